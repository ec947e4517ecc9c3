"""The posterior by the No-U-Turn sampler: the extra ``bayes`` (numpyro).

The likelihood and the Gaussian priors are those of the fit; a parameter without a prior is flat over the range searched, a
positive one in its logarithm. `log_density` is the objective of the fit once more, as a function that JAX can trace: a
sampler inside a compiled loop cannot call the batches that the fit works with.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr
from jaxtyping import Array, Float

from slippulse_jax.inference.forward import displacement_at, force_at
from slippulse_jax.inference.likelihood import SHARPEST, STUDENT_DOF
from slippulse_jax.inference.objective import Problem
from slippulse_jax.inference.parameters import WIDTH
from slippulse_jax.inference.result import FitResult
from slippulse_jax.inference.samples import Samples
from slippulse_jax.interface import Interface
from slippulse_jax.lattice.exact import exact_length
from slippulse_jax.lattice.readings import Readings, readings
from slippulse_jax.slider import Slider

GOOD_RHAT = 1.01
GOOD_ESS = 400.0


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior(Samples):
    """Samples of the posterior and what tells whether to believe them."""

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


def posterior(result: FitResult, *, samples: int = 1000, warmup: int = 500, chains: int = 4, seed: int = 0) -> Posterior:
    """Sample the posterior of a fit.

    Parameters
    ----------
    result : FitResult
        Of a fit with the normal or the Student loss and believed σ.
    samples, warmup : int
        Kept and discarded, a chain.
    chains : int
        They start at the minima that are not excluded, in turns: a second root that they do not mix with shows in R-hat.
    seed : int

    Raises
    ------
    ModuleNotFoundError
        Without the extra ``bayes``.
    ValueError
        If the deviance of this fit is no −2 ln(likelihood): Huber's loss, or scaled σ; or the break rule is a smooth one.
    """
    if result.parameters.base.shape[1] > WIDTH:
        raise ValueError("a posterior takes the hard break rule: hold no width, or use bootstrap")
    if result.problem.loss.name == "huber" or result.scaled:
        raise ValueError("a posterior needs a likelihood: the normal or the Student loss, and sigma = 'absolute'")
    try:
        from numpyro.diagnostics import effective_sample_size, split_gelman_rubin  # pyright: ignore[reportMissingImports]
        from numpyro.infer import MCMC, NUTS  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise ModuleNotFoundError("the posterior needs numpyro: pip install 'slippulse_jax[bayes]'") from None
    low, high = result.parameters.low, result.parameters.high
    starts = np.array([one.theta for one in result.found] or [result.theta])
    share = np.clip((starts - low) / (high - low), 1e-6, 1 - 1e-6)
    unbounded = np.resize(np.log(share / (1 - share)), (chains, len(low)))
    unbounded = unbounded + 1e-3 * np.random.default_rng(seed).standard_normal(unbounded.shape)
    with jax.enable_x64(True):
        # a few parameters: forward mode is less to compile
        kernel = NUTS(
            potential_fn=_potential(result), dense_mass=True, target_accept_prob=0.9, forward_mode_differentiation=True
        )
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


def _potential(result: FitResult) -> Callable[[Array], Array]:
    """−ln posterior over z, θ = low + (high − low)/(1 + e^−z)."""
    low, high = result.parameters.low, result.parameters.high
    density = log_density(result.problem)

    def potential(z: Array) -> Array:
        inside = jax.nn.sigmoid(z)
        return -density(jnp.asarray(low + (high - low) * inside)) - (jax.nn.log_sigmoid(z) + jax.nn.log_sigmoid(-z)).sum()

    return potential


def log_density(problem: Problem) -> Callable[[Float[Array, " p"]], Float[Array, ""]]:
    """ln(likelihood × prior) of one θ as a JAX function, the objective's numbers; forward mode only where gauges were read."""
    blocks = [_log_likelihood(problem, block) for block in problem.blocks]

    def density(theta: Array) -> Array:
        off = theta - jnp.asarray(problem.prior_mean[0])
        return sum((block(theta) for block in blocks), -(problem.prior_weight * off**2).sum() / 2)

    return density


def _log_likelihood(problem: Problem, block: Any) -> Callable[[Array], Array]:
    data, d = block.data, problem.parameters.discrepancy
    value = data.value[0]
    n, w, b = (np.nonzero(data.kind == kind)[0] for kind in ("length", "whole", "at_least"))
    plain = not block.base[:, 3:5].any() and not block.slope[:, 3:5].any()
    of_length = partial(_length, plain)
    sites = _sites(problem, block) if block.base.shape[1] > 5 else 0
    model = {
        "length": of_length,
        "displacement": displacement_at,
        "force": force_at,
        "slip": lambda y: _reading(of_length, sites, y).slip,
        "stress": lambda y: _reading(of_length, sites, y).stress,
    }[block.observable]

    def likelihood(theta: Array) -> Array:
        y = block.base + block.slope @ theta
        predicted = jax.vmap(model)(y)[block.rows]
        mu = predicted * jnp.exp(block.scale_base + block.scale_slope @ theta) + block.offset @ theta
        sigma = jnp.asarray(data.sigma)
        if d is not None:
            sigma = jnp.sqrt(sigma**2 + jnp.where(data.has_discrepancy, jnp.exp(theta[d]) * value, 0) ** 2)
        parts = [_of_length(mu[n], value[n], sigma[n], data.sigma[n], problem.loss.name)]
        if len(w):
            soft = jnp.maximum(sigma[w], SHARPEST)
            parts.append(_log_between((value[w] - 1 - mu[w]) / soft, (value[w] - mu[w]) / soft))
        if len(b):
            parts.append(log_ndtr((mu[b] - value[b]) / jnp.maximum(sigma[b], SHARPEST)))
        return jnp.concatenate(parts).sum()

    return likelihood


def _of_length(mu: Array, value: np.ndarray, sigma: Array, stated: np.ndarray, loss: str) -> Array:
    r = (mu - value) / sigma
    cost = r**2 / 2 if loss == "normal" else (STUDENT_DOF + 1) / 2 * jnp.log1p(r**2 / STUDENT_DOF)
    return -cost - jnp.log(sigma / stated)


def _log_between(a: Array, b: Array) -> Array:
    """ln[Φ(b) − Φ(a)], by the tail that loses no digits."""
    flip = a > 0
    a, b = jnp.where(flip, -b, a), jnp.where(flip, -a, b)
    top = log_ndtr(b)
    return top + jnp.log1p(-jnp.exp(jnp.minimum(log_ndtr(a) - top, -1e-300)))


def _length(plain: bool, y: Array) -> Array:
    slider = Slider(jnp.exp(y[0]), jnp.exp(y[1]), y[2])
    return exact_length(slider) if plain else exact_length(slider, Interface(y[3], y[4]))


def _sites(problem: Problem, block: Any) -> int:
    """Contacts that fields are looked at: eight times what the gauges and counts reach in the middle of the range searched."""
    middle = (problem.parameters.low + problem.parameters.high) / 2
    y = block.base + block.slope @ middle
    return 64 + 8 * int(max(np.exp(y[:, 5]).max(), y[:, 7].max()))


def _reading(of_length: Callable[[Array], Array], count: int, y: Array) -> Readings:
    """At one gauge, by a straight line between the contacts on both sides."""
    # contact 0 has broken even where no domino starts
    stopped = jnp.where(y[7] > 0, y[7], jnp.maximum(of_length(y[:5]) + y[6], 1))
    place = jnp.exp(y[5])
    left = jnp.floor(place).astype(jnp.int32)
    found = readings(Slider(jnp.exp(y[0]), jnp.exp(y[1]), y[2]), y[3], stopped, count)
    known = (stopped < count) & (place + 1 < count)
    return Readings(*(jnp.where(known, x[left] + (place - left) * (x[left + 1] - x[left]), jnp.inf) for x in found))
