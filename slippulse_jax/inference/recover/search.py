"""The smooth profile that fits best: Gauss–Newton steps, and the evidence of the settings of the prior where they end."""

from typing import NamedTuple

import numpy as np

from slippulse_jax.inference.recover.model import Look, ProfileModel
from slippulse_jax.inference.recover.prior import Posterior, Smoothness, condition, squared_exponential

ENOUGH = 4
"""Lengths from which on the evidence chooses amplitude and length scale; fewer cannot tell, and all settings count alike."""

LEVEL = 0.3
"""Standard deviation of the unknown mean prestress, in σ_s."""

KINK = 0.1
"""Square of the last step, in the prior's standard deviations, below which a search that cannot descend further has arrived."""


class Problem(NamedTuple):
    """What is searched: u, the values at the knots and the shift of ln k."""

    model: ProfileModel
    sigma: np.ndarray  # (n,), in λc
    mean: np.ndarray  # (k + 1,), of u
    log_stiffness_sd: float

    def prior(self, smoothness: Smoothness) -> np.ndarray:
        """Covariance of u."""
        k = len(self.mean) - 1
        covariance = np.zeros((k + 1, k + 1))
        pinned = self.model.kind == "threshold"
        covariance[:k, :k] = squared_exponential(self.model.knots, smoothness, level=0.0 if pinned else LEVEL, pinned=pinned)
        covariance[k, k] = self.log_stiffness_sd**2
        return covariance


class Found(NamedTuple):
    """Outcome of a search."""

    posteriors: list[Posterior]  # of each setting, linearised where the search ended
    weight: np.ndarray  # their probabilities
    prior_misfit: float  # (u − m)ᵀK⁻¹(u − m)
    converged: bool
    steps: int


def search(problem: Problem, settings: list[Smoothness], max_steps: int) -> Found:
    """Gauss–Newton under the setting of most evidence, and the evidence anew where it ended, until the setting stays."""
    priors = [problem.prior(s) for s in settings]
    weight = np.full(len(settings), 1 / len(settings))
    best, total, tried = len(settings) // 2, 0, set()
    while True:
        c, steps, converged = _descend(problem, priors[best], max_steps)
        total += steps
        place = priors[best] @ c
        at = problem.model.lengths(problem.mean + place)
        z = problem.model.measured - at.value + at.derivative @ place
        posteriors = [condition(z, at.derivative, problem.sigma, prior) for prior in priors]
        if len(z) >= ENOUGH:
            evidence = np.array([p.log_evidence for p in posteriors])
            weight = np.exp(evidence - evidence.max())
            weight /= weight.sum()
        tried.add(best)
        best = int(np.argmax(weight)) if len(z) >= ENOUGH else best
        if best in tried:
            return Found(posteriors, weight, float(c @ place), converged, total)


def _descend(problem: Problem, prior: np.ndarray, max_steps: int) -> tuple[np.ndarray, int, bool]:
    """Where χ² + (u − m)ᵀK⁻¹(u − m) is least, as c with u − m = K c; only steps that descend are taken."""
    measured, sigma = problem.model.measured, problem.sigma

    def look(c: np.ndarray) -> tuple[float, np.ndarray, Look]:
        at = problem.model.lengths(problem.mean + prior @ c)
        value = (((at.value - measured) / sigma) ** 2).sum() + c @ prior @ c
        return (value if np.isfinite(value) else np.inf), c, at

    value, c, at = min((look(c) for c in (np.zeros(len(problem.mean)), _by_excess(problem, prior))), key=lambda found: found[0])
    for step in range(1, max_steps + 1):
        z = measured - at.value + at.derivative @ (prior @ c)
        move = at.derivative.T @ condition(z, at.derivative, sigma, prior).coefficient - c
        size = move @ prior @ move
        for fraction in 0.5 ** np.arange(14):
            trial = look(c + fraction * move)
            if trial[0] < value:
                break
        else:
            # no lower along the step: rounding if it is small, a kink of ℓ at a site if it is not
            return c, step, bool(size < KINK)
        gained = value - trial[0]
        value, c, at = trial
        if size < 1e-8 or gained < 1e-6:
            return c, step, True
    return c, max_steps, False


def _by_excess(problem: Problem, prior: np.ndarray, steps: int = 6) -> np.ndarray:
    """A start: c for which the stress equals the threshold at the measured arrests."""
    c = np.zeros(len(problem.mean))
    for _ in range(steps):
        at = problem.model.excess(problem.mean + prior @ c)
        noise = problem.sigma * np.maximum(abs(at.slope), 1e-4)
        if not np.isfinite(at.value).all():
            break
        c = at.derivative.T @ condition(at.derivative @ (prior @ c) - at.value, at.derivative, noise, prior).coefficient
    return c
