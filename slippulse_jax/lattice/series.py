"""A series of events: a chain loaded on and on, one rupture after another.

Protocols, and what a series is asked for; how it is worked out is in `slippulse_jax.lattice.loading`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.bulk.compiler import as_one_kernel
from slippulse_jax.bulk.independence import lane_by_lane
from slippulse_jax.derivatives import without_derivative
from slippulse_jax.lattice.ageing import Ageing
from slippulse_jax.lattice.blocks import all_opened
from slippulse_jax.lattice.breaks import check_delay
from slippulse_jax.lattice.catalogue import Catalogue
from slippulse_jax.lattice.chain import Chain, State, driven, potential_energy, relaxed
from slippulse_jax.lattice.contacts import Contacts, contacts_of
from slippulse_jax.lattice.equilibrium import all_numbers, equilibrium
from slippulse_jax.lattice.loading import Loading, Now, load_through, recorded, start
from slippulse_jax.lattice.response import Response, into_blocks, shared_response


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


def series(
    chain: Chain,
    protocol: Protocol = Adiabatic(),  # noqa: B008 - a constant
    *,
    events: int,
    ageing: Ageing | None = None,
    repin_delay: int = 0,
    until: Float[AnyArrayLike, ""] | None = None,
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
    repin_delay : int
        n, breaks for which a broken contact stays detached: it repins, at zero stretch, when the nth contact after it breaks,
        or when the event ends. For a front that breaks one contact after another, the delay in sites of `Interface`.
    until : array_like, shape (), optional
        Load with which the series ends: the first event at or beyond it is the last.
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
    check_delay(repin_delay)
    if not isinstance(protocol, Protocol):
        raise TypeError(f"protocol = {protocol!r}: must be Adiabatic(), Steps(size) or Spring(stiffness)")
    for name in ("size", "stiffness", "velocity"):
        value = getattr(protocol, name, 1.0)
        if not isinstance(value, Tracer) and not np.all(np.asarray(value) > 0):
            raise ValueError(f"{type(protocol).__name__}.{name} = {value}: must be positive")
    max_breaks = 50 * chain.sites if max_breaks is None else max_breaks
    shape = (events, max_breaks, recorded_breaks, stop_when_spanning, repin_delay)
    return _hard_series(shape, chain, protocol, ageing, None if until is None else jnp.asarray(until, chain.contact.dtype))


Shape = tuple[int, int, int, bool, int]
"""Events, most breaks of one, breaks recorded, whether to stop at the first that spans, repinning delay."""


def _series(shape: Shape, chain: Chain, protocol: Protocol, ageing: Ageing | None, until: Array | None) -> Catalogue:
    chain = driven(chain, protocol.stiffness) if isinstance(protocol, Spring) else chain
    resp = shared_response(chain)
    return lane_by_lane(lambda *given: _one_series(shape, *given), resp, chain, protocol, ageing, until)


def _one_series(
    shape: Shape, resp: Response, chain: Chain, protocol: Protocol, ageing: Ageing | None, until: Array | None
) -> Catalogue:
    events, max_breaks, room, stop, delay = shape
    ahead = int(isinstance(protocol, Spring))  # sites put before the chain's own
    by = Loading(
        response=resp,
        contacts=contacts_of(chain, resp),
        ageing=ageing,
        velocity=jnp.asarray(protocol.velocity),
        step=jnp.asarray(protocol.size, chain.contact.dtype) if isinstance(protocol, Steps) else None,
        sites=chain.sites,
        ahead=ahead,
        delay=delay,
        events=events,
        max_breaks=max_breaks,
        recorded=room,
        stop_when_spanning=stop,
        until=until,
    )
    prestress = jnp.where(chain.contact > 0, chain.prestress, 0)  # all that a relaxed chain carries
    holds = (chain.threshold > prestress).all() & (chain.threshold > 0).all()
    valid = all_numbers(chain, relaxed(chain)) & ~resp.floating & holds

    def loop(resp: Response, contacts: Contacts, prestress: Array, valid: Array, until: Array | None) -> Now:
        now = by._replace(response=resp, contacts=contacts, until=until)
        return load_through(now, start(now, prestress, valid))

    given = resp, by.contacts, into_blocks(prestress, resp.near.shape[1]), valid, until
    end = loop(*given) if delay else as_one_kernel(loop, *given)
    pinning = by.contacts.gains[:, :, 1] * end.given
    state = State(pinning.reshape(-1)[: chain.sites], end.numbers.load)
    solved = equilibrium(chain, state)
    columns = recorded(by, end)
    stored = potential_energy(chain, (solved.upper, solved.layer), state.pinning)
    booked = (columns["stored"] * (jnp.arange(events) == columns["number"] - 1)).sum(where=columns["kind"] >= 0)
    return Catalogue(
        **columns,
        state=State(state.pinning[ahead:], state.load),
        drift=jnp.abs(all_opened(resp, end.stresses).reshape(-1)[: chain.sites] - solved.stress).max(),
        energy_drift=jnp.abs(booked - stored),
        status=end.ending,
    )


_hard_series = without_derivative(
    jax.jit(_series, static_argnums=0),
    "a series of hard events cannot be differentiated: which contact breaks next is a comparison",
    nondiff_argnums=(0,),
)
