"""Interpolation along straight lines between nodes that are computed once, as lanes need them.

For lengths of whole events in fits: one takes milliseconds to seconds, and steps where the order of its breaks changes. What a
fit sees is continuous, and its slope is the trend over many steps.
"""

import itertools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

ON_NODE = 1e-9
"""Distance from a node, in spacings, at which the next one is not needed."""


class Grid:
    """Values, m numbers each, between nodes at whole multiples of a spacing along d axes.

    Parameters
    ----------
    spacing : sequence of float
        Along each axis.
    compute : callable
        Values at places (n, d), shape (n, m).
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


def distinct_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct rows, and which of them each row is: by a hash of the bits of a row, several times as fast as sorting rows."""
    odd = np.random.default_rng(0).integers(2**63, size=rows.shape[1], dtype=np.uint64) * 2 + 1
    _, first, own = np.unique(np.ascontiguousarray(rows).view(np.uint64) @ odd, return_index=True, return_inverse=True)
    if not np.array_equal(rows[first][own], rows):  # two rows of one hash: never seen
        different, own = np.unique(rows, axis=0, return_inverse=True)
        return different, own.ravel()
    return rows[first], own
