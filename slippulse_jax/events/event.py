"""One event of any body: contacts break one after another at a fixed load, the most overloaded first.

A break changes every stress by a known amount (`slippulse_jax.bodies.response`). Within the block of the broken contact the
stresses are updated at once. Every other block only adds up what arrives at its edges, and bounds its largest overload by

    overload ≤ (largest overload when the block was last opened) + (arrived) · (largest reading of a contact).

To open a block is to compute its current stresses. The most overloaded contact of the body is found by opening a few blocks.
The contacts of one block then break one after another, in a *burst*, until another block might hold a more overloaded contact.
The order of breaks is exactly the same as if all contacts were checked after every break; the cost is O(√N) per break or less.
A body whose response is a matrix is a single block.

Where the threshold of a contact follows its pressure, a break changes that too, by one more known amount: a contact breaks
where its stress reaches threshold times pressure, and releases the stress. The first contact whose pressure is used up lifts
off, which ends the event.

A contact may repin some breaks after it broke. Until then it is detached and carries no stress: its pinning point follows the
layer. Each break therefore moves the pinning points of all detached contacts such that their stress stays zero.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax.bodies.pressed import Pressed, balance, frozen
from slippulse_jax.bodies.response import Response, carried, within
from slippulse_jax.bulk.compiler import solve_without_pivots
from slippulse_jax.front.front import REACHED, EventKind, end_of_front

SLACK_DIGITS = 4096
"""Units in the last place by which a bound is raised: more than the rounding of thousands of positive terms."""

BREAKS_PER_SITE = 50
"""Breaks per contact after which an event is given up."""
LOST = 1e-6
"""Pressure, over the initial one, below which a contact has lost it: by then its threshold shrinks with every break."""
MORE_SITES = 4
"""Factor by which the sites resolved grow while an event reaches the last of them: each number is a program to compile."""


class Relaxed(NamedTuple):
    """A body before it is loaded; stresses in σ_s."""

    response: Response
    threshold: Float[Array, "*B M"]  # of contacts that never broke; inf where there is none
    prestress: Float[Array, "*B M"]  # the only stress
    stiffness: Array | float = 1.0  # k, in K
    last: Int[Array, ""] | int = -1  # index of the last contact, or of the last one resolved
    valid: Bool[Array, ""] | bool = True  # whether all numbers lie in their domains
    driver: int = 0  # sites before those of the body: the driver's
    pressed: Pressed | None = None  # where stiffness and threshold follow the pressure; stresses are then stretches, in u_s
    alike: Bool[Array, ""] | bool = False  # whether neighbouring contacts are: a first event ends on a curve


class Contacts(NamedTuple):
    """Contacts of B blocks, or of one; stresses in σ_s."""

    stress: Float[Array, "*B M"]  # when their block was last opened
    threshold: Float[Array, "*B M"]  # now; inf where there is no contact
    released: Float[Array, "*B M"]  # stress released in the event: how far the pinning point moved, as a stress
    overload: Float[Array, "*B M"]  # excess over the threshold as the contact first broke
    times: Int[Array, "*B M"]  # how often it broke
    turn: Int[Array, "*B M"]  # breaks before it first broke; −1 if it did not
    pressure: Float[Array, "*B M"] | None = None  # over the initial one, where thresholds follow it

    @property
    def excess(self) -> Array:
        """How far each is over its threshold; of one contact too."""
        return overload(self.stress, self.threshold, self.pressure)


def overload(stress: Array, threshold: Array, pressure: Array | None) -> Array:
    """How far contacts are over their threshold, which follows the pressure where there is one."""
    if pressure is None:
        return stress - threshold
    return stress - threshold * jnp.maximum(pressure, jnp.finfo(stress.dtype).tiny)  # of threshold inf too


class Nucleation(NamedTuple):
    """Contacts of one block as the first of them reaches its threshold."""

    first: Int[Array, ""]
    load: Array
    stress: Float[Array, " N"]  # in σ_s; of a `Pressed` body the stretch in u_s
    pressure: Float[Array, " N"] | None  # over the initial one, where anything follows it
    response: Response  # what breaks do from here on


class Record(NamedTuple):
    """Record of the breaks of an event."""

    breaks: Int[Array, ""]
    stretched: Float[Array, ""]  # Σ t² (k/k_i) over the breaks: twice the energy of the broken contacts' stretch over k
    relaxed: Float[Array, ""]  # Σ t t' (k/k_i), with t' the stress on the contact after its break
    ended: Bool[Array, ""]  # whether the contact broke that ends the event, or one lifted off
    order: Int[Array, " L+1"] | None  # sites in order of breaking, −1 where none; the last entry is scratch space
    each: Float[Array, " L+1"] | None  # stress each break released


class Event(NamedTuple):
    """State of an event."""

    contacts: Contacts
    inbox: Float[Array, "B 4"]  # displacements that have arrived at each block's edges since it was opened
    worst: Float[Array, " B"]  # largest overload of each block when it was last opened
    record: Record

    @property
    def broken(self) -> Bool[Array, " N"]:
        """Whether each contact broke."""
        return self.contacts.times.reshape(-1) > 0

    @property
    def rightmost(self) -> Int[Array, ""]:
        """Rightmost contact that broke; −1 if none did."""
        return largest(jnp.where(self.contacts.times > 0, self._sites, -1)).max()

    @property
    def leftmost(self) -> Int[Array, ""]:
        """Leftmost contact that broke; N if none did."""
        return -largest(jnp.where(self.contacts.times > 0, -self._sites, -self._sites.size)).max()

    @property
    def _sites(self) -> Int[Array, "B M"]:
        return jnp.arange(self.contacts.times.size, dtype=jnp.int32).reshape(self.contacts.times.shape)

    def length(self, excess: Float[Array, " N"], last: int | Array, alike: bool | Array = False) -> Float[Array, ""]:
        """ℓ: where a curve of the excess over the threshold, through the last contacts that broke, falls to zero.

        The excess is that after the event; of those contacts, as they broke for the *first* time, as the front passed. By that
        of a later break ℓ would fall where the event becomes larger: a contact that just breaks again has no overload. If all
        are `alike` the curve reaches back over those that broke after all to their left; a straight line if one broke again.
        """
        at, over, degree = self.front_of(alike)
        return self.end(at, over, excess[jnp.minimum(at + 1, last)], degree)

    def front_of(self, alike: bool | Array) -> tuple[Array, Float[Array, " R"], Array]:
        """Rightmost contact that broke, overloads of those before it, the nearest first, and the degree of the curve."""
        at, turn = jnp.maximum(self.rightmost, 0), self.contacts.turn.reshape(-1)
        reached = at - jnp.arange(REACHED - 1, dtype=at.dtype)
        in_turn = (turn >= 0) & (turn == lax.cummax(turn)) & alike & (self.contacts.times.max() <= 1)
        degree = jnp.cumprod(in_turn[reached] & (reached >= 0)).sum()
        return at, self.contacts.overload.reshape(-1)[jnp.maximum(reached, 0)], jnp.maximum(degree, 1)

    @staticmethod
    def end(at: Array, over: Float[Array, " R"], excess: Array, degree: Array) -> Float[Array, ""]:
        """ℓ from the overloads of contact `at` and those before it as they broke, and the excess on the next one."""
        # rounding may leave a contact that was made to break just below its threshold
        excess, nearest = jnp.minimum(excess, 0), jnp.maximum(over[0], 0)
        return end_of_front((at + 1).astype(over.dtype), (excess, nearest, *over[1:]), degree)


class Turn(NamedTuple):
    """An event between two bursts, or between two breaks where contacts repin after a delay."""

    event: Event
    detached: Int[Array, " n"]  # contacts that have not repinned yet, the last broken last; −1 for none
    bound: Float[Array, " B"]  # largest overload that each block may hold
    block: Int[Array, ""]  # the one to be opened next


def event(
    response: Response,
    stress: Float[Array, "B M"],
    threshold: Float[Array, "B M"],
    *,
    limit: int | Array,
    renewed: Float[Array, "B M"] | None = None,
    trigger: int | Array = -1,
    last: int | Array = -1,
    delay: int = 0,
    pressure: Float[Array, "B M"] | None = None,
    log: tuple[Int[Array, " L+1"], Float[Array, " L+1"], int | Array] | None = None,
) -> Event:
    """Break contacts until none is at its threshold, `limit` have broken, or contact `last` has.

    Thresholds are inf where there is no contact, and `renewed` once it has broken. The contact `trigger` breaks first, whatever
    its overload; −1, like that of `last`, for none. A broken contact stays detached for `delay` breaks: then every break
    updates all stresses, in O(N). The pressure, over the initial one, is that before the event, where thresholds follow it;
    without a delay. `log` is arrays for the sites in order of breaking and what each released, and the place of the first
    break.
    """
    renewed = threshold if renewed is None else renewed
    none, zero = jnp.zeros((), jnp.int32), jnp.zeros((), stress.dtype)
    order, each, logged = (None, None, 0) if log is None else log
    record = Record(none, zero, zero, jnp.zeros((), bool), order, each)
    empty = jnp.zeros_like(stress)
    never = jnp.zeros(stress.shape, jnp.int32)
    contacts = Contacts(stress, threshold, empty, empty, never, never - 1, pressure)
    start = Event(contacts, jnp.zeros((stress.shape[0], 4), stress.dtype), largest(contacts.excess), record)
    trigger, last = jnp.asarray(trigger, jnp.int32), jnp.asarray(last, jnp.int32)

    def broken(
        contacts: Contacts, record: Record, place: Array, block: Array | int, t: Array, over: Array, after: Array
    ) -> tuple[Contacts, Record]:
        """Record the break of one contact of a block: `over` its threshold, it released t and now carries `after`."""
        site = block * contacts.times.size + place
        over = jnp.where(contacts.times[place] == 0, over, contacts.overload[place])
        turn = jnp.where(contacts.times[place] == 0, record.breaks, contacts.turn[place])
        if record.order is not None and record.each is not None:
            row = jnp.minimum(logged + record.breaks, record.order.size - 1)
            record = record._replace(order=record.order.at[row].set(site), each=record.each.at[row].set(t))
        soft = response.soft.reshape(-1)[site] * t
        return contacts._replace(
            threshold=contacts.threshold.at[place].set(renewed.reshape(-1)[site]),
            overload=contacts.overload.at[place].set(over),
            times=contacts.times.at[place].add(1),
            turn=contacts.turn.at[place].set(turn),
        ), record._replace(
            breaks=record.breaks + 1,
            stretched=record.stretched + soft * t,
            relaxed=record.relaxed + soft * after,
            ended=(site == last) | (False if contacts.pressure is None else (contacts.pressure < 0).any()),
        )

    def next_turn(event: Event, detached: Array) -> Turn:
        bound = event.worst + (event.inbox * response.reach).sum(-1) * _slack(stress)
        block = jnp.where(forced(event.record), trigger // size, most(bound)[0])
        return Turn(event, detached, bound, block)

    def forced(record: Record) -> Array:
        return (trigger >= 0) & (record.breaks == 0)

    def going(turn: Turn) -> Array:
        record = turn.event.record
        return (forced(record) | (turn.bound.max() >= 0)) & (record.breaks < limit) & ~record.ended

    def burst(response: Response, turn: Turn) -> Turn:
        return next_turn(_burst(response, turn, trigger, limit, broken), turn.detached)

    blocks, size = stress.shape
    begin = next_turn(start, jnp.full(delay, -1, jnp.int32))
    if delay:
        return lax.while_loop(going, lambda turn: next_turn(*_one_break(response, turn, trigger, broken)), begin).event
    if response.near.shape[0]:
        return lax.while_loop(going, partial(burst, response), begin).event

    def in_known_blocks(carry: tuple[Array, Array, Turn]) -> tuple[Array, Array, Turn]:
        """Compute the response within the block to be opened, and go on until another one must be computed."""
        near, known, turn = carry
        assert response.links is not None
        within_block = within(*(x[turn.block] for x in response.links))
        near, known = near.at[turn.block].set(within_block), known.at[turn.block].set(True)
        here = partial(burst, response._replace(near=near))
        return near, known, lax.while_loop(lambda turn: going(turn) & known[turn.block], here, turn)

    unknown = jnp.zeros((blocks, size, size), stress.dtype), jnp.zeros(blocks, bool)
    return lax.while_loop(lambda carry: going(carry[2]), in_known_blocks, (*unknown, begin))[2].event


def rises(push: Array, threshold: Array, stress: Array, pressure: Array | None = None, relief: Array | None = None) -> Array:
    """Rise of the load that brings each contact to its threshold; inf where none does, or there is no contact.

    `push` is stress per load; `pressure` that now, where thresholds follow it, and `relief` what each contact loses of it per
    load.
    """
    if pressure is not None and relief is not None:
        weak = jnp.where(jnp.isfinite(threshold), threshold, 0)
        push, threshold = push + weak * relief, jnp.where(weak > 0, weak * pressure, threshold)
    return jnp.where(push > 0, (threshold - stress) / jnp.where(push > 0, push, 1), jnp.inf)


def nucleated(body: Relaxed) -> Nucleation:
    """Load a body of one block until a contact is at its threshold."""
    response, threshold, prestress = body[:3]
    if body.pressed is not None:
        found = balance(body.pressed, threshold, prestress, 0 * prestress, 0 * prestress[0])
        return Nucleation(found.first, found.load, found.stretch, found.pressure, frozen(body.pressed, found))
    push, relief = response.push[0], None if response.push_relief is None else response.push_relief[0]
    needed = rises(push, threshold, prestress, jnp.ones_like(threshold), relief)
    first = jnp.argmin(needed)
    load = needed[first]
    return Nucleation(first, load, prestress + load * push, None if relief is None else 1 - load * relief, response)


def first_event(
    body: Relaxed, limit: Int[Array, ""] | int | None = None, kind: EventKind = "domino"
) -> tuple[Event, Nucleation]:
    """Load a body of one block until a contact is at its threshold; break contacts until none is, or the last has broken.

    In the first front no contact breaks again. The event is given up after `limit` breaks, at least one.
    """
    start = nucleated(body)
    return event_from(start, body, limit, kind), start


def event_from(
    start: Nucleation,
    body: Relaxed,
    limit: Int[Array, ""] | int | None = None,
    kind: EventKind = "domino",
    *,
    logged: bool = False,
) -> Event:
    """The event that a nucleation begins (see `first_event`); with `logged`, its record has the order of breaks."""
    threshold, sites = body.threshold, body.threshold.size
    most = BREAKS_PER_SITE * sites
    follows = start.response.relief is not None and start.pressure is not None
    return event(
        start.response,
        start.stress[None],
        threshold[None],
        limit=most if limit is None else limit,
        renewed=None if kind == "full" else jnp.full((1, sites), jnp.inf, start.stress.dtype),
        trigger=start.first,
        last=jnp.asarray(body.last) % sites,
        pressure=start.pressure[None] if follows and start.pressure is not None else None,
        log=(jnp.full(most + 1, -1, jnp.int32), jnp.zeros(most + 1, threshold.dtype), 0) if logged else None,
    )


def slopes_of_length(
    found: Event, start: Nucleation, threshold: Float[Array, " N"], alike: bool | Array
) -> tuple[Array | None, ...]:
    """Derivatives of ℓ at a fixed order of breaks, in the stress, the transfer, the pressure, its relief and the threshold.

    Of a logged event of a body of one block; `alike` as for its length. From the last break back to the first, λ is the
    derivative in the stress on each contact, and ρ that in its pressure: a break of contact o that released t set the stress on
    it to zero, added G_oi t to that on contact i, and took Q_oi t of the pressure.
    """
    record, contacts = found.record, jax.tree.map(lambda x: x[0], found.contacts)
    order, each, G = record.order, record.each, start.response.near[0]
    assert order is not None
    assert each is not None
    Q = None if contacts.pressure is None or start.response.relief is None else start.response.relief[0]
    at, over, degree = found.front_of(alike)
    ahead, none = jnp.minimum(at + 1, threshold.size - 1), jnp.zeros_like(threshold)
    of_over, of_short = jax.grad(found.end, (1, 2))(at, over, contacts.excess[ahead], degree)
    # of every contact that broke: what its overload as the front passed is to ℓ, and when that was
    reached = at - jnp.arange(over.size, dtype=at.dtype)
    of_over, reached = jnp.where(reached >= 0, of_over, 0), jnp.maximum(reached, 0)
    passed = jnp.argmax(order[None] == reached[:, None], axis=1).astype(jnp.int32)
    weak, short = threshold[reached], threshold[ahead]  # all can break
    of_threshold = none.at[reached].add(-of_over * (each[passed] - over) / weak)
    of_threshold = of_threshold.at[ahead].add(-of_short * (1 if contacts.pressure is None else contacts.pressure[ahead]))

    def back(state: tuple) -> tuple:
        number, of_stress, of_transfer, of_pressure, of_relief = state
        site, t, front = order[number], each[number], jnp.where(number == passed, of_over, 0)
        of_t = G[site] @ of_stress + front.sum()
        of_transfer = of_transfer.at[site].add(of_stress * t)
        if Q is not None:
            of_t = of_t - Q[site] @ of_pressure
            of_relief = of_relief.at[site].add(-of_pressure * t)
            of_pressure = of_pressure.at[site].add(-(front * weak).sum())
        return number - 1, of_stress.at[site].set(of_t), of_transfer, of_pressure, of_relief

    pressed = (None, None) if Q is None else (none.at[ahead].add(-of_short * short), jnp.zeros_like(Q))
    begin = record.breaks - 1, none.at[ahead].add(of_short), jnp.zeros_like(G), *pressed
    slopes = lax.while_loop(lambda state: state[0] >= 0, back, begin)[1:]
    return *slopes, of_threshold


def stresses(response: Response, event: Event) -> Float[Array, " N"]:
    """Compute the current stresses of all blocks."""
    read = sum(event.inbox[:, k, None] * response.read[:, k] for k in range(4))  # written out: arithmetic on rows
    return (event.contacts.stress + read).reshape(-1)


def most(x: Float[Array, "*B M"]) -> tuple[Array, Array]:
    """Return site and value of the largest entry of one block, or of several; the first of equals."""
    if x.ndim == 2:
        block, value = most(largest(x))
        return block * x.shape[1] + most(x[block])[0], value
    value = x.max()
    return jnp.argmax(x == value).astype(jnp.int32), value


def largest(x: Array) -> Array:
    """Largest entry of each block, by halves: unlike a plain reduction, this compiles to vector instructions."""
    while x.shape[-1] > 1 and x.shape[-1] % 2 == 0:
        half = x.shape[-1] // 2
        x = jnp.maximum(x[..., :half], x[..., half:])
    return x.max(-1)


# --- bursts --------------------------------------------------------------------------------------------------------------

Broken = Callable[[Contacts, Record, Array, Array | int, Array, Array, Array], tuple[Contacts, Record]]


def _slack(like: Array) -> float:
    """Factor by which a bound is raised to cover rounding."""
    return 1 + SLACK_DIGITS * float(jnp.finfo(like.dtype).eps)


def _burst(response: Response, turn: Turn, trigger: Array, limit: int | Array, broken: Broken) -> Event:
    """Open a block, and break its contacts until another block might hold a more overloaded one."""
    event, _, bound, block = turn
    near, size = response.near, event.contacts.times.shape[1]
    others = jnp.where(jnp.arange(bound.size, dtype=jnp.int32) == block, -jnp.inf, bound).max()
    spill = response.spill[block] * _slack(bound)
    sites = jnp.arange(size, dtype=jnp.int32)
    here = jax.tree.map(lambda x: x[block], event.contacts)
    here = here._replace(stress=here.stress + (event.inbox[block][:, None] * response.read[block]).sum(0))
    forced = (trigger >= 0) & (event.record.breaks == 0)
    site, most_over = most(here.excess)

    def going(carry: tuple) -> Array:
        _, record, _, over, left = carry
        sure = (over >= 0) & (over >= others + (left * spill).sum())
        return (sure | (forced & (record.breaks == 0))) & (record.breaks < limit) & ~record.ended

    def step(carry: tuple) -> tuple:
        here, record, site, _, left = carry
        t, over = here.stress[site], jax.tree.map(lambda x: x[site], here).excess
        stress = jnp.where(sites == site, 0, here.stress) + near[block, site] * t
        here = here._replace(stress=stress, released=here.released.at[site].add(t))
        if response.relief is not None and here.pressure is not None:
            here = here._replace(pressure=here.pressure - response.relief[block, site] * t)
        here, record = broken(here, record, site, block, t, over, stress[site])
        return here, record, *most(here.excess), left + response.leave[block, site] * t

    begin = here, event.record, jnp.where(forced, trigger % size, site), most_over, jnp.zeros_like(spill)
    here, record, _, most_over, left = lax.while_loop(going, step, begin)
    return Event(
        contacts=jax.tree.map(lambda x, y: x.at[block].set(y), event.contacts, here),
        inbox=event.inbox.at[block].set(0) + carried(response, block, left),
        worst=event.worst.at[block].set(most_over),
        record=record,
    )


# --- with a delay --------------------------------------------------------------------------------------------------------


def _one_break(response: Response, turn: Turn, trigger: Array, broken: Broken) -> tuple[Event, Int[Array, " n"]]:
    """Break the most overloaded contact and move the pinning points of all detached ones, with every block open."""
    event, detached, _, block = turn
    blocks, size = event.contacts.times.shape
    place = most(event.contacts.excess[block])[0]
    forced = (trigger >= 0) & (event.record.breaks == 0)
    site = jnp.where(forced, trigger, block * size + place)
    moving = jnp.append(detached, site)[1:]  # the contact detached longest repins, where it is
    there = moving >= 0
    contacts = jax.tree.map(lambda x: x.reshape(-1), event.contacts)
    columns = jax.vmap(partial(column, response))(jnp.maximum(moving, 0))
    green = jnp.where(there[:, None] & there[None], columns[:, jnp.maximum(moving, 0)], 0)
    t, over = contacts.stress[site], jax.tree.map(lambda x: x[site], contacts).excess
    unit = jnp.eye(moving.size, dtype=t.dtype)
    given = solve_without_pivots(unit - green.T, unit[-1] * t)  # what each releases, so that none carries any stress
    stress, released = contacts.stress + given @ columns, contacts.released
    for j in range(moving.size):
        stress, released = stress.at[moving[j]].add(-given[j]), released.at[moving[j]].add(given[j])
    # of the broken contact, the displacement of its site as a stress
    contacts = contacts._replace(stress=stress, released=released)
    contacts, record = broken(contacts, event.record, site, 0, t, over, given[-1] - t)
    contacts = jax.tree.map(lambda x: x.reshape(blocks, size), contacts)
    return Event(contacts, event.inbox, largest(contacts.excess), record), moving


def column(response: Response, site: Array) -> Float[Array, " N"]:
    """Stress on every contact per stress released at one, its own pinning point apart."""
    size = response.near.shape[1]
    block, place = site // size, site % size
    far = (carried(response, block, response.leave[block, place])[:, :, None] * response.read).sum(1)
    return far.at[block].add(response.near[block, place]).reshape(-1)
