r"""Load transfer: the stress that one break adds to every other contact.

A contact that gives up the stress t_j adds q_i G_ij t_j to the stress on contact i (q_i = k_i/K, G_ij the displacement of
the interfacial layer at i per force at j). Displacements travel from site to site by 2×2 propagators with non-negative
entries, to the right by P_i and to the left by Q_i, so that beyond the source G_ij is a product of propagators: G is
block-semiseparable. The sites are cut into blocks of about √N:

* within the block of the source G is held as it is (`near`);
* elsewhere a block receives two displacements per edge, u_t and u, whatever happened in the source's block, and a contact's
  stress is read off when it is needed (`read`).

So a break costs O(√N), or O(N) where every stress is wanted, without ever solving the chain anew. Nothing is subtracted.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from slippulse_jax.bulk.independence import lane_by_lane
from slippulse_jax.lattice.chain import Chain, Pair, Springs, beside, eliminate, solve_pair, through


class Response(NamedTuple):
    """Response of B blocks of M sites, the last padded with sites without contact."""

    near: Float[Array, "B M M"]  # q_i G_ij within a block; the middle axis is the source j
    read: Float[Array, "B 4 M"]  # stress at i per u_t, u at the block's left edge and per u_t, u at its right edge
    leave: Float[Array, "B M 4"]  # u_t, u at the edge of the next block, and of the block before, per stress given up at j
    pass_on: Float[Array, "B B 4 2"]  # from block (first axis) to block: the edge values, per edge value of the neighbour
    reach: Float[Array, "B 4"]  # largest of `read` in each block
    spill: Float[Array, "B 4"]  # the most any contact of another block receives, per unit of what leaves this one
    at_load: Float[Array, "B 4"]  # what a block receives per load: k⁻¹ (u_t, u) at its left edge, nothing at its right edge
    edge_stiffness: Float[Array, ""]  # force on the left edge per load, in K
    floating: Bool[Array, ""]  # whether a part of the chain is held by nothing


class Propagators(NamedTuple):
    """Maps of the displacements (u_t, u) from site to site; shapes (N, 2, 2) and (N, 2)."""

    right: Array  # P_i: from site i to i + 1; zero for the last
    left: Array  # Q_i: from site i to i − 1; zero for the first
    source: Array  # displacements at site i per force on its interfacial layer
    follow: Array  # u[0] per u_t[0], shape ()
    edge_stiffness: Array  # force on u_t[0] per u_t[0], in K, shape ()
    floating: Array  # whether a part of the chain is held by nothing


def block_size(sites: int) -> int:
    """Number of sites per block: a power of two between √N and 2√N, at least 8.

    Work inside a block is cheaper than work on all blocks.
    """
    size = 8
    while size * size < sites:
        size *= 2
    return size


def propagators(chain: Chain) -> Propagators:
    """Propagators of a chain, from one elimination per end."""
    right = eliminate(chain, chain.contact)
    site = beside(right.beyond, chain.across, chain.contact)

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
        """2×2 matrix: response to unit displacements at the far side of a bond."""
        zero = jnp.zeros_like(bond[0])
        by_upper, by_layer = solve_pair(held, (bond[0], zero)), solve_pair(held, (zero, bond[1]))
        return jnp.stack([jnp.stack([by_upper[0], by_layer[0]], -1), jnp.stack([by_upper[1], by_layer[1]], -1)], -2)

    bond = (chain.upper, chain.layer)
    after = Springs(site.upper[1:] + bond[0], site.layer[1:] + bond[1], site.across[1:])
    site_left = beside(behind, chain.across, chain.contact)
    before = Springs(site_left.upper[:-1] + bond[0], site_left.layer[:-1] + bond[1], site_left.across[:-1])
    P, Q = columns(after, bond), columns(before, bond)
    held = jnp.zeros((2, 2), P.dtype).at[1, 1].set(share)
    whole = Springs(*(a + b for a, b in zip(behind, site, strict=True)))
    source = jnp.stack(solve_pair(whole, (jnp.zeros_like(ground), jnp.ones_like(ground))), -1)
    stiff = site.layer[0] + site.across[0]
    at_edge = jnp.zeros(2, P.dtype).at[1].set(1 / jnp.where(stiff > 0, stiff, jnp.inf))
    zero = jnp.zeros((1, 2, 2), P.dtype)
    follow = site.across[0] * at_edge[1]
    # u_t[0] − u[0] per load, from positive terms
    apart = (chain.contact[0] + right.beyond.layer[0]) * at_edge[1]
    return Propagators(
        right=jnp.concatenate([P, zero]),
        left=jnp.concatenate([zero, Q.at[0].set(held)]),
        source=source.at[0].set(at_edge),
        follow=follow,
        edge_stiffness=right.beyond.upper[0] + site.across[0] * apart,
        floating=right.floating,
    )


def into_blocks(x: Array, size: int, fill: float = 0.0) -> Array:
    """Cut (N, …) into blocks (B, M, …)."""
    missing = -x.shape[0] % size
    padding = jnp.full((missing, *x.shape[1:]), fill, x.dtype)
    return jnp.concatenate([x, padding]).reshape(-1, size, *x.shape[1:])


def response(chain: Chain) -> Response:
    """Response of a chain with linear contacts, whatever its thresholds and prestress."""
    links = propagators(chain)
    size = block_size(chain.sites)
    P, Q, v = (into_blocks(x, size) for x in links[:3])
    q = into_blocks(chain.contact, size)
    blocks = q.shape[0]
    # what goes to the left is what goes to the right, seen in a mirror
    both = _one_way(jnp.concatenate([P, Q[::-1, ::-1]]), jnp.concatenate([v, v[::-1, ::-1]]))
    near, read, leave, across = (x[:blocks] for x in both)
    near_left, read_left, leave_left, across_left = (x[blocks:][::-1] for x in both)
    near = near + jnp.where(jnp.eye(size, dtype=bool)[None], 0, near_left[:, ::-1, ::-1])
    read = jnp.concatenate([read, read_left[:, :, ::-1]], 1) * q[:, None, :]
    pass_on = jnp.concatenate([_between_blocks(across), _between_blocks(across_left[::-1])[::-1, ::-1]], 2)
    reach = read.max(-1)

    def load_step(here: Array, across_b: Array) -> tuple[Array, Array]:
        return (across_b * here[None]).sum(-1), here

    start = jnp.stack([jnp.ones_like(links.follow), links.follow]) / chain.stiffness
    _, at_load = lax.scan(load_step, start, across)
    felt = pass_on * reach[None, :, :, None]
    return Response(
        near=near * q[:, None, :],
        read=read,
        leave=jnp.concatenate([leave, leave_left[:, ::-1]], -1),
        pass_on=pass_on,
        reach=reach,
        spill=jnp.concatenate([felt[:, :, :2].sum(2), felt[:, :, 2:].sum(2)], -1).max(1),
        at_load=jnp.concatenate([at_load, jnp.zeros_like(at_load)], -1),
        edge_stiffness=links.edge_stiffness,
        floating=links.floating,
    )


def shared_response(chain: Chain) -> Response:
    """`response`, computed once for lanes that differ in thresholds or prestress only."""
    none = jnp.ones(chain.sites, chain.contact.dtype)
    springs = eqx.tree_at(lambda c: (c.threshold, c.prestress), chain, (none, none))
    return lane_by_lane(response, springs)


def _mul(a: Float[Array, "... x y"], b: Float[Array, "... y z"]) -> Array:
    """Matrix product with y = 2, written out: it must not depend on how a batched dot is scheduled."""
    return a[..., :, :1] * b[..., :1, :] + a[..., :, 1:] * b[..., 1:, :]


def _one_way(P: Float[Array, "B M 2 2"], v: Float[Array, "B M 2"]) -> tuple[Array, Array, Array, Array]:
    """`near`, `read` and `leave` for what lies to the right of a source, and the propagator across each block.

    Pieces of a block are joined two by two, from single sites to the whole: what crosses the joint is a product.
    """
    near, across = v[:, :, None, 1:], P
    read = jnp.broadcast_to(jnp.array([[0.0], [1.0]], P.dtype), (*P.shape[:2], 2, 1))
    leave = _mul(P, v[..., None])[:, :, None, :, 0]
    while near.shape[1] > 1:
        (near_a, near_b), (read_a, read_b), (leave_a, leave_b), (across_a, across_b) = (
            (x[:, 0::2], x[:, 1::2]) for x in (near, read, leave, across)
        )
        joint = _mul(leave_a, read_b)
        near = jnp.concatenate([jnp.concatenate([near_a, joint], -1), jnp.concatenate([jnp.zeros_like(joint), near_b], -1)], -2)
        read = jnp.concatenate([read_a, _mul(jnp.swapaxes(across_a, -1, -2), read_b)], -1)
        leave = jnp.concatenate([_mul(leave_a, jnp.swapaxes(across_b, -1, -2)), leave_b], -2)
        across = _mul(across_b, across_a)
    return near[:, 0], read[:, 0], leave[:, 0], across[:, 0]


def _between_blocks(across: Float[Array, "B 2 2"]) -> Float[Array, "B B 2 2"]:
    """Edge values of every block per edge value of the block after the source's; axes: from, to."""
    blocks = across.shape[0]

    def step(so_far: Array, here: tuple) -> tuple[Array, Array]:
        across_b, b = here
        neighbour = (jnp.arange(blocks) == b)[:, None, None]
        return jnp.where(neighbour, jnp.eye(2, dtype=across.dtype)[None], _mul(across_b[None], so_far)), so_far

    _, reached = lax.scan(step, jnp.zeros_like(across), (across, jnp.arange(blocks)))
    return jnp.swapaxes(reached, 0, 1)


def dense(resp: Response) -> Float[Array, "S S"]:
    """q_i G_ij as a dense matrix, source first; for tests and inspection."""
    blocks, size = resp.near.shape[:2]
    arriving = jnp.einsum("abxy,ajxy->ajbx", resp.pass_on.reshape(blocks, blocks, 4, 2), _sent(resp.leave))
    far = jnp.einsum("ajbx,bxi->ajbi", arriving, resp.read)
    same = jnp.eye(blocks)[:, None, :, None]
    return (far + same * resp.near[:, :, None, :]).reshape(blocks * size, blocks * size)


def _sent(leave: Float[Array, "... 4"]) -> Float[Array, "... 4 2"]:
    """Pairs each row of `pass_on` multiplies: what leaves to the right for the first two, to the left for the last two."""
    right, left = leave[..., None, :2], leave[..., None, 2:]
    return jnp.concatenate([right, right, left, left], -2)


def arriving(resp: Response, block: Array, site: Array) -> Float[Array, "B 4"]:
    """(u_t, u) at the left and right edges of every block, per stress released at one site."""
    return carried(resp, block, resp.leave[block, site])


def carried(resp: Response, block: Array, left: Float[Array, "4"]) -> Float[Array, "B 4"]:
    """Displacements at the edges of every block due to those that left one of them."""
    return (resp.pass_on[block] * _sent(left)[None]).sum(-1)
