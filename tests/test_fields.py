"""Recovered profiles: data from the dense program, derivatives against differences, algebra against textbook formulas, coverage."""

import json

import jax
import numpy as np
import pytest
from oracles import dense_chain
from scipy.stats import multivariate_normal

import slippulse_jax as sp
from slippulse_jax.inference.measurements import MeasurementError
from slippulse_jax.inference.recover.inversion import LEVEL, Smoothness, condition, mixture, squared_exponential
from slippulse_jax.inference.recover.model import profile_model
from slippulse_jax.inference.recover.recovery import Determination
from slippulse_jax.interface import Profile
from slippulse_jax.lattice.front import front_stress
from slippulse_jax.lattice.modes import lattice_modes

STIFFNESS, POISSON, SITES = 0.03, 0.3, 64
HEIGHTS = np.linspace(6, 26, 8)
X = np.arange(SITES)


def dense_lengths(theta, phi, heights=HEIGHTS):
    """From the program that solves the whole matrix anew after every break."""
    return np.array([dense_chain.crossing(dense_chain.front(h, STIFFNESS, POISSON, theta, phi, 0, SITES)[1]) for h in heights])


def wave(amplitude=0.04):
    return np.exp(amplitude * np.sin(X / 8))


def measured(length, sigma, seed=None, **columns):
    noise = 0 if seed is None else sigma * np.random.default_rng(seed).normal(size=len(length))
    return sp.Measurements(height=HEIGHTS, poisson=POISSON, length=length + noise, length_sigma=sigma, **columns)


@pytest.fixture(scope="module")
def recovered():
    return sp.recover_profile(measured(dense_lengths(wave(), 0 * X), 0.1, seed=1), stiffness=STIFFNESS)


def test_a_known_threshold_profile_is_recovered_within_its_error(recovered):
    at = np.arange(5, 30, 3)
    low, high = (np.interp(at, recovered.position, end) for end in recovered.interval(0.99))
    assert ((low < wave()[at]) & (wave()[at] < high)).all()
    assert recovered.determination is Determination.DETERMINED
    assert np.interp(at, recovered.position, recovered.stderr).max() < 0.01
    assert abs(recovered.fitted - recovered.measurements.length).max() < 0.4
    assert 3 < recovered.degrees < len(HEIGHTS)


def test_a_length_reads_the_threshold_at_its_arrest():
    """θ(ℓ)/θ_0 = t(ℓ), with t that of uniform thresholds: what a contact gives up does not depend on when it breaks."""
    theta = 1.3 * wave()
    lengths = dense_lengths(theta, 0 * X)
    uniform = sp.Measurements(height=HEIGHTS, poisson=POISSON, length=lengths, length_sigma=0.01)
    found = sp.recover_profile(uniform, stiffness=STIFFNESS)
    compared = 0
    for height, length in zip(HEIGHTS, lengths, strict=True):
        t = 1 + dense_chain.front(height, STIFFNESS, POISSON, np.ones(SITES), 0 * X, 0, SITES)[1]
        if length <= len(t) - 1:  # the front under uniform thresholds came as far
            assert abs(np.interp(length, X[: len(t)], t) - np.interp(length, X, theta / theta[0])) < 1e-9
            compared += 1
    assert compared >= 3
    truth = np.interp(lengths, X, theta / theta[0])
    np.testing.assert_allclose(found.readings.value, truth, rtol=1e-9)
    # with errors this small the profile goes through the readings
    np.testing.assert_allclose(found.at(lengths), truth, atol=2e-3)


@pytest.mark.parametrize("kind", ["threshold", "prestress"])
def test_derivatives_in_knots_and_stiffness(kind):
    rng = np.random.default_rng(3)
    m = measured(np.full(len(HEIGHTS), 12.3), 0.1, prestress=0.05, threshold_slope=0.001)
    model = profile_model(m, kind, np.array(STIFFNESS), m.length, SITES, 9)
    assert len(model.knots) == 9
    u = np.append(0.02 * rng.normal(size=9) + (0.1 if kind == "prestress" else 0), 0.05)
    u[0] = 0 if kind == "threshold" else u[0]
    step = 1e-6
    for function in (model.lengths, model.excess):
        at = function(u)
        for j in range(kind == "threshold", 10):
            h = step * np.eye(10)[j]
            np.testing.assert_allclose(
                at.derivative[:, j], (function(u + h).value - function(u - h).value) / (2 * step), rtol=1e-5, atol=1e-5
            )


def test_reverse_mode_of_the_front_over_a_profile():
    """The gradient through the scan over a Profile, against differences and against `sensitivity`."""
    theta, phi, last = wave(), 0.1 + 0.02 * np.cos(X / 5), 20
    modes = lattice_modes(sp.Slider(25.0, STIFFNESS, POISSON))

    def stress(theta, phi):
        return front_stress(modes, SITES, Profile(theta, phi))[last]

    by_theta, by_phi = jax.jit(jax.grad(stress, (0, 1)))(theta, phi)
    assert np.flatnonzero(by_theta).tolist() == [0], "thresholds on the way do not matter"
    run = jax.jit(stress)
    for i in (0, 1, 7, 19, 20, 21):
        h = 1e-5 * np.eye(SITES)[i]
        # linear in both, so that the difference is exact but for rounding
        assert abs(by_phi[i] - (run(theta, phi + h) - run(theta, phi - h)) / 2e-5) < 1e-9
        assert abs(by_theta[i] - (run(theta + h, phi) - run(theta - h, phi)) / 2e-5) < 1e-9
    found = sp.sensitivity(sp.Slider(25.0, STIFFNESS, POISSON), interface=Profile(theta, phi), sites=SITES)
    count = int(np.ceil(found.length))

    def crossing(phi):
        over = front_stress(modes, SITES, Profile(theta, phi)) - theta
        return count - 1 + over[count - 1] / (over[count - 1] - over[count])

    np.testing.assert_allclose(jax.jit(jax.grad(crossing))(phi), found.prestress, rtol=1e-9, atol=1e-10)


def test_gaussian_algebra_against_the_textbook():
    rng = np.random.default_rng(0)
    x = np.linspace(0, 10, 6)
    prior = squared_exponential(x, Smoothness(0.5, 2.0), level=0.2) + 1e-6 * np.eye(6)
    design, noise, z = rng.normal(size=(4, 6)), rng.uniform(0.1, 0.5, 4), rng.normal(size=4)
    found = condition(z, design, noise, prior)
    precision = design.T @ np.diag(noise**-2) @ design
    covariance = np.linalg.inv(precision + np.linalg.inv(prior))
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-8)
    np.testing.assert_allclose(found.mean, covariance @ design.T @ (z / noise**2), atol=1e-7)
    np.testing.assert_allclose(found.resolution, covariance @ precision, atol=1e-7)
    np.testing.assert_allclose(found.resolution, np.eye(6) - covariance @ np.linalg.inv(prior), atol=1e-4)
    spread = design @ prior @ design.T + np.diag(noise**2)
    assert found.log_evidence == pytest.approx(multivariate_normal(cov=spread).logpdf(z))
    pinned = squared_exponential(x, Smoothness(0.5, 2.0), pinned=True)
    assert abs(pinned[0]).max() < 1e-12
    mean, spread, _ = mixture([found, found._replace(mean=-found.mean)], np.array([0.5, 0.5]))
    np.testing.assert_allclose(mean, 0, atol=1e-15)
    np.testing.assert_allclose(spread, found.covariance + np.outer(found.mean, found.mean))


@pytest.mark.parametrize("kind", ["threshold", "prestress"])
def test_one_length_is_never_a_profile(kind):
    one = sp.Measurements(height=25, poisson=POISSON, length=26.0, length_sigma=0.3)
    found = sp.recover_profile(one, stiffness=STIFFNESS, kind=kind)
    assert found.determination is Determination.UNDERDETERMINED
    assert "under-determined" in found.report()
    assert found.degrees < 1
    far = abs(found.position - 26) > 8
    far &= found.prior_stderr > 0.01
    # one weighted mean of the prestress is known, and with it something of its level; of its shape nothing
    shape = found.prior_stderr**2 - (LEVEL**2 if kind == "prestress" else 0)
    assert (found.stderr[far] > 0.7 * np.sqrt(shape[far])).all()
    assert found.determined.mean() < (0.2 if kind == "threshold" else 1e-9)
    # the one averaging kernel there is: R = K g gᵀ/(gᵀ K g + σ²), along the sensitivity of that length
    given = Smoothness(0.05, 10.0)
    found = sp.recover_profile(one, stiffness=STIFFNESS, kind=kind, amplitude=0.05, length_scale=10.0)
    field = np.interp(X, found.position, found.profile)
    phi = field if kind == "prestress" else 0.0
    g = getattr(
        sp.sensitivity(
            sp.Slider(25.0, STIFFNESS, POISSON), Profile(field if kind == "threshold" else np.ones(SITES), phi), sites=SITES
        ),
        kind,
    )  # fmt: skip
    g = np.array(g) * (field if kind == "threshold" else 1)
    g[0] *= kind == "prestress"
    prior = squared_exponential(X.astype(float), given, level=LEVEL * (kind == "prestress"), pinned=kind == "threshold")
    expected = np.outer(prior @ g, g) / (g @ prior @ g + 0.3**2)
    np.testing.assert_allclose(found.resolution, expected, atol=1e-6 * abs(expected).max())


def test_a_constant_is_recovered_as_a_constant():
    found = sp.recover_profile(measured(dense_lengths(np.ones(SITES), 0 * X), 0.1), stiffness=STIFFNESS)
    inside = found.position < 35
    assert abs(found.profile[inside] - 1).max() < 1e-3
    found = sp.recover_profile(
        measured(dense_lengths(np.ones(SITES), 0.2 + 0 * X), 0.05), stiffness=STIFFNESS, kind="prestress"
    )
    assert (abs(found.profile - 0.2) < 1.5 * found.stderr).all()
    assert np.ptp(found.profile) < 0.02


def test_a_prestress_is_known_as_averages_first():
    phi = 0.15 + 0.05 * np.cos(X / 10)
    found = sp.recover_profile(measured(dense_lengths(np.ones(SITES), phi), 0.1, seed=2), stiffness=STIFFNESS, kind="prestress")
    inside = found.position < 30
    assert (abs(found.profile - phi)[inside] < 2.5 * found.stderr[inside]).all()
    assert found.determination in (Determination.AVERAGES, Determination.PARTLY)
    assert found.degrees > 2


def test_an_uncertain_stiffness_widens_the_profile(recovered):
    loose = sp.recover_profile(recovered.measurements, stiffness=STIFFNESS, log_stiffness_sd=0.3)
    inside = (recovered.position > 5) & (recovered.position < 30)
    assert (loose.stderr[inside] > 1.5 * recovered.stderr[inside]).all()
    assert loose.log_stiffness_shift != 0


def test_lengths_no_smooth_profile_gives_are_flagged():
    lengths = dense_lengths(np.ones(SITES), 0 * X)
    lengths[3] += 8  # out of order: that front would have had to pass where the next one stopped
    found = sp.recover_profile(measured(lengths, 0.05), stiffness=STIFFNESS, amplitude=0.02, length_scale=20.0)
    assert found.determination in (Determination.NOT_EXPLAINED, Determination.NOT_CONVERGED)


def coverage(kind, trials, seed, longest):
    """Shares of positions within one and 1.96 standard errors, over truths drawn from the prior; those given up are left out."""
    rng = np.random.default_rng(seed)
    heights, sites = np.linspace(5, 30, 8), 128
    x = np.arange(sites, dtype=float)
    lengths = jax.jit(
        jax.vmap(
            lambda h, theta, phi: sp.sensitivity(sp.Slider(h, STIFFNESS, POISSON), interface=Profile(theta, phi), sites=sites).length,
            in_axes=(0, None, None),
        )
    )  # fmt: skip
    pulls, given_up = [], 0
    while len(pulls) + given_up < trials:
        smooth = Smoothness(rng.choice([0.01, 0.03, 0.1]), rng.choice([8.0, 15.0, 30.0]))
        prior = squared_exponential(x, smooth, pinned=kind == "threshold")
        f = np.linalg.cholesky(prior + 1e-12 * np.eye(sites)) @ rng.normal(size=sites) + (0.15 if kind == "prestress" else 0)
        true = np.asarray(lengths(heights, np.exp(f), 0 * f) if kind == "threshold" else lengths(heights, 1 + 0 * f, f))
        sigma = rng.choice([0.1, 0.4])
        seen = true + sigma * rng.normal(size=8)
        # by the truth alone: a choice by what was seen would be a bias of its own
        if not (np.isfinite(true).all() and true.min() > 2 and true.max() < longest):
            continue
        m = sp.Measurements(height=heights, poisson=POISSON, length=seen, length_sigma=sigma)
        found = sp.recover_profile(m, stiffness=STIFFNESS, kind=kind)
        if found.determination in (Determination.NOT_CONVERGED, Determination.NOT_EXPLAINED):
            given_up += 1
            continue
        at = np.linspace(3, seen.max(), 6).round()
        u = np.log(found.profile) if kind == "threshold" else found.profile
        error = np.sqrt(np.maximum(np.diag(found.covariance), 0))
        pulls.append((np.interp(at, x, f) - np.interp(at, found.position, u)) / np.interp(at, found.position, error))
    pulls = abs(np.array(pulls))
    return (pulls < 1).mean(), (pulls < 1.96).mean(), given_up


@pytest.mark.parametrize("kind", ["threshold", "prestress"])
def test_coverage(kind):
    one, two, given_up = coverage(kind, 25, seed=5, longest=30)
    assert 0.55 < one < 0.85
    assert two > 0.87
    assert given_up <= 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["threshold", "prestress"])
def test_coverage_campaign(kind):
    one, two, given_up = coverage(kind, 500, seed=6, longest=60)
    print(kind, one, two, given_up)
    assert 0.63 < one < 0.76
    assert 0.92 < two < 0.98
    assert given_up < 50


def test_report_json_and_pictures(recovered):
    from matplotlib.figure import Figure

    text = str(recovered)
    assert text.startswith("Threshold profile from 8 lengths: determined between the first and the last arrest")
    content = json.loads(json.dumps(recovered.to_dict(), allow_nan=False))
    assert content["determination"] == "determined"
    assert len(content["profile"]) == len(content["position"])
    left, right = Figure().subplots(1, 2)
    assert sp.plot.recovered_profile(recovered, ax=left) is left
    assert sp.plot.resolution(recovered, ax=right) is right
    assert "lambda" in left.get_xlabel()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"kind": "stiffness"}, "kind = 'stiffness'"),
        ({"log_stiffness_sd": -1.0}, "log_stiffness_sd = -1"),
        ({"amplitude": 0.0}, "amplitude = 0"),
        ({"length_scale": np.inf}, "length_scale = inf"),
        ({"max_steps": 0}, "max_steps = 0"),
        ({"stiffness": -1.0}, "Slider.stiffness = -1"),
    ],
)
def test_errors_name_the_argument(wrong, message):
    m = sp.Measurements(height=25, poisson=POISSON, length=26.0, length_sigma=0.3)
    with pytest.raises(ValueError, match=message):
        sp.recover_profile(m, **{"stiffness": STIFFNESS, **wrong})


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"kind": ("length", "at_least")}, "measurement 1: kind 'at_least'"),
        ({"length_sigma": None}, "needs the standard errors"),
        ({"correlation_length": [1e-6, 2e-6]}, "several correlation lengths"),
    ],
)
def test_measurements_that_are_no_lengths_of_one_interface_are_refused(columns, message):
    m = sp.Measurements(**{"height": [20, 25], "poisson": POISSON, "length": [20.0, 26.0], "length_sigma": 0.3, **columns})
    with pytest.raises(MeasurementError, match=message):
        sp.recover_profile(m, stiffness=STIFFNESS)


def test_a_count_stands_for_the_middle_of_its_contact():
    count = sp.Measurements(height=[20, 25], poisson=POISSON, length=[22.0, 26.0], length_sigma=0.0, kind=("whole",) * 2)
    plain = sp.Measurements(height=[20, 25], poisson=POISSON, length=[21.5, 25.5], length_sigma=12**-0.5)
    counted, found = (sp.recover_profile(m, stiffness=STIFFNESS) for m in (count, plain))
    np.testing.assert_allclose(counted.profile[:30], found.profile[:30], rtol=1e-12)
