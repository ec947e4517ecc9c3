r"""Load transfer: the stress that one break adds to every other contact.

A contact that releases the stress t_j adds q_i G_ij t_j to the stress on contact i (q_i = k_i/K, G_ij the displacement of
the interfacial layer at i per force at j). Displacements are carried from site to site by 2×2 propagators with non-negative
entries, P_i to the right and Q_i to the left, so that beyond the source G_ij is a product of propagators: G is
block-semiseparable. The sites are divided into blocks of about √N:

* within the block of the source, G is stored as it is (`near`), computed when a contact of the block first breaks;
* any other block receives two displacements per edge, u_t and u, whatever happened in the source's block. The stress on one of
  its contacts is computed from these when it is needed (`read`).

A break thus costs O(√N), or O(N) where every stress is wanted, and the chain is never solved again. Nothing is subtracted.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.bodies.chain import (
    Chain,
    Pair,
    Springs,
    beside,
    carried_over,
    eliminate,
    held_from_left,
    solve_pair,
    through,
)
from slippulse_jax.bodies.modes import Modes
from slippulse_jax.bulk.compiler import in_full, lane_by_lane


class Response(NamedTuple):
    """What a push and a break do to every contact, in B blocks of M contacts.

    The last block is padded with sites without contact.
    """

    push: Float[Array, "B M"]  # stress per load
    soft: Float[Array, "B M"]  # k/k_i, how far a pinning point moves per stress released; 0 without a contact
    near: Float[Array, "B M M"]  # q_i G_ij within a block, source j first; of no block where `within` is left to be called
    read: Float[Array, "B 4 M"]  # stress at i per u_t, u at the block's left edge and per u_t, u at its right edge
    leave: Float[Array, "B M 4"]  # u_t, u at the edge of the next block, and of the block before, per stress released at j
    pass_on: Float[Array, "B B 4 2"]  # from block (first axis) to block: edge values per edge value of the neighbour
    reach: Float[Array, "B 4"]  # largest entries of `read` in each block
    spill: Float[Array, "B 4"]  # most that any contact of another block receives, per unit that leaves this block
    edge_stiffness: Float[Array, ""]  # force on the pusher per load, in K
    links: tuple[Array, Array, Array, Array] | None = None  # arguments of `within`, of all blocks
    # where thresholds follow the pressure, what a contact loses of it, over the initial one; of a single block
    relief: Float[Array, "B M M"] | None = None  # per stress released at j, source j first
    push_relief: Float[Array, "B M"] | None = None  # per load


class Propagators(NamedTuple):
    """Maps of the displacements (u_t, u) from site to site.

    Their shapes are (N, 2, 2) and (N, 2).
    """

    right: Array  # P_i: from site i to i + 1; zero for the last
    left: Array  # Q_i: from site i to i − 1; zero for the first
    source: Array  # displacements at site i per force on its interfacial layer
    follow: Array  # u[0] per u_t[0], shape ()
    edge_stiffness: Array  # force on u_t[0] per u_t[0], in K, shape ()


def block_size(sites: int) -> int:
    """Choose the number of sites per block.

    It is a power of two between √N and 2√N, at least 8: work inside a block is cheaper than work on all blocks.
    """
    size = 8
    while size * size < sites:
        size *= 2
    return size


def propagators(chain: Chain, beyond: Springs) -> Propagators:
    """Compute a chain's propagators, given its elimination from the right end."""
    site = beside(beyond, chain.across, chain.contact)

    def step(near: Springs, here: tuple) -> tuple[Springs, Springs]:
        bond, across, contact = here
        seen = through(bond, beside(near, across, contact))
        return seen, seen

    # u_t[0] is held: from site 1 the upper layer ends in a wall, the interfacial layer in site 0
    ground = chain.across[0] + chain.contact[0]
    share = chain.layer[0] / jnp.where(chain.layer[0] + ground > 0, chain.layer[0] + ground, jnp.inf)
    first = Springs(chain.upper[0], share * ground, jnp.zeros_like(ground))
    bonds = (chain.upper[1:], chain.layer[1:])
    _, rest = lax.scan(step, first, (bonds, chain.across[1:-1], chain.contact[1:-1]))
    none = Springs(*(jnp.zeros_like(ground),) * 3)
    behind = Springs(*(jnp.concatenate([n[None], f[None], r]) for n, f, r in zip(none, first, rest, strict=True)))

    def columns(held: Springs, bond: Pair) -> Array:
        return jnp.stack([jnp.stack(column, -1) for column in carried_over(held, bond)], -1)

    bond = (chain.upper, chain.layer)
    site_left = beside(behind, chain.across, chain.contact)
    before = Springs(site_left.upper[:-1] + bond[0], site_left.layer[:-1] + bond[1], site_left.across[:-1])
    P, Q = columns(held_from_left(chain, site), bond), columns(before, bond)
    held = jnp.zeros((2, 2), P.dtype).at[1, 1].set(share)
    whole = Springs(*(a + b for a, b in zip(behind, site, strict=True)))
    source = jnp.stack(solve_pair(whole, (jnp.zeros_like(ground), jnp.ones_like(ground))), -1)
    stiff = site.layer[0] + site.across[0]
    at_edge = jnp.zeros(2, P.dtype).at[1].set(1 / jnp.where(stiff > 0, stiff, jnp.inf))
    zero = jnp.zeros((1, 2, 2), P.dtype)
    follow = site.across[0] * at_edge[1]
    # u_t[0] − u[0] per load, from positive terms
    apart = (chain.contact[0] + beyond.layer[0]) * at_edge[1]
    return Propagators(
        right=jnp.concatenate([P, zero]),
        left=jnp.concatenate([zero, Q.at[0].set(held)]),
        source=source.at[0].set(at_edge),
        follow=follow,
        edge_stiffness=beyond.upper[0] + site.across[0] * apart,
    )


def into_blocks(x: Array, size: int, fill: float = 0.0) -> Array:
    """Cut (N, …) into blocks (B, M, …)."""
    missing = -x.shape[0] % size
    padding = jnp.full((missing, *x.shape[1:]), fill, x.dtype)
    return jnp.concatenate([x, padding]).reshape(-1, size, *x.shape[1:])


def response(chain: Chain, beyond: Springs, *, near: bool = True) -> Response:
    """Compute the response of a chain with linear contacts, given its elimination from the right end.

    It does not depend on thresholds and prestress. Without `near`, the response inside a block is left to `within`.
    """
    sites = propagators(chain, beyond)
    size = block_size(chain.sites)
    q = into_blocks(chain.contact, size)
    P, Q, source = (into_blocks(x, size) for x in sites[:3])
    read, leave, across = _through_blocks(P, source, reverse=False)
    read_left, leave_left, across_left = _through_blocks(Q, source, reverse=True)
    pass_on = jnp.concatenate([_between_blocks(across), _between_blocks(across_left[::-1])[::-1, ::-1]], 2)

    def load_step(here: Array, across_b: Array) -> tuple[Array, Array]:
        return (across_b * here[None]).sum(-1), here

    start = jnp.stack([jnp.ones_like(sites.follow), sites.follow]) / chain.stiffness
    _, at_load = lax.scan(load_step, start, across)
    push = (at_load[:, :, None] * read).sum(1) * q
    read = jnp.concatenate([read, read_left], 1) * q[:, None, :]
    reach = read.max(-1)
    felt = pass_on * reach[None, :, :, None]
    links = P, Q, source, q
    return Response(
        push=push,
        soft=chain.stiffness / jnp.where(q > 0, q, jnp.inf),
        near=jax.vmap(within)(*links) if near else jnp.zeros((0, size, size), q.dtype),
        read=read,
        leave=jnp.concatenate([leave, leave_left], -1),
        pass_on=pass_on,
        reach=reach,
        spill=jnp.concatenate([felt[:, :, :2].sum(2), felt[:, :, 2:].sum(2)], -1).max(1),
        edge_stiffness=sites.edge_stiffness,
        links=links,
    )


def shared_response(chain: Chain, *, near: bool = True) -> tuple[Springs, Response]:
    """Eliminate a chain and compute its response, once for lanes that share their springs.

    Such lanes differ in thresholds or prestress only.
    """

    def of_springs(springs: Chain) -> tuple[Springs, Response]:
        beyond = eliminate(springs, springs.contact)
        return beyond, response(springs, beyond, near=near)

    none = jnp.ones(chain.sites, chain.contact.dtype)
    return lane_by_lane(of_springs, eqx.tree_at(lambda c: (c.threshold, c.prestress), chain, (none, none)))


def _mul(a: Float[Array, "... x y"], b: Float[Array, "... y z"]) -> Array:
    """Multiply matrices with y = 2.

    The product is written out because it must not depend on how a batched dot is scheduled.
    """
    return a[..., :, :1] * b[..., :1, :] + a[..., :, 1:] * b[..., 1:, :]


def within(
    P: Float[Array, "M 2 2"], Q: Float[Array, "M 2 2"], source: Float[Array, "M 2"], contact: Float[Array, " M"]
) -> Float[Array, "M M"]:
    """Compute q_i G_ij inside one block, source first.

    The displacements due to all sources are carried through the block together, site by site, in each direction. What arrives
    at a site from every source is, by reciprocity, what every site receives from a source there.
    """
    sites = jnp.arange(contact.size, dtype=jnp.int32)

    def arriving(P: Array, *, reverse: bool) -> Array:
        def step(arriving: Pair, here: tuple) -> tuple[Pair, Array]:
            P, source, site = here
            upper, layer = (jnp.where(sites == site, source[edge], arriving[edge]) for edge in (0, 1))
            after = P[0, 0] * upper + P[0, 1] * layer, P[1, 0] * upper + P[1, 1] * layer
            return after, arriving[1] if reverse else layer  # the source itself counts once

        nothing = jnp.zeros_like(contact)
        return lax.scan(step, (nothing, nothing), (P, source, sites), reverse=reverse)[1]

    return (arriving(P, reverse=False) + arriving(Q, reverse=True)) * contact[None]


def _through_blocks(P: Float[Array, "B M 2 2"], v: Float[Array, "B M 2"], *, reverse: bool) -> tuple[Array, Array, Array]:
    """Compute `read`, `leave` and the propagator across each block, in one direction."""
    along, source = jnp.moveaxis(P, 0, -1), jnp.moveaxis(v, 0, -1)  # blocks last: arithmetic on rows
    unit = jnp.broadcast_to(jnp.eye(2, dtype=P.dtype)[..., None], along.shape[1:])

    def product(a: Array, b: Array) -> Array:
        return a[:, 0, None] * b[None, 0] + a[:, 1, None] * b[None, 1]

    across, read = lax.scan(lambda so_far, P: (product(P, so_far), so_far[1]), unit, along, reverse=reverse)

    def back(rest: Array, here: tuple) -> tuple[Array, Array]:
        rest = product(rest, here[0])
        return rest, rest[:, 0] * here[1][None, 0] + rest[:, 1] * here[1][None, 1]

    _, leave = lax.scan(back, unit, (along, source), reverse=not reverse)
    return jnp.moveaxis(read, -1, 0).swapaxes(1, 2), jnp.moveaxis(leave, -1, 0), jnp.moveaxis(across, -1, 0)


def _between_blocks(across: Float[Array, "B 2 2"]) -> Float[Array, "B B 2 2"]:
    """Propagate edge values from block to block.

    The result holds the edge values of every block per edge value of the block after the source's; axes: from, to.
    """
    blocks = across.shape[0]

    def step(so_far: Array, here: tuple) -> tuple[Array, Array]:
        across_b, b = here
        neighbour = (jnp.arange(blocks) == b)[:, None, None]
        return jnp.where(neighbour, jnp.eye(2, dtype=across.dtype)[None], _mul(across_b[None], so_far)), so_far

    _, reached = lax.scan(step, jnp.zeros_like(across), (across, jnp.arange(blocks)))
    return jnp.swapaxes(reached, 0, 1)


def of_matrix(transfer: Float[Array, "M M"], push: Float[Array, " M"], edge_stiffness: Any = 0.0) -> Response:
    """Response of equal contacts in a single block.

    From the stress that each contact adds to each per stress it releases, source first; the stress per load; and the force on
    the pusher per load, in K.
    """
    size, none = push.size, partial(jnp.zeros, dtype=transfer.dtype)
    return Response(
        push=push[None],
        soft=jnp.ones_like(push)[None],
        near=transfer[None],
        read=none((1, 4, size)),
        leave=none((1, size, 4)),
        pass_on=none((1, 1, 4, 2)),
        reach=none((1, 4)),
        spill=none((1, 4)),
        edge_stiffness=jnp.asarray(edge_stiffness, transfer.dtype),
    )


@in_full
def of_slider(modes: Modes, sites: int) -> Response:
    """Response of the first contacts of a semi-infinite slider, as a matrix: directly, and by way of the edge."""
    site = jnp.arange(sites, dtype=modes.gap.dtype)
    y, apart = jax.vmap(modes.profile)(site), jnp.abs(site[:, None] - site[None])
    direct = sum(modes.weight[m] * jnp.exp(apart * jnp.log1p(-modes.gap[m])) for m in (0, 1))
    return of_matrix(direct + y @ modes.reflection @ y.T, y @ modes.drive / modes.load)


@in_full
def dense(resp: Response) -> Float[Array, "S S"]:
    """Assemble q_i G_ij as a dense matrix, source first.

    For tests and inspection.
    """
    blocks, size = resp.near.shape[:2]
    arriving = jnp.einsum("abxy,ajxy->ajbx", resp.pass_on.reshape(blocks, blocks, 4, 2), _sent(resp.leave))
    far = jnp.einsum("ajbx,bxi->ajbi", arriving, resp.read)
    same = jnp.eye(blocks)[:, None, :, None]
    return (far + same * resp.near[:, :, None, :]).reshape(blocks * size, blocks * size)


def _sent(leave: Float[Array, "... 4"]) -> Float[Array, "... 4 2"]:
    """Pair what leaves a block with the rows of `pass_on`.

    The first two rows multiply what leaves to the right, the last two what leaves to the left.
    """
    right, left = leave[..., None, :2], leave[..., None, 2:]
    return jnp.concatenate([right, right, left, left], -2)


def carried(resp: Response, block: Array, left: Float[Array, "4"]) -> Float[Array, "B 4"]:
    """Displacements at every block's edges, (u_t, u) at the left and then at the right one, due to those leaving one block."""
    return (resp.pass_on[block] * _sent(left)[None]).sum(-1)
