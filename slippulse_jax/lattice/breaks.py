"""Breaks one after another, at a fixed load: at once repinned, or each a while later; and what is kept of them.

Every break raises the stress everywhere else, by a known amount (`slippulse_jax.lattice.response`); which contact is the most
overloaded is found without looking at all of them (`slippulse_jax.lattice.blocks`).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from slippulse_jax.lattice.blocks import Stresses, bounds, burst, closed, most, opened
from slippulse_jax.lattice.chain import Chain
from slippulse_jax.lattice.contacts import at, contacts_of, given_up, largest, moved
from slippulse_jax.lattice.response import Response, carried


class Record(NamedTuple):
    """What is kept of every break."""

    order: Int[Array, " L"]  # sites in order of breaking, −1 where none
    released: Float[Array, " L"]  # stress each break gave up
    breaks: Int[Array, ""]
    energy: Float[Array, ""]  # released, in K u_s²
    furthest: Int[Array, ""]  # rightmost site broken so far
    overload: Float[Array, ""]  # its overload when it first broke


class Progress(NamedTuple):
    """A rupture under way; B blocks of M sites, room for L breaks."""

    stresses: Stresses
    slip: Float[Array, "B M"]  # stress given up so far, in σ_s
    record: Record


def _nothing(max_breaks: int, dtype: DTypeLike) -> Record:
    """No break yet."""
    none, zero = jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
    return Record(jnp.full(max_breaks, -1, jnp.int32), jnp.zeros(max_breaks, dtype), zero, none, zero - 1, none)


def _with_break(record: Record, site: Array, stress: Array, energy: Array, threshold: Array) -> Record:
    """The record with one more break: of a contact that carried `stress`, in σ_s, and released `energy`."""
    return Record(
        order=record.order.at[record.breaks].set(site),
        released=record.released.at[record.breaks].set(stress),
        breaks=record.breaks + 1,
        energy=record.energy + energy,
        furthest=jnp.maximum(site, record.furthest),
        overload=jnp.where(site > record.furthest, stress - threshold, record.overload),
    )


def run(max_breaks: int, resp: Response, stress: Array, threshold: Array, contact: Array, trigger: Array) -> Progress:
    """Break contacts until none is over threshold, or `max_breaks` have broken; `trigger` first unless negative."""
    size = stress.shape[1]
    soft = 1 / jnp.where(contact > 0, 2 * contact, jnp.inf)
    start = Progress(
        Stresses(stress, jnp.zeros_like(resp.reach), (stress - threshold).max(-1)),
        jnp.zeros_like(stress),
        _nothing(max_breaks, stress.dtype),
    )

    def triggered(now: Progress) -> Array:
        return (now.record.breaks == 0) & (trigger >= 0)

    def going(now: Progress) -> Array:
        return ((bounds(resp, now.stresses).max() >= 0) | triggered(now)) & (now.record.breaks < max_breaks)

    def turn(now: Progress) -> Progress:
        bound = bounds(resp, now.stresses)
        first = triggered(now)
        block = jnp.where(first, trigger // size, most(bound)[0])
        others = jnp.where(jnp.arange(bound.shape[0]) == block, -jnp.inf, bound).max()
        limit = threshold[block]

        def note(book: tuple, site: Array, t: Array, after: Array) -> tuple[tuple, Array]:
            slip, record = book
            index = (block * size + site).astype(jnp.int32)
            record = _with_break(record, index, t, t * (t + after) * soft[block, site], limit[site])
            return (slip.at[site].add(t), record), limit[site]

        forced = jnp.where(first, trigger % size, -1)
        room = max_breaks - now.record.breaks
        book = (now.slip[block], now.record)
        end = burst(resp, block, opened(resp, now.stresses, block), limit, others, forced, room, book, note)
        arrivals = carried(resp, block, end.left)
        return Progress(
            stresses=closed(now.stresses, block, end.stress, end.overload, arrivals),
            slip=now.slip.at[block].set(end.book[0]),
            record=end.book[1],
        )

    return lax.while_loop(going, turn, start)


def run_delayed(delay: int, max_breaks: int, chain: Chain, resp: Response, stress: Array, trigger: Array) -> Progress:
    """As `run`, with broken contacts that repin `delay` breaks later. All stresses are brought up to date at every break."""
    tables, size = contacts_of(chain, resp), stress.shape[1]

    def next_break(stress: Array) -> tuple[Array, Array]:
        return largest(stress - tables.threshold)

    def going(carry: tuple) -> Array:
        *_, record, overload = carry
        return ((overload >= 0) | ((record.breaks == 0) & (trigger >= 0))) & (record.breaks < max_breaks)

    def turn(carry: tuple) -> tuple:
        stress, slip, detached, site, record, _ = carry
        t = at(stress, site)
        moves = given_up(tables, stress, detached, site, t)
        after, slip, _ = moved(tables, stress, slip, moves)
        followed = moves[-1][2] - t  # by what its site moved, as a stress
        energy = t * (t + followed) * tables.energy[site // size, site % size] / chain.stiffness**2
        record = _with_break(record, site, t, energy, at(tables.threshold, site))
        following, overload = next_break(after)
        return after, slip, jnp.append(detached, site)[1:], following, record, overload

    site, overload = next_break(stress.T)
    site = jnp.where(trigger >= 0, trigger, site).astype(jnp.int32)
    detached = jnp.full(delay, -1, jnp.int32)
    start = (stress.T, jnp.zeros_like(stress.T), detached, site, _nothing(max_breaks, stress.dtype), overload)
    end, slip, _, _, record, _ = lax.while_loop(going, turn, start)
    soft = tables.gains[:, :, 1]
    given = jnp.where(soft > 0, slip.T / jnp.where(soft > 0, soft, 1), 0)
    return Progress(Stresses(end.T, jnp.zeros_like(resp.reach), jnp.zeros_like(resp.reach[:, 0])), given, record)
