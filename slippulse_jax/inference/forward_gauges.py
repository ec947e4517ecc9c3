"""Gauges as a fit sees them: slip and stress along the interface when the front has stopped.

The inputs y of `slippulse_jax.inference.forward` go on with ln x/λc; with the contacts that broke beyond ℓ*, anything from 0 to
1; and with how many broke, 0 where that is not known. What a front leaves goes over smoothly from one whole count to the next.
"""

from collections.abc import Sequence
from functools import lru_cache, partial

import jax
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.inference.forward import Prediction, by_differences, distinct_rows, values_of_length
from slippulse_jax.lattice.readings import Readings, readings
from slippulse_jax.slider import Slider

LANES = 256
STEP = 0.1  # fields bend from contact to contact, more than a length does


def slips(y: Float[np.ndarray, "L 8"], order: int, columns: Sequence[int] = range(7)) -> Prediction:
    """How far the interface has slipped at a position when the front has stopped, in u_s; inf where it never stops."""
    return by_differences(lambda y: _readings(y)[0], y, columns if order else (), STEP)


def stresses(y: Float[np.ndarray, "L 8"], order: int, columns: Sequence[int] = range(7)) -> Prediction:
    """Stress on the contacts at a position when the front has stopped, in σ_s; otherwise as `slips`."""
    return by_differences(lambda y: _readings(y)[1], y, columns if order else (), STEP)


def _readings(y: np.ndarray) -> np.ndarray:
    """Slip and stress at every lane's position, (2, L); each front runs once for all positions behind it."""
    return _readings_of(y.tobytes(), y.shape)


@lru_cache(maxsize=2)  # whoever measured slip may have measured stress at the same places
def _readings_of(numbers: bytes, shape: tuple[int, ...]) -> np.ndarray:
    y = np.frombuffer(numbers).reshape(shape)
    fronts, own = distinct_rows(y[:, [0, 1, 2, 3, 4, 6, 7]])
    counted = fronts[:, 6] > 0
    stopped = fronts[:, 6].copy()
    # contact 0 has broken even where no domino starts
    stopped[~counted] = np.maximum(values_of_length(fronts[~counted, :5]) + fronts[~counted, 5], 1)
    place = np.exp(y[:, 5])
    reach = np.maximum(stopped, 0)
    np.maximum.at(reach, own, place)
    found = np.full((2, len(y)), np.inf)
    known = np.isfinite(reach) & (reach < MOST_SITES)
    # as many contacts as the longest of its company needs, in few shapes to compile
    size = FEW_SITES * 4 ** np.ceil(np.log(np.maximum(np.where(known, reach, 0) + 2, FEW_SITES) / FEW_SITES) / np.log(4) - 1e-9)
    for count in np.unique(size[known]).astype(int):
        chosen = np.nonzero(known & (size == count))[0]
        at_once = min(LANES, max(1, LANES * 1024 // count))
        for start in range(0, len(chosen), at_once):
            part = chosen[start : start + at_once]
            fields = _after(fronts[np.resize(part, at_once)], stopped[np.resize(part, at_once)], count)
            lanes = np.nonzero(np.isin(own, part))[0]
            found[:, lanes] = _between(fields[:, np.searchsorted(part, own[lanes])], place[lanes])
    found.setflags(write=False)  # the next caller gets the same array
    return found


FEW_SITES, MOST_SITES = 64, 2**20
"""Contacts looked at, at least and at most: where a front runs farther nothing is predicted (inf)."""


def _after(fronts: np.ndarray, stopped: np.ndarray, count: int) -> np.ndarray:
    """Slip and stress of the first `count` contacts, shape (2, fronts, count)."""
    with jax.enable_x64(True):
        slider = Slider(np.exp(fronts[:, 0]), np.exp(fronts[:, 1]), fronts[:, 2])
        return np.stack(_fields_after(slider, fronts[:, 3], stopped, count))


@partial(jax.jit, static_argnums=3)
def _fields_after(slider: Slider, prestress: Array, stopped: Array, count: int) -> Readings:
    return jax.vmap(partial(readings, count=count))(slider, prestress, stopped)


def _between(fields: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Fields, (2, lanes, sites), at a place in each lane."""
    low = np.floor(place).astype(int)
    lanes = np.arange(len(place))
    left, right = fields[:, lanes, low], fields[:, lanes, low + 1]
    return left + (place - low) * (right - left)
