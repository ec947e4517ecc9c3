r"""A smooth function of position as a Gaussian process, and what linear data say about it.

The unknown u is the profile at its knots, and possibly a number or two beside it. Data d = μ + G (u − m) + noise of
covariance Σ, and a prior of covariance K, give with S = G K Gᵀ + Σ

    mean m + K Gᵀ S⁻¹ (d − μ),   covariance K − K Gᵀ S⁻¹ G K,   resolution R = K Gᵀ S⁻¹ G,   ln evidence −½ zᵀS⁻¹z − ½ ln|2πS|,

with z = d − μ. The mean is m + R (truth − m) + noise: row i of R is the averaging kernel of knot i, and the trace of R counts
the numbers that the data, rather than the prior, determine. K is never inverted, so it may be singular: pinned, or very smooth.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Smoothness(NamedTuple):
    """Settings of a prior."""

    amplitude: float  # standard deviation of the profile about its mean, in the unit of the profile
    length_scale: float  # distance over which it varies, in λc


class Posterior(NamedTuple):
    """What linear data say of u, for one `Smoothness`."""

    mean: Float[np.ndarray, " k"]  # of u − m
    covariance: Float[np.ndarray, "k k"]
    resolution: Float[np.ndarray, "k k"]
    log_evidence: float
    coefficient: Float[np.ndarray, " n"]  # S⁻¹ z


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
        Standard deviation of an unknown constant added to it.
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
) -> Posterior:
    """Posterior of u − m from z = G (u − m) + noise.

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
    return Posterior(
        mean=gain @ coefficient,
        covariance=prior - white.T @ white,
        resolution=white.T @ np.linalg.solve(factor, design),
        log_evidence=float(-residual @ residual / 2 - np.log(np.diag(factor)).sum() - len(z) * np.log(2 * np.pi) / 2),
        coefficient=coefficient,
    )


def mixture(posteriors: list[Posterior], weight: Float[np.ndarray, " h"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, covariance and resolution of several settings of the prior together, each with its probability."""
    pairs = list(zip(weight, posteriors, strict=True))
    mean = np.sum([w * p.mean for w, p in pairs], axis=0)
    covariance = np.sum([w * (p.covariance + np.outer(p.mean - mean, p.mean - mean)) for w, p in pairs], axis=0)
    return mean, covariance, np.sum([w * p.resolution for w, p in pairs], axis=0)
