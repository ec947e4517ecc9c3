r"""Load transfer: how pushes and breaks change the readings of every contact.

A contact that releases the stress t_j adds q_i G_ij t_j to the stress on contact i (q_i = k_i/K, G_ij the displacement of
the interfacial layer at i per force at j). Of a chain, displacements are carried from site to site by 2×2 propagators with
non-negative entries, so that nothing is subtracted; what arrives on their left follows by reciprocity, G_ij = G_ji.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

from slippulse_jax.bodies.chain import Chain, Pair, Springs, beside, carried_over, eliminate, pass_site, solve_pair
from slippulse_jax.bulk.compiler import lane_by_lane

MOST_SITES = 2**12
"""Largest number of sites of a chain whose contacts break: its response is a matrix of that size."""


class Response(NamedTuple):
    """Effect of pushes and breaks on the readings of N contacts.

    Readings are the stress and, where anything follows it, the pressure over the initial one.
    """

    push: Float[Array, "r N"]  # per load
    soft: Float[Array, " N"]  # k/k_i, how far a pinning point moves per stress released; 0 without a contact
    matrix: Float[Array, "N r N"]  # per stress released, source first
    edge_stiffness: Float[Array, ""]  # force on the pusher per load, in K

    def through(self, spring: Any, stiffness: Any) -> "Response":
        """Response of a body whose pusher is pulled through a spring.

        The load is then that of the far end of the spring. `spring` and `stiffness`, k of the contacts, are in K.
        """
        spring, push = jnp.asarray(spring), self.push
        whole = spring + self.edge_stiffness
        matrix = self.matrix + stiffness / whole * push[0][:, None, None] * push[None]  # a break lets the pusher move
        return self._replace(matrix=matrix, push=push * spring / whole, edge_stiffness=self.edge_stiffness * spring / whole)


def propagators(chain: Chain, beyond: Springs) -> tuple[Float[Array, "N 2 2"], Float[Array, "N 2"], Array, Array]:
    """Compute a chain's propagators, given its elimination from the right end.

    They map the displacements (u_t, u) of site i to those of i + 1, of the last to zero. With them the displacements at site i
    per force on its interfacial layer, u[0] per u_t[0], and the force on u_t[0] per u_t[0], in K.
    """
    site = beside(beyond, chain.across, chain.contact)
    # u_t[0] is held: from site 1 the upper layer ends in a wall, the interfacial layer in site 0
    ground = chain.across[0] + chain.contact[0]
    share = chain.layer[0] / jnp.where(chain.layer[0] + ground > 0, chain.layer[0] + ground, jnp.inf)
    first = Springs(chain.upper[0], share * ground, jnp.zeros_like(ground))
    bonds = (chain.upper[1:], chain.layer[1:])
    _, rest = lax.scan(pass_site, first, (bonds, chain.across[1:-1], chain.contact[1:-1]))
    none = Springs(*(jnp.zeros_like(ground),) * 3)
    behind = Springs(*(jnp.concatenate([n[None], f[None], r]) for n, f, r in zip(none, first, rest, strict=True)))

    right = jnp.stack([jnp.stack(column, -1) for column in carried_over(chain, site)], -1)
    whole = Springs(*(a + b for a, b in zip(behind, site, strict=True)))
    source = jnp.stack(solve_pair(whole, (jnp.zeros_like(ground), jnp.ones_like(ground))), -1)
    stiff = site.layer[0] + site.across[0]
    at_edge = jnp.zeros(2, right.dtype).at[1].set(1 / jnp.where(stiff > 0, stiff, jnp.inf))
    # u_t[0] − u[0] per load, from positive terms
    apart = (chain.contact[0] + beyond.layer[0]) * at_edge[1]
    right = jnp.concatenate([right, jnp.zeros((1, 2, 2), right.dtype)])
    return right, source.at[0].set(at_edge), site.across[0] * at_edge[1], beyond.upper[0] + site.across[0] * apart


def of_chain(chain: Chain, beyond: Springs) -> Response:
    """Compute the response of a chain with linear contacts.

    `beyond` is its elimination. Thresholds and prestress do not matter. In O(N²): 3 ms for 1000 sites, 0.1 s for 3000.

    Raises
    ------
    ValueError
        If there are more than `MOST_SITES`, saying how much memory that would take.
    """
    if chain.sites > MOST_SITES:
        raise ValueError(
            f"a chain of {chain.sites} sites: what each contact does to every other would take "
            f"{chain.sites**2 * chain.contact.dtype.itemsize / 1e9:.1f} GB; the most is {MOST_SITES}. Of a uniform one, take "
            "contacts n times as large: H/λc over n, and n times k/K"
        )
    right, source, follow, edge_stiffness = propagators(chain, beyond)
    load = jnp.stack([jnp.ones_like(follow), follow]) / chain.stiffness
    at_load = lax.scan(lambda here, P: ((P * here[None]).sum(-1), here[1]), load, right)[1]
    soft = chain.stiffness / jnp.where(chain.contact > 0, chain.contact, jnp.inf)
    matrix = transfers(right, source, chain.contact)[:, None]
    return Response((at_load * chain.contact)[None], soft, matrix, edge_stiffness)


def with_response(f: Callable, chain: Chain, *given: Any) -> Any:
    """Evaluate ``f(beyond, response, chain, *given)`` lane by lane.

    Lanes that differ only in thresholds or prestress share elimination and response; of others only one is held at a time.
    """
    none = jnp.ones(chain.sites, chain.contact.dtype)
    springs = eqx.tree_at(lambda c: (c.threshold, c.prestress, c.residual_strength), chain, (none, none, none[0]))

    def of_springs(springs: Chain) -> tuple[Springs, Response]:
        beyond = eliminate(springs, springs.contact)
        return beyond, of_chain(springs, beyond)

    def one(springs: Chain, *given: Any) -> Any:
        return f(*of_springs(springs), *given)

    lanes = custom_vmap(one)

    @lanes.def_vmap
    def _rule(size, in_batched, springs, *given):  # pyright: ignore[reportUnusedFunction]
        own = any(jax.tree.leaves(in_batched[0]))
        axes = jax.tree.map(lambda batched: 0 if batched else None, tuple(in_batched))
        where, first, function = (axes, (springs,), one) if own else ((None, None, *axes[1:]), of_springs(springs), f)
        found = jax.vmap(lambda *x: lane_by_lane(function, *x), where, axis_size=size)(*first, *given)
        return found, jax.tree.map(lambda _: True, found)

    return lanes(springs, chain, *given)


def transfers(right: Float[Array, "N 2 2"], source: Float[Array, "N 2"], contact: Float[Array, " N"]) -> Float[Array, "N N"]:
    """Compute q_i G_ij, source first.

    The displacements due to all sources are carried to the right together, site by site.
    """
    sites = jnp.arange(contact.size, dtype=jnp.int32)

    def step(arriving: Pair, here: tuple) -> tuple[Pair, Array]:
        P, source, site = here
        upper, layer = (jnp.where(sites == site, source[edge], arriving[edge]) for edge in (0, 1))
        return (P[0, 0] * upper + P[0, 1] * layer, P[1, 0] * upper + P[1, 1] * layer), layer

    nothing = jnp.zeros_like(contact)
    arrived = lax.scan(step, (nothing, nothing), (right, source, sites))[1]
    return jnp.where(sites[:, None] >= sites[None], arrived, arrived.T) * contact[None]


def of_matrix(matrix: Float[Array, "N r N"], push: Float[Array, "r N"], edge_stiffness: Any = 0.0) -> Response:
    """Response of equal contacts as a matrix.

    From what a contact does to the readings of each per stress it releases, source first; those per load; and the force on the
    pusher per load, in K.
    """
    return Response(push, jnp.ones_like(push[0]), matrix, jnp.asarray(edge_stiffness, matrix.dtype))
