r"""Fronts of many sliders at once, and derivatives of their lengths.

A kernel maps the parameters of a chunk of lanes to results: `length_kernel`, `arrest_kernel`, `gradient_kernel` and
`jet_kernel`. Each begins the fronts, breaks contacts in all lanes in step until the last front has arrested, and finds where
the curve through the last overloads falls to zero. A lane (`Lane`) and its front (`State`) are tuples of single numbers, and
the second half of this file is written for one lane. The equations are those of `slippulse_jax.front.front`.

A tangent is a tree of the same shape, with None for what does not move: nothing is computed or handed on for it. `_rates` and
`_rate_and_bend` evaluate a function of a lane with its tangents.

Notes
-----
What else a loop over lanes costs was read off the compiled program:

- A turn is one loop over the lanes that computes every number once (`slippulse_jax.bulk.compiler.in_one_loop`).
- A look at the lanes, and handing them on, cost as much as some breaks: `BREAKS_PER_TURN` are taken in a turn and two turns
  between two looks, the second writing where the first has read.
- R is symmetric (a pinning point at i moves site j as one at j moves site i), so half of it is handed on.
- A front that has arrested stays as it is: nothing has to be recorded elsewhere. The overloads on whose curve ℓ ends are found
  by running the recursion back from there, once per front.
- Nothing but sums, products, quotients and square roots, and exponentials where a chain ends: the same bits whatever the lane's
  place in the chunk.

`advance` is written twice: here for `in_one_loop`, which takes single numbers, and in `slippulse_jax.front.front` for arrays
over any number of modes. A test holds the two equal.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from slippulse_jax.base.outcomes import outcome
from slippulse_jax.bodies.modes import Number, Pair, RightEnd, inverse, lattice_modes, mode_numbers
from slippulse_jax.bulk.chunks import Kernel
from slippulse_jax.bulk.compiler import in_one_loop
from slippulse_jax.front.front import REACHED, end_of_front, never_stops_after
from slippulse_jax.interface import Interface
from slippulse_jax.slider import Slider

BREAKS_PER_TURN = 6
"""Breaks per turn."""

FAR_END = 1e9
"""Sites from which on a chain counts as one without end."""

STIFFEST = 8.0
"""k/K up to which the recursion is run back, which loses digits as r_1 shrinks: ℓ stays right to 1e-11 λc."""


class Lane(NamedTuple):
    """Constants of a lane: modes, limit, interface and right end."""

    gap: Pair  # 1 − r_m
    weight: Pair  # w_m
    limit: Number  # breaks after which the front is followed no further
    # φ, in σ_s, and ε, of a threshold 1 + ε s; None on a relaxed, uniform interface. Of contacts that keep a share r of their
    # strength, as of r = 0: (φ − r)/(1 − r), and its slope −r ε/(1 − r)
    contacts: tuple[Number, Number, Number | None] | None = None
    end: tuple[Pair, Pair, Number] | None = None  # η_m, 2 ln r_m, and N − 1; None of a semi-infinite chain


class State(NamedTuple):
    """State of a front past contacts 0 … position − 1."""

    stress: Pair  # Z_m, in σ_s
    reflected: tuple[Number, Number, Number]  # Q_11, Q_12 = Q_21, Q_22
    position: Number  # s
    edge: tuple[Number, Number, Number] | None = None  # reach_m, and the stress on contact 0, in σ_s; None where not wanted


LaneAndFront = tuple[Lane, State]
"""A lane and its front; or a tangent of both, with None for what does not move."""


@functools.cache
def length_kernel(most: int, right: RightEnd = "semi-infinite") -> Kernel:
    """ℓ of lanes, in λc.

    They are (height, stiffness, poisson[, prestress, threshold_slope[, residual_strength][, sites, machine]]).

    Of uniform interfaces. inf where a front never stops or runs through, NaN where it is given up after
    `most` breaks.
    """

    def lengths(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        given, end = _given(parameters, most)
        (arrested,) = _arrested(_rates, functools.partial(_begun, right=right), given)
        return (_length(arrested, end, _once(_crossing, arrested)),)

    return lengths


@functools.cache
def arrest_kernel(most: int) -> Kernel:
    """Contacts broken, ℓ, status, and stress on contact 0 in σ_s.

    Of lanes as for `length_kernel`.
    """

    def arrests(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        given, end = _given(parameters, most)
        (arrested,) = _arrested(_rates, functools.partial(_begun, with_edge=True), given)
        length, (lane, front) = _length(arrested, end, _once(_crossing, arrested)), arrested
        broken, (_, excess), (_, _, edge) = front.position, _stress_and_excess(lane, front), front.edge
        status = outcome(broken, excess >= 0, edge - 1, valid=jnp.isfinite(excess), endless=jnp.isposinf(length))
        kept = _by_name(parameters).get("residual_strength")
        return broken.astype(jnp.int32), length, status, edge if kept is None else kept + (1 - kept) * edge

    return arrests


@functools.cache
def gradient_kernel(most: int) -> Kernel:
    """ℓ of lanes and its derivative in every field, as rows.

    Lanes, and ℓ to rounding, are those of `length_kernel`; NaN is the derivative of what is no number.
    """

    def lengths(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        given, end = _given(parameters, most)
        one, fields = jnp.ones_like(end), range(len(given))
        ways = (tuple(one if field == moving else None for field in fields) for moving in fields[1:])
        arrested, *rates = _arrested(_rates, _begun, given, *ways)
        crossing, *slopes = _once(_crossing_and_rates, arrested, *rates)
        length = _length(arrested, end, crossing)
        return (_rows(length, slopes, jnp.where(jnp.isfinite(length), 0, jnp.nan)),)

    return lengths


@functools.cache
def jet_kernel(most: int, right: RightEnd = "semi-infinite") -> Kernel:
    """ℓ of lanes, and its first and second derivative along a line.

    A lane is the logarithms of H/λc and k/K, and ν[, φ, ε[, r][, and the logarithms of N and M/K]]; then the direction of the
    line, in as many numbers. NaN where a front is given up; derivatives are 0 where there is none.
    """

    def begun(given: tuple[Number, ...]) -> LaneAndFront:
        return _begun((given[0], *_plain(given[1:])), right)

    def jets(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        at, direction = jnp.split(parameters, 2)
        (limit, *_), end = _given(jnp.stack(_plain(at)), most)
        rate, bend = (None, *direction), (None,) * (1 + len(direction))
        moving = _arrested(_rate_and_bend, begun, (limit, *at), rate, bend)
        crossing, *slopes = _once(functools.partial(_rate_and_bend, _crossing), *moving)
        return (_rows(_length(moving[0], end, crossing), slopes, 0),)

    return jets


def _by_name(numbers: Any) -> dict[str, Number]:
    """Numbers of a lane after the first three.

    r is among them where a lane has an even number.
    """
    names = ("prestress", "threshold_slope", *["residual_strength"] * (len(numbers) % 2 == 0), "sites", "machine")
    return dict(zip(names, numbers[3:], strict=False))


def _plain(numbers: Any) -> list[Number]:
    """Lane parameters from those whose positive ones are logarithms."""
    logs = {0, 1, *(i for i, name in enumerate(_by_name(numbers), 3) if name in ("sites", "machine"))}
    return [jnp.exp(x) if i in logs else x for i, x in enumerate(numbers)]


def _given(parameters: Float[Array, "fields lanes"], most: int) -> tuple[tuple[Number, ...], Number]:
    """`Lane.limit` and the parameters; and breaks after which a front never stops."""
    end, more = jnp.full_like(parameters[0], jnp.inf), _by_name(parameters)
    if more:
        with jax.numpy_rank_promotion("allow"):  # lanes are last in every array
            modes = lattice_modes(Slider(parameters[0], parameters[1], parameters[2]))
            kept = more.get("residual_strength")
            end = never_stops_after(modes, Interface(more["prestress"], more["threshold_slope"], kept))
    if "sites" in more:
        # a front that would stop nowhere on an endless chain may yet stop at the end of a short one
        contacts = jnp.ceil(more["sites"] - 0.5)
        end = jnp.where(contacts < FAR_END, contacts, end)
    return (jnp.minimum(end, most), *parameters), end


# --- derivations -------------------------------------------------------------------------------------------------------


def _rates(f: Callable[[Any], Any], at: Any, *rates: Any) -> tuple[Any, ...]:
    """``f(at)``, and its rate of change per rate of `at`."""
    return f(at), *(eqx.filter_jvp(f, (at,), (rate,))[1] for rate in rates)


def _rate_and_bend(f: Callable[[Any], Any], at: Any, rate: Any, bend: Any) -> tuple[Any, Any, Any]:
    """``f(at)``, and its first and second derivative from those of `at`."""
    (value, slope), (_, bent) = eqx.filter_jvp(lambda *x: eqx.filter_jvp(f, x[:1], x[1:]), (at, rate), (rate, bend))
    return value, slope, bent


def _crossing_and_rates(arrested: LaneAndFront, *rates: LaneAndFront) -> tuple[Any, ...]:
    """``_rates(_crossing, …)`` by one gradient, which takes less time to compile."""
    length, back = jax.vjp(_crossing, arrested)
    gradient, *ways = (jax.tree.leaves(x, is_leaf=lambda x: x is None) for x in (*back(jnp.ones_like(length)), *rates))
    return length, *(sum(x * by for x, by in zip(way, gradient, strict=True) if x is not None) for way in ways)


# --- all lanes ---------------------------------------------------------------------------------------------------------


def _arrested(derive: Callable[..., Any], begin: Callable[[Any], LaneAndFront], given: tuple[Number, ...], *ways: Any) -> Any:
    """Lanes and fronts once all have arrested, with their tangents.

    `ways` are the tangents of `given`, and `derive` is `_rates` or `_rate_and_bend`.
    """
    turn = functools.partial(derive, _turn)

    def some_go(moving: Any) -> Bool[Array, ""]:
        lane, front = moving[0]
        return jnp.any(_goes(lane, front, _stress_and_excess(lane, front)[1]))

    begun = in_one_loop(functools.partial(derive, begin), given, *ways)
    return lax.while_loop(some_go, lambda moving: in_one_loop(turn, *in_one_loop(turn, *moving)), begun)


def _once(f: Callable[..., Any], *moving: LaneAndFront) -> Any:
    """``f(*moving)``, by one loop over the lanes."""
    # XLA would look long for unused results, see `in_one_loop`
    return lax.optimization_barrier(in_one_loop(lambda *moving: (f(*moving), moving), *moving))[0]


def _length(arrested: LaneAndFront, end: Float[Array, " lanes"], crossing: Float[Array, " lanes"]) -> Float[Array, " lanes"]:
    """ℓ from `crossing`; inf where nothing stops, NaN where given up."""
    lane, front = arrested
    ended, going = front.position >= end, _stress_and_excess(lane, front)[1] >= 0
    if lane.end is not None:
        going = going | ended  # nothing is ahead of the last contact
    return jnp.where(going, jnp.where(ended, jnp.inf, jnp.nan), crossing)


def _rows(length: Float[Array, " lanes"], slopes: list[Any], flat: Any) -> Float[Array, "rows lanes"]:
    """ℓ and its derivatives, `flat` where there is no domino or stop."""
    return jnp.stack([length, *(jnp.where(jnp.isfinite(length) & (length > 0), x, flat) for x in slopes)])


# --- one lane ----------------------------------------------------------------------------------------------------------


def _begun(given: tuple[Number, ...], right: RightEnd = "semi-infinite", with_edge: bool = False) -> LaneAndFront:
    """A lane, and its front after contact 0 broke at its threshold."""
    limit, height, stiffness, poisson = given[:4]
    names = "prestress", "threshold_slope", "residual_strength", "sites", "machine"
    prestress, slope, kept, sites, machine = map(_by_name(given[1:]).get, names)
    modes = mode_numbers(height, stiffness, poisson, None if sites is None else (right, sites), machine)
    lane = Lane(modes["gap"], modes["weight"], limit)
    (w1, w2), (c1, c2), ((r11, r12), (_, r22)) = lane.weight, modes["drive"], modes["reflection"]
    if prestress is not None and slope is not None:
        tilt, still = None, 0.0
        if kept is not None:
            loose = inverse(1 - kept)
            prestress, tilt = (prestress - kept) * loose, -kept * slope * loose
            still = 0 * tilt  # later stresses move with the slope: their tangents are there from the start
        lane, start = lane._replace(contacts=(prestress, slope, tilt)), 1 - prestress + still
        c1, c2 = c1 * start, c2 * start
    if sites is not None:
        g1, g2 = lane.gap
        lane = lane._replace(end=(modes["echo"], (2 * jnp.log1p(-g1), 2 * jnp.log1p(-g2)), modes["last"]))
    zero, one = jnp.zeros_like(height), jnp.ones_like(height)
    e1, e2 = _echo(lane, zero)
    edge = (w1 + (e1 * r11 + e2 * r12), w2 + (e1 * r12 + e2 * r22), zero) if with_edge else None
    return lane, advance(lane, State((c1, c2), (r11, r12, r22), zero, edge), one)


def _turn(now: LaneAndFront) -> LaneAndFront:
    """Break `BREAKS_PER_TURN` contacts, or those before the front arrests."""
    lane, front = now
    for _ in range(BREAKS_PER_TURN):
        stress, excess = _stress_and_excess(lane, front)
        goes = _goes(lane, front, excess)
        front = jax.tree.map(functools.partial(lax.select, goes), advance(lane, front, stress), front)
    return lane, front


def _goes(lane: Lane, front: State, excess: Number) -> Bool[Array, "..."]:
    """Whether the contact ahead breaks, from the excess of its stress."""
    return (excess >= 0) & (front.position < lane.limit)


def _stress_and_excess(lane: Lane, front: State) -> Pair:
    """Stress on the contact ahead, and excess over its threshold, in σ_s."""
    (e1, e2), (z1, z2) = _echo(lane, front.position), front.stress
    threshold, prestress = _contact(lane, front.position)
    stress = prestress + (e1 * z1 + e2 * z2)
    return stress, stress - threshold


def _contact(lane: Lane, position: Number) -> tuple[Any, Any]:
    """θ and φ of a contact, in σ_s."""
    if lane.contacts is None:
        return 1.0, 0.0
    prestress, slope, tilt = lane.contacts
    return 1 + slope * position, prestress if tilt is None else prestress + tilt * position


def _echo(lane: Lane, position: Number) -> tuple[Any, Any]:
    """e_m at a contact."""
    if lane.end is None:
        return 1.0, 1.0
    (n1, n2), (rate1, rate2), last = lane.end
    return 1 + n1 * jnp.exp((last - position) * rate1), 1 + n2 * jnp.exp((last - position) * rate2)


def advance(lane: Lane, front: State, released: Number) -> State:
    """Pass the contact ahead, which gives up the stress `released`, in σ_s.

    As `slippulse_jax.front.front.advance` of two modes.
    """
    (g1, g2), (w1, w2), (e1, e2) = lane.gap, lane.weight, _echo(lane, front.position)
    (z1, z2), (q11, q12, q22), edge = front.stress, front.reflected, front.edge
    z1, z2 = z1 + (w1 + (q11 * e1 + q12 * e2)) * released, z2 + (w2 + (q12 * e1 + q22 * e2)) * released
    reflected = q11 - (g1 + g1 - g1 * g1) * q11, q12 - (g1 + g2 - g1 * g2) * q12, q22 - (g2 + g2 - g2 * g2) * q22
    if edge is not None:
        reach1, reach2, stress = edge
        edge = reach1 - g1 * reach1, reach2 - g2 * reach2, stress + (reach1 * e1 + reach2 * e2) * released
    return State((z1 - g1 * z1, z2 - g2 * z2), reflected, front.position + 1, edge)


def taken_back(lane: Lane, front: State) -> tuple[State, Number]:
    """Undo `advance` where the contact broke as a whole.

    Return the front before it, and the stress that it released, in σ_s. Each step back loses the digits of r_m.
    """
    (g1, g2), (w1, w2), position = lane.gap, lane.weight, front.position - 1
    (z1, z2), (q11, q12, q22), growth1, growth2 = front.stress, front.reflected, inverse(1 - g1), inverse(1 - g2)
    (e1, e2), (_, prestress) = _echo(lane, position), _contact(lane, position)
    z1, z2 = growth1 * z1, growth2 * z2
    q11, q12, q22 = growth1 * growth1 * q11, growth1 * growth2 * q12, growth2 * growth2 * q22
    v1, v2 = w1 + (q11 * e1 + q12 * e2), w2 + (q12 * e1 + q22 * e2)
    released = (prestress + (e1 * z1 + e2 * z2)) * inverse(1 + (e1 * v1 + e2 * v2))
    return State((z1 - v1 * released, z2 - v2 * released), (q11, q12, q22), position), released


def _crossing(arrested: LaneAndFront) -> Number:
    """ℓ, where the curve through the last overloads falls to zero."""
    lane, front = arrested
    position, over = front.position, [_stress_and_excess(lane, front)[1]]
    for _ in range(REACHED - 1):
        front, stress = taken_back(lane, front)
        excess = stress - _contact(lane, front.position)[0]
        over.append(jnp.where(front.position > 0, excess, 0))  # contact 0 breaks at its threshold exactly
    return end_of_front(position, over)
