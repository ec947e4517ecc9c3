"""Sequences of precursors of a block, for fits: forces by place.

A series is followed at given numbers, on at most `SITES` contacts of the same areal stiffness; forces of a block with more are
continued to their size, along which they change little. Its lengths jump with the order of breaks, and so, by some 0.01 μF_N,
does the force F^x(x) at which the front first reaches x. The slope that a fit needs is the trend over many orders; at a fixed
order it has the wrong sign beyond 0.4 L. So a prediction is a smooth function through many series (`Surface`), and a fit
chooses where these are.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.special import ndtr

from slippulse_jax.block import Block, Push, Top
from slippulse_jax.blocks.event import contacts_of, unattached
from slippulse_jax.blocks.size import ONE_BY_ONE
from slippulse_jax.bulk.chunks import Kernel, distinct_rows, over_lanes
from slippulse_jax.events.ageing import Ageing
from slippulse_jax.events.event import BREAKS_PER_SITE
from slippulse_jax.events.series import Adiabatic, Loading, load_through
from slippulse_jax.interface import Interface

SITES = 128
"""Most contacts of a block whose series is followed."""
COARSER = 80
"""Contacts of every other series of a block that has more than `SITES`."""
EVENTS = 4 * SITES
"""Most events of a series; a front that creeps by single contacts has one for each."""
TOGETHER = 8
"""Series of one geometry that are followed by one lane."""
GEOMETRY = ("poisson", "log_ratio", "log_push", "log_push_width", "log_normal_stiffness")
"""What the elastic block is: ν, and the logarithms of L/H, h/H, w/H and k_n/k."""
CONTACTS = ("log_b", "friction", "prestress", "log_machine", "newborn", "log_time", "threshold_scatter")
"""What may differ on one block: ln b, μ, φ, ln M/K, a newborn contact, ln τ over u_s, scatter of thresholds."""
WEAKEST = 0.05
"""Least threshold, over their mean, where they scatter."""


class Followed(NamedTuple):
    """Series of n blocks, by event; places over L, forces over μF_N."""

    reached: Float[np.ndarray, "n E"]  # farthest place; inf once the front spans, and after the last event
    force: Float[np.ndarray, "n E"]  # NaN after the last event, if none spans
    load: Float[np.ndarray, "n E"]  # displacement of the pusher, in u_s
    begin: Float[np.ndarray, "n E"]  # left side of the leftmost contact broken, over L
    end: Float[np.ndarray, "n E"]  # right side of the rightmost one; 0 after the last event

    @property
    def advance(self) -> Float[np.ndarray, "n E"]:
        """How much farther than all before each event gets, over L."""
        ends = np.minimum(self.reached, 1.0)
        return np.diff(ends, axis=1, prepend=0.0)

    def force_at(self, place: Float[np.ndarray, "*n m"], error: Float[np.ndarray, " m"]) -> np.ndarray:
        """Force at which the front first reaches places x/L.

        Averaged over their errors, and its spread; (2, n, m).
        """
        ends, error = np.minimum(self.reached, 2.0)[:, None], np.maximum(error, 1e-9)[:, None]
        below = np.where(np.isinf(self.reached)[:, None], 1.0, ndtr((ends - place[..., None]) / error))
        return self._averaged(np.diff(below, axis=-1, prepend=0.0))

    def force_of_arrest(self, place: Float[np.ndarray, "*n m"], error: Float[np.ndarray, " m"]) -> np.ndarray:
        """Force of the events that end at places x/L.

        Averaged over their errors, and its spread; (2, n, m). By how far they advance: a jump that ends there has been seen,
        and not the creep after it.
        """
        advance = self.advance[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):  # NaN where no event advances
            density = np.log(advance) - ((np.minimum(self.reached, 1.0)[:, None] - place[..., None]) / error[:, None]) ** 2 / 2
            density = np.where(advance > 1e-12, density, -np.inf)
            weight = np.exp(density - density.max(axis=-1, keepdims=True))
        return self._averaged(weight / weight.sum(axis=-1, keepdims=True))

    def _averaged(self, weight: Float[np.ndarray, "n m E"]) -> np.ndarray:
        parts = np.where(weight > 0, self.force[:, None], 0)
        mean = (weight * parts).sum(axis=-1)
        return np.stack([mean, np.sqrt(np.maximum((weight * parts**2).sum(axis=-1) - mean**2, 0))])

    def first(self, least: float) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Extent over L, and force, of the first event that is seen.

        It is the first that advances by more than `least`.
        """
        at = np.arange(len(self.force)), np.argmax(self.advance > least, axis=1)
        return np.minimum(self.reached[at], 1.0), self.force[at]


def followed(
    geometry: Float[np.ndarray, "n 5"],
    contacts: Float[np.ndarray, "n 7"],
    height: Float[np.ndarray, " n"] | float,
    *,
    top: Top = "free",
    first: int = 0,
) -> Followed:
    """Follow series of blocks of H/λc, each at its own numbers.

    Where thresholds scatter, each has its own, of as many draws from `first` on.
    """
    aged, wide = bool((contacts[:, CONTACTS.index("newborn")] < 1).any()), bool(np.isfinite(geometry[:, 3]).all())
    geometry = np.column_stack([geometry, np.broadcast_to(height, len(geometry))])
    blocks, own = distinct_rows(geometry)
    scattered = bool(contacts[:, CONTACTS.index("threshold_scatter")].any())
    contacts = np.column_stack([contacts, first + np.arange(len(contacts))])
    groups = [np.flatnonzero(own == i) for i in range(len(blocks))]
    parts = [rows[start : start + TOGETHER] for rows in groups for start in range(0, len(rows), TOGETHER)]
    lanes = np.empty((len(parts), geometry.shape[1] + TOGETHER * contacts.shape[1]))
    for lane, rows in zip(lanes, parts, strict=True):
        filled = contacts[np.resize(rows, TOGETHER)]
        lane[:] = np.concatenate([geometry[rows[0]], filled.ravel()])
    found = Followed(*np.empty((len(Followed._fields), len(contacts), EVENTS)))
    for column, values in zip(found, over_lanes(_series(aged, wide, scattered, top), [*lanes.T], ONE_BY_ONE), strict=True):
        for i, rows in enumerate(parts):
            column[rows] = values[: len(rows), :, i]
    return found


@functools.cache
def _series(aged: bool, wide: bool, scattered: bool, top: Top) -> Kernel:
    def of_lane(lane: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        numbers = lane[:, 0]
        poisson, *logs = numbers[: len(GEOMETRY)]
        ratio, height, width, normal = map(jnp.exp, logs)
        sites = jnp.minimum(jnp.rint(ratio * numbers[len(GEOMETRY)]), SITES)
        tall = sites / ratio
        push, per_b = Push(height, width if wide else None), 1 / (2 * (1 + poisson) * tall)

        def block(contacts: Array) -> Block:
            b, friction, machine = jnp.exp(contacts[0]), contacts[1], jnp.minimum(jnp.exp(contacts[3]), 1e12)
            length = sites.astype(jnp.int32)
            return Block(tall, b * per_b, poisson, push, "stress", length, normal, friction, "amontons", top, machine)

        points = numbers[len(GEOMETRY) + 1 :].reshape(TOGETHER, len(CONTACTS) + 1)
        bare = unattached(block(points[0]))

        def one(contacts: Array) -> tuple[Array, ...]:
            body = contacts_of(block(contacts), Interface(contacts[2], 0.0), SITES, bare)
            if scattered:
                drawn = jax.random.normal(jax.random.key(contacts[7].astype(jnp.int32)), (SITES,), body.threshold.dtype)
                threshold = body.threshold * jnp.maximum(1 + contacts[6] * drawn, WEAKEST)
                body = body._replace(threshold=threshold, alike=False)
            body = body.up_to(body.last)
            ageing = Ageing(contacts[4], jnp.exp(contacts[5])) if aged else None
            most = jnp.int32(BREAKS_PER_SITE * SITES)
            loading = Loading(Adiabatic(), ageing, jnp.asarray(jnp.inf), jnp.asarray(True), most, jnp.asarray(body.last))
            end = load_through((EVENTS, 0, 0, SITES), body, loading)
            event = jnp.arange(EVENTS)
            length, force = (end.rows[name][:-1] for name in ("length", "force_before"))
            reached = lax.cummax(jnp.where(event < end.number, length, jnp.inf)) / sites
            force = jnp.where(event < end.number, force / (body.stiffness * sites), jnp.nan)
            load, begin, farthest = (end.rows[name][:-1] for name in ("load", "leftmost", "extent"))
            return reached, force, load, begin / sites, farthest / sites

        return tuple(column[..., None] for column in lax.map(one, points))

    return of_lane


SIZES = 0.03, 0.05, 0.05, 0.1, 0.2, 0.06, 0.06, 0.03, 0.3, 0.06, 0.2, 0.02, 0.05
UNITS = dict(zip((*GEOMETRY, *CONTACTS, "log_extent"), SIZES, strict=True))  # the last of how places are read
"""Least half-width of a cloud in each number: the slope over less is that of single orders of breaks."""
REACH, SCATTER, USUAL_REACH, USUAL_SCATTER = (3.0, 60.0), (1e-3, 1.0), 6.0, 0.03
"""Lengths of a surface, in `UNITS`, and its scatter over its size, squared: their ranges, and those that are not tuned."""

TUNED = 200
"""Series by which lengths and scatter of a surface are tuned, the best ones."""
TOGETHER_READ = 256
"""Places at which derivatives are taken together."""
DOUBTED = 0.25
"""Error of a continuation to smaller contacts, over what it changes; contacts of a quarter of the size say 0.1 to 0.4."""


class Cloud:
    """Series followed at some numbers, and what was read from each."""

    def __init__(self) -> None:
        self.numbers = np.empty((0, len(UNITS)))
        self.values = np.empty((0, 0))
        self.coarse = np.empty(0)

    def add(
        self, numbers: Float[np.ndarray, "n d"], values: Float[np.ndarray, "n m"], coarse: float | np.ndarray = 0.0
    ) -> None:
        """Add series; what could not be read of one is NaN.

        `coarse` is how much larger their contacts are than those of the block, over its length.
        """
        self.coarse = np.append(self.coarse, np.broadcast_to(coarse, len(values)))
        self.values = np.concatenate([self.values.reshape(-1, values.shape[1]), values])
        self.numbers = np.concatenate([self.numbers, numbers])

    def nearest(self, numbers: Float[np.ndarray, "b d"]) -> Float[np.ndarray, "b m"]:
        """What was read from the series nearest to each."""
        here, place = coordinates(numbers), coordinates(self.numbers)
        apart = (here**2).sum(axis=1)[:, None] - 2 * here @ place.T + (place**2).sum(axis=1)
        return self.values[apart.argmin(axis=1)]


class Surface:
    """What was read from series as a smooth function of their numbers.

    A Gaussian process about a plane, with scatter (kriging: Sacks et al., Stat. Sci. 4, 409, 1989); its lengths and scatter are
    those of the largest likelihood if `tuned`. Where contacts are larger than those of the block, it is continued along a
    straight line in their size.
    """

    def __init__(self, cloud: Cloud, rows: np.ndarray, tuned: bool = False) -> None:
        rows = rows[np.isfinite(cloud.values[rows]).all(axis=1)]
        place, self.coarse, values = coordinates(cloud.numbers[rows]), cloud.coarse[rows], cloud.values[rows]
        self.moving = np.ptp(place, axis=0) > 0
        self.place, self.middle = place[:, self.moving], place[:, self.moving].mean(axis=0)
        self.size = np.maximum(values.std(axis=0), 1e-9)
        self.values = values / self.size
        self.plane = np.column_stack([np.ones(len(rows)), self.place - self.middle, SITES * self.coarse])
        self.plane = self.plane if self.coarse.any() else self.plane[:, :-1]
        logs = np.log(np.append(np.full(self.place.shape[1], USUAL_REACH), USUAL_SCATTER))
        if tuned:
            bounds = [*[tuple(np.log(REACH))] * self.place.shape[1], tuple(np.log(SCATTER))]
            how = {"maxfev": 40 * len(logs), "xatol": 0.05, "fatol": 0.5}
            logs = minimize(self._through, logs, args=(slice(TUNED),), method="Nelder-Mead", bounds=bounds, options=how).x
        self._through(logs, slice(None))
        self.inverse = cho_solve(self.factor, np.eye(len(rows)))
        known = self.inverse - self.weights @ self.spread @ self.weights.T
        self.alone = (known @ self.values) / np.diag(known)[:, None]  # how far each series lies from the others

    def _through(self, logs: np.ndarray, some: slice) -> float:
        """Go through some series, at lengths and scatter; −ln of their likelihood."""
        self.reach, self.scatter = np.exp(logs[:-1]), np.exp(logs[-1])
        plane, y = self.plane[some], self.values[some]
        kernel = self._alike(self.place[some])[:, some]
        self.factor = cho_factor(kernel + self.scatter * np.eye(len(y)), lower=True)
        self.weights = cho_solve(self.factor, plane)
        self.spread = np.linalg.pinv(plane.T @ self.weights, rcond=1e-10, hermitian=True)  # inputs may move together
        self.slope = self.spread @ self.weights.T @ y
        self.bend = cho_solve(self.factor, y - plane @ self.slope)
        left = np.maximum(((y - plane @ self.slope) * self.bend).mean(axis=0), 1e-12)
        return len(y) * np.log(left).sum() / 2 + y.shape[1] * np.log(np.diag(self.factor[0])).sum()

    def _alike(self, place: np.ndarray) -> np.ndarray:
        here, there = place / self.reach, self.place / self.reach
        apart = (here**2).sum(axis=1)[:, None] - 2 * here @ there.T + (there**2).sum(axis=1)
        return np.exp(-np.maximum(apart, 0) / 2)

    def __call__(self, numbers: Float[np.ndarray, "b d"]) -> tuple[Float[np.ndarray, "b m"], Float[np.ndarray, " b"]]:
        """Values at numbers; and how many series are near."""
        place = coordinates(numbers)[:, self.moving]
        alike = self._alike(place)
        plane = np.column_stack([np.ones(len(place)), place - self.middle])
        return (plane @ self.slope[: plane.shape[1]] + alike @ self.bend) * self.size, alike.sum(axis=1)

    def derivatives(self, numbers: Float[np.ndarray, "b d"]) -> tuple[Float[np.ndarray, "b c m"], Float[np.ndarray, "b c c m"]]:
        """First and second derivatives of the values in the moving coordinates."""
        place, count = coordinates(numbers)[:, self.moving], self.place.shape[1]
        first = np.empty((len(place), count, self.values.shape[1]))
        second = np.empty((len(place), count, count, self.values.shape[1]))
        for start in range(0, len(place), TOGETHER_READ):
            here = slice(start, start + TOGETHER_READ)
            off = (self.place.T - place[here][:, :, None]) / self.reach[:, None] ** 2
            bent = off * self._alike(place[here])[:, None]
            first[here] = bent @ self.bend + self.slope[1 : 1 + count]
            curved = (
                bent[:, :, None] * off[:, None]
                - np.eye(count)[..., None] / self.reach[:, None, None] ** 2 * (self._alike(place[here])[:, None, None])
            )
            second[here] = curved @ self.bend
        return first * self.size, second * self.size

    def covariance(self, numbers: Float[np.ndarray, " d"]) -> Float[np.ndarray, "m m"]:
        """Covariance of how far series around these numbers lie from it.

        With its own error; where it is continued to smaller contacts, `DOUBTED` of that too.
        """
        place = coordinates(numbers[None])[:, self.moving]
        weight = self._alike(place)[0]
        plane = np.zeros(self.plane.shape[1])
        plane[: 1 + place.shape[1]] = 1.0, *(place[0] - self.middle)
        off = plane - weight @ self.weights
        own = max(1 - weight @ self.inverse @ weight, 0) + off @ self.spread @ off
        alone = self.alone * self.size
        found = (weight * alone.T) @ alone / weight.sum() * (1 + own / self.scatter)
        if not self.coarse.any():
            return found
        doubt = DOUBTED * SITES * self.coarse.min() * self.slope[-1] * self.size
        return found + np.outer(doubt, doubt)


def coordinates(numbers: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    """Numbers in `UNITS`; of friction its logarithm."""
    place = np.clip(numbers, -50.0, 10.0)
    friction = [*UNITS].index("friction")
    place[:, friction] = np.log(np.maximum(numbers[:, friction], 1e-3))
    return place / np.array([*UNITS.values()])
