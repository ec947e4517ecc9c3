"""Series of events of a block, up to sliding, for fits.

A series is followed on at most `SITES` contacts of the same areal stiffness; what is read from that of a block with more is
continued to their size, along which it changes little. Its lengths jump with the order of breaks, and so, by some 0.01 μF_N,
does the force at which the front first reaches a place. The slope that a fit needs is the trend over many orders; at a fixed
order it has the wrong sign beyond 0.4 L. So a prediction is an emulator through many series, and a fit chooses where these are.
"""

import functools
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from scipy.special import ndtr

from slippulse_jax.base.status import Outcome
from slippulse_jax.block import RIGID, USUAL_NORMAL_STIFFNESS, Block, Push, Top
from slippulse_jax.blocks.event import contacts_of, unattached, with_friction
from slippulse_jax.blocks.size import ONE_BY_ONE
from slippulse_jax.bulk.chunks import Kernel, distinct_rows, over_lanes
from slippulse_jax.events.ageing import Ageing
from slippulse_jax.events.event import BREAKS_PER_SITE
from slippulse_jax.events.first import Relaxed
from slippulse_jax.events.series import Adiabatic, Loading, load_through
from slippulse_jax.inference.model.block import BlockEvent
from slippulse_jax.inference.model.inputs import COMMON, Input, Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.table.measurements import Measurements

SITES = 128
"""Most contacts of a block whose series is followed."""
COARSER = 80
"""Contacts of every other series of a block that has more than `SITES`."""
EVENTS = 16 * SITES
"""Most events of a series; a front that creeps by single contacts has one for each, of contacts that keep much several."""
TOGETHER = 16
"""Series of one geometry that are followed by one lane; those of one b after one another, on one response."""
GEOMETRY = ("poisson", "log_ratio", "log_push", "log_push_width", "log_normal_stiffness")
"""What the elastic block is: ν, and the logarithms of L/H, h/H, w/H and k_n/k."""
CONTACTS = ("log_b", "friction", "prestress", "log_machine", "newborn", "log_time", "log_scatter", "residual_strength")
"""What may differ on one block: ln b, μ, φ, ln M/K, a newborn contact, ln τ over u_s, ln of the scatter, and r."""
CREEP = 0.01
"""Weight of an event that is not seen, over that of one that is: of single contacts, between the events of a record."""


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

    def force_of_arrest(
        self, place: Float[np.ndarray, "*n m"], error: Float[np.ndarray, " m"], least: Float[np.ndarray, " n"]
    ) -> np.ndarray:
        """Force of the events that end at places x/L.

        Averaged over their errors, and its spread; (2, n, m). By how far they advance: a jump that ends there has been seen,
        by more than `least`, and not the creep about it (`CREEP`).
        """
        advance = self.advance[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):  # NaN where no event advances
            density = np.log(advance) - ((np.minimum(self.reached, 1.0)[:, None] - place[..., None]) / error[:, None]) ** 2 / 2
            density = np.where(advance > least[:, None, None], density, density + np.log(CREEP))
            density = np.where(advance > 1e-12, density, -np.inf)
            weight = np.exp(density - density.max(axis=-1, keepdims=True))
        return self._averaged(weight / weight.sum(axis=-1, keepdims=True))

    def _averaged(self, weight: Float[np.ndarray, "n m E"]) -> np.ndarray:
        parts = np.where(weight > 0, self.force[:, None], 0)
        mean = (weight * parts).sum(axis=-1)
        return np.stack([mean, np.sqrt(np.maximum((weight * parts**2).sum(axis=-1) - mean**2, 0))])

    def first(self, least: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Extent over L, and force, of the first event that is seen.

        It is the first that advances by more than `least`.
        """
        at = np.arange(len(self.force)), np.argmax(self.advance > least[:, None], axis=1)
        return np.minimum(self.reached[at], 1.0), self.force[at]


def followed(
    geometry: Float[np.ndarray, "n 5"],
    contacts: Float[np.ndarray, "n 8"],
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
    scattered = bool((contacts[:, CONTACTS.index("log_scatter")] > -np.inf).any())
    contacts = np.column_stack([contacts, first + np.arange(len(contacts))])
    order = np.argsort(contacts[:, 0], kind="stable")
    groups = [order[own[order] == i] for i in range(len(blocks))]
    parts = [rows[start : start + TOGETHER] for rows in groups for start in range(0, len(rows), TOGETHER)]
    lanes = np.empty((len(parts), geometry.shape[1] + TOGETHER * contacts.shape[1]))
    for lane, rows in zip(lanes, parts, strict=True):
        filled = contacts[np.resize(rows, TOGETHER)]
        lane[:] = np.concatenate([geometry[rows[0]], filled.ravel()])
    found = Followed(*np.empty((len(Followed._fields), len(contacts), EVENTS)))
    for column, values in zip(found, over_lanes(_series(aged, wide, scattered, top), [*lanes.T], ONE_BY_ONE), strict=True):
        for i, rows in enumerate(parts):
            column[rows] = values[: len(rows), :, i]
    there = 1 + int((found.end > 0).sum(axis=1).max())  # and what follows the last
    return Followed(*(column[:, :there] for column in found))


@functools.cache
def _series(aged: bool, wide: bool, scattered: bool, top: Top) -> Kernel:
    def of_lane(lane: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        numbers = lane[:, 0]
        poisson, *logs = numbers[: len(GEOMETRY)]
        ratio, height, width, normal = map(jnp.exp, logs)
        sites = jnp.minimum(jnp.rint(ratio * numbers[len(GEOMETRY)]), SITES)
        tall = sites / ratio
        push, per_b = Push(height, width if wide else None), 1 / (2 * (1 + poisson) * tall)

        def block(log_b: Array) -> Block:
            length = sites.astype(jnp.int32)
            return Block(tall, jnp.exp(log_b) * per_b, poisson, push, "stress", length, normal, 1.0, "amontons", top)

        def of_b(log_b: Array) -> tuple[Array, Relaxed]:
            return log_b, contacts_of(block(log_b), None, SITES, bare)

        points = numbers[len(GEOMETRY) + 1 :].reshape(TOGETHER, len(CONTACTS) + 1)
        bare = unattached(block(points[0, 0]))

        def one(known: tuple[Array, Relaxed], contacts: Array) -> tuple[tuple[Array, Relaxed], tuple[Array, ...]]:
            known = lax.cond(contacts[0] == known[0], lambda: known, lambda: of_b(contacts[0]))
            body, machine = with_friction(known[1], contacts[1]), jnp.minimum(jnp.exp(contacts[3]), 1e12)
            prestress = jnp.broadcast_to(contacts[2], body.prestress.shape)
            body = body._replace(prestress=prestress, residual_strength=contacts[7]).through(machine)
            if scattered:
                body = body.scattered(jnp.exp(contacts[6]), jax.random.key(contacts[8].astype(jnp.int32)))
            body = body.up_to(body.last)
            ageing = Ageing(contacts[4], jnp.exp(contacts[5])) if aged else None
            most = jnp.int32(BREAKS_PER_SITE * SITES)
            loading = Loading(Adiabatic(), ageing, jnp.asarray(jnp.inf), jnp.asarray(True), most, jnp.asarray(body.last))
            end = load_through((EVENTS, 0, 0, SITES), body, loading)
            event = jnp.arange(EVENTS)
            length, force = (end.rows[name][:-1] for name in ("length", "force_before"))
            # no series that ends before it spans for want of events, nor one whose new contacts are weaker than what they keep
            sound = (end.number < EVENTS) | jnp.isinf(length).any()
            force = jnp.where(sound & (contacts[7] < contacts[4]), force, jnp.nan)
            reached = lax.cummax(jnp.where(event < end.number, length, jnp.inf)) / sites
            force = jnp.where(event < end.number, force / (body.stiffness * sites), jnp.nan)
            load, begin, farthest = (end.rows[name][:-1] for name in ("load", "leftmost", "extent"))
            return known, (reached, force, load, begin / sites, farthest / sites)

        _, empty = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(of_b, points[0, 0]))
        return tuple(column[..., None] for column in lax.scan(one, (jnp.full((), jnp.nan), empty), points)[1])

    return of_lane


SIZES = 0.03, 0.05, 0.05, 0.1, 0.2, 0.06, 0.06, 0.03, 0.3, 0.06, 0.2, 0.3, 0.03, 0.05
UNITS = dict(zip((*GEOMETRY, *CONTACTS, "log_extent"), SIZES, strict=True))  # the last of how places are read
"""Least half-width of a cloud in each number: the slope over less is that of single orders of breaks."""
APART = 1_000_000
"""Between the numbers from which thresholds of two sequences are drawn."""
AGED = 0.45
"""Part of a block below which no event tells how its contacts age."""
USUAL_LOAD = 0.015, 1.2
"""Largest force of a sequence over the normal load."""


class BlockSeries(BlockEvent):
    """The events of a block up to sliding, as a series."""

    event = "sequence"
    inputs = {
        **BlockEvent.inputs,
        "log_machine": FirstFront.inputs["log_machine"],
        "newborn": Input("newborn", 0.0, 1.0, "must lie in (0, 1]", 1e-4, (0.01, 1.0)),
        "log_time": Input("τ/u_s", -np.inf, np.inf, ""),
        "log_scatter": Input("scatter", -np.inf, np.log(0.3), "must lie in [0, 0.3)"),
        "log_extent": Input("", -np.inf, np.inf, ""),
        "model_error": Input("", 0.0, np.inf, ""),
    }
    most_off = 0.0  # what it leaves open is in its predictions
    observes = ("place_force", "first_length", "largest_force", "between")
    measured = "a sequence of precursors"
    name = "sequence of precursors"
    body_modelled = "block with a free end under two-dimensional elasticity, pushed at a height"
    length_modelled = "force at which the front first reaches a place"
    needs = ("friction", "normal_load")
    refused = dict.fromkeys(("displacement", "gauges"), "from forces and lengths alone: leave it out")
    thresholds: str = "thresholds that follow the pressure"

    def __init__(self, *_: Measurements) -> None:
        """Depend on nothing: what is measured is read from series by observables."""

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Ask for push, end, friction, normal load, and parameters that forces determine."""
        self._check_parameters(m, names if isinstance(names, Mapping) else {})
        if m.block_length is None or np.isnan(m.block_length).any():
            raise ValueError(f"{m.source}: a sequence ends as the front spans the block: give block_length (block_length_mm)")
        if m.friction is None and "friction" not in names:
            raise ValueError('parameter friction: neither stated nor fitted nor held: free = ["stiffness", "friction"]')
        if m.normal_load is None and "normal_load" not in names:
            raise ValueError("parameter normal_load: neither stated nor fitted nor held: forces scale with it")
        if "force" in m.push_control:
            raise ValueError(f"{m.source}: push_control = 'force': the pusher of a sequence is displaced")
        if "multicontact" in m.contact_law:
            raise ValueError(f"{m.source}: contact_law = 'multicontact': series of such contacts take too long for a sequence")
        super().check(m, {*names} - {"friction"})

    @staticmethod
    def _check_parameters(m: Measurements, chosen: Mapping[str, Any]) -> None:
        """Check that forces determine what is fitted."""
        fitted = [name for name, one in chosen.items() if one.value is None]
        if "machine_stiffness" in chosen and m.machine_stiffness is None:
            raise ValueError("parameter machine_stiffness: the measurements state none to start from; a guess is enough")
        if "threshold_scatter" in fitted and chosen["threshold_scatter"].prior is None:
            option = m.option("--fix threshold_scatter=0.05", 'fixed={"threshold_scatter": 0.05}')
            raise ValueError(
                f"parameter threshold_scatter: give a prior, as forces hardly tell 2 % from 10 %, or hold it: {option}"
            )
        if "time_constant" in chosen and "newborn" not in chosen:
            raise ValueError('parameter time_constant: contacts that age need newborn too: free = [..., "newborn"]')
        kept, newborn = (chosen[name].value if name in chosen else None for name in ("residual_strength", "newborn"))
        kept = float(m.or_zero("residual_strength").max()) if "residual_strength" not in chosen else kept
        if newborn is not None and kept is not None and kept >= newborn:
            weak = f"a new contact is weaker than the share {kept:g} of its strength (residual_strength) that it keeps"
            raise ValueError(f"parameter newborn = {newborn:g}: {weak}, and would break at once")
        aged = next((name for name in fitted if name in ("newborn", "time_constant")), None)
        if aged and m.block_length is not None and (farthest := float(np.max(m.length / m.block_length))) < AGED:
            where = f"the farthest place is {farthest:.2g} L, and nothing below {AGED:g} L tells how contacts age"
            raise ValueError(f"parameter {aged}: {where}: hold it")

    def ranges(self, m: Measurements) -> dict[str, tuple[float, float]]:
        """Friction and normal load that the largest force allows.

        It is 0.3 to 1 of μF_N, with μ from 0.05 to 1.2.
        """
        if m.normal_load is None:
            return {"friction": (0.05, 1.2)} | self.usual(m)
        share = float(np.max(m.or_zero("force") / m.normal_load))
        return {"friction": (share, share / 0.3)}

    def usual(self, m: Measurements) -> dict[str, tuple[float, float]]:
        """Usual normal load for the largest force."""
        most, (least_share, share) = float(np.max(m.or_zero("force"))), USUAL_LOAD
        return {"normal_load": (most / share, most / least_share)}

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """Block and push as of one event, and machine and ageing."""
        none = np.zeros(len(m))
        usual = np.full(len(m), np.log(USUAL_NORMAL_STIFFNESS))
        normal = usual if m.normal_stiffness is None else np.log(np.minimum(m.normal_stiffness, RIGID))
        return super().stated(m) | {
            "log_normal_stiffness": normal,
            "log_machine": FirstFront().stated(m).get("log_machine", none + np.inf),
            "newborn": none + 1,
            **dict.fromkeys(("log_time", "log_scatter", "log_extent", "model_error"), none),
        }

    @staticmethod
    def numbers(inputs: Inputs, numpy: Any = np) -> Any:
        """Numbers of a series, and of how it is read; (…, 14).

        `numpy` may be JAX's.
        """
        given = {
            "log_ratio": inputs.get("log_sites") - inputs.log_height,
            "log_b": numpy.log(2 * (1 + inputs.poisson)) + inputs.log_stiffness + inputs.log_height,
        }
        given |= {} if "residual_strength" in inputs.more else {"residual_strength": 0 * inputs.poisson}
        return numpy.stack([given[name] if name in given else inputs.get(name) for name in UNITS], axis=-1)

    @classmethod
    def coordinates(cls, inputs: Inputs, numpy: Any = np) -> Any:
        """These numbers, each in its unit; of friction its logarithm."""
        numbers, friction = cls.numbers(inputs, numpy), [*UNITS].index("friction")
        columns = [numpy.clip(numbers[..., i], -50.0, 10.0) for i in range(len(UNITS))]
        columns[friction] = numpy.log(numpy.maximum(columns[friction], 1e-3))
        return numpy.stack([x / size for x, size in zip(columns, UNITS.values(), strict=True)], axis=-1)

    @staticmethod
    def unit(acts: Iterable[str]) -> float:
        """Least half-width of a cloud in a parameter.

        By the inputs on which it acts.
        """
        acts = {"log_b" if name in COMMON and name not in UNITS else name for name in acts}
        return min(
            (0.02 if name == "friction" else size for name, size in UNITS.items() if name in acts), default=UNITS["log_b"]
        )

    @staticmethod
    def sites(inputs: Inputs, *, continued: bool = True) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
        """Number of contacts on which series are followed; their excess size.

        Those of the block; or where they are too many `SITES` and, every other series, fewer, so that the square root of
        their size, over L, can be continued to that of the block: forces of first events are straight in it to 0.1 % from 80
        to 270 contacts. Where thresholds scatter that would be another scatter, and `SITES` it is.
        """
        own, alike = np.exp(inputs.get("log_sites")), np.isneginf(inputs.get("log_scatter"))
        fewer = alike & (np.arange(len(own)) % 2 == 1) & continued
        found = np.where(own <= SITES, own, np.where(fewer, COARSER, SITES))
        return found, np.where(alike, 1 / np.sqrt(found) - 1 / np.sqrt(own), 0.0)

    def follow(
        self, inputs: Inputs, *, first: int = 0, continued: bool = True
    ) -> Iterator[tuple[Followed, Float[np.ndarray, " t"], Float[np.ndarray, " t"]]]:
        """Follow the series of every block at inputs, (t, u); with `sites`.

        `first` is the number of those followed before, by which thresholds are drawn.
        """
        for unit in range(inputs.poisson.shape[1]):
            own = inputs.map(lambda x, unit=unit: x[:, unit])
            numbers, (sites, coarse) = self.numbers(own), self.sites(own, continued=continued)
            of_block, top = len(GEOMETRY), "held" if own.get("top_held").flat[0] else "free"
            geometry, contacts = numbers[:, :of_block], numbers[:, of_block : of_block + len(CONTACTS)]
            height = sites / np.exp(numbers[:, GEOMETRY.index("log_ratio")])
            yield followed(geometry, contacts, height, top=top, first=first + APART * unit), sites, coarse

    def guesses(self, m: Measurements) -> list[str]:
        """A pusher over all the side, where none is stated."""
        column = "push_width" + f"_{m.unit[1]}" * m.in_si
        return [f"the pusher covers the whole side above the push, as no {column} is stated"] * (m.push_width is None)

    def left_out(self, m: Measurements, names: Collection[str]) -> list[str]:
        """A machine that gives way, and contacts that age."""
        return ["compliant machine (column machine_stiffness)"] * (m.machine_stiffness is None) + [
            "ageing contacts (newborn, time_constant)"
        ] * ("newborn" not in names)

    def outcomes(self, m: Measurements, inputs: Inputs) -> np.ndarray:
        """As measured: an event spans the block, or stops."""
        return np.where(np.array(m.kind) == "at_least", Outcome.RAN_THROUGH, Outcome.ARRESTED)

    def contacts_broken(self, m: Measurements, inputs: Inputs) -> np.ndarray:
        """Those up to the places measured."""
        return np.ceil(m.length).astype(int)

    def softest(self, m: Measurements) -> np.ndarray:
        """k/K at the least b searched."""
        return 0.02 / (2 * (1 + m.poisson) * m.height)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K searched by default."""
        return 50.0 / (2 * (1 + m.poisson) * m.height)

    def longest(self, inputs: Inputs, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """No force bounds a sequence from above."""
        return np.full(len(low), np.inf), high
