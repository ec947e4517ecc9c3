"""Clouds of series for a fit of sequences.

A scan of the range searched comes first, then clouds about the minima. Each round fits surfaces to the series around the
lowest ones, minimises the deviance on each, and follows more series around its minimum: over the errors known so far, and
never over less than the half-widths below which a slope would be that of single orders of breaks. In the end one surface is
fitted to all series that these data allow.
"""

import dataclasses

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri
from scipy.stats import qmc

from slippulse_jax.inference.model.fronts import ROUGHNESS, BlockSequence
from slippulse_jax.inference.model.inputs import COMMON
from slippulse_jax.inference.model.parameters import PARAMETERS, Free, ParameterSet
from slippulse_jax.inference.model.sequence import UNITS
from slippulse_jax.inference.search.likelihood import Problem
from slippulse_jax.inference.search.minima import SLACK, Curve, describe
from slippulse_jax.inference.search.minimise import minimise

SCANNED, RESCALED = 192, 64
"""Series of the first scan, and those of it that are followed again with forces of the right size."""
BASINS = 5, 3, 2, 2, 1, 1
"""Most minima about which each round puts a cloud."""
RADIUS = 6.0, 4.0, 3.0, 2.0, 2.0, 2.0
"""Size of the clouds of each round, in standard errors."""
NARROWEST, WIDEST, FARTHEST = 1.5, 3.0, 8.0
"""Half-width of a last surface: at least and at most in those of clouds, and in standard errors."""
UNLIKELY, LARGEST_ERROR = 0.05, 0.05
"""Probability of χ² below which the error of the model is taken from the data, and the largest that it may be, in μF_N."""
TURNS = 4
"""Turns in which a last surface and the errors that it gives are fitted to each other."""


def gathered(problem: Problem, seed: int) -> Problem:
    """Follow series wherever data may be met, and fit surfaces to them.

    Return the problem with the errors that forces have there, and the range in which series were followed.
    """
    front, q, stated = problem.parameters.front, problem.parameters, problem
    assert isinstance(front, BlockSequence)
    units, random = np.array([_unit(one) for one in q.free]), np.random.default_rng(seed)
    known = _scan(problem, seed)
    front.follow(q.inputs.at(known))
    more = _rescaled(stated, known)
    front.follow(q.inputs.at(more))
    known = np.concatenate([known, more])
    deviance = _raw(stated, known)
    for most, radius in zip(BASINS, RADIUS, strict=True):
        starts = _apart(known[np.argsort(deviance, kind="stable")], 3 * units, most)
        ends = [_minimum(stated, known, start, units) for start in starts]
        more = np.concatenate([_cloud(q, end, covariance, radius, units, random) for end, covariance in ends])
        front.follow(q.inputs.at(more))
        known = np.concatenate([known, more])
        deviance = _raw(stated, known)
    basins: list[tuple[float, np.ndarray, np.ndarray]] = []
    for start in _apart(known[np.argsort(deviance, kind="stable")], 3 * units, BASINS[0]):
        theta, covariance = _minimum(stated, known, start, units)
        for _ in range(TURNS):
            metric = WIDEST**2 * covariance + np.diag((NARROWEST * units) ** 2)
            front.fitted([_tricube(known, theta, metric)[0]])
            theta, covariance = _descended(with_errors(stated, theta), theta, np.sqrt(np.diag(metric)) / 2, units)
        sized = with_errors(stated, theta)  # which a surface that fits the series badly makes large
        value = 2 * float(sized(theta[None]).value[0] + np.log(sized.lengths.sigma).sum())
        if not any(_off(theta, other, own) < 1 for _, other, own in basins):
            basins.append((value, theta, WIDEST**2 * covariance + np.diag((NARROWEST * units) ** 2)))
    basins.sort(key=lambda basin: basin[0])
    basins = [basin for basin in basins if basin[0] <= basins[0][0] + SLACK]
    front.fitted([_tricube(known, theta, metric)[0] for _, theta, metric in basins])
    reach = [np.sqrt(np.diag(metric)) for *_, metric in basins]
    ends = [np.stack([theta + side * half for (_, theta, _), half in zip(basins, reach, strict=True)]) for side in (-1, 1)]
    low, high = np.maximum(q.low, ends[0].min(axis=0)), np.minimum(q.high, ends[1].max(axis=0))
    free = tuple(one._replace(low=a, high=b) for one, a, b in zip(q.free, low.tolist(), high.tolist(), strict=True))
    narrowed = dataclasses.replace(stated, parameters=dataclasses.replace(q, free=free))
    return _widened(narrowed, basins[0][1])


def within_reach(curve: Curve) -> Curve:
    """The part of a profile with surfaces; its ends end no interval."""
    known = np.flatnonzero(np.isfinite(curve.deviance))
    return Curve(*(column[known[0] : known[-1] + 1] for column in curve)) if known.size else curve


def _widened(problem: Problem, theta: np.ndarray) -> Problem:
    """Enlarge the error of the model where forces scatter more.

    More than chance would have it; thresholds that scatter do that. It is the least error by which they match, unless that is
    too large to be called one.
    """
    front, q = problem.parameters.front, problem.parameters
    assert isinstance(front, BlockSequence)

    def at(error: float) -> tuple[float, np.ndarray]:
        front.model_error = error
        end = minimise(with_errors(problem, theta), theta[None], q.low, q.high)
        return 2 * float(end.value[0]), end.theta[0]

    degrees = problem.count - problem.p
    if degrees < 1 or at(ROUGHNESS)[0] <= chdtri(degrees, UNLIKELY) or at(LARGEST_ERROR)[0] > degrees:
        front.model_error = ROUGHNESS
        return with_errors(problem, theta)
    found = brentq(lambda error: at(error)[0] - degrees, ROUGHNESS, LARGEST_ERROR, xtol=1e-5)
    front.model_error = float(np.asarray(found))
    return with_errors(problem, theta)


def _off(theta: np.ndarray, centre: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Distances from a centre, in half-widths."""
    off = theta - centre
    return np.sqrt(np.einsum("...i,ij,...j->...", off, np.linalg.inv(metric), off))


def _tricube(known: np.ndarray, centre: np.ndarray, metric: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights that fall to 0 at an ellipsoid, and its size.

    Larger than asked for where too few series lie within.
    """
    p, off = len(centre), _off(known, centre, metric)
    reach = max(1.01 * float(np.sort(off)[min(len(off), 2 * (p + 1) * (p + 2)) - 1]), 1.0)
    return np.clip(1 - (off / reach) ** 3, 0, None) ** 3, reach


def _minimum(stated: Problem, known: np.ndarray, start: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimum of a surface around a start, and the covariance there."""
    front = stated.parameters.front
    assert isinstance(front, BlockSequence)
    weight, reach = _tricube(known, start, np.diag((NARROWEST * units) ** 2))
    front.fitted([weight])
    return _descended(with_errors(stated, start), start, min(NARROWEST * reach, FARTHEST) * units, units)


def _descended(problem: Problem, start: np.ndarray, reach: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimum near a start, and its covariance.

    Its errors are no larger than a surface may be wide.
    """
    q = problem.parameters
    box = np.maximum(q.low, start - reach), np.minimum(q.high, start + reach)
    end = minimise(problem, start[None], *box, max_steps=20).theta[0]
    covariance = describe(problem, end, 0.0).covariance
    scale = np.sqrt(np.diag(covariance))
    most = np.minimum(scale, np.maximum(FARTHEST / WIDEST * units, (q.high - q.low) / 12))
    return end, covariance * np.outer(most / scale, most / scale)


def with_errors(problem: Problem, theta: np.ndarray) -> Problem:
    """Add the errors of model and places, at θ, to forces."""
    q = problem.parameters
    off = q.front.uncertainty(q.inputs.at(theta))
    assert off is not None
    forces, *others = problem.observed
    sigma = np.hypot(forces.sigma, off * np.exp(q.scales["reach"](theta)))
    return dataclasses.replace(problem, observed=(forces._replace(sigma=np.where(np.isfinite(sigma), sigma, 1e3)), *others))


def _raw(problem: Problem, known: np.ndarray) -> np.ndarray:
    """Deviance of single series, each with its own errors."""
    q = problem.parameters
    assert isinstance(q.front, BlockSequence)
    q.front.fitted([])
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
    return np.where(np.isfinite(total), total, 1e9)


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
    return np.clip(moved[np.argsort(off, kind="stable")[:RESCALED]], q.low, q.high)


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
    return np.clip(centre + draws + random.uniform(-1, 1, draws.shape) * units, q.low, q.high)
