"""How far a model with given stiffness is from the data: χ² and what it is made of, over a parameter θ = ln(stiffness)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.optimise import Local
from slippulse_jax.inference.parameters import Stiffness
from slippulse_jax.lattice.front import DEFAULT_MAX_CONTACTS, arrest
from slippulse_jax.slider import Slider

LANES = 512  # lanes a chunk


class Data(NamedTuple):
    """The columns of the measurements that enter χ², of shape (n,); lengths in λc."""

    height: np.ndarray
    poisson: np.ndarray
    ratio_per_unit: np.ndarray
    length: np.ndarray
    sigma: np.ndarray


class Curve(NamedTuple):
    """The model along the parameter: nodes θ of shape (g,), ℓ, dℓ/dθ and d²ℓ/dθ² of shape (g, n), in λc."""

    theta: np.ndarray
    length: np.ndarray
    slope: np.ndarray
    bend: np.ndarray


def as_data(measurements: Measurements, parameter: Stiffness) -> Data:
    """What of the measurements enters χ²."""
    m = measurements
    return Data(m.height, m.poisson, parameter.ratio_per_unit, m.length, m.length_sigma)


def distinct_curves(data: Data) -> tuple[np.ndarray, np.ndarray]:
    """Indices of measurements whose ℓ(θ) are all there are, and for each measurement which of them is its own."""
    _, first, own = np.unique(
        np.stack([data.height, data.poisson, data.ratio_per_unit]), axis=1, return_index=True, return_inverse=True
    )
    return first, own.ravel()


def chi_squared(curve: Curve, data: Data) -> np.ndarray:
    """χ² = Σ [(ℓ − measured)/σ]² at every node, shape (g,)."""
    return (((curve.length - data.length) / data.sigma) ** 2).sum(axis=1)


def near(theta: np.ndarray, data: Data) -> Local:
    """χ²/2, its derivatives and the Fisher information at each θ."""
    curve = evaluate(theta, data)
    residual, slope, bend = (curve.length - data.length) / data.sigma, curve.slope / data.sigma, curve.bend / data.sigma
    information = (slope**2).sum(axis=1)
    return Local(
        value=(residual**2).sum(axis=1) / 2,
        gradient=(residual * slope).sum(axis=1),
        curvature=information + (residual * bend).sum(axis=1),
        information=information,
    )


def evaluate(theta: np.ndarray, data: Data) -> Curve:
    """Lengths and their first two derivatives at the nodes; each (node, distinct curve) a lane, in chunks of one shape."""
    theta = np.asarray(theta, dtype=np.float64)
    first, own = distinct_curves(data)
    shape = (len(theta), len(first))
    lanes = (data.height[first], np.exp(theta)[:, None] * data.ratio_per_unit[first], data.poisson[first])
    columns = np.stack([np.broadcast_to(lane, shape).ravel() for lane in lanes])
    result = np.empty((3, columns.shape[1]))
    with jax.enable_x64(True):
        for start in range(0, columns.shape[1], LANES):
            chosen = columns[:, start : start + LANES]
            count = chosen.shape[1]
            padded = np.concatenate([chosen, np.repeat(chosen[:, -1:], LANES - count, axis=1)], axis=1)
            result[:, start : start + count] = np.asarray(_length_and_derivatives(padded))[:, :count]
    length, slope, bend = (x.reshape(shape)[:, own] for x in result)
    return Curve(theta, length, slope, bend)


@jax.jit
def _length_and_derivatives(columns: Float[Array, "3 lanes"]) -> Float[Array, "3 lanes"]:
    """ℓ, dℓ/dθ and d²ℓ/dθ² with stiffness ∝ e^θ, by the recursion with two nested tangents."""

    def one(height: Array, stiffness: Array, poisson: Array) -> tuple[Array, Array, Array]:
        def length(theta: Array) -> Array:
            slider = Slider(height, stiffness * jnp.exp(theta), poisson)
            return jnp.asarray(arrest(slider, "semi-infinite", None, DEFAULT_MAX_CONTACTS).length)

        def with_slope(theta: Array) -> tuple[Array, Array]:
            return jax.jvp(length, (theta,), (jnp.ones_like(theta),))

        zero = jnp.zeros_like(stiffness)
        (value, slope), (_, bend) = jax.jvp(with_slope, (zero,), (jnp.ones_like(zero),))
        return value, slope, bend

    return jnp.stack(jax.vmap(one)(*columns))
