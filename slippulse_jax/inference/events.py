"""Length of the whole event over that of its front, for fits: interpolated between cascades.

The length of an event steps where the order of its breaks changes, by up to a few per cent in short sliders, and one takes
milliseconds to seconds. Over the front's it varies slowly. So it is computed once on a grid of the inputs, as far as lanes need
it, and interpolated along straight lines: what a fit sees is continuous, and its slope is the trend over many steps.
"""

import itertools

import numpy as np
from jaxtyping import Float

from slippulse_jax.interface import Interface
from slippulse_jax.lattice.lengths import lengths
from slippulse_jax.lattice.rebreaking import NEVER
from slippulse_jax.slider import Slider

SPACING = np.array([0.25, 0.2, 0.1, 0.1, 0.1])
"""Of the grid, in ln H/λc, ln b, ν, φ and ε H/λc."""
ON_NODE = 1e-9
"""Distance from a node, in spacings, at which the next one is not needed."""
SHORTEST, STEEPEST = 1.01, 0.99
"""Least H/λc, and largest |ν| and |φ|, at which a node lies: inside the domains."""

_known: dict[tuple[int, ...], float] = {}


def whole_over_front(lanes: Float[np.ndarray, "5 n"]) -> Float[np.ndarray, " n"]:
    """ℓ of the whole event over ℓ of its front, of lanes (H/λc, k/K, ν, φ, ε); NaN where events were given up all around."""
    height, stiffness, poisson, prestress, slope = lanes
    b = 2 * (1 + poisson) * stiffness * height
    factor = np.ones(lanes.shape[1])
    # one spacing below the onset of relaxed, level interfaces all nodes are those of fronts
    some = np.nonzero((np.log(b) > np.log(NEVER) - SPACING[1]) | (prestress != 0) | (slope != 0))[0]
    if not len(some):
        return factor
    place = np.stack([np.log(height), np.log(b), poisson, prestress, slope * height], axis=1)[some] / SPACING
    node = np.floor(place + ON_NODE)
    share = np.where(place - node > ON_NODE, place - node, 0)
    total, weight = np.zeros((2, len(some)))
    for corner in itertools.product((0, 1), repeat=5):
        part = np.prod(np.where(corner, share, 1 - share), axis=1)
        near = np.nonzero(part)[0]
        value = _at_nodes((node[near] + corner).astype(int))
        good = np.isfinite(value)
        total[near[good]] += part[near[good]] * value[good]
        weight[near[good]] += part[near[good]]
    with np.errstate(invalid="ignore"):
        factor[some] = total / weight
    return factor


def _at_nodes(node: np.ndarray) -> np.ndarray:
    """Values at nodes of the grid, (n, 5), computing those that are not known yet."""
    distinct, own = np.unique(node, axis=0, return_inverse=True)
    keys = list(map(tuple, distinct.tolist()))
    new = np.array([key for key in keys if key not in _known])
    if len(new):
        height, b, poisson, prestress, slope = (new * SPACING).T
        height, poisson = np.maximum(np.exp(height), SHORTEST), np.clip(poisson, -STEEPEST, 0.5)
        slider = Slider(height, np.exp(b) / (2 * (1 + poisson) * height), poisson)
        interface = Interface(np.clip(prestress, -STEEPEST, STEEPEST), slope / height) if new[:, 3:].any() else None
        front = lengths(slider, interface)
        with np.errstate(invalid="ignore"):
            ratio = np.where(front > 0, lengths(slider, interface, event="full") / front, 1)
        _known.update(zip(map(tuple, new.tolist()), ratio.tolist(), strict=True))
    return np.array([_known[key] for key in keys])[own.ravel()]
