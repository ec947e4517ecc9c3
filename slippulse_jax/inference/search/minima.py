"""Search for every minimum of the deviance not excluded by data.

With up to `SCANNED` fitted parameters the deviance is computed on a grid over the whole range, and every local minimum of the
grid starts a minimisation; with more, the best of `SAMPLES` points of a Sobol sequence do. Nothing is proved by either: a
valley narrower than the grid is found if a start descends into it, or by the profiles (`fit._explore`).
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.parameters import STIFFNESSES, ParameterSet
from slippulse_jax.inference.search.likelihood import EXPECTED, Problem, costs
from slippulse_jax.inference.search.minimise import Convergence, Method, descend, minimise

SCANNED = 3
"""Largest number of fitted parameters whose range is scanned by a grid."""
NODES = {1: 257, 2: 33, 3: 13}
"""Nodes of the grid along each parameter, by the number of parameters."""
SLACK = 16.0
"""Deviance above the least within which minima are reported: four standard errors."""
UNMEASURABLE = 1e-4
"""Relative scatter of the lengths below which it is not an error of measurement."""
SAMPLES = 512
"""Points of the Sobol sequence; the best of them become starts."""
STARTS = 32
CLOSER = 1, 1, 64, 64**2
"""By which factors the grids along a parameter, on which a start is sought, are closer."""
BETWEEN = 0.5
"""Error of a length by interpolation, in σ, above which the fit allows for it."""


class DevianceGrid(NamedTuple):
    """Deviance on a grid, of one axis or several."""

    theta: np.ndarray  # (g_1, …, g_p, p)
    deviance: np.ndarray  # (g_1, …, g_p); inf where a front that was measured never stops

    def lows(self, axes: Iterable[int] = (0,)) -> np.ndarray:
        """Mark nodes lower than their neighbours, of equal ones the first."""
        found = np.isfinite(self.deviance)
        for axis in axes:
            here, low = np.moveaxis(self.deviance, axis, 0), np.moveaxis(found, axis, 0)
            beyond = np.full_like(here[:1], np.inf)
            low &= (here < np.concatenate([beyond, here[:-1]])) & (here <= np.concatenate([here[1:], beyond]))
        return found

    def starts(self) -> np.ndarray:
        """Middle of the lowest floor, then the lowest 64 minima; (s, p)."""
        low = self.lows(range(self.deviance.ndim))
        if not low.any():
            return self.theta[low]
        floor = self.theta[self.deviance == self.deviance.min()]
        span = np.ptp(self.theta.reshape(-1, self.deviance.ndim), axis=0)
        middle = np.square((floor - floor.mean(axis=0)) / span).sum(axis=1).argmin()
        ranked = np.argsort(self.deviance[low], kind="stable")[:64]
        return np.concatenate([floor[[middle]], self.theta[low][ranked]])

    def beside(self, j: int, at: np.ndarray, count: int) -> np.ndarray:
        """Lowest minima over the others next to θ_j; (len(at), count, p)."""
        p = self.theta.shape[-1]
        value = np.where(self.lows(axis for axis in range(p) if axis != j), self.deviance, np.inf)
        value, theta = np.moveaxis(value, j, 0), np.moveaxis(self.theta, j, 0)
        value, theta = value.reshape(len(value), -1), theta.reshape(len(value), -1, p)
        best = np.argsort(value, axis=1, kind="stable")[:, :count, None]
        nearest = np.abs(theta[:, 0, j, None] - at).argmin(axis=0)
        return np.take_along_axis(theta, best, axis=1)[nearest]


@dataclasses.dataclass(frozen=True, eq=False)
class Root:
    """A minimum of the deviance D = −2 ln(likelihood × prior)."""

    parameters: ParameterSet = dataclasses.field(metadata={"written": False})
    theta: np.ndarray  # (p,)
    deviance: float
    covariance: np.ndarray  # of θ, (p, p): the inverse Fisher information
    singular: np.ndarray  # parameters it does not constrain: their variance is that of the range searched
    share: float  # least share that the response of the model makes up of the second derivative of D; 1 at a good root

    @property
    def values(self) -> dict[str, float]:
        """Values of the requested parameters."""
        return self.parameters.values(self.theta)

    @property
    def stderrs(self) -> dict[str, float | None]:
        """Their standard errors, from the information here; None where there is none."""
        values, q = self.values, self.parameters
        errors: dict[str, float | None] = dict.fromkeys(values)
        for j, one in enumerate(q.free):
            spread = float(np.sqrt(self.covariance[j, j]))
            if not (one.nuisance or self.singular[j]) and spread <= one.high - one.low:
                errors[one.label] = spread * (values[one.label] if one.log else 1.0)
        return errors

    @functools.cached_property
    def inputs(self) -> Inputs:
        """Inputs of the model for each measurement, (n,)."""
        return self.parameters.inputs.at(self.theta)

    @property
    def ratio(self) -> np.ndarray:
        """k/K of each measurement, shape (n,)."""
        return self.inputs.ratio

    @functools.cached_property
    def rebreaks(self) -> bool:
        """Whether the edge contact breaks again before some front stops."""
        return bool(self.parameters.front.breaks_again(self.inputs).any())


FEW_STARTS = 6
"""Starts of a search on draws, whose deviance is a little rough."""


class Curve(NamedTuple):
    """A profile: increasing nodes, with deviance and best θ at each."""

    node: np.ndarray  # (g,), θ of the parameter followed
    deviance: np.ndarray  # (g,)
    theta: np.ndarray  # (g, p)


class Found(NamedTuple):
    """What a search found, and what follows from it."""

    minima: list[Root]  # within `SLACK` of the least deviance, best first
    theta: np.ndarray  # (p,), of the least deviance met, at a minimum or not
    deviance: float
    unconverged: list[tuple[float, str]]  # deviance and message of the starts that did not converge
    grid: DevianceGrid | None  # where one was searched
    curves: dict[int, Curve] = {}  # profiles of the requested parameters, where they were followed
    scatter: float | None = None  # factor on the stated σ, or on 1 λc, by which they match the scatter about the fit
    scatter_dof: float | None = None  # degrees of freedom left over by that
    closest: float | None = None  # relative distance of the lengths from the fit, where it is too small to be scatter
    roots: tuple[Root, ...] = ()  # minima not excluded at 95 %
    testable_dof: int | None = None  # degrees of freedom where χ² tests the model
    attainable: np.ndarray = np.empty(0)  # longest length of each measurement at any stiffness searched, in λc
    covered: dict[int, tuple[float, float]] = {}  # shares of simulated estimates within 1 and 1.96 standard errors


def search(problem: Problem, *, method: Method, max_steps: int, seed: int, extra: np.ndarray | None = None) -> Found:
    """Find the minima within `SLACK` of the least, best first.

    `method` and `max_steps` are those of `minimise`, `seed` is that of the starts with more than `SCANNED` parameters. With
    `extra`, (s, p), the search starts there and nowhere else.
    """
    grid = grid_of(problem) if extra is None else None
    starts = _starts(problem, grid, seed) if extra is None else extra
    starts = starts[:FEW_STARTS] if problem.parameters.front.drawn else starts  # small lows are of the draws
    ends = descend(problem, starts, method=method, max_steps=max_steps)
    near = ends.value <= ends.value.min() + SLACK / 2
    good = np.isin(ends.convergence, (Convergence.CONVERGED, Convergence.FLAT)) & np.isfinite(ends.value) & near
    order = np.nonzero(good)[0][np.argsort(ends.value[good], kind="stable")]
    minima = distinct(problem, ends.theta[order], 2 * ends.value[order], ends.convergence[order] == Convergence.FLAT)
    unconverged = [
        (2 * float(value), Convergence(int(how)).message)
        for value, how in zip(ends.value, ends.convergence, strict=True)
        if how == Convergence.NOT_CONVERGED
    ]
    least = int(np.argmin(ends.value))
    return Found(minima, ends.theta[least], 2 * float(ends.value[least]), unconverged, grid)


def ordered(problem: Problem, roots: Sequence[Root]) -> list[Root]:
    """Sort minima by deviance, last those that contradict the model.

    It does where a contact breaks again before the front stops. Of minima equal to rounding the softest comes first, so that
    specimens do not differ by chance.
    """

    def by_deviance(some: list[Root]) -> list[Root]:
        least = min((root.deviance for root in some), default=0.0)
        near = 1e-6 * max(1.0, abs(least))
        return sorted(some, key=lambda root: (max(root.deviance - least - near, 0.0), root.theta.sum()))

    sound = [root for root in roots if len(roots) > 1 and not root.rebreaks]
    most = min((root.deviance for root in roots), default=0.0) + SLACK
    if not any(problem.accepts(root.theta, root.deviance, most) for root in sound):
        return by_deviance(list(roots))
    return by_deviance(sound) + by_deviance([root for root in roots if root not in sound])


def between_contacts(problem: Problem, seed: int) -> np.ndarray | None:
    """Typical error of every length by its definition, or by interpolation.

    In λc; 0 for counts, unless lengths are interpolated. None where all are small compared with σ.
    """
    q = problem.parameters
    if problem.emulates or not q.front.most_off:
        return None
    concerned = problem.by_row(lambda data: np.full(len(data.rows), data.observable.is_value)) > 0
    concerned, sigma = concerned | q.front.interpolated, problem.by_row(lambda data: data.sigma)
    scale, _ = q.of_lengths
    widest = q.front.most_off * np.exp(scale(np.stack([q.low, q.high])).max(axis=0))
    if not (concerned & (widest > BETWEEN * sigma)).any():
        return None
    theta = first_look(problem, seed)
    off = q.front.uncertainty(q.inputs.at(theta))
    if off is None:
        return None
    off = np.where(concerned, off * np.exp(scale(theta)), 0.0)
    return off if (off > BETWEEN * sigma).any() else None


def first_look(problem: Problem, seed: int) -> np.ndarray:
    """Find a point of low deviance; shape (p,)."""
    q = problem.parameters
    starts = _starts(problem, grid_of(problem), seed)[: STARTS // 4]
    ends = minimise(problem, starts, q.low, q.high, max_steps=20)
    return ends.theta[np.argmin(ends.value)]


def scaled_to_scatter(problem: Problem, theta: np.ndarray, *, of_lengths: bool) -> tuple[Problem, Found]:
    """Scale σ to the scatter about the fit nearest to θ.

    Where only the ratios of σ are known. The deviance of the data is then what it should be, on average, of as many of them as
    the fit does not use up. Errors of inputs keep the size that is stated for them: a parameter that its prior determines uses
    up none of the data.

    The problem has the σ stated, and is returned with σ of that size, those of all data or `of_lengths` alone; with the fit.
    """
    q, factor, turns = problem.parameters, 1.0, 0
    widest = float(np.max(problem.by_row(lambda data: data.sigma / data.value[0])))
    while True:
        sized = problem.with_sigma(factor, of_lengths=of_lengths)
        end = minimise(sized, theta[None], q.low, q.high)
        theta = end.theta[0]
        found = Found([], theta, 2 * float(end.value[0]), [], None)
        deviance, dof = _left_over(sized, theta, of_lengths)
        change = np.sqrt(deviance / dof / EXPECTED[problem.loss]) if dof > 1e-6 else 0.0
        turns += 1
        # a front that never stops has no fit
        if not np.isfinite(deviance) or abs(change - 1) < 1e-10 or turns == 100:
            return sized, found._replace(scatter=factor, scatter_dof=dof)
        if factor * change * widest < UNMEASURABLE:
            least = UNMEASURABLE / widest
            sized = problem.with_sigma(least, of_lengths=of_lengths)
            total = 2 * float(minimise(sized, theta[None], q.low, q.high).value[0])
            found = found._replace(deviance=total, scatter=least, scatter_dof=dof)
            return sized, found._replace(closest=factor * change * widest)
        factor *= float(change)


def _left_over(problem: Problem, theta: np.ndarray, of_lengths: bool) -> tuple[float, float]:
    """Deviance and degrees of freedom of data whose σ are scaled."""
    scaled, deviance = problem.of_rows if of_lengths else problem.observed, 0.0
    for data in scaled:
        deviance += 2 * float(costs(problem.predicted(theta, data), data, np.zeros(1, int))[0].sum())
    jacobian = problem.jacobian(theta) * (problem.parameters.high - problem.parameters.low)
    own = jacobian[: sum(len(data.rows) for data in scaled)]  # what the rows are about comes first, priors last
    used = np.trace(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12, hermitian=True) @ (own.T @ own))
    return deviance, len(own) - float(used)


def grid_of(problem: Problem) -> DevianceGrid | None:
    """Compute the deviance on a grid; None beyond `SCANNED` parameters."""
    if problem.p > SCANNED:
        return None
    theta = np.stack(np.meshgrid(*first_edges(problem), indexing="ij"), axis=-1)
    value = problem(theta.reshape(-1, problem.p)).value
    return DevianceGrid(theta, 2 * value.reshape(theta.shape[:-1]))


def first_edges(problem: Problem) -> list[np.ndarray]:
    """Nodes of the grid along each parameter.

    A single parameter is divided closely around the peak of every length: two roots on its two sides may lie closer together
    than any fixed spacing.
    """
    q, p = problem.parameters, problem.p
    edges = [np.linspace(low, high, NODES[p]) for low, high in zip(q.low, q.high, strict=True)]
    if p > 1:
        middle = np.where(problem.prior_weight > 0, problem.prior_mean[0], (q.low + q.high) / 2)
        return [np.unique(np.concatenate([edge, _counted(problem, j, middle)])) for j, edge in enumerate(edges)]
    if p == 1:
        offsets = np.concatenate([[0.0], np.geomspace(1e-6, 0.1, 24)])
        near = [top + side * offsets for top in _tops(problem) for side in (-1, 1)]
        near.append(_counted(problem, 0, q.low, (1.0, 0.0)))
        near.append((near[-1][1:] + near[-1][:-1]) / 2)  # between ends of counts, where some hold together
        every = np.unique(np.concatenate([edges[0], *near]))
        edges = [every[(every >= q.low[0]) & (every <= q.high[0])]]
    return edges


def _counted(problem: Problem, j: int, at: np.ndarray, below: Sequence[float] = (0.5,)) -> np.ndarray:
    """Values of θ_j amid counts, or so far below them.

    A count may hold in a range narrower than the grid's.
    """
    q, found = problem.parameters, [np.empty(0)]
    theta = np.tile(at, (NODES[1], 1))
    theta[:, j] = np.linspace(q.low[j], q.high[j], NODES[1])
    for data in (data for data in problem.observed if data.observable.counts):
        length = problem.predicted(theta, data)
        for off in (length - data.value[0] + by for by in below):
            node, which = np.nonzero((off[1:] >= 0) != (off[:-1] >= 0))
            with np.errstate(invalid="ignore"):
                share = off[node, which] / (off[node, which] - off[node + 1, which])
            share = np.where(np.isfinite(share), share, 0.5)
            found.append(theta[node, j] + share * (theta[node + 1, j] - theta[node, j]))
    return np.sort(np.concatenate(found))


def _starts(problem: Problem, grid: DevianceGrid | None, seed: int) -> np.ndarray:
    """Choose where to start, (s, p); else the middle of the range."""
    found = _sampled(problem, seed) if grid is None else grid.starts()
    return found if len(found) else (problem.parameters.low + problem.parameters.high)[None] / 2


def lowest_look(problem: Problem) -> np.ndarray:
    """Point of least deviance on grids, ever closer along each parameter."""
    q, points = problem.parameters, _starts(problem, grid_of(problem), 0)
    if len(problem.points.theta):
        points = np.concatenate([points, problem.points.theta])
    if problem.prior_weight.any():
        points = np.concatenate([points, _sampled(problem, 0)])
    best = points[np.argmin(problem(points).value)]
    for closer, j in itertools.product(CLOSER, [j for j, one in enumerate(q.free) if not one.nuisance]):
        near = best[j] + (q.high[j] - q.low[j]) / closer * np.linspace(-1, 1, NODES[1])
        nodes = np.concatenate([best[[j]], np.clip(near, q.low[j], q.high[j]), _counted(problem, j, best)])
        points = np.where(np.arange(problem.p) == j, nodes[:, None], best)
        best = points[np.argmin(problem(points).value)]
    return best


def _sampled(problem: Problem, seed: int) -> np.ndarray:
    from scipy.stats import qmc  # half a second to import, and most fits are of one parameter

    low, high = problem.parameters.low, problem.parameters.high
    sample = qmc.scale(qmc.Sobol(problem.p, rng=np.random.default_rng(seed)).random(SAMPLES), low, high)
    known = problem.prior_weight > 0
    centre = problem.prior_mean[0]
    # parameters with a prior start where it is: the search is over what is not known beforehand
    sample[:, known] = np.clip(centre[known], low[known], high[known])
    value = problem(sample).value
    ranked = np.argsort(value, kind="stable")
    ranked = ranked[np.isfinite(value[ranked])]
    # half are the lowest, half are spread over the rest, so that a second basin is not missed
    spread = ranked[STARTS // 2 :: max(1, (len(ranked) - STARTS // 2) // (STARTS // 2))][: STARTS // 2]
    return sample[np.concatenate([ranked[: STARTS // 2], spread])]


def _tops(problem: Problem) -> np.ndarray:
    """θ at which each of a few lengths is longest.

    With more, each with its own peak, no single length makes a pair of roots.
    """
    q = problem.parameters
    first = [data.measurement[np.unique(data.rows, return_index=True)[1]] for data in problem.of_rows]
    if sum(map(len, first)) > 24 or q.free[0].name not in STIFFNESSES:
        return np.empty(0)
    theta, inputs = q.low, q.inputs.take(np.concatenate(first))
    _, ratio = q.longest(theta, inputs)
    return np.unique(np.log(ratio) - inputs.log_stiffness(theta) + theta[0])


def distinct(problem: Problem, theta: np.ndarray, deviance: np.ndarray, flat: np.ndarray) -> list[Root]:
    """Keep each minimum once, and of a flat floor its first point."""
    kept: list[Root] = []
    for point, value, is_flat in zip(theta, deviance, flat, strict=True):
        if is_flat and not problem.predict(point).any():
            continue  # where no domino starts nothing responds either, and nothing was found
        if any(same(point, float(value), one, problem) for one in kept):
            continue
        kept.append(describe(problem, point, float(value)))
    return kept


def same(point: np.ndarray, deviance: float, one: Root, problem: Problem) -> bool:
    """Whether a point is this minimum, or lies in the same valley.

    For lengths along one parameter: unless the deviance rises between them. Otherwise: to a fiftieth of the standard errors.
    """
    if abs(deviance - one.deviance) > 1e-3:
        return False
    if problem.p == 1 and not problem.steps:
        between = 2 * float(problem((point + one.theta)[None] / 2).value[0])
        higher = max(deviance, one.deviance)
        return between <= higher + 1e-9 * max(1, abs(higher))  # far above rounding
    off = point - one.theta
    if np.all(np.abs(off) <= 1e-4 * (problem.parameters.high - problem.parameters.low)):
        return True
    along = np.sqrt(np.diag(one.covariance))
    return bool(one.singular.any() or np.all(np.abs(off) <= 0.02 * along))


def describe(problem: Problem, theta: np.ndarray, deviance: float) -> Root:
    """Covariance and share of the response at a minimum."""
    at, jacobian = problem(theta[None], order=2), problem.jacobian(theta)
    information = jacobian.T @ jacobian
    reach = problem.parameters.high - problem.parameters.low
    singular = undetermined_axes(information * np.outer(reach, reach))
    # a prior as wide as the range searched makes the inverse exist without changing what the data determine
    vague = information + np.diag(1.0 / reach**2) * bool(singular.any())
    return Root(problem.parameters, theta, deviance, np.linalg.inv(vague), singular, _share(at.metric[0], at.curvature[0]))


def _share(metric: np.ndarray, curvature: np.ndarray) -> float:
    """Least share of the metric in the second derivative, along any direction."""
    unit = np.sqrt(np.maximum(np.maximum(np.abs(np.diag(curvature)), np.diag(metric)), 1e-300))
    values, vectors = np.linalg.eigh(curvature / np.outer(unit, unit))
    curved = values > 1e-8
    whitened = vectors[:, curved] / np.sqrt(values[curved])
    share = np.linalg.eigvalsh(whitened.T @ (metric / np.outer(unit, unit)) @ whitened)
    return float(share[0]) if len(share) else 1.0


def undetermined_axes(information: np.ndarray) -> np.ndarray:
    """Mark parameters of a direction that the information leaves open; (p,).

    `information` is that of each parameter in units of the range searched for it: a standard error of a million such ranges
    is rounding as well.
    """
    unit = np.sqrt(np.diag(information))
    empty = unit < 1e-6
    unit = np.where(empty, 1, unit)
    values, vectors = np.linalg.eigh(information / np.outer(unit, unit))
    return empty | (np.abs(vectors[:, values < 1e-10]) > 1e-3).any(axis=1)
