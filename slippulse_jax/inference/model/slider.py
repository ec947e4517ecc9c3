"""First front of a slider by the recursion, and its whole event."""

from collections.abc import Collection
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.base.choices import RightEnd
from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.base.units import machine_ratio
from slippulse_jax.bodies.modes import FARTHEST as NO_END
from slippulse_jax.bulk.chunks import Lanes, Layout, distinct_rows, over_lanes
from slippulse_jax.bulk.derivatives import without_derivative
from slippulse_jax.exact.bulk import NEVER, exact_fronts
from slippulse_jax.exact.crossing import expected_length
from slippulse_jax.front.arrest import MOST_BREAKS, arrest
from slippulse_jax.front.front import APPROACH
from slippulse_jax.front.lanes import STIFFEST as STIFFEST_RUN_BACK
from slippulse_jax.front.lanes import jet_kernel
from slippulse_jax.inference.model.front import (
    ENDED,
    RISING,
    STIFFEST,
    Along,
    Front,
    Predicted,
    is_relaxed,
    joined,
    numbers_of,
    sliders,
)
from slippulse_jax.inference.model.inputs import COMMON, KEPT, STEEPEST, Input, Inputs, interface_of
from slippulse_jax.inference.model.interpolation import Grid
from slippulse_jax.inference.table.measurements import Measurements
from slippulse_jax.interface import Interface
from slippulse_jax.lengths import arrests, length_rank
from slippulse_jax.lengths import lengths as bulk_lengths
from slippulse_jax.slider import Slider

FULL_TO = 200.0
"""Largest b searched for whole events, unless bounds go farther: their cost grows with it."""
LOOP = Layout(chunk=120)
"""Layout of the loop over lanes."""
FEW_LANES = 50_000
"""Lanes up to which lengths alone are taken from the program that has their slopes too, which is then the only one."""
LONGEST, FAR_FROM = 2e4, 0.2
"""Expected length, in λc, up to which that program is as fast as three lengths in closed form; and prestress, or fall of the
thresholds over one height, from which on a front on sloping thresholds may run some `APPROACH` heights."""
SEEN_SOON = 2e3
"""Breaks within which the recursion may take to see that a front never stops; beyond, the closed form is asked first."""
SHORTEST = 1.01
"""Least H/λc at which a whole event is computed: inside the domain, as the largest |ν| and |φ| are, `STEEPEST`."""
SPACING = [0.25, 0.2, 0.1, 0.1, 0.1]
"""Spacing of whole events on sliders, in ln H/λc, ln b, ν, φ and ε H/λc."""
FARTHEST, AT_LEAST = 8.0, 2**12
"""Length over H, and contacts, from which on a front through a machine or under an end counts as one that never stops."""
UNLIKE, LOW = 1.1, 400.0
"""Beyond four errors and this factor from all measured lengths over H, an event is that of a slider of at most this H/λc."""
NEARBY = np.linspace(-0.15, 0.15, 13)
"""Changes of ln k/K over which the error of interpolated lengths is averaged, which step at single contacts."""


class FirstFront(Front):
    """The first front of a slider, by the recursion.

    The slider may end, or be pushed through a spring.
    """

    event = "domino"
    rising = RISING
    inputs = {
        "log_sites": Input("L/λc", np.log(2.0), np.inf, "must be at least 2"),
        "log_machine": Input("M/K", np.log(1e-30), np.inf, "must be positive"),
        "residual_strength": KEPT,
    }

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """Logarithms of L/λc and M/K where stated; inf in rows without one."""
        found = {}
        if m.block_length is not None:
            found["log_sites"] = np.log(m.block_length)
        if m.machine_stiffness is not None:
            found["log_machine"] = np.log(machine_ratio(m.machine_stiffness, 1.0 if m.young is None else m.young))
        return {name: np.where(np.isnan(x), np.inf, x) for name, x in found.items() if not np.isnan(x).all()}

    def length(self, inputs: Inputs, relaxed: bool) -> Array:
        """ℓ of one lane."""
        return jnp.asarray(arrest(sliders(inputs, jnp.exp), None if relaxed else inputs.interface).length)

    def evaluate(self, inputs: Inputs, along: Along = None) -> Predicted:
        """ℓ by the loop over lanes.

        Of tall sliders and stiff contacts derivatives are differences.

        inf where a front under an end or a machine runs farther than `FARTHEST`, which a soft machine and a prestress may let
        it do for ever. What never stops by itself does not stop under them either.
        """
        rows, own = distinct_rows(inputs.table())
        return self._evaluate(inputs, along, self.reach(Inputs.from_table(inputs.names, rows))[own])

    def _evaluate(self, inputs: Inputs, along: Along, reach: np.ndarray) -> Predicted:
        never, loop = np.isinf(reach), (reach <= LONGEST) & (inputs.ratio <= STIFFEST_RUN_BACK)
        for some in (never, loop):
            if some.any() and not some.all():
                sides = (some, ~some)
                return joined(
                    some, *(self._evaluate(inputs.take(x), None if along is None else along[x], reach[x]) for x in sides)
                )
        if never.any():
            return np.stack([reach, *([np.zeros_like(reach)] * 2 if along is not None else ())])
        if not loop.any() or along is None and loop.size > FEW_LANES:
            return super().evaluate(inputs, along)
        names, table = inputs.names, inputs.table()
        rows, own = distinct_rows(np.concatenate([table, np.zeros_like(table) if along is None else along], axis=1))
        at, way = rows[:, : len(names)], rows[:, len(names) :]
        (most, right), here = self.most(rows[:, 0], names), Inputs.from_table(names, at)
        fields = lane_fields(here, Inputs.from_table(names, way), is_relaxed(here, way), np)
        (found,) = over_lanes(jet_kernel(most, right), np.concatenate(fields), LOOP, _rank)
        value = self.within_reach(here, found[0], most)
        slopes = () if along is None else np.where(np.isfinite(value), found[1:], 0)
        return np.stack([value, *slopes])[:, own]

    def in_rows(self, inputs: Inputs, relaxed: bool, *most: Any) -> Float[Array, " m"]:
        """ℓ by the same loop, with two derivatives in forward mode."""
        at, _ = lane_fields(inputs, inputs, relaxed, jnp)
        return self.within_reach(inputs, _by_loop(*most, at), most[0], jnp)

    def status(self, inputs: Inputs) -> np.ndarray:
        """`Outcome` of each front, by the recursion; shape (L,)."""
        distinct, own = distinct_rows(inputs.table())
        at = Inputs.from_table(inputs.names, distinct)
        return np.asarray(arrests(*recursion_inputs(at, is_relaxed(at))).status)[own]

    def values(self, inputs: Inputs) -> np.ndarray:
        """Lengths alone, of fronts that run far in closed form, to rounding."""
        reach, ended = self.reach(inputs), {*ENDED} & {*inputs.names}
        far = np.isinf(reach) if ended else reach > LONGEST
        if far.any() and not far.all():
            return joined(far, *(self.values(inputs.take(here)) for here in (far, ~far)))
        if far.any():
            return reach if np.isinf(reach).all() else self.in_closed_form(inputs)
        most = self.most(inputs.log_height, inputs.names)[0]
        return self.within_reach(inputs, bulk_lengths(*recursion_inputs(inputs, is_relaxed(inputs)), most=most), most)

    def in_closed_form(self, inputs: Inputs) -> np.ndarray:
        """ℓ* of fronts without end; NotConverged names one that has none."""
        lanes = numbers_of(inputs)
        found, status = exact_fronts(lanes)
        if np.isnan(found).any():
            where = ", ".join(f"{x:.9g}" for x in lanes[:, np.argmax(np.isnan(found))])
            why = Outcome(int(status[np.argmax(np.isnan(found))])).message
            raise NotConverged(f"no exact length at (H/λc, k/K, ν, φ, ε) = ({where}): {why}")
        return found

    @staticmethod
    def reach(inputs: Inputs) -> np.ndarray:
        """How far each front without end may run, in λc.

        inf where it never stops, if the recursion takes long to see that.
        """
        lanes = numbers_of(inputs)
        height, ratio, poisson, prestress, slope = lanes
        found = expected_length(height, ratio, poisson)
        slow = height * np.sqrt(2 * (1 + poisson) + 1 / (ratio * height))  # 1/κ_2
        tilted = np.maximum(prestress, -slope * height) * (slope != 0)  # of which the closed form takes long too
        found = np.where(tilted > FAR_FROM, np.maximum(APPROACH * height, found), found)
        # far from the edge the contact ahead carries less than twice the prestress
        doubtful = (prestress > 0.5) & (slope == 0) & (APPROACH * slow > SEEN_SOON)
        if doubtful.any():
            exact = exact_fronts(lanes[:, doubtful])[0]
            found[doubtful] = np.where(np.isnan(exact), found[doubtful], exact)
        return found

    @staticmethod
    def most(log_height: np.ndarray, names: tuple[str, ...]) -> tuple[int, RightEnd]:
        """Contacts after which a front never stops; and the right end."""
        if not set(ENDED) & set(names):
            return MOST_BREAKS, "semi-infinite"
        return int(2 ** np.ceil(np.log2(np.maximum(FARTHEST * np.exp(log_height), AT_LEAST))).max()), "free"

    @staticmethod
    def within_reach(inputs: Inputs, value: Any, most: int, numpy: Any = np) -> Any:
        """Lengths, inf where a front runs too far; `numpy` may be JAX's."""
        too_far = numpy.isnan(value) | (value > most if {*ENDED} & {*inputs.names} else False)
        return numpy.where(too_far, np.inf, value)

    def breaks_again(self, inputs: Inputs) -> np.ndarray:
        """Whether the edge is back at its threshold before the front stops."""
        uneven = (numbers_of(inputs)[3:] != 0).any(axis=0) | bool({*ENDED} & {*inputs.names})
        may = uneven | (np.exp(inputs.log_b) >= NEVER)
        return self.status(inputs) == Outcome.REBREAK if may.any() else may


class WholeEvent(Front):
    """The whole event on a slider: ℓ times an interpolated factor."""

    event = "full"
    rising = RISING
    inputs = {"residual_strength": KEPT}
    interpolated = True
    most_off = 1.0
    length_modelled = "length of the whole event, in which contacts may break again"
    lengths_are_of = "whole events"
    uncertain_as = "the length of an event steps where the order of its breaks changes, and is interpolated"

    def __init__(self, *tables: Measurements) -> None:
        self.ratios = Grid(SPACING, _over_front)
        every = [(m.length + side * np.nan_to_num(m.sigma)) / m.height for m in tables for side in (-4, 4)]
        self.least = min((shares.min() for shares in every), default=np.inf) / UNLIKE
        self.largest = max((shares.max() for shares in every), default=0.0) * UNLIKE

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse gauges and ends, which need the model of one front."""
        super().check(m, names)
        if m.gauges is not None or m.block_length is not None or m.machine_stiffness is not None:
            raise ValueError(f"event = {self.event!r}: gauges, block_length and machine_stiffness need the model of one front")

    def values(self, inputs: Inputs) -> np.ndarray:
        """ℓ times `over_front`.

        Of lengths unlike all that were measured, that of a lower slider of the same b: a few per cent off, and quick.
        """
        found, lanes = FirstFront().lengths(inputs), numbers_of(inputs)
        front, height = found.copy(), lanes[0]
        stops, same = np.isfinite(front) & (front > 0), np.ones(len(height))
        size = np.maximum(height / LOW, 1) if self.largest > 0 else same
        low = lanes * np.stack([1 / size, size, same, same, size])
        found[stops] *= self.over_front(low[:, stops])
        near = np.where(np.isnan(found), front, found) / height
        like = stops & (size > 1) & (near >= self.least) & (near <= self.largest)
        found[like] = front[like] * self.over_front(lanes[:, like])
        return found

    def starts(self, inputs: Inputs) -> np.ndarray:
        """Lengths of first fronts."""
        return FirstFront().lengths(inputs)

    def status(self, inputs: Inputs) -> np.ndarray:
        """`Outcome` of the front, with which the event begins."""
        return FirstFront().status(inputs)

    def over_front(self, lanes: Float[np.ndarray, "5 n"]) -> Float[np.ndarray, " n"]:
        """ℓ over that of the front at (H/λc, k/K, ν, φ, ε).

        Along straight lines between nodes; NaN where all were given up.
        """
        height, stiffness, poisson, prestress, slope = lanes
        b = 2 * (1 + poisson) * stiffness * height
        factor = np.ones(lanes.shape[1])
        # one spacing below the onset on relaxed, level interfaces no contact breaks again at any node
        some = np.nonzero((np.log(b) > np.log(NEVER) - SPACING[1]) | (prestress != 0) | (slope != 0))[0]
        if len(some):
            place = np.stack([np.log(height), np.log(b), poisson, prestress, slope * height], axis=1)
            factor[some] = self.ratios(place[some])[0, 0]
        return factor

    def uncertainty(self, inputs: Inputs) -> np.ndarray | None:
        """Root mean square error of the interpolation at stiffnesses nearby."""
        around = inputs.map(lambda x: np.broadcast_to(x, (len(NEARBY), x.size)))
        around = around._replace(log_stiffness=inputs.log_stiffness + NEARBY[:, None]).ravel()
        found = self.lengths(around)
        stops, off = np.isfinite(found), np.zeros(len(found))
        slider, interface = recursion_inputs(around.take(stops), is_relaxed(around))
        off[stops] = bulk_lengths(slider, interface, event="full") - found[stops]
        off = np.where(np.isfinite(off), off, 0).reshape(len(NEARBY), -1)
        return np.sqrt(np.mean(off**2, axis=0))

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K searched by default, up to b = `FULL_TO`."""
        return np.minimum(STIFFEST, FULL_TO / (2 * (1 + m.poisson) * m.height))


def _over_front(place: Float[np.ndarray, "n 5"]) -> Float[np.ndarray, "n 1"]:
    """ℓ of whole events over that of fronts, at nodes.

    Of ln H/λc, ln b, ν, φ and ε H/λc.
    """
    height, b, poisson, prestress, slope = place.T
    height, poisson = np.maximum(np.exp(height), SHORTEST), np.clip(poisson, -STEEPEST, 0.5)
    slider = Slider(height, np.exp(b) / (2 * (1 + poisson) * height), poisson)
    interface = interface_of(prestress, slope / height) if prestress.any() or slope.any() else None
    front = bulk_lengths(slider, interface)
    with np.errstate(invalid="ignore"):
        return np.where(front > 0, bulk_lengths(slider, interface, event="full") / front, 1)[:, None]


# --- the recursion over lanes -------------------------------------------------------------------------------------------


def lane_fields(inputs: Inputs, along: Inputs, relaxed: bool, numpy: Any) -> tuple[Any, Any]:
    """Numbers of lanes for `jet_kernel`, and their direction.

    A missing end is so far away that no digit changes.
    """
    names, ended = [*COMMON, *({"residual_strength"} & {*inputs.more})], bool({*ENDED} & {*inputs.names})
    at, way = ([one.get(name) for name in (names[:3] if relaxed and not ended else names)] for one in (inputs, along))
    far, still = numpy.full_like(at[0], np.log(NO_END)), numpy.zeros_like(at[0])
    for name in ENDED if ended else ():
        there = name in inputs.more
        end = inputs.more[name] if there else far
        at.append(numpy.minimum(end, far))
        way.append(numpy.where(end < far, along.more[name], 0) if there else still)
    return numpy.stack(at), numpy.stack(way)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _by_loop(most: int, right: RightEnd, at: Float[Array, "k m"]) -> Float[Array, " m"]:
    return _jets_along(most, right, at, jnp.zeros_like(at))[0]


@_by_loop.defjvp
def _by_loop_jvp(most: int, right: RightEnd, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    return _with_slope(most, right, *primals, *tangents)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _with_slope(most: int, right: RightEnd, at: Array, along: Array) -> tuple[Array, Array]:
    """ℓ, and its slope along a line, from one loop."""
    value, slope, _ = _jets_along(most, right, at, along)
    return value, slope


@_with_slope.defjvp
def _with_slope_jvp(most: int, right: RightEnd, primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple:
    """Change of a slope along v where the lane moves by w.

    From the bends along v, w and v + w, in one loop: a program that has one for each is six times as large.
    """
    (at, along), (moved, turned) = primals, tangents
    ways = (along, moved, along + moved, turned)
    jets = _bent(most, right, jnp.tile(at, len(ways)), jnp.concatenate(ways, axis=1))
    (value, *_), slope, bend = jnp.split(jets[0], len(ways)), *(jnp.split(x, len(ways)) for x in jets[1:])
    return (value, slope[0]), (slope[1], (bend[2] - bend[0] - bend[1]) / 2 + slope[3])


_bent = without_derivative(
    lambda most, right, at, along: _jets_along(most, right, at, along),
    "the objective has first and second derivatives; for higher ones write it with precursor_length",
    static_argnums=(0, 1),
)


def _jets_along(most: int, right: RightEnd, at: Array, along: Array) -> Float[Array, "3 m"]:
    return jet_kernel(most, right)(jnp.concatenate([at, along]))[0]


def _rank(lanes: Lanes) -> np.ndarray:
    return length_rank([np.exp(lanes[0]), np.exp(lanes[1]), lanes[2]])


def recursion_inputs(inputs: Inputs, relaxed: bool) -> tuple[Slider, Interface | None]:
    """Sliders and interfaces for the recursion."""
    return sliders(inputs), None if relaxed else inputs.interface
