r"""Load transfer: the stress that one break adds to every other contact.

A contact that releases the stress t_j adds q_i G_ij t_j to the stress on contact i (q_i = k_i/K, G_ij the displacement of
the interfacial layer at i per force at j). Displacements are carried from site to site by 2×2 propagators with non-negative
entries, P_i to the right and Q_i to the left, so that beyond the source G_ij is a product of propagators: G is
block-semiseparable. The sites are divided into blocks of about √N:

* within the block of the source, G is stored as it is (`near`);
* any other block receives two displacements per edge, u_t and u, whatever happened in the source's block. The stress on one of
  its contacts is computed from these when it is needed (`read`).

A break thus costs O(√N), or O(N) where every stress is wanted, and the chain is never solved again. Nothing is subtracted.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from slippulse_jax.bulk.independence import lane_by_lane
from slippulse_jax.lattice.chain import Chain, Pair, Springs, beside, eliminate, solve_pair, through


class Response(NamedTuple):
    """Response of B blocks of M sites.

    The last block is padded with sites without contact.
    """

    near: Float[Array, "B M M"]  # q_i G_ij within a block; the middle axis is the source j
    read: Float[Array, "B 4 M"]  # stress at i per u_t, u at the block's left edge and per u_t, u at its right edge
    leave: Float[Array, "B M 4"]  # u_t, u at the edge of the next block, and of the block before, per stress released at j
    pass_on: Float[Array, "B B 4 2"]  # from block (first axis) to block: edge values per edge value of the neighbour
    reach: Float[Array, "B 4"]  # largest entries of `read` in each block
    spill: Float[Array, "B 4"]  # most that any contact of another block receives, per unit that leaves this block
    at_load: Float[Array, "B 4"]  # received by a block per load: k⁻¹ (u_t, u) at its left edge, nothing at its right edge
    edge_stiffness: Float[Array, ""]  # force on the left edge per load, in K
    floating: Bool[Array, ""]  # whether a part of the chain is unattached


class Propagators(NamedTuple):
    """Maps of the displacements (u_t, u) from site to site.

    Their shapes are (N, 2, 2) and (N, 2).
    """

    right: Array  # P_i: from site i to i + 1; zero for the last
    left: Array  # Q_i: from site i to i − 1; zero for the first
    source: Array  # displacements at site i per force on its interfacial layer
    follow: Array  # u[0] per u_t[0], shape ()
    edge_stiffness: Array  # force on u_t[0] per u_t[0], in K, shape ()
    floating: Array  # whether a part of the chain is unattached


def block_size(sites: int) -> int:
    """Choose the number of sites per block.

    It is a power of two between √N and 2√N, at least 8: work inside a block is cheaper than work on all blocks.
    """
    size = 8
    while size * size < sites:
        size *= 2
    return size


def propagators(chain: Chain) -> Propagators:
    """Compute a chain's propagators from one elimination per end."""
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
        """Response to unit displacements beyond a bond, a 2×2 matrix."""
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
    """Compute the response of a chain with linear contacts.

    It does not depend on thresholds and prestress.
    """
    links = propagators(chain)
    size = block_size(chain.sites)
    P, Q, v = (into_blocks(x, size) for x in links[:3])
    q = into_blocks(chain.contact, size)
    blocks = q.shape[0]
    # propagation to the left is the mirror image of propagation to the right
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
    """Compute `response` once for lanes that share their springs.

    Such lanes differ in thresholds or prestress only.
    """
    none = jnp.ones(chain.sites, chain.contact.dtype)
    springs = eqx.tree_at(lambda c: (c.threshold, c.prestress), chain, (none, none))
    return lane_by_lane(response, springs)


def _mul(a: Float[Array, "... x y"], b: Float[Array, "... y z"]) -> Array:
    """Multiply matrices with y = 2.

    The product is written out because it must not depend on how a batched dot is scheduled.
    """
    return a[..., :, :1] * b[..., :1, :] + a[..., :, 1:] * b[..., 1:, :]


def _one_way(P: Float[Array, "B M 2 2"], v: Float[Array, "B M 2"]) -> tuple[Array, Array, Array, Array]:
    """Compute `near`, `read` and `leave` to the right of a source.

    The fourth result is the propagator across each block. Pieces of a block are joined in pairs, from single sites to the
    whole block; terms that cross a joint are products.
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


def arriving(resp: Response, block: Array, site: Array) -> Float[Array, "B 4"]:
    """Displacements at every block's edges per stress released at one site.

    They are (u_t, u) at the left edge, then at the right edge.
    """
    return carried(resp, block, resp.leave[block, site])


def carried(resp: Response, block: Array, left: Float[Array, "4"]) -> Float[Array, "B 4"]:
    """Displacements at every block's edges due to those leaving one block."""
    return (resp.pass_on[block] * _sent(left)[None]).sum(-1)
