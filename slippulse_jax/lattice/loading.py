r"""Loading a chain from event to event: to the next break, the rupture, the record of it, and how contacts age.

Between events every stress grows linearly with the load, so that the next break is found exactly. In an event contacts break
one after another at a fixed load, the most overloaded first. All sums are updated from break to break; the chain is solved
afresh only at the end, to see what they have lost:

* a break at j that gives up the stress t_j adds q_i G_ij t_j to every stress (`slippulse_jax.lattice.response`);
* by reciprocity it lowers the force on the left edge by k t_j du_j/dU;
* it gives up the energy (k t_j)²/2k_j of the broken contact's own stretch, and (k t_j)(k t_j')/2k_j on top of it as the chain
  relaxes to equilibrium, t_j' being what the contact carries then;
* what the drive puts in beyond that is stored.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.lattice.ageing import Ageing, next_crossing
from slippulse_jax.lattice.catalogue import EventClass, SeriesStatus
from slippulse_jax.lattice.contacts import Contacts, at, fold, given_up, largest, moved, put


class Numbers(NamedTuple):
    """Of the event under way, or the last one; carried and recorded as one vector."""

    load: Array
    force_before: Array  # on the left edge, as it began
    work: Array
    force_lost: Array
    slip: Array
    stress_drop: Array
    broken: Array
    relaxed: Array


class Counts(NamedTuple):
    """Likewise, as whole numbers."""

    number: Array  # −1 before the first event
    first: Array  # site that broke first
    creeps: Array  # whether the contact left of it broke later than it did
    left: Array
    right: Array
    breaks: Array
    total: Array  # of breaks, in all events


class Now(NamedTuple):
    """A series under way. The last rows of the tables are for what need not be kept."""

    stress: Float[Array, "M B"]
    threshold: Float[Array, "M B"] | None  # at this load, where contacts age
    born: Float[Array, "M B"] | None  # load at the last break; −inf if never
    pinning: Float[Array, "M B"]
    last: Int[Array, "M B"]  # event of the last break; −1 if never
    detached: Int[Array, " n"]  # sites that have not repinned yet, the last broken last; −1 for none
    numbers: Float[Array, "8"]
    counts: Int[Array, "7"]
    ending: Int[Array, ""]  # a `SeriesStatus`, or −1
    number_table: Float[Array, "E+1 8"]
    count_table: Int[Array, "E+1 7"]
    log: Int[Array, "L+1 2"]  # site and event of every break


class Loading(NamedTuple):
    """What is done to the chain."""

    contacts: Contacts
    ageing: Ageing | None
    velocity: Array
    step: Array | None  # whole steps of load; None: exactly to the next break
    delay: int  # breaks for which a contact stays detached
    sites: int  # of the chain, the driver's among them
    ahead: int  # sites before the chain's own: the driver's
    events: int
    max_breaks: int
    recorded: int
    stop_when_spanning: bool


def start(by: Loading, prestress: Float[Array, "M B"], valid: Array) -> Now:
    """The relaxed chain."""
    dtype, aged = prestress.dtype, by.ageing is not None
    return Now(
        stress=prestress,
        threshold=by.contacts.threshold if aged else None,
        born=jnp.full_like(prestress, -jnp.inf) if aged else None,
        pinning=jnp.zeros_like(prestress),
        last=jnp.full(prestress.shape, -1, jnp.int32),
        detached=jnp.full(by.delay, -1, jnp.int32),
        numbers=jnp.zeros(8, dtype),
        counts=jnp.array([-1, 0, 0, 0, -1, 0, 0], jnp.int32),
        ending=jnp.where(valid, -1, SeriesStatus.INVALID).astype(jnp.int32),
        number_table=jnp.full((by.events + 1, 8), jnp.nan, dtype),
        count_table=jnp.tile(jnp.array([-1, by.ahead - 1, 0, by.ahead - 1, by.ahead - 1, 0, 0], jnp.int32), (by.events + 1, 1)),
        log=jnp.full((by.recorded + 1, 2), -1, jnp.int32),
    )


def load_through(by: Loading, now: Now) -> Now:
    """Break after break, through all events. Each turn finds the next contact, loading the chain if need be, and breaks it."""

    def turn(now: Now) -> Now:
        now, site, t = _next_break(by, now)
        return _record(by, _break(by, now, site, t), site)

    return lax.while_loop(lambda now: now.ending < 0, turn, now)


def _next_break(by: Loading, now: Now) -> tuple[Now, Array, Array]:
    """The most overloaded contact and its stress; if none is overloaded, the load is raised to the next: an event."""
    tables, count = by.contacts, Counts(*now.counts)
    limit = tables.threshold if now.threshold is None else now.threshold
    site, overload = largest(now.stress - limit)
    quiet = overload < 0
    spanned = by.stop_when_spanning & (count.right == by.sites - 1)
    ends = jnp.where(quiet, spanned | (count.number == by.events - 1), count.breaks >= by.max_breaks)
    loads = quiet & ~ends

    def onward() -> tuple:
        rise, found = _rise(by, now)
        threshold = tables.threshold
        if by.ageing is not None:
            threshold = threshold * by.ageing.strength(now.numbers[0] + rise - _aged(now.born), by.velocity)
        first = largest(now.stress + tables.per_load * rise - threshold)[0]
        t = at(now.stress, first) + at(tables.per_load, first) * rise
        return rise, first, jnp.where(found, t, 0), found, threshold if by.ageing is not None else None

    def stay() -> tuple:
        t = jnp.where(ends, 0, at(now.stress, site))
        return jnp.zeros_like(t), site, t, jnp.ones((), bool), now.threshold

    rise, site, t, found, threshold = lax.cond(loads, onward, stay)
    number, count = _begin(by, now, loads & found, site, rise)
    endings = [~found, ~ends, ~quiet, spanned]
    reasons = [SeriesStatus.NOTHING_LEFT, -1, SeriesStatus.LIMIT, SeriesStatus.SPANNED]
    now = now._replace(
        stress=now.stress + tables.per_load * rise,
        threshold=threshold,
        detached=jnp.where(quiet, -1, now.detached),  # what was detached has repinned, where it stood
        numbers=number,
        counts=count,
        ending=jnp.select(endings, reasons, SeriesStatus.DONE).astype(jnp.int32),
    )
    return now, site, t


def _rise(by: Loading, now: Now) -> tuple[Array, Array]:
    """By how much to raise the load, and whether that makes a contact break."""
    tables = by.contacts
    if by.ageing is None:
        pulled = tables.per_load > 0
        missing = jnp.where(pulled, (tables.threshold - now.stress) / jnp.where(pulled, tables.per_load, 1), jnp.inf)
    else:
        age = now.numbers[0] - _aged(now.born)
        missing = next_crossing(by.ageing, now.stress, tables.per_load, tables.threshold, age, by.velocity)
    rise = jnp.maximum(fold(jnp.minimum, missing).min(), 0)
    if by.step is not None:
        rise = jnp.maximum(jnp.ceil(rise / by.step - 1e4 * jnp.finfo(rise.dtype).eps), 1) * by.step
    found = jnp.isfinite(rise)
    return jnp.where(found, rise, 0), found


def _begin(by: Loading, now: Now, begins: Array, site: Array, rise: Array) -> tuple[Array, Array]:
    """Numbers and counts of a new event, if one begins."""
    number, count = Numbers(*now.numbers), Counts(*now.counts)
    force_before = number.force_before - number.force_lost  # the force now
    force = force_before + by.contacts.edge_stiffness * rise
    newer = at(now.last, jnp.maximum(site - 1, 0)) > at(now.last, site)
    zero = jnp.zeros_like(rise)
    fresh = Numbers(number.load + rise, force, (force_before + force) / 2 * rise, *(zero,) * 5)
    one = jnp.ones_like(count.number)
    counted = Counts(
        number=count.number + 1,
        first=site,
        creeps=(newer & (site > by.ahead)).astype(jnp.int32),
        left=one * by.sites,
        right=-one,
        breaks=one * 0,
        total=count.total,
    )
    return jnp.where(begins, jnp.stack(fresh), now.numbers), jnp.where(begins, jnp.stack(counted), now.counts)


def _aged(x: Array | None) -> Array:
    assert x is not None
    return x


def _break(by: Loading, now: Now, site: Array, t: Array) -> Now:
    """Break a contact that carries t; nothing if the series is over."""
    tables = by.contacts
    size = now.stress.shape[0]
    b, m = site // size, site % size
    moves = given_up(tables, now.stress, now.detached, site, t)
    stress, pinning, lost = moved(tables, now.stress, now.pinning, moves)
    threshold, born = now.threshold, now.born
    if by.ageing is not None:
        threshold = put(_aged(threshold), site, at(tables.threshold, site) * by.ageing.newborn)
        born = put(_aged(born), site, now.numbers[0])
    # what the broken contact's site moved by, as a stress of the contact
    followed = tables.near[b, m, m] * t if by.delay == 0 else moves[-1][2] - t
    energy = tables.energy[b, m] * t * jnp.stack([t, followed])
    count = Counts(*now.counts)
    return now._replace(
        stress=stress,
        threshold=threshold,
        born=born,
        pinning=pinning,
        last=put(now.last, site, count.number),
        detached=jnp.append(now.detached, site)[1:],
        numbers=now.numbers + jnp.concatenate([jnp.zeros(3, t.dtype), lost, energy]),
        counts=jnp.stack(
            count._replace(
                left=jnp.minimum(count.left, site),
                right=jnp.maximum(count.right, site),
                breaks=count.breaks + 1,
                total=count.total + 1,
            )
        ),
    )


def _record(by: Loading, now: Now, site: Array) -> Now:
    """Write down the event as it stands; its last break has the last word."""
    over, count = now.ending >= 0, Counts(*now.counts)
    row = jnp.where(over, by.events, count.number)
    log = now.log
    if by.recorded:
        place = jnp.where(over, by.recorded, jnp.minimum(count.total - 1, by.recorded))
        log = lax.dynamic_update_slice_in_dim(log, jnp.stack([site, count.number])[None], place, 0)
    return now._replace(
        number_table=lax.dynamic_update_slice_in_dim(now.number_table, now.numbers[None], row, 0),
        count_table=lax.dynamic_update_slice_in_dim(now.count_table, now.counts[None], row, 0),
        log=log,
    )


def recorded(by: Loading, end: Now) -> dict[str, Array]:
    """Columns of the catalogue."""
    number, count = Numbers(*end.number_table[:-1].T), Counts(*end.count_table[:-1].T)
    kinds = [count.number < 0, count.right == by.sites - 1, count.first == by.ahead, count.creeps == 1]
    kind = jnp.select(kinds, [-1, EventClass.SPANNING, EventClass.EDGE, EventClass.CREEP], EventClass.INTERIOR)
    return {
        "load": number.load,
        "force_before": number.force_before,
        "force_after": number.force_before - number.force_lost,
        "site": count.first - by.ahead,
        "leftmost": count.left - by.ahead,
        "extent": count.right + 1 - by.ahead,
        "breaks": count.breaks,
        "slip": number.slip,
        "stress_drop": number.stress_drop,
        "work": number.work,
        "stored": jnp.cumsum(number.work - number.broken - number.relaxed),
        "broken": number.broken,
        "relaxed": number.relaxed,
        "kind": kind.astype(jnp.int32),
        "number": (count.number >= 0).sum().astype(jnp.int32),
        "break_site": jnp.where(end.log[:-1, 1] >= 0, end.log[:-1, 0] - by.ahead, -1),
        "break_event": end.log[:-1, 1],
    }
