"""Length of the whole event over that of its front, for fits: it varies slowly, and is interpolated between cascades."""

import numpy as np
from jaxtyping import Float

from slippulse_jax.inference.grid import Grid
from slippulse_jax.interface import Interface
from slippulse_jax.lattice.events import NEVER
from slippulse_jax.lattice.lengths import lengths
from slippulse_jax.slider import Slider

SPACING = [0.25, 0.2, 0.1, 0.1, 0.1]
"""Of the grid, in ln H/λc, ln b, ν, φ and ε H/λc."""
SHORTEST, STEEPEST = 1.01, 0.99
"""Least H/λc, and largest |ν| and |φ|, at which a node lies: inside the domains."""


def whole_over_front(lanes: Float[np.ndarray, "5 n"]) -> Float[np.ndarray, " n"]:
    """ℓ of the whole event over ℓ of its front, of lanes (H/λc, k/K, ν, φ, ε); NaN where events were given up all around."""
    height, stiffness, poisson, prestress, slope = lanes
    b = 2 * (1 + poisson) * stiffness * height
    factor = np.ones(lanes.shape[1])
    # one spacing below the onset of relaxed, level interfaces all nodes are those of fronts
    some = np.nonzero((np.log(b) > np.log(NEVER) - SPACING[1]) | (prestress != 0) | (slope != 0))[0]
    if len(some):
        place = np.stack([np.log(height), np.log(b), poisson, prestress, slope * height], axis=1)
        factor[some] = _grid(place[some])[:, 0]
    return factor


def _ratios(place: Float[np.ndarray, "n 5"]) -> Float[np.ndarray, "n 1"]:
    height, b, poisson, prestress, slope = place.T
    height, poisson = np.maximum(np.exp(height), SHORTEST), np.clip(poisson, -STEEPEST, 0.5)
    slider = Slider(height, np.exp(b) / (2 * (1 + poisson) * height), poisson)
    interface = Interface(np.clip(prestress, -STEEPEST, STEEPEST), slope / height) if prestress.any() or slope.any() else None
    front = lengths(slider, interface)
    with np.errstate(invalid="ignore"):
        return np.where(front > 0, lengths(slider, interface, event="full") / front, 1)[:, None]


_grid = Grid(SPACING, _ratios)
