"""First events that would be noticed, of contacts that differ, for fits.

Thresholds scatter, and each event is a draw. Draws are followed at nodes of a lattice of all that they depend on, ln H/λc,
ln b, scatter, φ and r, and sorted into classes of length. Between nodes the shares of the classes are interpolated, and where
these lie: a mean and a spread would not do, as events that stop near the uniform front and those that stop early are two heaps.
"""

import functools
import hashlib
import io
import itertools
import os
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.base.files import read_whole, write_atomically
from slippulse_jax.base.shown import ends
from slippulse_jax.block import Block, Push
from slippulse_jax.blocks.event import contacts_of
from slippulse_jax.blocks.size import ONE_BY_ONE
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.bulk.chunks import Kernel, distinct_rows, over_lanes
from slippulse_jax.bulk.kept import FOLDER, LARGEST, sources
from slippulse_jax.events.first import Relaxed
from slippulse_jax.events.scattered import FARTHEST_DRAW, check_prestress, events_noticed
from slippulse_jax.inference.model.block import BlockEvent
from slippulse_jax.inference.model.front import STIFFEST, Front
from slippulse_jax.inference.model.inputs import Input, Inputs
from slippulse_jax.inference.model.slider import WholeEvent
from slippulse_jax.inference.table.columns import COLUMNS
from slippulse_jax.inference.table.measurements import Measurements
from slippulse_jax.interface import Interface
from slippulse_jax.slider import Slider

FEW, MANY = 12, 256
"""Draws of every node, and of those near the data."""
CLASSES = np.concatenate(
    [np.arange(0, 28) * 0.03, 1 + np.arange(-10, 20) * 0.015, np.arange(26, 52) * 0.05, 2.6 * 1.1 ** np.arange(24)]
)
"""Classes of lengths, in (ℓ − v)/(q − v); where contacts are alike that is 1, and few events of blocks get ten times as far."""
QUANTILES = 0.16, 0.84, 0.75
KERNEL, NARROWEST, LEAST_TOGETHER = 0.4, 1e-12, 0.7
"""Width of what stands for an event in the density of lengths, over half of the range of 68 % of them; the least square of
the standard deviation of others in a class; and of the factor by which lengths are drawn together to leave their spread."""
SEVERAL = 64
"""Places up to which many draws are made for a mean."""
RECORDS = 12
"""Most events of a draw of which each is larger than all before, from the least extent that may be noticed on."""
TASKS = 12
"""Scatters of one body that are drawn by one lane."""
SITES, BLOCK_SITES = (192, 384, 768, 1536, 3072), (128, 256, 512, 1024)
"""Contacts that may break, of sliders and blocks: each number is a program to compile."""
NEAR, BEYOND = 0.9, 0.05
"""Part of them beyond which an event may have been cut short, and the share of such draws that is no matter near the data."""
SOFTEST, HARDEST = 0.05, 20.0
"""Range of b searched by default."""
AXES = ("log_height", "log_b", "threshold_scatter", "prestress", "residual_strength")
SPACING = np.array([np.log(2), 0.3, 0.42, 0.1, 0.1])
"""What ensembles depend on, and the spacing of nodes: of the scatter that of asinh(s / `SMALL`)."""
SMALL = 0.008
OUTPUTS = ("length", "force", "displacement")
"""What is read from an event: ℓ/H, and force and displacement over those of contacts that are alike."""
LEAST_SCATTER, MOST_SCATTER = 0.002, 0.15
"""Scatters searched."""
FOLLOWED, TALLEST = (6, 8, 10), 1e5
"""Nodes in ln H/λc (64, 256 and 1024) from which sliders that are taller than the last are continued; and the tallest."""
TENTH = 0.1
"""Least extent that is noticed, over the height, where none is stated."""
HALF = 2.0
"""Factor by which the least extent that is noticed may differ from that stated, to see what it does."""


Node = tuple[float, ...]
"""H/λc, b, ν, φ, r, scatter, and the least and most extent over H that may be noticed."""


class Drawn(NamedTuple):
    """Events at one place: n numbers of K classes."""

    mean: Float[Array, " n"]
    spread: Float[Array, " n"]  # standard deviation
    value: Float[Array, "n K"]  # mean of each class; inf of the length of events that do not stop
    width: Float[Array, "n K"]  # standard deviation within it; of lengths what is visible in their density
    weight: Float[Array, " K"]  # their sum is 1


class Ensembles(NamedTuple):
    """Events at the nodes of one unit's lattice, or of several.

    Classes are of (ℓ − v)/(q − v), with v what is visible and q the upper quartile: short events, which end where they may be
    seen, and long ones, which end near the uniform front, both stay where they are as a node's are taken beside it.
    """

    first: Any  # (axes,), place of the first node
    visible: Any  # (), v/H
    moments: Any  # (*nodes, 2 + 2 n): q, half of the range of 68 % of ℓ/H; means; standard deviations
    classes: Any  # (*nodes, K, 1 + 2 (n − 1)): share, and but of lengths alone its products with the others, squared too

    def __call__(self, place: Float[Array, " axes"]) -> Drawn:
        """Events at a place, in spacings."""
        (tall, *counts), steps = self.moments.shape[:-1], [x - first for x, first in zip(place, self.first, strict=True)]
        curves = [_spline(x, count, jnp) for x, count in zip(steps[1:], counts, strict=True)]
        near = [_around(x, count, 3) for x, count in zip(steps[1:], counts, strict=True)]
        parts = [curve[at] for curve, at in zip(curves, near, strict=True)]
        part = functools.reduce(lambda whole, own: (whole[:, None] * own[None]).ravel(), parts)
        moments, classes = (
            x[jnp.ix_(jnp.arange(tall), *near)].reshape(tall, len(part), *x.shape[len(AXES) :]) for x in self[2:]
        )
        inside, own, doubt = _along_height(place[:1], self.first[:1], tall, jnp)
        moments = jnp.tensordot(part, moments, [0, 1])
        (quartile, width), mean, spread = jnp.split(own @ moments, [2, 2 + len(OUTPUTS)])
        off = (doubt @ moments)[0]
        weight, *others = jnp.tensordot(part, jnp.tensordot(inside, classes, 1), 1).T
        length = self.visible + (quartile - self.visible) * CLASSES
        # drawn together by what the kernel spreads them
        together = jnp.sqrt(jnp.maximum(1 - (KERNEL * width / jnp.maximum(spread[0], NARROWEST)) ** 2, LEAST_TOGETHER))
        length = jnp.append(mean[0] + (length - mean[0]) * together, jnp.inf)
        within = jnp.append(np.gradient(CLASSES) / 2, 0.0) * (quartile - self.visible)
        value, widths = [length], [jnp.sqrt((KERNEL * width) ** 2 + off**2 + within**2)]
        for i, (first, second) in enumerate(zip(others[::2], others[1::2], strict=True), start=1):
            share = jnp.where(weight > 0, weight, 1)
            value.append(mean[i] + spread[i] * first / share)
            widths.append(spread[i] * jnp.sqrt(jnp.maximum(second / share - (first / share) ** 2, NARROWEST)))
        return Drawn(mean, spread, jnp.stack(value), jnp.stack(widths), weight)


def _spline(x: Any, count: int, numpy: Any) -> Any:
    """Weights of the nodes of an axis, (…, count), by quadratic splines.

    Their slope has no steps.
    """
    if count == 1:
        return 0 * x[..., None] + 1
    off = abs(numpy.clip(x, 0.5, count - 1.5)[..., None] - np.arange(count))  # within half a spacing of its middle node
    return numpy.where(off < 0.5, 0.75 - off**2, numpy.maximum(1.5 - off, 0) ** 2 / 2)


def _along_height(place: Any, first: Any, count: int, numpy: Any) -> tuple[Any, Any, Any]:
    """Weights of nodes in ln H/λc, (…, count).

    Of classes, of moments, and of what these leave in doubt. Straight lines, as what is fitted moves it little. Beyond the
    tallest node classes stay as they are there, and moments are continued along a straight line in √ln H/λc; in doubt is what
    a parabola in ln H/λc would add.
    """
    node, (least, middle, most) = first + np.arange(count), FOLLOWED
    inside = numpy.maximum(1 - abs(numpy.clip(place, first, first + count - 1) - node), 0)
    here = numpy.maximum(place, most)
    root = (numpy.sqrt(here) - most**0.5) / (most**0.5 - middle**0.5)
    own = inside + root * ((node == most) * 1.0 - (node == middle))
    x = (here - most) / (most - middle)
    parabola = x * (x + 1) / 2 * (node == least) - x * (x + 2) * (node == middle) + (x * (x + 3) / 2) * (node == most)
    return inside, own, inside + parabola - own


def _around(x: Array, count: int, most: int) -> Array:
    """The nodes around a place that have a weight there."""
    few = min(most, count)
    return jnp.clip(jnp.round(x - (few - 1) / 2), 0, count - few).astype(int) + jnp.arange(few)


OF_DRAWS = {
    "log_scatter": Input("scatter", -np.inf, np.log(0.3), "must lie in [0, 0.3)"),
    "log_visible": Input("visible/H", -np.inf, np.inf, ""),
}
"""Inputs of events that are draws."""


class OfDraws(Front):
    """The first event that would be noticed, of contacts that differ."""

    event = "scattered"
    drawn = True
    reaches: ClassVar[tuple[float, ...]] = (1.5, 3.0)  # heights along which contacts may break, at first and if need be
    most_off = 0.0
    name = "first precursor that would be noticed"
    length_modelled = "length of the first event that would be noticed, from the edge to its right end"
    lengths_are_of = "first events that would be noticed"
    thresholds = "thresholds that scatter from contact to contact"

    def __init__(self, *tables: Measurements) -> None:
        """Follow events as they may be noticed in any table."""
        super().__init__(*tables)
        self.known: dict[Node, np.ndarray] = {}
        self.read: set[Node] = set()
        every = np.concatenate([visible(m) / m.height for m in tables]) if tables else np.full(1, TENTH)
        self.noticed = every.min() / HALF, every.max() * HALF

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse what the model leaves out, and lengths that nobody would notice."""
        super().check(m, names)
        if "threshold_slope" in names or m.or_zero("threshold_slope").any():
            raise ValueError(
                f"{m.source}: threshold_slope beside threshold_scatter: thresholds that scatter are level on average"
            )
        if (tall := m.height > TALLEST).any():
            i = int(np.argmax(tall))
            raise ValueError(
                f"{m.place(i)}: H/λc = {m.height[i]:.4g}: on contacts that differ events are continued up to {TALLEST:g} only"
            )
        unseen = (np.array(m.kind) == "length") & (m.length < visible(m) * (1 - 1e-9))
        if unseen.any():
            i = int(np.argmax(unseen))
            least = m.in_its_unit(i, visible(m)[i])
            raise ValueError(
                f"{m.place(i)}: the length is below {least}, the least that is noticed by column {m.heading('visible')}"
            )
        if "threshold_scatter" not in names:
            raise ValueError("event = 'scattered': free or hold threshold_scatter too")
        one, most = names["threshold_scatter"] if isinstance(names, Mapping) else None, 0.0  # of no prior less is searched
        if one is not None:
            most = one.value or (one.bounds[1] if one.bounds else MOST_SCATTER * (one.prior is not None))
        check_prestress(Interface(m.or_zero("prestress").max()), most)

    def remarks(self, m: Measurements) -> Iterator[str]:
        """From which extent on events are noticed, and which are draws."""
        (scale, unit), least = m.unit, visible(m)
        usual = f": column {COLUMNS['visible'].name(m.in_si)} states it; else a tenth of the height, or the shortest length"
        yield f"events are taken to be noticed from {ends(least * scale)} {unit} on{usual * (m.visible is None)}"
        if m.distinct < len(m) or len(np.unique(m.height)) < len(m):
            yield (
                "repeated lengths tell how thresholds scatter only if every run meets new contacts; of a surface that keeps "
                "its own give its name (specimen) and the column thresholds = kept"
            )

    def ranges(self, m: Measurements) -> dict[str, tuple[float, float]]:
        """Scatters at which no contact begins beyond its threshold."""
        high = (1 - m.or_zero("prestress").max()) / FARTHEST_DRAW
        return {"threshold_scatter": (LEAST_SCATTER, min(high, MOST_SCATTER))}

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """What is visible over the height, and no scatter."""
        own = {"log_scatter": np.zeros(len(m)), "log_visible": np.log(visible(m) / m.height)}
        return super().stated(m) | own

    def uncertainty(self, inputs: Inputs) -> None:
        """None beside the spread of the draws."""

    def starts(self, inputs: Inputs) -> np.ndarray:
        """Lengths of events."""
        return self.lengths(inputs)

    def status(self, inputs: Inputs) -> np.ndarray:
        """`Outcome` of each, by its mean length."""
        return Front.status(self, inputs)

    def geometry(self, inputs: Inputs) -> Float[np.ndarray, "u g"]:
        """What else the bodies are like, which no node differs in."""
        return np.empty((len(inputs.poisson), 0))

    @staticmethod
    def contacts(kind: tuple[Any, ...], body: Array) -> tuple[Relaxed, Array]:
        """Contacts of a body, and units of force and displacement."""
        raise NotImplementedError

    @staticmethod
    def kind(node: Node, reach: float) -> tuple[Any, ...]:
        """What sets the program of a body: contacts, and its parts."""
        return (enough(reach * node[0], SITES),)

    def softest(self, m: Measurements) -> np.ndarray:
        """k/K at the least b searched."""
        return SOFTEST / (2 * (1 + m.poisson) * m.height)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K searched by default."""
        return np.minimum(STIFFEST, HARDEST / (2 * (1 + m.poisson) * m.height))

    @classmethod
    def coordinates(cls, inputs: Inputs, numpy: Any = np) -> Any:
        """Place on the lattice, in spacings, (…, axes)."""
        log_b = numpy.log(2 * (1 + inputs.poisson)) + inputs.log_stiffness + inputs.log_height
        scatter = numpy.arcsinh(numpy.exp(inputs.more["log_scatter"]) / SMALL)
        kept = inputs.more.get("residual_strength", 0 * inputs.prestress)
        every = inputs.log_height, log_b, scatter, inputs.prestress, kept
        return numpy.stack([x / unit for x, unit in zip(every, SPACING, strict=True)], axis=-1)

    def values(self, inputs: Inputs) -> np.ndarray:
        """Means of ℓ in λc, of events that stop."""
        some = len(inputs.poisson) <= SEVERAL
        found = self.ensembles(inputs, inputs.table()[None], inputs.map(lambda x: x[None]) if some else None)
        place, (tall, *counts) = self.coordinates(inputs), found.moments.shape[1:-1]
        own = _along_height(place[:, :1], found.first[:, :1], tall, np)[1]
        curves = [_spline(x, count, np) for x, count in zip((place - found.first)[:, 1:].T, counts, strict=True)]
        return np.exp(inputs.log_height) * np.einsum("la,lb,lc,ld,le,labcde->l", own, *curves, found.moments[..., 2])

    # --- draws at nodes

    def ensembles(self, inputs: Inputs, reach: np.ndarray, near: Inputs | None = None, *, alone: bool = True) -> Ensembles:
        """Lay nodes over all places of `reach`, and draw there.

        These are (…, units, inputs). Few draws, but where they are `near`, (t, units). Where nothing moves a number, its nodes
        have that. Lengths `alone`, or what else is read of events too.
        """
        place = self.coordinates(Inputs.from_table(inputs.names, reach)).reshape(-1, len(inputs.log_height), len(AXES))
        low, high = place.min(axis=0), place.max(axis=0)
        moves = (np.ptp(place, axis=0) > 1e-9).any(axis=0)
        moves[:2] = True  # of all tables alike
        lowest, top = np.floor(low[:, 0]), FOLLOWED[-1]
        lowest = np.where(high[:, 0] > top, np.minimum(lowest, FOLLOWED[0]), lowest)
        sides = np.stack([lowest, np.minimum(np.floor(high[:, 0]) + 1, top)]), np.stack([np.round(low) - 1, np.round(high) + 1])
        first, last = (np.where(moves, np.column_stack([a, b[:, 1:]]), low) for a, b in zip(*sides, strict=True))
        count_of = np.where(moves, (last - first).max(axis=0).round().astype(int) + 1, 1)
        node = np.stack(np.meshgrid(*map(np.arange, count_of), indexing="ij"), axis=-1)
        at = (first[:, None] + node.reshape(-1, len(AXES))).reshape(-1, len(AXES))  # of all units one after another
        some = np.zeros((len(first), *count_of), bool)
        for one in () if near is None else self.coordinates(near):
            middle = np.round(one - first).astype(int)
            for step in itertools.product(range(count_of[0]), *((-1, 0, 1) if n > 1 else (0,) for n in count_of[1:])):
                at_node = np.clip(middle + step, 0, count_of - 1)
                at_node[:, 0] = step[0]
                some[(np.arange(len(first)), *at_node.T)] = True
        height, b, scatter, prestress, kept = (at * SPACING).T
        height, b, scatter = np.exp(height), np.exp(b), np.abs(SMALL * np.sinh(scatter))
        few, many = np.round(
            np.outer((FEW, MANY), np.minimum(1, 2.0 ** FOLLOWED[1] / height))
        )  # of tall ones each takes longer
        seen, unit = np.exp(inputs.more["log_visible"]), np.repeat(np.arange(len(first)), node[..., 0].size)
        least, most = (np.full_like(height, x) for x in self.noticed)
        geometry = self.geometry(inputs)[unit].T
        numbers = height, b, inputs.poisson[unit], prestress, np.maximum(kept, 0), scatter, least, most, *geometry, seen[unit]
        rows, own = distinct_rows(np.array([[float(f"{x:.12g}") for x in one] for one in zip(*numbers, strict=True)]))
        # nodes between those from which tall sliders are continued are not read
        level = first[:, :1] + np.arange(count_of[0])
        read = (level >= np.floor(low[:, :1])) & (level <= np.floor(high[:, :1]) + 1)
        read |= (high[:, :1] > top) & np.isin(level, FOLLOWED)
        read = np.broadcast_to(read.reshape(*read.shape, *[1] * (len(AXES) - 1)), some.shape).ravel()
        wanted = np.zeros(len(rows), int)
        np.maximum.at(wanted, own, np.where(some.ravel(), many, few) * read)
        wanted = np.minimum(wanted, np.where(rows[:, 5] > 0, MANY, 1))
        draws = self._draws([tuple(one) for one in rows[:, :-1].tolist()], wanted.tolist())
        moments = np.zeros((len(rows), 2 + 2 * len(OUTPUTS)))
        classes = np.zeros((len(rows), len(CLASSES) + 1, 1 if alone else 2 * len(OUTPUTS) - 1))
        for count in np.unique(wanted[wanted > 0]).tolist():
            mine = np.flatnonzero(wanted == count)
            read = _noticed(rows[mine], np.stack([draws[i] for i in mine.tolist()]))
            moments[mine] = _moments(read)
            classes[mine] = _classes(read, rows[mine, -1], moments[mine], classes.shape[-1])
        shape = len(first), *count_of
        return Ensembles(first, seen, *(x[own].reshape(*shape, *x.shape[1:]) for x in (moments, classes)))

    def _draws(self, nodes: list[Node], wanted: list[int]) -> list[Any]:
        """Draw so many events of each node, (4, E, D); keep them."""
        ask: dict[Node, int] = {}
        for node, count in zip(nodes, wanted, strict=True):
            if count:
                ask[node] = max(ask.get(node, 0), count)
        files = {_file_of(node) for node in ask}
        for file in files - self.read:
            self.known |= _kept(file)
        self.read |= files
        there = {node: self.known[node].shape[-1] if node in self.known else 0 for node in ask}
        lacking = {node: (there[node], count) for node, count in ask.items() if there[node] < count}
        new = self._followed(lacking, self.reaches[0])
        for before, reach in itertools.pairwise(self.reaches):  # where events come near the last contact
            share = {node: _share_beyond(x[0], NEAR * before * node[0]) for node, x in new.items()}
            near = {node for node, x in share.items() if x > (BEYOND if ask[node] > FEW else 0.5)}
            new |= self._followed({node: lacking[node] for node in near}, reach)
        for node, x in new.items():
            self.known[node] = np.concatenate([self.known[node], x], axis=-1) if there[node] else x
        for file in {_file_of(node) for node in lacking}:
            _keep(file, {node: x for node, x in self.known.items() if _file_of(node) == file})
        return [self.known[node][..., :count] if count else None for node, count in zip(nodes, wanted, strict=True)]

    def _followed(self, wanted: Mapping[Node, tuple[int, int]], reach: float) -> dict[Node, Float[np.ndarray, "4 E D"]]:
        """Follow draws of nodes, from one number to another.

        Where contacts may break along `reach` heights.
        """
        bodies: dict[Node, list[Node]] = {}
        for node in wanted:
            bodies.setdefault((*node[:5], *node[6:]), []).append(node)
        new = {}
        for kind in dict.fromkeys(self.kind(every[0], reach) for every in bodies.values()):
            parts = [
                (body, every[start : start + TASKS])
                for body, every in bodies.items()
                for start in range(0, len(every), TASKS)
                if self.kind(every[0], reach) == kind
            ]
            # those that take longest first: threads take turns
            parts.sort(key=lambda one: -one[0][0] * sum(np.ptp(wanted[node]) for node in one[1]))
            fields = len(parts[0][0])
            lanes = np.zeros((len(parts), fields + 4 * TASKS))
            for lane, (body, every) in zip(lanes, parts, strict=True):
                lane[:fields] = body
                lane[5:7] *= body[0]  # what is noticed, in λc
                tasks = [(node[5], _seed(node), *wanted[node]) for node in every]
                lane[fields : fields + 4 * len(every)] = np.ravel(tasks)
            found = over_lanes(_series(type(self), kind), [*lanes.T], ONE_BY_ONE)[0].astype(np.float32)
            for i, (_, every) in enumerate(parts):
                new |= {node: found[task, ..., slice(*wanted[node]), i] for task, node in enumerate(every)}
        return new


def _share_beyond(length: Float[np.ndarray, "E D"], most: float) -> float:
    """Share of draws of which an event gets farther."""
    return float((length > most).any(axis=0).mean())


def _noticed(rows: Float[np.ndarray, "n 9"], draws: Float[np.ndarray, "n 4 E D"]) -> Float[np.ndarray, "n outputs D"]:
    """Read the first event that is long enough to be seen.

    inf of one without end.
    """
    height = rows[:, :1, None]
    with np.errstate(invalid="ignore"):
        enough: Any = draws[:, 0] - draws[:, 1] >= rows[:, -1:, None] * height
    read = np.take_along_axis(draws[:, [0, 2, 3]], np.argmax(enough, axis=1)[:, None, None], axis=2)[:, :, 0].astype(float)
    there = enough.any(axis=1)[:, None] & np.isfinite(read[:, :1])
    read[:, :1] /= height
    return np.where(there, read, np.inf)


def _moments(read: Float[np.ndarray, "n outputs D"]) -> Float[np.ndarray, "n 2+2*outputs"]:
    """Upper quartile and width of lengths, means and standard deviations.

    Of events that stop; half of the range of 68 % of them is the width.
    """
    there = np.less(read, np.inf)[:, 0]
    count = np.maximum(there.sum(axis=-1), 1)
    at = np.floor(np.array(QUANTILES) * count[:, None]).astype(int)
    low, high, quartile = np.where(there.any(axis=-1), np.take_along_axis(np.sort(read[:, 0]), at, axis=-1).T, 0)
    mean = np.where(there[:, None], read, 0).sum(axis=-1) / count[:, None]
    off = np.where(there[:, None], read - mean[..., None], 0)
    return np.column_stack([quartile, (high - low) / 2, mean, np.sqrt((off**2).sum(axis=-1) / count[:, None])])


def _classes(read: Float[np.ndarray, "n outputs D"], visible: np.ndarray, moments: np.ndarray, numbers: int) -> np.ndarray:
    """Share of each class, and what else is added up by it.

    A draw counts in the two classes beside it, by its distance.
    """
    (quartile, _), mean, spread = np.split(moments.T[..., None], [2, 2 + len(OUTPUTS)])
    stops, span = np.isfinite(read[:, 0]), np.where(quartile > visible[:, None], quartile - visible[:, None], 1)
    place = np.interp(np.where(stops, (read[:, 0] - visible[:, None]) / span, 0), CLASSES, np.arange(len(CLASSES)))
    low = np.minimum(np.floor(place).astype(int), len(CLASSES) - 2)
    found, row = np.zeros((len(read), len(CLASSES) + 1, numbers)), np.arange(len(read))[:, None]
    off = [np.where(stops, read[:, i] - mean[i], 0) / np.where(spread[i] > 0, spread[i], 1) for i in (1, 2)]
    others = [x for one in off for x in (one, one**2)]
    every = np.stack([np.ones_like(place), *others], axis=-1)[..., :numbers] / read.shape[-1]
    for side, share in ((low, 1 - (place - low)), (low + 1, place - low)):
        at = row, np.where(stops, side, len(CLASSES))
        np.add.at(found, at, np.where(stops, share, 0.5)[..., None] * every)
    return found


def _file_of(node: Node) -> Node:
    """What nodes have in common that are kept in one file."""
    return (node[0], *node[2:5], *node[6:])


def _seed(node: Node) -> int:
    """A seed of its own: draws that are mixed are as many."""
    return zlib.crc32(repr(node).encode())


@functools.cache
def _series(model: type[OfDraws], kind: tuple[Any, ...]) -> Kernel:
    def of_lane(lane: Float[Array, "fields lanes"]) -> tuple[Array]:
        body, tasks = lane[: -4 * TASKS, 0], lane[-4 * TASKS :, 0].reshape(TASKS, 4)
        contacts, alike = model.contacts(kind, body)

        def of_scatter(task: Array) -> Array:
            def one(i: Array, every: Array) -> Array:
                key = jax.random.fold_in(jax.random.key(task[1].astype(jnp.uint32)), i)
                found = events_noticed(contacts.scattered(task[0], key), body[5], body[6], RECORDS)
                columns = [found.length, found.left.astype(every.dtype), found.force / alike[0], found.load / alike[1]]
                return lax.dynamic_update_index_in_dim(every, jnp.stack(columns), i, 2)

            first, last = task[2:].astype(jnp.int32)
            return lax.fori_loop(first, last, one, jnp.full((4, RECORDS, MANY), jnp.nan))

        return (lax.map(of_scatter, tasks)[..., None],)

    return of_lane


def _file(group: Node) -> Path | None:
    folder = os.environ.get(FOLDER)
    name = hashlib.sha256(repr((sources(), group)).encode()).hexdigest()[:32]
    return Path(folder, f"{name}.npz") if folder else None


def _kept(group: Node) -> dict[Node, np.ndarray]:
    """Draws that earlier fits kept; none of a damaged file."""
    path = _file(group)
    with suppress(Exception):
        if path is not None:
            content = np.load(io.BytesIO(read_whole(path, LARGEST)))
            return {
                tuple(key): x[..., : int(n)]
                for key, n, x in zip(content["node"].tolist(), content["draws"], content["found"], strict=True)
            }
    return {}


def _keep(group: Node, draws: dict[Node, np.ndarray]) -> None:
    path, content = _file(group), io.BytesIO()
    if path is None:
        return
    with suppress(OSError):
        filled = np.stack([np.pad(x, [(0, 0), (0, 0), (0, MANY - x.shape[-1])]) for x in draws.values()])
        np.savez_compressed(
            content, node=np.array([*draws]), draws=np.array([x.shape[-1] for x in draws.values()]), found=filled
        )
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_atomically(path, content.getvalue())


def enough(contacts: float, choices: tuple[int, ...]) -> int:
    """Least of these numbers of contacts that suffices, or a ValueError."""
    for found in choices:
        if found >= contacts * (1 - 1e-9):
            return found
    raise ValueError(f"a body of {contacts:.0f} contacts that differ: events are followed on up to {choices[-1]}")


def visible(m: Measurements) -> np.ndarray:
    """Least extent of an event that is noticed, in λc, (n,).

    As stated; else a tenth of the height, or the shortest length of the table if that is less.
    """
    usual = np.minimum(TENTH * m.height, m.length.min())
    return usual if m.visible is None else np.where(np.isnan(m.visible), usual, m.visible)


class ScatteredEvent(OfDraws, WholeEvent):
    """The first event on a slider that would be noticed."""

    inputs = {**WholeEvent.inputs, **OF_DRAWS}
    observes = ("length", "count", "limit", "force", "displacement")

    @staticmethod
    def contacts(kind: tuple[Any, ...], body: Array) -> tuple[Relaxed, Array]:
        """Contacts of a slider; force and displacement if all were alike."""
        height, b, poisson, prestress, kept = body[:5]
        slider = Slider(height, b / (2 * (1 + poisson) * height), poisson)
        modes = lattice_modes(slider)
        alike = (1 - prestress) * jnp.stack([slider.stiffness * (modes.drive / modes.gap).sum(), modes.load])
        return slider.contacts(Interface(prestress, 0.0, kept), kind[0]), alike


class ScatteredBlock(OfDraws, BlockEvent):
    """The first event on a block that would be noticed."""

    inputs = {**BlockEvent.inputs, **OF_DRAWS}
    reaches = (4.0,)

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse what is not followed, and inputs that are held."""
        super().check(m, names)
        if "force" in m.push_control or "multicontact" in m.contact_law:
            raise ValueError(
                f"{m.source}: threshold_scatter on a block: the pusher is displaced, and the contact law Amontons'"
            )
        ratio = np.full(len(m), np.inf) if m.block_length is None else m.block_length / m.height
        above = 2 ** (np.floor(np.log2(m.height)) + 1)  # the node there
        for i in np.flatnonzero(np.fmin(ratio, self.reaches[-1]) * above > BLOCK_SITES[-1])[:1].tolist():
            most = f"events are followed on up to {BLOCK_SITES[-1]}, of a block {above[i] / m.height[i]:.3g} times as high"
            raise ValueError(f"{m.place(i)}: a block of too many contacts that differ: {most}")
        moving = {"push_height", "push_width", "friction", "normal_stiffness", "block_length"}
        for name in sorted(moving):
            one = names.get(name) if isinstance(names, Mapping) else None
            if (one is not None and one.value is None) or np.any(m.or_zero(f"{name}_sigma")):
                raise ValueError(
                    f"{m.source}: {name} beside threshold_scatter: draws are of one geometry and friction, so hold it"
                )

    def geometry(self, inputs: Inputs) -> Float[np.ndarray, "u g"]:
        """L/H, h/H, w/H, μ, k_n/k, and whether the top is held."""
        ended = inputs.more.get("log_sites", np.inf) - inputs.log_height
        logs = np.exp([ended, *(inputs.more[name] for name in ("log_push", "log_push_width", "log_normal_stiffness"))])
        return np.stack([*logs, inputs.more["friction"], inputs.more["top_held"]], axis=-1)

    @staticmethod
    def kind(node: Node, reach: float) -> tuple[Any, ...]:
        """Contacts; and whether there are end, patch, pressure, a held top."""
        ratio, _, width, normal, _, held = node[8:]
        sites = min(ratio, reach) * node[0]
        finite = tuple(bool(np.isfinite(x)) for x in (ratio, width, normal))
        return enough(sites, BLOCK_SITES), *finite, bool(held)

    @staticmethod
    def contacts(kind: tuple[Any, ...], body: Array) -> tuple[Relaxed, Array]:
        """Contacts of a block; force and displacement as they are."""
        sites, ended, wide, pressed, held = kind
        height, b, poisson, prestress, kept, _, _, ratio, push, width, normal, friction, _ = body
        block = Block(
            height, b / (2 * (1 + poisson) * height), poisson, Push(push, width if wide else None), "stress",
            jnp.rint(ratio * height).astype(jnp.int32) if ended else None, normal if pressed else None,
            friction if pressed else None, "amontons", "held" if held else "free",
        )  # fmt: skip
        return contacts_of(block, Interface(prestress, 0.0, kept), sites), jnp.ones(2)
