"""The posterior by the No-U-Turn sampler: the extra ``bayes`` (numpyro).

The density is that of the fit (`slippulse_jax.inference.likelihood.log_density`); a parameter without a prior is flat over the
range searched, a positive one in its logarithm.
"""

import dataclasses
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slippulse_jax.inference.likelihood import log_density
from slippulse_jax.inference.verdict import LEVELS

if TYPE_CHECKING:
    from slippulse_jax.inference.result import FitResult

GOOD_RHAT = 1.01
GOOD_ESS = 400.0


class Samples:
    """Base of samples of the parameters, whether refits or draws from a posterior."""

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
class Posterior(Samples):
    """Samples of the posterior, with the diagnostics of their convergence."""

    names: tuple[str, ...]
    theta: np.ndarray  # (chains, samples, p)
    values: np.ndarray  # (chains, samples, p), in the units of the parameters
    rhat: dict[str, float]  # split R-hat: 1 where the chains agree
    ess: dict[str, float]  # effective number of independent samples
    divergences: int
    seed: int

    @property
    def converged(self) -> bool:
        """R-hat ≤ 1.01, at least 400 effective samples, and no divergence."""
        return max(self.rhat.values()) <= GOOD_RHAT and min(self.ess.values()) >= GOOD_ESS and not self.divergences

    def to_dict(self) -> dict[str, Any]:
        """Summary as plain Python values."""
        chains, samples, _ = self.values.shape
        return {
            "chains": chains,
            "samples": samples,
            "seed": self.seed,
            "divergences": self.divergences,
            "converged": self.converged,
            "mean": {name: float(self.of(name).mean()) for name in self.names},
            **self.summary(),
            "rhat": self.rhat,
            "ess": self.ess,
        }

    def __str__(self) -> str:
        chains, samples, _ = self.values.shape
        rows = [f"posterior by NUTS, {chains} chains of {samples} (seed {self.seed}; {self.divergences} divergences)"]
        rows += [f"{self.line(name)}; R-hat {self.rhat[name]:.3f}, ESS {self.ess[name]:.0f}" for name in self.names]
        if not self.converged:
            rows.append(
                f"  not to be used: R-hat above {GOOD_RHAT}, fewer than {GOOD_ESS:.0f} effective samples, or divergences "
                "(two roots far apart stay unmixed)"
            )
        return "\n".join(rows)


def posterior(result: "FitResult", *, samples: int = 1000, warmup: int = 500, chains: int = 4, seed: int = 0) -> Posterior:
    """Sample the posterior of a fit.

    Parameters
    ----------
    result : FitResult
        Result of a fit with the normal or the Student loss and absolute σ.
    samples, warmup : int
        Samples kept and discarded, per chain.
    chains : int
        They start at the roots in turn: a second root that they do not mix with shows in R-hat.
    seed : int

    Raises
    ------
    ModuleNotFoundError
        Without the extra ``bayes``.
    ValueError
        If the deviance of this fit is no −2 ln(likelihood): Huber's loss, or scaled σ; or the break rule is a smooth one; or
        lengths are those of whole events.
    """
    if result.parameters.smooth:
        raise ValueError("a posterior takes the hard break rule: hold no width, or use bootstrap")
    if result.parameters.event == "full":
        raise ValueError("event = 'full': a posterior needs a length that can be traced; use bootstrap")
    if result.problem.loss.name == "huber" or result.scaled:
        raise ValueError("a posterior needs a likelihood: the normal or the Student loss, and sigma = 'absolute'")
    try:
        from numpyro.diagnostics import effective_sample_size, split_gelman_rubin  # pyright: ignore[reportMissingImports]
        from numpyro.infer import MCMC, NUTS  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise ModuleNotFoundError("the posterior needs numpyro: pip install 'slippulse_jax[bayes]'") from None
    low, high = result.parameters.low, result.parameters.high
    starts = np.array([one.theta for one in result.roots] or [result.theta])
    share = np.clip((starts - low) / (high - low), 1e-6, 1 - 1e-6)
    unbounded = np.resize(np.log(share / (1 - share)), (chains, len(low)))
    unbounded = unbounded + 1e-3 * np.random.default_rng(seed).standard_normal(unbounded.shape)

    def potential(z: Array) -> Array:
        """−ln posterior over z, θ = low + (high − low)/(1 + e^−z)."""
        theta = jnp.asarray(low + (high - low) * jax.nn.sigmoid(z))
        return -log_density(theta, result.problem) - (jax.nn.log_sigmoid(z) + jax.nn.log_sigmoid(-z)).sum()

    with jax.enable_x64(True):
        # a few parameters: forward mode is less to compile
        kernel = NUTS(potential_fn=potential, dense_mass=True, target_accept_prob=0.9, forward_mode_differentiation=True)
        run = MCMC(
            kernel, num_warmup=warmup, num_samples=samples, num_chains=chains, chain_method="vectorized", progress_bar=False
        )
        run.run(jax.random.key(seed), init_params=jnp.asarray(unbounded), extra_fields=("diverging",))
        drawn = np.asarray(run.get_samples(group_by_chain=True))
        diverging = int(np.asarray(run.get_extra_fields()["diverging"]).sum())
    theta = low + (high - low) / (1 + np.exp(-drawn))
    free = result.parameters.free
    values = np.stack([np.asarray(one.value(theta[:, :, i])) for i, one in enumerate(free)], axis=-1)
    names = tuple(result.parameters.names)
    return Posterior(
        names=names,
        theta=theta,
        values=values,
        rhat={name: float(split_gelman_rubin(theta[:, :, i])) for i, name in enumerate(names)},
        ess={name: float(effective_sample_size(theta[:, :, i])) for i, name in enumerate(names)},
        divergences=diverging,
        seed=seed,
    )
