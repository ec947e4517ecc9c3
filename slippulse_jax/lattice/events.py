"""Events in which contacts break again: where they begin, and how far they go.

Contact 0 repins as the front starts, and every later break adds to the stress that it carries. Beyond an onset of the areal
stiffness it is back at its threshold before the front stops. It then breaks again, and others after it: the event is a cascade
in which the most overloaded contact breaks next (`slippulse_jax.lattice.rupture`), on the chain of which enough sites are
resolved. Everywhere else the event is its front.
"""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax import double_series as series
from slippulse_jax.bulk.chunks import Kernel, Layout, over_lanes
from slippulse_jax.derivatives import with_jacobian
from slippulse_jax.domains import HEIGHT, POISSON, PRESTRESS
from slippulse_jax.interface import Interface
from slippulse_jax.lattice.chain import chain, eliminate
from slippulse_jax.lattice.crossing import system_of
from slippulse_jax.lattice.event import BREAKS_PER_SITE
from slippulse_jax.lattice.exact_lanes import CAREFULLY, EXACT_OUTCOMES, IN_BULK, exact_fronts
from slippulse_jax.lattice.front import nucleation_load
from slippulse_jax.lattice.modes import Ends, RightEnd, lattice_modes
from slippulse_jax.lattice.response import response
from slippulse_jax.lattice.rupture import one_rupture
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

ROOM = 1.25
"""Sites resolved at first, over the length of the front: an event seldom goes a fifth farther."""
FEW_SITES, MORE, MOST_SITES = 128, 4, 2**21
"""Smallest and largest number of sites, and the factor between two: each number is a program to compile."""
ONE_BY_ONE = Layout(chunk=1, fusion_emitters=False)
"""Each lane is a loop of its own."""
ARREST_OUTCOMES = (*EXACT_OUTCOMES, Outcome.REBREAK)
"""Possible outcomes of an exact front, with the stress on the edge behind it."""

NEVER = 3.0
"""b below which contact 0 of a relaxed interface on level thresholds never breaks again: the onset falls towards 3.0872
(`slippulse_jax.theory.rebreaking_b`) as H/λc grows, and never below."""


# --- where contact 0 breaks again ---------------------------------------------------------------------------------------


def exact_arrests(lanes: Float[np.ndarray, "5 n"]) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """As `exact_fronts`, with `REBREAK` among the outcomes."""
    length, status = exact_fronts(lanes)
    edge = np.full(length.shape, np.nan)
    b = 2 * (1 + lanes[2]) * lanes[1] * lanes[0]
    may = (status == Outcome.ARRESTED) & ((b >= NEVER) | (lanes[3:] != 0).any(0))
    for kernel, layout in ((_edge, IN_BULK), (_careful_edge, CAREFULLY)):
        left = may & np.isnan(edge)
        if left.any():
            behind = np.vstack([lanes[:, left], np.maximum(np.ceil(length[left]), 1)])
            (edge[left],) = over_lanes(kernel, behind, layout)
    return length, np.where(edge >= 1, np.int32(Outcome.REBREAK), status)


def rebreaking_onset(height: Any, poisson: Any, prestress: Any = 0.0) -> Float[np.ndarray, "..."]:
    """Smallest b at which contact 0 breaks again before the front stops.

    b is the areal shear stiffness of the interface times H over the shear modulus (`Slider.b`). Beyond the onset the event is
    no longer one front, and goes farther than it: the status is `REBREAK`.

    Parameters
    ----------
    height, poisson, prestress : array_like
        H/λc, ν and φ, which broadcast.

    Returns
    -------
    numpy.ndarray
        float64; inf where contact 0 never breaks again, as in sliders of H/λc < 7. It tends to
        `slippulse_jax.theory.rebreaking_b` = 3.0872 for tall sliders, about as 5.5 (H/λc)^{−1/2}.

    Notes
    -----
    The first change of status on a grid of b, bisected. In short sliders contact 0 holds again where b is large, because
    the front is shorter there.
    """
    for name, domain, value in (("height", HEIGHT, height), ("poisson", POISSON, poisson), ("prestress", PRESTRESS, prestress)):
        domain.check(f"rebreaking_onset: {name}", value)
    height, poisson, prestress = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (height, poisson, prestress)))
    fixed = [x.reshape(-1, 1) for x in (height, poisson, prestress)]

    def again(b: Float[np.ndarray, "n m"]) -> Bool[np.ndarray, "n m"]:
        H, nu, phi = (np.broadcast_to(x, b.shape).ravel() for x in fixed)
        lanes = np.stack([H, b.ravel() / (2 * (1 + nu) * H), nu, phi, np.zeros(b.size)])
        return (exact_arrests(lanes)[1] == Outcome.REBREAK).reshape(b.shape)

    grid = np.broadcast_to(np.geomspace(NEVER, 100 * NEVER, 128), (height.size, 128))
    found = again(grid)
    first, some = found.argmax(1, keepdims=True), found.any(1, keepdims=True)
    high = np.take_along_axis(grid, first, 1)
    low = np.take_along_axis(grid, np.maximum(first - 1, 0), 1)
    while (high - low > 1e-12 * high).any():
        middle = (low + high) / 2
        beyond = again(middle)
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return np.where(some, high, np.inf).reshape(height.shape)


def _edge(lanes: Float[Array, "6 lanes"]) -> tuple[Array]:
    return (series.edge_stress(series.solve(system_of(lanes[:5], prestressed=True), regular=False), lanes[5]),)


def _careful_edge(lanes: Float[Array, "6 lanes"]) -> tuple[Array]:
    return (series.edge_stress(series.solve(system_of(lanes[:5], prestressed=True)), lanes[5]),)


# --- lengths of whole events --------------------------------------------------------------------------------------------


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
