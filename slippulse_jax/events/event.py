"""One event of any body: contacts break in turn, load fixed.

The most overloaded breaks next. A break changes the readings of every contact by a known amount, as in
`slippulse_jax.bodies.response`: its stress and, where its threshold follows the pressure, that too. A contact breaks where its
stress reaches threshold times pressure, its strength. It keeps a share r of that, in the paper none, and releases the rest. The
first whose pressure is used up lifts off, which ends the event.

A contact may repin some breaks after it broke. Until then it is detached and carries what it kept: its pinning point follows
the layer. Each break therefore moves the pinning points of all detached contacts such that their stress stays the same.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax.bodies.response import Response
from slippulse_jax.bulk.compiler import solve_without_pivots
from slippulse_jax.front.front import REACHED, end_of_front

BREAKS_PER_SITE = 50
"""Breaks per contact after which an event is given up."""
LOST = 1e-6
"""Pressure, over the initial one, below which a contact has lost it: by then its threshold shrinks with every break."""
MORE_SITES = 4
"""Factor by which the sites resolved grow while an event reaches the last of them: each number is a program to compile."""


class Event(NamedTuple):
    """State of an event of N contacts; stresses in σ_s."""

    readings: Float[Array, "r N"]  # stress; and pressure over the initial one, where thresholds follow it
    threshold: Float[Array, " N"]  # now; inf where there is no contact
    released: Float[Array, " N"]  # stress released in the event: how far the pinning point moved, as a stress
    overload: Float[Array, " N"]  # excess over the threshold as the contact first broke
    times: Int[Array, " N"]  # how often it broke
    turn: Int[Array, " N"]  # breaks before it first broke; −1 if it did not
    breaks: Int[Array, ""]
    stretched: Float[Array, ""]  # Σ (t² − t_r²)(k/k_i) over the breaks, from t to t_r: twice the energy of stretch over k
    # Σ (t − t_r)(t' − t_r)(k/k_i), with t' the stress on the contact after its break; and what detached contacts rub, twice
    # their stress times how far their pinning points follow the layer
    relaxed: Float[Array, ""]
    order: Int[Array, " L+1"]  # sites in order of breaking, −1 where none; the last entry is scratch space
    each: Float[Array, " L+1"]  # stress each break released

    @property
    def stress(self) -> Float[Array, " N"]:
        """Stress on every contact."""
        return self.readings[0]

    @property
    def pressure(self) -> Float[Array, " N"] | None:
        """Pressure of every contact over the initial one, where thresholds follow it."""
        return self.readings[1] if len(self.readings) > 1 else None

    @property
    def excess(self) -> Float[Array, " N"]:
        """How far each contact is over its threshold."""
        return overload(self.readings, self.threshold)

    @property
    def broken(self) -> Bool[Array, " N"]:
        """Whether each contact broke."""
        return self.times > 0

    @property
    def rightmost(self) -> Int[Array, ""]:
        """Rightmost contact that broke; −1 if none did."""
        return jnp.where(self.broken, jnp.arange(self.times.size, dtype=jnp.int32), -1).max()

    @property
    def leftmost(self) -> Int[Array, ""]:
        """Leftmost contact that broke; N if none did."""
        return jnp.where(self.broken, jnp.arange(self.times.size, dtype=jnp.int32), self.times.size).min()

    def length(self, excess: Float[Array, " N"], last: int | Array, alike: bool | Array = False) -> Float[Array, ""]:
        """ℓ: zero of the excess, by a curve through the last breaks.

        The excess is that after the event; of their contacts, as they broke for the *first* time, as the front passed. By that
        of a later break ℓ would fall where the event becomes larger: a contact that just breaks again has no overload. If all
        are `alike` the curve reaches back over those that broke after all to their left; a straight line if one broke again.
        """
        at, over, degree = self.front_of(alike)
        return self.end(at, over, excess[jnp.minimum(at + 1, last)], degree)

    def front_of(self, alike: bool | Array) -> tuple[Array, Float[Array, " R"], Array]:
        """Rightmost broken contact, overloads back from it, and degree of the curve."""
        at = jnp.maximum(self.rightmost, 0)
        reached = at - jnp.arange(REACHED - 1, dtype=at.dtype)
        in_turn = (self.turn >= 0) & (self.turn == lax.cummax(self.turn)) & alike & (self.times.max() <= 1)
        degree = jnp.cumprod(in_turn[reached] & (reached >= 0)).sum()
        return at, self.overload[jnp.maximum(reached, 0)], jnp.maximum(degree, 1)

    @staticmethod
    def end(at: Array, over: Float[Array, " R"], excess: Array, degree: Array) -> Float[Array, ""]:
        """ℓ from overloads back from contact `at`, and the next one's excess."""
        # rounding may leave a contact that was made to break just below its threshold
        excess, nearest = jnp.minimum(excess, 0), jnp.maximum(over[0], 0)
        return end_of_front((at + 1).astype(over.dtype), (excess, nearest, *over[1:]), degree)


def overload(readings: Float[Array, "r *N"], threshold: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Excess of contacts over their thresholds, which follow the pressure where read."""
    if len(readings) == 1:
        return readings[0] - threshold
    return readings[0] - threshold * jnp.maximum(readings[1], jnp.finfo(readings.dtype).tiny)  # of threshold inf too


def event(
    response: Response,
    readings: Float[Array, "r N"],
    threshold: Float[Array, " N"],
    *,
    limit: int | Array,
    residual_strength: Array | float = 0.0,
    renewed: Float[Array, " N"] | None = None,
    trigger: int | Array = -1,
    last: int | Array = -1,
    delay: int = 0,
    log: tuple[Int[Array, " L+1"], Float[Array, " L+1"], int | Array] | None = None,
) -> Event:
    """Break contacts until none is at its threshold.

    Or `limit` have broken, or contact `last` has. A contact keeps the share `residual_strength` of its strength. Thresholds are
    inf where there is no contact, and `renewed` once it has broken. The contact `trigger` breaks first, whatever its overload;
    −1, like that of `last`, for none. A broken contact stays detached for `delay` breaks, where no pressure is read. `log` is
    arrays for the sites in order of breaking and what each released, and the place of the first break.
    """
    renewed = threshold if renewed is None else renewed
    zero, none = jnp.zeros_like(readings[0]), jnp.zeros((), jnp.int32)
    never, (order, each, logged) = jnp.zeros(threshold.shape, jnp.int32), empty_log(0, readings.dtype) if log is None else log
    start = Event(readings, threshold, zero, zero, never, never - 1, none, zero[0], zero[0], order, each)
    trigger, last = jnp.asarray(trigger, jnp.int32), jnp.asarray(last, jnp.int32)

    def forced(now: Event) -> Array:
        return (trigger >= 0) & (now.breaks == 0)

    def next_of(now: Event) -> tuple[Array, ...]:
        """Find the largest overload, and the contact that breaks next.

        With its overload, stress and whether it never broke. Read here: to read an array written in the same step copies it.
        """
        site, most_over = most(now.excess)
        site = jnp.where(forced(now), trigger, site)
        over, stress = overload(now.readings[:, site], now.threshold[site]), now.stress[site]
        return most_over, site, over, stress, residual_strength * (stress - over), now.times[site] == 0

    def going(state: tuple) -> Array:
        now, (most_over, *_), _ = state
        ended = (last >= 0) & (now.times[last] > 0)
        if now.pressure is not None:
            ended = ended | (now.pressure.min() < 0) & (now.breaks > 0)
        return (forced(now) | (most_over >= 0)) & (now.breaks < limit) & ~ended

    def step(state: tuple) -> tuple:
        now, (_, site, over, stress, kept, first), detached = state
        t = stress - kept
        soft, row = response.soft[site] * t, jnp.minimum(logged + now.breaks, now.order.size - 1)
        if delay:
            readings, released, relaxed, detached = _held(response, now, site, stress, kept, detached)
        else:
            readings = now.readings.at[0, site].set(kept) + response.matrix[site] * t
            released, relaxed = now.released.at[site].add(t), soft * (readings[0, site] - kept)
        now = now._replace(
            readings=readings,
            threshold=now.threshold.at[site].set(renewed[site]),
            released=released,
            overload=now.overload.at[site].add(jnp.where(first, over, 0)),
            times=now.times.at[site].add(1),
            turn=now.turn.at[site].add(jnp.where(first, now.breaks + 1, 0)),
            breaks=now.breaks + 1,
            stretched=now.stretched + soft * (stress + kept),
            relaxed=now.relaxed + relaxed,
            order=now.order.at[row].set(site),
            each=now.each.at[row].set(t),
        )
        return now, next_of(now), detached

    begin = start, next_of(start), jnp.full(delay, -1, jnp.int32)
    return lax.while_loop(going, step, begin)[0]


def empty_log(breaks: int, dtype: Any) -> tuple[Int[Array, " L+1"], Float[Array, " L+1"], int]:
    """The `log` of an `event`, for so many breaks."""
    return jnp.full(breaks + 1, -1, jnp.int32), jnp.zeros(breaks + 1, dtype), 0


def _held(
    response: Response, now: Event, site: Array, stress: Array, kept: Array, detached: Int[Array, " n"]
) -> tuple[Array, Array, Array, Array]:
    """Break a contact, and hold the stress of all detached ones.

    Readings, what every contact released, the change of `Event.relaxed`, and those detached now.
    """
    moving = jnp.append(detached, site)[1:]  # the contact detached longest repins, where it is
    there = moving >= 0
    columns = response.matrix[jnp.maximum(moving, 0), 0]
    green = jnp.where(there[:, None] & there[None], columns[:, jnp.maximum(moving, 0)], 0)
    unit, at = jnp.eye(moving.size, dtype=kept.dtype), jnp.where(there, moving, now.times.size)
    t = stress - kept
    releases = solve_without_pivots(unit - green.T, unit[-1] * t)
    followed, soft = releases.at[-1].add(-t), response.soft[moving]
    relaxed = soft[-1] * t * followed[-1] + 2 * (soft * now.stress[moving].at[-1].set(kept) * followed).sum()
    after = (now.stress + releases @ columns).at[at].add(-releases, mode="drop")
    return after[None], now.released.at[at].add(releases, mode="drop"), relaxed, moving


def most(x: Float[Array, " N"]) -> tuple[Array, Array]:
    """Return site and value of the largest entry; the first of equals."""
    value, count = largest(x), jnp.int32(x.size)
    return count - largest(jnp.where(x == value, count - jnp.arange(x.size, dtype=jnp.int32), 0)), value


def largest(x: Array) -> Array:
    """Largest entry, by halves: unlike plain reductions, this compiles to vector instructions."""
    while x.size > 1:
        half = -(-x.size // 2)
        x = jnp.maximum(x[:half], x[-half:])
    return x[0]


def rises(push: Float[Array, "r N"], threshold: Float[Array, " N"], readings: Float[Array, "r N"]) -> Float[Array, " N"]:
    """Rise of the load that brings each contact to its threshold.

    It is inf where none does, or where there is no contact. `push` is what the load adds to the readings.
    """
    there = jnp.isfinite(threshold)
    weak = jnp.where(there, threshold, 0)
    if len(push) == 1:
        gains, short = push[0], weak - readings[0]
    else:
        gains, short = push[0] - weak * push[1], weak * readings[1] - readings[0]
    rising = there & (gains > 0)
    return jnp.where(rising, short / jnp.where(rising, gains, 1), jnp.inf)


def first_to_break(
    push: Float[Array, "r N"],
    threshold: Float[Array, " N"],
    readings: Float[Array, "r N"],
    rises: Callable[..., Float[Array, " N"]] = rises,
) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """Contact that a growing load breaks first, and that rise.

    The first of equals; inf where none gets there. `rises` tells the rise of the load for each.
    """
    needed = rises(push, threshold, readings)
    site = jnp.argmin(needed).astype(jnp.int32)
    return site, needed[site]
