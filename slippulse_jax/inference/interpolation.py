"""Lengths of whole events on sliders for fits, along straight lines between nodes that are computed once, as lanes need them.

A whole event takes milliseconds to seconds, and its length steps where the order of its breaks changes. What a fit sees is
continuous, and its slope is the trend over many steps.

It is the ratio to the length of the front that is interpolated, which varies slowly.
"""

import itertools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from slippulse_jax.bulk.chunks import distinct_rows
from slippulse_jax.exact.bulk import NEVER
from slippulse_jax.interface import Interface
from slippulse_jax.lengths import lengths
from slippulse_jax.slider import Slider

ON_NODE = 1e-9
"""Distance from a node, in spacings, at which the next one is not needed."""
SHORTEST, STEEPEST = 1.01, 0.99
"""Least H/λc, and largest |ν| and |φ|, at which a node lies: inside the domains."""
SPACING = [0.25, 0.2, 0.1, 0.1, 0.1]
"""Spacing of the nodes of sliders, in ln H/λc, ln b, ν, φ and ε H/λc."""


class Grid:
    """Values, m numbers each, between nodes at whole multiples of a spacing along d axes.

    ``compute`` gives those at places (n, d), of shape (n, m).
    """

    def __init__(self, spacing: list[float], compute: Callable[[Float[np.ndarray, "n d"]], Float[np.ndarray, "n m"]]) -> None:
        self.spacing, self.compute = np.array(spacing), compute
        self.known: dict[tuple[int, ...], np.ndarray] = {}

    def __call__(self, place: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n m"]:
        """Values at places; NaN where they are NaN at all nodes around."""
        place = place / self.spacing
        node = np.floor(place + ON_NODE)
        share = np.where(place - node > ON_NODE, place - node, 0)
        parts = []
        between = set(np.nonzero(share)[1].tolist())
        for corner in itertools.product(*((0, 1) if axis in between else (0,) for axis in range(len(self.spacing)))):
            part = np.prod(np.where(corner, share, 1 - share), axis=1)
            near = np.nonzero(part)[0]
            parts.append((near, part[near], (node[near] + corner).astype(int)))
        near, part, nodes = (np.concatenate(column) for column in zip(*parts, strict=True))
        value = self._at(nodes)
        good = np.isfinite(value)
        total, weight = np.zeros((2, len(place), value.shape[1]))
        np.add.at(total, near, part[:, None] * np.where(good, value, 0))
        np.add.at(weight, near, part[:, None] * good)
        with np.errstate(invalid="ignore"):
            return total / weight

    def _at(self, nodes: Int[np.ndarray, "n d"]) -> Float[np.ndarray, "n m"]:
        """Values at nodes, computing those that are not known yet, all at once."""
        distinct, own = distinct_rows(nodes)
        keys = list(map(tuple, distinct.tolist()))
        new = [key for key in keys if key not in self.known]
        if new:
            self.known.update(zip(new, self.compute(np.array(new) * self.spacing), strict=True))
        return np.array([self.known[key] for key in keys])[own]


def whole_over_front(lanes: Float[np.ndarray, "5 n"]) -> Float[np.ndarray, " n"]:
    """ℓ of the whole event over ℓ of its front at (H/λc, k/K, ν, φ, ε); NaN where events were given up at all nodes around."""
    height, stiffness, poisson, prestress, slope = lanes
    b = 2 * (1 + poisson) * stiffness * height
    factor = np.ones(lanes.shape[1])
    # one spacing below the onset on relaxed, level interfaces no contact breaks again at any node
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
