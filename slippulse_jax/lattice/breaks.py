"""Breaks one after another, at a fixed load, until no contact is over its threshold.

Every break raises the stress everywhere else, by a known amount (`slippulse_jax.lattice.response`); which contact is the most
overloaded is found without looking at all of them (`slippulse_jax.lattice.blocks`).

A contact may repin a while after it broke. Until then it is detached and carries nothing. It is one whose pinning point
follows the layer, so as a contact breaks, the pinning points of all detached ones move such that no stress is left there.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.lattice.blocks import (
    Moves,
    Note,
    Stresses,
    all_opened,
    begun,
    bounds,
    burst,
    closed,
    fold,
    largest,
    most,
    opened,
)
from slippulse_jax.lattice.response import Response, carried

Limits = Callable[[Array, Float[Array, " M"]], tuple[Float[Array, " M"], Float[Array, " M"]]]
"""Thresholds in a block, by its number and what its contacts have given up: now, and once broken; inf where there is none."""


class Broken(NamedTuple):
    """A rupture under way, and what is left when it is over. B blocks of M contacts."""

    stresses: Stresses
    given: Float[Array, "B M"]  # stress given up by each contact so far: how far its pinning point moved, in σ_s
    arrived: Float[Array, "B 4"]  # at the edges of every block; inf where contacts of the block broke
    breaks: Int[Array, ""]
    overload: Float[Array, ""]  # not negative if contacts were still over threshold after the most breaks allowed
    book: Any  # what the caller kept of every break


def check_delay(delay: object) -> None:
    """Refuse anything that is not a number of breaks."""
    if isinstance(delay, bool) or not isinstance(delay, int) or delay < 0:
        raise ValueError(f"repin_delay = {delay!r}: must be a whole number of breaks, 0 or more")


def run(
    max_breaks: int,
    delay: int,
    resp: Response,
    stresses: Stresses,
    given: Float[Array, "B M"],
    limits: Limits,
    trigger: Int[Array, ""],
    book: Any,
    note: Note,
) -> Broken:
    """Break contacts until none is over threshold, or `max_breaks` have broken; `trigger` first unless negative.

    Broken contacts repin at once, or `delay` breaks later; then all stresses are brought up to date at every break, in O(N).
    """
    nothing, none = jnp.full((), -jnp.inf, given.dtype), jnp.zeros((), jnp.int32)
    start = Broken(stresses, given, jnp.zeros_like(stresses.inbox), none, nothing, book)
    if delay:
        return _one_by_one(delay, max_breaks, resp, start, limits, trigger, note)
    return _in_bursts(max_breaks, resp, start, limits, trigger, note)


def _in_bursts(max_breaks: int, resp: Response, start: Broken, limits: Limits, trigger: Array, note: Note) -> Broken:
    size = start.given.shape[1]

    def triggered(now: Broken) -> Array:
        return (now.breaks == 0) & (trigger >= 0) & (max_breaks > 0)

    def going(carry: tuple[Broken, Array]) -> Array:
        now, bound = carry
        given_up = (now.breaks >= max_breaks) & (now.overload >= 0)
        return ((bound.max() >= 0) | triggered(now)) & ~given_up

    def turn(carry: tuple[Broken, Array]) -> tuple[Broken, Array]:
        now, bound = carry
        first = triggered(now)
        block = jnp.where(first, trigger // size, most(bound)[0])
        others = jnp.where(jnp.arange(bound.shape[0]) == block, -jnp.inf, bound).max()
        limit, renewed = limits(block, now.given[block])
        opens = begun(opened(resp, now.stresses, block), limit, now.given[block], now.book)
        forced = jnp.where(first, trigger % size, -1)
        end = burst(resp, block, opens, renewed, others, forced, max_breaks - now.breaks, note)
        arrivals = carried(resp, block, end.left)
        after = Broken(
            stresses=closed(now.stresses, block, end.stress, end.overload, arrivals),
            given=now.given.at[block].set(end.given),
            arrived=(now.arrived + arrivals).at[block].set(jnp.inf),
            breaks=now.breaks + end.breaks,
            overload=end.overload,
            book=end.book,
        )
        return after, bounds(resp, after.stresses)

    return lax.while_loop(going, turn, (start, bounds(resp, start.stresses)))[0]


class Delayed(NamedTuple):
    """A rupture under way whose broken contacts stay detached for n breaks."""

    stress: Float[Array, "B M"]
    given: Float[Array, "B M"]
    detached: Int[Array, " n"]  # sites that have not repinned yet, the last broken last; −1 for none
    site: Array  # most overloaded contact
    overload: Array
    breaks: Array
    book: Any


def _one_by_one(
    delay: int, max_breaks: int, resp: Response, start: Broken, limits: Limits, trigger: Array, note: Note
) -> Broken:
    all_blocks = jnp.arange(start.given.shape[0])

    def overloads(stress: Array, given: Array) -> Array:
        return stress - jax.vmap(limits)(all_blocks, given)[0]

    def going(now: Delayed) -> Array:
        return ((now.overload >= 0) | ((now.breaks == 0) & (trigger >= 0))) & (now.breaks < max_breaks)

    def turn(now: Delayed) -> Delayed:
        t = now.stress.reshape(-1)[now.site]
        # the one that has been detached longest repins first, where it is
        moving = jnp.append(now.detached, now.site)[1:]
        moves = _given_up(resp, moving, t)
        stress, given = _moved(resp, now.stress, now.given, moving, moves)
        site, overload = largest(overloads(stress, given))
        # by what the site of the broken contact moved, as a stress
        book = note(now.book, Moves(moving, moves), t, moves[-1] - t)
        return Delayed(stress, given, moving, site, overload, now.breaks + 1, book)

    stress = all_opened(resp, start.stresses)
    site, overload = largest(overloads(stress, start.given))
    site = jnp.where(trigger >= 0, trigger, site)
    begin = Delayed(stress, start.given, jnp.full(delay, -1, jnp.int32), site, overload, start.breaks, start.book)
    end = lax.while_loop(going, turn, begin)
    worst = fold(jnp.maximum, overloads(end.stress, end.given))
    stresses = Stresses(end.stress, jnp.zeros_like(start.stresses.inbox), worst)
    return Broken(stresses, end.given, jnp.full_like(start.arrived, jnp.inf), end.breaks, end.overload, end.book)


def _given_up(resp: Response, moving: Int[Array, " n"], t: Array) -> Float[Array, " n"]:
    """Stress that detached contacts give up, by their pinning points, as the last of them breaks and gives up t."""
    size, n = resp.near.shape[1], moving.shape[0]
    there = moving >= 0
    block, place = jnp.maximum(moving, 0) // size, jnp.maximum(moving, 0) % size
    arrived = jax.vmap(partial(carried, resp))(block, resp.leave[block, place])[:, block]  # source, target, edge value
    far = (arrived * resp.read[block, :, place][None]).sum(-1)
    near = resp.near[block[:, None], place[:, None], place[None, :]]
    green = jnp.where(block[:, None] == block[None, :], near, far) * there[:, None] * there[None, :]
    return jnp.linalg.solve(jnp.eye(n) - green.T, jnp.zeros(n, t.dtype).at[-1].set(t))


def _moved(
    resp: Response, stress: Array, given: Array, moving: Int[Array, " n"], moves: Float[Array, " n"]
) -> tuple[Array, Array]:
    """Stresses, and what contacts have given up, after pinning points have moved."""
    size, n = resp.near.shape[1], moving.shape[0]
    block, place = jnp.maximum(moving, 0) // size, jnp.maximum(moving, 0) % size
    arrived = jax.vmap(partial(carried, resp))(block, resp.leave[block, place] * moves[:, None]).sum(0)
    stress = stress + (arrived[:, :, None] * resp.read).sum(1)
    for j in range(n):  # several may lie in one block
        stress = stress.at[block[j]].add(resp.near[block[j], place[j]] * moves[j])
        stress = stress.at[block[j], place[j]].add(-moves[j])
        given = given.at[block[j], place[j]].add(moves[j])
    return stress, given
