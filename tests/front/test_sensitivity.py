"""Reverse mode through a sweep of the front against differences, against the surrogate's own derivatives, and against what it must be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.bodies.chain import chain
from slippulse_jax.events.rupture import nucleate, rupture
from slippulse_jax.front.arrest import arrest
from slippulse_jax.front.sensitivity import sensitivity
from slippulse_jax.rules import SmoothBreak

pytestmark = pytest.mark.ci

FIG2 = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)
SITES = 200
RULES = [None, SmoothBreak(width=0.02), SmoothBreak(width=1e-3)]


def fields(seed):
    rng = np.random.default_rng(seed)
    return 1 + 0.02 * rng.uniform(-1, 1, SITES), 0.1 * rng.uniform(0, 1, SITES)


@pytest.mark.parametrize("rule", RULES, ids=repr)
def test_every_contact_against_differences(rule):
    theta, phi = fields(1)
    run = jax.jit(lambda theta, phi: sensitivity(FIG2, sp.Profile(theta, phi), sites=SITES, rule=rule))
    found = run(theta, phi)
    lengths = jax.jit(jax.vmap(lambda theta, phi: run(theta, phi).length))
    assert found.complete
    h = 1e-6
    steps = h * np.eye(SITES)
    same = np.zeros_like(steps)
    by_theta = (lengths(theta + steps, phi + same) - lengths(theta - steps, phi + same)) / (2 * h)
    by_phi = (lengths(theta + same, phi + steps) - lengths(theta + same, phi - steps)) / (2 * h)
    scale = np.abs(found.prestress).max()
    np.testing.assert_allclose(found.threshold, by_theta, atol=1e-5 * scale)
    np.testing.assert_allclose(found.prestress, by_phi, atol=1e-5 * scale)


def test_length_is_that_of_recursion_surrogate_and_cascade():
    line = arrest(FIG2, sp.Profile(np.ones(1)), most=1000).length  # which the sensitivity ends on
    np.testing.assert_allclose(sensitivity(FIG2, sites=SITES).length, line, rtol=1e-12)
    rule = SmoothBreak(width=0.02)
    found = sensitivity(FIG2, sites=SITES, rule=rule)
    np.testing.assert_allclose(found.length, sp.precursor_length(FIG2, rule=rule), rtol=1e-12)
    theta, phi = fields(2)
    theta[0], phi[0] = 0.9, 0.0
    c = chain(FIG2, sites=80, threshold=theta[:80], prestress=phi[:80])
    state, site = nucleate(c)
    event = jax.tree.map(np.asarray, rupture(c, state, trigger=site))
    assert site == 0
    n = int(event.breaks)
    np.testing.assert_array_equal(event.order[:n], np.arange(n))
    found = sensitivity(FIG2, sp.Profile(theta, phi), sites=SITES)
    np.testing.assert_allclose(found.length, event.length, rtol=1e-10)
    np.testing.assert_allclose(np.asarray(found.stress)[:n], event.released[:n], rtol=1e-10)


def test_it_is_the_reverse_mode_of_the_surrogate_in_a_chain():
    theta, phi = (jnp.asarray(x) for x in fields(3))
    theta = theta.at[0].set(0.9)
    rule = SmoothBreak(width=0.02)

    def length(theta, phi):
        c = chain(FIG2, sites=SITES, threshold=theta, prestress=phi)
        state, site = nucleate(c)
        return rupture(c, state, trigger=site, rule=rule).length

    by_theta, by_phi = jax.jit(jax.grad(length, (0, 1)))(theta, phi)
    found = sensitivity(FIG2, sp.Profile(theta, phi), sites=SITES, rule=rule)
    np.testing.assert_allclose(found.threshold, by_theta, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.prestress, by_phi, rtol=1e-7, atol=1e-9)


def test_stress_scale_does_not_matter():
    """Λ is independent of σ_s: raising every threshold and prestress by the same factor changes nothing (claim C6)."""
    theta, phi = fields(4)
    found = sensitivity(FIG2, sp.Profile(theta, phi), sites=SITES)
    np.testing.assert_allclose(found.threshold @ theta + found.prestress @ phi, 0, atol=1e-9 * np.abs(found.threshold).max())


def test_under_the_hard_rule_only_the_first_and_the_last_two_thresholds_matter():
    found = jax.tree.map(np.asarray, sensitivity(FIG2, sites=SITES))
    assert np.flatnonzero(found.threshold).tolist() == [0, 25, 26]
    assert np.all(found.prestress[1:27] > 0)
    assert not found.prestress[27:].any()


def test_a_front_that_does_not_end_within_the_sites_says_so():
    for rule in RULES:
        found = sensitivity(FIG2, sites=20, rule=rule)
        assert not found.complete
        assert np.isnan(found.length)
        assert np.isnan(found.prestress).all()


@pytest.mark.parametrize("double", [True, False])
def test_under_strict_promotion(double):
    """No number changes its type by itself."""
    with jax.numpy_dtype_promotion("strict"), jax.enable_x64(double):
        for rule in RULES[:2]:
            for interface in (None, sp.Interface(0.1, 0.01), sp.Profile(threshold=np.ones(10))):
                found = sp.sensitivity(sp.Slider(10.0, 0.03, 0.3), interface, sites=40, rule=rule)
                assert found.length.dtype == found.prestress.dtype == (jnp.float64 if double else jnp.float32)
                assert bool(found.complete)
