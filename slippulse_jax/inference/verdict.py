"""Verdicts: whether the data determine each parameter, and if not, why not and what they do determine."""

import dataclasses
import enum
import functools
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.inference.likelihood import Problem
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.model import recursion_status
from slippulse_jax.inference.parameters import STIFFNESSES, Free, ParameterSet
from slippulse_jax.inference.profile import Curve, Interval, Intervals, Rise
from slippulse_jax.inference.search import SLACK, Minimum
from slippulse_jax.shown import format_number
from slippulse_jax.status import Outcome

LEVELS = (0.6827, 0.95)
IMPROBABLE = 1e-3
"""Probability of χ² below which model and σ do not describe the data."""
SCATTERED = 0.05
"""Probability of χ², or of the largest pull, below which the report remarks on it."""
UNCHANGED = "at that maximum the length does not change with stiffness"
COVERED = (0.64, 0.93)
"""Shares of simulated estimates within 1 and 1.96 standard errors below which no standard error is given."""
WITHIN = 7
"""Points per piece of an interval at which to test whether a contact breaks again."""
PLATEAU = 0.97  # of the longest attainable length, above which a length constrains stiffness little


class Identifiability(enum.Enum):
    """Whether the data determine a parameter; the value is the sentence of the report."""

    IDENTIFIED = "identified"
    SEVERAL_ROOTS = "not identifiable as one number: more than one value fits"
    AT_MAXIMUM = "not identifiable: the length is at or above the attainable maximum"
    ONE_SIDED = "bounded on one side only"
    AT_BOUND = "not identifiable: the best fit lies at an end of the range searched"
    SKEWED = "identified, but not with a symmetric error"
    REBREAKS = "identified only if the event ends with its first front, which in the model it does not"
    EQUAL = "bounded, without a best value: all values inside the interval fit equally"
    UNINFORMATIVE = "not identifiable: no value is preferred"
    NO_SCATTER = "a value without an error: these lengths have no scatter to take one from"
    POOR_FIT = "the model does not describe these data"
    NOT_CONVERGED = "the search did not converge"


GRAVITY = (
    Identifiability.NOT_CONVERGED, Identifiability.POOR_FIT, Identifiability.UNINFORMATIVE, Identifiability.AT_BOUND,
    Identifiability.AT_MAXIMUM, Identifiability.NO_SCATTER, Identifiability.SEVERAL_ROOTS, Identifiability.ONE_SIDED,
    Identifiability.EQUAL, Identifiability.REBREAKS, Identifiability.SKEWED, Identifiability.IDENTIFIED,
)  # fmt: skip


GIVEN = (Identifiability.IDENTIFIED, Identifiability.SKEWED, Identifiability.REBREAKS)
"""Verdicts with a value that an input can move."""


class Verdict(NamedTuple):
    """Verdict on one parameter, with its reason."""

    identifiability: Identifiability
    reason: str = ""


SOUND = Verdict(Identifiability.IDENTIFIED)


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence for the verdicts on a fit; parameters by their index."""

    measurements: Measurements
    problem: Problem
    minima: list[Minimum]  # best first
    best: np.ndarray  # θ of least deviance, a minimum or not
    deviance: float
    dof: int | None  # where χ² can be judged
    rise: Rise
    attainable: np.ndarray  # longest length of each measurement at any stiffness searched, in λc
    curves: dict[int, Curve]  # profiles
    profiled: dict[int, Intervals]  # by profile likelihood, or those that counts allow
    reported: dict[int, Intervals]  # the same, or those of simulated measurements
    covered: dict[int, tuple[float, float]]  # shares of simulated estimates within 1 and 1.96 standard errors, if simulated
    lost: list[str]  # messages of the starts that did not converge and might matter
    closest: float | None  # relative distance of the lengths from the fit, where it is too small to be scatter
    at_odds: list[int] | None  # for exact counts: those at odds with the others

    @property
    def misfit(self) -> float:
        """Deviance beyond that of a perfect fit."""
        return self.deviance - self.problem.perfect

    @functools.cached_property
    def roots(self) -> list[Minimum]:
        """Minima not excluded at 95 %."""
        return [one for one in self.minima if one.deviance <= self.deviance + self.rise(LEVELS[-1])]


def judge(j: int, evidence: Evidence) -> Verdict:
    """Whether there is a number for parameter j to report with a standard error, and if not, why."""
    tests = (
        _lost,
        _nothing_responds,
        _misfit,
        _everything_allowed,
        _only_limits,
        _at_an_end,
        _singular,
        _beyond_maximum,
        _no_scatter,
        _not_alone,
        _open,
        _not_normal,
        _not_covered,
        _another_valley,
    )
    of_counts = evidence.at_odds is not None
    verdict = _counted(evidence) if of_counts else next(filter(None, (test(j, evidence) for test in tests)), SOUND)
    equal = of_counts and verdict.identifiability is Identifiability.EQUAL
    if equal or verdict.identifiability in (Identifiability.IDENTIFIED, Identifiability.SKEWED):
        return _breaks_again(j, evidence) or verdict
    return verdict


def trusted(j: int, verdict: Verdict, evidence: Evidence) -> Intervals:
    """Intervals of parameter j, without those that would measure a misfit instead of the parameter."""
    intervals = evidence.reported[j]
    if verdict.identifiability in (Identifiability.POOR_FIT, Identifiability.NO_SCATTER):
        return dict.fromkeys(intervals, [])
    if verdict.identifiability is Identifiability.AT_MAXIMUM:
        # where the data lie far above the maximum, the rise measures the misfit
        probability = float(chdtrc((evidence.dof or 0) + 1, evidence.misfit))
        return {level: pieces if probability >= 1 - level else [] for level, pieces in intervals.items()}
    return intervals


def _lost(j: int, e: Evidence) -> Verdict | None:
    return Verdict(Identifiability.NOT_CONVERGED, f"a start {e.lost[0]}") if e.lost else None


def _nothing_responds(j: int, e: Evidence) -> Verdict | None:
    if not e.problem.predict(e.best).any():
        return Verdict(Identifiability.UNINFORMATIVE, "nothing in the range searched starts a domino: every length is zero")
    return None


def _everything_allowed(j: int, e: Evidence) -> Verdict | None:
    pieces = e.profiled[j][LEVELS[-1]]
    if len(pieces) == 1 and pieces[0].open_low and pieces[0].open_high:
        told = undetermined(e.problem, e.best)
        why = f"; {told}" if told else ""
        return Verdict(Identifiability.UNINFORMATIVE, f"the data allow every value in the range searched{why}")
    return None


def _only_limits(j: int, e: Evidence) -> Verdict | None:
    """Fronts without arrest alone, all of them met: they have no best value."""
    pieces, problem = e.profiled[j][LEVELS[-1]], e.problem
    bound = problem.parameters.free[j].name in STIFFNESSES and not problem.gauged and set(e.measurements.kind) == {"at_least"}
    if not bound or len(pieces) != 1 or (problem.predict(e.best)[0] < e.measurements.length).any():
        return None
    if pieces[0].open_low or pieces[0].open_high:
        return Verdict(Identifiability.ONE_SIDED, "from above" if pieces[0].open_low else "from below")
    return Verdict(Identifiability.EQUAL, "every value in the interval gives lengths that are long enough")


def _misfit(j: int, e: Evidence) -> Verdict | None:
    if _above_maximum(e):
        return None  # `_beyond_maximum` is more precise
    if _improbable(e):
        end = _end(j, e)
        at = f" (the best fit lies at its {end} end)" if end else ""
        return Verdict(
            Identifiability.POOR_FIT,
            f"{e.problem.named_deviance} is {format_number(e.misfit, 3)}{of_inputs(e.problem, e.best)} for "
            f"{degrees_of_freedom(e.problem, e.dof)}: with the stated σ nothing in the range searched{at} gives these "
            "measurements, so no uncertainty is given",
        )
    return None


def _improbable(e: Evidence) -> bool:
    return e.dof is not None and float(chdtrc(e.dof, e.misfit)) < IMPROBABLE


def of_inputs(problem: Problem, theta: np.ndarray) -> str:
    """State the part of χ² that is no residual of a measurement, but of inputs fitted within their errors; empty if none."""
    part = float((problem.prior_weight * (theta - problem.prior_mean[0]) ** 2).sum())
    return f" ({part:.3g} of it from inputs fitted within their errors)" if f"{part:.2f}" != "0.00" else ""


def degrees_of_freedom(problem: Problem, dof: int | None) -> str:
    """``5 degrees of freedom``; ``at most 5`` where `Problem.testable` gives a bound."""
    count = dof or 0
    bound = "at most " * (count > problem.known - problem.p)
    return f"{bound}{count} degree{'s' * (count != 1)} of freedom"


def _no_scatter(j: int, e: Evidence) -> Verdict | None:
    if e.closest is None:
        return None
    return Verdict(
        Identifiability.NO_SCATTER,
        f"the lengths lie within {e.closest:.1g} of themselves of the fit, closer than anyone measures: they were computed, or "
        "copied; give σ (column length_sigma or length_sigma_mm)",
    )


def _singular(j: int, e: Evidence) -> Verdict | None:
    bounded = any(not (piece.open_low and piece.open_high) for piece in e.profiled[j][LEVELS[-1]])
    if e.problem.p > 1 and e.roots and e.roots[0].singular[j] and not bounded:
        return Verdict(Identifiability.UNINFORMATIVE, undetermined(e.problem, e.best))
    return None


def _above_maximum(e: Evidence) -> bool:
    # gauges determine stiffness where the length does not, and their fields bend from contact to contact;
    # interpolated lengths bend at their nodes too, so one of the lengths must be close to its longest
    if not e.roots or e.roots[0].share >= 0.5 or e.problem.gauged:
        return False
    predicted, m = e.problem.predict(e.roots[0].theta)[0], e.measurements
    met = (np.array(m.kind) == "at_least") & (predicted >= m.length)  # which says nothing of the longest
    return bool((~met & (predicted > PLATEAU * e.attainable)).any())


def _beyond_maximum(j: int, e: Evidence) -> Verdict | None:
    if not _above_maximum(e) or e.problem.parameters.free[j].name not in STIFFNESSES:
        return None
    over = e.problem.blocks[0].data.value[0] / e.attainable
    worst = int(np.argmax(over))
    return Verdict(
        Identifiability.AT_MAXIMUM,
        f"{e.measurements.number(worst)} is {over[worst]:.3g} times the longest that a stiffness in the range searched gives; "
        + UNCHANGED,
    )


def _at_an_end(j: int, e: Evidence) -> Verdict | None:
    end = _end(j, e)
    if end == "lower" and j == e.problem.parameters.discrepancy:
        return Verdict(Identifiability.ONE_SIDED, "the data need none: it is bounded from above only")
    return Verdict(Identifiability.AT_BOUND, f"the {end} one") if end else None


def _end(j: int, e: Evidence) -> str:
    """The end of the range searched at which the best fit lies; empty if at neither."""
    q = e.problem.parameters
    reach = 1e-6 * (q.high[j] - q.low[j])
    ends = {"lower": q.low[j], "upper": q.high[j]}
    return next((end for end, at in ends.items() if abs(e.best[j] - at) <= reach), "")


def _open(j: int, e: Evidence) -> Verdict | None:
    if any(piece.open_low or piece.open_high for piece in e.profiled[j][LEVELS[-1]]):
        lower = e.profiled[j][LEVELS[-1]][0].open_low
        return Verdict(Identifiability.ONE_SIDED, "from above" if lower else "from below")
    return None


def _not_alone(j: int, e: Evidence) -> Verdict | None:
    q, pieces = e.problem.parameters, e.profiled[j][LEVELS[-1]]
    one = q.free[j]
    inner = [root for root in e.roots if q.low[j] < root.theta[j] < q.high[j]]
    values = sorted({float(f"{one.value(root.theta[j]):.4g}"): None for root in inner})
    near = max(1e-3, _wrinkle(j, e)) if len(pieces) == 1 else 1e-3
    apart = [value for i, value in enumerate(values) if i == 0 or abs(one.theta(value) - one.theta(values[i - 1])) > near]
    if len(apart) > 1:
        joined = "; the interval joins them" if len(pieces) == 1 else ""
        named = " and ".join(map(format_number, apart))
        return Verdict(Identifiability.SEVERAL_ROOTS, f"the data fit at {named} {one.unit}".rstrip() + joined)
    return None


def _wrinkle(j: int, e: Evidence) -> float:
    """Largest distance between two minima of one valley: one standard error where gauges were read, whose fields change in
    steps from contact to contact; zero elsewhere.
    """
    if not e.problem.gauged or not e.roots or e.roots[0].singular[j]:
        return 0.0
    return float(np.sqrt(e.rise(LEVELS[0]) * e.roots[0].covariance[j, j]))


def _not_normal(j: int, e: Evidence) -> Verdict | None:
    if not e.roots or e.roots[0].singular[j]:
        one, ranges = e.problem.parameters.free[j], e.profiled[j][LEVELS[-1]]
        if len(ranges) < 2:
            return Verdict(Identifiability.EQUAL, "a whole range of values fits equally well; use the intervals")
        return Verdict(Identifiability.SEVERAL_ROOTS, f"the data fit from {_ranges(one, ranges)}")
    covariance = e.roots[0].covariance
    pieces = e.profiled[j][LEVELS[0]]
    if not pieces:
        return Verdict(Identifiability.SKEWED, "the likelihood has no interval at 68 %")
    one = np.sqrt(e.rise(LEVELS[0]) * covariance[j, j])
    widths = [abs(end - e.best[j]) / one for end in (pieces[0].low, pieces[-1].high)]
    if max(widths) < 0.5 and e.problem.parameters.free[j].name in STIFFNESSES:
        longest = f"the measured length is almost the longest that any stiffness gives; {UNCHANGED}"
        return Verdict(Identifiability.AT_MAXIMUM, longest)
    if len(pieces) > 1 or max(widths) > 1.5 or min(widths) < 1 / 1.5:
        return Verdict(
            Identifiability.SKEWED,
            "the likelihood is far from a normal curve (its 68 % interval reaches "
            f"{widths[0]:.2g} and {widths[1]:.2g} curvature standard errors); use the intervals",
        )
    return None


def _not_covered(j: int, e: Evidence) -> Verdict | None:
    covered = e.covered.get(j, (1.0, 1.0))
    if all(share >= least for share, least in zip(covered, COVERED, strict=True)):
        return None
    return Verdict(
        Identifiability.SKEWED,
        f"in simulations of these measurements a standard error holds the truth in {covered[0]:.0%} of cases, 1.96 of them in "
        f"{covered[1]:.0%}; use the intervals",
    )


def _another_valley(j: int, e: Evidence) -> Verdict | None:
    """Withhold a standard error where another valley, only slightly worse, lies far outside it."""
    best, one = e.minima[0], e.problem.parameters.free[j]
    far = 5 * np.sqrt(best.covariance[j, j])
    for other in e.minima[1:]:
        if other.deviance <= e.deviance + SLACK and abs(other.theta[j] - best.theta[j]) > far:
            value = f"{format_number(one.value(other.theta[j]))} {one.unit}".rstrip()
            worse = other.deviance - e.deviance
            return Verdict(
                Identifiability.SKEWED,
                f"another valley, at {value}, is worse by a deviance of only {worse:.3g}; use the intervals",
            )
    return None


def _breaks_again(j: int, e: Evidence) -> Verdict | None:
    """Test whether, at a value that is not excluded, the edge contact breaks again before the front stops."""
    q, pieces, curve = e.problem.parameters, e.reported[j][LEVELS[-1]], e.curves[j]
    if q.smooth or q.event != "domino" or not pieces:
        return None
    value = np.concatenate([np.linspace(piece.low, piece.high, WITHIN) for piece in pieces])
    inputs = q.inputs_at(np.stack([np.interp(value, curve.node, column) for column in curve.theta.T], axis=1))
    rows = q.rows_of(j)
    again = (recursion_status(inputs.ravel()) == Outcome.REBREAK).reshape(len(value), -1)[:, rows].any(axis=1)
    if not again.any():
        return None
    share = "everywhere in the 95 % interval" if again.all() else "within the 95 % interval"
    b = np.exp(inputs.log_b)[:, rows].max()
    return Verdict(
        Identifiability.REBREAKS,
        f"{share} (b up to {b:.3g}) the contact at the edge is back at its threshold before the front stops: the event then "
        "goes on, and the length fitted is that of the front alone",
    )


def _counted(e: Evidence) -> Verdict:
    """Whether one range of values, several or none give all counts."""
    m, one, pieces = e.measurements, e.problem.parameters.free[0], e.profiled[0][LEVELS[-1]]
    if not pieces:
        at_odds = e.at_odds or []
        where = ", ".join(m.number(i) for i in at_odds)
        without = f"all counts; without {where} the others agree" if len(at_odds) < len(m) else "any of the counts"
        return Verdict(Identifiability.POOR_FIT, f"no value in the range searched gives {without}")
    if len(pieces) > 1:
        return Verdict(Identifiability.SEVERAL_ROOTS, f"the counts hold from {_ranges(one, pieces)}")
    (piece,) = pieces
    if piece.open_low and piece.open_high:
        return Verdict(Identifiability.UNINFORMATIVE, "the counts hold everywhere in the range searched")
    if piece.open_low or piece.open_high:
        return Verdict(Identifiability.ONE_SIDED, "from above" if piece.open_low else "from below")
    return Verdict(Identifiability.EQUAL, "every value in the interval gives all counts")


def _ranges(one: Free, pieces: list[Interval]) -> str:
    each = (" to ".join(format_number(one.value(x)) for x in (piece.low, piece.high)) for piece in pieces)
    return f"{' and '.join(each)} {one.unit}".rstrip()


def gravest(verdicts: dict[str, Verdict]) -> str:
    """Name of the parameter with the gravest verdict."""
    return min(verdicts, key=lambda name: GRAVITY.index(verdicts[name].identifiability))


class Direction(NamedTuple):
    """A combination of parameters, and the standard error with which the data and priors give it."""

    text: str  # as ``young / areal_stiffness^0.98``
    coefficients: np.ndarray  # of the logarithms (of linear parameters: over their range), (p,), length 1
    stderr: float  # inf where nothing determines it


def directions(problem: Problem, theta: np.ndarray) -> list[Direction]:
    """Combinations of the parameters by how well they are determined, best first: singular vectors of the scaled Jacobian.

    Every positive parameter counts by its logarithm, every other over the range searched for it. Two parameters that only ever
    act together have one direction with a finite error, and one without.
    """
    q = problem.parameters
    unit = np.array([1.0 if one.log else one.high - one.low for one in q.free])
    _, jacobian = problem.information(theta)
    _, values, vectors = np.linalg.svd(jacobian * unit, full_matrices=False)
    nothing = values <= 1e-7 * max(values.max(), 1e-300)
    stderr = np.where(nothing, np.inf, 1 / np.where(nothing, 1, values))
    return [Direction(_in_words(vector, q), vector, float(error)) for vector, error in zip(vectors, stderr, strict=True)]


def _in_words(vector: np.ndarray, q: ParameterSet) -> str:
    lead = int(np.argmax(np.abs(vector) > 0.9 * np.abs(vector).max()))
    scaled = vector / vector[lead]
    parts = []
    for weight, one in sorted(zip(scaled, q.free, strict=True), key=lambda pair: -round(abs(pair[0]), 2)):
        if abs(weight) < 0.02:
            continue
        power = "" if abs(weight - 1) < 0.005 else f"^{weight:.2g}"
        parts.append(f"{one.label}{power}" if one.log else f"exp({weight / (one.high - one.low):.3g} {one.label})")
    return " · ".join(parts)


def undetermined(problem: Problem, theta: np.ndarray) -> str:
    """Describe the combinations of parameters that the data leave open; empty where there is none."""
    if problem.p == 1:
        return ""
    found = directions(problem, theta)
    reach = max((one.high - one.low) if one.log else 1.0 for one in problem.parameters.free)
    open_ones = [one for one in found if one.stderr > reach / 4]
    if not open_ones:
        return ""
    known = [one.text for one in found if one.stderr <= reach / 4]
    told = f"only {', '.join(known)} is determined" if known else "no combination is determined"
    return f"{told}; the data do not determine {', '.join(one.text for one in open_ones)}"
