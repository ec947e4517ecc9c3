"""First precursors by the million: NumPy in and out, double precision, every lane by itself."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Float

from slippulse_jax.bulk.chunks import Lanes, Layout, over_lanes
from slippulse_jax.interface import Interface
from slippulse_jax.lattice import compiled, lanes, long_fronts
from slippulse_jax.lattice.compiled import fields
from slippulse_jax.lattice.front import DEFAULT_MAX_CONTACTS, Arrest
from slippulse_jax.lattice.modes import RightEnd, check_right_end
from slippulse_jax.lattice.precursor import HARD, check_max_contacts, report_without_length
from slippulse_jax.rules import BreakRule, SmoothBreak, check_rule
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

LENGTHS, WITH_MORE, ANY = Layout(few=64, worth_a_thread=16), Layout(), Layout(chunk=256)
"""Of the recursion for lanes, for the length alone (`benchmarks` has the cost of a point at 10⁴) and with more; of the general
recursion."""


Columns = list[Float[np.ndarray, " n"]]
"""The numbers of every lane, one array each."""


def precursor_lengths(
    slider: Slider,
    *,
    interface: Interface | None = None,
    rule: BreakRule = HARD,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> np.ndarray:
    """Lengths ℓ of a batch of any size, in λc, as NumPy float64.

    The numbers of `precursor_length` in double precision whatever the JAX flags, to rounding, computed lane by lane in the
    order of their expected length and in chunks of fixed shapes, so that no lane waits for a much longer one. A result never
    depends on the rest of the batch. Not traceable: inside ``jit`` use ``jax.vmap`` of `precursor_length`.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast.
    interface, rule, right, sites, max_contacts
        As for `precursor_length`; the numbers of a smooth rule broadcast with the slider.

    Returns
    -------
    numpy.ndarray
        float64, of the shape of the batch; inf and NaN as for `precursor_length`, with a warning for the latter.
    """
    found = lengths(slider, interface=interface, rule=rule, right=right, sites=sites, max_contacts=max_contacts)
    _warn_of_missing(found, slider, max_contacts)
    return found


def lengths(
    slider: Slider,
    *,
    interface: Interface | None = None,
    rule: BreakRule = HARD,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> np.ndarray:
    """`precursor_lengths` without warnings."""
    check_rule(rule)
    if isinstance(rule, SmoothBreak):
        columns, shape, statics = _smooth_lanes(slider, rule, interface, right, max_contacts)
        return over_lanes(compiled.smooth_kernel(*statics), columns, ANY, length_rank)[0].reshape(shape)
    if _is_simple(interface, right):
        check_right_end(right, sites)
        check_max_contacts(max_contacts)
        columns, shape = _lanes(slider, interface)
        return _simple_lengths(columns, max_contacts).reshape(shape)
    ended = precursor_arrests(slider, interface=interface, right=right, sites=sites, max_contacts=max_contacts)
    return np.asarray(ended.length)


def precursor_arrests(
    slider: Slider,
    *,
    interface: Interface | None = None,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> Arrest:
    """Count, length, status and edge stress of a batch of any size, as an `Arrest` of NumPy arrays of its shape.

    What `precursor_lengths` computes, with all that is known of each lane; nothing is raised or warned about a lane.
    """
    check_right_end(right, sites)
    check_max_contacts(max_contacts)
    given, shape = _lanes(slider, interface)
    if _is_simple(interface, right):
        columns = over_lanes(lanes.arrest_kernel(max_contacts), given, WITH_MORE, length_rank)
    else:
        statics = 0 if interface is None else interface.repin_delay, (right, sites, max_contacts)
        columns = over_lanes(compiled.arrest_kernel(*statics), given, ANY, length_rank)
    return Arrest(*(column.reshape(shape) for column in columns))


class LengthGradient(NamedTuple):
    """Lengths of a batch and their derivatives, of the shape of the batch; in λc (threshold slope: λc per σ_s a site)."""

    length: np.ndarray
    height: np.ndarray
    stiffness: np.ndarray
    poisson: np.ndarray
    prestress: np.ndarray | None = None
    threshold_slope: np.ndarray | None = None
    rule: SmoothBreak | None = None  # with the derivatives in its numbers in their places


def precursor_length_gradients(
    slider: Slider,
    *,
    interface: Interface | None = None,
    rule: BreakRule = HARD,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> LengthGradient:
    """Lengths ℓ of a batch of any size and their derivatives with respect to every parameter, as NumPy float64.

    The derivatives are those of `precursor_length` (its kinks at whole contacts included), computed lane by lane as in
    `precursor_lengths`; parameters and errors as there. Not finite where the length is not. With an `interface`, the
    derivatives with respect to prestress and threshold slope too; with a smooth rule, those in its numbers.

    Returns
    -------
    LengthGradient
        NumPy float64, of the shape of the batch; a warning where a length is NaN.
    """
    options: Any = {"interface": interface, "rule": rule, "right": right, "sites": sites, "max_contacts": max_contacts}
    found = length_gradients(slider, **options)
    _warn_of_missing(found.length, slider, max_contacts)
    return found


def length_gradients(
    slider: Slider,
    *,
    interface: Interface | None = None,
    rule: BreakRule = HARD,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> LengthGradient:
    """`precursor_length_gradients` without warnings."""
    check_rule(rule)
    if isinstance(rule, SmoothBreak):
        columns, shape, statics = _smooth_lanes(slider, rule, interface, right, max_contacts)
        found = over_lanes(compiled.smooth_gradient_kernel(*statics), columns, ANY, length_rank)
        length, *slopes = (column.reshape(shape) for column in found)
        in_slider, in_rule = jax.tree.unflatten(statics[0], slopes)
        return LengthGradient(length, in_slider.height, in_slider.stiffness, in_slider.poisson, rule=in_rule)
    check_right_end(right, sites)
    check_max_contacts(max_contacts)
    columns, shape = _lanes(slider, interface)
    if _is_simple(interface, right):
        found = list(over_lanes(lanes.gradient_kernel(max_contacts), columns, WITH_MORE, length_rank)[0])
    else:
        statics = 0 if interface is None else interface.repin_delay, (right, sites, max_contacts)
        found = over_lanes(compiled.gradient_kernel(*statics), columns, ANY, length_rank)
    length_and_slopes: Any = [column.reshape(shape) for column in found]
    return LengthGradient(*length_and_slopes)


def _warn_of_missing(found: np.ndarray, slider: Slider, max_contacts: int) -> None:
    if np.isnan(np.min(found, initial=0)):  # nothing as large as the batch is made
        # what has no length was given up, or its numbers leave double precision: with the first break already
        numbers = [np.broadcast_to(x, found.shape)[np.isnan(found)] for x in fields(slider, None)]
        status = np.zeros(found.shape, np.int32)
        at_once = precursor_arrests(Slider(*numbers), max_contacts=1).status
        status[np.isnan(found)] = np.where(at_once == Outcome.INVALID, Outcome.INVALID, Outcome.LIMIT)
        report_without_length(status, max_contacts, raises=False, stacklevel=4)


def _simple_lengths(columns: Columns, max_contacts: int) -> Float[np.ndarray, " n"]:
    """By the recursion, or on relaxed interfaces by the series where a front is expected to be long and the series settles."""

    def by_recursion(columns: Columns) -> np.ndarray:
        return over_lanes(lanes.length_kernel(max_contacts), columns, LENGTHS, length_rank)[0]

    relaxed = len(columns) == 3 and max_contacts > long_fronts.LONG
    long = long_fronts.which_are_long(columns) if relaxed else np.zeros(0, int)
    if not len(long):
        return by_recursion(columns)
    found = np.full(len(columns[0]), np.nan)
    kernel, layout = long_fronts.long_length_kernel, long_fronts.LAYOUT
    found[long] = over_lanes(kernel(max_contacts), [x[long] for x in columns], layout, length_rank)[0]
    rest = np.isnan(found)
    found[rest] = by_recursion([x[rest] for x in columns])
    return found


def length_rank(lanes: Lanes) -> np.ndarray:
    """Rank by the leading term of Eq. (25), ln[2/(1+β)]/κ_2, in steps of a thousandth; uint16, which NumPy sorts by digits."""
    with np.errstate(over="ignore", invalid="ignore"):
        height, stiffness, poisson = (field.astype(np.float32) for field in lanes[:3])
        shape = 2 * (1 + poisson)
        b = shape * stiffness * height
        # ln(1 + x) ≈ 2x/(2 + x) at x = b/(2 + b), and 1/κ_2 = H √[shape (1 + 1/b)]
        expected = 2 * height * np.sqrt(shape * b * (1 + b)) / (4 + 3 * b)
    # the leading bits of a floating-point number are in its own order; from 2^-10 on
    bits = np.maximum(expected, np.float32(2**-10)).view(np.int32) >> 13
    return np.minimum(bits - ((127 - 10) << 10), 65535).astype(np.uint16)


def _is_simple(interface: Interface | None, right: RightEnd) -> bool:
    """Whether `slippulse_jax.lattice.lanes` has a loop of its own for it."""
    return right == "semi-infinite" and (interface is None or interface.repin_delay == 0)


def _lanes(slider: Slider, interface: Interface | None) -> tuple[Columns, tuple[int, ...]]:
    return _columns(*fields(slider, interface))


def _smooth_lanes(
    slider: Slider, rule: SmoothBreak, interface: Interface | None, right: RightEnd, max_contacts: int
) -> tuple[Columns, tuple[int, ...], tuple[Any, int]]:
    """Lanes, shape of the batch, and what else a program for a smooth rule is made of."""
    if right != "semi-infinite" or interface is not None:
        raise ValueError("a smooth rule in the fast recursion needs a relaxed, semi-infinite chain; use sp.rupture")
    check_max_contacts(max_contacts)
    numbers, kind = jax.tree.flatten((slider, rule))
    return *_columns(*numbers), (kind, max_contacts)


def _columns(*numbers: object) -> tuple[Columns, tuple[int, ...]]:
    if any(isinstance(x, Tracer) for x in numbers):
        raise TypeError("lengths in bulk take numbers, not values traced by jit, grad or vmap: use precursor_length there")
    values = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in numbers))
    return [x.ravel() for x in values], values[0].shape
