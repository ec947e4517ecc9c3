"""The posterior: the traced density is the objective of the fit; NUTS, profile and bootstrap agree on a well-posed study (slow).

The traced length takes a minute to compile inside the sampler. The slow test uses it, and it has a test of its own; elsewhere
the lengths that a fit works with stand in for it.
"""

import json
import sys
from functools import partialmethod
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

from slippulse_jax import Measurements, Parameter, fit, read_measurements
from slippulse_jax.cli.fit import command
from slippulse_jax.inference import bayes
from slippulse_jax.inference.forward import lengths
from slippulse_jax.inference.likelihood import Loss
from slippulse_jax.inference.objective import make_problem
from slippulse_jax.inference.parameters import STIFFEST
from slippulse_jax.inference.resolve import resolve, softest
from slippulse_jax.inference.result import FitResult

DATA = str(Path(__file__).resolve().parent.parent / "fit_examples/pmma_block/lengths.csv")


def outside(plain, y):
    """The length from the batches that a fit works with, called from within a compiled function."""
    del plain
    shape = jax.ShapeDtypeStruct((), y.dtype)
    return jax.pure_callback(lambda y: lengths(np.atleast_2d(y), 0).value[0], shape, y, vmap_method="sequential")


def tabulated(m):
    """The length of measurements of which the stiffness alone is fitted, from a table of it."""
    log_height, first = np.unique(np.log(m.height), return_index=True)
    log_stiffness = np.linspace(np.log(softest(m).min()), np.log(STIFFEST), 6001)
    y = np.zeros((len(first), len(log_stiffness), 5))
    y[:, :, 0], y[:, :, 1], y[:, :, 2] = log_height[:, None], log_stiffness, m.poisson[first][:, None]
    table = lengths(y.reshape(-1, 5), 0).value.reshape(y.shape[:2])

    def length(plain, y):
        row = jnp.argmin(jnp.abs(log_height - y[0]))
        return jnp.interp(y[1], log_stiffness, jnp.asarray(table)[row])

    return length


@pytest.mark.parametrize("loss", ["normal", "student"])
def test_density_is_the_objective(loss, monkeypatch):
    """At random points, with counts, censoring, discrepancy and a prior."""
    monkeypatch.setattr(bayes, "_length", outside)
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


def test_command_line(monkeypatch):
    """`slippulse fit --posterior`: four chains whose interval is that of the profile, in the report and as JSON."""
    monkeypatch.setattr(bayes, "_length", tabulated(read_measurements(DATA)))
    monkeypatch.setattr(FitResult, "posterior", partialmethod(FitResult.posterior, warmup=100))
    done = CliRunner().invoke(command, [DATA, "--posterior", "150", "--seed", "3", "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    drawn, name = found["posterior"], "areal_stiffness"
    assert (drawn["chains"], drawn["samples"], drawn["seed"]) == (4, 150, 3)
    assert drawn["rhat"][name] < 1.05
    assert drawn["ess"][name] > 100
    assert drawn["divergences"] == 0
    # a mean of 100 independent samples: a tenth of a standard error
    assert abs(drawn["mean"][name] - found["values"][name]) < 0.5 * found["stderr"][name]
    assert drawn["stderr"][name] == pytest.approx(found["stderr"][name], rel=0.2)


def test_missing_sampler_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "numpyro.diagnostics", None)
    done = CliRunner().invoke(command, [DATA, "--posterior", "10"])
    assert done.exit_code == 2
    assert "pip install 'slippulse_jax[bayes]'" in done.output


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
