"""The solution of the front's recursion, as a double power series: its coefficients, and its sums at any real s.

The recursion of `slippulse_jax.lattice.front`, written for the two parts V_m of the stress t = φ + V_1 + V_2 ahead of the
front (φ a uniform prestress), is a linear q-difference system,

    V(s+1) = A V(s) + r w φ + Σ_mn r_m R_mn (r_m r_n)^s t(s) e_m,      A = diag(r) (1 + w 1ᵀ),     V(0) = (1 − φ) C,

solved by sums of μ^s with μ = start · r_1^a r_2^b, a + b even. Inserting a term at μ asks for (μ − A) V_ab = g_ab, the
reflection of the terms two degrees below; the starts are the eigenvalues ρ_1 < ρ_2 of A, and 1 for the prestress.
`docs/exact_solution.md` derives all that follows.

**Resonance.** μ may meet the eigenvalue ρ_1: only at a = 0 (because ρ_1 > r_1), and only at the one b = 2n nearest to it
(because the others are a factor r_2² apart). There the plain series has a pole, cancelled by another in front of ρ_1^s.
So that term is written with the divided difference D(s) = (x^s − ρ_1^s)/(x − ρ_1), x = start · r_2^{2n}, which is regular:
n = 0 covers coalescing roots. The choice of n does not change the sum, only the rounding.

**Layout.** Terms are held as k = (a + b)/2 by a, since r_1^a r_2^b = (r_2²)^k (r_1/r_2)^a; entries with a > 2k are zero.

Everything is built from the small numbers 1 − r_m, 1 − ρ_j and from decay rates −ln μ, never from r_m and ρ_j themselves:
for tall sliders these agree with 1 to eight digits.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

DEGREE = 28
"""Largest a + b kept: what is left out is below 1e-12 (measured; docs/exact_solution.md), largest at s = 0."""

Pair = tuple[Array, Array]  # V_1, V_2
Terms = Float[Array, "k a"]


class Roots(eqx.Module):
    """A = diag(r)(1 + w 1ᵀ), its eigenvalues, and their differences as sums of positive numbers."""

    rate: Float[Array, "2"]  # λ_m = −ln r_m
    reflected: Float[Array, "2 2"]  # r_m R_mn
    coupling: Float[Array, "2"]  # r_m w_m
    gap: Float[Array, "2"]  # 1 − ρ_j
    root_rate: Float[Array, "2"]  # σ_j = −ln ρ_j
    split: Float[Array, ""]  # ρ_2 − ρ_1
    over_first: Float[Array, "2"]  # ρ_j − A_11
    over_second: Float[Array, "2"]  # ρ_j − A_22
    runaway: Float[Array, ""]  # (1 + G_00)/2
    # False: the same on a line, where κ_m, σ_j and W_m stand for 1 − r_m, 1 − ρ_j and r_m w_m
    lattice: bool = eqx.field(static=True, default=True)


class Family(NamedTuple):
    """One start of the series: Σ_ab terms e^{−(start + aλ_1 + bλ_2)s}, and its share κ D(s) of ρ_1's series."""

    start: Array  # −ln of the start
    terms: tuple[Terms, Terms]  # V_ab
    kappa: Array
    resonant: Array  # −ln x


class Solution(NamedTuple):
    """t(s) = φ + [c_1 ρ_1^s + Σ κ D(s)] · (first series) + Σ over `others`, whose c_2 is inside."""

    roots: Roots
    prestress: Array
    c1: Array
    first: tuple[Terms, Terms]
    others: tuple[Family, ...]


def solve(roots: Roots, drive: Pair, prestress: Array | None = None, degree: int = DEGREE) -> Solution:
    """Coefficients of the front stress with V(0) = (1 − φ) `drive`; `prestress` None saves the family it would add."""
    zero, one = jnp.zeros_like(roots.split), jnp.ones_like(roots.split)
    eigenvector_1, eigenvector_2 = ((roots.coupling[0], roots.over_first[j]) for j in (0, 1))
    gaps = _power_gaps(roots, degree)
    first = _terms(roots, gaps, 0, eigenvector_1, zero)
    # the nearest resonance; n = 0 starts ρ_2's series from the second unit vector, as A^s itself does
    n = jnp.round((roots.root_rate[0] - roots.root_rate[1]) / (2 * roots.rate[1]))
    start_2 = (jnp.where(n == 0, zero, eigenvector_2[0]), jnp.where(n == 0, one, eigenvector_2[1]))
    second = _family(roots, gaps, 1, start_2, zero, n, first)
    phi, others = zero, ()
    if prestress is not None:
        # (1 − A) V_00 = r w φ, then as for the others; its resonances are at r_2^{2n} = ρ_1, never with n = 0
        phi = prestress
        pushed = _resolve(roots, roots.gap[1], roots.gap[0], (roots.coupling[0] * phi, roots.coupling[1] * phi))
        n = jnp.maximum(jnp.round(roots.root_rate[0] / (2 * roots.rate[1])), 1)
        third = _family(roots, gaps, 2, pushed, phi, n, first)
        drive = ((1 - phi) * drive[0] - third.terms[0].sum(), (1 - phi) * drive[1] - third.terms[1].sum())
        others = (third,)
    (a1, a2), (b1, b2), (d1, d2) = (x.sum() for x in first), (x.sum() for x in second.terms), drive
    determinant = a1 * b2 - a2 * b1
    c1, c2 = (d1 * b2 - d2 * b1) / determinant, (a1 * d2 - a2 * d1) / determinant
    second = second._replace(terms=(c2 * second.terms[0], c2 * second.terms[1]), kappa=c2 * second.kappa)
    return Solution(roots, phi, c1, first, (second, *others))


def roots_of(gap: Array, coupling: Array, reflected: Array, weight: Array | None = None) -> Roots:
    """Eigenvalues of A, from γ_m = 1 − r_m, r_m w_m, r_m R_mn and w_m.

    The smaller 1 − ρ_2 comes from the product (1 − ρ_1)(1 − ρ_2) = γ_1 γ_2 (1 + G_00)/2. Without `weight`, the line:
    A = −diag(κ) + W 1ᵀ from κ_m, W_m and R_mn, with static responses 2W_m/κ_m that add up to 1.
    """
    lattice = weight is not None
    diagonal = gap - coupling  # at least γ_m/2
    difference = diagonal[0] - diagonal[1]  # A_22 − A_11
    split = jnp.sqrt(difference**2 + 4 * coupling[0] * coupling[1])
    larger = (jnp.where(difference < 0, -difference, difference) + split) / 2
    smaller = coupling[0] * coupling[1] / larger
    up, down = jnp.where(difference < 0, smaller, larger), jnp.where(difference < 0, larger, smaller)
    runaway = (1 + weight[0] + weight[1]) / 2 if weight is not None else jnp.full_like(split, 0.5)
    gap_1 = (diagonal[0] + diagonal[1] + split) / 2
    gaps = jnp.stack([gap_1, gap[0] * gap[1] * runaway / gap_1])
    return Roots(
        rate=-jnp.log1p(-gap) if lattice else gap,
        reflected=reflected,
        coupling=coupling,
        gap=gaps,
        root_rate=-jnp.log1p(-gaps) if lattice else gaps,
        split=split,
        over_first=jnp.stack([-down, up]),
        over_second=jnp.stack([-up, down]),
        runaway=runaway,
        lattice=lattice,
    )


def _power_gaps(roots: Roots, degree: int) -> Terms:
    """1 − r_1^a r_2^b as a sum of positive numbers: (1 − r_2^{2k}) + r_2^{2k} (1 − (r_1/r_2)^a)."""
    half = degree // 2
    if not roots.lattice:
        k, a = np.arange(half + 1)[:, None], np.arange(degree + 1)[None]
        return 2 * roots.rate[1] * k + (roots.rate[0] - roots.rate[1]) * a
    level = -2 * roots.rate[1] * np.arange(half + 1)
    a = -(roots.rate[0] - roots.rate[1]) * np.arange(degree + 1)
    return -jnp.expm1(level)[:, None] - jnp.exp(level)[:, None] * jnp.expm1(a)[None]


def _distances(roots: Roots, gaps: Array, start: int) -> tuple[Array, Array]:
    """μ − ρ_1 and μ − ρ_2, both up to sign positive but for the resonances, for μ = (ρ_1, ρ_2, 1)[start] · (1 − gaps)."""
    root = 1 - roots.gap if roots.lattice else jnp.ones_like(roots.gap)
    if start == 0:
        over_1 = -root[0] * gaps
        return over_1, over_1 - roots.split
    if start == 1:
        over_2 = -root[1] * gaps
        return over_2 + roots.split, over_2
    return roots.gap[0] - gaps, roots.gap[1] - gaps


def _resolve(roots: Roots, over_2: Array, over_1: Array, g: Pair, regular: Array | None = None) -> Pair:
    """(μ − A)⁻¹ g; where not `regular`, something finite of no meaning."""
    determinant = over_1 * over_2 if regular is None else jnp.where(regular, over_1 * over_2, 1)
    over_first, over_second = over_2 + roots.over_first[1], over_2 + roots.over_second[1]
    return (
        (over_second * g[0] + roots.coupling[0] * g[1]) / determinant,
        (roots.coupling[1] * g[0] + over_first * g[1]) / determinant,
    )


def _reflect(roots: Roots, stress: Float[Array, " a"]) -> Pair:
    """g_ab = Σ_mn r_m R_mn t_{(a,b) − e_m − e_n} e_m, from the degree below."""
    (R11, R12), (R21, R22) = roots.reflected
    one, two = (jnp.pad(stress[:-j], (j, 0)) for j in (1, 2))
    return R11 * two + R12 * one, R21 * one + R22 * stress


def _terms(
    roots: Roots, gaps: Terms, start: int, vector: Pair, constant: Array, n: Array | None = None, echo: Any = None
) -> Any:
    """V_ab of one start, degree by degree; `constant` is what t has beside V_1 + V_2 at degree 0.

    With `n` and `echo` (ρ_1's series from degree 2n on, times its power) also κ, the amplitude at the resonance (0, 2n).
    """
    width = gaps.shape[-1]
    at_0 = tuple(jnp.zeros(width, gaps.dtype).at[0].set(v) for v in vector)
    first_column = np.arange(width) == 0

    def raise_degree(carry: Any, level: Any) -> Any:
        stress, kappa = carry
        k, gap, fed = level
        g = _reflect(roots, stress)
        over_1, over_2 = _distances(roots, gap, start)
        if n is None:
            v = _resolve(roots, over_2, over_1, g)
            return (v[0] + v[1], kappa), v
        here = (k == n) & first_column
        amplitude = g[1][0] / over_2[0]
        kappa = jnp.where(k == n, amplitude, kappa)
        v = _resolve(roots, over_2, over_1, (g[0] - kappa * fed[0], g[1] - kappa * fed[1]), ~here)
        v = jnp.where(here, 0, v[0]), jnp.where(here, amplitude, v[1])
        return (v[0] + v[1], kappa), v

    kappa = jnp.zeros_like(constant) if n is None else jnp.where(n == 0, jnp.ones_like(constant), 0)
    seen = (at_0[0] + at_0[1]).at[0].add(constant)
    k = np.arange(1, gaps.shape[0])
    fed = (gaps[1:],) * 2 if echo is None else (echo[0][1:], echo[1][1:])
    (_, kappa), levels = lax.scan(raise_degree, (seen, kappa), (jnp.asarray(k, gaps.dtype), gaps[1:], fed))
    terms = tuple(jnp.concatenate([x[None], y]) for x, y in zip(at_0, levels, strict=True))
    return terms if n is None else (terms, kappa)


def _family(
    roots: Roots, gaps: Terms, start: int, vector: Pair, constant: Array, n: Array, first: tuple[Terms, Terms]
) -> Family:
    """Series of ρ_2 or of the prestress: ρ_1's feeds into it from degree 2n + 2 on, as D(s + 1) = ρ_1 D(s) + x^s."""
    depth = gaps.shape[0]
    shift = jnp.clip(n, 0, depth).astype(jnp.int32)
    echo = []
    for x in first:
        fed = ((1 - gaps) * x if roots.lattice else x).at[0].set(0)
        echo.append(lax.dynamic_slice_in_dim(jnp.pad(fed, ((depth, 0), (0, 0))), depth - shift, depth))
    terms, kappa = _terms(roots, gaps, start, vector, constant, n, echo)
    rate = jnp.stack([roots.root_rate[0], roots.root_rate[1], jnp.zeros_like(constant)])[start]
    return Family(rate, terms, kappa, rate + 2 * n * roots.rate[1])


def _powers(roots: Roots, s: Array, shape: tuple[int, ...]) -> tuple[Array, Array, Array, Array]:
    """(r_2²)^{ks} and (r_1/r_2)^{as}, and their decay rates."""
    k_rate = 2 * roots.rate[1] * np.arange(shape[0])
    a_rate = (roots.rate[0] - roots.rate[1]) * np.arange(shape[1])
    return jnp.exp(-s * k_rate), jnp.exp(-s * a_rate), k_rate, a_rate


def parts(solution: Solution, s: Array) -> Float[Array, "2"]:
    """V_1(s), V_2(s) at real s ≥ 0."""
    level, column, _, _ = _powers(solution.roots, s, solution.first[0].shape)
    both = []
    for m in (0, 1):
        total = _of_first(solution, s) * (level @ (solution.first[m] @ column))
        for family in solution.others:
            total = total + jnp.exp(-s * family.start) * (level @ (family.terms[m] @ column))
        both.append(total)
    return jnp.stack(both)


def _of_first(solution: Solution, s: Array) -> Array:
    """c_1 ρ_1^s + Σ κ D(s)."""
    y = solution.roots.root_rate[0]
    return solution.c1 * jnp.exp(-s * y) + sum(f.kappa * _difference(solution.roots, f.resonant, s) for f in solution.others)


def stress(solution: Solution, s: Array) -> Array:
    """t(s), the stress on contact s when all before it have broken, at real s ≥ 0; in σ_s."""
    v = parts(solution, s)
    return solution.prestress + v[0] + v[1]


def rise(solution: Solution, s: Array) -> Array:
    """t(s) − t(0), term by term: soft interfaces lift t above 1 by as little as b, which t − 1 would lose to rounding."""
    roots = solution.roots
    level, column, k_rate, a_rate = _powers(roots, s, solution.first[0].shape)
    level_gap, column_gap = -jnp.expm1(-s * k_rate), -jnp.expm1(-s * a_rate)

    def fall(start: Array, terms: Terms) -> Array:
        """Σ terms (1 − e^{−start s} u_k v_a), 1 − xyz = (1 − x) + x (1 − y) + xy (1 − z)."""
        by_column = terms @ column_gap
        power = jnp.exp(-s * start)
        return -jnp.expm1(-s * start) * terms.sum() + power * (level_gap @ terms.sum(1) + level @ by_column)

    first = solution.first[0] + solution.first[1]
    y = roots.root_rate[0]
    total = -solution.c1 * fall(y, first)
    for family in solution.others:
        total = total - fall(family.start, family.terms[0] + family.terms[1])
        total = total + family.kappa * _difference(roots, family.resonant, s) * (level @ (first @ column))
    return total


def stress_sums(solution: Solution, low: Array, high: Array) -> Float[Array, "2"]:
    """Σ_{low ≤ j < high} r_m^{j − low} t(j) for whole `low` ≤ `high`, term by term; on the line the integral."""
    roots = solution.roots
    first = solution.first[0] + solution.first[1]
    _, _, k_rate, a_rate = _powers(roots, low, first.shape)
    rate, span = k_rate[:, None] + a_rate[None], high - low

    def over(every: Array) -> Array:
        """1 − e^{−rate}, what a geometric series is divided by; on the line the rate."""
        return -jnp.expm1(-every) if roots.lattice else every

    def one(mode: Array) -> Array:
        def summed(start: Array) -> Array:
            """Σ μ^j r_m^{j − low}, μ = e^{−start − rate}."""
            every = start + rate + mode
            return -jnp.exp(-low * (start + rate)) * jnp.expm1(-span * every) / over(every)

        total = solution.c1 * (summed(roots.root_rate[0]) * first).sum()
        for family in solution.others:
            x, y = family.resonant, roots.root_rate[0]
            total = total + (summed(family.start) * (family.terms[0] + family.terms[1])).sum()
            # D(j) is a divided difference in μ, and so is its sum: (FG)[x,y] = F[x,y] G(y) + F(x) G[x,y]
            D_low, D_high = (_difference(roots, x, s) for s in (low, high))
            numerator = jnp.exp(-rate * low) * (D_low - jnp.exp(-span * (rate + mode)) * D_high)
            power = jnp.exp(-rate - mode) if roots.lattice else 1
            both = (numerator + summed(x) * power) / over(y + rate + mode)
            total = total + family.kappa * (both * first).sum()
        return total - solution.prestress * jnp.expm1(-span * mode) / over(mode)

    return jnp.stack([one(roots.rate[0]), one(roots.rate[1])])


def _difference(roots: Roots, x_rate: Array, s: Array) -> Array:
    """D(s); on the line (e^{−xs} − e^{−ys})/(y − x), in the rates themselves."""
    y = roots.root_rate[0]
    return divided_difference(x_rate, y, s) if roots.lattice else overlap(x_rate, y, s)


def overlap(x_rate: Array, y_rate: Array, s: Array) -> Array:
    """∫_0^s e^{−x(s−y) − zy} dy = (e^{−xs} − e^{−zs})/(z − x) for rates x, z; regular, with all its derivatives, at x = z."""
    gap = y_rate - x_rate
    slower, distance = jnp.where(gap >= 0, x_rate, y_rate), jnp.where(gap >= 0, gap, -gap)
    return jnp.exp(-slower * s) * s * _relaxation(s * distance)


def divided_difference(x_rate: Array, y_rate: Array, s: Array) -> Array:
    """D(s) = (x^s − y^s)/(x − y) from rates −ln x, −ln y; regular, with all its derivatives, at x = y."""
    gap = y_rate - x_rate  # ln(x/y)
    slower, distance = jnp.where(gap >= 0, x_rate, y_rate), jnp.where(gap >= 0, gap, -gap)
    return jnp.exp(-slower * (s - 1)) * s * _relaxation(s * distance) / _relaxation(distance)


def _relaxation(z: Array) -> Array:
    """(1 − e^{−z})/z by its Taylor series near 0, where the quotient's derivatives cancel."""
    small = (z < 1) & (z > -1)
    z0, z1 = jnp.where(small, z, 0), jnp.where(small, 1, z)
    series = jnp.ones_like(z)
    for k in range(19, 1, -1):
        series = 1 - z0 / k * series
    return jnp.where(small, series, -jnp.expm1(-z1) / z1)
