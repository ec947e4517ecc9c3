"""Bootstrap: refits of simulated or resampled measurements, all at once."""

import dataclasses
from typing import Any

import numpy as np

from slippulse_jax.inference.fitted import LEVELS, Fitted
from slippulse_jax.inference.likelihood import STUDENT_DOF, Problem
from slippulse_jax.inference.optimise import Convergence, minimise

KINDS = ("parametric", "case")
MOST_STARTS = 4


class Samples:
    """Samples of the parameters: refits, or draws from a posterior."""

    names: tuple[str, ...]
    values: np.ndarray  # (…, parameters), in the units of the parameters

    def of(self, name: str) -> np.ndarray:
        """All samples of one parameter, shape (count,)."""
        return self.values[..., self.names.index(name)].ravel()

    def stderr(self, name: str) -> float:
        """Standard deviation of a parameter."""
        return float(self.of(name).std(ddof=1))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Central interval of a parameter, by its percentiles."""
        low, high = np.quantile(self.of(name), [(1 - level) / 2, (1 + level) / 2])
        return float(low), float(high)

    def summary(self) -> dict[str, Any]:
        """Standard deviations and intervals of all parameters as plain Python values."""
        return {
            "stderr": {name: self.stderr(name) for name in self.names},
            "intervals": {name: {f"{level:g}": list(self.interval(name, level)) for level in LEVELS} for name in self.names},
        }

    def line(self, name: str) -> str:
        """Summarise one parameter in a line."""
        low, high = self.interval(name)
        mean, sd = self.of(name).mean(), self.stderr(name)
        return f"  {name}: mean {mean:.5g}, standard deviation {sd:.3g}, 95% {low:.5g} to {high:.5g}"


@dataclasses.dataclass(frozen=True, eq=False)
class Bootstrap(Samples):
    """Refits of one kind, one row per replicate that converged."""

    kind: str
    seed: int
    names: tuple[str, ...]  # of the columns
    theta: np.ndarray  # (count, p)
    values: np.ndarray  # (count, p), in the units of the parameters
    deviance: np.ndarray  # (count,)
    lost: int  # replicates whose refit did not converge
    at_bound: dict[str, float]  # share of the refits that end at a limit of each parameter

    def to_dict(self) -> dict[str, Any]:
        """Summary as plain Python values."""
        return {
            "kind": self.kind,
            "count": len(self.theta),
            "seed": self.seed,
            "lost": self.lost,
            **self.summary(),
            "at_bound": self.at_bound,
        }

    def __str__(self) -> str:
        rows = [f"{self.kind} bootstrap, {len(self.theta)} refits (seed {self.seed}; {self.lost} did not converge)"]
        rows += [f"{self.line(name)}; {self.at_bound[name]:.1%} at a limit" for name in self.names]
        return "\n".join(rows)


def bootstrap(result: Fitted, count: int = 1000, *, kind: str = "parametric", seed: int = 0) -> Bootstrap:
    """Refit simulated or resampled measurements `count` times.

    Parameters
    ----------
    result : FitResult
    count : int
    kind : {"parametric", "case"}
        New measurements drawn from the fitted model with the stated errors (and new values of the inputs from their priors);
        or the measurements themselves, drawn with replacement, which relies on neither the model nor σ.
    seed : int

    Returns
    -------
    Bootstrap

    Raises
    ------
    ValueError
        If there is nothing to resample.

    Notes
    -----
    Every refit starts at each minimum of the fit that is not excluded (up to four) and keeps the best end, so that a second
    root shows as a second heap. A front that ran past a length without arrest stays one in every replicate.
    """
    if kind not in KINDS:
        raise ValueError(f"kind = {kind!r}: one of {', '.join(KINDS)}")
    if count < 2:
        raise ValueError(f"count = {count}: at least 2 refits are needed")
    if kind == "case" and len(result.measurements) < 2:
        raise ValueError("one measurement cannot be resampled: use kind = 'parametric'")
    rng = np.random.default_rng(seed)
    problem = simulated(result, count, rng) if kind == "parametric" else _resampled(result, count, rng)
    q = result.parameters
    theta, deviance, good = refitted(result, problem, count)
    theta = theta[good]
    values = np.stack([one.value(column) for one, column in zip(q.free, theta.T, strict=True)], axis=1)
    reach = 1e-6 * (q.high - q.low)
    limits = ((theta <= q.low + reach) | (theta >= q.high - reach)).mean(axis=0)
    return Bootstrap(
        kind=kind,
        seed=seed,
        names=tuple(q.names),
        theta=theta,
        values=values,
        deviance=deviance[good],
        lost=int((~good).sum()),
        at_bound=dict(zip(q.names, limits.tolist(), strict=True)),
    )


def refitted(result: Fitted, problem: Problem, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """θ, deviance and convergence of the best refit per replicate; converged refits come before others."""
    starts = np.array([one.theta for one in result.roots[:MOST_STARTS]] or [result.theta])
    q, many = result.parameters, len(starts)
    lane = np.repeat(np.arange(count), many)
    ends = minimise(problem, np.tile(starts, (count, 1)), q.low, q.high, lane=lane)
    value, good = (x.reshape(count, many) for x in (ends.value, ends.convergence != Convergence.NOT_CONVERGED))
    best = np.where(good | ~good.any(axis=1, keepdims=True), value, np.inf).argmin(axis=1)
    chosen = np.arange(count), best
    return ends.theta.reshape(count, many, -1)[chosen], 2 * value[chosen], good[chosen] & np.isfinite(value[chosen])


def simulated(result: Fitted, count: int, rng: np.random.Generator) -> Problem:
    """Draw measurements from the fitted model, and new values of the inputs from their priors."""
    problem, q = result.problem, result.parameters
    values, weights = {}, {}
    for block in problem.blocks:
        mu = problem.predict(result.theta, block.observable)[0]
        sigma = block.data.sigma
        student = problem.loss == "student"
        noise = rng.standard_t(STUDENT_DOF, (count, len(mu))) if student else rng.standard_normal((count, len(mu)))
        drawn = mu + sigma * noise
        whole, beyond = block.data.kind == "whole", block.data.kind == "at_least"
        drawn = np.where(whole, np.maximum(np.ceil(drawn), 1), drawn)
        values[block.observable] = np.where(beyond, block.data.value[0], drawn)
        weights[block.observable] = np.ones((count, len(mu)))
    spread = np.array([one.prior_sigma for one in q.free])
    means = np.repeat(problem.prior_mean, count, axis=0)
    known = np.isfinite(spread)
    means[:, known] = result.theta[known] + spread[known] * rng.standard_normal((count, int(known.sum())))
    return problem.with_replicates(values, weights, means)


def _resampled(result: Fitted, count: int, rng: np.random.Generator) -> Problem:
    problem, n = result.problem, len(result.measurements)
    often = rng.multinomial(n, np.full(n, 1 / n), size=count).astype(float)
    values = {block.observable: np.repeat(block.data.value, count, axis=0) for block in problem.blocks}
    weights = {block.observable: often[:, block.measurement] for block in problem.blocks}
    return problem.with_replicates(values, weights, np.repeat(problem.prior_mean, count, axis=0))
