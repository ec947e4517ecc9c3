"""The Appendix, equation by equation: each against the model it says it solves, or against the step before it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import derivation as d

import slippulse_jax as sp
from slippulse_jax import theory
from slippulse_jax.theory.frozen import psi6

pytestmark = pytest.mark.ci

SLIDERS = [(25.0, 0.03, 0.3), (8.0, 0.2, 0.1), (400.0, 1e-3, 0.45)]


def of_slider(function):
    """`function(slider, *scalars)` as a compiled function of (three numbers, scalars), the same for every slider."""
    compiled = jax.jit(lambda x, *rest: function(sp.Slider(x[0], x[1], x[2]), *rest))
    return lambda x, *rest: compiled(jnp.asarray(x), *map(jnp.asarray, rest))


def with_slopes(function):
    """Value, first and second derivative in the first scalar."""

    def every(slider, x, *rest):
        def slope(y):
            value, rise = jax.jvp(lambda z: function(slider, z, *rest), (y,), (jnp.ones_like(y),))
            return rise, (value, rise)

        _, bend, (value, rise) = jax.jvp(slope, (x,), (jnp.ones_like(x),), has_aux=True)
        return value, rise, bend

    return of_slider(every)


nucleated = with_slopes(d.layer_at_nucleation)
ahead = with_slopes(d.bounded_layer_ahead)
behind = with_slopes(d.layer_behind)
steps = of_slider(lambda slider, s: (d.steps(slider, s), d.steps(slider, s, d.printed_psi6)))
front = of_slider(theory.frozen_stress)


@pytest.mark.parametrize("x", SLIDERS)
def test_nucleation_of_the_layer_under_a_frozen_upper_one(x):
    """Labels cra45, cra45b, cra45c, cra45d1, cra45d2, cra45e, cra45f: solves cra09, with a free edge, and u(0) = u_s."""
    slider = sp.Slider(*x)
    k, U0 = float(slider.kappa), float(theory.appendix(slider).U0)
    for y in (0.0, 0.7 / k, 5 / k):
        value, rise, bend = nucleated(x, y)
        held = d.held_at(slider, d.frozen_upper(slider, y), 0.0)
        np.testing.assert_allclose(bend, k**2 * (value - held), atol=1e-11 * k**2)
        np.testing.assert_allclose(d.layer_from_amplitudes(slider, y, d.edge_amplitudes(slider)), value, atol=1e-11)
        if y == 0:
            np.testing.assert_allclose(value, 1, rtol=1e-12)
            np.testing.assert_allclose(rise, float(slider.stiffness) - float(slider.K_T) * (U0 - 1), atol=1e-12)
    # with the printed ½ in front of βUκ/(κ + κ_2) the layer would grow without bound
    amplitudes = d.edge_amplitudes(slider)
    wrong = amplitudes._replace(cosh=amplitudes.cosh - (amplitudes.sinh + amplitudes.cosh) / 2)
    assert abs(d.layer_from_amplitudes(slider, 20 / k, wrong)) > 1e6
    np.testing.assert_allclose(d.frozen_upper(slider, 0.0), U0, rtol=1e-13)


@pytest.mark.parametrize("x", SLIDERS)
def test_layer_ahead_and_behind_solve_their_equation_and_meet(x):
    """Labels cra46, cra46b, cra46c, cra47, cra47b, cra47c, cra47d, cra48, and cra26 with u_b = A_3 + A_4 behind."""
    slider = sp.Slider(*x)
    k, q, KT = float(slider.kappa), float(slider.stiffness), float(slider.K_T)
    s = 3 / k
    for solution, places in ((ahead, (s, 1.3 * s, 4 * s)), (behind, (0.1 * s, 0.5 * s, s))):
        for y in places:
            value, _, bend = solution(x, y, s)
            pinned = front(x, y) if solution is behind else 0.0
            held = d.held_at(slider, d.frozen_upper(slider, y), pinned)
            np.testing.assert_allclose(bend, k**2 * (value - held), atol=1e-9 * k**2)
    np.testing.assert_allclose(ahead(x, s, s)[:2], behind(x, s, s)[:2], atol=1e-10)
    np.testing.assert_allclose(ahead(x, s, s)[0], front(x, s), rtol=1e-12)
    value, rise, _ = behind(x, 0.0, s)
    U0 = float(d.frozen_upper(slider, 0.0))
    np.testing.assert_allclose(rise, q * (value - 1) - KT * (U0 - value), atol=1e-10)
    A4 = theory.appendix(slider).A4_0 * np.exp(-float(slider.kappa_2) * s)
    y = 2.5 * s
    general = d.layer_ahead(slider, y, s, front(x, s) - A4, A4)
    np.testing.assert_allclose(general, ahead(x, y, s)[0], rtol=1e-10)
    # ℱ starts flat, and its slope is its derivative
    value, rise, _ = with_slopes(d.released_layer)(x, 0.0)
    assert value == rise == 0
    np.testing.assert_allclose(with_slopes(d.released_layer)(x, s)[1] / k, d.released_slope(slider, s), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("x", SLIDERS)
def test_every_step_from_continuity_to_the_equation_of_a3(x):
    """Labels cra49, cra50, cra49b, cra50b, cra49c1, cra50c1, cra49c, cra50c, cra51, cra55, cra54, cra54b."""
    slider = sp.Slider(*x)
    for s in np.array([0.2, 1.0, 4.0]) / float(slider.kappa):
        scale = np.exp(float(slider.kappa) * s)
        right, printed = steps(x, s)
        for name, difference in right._asdict().items():
            assert abs(difference) < 1e-11 * scale, name
        assert {name for name, v in printed._asdict().items() if abs(v) > 1e-9 * scale} == {"integral", "rate"}
        # cra54b is the derivative of cra54, corrected
        slope = jax.grad(lambda y: psi6(slider, y))(s) * np.exp(-float(slider.kappa) * s)
        np.testing.assert_allclose(slope, theory.frozen._psi6_slope(slider, s), rtol=1e-11)


@functools.cache
def appendix(x):
    return theory.appendix(sp.Slider(*x))


@pytest.mark.parametrize("x", [SLIDERS[0], SLIDERS[2]])
def test_both_ends_of_the_front_stress_and_the_curve_between(x):
    """Labels cra51b, cra56a, cra56a2, cra56b, cra56c, cra56, cra57a, cra57b, cra57c, cra58."""
    slider, a = sp.Slider(*x), appendix(x)
    k, k2 = float(slider.kappa), float(slider.kappa_2)
    value, slope, _ = with_slopes(theory.frozen_stress)(x, 1e-9)
    np.testing.assert_allclose(value, a.A0, rtol=1e-7)
    np.testing.assert_allclose(a.A0, a.A3_0 + a.A4_0, rtol=1e-14)
    np.testing.assert_allclose(slope / value, a.gamma, rtol=1e-6)
    np.testing.assert_allclose((slope + k2 * a.A4_0) / a.A3_0, a.gamma3, rtol=1e-6)
    far = 60 / k
    np.testing.assert_allclose(front(x, far) * np.exp(k2 * far), a.A_far, rtol=1e-9)
    # the fitted curve has both ends, and Λ lies where it falls to the threshold
    fitted = with_slopes(d.fitted_stress)
    np.testing.assert_allclose(fitted(x, 0.0)[:2], [a.A0, a.A0 * a.gamma], rtol=1e-9)
    far = 60 / float(a.kappa3)
    np.testing.assert_allclose(fitted(x, far)[0] * np.exp(k2 * far), a.A_far, rtol=1e-9)
    np.testing.assert_allclose(fitted(x, a.length)[0], 1, rtol=1e-10)
    y = np.exp(float(a.kappa3 * a.length))
    np.testing.assert_allclose(a.B * y, (y + a.C) ** a.alpha, rtol=1e-10)


def test_continuum_fields_have_the_form_of_the_paper():
    """Labels cra28, cra29, cra30, cra31, cra32, cra33: ũ less the integrals ū is D_11 sinh κ_1 x + … behind, D_1 e^{−κ_1(x−s)} + … ahead."""
    slider, s = sp.Slider(25.0, 0.03, 0.3), 9.0
    k = np.array([float(slider.kappa_1), float(slider.kappa_2)])
    alpha = np.array([float(slider.alpha_1), float(slider.alpha_2)])
    b1 = (1 - float(slider.beta)) * float(slider.kappa) ** 2 / (k[0] * (alpha[1] - alpha[0]))
    b = np.array([b1, -b1 * k[0] / k[1]])
    nodes, weights = np.polynomial.legendre.leggauss(30)
    x = np.linspace(0.5, 8.5, 9)
    at = x[:, None] * (1 + nodes) / 2
    pinned = np.asarray(theory.continuum_stress(slider, at))  # cra26: what the front left behind
    kernel = np.sinh(k * (x[:, None] - at)[..., None]) * b
    bar = np.einsum("ij,ijm,i->im", pinned * weights, kernel, x / 2)
    fields = theory.continuum_fields(slider, s, x)
    rest = np.concatenate([fields.upper - bar.sum(1), fields.layer - bar @ alpha])
    shapes = np.hstack([np.sinh(k * x[:, None]), np.cosh(k * x[:, None])])
    both = np.vstack([shapes, shapes * np.tile(alpha, 2)])
    found, *_ = np.linalg.lstsq(both, rest, rcond=None)
    np.testing.assert_allclose(both @ found, rest, atol=1e-10)
    y = s + np.linspace(0.0, 60, x.size)
    fields = theory.continuum_fields(slider, s, y)
    shapes = np.exp(-k * (y - s)[:, None])
    both, rest = np.vstack([shapes, shapes * alpha]), np.concatenate([fields.upper, fields.layer])
    found, *_ = np.linalg.lstsq(both, rest, rcond=None)
    np.testing.assert_allclose(both @ found, rest, atol=1e-10)
    # label cra27: nothing has broken ahead, so that the stress there is the displacement
    np.testing.assert_array_equal(fields.stress, fields.layer)


def test_nucleation_in_the_continuum_is_the_printed_one():
    """Labels cra17, cra18: D_10, D_20 and u_c as printed, with α_m as they should read."""
    slider = sp.Slider(25.0, 0.03, 0.3)
    k1, k2, k, kT = (float(getattr(slider, name)) for name in ("kappa_1", "kappa_2", "kappa", "kappa_T"))
    root = float(slider.mode_splitting)
    a1, a2 = (1 - (k**2 + root) / kT**2) / 2, (1 - (k**2 - root) / kT**2) / 2
    beta, KT = float(slider.beta), float(slider.K_T)
    x = np.linspace(0, 80, 9)
    fields = theory.continuum_fields(slider, 0.0, x)
    U = float(fields.upper[0])
    uc = U * (beta * k**2 * (k1 - k2) + KT * root) / (kT**2 * (a2 * k2 - a1 * k1) + k**2 * root)
    np.testing.assert_allclose(uc, 1, rtol=1e-12)  # contact 0 at its threshold
    D1, D2 = (a2 * U - uc) / (a2 - a1), (uc - a1 * U) / (a2 - a1)
    np.testing.assert_allclose(fields.upper, D1 * np.exp(-k1 * x) + D2 * np.exp(-k2 * x), rtol=1e-10)
    np.testing.assert_allclose(fields.layer, a1 * D1 * np.exp(-k1 * x) + a2 * D2 * np.exp(-k2 * x), rtol=1e-10)
