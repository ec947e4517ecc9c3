r"""Series of events: a chain or a block under increasing load, one rupture after another.

Between events every stress grows linearly with the load, so the next break is found exactly. In an event contacts break one
after another at a fixed load, the most overloaded first. All sums are updated from break to break. The chain is solved afresh
only at the end, to measure the accumulated rounding errors.

* A break at j that releases the stress t_j adds q_i G_ij t_j to every stress (`slippulse_jax.lattice.response`).
* By reciprocity it lowers the force on the left edge by k t_j du_j/dU.
* It releases the energy (k t_j)²/2k_j of the broken contact's own stretch, and a further (k t_j)(k t_j')/2k_j as the chain
  relaxes to equilibrium, where the contact carries t_j'.
* The rest of the work of the drive is stored.

Stresses are kept block by block (`slippulse_jax.lattice.cascade`); load, like released stress, enters a block through its
edges. For each block the series keeps a lower bound on the load of its next break: exact when the block was last opened,
lowered by whatever has arrived since. The next break is found by opening the few blocks that may hold it, at O(√N) per event.
"""

from collections.abc import Callable
from functools import partial
from types import NoneType
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.block import Block
from slippulse_jax.bulk.compiler import in_full, lane_by_lane
from slippulse_jax.derivatives import without_derivative
from slippulse_jax.domains import Domain, check_kind, check_whole
from slippulse_jax.interface import Interface, Profile
from slippulse_jax.lattice import blocks, waveguide
from slippulse_jax.lattice.ageing import Ageing, next_crossing
from slippulse_jax.lattice.cascade import (
    Cascade,
    Moves,
    Stresses,
    all_opened,
    looked_at,
    most,
    opened,
    run,
    slack,
    whole,
)
from slippulse_jax.lattice.catalogue import Catalogue, EventClass, SeriesStatus
from slippulse_jax.lattice.chain import Chain, State, check_linear, driven, potential_energy
from slippulse_jax.lattice.equilibrium import all_numbers, equilibrium
from slippulse_jax.lattice.front import event_length
from slippulse_jax.lattice.response import Response, into_blocks, of_matrix, shared_response


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

POSITIVE = Domain(0, float("inf"), "must be positive and finite")


def series(
    body: Chain | Block,
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
    """Load a relaxed chain or block through `events` events.

    Parameters
    ----------
    body : Chain or Block
        A chain with linear contacts, whose thresholds and prestress may have any profile. Or a block whose pusher is displaced;
        "the left edge" of what follows is then its pusher.
    protocol : Adiabatic, Steps or Spring
    events : int
        Number of events, and of rows in the catalogue.
    interface : Interface or Profile, optional
        Thresholds and prestress of the contacts of a block; a chain has its own.
    sites : int, optional
        Number of contacts resolved of a block without end, which must be given; from 2 to 8192.
    ageing : Ageing, optional
        Contacts that never broke have the thresholds of the chain; those that did are reborn weak. By default they recover
        immediately.
    repin_delay : int
        Number n of breaks for which a broken contact stays detached: it repins, at zero stretch, when the nth contact after
        it breaks, or when the event ends. For a front that breaks one contact after another this is the delay in sites of
        `Interface`.
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
        It carries a status (`SeriesStatus`) instead of raising an exception. Composes with ``jit`` and ``vmap``.

    Raises
    ------
    ValueError
        If a size is not positive, the chain has nonlinear contacts, or the force on a block is held.
    TypeError
        If `protocol` is not a protocol, or if the series is differentiated: a comparison decides which contact breaks next.
    """
    check_kind("body", body, Chain, Block)
    check_kind("interface", interface, Interface, Profile, NoneType)
    if isinstance(body, Chain):
        check_linear(body, "a series")
        if interface is not None or sites is not None:
            given = f"sites = {sites}" if interface is None else f"interface = {interface!r}"
            raise ValueError(f"{given}: that is for a block; a chain has its own contacts")
        sites = body.sites
    else:
        sites = _sites_of_block(body, interface, sites)
    check_whole("events", events, 1)
    check_whole("recorded_breaks", recorded_breaks, 0)
    check_whole("repin_delay", repin_delay, 0)
    if not isinstance(protocol, Protocol):
        raise TypeError(f"protocol = {protocol!r}: must be Adiabatic(), Steps(size) or Spring(stiffness)")
    for name in ("size", "stiffness", "velocity"):
        POSITIVE.check(f"{type(protocol).__name__}.{name}", getattr(protocol, name, 1.0))
    stopping = Stopping(
        jnp.asarray(jnp.inf if until is None else until, jnp.asarray(body.stiffness).dtype),
        jnp.asarray(stop_when_spanning),
        jnp.asarray(50 * sites if max_breaks is None else max_breaks, jnp.int32),
    )
    shape = Shape(events, recorded_breaks, repin_delay, sites)
    run_series = _hard_series if isinstance(body, Chain) else blocks.in_double(_hard_series)
    return run_series(shape, (body, interface), protocol, ageing, stopping)


def _sites_of_block(block: Block, interface: Interface | Profile | None, sites: int | None) -> int:
    """Number of contacts resolved of a block."""
    if block.push.control != "displacement":
        raise ValueError("push.control = 'force': the pusher of a series is displaced; pull it through a soft Spring instead")
    if interface is not None and interface.repin_delay:
        raise ValueError(f"interface.repin_delay = {interface.repin_delay}: give the delay to series, as repin_delay")
    if sites is None and block.contacts is None:
        raise ValueError(f"{block} has no end: give sites, the number of contacts resolved")
    found = blocks.checked_sites(block, block.contacts if sites is None else sites)
    return block.contacts or found


class Shape(NamedTuple):
    """Arguments that set the shape of a compiled series."""

    events: int
    recorded: int  # breaks
    delay: int  # breaks for which a contact stays detached
    sites: int


class Stopping(NamedTuple):
    """What ends a series besides its number of events; one program serves any."""

    until: Float[Array, ""]  # load; inf for none
    when_spanning: Array  # whether with the first event that breaks the last contact
    max_breaks: Int[Array, ""]  # of one event


class LoadedBody(NamedTuple):
    """What is loaded, before it is."""

    response: Response
    effects: "Effects"
    prestress: Float[Array, "B M"]  # the only stress while it is relaxed
    valid: Array
    sites: int  # with the driver's
    ahead: int  # sites before those of the body: the driver's
    afresh: Callable[[State], tuple[Float[Array, " N"], Float[Array, ""]]]  # stresses and potential energy, solved anew


def _series(
    shape: Shape,
    given: tuple[Chain | Block, Interface | Profile | None],
    protocol: Protocol,
    ageing: Ageing | None,
    stopping: Stopping,
) -> Catalogue:
    body, interface = given
    spring = protocol.stiffness if isinstance(protocol, Spring) else None
    if isinstance(body, Block):

        def on_block(block: Block, interface: Interface | Profile | None, spring: Array | None, *more: Any) -> Catalogue:
            return _one_series(shape, _of_block(block, interface, shape.sites, spring), *more)

        return lane_by_lane(on_block, body, interface, spring, protocol, ageing, stopping)

    def on_chain(chain: Chain, resp: Response, *more: Any) -> Catalogue:
        return _one_series(shape, _of_chain(chain, resp, spring is not None), *more)

    chain = body if spring is None else driven(body, spring)
    return lane_by_lane(on_chain, chain, shared_response(chain), protocol, ageing, stopping)


def _of_chain(chain: Chain, resp: Response, behind_spring: bool) -> LoadedBody:
    prestress = jnp.where(chain.contact > 0, chain.prestress, 0)
    holds = (chain.threshold > prestress).all() & (chain.threshold > 0).all()

    def afresh(state: State) -> tuple[Array, Array]:
        solved = equilibrium(chain, state)
        return solved.stress, potential_energy(chain, (solved.upper, solved.layer), state.pinning)

    return LoadedBody(
        response=resp,
        effects=tabulated(chain.contact, chain.threshold, chain.stiffness, resp),
        prestress=into_blocks(prestress, resp.near.shape[1]),
        valid=all_numbers(chain, chain.relaxed()) & ~resp.right.floating & holds,
        sites=chain.sites,
        ahead=int(behind_spring),
        afresh=afresh,
    )


def _of_block(block: Block, interface: Interface | Profile | None, sites: int, spring: Array | None) -> LoadedBody:
    given, k = blocks.contacts_of(block, interface, 1 << (sites - 1).bit_length()), jnp.asarray(block.stiffness)
    edge = waveguide.edge_stiffness(blocks.guide_of(block), k, given.response)
    return of_response(given, sites, k, edge, spring)


def of_response(given: blocks.BlockContacts, sites: int, k: Array, edge: Array, spring: Array | None) -> LoadedBody:
    """The first `sites` contacts of a response that is a matrix; a spring to the driver makes the pusher give way.

    Parameters
    ----------
    given : BlockContacts
        A power of two of them.
    sites : int
    k : array, shape ()
        Stiffness of a contact, in K.
    edge : array, shape ()
        Force on the pusher per load, in K.
    spring : array, shape (), optional
        In K.
    """
    (push, matrix), threshold, prestress, _, valid = given
    there = jnp.arange(push.size) < sites
    prestress = jnp.where(there, prestress, 0)
    if spring is not None:
        share = spring / (spring + edge)
        matrix = matrix + jnp.outer(push, push) * k / (spring + edge)
        push, edge = push * share, edge * share
    resp = of_matrix(matrix, push, edge)

    @in_full
    def afresh(state: State) -> tuple[Array, Array]:
        u, p, driven, own = state.load, state.pinning, state.load * push[:sites], prestress[:sites]
        apart = p - matrix[:sites, :sites] @ p
        return own + driven - apart, edge * u**2 / 2 + k * (p * (apart / 2 - driven - own)).sum()

    return LoadedBody(
        response=resp,
        effects=tabulated(jnp.where(there, k, 0), threshold, k, resp),
        prestress=prestress[None],
        valid=valid & jnp.isfinite(matrix).all() & ((threshold > prestress) & (threshold > 0) | ~there).all(),
        sites=sites,
        ahead=0,
        afresh=afresh,
    )


def _one_series(shape: Shape, body: LoadedBody, protocol: Protocol, ageing: Ageing | None, stopping: Stopping) -> Catalogue:
    step = jnp.asarray(protocol.size, body.prestress.dtype) if isinstance(protocol, Steps) else None
    by = Loading(shape, body, ageing, jnp.asarray(protocol.velocity), step, stopping)
    end = load_through(by, start(by))
    pinning = by.body.effects.gains[:, :, 1] * end.given
    state = State(pinning.reshape(-1)[: body.sites], end.numbers.load)
    stress, stored = body.afresh(state)
    columns = recorded(by, end)
    last = jnp.arange(shape.events, dtype=jnp.int32) == columns["number"] - 1
    booked = columns["stored"].sum(where=last & (columns["kind"] >= 0))
    return Catalogue(
        **columns,
        state=State(state.pinning[body.ahead :], state.load),
        drift=jnp.abs(all_opened(body.response, end.stresses).reshape(-1)[: body.sites] - stress).max(),
        energy_drift=jnp.abs(booked - stored),
        status=end.ending,
    )


_hard_series = without_derivative(
    _series,
    "a series of hard events cannot be differentiated: a comparison decides which contact breaks next",
    static_argnums=(0,),
)


# --- effects of loading and breaking each contact ---


class Effects(NamedTuple):
    """Effects of loading and breaking each of B blocks of M contacts."""

    threshold: Float[Array, "B M"]  # of a contact that never broke; inf where there is none
    per_load: Float[Array, "B M"]  # stress per load
    hastened: Float[Array, "B 4"]  # largest reduction of the load at a contact's break, per displacement at a block's edges
    gains: Float[Array, "B M 3"]  # per stress released: force lost at the edge, slip, stress lost by the whole chain
    energy: Float[Array, "B M"]  # k²/2k_i
    edge_stiffness: Float[Array, ""]  # force on the edge per load


def tabulated(contact: Float[Array, " N"], threshold: Float[Array, " N"], k: Array, resp: Response) -> Effects:
    """Tabulate the effect of loading and breaking each contact."""
    size = resp.near.shape[1]
    q = into_blocks(contact, size)
    per_load = (resp.at_load[:, :, None] * resp.read).sum(1)
    pulled = per_load[:, None] > 0
    soft = k / jnp.where(q > 0, q, jnp.inf)
    # stress that a break adds to the contacts of its own block, and of the blocks beyond
    felt = resp.pass_on * resp.read.sum(-1)[None, :, :, None]
    beyond = jnp.concatenate([felt[:, :, :2].sum((1, 2)), felt[:, :, 2:].sum((1, 2))], -1)
    lost = 1 - resp.near.sum(-1) - (resp.leave * beyond[:, None]).sum(-1)
    return Effects(
        threshold=into_blocks(jnp.where(contact > 0, threshold, jnp.inf), size, jnp.inf),
        per_load=per_load,
        hastened=jnp.where(pulled, resp.read / jnp.where(pulled, per_load[:, None], 1), 0).max(-1),
        gains=jnp.stack([k * per_load * soft, soft, lost], -1),
        energy=soft * k / 2,
        edge_stiffness=resp.edge_stiffness,
    )


# --- from event to event ---


class Numbers(NamedTuple):
    """Quantities of an event, recorded as one vector."""

    load: Array
    force_before: Array  # on the left edge as the event began
    work: Array
    force_lost: Array
    slip: Array
    stress_drop: Array
    broken: Array
    relaxed: Array
    length: Array  # ℓ, in λc from the first site


class Counts(NamedTuple):
    """Counts and sites of an event, recorded as one vector."""

    number: Array  # −1 before the first event
    first: Array  # site that broke first
    at_peak: Array  # whether its left neighbour last broke in a later event than it did
    left: Array
    right: Array
    breaks: Array
    total: Array  # of breaks, in all events


class Tally(NamedTuple):
    """Sums over the breaks of the current event."""

    lost: Float[Array, "3"]  # sum of `Effects.gains` over the breaks
    broken: Array
    relaxed: Array
    first: Array  # −1 before the first break
    at_peak: Array
    left: Array
    right: Array
    peak: Array  # overload of the rightmost broken contact as it first broke in the event
    total: Array
    last: Int[Array, " S"]
    log: Int[Array, "L+1 2"]


class Now(NamedTuple):
    """State between two events, in B blocks of M.

    S = BM is the number of sites. The last row of each table is scratch space.
    """

    stresses: Stresses
    soonest: Float[Array, " B"]  # no contact of a block breaks before this load
    given: Float[Array, "B M"]  # stress released by each contact so far
    born: Float[Array, "B M"] | None  # load at the last break, if contacts age; −inf if never
    last: Int[Array, " S"]  # event of the last break; −1 if never
    numbers: Numbers  # of the last event
    counts: Counts
    ending: Int[Array, ""]  # a `SeriesStatus`, or −1
    number_table: Float[Array, "E+1 9"]
    count_table: Int[Array, "E+1 7"]
    log: Int[Array, "L+1 2"]  # site and event of every break


class Loading(NamedTuple):
    """Constants of a series."""

    shape: Shape
    body: LoadedBody
    ageing: Ageing | None
    velocity: Array
    step: Array | None  # load step; None: exactly to the next break
    stopping: Stopping


def start(by: Loading) -> Now:
    """Make the state of the relaxed chain, before the first event."""
    prestress, before = by.body.prestress, by.body.ahead - 1
    zero, none = jnp.zeros((), prestress.dtype), jnp.zeros((), jnp.int32)
    return Now(
        stresses=whole(prestress, by.body.effects.threshold),
        soonest=jnp.full_like(prestress[:, 0], -jnp.inf),
        given=jnp.zeros_like(prestress),
        born=jnp.full_like(prestress, -jnp.inf) if by.ageing is not None else None,
        last=jnp.full(prestress.size, -1, jnp.int32),
        numbers=Numbers(*(zero,) * len(Numbers._fields)),
        counts=Counts(*(none,) * 7)._replace(number=none - 1),
        ending=jnp.where(by.body.valid, -1, SeriesStatus.INVALID).astype(jnp.int32),
        number_table=jnp.full((by.shape.events + 1, len(Numbers._fields)), jnp.nan, prestress.dtype),
        count_table=jnp.tile(jnp.array([-1, before, 0, before, before, 0, 0], jnp.int32), (by.shape.events + 1, 1)),
        log=jnp.full((by.shape.recorded + 1, 2), -1, jnp.int32),
    )


def load_through(by: Loading, now: Now) -> Now:
    """Run events until the series ends."""
    return lax.while_loop(lambda now: now.ending < 0, partial(_next_event, by), now)


def _next_event(by: Loading, now: Now) -> Now:
    """Load to the next break, run the rupture and record it."""
    tables, before = by.body.effects, now.numbers
    found = _next_crossing(by, now)
    rise, trigger = _raised(by, found)
    load, number = before.load + rise, now.counts.number + 1
    stresses = found.stresses._replace(inbox=found.stresses.inbox + by.body.response.at_load * rise)
    broken = _rupture(by, now, stresses, load, trigger)
    tally, begins = broken.book, jnp.isfinite(found.rise)
    force_before = before.force_before - before.force_lost  # the force now
    force = force_before + tables.edge_stiffness * rise
    work = (force_before + force) / 2 * rise
    force_lost, slip, stress_drop = tally.lost
    length = _length(by, now, broken, load)
    numbers = Numbers(load, force, work, force_lost, slip, stress_drop, tally.broken, tally.relaxed, length)
    counts = Counts(number, tally.first, tally.at_peak, tally.left, tally.right, broken.breaks, tally.total)
    over = (broken.breaks >= by.stopping.max_breaks) & (broken.overload >= 0)
    last = (number == by.shape.events - 1) | (load >= by.stopping.until)
    endings = [~begins, over, by.stopping.when_spanning & (counts.right == by.body.sites - 1), last]
    reasons = [SeriesStatus.NOTHING_LEFT, SeriesStatus.LIMIT, SeriesStatus.SPANNED, SeriesStatus.DONE]
    row = jnp.where(begins, number, by.shape.events)
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
    """State of the search for the next contact to reach its threshold."""

    stresses: Stresses
    soonest: Float[Array, " B"]
    looked: Array  # whether each block has been opened, shape (B,)
    rise: Float[Array, ""]  # smallest increase of load found
    site: Int[Array, ""]  # contact that it brings to its threshold


def _next_crossing(by: Loading, now: Now) -> Crossing:
    """Find the smallest load increase that brings a contact to its threshold.

    The rise is inf if there is none.
    """
    tables, size, load = by.body.effects, now.given.shape[1], now.numbers.load

    def going(c: Crossing) -> Array:
        lowest = jnp.where(c.looked, jnp.inf, c.soonest).min()
        return (lowest < jnp.inf) & (lowest <= (load + c.rise) * slack(load))

    def look(c: Crossing) -> Crossing:
        block = most(jnp.where(c.looked, -jnp.inf, -c.soonest))[0]
        stress, per_load = opened(by.body.response, c.stresses, block), tables.per_load[block]
        limit, _ = _limits(by, now, load, block, now.given[block])
        pulled = per_load > 0
        missing = jnp.where(pulled, (limit - stress) / jnp.where(pulled, per_load, 1), jnp.inf)
        rises = missing
        if now.born is not None and by.ageing is not None:
            ages = load - now.born[block]
            rises = next_crossing(by.ageing, stress, per_load, tables.threshold[block], ages, by.velocity)
        place, rise = most(-rises)
        better = -rise < c.rise
        return Crossing(
            stresses=looked_at(by.body.response, c.stresses, block, (stress - limit).max()),
            soonest=c.soonest.at[block].set(load + missing.min()),  # thresholds only grow, so this is a lower bound
            looked=c.looked.at[block].set(True),
            rise=jnp.where(better, -rise, c.rise),
            site=jnp.where(better, block * size + place, c.site),
        )

    never, none = jnp.full_like(load, jnp.inf), jnp.zeros((), jnp.int32)
    return lax.while_loop(going, look, Crossing(now.stresses, now.soonest, jnp.zeros(now.soonest.shape, bool), never, none))


def _raised(by: Loading, found: Crossing) -> tuple[Array, Array]:
    """Return the load increase and the contact that must break first.

    The contact breaks first whatever the rounding; −1 for none.
    """
    rise = jnp.maximum(found.rise, 0)
    trigger = jnp.where(jnp.isfinite(rise), found.site, -1)
    if by.step is not None:
        close = 1e4 * jnp.finfo(rise.dtype).eps
        whole_steps = jnp.maximum(jnp.ceil(rise / by.step - close), 1) * by.step
        trigger = jnp.where(
            whole_steps > rise + close * by.step, -1, trigger
        )  # beyond the crossing the most overloaded contact breaks first
        rise = whole_steps
    return jnp.where(jnp.isfinite(found.rise), rise, 0), trigger


def _limits(by: Loading, now: Now, load: Array, block: Array, given: Array) -> tuple[Array, Array]:
    """Return a block's thresholds at this load, current and after a break; `given` is the stress released so far."""
    old = by.body.effects.threshold[block]
    if now.born is None or by.ageing is None:
        return old, old
    born = jnp.where(given > now.given[block], load, now.born[block])
    return old * by.ageing.strength(load - born, by.velocity), old * by.ageing.newborn


def _length(by: Loading, now: Now, broken: Cascade, load: Array) -> Array:
    """Interpolate ℓ of the event, where the stress falls to the threshold; inf where there is no contact ahead."""
    right, peak = broken.book.right, broken.book.peak
    block, place = jnp.divmod(jnp.minimum(right + 1, by.body.sites - 1), broken.given.shape[1])
    limit, _ = _limits(by, now, load, block, broken.given[block])
    ahead = opened(by.body.response, broken.stresses, block)[place] - limit[place]
    return jnp.where(right == by.body.sites - 1, jnp.inf, event_length(right, peak, ahead))


def _limit_of(by: Loading, now: Now, load: Array, site: Array) -> Array:
    """Return the threshold at this load of one contact that has not broken in this event."""
    old = by.body.effects.threshold.reshape(-1)[site]
    if now.born is None or by.ageing is None:
        return old
    return old * by.ageing.strength(load - now.born.reshape(-1)[site], by.velocity)


def _rupture(by: Loading, now: Now, stresses: Stresses, load: Array, trigger: Array) -> Cascade:
    """Run the rupture of one event and sum over its breaks."""
    energy, number = by.body.effects.energy.reshape(-1), now.counts.number + 1
    gains = by.body.effects.gains.reshape(-1, 3)

    def note(tally: Tally, moves: Moves, t: Array, after: Array) -> Tally:
        site, log, lost = moves.sites[-1], tally.log, tally.lost
        if by.shape.recorded:
            entry = jnp.stack([site, number])[None]
            log = lax.dynamic_update_slice_in_dim(log, entry, jnp.minimum(tally.total, by.shape.recorded), 0)
        for j in range(moves.sites.shape[0]):
            lost = lost + gains[moves.sites[j]] * moves.given[j]
        stretch, begins = energy[site] * t, tally.first < 0
        newer = (site > by.body.ahead) & (tally.last[jnp.maximum(site - 1, 0)] > tally.last[site])
        return Tally(
            lost=lost,
            broken=tally.broken + stretch * t,
            relaxed=tally.relaxed + stretch * after,
            first=jnp.where(begins, site, tally.first),
            at_peak=jnp.where(begins, newer.astype(jnp.int32), tally.at_peak),
            left=jnp.minimum(tally.left, site),
            right=jnp.maximum(tally.right, site),
            peak=jnp.where(site > tally.right, t - _limit_of(by, now, load, site), tally.peak),
            total=tally.total + 1,
            last=tally.last.at[site].set(number),
            log=log,
        )

    zero, none = jnp.zeros((), load.dtype), jnp.zeros((), jnp.int32)
    places = none - 1, none, none + by.body.sites, none - 1
    tally = Tally(jnp.zeros(3, load.dtype), zero, zero, *places, zero, now.counts.total, now.last, now.log)
    limits = partial(_limits, by, now, load)
    return run(by.stopping.max_breaks, by.shape.delay, by.body.response, stresses, now.given, limits, trigger, tally, note)


def recorded(by: Loading, end: Now) -> dict[str, Array]:
    """Make the columns of the catalogue."""
    number, count = Numbers(*end.number_table[:-1].T), Counts(*end.count_table[:-1].T)
    kinds = [count.number < 0, count.right == by.body.sites - 1, count.first == by.body.ahead, count.at_peak == 1]
    kind = jnp.select(kinds, [-1, EventClass.SPANNING, EventClass.EDGE, EventClass.RENUCLEATED], EventClass.INTERIOR)
    return {
        "load": number.load,
        "force_before": number.force_before,
        "force_after": number.force_before - number.force_lost,
        "site": count.first - by.body.ahead,
        "leftmost": count.left - by.body.ahead,
        "extent": count.right + 1 - by.body.ahead,
        "length": number.length - by.body.ahead,
        "breaks": count.breaks,
        "slip": number.slip,
        "stress_drop": number.stress_drop,
        "work": number.work,
        "stored": jnp.cumsum(number.work - number.broken - number.relaxed),
        "broken": number.broken,
        "relaxed": number.relaxed,
        "kind": kind.astype(jnp.int32),
        "number": (count.number >= 0).sum().astype(jnp.int32),
        "break_site": jnp.where(end.log[:-1, 1] >= 0, end.log[:-1, 0] - by.body.ahead, -1),
        "break_event": end.log[:-1, 1],
    }
