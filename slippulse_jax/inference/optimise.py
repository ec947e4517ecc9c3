"""Minimise from many starts at once: Gauss and Newton's method with Levenberg and Marquardt's damping, or optax.

A fit is thousands of small minimisations: starts, nodes of profiles, replicates of a bootstrap. All are lanes of one call;
the model is evaluated for the lanes still at work, in one batch a step.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from slippulse_jax.inference.objective import Evaluation
from slippulse_jax.status import Status

METHODS = ("lm", "lbfgs", "adam")
TOLERANCE = 1e-12
"""Newton decrement g·H⁻¹g, over the value where that exceeds 1, at which a minimum is found: 10⁻⁶ standard errors away."""
GAUSS_NEWTON_STEPS = 12  # before the whole second derivative is asked for
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e12


class Outcome(Status):
    """What became of one start."""

    CONVERGED = 0, "converged"
    FLAT = 1, "flat: nothing measured responds here, so that nothing was learnt"
    NOT_CONVERGED = 2, "did not converge within the allowed steps"
    NO_LENGTH = 3, "started where the front never stops, which these measurements exclude"


class Objective(Protocol):
    """Any function to minimise: of points (B, p) and replicates (B,), with derivatives to `order`."""

    def __call__(self, theta: np.ndarray, lane: np.ndarray | None = None, order: int = 0) -> Evaluation:
        """Value, and gradient and metric from order 1, the whole second derivative at order 2."""
        ...


class Starts(NamedTuple):
    """What is minimised, from where, and within which box."""

    objective: Objective
    theta: np.ndarray  # (B, p)
    low: np.ndarray  # (B, p)
    high: np.ndarray  # (B, p)
    held: np.ndarray  # (p,), coordinates that stay where they start
    lane: np.ndarray  # (B,), replicate of each


class Minimum(NamedTuple):
    """Where each start ended."""

    theta: np.ndarray  # (B, p)
    value: np.ndarray  # (B,)
    outcome: np.ndarray  # (B,), an `Outcome`
    steps: np.ndarray  # (B,)


def minimise(
    objective: Objective,
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    held: np.ndarray | None = None,
    lane: np.ndarray | None = None,
    method: str = "lm",
    max_steps: int = 60,
) -> Minimum:
    """Minimise within the box from every start.

    Parameters
    ----------
    objective : callable
        As `Objective`.
    start : array, shape (B, p)
    low, high : array, shape (p,) or (B, p)
        The box, of all or of each. A minimum may lie on its sides.
    held : array of bool, shape (p,), optional
        Coordinates that stay where they start.
    lane : array of int, shape (B,), optional
        Replicate of each start.
    method : {"lm", "lbfgs", "adam"}
        Levenberg–Marquardt by default; the others are optax's.
    max_steps : int
        Steps allowed each start; optax's Adam gets twenty times as many.
    """
    if method not in METHODS:
        raise ValueError(f"method = {method!r}: one of {', '.join(METHODS)}")
    start = np.clip(np.atleast_2d(np.array(start, dtype=np.float64)), low, high)
    low, high = np.broadcast_to(low, start.shape), np.broadcast_to(high, start.shape)
    held = np.zeros(start.shape[1], dtype=bool) if held is None else held
    lane = np.zeros(len(start), dtype=int) if lane is None else lane
    if held.all():
        value = objective(start, lane).value
        ends = np.where(np.isfinite(value), Outcome.CONVERGED, Outcome.NO_LENGTH)
        return Minimum(start, value, ends, np.zeros(len(start), dtype=int))
    run = {"lm": _levenberg_marquardt, "lbfgs": _lbfgs, "adam": _adam}[method]
    return run(Starts(objective, start, low, high, held, lane), max_steps)


def _levenberg_marquardt(given: Starts, max_steps: int) -> Minimum:
    """Damped steps; each lane has its own damping, and its own largest metric so far as the measure of a step (Moré)."""
    objective, theta, low, high, held, lane = given
    at = objective(theta, lane, 1)
    assert at.gradient is not None
    assert at.metric is not None
    value, gradient, metric = at.value.copy(), at.gradient.copy(), at.metric.copy()
    damping, size = np.full(len(theta), FIRST_DAMPING), np.zeros_like(theta)
    outcome = np.where(np.isfinite(value), Outcome.NOT_CONVERGED, Outcome.NO_LENGTH)
    steps = np.zeros(len(theta), dtype=int)
    work = np.nonzero(np.isfinite(value))[0]
    for count in range(max_steps + 1):
        order = 1 if count < GAUSS_NEWTON_STEPS else 2
        if count == GAUSS_NEWTON_STEPS and len(work):
            metric[work] = _positive(_second(objective(theta[work], lane[work], 2)), metric[work])
        g, m = gradient[work], metric[work]
        stuck = held | (theta[work] <= low[work]) & (g > 0) | (theta[work] >= high[work]) & (g < 0)
        g, m = _without(g, m, stuck)
        diagonal = np.einsum("bpp->bp", m)
        size[work] = np.maximum(size[work], diagonal)
        flat = np.all((diagonal == 0) | stuck, axis=1) & ~np.any(g, axis=1)
        decrement = -(g * _step(g, m, size[work], np.full(len(work), 1e-12))).sum(axis=1)
        done = flat | (decrement <= TOLERANCE * np.maximum(1, np.abs(value[work])))
        outcome[work[done]] = np.where((flat & ~stuck.all(axis=1))[done], Outcome.FLAT, Outcome.CONVERGED)
        work, g, m = work[~done], g[~done], m[~done]
        if not len(work) or count == max_steps:
            break
        step = _step(g, m, size[work], damping[work])
        trial = np.clip(theta[work] + step, low[work], high[work])
        step = trial - theta[work]
        tried = objective(trial, lane[work], order)
        expected = -(g * step).sum(axis=1) - np.einsum("bp,bpq,bq->b", step, m, step) / 2
        gained = value[work] - tried.value
        better = gained > 0
        # rounding of the value hides a gain this small: the step is then taken on trust in the gradient
        tiny = np.abs(gained) <= 1e-13 * np.maximum(1, np.abs(value[work]))
        accept = better | tiny & (expected <= 1e-10 * np.maximum(1, np.abs(value[work])))
        share = gained / np.where(expected > 0, expected, np.inf)
        factor = np.where(accept & (share > 0.75), 0.1, np.where(accept & (share > 0.25), 1.0, np.where(accept, 3.0, 8.0)))
        damping[work] = np.clip(damping[work] * factor, LEAST_DAMPING, MOST_DAMPING)
        moved = work[accept]
        theta[moved], value[moved] = trial[accept], tried.value[accept]
        assert tried.gradient is not None
        assert tried.metric is not None
        gradient[moved] = tried.gradient[accept]
        own = tried.metric[accept] if order == 1 else _positive(_second(tried)[accept], tried.metric[accept])
        metric[moved] = own
        steps[work] += 1
    return Minimum(theta, value, outcome, steps)


def _second(at: Evaluation) -> np.ndarray:
    assert at.curvature is not None
    return at.curvature


def _without(g: np.ndarray, m: np.ndarray, stuck: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and metric with the coordinates that cannot move taken out."""
    free = ~stuck
    return g * free, m * (free[:, :, None] & free[:, None, :])


def _step(g: np.ndarray, m: np.ndarray, size: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """−(M + λ diag(size))⁻¹ g, in units in which every diagonal element is about one."""
    unit = np.sqrt(np.where(size > 0, size, 1))
    scaled = m / unit[:, :, None] / unit[:, None, :]
    p = g.shape[1]
    scaled[:, range(p), range(p)] += damping[:, None] + 1e-14
    # a coordinate that was taken out has an empty row: its step is zero whatever stands on its diagonal
    empty = np.einsum("bpp->bp", m) == 0
    scaled[:, range(p), range(p)] += empty
    return -np.linalg.solve(scaled, (g / unit)[:, :, None])[:, :, 0] / unit


def _positive(curvature: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """The second derivative with its negative directions turned upward, so that a step leads downhill from a saddle too."""
    unit = np.sqrt(np.maximum(np.einsum("bpp->bp", metric), np.abs(np.einsum("bpp->bp", curvature))))
    unit = np.where(unit > 0, unit, 1)
    values, vectors = np.linalg.eigh(curvature / unit[:, :, None] / unit[:, None, :])
    upward = np.maximum(np.abs(values), 1e-12)
    return np.einsum("bpk,bk,bqk->bpq", vectors, upward, vectors) * unit[:, :, None] * unit[:, None, :]


def _adam(given: Starts, max_steps: int) -> Minimum:
    """optax.adam in units of a sixtieth of the box, its rate falling to nothing by a cosine."""
    import optax

    rounds = 20 * max_steps
    unit = (given.high - given.low) / 60
    optimiser = optax.adam(optax.cosine_decay_schedule(1.0, rounds))

    def propose(theta: np.ndarray, gradient: np.ndarray, state):
        updates, state = optimiser.update(gradient, state)
        return theta + np.asarray(updates), state

    return _descend(given, rounds, optimiser.init, propose, unit, careful=False)


def _lbfgs(given: Starts, max_steps: int) -> Minimum:
    """optax.scale_by_lbfgs a lane (vmapped), with a step halved until it gains; in units of the first metric."""
    import jax
    import optax

    optimiser = optax.scale_by_lbfgs(memory_size=10)
    first = given.objective(given.theta, given.lane, 1)
    assert first.metric is not None
    diagonal = np.einsum("bpp->bp", first.metric)
    unit = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1)), (given.high - given.low) / 60)

    def init(z: np.ndarray):
        return jax.vmap(optimiser.init)(z)

    update = jax.jit(jax.vmap(optimiser.update))

    def propose(z: np.ndarray, gradient: np.ndarray, state):
        updates, state = update(gradient, state, z)
        return z - np.asarray(updates), state

    return _descend(given, max_steps, init, propose, unit, careful=True)


def _descend(
    given: Starts,
    rounds: int,
    init: Callable,
    propose: Callable,
    unit: np.ndarray,
    *,
    careful: bool,
) -> Minimum:
    """Steps of an optax optimiser on z = θ/unit, clipped to the box; `careful` ones are halved until they gain."""
    import jax

    objective, theta, low, high, held, lane = given
    at = objective(theta, lane, 1)
    best, lowest = theta.copy(), at.value.copy()
    steps = np.zeros(len(theta), dtype=int)
    with jax.enable_x64(True):
        state = init(theta / unit)
        for _ in range(rounds):
            assert at.gradient is not None
            z = theta / unit
            target, state = propose(z, np.where(held, 0, at.gradient * unit), state)
            trial = np.where(held, theta, np.clip(target * unit, low, high))
            for _ in range(30 if careful else 0):
                worse = ~(objective(trial, lane).value <= at.value)
                if not worse.any():
                    break
                trial = np.where(worse[:, None], (trial + theta) / 2, trial)
            settled = np.all(np.abs(trial - theta) <= 1e-12 * np.maximum(1, np.abs(theta)), axis=1)
            steps += ~settled
            theta = trial
            at = objective(theta, lane, 1)
            gained = at.value < lowest
            best[gained], lowest[gained] = theta[gained], at.value[gained]
            if settled.all():
                break
    at = objective(best, lane, 2)
    assert at.gradient is not None
    assert at.metric is not None
    stuck = held | (best <= low) & (at.gradient > 0) | (best >= high) & (at.gradient < 0)
    g, m = _without(at.gradient, _positive(_second(at), at.metric), stuck)
    size = np.einsum("bpp->bp", m)
    decrement = -(g * _step(g, m, size, np.full(len(g), 1e-12))).sum(axis=1)
    flat = ~np.any(np.where(stuck, 0, np.einsum("bpp->bp", at.metric)), axis=1) & ~stuck.all(axis=1)
    ends = np.select(
        [~np.isfinite(lowest), flat, decrement <= 1e-4],
        [Outcome.NO_LENGTH, Outcome.FLAT, Outcome.CONVERGED],
        Outcome.NOT_CONVERGED,
    )
    return Minimum(best, lowest, ends, steps)
