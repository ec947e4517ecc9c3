"""Calibrated intervals, by simulating measurements at every value.

The simulations give the rise of the deviance that an interval allows there.

Near the longest attainable length the deviance is no parabola, at the peak not even to lowest order, and its rise at the true
value is not distributed as χ². Feldman and Cousins (Phys. Rev. D 57, 3873, 1998) take the distribution that it does have: for
each stiffness, measurements are drawn, each is fitted, and the quantile of the rise replaces that of χ².
"""

import numpy as np

from slippulse_jax.inference.likelihood import Problem
from slippulse_jax.inference.profile import Interval

SIMULATIONS = 2000
RESOLUTION = 0.15  # of the grid of values, in standard errors of all measurements together
MOST_NODES, MOST_VALUES = 2000, 60
HOPELESS = 25.0  # rise of D beyond which a value is excluded whatever its calibration


def can_be_calibrated(problem: Problem) -> bool:
    """Whether this is a fit of one parameter to lengths with Gaussian errors."""
    plain = problem.exact_values and problem.loss.name == "normal"
    return problem.p == 1 and plain and problem.parameters.discrepancy is None


def calibrated(problem: Problem, levels: tuple[float, ...], *, seed: int = 0) -> dict[float, list[Interval]]:
    """Allowed θ of a fit of one parameter, at each level, as intervals in increasing order.

    Parameters
    ----------
    problem : Problem
        Of one parameter and lengths with Gaussian errors.
    levels : tuple of float
    seed : int
        Of the simulations, `SIMULATIONS` per value looked at.

    Raises
    ------
    ValueError
        If there are several parameters, or data of another kind.
    """
    if not can_be_calibrated(problem):
        raise ValueError("calibrated intervals: for one parameter, and lengths with Gaussian errors")
    node, mean = _grid(problem)
    measured = np.concatenate([block.data.value[0] / block.data.sigma for block in problem.blocks])
    rise = ((measured - mean) ** 2).sum(axis=1)
    rise -= rise.min()
    candidates = np.nonzero(rise < HOPELESS)[0]
    chosen = np.unique(candidates[np.linspace(0, len(candidates) - 1, MOST_VALUES).round().astype(int)])
    noise = np.random.default_rng(seed).standard_normal((SIMULATIONS, mean.shape[1]))
    found = np.array([_rises(mean, one, noise) for one in chosen])
    result = {}
    for level in levels:
        critical = np.interp(node, node[chosen], np.quantile(found, level, axis=1))
        result[level] = _below(node, rise - critical)
    return result


def _grid(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Values θ, and what is predicted in units of σ, evenly spaced in the latter."""
    low, high = problem.parameters.low[0], problem.parameters.high[0]
    node = np.linspace(low, high, 801)
    for _ in range(2):
        mean = _scaled(problem, node)
        path = np.concatenate([[0], np.cumsum(np.sqrt((np.diff(mean, axis=0) ** 2).sum(axis=1)))])
        # where nothing responds the values are kept apart too, so that an open side is seen
        path = path / max(path[-1], 1e-300) + 0.1 * (node - low) / (high - low)
        count = int(np.clip(_length(mean) / RESOLUTION, 400, MOST_NODES))
        node = np.interp(np.linspace(0, path[-1], count), path, node)
    return node, _scaled(problem, node)


def _length(mean: np.ndarray) -> float:
    return float(np.sqrt((np.diff(mean, axis=0) ** 2).sum(axis=1)).sum())


def _scaled(problem: Problem, node: np.ndarray) -> np.ndarray:
    columns = [problem.predict(node[:, None], block.observable) / block.data.sigma for block in problem.blocks]
    return np.concatenate(columns, axis=1)


def _rises(mean: np.ndarray, true: int, noise: np.ndarray) -> np.ndarray:
    """Rise of D at the true value above its minimum over all values, in each simulation."""
    off = mean - mean[true]
    # |y − μ|² = |ε|² − 2 ε·off + |off|², and |ε|² is the deviance at the true value
    lowest = (np.einsum("gn,gn->g", off, off)[:, None] - 2 * off @ noise.T).min(axis=0)
    return -np.minimum(lowest, 0)


def _below(node: np.ndarray, excess: np.ndarray) -> list[Interval]:
    """Where `excess` is not positive, its ends by straight lines."""
    inside = excess <= 0
    change = np.nonzero(inside[1:] != inside[:-1])[0]
    ends = [
        float(node[i] + (node[i + 1] - node[i]) * excess[i] / (excess[i] - excess[i + 1]))
        for i in change
    ]  # fmt: skip
    open_low, open_high = bool(inside[0]), bool(inside[-1])
    ends = [float(node[0])] * open_low + ends + [float(node[-1])] * open_high
    pairs = list(zip(ends[::2], ends[1::2], strict=True))
    return [Interval(a, b, open_low and i == 0, open_high and i == len(pairs) - 1) for i, (a, b) in enumerate(pairs)]
