r"""A series of events: a chain loaded on and on, one rupture after another.

Between events every stress grows linearly with the load, so that the next break is found exactly. In an event contacts break
as in `slippulse_jax.lattice.cascade`, the most overloaded first, at fixed load. All sums are updated from break to break, and
the chain is solved only once, before the first event:

* a break at j that gives up the stress t_j adds q_i G_ij t_j to every stress (`slippulse_jax.lattice.response`);
* by reciprocity it lowers the force on the left edge by k t_j du_j/dU;
* it gives up the energy (k t_j)²/2k_j of the broken contact's own stretch, and (k t_j)(k t_j')/2k_j on top of it as the chain
  relaxes to equilibrium, t_j' being what the contact carries then.

The energy stored follows from the state alone, Π = ½ F U − ½ Σ k (t_i + φ_i) u_b,i, so that drive, store and loss check each
other.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, Int
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.lattice.ageing import Ageing, next_crossing
from slippulse_jax.lattice.chain import Chain, State, driven, relaxed
from slippulse_jax.lattice.equilibrium import EquilibriumStatus, equilibrium
from slippulse_jax.lattice.response import Response, arriving, into_blocks, response
from slippulse_jax.status import Status


class SeriesStatus(Status):
    """How a series ended."""

    DONE = 0, "done: as many events as were asked for"
    SPANNED = 1, "ended by an event that broke the last contact of the chain"
    NOTHING_LEFT = 2, "ended early: no load brings a further contact to its threshold"
    LIMIT = 3, "given up: contacts were still over threshold after max_breaks breaks of one event"
    INVALID = 4, "no such chain: a part is held by nothing, or a value is outside its domain"


class EventClass(Status):
    """What kind of event it was; the first that fits."""

    SPANNING = 0, "broke the last contact of the chain"
    EDGE = 1, "nucleated at the left edge"
    CREEP = 2, "nucleated at a stress peak, on the contact just ahead of where an earlier event had stopped"
    INTERIOR = 3, "nucleated anywhere else"


class Adiabatic(eqx.Module):
    """The left edge is pushed exactly to the next break, and waits while the event runs."""

    velocity: Float[AnyArrayLike, ""] = 1.0  # of the left edge, for ageing in time only; u_s per time


class Steps(eqx.Module):
    """The left edge is pushed by whole steps of `size` u_s; each event starts with all that a step has overloaded."""

    size: Float[AnyArrayLike, ""]
    velocity: Float[AnyArrayLike, ""] = 1.0


class Spring(eqx.Module):
    """A driver moves the left edge through a spring of `stiffness` (in K); the load is the driver's displacement."""

    stiffness: Float[AnyArrayLike, ""]
    velocity: Float[AnyArrayLike, ""] = 1.0


Protocol = Adiabatic | Steps | Spring


class Catalogue(NamedTuple):
    """Events of a series in order; displacements in u_s, stresses in σ_s, forces in K u_s, energies in K u_s².

    Rows beyond `number` are empty: kind −1, numbers NaN or 0.
    """

    load: Float[Array, " E"]  # U (of the driver, with a spring)
    force_before: Float[Array, " E"]  # on the left edge, as the event starts
    force_after: Float[Array, " E"]
    site: Int[Array, " E"]  # that broke first
    leftmost: Int[Array, " E"]
    extent: Int[Array, " E"]  # sites from the left edge to the rightmost broken one, which is among them
    breaks: Int[Array, " E"]
    slip: Float[Array, " E"]  # sum over contacts of how far pinning points moved
    stress_drop: Float[Array, " E"]  # sum over contacts of stress before − after
    work: Float[Array, " E"]  # of the drive since the event before
    stored: Float[Array, " E"]  # potential energy after the event
    broken: Float[Array, " E"]  # energy of the stretch of the contacts that broke
    relaxed: Float[Array, " E"]  # energy given up as the chain relaxed after the breaks
    kind: Int[Array, " E"]  # an EventClass
    number: Int[Array, ""]  # of events
    break_site: Int[Array, " L"]  # every break in order, as far as `recorded_breaks` goes; −1 beyond
    break_event: Int[Array, " L"]
    state: State  # at the end
    drift: Float[Array, ""]  # largest error of a stress accumulated over all breaks, in σ_s
    status: Int[Array, ""]  # a SeriesStatus


class _Now(NamedTuple):
    """A series under way, stresses and the like in B blocks of M sites."""

    stress: Array
    pinning: Array
    born: Array  # load at the last break; −inf if never
    last: Array  # event of the last break; −1 if never
    load: Array
    force: Array
    stored: Array
    total: Array  # breaks
    rows: Any
    event: Array
    ended: Array  # a SeriesStatus, or −1


_EMPTY = {"kind": -1, "site": -1, "leftmost": -1, "extent": 0, "breaks": 0}
_ROWS = Catalogue._fields[: Catalogue._fields.index("number")]


def series(
    chain: Chain,
    protocol: Protocol = Adiabatic(),  # noqa: B008 - a constant
    *,
    events: int,
    ageing: Ageing | None = None,
    stop_when_spanning: bool = True,
    max_breaks: int | None = None,
    recorded_breaks: int = 0,
) -> Catalogue:
    """Load a relaxed chain through `events` events.

    Parameters
    ----------
    chain : Chain
        With linear contacts; thresholds and prestress of any profile.
    protocol : Adiabatic, Steps or Spring
    events : int
        Number of events, and of rows.
    ageing : Ageing, optional
        Contacts that never broke have the chain's thresholds; those that did start anew, weak. None: immediate recovery.
    stop_when_spanning : bool
        End with the first event that breaks the last contact; of a semi-infinite chain nothing is resolved beyond.
    max_breaks : int, optional
        Breaks of one event after which the series is given up; 50 N by default.
    recorded_breaks : int
        Room for a record of every break, for the space–time map.

    Returns
    -------
    Catalogue
        With a status (`SeriesStatus`) instead of an exception. Composes with ``jit`` and ``vmap``.

    Raises
    ------
    ValueError
        If a size is not positive or the chain has nonlinear contacts.
    TypeError
        If `protocol` is none, or the series is differentiated: which contact breaks next is a comparison.
    """
    if chain.law is not None:
        raise ValueError("a series needs linear contacts: this chain has a force law")
    if events < 1:
        raise ValueError(f"events = {events}: must be at least 1")
    if not isinstance(protocol, Protocol):
        raise TypeError(f"protocol = {protocol!r}: must be Adiabatic(), Steps(size) or Spring(stiffness)")
    for name in ("size", "stiffness", "velocity"):
        value = getattr(protocol, name, 1.0)
        if not isinstance(value, Tracer) and not np.all(np.asarray(value) > 0):
            raise ValueError(f"{type(protocol).__name__}.{name} = {value}: must be positive")
    max_breaks = 50 * chain.sites if max_breaks is None else max_breaks
    shape = (events, max_breaks, recorded_breaks, stop_when_spanning)
    return _hard_series(shape, chain, protocol, ageing)


def _series(  # noqa: C901 - one loop in a loop, and the helpers that share its constants
    shape: tuple[int, int, int, bool], chain: Chain, protocol: Protocol, ageing: Ageing | None
) -> Catalogue:
    events, max_breaks, recorded, stop = shape
    velocity = jnp.asarray(protocol.velocity)
    sites = chain.sites
    ahead = int(isinstance(protocol, Spring))  # sites put before the chain's own
    if isinstance(protocol, Spring):
        chain = driven(chain, protocol.stiffness)
    start = relaxed(chain)
    at_rest, pushed = equilibrium(chain, start), equilibrium(chain, State(start.pinning, start.load + 1))
    resp = response(chain)
    resp = resp[0] if not isinstance(resp, Response) else resp
    size = resp.near.shape[1]
    k = chain.stiffness
    q = into_blocks(chain.contact, size)
    threshold = into_blocks(jnp.where(chain.contact > 0, chain.threshold, jnp.inf), size, jnp.inf)
    per_load = into_blocks((pushed.stress - at_rest.stress) * (chain.contact > 0), size)
    prestress = into_blocks(chain.prestress * (chain.contact > 0), size)
    soft = k / jnp.where(q > 0, q, jnp.inf)  # slip per stress given up
    edge_gain = k * per_load * soft  # force on the edge per stress given up
    index = jnp.arange(q.size).reshape(q.shape)
    stiff = pushed.push - at_rest.push
    valid = (
        (at_rest.status == EquilibriumStatus.SOLVED) & (chain.threshold > at_rest.stress).all() & (chain.threshold > 0).all()
    )

    def strength(now: _Now) -> Array:
        return threshold if ageing is None else threshold * ageing.strength(now.load - now.born, velocity)

    def next_load(now: _Now) -> Array:
        if ageing is None:
            pulled = per_load > 0
            missing = jnp.where(pulled, (threshold - now.stress) / jnp.where(pulled, per_load, 1), jnp.inf)
        else:
            missing = next_crossing(ageing, now.stress, per_load, threshold, now.load - now.born, velocity)
        return jnp.maximum(missing, 0)

    def break_one(now: _Now, where: Array, event: Array) -> tuple[_Now, Array, Array]:
        b, m = where // size, where % size
        t = now.stress[b, m]
        stress = now.stress + (arriving(resp, b, m)[:, :, None] * resp.read).sum(1) * t
        stress = stress.at[b].add(resp.near[b, m] * t).at[b, m].add(-t)
        slip = t * soft[b, m]
        moved = now._replace(
            stress=stress,
            pinning=now.pinning.at[b, m].add(slip),
            born=now.born.at[b, m].set(now.load),
            last=now.last.at[b, m].set(event),
            force=now.force - t * edge_gain[b, m],
            total=now.total + 1,
        )
        return moved, t * slip * k / 2, stress[b, m] * slip * k / 2

    def one_event(now: _Now) -> _Now:
        missing = next_load(now)
        first = jnp.argmin(missing.min(1))
        site = first * size + jnp.argmin(missing[first])
        rise = missing.reshape(-1)[site]
        if isinstance(protocol, Steps):
            rise = jnp.maximum(jnp.ceil(rise / protocol.size - 1e-9), 1) * protocol.size
        found = jnp.isfinite(rise)
        rise = jnp.where(found, rise, 0)
        force = now.force + stiff * rise
        loaded = now._replace(stress=now.stress + per_load * rise, load=now.load + rise, force=force)
        if isinstance(protocol, Steps):
            over = loaded.stress - strength(loaded)
            site = jnp.argmax(over.reshape(-1))
        before = loaded.stress.sum()
        left_newer = (now.last.reshape(-1)[jnp.maximum(site - 1, 0)] > now.last.reshape(-1)[site]) & (site > ahead)

        def body(carry: tuple) -> tuple:
            here, chosen, n, broken, loosened, left, right, slipped, log = carry
            after, b, r = break_one(here, chosen, now.event)
            over = after.stress - strength(after)
            block = jnp.argmax(over.max(1))
            following = block * size + jnp.argmax(over[block])
            following = jnp.where(over.max() >= 0, following, -1)
            if recorded:
                at = jnp.where(here.total < recorded, here.total, recorded)
                log = (
                    log[0].at[at].set((chosen - ahead).astype(jnp.int32), mode="drop"),
                    log[1].at[at].set(now.event, mode="drop"),
                )
            moved = after.pinning.reshape(-1)[chosen] - here.pinning.reshape(-1)[chosen]
            return (after, following, n + 1, broken + b, loosened + r, jnp.minimum(left, chosen), jnp.maximum(right, chosen),
                    slipped + moved, log)  # fmt: skip

        zero = jnp.zeros_like(now.load)
        none = jnp.zeros((), index.dtype)
        bare = loaded._replace(rows=None)  # keep the table out of the inner loop
        carry = (bare, jnp.where(found, site, -1), none, zero, zero, none + index.size, none - 1, zero, now.rows["log"])
        end = lax.while_loop(lambda c: (c[1] >= 0) & (c[2] < max_breaks), body, carry)
        after, unfinished, n, broken, loosened, left, right, slipped, log = end
        spanned = right == sites - 1 + ahead
        stored = after.force * after.load / 2 - k * ((after.stress + prestress) * after.pinning).sum() / 2
        kinds = [spanned, site == ahead, left_newer]
        row = {
            "load": after.load,
            "force_before": force,
            "force_after": after.force,
            "site": site - ahead,
            "leftmost": left - ahead,
            "extent": right + 1 - ahead,
            "breaks": n,
            "slip": slipped,
            "stress_drop": before - after.stress.sum(),
            "work": (now.force + force) / 2 * rise,
            "stored": stored,
            "broken": broken,
            "relaxed": loosened,
            "kind": jnp.select(kinds, [EventClass.SPANNING, EventClass.EDGE, EventClass.CREEP], EventClass.INTERIOR),
        }
        at = jnp.where(found, now.event, events)
        rows = {name: now.rows[name].at[at].set(row[name].astype(now.rows[name].dtype), mode="drop") for name in _ROWS}
        endings = [~found, unfinished >= 0, spanned & stop]
        ended = jnp.select(endings, [SeriesStatus.NOTHING_LEFT, SeriesStatus.LIMIT, SeriesStatus.SPANNED], -1)
        return after._replace(rows=rows | {"log": log}, event=now.event + found, stored=stored, ended=ended.astype(jnp.int32))

    dtype = chain.contact.dtype
    stress = into_blocks(at_rest.stress, size)
    whole = jnp.zeros((), jnp.int32)
    rows: dict[str, Any] = {
        name: jnp.full(events, _EMPTY[name], jnp.int32) if name in _EMPTY else jnp.full(events, jnp.nan, dtype)
        for name in _ROWS
    }
    rows["log"] = (jnp.full(recorded, -1, jnp.int32),) * 2
    now = _Now(
        stress=stress,
        pinning=jnp.zeros_like(stress),
        born=jnp.full_like(stress, -jnp.inf),
        last=jnp.full(stress.shape, -1, jnp.int32),
        load=start.load,
        force=at_rest.push,
        stored=jnp.zeros_like(start.load),
        total=whole,
        rows=rows,
        event=whole,
        ended=jnp.where(valid, -1, SeriesStatus.INVALID).astype(jnp.int32),
    )
    end = lax.while_loop(lambda n: (n.event < events) & (n.ended < 0), one_event, now)
    count = chain.sites
    state = State(end.pinning.reshape(-1)[:count], end.load)
    drift = jnp.abs(end.stress.reshape(-1)[:count] - equilibrium(chain, state).stress).max()
    log = end.rows.pop("log")
    status = jnp.where(end.ended < 0, SeriesStatus.DONE, end.ended)
    return Catalogue(
        **end.rows, number=end.event, break_site=log[0], break_event=log[1],
        state=State(state.pinning[ahead:], state.load), drift=drift, status=status,
    )  # fmt: skip


_hard_series = jax.custom_jvp(jax.jit(_series, static_argnums=0), nondiff_argnums=(0,))


@_hard_series.defjvp
def _refuse(shape, primals, tangents):
    raise TypeError("a series of hard events cannot be differentiated: which contact breaks next is a comparison")
