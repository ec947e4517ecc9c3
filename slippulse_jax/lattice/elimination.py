"""O(N) solution of a chain by elimination, site after site, in sums, products and quotients of positive numbers only.

Eliminating the sites beyond a bond leaves three springs (`Springs`), computed from those one site further. No step
subtracts, so every stiffness and every response comes out with a small relative error, however soft or long the chain:
a plain banded factorisation loses digits where contacts are detached and little holds the chain.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from slippulse_jax.lattice.chain import Chain, Springs

Pair = tuple[Array, Array]
"""One number for each layer: (upper, interfacial)."""


class Elimination(NamedTuple):
    """A chain seen from its left edge, site by site, whatever the displacements and pinning points."""

    beyond: Springs  # (N,): everything right of site i, through bond i; the last is the chain's end
    floating: Bool[Array, ""]  # whether a part of the chain is held by nothing


def beside(far: Springs, across: Array, contact: Array) -> Springs:
    """`far` with the springs of one site put beside it."""
    return Springs(far.upper, far.layer + contact, far.across + across)


def determinant(springs: Springs) -> Array:
    """Determinant of the 2×2 stiffness matrix of three springs; zero where something floats."""
    return springs.upper * springs.layer + springs.across * (springs.upper + springs.layer)


def solve_pair(springs: Springs, force: Pair) -> Pair:
    """Displacements of the two terminals under given forces; zero where something floats."""
    det = determinant(springs)
    det = jnp.where(det > 0, det, jnp.inf)
    f, g = force
    return (
        ((springs.layer + springs.across) * f + springs.across * g) / det,
        ((springs.upper + springs.across) * g + springs.across * f) / det,
    )


def through(bond: Pair, far: Springs) -> Springs:
    """`far` seen through a bond of each layer."""
    B, K = bond
    held = Springs(B + far.upper, K + far.layer, far.across)
    upper, layer = solve_pair(held, (far.upper, far.layer))
    det = determinant(held)
    return Springs(B * upper, K * layer, B * K * far.across / jnp.where(det > 0, det, jnp.inf))


def eliminate(chain: Chain, contact: Float[Array, " N"]) -> Elimination:
    """Eliminate a chain from its right end, with given (tangent) stiffnesses of the contacts."""

    def step(far: Springs, bond_and_site: tuple) -> tuple[Springs, tuple]:
        B, K, across, contact = bond_and_site
        site = beside(far, across, contact)
        floating = determinant(Springs(B + site.upper, K + site.layer, site.across)) <= 0
        seen = through((B, K), site)
        return seen, (seen, floating)

    end = Springs(*(jnp.asarray(x, contact.dtype) for x in chain.end))
    bonds_and_sites = (chain.upper, chain.layer, chain.across[1:], contact[1:])
    _, (beyond, floating) = lax.scan(step, end, bonds_and_sites, reverse=True)
    beyond = Springs(*(jnp.append(x, e) for x, e in zip(beyond, end, strict=True)))
    first = beside(Springs(*(x[0] for x in beyond)), chain.across[0], contact[0])
    return Elimination(beyond, floating.any() | (first.layer + first.across <= 0))


def respond(chain: Chain, contact: Array, force: Pair) -> Pair:
    """Displacements under forces on every site, with u_t[0] held; zero for a part that floats.

    Forces travel from the right end to the left edge through the springs, displacements back.
    """
    beyond = eliminate(chain, contact).beyond
    site = beside(beyond, chain.across, contact)
    held = Springs(site.upper[1:] + chain.upper, site.layer[1:] + chain.layer, site.across[1:])

    def collect(arriving: Pair, here: tuple) -> tuple[Pair, Pair]:
        springs, bond, (f, g) = here
        total = (arriving[0] + f, arriving[1] + g)
        v, u = solve_pair(springs, total)
        return (bond[0] * v, bond[1] * u), total

    bonds = (chain.upper, chain.layer)
    zero = jnp.zeros_like(force[0][0])
    arriving, total = lax.scan(collect, (zero, zero), (held, bonds, tuple(f[1:] for f in force)), reverse=True)
    stiff = site.layer[0] + site.across[0]
    first = (zero, (force[1][0] + arriving[1]) / jnp.where(stiff > 0, stiff, jnp.inf))

    def spread(before: Pair, here: tuple) -> tuple[Pair, Pair]:
        springs, bond, total = here
        after = solve_pair(springs, (bond[0] * before[0] + total[0], bond[1] * before[1] + total[1]))
        return after, after

    _, after = lax.scan(spread, first, (held, bonds, total))
    return jnp.append(first[0], after[0]), jnp.append(first[1], after[1])
