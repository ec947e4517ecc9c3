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
from jaxtyping import Array, Float, Int

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
    given: Float[Array, " M"]  # stress each contact has given up so far
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
    return now.held + sum(
        now.inbox[:, k, None] * resp.read[:, k] for k in range(4)
    )  # written out: compiles to arithmetic on rows


def closed(now: Stresses, block: Array, stress: Array, worst: Array, arrivals: Float[Array, "B 4"]) -> Stresses:
    """One block put back, and the arrivals that come with it."""
    return Stresses(
        held=now.held.at[block].set(stress),
        inbox=now.inbox.at[block].set(0) + arrivals,
        worst=now.worst.at[block].set(worst),
    )


def looked_at(resp: Response, now: Stresses, block: Array, worst: Array) -> Stresses:
    """One block opened and left as it was, but for its bound: `worst` is its largest overload now."""
    since = (now.inbox[block] * resp.reach[block]).sum()
    return now._replace(worst=now.worst.at[block].set(worst - since))


def most(x: Array) -> tuple[Array, Array]:
    """Index and value of the largest entry; the first of equals."""
    value = x.max()
    return jnp.argmax(x == value).astype(jnp.int32), value


class Moves(NamedTuple):
    """Contacts whose pinning points move at a break, the one that breaks last; and the stress each gives up by that."""

    sites: Int[Array, " n"]  # −1 for none
    given: Float[Array, " n"]


Note = Callable[[Any, Moves, Array, Array], Any]
"""What a caller keeps of a break: ``book = note(book, moves, stress the contact carried, stress after)``."""


def burst(
    resp: Response,
    block: Array,
    start: Burst,
    renewed: Float[Array, " M"],
    others: Array,
    forced: Array,
    room: Array,
    note: Note,
) -> Burst:
    """Break contacts of an opened block, the most overloaded first, while none elsewhere can be more overloaded.

    Parameters
    ----------
    start : Burst
        As `begun` has it.
    renewed : array, shape (M,)
        Thresholds of contacts that have broken and repinned.
    others : array, shape ()
        Bound on the overload of every other block.
    forced : array, shape ()
        Contact that breaks first whatever its overload; −1 for none.
    room : array, shape ()
        Breaks at most.
    """
    size = start.stress.shape[0]
    spill = resp.spill[block] * slack(start.stress)
    sites = jnp.arange(size)
    start = start._replace(site=jnp.where(forced >= 0, forced, start.site))

    def going(b: Burst) -> Array:
        sure = (b.overload >= 0) & (b.overload >= others + (b.left * spill).sum())
        return (sure | ((forced >= 0) & (b.breaks == 0))) & (b.breaks < room)

    def step(b: Burst) -> Burst:
        t, here = b.stress[b.site], sites == b.site
        after = jnp.where(here, 0, b.stress) + resp.near[block, b.site] * t
        threshold = jnp.where(here, renewed, b.threshold)
        site, overload = most(after - threshold)
        return Burst(
            stress=after,
            threshold=threshold,
            given=b.given.at[b.site].add(t),
            site=site,
            overload=overload,
            left=b.left + resp.leave[block, b.site] * t,
            breaks=b.breaks + 1,
            book=note(b.book, Moves((block * size + b.site)[None], t[None]), t, after[b.site]),
        )

    return lax.while_loop(going, step, start)


def fold(op: Callable[[Array, Array], Array], x: Float[Array, "... M"]) -> Float[Array, "..."]:
    """`op` over the last axis, M a power of two, half by half: arithmetic that compiles to vector instructions."""
    while x.shape[-1] > 1:
        half = x.shape[-1] // 2
        x = op(x[..., :half], x[..., half:])
    return x[..., 0]


def whole(stress: Float[Array, "B M"], threshold: Float[Array, "B M"]) -> Stresses:
    """All blocks open."""
    return Stresses(stress, jnp.zeros((stress.shape[0], 4), stress.dtype), fold(jnp.maximum, stress - threshold))


def largest(x: Float[Array, "B M"]) -> tuple[Int[Array, ""], Array]:
    """Site and value of the largest entry; the first of equals."""
    block, value = most(fold(jnp.maximum, x))
    return block * x.shape[1] + most(x[block])[0], value


def begun(stress: Float[Array, " M"], threshold: Float[Array, " M"], given: Float[Array, " M"], book: Any) -> Burst:
    """An opened block, of which nothing has broken yet."""
    site, overload = most(stress - threshold)
    return Burst(stress, threshold, given, site, overload, jnp.zeros(4, stress.dtype), jnp.zeros((), jnp.int32), book)
