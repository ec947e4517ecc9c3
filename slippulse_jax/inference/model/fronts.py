"""Models of a measured length: inputs, lengths, range, status, words.

A model is `length`, a JAX function of the inputs of one measurement, or a table of `values` that were computed before, such as
those of whole events and blocks. From it come lengths and derivatives of many lanes at once (`evaluate`), which a compiled
kernel may compute. A new model is a new class: one here, which `front_of` chooses, or one of a user, given as ``event``.
"""

import functools
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.base.choices import RightEnd
from slippulse_jax.base.domains import FRICTION, check_choice
from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.base.units import machine_ratio
from slippulse_jax.block import RIGID, USUAL_NORMAL_STIFFNESS
from slippulse_jax.bodies.modes import FARTHEST as NO_END
from slippulse_jax.bulk.chunks import Kernel, Lanes, Layout, distinct_rows, over_lanes
from slippulse_jax.bulk.derivatives import without_derivative
from slippulse_jax.exact import crack
from slippulse_jax.exact.bulk import NEVER, exact_fronts
from slippulse_jax.exact.crossing import expected_length
from slippulse_jax.front.arrest import MOST_BREAKS, arrest
from slippulse_jax.front.front import APPROACH, slip_and_stress
from slippulse_jax.front.lanes import STIFFEST as STIFFEST_RUN_BACK
from slippulse_jax.front.lanes import jet_kernel
from slippulse_jax.inference.choices import Body, MeasuredEvent
from slippulse_jax.inference.model.family import FLAGS, SEARCHED, Families, geometry_of
from slippulse_jax.inference.model.inputs import COMMON, Input, Inputs
from slippulse_jax.inference.model.interpolation import Grid
from slippulse_jax.inference.model.sequence import (
    COARSER,
    CONTACTS,
    GEOMETRY,
    SITES,
    UNITS,
    Cloud,
    Followed,
    Surface,
    coordinates,
    followed,
)
from slippulse_jax.inference.table.columns import NUMERIC
from slippulse_jax.inference.table.measurements import Measurements
from slippulse_jax.interface import Interface
from slippulse_jax.lengths import arrests, length_rank
from slippulse_jax.lengths import lengths as bulk_lengths
from slippulse_jax.slider import Slider
from slippulse_jax.theory import block_decay_length

STIFFEST = 1.0
"""Largest k/K searched: a contact stiffer than the block of bulk it is attached to is outside the model."""
FULL_TO = 200.0
"""Largest b searched for whole events, unless bounds go farther: their cost grows with it."""
RISING = 0.01
"""b up to which every length of a slider certainly rises with stiffness."""
LANES = Layout(chunk=256, fusion_emitters=False)
"""Layout of lanes of models without a kernel of their own."""
LOOP = Layout(chunk=120)
"""Layout of the loop over lanes."""
FEW_LANES = 50_000
"""Lanes up to which lengths alone are taken from the program that has their slopes too, which is then the only one."""
LONGEST, FAR_FROM = 2e4, 0.2
"""Expected length, in λc, up to which that program is as fast as three lengths in closed form; and prestress, or fall of the
thresholds over one height, from which on a front on sloping thresholds may run some `APPROACH` heights."""
SEEN_SOON = 2e3
"""Breaks within which the recursion may take to see that a front never stops; beyond, the closed form is asked first."""
SHORTEST, STEEPEST = 1.01, 0.99
"""Least H/λc, and largest |ν| and |φ|, at which a whole event is computed: inside the domains."""
SPACING = [0.25, 0.2, 0.1, 0.1, 0.1]
"""Spacing of whole events on sliders, in ln H/λc, ln b, ν, φ and ε H/λc."""
FARTHEST, AT_LEAST = 8.0, 2**12
"""Length over H, and contacts, from which on a front through a machine or under an end counts as one that never stops."""
UNLIKE, LOW = 1.1, 400.0
"""Beyond four errors and this factor from all measured lengths over H, an event is that of a slider of at most this H/λc."""
NEARBY = np.linspace(-0.15, 0.15, 13)
"""Changes of ln k/K over which the error of interpolated lengths is averaged, which step at single contacts."""


Predicted = Float[np.ndarray, "order L"]
"""Values for L lanes, (1, L); or with two derivatives along a line of inputs, (3, L), 0 where a value is not finite."""
Along = Float[np.ndarray, "L inputs"] | None
"""Direction of each lane's line, in as many inputs as there are; None for values alone."""


class Regime(NamedTuple):
    """Where in the model's range each row of the inputs lies."""

    b: np.ndarray  # areal stiffness times H over the shear modulus
    slow_decay_length: np.ndarray  # 1/κ_2, or that of an edge load of a block, in λc
    edge_stiffness: np.ndarray  # of a block without end, pushed at its edge, in K


class Front:
    """A model of a measured length."""

    event: ClassVar[Any] = "own"  # a `MeasuredEvent`, of the models here
    body: ClassVar[Body] = "slider"
    inputs: ClassVar[Mapping[str, Input]] = {}  # beside those of every model
    columns: ClassVar[Collection[str]] = ()  # that it reads from `Measurements.other`
    interpolated: ClassVar[bool] = False  # whether its lengths are interpolated, so that no count holds or fails for certain
    most_off: ClassVar[float] = 0.0  # largest `uncertainty` of a length, in λc

    # in words
    name: ClassVar[str] = "first self-healing precursor"
    carrier: ClassVar[str] = "the paper's slider"
    body_modelled: str = "semi-infinite slider"
    length_modelled: ClassVar[str] = "continuous length"
    lengths_are_of: ClassVar[str] = ""  # where that is not the first front
    held: str = "the edge"  # does not move during the event
    thresholds: str = "uniform thresholds"
    # of fits that version 0.2 saved; where lengths are not interpolated nothing is added today
    rising: ClassVar[float] = 0.0  # b up to which every length is known to rise with stiffness
    uncertain_as: ClassVar[str] = "a length between two whole contacts is defined only"

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse columns and parameters without a meaning; a ValueError names them."""
        if "friction" in names:
            raise ValueError("parameter friction: contacts slide only behind a crack-like front: event = 'crack'")

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """Its own inputs that the measurements state, each of shape (n,)."""
        return {}

    def values(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """Lengths of many lanes, in λc.

        0 where no domino starts, inf where nothing stops, NaN where there is none.
        """
        raise NotImplementedError

    def length(self, inputs: Inputs, relaxed: bool) -> Array:
        """Length of one lane in λc, a JAX function.

        With derivatives in forward mode. `relaxed` says that prestress and slope are zero for certain.
        """
        return self._from_table(inputs)

    @staticmethod
    def most(log_height: np.ndarray, names: tuple[str, ...]) -> tuple[Any, ...]:
        """What `in_rows` needs of the largest ln H/λc of each row."""
        return ()

    def in_rows(self, inputs: Inputs, relaxed: bool, *most: Any) -> Float[Array, " m"]:
        """`length` of every row."""
        return jax.vmap(lambda one: self.length(one, relaxed))(inputs)

    def lengths(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """Lengths of many lanes, in λc, as `values`."""
        return self.evaluate(inputs)[0]

    def evaluate(self, inputs: Inputs, along: Along = None) -> Predicted:
        """Lengths of many lanes, and their derivatives along a line."""
        if type(self).values is Front.values:
            return by_jax(type(self).length, self, inputs, along)
        return self.values(inputs)[None] if along is None else self._by_differences(inputs, along)

    def _by_differences(self, inputs: Inputs, along: np.ndarray) -> Predicted:
        """Values of a table, and their central differences along a line."""
        table, every = inputs.table(), {**COMMON, **self.inputs}
        steps = np.array([every[name].step for name in inputs.names])
        steps = steps * np.where(np.array(inputs.names) == "threshold_slope", np.exp(-table[:, :1]), 1.0)
        moves = (along != 0).any(axis=1)
        reach = 1 / np.where(moves, np.max(np.abs(along) / steps, axis=1), 1)  # the largest step is that of its input
        low, high = (np.array([every[name].domain[i] for name in inputs.names]) for i in (0, 1))
        with np.errstate(invalid="ignore"):  # inf − inf of blocks without end, and where nothing stops
            places = [np.where(along != 0, np.clip(table + k * reach[:, None] * along, low, high), table) for k in (0, 1, -1)]
            rows, own = distinct_rows(np.concatenate(places))
            value, *sides = self.values(Inputs.from_table(inputs.names, rows))[own].reshape(3, -1)
            # next to where nothing stops, and at the side of a domain, one side counts
            there = [np.isfinite(x) & (place != table).any(axis=1) for x, place in zip(sides, places[1:], strict=True)]
            up, down = (np.where(known, x, value) for x, known in zip(sides, there, strict=True))
            slope = (up - down) / (np.maximum(sum(there), 1) * reach)
            bend = (up - 2 * value + down) / reach**2 * (there[0] & there[1])
        stops = np.isfinite(value) & moves
        return np.stack([value, np.where(stops, slope, 0), np.where(stops, bend, 0)])

    def _from_table(self, inputs: Inputs) -> Array:
        """Length from a table as a JAX function, with first derivatives."""
        names = inputs.names

        def called(of: Callable[..., np.ndarray], *lanes: Array) -> Array:
            dtype = lanes[0].dtype
            words = (dtype.itemsize // 4,)[: dtype.itemsize > 4]  # in a thread of XLA's, JAX would round what is double

            def on_host(*lanes: Any) -> np.ndarray:
                given = [np.ascontiguousarray(x).view(dtype).reshape(*x.shape[: x.ndim - len(words)]) for x in lanes]
                rows, *along = (x.reshape(-1, len(names)).astype(float) for x in given)
                found = np.asarray(of(Inputs.from_table(names, rows), *along), dtype)
                return found.view(np.uint32).reshape(*given[0].shape[:-1], *words)

            bits = [lax.bitcast_convert_type(x, jnp.uint32) for x in lanes]
            found = jax.pure_callback(on_host, jax.ShapeDtypeStruct(words, jnp.uint32), *bits, vmap_method="broadcast_all")
            return lax.bitcast_convert_type(found, dtype)

        @jax.custom_jvp
        def length(lane: Array) -> Array:
            return called(self.lengths, lane)

        @length.defjvp
        def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:  # pyright: ignore[reportUnusedFunction]
            return length(*primals), slope(*primals, *tangents)

        slope = without_derivative(
            lambda lane, along: called(lambda at, way: self.evaluate(at, way)[1], lane, along),
            "the length of a whole event comes from a table, which has first derivatives only",
        )

        return length(jnp.stack([jnp.asarray(inputs.get(name)) for name in names]))

    def status(self, inputs: Inputs) -> np.ndarray:
        """`Outcome` of each, by its length."""
        found = self.lengths(inputs)
        ends = np.isfinite(inputs.get("log_sites")) if "log_sites" in inputs.names else np.zeros(found.shape, bool)
        endless = np.isinf(found)
        kinds = {Outcome.RAN_THROUGH: endless & ends, Outcome.RUN_AWAY: endless, Outcome.ARRESTED: found > 0}
        kinds |= {Outcome.LIMIT: np.isnan(found)}
        return np.select(list(kinds.values()), list(kinds), Outcome.NO_DOMINO)

    def breaks_again(self, inputs: Inputs) -> np.ndarray:
        """Whether the edge would break again, which the model leaves out; (L,)."""
        return np.zeros(inputs.poisson.shape, bool)

    def uncertainty(self, inputs: Inputs) -> np.ndarray | None:
        """Typical error of each length, in λc, shape (L,); None without one."""
        return None

    def softest(self, m: Measurements) -> np.ndarray:
        """k/K of each measurement below which certainly no domino starts.

        There b is far below (λc/H)², and the length is zero.
        """
        return 1e-2 / (2 * (1 + m.poisson) * m.height**3)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K of each measurement searched by default."""
        return np.full(len(m), STIFFEST)

    def ranges(self, m: Measurements) -> dict[str, tuple[float, float]]:
        """Ranges of other parameters searched by default, where it has its own."""
        return {}

    def fields(self, inputs: Inputs, stopped: Array, count: int) -> tuple[Array, Array]:
        """Slip and stress of the first contacts when `stopped` have broken.

        Traced, each of shape (count,).
        """
        return slip_and_stress(sliders(inputs, jnp.exp), inputs.prestress, stopped, count)

    def regime(self, inputs: Inputs) -> Regime:
        """Find b and 1/κ_2 of each row of the inputs."""
        with jax.enable_x64(True):
            return Regime(*map(np.asarray, _regime(sliders(inputs))))

    def longest(self, inputs: Inputs, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the longest length over ln k/K from `low` to `high`.

        By a scan, and closer scans around its top.

        Where lengths are known to rise with stiffness, up to b = `rising`, nothing softer is looked at. Those of blocks under
        friction, and of models of one's own, may fall there.
        """
        rising = (np.log(self.rising) if self.rising else -np.inf) + inputs.log_stiffness - inputs.log_b
        low = np.minimum(np.maximum(low, rising), high)
        best, where = np.empty(len(low)), np.empty(len(low))
        for count in (129, 17, 17, 17, 17):
            grid = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, count)
            lanes = inputs.take(np.repeat(np.arange(len(low)), count))._replace(log_stiffness=grid.ravel())
            length = np.nan_to_num(self.lengths(lanes), posinf=np.inf).reshape(grid.shape)
            top = length.argmax(axis=1)
            rows = np.arange(len(low))
            best, where = length[rows, top], grid[rows, top]
            step = (high - low) / (count - 1)
            low, high = np.maximum(where - step, low), np.minimum(where + step, high)
        return best, where


ENDED = ("log_sites", "log_machine")
"""Inputs of a slider that ends, or is pushed by a machine that gives way; inf in rows without."""


class FirstFront(Front):
    """The first front of a slider, by the recursion.

    The slider may end, or be pushed through a spring.
    """

    event = "domino"
    rising = RISING
    inputs = {
        "log_sites": Input("L/λc", np.log(2.0), np.inf, "must be at least 2"),
        "log_machine": Input("M/K", np.log(1e-30), np.inf, "must be positive"),
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
        return jnp.asarray(arrest(sliders(inputs, jnp.exp), _interface(inputs, relaxed)).length)

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
                return _joined(
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
            return _joined(far, *(self.values(inputs.take(here)) for here in (far, ~far)))
        if far.any():
            return reach if np.isinf(reach).all() else self.in_closed_form(inputs)
        most = self.most(inputs.log_height, inputs.names)[0]
        return self.within_reach(inputs, bulk_lengths(*recursion_inputs(inputs, is_relaxed(inputs)), most=most), most)

    def in_closed_form(self, inputs: Inputs) -> np.ndarray:
        """ℓ* of fronts without end; NotConverged names one that has none."""
        lanes = _lanes(inputs)
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
        lanes = _lanes(inputs)
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
        uneven = (inputs.prestress != 0) | (inputs.threshold_slope != 0) | bool({*ENDED} & {*inputs.names})
        may = uneven | (np.exp(inputs.log_b) >= NEVER)
        return self.status(inputs) == Outcome.REBREAK if may.any() else may


class WholeEvent(Front):
    """The whole event on a slider: ℓ times an interpolated factor."""

    event = "full"
    rising = RISING
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
            raise ValueError("event = 'full': gauges, block_length and machine_stiffness need the model of one front")

    def values(self, inputs: Inputs) -> np.ndarray:
        """ℓ times `over_front`.

        Of lengths unlike all that were measured, that of a lower slider of the same b: a few per cent off, and quick.
        """
        found, lanes = FirstFront().lengths(inputs), _lanes(inputs)
        front, height = found.copy(), lanes[0]
        stops, same = np.isfinite(front) & (front > 0), np.ones(len(height))
        size = np.maximum(height / LOW, 1) if self.largest > 0 else same
        low = lanes * np.stack([1 / size, size, same, same, size])
        found[stops] *= self.over_front(low[:, stops])
        near = np.where(np.isnan(found), front, found) / height
        like = stops & (size > 1) & (near >= self.least) & (near <= self.largest)
        found[like] = front[like] * self.over_front(lanes[:, like])
        return found

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
    interface = Interface(np.clip(prestress, -STEEPEST, STEEPEST), slope / height) if prestress.any() or slope.any() else None
    front = bulk_lengths(slider, interface)
    with np.errstate(invalid="ignore"):
        return np.where(front > 0, bulk_lengths(slider, interface, event="full") / front, 1)[:, None]


class CrackFront(Front):
    """A crack-like front, behind which contacts slide, in closed form."""

    event = "crack"
    rising = RISING
    inputs = {"friction": Input("σ_k/σ_s", 0.0, 1.0, "must be 0 or more, and below 1", 1e-5, (0.0, np.inf))}
    name = "first crack-like precursor"
    length_modelled = "contacts behind it slide at the friction σ_k; exact length"
    lengths_are_of = "crack-like fronts"

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Ask for a friction, and refuse ends and sloping thresholds."""
        if "friction" not in names:
            raise ValueError("event = 'crack': friction is neither fitted nor held; in σ_s, as fixed = {'friction': 0.3}")
        if "threshold_slope" in names:
            raise ValueError("parameter threshold_slope: a crack-like front has a closed form on level thresholds only")
        if m.block_length is not None or m.machine_stiffness is not None:
            raise ValueError("event = 'crack': for a block without end, whose edge is held")
        if m.or_zero("threshold_slope").any():
            raise ValueError(f"{m.source}: event = 'crack' takes level thresholds, without threshold_slope")

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """No friction: it is fitted or held."""
        return {"friction": np.zeros(len(m))}

    def length(self, inputs: Inputs, relaxed: bool) -> Array:
        """Length of one crack-like front, in λc."""
        return crack.length(sliders(inputs, jnp.exp), inputs.get("friction"), inputs.prestress)[0]

    def status(self, inputs: Inputs) -> np.ndarray:
        """Outcome of each crack-like front."""
        return over_lanes(_crack_status, [*_lanes(inputs)[:4], inputs.get("friction")], LANES)[0]

    def fields(self, inputs: Inputs, stopped: Array, count: int) -> tuple[Array, Array]:
        """Slip and stress of the first `count` contacts of one front, traced."""
        slider, friction = sliders(inputs, jnp.exp), inputs.get("friction")
        site = jnp.arange(count, dtype=jnp.result_type(stopped))
        return jax.vmap(lambda one: crack.fields(slider, friction, inputs.prestress, stopped, one))(site)


class BlockEvent(Front):
    """The whole event on a block that is pushed at a height."""

    event = "full"
    body = "block"
    inputs = {
        "log_push": Input("h/H", -np.inf, 0.0, "the push must lie below the top of the block"),
        "log_push_width": Input("w/H", -np.inf, np.inf, ""),
        "log_sites": Input("L/λc", np.log(2.0), np.inf, "must be at least 2"),
        "friction": Input("μ", 0.0, np.inf, FRICTION.requirement, 1e-4, (0.0, np.inf)),
        "log_normal_stiffness": Input("k_n/k", -np.inf, np.inf, ""),
        **{name: Input("", 0.0, 1.0, "") for name in FLAGS},
    }
    interpolated = True
    most_off = np.inf
    name = "first precursor"
    carrier = "a block under two-dimensional elasticity"
    body_modelled = "semi-infinite block under two-dimensional elasticity, pushed at a height"
    length_modelled = "length of the whole event, in which contacts may break again"
    held = "the pusher"
    uncertain_as = "lengths on a block are interpolated, between coarser blocks and across falls to a few contacts,"
    refused: ClassVar[dict[str, str]] = {
        "displacement": "from lengths alone: leave it out",
        "force": "from lengths alone: leave it out",
        "gauges": "from lengths alone: leave it out",
        "machine_stiffness": "whose pusher is held: leave it out. The stiffness is then too large, as a machine takes part of "
        "the load; by about what factor, the row of machines in the report of a table without the columns of the push says",
    }
    """What measurements may state beside lengths, and a fit of a block cannot take; and what a block it takes instead."""

    def __init__(self, *tables: Measurements, tried: bool = False) -> None:
        """Follow blocks like those measured from theirs, in any of the tables.

        Blocks that are `tried`, for what they would make of a fit, are followed at fewer stiffnesses.
        """
        self.followed = Families(tried=tried)
        whole = [m for m in tables if m.push_height is not None and not np.isnan(m.push_height).any()]
        for m in whole:
            own = Inputs.of(m.height, 1.0, m.poisson, m.or_zero("prestress")).given(**self.stated(m))
            self.followed.add(geometry_of(own), m.length / m.height, m.height)
        if whole:
            m = whole[0]
            if m.block_length is not None:
                self.body_modelled = self.body_modelled.replace("semi-infinite block", "block with a free end")
            if m.friction is not None:
                stiffness = " and stiffnesses" * ("multicontact" in m.contact_law)
                self.thresholds = f"thresholds{stiffness} that follow the pressure"
            if "held" in m.top:
                self.held = "the pusher and the top of the block"

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Ask for a push, and refuse what blocks cannot take."""
        if m.push_height is None:
            raise ValueError(f"{m.source}: a block needs the height of the push: give push_height (push_height_mm in a table)")
        if np.isnan(m.push_height).any():
            blank = m.place(int(np.argmax(np.isnan(m.push_height))))
            raise ValueError(f"{blank}, column push_height: missing: a block needs the height of the push of every measurement")
        if "friction" in names and m.friction is None:
            raise ValueError("parameter friction: the measurements state no friction to start from; a guess is enough")
        for name, why in self.refused.items():
            if getattr(m, name) is not None:
                own, push = m.heading(name), m.heading("push_height")
                raise ValueError(f"{m.source}: {own} beside {push}: a fit of a block takes one {why} (docs/fit/own_csv.md)")
        if "threshold_slope" in names or m.or_zero("threshold_slope").any():
            raise ValueError(f"{m.source}: threshold_slope: a fit of a block takes level thresholds")

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """The push on each block, its end, and what the pressure does."""
        assert m.push_height is not None

        def log(x: np.ndarray | None) -> np.ndarray:
            return np.full(len(m), np.inf) if x is None else np.log(np.where(np.isnan(x), np.inf, x))

        ended, normal = {} if m.block_length is None else {"log_sites": log(m.block_length)}, log(m.normal_stiffness)
        if m.friction is not None:
            usual = np.full(len(m), np.log(USUAL_NORMAL_STIFFNESS))
            normal = usual if m.normal_stiffness is None else np.minimum(normal, np.log(RIGID))
        texts = zip(FLAGS, (m.push_control, m.contact_law, m.top), ("force", "multicontact", "held"), strict=True)
        return ended | {
            "log_push": np.log(m.push_height / m.height),
            "log_push_width": log(m.push_width) - np.log(m.height),
            "friction": m.or_zero("friction"),
            "log_normal_stiffness": normal,
            **{name: np.array([one == word for one in text] or [False] * len(m), float) for name, text, word in texts},
        }

    def values(self, inputs: Inputs) -> np.ndarray:
        """Interpolated ℓ in λc."""
        return self.followed(inputs)[0]

    def uncertainty(self, inputs: Inputs) -> np.ndarray | None:
        """How far lengths may be off, for their contacts and near falls."""
        return self.followed(inputs)[1]

    def softest(self, m: Measurements) -> np.ndarray:
        """k/K at the least b searched."""
        return SEARCHED[0] / (2 * (1 + m.poisson) * m.height)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K searched by default."""
        return np.minimum(STIFFEST, SEARCHED[1] / (2 * (1 + m.poisson) * m.height))

    def regime(self, inputs: Inputs) -> Regime:
        """Find b, and over what length an edge load decays."""
        found = super().regime(inputs)
        decay = np.exp(inputs.log_height) * block_decay_length(found.b, inputs.poisson)
        return found._replace(slow_decay_length=decay)


ROUGHNESS = 0.01
"""How far forces by place of a single series lie from the trend, in μF_N: to rank series before there is a surface."""

APART = 1_000_000
"""Between the numbers from which thresholds of two sequences are drawn."""
STEP = 1e-3
"""Step of θ over which curves of the numbers of a series are differences."""
NEAR = 0.6
"""How many series a surface has near where it is read, at least; one that is as far as its lengths counts 0.6."""
NEAR_END = 0.05
"""Part of the block within which a length that is stated of an event that spans is its end."""


class BlockSequence(BlockEvent):
    """Sequences of a block: force at which its front first reaches places.

    Forces are over the normal load.
    Of one more datum per sequence whose events are numbered, the logarithm of the first length over that of the block.
    """

    event = "sequence"
    inputs = {
        **BlockEvent.inputs,
        "log_machine": FirstFront.inputs["log_machine"],
        "newborn": Input("newborn", 0.0, 1.0, "must lie in (0, 1]", 1e-4, (0.01, 1.0)),
        "log_time": Input("τ/u_s", -np.inf, np.inf, ""),
        "threshold_scatter": Input("scatter", 0.0, 0.3, "must lie in [0, 0.3)", 1e-4, (0.0, 0.3)),
        "log_extent": Input("", -np.inf, np.inf, ""),
        "datum": Input("", 0.0, np.inf, ""),
    }
    most_off = 0.0  # `search.clouds` adds errors
    name = "sequence of precursors"
    body_modelled = "block with a free end under two-dimensional elasticity, pushed at a height"
    length_modelled = "force at which the front first reaches a place"
    refused: ClassVar[dict[str, str]] = {
        "displacement": "from forces and lengths alone: leave it out",
        "gauges": "from forces and lengths alone: leave it out",
    }
    thresholds: str = "thresholds that follow the pressure"
    model_error: float = 0.0  # of a force, in μF_N, beyond the order of breaks and places
    error_is_fitted: bool = False
    continued: bool = True  # whether every other series of a block of very many contacts has fewer

    def __init__(self, m: Measurements, **_: bool) -> None:
        none = np.zeros(len(m), int)
        keys = list(zip(m.sequence or none, m.specimen or none, strict=True))
        self.group = np.array([list(dict.fromkeys(keys)).index(key) for key in keys])
        self.clouds = [Cloud() for _ in range(self.group.max() + 1)]
        self.surfaces: list[Surface | None] = [None for _ in self.clouds]
        ends = np.full(len(m), np.nan) if m.block_length is None else m.block_length
        spans = np.array(m.kind) == "at_least"
        self.place = np.where(spans, np.nextafter(1.0, 0), m.length / ends)
        contact = 1 / np.minimum(ends, SITES)
        own = contact * np.where(ends > SITES, 1.0, 0.5)  # of a front between two; and of contacts of another size
        self.error = np.where(spans, 0.0, np.hypot(np.nan_to_num(m.sigma) / ends, own))
        self.advance = 1.5 * contact
        self.numbered = m.event is not None
        self.first = np.flatnonzero(m.or_zero("event") == 1)

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Ask for a push, an end, a friction and a normal load."""
        if m.block_length is None or np.isnan(m.block_length).any():
            raise ValueError(f"{m.source}: a sequence ends as the front spans the block: give block_length (block_length_mm)")
        if m.friction is None and "friction" not in names:
            raise ValueError('parameter friction: neither stated nor fitted nor held: free = ["stiffness", "friction"]')
        if shared := {"model_factor", "offset"} & {*names}:
            raise ValueError(
                f"parameter {min(shared)}: of lengths; what a model of a sequence leaves out is an error of forces"
            )
        if m.normal_load is None and "normal_load" not in names:
            raise ValueError("parameter normal_load: neither stated nor fitted nor held: forces scale with it")
        if "force" in m.push_control:
            raise ValueError(f"{m.source}: push_control = 'force': the pusher of a sequence is displaced")
        if "multicontact" in m.contact_law:
            raise ValueError(f"{m.source}: contact_law = 'multicontact': series of such contacts take too long for a sequence")
        self._check_alike(m)
        kind = np.array(m.kind)
        short = (kind == "at_least") & (m.length < (1 - NEAR_END) * m.block_length)
        if (wrong := (kind == "whole") | short).any():
            where = "a sequence has places, and the end of the block where the event spans (spans, or kind at_least)"
            raise ValueError(f"{m.place(i := int(np.argmax(wrong)))}: {m.in_its_unit(i, m.length[i])}, {kind[i]}: {where}")
        for name, row in (("force", m.force), ("normal_load", m.normal_load)):
            if row is not None and np.isnan(row).any():
                raise ValueError(f"{m.place(int(np.argmax(np.isnan(row))))}, column {m.heading(name)}: missing")
        super().check(m, {*names} - {"friction"})

    def _check_alike(self, m: Measurements) -> None:
        """Refuse a sequence of several blocks, or of several runs."""
        keys = list(zip(self.group.tolist(), m.or_zero("event").tolist(), strict=True))
        for i in (i for i, key in enumerate(keys) if m.event is not None and key in keys[:i]):
            again = f"{keys[i][1]:g}: a second time; name the runs in a column sequence"
            raise ValueError(f"{m.place(i)}, column {m.heading('event')}: {again}")
        one_of = set(NUMERIC) - {"length", "length_sigma", "force", "force_sigma", "event"}
        for name in (name for name in NUMERIC if name in one_of and getattr(m, name) is not None):
            x = np.nan_to_num(getattr(m, name), nan=-1.0)
            first = x[[int(np.argmax(self.group == group)) for group in self.group]]
            if (x != first).any():
                i = int(np.argmax(x != first))
                raise ValueError(
                    f"{m.place(i)}, column {m.heading(name)}: another one than in the first row of its sequence, which is of "
                    "one block: tell sequences apart in a column sequence"
                )

    def ranges(self, m: Measurements) -> dict[str, tuple[float, float]]:
        """Friction and normal load that the largest force allows.

        It is 0.3 to 1 of μF_N, with μ from 0.05 to 1.2.
        """
        assert m.force is not None
        most = float(np.max(m.force))
        if m.normal_load is None:
            return {"friction": (0.05, 1.2), "normal_load": (most / 1.2, most / 0.015)}
        share = float(np.max(m.force / m.normal_load))
        return {"friction": (share, share / 0.3)}

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """Block and push as of one event, and machine, ageing and datum."""
        none = np.zeros(len(m))
        usual = np.full(len(m), np.log(USUAL_NORMAL_STIFFNESS))
        normal = usual if m.normal_stiffness is None else np.log(np.minimum(m.normal_stiffness, RIGID))
        return super().stated(m) | {
            "log_normal_stiffness": normal,
            "log_machine": FirstFront().stated(m).get("log_machine", none + np.inf),
            "newborn": none + 1,
            "log_time": none,
            "threshold_scatter": none,
            "log_extent": none,
            "datum": np.arange(len(m), dtype=float),
        }

    def _numbers(self, inputs: Inputs) -> Float[np.ndarray, "L 13"]:
        """What a series depends on, and how it is read."""
        given = {
            "log_ratio": inputs.get("log_sites") - inputs.log_height, "log_b": inputs.log_b, "poisson": inputs.poisson,
            "prestress": inputs.prestress,
        }  # fmt: skip
        return np.stack([given[name] if name in given else inputs.get(name) for name in UNITS], axis=-1)

    def _followed(self, inputs: Inputs, row: int) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
        """Number of contacts on which series are followed; their excess size.

        Those of the block; or where they are too many `SITES` and, every other series, fewer, so that their size, over L, can
        be continued to that of the block. Where thresholds scatter that would be another scatter, and `SITES` it is.
        """
        own = np.exp(inputs.get("log_sites")[:, row])
        alike = inputs.get("threshold_scatter")[:, row] == 0
        fewer = alike & (np.arange(len(own)) % 2 == 1) & self.continued
        sites = np.where(own <= SITES, own, np.where(fewer, COARSER, SITES))
        return sites, np.where(alike, 1 / sites - 1 / own, 0.0)

    def series(self, inputs: Inputs) -> Iterator[tuple[np.ndarray, Followed]]:
        """Follow the series of every sequence at inputs, (t, n)."""
        every = self._numbers(inputs)
        for group in range(len(self.clouds)):
            rows = np.flatnonzero(self.group == group)
            numbers = every[:, rows[0]]
            top = "held" if inputs.get("top_held").flat[rows[0]] else "free"
            height = self._followed(inputs, rows[0])[0] / np.exp(numbers[:, GEOMETRY.index("log_ratio")])
            of_block, first = len(GEOMETRY), len(self.clouds[group].numbers) + APART * group
            contacts = numbers[:, of_block : of_block + len(CONTACTS)]
            yield rows, followed(numbers[:, :of_block], contacts, height, top=top, first=first)

    def follow(self, inputs: Inputs) -> None:
        """Add series of every sequence at inputs of shape (t, n)."""
        every = self._numbers(inputs)
        for cloud, (rows, series) in zip(self.clouds, self.series(inputs), strict=True):
            numbers = every[:, rows[0]]
            friction = numbers[:, [len(GEOMETRY) + CONTACTS.index("friction")]]
            extent, arrested = inputs.get("log_extent")[:, rows], self.error[rows] > 0
            place = self.place[rows] * np.exp(-extent * arrested)  # over the length that the block then has
            force, spread = series.force_at(place, self.error[rows])
            length, begins = series.first(float(self.advance[rows[0]]))
            if self.numbered:
                found = series.force_of_arrest(place[:, arrested], self.error[rows[arrested]])
                force[:, arrested], spread[:, arrested] = found
                own = np.isin(rows, self.first)
                force[:, own], spread[:, own] = begins[:, None], 0.0
            with np.errstate(divide="ignore"):  # no event, no length
                read = np.column_stack([friction * force, friction * spread, np.log(length) + extent[:, 0]])
            cloud.add(numbers, read, self._followed(inputs, rows[0])[1])

    def fitted(self, rows: np.ndarray | None, tuned: bool = False) -> None:
        """Read surfaces through these series from here on.

        Without any, the nearest series.
        """
        self.surfaces = [None if rows is None else Surface(cloud, rows, tuned) for cloud in self.clouds]

    def evaluate(self, inputs: Inputs, along: Along = None) -> Predicted:
        """Forces of many lanes, and their derivatives along a line."""
        if along is None:
            return self._read(inputs, uncertain=False)[None]
        sides = [
            coordinates(self._numbers(Inputs.from_table(inputs.names, inputs.table() + side * STEP * along)))
            for side in (-1, 0, 1)
        ]
        way, bend = (sides[2] - sides[0]) / (2 * STEP), (sides[2] - 2 * sides[1] + sides[0]) / STEP**2
        found = np.zeros((3, len(way)))
        found[0] = self._read(inputs, uncertain=False)
        for here, group, distinct, own, column in self._columns(inputs, uncertain=False):
            surface = self.surfaces[group]
            assert surface is not None
            first, second = (x[own, ..., column] for x in surface.derivatives(distinct))
            w = way[here][:, surface.moving]
            found[1, here] = np.einsum("la,la->l", first, w)
            found[2, here] = np.einsum("lab,la,lb->l", second, w, w) + np.einsum(
                "la,la->l", first, bend[here][:, surface.moving]
            )
        return np.where(np.isfinite(found[0]) | (np.arange(3) == 0)[:, None], found, 0)

    def _columns(self, inputs: Inputs, uncertain: bool) -> Iterator[tuple]:
        """Lanes of each sequence, and what is read.

        Where they are, which sequence, distinct numbers, which of these, and the columns.
        """
        numbers, datum = self._numbers(inputs), np.asarray(inputs.get("datum")).astype(int)
        n = len(self.group)
        for group in range(len(self.clouds)):
            here = np.flatnonzero(self.group[datum % n] == group)
            if not here.size:
                continue
            distinct, own = distinct_rows(numbers[here])
            rows = np.flatnonzero(self.group == group)
            column = np.searchsorted(rows, datum[here] % n) + uncertain * len(rows)
            yield here, group, distinct, own, np.where(datum[here] >= n, 2 * len(rows), column)

    def _read(self, inputs: Inputs, uncertain: bool) -> np.ndarray:
        found = np.zeros(inputs.poisson.shape)
        for here, group, distinct, own, column in self._columns(inputs, uncertain):
            surface = self.surfaces[group]
            if surface is None:
                found[here] = self.clouds[group].nearest(distinct)[own, column]
                continue
            values, near = surface(distinct)
            found[here] = np.where(near < NEAR, np.nan, values.T).T[own, column]
        return np.where(np.isnan(found), np.inf, found)

    def values(self, inputs: Inputs) -> np.ndarray:
        """Forces over the normal load.

        Of the data beyond, ln of the first length over that of the block.
        """
        return self._read(inputs, uncertain=False)

    def uncertainty(self, inputs: Inputs) -> np.ndarray | None:
        """Errors of forces of a single series over the normal load."""
        return np.hypot(self._read(inputs, uncertain=True), np.hypot(self.model_error, ROUGHNESS) * inputs.get("friction"))

    def covariance(self, inputs: Inputs) -> Float[np.ndarray, "n n"]:
        """Covariance of the errors of forces over the normal load.

        Of their places, of what the model leaves out, and of how far series lie from their surface: neighbours, which may be
        of one event, err together.
        """
        found = np.diag(self._read(inputs, uncertain=True) ** 2 + (self.model_error * inputs.get("friction")) ** 2)
        numbers = self._numbers(inputs)
        for group, surface in enumerate(self.surfaces):
            rows = np.flatnonzero(self.group == group)
            if surface is not None:
                found[np.ix_(rows, rows)] += surface.covariance(numbers[rows[0]])[: len(rows), : len(rows)]
        return found

    def softest(self, m: Measurements) -> np.ndarray:
        """k/K at the least b searched."""
        return 0.02 / (2 * (1 + m.poisson) * m.height)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K searched by default."""
        return 50.0 / (2 * (1 + m.poisson) * m.height)

    def longest(self, inputs: Inputs, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """No force bounds a sequence from above."""
        return np.full(len(low), np.inf), high


FRONTS: dict[tuple[Body, MeasuredEvent], type[Front]] = {
    (front.body, front.event): front for front in (FirstFront, WholeEvent, CrackFront, BlockEvent, BlockSequence)
}
"""Models by body and event."""
_shared = functools.cache(lambda model: model())


def front_for(body: Body, event: MeasuredEvent, *tables: Measurements) -> Front:
    """A model by body and event; with a table, for these measurements."""
    model = FRONTS[body, event]
    return model(*tables) if model.interpolated else _shared(model)  # whose compiled programs all fits share


def front_of(m: Measurements, event: MeasuredEvent | Front | None = None, body: Body | None = None) -> Front:
    """Choose the model of measured lengths; a ValueError if there is none.

    By default a block and its whole event where every measurement states how its side is pushed, unless the event is one of
    sliders only; else a slider and its first front.
    """
    if isinstance(event, Front):
        if type(event).length is Front.length and type(event).values is Front.values:
            raise TypeError(f"event: {type(event).__name__} has neither a length nor values (docs/howto/extend.md)")
        return event
    if isinstance(event, type) and issubclass(event, Front):
        raise TypeError(f"event: give {event.__name__}(), a model, and not its class")
    if event is not None:
        check_choice("event", event, MeasuredEvent)
    if event == "sequence" and not m.is_sequence:
        raise ValueError(f"{m.source}: event = 'sequence' needs forces of a block: columns force, force_sigma, push_height")
    if body is not None:
        check_choice("body", body, Body)
    else:
        said = m.push_height is not None and not np.isnan(m.push_height).any()
        body = "block" if said and event in (None, "full", "sequence") else "slider"
    event = event or ("sequence" if body == "block" and m.is_sequence else "full" if body == "block" else "domino")
    if (body, event) not in FRONTS:
        raise ValueError(
            f"event = {event!r}: contacts of a block break in any order, so its length is that of the whole event: 'full'"
        )
    return front_for(body, event, m)


# --- derivatives -------------------------------------------------------------------------------------------------------


def is_relaxed(inputs: Inputs, along: Along = None) -> bool:
    """Whether prestress and slope are zero, and stay so along a line."""
    return not (inputs.prestress.any() or inputs.threshold_slope.any() or along is not None and along[:, 3:5].any())


def by_jax(function: Any, front: Front, inputs: Inputs, along: Along, **options: Any) -> Predicted:
    """Values and derivatives of a ``function(front, inputs, relaxed)`` of one lane."""
    table = inputs.table()
    rows, own = distinct_rows(table if along is None else np.concatenate([table, along], axis=1))
    kernel = _jets(function, front, inputs.names, along is not None, is_relaxed(inputs, along), **options)
    value, *slopes = over_lanes(kernel, rows.T, LANES)[0]
    if np.isnan(value).any():
        where = ", ".join(f"{x:.9g}" for x in rows[np.argmax(np.isnan(value))])
        raise NotConverged(f"no {front.name} at {inputs.names} = ({where})")
    return np.stack([value, *(np.where(np.isfinite(value), x, 0) for x in slopes)])[:, own]


@functools.cache
def _jets(function: Any, front: Front, names: tuple[str, ...], slopes: bool, relaxed: bool, **options: Any) -> Kernel:
    def one(lane: Float[Array, " fields"]) -> Array:
        at, along = lane[: len(names)], lane[len(names) :]

        def value(t: Array) -> Array:
            return function(front, Inputs.from_table(names, at + t * along if slopes else at), relaxed, **options)

        def slope(t: Array) -> Array:
            return jax.jvp(value, (t,), (jnp.ones_like(t),))[1]

        zero = jnp.zeros_like(lane[0])
        return jnp.stack([value(zero), *(jax.jvp(slope, (zero,), (zero + 1,)) if slopes else ())])

    return lambda lanes: (jax.vmap(one, in_axes=1, out_axes=-1)(lanes),)


def lane_fields(inputs: Inputs, along: Inputs, relaxed: bool, numpy: Any) -> tuple[Any, Any]:
    """Numbers of lanes for `jet_kernel`, and their direction.

    A missing end is so far away that no digit changes.
    """
    names, ended = [*COMMON], bool({*ENDED} & {*inputs.names})
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


def _joined(first: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    found = np.empty((*x.shape[:-1], len(first)))
    found[..., first], found[..., ~first] = x, y
    return found


def _rank(lanes: Lanes) -> np.ndarray:
    return length_rank([np.exp(lanes[0]), np.exp(lanes[1]), lanes[2]])


# --- what the recursion takes ------------------------------------------------------------------------------------------


def recursion_inputs(inputs: Inputs, relaxed: bool) -> tuple[Slider, Interface | None]:
    """Sliders and interfaces for the recursion."""
    return sliders(inputs), _interface(inputs, relaxed)


def sliders(inputs: Inputs, exp: Any = np.exp) -> Slider:
    """Sliders of the inputs; of traced ones by JAX's ``exp``.

    Where there is no end or machine, with one so far away, or so stiff, that no digit changes.
    """
    most = np.log(NO_END)
    length, machine = (exp(inputs.more[name].clip(max=most)) if name in inputs.more else None for name in ENDED)
    return Slider(exp(inputs.log_height), exp(inputs.log_stiffness), inputs.poisson, length=length, machine=machine)


def _interface(inputs: Inputs, relaxed: bool) -> Interface | None:
    return None if relaxed else Interface(inputs.prestress, inputs.threshold_slope)


def _lanes(inputs: Inputs) -> Float[np.ndarray, "5 L"]:
    """H/λc, k/K, ν, φ, ε."""
    return np.stack([np.exp(inputs.log_height), inputs.ratio, *inputs[2:5]])


def _crack_status(lanes: Float[Array, "5 L"]) -> tuple[Array]:
    """Status of crack-like fronts at H/λc, k/K, ν, φ and σ_k."""
    return (jax.vmap(lambda lane: crack.length(Slider(*lane[:3]), lane[4], lane[3])[1], 1)(lanes),)


@jax.jit
def _regime(slider: Slider) -> tuple[Array, Array, Array]:
    """`Regime` of sliders, as one program, which compiles sooner than a dozen."""
    k1, k2 = slider.kappa_1, slider.kappa_2
    # the layer is free at the edge: in amplitudes of u_t, A_1 α_1 κ_1 + A_2 α_2 κ_2 = 0 (continuum)
    first, second = slider.alpha_2 * k2, -slider.alpha_1 * k1
    return slider.b, slider.slow_decay_length, slider.K_L * (first * k1 + second * k2) / (first + second)
