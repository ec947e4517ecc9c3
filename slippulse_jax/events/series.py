r"""Series of events: a chain or a block under increasing load.

Between events every stress grows linearly with the load, so the next break is found exactly. In an event contacts break one
after another at a fixed load, the most overloaded first. All sums are updated from break to break. The chain is solved afresh
only at the end, to measure the accumulated rounding errors.

* A break at j that releases the stress t_j adds q_i G_ij t_j to every stress (`slippulse_jax.bodies.response`).
* By reciprocity it lowers the force on the left edge by k t_j du_j/dU.
* It releases the energy (k t_j)²/2k_j of the broken contact's own stretch, and a further (k t_j)(k t_j')/2k_j as the chain
  relaxes to equilibrium, where the contact carries t_j'. (A contact that repins with t_r releases t_j − t_r: (t_j² − t_r²) and
  (t_j − t_r)(t_j' − t_r) then stand for these.)
* The rest of the work of the drive is stored.

A break costs O(N) (`slippulse_jax.events.event`).
"""

from functools import partial
from types import NoneType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, Int
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.base.domains import Domain, check_kind, check_whole
from slippulse_jax.base.shown import short
from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.base.units import as_float
from slippulse_jax.block import Block, checked_sites
from slippulse_jax.bodies.chain import Chain, Springs, State, check_linear
from slippulse_jax.bodies.response import Response, with_response
from slippulse_jax.bulk.compiler import lane_by_lane
from slippulse_jax.bulk.derivatives import without_derivative
from slippulse_jax.bulk.double import in_double
from slippulse_jax.events.ageing import Ageing, next_crossing
from slippulse_jax.events.catalogue import COLUMNS, Catalogue, EventClass
from slippulse_jax.events.event import BREAKS_PER_SITE, LOST, event, first_to_break, most, overload, rises
from slippulse_jax.events.first import Relaxed, contacts_of_chain
from slippulse_jax.interface import AnyInterface, Interface, Profile, kept_share
from slippulse_jax.slider import Slider


class Adiabatic(eqx.Module):
    """Push the left edge exactly to the next break.

    The edge is held fixed while the event runs.
    """

    velocity: Float[AnyArrayLike, ""] = 1.0  # of the left edge, in u_s per time; matters only for ageing in time


class Steps(eqx.Module):
    """Push the left edge in steps of `size` u_s.

    A step may overload several contacts at once.
    """

    size: Float[AnyArrayLike, ""]
    velocity: Float[AnyArrayLike, ""] = 1.0


class Spring(eqx.Module):
    """Pull the left edge through a spring of `stiffness` K.

    The load is the displacement of the driver.
    """

    stiffness: Float[AnyArrayLike, ""]
    velocity: Float[AnyArrayLike, ""] = 1.0


Protocol = Adiabatic | Steps | Spring

Shape = tuple[int, int, int, int]
"""Numbers that set the shape of a compiled series: events, recorded breaks, delay, contacts resolved."""


class Loading(NamedTuple):
    """How a series is loaded and ended early; traced, to compile once."""

    protocol: Protocol
    ageing: Ageing | None
    until: Float[Array, ""]  # load; inf for none
    when_spanning: Array  # whether with the first event that breaks the last contact
    max_breaks: Int[Array, ""]  # of one event
    last: Int[Array, ""]  # contact that may break, of those resolved
    # record only events whose own extent is at least the first of these, and larger than before; end with one of the second
    noticed: tuple[Array, Array] | None = None


LIFTED = 1e-3
"""Pressure, over the initial one, below which a contact that breaks alone lifts off: it would break for ever, ever sooner."""
BALANCED = 1e-9
"""Stretch, in u_s, by which Newton's method may leave a contact short of its threshold."""
POSITIVE = Domain(0, float("inf"), "must be positive and finite")
FEW_EVENTS, MOST_EVENTS = 8, 512
"""Events for each contact that a series has at first, and at most, until a front spans."""


def series(
    body: Any,
    protocol: Protocol = Adiabatic(),  # noqa: B008 - a constant
    *,
    events: int,
    interface: Interface | Profile | None = None,
    sites: int | None = None,
    ageing: Ageing | None = None,
    repin_delay: int = 0,
    until: Float[AnyArrayLike, ""] | None = None,
    stop_when_spanning: bool = True,
    max_breaks: int | None = None,
    recorded_breaks: int = 0,
) -> Catalogue:
    """Load a relaxed body through `events` events.

    Parameters
    ----------
    body : Chain, Slider or Block
        A chain with linear contacts, whose thresholds and prestress may have any profile. Or a slider, or a block whose pusher
        is displaced; "the left edge" of what follows is then its pusher. Or a body of one's own (docs/howto/extend.md).
    protocol : Adiabatic, Steps or Spring
    events : int
        Number of events, and of rows in the catalogue.
    interface : Interface or Profile, optional
        Thresholds and prestress of the contacts; a chain has its own.
    sites : int, optional
        Number of contacts resolved of a body without end, which must be given; from 2 to 8192, of sliders to 4096.
    ageing : Ageing, optional
        Contacts that never broke have the thresholds of the chain; those that did are reborn weak. By default they recover
        immediately. What a contact keeps is a share of its strength as it breaks, and less than that of a newborn one.
    repin_delay : int
        Number n of breaks for which a broken contact stays detached: it repins, with what it kept, when the nth contact after
        it breaks, or when the event ends. For a front that breaks one contact after another this is a delay in sites.
    until : array_like, shape (), optional
        Load at which the series ends: the first event at or beyond it is the last.
    stop_when_spanning : bool
        End with the first event that breaks the last contact; a semi-infinite chain is not resolved beyond it.
    max_breaks : int, optional
        Limit on the breaks of one event, at which the series is given up; 50 N by default.
    recorded_breaks : int
        Number of breaks to record one by one, for the space–time map.

    Returns
    -------
    Catalogue
        It carries a status (`Outcome`) instead of raising an exception. Composes with ``jit`` and ``vmap``.

    Raises
    ------
    ValueError
        If a size is not positive, the chain has nonlinear contacts, or the force on a block is held.
    TypeError
        If `protocol` is not a protocol, or if the series is differentiated: a comparison decides which contact breaks next.
    """
    if not hasattr(body, "contacts"):
        check_kind("body", body, Slider, Block, Chain)
    check_kind("interface", interface, Interface, Profile, NoneType)
    if isinstance(body, Chain):
        check_linear(body, "a series")
        if interface is not None or sites is not None:
            given = f"sites = {sites}" if interface is None else f"interface = {interface!r}"
            raise ValueError(f"{given}: that is for a block; a chain has its own contacts")
        sites = body.sites
    else:
        check_pusher(body, protocol)
        sites = checked_sites(body, sites)
    check_whole("events", events, 1)
    check_whole("recorded_breaks", recorded_breaks, 0)
    check_whole("repin_delay", repin_delay, 0)
    if not isinstance(protocol, Protocol):
        raise TypeError(f"protocol = {protocol!r}: must be Adiabatic(), Steps(size) or Spring(stiffness)")
    for name in ("size", "stiffness", "velocity"):
        POSITIVE.check(f"{type(protocol).__name__}.{name}", getattr(protocol, name, 1.0))
    kept = body.residual_strength if isinstance(body, Chain) else kept_share(interface)
    if ageing is not None and not isinstance(weak := kept >= jnp.asarray(ageing.newborn), Tracer) and weak.any():
        raise ValueError(
            f"Ageing.newborn = {short(ageing.newborn)} beside residual_strength = {short(kept)}: must be larger; a newborn "
            "contact that is weaker than what it keeps breaks at once"
        )
    if isinstance(body, Block) and body.friction is not None and repin_delay:
        raise ValueError(f"repin_delay = {repin_delay}: contacts of a block with friction repin at once")
    # of a block, which says itself where it ends, a power of two, so that similar ones share a program
    resolved = 1 << (sites - 1).bit_length() if isinstance(body, Block) else sites
    shape = events, recorded_breaks, repin_delay, resolved
    run_series = _hard_series if isinstance(body, Chain) else in_double(_hard_series)
    with jax.debug_infs(False):  # nothing ends a series without `until`, and the extent of an event that spans is inf
        until = jnp.asarray(jnp.inf if until is None else as_float("until", until))
        most = jnp.asarray(BREAKS_PER_SITE * sites if max_breaks is None else max_breaks, jnp.int32)
        loading = Loading(protocol, ageing, until, jnp.asarray(stop_when_spanning), most, jnp.asarray(sites - 1))
        found = run_series(shape, body, interface, loading)
    return found._replace(state=State(found.state.pinning[..., :sites], found.state.load))


def static_friction(
    body: Any,
    interface: Interface | Profile | None = None,
    *,
    ageing: Ageing | None = None,
    events: int | None = None,
) -> Float[Array, ""]:
    """Largest force over μF_N before a block slides as a whole.

    From its series, up to the event in which the front spans the block. Fronts that creep by single contacts count.

    Parameters
    ----------
    body : Block or Slider
        One that ends, or a body of yours (docs/howto/extend.md). With friction the result is the coefficient of static friction
        of the block over that of a contact, μ; without, the force is over that at which all contacts carry their thresholds.
    interface, ageing
        As for `series`.
    events : int, optional
        Events after which the series is given up. By default as many as are needed, under ``jit`` and ``vmap`` 8 per contact.

    Returns
    -------
    array
        In (0, 1]; NaN under ``jit`` and ``vmap`` if no front spans.

    Raises
    ------
    NotConverged
        If no front spans the block, and nothing is traced.
    ValueError, TypeError
        As of `series`.

    Notes
    -----
    It falls as the block becomes longer or the interface stiffer while the first break has the largest force, rises towards 1
    with what contacts keep where creep has, and stays near 0.6 of long blocks on stiff interfaces (docs/model/amontons.md).
    Stresses are in σ_s = μF_N over the area, so that the normal load itself has no part in it as long as k stays the same;
    where k grows with the load, k/K does. A program is compiled for each number of contacts, to a power of two, and of events.
    """
    sites = checked_sites(body, None)
    count = FEW_EVENTS * sites if events is None else events
    while True:
        found = series(body, events=count, interface=interface, ageing=ageing)
        spans = found.kind == EventClass.SPANNING
        if isinstance(found.status, Tracer) or found.status == Outcome.SPANNED:
            return jnp.where(spans.any(), jnp.nanmax(found.force_before) / found.strength, jnp.nan)
        if found.status != Outcome.DONE or events is not None or count >= MOST_EVENTS * sites:
            after = f", after {int(found.number)} events" if found.status == Outcome.DONE else ""
            raise NotConverged(f"no front spans {body}{after}: {Outcome(int(found.status)).message}")
        count *= 4


def check_pusher(body: Any, protocol: Protocol) -> None:
    """Refuse a pusher whose force is held, and two springs behind it."""
    if isinstance(body, Block) and body.push.control != "displacement":
        raise ValueError("push.control = 'force': the pusher of a series is displaced; pull it through a soft Spring instead")
    if getattr(body, "machine", None) is not None and isinstance(protocol, Spring):
        raise ValueError("a machine and protocol = Spring(…): they are one spring, give one of them")


def _series(shape: Shape, body: Any, interface: AnyInterface, loading: Loading) -> Catalogue:
    def of_chain(beyond: Springs, response: Response, chain: Chain, loading: Loading) -> Catalogue:
        return of_contacts(shape, contacts_of_chain(chain, beyond, response), loading)

    def resolved(body: Any, interface: AnyInterface, loading: Loading) -> Catalogue:
        return of_contacts(shape, body.contacts(interface, shape[-1]), loading)

    if isinstance(body, Chain):
        return with_response(of_chain, body, loading)
    return lane_by_lane(resolved, body, interface, loading)


def of_contacts(shape: Shape, body: Relaxed, loading: Loading) -> Catalogue:
    """Series of a body's first contacts; a spring lets its pusher yield."""
    if isinstance(loading.protocol, Spring):
        body = body.through(loading.protocol.stiffness)
    body = body.up_to(loading.last)
    response, threshold, prestress, k, *_ = body
    sound = jnp.isfinite(response.matrix[:, 0]).all() & ((threshold > prestress) & (threshold > 0)).all()
    if loading.ageing is not None:  # a newborn contact weaker than what it keeps would break at once
        sound = sound & (jnp.asarray(body.residual_strength) < loading.ageing.newborn)
    body = body._replace(valid=body.valid & sound)
    end = load_through(shape, body, loading)
    u, pinning = end.load, response.soft * end.released
    driven, held = u * response.push[0], end.released - end.released @ response.matrix[:, 0]
    stored = response.edge_stiffness * u**2 / 2 + k * (pinning * (held / 2 - driven - prestress)).sum()
    stress = prestress + driven - held
    if body.pressed is not None:
        stress = body.pressed.balance(jnp.full_like(prestress, jnp.inf), prestress, pinning, u).stretch
    return _catalogue(body, end, State(pinning, u), stress, stored)


_hard_series = without_derivative(
    _series,
    "a series of hard events cannot be differentiated: a comparison decides which contact breaks next",
    static_argnums=(0,),
)


# --- from event to event ---


class SeriesState(NamedTuple):
    """State between two events of N contacts."""

    readings: Float[Array, "r N"]  # stress; and pressure over the initial one, where thresholds follow it
    released: Float[Array, " N"]  # by each contact so far
    born: Float[Array, " N"] | None  # load at the last break, if contacts age; −inf if never
    last: Int[Array, " N"]  # event of the last break; −1 if never
    load: Array
    force: Array  # on the left edge
    stored: Array  # potential energy
    number: Array  # of events
    total: Array  # of breaks
    seen: tuple[Array, Array] | None  # events recorded, and the largest own extent of all, where not every event is
    ending: Int[Array, ""]  # an `Outcome`, or −1
    rows: dict[str, Array]  # columns of the catalogue, of length E + 1; the last row is scratch space
    order: Int[Array, " L+1"]  # site of every break; likewise


WHOLE = {"site": -1, "leftmost": -1, "kind": -1, "extent": 0, "breaks": 0}
"""Columns of whole numbers, and their value where there is no event; that of the others is NaN."""


def load_through(shape: Shape, body: Relaxed, loading: Loading) -> SeriesState:
    """Run events until the series ends."""
    events, recorded, delay, _ = shape
    zero, none = jnp.zeros_like(body.prestress[0]), jnp.zeros((), jnp.int32)
    begin = SeriesState(
        readings=body.readings,
        released=jnp.zeros_like(body.prestress),
        born=None if loading.ageing is None else jnp.full_like(body.prestress, -jnp.inf),
        last=jnp.full(body.prestress.shape, -1, jnp.int32),
        load=zero,
        force=zero,
        stored=zero,
        number=none,
        total=none,
        seen=None if loading.noticed is None else (none, zero),
        ending=jnp.where(body.valid, -1, Outcome.INVALID).astype(jnp.int32),
        rows={
            name: jnp.full(events + 1, WHOLE.get(name, jnp.nan), jnp.int32 if name in WHOLE else zero.dtype) for name in COLUMNS
        },
        order=jnp.full(recorded + 1, -1, jnp.int32),
    )
    return lax.while_loop(lambda now: now.ending < 0, partial(_next_event, body, loading, delay), begin)


def _next_event(body: Relaxed, loading: Loading, delay: int, now: SeriesState) -> SeriesState:
    """Load to the next break, run the event and record it."""
    response, k, ageing = body.response, body.stiffness, loading.ageing
    threshold, renewed, reach = body.threshold, None, rises
    velocity = jnp.asarray(loading.protocol.velocity)
    if ageing is not None and now.born is not None:
        renewed = threshold * jnp.asarray(ageing.newborn)
        reach = partial(next_crossing, ageing=ageing, age=now.load - now.born, velocity=velocity)

    def aged(load: Array) -> Array:
        if ageing is None or now.born is None:
            return body.threshold
        return body.threshold * ageing.strength(load - now.born, velocity)

    if body.pressed is not None:
        at = body.pressed.balance(threshold, body.prestress, now.released, now.load, reach)
        begins = at.stretch[at.first] >= aged(at.load)[at.first] - BALANCED
        rise, trigger = _stepped(loading.protocol, at.load - now.load, at.first, begins)
        load = now.load + rise
        if isinstance(loading.protocol, Steps):
            at = body.pressed.balance(jnp.full_like(threshold, jnp.inf), body.prestress, now.released, load)
        readings, response, per_stretch = at.stretch[None], body.pressed.frozen(at), at.pressure
        force_before = body.pressed.edge_stiffness * load - k * body.pressed.push @ at.force
    else:
        site, rise = first_to_break(response.push, threshold, now.readings, reach)
        begins = jnp.isfinite(rise)
        rise, trigger = _stepped(loading.protocol, jnp.maximum(rise, 0), site, begins)
        load, force_before, per_stretch = now.load + rise, now.force + response.edge_stiffness * rise, 1.0
        readings = now.readings + response.push * rise
    threshold = aged(load)
    most_over = most(overload(readings, threshold))[0]
    first = jnp.where(trigger >= 0, trigger, most_over) if isinstance(loading.protocol, Steps) else trigger
    found = event(
        response,
        readings,
        threshold,
        renewed=renewed,
        trigger=trigger,
        limit=loading.max_breaks,
        residual_strength=body.residual_strength,
        delay=delay,
        log=(now.order, jnp.zeros(now.order.size, rise.dtype), now.total),
    )
    right, excess, slip = found.rightmost, found.excess, response.soft * found.released
    lifted = [(x < LOST).any() for x in (*readings[1:], *found.readings[1:])]
    lifted += [(found.breaks == 1) & (readings[1, first] < LIFTED)] if len(readings) > 1 else []
    even = body.alike & (now.number == 0) & (delay == 0)  # contacts that broke differ
    force = force_before - k * (response.push[0] * slip).sum()
    work, broken, relaxed = (now.force + force_before) / 2 * rise, k / 2 * found.stretched, k / 2 * found.relaxed
    if body.pressed is not None:  # the sums above are those of springs that stay as they are
        work, broken, relaxed = (jnp.full_like(work, jnp.nan),) * 3
    stored, spans = now.stored + work - broken - relaxed, right == body.last
    kinds = {
        EventClass.SPANNING: spans,
        EventClass.EDGE: first == 0,
        EventClass.RENUCLEATED: (first > 0) & (now.last[jnp.maximum(first - 1, 0)] > now.last[first]),
    }
    length = jnp.where(spans, jnp.inf, found.length(excess, body.last, even))
    row = {
        "load": load, "force_before": force_before, "force_after": force, "site": first, "leftmost": found.leftmost,
        "extent": right + 1, "length": length, "breaks": found.breaks, "slip": slip.sum(),
        "stress_drop": (per_stretch * (readings[0] - found.stress)).sum(), "work": work, "stored": stored, "broken": broken,
        "relaxed": relaxed, "kind": jnp.select(list(kinds.values()), list(kinds), EventClass.INTERIOR),
    }  # fmt: skip
    over = (found.breaks >= loading.max_breaks) & (excess >= 0).any()
    at, recorded, enough, seen = now.number, begins, jnp.zeros((), bool), None
    if loading.noticed is not None and now.seen is not None:
        (least, most_own), (at, widest), own = loading.noticed, now.seen, length - found.leftmost
        recorded, enough = begins & (own >= least) & (own > widest), own >= most_own
        seen, over = (at + recorded, jnp.maximum(widest, own)), over | (now.number >= loading.max_breaks)
    endings = {
        Outcome.NOTHING_LEFT: ~begins,
        Outcome.LIFT_OFF: jnp.any(jnp.stack(lifted)) if lifted else jnp.zeros((), bool),
        Outcome.LIMIT: over,
        Outcome.SPANNED: loading.when_spanning & spans,
        Outcome.DONE: (at == now.rows["load"].size - 2) & recorded | (load >= loading.until.astype(load.dtype)) | enough,
    }
    place = jnp.where(recorded, at, now.rows["load"].size - 1)
    return SeriesState(
        readings=found.readings,
        released=now.released + found.released,
        born=None if now.born is None else jnp.where(found.broken, load, now.born),
        last=jnp.where(found.broken, now.number, now.last),
        load=load,
        force=force,
        stored=stored,
        number=now.number + begins.astype(jnp.int32),
        total=now.total + found.breaks,
        seen=seen,
        ending=jnp.select(list(endings.values()), list(endings), -1).astype(jnp.int32),
        rows={
            name: lax.dynamic_update_index_in_dim(column, row[name].astype(column.dtype), place, 0)
            for name, column in now.rows.items()
        },
        order=found.order,
    )


def _stepped(protocol: Protocol, rise: Array, site: Array, begins: Array) -> tuple[Array, Array]:
    """Rise to the event, or 0; first contact if sure, or −1."""
    trigger = jnp.where(begins, site, -1)
    if isinstance(protocol, Steps):
        size, close = jnp.asarray(protocol.size, rise.dtype), 1e4 * jnp.finfo(rise.dtype).eps
        whole_steps = jnp.maximum(jnp.ceil(rise / size - close), 1) * size
        # beyond the crossing the most overloaded contact breaks first
        trigger = jnp.where(whole_steps > rise + close * size, -1, trigger)
        rise = whole_steps
    return jnp.where(begins, rise, 0), trigger


def _catalogue(body: Relaxed, end: SeriesState, state: State, stress: Float[Array, " N"], stored: Array) -> Catalogue:
    """Make the catalogue; final `stress` and `stored` were solved afresh."""
    columns = {name: column[:-1] for name, column in end.rows.items()}
    place = jnp.arange(end.order.size - 1, dtype=jnp.int32)
    of_event = jnp.searchsorted(jnp.cumsum(columns["breaks"]), place, side="right").astype(jnp.int32)
    known = place < end.total
    return Catalogue(
        **columns,
        number=end.number,
        break_site=jnp.where(known, end.order[:-1], -1),
        break_event=jnp.where(known, of_event, -1),
        state=state,
        strength=body.stiffness * jnp.where(jnp.isfinite(body.threshold), body.threshold, 0).sum(),
        drift=jnp.abs(end.readings[0] - stress).max(),
        energy_drift=jnp.abs(end.stored - stored),
        status=end.ending,
    )
