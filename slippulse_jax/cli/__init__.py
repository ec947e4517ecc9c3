"""The commands of ``slippulse``, one module each; imports are inside the functions so that ``--help`` answers at once."""
