"""Choices of bodies and events, read without JAX and NumPy."""

from typing import Literal

Control = Literal["displacement", "force"]
"""What is held while an event on a block runs."""
ContactLaw = Literal["amontons", "multicontact"]
"""What follows the pressure on a contact: its threshold, or its threshold and its stiffness."""
Top = Literal["free", "held"]
"""Whether the top of a block may tilt."""
RightEnd = Literal["semi-infinite", "free", "clamped"]
"""Right end of a chain of contacts."""
EventKind = Literal["domino", "full"]
"""Event whose length is meant: the first front, in which each contact breaks once; or the whole event."""
