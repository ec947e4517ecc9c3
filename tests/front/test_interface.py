"""Prestress and threshold profiles against dense solves."""

import functools

import jax
import numpy as np
import pytest
from chains import ended
from oracles import dense_chain
from oracles.dense_chain import DenseChain, chain_matrix

import slippulse_jax as sp
from slippulse_jax import Interface, Profile, Slider, first_precursor, precursor_length, precursor_lengths
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.lengths import arrests

FIG2 = Slider(25.0, 0.03, 0.3)


@pytest.mark.parametrize("right", ["semi-infinite", pytest.param("free", marks=pytest.mark.ci)])
def test_against_dense_chain(right):
    rng = np.random.default_rng([1, right == "free"])
    sites = 80
    for _ in range(4):
        slider = (rng.uniform(5, 25), 10 ** rng.uniform(-2.5, -0.5), rng.uniform(0, 0.45))
        phi, slope = rng.uniform(-0.9, 0.4), rng.uniform(-0.002, 0.01)
        theta = 1 + slope * np.arange(sites)
        count, excess, load, stress = dense_chain.front(*slider, theta, np.full(sites, phi), 0, sites, right)
        if right == "semi-infinite" and count == sites:
            continue
        got = first_precursor(
            ended(Slider(*slider), sites, right), interface=Interface(phi, slope), sites=sites
        )  # fmt: skip
        got = jax.tree.map(np.asarray, got)
        assert int(got.contacts_broken) == count
        if count == sites:
            assert int(got.status) == Outcome.RAN_THROUGH
            assert np.isinf(got.length)
            continue
        assert abs(got.load - load) < 1e-10 * load
        assert abs(got.front_stress[: count + 1] - theta[: count + 1] - excess).max() < 1e-10
        assert abs(got.stress - stress).max() < 1e-9
        assert abs(got.edge_stress - stress[0]) < 1e-9
        if count > 1:
            assert abs(got.length - dense_chain.crossing(excess)) < 1e-8


@pytest.mark.ci
def test_profile_against_dense_chain():
    rng = np.random.default_rng(5)
    for _ in range(2):
        theta, phi = rng.uniform(0.85, 1.15, 100), rng.uniform(-0.3, 0.3, 100)
        theta[0], phi[0] = 0.9, 0.1
        count, excess, load, stress = dense_chain.front(25, 0.03, 0.3, theta, phi, 0, 100)
        got = jax.tree.map(np.asarray, first_precursor(FIG2, interface=Profile(theta, phi), sites=100))
        assert int(got.contacts_broken) == count
        assert abs(got.load - load) < 1e-10
        assert abs(got.length - dense_chain.crossing(excess, degree=1)) < 1e-9
        assert abs(got.stress - stress).max() < 1e-9


@pytest.mark.ci
def test_negative_prestress_in_bulk_and_in_the_cascade():
    """Sheared against the push: batches, and every break of the general cascade, as dense solves have them."""
    rng = np.random.default_rng(11)
    sites, cases = 80, [(rng.uniform(4, 20), 10 ** rng.uniform(-2, -0.5), rng.uniform(0, 0.45)) for _ in range(4)]
    phi, site = np.linspace(-0.95, -0.05, len(cases)), np.arange(sites)
    found = arrests(Slider(*np.transpose(cases)), interface=Interface(phi))
    for i, (height, stiffness, poisson) in enumerate(cases):
        even, carried = np.ones(sites), np.full(sites, phi[i])
        count, excess, _, stress = dense_chain.front(height, stiffness, poisson, even, carried, 0, sites)
        assert found.contacts_broken[i] == count
        assert abs(found.edge_stress[i] - stress[0]) < 1e-10
        assert abs(found.length[i] - (dense_chain.crossing(excess) if count > 1 else 0)) < 1e-9
        dense = DenseChain.uniform((height, stiffness, poisson), even, carried, "semi-infinite")
        order = dense.event()
        chain = sp.chain(Slider(height, stiffness, poisson), sites=sites, prestress=carried)
        state, trigger = sp.nucleate(chain)
        event = sp.rupture(chain, state, trigger=trigger)
        assert list(np.asarray(event.order[: len(order)])) == order
        assert int(event.breaks) == len(order)
        assert abs(event.state.pinning - dense.pinning).max() < 1e-10
        assert order == list(site[:count])


@pytest.mark.ci
def test_stress_is_all_that_a_contact_carries():
    """Prestress included: contact 0 is at its threshold at nucleation, and the contact ahead carries the front stress."""
    front = first_precursor(FIG2, interface=Interface(0.3), sites=80)
    assert abs(front.stress_before[0] - 1) < 1e-12
    for position, stress in ((0, front.stress_before), (int(front.contacts_broken), front.stress)):
        assert abs(stress[position] - front.front_stress[position]) < 1e-12


@pytest.mark.ci
def test_no_prestress_no_slope_is_the_papers_interface():
    sliders = Slider([5.0, 25.0, 60.0], [[0.3], [0.003]], 0.3)
    assert abs(precursor_length(sliders, interface=Interface()) - precursor_length(sliders)).max() < 1e-11


@pytest.mark.ci
def test_uniform_thresholds_rescale():
    """Twice the thresholds and twice the prestress: the same front at twice the load."""
    theta = np.linspace(1, 1.2, 60)
    one = first_precursor(FIG2, interface=Profile(theta, 0.2), sites=60)
    two = first_precursor(FIG2, interface=Profile(2 * theta, 0.4), sites=60)
    assert abs(one.length - two.length) < 1e-11
    assert abs(two.load - 2 * one.load) < 1e-12


def test_lengths_under_prestress():
    """The lattice's values of the physics notes, obtained by dense solves."""
    lengths = precursor_lengths(FIG2, interface=Interface([0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.53, 0.54]))
    assert list(np.ceil(lengths)) == [30, 34, 42, 56, 71, 107, 204, np.inf]


@pytest.mark.ci
def test_runaway_threshold_to_a_millionth():
    """φ_c = (1 + G_00)/2, with G_00 from a dense endless chain: finite just below, endless at and above."""
    sites, middle = 801, 400
    matrix = chain_matrix(25, 0.03, 0.3, sites)
    force = np.zeros(2 * sites)
    force[sites + middle] = 0.03
    critical = (1 + np.linalg.solve(matrix, force)[sites + middle]) / 2
    assert abs(critical - (1 + float(lattice_modes(FIG2).weight.sum())) / 2) < 1e-9
    below, above = precursor_length(FIG2, interface=Interface(critical * (1 - 1e-6))), critical * (1 + 1e-6)
    assert 400 < below < 2000
    assert np.isinf(precursor_length(FIG2, interface=Interface(above)))
    record = first_precursor(FIG2, interface=Interface(above), sites=4000)
    assert int(record.status) == Outcome.RUN_AWAY
    assert not np.isfinite(jax.grad(lambda p: precursor_length(FIG2, interface=Interface(p)))(above))


def test_above_the_threshold_a_soft_short_slider_may_still_stop_the_front():
    """t approaches 2φ/(1 + G_00) from below there: the criterion is necessary, not sufficient. Against a dense chain."""
    slider = (10.381840251071646, 0.024884160056852563, 0.05409050217326783)
    critical = (1 + float(lattice_modes(Slider(*slider)).weight.sum())) / 2
    for phi, stops in ((critical + 1e-4, True), (critical + 0.02, False)):
        count, excess, *_ = dense_chain.front(*slider, np.ones(120), np.full(120, phi), 0, 120)
        assert (count < 100) == stops
        length = precursor_length(Slider(*slider), interface=Interface(phi))
        assert np.isfinite(length) == stops
        if stops:
            assert abs(length - dense_chain.crossing(excess)) < 1e-6


@pytest.mark.ci
def test_falling_thresholds_run_away_where_nothing_holds():
    falling = Interface(threshold_slope=-0.02)
    record = first_precursor(FIG2, interface=falling, sites=80)
    assert int(record.status) == Outcome.RUN_AWAY
    assert int(record.contacts_broken) == 50, "θ = 0 at site 50"
    assert np.isinf(precursor_length(FIG2, interface=falling))
    assert np.isfinite(precursor_length(FIG2, interface=Interface(threshold_slope=-0.005)))


@pytest.mark.ci
def test_derivatives():
    def length(x):
        return precursor_length(Slider(x[0], x[1], x[2]), interface=Interface(x[3], x[4]))

    at = np.array([25.3, 0.031, 0.3, 0.12, 0.003])
    step = 1e-6 * np.maximum(abs(at), 0.01)
    expected = [(length(at + h) - length(at - h)) / (2 * h.max()) for h in np.diag(step)]
    for mode in (jax.grad, jax.jacfwd):
        assert np.allclose(mode(length)(at), expected, rtol=1e-6)


@pytest.mark.ci
def test_reverse_derivatives_with_respect_to_a_profile():
    """Against differences; sites ahead of the front have none; both modes give the same."""
    rng = np.random.default_rng(8)
    at = rng.uniform(0.95, 1.05, 24), rng.uniform(0.0, 0.1, 24)

    def length(theta, phi):
        return precursor_length(Slider(20.0, 0.02, 0.3), interface=Profile(theta, phi))

    s0, by_threshold, by_prestress = int(np.ceil(length(*at))), *jax.grad(length, argnums=(0, 1))(*at)
    assert 3 < s0 < 22
    for which, gradient in ((0, by_threshold), (1, by_prestress)):
        assert not gradient[s0 + 1 :].any()
        for i in (0, 1, s0 - 1, s0):
            step = 1e-6 * np.eye(24)[i]
            up, down = list(at), list(at)
            up[which], down[which] = at[which] + step, at[which] - step
            assert abs(gradient[i] - (length(*up) - length(*down)) / 2e-6) < 1e-5 * abs(gradient).max()
    forward = jax.jacfwd(length)(*at)
    assert np.allclose(forward, by_threshold, rtol=1e-12)


@pytest.mark.ci
def test_profile_that_nothing_stops():
    """Beyond its last value a profile is uniform: endless if the prestress is beyond φ_c there, whatever it was before."""
    critical = (1 + float(lattice_modes(FIG2).weight.sum())) / 2
    for level, runs in ((critical + 1e-4, True), (critical - 1e-3, False)):
        profile = Profile(np.linspace(0.9, 1.0, 15), np.linspace(0.5, level, 15))
        length = precursor_length(FIG2, interface=profile)
        assert np.isinf(length) == runs
        record = first_precursor(FIG2, interface=profile, sites=5000)
        assert (int(record.status) == Outcome.RUN_AWAY) == runs
    # half the thresholds and half the prestress: the same ratio
    assert np.isinf(precursor_length(FIG2, interface=Profile(np.full(3, 0.5), (critical + 1e-4) / 2)))
    held = precursor_length(FIG2, interface=Profile(np.append(np.ones(40), 3.0), 0.6))
    assert np.isfinite(held), "rising thresholds hold it"


@pytest.mark.ci
def test_single_precision(float32):
    """float32 in, float32 out: a relative error below 1e-4 at a prestress far from φ_c."""
    lengths = [
        precursor_length(FIG2, interface=Interface(np.float32(0.2))),
        precursor_length(FIG2, interface=Profile(np.ones(5, np.float32), 0.2)),
    ]
    with jax.enable_x64(True):
        exact = float(precursor_length(FIG2, interface=Interface(0.2)))
    for length in lengths:
        assert length.dtype == np.float32
        assert abs(length - exact) < 1e-4 * exact


@pytest.mark.ci
def test_batches_do_not_depend_on_company():
    rng = np.random.default_rng(2)
    sliders = Slider(rng.uniform(5, 40, 50), 10 ** rng.uniform(-3, -1, 50), 0.3)
    phi = rng.uniform(0, 0.6, 50)
    together = precursor_lengths(sliders, interface=Interface(phi))
    alone = [
        precursor_lengths(Slider(h, k, 0.3), interface=Interface(p))
        for h, k, p in zip(sliders.height, sliders.stiffness, phi, strict=True)
    ]
    assert np.array_equal(together, alone)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"prestress": 1.0}, "Interface.prestress = 1"),
        ({"prestress": [0.1, -1.0]}, "Interface.prestress = -1 at index 1: must lie in"),
        ({"threshold_slope": -1.0}, "Interface.threshold_slope = -1"),
        ({"threshold_slope": np.nan}, "threshold_slope = nan"),
    ],
)
def test_errors_name_the_field(wrong, message):
    with pytest.raises(ValueError, match=message):
        Interface(**wrong)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"threshold": []}, r"Profile.threshold has shape \(0,\)"),
        ({"threshold": 1.0}, r"Profile.threshold has shape \(\)"),
        ({"threshold": [1.0, -0.5]}, "Profile.threshold = -0.5 at index 1"),
        ({"threshold": [1.0, np.inf]}, "Profile.threshold = inf at index 1"),
        ({"threshold": [1.0, 1.0], "prestress": 1.5}, "Profile.prestress = 1.5 at index 0"),
        ({"threshold": [0.5, 1.0, 0.4], "prestress": [0.4, 0.4, -0.4]}, "Profile.prestress = -0.4 at index 2"),
        ({"threshold": [1.0, 1.0], "prestress": [0.1] * 3}, r"Profile.prestress has shape \(3,\)"),
    ],
)
def test_errors_of_a_profile_name_the_field(wrong, message):
    with pytest.raises(ValueError, match=message):
        Profile(**wrong)


@pytest.mark.ci
def test_sensitivity_takes_any_interface():
    rising = sp.sensitivity(FIG2, Interface(0.1, 0.002), sites=60)
    given = sp.sensitivity(FIG2, Profile(1 + 0.002 * np.arange(60), 0.1), sites=60)
    np.testing.assert_allclose(rising.threshold, given.threshold, rtol=1e-12)
    assert abs(rising.length - precursor_length(FIG2, Profile(1 + 0.002 * np.arange(60), 0.1))) < 1e-11
    with pytest.raises(ValueError, match=r"batch of shape \(2,\)"):
        sp.sensitivity(FIG2, Interface([0.1, 0.2]), sites=30)


def test_lengths_in_bulk_refuse_a_profile_by_name():
    for bulk in (precursor_lengths, arrests, functools.partial(precursor_lengths, derivatives=1)):
        with pytest.raises(TypeError, match="Profile.*precursor_length"):
            bulk(FIG2, interface=Profile(np.ones(3)))


@pytest.mark.ci
def test_traced_interface_outside_its_domain_is_nan():
    lengths = jax.vmap(lambda p: precursor_length(FIG2, interface=Interface(p)))(np.array([0.1, -0.5, 1.2, -1.0, np.nan]))
    assert np.isfinite(lengths[:2]).all()
    assert np.isnan(lengths[2:]).all()
    slopes = jax.vmap(lambda e: precursor_length(FIG2, interface=Interface(0.0, e)))(np.array([0.001, -1.0, np.inf]))
    assert list(np.isnan(slopes)) == [False, True, True]


def test_traced_profile_outside_its_domain_is_nan():
    """As for values that can be looked at, which are refused: prestress beyond a threshold, or no threshold."""
    theta = np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 0.0], [1.0, np.nan], [1.0, 1.0]])
    phi = np.array([[0.2, 0.1], [1.5, 0.1], [0.2, 0.1], [0.2, 0.1], [0.2, -1.0]])
    lengths = jax.vmap(lambda t, p: precursor_length(FIG2, interface=Profile(t, p)))(theta, phi)
    assert list(np.isnan(lengths)) == [False, True, True, True, True]


def test_thresholds_that_fall_to_nothing_under_a_negative_prestress():
    """A threshold below zero holds nothing, though the prestress is lower still."""
    record = first_precursor(FIG2, interface=Interface(-0.2, -0.05), sites=80)
    assert (int(record.status), int(record.contacts_broken)) == (Outcome.RUN_AWAY, 20)
