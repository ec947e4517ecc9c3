"""Intervals of a parameter: by profile likelihood, or by simulation.

The length rises with stiffness, peaks and falls again, so that the likelihood can have two maxima, a broad top, or an open
side. A curvature at the best point misses that. A profile-likelihood interval does not: it is the set of values whose
deviance D = −2 ln(likelihood × prior), minimised over the other parameters, lies no more than a rise (`rise_of`) above its
minimum, in as many disjoint pieces as there are.

Near the longest attainable length, and where two valleys compete, the rise of the deviance at the true value is not
distributed as χ². Feldman and Cousins (Phys. Rev. D 57, 3873, 1998) take the distribution that it does have: at each value
measurements are drawn, each is fitted, and the quantile of the rise replaces that of χ² (`calibrated`), where one parameter is
fitted. Every such fit is a search of one table of predictions, in units of σ; a prior is a datum like any other.
"""

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import chdtri, fdtri, logsumexp
from scipy.stats import skew

from slippulse_jax.inference.choices import IntervalsBy
from slippulse_jax.inference.search.learning import about, followed, single, spreads
from slippulse_jax.inference.search.likelihood import SIMULATED, Problem
from slippulse_jax.inference.search.minima import SLACK, Curve, DevianceGrid, Found, Root
from slippulse_jax.inference.search.minimise import minimise

LEVELS = (0.6827, 0.95)
"""Confidence levels of intervals."""
NODES = 61  # of a profile of one of several parameters, over its whole range
STEPS_AROUND = np.array([0.1, 0.25, 0.5, 0.75, 1, 1.25, 1.6, 2, 2.5, 3, 4, 6])  # in standard errors of a root
STARTS_KEPT = 2  # per node, and of the low points of a grid
EXCLUDED = 100.0  # expected deviance above the least, above which a node is left out, or not minimised to the end
CROSSED = 1e-5  # distance of the root of the rise from that of a limit at which an end is found: 10⁻⁵ of the interval
LARGEST = 1e12  # rise that a crossing is sought with; a measured length whose event does not stop has none
SIMULATIONS = 2000
RESOLUTION = 0.15
"""Spacing of the table of predictions, in standard errors of all measurements together."""
MOST_NODES, MOST_VALUES = 2000, 60
ONE_THREAD = 4 * 2**16
"""Multiplications up to which OpenBLAS uses one thread: larger products, split over two, took ten times as long."""
STRAIGHT = 1.15
"""Ratio of a profile's limit at the highest level to that of a parabola from which on intervals are simulated."""
HOPELESS = 25.0  # rise of D above which a value is excluded at any calibration
INTEGRATED, FINER, TINY = 48, 1000, 1e-15  # nodes of a curve that is integrated over the scatter, and of its spline; rounding
FEW_STEPS, FRESH = 5, 64
"""Steps in which a table is fitted from where it was drawn; and series that are followed to draw tables of sequences."""
NARROWEST = 1e-10  # part of the range of a parameter that is not divided
SLIGHT = 1e-3  # difference of two deviances that is none


class Interval(NamedTuple):
    """One piece of an interval, open at ends of the range."""

    low: float
    high: float
    open_low: bool
    open_high: bool

    def encloses(self, value: float) -> bool:
        """Whether it is closed, and the value lies inside."""
        return self.low < value < self.high and not (self.open_low or self.open_high)


Intervals = dict[float, list[Interval]]
"""The pieces of an interval, in increasing order, by confidence level."""


def pieces_of(node: np.ndarray, inside: np.ndarray, crossings: list[float]) -> list[Interval]:
    """Pair crossings in increasing order to intervals.

    With the ends of the range searched, the first and last of `node`, where these lie inside.
    """
    open_low, open_high = bool(inside[0]), bool(inside[-1])
    every = [float(node[0])] * open_low + crossings + [float(node[-1])] * open_high
    pairs = list(zip(every[::2], every[1::2], strict=True))
    return [Interval(a, b, open_low and i == 0, open_high and i == len(pairs) - 1) for i, (a, b) in enumerate(pairs)]


def _changes(inside: np.ndarray) -> list[int]:
    """Nodes after which a curve goes in or out."""
    return np.nonzero(inside[1:] != inside[:-1])[0].tolist()


def rise_of(level: float, parameters: int = 1, dof: float | None = None) -> float:
    """Rise of the deviance at ends of intervals, or of regions."""
    if dof is None:
        return float(chdtri(parameters, 1 - level))
    return parameters * float(fdtri(parameters, dof, level))


def constrained(problem: Problem, held: np.ndarray, nodes: np.ndarray, starts: np.ndarray, *, enough: float = np.inf) -> Curve:
    """Least deviance at every node, with the `held` coordinates fixed there.

    `held` is of shape (p,), `nodes` (g, number held). The other coordinates start from `starts`, (s, p) or (g, s, p). Above
    `enough`, the deviance of a node need not be the least.
    """
    starts = np.broadcast_to(starts, (len(nodes), *starts.shape[-2:])).copy()
    starts[:, :, held] = nodes[:, None, :]
    count, many, p = starts.shape
    holding = dataclasses.replace(problem, held=held)
    box = problem.parameters.low, problem.parameters.high
    how = {"max_steps": 25, "tolerance": 1e-7, "enough": enough / 2}
    found = minimise(holding, starts.reshape(-1, p), *box, held=held, **how)
    value = found.value.reshape(count, many)
    best = value.argmin(axis=1)
    rows = np.arange(count)
    return Curve(nodes[:, 0], 2 * value[rows, best], found.theta.reshape(count, many, p)[rows, best])


def profile(problem: Problem, j: int, roots: list[Root], seeds: np.ndarray, grid: DevianceGrid | None = None) -> Curve:
    """Profile of parameter j, with nodes crowded around every root.

    `seeds`, (s, p), are other good points to start from. The `grid` of the search has the nodes, for a single parameter, and
    low points to start from, for several.
    """
    low, high = problem.parameters.low[j], problem.parameters.high[j]
    spread = np.linspace(low, high, NODES) if grid is None or problem.p > 1 else grid.theta[:, 0]
    around = [spread, [root.theta[j] for root in roots]]
    if grid is not None and problem.p > 1 and any(data.observable.counts for data in problem.observed):
        around.append(np.unique(grid.theta[..., j]))  # a count may hold between two others
    for root in roots:
        step = min(np.sqrt(root.covariance[j, j]), (high - low) / 8)
        around += [root.theta[j] - STEPS_AROUND * step, root.theta[j] + STEPS_AROUND * step]
    node = np.unique(np.concatenate(around))
    node = node[(node >= low) & (node <= high)]
    held = np.arange(problem.p) == j
    if problem.p == 1:
        return constrained(problem, held, node[:, None], seeds)
    starts = _predicted(node, j, roots, seeds, problem)
    if grid is not None:
        starts = np.concatenate([starts, grid.beside(j, node, STARTS_KEPT)], axis=1)
    starts[:, :, j] = node[:, None]
    value = problem(starts.reshape(-1, problem.p)).value.reshape(starts.shape[:2])
    best = np.argsort(value, axis=1, kind="stable")[:, :STARTS_KEPT, None]
    enough = min([2 * float(value.min()), *(root.deviance for root in roots)]) + EXCLUDED
    curve = constrained(problem, held, node[:, None], np.take_along_axis(starts, best, axis=1), enough=enough)
    return _from_neighbours(problem, held, curve, enough)


def _predicted(node: np.ndarray, j: int, roots: list[Root], seeds: np.ndarray, problem: Problem) -> np.ndarray:
    """Starts at each node, (g, s, p): roots along ridges, other points."""
    starts = [np.broadcast_to(seed, (len(node), problem.p)) for seed in seeds]
    for root in roots:
        moved = (node - root.theta[j])[:, None] * root.covariance[:, j] / root.covariance[j, j]
        starts.append(root.theta + moved)
    return np.clip(np.stack(starts, axis=1), problem.parameters.low, problem.parameters.high)


def _from_neighbours(problem: Problem, held: np.ndarray, curve: Curve, enough: float) -> Curve:
    """Minimise again from neighbouring nodes until no node that matters improves."""
    theta, deviance = curve.theta.copy(), curve.deviance.copy()
    look = np.arange(len(theta))
    while len(look):
        near = np.stack([theta[look - 1], theta[(look + 1) % len(theta)]], axis=1)
        again = constrained(problem, held, theta[look][:, held], near, enough=enough)
        better = again.deviance < np.minimum(deviance[look] - SLIGHT, enough)
        moved = look[better]
        theta[moved], deviance[moved] = again.theta[better], again.deviance[better]
        look = np.unique(np.concatenate([moved - 1, moved + 1]) % len(theta))
    return Curve(curve.node, deviance, theta)


def allowed(problem: Problem, j: int, curve: Curve, limits: dict[float, float]) -> Intervals:
    """Intervals of θ_j with a deviance below the limit of each level."""
    inside = {level: curve.deviance <= limit for level, limit in limits.items()}
    ends = iter(_crossings(problem, j, curve, [(i, limits[level]) for level, own in inside.items() for i in _changes(own)]))
    return {level: pieces_of(curve.node, own, [next(ends) for _ in _changes(own)]) for level, own in inside.items()}


def _crossings(problem: Problem, j: int, curve: Curve, brackets: list[tuple[int, float]]) -> list[float]:
    """Find where a profile crosses limits, by false position (Illinois).

    Each between node i and the next, all at once. Of the root of its rise, which is straight where the profile is a parabola,
    and on the wall beyond the edge of a count.
    """
    index = np.array([i for i, _ in brackets], dtype=int)
    limit, least = np.array([x for _, x in brackets]), curve.deviance.min()

    def above(deviance: np.ndarray, some: np.ndarray) -> np.ndarray:
        return np.sqrt(np.clip(deviance - least, 0, LARGEST)) - np.sqrt(limit[some] - least)

    held, work = np.arange(problem.p) == j, np.arange(len(index))
    ends, near = (np.stack([x[index], x[index + 1]], axis=1) for x in (curve.node, curve.theta))
    value = np.stack([above(curve.deviance[index + k], work) for k in (0, 1)], axis=1)
    at, rises, last = ends[:, 0].copy(), value[:, 1] > 0, np.full(len(index), -1)
    for round_ in range(60):
        if not len(work):
            break
        share = value[work, 0] / (value[work, 0] - value[work, 1])
        # a wall next to a floor defeats false position, so every third step halves
        share = 0.5 if round_ % 3 == 2 else np.clip(share, 1e-3, 1 - 1e-3)
        at[work] = ends[work, 0] + share * (ends[work, 1] - ends[work, 0])
        here = constrained(problem, held, at[work, None], near[work])
        found = above(here.deviance, work)
        side = ((found > 0) == rises[work]).astype(int)
        ends[work, side], near[work, side], value[work, side] = at[work], here.theta, found
        value[work, 1 - side] /= np.where(side == last[work], 2, 1)
        last[work] = side
        wide = ends[work, 1] - ends[work, 0] > NARROWEST * np.ptp(curve.node)
        work = work[(np.abs(found) > CROSSED) & wide]
    return at.tolist()


def profile_2d(problem: Problem, i: int, j: int, first: np.ndarray, second: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Least deviance at every pair (a, b), from `starts` (s, p)."""
    held = np.isin(np.arange(problem.p), (i, j))
    a, b = np.meshgrid(first, second, indexing="ij")
    nodes = np.stack([a.ravel(), b.ravel()] if i < j else [b.ravel(), a.ravel()], axis=1)
    curve = constrained(problem, held, nodes, starts)
    return curve.deviance.reshape(a.shape)


# --- integrated over the scatter of contacts ---------------------------------------------------------------------------


def integrated(problem: Problem, j: int, found: Found) -> Curve:
    """Deviance of θ_j, integrated over the scatter of contacts.

    That of the scatter over the first parameter; least over the others. A profile of draws is too narrow: the densest ensemble
    is not the likeliest scatter. Where the curve is not that of a normal distribution it is changed so that usual rises bound
    regions of the usual probability.
    """
    q = problem.parameters
    scatter = q.names.index("threshold_scatter")
    across = scatter if j != scatter else next(i for i in range(problem.p) if i != j)
    most = INTEGRATED if problem.p == 2 else INTEGRATED // 2  # of which each has a minimum to be found
    nodes = {i: np.linspace(*_reached(problem, i, found), count) for i, count in ((j, most), (across, most // 2))}
    first, second = nodes[j], nodes[across]
    starts = np.array([*(root.theta for root in found.minima[:STARTS_KEPT]), found.theta])
    held = np.isin(np.arange(problem.p), (j, across))
    pairs = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
    pairs = pairs if j < across else pairs[:, ::-1]
    curve = Curve(first, 2 * problem(pairs).value, pairs) if problem.p == 2 else constrained(problem, held, pairs, starts)
    deviance, theta = curve.deviance.reshape(len(first), -1), curve.theta.reshape(len(first), -1, problem.p)
    whole = -2 * np.asarray(logsumexp(-deviance / 2, axis=1))
    finer = np.linspace(first[0], first[-1], FINER)
    smooth = CubicSpline(first, np.minimum(whole - whole.min(), LARGEST))(finer)
    near = np.abs(first[:, None] - finer).argmin(axis=0)
    best = theta[np.arange(len(first)), deviance.argmin(axis=1)][near]
    best[:, j] = finer
    rise = np.maximum(smooth - smooth.min(), 0)
    # the rise of a normal curve that has as much above it; nowhere more than it is, where there is no end of the range in sight
    order, mass = np.argsort(rise, kind="stable"), np.exp(-rise / 2)
    within = np.empty_like(mass)
    within[order] = np.cumsum(mass[order]) / mass.sum()
    return Curve(finer, found.deviance + np.minimum(rise, chdtri(1, np.maximum(1 - within, TINY))), best)


def _reached(problem: Problem, i: int, found: Found) -> tuple[float, float]:
    """Range of θ_i that the data may mean."""
    q, grid = problem.parameters, found.grid
    if grid is None:
        every = [(root.theta[i], 6 * np.sqrt(root.covariance[i, i])) for root in found.minima]
        low, high = min((x - e for x, e in every), default=-np.inf), max((x + e for x, e in every), default=np.inf)
    else:
        node = np.unique(grid.theta[..., i])
        least = np.array([grid.deviance[grid.theta[..., i] == x].min() for x in node])
        some = np.flatnonzero(least < found.deviance + HOPELESS)
        low, high = node[max(some[0] - 1, 0)], node[min(some[-1] + 1, len(node) - 1)]
    return max(low, q.low[i]), min(high, q.high[i])


def crossed(curve: Curve, limits: dict[float, float]) -> Intervals:
    """Pieces of a fine curve below the limit of each level."""
    found = {}
    for level, limit in limits.items():
        inside, over = curve.deviance <= limit, curve.deviance - limit
        at = np.array(_changes(inside), dtype=int)
        ends = curve.node[at] + np.diff(curve.node)[at] * over[at] / (over[at] - over[at + 1])
        found[level] = pieces_of(curve.node, inside, ends.tolist())
    return found


def deviances(problem: Problem, theta: np.ndarray) -> tuple[float, ...] | None:
    """Skewness, mean and spread of deviances of tables drawn at θ.

    Each is fitted from there. None where some data are no values, their errors were taken from them, or no series near θ
    reaches all places.
    """
    if not problem.exact_values or not problem.known:
        return None
    random, at = np.random.default_rng(0), np.tile(theta, (SIMULATED, 1))
    every = [*(_of_draws if problem.drawn else _of_series)(problem, theta, random)]
    if not every:
        return None
    q, tables = problem.parameters, problem.with_tables(theta, every, random)
    deviance = 2 * minimise(tables, at, q.low, q.high, lane=np.arange(SIMULATED), max_steps=FEW_STEPS).value
    return float(skew(deviance)), float(deviance.mean()), float(deviance.std())


def _of_draws(problem: Problem, theta: np.ndarray, random: np.random.Generator) -> Iterator[np.ndarray]:
    """Draw tables of contacts that differ, (R, n) of each observable."""
    draws = problem.draws(theta)
    weight = {int(g): w for one in draws for g, w in zip(one.group, one.weight, strict=True)}
    shares = {g: np.cumsum(np.maximum(w[:-1], 0)) for g, w in weight.items()}  # of events that stop
    event = {g: np.searchsorted(share, random.random(SIMULATED) * share[-1]) for g, share in shares.items()}
    for data, one in zip(problem.learnt, draws, strict=True):
        shared = {g: random.standard_normal(SIMULATED) for g in event}  # by data of one event
        which, off = (np.stack([of[int(g)] for g in one.group], axis=1) for of in (event, shared))  # (R, n)
        row = np.arange(len(one.group))
        drawn = one.value[row, which] + one.width[row, which] * off
        yield drawn + data.sigma * random.standard_normal(drawn.shape)


def _of_series(problem: Problem, theta: np.ndarray, random: np.random.Generator) -> Iterator[np.ndarray]:
    """Draw tables of sequences, (R, n) of each observable.

    By how far fresh series near θ lie from the emulator, which is less than it allows: that is for the worst of its points.
    """
    near = about(problem, theta, FRESH)
    fresh = followed(problem, near)
    fresh = dataclasses.replace(fresh, points=fresh.points.take(np.arange(-FRESH, 0)))
    off = [found - problem.predicted(near, data) for found, data in zip(single(fresh)[1], problem.observed, strict=True)]
    whole = np.flatnonzero(np.all([np.isfinite(one).all(axis=1) for one in off], axis=0))  # which reach all places
    if not len(whole):
        return
    series = random.choice(whole, SIMULATED)
    for data, own, away in zip(problem.observed, spreads(fresh, theta), off, strict=True):
        error = np.hypot(data.sigma, own) * random.standard_normal((SIMULATED, len(data.rows)))
        yield problem.predicted(theta, data) + away[series] + error


# --- by simulation ----------------------------------------------------------------------------------------------------


def can_be_calibrated(problem: Problem) -> bool:
    """Whether one parameter is fitted to Gaussian values."""
    return problem.p == 1 and problem.simulable


def to_be_simulated(problem: Problem, wanted: IntervalsBy, found: Found, pieces: dict[int, Intervals]) -> bool:
    """Whether to simulate intervals: if wanted, or where χ² would mislead.

    By default it would where valleys compete, or one is not parabolic. `pieces` are the profile-likelihood intervals.
    """
    minima, deviance = found.minima, found.deviance
    if wanted == "calibrated":
        return True
    if wanted == "profile" or not can_be_calibrated(problem) or not minima:
        return False
    if any(one.deviance < deviance - SLIGHT for one in minima):  # simulated fits would prefer what stands last here
        return False
    if sum(one.deviance <= deviance + SLACK for one in minima) > 1:
        return True
    for j, own in pieces.items():
        level, last = max(own.items())
        if not last or minima[0].singular[j]:
            return False
        reach = np.sqrt(chdtri(1, 1 - level) * minima[0].covariance[j, j])
        off = (found.theta[j] - last[0].low) / reach, (last[-1].high - found.theta[j]) / reach
        if max(off) > STRAIGHT or min(off) < 1 / STRAIGHT:
            return True
    return False


def calibrated(problem: Problem, seed: int) -> tuple[Intervals, tuple[float, float]]:
    """Simulate the intervals of the parameter.

    With the shares of estimates within 1 and 1.96 standard errors of its best value. At each of a number of values
    measurements are drawn, `SIMULATIONS` times, and fitted by a table of predictions.
    """
    node, off = _along(problem)
    deviance = (off**2).sum(axis=1)
    rise = deviance - deviance.min()
    candidates = np.nonzero(rise < HOPELESS)[0]
    places = np.linspace(0, len(candidates) - 1, MOST_VALUES).round().astype(int)
    chosen = np.unique(np.concatenate([candidates[places], [int(np.argmin(rise))]]))
    noise = np.random.default_rng(seed).standard_normal((SIMULATIONS, off.shape[1]), np.float32)
    found = [_refitted(off, int(one), noise) for one in chosen]
    critical = np.quantile(np.array([rises for rises, _ in found]), LEVELS, axis=1)
    intervals = {
        level: _below(node, rise - np.interp(node, node[chosen], own)) for level, own in zip(LEVELS, critical, strict=True)
    }
    best = int(np.argmin(rise))
    estimates = node[found[int(np.searchsorted(chosen, best))][1]]
    information = problem(node[chosen, None], order=1).metric[:, 0, 0]
    stderr = np.interp(estimates, node[chosen], 1 / np.sqrt(np.maximum(information, 1e-300)))
    away = np.abs(estimates - node[best]) / stderr
    return intervals, (float((away <= 1).mean()), float((away <= 1.96).mean()))


def _along(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Choose M values, evenly spaced in the predictions.

    With the predictions less what was measured, in σ, (M, n).
    """
    low, high = problem.parameters.low[0], problem.parameters.high[0]
    node = np.linspace(low, high, 801)
    for _ in range(2):
        steps = np.sqrt((np.diff(problem.residuals(node[:, None]), axis=0) ** 2).sum(axis=1))
        path = np.concatenate([[0], np.cumsum(steps)])
        count = int(np.clip(path[-1] / RESOLUTION, 400, MOST_NODES))
        # values stay apart where the predictions are constant too, so that an open side is seen
        path = path / max(path[-1], 1e-300) + 0.1 * (node - low) / (high - low)
        node = np.interp(np.linspace(0, path[-1], count), path, node)
    return node, problem.residuals(node[:, None])


def _refitted(off: np.ndarray, true: int, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rise of D at the truth, and best value, per simulation."""
    # single precision is enough: the table is far coarser
    away = (off - off[true]).clip(-1e6, 1e6).astype(np.float32)
    # |y − μ|² = |ε|² − 2 ε·off + |off|², and |ε|² is the same everywhere; one product, a simulation per row
    there = np.concatenate([-2 * away, np.einsum("gn,gn->g", away, away)[:, None]], axis=1).T
    drawn = np.concatenate([noise, np.ones_like(noise[:, :1])], axis=1)
    rise, least = np.empty(len(noise), np.float32), np.empty(len(noise), np.intp)
    rows = max(1, ONE_THREAD // there.size)
    for some in (slice(start, start + rows) for start in range(0, len(noise), rows)):
        deviance = drawn[some] @ there
        least[some] = deviance.argmin(axis=1)
        rise[some] = deviance[:, true] - deviance.min(axis=1)
    return rise, least


def _below(node: np.ndarray, excess: np.ndarray) -> list[Interval]:
    """Where `excess` is not positive, its ends by straight lines."""
    inside = excess <= 0
    step = np.diff(node)
    return pieces_of(
        node, inside, [float(node[i] + step[i] * excess[i] / (excess[i] - excess[i + 1])) for i in _changes(inside)]
    )
