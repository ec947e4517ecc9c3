"""Lengths of first precursors of a block, for fits: ℓ/H between nodes of a grid.

Over its height the length depends on b, ν, the push and the prestress, and hardly on λc/H, in which it is linear: few nodes
serve blocks of every height. Those of usual pushes come with the package (`python -m benchmarks block_table` computes them).
"""

import functools
from pathlib import Path

import numpy as np
from jaxtyping import Float

from slippulse_jax.inference.grid import Grid
from slippulse_jax.inference.parameters import Inputs
from slippulse_jax.lattice.blocks import Lanes, tall_lengths

SPACING = [0.005, 0.2, 0.1, 0.1, 0.05, 0.1, 1.0]
"""Of the grid, in λc/H, ln b, ν, φ, height and width of the push over H, and its kind: 1 for a patch, plus 2 for a force."""
TALLEST, SHORTEST, STEEPEST = 1e5, 1.01, 0.99
"""H/λc at which λc/H is taken as 0; the least H/λc, and the largest |ν| and |φ|, at which a node lies."""
LOWEST, NARROWEST = 0.005, 0.02
"""Least distance of a push from the corners of the side, and the least width of a patch, over H."""
TABLE = Path(__file__).with_name("block_lengths.npz")
"""Nodes that come with the package."""


def block_lengths(inputs: Inputs) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """ℓ, in λc, of whole events of blocks, and how far each may be off.

    It is 0 where no domino starts, and inf where the event does not stop at any node around.
    """
    height = np.exp(inputs.log_height)
    width = np.exp(inputs.log_push_width)
    patch = np.isfinite(width)
    kind = patch + 2 * inputs.push_force
    at = (1 / height, inputs.log_b, inputs.poisson, inputs.prestress, np.exp(inputs.log_push), np.where(patch, width, 0), kind)
    found, error = block_grid()(np.stack(at, axis=1)).T
    return np.where(np.isnan(found), np.inf, found) * height, error * height


def _nodes(place: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 2"]:
    """ℓ/H at places, and how far it may be off."""
    inverse, b, poisson, prestress, at, width, kind = place.T
    poisson = np.clip(poisson, -STEEPEST, 0.5)
    height = np.clip(1 / np.maximum(inverse, 1 / TALLEST), SHORTEST, TALLEST)
    at = np.clip(at, 2 * LOWEST, 1 - 2 * LOWEST)
    width = np.minimum(np.maximum(width, NARROWEST), 2 * (np.minimum(at, 1 - at) - LOWEST / 2))
    lanes = Lanes(
        height=height,
        stiffness=np.exp(b) / (2 * (1 + poisson) * height),
        poisson=poisson,
        prestress=np.clip(prestress, -STEEPEST, STEEPEST),
        threshold_slope=np.zeros(len(place)),
        push_height=at,
        push_width=width,
    )
    found = np.empty((len(place), 2))
    for one in np.unique(kind):
        force, patch = divmod(round(one), 2)
        here = kind == one
        some = Lanes(*(x[here] for x in lanes))
        if not patch:
            some = some._replace(push_width=np.full(here.sum(), np.nan))
        found[here] = np.stack(tall_lengths(some, "force" if force else "displacement"), axis=1) / height[here, None]
    return found


@functools.cache
def block_grid() -> Grid:
    """ℓ/H and how far it may be off, with the nodes that come with the package."""
    grid = Grid(SPACING, _nodes)
    with np.load(TABLE) as table:
        grid.known.update(zip(map(tuple, table["node"].tolist()), table["value"].astype(float), strict=True))
    return grid


def packaged_b(length: float, poisson: float, push_height: float) -> float | None:
    """The smallest b at which a tall block pushed above a height has a length over H, at the nearest ν of the packaged nodes.

    nan where no b gives so long an event; None where the package has no such nodes.
    """
    nearest, at = (round(x / step) for x, step in ((min(max(poisson, 0.2), 0.4), SPACING[2]), (push_height, SPACING[4])))
    every = [(j, value[0]) for (i, j, *more), value in block_grid().known.items() if (i, *more) == (0, nearest, 0, at, 0, 0)]
    if not every:
        return None
    node, found = np.array(sorted(every)).T
    above = found >= length
    if not above.any():
        return float("nan")
    i = max(int(np.argmax(above)), 1)
    return float(np.exp(SPACING[1] * np.interp(length, found[i - 1 : i + 1], node[i - 1 : i + 1])))
