"""Lengths of whole events, in which contacts may break again: against dense solves, and their derivatives at a fixed order."""

import jax
import numpy as np
import pytest
from oracles.dense_chain import DenseChain

import slippulse_jax as sp
from slippulse_jax import lengths
from slippulse_jax.lengths import FEW_SITES, arrests
from slippulse_jax.status import Outcome


def sliders_beyond(count, seed, *, shortest=6.0, tallest=60.0):
    """Random sliders of b 1–200 that a dense program can follow, and their b."""
    rng = np.random.default_rng(seed)
    height, b = np.exp(rng.uniform(np.log(shortest), np.log(tallest), count)), np.exp(rng.uniform(0, np.log(200), count))
    poisson = rng.uniform(0, 0.5, count)
    return sp.Slider(height, b / (2 * (1 + poisson) * height), poisson), b


def dense_event(slider, sites, prestress=0.0, threshold_slope=0.0, right="semi-infinite"):
    """ℓ of the first event by dense solves, and the order of its breaks."""
    threshold = 1 + threshold_slope * np.arange(sites)
    numbers = (slider.height, slider.stiffness, slider.poisson)
    dense = DenseChain.uniform(numbers, threshold, np.full(sites, prestress), right=right)
    rest = dense.stress()[0]
    order = dense.at(load=(1 - rest) / (dense.at(load=1.0).stress()[0] - rest)).rupture(0)
    return dense.reach(order, alike=True), order


@pytest.mark.ci
def test_whole_events_against_dense_solves():
    """50 sliders of b 1–200."""
    slider, b = sliders_beyond(50, seed=16)
    found, front = sp.precursor_lengths(slider, event="full"), sp.precursor_lengths(slider)
    sites = (np.ceil(1.4 * front) + 8).astype(int)
    expected = np.array([dense_event(jax.tree.map(lambda x, i=i: x[i], slider), n)[0] for i, n in enumerate(sites)])
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    again = arrests(slider).status == Outcome.REBREAK
    assert again.sum() > 20
    np.testing.assert_array_equal(found[~again], front[~again])
    assert (found[again] > front[again]).all()
    assert (found[again] > 1.1 * front[again]).sum() > 5


def test_known_events():
    slider = sp.Slider(np.array([25.0, 50.0, 50.0, 50.0]), np.array([1.0, 0.1, 0.3, 1.0]), 0.3)
    found = sp.precursor_lengths(slider, event="full")
    np.testing.assert_allclose(found, [16.40, 49.53, 43.40, 32.33], atol=0.005)
    assert np.ceil(found[2]) == 44
    assert np.ceil(sp.precursor_lengths(slider)[2]) == 40


@pytest.mark.slow
def test_the_event_of_a_tall_slider_goes_beyond_the_ceiling_of_fronts():
    slider = sp.Slider(1e4, 40 / 2.6e4, 0.3)
    # 1.1256 of every contact; on larger contacts of two sizes within the 1e-3 that its docstring states at b = 40
    assert float(sp.precursor_lengths(slider, event="full")) / 1e4 == pytest.approx(1.1256, rel=1e-3)


@pytest.mark.ci
@pytest.mark.parametrize(("height", "b", "interface"), [(3000.0, 15.0, None), (1500.0, 8.0, sp.Interface(0.2, 1e-6))])
def test_a_long_event_is_followed_on_larger_contacts_to_the_same_length(monkeypatch, height, b, interface):
    slider = sp.Slider(height, b / (2.6 * height), 0.3)
    every = sp.precursor_lengths(slider, interface, event="full")
    monkeypatch.setattr(lengths, "MOST_SITES", 2048)
    assert sp.precursor_lengths(slider, interface, event="full") == pytest.approx(every, rel=3e-4)


@pytest.mark.ci
def test_events_under_prestress_and_on_rising_thresholds_against_dense_solves():
    slider, interface = sp.Slider(20.0, 0.4, 0.3), sp.Interface(np.array([0.2, -0.4, 0.0]), np.array([0.0, 0.0, 2e-3]))
    found = sp.precursor_lengths(slider, interface, event="full")
    expected = [
        dense_event(slider, 120, float(phi), float(slope))[0]
        for phi, slope in zip(interface.prestress, interface.threshold_slope, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert (found > sp.precursor_lengths(slider, interface)).all()


@pytest.mark.ci
def test_an_event_longer_than_expected_gets_more_sites():
    """Such that the front just fits the sites that are resolved at first."""
    from slippulse_jax.lengths import event_lengths

    lane = np.array([[50.0], [0.3], [0.3]])
    longer = event_lengths(lane, np.array([39.0]))
    np.testing.assert_allclose(event_lengths(lane, np.array([3.0 * FEW_SITES])), longer, rtol=1e-12)


@pytest.mark.ci
def test_events_in_a_finite_chain_against_dense_solves():
    height, end = np.array([20.0, 35.0, 50.0]), {"right": "free", "sites": 64}
    found = sp.precursor_lengths(sp.Slider(height, 0.4, 0.3), event="full", **end)
    np.testing.assert_allclose(found, [dense_event(sp.Slider(H, 0.4, 0.3), 64, right="free")[0] for H in height], rtol=1e-9)
    assert np.isinf(found).tolist() == [False, False, True]


@pytest.mark.slow
def test_derivatives_at_a_fixed_order_of_breaks():
    """Against differences so narrow that the order stays, and against zero of what is not differentiated: the order itself."""
    slider = sp.Slider(np.array([50.0, 50.0, 15.0, 25.0]), np.array([0.05, 0.3, 0.5, 0.03]), 0.3)
    interface = sp.Interface(np.array([0.0, 0.0, 0.2, 0.0]), np.array([0.0, 0.0, 1e-3, 0.0]))
    found = sp.precursor_lengths(slider, interface, event="full", derivatives=1)
    np.testing.assert_array_equal(found.length, sp.precursor_lengths(slider, interface, event="full"))
    step = 1e-6
    numbers = {name: np.broadcast_to(x, 4) for name, x in (*vars(slider).items(), *vars(interface).items())}
    for name, value in numbers.items():
        size = step * np.maximum(np.abs(value), 1e-3)

        def at(sign, name=name, value=value, size=size):
            moved = {**numbers, name: value + sign * size}
            slider = sp.Slider(*(moved[key] for key in ("height", "stiffness", "poisson")))
            return sp.precursor_lengths(slider, sp.Interface(moved["prestress"], moved["threshold_slope"]), event="full")

        difference = (at(1) - at(-1)) / (2 * size)
        np.testing.assert_allclose(
            getattr(found.slider if name in vars(slider) else found.interface, name),
            difference,
            rtol=2e-5,
            atol=1e-5 * np.abs(found.length).max(),
            err_msg=name,
        )


def test_what_an_event_does_not_take():
    slider = sp.Slider(50.0, 0.3, 0.3)
    with pytest.raises(ValueError, match=r"event = 'whole': must be one of 'domino', 'full'"):
        sp.precursor_lengths(slider, event="whole")
    with pytest.raises(ValueError, match=r"event = 'full': needs the hard rule"):
        sp.precursor_lengths(slider, rule=sp.SmoothBreak(0.01), event="full")
