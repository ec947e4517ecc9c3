"""Functions of many lanes at full speed: lanes of like length together, in few fixed shapes, on every core.

A lane that waits for a longer one wastes time, so lanes are sorted by expected length; and what a call of a compiled function
costs beside the arithmetic (its dispatch, and memory that the system has to provide anew) is shared by many chunks. A piece of
the input is ranked, gathered, computed and put back by one thread, so that no part of the work is left to one core.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.devices import spread

Kernel = Callable[[Float[Array, "fields lanes"]], tuple[Array, ...]]
"""Columns of a chunk of lanes; no lane may depend on another."""

CHUNKS = (64, 512, 2048)
"""Lanes a chunk may have. The largest is fastest a lane; the others spare small batches its padding."""

PIECE = 4
"""Largest chunks that a call takes one after another."""


def over_lanes(
    kernel: Callable[..., Kernel],
    statics: tuple,
    lanes: Float[np.ndarray, "fields n"],
    dtypes: Sequence[type],
    sizes: tuple[int, ...] | None = None,
    piece: int | None = None,
) -> list[np.ndarray]:
    """Columns of ``kernel(*statics)`` at every lane, in the order given; the same bits in any company.

    Parameters
    ----------
    kernel : callable
        Makes the function to be compiled; called once for each `statics`.
    lanes : numpy.ndarray, shape (fields, n)
        Height, stiffness, Poisson's ratio and any others, float64.
    sizes : tuple of int, optional
        Lanes a chunk may have, `CHUNKS` by default.
    piece : int, optional
        Largest chunks a call takes one after another, `PIECE` by default. A heavy kernel is better off with 1.
    """
    sizes = CHUNKS if sizes is None else sizes
    columns = [np.empty(lanes.shape[1], dtype) for dtype in dtypes]

    def run(piece: tuple[slice | np.ndarray, int]) -> None:
        where, chunks = piece
        here = lanes[:, where]
        order = np.argsort(length_rank(here), kind="stable")
        count = len(order)
        size = next((size for size in sizes if count <= size), sizes[-1]) * chunks
        padded = np.take(here, np.resize(order, size) if count < size else order, axis=1)
        values = _compiled(kernel, statics, chunks)(padded)
        for column, value in zip(columns, values, strict=True):
            back = np.empty(count, column.dtype)
            back[order] = np.asarray(value)[:count]
            column[where] = back

    spread(run, _pieces(lanes, sizes[-1], PIECE if piece is None else piece))
    return columns


def _pieces(lanes: Float[np.ndarray, "fields n"], size: int, piece: int) -> Iterator[tuple[slice | np.ndarray, int]]:
    """Where in the batch a piece is, and its number of chunks: the last one sorted into single chunks."""
    n = lanes.shape[1]
    whole = n - n % (piece * size) if piece > 1 else 0
    for start in range(0, whole, piece * size):
        yield slice(start, start + piece * size), piece
    if whole < n:
        order = whole + np.argsort(length_rank(lanes[:, whole:]), kind="stable")
        for start in reversed(range(0, n - whole, size)):
            yield order[start : start + size], 1


def length_rank(lanes: np.ndarray) -> np.ndarray:
    """Rank by the leading term of Eq. (25), ln[2/(1+β)]/κ_2, in steps of a thousandth; uint16, which NumPy sorts by digits."""
    height, stiffness, poisson = lanes[:3].astype(np.float32)
    shape = 2 * (1 + poisson)
    b = shape * stiffness * height
    x = b / (2 + b)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        # ln(1 + x) ≈ 2x/(2 + x)
        expected = 2 * x / (2 + x) * height * np.sqrt(shape * (1 + 1 / b))
    # the leading bits of a floating-point number are in its own order; from 2^-10 on
    bits = np.maximum(expected, np.float32(2**-10)).view(np.int32) >> 13
    return np.minimum(bits - ((127 - 10) << 10), 65535).astype(np.uint16)


@functools.cache
def _compiled(kernel: Callable[..., Kernel], statics: tuple, chunks: int) -> Callable[[np.ndarray], tuple[Array, ...]]:
    one = kernel(*statics)

    def several(lanes: Float[Array, "fields n"]) -> tuple[Array, ...]:
        fields = lanes.shape[0]
        columns = lax.map(one, lanes.reshape(fields, chunks, -1).transpose(1, 0, 2))
        return tuple(column.reshape(-1) for column in columns)

    # chunks run beside each other already; and the widest vectors there are serve loops as long as these
    options: Any = {"xla_cpu_multi_thread_eigen": False, "xla_cpu_prefer_vector_width": 512}
    return jax.jit(one if chunks == 1 else several, compiler_options=options)
