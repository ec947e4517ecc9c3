"""Exact lengths by the million: NumPy in and out, double precision, with derivatives, every lane by itself."""

import functools
import warnings
from collections.abc import Callable
from typing import Any, Literal, overload

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax.bulk.threads import compiled_once, spread
from slippulse_jax.interface import Interface
from slippulse_jax.lattice import lane_crossing, lane_derivatives, lane_series
from slippulse_jax.lattice.exact import exact_front, uniform
from slippulse_jax.lattice.front import LengthDerivatives
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

CHUNK = 128
"""Lanes of a chunk: as many as leave its table in the second-level cache."""

DERIVATIVE_CHUNKS = {1: 128, 2: 32}
"""Lanes of a chunk with derivatives up to an order, worked in NumPy."""

EXACT_OUTCOMES = (Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.INVALID, Outcome.RUN_AWAY, Outcome.NOT_CONVERGED)
"""What an exact front may end with."""

SAFEGUARDED_CHUNK = 16
"""Lanes of a chunk that goes through the safeguarded search of `exact_length`."""


@overload
def exact_lengths(slider: Slider, interface: Interface | None = None, *, derivatives: Literal[0] = 0) -> np.ndarray: ...
@overload
def exact_lengths(slider: Slider, interface: Interface | None = None, *, derivatives: Literal[1, 2]) -> LengthDerivatives: ...
def exact_lengths(
    slider: Slider, interface: Interface | None = None, *, derivatives: Literal[0, 1, 2] = 0
) -> np.ndarray | LengthDerivatives:
    """Lengths ℓ* of a batch of any size, in λc, and their derivatives.

    The numbers of `exact_length` in double precision whatever the JAX flags, at a cost that does not grow with ℓ*. The
    result of a lane depends on that lane alone. Not traceable: inside ``jit`` use `exact_length`.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast.
    interface : Interface, optional
        As for `exact_length`.
    derivatives : {0, 1, 2}
        Highest order of derivatives, with respect to H/λc, k/K, ν and, with an `interface`, φ, ε.

    Returns
    -------
    numpy.ndarray or LengthDerivatives
        float64, of the shape of the batch: 0 where no domino starts, inf where the front never stops, NaN where the crossing
        was not found, with a warning. With derivatives a record of length, slopes and, for the order 2, Hessian.

    Notes
    -----
    Relative error ≤ 1e-11, of derivatives 1e-8 of the largest. Lengths alone run through one compiled program; with derivatives
    they are worked in NumPy, which has nothing to compile and takes longer per lane. The two agree to 1e-12, not to the bit.

    Raises
    ------
    ValueError, TypeError
        If `derivatives` is none of 0, 1, 2; if the closed form does not hold for `interface`; if a value is traced by JAX.
    """
    if derivatives not in (0, 1, 2):
        raise ValueError(f"derivatives = {derivatives!r}: must be 0, 1 or 2, the highest order of derivatives")
    numbers = slider.height, slider.stiffness, slider.poisson, *uniform(interface)
    if any(isinstance(x, Tracer) for x in numbers):
        raise TypeError("exact_lengths needs NumPy arrays; inside jit, grad or vmap use exact_length")
    shape = np.broadcast_shapes(*(np.shape(x) for x in numbers))
    lanes = np.stack([np.broadcast_to(np.asarray(x, np.float64), shape).ravel() for x in numbers])
    length, status, *rest = _solve(lanes, derivatives)
    lost = np.isnan(length)
    if lost.any():
        first = tuple(int(i) for i in np.unravel_index(np.argmax(lost), shape))
        why = Outcome(int(status[lost][0])).message
        message = f"{lost.sum()} of {lost.size} exact lengths, the first at index {first}, are NaN: {why}"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
    length = length.reshape(shape)
    if not derivatives:
        return length
    count = 3 if interface is None else 5
    slopes = [x.reshape(shape) for x in rest[0].T[:count]]
    hessian = rest[1][:, :count, :count].reshape(*shape, count, count) if derivatives > 1 else None
    return LengthDerivatives(length, *slopes, hessian=hessian)


def exact_fronts(lanes: Float[np.ndarray, "5 n"]) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Length ℓ* and `Outcome` of every column (H/λc, k/K, ν, φ, ε), whose domains the caller has checked."""
    length, status = _solve(lanes, 0)
    return length, status


def _solve(lanes: Float[np.ndarray, "5 n"], derivatives: int) -> list[np.ndarray]:
    count = lanes.shape[1]
    found = [np.empty(count), np.empty(count, np.int32), np.empty((count, 5)), np.empty((count, 5, 5))][: 2 + derivatives]
    if derivatives:
        _in_chunks(
            lanes, np.arange(count), DERIVATIVE_CHUNKS[derivatives], functools.partial(_with_derivatives, derivatives), found
        )
        return found
    order = np.argsort(_effort(lanes), kind="stable")
    prestressed = lanes[3, order] != 0  # a family of terms more: a lane's own value chooses its program
    for kind in (False, True):
        _in_chunks(lanes, order[prestressed == kind], CHUNK, lambda theta, kind=kind: _compiled(kind)(theta), found)
    unsettled = np.flatnonzero(found[1] == lane_crossing.UNSETTLED)
    _in_chunks(lanes, unsettled, SAFEGUARDED_CHUNK, lambda theta: _safeguarded()(theta), found)
    return found


def _effort(lanes: np.ndarray) -> np.ndarray:
    """Rank by the work to expect, so that like lanes share a chunk.

    b sets how many Newton steps soft lanes (b < 1/2) take, κ how many rows of the series stiff ones have.
    """
    height, stiffness, poisson = lanes[:3].astype(np.float32)
    transverse = 1 / (2 * (1 + poisson) * height)
    with np.errstate(all="ignore"):
        b = stiffness / transverse
        rank = np.log2(np.where(b < 0.5, b, 2**40 * (stiffness + transverse))) * 512 + 32768
    return np.nan_to_num(rank, nan=65535).clip(0, 65535).astype(np.uint16)


def _in_chunks(lanes: np.ndarray, order: np.ndarray, size: int, function: Any, found: list[np.ndarray]) -> None:
    """Fill `found` at `order`, chunk by chunk, on every core."""

    def run(chosen: np.ndarray) -> None:
        with jax.numpy_rank_promotion("allow"):  # lanes are last in every array, so that missing axes are the leading ones
            values = function(np.take(lanes, np.resize(chosen, size), axis=1))
        for column, value in zip(found, values, strict=True):
            column[chosen] = np.asarray(value)[: len(chosen)]

    spread(run, [order[start : start + size] for start in range(0, len(order), size)])


@functools.cache
def _compiled(prestressed: bool) -> Callable[[np.ndarray], tuple[Array, ...]]:
    def chunk(theta: Float[Array, "5 lanes"]) -> tuple[Array, ...]:
        return lane_crossing.crossing(lane_series.solve(lane_series.inputs_of(theta, prestressed)), theta)

    return compiled_once(jax.jit(chunk))


def _with_derivatives(order: int, theta: np.ndarray) -> tuple[np.ndarray, ...]:
    """In NumPy, and the lanes that it leaves through the safeguarded search."""

    def search(left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = [
            _safeguarded()(np.take(theta, np.resize(left[i : i + SAFEGUARDED_CHUNK], SAFEGUARDED_CHUNK), axis=1))
            for i in range(0, len(left), SAFEGUARDED_CHUNK)
        ]
        length, status = (np.concatenate([np.asarray(x) for x in column])[: len(left)] for column in zip(*parts, strict=True))
        return length, status

    return lane_derivatives.lengths(theta, order, search)


@functools.cache
def _safeguarded() -> Callable[[np.ndarray], tuple[Array, ...]]:
    """The lanes that the fast search leaves: near run-away, on falling thresholds, next to a resonance."""

    def one(theta: Array) -> tuple[Array, ...]:
        front = exact_front(Slider(theta[0], theta[1], theta[2]), Interface(theta[3], theta[4]))
        return front.length, front.status

    return compiled_once(jax.jit(jax.vmap(one, in_axes=1)))
