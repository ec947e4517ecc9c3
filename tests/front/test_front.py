"""The recursion against programs that solve the chain as a matrix, in float64 and in many more digits."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from chains import ended
from oracles import dense_chain
from oracles.lattice_mp import Chain
from problems import PAPER, REFERENCE

from slippulse_jax import Slider, SmoothBreak, first_precursor, precursor, precursor_length, precursor_lengths
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.modes import FARTHEST, lattice_modes
from slippulse_jax.exact.front import exact_front_stress, exact_length
from slippulse_jax.front import lanes
from slippulse_jax.front.arrest import FrontNotArrested, arrest
from slippulse_jax.front.front import (
    REACHED,
    Front,
    advance,
    echo_at,
    end_of_front,
    front_stress,
    nucleate,
    slowest_approach,
    stress_ahead,
)
from slippulse_jax.lengths import arrests


@pytest.mark.parametrize("known", REFERENCE)
def test_reference_values(known):
    front = first_precursor(Slider(*known.slider))
    assert int(front.contacts_broken) == known.contacts
    assert abs(front.length - known.length) < 1e-11 * known.length
    assert abs(front.load - known.load) < 1e-11 * known.load
    assert int(front.status) == Outcome[known.status]


def random_sliders(count, seed):
    rng = np.random.default_rng(seed)
    return Slider(rng.uniform(3, 60, count), 10 ** rng.uniform(-4, 0, count), rng.uniform(0, 0.49, count))


@pytest.mark.parametrize(
    ("right", "number"),
    [("semi-infinite", 300), *(pytest.param(*x, marks=pytest.mark.ci) for x in (("free", 6), ("clamped", 6)))]
    + [pytest.param(*x, marks=pytest.mark.slow) for x in (("free", 60), ("clamped", 60))],
)
def test_against_dense_chain(right, number):
    """Random sliders on chains of 400 sites and on the endless one: same count, length, edge stress and status."""
    sliders = random_sliders(number, seed=number)
    sites = 140 if right == "semi-infinite" else 400  # what lies beyond the matrix of an endless chain is eliminated exactly
    got = arrests(ended(sliders, sites, right))
    for i, slider in enumerate(zip(sliders.height, sliders.stiffness, sliders.poisson, strict=True)):
        count, length, _, behind = dense_chain.first_precursor(*slider, sites, right)
        assert got.contacts_broken[i] == count, slider
        assert abs(got.length[i] - length) <= 1e-9, slider
        assert behind[1] == 0, "the contact at the edge is the most stressed one behind the front"
        if count > 1:
            assert abs(got.edge_stress[i] - behind[0]) <= 1e-9
        expected = Outcome.NO_DOMINO if count == 1 else Outcome.REBREAK if behind[0] >= 1 else Outcome.ARRESTED
        assert got.status[i] == expected


@pytest.mark.ci
@pytest.mark.parametrize(("right", "count", "length"), [("free", 28, 27.614), ("clamped", 25, 24.277)])
def test_right_end_changes_the_answer(right, count, length):
    front = first_precursor(ended(Slider(25, 0.03, 0.3), 100, right))
    assert int(front.contacts_broken) == count
    assert round(float(front.length), 3) == length
    assert abs(float(front.length) - dense_chain.first_precursor(25.0, 0.03, 0.3, 100, right)[1]) < 1e-10


def test_length_of_the_chain_order_of_breaks_and_stress_behind_by_dense_solves():
    """What was worked out before any code, at Fig. 2's parameters and beside them, by the matrix program alone."""
    slider = 25.0, 0.03, 0.3
    assert [dense_chain.first_precursor(*slider, 200, right)[0] for right in ("free", "clamped")] == [26, 26]
    behind = [dense_chain.first_precursor(height, 0.03, 0.3)[3][0] for height in (25.0, 50.0)]
    np.testing.assert_allclose(behind, [0.774, 0.987], atol=5e-4)  # in the second it all but breaks again
    load, pinning = dense_chain.responses(*slider, sites=400, right="semi-infinite", reach=60)
    for choose, count in ((np.min, 26), (np.max, 25)):  # of those at threshold: nearest to the edge, farthest from it
        pinned, ready, broken = np.zeros(60), np.array([0]), []
        while len(ready):
            i = choose(ready)
            broken.append(i)
            pinned[i] = load[i] / load[0] + pinning[i] @ pinned
            ready = np.flatnonzero(load / load[0] + pinning @ pinned - pinned >= 1)
        assert len(broken) == len(set(broken)) == count


@pytest.mark.ci
def test_long_chains_agree_with_the_endless_one():
    endless = precursor_length(Slider(25, 0.03, 0.3))
    for right in ("free", "clamped"):
        assert abs(precursor_length(ended(Slider(25, 0.03, 0.3), 3000, right)) - endless) < 1e-12


@pytest.mark.ci
def test_front_that_reaches_the_end_has_no_length():
    slider = Slider(50, 0.03, 0.3)
    front = first_precursor(ended(slider, 100))
    assert int(front.status) == Outcome.RAN_THROUGH
    assert int(front.contacts_broken) == 100
    assert np.isinf(front.length)
    gradient = jax.grad(lambda k: precursor_length(ended(Slider(50.0, k, 0.3), 100)))(0.03)
    assert not np.isfinite(gradient), "a length that is none has no derivative, and not a silent zero either"


def test_no_domino():
    """A short, soft slider: the neighbour of the edge contact stays below threshold."""
    front = first_precursor(Slider(3.0, 1e-4, 0.3))
    count, length, _, _ = dense_chain.first_precursor(3.0, 1e-4, 0.3)
    assert (int(front.contacts_broken), float(front.length)) == (count, length) == (1, 0.0)
    assert int(front.status) == Outcome.NO_DOMINO


@pytest.mark.ci
def test_cap_on_breaks_reports_itself():
    slider = Slider(25, 0.03, 0.3)
    assert float(arrest(slider, most=26).length) == float(precursor_length(slider))
    assert int(arrest(slider, most=25).status) == Outcome.LIMIT
    with pytest.raises(FrontNotArrested, match="given up.*: 10000000"):
        precursor_length(Slider(1e8, 1e-6, 0.3))


@pytest.mark.slow
def test_every_door_gives_a_front_up():
    tall = Slider(1e8, 1e-6, 0.3)
    with pytest.raises(FrontNotArrested, match="given up.*: 10000000"):
        first_precursor(tall)
    with pytest.raises(FrontNotArrested, match="given up.*: 10000000"):
        precursor_length(tall, rule=SmoothBreak(0.01))
    with pytest.raises(FrontNotArrested, match="given up.*: 10000000"):
        first_precursor(tall, sites=100)
    assert int(jax.jit(lambda h: first_precursor(Slider(h, 1e-6, 0.3), sites=100).status)(1e8)) == Outcome.LIMIT
    assert np.isnan(jax.jit(lambda h: precursor_length(Slider(h, 1e-6, 0.3)))(1e8))
    with pytest.warns(RuntimeWarning, match=r"1 of 2 fronts, the first at index \(1,\).*given up.*: 10000000"):
        lengths = precursor_lengths(Slider([10.0, 1e8], [0.03, 1e-6], 0.3))
    assert np.isfinite(lengths[0])
    assert np.isnan(lengths[1])


def test_traced_slider_outside_its_domain_is_nan_not_a_number():
    lengths = jax.vmap(lambda h, k, nu: precursor_length(Slider(h, k, nu)))(
        np.array([25.0, 0.5, 25.0, 25.0, np.nan]), np.array([0.03, 0.03, -0.1, 0.03, 0.03]), np.array([0.3, 0.3, 0.3, 0.7, 0.3])
    )
    assert np.isfinite(lengths[0])
    assert np.isnan(lengths[1:]).all()


def digits_of_tall_slider(t):
    """ℓ and dℓ/dq of H/λc = 75 000, b = 1, in 60 digits; `t` gives the six stresses up to the arrest from a `Chain`."""
    with mpmath.workdps(60):
        step = TALL[1] * mpmath.mpf("1e-20")
        rows = mpmath.matrix([[mpmath.mpf(i) ** j for j in range(6)] for i in range(-5, 1)])

        def length(stiffness):
            over = mpmath.matrix([stress - 1 for stress in t(Chain(TALL[0], stiffness, TALL[2]))])
            powers = mpmath.lu_solve(rows, over)
            return 54195 + mpmath.findroot(lambda x: sum(c * x**j for j, c in enumerate(powers)), (-1, 0), solver="illinois")

        low, high = length(TALL[1] - step), length(TALL[1] + step)
        return (low + high) / 2, (high - low) / (2 * step)


TALL = 75_000.0, 1 / (2.6 * 75_000), 0.3


def by_series(chain):
    t = chain.series(44)
    return [t(s) for s in range(54190, 54196)]


@pytest.mark.ci
def test_tall_slider_in_extended_precision():
    """H/λc = 75 000, b = 1: value and gradient in k/K to eleven digits."""
    ended = arrest(Slider(*TALL), most=10**6)
    assert int(ended.contacts_broken) == 54195
    value, slope = jax.value_and_grad(lambda k: precursor_length(Slider(TALL[0], k, TALL[2])))(TALL[1])
    expected, expected_slope = digits_of_tall_slider(by_series)
    assert abs(float(value) - float(expected)) < 1e-6
    assert abs(float(slope) / float(expected_slope) - 1) < 1e-8


@pytest.mark.slow
def test_that_reference_break_by_break():
    both = digits_of_tall_slider(by_series), digits_of_tall_slider(lambda chain: chain.recursion(54196)[-6:])
    for one, other in zip(*both, strict=True):
        assert abs(one / other - 1) < 1e-15


@pytest.mark.ci
def test_float32(float32):
    """Single precision keeps its dtype and its stated error, and says once where that error is large."""
    sliders = random_sliders(64, seed=5)
    exact = arrests(sliders).length
    single = precursor_length(sliders)
    assert single.dtype == np.float32
    assert np.abs(np.asarray(single, np.float64) - exact).max() < 0.01
    with pytest.warns(RuntimeWarning, match="single precision"):
        tall = precursor_length(Slider(1e5, 1 / 2.6e5, 0.3))
    precursor._warn_once.cache_clear()
    with pytest.warns(RuntimeWarning, match="single precision"):
        jax.grad(lambda height: precursor_length(Slider(height, 0.03, 0.3)))(2000.0)
    exact = arrests(Slider(1e5, 1 / 2.6e5, 0.3)).length
    assert abs(float(tall) / float(exact) - 1) < 1e-3


@pytest.mark.ci
def test_a_million_breaks_leave_the_digits():
    """Of multiplying by r as it is rounded, instead of taking 1 − r away, 5e-11 would be left of the stress and 1e-4 of ℓ."""
    slider = Slider(1e6, 1e-6, 0.3)
    length = float(precursor_length(slider))
    assert length == pytest.approx(923071.94796, abs=1e-5)
    assert length == pytest.approx(float(exact_length(slider)), abs=1e-6)
    sites = np.linspace(1, int(length), 50).astype(int)
    stress = np.asarray(front_stress(lattice_modes(slider), int(length) + 1))[sites]
    np.testing.assert_allclose(
        stress, jax.vmap(lambda s: exact_front_stress(slider, s))(sites.astype(float)), rtol=0, atol=1e-12
    )


@pytest.mark.ci
def test_float32_on_soft_interfaces(float32):
    """The stress exceeds its threshold by as little as b: 0 was returned for the first, 4.08 λc long."""
    rng = np.random.default_rng(70)
    numbers = rng.uniform([1.0, -10.0, -0.9], [3.0, -4.0, 0.5], (62, 3)).T
    numbers[:2] = 10 ** numbers[:2]
    single = np.concatenate([[[931.9, 1000.0], [2.135e-9, 3e-7], [0.037, 0.3]], numbers], axis=1).astype(np.float32)
    double = Slider(*single.astype(float))
    for ends in {}, {"right": "free", "sites": 3000}, {"right": "clamped", "sites": 3000}:
        expected = precursor_lengths(ended(double, **ends))
        assert (np.isfinite(expected) & (expected > 1)).sum() > 10
        found = np.float64(precursor_length(ended(Slider(*single), **ends)))
        np.testing.assert_allclose(found, expected, rtol=0.01 if ends else 0, atol=0.01)
    assert 4 < float(precursor_length(Slider(*single[:, 0]))) < 4.1


class Guide(NamedTuple):
    gap: Any
    weight: Any


@pytest.mark.ci
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_step_against_the_sum_over_all_earlier_breaks(dtype):
    """Of modes and reflections drawn at random, which are those of no slider; three modes as well as two."""
    rng, count = np.random.default_rng(3), 40
    for r, w, drive in [([0.9, 0.5], [0.05, 0.1], [0.6, 0.4]), ([0.9, 0.5, -0.3], [0.05, 0.1, 0.03], [0.6, 0.1, 0.3])]:
        r, w, drive, n = np.array(r), np.array(w), np.array(drive), len(r)
        reflection = rng.uniform(-0.05, 0.05, (n, n))
        reflection = reflection + reflection.T
        prestress, t = rng.uniform(-0.2, 0.2, count), np.zeros(count)
        for s in range(count):
            j = np.arange(s)
            response = (w * r ** (s - j)[:, None]).sum(1) + (r**s) @ reflection @ (r[:, None] ** j)
            t[s] = prestress[s] + (drive * r**s).sum() + response @ t[:s]

        with jax.enable_x64(dtype == np.float64):
            guide = Guide(jnp.asarray(1 - r, dtype), jnp.asarray(w, dtype))
            front = Front(jnp.asarray(drive, dtype), jnp.asarray(reflection, dtype), None, 0)
            for s in range(count):
                ahead = dtype(prestress[s]) + stress_ahead(front)
                assert ahead.dtype == dtype
                np.testing.assert_allclose(ahead, t[s : s + 1], rtol=0, atol=1e3 * np.finfo(dtype).eps)
                front = advance(guide, front, ahead)


@pytest.mark.parametrize("slider", [(25, 0.03, 0.3), (5, 0.02, 0.3), (2.0, 0.2, 0.3)])
def test_length_ends_on_the_polynomial_through_the_recorded_stresses(slider):
    """Of the last six contacts, or of all where fewer were reached; as NumPy has it."""
    record = first_precursor(Slider(*slider))
    s0 = int(record.contacts_broken)
    over = np.asarray(record.front_stress)[: s0 + 1][-REACHED:] - 1
    zeros = np.roots(np.polyfit(np.arange(1 - len(over), 1), over, len(over) - 1))
    (end,) = zeros.real[(zeros.imag == 0) & (zeros.real >= -1) & (zeros.real <= 0)]
    assert abs(s0 + end - float(record.length)) < 1e-10


def test_curves_of_every_degree_and_their_ends():
    """The zero of a polynomial of that degree is met, one at either end of the last step too."""
    x = -np.arange(REACHED)  # of the contacts, the nearest first
    for degree in range(1, REACHED):
        for zero in (-1.0, -0.5, -1e-3, -1e-300):
            over = (zero - x) * (1 + 0.1 * x) ** (degree - 1)
            assert abs(end_of_front(7, list(map(jnp.asarray, over)), degree) - (7 + zero)) < 1e-13
    line = end_of_front(2, [jnp.asarray(-1.0), jnp.asarray(3.0)])
    assert abs(line - 1.75) < 1e-15
    # before contact 0 there is none, whatever stands there
    few = [end_of_front(2, list(map(jnp.asarray, [-1.0, 3.0, 0.0, *rest]))) for rest in ([0.0, 0.0, 0.0], [5.0, -9.0, 1e3])]
    assert few[0] == few[1]


@pytest.mark.parametrize("end", [{}, {"length": 12.0}, {"length": 12.5, "right": "clamped", "machine": 0.3}])
def test_the_step_of_a_lane_is_that_of_any_front_and_can_be_undone(end):
    """It is written twice, in arrays of modes and in single numbers; the latter is run back from the end."""
    modes, contacts = lattice_modes(Slider(*PAPER.slider, **end)), (0.2, 0.01)
    more = (end["length"], end.get("machine", FARTHEST)) if end else ()
    given = (jnp.asarray(x, float) for x in (np.inf, *PAPER.slider, *contacts, *more))
    lane, state = lanes._begun((*given,), end.get("right", "free"), with_edge=True)
    front = advance(modes, nucleate(modes, 1 - contacts[0]), jnp.ones(()), echo_at(modes, jnp.int32(0)))
    states, stresses = [], []
    for _ in range(8):
        (q11, q12, q22), (*reach, edge) = state.reflected, state.edge
        for one, other in zip(front, (state.stress, [[q11, q12], [q12, q22]], reach, state.position, [edge]), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-15)
        echo, (stress, excess) = echo_at(modes, front.position), lanes._stress_and_excess(lane, state)
        np.testing.assert_allclose(stress, contacts[0] + stress_ahead(front, echo)[0], rtol=1e-13)
        np.testing.assert_allclose(stress - excess, 1 + contacts[1] * front.position, rtol=1e-13)
        states.append(state)
        stresses.append(stress)
        state, front = lanes.advance(lane, state, stress), advance(modes, front, stress, echo)
    while states:
        state, released = lanes.taken_back(lane, state)
        assert abs(released - stresses.pop()) < 1e-14
        for one, other in zip(state[:3], states.pop()[:3], strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("slider", "sites"), [(PAPER.slider, 1500), ((2.0, 2.0, 0.1), 60)])
def test_rate_at_which_the_front_stress_settles(slider, sites):
    """Far from the edge the front stress of relaxed contacts falls by the same factor from contact to contact."""
    modes = lattice_modes(Slider(*slider))
    stress = front_stress(modes, sites)
    assert 1 - slowest_approach(modes) == pytest.approx(float(stress[-1] / stress[-2]), rel=1e-12)
