"""First precursors by the million: NumPy in and out, double precision, every lane by itself."""

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Float

from slippulse_jax.interface import Interface
from slippulse_jax.lattice.compiled import chunk_function, fields, shape_of
from slippulse_jax.lattice.front import DEFAULT_MAX_CONTACTS, Arrest, FrontStatus
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
    """
    check_right_end(right, sites)
    check_max_contacts(max_contacts)
    if right == "semi-infinite" and interface is None:
        lengths = sorted_lengths(_lanes(slider, None), max_contacts).reshape(slider.shape)
        status = np.where(np.isnan(lengths), FrontStatus.LIMIT, 0)  # in double precision every slider that can be made is one
    else:
        ended = precursor_arrests(slider, interface=interface, right=right, sites=sites, max_contacts=max_contacts)
        lengths, status = np.asarray(ended.length), np.asarray(ended.status)
    if np.isnan(lengths).any():
        report_without_length(status, max_contacts, raises=False)
    return lengths


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
    lanes = _lanes(slider, interface).T
    order = np.argsort(length_rank(lanes.T[:3]), kind="stable")
    result = Arrest(*(np.empty(len(lanes), dtype) for dtype in (np.int32, np.float64, np.int32, np.float64)))
    with jax.enable_x64(True):
        arrest_chunk = chunk_function(0 if interface is None else interface.repin_delay, (right, sites, max_contacts))
        for start in range(0, len(lanes), _LANES):
            chosen = order[start : start + _LANES]
            padded = np.resize(chosen, _LANES)
            for column, values in zip(result, arrest_chunk(lanes[padded]), strict=True):
                column[chosen] = np.asarray(values)[: len(chosen)]
    shape = shape_of(slider, interface)
    return Arrest(*(column.reshape(shape) for column in result))


_LANES = 1024  # lanes a chunk: the carried state of a chunk stays in the first-level cache


def _lanes(slider: Slider, interface: Interface | None) -> Float[np.ndarray, "fields n"]:
    numbers = fields(slider, interface)
    if any(isinstance(x, Tracer) for x in numbers):
        raise TypeError("lengths in bulk take numbers, not values traced by jit, grad or vmap: use precursor_length there")
    shape = shape_of(slider, interface)
    return np.stack([np.broadcast_to(np.asarray(x, np.float64), shape).ravel() for x in numbers])
