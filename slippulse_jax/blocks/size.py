"""Number of contacts followed on a block, and their size.

The contacts resolved grow in number until the event stops before the last of them. Of a tall block they are too many, but a
length over H depends on their size only as 1/n, n being the number that breaks. So the event is followed on larger contacts of
the same areal stiffness, of two sizes, and its length extrapolated.

Many blocks are one `Block` of arrays (`many`), and an `Interface` of arrays as long.
"""

import dataclasses
import functools
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from slippulse_jax.base.choices import EventKind
from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.block import MOST_CONTACTS, USUAL_NORMAL_STIFFNESS, Block, ContactLaw, Control, Push, Top, checked_sites
from slippulse_jax.blocks import event as blocks
from slippulse_jax.bodies.response import MOST_SITES
from slippulse_jax.bulk.chunks import Kernel, Layout, over_lanes
from slippulse_jax.bulk.derivatives import known, under_grad_too
from slippulse_jax.bulk.double import in_double
from slippulse_jax.events import first
from slippulse_jax.events.event import MORE_SITES
from slippulse_jax.events.first import FirstPrecursor, length_of
from slippulse_jax.interface import AnyInterface, Interface, Profile
from slippulse_jax.rules import BreakRule
from slippulse_jax.slider import Slider

FEWEST_CONTACTS, FIRST_TRIAL = 64, 512
"""Smallest number of contacts resolved, and most of them in the first trial, which reaches over one height."""
TALL = 500.0
"""H/λc above which a length is extrapolated from larger contacts."""
FOLLOWED, FARTHER = 256, 2048
"""Larger contacts that are followed: of any event, and of one that may run away and differs between contacts of two sizes."""
BELOW_PUSH, ENOUGH, BREAKING = 60.0, 90, 150
"""Of those followed, how many lie below the push in the first trial; how many an event should break, at least, and where its
length is known."""
SMALLEST, OF_END = 4.0, 128
"""Least H/λc of a block whose length is known, and most contacts followed of each height of one that ends."""
MOST_HEIGHTS = 20
"""Distance, in heights, beyond which an event on larger contacts is not followed."""
ALIKE = 0.1
"""Largest relative difference between the lengths on contacts of two sizes that are taken for the same event."""
ONE_BY_ONE = Layout(chunk=1, fusion_emitters=False)
"""Layout of blocks."""


NO_SITES = "a body needs sites, the number of contacts resolved: its length is not known"
"""Why the length of a traced body is not known."""


class NotFollowed(ValueError):
    """An event that does not stop within what can be followed."""

    def __init__(self, body: Any, why: str) -> None:
        super().__init__(
            f"the event of {body} {why}, farther than can be followed; under a prestress of half the threshold or more "
            "(of contacts that keep r of it, (1 + r)/2), or on falling thresholds, it may never stop"
        )


def _without_length(body: Any, interface: AnyInterface, status: Any) -> Exception:
    """Make the error for an event of which nothing is known."""
    where = f"{body}" if interface is None else f"{body} on {interface}"
    kind = ValueError if status == Outcome.INVALID else NotConverged
    return kind(f"no length of {where}: {Outcome(int(status)).message}")


# --- one body ----------------------------------------------------------------------------------------------------------


def first_precursor(body: Any, interface: AnyInterface, sites: int | None, kind: EventKind) -> FirstPrecursor:
    """Record of one body by its contacts: see `slippulse_jax.first_precursor`."""
    found = in_double(_record)(body, interface, sites, kind)
    _warn_of_few_sites(body, sites, found.length)
    own = getattr(body, "sites", None)
    if own is not None and not isinstance(own, Tracer):  # no more than it has
        found = jax.tree.map(lambda x: x[: int(own)] if jnp.ndim(x) else x, found)
    return dataclasses.replace(found, body=body, interface=interface)  # not rounded


def _record(body: Any, interface: AnyInterface, sites: int | None, kind: EventKind) -> FirstPrecursor:
    found = resolved(body, interface, sites=sites, event=partial(first.record, kind=kind))
    if isinstance(interface, Profile) or not _is_tall(body, sites):
        return found
    return dataclasses.replace(found, length=tall_length(body, interface, kind)[0])  # one number, as `precursor_length` has it


def precursor_length(
    body: Any, interface: AnyInterface, sites: int | None, rule: BreakRule | None, kind: EventKind
) -> Float[Array, ""]:
    """ℓ of one body by its contacts: see `slippulse_jax.precursor_length`."""
    tall = rule is None and not isinstance(interface, Profile) and _is_tall(body, sites)
    one = partial(_of_tall, kind=kind) if tall else partial(resolved, sites=sites, event=partial(first.length, kind=kind))
    found = under_grad_too(one)(body, interface, rule)
    _warn_of_few_sites(body, sites, found)
    if not isinstance(found, Tracer) and np.isnan(found):
        record = in_double(_record)(body, interface, sites, kind)
        if rule is not None and record.first:
            begins = f"this event begins at contact {int(record.first)}"
            raise ValueError(f"rule = {rule!r}: a smooth front runs from the edge, and {begins}")
        if record.status != Outcome.LIFT_OFF and not tall:  # of a tall one nothing else is NaN
            raise _without_length(body, interface, record.status)
        warnings.warn(f"{body}: {Outcome.LIFT_OFF.message}", RuntimeWarning, stacklevel=4)
    return found


def _of_tall(body: Any, interface: Interface | None, _: None, kind: EventKind) -> Float[Array, ""]:
    return tall_length(body, interface, kind)[0]


def _is_tall(body: Any, sites: int | None) -> bool:
    """Whether a length is extrapolated, on thresholds that are no profile."""
    return isinstance(body, Block) and sites is None and body.length is None and bool(known(body, NO_SITES).height > TALL)


Found = TypeVar("Found", Array, FirstPrecursor)


def resolved(*given: Any, sites: int | None, event: Callable[..., Found]) -> Found:
    """Compute an event on the contacts that it needs.

    A record or length of body, interface and rule: on `sites` contacts, all there are, or enough for it to stop.
    """
    if sites is not None or not hasattr(given[0], "sites"):
        return event(*given, sites=checked_sites(given[0], sites))
    body, most = known(given[0], NO_SITES), MOST_SITES if isinstance(given[0], Slider) else MOST_CONTACTS
    if body.sites is not None:
        contacts = int(body.sites)
        if contacts > most:
            raise ValueError(f"{body} reaches beyond {most} contacts: take a coarser one of the same b")
        if isinstance(body, Block):  # of similar ones, one program
            contacts = max(FEWEST_CONTACTS, 1 << (contacts - 1).bit_length())
        return event(*given, sites=contacts)
    reach = min(int(np.ceil(body.height)), FIRST_TRIAL)
    for count in trials(max(FEWEST_CONTACTS, 1 << (reach - 1).bit_length()), most):
        found = event(*given, sites=count)
        if not np.isposinf(known(found.length if isinstance(found, FirstPrecursor) else found, NO_SITES)):
            return found
    raise NotFollowed(body, f"reaches beyond {most} contacts")  # under a wide smooth rule for ever


def trials(contacts: int, most: int) -> Iterator[int]:
    """Numbers of contacts to follow an event on, until it stops."""
    while contacts <= most:
        yield contacts
        contacts *= MORE_SITES


def _warn_of_few_sites(body: Any, sites: int | None, length: Array) -> None:
    """Warn that an event reached the last resolved contact, not an end."""
    endless = isinstance(body, Slider | Block) and body.length is None
    if sites is not None and endless and not isinstance(length, Tracer) and np.isposinf(length):
        warnings.warn(
            f"sites = {sites}: the event reached the last contact resolved, so its length is not known (inf); give more",
            RuntimeWarning,
            stacklevel=4,
        )


# --- tall blocks, on larger contacts -----------------------------------------------------------------------------------

Body = tuple[Block, Interface | None]


def tall_length(block: Block, interface: Interface | None, kind: EventKind) -> tuple[Array, Array]:
    """ℓ of one tall block from larger contacts, and its possible error.

    The contacts are of the same b. A ValueError if the event does not stop within what can be followed.
    """
    one = jax.tree.map(lambda x: x[None], known((block, interface), NO_SITES))
    height, sites, fine, rough = _views(one, kind)[:, 0]
    if np.isposinf(fine):
        grows = np.isfinite(rough)
        raise NotFollowed(
            block, "becomes ever longer on ever finer contacts" if grows else f"reaches beyond {sites / height:.2g} heights"
        )
    on = partial(first.length, sites=int(sites), kind=kind)
    if height == one[0].height:
        found = on(block, interface)
        return found, jnp.zeros_like(found)
    pair = [on(*coarser((block, interface), size)) for size in (height, height / 2)]
    return extrapolated(pair[0], pair[1], height, block.height, _b(block))


def _b(block: Block) -> Any:
    """Stiffness of the interface over that of the block."""
    return 2 * (1 + block.poisson) * block.stiffness * block.height


def extrapolated(fine: Any, rough: Any, height: Any, tall: Any, b: Any) -> tuple[Any, Any]:
    """Extrapolate ℓ from H/λc = `height` and half that, with its error.

    The length of an event of n breaks has a relative error of order 1/n; extrapolation leaves about a quarter of its own
    correction, and as much as that from b = 20 on, where stresses change within few contacts. Lengths that differ by more than
    `ALIKE` belong to two kinds of event: the finer one is taken, and may be off by their difference.
    """
    fine, rough = fine * tall / height, rough * tall * 2 / height
    correction = (fine - rough) * (1 - height / tall)
    alike = _alike(fine, rough).astype(fine.dtype)
    return fine + correction * alike, abs(correction) * (1 - (1 - (b / 20).clip(0.25, 1)) * alike)


def suited(length: float, own: float, end: float = np.inf, share: float = 1.0) -> float:
    """H/λc, up to `own`, at which a known ℓ/H breaks `BREAKING` contacts.

    A block that ends at L/H has a whole number of them, of twice their size too; of `OF_END` per height a `share` is followed.
    """
    height = 2 ** (round(2 * np.log2(BREAKING / max(length, 1e-3))) / 2)
    height = float(min(height, max(own, SMALLEST)))
    if np.isinf(end):
        return height
    most = min(height * end + 1e-9, max(2 * FOLLOWED, 1 << int(np.ceil(np.log2(OF_END * end)))) * share)
    return 2 * max(int(most / 2), 2) / end


def sites_at(height: float, end: float = np.inf) -> int:
    """Contacts followed at H/λc, a power of two that covers any end."""
    return FOLLOWED if np.isinf(end) else max(FOLLOWED, 1 << int(np.ceil(np.log2(end * height - 1e-6))))


def _alike(fine: Any, rough: Any) -> Any:
    return abs(fine - rough) <= ALIKE * fine


def coarser(body: Body, height: Any) -> Body:
    """Blocks on larger contacts, H/λc = `height`, of the same areal stiffness."""
    block, interface = body
    larger = block.height / height
    contacts = eqx.tree_at(lambda x: (x.height, x.stiffness), block, (np.asarray(height), block.stiffness * larger))
    if interface is None:
        return contacts, None
    return contacts, eqx.tree_at(lambda x: x.threshold_slope, interface, interface.threshold_slope * larger)


def _views(body: Body, kind: EventKind) -> Float[np.ndarray, "4 n"]:
    """Look at the events of many blocks on contacts of two sizes.

    Rows are H/λc of the finer ones, how many are followed, and both lengths in contacts. The first length is inf where the
    event does not stop within what can be followed. The second, on contacts twice as large, is not looked for where the first
    is on the block's own.

    Ever finer contacts lengthen an event, near run-away without bound: one that stops on coarse contacts may never stop on
    finer ones. So its lengths on contacts of two sizes must be alike. Far from the edge the stress on the contact ahead tends
    to 2φ/(1 + R_ii), R_ii > 0: without an equivalent prestress of half the threshold, or falling thresholds, every front stops.
    """
    block, interface = body
    tall = np.asarray(block.height, float)
    prestress, slope = (0.0, 0.0) if interface is None else (interface.equivalent_prestress, interface.threshold_slope)
    falling = np.broadcast_to(np.asarray(slope) < 0, tall.shape)
    lasting, endless = (np.asarray(prestress) > 0) | falling, (2 * np.asarray(prestress) >= 1) | falling
    found = np.stack([tall, np.full_like(tall, FOLLOWED), *np.full((2, tall.size), np.inf)])
    left = np.arange(tall.size)
    # an event that runs away on the largest contacts does so on smaller ones; falling thresholds reach zero before the last
    driven = np.flatnonzero(endless & ~falling)
    found[0, driven] = np.minimum(tall[driven], FOLLOWED / MOST_HEIGHTS)
    status = _events(coarser(_some(body, driven), found[0, driven]), FOLLOWED, kind)[2]
    left = np.setdiff1d(left, driven[status == Outcome.RAN_THROUGH])
    for sites in (FOLLOWED, FARTHER):
        height, fine, bounded = _fitting(_some(body, left), sites, kind)
        found[:, left] = height, np.full_like(height, sites), fine, fine
        larger = (height != tall[left]) & np.isfinite(fine)
        left, bounded = left[larger], bounded[larger]
        found[3, left] = _events(coarser(_some(body, left), found[0, left] / 2), sites, kind)[0]
        differ = ~_alike(found[2, left], 2 * found[3, left]) & lasting[left]
        left, bounded = left[differ], bounded[differ]
    found[2, left[bounded & endless[left]]] = np.inf
    return found


def _fitting(body: Body, sites: int, kind: EventKind) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find H/λc where events fit `sites` contacts; ℓ; whether finer ones failed.

    An event should break `ENOUGH` of `FOLLOWED` contacts. One that breaks them all although they reach over `MOST_HEIGHTS` has
    no length (inf): on still larger contacts it would stop only because they are so large.
    """
    finer, tall = sites / FOLLOWED, np.asarray(body[0].height, float)
    push = 1.0 if body[0].push.height is None else np.asarray(body[0].push.height)
    height, most, length = np.minimum(tall, BELOW_PUSH * finer / push), tall.copy(), np.empty_like(tall)
    left = np.arange(tall.size)
    while left.size:
        at = height[left]
        length[left], broken, status = _events(coarser(_some(body, left), at), sites, kind)
        through = status == Outcome.RAN_THROUGH
        most[left] = np.where(through, at / 1.5, most[left])
        factor = np.clip(1.5 * ENOUGH * finer / np.maximum(broken, 1), 1.5, 16.0)
        height[left] = np.where(through, most[left], np.minimum(at * factor, most[left]))
        again = np.where(through, at * MOST_HEIGHTS >= 1.5 * sites, (at < most[left]) & (broken < ENOUGH * finer))
        height[left[~again]] = at[~again]
        left = left[again]
    return height, length, most < tall


# --- many blocks -------------------------------------------------------------------------------------------------------


def many(
    height: Any,
    stiffness: Any,
    poisson: Any,
    push_height: Any,
    push_width: Any = None,
    control: Control = "displacement",
    *,
    length: Any = None,
    normal_stiffness: Any = None,
    friction: Any = None,
    contact_law: ContactLaw = "amontons",
    top: Top = "free",
) -> Block:
    """Many blocks as one, of arrays, pushed on patches or above heights."""
    push = Push(0.5, None if push_width is None else 0.5, control)
    ended, sprung, rubbing = (None if x is None else 2.0 for x in (length, normal_stiffness, friction))
    one = Block(2.0, 1.0, 0.0, push, "stress", ended, sprung, rubbing, contact_law, top)
    if friction is not None and normal_stiffness is None:
        normal_stiffness = USUAL_NORMAL_STIFFNESS
    every = height, stiffness, poisson, push_height, push_width, length, normal_stiffness, friction
    columns = [x for x in every if x is not None]
    return jax.tree.unflatten(jax.tree.structure(one), np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in columns)))


def lengths(block: Block, interface: Interface | None, kind: EventKind) -> Float[np.ndarray, " n"]:
    """ℓ of many half-infinite blocks: `precursor_length` to rounding, inf where it refuses."""
    body, height = (block, interface), np.asarray(block.height)
    tall, short = (np.nonzero(side)[0] for side in (height > TALL, height <= TALL))
    found = np.empty(height.size)
    found[tall] = tall_lengths(*_some(body, tall), kind)[0]
    found[short], _, status = _events(_some(body, short), FOLLOWED, kind)
    for i in short[status == Outcome.RAN_THROUGH]:
        try:
            with jax.enable_x64(True):
                found[i] = precursor_length(*_some(body, i), None, None, kind)
        except NotFollowed:
            found[i] = np.inf
    return found


def tall_lengths(block: Block, interface: Interface | None, kind: EventKind) -> tuple[np.ndarray, np.ndarray]:
    """ℓ of many blocks from larger contacts, and possible errors; shapes (n,).

    Lengths are 0 where no domino starts, inf where the event does not stop within the contacts followed, and NaN where the
    block lifts off. The error of an infinite length is set to H, for the blocks beside it in a table.
    """
    height, _, fine, rough = _views((block, interface), kind)
    endless = np.isposinf(fine)
    with np.errstate(invalid="ignore"):  # inf − inf
        found, error = extrapolated(fine, rough, height, block.height, _b(block))
    return np.where(endless, np.inf, found), np.where(endless, np.asarray(block.height), error)


def _some(body: Body, which: Any) -> Body:
    """Some of many blocks, or one."""
    return jax.tree.map(lambda x: x[which], body)


def _events(body: Body, sites: int, kind: EventKind) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lengths, contacts broken and statuses of many blocks, or none; shapes (n,)."""
    if not np.size(body[0].height):
        return np.empty(0), np.empty(0), np.empty(0)
    length, broken, status = followed(body, np.asarray(body[0].stiffness)[:, None], sites, kind)[:, :, 0, 0]
    lost = ~np.isin(status, (Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.REBREAK, Outcome.RAN_THROUGH, Outcome.LIFT_OFF))
    if lost.any():
        block, interface = _some(body, np.argmax(lost))
        raise _without_length(block, interface, status[lost][0])
    return length, broken, status


def followed(
    body: Body,
    stiffness: Float[np.ndarray, "n m"],
    sites: int,
    kind: EventKind,
    friction: Float[np.ndarray, "n f"] | None = None,
) -> Float[np.ndarray, "3 n m f"]:
    """Length, contacts broken and status of blocks at several contact stiffnesses each.

    The block itself is computed once for all stiffnesses. With `friction`, each is followed at several coefficients of it, and
    its response is computed once for all. NaN asks for nothing.
    """
    if friction is not None:
        block = eqx.tree_at(lambda x: x.friction, body[0], np.ones(len(stiffness)))
        body = block, body[1]
    leaves, tree = jax.tree.flatten(body)
    columns = [] if friction is None else [*friction.T]
    lanes = [np.asarray(x, float) for x in (*leaves, *stiffness.T, *columns)]
    kernel = _followed(tree, stiffness.shape[1], len(columns), sites, kind)
    return np.moveaxis(np.stack(over_lanes(kernel, lanes, ONE_BY_ONE)), -1, 1)


@functools.cache
def _followed(tree: Any, stiffnesses: int, frictions: int, sites: int, kind: EventKind) -> Kernel:
    def events(lane: Float[Array, "fields lanes"]) -> tuple[Array, ...]:
        numbers, first = lane[:, 0], tree.num_leaves
        block, interface = jax.tree.unflatten(tree, list(numbers[:first]))
        if block.length is not None:
            block = eqx.tree_at(lambda x: x.length, block, jnp.rint(block.length).astype(jnp.int32))
        bare = blocks.unattached(block)
        asked = numbers[first + stiffnesses :] if frictions else jnp.zeros(1)

        def at(k: Array) -> Float[Array, "f 3"]:
            body = blocks.contacts_of(eqx.tree_at(lambda x: x.stiffness, block, k), interface, sites, bare)

            def event(friction: Array) -> Float[Array, "3"]:
                found = length_of(blocks.with_friction(body, friction) if frictions else body, kind)
                return jnp.stack([x.astype(k.dtype) for x in found])

            return _wanted(event, asked, 3)

        found = _wanted(at, numbers[first : first + stiffnesses], asked.size, 3)
        return tuple(found[:, :, i, None] for i in range(3))

    return events


def _wanted(function: Callable[[Array], Array], given: Float[Array, " n"], *shape: int) -> Array:
    """`function` of each number, one after another, and NaN for NaN."""
    return lax.map(lambda x: lax.cond(jnp.isnan(x), lambda x: jnp.full(shape, x), function, x), given)
