"""Slabs of a block: graded columns of rectangular elements over one contact.

Elements are biquadratic: nine nodes each, of which those in the middle of a column are eliminated at once. Two of them lie side
by side over a contact, more over that at the edge; they are graded upwards from the interface and away from the pusher, whose
ends are nodes, so that everything is a smooth function of the heights. At an end of the pusher stress is singular: there the
nodes follow a power of the distance, with which a few elements do as well as many of a constant ratio. In λc and E = 1. A mesh
that is `finer` by n has 2ⁿ elements in the place of each, along and across.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.block import Block
from slippulse_jax.blocks.guide import Along, Slab, Springs, doubled, joined, placed

AT_INTERFACE = 0.25
"""Height of the elements at the interface, roughly, in λc."""
POWER = 3.5
"""Of the distance from an end of the pusher that its nodes follow."""
HALVINGS = 1
"""Number of elements side by side over a contact, as a power of 2."""
CORNER = 6
"""Number of elements side by side over contact 0, graded towards the pusher."""
BELOW, NEAR, OVER, ABOVE = 5, 6, 8, 12
"""Elements above the interface, below the pusher, over the pusher, and above it."""


def heights(block: Block, finer: int = 0) -> Float[Array, " nodes"]:
    """Heights of the nodes of a column, the pusher's ends included."""
    H, (low, high) = jnp.asarray(block.height), block.push.reach
    times = 2**finer

    def from_interface(end: Array, count: int) -> Array:
        """Edges by a hyperbolic sine, fine at the interface and ever coarser."""
        size = AT_INTERFACE / times
        scale = count * times * size / jnp.log1p(count * times)
        rate = jnp.arcsinh(end / scale)
        return end * jnp.sinh(rate * jnp.linspace(0, 1, count * times + 1)) / jnp.sinh(rate)

    def from_pusher(start: Array, end: Array, count: int) -> Array:
        return start + (end - start) * jnp.linspace(0, 1, count * times + 1) ** POWER

    if block.push.height is None:
        edges = from_interface(H, BELOW + NEAR + ABOVE)
    else:
        parts = [from_interface(low * H / 2, BELOW), from_pusher(low * H, low * H / 2, NEAR)[::-1]]
        if block.push.width is not None:
            centre = (low + high) * H / 2
            parts += [from_pusher(low * H, centre, OVER // 2), from_pusher(high * H, centre, OVER // 2)[::-1]]
        parts.append(from_pusher(high * H if block.push.width is not None else low * H, H, ABOVE))
        edges = jnp.concatenate([parts[0], *(part[1:] for part in parts[1:])])
    middles = (edges[1:] + edges[:-1]) / 2
    return jnp.append(jnp.stack([edges[:-1], middles], 1).ravel(), edges[-1])


def _integrals() -> tuple[np.ndarray, np.ndarray]:
    """Integrate over a biquadratic element of unit sides, and its lower edge.

    Of the strain energy; and of what is linear in u along that edge. Strains (ε_x, ε_y, 2 ε_xy) are a sum of those that go with
    1/width and with 1/height. Of the energies the axes are which of the two, twice, and which strain, twice, before (u_x, u_y)
    of nine nodes, row by row from below, twice.
    """
    at, weight = np.polynomial.legendre.leggauss(3)
    shape = np.array([at * (at - 1) / 2, 1 - at * at, at * (at + 1) / 2])
    slope = 2 * np.array([at - 0.5, -2 * at, at + 0.5])
    along, up = (np.einsum("ag,bh->ghab", *parts).reshape(9, 9) for parts in ((shape, slope), (slope, shape)))
    strains = np.zeros((9, 2, 3, 18))
    strains[:, 0, 0, 0::2] = strains[:, 0, 2, 1::2] = along
    strains[:, 1, 1, 1::2] = strains[:, 1, 2, 0::2] = up
    energies = np.einsum("g,gpai,gqbj->pqabij", np.outer(weight, weight).ravel() / 4, strains, strains)
    return energies.reshape(36, -1), np.einsum("g,ag,bg->ab", weight / 2, shape, shape)


_ENERGIES, _PRODUCTS = _integrals()
_MEANS = _PRODUCTS.sum(0)


def element(width: Array | float, height: Array, poisson: Array) -> Float[Array, "18 18"]:
    """Stiffness of a rectangle under plane stress, freedoms as in `_integrals`."""
    one, none = jnp.ones_like(poisson), jnp.zeros_like(poisson)
    elastic = jnp.stack(
        [jnp.stack([one, poisson, none]), jnp.stack([poisson, one, none]), jnp.stack([none, none, (1 - poisson) / 2])]
    ) / (1 - poisson**2)
    per = 1 / jnp.stack([width * one, height * one])
    each = (width * height * jnp.outer(per, per)[:, :, None, None] * elastic[None, None]).ravel()
    return (each @ _ENERGIES).reshape(18, 18)


def freedoms(block: Block, nodes: int) -> np.ndarray:
    """Numbers of a column's freedoms among (u_x, u_y), without any u_y held."""
    held = [1] * (block.normal_stiffness is None) + [2 * nodes - 1] * (block.top == "held")
    return np.delete(np.arange(2 * nodes, dtype=np.int32), held)


def along(block: Block, finer: int = 0) -> Along:
    """Which freedoms of a column are along the block."""
    return tuple(np.flatnonzero(freedoms(block, heights(block, finer).size) % 2 == 0).tolist())


def slabs(block: Block, finer: int = 0) -> tuple[Slab, Slab]:
    """Elements over one contact, without the springs of the interface.

    Those over contact 0, from the pusher on, along a leading axis; and all over any other contact.
    """
    corner, other = widths(finer)
    every = jax.vmap(lambda width: _column(block, heights(block, finer), width, along(block, finer)))(
        jnp.asarray(np.append(corner, other[0]), jnp.asarray(block.height).dtype)
    )
    layers, slab = jax.tree.map(lambda x: x[:-1], every), jax.tree.map(lambda x: x[-1], every)
    for _ in range(HALVINGS + finer):
        slab = doubled(slab, along(block, finer), _in_a_row(2, len(slab.own)))
    return placed(layers, _in_a_row(len(corner), layers.own.shape[-1])), slab


def _in_a_row(count: int, readings: int) -> Float[np.ndarray, "count s r"]:
    """Place the readings of each of several slabs among those of all.

    Of each they are the mean along the interface, which adds up, and perhaps nodes across it, the last the next slab's first.
    """
    every = np.zeros((count, 1 + (readings > 1) * (1 + count * (readings - 2)), readings))
    every[:, 0, 0] = 1
    for slab in range(count):
        node = np.arange(slab > 0, readings - 1)
        every[slab, 1 + slab * (readings - 2) + node, 1 + node] = 1
    return every


def springs(block: Block, finer: int = 0) -> tuple[Springs, Springs]:
    """Springs of the interface beneath contact 0, and beneath any other."""
    corner, other = widths(finer)
    return _springs(block, corner), _springs(block, other)


def _springs(block: Block, width: Float[np.ndarray, " m"]) -> Springs:
    softness = 1 / jnp.asarray(block.stiffness).reshape(1, 1)
    if block.normal_stiffness is None:
        return softness, jnp.ones_like(softness)
    nodes = np.stack([np.eye(2 * len(width) + 1)[:, at : at + 3] for at in range(0, 2 * len(width), 2)])
    per_stiffness = np.linalg.inv(np.einsum("can,nm,cbm,c->ab", nodes, _PRODUCTS, nodes, width))
    means = np.einsum("can,n,c->a", nodes, _MEANS, width)
    readings = 1 if block.friction is None else 2
    read = np.zeros((readings, 1 + len(means)))
    read[0, 0], read[1:, 1:] = 1, means
    across = softness / jnp.asarray(block.normal_stiffness) * per_stiffness
    return jnp.pad(across, ((1, 0), (1, 0))).at[0, 0].set(softness[0, 0]), jnp.asarray(read, across.dtype)


def widths(finer: int = 0) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " n"]]:
    """Widths of elements over contact 0, from the pusher, and over others."""
    count = 2**finer
    return np.diff(np.linspace(0, 1, CORNER * count + 1) ** POWER), np.full(2**HALVINGS * count, 0.5**HALVINGS / count)


def _column(block: Block, y: Float[Array, " nodes"], width: Array, along: Along) -> Slab:
    """One element over each height, without the nodes in their middle."""
    poisson, young = block.plane_constants
    every = young * jax.vmap(lambda height: element(width, height, poisson))(jnp.diff(y[::2]))
    keep, count = freedoms(block, y.size), y.size // 2
    # of each element row, column, u_x or u_y, twice; three rows are two of its own and the first of the next one's two
    every = jnp.pad(every.reshape(-1, 3, 3, 2, 3, 3, 2), ((0, 0), (0, 1), (0, 0), (0, 0), (0, 1), (0, 0), (0, 0)))
    every = every.reshape(-1, 2, 2, 3, 2, 2, 2, 3, 2)
    same, above, below = (np.eye(count + 1, k=by)[:, None, :, None] for by in (0, 1, -1))

    def assembled(first: int, second: int) -> Array:
        at = every[:, :, :, first, :, :, :, second].reshape(-1, 2, 4, 2, 4)
        last, next_to = ((0, 1), (0, 0), (0, 0)), ((1, 0), (0, 0), (0, 0))
        own = jnp.pad(at[:, 0, :, 0], last) + jnp.pad(at[:, 1, :, 1], next_to)
        up, down = jnp.pad(at[:, 0, :, 1], last), jnp.pad(at[:, 1, :, 0], next_to)
        whole = own[:, :, None] * same + up[:, :, None] * above + down[:, :, None] * below
        return _kept(_kept(whole.reshape(4 * count + 4, -1), keep).T, keep).T

    # the contact reads the mean of u_x along the lower edges, springs across it read u_y of their nodes
    readings = 1 if block.normal_stiffness is None else 4

    def reading(node: int) -> Float[Array, "r n"]:
        row = jnp.zeros((readings, keep.size), y.dtype).at[0, 0].set(_MEANS[node] * width)
        return row if readings == 1 else row.at[1 + node, 1].set(1)

    own = jnp.zeros((readings, readings), y.dtype)
    sides = Slab(assembled(0, 0), assembled(0, 2), assembled(2, 2), reading(0), reading(2), own)
    return joined(sides, assembled(0, 1), assembled(1, 1), reading(1), along)


def _kept(rows: Float[Array, "m n"], keep: np.ndarray) -> Float[Array, "k n"]:
    """Some rows, by slices: picking each takes longer than all the rest."""
    ends = np.flatnonzero(np.diff(keep) > 1) + 1
    return jnp.concatenate([rows[part[0] : part[-1] + 1] for part in np.split(keep, ends)])


def loaded(block: Block, finer: int = 0) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Ones for displaced freedoms of column 0; forces of a uniform traction."""
    y, push = heights(block, finer), block.push
    # by number, not by height: which nodes are pushed never changes
    number, below = np.arange(y.size) / 2 / 2**finer, 0 if push.height is None else BELOW + NEAR
    under = (number >= below) & (number <= (below + 2 * (OVER // 2) if push.width is not None else y.size))
    keep = freedoms(block, y.size)

    def along(x: Any) -> Array:
        return jnp.zeros(2 * y.size, y.dtype).at[0::2].set(jnp.asarray(x, y.dtype))[keep]

    none = along(0.0)
    if push.control == "displacement":
        return along(under), none
    part = jnp.diff(y[::2]) * (under[2::2] & under[:-2:2]).astype(y.dtype)
    first, middle, last = (jnp.zeros_like(y).at[at : at + 2 * part.size : 2].add(mean * part) for at, mean in enumerate(_MEANS))
    return none, along((first + middle + last) / part.sum())
