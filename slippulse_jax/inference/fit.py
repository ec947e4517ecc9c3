"""The fit: every minimum, profile-likelihood intervals, a verdict on each parameter."""

import dataclasses
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from tqdm.auto import tqdm

from slippulse_jax.base.domains import check_choice, check_whole
from slippulse_jax.base.status import NotConverged
from slippulse_jax.inference.choices import Body, IntervalsBy, Loss, MeasuredEvent, Method, Sigma
from slippulse_jax.inference.model.front import Front
from slippulse_jax.inference.model.models import front_of
from slippulse_jax.inference.observables import Observable
from slippulse_jax.inference.parameters import (
    STIFFNESSES,
    Parameter,
    checked,
    suspicions,
    wanted_parameters,
    where_contacts_differ,
    with_errors_of_measuring,
)
from slippulse_jax.inference.result import record
from slippulse_jax.inference.result.result import FitResult
from slippulse_jax.inference.result.verdict import judge
from slippulse_jax.inference.search.intervals import (
    LEVELS,
    Intervals,
    allowed,
    calibrated,
    can_be_calibrated,
    crossed,
    deviances,
    integrated,
    profile,
    rise_of,
    to_be_simulated,
)
from slippulse_jax.inference.search.learning import (
    OUTWARDS,
    check_model_error,
    learnt,
    narrowed,
    outwards,
    pruned,
    sized,
    within_reach,
)
from slippulse_jax.inference.search.likelihood import Problem, make_problem
from slippulse_jax.inference.search.minima import (
    SLACK,
    Curve,
    DevianceGrid,
    Found,
    Root,
    between_contacts,
    first_look,
    ordered,
    same,
    scaled_to_scatter,
    search,
)
from slippulse_jax.inference.table.measurements import Measurements, MeasurementWarning, measurements_of

if TYPE_CHECKING:
    import pandas as pd

MOST_ROOTS = 4  # from which a profile is started
SEARCH_ROUNDS = 3  # the search is repeated where a profile finds a lower deviance
SOFTER = 17  # starts below a stiffness at which a contact breaks again


def fit(
    measurements: "Measurements | pd.DataFrame | str | os.PathLike[str]",
    free: str | Parameter | Sequence[str | Parameter] | None = None,
    *,
    bounds: tuple[float, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    loss: Loss = "normal",
    sigma: Sigma = "absolute",
    method: Method = "lm",
    max_steps: int = 60,
    seed: int = 0,
    intervals: IntervalsBy = "auto",
    event: MeasuredEvent | Front | None = None,
    body: Body | None = None,
    model_error: float | Literal["fitted"] | None = None,
    observables: Sequence[Observable] = (),
) -> FitResult:
    """Fit the interface to measured first precursors.

    The model is the length ℓ of the first precursor on a slider, as `precursor_length` has it, or the length of the whole event
    on a block whose push is stated, or the forces of its events up to sliding. The deviance −2 ln(likelihood × prior), which is
    χ² for plain lengths, is minimised from many starts at once. The intervals are profile-likelihood intervals, in as many
    disjoint pieces as there are.

    Parameters
    ----------
    measurements : Measurements, pandas.DataFrame or path
        From `read_measurements`, or built from arrays; or a table with the columns of `read_measurements`, or its CSV file.
    free : str, Parameter, or sequence of them, optional
        Parameters to fit, by the names of `slippulse_jax.inference.parameters.PARAMETERS`. By default the stiffness, and
        of a sequence friction and normal load where the table does not state them. "stiffness" is k/K where
        lengths are in λc, the areal stiffness k/λc² where they are in SI. A `Parameter` adds bounds, a prior, one value per
        specimen. Inputs that come with an error of their own are fitted beside them, with that error as prior; beside what
        was measured or digitised also the scatter of thresholds, a "model_factor" and, where lengths have σ, an "offset"
        (`with_errors_of_measuring`), unless they are named or held. `fixed={"threshold_scatter": 0}` takes contacts as alike.
    bounds : (float, float), optional
        Range of the stiffness searched, in the unit of the result. By default everything from where no domino starts up to
        k/K = 1.
    fixed : dict, optional
        Values of parameters that are neither fitted nor stated with the measurements, as {"prestress": 0.1}.
    loss : {"normal", "student"}
        Loss function of the residuals; Student's, with 4 degrees of freedom, is robust against outliers.
    sigma : {"absolute", "relative"}
        The stated σ are standard errors; or only their ratios are used, and their size is taken from the scatter. Measurements
        without σ are fitted as if "relative" with equal errors, and the report says so.
    method : {"lm", "lbfgs", "adam"}
        Levenberg and Marquardt's; or optax's L-BFGS or Adam.
    max_steps : int
        Steps allowed per start; five times as many beside counts and limits without an error.
    seed : int
        Seed of the starts where several parameters are fitted, and of simulations.
    intervals : {"auto", "profile", "calibrated"}
        Rises of the deviance from χ²; or from measurements simulated at every value, which keep their coverage near the
        longest attainable length too (`slippulse_jax.inference.search.intervals`; one parameter, plain lengths). By
        default simulated where valleys of the deviance compete, or its shape is far from a parabola.
    event : {"domino", "full", "crack", "sequence"} or Front
        What was measured: the first front; or the whole event, in which contacts may break again where the areal stiffness is
        large (`rebreaking_onset`), with a cost that grows with it (docs/appendix/method.md), for lengths without gauges; or
        the front of a crack, behind which contacts slide at a "friction" that is fitted or held (docs/model/beyond.md); or a
        sequence, the forces at which the front of a block first reaches each place up to sliding (docs/fit/sequence.md). By
        default "domino" of a slider, and of a block "sequence" where it has forces, else "full". Or a model of one's own, a
        `Front` (docs/howto/extend.md).
    body : {"slider", "block"}
        The paper's slider; or a block under two-dimensional elasticity, pushed where `measurements` say (docs/model/block.md):
        taken by default where they say so for every line.
    model_error : float or "fitted", optional
        Of the forces of sequences: what the model leaves out, in μF_N; or taken from how far the forces lie from the fit, so
        that χ² is what is expected, and tests nothing. By default nothing beyond how far single series scatter.
    observables : sequence of Observable, optional
        Kinds of data of one's own, beside those of the model (docs/howto/extend.md).

    Returns
    -------
    FitResult
        Look at `identifiability` first: where the data do not determine a number, the result says why.

    Raises
    ------
    ValueError
        If an argument has no meaning for these measurements; the message names it.

    Warns
    -----
    MeasurementWarning
        Where a column seems to be in another unit than its name says, or two to be exchanged.
    """
    arguments = locals().copy()
    measurements = measurements_of(measurements)
    size_known = sigma == "absolute" and loss == "normal" and measurements.length_sigma is not None
    front = front_of(measurements, event, body)
    front = where_contacts_differ(front, measurements, event, free, fixed, size_known=size_known)
    wanted = wanted_parameters(measurements, free, bounds, fixed, front)
    suspected = suspicions(measurements, wanted, front)
    for mistake in suspected:
        warnings.warn(mistake, MeasurementWarning, stacklevel=2)
    choices = {"loss": (loss, Loss), "method": (method, Method), "sigma": (sigma, Sigma), "intervals": (intervals, IntervalsBy)}
    for name, (value, known) in choices.items():
        check_choice(name, value, known)
    check_whole("max_steps", max_steps, 1)
    check_whole("seed", seed, 0)
    scaled = _is_scaled(measurements, front, sigma)
    every = with_errors_of_measuring(measurements, wanted, front, size_known=not scaled)
    problem = make_problem(measurements, checked(measurements, every, front, None, loss, observables))
    _check_scaled(problem, scaled)
    _check_calibrated(problem, intervals, scaled)
    check_model_error(problem, model_error)
    options: dict[str, Any] = {"method": method, "max_steps": max_steps, "seed": seed}
    whole = problem.parameters
    if scaled:
        explored = _by_scatter(problem, **options)
    elif problem.emulates:
        explored = _by_learning(problem, model_error, **options)
    else:
        explored = _by_search(problem, **options)
    problem, found, between = explored.problem, explored.found, explored.between
    if problem.emulates:
        problem = dataclasses.replace(problem, simulated=deviances(problem, found.theta))
    limits = {level: found.deviance + rise_of(level, dof=found.scatter_dof) for level in LEVELS}
    profiled = {
        j: crossed(curve, limits) if _integrated(problem) else allowed(problem, j, curve, limits)
        for j, curve in found.curves.items()
    }
    simulated: dict[int, tuple[Intervals, tuple[float, float]]] = {}
    if not scaled and to_be_simulated(problem, intervals, found, profiled):
        with _progress(problem) as shown:
            simulated = {0: calibrated(shown, seed)}
    problem = dataclasses.replace(problem, parameters=whole)  # and not only where a model was followed
    longest, longest_at = problem.parameters.attainable(found.theta)
    unconverged = [start for start in found.unconverged if start[0] <= limits[LEVELS[-1]]]
    found = found._replace(
        unconverged=unconverged,
        roots=tuple(root for root in found.minima if root.deviance <= limits[LEVELS[-1]]),
        testable_dof=None if scaled else problem.testable(found.theta),
        attainable=longest,
        covered={j: shares for j, (_, shares) in simulated.items()},
    )
    names = {j: problem.parameters.names[j] for j in profiled}
    judged = {
        names[j]: judge(problem, found, j, pieces, simulated[j][0] if simulated else pieces) for j, pieces in profiled.items()
    }
    return FitResult(
        measurements=measurements,
        problem=problem,
        request={"free": wanted} | {name: x for name, x in arguments.items() if name in record.SETTINGS and x != ()},
        theta=found.theta,
        deviance=found.deviance,
        minima=found.minima,
        curves={names[j]: curve for j, curve in found.curves.items()},
        intervals=_in_units(problem, found.theta, {name: trusted for name, (_, trusted) in judged.items()}),
        verdicts={name: verdict for name, (verdict, _) in judged.items()},
        scatter=found.scatter,
        scatter_dof=found.scatter_dof,
        closest=found.closest,
        testable_dof=found.testable_dof,
        unconverged=[message for _, message in unconverged],
        attainable=longest,
        attainable_at=longest_at,
        between_contacts=between,
        covered={names[j]: shares for j, shares in found.covered.items()},
        suspicions=suspected,
    )


def _is_scaled(m: Measurements, front: Front, sigma: Sigma) -> bool:
    """Test whether the scatter gives the size of errors.

    It does if asked for, or where lengths have none.
    """
    lengths = "length" in front.observes
    if sigma == "relative" and not lengths:
        raise ValueError(
            "sigma = 'relative': a sequence has errors of the model too: model_error = \"fitted\" takes their size"
        )
    scaled = lengths and (sigma == "relative" or m.length_sigma is None)
    if scaled and front.drawn:
        raise ValueError(
            f"{m.source}: the spread of lengths is to say how thresholds scatter, and cannot give the size of errors too: give "
            "their standard errors of reading"
        )
    return scaled


class Explored(NamedTuple):
    """A problem with the errors that were used, and what was found."""

    problem: Problem
    found: Found
    between: np.ndarray | None = None  # error of each length by interpolation, in λc


def _by_search(problem: Problem, **options: Any) -> Explored:
    """Search with the stated σ, and errors of interpolated lengths."""
    between = between_contacts(problem, options["seed"])
    problem = problem if between is None else problem.widened(between)
    with _progress(problem) as shown:
        return Explored(problem, _explore(shown, **options), between)


def _by_learning(problem: Problem, model_error: float | str | None, **options: Any) -> Explored:
    """Follow the model where data may be met, until profiles rise."""
    problem, turn = learnt(problem, options["seed"], model_error), 0
    if problem.through is None:  # of draws, all at once
        with _progress(problem) as shown:
            if not _integrated(problem):
                return Explored(problem, _explore(shown, **options))
            found = search(shown, **options)
            lost = [one for one in found.unconverged if not found.minima]
            asked = [j for j, one in enumerate(problem.parameters.free) if not one.nuisance]
            return Explored(problem, found._replace(unconverged=lost, curves={j: integrated(shown, j, found) for j in asked}))
    while True:
        near = narrowed(sized(problem) if model_error == "fitted" else problem)
        with _progress(near) as shown:
            found = _explore(shown, turns=1, **options)  # an emulator has no minima between its points
        found = found if near.known else found._replace(scatter_dof=max(problem.count - problem.p, 1))
        limit = found.deviance + rise_of(LEVELS[-1], dof=found.scatter_dof)
        more = outwards(problem, found.curves, limit, options["seed"] + turn) if turn < OUTWARDS else None
        if more is None:
            known = {j: within_reach(curve) for j, curve in found.curves.items()}
            return Explored(pruned(near), found._replace(curves=known))
        problem, turn = more, turn + 1


def _integrated(problem: Problem) -> bool:
    """Whether profiles are integrated over the scatter of contacts."""
    q = problem.parameters
    return q.front.drawn and problem.p > 1 and "threshold_scatter" in q.names


@contextmanager
def _progress(problem: Problem) -> Iterator[Problem]:
    """Show a progress bar; on a terminal at once, before compiling."""
    delay = 0 if sys.stderr is not None and sys.stderr.isatty() else 2
    with tqdm(desc="fit (the first compiles)", unit=" lengths", unit_scale=True, delay=delay, leave=False, disable=None) as bar:
        yield dataclasses.replace(problem, tick=bar.update)


def _in_units(problem: Problem, best: np.ndarray, pieces: dict[str, Intervals]) -> dict[str, Intervals]:
    """Convert intervals to units, and add k/K where that is proportional."""
    q = problem.parameters

    def converted(found: Intervals, unit: Callable[[float], float]) -> Intervals:
        return {level: [p._replace(low=unit(p.low), high=unit(p.high)) for p in every] for level, every in found.items()}

    result = {name: converted(found, q.named(name).value) for name, found in pieces.items()}
    moving, ratio = np.flatnonzero(q.inputs.log_stiffness.slope[0]), q.common_ratio(best)
    if ratio is not None and "stiffness" not in result and len(moving) == 1 and q.names[moving[0]] in result:
        moves = int(moving[0])
        factor = ratio / q.free[moves].value(best[moves])
        result["stiffness"] = converted(result[q.names[moves]], lambda x: x * factor)
    return result


def _check_scaled(problem: Problem, scaled: bool) -> None:
    if not scaled:
        return
    copies = len(problem.measurements) - problem.measurements.distinct
    if problem.count - copies <= problem.p:
        different = f", of which {copies} repeat another one exactly," if copies else ""
        raise ValueError(
            f"{problem.count} data{different} for {problem.p} fitted parameters: no size of errors can be taken from the "
            "scatter; give σ"
        )
    if not problem.exact_values:
        raise ValueError("sigma = 'relative': counts and fronts without arrest have no scatter to take a size from; give σ")


def _check_calibrated(problem: Problem, intervals: str, scaled: bool) -> None:
    if intervals != "calibrated":
        return
    if scaled:
        raise ValueError("calibrated intervals need absolute standard errors: sigma = 'absolute'")
    if not can_be_calibrated(problem):
        raise ValueError("calibrated intervals: for one parameter, and values with Gaussian errors")


def _by_scatter(problem: Problem, **options: Any) -> Explored:
    """Search with σ scaled to the scatter about the best fit known."""
    theta, rounds, of_lengths = first_look(problem, options["seed"]), 0, problem.measurements.length_sigma is None
    while True:
        scaled, near = scaled_to_scatter(problem, theta, of_lengths=of_lengths)
        with _progress(scaled) as shown:
            found = _explore(shown, **options)
        rounds += 1
        if found.deviance >= near.deviance - 1e-3 or rounds == SEARCH_ROUNDS:
            sizes = {name: getattr(near, name) for name in ("scatter", "scatter_dof", "closest")}
            return Explored(scaled, found._replace(**sizes))
        theta = found.theta


def _explore(problem: Problem, turns: int = SEARCH_ROUNDS, **options: Any) -> Found:
    """Search and follow profiles in turns, until neither finds more."""
    asked = [j for j, one in enumerate(problem.parameters.free) if not one.nuisance]
    found = search(problem, **options)
    if not np.isfinite(found.deviance) or not problem.predict(found.theta).any():
        q, share = problem.parameters, np.linspace(0, 1, SOFTER)[:, None]
        if np.isnan(problem.predictions(q.low + share * (q.high - q.low))).any():
            raise NotConverged("no event of the range searched that could be followed is like these: give other bounds")
    if not np.isfinite(found.deviance):
        raise ValueError("the front never stops anywhere in the range searched: these measurements cannot come from this model")
    roots, best, deviance = found.minima, found.theta, found.deviance
    if roots and all(root.rebreaks for root in roots):
        roots = _merged(problem, roots, _softer(problem, roots[0], **options))
    curves: dict[int, Curve] = {}
    for _ in range(turns):
        roots = ordered(problem, roots)
        curves = {j: profile(problem, j, roots[:MOST_ROOTS], found.theta[None], found.grid) for j in asked}
        best, deviance = _lowest(roots, curves, best, deviance)
        missed = [
            curve.theta[i]
            for curve in curves.values()
            for i in np.flatnonzero(DevianceGrid(curve.theta, curve.deviance).lows()).tolist()
            if 0 < i < len(curve.node) - 1
            and curve.deviance[i] < deviance + SLACK
            and not any(curve.deviance[i] >= root.deviance - 1e-6 and _near(curve, i, root) for root in roots)
        ]
        missed += _crossed(roots[:MOST_ROOTS])
        before = len(roots)
        if missed:
            roots = _merged(problem, roots, search(problem, extra=np.array(missed), **options).minima)
        if len(roots) == before:
            break
    known = [root.deviance for root in roots]
    lost = [(value, message) for value, message in found.unconverged if not known or value < min(known) - 1e-6]
    return Found(roots, best, deviance, lost, found.grid, curves)


def _softer(problem: Problem, stiff: Root, **options: Any) -> list[Root]:
    """Find accepted minima below a stiff one where contacts break again."""
    q = problem.parameters
    moved = np.array([one.name in STIFFNESSES for one in q.free])
    below = q.low + np.linspace(0, 1, SOFTER)[:-1, None] * (stiff.theta - q.low)
    found = search(problem, extra=np.where(moved, below, stiff.theta), **options).minima if moved.any() else []
    return [root for root in found if not root.rebreaks and problem.accepts(root.theta, root.deviance, stiff.deviance + SLACK)]


def _crossed(roots: list[Root]) -> list[np.ndarray]:
    """Combine each root with one coordinate of another."""
    pairs = [(a.theta, b.theta) for a in roots for b in roots if a is not b]
    return [np.where(np.arange(len(a)) == j, b, a) for a, b in pairs for j in range(len(a)) if len(a) > 1]


def _near(curve: Curve, i: int, root: Root) -> bool:
    """Whether a root lies between the two neighbours of node i."""
    j = int(np.argmin(np.abs(curve.theta[i] - curve.node[i])))
    return bool(curve.node[i - 1] <= root.theta[j] <= curve.node[i + 1])


def _lowest(roots: list[Root], curves: dict[int, Curve], best: np.ndarray, deviance: float) -> tuple[np.ndarray, float]:
    """Return the first root, or a lower point of a profile."""
    for curve in curves.values():
        i = int(np.argmin(curve.deviance))
        if curve.deviance[i] < deviance - 1e-9 * max(1.0, abs(deviance)):
            best, deviance = curve.theta[i], float(curve.deviance[i])
    if roots and min(root.deviance for root in roots) <= deviance + 1e-6 * max(1.0, abs(deviance)):
        return roots[0].theta, roots[0].deviance
    return best, deviance


def _merged(problem: Problem, roots: list[Root], more: list[Root]) -> list[Root]:
    kept = list(roots)
    for one in more:
        if not any(same(one.theta, one.deviance, other, problem) for other in kept):
            kept.append(one)
    return ordered(problem, kept)
