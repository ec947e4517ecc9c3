r"""Information expected from an outcome y about weighted samples θ_i.

An experiment measures a length ℓ(θ) with a normal error σ, or counts whole contacts, ceil(ℓ + error); a front that never stops
is an outcome of its own. The expected information (mutual information, in nats) is

    I = Σ_i w_i ∫ dy p(y|θ_i) ln[p(y|θ_i)/p(y)],        p(y) = Σ_i w_i p(y|θ_i),

a one-dimensional quadrature for one experiment. For several, I is the mean of the same logarithm over (θ, y) drawn together:
p(y) being an exact sum over the samples, that estimate has no bias, and scrambled Sobol points give its standard error.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy.special import logsumexp, ndtri, xlogy

from slippulse_jax.inference.knowledge import Knowledge
from slippulse_jax.inference.likelihood import data_log_density

Kind = Literal["length", "whole"]

REACH = 7.0
"""Range of the outcomes summed over, in standard errors beyond the lengths."""

STEP = 0.25
"""Spacing of the outcomes summed over, in standard errors."""

SURE = 0.95
"""Smallest posterior of one root from which the roots count as distinguished."""

REPLICATES, POINTS = 8, 512
"""Number of scrambled Sobol sequences, and points of each."""


class Gain(NamedTuple):
    """Gain expected from one experiment, or from several together."""

    information: float  # nats
    error: float  # of the information: of the quadrature, or a standard error
    log_stderr: float  # expected standard deviation of θ afterwards
    told_apart: float  # probability that one root will have a posterior of `SURE` or more


def log_likelihood(y: np.ndarray, length: np.ndarray, sigma: float, kind: Kind) -> np.ndarray:
    """Logarithm ln p(y | ℓ) of the density that a fit has, without its constant; shape (n, m).

    Parameters
    ----------
    y : array, shape (n,)
        Outcomes; ∞ where the front did not stop.
    length : array, shape (m,)
    sigma : float
        Standard error; may be 0 for counts.
    kind : {"length", "whole"}
    """
    stops = np.isfinite(y)
    found = np.where(np.isinf(length), 0.0, -np.inf) + np.zeros((len(y), 1))
    found[stops] = data_log_density(length, y[stops, None], sigma, kind, exact=True)
    return found


def outcomes(length: np.ndarray, sigma: float, kind: Kind, step: float = STEP) -> tuple[np.ndarray, np.ndarray]:
    """Outcomes to sum over, and their weights, the constant of the density included; both of shape (n,)."""
    finite = length[np.isfinite(length)]
    y, dy = np.empty(0), np.empty(0)
    if finite.size:
        if kind == "length":
            # only near the lengths, which may lie in clumps far apart
            edges = np.unique(np.floor(finite[:, None] / sigma) + np.arange(-REACH, REACH + 1))
            y = (edges[:, None] + step * np.arange(round(1 / step))).ravel() * sigma
            dy = np.full(len(y), step / np.sqrt(2 * np.pi))
        else:
            low, high = np.floor(finite.min() - REACH * sigma), np.ceil(finite.max() + REACH * sigma)
            y = np.arange(max(low, 1), max(high, 1) + 1)
            dy = np.ones(len(y))
    if finite.size < length.size:
        y, dy = np.append(y, np.inf), np.append(dy, 1.0)
    return y, dy


def expected_gain(known: Knowledge, length: np.ndarray, sigma: float, kind: Kind) -> Gain:
    """Gain of one experiment whose length at each sample is `length`, shape (m,), by quadrature."""
    found = _quadrature(known, length, sigma, kind, STEP)
    thin, kept = thinned(known)
    coarse = _quadrature(thin, length[kept], sigma, kind, STEP), _quadrature(known, length, sigma, kind, 2 * STEP)
    error = max(abs(found.information - other.information) for other in coarse)
    return found._replace(error=error)


def thinned(known: Knowledge) -> tuple[Knowledge, np.ndarray]:
    """Keep every other sample of each root, with the probability of the root; also return their indices."""
    root, likely = known.labels, known.probability > 0
    kept = np.sort(np.concatenate([np.flatnonzero((root == r) & likely)[::2] for r in range(root.max() + 1)]))
    share = np.bincount(root, known.probability)[root[kept]]
    left = np.bincount(root[kept], known.probability[kept])[root[kept]]
    return Knowledge(known.theta[kept], known.probability[kept] * (share / left), root[kept]), kept


def _quadrature(known: Knowledge, length: np.ndarray, sigma: float, kind: Kind, step: float) -> Gain:
    y, dy = outcomes(length, sigma, kind, step)
    information = stderr = apart = 0.0
    for part in np.array_split(np.arange(len(y)), max(len(y) * len(length) // 2_000_000, 1)):
        p = np.exp(log_likelihood(y[part], length, sigma, kind))
        total = p @ known.probability
        # outcomes that no sample leads to have no probability
        seen = total > 0
        p, total, dy_seen = p[seen], total[seen], dy[part][seen]
        entropy = xlogy(p, p) @ known.probability - xlogy(total, total)
        information += dy_seen @ entropy
        sd, sure = _afterwards(known, p * known.probability / total[:, None])
        stderr += (dy_seen * total) @ sd
        apart += (dy_seen * total) @ sure
    return Gain(float(information), 0.0, float(stderr), float(apart))


def _afterwards(known: Knowledge, posterior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviation of θ, and whether one root is sure, for posteriors of shape (n, m)."""
    theta = known.theta - known.probability @ known.theta
    mean = posterior @ theta
    variance = posterior @ theta**2 - mean**2
    by_root = posterior @ (known.labels[:, None] == np.arange(known.labels.max() + 1))
    return np.sqrt(np.maximum(variance, 0)), by_root.max(axis=1) >= SURE


def draw(known: Knowledge, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw truths and errors for a sequence of experiments, common to all candidates.

    `REPLICATES` independently scrambled Sobol sequences, one after another.

    Returns
    -------
    truth : array of int, shape (n,)
        The sample that is the truth.
    noise : array, shape (n, steps)
        Standard normal.
    """
    from scipy.stats.qmc import Sobol

    rng = np.random.default_rng(seed)
    u = np.concatenate([Sobol(steps + 1, rng=rng).random(POINTS) for _ in range(REPLICATES)])
    truth = np.searchsorted(np.cumsum(known.probability), u[:, 0] * (1 - 1e-12))
    return np.minimum(truth, len(known) - 1), ndtri(np.clip(u[:, 1:], 1e-12, 1 - 1e-12))


def log_likelihoods(truth: np.ndarray, noise: np.ndarray, length: np.ndarray, sigma: float, kind: Kind) -> np.ndarray:
    """Logarithms ln p(y|θ_j) of the outcome of each draw of one experiment, for every sample j; shape (n, m)."""
    y = length[truth] + sigma * noise
    if kind == "length":
        return log_likelihood(y, length, sigma, kind)
    # far fewer counts than draws
    counts, own = np.unique(np.maximum(np.ceil(y), 1), return_inverse=True)
    return log_likelihood(counts, length, sigma, kind)[own]


def joint_gain(known: Knowledge, truth: np.ndarray, log_p: np.ndarray) -> Gain:
    """Gain of several experiments together; `log_p` is the sum of their `log_likelihoods`, shape (n, m)."""
    with np.errstate(divide="ignore"):
        joint = log_p + np.log(known.probability)
    total = np.asarray(logsumexp(joint, axis=1))
    own = log_p[np.arange(len(log_p)), truth]
    means = (own - total).reshape(REPLICATES, -1).mean(axis=1)
    sd, sure = _afterwards(known, np.exp(joint - total[:, None]))
    return Gain(float(means.mean()), float(means.std(ddof=1) / np.sqrt(REPLICATES)), float(sd.mean()), float(sure.mean()))
