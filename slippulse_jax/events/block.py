"""First precursors of a block under two-dimensional elasticity: any contacts, in any order.

The most overloaded contact breaks next, the pusher held: the cascade of a chain (`slippulse_jax.events.event`), with all
contacts in one block. In the first front every contact breaks at most once, as on a slider. Every contact stays attached to the
body, so a break costs one row of a matrix (`slippulse_jax.bodies.waveguide`), and derivatives at a fixed order of breaks are
those of the sums.

Everything is computed in double precision (`in_double`): single precision loses several per cent of a length at H/λc = 400,
and at 800 the event itself.
"""

import dataclasses
import functools
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax.block import Block, Control, Push
from slippulse_jax.bodies import elements, waveguide
from slippulse_jax.bodies.response import Response
from slippulse_jax.bodies.waveguide import Guide
from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.derivatives import by_forward_mode
from slippulse_jax.domains import NORMAL_STIFFNESS
from slippulse_jax.events.event import first_event, nucleated
from slippulse_jax.front.front import FADED, EventKind, Front, first_of, follow, in_domain, length_or_reason
from slippulse_jax.interface import Interface, Profile
from slippulse_jax.rules import HARD, BreakRule, SmoothBreak
from slippulse_jax.shown import in_a_line
from slippulse_jax.status import NotConverged, Outcome
from slippulse_jax.units import Numbers

FEWEST, MORE, MOST = 64, 4, 2**13
"""Smallest number of contacts resolved, the factor by which it grows while the event reaches the last of them, and the largest:
the response is a matrix of that size."""
TALL = 500.0
"""H/λc above which a length is extrapolated from coarser blocks."""
COARSE, FOLLOWED, ENOUGH = 60.0, 256, 90
"""On a coarser block: contacts below the push in the first trial, contacts resolved, and the fewest that an event may break."""
FARTHER = 2048
"""Contacts resolved where a prestressed event differs between contacts of two sizes."""
FAR = 20
"""Distance, in heights, beyond which an event on coarser contacts is not followed."""
ALIKE = 0.1
"""Largest relative difference between the lengths on contacts of two sizes that are taken for the same event."""
TOGETHER = 4
"""Blocks computed at once."""
IN_DOUBLE = "a block needs double precision: work under jax.enable_x64(True)"


class BlockPrecursor(eqx.Module):
    """The first precursor of a block. Lengths are in λc, displacements in u_s, stresses in σ_s."""

    block: Block
    nucleation: Int[Array, ""]  # contact that breaks first
    contacts_broken: Int[Array, ""]
    breaks: Int[Array, ""]  # more than contacts broke where some broke again in a whole event
    length: Float[Array, ""]  # ℓ, from the pushed edge to where the event stops
    load: Float[Array, ""]  # U at nucleation, in u_s; under a constant force, that force in k u_s
    status: Int[Array, ""]  # an `Outcome`
    stress_before: Float[Array, " sites"]  # at nucleation
    stress: Float[Array, " sites"]  # when the event is over
    slip: Float[Array, " sites"]  # of the interface while it ran
    pinning: Float[Array, " sites"]
    event: EventKind = eqx.field(static=True)  # the first front, or the whole event

    def __repr__(self) -> str:
        return in_a_line(self, "block", "contacts_broken", "length", "load")

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


Computed = TypeVar("Computed", bound=Callable)


def in_double(function: Computed) -> Computed:
    """Compute a function of a block in double precision, whatever the JAX flags; results are in the caller's precision.

    Raises
    ------
    ValueError
        If an argument is traced while JAX is in single precision.
    """

    @functools.wraps(function)
    def computed(*given: Any) -> Any:
        single = not jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
        if single and any(isinstance(x, Tracer) for x in jax.tree.leaves(given)):
            raise ValueError(f"under jit, vmap and grad {IN_DOUBLE}")
        with jax.enable_x64(True):
            found = function(*jax.tree.map(lambda x: _of_type(x, np.float64), given))
            return jax.tree.map(lambda x: _of_type(x, np.float32), found) if single else found

    return computed  # pyright: ignore[reportReturnType]


def _of_type(x: Any, dtype: Any) -> Any:
    """`x` in this floating type; anything else as it is."""
    if isinstance(x, jax.Array):
        return lax.convert_element_type(x, dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x
    return np.asarray(x, dtype) if isinstance(x, float | np.ndarray) and np.asarray(x).dtype.kind == "f" else x


def guide_of(block: Block, finer: int = 0) -> Guide:
    """The block as a waveguide, its contacts attached; on a mesh that is `finer` by so many halvings."""
    contact, length = jnp.asarray(block.stiffness), None if block.length is None else jnp.asarray(block.length)
    slab = waveguide.attached(elements.slab(block, finer), contact)
    return waveguide.guide(slab, elements.loaded(block, finer), length)


class BlockContacts(NamedTuple):
    """The contacts of a block, before it is pushed."""

    response: Response
    threshold: Float[Array, " N"]
    prestress: Float[Array, " N"]
    last: Int[Array, ""] | int  # index of the last contact, or of the last one resolved
    valid: Bool[Array, ""]  # whether all numbers lie in their domains


def contacts_of(block: Block, interface: Interface | Profile | None, sites: int) -> BlockContacts:
    """The first contacts of a block, and their response."""
    last = sites - 1 if block.length is None else jnp.asarray(block.length) - 1
    response = waveguide.response(guide_of(block), jnp.asarray(block.stiffness), sites)
    threshold, prestress = jnp.ones_like(response.push[0]), jnp.zeros_like(response.push[0])
    site = jnp.arange(sites, dtype=threshold.dtype)
    if interface is not None:
        threshold, prestress = (x.astype(threshold.dtype) for x in (interface.threshold_at(site), interface.prestress_at(site)))
    valid = in_domain(block)
    if block.normal_stiffness is not None:
        valid = valid & NORMAL_STIFFNESS.holds(block.normal_stiffness)
    return BlockContacts(response, threshold, prestress, last, valid)


@in_full
def _record(block: Block, interface: Interface | Profile | None, sites: int, kind: EventKind) -> BlockPrecursor:
    response, threshold, prestress, last, valid = contacts_of(block, interface, sites)
    found, first, load, before = first_event(response, threshold, prestress, last, kind=kind)
    stress, pinning = found.contacts.stress[0], found.contacts.released[0]
    excess = stress - threshold
    again = (excess >= 0) & found.broken if kind == "domino" else jnp.zeros(sites, bool)
    endings = {
        Outcome.INVALID: ~(valid & jnp.isfinite(excess).all()),
        Outcome.RAN_THROUGH: found.broken[last],
        Outcome.LIMIT: ((excess >= 0) & ~again).any(),
        Outcome.NO_DOMINO: found.rightmost == 0,
        Outcome.REBREAK: again.any(),
    }
    status = first_of(endings)
    return BlockPrecursor(
        block=block,
        nucleation=first.astype(jnp.int32),
        contacts_broken=found.broken.sum().astype(jnp.int32),
        breaks=found.record.breaks,
        length=length_or_reason(status, found.length(stress, sites - 1)),
        load=load,
        status=status,
        stress_before=before,
        stress=stress,
        slip=response.near[0] @ pinning,
        pinning=pinning,
        event=kind,
    )


@partial(jax.jit, static_argnames=("sites", "kind"))
def record(block: Block, interface: Interface | Profile | None, sites: int, kind: EventKind) -> BlockPrecursor:
    """Compute the event of one block on its first `sites` contacts."""
    return _record(block, interface, sites, kind)


def faded(contacts: BlockContacts, rule: SmoothBreak) -> Float[Array, ""]:
    """ℓ under a smooth rule, of a front from the edge; inf if it reaches the last contact, NaN if it begins elsewhere."""
    response, threshold, prestress, last, valid = contacts
    push, near = response.push[0], response.near[0]
    first, load = nucleated(push, threshold, prestress)

    def ahead(front: Front) -> tuple[Array, Array]:
        return front.stress[front.position], threshold[front.position]

    def release(front: Front, part: Any, stress: Array) -> Front:
        return front._replace(stress=front.stress + near[front.position] * (part * stress), position=front.position + 1)

    start = release(Front(prestress + load * push, None, None, jnp.int32(0)), 1, threshold[0])
    _, _, part, length = follow(rule, start, ahead, release, last)
    valid = valid & (first == 0) & rule.in_domain()
    return length_or_reason(first_of({Outcome.INVALID: ~valid, Outcome.RAN_THROUGH: part > FADED}), length)


@partial(jax.jit, static_argnames=("sites", "kind"))
def length(
    block: Block, interface: Interface | Profile | None, rule: BreakRule = HARD, *, sites: int, kind: EventKind
) -> Float[Array, ""]:
    """ℓ of one block; under the hard rule with derivatives at a fixed order of breaks."""
    given, tree = jax.tree.flatten((block, interface, rule))

    def one(*numbers: Array) -> Array:
        here = [x.astype(like.dtype) for x, like in zip(numbers, given, strict=True)]
        block, interface, rule = jax.tree.unflatten(tree, here)
        if isinstance(rule, SmoothBreak):
            return faded(contacts_of(block, interface, sites), rule)
        return _record(block, interface, sites, kind).length

    return by_forward_mode(one)(*(x.astype(float) for x in given))  # whole numbers too: the rule joins all tangents


class NotFollowed(ValueError):
    """An event that does not stop within what can be followed."""

    def __init__(self, block: Block, why: str) -> None:
        super().__init__(
            f"the event of {block} {why}, farther than can be followed; under a prestress of half the threshold or more, "
            "or on falling thresholds, it may never stop"
        )


Found = TypeVar("Found", Array, BlockPrecursor)


def resolved(given: tuple[Any, ...], sites: Numbers | None, event_on: Callable[[tuple[Any, ...], int], Found]) -> Found:
    """Compute an event on enough contacts for it to stop, or on the number that is given.

    Parameters
    ----------
    given : tuple
        Block, interface, and the other arguments of `event_on`.
    sites : int, optional
    event_on : callable
        Length or record on a number of contacts; its length is inf where the event breaks the last of them.

    Raises
    ------
    ValueError
        If the number is not given for a traced block, whose length is unknown; or is too large, or not a whole number.
    """
    block = given[0]
    if sites is not None:
        return event_on(given, checked_sites(block, sites))
    known = _known(given)
    contacts = known[0].contacts
    if contacts is not None and contacts <= MOST:
        return event_on(given, max(FEWEST, 1 << (contacts - 1).bit_length()))
    count, traced = FEWEST, any(isinstance(x, Tracer) for x in jax.tree.leaves(given))
    while count <= MOST and contacts is None:
        found = event_on(known, count)
        if not np.isposinf(found.length if isinstance(found, BlockPrecursor) else found):
            return event_on(given, count) if traced else found
        count *= MORE
    if contacts is not None:
        raise ValueError(f"{block} reaches beyond {MOST} contacts: take a coarser one of the same b")
    raise NotFollowed(block, f"reaches beyond {count // MORE} contacts")  # under a wide smooth rule for ever


def checked_sites(block: Block, sites: Numbers | None) -> int:
    """Number of contacts to resolve, which must fit into memory; a block that ends needs all of its own."""
    if not isinstance(sites, int) or not 2 <= sites <= MOST:
        raise ValueError(f"sites = {sites}: of a block a whole number from 2 to {MOST}")
    if sites < (block.contacts or 0):
        raise ValueError(f"sites = {sites}: a block of {block.contacts} contacts needs all of them")
    return sites


def _known(
    given: Any,
    why: str = "a block needs sites, the number of contacts resolved: its length is not known",
) -> Any:
    """Strip derivatives from a block and its interface, which leaves numbers."""
    given = lax.stop_gradient(given)
    try:
        return jax.tree.map(np.asarray, given)
    except jax.errors.JAXTypeError:
        raise ValueError(f"under jit and vmap {why}") from None


def _coarser(body: tuple[Block, Interface | None], height: float) -> tuple[Block, Interface | None]:
    """The block on larger contacts of the same areal stiffness, at H/λc = `height`."""
    block, interface = body
    larger = block.height / height
    contacts = eqx.tree_at(lambda x: (x.height, x.stiffness), block, (jnp.asarray(height), block.stiffness * larger))
    if interface is None:
        return contacts, None
    return contacts, eqx.tree_at(lambda x: x.threshold_slope, interface, interface.threshold_slope * larger)


Look = Callable[[np.ndarray, np.ndarray, int], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""``look(which, height, sites)``: lengths, contacts broken and statuses of some of the blocks, on contacts coarsened to H/λc =
`height`, of which `sites` are resolved."""


class BlockNumbers(NamedTuple):
    """Numbers of many blocks."""

    height: Float[np.ndarray, " n"]
    stiffness: Float[np.ndarray, " n"]
    poisson: Float[np.ndarray, " n"]
    prestress: Float[np.ndarray, " n"]
    threshold_slope: Float[np.ndarray, " n"]
    push_height: Float[np.ndarray, " n"]
    push_width: Float[np.ndarray, " n"]  # NaN where the push covers everything above


class Views(NamedTuple):
    """Events of many blocks on coarser contacts, `fine` at H/λc = `height` and `rough` at half of it, in contacts."""

    height: Float[np.ndarray, " n"]
    sites: Int[np.ndarray, " n"]  # contacts followed
    fine: Float[np.ndarray, " n"]  # inf where the event does not stop within what can be followed
    rough: Float[np.ndarray, " n"]  # as `fine` where `height` is that of the block


def _coarse_heights(
    given: BlockNumbers, left: Int[np.ndarray, " m"], look: Look, sites: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find an H/λc, at most that of the block, at which each event fits `sites` contacts; ℓ there; whether finer ones did not.

    An event should break `ENOUGH` of `FOLLOWED` contacts. One that breaks them all although they reach over `FAR` heights has
    no length (inf): on still larger contacts it would stop only because they are so large.
    """
    finer, tall = sites / FOLLOWED, given.height
    height, length, most = np.minimum(tall, COARSE * finer / given.push_height), np.zeros(len(tall)), tall.copy()
    every = left
    while len(left):
        now = height[left]
        length[left], broken, status = look(left, now, sites)
        through = status == Outcome.RAN_THROUGH
        few = ~through & (now < most[left]) & (broken < ENOUGH * finer)
        most[left[through]] = now[through] / 1.5
        grown = now * np.clip(1.5 * ENOUGH * finer / np.maximum(broken, 1), 1.5, 16.0)
        again = few | (through & (now * FAR >= 1.5 * sites))
        height[left] = np.where(again, np.minimum(np.where(through, now, grown), most[left]), now)
        left = left[again]
    return height[every], length[every], (most < tall)[every]


def _views(given: BlockNumbers, look: Look) -> Views:
    """Look at each event on `FOLLOWED` contacts, and on `FARTHER` at those that may run away and are still undecided.

    Ever finer contacts lengthen an event, near run-away without bound: one that stops on coarse contacts may never stop on
    finer ones. So its lengths on contacts of two sizes must be alike. Far from the edge the stress on the contact ahead tends
    to 2φ/(1 + R_ii), R_ii > 0: without a prestress of half the threshold, or falling thresholds, every front stops.
    """
    falling = given.threshold_slope < 0
    lasting, endless = (given.prestress > 0) | falling, (2 * given.prestress >= 1) | falling
    # an event that runs away on the largest contacts does so on smaller ones; falling thresholds reach zero before the last
    first, left = np.minimum(given.height, FOLLOWED / FAR), np.arange(len(given.height))
    found = Views(first, np.full(len(left), FOLLOWED), np.full(len(left), np.inf), np.full(len(left), np.inf))
    away = np.nonzero(endless & ~falling)[0]
    if len(away):
        away = away[look(away, first[away], FOLLOWED)[2] == Outcome.RAN_THROUGH]
        left = np.setdiff1d(left, away)
    for sites in (FOLLOWED, FARTHER):
        height, fine, bounded = _coarse_heights(given, left, look, sites)
        rough = fine.copy()
        coarse = np.isfinite(fine) & (height < given.height[left])
        if coarse.any():
            rough[coarse] = look(left[coarse], height[coarse] / 2, sites)[0]
        unlike = coarse & ~_alike(fine, 2 * rough)
        if sites == FARTHER:
            fine = np.where(unlike & bounded & endless[left], np.inf, fine)
        for column, values in zip(found, (height, sites, fine, rough), strict=True):
            column[left] = values
        left = left[unlike & lasting[left]]
        if not len(left):
            break
    return found


def _alike(fine: Any, rough: Any) -> Any:
    with np.errstate(invalid="ignore"):  # where there is no length
        return abs(fine - rough) <= ALIKE * fine


def extrapolated(fine: Any, rough: Any, height: Any, tall: Any) -> tuple[Any, Any]:
    """ℓ of a block from those of two coarser ones, at H/λc = `height` and half of it; and how far it may be off.

    The length of an event of n breaks has a relative error of order 1/n; extrapolation leaves about a quarter of its own
    correction. Lengths that differ by more than `ALIKE` belong to two kinds of event: the finer one is taken, and may be off by
    their difference.
    """
    fine, rough = fine * tall / height, rough * tall * 2 / height
    correction = (fine - rough) * (1 - height / tall)
    alike = _alike(fine, rough).astype(fine.dtype)
    return fine + correction * alike, abs(correction) * (1 - 0.75 * alike)


def tall_length(block: Block, interface: Interface | None, kind: EventKind) -> tuple[Array, Array]:
    """ℓ of one tall block from coarser ones of the same b, and how far it may be off.

    Raises
    ------
    ValueError
        If the event does not stop within what can be followed.
    """
    known = _known((block, interface))

    def look(_: np.ndarray, height: np.ndarray, sites: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        found = record(*_coarser(known, float(height[0])), sites, kind)
        return np.array([found.length]), np.array([found.contacts_broken]), np.array([found.status])

    one, carried = known[0], (0.0, 0.0) if known[1] is None else (known[1].prestress, known[1].threshold_slope)
    push = one.push.height or 1.0, np.nan if one.push.width is None else one.push.width
    numbers = BlockNumbers(*(np.array([x], dtype=float) for x in (one.height, one.stiffness, one.poisson, *carried, *push)))
    view = _views(numbers, look)
    height, sites = float(view.height[0]), int(view.sites[0])
    if np.isposinf(view.fine[0]):
        grows = np.isfinite(view.rough[0])
        raise NotFollowed(
            block, "becomes ever longer on ever finer contacts" if grows else f"reaches beyond {sites / height:.2g} heights"
        )
    if height == known[0].height:
        found = length(block, interface, sites=sites, kind=kind)
        return found, jnp.zeros_like(found)
    pair = [length(*_coarser((block, interface), one), sites=sites, kind=kind) for one in (height, height / 2)]
    return extrapolated(pair[0], pair[1], height, block.height)


@partial(jax.jit, static_argnames=("patch", "control", "sites", "kind"))
def _events(
    lanes: Float[Array, "7 n"], patch: bool, control: Control, sites: int, kind: EventKind
) -> tuple[Array, Array, Array]:
    """Lengths, contacts broken and statuses of a few blocks."""

    def one(lane: Array) -> tuple[Array, Array, Array]:
        height, stiffness, poisson, prestress, slope, at, width = lane
        push = Push(at, width if patch else None, control)
        found = _record(Block(height, stiffness, poisson, push), Interface(prestress, slope), sites, kind)
        return found.length, found.contacts_broken, found.status

    return jax.vmap(one, 1)(lanes)


def _look(lanes: BlockNumbers, control: Control, kind: EventKind) -> Look:
    """Events of many blocks; either all pushes cover everything above a height, or none does."""
    given = np.stack(lanes)
    patch = not np.isnan(lanes.push_width).any()
    given[-1] = np.nan_to_num(given[-1])

    def look(which: np.ndarray, height: np.ndarray, sites: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        together = TOGETHER if sites == FOLLOWED else 1
        larger = lanes.height[which] / height
        numbers = given[:, which]
        numbers[0], numbers[1], numbers[4] = height, numbers[1] * larger, numbers[4] * larger
        padded = np.resize(np.arange(len(which)), -(-len(which) // together) * together)
        with jax.enable_x64(True):
            parts = [
                _events(numbers[:, part], patch, control, sites, kind) for part in np.split(padded, len(padded) // together)
            ]
        length, broken, status = (np.concatenate(column)[: len(which)] for column in zip(*parts, strict=True))
        lost = ~np.isin(status, (Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.REBREAK, Outcome.RAN_THROUGH))
        if lost.any():
            where = ", ".join(f"{x:.9g}" for x in numbers[:, np.argmax(lost)])
            why = Outcome(int(status[lost][0])).message
            raise NotConverged(f"no length of a block at (H/λc, k/K, ν, φ, ε, height and width of the push) = ({where}): {why}")
        return length, broken, status

    return look


def tall_lengths(lanes: BlockNumbers, control: Control, kind: EventKind) -> tuple[np.ndarray, np.ndarray]:
    """ℓ of many blocks from coarser ones, and how far each may be off.

    Lengths are 0 where no domino starts, and inf where the event does not stop within the contacts followed. The error of an
    infinite length is set to H, for the blocks beside it in a table.
    """
    view = _views(lanes, _look(lanes, control, kind))
    found, error = view.fine, np.where(np.isinf(view.fine), lanes.height, 0)
    coarse = np.nonzero(np.isfinite(view.fine) & (view.height < lanes.height))[0]
    if len(coarse):
        of = (x[coarse] for x in (view.fine, view.rough, view.height, lanes.height))
        found[coarse], error[coarse] = extrapolated(*of)
    return found, error


def lengths(lanes: BlockNumbers, control: Control, kind: EventKind) -> np.ndarray:
    """ℓ of many blocks, each as `precursor_length` has it to rounding, inf where that refuses; shape (n,)."""
    found = np.empty(len(lanes.height))
    for patch in (False, True):
        own = np.isfinite(lanes.push_width) == patch
        tall, short = (np.nonzero(own & side)[0] for side in (lanes.height > TALL, lanes.height <= TALL))
        if tall.size:
            found[tall] = tall_lengths(BlockNumbers(*(x[tall] for x in lanes)), control, kind)[0]
        if short.size:
            some = BlockNumbers(*(x[short] for x in lanes))
            found[short], _, status = _look(some, control, kind)(np.arange(len(short)), some.height, FOLLOWED)
            for i in short[status == Outcome.RAN_THROUGH]:
                height, stiffness, poisson, prestress, slope, at, width = (float(x[i]) for x in lanes)
                block = Block(height, stiffness, poisson, Push(at, width if patch else None, control))
                try:
                    with jax.enable_x64(True):
                        found[i] = precursor_length(block, Interface(prestress, slope), None, HARD, kind)
                except NotFollowed:
                    found[i] = np.inf
    return found


def precursor_length(
    block: Block, interface: Interface | Profile | None, sites: Numbers | None, rule: BreakRule, kind: EventKind
) -> Float[Array, ""]:
    """ℓ of one block: see `slippulse_jax.precursor_length`."""
    given = block, interface, rule
    traced = any(isinstance(x, Tracer) for x in jax.tree.leaves(given))
    if not traced or jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        found = in_double(_length)(block, interface, rule, sites, kind)
        _warn_of_few_sites(block, sites, found)
        return found
    _known(given, IN_DOUBLE)
    numbers, others = eqx.partition(given, lambda x: isinstance(x, Tracer) and jnp.issubdtype(x.dtype, jnp.floating))
    numbers, tree = jax.tree.flatten(numbers)
    others = _known(others)

    def one(*numbers: Array) -> Array:
        with jax.enable_x64(True):  # in here, because JAX computes derivatives later
            every = eqx.combine(jax.tree.unflatten(tree, numbers), others)
            block, interface, rule = jax.tree.map(lambda x: _of_type(x, np.float64), every)
            return _of_type(_length(block, interface, rule, sites, kind), np.float32)

    return by_forward_mode(one)(*numbers)


def _length(
    block: Block, interface: Interface | Profile | None, rule: BreakRule, sites: Numbers | None, kind: EventKind
) -> Float[Array, ""]:
    smooth = isinstance(rule, SmoothBreak)
    every = sites is not None or block.length is not None or smooth
    if not every and not isinstance(interface, Profile) and _known(block).height > TALL:
        return tall_length(block, interface, kind)[0]
    found = resolved((block, interface, rule), sites, lambda given, count: length(*given, sites=count, kind=kind))
    if smooth and not isinstance(found, Tracer) and np.isnan(found):
        begins = int(_first(block, interface, sites, kind).nucleation)
        raise ValueError(f"rule = {rule!r}: a smooth front runs from the edge, and this event begins at contact {begins}")
    return found


def first_precursor(
    block: Block, interface: Interface | Profile | None, sites: Numbers | None, kind: EventKind
) -> BlockPrecursor:
    """Record of one block: see `slippulse_jax.first_precursor`."""
    found = in_double(_first)(block, interface, sites, kind)
    _warn_of_few_sites(block, sites, found.length)
    if block.contacts is not None:  # no more than it has
        found = jax.tree.map(lambda x: x[: block.contacts] if jnp.ndim(x) else x, found)
    return dataclasses.replace(found, block=block)  # not rounded


def _first(block: Block, interface: Interface | Profile | None, sites: Numbers | None, kind: EventKind) -> BlockPrecursor:
    return resolved((block, interface), sites, lambda given, count: record(*given, count, kind))


def _warn_of_few_sites(block: Block, sites: Numbers | None, length: Array) -> None:
    """Say that an event reached the last contact resolved of a block that goes on."""
    if sites is not None and block.length is None and not isinstance(length, Tracer) and np.isposinf(length):
        warnings.warn(
            f"sites = {sites}: the event reached the last contact resolved, so its length is not known (inf); give more",
            RuntimeWarning,
            stacklevel=4,
        )


class BlockFields(NamedTuple):
    """Displacements in u_s at the nodes of the block; rows are columns of nodes, one λc apart."""

    x: Float[Array, " columns"]  # in λc
    y: Float[Array, " nodes"]  # in λc
    horizontal: Float[Array, "columns nodes"]
    vertical: Float[Array, "columns nodes"]


def fields(block: Block, load: Array, pinning: Float[Array, " N"]) -> BlockFields:
    """Displacements of a block under a load and pinning points of its first contacts; of all, if it has an end.

    At nucleation ``fields(found.block, found.load, 0 * found.pinning)``, after the event ``fields(…, found.pinning)``.

    Raises
    ------
    ValueError
        If the block ends and has not as many contacts as there are pinning points.
    """
    if block.contacts not in (None, pinning.size):
        raise ValueError(f"pinning has shape {pinning.shape}: the block has {block.contacts} contacts")
    return in_double(_fields)(block, load, pinning)


@jax.jit
def _fields(block: Block, load: Array, pinning: Float[Array, " N"]) -> BlockFields:
    return _fields_of(block, guide_of(block), load, pinning)


def _fields_of(block: Block, guide: Guide, load: Array, pinning: Float[Array, " N"]) -> BlockFields:
    contact, y = jnp.asarray(block.stiffness), elements.heights(block)
    found = waveguide.columns(guide, contact, load, pinning)
    every = jnp.zeros((found.shape[0], 2 * y.size), y.dtype).at[:, elements.freedoms(block, y.size)].set(found)
    return BlockFields(jnp.arange(found.shape[0], dtype=y.dtype), y, every[:, 0::2], every[:, 1::2])


class Stages(NamedTuple):
    """Stresses of the contacts and in the block, in σ_s, after given numbers of breaks; without the prestress in the block."""

    y: Float[Array, " nodes"]  # heights of the nodes, in λc
    contact: Float[Array, "n N"]
    shear: Float[Array, "n N cells"]  # σ_xy over each contact, from one node to the next


def stages(
    block: Block, interface: Interface | Profile | None, sites: int, breaks: Int[Array, " n"], kind: EventKind
) -> Stages:
    """Stresses after so many breaks of the first precursor, 0 for none."""
    return in_double(_stages)(block, interface, sites, breaks.astype(np.int32), kind)


@partial(jax.jit, static_argnames=("sites", "kind"))
def _stages(
    block: Block, interface: Interface | Profile | None, sites: int, breaks: Int[Array, " n"], kind: EventKind
) -> Stages:
    response, threshold, prestress, last, _ = contacts_of(block, interface, sites)
    _, _, load, before = first_event(response, threshold, prestress, last, 1, kind)
    guide, modulus = guide_of(block), 1 / (2 * (1 + jnp.asarray(block.poisson)) * jnp.asarray(block.stiffness))

    def at(limit: Array) -> tuple[Array, Array]:
        now = first_event(response, threshold, prestress, last, limit, kind)[0].contacts
        field = _fields_of(block, guide, load, jnp.where(limit > 0, now.released[0], 0))
        across, up = jnp.diff(field.vertical, axis=0), jnp.diff(field.horizontal, axis=1) / jnp.diff(field.y)[None, :]
        shear = modulus * (across[:, 1:] + across[:, :-1] + up[1:] + up[:-1]) / 2
        return jnp.where(limit > 0, now.stress[0], before), shear

    return Stages(elements.heights(block), *lax.map(at, breaks))
