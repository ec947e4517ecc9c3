"""Which values the data allow: the likelihood along one parameter, read off a scan that follows its every turn.

The length rises with stiffness, peaks and falls again, so that the likelihood can have two maxima, a broad top, or an open
side. A curvature at the best point knows nothing of that; the set {θ : χ²(θ) − χ²_min ≤ Δ} does.
"""

from collections.abc import Callable
from statistics import NormalDist
from typing import NamedTuple

import jax
import numpy as np
from jax.scipy.special import gammaincc

from slippulse_jax.inference.objective import Curve, Data, chi_squared, distinct_curves, evaluate

NODE_SPACING = 0.1  # in ln(stiffness); ℓ(k/K) turns over a range of order one
CROWDED_CURVES = 24
CROSSING_ROUNDS, CROSSING_PARTS = 2, 33  # each round divides a bracket, at most a node spacing wide, by 32


class Interval(NamedTuple):
    """One piece of the set of allowed values; an open side means the search range ended before the data did."""

    low: float
    high: float
    open_low: bool
    open_high: bool


def threshold(level: float) -> float:
    """Rise of χ² at the ends of an interval of this confidence level, one parameter: 1 at 68.27 %, 3.84 at 95 %."""
    return NormalDist().inv_cdf((1 + level) / 2) ** 2


def chi_squared_tail(chi2: float, dof: int) -> float:
    """Probability of a χ² with `dof` degrees of freedom at least this large."""
    with jax.enable_x64(True):
        return float(gammaincc(dof / 2, chi2 / 2))


def scan(data: Data, bounds: tuple[float, float]) -> Curve:
    """Curve over ln(bounds), with extra nodes crowded around the peak of every ℓ(θ), of up to `CROWDED_CURVES` of them.

    Two roots either side of a peak may lie closer together than any fixed spacing; the crowding resolves them down to 10⁻⁴.
    With more curves than that, each with a peak of its own, no one of them makes a pair of roots.
    """
    low, high = np.log(bounds)
    nodes = np.linspace(low, high, max(200, int((high - low) / NODE_SPACING)))
    curve = evaluate(nodes, data)
    offsets = np.concatenate([[0.0], np.geomspace(1e-4, NODE_SPACING, 16)])
    if len(distinct_curves(data)[0]) > CROWDED_CURVES:
        return curve
    around = [peak + sign * offsets for peak in peaks(curve, data) for sign in (-1, 1)]
    if not around:
        return curve
    extra = np.unique(np.concatenate(around))
    return merge(curve, evaluate(extra[(extra > low) & (extra < high)], data))


def merge(*curves: Curve) -> Curve:
    """Nodes of all the curves, in order of θ, each once."""
    theta, keep = np.unique(np.concatenate([c.theta for c in curves]), return_index=True)
    return Curve(theta, *(np.concatenate(columns)[keep] for columns in list(zip(*curves, strict=True))[1:]))


def peaks(curve: Curve, data: Data) -> np.ndarray:
    """θ at which some measurement's ℓ(θ) has its maximum, from sign changes of the slope, refined; shape (p,)."""
    rising, falling = curve.slope[:-1] > 0, curve.slope[1:] <= 0
    node, _ = np.nonzero(rising & falling)
    found = [_bracketed_peak(float(curve.theta[i]), float(curve.theta[i + 1]), data) for i in np.unique(node)]
    return np.unique(np.concatenate(found)) if found else np.empty(0)


def _bracketed_peak(low: float, high: float, data: Data) -> np.ndarray:
    """Peaks of the measurements whose slope changes sign between `low` and `high`, to 10⁻⁵ of the bracket."""
    fine = evaluate(np.linspace(low, high, 65), data)
    result = []
    for slope in fine.slope.T:
        inside = np.nonzero((slope[:-1] > 0) & (slope[1:] <= 0))[0]
        for i in inside:
            # the slope is close to linear over a 64th of a node spacing, but jumps at a kink: stay within the cell
            share = slope[i] / (slope[i] - slope[i + 1])
            result.append(fine.theta[i] + share * (fine.theta[i + 1] - fine.theta[i]))
    return np.array(result)


def local_minima(chi2: np.ndarray) -> np.ndarray:
    """Indices of interior nodes lower than the node before and not higher than the one after; shape (k,)."""
    return 1 + np.nonzero((chi2[1:-1] < chi2[:-2]) & (chi2[1:-1] <= chi2[2:]))[0]


def allowed(curve: Curve, data: Data, chi2_min: float, level: float) -> list[Interval]:
    """All θ with χ² ≤ χ²_min + Δ(level), as intervals in increasing order.

    Parameters
    ----------
    curve : Curve
        Must have nodes at the minima, or a valley narrower than the node spacing is lost.
    chi2_min : float
        χ² at the best point.
    level : float
        Confidence level, as 0.95.
    """
    limit = chi2_min + threshold(level)

    def excess(theta: np.ndarray) -> np.ndarray:
        return chi_squared(evaluate(theta, data), data) - limit

    inside = chi_squared(curve, data) <= limit
    changes = np.nonzero(inside[1:] != inside[:-1])[0]
    ends = [find_crossing(excess, curve.theta[i], curve.theta[i + 1]) for i in changes]
    open_low, open_high = bool(inside[0]), bool(inside[-1])
    ends = [float(curve.theta[0])] * open_low + ends + [float(curve.theta[-1])] * open_high
    pairs = list(zip(ends[::2], ends[1::2], strict=True))
    return [Interval(low, high, open_low and i == 0, open_high and i == len(pairs) - 1) for i, (low, high) in enumerate(pairs)]


def find_crossing(f: Callable[[np.ndarray], np.ndarray], low: float, high: float) -> float:
    """Point between `low` and `high`, where its signs differ, at which `f` changes sign; `f` takes many points at once."""
    theta = value = np.empty(0)
    i = 0
    for _ in range(CROSSING_ROUNDS):
        theta = np.linspace(low, high, CROSSING_PARTS)
        value = f(theta)
        i = int(np.nonzero((value[1:] > 0) != (value[:-1] > 0))[0][0])
        low, high = float(theta[i]), float(theta[i + 1])
    # nodes lie half a standard error apart here, so that the line is straight to 1e-6 of one
    share = value[i] / (value[i] - value[i + 1])
    return low + float(share) * (high - low)
