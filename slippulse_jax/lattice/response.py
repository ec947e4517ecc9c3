r"""What one break does to the stress on every other contact, ready to be applied in a few operations.

A contact that gives up the stress t_j adds q_i G_ij t_j to the stress on contact i (q_i = k_i/K, G_ij the displacement of
the interfacial layer at i per force at j). Displacements travel from site to site by 2×2 propagators with non-negative
entries, to the right by P_i and to the left by Q_i, so that beyond the source G_ij is a product of propagators: G is
block-semiseparable. The sites are cut into blocks of about √N:

* within the block of the source G is held as it is (`near`);
* elsewhere a block receives two numbers from the left and two from the right, u_t and u at its edge (`Inbox`), whatever
  happened in the source's block, and a contact's stress is read off when it is needed (`read`).

So a break costs O(√N), or O(N) where every stress is wanted, without ever solving the chain anew. Nothing is subtracted.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.lattice.chain import Chain, Springs
from slippulse_jax.lattice.elimination import Pair, beside, eliminate, solve_pair, through


class Response(NamedTuple):
    """B blocks of M sites (the last filled up with sites that have no contact and hold nothing)."""

    near: Float[Array, "B M M"]  # q_i G_ij within a block; the middle axis is the source j
    read: Float[Array, "B 4 M"]  # stress at i per u_t, u at the block's left edge and per u_t, u at its right edge
    leave: Float[Array, "B M 4"]  # u_t, u at the edge of the next block, and of the block before, per stress given up at j
    pass_on: Float[Array, "B B 4 2"]  # from block (first axis) to block: the edge values, per edge value of the neighbour
    reach: Float[Array, "B 4"]  # largest of `read` in each block


class Propagators(NamedTuple):
    """How the displacements (u_t, u) at one site follow from those next to it; shapes (N, 2, 2) and (N, 2)."""

    right: Array  # P_i: from site i to i + 1; zero for the last
    left: Array  # Q_i: from site i to i − 1; zero for the first
    source: Array  # displacements at site i per force on its interfacial layer


def block_size(sites: int) -> int:
    """Power of two near √N, at least 8."""
    size = 8
    while 2 * size * size <= sites:
        size *= 2
    return size


def propagators(chain: Chain) -> Propagators:
    """One elimination from each end."""
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
    return Propagators(jnp.concatenate([P, zero]), jnp.concatenate([zero, Q.at[0].set(held)]), source.at[0].set(at_edge))


def into_blocks(x: Array, size: int, fill: float = 0.0) -> Array:
    """(N, …) as (B, M, …)."""
    missing = -x.shape[0] % size
    padding = jnp.full((missing, *x.shape[1:]), fill, x.dtype)
    return jnp.concatenate([x, padding]).reshape(-1, size, *x.shape[1:])


def response(chain: Chain) -> Response:
    """The response of a chain with linear contacts."""
    links = propagators(chain)
    size = block_size(chain.sites)
    P, Q, v = (into_blocks(x, size) for x in links)
    q = into_blocks(chain.contact, size)
    toward_right = _one_way(P, v)
    # the same, seen in a mirror
    mirrored = _one_way(Q[::-1, ::-1], v[::-1, ::-1])
    near, read, leave, pass_on = toward_right
    near_left, read_left, leave_left, pass_on_left = (
        mirrored[0][::-1, ::-1, ::-1],
        mirrored[1][::-1, :, ::-1],
        mirrored[2][::-1, ::-1],
        mirrored[3][::-1, ::-1],
    )
    read = jnp.concatenate([read, read_left], 1) * q[:, None, :]
    both = near + jnp.where(jnp.eye(size, dtype=bool)[None], 0, near_left)
    return Response(
        near=both * q[:, None, :],
        read=read,
        leave=jnp.concatenate([leave, leave_left], -1),
        pass_on=jnp.concatenate([pass_on, pass_on_left], 2),
        reach=read.max(-1),
    )


def _one_way(P: Float[Array, "B M 2 2"], v: Float[Array, "B M 2"]) -> tuple[Array, Array, Array, Array]:
    """`near`, `read`, `leave`, `pass_on` for what lies to the right of a source."""
    blocks, size = P.shape[:2]
    one = jnp.broadcast_to(jnp.eye(2, dtype=P.dtype), (blocks, 2, 2))
    by_site = jnp.moveaxis(P, 1, 0)

    def mul(a: Array, b: Array) -> Array:
        # written out: a product of 2×2 matrices must not depend on how a batched dot is scheduled
        return (a[..., :, None, :] * jnp.swapaxes(b, -1, -2)[..., None, :, :]).sum(-1)

    def read_step(so_far: Array, P_i: Array) -> tuple[Array, Array]:
        return mul(P_i, so_far), so_far[:, 1]

    across, read = lax.scan(read_step, one, by_site)

    def leave_step(so_far: Array, here: tuple) -> tuple[Array, Array]:
        P_i, v_i = here
        so_far = mul(so_far, P_i)
        return so_far, (so_far * v_i[:, None, :]).sum(-1)

    _, leave = lax.scan(leave_step, one, (by_site, jnp.moveaxis(v, 1, 0)), reverse=True)

    def near_step(so_far: Array, here: tuple) -> tuple[Array, Array]:
        P_i, v_i, i = here
        so_far = jnp.where((jnp.arange(size) == i)[None, :, None], v_i[:, None, :], so_far)
        return (P_i[:, None] * so_far[:, :, None, :]).sum(-1), so_far[..., 1]

    sites = jnp.arange(size)
    start = jnp.zeros((blocks, size, 2), P.dtype)
    _, near = lax.scan(near_step, start, (by_site, jnp.moveaxis(v, 1, 0), sites))

    def pass_step(so_far: Array, here: tuple) -> tuple[Array, Array]:
        across_b, b = here
        after = mul(jnp.broadcast_to(across_b, so_far.shape), so_far)
        neighbour = (jnp.arange(blocks) == b)[:, None, None]
        return jnp.where(neighbour, jnp.eye(2, dtype=P.dtype)[None], after), so_far

    nothing = jnp.zeros((blocks, 2, 2), P.dtype)
    _, pass_on = lax.scan(pass_step, nothing, (across, jnp.arange(blocks)))
    # axes: near (i, b, j) → (b, j, i); read (i, b, 2) → (b, 2, i); leave (j, b, 2) → (b, j, 2); pass_on (to, from) → (from, to)
    return (
        jnp.transpose(near, (1, 2, 0)),
        jnp.transpose(read, (1, 2, 0)),
        jnp.moveaxis(leave, 0, 1),
        jnp.swapaxes(pass_on, 0, 1),
    )


def dense(resp: Response) -> Float[Array, "S S"]:
    """q_i G_ij of all sites, source first: for tests and for looking at."""
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
    """What every block receives per stress given up at one site: (u_t, u) at its left edge, and at its right edge."""
    return (resp.pass_on[block] * _sent(resp.leave[block, site])[None]).sum(-1)
