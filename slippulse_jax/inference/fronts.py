"""Models of a measured length, one class each: what it takes, its lengths, its range, its status, its words.

`FirstFront` has a closed form ℓ* without kinks, which starts continuously where the domino starts and costs microseconds per
lane. A new model is a new class here, which `front_of` chooses.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.block import RIGID, USUAL_NORMAL_STIFFNESS
from slippulse_jax.bodies.modes import NO_END, Ends
from slippulse_jax.bulk.chunks import Layout, distinct_rows, over_lanes
from slippulse_jax.domains import FRICTION, check_choice
from slippulse_jax.exact import crack
from slippulse_jax.exact.bulk import exact_fronts
from slippulse_jax.exact.front import exact_length
from slippulse_jax.front.arrest import quantity
from slippulse_jax.front.front import DEFAULT_MAX_CONTACTS, readings
from slippulse_jax.inference.block_lengths import FLAGS, BlockLengths, geometry_of
from slippulse_jax.inference.choices import Body, MeasuredEvent
from slippulse_jax.inference.inputs import COMMON, Input, Inputs
from slippulse_jax.inference.interpolation import whole_over_front
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.interface import Interface
from slippulse_jax.lengths import arrests
from slippulse_jax.lengths import lengths as bulk_lengths
from slippulse_jax.slider import Slider
from slippulse_jax.status import NotConverged, Outcome
from slippulse_jax.theory import block_decay_length
from slippulse_jax.units import machine_ratio

STIFFEST = 1.0
"""Largest k/K searched: a contact stiffer than the block of bulk it is attached to is outside the model."""
FULL_TO = 200.0
"""Largest b searched for whole events, unless bounds go farther: their cost grows with it."""
BLOCK_FROM, BLOCK_TO = 3e-3, 1000.0
"""Range of b searched for blocks, unless bounds go farther. Below it hardly any push starts a domino."""
RISING = 0.01
"""b up to which every length certainly rises with stiffness."""
CRACKS = Layout(chunk=250)
"""Layout of crack-like fronts."""
FARTHEST, AT_LEAST = 8.0, 2**12
"""Length over H, and contacts, from which on a front through a machine or under an end counts as one that never stops."""
NEARBY = np.linspace(-0.15, 0.15, 13)
"""Changes of ln k/K over which the difference between ℓ and ℓ* is averaged: one that ends on a contact shows none."""


class Prediction(NamedTuple):
    """Values for L lanes, and derivatives by the name of the input; 0 where there is no finite value."""

    value: Float[np.ndarray, " L"]
    slopes: dict[str, Float[np.ndarray, " L"]]


class Regime(NamedTuple):
    """Where in the model's range each row of the inputs lies."""

    b: np.ndarray  # areal stiffness times H over the shear modulus
    slow_decay_length: np.ndarray  # 1/κ_2, or that of an edge load of a block, in λc
    edge_stiffness: np.ndarray  # of a block without end, pushed at its edge, in K


class Front:
    """A model of a measured length."""

    event: ClassVar[MeasuredEvent] = "domino"
    body: ClassVar[Body] = "slider"
    inputs: ClassVar[Mapping[str, Input]] = {}  # beside those of every model
    traceable: ClassVar[bool] = True  # whether JAX can trace its length
    interpolated: ClassVar[bool] = False  # whether its lengths are interpolated, so that no count holds or fails for certain
    most_off: ClassVar[float] = 1.0  # largest `uncertainty` of a length, in λc: ℓ and ℓ* lie between the same two contacts

    # in words
    name: ClassVar[str] = "first self-healing precursor"
    carrier: ClassVar[str] = "the paper's slider"
    body_modelled: str = "semi-infinite slider"
    length_modelled: ClassVar[str] = "exact length"
    lengths_are_of: ClassVar[str] = ""  # where that is not the first front
    held: str = "the edge"  # does not move during the event
    thresholds: str = "uniform thresholds"
    uncertain_as: ClassVar[str] = "the definition of a length between two whole contacts changes it by"

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse columns and parameters that have no meaning for this model; a ValueError names them."""
        if "friction" in names:
            raise ValueError("parameter friction: contacts slide only behind a crack-like front: event = 'crack'")

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """Values of its own inputs that the measurements state, each of shape (n,)."""
        return {}

    def lengths(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """Lengths in λc; 0 where no domino starts, inf where nothing stops. NotConverged names inputs where none was found."""
        raise NotImplementedError

    def status(self, inputs: Inputs) -> np.ndarray:
        """`Outcome` of each front, by the recursion that breaks its contacts one by one; shape (L,)."""
        distinct, own = distinct_rows(inputs.table())
        slider, interface, ends = recursion_inputs(Inputs.from_table(inputs.names, distinct))
        return np.asarray(arrests(slider, interface, ends=ends).status)[own]

    def breaks_again(self, inputs: Inputs) -> np.ndarray:
        """Whether the edge contact would break again before the front stops, which the model leaves out; shape (L,)."""
        return np.zeros(inputs.poisson.shape, bool)

    def uncertainty(self, inputs: Inputs) -> np.ndarray | None:
        """Typical error of each length, in λc, shape (L,); None where there is none to speak of."""
        return None

    def softest(self, m: Measurements) -> np.ndarray:
        """k/K of each measurement below which certainly no domino starts (b far below (λc/H)²), so that the length is zero."""
        return 1e-2 / (2 * (1 + m.poisson) * m.height**3)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K of each measurement searched by default."""
        return np.full(len(m), STIFFEST)

    def traced(self, inputs: Inputs, relaxed: bool) -> Array:
        """Length of one lane as a JAX function; `relaxed` says that prestress and slope are zero for certain."""
        raise ValueError(
            f"event = {self.event!r}: the length of a whole event cannot be traced; −problem(theta) has the density"
        )

    def fields(self, inputs: Inputs, stopped: Array, count: int) -> tuple[Array, Array]:
        """Slip and stress of the first `count` contacts when `stopped` have broken, traced; each of shape (count,)."""
        return readings(sliders(inputs, jnp.exp), inputs.prestress, stopped, count, ends_of(inputs, jnp.exp))

    def regime(self, inputs: Inputs) -> Regime:
        """Find b and 1/κ_2 of each row of the inputs."""
        with jax.enable_x64(True):
            return Regime(*map(np.asarray, _regime(sliders(inputs))))

    def predict(self, inputs: Inputs, wanted: Collection[str] = ()) -> Prediction:
        """Lengths and their derivatives in the `wanted` inputs.

        By central differences, good to 1e-8 of the larger of derivative and length except next to run-away and where the domino
        just starts. Two more lengths per derivative cost some 25 µs per lane, exact derivatives 1100 µs.
        """
        return by_differences(self.lengths, inputs, wanted, self.inputs)

    def longest(self, inputs: Inputs, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the maximum of the length over ln k/K from `low` to `high`, by a scan and closer scans around its top.

        Below b = `RISING` a length rises with stiffness, so that nothing softer is looked at.
        """
        rising = np.log(RISING) + inputs.log_stiffness - inputs.log_b
        low = np.minimum(np.maximum(low, rising), high)
        best, where = np.empty(len(low)), np.empty(len(low))
        for count in (129, 17, 17, 17, 17):
            grid = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, count)
            lanes = inputs.take(np.repeat(np.arange(len(low)), count))._replace(log_stiffness=grid.ravel())
            length = self.lengths(lanes).reshape(grid.shape)
            top = length.argmax(axis=1)
            rows = np.arange(len(low))
            best, where = length[rows, top], grid[rows, top]
            step = (high - low) / (count - 1)
            low, high = np.maximum(where - step, low), np.minimum(where + step, high)
        return best, where


class FirstFront(Front):
    """The first front of a slider without end, by the exact solution."""

    def lengths(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """ℓ* in λc."""
        lanes = _lanes(inputs)
        found, status = exact_fronts(lanes, one_program=True)
        lost = ~np.isin(status, (Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.RUN_AWAY))
        if lost.any():
            where = ", ".join(f"{x:.9g}" for x in lanes[:, np.argmax(lost)])
            why = Outcome(int(status[lost][0])).message
            raise NotConverged(f"no exact length at (H/λc, k/K, ν, φ, ε) = ({where}): {why}")
        return found

    def breaks_again(self, inputs: Inputs) -> np.ndarray:
        """Whether the edge contact is back at its threshold before the front stops."""
        return self.status(inputs) == Outcome.REBREAK

    def uncertainty(self, inputs: Inputs) -> np.ndarray | None:
        """Root mean square of ℓ − ℓ* at stiffnesses nearby.

        ℓ is where the straight line between the stresses on two contacts falls to the threshold, ℓ* where the analytic
        continuation does. A length is measured to neither convention.
        """
        count, own = len(NEARBY), inputs.without(*ENDED)
        around = own.map(lambda x: np.broadcast_to(x, (count, x.size)))
        around = around._replace(log_stiffness=own.log_stiffness + NEARBY[:, None]).ravel()
        endless = FirstFront() if isinstance(self, EndedFront) else self  # as the exact solution is
        exact = endless.lengths(around)
        stops, off = np.isfinite(exact), np.zeros(len(exact))
        off[stops] = straight_lengths(around.take(stops), self.event) - exact[stops]
        off = np.where(np.isfinite(off), off, 0).reshape(count, -1)
        return np.sqrt(np.mean(off**2, axis=0))

    def traced(self, inputs: Inputs, relaxed: bool) -> Array:
        """ℓ* of one lane as a JAX function."""
        return exact_length(sliders(inputs, jnp.exp), _interface(inputs, relaxed))


ENDED = ("log_sites", "log_machine")
"""Inputs of a slider that ends, or is pushed by a machine that gives way; inf in rows without."""


class EndedFront(FirstFront):
    """The first front of a slider that ends or is pushed through a spring: ℓ by the recursion.

    It has a kink at every whole contact: the slope jumps there by about the curvature of the front's stress. Rows of blocks
    without end whose edge is held are those of `FirstFront`.
    """

    inputs = {
        "log_sites": Input("L/λc", np.log(2.0), np.inf, "must be at least 2"),
        "log_machine": Input("M/K", np.log(1e-30), np.inf, "must be positive"),
    }
    length_modelled = "length by the recursion"

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """Logarithms of L/λc and M/K where stated; inf in rows without one."""
        found = {}
        if m.block_length is not None:
            found["log_sites"] = np.log(m.block_length)
        if m.machine_stiffness is not None:
            found["log_machine"] = np.log(machine_ratio(m.machine_stiffness, 1.0 if m.young is None else m.young))
        return {name: np.where(np.isnan(x), np.inf, x) for name, x in found.items() if not np.isnan(x).all()}

    def lengths(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """ℓ by the recursion where a block ends or a machine gives way, else ℓ*."""
        ended = np.isfinite([inputs.get(name) for name in ENDED if name in inputs.more]).any(axis=0)
        found = np.empty(ended.shape)
        found[~ended] = super().lengths(inputs.take(~ended)) if not ended.all() else 0
        if (ended & (inputs.prestress > 0)).any():  # what never stops by itself does not stop under an end or a machine either
            found[ended] = super().lengths(inputs.take(ended).without(*ENDED))
            ended &= np.isfinite(found)
        if ended.any():
            found[ended] = _within_reach(inputs.take(ended))
        return found

    def traced(self, inputs: Inputs, relaxed: bool) -> Array:
        """ℓ of one lane where the block ends or the machine gives way, else ℓ*."""
        straight = quantity(
            "length", sliders(inputs, jnp.exp), _interface(inputs, relaxed), ends_of(inputs, jnp.exp), DEFAULT_MAX_CONTACTS
        )
        ended = jnp.isfinite(jnp.stack([inputs.get(name) for name in ENDED if name in inputs.more])).any()
        return jnp.where(ended, straight, super().traced(inputs, relaxed))


class WholeEvent(FirstFront):
    """The whole event on a slider, in which contacts may break again: ℓ* times an interpolated factor."""

    event = "full"
    traceable = False
    interpolated = True
    length_modelled = "length of the whole event, in which contacts may break again"
    lengths_are_of = "whole events"
    uncertain_as = (
        "the length of an event steps where the order of its breaks changes, and is interpolated, which changes it by"
    )

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse gauges and ends, which need the model of one front."""
        super().check(m, names)
        if m.gauges is not None or m.block_length is not None or m.machine_stiffness is not None:
            raise ValueError("event = 'full': gauges, block_length and machine_stiffness need the model of one front")

    def lengths(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """ℓ* times `whole_over_front`."""
        front, lanes = super().lengths(inputs), _lanes(inputs)
        stops = np.isfinite(front) & (front > 0)
        found = front.copy()
        found[stops] *= whole_over_front(lanes[:, stops])
        if np.isnan(found).any():
            where = ", ".join(f"{x:.9g}" for x in lanes[:, np.argmax(np.isnan(found))])
            raise NotConverged(f"the event was given up at (H/λc, k/K, ν, φ, ε) = ({where}): give narrower bounds")
        return found

    def breaks_again(self, inputs: Inputs) -> np.ndarray:
        """Nowhere: what follows is part of the event."""
        return Front.breaks_again(self, inputs)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K searched by default, up to b = `FULL_TO`."""
        return np.minimum(STIFFEST, FULL_TO / (2 * (1 + m.poisson) * m.height))

    def traced(self, inputs: Inputs, relaxed: bool) -> Array:
        """Refuse: an interpolated length cannot be traced."""
        return Front.traced(self, inputs, relaxed)


class CrackFront(Front):
    """A crack-like front, behind which contacts slide at a friction, in closed form."""

    event = "crack"
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

    def lengths(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """Length of each crack-like front, in λc."""
        return _all_found(self._found(inputs)[0], inputs, "of a crack-like front")

    def status(self, inputs: Inputs) -> np.ndarray:
        """Outcome of each crack-like front."""
        return self._found(inputs)[1]

    def _found(self, inputs: Inputs) -> Sequence[np.ndarray]:
        return over_lanes(_cracks, [*_lanes(inputs)[:4], inputs.get("friction")], CRACKS)

    def traced(self, inputs: Inputs, relaxed: bool) -> Array:
        """Length of one crack-like front as a JAX function."""
        return crack.length(sliders(inputs, jnp.exp), inputs.get("friction"), inputs.prestress)[0]

    def fields(self, inputs: Inputs, stopped: Array, count: int) -> tuple[Array, Array]:
        """Slip and stress of the first `count` contacts of one front, traced."""
        slider, friction = sliders(inputs, jnp.exp), inputs.get("friction")
        site = jnp.arange(count, dtype=jnp.result_type(stopped))
        return jax.vmap(lambda one: crack.fields(slider, friction, inputs.prestress, stopped, one))(site)


class BlockEvent(Front):
    """The whole event on a block under two-dimensional elasticity that is pushed at a height."""

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
    traceable = False
    interpolated = True
    most_off = np.inf
    name = "first precursor"
    carrier = "a block under two-dimensional elasticity"
    body_modelled = "semi-infinite block under two-dimensional elasticity, pushed at a height"
    length_modelled = "length of the whole event, in which contacts may break again"
    held = "the pusher"
    uncertain_as = (
        "interpolating the length of an event on a block, between coarser blocks and across a fall to a few contacts, may "
        "change it by"
    )
    refused: ClassVar[dict[str, str]] = {
        "displacement": "from lengths alone: leave it out",
        "force": "from lengths alone: leave it out",
        "gauges": "from lengths alone: leave it out",
        "machine_stiffness": "whose pusher is held: leave it out. The stiffness is then too large, as a machine takes part of "
        "the load; by about what factor, the row of machines in the report of a table without the columns of the push says",
    }
    """What measurements may state beside lengths, and a fit of a block cannot take; and what a block it takes instead."""

    def __init__(self, m: Measurements | None = None) -> None:
        """Blocks like those measured are followed from theirs."""
        self.followed = BlockLengths()
        if m is not None and m.push_height is not None and not np.isnan(m.push_height).any():
            own = Inputs.of(m.height, 1.0, m.poisson, m.or_zero("prestress")).given(**self.stated(m))
            self.followed = BlockLengths(geometry_of(own), m.length / m.height, m.height)
            if m.block_length is not None:
                self.body_modelled = self.body_modelled.replace("semi-infinite block", "block with a free end")
            if m.friction is not None:
                stiffness = " and stiffnesses" * ("multicontact" in m.contact_law)
                self.thresholds = f"thresholds{stiffness} that follow the pressure"
            if "held" in m.top:
                self.held = "the pusher and the top of the block"

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Ask for the height of the push, and refuse what a fit of a block cannot take."""
        if m.push_height is None:
            raise ValueError(f"{m.source}: a block needs the height of the push: give push_height (push_height_mm in a table)")
        if np.isnan(m.push_height).any():
            blank = m.place(int(np.argmax(np.isnan(m.push_height))))
            raise ValueError(f"{blank}, column push_height: missing: a block needs the height of the push of every measurement")
        if "friction" in names and m.friction is None:
            raise ValueError("parameter friction: the measurements state no friction to start from; a guess is enough")
        for name, why in self.refused.items():
            if getattr(m, name) is not None:
                own, push = m.columns.get(name, name), m.columns.get("push_height", "push_height")
                raise ValueError(f"{m.source}: {own} beside {push}: a fit of a block takes one {why} (docs/fit/own_csv.md)")
        if "threshold_slope" in names or m.or_zero("threshold_slope").any():
            raise ValueError(f"{m.source}: threshold_slope: a fit of a block takes level thresholds")

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """The push on the side of each block, where it ends, and what the pressure does."""
        assert m.push_height is not None
        return pushed(
            m.height, m.push_height, m.push_width, m.push_control, length=m.block_length, friction=m.friction,
            normal_stiffness=m.normal_stiffness, contact_law=m.contact_law, top=m.top,
        )  # fmt: skip

    def lengths(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """Interpolated ℓ in λc."""
        return self.followed(inputs)[0]

    def status(self, inputs: Inputs) -> np.ndarray:
        """`Outcome` of each event, by its length."""
        found = self.lengths(inputs)
        ends = np.isfinite(inputs.get("log_sites")) if "log_sites" in inputs.names else np.zeros(found.shape, bool)
        endless = np.isinf(found)
        kinds = {Outcome.RAN_THROUGH: endless & ends, Outcome.RUN_AWAY: endless, Outcome.ARRESTED: found > 0}
        return np.select(list(kinds.values()), list(kinds), Outcome.NO_DOMINO)

    def uncertainty(self, inputs: Inputs) -> np.ndarray | None:
        """How far each length may be off, as coarser blocks show, and next to where it falls."""
        return self.followed(inputs)[1]

    def softest(self, m: Measurements) -> np.ndarray:
        """k/K at b = `BLOCK_FROM`."""
        return BLOCK_FROM / (2 * (1 + m.poisson) * m.height)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K searched by default, up to b = `BLOCK_TO`."""
        return np.minimum(STIFFEST, BLOCK_TO / (2 * (1 + m.poisson) * m.height))

    def regime(self, inputs: Inputs) -> Regime:
        """Find b, and over what length an edge load decays."""
        found = super().regime(inputs)
        decay = np.exp(inputs.log_height) * block_decay_length(found.b, inputs.poisson)
        return found._replace(slow_decay_length=decay)


FRONTS: dict[tuple[Body, MeasuredEvent], Front] = {
    (front.body, front.event): front for front in (FirstFront(), WholeEvent(), CrackFront(), BlockEvent())
}
"""Models by body and event; `EndedFront` stands for the first front where an end or a machine is stated."""


def front_of(m: Measurements, event: MeasuredEvent | None = None, body: Body | None = None) -> Front:
    """Choose the model of the measured lengths; a ValueError if there is none for this event and body.

    By default a block and its whole event where every measurement states how its side is pushed, unless the event is one of
    sliders only; else a slider and its first front.
    """
    if event is not None:
        check_choice("event", event, MeasuredEvent)
    if body is not None:
        check_choice("body", body, Body)
    else:
        said = m.push_height is not None and not np.isnan(m.push_height).any()
        body = "block" if said and event in (None, "full") else "slider"
    event = event or ("full" if body == "block" else "domino")
    if (body, event) not in FRONTS:
        raise ValueError(
            f"event = {event!r}: contacts of a block break in any order, so its length is that of the whole event: 'full'"
        )
    chosen, ended = FRONTS[body, event], EndedFront()
    if body == "block":
        return BlockEvent(m)
    return ended if type(chosen) is FirstFront and ended.stated(m) else chosen


def pushed(
    height: np.ndarray,
    at: np.ndarray,
    width: np.ndarray | None = None,
    control: Sequence[str] = (),
    *,
    length: np.ndarray | None = None,
    normal_stiffness: np.ndarray | None = None,
    friction: np.ndarray | None = None,
    contact_law: Sequence[str] = (),
    top: Sequence[str] = (),
) -> dict[str, np.ndarray]:
    """Inputs of blocks that are not those of sliders, each of shape (n,): NaN, or None, as in `Measurements`."""
    none = np.full(len(height), np.nan)

    def or_inf(x: np.ndarray | None) -> np.ndarray:
        return np.log(np.where(np.isnan(none if x is None else x), np.inf, none if x is None else x))

    usual = None if friction is None else np.full(len(height), USUAL_NORMAL_STIFFNESS)
    normal = or_inf(usual if normal_stiffness is None else normal_stiffness)
    ended = {} if length is None else {"log_sites": or_inf(length)}
    texts = zip(FLAGS, (control, contact_law, top), ("force", "multicontact", "held"), strict=True)
    return ended | {
        "log_push": np.log(at / height),
        "log_push_width": or_inf(width) - np.log(height),
        "friction": np.zeros(len(height)) if friction is None else friction,
        "log_normal_stiffness": normal if friction is None else np.minimum(normal, np.log(RIGID)),
        **{name: np.array([one == word for one in text] or [False] * len(height), float) for name, text, word in texts},
    }


def by_differences(
    values: Any, inputs: Inputs, wanted: Collection[str], own: Mapping[str, Input], size: float = 1.0
) -> Prediction:
    """Values of a model and their derivatives in the `wanted` inputs by central differences, all in one call.

    The steps are those of the inputs, of which `own` are beside `COMMON`, times `size`.
    """
    names, every = inputs.names, {**COMMON, **own}
    wanted = [name for name in names if name in wanted]
    if not wanted:
        return Prediction(values(inputs), {})
    # nodes of a profile are reached from several starts: each distinct row once
    rows, at = distinct_rows(inputs.table())
    shifted = [rows]
    for name in wanted:
        column, (least, most) = names.index(name), every[name].domain
        step = size * every[name].step * (np.exp(-rows[:, 0]) if name == "threshold_slope" else 1.0)
        for sign in (1, -1):
            moved = rows.copy()
            moved[:, column] = np.clip(moved[:, column] + sign * step, least, most)
            shifted.append(moved)
    value, *around = values(Inputs.from_table(names, np.concatenate(shifted))).reshape(len(shifted), -1)
    slopes = {}
    for i, name in enumerate(wanted):
        column = names.index(name)
        ends, places = around[2 * i : 2 * i + 2], [x[:, column] for x in shifted[2 * i + 1 : 2 * i + 3]]
        # next to run-away one side has no value
        up, down = (np.where(np.isfinite(end), end, value) for end in ends)
        right, left = (np.where(np.isfinite(end), x, rows[:, column]) for end, x in zip(ends, places, strict=True))
        with np.errstate(invalid="ignore"):  # inf − inf for a block without end
            apart = right - left
            slope = (up - down) / np.where(apart > 0, apart, 1)
        slopes[name] = np.where(np.isfinite(value), slope, 0)[at]
    return Prediction(value[at], slopes)


def straight_lengths(inputs: Inputs, event: MeasuredEvent = "domino") -> np.ndarray:
    """ℓ, where the straight line between the stresses on two contacts falls to the threshold; for inputs of shape (L,)."""
    slider, interface, ends = recursion_inputs(inputs)
    return bulk_lengths(slider, interface, ends=ends, event="full" if event == "full" else "domino")


def recursion_inputs(inputs: Inputs) -> tuple[Slider, Interface | None, Ends]:
    """Sliders, interfaces and ends for the recursion."""
    relaxed = not (inputs.prestress.any() or inputs.threshold_slope.any())
    return sliders(inputs), _interface(inputs, relaxed), ends_of(inputs)


def sliders(inputs: Inputs, exp: Any = np.exp) -> Slider:
    """Sliders of the inputs; of traced ones by JAX's ``exp``."""
    return Slider(exp(inputs.log_height), exp(inputs.log_stiffness), inputs.poisson)


def ends_of(inputs: Inputs, exp: Any = np.exp) -> Ends:
    """Free end and machine; where there is none, one so far away, or so stiff, that no digit changes."""
    most = np.log(NO_END)
    sites, machine = (exp(inputs.more[name].clip(max=most)) if name in inputs.more else None for name in ENDED)
    return Ends("semi-infinite" if sites is None else "free", sites, machine)


def _interface(inputs: Inputs, relaxed: bool) -> Interface | None:
    return None if relaxed else Interface(inputs.prestress, inputs.threshold_slope)


def _lanes(inputs: Inputs) -> Float[np.ndarray, "5 L"]:
    """H/λc, k/K, ν, φ, ε."""
    return np.stack([np.exp(inputs.log_height), inputs.ratio, *inputs[2:5]])


def _cracks(lanes: Float[Array, "5 L"]) -> tuple[Array, Array]:
    """Length and status of crack-like fronts at H/λc, k/K, ν, φ and σ_k."""
    return jax.vmap(lambda lane: crack.length(Slider(*lane[:3]), lane[4], lane[3]), 1)(lanes)


def _within_reach(inputs: Inputs) -> np.ndarray:
    """ℓ by the recursion, inf where the front runs `FARTHEST`, which a soft machine and a prestress may let it do for ever."""
    most = 2 ** np.ceil(np.log2(np.maximum(FARTHEST * np.exp(inputs.log_height), AT_LEAST))).astype(int)  # few programs
    slider, interface, ends = recursion_inputs(inputs)
    found = arrests(slider, interface, ends=ends, max_contacts=int(most.max()))
    far = (found.status == Outcome.LIMIT) | (found.length > most)
    return _all_found(np.where(far, np.inf, found.length), inputs, "by the recursion")


def _all_found(length: np.ndarray, inputs: Inputs, how: str) -> np.ndarray:
    lost = np.isnan(length)
    if lost.any():
        where = ", ".join(f"{x:.9g}" for x in inputs.table()[np.argmax(lost)])
        raise NotConverged(f"no length {how} at {inputs.names} = ({where})")
    return length


@jax.jit
def _regime(slider: Slider) -> tuple[Array, Array, Array]:
    """`Regime` of sliders, as one program: a dozen small ones take a third of a second to compile."""
    k1, k2 = slider.kappa_1, slider.kappa_2
    # the layer is free at the edge: in amplitudes of u_t, A_1 α_1 κ_1 + A_2 α_2 κ_2 = 0 (continuum)
    first, second = slider.alpha_2 * k2, -slider.alpha_1 * k1
    return slider.b, slider.slow_decay_length, slider.K_L * (first * k1 + second * k2) / (first + second)
