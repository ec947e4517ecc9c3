"""Events on given profiles: many profiles by their fronts, a few contact by contact.

`fronts` breaks the contacts from the edge on, as `slippulse_jax.inference.recover.model` does, for many profiles at once.
`followed` breaks the most overloaded contact again and again, wherever it lies (`slippulse_jax.events.event`), and so finds
what the first leaves out: events that start far inside, stop short of the edge, or break a contact twice.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.bodies.response import of_slider
from slippulse_jax.events.event import first_event
from slippulse_jax.inference.recover.model import front_length
from slippulse_jax.slider import Slider

Sliders = tuple[np.ndarray, np.ndarray, np.ndarray]
"""H/λc, k/K and ν, of shapes that broadcast with the profiles without their contacts."""


class Events(NamedTuple):
    """One per profile."""

    length: Float[np.ndarray, "..."]  # ℓ, in λc; NaN where the event does not stop within the contacts followed
    start: Int[np.ndarray, "..."]  # contact that breaks first


def fronts(sliders: Sliders, theta: Float[np.ndarray, "... sites"], phi: Float[np.ndarray, "... sites"]) -> Events:
    """Follow fronts whose contacts break from the edge on, under the load at which the first contact breaks.

    Parameters
    ----------
    sliders : tuple of array
    theta, phi : array, shape (..., sites)
        Threshold and prestress of every contact, in σ_s.
    """
    return _each(_fronts, sliders, theta, phi)


def followed(sliders: Sliders, theta: Float[np.ndarray, "... sites"], phi: Float[np.ndarray, "... sites"]) -> Events:
    """Follow events in the order in which their contacts break, the most overloaded next.

    Parameters as for `fronts`.
    """
    return _each(_ruptures, sliders, theta, phi)


def _each(function: Callable[..., tuple[Array, Array]], sliders: Sliders, theta: np.ndarray, phi: np.ndarray) -> Events:
    shape, sites = theta.shape[:-1], theta.shape[-1]
    numbers = [np.broadcast_to(x, shape).ravel() for x in sliders]
    with jax.enable_x64(True):
        found = function(*numbers, theta.reshape(-1, sites), phi.reshape(-1, sites))
    return Events(*(np.asarray(x).reshape(shape) for x in found))


_fronts = jax.jit(jax.vmap(front_length))


@jax.jit
def _ruptures(*lanes: Array) -> tuple[Array, Array]:
    def one(lane: tuple[Array, ...]) -> tuple[Array, Array]:
        height, stiffness, poisson, theta, phi = lane
        response = of_slider(lattice_modes(Slider(height, stiffness, poisson)), theta.size)
        found, first, _, _ = first_event(response, theta, phi, kind="full")
        stress = found.contacts.stress[0]
        stopped = (stress < theta).all() & (found.rightmost < theta.size - 1)
        return jnp.where(stopped, found.length(stress, theta.size - 1), jnp.nan), first

    return lax.map(one, lanes)
