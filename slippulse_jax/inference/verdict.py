"""Verdicts: whether the data determine each parameter, and if not, why not and what they do determine."""

from typing import Any

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.inference.fitted import IMPROBABLE, LEVELS, Fitted, Identifiability, Verdict
from slippulse_jax.inference.intervals import Interval, Intervals
from slippulse_jax.inference.likelihood import Problem
from slippulse_jax.inference.parameters import STIFFNESSES, Free, ParameterSet
from slippulse_jax.inference.search import SLACK
from slippulse_jax.shown import format_number, plural

UNCHANGED = "at that maximum the length does not change with stiffness"
COVERED = (0.64, 0.93)
"""Shares of simulated estimates within 1 and 1.96 standard errors below which no standard error is given."""
WITHIN = 7
"""Points per piece of an interval at which to test whether a contact breaks again."""
PLATEAU = 0.97  # of the longest attainable length, above which a length constrains stiffness little


def judge(
    e: Fitted, j: int, profiled: Intervals, reported: Intervals, at_odds: list[int] | None = None
) -> tuple[Verdict, Intervals]:
    """Whether there is a number for parameter j to report with a standard error, and if not, why; and its intervals.

    Parameters
    ----------
    e : Fitted
        Of which verdicts and intervals are not known yet.
    j : int
    profiled : dict
        Pieces of the profile-likelihood interval of θ_j by level, or those that counts allow.
    reported : dict
        The same, or those of simulated measurements.
    at_odds : list of int, optional
        For counts without an error: those at odds with the others.
    """
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
    if at_odds is not None:
        verdict = _counted(e, profiled[LEVELS[-1]], at_odds)
    else:
        verdict = next(filter(None, (test(e, j, profiled) for test in tests)), Verdict(Identifiability.IDENTIFIED))
    equal = at_odds is not None and verdict.identifiability is Identifiability.EQUAL
    if equal or verdict.identifiability in (Identifiability.IDENTIFIED, Identifiability.SKEWED):
        verdict = _breaks_again(e, j, reported[LEVELS[-1]]) or verdict
    # without intervals that would measure a misfit instead of the parameter
    if verdict.identifiability in (Identifiability.POOR_FIT, Identifiability.NO_SCATTER):
        return verdict, dict.fromkeys(reported, [])
    if verdict.identifiability is Identifiability.AT_MAXIMUM:
        probability = float(chdtrc((e.testable_dof or 0) + 1, e.misfit))
        return verdict, {level: pieces if probability >= 1 - level else [] for level, pieces in reported.items()}
    return verdict, reported


def _lost(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    return Verdict(Identifiability.NOT_CONVERGED, f"a start {e.unconverged[0]}") if e.unconverged else None


def _nothing_responds(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    if not e.problem.predict(e.theta).any():
        return Verdict(Identifiability.UNINFORMATIVE, "nothing in the range searched starts a domino: every length is zero")
    return None


def _everything_allowed(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    pieces = profiled[LEVELS[-1]]
    if len(pieces) == 1 and pieces[0].open_low and pieces[0].open_high:
        told = undetermined(e.problem, e.theta)
        why = f"; {told}" if told else ""
        return Verdict(Identifiability.UNINFORMATIVE, f"the data allow every value in the range searched{why}")
    return None


def _only_limits(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    """Fronts without arrest alone, all of them met: they have no best value."""
    problem = e.problem
    bound = problem.parameters.free[j].name in STIFFNESSES and not problem.gauged and set(e.measurements.kind) == {"at_least"}
    if not bound or len(profiled[LEVELS[-1]]) != 1 or (problem.predict(e.theta)[0] < e.measurements.length).any():
        return None
    equal = Verdict(Identifiability.EQUAL, "every value in the interval gives lengths that are long enough")
    return _open(e, j, profiled) or equal


def _misfit(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    if _above_maximum(e) or e.p_value is None or e.p_value >= IMPROBABLE:
        return None  # `_beyond_maximum` is more precise
    end = _end(e, j)
    at = f" (the best fit lies at its {end} end)" if end else ""
    return Verdict(
        Identifiability.POOR_FIT,
        f"{e.problem.named_deviance} is {format_number(e.misfit, 3)}{of_inputs_in_words(e.problem, e.theta)} for "
        f"{degrees_of_freedom(e.problem, e.testable_dof)}: with the stated σ nothing in the range searched{at} gives these "
        "measurements, so no uncertainty is given",
    )


def of_inputs_in_words(problem: Problem, theta: np.ndarray) -> str:
    """State the part of χ² that is no residual of a measurement, but of inputs fitted within their errors; empty if none."""
    part = float((problem.prior_weight * (theta - problem.prior_mean[0]) ** 2).sum())
    return f" ({part:.3g} of it from inputs fitted within their errors)" if f"{part:.2f}" != "0.00" else ""


def degrees_of_freedom(problem: Problem, dof: int | None) -> str:
    """``5 degrees of freedom``; ``at most 5`` where `Problem.testable` gives a bound."""
    count = dof or 0
    return "at most " * (count > problem.known - problem.p) + f"{plural(count, 'degree')} of freedom"


def _no_scatter(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    if e.closest is None:
        return None
    return Verdict(
        Identifiability.NO_SCATTER,
        f"the lengths lie within {e.closest:.1g} of themselves of the fit, closer than anyone measures: they were computed, or "
        "copied; give σ (column length_sigma or length_sigma_mm)",
    )


def _singular(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    bounded = any(not (piece.open_low and piece.open_high) for piece in profiled[LEVELS[-1]])
    if e.problem.p > 1 and e.roots and e.roots[0].singular[j] and not bounded:
        return Verdict(Identifiability.UNINFORMATIVE, undetermined(e.problem, e.theta))
    return None


def _above_maximum(e: Fitted) -> bool:
    # gauges determine stiffness where the length does not, and their fields bend from contact to contact;
    # interpolated lengths bend at their nodes too, so one of the lengths must be close to its longest
    if not e.roots or e.roots[0].share >= 0.5 or e.problem.gauged:
        return False
    predicted, m = e.problem.predict(e.roots[0].theta)[0], e.measurements
    met = (np.array(m.kind) == "at_least") & (predicted >= m.length)  # which says nothing of the longest
    return bool((~met & (predicted > PLATEAU * e.attainable)).any())


def _beyond_maximum(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    if not _above_maximum(e) or e.problem.parameters.free[j].name not in STIFFNESSES:
        return None
    over = e.problem.lengths.value[0] / e.attainable
    worst = int(np.argmax(over))
    return Verdict(
        Identifiability.AT_MAXIMUM,
        f"{e.measurements.number(worst)} is {over[worst]:.3g} times the longest that a stiffness in the range searched gives; "
        + UNCHANGED,
    )


def _at_an_end(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    end = _end(e, j)
    return Verdict(Identifiability.AT_BOUND, f"the {end} one") if end else None


def _end(e: Fitted, j: int) -> str:
    """The end of the range searched at which the best fit lies; empty if at neither."""
    q = e.problem.parameters
    reach = 1e-6 * (q.high[j] - q.low[j])
    ends = {"lower": q.low[j], "upper": q.high[j]}
    return next((end for end, at in ends.items() if abs(e.theta[j] - at) <= reach), "")


def _open(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    pieces = profiled[LEVELS[-1]]
    if any(piece.open_low or piece.open_high for piece in pieces):
        return Verdict(Identifiability.ONE_SIDED, "from above" if pieces[0].open_low else "from below")
    return None


def _not_alone(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    q, joined = e.problem.parameters, len(profiled[LEVELS[-1]]) == 1
    one = q.free[j]
    inner = [root.theta[j] for root in e.roots if q.low[j] < root.theta[j] < q.high[j]]
    values = sorted({float(f"{one.value(theta):.4g}") for theta in inner})
    near = 1e-3  # minima of one valley
    if joined and e.problem.gauged and e.roots and not e.roots[0].singular[j]:
        # one standard error where gauges were read, whose fields change in steps from contact to contact
        near = max(near, float(np.sqrt(e.rise(LEVELS[0]) * e.roots[0].covariance[j, j])))
    apart = [value for i, value in enumerate(values) if i == 0 or abs(one.theta(value) - one.theta(values[i - 1])) > near]
    if len(apart) < 2:
        return None
    named = f"{' and '.join(map(format_number, apart))} {one.unit}".rstrip()
    return Verdict(Identifiability.SEVERAL_ROOTS, f"the data fit at {named}" + "; the interval joins them" * joined)


def _not_normal(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    one, pieces = e.problem.parameters.free[j], profiled[LEVELS[0]]
    if not e.roots or e.roots[0].singular[j]:
        if len(profiled[LEVELS[-1]]) < 2:
            return Verdict(Identifiability.EQUAL, "a whole range of values fits equally well; use the intervals")
        return Verdict(Identifiability.SEVERAL_ROOTS, f"the data fit from {_ranges(one, profiled[LEVELS[-1]])}")
    if not pieces:
        return Verdict(Identifiability.SKEWED, "the likelihood has no interval at 68 %")
    error = np.sqrt(e.rise(LEVELS[0]) * e.roots[0].covariance[j, j])
    widths = [abs(end - e.theta[j]) / error for end in (pieces[0].low, pieces[-1].high)]
    if max(widths) < 0.5 and one.name in STIFFNESSES:
        longest = f"the measured length is almost the longest that any stiffness gives; {UNCHANGED}"
        return Verdict(Identifiability.AT_MAXIMUM, longest)
    if len(pieces) > 1 or max(widths) > 1.5 or min(widths) < 1 / 1.5:
        return Verdict(
            Identifiability.SKEWED,
            "the likelihood is far from a normal curve (its 68 % interval reaches "
            f"{widths[0]:.2g} and {widths[1]:.2g} curvature standard errors); use the intervals",
        )
    return None


def _not_covered(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    covered = e.covered.get(e.parameters.names[j], (1.0, 1.0))
    if all(share >= least for share, least in zip(covered, COVERED, strict=True)):
        return None
    return Verdict(
        Identifiability.SKEWED,
        f"in simulations of these measurements a standard error holds the truth in {covered[0]:.0%} of cases, 1.96 of them in "
        f"{covered[1]:.0%}; use the intervals",
    )


def _another_valley(e: Fitted, j: int, profiled: Intervals) -> Verdict | None:
    """Withhold a standard error where another valley, only slightly worse, lies far outside it."""
    best, one = e.minima[0], e.problem.parameters.free[j]
    far = 5 * np.sqrt(best.covariance[j, j])
    for other in e.minima[1:]:
        worse = other.deviance - e.deviance
        if other.deviance <= e.deviance + SLACK and abs(other.theta[j] - best.theta[j]) > far:
            value = f"{format_number(one.value(other.theta[j]))} {one.unit}".rstrip()
            reason = f"another valley, at {value}, is worse by a deviance of only {worse:.3g}; use the intervals"
            return Verdict(Identifiability.SKEWED, reason)
    return None


def _breaks_again(e: Fitted, j: int, pieces: list[Interval]) -> Verdict | None:
    """Test whether, at a value that is not excluded, the edge contact breaks again before the front stops."""
    q, curve = e.problem.parameters, e.curves[e.parameters.names[j]]
    if not pieces:
        return None
    value = np.concatenate([np.linspace(piece.low, piece.high, WITHIN) for piece in pieces])
    inputs = q.inputs_at(np.stack([np.interp(value, curve.node, column) for column in curve.theta.T], axis=1))
    rows = q.rows_of(j)
    again = q.front.breaks_again(inputs.ravel()).reshape(len(value), -1)[:, rows].any(axis=1)
    if not again.any():
        return None
    share = "everywhere in the 95 % interval" if again.all() else "within the 95 % interval"
    b = np.exp(inputs.log_b)[:, rows].max()
    return Verdict(
        Identifiability.REBREAKS,
        f"{share} (b up to {b:.3g}) the contact at the edge is back at its threshold before the front stops: the event then "
        "goes on, and the length fitted is that of the front alone",
    )


def _counted(e: Fitted, pieces: list[Interval], at_odds: list[int]) -> Verdict:
    """Whether one range of values, several or none give all counts."""
    m, one = e.measurements, e.problem.parameters.free[0]
    if not pieces:
        where = ", ".join(m.number(i) for i in at_odds)
        without = f"all counts; without {where} the others agree" if len(at_odds) < len(m) else "any of the counts"
        return Verdict(Identifiability.POOR_FIT, f"no value in the range searched gives {without}")
    if len(pieces) > 1:
        return Verdict(Identifiability.SEVERAL_ROOTS, f"the counts hold from {_ranges(one, pieces)}")
    if pieces[0].open_low and pieces[0].open_high:
        return Verdict(Identifiability.UNINFORMATIVE, "the counts hold everywhere in the range searched")
    equal = Verdict(Identifiability.EQUAL, "every value in the interval gives all counts")
    return _open(e, 0, {LEVELS[-1]: pieces}) or equal


def _ranges(one: Free, pieces: list[Interval]) -> str:
    each = (" to ".join(format_number(one.value(x)) for x in (piece.low, piece.high)) for piece in pieces)
    return f"{' and '.join(each)} {one.unit}".rstrip()


def directions(problem: Problem, theta: np.ndarray) -> list[dict[str, Any]]:
    """Combinations of the parameters by how well they are determined, best first: singular vectors of the scaled Jacobian.

    Each with the `combination` in words, as ``young / areal_stiffness^0.98``, the `stderr` with which data and priors give it,
    inf where nothing does, and its `coefficients`, a vector of length 1. Every positive parameter counts by its logarithm,
    every other over the range searched for it. Two parameters that only ever act together have one direction with a finite
    error, and one without.
    """
    q = problem.parameters
    unit = np.array([1.0 if one.log else one.high - one.low for one in q.free])
    _, jacobian = problem.information(theta)
    _, values, vectors = np.linalg.svd(jacobian * unit, full_matrices=False)
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
    """Describe the combinations of parameters that the data leave open; empty where there is none."""
    if problem.p == 1:
        return ""
    found = directions(problem, theta)
    reach = max((one.high - one.low) if one.log else 1.0 for one in problem.parameters.free)
    known, lost = ([one["combination"] for one in found if (one["stderr"] > reach / 4) == left] for left in (False, True))
    if not lost:
        return ""
    told = f"only {', '.join(known)} is determined" if known else "no combination is determined"
    return f"{told}; the data do not determine {', '.join(lost)}"
