r"""Modes of a lane and their derivatives, by hand: of one slider on a semi-infinite chain, number by number.

The numbers of `slippulse_jax.lattice.modes`, written for a loop that has to compute millions of them: what takes long are
quotients and roots, so each is taken once, for the modes and for all derivatives. The modes depend on three numbers alone,
a = K_T/K_L, c = K_T/K and q = k/K. With μ_m = κ_m², S = μ_1 − μ_2, X = μ_1 − a (a sum of positive terms),
h_m = √(1 + μ_m/4) and p_m = h_m + κ_m/2,

    r_m = 1/p_m²,    1/α_1 = −a/X,    1/α_2 = X/c,    w_1 = q X/(S · 2κ_1 h_1),    w_2 = q a c/(X S · 2κ_2 h_2).

Of the derivatives (a dot: along one parameter), all else are products of

    μ̇_1 = [μ_1 (ȧ + ċ + q̇) − (aq)˙]/S,    μ̇_2 = [(aq)˙ − μ_2 (ȧ + ċ + q̇)]/S,    (ln r_m)˙ = −μ̇_m/(2 κ_m h_m).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

Number = Float[Array, ""]
Pair = tuple[Number, Number]  # one number a mode


class LaneModes(NamedTuple):
    """What a front on a semi-infinite chain depends on, of `slippulse_jax.lattice.modes.Modes`."""

    gap: Pair  # 1 − r_m
    weight: Pair  # w_m
    reflection: tuple[Number, Number, Number]  # R_11, R_12 = R_21, R_22
    drive: Pair  # C_m


class LaneRates(NamedTuple):
    """Derivatives along one parameter."""

    log_decay: Pair  # of ln r_m
    weight: Pair
    reflection: tuple[Number, Number, Number]
    drive: Pair


class Intermediate(NamedTuple):
    """What modes and derivatives have in common."""

    transverse: Number  # K_T/K
    over_height: Number  # λc/H
    mu: Pair  # κ_m²
    over_split: Number  # 1/S
    over_excess: Number  # 1/X
    root: Pair  # p_m, so that r_m = 1/p_m²
    slope: Pair  # (1 − r_m)/r_m
    over_decay: Pair  # 1/(2κ_m h_m)
    upper: Pair  # 1/α_m
    over_determinant: Number  # of the equations at the left edge
    over_edge: Number


def lane_modes(height: Number, stiffness: Number, poisson: Number) -> tuple[LaneModes, Intermediate]:
    """Modes of one slider, and what `lane_rates` needs besides."""
    q, double = stiffness, 2 * (1 + poisson)
    c = 1 / (double * height)
    over_height = c * double
    a = c * over_height
    square = (c + q - a) ** 2 + 4 * a * c
    split = jnp.sqrt(square)
    over_split = split / square  # XLA would take an approximate reciprocal root for 1/split
    X = (c + q - a + split) / 2
    over_X, mu1 = 1 / X, a + X
    mu2 = a * q / mu1
    k1, k2 = jnp.sqrt(mu1), jnp.sqrt(mu2)
    h1, h2 = jnp.sqrt(1 + mu1 / 4), jnp.sqrt(1 + mu2 / 4)
    p1, p2 = h1 + k1 / 2, h2 + k2 / 2
    g1, g2 = k1 / p1, k2 / p2
    s1, s2 = k1 * p1, k2 * p2
    D1, D2 = 1 / (2 * k1 * h1), 1 / (2 * k2 * h2)
    w1, w2 = q * X * over_split * D1, q * a * c * over_X * over_split * D2
    U1, U2 = -a * over_X, X * double * height
    # at the left edge u_t is imposed and u is free
    over_determinant, over_edge = 1 / (U1 * s2 - U2 * s1), 1 / (s2 - s1)
    R11 = -w1 * (U1 * s2 + g1 * U2) * over_determinant
    R12 = -w2 * U2 * (s2 + g2) * over_determinant
    R22 = w2 * (g2 * U1 + U2 * s1) * over_determinant
    at_edge = (U1, U2), over_determinant, over_edge
    common = Intermediate(c, over_height, (mu1, mu2), over_split, over_X, (p1, p2), (s1, s2), (D1, D2), *at_edge)
    return LaneModes((g1, g2), (w1, w2), (R11, R12, R22), (s2 * over_edge, -s1 * over_edge)), common


def lane_rates(
    height: Number, stiffness: Number, modes: LaneModes, common: Intermediate
) -> tuple[LaneRates, LaneRates, LaneRates]:
    """Derivatives of `lane_modes` in height, stiffness and Poisson's ratio."""
    q, c = stiffness, common.transverse
    a, over_q = c * common.over_height, 1 / q
    (mu1, mu2), (s1, s2), (D1, D2), (U1, U2) = common.mu, common.slope, common.over_decay, common.upper
    (g1, g2), (w1, w2), (R11, R12, R22), (C1, C2) = modes
    over_r1, over_r2 = common.root[0] ** 2, common.root[1] ** 2
    # (ln 2κh)˙ = 2 (1 + μ/2) μ̇/(2κh)²
    spread1, spread2 = (2 + mu1) * D1**2, (2 + mu2) * D2**2
    to_11, to_22, to_12 = U1 * s2 + g1 * U2, g2 * U1 + U2 * s1, U2 * (s2 + g2)

    def along(log_a: Number, log_c: Number, dq: Number) -> LaneRates:
        da, dc = a * log_a, c * log_c
        trace, product = da + dc + dq, da * q + a * dq
        dmu1, dmu2 = (mu1 * trace - product) * common.over_split, (product - mu2 * trace) * common.over_split
        log_split, log_X = (dmu1 - dmu2) * common.over_split, (dmu1 - da) * common.over_excess
        l1, l2 = -dmu1 * D1, -dmu2 * D2
        ds1, ds2 = -l1 * over_r1, -l2 * over_r2
        dg1, dg2 = l1 * (g1 - 1), l2 * (g2 - 1)
        dU1, dU2 = U1 * (log_a - log_X), U2 * (log_X - log_c)
        dw1 = w1 * (dq * over_q + log_X - log_split - dmu1 * spread1)
        dw2 = w2 * (dq * over_q + log_a + log_c - log_X - log_split - dmu2 * spread2)
        log_determinant = (dU1 * s2 + U1 * ds2 - dU2 * s1 - U2 * ds1) * common.over_determinant
        log_edge = (ds2 - ds1) * common.over_edge
        dto_11 = dU1 * s2 + U1 * ds2 + dg1 * U2 + g1 * dU2
        dto_22 = dg2 * U1 + g2 * dU1 + dU2 * s1 + U2 * ds1
        dto_12 = dU2 * (s2 + g2) + U2 * (ds2 + dg2)
        return LaneRates(
            log_decay=(l1, l2),
            weight=(dw1, dw2),
            reflection=(
                -(dw1 * to_11 + w1 * dto_11) * common.over_determinant - R11 * log_determinant,
                -(dw2 * to_12 + w2 * dto_12) * common.over_determinant - R12 * log_determinant,
                (dw2 * to_22 + w2 * dto_22) * common.over_determinant - R22 * log_determinant,
            ),
            drive=(ds2 * common.over_edge - C1 * log_edge, -ds1 * common.over_edge - C2 * log_edge),
        )

    none, one = jnp.zeros_like(q), jnp.ones_like(q)
    by_height, by_poisson = -common.over_height, -2 * height * c
    return along(2 * by_height, by_height, none), along(none, none, one), along(by_poisson, by_poisson, none)
