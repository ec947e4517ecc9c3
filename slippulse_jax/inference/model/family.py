"""Lengths of whole events of blocks for fits, by families of blocks.

A whole event takes milliseconds, and its length steps where the order of its breaks changes. What a fit sees is continuous, and
its slope is the trend over many steps.

Over the height, a length depends on b, ν, the push, the prestress, where the block ends and what the pressure does, and hardly
on λc/H, in which it is linear. A `Family` is blocks that differ in b alone: their lengths are computed at nodes along ln b, on
contacts of two sizes that suit the measured length, and on ones of one size for blocks beside a measured one. Nodes are half as
far apart near a measured length as elsewhere; closer ones would follow the steps. Where a length falls at once, over b or over
friction, blocks on both sides are followed up to the fall, between which a length may be of either kind, and says so. Other
inputs that differ from what the table states, because they have an error, multiply it by the ratio of lengths that differ in
that input alone.

The emulator of series is no substitute: on 41 random tables it took 5 to 41 times the processor time, as it follows up to 36
times the events, and gave another verdict on 16, often for another root.
"""

import itertools
import sys
import time
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from tqdm.auto import tqdm

from slippulse_jax.base.status import Outcome
from slippulse_jax.blocks.size import FOLLOWED, MOST_HEIGHTS, extrapolated, followed, many, sites_at, suited, tall_lengths
from slippulse_jax.bulk.chunks import distinct_rows, workers
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.interpolation import Grid
from slippulse_jax.interface import Interface

AXES = {
    "poisson": 0.1, "prestress": 0.1, "log_push": 0.1, "log_push_width": 0.3, "log_ratio": 0.2, "friction": 0.02,
    "log_normal_stiffness": 0.5, "log_lost": 0.1,
}  # fmt: skip
"""Inputs that a block may differ in from the one it is followed from, and the spacing of the nodes in them; ln L/H is one, and
the logarithm of what contacts lose of their strength, 1 − r."""
FLAGS = ("push_force", "multicontact", "top_held")
"""Inputs that are 0 or 1."""
GEOMETRY = (*AXES, *FLAGS)
"""What is one geometry, beside λc/H."""
PRESTRESS, RATIO, FRICTION, NORMAL, MULTICONTACT = map(
    GEOMETRY.index, ("prestress", "log_ratio", "friction", "log_normal_stiffness", "multicontact")
)
SEARCHED = 3e-3, 1000.0
"""Range of b in which a fit searches, unless bounds go farther. Below it hardly any push starts a domino."""
LOG_SEARCHED = np.log(SEARCHED)
UNIT, WIDEST, AT_ENDS, BESIDE = 0.04, 32, 4, 8
"""Spacing of nodes in ln b next to a fall; in that unit, of the first ones, of those where events cease to stop,
and next to a fall of a block beside a measured one: a fall moves by that much in ln b over less than 0.0025 in friction."""
NEAR = {32: 1.5, 16: 1.1}
"""By the distance of two nodes, in that unit: up to which factor from a measured length another one is put between them."""
ALIKE = 2.0
"""Factor from a measured length up to which the first nodes are computed on contacts of two sizes."""
FAR, LIKE = 4.0, 1.25
"""Factor below the measured lengths from which on an event is of another kind, and up to which one is like them."""
PARTS = 8
"""Into how many parts a step of friction is divided where a length falls within it."""
TALLEST = 1e5
"""H/λc of a block at which λc/H is taken as 0."""
LOWEST, NARROWEST, STEEPEST = 0.005, 0.02, 0.99
"""Least distance of a push from the corners of the side, the least width of a patch, over H; and largest |ν| and |φ|."""
MANY = 20
"""Values of b at which a block that was not measured is looked at, above which it is followed."""
TOGETHER = 32
"""Most values of b of one block that are followed at once, and most coefficients of friction."""
FEW, LONG = 40, 5.0
"""Events, and a time in s, that are worth a word."""

Geometry = tuple[float, ...]
Key = tuple[Geometry, float, int]
"""Geometry; H/λc on whose contacts an event is followed, inf for those that suit it; and ln b over `UNIT`."""


class Node(NamedTuple):
    """ℓ/H of one event, and how far it may be off."""

    length: float
    error: float = 0.0


# --- blocks that differ in b alone ----------------------------------------------------------------------------------------


class Family:
    """Blocks of one geometry, which differ in b alone.

    `target` is the least and the largest measured ℓ/H, `height` H/λc of the contacts on which they are followed.
    What contacts of half the size change varies so slowly with b that the first nodes tell it.
    """

    def __init__(
        self,
        events: "Events",
        geometry: Geometry,
        target: tuple[float, float],
        height: float,
        *,
        measured: bool = True,
        tried: bool = False,
    ) -> None:
        self.events, self.geometry, self.target, self.height = events, geometry, target, height
        self.endless = bool(np.isinf(geometry[RATIO]))
        self.driven = self.endless and geometry[PRESTRESS] > 0  # such an event may go on for ever
        self.measured = measured and not self.driven
        self.at_falls, self.at_ends = (BESIDE, BESIDE) if tried or not self.measured else (1, AT_ENDS)
        self.near = {WIDEST: NEAR[WIDEST]} if tried else NEAR
        events.expect(geometry, height, height / 2)
        self.nodes: set[int] = set()
        self.drawn: tuple[frozenset[int], Any] = frozenset(), None

    def reach(self, low: float, high: float) -> bool:
        """Place the first nodes, and return whether there are new ones.

        They reach one farther than asked, and of a measured block wherever a fit searches.
        """
        cell, before = UNIT * WIDEST, len(self.nodes)
        first, last = int(np.floor(low / cell)), int(np.ceil(high / cell))
        least, most = int(np.floor(LOG_SEARCHED[0] / cell)), int(np.ceil(LOG_SEARCHED[1] / cell))
        if self.measured and least <= first and last <= most:
            first, last = least + 1, most - 1
        self.nodes |= {WIDEST * n for n in range(first - 1, last + 2)}
        return len(self.nodes) > before

    def missing(self) -> list[Key]:
        """What is to be computed next; nothing if all nodes are there."""
        while True:
            missing = [key for j in sorted(self.nodes) for key in self.keys(j) if key not in self.events.known]
            if missing or not (between := self._between()):
                return missing
            self.nodes |= between

    def keys(self, j: int) -> list[Key]:
        """Events of one node.

        On its contacts, perhaps on ones twice as large, and on ever larger ones if none stops.
        """
        known, height = self.events.known, self.height
        keys = [(self.geometry, np.inf if self.driven else height, j)]
        if self._of_two_sizes(j):
            keys.append((self.geometry, height / 2, j))
        larger = self.measured and self.endless
        while larger and all(key in known and np.isinf(known[key].length) for key in keys):
            if (height := keys[-1][1] / 2) * MOST_HEIGHTS < FOLLOWED:
                break
            keys.append((self.geometry, height, j))
        return keys

    def _of_two_sizes(self, j: int) -> bool:
        """Whether the size of contacts matters at a node.

        It does at first nodes of a length much like those measured.
        """
        own = self.events.known.get((self.geometry, self.height, j)) if self.measured and j % WIDEST == 0 else None
        return own is not None and self.target[0] < ALIKE * own.length < ALIKE**2 * self.target[1]

    def node(self, j: int) -> Node:
        """ℓ/H at one node, on the smallest contacts that stop it."""
        fine, *larger = (self.events.known[key] for key in self.keys(j))
        if np.isfinite(fine.length) or not self.endless:
            return fine
        last = min((one.length for one in larger), default=np.inf)
        return Node(last, 0.1 * last)

    def limit(self, j: int) -> float:
        """ℓ/H at one node on ever smaller contacts."""
        return self.node(j).length * (1 + (self._finer(j)[0] if self._of_two_sizes(j) else 0.0))

    def _finer(self, j: int) -> tuple[float, float]:
        """Share by which smaller contacts change a length, and its error."""
        fine, rough = (self.events.known[self.geometry, height, j].length for height in (self.height, self.height / 2))
        if not np.isfinite(rough):  # of another kind
            return 0.0, 1 / fine
        h, b = self.height, np.exp(UNIT * j)
        value, error = np.array(extrapolated(np.float64(fine * h), rough * h / 2, h, TALLEST, b)) / TALLEST / fine
        return value - 1, error

    def _between(self) -> set[int]:
        """Nodes missing near the measured length, and where events cease to stop."""
        (low, high), found = self.target, set()
        for left, right in itertools.pairwise(sorted(self.nodes)):
            apart, (a, b) = right - left, sorted((self.node(left).length, self.node(right).length))
            if _falls(a, b, low, high):
                near = apart > self.at_falls
            elif _kind(a) != _kind(b):
                near = apart > self.at_ends and b > low / FAR
            else:
                factor = self.near.get(apart, 0.0)
                near = _kind(a) == 1 and b * factor > low and a < high * factor
            if near:
                found.add((left + right) // 2)
        return found

    def __call__(self, log_b: Float[np.ndarray, " n"], inverse: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3 n"]:
        """ℓ/H, its error, and that next to a fall; nothing may be `missing`.

        By monotone cubics; `inverse` is λc/H. Next to an endless event the length is the last one, elsewhere without one inf.
        """
        if self.drawn[0] != self.nodes:
            self.drawn = frozenset(self.nodes), self._curve()
        at, value, runs, finer = self.drawn[1]
        i = np.clip(np.searchsorted(at, log_b, side="right") - 1, 0, len(at) - 2)
        found, off = np.full((2, len(log_b)), [[np.inf], [1.0]])
        for first, last, through in runs:
            inside = (i >= first - 1) & (i <= last)
            found[inside], off[inside] = through(np.clip(log_b[inside], at[first], at[last])).T
        change, error = (np.interp(log_b, finer[0], row) * (1 - self.height * inverse) for row in finer[1:])
        with np.errstate(invalid="ignore"):  # inf times zero
            off = off + np.where(np.isfinite(found), found * np.abs(error), 0)
            found = np.where(np.isfinite(found), np.maximum(found * (1 + change), 0), found)
        part = np.clip((log_b - at[i]) / (at[i + 1] - at[i]), 0, 1)
        return np.stack([found, off, _off(np.stack([value[i], value[i + 1]]), part, *self.target)])

    def _curve(self) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int, Any]], np.ndarray]:
        """Nodes, ℓ/H, runs of neighbours at which events stop, and `_finer`.

        Of each run the first node, the last, and what is between.
        """
        from scipy.interpolate import PchipInterpolator  # a quarter of a second, and most fits have no block

        order = np.array(sorted(self.nodes))
        at, value = UNIT * order, np.array([self.node(j) for j in order.tolist()])
        stops, runs = np.isfinite(value[:, 0]), []
        for run in np.split(np.arange(len(at)), np.flatnonzero(np.diff(stops)) + 1):
            if stops[run[0]]:
                alone = np.append(run, run[-1]) if len(run) == 1 else run  # a node by itself: the same all around
                place = at[run] if len(run) > 1 else at[run[0]] + np.array([-1.0, 1.0])
                runs.append((int(run[0]), int(run[-1]), PchipInterpolator(place, value[alone])))
        finer = [(UNIT * j, *self._finer(j)) for j in order.tolist() if self._of_two_sizes(j)]
        return at, value[:, 0], runs, np.array(finer or [(0.0, 0.0, 0.0)]).T


# --- blocks of a table ----------------------------------------------------------------------------------------------------


class Families:
    """Lengths of whole events of measured blocks and of any others."""

    def __init__(self, events: "Events | None" = None, *, tried: bool = False) -> None:
        self.events, self.tried = Events() if events is None else events, tried
        self.measured: list[Family] = []
        self.beside: dict[tuple[int, int], Family] = {}  # by parts of a step of friction from a measured one
        self.ratios: dict[tuple[int, int], Grid] = {}  # along an axis from a measured one

    def add(
        self,
        geometry: Float[np.ndarray, "m g"],
        ratio: Float[np.ndarray, " m"],
        height: float | Float[np.ndarray, " m"] = np.inf,
    ) -> "Families":
        """Add measured blocks, by `geometry_of` each, ℓ/H, and H/λc.

        None is followed on smaller contacts than its own.
        """
        rows, own = distinct_rows(geometry)
        for i, row in enumerate(rows.tolist()):
            here = own == i
            target = float(ratio[here].min()), float(ratio[here].max())
            largest = float(np.broadcast_to(height, own.shape)[here].max())
            own_height = _height(tuple(row), target, largest)
            self.measured.append(Family(self.events, tuple(row), target, own_height, tried=self.tried))
        return self

    def __call__(self, inputs: Inputs) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """ℓ, in λc, and how far each may be off.

        It is 0 where no domino starts, and inf where the event does not stop.
        """
        table = np.column_stack([geometry_of(inputs), inputs.log_b, np.exp(-inputs.log_height)])
        rows, own = distinct_rows(table)
        geometry, log_b, inverse = rows[:, : len(GEOMETRY)], rows[:, -2], rows[:, -1]
        origin = self._nearest(geometry)
        found, unlike = np.empty((2, len(rows))), origin < 0
        if unlike.any():
            found[:, unlike] = self._unlike(geometry[unlike], log_b[unlike], inverse[unlike])
        if not unlike.all():
            found[:, ~unlike] = self._like(origin[~unlike], geometry[~unlike], log_b[~unlike], inverse[~unlike])
        length, error = found / inverse
        return length[own], error[own]

    def _nearest(self, geometry: Float[np.ndarray, "n g"]) -> Int[np.ndarray, " n"]:
        """Number of the measured block that each is most like; −1 without."""
        best, least = np.full(len(geometry), -1), np.full(len(geometry), np.inf)
        kinds, own = _kinds(geometry), np.array([family.geometry for family in self.measured]).reshape(-1, len(GEOMETRY))
        for i, kind in enumerate(_kinds(own)):
            apart, same = np.abs(_offsets(geometry, own[i])).sum(axis=1), (kinds == kind).all(axis=1)
            nearer = same & (apart < least)
            best[nearer], least[nearer] = i, apart[nearer]
        return best

    def _like(
        self, origin: Int[np.ndarray, " n"], geometry: Float[np.ndarray, "n g"], log_b: np.ndarray, inverse: np.ndarray
    ) -> Float[np.ndarray, "2 n"]:
        """ℓ/H of blocks like measured ones, and its error."""
        offset = _offsets(geometry, np.array([family.geometry for family in self.measured])[origin])
        moved = np.abs(offset) > 1e-9
        left = PARTS * np.floor(offset[:, FRICTION] + 1e-9).astype(int)
        for i, parts in dict.fromkeys(zip(origin.tolist(), left.tolist(), strict=True)) if moved[:, FRICTION].any() else ():
            for side in (parts, parts + PARTS):  # expected from now on
                self._family(i, side)
        value, error, off = self._along([(i, 0) for i in origin.tolist()], log_b, inverse)
        lanes = np.flatnonzero(moved[:, FRICTION])
        if lanes.size:
            value[lanes], off[lanes] = self._over_friction(
                origin[lanes], offset[lanes, FRICTION], log_b[lanes], np.stack([value, off])[:, lanes]
            )
            moved[:, FRICTION] = False
        for axis in np.flatnonzero(moved.any(axis=0)).tolist():
            for i in np.unique(origin[moved[:, axis]]).tolist():
                lanes = np.flatnonzero(moved[:, axis] & (origin == i))
                (log_ratio, other), (alike, unlike) = self._ratio(i, axis)(
                    np.stack([log_b[lanes], offset[lanes, axis]], axis=1)
                )
                with np.errstate(all="ignore"):
                    alike = np.where(np.isfinite(value[lanes]), alike, 0)
                    times = np.where(alike > 0, alike * value[lanes] * np.exp(log_ratio), 0)
                    found = (times + np.where(unlike > 0, unlike * other, 0)) / (alike + unlike)
                value[lanes] = np.where(np.isnan(found), np.inf, found)
        return np.stack([value, np.hypot(error, off)])

    def _along(self, which: list[tuple[int, int]], log_b: np.ndarray, inverse: np.ndarray) -> Float[np.ndarray, "3 n"]:
        """ℓ/H of families, its error, and that next to a fall.

        By measured block and parts of friction.
        """
        number = np.array(which)
        every = [(self._family(*pair), np.flatnonzero((number == pair).all(axis=1))) for pair in dict.fromkeys(which)]
        asked = [family for family, lanes in every if family.reach(log_b[lanes].min(), log_b[lanes].max())]
        while missing := [key for family in asked for key in family.missing()]:
            self.events(missing)
        found = np.empty((3, len(log_b)))
        for family, lanes in every:
            found[:, lanes] = family(log_b[lanes], inverse[lanes])
        return found

    def _family(self, i: int, parts: int) -> Family:
        """A measured block, or one beside it by parts of a friction step."""
        origin = self.measured[i]
        if not parts:
            return origin
        if (i, parts) not in self.beside:
            moved = _moved(origin.geometry, FRICTION, parts / PARTS)
            self.beside[i, parts] = Family(self.events, moved, origin.target, origin.height, measured=False)
        return self.beside[i, parts]

    def _over_friction(
        self, origin: np.ndarray, offset: np.ndarray, log_b: np.ndarray, own: Float[np.ndarray, "2 n"]
    ) -> Float[np.ndarray, "2 n"]:
        """ℓ/H at other coefficients of friction, from blocks on both sides.

        Ever closer ones where it falls between. Their contacts have one size; `own`, of the measured blocks, says what smaller
        ones change. The second row is how far the first may be off where it falls.
        """
        heights = np.array([family.height for family in self.measured])[origin]
        with np.errstate(all="ignore"):
            factor = own[0] / self._along([(i, 0) for i in origin.tolist()], log_b, 1 / heights)[0]
        factor = np.where(np.isfinite(factor) & (factor > 0), factor, 1)

        def at(parts: Int[np.ndarray, " m"], lanes: Int[np.ndarray, " m"]) -> Float[np.ndarray, "2 m"]:
            beside = self._along(list(zip(origin[lanes].tolist(), parts.tolist(), strict=True)), log_b[lanes], 0 * log_b[lanes])
            return np.where(parts == 0, own[:, lanes], factor[lanes] * beside[::2])

        lanes, place = np.arange(len(offset)), PARTS * offset
        left, width = PARTS * np.floor(offset + 1e-9).astype(int), np.full(len(offset), PARTS)
        sides, off = at(np.concatenate([left, left + PARTS]), np.tile(lanes, 2)).reshape(2, 2, -1)
        target = np.array([self.measured[i].target for i in origin.tolist()]).T
        while (lanes := lanes[_falls(*np.sort(sides, axis=0), *target)[lanes] & (width[lanes] > 1)]).size:
            width[lanes] //= 2
            middle = left[lanes] + width[lanes]
            right = (place[lanes] >= middle).astype(int)
            sides[1 - right, lanes], off[1 - right, lanes] = at(middle, lanes)
            left[lanes] = np.where(right, middle, left[lanes])
        part = np.clip((place - left) / width, 0, 1)
        weight = np.stack([1 - part, part])
        return np.stack([_blended(sides, weight), np.hypot((weight * off).sum(axis=0), _off(sides, part, *target))])

    def _ratio(self, i: int, axis: int) -> Grid:
        """Logarithm of a length over the measured one; or, unlike it, the length.

        Over ln b and steps along an axis.
        """
        if (i, axis) not in self.ratios:
            self.ratios[i, axis] = Grid([WIDEST * UNIT, 1.0], partial(self._compared, self.measured[i], axis))
        return self.ratios[i, axis]

    def _compared(self, family: Family, axis: int, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Compare blocks steps aside with a measured one.

        On contacts of one size, whose error is the same, where both stop.
        """
        steps, nodes = np.rint(place[:, 1]).astype(int), np.rint(place[:, 0] / UNIT).astype(int).tolist()
        both = [[_moved(family.geometry, axis, m) for m in steps.tolist()], [family.geometry] * len(nodes)]
        both = [list(zip(every, nodes, strict=True)) for every in both]
        there, before = np.full((2, len(nodes)), np.inf)
        if not family.driven and axis != PRESTRESS:
            keys = [[(g, family.height, j) for g, j in every] for every in both]
            self.events(itertools.chain(*keys))
            there, before = (np.array([self.events.known[key].length for key in every]) for every in keys)
        longer = np.flatnonzero(~np.isfinite(there + before)).tolist()
        places = [every[k] for every in both for k in longer]
        alone = {g: Family(self.events, g, family.target, family.height) for g, _ in places}
        while missing := [key for g, j in places for key in alone[g].keys(j) if key not in self.events.known]:
            self.events(missing)
        there[longer], before[longer] = np.reshape([alone[g].limit(j) for g, j in places], (2, -1))
        least = family.target[0] / FAR  # an event of few breaks is another kind
        alike = np.isfinite(there) & np.isfinite(before) & (there > least) & (before > least) | (steps == 0)
        with np.errstate(all="ignore"):
            ratio = np.where(steps == 0, 0.0, np.log(there / before))
        return np.stack([np.where(alike, ratio, np.nan), np.where(alike | ~np.isfinite(there), np.nan, there)], axis=1)

    def _unlike(self, geometry: Float[np.ndarray, "n g"], log_b: np.ndarray, inverse: np.ndarray) -> Float[np.ndarray, "2 n"]:
        """ℓ/H of blocks that were not measured, and its error.

        Those at many b are families too.
        """
        rows, own = distinct_rows(geometry)
        found, often = np.empty((2, len(geometry))), (np.bincount(own) > MANY) | np.isfinite(rows[:, RATIO])
        once = ~often[own]
        if once.any():
            found[:, once] = _each(geometry[once], log_b[once], inverse[once])
        if often.any():
            middle = [
                np.flatnonzero(own == i)[np.argsort(log_b[own == i])[(own == i).sum() // 2]] for i in np.flatnonzero(often)
            ]
            height = np.array([1 / inverse[own == i].min() for i in range(len(rows))])
            without = geometry[middle].copy()
            without[:, RATIO] = np.inf
            ratio = _each(without, log_b[middle], inverse[middle])[0]
            usual = np.where(np.isfinite(ratio) & (ratio > 0), ratio, 1.0)
            alike = Families(self.events).add(rows[often], usual, height[often])
            lanes = ~once
            found[:, lanes] = alike._like(alike._nearest(geometry[lanes]), geometry[lanes], log_b[lanes], inverse[lanes])
        return found


# --- geometry -------------------------------------------------------------------------------------------------------------


def geometry_of(inputs: Inputs) -> Float[np.ndarray, "n g"]:
    """What the blocks are like, beside λc/H and b.

    Without an end, friction and what else is not among the inputs.
    """
    absent = {"log_sites": np.inf, "log_normal_stiffness": np.inf}

    def stated(name: str) -> np.ndarray:
        return inputs.get(name) if name in inputs.names else np.full_like(inputs.log_height, absent.get(name, 0))

    own = {"log_ratio": stated("log_sites") - inputs.log_height, "log_lost": np.log1p(-stated("residual_strength"))}
    return np.stack([own[name] if name in own else stated(name) for name in GEOMETRY], axis=-1)


def _moved(geometry: Geometry, axis: int, steps: float) -> Geometry:
    """Geometry so many steps along an axis."""
    moved = list(geometry)
    moved[axis] += steps * list(AXES.values())[axis]
    return tuple(moved)


def _is_pressed(geometry: Geometry) -> bool:
    """Whether the interface has a normal stiffness, so that friction matters."""
    return bool(np.isfinite(geometry[NORMAL]))


def _without_friction(geometry: Geometry) -> Geometry:
    return geometry[:FRICTION] + (0.0,) + geometry[FRICTION + 1 :]


def _ratio(geometry: Geometry) -> float:
    """L/H, inf without an end."""
    return float(np.exp(geometry[RATIO]))


def _sites(geometry: Geometry, height: float) -> int:
    """Contacts that are followed."""
    return sites_at(height, _ratio(geometry))


def _height(geometry: Geometry, target: tuple[float, float], own: float) -> float:
    """H/λc on whose contacts a measured block is followed.

    Half as many where balancing them takes iterations.
    """
    share = 0.5 if geometry[MULTICONTACT] else 1.0
    return suited(np.sqrt(target[0] * target[1]), own, _ratio(geometry), share)


def _kinds(geometry: Float[np.ndarray, "n g"]) -> Float[np.ndarray, "n f"]:
    """What blocks that are followed together must have in common."""
    return np.column_stack([geometry[:, len(AXES) :], np.isinf(geometry[:, : len(AXES)])])


def _alike(geometry: Float[np.ndarray, "n g"], height: Float[np.ndarray, " n"]) -> list[np.ndarray]:
    """Group blocks that can be followed together."""
    sites = [_sites(tuple(one), at) for one, at in zip(geometry, height, strict=True)]
    own = distinct_rows(np.column_stack([_kinds(geometry), sites, np.isinf(height)]))[1]
    return [np.flatnonzero(own == i) for i in range(own.max() + 1)]


def _offsets(geometry: Float[np.ndarray, "n g"], origin: Float[np.ndarray, "... g"]) -> Float[np.ndarray, "n a"]:
    """Distance in each of `AXES`, in spacings."""
    with np.errstate(invalid="ignore"):  # inf − inf: both push everything above, say
        apart = (geometry[:, : len(AXES)] - origin[..., : len(AXES)]) / np.array(list(AXES.values()))
    return np.where(np.isfinite(apart), apart, 0)


def _bodies(geometry: Float[np.ndarray, "n g"], height: np.ndarray, b: Any = 1.0) -> tuple[Any, Interface]:
    """Blocks of one kind, within their domains, and their interfaces."""
    poisson, prestress, log_push, log_width, log_ratio, friction, log_normal, log_lost, *flags = geometry.T
    force, multicontact, held = (bool(flag[0]) for flag in flags)
    poisson = np.clip(poisson, -STEEPEST, 0.5)
    at = np.clip(np.exp(log_push), 2 * LOWEST, 1 - 2 * LOWEST)
    patch = np.isfinite(log_width[0])
    width = np.minimum(np.maximum(np.exp(log_width), NARROWEST), 2 * (np.minimum(at, 1 - at) - LOWEST / 2)) if patch else None
    pressed = np.isfinite(log_normal[0])
    block = many(
        height, b / (2 * (1 + poisson) * height), poisson, at, width, "force" if force else "displacement",
        length=np.rint(np.exp(log_ratio) * height) if np.isfinite(log_ratio[0]) else None,
        normal_stiffness=np.exp(log_normal) if pressed else None, friction=np.maximum(friction, 0) if pressed else None,
        contact_law="multicontact" if multicontact else "amontons", top="held" if held else "free",
    )  # fmt: skip
    kept = -np.expm1(np.minimum(log_lost, 0)) if log_lost.any() else None
    return block, Interface(np.clip(prestress, -STEEPEST, STEEPEST), np.zeros(len(prestress)), kept)


# --- between nodes --------------------------------------------------------------------------------------------------------


def _blended(length: Float[np.ndarray, "2 n"], weight: Float[np.ndarray, "2 n"]) -> Float[np.ndarray, " n"]:
    """Length between two, of those that stop.

    Along a straight line of the logarithm where they are alike.
    """
    used = (weight > 0) & np.isfinite(length)
    share, low = (weight * used).sum(axis=0), np.where(used, length, np.inf).min(axis=0)
    with np.errstate(all="ignore"):
        alike = low * FAR > np.where(used, length, 0).max(axis=0)
        by_log = np.exp((weight * np.where(used, np.log(length), 0)).sum(axis=0) / share)
        return np.where(share > 0, np.where(alike, by_log, (weight * np.where(used, length, 0)).sum(axis=0) / share), np.inf)


def _off(sides: Float[np.ndarray, "2 n"], part: Float[np.ndarray, " n"], least: Any, most: Any) -> Float[np.ndarray, " n"]:
    """How far a length between two may be off where it falls.

    It falls at once, past measured ones, anywhere between the two.
    It is then the one or the other, as likely as it is near; this is the standard deviation.
    """
    low, high = np.sort(sides, axis=0)
    past = np.isfinite(high) & (low * FAR < high) & (high * LIKE > least) & (low < most * LIKE)
    return np.where(past, high - np.where(past, low, 0), 0) * np.sqrt(np.clip(part * (1 - part), 0, None))


def _falls(low: Any, high: Any, least: Any, most: Any) -> Any:
    """Whether a length like the measured ones falls to another kind."""
    return (low * FAR < high) & (high * LIKE > least) & (high < most * LIKE)


def _kind(value: float) -> int:
    """Whether a length is 0, finite, or endless."""
    return 0 if value <= 0 else 1 if np.isfinite(value) else 2


# --- events ---------------------------------------------------------------------------------------------------------------


class Events:
    """Whole events, each followed once for the object that asks for them.

    A block serves every b, and under pressure its response at a b every coefficient of friction: that of all expected.
    """

    def __init__(self) -> None:
        self.known: dict[Key, Node] = {}
        self.expected: dict[tuple[Geometry, float], dict[Geometry, None]] = {}
        self.pace = 0.0  # in s per event, of the last part whose program was compiled before; 0 until there is one

    def expect(self, geometry: Geometry, *heights: float) -> None:
        """Say that a geometry will be asked for, at these H/λc."""
        for height in heights:
            self.expected.setdefault((_without_friction(geometry), height), {})[geometry] = None

    def __call__(self, keys: Iterable[Key]) -> None:
        """Follow the events that are not known.

        ℓ/H is inf where one leaves the contacts followed, or the block lifts off.
        """
        asked: dict[tuple[Geometry, float], tuple[dict[Geometry, None], dict[int, None]]] = {}
        for geometry, height, j in keys:
            if (geometry, height, j) not in self.known:
                place = (geometry if np.isinf(height) else _without_friction(geometry)), height
                geometries, nodes = asked.setdefault(place, ({}, {}))
                geometries[geometry], nodes[j] = None, None
        if not asked:
            return
        at_once = min(-(-sum(len(nodes) for _, nodes in asked.values()) // workers()), TOGETHER)
        parts = []
        for (without, height), (geometries, nodes) in asked.items():
            for other in self.expected.get((without, height), ()):
                if any((other, height, j) not in self.known for j in nodes):
                    geometries[other] = None
            for some, at in itertools.product(_in_parts(geometries, TOGETHER), _in_parts(nodes, at_once)):
                parts.append([(geometry, height, j) for geometry in some for j in at])
        for alike in _alike(np.array([part[0][0] for part in parts]), np.array([part[0][1] for part in parts])):
            for some in self.announced([parts[i] for i in alike]):
                of_their_own = np.isinf(some[0][0][1])
                found = _driven(some) if of_their_own else _of_one_size(some)
                self.known.update(zip(itertools.chain(*some), found, strict=True))

    def announced(self, every: list[list[Key]]) -> Iterator[list[list[Key]]]:
        """Cut into parts of one per thread, and show progress.

        By a bar on a terminal; elsewhere by one line at first, and one with the time of each call that takes long.
        """
        delay = 0 if sys.stderr is not None and sys.stderr.isatty() else 2
        what = {"desc": "events followed (the first compiles)", "unit": " events", "delay": delay, "leave": False}
        left = sum(map(len, every))
        with tqdm(total=left, disable=None, **what) as bar:
            told = not bar.disable or sys.stderr is None
            if not told and left > FEW and not self.known:
                print(f"following at least {left} events of blocks", file=sys.stderr, flush=True)
            for start in range(0, len(every), workers()):
                if not told and self.pace * left > LONG:
                    told = True
                    print(f"following {left} events of blocks: about {self.pace * left:.0f} s", file=sys.stderr, flush=True)
                some, begun = every[start : start + workers()], time.monotonic()
                yield some
                count = sum(map(len, some))
                left -= count
                bar.update(count)
                self.pace = (time.monotonic() - begun) / count if start else self.pace


def _in_parts(every: Iterable[Any], size: int) -> list[list[Any]]:
    """Cut into parts of at most `size`."""
    every = list(every)
    return [every[i : i + size] for i in range(0, len(every), size)]


def _of_one_size(parts: list[list[Key]]) -> list[Node]:
    """ℓ/H of blocks of one kind.

    Each part is of one block, at every one of its coefficients of friction and, at each of these, values of b.
    """
    geometry, height = (np.array([part[0][i] for part in parts]) for i in (0, 1))
    friction, log_b = np.full((2, len(parts), TOGETHER), np.nan)
    shapes = []
    for i, part in enumerate(parts):
        coefficients, nodes = (
            list(dict.fromkeys(every)) for every in zip(*((key[0][FRICTION], key[2]) for key in part), strict=True)
        )
        friction[i, : len(coefficients)], log_b[i, : len(nodes)] = coefficients, UNIT * np.array(nodes)
        shapes.append((len(nodes), len(coefficients)))
    block, interface = _bodies(geometry, height)
    stiffness = np.exp(log_b) / (2 * (1 + block.poisson) * block.height)[:, None]
    pressed = np.maximum(friction, 0) if _is_pressed(parts[0][0][0]) else None
    length, _, status = followed((block, interface), stiffness, _sites(*parts[0][0][:2]), "full", pressed)
    length = np.where(np.isin(status, (Outcome.RAN_THROUGH, Outcome.LIFT_OFF)), np.inf, length) / block.height[:, None, None]
    return [Node(float(x)) for one, (m, f) in zip(length, shapes, strict=True) for x in one[:m, :f].T.ravel()]


def _driven(parts: list[list[Key]]) -> list[Node]:
    """ℓ/H of blocks whose event may never stop, and its error."""
    keys = list(itertools.chain(*parts))
    found = _each(
        np.array([key[0] for key in keys]), UNIT * np.array([key[2] for key in keys]), np.full(len(keys), 1 / TALLEST)
    )
    return [Node(float(value), float(off)) for value, off in found.T]


def _each(geometry: Float[np.ndarray, "n g"], log_b: np.ndarray, inverse: np.ndarray) -> Float[np.ndarray, "2 n"]:
    """ℓ/H of blocks without end, and its error.

    Each is followed on contacts that suit its own event.
    """
    found = np.empty((2, len(geometry)))
    height = 1 / np.maximum(inverse, 1 / TALLEST)
    for here in _alike(geometry, height):
        block, interface = _bodies(geometry[here], height[here], np.exp(log_b[here]))
        found[:, here] = np.stack(tall_lengths(block, interface, "full")) / height[here]
    return np.where(np.isnan(found[0]), [[np.inf], [1.0]], found)  # those that lift off
