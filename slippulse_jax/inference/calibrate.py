"""Calibrated intervals, by simulating measurements at every value.

The simulations give the rise of the deviance that an interval allows there.

Near the longest attainable length, and where two valleys compete, the rise of the deviance at the true value is not distributed
as χ². Feldman and Cousins (Phys. Rev. D 57, 3873, 1998) take the distribution that it does have: at each value measurements are
drawn, each is fitted, and the quantile of the rise replaces that of χ². A second parameter has its best value there.

Every fit is a search of one table of predictions, in units of σ, over all values that are not hopeless; a prior is a datum like
any other.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from slippulse_jax.inference.likelihood import Problem
from slippulse_jax.inference.profile import Curve, Interval, Intervals, pieces_of
from slippulse_jax.inference.search import SLACK, Cells, Root

SIMULATIONS = {1: 2000, 2: 500}
"""By the number of fitted parameters."""
RESOLUTION = {1: 0.15, 2: 0.3}
"""Spacing of the table of predictions, in standard errors of all measurements together."""
MOST_NODES, MOST_VALUES = {1: 2000, 2: 120}, {1: 60, 2: 30}
MOST_OTHERS = 80  # values of a second parameter at each of the first
ONE_THREAD = 4 * 2**16
"""Multiplications up to which OpenBLAS uses one thread: larger products, split over two, took ten times as long."""
STRAIGHT = 1.15
"""Ratio of a profile's limit at the highest level to that of a parabola from which on intervals are simulated."""
HOPELESS = 25.0  # rise of D above which a value is excluded at any calibration; the cells of a scan reach farther


class Table(NamedTuple):
    """Predictions at M values of one parameter, at each of which the other takes several."""

    node: np.ndarray  # (M,), θ of the parameter
    best: np.ndarray  # (M,), row of the best value of the other
    theta: np.ndarray  # (G, p)
    column: np.ndarray  # (G,), which of the M values
    off: np.ndarray  # (G, n), predictions less what was measured, in σ, the parameters with priors last


class Calibration(NamedTuple):
    """Result of simulations along one parameter."""

    intervals: Intervals
    covered: tuple[float, float]  # share of estimates within 1 and 1.96 standard errors, at the best value


def can_be_calibrated(problem: Problem) -> bool:
    """Whether this is a fit of one or two parameters to values with Gaussian errors."""
    return problem.p <= 2 and problem.plain


def to_be_simulated(
    problem: Problem, wanted: str, minima: list[Root], deviance: float, pieces: dict[int, Intervals], best: np.ndarray
) -> bool:
    """Whether to simulate intervals: as requested, or where valleys compete or one is not parabolic.

    Parameters
    ----------
    problem : Problem
    wanted : {"auto", "profile", "calibrated"}
    minima : list of Root
        Best first.
    deviance : float
        The least.
    pieces : dict
        Profile-likelihood intervals of each θ_j.
    best : array, shape (p,)
    """
    if wanted == "calibrated":
        return True
    if wanted == "profile" or not can_be_calibrated(problem) or not minima:
        return False
    if sum(one.deviance <= deviance + SLACK for one in minima) > 1:
        return True
    for j, found in pieces.items():
        level, last = max(found.items())
        if not last or minima[0].singular[j]:
            return False
        reach = np.sqrt(chdtri(1, 1 - level) * minima[0].covariance[j, j])
        off = (best[j] - last[0].low) / reach, (last[-1].high - best[j]) / reach
        if max(off) > STRAIGHT or min(off) < 1 / STRAIGHT:
            return True
    return False


def calibrated(
    problem: Problem,
    levels: tuple[float, ...],
    *,
    curves: dict[int, Curve] | None = None,
    cells: Cells | None = None,
    seed: int = 0,
) -> dict[int, Calibration]:
    """Allowed θ at each level, as intervals in increasing order, and how often a standard error holds the truth.

    Parameters
    ----------
    problem : Problem
        Of one or two parameters, and values with Gaussian errors.
    levels : tuple of float
    curves : dict, optional
        Profile of each θ_j asked for; needed with two parameters.
    cells : Cells, optional
        Of a scan; needed with two parameters.
    seed : int
        Of the simulations, `SIMULATIONS` per value looked at.
    """
    if problem.p == 1:
        return {0: _simulated(problem, levels, 0, _along(problem), seed)}
    if curves is None or cells is None:
        raise ValueError("calibrated intervals of two parameters need their profiles and a scan")
    return {j: _simulated(problem, levels, j, _across(problem, j, curve, cells), seed) for j, curve in curves.items()}


def _simulated(problem: Problem, levels: tuple[float, ...], j: int, table: Table, seed: int) -> Calibration:
    """Simulate measurements at each value of θ_j and fit them by the table."""
    deviance = (table.off**2).sum(axis=1)
    rise = np.minimum.reduceat(deviance, np.searchsorted(table.column, np.arange(len(table.node)))) - deviance.min()
    candidates = np.nonzero(rise < HOPELESS)[0]
    places = np.linspace(0, len(candidates) - 1, MOST_VALUES[problem.p]).round().astype(int)
    chosen = np.unique(np.concatenate([candidates[places], [int(np.argmin(rise))]]))
    noise = np.random.default_rng(seed).standard_normal((SIMULATIONS[problem.p], table.off.shape[1]), np.float32)
    found = [_refitted(table, int(one), noise) for one in chosen]
    critical = np.quantile(np.array([rises for rises, _ in found]), levels, axis=1)
    intervals = {
        level: _below(table.node, rise - np.interp(table.node, table.node[chosen], own))
        for level, own in zip(levels, critical, strict=True)
    }
    best = int(np.argmin(rise))
    estimates = table.node[found[int(np.searchsorted(chosen, best))][1]]
    stderr = np.interp(estimates, table.node[chosen], _standard_errors(problem, j, table.theta[table.best[chosen]]))
    off = np.abs(estimates - table.node[best]) / stderr
    return Calibration(intervals, (float((off <= 1).mean()), float((off <= 1.96).mean())))


def _residuals(problem: Problem, theta: np.ndarray) -> np.ndarray:
    """Residuals at points (B, p); very large instead of infinite where the front never stops."""
    found, _ = problem.residuals(problem.predictions(theta), theta)
    return np.where(np.isfinite(found), found, 1e9)


def _steps(off: np.ndarray) -> np.ndarray:
    """Distance from each row to the next, in σ."""
    return np.sqrt((np.diff(off, axis=0) ** 2).sum(axis=1))


def _along(problem: Problem) -> Table:
    """Choose values of a single parameter, evenly spaced in the predictions."""
    low, high = problem.parameters.low[0], problem.parameters.high[0]
    node = np.linspace(low, high, 801)
    for _ in range(2):
        path = np.concatenate([[0], np.cumsum(_steps(_residuals(problem, node[:, None])))])
        count = int(np.clip(path[-1] / RESOLUTION[1], 400, MOST_NODES[1]))
        # values stay apart where the predictions are constant too, so that an open side is seen
        path = path / max(path[-1], 1e-300) + 0.1 * (node - low) / (high - low)
        node = np.interp(np.linspace(0, path[-1], count), path, node)
    every = np.arange(len(node))
    return Table(node, every, node[:, None], every, _residuals(problem, node[:, None]))


def _across(problem: Problem, j: int, curve: Curve, cells: Cells) -> Table:
    """Choose values of θ_j along its profile, and at each those of the other parameter that a scan left."""
    near = curve.deviance <= curve.deviance.min() + HOPELESS
    profile = np.nonzero(near)[0]
    profile = np.arange(max(profile[0] - 1, 0), min(profile[-1] + 2, len(near)))
    path = np.concatenate([[0], np.cumsum(np.minimum(_steps(_residuals(problem, curve.theta[profile])), 3.0))])
    path += 1e-3 * np.arange(len(path))
    count = int(np.clip(path[-1] / RESOLUTION[2], 12, MOST_NODES[2]))
    node = np.interp(np.linspace(0, path[-1], count), path, curve.node[profile])
    ridge = np.stack([np.interp(node, curve.node, column) for column in curve.theta.T], axis=1)
    other, found = 1 - j, []
    # the values of the other that the scan left, and how far apart their predictions are
    for x, on_ridge in zip(node, ridge[:, other], strict=True):
        there = (cells.low[:, j] <= x) & (x <= cells.high[:, j])
        # a cell is almost linear, so its two ends give its length
        found.append(np.unique(np.concatenate([[on_ridge], cells.low[there, other], cells.high[there, other]])))
    steps = _steps(_residuals(problem, _points(node, found, j)))
    starts = np.cumsum([0] + [len(y) for y in found])
    for i, y in enumerate(found):
        # gaps between cells are skipped
        path = np.concatenate([[0], np.cumsum(np.minimum(steps[starts[i] : starts[i + 1] - 1], 20.0))])
        count = int(np.clip(path[-1] / RESOLUTION[2], 2, MOST_OTHERS))
        found[i] = np.append(np.interp(np.linspace(0, path[-1], count), path, y), ridge[i, other])
    theta = _points(node, found, j)
    off = _residuals(problem, theta)
    deviance = (off**2).sum(axis=1)
    starts = np.cumsum([0] + [len(y) for y in found])
    best = np.array([a + int(np.argmin(deviance[a:b])) for a, b in pairwise(starts)])
    return Table(node, best, theta, np.repeat(np.arange(len(node)), np.diff(starts)), off)


def _points(node: np.ndarray, others: list[np.ndarray], j: int) -> np.ndarray:
    """Points (G, 2) of every value of θ_j with each of the other's values there."""
    theta = np.empty((sum(len(y) for y in others), 2))
    theta[:, j] = np.repeat(node, [len(y) for y in others])
    theta[:, 1 - j] = np.concatenate(others)
    return theta


def _refitted(table: Table, true: int, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rise of D at the true value above its minimum, and the value at that minimum, per simulation."""
    # single precision is enough: the table is far coarser
    off = (table.off - table.off[table.best[true]]).clip(-1e6, 1e6).astype(np.float32)
    # |y − μ|² = |ε|² − 2 ε·off + |off|², and |ε|² is the same everywhere; one product, a simulation per row
    there = np.concatenate([-2 * off, np.einsum("gn,gn->g", off, off)[:, None]], axis=1).T
    drawn, own = np.concatenate([noise, np.ones_like(noise[:, :1])], axis=1), table.column == true
    rise, least = np.empty(len(noise), np.float32), np.empty(len(noise), np.intp)
    rows = max(1, ONE_THREAD // there.size)
    for some in (slice(start, start + rows) for start in range(0, len(noise), rows)):
        deviance = drawn[some] @ there
        least[some] = deviance.argmin(axis=1)
        rise[some] = deviance[:, own].min(axis=1) - deviance.min(axis=1)
    return rise, table.column[least]


def _standard_errors(problem: Problem, j: int, theta: np.ndarray) -> np.ndarray:
    """Standard error of θ_j from the information at each point; inf where that is singular."""
    information = problem(theta, order=1).metric
    assert information is not None
    regular = np.linalg.cond(information) < 1e14
    found = np.full(len(theta), np.inf)
    found[regular] = np.sqrt(np.linalg.inv(information[regular])[:, j, j])
    return found


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
    return pieces_of(ends, open_low, open_high)
