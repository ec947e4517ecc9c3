r"""Lengths of many sliders at once, at the speed of the arithmetic: a chunk of lanes advances in step.

The sums of `slippulse_jax.lattice.front` fold into two numbers a lane. With Z_m = w_m S_m + r_m^s (A C_m + Σ_n R_mn T_n), the
stress ahead is t = φ + Z_1 + Z_2, and breaking contact s is

    Z_m → r_m [Z_m + (w_m + Σ_n R_mn r_m^s r_n^s) t],

where R is symmetric (a pinning point at i moves site j as one at j moves site i); A = 1 − φ. What else a loop over lanes costs
was read off the compiled program:

- XLA on a CPU writes one loop over the lanes for each array that a turn of the loop hands on, and repeats in it all that the
  array depends on. So a turn hands on one array that takes work, the two modes being the real and imaginary part of one
  complex number, and r_m^s, which takes next to none.
- A look at the lanes costs as much as two breaks: `BLOCK` breaks are taken between two looks.
- What the edge adds, R_mn r_m^s r_n^s, is three geometric sequences, begun anew from r_m^s in each block.
- A front that has arrested leaves its length in the place of its stresses, (NaN, ℓ): nothing breaks under a stress that is no
  number, and nothing has to be recorded elsewhere.
- Derivatives are tangents of a block, carried beside it for all parameters at once. Those of r_m^s, which are s r_m^s d ln r_m,
  need not be carried.
- On relaxed interfaces all of it is compiled as one function (`slippulse_jax.lattice.kernel`): XLA would hand operations of the
  loop to other threads, which have chunks of their own to do.
- Nothing but sums, products, quotients and square roots: the same bits whatever the lane's place in the chunk.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float, Int

from slippulse_jax.interface import Interface
from slippulse_jax.lattice.batch import Kernel
from slippulse_jax.lattice.interface_front import APPROACH, runaway_prestress, slowest_approach
from slippulse_jax.lattice.kernel import as_one_kernel
from slippulse_jax.lattice.lane_rates import mode_rates
from slippulse_jax.lattice.modes import Modes, lattice_modes
from slippulse_jax.slider import Slider

Pair = tuple[Array, Array]  # one number a mode, of lanes

BLOCK = 8
"""Breaks taken between two looks at the lanes."""


class Constants(NamedTuple):
    """Constants of a lane."""

    gap: Pair  # 1 − r_m
    weight: Pair  # w_m
    reflection: tuple[Array, Array, Array]  # R_11, R_12 = R_21, R_22
    prestress: Array | None  # φ; None on a relaxed, uniform interface
    slope: Array | None  # ε, threshold 1 + ε s


class Start(NamedTuple):
    """Lanes when contact 0 has broken."""

    constants: Constants
    stress: Pair  # Z_m, or (NaN, ℓ) where contact 1 holds


class Now(NamedTuple):
    """What a turn of the loop hands on."""

    stress: Complex[Array, " lanes"]  # Z_1 + i Z_2
    tangents: tuple[Complex[Array, " lanes"], ...]
    decay: Complex[Array, " lanes"]  # r_1^s + i r_2^s
    position: Int[Array, ""]  # s


def length_kernel(max_contacts: int) -> Kernel:
    """ℓ of lanes (height, stiffness, poisson[, prestress, threshold_slope]), in λc.

    Of uniform, semi-infinite interfaces without repinning delay. inf where it never stops, NaN after `max_contacts` breaks.
    """

    def lengths(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        lanes = Lanes(_nucleate(parameters), (), _end(parameters))

        def body(now: Now) -> Now:
            stress = _block(lanes.start.constants, now.stress, now.decay, _site(now), lanes.end, max_contacts)
            return _turned(now, lanes.start.constants, stress, ())

        return (_length(_until_all_arrest(body, lanes, max_contacts).stress),)

    def as_one(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        # the sums by which a prestress is found to be beyond run-away are more than such a function may hold
        return as_one_kernel(lengths, parameters) if parameters.shape[0] == 3 else lengths(parameters)

    return as_one


def gradient_kernel(max_contacts: int) -> Kernel:
    """ℓ of lanes as by `length_kernel`, to rounding, and its derivative in every field."""

    def lengths(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        lanes = Lanes(_nucleate(parameters), _start_rates(parameters), _end(parameters))
        constants = lanes.start.constants

        def body(now: Now) -> Now:
            s = _site(now)

            def block(constants: Constants, stress: Array, decay: Array) -> Array:
                return _block(constants, stress, decay, s, lanes.end, max_contacts)

            def along(rate: Start, tangent: Array) -> Array:
                # r^s moves by s r^s d ln r
                (E1, E2), (gap_1, gap_2), (d1, d2) = _parts(now.decay), constants.gap, rate.constants.gap
                moving = lax.complex(-s * E1 * (d1 / (1 - gap_1)), -s * E2 * (d2 / (1 - gap_2)))
                return jax.jvp(block, (constants, now.stress, now.decay), (rate.constants, tangent, moving))[1]

            tangents = tuple(along(rate, tangent) for rate, tangent in zip(lanes.rates, now.tangents, strict=True))
            return _turned(now, constants, block(constants, now.stress, now.decay), tangents)

        now = _until_all_arrest(body, lanes, max_contacts)
        length = _length(now.stress)
        # ℓ = 0 is flat, and what is no number has no derivative
        flat = jnp.where(jnp.isfinite(length), 0, jnp.nan)
        return length, *(jnp.where(jnp.isfinite(length) & (length > 0), d.imag, flat) for d in now.tangents)

    return lengths


class Lanes(NamedTuple):
    """What is known of lanes before they set off."""

    start: Start
    rates: tuple[Start, ...]  # derivatives of `start`
    end: Array  # `_end`


def _nucleate(parameters: Float[Array, "fields lanes"]) -> Start:
    """Lanes whose contact 0 has broken (at exactly its threshold, which rounding must not spoil)."""
    constants, drive = _constants(parameters, _modes(parameters))
    stress, one = _first_stress(constants, drive), jnp.ones_like(parameters[0])
    running = _ahead(constants, stress, one)[1] >= (1 if constants.prestress is None else 0)
    going = running & (_end(parameters) > 1)
    Z1, Z2 = jnp.where(going, stress[0], jnp.nan), jnp.where(going, stress[1], jnp.where(running, jnp.inf, 0))
    return Start(constants, (Z1, Z2))


def _constants(parameters: Float[Array, "fields lanes"], modes: Modes) -> tuple[Constants, Pair]:
    """Constants of lanes, and the drive C_m."""
    R = modes.reflection
    prestress, slope = (parameters[3], parameters[4]) if parameters.shape[0] > 3 else (None, None)
    gap, weight = (modes.gap[0], modes.gap[1]), (modes.weight[0], modes.weight[1])
    return Constants(gap, weight, (R[0, 0], R[0, 1], R[1, 1]), prestress, slope), (modes.drive[0], modes.drive[1])


def _first_stress(constants: Constants, drive: Pair) -> Pair:
    """Z_m when contact 0 has broken."""
    if constants.prestress is not None:
        drive = (1 - constants.prestress) * drive[0], (1 - constants.prestress) * drive[1]
    return _break(constants, drive, constants.reflection, jnp.ones_like(drive[0]))


def _start_rates(parameters: Float[Array, "fields lanes"]) -> tuple[Start, ...]:
    """Derivatives of `_nucleate` in every field, of lanes that go on."""
    modes = _modes(parameters)
    constants, drive = _constants(parameters, modes)
    still = jax.tree.map(jnp.zeros_like, constants)
    moves = [
        (still._replace(gap=rate.gap, weight=rate.weight, reflection=rate.reflection), rate.drive)
        for rate in mode_rates(Slider(parameters[0], parameters[1], parameters[2]), modes)
    ]
    if parameters.shape[0] > 3:
        one, none = jnp.ones_like(parameters[0]), (jnp.zeros_like(drive[0]), jnp.zeros_like(drive[1]))
        moves += [(still._replace(prestress=one), none), (still._replace(slope=one), none)]
    return tuple(Start(move[0], jax.jvp(_first_stress, (constants, drive), move)[1]) for move in moves)


def _modes(parameters: Float[Array, "fields lanes"]) -> Modes:
    with jax.numpy_rank_promotion("allow"):  # lanes are last in every array
        return lattice_modes(Slider(parameters[0], parameters[1], parameters[2]))


def _end(parameters: Float[Array, "fields lanes"]) -> Float[Array, " lanes"]:
    """Breaks after which a front that is still running never stops (`slippulse_jax.lattice.interface_front`); mostly inf."""
    if parameters.shape[0] == 3:
        return jnp.full(parameters.shape[1], jnp.inf, parameters.dtype)
    parameters = lax.stop_gradient(parameters)
    interface, modes = Interface(parameters[3], parameters[4]), _modes(parameters)
    never_stops = (parameters[4] == 0) & (parameters[3] >= runaway_prestress(modes))
    enough = jnp.where(never_stops, APPROACH / slowest_approach(modes) + 10, jnp.inf)
    return jnp.ceil(jnp.minimum(enough, interface.last_site()))


def _parts(x: Array) -> Pair:
    return x.real, x.imag


def _shrink(x: Pair, gap: Pair) -> Pair:
    """R x, mode by mode, as x − (1 − r) x."""
    return x[0] - gap[0] * x[0], x[1] - gap[1] * x[1]


def _edge(lane: Constants, decay: Pair) -> tuple[Array, Array, Array]:
    """R_mn r_m^s r_n^s, what the left edge adds to the response at site s."""
    (R11, R12, R22), (E1, E2) = lane.reflection, decay
    return R11 * E1 * E1, R12 * E1 * E2, R22 * E2 * E2


def _break(lane: Constants, Z: Pair, edge: tuple[Array, Array, Array], t: Array) -> Pair:
    """Z_m one contact further."""
    (w1, w2), (R11, R12, R22) = lane.weight, edge
    return _shrink((Z[0] + (w1 + (R11 + R12)) * t, Z[1] + (w2 + (R22 + R12)) * t), lane.gap)


def _ahead(lane: Constants, Z: Pair, position: Array) -> tuple[Array, Array]:
    """Stress on the contact ahead, and what decides whether it breaks: that stress, or where thresholds vary its excess."""
    if lane.prestress is None or lane.slope is None:
        t = Z[0] + Z[1]
        return t, t
    t = lane.prestress + (Z[0] + Z[1])
    return t, t - (1 + lane.slope * position)


def _block(lane: Constants, stress: Array, decay: Array, s: Array, end: Array, max_contacts: int) -> Array:
    """State after `BLOCK` breaks from position `s`: stresses, or (NaN, ℓ) once arrested."""
    arrived = Z = _parts(stress)
    edge, (gap_1, gap_2) = _edge(lane, _parts(decay)), lane.gap
    fading = gap_1 * (2 - gap_1), gap_1 + gap_2 - gap_1 * gap_2, gap_2 * (2 - gap_2)  # 1 − r_m r_n
    level = 1 if lane.prestress is None else 0
    going = started = _going(stress)
    t, load = _ahead(lane, Z, s)
    behind = ahead = load
    steps = jnp.zeros_like(load)
    runs = jnp.zeros_like(going)
    for k in range(BLOCK):
        behind, steps = jnp.where(going, load, behind), jnp.where(going, k, steps)
        Z = _break(lane, Z, edge, t)
        edge = edge[0] - fading[0] * edge[0], edge[1] - fading[1] * edge[1], edge[2] - fading[2] * edge[2]
        t, load = _ahead(lane, Z, s + (k + 1))
        ahead = jnp.where(going, load, ahead)
        going = going & (load >= level)
        if lane.prestress is not None:
            runs = runs | (going & (s + (k + 1) >= end))
            going = going & ~runs
    # t(ℓ) = 1 + εℓ on the straight line between the last contact that broke, s + steps, and the first that did not
    length = jnp.where(runs, jnp.inf, s + steps + (behind - level) / (behind - ahead))
    length = jnp.where(s + steps < max_contacts, length, jnp.nan)
    kept = jnp.where(started, length, arrived[1])
    return lax.complex(jnp.where(going, Z[0], jnp.nan), jnp.where(going, Z[1], kept))


def _going(stress: Array) -> Array:
    """Lanes whose front has not arrested."""
    return stress.real == stress.real


def _length(stress: Array) -> Array:
    return jnp.where(_going(stress), jnp.nan, stress.imag)


def _until_all_arrest(body: Callable[[Now], Now], lanes: Lanes, max_contacts: int) -> Now:
    gap = lanes.start.constants.gap
    tangents = tuple(lax.complex(*rate.stress) for rate in lanes.rates)
    first = Now(lax.complex(*lanes.start.stress), tangents, lax.complex(1 - gap[0], 1 - gap[1]), jnp.ones((), jnp.int32))
    return lax.while_loop(lambda now: jnp.any(_going(now.stress)) & (now.position <= max_contacts), body, first)


def _site(now: Now) -> Array:
    return now.position.astype(now.stress.real.dtype)


def _turned(now: Now, constants: Constants, stress: Array, tangents: tuple[Array, ...]) -> Now:
    E = _parts(now.decay)
    for _ in range(BLOCK):
        E = _shrink(E, constants.gap)
    return Now(stress, tangents, lax.complex(*E), now.position + BLOCK)
