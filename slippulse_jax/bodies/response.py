r"""Load transfer: what one break adds to the readings of every contact.

A contact that releases the stress t_j adds q_i G_ij t_j to the stress on contact i (q_i = k_i/K, G_ij the displacement of
the interfacial layer at i per force at j). Displacements are carried from site to site by 2×2 propagators with non-negative
entries, P_i to the right and Q_i to the left, so that beyond the source G_ij is a product of propagators: G is
block-semiseparable. The sites are divided into blocks of M:

* within the block of the source, G is stored as it is (`near`), in N M numbers;
* any other block receives two displacements per edge, u_t and u, whatever happened in the source's block, from which the
  stress on its contacts is read (`read`).

The chain is never solved again, and nothing is subtracted. A body whose response is a matrix is a single block.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

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


class Far(NamedTuple):
    """What the contacts of B blocks of M do to each other."""

    read: Float[Array, "B 4 M"]  # stress at i per u_t, u at the block's left edge and per u_t, u at its right edge
    leave: Float[Array, "B M 4"]  # u_t, u at the edge of the next block, and of the block before, per stress released at j
    pass_on: Float[Array, "B B 4 2"]  # from block (first axis) to block: edge values per edge value of the neighbour


class Response(NamedTuple):
    """What a push and a break do to the readings of N contacts: the stress and, where anything follows it, the pressure.

    The pressure is that over the initial one.
    """

    push: Float[Array, "r N"]  # per load
    soft: Float[Array, " N"]  # k/k_i, how far a pinning point moves per stress released; 0 without a contact
    near: Float[Array, "B M r M"]  # within a block, per stress released, source first; the last block may be padded
    edge_stiffness: Float[Array, ""]  # force on the pusher per load, in K
    far: Far | None = None  # between several blocks

    def through(self, spring: Any, stiffness: Any) -> "Response":
        """Response of a matrix body of contacts of this stiffness k whose pusher is pulled through a spring, both in K.

        The load is then that of the far end of the spring.
        """
        spring, push = jnp.asarray(spring), self.push
        whole = spring + self.edge_stiffness
        near = self.near + (stiffness / whole * push[0][:, None, None] * push[None])[None]  # a break lets the pusher move
        return self._replace(near=near, push=push * spring / whole, edge_stiffness=self.edge_stiffness * spring / whole)

    def column(self, site: Int[Array, ""]) -> Float[Array, "r N"]:
        """Readings of every contact per stress released at one, its own pinning point apart."""
        size, count = self.near.shape[1], self.soft.size
        if self.far is None:
            return self.near[0, site]
        block, place = site // size, site % size
        right, left = jnp.split(self.far.leave[block, place], 2)
        sent = jnp.stack([right, right, left, left])
        arriving = (self.far.pass_on[block] * sent[None]).sum(-1)
        own = (jnp.arange(len(arriving)) == block)[:, None]
        found = jnp.where(own, self.near[block, place], 0)
        for edge in range(4):  # written out: arithmetic on rows
            found = found + arriving[:, edge, None] * self.far.read[:, edge]
        return found.reshape(1, -1)[:, :count]


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
    """Choose the number of sites per block: 32, or the power of two from √N/2 on; all of fewer."""
    size = 32
    while 4 * size * size < sites:
        size *= 2
    return min(size, sites)


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


def of_chain(chain: Chain, beyond: Springs) -> Response:
    """Compute the response of a chain with linear contacts, given its elimination from the right end.

    It does not depend on thresholds and prestress.
    """
    sites = propagators(chain, beyond)
    size = block_size(chain.sites)
    q = into_blocks(chain.contact, size)
    P, Q, source = (into_blocks(x, size) for x in sites[:3])
    read, leave, across = _through_blocks(P, source, reverse=False)
    read_left, leave_left, across_left = _through_blocks(Q, source, reverse=True)

    def load_step(here: Array, across_b: Array) -> tuple[Array, Array]:
        return (across_b * here[None]).sum(-1), here

    start = jnp.stack([jnp.ones_like(sites.follow), sites.follow]) / chain.stiffness
    _, at_load = lax.scan(load_step, start, across)
    far = Far(
        read=jnp.concatenate([read, read_left], 1) * q[:, None, :],
        leave=jnp.concatenate([leave, leave_left], -1),
        pass_on=jnp.concatenate([_between_blocks(across), _between_blocks(across_left[::-1])[::-1, ::-1]], 2),
    )
    return Response(
        push=((at_load[:, :, None] * read).sum(1) * q).reshape(1, -1)[:, : chain.sites],
        soft=chain.stiffness / jnp.where(chain.contact > 0, chain.contact, jnp.inf),
        near=jax.vmap(within)(P, Q, source, q)[:, :, None],
        edge_stiffness=sites.edge_stiffness,
        far=None if size == chain.sites else far,
    )


def shared_response(chain: Chain) -> tuple[Springs, Response]:
    """Eliminate a chain and compute its response, once for lanes that share their springs.

    Such lanes differ in thresholds or prestress only.
    """

    def of_springs(springs: Chain) -> tuple[Springs, Response]:
        beyond = eliminate(springs, springs.contact)
        return beyond, of_chain(springs, beyond)

    none = jnp.ones(chain.sites, chain.contact.dtype)
    return lane_by_lane(of_springs, eqx.tree_at(lambda c: (c.threshold, c.prestress), chain, (none, none)))


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
    sites, source = jnp.moveaxis(P, 0, -1), jnp.moveaxis(v, 0, -1)  # blocks last: arithmetic on rows
    unit = jnp.broadcast_to(jnp.eye(2, dtype=P.dtype)[..., None], sites.shape[1:])

    def product(a: Array, b: Array) -> Array:
        return a[:, 0, None] * b[None, 0] + a[:, 1, None] * b[None, 1]

    across, read = lax.scan(lambda so_far, P: (product(P, so_far), so_far[1]), unit, sites, reverse=reverse)

    def back(rest: Array, here: tuple) -> tuple[Array, Array]:
        rest = product(rest, here[0])
        return rest, rest[:, 0] * here[1][None, 0] + rest[:, 1] * here[1][None, 1]

    _, leave = lax.scan(back, unit, (sites, source), reverse=not reverse)
    return jnp.moveaxis(read, -1, 0).swapaxes(1, 2), jnp.moveaxis(leave, -1, 0), jnp.moveaxis(across, -1, 0)


def _between_blocks(across: Float[Array, "B 2 2"]) -> Float[Array, "B B 2 2"]:
    """Propagate edge values from block to block.

    The result holds the edge values of every block per edge value of the block after the source's; axes: from, to.
    """
    blocks = across.shape[0]

    def step(so_far: Array, here: tuple) -> tuple[Array, Array]:
        across_b, b = here
        neighbour = (jnp.arange(blocks) == b)[:, None, None]
        # written out: a product must not depend on how a batched dot is scheduled
        passed = (across_b[None, :, :, None] * so_far[:, None]).sum(2)
        return jnp.where(neighbour, jnp.eye(2, dtype=across.dtype)[None], passed), so_far

    _, reached = lax.scan(step, jnp.zeros_like(across), (across, jnp.arange(blocks)))
    return jnp.swapaxes(reached, 0, 1)


def of_matrix(near: Float[Array, "M r M"], push: Float[Array, "r M"], edge_stiffness: Any = 0.0) -> Response:
    """Response of equal contacts as a matrix.

    From what a contact does to the readings of each per stress it releases, source first; those per load; and the force on the
    pusher per load, in K.
    """
    return Response(push, jnp.ones_like(push[0]), near[None], jnp.asarray(edge_stiffness, near.dtype))


@in_full
def of_slider(modes: Modes, sites: int) -> Response:
    """Response of the first contacts of a semi-infinite slider, as a matrix: directly, and by way of the edge."""
    site = jnp.arange(sites, dtype=modes.gap.dtype)
    y, apart = jax.vmap(modes.profile)(site), jnp.abs(site[:, None] - site[None])
    direct = sum(modes.weight[m] * jnp.exp(apart * jnp.log1p(-modes.gap[m])) for m in (0, 1))
    return of_matrix((direct + y @ modes.reflection @ y.T)[:, None], (y @ modes.drive / modes.load)[None])
