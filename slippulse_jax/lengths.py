"""First precursors by the million.

NumPy in and out, double precision, every lane by itself.
"""

import functools
from typing import Any, Literal, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from slippulse_jax.base.choices import EventKind
from slippulse_jax.base.domains import Domain, check_choice, check_kind
from slippulse_jax.base.status import Outcome
from slippulse_jax.blocks.size import ONE_BY_ONE, coarser, extrapolated, trials
from slippulse_jax.bodies.modes import FARTHEST
from slippulse_jax.bodies.response import MOST_SITES
from slippulse_jax.bulk.chunks import Kernel, Lanes, Layout, over_lanes
from slippulse_jax.bulk.derivatives import with_gradient, with_jacobian
from slippulse_jax.events.event import MORE_SITES
from slippulse_jax.events.first import length as whole_length
from slippulse_jax.exact import bulk as exact_lanes
from slippulse_jax.exact.crossing import expected_length
from slippulse_jax.front import lanes
from slippulse_jax.front.arrest import (
    MOST_BREAKS,
    Arrest,
    LengthDerivatives,
    arrest,
    report_without_length,
)
from slippulse_jax.interface import Interface, check_bulk
from slippulse_jax.rules import BreakRule, check_rule
from slippulse_jax.slider import Slider

LENGTHS, WITH_MORE, ENDED = Layout(few=64, worth_a_thread=16), Layout(), Layout(chunk=504)
ANY = Layout(chunk=256, fusion_emitters=False)
"""Layouts: of the loops of `lanes` for the length alone, with more results, and with ends; of the general recursion."""

ROOM = 1.25
"""Sites resolved at first, over the length of the front: an event seldom goes a fifth farther."""
FEW_SITES = 64
"""Smallest number of sites resolved of a slider. The largest is `MOST_SITES`; longer events are followed on larger contacts."""


@overload
def precursor_lengths(
    slider: Slider,
    interface: Interface | None = None,
    *,
    rule: BreakRule | None = None,
    event: EventKind = "domino",
    derivatives: Literal[0] = 0,
) -> np.ndarray: ...
@overload
def precursor_lengths(
    slider: Slider,
    interface: Interface | None = None,
    *,
    rule: BreakRule | None = None,
    event: EventKind = "domino",
    derivatives: Literal[1],
) -> LengthDerivatives: ...
def precursor_lengths(
    slider: Slider,
    interface: Interface | None = None,
    *,
    rule: BreakRule | None = None,
    event: EventKind = "domino",
    derivatives: Literal[0, 1] = 0,
) -> np.ndarray | LengthDerivatives:
    """Lengths ℓ of a batch of any size, and their derivatives.

    Lengths are in λc, results NumPy float64.

    The numbers of `precursor_length` to rounding, in double precision whatever the JAX flags. Lanes are computed in the order
    of their expected length and in chunks of fixed shapes, so that none waits for a much longer one. A result never depends on
    the rest of the batch. Not traceable: inside ``jit`` use ``jax.vmap`` of `precursor_length`.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast.
    interface, rule
        As for `precursor_length`; the numbers of a smooth rule broadcast with the slider.
    event : {"domino", "full"}
        Length of the first front, in which each contact breaks once; or of the whole event, in which contacts may break again.
        The two differ where the edge contact is back at its threshold before the front stops (`REBREAK`,
        `rebreaking_onset`).
    derivatives : {0, 1}
        Highest order of derivatives.

    Returns
    -------
    numpy.ndarray or LengthDerivatives
        ℓ, float64, of the shape of the batch: 0 where no domino starts, inf where the front never stops, NaN where it was given
        up, with a warning. With ``derivatives=1`` a `LengthDerivatives`, in all numbers of slider, interface and rule.

    Notes
    -----
    A whole event takes some 10 µs per break by the general cascade, and a program per number of sites that takes seconds to
    compile: 80 breaks at H/λc = 50 and b = 6, 14 000 at 10⁴ and b = 5, 85 000 at 10⁴ and b = 40. Its length steps where the
    order of breaks changes; the derivatives are those at a fixed order, which differ from its trend.
    """
    check_kind("slider", slider, Slider)
    found = lengths(slider, interface, rule=rule, event=event, derivatives=derivatives)
    _warn_of_missing(found.length if isinstance(found, LengthDerivatives) else found, slider)
    return found


def lengths(
    slider: Slider,
    interface: Interface | None = None,
    *,
    rule: BreakRule | None = None,
    event: EventKind = "domino",
    derivatives: int = 0,
    most: int = MOST_BREAKS,
) -> Any:
    """`precursor_lengths` without warnings; fronts are given up after `most` breaks."""
    check_choice("event", event, EventKind)
    check_rule(rule)
    if event == "full":
        if rule is not None:
            raise ValueError("event = 'full': needs the paper's rule, rule=None")
        return whole_lengths(slider, interface, derivatives)
    if derivatives not in (0, 1):
        raise ValueError(f"derivatives = {derivatives!r}: must be 0 or 1, the highest order of derivatives wanted")
    smooth = rule is not None
    columns, shape, kind = _columns(slider, interface, rule)
    general, own = general_kernel(kind, most, derivatives), columns
    if smooth or (derivatives and not _is_simple(slider)):
        (found,) = over_lanes(general, columns, ANY, length_rank)
    elif derivatives:
        (found,) = _by_loop(lanes.gradient_kernel(most), WITH_MORE, columns, general, columns)
    else:
        kernel, layout = lanes.length_kernel(most), LENGTHS
        if not _is_simple(slider):
            # a missing end is too far, a missing machine too stiff, to matter
            far = (FARTHEST if x is None else np.minimum(x, FARTHEST) for x in (slider.length, slider.machine))
            right = "free" if slider.right == "semi-infinite" else slider.right
            numbers = Slider(slider.height, slider.stiffness, slider.poisson)
            own = _columns(numbers, interface or Interface(), (*far,))[0]
            kernel, layout = lanes.length_kernel(most, right), ENDED
        long = exact_lanes.which_are_long(columns) if len(columns) == 3 and most > exact_lanes.LONG else ()
        rest, found = slice(None), np.full(len(columns[0]), np.nan)
        if len(long):  # relaxed fronts of which some are expected to be long: those by the series, where it settles
            found[long] = exact_lanes.long_lengths([x[long] for x in columns], most)
            rest = np.isnan(found)
        (found[rest],) = _by_loop(kernel, layout, [x[rest] for x in own], general, [x[rest] for x in columns])
    if not derivatives:
        return found.reshape(shape)
    length, *slopes = (column.reshape(shape) for column in found)
    return LengthDerivatives(length, *jax.tree.unflatten(kind, slopes))


def _by_loop(kernel: Kernel, layout: Layout, columns: Lanes, general: Kernel, given: Lanes) -> list[np.ndarray]:
    """Results by a loop over lanes; stiff ones by the general recursion."""
    if not np.max(given[1], initial=0) > lanes.STIFFEST:
        return over_lanes(kernel, columns, layout, length_rank)
    stiff, found = given[1] > lanes.STIFFEST, []
    for where, program, numbers, how in ((~stiff, kernel, columns, layout), (stiff, general, given, ANY)):
        some = over_lanes(program, [x[where] for x in numbers], how, length_rank)
        found = found or [np.empty((*x.shape[:-1], stiff.size), x.dtype) for x in some]
        for row, x in zip(found, some, strict=True):
            row[..., where] = x
    return found


def arrests(slider: Slider, interface: Interface | None = None, *, most: int = MOST_BREAKS) -> Arrest:
    """Count, length, status and edge stress of a batch of any size.

    An `Arrest` of NumPy arrays of its shape: the numbers of `precursor_lengths`, with the outcome of each lane. None raises or
    warns.
    """
    columns, shape, kind = _columns(slider, interface)
    general = general_arrest_kernel(kind, most)
    if _is_simple(slider):
        found = _by_loop(lanes.arrest_kernel(most), WITH_MORE, columns, general, columns)
    else:
        found = over_lanes(general, columns, ANY, length_rank)
    return Arrest(*(x.reshape(shape) for x in found))


# --- whole events, in which contacts break again -----------------------------------------------------------------------


def whole_lengths(slider: Slider, interface: Interface | None, derivatives: int = 0) -> Any:
    """Lengths of fronts, and of whole events where contacts break again."""
    front = lengths(slider, interface, derivatives=derivatives)
    numbers, kind = jax.tree.flatten(front)  # the length, and its derivatives in slider and interface
    rows = np.stack(numbers)
    again = arrests(slider, interface).status == Outcome.REBREAK
    if again.any():
        columns, _, lane = _columns(slider, interface)
        rows[:, again] = event_lengths(np.stack(columns)[:, again.ravel()], lane, rows[0][again], derivatives)
    return jax.tree.unflatten(kind, list(rows))


def event_lengths(
    lanes: Float[np.ndarray, "fields n"], kind: Any, front: Float[np.ndarray, " n"], derivatives: int = 0
) -> Float[np.ndarray, "rows n"]:
    """ℓ of whole events, and derivatives at a fixed order of breaks.

    Beyond an onset of the areal stiffness (`rebreaking_onset`) contact 0 breaks again before the front stops, and others after
    it, the most overloaded next (`slippulse_jax.events.event`), on a chain of which enough sites are resolved. `kind` is the
    tree of a lane, and `front` the length of the front of each, in λc. inf where the event runs through a chain that ends, NaN
    where it was given up.
    """
    ended = jax.tree.unflatten(kind, list(lanes))[0].length
    resolved = FEW_SITES * MORE_SITES ** np.ceil(np.maximum(np.log(ROOM * front / FEW_SITES) / np.log(MORE_SITES), 0))
    if ended is not None:
        resolved = ended.copy()
        Domain(1, MOST_SITES, f"of an event a whole number up to {MOST_SITES}", closed="high").check("Slider.length", ended)

    rows, waiting = np.full((1 + derivatives * len(lanes), lanes.shape[1]), np.nan), np.isfinite(resolved)
    for sites in trials(FEW_SITES, MOST_SITES) if ended is None else np.unique(resolved).astype(int):
        here = np.flatnonzero(waiting & (resolved <= sites))
        if here.size:
            rows[:, here] = over_lanes(event_kernel(kind, int(sites), derivatives), lanes[:, here], ONE_BY_ONE)[0]
            waiting[here] = np.isinf(rows[0, here]) & (ended is None)
    if waiting.any():
        rows[:, waiting] = _on_larger_contacts(lanes[:, waiting], kind, front[waiting], derivatives)
    return rows


def _on_larger_contacts(
    lanes: Float[np.ndarray, "fields n"], kind: Any, front: Float[np.ndarray, " n"], derivatives: int
) -> Float[np.ndarray, "rows n"]:
    """ℓ of events beyond `MOST_SITES`, from larger contacts of two sizes.

    The length over that of the front is extrapolated, to some 10⁻⁴, at b = 40 to 10⁻³. Derivatives are those on the smaller of
    the two. NaN where an event runs far beyond its front on large contacts too.
    """
    fits = MOST_SITES / (ROOM * front)
    share = np.where(fits < 1, fits, 1 / MORE_SITES)
    rows = np.full((1 + derivatives * len(lanes), len(share)), np.nan)
    able = share * lanes[0] >= FEW_SITES
    if not able.any():
        return rows
    lanes, share, found = lanes[:, able], share[able], []
    of_one, own = (jax.tree.unflatten(kind, list(x)) for x in (np.ones_like(lanes), lanes))
    for size in (share / 2, share):
        scale = np.stack(jax.tree.leaves(coarser(of_one[:2], size)))
        stops = lengths(*jax.tree.unflatten(kind, list(scale * lanes))[:2])
        event = event_lengths(scale * lanes, kind, stops, derivatives)
        found.append(size * event[0] / stops)
        rows[1:, able] = event[1:] * scale[: len(event) - 1] / size
    rows[0, able] = front[able] * extrapolated(found[1], found[0], share, np.ones_like(share), np.asarray(own[0].b))[0]
    return rows


@functools.cache
def event_kernel(kind: Any, sites: int, derivatives: int) -> Kernel:
    """ℓ of one lane, and derivatives at a fixed order of breaks."""

    def length(*numbers: Array) -> Array:
        slider, interface, _ = jax.tree.unflatten(kind, numbers)
        return whole_length(slider, interface, sites=sites, kind="full")

    return lambda lanes: ((with_gradient(length)(*lanes[:, 0]) if derivatives else length(*lanes[:, 0])[None])[:, None],)


# --- the general recursion, for chunks of lanes --------------------------------------------------------------------------


@functools.cache
def general_arrest_kernel(kind: Any, most: int) -> Kernel:
    """`Arrest` of lanes; `kind` is the tree of a lane."""

    def one(lane: Array) -> Arrest:
        slider, interface, _ = jax.tree.unflatten(kind, list(lane))
        return arrest(slider, interface, most=most)

    return lambda lanes: tuple(map(jnp.asarray, jax.vmap(one, in_axes=1)(lanes)))


@functools.cache
def general_kernel(kind: Any, most: int, derivatives: int) -> Kernel:
    """ℓ of lanes; with derivatives rows: ℓ, its slope in every number."""

    def one(lane: Array) -> Array:
        slider, interface, rule = jax.tree.unflatten(kind, list(lane))
        return jnp.asarray(arrest(slider, interface, rule, most=most).length)

    mapped = jax.vmap(with_jacobian(one) if derivatives else one, in_axes=1, out_axes=-1)
    return lambda lanes: (mapped(lanes),)


def _is_simple(slider: Slider) -> bool:
    """Whether sliders have neither an end nor a machine."""
    return slider.length is None and slider.machine is None


def _columns(slider: Slider, interface: Interface | None, more: Any = None) -> tuple[list[Float[np.ndarray, " n"]], Any, Any]:
    """Numbers of all lanes, shape of the batch, tree of a lane."""
    check_bulk(interface)
    numbers, kind = jax.tree.flatten((slider, interface, more))
    if any(isinstance(x, Tracer) for x in numbers):
        raise TypeError("precursor_lengths needs NumPy arrays; inside jit, grad or vmap use precursor_length")
    values = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in numbers))
    return [x.ravel() for x in values], values[0].shape, kind


def length_rank(lanes: Lanes) -> np.ndarray:
    """Rank by ln[2/(1+β)]/κ_2 of Eq. (25), as uint16, sorted by digits."""
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        expected = expected_length(*(field.astype(np.float32) for field in lanes[:3]))
    # the leading bits of a floating-point number are in its own order; from 2^-10 on
    bits = np.maximum(expected, np.float32(2**-10)).view(np.int32) >> 13
    return np.minimum(bits - ((127 - 10) << 10), 65535).astype(np.uint16)


def _warn_of_missing(found: np.ndarray, slider: Slider) -> None:
    if np.isnan(np.min(found, initial=0)):  # nothing as large as the batch is made
        # a lane without a length was given up, or overflows double precision, which the first break already shows
        missing = np.isnan(found)
        height, stiffness, poisson = (np.broadcast_to(x, found.shape)[missing] for x in jax.tree.leaves(slider)[:3])
        status = np.zeros(found.shape, np.int32)
        at_once = arrests(Slider(height, stiffness, poisson), most=1).status
        status[missing] = np.where(at_once == Outcome.INVALID, Outcome.INVALID, Outcome.LIMIT)
        report_without_length(status, raises=False, stacklevel=4)
