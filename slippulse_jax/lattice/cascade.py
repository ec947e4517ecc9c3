"""Successive breaks at a fixed load, with stresses kept block by block.

A break changes every stress by a known amount (`slippulse_jax.lattice.response`). Within the block of the broken contact the
stresses are updated at once. Every other block only adds up what arrives at its edges, and bounds its largest overload by

    overload ≤ (largest overload when the block was last opened) + (arrived) · (largest reading of a contact).

To open a block is to compute its current stresses. The most overloaded contact of the chain is found by opening a few blocks.
The contacts of one block then break one after another, in a *burst*, until another block might hold a more overloaded contact.
The order of breaks is exactly the same as if all contacts were checked after every break; the cost is O(√N) per break or less.

A contact may repin some breaks after it broke. Until then it is detached and carries no stress: its pinning point follows the
layer. Each break therefore moves the pinning points of all detached contacts such that their stress stays zero.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.lattice.response import Response, carried, within

SLACK_DIGITS = 4096
"""Units in the last place by which a bound is raised: more than the rounding of thousands of positive terms."""


class Stresses(NamedTuple):
    """Stresses of B blocks of M contacts, in σ_s."""

    held: Float[Array, "B M"]  # stress when the block was last opened
    inbox: Float[Array, "B 4"]  # displacements that have arrived at the block's edges since then
    worst: Float[Array, " B"]  # largest overload of the block when it was last opened


class Burst(NamedTuple):
    """State of a burst: successive breaks in one block."""

    stress: Float[Array, " M"]
    threshold: Float[Array, " M"]
    given: Float[Array, " M"]  # stress each contact has released so far
    site: Array  # most overloaded contact of the block
    overload: Array  # its overload
    left: Float[Array, "4"]  # what has left the block, to the right and to the left
    breaks: Array
    book: Any  # the caller's record of the breaks


def slack(like: Array) -> float:
    """Factor by which a bound is raised to cover rounding."""
    return 1 + SLACK_DIGITS * float(jnp.finfo(like.dtype).eps)


def bounds(resp: Response, now: Stresses) -> Float[Array, " B"]:
    """Bound the overload in each block from above."""
    return now.worst + (now.inbox * resp.reach).sum(-1) * slack(now.worst)


def opened(resp: Response, now: Stresses, block: Array) -> Float[Array, " M"]:
    """Compute the current stresses of one block."""
    return now.held[block] + (now.inbox[block][:, None] * resp.read[block]).sum(0)


def all_opened(resp: Response, now: Stresses) -> Float[Array, "B M"]:
    """Compute the current stresses of all blocks."""
    return now.held + sum(
        now.inbox[:, k, None] * resp.read[:, k] for k in range(4)
    )  # written out, to compile to arithmetic on rows


def closed(now: Stresses, block: Array, stress: Array, worst: Array, arrivals: Float[Array, "B 4"]) -> Stresses:
    """Close one block and deliver what left it to the other blocks."""
    return Stresses(
        held=now.held.at[block].set(stress),
        inbox=now.inbox.at[block].set(0) + arrivals,
        worst=now.worst.at[block].set(worst),
    )


def looked_at(resp: Response, now: Stresses, block: Array, worst: Array) -> Stresses:
    """Update the bound of one block, whose largest overload is now `worst`."""
    since = (now.inbox[block] * resp.reach[block]).sum()
    return now._replace(worst=now.worst.at[block].set(worst - since))


def most(x: Array) -> tuple[Array, Array]:
    """Return index and value of the largest entry; the first of equals."""
    value = x.max()
    return jnp.argmax(x == value).astype(jnp.int32), value


class Moves(NamedTuple):
    """Contacts whose pinning points move in a break, the breaking contact last."""

    sites: Int[Array, " n"]  # −1 for none
    given: Float[Array, " n"]


Note = Callable[[Any, Moves, Array, Array], Any]
"""Record of a break: ``book = note(book, moves, stress the contact carried, stress after)``."""


Done = Callable[[Any], Array | bool]
"""Whether a cascade is to end early: ``done(book)``."""


def never(_: Any) -> bool:
    """End no cascade early."""
    return False


def burst(
    resp: Response,
    block: Array,
    start: Burst,
    renewed: Float[Array, " M"],
    others: Array,
    forced: Array,
    room: Array,
    note: Note,
    done: Done = never,
) -> Burst:
    """Break contacts of one opened block, the most overloaded first.

    The burst ends when a contact of another block might be more overloaded.

    Parameters
    ----------
    start : Burst
        From `begun`.
    renewed : array, shape (M,)
        Thresholds of contacts that have broken and repinned.
    others : array, shape ()
        Bound on the overload of every other block.
    forced : array, shape ()
        Contact that breaks first, whatever its overload; −1 for none.
    room : array, shape ()
        Largest number of breaks.
    """
    size = start.stress.shape[0]
    spill = resp.spill[block] * slack(start.stress)
    sites = jnp.arange(size, dtype=jnp.int32)
    start = start._replace(site=jnp.where(forced >= 0, forced, start.site))

    def going(b: Burst) -> Array:
        sure = (b.overload >= 0) & (b.overload >= others + (b.left * spill).sum())
        return (sure | ((forced >= 0) & (b.breaks == 0))) & (b.breaks < room) & jnp.logical_not(done(b.book))

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
    """Reduce the last axis, of length 2ⁿ, by halves.

    Unlike a plain reduction, this compiles to vector instructions.
    """
    while x.shape[-1] > 1:
        half = x.shape[-1] // 2
        x = op(x[..., :half], x[..., half:])
    return x[..., 0]


def whole(stress: Float[Array, "B M"], threshold: Float[Array, "B M"]) -> Stresses:
    """Stresses with every block just opened."""
    return Stresses(stress, jnp.zeros((stress.shape[0], 4), stress.dtype), fold(jnp.maximum, stress - threshold))


def largest(x: Float[Array, "B M"]) -> tuple[Int[Array, ""], Array]:
    """Return site and value of the largest entry; the first of equals."""
    block, value = most(fold(jnp.maximum, x))
    return block * x.shape[1] + most(x[block])[0], value


def begun(stress: Float[Array, " M"], threshold: Float[Array, " M"], given: Float[Array, " M"], book: Any) -> Burst:
    """Burst of an opened block before its first break."""
    site, overload = most(stress - threshold)
    return Burst(stress, threshold, given, site, overload, jnp.zeros(4, stress.dtype), jnp.zeros((), jnp.int32), book)


Limits = Callable[[Array, Float[Array, " M"]], tuple[Float[Array, " M"], Float[Array, " M"]]]
"""Thresholds of a block, current and after a break; inf where there is no contact.

The arguments are the number of the block and the stress its contacts have released.
"""


class Cascade(NamedTuple):
    """State of a cascade in B blocks of M contacts."""

    stresses: Stresses
    given: Float[Array, "B M"]  # stress released by each contact so far: the shift of its pinning point as a stress, in σ_s
    arrived: Float[Array, "B 4"]  # displacements at the edges of every block; inf where contacts of the block broke
    breaks: Int[Array, ""]
    overload: Float[Array, ""]  # not negative if contacts were still overloaded when the limit on breaks was reached
    book: Any  # the caller's record of the breaks


def run(
    max_breaks: int | Array,
    delay: int,
    resp: Response,
    stresses: Stresses,
    given: Float[Array, "B M"],
    limits: Limits,
    trigger: Int[Array, ""],
    book: Any,
    note: Note,
    done: Done = never,
) -> Cascade:
    """Break contacts until none is overloaded, `max_breaks` have broken, or `done` says so.

    Contact `trigger` breaks first, unless it is negative. Broken contacts repin at once, or `delay` breaks later; with a
    delay every break updates all stresses, in O(N).
    """
    nothing, none = jnp.full((), -jnp.inf, given.dtype), jnp.zeros((), jnp.int32)
    start = Cascade(stresses, given, jnp.zeros_like(stresses.inbox), none, nothing, book)
    if delay:
        return _one_by_one(delay, max_breaks, resp, start, limits, trigger, note, done)
    return _in_bursts(max_breaks, resp, start, limits, trigger, note, done)


def _in_bursts(
    max_breaks: int | Array, resp: Response, start: Cascade, limits: Limits, trigger: Array, note: Note, done: Done
) -> Cascade:
    blocks, size = start.given.shape

    def triggered(now: Cascade) -> Array:
        return (now.breaks == 0) & (trigger >= 0) & (max_breaks > 0)

    def chosen(now: Cascade) -> tuple[Cascade, Array, Array]:
        bound = bounds(resp, now.stresses)
        return now, bound, jnp.where(triggered(now), trigger // size, most(bound)[0])

    def going(carry: tuple[Cascade, Array, Array]) -> Array:
        now, bound, _ = carry
        given_up = ((now.breaks >= max_breaks) & (now.overload >= 0)) | done(now.book)
        return ((bound.max() >= 0) | triggered(now)) & ~given_up

    def turn(resp: Response, carry: tuple[Cascade, Array, Array]) -> tuple[Cascade, Array, Array]:
        now, bound, block = carry
        others = jnp.where(jnp.arange(blocks, dtype=jnp.int32) == block, -jnp.inf, bound).max()
        limit, renewed = limits(block, now.given[block])
        opens = begun(opened(resp, now.stresses, block), limit, now.given[block], now.book)
        forced = jnp.where(triggered(now), trigger % size, -1)
        end = burst(resp, block, opens, renewed, others, forced, max_breaks - now.breaks, note, done)
        arrivals = carried(resp, block, end.left)
        after = Cascade(
            stresses=closed(now.stresses, block, end.stress, end.overload, arrivals),
            given=now.given.at[block].set(end.given),
            arrived=(now.arrived + arrivals).at[block].set(jnp.inf),
            breaks=now.breaks + end.breaks,
            overload=end.overload,
            book=end.book,
        )
        return chosen(after)

    if resp.near.shape[0]:
        return lax.while_loop(going, partial(turn, resp), chosen(start))[0]

    def in_known_blocks(carry: tuple[Array, Array, tuple]) -> tuple[Array, Array, tuple]:
        """Compute the block to be opened, and go on until another one must be computed."""
        near, known, now = carry
        block = now[2]
        links = (x[block] for x in (resp.links.right, resp.links.left, resp.links.source, resp.contact))
        near, known = near.at[block].set(within(*links)), known.at[block].set(True)
        here = resp._replace(near=near)
        return near, known, lax.while_loop(lambda now: going(now) & known[now[2]], partial(turn, here), now)

    nothing = jnp.zeros((blocks, size, size), start.given.dtype), jnp.zeros(blocks, bool)
    return lax.while_loop(lambda carry: going(carry[2]), in_known_blocks, (*nothing, chosen(start)))[2][0]


class Delayed(NamedTuple):
    """State of a cascade whose broken contacts stay detached for n breaks."""

    stress: Float[Array, "B M"]
    given: Float[Array, "B M"]
    detached: Int[Array, " n"]  # sites that have not repinned yet, the last broken last; −1 for none
    site: Array  # most overloaded contact
    overload: Array
    breaks: Array
    book: Any


def _one_by_one(
    delay: int, max_breaks: int | Array, resp: Response, start: Cascade, limits: Limits, trigger: Array, note: Note, done: Done
) -> Cascade:
    all_blocks = jnp.arange(start.given.shape[0], dtype=jnp.int32)

    def overloads(stress: Array, given: Array) -> Array:
        return stress - jax.vmap(limits)(all_blocks, given)[0]

    def going(now: Delayed) -> Array:
        overloaded = (now.overload >= 0) | ((now.breaks == 0) & (trigger >= 0))
        return overloaded & (now.breaks < max_breaks) & jnp.logical_not(done(now.book))

    def turn(now: Delayed) -> Delayed:
        t = now.stress.reshape(-1)[now.site]
        # the contact detached longest repins first, where it is
        moving = jnp.append(now.detached, now.site)[1:]
        moves = _given_up(resp, moving, t)
        stress, given = _moved(resp, now.stress, now.given, moving, moves)
        site, overload = largest(overloads(stress, given))
        # the displacement of the broken contact's site, as a stress
        book = note(now.book, Moves(moving, moves), t, moves[-1] - t)
        return Delayed(stress, given, moving, site, overload, now.breaks + 1, book)

    stress = all_opened(resp, start.stresses)
    site, overload = largest(overloads(stress, start.given))
    site = jnp.where(trigger >= 0, trigger, site)
    begin = Delayed(stress, start.given, jnp.full(delay, -1, jnp.int32), site, overload, start.breaks, start.book)
    end = lax.while_loop(going, turn, begin)
    worst = fold(jnp.maximum, overloads(end.stress, end.given))
    stresses = Stresses(end.stress, jnp.zeros_like(start.stresses.inbox), worst)
    return Cascade(stresses, end.given, jnp.full_like(start.arrived, jnp.inf), end.breaks, end.overload, end.book)


def _given_up(resp: Response, moving: Int[Array, " n"], t: Array) -> Float[Array, " n"]:
    """Compute the stress each detached contact releases as the last one breaks."""
    size, n = resp.near.shape[1], moving.shape[0]
    there = moving >= 0
    block, place = jnp.maximum(moving, 0) // size, jnp.maximum(moving, 0) % size
    arrived = jax.vmap(partial(carried, resp))(block, resp.leave[block, place])[:, block]  # source, target, edge value
    far = (arrived * resp.read[block, :, place][None]).sum(-1)
    near = resp.near[block[:, None], place[:, None], place[None, :]]
    green = jnp.where(there[:, None] & there[None, :], jnp.where(block[:, None] == block[None, :], near, far), 0)
    return jnp.linalg.solve(jnp.eye(n, dtype=t.dtype) - green.T, jnp.zeros(n, t.dtype).at[-1].set(t))


def _moved(
    resp: Response, stress: Array, given: Array, moving: Int[Array, " n"], moves: Float[Array, " n"]
) -> tuple[Array, Array]:
    """Update stresses and pinning points."""
    size, n = resp.near.shape[1], moving.shape[0]
    block, place = jnp.maximum(moving, 0) // size, jnp.maximum(moving, 0) % size
    arrived = jax.vmap(partial(carried, resp))(block, resp.leave[block, place] * moves[:, None]).sum(0)
    stress = stress + (arrived[:, :, None] * resp.read).sum(1)
    for j in range(n):  # several may lie in one block
        stress = stress.at[block[j]].add(resp.near[block[j], place[j]] * moves[j])
        stress = stress.at[block[j], place[j]].add(-moves[j])
        given = given.at[block[j], place[j]].add(moves[j])
    return stress, given
