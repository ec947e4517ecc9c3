"""Observables beside the length, at nucleation and after arrest.

Force and displacement are closed forms in the two lattice modes. Gauges read slip and stress along the interface when the
front has stopped, which go over smoothly from one whole count of contacts to the next. Each is a JAX function of the inputs of
one measurement.
"""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.inference.model.fronts import Along, Front, Predicted, by_jax, sliders
from slippulse_jax.inference.model.inputs import Input, Inputs
from slippulse_jax.slider import Slider

OF_GAUGES = {
    "log_position": Input("x/λc", -np.inf, np.inf, ""),  # ln of a gauge's distance from the pushed edge
    "beyond": Input("", 0.0, 1.0, ""),  # contacts broken beyond ℓ, 0 to 1, when gauges were read
    "counted": Input("", 0.0, np.inf, ""),  # contacts counted as broken when gauges were read; 0 where they were not
}
"""Inputs of readings beside those of the front."""
FEW_SITES, MORE_SITES, MOST_SITES = 64, 4, 2**20
"""Smallest and largest number of contacts whose fields are computed, by steps of a factor; where a front runs farther than the
largest the prediction is inf."""


def displacement(front: Front, inputs: Inputs, relaxed: bool) -> Array:
    """Displacement of the pushed edge at nucleation, in u_s = f_s/k."""
    return (1 - inputs.prestress) * lattice_modes(_displaced(inputs)).load


def force(front: Front, inputs: Inputs, relaxed: bool) -> Array:
    """Driving force at nucleation, in f_s, the threshold of one contact.

    It is the sum over the contacts, Σ_i Σ_m C_m y_m(i), a geometric series in each mode.
    """
    slider = _displaced(inputs)
    modes = lattice_modes(slider)
    every = modes.drive / modes.gap
    if slider.length is not None:  # there and, from the free end, back again: 1 + r + … + r^{2N − 1}
        every = every * -jnp.expm1(2 * slider.length * jnp.log1p(-modes.gap))
    return (1 - inputs.prestress) * every.sum()


def _displaced(inputs: Inputs) -> Slider:
    """The slider whose edge is displaced, without its machine."""
    return sliders(inputs.without("log_machine"), jnp.exp)


def reading(which: int, front: Front, inputs: Inputs, relaxed: bool, sites: int) -> Array:
    """Slip in u_s, or stress in σ_s, at a gauge after arrest.

    By a straight line between two contacts; inf without arrest, and if `sites` are too few.
    """
    lone = inputs.without(*OF_GAUGES)
    # contact 0 has broken even where no domino starts
    free = jnp.maximum(front.length(lone, relaxed) + inputs.get("beyond"), 1)
    stopped = jnp.where(inputs.get("counted") > 0, inputs.get("counted"), free)
    place = jnp.exp(inputs.get("log_position"))
    known = (stopped < sites) & (place + 1 < sites)
    left = jnp.where(known, jnp.floor(place), 0).astype(jnp.int32)
    field = front.fields(lone, jnp.where(known, stopped, 1), sites)[which]
    return jnp.where(known, field[left] + (place - left) * (field[left + 1] - field[left]), jnp.inf)


OBSERVED = {"displacement": displacement, "force": force, "slip": partial(reading, 0), "stress": partial(reading, 1)}
"""Models of observables: of front, inputs of a lane, whether it is relaxed, and for gauges how many fields are computed."""


def predicted(observable: str, front: Front, inputs: Inputs, along: Along = None) -> Predicted:
    """Predictions of many lanes, and their derivatives along a line."""
    if observable in ("length", "first"):
        return front.evaluate(inputs, along)
    if observable in ("displacement", "force"):
        return by_jax(OBSERVED[observable], front, inputs, along)
    counted = inputs.get("counted")
    stopped = np.where(counted > 0, counted, front.lengths(inputs.without(*OF_GAUGES)) + inputs.get("beyond"))
    reach = np.maximum(stopped, np.exp(inputs.get("log_position"))) + 2
    # few array sizes, so that few programs are compiled
    steps = np.ceil(np.log(np.maximum(reach, FEW_SITES) / FEW_SITES) / np.log(MORE_SITES) - 1e-9)
    size = np.where(reach < MOST_SITES, FEW_SITES * MORE_SITES ** np.where(reach < MOST_SITES, steps, 0), 0).astype(int)
    found = np.zeros((1 if along is None else 3, len(reach)))
    found[0] = np.inf
    for count in np.unique(size[size > 0]).tolist():
        here, direction = size == count, None if along is None else along[size == count]
        found[:, here] = by_jax(OBSERVED[observable], front, inputs.take(here), direction, sites=count)
    return found
