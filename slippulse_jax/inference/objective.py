"""How far a model with given stiffness is from the data: χ² and what it is made of, over a parameter θ = ln(stiffness)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.derivatives import by_forward_mode
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.parameters import Stiffness
from slippulse_jax.lattice.front import DEFAULT_MAX_CONTACTS, arrest
from slippulse_jax.slider import Slider

AnyArray = Array | np.ndarray


class Data(NamedTuple):
    """Arrays of shape (n,) that the compiled functions see; lengths in λc."""

    height: AnyArray
    poisson: AnyArray
    ratio_per_unit: AnyArray
    length: AnyArray
    sigma: AnyArray


class Curve(NamedTuple):
    """The model along the parameter, as NumPy: nodes θ of shape (g,), lengths and dℓ/dθ of shape (g, n), in λc."""

    theta: np.ndarray
    length: np.ndarray
    slope: np.ndarray


def as_data(measurements: Measurements, parameter: Stiffness) -> Data:
    """Data in the form the compiled functions take."""
    m = measurements
    return Data(m.height, m.poisson, parameter.ratio_per_unit, m.length, m.length_sigma)


def padded(data: Data) -> Data:
    """The same data in one of few shapes, so that little is compiled: copies of the last one with σ = ∞ weigh nothing."""
    count = len(data.length)
    size = max(8, 1 << (count - 1).bit_length())
    repeated = Data(*(np.concatenate([column, np.repeat(column[-1:], size - count)]) for column in data))
    return repeated._replace(sigma=np.concatenate([data.sigma, np.full(size - count, np.inf)]))


def length_of(height: AnyArray, stiffness: AnyArray, poisson: AnyArray) -> Array:
    """Model length of one measurement, in λc; differentiable forward."""
    return jnp.asarray(arrest(Slider(height, stiffness, poisson), "semi-infinite", None, DEFAULT_MAX_CONTACTS).length)


def half_chi_squared(theta: Float[Array, "1"], data: Data) -> Float[Array, ""]:
    """χ²/2 = ½ Σ [(ℓ − measured)/σ]², differentiable in `theta` alone.

    Derivatives are taken here, in the one parameter that is fitted, rather than in the three numbers of every slider: each pass
    of the recursion then carries one tangent instead of three, and compiles in a fraction of the time.
    """

    def value(theta: Float[Array, "1"]) -> Float[Array, ""]:
        model = jax.vmap(length_of)(data.height, jnp.exp(theta[0]) * data.ratio_per_unit, data.poisson)
        return jnp.sum(((model - data.length) / data.sigma) ** 2) / 2

    return by_forward_mode(value)(theta)


def chi_squared(curve: Curve, data: Data) -> np.ndarray:
    """χ² at every node, shape (g,)."""
    return (((curve.length - data.length) / data.sigma) ** 2).sum(axis=1)


def fisher_information(curve: Curve, data: Data) -> np.ndarray:
    """Σ [(dℓ/dθ)/σ]² at every node, shape (g,)."""
    return ((curve.slope / data.sigma) ** 2).sum(axis=1)


def evaluate(theta: np.ndarray, data: Data) -> Curve:
    """Lengths and their slopes at the nodes, each (node, measurement) a lane; in chunks of one shape, compiled once."""
    theta = np.asarray(theta, dtype=np.float64)
    shape = (len(theta), len(data.length))
    lanes = np.broadcast_arrays(data.height, np.exp(theta)[:, None] * data.ratio_per_unit, data.poisson)
    columns = np.stack([np.broadcast_to(lane, shape).ravel() for lane in lanes])
    result = np.empty((2, columns.shape[1]))
    with jax.enable_x64(True):
        for start in range(0, columns.shape[1], _LANES):
            chosen = columns[:, start : start + _LANES]
            count = chosen.shape[1]
            padded = np.concatenate([chosen, np.repeat(chosen[:, -1:], _LANES - count, axis=1)], axis=1)
            result[:, start : start + count] = np.asarray(_length_and_slope(padded))[:, :count]
    return Curve(theta, *result.reshape(2, *shape))


_LANES = 512


@jax.jit
def _length_and_slope(columns: Float[Array, "3 lanes"]) -> Float[Array, "2 lanes"]:
    def value_and_slope(height: Array, stiffness: Array, poisson: Array) -> tuple[Array, Array]:
        return jax.jvp(lambda k: length_of(height, k, poisson), (stiffness,), (stiffness,))

    return jnp.stack(jax.vmap(value_and_slope)(*columns))
