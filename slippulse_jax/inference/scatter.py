"""Size of σ from the scatter of the data about the fit, where only the ratios of σ are known.

The deviance of the data is then what it should be, on average, of as many of them as the fit does not use up. Errors of inputs
keep the size that is stated for them: a parameter that its prior determines uses up none of the data.
"""

from typing import NamedTuple

import numpy as np

from slippulse_jax.inference.likelihood import EXPECTED, Problem, terms
from slippulse_jax.inference.minimise import minimise

UNMEASURABLE = 1e-4
"""Relative scatter of the lengths below which it is not an error of measurement."""
TURNS, SETTLED = 100, 1e-10
"""Largest number of alternations between fit and scale, and the relative change of the scale at which they end."""


class Scatter(NamedTuple):
    """Size of σ by the scatter."""

    factor: float  # on the stated σ, or on 1 λc
    dof: float  # degrees of freedom left over by the fit
    problem: Problem  # with σ of that size
    deviance: float
    closest: float | None = None  # relative distance of the lengths from the fit, where it is too small to be scatter


def scatter_about(problem: Problem, theta: np.ndarray, *, of_lengths: bool) -> Scatter:
    """Scale σ to the scatter about the fit that is nearest to θ.

    Parameters
    ----------
    problem : Problem
        With the σ stated.
    theta : array, shape (p,)
    of_lengths : bool
        Scale the errors of lengths alone, instead of those of all data.
    """
    q, factor, turns = problem.parameters, 1.0, 0
    widest = float(np.max(problem.lengths.sigma / problem.lengths.value[0]))
    while True:
        sized = problem.with_sigma(factor, of_lengths=of_lengths)
        end = minimise(sized, theta[None], q.low, q.high)
        theta, total = end.theta[0], 2 * float(end.value[0])
        deviance, dof = _left_over(sized, theta, of_lengths)
        if not np.isfinite(deviance):  # the front never stops: there is no fit
            return Scatter(factor, dof, sized, total)
        change = np.sqrt(deviance / dof / EXPECTED[problem.loss]) if dof > 1e-6 else 0.0
        if factor * change * widest < UNMEASURABLE:
            least = UNMEASURABLE / widest
            sized = problem.with_sigma(least, of_lengths=of_lengths)
            total = 2 * float(minimise(sized, theta[None], q.low, q.high).value[0])
            return Scatter(least, dof, sized, total, factor * change * widest)
        turns += 1
        if abs(change - 1) < SETTLED or turns == TURNS:
            return Scatter(factor, dof, sized, total)
        factor *= float(change)


def _left_over(problem: Problem, theta: np.ndarray, of_lengths: bool) -> tuple[float, float]:
    """Deviance of the data whose σ are scaled, and their degrees of freedom."""
    blocks = problem.observed[:1] if of_lengths else problem.observed
    deviance, count = 0.0, sum(len(data.rows) for data in blocks)
    for data in blocks:
        mu = problem.predict(theta, data.observable)
        deviance += 2 * float(terms(mu, data, np.zeros(1, int), problem.loss).value.sum())
    reach = problem.parameters.high - problem.parameters.low
    jacobian = problem.information(theta)[1] * reach
    own = jacobian[:count]  # the lengths come first, priors last
    used = np.trace(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12, hermitian=True) @ (own.T @ own))
    return deviance, count - float(used)
