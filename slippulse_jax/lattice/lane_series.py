r"""The double series of many fronts at once: lanes last in every array, no half table of zeros, and each lane its own degree.

The same solution as `slippulse_jax.double_series`, written for the total stress alone,

    t(s) = Σ_j c_j Σ_ka τ^j_ka μ^s,   μ = start_j (r_2²)^k (r_1/r_2)^a,   0 ≤ a ≤ 2k,   start = ρ_1, ρ_2; 1 under prestress,

    τ_ka = [g_1 (μ − r_2) + g_2 (μ − r_1)] / [(μ − ρ_1)(μ − ρ_2)],
    g_1 = r_1 (R_11 τ_{k−1,a−2} + R_12 τ_{k−1,a−1}),   g_2 = r_2 (R_12 τ_{k−1,a−1} + R_22 τ_{k−1,a}).

Two things differ. The pole at a resonance ρ_2 r_2^{2n} = ρ_1 is left in: it costs digits only where the distance is below
a thousandth of the residue, which `Series.sound` watches over. And a lane's table ends at the first row whose moduli add up
to less than `ROW_TOLERANCE` of the first row's: rows shrink to an eighth from there on (measured; docs/exact_solution.md).
A lane that has ended gets rows of zeros, so that it never depends on its neighbours.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.slider import Slider

ROW_TOLERANCE = 5e-13
"""Moduli of a lane's last row beside those of its first."""

BLOCKS = ((1, 5), (6, 11), (12, 17))
"""First and last row k of each block of one width: compiled once each, with few zeros."""

STORED = 11
"""Rows that are looked at again at the crossing: above them nothing but row sums is left there (checked lane by lane)."""

ROWS = BLOCKS[-1][1]

Lanes = Float[Array, " lanes"]
Table = Float[Array, "F a lanes"]


class Inputs(NamedTuple):
    """What the table and its amplitudes are made of: arrays of JAX, or of NumPy in `lane_derivatives`; F families."""

    reflected: Any  # r_m R_mn, shape (2, 2, lanes)
    start_gap: Any  # 1 − start_j, shape (F, lanes)
    to_roots: Any  # start_j − ρ_i, shape (2, F, lanes)
    to_modes: Any  # start_j − r_m, shape (2, F, lanes)
    rate: Any  # −ln start_j, shape (F, lanes)
    level_rate: Any  # −2 ln r_2, shape (lanes,)
    column_rate: Any  # −ln(r_1/r_2)
    first_step: Any  # t(1) − t(0)
    plateau: Any  # stress far from the edge where nothing stops the front


class Series(NamedTuple):
    """Table and amplitudes of a chunk of lanes."""

    inputs: Inputs
    blocks: tuple[Float[Array, "rows F a lanes"], ...]  # τ; of blocks that were stored
    rows: Float[Array, "k F lanes"]  # Σ_a τ up to the last row stored
    beyond: Float[Array, "F lanes"]  # Σ_ka τ of later rows
    totals: Float[Array, "3 F lanes"]  # Σ τ, Σ τ (1 − μ), −Σ τ ln μ
    amplitude: Float[Array, "F lanes"]  # c_j
    last: Array  # the last row any lane has
    sound: Bool[Array, " lanes"]  # whether every digit is there

    def at_edge(self) -> Lanes:
        """t'(0)."""
        return -over_families(self.amplitude * self.totals[2])


def inputs_of(theta: Float[Array, "n lanes"], prestressed: bool) -> Inputs:
    """`Inputs` of lanes (H/λc, k/K, ν, φ, …); φ is not looked at unless `prestressed`."""
    modes = jax.vmap(lambda h, q, n: lattice_modes(Slider(h, q, n)), in_axes=0, out_axes=-1)(*theta[:3])
    r, w, gap = modes.ratio, modes.weight, modes.gap
    coupling, reflected = r * w, r[:, None] * modes.reflection
    diagonal = gap - coupling
    difference = diagonal[0] - diagonal[1]
    split = jnp.sqrt(difference**2 + 4 * coupling[0] * coupling[1])
    larger = (jnp.where(difference < 0, -difference, difference) + split) / 2
    smaller = coupling[0] * coupling[1] / larger
    up, down = jnp.where(difference < 0, smaller, larger), jnp.where(difference < 0, larger, smaller)
    runaway = (1 + w[0] + w[1]) / 2
    gap_1 = (diagonal[0] + diagonal[1] + split) / 2
    gap_2 = gap[0] * gap[1] * runaway / gap_1
    apart = gap[0] - gap[1]
    zero = jnp.zeros_like(split)
    # ρ_j − r_m as products of positive numbers, from (r_1 − ρ_1)(r_1 − ρ_2) = −w_1 r_1 (r_1 − r_2) and the like at r_2
    to_mode_1 = [coupling[0] * apart / (up + coupling[0]), up + coupling[0], gap[0]]
    to_mode_2 = [-coupling[1] * apart / (down + coupling[1]), down + coupling[1], gap[1]]
    to_root_1, to_root_2, start_gap = [zero, split, gap_1], [-split, zero, gap_2], [gap_1, gap_2, zero]
    rate, families = [-jnp.log1p(-gap_1), -jnp.log1p(-gap_2), zero], 3 if prestressed else 2
    stacked = [jnp.stack(x[:families]) for x in (start_gap, to_root_1, to_root_2, to_mode_1, to_mode_2, rate)]
    held = 1 - theta[3] if prestressed else 1
    mode_rate = -jnp.log1p(-gap)
    return Inputs(
        reflected=reflected,
        start_gap=stacked[0],
        to_roots=jnp.stack(stacked[1:3]),
        to_modes=jnp.stack(stacked[3:5]),
        rate=stacked[5],
        level_rate=2 * mode_rate[1],
        column_rate=mode_rate[0] - mode_rate[1],
        # (1 − φ) C is carried on, and contact 0 adds its stress, 1
        first_step=coupling.sum(0) + reflected.sum((0, 1)) - held * (gap * modes.drive).sum(0),
        plateau=theta[3] / runaway if prestressed else zero,
    )


def solve(inputs: Inputs) -> Series:
    """Table, and amplitudes from t(0) = 1 and from t(1) − t(0)."""
    table = _table(inputs)
    (A, gaps, _), plateau = table.totals, inputs.plateau
    B, known_0, known_1 = -gaps, jnp.ones_like(plateau), inputs.first_step
    prestressed = A.shape[0] > 2
    if prestressed:
        known_0, known_1 = known_0 - plateau * A[2], known_1 - plateau * B[2]
    determinant = A[0] * B[1] - A[1] * B[0]
    c1, c2 = (known_0 * B[1] - A[1] * known_1) / determinant, (A[0] * known_1 - known_0 * B[0]) / determinant
    sound = table.sound & (jnp.abs(c1) < 1e3) & (jnp.abs(c2) < 1e3)
    return table._replace(amplitude=jnp.stack([c1, c2, plateau] if prestressed else [c1, c2]), sound=sound)


def _table(inputs: Inputs) -> Series:
    """Rows until every lane has ended, or `ROWS`; no amplitudes yet."""
    families, lanes = inputs.rate.shape
    zeros, one = jnp.zeros((families, lanes)), jnp.ones((families, lanes))
    rows = jnp.zeros((STORED + 1, families, lanes)).at[0].set(1)
    totals = jnp.stack([one, inputs.start_gap, inputs.rate])
    above = jnp.zeros((families, 3, lanes)).at[:, 2].set(1)
    carry = _Progress(jnp.asarray(1), jnp.zeros(()), rows, zeros, totals, jnp.ones(lanes, bool))
    blocks = []
    for start, end in BLOCKS:
        stored = end <= STORED
        block = jnp.zeros((end - start + 1 if stored else 0, families, 2 * end + 1, lanes))
        above = jnp.zeros((families, 2 * end + 3, lanes)).at[:, : above.shape[1]].set(above)
        carry, above, block = _fill(inputs, carry, above, block, (start, end))
        blocks.append(block)
    return Series(
        inputs=inputs,
        blocks=tuple(blocks),
        rows=carry.rows,
        beyond=carry.beyond,
        totals=carry.totals,
        amplitude=zeros,
        last=carry.k - 1,
        sound=~carry.running,
    )


class _Progress(NamedTuple):
    k: Array  # the next row
    level: Array  # 1 − r_2^{2(k−1)}
    rows: Array
    beyond: Array
    totals: Array
    running: Array


def _fill(
    inputs: Inputs, carry: _Progress, above: Table, block: Array, span: tuple[int, int]
) -> tuple[_Progress, Table, Array]:
    """Rows of one block; written to `block` if it has places for them."""
    start, end = span
    first_block, stored = start == 1, block.shape[0] > 0
    columns = power_gaps(decayed(inputs.column_rate), 2 * end + 1)
    level_gap = decayed(inputs.level_rate)
    a = jnp.asarray(np.arange(2.0 * end + 1)[:, None])

    def row(state: tuple[_Progress, Table, Array]) -> tuple[_Progress, Table, Array]:
        (k, level, rows, beyond, totals, running), above, block = state
        level = level + (1 - level) * level_gap
        gap = level + (1 - level) * columns
        tau = entries(inputs, above, gap)
        tau = tau if first_block else jnp.where(running, tau, 0)
        total = over_columns(tau)
        bend = inputs.level_rate * k.astype(total.dtype) * total + inputs.column_rate * over_columns(a * tau)
        lost = over_columns(gap * tau)
        rho = 1 - inputs.start_gap
        totals = totals + jnp.stack([total, inputs.start_gap * total + rho * lost, inputs.rate * total + bend])
        if stored:
            rows = lax.dynamic_update_index_in_dim(rows, total, k, 0)
        else:
            beyond = beyond + total
        if not first_block:
            size = over_families(over_columns(jnp.abs(tau)))
            scale = jnp.minimum(over_families(jnp.abs(rows[1])), 1)
            running = running & (size > ROW_TOLERANCE * scale)
        if stored:
            block = lax.dynamic_update_index_in_dim(block, tau, k - start, 0)
        above = lax.dynamic_update_slice_in_dim(above, tau, 2, 1)
        return _Progress(k + 1, level, rows, beyond, totals, running), above, block

    def going(state: tuple[_Progress, Table, Array]) -> Array:
        return (state[0].k <= end) & state[0].running.any()

    carry = carry._replace(level=jnp.broadcast_to(carry.level, level_gap.shape))
    return lax.while_loop(going, row, (carry, above, block))


def entries(inputs: Inputs, above: Any, gap: Any) -> Any:
    """τ of one row from the row above (two columns of zeros first) and 1 − μ/start."""
    (R11, R12), (R21, R22) = inputs.reflected
    x = (1 - inputs.start_gap)[:, None] * gap
    to_1, to_2, from_1, from_2 = (y[:, None] for y in (*inputs.to_roots, *inputs.to_modes))
    g1 = R11 * above[:, :-2] + R12 * above[:, 1:-1]
    g2 = R21 * above[:, 1:-1] + R22 * above[:, 2:]
    return (g1 * (from_2 - x) + g2 * (from_1 - x)) / ((to_1 - x) * (to_2 - x))


def power_gaps(gap: Lanes, count: int) -> Float[Array, "count lanes"]:
    """1 − (1 − gap)^n, n = 0 … count − 1, as sums of positive numbers."""
    out = jnp.stack([jnp.zeros_like(gap), gap])
    while out.shape[0] < count:  # twice as many powers by one product: 1 − xy = (1 − x) + x (1 − y)
        step = out[-1] + (1 - out[-1]) * gap
        out = jnp.concatenate([out, step + (1 - step) * out])
    return out[:count]


def over_columns(x: Table) -> Float[Array, "F lanes"]:
    """Σ_a, written out: XLA hands its own reduction to a library that costs more than the sum."""
    total = x[:, 0]
    for a in range(1, x.shape[1]):
        total = total + x[:, a]
    return total


def over_families(x: Float[Array, "F lanes"]) -> Lanes:
    """Σ_j, written out."""
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
