"""Events of an elastic block on a given number of its contacts.

The most overloaded contact breaks next, the pusher held: the cascade of a chain (`slippulse_jax.events.event`). In the first
front every contact breaks at most once, as on a slider. Every contact stays attached to the body, so a break costs one row of a
matrix (`slippulse_jax.blocks.guide`). How many contacts an event needs is a matter of `slippulse_jax.blocks.size`.

Everything is computed in double precision (`slippulse_jax.bulk.double`): single precision loses several per cent of a length at
H/λc = 400, and at 800 the event itself.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.base.choices import EventKind
from slippulse_jax.block import Block
from slippulse_jax.blocks import elements
from slippulse_jax.blocks import guide as waveguide
from slippulse_jax.blocks.guide import Edge, Guide, Slab
from slippulse_jax.blocks.pressed import under_pressure
from slippulse_jax.bodies.response import of_matrix
from slippulse_jax.bulk.double import in_double
from slippulse_jax.events.first import Relaxed, event_from, nucleated
from slippulse_jax.interface import AnyInterface, Profile, kept_share


def unattached(block: Block, finer: int = 0) -> tuple[Edge, Slab]:
    """The block as a waveguide without springs, for contacts of any stiffness."""
    layers, slab = elements.slabs(block, finer)
    return waveguide.edge(layers, *elements.loaded(block, finer)), slab


def guide_of(block: Block, finer: int = 0, bare: tuple[Edge, Slab] | None = None) -> Guide:
    """The block as a waveguide with contacts attached; `bare` is from `unattached`."""
    length = None if block.length is None else jnp.asarray(block.length)
    edge, slab = unattached(block, finer) if bare is None else bare
    return waveguide.guide(edge, slab, elements.springs(block, finer), elements.along(block, finer), length)


def contacts_of(block: Block, interface: AnyInterface, sites: int, bare: tuple[Edge, Slab] | None = None) -> Relaxed:
    """The first contacts of a block, and their response."""
    last = sites - 1 if block.length is None else jnp.asarray(block.length) - 1
    guide, k, body = guide_of(block, bare=bare), jnp.asarray(block.stiffness), None
    if block.friction is None or block.normal_stiffness is None:
        response = waveguide.response(guide, k, sites)
    elif block.contact_law == "amontons":
        response = waveguide.response(guide, k, sites, jnp.asarray(block.friction * block.normal_stiffness))
    else:
        body = under_pressure(guide, k, sites, jnp.asarray(block.normal_stiffness), jnp.asarray(block.friction))
        response = of_matrix(body.matrix[:sites, None, :sites], body.push[None, :sites], body.edge_stiffness)
    threshold, prestress = jnp.ones_like(response.soft), jnp.zeros_like(response.soft)
    site = jnp.arange(sites, dtype=threshold.dtype)
    if interface is not None:
        threshold, prestress = (x.astype(threshold.dtype) for x in (interface.threshold_at(site), interface.prestress_at(site)))
    valid = block.in_domain() if interface is None else block.in_domain() & interface.in_domain()
    even, kept = not isinstance(interface, Profile), jnp.asarray(kept_share(interface), threshold.dtype)
    found = Relaxed(response, threshold, prestress, k, last, valid, pressed=body, alike=even, residual_strength=kept)
    return found if block.machine is None else found.through(block.machine)


def with_friction(body: Relaxed, friction: Array) -> Relaxed:
    """Rescale contacts from a coefficient of friction of 1 to `friction`."""
    if body.pressed is not None:
        return body._replace(pressed=body.pressed._replace(friction=friction))
    of_reading = jnp.ones_like(body.response.push[:, :1]).at[1:].set(friction)
    matrix, push = (x * of_reading for x in (body.response.matrix, body.response.push))
    return body._replace(response=body.response._replace(matrix=matrix, push=push))


class BlockFields(NamedTuple):
    """Displacements at the nodes of a block, in u_s, column by column."""

    x: Float[Array, " columns"]  # in λc
    y: Float[Array, " nodes"]  # in λc
    horizontal: Float[Array, "columns nodes"]
    vertical: Float[Array, "columns nodes"]


def fields(block: Block, load: Array, pinning: Float[Array, " N"]) -> BlockFields:
    """Displacements of a block under a load, given its first pinning points.

    At nucleation ``fields(found.block, found.load, 0 * found.pinning)``, after the event ``fields(…, found.pinning)``.

    Raises
    ------
    ValueError
        If the block ends and has not as many contacts as there are pinning points.
    """
    if block.sites not in (None, pinning.size):
        raise ValueError(f"pinning has shape {pinning.shape}: the block has {block.sites} contacts")
    return in_double(_fields)(block, load, pinning)


@jax.jit
def _fields(block: Block, load: Array, pinning: Float[Array, " N"], guide: Guide | None = None) -> BlockFields:
    guide, y = guide_of(block) if guide is None else guide, elements.heights(block)
    k = jnp.asarray(block.stiffness)
    if block.machine is not None:  # the pusher is where its spring and the block are in balance
        held = waveguide.response(guide, k, pinning.size)
        machine = jnp.asarray(block.machine)
        load = (machine * load + k * (held.push[0] @ pinning)) / (machine + held.edge_stiffness)
    found = waveguide.columns(guide, k, load, pinning)
    every = jnp.zeros((found.shape[0], 2 * y.size), y.dtype).at[:, elements.freedoms(block, y.size)].set(found)
    return BlockFields(jnp.arange(found.shape[0], dtype=y.dtype), y, every[:, 0::2], every[:, 1::2])


@in_double
@partial(jax.jit, static_argnames=("sites", "kind"))
def stages(
    block: Block, interface: AnyInterface, sites: int, breaks: Int[Array, " n"], kind: EventKind
) -> tuple[Float[Array, "n N"], Float[Array, "n N"], Float[Array, "n N cells"]]:
    """Stresses after so many breaks of the first precursor, in σ_s.

    On the contacts; their thresholds, which follow the pressure where there is friction; and σ_xy in the block over each
    contact, from one node to the next (`slippulse_jax.blocks.elements.heights`), without the prestress.
    """
    body = contacts_of(block, interface, sites)
    start = nucleated(body)
    per_stress = jnp.ones(sites) if body.pressed is None else jnp.asarray(start.pressure)  # or per stretch
    guide, modulus = guide_of(block), 1 / (2 * (1 + jnp.asarray(block.poisson)) * jnp.asarray(block.stiffness))

    def at(limit: Array) -> tuple[Array, Array, Array]:
        now = event_from(start, body, kind, limit)
        readings = jnp.where(limit > 0, now.readings, start.readings)
        pressure = readings[1] if len(readings) > 1 else per_stress
        field = _fields(block, start.load, jnp.where(limit > 0, now.released, 0), guide)
        across, up = jnp.diff(field.vertical, axis=0), jnp.diff(field.horizontal, axis=1) / jnp.diff(field.y)[None, :]
        shear = modulus * (across[:, 1:] + across[:, :-1] + up[1:] + up[:-1]) / 2
        return per_stress * readings[0], pressure * body.threshold, shear

    return lax.map(at, breaks.astype(jnp.int32))
