"""Points at which an expensive model is followed for a fit.

A scan of the range searched comes first; then, where several parameters trade, points that evolve along the valleys; then
clouds about the minima. Each round fits an emulator through the best points, minimises the deviance on it from several of
them, and follows the model around its minima: over the errors known so far, and never over less than the half-widths below
which a slope would be that of single orders of breaks. Last, profiles are followed outwards until they rise.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import brentq
from scipy.stats import qmc

from slippulse_jax.base.domains import check_choice, check_domain
from slippulse_jax.inference.model.emulator import Outputs, Points, through
from slippulse_jax.inference.model.inputs import Linear
from slippulse_jax.inference.model.series import CONTACTS, GEOMETRY
from slippulse_jax.inference.observables.observable import Observations
from slippulse_jax.inference.parameters import PARAMETERS, ParameterSet
from slippulse_jax.inference.search.likelihood import AT_ONCE, Problem
from slippulse_jax.inference.search.minima import Curve, describe
from slippulse_jax.inference.search.minimise import minimise

SCANNED, RESCALED = 160, 64
"""Points of the first scan, and those of it that are followed again with forces of the right size."""
BASINS = 5, 3, 2, 2, 1
"""Most minima about which each round puts a cloud."""
QUICK = 80, 32, (5,), 0
"""The same, and rounds outwards, where an estimate is enough."""
RADIUS = 6.0, 4.0, 3.0, 2.0, 2.0
"""Size of the clouds of each round, in standard errors."""
FITTED, KEPT, MOST = 100, 25.0, 2
"""Points through which an emulator goes, for each parameter; and up to how many times, of deviances so near the least."""
CELL = 3.0
"""Size of the cells, in half-widths, of which each gives its best points in turn where there are too many."""
FARTHEST, HOPELESS = 8.0, 60.0
"""How far a minimum is sought from a point, in half-widths; and the deviance above the least from which on none is sought."""
LARGEST_ERROR = 0.2
"""Largest error of the model, in μF_N, that is taken from data."""
MEMBERS, GENERATIONS, FACTOR = 48, 3, 0.7
"""Points that evolve together, generations for every parameter beyond two, and the factor of differences between them."""
PROMISING, MOST_PROMISING = 15.0, 3
"""Deviance of a point by itself, above the least, up to which its surroundings are followed; and of how many in each round."""
OF_BLOCK = {*GEOMETRY, "log_height", "log_sites"}
"""Inputs on which the elastic block depends."""
OUTWARDS, STEPS = 12, 3.0
"""Most rounds in which a profile is followed outwards, and how far each goes, in half-widths."""
WIDE, SIDES, TRIED, NEAR = 3.0, 256, 2048, 6.0
"""Errors of a prior over which events are drawn; corners of many parameters; and points at which −ln p is looked at, with how
far above the least many draws are worth it."""
RISEN = 2.0
"""Rise of the deviance beyond the limit of an interval from which on a profile needs no more points."""


def learnt(problem: Problem, seed: int, model_error: float | str | None = None, *, quick: bool = False) -> Problem:
    """Follow the model where data may be met; fit an emulator.

    In one round, `quick`, to some per cent.
    """
    if problem.parameters.front.drawn:
        return with_draws(problem, seed)
    problem = with_model_error(problem, model_error) if isinstance(model_error, float | int) else problem
    q, units, random = problem.parameters, _units(problem.parameters), np.random.default_rng(seed)
    if problem.loss != "normal":
        raise ValueError(f"loss = {problem.loss!r}: forces of a sequence err together, so that none can count less alone")
    scanned, rescaled, basins, outwards = (SCANNED, RESCALED, BASINS, OUTWARDS) if not quick else QUICK
    problem = followed(problem, _within(q, _scan(problem, scanned, seed), units))
    if len(more := _rescaled(problem)[:rescaled]):
        problem = followed(problem, _within(q, more, units))
    problem = emulated(_evolved(problem, units, random))
    for most, radius in zip(basins, RADIUS, strict=False):
        ends = _minima(problem, np.array(_starts(problem, units, most)), units)
        more = [_cloud(q, end, covariance, radius, units, random) for end, covariance in ends]
        more += [_cloud(q, start, np.diag(units**2), 2.0, units, random) for start in _promising(problem, units)]
        problem = emulated(followed(problem, np.concatenate(more)))
    problem = problem if quick else emulated(problem, tuned=True)
    for _ in range(outwards):
        if not (more := [_cloud(q, one, np.diag(units**2), 2.0, units, random) for one in _promising(problem, units)]):
            break
        problem = emulated(followed(problem, np.concatenate(more)), tuned=True)
    return problem


def with_draws(problem: Problem, seed: int) -> Problem:
    """Draw events in the range searched, more where data may be met."""
    if problem.loss != "normal":
        raise ValueError(f"loss = {problem.loss!r}: of contacts that scatter events that are far off are part of the model")
    q, inputs = problem.parameters, problem.learnt[0].inputs
    nuisance, spread = np.array([one.nuisance for one in q.free]), WIDE / np.sqrt(np.maximum(problem.prior_weight, 1e-300))
    low, high = np.maximum(q.low, problem.prior_mean[0] - spread), np.minimum(q.high, problem.prior_mean[0] + spread)
    low, high = np.where(nuisance, low, q.low), np.where(nuisance, high, q.high)
    sides = (
        qmc.Halton(problem.p, rng=seed).random(SIDES).round()
        if problem.p > 8
        else np.indices((2,) * problem.p).reshape(problem.p, -1).T
    )
    middle, ends = inputs.at((low + high) / 2), inputs.at(low + sides * (high - low)).table()
    alone = all(data.observable.drawn_as == 0 for data in problem.learnt)
    few = dataclasses.replace(problem, emulator=q.front.ensembles(middle, ends, alone=alone))
    theta = low + qmc.Sobol(problem.p, rng=seed).random(TRIED) * (high - low)
    value = few(theta).value
    near = theta[value < np.min(value, initial=np.inf, where=np.isfinite(value)) + NEAR]
    return dataclasses.replace(problem, emulator=q.front.ensembles(middle, ends, inputs.at(near), alone=alone))


def outwards(problem: Problem, curves: Mapping[int, Curve], limit: float, seed: int) -> Problem | None:
    """Follow the model beyond profiles that have not risen, if any."""
    q, units, random = problem.parameters, _units(problem.parameters), np.random.default_rng(seed)
    count, more = 6 * problem.p + 6, []
    for j, curve in curves.items():
        known = np.isfinite(curve.deviance)
        for way in (-1, 1):  # of all nodes beside which, that way, nothing is known
            beside = np.append(known[1:], True) if way > 0 else np.append(True, known[:-1])
            for end in np.flatnonzero(known & ~beside & (curve.deviance < limit + RISEN)).tolist():
                inside = [i for i in range(end, end - way * len(known), -way) if 0 <= i < len(known) and known[i]]
                inner = next((i for i in inside if abs(curve.node[i] - curve.node[end]) > units[j]), inside[-1])
                step = curve.theta[end] - curve.theta[inner]
                step = (
                    step / max(abs(step[j]), 1e-300) * units[j] if inner != end else way * units * (np.arange(problem.p) == j)
                )
                step = step * min(1.0, float(np.min(STEPS * units / np.maximum(np.abs(step), 1e-300))))
                along = curve.theta[end] + STEPS * random.random((count, 1)) * step
                more.append(_within(q, along + random.uniform(-1, 1, (count, problem.p)) * units, units))
    return emulated(followed(problem, np.concatenate(more)), tuned=True) if more else None


def over(problem: Problem, theta: np.ndarray) -> Problem:
    """Follow the model about θ, (t, p); fit an emulator."""
    units, random = _units(problem.parameters), np.random.default_rng(0)
    problem = followed(problem, _within(problem.parameters, theta + random.uniform(-1, 1, theta.shape) * units, units))
    return dataclasses.replace(problem, emulator=through(problem.points, len(theta), tuned=True))


def _promising(problem: Problem, units: np.ndarray) -> list[np.ndarray]:
    """The best points, by themselves, where an emulator knows nothing."""
    theta, deviance = problem.points.theta, 2 * single(problem)[0]
    order = np.argsort(deviance, kind="stable")
    unknown = ~np.isfinite(problem.of_points) & (deviance < deviance[order[0]] + PROMISING)
    return _apart(theta[order[unknown[order]]], units, MOST_PROMISING)


def narrowed(problem: Problem) -> Problem:
    """The problem in the range in which the model was followed."""
    q, units, near = problem.parameters, _units(problem.parameters), problem.points.theta[problem.through]
    low, high = np.maximum(q.low, (near - units).min(axis=0)), np.minimum(q.high, (near + units).max(axis=0))
    free = tuple(one._replace(low=a, high=b) for one, a, b in zip(q.free, low.tolist(), high.tolist(), strict=True))
    return dataclasses.replace(problem, parameters=dataclasses.replace(q, free=free))


def pruned(problem: Problem) -> Problem:
    """Keep only the points through which the emulator goes."""
    assert problem.through is not None
    return dataclasses.replace(problem, points=problem.points.take(problem.through), through=None)


def within_reach(curve: Curve) -> Curve:
    """The part of a profile that the emulator knows."""
    known = np.flatnonzero(np.isfinite(curve.deviance))
    return Curve(*(column[known[0] : known[-1] + 1] for column in curve)) if known.size else curve


# --- errors of the model --------------------------------------------------------------------------------------------------


def check_model_error(problem: Problem, model_error: float | str | None) -> None:
    """Refuse an error of forces where there are none."""
    if model_error is None:
        return
    if "model_error" not in problem.parameters.front.inputs:
        raise ValueError("model_error: of forces of a sequence; beside lengths give a prior of model_factor")
    if isinstance(model_error, str):
        check_choice("model_error", model_error, Literal["fitted"])
        if problem.count <= problem.p:
            raise ValueError(
                f'model_error = "fitted": {problem.count} data for {problem.p} fitted parameters leave nothing to take it from'
            )
    else:
        check_domain("model_error", model_error, lambda x: (x >= 0) & (x <= 1), "in μF_N, must lie in [0, 1]")


def with_model_error(problem: Problem, error: float) -> Problem:
    """Add an error of the model to every force, in μF_N."""

    def changed(data: Observations) -> Observations:
        known = data.inputs.get("model_error")
        return data._replace(inputs=data.inputs.given(model_error=Linear(np.full_like(known.base, error), known.slope)))

    return problem.changed(changed)


def model_error_of(problem: Problem) -> float:
    """The error of the model that was added, in μF_N."""
    inputs = problem.observed[0].inputs
    return float(inputs.get("model_error").base[0]) if "model_error" in inputs.names else 0.0


def sized(problem: Problem) -> Problem:
    """Take the error of the model from the data.

    It is that with which χ² is what is expected. Where the largest is not enough χ² tests the model with that.
    """
    units, q, degrees = _units(problem.parameters), problem.parameters, problem.count - problem.p
    starts = np.array(_starts(problem, units, BASINS[0]))

    def beyond(error: float) -> float:
        wider = with_model_error(problem, error)
        ends = minimise(wider, starts, q.low, q.high)
        least = int(np.argmin(ends.value))
        return 2 * float(ends.value[least]) - wider.perfect(ends.theta[least]) - degrees

    if beyond(LARGEST_ERROR) > 0:
        return with_model_error(problem, LARGEST_ERROR)
    error = float(np.asarray(brentq(beyond, 0.0, LARGEST_ERROR, xtol=1e-5))) if beyond(0.0) > 0 else 0.0
    return dataclasses.replace(with_model_error(problem, error), known=False)


# --- points ---------------------------------------------------------------------------------------------------------------


def followed(problem: Problem, theta: np.ndarray) -> Problem:
    """Follow the model at more θ, (t, p)."""
    front, inputs = problem.parameters.front, problem.observed[0].inputs.at(theta)
    before = len(problem.points.theta)
    units = []
    for unit, (series, *how) in enumerate(front.follow(inputs, first=before)):
        own = inputs.map(lambda x, unit=unit: x[:, unit])
        columns = []
        for data in problem.observed:
            mine = data.rows == unit
            more = {name: x[mine] for name, x in data.more.items()}
            read = data.observable.read_series(series, how[0], own, more)
            columns.append(read.reshape(len(theta), -1))
        units.append((front.coordinates(own), np.concatenate(columns, axis=1), how[1]))
    widest = max(values.shape[1] for _, values, _ in units)
    place, values, coarse = zip(*units, strict=True)
    padded = [np.pad(x, [(0, 0), (0, widest - x.shape[1])]) for x in values]  # of units with fewer data
    points = Points(theta, np.stack(place), np.stack(padded), np.stack(coarse))
    return dataclasses.replace(problem, points=problem.points.and_(points))


def about(problem: Problem, theta: np.ndarray, count: int) -> np.ndarray:
    """Points within the errors of a fit, (count, p)."""
    q, random = problem.parameters, np.random.default_rng(0)
    covariance = np.linalg.pinv(problem(theta[None], order=1).metric[0], rcond=1e-9, hermitian=True)
    return np.clip(random.multivariate_normal(theta, covariance, count, method="eigh"), q.low, q.high)


def spreads(problem: Problem, theta: np.ndarray) -> Iterator[np.ndarray]:
    """Errors of places and of the model near θ, by observable."""
    values, inputs = np.nanmean(problem.points.values, axis=1), problem.observed[0].inputs.at(theta)
    units, size = values.shape
    with jax.enable_x64(True):
        for data in problem.observed:
            exact = Outputs(*map(jnp.asarray, (values, np.zeros((units, size, size)), np.zeros(units))))
            found = data.predicted(data.observable.emulate(exact, inputs, data), jnp.asarray(theta))
            yield np.sqrt(np.diag(found.covariance))


def emulated(problem: Problem, *, tuned: bool = False) -> Problem:
    """Fit an emulator through the best points.

    Of too many that are near enough through some of everywhere: the best alone would leave out the ends of a profile.
    """
    (order, deviance), count, units = _ranked(problem), FITTED * problem.p, _units(problem.parameters)
    rows = order[: max(count, int(np.searchsorted(deviance, deviance[0] + KEPT)))]
    _, cell = np.unique(np.floor(problem.points.theta[rows] / (CELL * units)), axis=0, return_inverse=True)
    turn = np.empty(len(rows), int)  # of each point among those of its cell
    for own in (np.flatnonzero(cell.ravel() == one) for one in range(int(cell.max()) + 1)):
        turn[own] = np.arange(len(own))
    rows = rows[np.sort(np.argsort(turn, kind="stable")[: MOST * count])]
    whole = -(-len(rows) // count) * count  # few shapes, so that few programs are compiled
    return dataclasses.replace(problem, through=rows, emulator=through(problem.points.take(rows), whole, tuned=tuned))


def _ranked(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Points that reach all data, the best first, and their deviance.

    Where an emulator is known, by its deviance there: those that lie near the data by their own order of breaks would bend it
    towards the data.
    """
    deviance = 2 * single(problem)[0]
    if problem.emulator is not None:
        smooth = 2 * problem.of_points
        known = np.isfinite(smooth) & np.isfinite(deviance)
        above = np.min(smooth, initial=np.inf, where=known) - np.min(deviance)  # of errors of another size
        deviance = np.where(known, smooth, deviance + (above if known.any() else 0.0))
    order = np.argsort(deviance, kind="stable")
    order = order[np.isfinite(deviance[order])]
    if len(order) < 2 * (problem.p + 1):
        raise ValueError(
            f"{problem.measurements.source}: of {len(deviance)} series in the range searched {len(order)} reach all places: "
            "these forces cannot come from this model"
        )
    return order, deviance[order]


def single(problem: Problem) -> tuple[np.ndarray, list[np.ndarray]]:
    """−ln(likelihood × prior) of each point by itself, (t,).

    With its own errors; and its predictions, (t, n) each.
    """
    points, every = problem.points, []
    numbers = tuple(data._replace(observable=None) for data in problem.observed)
    kinds = tuple(data.observable for data in problem.observed)
    for start in range(0, len(points.theta), AT_ONCE):
        count = len(points.theta[start : start + AT_ONCE])
        rows = np.resize(np.arange(start, start + count), AT_ONCE)
        with jax.enable_x64(True):
            found = _single(kinds, numbers, points.theta[rows], np.moveaxis(points.values, 1, 0)[rows])
        every.append([np.asarray(x)[:count] for x in found])
    value, *means = map(np.concatenate, zip(*every, strict=True))
    value = value + (problem.prior_weight * (points.theta - problem.prior_mean[0]) ** 2).sum(axis=1) / 2
    return np.where(np.isfinite(value), value, np.inf), means


@partial(jax.jit, static_argnums=0)
def _single(kinds: tuple[Any, ...], observed: Any, theta: Array, values: Array) -> tuple[Array, ...]:
    def one(theta: Array, values: Array) -> tuple[Array, ...]:
        size = values.shape[1]
        outputs = Outputs(values, jnp.zeros((len(values), size, size)), jnp.zeros(len(values)))
        total, means = jnp.zeros(()), []
        for observable, data in zip(kinds, observed, strict=True):
            found = observable.emulate(outputs, data.inputs.at(theta), data, single=True)
            found = data.predicted(found, theta)
            total = total - observable.log_density(found, data.reading())
            means.append(found.mean)
        return total, *means

    return jax.vmap(one)(theta, values)


def _starts(problem: Problem, units: np.ndarray, most: int) -> list[np.ndarray]:
    """The best points of which none is near another."""
    order, deviance = _ranked(problem)
    return _apart(problem.points.theta[order[deviance < deviance[0] + HOPELESS]], units, most)


def _apart(theta: np.ndarray, units: np.ndarray, most: int) -> list[np.ndarray]:
    """The first points of which none is near another."""
    chosen: list[np.ndarray] = []
    for one in theta:
        if len(chosen) < most and all(np.abs((one - other) / units).max() > 3 for other in chosen):
            chosen.append(one)
    return chosen


def _minima(problem: Problem, starts: np.ndarray, units: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Minima near starts, and their covariances.

    Their errors are no larger than a cloud may be wide.
    """
    q, reach = problem.parameters, FARTHEST * units
    box = np.maximum(q.low, starts - reach), np.minimum(q.high, starts + reach)
    for theta in minimise(problem, starts, *box, max_steps=20).theta:
        covariance = describe(problem, theta, 0.0).covariance
        scale = np.sqrt(np.diag(covariance))
        most = np.minimum(scale, np.maximum(FARTHEST / 3 * units, (q.high - q.low) / 12))
        yield theta, covariance * np.outer(most / scale, most / scale)


def _evolved(problem: Problem, units: np.ndarray, random: np.random.Generator) -> Problem:
    """More points along the valleys where several parameters trade.

    By differential evolution (Storn and Price), in which a point is replaced by a better one near it.
    """
    q, member = problem.parameters, np.argsort(single(problem)[0], kind="stable")[:MEMBERS]
    for _ in range(GENERATIONS * (problem.p - 2)):
        here = problem.points.theta[member]
        step = FACTOR * (random.permutation(here) - random.permutation(here)) + random.uniform(-0.5, 0.5, here.shape) * units
        problem = followed(problem, _within(q, here + step, units))
        deviance, _ = single(problem)
        born = len(deviance) - len(member) + np.arange(len(member))
        member = np.where(deviance[born] < deviance[member], born, member)
    return problem


def _rescaled(problem: Problem) -> np.ndarray:
    """The best of the points if their forces had the right size.

    With the friction or the normal load that gives it. A force is nearly in proportion to either, so that the range of
    stiffness is scanned as if it were the only parameter.
    """
    q, known = problem.parameters, problem.points.theta
    scaling = next((j for name in ("normal_load", "friction") for j, one in enumerate(q.free) if one.name == name), None)
    if scaling is None:
        return known[:0]
    (fitted, *others), (forces, *read) = single(problem)[1], [data.value[0] for data in problem.observed]
    with np.errstate(all="ignore"):
        size = (forces / fitted).mean(axis=1)
        moved = known.copy()
        moved[:, scaling] = known[:, scaling] + np.log(size) if q.free[scaling].log else known[:, scaling] * size
        off = np.sqrt(np.mean((fitted * size[:, None] / forces - 1) ** 2, axis=1))
        for found, value in zip(others, read, strict=True):
            off = off + np.abs(found - value).sum(axis=1) / len(forces)
    off = np.where(np.isfinite(off), off, np.inf)
    return moved[np.argsort(off, kind="stable")[:RESCALED]]


def _units(q: ParameterSet) -> np.ndarray:
    """Least half-width of a cloud in each θ."""
    return np.array([q.front.unit(PARAMETERS[one.name].acts) for one in q.free])


def _scan(problem: Problem, count: int, seed: int) -> np.ndarray:
    """Points over the whole range; of priors over two of their errors."""
    q = problem.parameters
    spread = 2 / np.sqrt(np.maximum(problem.prior_weight, 1e-300))
    low, high = np.maximum(q.low, problem.prior_mean[0] - spread), np.minimum(q.high, problem.prior_mean[0] + spread)
    return low + qmc.Halton(problem.p, rng=seed).random(count) * (high - low)


def _cloud(
    q: ParameterSet, centre: np.ndarray, covariance: np.ndarray, radius: float, units: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Points about a minimum, over its errors and the least half-widths."""
    size = 6 * len(centre) + 6
    draws = random.multivariate_normal(np.zeros(len(centre)), covariance, size, method="eigh") * radius / 2
    return _within(q, centre + draws + random.uniform(-1, 1, draws.shape) * units, units)


def _within(q: ParameterSet, theta: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Points in the range searched, on few elastic blocks and few stiffnesses.

    A block's response takes as long as many series on it, that of one more stiffness as several. Blocks differ by whole units.
    Where two numbers of the contacts are free, stiffnesses of two neighbours on contacts of one size (`BlockSeries.sites`) are
    made one. Of two that differ in friction alone one would tell little that the other does not; and where more are free, as of
    contacts that age, fewer stiffnesses miss minima.
    """
    of_block, of_stiffness, differ = (
        np.array([bool(names & PARAMETERS[one.name].acts.keys()) for one in q.free])
        for names in (OF_BLOCK, {"log_stiffness"}, {*CONTACTS})
    )
    middle = (q.low + q.high) / 2
    theta = np.where(of_block, middle + np.round((theta - middle) / units) * units, theta)
    together = 2 if differ.sum() == 2 else 1
    for j in np.flatnonzero(of_stiffness & ~of_block):
        order = np.lexsort([theta[:, j], np.arange(len(theta)) % 2])
        for rows in np.split(order, range(together, len(order), together)):
            theta[rows, j] = theta[rows, j].mean()
    return np.clip(theta, q.low, q.high)
