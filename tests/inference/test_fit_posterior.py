"""The posterior: the traced density is the objective of the fit; NUTS, profile and bootstrap agree on a well-posed study (slow).

The traced length takes a minute to compile inside the sampler. The slow test uses it, and it has a test of its own; elsewhere
the lengths that a fit works with stand in for it.
"""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest
from click.testing import CliRunner

from slippulse_jax import Measurements, Parameter, fit
from slippulse_jax.cli.fit import command
from slippulse_jax.inference.fit import FitResult
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.parameters import observables_of, parameter_set
from slippulse_jax.inference.result.samples import Samples
from slippulse_jax.inference.search.likelihood import make_problem

ROOT = Path(__file__).resolve().parents[2]
DATA = str(ROOT / "fit_examples/pmma_block/lengths.csv")


@pytest.mark.parametrize("loss", ["normal", pytest.param("student", marks=pytest.mark.ci)])
def test_density_is_the_objective(loss):
    """At random points, with counts, censoring and a prior."""
    m = Measurements(
        height=[20, 30, 40], poisson=0.3, length=[15, 24, 30], length_sigma=[0.5, 0.6, 0.7], kind=["length", "whole", "at_least"]
    )  # fmt: skip
    q = parameter_set(m, ["stiffness", Parameter("poisson", prior=(0.3, 0.02))], observables=observables_of(FirstFront(), loss))
    problem = make_problem(m, q)
    theta = np.random.default_rng(0).uniform([-7, 0.2], [-4, 0.4], (4, 2))
    density = jax.jit(jax.vmap(problem.traced))(theta)
    np.testing.assert_allclose(density, problem(theta).value, rtol=1e-9)


@pytest.fixture(scope="module")
def sampled(tmp_path_factory):
    """A fit, four chains of its posterior, and what sampling said; compiled as users' programs are, which run five times as fast."""
    path = tmp_path_factory.mktemp("posterior") / "drawn.npz"
    code = (
        "import sys, numpy, slippulse_jax as sp\n"
        "drawn = sp.fit(sys.argv[1]).posterior(samples=150, warmup=100, seed=3)\n"
        "numpy.savez(sys.argv[2], theta=drawn.theta, diverging=drawn.diverging)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, DATA, path], capture_output=True, text=True, cwd=ROOT, env=os.environ | {"XLA_FLAGS": ""}
    )
    assert done.returncode == 0, done.stderr
    result, drawn = fit(DATA), np.load(path)
    samples = Samples("posterior", 3, result.parameters.free, drawn["theta"], diverging=drawn["diverging"])
    return result, samples, done.stderr


@pytest.mark.ci
def test_command_line(sampled, monkeypatch):
    """`slippulse fit --posterior`: four chains whose interval is that of the profile, in the report and as JSON."""
    asked = []
    monkeypatch.setattr(FitResult, "posterior", lambda _, **request: asked.append(request) or sampled[1])
    done = CliRunner().invoke(command, [DATA, "--posterior", "150", "--seed", "3", "--json"])
    assert done.exit_code == 0, done.output
    assert asked == [{"samples": 150, "seed": 3}]
    found = json.loads(done.stdout)
    drawn, name = found["posterior"], "areal_stiffness"
    assert (drawn["chains"], drawn["samples"], drawn["seed"]) == (4, 150, 3)
    assert drawn["rhat"][name] < 1.05
    assert drawn["ess"][name] > 100
    assert drawn["divergences"] == 0
    # a mean of 100 independent samples: a tenth of a standard error
    assert abs(drawn["mean"][name] - found["values"][name]) < 0.5 * found["stderr"][name]
    assert drawn["stderr"][name] == pytest.approx(found["stderr"][name], rel=0.2)


@pytest.mark.ci
def test_arviz_takes_the_posterior(sampled):
    """Its summary and plots work on what is returned; so does the corner, on samples of either kind."""
    az = import_arviz()
    result, drawn, said = sampled
    assert said.startswith("sampling 4 chains of 250 steps; the first compiles\n")
    tree = drawn.to_arviz()
    table = az.summary(tree)
    assert list(table.index) == ["areal_stiffness"]
    summary = drawn.to_dict()
    assert table["mean"].iloc[0] == pytest.approx(summary["mean"]["areal_stiffness"], rel=1e-3)
    assert table["r_hat"].iloc[0] == pytest.approx(summary["rhat"]["areal_stiffness"], abs=0.01)
    assert table["ess_bulk"].iloc[0] == pytest.approx(summary["ess"]["areal_stiffness"], abs=1)
    assert tree["posterior"]["areal_stiffness"].attrs["units"] == "Pa/m"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Matplotlib's about ArviZ
        az.plot_trace(tree)
    assert drawn.theta.shape == (4, 150, 1)
    np.testing.assert_allclose(np.exp(drawn.theta).ravel(), drawn.of("areal_stiffness"))
    refits = result.bootstrap(5)
    assert refits.theta.shape == (5, 1)
    assert az.summary(refits.to_arviz(), kind="stats")["mean"].iloc[0] == pytest.approx(refits.values.mean(), rel=1e-3)


def import_arviz():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of its own next version
        import arviz
    return arviz


def test_missing_sampler_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "numpyro", None)
    done = CliRunner().invoke(command, [DATA, "--posterior", "10"])
    assert done.exit_code == 2
    assert "pip install 'slippulse_jax[bayes]'" in done.output


class Drawn:
    """Stands in for NumPyro's MCMC: samples at the middle of the range, of which some diverged."""

    diverged = 0

    def __init__(self, *_, num_samples, num_chains, **__):
        self.shape = (num_chains, num_samples)

    def run(self, *_, init_params, **__):
        self.parameters = init_params.shape[-1]

    def get_samples(self, group_by_chain):
        return np.zeros((*self.shape, self.parameters))

    def get_extra_fields(self, group_by_chain):
        return {"diverging": np.arange(np.prod(self.shape)).reshape(self.shape) < self.diverged}


@pytest.mark.ci  # which have NumPyro
@pytest.mark.parametrize("kind", ["length", "whole"])
def test_samples_that_diverged_are_said(kind, monkeypatch):
    monkeypatch.setattr("numpyro.infer.MCMC", Drawn)
    result = fit(
        Measurements([10.0, 20, 30], 0.3, length=[7.0, 15, 24], length_sigma=[0.5 * (kind == "length")] * 3, kind=kind)
    )
    assert not result.posterior(samples=20, progress=False).diverging.any()
    monkeypatch.setattr(Drawn, "diverged", 7)
    with pytest.warns(RuntimeWarning, match="^7 of 80 samples diverged") as said:
        assert result.posterior(samples=20, progress=False).diverging.sum() == 7
    assert ("counts" in str(said[0].message)) == (kind == "whole")
    assert said[0].filename == __file__


@pytest.mark.slow  # the sampler takes minutes to compile
def test_posterior_profile_and_bootstrap_agree():
    height = np.array([15.0, 20, 25, 30, 40, 50])
    length = FirstFront().lengths(Inputs.of(height, 0.004, 0.3))
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
        assert found.stderr("stiffness") == pytest.approx(result.stderrs["stiffness"], rel=0.1)
