"""Contacts in tables, and what moving their pinning points does to all stresses: by row operations only.

Sites are cut into the blocks of `slippulse_jax.lattice.response`; here a block is a column, so that what is done to all of them
is arithmetic on whole rows, which compiles well. All stresses are brought up to date at every break, in O(N).

A detached contact carries nothing. It is one whose pinning point follows the layer, so as a contact breaks, the pinning points
of all detached ones move such that no stress is left there.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.lattice.chain import Chain
from slippulse_jax.lattice.response import Response, into_blocks


class Contacts(NamedTuple):
    """What does not change, contact by contact: B blocks of M, a block a column; work on all contacts runs along rows."""

    threshold: Float[Array, "M B"]  # of a contact never broken; inf where there is none
    per_load: Float[Array, "M B"]  # stress per load
    read: Float[Array, "4 M B"]  # stress per displacement at the block's edges
    near: Float[Array, "B M M"]  # stress on the contacts of a block (last axis) per stress given up in it
    leave: Float[Array, "B M 4"]  # displacements at the block's edges per stress given up in it
    pass_on: Float[Array, "B 4 2 B"]  # what arrives at a block (last axis) of what leaves another
    gains: Float[Array, "B M 3"]  # per stress given up: force lost at the edge, slip, stress lost by the whole chain
    energy: Float[Array, "B M"]  # k²/2k_i
    edge_stiffness: Float[Array, ""]  # force on the edge per load


def check_delay(delay: object) -> None:
    """Refuse anything that is not a number of breaks."""
    if isinstance(delay, bool) or not isinstance(delay, int) or delay < 0:
        raise ValueError(f"repin_delay = {delay!r}: must be a whole number of breaks, 0 or more")


def fold(op: Callable[[Array, Array], Array], x: Float[Array, "M B"]) -> Float[Array, " B"]:
    """`op` over the first axis, M a power of two; in a form that compiles to arithmetic on whole rows."""
    while x.shape[0] > 1:
        half = x.shape[0] // 2
        x = op(x[:half], x[half:])
    return x[0]


def first_largest(x: Array) -> Array:
    """Index of the largest entry, the first of equals."""
    return jnp.argmax(x == x.max()).astype(jnp.int32)


def largest(x: Float[Array, "M B"]) -> tuple[Array, Array]:
    """Site and value of the largest entry; the first site of equals."""
    by_block = fold(jnp.maximum, x)
    block = first_largest(by_block)
    column = lax.dynamic_slice_in_dim(x, block, 1, 1)[:, 0]
    return block * x.shape[0] + first_largest(column), by_block.max()


def contacts_of(chain: Chain, resp: Response) -> Contacts:
    """Tables of a chain's contacts."""
    size = resp.near.shape[1]
    q, k = into_blocks(chain.contact, size), chain.stiffness
    threshold = into_blocks(jnp.where(chain.contact > 0, chain.threshold, jnp.inf), size, jnp.inf)
    per_load = (resp.at_load[:, :, None] * resp.read).sum(1)
    soft = k / jnp.where(q > 0, q, jnp.inf)
    # stress that a break adds to the other contacts: in its own block, and in those that what leaves it gets to
    felt = resp.pass_on * resp.read.sum(-1)[None, :, :, None]
    beyond = jnp.concatenate([felt[:, :, :2].sum((1, 2)), felt[:, :, 2:].sum((1, 2))], -1)
    lost = 1 - resp.near.sum(-1) - (resp.leave * beyond[:, None]).sum(-1)
    return Contacts(
        threshold=threshold.T,
        per_load=per_load.T,
        read=jnp.transpose(resp.read, (1, 2, 0)),
        near=resp.near,
        leave=resp.leave,
        pass_on=jnp.moveaxis(resp.pass_on, 1, -1),
        gains=jnp.stack([k * per_load * soft, soft, lost], -1),
        energy=soft * k / 2,
        edge_stiffness=resp.edge_stiffness,
    )


def at(x: Float[Array, "M B"], site: Array) -> Array:
    """Value at one site."""
    size = x.shape[0]
    return lax.dynamic_slice(x, (site % size, site // size), (1, 1))[0, 0]


def put(x: Float[Array, "M B"], site: Array, value: Array) -> Array:
    """With another value at one site."""
    size = x.shape[0]
    return lax.dynamic_update_slice(x, jnp.reshape(value, (1, 1)).astype(x.dtype), (site % size, site // size))


Move = tuple[Array, Array, Array]
"""Block and place of a contact whose pinning point moves, and the stress it gives up."""


def given_up(tables: Contacts, stress: Array, detached: Int[Array, " n"], site: Array, t: Array) -> list[Move]:
    """What moves as a contact breaks, that contact last."""
    size = stress.shape[0]
    if not detached.shape[0]:
        return [(site // size, site % size, t)]
    # the one that has been detached longest repins first, where it is
    moving = jnp.append(detached, site)[1:]
    there = moving >= 0
    b, m = jnp.maximum(moving, 0) // size, jnp.maximum(moving, 0) % size
    n = moving.shape[0]
    added = jnp.stack([_arriving(tables, b[j], m[j]) for j in range(n)])[:, :, b]  # source, edge value, target
    far = (added * tables.read[:, m, b][None]).sum(1)
    near = tables.near[b[:, None], m[:, None], m[None, :]]
    green = jnp.where(b[:, None] == b[None, :], near, far) * there[:, None] * there[None, :]
    x = jnp.linalg.solve(jnp.eye(n) - green.T, jnp.zeros(n, stress.dtype).at[-1].set(t))
    return [(b[j], m[j], x[j]) for j in range(n)]


def _arriving(tables: Contacts, b: Array, m: Array) -> Float[Array, "4 B"]:
    """Displacements at the edges of every block per stress given up at one contact."""
    left, to = tables.leave[b, m], tables.pass_on[b]
    return jnp.stack([to[k, 0] * left[2 * (k // 2)] + to[k, 1] * left[2 * (k // 2) + 1] for k in range(4)])


def _spread(tables: Contacts, stress: Array, moves: list[Move]) -> Array:
    """Stresses with what the moves add to blocks other than their own."""
    read = tables.read
    for b, m, x in moves:
        arrived = _arriving(tables, b, m) * x
        # written out: a sum over an axis would not be done a row at a time
        stress = stress + read[0] * arrived[:1] + read[1] * arrived[1:2] + read[2] * arrived[2:3] + read[3] * arrived[3:]
    return stress


def moved(tables: Contacts, stress: Array, pinning: Array, moves: list[Move]) -> tuple[Array, Array, Float[Array, "3"]]:
    """Stresses and pinning points after the moves, and the sum of what `Contacts.gains` says of them."""
    size = stress.shape[0]
    stress, lost = _spread(tables, stress, moves), jnp.zeros(3, stress.dtype)
    for b, m, x in moves:
        own = lax.dynamic_slice_in_dim(stress, b, 1, 1)[:, 0] + tables.near[b, m] * x
        own = own - jnp.where(jnp.arange(size) == m, x, 0)
        stress = lax.dynamic_update_slice_in_dim(stress, own[:, None], b, 1)
        site = b * size + m
        pinning = put(pinning, site, at(pinning, site) + x * tables.gains[b, m, 1])
        lost = lost + x * tables.gains[b, m]
    return stress, pinning, lost
