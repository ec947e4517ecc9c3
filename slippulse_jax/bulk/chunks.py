"""Functions of many lanes at full speed: lanes of like length together, in few fixed shapes, on every core.

A lane that waits for a longer one wastes time, so lanes are sorted by expected length, and a call of a compiled function takes
them chunk by chunk: a chunk stays in the cache, and what a call costs beside the arithmetic is shared by many. A piece of the
input is ranked, gathered, computed and put back by one thread, so that no part of the work is left to one core.
"""

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.bulk.threads import compiled_once, spread, workers

Kernel = Callable[[Float[Array, "fields lanes"]], tuple[Array, ...]]
"""Columns of a chunk of lanes, or several as the rows of one array; no lane may depend on another."""


class Layout(NamedTuple):
    """How lanes are laid out for a kernel. No number depends on it, only what it costs."""

    chunk: int = 1000
    """Lanes of a chunk: not a power of two, for which arrays would meet in the same lines of the cache."""
    few: int = 0
    """Lanes of a call for so few that a chunk would be mostly padding; 0 for one program fewer to compile."""
    worth_a_thread: int = 1
    """Chunks of which another thread takes no fewer. To hand it some costs as much as some chunks: Python's lock is passed on,
    and a core woken."""


PIECE = 32
"""Chunks of a call, at most."""


def over_lanes(
    kernel: Callable[..., Kernel],
    statics: tuple,
    lanes: Sequence[Float[np.ndarray, " n"]] | Float[np.ndarray, "fields n"],
    dtypes: Sequence[type],
    layout: Layout,
) -> list[np.ndarray]:
    """Columns of ``kernel(*statics)`` at every lane, in the order given; the same bits in any company.

    Parameters
    ----------
    kernel : callable
        Makes the function to be compiled; called once for each `statics`.
    lanes : sequence of numpy.ndarray, shape (n,)
        Height, stiffness, Poisson's ratio and any others, float64. Large temporary arrays are avoided: the system provides
        their memory anew at every call, which costs as much as the arithmetic on them.
    """
    chunk, few, _ = layout
    columns = [np.empty(len(lanes[0]), dtype) for dtype in dtypes]
    at_once, in_chunks = _compiled(kernel, statics), _looped(kernel, statics, chunk)

    def run(where: slice) -> None:
        here = [field[where] for field in lanes]
        order = np.argsort(length_rank(here), kind="stable")
        count = len(order)
        chunks = -(-count // chunk)
        padded = np.empty((len(here), few if count <= few else PIECE * chunk))
        for field, row in zip(here, padded, strict=True):
            np.take(field, order, out=row[:count], mode="clip")
        padded[:, count : chunks * chunk] = padded[:, :1]  # the shortest: nobody waits for it
        values = at_once(padded) if count <= few else in_chunks(padded, chunks)
        rows = itertools.chain.from_iterable(np.atleast_2d(np.asarray(value)) for value in values)
        for column, row in zip(columns, rows, strict=True):
            back = np.empty(count, column.dtype)
            back[order] = row[:count]
            column[where] = back

    spread(run, _pieces(len(lanes[0]), layout))
    return columns


def _pieces(n: int, layout: Layout) -> Iterator[slice]:
    """Where in the batch the pieces lie: every worker gets as many, of lanes that are neighbours in the batch."""
    chunks = -(-n // layout.chunk)  # what is less than a chunk takes as long as one
    hands = max(1, min(workers(), chunks // layout.worth_a_thread))
    rounds = -(-chunks // (hands * PIECE))
    for k in range(rounds):
        start, stop = k * n // rounds, (k + 1) * n // rounds
        for hand in range(hands):
            yield slice(start + hand, stop, hands)


def length_rank(lanes: Sequence[np.ndarray]) -> np.ndarray:
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


# chunks run beside each other already, so that nothing in one is to be split; and the widest vectors there are serve loops of
# this length
_OPTIONS: Any = {
    "xla_cpu_multi_thread_eigen": False,
    "xla_cpu_prefer_vector_width": 512,
    "xla_disable_hlo_passes": "cpu-parallel-task-assigner",
}


@functools.cache
def _compiled(kernel: Callable[..., Kernel], statics: tuple) -> Callable[..., tuple[Array, ...]]:
    return compiled_once(jax.jit(kernel(*statics), compiler_options=_OPTIONS))


@functools.cache
def _looped(kernel: Callable[..., Kernel], statics: tuple, chunk: int) -> Callable[[np.ndarray, int], tuple[Array, ...]]:
    """One program for any number of chunks: the rest of the array is not looked at."""
    one = kernel(*statics)

    def several(lanes: Float[Array, "fields n"], chunks: Int[Array, ""]) -> tuple[Array, ...]:
        fields, n = lanes.shape

        def cut(i: Array | int) -> Array:
            return lax.dynamic_slice(lanes, (0, i * chunk), (fields, chunk))

        # a chunk is handed on cut out: XLA would cut it wherever a number is used, and use no vectors. Few arrays come out of
        # one: of a turn of more than eight operations XLA hands some to other threads
        def go_on(i: Array, carried: tuple[Array, tuple[Array, ...]]) -> tuple[Array, tuple[Array, ...]]:
            here, columns = carried
            found = zip(columns, one(here), strict=True)
            return cut(i + 1), tuple(lax.dynamic_update_slice_in_dim(x, y, i * chunk, -1) for x, y in found)

        shapes = jax.eval_shape(one, jax.ShapeDtypeStruct((fields, chunk), lanes.dtype))
        empty = tuple(jnp.zeros((*x.shape[:-1], n), x.dtype) for x in shapes)
        return lax.fori_loop(0, chunks, go_on, (cut(0), empty))[1]

    return compiled_once(jax.jit(several, compiler_options=_OPTIONS))
