r"""The double series of many fronts at once: lanes last in every array, no half table of zeros, and each lane its own degree.

The same solution as `slippulse_jax.double_series`, written for the total stress alone,

    t(s) = Σ_j c_j Σ_ka τ^j_ka μ^s,   μ = start_j (r_2²)^k (r_1/r_2)^a,   0 ≤ a ≤ 2k,   start = ρ_1, ρ_2; 1 under prestress,

    τ_ka = [g_1 (μ − r_2) + g_2 (μ − r_1)] / [(μ − ρ_1)(μ − ρ_2)],
    g_1 = r_1 (R_11 τ_{k−1,a−2} + R_12 τ_{k−1,a−1}),   g_2 = r_2 (R_12 τ_{k−1,a−1} + R_22 τ_{k−1,a}).

Two things differ. The pole at a resonance ρ_2 r_2^{2n} = ρ_1 is left in: it costs digits only where the distance is below
a thousandth of the residue, which `Series.sound` watches over. And a lane's table ends at the first row whose moduli add up
to less than `ROW_TOLERANCE` of the first row's: rows shrink by a third at least (measured; docs/exact_solution.md), so that
what is left out is below half of that. A lane that has ended gets rows of zeros, so that it never depends on its neighbours.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.slider import Slider

ROW_TOLERANCE = 5e-13
"""Moduli of a lane's last row beside those of its first."""

BLOCKS = ((1, 5), (6, 11), (12, 17))
"""First and last row k of each block of one width 2·last + 1: compiled once each, few zeros."""

ROWS = BLOCKS[-1][1]

Lanes = Float[Array, " lanes"]


class Series(NamedTuple):
    """Table and amplitudes of a chunk of lanes; F families."""

    blocks: tuple[Float[Array, "rows F a lanes"], ...]  # τ
    rows: Float[Array, "k F lanes"]  # Σ_a τ
    slopes: Float[Array, "k F lanes"]  # Σ_a a τ
    last: Array  # the last row any lane has
    amplitude: Float[Array, "F lanes"]  # c_j
    rate: Float[Array, "F lanes"]  # −ln start_j
    level_rate: Lanes  # −2 ln r_2
    column_rate: Lanes  # −ln(r_1/r_2)
    plateau: Lanes  # stress far from the edge where nothing stops the front
    sound: Array  # whether every digit is there

    def at_edge(self) -> Lanes:
        """t'(0)."""
        k = np.arange(ROWS + 1)[:, None, None]
        bend = (self.level_rate * k * self.rows + self.column_rate * self.slopes).sum(0)
        return -(self.amplitude * (self.rate * self.rows.sum(0) + bend)).sum(0)


class Constants(NamedTuple):
    """What the table is made of."""

    reflected: Float[Array, "2 2 lanes"]  # r_m R_mn
    rho: Float[Array, "F lanes"]  # start_j
    to_roots: Float[Array, "2 F lanes"]  # start_j − ρ_i
    to_modes: Float[Array, "2 F lanes"]  # start_j − r_m
    level_gap: Lanes  # 1 − r_2²
    column_gap: Lanes  # 1 − r_1/r_2


def solve(theta: Float[Array, "n lanes"], prestressed: bool) -> Series:
    """Series of lanes (H/λc, k/K, ν, φ, …); φ is not looked at unless `prestressed`."""
    modes = jax.vmap(lambda h, q, n: lattice_modes(Slider(h, q, n)), in_axes=0, out_axes=-1)(*theta[:3])
    phi = theta[3] if prestressed else None
    r, w, gap = modes.ratio, modes.weight, modes.gap
    coupling, reflected = r * w, r[:, None] * modes.reflection
    diagonal = gap - coupling
    difference = diagonal[0] - diagonal[1]
    split = jnp.sqrt(difference**2 + 4 * coupling[0] * coupling[1])
    larger = (jnp.abs(difference) + split) / 2
    smaller = coupling[0] * coupling[1] / larger
    up, down = jnp.where(difference < 0, smaller, larger), jnp.where(difference < 0, larger, smaller)
    runaway = (1 + w[0] + w[1]) / 2
    gap_1 = (diagonal[0] + diagonal[1] + split) / 2
    gap_2 = gap[0] * gap[1] * runaway / gap_1
    apart = gap[0] - gap[1]
    zero = jnp.zeros_like(split)
    # ρ_j − r_m as products of positive numbers, from (r_1 − ρ_1)(r_1 − ρ_2) = −w_1 r_1 (r_1 − r_2) and the like at r_2
    to_mode_1 = [coupling[0] * apart / (up + coupling[0]), up + coupling[0]]
    to_mode_2 = [-coupling[1] * apart / (down + coupling[1]), down + coupling[1]]
    to_root_1, to_root_2, start_gap = [zero, split], [-split, zero], [gap_1, gap_2]
    if prestressed:
        to_mode_1, to_mode_2 = [*to_mode_1, gap[0]], [*to_mode_2, gap[1]]
        to_root_1, to_root_2 = [*to_root_1, gap_1], [*to_root_2, gap_2]
        start_gap = [*start_gap, zero]
    start_gap = jnp.stack(start_gap)
    constants = Constants(
        reflected=reflected,
        rho=1 - start_gap,
        to_roots=jnp.stack([jnp.stack(to_root_1), jnp.stack(to_root_2)]),
        to_modes=jnp.stack([jnp.stack(to_mode_1), jnp.stack(to_mode_2)]),
        level_gap=gap[1] * (1 + r[1]),
        column_gap=apart / r[1],
    )
    table = _table(constants)
    # c_j from t(0) = 1 and from the first step t(1) − t(0), both of which the front's recursion knows
    step = coupling.sum(0) + reflected.sum((0, 1))
    pushed = (gap * modes.drive).sum(0)
    known_0, known_1 = jnp.ones_like(zero), step - pushed
    A, B = table.rows.sum(0), -(start_gap * table.rows.sum(0) + (1 - start_gap) * table.gaps)
    plateau = zero
    if phi is not None:
        plateau = phi / runaway
        known_0, known_1 = known_0 - plateau * A[2], step - (1 - phi) * pushed - plateau * B[2]
    determinant = A[0] * B[1] - A[1] * B[0]
    amplitude = [(known_0 * B[1] - A[1] * known_1) / determinant, (A[0] * known_1 - known_0 * B[0]) / determinant]
    amplitude = jnp.stack([*amplitude, plateau] if prestressed else amplitude)
    mode_rate = -jnp.log1p(-gap)
    rate = -jnp.log1p(-jnp.stack([gap_1, gap_2]))
    sound = table.ended & (jnp.abs(amplitude[0]) < 1e3) & (jnp.abs(amplitude[1]) < 1e3)
    return Series(
        blocks=table.blocks,
        rows=table.rows,
        slopes=table.slopes,
        last=table.last,
        amplitude=amplitude,
        rate=jnp.concatenate([rate, zero[None]]) if prestressed else rate,
        level_rate=2 * mode_rate[1],
        column_rate=mode_rate[0] - mode_rate[1],
        plateau=plateau,
        sound=sound,
    )


class _Table(NamedTuple):
    blocks: tuple[Array, ...]
    rows: Array
    slopes: Array
    gaps: Array  # Σ_ka τ (1 − r_2^{2k} (r_1/r_2)^a)
    last: Array
    ended: Array


def _table(constants: Constants) -> _Table:
    """Rows until every lane has ended, or `ROWS`."""
    families, lanes = constants.rho.shape
    column_gap = _power_gaps(constants.column_gap, 2 * ROWS + 1)
    level_gap = _power_gaps(constants.level_gap, ROWS + 1)
    rho, (to_1, to_2), (from_1, from_2) = (x[..., None, :] for x in (constants.rho, constants.to_roots, constants.to_modes))
    (R11, R12), (R21, R22) = constants.reflected
    zeros = jnp.zeros((ROWS + 1, families, lanes))
    rows = zeros.at[0].set(1)
    slopes, gaps = zeros, zeros[0]
    above = jnp.zeros((families, 2 * ROWS + 3, lanes)).at[:, 2].set(1)
    running, first = jnp.ones(lanes, bool), jnp.ones(lanes)
    k, blocks = jnp.asarray(1, jnp.int32), []
    for start, end in BLOCKS:
        width = 2 * end + 1
        a = np.arange(width, dtype=float)[:, None]

        def row(carry: Any, width: int = width, a: np.ndarray = a, start: int = start) -> Any:
            k, above, block, rows, slopes, gaps, running, first = carry
            level = level_gap[k]
            columns = column_gap[:width]
            x = rho * (level + (1 - level) * columns)
            g1 = R11 * above[:, :-2] + R12 * above[:, 1:-1]
            g2 = R21 * above[:, 1:-1] + R22 * above[:, 2:]
            tau = (g1 * (from_2 - x) + g2 * (from_1 - x)) / ((to_1 - x) * (to_2 - x))
            tau = jnp.where(running, tau, 0)
            total = _over_columns(tau)
            size = sum(_over_columns(jnp.abs(tau)))
            first = jnp.where(k == 1, jnp.minimum(size, 1), first)
            gaps = gaps + level * total + (1 - level) * _over_columns(tau * columns)
            rows = lax.dynamic_update_index_in_dim(rows, total, k, 0)
            slopes = lax.dynamic_update_index_in_dim(slopes, _over_columns(jnp.asarray(a) * tau), k, 0)
            block = lax.dynamic_update_index_in_dim(block, tau, k - start, 0)
            above = lax.dynamic_update_slice_in_dim(above, tau, 2, 1)
            return k + 1, above, block, rows, slopes, gaps, running & (size > ROW_TOLERANCE * first), first

        def going(carry: Any, end: int = end) -> Array:
            return (carry[0] <= end) & carry[-2].any()

        block = jnp.zeros((end - start + 1, families, width, lanes))
        carry = (k, above[:, : width + 2], block, rows, slopes, gaps, running, first)
        k, short, block, rows, slopes, gaps, running, first = lax.while_loop(going, row, carry)
        above = above.at[:, : width + 2].set(short)
        blocks.append(block)
    return _Table(tuple(blocks), rows, slopes, gaps, k - 1, ~running)


def _power_gaps(gap: Lanes, count: int) -> Float[Array, "count lanes"]:
    """1 − (1 − gap)^n, n = 0 … count − 1, as sums of positive numbers."""
    out = jnp.stack([jnp.zeros_like(gap), gap])
    while out.shape[0] < count:  # twice as many powers by one product: 1 − xy = (1 − x) + x (1 − y)
        step = out[-1] + (1 - out[-1]) * gap
        out = jnp.concatenate([out, step + (1 - step) * out])
    return out[:count]


def _over_columns(x: Float[Array, "F a lanes"]) -> Float[Array, "F lanes"]:
    """Σ_a, written out: XLA hands its own reduction to a library that costs more than the sum."""
    total = x[:, 0]
    for a in range(1, x.shape[1]):
        total = total + x[:, a]
    return total


def _over_families(x: Float[Array, "F lanes"]) -> Lanes:
    total = x[0]
    for j in range(1, x.shape[0]):
        total = total + x[j]
    return total


def decayed(x: Array) -> Array:
    """1 − e^{−x} for x ≥ 0, to a few roundings: a polynomial for x/64, doubled six times, so that it vectorises."""
    y = jnp.minimum(x, 44) / 64
    e = jnp.ones_like(y)
    for n in range(15, 1, -1):
        e = 1 - y / n * e
    e = y * e
    for _ in range(6):
        e = e * (2 - e)
    return e


def rise_far(series: Series, s: Lanes) -> tuple[Lanes, Lanes]:
    """As `rise` where (r_1/r_2)^s has vanished, and only the first column of the table is left."""
    column = jnp.concatenate([jnp.ones_like(series.rows[:1]), *(block[:, :, 0] for block in series.blocks)])
    return _rise(series, s, series.rows - column, jnp.zeros_like(column))


def rise(series: Series, s: Lanes) -> tuple[Lanes, Lanes]:
    """t(s) − 1 and t'(s); summed as what every term has lost since s = 0, so that a rise as small as b keeps its digits."""
    column_gap = _power_gaps(decayed(s * series.column_rate), 2 * ROWS + 1)
    lost, slopes = jnp.zeros_like(series.rows), jnp.zeros_like(series.rows)
    for (start, end), block in zip(BLOCKS, series.blocks, strict=True):
        gaps = column_gap[: 2 * end + 1]
        weights = jnp.asarray(np.arange(2 * end + 1, dtype=float)[:, None]) * (1 - gaps)

        def add(
            k: Array, both: Any, block: Array = block, gaps: Array = gaps, weights: Array = weights, start: int = start
        ) -> Any:
            tau = block[k - start]
            at_k = _over_columns(gaps * tau), _over_columns(weights * tau)
            return tuple(lax.dynamic_update_index_in_dim(x, y, k, 0) for x, y in zip(both, at_k, strict=True))

        lost, slopes = lax.fori_loop(start, jnp.minimum(end, series.last) + 1, add, (lost, slopes))
    return _rise(series, s, lost, slopes)


def _rise(series: Series, s: Lanes, lost: Array, slopes: Array) -> tuple[Lanes, Lanes]:
    """From each row's Σ_a τ (1 − v^a) and Σ_a a τ v^a, v = (r_1/r_2)^s, by Horner's rule in u = r_2^{2s}.

    What row k has lost is (1 − u^k) Σ_a τ + u^k Σ_a τ (1 − v^a), and (1 − u^k) sums to (1 − u) Σ_k u^k times the rows above k.
    """
    level_gap, start_gap = decayed(s * series.level_rate), decayed(s * series.rate)
    level = 1 - level_gap
    change, fall = jnp.zeros_like(series.rate), jnp.zeros_like(series.rate)
    above = jnp.zeros_like(series.rate)
    for k in range(ROWS, -1, -1):
        kept = series.rows[k] - lost[k]
        change = level * change + level_gap * above + lost[k] + start_gap * kept
        fall = level * fall + (series.rate + k * series.level_rate) * kept + series.column_rate * slopes[k]
        above = above + series.rows[k]
    weight = series.amplitude
    return -_over_families(weight * change), -_over_families(weight * (1 - start_gap) * fall)
