"""Slabs of a block under two-dimensional elasticity: graded columns of rectangular elements over one contact.

Elements are the four-node rectangles with two incompatible modes of Taylor, Beresford and Wilson (QM6), which bend without
locking. Four of them lie side by side over a contact, more over that at the edge; they are graded upwards from the interface
and away from the pusher, whose ends are nodes, so that everything is a smooth function of the heights. There the stress is
singular, which leaves lengths 0.1 % short, 0.2 % where few contacts break. In λc and E = 1. A mesh that is `finer` by n has 2ⁿ
elements in the place of each, along and across.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.block import Block
from slippulse_jax.bodies.waveguide import Along, Slab, doubled
from slippulse_jax.bulk.compiler import in_full

GAUSS = 3**-0.5
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)

AT_INTERFACE = 0.12
"""Height of the elements at the interface, roughly, in λc."""
AT_PUSHER = 2.5e-4
"""Height of those at an end of the pusher, roughly, over H."""
HALVINGS = 2
"""Number of elements side by side over a contact, as a power of 2."""
CORNER = 9
"""Number of elements side by side over contact 0, graded towards the pusher."""
BELOW, NEAR, OVER, ABOVE = 12, 15, 12, 17
"""Elements above the interface, below the pusher, over the pusher, and above it."""


def heights(block: Block, finer: int = 0) -> Float[Array, " nodes"]:
    """Heights of the nodes of a column, the ends of the pusher among them."""
    H, (low, high) = jnp.asarray(block.height), block.push.reach

    def graded(start: Array, end: Array, size: Array | float, count: int) -> Array:
        return _graded(start, end, size / 2**finer, count * 2**finer)

    if block.push.height is None:
        return graded(0 * H, H, AT_INTERFACE, BELOW + NEAR + ABOVE)
    fine, none = AT_PUSHER * H, 0 * H
    parts = [graded(none, low * H / 2, AT_INTERFACE, BELOW), graded(low * H, low * H / 2, fine, NEAR)[::-1]]
    if block.push.width is not None:
        centre = (low + high) * H / 2
        parts += [graded(low * H, centre, fine / 2, OVER // 2), graded(high * H, centre, fine / 2, OVER // 2)[::-1]]
    parts.append(graded(high * H if block.push.width is not None else low * H, H, fine, ABOVE))
    return jnp.concatenate([parts[0], *(part[1:] for part in parts[1:])])


def _graded(start: Array, end: Array, size: Array | float, count: int) -> Array:
    """Nodes from `start` to `end`, by a hyperbolic sine fine at the start and ever coarser: about `size` there."""
    scale = count * size / jnp.log1p(count)
    rate = jnp.arcsinh(jnp.abs(end - start) / scale)
    return start + (end - start) * jnp.sinh(rate * jnp.linspace(0, 1, count + 1)) / jnp.sinh(rate)


def _strains() -> tuple[np.ndarray, np.ndarray]:
    """Strains (ε_x, ε_y, 2 ε_xy) at four Gauss points of a rectangle, times its width and times its height (second axis).

    Per displacement (u_x, u_y) of its corners, and per incompatible mode.
    """
    x, y = CORNERS.T
    nodal, modes = np.zeros((4, 2, 3, 8)), np.zeros((4, 2, 3, 4))
    for at, (a, b) in enumerate(GAUSS * CORNERS):
        along, across = x * (1 + y * b) / 2, y * (1 + x * a) / 2
        nodal[at, 0, 0, 0::2] = nodal[at, 0, 2, 1::2] = along
        nodal[at, 1, 1, 1::2] = nodal[at, 1, 2, 0::2] = across
        modes[at, 0, 0, 0] = modes[at, 0, 2, 1] = -4 * a
        modes[at, 1, 2, 2] = modes[at, 1, 1, 3] = -4 * b
    return nodal, modes


_NODAL, _MODES = _strains()
_ENERGIES = [
    np.einsum(sums, x, y).reshape(36, -1)
    for sums, x, y in (
        ("gpai,gqbj->pqabij", _NODAL, _NODAL),
        ("gpai,gqbj->pqabij", _NODAL, _MODES),
        ("gpai,gqbi->pqabi", _MODES, _MODES),
    )
]
"""What 1/width and 1/height, of either strain, and each elastic constant contribute, summed over the Gauss points."""


@in_full
def element(width: Array | float, height: Array, poisson: Array) -> Float[Array, "8 8"]:
    """Stiffness of a rectangle under plane stress, E = 1; corners anticlockwise from below left, (u_x, u_y) of each."""
    one, none = jnp.ones_like(poisson), jnp.zeros_like(poisson)
    elastic = jnp.stack(
        [jnp.stack([one, poisson, none]), jnp.stack([poisson, one, none]), jnp.stack([none, none, (1 - poisson) / 2])]
    ) / (1 - poisson**2)
    per = 1 / jnp.stack([width * one, height * one])
    each = (width * height / 4 * jnp.outer(per, per)[:, :, None, None] * elastic[None, None]).ravel()
    nodal, mixed, bubbles = (each @ energy for energy in _ENERGIES)
    # of a rectangle the incompatible modes do not act on each other: `bubbles` is their diagonal
    mixed = mixed.reshape(8, 4)
    return nodal.reshape(8, 8) - (mixed / bubbles[None]) @ mixed.T


# 32 bits whatever the precision: JAX takes both, but not within one process
LEFT, RIGHT = np.array([0, 1, 6, 7], np.int32), np.array([2, 3, 4, 5], np.int32)


def freedoms(block: Block, nodes: int) -> np.ndarray:
    """Numbers of the freedoms of a column among (u_x, u_y) of its nodes, without u_y at an interface or a top that holds it."""
    held = [1] * (block.normal_stiffness is None) + [2 * nodes - 1] * (block.top == "held")
    return np.delete(np.arange(2 * nodes, dtype=np.int32), held)


def along(block: Block, finer: int = 0) -> Along:
    """Which freedoms of a column are along the block."""
    return tuple(np.flatnonzero(freedoms(block, heights(block, finer).size) % 2 == 0).tolist())


def slabs(block: Block, finer: int = 0) -> tuple[Slab, Slab]:
    """Elements over one contact, on the normal stiffness of the interface, without the spring of the contact.

    Returns
    -------
    layers : Slab
        Those over contact 0, from the pusher on, along a leading axis.
    slab : Slab
        All over any other contact.
    """
    corner, other = widths(block, finer)
    every = jax.vmap(lambda width: _between_columns(block, heights(block, finer), width))(jnp.append(corner, other[0]))
    layers, slab = jax.tree.map(lambda x: x[:-1], every), jax.tree.map(lambda x: x[-1], every)
    for _ in range(HALVINGS + finer):
        slab = doubled(slab, along(block, finer))
    return layers, slab


def widths(block: Block, finer: int = 0) -> tuple[Float[Array, " m"], np.ndarray]:
    """Widths of the elements over contact 0, from the pusher on, and over any other, in λc."""
    count = 2**finer
    edge = _graded(jnp.zeros(()), jnp.ones(()), AT_PUSHER * jnp.asarray(block.height) / count, CORNER * count)
    return jnp.diff(edge), np.full(2**HALVINGS * count, 0.5**HALVINGS / count)


def _between_columns(block: Block, y: Float[Array, " nodes"], width: Array) -> Slab:
    """One element over each height."""
    poisson, young = block.plane_constants
    every = young * jax.vmap(lambda height: element(width, height, poisson))(jnp.diff(y))
    if block.normal_stiffness is not None:
        below = jnp.array([1, 3])  # u_y of the lower corners
        spring = jnp.asarray(block.normal_stiffness) * block.stiffness * width / 6 * jnp.array([[2.0, 1.0], [1.0, 2.0]])
        every = every.at[0, below[:, None], below].add(spring)
    keep = freedoms(block, y.size)
    same, above, below = (np.eye(y.size, k=by)[:, None, :, None] for by in (0, 1, -1))

    def assembled(rows: np.ndarray, cols: np.ndarray) -> Array:
        at = every[:, rows[:, None], cols].reshape(-1, 2, 2, 2, 2)  # lower or upper node, u_x or u_y, twice
        first, last = ((0, 1), (0, 0), (0, 0)), ((1, 0), (0, 0), (0, 0))
        own = jnp.pad(at[:, 0, :, 0], first) + jnp.pad(at[:, 1, :, 1], last)
        up, down = jnp.pad(at[:, 0, :, 1], first), jnp.pad(at[:, 1, :, 0], last)
        whole = own[:, :, None] * same + up[:, :, None] * above + down[:, :, None] * below
        return _kept(_kept(whole.reshape(2 * y.size, -1), keep).T, keep).T

    # the contact reads the mean of u_x along the lower edges, and its pressure that of u_y
    mean = width / 2 * jnp.eye(1 if block.friction is None else 2, keep.size, dtype=y.dtype)
    none = jnp.zeros((len(mean), len(mean)), y.dtype)
    return Slab(assembled(LEFT, LEFT), assembled(LEFT, RIGHT), assembled(RIGHT, RIGHT), mean, mean, none)


def _kept(rows: Float[Array, "m n"], keep: np.ndarray) -> Float[Array, "k n"]:
    """Some of the rows, in slices: picking them one by one takes longer than all the rest."""
    ends = np.flatnonzero(np.diff(keep) > 1) + 1
    return jnp.concatenate([rows[part[0] : part[-1] + 1] for part in np.split(keep, ends)])


def loaded(block: Block, finer: int = 0) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Push on column 0: 1 for the freedoms that the pusher displaces, and forces on the others, of a uniform traction."""
    y, push = heights(block, finer), block.push
    # by number, not by height: which nodes are pushed never changes
    number, below = np.arange(y.size) / 2**finer, 0 if push.height is None else BELOW + NEAR
    under = (number >= below) & (number <= (below + 2 * (OVER // 2) if push.width is not None else y.size))
    keep = freedoms(block, y.size)

    def along(x: Any) -> Array:
        return jnp.zeros(2 * y.size, y.dtype).at[0::2].set(jnp.asarray(x, y.dtype))[keep]

    none = along(0.0)
    if push.control == "displacement":
        return along(under), none
    part = jnp.diff(y) * (under[1:] & under[:-1]).astype(y.dtype)
    return none, along((jnp.pad(part, (0, 1)) + jnp.pad(part, (1, 0))) / (2 * part.sum()))
