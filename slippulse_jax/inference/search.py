"""Every minimum of the deviance: where to start, and which ends are one and the same."""

import dataclasses

import numpy as np

from slippulse_jax.inference.attainable import attainable_of
from slippulse_jax.inference.objective import Problem
from slippulse_jax.inference.optimise import Minimum, Outcome, minimise
from slippulse_jax.inference.parameters import STIFFNESSES
from slippulse_jax.inference.profile import DENSE_NODES, DENSE_SPACING

SAMPLES = 512  # points at which several parameters are looked at before the best of them are taken as starts
STARTS = 32
CROWDED = 24


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """One minimum of the deviance D = −2 ln(likelihood × prior)."""

    theta: np.ndarray
    deviance: float
    covariance: np.ndarray  # inverse Fisher information
    singular: np.ndarray  # parameters of which that knows nothing: their variance is that of the range searched
    share: float  # least share that the response of the model makes up of the second derivative of D; 1 at a good root


def search(
    problem: Problem, *, method: str, max_steps: int, seed: int, extra: np.ndarray | None = None
) -> tuple[list[Found], Minimum]:
    """Minima of the deviance, best first, and where each start ended."""
    low, high = problem.parameters.low, problem.parameters.high
    if extra is not None:
        starts = extra
    elif problem.p == 1:
        starts, low, high = _cells(problem)
    else:
        starts = _starts(problem, seed)
    ends = minimise(problem, starts, low, high, method=method, max_steps=max_steps)
    good = np.isin(ends.outcome, (Outcome.CONVERGED, Outcome.FLAT)) & np.isfinite(ends.value)
    order = np.nonzero(good)[0][np.argsort(ends.value[good], kind="stable")]
    return distinct(problem, ends.theta[order], 2 * ends.value[order], ends.outcome[order] == Outcome.FLAT), ends


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
    # half the lowest, half spread over the rest, so that a second basin is not crowded out
    spread = ranked[STARTS // 2 :: max(1, (len(ranked) - STARTS // 2) // (STARTS // 2))][: STARTS // 2]
    return sample[np.concatenate([ranked[: STARTS // 2], spread])]


def _cells(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of a scan that are lower than both neighbours: where to start in each, and those neighbours; shapes (k, 1).

    The scan is crowded around the peak of every length: two roots on its two sides may lie closer together than any fixed
    spacing, and a search that starts on one side must not leap to the other.
    """
    low, high = problem.parameters.low[0], problem.parameters.high[0]
    node = np.linspace(low, high, max(DENSE_NODES, int((high - low) / DENSE_SPACING)))
    offsets = np.concatenate([[0.0], np.geomspace(1e-4, DENSE_SPACING, 16)])
    near = [top + side * offsets for top in _tops(problem) for side in (-1, 1)]
    node = np.unique(np.concatenate([node, *near]))
    node = node[(node >= low) & (node <= high)]
    value = problem(node[:, None]).value
    valley = 1 + np.nonzero((value[1:-1] < value[:-2]) & (value[1:-1] <= value[2:]))[0]
    start = np.concatenate([node[valley], node[[int(np.argmin(value))]]])
    left, right = np.concatenate([node[valley - 1], [low]]), np.concatenate([node[valley + 1], [high]])
    return start[:, None], left[:, None], right[:, None]


def _tops(problem: Problem) -> np.ndarray:
    """θ of the stiffness at which a length is longest, of up to `CROWDED` different lengths.

    With more than that, each with a peak of its own, no one of them makes a pair of roots.
    """
    q, block = problem.parameters, problem.blocks[0]
    _, first = np.unique(block.rows, return_index=True)
    if len(first) > CROWDED or q.free[0].name not in STIFFNESSES:
        return np.empty(0)
    rows = block.measurement[first]
    theta = q.low
    y = q.inputs(theta)[rows]
    _, ratio = attainable_of(q, theta, rows, y)
    return np.unique(np.log(ratio) - y[:, 1] + theta[0])


def distinct(problem: Problem, theta: np.ndarray, deviance: np.ndarray, flat: np.ndarray) -> list[Found]:
    """Each minimum once; of a floor or a valley without a slope the first point found stands for all."""
    kept: list[Found] = []
    for point, value, is_flat in zip(theta, deviance, flat, strict=True):
        if is_flat and not problem.predict(point).any():
            continue  # where no domino starts nothing responds either, and nothing was found
        if any(same(point, float(value), one, problem) for one in kept):
            continue
        kept.append(describe(problem, point, float(value)))
    return kept


def same(point: np.ndarray, deviance: float, one: Found, problem: Problem) -> bool:
    """Whether a point is this minimum, to a fiftieth of its standard errors; or lies in the valley that it lies in."""
    if abs(deviance - one.deviance) > 1e-3:
        return False
    off = point - one.theta
    if np.all(np.abs(off) <= 1e-4 * (problem.parameters.high - problem.parameters.low)):
        return True
    along = np.sqrt(np.diag(one.covariance))
    return bool(one.singular.any() or np.all(np.abs(off) <= 0.02 * along))


def describe(problem: Problem, theta: np.ndarray, deviance: float) -> Found:
    """Covariance and share of the response at a minimum."""
    at = problem(theta[None], order=2)
    assert at.metric is not None
    assert at.curvature is not None
    information = problem.information(theta)[0]
    reach = problem.parameters.high - problem.parameters.low
    singular = undetermined_axes(information * np.outer(reach, reach))
    # a range as wide as the one searched, as a prior, makes the inverse exist and leaves alone what the data determine
    vague = information + np.diag(1.0 / reach**2) * bool(singular.any())
    # the scatter that the data happen to show moves the curvature in `discrepancy`; no prediction responds to that
    predicted = np.arange(problem.p) != problem.parameters.discrepancy
    share = _share(at.metric[0][np.ix_(predicted, predicted)], at.curvature[0][np.ix_(predicted, predicted)])
    return Found(theta, deviance, np.linalg.inv(vague), singular, share)


def _share(metric: np.ndarray, curvature: np.ndarray) -> float:
    """Least share of the metric in the second derivative, over all directions that this curves in."""
    unit = np.sqrt(np.maximum(np.maximum(np.abs(np.diag(curvature)), np.diag(metric)), 1e-300))
    values, vectors = np.linalg.eigh(curvature / np.outer(unit, unit))
    told = values > 1e-8
    whitened = vectors[:, told] / np.sqrt(values[told])
    share = np.linalg.eigvalsh(whitened.T @ (metric / np.outer(unit, unit)) @ whitened)
    return float(share[0]) if len(share) else 1.0


def undetermined_axes(information: np.ndarray) -> np.ndarray:
    """Which parameters take part in a direction that the information says nothing of, to rounding; bool, (p,).

    `information` is that of each parameter in units of the range searched for it: a standard error of a million such ranges
    is rounding as well.
    """
    unit = np.sqrt(np.diag(information))
    empty = unit < 1e-6
    unit = np.where(empty, 1, unit)
    values, vectors = np.linalg.eigh(information / np.outer(unit, unit))
    return empty | (np.abs(vectors[:, values < 1e-10]) > 1e-3).any(axis=1)
