"""Exact lengths by the million: NumPy in and out, double precision, with derivatives, every lane by itself."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax.bulk.threads import compiled_once, spread
from slippulse_jax.lattice import lane_crossing, lane_derivatives, lane_series
from slippulse_jax.lattice.exact import AnyArrayLike, check_interface, exact_front
from slippulse_jax.slider import Slider

CHUNK = 128
"""Lanes of a chunk: as many as leave its table in the second-level cache."""

DERIVATIVE_CHUNKS = {1: 128, 2: 32}
"""Lanes of a chunk with derivatives up to an order, worked in NumPy."""

SAFEGUARDED_CHUNK = 16
"""Lanes of a chunk that goes through the safeguarded search of `exact_length`."""

PARAMETERS = ("height", "stiffness", "poisson", "prestress", "threshold_slope")
"""What the last axes of gradient and Hessian run over: H/λc, k/K, ν, φ, ε."""


class ExactLengths(NamedTuple):
    """Exact lengths of a batch, as NumPy arrays of its shape."""

    length: Float[np.ndarray, "..."]  # ℓ*, in λc
    status: Int[np.ndarray, "..."]  # `ExactStatus`
    gradient: Any  # array of shape (..., 5), dℓ*/d`PARAMETERS`; None unless asked for
    hessian: Any  # array of shape (..., 5, 5); None unless asked for


def exact_lengths(
    slider: Slider, *, prestress: AnyArrayLike = 0.0, threshold_slope: AnyArrayLike = 0.0, derivatives: int = 0
) -> ExactLengths:
    """Lengths ℓ* of a batch of any size, in λc, and their derivatives.

    The numbers of `exact_length` in double precision whatever the JAX flags, at a cost that does not grow with ℓ*. A lane's
    result depends on that lane alone. Not traceable: inside ``jit`` use `exact_length`.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast.
    prestress, threshold_slope : array_like
        φ and ε, as for `exact_length`; they broadcast with `slider`.
    derivatives : {0, 1, 2}
        Highest order of derivatives, with respect to `PARAMETERS`.

    Returns
    -------
    ExactLengths
        Length, status, and (``None`` where not asked for) gradient of shape (..., 5) and Hessian of shape (..., 5, 5).
        Where the length is not finite the derivatives are NaN, where nothing follows contact 0 they are 0, as the length is.

    Notes
    -----
    Relative error ≤ 1e-11, of derivatives 1e-8 of the largest. Lengths alone run through one compiled program; with derivatives
    they are worked in NumPy, which has nothing to compile and takes longer a lane. The two agree to 1e-12, not to the last bit.

    Raises
    ------
    ValueError
        If `prestress` or `threshold_slope` lies outside its domain, or `derivatives` is none of 0, 1, 2.
    TypeError
        If a value is traced by JAX.
    """
    if derivatives not in (0, 1, 2):
        raise ValueError(f"derivatives = {derivatives!r}: must be 0, 1 or 2, the highest order of derivatives wanted")
    numbers = slider.height, slider.stiffness, slider.poisson, prestress, threshold_slope
    if any(isinstance(x, Tracer) for x in numbers):
        raise TypeError("lengths in bulk take numbers, not values traced by jit, grad or vmap: use exact_length there")
    check_interface(prestress, threshold_slope)
    shape = np.broadcast_shapes(*(np.shape(x) for x in numbers))
    lanes = np.stack([np.broadcast_to(np.asarray(x, np.float64), shape).ravel() for x in numbers])
    found = solve_lanes(lanes, derivatives)
    return ExactLengths(*(None if x is None else x.reshape((*shape, *x.shape[1:])) for x in found))  # pyright: ignore[reportArgumentType]


def solve_lanes(lanes: Float[np.ndarray, "5 n"], derivatives: int = 0) -> ExactLengths:
    """`exact_lengths` of lanes (`PARAMETERS` first, checked by the caller)."""
    count = lanes.shape[1]
    found = ExactLengths(
        np.empty(count),
        np.empty(count, np.int32),
        np.empty((count, 5)) if derivatives else None,
        np.empty((count, 5, 5)) if derivatives > 1 else None,
    )
    if derivatives:
        _in_chunks(
            lanes, np.arange(count), DERIVATIVE_CHUNKS[derivatives], functools.partial(_with_derivatives, derivatives), found
        )
        return found
    order = np.argsort(_effort(lanes), kind="stable")
    prestressed = lanes[3, order] != 0  # a family of terms more: a lane's own value chooses its program
    for kind in (False, True):
        _in_chunks(lanes, order[prestressed == kind], CHUNK, lambda theta, kind=kind: _compiled(kind)(theta), found)
    unsettled = np.flatnonzero(found.status == lane_crossing.UNSETTLED)
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


def _in_chunks(lanes: np.ndarray, order: np.ndarray, size: int, function: Any, found: ExactLengths) -> None:
    """Fill `found` at `order`, chunk by chunk, on every core."""
    outputs = [x for x in found if x is not None]

    def run(chosen: np.ndarray) -> None:
        with jax.numpy_rank_promotion("allow"):  # lanes are last in every array, so that missing axes are the leading ones
            values = function(np.take(lanes, np.resize(chosen, size), axis=1))
        for column, value in zip(outputs, values, strict=True):
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
        front = exact_front(Slider(theta[0], theta[1], theta[2]), prestress=theta[3], threshold_slope=theta[4])
        return front.length, front.status

    return compiled_once(jax.jit(jax.vmap(one, in_axes=1)))
