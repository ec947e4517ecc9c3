"""The continuum, self-consistent in both layers: labels cra08–cra37.

Lengths in λc, displacements in u_s, stresses in σ_s. The front leaves u_b(x) = ũ(x+0; x) behind it (cra26); the six
coefficients D(s) of cra28–cra33 follow from two boundary and four continuity conditions, and close on the front stress
t(s) = ũ(s+0; s). Written for the two parts V_m of t = V_1 + V_2 in the modes κ_m,

    dV_m/ds = −κ_m V_m + W_m t + Σ_n R_mn e^{−(κ_m + κ_n)s} t,        W_m = (k/K) α_m g_m/(2κ_m),

with (0, 1) = Σ g_m (1, α_m): a linear system that `slippulse_jax.exact.double_series` solves, as on the lattice, at any real s.
Valid, as a limit of the lattice, for κ_1 λc ≪ 1: H ≫ λc and k ≪ K.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.bulk.derivatives import by_forward_mode, root_between
from slippulse_jax.exact import double_series
from slippulse_jax.exact.crossing import expected_length
from slippulse_jax.slider import Fields, Slider, each_slider


def _line(slider: Slider) -> tuple[double_series.Series, Array, Array, Array]:
    """Series of the front stress on a line, and its edge.

    Return it; 1/α_m; V_m at nucleation (cra18), of sum 1; and t(0) − 1, what contact 0, repinned at u_s, adds.
    """
    k, q = jnp.stack([slider.kappa_1, slider.kappa_2]), jnp.asarray(slider.stiffness)
    alpha = jnp.stack([slider.alpha_1, slider.alpha_2])
    share = jnp.stack([-alpha[0], alpha[1]]) * slider.kappa_T**2 / slider.mode_splitting
    weight, upper = q * share / (2 * k), 1 / alpha
    # at x = 0:  Σ V_m/α_m = U  (cra14),   u' = κ²u − K_T U − q u_b(0)  (cra15)
    pull, KT = k + slider.kappa**2, slider.K_T
    edge = upper[0] * pull[1] - upper[1] * pull[0]

    def amplitudes(first: Array, second: Array) -> Array:
        """B_m of Σ B_m/α_m = first, Σ(κ_m + κ²) B_m = second."""
        return jnp.stack([first * pull[1] - upper[1] * second, upper[0] * second - first * pull[0]]) / edge

    per_load = amplitudes(jnp.ones_like(KT), KT)
    load = 1 / (per_load[0] + per_load[1])
    back = [amplitudes(-weight[n] * upper[n], weight[n] * (k[n] - slider.kappa**2)) for n in (0, 1)]
    released = amplitudes(jnp.zeros_like(KT), q)
    system = double_series.system_of(k, weight, jnp.stack(back, 1), load * per_load + released)
    return double_series.solve(system), upper, load * per_load, released.sum()


def _differentiable(function: Any) -> Any:
    """Give a `function` of slider and scalars derivatives in every mode."""
    of_numbers = by_forward_mode(lambda theta, *rest: function(Slider(theta[0], theta[1], theta[2]), *rest))
    return lambda slider, *rest: of_numbers(jnp.stack([slider.height, slider.stiffness, slider.poisson]), *rest)


@jax.jit
def continuum_stress(slider: Slider, s: Any) -> Float[Array, "..."]:
    """Front stress ũ(s+0; s) at s > 0 (labels cra26, cra33).

    In σ_s; at s = 0 the limit once contact 0 has broken.
    """
    return each_slider(_differentiable(lambda x, y: double_series.stress(_line(x)[0], y)[0]), slider, s)


@jax.jit
def length_continuum(slider: Slider) -> Float[Array, "..."]:
    """Length of the first precursor in the self-consistent continuum, in λc.

    It solves t(Λ) = 1; NaN where the front does not start.
    """

    def one(slider: Slider) -> Array:
        solution, _, _, first = _line(slider)
        about = expected_length(slider.height, slider.stiffness, slider.poisson)

        def excess(x: tuple[double_series.Series, Array], s: Array) -> Array:
            """Excess over the threshold, without the difference t(s) − 1.

            On soft interfaces it is as little as b.
            """
            solution, first = x
            return first + double_series.rise(solution, s)[0]

        return root_between(excess, (solution, first), jnp.zeros_like(about), 4 * about + 4)

    return each_slider(_differentiable(one), slider)


@jax.jit
def continuum_fields(slider: Slider, s: Any, x: Any) -> Fields:
    """Fields at x ≥ 0 with the front at s (labels cra28–cra33).

    They solve labels cra08, cra09 under the conditions of labels cra14, cra15, cra27, cra34–cra37; s = 0 is nucleation (labels
    cra17, cra18).

    At x = s the values are those just ahead of the front. Behind it u = t(x) + Σ_m W_m X_m + Σ_mn R_mn e^{−(κ_m+κ_n)x} X_n,
    X_m = ∫_x^s e^{−κ_m(y−x)} t(y) dy.
    """
    return Fields(*each_slider(lambda *of: tuple(_differentiable(_fields)(*of)), slider, s, x))


@in_full
def _fields(slider: Slider, s: Array, x: Array) -> Float[Array, "3"]:
    solution, upper, initial, _ = _line(slider)
    mode, stress = double_series.fields(solution, s, x, initial)
    return jnp.stack([upper @ mode, mode.sum(), stress])
