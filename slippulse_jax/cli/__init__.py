"""The commands of ``slippulse``, a module each; they import what they need when they run."""
