"""Run a function of many lanes at full speed.

Lanes are cut into chunks, padded to a fixed shape, and run on every core.

A lane is one column of numbers, such as one slider. A lane that waits for a slower one wastes time, so lanes are ordered by a
rank of their expected cost, which the caller supplies. A call of the compiled program takes many chunks one after another: a
chunk stays in the cache, and the cost of a call is shared. Each thread ranks, gathers, computes and scatters its own piece of
the input, so that no part of the work is left to one core.

An accelerator runs all lanes of a chunk in step and needs many at once: there a call takes one wide chunk, and lanes are not
ordered.
"""

import functools
import itertools
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.stages import Compiled
from jaxtyping import Array, Float, Int

from slippulse_jax.bulk.compiler import compiled
from slippulse_jax.bulk.threads import default_device, local_devices, spread, workers

Kernel = Callable[[Float[Array, "fields lanes"]], tuple[Array, ...]]
"""Results of a chunk of lanes, each with the lanes last. No lane may depend on another.

A program is compiled once for each function object: a module's function, or one from a factory under ``functools.cache``.
"""

Lanes = Sequence[Float[np.ndarray, " n"]] | Float[np.ndarray, "fields n"]
"""The numbers of all lanes, field by field."""

Rank = Callable[[Lanes], np.ndarray]
"""Order in which lanes are taken, by expected cost; best as uint16, which NumPy sorts by digits."""


class Layout(NamedTuple):
    """How lanes are laid out for a kernel, and its program compiled. Costs depend on it; results only on `fusion_emitters`."""

    chunk: int = 1000
    """Lanes per chunk; not a power of two, for which arrays would compete for the same lines of the cache. With one lane per
    chunk the kernel takes no more, and stays on the CPU."""
    few: int = 0
    """Number of lanes up to which a smaller program takes them at once; 0 for one program fewer to compile."""
    worth_a_thread: int = 1
    """Chunks below which a second thread costs more than it saves: the interpreter lock changes hands, and a core wakes up."""
    fusion_emitters: bool = True
    """Whether XLA's newer code generator writes the program. The older one takes half the time to compile wide formulas, which
    then run as fast or faster; the last digit differs. Programs that promise each other's bits need the same."""


DEFAULT_LAYOUT = Layout()

PIECE = 32
"""Largest number of chunks per call."""
WIDE, NARROW = 512, 32
"""Chunks in the wide one of an accelerator, and in that for few lanes; its temporary arrays take a few megabytes at most."""

_compiling = threading.RLock()


def over_lanes(kernel: Kernel, lanes: Lanes, layout: Layout = DEFAULT_LAYOUT, rank: Rank | None = None) -> list[np.ndarray]:
    """Evaluate ``kernel`` at every lane, in double precision.

    Parameters
    ----------
    kernel : Kernel
        Traced and compiled on first use. Missing axes are the leading ones (``numpy_rank_promotion`` is "allow").
    lanes : sequence of numpy.ndarray, shape (n,)
        float64, one array per field.
    layout : Layout
    rank : callable, optional
        Maps lanes to their order; as given by default.

    Returns
    -------
    list of numpy.ndarray
        The kernel's results, lanes last, in the order given: the same bits in any batch, chunk, order or device.

    Notes
    -----
    Large temporary arrays are avoided: the system provides their memory anew at every call, which costs as much as the
    arithmetic on them.
    """
    count, fields = len(lanes[0]), len(lanes)
    devices = local_devices(cpu=layout.chunk == 1)
    in_step = devices[0].platform != "cpu" and layout.chunk > 1
    pieces, program, width = _in_step(count, layout) if in_step else _in_turn(count, layout)
    devices, rank = devices[: max(len(pieces), 1)], None if in_step else rank  # the shapes are needed even without lanes
    with _compiling:  # of threads that need the same program one compiles it
        ready = {device: program(kernel, fields, width, device, layout.fusion_emitters) for device in devices}
    results = [np.empty((*x.shape[:-1], count), x.dtype) for x in next(iter(ready.values())).out_info]

    def run(where: slice) -> None:
        here = [field[where] for field in lanes]
        size = len(here[0])
        order = None if rank is None else np.argsort(rank(here), kind="stable")
        padded = np.empty((fields, width if program is _at_once else PIECE * width))
        for field, row in zip(here, padded, strict=True):
            if order is None:
                row[:size] = field
            else:
                np.take(field, order, out=row[:size], mode="clip")
        chunks = -(-size // width)
        padded[:, size : chunks * width] = padded[:, :1]  # pad with the cheapest lane
        values = ready[default_device()](padded, np.int64(chunks))
        for result, value in zip(results, values, strict=True):
            for row, found in zip(result.reshape(-1, count), np.asarray(value).reshape(-1, padded.shape[1]), strict=True):
                if order is None:
                    row[where] = found[:size]
                else:  # one dimension at a time: NumPy scatters several far more slowly
                    back = np.empty(size, row.dtype)
                    back[order] = found[:size]
                    row[where] = back

    spread(run, pieces, devices)
    return results


def distinct_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct rows, and the index of each row among them; by hashes, several times as fast as sorting rows."""
    odd = np.random.default_rng(0).integers(2**63, size=rows.shape[1], dtype=np.uint64) * 2 + 1
    _, first, own = np.unique(np.ascontiguousarray(rows).view(np.uint64) @ odd, return_index=True, return_inverse=True)
    if not np.array_equal(rows[first][own], rows):  # two rows of one hash: never seen
        different, own = np.unique(rows, axis=0, return_inverse=True)
        return different, own.ravel()
    return rows[first], own


Plan = tuple[list[slice], Callable[..., Compiled], int]
"""The slice of the batch of each call, the program that takes it, and the lanes of a chunk."""


def _in_turn(count: int, layout: Layout) -> Plan:
    """Chunk by chunk: every worker gets as many strided slices, of lanes that are neighbours in the batch."""
    chunks = -(-count // layout.chunk)  # a part of a chunk takes as long as a whole one
    hands = max(1, min(workers(), chunks // layout.worth_a_thread))
    rounds = -(-chunks // (hands * PIECE))
    ends = [k * count // rounds for k in range(rounds)] + [count]
    pieces = [slice(start + hand, stop, hands) for start, stop in itertools.pairwise(ends) for hand in range(hands)]
    return (pieces, _at_once, layout.few) if count <= layout.few else (pieces, _chunk_by_chunk, layout.chunk)


def _in_step(count: int, layout: Layout) -> Plan:
    """One chunk per call."""
    width = layout.chunk * (NARROW if count <= NARROW * layout.chunk else WIDE)
    return [slice(start, start + width) for start in range(0, count, width)], _at_once, width


@functools.cache
def _traced(kernel: Kernel) -> Callable[..., tuple[Array, ...]]:
    """The kernel, traced once for the shapes of its results and for its place in the loop."""
    return jax.jit(kernel, inline=True)


@functools.cache
def _at_once(kernel: Kernel, fields: int, width: int, device: Any, emitters: bool) -> Compiled:
    """Program for a few lanes on one device."""
    return compiled(
        lambda lanes, _: _traced(kernel)(lanes), _input(fields, width), _COUNT, device=device, fusion_emitters=emitters
    )


@functools.cache
def _chunk_by_chunk(kernel: Kernel, fields: int, width: int, device: Any, emitters: bool) -> Compiled:
    """Program for up to `PIECE` chunks; the rest of its input is ignored."""

    def all_chunks(lanes: Float[Array, "fields n"], chunks: Int[Array, ""]) -> tuple[Array, ...]:
        traced = _traced(kernel)

        def cut(i: Array | int) -> Array:
            return lax.dynamic_slice(lanes, (0, i * width), (fields, width))

        # carry the chunk itself: XLA would slice it wherever a number is used, without vectors. A kernel should return
        # few arrays: XLA hands some operations to other threads in a loop body of more than eight
        def next_chunk(i: Array, carried: tuple[Array, tuple[Array, ...]]) -> tuple[Array, tuple[Array, ...]]:
            here, results = carried
            found = zip(results, traced(here), strict=True)
            return cut(i + 1), tuple(lax.dynamic_update_slice_in_dim(x, y, i * width, -1) for x, y in found)

        shapes = jax.eval_shape(traced, _input(fields, width))
        empty = tuple(jnp.zeros((*x.shape[:-1], lanes.shape[1]), x.dtype) for x in shapes)
        return lax.fori_loop(0, chunks, next_chunk, (cut(0), empty))[1]

    return compiled(all_chunks, _input(fields, PIECE * width), _COUNT, device=device, fusion_emitters=emitters)


_COUNT = jax.ShapeDtypeStruct((), np.int64)


def _input(fields: int, lanes: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((fields, lanes), np.float64)
