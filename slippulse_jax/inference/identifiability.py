"""Whether the data determine the stiffness, and if not, why not."""

import enum
from typing import TYPE_CHECKING

import numpy as np

from slippulse_jax.inference.objective import Curve, Data
from slippulse_jax.inference.optimise import Outcome
from slippulse_jax.inference.uncertainty import Interval, chi_squared_tail, threshold

if TYPE_CHECKING:
    from slippulse_jax.inference.result import Root

LEVELS = (0.6827, 0.95)
IMPROBABLE = 1e-3
"""Probability of χ² under which model and σ together are said not to describe the data."""
UNCHANGED = "at that maximum the length does not change with stiffness"

Verdict = tuple["Identifiability", str]


class Identifiability(enum.Enum):
    """Whether the data determine the stiffness; the value is what the report says."""

    IDENTIFIED = "identified"
    SEVERAL_ROOTS = "not identifiable as one number: more than one stiffness fits"
    AT_MAXIMUM = "not identifiable: the length is at or above the attainable maximum"
    ONE_SIDED = "bounded on one side only"
    AT_BOUND = "not identifiable: the best fit lies at an end of the range searched"
    SKEWED = "identified, but not with a symmetric error"
    UNINFORMATIVE = "not identifiable: no stiffness is preferred"
    POOR_FIT = "the model does not describe these data"
    NOT_CONVERGED = "the search did not converge"


def judge(
    best: "Root | None", roots: list["Root"], intervals: dict[float, list[Interval]], curve: Curve, data: Data, unit: str
) -> Verdict:
    """Whether there is a number to report with a standard error, and if not, why.

    Parameters
    ----------
    best : Root or None
        The root with the least χ² of all, if a root has it.
    roots : list of Root
        All of them, best first.
    intervals : dict
        Allowed ranges of θ at `LEVELS`.
    """
    verdict = _without_a_root(best, intervals, curve)
    if verdict is None and best is not None:
        verdict = _misfit(best, curve, data) or _not_alone(roots, intervals, unit) or _not_normal(best, intervals)
    return verdict or (Identifiability.IDENTIFIED, "")


def _without_a_root(best: "Root | None", intervals: dict[float, list[Interval]], curve: Curve) -> Verdict | None:
    pieces = intervals[LEVELS[-1]]
    if not curve.length.any():
        return Identifiability.UNINFORMATIVE, "no stiffness in the range searched starts a domino: every length is zero"
    if len(pieces) == 1 and pieces[0].open_low and pieces[0].open_high:
        return Identifiability.UNINFORMATIVE, "the data allow every stiffness in the range searched"
    if best is None:
        end = "upper" if intervals[LEVELS[0]][-1].open_high else "lower"
        return Identifiability.AT_BOUND, f"the best fit lies at the {end} end of the range searched"
    return None


def _misfit(best: "Root", curve: Curve, data: Data) -> Verdict | None:
    if best.share_of_information is not None and best.share_of_information < 0.5:
        longest = float(np.max(data.length / curve.length.max(axis=0)))
        return Identifiability.AT_MAXIMUM, (
            f"the measured length is {longest:.3g} times the longest that a stiffness in the range searched gives; {UNCHANGED}"
        )
    dof = len(data.length) - 1
    if dof and chi_squared_tail(best.chi2, dof) < IMPROBABLE:
        return Identifiability.POOR_FIT, (
            f"chi-squared is {best.chi2:.3g} for {dof} degree{'s' * (dof > 1)} of freedom: with the stated σ no stiffness "
            "gives these lengths, and errors that rest on σ would mean nothing"
        )
    return None


def _not_alone(roots: list["Root"], intervals: dict[float, list[Interval]], unit: str) -> Verdict | None:
    pieces = intervals[LEVELS[-1]]
    rivals = [root for root in roots if root.chi2 <= roots[0].chi2 + threshold(LEVELS[-1])]
    if len(rivals) > 1:
        values = " and ".join(f"{root.value:.4g}" for root in rivals)
        joined = "; the interval joins them" if len(pieces) == 1 else ""
        return Identifiability.SEVERAL_ROOTS, f"the lengths fit at {values} {unit}".rstrip() + joined
    if any(piece.open_low or piece.open_high for piece in pieces):
        return Identifiability.ONE_SIDED, "the data bound the stiffness on one side only"
    return None


def _not_normal(best: "Root", intervals: dict[float, list[Interval]]) -> Verdict | None:
    if best.log_stderr is None:
        return Identifiability.SKEWED, Outcome.KINK.message + "; use the intervals"
    pieces = intervals[LEVELS[0]]
    widths = [abs(end - np.log(best.value)) / best.log_stderr for end in (pieces[0].low, pieces[-1].high)]
    if max(widths) < 0.5:
        return Identifiability.AT_MAXIMUM, f"the measured length is all but the longest that any stiffness gives; {UNCHANGED}"
    if len(pieces) > 1 or max(widths) > 1.5 or min(widths) < 1 / 1.5:
        return Identifiability.SKEWED, (
            "the likelihood is far from a normal curve (its 68 % interval reaches "
            f"{widths[0]:.2g} and {widths[1]:.2g} curvature standard errors); use the intervals"
        )
    return None
