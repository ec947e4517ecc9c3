r"""Lengths of many sliders at once, at the speed of the arithmetic: a chunk of lanes advances in step.

The sums of `slippulse_jax.lattice.front` fold into two numbers a lane. With Z_m = w_m S_m + r_m^s (C_m + Σ_n R_mn T_n), the
stress ahead is t = Z_1 + Z_2, and breaking contact s is

    Z_m → r_m [Z_m + (w_m + Σ_n R_mn r_m^s r_n^s) t],

where R is symmetric (a pinning point at i moves site j as one at j moves site i). What else a loop over lanes costs was read
off the compiled program:

- XLA on a CPU writes one loop over the lanes for each array that a turn of the loop hands on, and repeats in it all that the
  array depends on. The two modes therefore travel as the real and imaginary part of one complex array, `BLOCK` breaks are
  taken at a time, and their outcome is handed on whole: it is looked at in the next turn.
- A lane whose front would arrest within the next block stays where it is, so that nothing is recorded on the way; a last
  block, run once, finds the break at which it arrested.
- Nothing but sums, products, quotients and square roots: the same bits whatever the lane's place in the chunk.
"""

import functools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.devices import spread
from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.slider import Slider

Pair = tuple[Array, Array]  # one number a mode, of lanes

BLOCK = 4
"""Breaks taken between two looks at the lanes: a power of two."""


CHUNKS = (64, 512, 4096)
"""Lanes a chunk may have. The largest is fastest a lane; the others spare small batches its padding."""


def sorted_lengths(lanes: np.ndarray, max_contacts: int) -> np.ndarray:
    """Length of each lane, in λc: lanes of like length together, in chunks of few shapes, on every core.

    Parameters
    ----------
    lanes : numpy.ndarray, shape (3, n)
        Height, stiffness and Poisson's ratio, float64.
    """
    order = np.argsort(length_rank(lanes), kind="stable")
    result = np.empty(lanes.shape[1])

    def run(chunk: tuple[np.ndarray, int]) -> None:
        chosen, size = chunk
        parameters = np.take(lanes, np.resize(chosen, size), axis=1)
        result[chosen] = np.asarray(_compiled(max_contacts)(parameters))[: len(chosen)]

    spread(run, _chunks(order))
    return result


def length_rank(lanes: np.ndarray) -> np.ndarray:
    """Rank by the leading term of Eq. (25), ln[2/(1+β)]/κ_2, in steps small beside the lengths; uint16, sorted by digits."""
    height, stiffness, poisson = lanes.astype(np.float32)
    shape = 2 * (1 + poisson)
    b = shape * stiffness * height
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        expected = np.log((1 + b) / (1 + b / 2)) * height * np.sqrt(shape * (1 + 1 / b))
        rank = np.log2(np.maximum(expected, 1e-3)) * 1024 + 16384  # 1e-3 to 1e14, a thousandth apart
    return np.nan_to_num(rank, nan=65535, posinf=65535).clip(0, 65535).astype(np.uint16)


def _chunks(order: np.ndarray) -> Iterator[tuple[np.ndarray, int]]:
    """Lanes of each chunk, and its size; long fronts first, so that no core is left with one of them at the end."""
    whole = len(order) - len(order) % CHUNKS[-1]
    if whole < len(order):
        rest = order[whole:]
        yield rest, next(size for size in CHUNKS if size >= len(rest))
    for start in range(whole - CHUNKS[-1], -1, -CHUNKS[-1]):
        yield order[start : start + CHUNKS[-1]], CHUNKS[-1]


@functools.cache
def _compiled(max_contacts: int) -> Callable[[np.ndarray], Array]:
    return jax.jit(lambda parameters: lane_lengths(parameters, max_contacts))


def lane_lengths(parameters: Float[Array, "3 lanes"], max_contacts: int) -> Float[Array, " lanes"]:
    """Length ℓ of the first precursor of each lane (height, stiffness, poisson), in λc; NaN after `max_contacts` breaks.

    Uniform, relaxed, semi-infinite; time is that of the longest front of the chunk.
    """
    lane, first = jax.vmap(_nucleate, in_axes=1)(parameters)
    block_gap = lane.gap
    for _ in range(BLOCK.bit_length() - 1):
        block_gap = block_gap[0] * (2 - block_gap[0]), block_gap[1] * (2 - block_gap[1])  # 1 − r^{2n} from 1 − r^n

    def body(carry: tuple[Array, ...]) -> tuple[Array, ...]:
        stress, decay, candidate, blocks, count, _ = carry
        on = candidate.real + candidate.imag >= 1
        stress = jnp.where(on, candidate, stress)
        decay = jnp.where(on, lax.complex(*_shrink(_parts(decay), block_gap)), decay)
        # used nowhere else in this turn, or every array that uses it would repeat the block
        candidate = lax.complex(*_block(lane, _Front(_parts(stress), _parts(decay))))
        return stress, decay, candidate, blocks + on, count + 1, jnp.any(on)

    def unfinished(carry: tuple[Array, ...]) -> Array:
        return carry[5] & (carry[4] * BLOCK < max_contacts)

    blocks = jnp.zeros(parameters.shape[1], parameters.dtype)
    stress, decay = lax.complex(*first.stress), lax.complex(*first.decay)
    start = (stress, decay, lax.complex(*_block(lane, first)), blocks, jnp.zeros((), jnp.int32), jnp.array(True))
    stress, decay, _, blocks, _, _ = lax.while_loop(unfinished, body, start)
    return _arrest(lane, _Front(_parts(stress), _parts(decay)), 1 + BLOCK * blocks, max_contacts)


class _Lane(NamedTuple):
    """Constants of a lane."""

    gap: Pair  # 1 − r_m
    weight: Pair  # w_m
    reflection: tuple[Array, Array, Array]  # R_11, R_12 = R_21, R_22


class _Front(NamedTuple):
    """State of a lane."""

    stress: Pair  # Z_m
    decay: Pair  # r_m^s


def _nucleate(parameters: Float[Array, "3"]) -> tuple[_Lane, _Front]:
    """A lane, and its front once contact 0 has broken (at exactly its threshold, which rounding must not spoil)."""
    modes = lattice_modes(Slider(parameters[0], parameters[1], parameters[2]))
    R, one = modes.reflection, jnp.ones_like(modes.load)
    lane = _Lane((modes.gap[0], modes.gap[1]), (modes.weight[0], modes.weight[1]), (R[0, 0], R[0, 1], R[1, 1]))
    g1, g2 = _gains(lane, (one, one))
    first = modes.drive[0] + g1, modes.drive[1] + g2
    return lane, _Front(_shrink(first, lane.gap), _shrink((one, one), lane.gap))


def _parts(x: Array) -> Pair:
    return x.real, x.imag


def _shrink(x: Pair, gap: Pair) -> Pair:
    """R x, mode by mode, as x − (1 − r) x."""
    return x[0] - gap[0] * x[0], x[1] - gap[1] * x[1]


def _gains(lane: _Lane, decay: Pair) -> Pair:
    """w_m + Σ_n R_mn r_m^s r_n^s."""
    (w1, w2), (R11, R12, R22), (E1, E2) = lane.weight, lane.reflection, decay
    return w1 + E1 * (R11 * E1 + R12 * E2), w2 + E2 * (R12 * E1 + R22 * E2)


def _break(lane: _Lane, front: _Front) -> _Front:
    (Z1, Z2), (g1, g2) = front.stress, _gains(lane, front.decay)
    t = Z1 + Z2
    return _Front(_shrink((Z1 + g1 * t, Z2 + g2 * t), lane.gap), _shrink(front.decay, lane.gap))


def _block(lane: _Lane, front: _Front) -> Pair:
    """Stresses after BLOCK breaks, or negative ones if some contact on the way would not have broken."""
    least = sum(front.stress)
    for _ in range(BLOCK):
        front = _break(lane, front)
        least = jnp.minimum(least, sum(front.stress))
    Z1, Z2 = front.stress
    return jnp.where(least >= 1, Z1, -1), jnp.where(least >= 1, Z2, -1)


def _arrest(lane: _Lane, front: _Front, broken: Array, max_contacts: int) -> Array:
    """Length of a front that arrests within the next block; NaN where it does not, or only after `max_contacts` breaks."""
    behind, ahead = jnp.ones_like(broken), sum(front.stress)
    alive = ahead >= 1
    for _ in range(BLOCK):
        front = _break(lane, front)
        broken, behind = broken + alive, jnp.where(alive, ahead, behind)
        ahead = jnp.where(alive, sum(front.stress), ahead)
        alive = alive & (ahead >= 1)
    length = broken - 1 + (behind - 1) / (behind - ahead)
    return jnp.where(alive | ~(broken <= max_contacts), jnp.nan, length)
