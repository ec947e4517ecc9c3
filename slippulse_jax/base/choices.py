"""Choices of bodies and events, read without JAX and NumPy."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, Literal

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


def did_you_mean(wrong: Any, known: Iterable[str]) -> str:
    """Ask for the name that was meant; nothing where none is alike."""
    meant = get_close_matches(str(wrong), map(str, known), n=1)
    return f"; did you mean {meant[0]}?" if meant else ""
