"""A claim of the paper, the criteria of its verdict, and its measurement."""

from collections.abc import Callable
from typing import Literal, NamedTuple

Verdict = Literal["holds", "holds within limits", "does not hold as worded"]

HOLDS: Verdict = "holds"
WITHIN: Verdict = "holds within limits"
FAILS: Verdict = "does not hold as worded"


class Finding(NamedTuple):
    """The numbers measured for one claim, and the verdict that follows from them."""

    measured: str
    verdict: Verdict


class Claim(NamedTuple):
    """One claim; `holds` and `limits` are the criteria of the verdicts *holds* and *holds within limits*."""

    number: str
    says: str
    holds: str
    limits: str  # empty where a claim either holds or fails
    measure: Callable[[], Finding]


def claim(number: str, *, holds: str, limits: str = "") -> Callable[[Callable[[], Finding]], Claim]:
    """Turn a measurement into a `Claim`; its docstring states the claim."""
    return lambda measure: Claim(number, (measure.__doc__ or "").rstrip("."), holds, limits, measure)


def judge(holds: bool, within: bool = False) -> Verdict:
    """Give the verdict of the two criteria."""
    return HOLDS if holds else WITHIN if within else FAILS
