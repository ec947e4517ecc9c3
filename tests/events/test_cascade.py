"""Ruptures against the dense event-by-event program, against the fast recursion, and against themselves in batches."""

import itertools
import os
import subprocess
import sys
import textwrap

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import batch, both_chains, ended
from problems import PAPER

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.chain import State, chain, eliminate
from slippulse_jax.bodies.response import of_chain
from slippulse_jax.events.rupture import _can_break, nucleate, rupture
from slippulse_jax.front.arrest import arrest
from slippulse_jax.rules import SmoothBreak

ENDS = ("semi-infinite", "free", "clamped")
SITES = (2, 3, 5, 8, 13, 29, 64, 150, 300)
SAMPLED_SITES = (5, 300)  # one block, and blocks enough that a rupture leaves most unopened
FIG2 = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)
MAX_BREAKS = 1500


def random_event(rng, sites, right):
    """A heterogeneous, preloaded chain about to rupture, for the dense program and for the package."""
    height, stiffness, poisson = 10 ** rng.uniform(0.3, 1.7), 10 ** rng.uniform(-2.5, -0.5), rng.uniform(0, 0.5)
    spread = rng.choice([0.02, 0.1, 0.3])
    contact = stiffness * 10 ** rng.uniform(-spread, spread, sites) * (rng.random(sites) > rng.choice([0, 0, 0.1]))
    contact[rng.integers(sites)] = stiffness
    fields = {
        "contact": contact,
        "threshold": 1 + spread * rng.uniform(-1, 1, sites),
        "prestress": rng.choice([0, 0.3, 0.5]) * rng.uniform(0.8, 1, sites),
        "upper": height * 10 ** rng.uniform(-spread, spread, sites - 1),
        "layer": 10 ** rng.uniform(-spread, spread, sites - 1),
    }
    numbers, mine = both_chains((height, stiffness, poisson), sites, right, fields)
    pinning = rng.choice([0, 0.2]) * rng.uniform(-1, 1, sites)
    load, trigger = numbers.at(pinning, 0.0).next_break()
    more = rng.choice([1.0, 1.0, 1.2, 2.0])
    if load < 0.1 or more > 1:  # overloaded by its preload already, or loaded beyond the first break at once
        load = max(load, 1.0) * more
        over = np.where(contact > 0, numbers.at(load=load).stress() - fields["threshold"], -np.inf)
        trigger = int(over.argmax()) if over.max() >= 0 else trigger
    return numbers, mine, State(jnp.asarray(pinning), jnp.asarray(load)), trigger


events = jax.jit(jax.vmap(lambda c, s, i: rupture(c, s, trigger=i, max_breaks=MAX_BREAKS)))


def compare(seed, shapes, per_shape):
    """Worst differences over shapes and ends; every sequence of breaks must be the same."""
    worst = {"pinning": 0.0, "layer": 0.0, "upper": 0.0, "stress": 0.0, "energy": 0.0, "residual": 0.0, "drift": 0.0}
    longest = again = beyond = 0
    for sites in shapes:
        cases = [random_event(np.random.default_rng([seed, sites, n]), sites, ENDS[n % 3]) for n in range(per_shape)]
        found = events(batch([c[1] for c in cases]), batch([c[2] for c in cases]), jnp.asarray([c[3] for c in cases]))
        found = jax.tree.map(np.asarray, found)
        for n, (numbers, mine, state, trigger) in enumerate(cases):
            before, load = np.asarray(state.pinning), float(state.load)
            stored = numbers.at(before, load).energy()
            order = numbers.rupture(trigger, MAX_BREAKS)
            one = jax.tree.map(lambda x, n=n: x[n], found)
            assert one.order[: one.breaks].tolist() == order, (sites, n)
            longest, again = max(longest, len(order)), again + (len(set(order)) < len(order))
            (u_t, u), stress = numbers.fields(), numbers.stress()
            assert one.status == expected_status(numbers, order, stress), (sites, n)
            released = stored - numbers.energy()
            digit = 4 * np.finfo(float).eps * np.asarray(mine.upper).max() * np.abs(u_t).max() / abs(one.after.push)
            beyond += one.after.residual > 1e-12
            assert one.after.residual <= max(1e-12, digit)
            for name, difference in {
                "pinning": one.state.pinning - numbers.pinning,
                "layer": one.after.layer - u,
                "upper": one.after.upper - u_t,
                "stress": one.after.stress - stress,
                "energy": (one.energy - released) / max(1, abs(stored)),
                "residual": one.after.residual,
                "drift": one.drift,
            }.items():
                worst[name] = max(worst[name], np.abs(difference).max())
    return worst, longest, again, beyond


def expected_status(numbers, order, stress):
    over = np.where(numbers.k > 0, stress - numbers.threshold, -np.inf)
    if len(order) == MAX_BREAKS and over.max() >= 0:
        return Outcome.LIMIT
    return Outcome.RAN_THROUGH if max(order) == len(numbers.k) - 1 else Outcome.ARRESTED


def check(worst, longest, again, beyond, chains):
    print(f"{chains} chains: longest {longest}, {again} with re-breaks, {beyond} over 1e-12 of balance; worst {worst}")
    assert longest > 150
    assert again > chains / 20  # the sample must hold events in which contacts break twice
    for name in ("pinning", "layer", "upper", "stress", "energy"):
        assert worst[name] < 1e-10, name


@pytest.mark.ci
def test_a_sample_of_random_chains_breaks_as_the_dense_program_does():
    check(*compare(seed=1, shapes=SAMPLED_SITES, per_shape=42), chains=42 * len(SAMPLED_SITES))


@pytest.mark.slow
def test_1000_random_chains_break_as_the_dense_program_does():
    check(*compare(seed=2, shapes=SITES, per_shape=112), chains=112 * len(SITES))


@pytest.mark.ci
@pytest.mark.parametrize("right", ENDS)
@pytest.mark.parametrize("sites", [9, *(pytest.param(n, marks=pytest.mark.ci) for n in (2, 50))])
def test_response_is_the_inverse_of_the_stiffness_matrix(sites, right):
    numbers, mine, _, _ = random_event(np.random.default_rng(sites), sites, right)
    G = numbers.inverse[sites:, sites:] * numbers.k[:, None]
    resp = jax.jit(lambda c: of_chain(c, eliminate(c, c.contact)))(mine)
    found = np.asarray(resp.matrix[:, 0])
    np.testing.assert_allclose(found[:sites, :sites], G.T, rtol=1e-11, atol=1e-300)
    assert not found[sites:].any()


@jax.jit
def first_precursor(slider_fields):
    c = chain(sp.Slider(*slider_fields), sites=2000)
    state, site = nucleate(c)
    return rupture(c, state, trigger=site), site


@pytest.mark.parametrize(
    ("height", "stiffness", "count", "load"),
    [
        (25.0, 0.03, 26, 3.1985),
        *(
            pytest.param(*one, marks=pytest.mark.ci)
            for one in ((10.0, 0.03, 10, 2.0197), (50.0, 0.003, 35, 1.4736), (25.0, 0.003, 16, 1.2770))
        ),
    ],
)
def test_uniform_chain_of_2000_sites_gives_the_count_and_length_of_the_recursion(height, stiffness, count, load):
    numbers = tuple(map(jnp.asarray, (height, stiffness, 0.3)))
    found, site = first_precursor(numbers)
    fast = arrest(sp.Slider(*numbers), most=10_000)
    assert site == 0
    assert found.status == Outcome.ARRESTED
    assert found.extent == found.breaks == fast.contacts_broken == count
    assert found.order[:count].tolist() == list(range(count))
    np.testing.assert_allclose(found.length, fast.length, rtol=1e-11)
    np.testing.assert_allclose(found.state.load, load, atol=5e-5)


STEEPER = 1 + 0.003 * np.arange(40.0)
UNEVEN = {
    "threshold": np.where(np.arange(40) == 9, 1.001, 1.0),
    "prestress": np.where(np.arange(40) == 12, 0.001, 0.0),
    "contact": np.where(np.arange(40) == 3, 0.0301, 0.03),
    "upper": np.where(np.arange(39) == 20, 10.1, 10.0),
}


@pytest.mark.parametrize(
    ("alike", "right", "given", "more"),
    [
        (True, "semi-infinite", {}, {}),
        (True, "free", {"threshold": STEEPER}, {}),
        (True, "clamped", {"prestress": np.full(40, 0.2)}, {}),
        (True, "free", {"threshold": STEEPER, "prestress": np.full(40, -0.3)}, {}),
        *((False, "semi-infinite", {name: value}, {}) for name, value in UNEVEN.items()),
        (False, "semi-infinite", {}, {"pinning": 1e-3 * (np.arange(40) == 15)}),
        (False, "free", {}, {"repin_delay": 2}),
    ],
)
def test_length_ends_on_the_curve_where_all_contacts_are_alike(alike, right, given, more):
    """Any front from the edge: as of the recursion where that has it, and of dense solves; else on a straight line."""
    plain = {"threshold": np.ones(40), "prestress": np.zeros(40), "contact": np.full(40, 0.03)}
    fields = plain | {"upper": np.full(39, 10.0), "layer": np.ones(39)} | given
    dense, made = both_chains((10.0, 0.03, 0.3), 40, right, fields)
    pinning, delay = more.get("pinning", np.zeros(40)), more.get("repin_delay", 0)
    dense.delay = delay
    load, site = dense.at(pinning).next_break()
    order = dense.at(pinning, load).rupture(site)
    found = rupture(made, State(jnp.asarray(pinning), jnp.asarray(load)), trigger=site, repin_delay=delay)
    assert order == list(range(len(order))) == list(found.order[: int(found.breaks)])
    curve, line = (dense.reach(order, alike=x) for x in (True, False))
    assert abs(curve - line) > 1e-5
    assert abs(found.length - (curve if alike else line)) < 1e-9
    if not given.keys() & {"contact", "upper"} and not more:
        interface = sp.Interface(fields["prestress"][0], fields["threshold"][1] - 1)
        if not alike:
            interface = sp.Profile(fields["threshold"], fields["prestress"])
        assert abs(found.length - sp.precursor_length(ended(sp.Slider(10.0, 0.03, 0.3), 40, right), interface)) < 1e-11


@pytest.mark.slow
def test_error_over_a_hundred_thousand_breaks():
    """The bound: n breaks leave a relative error of at most n (ε + 8u), componentwise; what is found is far below it."""
    c = chain(ended(FIG2, 3000))
    found = jax.jit(lambda s: rupture(c, s, max_breaks=100_000))(c.relaxed(2e5))
    assert found.breaks == 100_000
    assert found.status == Outcome.LIMIT
    # ε: relative error of the response, against the same in a reference where it is known to all digits
    print(f"drift {float(found.drift):.2e} σ_s after {int(found.breaks)} breaks, largest {int(found.broken.max())} times")
    largest = float(jnp.abs(found.after.layer).max())
    assert found.drift < 100_000 * 16 * np.finfo(float).eps * max(1.0, float(found.after.stress.max()))
    # the fresh solve itself cannot tell u from u_b to better than a last digit of u
    assert found.drift < 100 * np.finfo(float).eps * largest


@pytest.mark.ci
def test_a_rupture_goes_on_where_it_was_given_up():
    """Stopping after n breaks and going on from that state is the same rupture: nothing is remembered but the state."""
    c = chain(ended(FIG2, 100))
    whole, part = (jax.tree.map(np.asarray, rupture(c, c.relaxed(20.0), max_breaks=n)) for n in (1000, 300))
    rest = jax.tree.map(np.asarray, rupture(c, State(*map(jnp.asarray, part.state)), max_breaks=1000))
    assert part.status == Outcome.LIMIT
    n = int(whole.breaks)
    assert int(whole.broken.max()) > 1
    np.testing.assert_array_equal(np.concatenate([part.order, rest.order])[:n], whole.order[:n])
    np.testing.assert_allclose(rest.state.pinning, whole.state.pinning, atol=1e-11)


# --- batches ---------------------------------------------------------------------------------------------------------

LOADS = np.linspace(2.5, 9.0, 200)


@pytest.fixture(scope="module")
def lanes():
    c = chain(FIG2, sites=120)
    run = jax.jit(jax.vmap(lambda load: rupture(c, State(jnp.zeros(120), load), max_breaks=400)))
    return run, run(jnp.asarray(LOADS))


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 2, 7, 33, 64])
def test_lanes_do_not_depend_on_the_size_of_the_batch(lanes, size):
    run, all_of_them = lanes
    assert len(np.unique(all_of_them.breaks)) > 20
    some = run(jnp.asarray(LOADS[-size:]))
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[-size:], b), all_of_them, some)


@pytest.mark.ci
def test_lanes_do_not_depend_on_their_order_and_one_may_fail(lanes):
    run, all_of_them = lanes
    order = np.random.default_rng(0).permutation(200)
    mixed = run(jnp.asarray(LOADS[order]))
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(np.asarray(a)[order], b), all_of_them, mixed)
    broken = LOADS.copy()
    broken[77] = np.nan
    found = run(jnp.asarray(broken))
    assert found.status[77] == Outcome.INVALID
    assert found.breaks[77] == 0
    assert np.isnan(found.length[77])
    others = np.arange(200) != 77
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(np.asarray(a)[others], np.asarray(b)[others]), all_of_them, found)


DEALT = """
    import jax, jax.numpy as jnp, numpy as np
    jax.config.update("jax_enable_x64", True)
    import slippulse_jax as sp
    from slippulse_jax.events.rupture import rupture
    from slippulse_jax.bodies.chain import State, chain, eliminate
    devices = jax.devices()
    assert len(devices) == 2
    c = chain(sp.Slider(height=25.0, stiffness=0.03, poisson=0.3), sites=60)
    run = jax.jit(jax.vmap(lambda load: rupture(c, State(jnp.zeros(60), load), max_breaks=200)))
    loads = np.linspace(2.5, 9.0, 24)
    one = run(jax.device_put(loads, devices[0]))
    two = [run(jax.device_put(part, device)) for part, device in zip(np.split(loads, 2), devices)]
    for a, first, second in zip(*map(jax.tree.leaves, (one, *two))):
        assert np.asarray(a).tobytes() == np.asarray(first).tobytes() + np.asarray(second).tobytes()
"""
PARTITIONED = """
    from jax.sharding import PartitionSpec
    mesh = jax.make_mesh((2,), ("lanes",), axis_types=(jax.sharding.AxisType.Auto,))
    spec = PartitionSpec("lanes")
    shared = jax.jit(jax.shard_map(run, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False))(loads)
    np.testing.assert_array_equal(shared.order, one.order)
    np.testing.assert_allclose(shared.after.layer, one.after.layer, rtol=0, atol=1e-12)
"""


@pytest.mark.slow
@pytest.mark.parametrize("further", ["", PARTITIONED], ids=["dealt", "partitioned"])
def test_lanes_do_not_depend_on_the_number_of_devices(further):
    """Lanes dealt out to two devices have the bits of one; partitioned by XLA itself, the same breaks (see docs/model/chain.md)."""
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"
    found = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(DEALT) + textwrap.dedent(further)],
        env={**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr


# --- what it refuses and how it ends ---------------------------------------------------------------------------------


def energy_at(height):
    c = chain(sp.Slider(height=height, stiffness=0.03, poisson=0.3), sites=40)
    return rupture(c, c.relaxed(3.5)).energy


@pytest.mark.ci
@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd, jax.jacrev, jax.hessian])
def test_hard_rupture_refuses_to_be_differentiated_and_names_the_surrogate(derivative):
    with pytest.raises(TypeError, match="SmoothBreak"):
        derivative(energy_at)(25.0)
    with pytest.raises(TypeError, match="SmoothBreak"):
        jax.jit(jax.vmap(derivative(energy_at)))(jnp.array([20.0, 25.0]))


@pytest.mark.ci
def test_loading_to_nucleation_is_differentiable():
    def load(height):
        c = chain(sp.Slider(height=height, stiffness=0.03, poisson=0.3), sites=40)
        return nucleate(c)[0].load

    load, slope, h = jax.jit(load), jax.jit(jax.grad(load)), 1e-3
    np.testing.assert_allclose(slope(25.0), (load(25 + h) - load(25 - h)) / (2 * h), rtol=1e-7)


def test_loading_begins_at_any_number():
    c = chain(FIG2, sites=20)
    expected, first = nucleate(c)
    for load in (0, np.int64(1), jnp.int32(1), 0.5):
        state, site = nucleate(c, State(jnp.zeros(20), load))
        assert (float(state.load), int(site)) == (pytest.approx(float(expected.load), rel=1e-12), int(first))


@pytest.mark.ci
def test_how_a_rupture_ends():
    def ends(c, load, **options):
        found = rupture(c, c.relaxed(load), **options)
        return Outcome(int(found.status)), float(found.length), found

    semi, free = chain(FIG2, sites=40), chain(ended(FIG2, 40))
    status, length, found = ends(semi, 1.0)
    assert (status, length, int(found.breaks), int(found.extent)) == (Outcome.NOTHING_BROKE, 0.0, 0, 0)
    assert not found.slip.any()
    assert ends(semi, 3.5)[0] == Outcome.ARRESTED
    status, length, found = ends(free, 9.0)
    assert (status, length, int(found.extent)) == (Outcome.RAN_THROUGH, np.inf, 40)
    status, length, _ = ends(free, 9.0, max_breaks=5)
    assert status == Outcome.LIMIT
    assert np.isnan(length)
    cut = np.ones(39)
    cut[9] = 0
    contact = np.where(np.arange(40) < 10, 0.03, 0)
    floating = chain(ended(FIG2, 40), contact=contact, layer=cut, upper=25 * cut)
    status, length, found = ends(floating, 9.0)
    assert status == Outcome.SINGULAR
    assert int(found.breaks) == 0
    assert ends(semi, np.nan)[0] == Outcome.INVALID


@pytest.mark.ci
def test_a_detached_contact_never_breaks_and_the_front_may_pass_it():
    contact = np.full(40, 0.03)
    contact[5] = 0
    c = chain(FIG2, sites=40, contact=contact)
    state, site = nucleate(c)
    found = rupture(c, state, trigger=site)
    assert found.broken[5] == 0
    assert found.broken[4] == found.broken[6] == 1


def test_refusals():
    c = chain(FIG2, sites=5)
    with pytest.raises(ValueError, match=r"state.pinning has shape \(4,\): must be \(5,\)"):
        rupture(c, State(jnp.zeros(4), jnp.asarray(1.0)))
    with pytest.raises(ValueError, match="linear contacts"):
        rupture(chain(FIG2, sites=5, law=jnp.tanh), c.relaxed())
    with pytest.raises(ValueError, match=r"batch.*jax.vmap"):
        rupture(batch([c, c]), c.relaxed())
    with pytest.raises(TypeError, match="must be None"):
        rupture(c, c.relaxed(), rule=0.01)
    with pytest.raises(ValueError, match="1e-6, 1"):
        SmoothBreak(width=2.0)


@pytest.mark.ci
def test_trigger_that_cannot_break():
    """Out of range, detached, or far below its threshold: ARRESTED once, with lengths beyond the chain."""
    c = chain(FIG2, sites=4, contact=[0.03, 0.03, 0.0, 0.03])
    for site in (-2, 4, 83, 1.5):
        with pytest.raises(ValueError, match=r"trigger = .*: must be one of the sites 0 … 3, or −1"):
            rupture(c, c.relaxed(1.0), trigger=site)
    state, first = nucleate(c)
    traced = jax.jit(jax.vmap(lambda load, site: rupture(c, c.relaxed(load), trigger=site)))
    load = float(state.load)
    found = traced(load * np.array([1, 1 - 1e-9, 1, 1, 1, 0.9]), np.array([first, first, -2, 4, 2, first]))
    assert first != 2
    assert (np.asarray(found.status[:2]) <= Outcome.RAN_THROUGH).all()
    np.testing.assert_array_equal(found.status[2:], Outcome.INVALID)
    assert np.isnan(found.length[2:]).all()
    np.testing.assert_array_equal(found.breaks[2:], 0)
    overloaded = traced(np.full(6, 50 * load), np.array([3, 4, -2, 2, 0, 1]))  # every contact, the last one too
    assert (np.asarray(overloaded.status) == Outcome.INVALID).tolist() == [False, True, True, True, False, False]
    smooth = jax.jit(lambda site: rupture(c, c.relaxed(load), rule=sp.SmoothBreak(0.02), trigger=site).status)
    assert smooth(2) == Outcome.INVALID
    assert smooth(first) != Outcome.INVALID


def test_trigger_just_below_its_threshold():
    """It may lie below by ε^¼ of the largest stress, here 2⁻¹³ of 1, and by no digit more."""
    c, least = chain(FIG2, sites=3), 1 - 2.0**-13
    for stress, allowed in ((least, True), (np.nextafter(least, 0), False)):
        assert _can_break(c, jnp.array([stress, 1.0, 0.5]), jnp.asarray(0)) == allowed


@pytest.mark.ci
def test_nothing_to_load():
    c = chain(ended(FIG2, 4), contact=0.0)
    state, site = nucleate(c)
    assert site == -1
    assert np.isinf(state.load)
    assert rupture(c, state, trigger=site).status == Outcome.INVALID


@pytest.mark.ci
def test_float32():
    with jax.enable_x64(False):
        c = chain(sp.Slider(height=np.float32(25), stiffness=np.float32(0.03), poisson=np.float32(0.3)), sites=200)
        state, site = nucleate(c)
        found = jax.jit(lambda s, i: rupture(c, s, trigger=i, max_breaks=100))(state, site)
        assert found.after.stress.dtype == jnp.float32
    assert found.breaks == 26
    np.testing.assert_allclose(found.length, PAPER.length, atol=2e-3)
    assert found.drift < 1e-5


def test_a_chain_takes_an_interface():
    """The same thresholds and prestress as the fast recursion; what a chain cannot take is named."""
    sloped = chain(FIG2, sites=5, interface=sp.Interface(prestress=0.1, threshold_slope=0.01))
    np.testing.assert_allclose(sloped.threshold, 1 + 0.01 * np.arange(5), rtol=1e-15)
    np.testing.assert_allclose(sloped.prestress, 0.1)
    given = chain(FIG2, sites=4, interface=sp.Profile(threshold=[1.0, 2.0], prestress=0.3))
    np.testing.assert_array_equal(given.threshold, [1.0, 2.0, 2.0, 2.0])
    with pytest.raises(ValueError, match=r"chain takes one interface, got a batch of shape \(2,\)"):
        chain(FIG2, sites=5, interface=sp.Interface(prestress=[0.1, 0.2]))


@pytest.mark.ci
@pytest.mark.parametrize("double", [pytest.param(True, marks=pytest.mark.slow), False])
def test_the_usual_call_breaks_the_first_contact(double):
    """Without a state it nucleates; of a nucleated state, rounding does not matter. These were found among random chains."""
    with jax.enable_x64(double):
        below = 0
        for height, stiffness, right in itertools.product((5.0, 50.0, 1000.0), (1e-3, 0.03, 1.0), ("semi-infinite", "free")):
            c = chain(ended(sp.Slider(height, stiffness, 0.3), 20, right), sites=20)
            state, site = nucleate(c)
            expected = rupture(c, state, trigger=site)
            below += int(rupture(c, state, trigger=-1).status) == Outcome.NOTHING_BROKE
            assert int(expected.breaks) >= 1
            for found in (rupture(c), rupture(c, state), jax.jit(rupture)(c)):
                np.testing.assert_array_equal(found.order, expected.order)
                assert int(found.status) == int(expected.status)
            if int(expected.status) != Outcome.LIMIT:
                assert int(rupture(c, expected.state).status) == Outcome.NOTHING_BROKE
        assert below, "rounding kept none of them below"
        smooth = rupture(c, rule=SmoothBreak(0.01))
        assert float(smooth.broken[0]) == 1
