"""Emulator of an expensive model: mean and covariance of its outputs.

A Gaussian process about a plane, with scatter (kriging: Sacks et al., Stat. Sci. 4, 409, 1989). It goes through points at which
the model was followed, and is evaluated in JAX: mean and covariance have derivatives of every order. Where contacts were larger
than those of the block, it is continued along a straight line in their size.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import minimize

REACH, SCATTER, USUAL_REACH, USUAL_SCATTER = (3.0, 60.0), (1e-3, 1.0), 6.0, 0.03
"""Lengths of the process, in units of the numbers, and its scatter over its size, squared: their ranges, and those that are not
tuned."""
TUNED = 200
"""Points by which lengths and scatter are tuned, the first ones."""
DOUBTED = 0.25
"""Error of a continuation to smaller contacts, over what it changes; contacts of a quarter of the size say 0.1 to 0.4."""
UNSURE = 0.5
"""Variance of the mean, over that of single points around it, above which an emulator knows nothing: it is about 1 at a point
that is alone."""
FAR = 1e6
"""Place of a point that is none, which fills up a list."""


class Points(NamedTuple):
    """Where a model was followed, and its outputs, by unit."""

    theta: np.ndarray  # (t, p)
    place: np.ndarray  # (u, t, d), numbers on which the outputs depend, each in its unit
    values: np.ndarray  # (u, t, m), NaN where there is none
    coarse: np.ndarray  # (u, t), how much larger contacts are than those of the block, over its length

    def and_(self, more: "Points") -> "Points":
        """Add points."""
        if not len(self.theta):
            return more
        (theta, *own), (also, *other) = self, more
        return Points(np.concatenate([theta, also]), *(np.concatenate(both, axis=1) for both in zip(own, other, strict=True)))

    def take(self, rows: np.ndarray) -> "Points":
        """Select some points."""
        return Points(self.theta[rows], *(column[:, rows] for column in self[1:]))


NOWHERE = Points(*(np.empty((0,) * rank) for rank in (2, 3, 3, 2)))
"""No points."""


class Outputs(NamedTuple):
    """Outputs at one place."""

    mean: Float[Array, " m"]
    covariance: Float[Array, "m m"]  # of how far single points lie from the mean, with the error of the mean
    unsure: Float[Array, ""]  # variance of the mean, over that of single points around it


class Emulator(NamedTuple):
    """Emulator of one unit, or of several along a leading axis.

    Arrays, traced or not.
    """

    place: Any  # (n, d)
    middle: Any  # (d,)
    reach: Any  # (d,), lengths of the process
    scatter: Any
    slope: Any  # (1 + d, m), of the plane
    bend: Any  # (n, m)
    alone: Any  # (n, m), how far each point lies from the others
    root: Any  # (n, n), inverse of the lower factor of their correlations
    weights: Any  # (n, 2 + d)
    spread: Any  # (2 + d, 2 + d), covariance of the plane, whose last column is the size of contacts
    doubt: Any  # (m,), error of the continuation to smaller contacts

    def __call__(self, place: Float[Array, " d"]) -> Outputs:
        """Mean and covariance at a place."""
        alike = _alike(place[None], self.place, self.reach, jnp)[0]
        plane = jnp.concatenate([jnp.ones(1, place.dtype), place - self.middle])
        off = jnp.append(plane, 0.0) - alike @ self.weights
        own = jnp.maximum(1 - jnp.square(self.root @ alike).sum(), 0) + off @ self.spread @ off
        share = alike / jnp.maximum(alike.sum(), 1e-30)
        spread = (share[:, None] * self.alone).T @ self.alone * (1 + own / self.scatter)
        covariance = spread + self.doubt[:, None] * self.doubt[None]
        return Outputs(plane @ self.slope + alike @ self.bend, covariance, own / self.scatter)


def through(points: Points, count: int, *, tuned: bool = False, like: tuple[np.ndarray, np.ndarray] | None = None) -> Emulator:
    """Fit an emulator to each unit through its points.

    Its lengths and scatter are those of the largest likelihood if `tuned`, or those of each unit in `like`.
    """
    every = []
    for unit, (place, values, coarse) in enumerate(zip(*points[1:], strict=True)):
        known = np.isfinite(values).all(axis=1)
        place, values, coarse = place[known], values[known], coarse[known]
        moving = np.ptp(place, axis=0) > 0
        usual = np.where(moving, USUAL_REACH, np.inf), USUAL_SCATTER
        how = usual if like is None else (like[0][unit], float(like[1][unit]))
        how = _likeliest(place[:TUNED], values[:TUNED], coarse[:TUNED], moving) if tuned else how
        every.append(_filled(_solved(place, values, coarse, *how)[1], count))
    return Emulator(*map(np.stack, zip(*every, strict=True)))


def _likeliest(place: np.ndarray, values: np.ndarray, coarse: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, float]:
    """Lengths and scatter of the largest likelihood."""

    def how(logs: np.ndarray) -> tuple[np.ndarray, float]:
        reach = np.full(len(moving), np.inf)
        reach[moving] = np.exp(logs[:-1])
        return reach, float(np.exp(logs[-1]))

    start = np.log(np.append(np.full(moving.sum(), USUAL_REACH), USUAL_SCATTER))
    bounds = [*[tuple(np.log(REACH))] * int(moving.sum()), tuple(np.log(SCATTER))]
    options = {"maxfev": 40 * len(start), "xatol": 0.05, "fatol": 0.5}

    def cost(logs: np.ndarray) -> float:
        return _solved(place, values, coarse, *how(logs))[0]

    return how(minimize(cost, start, method="Nelder-Mead", bounds=bounds, options=options).x)


def _solved(
    place: np.ndarray, values: np.ndarray, coarse: np.ndarray, reach: np.ndarray, scatter: float
) -> tuple[float, Emulator]:
    """−ln of the likelihood at lengths and scatter, and the emulator."""
    middle, size, unit = place.mean(axis=0), np.maximum(values.std(axis=0), 1e-9), np.max(coarse, initial=0.0) or 1.0
    plane, y = np.column_stack([np.ones(len(place)), place - middle, coarse / unit]), values / size
    factor = cho_factor(_alike(place, place, reach, np) + scatter * np.eye(len(place)), lower=True, check_finite=False)
    weights = cho_solve(factor, plane, check_finite=False)
    spread = np.linalg.pinv(plane.T @ weights, rcond=1e-10, hermitian=True)  # numbers may move together
    slope = spread @ weights.T @ y
    bend = cho_solve(factor, y - plane @ slope, check_finite=False)
    sizes = np.log(np.maximum(((y - plane @ slope) * bend).mean(axis=0), 1e-12))
    cost = len(y) * sizes.sum() / 2 + y.shape[1] * np.log(np.diag(factor[0])).sum()
    root = solve_triangular(np.tril(factor[0]), np.eye(len(y)), lower=True, check_finite=False)
    known = root.T @ root - weights @ spread @ weights.T
    alone = (known @ y) / np.diag(known)[:, None] * size
    doubt = DOUBTED * coarse.min() / unit * slope[-1] * size if coarse.any() else np.zeros_like(size)
    slopes = slope[:-1] * size
    return float(cost), Emulator(
        place, middle, reach, np.asarray(scatter), slopes, bend * size, alone, root, weights, spread, doubt
    )  # fmt: skip


def _filled(one: Emulator, count: int) -> Emulator:
    """Fill up with points that are too far away to count.

    All units then have as many.
    """
    more = [(0, count - len(one.place)), (0, 0)]
    return one._replace(
        place=np.pad(one.place, more, constant_values=FAR),
        root=np.pad(one.root, (0, count - len(one.place))),
        **{name: np.pad(getattr(one, name), more) for name in ("bend", "alone", "weights")},
    )


def _alike(here: Any, there: Any, reach: Any, numpy: Any) -> Any:
    """Correlation of the process between places, (b, n)."""
    off = (here[:, None] - there[None]) / reach[None, None]
    return numpy.exp(-(off**2).sum(axis=-1) / 2)
