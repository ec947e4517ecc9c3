"""Ageing: crossings against a root finder, limits, and events that grow until one spans (C14)."""

import jax
import numpy as np
import pytest
from chains import SITES, ended, long_series
from oracles.dense_chain import DenseChain, ages
from problems import PAPER
from scipy.optimize import brentq

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.events.ageing import next_crossing
from slippulse_jax.events.series import Adiabatic

FIG2 = sp.Slider(*PAPER.slider)
CHAIN = sp.chain(FIG2, sites=SITES)


def first_zero(gap, end, points=20_000):
    """The first zero of a function that is positive at 0, up to `end`; inf if there is none."""
    at = np.linspace(0, end, points)
    below = np.flatnonzero(gap(at) <= 0)
    return brentq(gap, at[below[0] - 1], at[below[0]], xtol=1e-15, rtol=1e-14) if below.size else np.inf


@pytest.mark.ci
@pytest.mark.parametrize("pressed", [False, True])
@pytest.mark.parametrize("law", ["exponential", "logarithmic"])
def test_crossings_against_a_root_finder(law, pressed):
    """The first crossing, where there are several too: a pressure that the push raises makes the threshold outgrow the stress."""
    rng = np.random.default_rng(1)
    n = 400
    ageing, grown = sp.Ageing(0.3, 2.0, law), ages(law, 0.3, 2.0)
    age, threshold = rng.uniform(0, 5, n), rng.uniform(0.8, 1.2, n)
    slope, pressure, lost = 10 ** rng.uniform(-4, 0.5, n), np.ones(n), np.zeros(n)
    if pressed:  # in the second half the stress outgrows a young contact, and the pressure the stress in the end
        age[n // 2 :] /= 10
        pressure, lost = rng.uniform(0.5, 1.5, n), rng.uniform(-0.7, 0.5, n) * slope
        lost[n // 2 :] = rng.uniform(1, 4, n // 2)
        slope[n // 2 :] = lost[n // 2 :] * rng.uniform(0.6, 0.95, n // 2)
    stress = threshold * grown(age) * pressure * rng.uniform(0, 0.999, n)

    def gap(i):
        return lambda d: threshold[i] * grown(age[i] + d) * (pressure[i] + lost[i] * d) - stress[i] - slope[i] * d

    pushes, held = np.stack([slope, lost])[: 1 + pressed], np.stack([stress, pressure])[: 1 + pressed]

    @jax.vmap
    def alone(push, threshold, readings, age):  # so that each is the first of all
        return next_crossing(push[:, None], threshold[None], readings[:, None], ageing=ageing, age=age[None])[0]

    got, several = alone(pushes.T, threshold, held.T, age), 0
    for i in range(n):
        far = min(40 / slope[i], pressure[i] / -lost[i] if lost[i] < 0 else np.inf)
        root = first_zero(gap(i), far)
        assert got[i] >= 0.999 * far if np.isinf(root) else abs(got[i] - root) < 1e-9 * (1 + root), i
        several += bool(np.isfinite(root) and (gap(i)(np.linspace(root, far, 5000)[1:]) > 1e-9).any())
    assert several > 10 or not pressed
    together = np.asarray(next_crossing(pushes, threshold, held, ageing=ageing, age=age))
    first = min(range(n), key=lambda i: first_zero(gap(i), 40 / slope[i]))
    assert np.argmin(together) == first
    assert together[first] == pytest.approx(first_zero(gap(first), 40 / slope[first]), abs=1e-12)


def test_never_broken_and_unpulled_contacts():
    ageing = sp.Ageing(0.3, 2.0)
    push, stress, age = np.array([[0.1, 0.0]]), np.array([[0.5, 0.5]]), np.array([np.inf, 1.0])
    got = next_crossing(push, np.ones(2), stress, ageing=ageing, age=age)
    assert abs(got[0] - 5) < 1e-14
    assert np.isinf(got[1])


@pytest.mark.slow
def test_infinitely_fast_ageing_is_none():
    none, fast = long_series(CHAIN), long_series(CHAIN, ageing=sp.Ageing(0.999999, 1e-12))
    assert np.array_equal(none.extent[1:30], fast.extent[1:30])
    assert abs(none.load - fast.load)[:30].max() < 1e-5


@pytest.mark.ci
def test_infinitely_slow_ageing_leaves_broken_contacts_weak():
    """As a chain whose broken contacts have the newborn threshold for ever: against the dense program."""
    plain = DenseChain.uniform((10.0, 0.03, 0.3), np.ones(SITES), np.zeros(SITES), strength=lambda a: 0.5 + 0 * a)
    chain = sp.chain(ended(sp.Slider(10.0, 0.03, 0.3), SITES))
    got = jax.tree.map(np.asarray, long_series(chain, ageing=sp.Ageing(0.5, 1e12)))
    for e in range(12):
        assert list(got.break_site[got.break_event == e]) == plain.event()


@pytest.mark.ci
def test_time_and_load_are_one_clock_at_constant_velocity():
    load = long_series(CHAIN, ageing=sp.Ageing(0.3, 3.0))
    time = long_series(CHAIN, Adiabatic(velocity=0.5), ageing=sp.Ageing(0.3, 6.0, clock="time"))
    assert np.allclose(load.load[:30], time.load[:30], rtol=1e-12)
    slower = long_series(CHAIN, Adiabatic(velocity=0.05), ageing=sp.Ageing(0.3, 6.0, clock="time"))
    assert not np.array_equal(load.extent[:30], slower.extent[:30]), "slow loading gives contacts time to recover"


@pytest.mark.ci
def test_with_ageing_precursors_grow_until_one_spans():
    """C14: thresholds reborn at 0.3 σ_s and recovering over 3 u_s of load, N = 150."""
    got = sp.series(sp.chain(FIG2, sites=150), events=3000, ageing=sp.Ageing(0.3, 3.0))
    assert int(got.status) == Outcome.SPANNED
    n = int(got.number)
    assert int(got.extent[0]) == 34
    furthest = np.maximum.accumulate(np.asarray(got.extent)[:n])
    assert furthest[-1] == 150
    large = np.asarray(got.breaks)[:n] >= 20
    assert (np.diff(np.asarray(got.extent)[:n][large][:3]) > 0).all()
    force = np.asarray(got.force_before)[:n][large]
    assert force[1:3].max() < 0.9 * force[0] < force[-1], "the force falls after the first event, and rises in the end"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"newborn": 0.0, "scale": 1.0}, "newborn"),
        ({"newborn": 0.5, "scale": -1.0}, "scale"),
        ({"newborn": 0.5, "scale": 1.0, "law": "linear"}, "law"),
    ],
)
def test_errors(wrong, message):
    with pytest.raises(ValueError, match=message):
        sp.Ageing(**wrong)
