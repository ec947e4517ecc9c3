"""Lengths of whole events for fits, interpolated along straight lines between nodes that are computed once, as lanes need them.

A whole event takes milliseconds to seconds, and its length steps where the order of its breaks changes. What a fit sees is
continuous, and its slope is the trend over many steps.

Of a slider it is the ratio to the length of the front that is interpolated, which varies slowly. Of a block it is ℓ/H: over
the height it depends on b, ν, the push and the prestress, and hardly on λc/H, in which it is linear, so that few nodes serve
blocks of every height. Those of usual pushes come with the package (`python -m benchmarks block_table` computes them).
"""

import functools
import itertools
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from tqdm.auto import tqdm

from slippulse_jax.bulk.chunks import distinct_rows
from slippulse_jax.events.resolution import many, tall_lengths
from slippulse_jax.exact.bulk import NEVER
from slippulse_jax.inference.inputs import Inputs
from slippulse_jax.interface import Interface
from slippulse_jax.lengths import lengths
from slippulse_jax.slider import Slider

ON_NODE = 1e-9
"""Distance from a node, in spacings, at which the next one is not needed."""
SHORTEST, STEEPEST = 1.01, 0.99
"""Least H/λc, and largest |ν| and |φ|, at which a node lies: inside the domains."""
SPACING = [0.25, 0.2, 0.1, 0.1, 0.1]
"""Spacing of the nodes of sliders, in ln H/λc, ln b, ν, φ and ε H/λc."""
BLOCK_SPACING = [0.005, 0.2, 0.1, 0.1, 0.05, 0.1, 1.0]
"""Spacing of those of blocks, in λc/H, ln b, ν, φ, height and width of the push over H, and its kind (patch 1, force 2)."""
TALLEST = 1e5
"""H/λc of a block at which λc/H is taken as 0."""
LOWEST, NARROWEST = 0.005, 0.02
"""Least distance of a push from the corners of the side, and the least width of a patch, over H."""
AT_ONCE, TIMED, LONG = 32, 1, 20.0
"""Nodes computed at once, the part of them after which their time is estimated (the first compiles), and a long time in s."""
TABLE = Path(__file__).with_name("block_lengths.npz")
"""Nodes of blocks that come with the package."""


def _announced(parts: list[list[Any]]) -> Iterator[list[Any]]:
    """Show the progress of the nodes computed: a bar on a terminal; elsewhere a line, once, if they take long."""
    count, begun = sum(map(len, parts)), time.monotonic()
    with tqdm(total=count, desc="events followed", unit=" events", delay=2, leave=False, disable=None) as bar:
        for number, part in enumerate(parts):
            yield part
            bar.update(len(part))
            left = (time.monotonic() - begun) / (number + 1) * (len(parts) - 1 - number)
            if number == TIMED and bar.disable and left > LONG and sys.stderr is not None:
                text = f"following {count} events of blocks, which takes about {left:.0f} s more"
                print(text, file=sys.stderr, flush=True)


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
        for part in _announced([new[i : i + AT_ONCE] for i in range(0, len(new), AT_ONCE)]):
            self.known.update(zip(part, self.compute(np.array(part) * self.spacing), strict=True))
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


def block_lengths(inputs: Inputs) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """ℓ, in λc, of whole events of blocks, and how far each may be off.

    It is 0 where no domino starts, and inf where the event does not stop at any node around.
    """
    height = np.exp(inputs.log_height)
    width, at = (np.exp(inputs.get(name)) for name in ("log_push_width", "log_push"))
    patch = np.isfinite(width)
    kind = patch + 2 * inputs.get("push_force")
    at = (1 / height, inputs.log_b, inputs.poisson, inputs.prestress, at, np.where(patch, width, 0), kind)
    found, error = block_grid()(np.stack(at, axis=1)).T
    return np.where(np.isnan(found), np.inf, found) * height, error * height


def _block_lengths(place: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 2"]:
    """ℓ/H at places, and how far it may be off."""
    inverse, b, poisson, prestress, at, width, kind = place.T
    poisson = np.clip(poisson, -STEEPEST, 0.5)
    height = np.clip(1 / np.maximum(inverse, 1 / TALLEST), SHORTEST, TALLEST)
    at = np.clip(at, 2 * LOWEST, 1 - 2 * LOWEST)
    width = np.minimum(np.maximum(width, NARROWEST), 2 * (np.minimum(at, 1 - at) - LOWEST / 2))
    numbers = height, np.exp(b) / (2 * (1 + poisson) * height), poisson, at
    prestress, found = np.clip(prestress, -STEEPEST, STEEPEST), np.empty((len(place), 2))
    for one in np.unique(kind):
        force, patch = divmod(round(one), 2)
        here = kind == one
        control = "force" if force else "displacement"
        block = many(*(x[here] for x in numbers), push_width=width[here] if patch else None, control=control)
        interface = Interface(prestress[here], np.zeros(here.sum()))
        found[here] = np.stack(tall_lengths(block, interface, "full"), axis=1) / height[here, None]
    return found


@functools.cache
def block_grid() -> Grid:
    """ℓ/H and how far it may be off, with the nodes that come with the package."""
    grid = Grid(BLOCK_SPACING, _block_lengths)
    with np.load(TABLE) as table:
        grid.known.update(zip(map(tuple, table["node"].tolist()), table["value"].astype(float), strict=True))
    return grid


def packaged_b(length: float, poisson: float, push_height: float) -> float | None:
    """Smallest b at which a tall block pushed above a height has this length over H, by the packaged nodes of nearest ν.

    nan where no b gives so long an event; None where the package has no such nodes.
    """
    nearest, at = (
        round(x / step) for x, step in ((min(max(poisson, 0.2), 0.4), BLOCK_SPACING[2]), (push_height, BLOCK_SPACING[4]))
    )
    every = [(j, value[0]) for (i, j, *more), value in block_grid().known.items() if (i, *more) == (0, nearest, 0, at, 0, 0)]
    if not every:
        return None
    node, found = np.array(sorted(every)).T
    above = found >= length
    if not above.any():
        return float("nan")
    i = max(int(np.argmax(above)), 1)
    return float(np.exp(BLOCK_SPACING[1] * np.interp(length, found[i - 1 : i + 1], node[i - 1 : i + 1])))
