"""Length, count, status and edge stress of one front, and refusals."""

import functools
import operator
import warnings
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.base.outcomes import length_or_reason, outcome
from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.bulk.derivatives import by_forward_mode
from slippulse_jax.front import front
from slippulse_jax.interface import AnyInterface, Interface, Profile
from slippulse_jax.rules import BreakRule
from slippulse_jax.slider import Slider, of_one_type

MOST_BREAKS = 10_000_000
"""Breaks after which a front is given up: beyond any slider of H/λc up to several million."""

AnyArray = Array | np.ndarray


class LengthDerivatives(NamedTuple):
    """Lengths of a batch, and their derivatives, in places as of ``jax.grad``.

    ``slider.stiffness`` is dℓ/d(k/K), ``slider.length`` dℓ/dN, ``interface.prestress`` dℓ/dφ. All are NumPy float64 of the
    shape of the batch, in λc per unit of the parameter: NaN where the length is not finite, and 0 where no domino starts.
    """

    length: np.ndarray  # ℓ or ℓ*
    slider: Slider
    interface: Interface | None = None
    rule: BreakRule | None = None


class Arrest(NamedTuple):
    """Where and how fronts ended; of NumPy arrays in bulk."""

    contacts_broken: Int[AnyArray, "..."]
    length: Float[AnyArray, "..."]  # ℓ, in λc
    status: Int[AnyArray, "..."]
    edge_stress: Float[AnyArray, "..."]  # stress on contact 0 behind the front, in σ_s


class FrontNotArrested(NotConverged):
    """The front was given up while it still ran: no length."""


def arrest(
    slider: Slider,
    interface: AnyInterface = None,
    rule: BreakRule | None = None,
    *,
    most: int = MOST_BREAKS,
) -> Arrest:
    """Length, count, status and edge stress of one first precursor.

    It is given up after `most` breaks. Differentiable forward.
    """
    modes = lattice_modes(slider)
    over = front.passage(modes, interface, rule)
    # where a front counts as one that never stops, or is given up; and how many contacts there are
    end, contacts = front.never_stops_after(modes, interface, rule), slider.sites
    limit = jnp.minimum(jnp.minimum(end, 2.0e9).astype(jnp.int32), most)
    before_last = limit if contacts is None else jnp.minimum(limit, contacts - 1)
    at, (stress, threshold), part, length = front.follow(rule, *over, before_last, front.degree_of(interface))

    through = last = jnp.zeros((), bool)
    if contacts is not None:
        last = (at.position == contacts - 1) & (at.position < limit)
        through = last & (part > 0.5)
        at = jax.tree.map(lambda new, old: jnp.where(through, new, old), over[2](at, part, stress), at)
    numbers = [x.in_domain() for x in (interface, rule) if x is not None]
    status = outcome(
        at.position,
        (part > front.FADED) & ~last,
        at.edge[0] - front.contact_at(modes, interface, 0)[0],
        valid=functools.reduce(operator.and_, numbers, slider.in_domain() & jnp.isfinite(stress - threshold)),
        through=through,
        endless=at.position.astype(end.dtype) >= end,
    )
    return Arrest(at.position, length_or_reason(status, length), status, at.edge[0] + front.kept_at(interface, 0 * at.edge[0]))


@partial(jax.jit, static_argnames="name")
def quantity(name: str, slider: Slider, interface: AnyInterface, rule: BreakRule | None = None) -> Array:
    """One number of the `arrest` of every slider, or of one profile.

    The length has derivatives of every order in every mode; the other numbers have none.
    """
    kind = jax.tree.structure((slider, interface, rule))

    def one(*numbers: Array) -> Array:
        slider, interface, rule = jax.tree.unflatten(kind, numbers)
        return getattr(arrest(slider, interface, rule), name)

    numbers = of_one_type(slider, *jax.tree.leaves((slider, interface, rule))[3:])
    if name == "length":
        one = by_forward_mode(one)
    else:
        numbers = lax.stop_gradient(numbers)
    return one(*numbers) if isinstance(interface, Profile) else jnp.vectorize(one)(*numbers)


def report_without_length(status: np.ndarray, *, raises: bool, stacklevel: int = 3) -> None:
    """Raise or warn about fronts that have no length."""
    for kind in (Outcome.LIMIT, Outcome.INVALID):
        lanes = status == kind
        if not lanes.any():
            continue
        why = kind.message + (f": {MOST_BREAKS}" if kind is Outcome.LIMIT else "")
        if raises:
            raise FrontNotArrested(why) if kind is Outcome.LIMIT else ValueError(why)
        first = tuple(int(i) for i in np.argwhere(lanes)[0])
        message = f"{int(lanes.sum())} of {lanes.size} fronts, the first at index {first}, have no length (NaN): {why}"
        warnings.warn(message, RuntimeWarning, stacklevel=stacklevel)
