"""Samples of the fitted parameters: refits, or draws from the posterior.

All refits of a bootstrap are one batch. The posterior is sampled by the No-U-Turn sampler, which needs the extra ``bayes``
(numpyro and ArviZ). Its density is that of the fit (`slippulse_jax.inference.search.likelihood.Problem.traced`); a parameter
without a prior is flat over the range searched, a positive one in its logarithm.
"""

import dataclasses
import sys
import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.special import expit, logit

from slippulse_jax.base.domains import check_choice
from slippulse_jax.base.files import plain
from slippulse_jax.inference.observables.observable import STUDENT_DOF
from slippulse_jax.inference.parameters import Free
from slippulse_jax.inference.search.intervals import LEVELS
from slippulse_jax.inference.search.likelihood import Problem
from slippulse_jax.inference.search.minimise import Convergence, minimise

if TYPE_CHECKING:
    import pandas as pd

    from slippulse_jax.inference.result.result import FitResult

Bootstrap = Literal["parametric", "case"]
"""Kinds of a bootstrap."""

GOOD_RHAT = 1.01
GOOD_ESS = 400.0


@dataclasses.dataclass(frozen=True, eq=False)
class Samples:
    """Samples of the fitted parameters."""

    kind: Bootstrap | Literal["posterior"]
    seed: int
    parameters: tuple[Free, ...]
    theta: np.ndarray  # (count, p) of the refits that converged, or (chains, samples, p) of the posterior
    deviance: np.ndarray | None = None  # (count,) of refits
    lost: int = 0  # replicates whose refit did not converge
    diverging: np.ndarray | None = None  # (chains, samples) whether the sampler diverged

    @property
    def names(self) -> tuple[str, ...]:
        """Labels of the parameters."""
        return tuple(one.label for one in self.parameters)

    @property
    def values(self) -> np.ndarray:
        """Samples in the units of the parameters, of the shape of `theta`."""
        columns = np.moveaxis(self.theta, -1, 0)
        return np.stack([one.value(column) for one, column in zip(self.parameters, columns, strict=True)], axis=-1)

    @property
    def at_bound(self) -> dict[str, float]:
        """Share of the samples at a limit of each parameter."""
        low, high = (np.array([getattr(one, end) for one in self.parameters]) for end in ("low", "high"))
        reach = 1e-6 * (high - low)
        there = (self.theta <= low + reach) | (self.theta >= high - reach)
        return dict(zip(self.names, there.reshape(-1, len(low)).mean(axis=0).tolist(), strict=True))

    @property
    def divergences(self) -> int:
        """Number of samples at which the sampler diverged."""
        return 0 if self.diverging is None else int(self.diverging.sum())

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

    def to_arviz(self) -> Any:
        """Return the samples for ArviZ; needs the extra ``bayes``.

        As ``az.summary`` and ``az.plot_trace`` take them.

        Returns
        -------
        arviz.InferenceData or xarray.DataTree
            What ArviZ of this version works on. The group ``posterior`` has the parameters in their units, by label; refits are
            one chain.
        """
        import xarray  # a quarter of a second, which a fit by itself need not take

        az = _arviz()
        values = self.values if self.values.ndim == 3 else self.values[None]
        where = {"chain": np.arange(len(values)), "draw": np.arange(values.shape[1])}
        columns = {
            one.label: (("chain", "draw"), column, {"units": one.unit})
            for one, column in zip(self.parameters, np.moveaxis(values, -1, 0), strict=True)
        }
        groups = {"posterior": xarray.Dataset(columns, where, {"seed": self.seed})}
        if self.diverging is not None:
            groups["sample_stats"] = xarray.Dataset({"diverging": (("chain", "draw"), self.diverging)}, where)
        before_1 = az.__version__.startswith("0.")
        return az.InferenceData(**groups) if before_1 else xarray.DataTree.from_dict(groups)  # pyright: ignore

    @cached_property
    def diagnostics(self) -> "pd.DataFrame":
        """ArviZ's diagnostics of convergence, one row per parameter.

        Of a posterior of at least two chains.
        """
        return _arviz().summary(self.to_arviz(), kind="diagnostics", round_to="none").loc[list(self.names)]

    @property
    def converged(self) -> bool:
        """Whether chains mix, or all refits converged.

        R-hat ≤ 1.01, at least 400 effective samples, and no divergence.
        """
        if self.kind != "posterior":
            return not self.lost
        table = self.diagnostics
        return bool((table.r_hat <= GOOD_RHAT).all() and (table.ess_bulk >= GOOD_ESS).all() and not self.divergences)

    def to_dict(self) -> dict[str, Any]:
        """Summary as plain Python values."""
        spread = {
            "stderr": {name: self.stderr(name) for name in self.names},
            "intervals": {name: {f"{level:g}": self.interval(name, level) for level in LEVELS} for name in self.names},
        }
        if self.kind != "posterior":
            of_refits = {"kind": self.kind, "count": len(self.theta), "seed": self.seed, "lost": self.lost}
            return plain({**of_refits, **spread, "at_bound": self.at_bound})
        chains, samples, _ = self.theta.shape
        return plain(
            {
                "chains": chains,
                "samples": samples,
                "seed": self.seed,
                "divergences": self.divergences,
                "converged": self.converged,
                "mean": {name: self.of(name).mean() for name in self.names},
                **spread,
                "rhat": self.diagnostics.r_hat.to_dict(),
                "ess": self.diagnostics.ess_bulk.to_dict(),
            }
        )

    def __str__(self) -> str:
        if self.kind == "posterior":
            chains, samples, _ = self.theta.shape
            title = f"posterior by NUTS, {chains} chains of {samples} (seed {self.seed}; {self.divergences} divergences)"
            table = self.diagnostics
            more = {name: f"R-hat {table.r_hat[name]:.3f}, ESS {table.ess_bulk[name]:.0f}" for name in self.names}
        else:
            title = f"{self.kind} bootstrap, {len(self.theta)} refits (seed {self.seed}; {self.lost} did not converge)"
            more = {name: f"{share:.1%} at a limit" for name, share in self.at_bound.items()}
        rows = [title]
        for name in self.names:
            low, high = self.interval(name)
            mean, sd = self.of(name).mean(), self.stderr(name)
            rows.append(f"  {name}: mean {mean:.5g}, standard deviation {sd:.3g}, 95% {low:.5g} to {high:.5g}; {more[name]}")
        if self.kind == "posterior" and not self.converged:
            rows.append(
                f"  not to be used: R-hat above {GOOD_RHAT}, fewer than {GOOD_ESS:.0f} effective samples, or divergences "
                "(two roots far apart stay unmixed)"
            )
        return "\n".join(rows)


def bootstrap(result: "FitResult", count: int = 1000, *, kind: Bootstrap = "parametric", seed: int = 0) -> Samples:
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
    Samples

    Raises
    ------
    ValueError
        If there is nothing to resample.

    Notes
    -----
    Every refit starts at each minimum of the fit that is not excluded (up to four) and keeps the best end, so that a second
    root shows as a second heap. A front that ran past a length without arrest stays one in every replicate.
    """
    check_choice("kind", kind, Bootstrap)
    if count < 2:
        raise ValueError(f"count = {count}: at least 2 refits are needed")
    if kind == "case" and result.problem.emulates:
        raise ValueError("kind = 'case': forces of a sequence err together, and cannot be drawn one by one: use 'parametric'")
    if kind == "case" and len(result.measurements) < 2:
        raise ValueError("one measurement cannot be resampled: use kind = 'parametric'")
    rng = np.random.default_rng(seed)
    problem = simulated(result, count, rng) if kind == "parametric" else _resampled(result, count, rng)
    theta, deviance, good = refitted(result, problem, count)
    free, lost = result.parameters.free, int((~good).sum())
    return Samples(kind, seed, free, theta[good], deviance[good], lost)


def refitted(result: "FitResult", problem: Problem, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """θ, deviance, convergence of the best refit, of converged ones first."""
    starts = np.array([one.theta for one in result.roots[:4]] or [result.theta])
    q, many = result.parameters, len(starts)
    lane = np.repeat(np.arange(count), many)
    ends = minimise(problem, np.tile(starts, (count, 1)), q.low, q.high, lane=lane)
    value, good = (x.reshape(count, many) for x in (ends.value, ends.convergence != Convergence.NOT_CONVERGED))
    best = np.where(good | ~good.any(axis=1, keepdims=True), value, np.inf).argmin(axis=1)
    chosen = np.arange(count), best
    return ends.theta.reshape(count, many, -1)[chosen], 2 * value[chosen], good[chosen] & np.isfinite(value[chosen])


def simulated(result: "FitResult", count: int, rng: np.random.Generator) -> Problem:
    """Draw measurements from the fit, and inputs from their priors."""
    problem, every = result.problem, []
    for data in problem.observed:
        mu, size = problem.predicted(result.theta, data)[0], (count, len(data.rows))
        noise = rng.standard_t(STUDENT_DOF, size) if problem.loss == "student" else rng.standard_normal(size)
        spread = (
            np.linalg.cholesky(problem.covariance(result.theta, data) + np.diag(data.sigma**2))
            if data.observable.emulated
            else None
        )
        drawn = mu + (data.sigma * noise if spread is None else noise @ spread.T)
        every.append(data.observable.simulated(drawn, data.value[0]))
    return problem.with_tables(result.theta, every, rng)


def _resampled(result: "FitResult", count: int, rng: np.random.Generator) -> Problem:
    problem, n = result.problem, len(result.measurements)
    often = rng.multinomial(n, np.full(n, 1 / n), size=count).astype(float)
    every = [(np.repeat(data.value, count, axis=0), often[:, data.measurement]) for data in problem.observed]
    return problem.with_replicates(every, np.repeat(problem.prior_mean, count, axis=0))


def posterior(
    result: "FitResult", *, samples: int = 1000, warmup: int = 500, chains: int = 4, seed: int = 0, progress: bool | None = None
) -> Samples:
    """Sample the posterior of a fit.

    Parameters
    ----------
    result : FitResult
        Result of a fit with absolute σ.
    samples, warmup : int
        Samples kept and discarded, per chain.
    chains : int
        They start at the roots in turn: a second root that they do not mix with shows in R-hat.
    seed : int
    progress : bool, optional
        Whether to show a progress bar; by default on a terminal, and a line on stderr elsewhere.

    Returns
    -------
    Samples
        `Samples.to_arviz` returns what ``az.summary`` and ``az.plot_trace`` take.

    Raises
    ------
    ModuleNotFoundError
        Without the extra ``bayes``.
    ValueError
        If the deviance of this fit is no −2 ln(likelihood), as σ was scaled.
    """
    if result.scaled or result.scatter_dof is not None:
        raise ValueError("a posterior needs a likelihood: sigma = 'absolute', and of a sequence a model_error that is stated")
    _arviz()
    from numpyro.infer import MCMC, NUTS  # pyright: ignore[reportMissingImports]

    if progress is not False and sys.stderr is not None:  # before the bar, which opens after compiling
        print(f"sampling {chains} chains of {warmup + samples} steps; the first compiles", file=sys.stderr, flush=True)
    low, high = result.parameters.low, result.parameters.high
    starts = np.array([one.theta for one in result.roots] or [result.theta])
    unbounded = np.resize(logit(np.clip((starts - low) / (high - low), 1e-6, 1 - 1e-6)), (chains, len(low)))
    unbounded = unbounded + 1e-3 * np.random.default_rng(seed).standard_normal(unbounded.shape)

    def potential(z: Array) -> Array:
        """−ln posterior over the logit of θ in its range."""
        theta = jnp.asarray(low + (high - low) * jax.nn.sigmoid(z))
        return result.problem.traced(theta) - (jax.nn.log_sigmoid(z) + jax.nn.log_sigmoid(-z)).sum()

    with jax.enable_x64(True):
        # a few parameters: forward mode is less to compile
        kernel = NUTS(potential_fn=potential, dense_mass=True, target_accept_prob=0.9, forward_mode_differentiation=True)
        run = MCMC(
            kernel,
            num_warmup=warmup,
            num_samples=samples,
            num_chains=chains,
            chain_method="vectorized",
            progress_bar=bool(sys.stderr and sys.stderr.isatty()) if progress is None else progress,
        )
        run.run(jax.random.key(seed), init_params=jnp.asarray(unbounded), extra_fields=("diverging",))
        drawn = np.asarray(run.get_samples(group_by_chain=True))
        diverging = np.asarray(run.get_extra_fields(group_by_chain=True)["diverging"])
    theta = low + (high - low) * expit(drawn)
    if diverging.any():
        ends = "; counts and limits without a σ have ends that it cannot follow: give one, or use the intervals of the fit"
        share = f"{diverging.sum()} of {diverging.size} samples diverged, and where they did the posterior is not to be trusted"
        warnings.warn(share + ends * result.problem.sharp, RuntimeWarning, stacklevel=2)
    return Samples("posterior", seed, result.parameters.free, theta, diverging=diverging)


def _arviz() -> Any:
    """Import ArviZ quietly, and make sure of a sampler."""
    try:
        import numpyro  # noqa: F401  # pyright: ignore[reportMissingImports]

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            import arviz  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise ModuleNotFoundError("the posterior needs numpyro and arviz: pip install 'slippulse_jax[bayes]'") from None
    return arviz
