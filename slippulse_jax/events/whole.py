"""Lengths of whole events, in which contacts break again.

Beyond an onset of the areal stiffness (`slippulse_jax.exact.bulk`) contact 0 breaks again before the front stops, and
others after it: the event is a cascade in which the most overloaded contact breaks next (`slippulse_jax.events.rupture`), on
the chain of which enough sites are resolved. Everywhere else the event is its front.
"""

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.bodies.chain import chain, eliminate
from slippulse_jax.bodies.modes import Ends, RightEnd, lattice_modes
from slippulse_jax.bodies.response import response
from slippulse_jax.bulk.chunks import Kernel, Layout, over_lanes
from slippulse_jax.derivatives import with_jacobian
from slippulse_jax.events.event import BREAKS_PER_SITE
from slippulse_jax.events.rupture import one_rupture
from slippulse_jax.front.front import nucleation_load
from slippulse_jax.interface import Interface
from slippulse_jax.slider import Slider

ROOM = 1.25
"""Sites resolved at first, over the length of the front: an event seldom goes a fifth farther."""
FEW_SITES, MORE, MOST_SITES = 128, 4, 2**21
"""Smallest and largest number of sites, and the factor between two: each number is a program to compile."""
ONE_BY_ONE = Layout(chunk=1, fusion_emitters=False)
"""Each lane is a loop of its own."""


def event_lengths(
    lanes: Float[np.ndarray, "fields n"],
    front: Float[np.ndarray, " n"],
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    derivatives: int = 0,
) -> Float[np.ndarray, "rows n"]:
    """ℓ of whole events by the cascade; with derivatives in every field at a fixed order of breaks in the rows after it.

    Parameters
    ----------
    lanes : array, shape (3, n) or (5, n)
        H/λc, k/K, ν; and φ, ε.
    front : array, shape (n,)
        Length of the front of each, in λc.
    right, sites
        Right end of the chain, and the number of sites of a finite one.
    derivatives : {0, 1}

    Returns
    -------
    array
        inf where the event runs through a finite chain, NaN where it was given up.
    """
    found = np.full((1 + derivatives * len(lanes), lanes.shape[1]), np.nan)
    if sites is not None:
        found[:] = over_lanes(_kernel(right, sites, derivatives), lanes, ONE_BY_ONE)[0]
        return found
    resolved = FEW_SITES * MORE ** np.ceil(np.maximum(np.log(ROOM * front / FEW_SITES) / np.log(MORE), 0))
    while (resolved <= MOST_SITES).any():
        size = int(resolved.min())
        here = np.nonzero(resolved == size)[0]
        found[:, here] = over_lanes(_kernel(right, size, derivatives), lanes[:, here], ONE_BY_ONE)[0]
        farther = np.isinf(found[0, here])
        found[:, here[farther]] = np.nan
        resolved[here] = np.where(farther, MORE * size, np.inf)
    return found


@functools.cache
def _kernel(right: RightEnd, sites: int, derivatives: int) -> Kernel:
    """ℓ of a single lane, and its derivatives; forward mode through a cascade leaves its order as it is."""

    def length(lane: Float[Array, " fields"]) -> Array:
        slider, interface = Slider(*lane[:3]), Interface(*lane[3:]) if len(lane) > 3 else None
        whole = chain(slider, sites=sites, interface=interface, right=right)
        modes = lattice_modes(slider, Ends(right, None if right == "semi-infinite" else sites))
        loaded = whole.relaxed(nucleation_load(modes, interface))
        beyond = eliminate(whole, whole.contact)
        resp = response(whole, beyond, near=False)
        return one_rupture((BREAKS_PER_SITE * sites, 0), resp, beyond, whole, loaded, jnp.int32(0)).length

    return lambda lanes: ((with_jacobian(length)(lanes[:, 0]) if derivatives else length(lanes[:, 0])[None])[:, None],)
