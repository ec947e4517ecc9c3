"""Exact lengths in bulk against the exact solution one by one, and against the recursion."""

import jax
import numpy as np
import pytest
from strategies import random_sliders

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.exact import bulk as exact_lanes
from slippulse_jax.exact.bulk import exact_arrests
from slippulse_jax.exact.front import exact_front, exact_length
from slippulse_jax.lengths import arrests as arrests_of


def random_lanes(count, seed):
    """Sliders of the whole domain; a third under prestress, a third on rising thresholds, some beyond run-away."""
    rng = np.random.default_rng(seed)
    H, q, nu = random_sliders(count, seed).T
    phi = rng.choice([0, 0, 1], count) * rng.uniform(-0.5, 0.7, count)
    slope = rng.choice([0, 0, 1], count) * 10 ** rng.uniform(-6, -2, count)
    return np.array([H, q, nu, phi, slope])


def bulk(lanes, **options):
    return sp.exact_lengths(sp.Slider(*lanes[:3]), sp.Interface(*lanes[3:]) if len(lanes) > 3 else None, **options)


def gradient_of(found):
    """dℓ* along (H/λc, k/K, ν, φ, ε), the last axis."""
    return np.stack(jax.tree.leaves((found.slider, found.interface)), -1)


def arrests(found):
    return np.isfinite(found.length) & (found.length > 0)


@pytest.mark.ci
@pytest.mark.slow  # by its compilation
def test_against_the_solution_one_by_one():
    lanes = random_lanes(150, 61)
    found = bulk(lanes, derivatives=1)

    def one(x):
        return exact_length(sp.Slider(x[0], x[1], x[2]), sp.Interface(x[3], x[4]))

    value, gradient = jax.jit(lambda x: jax.lax.map(lambda y: (one(y), jax.jacfwd(one)(y)), x))(lanes.T)
    arrested = arrests(found)
    assert arrested.sum() > 100
    np.testing.assert_allclose(found.length, value, rtol=1e-11)
    scale = np.maximum(np.abs(lanes.T), 1e-2) / np.where(arrested, found.length, 1)[:, None]
    np.testing.assert_allclose((gradient_of(found) * scale)[arrested], (gradient * scale)[arrested], rtol=1e-8, atol=1e-9)
    assert np.all(gradient_of(found)[found.length == 0] == 0)


@pytest.mark.ci
@pytest.mark.slow
def test_twenty_thousand_lanes_against_the_solution_one_by_one():
    lanes = random_lanes(20_000, 67)

    def front(x):
        return exact_front(sp.Slider(x[0], x[1], x[2]), sp.Interface(x[3], x[4]))

    one_by_one = jax.jit(lambda x: jax.lax.map(jax.vmap(front), x))(lanes.T.reshape(20, 1000, 5))
    (found, outcome), expected = exact_arrests(lanes), one_by_one.length.ravel()
    np.testing.assert_array_equal(outcome, np.asarray(one_by_one.status).ravel())
    finite = np.isfinite(expected)
    np.testing.assert_array_equal(found[~finite], expected[~finite])
    long = finite & (expected > 0.01)  # where the domino starts a length is as small, and as ill-conditioned, as one likes
    worst = np.max(np.abs(found / np.where(long, expected, 1) - 1)[long])
    print(f"worst relative difference {worst:.1e} of {long.sum()} lengths")
    assert worst < 1e-11
    np.testing.assert_allclose(found[finite & ~long], expected[finite & ~long], atol=1e-11)


@pytest.mark.ci
def test_lanes_of_three_numbers_and_of_five_agree():
    """Sliders of every height, those included whose front stops near the edge, or never starts."""
    rng, n = np.random.default_rng(68), 1500
    height, nu, b = 10 ** rng.uniform(0.3, 5.3, n), rng.uniform(-0.9, 0.5, n), 10 ** rng.uniform(-2, 3, n)
    lanes = np.stack([height, np.minimum(b / (2 * (1 + nu) * height), 1), nu, 0 * nu, 0 * nu])
    (few, few_status), (all_of_them, status) = exact_lanes.exact_fronts(lanes[:3]), exact_lanes.exact_fronts(lanes)
    assert set(status) <= {Outcome.ARRESTED, Outcome.NO_DOMINO}
    np.testing.assert_array_equal(few_status, status)
    np.testing.assert_allclose(few, all_of_them, rtol=1e-11)


def test_fronts_all_but_level_beside_the_threshold_are_found():
    """Next to run-away a soft front crosses so flatly that rounding of t moves the crossing, and the steps never get small."""
    height = [51.955197273506506, 36.38510809314106, 31.7249989366804, 44.78519018877841]
    stiffness = [2.737858085746002e-07, 2.0499727354926148e-07, 7.938515354735507e-07, 1.3929989226398567e-07]
    found = sp.exact_lengths(sp.Slider(np.array(height), np.array(stiffness), 0.3), sp.Interface(0.5))
    # the series at 60 digits
    expected = [0.899831747494954, 0.0102213419252539, 0.55588669863918, 0.130069399533327]
    np.testing.assert_allclose(found, expected, atol=1e-3)


def near_runaway(count, seed):
    """Sliders at, below and beyond the prestress from which fronts may never stop, on level, rising and falling thresholds."""
    rng = np.random.default_rng(seed)
    slider = 1 + 10 ** rng.uniform(-1.5, 3, count), 10 ** rng.uniform(-6, 0, count), rng.uniform(-0.9, 0.5, count)
    weight = jax.jit(jax.vmap(lambda *x: lattice_modes(sp.Slider(*x)).weight.sum()))(*slider)
    critical, u = (1 + np.asarray(weight)) / 2, rng.uniform(0, 1, count)
    beside = critical * (1 + rng.choice([-1, 1], count) * 10 ** rng.uniform(-7, -1, count))
    phi = np.choose(rng.integers(0, 3, count), [beside, critical + (1 - critical) * u, 1 - 10 ** rng.uniform(-4, -0.3, count)])
    slope = rng.choice([-1, 0, 1], count) * 10 ** rng.uniform(-8, -2.5, count)
    return np.array([*slider, np.minimum(phi, 1 - 1e-9), slope])


@pytest.mark.ci
@pytest.mark.parametrize("count", [500, pytest.param(150_000, marks=pytest.mark.slow)])
def test_beside_the_runaway_prestress_whole_contacts_are_those_of_the_recursion(count):
    """Wrong numbers called arrested were found here, 43 of 96 679; a front the recursion gives up has no whole count to compare."""
    lanes = near_runaway(count, 81)
    length, status = exact_lanes.exact_fronts(lanes)
    found = arrests_of(sp.Slider(*lanes[:3]), sp.Interface(*lanes[3:]), most=100_000)
    stopped = np.isfinite(found.length)
    followed = found.status != Outcome.LIMIT
    assert followed.mean() > 0.8
    np.testing.assert_array_equal(np.isfinite(length)[followed], stopped[followed])
    np.testing.assert_array_equal(np.maximum(np.ceil(length[stopped]), 1), found.contacts_broken[stopped])
    np.testing.assert_array_equal(status[followed & ~stopped], Outcome.RUN_AWAY)


@pytest.mark.ci
def test_gradient_against_differences():
    lanes = random_lanes(24, 64)
    lanes[2], lanes[4] = 0.05 + 0.8 * lanes[2], 0
    # differences want digits: not the softest of them, nor those next to run-away
    lanes = lanes[:, (lanes[0] * lanes[1] > 1e-2) & (lanes[3] < 0.4)]
    found = bulk(lanes, derivatives=1)
    np.testing.assert_allclose(found.length, bulk(lanes), rtol=1e-12)
    step = 1e-4 * np.maximum(np.abs(lanes), [[0], [0], [0], [1e-2], [1e-2]])
    moved = [lanes + k * step[i] * np.eye(5)[i][:, None] for i in range(5) for k in (-2, -1, 1, 2)]
    # all in the one program of prestressed lanes, thresholds level or rising
    length = bulk(np.concatenate(moved, axis=1)).reshape(5, 4, -1)
    expected = (length[:, 0] - 8 * length[:, 1] + 8 * length[:, 2] - length[:, 3]) / (12 * step)
    arrested = arrests(found)
    assert arrested.sum() > 10
    scale = step / np.where(arrested, found.length, 1)
    size = np.abs(expected * scale).max(0)
    error = np.abs(gradient_of(found).T - expected) * scale / size
    assert np.max(error[:4, arrested]) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("numbers", [3, 5])  # which takes a minute to compile
def test_second_derivatives_against_differences_of_the_gradient(numbers):
    """In the numbers of the slider alone, or in those of the interface too."""
    lanes = random_lanes(24, 65)[:numbers]
    lanes[2] = 0.05 + 0.8 * lanes[2]
    chosen = lanes[0] * lanes[1] > 1e-2
    if numbers == 5:
        lanes[4] = np.abs(lanes[4]) * (lanes[3] == 0)
        chosen &= lanes[3] < 0.4
    lanes = lanes[:, chosen]

    def one(x):
        return exact_length(sp.Slider(x[0], x[1], x[2]), sp.Interface(x[3], x[4]) if numbers == 5 else None)

    length, hessian = jax.jit(lambda x: jax.lax.map(lambda y: (one(y), jax.hessian(one)(y)), x))(lanes.T)
    arrested = np.isfinite(length) & (length > 0)
    assert arrested.sum() > 10
    unit = np.maximum(np.abs(lanes), np.array([[0], [0], [0], [1e-2], [1e-9]])[:numbers])
    moved = [lanes + k * 1e-4 * unit[i] * np.eye(numbers)[i][:, None] for i in range(numbers) for k in (-2, -1, 1, 2)]
    moved = [np.concatenate([x[:4], np.maximum(x[4:], 0)]) for x in moved]
    around = gradient_of(bulk(np.concatenate(moved, axis=1), derivatives=1)).reshape(numbers, 4, -1, numbers)
    expected = (around[:, 0] - 8 * around[:, 1] + 8 * around[:, 2] - around[:, 3]) / (12e-4 * unit[..., None])
    scale = unit.T[:, :, None] * unit.T[:, None] / np.where(arrested, length, 1)[:, None, None]
    error, size = (hessian - expected.swapaxes(0, 1)) * scale, np.abs(hessian * scale).max((1, 2))
    # where the threshold is level its slope cannot be moved both ways
    rows = np.where(lanes[4] > 0, 5, 4) if numbers == 5 else np.full(len(arrested), 3)
    for one_error, most, last, ok in zip(error, size, rows, arrested, strict=True):
        assert not ok or np.max(np.abs(one_error[:last])) < 1e-6 * most
    symmetric = (hessian - hessian.swapaxes(1, 2)) * scale
    assert np.max(np.abs(symmetric[arrested]) / size[arrested, None, None]) < 1e-10


@pytest.mark.ci
def test_shapes_and_refusals():
    found = sp.exact_lengths(sp.Slider(np.array([[10.0], [25.0]]), np.array([0.003, 0.01, 0.03]), 0.3), derivatives=1)
    assert found.length.shape == (2, 3)
    assert found.slider.stiffness.shape == (2, 3)
    assert found.interface is None
    np.testing.assert_allclose(found.length[1, 2], 25.788815261, atol=5e-10)
    single = sp.exact_lengths(sp.Slider(25.0, 0.03, 0.3), derivatives=1)
    assert (single.length.shape, single.slider.height.shape) == ((), ())
    with pytest.raises(ValueError, match="derivatives = 2: must be 0 or 1"):
        sp.exact_lengths(sp.Slider(25.0, 0.03, 0.3), derivatives=2)
    with pytest.raises(ValueError, match=r"prestress = 1\.5"):
        sp.exact_lengths(sp.Slider(25.0, 0.03, 0.3), sp.Interface(1.5))
    with pytest.raises(TypeError, match="exact_length"):
        jax.jit(lambda h: sp.exact_lengths(sp.Slider(h, 0.03, 0.3)))(25.0)
