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
- A front that has arrested leaves its length in the place of its stresses, (NaN, ℓ): nothing breaks under a stress that is no
  number, and nothing has to be recorded elsewhere.
- Derivatives are tangents of a block, carried beside it for all parameters at once. Those of r_m^s, which are s r_m^s d ln r_m,
  need not be carried.
- Nothing but sums, products, quotients and square roots: the same bits whatever the lane's place in the chunk.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Complex, Float, Int

from slippulse_jax.interface import Interface
from slippulse_jax.lattice.batch import Kernel
from slippulse_jax.lattice.interface_front import APPROACH, runaway_prestress, slowest_approach
from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.slider import Slider

Pair = tuple[Array, Array]  # one number a mode, of lanes

BLOCK, GRADIENT_BLOCK = 8, 4
"""Breaks taken between two looks at the lanes, powers of two; fewer where derivatives lengthen what is compiled."""


class Constants(NamedTuple):
    """Constants of a lane."""

    gap: Pair  # 1 − r_m
    weight: Pair  # w_m
    reflection: tuple[Array, Array, Array]  # R_11, R_12 = R_21, R_22
    prestress: Array | None  # φ; None on a relaxed, uniform interface
    slope: Array | None  # ε, threshold 1 + ε s


class Start(NamedTuple):
    """A lane when contact 0 has broken."""

    constants: Constants
    stress: Complex[Array, "..."]  # Z_1 + i Z_2
    log_ratio: Pair  # ln r_m, of which only derivatives are used


class Now(NamedTuple):
    """What a turn of the loop hands on."""

    stress: Complex[Array, " lanes"]
    tangents: tuple[Complex[Array, " lanes"], ...]
    decay: Complex[Array, " lanes"]  # r_1^s + i r_2^s
    position: Int[Array, ""]  # s
    some_going: Bool[Array, ""]  # as the turn began


def length_kernel(max_contacts: int) -> Kernel:
    """ℓ of lanes (height, stiffness, poisson[, prestress, threshold_slope]), in λc.

    Of uniform, semi-infinite interfaces without repinning delay. inf where it never stops, NaN after `max_contacts` breaks.
    """

    def lengths(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        start = jax.vmap(_nucleate, in_axes=1)(parameters)
        end = jax.vmap(_end, in_axes=1)(parameters)

        def body(now: Now) -> Now:
            s = now.position.astype(end.dtype)
            return _turned(
                now, start.constants, _block(start.constants, now.stress, now.decay, s, end, max_contacts, BLOCK), (), BLOCK
            )

        now = lax.while_loop(lambda now: _unfinished(now, max_contacts), body, _first(start, ()))
        return (_length(now.stress),)

    return lengths


def gradient_kernel(max_contacts: int) -> Kernel:
    """ℓ of lanes as by `length_kernel`, and its derivative in every field."""

    def lengths(parameters: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        def nucleate(x: Array) -> Start:
            return jax.vmap(_nucleate, in_axes=1)(x)

        units = [jnp.zeros_like(parameters).at[i].set(1) for i in range(parameters.shape[0])]
        start = nucleate(parameters)
        rates: list[Start] = [jax.jvp(nucleate, (parameters,), (unit,))[1] for unit in units]
        end = jax.vmap(_end, in_axes=1)(parameters)

        def body(now: Now) -> Now:
            s = now.position.astype(end.dtype)

            def block(constants: Constants, stress: Array, decay: Array) -> Array:
                return _block(constants, stress, decay, s, end, max_contacts, GRADIENT_BLOCK)

            def along(rate: Start, tangent: Array) -> Array:
                E1, E2 = _parts(now.decay)
                moving = lax.complex(s * rate.log_ratio[0] * E1, s * rate.log_ratio[1] * E2)
                return jax.jvp(block, (start.constants, now.stress, now.decay), (rate.constants, tangent, moving))[1]

            tangents = tuple(along(rate, tangent) for rate, tangent in zip(rates, now.tangents, strict=True))
            return _turned(now, start.constants, block(start.constants, now.stress, now.decay), tangents, GRADIENT_BLOCK)

        now = lax.while_loop(lambda now: _unfinished(now, max_contacts), body, _first(start, tuple(r.stress for r in rates)))
        length = _length(now.stress)
        # ℓ = 0 is flat, and what is no number has no derivative
        flat = jnp.where(jnp.isfinite(length), 0, jnp.nan)
        return length, *(jnp.where(jnp.isfinite(length) & (length > 0), d.imag, flat) for d in now.tangents)

    return lengths


def _nucleate(parameters: Float[Array, " fields"]) -> Start:
    """A lane whose contact 0 has broken (at exactly its threshold, which rounding must not spoil)."""
    modes = lattice_modes(Slider(parameters[0], parameters[1], parameters[2]))
    R, one = modes.reflection, jnp.ones_like(modes.load)
    prestress, slope = (parameters[3], parameters[4]) if parameters.shape[0] > 3 else (None, None)
    constants = Constants(
        (modes.gap[0], modes.gap[1]), (modes.weight[0], modes.weight[1]), (R[0, 0], R[0, 1], R[1, 1]), prestress, slope
    )
    drive = modes.drive if prestress is None else (1 - prestress) * modes.drive
    g1, g2 = _gains(constants, (one, one))
    stress = _shrink((drive[0] + g1, drive[1] + g2), constants.gap)
    log_ratio = jnp.log1p(-modes.gap)
    running = _excess(constants, stress, one)[1] >= 0
    ended = lax.complex(jnp.nan * one, jnp.where(running, jnp.inf, 0) * one)
    going = running & (_end(parameters) > 1)
    return Start(constants, jnp.where(going, lax.complex(*stress), ended), (log_ratio[0], log_ratio[1]))


def _end(parameters: Float[Array, " fields"]) -> Array:
    """Breaks after which a front that is still running never stops (`slippulse_jax.lattice.interface_front`); mostly inf."""
    if parameters.shape[0] == 3:
        return jnp.asarray(jnp.inf, parameters.dtype)
    parameters = lax.stop_gradient(parameters)
    interface = Interface(parameters[3], parameters[4])
    modes = lattice_modes(Slider(parameters[0], parameters[1], parameters[2]))
    never_stops = (parameters[4] == 0) & (parameters[3] >= runaway_prestress(modes))
    enough = jnp.where(never_stops, APPROACH / slowest_approach(modes) + 10, jnp.inf)
    return jnp.ceil(jnp.minimum(enough, interface.last_site()))


def _parts(x: Array) -> Pair:
    return x.real, x.imag


def _shrink(x: Pair, gap: Pair) -> Pair:
    """R x, mode by mode, as x − (1 − r) x."""
    return x[0] - gap[0] * x[0], x[1] - gap[1] * x[1]


def _gains(lane: Constants, decay: Pair) -> Pair:
    """w_m + Σ_n R_mn r_m^s r_n^s."""
    (w1, w2), (R11, R12, R22), (E1, E2) = lane.weight, lane.reflection, decay
    return w1 + E1 * (R11 * E1 + R12 * E2), w2 + E2 * (R12 * E1 + R22 * E2)


def _excess(lane: Constants, Z: Pair, position: Array) -> tuple[Array, Array]:
    """Stress on the contact ahead, and by how much it exceeds the threshold."""
    if lane.prestress is None or lane.slope is None:
        t = Z[0] + Z[1]
        return t, t - 1
    t = lane.prestress + (Z[0] + Z[1])
    return t, t - (1 + lane.slope * position)


def _block(lane: Constants, stress: Array, decay: Array, s: Array, end: Array, max_contacts: int, breaks: int) -> Array:
    """State after some breaks from position `s`: stresses, or (NaN, ℓ) once arrested."""
    arrived, E = _parts(stress), _parts(decay)
    Z = arrived
    going = started = _going(stress)
    t, over = _excess(lane, Z, s)
    behind = ahead = over
    broken = jnp.zeros_like(over) + s
    runs = jnp.zeros_like(going)
    for position in (s + k for k in range(1, breaks + 1)):
        g1, g2 = _gains(lane, E)
        Z, E = _shrink((Z[0] + g1 * t, Z[1] + g2 * t), lane.gap), _shrink(E, lane.gap)
        t, after = _excess(lane, Z, position)
        behind, ahead = jnp.where(going, over, behind), jnp.where(going, after, ahead)
        broken = jnp.where(going, position, broken)
        over, going = after, going & (after >= 0)
        if lane.prestress is not None:
            runs = runs | (going & (position >= end))
            going = going & ~runs
    # t(ℓ) = 1 + εℓ on the straight line between the last contact that broke and the first that did not
    length = jnp.where(runs, jnp.inf, broken - 1 + behind / (behind - ahead))
    length = jnp.where(broken <= max_contacts, length, jnp.nan)
    kept = jnp.where(started, length, arrived[1])
    return lax.complex(jnp.where(going, Z[0], jnp.nan), jnp.where(going, Z[1], kept))


def _going(stress: Array) -> Array:
    """Lanes whose front has not arrested."""
    return stress.real == stress.real


def _length(stress: Array) -> Array:
    return jnp.where(_going(stress), jnp.nan, stress.imag)


def _first(start: Start, tangents: tuple[Array, ...]) -> Now:
    gap = start.constants.gap
    decay = lax.complex(1 - gap[0], 1 - gap[1])
    return Now(start.stress, tangents, decay, jnp.ones((), jnp.int32), jnp.array(True))


def _turned(now: Now, constants: Constants, stress: Array, tangents: tuple[Array, ...], breaks: int) -> Now:
    E = _parts(now.decay)
    for _ in range(breaks):  # as within a block, so that its number of breaks does not show in the bits
        E = _shrink(E, constants.gap)
    return Now(stress, tangents, lax.complex(*E), now.position + breaks, jnp.any(_going(now.stress)))


def _unfinished(now: Now, max_contacts: int) -> Array:
    return now.some_going & (now.position <= max_contacts)
