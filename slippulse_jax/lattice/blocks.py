"""Stresses of all contacts while they break, known block by block.

A break changes every stress by a known amount (`slippulse_jax.lattice.response`). Within the block of the broken contact the
change is made at once; every other block is only told what has arrived at its edges, and bounds its largest overload by

    overload ≤ (largest overload when the block was last opened) + (arrived) · (largest reading of a contact).

To open a block is to read off its stresses as they are now. So the most overloaded contact of the chain is found by opening few
blocks, and the contacts of one block break one after another, in a *burst*, for as long as no other block can hold a more
overloaded one. The order of breaks is exactly that of looking at all contacts after every break, at O(√N) a break or less.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.lattice.response import Response

SLACK_DIGITS = 4096
"""Units in the last place by which a bound is raised: more than thousands of positive terms can lose."""


class Stresses(NamedTuple):
    """B blocks of M contacts; in σ_s."""

    held: Float[Array, "B M"]  # stress as of when the block was last opened
    inbox: Float[Array, "B 4"]  # arrived at the block's edges since
    worst: Float[Array, " B"]  # largest overload of the block when it was last opened


class Burst(NamedTuple):
    """Breaks of one block under way."""

    stress: Float[Array, " M"]
    threshold: Float[Array, " M"]
    site: Array  # most overloaded contact of the block
    overload: Array  # its overload
    left: Float[Array, "4"]  # what has left the block, to the right and to the left
    breaks: Array
    book: Any  # what the caller keeps of every break


def slack(like: Array) -> float:
    """Factor by which a bound is raised."""
    return 1 + SLACK_DIGITS * float(jnp.finfo(like.dtype).eps)


def bounds(resp: Response, now: Stresses) -> Float[Array, " B"]:
    """No contact of a block is more overloaded than this."""
    return now.worst + (now.inbox * resp.reach).sum(-1) * slack(now.worst)


def opened(resp: Response, now: Stresses, block: Array) -> Float[Array, " M"]:
    """Stresses of one block."""
    return now.held[block] + (now.inbox[block][:, None] * resp.read[block]).sum(0)


def all_opened(resp: Response, now: Stresses) -> Float[Array, "B M"]:
    """Stresses of all blocks."""
    return now.held + (now.inbox[:, :, None] * resp.read).sum(1)


def closed(now: Stresses, block: Array, stress: Array, worst: Array, arrivals: Float[Array, "B 4"]) -> Stresses:
    """One block put back, and the arrivals that come with it."""
    return Stresses(
        held=now.held.at[block].set(stress),
        inbox=now.inbox.at[block].set(0) + arrivals,
        worst=now.worst.at[block].set(worst),
    )


def most(x: Array) -> tuple[Array, Array]:
    """Index and value of the largest entry; the first of equals."""
    value = x.max()
    return jnp.argmax(x == value), value


def burst(
    resp: Response,
    block: Array,
    stress: Float[Array, " M"],
    threshold: Float[Array, " M"],
    others: Array,
    forced: Array,
    room: Array,
    book: Any,
    note: Callable[[Any, Array, Array, Array], tuple[Any, Array]],
) -> Burst:
    """Break contacts of an opened block, the most overloaded first, while none elsewhere can be more overloaded.

    Parameters
    ----------
    others : array, shape ()
        Bound on the overload of every other block.
    forced : array, shape ()
        Contact that breaks first whatever its overload; −1 for none.
    room : array, shape ()
        Breaks at most.
    book, note
        What is kept of the breaks: ``book, threshold = note(book, site, stress given up, stress after)``, with the
        threshold of the contact that has just repinned.
    """
    spill = resp.spill[block] * slack(stress)
    sites = jnp.arange(stress.shape[0])
    site, overload = most(stress - threshold)
    index = jnp.where(forced >= 0, forced, site)
    start = Burst(stress, threshold, index, overload, jnp.zeros_like(spill), jnp.zeros((), jnp.int32), book)

    def going(b: Burst) -> Array:
        sure = (b.overload >= 0) & (b.overload >= others + (b.left * spill).sum())
        return (sure | ((forced >= 0) & (b.breaks == 0))) & (b.breaks < room)

    def step(b: Burst) -> Burst:
        t = b.stress[b.site]
        after = jnp.where(sites == b.site, 0, b.stress) + resp.near[block, b.site] * t
        book, renewed = note(b.book, b.site, t, after[b.site])
        threshold = jnp.where(sites == b.site, renewed, b.threshold)
        site, overload = most(after - threshold)
        return Burst(after, threshold, site, overload, b.left + resp.leave[block, b.site] * t, b.breaks + 1, book)

    return lax.while_loop(going, step, start)
