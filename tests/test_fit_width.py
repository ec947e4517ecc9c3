"""The width of the smooth break rule as a parameter of a fit."""

import numpy as np
import pytest
from reports import unfolded

import slippulse_jax as sp
from slippulse_jax.inference.likelihood import Loss, make_problem
from slippulse_jax.inference.parameters import parameter_set
from slippulse_jax.inference.verdict import Identifiability

HEIGHTS = np.array([12.0, 15.0, 20.0, 30.0, 45.0, 70.0])
RATIO, WIDTH = 0.01, 0.01


def data(width=WIDTH, **given):
    length = sp.precursor_lengths(sp.Slider(HEIGHTS, RATIO, 0.3), rule=sp.SmoothBreak(width))
    return sp.Measurements(height=HEIGHTS, poisson=0.3, length=length, length_sigma=0.02 * length, **given)


def test_gradient_is_that_of_the_value():
    m = data()
    problem = make_problem(m, parameter_set(m, ["stiffness", "width", "poisson"]), Loss(), m.sigma)
    theta, step = np.array([np.log(0.011), np.log(0.03), 0.29]), 1e-5 * np.eye(3)
    slope = (problem(theta + step).value - problem(theta - step).value) / 2e-5
    np.testing.assert_allclose(problem(theta, order=1).gradient[0], slope, rtol=1e-5)


def test_a_width_held_is_the_rule_the_lengths_are_computed_with():
    """With it the stiffness comes back; the hard rule's is off by the bias of the smooth length."""
    m = data()
    held, hard = sp.fit(m, fixed={"width": WIDTH}), sp.fit(m)
    assert held.values["stiffness"] == pytest.approx(RATIO, rel=1e-6)
    np.testing.assert_allclose(held.fitted.length, m.length, rtol=1e-6)
    assert abs(hard.values["stiffness"] / RATIO - 1) > 0.05
    assert "and the smooth break rule" in unfolded(held.report())
    assert "exact length" in hard.report(verbose=True)


def test_stiffness_and_width_together():
    """Both come back from exact lengths; with errors of 2 % the report knows that lengths cannot tell them apart."""
    result = sp.fit(data(), [sp.Parameter("stiffness", bounds=(3e-3, 3e-2)), "width"])
    assert result.values["stiffness"] == pytest.approx(RATIO, rel=1e-3)
    assert result.values["width"] == pytest.approx(WIDTH, rel=1e-2)
    assert result.correlations["stiffness", "width"] > 0.9
    assert result.verdicts["width"].identifiability is Identifiability.UNINFORMATIVE
    assert result.stderrs["width"] is None
    assert (result.attainable > sp.precursor_lengths(sp.Slider(HEIGHTS, RATIO, 0.3))).all()
    assert (result.attainable < 1.118 * HEIGHTS).all()
    with pytest.raises(ValueError, match="the hard break rule"):
        result.posterior()


@pytest.mark.parametrize(
    ("given", "asked", "message"),
    [
        ({"prestress": 0.1}, ["stiffness", "width"], "relaxed, uniform interfaces, without prestress"),
        ({}, ["stiffness", "width", "threshold_slope"], "without threshold_slope"),
        ({}, ["stiffness", sp.Parameter("width", bounds=(1e-8, 0.1))], "must lie in 1e-6 to 0.1"),
    ],
)
def test_refusals(given, asked, message):
    with pytest.raises(ValueError, match=message):
        sp.fit(data(**given), asked)
