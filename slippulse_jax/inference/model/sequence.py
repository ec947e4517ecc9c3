"""Sequences of precursors of a block, for fits: forces by place.

A series is followed at given numbers, on at most `SITES` contacts of the same areal stiffness: what a front does hardly depends
on their size. Its lengths jump with the order of breaks, and so, by some 0.01 μF_N, does the force F^x(x) at which the front
first reaches x. The slope that a fit needs is the trend over many orders; at a fixed order it has the wrong sign beyond 0.4 L.
So a prediction is a polynomial through many series (`Surface`), and a fit chooses where these are.
"""

import functools
import itertools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
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
EVENTS = 4 * SITES
"""Most events of a series; a front that creeps by single contacts has one for each."""
TOGETHER = 8
"""Series of one geometry that are followed by one lane."""
GEOMETRY = ("poisson", "log_ratio", "log_push", "log_push_width", "log_normal_stiffness")
"""What the elastic block is: ν, and the logarithms of L/H, h/H, w/H and k_n/k."""
CONTACTS = ("log_b", "friction", "prestress", "log_machine", "newborn", "log_time")
"""What may differ on one block: ln b, μ, φ, ln M/K, and the strength of a newborn contact and ln τ over u_s."""


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

    def force_at(self, place: Float[np.ndarray, " m"], error: Float[np.ndarray, " m"]) -> np.ndarray:
        """Force at which the front first reaches places x/L.

        Averaged over their errors, and its spread; (2, n, m).
        """
        ends = np.minimum(self.reached, 2.0)[:, None]
        below = np.where(np.isinf(self.reached)[:, None], 1.0, ndtr((ends - place[:, None]) / np.maximum(error, 1e-9)[:, None]))
        return self._averaged(np.diff(below, axis=-1, prepend=0.0))

    def force_of_arrest(self, place: Float[np.ndarray, " m"], error: Float[np.ndarray, " m"]) -> np.ndarray:
        """Force of the events that end at places x/L.

        Averaged over their errors, and its spread; (2, n, m). By how far they advance: a jump that ends there has been seen,
        and not the creep after it.
        """
        advance = self.advance[:, None]
        with np.errstate(divide="ignore"):
            density = np.log(advance) - ((np.minimum(self.reached, 1.0)[:, None] - place[:, None]) / error[:, None]) ** 2 / 2
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
    contacts: Float[np.ndarray, "n 6"],
    height: float,
    *,
    top: Top = "free",
) -> Followed:
    """Follow series of blocks of H/λc, each at its own numbers."""
    aged, wide = bool((contacts[:, CONTACTS.index("newborn")] < 1).any()), bool(np.isfinite(geometry[:, 3]).all())
    blocks, own = distinct_rows(geometry)
    groups = [np.flatnonzero(own == i) for i in range(len(blocks))]
    parts = [rows[start : start + TOGETHER] for rows in groups for start in range(0, len(rows), TOGETHER)]
    lanes = np.empty((len(parts), len(GEOMETRY) + 1 + TOGETHER * len(CONTACTS)))
    for lane, rows in zip(lanes, parts, strict=True):
        filled = contacts[np.resize(rows, TOGETHER)]
        lane[:] = np.concatenate([geometry[rows[0]], [height], filled.ravel()])
    found = Followed(*np.empty((len(Followed._fields), len(contacts), EVENTS)))
    for column, values in zip(found, over_lanes(_series(aged, wide, top), [*lanes.T], ONE_BY_ONE), strict=True):
        for i, rows in enumerate(parts):
            column[rows] = values[: len(rows), :, i]
    return found


@functools.cache
def _series(aged: bool, wide: bool, top: Top) -> Kernel:
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

        points = numbers[len(GEOMETRY) + 1 :].reshape(TOGETHER, len(CONTACTS))
        bare = unattached(block(points[0]))

        def one(contacts: Array) -> tuple[Array, ...]:
            body = contacts_of(block(contacts), Interface(contacts[2], 0.0), SITES, bare)
            there = jnp.arange(SITES) < sites
            body = body._replace(
                threshold=jnp.where(there, body.threshold, jnp.inf), prestress=jnp.where(there, body.prestress, 0)
            )
            ageing = Ageing(contacts[4], jnp.exp(contacts[5])) if aged else None
            most = jnp.int32(BREAKS_PER_SITE * SITES)
            loading = Loading(Adiabatic(), ageing, jnp.asarray(jnp.inf), jnp.asarray(True), most)
            end = load_through((EVENTS, 0, 0, SITES), body, loading)
            event = jnp.arange(EVENTS)
            length, force = (end.rows[name][:-1] for name in ("length", "force_before"))
            reached = lax.cummax(jnp.where(event < end.number, length, jnp.inf)) / sites
            force = jnp.where(event < end.number, force / (body.stiffness * sites), jnp.nan)
            load, begin, farthest = (end.rows[name][:-1] for name in ("load", "leftmost", "extent"))
            return reached, force, load, begin / sites, farthest / sites

        return tuple(column[..., None] for column in lax.map(one, points))

    return of_lane


UNITS = dict(zip((*GEOMETRY, *CONTACTS), (0.03, 0.05, 0.05, 0.1, 0.2, 0.06, 0.06, 0.03, 0.3, 0.06, 0.2), strict=True))
"""Least half-width of a cloud in each number: the slope over less is that of single orders of breaks."""
HIGHEST, PER_TERM = 4, 2.5
"""Highest degree of a surface, and the least number of series, by their weights, for each of its coefficients."""


class Cloud:
    """Series followed at some numbers, and what was read from each."""

    def __init__(self) -> None:
        self.numbers = np.empty((0, len(UNITS)))
        self.values = np.empty((0, 0))

    def add(self, numbers: Float[np.ndarray, "n d"], values: Float[np.ndarray, "n m"]) -> None:
        """Add series; what could not be read of one is NaN."""
        self.values = np.concatenate([self.values.reshape(-1, values.shape[1]), values])
        self.numbers = np.concatenate([self.numbers, numbers])

    def nearest(self, numbers: Float[np.ndarray, "b d"]) -> Float[np.ndarray, "b m"]:
        """What was read from the series nearest to each."""
        here, place = coordinates(numbers), coordinates(self.numbers)
        apart = (here**2).sum(axis=1)[:, None] - 2 * here @ place.T + (place**2).sum(axis=1)
        return self.values[apart.argmin(axis=1)]


class Surface:
    """A polynomial through what was read from series: a response surface.

    By weighted least squares (Box and Wilson). Its degree is the one that predicts each series best from the others. `scatter`
    is how far the series lie from it.
    """

    def __init__(self, cloud: Cloud, weight: Float[np.ndarray, " n"]) -> None:
        place = coordinates(cloud.numbers)
        self.moving = np.ptp(place, axis=0) > 0
        inside = np.isfinite(cloud.values).all(axis=1) & (weight > 0)
        x, y, w = place[inside][:, self.moving], cloud.values[inside], weight[inside]
        share = w / w.sum()
        self.centre = share @ x
        self.scale = np.maximum(np.sqrt(share @ (x - self.centre) ** 2), 1e-9)
        off = (x - self.centre) / self.scale
        self.inverse = np.linalg.pinv((share * off.T) @ off, rcond=1e-9, hermitian=True)
        self.reach = np.maximum(self._apart(x).max(initial=0.0), 1e-9)
        self.scatter = np.full(y.shape[1], np.inf)
        count = w.sum() ** 2 / (w**2).sum()  # of series of equal weight
        typical = np.maximum(np.abs(share @ y), 1e-9)
        best = np.inf
        for degree in range(1, HIGHEST + 1):
            powers = _powers(x.shape[1], degree)
            if degree > 1 and PER_TERM * len(powers) > count:
                break
            design = self._design(x, powers) * np.sqrt(w)[:, None]
            u, s, v = np.linalg.svd(design, full_matrices=False)
            kept = s > 1e-9 * s[0]
            coefficients = (v[kept].T / s[kept]) @ (u[:, kept].T @ (y * np.sqrt(w)[:, None]))
            left = (y * np.sqrt(w)[:, None] - design @ coefficients) / np.maximum(1 - (u[:, kept] ** 2).sum(1), 1e-3)[:, None]
            alone = np.sqrt((left**2).sum(axis=0) / w.sum())  # each series predicted from the others
            score = float((np.minimum(alone / typical, 1.0) ** 2).sum())
            if score < best:
                best, self.powers, self.coefficients, self.scatter = score, powers, coefficients, alone

    def _design(self, x: np.ndarray, powers: list[tuple[int, ...]]) -> np.ndarray:
        z = (x - self.centre) / self.scale
        return np.stack([np.prod(z[:, list(term)], axis=1) for term in powers], axis=1)

    def __call__(self, numbers: Float[np.ndarray, "b d"]) -> tuple[Float[np.ndarray, "b m"], Float[np.ndarray, " b"]]:
        """Values at numbers; distances from the middle, at most 1 inside."""
        x = coordinates(numbers)[:, self.moving]
        return self._design(x, self.powers) @ self.coefficients, self._apart(x) / self.reach

    def _apart(self, x: np.ndarray) -> np.ndarray:
        off = (x - self.centre) / self.scale
        return np.einsum("bi,ij,bj->b", off, self.inverse, off)


def _powers(d: int, degree: int) -> list[tuple[int, ...]]:
    return [term for n in range(degree + 1) for term in itertools.combinations_with_replacement(range(d), n)]


def coordinates(numbers: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    """Numbers in `UNITS`; of friction its logarithm."""
    place = np.clip(numbers, -50.0, 10.0)
    friction = [*UNITS].index("friction")
    place[:, friction] = np.log(np.maximum(numbers[:, friction], 1e-3))
    return place / np.array([*UNITS.values()])
