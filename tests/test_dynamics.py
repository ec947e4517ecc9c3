"""The inertial chain against a plain leapfrog, its energy balance, and its limits."""

import jax
import numpy as np
import plain_dynamics
import pytest

import slippulse_jax as sp
from slippulse_jax.lattice.dynamics import CrackLike, MotionStatus, SelfHealing, quasi_static_break_time

FIG2 = sp.Slider(25.0, 0.03, 0.3)


@pytest.mark.parametrize(("damping", "friction"), [(0.0, None), (0.2, None), (0.1, 0.5)])
def test_against_plain_leapfrog(damping, friction):
    slider, sites = (10.0, 0.03, 0.3), 30
    chain = sp.chain(sp.Slider(*slider), sites=sites, right="free")
    rule = SelfHealing() if friction is None else CrackLike(friction)
    got = sp.simulate_inertial(chain, duration=60.0, damping=damping, rule=rule)
    x, pin, count, books = plain_dynamics.run(
        slider, sites, float(got.step), round(float(got.time / got.step)), damping, friction
    )
    assert np.array_equal(got.breaks, count)
    assert abs(np.append(got.upper, got.layer) - x).max() < 1e-9
    assert abs(got.state.pinning - pin).max() < 1e-9
    assert abs(np.array([got.broken, got.damped, got.rubbed]) - books).max() < 1e-10


def test_energy_balance_to_the_order_of_the_integrator():
    """The largest imbalance at any step falls as the step squared."""
    chain = sp.chain(FIG2, sites=100)
    errors = [float(sp.simulate_inertial(chain, duration=100.0, damping=0.05, safety=s).imbalance) for s in (0.2, 0.1, 0.05)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (abs(orders - 2) < 0.15).all()
    assert errors[0] < 1e-3


def test_no_drift_over_a_million_steps():
    """Undamped, after the breaks are over, the imbalance stays what it was: nothing accumulates."""
    chain = sp.chain(sp.Slider(10.0, 0.03, 0.3), sites=16, right="free", threshold=np.append(1.0, np.full(15, 50.0)))
    short = sp.simulate_inertial(chain, duration=2000.0)
    long = sp.simulate_inertial(chain, duration=float(short.step) * 1_000_000)
    assert round(float(long.time / long.step)) >= 1_000_000
    assert int(long.breaks.sum()) < 100
    assert long.imbalance < 1.5 * short.imbalance
    # leapfrog keeps an energy that differs from the true one by at most (ω dt)²/8 of it; ω dt ≤ 2 · 0.2
    assert long.imbalance < 0.4**2 / 8 * long.broken


def test_work_of_a_moving_edge_is_booked():
    chain = sp.chain(FIG2, sites=60)
    errors = [
        float(sp.simulate_inertial(chain, duration=100.0, velocity=0.01, damping=0.1, safety=s).imbalance) for s in (0.2, 0.1)
    ]
    assert errors[1] < 0.35 * errors[0]


def test_slow_breaks_and_damping_are_the_quasi_static_cascade():
    """Breaks far apart in time, as in the paper's hierarchy of times: the same contacts in the same order, to rounding."""
    for height, stiffness, damping in ((10.0, 0.03, 0.5), (6.0, 0.1, 1.0)):
        chain = sp.chain(sp.Slider(height, stiffness, 0.3), sites=30)
        wait = quasi_static_break_time(chain, damping)
        got = sp.simulate_inertial(chain, duration=14 * wait, damping=damping, rule=SelfHealing(wait))
        state, site = sp.nucleate(chain, sp.relaxed(chain))
        expected = sp.rupture(chain, state, trigger=site)
        assert int(got.status) == MotionStatus.AT_REST
        assert np.array_equal(got.breaks, expected.broken.astype(int))
        assert abs(got.state.pinning - expected.state.pinning).max() < 1e-9


def test_inertia_lengthens_the_precursor_and_leaves_nucleation_alone():
    """C11: from overdamped to undamped, never shorter; longer than the quasi-static 26 where waves live."""
    chain = sp.chain(FIG2, sites=150)
    extents = [int(sp.simulate_inertial(chain, duration=400.0, damping=g).extent) for g in (0.3, 0.1, 0.03, 0.0)]
    assert (np.diff(extents) >= 0).all()
    assert extents[0] <= 26 < extents[-1]
    nucleated = sp.simulate_inertial(chain, duration=1.0).state.load
    assert abs(nucleated - sp.first_precursor(FIG2).load) < 1e-12


def test_breaking_at_exactly_the_threshold_shortens_the_overdamped_front():
    """With instantaneous breaks a contact gives up exactly σ_s, not the overload of the quasi-static picture: fewer than 26."""
    from plain_chain import responses

    load, pinning = responses(25, 0.03, 0.3, 200, "semi-infinite", 60)
    s = 1
    while load[s] / load[0] + pinning[s, :s].sum() >= 1:  # every contact behind gave up exactly 1
        s += 1
    chain = sp.chain(FIG2, sites=150)
    got = sp.simulate_inertial(chain, duration=4000.0, damping=1.0)
    assert int(got.extent) == s < 26


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


def test_refusals_and_bad_lanes():
    chain = sp.chain(FIG2, sites=20)
    with pytest.raises(TypeError, match="rule"):
        sp.simulate_inertial(chain, duration=1.0, rule="slip")  # pyright: ignore
    with pytest.raises(ValueError, match="duration"):
        sp.simulate_inertial(chain, duration=-1.0)
    status = jax.vmap(lambda g: sp.simulate_inertial(chain, duration=5.0, damping=g).status)(np.array([0.1, np.nan]))
    assert list(status) == [MotionStatus.TIME_OVER, MotionStatus.INVALID]
