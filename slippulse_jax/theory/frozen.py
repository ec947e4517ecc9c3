"""The Appendix: the continuum with a frozen upper layer.

It is frozen in its shape at nucleation, u_t = U0 e^{−κ_2 x} (label cra45). Lengths in λc, displacements in u_s, stresses in
σ_s. Valid for λc ≪ H and k ≪ K (ε = κ_T²/κ² ≪ 1); where the paper's printed formulas err, the corrected ones are in use.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.bulk.derivatives import root_between
from slippulse_jax.exact.double_series import exponential_terms, overlap
from slippulse_jax.slider import Slider, each_slider


class Appendix(NamedTuple):
    """Every named intermediate of the Appendix at one slider; u_s = 1."""

    U0: Array  # load at nucleation (cra45e)
    psi1: Array  # Ψ_1 (cra45f)
    psi2: Array  # Ψ_2 (cra47d)
    psi3: Array  # Ψ_3 (cra48)
    psi6_0: Array  # Ψ_6(0) (cra54)
    psi6_slope_0: Array  # Ψ_6'(0) (cra54b), 1/λc
    A3_0: Array  # A_3(0) (cra51b)
    A4_0: Array  # A_4(0) (cra46b)
    gamma3: Array  # γ_3 (cra56a), 1/λc
    A0: Array  # A_0 (cra56a2), the stress on the next contact once the first has broken; above 1 if the front starts
    gamma: Array  # γ (cra56b), 1/λc
    A_far: Array  # 𝒜 (cra56c), amplitude of e^{−κ_2 s} far from the edge
    kappa3: Array  # κ_3 (cra57c), 1/λc
    alpha: Array  # α (cra57a)
    C: Array  # C (cra57b)
    B: Array  # ℬ (below cra58)
    length: Array  # Λ (cra58), λc


def psi6(slider: Slider, s: Array) -> Array:
    """Ψ_6(s), label cra54.

    Erratum: the coefficient of e^{−(κ+κ_2)s} in the bracket is wrong. Eliminating A_1 and A_2 from cra48–cra50 gives
    ½κ(1−λcκ)/(κ+κ_2)·(1/Ψ_2 − 1), where −κ(λcκ²+κ_2)/(κ²−κ_2²), the constant term, is printed.
    """
    k, k2 = slider.kappa, slider.kappa_2
    constant = -k * (k**2 + k2) / (k**2 - k2**2)
    return k * (1 + k) / (2 * (k - k2)) * jnp.exp((k - k2) * s) + constant + _echo(slider) * jnp.exp(-(k + k2) * s)


def _echo(slider: Slider) -> Array:
    """½κ(1−λcκ)/(κ+κ_2)·(1/Ψ_2 − 1), with 1/Ψ_2 − 1 = −(1−β)κ/[(3−β)κ + 2κ_2]."""
    k, k2 = slider.kappa, slider.kappa_2
    return -k * (1 - k) / (2 * (k + k2)) * _released(slider) * k / ((3 - slider.beta) * k + 2 * k2)


def _released(slider: Slider) -> Array:
    """1 − β = k/(k + K_T)."""
    return slider.b * slider.beta


def _psi6_slope(slider: Slider, s: Array) -> Array:
    """e^{−κs} Ψ_6'(s), label cra54b, erratum as for `psi6`."""
    k, k2 = slider.kappa, slider.kappa_2
    return k * (1 + k) / 2 * jnp.exp(-k2 * s) - (k + k2) * _echo(slider) * jnp.exp(-(2 * k + k2) * s)


def leading_length(slider: Slider) -> Array:
    """ln[2/(1 + β)]/κ_2, the leading term of Eq. (25), in λc."""
    return jnp.log(2 / (1 + slider.beta)) / slider.kappa_2


def _psi1(slider: Slider) -> Array:
    return 1 + slider.kappa_2 / (1 + slider.kappa)


def _psi2(slider: Slider) -> Array:
    k, k2 = slider.kappa, slider.kappa_2
    return ((3 - slider.beta) * k + 2 * k2) / (2 * (k + k2))


def _load(slider: Slider) -> Array:
    """βU0 (cra45e)."""
    return (1 + slider.kappa_2 / slider.kappa) / _psi1(slider)


def _a4(slider: Slider, s: Array) -> Array:
    return _load(slider) * slider.kappa * jnp.exp(-slider.kappa_2 * s) / (2 * (slider.kappa + slider.kappa_2))


def _a3_start(slider: Slider) -> Array:
    psi3 = _load(slider) + _released(slider)
    first = _load(slider) * _psi2(slider) * psi6(slider, jnp.zeros_like(psi3))
    return (slider.kappa * psi3 + first) / (1 + slider.kappa)


@in_full
def _a3_parts(slider: Slider, s: Array) -> tuple[Array, Array]:
    """p(s) and f(s) of A_3(s) = A_3(0) e^{p(s)} + f(s), cra55 integrated.

    With its integrating factor e^{as + gz}, z = e^{−2κs}, expanded in gz,

        p(s) = g(1 − z) − as,    f(s) = e^{−gz} Σ_n weight_n ∫_0^s e^{−a(s−y) − rate_n y} dy.
    """
    k, k2 = slider.kappa, slider.kappa_2
    a, g = k * (1 + slider.beta) / 2, _released(slider) * (1 - k) / (4 * (1 + k))
    source = _load(slider) * _psi2(slider) / (1 + k)
    slope_far = k * (1 + k) / 2
    slope_near = _psi6_slope(slider, jnp.zeros_like(k)) - slope_far
    # rate κ_2 + 2nκ: the far part of Ψ_6' starts at n = 0, the near part at n = 1
    power = exponential_terms(g)
    n = np.arange(power.size + 1, dtype=power.dtype)
    weight = source * (slope_far * jnp.pad(power, (0, 1)) + slope_near * jnp.pad(power, (1, 0)))
    forced = jnp.exp(-g * jnp.exp(-2 * k * s)) * (weight @ overlap(a, k2 + 2 * n * k, s))
    return -a * s - g * jnp.expm1(-2 * k * s), forced


def _stress(slider: Slider, s: Array) -> Array:
    """A_3(s) + A_4(s)."""
    exponent, forced = _a3_parts(slider, s)
    return _a3_start(slider) * jnp.exp(exponent) + forced + _a4(slider, s)


def _excess(slider: Slider, s: Array) -> Array:
    """t(s) − 1, term by term: differences as small as b survive."""
    k = slider.kappa
    A3, A4 = _a3_start(slider), _a4(slider, jnp.zeros_like(k))
    # contact 0, repinned at u_s, adds q/κ(1+κ) to the 1 it was broken at: A_0 − 1
    at_edge = jnp.asarray(slider.stiffness) / (k * (1 + k))
    exponent, forced = _a3_parts(slider, s)
    return at_edge + A3 * jnp.expm1(exponent) + forced + A4 * jnp.expm1(-slider.kappa_2 * s)


@jax.jit
def frozen_stress(slider: Slider, s: Any) -> Float[Array, "..."]:
    """Stress at the front at s > 0, in σ_s.

    ũ(s+0; s) = A_3(s) + A_4(s); labels cra46b and cra55, integrated.

    Parameters
    ----------
    slider : Slider
    s : array_like
        Position of the front in λc; broadcasts with `slider`.
    """
    return each_slider(_stress, slider, s)


@jax.jit
def length_frozen(slider: Slider) -> Float[Array, "..."]:
    """Length of the first precursor with a frozen upper layer, in λc.

    It integrates cra55 without further approximation.

    NaN where the stress never exceeds the threshold beyond the edge.
    """

    def one(slider: Slider) -> Array:
        about = leading_length(slider)
        return root_between(_excess, slider, jnp.zeros_like(about), 4 * about + 2)

    return each_slider(one, slider)


@jax.jit
def length_eq25(slider: Slider) -> Float[Array, "..."]:
    """Length by the paper's Eq. (25), in λc.

    Label cra58b: Λ ≈ κ_2⁻¹ ln{2/[(1 + β − 2κ_2/κ)Ψ_1]}. For Λ ≫ κ⁻¹, H ≫ λc, k ≪ K.
    """

    def one(slider: Slider) -> Array:
        k, k2 = slider.kappa, slider.kappa_2
        # half the bracket is 1 − fall with fall = (1−β)/2 + κ_2/κ, and Ψ_1 = 1 + rise; rise − fall without cancellation
        fall, rise = _released(slider) / 2 + k2 / k, k2 / (1 + k)
        return -jnp.log1p(-(_released(slider) / 2 + k2 / (k * (1 + k)) + fall * rise)) / k2

    return each_slider(one, slider)


@jax.jit
def appendix(slider: Slider) -> Appendix:
    """Every named quantity of the Appendix; NaN where it does not exist."""
    return Appendix(*each_slider(lambda x: tuple(_appendix(x)), slider))


@jax.jit
def length(slider: Slider) -> Float[Array, "..."]:
    """Length by Eq. (58), corrected, in λc.

    Label cra58: Λ ≈ κ_3⁻¹ ln y with ℬy = (y + C)^α. It replaces the front stress of `length_frozen` by a function with the
    right value and slope at the edge and the right tail. For H ≫ λc, k ≪ K. NaN where A_0 ≤ 1 (the front does not start), or
    where cra57c has no solution κ_3.

    Erratum: Ψ_6 (cra54) enters through A_0 and γ.
    """
    return each_slider(lambda x: _appendix(x).length, slider)


def _appendix(slider: Slider) -> Appendix:
    k, k2 = slider.kappa, slider.kappa_2
    zero = jnp.zeros_like(k)
    load, psi2 = _load(slider), _psi2(slider)
    A3, A4 = _a3_start(slider), _a4(slider, zero)
    psi6_slope = _psi6_slope(slider, zero)
    gamma3 = -k / (1 + k) * (slider.beta + k - load / A3 * psi2 * psi6_slope / k)
    A0 = A3 + A4
    gamma = (gamma3 * A3 - k2 * A4) / A0
    far = load * (k / (2 * (k + k2)) + psi2 / (1 + slider.beta - 2 * k2 / k))

    def mismatch(p: tuple[Array, Array, Array], log_kappa3: Array) -> Array:
        """cra57c, with ln[(κ_2+κ_3)/(κ_3−γ)] = ln1p[(κ_2+γ)/(κ_3−γ)]."""
        k2, gamma, target = p
        k3 = jnp.exp(log_kappa3) + jnp.maximum(gamma, 0)
        return (1 + k2 / k3) * jnp.log1p((k2 + gamma) / (k3 - gamma)) - target

    log_k = jnp.log(k)
    root = root_between(mismatch, (k2, gamma, jnp.log(far / A0)), log_k - 12, log_k + 7)
    k3 = jnp.exp(root) + jnp.maximum(gamma, 0)
    alpha, C = 1 + k2 / k3, (k2 + gamma) / (k3 - gamma)

    def excess(p: tuple[Array, Array, Array, Array], s: Array) -> Array:
        """Logarithm of cra56, with y = e^{κ_3 s}."""
        A0, alpha, C, k3 = p
        x = k3 * s
        return jnp.log(A0) + alpha * jnp.log1p(-C * jnp.expm1(-x) / (1 + C * jnp.exp(-x))) + (1 - alpha) * x

    found = root_between(excess, (A0, alpha, C, k3), zero, 4 * leading_length(slider) + 2)
    B = A0 * (1 + C) ** alpha
    first = load / slider.beta, _psi1(slider), psi2, load + _released(slider)
    psi6_0 = psi6(slider, zero)
    return Appendix(
        *first, psi6_0, psi6_slope, A3, A4, gamma3, A0, gamma, far, k3, alpha, C, B, jnp.where(A0 > 1, found, jnp.nan)
    )
