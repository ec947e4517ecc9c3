"""The first event of any body: its nucleation load and its length.

A body answers ``contacts(interface, sites)`` with its first contacts before loading, `Relaxed`. Derivatives of a length are
those at a fixed order of breaks.
"""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax.base.choices import EventKind
from slippulse_jax.base.domains import RESIDUAL_STRENGTH
from slippulse_jax.base.outcomes import first_of, length_or_reason
from slippulse_jax.base.shown import html, in_a_line, short
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.chain import Chain, Springs, chain, eliminate, floats
from slippulse_jax.bodies.equilibrium import all_numbers
from slippulse_jax.bodies.modes import FARTHEST
from slippulse_jax.bodies.response import Response, of_chain
from slippulse_jax.bulk.derivatives import by_forward_mode, with_gradient, with_jacobian
from slippulse_jax.events.event import BREAKS_PER_SITE, LOST, Event, empty_log, event, first_to_break, overload
from slippulse_jax.front.front import FADED, Front, follow
from slippulse_jax.interface import AnyInterface
from slippulse_jax.rules import BreakRule
from slippulse_jax.slider import Slider

WEAKEST = 0.05
"""Least threshold, over its mean, where thresholds scatter."""
ROUNDING = 16
"""Units in the last place within which numbers along a chain are equal."""


class FirstPrecursor(eqx.Module):
    """First precursor of one body: its contacts before and after it.

    Lengths are in λc, displacements in u_s, stresses in σ_s.
    """

    body: Any
    interface: AnyInterface
    contacts_broken: Int[Array, ""]  # s0, so that Λ = s0 λc of a front from the edge
    length: Float[Array, ""]  # ℓ, the continuous length; extrapolated where `precursor_length` does
    load: Float[Array, ""]  # U0 at nucleation: displacement of the drive, or a force held, in K u_s
    status: Int[Array, ""]  # an `Outcome`
    first: Int[Array, ""]  # contact that breaks first
    breaks: Int[Array, ""]  # more than contacts broke where some broke again in a whole event
    stress_before: Float[Array, " sites"]  # on every contact at nucleation
    stress: Float[Array, " sites"]  # when the event is over
    slip: Float[Array, " sites"]  # how far the interface moved while it ran; 0 where there is no contact
    pinning: Float[Array, " sites"]  # how far pinning points moved: what contacts released, as a stress
    pressure_before: Float[Array, " sites"] | None = None  # over the initial one, where anything follows it; at nucleation
    pressure: Float[Array, " sites"] | None = None  # when the event is over
    front_stress: Any = None  # of the front of a slider t(s), (sites,): on contact s once all before it have broken
    event: EventKind = eqx.field(default="domino", static=True)  # the first front, or the whole event

    @property
    def edge_stress(self) -> Float[Array, ""]:
        """Stress on contact 0 at arrest."""
        return self.stress[0]

    def __repr__(self) -> str:
        return in_a_line(self, "body", "contacts_broken", "length", "load", "interface")

    def _repr_html_(self) -> str:
        rows = [
            ("length, ℓ/λc", short(self.length)),
            ("contacts broken", short(self.contacts_broken)),
            ("load at nucleation, U/u_s", short(self.load)),
            ("on", repr(self.body)),
        ]
        one = not isinstance(self.status, Tracer) and np.ndim(self.status) == 0
        return html("First precursor", rows, below=Outcome(int(self.status)).message if one else "")

    def __str__(self) -> str:
        if isinstance(self.length, Tracer) or self.length.ndim:
            return repr(self)
        broken, first, breaks = int(self.contacts_broken), int(self.first), int(self.breaks)
        text = (
            f"first precursor: {broken} contact{'s' * (broken != 1)} broken, length {float(self.length):.6g} λc, "
            f"load at nucleation {float(self.load):.6g} u_s; {Outcome(int(self.status)).message}"
        )
        push = getattr(self.body, "push", None)
        if int(self.status) == Outcome.NO_DOMINO and push is not None and push.height is None:
            text += "; a side that is pushed as a whole loads every contact alike, which leaves the neighbour just below"
        text += f"; it begins at contact {first}, not at the edge" if first else ""
        return text + (f"; contacts behind the front break again, {breaks} breaks in all" if breaks > broken else "")


class Relaxed(NamedTuple):
    """A body before it is loaded; stresses in σ_s."""

    response: Response
    threshold: Float[Array, " N"]  # of contacts that never broke; inf where there is none
    prestress: Float[Array, " N"]  # the only stress
    stiffness: Array | float = 1.0  # k, in K
    last: Int[Array, ""] | int = -1  # index of the last contact, or of the last one resolved
    valid: Bool[Array, ""] | bool = True  # whether all numbers lie in their domains
    pressed: Any = None  # `blocks.pressed.Pressed`, where stiffness follows the pressure too; stresses are stretches then
    alike: Bool[Array, ""] | bool = False  # whether neighbouring contacts are: a first event ends on a curve
    residual_strength: Array | float = 0.0  # r, the share of its strength that a contact keeps

    @property
    def readings(self) -> Float[Array, "r N"]:
        """The prestress and, where it is read, the initial pressure."""
        return jnp.stack([self.prestress, jnp.ones_like(self.prestress)])[: len(self.response.push)]

    def up_to(self, last: int | Array) -> "Relaxed":
        """The same body whose contacts beyond `last` never break."""
        there = jnp.arange(self.threshold.size) <= last
        threshold, prestress = jnp.where(there, self.threshold, jnp.inf), jnp.where(there, self.prestress, 0)
        return self._replace(threshold=threshold, prestress=prestress, last=last)

    def scattered(self, scatter: Any, key: Array) -> "Relaxed":
        """The same body with thresholds drawn, normal about its own.

        That of a contact depends on no other: more contacts add to those drawn.
        """
        drawn = jax.random.normal(key, self.threshold.shape, self.threshold.dtype)
        return self._replace(
            threshold=self.threshold * jnp.maximum(1 + scatter * drawn, WEAKEST), alike=self.alike & (scatter == 0)
        )

    def through(self, spring: Any) -> "Relaxed":
        """The same body with its pusher pulled through a spring, in K."""
        pressed = None if self.pressed is None else self.pressed.through(spring, self.stiffness)
        return self._replace(response=self.response.through(spring, self.stiffness), pressed=pressed)


def contacts_of_chain(body: Chain, beyond: Springs | None = None, response: Response | None = None) -> Relaxed:
    """Contacts of a chain, given its elimination and response where known."""
    beyond = eliminate(body, body.contact) if beyond is None else beyond
    attached = body.contact > 0
    prestress = jnp.where(attached, body.prestress, 0)
    holds = (body.threshold > prestress).all() & (body.threshold > 0).all() & RESIDUAL_STRENGTH.holds(body.residual_strength)
    return Relaxed(
        response=of_chain(body, beyond) if response is None else response,
        threshold=jnp.where(attached, body.threshold, jnp.inf),
        prestress=prestress,
        stiffness=body.stiffness,
        last=body.sites - 1,
        valid=all_numbers(body, body.relaxed()) & holds & ~floats(body, beyond),
        alike=alike(body, jnp.zeros_like(prestress)),
        residual_strength=body.residual_strength,
    )


def contacts_of_slider(slider: Slider, interface: AnyInterface, sites: int) -> Relaxed:
    """The first contacts of a slider, or all of one that ends."""
    found = contacts_of_chain(chain(dataclasses.replace(slider, machine=None), sites=sites, interface=interface))
    valid = found.valid if slider.sites is None else found.valid & (slider.sites == sites)
    found = found._replace(valid=valid & slider.in_domain())
    return found if slider.machine is None else found.through(jnp.minimum(slider.machine, FARTHEST))


def alike(chain: Chain, pinning: Array) -> Array:
    """Whether along a chain only thresholds and prestress change, and these evenly."""

    def even(x: Array, order: int) -> Array:
        return (jnp.abs(jnp.diff(x, order)) <= ROUNDING * jnp.finfo(x.dtype).eps * jnp.abs(x).max()).all()

    bonds = [even(x, 1) for x in (chain.upper, chain.layer, chain.across, chain.contact, pinning)]
    return jnp.stack([*bonds, even(chain.threshold, 2), even(chain.prestress, 2)]).all()


class Nucleation(NamedTuple):
    """Contacts as the first of them reaches its threshold."""

    first: Int[Array, ""]
    load: Array
    readings: Float[Array, "r N"]  # of a `Pressed` body the stretch, in u_s
    response: Response  # what breaks do from here on
    pressure: Float[Array, " N"] | None = None  # over the initial one, where anything follows it


def nucleated(body: Relaxed) -> Nucleation:
    """Load a body until a contact is at its threshold."""
    response, threshold, prestress = body[:3]
    if body.pressed is not None:
        found = body.pressed.balance(threshold, prestress, 0 * prestress, 0 * prestress[0])
        return Nucleation(found.first, found.load, found.stretch[None], body.pressed.frozen(found), found.pressure)
    first, load = first_to_break(response.push, threshold, body.readings)
    readings = body.readings + load * response.push
    return Nucleation(first, load, readings, response, readings[1] if len(readings) > 1 else None)


def first_event(body: Relaxed, kind: EventKind = "domino") -> tuple[Event, Nucleation]:
    """Load a body to its first break, and follow the event."""
    start = nucleated(body)
    return event_from(start, body, kind), start


def event_from(
    start: Nucleation, body: Relaxed, kind: EventKind, limit: Array | int | None = None, *, logged: bool = False
) -> Event:
    """Event that a nucleation begins; if `logged`, with the order of breaks.

    Contacts break until none is at its threshold, or the last has broken. In the first front no contact breaks again. The
    event is given up after `limit` breaks, at least one.
    """
    threshold, sites = body.threshold, body.threshold.size
    most_breaks = BREAKS_PER_SITE * sites
    return event(
        start.response,
        start.readings,
        threshold,
        limit=most_breaks if limit is None else limit,
        residual_strength=body.residual_strength,
        renewed=None if kind == "full" else jnp.full_like(threshold, jnp.inf),
        trigger=start.first,
        last=jnp.asarray(body.last) % sites,
        log=empty_log(most_breaks, threshold.dtype) if logged else None,
    )


def slopes_of_length(
    found: Event, start: Nucleation, body: Relaxed
) -> tuple[Float[Array, "r N"], Float[Array, "N r N"], Float[Array, " N"], Array]:
    """Derivatives of ℓ in readings, matrix, threshold and r.

    Of a logged event, at a fixed order of breaks. From the last break back to the first, λ is the derivative in the readings of
    every contact: a break of contact o that released t set its stress to what it kept, r θ times its pressure then, and added t
    times its column.
    """
    order, each, matrix, threshold = found.order, found.each, start.response.matrix, body.threshold
    lost = 1 - jnp.asarray(body.residual_strength)
    at, over, degree = found.front_of(body.alike)
    ahead, none = jnp.minimum(at + 1, threshold.size - 1), jnp.zeros_like(threshold)
    of_over, of_short = jax.grad(found.end, (1, 2))(at, over, found.excess[ahead], degree)
    # of every contact that broke: what its overload as the front passed is to ℓ, and when that was
    reached = at - jnp.arange(over.size, dtype=at.dtype)
    of_over, reached = jnp.where(reached >= 0, of_over, 0), jnp.maximum(reached, 0)
    passed = jnp.argmax(order[None] == reached[:, None], axis=1).astype(jnp.int32)
    weak, short = threshold[reached], threshold[ahead]  # all can break
    of_threshold = none.at[reached].add(-of_over * (each[passed] - over) / (weak * lost))
    of_threshold = of_threshold.at[ahead].add(-of_short * (1 if found.pressure is None else found.pressure[ahead]))

    def back(state: tuple) -> tuple:
        number, of_readings, of_matrix, of_threshold, of_kept, pressure = state
        site, t, front = order[number], each[number], jnp.where(number == passed, of_over, 0)
        of_t = (matrix[site] * of_readings).sum()
        held = of_readings[0, site] - of_t  # the derivative in what the contact keeps
        of_matrix = of_matrix.at[site].add(of_readings * t)
        pressure = pressure - matrix[site, 1:] * t  # as it was before the break
        then = pressure[0, site] if len(pressure) else 1.0
        passing = jnp.stack([front.sum(), (1 - lost) * threshold[site] * held - (front * weak).sum()])[: len(of_readings)]
        of_readings = of_readings.at[0, site].set(of_t).at[:, site].add(passing)
        of_threshold = of_threshold.at[site].add((1 - lost) * then * held)
        return number - 1, of_readings, of_matrix, of_threshold, of_kept + threshold[site] * then * held, pressure

    begin = jnp.zeros_like(found.readings).at[:, ahead].add(jnp.stack([of_short, -of_short * short])[: len(found.readings)])
    last = found.breaks - 1, begin, jnp.zeros_like(matrix), of_threshold, none[0], found.readings[1:]
    return lax.while_loop(lambda state: state[0] >= 0, back, last)[1:5]


def ended(found: Event, start: Nucleation, body: Relaxed, kind: EventKind) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """How an event ended, and ℓ."""
    excess = overload(found.readings, body.threshold)
    # that of rough contacts decays for ever
    lifted = [] if found.pressure is None else [(x < LOST).any() for x in (start.readings[1], found.pressure)]
    again = (excess >= 0) & found.broken if kind == "domino" else jnp.zeros(excess.size, bool)
    endings = {
        Outcome.INVALID: ~(body.valid & jnp.isfinite(excess).all()),
        Outcome.LIFT_OFF: jnp.any(jnp.stack(lifted)) if lifted else jnp.zeros((), bool),
        Outcome.RAN_THROUGH: found.broken[body.last],
        Outcome.LIMIT: ((excess >= 0) & ~again).any(),
        Outcome.NO_DOMINO: found.rightmost == 0,
        Outcome.REBREAK: again.any(),
    }
    status = first_of(endings)
    return status, length_or_reason(status, found.length(excess, excess.size - 1, body.alike))


@partial(jax.jit, static_argnames=("sites", "kind"))
def record(body: Any, interface: AnyInterface, sites: int, kind: EventKind) -> FirstPrecursor:
    """Record of the event of a body's first `sites` contacts."""
    contacts = body.contacts(interface, sites)
    found, start = first_event(contacts, kind)
    pinning, before, stress, pressure = found.released, start.readings[0], found.stress, found.pressure
    if contacts.pressed is not None:
        after = contacts.pressed.balance(jnp.full(sites, jnp.inf), contacts.prestress, pinning, start.load)
        before, stress, pressure = before * jnp.asarray(start.pressure), after.stretch * after.pressure, after.pressure
    status, length = ended(found, start, contacts, kind)
    return FirstPrecursor(
        body=body,
        interface=interface,
        contacts_broken=found.broken.sum().astype(jnp.int32),
        length=length,
        load=start.load,
        status=status,
        first=start.first.astype(jnp.int32),
        breaks=found.breaks,
        stress_before=before,
        stress=stress,
        slip=pinning @ start.response.matrix[:, 0] * contacts.response.soft,
        pinning=pinning,
        pressure_before=start.pressure,
        pressure=pressure,
        event=kind,
    )


def length_of(body: Relaxed, kind: EventKind) -> tuple[Float[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """ℓ of an event, how many contacts broke, and its `Outcome`."""
    found, start = first_event(body, kind)
    status, length = ended(found, start, body, kind)
    return length, found.broken.sum(), status


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def length_from(start: Nucleation, body: Relaxed, kind: EventKind) -> Float[Array, ""]:
    """ℓ of the event that a nucleation begins."""
    return ended(event_from(start, body, kind), start, body, kind)[1]


@length_from.defjvp
def _length_jvp(kind: EventKind, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    """At a fixed order of breaks."""
    (start, body), (moved, changed) = primals, tangents
    found = event_from(start, body, kind, logged=True)
    length = ended(found, start, body, kind)[1]
    changes = moved.readings, moved.response.matrix, changed.threshold, changed.residual_strength
    slopes = slopes_of_length(found, start, body)
    change = sum(jax.tree.leaves(jax.tree.map(lambda slope, x: (slope * x).sum(), slopes, changes)))
    return length, change * jnp.where(jnp.isfinite(length), 1, jnp.nan)  # without a length there is no derivative either


def smooth_length(contacts: Relaxed, rule: BreakRule) -> Float[Array, ""]:
    """ℓ under a smooth rule, of a front from the edge.

    It is inf if the front reaches the last contact, NaN if it begins elsewhere.
    """
    threshold, last, start = contacts.threshold, contacts.last, nucleated(contacts)

    def ahead(front: Front) -> tuple[Array, Array]:
        """What a contact can lose, and that at which it breaks."""
        stress, *pressure = front.loads[:, front.position]
        strength = threshold[front.position] * (pressure[0] if pressure else 1)
        return stress - contacts.residual_strength * strength, (1 - contacts.residual_strength) * strength

    def release(front: Front, part: Any, released: Array) -> Front:
        return front._replace(
            loads=front.loads + start.response.matrix[front.position] * (part * released), position=front.position + 1
        )

    at_edge = Front(start.readings, None, None, jnp.int32(0))
    _, _, part, length = follow(rule, release(at_edge, 1, ahead(at_edge)[0]), ahead, release, last)
    valid = contacts.valid & (start.first == 0) & rule.in_domain()
    return length_or_reason(first_of({Outcome.INVALID: ~valid, Outcome.RAN_THROUGH: part > FADED}), length)


@partial(jax.jit, static_argnames=("sites", "kind"))
def length(
    body: Any, interface: AnyInterface, rule: BreakRule | None = None, *, sites: int, kind: EventKind
) -> Float[Array, ""]:
    """ℓ of a body that has ``contacts``, under any rule."""
    given, tree = jax.tree.flatten((body, interface, rule))
    types = [x.dtype for x in given]

    def one(*numbers: Array) -> Array:
        here = [x.astype(dtype) for x, dtype in zip(numbers, types, strict=True)]
        body, interface, rule = jax.tree.unflatten(tree, here)
        contacts = body.contacts(interface, sites)
        if rule is not None:
            return smooth_length(contacts, rule)
        return length_from(nucleated(contacts), contacts, kind)

    first = with_gradient if rule is None else with_jacobian
    return by_forward_mode(one, first)(*(x.astype(float) for x in given))  # whole numbers too: the rule joins all tangents
