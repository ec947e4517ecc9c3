"""Errors that all measured lengths share: an offset and a model factor beside the fit, unless they are held."""

import dataclasses

import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.inference.parameters import MODEL_ERROR

ALIKE = {"threshold_scatter": 0}
HEIGHT = np.array([25.0, 35.0, 45.0, 55.0, 65.0, 75.0]) * 10
STIFFNESS = 3e-4


@pytest.fixture(scope="module")
def lengths():
    """Lengths of the recursion, read with an error of two per cent of the median."""
    length = sp.precursor_lengths(sp.Slider(HEIGHT, STIFFNESS, 0.3))
    sigma = 0.02 * np.median(length)
    length = length + sigma * np.random.default_rng(4).standard_normal(6)
    return sp.Measurements(HEIGHT, 0.3, length, sigma, provenance=["measured"] * 6)


@pytest.mark.ci
def test_standard_error_is_that_of_correlated_lengths(lengths):
    """By generalised least squares: the two errors are covariances of the lengths."""
    result = sp.fit(lengths, fixed=ALIKE)
    found = sp.exact_lengths(sp.Slider(HEIGHT, result.values["stiffness"], 0.3), derivatives=1)
    slope = found.slider.stiffness * result.values["stiffness"]
    sigma, factor = lengths.sigma, np.exp(result.theta[result.parameters.index("model_factor")])
    shared = MODEL_ERROR * factor * found.length
    covariance = np.diag(sigma**2) + np.median(sigma) ** 2 + np.outer(shared, shared)
    stderr = 1 / np.sqrt(factor * slope @ np.linalg.solve(covariance, factor * slope))
    assert result.stderrs["stiffness"] / result.values["stiffness"] == pytest.approx(stderr, rel=0.02)
    assert list(result.verdicts) == list(result.intervals) == ["stiffness"]
    assert set(result.inputs) == {"offset", "model_factor"}
    assert "length" not in {one.name for one in result.changes}
    assert 'To keep only the errors of each length, give fixed={"offset": 0, "model_factor": 1}\n' in f"{result.report()}\n"


@pytest.mark.ci
def test_held_they_leave_the_error_of_the_lengths(lengths):
    plain = sp.fit(dataclasses.replace(lengths, provenance=()))
    held = sp.fit(lengths, fixed={"offset": 0, "model_factor": 1} | ALIKE)
    assert held.values == plain.values
    assert held.intervals == plain.intervals
    assert held.stderrs["stiffness"] < 0.2 * sp.fit(lengths, fixed=ALIKE).stderrs["stiffness"]


@pytest.mark.ci
def test_a_fit_repeated_from_its_record_is_the_same(lengths):
    from slippulse_jax.inference.result.record import from_request

    result = sp.fit(lengths, fixed=ALIKE)
    again = sp.fit(lengths, **from_request(result.to_dict()["request"]))
    assert again.theta.tolist() == result.theta.tolist()
    assert again.names == result.names


@pytest.mark.parametrize("case", ["counts", "printed", "digitised"])
def test_only_beside_lengths_that_were_measured(lengths, case):
    if case == "counts":
        count = np.ceil(sp.exact_lengths(sp.Slider(HEIGHT, STIFFNESS, 0.3)))
        lengths = dataclasses.replace(lengths, length=count, length_sigma=0 * count, kind=("whole",) * 6)
    else:
        lengths = dataclasses.replace(lengths, provenance=(case,) * 6)
    beside = ["offset", "model_factor"] * (case == "digitised")
    assert sp.fit(lengths, fixed=ALIKE).parameters.names == ["stiffness", *beside]


@pytest.mark.ci
@pytest.mark.parametrize("case", ["relative", "no errors"])
def test_the_model_factor_is_there_without_a_size_of_errors(lengths, case):
    """By generalised least squares with σ of the size of the scatter; an offset would need σ for its prior."""
    if case == "no errors":
        lengths = dataclasses.replace(lengths, length_sigma=None)
    result = sp.fit(lengths, fixed=ALIKE, sigma="absolute" if case == "no errors" else "relative")
    assert set(result.inputs) == {"model_factor"}
    found = sp.exact_lengths(sp.Slider(HEIGHT, result.values["stiffness"], 0.3), derivatives=1)
    factor = result.inputs["model_factor"]
    slope, shared = factor * found.slider.stiffness * result.values["stiffness"], MODEL_ERROR * factor * found.length
    stderr = 1 / np.sqrt(slope @ np.linalg.solve(np.diag(result.sigma**2) + np.outer(shared, shared), slope))
    assert result.stderrs["stiffness"] / result.values["stiffness"] == pytest.approx(stderr, rel=0.02)
    assert 'To keep only the errors of each length, give fixed={"model_factor": 1}\n' in f"{result.report()}\n"


def test_a_nuisance_needs_a_prior():
    with pytest.raises(ValueError, match=r"parameter offset: nuisance = True, but no prior"):
        sp.Parameter("offset", nuisance=True)


@pytest.mark.ci
def test_lengths_that_share_a_factor_are_not_too_long():
    """A tenth above the longest of the model is named of exact lengths, and within the model factor of measured ones."""
    longest = sp.fit(sp.Measurements(HEIGHT, 0.3, 0.8 * HEIGHT, 0.02 * HEIGHT), intervals="profile").attainable
    said = {}
    for provenance in ("synthetic", "measured"):
        m = sp.Measurements(HEIGHT, 0.3, 1.1 * longest, 0.01 * HEIGHT, provenance=[provenance] * 6)
        said[provenance] = " ".join(sp.fit(m, intervals="profile", fixed=ALIKE).notes)
    assert "above the longest" in said["synthetic"]
    assert "above the longest" not in said["measured"]


@pytest.mark.ci
def test_report_names_what_measured_lengths_would_share():
    length = sp.precursor_lengths(sp.Slider(HEIGHT, STIFFNESS, 0.3)) * (1 + 0.02 * np.array([1, -1, 1, -1, 1, -1]))
    with_sigma = sp.fit(sp.Measurements(HEIGHT, 0.3, length, 0.03 * length)).report()
    without = sp.fit(sp.Measurements(HEIGHT, 0.3, length)).report()
    for report in (with_sigma, without):
        assert "a model factor of 1.1, if the lengths were measured (provenance = measured fits it)" in report
