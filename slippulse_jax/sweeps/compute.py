"""Compute the chunks of a sweep, in this process or as tasks on a Dask cluster.

The values of a request are returned, those of a store are written to it. There, intact chunks are left alone, and damaged ones
are computed again; a description of the damage is returned.
"""

import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, NamedTuple

from slippulse_jax.bulk.threads import in_this_thread
from slippulse_jax.sweeps.dataset import processor
from slippulse_jax.sweeps.outputs import evaluate
from slippulse_jax.sweeps.request import Columns, Region, Request, chunk_shape, shape_of
from slippulse_jax.sweeps.store import Store, StoreError

if TYPE_CHECKING:
    from distributed import Client

PROBE, RETRIES = 1024, 2  # points computed again to compare their digits; retries of a failed Dask task


class Probe(NamedTuple):
    """First points of a chunk as computed before; another processor or build may round differently."""

    region: Region
    columns: Columns
    origin: str

    def check(self, request: Request) -> None:
        """Compute the points again and compare their digits."""
        for name, values in evaluate(request, self.region).items():
            if values.tobytes() != self.columns[name].tobytes():
                raise StoreError(f"computed on {processor()}, the first points of {name} have other digits than {self.origin}")


def _probe(region: Region, columns: Columns, origin: str) -> Probe:
    shape = chunk_shape(shape_of(region), PROBE)
    first = tuple(slice(whole.start, whole.start + n) for whole, n in zip(region, shape, strict=True))
    return Probe(first, {name: values[tuple(map(slice, shape))] for name, values in columns.items()}, origin)


def _stored_probe(store: Store) -> Probe | None:
    for region in store.present():
        columns, _ = store.read(region)
        if columns is not None:
            return _probe(region, columns, f"stored in {store.url}, computed on {store.about['processor']}")
    return None


def complete(store: Store, chunks: list[Region]) -> Iterator[tuple[Region, str]]:
    """Compute the missing chunks of a store in this process; one is written while the next is computed."""
    if (first := _stored_probe(store)) is not None:
        first.check(store.request)
    with ThreadPoolExecutor(1) as writer:
        writing: Future[None] | None = None
        for region in chunks:
            there, damage = store.read(region)
            columns = evaluate(store.request, region) if there is None else None
            if writing is not None:
                writing.result()
            writing = None if columns is None else writer.submit(store.write, region, columns)
            yield region, damage
        if writing is not None:
            writing.result()


def on_cluster(client: "Client", work: Request | Store, chunks: list[Region]) -> Iterator[tuple[Region, Any]]:
    """Compute chunks on the workers, each on one thread; every worker first reproduces the digits of the first chunk."""
    from distributed import as_completed

    first = _stored_probe(work) if isinstance(work, Store) else None
    if first is None and chunks:
        region, *chunks = chunks
        result = client.submit(_task, region, work, None, pure=False, retries=RETRIES).result()
        yield region, result
        first = _stored_probe(work) if isinstance(work, Store) else _probe(region, result, "those of the first worker")
    futures = client.map(_task, chunks, work=work, first=first, pure=False, retries=RETRIES)
    regions = {future.key: region for future, region in zip(futures, chunks, strict=True)}
    try:
        for future, result in as_completed(futures, with_results=True):
            yield regions[future.key], result
            future.release()
    except BaseException:
        client.cancel(futures)
        raise


_checked: set[str] = set()
_checking = threading.Lock()


def _task(region: Region, work: Request | Store, first: Probe | None) -> Any:
    request = work.request if isinstance(work, Store) else work
    with in_this_thread():
        with _checking:  # once per process
            if first is not None and request.digest not in _checked:
                first.check(request)
                _checked.add(request.digest)
        if isinstance(work, Request):
            return evaluate(request, region)
        there, damage = work.read(region)
        if there is None:
            work.write(region, evaluate(request, region))
        return damage
