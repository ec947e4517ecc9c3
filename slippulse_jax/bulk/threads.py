"""Work spread over what this process has: its cores, and its local devices."""

import functools
import itertools
import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import jax

Piece = TypeVar("Piece")


def cores() -> int:
    """Cores this process may use (a batch system or ``taskset`` may give it fewer than the machine has)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def workers() -> int:
    """Threads that work is spread over: one a core, and at least one a local device."""
    return max(cores(), len(jax.local_devices()))


def spread(work: Callable[[Piece], None], pieces: Iterable[Piece]) -> None:
    """Call ``work(piece)`` for every piece, in double precision, the pieces dealt to the local devices in turn.

    Each piece runs whole, by the same compiled program, on one device: which one, and beside what, does not show in its bits
    (a program compiled for several devices at once would round differently).
    """
    dealt = list(zip(pieces, itertools.cycle(jax.local_devices())))  # noqa: B905  # the devices go round

    def run(dealt: tuple[Piece, Any]) -> None:
        piece, device = dealt
        with jax.enable_x64(True), jax.default_device(device):  # settings of the thread
            work(piece)

    if len(dealt) == 1:
        run(dealt[0])
        return
    for _ in _pool(workers()).map(run, dealt):
        pass


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads are kept: to start them and their first call takes longer than ten thousand lengths. `spread` is never nested."""
    return ThreadPoolExecutor(threads)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads are not copied


def compiled_once(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function`, compiled by one thread: those that meet a new program together would each compile it."""
    first, met = threading.Lock(), threading.Event()

    def call(*arguments: Any) -> Any:
        if met.is_set():
            return function(*arguments)
        with first:
            found = function(*arguments)
            met.set()
        return found

    return call
