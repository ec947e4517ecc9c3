"""Verdicts: whether the data determine each parameter, and if not, why not and what they do determine."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.inference.fitted import LEVELS, Fitted, Identifiability, Verdict
from slippulse_jax.inference.intervals import Interval, Intervals
from slippulse_jax.inference.likelihood import IMPROBABLE, Problem
from slippulse_jax.inference.parameters import STIFFNESSES, Free, ParameterSet
from slippulse_jax.inference.search import SLACK
from slippulse_jax.shown import TIED, format_number, listed, plural

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
    pieces = profiled[LEVELS[-1]]
    if at_odds is None:
        withheld = itertools.chain(_of_fit(e, j), _of_range(e, j, pieces), _of_shape(e, j, profiled))
    else:
        withheld = _of_counts(e, pieces, at_odds)
    verdict = next(withheld, Verdict(Identifiability.IDENTIFIED))
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


def _of_fit(e: Fitted, j: int) -> Iterator[Verdict]:
    """Withhold a number where the search or the fit as a whole failed."""
    if e.unconverged:
        yield Verdict(Identifiability.NOT_CONVERGED, f"a start {e.unconverged[0]}")
    if not e.problem.predict(e.theta).any():
        yield Verdict(Identifiability.UNINFORMATIVE, "nothing in the range searched starts a domino: every length is zero")
    if e.p_value is not None and e.p_value < IMPROBABLE and not _above_maximum(e):  # of which `_of_range` says more
        at = f" (the best fit lies at its {end} end)" if (end := _end(e, j)) else ""
        misfit = f"{format_number(e.misfit, 3)}{of_inputs_in_words(e.problem, e.theta)}{tested(e)}"
        yield Verdict(
            Identifiability.POOR_FIT,
            f"{e.problem.named_deviance} is {misfit}: with the stated σ nothing in the range searched{at} gives these "
            "measurements, so no uncertainty is given",
        )


def _of_range(e: Fitted, j: int, pieces: list[Interval]) -> Iterator[Verdict]:
    """Withhold a number where the range searched or the longest attainable length bounds it, not the data."""
    problem, m, stiff = e.problem, e.measurements, e.parameters.free[j].name in STIFFNESSES
    every = [piece.open_low and piece.open_high for piece in pieces]
    if every == [True]:
        told = undetermined(problem, e.theta)
        why = f"the data allow every value in the range searched{'; ' * bool(told)}{told}"
        yield Verdict(Identifiability.UNINFORMATIVE, why)
    limits = stiff and not problem.gauged and {*m.kind} == {"at_least"}  # which have no best value where all are met
    if limits and len(pieces) == 1 and (problem.predict(e.theta)[0] >= m.length).all():
        yield from _open(pieces)
        yield Verdict(Identifiability.EQUAL, "every value in the interval gives lengths that are long enough")
    if end := _end(e, j):
        yield Verdict(Identifiability.AT_BOUND, f"the {end} one; give wider bounds")
    if problem.p > 1 and e.roots and e.roots[0].singular[j] and all(every):
        yield Verdict(Identifiability.UNINFORMATIVE, undetermined(problem, e.theta))
    if stiff and _above_maximum(e):
        over = problem.lengths.value[0] / e.attainable
        worst = int(np.argmax(over))
        times = f"{over[worst]:.3g} times the longest that a stiffness in the range searched gives"
        yield Verdict(Identifiability.AT_MAXIMUM, f"{m.number(worst)} is {times}; {UNCHANGED}")
    if e.closest is not None:
        yield Verdict(
            Identifiability.NO_SCATTER,
            f"the lengths lie within {e.closest:.1g} of themselves of the fit, closer than anyone measures: they were "
            "computed, or copied; give σ, in column length_sigma or length_sigma_mm",
        )


def _of_shape(e: Fitted, j: int, profiled: Intervals) -> Iterator[Verdict]:
    """Withhold a standard error where the likelihood of the parameter is far from a normal curve."""
    yield from _several(e, j, profiled[LEVELS[-1]])
    yield from _open(profiled[LEVELS[-1]])
    yield from _not_normal(e, j, profiled)
    covered = e.covered.get(e.parameters.names[j], (1.0, 1.0))
    if any(share < least for share, least in zip(covered, COVERED, strict=True)):
        yield Verdict(
            Identifiability.SKEWED,
            f"in simulations of these measurements a standard error holds the truth in {covered[0]:.0%} of cases, 1.96 of them "
            f"in {covered[1]:.0%}; use the intervals",
        )
    best, one = e.minima[0], e.parameters.free[j]
    far = 5 * np.sqrt(best.covariance[j, j])
    for other in e.minima[1:]:  # another valley, only slightly worse, far outside the standard error
        if other.deviance <= e.deviance + SLACK and abs(other.theta[j] - best.theta[j]) > far:
            value, worse = f"{format_number(one.value(other.theta[j]))} {one.unit}".rstrip(), other.deviance - e.deviance
            reason = f"another valley, at {value}, is worse by a deviance of only {worse:.3g}; use the intervals"
            yield Verdict(Identifiability.SKEWED, reason)


def of_inputs_in_words(problem: Problem, theta: np.ndarray) -> str:
    """State the part of χ² from inputs fitted within their errors and from priors, which is no residual; empty if none."""
    parts = problem.prior_weight * (theta - problem.prior_mean[0]) ** 2
    pulled = dict.fromkeys(one.symbol for one, x in zip(problem.parameters.free, parts, strict=True) if x > 0.1 * parts.sum())
    return f" ({parts.sum():.3g} of it from the fitted {listed([*pulled])})" if f"{parts.sum():.2f}" != "0.00" else ""


def tested(e: Fitted) -> str:
    """`` for 5 degrees of freedom (p = 0.82)``; the probability alone where `Problem.testable` gives a bound on it."""
    p = "p < 1e-300" if not e.p_value or e.p_value < 1e-300 else f"p = {e.p_value:.2g}".replace("e-0", "e-")
    p = p.replace(" ", TIED)
    if (e.testable_dof or 0) > e.problem.known - e.problem.p:
        return f" ({p.replace('=', 'at most')})"
    return f" for {plural(e.testable_dof or 0, 'degree')} of freedom ({p})"


def _above_maximum(e: Fitted) -> bool:
    # gauges determine stiffness where the length does not, and their fields bend from contact to contact;
    # interpolated lengths bend at their nodes too, so one of the lengths must be close to its longest
    if not e.roots or e.roots[0].share >= 0.5 or e.problem.gauged:
        return False
    predicted, m = e.problem.predict(e.roots[0].theta)[0], e.measurements
    met = (np.array(m.kind) == "at_least") & (predicted >= m.length)  # which says nothing of the longest
    return bool((~met & (predicted > PLATEAU * e.attainable)).any())


def _end(e: Fitted, j: int) -> str:
    """The end of the range searched at which the best fit lies; empty if at neither."""
    q = e.problem.parameters
    reach = 1e-6 * (q.high[j] - q.low[j])
    ends = {"lower": q.low[j], "upper": q.high[j]}
    return next((end for end, at in ends.items() if abs(e.theta[j] - at) <= reach), "")


def _open(pieces: list[Interval]) -> Iterator[Verdict]:
    if any(piece.open_low or piece.open_high for piece in pieces):
        yield Verdict(Identifiability.ONE_SIDED, "from above" if pieces[0].open_low else "from below")


def _several(e: Fitted, j: int, pieces: list[Interval]) -> Iterator[Verdict]:
    """Name the values of the minima that are not of one valley."""
    one, joined = e.parameters.free[j], len(pieces) == 1
    values = sorted({float(f"{one.value(root.theta[j]):.4g}") for root in e.roots if one.low < root.theta[j] < one.high})
    near = 1e-3
    if joined and e.problem.gauged and e.roots and not e.roots[0].singular[j]:
        # one standard error where gauges were read, whose fields change in steps from contact to contact
        near = max(near, float(np.sqrt(e.rise(LEVELS[0]) * e.roots[0].covariance[j, j])))
    apart = [value for i, value in enumerate(values) if i == 0 or abs(one.theta(value) - one.theta(values[i - 1])) > near]
    if len(apart) > 1:
        named = f"{' and '.join(map(format_number, apart))} {one.unit}".rstrip()
        yield Verdict(Identifiability.SEVERAL_ROOTS, f"the data fit at {named}" + "; the interval joins them" * joined)


def _not_normal(e: Fitted, j: int, profiled: Intervals) -> Iterator[Verdict]:
    """Compare the 68 % interval with the standard error of the curvature."""
    one, inner, pieces = e.parameters.free[j], profiled[LEVELS[0]], profiled[LEVELS[-1]]
    if not e.roots or e.roots[0].singular[j]:
        if len(pieces) > 1:
            yield Verdict(Identifiability.SEVERAL_ROOTS, f"the data fit from {_ranges(one, pieces)}")
        yield Verdict(Identifiability.EQUAL, "a whole range of values fits equally well; use the intervals")
    elif not inner:
        yield Verdict(Identifiability.SKEWED, "the likelihood has no interval at 68 %")
    else:
        error = np.sqrt(e.rise(LEVELS[0]) * e.roots[0].covariance[j, j])
        widths = [abs(end - e.theta[j]) / error for end in (inner[0].low, inner[-1].high)]
        if max(widths) < 0.5 and one.name in STIFFNESSES:
            longest = f"the measured length is almost the longest that any stiffness gives; {UNCHANGED}"
            yield Verdict(Identifiability.AT_MAXIMUM, longest)
        if len(inner) > 1 or max(widths) > 1.5 or min(widths) < 1 / 1.5:
            reach = f"its 68 % interval reaches {widths[0]:.2g} and {widths[1]:.2g} curvature standard errors"
            yield Verdict(Identifiability.SKEWED, f"the likelihood is far from a normal curve ({reach}); use the intervals")


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
        f"{share} (b up to {b:.3g}) the contact at the edge is back at its threshold before the front stops; {whole_events(e)}",
    )


def whole_events(e: Fitted) -> str:
    """Say how whole events are fitted, of which the first front is a part."""
    m = e.measurements
    if m.gauges is not None or m.block_length is not None or m.machine_stiffness is not None:
        return "a fit of whole events takes no gauges, ends or machines"
    return "if whole events were measured, give " + m.option("--event full", 'event="full"')


def _of_counts(e: Fitted, pieces: list[Interval], at_odds: list[int]) -> Iterator[Verdict]:
    """Whether one range of values, several or none give all counts."""
    m = e.measurements
    if not pieces:
        where = ", ".join(m.number(i) for i in at_odds)
        without = f"all counts; without {where} the others agree" if len(at_odds) < len(m) else "any of the counts"
        yield Verdict(Identifiability.POOR_FIT, f"no value in the range searched gives {without}")
    if len(pieces) > 1:
        yield Verdict(Identifiability.SEVERAL_ROOTS, f"the counts hold from {_ranges(e.parameters.free[0], pieces)}")
    if pieces[0].open_low and pieces[0].open_high:
        yield Verdict(Identifiability.UNINFORMATIVE, "the counts hold everywhere in the range searched")
    yield from _open(pieces)
    yield Verdict(Identifiability.EQUAL, "every value in the interval gives all counts")


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
