"""Interface stiffness from measured precursor lengths: every root, what the data allow, and what they cannot say."""

from collections.abc import Sequence

import numpy as np

from slippulse_jax.inference.identifiability import LEVELS, Identifiability, judge
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.objective import Curve, Data, as_data, chi_squared, evaluate, near
from slippulse_jax.inference.optimise import Local, Outcome, minimise
from slippulse_jax.inference.parameters import Stiffness, stiffness_parameter
from slippulse_jax.inference.result import FitResult, Root
from slippulse_jax.inference.uncertainty import Interval, allowed, chi_squared_tail, local_minima, merge, peaks, scan, threshold
from slippulse_jax.lattice.front import Arrest, FrontStatus
from slippulse_jax.lattice.precursor import precursor_arrests
from slippulse_jax.slider import Slider

FREE_PARAMETERS = ("stiffness",)


def fit(
    measurements: Measurements,
    free: str | Sequence[str] = ("stiffness",),
    *,
    bounds: tuple[float, float] | None = None,
    max_steps: int = 60,
) -> FitResult:
    """Fit the interface stiffness to measured first-precursor lengths.

    The model is the first precursor of a uniform, relaxed interface on a semi-infinite slider, and all measurements share one
    stiffness: k/K where lengths are in λc, the areal stiffness k/λc² where they are in SI. χ² = Σ[(ℓ − measured)/σ]² is
    scanned over the whole range of stiffness, each of its minima is refined by gradient descent (optax, all starts at
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
    free = (free,) if isinstance(free, str) else tuple(free)
    unknown = [name for name in free if name not in FREE_PARAMETERS]
    if unknown or not free:
        raise ValueError(f"free = {free!r}: this version fits {', '.join(FREE_PARAMETERS)}")
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
    at_best = roots[0] if roots and roots[0].chi2 <= _close_to(chi2_min) else None
    theta = np.log(at_best.value) if at_best else float(curve.theta[best])
    if at_best is None and unconverged:
        identifiability, reason = Identifiability.NOT_CONVERGED, unconverged[0]
    else:
        identifiability, reason = judge(at_best, roots, intervals, curve, data, parameter.unit)
    if identifiability is Identifiability.AT_MAXIMUM:
        # around a maximum that the data lie far above, the rise of χ² measures the misfit and not the stiffness
        intervals = {
            level: pieces if chi_squared_tail(chi2_min, len(measurements)) >= 1 - level else []
            for level, pieces in intervals.items()
        }
    elif identifiability is Identifiability.POOR_FIT:
        intervals = dict.fromkeys(LEVELS, [])
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
    box = curve.theta[nodes], curve.theta[nodes - 1], curve.theta[nodes + 1]
    found = minimise(lambda theta: near(theta, data), *box, max_steps=max_steps)
    roots, unconverged = [], []
    for i, outcome in enumerate(found.outcome):
        local = Local(*(x[i] for x in found.local))
        if outcome in (Outcome.CONVERGED, Outcome.KINK):
            value = float(np.exp(found.theta[i]))
            ratio = parameter.ratio(value)
            smooth = outcome == Outcome.CONVERGED
            roots.append(
                Root(
                    value=value,
                    chi2=float(2 * local.value),
                    log_stderr=float(local.information) ** -0.5 if smooth else None,
                    share_of_information=float(local.information / max(local.curvature, local.information)) if smooth else None,
                    ratio=ratio,
                    rebreaks=np.asarray(_fitted(measurements, ratio).status) == FrontStatus.REBREAK,
                )
            )
        elif 2 * local.value <= _close_to(float(chi2.min())) + threshold(LEVELS[-1]):
            unconverged.append(Outcome(int(outcome)).message)
    return sorted(roots, key=lambda root: root.chi2), unconverged


def _close_to(chi2: float) -> float:
    """A χ² that rounding cannot tell from this one."""
    return chi2 * (1 + 1e-9) + 1e-6


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


def _attainable(curve: Curve, data: Data) -> tuple[np.ndarray, np.ndarray]:
    """Longest length each measurement could have at any stiffness, in λc, and the θ where; shapes (n,)."""
    fine = merge(curve, evaluate(np.append(peaks(curve, data), curve.theta[-1]), data))
    at = fine.length.argmax(axis=0)
    return fine.length.max(axis=0), fine.theta[at]


def _fitted(measurements: Measurements, ratio: np.ndarray) -> Arrest:
    return precursor_arrests(Slider(measurements.height, ratio, measurements.poisson))


def _exponential(interval: Interval) -> Interval:
    return interval._replace(low=float(np.exp(interval.low)), high=float(np.exp(interval.high)))
