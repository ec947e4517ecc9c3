"""Where the stress of many fronts falls to the threshold: Newton's method, every lane until it has converged by itself."""

from collections.abc import Callable
from math import comb
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


def crossing(series: Series, theta: Float[Array, "5 lanes"]) -> tuple[Lanes, Int[Array, " lanes"]]:
    """ℓ* and its status, 0 arrested or 1 no domino as in `ExactStatus`, or `UNSETTLED`.

    Settled are fronts well below run-away (φ < 0.999 φ_c) on thresholds that do not fall: t then has one maximum, and one
    crossing beyond it, which a negative slope there certifies. Newton's method on the first rows of the table brings a lane to
    about 1e-5 of the crossing; there the whole table is summed with its first three derivatives, once or seldom twice.
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

    def refine(s: Lanes) -> Lanes:
        excess, first, second, third = derivatives(series, s)
        excess, first = excess - slope * s, first - slope
        d = -excess / first
        for _ in range(3):  # the cubic's own Newton steps
            value = excess + d * (first + d / 2 * (second + d / 3 * third))
            d = d - value / (first + d * (second + d / 2 * third))
        # far off, the cubic means nothing
        good = (first < 0) & (jnp.abs(d) < 0.1 * s)
        return jnp.where(good, s + d, step(excess + slope * s, first + slope, s))

    def approach(s: Lanes) -> Lanes:
        excess, rate = _low(series, s)
        return step(excess, rate, s)

    s, _ = _iterate(approach, start, 1e-4)
    s, before = _iterate(refine, s, 2e-4)
    # rows that were not stored must have died out by then
    level = decayed(s * series.inputs.level_rate * (STORED + 1))
    left = (1 - level) * jnp.abs(series.beyond).max(0) <= ROW_TOLERANCE * jnp.minimum(jnp.abs(series.rows[1]).max(0), 1)
    settled = regular & (~moves | _close(s, before, 2e-4) & left)
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


def _low(series: Series, s: Lanes) -> list[Lanes]:
    """t(s) − 1 and t'(s) by the first block of the table."""
    return _total(series, s, family_sums(series, s, blocks=1, count=2))


def derivatives(series: Series, s: Lanes) -> list[Lanes]:
    """t(s) − 1 and three derivatives, by all rows stored."""
    return _total(series, s, family_sums(series, s, blocks=len(BLOCKS), count=4))


def _total(series: Series, s: Lanes, sums: list[Array]) -> list[Lanes]:
    """Σ_j c_j: first t − 1, then the derivatives."""
    left = series.amplitude * (1 - decayed(s * series.inputs.rate))
    return [
        -over_families(series.amplitude * sums[0]),
        *((-1) ** n * over_families(left * x) for n, x in enumerate(sums[2:], 1)),
    ]


def family_sums(series: Series, s: Lanes, blocks: int, count: int) -> list[Float[Array, "F lanes"]]:
    """Of each family Σ τ (1 − μ^s), then Σ τ (μ/start)^s (−ln μ)^n for n = 0 … count − 1, by as many blocks of stored rows.

    t − 1 is summed as what every term has lost since s = 0, so that a rise as small as b keeps its digits. By Horner's rule in
    u = r_2^{2s}: what row k has lost is (1 − u^k) Σ_a τ + u^k Σ_a τ (1 − v^a), and (1 − u^k) sums to (1 − u) Σ_k u^k times the
    rows above k. Rows that are not summed are taken to have lost what the last one has by its level.
    """
    inputs = series.inputs
    moments = [_row_moments(series, s, i, count) for i in range(blocks) if series.blocks[i].shape[0]]
    level_gap, start_gap = decayed(s * inputs.level_rate), decayed(s * inputs.rate)
    level, zero = 1 - level_gap, jnp.zeros_like(inputs.rate)
    lost = [jnp.concatenate([zero[None], *(block[n] for block in moments)]) for n in range(count)]
    last = lost[0].shape[0] - 1
    change, sums = zero, [zero] * count
    above = sum((series.rows[k] for k in range(last + 1, series.rows.shape[0])), series.beyond)
    for k in range(last, -1, -1):
        kept = series.rows[k] - lost[0][k]
        change = level * change + level_gap * above + lost[0][k] + start_gap * kept
        above = above + series.rows[k]
        of_row = _binomial(inputs.rate + k * inputs.level_rate, [kept, *(x[k] for x in lost[1:])])
        sums = [level * x + y for x, y in zip(sums, of_row, strict=True)]
    return [change, *sums]


def _row_moments(series: Series, s: Lanes, which: int, count: int) -> list[Float[Array, "rows F lanes"]]:
    """Of each row of a block: Σ_a τ (1 − v^a), then Σ_a (aδ)^n τ v^a for n = 1 … count − 1; v^s = e^{−δ s}."""
    start, end = BLOCKS[which]
    column_gap = power_gaps(decayed(s * series.inputs.column_rate), 2 * end + 1)
    a = jnp.asarray(np.arange(2.0 * end + 1)[:, None])
    weights = [column_gap, *((a * series.inputs.column_rate) ** n * (1 - column_gap) for n in range(1, count))]
    zero = [jnp.zeros((end - start + 1, *series.rows.shape[1:]))] * count

    def add(k: Array, found: list[Array]) -> list[Array]:
        tau = series.blocks[which][k - start]
        each = (over_columns(w * tau) for w in weights)
        return [lax.dynamic_update_index_in_dim(x, y, k - start, 0) for x, y in zip(found, each, strict=True)]

    return lax.fori_loop(start, jnp.minimum(end, series.last) + 1, add, zero)


def _binomial(level: Array, moments: list[Array]) -> list[Array]:
    """Σ_a τ v^a (level + aδ)^n, n = 0, 1, …, from the moments in aδ."""
    return [
        sum((comb(n, i) * level ** (n - i) * moments[i] for i in range(n)), moments[n]) if n else moments[0]
        for n in range(len(moments))
    ]
