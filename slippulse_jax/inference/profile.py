"""Profile likelihood: the deviance along one or two parameters, minimised over the others at every point.

The length rises with stiffness, peaks and falls again, so that the likelihood can have two maxima, a broad top, or an open
side. A curvature at the best point misses that. A profile-likelihood interval does not: it is the set of values whose deviance
D = −2 ln(likelihood × prior) lies no more than a rise (`rise_of`) above its minimum, in as many disjoint pieces as there are.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, fdtri

from slippulse_jax.inference.likelihood import Problem
from slippulse_jax.inference.optimise import minimise
from slippulse_jax.inference.search import Cells, Root

NODES, NODES_ALONE = 61, 201  # of a profile over its whole range: where other parameters are fitted at each, and where not
STEPS_AROUND = np.array([0.1, 0.25, 0.5, 0.75, 1, 1.25, 1.6, 2, 2.5, 3, 4, 6])  # in standard errors of a root
STARTS_KEPT = 4  # per node
EXCLUDED = 100.0  # expected deviance above the least, above which a node is left out
CONTENDING = 3.0  # expected deviance above that of the best start, within which a node gets a second start
STEPS = 25  # of a minimisation at a node
AT_NODES = 1e-7  # Newton decrement at which it ends
CROSSING_ROUNDS = 14
CROSSED = 1e-5  # distance of the deviance from a limit at which an end is found: 10⁻⁵ of the interval


class Interval(NamedTuple):
    """One piece of a profile-likelihood interval; on an open side it reaches the end of the range searched."""

    low: float
    high: float
    open_low: bool
    open_high: bool

    def encloses(self, value: float) -> bool:
        """Whether it is closed, and the value lies inside."""
        return self.low < value < self.high and not (self.open_low or self.open_high)


Intervals = dict[float, list[Interval]]
"""The pieces of an interval, in increasing order, by confidence level."""


def pieces_of(ends: list[float], open_low: bool, open_high: bool) -> list[Interval]:
    """Pair ends in increasing order to intervals; the first and last end may be those of the range searched."""
    pairs = list(zip(ends[::2], ends[1::2], strict=True))
    return [Interval(a, b, open_low and i == 0, open_high and i == len(pairs) - 1) for i, (a, b) in enumerate(pairs)]


def rise_of(level: float, parameters: int = 1, dof: float | None = None) -> float:
    """Rise of the deviance at the ends of an interval: 1 at 68.27 % and 3.84 at 95 % for one parameter and known σ.

    With known σ that is the quantile of χ² with one degree of freedom for each parameter followed. Where the size of the
    errors is itself estimated, with `dof` degrees of freedom, it is larger, by the F distribution: exactly so for a
    straight-line model.
    """
    if dof is None:
        return float(chdtri(parameters, 1 - level))
    return parameters * float(fdtri(parameters, dof, level))


class Curve(NamedTuple):
    """A profile: nodes in increasing order, the deviance at each, and the best θ there."""

    node: np.ndarray  # (g,), θ of the parameter followed
    deviance: np.ndarray  # (g,)
    theta: np.ndarray  # (g, p)


def constrained(problem: Problem, held: np.ndarray, nodes: np.ndarray, starts: np.ndarray) -> Curve:
    """Least deviance at every node with the `held` coordinates fixed there; the best of all starts.

    Parameters
    ----------
    held : array of bool, shape (p,)
    nodes : array, shape (g, number held)
    starts : array, shape (s, p) or (g, s, p)
        Values of the other coordinates to start from.
    """
    starts = np.broadcast_to(starts, (len(nodes), *starts.shape[-2:])).copy()
    starts[:, :, held] = nodes[:, None, :]
    count, many, p = starts.shape
    holding = dataclasses.replace(problem, held=held)
    box = problem.parameters.low, problem.parameters.high
    found = minimise(holding, starts.reshape(-1, p), *box, held=held, max_steps=STEPS, tolerance=AT_NODES)
    value = found.value.reshape(count, many)
    best = value.argmin(axis=1)
    rows = np.arange(count)
    return Curve(nodes[:, 0], 2 * value[rows, best], found.theta.reshape(count, many, p)[rows, best])


def profile(problem: Problem, j: int, roots: list[Root], seeds: np.ndarray, cells: Cells | None = None) -> Curve:
    """Profile of parameter j over its whole range, or where a scan has left it, with nodes crowded around every root.

    Parameters
    ----------
    roots : list of Root
    seeds : array, shape (s, p)
        Other good points to start from.
    cells : Cells, optional
        Of a scan: the values that are not excluded.
    """
    low, high = problem.parameters.low[j], problem.parameters.high[j]
    alone = problem.p == 1
    scanned = cells is not None and cells.complete and len(cells.low) > 0 and not alone
    if cells is not None and scanned:
        # everything outside the cells is excluded
        low, high = cells.low[:, j].min(), cells.high[:, j].max()
    around = [np.linspace(low, high, NODES_ALONE if alone else NODES), [root.theta[j] for root in roots]]
    for root in roots:
        step = min(np.sqrt(root.covariance[j, j]), (high - low) / 8)
        around += [root.theta[j] - STEPS_AROUND * step, root.theta[j] + STEPS_AROUND * step]
    if cells is not None and len(cells.low):
        around += [_spread(cells, j, 2 * len(cells.low) if alone else NODES)]
    node = np.unique(np.concatenate(around))
    node = node[(node >= low) & (node <= high)]
    held = np.arange(problem.p) == j
    if alone:
        return constrained(problem, held, node[:, None], seeds)
    if cells is not None and scanned:
        node, starts = _of_cells(node, j, cells, problem.p)
        return constrained(problem, held, node[:, None], starts)
    starts = _predicted(node, j, roots, seeds, problem)
    starts[:, :, j] = node[:, None]
    value = problem(starts.reshape(-1, problem.p)).value.reshape(starts.shape[:2])
    best = np.argsort(value, axis=1, kind="stable")[:, :STARTS_KEPT, None]
    curve = constrained(problem, held, node[:, None], np.take_along_axis(starts, best, axis=1))
    return _from_neighbours(problem, held, curve)


def _spread(cells: Cells, j: int, count: int) -> np.ndarray:
    """Limits of the cells along parameter j, thinned out evenly to `count`."""
    limits = np.unique(np.concatenate([cells.low[:, j], cells.high[:, j]]))
    return limits[np.unique(np.linspace(0, len(limits) - 1, min(len(limits), count)).round().astype(int))]


def _of_cells(node: np.ndarray, j: int, cells: Cells, p: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts at each node, (g, 2, p), by the linear models of the cells there, or of the nearest ones.

    Nodes that these models exclude are dropped, except next to others.
    """
    away = np.maximum(np.maximum(cells.low[:, j] - node[:, None], node[:, None] - cells.high[:, j]), 0)
    row, cell = np.nonzero(away == away.min(axis=1, keepdims=True))
    at = np.zeros((len(row), p))
    at[:, j] = node[row]
    value, point = cells.expected(np.arange(p) == j, at, cell)
    order = np.lexsort((value, row))
    first = np.searchsorted(row[order], np.arange(len(node)))
    second = np.minimum(first + 1, len(order) - 1)
    best = value[order[first]]
    contending = (row[order[second]] == row[order[first]]) & (value[order[second]] < best + CONTENDING)
    starts = np.stack([point[order[first]], point[order[np.where(contending, second, first)]]], axis=1)
    near = best < best.min() + EXCLUDED
    kept = near | np.append(near[1:], False) | np.append(False, near[:-1])
    return node[kept], starts[kept]


def _predicted(node: np.ndarray, j: int, roots: list[Root], seeds: np.ndarray, problem: Problem) -> np.ndarray:
    """Starts at each node, (g, s, p): every root moved along its ridge, and the other points."""
    starts = [np.broadcast_to(seed, (len(node), problem.p)) for seed in seeds]
    for root in roots:
        moved = (node - root.theta[j])[:, None] * root.covariance[:, j] / root.covariance[j, j]
        starts.append(root.theta + moved)
    return np.clip(np.stack(starts, axis=1), problem.parameters.low, problem.parameters.high)


def _from_neighbours(problem: Problem, held: np.ndarray, curve: Curve) -> Curve:
    """Minimise again at each node from the results of its neighbours, until nothing improves."""
    for _ in range(3):
        before, after = np.roll(curve.theta, 1, axis=0), np.roll(curve.theta, -1, axis=0)
        again = constrained(problem, held, curve.theta[:, held], np.stack([before, after], axis=1))
        better = again.deviance < curve.deviance - 1e-6
        if not better.any():
            break
        theta = np.where(better[:, None], again.theta, curve.theta)
        curve = Curve(curve.node, np.where(better, again.deviance, curve.deviance), theta)
    return curve


def allowed(problem: Problem, j: int, curve: Curve, limits: dict[float, float]) -> Intervals:
    """Intervals of θ_j with a deviance below each limit, in increasing order.

    Parameters
    ----------
    limits : dict
        Deviance allowed, by confidence level.
    """
    found = {}
    brackets = []
    for level, limit in limits.items():
        inside = curve.deviance <= limit
        changes = np.nonzero(inside[1:] != inside[:-1])[0]
        found[level] = inside, len(changes)
        brackets += [(i, limit) for i in changes]
    ends = _crossings(problem, j, curve, brackets)
    result, used = {}, 0
    for level, (inside, count) in found.items():
        own = list(ends[used : used + count])
        used += count
        open_low, open_high = bool(inside[0]), bool(inside[-1])
        own = [float(curve.node[0])] * open_low + own + [float(curve.node[-1])] * open_high
        result[level] = pieces_of(own, open_low, open_high)
    return result


def _crossings(problem: Problem, j: int, curve: Curve, brackets: list[tuple[int, float]]) -> list[float]:
    """Find where the profile crosses each limit between node i and the next, all at once, by false position (Illinois)."""
    if not brackets:
        return []
    index = np.array([i for i, _ in brackets])
    limit = np.array([x for _, x in brackets])
    held = np.arange(problem.p) == j
    left, right = curve.node[index], curve.node[index + 1]
    f_left, f_right = (np.minimum(curve.deviance[index + k] - limit, 1e6) for k in (0, 1))
    near = np.stack([curve.theta[index], curve.theta[index + 1]], axis=1)
    w_left, w_right, last = f_left.copy(), f_right.copy(), np.zeros(len(index))
    at = left
    for round_ in range(CROSSING_ROUNDS):
        share = np.clip(w_left / (w_left - w_right), 1e-3, 1 - 1e-3)
        # a wall next to a floor (counts without blur) defeats false position, so every third step halves
        share = 0.5 if round_ % 3 == 2 else share
        at = left + share * (right - left)
        here = constrained(problem, held, at[:, None], near)
        value = here.deviance - limit
        on_left = np.sign(value) == np.sign(f_left)
        left, right = np.where(on_left, at, left), np.where(on_left, right, at)
        w_right = np.where(on_left & (last == 1), w_right / 2, np.where(on_left, w_right, value))
        w_left = np.where(~on_left & (last == -1), w_left / 2, np.where(on_left, value, w_left))
        last = np.where(on_left, 1, -1)
        near = np.where(on_left[:, None, None], np.stack([here.theta, near[:, 1]], 1), np.stack([near[:, 0], here.theta], 1))
        if (np.abs(value) < CROSSED).all():
            break
    return [float(x) for x in at]


class Surface(NamedTuple):
    """A profile in two parameters."""

    first: np.ndarray  # (a,), θ
    second: np.ndarray  # (b,)
    deviance: np.ndarray  # (a, b)


def profile_2d(problem: Problem, i: int, j: int, first: np.ndarray, second: np.ndarray, starts: np.ndarray) -> Surface:
    """Least deviance at every pair of values of parameters i and j; `starts` (s, p) are points to begin from."""
    held = np.isin(np.arange(problem.p), (i, j))
    a, b = np.meshgrid(first, second, indexing="ij")
    nodes = np.stack([a.ravel(), b.ravel()] if i < j else [b.ravel(), a.ravel()], axis=1)
    curve = constrained(problem, held, nodes, starts)
    return Surface(first, second, curve.deviance.reshape(a.shape))
