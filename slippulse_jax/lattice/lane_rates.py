r"""Derivatives of the modes of many sliders, by hand: JAX's own take twenty times as long as the modes themselves.

The modes depend on a = K_T/K_L, b = K_T/K and q = k/K alone. With μ_m = κ_m², μ_1 + μ_2 = a + b + q and μ_1 μ_2 = a q; a dot is
a derivative along one parameter, and √D = μ_1 − μ_2:

    μ̇_1 = [μ_1 (ȧ + ḃ + q̇) − (aq)˙]/√D,    μ̇_2 = [(aq)˙ − μ_2 (ȧ + ḃ + q̇)]/√D,
    (ln r_m)˙ = −μ̇_m/(2 κ_m h_m),    h_m = √(1 + μ_m/4).

All else is products of these. Written for semi-infinite chains; quotients of the values are taken once for all parameters.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from slippulse_jax.lattice.modes import Modes
from slippulse_jax.slider import Slider

Pair = tuple[Array, Array]


class ModeRates(NamedTuple):
    """Derivatives of modes along one parameter; each an array of lanes."""

    gap: Pair  # of 1 − r_m
    weight: Pair  # of w_m
    reflection: tuple[Array, Array, Array]  # of R_11, R_12, R_22
    drive: Pair  # of C_m


def mode_rates(slider: Slider, modes: Modes) -> tuple[ModeRates, ModeRates, ModeRates]:
    """Derivatives of `modes` in height, stiffness and Poisson's ratio.

    Parameters
    ----------
    slider : Slider
        Fields of shape (lanes,).
    modes : Modes
        Its modes, lanes last.
    """
    q, height = jnp.asarray(slider.stiffness), jnp.asarray(slider.height)
    a, b, split = slider.kappa_T**2, slider.K_T, slider.mode_splitting
    mu = slider.kappa_1**2, slider.kappa_2**2
    h2 = 1 + mu[0] / 4, 1 + mu[1] / 4
    (r1, r2), (g1, g2), (w1, w2), (U1, U2) = modes.ratio, modes.gap, modes.weight, modes.upper
    s1, s2 = g1 / r1, g2 / r2
    (R11, R12), (_, R22) = modes.reflection
    C1, C2 = modes.drive
    over_split, over_q, over_r = 1 / split, 1 / q, (1 / r1, 1 / r2)
    over_mu = 1 / mu[0], 1 / mu[1]
    over_decay = tuple(1 / (2 * jnp.sqrt(m * h)) for m, h in zip(mu, h2, strict=True))
    over_h2 = 1 / (8 * h2[0]), 1 / (8 * h2[1])
    over_determinant, over_edge = 1 / (U1 * s2 - U2 * s1), 1 / (s2 - s1)
    x, e = -a / U1, mu[0] / U2  # μ_1 − a and μ_1 − q, without cancellation
    over_x, over_e = 1 / x, 1 / e

    def along(log_a: Array, log_b: Array, dq: Array) -> ModeRates:
        da, db = a * log_a, b * log_b
        trace, product = da + db + dq, da * q + a * dq
        dmu = (mu[0] * trace - product) * over_split, (product - mu[1] * trace) * over_split
        log_split = (dmu[0] - dmu[1]) * over_split
        # logarithms of α_1 = −x/a and α_2 = e/μ_1, where e² + (q − a − b) e = bq
        log_x = (dmu[0] - da) * over_x
        log_e = (db * q + b * dq - (dq - da - db) * e) * over_split * over_e
        log_alpha = log_x - log_a, log_e - dmu[0] * over_mu[0]
        log_r = -dmu[0] * over_decay[0], -dmu[1] * over_decay[1]
        dg1, dg2 = -r1 * log_r[0], -r2 * log_r[1]
        ds1, ds2 = -log_r[0] * over_r[0], -log_r[1] * over_r[1]
        dU1, dU2 = -U1 * log_alpha[0], -U2 * log_alpha[1]
        # w_m = k/K |α_m| a / (2 √D κ_m h_m)
        common = dq * over_q + log_a - log_split
        dw1 = w1 * (common + log_alpha[0] - dmu[0] * (over_mu[0] / 2 + over_h2[0]))
        dw2 = w2 * (common + log_alpha[1] - dmu[1] * (over_mu[1] / 2 + over_h2[1]))
        log_determinant = (dU1 * s2 + U1 * ds2 - dU2 * s1 - U2 * ds1) * over_determinant
        log_edge = (ds2 - ds1) * over_edge
        to_11, to_22, to_12 = U1 * s2 + g1 * U2, g2 * U1 + U2 * s1, U2 * (s2 + g2)
        dto_11 = dU1 * s2 + U1 * ds2 + dg1 * U2 + g1 * dU2
        dto_22 = dg2 * U1 + g2 * dU1 + dU2 * s1 + U2 * ds1
        dto_12 = dU2 * (s2 + g2) + U2 * (ds2 + dg2)
        return ModeRates(
            gap=(dg1, dg2),
            weight=(dw1, dw2),
            reflection=(
                -(dw1 * to_11 + w1 * dto_11) * over_determinant - R11 * log_determinant,
                -(dw2 * to_12 + w2 * dto_12) * over_determinant - R12 * log_determinant,
                (dw2 * to_22 + w2 * dto_22) * over_determinant - R22 * log_determinant,
            ),
            drive=(ds2 * over_edge - C1 * log_edge, -ds1 * over_edge - C2 * log_edge),
        )

    none, by_height, by_poisson = jnp.zeros_like(q), 1 / height, 1 / (1 + jnp.asarray(slider.poisson))
    return along(-2 * by_height, -by_height, none), along(none, none, none + 1), along(-by_poisson, -by_poisson, none)
