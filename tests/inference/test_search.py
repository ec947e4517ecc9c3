"""The search and the profiles on random studies, against the deviance on dense grids that neither of them sees."""

import numpy as np
import pytest
import random_tables

import slippulse_jax as sp
from slippulse_jax.inference.fit import wanted_parameters
from slippulse_jax.inference.parameters import parameter_set, with_errors_of_measuring
from slippulse_jax.inference.search.minima import DevianceGrid

pytestmark = pytest.mark.filterwarnings("ignore::slippulse_jax.inference.table.measurements.MeasurementWarning")
KINDS = ("one stiffness", "bounds", "counts", "mixed", "prestress", "second", "each specimen", "priors", "student", "relative")
DENSE = {1: 20_001, 2: 101, 3: 21}
"""Nodes along each parameter, by the number of parameters."""
EDGE = 2e-3
"""Part of an interval by which a node may lie outside: of a count without an error, whose edges are blurred in a deviance."""


def test_first_of_equal_nodes_is_the_lowest():
    """Of a floor one corner, of a slope the end, of what is infinite nothing."""
    deviance = np.array([[np.inf, 4.0, 4.0, 9.0], [3.0, 1.0, 1.0, 5.0], [6.0, 1.0, 1.0, 0.5]])
    grid = DevianceGrid(np.stack(np.meshgrid(np.arange(3.0), np.arange(4.0), indexing="ij"), axis=-1), deviance)
    np.testing.assert_array_equal(np.argwhere(grid.lows((0, 1))), [[1, 1], [2, 3]])
    np.testing.assert_array_equal(grid.beside(0, np.array([1.4, 1.6]), 1)[:, 0], [[1, 1], [2, 3]])
    np.testing.assert_array_equal(grid.beside(1, np.array([0.1]), 1)[:, 0], [[1, 0]])
    assert not DevianceGrid(grid.theta, np.full((3, 4), np.inf)).lows((0, 1)).any()


def lows(theta, deviance):
    """Local minima of one row of values."""
    inner = (deviance[1:-1] < deviance[:-2]) & (deviance[1:-1] <= deviance[2:])
    return theta[1:-1][inner], deviance[1:-1][inner]


def studies(kind, seeds):
    """Tables of this kind of which no more than three parameters are fitted."""
    for table in (random_tables.draw(seed, kind) for seed in seeds):
        scaled = table.options.get("sigma") == "relative"
        wanted = wanted_parameters(table.measurements, table.free, None, None)
        every = with_errors_of_measuring(table.measurements, wanted, size_known=not scaled)
        if len(parameter_set(table.measurements, every).free) in DENSE:
            yield table


def check(table):
    """Nothing lies lower; what the deviance allows lies in the intervals; of one parameter, every valley has its root."""
    result = sp.fit(table.measurements, list(table.free), **table.options, intervals="profile")
    problem, q = result.problem, result.problem.parameters
    pieces = {
        j: [[q.free[j].theta(end) for end in piece[:2]] for piece in result.intervals[name].get(0.95, [])]
        for j, name in enumerate(q.names)
        if name in result.intervals
    }
    # over the whole range, and around the intervals, as wide again
    box = np.stack([q.low, q.high])
    near = box.copy()
    for j, own in pieces.items():
        if own:
            low, high = own[0][0], own[-1][1]
            near[:, j] = np.clip([low - (high - low) / 2, high + (high - low) / 2], q.low[j], q.high[j])
    least = min([result.deviance, *(root.deviance for root in result.minima)])
    limit = result.deviance + result.rise(0.95)
    for low, high in (box, near):
        axes = np.linspace(low, high, DENSE[problem.p]).T
        theta = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, problem.p)
        deviance = 2 * problem(theta).value
        assert least <= deviance.min() + 1e-6 * max(1, abs(least))
        held = theta[deviance <= limit]
        for j, own in pieces.items():
            inside = [(a - EDGE * (b - a) <= held[:, j]) & (held[:, j] <= b + EDGE * (b - a)) for a, b in own]
            assert not own or np.any(inside, axis=0).all()
        if problem.p == 1 and not (np.array(table.measurements.kind) != "length").any():
            for at, low_there in zip(*lows(theta[:, 0], deviance), strict=True):
                assert low_there > limit or min(abs(root.theta[0] - at) for root in result.minima) < 2e-3


@pytest.mark.ci
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("mixed", "prestress", "student")])
def test_nothing_is_missed_by_a_random_study(kind):
    check(next(studies(kind, range(1, 100))))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_missed(kind):
    for table in studies(kind, range(100, 150)):
        check(table)
