"""First precursors by the million: NumPy in and out, double precision, every lane by itself."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jax.core import Tracer
from jaxtyping import Float

from slippulse_jax.devices import spread
from slippulse_jax.interface import Interface
from slippulse_jax.lattice.compiled import chunk_function, fields, gradient_function, shape_of
from slippulse_jax.lattice.front import DEFAULT_MAX_CONTACTS, AnyArray, Arrest, FrontStatus
from slippulse_jax.lattice.lanes import length_rank, sorted_lengths
from slippulse_jax.lattice.modes import RightEnd, check_right_end
from slippulse_jax.lattice.precursor import check_max_contacts, report_without_length
from slippulse_jax.slider import Slider


def precursor_lengths(
    slider: Slider,
    *,
    interface: Interface | None = None,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> np.ndarray:
    """Lengths ℓ of a batch of any size, in λc, as NumPy float64.

    The same numbers as `precursor_length` in double precision whatever the JAX flags, computed lane by lane in the
    order of their expected length and in chunks of one fixed shape, so that no lane waits for a much longer one. A
    result never depends on the rest of the batch. Not traceable: inside ``jit`` use ``jax.vmap`` of `precursor_length`.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast.
    interface, right, sites, max_contacts
        As for `precursor_length`.

    Returns
    -------
    numpy.ndarray
        float64, of shape ``slider.shape``; inf and NaN as for `precursor_length`, with a warning for the latter.

    Examples
    --------
    >>> precursor_lengths(Slider([[10.0], [25.0]], [0.01, 0.03], 0.3)).round(2)
    array([[ 7.27,  9.72],
           [21.64, 25.79]])
    """
    found = lengths(slider, interface=interface, right=right, sites=sites, max_contacts=max_contacts)
    if np.isnan(found).any():
        # in double precision every slider that can be made is one, and what has no length was given up
        report_without_length(np.where(np.isnan(found), FrontStatus.LIMIT, 0), max_contacts, raises=False)
    return found


def lengths(
    slider: Slider,
    *,
    interface: Interface | None = None,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> np.ndarray:
    """`precursor_lengths` without warnings."""
    check_right_end(right, sites)
    check_max_contacts(max_contacts)
    if right == "semi-infinite" and interface is None:
        return sorted_lengths(_lanes(slider, None), max_contacts).reshape(slider.shape)
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
    lanes = _lanes(slider, interface)
    chunk = chunk_function(0 if interface is None else interface.repin_delay, (right, sites, max_contacts))
    columns = in_chunks(chunk, lanes, (np.int32, np.float64, np.int32, np.float64))
    shape = shape_of(slider, interface)
    return Arrest(*(column.reshape(shape) for column in columns))


class LengthGradient(NamedTuple):
    """Lengths of a batch and their derivatives, of the shape of the batch; in λc (the slope: λc per σ_s a site)."""

    length: np.ndarray
    height: np.ndarray
    stiffness: np.ndarray
    poisson: np.ndarray
    prestress: np.ndarray | None = None
    threshold_slope: np.ndarray | None = None


def precursor_length_gradients(
    slider: Slider,
    *,
    interface: Interface | None = None,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> LengthGradient:
    """Lengths ℓ of a batch of any size and their derivatives with respect to every parameter, as NumPy float64.

    The derivatives are those of `precursor_length` (its kinks at whole contacts included), computed lane by lane as in
    `precursor_lengths`; parameters and errors as there. Not finite where the length is not. With an `interface`, the
    derivatives with respect to prestress and threshold slope too.
    """
    check_right_end(right, sites)
    check_max_contacts(max_contacts)
    lanes = _lanes(slider, interface)
    chunk = gradient_function(0 if interface is None else interface.repin_delay, (right, sites, max_contacts))
    columns = in_chunks(chunk, lanes, (np.float64,) * (1 + len(lanes)))
    shape = shape_of(slider, interface)
    return LengthGradient(*(column.reshape(shape) for column in columns))


LANES = 1024
"""Lanes a chunk of `in_chunks`: its carried state stays in the nearest cache."""


def in_chunks(
    function: Callable[[np.ndarray], Iterable[AnyArray]], lanes: Float[np.ndarray, "fields n"], dtypes: Sequence[type]
) -> list[np.ndarray]:
    """Columns of a function of chunks of lanes, shape (LANES, fields): lanes of like length together, on every core."""
    order = np.argsort(length_rank(lanes[:3]), kind="stable")
    columns = [np.empty(lanes.shape[1], dtype) for dtype in dtypes]

    def run(chosen: np.ndarray) -> None:
        padded = lanes.T[np.resize(chosen, LANES)]
        for column, values in zip(columns, function(padded), strict=True):
            column[chosen] = np.asarray(values)[: len(chosen)]

    spread(run, [order[start : start + LANES] for start in range(0, len(order), LANES)][::-1])
    return columns


def _lanes(slider: Slider, interface: Interface | None) -> Float[np.ndarray, "fields n"]:
    numbers = fields(slider, interface)
    if any(isinstance(x, Tracer) for x in numbers):
        raise TypeError("lengths in bulk take numbers, not values traced by jit, grad or vmap: use precursor_length there")
    shape = shape_of(slider, interface)
    return np.stack([np.broadcast_to(np.asarray(x, np.float64), shape).ravel() for x in numbers])
