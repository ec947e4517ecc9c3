"""Spread work over the cores and local devices of this process."""

import functools
import itertools
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

import jax

Piece = TypeVar("Piece")


def cores() -> int:
    """Cores this process may use (a batch system or ``taskset`` may give it fewer than the machine has)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_here = threading.local()


@contextmanager
def in_this_thread() -> Iterator[None]:
    """Work in the calling thread alone, for a caller whose own threads keep all cores busy."""
    before, _here.alone = getattr(_here, "alone", False), True
    try:
        yield
    finally:
        _here.alone = before


def workers() -> int:
    """Number of threads: one per core, and at least one per local device; one within `in_this_thread`."""
    return 1 if getattr(_here, "alone", False) else max(cores(), len(jax.local_devices()))


def default_device() -> Any:
    """The device chosen by ``jax.default_device``, which within `spread` is that of the piece at hand; None if none was."""
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    return jax.local_devices(backend=chosen)[0] if isinstance(chosen, str) else chosen


def local_devices(*, cpu: bool = False) -> Sequence[Any]:
    """Devices to work on: the one chosen by ``jax.default_device``, or all; with `cpu` those of the CPU, if JAX may use it."""
    chosen = default_device()
    devices = [chosen] if chosen is not None else jax.local_devices()
    if not cpu or devices[0].platform == "cpu":
        return devices
    try:
        return jax.local_devices(backend="cpu")
    except RuntimeError:  # JAX_PLATFORMS names the accelerator alone
        return devices


def platform() -> str:
    """Platform on which an operation runs by default."""
    return local_devices()[0].platform


def spread(work: Callable[[Piece], None], pieces: Iterable[Piece], devices: Sequence[Any]) -> None:
    """Call ``work(piece)`` for every piece, in double precision, the pieces dealt to the devices in turn.

    Each piece runs whole on one device, by a program compiled for one: bits do not depend on the number of devices (a program
    compiled for several at once would round differently). Never nested.
    """
    dealt = list(zip(pieces, itertools.cycle(devices)))  # noqa: B905  # the devices go round

    def run(dealt: tuple[Piece, Any]) -> None:
        piece, device = dealt
        with jax.enable_x64(True), jax.default_device(device):  # settings of the thread
            work(piece)

    if len(dealt) == 1 or workers() == 1:
        for one in dealt:
            run(one)
        return
    for _ in _pool(workers()).map(run, dealt):
        pass


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Keep the threads: starting them takes longer than ten thousand lengths."""
    return ThreadPoolExecutor(threads)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads are not copied
