"""Lengths of whole events of blocks for fits: each measured block is followed along ln b on its own geometry.

A whole event takes milliseconds, and its length steps where the order of its breaks changes. What a fit sees is continuous, and
its slope is the trend over many steps.

Over the height, a length depends on b, ν, the push, the prestress, where the block ends and what the pressure does, and hardly
on λc/H, in which it is linear. For every distinct block of a table it is computed at nodes along ln b, few where it is far from
the measured one and more where it is near: on the block's own contacts and on ones twice as large, or, of a tall block, on
contacts of two sizes that suit the measured length. Over friction, in which a length may fall at once, blocks on both sides are
followed alike. Between the nodes on the two sides of a fall a length may be of either kind, and says so. Other inputs that
differ from what the table states, because they have an error, multiply it by the ratio of lengths that differ in that
input alone. Nodes are kept for the next fit.
"""

import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from tqdm.auto import tqdm

from slippulse_jax.bulk.chunks import distinct_rows, workers
from slippulse_jax.events.resolution import FOLLOWED, MOST_HEIGHTS, extrapolated, followed, many, tall_lengths
from slippulse_jax.inference.inputs import Inputs
from slippulse_jax.interface import Interface
from slippulse_jax.status import Outcome

AXES = {
    "poisson": 0.1, "prestress": 0.1, "log_push": 0.1, "log_push_width": 0.3, "log_ratio": 0.2, "friction": 0.02,
    "log_normal_stiffness": 0.5,
}  # fmt: skip
"""Inputs that a block may differ in from the one it is followed from, and the spacing of the nodes in them; ln L/H is one."""
FLAGS = ("push_force", "multicontact", "top_held")
"""Inputs that are 0 or 1."""
GEOMETRY = (*AXES, *FLAGS)
"""What is one geometry, beside λc/H."""
WITHOUT_END, FRICTION, MULTICONTACT = (GEOMETRY.index(name) for name in ("log_ratio", "friction", "multicontact"))
UNIT, CLOSE, WIDEST = 0.04, 4, 32
"""Spacing of nodes in ln b next to a fall; in that unit, of those near a measured length, and of the first ones."""
NEAR = {32: 1.5, 16: 1.2, 8: 1.1}
"""By the distance of two nodes, in that unit: up to which factor from a measured length another one is put between them."""
FAR, LIKE = 4.0, 1.25
"""Factor below the measured lengths from which on an event is of another kind, and up to which one is like them."""
BREAKING = 150
"""Contacts that an event as long as measured should break, of those that are followed."""
PARTS = 8
"""Into how many parts a step of friction is divided where a length falls within it."""
SMALLEST = 4.0
"""Least H/λc of a block that is followed: its larger contacts are twice as large."""
TALLEST = 1e5
"""H/λc of a block at which λc/H is taken as 0."""
LOWEST, NARROWEST, STEEPEST = 0.005, 0.02, 0.99
"""Least distance of a push from the corners of the side, the least width of a patch, over H; and largest |ν| and |φ|."""
OF_END = 128
"""Contacts of each height of a block that ends, at most; their number is a power of 2, and at least twice `FOLLOWED`."""
MANY = 20
"""Values of b at which a block that was not measured is looked at, above which it is followed."""
TOGETHER, RUBBING = 4, 32
"""Nodes of one block computed at once: of several b, or, at one b, of several coefficients of friction."""
COMPILING, AN_EVENT, FEW = 10, 0.4, 10
"""Usual times in s to compile, and of a part of several events; and how many of these take no time worth a word."""

NONE = np.empty((0, len(GEOMETRY)))
"""No blocks."""
Geometry = tuple[float, ...]
Run = tuple[int, int, Callable[[np.ndarray], np.ndarray]]
"""First and last node, and what a `Node` has between them."""


class Node(NamedTuple):
    """ℓ/H at one ln b: ``value + slope λc/H``, and how far it may be off."""

    value: float
    slope: float
    error: float


class Curve(NamedTuple):
    """Nodes of one block along ln b, in order."""

    at: Float[np.ndarray, " n"]
    value: Float[np.ndarray, " n"]  # ℓ/H
    runs: list[Run]  # of neighbours at which the event stops


Key = tuple[Geometry, float, int]
"""Geometry, H/λc on whose contacts it is followed, and ln b over `UNIT`."""
_known: dict[tuple[Geometry, float], dict[int, Node]] = {}
"""Nodes that were computed, of each geometry and H/λc by their ln b."""
_computed: dict[Key, float] = {}
"""ℓ/H on contacts of one size."""


class BlockLengths:
    """Lengths of whole events of blocks like m measured ones: their `geometry_of`, lengths over H, and H/λc.

    None is followed on smaller contacts than its own.
    """

    def __init__(
        self,
        geometry: Float[np.ndarray, "m g"] = NONE,
        ratio: Float[np.ndarray, " m"] = NONE[:, 0],
        height: float | Float[np.ndarray, " m"] = np.inf,
    ) -> None:
        rows, own = distinct_rows(geometry)
        self.origins: list[Geometry] = [tuple(row) for row in rows.tolist()]
        self.target = [(float(ratio[own == i].min()), float(ratio[own == i].max())) for i in range(len(rows))]
        own_height = [float(np.broadcast_to(height, own.shape)[own == i].max()) for i in range(len(rows))]
        # H/λc on whose contacts each is followed
        self.heights = [_height(*every) for every in zip(self.origins, self.target, own_height, strict=True)]
        self.measured = len(rows)
        # number of a block that differs from a measured one by parts of a step of friction
        self.beside: dict[tuple[int, int], int] = {}
        self.curves: dict[int, Curve] = {}
        self.nodes: list[set[int]] = [set() for _ in rows]

    def __call__(self, inputs: Inputs) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """ℓ, in λc, and how far each may be off.

        It is 0 where no domino starts, and inf where the event does not stop.
        """
        table = np.column_stack([geometry_of(inputs), inputs.log_b, np.exp(-inputs.log_height)])
        rows, own = distinct_rows(table)
        geometry, log_b, inverse = rows[:, : len(GEOMETRY)], rows[:, -2], rows[:, -1]
        origin = self._nearest(geometry)
        found = np.empty((2, len(rows)))
        alone = origin < 0
        if alone.any():
            found[:, alone] = _others(geometry[alone], log_b[alone], inverse[alone])
        if not alone.all():
            lanes = ~alone
            found[:, lanes] = self._followed(origin[lanes], geometry[lanes], log_b[lanes], inverse[lanes])
        length, error = found / inverse
        return length[own], error[own]

    def _nearest(self, geometry: Float[np.ndarray, "n g"]) -> Int[np.ndarray, " n"]:
        """Number of the measured block that each is most like; −1 where there is none with such a pusher."""
        best, least = np.full(len(geometry), -1), np.full(len(geometry), np.inf)
        for i, origin in enumerate(self.origins[: self.measured]):
            apart = np.abs(_offsets(geometry, np.array(origin))).sum(axis=1)
            same = (_kinds(geometry) == _kinds(np.array([origin]))).all(axis=1)
            nearer = same & (apart < least)
            best[nearer], least[nearer] = i, apart[nearer]
        return best

    def _followed(
        self, origin: np.ndarray, geometry: Float[np.ndarray, "n g"], log_b: np.ndarray, inverse: np.ndarray
    ) -> Float[np.ndarray, "2 n"]:
        offset = _offsets(geometry, np.array(self.origins)[origin])
        moved, cell, share = np.abs(offset) > 1e-9, *_cells(log_b / UNIT / WIDEST)
        value, error, off = self._along(origin, log_b, inverse)
        lanes = np.flatnonzero(moved[:, FRICTION])
        if lanes.size:
            value[lanes], off[lanes] = self._over_friction(
                origin[lanes], offset[lanes, FRICTION], log_b[lanes], np.stack([value, off])[:, lanes]
            )
            moved[:, FRICTION] = False
        for axis in np.flatnonzero(moved.any(axis=0)).tolist():
            lanes = np.flatnonzero(moved[:, axis])
            step, part = _cells(offset[lanes, axis])
            there, before = self._beside(origin[lanes], axis, step, WIDEST * cell[lanes])
            least = np.array([low / FAR for low, _ in self.target])[origin[lanes]]  # an event of few breaks is another kind
            weight = np.stack([1 - part, part])[:, None] * np.stack([1 - share[lanes], share[lanes]])[None]
            used = (weight > 0) & np.isfinite(there)
            still = np.stack([step == 0, step == -1])[:, None] & np.isfinite(value[lanes])  # as measured
            good = used & np.isfinite(before) & ((there > least) & (before > least) | still)
            share_good, share_used = ((weight * every).sum(axis=(0, 1)) for every in (good, used))
            with np.errstate(all="ignore"):
                log_ratio = (weight * np.where(good & ~still, np.log(there / before), 0)).sum(axis=(0, 1)) / share_good
                alike = np.where(share_good > 0, share_good * value[lanes] * np.exp(log_ratio), 0)
                others = (weight * np.where(used & ~good, there, 0)).sum(axis=(0, 1))  # by themselves
                value[lanes] = np.where(share_used > 0, (alike + others) / share_used, np.inf)
        return np.stack([value, np.hypot(error, off)])

    def _along(self, which: np.ndarray, log_b: np.ndarray, inverse: np.ndarray) -> Float[np.ndarray, "3 n"]:
        """ℓ/H along the curves of some blocks, its error, and how far it may be off where it falls."""
        every = np.unique(which).tolist()
        curves = self._curves({i: (log_b[which == i].min(), log_b[which == i].max()) for i in every})
        found = np.empty((3, len(log_b)))
        for i in every:
            here = which == i
            found[:, here] = _between(curves[i], log_b[here], inverse[here], self.heights[i], self.target[i])
        return found

    def _over_friction(
        self, origin: np.ndarray, offset: np.ndarray, log_b: np.ndarray, own: Float[np.ndarray, "2 n"]
    ) -> Float[np.ndarray, "2 n"]:
        """ℓ/H at other coefficients of friction, from blocks followed on both sides; ever closer ones where it falls between.

        Their contacts have one size; `own`, of the measured blocks, says what smaller ones change. The second row is how far
        the first may be off where it falls.
        """
        with np.errstate(all="ignore"):
            factor = own[0] / self._along(origin, log_b, 1 / np.array(self.heights)[origin])[0]
        factor = np.where(np.isfinite(factor) & (factor > 0), factor, 1)

        def at(parts: Int[np.ndarray, " m"], lanes: Int[np.ndarray, " m"]) -> Float[np.ndarray, "2 m"]:
            pairs = zip(origin[lanes].tolist(), parts.tolist(), strict=True)
            near = np.array([self._with_friction(i, number) for i, number in pairs])
            beside = self._along(near, log_b[lanes], 0 * log_b[lanes])[::2]
            return np.where(near == origin[lanes], own[:, lanes], factor[lanes] * beside)

        lanes, place = np.arange(len(offset)), PARTS * offset
        left, width = PARTS * _cells(offset)[0], np.full(len(offset), PARTS)
        sides, off = at(np.concatenate([left, left + PARTS]), np.tile(lanes, 2)).reshape(2, 2, -1)
        target = np.array(self.target).T[:, origin]
        while (lanes := lanes[_falls(*np.sort(sides, axis=0), *target)[lanes] & (width[lanes] > 1)]).size:
            width[lanes] //= 2
            middle = left[lanes] + width[lanes]
            right = (place[lanes] >= middle).astype(int)
            sides[1 - right, lanes], off[1 - right, lanes] = at(middle, lanes)
            left[lanes] = np.where(right, middle, left[lanes])
        part = (place - left) / width
        weight = np.stack([1 - part, part])
        return np.stack([_blended(sides, weight), np.hypot((weight * off).sum(axis=0), _off(sides, part, *target))])

    def _with_friction(self, i: int, parts: int) -> int:
        """Number of the block that differs from a measured one by so many parts of a step of friction."""
        if parts and (i, parts) not in self.beside:
            self.beside[i, parts] = len(self.origins)
            self.origins.append(self._moved(i, FRICTION, parts / PARTS))
            self.target.append(self.target[i])
            self.heights.append(self.heights[i])
            self.nodes.append(set())
        return self.beside[i, parts] if parts else i

    def _beside(self, origin: np.ndarray, axis: int, step: np.ndarray, j: np.ndarray) -> Float[np.ndarray, "2 2 2 n"]:
        """ℓ/H of blocks moved so many steps along an axis or one more, at two nodes in ln b; and of the blocks themselves."""
        rows, own = distinct_rows(np.column_stack([origin, step, j]).astype(float))
        moved, still = [], []
        for side in (0, 1):
            for beside in (0, WIDEST):
                for i, m, node in rows.astype(int).tolist():
                    height = self.heights[i]
                    moved.append((self._moved(i, axis, m + side), height, node + beside))
                    still.append((self.origins[i], height, node + beside))
        values = _beside_each_other(moved, still)
        return values.reshape(2, 2, 2, -1)[..., own]

    def _moved(self, i: int, axis: int, steps: float) -> Geometry:
        moved = list(self.origins[i])
        moved[axis] += steps * list(AXES.values())[axis]
        return tuple(moved)

    def _curves(self, reach: dict[int, tuple[float, float]]) -> dict[int, Curve]:
        """Curves of some of the blocks over as much of ln b as was ever asked for, with all nodes that they need.

        They reach one spacing further than asked, so that no value depends on what else was asked for.
        """
        cell = UNIT * WIDEST
        new = {
            i: {WIDEST * n for n in range(int(np.floor(low / cell)) - 1, int(np.floor(high / cell)) + 3)} - self.nodes[i]
            for i, (low, high) in reach.items()
        }
        changed = [i for i, every in new.items() if every or i not in self.curves]
        while any(new.values()):
            self._add({i: every for i, every in new.items() if every})
            new = {i: self._between(i, self._found(i)) - self.nodes[i] for i in changed}
        self.curves.update({i: _curve(self._found(i)) for i in changed})
        return self.curves

    def _add(self, new: dict[int, set[int]]) -> None:
        """Compute nodes: of measured blocks on contacts of two sizes, of those beside them of one."""
        of_two, of_one = [], []
        for i, nodes in new.items():
            place = self.origins[i], self.heights[i]
            (of_one if self._of_one_size(i) else of_two).extend((*place, j) for j in sorted(nodes))
            self.nodes[i] |= nodes
        _follow(of_two)
        _lengths(of_one)

    def _found(self, i: int) -> dict[int, Node]:
        """Nodes of one block."""
        place = self.origins[i], self.heights[i]
        if self._of_one_size(i):
            return {j: Node(_computed[*place, j], 0.0, 0.0) for j in self.nodes[i]}
        return {j: _known[place][j] for j in self.nodes[i]}

    def _of_one_size(self, i: int) -> bool:
        return i >= self.measured and not _driven(self.origins[i])

    def _between(self, i: int, known: dict[int, Node]) -> set[int]:
        """Nodes that are missing: near the measured length, and where the event begins or ceases to stop."""
        (low, high), every, found = self.target[i], sorted(self.nodes[i]), set()
        for left, right in itertools.pairwise(every):
            apart, (a, b) = right - left, sorted((known[left].value, known[right].value))
            if _falls(a, b, low, high):
                near = apart > 1
            elif _kind(a) != _kind(b):
                near = apart > CLOSE and b > low / FAR
            else:
                near = _kind(a) == 1 and apart in NEAR and b * NEAR[apart] > low and a / NEAR[apart] < high
            if near:
                found.add((left + right) // 2)
        return found


def geometry_of(inputs: Inputs) -> Float[np.ndarray, "n g"]:
    """What the blocks are like, beside λc/H and b; without an end, friction and what else is not among the inputs."""
    absent = {"log_sites": np.inf, "log_normal_stiffness": np.inf}

    def stated(name: str) -> np.ndarray:
        return inputs.get(name) if name in inputs.names else np.full_like(inputs.log_height, absent.get(name, 0))

    ratio = stated("log_sites") - inputs.log_height
    return np.stack([ratio if name == "log_ratio" else stated(name) for name in GEOMETRY], axis=-1)


def _pressed(geometry: Geometry) -> bool:
    """Whether the interface has a normal stiffness, so that friction matters."""
    return bool(np.isfinite(geometry[GEOMETRY.index("log_normal_stiffness")]))


def _ratio(geometry: Geometry) -> float:
    """L/H, inf without an end."""
    return float(np.exp(geometry[WITHOUT_END]))


def _most_sites(geometry: Geometry) -> int:
    """Most contacts that are followed, of a block that ends; half as many where balancing them takes iterations."""
    halves = 1 + int(geometry[MULTICONTACT])
    return max(2 * FOLLOWED, 1 << int(np.ceil(np.log2(OF_END * _ratio(geometry))))) // halves


def _sites(geometry: Geometry, height: float) -> int:
    """Contacts that are followed: all of a block that ends."""
    ratio = _ratio(geometry)
    return FOLLOWED if np.isinf(ratio) else max(FOLLOWED, 1 << int(np.ceil(np.log2(ratio * height - 1e-6))))


def _height(geometry: Geometry, target: tuple[float, float], own: float) -> float:
    """H/λc on whose contacts a measured block is followed, by the length it has; the same for lengths that are alike."""
    ratio = _ratio(geometry)
    height = 2 ** (round(2 * np.log2(BREAKING / max(np.sqrt(target[0] * target[1]), 1e-3))) / 2)
    height = float(min(height, max(own, SMALLEST)))
    if not np.isfinite(ratio):
        return height
    most = min(height * ratio + 1e-9, _most_sites(geometry))
    return 2 * max(int(most / 2), 2) / ratio  # whole contacts of either size


def _kinds(geometry: Float[np.ndarray, "n g"]) -> Float[np.ndarray, "n f"]:
    """What blocks must have in common to differ by numbers only, and to be followed together."""
    return np.column_stack([geometry[:, len(AXES) :], np.isinf(geometry[:, : len(AXES)])])


def _alike(geometry: Float[np.ndarray, "n g"], height: Float[np.ndarray, " n"]) -> list[np.ndarray]:
    """Group blocks that can be followed together."""
    sites = [_sites(tuple(one), at) for one, at in zip(geometry, height, strict=True)]
    own = distinct_rows(np.column_stack([_kinds(geometry), sites]))[1]
    return [np.flatnonzero(own == i) for i in range(own.max() + 1)]


def _offsets(geometry: Float[np.ndarray, "n g"], origin: Float[np.ndarray, "... g"]) -> Float[np.ndarray, "n a"]:
    """Distance in each of `AXES`, in spacings."""
    with np.errstate(invalid="ignore"):  # inf − inf: both push everything above, say
        apart = (geometry[:, : len(AXES)] - origin[..., : len(AXES)]) / np.array(list(AXES.values()))
    return np.where(np.isfinite(apart), apart, 0)


def _cells(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Node below each place, and the share of the next one."""
    node = np.floor(place + 1e-9)
    return node.astype(int), np.maximum(place - node, 0)


def _blended(length: Float[np.ndarray, "2 n"], weight: Float[np.ndarray, "2 n"]) -> Float[np.ndarray, " n"]:
    """Length between two: of those that stop, along a straight line of the logarithm where they are alike."""
    used = (weight > 0) & np.isfinite(length)
    share, low = (weight * used).sum(axis=0), np.where(used, length, np.inf).min(axis=0)
    with np.errstate(all="ignore"):
        alike = low * FAR > np.where(used, length, 0).max(axis=0)
        by_log = np.exp((weight * np.where(used, np.log(length), 0)).sum(axis=0) / share)
        return np.where(share > 0, np.where(alike, by_log, (weight * np.where(used, length, 0)).sum(axis=0) / share), np.inf)


def _off(sides: Float[np.ndarray, "2 n"], part: Float[np.ndarray, " n"], least: Any, most: Any) -> Float[np.ndarray, " n"]:
    """How far a length between two may be off where it falls, at once and anywhere between them, past measured ones.

    It is then the one or the other, as likely as it is near; this is the standard deviation.
    """
    low, high = np.sort(sides, axis=0)
    past = np.isfinite(high) & (low * FAR < high) & (high * LIKE > least) & (low < most * LIKE)
    return np.where(past, high - np.where(past, low, 0), 0) * np.sqrt(np.clip(part * (1 - part), 0, None))


def _falls(low: Any, high: Any, least: Any, most: Any) -> Any:
    """Whether a length like the measured ones, from `least` to `most`, falls to one of another kind."""
    return (low * FAR < high) & (high * LIKE > least) & (high < most * LIKE)


def _kind(value: float) -> int:
    """Whether a length is 0, finite, or endless."""
    return 0 if value <= 0 else 1 if np.isfinite(value) else 2


def _curve(nodes: dict[int, Node]) -> Curve:
    from scipy.interpolate import PchipInterpolator  # a quarter of a second, and most fits have no block

    order = np.array(sorted(nodes))
    at, value = UNIT * order, np.array([nodes[j] for j in order.tolist()])
    stops, runs = np.isfinite(value[:, 0]), []
    for run in np.split(np.arange(len(at)), np.flatnonzero(np.diff(stops)) + 1):
        if stops[run[0]]:
            alone = np.append(run, run[-1]) if len(run) == 1 else run  # a node by itself: the same all around
            place = at[run] if len(run) > 1 else at[run[0]] + np.array([-1.0, 1.0])
            runs.append((run[0], run[-1], PchipInterpolator(place, value[alone])))
    return Curve(at, value[:, 0], runs)


def _between(
    curve: Curve, log_b: np.ndarray, inverse: np.ndarray, height: float, target: tuple[float, float]
) -> Float[np.ndarray, "3 n"]:
    """ℓ/H at places along a curve, and its errors: monotone cubics; next to an endless event the last length, else inf.

    The errors are that of extrapolating from the contacts of H/λc = `height`, and that next to a fall.
    """
    i = np.clip(np.searchsorted(curve.at, log_b, side="right") - 1, 0, len(curve.at) - 2)
    found, off = np.full((2, len(log_b)), [[np.inf], [1.0]])
    for first, last, through in curve.runs:
        inside = (i >= first - 1) & (i <= last)
        length, per, may = through(np.clip(log_b[inside], curve.at[first], curve.at[last])).T
        found[inside] = np.maximum(length + per * inverse[inside], 0)
        off[inside] = may * np.abs(1 - height * inverse[inside])
    part = np.clip((log_b - curve.at[i]) / (curve.at[i + 1] - curve.at[i]), 0, 1)
    return np.stack([found, off, _off(np.stack([curve.value[i], curve.value[i + 1]]), part, *target)])


# --- nodes ----------------------------------------------------------------------------------------------------------------


def _follow(keys: Sequence[Key]) -> None:
    """Compute nodes that are not known yet."""
    new = [key for key in dict.fromkeys(keys) if key[2] not in _known.setdefault(key[:2], {})]
    held = [key for key in new if _driven(key[0])]
    for part in _announced(held):
        geometry = np.array([key[0] for key in part])
        found, error = _each(geometry, UNIT * np.array([key[2] for key in part]), np.full(len(part), 1 / TALLEST))
        for key, value, off in zip(part, found, error, strict=True):
            _known[key[:2]][key[2]] = Node(value, 0.0, off)
    _pairs([key for key in new if not _driven(key[0])])


def _beside_each_other(moved: Sequence[Key], still: Sequence[Key]) -> Float[np.ndarray, "2 n"]:
    """ℓ/H of each block and of another: on contacts of one size, whose error is the same, where both events stop on those."""
    every = dict.fromkeys((*moved, *still))
    sized = dict.fromkeys(key for key in every if not _driven(key[0]))
    sized.update(zip(sized, _lengths(list(sized)), strict=True))
    found = np.array([[sized.get(key, np.inf) for key in keys] for keys in (moved, still)])
    longer = np.flatnonzero(~np.isfinite(found).all(axis=0)).tolist()
    _follow([keys[i] for keys in (moved, still) for i in longer])
    found[:, longer] = [[_known[keys[i][:2]][keys[i][2]].value for i in longer] for keys in (moved, still)]
    return found


def _driven(geometry: Geometry) -> bool:
    """Whether a prestress may drive the event on for ever."""
    return geometry[GEOMETRY.index("prestress")] > 0 and bool(np.isinf(_ratio(geometry)))


def _pairs(keys: list[Key]) -> None:
    """Compute nodes on contacts of two sizes; on ever larger ones where the event leaves those that are followed."""
    found = dict(zip(keys, _lengths([(g, h, j) for g, h, j in keys]), strict=True))
    larger = dict(zip(keys, _lengths([(g, h / 2, j) for g, h, j in keys]), strict=True))
    for (g, h, j), fine in found.items():
        rough = larger[g, h, j]
        if np.isfinite(fine) and not np.isfinite(rough):  # of another kind
            _known[g, h][j] = Node(fine, 0.0, 1.0)
        elif np.isfinite(fine):
            value, error = np.array(extrapolated(np.float64(fine * h), rough * h / 2, h, TALLEST, np.exp(UNIT * j))) / TALLEST
            _known[g, h][j] = Node(value, -(value - fine) * h, error)
        elif np.isinf(_ratio(g)):
            _known[g, h][j] = Node(rough, 0.0, 0.1 * rough)
        else:
            _known[g, h][j] = Node(np.inf, 0.0, 1.0)
    endless = [key for key in keys if np.isinf(_ratio(key[0]))]
    beyond, factor = [key for key in endless if not np.isfinite(_known[key[:2]][key[2]].value)], 4
    while beyond := [key for key in beyond if key[1] / factor * MOST_HEIGHTS >= FOLLOWED]:
        for (g, h, j), value in zip(beyond, _lengths([(g, h / factor, j) for g, h, j in beyond]), strict=True):
            _known[g, h][j] = Node(value, 0.0, 0.1 * value)
        beyond, factor = [key for key in beyond if not np.isfinite(_known[key[:2]][key[2]].value)], 2 * factor


def _lengths(keys: list[Key]) -> list[float]:
    """ℓ/H of blocks of some H/λc, inf where the event leaves the contacts followed or the block lifts off."""
    lanes: dict[tuple[Geometry, float, int | None], list[Key]] = {}
    for geometry, height, j in dict.fromkeys(keys):
        if (geometry, height, j) not in _computed:
            without = tuple(0.0 if i == FRICTION else x for i, x in enumerate(geometry))
            place = (without, height, j) if _pressed(geometry) else (geometry, height, None)
            lanes.setdefault(place, []).append((geometry, height, j))
    parts = []
    for (geometry, *_), every in lanes.items():
        most = RUBBING if _pressed(geometry) else TOGETHER
        parts += [every[i : i + most] for i in range(0, len(every), most)]
    for alike in _alike(np.array([part[0][0] for part in parts]), np.array([part[0][1] for part in parts])) if parts else ():
        for some in _announced([parts[i] for i in alike]):
            _computed.update(zip(itertools.chain(*some), _events(some), strict=True))
    return [_computed[key] for key in keys]


def _events(parts: list[list[Key]]) -> list[float]:
    """ℓ/H of blocks of one kind: each part is of one block at several b, or of several coefficients of friction."""
    geometry, height = (np.array([part[0][i] for part in parts]) for i in (0, 1))
    pressed = _pressed(parts[0][0][0])
    most = RUBBING if pressed else TOGETHER
    every = [[key[0][FRICTION] if pressed else UNIT * key[2] for key in part] for part in parts]
    varied = np.array([(row + [np.nan] * most)[:most] for row in every])
    log_b = np.array([[UNIT * part[0][2]] for part in parts]) if pressed else varied
    block, interface = _bodies(geometry, height)
    stiffness = np.exp(log_b) / (2 * (1 + block.poisson) * block.height)[:, None]
    friction = np.maximum(varied, 0) if pressed else None
    length, _, status = followed((block, interface), stiffness, _sites(*parts[0][0][:2]), "full", friction)
    endless = np.isin(status, (Outcome.RAN_THROUGH, Outcome.LIFT_OFF))
    length = (np.where(endless, np.inf, length) / block.height[:, None, None]).reshape(len(parts), most)
    return [float(value) for part, row in zip(parts, length, strict=True) for value in row[: len(part)]]


def _each(geometry: Float[np.ndarray, "n g"], log_b: np.ndarray, inverse: np.ndarray) -> Float[np.ndarray, "2 n"]:
    """ℓ/H of blocks without end, each on contacts that suit its own event, and how far it may be off."""
    found = np.empty((2, len(geometry)))
    height = 1 / np.maximum(inverse, 1 / TALLEST)
    for here in _alike(geometry, height):
        block, interface = _bodies(geometry[here], height[here], np.exp(log_b[here]))
        found[:, here] = np.stack(tall_lengths(block, interface, "full")) / height[here]
    return np.where(np.isnan(found[0]), [[np.inf], [1.0]], found)  # those that lift off


def _others(geometry: Float[np.ndarray, "n g"], log_b: np.ndarray, inverse: np.ndarray) -> Float[np.ndarray, "2 n"]:
    """ℓ/H of blocks that were not measured, and how far it may be off; those at many b are followed too."""
    rows, own = distinct_rows(geometry)
    found, often = np.empty((2, len(geometry))), (np.bincount(own) > MANY) | np.isfinite(rows[:, WITHOUT_END])
    once = ~often[own]
    if once.any():
        found[:, once] = _each(geometry[once], log_b[once], inverse[once])
    if often.any():
        middle = [np.flatnonzero(own == i)[np.argsort(log_b[own == i])[(own == i).sum() // 2]] for i in np.flatnonzero(often)]
        height = np.array([1 / inverse[own == i].min() for i in range(len(rows))])
        without = geometry[middle].copy()
        without[:, WITHOUT_END] = np.inf
        ratio = _each(without, log_b[middle], inverse[middle])[0]
        usual = np.where(np.isfinite(ratio) & (ratio > 0), ratio, 1.0)
        length, error = BlockLengths(rows[often], usual, height[often])(_inputs(geometry[~once], log_b[~once], inverse[~once]))
        found[:, ~once] = np.stack([length, error]) * inverse[~once]
    return found


def _inputs(geometry: Float[np.ndarray, "n g"], log_b: np.ndarray, inverse: np.ndarray) -> Inputs:
    named = dict(zip(GEOMETRY, geometry.T, strict=True))
    poisson, prestress, height = named.pop("poisson"), named.pop("prestress"), 1 / inverse
    named["log_sites"] = named.pop("log_ratio") + np.log(height)
    return Inputs.of(height, np.exp(log_b) / (2 * (1 + poisson) * height), poisson, prestress).given(**named)


def _bodies(geometry: Float[np.ndarray, "n g"], height: np.ndarray, b: Any = 1.0) -> tuple[Any, Interface]:
    """Blocks of one kind, within their domains, and their interfaces."""
    poisson, prestress, log_push, log_width, log_ratio, friction, log_normal, *flags = geometry.T
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
    return block, Interface(np.clip(prestress, -STEEPEST, STEEPEST), np.zeros(len(prestress)))


def _announced(every: list[Any]) -> Iterator[list[Any]]:
    """Cut into parts of an event per thread, and show progress: a bar on a terminal, elsewhere one line, once."""
    delay = 0 if sys.stderr is not None and sys.stderr.isatty() else 2
    what = {"desc": "events followed (the first compiles)", "unit": " events", "delay": delay, "leave": False}
    with tqdm(total=len(every), disable=None, **what) as bar:
        if bar.disable and len(every) > FEW and not _computed and not any(_known.values()) and sys.stderr is not None:
            about = COMPILING + len(every) * AN_EVENT / workers()
            text = f"following {len(every)} events of blocks at first: about {about:.0f} s, {COMPILING} of them to compile"
            print(text, file=sys.stderr, flush=True)
        for start in range(0, len(every), workers()):
            yield every[start : start + workers()]
            bar.update(len(every[start : start + workers()]))
