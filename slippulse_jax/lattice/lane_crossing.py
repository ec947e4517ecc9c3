"""Where the stress of many fronts falls to the threshold: Newton's method, every lane until it has converged by itself."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax.lattice.lane_series import (
    BLOCKS,
    ROW_TOLERANCE,
    STORED,
    Lanes,
    Series,
    decayed,
    over_columns,
    over_families,
    power_gaps,
)
from slippulse_jax.slider import Slider

UNSETTLED = -1
"""Status of a lane that this search leaves to `slippulse_jax.lattice.exact`."""

MAX_TURNS = 16
"""Steps, of each kind, before a lane is left to the safeguarded search."""

CLOSE = 1e-7
"""Relative size of the last Newton step: its square is rounding."""


def crossing(series: Series, theta: Float[Array, "5 lanes"]) -> tuple[Lanes, Int[Array, " lanes"]]:
    """ℓ* and its status, 0 arrested or 1 no domino as in `Outcome`, or `UNSETTLED`.

    Settled are fronts well below run-away (φ < 0.999 φ_c) on thresholds that do not fall: t then has one maximum, and one
    crossing beyond it, which a negative slope there certifies. Newton's method on the first rows of the table brings a lane to
    about 1e-5 of the crossing, and on the whole table to the crossing itself.
    """
    slope = theta[4]
    moves = series.at_edge() > slope
    regular = series.sound & (series.inputs.plateau < 0.999) & (slope >= 0)
    start = jnp.where(moves & regular, _start(series, theta), 0)

    def step(excess: Lanes, rate: Lanes, s: Lanes) -> Lanes:
        # ln t is all but straight: x (6 + x)/(6 + 4x) is ln(1 + x) near 0
        x = jnp.maximum(excess, -0.9)
        by_log = x * (6 + x) / (6 + 4 * x) * (1 + excess) / rate
        newton = s - jnp.where(slope == 0, by_log, (excess - slope * s) / (rate - slope))
        return jnp.where(rate < slope, jnp.clip(newton, s / 4, 4 * s + 10), 2 * s + 0.25)

    def approach(s: Lanes) -> Lanes:
        return step(*rise(series, s, blocks=1), s)

    def arrive(s: Lanes) -> Lanes:
        return step(*rise(series, s), s)

    s, _ = _iterate(approach, start, 1e-4)
    s, before = _iterate(arrive, s, CLOSE)
    # rows that were not stored must have died out by then
    level = decayed(s * series.inputs.level_rate * (STORED + 1))
    left = (1 - level) * jnp.abs(series.beyond).max(0) <= ROW_TOLERANCE * jnp.minimum(jnp.abs(series.rows[1]).max(0), 1)
    settled = regular & (~moves | _close(s, before, CLOSE) & left)
    status = jnp.where(settled, jnp.where(moves, 0, 1), UNSETTLED)
    return jnp.where(settled & moves, s, 0), status


def _close(s: Lanes, before: Lanes, tolerance: float) -> Bool[Array, " lanes"]:
    return jnp.abs(s - before) <= tolerance * s


def _iterate(function: Callable[[Lanes], Lanes], s: Lanes, tolerance: float) -> tuple[Lanes, Lanes]:
    """(s, the s before) once every lane is close; one that is stays where it is, and s = 0 asks for nothing."""

    def turn(carry: Any) -> Any:
        s, before, count = carry
        done = _close(s, before, tolerance)
        return jnp.where(done, s, function(s)), jnp.where(done, before, s), count + 1

    def unfinished(carry: Any) -> Array:
        return (~_close(carry[0], carry[1], tolerance)).any() & (carry[2] < MAX_TURNS)

    return lax.while_loop(unfinished, turn, (s, jnp.zeros_like(s), 0))[:2]


def _start(series: Series, theta: Array) -> Lanes:
    """By the tail c_2 ρ_2^s far from the edge, or the macroscopic law on a rigid upper layer, whichever makes sense."""
    slider = Slider(theta[0], theta[1], theta[2])
    excess = series.amplitude[1] / (1 - jnp.minimum(series.inputs.plateau, 0.999)) - 1
    b = slider.b
    by_tail = excess > 0.1
    return jnp.log1p(jnp.where(by_tail, excess, b / (2 + b))) / jnp.where(by_tail, series.inputs.rate[1], slider.kappa_2)


def rise(series: Series, s: Lanes, blocks: int = len(BLOCKS)) -> tuple[Lanes, Lanes]:
    """t(s) − 1 and t'(s), by as many blocks of stored rows.

    t − 1 is summed as what every term has lost since s = 0, so that a rise as small as b keeps its digits. By Horner's rule in
    u = r_2^{2s}: what row k has lost is (1 − u^k) Σ_a τ + u^k Σ_a τ (1 − v^a), and (1 − u^k) sums to (1 − u) Σ_k u^k times the
    rows above k. Rows that are not summed are taken to have lost what the last one has by its level.
    """
    inputs = series.inputs
    moments = [_row_moments(series, s, i) for i in range(blocks) if series.blocks[i].shape[0]]
    level_gap, start_gap = decayed(s * inputs.level_rate), decayed(s * inputs.rate)
    level, zero = 1 - level_gap, jnp.zeros_like(inputs.rate)
    lost, bent = (jnp.concatenate([zero[None], *(block[n] for block in moments)]) for n in (0, 1))
    last = lost.shape[0] - 1
    change, fall = zero, zero
    above = sum((series.rows[k] for k in range(last + 1, STORED + 1)), series.beyond)
    for k in range(last, -1, -1):
        kept = series.rows[k] - lost[k]
        change = level * change + level_gap * above + lost[k] + start_gap * kept
        above = above + series.rows[k]
        fall = level * fall + (inputs.rate + k * inputs.level_rate) * kept + bent[k]
    c = series.amplitude
    return -over_families(c * change), -over_families(c * (1 - start_gap) * fall)


def _row_moments(series: Series, s: Lanes, which: int) -> list[Float[Array, "rows F lanes"]]:
    """Of each row of a block: Σ_a τ (1 − v^a) and Σ_a aδ τ v^a; v^s = e^{−δ s}."""
    start, end = BLOCKS[which]
    rate = series.inputs.column_rate
    gap = power_gaps(decayed(s * rate), 2 * end + 1)
    weights = gap, jnp.asarray(np.arange(2.0 * end + 1)[:, None]) * rate * (1 - gap)
    zero = [jnp.zeros((end - start + 1, *series.rows.shape[1:]))] * 2

    def add(k: Array, found: list[Array]) -> list[Array]:
        tau = series.blocks[which][k - start]
        each = (over_columns(w * tau) for w in weights)
        return [lax.dynamic_update_index_in_dim(x, y, k - start, 0) for x, y in zip(found, each, strict=True)]

    return lax.fori_loop(start, jnp.minimum(end, series.last) + 1, add, zero)
