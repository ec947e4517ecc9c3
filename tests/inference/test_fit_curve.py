"""Curves of a fit between and beyond its measurements, against lengths computed without it."""

import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.inference.search import intervals

MEASURED, OTHERS = np.array([20.0, 40.0, 80.0]), np.array([12.0, 30.0, 55.0, 140.0])
FACTOR, OFFSET = 1.2, 0.7


def model(height, stiffness, poisson=0.3):
    return sp.precursor_lengths(sp.Slider(height, stiffness, poisson))


def fitted(stiffness=0.01, free=("stiffness",), **columns):
    """The fit of lengths of the model, measured on another scale and from another edge."""
    length = FACTOR * model(MEASURED, stiffness) + OFFSET
    m = sp.Measurements(MEASURED, 0.3, length, 0.3, **columns)
    return sp.fit(m, free, fixed={"model_factor": FACTOR, "offset": OFFSET}, intervals="profile")


@pytest.mark.ci
def test_lengths_at_other_heights_are_model():
    result = fitted()
    curve = result.curve([0, 1, 2], OTHERS)
    np.testing.assert_allclose(curve.length, FACTOR * model(OTHERS, result.values["stiffness"]) + OFFSET, rtol=1e-9)
    ratio = np.array([[0.003], [0.2]])
    family = result.curve(0, OTHERS, np.log(ratio))
    np.testing.assert_allclose(family.length, FACTOR * model(OTHERS, ratio) + OFFSET, rtol=1e-9)
    status = [[int(sp.first_precursor(sp.Slider(h, float(k), 0.3)).status) for h in OTHERS] for (k,) in ratio]
    np.testing.assert_array_equal(family.breaks_again, np.array(status) == Outcome.REBREAK)
    assert family.breaks_again.any()
    assert not family.breaks_again.all()


@pytest.mark.ci
def test_no_stiffness_gives_more_than_the_longest():
    result = fitted()
    ratio = np.exp(np.linspace(result.parameters.low[0], result.parameters.high[0], 4001))[:, None]
    np.testing.assert_allclose(result.curve(0, OTHERS).longest, FACTOR * model(OTHERS, ratio).max(axis=0) + OFFSET, rtol=1e-5)


def test_the_band_of_one_parameter_ends_where_its_interval_does():
    result = fitted()
    (piece,) = result.intervals["stiffness"][0.95]
    ((low, high),) = result.curve(0, OTHERS).bands
    np.testing.assert_allclose(low, FACTOR * model(OTHERS, piece.low) + OFFSET, rtol=1e-9)
    np.testing.assert_allclose(high, FACTOR * model(OTHERS, piece.high) + OFFSET, rtol=1e-9)


def test_the_band_of_several_is_that_of_the_error_of_their_own():
    each = sp.Parameter("stiffness", each="specimen")
    result = fitted(np.array([0.01, 0.01, 0.006]), [each], specimen=[*"AAB"])
    stiffness, error = result.values["stiffness[A]"], result.stderrs["stiffness[A]"]
    slope = sp.precursor_lengths(sp.Slider(OTHERS, stiffness, 0.3), derivatives=1).slider.stiffness
    ((low, high),) = result.curve([0, 1], OTHERS).bands
    np.testing.assert_allclose((high - low) / 2, 1.959964 * FACTOR * slope * error, rtol=1e-4)


def test_a_curve_along_the_height_of_the_push_goes_through_the_fitted_lengths(worked):
    result = worked("pushed_block")
    m = result.measurements
    curve = result.curve(np.arange(len(m)), m.push_height, along="push_height")
    np.testing.assert_allclose(curve.length, result.fitted, rtol=1e-9)
    np.testing.assert_allclose(curve.longest, result.attainable, rtol=1e-9)
    with pytest.raises(ValueError, match="no push_height"):
        fitted().curve(0, OTHERS, along="push_height")


def test_no_field_where_no_gauge_was():
    with pytest.raises(ValueError, match="no gauge read slip in measurement 0"):
        fitted().field(0, "slip", 1e-3)


def test_an_interval_ends_next_to_values_at_which_no_event_stops(monkeypatch):
    """The deviance is infinite there: D = 3 θ up to ½, and a limit of 1 is crossed at ⅓."""

    def constrained(problem, held, at, near):
        return intervals.Curve(at[:, 0], np.where(at[:, 0] > 0.5, np.inf, 3 * at[:, 0]), at)

    monkeypatch.setattr(intervals, "constrained", constrained)
    one = type("Problem", (), {"p": 1})()
    profile = intervals.Curve(np.array([0.0, 1.0]), np.array([0.0, np.inf]), np.array([[0.0], [1.0]]))
    (piece,) = intervals.allowed(one, 0, profile, {0.68: 1.0})[0.68]
    assert (piece.low, piece.high) == (0, pytest.approx(1 / 3, abs=1e-3))
