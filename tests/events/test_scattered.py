"""Events of contacts that differ: against a dense program draw by draw, one's values, and limits."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.dense_chain import DenseChain

import slippulse_jax as sp
from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.events.first import Relaxed
from slippulse_jax.events.scattered import Scattered, events_noticed

NONE_KEPT = sp.Interface(residual_strength=0.0)


def of_b(height, b, **more):
    return sp.Slider(height, b / (2.6 * height), 0.3, **more)


def thresholds(scatter, sites, draws, seed):
    """Thresholds of each draw, (draws, sites)."""
    body = Relaxed(None, jnp.ones(sites), jnp.zeros(sites))  # pyright: ignore[reportArgumentType]
    each = [body.scattered(scatter, key).threshold for key in jax.random.split(jax.random.key(seed), draws)]
    return np.array(each)


def dense_events(slider, threshold, visible, prestress=0.0, kept=0.0):
    """Left end, length, load and force of events, up to the first of at least this extent; by dense solves."""
    numbers = float(slider.height), float(slider.stiffness), float(slider.poisson)
    chain = DenseChain.uniform(numbers, threshold, np.full(len(threshold), prestress), residual=kept)
    found = []
    while not found or found[-1][1] - found[-1][0] < visible:
        load, first = chain.next_break()
        force = chain.at(load=load).push()
        order = chain.rupture(first)
        found.append((min(order), chain.reach(order), load, force))
    return found


CASES = [
    (12, 0.5, 0.05, 3.0, 0.0, 0.0),
    (12, 2.0, 0.1, 4.0, 0.0, 0.3),
    (25, 1.0, 0.05, 2.5, 0.2, 0.0),
    (25, 0.4, 0.15, 6.0, 0.0, 0.0),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_each_draw_against_dense_solves(case):
    """Of a slider that ends, with prestress or contacts that keep something: every draw, and all that nobody sees before it."""
    height, b, scatter, visible, prestress, kept = case
    sites, draws = 40, 12
    slider, interface = of_b(height, b, length=sites, right="free"), sp.Interface(prestress=prestress, residual_strength=kept)
    found = sp.scattered(slider, interface, threshold_scatter=scatter, visible=visible, draws=draws, seed=3)
    for i, threshold in enumerate(thresholds(scatter, sites, draws, 3)):
        events = dense_events(slider, threshold, visible, prestress, kept)
        left, length, load, force = events[-1]
        assert (int(found.left[i]), int(found.before[i])) == (left, len(events) - 1)
        for one, value in ((found.length, length), (found.load, load), (found.force, force)):
            assert float(one[i]) == pytest.approx(value, rel=1e-9)


VALUES = {  # H/λc, b, r, s: mean of ℓ/H, its error, touching the edge, load over that of uniform contacts, events before
    (50, 0.3, 0.0, 0.02): (0.516, 0.004, 0.92, 0.978, 0.4),
    (50, 0.3, 0.0, 0.05): (0.376, 0.007, 0.60, 0.951, 1.6),
    (50, 1.0, 0.0, 0.02): (0.805, 0.003, 0.99, 0.978, 0.0),
    (50, 1.0, 0.0, 0.05): (0.660, 0.006, 0.90, 0.940, 0.5),
    (50, 1.0, 0.0, 0.10): (0.480, 0.010, 0.67, 0.894, 1.7),
    (50, 3.0, 0.0, 0.05): (0.833, 0.004, 0.99, 0.939, 0.2),
    (200, 0.3, 0.0, 0.02): (0.417, 0.002, 0.92, 0.971, 1.0),
    (200, 0.3, 0.0, 0.05): (0.278, 0.005, 0.53, 0.937, 3.7),
    (200, 1.0, 0.0, 0.02): (0.696, 0.002, 0.99, 0.969, 0.2),
    (200, 1.0, 0.0, 0.05): (0.551, 0.005, 0.89, 0.926, 1.3),
    (200, 1.0, 0.0, 0.10): (0.358, 0.007, 0.55, 0.868, 4.0),
    (200, 3.0, 0.0, 0.05): (0.746, 0.003, 0.98, 0.921, 0.6),
    (200, 1.0, 0.3, 0.05): (0.348, 0.004, 0.80, 0.932, 2.0),
    (200, 3.0, 0.3, 0.05): (0.463, 0.003, 0.96, 0.927, 0.9),
}
"""Of a program that shares nothing with this one (400 draws, visible = 0.1 H)."""


@pytest.mark.parametrize("case", [pytest.param(one, marks=pytest.mark.ci) if one[0] > 50 else one for one in VALUES], ids=str)
def test_ensembles_against_another_program(case):
    height, b, kept, scatter = case
    slider, interface, draws = of_b(height, b), sp.Interface(residual_strength=kept), 400
    found = sp.scattered(slider, interface, threshold_scatter=scatter, visible=0.1 * height, draws=draws, seed=7)
    mean, error, touches, load, before = VALUES[case]
    ends = np.asarray(found.length) / height
    assert abs(ends.mean() - mean) < 3 * np.hypot(error, ends.std() / np.sqrt(draws))
    share = float(jnp.mean(found.left == 0))
    assert abs(share - touches) < 3 * np.sqrt(2 * max(touches * (1 - touches), 0.02) / draws) + 0.005
    loads = np.asarray(found.load) / float(sp.first_precursor(slider, interface).load)
    assert abs(loads.mean() - load) < 3 * np.sqrt(2 / draws) * loads.std() + 0.0005
    events = np.asarray(found.before)
    assert abs(events.mean() - before) < 3 * np.sqrt(2 / draws) * max(events.std(), 0.1) + 0.05


BLOCK = sp.Block(16.0, 1 / (2.6 * 16), 0.3, sp.Push(0.15, 0.1), length=48, friction=0.3)


@pytest.mark.parametrize("body", [of_b(30, 1.0), BLOCK], ids=["slider", "block"])
def test_contacts_that_are_alike_all_do_the_same(body):
    """Without scatter every draw is the first event of uniform contacts, if that is seen; load and force too."""
    one = sp.first_precursor(body, event="full")
    found = sp.scattered(body, threshold_scatter=0.0, visible=1.0, draws=3)
    assert (found.length == found.length[0]).all()
    assert (found.before == 0).all()
    assert float(found.length[0]) == pytest.approx(float(one.length), rel=1e-12)
    assert float(found.load[0]) == pytest.approx(float(one.load), rel=1e-12)
    series = sp.series(body, events=1, sites=90)
    assert float(found.force[0]) == pytest.approx(float(series.force_before[0]), rel=1e-12)


def test_draws_do_not_depend_on_their_number_nor_contacts_on_theirs():
    few, many = (sp.scattered(of_b(20, 1.0), threshold_scatter=0.05, visible=2.0, draws=n) for n in (5, 9))
    assert (many.length[:5] == few.length).all()
    assert (many.load[:5] == few.load).all()
    assert (thresholds(0.05, 40, 3, 1) == thresholds(0.05, 90, 3, 1)[:, :40]).all()
    longer = sp.scattered(of_b(20, 1.0), threshold_scatter=0.05, visible=2.0, draws=5, sites=120)
    np.testing.assert_allclose(longer.length, few.length, rtol=1e-9)
    other = sp.scattered(of_b(20, 1.0), threshold_scatter=0.05, visible=2.0, draws=5, seed=1)
    assert (other.length != few.length).any()


def test_one_series_has_what_is_noticed_by_every_apparatus():
    """The first event of at least any extent, among those that are larger than all before."""
    slider, scatter, draws = of_b(40, 0.4), 0.08, 20
    visible = [2.0, 4.0, 8.0]
    contacts = slider.contacts(NONE_KEPT, 120)

    @jax.jit
    def every(key):
        return events_noticed(contacts.scattered(scatter, key), jnp.asarray(visible[0]), jnp.asarray(visible[-1]), 12)

    each = [every(key) for key in jax.random.split(jax.random.key(0), draws)]
    for least in visible:
        found = sp.scattered(slider, threshold_scatter=scatter, visible=least, draws=draws)
        for i, one in enumerate(each):
            at = int(np.argmax(np.asarray(one.length - one.left) >= least))
            assert (one.length[at], one.left[at]) == (found.length[i], found.left[i])
    assert len({float(x.length[0]) for x in each} ^ {float(x) for x in found.length}) > 0


def test_it_can_be_compiled_and_mapped():
    """One program, the same draws; every number may be traced, the seed too."""
    draw = partial(sp.scattered, draws=4, sites=60)
    alone = [
        draw(of_b(20, b), threshold_scatter=s, visible=v, seed=k) for b, s, v, k in ((1.0, 0.05, 2.0, 0), (0.5, 0.1, 4.0, 3))
    ]

    def one(b, s, v, seed):
        return draw(of_b(20.0, b), threshold_scatter=s, visible=v, seed=seed)

    given = jnp.array([1.0, 0.5]), jnp.array([0.05, 0.1]), jnp.array([2.0, 4.0]), jnp.array([0, 3])
    for found in (jax.vmap(one)(*given), jax.jit(jax.vmap(one))(*given)):
        for i, own in enumerate(alone):
            np.testing.assert_allclose(found.length[i], own.length, rtol=1e-12)
            assert (found.left[i] == own.left).all()


def test_it_refuses_to_be_differentiated():
    with pytest.raises(TypeError, match="cannot be differentiated"):
        jax.grad(lambda s: sp.scattered(of_b(20, 1.0), threshold_scatter=s, visible=2.0, draws=2, sites=60).length.sum())(0.05)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"threshold_scatter": -0.01}, r"threshold_scatter = -0.01: must lie in \[0, 1\)"),
        ({"threshold_scatter": 1.0}, "threshold_scatter = 1"),
        ({"threshold_scatter": np.nan}, "threshold_scatter = nan"),
        ({"threshold_scatter": [0.1, 0.2]}, "threshold_scatter has shape"),
        ({"visible": 0.0}, "visible = 0: must be positive"),
        ({"visible": np.inf}, "visible = inf"),
        ({"draws": 0}, "draws = 0: must be a whole number, at least 1"),
        ({"seed": -1}, "seed = -1: must be a whole number"),
        ({"interface": sp.Interface(prestress=0.8)}, "prestress = 0.8: must be at most 1 − 5 s = 0.75"),
        ({"interface": sp.Profile(threshold=np.full(60, 0.3), prestress=np.full(60, 0.25))}, "below the prestress"),
        ({"interface": 0.2}, "interface is float"),
        ({"body": 3.0}, "body is float"),
        ({"sites": 1}, "sites = 1"),
    ],
    ids=str,
)  # fmt: skip
def test_what_it_refuses(given, message):
    with pytest.raises((ValueError, TypeError), match=message):
        sp.scattered(**{"body": of_b(20, 1.0), "threshold_scatter": 0.05, "visible": 2.0} | given)  # pyright: ignore


def test_an_event_that_runs_on_is_said_and_no_length():
    """At the end of a body ℓ is inf; of a body without end, beyond what can be resolved, that is an error."""
    pushed = sp.Interface(prestress=0.7)
    found = sp.scattered(of_b(10, 1.0, length=20), pushed, threshold_scatter=0.05, visible=3.0, draws=3)
    assert np.isinf(np.asarray(found.length)).all()
    assert (found.status == Outcome.SPANNED).all()
    with pytest.raises(NotConverged, match="of some draws events reach beyond 4096 contacts"):
        sp.scattered(of_b(10, 1.0), pushed, threshold_scatter=0.05, visible=3.0, draws=4)
    assert isinstance(found, Scattered)
