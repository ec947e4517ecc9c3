"""Lengths of whole events, in which contacts may break again: against dense solves, and their derivatives at a fixed order."""

import functools

import jax
import numpy as np
import pytest
from chains import ended
from oracles.dense_chain import DenseChain

import slippulse_jax as sp
from slippulse_jax import lengths
from slippulse_jax.base.status import Outcome
from slippulse_jax.lengths import FEW_SITES, arrests


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
    """On a quarter of the contacts that are followed by default, four times as far off as there."""
    slider = sp.Slider(height, b / (2.6 * height), 0.3)
    every = sp.precursor_lengths(slider, interface, event="full")
    monkeypatch.setattr(lengths, "MOST_SITES", 1024)
    assert sp.precursor_lengths(slider, interface, event="full") == pytest.approx(every, rel=8e-4)


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
    lane, kind = np.array([[50.0], [0.3], [0.3]]), jax.tree.structure((sp.Slider(50.0, 0.3, 0.3), None, None))
    longer = lengths.event_lengths(lane, kind, np.array([39.0]))
    np.testing.assert_allclose(lengths.event_lengths(lane, kind, np.array([3.0 * FEW_SITES])), longer, rtol=1e-12)


@pytest.mark.ci
def test_whole_events_trace_differentiate_and_map():
    """As they are: one, a batch, under jit and vmap with sites, and their slopes at a fixed order of breaks, in all numbers."""
    sliders, interface = sp.Slider(np.array([50.0, 25.0, 25.0]), np.array([0.05, 0.5, 0.03]), 0.3), sp.Interface(0.05, 1e-3)
    expected = sp.precursor_lengths(sliders, interface, event="full", derivatives=1)
    assert (arrests(sliders, interface).status == Outcome.REBREAK).tolist() == [True, True, False]

    def length(height, stiffness, poisson, prestress, slope, sites=None):
        slider, contacts = sp.Slider(height, stiffness, poisson), sp.Interface(prestress, slope)
        return sp.precursor_length(slider, contacts, event="full", sites=sites)

    numbers = np.broadcast_arrays(sliders.height, sliders.stiffness, 0.3, 0.05, 1e-3)
    each = [float(length(*(float(x[i]) for x in numbers))) for i in range(3)]
    np.testing.assert_allclose(each, expected.length, rtol=1e-12)
    np.testing.assert_allclose(length(*numbers), expected.length, rtol=1e-12)
    on = functools.partial(length, sites=128)
    np.testing.assert_allclose(jax.jit(jax.vmap(on))(*numbers), expected.length, rtol=1e-9)
    slopes = jax.jit(jax.vmap(jax.grad(on, argnums=range(5))))(*numbers)
    every = *jax.tree.leaves(expected.slider), *jax.tree.leaves(expected.interface)
    np.testing.assert_allclose(slopes, every, rtol=1e-7, atol=1e-8)
    alone = [jax.grad(length, argnums=range(5))(*(float(x[i]) for x in numbers)) for i in range(3)]
    np.testing.assert_allclose(np.transpose(alone), every, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(jax.grad(lambda k: length(numbers[0], k, *numbers[2:]).sum())(numbers[1]), every[1], rtol=1e-7)


@pytest.mark.ci
def test_whole_events_with_an_end_a_machine_and_on_a_profile():
    """As the same contacts of a chain have them."""
    slider = sp.Slider(25.0, 0.5, 0.3, length=64, machine=40.0)
    pulled = sp.series(sp.chain(ended(slider, 64)), sp.Spring(40.0), events=1)
    assert int(pulled.breaks[0]) > int(pulled.extent[0])
    for length in (sp.precursor_length(slider, event="full"), sp.precursor_lengths(slider, event="full")):
        assert float(length) == pytest.approx(float(pulled.length[0]), rel=1e-11)
    profile = sp.Profile(1 + 0.01 * np.sin(np.arange(200)), 0.05)
    rough = sp.rupture(sp.chain(sp.Slider(50.0, 0.1, 0.3), sites=256, interface=profile))
    assert bool(rough.rebreaks)
    found = sp.precursor_length(sp.Slider(50.0, 0.1, 0.3), profile, event="full")
    assert float(found) == pytest.approx(float(rough.length), rel=1e-11)


@pytest.mark.ci
def test_events_in_a_finite_chain_against_dense_solves():
    height = np.array([20.0, 35.0, 50.0])
    found = sp.precursor_lengths(sp.Slider(height, 0.4, 0.3, length=64), event="full")
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
    of_slider = {name: getattr(slider, name) for name in ("height", "stiffness", "poisson")}
    numbers = {name: np.broadcast_to(x, 4) for name, x in (*of_slider.items(), *vars(interface).items())}
    for name, value in numbers.items():
        size = step * np.maximum(np.abs(value), 1e-3)

        def at(sign, name=name, value=value, size=size):
            moved = {**numbers, name: value + sign * size}
            slider = sp.Slider(*(moved[key] for key in ("height", "stiffness", "poisson")))
            return sp.precursor_lengths(slider, sp.Interface(moved["prestress"], moved["threshold_slope"]), event="full")

        difference = (at(1) - at(-1)) / (2 * size)
        np.testing.assert_allclose(
            getattr(found.slider if name in of_slider else found.interface, name),
            difference,
            rtol=2e-5,
            atol=1e-5 * np.abs(found.length).max(),
            err_msg=name,
        )


def test_what_an_event_does_not_take():
    slider = sp.Slider(50.0, 0.3, 0.3)
    with pytest.raises(ValueError, match=r"event = 'whole': must be one of 'domino', 'full'"):
        sp.precursor_lengths(slider, event="whole")
    with pytest.raises(ValueError, match=r"event = 'full': needs the paper's rule"):
        sp.precursor_lengths(slider, rule=sp.SmoothBreak(0.01), event="full")
