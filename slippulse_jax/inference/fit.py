"""Interface stiffness from measured precursor lengths: every root, what the data allow, and what they cannot say."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.objective import (
    Curve,
    Data,
    as_data,
    chi_squared,
    evaluate,
    fisher_information,
    half_chi_squared,
    padded,
)
from slippulse_jax.inference.optimise import Minimum, Outcome, minimise
from slippulse_jax.inference.parameters import Stiffness, stiffness_parameter
from slippulse_jax.inference.result import FitResult, Identifiability, Root
from slippulse_jax.inference.uncertainty import Interval, allowed, chi_squared_tail, local_minima, merge, peaks, scan, threshold
from slippulse_jax.lattice.front import Arrest, FrontStatus
from slippulse_jax.lattice.precursor import precursor_arrests
from slippulse_jax.slider import Slider

LEVELS = (0.6827, 0.95)
FREE_PARAMETERS = ("stiffness",)


def fit(
    measurements: Measurements,
    free: Sequence[str] = ("stiffness",),
    *,
    bounds: tuple[float, float] | None = None,
    max_steps: int = 60,
) -> FitResult:
    """Fit the interface stiffness to measured first-precursor lengths.

    The model is the first precursor of a uniform, relaxed interface on a semi-infinite slider, and all measurements share one
    stiffness: k/K where lengths are in λc, the areal stiffness k/λc² where they are in SI. χ² = Σ[(ℓ − measured)/σ]² is
    scanned over the whole range of stiffness, each of its minima is refined by gradient descent (optax L-BFGS, all starts at
    once), and the intervals are the sets of values that χ² allows, in as many pieces as there are.

    Parameters
    ----------
    measurements : Measurements
        From `read_measurements`, or built from arrays. Their σ is taken as the true standard error, never rescaled.
    free : sequence of str
        What is fitted; ("stiffness",) in this version.
    bounds : (float, float), optional
        Range of the stiffness searched, in the unit of the result. By default everything from where no domino starts up to
        k/K = 1.
    max_steps : int
        Descent steps allowed each start.

    Returns
    -------
    FitResult
        Look at `identifiability` first: where the data cannot give a number, the result says why instead.

    Raises
    ------
    ValueError
        If something else than the stiffness is asked for, or the bounds make no range.
    """
    unknown = [name for name in free if name not in FREE_PARAMETERS]
    if unknown or not free:
        raise ValueError(f"free = {tuple(free)!r}: this version fits {', '.join(FREE_PARAMETERS)}")
    if max_steps < 1:
        raise ValueError(f"max_steps = {max_steps}: must be at least 1")
    parameter = stiffness_parameter(measurements, bounds)
    data = as_data(measurements, parameter)
    curve = scan(data, parameter.bounds)
    roots, unconverged = _roots(curve, data, parameter, measurements, max_steps)
    # the scan may lie lower than any interior minimum: at an end of the range, or on a broad top
    curve = _with_valleys(curve, roots, data)
    chi2 = chi_squared(curve, data)
    best = int(np.argmin(chi2))
    chi2_min = float(chi2[best])
    intervals = {level: allowed(curve, data, chi2_min, level) for level in LEVELS}
    at_best = roots[0] if roots and roots[0].chi2 <= chi2_min + 1e-6 else None
    theta = np.log(at_best.value) if at_best else float(curve.theta[best])
    if at_best is None and unconverged:
        identifiability, reason = Identifiability.NOT_CONVERGED, unconverged[0]
    else:
        identifiability, reason = _identifiability(at_best, roots, intervals, curve, data, parameter)
    if identifiability is Identifiability.AT_MAXIMUM:
        # around a maximum that the data lie far above, the rise of χ² measures the misfit and not the stiffness
        for level in LEVELS:
            if chi_squared_tail(chi2_min, len(measurements)) < 1 - level:
                intervals[level] = []
    attainable, where = _attainable(curve, data)
    return FitResult(
        measurements=measurements,
        parameter=parameter,
        value=float(np.exp(theta)),
        log_stderr=at_best.log_stderr if at_best and identifiability is Identifiability.IDENTIFIED else None,
        identifiability=identifiability,
        reason=reason,
        level_intervals={level: [_exponential(i) for i in pieces] for level, pieces in intervals.items()},
        roots=[root for root in roots if root.chi2 <= chi2_min + threshold(LEVELS[-1])],
        chi2=chi2_min,
        converged=not unconverged,
        outcomes=unconverged,
        fitted=_fitted(measurements, parameter.ratio(float(np.exp(theta)))),
        attainable=attainable,
        attainable_at=np.exp(where) * parameter.ratio_per_unit,
        curve=curve,
    )


def _roots(
    curve: Curve, data: Data, parameter: Stiffness, measurements: Measurements, max_steps: int
) -> tuple[list[Root], list[str]]:
    """Every minimum of χ², best first, and the outcome of each start that ended otherwise."""
    chi2 = chi_squared(curve, data)
    nodes = local_minima(chi2)
    if not len(nodes):
        return [], []
    found = _descend(curve.theta[nodes], curve.theta[nodes - 1], curve.theta[nodes + 1], data, max_steps)
    roots, unconverged = [], []
    for (theta,), value, ((curvature,),), outcome in zip(found.theta, found.value, found.hessian, found.outcome, strict=True):
        if outcome == Outcome.CONVERGED:
            here = evaluate(np.array([theta]), data)
            information = float(fisher_information(here, data)[0])
            ratio = parameter.ratio(float(np.exp(theta)))
            roots.append(
                Root(
                    value=float(np.exp(theta)),
                    chi2=float(2 * value),
                    # χ²/2 has curvature Σ(ℓ'/σ)² + Σ r ℓ''/σ: without the first term the length does not tell
                    log_stderr=information**-0.5 if information > 0 else None,
                    share_of_information=information / float(curvature),
                    ratio=ratio,
                    rebreaks=np.asarray(_fitted(measurements, ratio).status) == FrontStatus.REBREAK,
                )
            )
        elif 2 * value <= chi2.min() + threshold(LEVELS[-1]):
            unconverged.append(Outcome(int(outcome)).message)
    return sorted(roots, key=lambda root: root.chi2), unconverged


def _descend(start: np.ndarray, low: np.ndarray, high: np.ndarray, data: Data, max_steps: int) -> Minimum:
    """Minima from all starts at once, as NumPy; repeated to a power of two so that few shapes are compiled."""
    count = len(start)
    boxes = [np.resize(x, max(2, 1 << (count - 1).bit_length()))[:, None] for x in (start, low, high)]
    with jax.enable_x64(True):
        return Minimum(*(np.asarray(x)[:count] for x in _minimise_all(*boxes, padded(data), jnp.asarray(max_steps))))


@jax.jit
def _minimise_all(start, low, high, data: Data, max_steps) -> Minimum:
    def one(start, low, high):
        return minimise(lambda theta: half_chi_squared(theta, data), start, low, high, max_steps=max_steps)

    return jax.vmap(one)(start, low, high)


def _with_valleys(curve: Curve, roots: list[Root], data: Data) -> Curve:
    """The curve with nodes in and around each root, so that a valley narrower than the node spacing is seen."""
    theta = [
        np.log(root.value) + steps * root.log_stderr
        for root in roots
        if root.log_stderr is not None
        for steps in [np.linspace(-6, 6, 25)]
    ] + [np.array([np.log(root.value)]) for root in roots]
    if not theta:
        return curve
    extra = np.concatenate(theta)
    extra = extra[(extra > curve.theta[0]) & (extra < curve.theta[-1])]
    return merge(curve, evaluate(extra, data)) if len(extra) else curve


def _identifiability(
    best: Root | None,
    roots: list[Root],
    intervals: dict[float, list[Interval]],
    curve: Curve,
    data: Data,
    parameter: Stiffness,
) -> tuple[Identifiability, str]:
    """Whether there is a number to report with a standard error, and if not, why."""
    low_level, high_level = (intervals[level] for level in LEVELS)
    rivals = [root for root in roots if root.chi2 <= roots[0].chi2 + threshold(LEVELS[-1])]
    values = " and ".join(f"{root.value:.4g}" for root in rivals)
    if not curve.length.any():
        return Identifiability.UNINFORMATIVE, "no stiffness in the range searched starts a domino: every length is zero"
    if len(high_level) == 1 and high_level[0].open_low and high_level[0].open_high:
        return Identifiability.UNINFORMATIVE, "the data allow every stiffness in the range searched"
    if best is None:
        end = "upper" if intervals[LEVELS[0]][-1].open_high else "lower"
        return Identifiability.AT_BOUND, f"the best fit lies at the {end} end of the range searched"
    if best.share_of_information < 0.5:
        longest = float(np.max(data.length / curve.length.max(axis=0)))
        return Identifiability.AT_MAXIMUM, (
            f"the measured length is {longest:.3g} times the longest the model can give at any stiffness; at that maximum the "
            "length does not change with stiffness"
        )
    if len(rivals) > 1:
        joined = "; the interval joins them" if len(high_level) == 1 else ""
        return Identifiability.SEVERAL_ROOTS, f"the lengths fit at {values} {parameter.unit}".rstrip() + joined
    if any(piece.open_low or piece.open_high for piece in high_level):
        return Identifiability.ONE_SIDED, "the data bound the stiffness on one side only"
    assert best.log_stderr is not None
    widths = [abs(end - np.log(best.value)) / best.log_stderr for end in (low_level[0].low, low_level[-1].high)]
    if len(low_level) > 1 or max(widths) > 1.5 or min(widths) < 1 / 1.5:
        return Identifiability.SKEWED, (
            "the likelihood is far from a normal curve (its 68 % interval reaches "
            f"{widths[0]:.2g} and {widths[1]:.2g} curvature standard errors); use the intervals"
        )
    return Identifiability.IDENTIFIED, ""


def _attainable(curve: Curve, data: Data) -> tuple[np.ndarray, np.ndarray]:
    """Longest length each measurement could have at any stiffness, in λc, and the θ where; shapes (n,)."""
    fine = merge(curve, evaluate(np.append(peaks(curve, data), curve.theta[-1]), data))
    at = fine.length.argmax(axis=0)
    return fine.length.max(axis=0), fine.theta[at]


def _fitted(measurements: Measurements, ratio: np.ndarray) -> Arrest:
    return precursor_arrests(Slider(measurements.height, ratio, measurements.poisson))


def _exponential(interval: Interval) -> Interval:
    return interval._replace(low=float(np.exp(interval.low)), high=float(np.exp(interval.high)))
