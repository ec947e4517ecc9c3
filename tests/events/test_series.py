"""Series of events against a program that solves the chain anew after every break; energies; what the protocols do."""

import jax
import numpy as np
import pytest
from chains import SITES, ended, long_series
from oracles.dense_chain import DenseChain, ages
from problems import PAPER

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.events.catalogue import EventClass
from slippulse_jax.events.series import Adiabatic

FIG2 = PAPER.slider
CHAIN = sp.chain(sp.Slider(*FIG2), sites=SITES)


CASES = [
    ("adiabatic", "free", None),
    pytest.param("adiabatic", "semi-infinite", ("exponential", 0.3, 3.0), marks=pytest.mark.ci),
    pytest.param("steps", "clamped", None, marks=pytest.mark.ci),
    pytest.param("spring", "semi-infinite", None, marks=pytest.mark.ci),
    pytest.param("spring", "free", ("logarithmic", 0.4, 2.0), marks=pytest.mark.ci),
    pytest.param("steps", "free", ("exponential", 0.5, 1.0), marks=pytest.mark.slow),
]


@pytest.mark.ci
@pytest.mark.parametrize(("protocol", "right", "ageing"), CASES)
def test_against_dense_program(protocol, right, ageing):
    rng = np.random.default_rng(len(protocol))
    sites, events = SITES, 25
    slider = (rng.uniform(5, 12), 10 ** rng.uniform(-2, -1), 0.3)
    theta, phi = rng.uniform(0.9, 1.1, sites), rng.uniform(0, 0.2, sites)
    protocols = {"adiabatic": Adiabatic(), "steps": sp.Steps(0.21), "spring": sp.Spring(4.0)}
    law = None if ageing is None else ages(*ageing)
    plain = DenseChain.uniform(slider, theta, phi, right, strength=law, spring=4.0 if protocol == "spring" else None)
    chain = sp.chain(ended(sp.Slider(*slider), sites, right), sites=sites, threshold=theta, prestress=phi)
    aged = None if ageing is None else sp.Ageing(ageing[1], ageing[2], ageing[0])
    got = jax.tree.map(np.asarray, long_series(chain, protocols[protocol], ageing=aged))
    for e in range(events):
        order = plain.event(0.21 if protocol == "steps" else None)
        assert list(got.break_site[got.break_event == e]) == order, e
        assert abs(got.load[e] - plain.load) < 1e-9
        assert abs(got.force_after[e] - plain.push()) < 1e-9
        # what is booked as work less losses, event by event, is in the springs
        assert abs(got.stored[e] - plain.energy()) < 1e-9
        np.testing.assert_allclose(got.length[e], plain.reach(order), rtol=1e-9, atol=1e-9)
        assert (got.site[e], got.leftmost[e], got.extent[e]) == (order[0], min(order), max(order) + 1)
    assert got.drift < 1e-12


@pytest.mark.ci
@pytest.mark.parametrize("right", ["free", "clamped"])
def test_state_of_a_short_chain_against_dense_program(right):
    """A few contacts are one block; the state after the last event."""
    rng = np.random.default_rng(7)
    slider, theta, phi = (8.0, 0.03, 0.3), rng.uniform(0.9, 1.1, 30), rng.uniform(0, 0.2, 30)
    plain = DenseChain.uniform(slider, theta, phi, right)
    chain = sp.chain(ended(sp.Slider(*slider), 30, right), sites=30, threshold=theta, prestress=phi)
    got = sp.series(chain, events=25, recorded_breaks=4000, stop_when_spanning=False)
    assert int(got.status) == Outcome.DONE
    assert list(got.break_site[got.break_event >= 0]) == [site for _ in range(25) for site in plain.event()]
    assert abs(got.state.pinning - plain.pinning).max() < 1e-9
    assert abs(got.stored[-1] - plain.energy()) < 1e-9


def energies(catalogue):
    n = int(catalogue.number)
    stored = np.diff(np.append(0, catalogue.stored[:n]))
    return abs((catalogue.work - catalogue.broken - catalogue.relaxed)[:n] - stored)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("protocol", "ageing"),
    [
        (Adiabatic(), None),
        (Adiabatic(), sp.Ageing(0.3, 3.0)),
        (sp.Steps(0.5), None),
        (sp.Spring(10.0), None),
        *(pytest.param(protocol, sp.Ageing(0.3, 3.0), marks=pytest.mark.slow) for protocol in (sp.Steps(0.5), sp.Spring(10.0))),
    ],
)
def test_energy_of_every_event(protocol, ageing):
    """Work of the drive = stored + broken + relaxed, and the stored energy is that of the springs of the final state."""
    got = long_series(CHAIN, protocol, ageing=ageing)
    assert energies(got).max() < 1e-9
    assert got.energy_drift < 1e-9
    assert (np.asarray(got.broken)[: int(got.number)] > 0).all()
    assert (np.asarray(got.relaxed)[: int(got.number)] > -1e-12).all()


@pytest.mark.ci
def test_stored_energy_is_that_of_the_springs():
    chain = sp.chain(ended(sp.Slider(*FIG2), SITES))
    got = long_series(chain)
    at_end = sp.equilibrium(chain, got.state)
    u_t, u = np.asarray(at_end.upper), np.asarray(at_end.layer)
    springs = (25 * np.diff(u_t) ** 2).sum() + (np.diff(u) ** 2).sum() + (chain.across * (u_t - u) ** 2).sum()
    assert abs(got.stored[-1] - (springs + 0.03 * ((u - got.state.pinning) ** 2).sum()) / 2) < 1e-12


@pytest.mark.ci
def test_first_event_is_the_first_precursor():
    got = long_series(CHAIN)
    assert (int(got.breaks[0]), int(got.extent[0]), int(got.kind[0])) == (26, 26, EventClass.EDGE)
    assert round(float(got.load[0]), 4) == 3.1985
    assert abs(got.length[0] - sp.precursor_length(sp.Slider(*FIG2))) < 1e-10
    pulled = long_series(CHAIN, sp.Spring(10.0))  # from one site to the left: the driver
    assert abs(pulled.length[0] - sp.precursor_length(ended(sp.Slider(*FIG2), machine=10.0))) < 1e-10


@pytest.mark.ci
@pytest.mark.parametrize("seed", [47, 196])
def test_one_length_of_an_event_whose_rightmost_contact_breaks_twice(seed):
    """Series, rupture and dense program: by the overload of the first break, as no later break makes an event shorter."""
    rng = np.random.default_rng(seed)
    height, b, factor = (rng.choice(x) for x in ([5.0, 10.0, 25.0], [1.0, 5.0, 20.0], [1.1, 1.5, 2.5]))
    slider, theta = (height, b / (2.6 * height), 0.3), rng.uniform(0.7, 1.3, 60)
    chain = sp.chain(sp.Slider(*slider), sites=60, threshold=theta)
    load = float(sp.nucleate(chain)[0].load) * factor
    event = sp.rupture(chain, chain.relaxed(load), max_breaks=200)
    assert event.broken[int(event.extent) - 1] == 2
    plain = DenseChain.uniform(slider, theta, np.zeros(60), "semi-infinite")
    order = plain.event(load)
    assert order == [int(site) for site in event.order[: int(event.breaks)]]
    assert float(event.length) == pytest.approx(plain.reach(order), abs=1e-10)
    assert float(sp.series(chain, sp.Steps(load), events=1).length[0]) == pytest.approx(plain.reach(order), abs=1e-10)


@pytest.mark.ci
def test_a_series_ends_at_a_load():
    """With the first event at or beyond it; the events before it are the same."""
    whole, cut = long_series(CHAIN), sp.series(CHAIN, events=400, until=4.2)
    count = int(cut.number)
    assert cut.status == Outcome.DONE
    assert cut.load[count - 2] < 4.2 <= cut.load[count - 1]
    assert np.array_equal(cut.load[:count], whole.load[:count])
    assert np.isnan(cut.load[count:]).all()
    assert int(sp.series(CHAIN, sp.Steps(0.001), events=400, until=100.0).number) == 400


@pytest.mark.ci
def test_how_far_fronts_have_come_hardly_depends_on_the_step():
    """At loads from 3.5 to 6 u_s, in steps of 0.05 to 1 u_s, within 3 λc of the adiabatic series; over that range it doubles."""
    loads = np.arange(4.0, 6.5, 1)
    slowly = sp.series(CHAIN, events=400, until=6.5).reach(loads)
    assert slowly[-1] > 1.7 * slowly[0]
    for step in (0.05, 0.1, 0.25, 0.5, 1.0):
        stepped = sp.series(CHAIN, sp.Steps(step), events=400, until=6.5)
        assert np.abs(stepped.reach(loads) - slowly).max() < 3
    assert slowly[0] == pytest.approx(36.9, abs=0.1)
    held = sp.series(CHAIN, events=400, until=3.9)  # the last event, at 3.9, breaks three contacts at the edge
    front = float(np.nanmax(held.length))
    last = float(held.load[int(held.number) - 1])
    farthest = float(held.load[np.nanargmax(held.length)])
    assert farthest < last
    assert held.reach([farthest, (farthest + last) / 2, last]) == pytest.approx([front] * 3)
    assert np.isnan(held.reach(last * (1 + 1e-12)))
    assert sp.series(CHAIN, events=400, until=4.0).reach([3.0, 100.0]) == pytest.approx([0, np.nan], nan_ok=True)
    assert sp.series(CHAIN, sp.Steps(1.0), events=400, until=100.0).reach(50.0) == np.inf


@pytest.mark.ci
def test_force_at_which_the_front_reaches_a_position():
    """The twin of `reach`: on the steps of the first event that gets as far; NaN where no event did, and beyond the body."""
    found = sp.series(CHAIN, events=60, until=5.0)
    n = int(found.number)
    lengths, forces = (np.asarray(x)[:n] for x in (found.length, found.force_before))
    at = np.concatenate([lengths, lengths - 1e-6, [0.0, -1.0, lengths.max() + 1e-9, SITES + 1.0]])
    strength = float(CHAIN.stiffness) * SITES
    want = [forces[lengths >= x][0] / strength if (lengths >= x).any() and 0 <= x <= SITES else np.nan for x in at]
    np.testing.assert_allclose(found.force_at(at), want, rtol=1e-12)
    assert np.isnan(want[-3:]).all()
    assert float(found.force_at(lengths[0], 250.0)) == pytest.approx(250 * forces[0] / strength)
    assert found.reach(float(found.load[0])) >= lengths[0]
    short = sp.chain(ended(sp.Slider(8.0, 0.03, 0.3), 30))
    whole = sp.series(short, events=200)
    assert int(whole.status) == Outcome.SPANNED
    last = int(whole.number) - 1
    assert float(whole.force_at(30.0)) == pytest.approx(float(whole.force_before[last] / short.stiffness) / 30)
    both = jax.vmap(lambda q: sp.series(sp.chain(sp.Slider(25.0, q, 0.3), sites=SITES), events=60).force_at(20.0))(
        np.array([0.03, 0.02])
    )
    assert float(both[0]) == pytest.approx(float(found.force_at(20.0)), rel=1e-6)


@pytest.mark.ci
def test_the_protocol_decides_what_the_precursors_look_like():
    """C13. Adiabatically events renucleate at the stress peak, and the second pulse breaks 3 contacts at U = 3.90; in steps of
    0.5 u_s every event breaks some 20 to 40 contacts at first."""
    adiabatic = long_series(CHAIN)
    kinds, edge = np.asarray(adiabatic.kind), np.nonzero(np.asarray(adiabatic.kind) == EventClass.EDGE)[0]
    assert (kinds[1 : edge[1]] == EventClass.RENUCLEATED).all()
    assert (adiabatic.breaks[1 : edge[1]] == 1).all()
    assert int(adiabatic.breaks[edge[1]]) == 3
    assert round(float(adiabatic.load[edge[1]]), 2) == 3.90
    stepped = long_series(CHAIN, sp.Steps(0.5))
    assert list(stepped.extent[1:6]) == [39, 46, 54, 60, 67]


@pytest.mark.ci
def test_a_stiff_spring_is_no_spring():
    direct, stiff = long_series(CHAIN), long_series(CHAIN, sp.Spring(1e9))
    assert np.array_equal(direct.extent[:30], stiff.extent[:30])
    assert abs(direct.load - stiff.load)[:30].max() < 1e-6


@pytest.mark.ci
@pytest.mark.parametrize("stop", [True, False])
def test_an_event_spans_whatever_pulls_the_edge(stop):
    """The driver's own site is not one of the chain's: the last contact is, and its break ends a series."""
    chain = sp.chain(ended(sp.Slider(10.0, 0.1, 0.3), 30))
    direct, pulled = (sp.series(chain, how, events=16, stop_when_spanning=stop) for how in (Adiabatic(), sp.Spring(1e9)))
    assert int(direct.status) == (Outcome.SPANNED if stop else Outcome.DONE)
    assert EventClass.SPANNING in direct.kind
    for name in ("extent", "kind", "breaks", "number", "status"):
        np.testing.assert_array_equal(getattr(pulled, name), getattr(direct, name), err_msg=name)
    np.testing.assert_allclose(pulled.length, direct.length, rtol=1e-6)


@pytest.mark.slow
def test_lanes_do_not_depend_on_their_order_nor_disturb_each_other():
    def run(height):
        return sp.series(sp.chain(sp.Slider(height, 0.03, 0.3), sites=40), events=6, stop_when_spanning=False)

    heights = np.array([10.0, 25.0, 15.0])
    batch = jax.jit(jax.vmap(run))
    together = jax.tree.map(np.asarray, batch(heights))
    order = [2, 0, 1]
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[order], b), together, batch(heights[order]))
    # the springs are made from the sliders outside the lanes: by another program where a batch has one
    np.testing.assert_allclose(batch(heights[1:2]).load[0], together.load[1], rtol=1e-14)
    alone = jax.tree.map(np.asarray, long_series(CHAIN))  # of more sites, which an endless chain does not notice
    assert np.array_equal(alone.extent[:6], together.extent[1])
    assert np.allclose(alone.load[:6], together.load[1], rtol=1e-12)


@pytest.mark.ci
def test_endings_are_reported():
    slider = sp.Slider(*FIG2)
    free = sp.chain(ended(slider, SITES))
    assert int(sp.series(free, events=400, until=100.0).status) == Outcome.SPANNED
    assert int(sp.series(CHAIN, events=400, max_breaks=5).status) == Outcome.LIMIT
    assert int(long_series(sp.chain(slider, sites=SITES, prestress=1.5)).status) == Outcome.INVALID
    assert int(long_series(sp.chain(slider, sites=SITES, contact=0.0)).status) == Outcome.NOTHING_LEFT


@pytest.mark.ci
def test_refusals():
    slider = sp.Slider(*FIG2)
    with pytest.raises(ValueError, match="events = 0"):
        sp.series(sp.chain(slider, sites=10), events=0)
    with pytest.raises(ValueError, match="Steps.size = -1"):
        sp.series(sp.chain(slider, sites=10), sp.Steps(-1.0), events=1)
    with pytest.raises(TypeError, match="protocol"):
        sp.series(sp.chain(slider, sites=10), "adiabatic", events=1)  # pyright: ignore
    with pytest.raises(TypeError, match="cannot be differentiated"):
        jax.grad(lambda k: sp.series(sp.chain(sp.Slider(25.0, k, 0.3), sites=40), events=2).load[1])(0.03)
