"""The posterior by the No-U-Turn sampler: the extra ``bayes`` (numpyro and ArviZ).

The density is that of the fit (`slippulse_jax.inference.likelihood.log_density`); a parameter without a prior is flat over the
range searched, a positive one in its logarithm.
"""

import sys
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slippulse_jax.inference.bootstrap import Samples
from slippulse_jax.inference.fitted import Fitted
from slippulse_jax.inference.likelihood import log_density

GOOD_RHAT = 1.01
GOOD_ESS = 400.0


class Posterior(Samples):
    """Summary of a posterior: moments, intervals, and the diagnostics of its convergence.

    Parameters
    ----------
    tree : arviz.InferenceData or xarray.DataTree
        As `posterior` returns it.
    """

    rhat: dict[str, float]  # split R-hat: 1 where the chains agree
    ess: dict[str, float]  # effective number of independent samples
    divergences: int
    seed: int

    def __init__(self, tree: Any) -> None:
        drawn = tree["posterior"].data_vars
        self.names = tuple(str(name) for name in drawn)
        self.values = np.stack([np.asarray(drawn[name]) for name in self.names], axis=-1)
        self.rhat, self.ess = ({name: float(drawn[name].attrs[key]) for name in self.names} for key in ("rhat", "ess"))
        self.divergences = int(np.asarray(tree["sample_stats"]["diverging"]).sum())
        self.seed = int(tree["posterior"].attrs["seed"])

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


def posterior(
    result: Fitted,
    *,
    samples: int = 1000,
    warmup: int = 500,
    chains: int = 4,
    seed: int = 0,
    progress: bool | None = None,
) -> Any:
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
        Whether to show a progress bar; by default on a terminal.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree
        What ArviZ of this version works on: ``az.summary`` and ``az.plot_trace`` take it. The group ``posterior`` has the
        parameters in their units, by label, with their R-hat and effective sample size as attributes; `Posterior` sums it up.

    Raises
    ------
    ModuleNotFoundError
        Without the extra ``bayes``.
    ValueError
        If the deviance of this fit is no −2 ln(likelihood), as σ was scaled; or lengths are those of whole events.
    """
    if result.parameters.front.event == "full":
        raise ValueError("event = 'full': a posterior needs a length that can be traced; use bootstrap")
    if result.scaled:
        raise ValueError("a posterior needs a likelihood: sigma = 'absolute'")
    try:
        with warnings.catch_warnings():  # which announces its next version on import
            warnings.simplefilter("ignore", FutureWarning)
            import arviz as az  # pyright: ignore[reportMissingImports]
            import xarray  # a quarter of a second, which a fit by itself need not take
        from numpyro.diagnostics import effective_sample_size, split_gelman_rubin  # pyright: ignore[reportMissingImports]
        from numpyro.infer import MCMC, NUTS  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise ModuleNotFoundError("the posterior needs numpyro and arviz: pip install 'slippulse_jax[bayes]'") from None
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
            kernel,
            num_warmup=warmup,
            num_samples=samples,
            num_chains=chains,
            chain_method="vectorized",
            progress_bar=sys.stderr.isatty() if progress is None else progress,
        )
        run.run(jax.random.key(seed), init_params=jnp.asarray(unbounded), extra_fields=("diverging",))
        drawn = np.asarray(run.get_samples(group_by_chain=True))
        diverging = np.asarray(run.get_extra_fields(group_by_chain=True)["diverging"])
    theta = low + (high - low) / (1 + np.exp(-drawn))
    columns = {
        one.label: xarray.DataArray(
            np.asarray(one.value(column)),
            dims=("chain", "draw"),
            attrs={
                "units": one.unit,
                "rhat": float(split_gelman_rubin(column)),
                "ess": float(effective_sample_size(column)),
            },
        )
        for one, column in zip(result.parameters.free, np.moveaxis(theta, -1, 0), strict=True)
    }
    where = {"chain": np.arange(chains), "draw": np.arange(samples)}
    groups = {
        "posterior": xarray.Dataset(columns, where, {"seed": seed}),
        "sample_stats": xarray.Dataset({"diverging": (("chain", "draw"), diverging)}, where),
    }
    before_1 = az.__version__.startswith("0.")
    return az.InferenceData(**groups) if before_1 else xarray.DataTree.from_dict(groups)  # pyright: ignore


def theta_of(result: Fitted, samples: Any) -> np.ndarray:
    """θ of samples of a fit, (n, p): an array of them, a `Bootstrap`, or what `posterior` returns."""
    if not hasattr(samples, "posterior"):
        return np.reshape(getattr(samples, "theta", samples), (-1, result.problem.p))
    drawn = samples["posterior"]
    values = [(one, np.ravel(drawn[one.label])) for one in result.parameters.free]
    return np.stack([np.log(value) if one.log else value for one, value in values], axis=-1)
