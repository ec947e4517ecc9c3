"""First precursors of a block under two-dimensional elasticity: any contacts, in any order.

The most overloaded contact breaks next, the pusher held, as in `slippulse_jax.lattice.cascade`. Every contact stays attached to
the block, so a break costs one row of a matrix (`slippulse_jax.lattice.waveguide`), and derivatives at a fixed order of breaks
are those of the sums.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.core import Tracer
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax.block import Block
from slippulse_jax.derivatives import by_forward_mode
from slippulse_jax.domains import HEIGHT, POISSON, STIFFNESS
from slippulse_jax.interface import Interface, Profile
from slippulse_jax.lattice import elements, waveguide
from slippulse_jax.lattice.front import event_length, length_or_reason
from slippulse_jax.lattice.waveguide import Guide, Response
from slippulse_jax.status import Outcome
from slippulse_jax.units import Numbers

AT_FIRST, MORE = 2.6, 2
"""Contacts resolved at first, in H/λc, and the factor by which they grow while an event reaches the last of them."""
FEWEST, MOST = 64, 2**13
"""Fewest and most contacts resolved: the response of so many to each other is a matrix."""
BREAKS = 64
"""Breaks per contact after which an event is given up."""


class Event(NamedTuple):
    """State of the contacts; stresses in σ_s."""

    stress: Float[Array, " N"]
    pinning: Float[Array, " N"]  # u_b, in u_s
    overload: Float[Array, " N"]  # excess over the threshold of each as it first broke
    broken: Bool[Array, " N"]
    breaks: Int[Array, ""]


class BlockPrecursor(eqx.Module):
    """The first precursor of a block. Lengths are in λc, displacements in u_s, stresses in σ_s."""

    block: Block
    nucleation: Int[Array, ""]  # contact that breaks first
    contacts_broken: Int[Array, ""]
    breaks: Int[Array, ""]  # more than contacts broke where some broke again
    length: Float[Array, ""]  # ℓ, from the pushed edge to where the event stops
    load: Float[Array, ""]  # U at nucleation, in u_s; under a constant force, that force in k u_s
    status: Int[Array, ""]  # an `Outcome`
    stress_before: Float[Array, " sites"]  # at nucleation
    stress: Float[Array, " sites"]  # when the event is over
    slip: Float[Array, " sites"]  # of the interface while it ran
    pinning: Float[Array, " sites"]

    def __str__(self) -> str:
        if isinstance(self.length, Tracer):
            return repr(self)
        text = (
            f"first precursor: {int(self.contacts_broken)} contacts broken, length {float(self.length):.6g} λc, "
            f"load at nucleation {float(self.load):.6g}; {Outcome(int(self.status)).message}"
        )
        if int(self.status) == Outcome.NO_DOMINO and self.block.push.height is None:
            text += "; a side that is pushed as a whole loads every contact alike, which leaves the neighbour just below"
        if int(self.nucleation):
            text += f"; it begins at contact {int(self.nucleation)}, not at the edge"
        if int(self.breaks) > int(self.contacts_broken):
            text += f"; contacts behind the front break again, {int(self.breaks)} breaks in all"
        return text


def guide_of(block: Block) -> Guide:
    """The block as a waveguide, its contacts attached."""
    contact = jnp.asarray(block.stiffness)
    return waveguide.guide(waveguide.attached(elements.slab(block), contact), elements.loaded(block))


def event(
    response: Response, threshold: Float[Array, " N"], prestress: Float[Array, " N"]
) -> tuple[Event, Int[Array, ""], Array, Float[Array, " N"]]:
    """Load the body until a contact is at its threshold, and break contacts until none is.

    Also the contact that broke first, the load and the stress at nucleation.
    """
    push, matrix = response
    sites = push.size
    needed = jnp.where(push > 0, (threshold - prestress) / jnp.where(push > 0, push, 1), jnp.inf)
    first = jnp.argmin(needed)
    load = needed[first]
    start = prestress + load * push

    def breaks(now: Event, j: Array) -> Event:
        released = now.stress[j]
        overload = jnp.where(now.broken[j], now.overload[j], released - threshold[j])
        return Event(
            stress=(now.stress + matrix[j] * released).at[j].add(-released),
            pinning=now.pinning.at[j].add(released),
            overload=now.overload.at[j].set(overload),
            broken=now.broken.at[j].set(True),
            breaks=now.breaks + 1,
        )

    def most(now: Event) -> Array:
        return jnp.argmax(now.stress - threshold)

    def goes_on(now: Event) -> Array:
        j = most(now)
        return (now.stress[j] >= threshold[j]) & (now.breaks < BREAKS * sites) & ~now.broken[-1]

    none = jnp.zeros_like(start)
    one = breaks(Event(start, none, none, jnp.zeros(sites, bool), jnp.int32(0)), first)
    return lax.while_loop(goes_on, lambda now: breaks(now, most(now)), one), first, load, start


def _record(block: Block, interface: Interface | Profile | None, sites: int) -> BlockPrecursor:
    site = jnp.arange(sites)
    response = waveguide.response(guide_of(block), jnp.asarray(block.stiffness), sites)
    threshold, prestress = jnp.ones_like(response.push), jnp.zeros_like(response.push)
    if interface is not None:
        threshold, prestress = (x.astype(threshold.dtype) for x in (interface.threshold_at(site), interface.prestress_at(site)))
    ended, first, load, before = event(response, threshold, prestress)
    furthest = jnp.max(jnp.where(ended.broken, site, -1))
    excess = ended.stress - threshold
    inside = HEIGHT.holds(block.height) & STIFFNESS.holds(block.stiffness) & POISSON.holds(block.poisson)
    endings = {
        Outcome.INVALID: ~(inside & jnp.isfinite(excess).all()),
        Outcome.RAN_THROUGH: ended.broken[-1],
        Outcome.LIMIT: (excess >= 0).any(),
        Outcome.NO_DOMINO: ended.breaks == 1,
    }
    status = jnp.select(list(endings.values()), list(endings), Outcome.ARRESTED).astype(jnp.int32)
    length = event_length(furthest, ended.overload[furthest], excess[jnp.minimum(furthest + 1, sites - 1)])
    return BlockPrecursor(
        block=block,
        nucleation=first.astype(jnp.int32),
        contacts_broken=ended.broken.sum().astype(jnp.int32),
        breaks=ended.breaks,
        length=length_or_reason(status, length),
        load=load,
        status=status,
        stress_before=before,
        stress=ended.stress,
        slip=response.matrix @ ended.pinning,
        pinning=ended.pinning,
    )


@partial(jax.jit, static_argnames="sites")
def record(block: Block, interface: Interface | Profile | None, sites: int) -> BlockPrecursor:
    """The event of one block on so many contacts."""
    return _record(block, interface, sites)


@partial(jax.jit, static_argnames="sites")
def length(block: Block, interface: Interface | Profile | None, sites: int) -> Float[Array, ""]:
    """ℓ of one block, with derivatives at a fixed order of breaks."""
    numbers, together = ravel_pytree((block, interface))

    def one(numbers: Array) -> Array:
        block, interface = together(numbers)
        return _record(block, interface, sites).length

    return by_forward_mode(one)(numbers)


def resolved(block: Block, interface: Interface | Profile | None, sites: Numbers | None) -> int:
    """Number of contacts on which an event stays, or the one that is given.

    Raises
    ------
    ValueError
        If it is neither given nor can be found out, because the block is traced; or too large, or no number of contacts.
    """
    if sites is not None:
        if not isinstance(sites, int) or not 2 <= sites <= MOST:
            raise ValueError(f"sites = {sites}: of a block a whole number from 2 to {MOST}")
        return sites
    block, interface = lax.stop_gradient((block, interface))
    try:
        tall = float(block.height)
    except jax.errors.ConcretizationTypeError:
        raise ValueError(
            "under jit and vmap a block needs sites, the number of contacts resolved: its length is not known"
        ) from None
    count = FEWEST
    while count < AT_FIRST * tall:
        count *= MORE
    while count <= MOST:
        if int(record(block, interface, count).status) != Outcome.RAN_THROUGH:
            return count
        count *= MORE
    raise ValueError(
        f"the event of {block} reaches beyond {MOST} contacts: such a block is resolved on a coarser one of the same b"
    )


def precursor_length(block: Block, interface: Interface | Profile | None, sites: Numbers | None) -> Float[Array, ""]:
    """ℓ of one block: see `slippulse_jax.precursor_length`."""
    return length(block, interface, resolved(block, interface, sites))


def first_precursor(block: Block, interface: Interface | Profile | None, sites: Numbers | None) -> BlockPrecursor:
    """Record of one block: see `slippulse_jax.first_precursor`."""
    return record(block, interface, resolved(block, interface, sites))


class BlockFields(NamedTuple):
    """Displacements in u_s at the nodes of the block; rows are columns of nodes, one λc apart."""

    x: Float[Array, " columns"]  # in λc
    y: Float[Array, " nodes"]  # in λc
    horizontal: Float[Array, "columns nodes"]
    vertical: Float[Array, "columns nodes"]


@jax.jit
def fields(block: Block, load: Array, pinning: Float[Array, " N"]) -> BlockFields:
    """Displacements of a block under a load and pinning points of its first contacts.

    At nucleation ``fields(found.block, found.load, 0 * found.pinning)``, after the event ``fields(…, found.pinning)``.
    """
    contact, y = jnp.asarray(block.stiffness), elements.heights(block)
    found = waveguide.columns(guide_of(block), contact, load, pinning)
    every = jnp.insert(found, 1, 0.0, axis=1)  # u_y at the interface
    return BlockFields(jnp.arange(found.shape[0], dtype=y.dtype), y, every[:, 0::2], every[:, 1::2])
