"""Minimise χ² from several starts at once, each inside the bracket a scan found for it, with optax."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
import optax

from slippulse_jax.status import Status


class Outcome(Status):
    """What became of one start."""

    CONVERGED = 0, "converged"
    KINK = 1, "at a corner: the minimum lies where the length passes a whole number of contacts or a domino starts"
    FLAT = 2, "flat: the length does not respond here, so that nothing was learnt"
    NOT_CONVERGED = 3, "did not converge within the allowed steps"


class Local(NamedTuple):
    """χ²/2 and what it is made of near each θ; shapes (k,)."""

    value: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray  # Σ (ℓ'/σ)² + Σ r ℓ''/σ, the second derivative
    information: np.ndarray  # Σ (ℓ'/σ)², the part that the response of the lengths makes up


class Minimum(NamedTuple):
    """Where each start ended; shapes (k,)."""

    theta: np.ndarray
    local: Local
    outcome: np.ndarray


def minimise(
    near: Callable[[np.ndarray], Local], start: np.ndarray, low: np.ndarray, high: np.ndarray, *, max_steps: int = 60
) -> Minimum:
    """Minimise between `low` and `high` from every start at once.

    Steepest descent on the natural gradient (optax.sgd with rate 1 on g/h, h the curvature, or the Fisher information where
    that is the larger): chosen by measurement (benchmarks/optimisers.py). It reaches every minimum in as few steps as optax's
    L-BFGS, and needs the model compiled once, where a line search inside a compiled loop needs it four times. A bracket that
    the sign of the gradient shrinks keeps it safe: a step that would leave it is replaced by its middle. That also ends
    the search at a corner of ℓ(θ), which no descent on derivatives can.

    A start is called converged only where the length responds and g²/h says that the minimum is within 10⁻⁴ standard
    errors; a plateau, where it does not respond, is called flat.
    """
    optimiser = optax.sgd(1.0)
    box = low, high
    theta, low, high = (np.array(x, dtype=np.float64) for x in (start, low, high))
    with jax.enable_x64(True):
        state = optimiser.init(theta)
        for _ in range(max_steps):
            local = near(theta)
            low, high = np.where(local.gradient < 0, theta, low), np.where(local.gradient > 0, theta, high)
            updates, state = optimiser.update(local.gradient / _metric(local), state)
            proposal = theta + np.asarray(updates)
            proposal = np.where((proposal > low) & (proposal < high), proposal, (low + high) / 2)
            settled = (np.abs(proposal - theta) <= 1e-13 * np.maximum(1, np.abs(theta))) | (local.gradient == 0)
            if settled.all():
                break
            theta = np.where(settled, theta, proposal)
    collapsed = high - low <= 1e-11 * np.maximum(1, np.abs(theta))
    # where ℓ jumps the gradient leads past the lowest point, to a place higher than the start
    misled = near(theta).value > near(start).value * (1 + 1e-12)
    if misled.any():
        theta = np.where(misled, _by_value(near, *box), theta)
    local = near(theta)
    decrement = local.gradient**2 / _metric(local)
    ends = [Outcome.FLAT, Outcome.CONVERGED, Outcome.KINK]
    outcome = np.select(
        [local.information == 0, (decrement <= 1e-8) & ~misled, collapsed | misled], ends, Outcome.NOT_CONVERGED
    )
    return Minimum(theta, local, outcome)


def _metric(local: Local) -> np.ndarray:
    metric = np.maximum(local.curvature, local.information)
    return np.where(metric > 0, metric, 1)


def _by_value(near: Callable[[np.ndarray], Local], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Lowest point between `low` and `high` by comparing values alone, for χ² that falls, perhaps jumps, and rises."""
    for _ in range(70):  # each round leaves two thirds: 10⁻¹² of the bracket
        left, right = low + (high - low) / 3, high - (high - low) / 3
        falls = near(left).value > near(right).value
        low, high = np.where(falls, left, low), np.where(falls, high, right)
    return np.where(near(low).value <= near(high).value, low, high)
