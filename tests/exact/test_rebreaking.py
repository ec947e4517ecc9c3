"""Where the contact at the edge breaks again before the front stops: one onset by every route, and its limit."""

import jax
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from strategies import random_sliders

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.exact.bulk import NEVER, exact_arrests
from slippulse_jax.exact.front import exact_fields
from slippulse_jax.lengths import arrests

CLOSE = 5e-4
"""Half of what the onsets may differ by, relative."""


def slider_of(b, height, poisson=0.3):
    return sp.Slider(height, b / (2 * (1 + poisson) * height), poisson)


@pytest.mark.parametrize("b", [0.3, 3.0872, 40.0])
def test_edge_stress_of_the_limit_against_the_integral_equation(b):
    """T by integrating its differential equation; the integral equation that it came from; and E, the integral of T."""
    share = b / (2 * (1 + b))
    T = solve_ivp(
        lambda y, t: 1 - t * (1 - share - share * np.exp(-2 * y)), (0, 40), [1], rtol=1e-11, atol=1e-12, dense_output=True
    ).sol
    y = 1.7
    behind, near = (quad(lambda x, sign=sign: T(x)[0] * np.exp(sign * x), 0, y, epsabs=1e-11)[0] for sign in (1, -1))
    assert T(y)[0] == pytest.approx(1 + share * np.exp(-y) * (behind + near), abs=1e-8)
    edge = 2 * share * quad(lambda x: T(x)[0] * np.exp(-x), 0, 40, epsabs=1e-11, limit=200)[0]
    assert float(sp.theory.macroscopic_edge_stress(b)) == pytest.approx(edge, abs=1e-8)


def test_onset_of_the_limit():
    b = sp.theory.rebreaking_b()
    assert b == pytest.approx(3.0872253, abs=1e-7)
    assert float(sp.theory.macroscopic_edge_stress(b)) == pytest.approx(1, abs=1e-14)
    assert float(sp.theory.macroscopic_length(b, 0.3)) == pytest.approx(0.9498, abs=1e-4)
    stresses = np.asarray(sp.theory.macroscopic_edge_stress(np.geomspace(1e-3, 1e6, 200)))
    assert (np.diff(stresses) > 0).all()
    assert stresses[-1] == pytest.approx(1.4714, abs=1e-4)


@pytest.mark.ci
def test_onset_tends_to_the_limit_for_every_poisson_ratio_and_prestress():
    height = np.array([1e4, 1e6, 1e8])
    for poisson, prestress in ((0.3, 0.0), (0.0, 0.0), (0.5, 0.0), (0.3, 0.4)):
        beyond = sp.rebreaking_onset(height, poisson, prestress) - sp.theory.rebreaking_b()
        np.testing.assert_allclose(beyond * np.sqrt(height), beyond[-1] * 1e4, rtol=0.03)
        assert 0 < beyond[-1] < 7e-4


@pytest.mark.ci
def test_onsets_of_the_documentation():
    onset = sp.rebreaking_onset([5, 10, 25, 100, 1e3, 1e4, 1e5], 0.3)
    np.testing.assert_allclose(onset, [np.inf, 8.458, 4.883, 3.752, 3.267, 3.142, 3.104], atol=6e-4)
    with pytest.raises(ValueError, match=r"rebreaking_onset: height = 0.5"):
        sp.rebreaking_onset(0.5, 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("height", [100.0, 1000.0, 10_000.0, 100_000.0])
def test_recursion_and_closed_form_have_one_onset(height):
    onset = sp.rebreaking_onset(height, 0.3)
    slider = slider_of(onset * np.array([1 - CLOSE, 1 + CLOSE]), height)
    expected = [Outcome.ARRESTED, Outcome.REBREAK]
    assert arrests(slider).status.tolist() == expected
    assert sp.exact_front(slider).status.tolist() == expected
    scanned = sp.sweep(height=height, stiffness=slider.stiffness, poisson=0.3, outputs=("status", "exact_status"))
    assert scanned.status.values.tolist() == scanned.exact_status.values.tolist() == expected


@pytest.mark.ci
@pytest.mark.parametrize(("height", "sites"), [(100.0, 150), pytest.param(1000.0, 1200, marks=pytest.mark.slow)])
def test_the_cascade_has_the_same_onset(height, sites):
    """Contact 0 is the first to break again, and the event then goes at least as far as its front."""
    onset = float(sp.rebreaking_onset(height, 0.3))

    def event(b):
        chain = sp.chain(slider_of(b, height), sites=sites)
        state, trigger = sp.nucleate(chain)
        return sp.rupture(chain, state, trigger=trigger, max_breaks=2 * sites)

    below, above = (event(onset * (1 + sign * CLOSE)) for sign in (-1, 1))
    assert not below.rebreaks
    assert above.rebreaks
    order = np.asarray(above.order)
    again = int(np.flatnonzero([site in order[:i] for i, site in enumerate(order[: int(above.breaks)])])[0])
    assert order[again] == 0
    assert above.length >= arrests(slider_of(onset * (1 + CLOSE), height)).length - 1e-6


@pytest.mark.slow
def test_statuses_and_edge_stress_of_random_sliders():
    """On relaxed and prestressed interfaces; a front that breaks contact 0 alone arrests in the one record, is none in the other."""
    rng = np.random.default_rng(5)
    sliders = np.stack([10 ** rng.uniform(0.4, 3.2, 600), 10 ** rng.uniform(-4, 0, 600), rng.uniform(0, 0.5, 600)])
    contacts = np.where(rng.random((2, 600)) < 0.5, 0, [rng.uniform(-0.5, 0.45, 600), rng.uniform(-1e-3, 1e-2, 600)])
    length, status = exact_arrests(np.vstack([sliders, contacts]))
    by_recursion = arrests(sp.Slider(*sliders), sp.Interface(*contacts))
    several = by_recursion.contacts_broken > 1
    np.testing.assert_array_equal(status[several], by_recursion.status[several])
    assert (status == Outcome.REBREAK).sum() > 100
    assert (status[several] == Outcome.ARRESTED).sum() > 100
    b = 2 * (1 + sliders[2]) * sliders[0] * sliders[1]
    plain = (b < NEVER) & (contacts == 0).all(0)
    assert by_recursion.edge_stress[plain].max() < 1
    some = np.flatnonzero(several & np.isfinite(length))[:40]
    found = jax.vmap(lambda x, s: exact_fields(sp.Slider(*x[:3]), s, 0, sp.Interface(x[3])).stress)(
        np.vstack([sliders, contacts]).T[some], by_recursion.contacts_broken[some].astype(float)
    )
    np.testing.assert_allclose(found, by_recursion.edge_stress[some], rtol=1e-11)


@pytest.mark.ci
def test_length_and_its_derivative_beyond_the_onset():
    """The status tells the regime; the length of the front and its slope stay what they were."""
    slider = slider_of(40.0, 1e4)
    front = sp.exact_front(slider)
    assert front.status == Outcome.REBREAK
    np.testing.assert_allclose(front.length, sp.exact_length(slider), rtol=1e-13)
    slope = jax.grad(lambda q: sp.exact_front(sp.Slider(1e4, q, 0.3)).length)(slider.stiffness)
    assert slope == pytest.approx(float(sp.exact_lengths(slider, derivatives=1).slider.stiffness), rel=1e-8)


def test_the_slow_decay_length_of_a_slider():
    slider = sp.Slider(*random_sliders(7, seed=1).T)
    np.testing.assert_allclose(slider.slow_decay_length * slider.kappa_2, 1, rtol=1e-15)
