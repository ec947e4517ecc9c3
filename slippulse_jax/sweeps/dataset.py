"""The labelled dataset of a sweep, in memory or read on demand.

A variable of a stored sweep uses xarray's own lazy indexing: values are read when they are needed, and only from the chunk
files that hold them. dask is not needed; with it, ``.chunk()`` works as on any dataset.
"""

import functools
import json
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from slippulse_jax.sweeps.outputs import OUTPUTS
from slippulse_jax.sweeps.request import PARAMETERS, Columns, Request
from slippulse_jax.sweeps.store import Store, StoreError, current_versions

OPEN_CHUNKS = 8
"""Chunk files kept in memory while a dataset is read."""

_PIECE = 1 << 20
"""Points read at a time."""


class StoredColumn(BackendArray):
    """One output of a stored sweep, read on demand; points not yet computed are NaN, in whole numbers −1."""

    def __init__(self, store: Store, name: str) -> None:
        self.store, self.name = store, name
        self.shape, self.dtype = store.request.shape, np.dtype(OUTPUTS[name].dtype)
        self._chunk = functools.lru_cache(OPEN_CHUNKS)(self._read)

    def __getstate__(self) -> dict[str, Any]:
        return {"store": self.store, "name": self.name}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._outer)

    def _read(self, index: int) -> np.ndarray:
        try:
            return self.store.read(index)[self.name]
        except FileNotFoundError:
            start, stop = self.store.span(index)
            return np.full(stop - start, unknown(self.dtype), self.dtype)

    def _outer(self, key: tuple[Any, ...]) -> np.ndarray:
        """Values at every combination of the indices, one index, slice or array per axis."""
        if not self.shape:  # a single point has no axis
            return self._look_up(np.zeros(1, np.int64)).reshape(())
        taken = [np.atleast_1d(np.arange(n)[k]) for n, k in zip(self.shape, key, strict=True)]
        strides = np.cumprod((1, *self.shape[:0:-1]))[::-1]
        result = np.empty([len(t) for t in taken], self.dtype)
        rest = functools.reduce(
            lambda whole, axis: (whole[:, None] + axis).ravel(),
            [t * s for t, s in zip(taken[1:], strides[1:], strict=True)],
            np.zeros(1, np.int64),
        )
        rows = max(1, _PIECE // max(rest.size, 1))
        flat = result.reshape(len(taken[0]), rest.size)
        for row in range(0, len(taken[0]), rows):
            points = taken[0][row : row + rows, None] * strides[0] + rest
            flat[row : row + rows] = self._look_up(points.ravel()).reshape(points.shape)
        fixed = tuple(0 if isinstance(k, int | np.integer) else slice(None) for k in key)
        return result[fixed]

    def _look_up(self, points: np.ndarray) -> np.ndarray:
        result = np.empty(points.size, self.dtype)
        chunk, within = np.divmod(points, self.store.chunk)
        order = np.argsort(chunk, kind="stable")
        first = np.flatnonzero(np.diff(chunk[order], prepend=-1))
        for at, end in zip(first, [*first[1:], points.size][: len(first)], strict=True):
            here = order[at:end]
            result[here] = self._chunk(int(chunk[here[0]]))[within[here]]
        return result


def unknown(dtype: np.dtype) -> Any:
    """Value of a point that has not been computed."""
    return np.nan if dtype.kind == "f" else -1


def in_memory(request: Request, columns: Columns) -> xr.Dataset:
    """Dataset of a sweep in memory."""
    data = {name: columns[name].reshape(request.shape) for name in request.outputs}
    return _dataset(request, data, {**current_versions(), "complete": True})


def stored(store: Store) -> xr.Dataset:
    """Dataset of a stored sweep, read on demand; its attribute ``complete`` is 1 once every chunk is there."""
    if store.request.size == 0:
        raise StoreError(f"{store.path}: no points")
    data = {name: indexing.LazilyIndexedArray(StoredColumn(store, name)) for name in store.request.outputs}
    complete = len(store.present()) == store.chunks
    return _dataset(store.request, data, {**store.versions, "complete": complete, "store": str(store.path)})


def _dataset(request: Request, data: dict[str, Any], about: dict[str, Any]) -> xr.Dataset:
    coords = {
        name: xr.Variable(() if not values.ndim else (name if request.product else "point"), values, _parameter(name))
        for name, values in request.parameters.items()
    }
    variables = {name: xr.Variable(request.dims, values, _output(name)) for name, values in data.items()}
    found = xr.Dataset(variables, coords)
    found.attrs = {
        "title": "first precursor to sliding, slippulse_jax sweep",
        "source": "Braun & Scheibert, Tribology Letters (2014): the lattice model, and theory where an output says so",
        "request": json.dumps(request.describe()),
        "request_sha256": request.digest,
        **{key: int(value) if isinstance(value, bool) else value for key, value in about.items()},
    }
    return found


def _parameter(name: str) -> dict[str, Any]:
    symbol, unit, label, long_name = PARAMETERS[name]
    about = {"long_name": long_name, "units": unit, "symbol": symbol}
    return about | ({"equation": label} if label else {})


def _output(name: str) -> dict[str, Any]:
    output = OUTPUTS[name]
    about: dict[str, Any] = {"long_name": output.long_name, "units": output.unit}
    if output.comment:
        about["comment"] = output.comment
    if output.outcomes:
        about["flag_values"] = np.array([one.value for one in output.outcomes], output.dtype)
        about["flag_meanings"] = " ".join(one.name.lower() for one in output.outcomes)
        about["comment"] = "; ".join(f"{one.value}: {one.message}" for one in output.outcomes)
    return about
