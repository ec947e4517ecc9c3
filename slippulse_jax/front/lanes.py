r"""Fronts of many sliders at once, a chunk of lanes in step.

The step is `slippulse_jax.front.front.advance`, given NumPy arrays of single numbers, one array per quantity with the
modes as its leading axis. What else a loop over lanes costs was read off the compiled program:

- A turn is one loop over the lanes that computes every number once (`slippulse_jax.bulk.compiler.in_one_loop`).
- A look at the lanes, and handing them on, cost as much as some breaks: `BREAKS_PER_TURN` are taken in a turn and two turns
  between two looks, the second writing where the first has read.
- R is symmetric (a pinning point at i moves site j as one at j moves site i), so half of it is handed on.
- A front that has arrested stays as it is: nothing has to be recorded elsewhere. The overloads on whose curve ℓ ends are found
  by running the recursion back from there, which with the end of the curve costs as much as some twenty breaks.
- Nothing but sums, products, quotients and square roots, and exponentials where a chain ends: the same bits whatever the lane's
  place in the chunk.

Derivatives are tangents of the same step, by ``jax.jvp``, along what depends on the parameter. Value and three derivatives took
2.6 to 2.8 times as long as the value (200 000 random points, two busy cores, shortest of 36 runs). With the derivatives of step
and modes written by hand, as they once were, they took as long, and the value a tenth to a fifth longer.
"""

import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from slippulse_jax.bodies.modes import Number, RightEnd, inverse, lattice_modes, mode_numbers
from slippulse_jax.bulk.chunks import Kernel
from slippulse_jax.bulk.compiler import in_one_loop
from slippulse_jax.front.front import (
    REACHED,
    Front,
    advance,
    end_of_front,
    never_stops_after,
    outcome,
    stress_ahead,
    taken_back,
)
from slippulse_jax.interface import Interface
from slippulse_jax.slider import Slider

BREAKS_PER_TURN = 6
"""Breaks per turn."""

FAR_END = 1e9
"""Sites from which on a chain counts as one without end."""

STIFFEST = 8.0
"""k/K up to which the recursion is run back, which loses digits as r_1 shrinks: ℓ stays right to 1e-11 λc."""


class Lane(NamedTuple):
    """Constants of a lane: the modes of its chain, and its interface."""

    gap: Any  # 1 − r_m
    weight: Any  # w_m
    prestress: Any  # φ; None on a relaxed, uniform interface
    slope: Any  # ε, threshold 1 + ε s; likewise
    end: Any  # breaks after which a front that is still running never stops; mostly inf
    most: Any  # limit on breaks where it must be exact; elsewhere a front may overshoot it by up to 11
    echo: Any = None  # η_m of the right end; None for a semi-infinite chain
    rate: Any = None  # 2 ln r_m
    last: Any = None  # N − 1
    growth: Any = None  # 1/r_m, for the way back


class LaneState(NamedTuple):
    """A front on its lane, or the tangent of one, whose fields are None where it does not move."""

    front: Front
    lane: Lane


WithRates = tuple[LaneState, tuple[LaneState, ...]]
"""A chunk of lanes, and its tangents along height, stiffness, poisson[, prestress, slope]."""


@functools.cache
def length_kernel(max_contacts: int, right: RightEnd = "semi-infinite") -> Kernel:
    """ℓ of lanes (height, stiffness, poisson[, prestress, threshold_slope[, sites, machine]]), in λc.

    Of uniform interfaces. inf where a front never stops or runs through, NaN after `max_contacts`
    breaks.
    """
    return lambda parameters: (_length(_until_all_arrest(parameters, max_contacts, right=right)[0], max_contacts),)


@functools.cache
def arrest_kernel(max_contacts: int) -> Kernel:
    """Contacts broken, ℓ, status and stress on contact 0 of lanes as for `length_kernel`."""

    def arrests(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        state, _ = _until_all_arrest(parameters, max_contacts, with_edge=True)
        length, (ahead,) = _length(state, max_contacts), _excess(_opened(state))
        (broken,), (edge,) = state.front.position, state.front.edge
        status = outcome(broken, ahead >= 0, edge - 1, valid=jnp.isfinite(ahead), endless=jnp.isposinf(length))
        return broken.astype(jnp.int32), length, status, edge

    return arrests


@functools.cache
def gradient_kernel(max_contacts: int) -> Kernel:
    """ℓ of lanes as by `length_kernel`, to rounding, and its derivative in every field: rows of one array."""

    def lengths(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        state, rates = _until_all_arrest(parameters, max_contacts, with_rates=True)
        crossing, slope = _used(in_one_loop(_with_slopes, state))
        length = _length(state, max_contacts, crossing)
        # ℓ = 0 is flat, and what is no number has no derivative
        flat = jnp.where(jnp.isfinite(length), 0, jnp.nan)
        slopes = [sum(way * by for way, by in _pairs(rate, slope)) for rate in rates]
        return (jnp.stack([length, *(jnp.where(jnp.isfinite(length) & (length > 0), x, flat) for x in slopes)]),)

    return lengths


Jet = tuple[LaneState, LaneState, LaneState]
"""A front on its lane that moves along a line of parameters: state, rate and bend, the first and second derivative."""


@functools.cache
def jet_kernel(max_contacts: int, right: RightEnd = "semi-infinite") -> Kernel:
    """ℓ of lanes, and its first and second derivative along a line.

    A lane is the logarithms of H/λc and k/K, and ν[, φ, ε[, and the logarithms of N and M/K]]; then the direction of the line,
    in as many numbers. NaN where a front is given up; derivatives are 0 where there is none.
    """

    def jets(given: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        at, direction = jnp.split(given, 2)
        ends = () if len(at) == 3 else (_end(jnp.stack(_plain(at))),)
        begun = in_one_loop(functools.partial(_nucleated_jet, right=right), *at, *direction, *ends)
        now = _until_all_stop(_jet_turn, begun, max_contacts)
        crossing, *slopes = _used(in_one_loop(_jet_end, *now))[0]
        length = _length(now[0], max_contacts, crossing)
        return (jnp.stack([length, *(jnp.where(jnp.isfinite(length) & (length > 0), x, 0) for x in slopes)]),)

    return jets


def _plain(numbers: Any) -> list[Any]:
    """Lane parameters from those whose positive ones are logarithms."""
    return [x if 2 <= i < 5 else jnp.exp(x) for i, x in enumerate(numbers)]


def _nucleated_jet(*fields: Number, right: RightEnd) -> Jet:
    count, end = len(fields) // 2, fields[-1] if len(fields) % 2 else None
    at, direction = fields[:count], fields[count : 2 * count]

    def begun(t: Number) -> LaneState:
        numbers = _plain(x + t * way for x, way in zip(at, direction, strict=True))
        return _nucleate(*numbers, *(() if end is None else (end,)), with_rates=False, most=None, right=right)[0]

    def with_rate(t: Number) -> tuple[LaneState, LaneState]:
        return jax.jvp(begun, (t,), (jnp.ones_like(t),))

    zero = jnp.zeros_like(fields[0])
    (state, first), (_, second) = jax.jvp(with_rate, (zero,), (jnp.ones_like(zero),))
    return state, _what_moves(first), _what_moves(second, bends=True)


def _what_moves(way: LaneState, bends: bool = False) -> LaneState:
    """A rate or bend without what stands still; prestress and slope move evenly."""
    contacts = {"prestress": None, "slope": None} if bends else {}
    return LaneState(way.front._replace(position=None), way.lane._replace(end=None, **contacts))


def _jet_turn(state: LaneState, rate: LaneState, bend: LaneState) -> Jet:
    """`BREAKS_PER_TURN` breaks."""
    for _ in range(BREAKS_PER_TURN):
        front, first, second = _jet(_break, state, rate, bend)
        state, rate, bend = LaneState(front, state.lane), LaneState(first, rate.lane), LaneState(second, bend.lane)
    return state, rate, bend


def _jet_end(state: LaneState, rate: LaneState, bend: LaneState) -> tuple[tuple[Any, Any, Any], Jet]:
    return _jet(_crossing, state, rate, bend), (state, rate, bend)


def _jet(f: Callable[[LaneState], Any], state: LaneState, rate: LaneState, bend: LaneState) -> tuple[Any, Any, Any]:
    """``f(state)``, its rate and its bend; of a front, in the fields in which it moves."""
    of_moving, moved, first, what_moves = _moving(f, state, rate)
    bends = [x for x, way in zip((*bend.front, *bend.lane), (*rate.front, *rate.lane), strict=True) if way is not None]
    second = tuple(list(map(jnp.zeros_like, way)) if x is None else x for x, way in zip(bends, first, strict=True))

    def with_rate(moved: tuple, ways: tuple) -> Any:
        return jax.jvp(of_moving, moved, ways)

    (value, slope), (_, bent) = jax.jvp(with_rate, (moved, first), (first, second))
    return value, what_moves(slope), what_moves(bent)


def _moving(f: Callable[[LaneState], Any], state: LaneState, rate: LaneState) -> tuple[Any, ...]:
    """`f` of the fields that move; these; their rates; and a function that keeps of a front what moves."""
    values, ways = (*state.front, *state.lane), (*rate.front, *rate.lane)
    moving = [i for i, way in enumerate(ways) if way is not None]

    def of_moving(*moved: Any) -> Any:
        everything = list(values)
        for i, x in zip(moving, moved, strict=True):
            everything[i] = x
        return f(LaneState(Front(*everything[: len(state.front)]), Lane(*everything[len(state.front) :])))

    def what_moves(found: Any) -> Any:
        if not isinstance(found, Front):
            return found
        return Front(*(None if way is None else x for x, way in zip(found, rate.front, strict=True)))

    return of_moving, tuple(values[i] for i in moving), tuple(ways[i] for i in moving), what_moves


def _until_all_arrest(
    parameters: Float[Array, "fields lanes"],
    max_contacts: int,
    with_rates: bool = False,
    with_edge: bool = False,
    right: RightEnd = "semi-infinite",
) -> WithRates:
    nucleate = functools.partial(_nucleate, with_rates=with_rates, most=max_contacts if with_edge else None, right=right)
    ends = () if parameters.shape[0] == 3 else (_end(parameters),)
    return _until_all_stop(_turn, in_one_loop(nucleate, *parameters, *ends), max_contacts)


def _until_all_stop(turn: Callable[..., Any], begun: Any, max_contacts: int) -> Any:
    """Take two turns at a time until no front goes on; the state is the first of what is handed on."""

    def some_go(now: Any) -> Bool[Array, ""]:
        opened = _opened(now[0])
        (goes,) = _goes(opened, _excess(opened))
        return jnp.any(goes & (now[0].front.position[0] < max_contacts))

    return lax.while_loop(some_go, lambda now: in_one_loop(turn, *in_one_loop(turn, *now)), begun)


def _end(parameters: Float[Array, "fields lanes"]) -> Float[Array, " lanes"]:
    with jax.numpy_rank_promotion("allow"):  # lanes are last in every array
        modes = lattice_modes(Slider(parameters[0], parameters[1], parameters[2]))
        end = never_stops_after(modes, Interface(parameters[3], parameters[4]))
    if parameters.shape[0] == 5:
        return end
    # a front that would stop nowhere on an endless chain may yet stop at the end of a short one
    contacts = jnp.ceil(parameters[5] - 0.5)
    return jnp.where(contacts < FAR_END, contacts, end)


# --- one lane ----------------------------------------------------------------------------------------------------------
# Between breaks every quantity is a list of its numbers (lanes last in each, or single in `in_one_loop`); for the arithmetic, a
# NumPy array of them.

PAIRS = np.array([[0, 1], [1, 2]])
"""Positions of mn = 11, 12, 21, 22 in half of a symmetric matrix."""

_where = np.frompyfunc(lax.select, 3, 1)
_less = np.frompyfunc(operator.lt, 2, 1)
_exp, _inverse = np.frompyfunc(lax.exp, 1, 1), np.frompyfunc(inverse, 1, 1)


def _array(numbers: Any) -> Any:
    if numbers is None:
        return None
    found = np.empty(len(numbers), object)
    for i, number in enumerate(numbers):
        found[i] = number
    return found


def _opened(state: LaneState) -> LaneState:
    """As arrays, of the reflection both halves."""
    front = Front(*map(_array, state.front))
    return LaneState(front._replace(reflected=front.reflected[PAIRS]), Lane(*map(_array, state.lane)))


def _closed(front: Front) -> Front:
    """As lists, of the reflection one half."""
    half = front._replace(reflected=front.reflected[[0, 0, 1], [0, 1, 1]])
    return Front(*(None if x is None else x.tolist() for x in half))


def _nucleate(*fields: Number, with_rates: bool, most: int | None, right: RightEnd) -> WithRates:
    """A lane whose contact 0 has broken, at its threshold exactly; with `most`, the stress on it too."""
    none, one = jnp.zeros_like(fields[0]), jnp.ones_like(fields[0])
    *numbers, end = fields if len(fields) > 3 else (*fields, None)
    cap, end = None if most is None else [most * one], None if end is None else [end]

    def begun(*numbers: Number) -> LaneState:
        sites, machine = numbers[5:] or (None, None)
        modes = mode_numbers(numbers[0], numbers[1], numbers[2], None if sites is None else (right, sites), machine)
        prestress, slope = ([x] for x in numbers[3:5]) if len(numbers) > 3 else (None, None)
        lane = Lane(list(modes["gap"]), list(modes["weight"]), prestress, slope, end, cap)
        if sites is not None:
            decay = [2 * jnp.log1p(-gap) for gap in modes["gap"]]
            lane = lane._replace(echo=list(modes["echo"]), rate=decay, last=[modes["last"]])
        (r11, r12), (_, r22) = modes["reflection"]
        half, drive = _array((r11, r12, r22)), _array(modes["drive"])
        if prestress is not None:
            drive = drive * _array([1 - prestress[0]])
        reach = None if most is None else _array(modes["weight"]) + half[PAIRS].sum(0)
        before = Front(drive, half[PAIRS], reach, _array([none]), None if most is None else _array([none]))
        guide = lane._replace(gap=_array(modes["gap"]), weight=_array(modes["weight"]))
        echo = _echo(Lane(*map(_array, lane)), before.position)
        return LaneState(_closed(advance(guide, before, _array([one]), echo)), lane)

    state = begun(*numbers)

    def rate(which: int) -> LaneState:
        front, lane = jax.jvp(lambda x: begun(*numbers[:which], x, *numbers[which + 1 :]), (numbers[which],), (one,))[1]
        still = Lane(*[None] * len(Lane._fields))
        if which < 3:  # prestress and slope enter by the contacts alone
            moves = front._replace(position=None)
            return LaneState(moves, still._replace(gap=lane.gap, weight=lane.weight))
        moves = Front(front.stress, None, None, None)
        return LaneState(moves, still._replace(prestress=lane.prestress) if which == 3 else still._replace(slope=lane.slope))

    return state, tuple(rate(which) for which in range(len(numbers))) if with_rates else ()


def _echo(lane: Lane, position: Any) -> Any:
    """Factor e_m at a contact, of a chain with a right end; of arrays."""
    return None if lane.last is None else 1 + lane.echo * _exp((lane.last - position) * lane.rate)


def _threshold(lane: Lane, position: Any) -> Any:
    return 1 if lane.slope is None else 1 + lane.slope * position


def _stress_and_excess(state: LaneState, echo: Any) -> tuple[Any, Any]:
    """On the contact ahead, and of the former over its threshold; of arrays."""
    front, lane = state
    t = stress_ahead(front, echo)
    t = t if lane.prestress is None else lane.prestress + t
    return t, t - _threshold(lane, front.position)


def _excess(state: LaneState) -> Any:
    """Excess of the stress on the contact ahead over its threshold; of arrays."""
    return _stress_and_excess(state, _echo(state.lane, state.front.position))[1]


def _goes(state: LaneState, excess: Any) -> Any:
    """Whether the contact ahead breaks, by how far its stress exceeds its threshold; of arrays."""
    goes = _array([excess[0] >= 0])
    for last in (state.lane.end, state.lane.most):
        goes = goes if last is None else goes & _less(state.front.position, last)
    return goes


def _turn(state: LaneState, rates: tuple[LaneState, ...]) -> WithRates:
    """`BREAKS_PER_TURN` breaks."""
    for _ in range(BREAKS_PER_TURN):
        rates = tuple(LaneState(_tangent(_break, state, rate), rate.lane) for rate in rates)
        state = state._replace(front=_break(state))
    return state, rates


def _break(state: LaneState) -> Front:
    """Break the contact ahead, where it breaks."""
    front, lane = state = _opened(state)
    echo = _echo(lane, front.position)
    t, excess = _stress_and_excess(state, echo)
    goes, after = _goes(state, excess), advance(lane, front, t, echo)
    kept = (None if new is None else _where(goes, new, old) for new, old in zip(after, front, strict=True))
    return _closed(Front(*kept)._replace(reach=after.reach))  # no use where it has arrested


def _tangent(f: Callable[[LaneState], Any], state: LaneState, rate: LaneState) -> Any:
    """Tangent of ``f(state)`` along what moves; of a front, in the fields in which it moves."""
    of_moving, moved, first, what_moves = _moving(f, state, rate)
    return what_moves(jax.jvp(of_moving, moved, first)[1])


def _crossing(state: LaneState) -> Float[Array, " lanes"]:
    """ℓ, of a front that has arrested."""
    now = _opened(state)
    front, lane = now
    lane = lane._replace(growth=_inverse(1 - lane.gap))
    prestress = 0 if lane.prestress is None else lane.prestress
    over = [_excess(now)[0]]
    for _ in range(REACHED - 1):
        front, released = taken_back(lane, front, prestress, functools.partial(_echo, lane), _inverse)
        excess = (released - _threshold(lane, front.position))[0]
        over.append(jnp.where(front.position[0] > 0, excess, 0))  # contact 0 breaks at its threshold exactly
    return end_of_front(now.front.position[0], over)


def _with_slopes(state: LaneState) -> tuple[Any, LaneState]:
    """ℓ, and its derivatives in the state in which the front has arrested."""
    length, back = jax.vjp(_crossing, state)
    return length, back(jnp.ones_like(length))[0]


def _pairs(rate: LaneState, slope: LaneState) -> list[tuple[Any, Any]]:
    """Rates of what moves, each with the derivative in it."""
    fields = zip((*rate.front, *rate.lane), (*slope.front, *slope.lane), strict=True)
    return [pair for ways, slopes in fields if ways is not None for pair in zip(ways, slopes, strict=True)]


def _used(results: Any) -> Any:
    """Keep XLA from looking for unused ones, see `in_one_loop`."""
    return lax.optimization_barrier(results)


def _length(state: LaneState, max_contacts: int, crossing: Any = None) -> Float[Array, " lanes"]:
    """ℓ; inf where nothing stops the front, NaN where it was given up."""
    (broken,), (ahead,) = state.front.position, _excess(_opened(state))
    endless = jnp.nan if state.lane.end is None else jnp.where(broken >= state.lane.end[0], jnp.inf, jnp.nan)
    going = ahead >= 0
    if state.lane.last is not None and state.lane.end is not None:
        going = going | (broken >= state.lane.end[0])  # nothing is ahead of the last contact
    if crossing is None:
        crossing = _used(in_one_loop(lambda now: (_crossing(now), now), state))[0]
    length = jnp.where(going, endless, jnp.asarray(crossing))
    return jnp.where(broken <= max_contacts, length, jnp.nan)
