"""The Appendix step by step: the fields and identities that lie between the frozen upper layer and Eq. (58).

`slippulse_jax.theory.frozen` has what these steps lead to, and nothing else needs them: they are here so that every
equation of the paper can be computed and held against the one before it. Lengths in λc, displacements in u_s.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.slider import Slider
from slippulse_jax.theory.frozen import _a4, _load, _psi2, _released, _stress, appendix, psi6

NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)


def held_at(slider: Slider, upper: Array, pinning: Array) -> Array:
    """The place that both springs pull a block of the layer to, w = β u_t + (1 − β) u_b; label cra10."""
    return slider.beta * upper + _released(slider) * pinning


def frozen_upper(slider: Slider, x: Array) -> Array:
    """u_t(x) ≈ U_t0 e^{−κ_2 x}, the upper layer as it is at nucleation and is assumed to stay; label cra45."""
    return _load(slider) / slider.beta * jnp.exp(-slider.kappa_2 * x)


class EdgeAmplitudes(NamedTuple):
    """Amplitudes of sinh κx and cosh κx at nucleation, A_30 and A_40, in u_s."""

    sinh: Array
    cosh: Array


def edge_amplitudes(slider: Slider) -> EdgeAmplitudes:
    """A_30 and A_40 at nucleation: bounded at infinity, and a free edge; labels cra45c, cra45d1.

    Erratum: the ½ printed in cra45b and cra45c is spurious, A_40 + A_30 = βU κ/(κ + κ_2).
    """
    k, k2 = slider.kappa, slider.kappa_2
    total = _load(slider) * k / (k + k2)
    difference = total * (1 + k + 2 * k2) / (1 + k)
    return EdgeAmplitudes((total - difference) / 2, (total + difference) / 2)


def layer_from_amplitudes(slider: Slider, x: Array, amplitudes: EdgeAmplitudes) -> Array:
    """u(x) at nucleation for any A_30, A_40; label cra45b, its first line, with the integral done."""
    k, k2 = slider.kappa, slider.kappa_2
    driven = _load(slider) * k**2 / (k**2 - k2**2) * (jnp.exp(-k2 * x) - jnp.cosh(k * x) + k2 / k * jnp.sinh(k * x))
    return amplitudes.sinh * jnp.sinh(k * x) + amplitudes.cosh * jnp.cosh(k * x) + driven


def layer_at_nucleation(slider: Slider, x: Array) -> Array:
    """u(x) at nucleation; label cra45d2."""
    k, k2 = slider.kappa, slider.kappa_2
    near = k2 / k * (1 + k2) / (1 + k) * jnp.exp(-k * x)
    return _load(slider) * k**2 / (k**2 - k2**2) * (jnp.exp(-k2 * x) - near)


def layer_ahead(slider: Slider, x: Array, s: Array, A3: Array, A4: Array) -> Array:
    """ũ(x; s) ahead of the front, x ≥ s, for any A_3 and A_4; label cra46."""
    k, k2 = slider.kappa, slider.kappa_2
    y, load = x - s, _load(slider)
    driven = load * k**2 / (k**2 - k2**2) * jnp.exp(-k2 * x)
    sent = load * k * jnp.exp(-k2 * s) / 2 * (jnp.exp(k * y) / (k + k2) + jnp.exp(-k * y) / (k - k2))
    return driven + A3 * jnp.exp(-k * y) + A4 * jnp.exp(k * y) - sent


def bounded_layer_ahead(slider: Slider, x: Array, s: Array) -> Array:
    """ũ(x; s) ahead of the front, x ≥ s, with the A_4 that keeps it bounded; label cra46c."""
    k, k2 = slider.kappa, slider.kappa_2
    amplitude = _a3(slider, s) - _load(slider) * k * jnp.exp(-k2 * s) / (2 * (k - k2))
    return _load(slider) * k**2 / (k**2 - k2**2) * jnp.exp(-k2 * x) + amplitude * jnp.exp(-k * (x - s))


def released_layer(slider: Slider, x: Array) -> Array:
    """ℱ(x), what the load and A_4 leave behind the front, over βU_0; label cra47b."""
    k, k2 = slider.kappa, slider.kappa_2
    inner = k2 / k * jnp.sinh(k * x) - jnp.cosh(k * x) + jnp.exp(-k2 * x)
    return _psi2(slider) * k**2 / (k**2 - k2**2) * inner


def released_slope(slider: Slider, x: Array) -> Array:
    """ℱ'(x)/κ; label cra47c."""
    k, k2 = slider.kappa, slider.kappa_2
    inner = k2 / k * jnp.cosh(k * x) - jnp.sinh(k * x) - k2 / k * jnp.exp(-k2 * x)
    return _psi2(slider) * k**2 / (k**2 - k2**2) * inner


def psi4(slider: Slider, s: Array) -> Array:
    """Ψ_4(s); label cra49b."""
    return released_layer(slider, s) - _a4(slider, s) / _load(slider)


def psi5(slider: Slider, s: Array) -> Array:
    """Ψ_5(s); label cra50b."""
    return released_slope(slider, s) - _a4(slider, s) / _load(slider)


def tail_amplitudes(slider: Slider, s: Array) -> tuple[Array, Array]:
    """A_1(s) and A_2(s) behind the front, from the sum of the two continuity conditions and the edge; label cra48."""
    k = slider.kappa
    psi3 = _load(slider) + _released(slider)
    memory = k * _released(slider) * _memory(slider, s, lambda y: jnp.exp(-k * y))
    source = psi3 + _load(slider) * (psi4(slider, s) + psi5(slider, s)) * jnp.exp(-k * s)
    A1 = (memory - source) * k / (1 + k)
    return A1, psi3 + A1 / k


def layer_behind(slider: Slider, x: Array, s: Array) -> Array:
    """ũ(x; s) behind the front, x ≤ s; label cra47."""
    k = slider.kappa
    A1, A2 = tail_amplitudes(slider, s)
    memory = _memory(slider, x, lambda y: jnp.sinh(k * (x - y)))
    own = A1 * jnp.sinh(k * x) + A2 * jnp.cosh(k * x)
    return _load(slider) * released_layer(slider, x) + own - k * _released(slider) * memory


class Steps(NamedTuple):
    """Left minus right side of the equations that lead from the continuity conditions to A_3(s): zero, all of them."""

    boundary: Float[Array, ""]  # A_2 − A_1/κ = Ψ_3 (cra48)
    value: Float[Array, ""]  # ũ continuous at the front (cra49)
    slope: Float[Array, ""]  # ũ' continuous at the front (cra50)
    difference: Float[Array, ""]  # of these two (cra49c1)
    total: Float[Array, ""]  # of these two (cra50c1)
    difference_closed: Float[Array, ""]  # without A_2 (cra49c)
    total_closed: Float[Array, ""]  # without A_2 (cra50c)
    integral: Float[Array, ""]  # without A_1, the integral equation for A_3 (cra51)
    rate: Float[Array, ""]  # its derivative (cra55)


def printed_psi6(slider: Slider, s: Array) -> Array:
    """Ψ_6 as printed: the coefficient of e^{−(κ+κ_2)s} is the constant term again."""
    k, k2 = slider.kappa, slider.kappa_2
    constant = -k * (k**2 + k2) / (k**2 - k2**2)
    return k * (1 + k) / (2 * (k - k2)) * jnp.exp((k - k2) * s) + constant * (1 + jnp.exp(-(k + k2) * s))


def asymptotic_decay_length(slider: Slider) -> Array:
    """κ_2⁻¹ ≈ [2(1+ν) + h/q]^{1/2}/h in λc, label cra44, for h, q ≪ 1."""
    return slider.height * jnp.sqrt(2 * (1 + slider.poisson) + 1 / (slider.height * slider.stiffness))


def steps(slider: Slider, s: Array, psi6: Callable[[Slider, Array], Array] = psi6) -> Steps:
    """Every identity of the derivation at one front position s > 0, with this Ψ_6; that of the paper breaks two."""
    k, load, free = slider.kappa, _load(slider), _released(slider)
    (A1, A2), psi3 = tail_amplitudes(slider, s), load + free
    p4, p5 = psi4(slider, s), psi5(slider, s)
    A3, A3_slope = jax.jvp(lambda y: _a3(slider, y), (s,), (jnp.ones_like(s),))
    sinh, cosh, up, down = jnp.sinh(k * s), jnp.cosh(k * s), jnp.exp(k * s), jnp.exp(-k * s)
    by_sinh = k * free * _memory(slider, s, lambda y: jnp.sinh(k * (s - y)))
    by_cosh = k * free * _memory(slider, s, lambda y: jnp.cosh(k * (s - y)))
    by_up = k * free * _memory(slider, s, lambda y: jnp.exp(k * y))
    by_down = k * free * _memory(slider, s, lambda y: jnp.exp(-k * y))
    by_both = k * free * _memory(slider, s, lambda y: jnp.cosh(k * y) + k * jnp.sinh(k * y))
    p6, p6_slope = jax.jvp(lambda y: psi6(slider, y), (s,), (jnp.ones_like(s),))
    kernel = free / (1 + k) * (cosh + k * sinh) * down
    return Steps(
        boundary=A2 - A1 / k - psi3,
        value=by_sinh + A3 - A1 * sinh - A2 * cosh - load * p4,
        slope=by_cosh - A3 - A1 * cosh - A2 * sinh - load * p5,
        difference=2 * A3 * up - by_up - (A2 - A1) - load * (p4 - p5) * up,
        total=by_down - (A2 + A1) - load * (p4 + p5) * down,
        difference_closed=2 * A3 * up - by_up - A1 * (1 - k) / k - psi3 - load * (p4 - p5) * up,
        total_closed=by_down - A1 * (1 + k) / k - psi3 - load * (p4 + p5) * down,
        integral=A3 * (1 + k) * up - by_both - k * psi3 - load * _psi2(slider) * p6,
        rate=A3_slope / k + A3 - A3 * kernel - load * _psi2(slider) / (k * (1 + k)) * p6_slope * down,
    )


def fitted_stress(slider: Slider, s: Array) -> Array:
    """The front stress approximated between its two ends, A_0 (1+C)^α e^{κ_3 s}/(e^{κ_3 s}+C)^α; label cra56."""
    a = appendix(slider)
    small = jnp.exp(-a.kappa3 * s)
    return a.A0 * ((1 + a.C) / (1 + a.C * small)) ** a.alpha * small ** (a.alpha - 1)


def _a3(slider: Slider, s: Array) -> Array:
    return _stress(slider, s) - _a4(slider, s)


def _memory(slider: Slider, s: Array, kernel: Callable[[Array], Array]) -> Array:
    """∫_0^s A_3(ξ) kernel(ξ) dξ, by Gauss and Legendre's rule."""
    at = s * (1 + NODES) / 2
    values = jax.vmap(lambda y: _a3(slider, y) * kernel(y))(at)
    return s / 2 * (WEIGHTS @ values)
