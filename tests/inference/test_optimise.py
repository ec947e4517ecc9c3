"""The optimisers of a fit, on functions whose minima are known: no model, nothing to compile but optax."""

from typing import get_args

import numpy as np
import pytest

from slippulse_jax.inference.search.likelihood import Evaluation
from slippulse_jax.inference.search.minimise import Convergence, Method, minimise


class LeastSquares:
    """½|r|² of residuals with their Jacobian and second derivatives, and how many points were looked at."""

    def __init__(self, residuals, jacobian, bend):
        self.residuals, self.jacobian, self.bend = residuals, jacobian, bend
        self.points = 0

    def traced(self, theta):
        return sum(r**2 for r in self.residuals(*theta)) / 2

    def __call__(self, theta, lane=None, order=0):
        self.points += len(theta)
        x, y = theta.T
        r, j, b = (np.moveaxis(np.array(f(x, y)), -1, 0) for f in (self.residuals, self.jacobian, self.bend))
        metric = np.einsum("bnp,bnq->bpq", j, j)
        return Evaluation(
            (r**2).sum(axis=1) / 2, np.einsum("bn,bnp->bp", r, j), metric, metric + np.einsum("bn,bnpq->bpq", r, b)
        )


def valley():
    """Rosenbrock's function: a bent valley with its one minimum, 0, at (1, 1)."""
    zero, one = np.zeros_like, np.ones_like
    return LeastSquares(
        lambda x, y: [10 * (y - x**2), 1 - x],
        lambda x, y: [[-20 * x, 10 * one(x)], [-one(x), zero(x)]],
        lambda x, y: [[[-20 * one(x), zero(x)], [zero(x), zero(x)]], [[zero(x)] * 2] * 2],
    )


def two_wells():
    """½(x² − 1)² + ½(y − x/2)²: minima at ±(1, ½), a saddle between them."""
    zero, one = np.zeros_like, np.ones_like
    return LeastSquares(
        lambda x, y: [x**2 - 1, y - x / 2],
        lambda x, y: [[2 * x, zero(x)], [-one(x) / 2, one(x)]],
        lambda x, y: [[[2 * one(x), zero(x)], [zero(x), zero(x)]], [[zero(x)] * 2] * 2],
    )


LOW, HIGH = np.array([-2.0, -2.0]), np.array([2.0, 2.0])
STARTS = np.random.default_rng(0).uniform(LOW, HIGH, (20, 2))
CLOSE = {"lm": 1e-6, "lbfgs": 1e-4, "adam": 1e-2}
METHODS = [method if method == "lm" else pytest.param(method, marks=pytest.mark.ci) for method in get_args(Method)]
"""The one that fits use unless told otherwise, and those of optax, which compile."""


@pytest.mark.parametrize("method", METHODS)
def test_bent_valley(method):
    found = minimise(valley(), STARTS, LOW, HIGH, method=method)
    reached = np.abs(found.theta - 1).max(axis=1) < CLOSE[method]
    assert reached.all() or method == "adam"  # which creeps along its floor
    assert (found.convergence[np.abs(found.theta - 1).max(axis=1) < 1e-3] == Convergence.CONVERGED).all()
    far = np.abs(found.theta - 1).max(axis=1) > 0.1
    assert (found.convergence[far] == Convergence.NOT_CONVERGED).all(), "where it is not, that is said"


@pytest.mark.parametrize("method", get_args(Method))
def test_both_wells_are_found(method):
    found = minimise(two_wells(), STARTS, LOW, HIGH, method=method)
    assert (found.convergence == Convergence.CONVERGED).all()
    side = np.sign(found.theta[:, :1])
    np.testing.assert_allclose(found.theta, side * [1, 0.5], atol=CLOSE[method])
    assert set(side.ravel()) == {-1, 1}


@pytest.mark.parametrize("method", METHODS)
def test_minimum_on_a_side_of_the_box(method):
    """Beyond x = ½ is forbidden: the valley's least value there is at (½, ¼)."""
    found = minimise(valley(), STARTS, LOW, np.array([0.5, 2.0]), method=method, max_steps=100)
    reached = np.abs(found.theta - [0.5, 0.25]).max(axis=1) < CLOSE[method]
    assert reached.mean() >= {"lm": 1, "lbfgs": 1, "adam": 0.7}[method]  # which creeps along the valley to a side at infinity
    np.testing.assert_allclose(found.theta[reached, 0], 0.5, atol=0 if method == "lm" else CLOSE[method])
    assert (found.convergence[reached] == Convergence.CONVERGED).all() or method == "adam"  # which says that it still moves


def test_held_coordinates_stay():
    start = np.array([[-1.2, 1.0], [0.3, 1.0]])
    found = minimise(valley(), start, LOW, HIGH, held=np.array([True, False]))
    np.testing.assert_array_equal(found.theta[:, 0], start[:, 0])
    np.testing.assert_allclose(found.theta[:, 1], start[:, 0] ** 2, atol=CLOSE["lm"])


def test_flat_and_endless_starts_are_named():
    """A floor at x < 0 that knows nothing, and no value at all beyond x = 1."""
    function = valley()

    def objective(theta, lane=None, order=0):
        at = function(theta, lane, order)
        x = theta[:, 0]
        value = np.where(x < 0, 1e3, np.where(x > 1.5, np.inf, at.value))
        flat = (x >= 0) & (x <= 1.5)
        return Evaluation(value, at.gradient * flat[:, None], *(m * flat[:, None, None] for m in at[2:]))

    found = minimise(objective, np.array([[-1.0, 0.0], [1.8, 0.0], [0.9, 0.9]]), LOW, HIGH)
    assert list(found.convergence) == [Convergence.FLAT, Convergence.NO_LENGTH, Convergence.CONVERGED]
    np.testing.assert_array_equal(found.theta[:2], [[-1.0, 0.0], [1.8, 0.0]])


@pytest.mark.ci
def test_finished_starts_cost_nothing_more():
    """Twenty starts at the minimum beside one that has far to go: no more looks than that one needs."""
    far = np.array([[-1.9, 1.9]])
    alone, beside = valley(), valley()
    minimise(alone, far, LOW, HIGH)
    minimise(beside, np.concatenate([far, np.ones((20, 2))]), LOW, HIGH)
    assert beside.points - alone.points <= 20 * 4
