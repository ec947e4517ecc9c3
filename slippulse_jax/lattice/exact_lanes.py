"""Exact lengths by the million, with derivatives.

NumPy in and out, double precision, every lane by itself.
"""

import functools
import warnings
from typing import Literal, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax import double_series as series
from slippulse_jax.bulk.chunks import Kernel, Lanes, Layout, over_lanes
from slippulse_jax.domains import check_kind
from slippulse_jax.interface import Interface
from slippulse_jax.lattice import long_fronts
from slippulse_jax.lattice.crossing import crossing, crossing_far, crossing_in_bulk, excess, system_of
from slippulse_jax.lattice.exact import uniform
from slippulse_jax.lattice.front import LengthDerivatives
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

EXACT_OUTCOMES = (Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.INVALID, Outcome.RUN_AWAY, Outcome.NOT_CONVERGED)
"""Possible outcomes of an exact front."""

IN_BULK, CAREFULLY = Layout(chunk=128, fusion_emitters=False), Layout(chunk=32, fusion_emitters=False)
"""Lanes per chunk for which a plain table fits into the second-level cache; and a regular one, with or without derivatives."""


@overload
def exact_lengths(slider: Slider, interface: Interface | None = None, *, derivatives: Literal[0] = 0) -> np.ndarray: ...
@overload
def exact_lengths(slider: Slider, interface: Interface | None = None, *, derivatives: Literal[1, 2]) -> LengthDerivatives: ...
def exact_lengths(
    slider: Slider, interface: Interface | None = None, *, derivatives: Literal[0, 1, 2] = 0
) -> np.ndarray | LengthDerivatives:
    """Lengths ℓ* of a batch of any size, and their derivatives.

    Lengths are in λc.

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
    Relative error ≤ 1e-11, of derivatives 1e-8 of the largest. Each order of derivatives is a program of its own, compiled on
    first use; the length is the same number in all.

    Raises
    ------
    ValueError, TypeError
        If `derivatives` is none of 0, 1, 2; if the closed form does not hold for `interface`; if a value is traced by JAX.
    """
    check_kind("slider", slider, Slider)
    if derivatives not in (0, 1, 2):
        raise ValueError(f"derivatives = {derivatives!r}: must be 0, 1 or 2, the highest order of derivatives")
    numbers = slider.height, slider.stiffness, slider.poisson, *uniform(interface)
    if any(isinstance(x, Tracer) for x in numbers):
        raise TypeError("exact_lengths needs NumPy arrays; inside jit, grad or vmap use exact_length")
    shape = np.broadcast_shapes(*(np.shape(x) for x in numbers))
    lanes = np.stack([np.broadcast_to(np.asarray(x, np.float64), shape).ravel() for x in numbers])
    length, status = exact_fronts(lanes)
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
    flat = np.where(status == Outcome.ARRESTED, length.ravel(), 1)
    found = over_lanes(_derivatives(count, derivatives), np.vstack([lanes, flat]), CAREFULLY)
    # a constant where nothing follows contact 0; never a number where there is no length
    elsewhere = np.where(status == Outcome.NO_DOMINO, 0, np.nan)
    first, *second = (np.where(status == Outcome.ARRESTED, x, elsewhere) for x in found)
    hessian = np.moveaxis(second[0], -1, 0).reshape(*shape, count, count) if second else None
    return LengthDerivatives(length, *(x.reshape(shape) for x in first), hessian=hessian)


def exact_fronts(
    lanes: Float[np.ndarray, "5 n"], *, one_program: bool = False
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Length ℓ* and `Outcome` of every column (H/λc, k/K, ν, φ, ε), whose domains the caller has checked.

    The values of a lane choose its program; lanes that one program leaves go to the next. Relaxed lanes that cross far from the
    edge use the few terms of the series that remain there; the others a plain series, which has one more family of terms with a
    prestress. The few lanes for which that does not give every digit use a regular series, which takes longer.

    With `one_program` lanes far from the edge have no program of their own, and their last digits differ: compiling one more
    takes longer than some thousand lanes do.
    """
    found = np.full((2, lanes.shape[1]), float(Outcome.NOT_CONVERGED))
    prestressed = lanes[3] != 0
    far = ~prestressed & (lanes[4] == 0) & (not one_program) & long_fronts.which_are_far(lanes)
    for kernel, layout, rank, wanted in (
        (_far, long_fronts.FAR, None, far),
        (_relaxed, IN_BULK, _effort, ~prestressed),
        (_prestressed, IN_BULK, _effort, prestressed),
        (_careful, CAREFULLY, None, True),
    ):
        left = (found[1] == Outcome.NOT_CONVERGED) & wanted
        if left.any():
            (found[:, left],) = over_lanes(kernel, lanes[:, left], layout, rank)
    return found[0], found[1].astype(np.int32)


def _far(theta: Float[Array, "5 lanes"]) -> tuple[Array]:
    found = series.solve_far(system_of(theta, prestressed=False))
    return (jnp.stack(crossing_far(found, theta)),)


def _relaxed(theta: Float[Array, "5 lanes"]) -> tuple[Array]:
    found = series.solve(system_of(theta, prestressed=False), regular=False)
    return (jnp.stack(crossing_in_bulk(found, theta)),)


def _prestressed(theta: Float[Array, "5 lanes"]) -> tuple[Array]:
    found = series.solve(system_of(theta, prestressed=True), regular=False)
    return (jnp.stack(crossing_in_bulk(found, theta)),)


def _careful(theta: Float[Array, "5 lanes"]) -> tuple[Array]:
    found = series.solve(system_of(theta, prestressed=True))
    return (jnp.stack(crossing(found, theta, careful=True)),)


@functools.cache
def _derivatives(count: int, order: int) -> Kernel:
    """Slopes of ℓ* in the first `count` parameters, and with the order 2 their slopes, at (θ, ℓ*)."""

    def slopes(theta: Float[Array, "5 lanes"], length: Float[Array, " lanes"]) -> Float[Array, "{count} lanes"]:
        def at_length(theta: Array) -> tuple[Array, Array]:
            return excess(series.solve(system_of(theta, prestressed=count > 3)), theta, length)

        def along(direction: Array) -> tuple[Array, Array]:
            (_, slope), (change, _) = jax.jvp(at_length, (theta,), (direction,))
            return change, slope

        change, slope = jax.vmap(along, out_axes=(0, None))(axes(theta))
        return -change / slope

    def axes(theta: Array) -> Array:
        """Directions along the parameters."""
        return jnp.broadcast_to(jnp.eye(5)[:count, :, None], (count, *theta.shape))

    def kernel(lanes: Float[Array, "6 lanes"]) -> tuple[Array, ...]:
        theta, length = lanes[:5], lanes[5]
        first = slopes(theta, length)
        if order == 1:
            return (first,)
        second = jax.vmap(lambda way, moves: jax.jvp(slopes, (theta, length), (way, moves))[1])(axes(theta), first)
        return first, second

    return kernel


def _effort(lanes: Lanes) -> np.ndarray:
    """Rank lanes by expected work, so that similar ones share a chunk.

    b determines the number of Newton steps of soft lanes (b < 1/2), κ the number of rows of stiff ones. A prestress above 1/2
    may exceed that of run-away, where the search is a different one.
    """
    height, stiffness, poisson, prestress = (np.asarray(x, np.float32) for x in lanes[:4])
    with np.errstate(all="ignore"):
        transverse = 1 / (2 * (1 + poisson) * height)
        b = stiffness / transverse
        rank = np.log2(np.where(b < 0.5, b, 2**40 * (stiffness + transverse))) * 256 + 16384 + 32768 * (prestress > 0.5)
    return np.nan_to_num(rank, nan=65535).clip(0, 65535).astype(np.uint16)
