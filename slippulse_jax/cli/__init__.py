"""The commands of ``slippulse``, one module each.

Imports are inside the functions, so that ``--help`` answers at once.
"""
