"""The inertial chain against a plain leapfrog, its energy balance, and its limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import ended
from oracles import leapfrog
from oracles.dense_chain import responses

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.equilibrium import forces
from slippulse_jax.events.inertia import quasi_static_break_time, stable_step
from slippulse_jax.rules import CrackLike, SelfHealing

FIG2 = sp.Slider(25.0, 0.03, 0.3)


@pytest.mark.parametrize(("damping", "friction"), [(0.0, None), (0.2, None), (0.1, 0.5)])
def test_against_plain_leapfrog(damping, friction):
    slider, sites = (10.0, 0.03, 0.3), 30
    chain = sp.chain(ended(sp.Slider(*slider), sites))
    rule = SelfHealing() if friction is None else CrackLike(friction)
    got = sp.simulate_inertial(chain, duration=60.0, damping=damping, rule=rule)
    x, pin, count, books = leapfrog.run(slider, sites, float(got.step), round(float(got.time / got.step)), damping, friction)
    assert np.array_equal(got.breaks, count)
    assert abs(np.append(got.upper, got.layer) - x).max() < 1e-9
    assert abs(got.state.pinning - pin).max() < 1e-9
    assert abs(np.array([got.broken, got.damped, got.rubbed]) - books).max() < 1e-10


def test_a_stiff_bond_makes_no_block_heavier():
    """Blocks keep the mass of their height; against the plain leapfrog, with one bond of the upper layer five times as stiff."""
    slider, sites, bond = (10.0, 0.03, 0.3), 30, 6
    upper = np.full(sites - 1, 10.0)
    upper[bond] *= 5
    chain = sp.chain(ended(sp.Slider(*slider), sites), upper=upper)
    got = sp.simulate_inertial(chain, duration=60.0)
    steps = round(float(got.time / got.step))
    x, pin, count, _ = leapfrog.run(slider, sites, float(got.step), steps, 0.0, extra={bond: 40.0})
    assert np.array_equal(got.breaks, count)
    assert abs(np.append(got.upper, got.layer) - x).max() < 1e-9
    assert abs(got.state.pinning - pin).max() < 1e-9
    assert got.imbalance < 1e-3


@pytest.mark.ci
def test_the_step_is_stable_on_any_chain():
    """Below 2/ω_max of the dense spectrum, whatever bonds and end; within a fifth of it on the paper's chain."""
    n = 12
    for right in ("free", "clamped", "semi-infinite"):
        for upper, layer in ((25.0, 1.0), (0.1, 0.004), (np.geomspace(0.1, 500, n - 1), np.geomspace(3, 0.01, n - 1))):
            chain = sp.chain(ended(FIG2, n, right), sites=n, upper=upper, layer=layer)
            stiffness = -jax.jacfwd(lambda x, c=chain: jnp.append(*forces(c, np.zeros(n), (x[:n], x[n:]))))(np.zeros(2 * n))
            root = np.sqrt(np.append(np.full(n, 25.0), np.ones(n)))
            fastest = np.sqrt(np.linalg.eigvalsh(np.asarray(stiffness)[1:, 1:] / np.outer(root, root)[1:, 1:])[-1])
            assert stable_step(chain, 1.0) <= 2 / fastest
            if np.shape(upper) == () and upper == 25.0:
                assert stable_step(chain, 1.0) > 0.8 * 2 / fastest


@pytest.mark.ci
def test_single_precision():
    def motion(exact):
        with jax.enable_x64(exact):
            return jax.tree.map(np.asarray, sp.simulate_inertial(sp.chain(FIG2, sites=12), duration=20.0, damping=0.1))

    double, single = motion(True), motion(False)
    assert single.layer.dtype == np.float32
    np.testing.assert_allclose(single.layer, double.layer, atol=1e-4)
    np.testing.assert_array_equal(single.breaks, double.breaks)


@pytest.mark.ci
def test_derivatives_are_refused():
    """The time of a break is a whole number of steps, and its derivative would be that of the step."""

    def first_break(k):
        chain = sp.chain(sp.Slider(10.0, k, 0.3), sites=20)
        return sp.simulate_inertial(chain, chain.relaxed(2.0), trigger=0, duration=20.0).first_break[3]

    chain = sp.chain(FIG2, sites=20)
    for refused in (
        lambda: jax.grad(first_break)(0.03),
        lambda: jax.grad(lambda g: sp.simulate_inertial(chain, duration=5.0, damping=g).damped)(0.1),
    ):
        with pytest.raises(TypeError, match="cannot be differentiated.*precursor_length"):
            refused()


@pytest.mark.ci
def test_energy_balance_to_the_order_of_the_integrator():
    """The largest imbalance at any step falls as the step squared."""
    chain = sp.chain(FIG2, sites=100)
    errors = [float(sp.simulate_inertial(chain, duration=100.0, damping=0.05, safety=s).imbalance) for s in (0.2, 0.1, 0.05)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (abs(orders - 2) < 0.15).all()
    assert errors[0] < 1e-3


@pytest.mark.ci
@pytest.mark.parametrize("steps", [200_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_no_drift_over_many_steps(steps):
    """Undamped, after the breaks are over, the imbalance stays what it was: nothing accumulates."""
    chain = sp.chain(ended(sp.Slider(10.0, 0.03, 0.3), 16), threshold=np.append(1.0, np.full(15, 50.0)))
    short = sp.simulate_inertial(chain, duration=2000.0)
    long = sp.simulate_inertial(chain, duration=float(short.step) * steps)
    assert round(float(long.time / long.step)) >= steps
    assert int(long.breaks.sum()) < 100
    assert long.imbalance < 1.5 * short.imbalance
    # leapfrog keeps an energy that differs from the true one by at most (ω dt)²/8 of it; ω dt ≤ 2 · 0.2
    assert long.imbalance < 0.4**2 / 8 * long.broken


@pytest.mark.ci
def test_work_of_a_moving_edge_is_booked():
    chain = sp.chain(FIG2, sites=60)
    errors = [
        float(sp.simulate_inertial(chain, duration=100.0, velocity=0.01, damping=0.1, safety=s).imbalance) for s in (0.2, 0.1)
    ]
    assert errors[1] < 0.35 * errors[0]


@pytest.mark.ci
def test_slow_breaks_and_damping_are_the_quasi_static_cascade():
    """Breaks far apart in time, as in the paper's hierarchy of times: the same contacts in the same order, to rounding."""
    for height, stiffness, damping in ((10.0, 0.03, 0.5), (6.0, 0.1, 1.0)):
        chain = sp.chain(sp.Slider(height, stiffness, 0.3), sites=30)
        wait = quasi_static_break_time(chain, damping)
        got = sp.simulate_inertial(chain, duration=14 * wait, damping=damping, rule=SelfHealing(wait))
        state, site = sp.nucleate(chain)
        expected = sp.rupture(chain, state, trigger=site)
        assert int(got.status) == Outcome.ARRESTED
        assert np.array_equal(got.breaks, expected.broken.astype(int))
        assert abs(got.state.pinning - expected.state.pinning).max() < 1e-9


@pytest.mark.ci
def test_inertia_lengthens_the_precursor_and_leaves_nucleation_alone():
    """C11: from overdamped to undamped, never shorter; longer than the quasi-static 26 where waves live."""
    chain = sp.chain(FIG2, sites=150)
    extents = [int(sp.simulate_inertial(chain, duration=400.0, damping=g).extent) for g in (0.3, 0.1, 0.03, 0.0)]
    assert (np.diff(extents) >= 0).all()
    assert extents[0] <= 26 < extents[-1]
    nucleated = sp.simulate_inertial(chain, duration=1.0).state.load
    assert abs(nucleated - sp.first_precursor(FIG2).load) < 1e-12


@pytest.mark.ci
def test_breaking_at_exactly_the_threshold_shortens_the_overdamped_front():
    """With instantaneous breaks a contact gives up exactly σ_s, not the overload of the quasi-static picture: fewer than 26."""
    load, pinning = responses(25, 0.03, 0.3, 200, "semi-infinite", 60)
    s = 1
    while load[s] / load[0] + pinning[s, :s].sum() >= 1:  # every contact behind gave up exactly 1
        s += 1
    chain = sp.chain(FIG2, sites=150)
    got = sp.simulate_inertial(chain, duration=4000.0, damping=1.0)
    assert int(got.extent) == s < 26


@pytest.mark.ci
def test_crack_like_fronts_know_the_thresholds_self_healing_ones_do_not():
    chain = sp.chain(FIG2, sites=150)
    crack = [
        int(sp.simulate_inertial(chain, duration=400.0, damping=0.1, rule=CrackLike(f)).extent) for f in (0.3, 0.5, 0.7, 0.9)
    ]
    assert (np.diff(crack) < 0).all(), "a larger kinetic over static friction, a shorter front"
    twice = sp.chain(FIG2, sites=150, threshold=2.0)
    one, two = (sp.simulate_inertial(c, duration=400.0, damping=0.1) for c in (chain, twice))
    assert int(one.extent) == int(two.extent)
    crack_two = sp.simulate_inertial(twice, duration=400.0, damping=0.1, rule=CrackLike(0.5))
    assert int(crack_two.extent) > crack[1], "the same friction under twice the threshold"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"duration": -1.0}, "duration = -1: must be positive"),
        ({"duration": np.inf}, "duration = inf"),
        ({"damping": -0.1}, "damping = -0.1: must be 0 or more"),
        ({"velocity": np.nan}, "velocity = nan"),
        ({"safety": 1.0}, "safety = 1: must lie between 0 and 1"),
        ({"rest": -1.0}, "rest = -1"),
        ({"trigger": 20}, "trigger = 20: must be −1 … 19"),
        ({"rule": SelfHealing(-1.0)}, "SelfHealing.break_time = -1"),
        ({"rule": CrackLike(0.8)}, "CrackLike.friction = 0.8: must be 0 or more and below every threshold"),
        ({"rule": CrackLike(-0.1)}, "CrackLike.friction = -0.1"),
    ],
)
def test_refusals_name_the_number(wrong, message):
    chain = sp.chain(FIG2, sites=20, threshold=np.append(1.0, np.full(19, 0.8)))
    with pytest.raises(ValueError, match=message):
        sp.simulate_inertial(chain, **({"duration": 1.0} | wrong))


@pytest.mark.ci
def test_bad_lanes():
    """What cannot be looked at makes its own lane invalid, and no other."""
    chain = sp.chain(FIG2, sites=20)
    with pytest.raises(TypeError, match="rule"):
        sp.simulate_inertial(chain, duration=1.0, rule="slip")  # pyright: ignore

    def status(duration, damping, friction):
        return sp.simulate_inertial(chain, duration=duration, damping=damping, rule=CrackLike(friction)).status

    good = (5.0, 0.1, 0.5)
    wrong = [(5.0, np.nan, 0.5), (5.0, -0.1, 0.5), (-1.0, 0.1, 0.5), (1e12, 0.1, 0.5), (5.0, 0.1, 1.0), (5.0, 0.1, -0.1)]
    found = jax.vmap(status)(*np.transpose([good, *wrong]))
    assert list(found) == [Outcome.TIME_OVER] + [Outcome.INVALID] * len(wrong)
