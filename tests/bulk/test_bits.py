"""No bit of a lane depends on its company: programs for many lanes."""

import numpy as np
import pytest
from strategies import random_sliders

import slippulse_jax as sp
from slippulse_jax import lengths
from slippulse_jax.bulk.chunks import Layout, over_lanes
from slippulse_jax.exact import bulk as exact_lanes
from slippulse_jax.exact.bulk import exact_fronts
from slippulse_jax.front import lanes

pytestmark = pytest.mark.ci


def alike(f, columns):
    """Results of all columns, the same to the last bit in another order and in parts of the batch."""
    whole, count = f(columns), columns.shape[1]
    order = np.random.default_rng(0).permutation(count)
    np.testing.assert_array_equal(f(columns[:, order]), whole[order])
    for part in (slice(0, 1), slice(0, 2), slice(7, 20), slice(3, 67)):
        np.testing.assert_array_equal(f(columns[:, part]), whole[part])
    return whole


def of_sliders(columns):
    return sp.precursor_lengths(sp.Slider(*columns))


def test_lengths():
    """Short and long fronts, each by a program of their own; in chunks of another size, and in arrays of another shape."""
    rng = np.random.default_rng(5)
    short = np.stack([1 + 10 ** rng.uniform(-1, 3.3, 1000), 10 ** rng.uniform(-5, 0, 1000), rng.uniform(-0.9, 0.5, 1000)])
    long = np.stack([10 ** rng.uniform(3.3, 4.6, 120), 10 ** rng.uniform(-4, -0.5, 120), rng.uniform(0, 0.5, 120)])
    assert 20 < len(exact_lanes.which_are_long(long)) < 100
    alike(of_sliders, long)
    whole = alike(of_sliders, short)
    np.testing.assert_array_equal(of_sliders(short.reshape(3, 10, 100)).ravel(), whole)

    def by_recursion(columns, layout=lengths.LENGTHS):
        return over_lanes(lanes.length_kernel(10_000_000), columns, layout, lengths.length_rank)[0]

    np.testing.assert_array_equal(by_recursion(short, Layout(chunk=128, few=64)), alike(by_recursion, short))


def test_exact_lengths():
    rng = np.random.default_rng(62)
    height, stiffness, poisson = random_sliders(130, 62).T
    prestress = rng.choice([0, 0, 1], 130) * rng.uniform(-0.5, 0.7, 130)
    slope = rng.choice([0, 0, 1], 130) * 10 ** rng.uniform(-6, -2, 130)
    alike(lambda five: exact_fronts(five)[0], np.array([height, stiffness, poisson, prestress, slope]))


def test_exact_lengths_far_from_the_edge():
    rng = np.random.default_rng(68)
    tall = np.stack([10 ** rng.uniform(2, 5, 200), 10 ** rng.uniform(-4, 0, 200), rng.uniform(-0.9, 0.5, 200)])
    found = alike(lambda columns: exact_fronts(columns)[0], tall)
    assert np.isfinite(found).mean() > 0.5
