"""Clouds of series for a fit of sequences.

A scan of the range searched comes first; then, where several parameters trade, series that evolve along the valleys; then
clouds about the minima. Each round fits a surface to the best series, minimises the deviance on it from several of them, and
follows more series around its minima: over the errors known so far, and never over less than the half-widths below which a
slope would be that of single orders of breaks.
"""

import dataclasses
from typing import Literal

import numpy as np
from scipy.optimize import brentq
from scipy.stats import qmc

from slippulse_jax.base.domains import check_choice, check_domain
from slippulse_jax.inference.model.fronts import BlockSequence
from slippulse_jax.inference.model.inputs import COMMON
from slippulse_jax.inference.model.parameters import PARAMETERS, Free, ParameterSet
from slippulse_jax.inference.model.sequence import GEOMETRY, UNITS
from slippulse_jax.inference.search.likelihood import Problem
from slippulse_jax.inference.search.minima import Curve, describe
from slippulse_jax.inference.search.minimise import minimise

SCANNED, RESCALED = 160, 64
"""Series of the first scan, and those of it that are followed again with forces of the right size."""
BASINS = 5, 3, 2, 2, 1
"""Most minima about which each round puts a cloud."""
RADIUS = 6.0, 4.0, 3.0, 2.0, 2.0
"""Size of the clouds of each round, in standard errors."""
FITTED, FARTHEST = 100, 8.0
"""Series through which a surface goes, for each parameter; and how far a minimum is sought from one, in half-widths."""
UNKNOWN = 1e9
"""Error of a force off all series."""
LARGEST_ERROR = 0.2
"""Largest error of the model, in μF_N, that is taken from data."""
MEMBERS, GENERATIONS, FACTOR = 48, 3, 0.7
"""Series that evolve together, generations for every parameter beyond two, and the factor of differences between them."""
OF_BLOCK = {*GEOMETRY, "log_height", "log_sites"}
"""Inputs on which the elastic block depends."""
TURNS = 2
"""Turns in which a minimum and the errors there are fitted to each other."""


def gathered(problem: Problem, seed: int, model_error: float | str | None = None) -> Problem:
    """Follow series wherever data may be met, and fit surfaces to them.

    Return the problem with the errors that forces have there, and the range in which series were followed.
    """
    front, q, stated = problem.parameters.front, problem.parameters, problem
    assert isinstance(front, BlockSequence)
    if isinstance(model_error, str):
        check_choice("model_error", model_error, Literal["fitted"])
        front.error_is_fitted = True
    elif model_error is not None:
        check_domain("model_error", model_error, lambda x: (x >= 0) & (x <= 1), "in μF_N, must lie in [0, 1]")
        front.model_error = model_error
    if problem.loss != "normal":
        raise ValueError(f"loss = {problem.loss!r}: forces of a sequence err together, so that none can count less alone")
    units, random = np.array([_unit(one) for one in q.free]), np.random.default_rng(seed)
    known = _within(q, _scan(problem, seed), units)
    front.follow(q.inputs.at(known))
    more = _within(q, _rescaled(stated, known), units)
    if len(more):
        front.follow(q.inputs.at(more))
    known = _evolved(stated, np.concatenate([known, more]), units, random)
    for most, radius in zip(BASINS, RADIUS, strict=True):
        front.fitted(best := _lowest(stated, known))
        ends = [_minimum(stated, start, units) for start in _apart(known[best], 3 * units, most)]
        more = np.concatenate([_cloud(q, end, covariance, radius, units, random) for end, covariance in ends])
        front.follow(q.inputs.at(more))
        known = np.concatenate([known, more])
    front.fitted(best := _lowest(stated, known), tuned=True)
    ends = [_minimum(stated, start, units)[0] for start in _apart(known[best], 3 * units, BASINS[0])]
    theta = min(ends, key=lambda end: _deviance(stated, end))
    low, high = np.maximum(q.low, (known[best] - units).min(axis=0)), np.minimum(q.high, (known[best] + units).max(axis=0))
    free = tuple(one._replace(low=a, high=b) for one, a, b in zip(q.free, low.tolist(), high.tolist(), strict=True))
    narrowed = dataclasses.replace(stated, parameters=dataclasses.replace(q, free=free))
    return _sized(narrowed, theta, np.array(ends)) if front.error_is_fitted else with_errors(narrowed, theta)


def refuse_model_error(model_error: float | str | None) -> None:
    """Refuse an error of forces where there are lengths."""
    if model_error is not None:
        raise ValueError("model_error: of forces of a sequence; beside lengths give a prior of model_factor")


def within_reach(curve: Curve) -> Curve:
    """The part of a profile with surfaces; its ends end no interval."""
    known = np.flatnonzero(np.isfinite(curve.deviance))
    return Curve(*(column[known[0] : known[-1] + 1] for column in curve)) if known.size else curve


def _sized(problem: Problem, theta: np.ndarray, starts: np.ndarray) -> Problem:
    """Take the error of the model from the data.

    It is that with which χ² is what is expected. Where the largest is not enough χ² tests the model with that.
    """
    front, q, degrees = problem.parameters.front, problem.parameters, problem.count - problem.p
    assert isinstance(front, BlockSequence)
    if degrees < 1:
        raise ValueError(
            f'model_error = "fitted": {problem.count} data for {problem.p} fitted parameters leave nothing to take it from'
        )

    def beyond(error: float) -> float:
        front.model_error = error
        return 2 * float(minimise(with_errors(problem, theta), starts, q.low, q.high).value.min()) - degrees

    if beyond(LARGEST_ERROR) > 0:
        front.error_is_fitted = False
    elif beyond(0.0) > 0:
        front.model_error = float(np.asarray(brentq(beyond, 0.0, LARGEST_ERROR, xtol=1e-5)))
    return with_errors(problem, theta)


def _lowest(problem: Problem, known: np.ndarray) -> np.ndarray:
    """The series through which a surface is fitted, the best first."""
    deviance = _raw(problem, known)
    best = np.argsort(deviance, kind="stable")[: FITTED * problem.p]
    best = best[np.isfinite(deviance[best])]
    if len(best) < 2 * (problem.p + 1):
        raise ValueError(
            f"{problem.measurements.source}: of {len(known)} series in the range searched {len(best)} reach all places: these "
            "forces cannot come from this model"
        )
    return best


def _deviance(stated: Problem, theta: np.ndarray) -> float:
    """−2 ln of the likelihood, with the errors at θ, which differ."""
    sized = with_errors(stated, theta)
    assert sized.lengths.whitening is not None
    return 2 * float(sized(theta[None]).value[0] - np.log(np.diag(sized.lengths.whitening)).sum())


def _minimum(stated: Problem, start: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimum near a start, with the errors there, and its covariance.

    Its errors are no larger than a cloud may be wide.
    """
    q, theta, reach = stated.parameters, start, FARTHEST * units
    box = np.maximum(q.low, start - reach), np.minimum(q.high, start + reach)
    for _ in range(TURNS):
        theta = minimise(with_errors(stated, theta), theta[None], *box, max_steps=20).theta[0]
    covariance = describe(with_errors(stated, theta), theta, 0.0).covariance
    scale = np.sqrt(np.diag(covariance))
    most = np.minimum(scale, np.maximum(FARTHEST / 3 * units, (q.high - q.low) / 12))
    return theta, covariance * np.outer(most / scale, most / scale)


def with_errors(problem: Problem, theta: np.ndarray) -> Problem:
    """Add the errors of model and places, at θ, to forces."""
    q, (forces, *others) = problem.parameters, problem.observed
    assert isinstance(q.front, BlockSequence)
    unit = np.exp(q.scales["reach"](theta))
    covariance = np.diag(forces.sigma**2) + q.front.covariance(q.inputs.at(theta)) * np.outer(unit, unit)
    if not np.isfinite(covariance).all():  # off all series
        covariance = np.diag(np.full(len(unit), UNKNOWN**2))
    sigma, whitening = np.sqrt(np.diag(covariance)), np.linalg.inv(np.linalg.cholesky(covariance))
    return dataclasses.replace(problem, observed=(forces._replace(sigma=sigma, whitening=whitening), *others))


def _raw(problem: Problem, known: np.ndarray) -> np.ndarray:
    """Deviance of single series, each with its own errors."""
    q = problem.parameters
    assert isinstance(q.front, BlockSequence)
    q.front.fitted(None)
    off = q.front.uncertainty(q.inputs.at(known).ravel())
    assert off is not None
    forces, *others = problem.observed
    sigma = np.hypot(forces.sigma, off.reshape(len(known), -1) * np.exp(q.scales["reach"](known)))
    with np.errstate(invalid="ignore"):
        residual = (problem.predict(known) - forces.value[0]) / sigma
    total = (residual**2 + 2 * np.log(sigma / sigma.min())).sum(axis=1)
    for data in others:
        total = total + (((problem.predict(known, data.observable) - data.value[0]) / data.sigma) ** 2).sum(axis=1)
    total = total + (problem.prior_weight * (known - problem.prior_mean[0]) ** 2).sum(axis=1)
    return np.where(np.isfinite(total), total, np.inf)


def _evolved(problem: Problem, known: np.ndarray, units: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """More series along the valleys where several parameters trade.

    By differential evolution (Storn and Price), in which a series is replaced by a better one near it.
    """
    q, front = problem.parameters, problem.parameters.front
    assert isinstance(front, BlockSequence)
    member = np.argsort(_raw(problem, known), kind="stable")[:MEMBERS]
    for _ in range(GENERATIONS * (problem.p - 2)):
        here = known[member]
        step = FACTOR * (random.permutation(here) - random.permutation(here)) + random.uniform(-0.5, 0.5, here.shape) * units
        front.follow(q.inputs.at(step := _within(q, here + step, units)))
        known = np.concatenate([known, step])
        deviance = _raw(problem, known)
        born = len(known) - len(member) + np.arange(len(member))
        member = np.where(deviance[born] < deviance[member], born, member)
    return known


def _rescaled(problem: Problem, known: np.ndarray) -> np.ndarray:
    """The best of some points if their forces had the right size.

    With the friction or the normal load that gives it. A force is nearly in proportion to either, so that the range of
    stiffness is scanned as if it were the only parameter.
    """
    q = problem.parameters
    scaling = next((j for name in ("normal_load", "friction") for j, one in enumerate(q.free) if one.name == name), None)
    if scaling is None:
        return known[:0]
    fitted, forces = problem.predict(known), problem.lengths.value[0]
    with np.errstate(all="ignore"):
        size = (forces / fitted).mean(axis=1)
        moved = known.copy()
        moved[:, scaling] = known[:, scaling] + np.log(size) if q.free[scaling].log else known[:, scaling] * size
        off = np.sqrt(np.mean((fitted * size[:, None] / forces - 1) ** 2, axis=1))
    for data in problem.observed[1:]:
        off = off + np.abs(problem.predict(known, data.observable) - data.value[0]).sum(axis=1) / len(forces)
    off = np.where(np.isfinite(off), off, np.inf)
    return moved[np.argsort(off, kind="stable")[:RESCALED]]


def _unit(one: Free) -> float:
    """Least half-width of a cloud in θ."""
    acts = {"log_b" if name in COMMON else name for name in PARAMETERS[one.name].acts}
    sizes = {"friction": 0.02, "poisson": UNITS["poisson"], "prestress": UNITS["prestress"]}
    return sizes.get(one.name) or min((size for name, size in UNITS.items() if name in acts), default=UNITS["log_b"])


def _scan(problem: Problem, seed: int) -> np.ndarray:
    """Points over the whole range; of priors over two of their errors."""
    q = problem.parameters
    spread = 2 / np.sqrt(np.maximum(problem.prior_weight, 1e-300))
    low, high = np.maximum(q.low, problem.prior_mean[0] - spread), np.minimum(q.high, problem.prior_mean[0] + spread)
    return low + qmc.Halton(problem.p, rng=seed).random(SCANNED) * (high - low)


def _apart(theta: np.ndarray, units: np.ndarray, most: int) -> list[np.ndarray]:
    """The first points of which none is near another."""
    chosen: list[np.ndarray] = []
    for one in theta:
        if len(chosen) < most and all(np.abs((one - other) / units).max() > 1 for other in chosen):
            chosen.append(one)
    return chosen


def _cloud(
    q: ParameterSet, centre: np.ndarray, covariance: np.ndarray, radius: float, units: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Points about a minimum, over its errors and the least half-widths."""
    size = 6 * len(centre) + 6
    draws = random.multivariate_normal(np.zeros(len(centre)), covariance, size, method="eigh") * radius / 2
    return _within(q, centre + draws + random.uniform(-1, 1, draws.shape) * units, units)


def _within(q: ParameterSet, theta: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Points in the range searched, on few elastic blocks.

    These differ by whole units: the response of one takes as long as many series on it.
    """
    of_block = np.array([bool(OF_BLOCK & PARAMETERS[one.name].acts.keys()) for one in q.free])
    middle = (q.low + q.high) / 2
    return np.clip(np.where(of_block, middle + np.round((theta - middle) / units) * units, theta), q.low, q.high)
