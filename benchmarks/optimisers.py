"""Which optax optimiser fits a stiffness best? Prints the table that the choice in inference/optimise.py rests on.

Every optimiser gets the same 200 random studies (three heights, 1 % noise), the same three starts each and the same box.
"reached" is the share of studies whose best start ends where chi-squared is within 1e-8 of the least found by a dense scan;
"calls" is the mean number of steps. Run: python benchmarks/optimisers.py
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax

from slippulse_jax import Slider
from slippulse_jax.inference.objective import Data, half_chi_squared, length_of
from slippulse_jax.lattice.precursor import precursor_lengths

STUDIES, HEIGHTS = 200, np.array([15.0, 25.0, 40.0])
BOX = np.log([1e-4, 2e-2])
BUDGET = 200


def studies(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    stiffness = np.exp(rng.uniform(*np.log([1e-3, 1e-2]), STUDIES))
    exact = precursor_lengths(Slider(HEIGHTS, stiffness[:, None], 0.3))
    sigma = 0.01 * exact
    return exact + sigma * rng.standard_normal(exact.shape), sigma


def data(length, sigma) -> Data:
    return Data(HEIGHTS, np.full(3, 0.3), np.ones(3), length, sigma)


def model(theta):
    return jax.vmap(lambda h: length_of(h, jnp.exp(theta), 0.3))(HEIGHTS)


def descend(optimiser: optax.GradientTransformationExtraArgs, natural: bool):
    """Steps of one optimiser from z0 until the position stops changing; returns θ and the number of steps."""

    def run(z0, length, sigma):
        def inside(z):
            return BOX[0] + (BOX[1] - BOX[0]) * jax.nn.sigmoid(z)

        def f(z):
            return half_chi_squared(inside(z)[None], data(length, sigma))

        def step(carry):
            z, state, n, _ = carry
            value, grad = jax.value_and_grad(f)(z)
            if natural:  # divide by the Fisher information: a Gauss–Newton step
                slope = jax.jacfwd(lambda x: model(inside(x)) / sigma)(z)
                grad = grad / (jnp.sum(slope**2) + 1e-12)
            updates, state = optimiser.update(grad, state, z, value=value, grad=grad, value_fn=f)
            new = optax.apply_updates(z, updates)
            return new, state, n + 1, jnp.abs(new - z) > 1e-13

        carry = (z0, optimiser.init(z0), 0, True)
        z, _, n, _ = lax.while_loop(lambda c: c[3] & (c[2] < BUDGET), step, carry)
        return inside(z), n

    return jax.jit(jax.vmap(jax.vmap(run, (0, None, None)), (None, 0, 0)))


CANDIDATES = {
    "L-BFGS, zoom line search": (optax.lbfgs(), False),
    "L-BFGS, backtracking": (optax.lbfgs(linesearch=optax.scale_by_backtracking_linesearch(20, store_grad=True)), False),
    "Adam, rate 0.1": (optax.adam(0.1), False),
    "Adam, rate 0.03": (optax.adam(0.03), False),
    "SGD on the natural gradient (Gauss–Newton)": (optax.sgd(1.0), True),
}


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    length, sigma = studies(np.random.default_rng(7))
    grid = np.linspace(*BOX, 4001)
    model = precursor_lengths(Slider(HEIGHTS, np.exp(grid)[:, None], 0.3))
    chi2 = (((model[None] - length[:, None]) / sigma[:, None]) ** 2).sum(-1)
    best = chi2.min(axis=1)
    print(f"{'optimiser':44s} {'reached':>8s} {'calls':>6s} {'time s':>7s} {'compile s':>9s}")
    for name, (optimiser, natural) in CANDIDATES.items():
        run = descend(optax.with_extra_args_support(optimiser), natural)
        starts = jnp.array([-2.0, 0.0, 2.0])
        began = time.perf_counter()
        jax.block_until_ready(run(starts, length, sigma))
        cold = time.perf_counter() - began
        began = time.perf_counter()
        theta, steps = jax.block_until_ready(run(starts, length, sigma))
        warm = time.perf_counter() - began
        found = precursor_lengths(Slider(HEIGHTS, np.exp(np.asarray(theta))[..., None], 0.3))
        value = (((found - length[:, None]) / sigma[:, None]) ** 2).sum(-1).min(axis=1)
        reached = (value <= best + 1e-8).mean()
        print(f"{name:44s} {reached:8.1%} {np.mean(steps):6.1f} {warm:7.2f} {cold - warm:9.1f}", flush=True)


if __name__ == "__main__":
    main()
