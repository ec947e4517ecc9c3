"""The posterior: the traced density is the objective of the fit; NUTS, profile and bootstrap agree on a well-posed study (slow)."""

import jax
import numpy as np
import pytest

from slippulse_jax import Measurements, Parameter, fit
from slippulse_jax.inference import bayes
from slippulse_jax.inference.forward import lengths
from slippulse_jax.inference.likelihood import Loss
from slippulse_jax.inference.objective import make_problem
from slippulse_jax.inference.resolve import resolve


def outside(plain, y):
    """The length from the batches that a fit works with, called from within a compiled function."""
    del plain
    shape = jax.ShapeDtypeStruct((), y.dtype)
    return jax.pure_callback(lambda y: lengths(np.atleast_2d(y), 0).value[0], shape, y, vmap_method="sequential")


@pytest.mark.parametrize("loss", ["normal", "student"])
def test_density_is_the_objective(loss, monkeypatch):
    """At random points, with counts, censoring, discrepancy and a prior."""
    monkeypatch.setattr(bayes, "_length", outside)  # the traced length takes long to compile; it has a test of its own
    m = Measurements(
        height=[20, 30, 40], poisson=0.3, length=[15, 24, 30], length_sigma=[0.5, 0.6, 0.7], kind=["length", "whole", "at_least"]
    )  # fmt: skip
    q = resolve(m, ["stiffness", Parameter("poisson", prior=(0.3, 0.02)), "discrepancy"])
    problem = make_problem(m, q, Loss(loss), m.sigma)
    theta = np.random.default_rng(0).uniform([-7, 0.2, -5], [-4, 0.4, -2], (4, 3))
    density = jax.jit(jax.vmap(bayes.log_density(problem)))(theta)
    np.testing.assert_allclose(-np.asarray(density), problem(theta).value, rtol=1e-9)


@pytest.mark.parametrize("plain", [True, False])
def test_traced_length_is_that_of_the_fit(plain):
    y = np.array([3.2, -4.5, 0.3, 0.0 if plain else 0.1, 0.0])
    assert float(bayes._length(plain, y)) == pytest.approx(lengths(y[None], 0).value[0], rel=1e-11)


@pytest.mark.slow  # the sampler takes minutes to compile
def test_posterior_profile_and_bootstrap_agree():
    height = np.array([15.0, 20, 25, 30, 40, 50])
    y = np.column_stack([np.log(height), np.full(6, np.log(0.004)), np.full(6, 0.3), np.zeros((6, 2))])
    length = lengths(y, 0).value
    rng = np.random.default_rng(1)
    m = Measurements(
        height=height, poisson=0.3, length=length * (1 + 0.01 * rng.standard_normal(6)), length_sigma=0.01 * length
    )
    result = fit(m)
    drawn = result.posterior(samples=1000, warmup=500)
    assert drawn.converged, drawn
    profile = result.intervals["stiffness"][0.95][0]
    width = profile.high - profile.low
    for found in (drawn, result.bootstrap(2000)):
        low, high = found.interval("stiffness")
        # ends of a 95 % interval from 1000 independent samples: 0.09 standard errors, a quarter of a tenth of its width
        assert abs(low - profile.low) < 0.08 * width
        assert abs(high - profile.high) < 0.08 * width
        assert found.stderr("stiffness") == pytest.approx(result.stderr["stiffness"], rel=0.1)
