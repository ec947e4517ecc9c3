r"""Solution of the front's recursion as a double power series.

The recursion of `slippulse_jax.front.front`, written for the two parts V_m of the stress t = φ + V_1 + V_2 ahead of the
front (φ a uniform prestress), is a linear q-difference system,

    V(s+1) = A V(s) + r w φ + Σ_mn r_m R_mn (r_m r_n)^s t(s) e_m,      A = diag(r) (1 + w 1ᵀ),

solved by sums of μ^s with μ = start · (r_2²)^k (r_1/r_2)^a, 0 ≤ a ≤ 2k. The starts are the eigenvalues ρ_1 < ρ_2 of A, and 1
where there is a prestress. For the stress alone,

    t(s) = Σ_j c_j Σ_ka τ^j_ka μ^s,    τ_ka = [g_1 (μ − r_2) + g_2 (μ − r_1)] / [(μ − ρ_1)(μ − ρ_2)],
    g_1 = r_1 (R_11 τ_{k−1,a−2} + R_12 τ_{k−1,a−1}),    g_2 = r_2 (R_21 τ_{k−1,a−1} + R_22 τ_{k−1,a}),

with amplitudes c_j from t(0) and t(1) − t(0). `docs/appendix/exact_solution.md` derives all of it.

**Lanes are last** in every array, in as many axes as the caller likes: none for one front. The table of a lane ends at the
first row k whose moduli add up to less than `ROW_TOLERANCE` of the first row's; from there on it has rows of zeros, so that a
lane never depends on its neighbours.

**Resonance.** μ may meet ρ_1: only at a = 0 (because ρ_1 > r_1), and only at the one k = n nearest to it (because the others
are a factor r_2² apart). There the series has a pole, cancelled by another in front of ρ_1's own series. The table holds that
term with the divided difference D(s) = (x^s − ρ_1^s)/(x − ρ_1), x = start · r_2^{2n}, and so has every digit everywhere; n = 0
covers coalescing roots, and the choice of n changes the rounding, not the sum.

Everything is built from the small numbers 1 − r_m, 1 − ρ_j and from decay rates −ln μ, never from r_m and ρ_j themselves:
for tall sliders these agree with 1 to eight digits. **On a line** (`slippulse_jax.exact.continuum`) differences become
derivatives: κ_m, W_m and the rates −ln μ stand for 1 − r_m, r_m w_m and 1 − μ.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.bulk.compiler import in_full

ROW_TOLERANCE = 5e-13
"""Moduli of the last row of a lane relative to those of its first; rows shrink to an eighth or less from there on."""

ROWS = 17
"""Rows of the longest table: degree 34 in r_1 and r_2."""

Lanes = Float[Array, "*lanes"]


class System(eqx.Module):
    """Numbers of which table and amplitudes are made; a family per start."""

    gap: Float[Array, "2 *lanes"]  # 1 − r_m
    coupling: Float[Array, "2 *lanes"]  # r_m w_m
    reflected: Float[Array, "2 2 *lanes"]  # r_m R_mn
    over_first: Float[Array, "2 *lanes"]  # ρ_1 − A_mm
    start_gap: Float[Array, "F *lanes"]  # 1 − start_j
    to_roots: Float[Array, "2 F *lanes"]  # start_j − ρ_i
    to_modes: Float[Array, "2 F *lanes"]  # start_j − r_m
    rate: Float[Array, "F *lanes"]  # −ln start_j
    level_rate: Lanes  # −2 ln r_2
    column_rate: Lanes  # −ln(r_1/r_2)
    at_edge: Lanes  # t(0)
    first_step: Lanes  # t(1) − t(0)
    prestress: Lanes  # φ
    plateau: Lanes  # stress far from the edge where nothing stops the front
    lattice: bool = eqx.field(static=True)

    @property
    def weight(self) -> Float[Array, "2 *lanes"]:
        """Response w_m; on a line W_m."""
        return self.coupling / (1 - self.gap) if self.lattice else self.coupling

    @property
    def reflection(self) -> Float[Array, "2 2 *lanes"]:
        """Reflection R_mn at the edge."""
        return self.reflected / (1 - self.gap)[:, None] if self.lattice else self.reflected

    @property
    def mode_rate(self) -> Float[Array, "2 *lanes"]:
        """Decay rates −ln r_m."""
        half = self.level_rate / 2
        return jnp.stack([self.column_rate + half, half])


class Series(NamedTuple):
    """Table and amplitudes of the solution, of every lane."""

    system: System
    table: Float[Array, "k F a *lanes"]  # τ
    rows: Float[Array, "k F *lanes"]  # Σ_a τ
    amplitude: Float[Array, "F *lanes"]  # c_j
    echo: Float[Array, "F *lanes"]  # κ_j, with which D(s) times ρ_1's series is part of family j
    echo_rate: Float[Array, "F *lanes"]  # −ln x_j


def system_of(
    gap: Array, coupling: Array, reflected: Array, start: Array, prestress: Array | None = None, runaway: Array | None = None
) -> System:
    """Roots of A, their distances, and the front's first step.

    From 1 − r_m, r_m w_m and r_m R_mn, lanes last (on a line κ_m, W_m, R_mn), V(0), φ and φ_c = (1 + G_00)/2, the run-away
    prestress. Without φ the family of terms that it would add is left out; without φ_c it is a line, whose φ_c is 1/2.

    The smaller 1 − ρ_2 comes from the product (1 − ρ_1)(1 − ρ_2) = γ_1 γ_2 φ_c, and ρ_j − r_m as products of positive
    numbers from (r_1 − ρ_1)(r_1 − ρ_2) = −w_1 r_1 (r_1 − r_2) and the like at r_2.
    """
    lattice = runaway is not None
    diagonal = gap - coupling  # 1 − A_mm, at least half of 1 − r_m
    difference = diagonal[0] - diagonal[1]
    split = jnp.sqrt(difference**2 + 4 * coupling[0] * coupling[1])
    larger = (jnp.where(difference < 0, -difference, difference) + split) / 2
    smaller = coupling[0] * coupling[1] / larger
    up, down = jnp.where(difference < 0, smaller, larger), jnp.where(difference < 0, larger, smaller)
    critical = jnp.full_like(split, 0.5) if runaway is None else runaway
    gap_1 = (diagonal[0] + diagonal[1] + split) / 2
    gap_2 = gap[0] * gap[1] * critical / gap_1
    apart, zero = gap[0] - gap[1], jnp.zeros_like(split)
    to_mode_1 = [coupling[0] * apart / (up + coupling[0]), up + coupling[0], gap[0]]
    to_mode_2 = [-coupling[1] * apart / (down + coupling[1]), down + coupling[1], gap[1]]
    to_root_1, to_root_2, start_gap = [zero, split, gap_1], [-split, zero, gap_2], [gap_1, gap_2, zero]
    families = 2 if prestress is None else 3
    start_gaps, root_1, root_2, mode_1, mode_2 = (
        jnp.stack(x[:families]) for x in (start_gap, to_root_1, to_root_2, to_mode_1, to_mode_2)
    )
    mode_rate, rate = (-jnp.log1p(-gap), -jnp.log1p(-start_gaps)) if lattice else (gap, start_gaps)
    phi = zero if prestress is None else prestress
    at_edge = start[0] + start[1] + phi if not lattice else jnp.ones_like(split)
    return System(
        gap=gap,
        coupling=coupling,
        reflected=reflected,
        over_first=jnp.stack([-down, -up]),
        start_gap=start_gaps,
        to_roots=jnp.stack([root_1, root_2]),
        to_modes=jnp.stack([mode_1, mode_2]),
        rate=rate,
        level_rate=2 * mode_rate[1],
        column_rate=mode_rate[0] - mode_rate[1],
        at_edge=at_edge,
        first_step=(coupling.sum(0) + reflected.sum((0, 1))) * at_edge - (gap * start).sum(0),
        prestress=phi,
        plateau=phi / critical,
        lattice=lattice,
    )


def solve(system: System) -> Series:
    """Table, and the amplitudes that give t(0) and t(1) − t(0)."""
    found, plateau = _table(system), system.plateau
    A, gaps = found.rows.sum(0), found.gaps
    # D(0) = 0 and D(1) = 1; on a line D'(0) = 1
    once = (A[0] - gaps[0]) / (1 - system.start_gap[0]) if system.lattice else A[0]
    B = found.echo * once[None] - gaps
    known_0, known_1 = system.at_edge, system.first_step
    prestressed = A.shape[0] > 2
    if prestressed:
        known_0, known_1 = known_0 - plateau * A[2], known_1 - plateau * B[2]
    determinant = A[0] * B[1] - A[1] * B[0]
    c1, c2 = (known_0 * B[1] - A[1] * known_1) / determinant, (A[0] * known_1 - known_0 * B[0]) / determinant
    amplitude = jnp.stack([c1, c2, plateau] if prestressed else [c1, c2])
    return Series(
        system, found.table, found.rows, amplitude, found.echo, system.rate + _resonance(system) * system.level_rate[None]
    )


class _Progress(NamedTuple):
    k: Array  # the next row
    above: Array  # the row before, behind two columns of zeros
    table: Array
    rows: Array
    gaps: Array  # Σ τ (1 − μ)
    running: Array
    fed: Array  # r_1^a r_2^b V_ab of ρ_1's series, shape (k, 2, a, *lanes)
    echo: Array


def _resonance(system: System) -> Float[Array, "F *lanes"]:
    """Nearest resonance n of every family.

    Of the prestress's it is never 0, of ρ_1's own always.
    """
    distance = (system.rate[:1] - system.rate) / system.level_rate[None]
    least = np.arange(len(system.rate)) == 2
    return jnp.maximum(jnp.round(distance), jnp.asarray(_column(least, distance.ndim - 1), distance.dtype))


def _table(system: System) -> _Progress:
    """Fill rows until every lane has ended, `ROWS` at most."""
    families, *lanes = system.rate.shape
    one, width, resonance = jnp.ones_like(system.rate), 2 * ROWS + 1, _resonance(system)
    start = _Progress(
        k=jnp.asarray(1),
        above=jnp.zeros((families, width + 2, *lanes), one.dtype).at[:, 2].set(1),
        table=jnp.zeros((ROWS + 1, families, width, *lanes), one.dtype).at[0, :, 0].set(1),
        rows=jnp.zeros((ROWS + 1, families, *lanes), one.dtype).at[0].set(1),
        gaps=system.start_gap,
        running=jnp.ones(lanes, bool),
        fed=jnp.zeros((ROWS + 1, 2, width, *lanes), one.dtype),
        echo=jnp.where(resonance == 0, system.to_modes[0, :1], 0).at[0].set(0),
    )
    columns, levels = _gaps(system, system.column_rate, width), _gaps(system, system.level_rate, ROWS + 1)
    rho = 1 - system.start_gap if system.lattice else one

    def row(now: _Progress) -> _Progress:
        k, level = now.k, lax.dynamic_slice_in_dim(levels, now.k, 1)
        gap = level + (1 - level) * columns if system.lattice else level + columns
        tau, fed, echo = _entries(system, now.above, gap, rho, resonance, (k, now.fed, now.echo))
        tau = jnp.where(now.running[None, None], tau, 0)
        total = tau.sum(1)
        rows = lax.dynamic_update_index_in_dim(now.rows, total, k, 0)
        size, scale = jnp.abs(tau).sum((0, 1)), jnp.minimum(jnp.abs(rows[1]).sum(0), 1)
        return _Progress(
            k + 1,
            lax.dynamic_update_slice_in_dim(now.above, tau, 2, 1),
            lax.dynamic_update_index_in_dim(now.table, tau, k, 0),
            rows,
            now.gaps + system.start_gap * total + rho * (gap[None] * tau).sum(1),
            now.running & (size > ROW_TOLERANCE * scale),
            fed,
            echo,
        )

    return lax.while_loop(lambda now: (now.k <= ROWS) & now.running.any(), row, start)


def _gaps(system: System, rate: Lanes, count: int) -> Float[Array, "count *lanes"]:
    """Gaps 1 − e^{−n rate}, n < `count`.

    On a line n rate.
    """
    if system.lattice:
        return power_gaps(decayed(rate), count)
    return jnp.asarray(_column(np.arange(float(count)), rate.ndim), rate.dtype) * rate[None]


def _sources(system: System, above: Array) -> tuple[Array, Array]:
    """Sources g_m of one row, from the row above.

    That has two columns of zeros first.
    """
    (R11, R12), (R21, R22) = system.reflected[:, :, None, None]
    two, one, zero = above[:, :-2], above[:, 1:-1], above[:, 2:]
    return R11 * two + R12 * one, R21 * one + R22 * zero


def _entries(
    system: System, above: Array, gap: Array, rho: Array, resonance: Array, state: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Compute τ of one row, ρ_1's series with it added, and κ.

    Beyond the resonance the families of ρ_2 and of the prestress obey (μ − A) V_ka = g_ka − κ p V¹_{k−n,a} with
    p = (r_2²)^{k−n} (r_1/r_2)^a, where V¹ is ρ_1's series in units of V¹_00 = (r_1 w_1, ρ_1 − A_11), whose stress is ρ_1 − r_1.
    At the resonance V = (0, κ), κ = g_2/(x − ρ_2). D(s + 1) = ρ_1 D(s) + x^s; on a line D' = −σ_1 D + e^{−xs}. What is kept is
    κ (ρ_1 − r_1), for a series in units of its own stress.
    """
    k, fed, echo = state
    to_1, to_2, from_1, from_2 = (y[:, None] for y in (*system.to_roots, *system.to_modes))
    x = rho[:, None] * gap[None]
    g1, g2 = _sources(system, above)
    # ρ_1's series by components
    determinant = (to_1[0] - x[0]) * (to_2[0] - x[0])
    over_1, over_2 = system.over_first[:, None] - x[0][None]
    c = system.coupling[:, None]
    own = jnp.stack([over_2 * g1[0] + c[0] * g2[0], c[1] * g1[0] + over_1 * g2[0]]) / determinant[None]
    width = own.shape[1]
    fed = lax.dynamic_update_index_in_dim(fed, (1 - gap if system.lattice else jnp.ones_like(gap))[None] * own, k, 0)
    tau = [own[0] + own[1]]
    found = [echo[0]]
    first = jnp.asarray(_column(np.arange(width) == 0, gap.ndim - 1))
    for j in range(1, rho.shape[0]):
        back = k - resonance[j].astype(jnp.int32)
        shifted = jnp.where(
            (back > 0)[None, None], jnp.take_along_axis(fed, jnp.clip(back, 0, ROWS)[None, None, None], 0)[0], 0
        )
        kappa = jnp.where(back == 0, system.to_modes[0, 0] * g2[j, 0] / (to_2[j, 0] - x[j, 0]), echo[j])
        h1, h2 = g1[j] - kappa[None] * shifted[0], g2[j] - kappa[None] * shifted[1]
        here = (back == 0)[None] & first
        distance = jnp.where(here, 1, to_1[j] - x[j])
        numerator = jnp.where(here, g2[j], h1 * (from_2[j] - x[j]) + h2 * (from_1[j] - x[j]))
        tau.append(numerator / (distance * (to_2[j] - x[j])))
        found.append(kappa)
    return jnp.stack(tau), fed, jnp.stack(found)


def _sums(series: Series, s: Lanes) -> tuple[Array, Array, Array]:
    """Sum each family at s: what is lost, left, and bends.

    These are Σ τ (1 − p^s), Σ τ p^s and −Σ τ p^s ln p, p = μ/start. By Horner's rule in u = r_2^{2s}: what row k has lost is
    (1 − u^k) Σ_a τ + u^k Σ_a τ (1 − v^a), v = (r_1/r_2)^s, and (1 − u^k) sums to (1 − u) Σ_k u^k times the rows above k.
    """
    system, width = series.system, series.table.shape[2]
    rate, columns = system.column_rate[None], power_gaps(decayed(s * system.column_rate), width)
    a = jnp.asarray(_column(np.arange(float(width)), s.ndim), columns.dtype)
    zero = jnp.zeros_like(system.rate)
    weights = columns[None], (a * rate * (1 - columns))[None]
    lost, bent = ((w[None] * series.table).sum(2) for w in weights)
    level_gap = decayed(s * system.level_rate)
    level, level_gap = (1 - level_gap)[None], level_gap[None]

    def add(carried: Any, row: Any) -> Any:
        missing, left, fall, above = carried
        k, rows, lost, bent = row
        missing = level * missing + level_gap * above + lost
        left = level * left + rows - lost
        fall = level * fall + (k * system.level_rate)[None] * (rows - lost) + bent
        return (missing, left, fall, above + rows), None

    # a loop takes less time to compile: minutes less in second derivatives
    every = (jnp.arange(ROWS + 1, dtype=zero.dtype), series.rows, lost, bent)
    missing, left, fall, _ = lax.scan(add, (zero,) * 4, every, reverse=True)[0]
    return missing, left, fall


def rise(series: Series, s: Lanes) -> tuple[Lanes, Lanes]:
    """Rise t(s) − t(0) of the front stress, and t'(s).

    Summed as what every term has lost since s = 0: soft interfaces lift t by as little as b, which t − 1 would lose.
    """
    c, rate = series.amplitude, series.system.rate
    missing, left, bent = _sums(series, s)
    gone = decayed(s[None] * rate)
    lost, slope = missing + gone * left, (1 - gone) * (rate * left + bent)
    D, D_slope = _difference(series, s)
    weight = c * series.echo
    lost = (c * lost).sum(0) - (weight * D).sum(0) * left[0]
    slope = (c * slope).sum(0) - (weight * D_slope).sum(0) * left[0] + (weight * D).sum(0) * bent[0]
    return -lost, -slope


def stress(series: Series, s: Lanes) -> tuple[Lanes, Lanes]:
    """Stress t(s) at the front, in σ_s, and t'(s).

    On contact s when all before it have broken. Every digit at any s ≥ 0, however far beyond the crossing.
    """
    c, rate = series.amplitude, series.system.rate
    _, left, bent = _sums(series, s)
    power = jnp.exp(-s[None] * rate)
    value, slope = (c * power * left).sum(0), (c * power * (rate * left + bent)).sum(0)
    D, D_slope = _difference(series, s)
    weight = c * series.echo
    value = value + (weight * D).sum(0) * left[0]
    return value, (weight * D_slope).sum(0) * left[0] - (weight * D).sum(0) * bent[0] - slope


def parts(series: Series, s: Lanes) -> Float[Array, "2 *lanes"]:
    """Parts V_1(s), V_2(s) of the stress in the two modes.

    From the stress and its next step (on a line its slope): two linear equations.
    """
    system = series.system
    t, slope = stress(series, s)
    step = stress(series, s + 1)[0] - t if system.lattice else slope
    power = jnp.exp(-s[None] * system.mode_rate)
    returned = (power * (system.reflected * power[None]).sum(1)).sum(0)
    fall = (system.coupling.sum(0) + returned) * t - step  # Σ (1 − r_m) V_m
    (gap_1, gap_2), free = system.gap, t - system.prestress
    return jnp.stack([fall - gap_2 * free, gap_1 * free - fall]) / (gap_1 - gap_2)[None]


def stress_sums(series: Series, low: Lanes, high: Lanes) -> Float[Array, "2 *lanes"]:
    """Sum r_m^{j − low} t(j) over low ≤ j < high.

    Term by term, for whole `low` ≤ `high`; on a line the integral.
    """
    system, span = series.system, high - low
    k, a = (_column(np.arange(n, dtype=low.dtype), low.ndim) for n in (series.table.shape[0], series.table.shape[2]))
    rate = (k[:, None] * system.level_rate[None, None] + a[None] * system.column_rate[None, None])[None, None]
    begin, length = low[None, None, None, None], span[None, None, None, None]
    modes = system.mode_rate[:, None, None, None]

    def of_families(x: Array) -> Array:
        """Axes for the modes, the table's rows and columns."""
        return x[None, :, None, None]

    def over(every: Array) -> Array:
        """Divisor 1 − e^{−rate} of geometric series; on lines the rate."""
        return -jnp.expm1(-every) if system.lattice else every

    def summed(start: Array) -> Array:
        """Sum of μ^j r_m^{j − low}, μ = e^{−start − rate}."""
        every = start + rate + modes
        return -jnp.exp(-begin * (start + rate)) * jnp.expm1(-length * every) / over(every)

    total = (summed(of_families(system.rate)) * jnp.swapaxes(series.table, 0, 1)[None]).sum((2, 3))
    # D(j) is a divided difference in μ, and so is its sum: (FG)[x,y] = F[x,y] G(y) + F(x) G[x,y]
    D_low, D_high = (of_families(_difference(series, s)[0]) for s in (low, high))
    difference = jnp.exp(-rate * begin) * (D_low - jnp.exp(-length * (rate + modes)) * D_high)
    power = jnp.exp(-rate - modes) if system.lattice else 1
    both = (difference + summed(of_families(series.echo_rate)) * power) / over(of_families(system.rate[:1]) + rate + modes)
    total = total + series.echo[None] * (both * series.table[None, None, :, 0]).sum((2, 3))  # ρ_1's own family has κ = 0
    return (series.amplitude[None] * total).sum(1)


@in_full
def fields(series: Series, s: Array, x: Array, initial: Array | None = None) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Layer's displacement in the two modes and stress, at x.

    With the front at s; scalars. Ahead of the front V_m(s) decays. Behind it contacts were repinned at zero stretch, and later
    breaks loaded them by

        Σ_m w_m X_m + Σ_mn R_mn (r_m r_n)^x X_n,     X_m = Σ_{x≤j<s} r_m^{j−x} t(j),

    and on a line the integral. `initial` is V_m at s = 0 where the series begins only once contact 0 has broken.
    """
    rate, behind = series.system.mode_rate, x < s
    at, beyond = jnp.where(behind, x, s), jnp.where(behind, 0, x - s)  # not min and max: one-sided derivatives at x = s
    front = parts(series, at)
    if initial is not None:
        front = jnp.where(s == 0, initial, front)
    later, decay = stress_sums(series, at, s), jnp.exp(-x * rate)
    back = series.system.weight * later + decay * (series.system.reflection @ (decay * later))
    mode = jnp.exp(-beyond * rate) * front + back
    return mode, jnp.where(behind, back.sum(), series.system.prestress + mode.sum())


def edge_stress(series: Series, broken: Lanes) -> Lanes:
    """Stress on contact 0 once `broken` contacts have broken in turn.

    In σ_s. Every break adds to it, so that the stress at the arrest is the largest on the way.
    """
    reached = series.system.weight + series.system.reflection.sum(0)
    return (reached * stress_sums(series, jnp.zeros_like(broken), broken)).sum(0)


def whole_contacts(length: Lanes) -> Lanes:
    """Contacts broken by a front that arrests at `length`."""
    return jnp.maximum(jnp.ceil(length), 1)


def _difference(series: Series, s: Lanes) -> tuple[Array, Array]:
    """Divided difference D(s) of every family, and D'(s).

    On a line (e^{−xs} − e^{−ys})/(y − x) in the rates themselves.
    """
    x, y, at = series.echo_rate, series.system.rate[:1], s[None]
    D = divided_difference(x, y, at) if series.system.lattice else overlap(x, y, at)
    if not series.system.lattice:
        return D, jnp.exp(-x * at) - y * D
    # D' = (y^s y − x^s x)/(e^{−x} − e^{−y}) = −y D + x^s (y − x)/(e^{−x} − e^{−y})
    slower, distance = _slower(x, y)
    return D, jnp.exp(slower - x * at) / _relaxation(distance) - y * D


def _slower(x: Array, y: Array) -> tuple[Array, Array]:
    """The smaller of two rates, and their distance."""
    gap = y - x
    return jnp.where(gap >= 0, x, y), jnp.where(gap >= 0, gap, -gap)


def overlap(x_rate: Array, y_rate: Array, s: Array) -> Array:
    """Overlap (e^{−xs} − e^{−zs})/(z − x) of two decays.

    ∫_0^s e^{−x(s−y) − zy} dy for rates x, z; regular, with all its derivatives, at x = z.
    """
    slower, distance = _slower(x_rate, y_rate)
    return jnp.exp(-slower * s) * s * _relaxation(s * distance)


def exponential_terms(x: Array) -> Float[Array, "20"]:
    """Terms xⁿ/n! of e^x for |x| ≤ 1/4.

    The first one left out is below (1/4)²⁰/20! = 4e-31.
    """
    return jnp.concatenate([jnp.ones_like(x)[None], jnp.cumprod(x / np.arange(1.0, 20).astype(x.dtype))])


def divided_difference(x_rate: Array, y_rate: Array, s: Array) -> Array:
    """Divided difference D(s) = (x^s − y^s)/(x − y).

    From the rates −ln x, −ln y; regular, with all its derivatives, at x = y.
    """
    slower, distance = _slower(x_rate, y_rate)
    return jnp.exp(-slower * (s - 1)) * s * _relaxation(s * distance) / _relaxation(distance)


def _relaxation(z: Array) -> Array:
    """Relaxation (1 − e^{−z})/z, regular at 0."""
    return _moment(0, z)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _moment(n: int, z: Array) -> Array:
    """Moment ∫_0^1 y^n e^{−zy} dy; its derivative is minus the next one.

    By its Taylor series near 0, where the quotient cancels.
    """
    small = (z < 1) & (z > -1)
    z0, z1 = jnp.where(small, z, 0), jnp.where(small, 1, z)
    series = jnp.ones_like(z)
    for k in range(18, 0, -1):
        series = 1 - z0 / (k * (k + n + 1) / (k + n)) * series
    direct = -jnp.expm1(-z1) / z1
    for k in range(1, n + 1):
        direct = (k * direct - jnp.exp(-z1)) / z1
    return jnp.where(small, series / (n + 1), direct)


@_moment.defjvp
def _moment_moves(n: int, at: tuple[Array], way: tuple[Array]) -> tuple[Array, Array]:
    return _moment(n, at[0]), -_moment(n + 1, at[0]) * way[0]


def _column(x: np.ndarray, lanes: int) -> np.ndarray:
    """Numbers along the axis before `lanes` others."""
    return x.reshape(-1, *[1] * lanes)


# Derivatives of the following two are simpler than the steps that lead to the values. Given them, programs for second
# derivatives compile in a quarter of the time.


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def power_gaps(gap: Lanes, count: int) -> Float[Array, "count *lanes"]:
    """Gaps of powers, 1 − (1 − gap)^n, below n = `count`.

    As sums of positive numbers.
    """
    out = jnp.stack([jnp.zeros_like(gap), gap])
    while out.shape[0] < count:  # twice as many powers by one product: 1 − xy = (1 − x) + x (1 − y)
        step = out[-1] + (1 - out[-1]) * gap
        out = jnp.concatenate([out, step[None] + (1 - step)[None] * out])
    return out[:count]


@power_gaps.defjvp
def _power_gaps_move(count: int, at: tuple[Array], way: tuple[Array]) -> tuple[Array, Array]:
    gaps = power_gaps(at[0], count)
    n = jnp.asarray(_column(np.arange(1.0, count), way[0].ndim), gaps.dtype)
    slope = jnp.concatenate([jnp.zeros_like(gaps[:1]), n * (1 - gaps[:-1])])
    return gaps, slope * way[0][None]


@jax.custom_jvp
def decayed(x: Array) -> Array:
    """Decayed part 1 − e^{−x}, x ≥ 0.

    To a few roundings: a polynomial for x/64, doubled six times, so that it vectorises.
    """
    y = jnp.minimum(x, 44) / 64
    e = jnp.ones_like(y)
    for n in range(15, 1, -1):
        e = 1 - y / n * e
    e = y * e
    for _ in range(6):
        e = e * (2 - e)
    return e


@decayed.defjvp
def _decayed_moves(at: tuple[Array], way: tuple[Array]) -> tuple[Array, Array]:
    gone = decayed(at[0])
    return gone, (1 - gone) * way[0]
