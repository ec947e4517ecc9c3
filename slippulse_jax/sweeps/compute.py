"""Compute the chunks of a sweep, in this process or as tasks on a Dask cluster.

The values of a request are returned, those of a store are written to it. There, intact chunks are left alone, and damaged ones
are computed again. Each chunk comes with remarks for the user: of its damage, and of first points computed before whose digits
differ here.
"""

import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slippulse_jax.bulk.threads import in_this_thread
from slippulse_jax.sweeps.dataset import computed_by
from slippulse_jax.sweeps.outputs import OUTPUTS, evaluate
from slippulse_jax.sweeps.request import Columns, Region, Request, chunk_shape, shape_of
from slippulse_jax.sweeps.store import Store, StoreError

if TYPE_CHECKING:
    from distributed import Client

PROBE, RETRIES = 1024, 2  # points computed again to compare them; retries of a failed Dask task

ROUNDING, OF_BLOCKS = 1e-9, 1e-6
"""Difference of two computations, over their value, that may be rounding: several times the largest seen between two CPUs, or a
CPU and a GPU, which was in derivatives of a million lengths, and in lengths of blocks. Whole numbers must be equal."""

JUMP = 100
"""Of so many points one may differ by more: where a front only just stops, rounding decides."""

Result = tuple[Region, Columns | None, list[str]]
"""A chunk, its values unless they went to a store, and the remarks."""


class Probe(NamedTuple):
    """First points of a chunk as computed before; another processor or release may round differently."""

    region: Region
    columns: Columns
    origin: str

    def compare(self, request: Request) -> str:
        """Compute the points again; describe by how much their digits differ, in no words if they do not.

        Raises
        ------
        StoreError
            If they differ by more than rounding, naming output, values and point.
        """
        here = evaluate(request, self.region)
        apart = {name: _apart(before, here[name]).ravel() for name, before in self.columns.items()}
        most = {name: float(each.max()) for name, each in apart.items() if each.any()}
        allowed = {name: OF_BLOCKS if OUTPUTS[name].group == "block" else ROUNDING for name in apart}
        beyond = np.any([each > allowed[name] for name, each in apart.items()], axis=0)
        if beyond.sum() > min(beyond.size // JUMP, 1):
            name = max(most, key=lambda name: most[name] / allowed[name])
            at = int(apart[name].argmax())
            before, now = (values[name].ravel()[at].item() for values in (self.columns, here))
            point = ", ".join(f"{axis} = {request.columns(self.region)[axis][at].item()!r}" for axis in request.axes)
            raise StoreError(
                f"{name} differs by more than rounding from {self.origin}: it was {before!r} at {point}, and is {now!r} "
                f"computed on {computed_by()}. Finish the sweep where it was begun, or start a new store"
            )
        differing = ", ".join(f"{name} by up to {by:.1g}" for name, by in most.items())
        return f"digits differ from {self.origin}: {differing} of the value, now computed on {computed_by()}" if most else ""


def _apart(before: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Difference of two computations over the value; inf where only one of them is finite.

    A value that happens to be near 0 counts as a thousandth of the largest.
    """
    size = np.maximum(np.abs(before), np.abs(now))
    least = np.max(size, where=np.isfinite(size), initial=0) / 1000
    with np.errstate(invalid="ignore"):
        apart = np.abs(now - before.astype(np.float64)) / np.maximum(size, least)
    return np.where((before == now) | (np.isnan(before) & np.isnan(now)), 0.0, np.where(np.isnan(apart), np.inf, apart))


def _probe(region: Region, columns: Columns, origin: str) -> Probe:
    shape = chunk_shape(shape_of(region), PROBE)
    first = tuple(slice(whole.start, whole.start + n) for whole, n in zip(region, shape, strict=True))
    return Probe(first, {name: values[tuple(map(slice, shape))] for name, values in columns.items()}, origin)


def _stored_probe(store: Store) -> Probe | None:
    for region in store.present():
        columns, _ = store.read(region)
        if columns is not None:
            return _probe(region, columns, f"those in {store.url}, computed on {computed_by(store.about)}")
    return None


def complete(store: Store, chunks: list[Region]) -> Iterator[Result]:
    """Compute the missing chunks of a store in this process; one is written while the next is computed."""
    first = _stored_probe(store)
    digits = "" if first is None else first.compare(store.request)
    with ThreadPoolExecutor(1) as writer:
        writing: Future[None] | None = None
        for region in chunks:
            there, damage = store.read(region)
            columns = evaluate(store.request, region) if there is None else None
            if writing is not None:
                writing.result()
            writing = None if columns is None else writer.submit(store.write, region, columns)
            yield region, None, [digits, damage]
        if writing is not None:
            writing.result()


def on_cluster(client: "Client", work: Request | Store, chunks: list[Region]) -> Iterator[Result]:
    """Compute chunks on the workers, each on one thread; every process first compares its digits with the first chunk's."""
    from distributed import as_completed

    first = _stored_probe(work) if isinstance(work, Store) else None
    if first is None and chunks:
        region, *chunks = chunks
        columns, remarks = client.submit(_task, region, work, None, pure=False, retries=RETRIES).result()
        yield region, columns, remarks
        if isinstance(work, Store):
            first = _stored_probe(work)
        elif columns is not None:
            first = _probe(region, columns, "those of the first worker")
    futures = client.map(_task, chunks, work=work, first=first, pure=False, retries=RETRIES)
    regions = {future.key: region for future, region in zip(futures, chunks, strict=True)}
    try:
        for future, result in as_completed(futures, with_results=True):
            yield regions[future.key], *result
            future.release()
    except BaseException:
        client.cancel(futures)
        raise


_compared: dict[tuple[Any, ...], str] = {}
_comparing = threading.Lock()


def _task(region: Region, work: Request | Store, first: Probe | None) -> tuple[Columns | None, list[str]]:
    request, digits = work.request if isinstance(work, Store) else work, ""
    with in_this_thread():
        if first is not None:
            with _comparing:  # once per process
                key = request.digest, first.origin, *(hash(values.tobytes()) for values in first.columns.values())
                if key not in _compared:
                    _compared[key] = first.compare(request)
                digits = _compared[key]
        if isinstance(work, Request):
            return evaluate(request, region), [digits]
        there, damage = work.read(region)
        if there is None:
            work.write(region, evaluate(request, region))
        return None, [digits, damage]
