"""Onset of re-breaking: the contact at the edge is back at its threshold before the front stops.

Contact 0 repins as the front starts, and every later break adds to the stress that it carries. Beyond an onset of the areal
stiffness it is back at its threshold before the front stops, and the event has more breaks than one front.
"""

from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax import double_series as series
from slippulse_jax.bulk.chunks import over_lanes
from slippulse_jax.domains import HEIGHT, POISSON, PRESTRESS
from slippulse_jax.lattice.crossing import system_of
from slippulse_jax.lattice.exact_lanes import CAREFULLY, EXACT_OUTCOMES, IN_BULK, exact_fronts
from slippulse_jax.status import Outcome

ARREST_OUTCOMES = (*EXACT_OUTCOMES, Outcome.REBREAK)
"""Possible outcomes of an exact front once the edge behind it is looked at."""

NEVER = 3.0
"""b below which contact 0 of a relaxed interface on level thresholds never breaks again: the onset falls towards 3.0872
(`slippulse_jax.theory.rebreaking_b`) as H/λc grows, and never below."""


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
