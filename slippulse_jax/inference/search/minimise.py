"""Minimisation from many starts at once.

A fit is thousands of small minimisations: starts, nodes of profiles, replicates of a bootstrap. All are lanes of one call of
`minimise`, by Levenberg–Marquardt or by an optimiser of optax; the model is evaluated for the lanes still at work, in one batch
per step.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit, logit

from slippulse_jax.base.domains import check_choice
from slippulse_jax.base.status import Status
from slippulse_jax.inference.choices import Method
from slippulse_jax.inference.search.likelihood import Evaluation, Problem

TOLERANCE = 1e-12
"""Newton decrement g·H⁻¹g, over the value where that exceeds 1, at which a minimum is found: 10⁻⁶ standard errors away."""
GAUSS_NEWTON_STEPS = 12  # before the full second derivative is used
BEND_KEPT = 4  # steps for which its part beside the metric is kept, which costs many times as much
AT_SIDE = 12.0  # of an optimiser of optax: |z| from which on θ is at a side of the box
ADAM_STEPS = 20  # of optax.adam for each one allowed
PROMISING, PATIENCE = 8.0, 5  # half the deviance above the least of starts that go on, and for how many times the steps
BLURS, BLURRED = (1.0, 0.1, 0.01, 0.001), 1e-2
"""Blurs, in λc, through which the edges of counts are sharpened, and the Newton decrement at which each is left."""


Target = Callable[[np.ndarray, np.ndarray, int], Evaluation]
"""Function to minimise: of points (B, p), the replicate of each (B,), and the order of the derivatives wanted."""


class Convergence(Status):
    """How the minimisation from one start ended."""

    CONVERGED = 0, "converged"
    FLAT = 1, "flat: no measurement responds here"
    NOT_CONVERGED = 2, "did not converge within the allowed steps"
    NO_LENGTH = 3, "started where the front never stops, which these measurements exclude"


class Descents(NamedTuple):
    """Where each start ended."""

    theta: np.ndarray  # (B, p)
    value: np.ndarray  # (B,)
    convergence: np.ndarray  # (B,), a `Convergence`


def minimise(
    objective: Target,
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    held: np.ndarray | None = None,
    lane: np.ndarray | None = None,
    method: Method = "lm",
    max_steps: int = 60,
    tolerance: float = TOLERANCE,
    enough: float = np.inf,
) -> Descents:
    """Minimise within the box from every start.

    Parameters
    ----------
    objective : callable
        Of points, replicates and the order of derivatives, as a `Problem`; for methods of optax with a JAX function `traced`.
    start : array, shape (B, p)
    low, high : array, shape (p,) or (B, p)
        The box, of all or of each. A minimum may lie on its sides.
    held : array of bool, shape (p,), optional
        Fixed coordinates, of "lm".
    lane : array of int, shape (B,), optional
        Replicate of each start, of "lm".
    method : {"lm", "lbfgs", "adam"}
        docs/appendix/coverage.md compares them.
    max_steps : int
        Steps allowed each start; Adam gets `ADAM_STEPS` times as many.
    tolerance : float
        Newton decrement at which a minimum is found; as `TOLERANCE`.
    enough : float
        Value above which no minimum matters: a start of "lm" ends where a step of Newton's method falls short of it by far.
    """
    check_choice("method", method, Method)
    start = np.clip(np.atleast_2d(np.array(start, dtype=np.float64)), low, high)
    low, high = np.broadcast_to(low, start.shape), np.broadcast_to(high, start.shape)
    held = np.zeros(start.shape[1], dtype=bool) if held is None else held
    lane = np.zeros(len(start), dtype=int) if lane is None else lane
    if held.all():
        value = objective(start, lane, 0).value
        ends = np.where(np.isfinite(value), Convergence.CONVERGED, Convergence.NO_LENGTH)
        return Descents(start, value, ends)
    if method != "lm":
        return _by_optax(method, objective, start, low, high, max_steps)
    return _levenberg_marquardt(objective, start, low, high, held, lane, tolerance, max_steps, enough=enough)


def descend(problem: Problem, start: np.ndarray, **options: Any) -> Descents:
    """Minimise a deviance, through ever sharper counts and limits.

    No step follows their edges.
    """
    low, high = problem.parameters.low, problem.parameters.high
    sharp = problem.blurred(BLURS[0]) is not problem
    for blur in BLURS if sharp else ():
        first = options | {"method": "lm", "max_steps": GAUSS_NEWTON_STEPS - 1, "tolerance": BLURRED}
        start = minimise(problem.blurred(blur), start, low, high, **first).theta
    ends = minimise(problem, start, low, high, **options)
    left = (ends.convergence == Convergence.NOT_CONVERGED) & (ends.value <= ends.value.min(initial=np.inf) + PROMISING)
    if sharp and left.any() and options["method"] == "lm":  # valleys between edges are followed by small steps
        again = minimise(problem, ends.theta[left], low, high, max_steps=PATIENCE * options["max_steps"])
        for mine, theirs in zip(ends, again, strict=True):
            mine[left] = theirs
    return ends


def _levenberg_marquardt(
    objective: Target,
    theta: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    held: np.ndarray,
    lane: np.ndarray,
    tolerance: float,
    max_steps: int,
    *,
    enough: float,
) -> Descents:
    """Take damped steps, each lane with its own damping (Moré)."""
    value, gradient, metric = (x.copy() for x in objective(theta, lane, 1)[:3])
    damping, size, bend = np.full(len(theta), 1e-3), np.zeros_like(theta), np.zeros_like(metric)
    ends = np.where(np.isfinite(value), Convergence.NOT_CONVERGED, Convergence.NO_LENGTH)
    work = np.nonzero(np.isfinite(value))[0]
    for count in range(max_steps + 1):
        order = 1 if count < GAUSS_NEWTON_STEPS or (count - GAUSS_NEWTON_STEPS + 1) % BEND_KEPT else 2
        if count == GAUSS_NEWTON_STEPS and len(work):
            curvature = objective(theta[work], lane[work], 2).curvature
            bend[work] = curvature - metric[work]
            metric[work] = _positive(curvature, metric[work])
        g, m = gradient[work], metric[work]
        # held, or pushed against a side of the box
        stuck = held | (theta[work] <= low[work]) & (g > 0) | (theta[work] >= high[work]) & (g < 0)
        g, m = _without(g, m, stuck)
        diagonal = np.einsum("bpp->bp", m)
        size[work] = np.maximum(size[work], diagonal)
        flat = np.all((diagonal == 0) | stuck, axis=1) & ~np.any(g, axis=1)
        scale = np.maximum(1, np.abs(value[work]))
        left = _decrement(g, m, size[work])
        done = flat | (left <= tolerance * scale)
        ends[work[done]] = np.where((flat & ~stuck.all(axis=1))[done], Convergence.FLAT, Convergence.CONVERGED)
        done |= value[work] - left > enough  # the model of the value expects it to fall by half of `left`
        work, g, m, left, scale = (x[~done] for x in (work, g, m, left, scale))
        if not len(work) or count == max_steps:
            break
        step = _step(g, m, size[work], damping[work])
        trial = np.clip(theta[work] + step, low[work], high[work])
        step = trial - theta[work]
        tried = objective(trial, lane[work], order)
        square = np.einsum("bp,bpq,bq->b", step, m, step)
        expected = -(g * step).sum(axis=1) - square / 2
        gained = value[work] - tried.value
        better = gained > 0
        # a gain this small is lost in the rounding of the value; the step is accepted because the gradient predicts it
        tiny = np.abs(gained) <= 1e-13 * scale
        accept = better | tiny & (expected <= 1e-10 * scale)
        with np.errstate(invalid="ignore"):
            share = gained / np.where(expected > 0, expected, np.inf)
        factor = np.where(accept & (share > 0.75), 0.1, np.where(accept & (share > 0.25), 1.0, np.where(accept, 3.0, 8.0)))
        damping[work] = np.clip(damping[work] * factor, 1e-9, 1e12)
        moved = work[accept]
        theta[moved], value[moved] = trial[accept], tried.value[accept]
        gradient[moved] = tried.gradient[accept]
        metric[moved] = tried.metric[accept]
        if order == 2:
            bend[moved] = tried.curvature[accept] - metric[moved]
        if count >= GAUSS_NEWTON_STEPS:
            metric[moved] = _positive(metric[moved] + bend[moved], metric[moved])
        edge = ~accept & (square <= tolerance * scale)  # beside a step of a length no move gains, however small
        ends[work[edge]] = Convergence.CONVERGED
        work = work[~edge]
    return Descents(theta, value, ends)


def _without(g: np.ndarray, m: np.ndarray, stuck: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and metric with the coordinates that cannot move taken out."""
    free = ~stuck
    return g * free, m * (free[:, :, None] & free[:, None, :])


def _step(g: np.ndarray, m: np.ndarray, size: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """−(M + λ diag(size))⁻¹ g, in units of the diagonal."""
    unit = np.sqrt(np.where(size > 0, size, 1))
    scaled = m / unit[:, :, None] / unit[:, None, :]
    p = g.shape[1]
    scaled[:, range(p), range(p)] += damping[:, None] + 1e-14
    # a coordinate taken out has an empty row: its step is zero whatever its diagonal
    empty = np.einsum("bpp->bp", m) == 0
    scaled[:, range(p), range(p)] += empty
    return -np.linalg.solve(scaled, (g / unit)[:, :, None])[:, :, 0] / unit


def _decrement(g: np.ndarray, m: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Newton decrement g·M⁻¹g: twice the fall that is expected."""
    return -(g * _step(g, m, size, np.full(len(g), 1e-12))).sum(axis=1)


def _positive(curvature: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Turn negative curvature upward, so that steps leave saddles downhill."""
    unit = np.sqrt(np.maximum(np.einsum("bpp->bp", metric), np.abs(np.einsum("bpp->bp", curvature))))
    unit = np.where(unit > 0, unit, 1)
    values, vectors = np.linalg.eigh(curvature / unit[:, :, None] / unit[:, None, :])
    upward = np.maximum(np.abs(values), 1e-12)
    return np.einsum("bpk,bk,bqk->bpq", vectors, upward, vectors) * unit[:, :, None] * unit[:, None, :]


def _by_optax(method: Method, objective: Any, start: np.ndarray, low: np.ndarray, high: np.ndarray, max_steps: int) -> Descents:
    """Descend by optax from every start, over the logit of θ."""
    import jax
    import jax.numpy as jnp
    import optax

    box, rounds = (low[0], high[0] - low[0]), max_steps * (ADAM_STEPS if method == "adam" else 1)

    def cost(z: Any) -> Any:
        return objective.traced(box[0] + box[1] * jax.nn.sigmoid(z))

    @jax.jit
    @jax.vmap
    def ends_of(z: Any) -> Any:
        optimiser = optax.lbfgs() if method == "lbfgs" else optax.adam(optax.cosine_decay_schedule(0.1, rounds))
        value_and_slope = optax.value_and_grad_from_state(cost) if method == "lbfgs" else jax.value_and_grad(cost)

        def step(_: Any, now: Any) -> Any:
            z, state = now
            value, slope = value_and_slope(z, state=state) if method == "lbfgs" else value_and_slope(z)
            more = {"value": value, "grad": slope, "value_fn": cost} if method == "lbfgs" else {}
            change, state = optimiser.update(slope, state, z, **more)
            return z + change, state

        return jax.lax.fori_loop(0, rounds, step, (z, optimiser.init(z)))[0]

    with jax.enable_x64(True):
        z = np.asarray(ends_of(jnp.asarray(logit(np.clip((start - box[0]) / box[1], 1e-6, 1 - 1e-6)))))
    theta = box[0] + box[1] * expit(z)
    at = objective(theta, np.zeros(len(theta), int), 2)
    g, m = at.gradient, _positive(at.curvature, at.metric)
    flat = ~np.any(np.einsum("bpp->bp", at.metric), axis=1)
    # at a side of the box nothing falls any farther
    done = _decrement(*_without(g, m, np.abs(z) > AT_SIDE), np.einsum("bpp->bp", m)) <= 1e-4
    kinds = [~np.isfinite(at.value), flat, done]
    ends = np.select(kinds, [Convergence.NO_LENGTH, Convergence.FLAT, Convergence.CONVERGED], Convergence.NOT_CONVERGED)
    return Descents(theta, at.value, ends)
