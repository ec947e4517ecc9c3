"""The theory at small and large parameters, against its formulas at 50 digits: nothing is lost to cancellation."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles.lattice_mp import Chain, Line
from strategies import random_sliders

import slippulse_jax as sp
from slippulse_jax import theory

SMALL_AND_LARGE = 10.0 ** np.arange(-12, 13, 3)  # b → 0 and ∞ are β → 1 and 0
# κ_2 → 0 with H, b → 0 with k, b → ∞ with both, and the middle
SLIDERS = [(1e5, 1e-6, 0.0), (1e5, 1.0, 0.5), (5.0, 1e-6, 0.5), (5.0, 1.0, 0.0), (1e8, 1e-12, 0.3), (25.0, 0.03, 0.3)]


@pytest.fixture(autouse=True)
def fifty_digits():
    with mp.workdps(50):
        yield


def relative(found, expected):
    return abs(float((mp.mpf(float(found)) - expected) / expected))


def law(b, nu, phi):
    """Λ/H of the macroscopic law: e^{−p}(1 + φ∫e^p) = (1 + β)/2."""
    b, nu, phi = mp.mpf(b), mp.mpf(nu), mp.mpf(phi)
    beta = 1 / (1 + b)

    def p(y):
        return (y + beta / 2 * (1 - mp.exp(-2 * y))) / (1 + beta)

    def excess(z):
        held = mp.quad(lambda y: mp.exp(p(y)), [0, z]) if phi else 0
        return mp.exp(-p(z)) * (1 + phi * held) - (1 + beta) / 2

    unit = mp.sqrt(2 * (1 + nu) * (1 + 1 / b))
    guess = float(theory.macroscopic_length(float(b), float(nu), prestress=float(phi))) / unit
    z = mp.findroot(excess, (guess * mp.mpf("0.99"), guess * mp.mpf("1.01")), tol=mp.mpf(10) ** -80)
    return z * unit, z, beta


def test_macroscopic_law_and_its_correction():
    found = theory.macroscopic_length(SMALL_AND_LARGE, 0.3)
    corrections = theory.macroscopic_correction(SMALL_AND_LARGE, 0.3)
    for b, length, correction in zip(SMALL_AND_LARGE, found, corrections, strict=True):
        expected, z, beta = law(b, 0.3, 0)
        assert relative(length, expected) < 1e-10, b

        def g(y, beta=beta):
            return (1 + beta * mp.exp(-2 * y)) / (1 + beta)

        integral = mp.quad(lambda y: (1 - mp.exp(-2 * y)) * g(y), [0, z])
        ratio, layer = (1 - beta) / (1 + beta), 1 + (1 - beta) * g(z) / (1 + beta)
        layer = mp.sqrt(beta * (1 - beta)) * (layer + beta * (1 - beta) / (1 + beta) ** 2 * integral)
        nu = mp.mpf(0.3)
        lag = mp.sqrt((1 + mp.mpf(b)) / (2 * (1 + nu))) * ratio / 2
        lag *= 1 + beta / (1 + beta) * (z - (1 - mp.exp(-2 * z)) / 2)
        assert relative(correction, (layer - lag) / g(z) * expected / z) < 1e-10, b


@pytest.mark.ci
@pytest.mark.parametrize("phi", [1e-9, 0.3, -0.4])
def test_macroscopic_law_with_prestress(phi):
    for b in (1e-6, 1.0, 1e9):
        assert relative(theory.macroscopic_length(b, 0.3, prestress=phi), law(b, 0.3, phi)[0]) < 1e-10, b


@pytest.mark.parametrize("x", SLIDERS)
def test_closed_forms(x):
    H, q, nu = (mp.mpf(v) for v in x)
    slider = sp.Slider(*x)
    chain = Chain(*x)
    assert relative(theory.runaway_prestress(slider), (1 + chain.w[0] + chain.w[1]) / 2) < 1e-10
    KT = 1 / (2 * (1 + nu) * H)
    k, beta, kT2 = mp.sqrt(q + KT), KT / (KT + q), KT / H
    k1 = mp.sqrt((k**2 + kT2 + mp.sqrt((k**2 - kT2) ** 2 + 4 * beta * k**2 * kT2)) / 2)
    k2 = mp.sqrt(kT2 * q) / k1
    bracket = (1 + beta - 2 * k2 / k) * (1 + k2 / (1 + k))
    assert relative(theory.length_eq25(slider), mp.log(2 / bracket) / k2) < 1e-10
    B = beta + (1 - beta) * k / mp.sqrt(4 + k**2)
    L, c = mp.log(2 / (1 + B)), mp.mpf("1.93") - mp.mpf("0.83") * beta
    P = k / k2 * (L + beta * (L - mp.mpf(1) / 2 + (1 + B) ** 2 / 8) / (1 + B - beta + beta * (1 + B) ** 2 / 4))
    fading = c * (1 - (1 + mp.mpf("1.15") * P / c) ** -2)
    line = (P + fading) / k - mp.mpf("0.29") - mp.mpf("0.12") * beta
    if line > 0.1:  # near zero the fitted constants cancel, by their nature
        assert relative(theory.envelope_length(slider), line) < 1e-10


@jax.jit
def levels(x):
    slider = sp.Slider(x[0], x[1], x[2])
    frozen, continuum = theory.length_frozen(slider), theory.length_continuum(slider)
    at = jnp.where(jnp.isfinite(continuum), continuum, 1)
    return frozen, continuum, theory.frozen_stress(slider, at), theory.continuum_stress(slider, at)


@pytest.mark.slow
@pytest.mark.parametrize("x", SLIDERS)
def test_continuum_at_both_levels(x):
    frozen, continuum, frozen_stress, continuum_stress = levels(jnp.asarray(x))
    line = Line(*x)
    at = mp.mpf(float(continuum)) if np.isfinite(continuum) else mp.mpf(1)
    t = line.series(36)
    assert relative(continuum_stress, t(at)) < 1e-10
    assert relative(frozen_stress, line.frozen(at)) < 1e-10
    if np.isfinite(continuum):
        # relative to a length that starts from zero: the stress exceeds the threshold by no more than b
        assert abs(float((t(at) - 1) / mp.diff(t, at) / at)) < 1e-10
    if np.isfinite(frozen):
        at = mp.mpf(float(frozen))
        stress = line.frozen(at)
        assert abs(float((stress - 1) / line.frozen_slope(at, stress) / at)) < 1e-10


def eq58_against_line(sliders):
    """Worst relative error of Eq. (58); both sides must find a length, or none, on the same sliders."""
    found = np.asarray(theory.length(sp.Slider(*sliders.T)))
    expected = [Line(*x).fitted_length() for x in sliders]
    np.testing.assert_array_equal(np.isnan(found), [mp.isnan(x) for x in expected])
    return max(relative(x, y) for x, y in zip(found, expected, strict=True) if not mp.isnan(y))


@pytest.mark.ci
def test_eq58_from_the_frozen_equation_alone():
    """Labels cra56b, cra56c, cra57a, cra57b, cra57c and cra58, at 50 digits; also where A_0 − 1 is 1e-5, 1e-7 and 1e-9."""
    assert eq58_against_line(random_sliders(60, 5)) < 1e-10
    was_nan = (23.156242840195386, 1.5328414322453369e-06, 0.44676401889863576)
    for slider, start in ((was_nan, 1e-5), ((23.0, 1.5e-8, 0.45), 1e-7), ((23.0, 1.5e-10, 0.45), 1e-9)):
        assert eq58_against_line(np.array([slider])) < 20 * np.finfo(float).eps / start


@pytest.mark.slow
def test_eq58_over_two_thousand_sliders():
    assert eq58_against_line(random_sliders(2000, 6)) < 1e-10


@pytest.mark.ci
def test_edge_and_tail_that_eq58_is_fitted_to_are_those_of_the_integrated_stress():
    # the reference of the reference: value, slope and tail of the quadrature
    line = Line(25, 0.03, 0.3)
    first, slope, far = line.edge_and_tail()
    step = mp.mpf(10) ** -12
    assert abs(line.frozen(step) / first - 1 - slope * step) < 1e-20
    at = 3 / line.kappa
    assert relative(line.frozen_slope(at, line.frozen(at)), mp.diff(line.frozen, at)) < 1e-15
    s = 100 / line.kappa
    assert relative(line.frozen(s) * mp.exp(line.k[1] * s), far) < 1e-15
