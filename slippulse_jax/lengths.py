"""First precursors by the million.

NumPy in and out, double precision, every lane by itself.
"""

import functools
from typing import Any, Literal, TypedDict, Unpack, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from slippulse_jax.bodies.modes import ENDLESS, NO_END, Ends, RightEnd, ends_of
from slippulse_jax.bulk.chunks import Kernel, Lanes, Layout, over_lanes
from slippulse_jax.derivatives import with_jacobian
from slippulse_jax.domains import check_kind
from slippulse_jax.events.event import MORE_SITES
from slippulse_jax.events.first import length_of
from slippulse_jax.exact import bulk as exact_lanes
from slippulse_jax.exact.crossing import expected_length
from slippulse_jax.front import lanes
from slippulse_jax.front.arrest import arrest, check_max_contacts, report_without_length
from slippulse_jax.front.front import DEFAULT_MAX_CONTACTS, Arrest, EventKind, LengthDerivatives, check_event
from slippulse_jax.interface import Interface, check_bulk
from slippulse_jax.rules import HARD, BreakRule, HardBreak, check_rule
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome
from slippulse_jax.units import Numbers

LENGTHS, WITH_MORE, ENDED = Layout(few=64, worth_a_thread=16), Layout(), Layout(chunk=504)
ANY = Layout(chunk=256, fusion_emitters=False)
"""Layouts: of the loops of `lanes` for the length alone, with more results, and with ends; of the general recursion."""

ROOM = 1.25
"""Sites resolved at first, over the length of the front: an event seldom goes a fifth farther."""
FEW_SITES, MOST_SITES = 128, 2**11
"""Smallest and largest number of sites resolved of a slider; longer events are followed on larger contacts."""
ONE_BY_ONE = Layout(chunk=1, fusion_emitters=False)
"""Each lane is a loop of its own."""


class Options(TypedDict, total=False):
    """Options of `precursor_lengths` on which the type of its result does not depend."""

    rule: BreakRule
    right: RightEnd
    sites: Numbers | None
    machine: Numbers | None
    max_contacts: int
    event: EventKind


@overload
def precursor_lengths(
    slider: Slider, interface: Interface | None = None, *, derivatives: Literal[0] = 0, **options: Unpack[Options]
) -> np.ndarray: ...
@overload
def precursor_lengths(
    slider: Slider, interface: Interface | None = None, *, derivatives: Literal[1], **options: Unpack[Options]
) -> LengthDerivatives: ...
def precursor_lengths(
    slider: Slider,
    interface: Interface | None = None,
    *,
    rule: BreakRule = HARD,
    right: RightEnd = "semi-infinite",
    sites: Numbers | None = None,
    machine: Numbers | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
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
    interface, rule, right, sites, machine, max_contacts
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
        up, with a warning. With ``derivatives=1`` a `LengthDerivatives`, in all numbers of slider, interface, rule and ends.

    Notes
    -----
    A whole event takes some 10 µs per break by the general cascade, and a program per number of sites that takes seconds to
    compile: 80 breaks at H/λc = 50 and b = 6, 14 000 at 10⁴ and b = 5, 85 000 at 10⁴ and b = 40. Its length steps where the
    order of breaks changes; the derivatives are those at a fixed order, which differ from its trend.
    """
    check_kind("slider", slider, Slider)
    ends = ends_of(right, sites, machine)
    found = lengths(slider, interface, rule=rule, ends=ends, max_contacts=max_contacts, event=event, derivatives=derivatives)
    _warn_of_missing(found.length if isinstance(found, LengthDerivatives) else found, slider, max_contacts)
    return found


def lengths(
    slider: Slider,
    interface: Interface | None = None,
    *,
    rule: BreakRule = HARD,
    ends: Ends = ENDLESS,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
    event: EventKind = "domino",
    derivatives: int = 0,
) -> Any:
    """`precursor_lengths` without warnings."""
    check_event(event)
    check_rule(rule)
    if event == "full":
        return whole_lengths(slider, interface, rule, ends, max_contacts, derivatives)
    check_max_contacts(max_contacts)
    if derivatives not in (0, 1):
        raise ValueError(f"derivatives = {derivatives!r}: must be 0 or 1, the highest order of derivatives wanted")
    smooth = not isinstance(rule, HardBreak)
    columns, shape, kind = _columns(slider, interface, rule, ends)
    general, own = general_kernel(kind, max_contacts, derivatives), columns
    if smooth or (derivatives and not _is_simple(ends)):
        (found,) = over_lanes(general, columns, ANY, length_rank)
    elif derivatives:
        (found,) = _by_loop(lanes.gradient_kernel(max_contacts), WITH_MORE, columns, general, columns)
    else:
        kernel, layout = lanes.length_kernel(max_contacts), LENGTHS
        if not _is_simple(ends):
            # a missing end is too far, a missing machine too stiff, to matter
            sites, machine = (NO_END if x is None else np.where(np.isinf(x), NO_END, x) for x in (ends.sites, ends.machine))
            own = _columns(slider, interface or Interface(), HARD, Ends(ends.right, sites, machine))[0]
            right = "free" if ends.right == "semi-infinite" else ends.right  # a chain without end has a free one at `NO_END`
            kernel, layout = lanes.length_kernel(max_contacts, right), ENDED
        long = exact_lanes.which_are_long(columns) if len(columns) == 3 and max_contacts > exact_lanes.LONG else ()
        rest, found = slice(None), np.full(len(columns[0]), np.nan)
        if len(long):  # relaxed fronts of which some are expected to be long: those by the series, where it settles
            found[long] = exact_lanes.long_lengths([x[long] for x in columns], max_contacts)
            rest = np.isnan(found)
        (found[rest],) = _by_loop(kernel, layout, [x[rest] for x in own], general, [x[rest] for x in columns])
    if not derivatives:
        return found.reshape(shape)
    length, *slopes = (column.reshape(shape) for column in found)
    return LengthDerivatives(length, *jax.tree.unflatten(kind, slopes))


def _by_loop(kernel: Kernel, layout: Layout, columns: Lanes, general: Kernel, given: Lanes) -> list[np.ndarray]:
    """Results of a loop over lanes; of the general recursion where contacts are so stiff that it cannot be run back."""
    if not np.max(given[1], initial=0) > lanes.STIFFEST:
        return over_lanes(kernel, columns, layout, length_rank)
    stiff, found = given[1] > lanes.STIFFEST, []
    for where, program, numbers, how in ((~stiff, kernel, columns, layout), (stiff, general, given, ANY)):
        some = over_lanes(program, [x[where] for x in numbers], how, length_rank)
        found = found or [np.empty((*x.shape[:-1], stiff.size), x.dtype) for x in some]
        for row, x in zip(found, some, strict=True):
            row[..., where] = x
    return found


def whole_lengths(
    slider: Slider, interface: Interface | None, rule: BreakRule, ends: Ends, max_contacts: int, derivatives: int = 0
) -> Any:
    """Lengths of fronts, and of whole events where contacts break again."""
    if not isinstance(rule, HardBreak):
        raise ValueError("event = 'full': needs the hard rule")
    sites = None if ends.sites is None else float(np.ravel(ends.sites)[0])
    if ends.machine is not None or sites is not None and not (np.all(ends.sites == sites) and sites.is_integer()):
        raise ValueError("event = 'full': takes no machine, and one whole number of sites")
    front = lengths(slider, interface, ends=ends, max_contacts=max_contacts, derivatives=derivatives)
    # the length, and its derivatives in slider and interface
    numbers, kind = jax.tree.flatten(front._replace(ends=None) if derivatives else front)
    rows = np.stack(numbers)
    status = arrests(slider, interface, ends=ends, max_contacts=max_contacts).status
    again = status == Outcome.REBREAK
    if again.any():
        columns = np.stack(_columns(slider, interface, rule, ENDLESS)[0])[:, again.ravel()]
        rows[:, again] = event_lengths(columns, rows[0][again], ends.right, None if sites is None else int(sites), derivatives)
    return jax.tree.unflatten(kind, list(rows))


def arrests(
    slider: Slider, interface: Interface | None = None, *, ends: Ends = ENDLESS, max_contacts: int = DEFAULT_MAX_CONTACTS
) -> Arrest:
    """Count, length, status and edge stress of a batch of any size, as an `Arrest` of NumPy arrays of its shape.

    The numbers of `precursor_lengths`, with the outcome of each lane; no lane raises or warns.
    """
    check_max_contacts(max_contacts)
    columns, shape, kind = _columns(slider, interface, HARD, ends)
    general = general_arrest_kernel(kind, max_contacts)
    if _is_simple(ends):
        found = _by_loop(lanes.arrest_kernel(max_contacts), WITH_MORE, columns, general, columns)
    else:
        found = over_lanes(general, columns, ANY, length_rank)
    return Arrest(*(x.reshape(shape) for x in found))


# --- whole events, in which contacts break again -----------------------------------------------------------------------


def event_lengths(
    lanes: Float[np.ndarray, "fields n"],
    front: Float[np.ndarray, " n"],
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    derivatives: int = 0,
) -> Float[np.ndarray, "rows n"]:
    """ℓ of whole events; with derivatives in every field at a fixed order of breaks in the rows after it.

    Beyond an onset of the areal stiffness (`rebreaking_onset`) contact 0 breaks again before the front stops, and others after
    it, the most overloaded next (`slippulse_jax.events.rupture`), on a chain of which enough sites are resolved. Of lanes H/λc,
    k/K, ν, or of these and φ, ε, and of the length of the front of each, in λc; `sites` are those of a finite chain. inf where
    the event runs through that, NaN where it was given up.
    """
    found = np.full((1 + derivatives * len(lanes), lanes.shape[1]), np.nan)
    if sites is not None:
        found[:] = over_lanes(event_kernel(right, sites, derivatives), lanes, ONE_BY_ONE)[0]
        return found
    resolved = FEW_SITES * MORE_SITES ** np.ceil(np.maximum(np.log(ROOM * front / FEW_SITES) / np.log(MORE_SITES), 0))
    while (resolved <= MOST_SITES).any():
        size = int(resolved.min())
        here = np.nonzero(resolved == size)[0]
        found[:, here] = over_lanes(event_kernel(right, size, derivatives), lanes[:, here], ONE_BY_ONE)[0]
        farther = np.isinf(found[0, here])
        found[:, here[farther]] = np.nan
        resolved[here] = np.where(farther, MORE_SITES * size, np.inf)
    far = np.isfinite(resolved)
    if far.any():
        found[:, far] = _on_larger_contacts(lanes[:, far], front[far], right, derivatives)
    return found


def _on_larger_contacts(
    lanes: Float[np.ndarray, "fields n"], front: Float[np.ndarray, " n"], right: RightEnd, derivatives: int
) -> Float[np.ndarray, "rows n"]:
    """ℓ of events beyond `MOST_SITES`, from those of sliders of the same b on contacts of two larger sizes.

    The length over that of the front is extrapolated in the size of contacts, to some 10⁻⁴, at b = 40 to 10⁻³. Derivatives are
    those on the smaller of the two. NaN where an event runs far beyond its front on large contacts too.
    """
    fits = MOST_SITES / (ROOM * front)
    share = np.where(fits < 1, fits, 1 / MORE_SITES)
    rows = np.full((1 + derivatives * len(lanes), len(share)), np.nan)
    able = share * lanes[0] >= FEW_SITES
    if not able.any():
        return rows
    ratios = []
    for size in (share[able] / 2, share[able]):
        scale = np.stack([size, 1 / size, size / size, size / size, 1 / size])[: len(lanes)]
        larger = lanes[:, able] * scale
        stops = lengths(Slider(*larger[:3]), Interface(*larger[3:]) if len(lanes) > 3 else None)
        event = event_lengths(larger, stops, right, None, derivatives)
        ratios.append(event[0] / stops)
        rows[1:, able] = event[1:] * scale[: len(event) - 1] / size
    rough, fine = ratios
    rows[0, able] = front[able] * (fine + (fine - rough) * (1 - share[able]))
    return rows


@functools.cache
def event_kernel(right: RightEnd, sites: int, derivatives: int) -> Kernel:
    """ℓ of a single lane, and its derivatives; forward mode through a cascade leaves its order as it is."""

    def length(lane: Float[Array, " fields"]) -> Array:
        slider, interface = Slider(*lane[:3]), Interface(*lane[3:]) if len(lane) > 3 else None
        return length_of(slider.contacts(interface, sites, right), "full")[0]

    return lambda lanes: ((with_jacobian(length)(lanes[:, 0]) if derivatives else length(lanes[:, 0])[None])[:, None],)


# --- the general recursion, for chunks of lanes --------------------------------------------------------------------------


@functools.cache
def general_arrest_kernel(kind: Any, max_contacts: int) -> Kernel:
    """`Arrest` of lanes; `kind` is the tree that turns the numbers of a lane into slider, interface, rule and ends."""

    def one(lane: Array) -> Arrest:
        slider, interface, _, ends = jax.tree.unflatten(kind, list(lane))
        return arrest(slider, interface, ends, max_contacts)

    return lambda lanes: tuple(map(jnp.asarray, jax.vmap(one, in_axes=1)(lanes)))


@functools.cache
def general_kernel(kind: Any, max_contacts: int, derivatives: int) -> Kernel:
    """ℓ of such lanes; with derivatives an array of rows: ℓ, and its slope in every number."""

    def one(lane: Array) -> Array:
        slider, interface, rule, ends = jax.tree.unflatten(kind, list(lane))
        return jnp.asarray(arrest(slider, interface, ends, max_contacts, rule).length)

    mapped = jax.vmap(with_jacobian(one) if derivatives else one, in_axes=1, out_axes=-1)
    return lambda lanes: (mapped(lanes),)


def _is_simple(ends: Ends) -> bool:
    """Whether a slider has neither an end nor a machine."""
    return ends.sites is None and ends.machine is None


def _columns(
    slider: Slider, interface: Interface | None, rule: BreakRule, ends: Ends
) -> tuple[list[Float[np.ndarray, " n"]], Any, Any]:
    """The numbers of every lane, one array each; the shape of the batch; and the tree that reassembles the arguments."""
    check_bulk(interface)
    numbers, kind = jax.tree.flatten((slider, interface, rule, ends))
    if any(isinstance(x, Tracer) for x in numbers):
        raise TypeError("precursor_lengths needs NumPy arrays; inside jit, grad or vmap use precursor_length")
    values = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in numbers))
    return [x.ravel() for x in values], values[0].shape, kind


def length_rank(lanes: Lanes) -> np.ndarray:
    """Rank by the leading term of Eq. (25), ln[2/(1+β)]/κ_2, in steps of a thousandth; uint16, which NumPy sorts by digits."""
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        expected = expected_length(*(field.astype(np.float32) for field in lanes[:3]))
    # the leading bits of a floating-point number are in its own order; from 2^-10 on
    bits = np.maximum(expected, np.float32(2**-10)).view(np.int32) >> 13
    return np.minimum(bits - ((127 - 10) << 10), 65535).astype(np.uint16)


def _warn_of_missing(found: np.ndarray, slider: Slider, max_contacts: int) -> None:
    if np.isnan(np.min(found, initial=0)):  # nothing as large as the batch is made
        # a lane without a length was given up, or overflows double precision, which the first break already shows
        missing = np.isnan(found)
        numbers = (np.broadcast_to(x, found.shape)[missing] for x in (slider.height, slider.stiffness, slider.poisson))
        status = np.zeros(found.shape, np.int32)
        at_once = arrests(Slider(*numbers), max_contacts=1).status
        status[missing] = np.where(at_once == Outcome.INVALID, Outcome.INVALID, Outcome.LIMIT)
        report_without_length(status, max_contacts, raises=False, stacklevel=4)
