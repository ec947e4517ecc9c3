"""Delayed repinning in ruptures and series: against a program that takes detached contacts out of the matrix."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import ended
from oracles import dense_chain
from oracles.dense_chain import DenseChain

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome

pytestmark = pytest.mark.ci

FIG2 = sp.Slider(25.0, 0.03, 0.3)


def rough(delay):
    rng = np.random.default_rng(delay)
    slider = (rng.uniform(5, 12), 10 ** rng.uniform(-2, -1), 0.3)
    theta, phi = rng.uniform(0.9, 1.1, 30), rng.uniform(0, 0.2, 30)
    chain = sp.chain(ended(sp.Slider(*slider), 30), threshold=theta, prestress=phi)
    return DenseChain.uniform(slider, theta, phi, delay=delay), chain


@pytest.mark.parametrize("delay", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 3))])
def test_series_against_dense_program(delay):
    plain, chain = rough(delay)
    got = sp.series(chain, events=20, repin_delay=delay, recorded_breaks=4000, stop_when_spanning=False)
    got = jax.tree.map(np.asarray, got)
    assert int(got.status) == Outcome.DONE
    start = plain.energy()
    for e in range(20):
        order = plain.event()
        assert list(got.break_site[got.break_event == e]) == order, e
        assert abs(got.load[e] - plain.load) < 1e-9
        assert abs(got.force_after[e] - plain.push()) < 1e-9
        assert abs(got.stored[e] - (plain.energy() - start)) < 1e-9
    assert (np.asarray(got.breaks) > delay + 1).any(), "an event in which contacts repin while it goes on"
    assert abs(got.state.pinning - plain.pinning).max() < 1e-9
    assert got.drift < 1e-12
    assert got.energy_drift < 1e-12


@pytest.mark.parametrize("delay", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_rupture_against_dense_program(delay):
    plain, chain = rough(delay)
    load = 5.0
    got = sp.rupture(chain, chain.relaxed(load), repin_delay=delay)
    before = plain.at(load=load).energy()
    order = plain.rupture()
    assert list(got.order[: len(order)]) == order
    assert int(got.breaks) == len(order) > delay + 1
    assert abs(got.state.pinning - plain.pinning).max() < 1e-10
    assert abs(got.energy - (before - plain.energy())) < 1e-10
    assert got.drift < 1e-12


@pytest.mark.parametrize("delay", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_first_precursor_against_dense_solves(delay):
    """A pulse that is n sites wide: its count, load and length, of a rupture and of a series."""
    broken, excess, load, _ = dense_chain.front(25.0, 0.03, 0.3, np.ones(150), np.zeros(150), delay, 150)
    chain = sp.chain(FIG2, sites=150)
    got = sp.rupture(chain, repin_delay=delay)
    assert int(got.status) == Outcome.ARRESTED
    assert int(got.breaks) == broken > 26
    assert abs(got.length - dense_chain.crossing(excess, degree=1)) < 1e-9
    first = sp.series(chain, events=1, repin_delay=delay)
    assert int(first.breaks[0]) == broken
    assert abs(first.load[0] - load) < 1e-10


def test_no_elimination_of_a_batch():
    """jaxlib's waits within a thread of XLA's pool for others of it: two at once never end on two cores."""
    chain = sp.chain(FIG2, sites=30)
    loads = jax.vmap(chain.relaxed)(jnp.array([4.0, 5.0, 6.0]))
    rupture = jax.jit(jax.vmap(lambda state: sp.rupture(chain, state, repin_delay=3).length)).lower(loads)
    for line in rupture.compile().as_text().splitlines():
        if "custom-call(" in line and "lapack" in line:
            assert re.search(r"= \(?f64\[\d+(,\d+)?\]", line), line


def test_refusals():
    chain = sp.chain(FIG2, sites=10)
    with pytest.raises(ValueError, match="repin_delay = -1"):
        sp.series(chain, events=1, repin_delay=-1)
    with pytest.raises(ValueError, match="repin_delay = 1.5"):
        sp.rupture(chain, chain.relaxed(), repin_delay=1.5)  # pyright: ignore
    with pytest.raises(ValueError, match="smooth rule"):
        sp.rupture(chain, chain.relaxed(), repin_delay=1, rule=sp.SmoothBreak(0.01))
