"""Run a function of many lanes at full speed.

A lane is one column of numbers, such as one slider. Lanes are cut into chunks, padded to a fixed shape, and run on every core.
A lane that waits for a slower one wastes time, so lanes are ordered by a rank of their expected cost, which the caller
supplies. A call of the compiled program takes many chunks one after another: a chunk stays in the cache, and the cost of a
call is shared. Each thread ranks, gathers, computes and scatters its own piece of the input, so that no part of the work is
left to one core.

An accelerator runs all lanes of a chunk in step and needs many at once: there a call takes one wide chunk, and lanes are not
ordered.
"""

import functools
import itertools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.stages import Compiled
from jaxtyping import Array, Float, Int

from slippulse_jax.base.process import check_process
from slippulse_jax.bulk.compiler import check_jit, compiled, local_devices

Kernel = Callable[[Float[Array, "fields lanes"]], tuple[Array, ...]]
"""Results of a chunk of lanes, each with the lanes last. No lane may depend on another.

A program is compiled once for each function object: a module's function, or one from a factory under ``functools.cache``.
"""

Lanes = Sequence[Float[np.ndarray, " n"]] | Float[np.ndarray, "fields n"]
"""The numbers of all lanes, field by field."""

Rank = Callable[[Lanes], np.ndarray]
"""Order in which lanes are taken, by expected cost; best as uint16, which NumPy sorts by digits."""


class Layout(NamedTuple):
    """Chunk size and compiler option of a kernel, for its speed."""

    chunk: int = 1000
    """Lanes per chunk; not a power of two, for which arrays would compete for the same lines of the cache. With one lane per
    chunk the kernel takes no more, and stays on the CPU."""
    few: int = 0
    """Number of lanes up to which a smaller program takes them at once; 0 for one program fewer to compile."""
    worth_a_thread: int = 1
    """Chunks below which a second thread costs more than it saves: the interpreter lock changes hands, and a core wakes up."""
    fusion_emitters: bool = True
    """Whether XLA's newer code generator writes the program. The older one takes half the time to compile wide formulas, which
    then run as fast or faster. The last digit depends on it."""


DEFAULT_LAYOUT = Layout()

PIECE = 32
"""Largest number of chunks per call."""
WIDE, NARROW = 512, 32
"""Chunks of a CPU that make one chunk of an accelerator: for many lanes, and for few, whose arrays take some megabytes."""

_compiling = threading.RLock()


def over_lanes(kernel: Kernel, lanes: Lanes, layout: Layout = DEFAULT_LAYOUT, rank: Rank | None = None) -> list[np.ndarray]:
    """Evaluate ``kernel`` at every lane, in double precision.

    The kernel is traced and compiled on first use; missing axes are the leading ones (``numpy_rank_promotion`` is "allow").
    Return its results, lanes last, in the order given. They do not depend on batch, chunk, order or device: each call runs
    whole on one device, by a program compiled for one. Large temporary arrays are avoided: the system provides their memory
    anew at every call, which costs as much as the arithmetic on them.
    """
    check_process()
    check_jit()
    count, fields = len(lanes[0]), len(lanes)
    devices = local_devices(cpu=layout.chunk == 1)
    in_step = devices[0].platform != "cpu" and layout.chunk > 1
    width, most, hands = _plan(count, layout, in_step, len(devices))
    # every hand takes as many strided slices, of lanes that are neighbours in the batch
    rounds = -(-count // (width * most * hands))
    ends = [k * count // max(rounds, 1) for k in range(rounds + 1)]
    pieces = [slice(start + hand, stop, hands) for start, stop in itertools.pairwise(ends) for hand in range(hands)]
    devices = devices[: max(len(pieces), 1)]  # the shapes are needed even without lanes
    with _compiling:  # of threads that need the same program one compiles it
        programs = [_program(kernel, fields, width, most, device, layout.fusion_emitters) for device in devices]
    results = [np.empty((*x.shape[:-1], count), x.dtype) for x in programs[0].out_info]

    def run(number: int) -> None:
        where, device = pieces[number], number % len(devices)
        here = [field[where] for field in lanes]
        size = len(here[0])
        order = np.arange(size) if rank is None or in_step else np.argsort(rank(here), kind="stable")
        padded = np.empty((fields, width * most))
        for field, row in zip(here, padded, strict=True):
            np.take(field, order, out=row[:size], mode="clip")
        chunks = -(-size // width)
        padded[:, size : chunks * width] = padded[:, :1]  # the cheapest lane, where lanes are ranked
        with jax.enable_x64(True), jax.default_device(devices[device]):  # settings of the thread
            values = programs[device](padded, np.int64(chunks))
        for result, value in zip(results, values, strict=True):
            rows, every = result.reshape(-1, count), np.asarray(value).reshape(-1, padded.shape[1])
            if len(rows) > size:  # of few lanes that return much
                for lane, own in enumerate(order.tolist()):
                    rows[:, where.start + own * hands] = every[:, lane]
                continue
            # row by row: NumPy scatters several dimensions far more slowly
            for row, found in zip(rows, every, strict=True):
                back = np.empty(size, row.dtype)
                back[order] = found[:size]
                row[where] = back

    each = map if len(pieces) == 1 or workers() == 1 else _pool(workers()).map
    for _ in each(run, range(len(pieces))):
        pass
    return results


def _plan(count: int, layout: Layout, in_step: bool, devices: int) -> tuple[int, int, int]:
    """Lanes per chunk, most chunks per call, and calls side by side."""
    if in_step:
        return layout.chunk * (NARROW if count <= NARROW * layout.chunk else WIDE), 1, devices
    if 0 < count <= layout.few:
        return layout.few, 1, 1
    chunks = -(-count // layout.chunk)  # a part of a chunk takes as long as a whole one
    return layout.chunk, PIECE, max(1, min(workers(), chunks // layout.worth_a_thread))


@functools.cache
def _program(kernel: Kernel, fields: int, width: int, most: int, device: Any, emitters: bool) -> Compiled:
    """Program for one device and up to `most` chunks."""
    traced = jax.jit(kernel, inline=True)  # once, for the shapes of its results and for its place in the loop

    def all_chunks(lanes: Float[Array, "fields n"], chunks: Int[Array, ""]) -> tuple[Array, ...]:
        def cut(i: Array | int) -> Array:
            return lax.dynamic_slice(lanes, (0, i * width), (fields, width))

        # carry the chunk itself: XLA would slice it wherever a number is used, without vectors. A kernel should return
        # few arrays: XLA hands some operations to other threads in a loop body of more than eight
        def next_chunk(i: Array, carried: tuple[Array, tuple[Array, ...]]) -> tuple[Array, tuple[Array, ...]]:
            here, results = carried
            found = zip(results, traced(here), strict=True)
            return cut(i + 1), tuple(lax.dynamic_update_slice_in_dim(x, y, i * width, -1) for x, y in found)

        if most == 1:
            return traced(lanes)
        empty = tuple(jnp.zeros((*x.shape[:-1], lanes.shape[1]), x.dtype) for x in jax.eval_shape(traced, cut(0)))
        return lax.fori_loop(0, chunks, next_chunk, (cut(0), empty))[1]

    shapes = jax.ShapeDtypeStruct((fields, width * most), np.float64), jax.ShapeDtypeStruct((), np.int64)
    return compiled(all_chunks, *shapes, device=device, fusion_emitters=emitters, named=(kernel, width))


def distinct_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct rows and their indices, several times as fast as ``numpy.unique``."""
    order = np.lexsort(rows.T)
    in_order = rows[order]
    is_new = np.append(True, (in_order[1:] != in_order[:-1]).any(axis=1))[: len(rows)]
    own = np.empty(len(rows), int)
    own[order] = np.cumsum(is_new) - 1
    return in_order[is_new], own


# --- threads -------------------------------------------------------------------------------------------------------------

_here = threading.local()


@contextmanager
def in_this_thread() -> Iterator[None]:
    """Work in this thread alone, as for callers with their own threads."""
    before, _here.alone = getattr(_here, "alone", False), True
    try:
        yield
    finally:
        _here.alone = before


def workers() -> int:
    """Number of threads: one per core, or one within `in_this_thread`."""
    # a batch system or ``taskset`` may give the process fewer cores than the machine has
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return 1 if getattr(_here, "alone", False) else max(cores, len(jax.local_devices()))


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Keep the threads: starting them takes longer than ten thousand lengths."""
    return ThreadPoolExecutor(threads)
