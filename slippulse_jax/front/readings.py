r"""Slip and stress along the interface after a front has passed.

When the contacts before `position` have broken in turn (of the last a part, where `position` is no whole number: f²(3 − 2f) of
it for a fraction f, so that fields are smooth in the position), pinning points have moved by p_j, and at site i, in units of
u_s and σ_s,

    slip(i)   = Σ_j G_ij p_j,
    stress(i) = φ + A Σ_m C_m r_m^i + slip(i) − p_i,      A = 1 − φ:

how far the interfacial layer moved while the front ran, and what the contact carries (label cra06).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slippulse_jax.bodies.modes import ENDLESS, Ends, equilibrium_fields, lattice_modes
from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.front.front import sweep
from slippulse_jax.slider import Slider


class Readings(NamedTuple):
    """At every contact from the edge on, when a front has stopped."""

    slip: Float[Array, " sites"]  # in u_s
    stress: Float[Array, " sites"]  # in σ_s


@in_full
def readings(slider: Slider, prestress: Array, position: Array, count: int, ends: Ends = ENDLESS) -> Readings:
    """Slip and contact stress at the first `count` contacts after a front that stopped at `position`.

    Parameters
    ----------
    slider : Slider
        One slider.
    prestress : array, shape ()
        φ, in σ_s.
    position : array, shape ()
        Contacts broken, at most `count`; between whole numbers the fields change smoothly from one to the next.
    count : int
        Contact i lies at x = i λc.
    ends : Ends
        Right end and drive; beyond a free end the fields have no meaning.
    """
    modes, site = lattice_modes(slider, ends), jnp.arange(count, dtype=position.dtype)
    part = jnp.clip(position - site, 0, 1)
    broken = part**2 * (3 - 2 * part)
    loaded = jnp.ones_like(modes.load)  # contact 0 carries its threshold
    moved = broken * sweep(modes, loaded, prestress + 0 * site, lambda _, broken: broken, broken)
    slip = equilibrium_fields(modes, jnp.zeros_like(modes.load), moved).layer
    driven = (1 - prestress) * jax.vmap(modes.profile)(site) @ modes.drive
    return Readings(slip, prestress + driven + slip - moved)
