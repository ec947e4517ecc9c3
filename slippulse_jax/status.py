"""Outcomes: a number to store in arrays and files, a sentence to show to people; and the error where there is no outcome."""

import enum
from typing import Self


class NotConverged(RuntimeError):
    """What was searched for was not found, though the input was sound; the command line ends with status 3."""


class Status(enum.IntEnum):
    """Base of the outcomes of fronts, ruptures, series and searches: members are written ``NAME = number, "message"``."""

    message: str

    def __new__(cls, value: int, message: str) -> Self:
        """Member whose value is stored in files and whose message is shown to the user."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.message = message
        return member
