"""Outcomes of events and searches, as numbers and as messages."""

import enum
from typing import Self


class NotConverged(RuntimeError):
    """Failure of a search for valid input (exit code 3)."""


class Status(enum.IntEnum):
    """Base of enumerations of outcomes; members are written ``NAME = number, "message"``."""

    message: str

    def __new__(cls, value: int, message: str) -> Self:
        """Make a member from its number and its message."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.message = message
        return member


class Outcome(Status):
    """How an event, a series of events or a search ended.

    Of an event, the length is finite up to `REBREAK` and for `NOTHING_BROKE`, inf for `RAN_THROUGH` and `RUN_AWAY`, else NaN.
    """

    ARRESTED = 0, "arrested: the first contact ahead stayed below its threshold"
    NO_DOMINO = 1, "no domino: only the contact at the edge broke, its neighbour stayed below threshold (length 0)"
    REBREAK = (
        2,
        "arrested, but a contact behind the front was back at its threshold before that: the length is that of the front, and "
        "the event goes farther; event='full' has the length of the whole event, rupture the breaks of a chain",
    )
    RAN_THROUGH = 3, "ran through: the last contact of the chain broke, so the event has no length (inf)"
    LIMIT = 4, "given up: contacts were still over threshold after the largest number of breaks allowed (length NaN)"
    INVALID = 5, "invalid: a value outside its domain, or too large for the precision (length NaN)"
    RUN_AWAY = 6, "run-away: no contact ahead will ever stop the front, so it has no length (inf)"
    NOTHING_BROKE = 7, "nothing broke: no contact was at its threshold"
    NOT_CONVERGED = 8, "not converged: the search was given up (length NaN)"
    SINGULAR = 9, "no equilibrium: a part of the chain is held by nothing, so its position is arbitrary (length NaN)"
    TIME_OVER = 10, "time over: still moving after the given duration"
    SOLVED = 11, "solved: every site is in balance"
    DONE = 12, "done: reached the requested number of events or load"
    SPANNED = 13, "ended by an event that broke the last contact of the chain"
    NOTHING_LEFT = 14, "ended early: no load brings a further contact to its threshold"
    LIFT_OFF = 15, "lifts off: a contact lost its pressure, beyond which the model does not go (length NaN)"


FRONT_OUTCOMES = tuple(outcome for outcome in Outcome if outcome <= Outcome.RUN_AWAY)
"""Possible outcomes of a front."""
