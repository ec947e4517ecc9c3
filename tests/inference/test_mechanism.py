"""Pulse or crack: fits of crack-like fronts, and the test between the two, on data of dense programs."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from oracles.sliding_chain import dense, nucleated
from reports import unfolded
from test_gauges import AREAL, LC, RATIO, STRENGTH, UNIT, YOUNG, table

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.cli.fit import command
from slippulse_jax.inference.model.models import front_for
from slippulse_jax.inference.parameters import parameter_set
from slippulse_jax.inference.search.likelihood import make_problem

FRICTION = 0.4


def crack_table(heights=(32.0,), noise=None):
    """As `table` of the tests of gauges, but contacts slide behind the tip: counts, slip and stress by banded solves."""
    counts, columns = [], []
    for row, height in enumerate(heights):
        sites = 2000
        load = nucleated(height, RATIO, 0.3, 0.0, sites)
        before = dense(height, RATIO, 0.3, 0, 0, 0, load, sites)[1]
        count, stress, layer = 0, np.ones(sites), before
        while count == 0 or stress[count] >= 1 - 1e-12:
            count += 1
            _, layer, stress = dense(height, RATIO, 0.3, FRICTION, 0.0, count, load, sites)
        counts.append(count)
        i = np.linspace(1, 1.3 * count, 9).round().astype(int)
        columns.append(np.stack([np.full(9, row), i * LC, (layer - before)[i] * UNIT, stress[i] * STRENGTH]))
    row, position, slip, stress = np.concatenate(columns, axis=1)
    sigma = 0.05e-6, 0.06e6
    if noise is not None:
        slip, stress = slip + sigma[0] * noise.standard_normal(len(slip)), stress + sigma[1] * noise.standard_normal(len(slip))
    return sp.Measurements(
        height=heights, poisson=0.3, length=counts, length_sigma=0.0, kind=("whole",) * len(heights),
        correlation_length=LC, young=YOUNG, gauges=sp.Gauges(row, position, slip, sigma[0], stress, sigma[1]),
    )  # fmt: skip


@pytest.mark.ci
@pytest.mark.slow
def test_a_crack_gives_its_parameters_back():
    result = sp.fit(crack_table(), ["stiffness", "strength", "friction"], event="crack")
    assert result.values["areal_stiffness"] == pytest.approx(AREAL, rel=1e-5)
    assert result.values["strength"] == pytest.approx(STRENGTH, rel=1e-5)
    assert result.values["friction"] == pytest.approx(FRICTION, rel=1e-4)
    assert result.converged
    assert "uniform thresholds, crack-like fronts, " in unfolded(result.report())
    assert "first crack-like precursor" in result.report(verbose=True)
    assert set(result.front_status) == {Outcome.ARRESTED}


@pytest.mark.slow
@pytest.mark.parametrize("truth", ["pulse", "crack"])
def test_gauges_tell_a_pulse_from_a_crack(truth):
    noise = np.random.default_rng(5)
    m = crack_table(noise=noise) if truth == "crack" else table(noise=noise, heights=(32.0,))
    found = sp.pulse_or_crack(m, ["stiffness", "strength"], simulations=20)
    assert found.statement.startswith("a crack-like" if truth == "crack" else "a self-healing")
    assert found.difference > 0 if truth == "crack" else found.difference < 0
    assert found.power > 0.9
    assert found.power_of_pulse > 0.9
    assert f"Pulse or crack: {found.statement}" in str(found)


def test_lengths_of_one_height_do_not():
    slider = sp.Slider(25.0, 0.03, 0.3)
    m = sp.Measurements(25.0, 0.3, float(sp.exact_length(slider)), 0.5)
    found = sp.pulse_or_crack(m, simulations=20)
    assert "lengths alone cannot separate a pulse from a crack" in found.statement
    assert found.crack.deviance < 1e-6


@pytest.mark.ci
def test_lengths_of_cracks_are_fitted_and_traced(tmp_path):
    """Values and derivatives of the objective, by differences of the closed form and by JAX."""
    import jax

    height = np.array([20.0, 40.0, 80.0])
    length = [float(sp.exact_length(sp.Slider(h, 0.004, 0.3), rule=sp.CrackLike(0.3))) for h in height]
    m = sp.Measurements(height, 0.3, length, 0.01 * np.array(length))
    result = sp.fit(m, fixed={"friction": 0.3}, event="crack")
    path = tmp_path / "lengths.csv"
    rows = zip(m.height, m.length, m.sigma, strict=True)
    path.write_text("height,poisson,length,length_sigma\n" + "".join(f"{h},0.3,{x:.17g},{s:.17g}\n" for h, x, s in rows))
    done = CliRunner().invoke(command, [str(path), "--event", "crack", "--fix", "friction=0.3", "--json"])
    assert json.loads(done.stdout)["values"]["stiffness"] == pytest.approx(result.values["stiffness"], rel=1e-9)
    assert result.values["stiffness"] == pytest.approx(0.004, rel=1e-5)
    theta = result.theta + 0.02
    found = result.problem(theta, order=1)
    with jax.enable_x64(True):
        value, slope = jax.jit(jax.value_and_grad(result.problem.traced))(jax.numpy.asarray(theta))
    assert float(value) == pytest.approx(found.value[0], rel=1e-9)
    np.testing.assert_allclose(slope, found.gradient[0], rtol=1e-5)


@pytest.mark.ci
def test_second_derivatives_where_there_is_no_friction():
    """Differences stay within the range: a crack with less than none has no length."""
    m = sp.Measurements([20.0, 40.0], 0.3, [15.0, 30.0], 0.3)
    problem = make_problem(m, parameter_set(m, ["stiffness", "friction"], front_for("slider", "crack")))
    at, near = (problem(np.array([[np.log(0.004), x]]), order=2).curvature for x in (0.0, 1e-3))
    np.testing.assert_allclose(at, near, rtol=0.05)  # one-sided at the limit


@pytest.mark.ci
def test_the_pulse_may_be_a_whole_event():
    """What `event` says is of the pulse's lengths; a crack is fitted in any case."""
    m = sp.Measurements([20.0, 30.0], 0.3, [15.0, 20.0], 0.3)
    with pytest.raises(ValueError, match=r"event = 'crack': both fronts are fitted"):
        sp.pulse_or_crack(m, event="crack")
    found = sp.pulse_or_crack(m, event="full", simulations=20)
    assert (found.pulse.parameters.front.event, found.crack.parameters.front.event) == ("full", "crack")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"event": "crack"}, r"friction is neither fitted nor held"),
        ({"free": ["stiffness", "friction"]}, r"parameter friction: .* event = 'crack'"),
        (
            {"free": ["stiffness", "threshold_slope", "friction"], "event": "crack"},
            r"threshold_slope: .* level thresholds only",
        ),
        ({"event": "slip"}, r"event = 'slip': must be one of 'domino', 'full', 'crack'"),
    ],
)
def test_refusals(options, message):
    m = sp.Measurements([20.0, 30.0], 0.3, [15.0, 20.0], 0.3)
    with pytest.raises(ValueError, match=message):
        sp.fit(m, **options)
