r"""Loading a chain from event to event: to the next break, the rupture, the record of it, and how contacts age.

Between events every stress grows linearly with the load, so that the next break is found exactly. In an event contacts break
one after another at a fixed load, the most overloaded first. All sums are updated from break to break; the chain is solved
afresh only at the end, to see what they have lost:

* a break at j that gives up the stress t_j adds q_i G_ij t_j to every stress (`slippulse_jax.lattice.response`);
* by reciprocity it lowers the force on the left edge by k t_j du_j/dU;
* it gives up the energy (k t_j)²/2k_j of the broken contact's own stretch, and (k t_j)(k t_j')/2k_j on top of it as the chain
  relaxes to equilibrium, t_j' being what the contact carries then;
* what the drive puts in beyond that is stored.

Stresses are known block by block (`slippulse_jax.lattice.blocks`), and a load reaches a block as all else does, through its
edges. For each block is kept the load before which no contact of it breaks: exact when the block was last opened, lowered by
what has arrived since. So the next break is found by opening the few blocks in which it may be, at O(√N) an event.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.lattice.ageing import Ageing, next_crossing
from slippulse_jax.lattice.blocks import Moves, Stresses, looked_at, most, opened, slack, whole
from slippulse_jax.lattice.breaks import Broken, run
from slippulse_jax.lattice.catalogue import EventClass, SeriesStatus
from slippulse_jax.lattice.contacts import Contacts
from slippulse_jax.lattice.response import Response


class Numbers(NamedTuple):
    """Of an event; recorded as one vector."""

    load: Array
    force_before: Array  # on the left edge, as it began
    work: Array
    force_lost: Array
    slip: Array
    stress_drop: Array
    broken: Array
    relaxed: Array
    length: Array  # ℓ, in λc from the first site


class Counts(NamedTuple):
    """Likewise, as whole numbers."""

    number: Array  # −1 before the first event
    first: Array  # site that broke first
    creeps: Array  # whether the contact left of it broke later than it did
    left: Array
    right: Array
    breaks: Array
    total: Array  # of breaks, in all events


class Tally(NamedTuple):
    """Of the event under way, break by break."""

    lost: Float[Array, "3"]  # what `Contacts.gains` says of the breaks
    broken: Array
    relaxed: Array
    first: Array  # −1 before the first break
    creeps: Array
    left: Array
    right: Array
    peak: Array  # stress on the rightmost as it broke, above its threshold
    total: Array
    last: Int[Array, " S"]
    log: Int[Array, "L+1 2"]


class Now(NamedTuple):
    """A series between two events; B blocks of M, S = BM sites. The last rows of tables are for what need not be kept."""

    stresses: Stresses
    soonest: Float[Array, " B"]  # no contact of a block breaks before this load
    given: Float[Array, "B M"]  # stress given up by each contact so far
    born: Float[Array, "B M"] | None  # where contacts age: load at the last break; −inf if never
    last: Int[Array, " S"]  # event of the last break; −1 if never
    numbers: Numbers  # of the last event
    counts: Counts
    ending: Int[Array, ""]  # a `SeriesStatus`, or −1
    number_table: Float[Array, "E+1 9"]
    count_table: Int[Array, "E+1 7"]
    log: Int[Array, "L+1 2"]  # site and event of every break


class Loading(NamedTuple):
    """What is done to the chain."""

    response: Response
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
    until: Array | None  # load with which the series ends; None: after all events


def start(by: Loading, prestress: Float[Array, "B M"], valid: Array) -> Now:
    """The relaxed chain."""
    zero, none = jnp.zeros((), prestress.dtype), jnp.zeros((), jnp.int32)
    return Now(
        stresses=whole(prestress, by.contacts.threshold),
        soonest=jnp.full_like(prestress[:, 0], -jnp.inf),
        given=jnp.zeros_like(prestress),
        born=jnp.full_like(prestress, -jnp.inf) if by.ageing is not None else None,
        last=jnp.full(prestress.size, -1, jnp.int32),
        numbers=Numbers(*(zero,) * len(Numbers._fields)),
        counts=Counts(*(none,) * 7)._replace(number=none - 1),
        ending=jnp.where(valid, -1, SeriesStatus.INVALID).astype(jnp.int32),
        number_table=jnp.full((by.events + 1, len(Numbers._fields)), jnp.nan, prestress.dtype),
        count_table=jnp.tile(jnp.array([-1, by.ahead - 1, 0, by.ahead - 1, by.ahead - 1, 0, 0], jnp.int32), (by.events + 1, 1)),
        log=jnp.full((by.recorded + 1, 2), -1, jnp.int32),
    )


def load_through(by: Loading, now: Now) -> Now:
    """Event after event."""
    return lax.while_loop(lambda now: now.ending < 0, partial(_next_event, by), now)


def _next_event(by: Loading, now: Now) -> Now:
    """Raise the load to the next break, let the rupture run, and write it down."""
    tables, before = by.contacts, now.numbers
    found = _next_crossing(by, now)
    rise, trigger = _raised(by, found)
    load, number = before.load + rise, now.counts.number + 1
    stresses = found.stresses._replace(inbox=found.stresses.inbox + by.response.at_load * rise)
    broken = _rupture(by, now, stresses, load, trigger)
    tally, begins = broken.book, jnp.isfinite(found.rise)
    force_before = before.force_before - before.force_lost  # the force now
    force = force_before + tables.edge_stiffness * rise
    work = (force_before + force) / 2 * rise
    force_lost, slip, stress_drop = tally.lost
    length = _length(by, now, broken, load)
    numbers = Numbers(load, force, work, force_lost, slip, stress_drop, tally.broken, tally.relaxed, length)
    counts = Counts(number, tally.first, tally.creeps, tally.left, tally.right, broken.breaks, tally.total)
    over = (broken.breaks >= by.max_breaks) & (broken.overload >= 0)
    last = number == by.events - 1
    if by.until is not None:
        last = last | (load >= by.until)
    endings = [~begins, over, by.stop_when_spanning & (counts.right == by.sites - 1), last]
    reasons = [SeriesStatus.NOTHING_LEFT, SeriesStatus.LIMIT, SeriesStatus.SPANNED, SeriesStatus.DONE]
    row = jnp.where(begins, number, by.events)
    anew = jnp.isinf(broken.arrived[:, 0])
    sooner = (jnp.where(anew[:, None], 0, broken.arrived) * tables.hastened).sum(-1) * slack(rise)
    return Now(
        stresses=broken.stresses,
        soonest=jnp.where(anew, -jnp.inf, found.soonest - sooner),
        given=broken.given,
        born=None if now.born is None else jnp.where(broken.given > now.given, load, now.born),
        last=tally.last,
        numbers=numbers,
        counts=counts,
        ending=jnp.select(endings, reasons, -1).astype(jnp.int32),
        number_table=lax.dynamic_update_slice_in_dim(now.number_table, jnp.stack(numbers)[None], row, 0),
        count_table=lax.dynamic_update_slice_in_dim(now.count_table, jnp.stack(counts)[None], row, 0),
        log=tally.log,
    )


class Crossing(NamedTuple):
    """The search for the next contact to reach its threshold."""

    stresses: Stresses
    soonest: Float[Array, " B"]
    looked: Array  # whether a block has been opened, shape (B,)
    rise: Float[Array, ""]  # smallest increase of load found
    site: Int[Array, ""]  # which contact it brings to its threshold


def _next_crossing(by: Loading, now: Now) -> Crossing:
    """By how much to raise the load to the next break, and of which contact; inf if there is none."""
    tables, size, load = by.contacts, now.given.shape[1], now.numbers.load

    def going(c: Crossing) -> Array:
        lowest = jnp.where(c.looked, jnp.inf, c.soonest).min()
        return (lowest < jnp.inf) & (lowest <= (load + c.rise) * slack(load))

    def look(c: Crossing) -> Crossing:
        block = most(jnp.where(c.looked, -jnp.inf, -c.soonest))[0]
        stress, per_load = opened(by.response, c.stresses, block), tables.per_load[block]
        limit, _ = _limits(by, now, now.given, load, block, now.given[block])
        pulled = per_load > 0
        missing = jnp.where(pulled, (limit - stress) / jnp.where(pulled, per_load, 1), jnp.inf)
        rises = missing
        if now.born is not None and by.ageing is not None:
            ages = load - now.born[block]
            rises = next_crossing(by.ageing, stress, per_load, tables.threshold[block], ages, by.velocity)
        place, rise = most(-rises)
        better = -rise < c.rise
        return Crossing(
            stresses=looked_at(by.response, c.stresses, block, (stress - limit).max()),
            soonest=c.soonest.at[block].set(load + missing.min()),  # thresholds only grow: a bound where they do
            looked=c.looked.at[block].set(True),
            rise=jnp.where(better, -rise, c.rise),
            site=jnp.where(better, block * size + place, c.site),
        )

    never, none = jnp.full_like(load, jnp.inf), jnp.zeros((), jnp.int32)
    return lax.while_loop(going, look, Crossing(now.stresses, now.soonest, jnp.zeros(now.soonest.shape, bool), never, none))


def _raised(by: Loading, found: Crossing) -> tuple[Array, Array]:
    """By how much the load is raised, and the contact that breaks first even if rounding leaves it short; −1 for none."""
    rise = jnp.maximum(found.rise, 0)
    trigger = jnp.where(jnp.isfinite(rise), found.site, -1)
    if by.step is not None:
        close = 1e4 * jnp.finfo(rise.dtype).eps
        whole_steps = jnp.maximum(jnp.ceil(rise / by.step - close), 1) * by.step
        trigger = jnp.where(whole_steps > rise + close * by.step, -1, trigger)  # beyond it, the most overloaded
        rise = whole_steps
    return jnp.where(jnp.isfinite(found.rise), rise, 0), trigger


def _limits(by: Loading, now: Now, before: Array, load: Array, block: Array, given: Array) -> tuple[Array, Array]:
    """Thresholds in a block at this load, and of its contacts that break at it."""
    old = by.contacts.threshold[block]
    if now.born is None or by.ageing is None:
        return old, old
    born = jnp.where(given > before[block], load, now.born[block])
    return old * by.ageing.strength(load - born, by.velocity), old * by.ageing.newborn


def _length(by: Loading, now: Now, broken: Broken, load: Array) -> Array:
    """ℓ of the event: where the stress, on a straight line between the rightmost contact and the one ahead, is the threshold.

    Of the one it is the stress as it broke, of the other as the event ends (`slippulse_jax.lattice.front`); inf where none is
    ahead.
    """
    right, peak = broken.book.right, broken.book.peak
    block, place = jnp.divmod(jnp.minimum(right + 1, by.sites - 1), broken.given.shape[1])
    limit, _ = _limits(by, now, now.given, load, block, broken.given[block])
    ahead = opened(by.response, broken.stresses, block)[place] - limit[place]
    return jnp.where(right == by.sites - 1, jnp.inf, right + peak / (peak - ahead))


def _limit_of(by: Loading, now: Now, load: Array, site: Array, anew: Array) -> Array:
    """Threshold of one contact at this load; `anew` if it broke at it before."""
    old = by.contacts.threshold.reshape(-1)[site]
    if now.born is None or by.ageing is None:
        return old
    aged = by.ageing.strength(load - now.born.reshape(-1)[site], by.velocity)
    return old * jnp.where(anew, by.ageing.newborn, aged)


def _rupture(by: Loading, now: Now, stresses: Stresses, load: Array, trigger: Array) -> Broken:
    """The breaks of one event, counted."""
    energy, number = by.contacts.energy.reshape(-1), now.counts.number + 1
    gains = by.contacts.gains.reshape(-1, 3)

    def note(tally: Tally, moves: Moves, t: Array, after: Array) -> Tally:
        site, log, lost = moves.sites[-1], tally.log, tally.lost
        if by.recorded:
            entry = jnp.stack([site, number])[None]
            log = lax.dynamic_update_slice_in_dim(log, entry, jnp.minimum(tally.total, by.recorded), 0)
        for j in range(moves.sites.shape[0]):
            lost = lost + gains[moves.sites[j]] * moves.given[j]
        stretch, begins = energy[site] * t, tally.first < 0
        peak = jnp.maximum(t - _limit_of(by, now, load, site, tally.last[site] == number), 0)
        newer = (site > by.ahead) & (tally.last[jnp.maximum(site - 1, 0)] > tally.last[site])
        return Tally(
            lost=lost,
            broken=tally.broken + stretch * t,
            relaxed=tally.relaxed + stretch * after,
            first=jnp.where(begins, site, tally.first),
            creeps=jnp.where(begins, newer.astype(jnp.int32), tally.creeps),
            left=jnp.minimum(tally.left, site),
            right=jnp.maximum(tally.right, site),
            peak=jnp.where(site >= tally.right, peak, tally.peak),
            total=tally.total + 1,
            last=tally.last.at[site].set(number),
            log=log,
        )

    zero, none = jnp.zeros((), load.dtype), jnp.zeros((), jnp.int32)
    places = none - 1, none, none + by.sites, none - 1
    tally = Tally(jnp.zeros(3, load.dtype), zero, zero, *places, zero, now.counts.total, now.last, now.log)
    limits = partial(_limits, by, now, now.given, load)
    return run(by.max_breaks, by.delay, by.response, stresses, now.given, limits, trigger, tally, note)


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
        "length": number.length - by.ahead,
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
