"""Lengths in bulk: three kernels, each against the one-front functions."""

import os
import subprocess
import sys

import jax
import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax import lengths as bulk
from slippulse_jax.base.status import FRONT_OUTCOMES, Outcome
from slippulse_jax.bulk import chunks as batch
from slippulse_jax.exact import bulk as exact_lanes
from slippulse_jax.front import lanes

MOST = 10_000_000


def random_lanes(n, seed, tall=3.3):
    rng = np.random.default_rng(seed)
    return np.stack([1 + 10 ** rng.uniform(-1, tall, n), 10 ** rng.uniform(-5, 0, n), rng.uniform(-0.9, 0.5, n)])


def by_recursion(lanes_):
    return batch.over_lanes(lanes.length_kernel(MOST), lanes_, bulk.LENGTHS, bulk.length_rank)[0]


def kind(numbers):
    """What puts so many numbers of a lane together to slider, interface and rule."""
    return jax.tree.structure((sp.Slider(25.0, 0.03, 0.3), sp.Interface() if numbers == 5 else None, None))


@pytest.fixture(scope="module")
def general():
    """Length and derivatives in five numbers a lane by the general recursion; compiled once."""
    kernel = bulk.general_kernel(kind(5), 5000, 1)
    return lambda five: batch.over_lanes(kernel, five, bulk.ANY)[0]


@pytest.mark.ci
def test_interfaces_equal_the_general_recursion(general):
    """Prestress and slopes of either sign: length, where there is none, and all derivatives."""
    rng = np.random.default_rng(1)
    n = 600
    five = np.concatenate([random_lanes(n, 2, 2.0), rng.uniform(0, 0.7, (1, n)), rng.choice([0, 0.0, -1e-2, 1e-2], (1, n))])
    exact = general(five)
    got = batch.over_lanes(lanes.gradient_kernel(5000), five, bulk.WITH_MORE)[0]
    alone = batch.over_lanes(lanes.length_kernel(5000), five, bulk.WITH_MORE)
    np.testing.assert_array_equal(alone[0], got[0])
    assert np.isinf(exact[0]).sum() > 20
    for a, b in zip(got, exact, strict=True):
        finite = np.isfinite(b)
        np.testing.assert_array_equal(np.isfinite(a), finite)
        np.testing.assert_allclose(a[finite], b[finite], rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(np.isinf(got[0]), np.isinf(exact[0]))


@pytest.mark.ci
def test_gradients_equal_those_of_one_front(general):
    points = random_lanes(300, 4, 2.0)
    got = sp.precursor_lengths(sp.Slider(*points), derivatives=1)
    exact = general(np.concatenate([points, np.zeros((2, 300))]))
    # two programs round differently, and the last digit of a stress moves the crossing by itself over the fall of a contact
    np.testing.assert_allclose(got.length, by_recursion(points), rtol=1e-12)
    assert (got.length == 0).any()
    assert (got.slider.height[got.length == 0] == 0).all()
    for a, b in zip(jax.tree.leaves(got), exact[:4], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-10)


@pytest.mark.ci
@pytest.mark.parametrize("numbers", [pytest.param(3, marks=pytest.mark.slow), 5])
def test_arrests_equal_the_general_recursion(numbers):
    """Count, length, status and edge stress, of every way to end: given up at just so many contacts among them."""
    rng = np.random.default_rng(numbers)
    n, most = 800, 60
    five = np.concatenate([random_lanes(n, 7, 2.3), rng.uniform(0, 0.8, (1, n)), rng.choice([0, 0.0, -1e-2, 1e-2], (1, n))])
    five[0, :20], five[1, :20] = 8.0, 0.5  # short enough to run away before they are given up
    endings = set(FRONT_OUTCOMES) - {Outcome.INVALID, Outcome.RAN_THROUGH}
    general = batch.over_lanes(bulk.general_arrest_kernel(kind(numbers), most), five[:numbers], bulk.ANY)
    got = batch.over_lanes(lanes.arrest_kernel(most), five[:numbers], bulk.WITH_MORE)
    np.testing.assert_array_equal(got[0], general[0])
    np.testing.assert_array_equal(got[2], general[2])
    assert set(got[2]) == endings - ({Outcome.RUN_AWAY} if numbers == 3 else set())
    for a, b in ((got[1], general[1]), (got[3], general[3])):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-10)
    assert (got[0][got[2] == Outcome.LIMIT] == most).all()
    alone = batch.over_lanes(lanes.length_kernel(most), five[:numbers], bulk.WITH_MORE)[0]
    np.testing.assert_allclose(alone, got[1], rtol=1e-9, atol=1e-10)


@pytest.mark.ci
@pytest.mark.parametrize("lengths", [sp.precursor_lengths, lambda *a, **k: sp.precursor_lengths(*a, derivatives=1, **k).length])
def test_a_missing_length_says_why(lengths):
    """Here because numbers leave double precision; that it was given up: tests of the front."""
    with pytest.warns(
        RuntimeWarning, match=r"1 of 2 fronts, the first at index .1,., have no length .NaN.: .*too large for the"
    ):
        assert np.isnan(lengths(sp.Slider([25.0, 1e170], 0.03, 0.3))).tolist() == [False, True]


@pytest.mark.ci
def test_the_last_break_that_is_allowed():
    for most in (25, 26):  # 26 contacts break: the very number, and one fewer
        assert np.isnan(bulk.lengths(sp.Slider(25.0, 0.03, 0.3), most=most)) == (most < 26)


@pytest.mark.ci
def test_long_fronts_by_the_series_equal_the_recursion():
    rng = np.random.default_rng(5)
    n = 120
    points = np.stack([10 ** rng.uniform(3.3, 4.6, n), 10 ** rng.uniform(-4, -0.5, n), rng.uniform(0, 0.5, n)])
    long = exact_lanes.which_are_long(points)
    assert 20 < len(long) < 100
    whole = sp.precursor_lengths(sp.Slider(*points))
    np.testing.assert_allclose(whole, by_recursion(points), rtol=1e-10)
    assert (whole[long] > 0.9 * exact_lanes.LONG).all()


@pytest.mark.ci
def test_smooth_rule_in_bulk():
    slider, width = sp.Slider([10.0, 25.0, 50.0], 0.01, 0.3), 0.02
    np.testing.assert_allclose(
        sp.precursor_lengths(slider, rule=sp.SmoothBreak(width)),
        sp.precursor_length(slider, rule=sp.SmoothBreak(width)),
        rtol=1e-12,
    )


@pytest.mark.ci
def test_rank_follows_the_length():
    """Neighbours in rank are neighbours in length; ranks span the domain without saturating."""
    points = random_lanes(4000, 6, 6.0)
    rank = bulk.length_rank(points)
    assert rank.dtype == np.uint16
    assert rank.max() < 65535
    short = points[:, points[0] < 1000]
    length, order = by_recursion(short), np.argsort(bulk.length_rank(short), kind="stable")
    long_enough = length[order] > 5
    chunks = np.array_split(length[order][long_enough], 40)
    assert np.mean([chunk.max() / chunk.mean() for chunk in chunks]) < 1.5


FORKED = """
import os, warnings, jax
import numpy as np
import slippulse_jax as sp
warnings.simplefilter("ignore")
slider, si = sp.Slider(25.0, 0.03, 0.3), dict(correlation_length=1e-5, young=3e9, poisson=0.3)
table = sp.Measurements.from_si(height=[0.01, 0.02], length=[0.01, 0.015], length_sigma=[1e-3, 1e-3], **si)
calls = {
    "before": lambda: np.ceil(slider.height),
    "precursor_lengths": lambda: sp.precursor_lengths(slider),
    "precursor_length": lambda: sp.precursor_length(slider),
    "first_precursor of a block": lambda: sp.first_precursor(sp.Block(25.0, 0.03, 0.3)),
    "exact_length": lambda: sp.exact_length(slider),
    "exact_lengths": lambda: sp.exact_lengths(slider),
    "onset": lambda: sp.rebreaking_onset(25.0, 0.3),
    "chain": lambda: sp.chain(slider, sites=8),
    "sensitivity": lambda: sp.sensitivity(slider, sites=8),
    "sweep": lambda: sp.sweep(height=[10.0, 20.0], stiffness=0.03, poisson=0.3, outputs="length"),
    "fit": lambda: sp.fit(table),
}

def in_child(call):
    if (child := os.fork()) == 0:
        try:
            call()
            os._exit(0)
        except RuntimeError as error:
            os._exit(1 if "get_context(\\"spawn\\")" in str(error) else 2)
        except BaseException:
            os._exit(3)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

print(in_child(calls["before"]), end=" ")
jax.devices()  # as any call does
print([name for name, call in calls.items() if in_child(call) != 1])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.ci
def test_a_child_of_fork_names_spawn_instead_of_waiting_for_ever():
    done = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, "0 ['before']\n"), done.stderr
