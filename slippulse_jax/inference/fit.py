"""The fit: every minimum of the deviance, profile-likelihood intervals, and a verdict on each parameter."""

import dataclasses
import functools
import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from tqdm.auto import tqdm

from slippulse_jax.domains import check_choice, check_whole
from slippulse_jax.files import write_atomically
from slippulse_jax.inference import predicted, record, report
from slippulse_jax.inference.changes import Change, changes, next_steps, total, total_interval
from slippulse_jax.inference.check import suspicions
from slippulse_jax.inference.choices import Body, IntervalsBy, Loss, MeasuredEvent, Method, Sigma
from slippulse_jax.inference.fitted import LEVELS, Fitted
from slippulse_jax.inference.intervals import (
    Curve,
    Interval,
    Intervals,
    allowed,
    allowed_by_counts,
    calibrated,
    can_be_calibrated,
    profile,
    rise_of,
    to_be_simulated,
)
from slippulse_jax.inference.likelihood import Problem, make_problem
from slippulse_jax.inference.measurements import Measurements, MeasurementWarning, measurements_of
from slippulse_jax.inference.objective import problem_of
from slippulse_jax.inference.parameters import STIFFNESSES, Parameter, attainable, wanted_parameters
from slippulse_jax.inference.samples import Bootstrap, Samples, bootstrap, posterior
from slippulse_jax.inference.search import (
    SLACK,
    Found,
    Root,
    between_contacts,
    describe,
    first_look,
    grid_of,
    ordered,
    same,
    scaled_to_scatter,
    search,
)
from slippulse_jax.inference.verdict import directions, judge

if TYPE_CHECKING:
    import pandas as pd

MOST_ROOTS = 4  # from which a profile is started
SEARCH_ROUNDS = 3  # the search is repeated where a profile finds a lower deviance
SOFTER = 17  # starts below a stiffness at which a contact breaks again


class FitResult(Fitted):
    """Result of `fit`. Start with `report()`, `identifiability` and `intervals`.

    What else would move it (`changes`, `next_steps`) is found by fitting again, once, when it is first asked for: by one of
    these names, or by `report`, `str`, `to_dict` and `save`, which contain them. A result that `load_fit` reads has them.
    """

    @functools.cached_property
    def changes(self) -> list[Change]:
        """Changes of inputs, ends, pushes and bodies that would move the parameters, and how far; largest first."""
        return changes(self)

    @functools.cached_property
    def next_steps(self) -> list[str]:
        """Suggestions with their options: what a rejected fit lacks, or errors of inputs that specimens may share."""
        return next_steps(self)

    @property
    def stderrs_with_inputs(self) -> dict[str, float | None]:
        """Standard errors with usual errors of inputs taken as exact (`changes`); None as in `stderrs`."""
        return {name: total(self, name, self.changes) for name in self.names}

    @property
    def errors_with_inputs(self) -> dict[str, tuple[float, float] | None]:
        """Errors to publish, below and above each value, with usual errors of inputs; None where there is no value.

        The sides of the 68 % interval, each widened by the errors of inputs taken as exact; else the standard error twice.
        """
        found: dict[str, tuple[float, float] | None] = dict.fromkeys(self.names)
        for name in self.given:
            value, error = self.values[name], self.stderrs_with_inputs[name]
            piece = total_interval(self, name, self.changes)
            found[name] = None if error is None else (error, error)
            if piece is not None and piece.encloses(value):
                found[name] = value - piece.low, piece.high - value
        return found

    @functools.cached_property
    def directions(self) -> list[dict[str, Any]]:
        """Combinations of the parameters by how well they are determined: `combination`, `stderr` and `coefficients`."""
        return directions(self.problem, self.theta)

    def curve(
        self,
        rows: "int | Sequence[int] | np.ndarray",
        heights: ArrayLike,
        theta: np.ndarray | None = None,
        *,
        along: predicted.Along = "height",
    ) -> predicted.LengthCurve:
        """Predict the lengths of measurements like some of these at other heights.

        Parameters
        ----------
        rows : int or sequence of int
            Measurements that they are like: every other input is the mean of theirs.
        heights : array_like, shape (n,)
            Heights in λc of the table (of ``measurements.unit[0]`` each, in the unit of the table).
        theta : array, shape (p,) or (t, p), optional
            Other θ than those of the best fit, in the order of ``parameters.names``.
        along : {"height", "push_height"}
            Whether `heights` are those of the block, whose push stays at its share of the height, or of the push.

        Returns
        -------
        LengthCurve
            ``length``, ``bands``, ``longest`` in λc of the table, and ``breaks_again``.

        Raises
        ------
        ValueError
            If the measurements state no such height.
        """
        return predicted.curve(self, rows, heights, theta, along=along)

    def field(self, row: int, observable: str, position: ArrayLike) -> np.ndarray:
        """Predict the slip or stress along the interface after one precursor.

        Parameters
        ----------
        row : int
            Measurement, for which gauges read this.
        observable : {"slip", "stress"}
        position : array_like, shape (n,)
            Distances from the pushed edge, in m.

        Returns
        -------
        array, shape (n,)
            Slip in m, or stress in Pa; inf where the front never stops.

        Raises
        ------
        ValueError
            If no gauge read it.
        """
        return predicted.field(self, row, observable, position)

    @property
    def notes(self) -> list[str]:
        """Remarks to read before using the numbers."""
        return list(report.notes(self))

    def report(self, *, verbose: bool = False) -> str:
        """Format the result as text: a box, what else would move it, the data, remarks; everything else if `verbose`."""
        return report.report(self, self.changes, self.next_steps, verbose=verbose)

    def methods(self) -> str:
        """Write a sentence for the methods section of a paper, with the numbers of this fit."""
        return report.methods(self, self.changes)

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {value:.4g}" for name, value in self.values.items())
        return f"FitResult({self.identifiability.name}: {values}; report() says more)"

    def _repr_html_(self) -> str:
        return report.html_of(self, self.changes)

    def __str__(self) -> str:
        return self.report()

    def to_dict(self) -> dict[str, Any]:
        """Return the whole result as plain Python values for JSON; open ends and missing numbers are None."""
        more = {
            "stderr_with_inputs": self.stderrs_with_inputs,
            "error_with_inputs": self.errors_with_inputs,
            "directions": self.directions,
            "notes": self.notes,
        }
        return record.to_dict(self, self.changes, self.next_steps, **more)

    def to_dataframe(self) -> "pd.DataFrame":
        """Return measurements and model as a pandas.DataFrame, one row per measurement, in the unit of the table."""
        return record.to_dataframe(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result as JSON, as ``slippulse fit --json`` prints it; `load_fit` reads it."""
        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
        write_atomically(path, (text + "\n").encode())

    def bootstrap(self, count: int = 1000, *, kind: Bootstrap = "parametric", seed: int = 0) -> Samples:
        """Refit simulated or resampled measurements: see `slippulse_jax.inference.samples`."""
        return bootstrap(self, count, kind=kind, seed=seed)

    def posterior(
        self, *, samples: int = 1000, warmup: int = 500, chains: int = 4, seed: int = 0, progress: bool | None = None
    ) -> Samples:
        """Sample the posterior by NUTS: see `slippulse_jax.inference.samples`; needs the extra ``bayes``."""
        return posterior(self, samples=samples, warmup=warmup, chains=chains, seed=seed, progress=progress)


def load_fit(path: str | os.PathLike[str]) -> FitResult:
    """Read a fit that `FitResult.save` wrote, or ``slippulse fit --json`` printed.

    Nothing is fitted again: measurements, request, what the search found, and what else would move the result are in the file.
    What else would move a fit that version 0.2 wrote is found when it is first asked for.

    Raises
    ------
    OSError
        If there is no such file, or it cannot be opened.
    ValueError
        If it is no fit, or has another schema.
    """
    found, moved, steps = record.of_dict(record.read_record(path))
    result = FitResult(**{one.name: getattr(found, one.name) for one in dataclasses.fields(found)})
    known = {"changes": moved, "next_steps": steps}
    vars(result).update({name: x for name, x in known.items() if x is not None})  # where `cached_property` keeps them
    return result


def fit(
    measurements: "Measurements | pd.DataFrame | str | os.PathLike[str]",
    free: str | Parameter | Sequence[str | Parameter] = ("stiffness",),
    *,
    bounds: tuple[float, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    loss: Loss = "normal",
    sigma: Sigma = "absolute",
    method: Method = "lm",
    max_steps: int = 60,
    seed: int = 0,
    intervals: IntervalsBy = "auto",
    event: MeasuredEvent | None = None,
    body: Body | None = None,
) -> FitResult:
    """Fit the interface to measured first precursors.

    The model is the length ℓ of the first precursor on a slider, as `precursor_length` has it, or the length of the whole event
    on a block whose push is stated. The deviance −2 ln(likelihood × prior), which is χ² for plain lengths, is minimised from
    many starts at once. The intervals are profile-likelihood intervals, in as many disjoint pieces as there are.

    Parameters
    ----------
    measurements : Measurements, pandas.DataFrame or path
        From `read_measurements`, or built from arrays; or a table with the columns of `read_measurements`, or its CSV file.
    free : sequence of str or Parameter
        Parameters to fit, by the names of `slippulse_jax.inference.parameters.PARAMETERS`. "stiffness" is k/K where lengths
        are in λc, the areal stiffness k/λc² where they are in SI. A `Parameter` adds bounds, a prior, one value per specimen.
        Inputs that come with an error of their own are fitted beside them, with that error as prior; beside lengths of
        provenance "measured" also a "model_factor" and, where they have σ, an "offset" (`with_errors_of_measuring`), unless
        they are named or held.
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
        longest attainable length too (`slippulse_jax.inference.intervals`; one or two parameters, plain lengths). By default
        simulated where valleys of the deviance compete, or its shape is far from a parabola.
    event : {"domino", "full", "crack"}
        What was measured: the first front; or the whole event, in which contacts may break again where the areal stiffness is
        large (`rebreaking_onset`), with a cost that grows with it (docs/fit/use.md), for lengths without gauges; or the front
        of a crack, behind which contacts slide at a "friction" that is fitted or held (docs/model/crack.md). By default
        "domino" of a slider and "full" of a block.
    body : {"slider", "block"}
        The paper's slider; or a block under two-dimensional elasticity, pushed where `measurements` say (docs/model/block.md):
        taken by default where they say so for every line.

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
    given = locals().copy()
    measurements = measurements_of(measurements)
    wanted = wanted_parameters(free, bounds, fixed)
    for suspicion in suspicions(measurements, wanted):
        warnings.warn(suspicion, MeasurementWarning, stacklevel=3)
    request = {"free": wanted} | {name: x for name, x in given.items() if name in record.SETTINGS}
    choices = {"loss": (loss, Loss), "method": (method, Method), "sigma": (sigma, Sigma), "intervals": (intervals, IntervalsBy)}
    for name, (value, known) in choices.items():
        check_choice(name, value, known)
    check_whole("max_steps", max_steps, 1)
    check_whole("seed", seed, 0)
    scaled = sigma == "relative" or measurements.length_sigma is None
    problem = problem_of(measurements, wanted, loss, size_known=not scaled, event=event, body=body)
    parameters = problem.parameters
    _check_scaled(measurements, problem, scaled)
    _check_calibrated(problem, intervals, scaled)
    counts = allowed_by_counts(problem) if problem.only_counts and not parameters.front.interpolated else None
    between = None if scaled or counts else between_contacts(problem, seed)
    if between is not None:
        problem = make_problem(measurements, parameters, loss, np.hypot(measurements.stated_sigma, between))
    held, at_odds = counts or ([], None)
    if held:
        found = _of_counts(problem, held)
    else:
        with _progress(problem) as shown:
            if scaled:
                problem, found = _explore_scaled(shown, measurements, method, max_steps, seed)
            else:
                found = _explore(shown, method, max_steps, seed)
    best, deviance, names = found.theta, found.deviance, parameters.names
    asked = [j for j, one in enumerate(parameters.free) if not one.nuisance]
    limits = {level: deviance + rise_of(level, dof=found.scatter_dof) for level in LEVELS}
    pieces = {j: allowed(problem, j, found.curves[j], limits) for j in asked}
    if counts is not None:
        pieces = {0: dict.fromkeys(LEVELS, held)}
    reported, covered = pieces, {}
    if counts is None and not scaled and to_be_simulated(problem, intervals, found.roots, deviance, pieces, best):
        with _progress(problem) as shown:
            simulated = calibrated(shown, LEVELS, curves=found.curves, seed=seed)
        reported = {j: own for j, (own, _) in simulated.items()}
        covered = {names[j]: shares for j, (_, shares) in simulated.items()}
    longest, longest_at = attainable(parameters, best)
    result = FitResult(
        measurements=measurements,
        problem=problem,
        request=request,
        theta=best,
        deviance=deviance,
        minima=found.roots,
        curves={names[j]: found.curves[j] for j in asked},
        intervals={},
        verdicts={},
        scatter=found.scatter,
        scatter_dof=found.scatter_dof,
        closest=found.closest,
        testable_dof=None if scaled else problem.testable(best),
        # counts at odds are named; the search of such a misfit need not converge
        unconverged=[] if counts else [message for value, message in found.unconverged if value <= limits[LEVELS[-1]]],
        attainable=longest,
        attainable_at=longest_at,
        between_contacts=between,
        covered=covered,
    )
    judged = {names[j]: judge(result, j, pieces[j], reported[j], at_odds) for j in asked}
    return dataclasses.replace(
        result,
        verdicts={name: verdict for name, (verdict, _) in judged.items()},
        intervals=_in_units(problem, best, {name: trusted for name, (_, trusted) in judged.items()}),
    )


@contextmanager
def _progress(problem: Problem) -> Iterator[Problem]:
    """Show a progress bar of the evaluations; on a terminal at once, because the first fit compiles before it counts."""
    delay = 0 if sys.stderr is not None and sys.stderr.isatty() else 2
    with tqdm(desc="fit (the first compiles)", unit=" lengths", unit_scale=True, delay=delay, leave=False, disable=None) as bar:
        yield dataclasses.replace(problem, tick=bar.update)


def _in_units(problem: Problem, best: np.ndarray, pieces: dict[str, Intervals]) -> dict[str, Intervals]:
    """Convert intervals to the units of the parameters; add those of k/K where it is proportional to one of them."""
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


def _check_scaled(m: Measurements, problem: Problem, scaled: bool) -> None:
    if not scaled:
        return
    copies = len(m) - m.distinct
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
        raise ValueError("calibrated intervals: for one or two parameters, and values with Gaussian errors")


def _of_counts(problem: Problem, held: list[Interval]) -> Found:
    """Put a root in the middle of every range that the counts allow, the softest first."""
    middle = np.array([[(piece.low + piece.high) / 2] for piece in held])
    value = 2 * problem(middle).value
    roots = [describe(problem, point, float(v)) for point, v in zip(middle, value, strict=True)]
    grid = grid_of(problem)
    return Found(roots, middle[0], float(value.min()), [], grid, {0: profile(problem, 0, roots, middle, grid)})


def _explore_scaled(problem: Problem, m: Measurements, method: Method, max_steps: int, seed: int) -> tuple[Problem, Found]:
    """Search with σ scaled to the scatter about the best fit known."""
    theta, rounds = first_look(problem, seed), 0
    while True:
        scaled, near = scaled_to_scatter(problem, theta, of_lengths=m.length_sigma is None)
        found = _explore(scaled, method, max_steps, seed)
        rounds += 1
        if found.deviance >= near.deviance - 1e-3 or rounds == SEARCH_ROUNDS:
            sizes = {name: getattr(near, name) for name in ("scatter", "scatter_dof", "closest")}
            return dataclasses.replace(scaled, tick=None), found._replace(**sizes)
        theta = found.theta


def _explore(problem: Problem, method: Method, max_steps: int, seed: int) -> Found:
    """Search the range, and compute the profile of every requested parameter."""
    asked = [j for j, one in enumerate(problem.parameters.free) if not one.nuisance]
    found = search(problem, method=method, max_steps=max_steps, seed=seed)
    if not np.isfinite(found.deviance):
        raise ValueError("the front never stops anywhere in the range searched: these measurements cannot come from this model")
    roots, best, deviance = found.roots, found.theta, found.deviance
    if roots and all(root.rebreaks for root in roots):
        roots = _merged(problem, roots, _softer(problem, roots[0], method=method, max_steps=max_steps, seed=seed))
    curves: dict[int, Curve] = {}
    for _ in range(SEARCH_ROUNDS):
        roots = ordered(problem, roots)
        curves = {j: profile(problem, j, roots[:MOST_ROOTS], found.theta[None], found.grid) for j in asked}
        best, deviance = _lowest(roots, curves, best, deviance)
        missed = [
            curve.theta[i]
            for curve in curves.values()
            for i in _valleys(curve.deviance, deviance + SLACK)
            if not any(curve.deviance[i] >= root.deviance - 1e-6 and _near(curve, i, root) for root in roots)
        ]
        missed += _crossed(roots[:MOST_ROOTS])
        if not missed:
            break
        more = search(problem, method=method, max_steps=max_steps, seed=seed, extra=np.array(missed))
        before = len(roots)
        roots = _merged(problem, roots, more.roots)
        if len(roots) == before:
            break
    known = [root.deviance for root in roots]
    lost = [(value, message) for value, message in found.unconverged if not known or value < min(known) - 1e-6]
    return Found(roots, best, deviance, lost, found.grid, curves)


def _softer(problem: Problem, stiff: Root, **options: Any) -> list[Root]:
    """Find minima below a stiffness at which a contact breaks again that the data accept, whatever their deviance."""
    q = problem.parameters
    moved = np.array([one.name in STIFFNESSES for one in q.free])
    below = q.low + np.linspace(0, 1, SOFTER)[:-1, None] * (stiff.theta - q.low)
    found = search(problem, extra=np.where(moved, below, stiff.theta), **options).roots if moved.any() else []
    return [root for root in found if not root.rebreaks and problem.accepts(root.theta, root.deviance, stiff.deviance + SLACK)]


def _valleys(deviance: np.ndarray, limit: float) -> np.ndarray:
    """Inner nodes lower than both neighbours and than `limit`."""
    inner = (deviance[1:-1] < deviance[:-2]) & (deviance[1:-1] <= deviance[2:]) & (deviance[1:-1] < limit)
    return 1 + np.nonzero(inner)[0]


def _crossed(roots: list[Root]) -> list[np.ndarray]:
    """Each root with one coordinate of another: two valleys of each of two parameters make four minima."""
    pairs = [(a.theta, b.theta) for a in roots for b in roots if a is not b]
    return [np.where(np.arange(len(a)) == j, b, a) for a, b in pairs for j in range(len(a)) if len(a) > 1]


def _near(curve: Curve, i: int, root: Root) -> bool:
    """Whether a root lies between the two neighbours of node i."""
    j = int(np.argmin(np.abs(curve.theta[i] - curve.node[i])))
    return bool(curve.node[i - 1] <= root.theta[j] <= curve.node[i + 1])


def _lowest(roots: list[Root], curves: dict[int, Curve], best: np.ndarray, deviance: float) -> tuple[np.ndarray, float]:
    """Return the first root if nothing lies lower than all; otherwise a point of a profile, such as the end of the range."""
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
