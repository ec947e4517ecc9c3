r"""Lengths of many sliders at once, at the speed of the arithmetic: a chunk of lanes advances in step.

The sums of `slippulse_jax.lattice.front` fold into two numbers a lane. With Z_m = w_m S_m + r_m^s (A C_m + Σ_n R_mn T_n), the
stress ahead is t = φ + Z_1 + Z_2, and breaking contact s is

    Z_m → r_m [Z_m + v_m t],        v_m = w_m + Σ_n R_mn r_m^s r_n^s,

where R is symmetric (a pinning point at i moves site j as one at j moves site i); A = 1 − φ. Along a parameter (a dot),

    Ż_m → r_m [Ż_m + v_m ṫ + v̇_m t] + (ln r_m)˙ Z_m',    v̇_m = ẇ_m + Σ_n [Ṙ_mn + s (ln r_m r_n)˙ R_mn] r_m^s r_n^s,

where Z_m' is the new Z_m. What else a loop over lanes costs was read off the compiled program:

- A turn is one loop over the lanes that computes every number once (`slippulse_jax.bulk.compiler.in_one_loop`).
- A look at the lanes, and handing them on, cost as much as some breaks: `BREAKS` are taken in a turn and two turns between two
  looks, the second writing where the first has read.
- What the edge adds, R_mn r_m^s r_n^s, is three geometric sequences, begun anew from r_m^s in each turn; their coefficients
  along a parameter grow by the same amount at every break.
- A front that has arrested stays as it is: nothing has to be recorded elsewhere.
- Nothing but sums, products, quotients and square roots: the same bits whatever the lane's place in the chunk.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from slippulse_jax.bulk.chunks import Kernel
from slippulse_jax.bulk.compiler import in_one_loop
from slippulse_jax.interface import Interface
from slippulse_jax.lattice.delayed import APPROACH, runaway_prestress, slowest_approach
from slippulse_jax.lattice.lane_modes import LaneRates, Number, Pair, lane_modes, lane_rates
from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

Three = tuple[Number, Number, Number]  # one number for mn = 11, 12, 22

BREAKS = 6
"""Breaks of a turn."""


class Lane(NamedTuple):
    """What stays as it is."""

    gap: Pair  # 1 − r_m
    weight: Pair  # w_m
    reflection: Three  # R_mn
    at_edge: Pair | None  # w_n + Σ_m R_mn, for the stress on contact 0; None where it is not asked for
    prestress: Number | None  # φ; None on a relaxed, uniform interface
    slope: Number | None  # ε, threshold 1 + ε s
    end: Number | None  # breaks after which a front that is still running never stops; mostly inf
    most: Number | None  # breaks after which it is given up, if it must not go on for a few more


class Along(NamedTuple):
    """Derivatives of what stays, along a parameter of the slider."""

    log_decay: Pair  # of ln r_m
    weight: Pair
    reflection: Three


class Rate(NamedTuple):
    """Derivatives of a front, along any parameter."""

    stress: Pair
    behind: Number


class Front(NamedTuple):
    """A front that has broken contacts 0 … broken − 1."""

    stress: Pair  # Z_m
    decay: Pair  # r_m^s; goes on when the front has arrested
    broken: Number  # s, a whole number
    behind: Number  # load on the contact that broke last
    edge: Number | None  # stress on contact 0
    rates: tuple[Rate, ...]  # along height, stiffness, poisson[, prestress, slope]


class Now(NamedTuple):
    """What a look at the lanes sees."""

    front: Front
    lane: Lane
    along: tuple[Along, ...]


@functools.cache
def length_kernel(max_contacts: int) -> Kernel:
    """ℓ of lanes (height, stiffness, poisson[, prestress, threshold_slope]), in λc.

    Of uniform, semi-infinite interfaces without repinning delay. inf where it never stops, NaN after `max_contacts` breaks.
    """

    def lengths(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        return (_length(_until_all_arrest(parameters, max_contacts), max_contacts),)

    return lengths


@functools.cache
def arrest_kernel(max_contacts: int) -> Kernel:
    """Contacts broken, ℓ, status and stress on contact 0 of lanes as for `length_kernel`."""

    def arrests(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        now = _until_all_arrest(parameters, max_contacts, with_edge=True)
        front, length = now.front, _length(now, max_contacts)
        assert front.edge is not None
        endings = {
            Outcome.INVALID: ~jnp.isfinite(_ahead(now.lane, front)[1]),
            Outcome.RUN_AWAY: jnp.isposinf(length),
            Outcome.LIMIT: jnp.isnan(length),
            Outcome.NO_DOMINO: front.broken == 1,
            Outcome.REBREAK: front.edge >= 1,
        }
        status = jnp.select(list(endings.values()), list(endings), Outcome.ARRESTED).astype(jnp.int32)
        return front.broken.astype(jnp.int32), length, status, front.edge

    return arrests


@functools.cache
def gradient_kernel(max_contacts: int) -> Kernel:
    """ℓ of lanes as by `length_kernel`, to rounding, and its derivative in every field: rows of one array."""

    def lengths(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        now = _until_all_arrest(parameters, max_contacts, with_rates=True)
        front, length = now.front, _length(now, max_contacts)
        over_fall = 1 / (front.behind - _ahead(now.lane, front)[1])
        part = (front.behind - _level(now.lane)) * over_fall
        # ℓ = 0 is flat, and what is no number has no derivative
        flat = jnp.where(jnp.isfinite(length), 0, jnp.nan)

        def derivative(which: int) -> Array:
            behind, ahead = front.rates[which].behind, _ahead_rate(front, which)[1]
            return jnp.where(jnp.isfinite(length) & (length > 0), (behind - part * (behind - ahead)) * over_fall, flat)

        return (jnp.stack([length, *(derivative(which) for which in range(len(front.rates)))]),)

    return lengths


def _until_all_arrest(
    parameters: Float[Array, "fields lanes"], max_contacts: int, with_rates: bool = False, with_edge: bool = False
) -> Now:
    def start(*fields: Number) -> tuple[Front, Lane, tuple[Along, ...]]:
        return _nucleate(fields, with_rates, max_contacts if with_edge else None)

    ends = () if parameters.shape[0] == 3 else (_end(parameters),)

    def two_turns(now: Now) -> Now:
        return Now(*in_one_loop(_turn, *in_one_loop(_turn, *now)))

    def some_go(now: Now) -> Bool[Array, ""]:
        return jnp.any(_goes(now.lane, now.front) & (now.front.broken < max_contacts))

    return lax.while_loop(some_go, two_turns, Now(*in_one_loop(start, *parameters, *ends)))


def _nucleate(fields: tuple[Number, ...], with_rates: bool, most: int | None) -> tuple[Front, Lane, tuple[Along, ...]]:
    """A lane whose contact 0 has broken (at its threshold, which rounding must not spoil); with `most`, the edge too."""
    height, stiffness, poisson = fields[:3]
    prestress, slope, end = fields[3:] or (None, None, None)
    modes, common = lane_modes(height, stiffness, poisson)
    (w1, w2), (R11, R12, R22), (C1, C2) = modes.weight, modes.reflection, modes.drive
    v, drive = (w1 + (R11 + R12), w2 + (R22 + R12)), 1 if prestress is None else 1 - prestress
    one, none = jnp.ones_like(height), jnp.zeros_like(height)
    at_edge, edge, last = (None, None, None) if most is None else (v, v[0] + v[1], most * one)
    lane = Lane(modes.gap, modes.weight, modes.reflection, at_edge, prestress, slope, end, last)
    Z = _shrink(lane, (drive * C1 + v[0], drive * C2 + v[1]))
    rates, along = (), ()
    if with_rates:
        slider_rates = lane_rates(height, stiffness, modes, common)
        rates = tuple(Rate(_nucleate_rate(lane, drive, Z, rate), none) for rate in slider_rates)
        along = tuple(Along(rate.log_decay, rate.weight, rate.reflection) for rate in slider_rates)
        if prestress is not None:
            rates += Rate(_shrink(lane, (-C1, -C2)), none), Rate((none, none), none)
    return Front(Z, _shrink(lane, (one, one)), one, _level(lane) * one, edge, rates), lane, along


def _nucleate_rate(lane: Lane, drive: Number | int, Z: Pair, rate: LaneRates) -> Pair:
    (dw1, dw2), (dR11, dR12, dR22), (dC1, dC2), (l1, l2) = rate.weight, rate.reflection, rate.drive, rate.log_decay
    Y = _shrink(lane, (drive * dC1 + (dw1 + (dR11 + dR12)), drive * dC2 + (dw2 + (dR22 + dR12))))
    return Y[0] + l1 * Z[0], Y[1] + l2 * Z[1]


def _end(parameters: Float[Array, "fields lanes"]) -> Float[Array, " lanes"]:
    """Breaks after which a front that is still running never stops (`slippulse_jax.lattice.delayed`)."""
    interface = Interface(parameters[3], parameters[4])
    with jax.numpy_rank_promotion("allow"):  # lanes are last in every array
        modes = lattice_modes(Slider(parameters[0], parameters[1], parameters[2]))
    never_stops = (parameters[4] == 0) & (parameters[3] >= runaway_prestress(modes))
    enough = jnp.where(never_stops, APPROACH / slowest_approach(modes) + 10, jnp.inf)
    return jnp.ceil(jnp.minimum(enough, interface.last_site()))


def _shrink(lane: Lane, x: Pair) -> Pair:
    """R x, mode by mode, as x − (1 − r) x."""
    return x[0] - lane.gap[0] * x[0], x[1] - lane.gap[1] * x[1]


def _level(lane: Lane) -> int:
    """Load at which a contact breaks."""
    return 1 if lane.prestress is None else 0


def _ahead(lane: Lane, front: Front) -> tuple[Number, Number]:
    """Stress on the contact ahead, and its load: that stress, or where thresholds vary its excess."""
    Z1, Z2 = front.stress
    if lane.prestress is None or lane.slope is None:
        t = Z1 + Z2
        return t, t
    t = lane.prestress + (Z1 + Z2)
    return t, t - (1 + lane.slope * front.broken)


def _ahead_rate(front: Front, which: int) -> tuple[Number, Number]:
    """Derivatives of `_ahead`, along height, stiffness, poisson, prestress or slope."""
    t = front.rates[which].stress[0] + front.rates[which].stress[1]
    if which == 3:
        t = t + 1
    return t, t - front.broken if which == 4 else t


def _goes(lane: Lane, front: Front) -> Array:
    """Whether the contact ahead breaks."""
    goes = _ahead(lane, front)[1] >= _level(lane)
    for last in (lane.end, lane.most):
        goes = goes if last is None else goes & (front.broken < last)
    return goes


def _turn(front: Front, lane: Lane, along: tuple[Along, ...]) -> tuple[Front, Lane, tuple[Along, ...]]:
    """`BREAKS` breaks, of a lane that has not arrested before."""
    (E1, E2), (g1, g2), (R11, R12, R22) = front.decay, lane.gap, lane.reflection
    edge: Three = (E1 * E1, E1 * E2, E2 * E2)
    fading = g1 * (2 - g1), g1 + g2 - g1 * g2, g2 * (2 - g2)  # 1 − r_m r_n
    growth = [(2 * l1 * R11, (l1 + l2) * R12, 2 * l2 * R22) for (l1, l2), *_ in along]
    bent = [_grown(rate.reflection, by, front.broken) for rate, by in zip(along, growth, strict=True)]
    for _ in range(BREAKS):
        front = _break(front, lane, along, edge, bent)
        edge = edge[0] - fading[0] * edge[0], edge[1] - fading[1] * edge[1], edge[2] - fading[2] * edge[2]
        bent = [_grown(x, by, 1) for x, by in zip(bent, growth, strict=True)]
    return front, lane, along


def _grown(x: Three, by: Three, times: Number | int) -> Three:
    return x[0] + times * by[0], x[1] + times * by[1], x[2] + times * by[2]


def _break(front: Front, lane: Lane, along: tuple[Along, ...], edge: Three, bent: list[Three]) -> Front:
    """Break the contact ahead, where it breaks. `edge`: r_m^s r_n^s; `bent`: their coefficients in v̇_m."""
    goes, (t, load) = _goes(lane, front), _ahead(lane, front)
    (Z1, Z2), (w1, w2), (R11, R12, R22) = front.stress, lane.weight, lane.reflection
    both = R12 * edge[1]
    v = (w1 + both) + R11 * edge[0], (w2 + both) + R22 * edge[2]
    Z = _shrink(lane, (Z1 + v[0] * t, Z2 + v[1] * t))

    def rate(which: int) -> Rate:
        (Y1, Y2), behind = front.rates[which]
        dt, dload = _ahead_rate(front, which)
        Y1, Y2 = Y1 + v[0] * dt, Y2 + v[1] * dt
        if which < len(along):
            (dw1, dw2), (c11, c12, c22) = along[which].weight, bent[which]
            both = c12 * edge[1]
            Y1, Y2 = Y1 + ((dw1 + both) + c11 * edge[0]) * t, Y2 + ((dw2 + both) + c22 * edge[2]) * t
        Y1, Y2 = _shrink(lane, (Y1, Y2))
        if which < len(along):
            l1, l2 = along[which].log_decay
            Y1, Y2 = Y1 + l1 * Z[0], Y2 + l2 * Z[1]
        return Rate((Y1, Y2), dload)

    at_0 = None
    if front.edge is not None and lane.at_edge is not None:
        at_0 = front.edge + (lane.at_edge[0] * front.decay[0] + lane.at_edge[1] * front.decay[1]) * t
    rates = tuple(rate(which) for which in range(len(front.rates)))
    after = Front(Z, front.decay, front.broken + 1, load, at_0, rates)
    kept = jax.tree.map(lambda new, old: lax.select(goes, new, old), after, front)
    return kept._replace(decay=_shrink(lane, front.decay))


def _length(now: Now, max_contacts: int) -> Float[Array, " lanes"]:
    """ℓ: where the load on a straight line between the contact that broke last and the one ahead falls to its level."""
    front, lane = now.front, now.lane
    ahead, level = _ahead(lane, front)[1], _level(lane)
    runs = ahead >= level
    length = front.broken - 1 + (front.behind - level) / (front.behind - ahead)
    endless = jnp.nan if lane.end is None else jnp.where(front.broken >= lane.end, jnp.inf, jnp.nan)
    return jnp.where(front.broken <= max_contacts, jnp.where(runs, endless, length), jnp.nan)
