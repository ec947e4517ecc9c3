"""Verdicts: whether the data determine each parameter, or why not."""

import enum
import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.base.shown import format_number, listed
from slippulse_jax.inference.model.front import IMPROBABLE
from slippulse_jax.inference.parameters import STIFFNESSES, Free, ParameterSet
from slippulse_jax.inference.search.intervals import LEVELS, Interval, Intervals, rise_of
from slippulse_jax.inference.search.likelihood import Problem
from slippulse_jax.inference.search.minima import SLACK, Curve, Found
from slippulse_jax.inference.table.measurements import Measurements

UNCHANGED = "at that maximum the length does not change with stiffness"
COVERED = (0.64, 0.93)
"""Shares of simulated estimates within 1 and 1.96 standard errors below which no standard error is given."""
FAR = 5.0  # standard errors from which on two minima are two valleys
PLATEAU = 0.97  # of the longest attainable length, above which a length constrains stiffness little


class Identifiability(enum.Enum):
    """Whether data determine a parameter: sentences of the report, the gravest first."""

    NOT_CONVERGED = "the search did not converge"
    POOR_FIT = "the model does not describe these data"
    UNINFORMATIVE = "not identifiable: no value is preferred"
    AT_BOUND = "not identifiable: the best fit is at an end of the range searched"
    AT_MAXIMUM = "not identifiable: the length is at or above the attainable maximum"
    NO_SCATTER = "no error: the lengths agree too closely to be measurements"
    SEVERAL_ROOTS = "not identifiable as one number: more than one value fits"
    ONE_SIDED = "bounded on one side only"
    EQUAL = "bounded, without a best value: all values inside the interval fit equally"
    REBREAKS = "identified for the first front only: in the model the edge breaks again and the event goes on"
    SKEWED = "identified, but not with a symmetric error"
    IDENTIFIED = "identified"


ANSWERS = {
    Identifiability.NOT_CONVERGED: "not-converged",
    Identifiability.POOR_FIT: "misfit",
    Identifiability.UNINFORMATIVE: "any-value",
    Identifiability.AT_BOUND: "at-a-bound",
    Identifiability.AT_MAXIMUM: "too-long",
    Identifiability.NO_SCATTER: "no-scatter",
    Identifiability.SEVERAL_ROOTS: "two-values",
    Identifiability.ONE_SIDED: "one-sided",
    Identifiability.EQUAL: "a-range",
    Identifiability.REBREAKS: "edge-breaks-again",
    Identifiability.SKEWED: "uneven-error",
    "none fits": "none-fits",
    "check first": "check-first",
}
"""Headings of `FAQ` by verdict, and by two messages of the report."""
FAQ = "docs/fit/faq.md"
GRAVITY = tuple(Identifiability)
GIVEN = (Identifiability.IDENTIFIED, Identifiability.SKEWED, Identifiability.REBREAKS)
"""Verdicts with a value."""


class Verdict(NamedTuple):
    """Verdict on one parameter, with its reason."""

    identifiability: Identifiability
    reason: str = ""


def judge(problem: Problem, found: Found, j: int, profiled: Intervals, reported: Intervals) -> tuple[Verdict, Intervals]:
    """Judge whether parameter j has an error; return its intervals too.

    `found` with what follows from it, as `testable_dof`. `profiled` are the profile-likelihood intervals of θ_j; `reported` the
    same, or those of simulated measurements.
    """
    pieces = profiled[LEVELS[-1]]
    withheld = itertools.chain(
        _of_fit(problem, found, j), _of_range(problem, found, j, pieces), _of_shape(problem, found, j, profiled)
    )
    verdict = next(withheld, Verdict(Identifiability.IDENTIFIED))
    equal = verdict.identifiability is Identifiability.EQUAL and problem.sharp
    if equal or verdict.identifiability in (Identifiability.IDENTIFIED, Identifiability.SKEWED):
        verdict = _breaks_again(problem, found.curves[j], j, reported[LEVELS[-1]]) or verdict
    # without intervals that would measure a misfit instead of the parameter
    if verdict.identifiability in (Identifiability.POOR_FIT, Identifiability.NO_SCATTER):
        return verdict, dict.fromkeys(reported, [])
    if verdict.identifiability is Identifiability.AT_MAXIMUM:
        probability = float(chdtrc((found.testable_dof or 0) + 1, found.deviance - problem.perfect(found.theta)))
        return verdict, {level: pieces if probability >= 1 - level else [] for level, pieces in reported.items()}
    return verdict, reported


def _of_fit(problem: Problem, found: Found, j: int) -> Iterator[Verdict]:
    """Withhold a number where search or fit failed."""
    dof = found.testable_dof
    p_value = problem.p_value(found.theta, found.deviance, dof)
    if found.unconverged:
        yield Verdict(Identifiability.NOT_CONVERGED, f"a start {found.unconverged[0][1]}")
    if not problem.predict(found.theta).any() and problem.measurements.length.max() > 1:  # a count of one holds there
        yield Verdict(Identifiability.UNINFORMATIVE, "nothing in the range searched starts a domino: every length is zero")
    if p_value is not None and p_value < IMPROBABLE and not _above_maximum(problem, found):  # of which `_of_range` says more
        at = f"; the best fit is at the {end} end of the range" if (end := _end(problem, found.theta, j)) else ""
        yield Verdict(
            Identifiability.POOR_FIT,
            f"{problem.fits(found.theta, found.deviance, p_value, dof)}; with the stated σ nothing in the range searched gives "
            f"these measurements, so no uncertainty is given{at}",
        )


def _of_range(problem: Problem, found: Found, j: int, pieces: list[Interval]) -> Iterator[Verdict]:
    """Withhold a number where range or longest length bounds it."""
    m, stiff = problem.measurements, problem.parameters.free[j].name in STIFFNESSES
    every = [piece.open_low and piece.open_high for piece in pieces]
    if every == [True]:
        told = undetermined(problem, found.theta)
        why = f"the data allow every value in the range searched{'; ' * bool(told)}{told}"
        yield Verdict(Identifiability.UNINFORMATIVE, _unseen(problem.parameters.free[j], pieces) or why)
    of_lengths = stiff and not problem.steps and not any(data.observable.is_value for data in problem.of_rows)
    limits = of_lengths and {*m.kind} == {"at_least"}  # which have no best value where all are met
    if limits and len(pieces) == 1 and (problem.predict(found.theta)[0] >= m.length).all():
        yield from open_ended(problem.parameters.free[j], pieces)
        yield Verdict(Identifiability.EQUAL, "every value in the interval gives lengths that are long enough")
    if end := _end(problem, found.theta, j):
        yield Verdict(
            Identifiability.AT_BOUND,
            f"it is the {end} end; widen the range: {m.option('--bounds LOW HIGH', 'bounds=(low, high)')}",
        )
    if problem.p > 1 and found.roots and found.roots[0].singular[j] and all(every):
        yield Verdict(Identifiability.UNINFORMATIVE, undetermined(problem, found.theta))
    if stiff and _above_maximum(problem, found):
        over = problem.by_row(lambda data: data.value[0]) / found.attainable
        worst = int(np.argmax(over))
        times = f"{over[worst]:.3g} times the longest at any stiffness searched"
        yield Verdict(Identifiability.AT_MAXIMUM, f"{m.number(worst)} is {times}; {UNCHANGED}")
    if found.closest is not None:
        yield Verdict(
            Identifiability.NO_SCATTER,
            f"they match the fit to a relative {format_number(found.closest, 1)}, closer than anyone measures, so they were "
            "computed or copied; give σ in column length_sigma or length_sigma_mm",
        )


def _of_shape(problem: Problem, found: Found, j: int, profiled: Intervals) -> Iterator[Verdict]:
    """Withhold an error where the likelihood is far from normal."""
    yield from _several(problem, found, j, profiled[LEVELS[-1]])
    yield from open_ended(problem.parameters.free[j], profiled[LEVELS[-1]])
    yield from _not_normal(problem, found, j, profiled)
    covered = found.covered.get(j, (1.0, 1.0))
    if any(share < least for share, least in zip(covered, COVERED, strict=True)):
        yield Verdict(
            Identifiability.SKEWED,
            f"in simulations one standard error covers the truth in {100 * covered[0]:.0f} % of cases, and 1.96 of them in "
            f"{100 * covered[1]:.0f} %; use the intervals",
        )
    best, free = found.minima[0], problem.parameters.free[j]
    far = FAR * np.sqrt(best.covariance[j, j])
    for other in found.minima[1:]:  # another valley, only slightly worse, far outside the standard error
        if other.deviance <= found.deviance + SLACK and abs(other.theta[j] - best.theta[j]) > far:
            value, worse = f"{format_number(free.value(other.theta[j]))} {free.unit}".rstrip(), other.deviance - found.deviance
            reason = f"a second minimum, at {value}, is worse by a deviance of only {worse:.3g}; use the intervals"
            yield Verdict(Identifiability.SKEWED, reason)


def _above_maximum(problem: Problem, found: Found) -> bool:
    # gauges determine stiffness where the length does not, and their fields bend from contact to contact;
    # interpolated lengths bend at their nodes too, so one of the lengths must be close to its longest
    if not found.roots or found.roots[0].share >= 0.5 or problem.steps:
        return False
    predicted, m = problem.predict(found.roots[0].theta)[0], problem.measurements
    met = (np.array(m.kind) == "at_least") & (predicted >= m.length)  # which says nothing of the longest
    return bool((~met & (predicted > PLATEAU * found.attainable)).any())


def _end(problem: Problem, theta: np.ndarray, j: int) -> str:
    """Name the end of the range at the best fit, if any."""
    q = problem.parameters
    reach = 1e-6 * (q.high[j] - q.low[j])
    ends = {"lower": q.low[j], "upper": q.high[j]}
    return next((end for end, at in ends.items() if abs(theta[j] - at) <= reach), "")


def open_ended(one: Free, pieces: list[Interval]) -> Iterator[Verdict]:
    """Call open ends limits, or not looked at."""
    if any(piece.open_low or piece.open_high for piece in pieces):
        limit = f"the data give {'an upper' if pieces[0].open_low else 'a lower'} limit only"
        yield Verdict(Identifiability.ONE_SIDED, _unseen(one, pieces) or limit)


def _unseen(one: Free, pieces: list[Interval]) -> str:
    """Say beyond which open ends no events were followed, if any."""
    ends = [("below", pieces[0].open_low, pieces[0].low, one.low), ("above", pieces[-1].open_high, pieces[-1].high, one.high)]
    inside = 1e-3 * (one.high - one.low)
    beyond = [f"{way} {format_number(one.value(at))}" for way, is_open, at, end in ends if is_open and abs(at - end) > inside]
    return f"not looked at {' and '.join(beyond)}{f' {one.unit}'.rstrip()}: no events were followed there" if beyond else ""


def _several(problem: Problem, found: Found, j: int, pieces: list[Interval]) -> Iterator[Verdict]:
    """Name the values of minima that lie in different valleys."""
    free, joined, roots = problem.parameters.free[j], len(pieces) == 1, found.roots
    values = sorted({float(f"{free.value(root.theta[j]):.4g}") for root in roots if free.low < root.theta[j] < free.high})
    near = 1e-3
    if joined and problem.drawn:
        return  # whose deviance is rough: minima within one interval are one valley
    if joined and problem.steps and roots and not roots[0].singular[j]:
        # one standard error where gauges were read, whose fields change in steps from contact to contact
        near = max(near, float(np.sqrt(rise_of(LEVELS[0], dof=found.scatter_dof) * roots[0].covariance[j, j])))
    if joined and problem.emulates and roots:  # a rough deviance has minima side by side
        near = FAR * float(np.sqrt(roots[0].covariance[j, j]))
    apart = [value for i, value in enumerate(values) if i == 0 or abs(free.theta(value) - free.theta(values[i - 1])) > near]
    if len(apart) > 1:
        named = f"{listed([*map(format_number, apart)])} {free.unit}".rstrip()
        yield Verdict(Identifiability.SEVERAL_ROOTS, f"the data fit at {named}" + "; the interval joins them" * joined)


def _not_normal(problem: Problem, found: Found, j: int, profiled: Intervals) -> Iterator[Verdict]:
    """Compare the 68 % interval with the standard error of the curvature."""
    free, inner, pieces = problem.parameters.free[j], profiled[LEVELS[0]], profiled[LEVELS[-1]]
    if not found.roots or found.roots[0].singular[j]:
        if len(pieces) > 1:
            yield Verdict(Identifiability.SEVERAL_ROOTS, f"the data fit from {_ranges(free, pieces)}")
        yield Verdict(Identifiability.EQUAL, "a whole range of values fits equally well; use the intervals")
    elif not inner:
        yield Verdict(Identifiability.SKEWED, "the likelihood has no interval at 68 %")
    else:
        error = np.sqrt(rise_of(LEVELS[0], dof=found.scatter_dof) * found.roots[0].covariance[j, j])
        widths = [abs(end - found.theta[j]) / error for end in (inner[0].low, inner[-1].high)]
        if max(widths) < 0.5 and free.name in STIFFNESSES and not problem.emulates:
            longest = f"the measured length is almost the longest at any stiffness; {UNCHANGED}"
            yield Verdict(Identifiability.AT_MAXIMUM, longest)
        if len(inner) > 1 or max(widths) > 1.5 or min(widths) < 1 / 1.5:
            reach = f"the 68 % interval reaches {widths[0]:.2g} standard errors below the value and {widths[1]:.2g} above"
            yield Verdict(Identifiability.SKEWED, f"the likelihood is far from a normal curve; {reach}; use the intervals")


def _breaks_again(problem: Problem, curve: Curve, j: int, pieces: list[Interval]) -> Verdict | None:
    """Test for a second break of the edge contact within the interval."""
    q = problem.parameters
    if not pieces:
        return None
    value = np.concatenate([np.linspace(piece.low, piece.high, 7) for piece in pieces])
    inputs = q.inputs.at(np.stack([np.interp(value, curve.node, column) for column in curve.theta.T], axis=1))
    rows = q.rows_of(j)
    again = q.front.breaks_again(inputs.ravel()).reshape(len(value), -1)[:, rows].any(axis=1)
    if not again.any():
        return None
    where = "everywhere" if again.all() else "at some values"
    b = np.exp(inputs.log_b)[:, rows].max()
    return Verdict(
        Identifiability.REBREAKS,
        f"{where} in the 95 % interval the edge contact is back at its threshold before the front stops; b is up to {b:.3g}; "
        f"{whole_events(problem.measurements)}",
    )


def whole_events(m: Measurements) -> str:
    """Say how whole events are fitted."""
    if m.gauges is not None or m.block_length is not None or m.machine_stiffness is not None:
        return "a fit of whole events takes no gauges, ends or machines"
    return "if whole events were measured, give " + m.option("--event full", 'event="full"')


def _ranges(one: Free, pieces: list[Interval]) -> str:
    each = (" to ".join(format_number(one.value(x)) for x in (piece.low, piece.high)) for piece in pieces)
    return f"{' and from '.join(each)} {one.unit}".rstrip()


def directions(problem: Problem, theta: np.ndarray) -> list[dict[str, Any]]:
    """List combinations of the parameters, the best determined first.

    They are singular vectors of the scaled Jacobian, each with the `combination` in words, as ``young / areal_stiffness^0.98``,
    the `stderr` with which data and priors give it, inf where nothing does, and its `coefficients`, a vector of length 1. Every
    positive parameter counts by its logarithm, every other over the range searched for it. Two parameters that only ever act
    together have one direction with a finite error, and one without.
    """
    q = problem.parameters
    unit = np.array([1.0 if one.log else one.high - one.low for one in q.free])
    _, values, vectors = np.linalg.svd(problem.jacobian(theta) * unit, full_matrices=False)
    nothing = values <= 1e-7 * max(values.max(), 1e-300)
    stderr = np.where(nothing, np.inf, 1 / np.where(nothing, 1, values)).tolist()
    found = zip(vectors, stderr, strict=True)
    return [{"combination": _in_words(vector, q), "stderr": error, "coefficients": vector} for vector, error in found]


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
    """Describe the combinations that the data leave open, if any."""
    if problem.p == 1:
        return ""
    found = directions(problem, theta)
    reach = max((one.high - one.low) if one.log else 1.0 for one in problem.parameters.free)
    known, lost = ([one["combination"] for one in found if (one["stderr"] > reach / 4) == left] for left in (False, True))
    if not lost:
        return ""
    told = f"only {', '.join(known)} is determined" if known else "no combination is determined"
    return f"{told}; the data do not determine {', '.join(lost)}"
