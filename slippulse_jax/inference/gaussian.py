r"""A smooth profile from data: Gaussian-process prior, Gauss–Newton steps, and the evidence of the prior's settings.

The unknown u is the profile at its knots, followed by the shift of ln k. Linear data d = μ + G (u − m) + noise of covariance Σ,
and a prior of mean m and covariance K, give with S = G K Gᵀ + Σ

    mean m + K Gᵀ S⁻¹ (d − μ),   covariance K − K Gᵀ S⁻¹ G K,   resolution R = K Gᵀ S⁻¹ G,   ln evidence −½ zᵀS⁻¹z − ½ ln|2πS|,

with z = d − μ. The mean is m + R (truth − m) + noise: row i of R is the averaging kernel of knot i, and the trace of R counts
the numbers that the data, rather than the prior, determine. K is never inverted, so it may be singular: pinned, or very smooth.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from slippulse_jax.inference.heterogeneous import Linearised, ProfileProblem

ENOUGH = 4
"""Fewest lengths whose evidence chooses amplitude and length scale; with fewer all settings have the same weight."""

LEVEL = 0.3
"""Standard deviation of the unknown mean prestress, in σ_s."""

KINK = 0.1
"""Square of the last step, in the prior's standard deviations, below which a search that cannot descend further has arrived."""


class Smoothness(NamedTuple):
    """Settings of the prior."""

    amplitude: float  # standard deviation of the profile about its mean, in the unit of the profile
    length_scale: float  # distance over which it varies, in λc


class LinearPosterior(NamedTuple):
    """Posterior of u given linear data, for one `Smoothness`."""

    mean: Float[np.ndarray, " k"]  # of u − m
    covariance: Float[np.ndarray, "k k"]
    resolution: Float[np.ndarray, "k k"]
    log_evidence: float
    coefficient: Float[np.ndarray, " n"]  # S⁻¹ z


class Inversion(NamedTuple):
    """Outcome of a search."""

    posteriors: list[LinearPosterior]  # of each setting, linearised where the search ended
    weight: np.ndarray  # their probabilities
    prior_misfit: float  # (u − m)ᵀK⁻¹(u − m)
    converged: bool
    steps: int
    place: np.ndarray  # (k + 1,), u − m where the lengths were linearised
    at: Linearised  # the lengths there


def prior_covariance(problem: ProfileProblem, smoothness: Smoothness) -> np.ndarray:
    """Covariance of u: of the knots, and of the shift of ln k."""
    k, pinned = len(problem.knots), problem.kind == "threshold"
    covariance = np.zeros((k + 1, k + 1))
    covariance[:k, :k] = squared_exponential(problem.knots, smoothness, level=0.0 if pinned else LEVEL, pinned=pinned)
    covariance[k, k] = problem.log_stiffness_sd**2
    return covariance


def squared_exponential(
    position: Float[np.ndarray, " k"], smoothness: Smoothness, *, level: float = 0.0, pinned: bool = False
) -> Float[np.ndarray, "k k"]:
    """Covariance s² exp[−(x − x')²/2L²] of a smooth function.

    Parameters
    ----------
    position : array, shape (k,)
        Knots, in λc.
    smoothness : Smoothness
    level : float
        Standard deviation of an unknown constant added to the function.
    pinned : bool
        Whether the function is known at the first knot.
    """
    apart = (position[:, None] - position[None, :]) / smoothness.length_scale
    kernel = smoothness.amplitude**2 * np.exp(-(apart**2) / 2) + level**2
    if pinned:
        kernel = kernel - np.outer(kernel[:, 0], kernel[0]) / kernel[0, 0]
    return kernel


def condition(
    z: Float[np.ndarray, " n"],
    design: Float[np.ndarray, "n k"],
    noise: Float[np.ndarray, " n"],
    prior: Float[np.ndarray, "k k"],
) -> LinearPosterior:
    """Posterior of u − m given z = G (u − m) + noise.

    Parameters
    ----------
    z : array, shape (n,)
    design : array, shape (n, k)
        G.
    noise : array, shape (n,)
        Standard errors of z.
    prior : array, shape (k, k)
        K.
    """
    gain = prior @ design.T
    spread = design @ gain + np.diag(noise**2)
    factor = np.linalg.cholesky(spread)
    white = np.linalg.solve(factor, gain.T)  # (n, k): covariance removed is whiteᵀ white
    residual = np.linalg.solve(factor, z)
    coefficient = np.linalg.solve(factor.T, residual)
    return LinearPosterior(
        mean=gain @ coefficient,
        covariance=prior - white.T @ white,
        resolution=white.T @ np.linalg.solve(factor, design),
        log_evidence=float(-residual @ residual / 2 - np.log(np.diag(factor)).sum() - len(z) * np.log(2 * np.pi) / 2),
        coefficient=coefficient,
    )


def mixture(posteriors: list[LinearPosterior], weight: Float[np.ndarray, " h"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, covariance and resolution of posteriors weighted by the probability of their settings."""
    pairs = list(zip(weight, posteriors, strict=True))
    mean = np.sum([w * p.mean for w, p in pairs], axis=0)
    covariance = np.sum([w * (p.covariance + np.outer(p.mean - mean, p.mean - mean)) for w, p in pairs], axis=0)
    return mean, covariance, np.sum([w * p.resolution for w, p in pairs], axis=0)


def quantile(
    level: float, mean: Float[np.ndarray, "h k"], stderr: Float[np.ndarray, "h k"], weight: Float[np.ndarray, " h"]
) -> Float[np.ndarray, " k"]:
    """Quantile of each of k mixtures of Gaussians, by bisection."""
    width = np.maximum(stderr, 1e-12)
    low, high = (mean - 10 * width).min(axis=0), (mean + 10 * width).max(axis=0)
    for _ in range(60):
        middle = (low + high) / 2
        under = weight @ ndtr((middle - mean) / width) < level
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return (low + high) / 2


def invert(problem: ProfileProblem, settings: list[Smoothness], max_steps: int) -> Inversion:
    """Fit with the setting of most evidence, weight all settings where the search ended, and repeat until it stays."""
    priors = [prior_covariance(problem, s) for s in settings]
    weight = np.full(len(settings), 1 / len(settings))
    best, total, tried = len(settings) // 2, 0, set()
    while True:
        c, steps, converged = _descend(problem, priors[best], max_steps)
        total += steps
        place = priors[best] @ c
        at = problem.lengths(problem.mean + place)
        z = problem.measured - at.value + at.derivative @ place
        posteriors = [condition(z, at.derivative, problem.sigma, prior) for prior in priors]
        if len(z) >= ENOUGH:
            # a prior flat in the amplitude: the settings lie evenly along its logarithm
            evidence = np.array([p.log_evidence + np.log(s.amplitude) for p, s in zip(posteriors, settings, strict=True)])
            weight = np.exp(evidence - evidence.max())
            weight /= weight.sum()
        tried.add(best)
        best = int(np.argmax(weight)) if len(z) >= ENOUGH else best
        if best in tried:
            return Inversion(posteriors, weight, float(c @ place), converged, total, place, at)


def _descend(problem: ProfileProblem, prior: np.ndarray, max_steps: int) -> tuple[np.ndarray, int, bool]:
    """Minimise χ² + (u − m)ᵀK⁻¹(u − m) over c, where u − m = K c, by Gauss–Newton steps cut until they descend."""
    measured, sigma = problem.measured, problem.sigma

    def tried(c: np.ndarray) -> tuple[float, np.ndarray, Linearised]:
        at = problem.lengths(problem.mean + prior @ c)
        value = (((at.value - measured) / sigma) ** 2).sum() + c @ prior @ c
        return (value if np.isfinite(value) else np.inf), c, at

    starts = np.zeros(len(problem.mean)), _by_excess(problem, prior)
    value, c, at = min(map(tried, starts), key=lambda found: found[0])
    for step in range(1, max_steps + 1):
        z = measured - at.value + at.derivative @ (prior @ c)
        move = at.derivative.T @ condition(z, at.derivative, sigma, prior).coefficient - c
        size = move @ prior @ move
        for fraction in 0.5 ** np.arange(14):
            trial = tried(c + fraction * move)
            if trial[0] < value:
                break
        else:
            # no lower along the step: rounding if the step is small, else a kink of ℓ at a site
            return c, step, bool(size < KINK)
        gained = value - trial[0]
        value, c, at = trial
        if size < 1e-8 or gained < 1e-6:
            return c, step, True
    return c, max_steps, False


def _by_excess(problem: ProfileProblem, prior: np.ndarray, steps: int = 6) -> np.ndarray:
    """Start of a search: c for which the stress equals the threshold at the measured arrests."""
    c = np.zeros(len(problem.mean))
    for _ in range(steps):
        at = problem.excess(problem.mean + prior @ c)
        noise = problem.sigma * np.maximum(abs(at.slope), 1e-4)
        if not np.isfinite(at.value).all():
            break
        c = at.derivative.T @ condition(at.derivative @ (prior @ c) - at.value, at.derivative, noise, prior).coefficient
    return c
