"""Compiled functions of the fast recursion, one a configuration: what `precursor` and `bulk` call."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from slippulse_jax.bulk.chunks import Kernel
from slippulse_jax.derivatives import by_forward_mode
from slippulse_jax.interface import Interface, Profile, check_bulk
from slippulse_jax.lattice import delayed as interface_front
from slippulse_jax.lattice.front import Arrest, arrest
from slippulse_jax.lattice.modes import RightEnd
from slippulse_jax.lattice.smooth import smooth_length
from slippulse_jax.rules import SmoothBreak
from slippulse_jax.slider import Slider

Configuration = tuple[RightEnd, int | None, int]
"""Right end, number of sites, most contacts."""


def fields(slider: Slider, interface: Interface | None) -> tuple[Any, ...]:
    """The numbers a lane is made of: three, or five with prestress and threshold slope."""
    check_bulk(interface)
    three = slider.height, slider.stiffness, slider.poisson
    return three if interface is None else (*three, interface.prestress, interface.threshold_slope)


def shape_of(slider: Slider, interface: Interface | None) -> tuple[int, ...]:
    """Shape of the batch."""
    return slider.shape if interface is None else np.broadcast_shapes(slider.shape, interface.shape)


def parameters(slider: Slider, interface: Interface | None) -> Float[Array, "... n"]:
    """`fields`, broadcast, in the last axis."""
    shape = shape_of(slider, interface)
    return jnp.stack([jnp.broadcast_to(jnp.asarray(x), shape) for x in fields(slider, interface)], axis=-1)


def arrest_of(lane: Float[Array, " n"], delay: int, configuration: Configuration) -> Arrest:
    """`Arrest` of one lane of three or five numbers; `delay` counts only with five."""
    slider = Slider(lane[0], lane[1], lane[2])
    if lane.shape[0] == 3:
        return arrest(slider, *configuration)
    return interface_front.arrest(slider, Interface(lane[3], lane[4], delay), *configuration)


@functools.cache
def length_function(delay: int, configuration: Configuration) -> Callable[[Array], Array]:
    """ℓ of lanes, with derivatives."""
    length = by_forward_mode(lambda lane: jnp.asarray(arrest_of(lane, delay, configuration).length))
    return jax.jit(jnp.vectorize(length, signature="(n)->()"))


@functools.cache
def status_function(delay: int, configuration: Configuration) -> Callable[[Array], Array]:
    """Status of lanes."""
    status = jnp.vectorize(lambda lane: jnp.asarray(arrest_of(lane, delay, configuration).status), signature="(n)->()")
    return jax.jit(status)


@functools.cache
def arrest_function(delay: int, configuration: Configuration) -> Callable[[Array], Arrest]:
    """`Arrest` of one lane."""
    return jax.jit(lambda lane: arrest_of(lane, delay, configuration))


@functools.cache
def arrest_kernel(delay: int, configuration: Configuration) -> Kernel:
    """`Arrest` of a chunk of lanes of any configuration."""

    def arrests(lanes: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        return tuple(jnp.asarray(x) for x in jax.vmap(lambda lane: arrest_of(lane, delay, configuration), in_axes=1)(lanes))

    return arrests


@functools.cache
def gradient_kernel(delay: int, configuration: Configuration) -> Kernel:
    """ℓ of a chunk of lanes of any configuration, and its derivative in every field."""
    return _with_derivatives(lambda lane: jnp.asarray(arrest_of(lane, delay, configuration).length))


@functools.cache
def smooth_kernel(kind: Any, max_contacts: int) -> Kernel:
    """ℓ_w of a chunk of lanes: the numbers of a slider and of a rule, which `kind` puts together."""
    return lambda lanes: (smooth_length(*jax.tree.unflatten(kind, list(lanes)), max_contacts=max_contacts)[0],)


@functools.cache
def smooth_gradient_kernel(kind: Any, max_contacts: int) -> Kernel:
    """ℓ_w likewise, and its derivative in every number of slider and rule."""
    return _with_derivatives(lambda x: smooth_length(*jax.tree.unflatten(kind, list(x)), max_contacts=max_contacts)[0])


def _with_derivatives(length: Callable[[Array], Array]) -> Kernel:
    """Of a function of one lane: its value, and its derivative in every field."""

    def one(lane: Array) -> tuple[Array, ...]:
        gradient, value = jax.jacfwd(lambda x: (length(x),) * 2, has_aux=True)(lane)
        return value, *gradient

    return jax.vmap(one, in_axes=1)


@functools.cache
def profile_function(configuration: Configuration) -> Callable[[Slider, Profile], Arrest]:
    """`Arrest` of one slider on a profile; its length has derivatives, at the cost of one tangent a number of the profile."""

    def ended(slider: Slider, profile: Profile) -> Arrest:
        numbers, together = ravel_pytree((slider, profile))

        def outcome(x: Array) -> Arrest:
            slider, profile = together(x)
            return interface_front.arrest(slider, profile, *configuration)

        length = by_forward_mode(lambda x: jnp.asarray(outcome(x).length))
        return outcome(jax.lax.stop_gradient(numbers))._replace(length=length(numbers))

    return eqx.filter_jit(ended)


@functools.cache
def smooth_function(max_contacts: int) -> Callable[[Slider, SmoothBreak], tuple[Array, Array]]:
    """ℓ and status under a smooth rule."""
    return jax.jit(lambda slider, rule: smooth_length(slider, rule, max_contacts=max_contacts))
