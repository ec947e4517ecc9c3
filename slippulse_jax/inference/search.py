"""Search for every minimum of the deviance that the data do not exclude.

With up to `SCANNED` fitted parameters the whole range is scanned. It is divided into cells; the predictions at the corners of a
cell, widened by how far the centre is from their mean, bound the deviance in it from below; a cell whose bound lies too far
above the least deviance known is dropped, and the others are halved until the predictions in each are all but linear. In each
that is left the deviance is minimised. With more parameters the search starts from `SAMPLES` points of a Sobol sequence, and
nothing is promised.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from slippulse_jax.bulk.chunks import distinct_rows
from slippulse_jax.inference.inputs import Inputs
from slippulse_jax.inference.likelihood import EXPECTED, Evaluation, Problem, terms
from slippulse_jax.inference.minimise import Convergence, Method, descend, minimise
from slippulse_jax.inference.parameters import STIFFNESSES, ParameterSet, attainable_of

SCANNED = 3
"""Largest number of fitted parameters whose range is scanned completely."""
EDGES = {1: 257, 2: 33, 3: 13}
"""Number of cell edges to begin with along each parameter, by the number of parameters."""
SLACK = 16.0
"""Deviance above the least within which minima are reported: four standard errors."""
SCANNED_TO = {1: 16.0, 2: 35.0, 3: 16.0}
"""Deviance above the least within which cells are kept, by the number of parameters; with two, as simulations need."""
LINEAR = 0.3
"""Departure from a linear model, in σ of all data together, at which a cell is resolved."""
WIDENED = 2.0
"""Factor on the departure from the linear model by which the range of the predictions in a cell is widened."""
NARROWEST = 1e-7
"""Width of the narrowest cell, over the range searched."""
RUNAWAY = {1: NARROWEST, 2: 1e-3, 3: 1e-2}
"""Width, likewise, of cells on the border of run-away, by the number of parameters: of several it is a surface."""
ROUNDS = 60
MOST_HALVED, MOST_LEFT = 30_000, 500
"""Cells after whose halving a scan ends where it is, ten times what most take; those of the least deviance to start from."""
CHORDS = 6
"""Steps of the minimisation in a cell, whose derivatives are those of its linear model."""
NEARBY = 0.5
"""Distance outside a cell, in its widths, within which the minimum of its linear model counts."""
POLISHED = 8
"""Cells from which the least deviance is lowered during the scan."""

RISEN = 1e-9
"""Relative rise of the deviance between two points that separates two valleys: far above rounding."""

BESIDE = 0.03
"""Distance in θ of two more starts on either side of a cell, with a single parameter."""

UNMEASURABLE = 1e-4
"""Relative scatter of the lengths below which it is not an error of measurement."""
TURNS, SETTLED = 100, 1e-10
"""Largest number of alternations between fit and scale, and the relative change of the scale at which they end."""
SAMPLES = 512
"""Points of the Sobol sequence; the best of them become starts."""
STARTS = 32
BETWEEN = 0.5
"""Difference between ℓ* and the straight-line length, in σ, above which the fit allows for it."""
CROWDED = 24
"""Largest number of different lengths whose peaks are scanned closely on both sides."""


class Cells(NamedTuple):
    """Cells of the range searched that may hold values the data do not exclude."""

    low: np.ndarray  # (c, p)
    high: np.ndarray  # (c, p)
    theta: np.ndarray  # (c, p), the best point found in each
    deviance: np.ndarray  # (c,), there
    gradient: np.ndarray  # (c, p), of half the deviance there, by the linear model of the cell
    metric: np.ndarray  # (c, p, p), and its second derivative
    complete: bool  # whether every cell was resolved

    def expected(self, held: np.ndarray, at: np.ndarray, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least deviance in some cells with the `held` coordinates as in `at`, (n, p), by their linear models; and where."""
        low, high, gradient, metric = (x[cell] for x in (self.low, self.high, self.gradient, self.metric))
        off = np.where(held, at - self.theta[cell], 0)
        slope = np.where(held, 0, gradient + np.einsum("cpq,cq->cp", metric, off))
        inverse = np.linalg.pinv(np.where(held | held[:, None], 0, metric), rcond=1e-9, hermitian=True)
        point = self.theta[cell] + off - np.einsum("cpq,cq->cp", inverse, slope)
        point = np.where(held, at, np.clip(point, low, high))
        off = point - self.theta[cell]
        rise = 2 * (gradient * off).sum(axis=1) + np.einsum("cp,cpq,cq->c", off, metric, off)
        return self.deviance[cell] + rise, point


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
        return self.parameters.inputs_at(self.theta)

    @property
    def ratio(self) -> np.ndarray:
        """k/K of each measurement, shape (n,)."""
        return self.inputs.ratio

    @functools.cached_property
    def rebreaks(self) -> bool:
        """Whether, for some measurement, the edge contact breaks again before the front stops, which the model leaves out."""
        return bool(self.parameters.front.breaks_again(self.inputs).any())


class Found(NamedTuple):
    """What a search found."""

    roots: list[Root]  # within `SLACK` of the least deviance, best first
    theta: np.ndarray  # (p,), of the least deviance met, at a minimum or not
    deviance: float
    unconverged: list[tuple[float, str]]  # deviance and message of the starts that did not converge
    cells: Cells | None  # None with more than `SCANNED` parameters
    curves: dict[int, Any] = {}  # profiles of the requested parameters, where they were followed
    scatter: float | None = None  # factor on the stated σ, or on 1 λc, by which they match the scatter about the fit
    scatter_dof: float | None = None  # degrees of freedom left over by that
    closest: float | None = None  # relative distance of the lengths from the fit, where it is too small to be scatter


def search(problem: Problem, *, method: Method, max_steps: int, seed: int, extra: np.ndarray | None = None) -> Found:
    """Find the minima of the deviance within `SLACK` of the least one, best first.

    Parameters
    ----------
    problem : Problem
    method : {"lm", "lbfgs", "adam"}
    max_steps : int
        Steps allowed each start.
    seed : int
        Seed of the starts with more than `SCANNED` parameters.
    extra : array, shape (s, p), optional
        Start here, and nowhere else.
    """
    low, high = problem.parameters.low, problem.parameters.high
    cells = scan(problem) if extra is None and problem.p <= SCANNED else None
    if extra is not None:
        starts = extra
    elif cells is None:
        starts = _starts(problem, seed)
    else:
        promising = np.nonzero(_promising(cells, low, high))[0]
        starts = cells.theta[promising[np.argsort(cells.deviance[promising], kind="stable")[:MOST_LEFT]]]
        if not len(starts):  # in a deep misfit rounding may exclude every cell
            starts = first_look(problem, seed)[None]
        if problem.p == 1:
            # a cell at the peak of a length is so narrow that its predictions are constant
            starts = np.clip(np.concatenate([starts, starts - BESIDE, starts + BESIDE]), low, high)
    ends = descend(problem, starts, low, high, method=method, max_steps=max_steps)
    good = np.isin(ends.convergence, (Convergence.CONVERGED, Convergence.FLAT)) & np.isfinite(ends.value)
    order = np.nonzero(good)[0][np.argsort(ends.value[good], kind="stable")]
    minima = distinct(problem, ends.theta[order], 2 * ends.value[order], ends.convergence[order] == Convergence.FLAT)
    unconverged = [
        (2 * float(value), Convergence(int(how)).message)
        for value, how in zip(ends.value, ends.convergence, strict=True)
        if how == Convergence.NOT_CONVERGED
    ]
    theta, deviance = ends.theta, 2 * ends.value
    if cells is not None:
        theta, deviance = np.concatenate([theta, cells.theta]), np.concatenate([deviance, cells.deviance])
    if not len(theta):
        return Found([], (low + high) / 2, np.inf, unconverged, cells)
    least = int(np.argmin(deviance))
    return Found(minima, theta[least], float(deviance[least]), unconverged, cells)


def ordered(problem: Problem, roots: Sequence[Root]) -> list[Root]:
    """Sort minima by deviance, but last those at which the model contradicts itself, if the data accept another.

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
    """Typical error of every length by its definition, or by interpolation, in λc; None where all are small compared with σ.

    It is 0 for counts, unless lengths are interpolated.
    """
    data, q = problem.lengths, problem.parameters
    concerned = (data.kind == "length") | q.front.interpolated
    widest = q.front.most_off * np.exp(q.scales["length"](np.stack([q.low, q.high])).max(axis=0))
    if not (concerned & (widest > BETWEEN * data.sigma)).any():
        return None
    theta = first_look(problem, seed)
    off = q.front.uncertainty(q.inputs_at(theta))
    if off is None:
        return None
    off = np.where(concerned, off * np.exp(q.scales["length"](theta)), 0.0)
    return off if (off > BETWEEN * data.sigma).any() else None


def first_look(problem: Problem, seed: int) -> np.ndarray:
    """Find a point of low deviance from a coarse grid, or from a sample if there are many parameters; shape (p,)."""
    q = problem.parameters
    if problem.p > SCANNED:
        starts = _starts(problem, seed)
    else:
        low, high = _first_cells(problem)
        middle = (low + high) / 2
        centre = problem.predictions(middle)
        value = problem.least(centre, centre, middle, middle)
        starts = middle[np.argsort(value, kind="stable")[:POLISHED]]
    ends = minimise(problem, starts, q.low, q.high, max_steps=20)
    return ends.theta[np.argmin(ends.value)]


def scaled_to_scatter(problem: Problem, theta: np.ndarray, *, of_lengths: bool) -> tuple[Problem, Found]:
    """Scale σ to the scatter of the data about the fit that is nearest to θ, where only the ratios of σ are known.

    The deviance of the data is then what it should be, on average, of as many of them as the fit does not use up. Errors of
    inputs keep the size that is stated for them: a parameter that its prior determines uses up none of the data.

    Parameters
    ----------
    problem : Problem
        With the σ stated.
    theta : array, shape (p,)
    of_lengths : bool
        Scale the errors of lengths alone, instead of those of all data.

    Returns
    -------
    problem : Problem
        With σ of that size.
    found : Found
        The fit, and the size of σ.
    """
    q, factor, turns = problem.parameters, 1.0, 0
    widest = float(np.max(problem.lengths.sigma / problem.lengths.value[0]))
    while True:
        sized = problem.with_sigma(factor, of_lengths=of_lengths)
        end = minimise(sized, theta[None], q.low, q.high)
        theta = end.theta[0]
        found = Found([], theta, 2 * float(end.value[0]), [], None)
        deviance, dof = _left_over(sized, theta, of_lengths)
        change = np.sqrt(deviance / dof / EXPECTED[problem.loss]) if dof > 1e-6 else 0.0
        turns += 1
        # a front that never stops has no fit
        if not np.isfinite(deviance) or abs(change - 1) < SETTLED or turns == TURNS:
            return sized, found._replace(scatter=factor, scatter_dof=dof)
        if factor * change * widest < UNMEASURABLE:
            least = UNMEASURABLE / widest
            sized = problem.with_sigma(least, of_lengths=of_lengths)
            total = 2 * float(minimise(sized, theta[None], q.low, q.high).value[0])
            found = found._replace(deviance=total, scatter=least, scatter_dof=dof)
            return sized, found._replace(closest=factor * change * widest)
        factor *= float(change)


def _left_over(problem: Problem, theta: np.ndarray, of_lengths: bool) -> tuple[float, float]:
    """Deviance of the data whose σ are scaled, and their degrees of freedom."""
    scaled, deviance = problem.observed[: 1 if of_lengths else None], 0.0
    for data in scaled:
        mu = problem.predict(theta, data.observable)
        deviance += 2 * float(terms(mu, data, np.zeros(1, int), problem.loss).value.sum())
    jacobian = problem.information(theta)[1] * (problem.parameters.high - problem.parameters.low)
    own = jacobian[: sum(len(data.rows) for data in scaled)]  # the lengths come first, priors last
    used = np.trace(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12, hermitian=True) @ (own.T @ own))
    return deviance, len(own) - float(used)


def scan(problem: Problem) -> Cells:
    """Divide the range into cells, drop those that the data exclude, and minimise in each that is left.

    A cell is excluded if its deviance exceeds the least one known by more than `SCANNED_TO` for all predictions in the range
    that its corners span. What the bound supposes is that predictions between the corners stay within that range, widened by
    `WIDENED` times the distance of the centre from the mean of the corners.
    """
    q, p = problem.parameters, problem.p
    box, slack = (q.low, q.high), SCANNED_TO[p]
    low, high = _first_cells(problem)
    upper = _upper(p)
    corner = _predictions(problem, np.where(upper, high[:, None], low[:, None]))
    best, done, complete, halved = np.inf, [], True, 0
    for round_ in range(ROUNDS):
        middle = (low + high) / 2
        centre = _predictions(problem, middle[:, None])[:, 0]
        value = 2 * problem.least(centre, centre, middle, middle)
        best = min(best, float(value.min()))
        if round_ % 3 == 0 and np.isfinite(best):
            starts = middle[np.argsort(value, kind="stable")[:POLISHED]]
            best = min(best, 2 * float(minimise(problem, starts, *box, max_steps=20).value.min()))
        with np.errstate(invalid="ignore"):
            bent = np.nan_to_num(np.abs(centre - corner.mean(axis=1)), nan=0.0, posinf=0.0)
            # infinite at every corner, a prediction does not change
            span = np.nan_to_num(np.ptp(corner, axis=1), nan=0.0, posinf=np.inf)
        ranges = np.concatenate([corner, centre[:, None]], axis=1)
        ranges = ranges.min(axis=1) - WIDENED * bent, ranges.max(axis=1) + WIDENED * bent
        bound = 2 * problem.least(*ranges, low, high)
        live = bound <= best + slack
        # what is met everywhere in a cell says nothing there, however much its prediction changes
        met = problem.met(*ranges)
        corner = np.where(met[:, None], centre[:, None], corner)
        bent, span = (np.where(met, 0, x) for x in (bent, span))
        # a jump across a parameter is resolved where nothing changes but across it
        width = (high - low) / (box[1] - box[0])
        narrow = width <= NARROWEST
        flat = np.stack([_in_sigmas(problem, np.nan_to_num(change)) for change in _changes(corner, upper)], axis=1) <= LINEAR
        jump = narrow.any(axis=1) & (narrow | flat).all(axis=1)
        finite = np.isfinite(span).all(axis=1)
        resolved = (_in_sigmas(problem, bent) <= LINEAR) & finite | jump | ~finite & (width <= RUNAWAY[p]).all(axis=1)
        ready = live & resolved
        done.append((low[ready], high[ready], corner[ready], centre[ready], bound[ready], value[ready]))
        left = np.nonzero(live & ~resolved)[0]
        if not len(left):
            break
        halved += len(left)
        if halved > MOST_HALVED:
            done.append((low[left], high[left], corner[left], centre[left], bound[left], value[left]))
            complete = False
            break
        low, high, corner = _halved(problem, low[left], high[left], corner[left], upper)
    low, high, corner, centre, bound, value = (np.concatenate(column) for column in zip(*done, strict=True))
    live = np.nonzero(bound <= best + slack)[0]
    if not complete:
        live = live[np.argsort(value[live], kind="stable")[:MOST_LEFT]]
    return _minimised(problem, low[live], high[live], corner[live], centre[live], best + slack, complete)


def _upper(p: int) -> np.ndarray:
    """Which corners of a cell lie at its upper limit, along each parameter; bool, (2^p, p)."""
    return np.array((np.arange(2**p)[:, None] >> np.arange(p)) & 1, dtype=bool)


def _first_cells(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Limits of the cells to begin with, (c, p)."""
    edges = first_edges(problem)
    low = np.stack(np.meshgrid(*(edge[:-1] for edge in edges), indexing="ij"), axis=-1)
    high = np.stack(np.meshgrid(*(edge[1:] for edge in edges), indexing="ij"), axis=-1)
    return low.reshape(-1, problem.p), high.reshape(-1, problem.p)


def first_edges(problem: Problem) -> list[np.ndarray]:
    """Edges of the cells to begin with, along each parameter.

    A single parameter is divided closely around the peak of every length: two roots on its two sides may lie closer together
    than any fixed spacing.
    """
    q, p = problem.parameters, problem.p
    edges = [np.linspace(low, high, EDGES[p]) for low, high in zip(q.low, q.high, strict=True)]
    if p == 1:
        offsets = np.concatenate([[0.0], np.geomspace(1e-6, 0.1, 24)])
        near = [top + side * offsets for top in _tops(problem) for side in (-1, 1)]
        every = np.unique(np.concatenate([edges[0], *near]))
        edges = [every[(every >= q.low[0]) & (every <= q.high[0])]]
    return edges


def _predictions(problem: Problem, theta: np.ndarray) -> np.ndarray:
    """Predictions at points (c, k, p), each different one once; shape (c, k, N)."""
    rows, own = distinct_rows(np.ascontiguousarray(theta.reshape(-1, problem.p)))
    return problem.predictions(rows)[own].reshape(*theta.shape[:2], -1)


def _halved(
    problem: Problem, low: np.ndarray, high: np.ndarray, corner: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both halves of every cell, cut across the parameter along which its predictions change most."""
    changes = [_in_sigmas(problem, _finite(change)) for change in _changes(corner, upper)]
    width = (high - low) / (problem.parameters.high - problem.parameters.low)
    # the widest side, where nothing changes or everything is infinite
    along = np.argmax(np.stack(changes, axis=1) * (width > NARROWEST) + 1e-3 * width, axis=1)
    rows = np.arange(len(low))
    middle = (low[rows, along] + high[rows, along]) / 2
    where = np.where(upper, high[:, None], low[:, None])
    where[rows, :, along] = middle[:, None]
    face = _predictions(problem, where)
    above = upper[:, along].T[:, :, None]
    low_of_upper, high_of_lower = low.copy(), high.copy()
    low_of_upper[rows, along] = high_of_lower[rows, along] = middle
    return (
        np.concatenate([low, low_of_upper]),
        np.concatenate([high_of_lower, high]),
        np.concatenate([np.where(above, face, corner), np.where(above, corner, face)]),
    )


def _changes(corner: np.ndarray, upper: np.ndarray) -> list[np.ndarray]:
    """Mean change of the predictions across each cell along each parameter, (c, N); nan or inf where they are infinite."""
    with np.errstate(invalid="ignore"):
        return [corner[:, up].mean(axis=1) - corner[:, ~up].mean(axis=1) for up in upper.T]


def _finite(x: np.ndarray) -> np.ndarray:
    return np.nan_to_num(x, nan=0.0, posinf=0.0, neginf=0.0)


def _in_sigmas(problem: Problem, change: np.ndarray) -> np.ndarray:
    """Norm of a change of the predictions, (c, N), in standard errors of all data together."""
    with np.errstate(over="ignore"):
        return np.sqrt(((change / problem.reach) ** 2).sum(axis=1))


def _minimised(
    problem: Problem, low: np.ndarray, high: np.ndarray, corner: np.ndarray, centre: np.ndarray, limit: float, complete: bool
) -> Cells:
    """Minimise in every cell, with derivatives from the predictions at its corners."""
    endless = np.asarray(np.isinf(corner).all(axis=1))  # runs away everywhere in the cell
    change = np.where(endless[:, :, None], 0, np.stack(_changes(corner, _upper(problem.p)), axis=2))
    smooth = np.asarray(np.isfinite(change).all(axis=(1, 2)) & (np.isfinite(centre) | endless).all(axis=1))
    slope = np.where(smooth[:, None, None], change, 0) / (high - low)[:, None]
    if problem.plain and complete:  # an unresolved cell is not judged by its linear model
        middle = (low + high) / 2
        at = problem.linearised(np.where(smooth[:, None], centre, 0), slope, middle)
        inverse = np.linalg.pinv(at.metric, rcond=1e-9, hermitian=True)
        least = 2 * at.value - np.einsum("cp,cpq,cq->c", at.gradient, inverse, at.gradient)
        worth = ~smooth | (least <= limit + 2 * LINEAR * np.sqrt(np.maximum(limit, 1)))
        low, high, slope, smooth = low[worth], high[worth], slope[worth], smooth[worth]

    def linear(theta: np.ndarray, lane: np.ndarray | None = None, order: int = 0) -> Evaluation:
        return problem.linearised(problem.predictions(theta), slope if lane is None else slope[lane], theta)

    every = np.arange(len(low))
    ends = minimise(linear, (low + high) / 2, low, high, lane=every, max_steps=CHORDS, enough=limit / 2)
    theta, value = ends.theta, ends.value
    exactly = ~smooth if problem.plain else every >= 0  # the likelihood of a count has corners
    if exactly.any():
        exactly = np.nonzero(exactly)[0]
        exactly = exactly[np.argsort(value[exactly], kind="stable")[:MOST_LEFT]]
        again = minimise(problem, theta[exactly], low[exactly], high[exactly], max_steps=20, enough=limit / 2)
        theta[exactly], value[exactly] = again.theta, again.value
    kept = 2 * value <= limit
    low, high, theta, slope = low[kept], high[kept], theta[kept], slope[kept]
    at = linear(theta)
    return Cells(low, high, theta, 2 * at.value, at.gradient, at.metric, complete)


def _promising(cells: Cells, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Select cells whose linear model has its minimum inside, nearby, or at an end of the range; and the best cell."""
    near = cells.deviance <= cells.deviance.min(initial=np.inf) + SLACK
    step = -np.einsum("cpq,cq->cp", np.linalg.pinv(cells.metric, rcond=1e-9, hermitian=True), cells.gradient)
    width = cells.high - cells.low
    above = (cells.theta + step > cells.low - NEARBY * width) | (cells.low <= low)
    below = (cells.theta + step < cells.high + NEARBY * width) | (cells.high >= high)
    best = np.arange(len(near)) == (int(np.argmin(cells.deviance)) if len(near) else -1)
    return (above & below).all(axis=1) & near | best


def lowest_of_grid(problem: Problem) -> np.ndarray:
    """Point of least deviance of a grid, or of a sample if there are many parameters; shape (p,)."""
    if problem.p > 1:
        return _starts(problem, 0)[0]
    grid = np.linspace(problem.parameters.low, problem.parameters.high, EDGES[1])
    return grid[np.argmin(problem(grid).value)]


def _starts(problem: Problem, seed: int) -> np.ndarray:
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
    """θ at which each length is longest, for up to `CROWDED` different lengths.

    With more, each with its own peak, no single length makes a pair of roots.
    """
    q, data = problem.parameters, problem.lengths
    _, first = np.unique(data.rows, return_index=True)
    if len(first) > CROWDED or q.free[0].name not in STIFFNESSES:
        return np.empty(0)
    theta, inputs = q.low, q.inputs.take(data.measurement[first])
    _, ratio = attainable_of(q, theta, inputs)
    return np.unique(np.log(ratio) - inputs.log_stiffness(theta) + theta[0])


def distinct(problem: Problem, theta: np.ndarray, deviance: np.ndarray, flat: np.ndarray) -> list[Root]:
    """Keep each minimum once; the first point of a flat floor or valley stands for all of it."""
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
    if problem.p == 1 and not problem.gauged:
        between = 2 * float(problem((point + one.theta)[None] / 2).value[0])
        higher = max(deviance, one.deviance)
        return between <= higher + RISEN * max(1, abs(higher))
    off = point - one.theta
    if np.all(np.abs(off) <= 1e-4 * (problem.parameters.high - problem.parameters.low)):
        return True
    along = np.sqrt(np.diag(one.covariance))
    return bool(one.singular.any() or np.all(np.abs(off) <= 0.02 * along))


def describe(problem: Problem, theta: np.ndarray, deviance: float) -> Root:
    """Covariance and share of the response at a minimum."""
    at = problem(theta[None], order=2)
    information = problem.information(theta)[0]
    reach = problem.parameters.high - problem.parameters.low
    singular = undetermined_axes(information * np.outer(reach, reach))
    # a prior as wide as the range searched makes the inverse exist without changing what the data determine
    vague = information + np.diag(1.0 / reach**2) * bool(singular.any())
    return Root(problem.parameters, theta, deviance, np.linalg.inv(vague), singular, _share(at.metric[0], at.curvature[0]))


def _share(metric: np.ndarray, curvature: np.ndarray) -> float:
    """Least share of the metric in the second derivative, over all directions with curvature."""
    unit = np.sqrt(np.maximum(np.maximum(np.abs(np.diag(curvature)), np.diag(metric)), 1e-300))
    values, vectors = np.linalg.eigh(curvature / np.outer(unit, unit))
    curved = values > 1e-8
    whitened = vectors[:, curved] / np.sqrt(values[curved])
    share = np.linalg.eigvalsh(whitened.T @ (metric / np.outer(unit, unit)) @ whitened)
    return float(share[0]) if len(share) else 1.0


def undetermined_axes(information: np.ndarray) -> np.ndarray:
    """Which parameters are part of a direction that the information leaves open, to rounding; bool, (p,).

    `information` is that of each parameter in units of the range searched for it: a standard error of a million such ranges
    is rounding as well.
    """
    unit = np.sqrt(np.diag(information))
    empty = unit < 1e-6
    unit = np.where(empty, 1, unit)
    values, vectors = np.linalg.eigh(information / np.outer(unit, unit))
    return empty | (np.abs(vectors[:, values < 1e-10]) > 1e-3).any(axis=1)
