"""A sweep as a Zarr group: one array per output, the swept parameters as coordinates, the request in the attributes.

Nothing but Zarr and xarray is needed to read it. A killed writer leaves whole chunks only, because Zarr's local store renames
whole files and object stores take whole objects. The attributes of the group are written after all else when a store is made,
and the last output of the request after the others of a chunk: so a group with attributes is a store, and a chunk whose last
output is there is finished. Every process writes the same bytes for a chunk.
"""

import functools
import json
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import xarray as xr
import zarr
from fsspec.implementations.local import LocalFileSystem
from zarr.codecs import BytesCodec, Crc32cCodec
from zarr.storage import FsspecStore, LocalStore, MemoryStore

from slippulse_jax.files import write_atomically
from slippulse_jax.plain import plain, shortened
from slippulse_jax.sweeps.dataset import labelled
from slippulse_jax.sweeps.outputs import OUTPUTS
from slippulse_jax.sweeps.request import PARAMETERS, Columns, Region, Request, chunk_shape, regions

FORMAT, MANIFEST, COORDINATE_CHUNK = 2, "zarr.json", 1 << 20


class StoreError(ValueError):
    """A store that cannot be used: it belongs to another request, is damaged, or does not exist."""


class Place:
    """A folder, or the address of one that fsspec knows, such as ``s3://bucket/scan.zarr``."""

    def __init__(self, url: str | os.PathLike[str]) -> None:
        self.url = os.fspath(url)
        try:
            self.files, self.root = fsspec.url_to_fs(self.url, use_listings_cache=False)  # others write there too
            self.is_local = isinstance(self.files, LocalFileSystem)
            self.zarr = LocalStore(self.root) if self.is_local else FsspecStore.from_url(self.url)
        except (ValueError, ImportError) as error:  # no such protocol, or its package is not installed
            raise StoreError(f"{self.url}: {error}") from None

    def __contains__(self, key: str) -> bool:
        return self.files.exists(f"{self.root}/{key}")

    @property
    def is_store(self) -> bool:
        """Whether there is a Zarr group; an error if there is a store of version 0.1."""
        if "manifest.json" in self:
            raise StoreError(f"{self.url}: a store of slippulse_jax 0.1 (.npz files), which only that version reads")
        return MANIFEST in self


class Store:
    """The stored sweep at a place, finished or not, with at most `chunk` points in each chunk; `about` are its attributes."""

    def __init__(self, place: Place, request: Request, chunk: int, about: dict[str, Any]) -> None:
        self.place, self.request, self.chunk, self.about = place, request, chunk, about
        self.url, self.chunk_shape = place.url, chunk_shape(request.shape, chunk)

    @property
    def regions(self) -> list[Region]:
        """The part of the result that each chunk holds."""
        return regions(self.request.shape, self.chunk)

    def key(self, region: Region, name: str) -> str:
        """Key of a chunk of one output: its place in the store."""
        index = (part.start // step for part, step in zip(region, self.chunk_shape, strict=True))
        return "/".join((name, "c", *map(str, index)))

    def present(self) -> list[Region]:
        """Keys of the finished chunks, without reading them."""
        last = self.request.outputs[-1]
        there = {path.removeprefix(f"{self.place.root}/") for path in self.place.files.find(f"{self.place.root}/{last}/c")}
        return [region for region in self.regions if self.key(region, last) in there]

    def read(self, region: Region) -> tuple[Columns | None, str]:
        """Values of a chunk of all outputs if present and intact, and a description of the damage if not intact."""
        keys = {name: self.key(region, name) for name in self.request.outputs}
        if keys[self.request.outputs[-1]] not in self.place:
            return None, ""
        columns: Columns = {}
        for name, key in keys.items():
            try:
                columns[name] = np.asarray(self._arrays[name][region])
                damage = "" if key in self.place else "it is missing"
            except OSError:
                raise
            except Exception as error:  # each codec raises its own errors on damaged bytes
                damage = shortened(str(error))
            if damage:
                return None, f"{self.url}: damaged chunk {key} ({damage}): computing it again"
        return columns, ""

    def write(self, region: Region, columns: Columns) -> None:
        """Write one chunk of all outputs."""
        try:
            self.place.files.info(f"{self.place.root}/{MANIFEST}")  # Zarr would recreate a folder that was removed
            for name in self.request.outputs:
                self._arrays[name][region] = columns[name]
        except FileNotFoundError:
            raise StoreError(f"{self.url}: the store was removed while the sweep ran") from None

    @functools.cached_property
    def _arrays(self) -> dict[str, Any]:
        group: Any = zarr.open_group(self.place.zarr, mode="r+")
        found = ((name, group[name]) for name in self.request.outputs)
        config: Any = {"write_empty_chunks": True}  # a chunk of NaN is a result too
        return {name: zarr.Array(zarr.AsyncArray(one.metadata, one.store_path, config)) for name, one in found}

    def dataset(self) -> xr.Dataset:
        """The sweep as a dataset, read on demand; its attribute ``complete`` is 1 once every chunk is there."""
        with _damage_named(self.place):
            found = xr.open_zarr(self.place.zarr, chunks=None, consolidated=True)
            found = found[[*self.request.parameters, *self.request.outputs]]
        for output in found.data_vars.values():
            if "flag_values" in output.attrs:
                output.attrs["flag_values"] = np.array(output.attrs["flag_values"], output.dtype)
        found.attrs |= {"complete": int(len(self.present()) == len(self.regions)), "store": self.url}
        return found


def create(place: Place, request: Request, chunk: int, computed_on: str) -> None:
    """Create a store in an empty place, unless another process has just created it."""
    documents = _documents(request, chunk, computed_on)
    try:
        if place.files.isfile(place.root):
            raise StoreError(f"{place.url}: is a file; a store is a folder")
        there = place.files.ls(place.root, detail=False) if place.files.exists(place.root) else []
        ours = {key.split("/")[0] for key in documents}  # a process killed while creating the store left some of them
        names = {path.rstrip("/").rsplit("/", 1)[-1] for path in there}
        others = any(name not in ours and not name.startswith(".") for name in names)
        if (others or any(f"{name}/c" in place for name in request.outputs)) and not place.is_store:
            raise StoreError(f"{place.url}: is a folder with other things in it; give a new or empty one")
        for key in sorted(documents, key=MANIFEST.__eq__):  # the manifest last
            path = f"{place.root}/{key}"
            if place.is_local:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                write_atomically(path, documents[key])
            else:
                place.files.pipe_file(path, documents[key])
    except OSError as error:
        raise StoreError(f"{place.url}: no store can be made there ({error.strerror or error})") from None


def _documents(request: Request, chunk: int, computed_on: str) -> dict[str, bytes]:
    """Content of a store before anything is computed, by key."""
    empty = {name: np.broadcast_to(_unknown(OUTPUTS[name].dtype), request.shape) for name in request.outputs}
    template = labelled(request, empty, processor=computed_on, chunk=chunk, store_format=FORMAT)
    made: dict[str, Any] = {}
    group = zarr.create_group(MemoryStore(made), zarr_format=3, attributes=template.attrs)
    for name, variable in template.variables.items():
        is_output = name in request.outputs
        array = group.create_array(
            str(name),
            shape=variable.shape,
            chunks=chunk_shape(variable.shape, chunk if is_output else COORDINATE_CHUNK),
            dtype=variable.dtype,
            fill_value=_unknown(variable.dtype).item(),
            filters=None,
            serializer=BytesCodec(endian="little"),
            compressors=[Crc32cCodec()],
            dimension_names=[str(dim) for dim in variable.dims],
            attributes=plain(variable.attrs) | ({"coordinates": " ".join(request.parameters)} if is_output else {}),
        )
        if not is_output:
            array[...] = variable.values
    with warnings.catch_warnings():  # other implementations of Zarr read the metadata of each array instead
        warnings.filterwarnings("ignore", "Consolidated metadata")
        zarr.consolidate_metadata(MemoryStore(made))
    return {key: content.to_bytes() for key, content in made.items()}


def _unknown(dtype: Any) -> np.ndarray:
    """Value of a point that has not been computed: NaN, in whole numbers −1."""
    return np.array(np.nan if np.dtype(dtype).kind == "f" else -1, dtype)


def open_store(place: Place) -> Store:
    """Open the stored sweep at a place; raise a `StoreError` if there is none."""
    if not place.is_store:
        raise StoreError(f"{place.url}: not the store of a sweep ({MANIFEST} is missing)")
    with _damage_named(place):
        group: Any = zarr.open_group(place.zarr, mode="r")
        about: dict[str, Any] = group.attrs.asdict()
        if (written := about.get("store_format")) == FORMAT:
            described = json.loads(about["request"])
            options = {name: described.pop(name) for name in ("parameters", "combined", "outputs")}
            parameters = {name: np.asarray(group[name][...]) for name in PARAMETERS if name in options["parameters"]}
            request = Request(parameters, options["combined"] == "product", tuple(options["outputs"]), **described)
            store = Store(place, request, about["chunk"], about)
            arrays = [(group[name], OUTPUTS[name].dtype) for name in request.outputs]
            held = all((one.shape, one.chunks, one.dtype) == (request.shape, store.chunk_shape, dtype) for one, dtype in arrays)
            if held and request.digest == about["request_sha256"] and "processor" in about:
                return store
    if written != FORMAT:
        raise StoreError(f"{place.url}: not a sweep, or one of format {written}; this version reads format {FORMAT}")
    raise StoreError(f"{place.url}: request and arrays do not agree: the store was tampered with or is damaged")


@contextmanager
def _damage_named(place: Place) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # each codec raises its own errors on damaged bytes
        what = shortened(f"{type(error).__name__}: {error}")
        raise StoreError(f"{place.url}: the store of a sweep with a damaged manifest or axes ({what})") from None


def check_same(store: Store, request: Request, chunk: int | None) -> None:
    """Check that request and chunks of the store are the same; raise a `StoreError` naming what differs."""
    if store.request.digest != request.digest:
        old, new = _briefly(store.request), _briefly(request)
        changed = (name for name in old | new if old.get(name) != new.get(name))
        differs = "; ".join(f"{name}: {old.get(name, NOT)[0]}, now {new.get(name, NOT)[0]}" for name in changed)
        raise StoreError(f"{store.url}: holds another sweep ({differs}); give it a store of its own")
    if chunk is not None and chunk != store.chunk:
        raise StoreError(f"{store.url}: has {store.chunk} points per chunk, not {chunk}; leave chunk out to resume it")


NOT = ("not given",)


def _briefly(request: Request) -> dict[str, tuple[Any, ...]]:
    """Parts of a request by name: the text of each for a message, then what it is compared by."""
    described = request.describe()
    axes = described.pop("parameters")
    brief = {
        name: f"{values.size} values {values[0]:g} … {values[-1]:g}" if values.ndim else f"{values:g}"
        for name, values in request.parameters.items()
    }
    return {name: (repr(value),) for name, value in described.items()} | {name: (brief[name], axes[name]) for name in brief}
