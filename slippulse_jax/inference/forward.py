"""The model as a fit sees it: what it predicts at inputs y = (ln H/λc, ln k/K, ν, φ, ε), with derivatives in y.

The length is ℓ*, the exact solution's crossing (`slippulse_jax.exact_lengths`): it has no kinks, starts continuously where
the domino starts, and costs microseconds a lane. What is measured at nucleation is closed in the two lattice modes.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.lattice.exact import ExactStatus
from slippulse_jax.lattice.exact_lanes import solve_lanes
from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.slider import Slider

LANES = 256


class Prediction(NamedTuple):
    """Of L lanes; the derivatives are None where they were not asked for, and 0 where there is no length."""

    value: Float[np.ndarray, " L"]
    first: Float[np.ndarray, "L 5"] | None


def lengths(y: Float[np.ndarray, "L 5"], order: int) -> Prediction:
    """ℓ*, in λc: 0 where no domino starts, inf where the front never stops.

    Raises
    ------
    RuntimeError
        If the exact solution did not converge somewhere; never seen.
    """
    lanes = y.T.copy()
    lanes[:2] = np.exp(lanes[:2])
    found = solve_lanes(lanes, order)
    lost = ~np.isin(found.status, (ExactStatus.ARRESTED, ExactStatus.NO_DOMINO, ExactStatus.NEVER_STOPS))
    if lost.any():
        where = ", ".join(f"{x:.9g}" for x in lanes[:, np.argmax(lost)])
        why = ExactStatus(int(found.status[lost][0])).message
        raise RuntimeError(f"no exact length at (H/λc, k/K, ν, φ, ε) = ({where}): {why}")
    if found.gradient is None:
        return Prediction(found.length, None)
    first = found.gradient.copy()
    first[:, :2] *= lanes[:2].T  # to the logarithms
    first[~np.isfinite(found.length)] = 0
    return Prediction(found.length, first)


def displacements(y: Float[np.ndarray, "L 5"], order: int) -> Prediction:
    """Displacement of the pushed edge at nucleation, in u_s = f_s/k."""
    return _at_nucleation(_displacement, y, order)


def forces(y: Float[np.ndarray, "L 5"], order: int) -> Prediction:
    """Driving force at nucleation over that on one contact at its threshold, f_s: all that the contacts carry."""
    return _at_nucleation(_force, y, order)


PREDICTED = {"length": lengths, "displacement": displacements, "force": forces}


def _displacement(y: Array) -> Array:
    return (1 - y[3]) * lattice_modes(Slider(jnp.exp(y[0]), jnp.exp(y[1]), y[2])).load


def _force(y: Array) -> Array:
    """Σ_i Σ_m C_m r_m^i over the contacts, a geometric series in each mode."""
    modes = lattice_modes(Slider(jnp.exp(y[0]), jnp.exp(y[1]), y[2]))
    return (1 - y[3]) * (modes.drive / modes.gap).sum()


@partial(jax.jit, static_argnums=0)
def _with_slope(function: Callable[[Array], Array], y: Float[Array, "L 5"]) -> tuple[Array, Array]:
    return jax.vmap(function)(y), jax.vmap(jax.jacfwd(function))(y)


def _at_nucleation(function: Callable[[Array], Array], y: np.ndarray, order: int) -> Prediction:
    value, first = np.empty(len(y)), np.empty((len(y), 5))
    with jax.enable_x64(True):
        for start in range(0, len(y), LANES):
            part = slice(start, start + LANES)
            chosen = y[part]
            padded = np.concatenate([chosen, np.repeat(chosen[-1:], LANES - len(chosen), axis=0)])
            one, slope = _with_slope(function, padded)
            value[part], first[part] = np.asarray(one)[: len(chosen)], np.asarray(slope)[: len(chosen)]
    return Prediction(value, first if order else None)
