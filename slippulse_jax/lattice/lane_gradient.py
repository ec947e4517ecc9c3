r"""Derivatives of many crossings at once, by the adjoint of the table: one pass over it backwards for all parameters.

At the crossing F = t(s) − 1 − εs = Σ_j c_j Σ_ka τ (E − 1) − εs, E = μ^s. The amplitudes hang on the table through
Σ_j c_j A_j = 1 and Σ_j c_j B_j = t(1) − t(0), with A = Σ τ and B = −Σ τ (1 − μ); multipliers y_0 A_j + y_1 B_j = Σ τ (E − 1),
j = 1, 2, turn that into weights on the terms,

    dF = Σ_j c_j Σ_ka d[τ (E − 1 − y_0 + y_1 (1 − μ))] + y_1 d[t(1) − t(0)] + …,

and the weights run through the recursion of the rows from the last to the first. What is left, from the inputs of the table to
(H/λc, k/K, ν, φ), is a short formula that JAX differentiates.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.lattice.lane_crossing import family_sums
from slippulse_jax.lattice.lane_series import (
    BLOCKS,
    ROWS,
    Inputs,
    Lanes,
    Series,
    Table,
    decayed,
    inputs_of,
    over_families,
    power_gaps,
)


def gradient(series: Series, theta: Float[Array, "5 lanes"], s: Lanes) -> Float[Array, "5 lanes"]:
    """dℓ*/d(H/λc, k/K, ν, φ, ε) = −(∂F/∂θ)/(∂F/∂s) at the crossing s > 0 of a prestressed `series` with all rows stored."""
    _, pull = jax.vjp(lambda x: inputs_of(x, prestressed=True), theta[:4])
    change, rate = _adjoint(series, s)
    (of_theta,) = pull(change)
    return -jnp.concatenate([of_theta, -s[None]]) / (rate - theta[4])


def _adjoint(series: Series, s: Lanes) -> tuple[Inputs, Lanes]:
    """∂F/∂`Inputs` and t'(s)."""
    inputs, c = series.inputs, series.amplitude
    lost, kept, bent = family_sums(series, s, blocks=len(BLOCKS), count=2)
    A, gaps, _ = series.totals
    kept = (1 - decayed(s * inputs.rate)) * kept  # Σ τ E
    rate = -over_families(c * (1 - decayed(s * inputs.rate)) * bent)
    determinant = A[1] * gaps[0] - A[0] * gaps[1]
    y0, y1 = (lost[0] * gaps[1] - gaps[0] * lost[1]) / determinant, (A[1] * lost[0] - A[0] * lost[1]) / determinant
    sums = _backwards(series, s, y0, y1)
    return Inputs(
        reflected=jnp.stack([over_families(x) for x in sums.reflected]).reshape(2, 2, -1),
        # 1 − μ = start_gap + start (1 − μ/start), where Σ τ μ/start is left of A
        start_gap=sums.start_gap + y1 * c * (A - gaps) / (1 - inputs.start_gap),
        to_roots=jnp.stack(sums.to_roots),
        to_modes=jnp.stack(sums.to_modes),
        rate=-s * c * kept,
        level_rate=over_families(sums.level_rate),
        column_rate=over_families(sums.column_rate),
        first_step=y1,
        plateau=-lost[2] - y0 * A[2] + y1 * gaps[2],
    ), rate


class _Sums(NamedTuple):
    """Derivatives of F as they add up row by row, of each family."""

    reflected: list[Array]
    to_roots: list[Array]
    to_modes: list[Array]
    start_gap: Array
    level_rate: Array
    column_rate: Array


def _backwards(series: Series, s: Lanes, y0: Lanes, y1: Lanes) -> _Sums:
    """The weights through the recursion of the rows, from the last row to the first."""
    zero = jnp.zeros_like(series.inputs.rate)
    sums = _Sums([zero] * 4, [zero] * 2, [zero] * 2, zero, zero, zero)
    first_row = jnp.zeros_like(series.blocks[0][0]).at[:, 0].set(1)
    incoming, powers = jnp.zeros_like(series.blocks[-1][0]), _powers(series, s)
    for i in range(len(BLOCKS) - 1, -1, -1):
        (start, end), block = BLOCKS[i], series.blocks[i]
        # the row above the block's first, as wide as its others
        above = series.blocks[i - 1][-1] if i else first_row[:, :1]
        above = jnp.zeros_like(block[0]).at[:, : above.shape[1]].set(above)
        rows = jnp.concatenate([above[None], block])
        rows = jnp.concatenate([jnp.zeros_like(rows[:, :, :2]), rows], axis=2)
        row = partial(_row_backwards, series, rows, start, s, y0, y1, powers)
        first = jnp.minimum(end, series.last)
        incoming, sums = lax.fori_loop(
            0, jnp.maximum(first - start + 1, 0), lambda n, x, f=first, row=row: row(f - n, x), (incoming, sums)
        )
        incoming = incoming[:, : 2 * start - 1]
    return sums


class _Powers(NamedTuple):
    """What μ is made of, over one step and over s; computed once, or every array in the loop would compute it again."""

    start: Float[Array, "F lanes"]  # 1 − start^s
    levels: tuple[Array, Array]  # 1 − r_2^{2k} and its power s
    columns: tuple[Array, Array]  # 1 − (r_1/r_2)^a and its power s


def _powers(series: Series, s: Lanes) -> _Powers:
    inputs = series.inputs

    def both(rate: Lanes, count: int) -> tuple[Array, Array]:
        return power_gaps(decayed(rate), count), power_gaps(decayed(s * rate), count)

    return _Powers(decayed(s * inputs.rate), both(inputs.level_rate, ROWS + 1), both(inputs.column_rate, 2 * ROWS + 1))


def _row_backwards(
    series: Series,
    rows: Array,
    start: int,
    s: Lanes,
    y0: Lanes,
    y1: Lanes,
    powers: _Powers,
    k: Array,
    state: tuple[Table, _Sums],
) -> tuple[Table, _Sums]:
    """Weights on row k become weights on row k − 1 and derivatives; the mirror image of `lane_series.entries`."""
    inputs, c = series.inputs, series.amplitude[:, None]
    incoming, sums = state
    width = incoming.shape[1]
    tau, above = rows[k + 1 - start, :, 2:], rows[k - start]
    two, one, zero = above[:, :-2], above[:, 1:-1], above[:, 2:]
    rank = k.astype(s.dtype)
    (level, level_s), (column, column_s) = ((x[k] for x in powers.levels), (x[:width] for x in powers.columns))
    rho = (1 - inputs.start_gap)[:, None]
    kept = (1 - level) * (1 - column)  # μ/start
    x = rho * (1 - kept)
    start_s = powers.start[:, None]
    gone = start_s + (1 - start_s) * (level_s + (1 - level_s) * column_s)  # 1 − E
    weight = c * (y1 * (1 - rho * kept) - y0 - gone) + incoming
    weight = jnp.where(rank <= series.own_last, weight, 0)
    to_1, to_2, from_1, from_2 = (y[:, None] for y in (*inputs.to_roots, *inputs.to_modes))
    q = weight / ((to_1 - x) * (to_2 - x))
    h1, h2 = q * (from_1 - x), q * (from_2 - x)
    (R11, R12), (R21, R22) = inputs.reflected
    g1, g2 = R11 * two + R12 * one, R21 * one + R22 * zero
    of_x = q * (tau * (to_1 - x + to_2 - x) - g1 - g2)
    of_rates = rho * kept * (of_x + y1 * c * tau) - s * c * tau * (1 - gone)
    a = jnp.asarray(np.arange(float(width))[:, None])
    total = of_rates.sum(1)
    found = _Sums(
        [y.sum(1) for y in (h2 * two, h2 * one, h1 * one, h1 * zero)],
        [-(q * tau * y).sum(1) for y in (to_2 - x, to_1 - x)],
        [(q * y).sum(1) for y in (g2, g1)],
        -(of_x * (1 - kept)).sum(1),
        rank * total,
        (a * of_rates).sum(1),
    )
    before = R11 * h2[:, 2:] + (R12 * h2 + R21 * h1)[:, 1:-1] + (R22 * h1)[:, :-2]
    return incoming.at[:, : width - 2].set(before), jax.tree.map(jnp.add, sums, found)
