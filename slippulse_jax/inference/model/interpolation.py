"""Values between nodes that are computed once, as they are needed."""

import itertools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from slippulse_jax.bulk.chunks import distinct_rows

ON_NODE = 1e-9
"""Distance from a node, in spacings, at which the next one is not needed."""


class Grid:
    """Values, m numbers each, between nodes at whole multiples of a spacing along d axes.

    ``compute`` gives those at places (n, d), of shape (n, m).
    """

    def __init__(self, spacing: list[float], compute: Callable[[Float[np.ndarray, "n d"]], Float[np.ndarray, "n m"]]) -> None:
        self.spacing, self.compute = np.array(spacing), compute
        self.known: dict[tuple[int, ...], np.ndarray] = {}

    def __call__(self, place: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "2 m n"]:
        """Values at places, NaN where they are NaN at all nodes around; and the weight of the nodes at which they are not."""
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
            return np.stack([(total / weight).T, weight.T])

    def _at(self, nodes: Int[np.ndarray, "n d"]) -> Float[np.ndarray, "n m"]:
        """Values at nodes, computing those that are not known yet, all at once."""
        distinct, own = distinct_rows(nodes)
        keys = list(map(tuple, distinct.tolist()))
        new = [key for key in keys if key not in self.known]
        if new:
            self.known.update(zip(new, self.compute(np.array(new) * self.spacing), strict=True))
        return np.array([self.known[key] for key in keys])[own]
