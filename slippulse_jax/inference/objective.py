"""How far a model with given stiffness is from the data: χ² and what it is made of, over a parameter θ = ln(stiffness)."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.parameters import Stiffness
from slippulse_jax.lattice.precursor import precursor_length
from slippulse_jax.slider import Slider


class Data(NamedTuple):
    """Arrays of shape (n,) that the compiled functions see; lengths in λc."""

    height: Array | np.ndarray
    poisson: Array | np.ndarray
    ratio_per_unit: Array | np.ndarray
    length: Array | np.ndarray
    sigma: Array | np.ndarray


class Curve(NamedTuple):
    """The model along the parameter, as NumPy: nodes θ of shape (g,), lengths and dℓ/dθ of shape (g, n), in λc."""

    theta: np.ndarray
    length: np.ndarray
    slope: np.ndarray


def as_data(measurements: Measurements, parameter: Stiffness) -> Data:
    """Data in the form the compiled functions take."""
    m = measurements
    return Data(m.height, m.poisson, parameter.ratio_per_unit, m.length, m.length_sigma)


def lengths(theta: Float[Array, ""], data: Data) -> Float[Array, " n"]:
    """Model length of each measurement, in λc."""
    return precursor_length(Slider(data.height, jnp.exp(theta) * data.ratio_per_unit, data.poisson))


def half_chi_squared(theta: Float[Array, ""], data: Data) -> Float[Array, ""]:
    """χ²/2 = ½ Σ [(ℓ − measured)/σ]²."""
    return jnp.sum(((lengths(theta, data) - data.length) / data.sigma) ** 2) / 2


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


@functools.partial(jax.jit)
def _length_and_slope(columns: Float[Array, "3 lanes"]) -> Float[Array, "2 lanes"]:
    height, stiffness, poisson = columns

    def length(log_factor: Array) -> Array:
        return precursor_length(Slider(height, stiffness * jnp.exp(log_factor), poisson))

    return jnp.stack(jax.jvp(length, (jnp.zeros_like(stiffness),), (jnp.ones_like(stiffness),)))
