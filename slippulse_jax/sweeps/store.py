"""A sweep as a Zarr group: one array per output, the swept parameters as coordinates, the request in the attributes.

Nothing but Zarr and xarray is needed to read it. A killed writer leaves whole chunks only, because Zarr's local store renames
whole files and object stores take whole objects. The attributes of the group are written after all else when a store is made,
and the last output of the request after the others of a chunk: so a group with attributes is a store, and a chunk whose last
output is there is finished.
"""

import functools
import json
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
from slippulse_jax.shown import plain, shortened
from slippulse_jax.sweeps.dataset import computed_by, labelled
from slippulse_jax.sweeps.outputs import OUTPUTS
from slippulse_jax.sweeps.request import PARAMETERS, Columns, Region, Request, chunk_shape, regions

FORMAT, MANIFEST, COORDINATE_CHUNK = 2, "zarr.json", 1 << 20


class StoreError(ValueError):
    """A store that cannot be used: it belongs to another request, is damaged, or does not exist."""


def _locate(url: str) -> tuple[Any, str, Any]:
    """File system, path and Zarr's view of a folder, or of an address such as ``s3://bucket/scan.zarr``."""
    try:
        files, root = fsspec.url_to_fs(url, use_listings_cache=False)  # others write there too
        return files, root, LocalStore(root) if isinstance(files, LocalFileSystem) else FsspecStore.from_url(url)
    except (ValueError, ImportError) as error:  # no such protocol, or its package is not installed
        raise StoreError(f"{url}: {error}") from None


class Store:
    """A stored sweep, finished or not, with at most `chunk` points in each chunk; `about` are its attributes."""

    def __init__(self, url: str, request: Request, chunk: int, about: dict[str, Any]) -> None:
        self.url, self.request, self.chunk, self.about = url, request, chunk, about
        self.files, self.root, self.zarr = _locate(url)
        self.chunk_shape = chunk_shape(request.shape, chunk)

    @property
    def regions(self) -> list[Region]:
        """The part of the result that each chunk holds."""
        return regions(self.request.shape, self.chunk)

    def _paths(self, region: Region) -> list[str]:
        """Path of a chunk for each output."""
        index = [str(part.start // step) for part, step in zip(region, self.chunk_shape, strict=True)]
        return ["/".join((self.root, name, "c", *index)) for name in self.request.outputs]

    @functools.cached_property
    def _arrays(self) -> dict[str, Any]:
        found: dict[str, Any] = {name: zarr.open_array(self.zarr, path=name, mode="r+") for name in self.request.outputs}
        config: Any = {"write_empty_chunks": True}  # a chunk of NaN is a result too
        return {name: zarr.Array(zarr.AsyncArray(one.metadata, one.store_path, config)) for name, one in found.items()}

    def is_missing(self, region: Region) -> tuple[bool, str]:
        """Whether a chunk must be computed, and what is wrong with it if it is damaged. Reads it to find out."""
        paths = self._paths(region)
        if not self.files.exists(paths[-1]):
            return True, ""
        for path, array in zip(paths, self._arrays.values(), strict=True):
            damage = "" if self.files.exists(path) else "it is missing"
            try:
                array[region]
            except OSError:
                raise
            except Exception as error:  # each codec raises its own errors on damaged bytes
                damage = shortened(str(error))
            if damage:
                return True, f"{self.url}: damaged chunk {path.removeprefix(f'{self.root}/')} ({damage}): computing it again"
        return False, ""

    def write(self, region: Region, columns: Columns) -> None:
        """Write one chunk of all outputs."""
        try:
            self.files.info(f"{self.root}/{MANIFEST}")  # Zarr would recreate a folder that was removed
            for name, array in self._arrays.items():
                array[region] = columns[name]
        except FileNotFoundError:
            raise StoreError(f"{self.url}: the store was removed while the sweep ran") from None

    def dataset(self) -> xr.Dataset:
        """The sweep as a dataset, read on demand; its attribute ``complete`` is 1 once every chunk is there."""
        with _damage_named(self.url):
            found = xr.open_zarr(self.zarr, chunks=None, consolidated=True)
            found = found[[*self.request.parameters, *self.request.outputs]]
        for output in found.data_vars.values():
            if "flag_values" in output.attrs:
                output.attrs["flag_values"] = np.array(output.attrs["flag_values"], output.dtype)
        last = set(self.files.find(f"{self.root}/{self.request.outputs[-1]}/c"))
        complete = all(self._paths(region)[-1] in last for region in self.regions)
        return found.assign_attrs(complete=int(complete), store=self.url)

    def begun_elsewhere(self) -> str:
        """Name the processor and versions that began the store and those of this process, in no words if they are the same."""
        began, here = computed_by(self.about), computed_by()
        return "" if began == here else f"{self.url}: begun on {began}, and resumed on {here}; the last digits may differ"


def is_store(url: str) -> bool:
    """Whether there is a Zarr group; raise a `StoreError` if there is a store of version 0.1."""
    files, root, _ = _locate(url)
    if files.exists(f"{root}/manifest.json"):
        raise StoreError(f"{url}: a store of slippulse_jax 0.1 (.npz files), which only that version reads")
    return files.exists(f"{root}/{MANIFEST}")


def create(url: str, request: Request, chunk: int, processor: str) -> None:
    """Create a store in an empty place, unless another process has just created it."""
    files, root, _ = _locate(url)
    documents = _documents(request, chunk, processor)
    try:
        if files.isfile(root):
            raise StoreError(f"{url}: is a file; a store is a folder")
        ours = {key.split("/")[0] for key in documents}  # a process killed while creating the store left some of them
        there = files.ls(root, detail=False) if files.exists(root) else []
        names = {path.rstrip("/").rsplit("/", 1)[-1] for path in there}
        others = any(name not in ours and not name.startswith(".") for name in names)
        if (others or any(files.exists(f"{root}/{name}/c") for name in request.outputs)) and not is_store(url):
            raise StoreError(f"{url}: is a folder with other things in it; give a new or empty one")
        for key in [*(documents.keys() - {MANIFEST}), MANIFEST]:
            if isinstance(files, LocalFileSystem):
                Path(root, key).parent.mkdir(parents=True, exist_ok=True)
                write_atomically(Path(root, key), documents[key])
            else:
                files.pipe_file(f"{root}/{key}", documents[key])
    except OSError as error:
        raise StoreError(f"{url}: no store can be made there ({error.strerror or error})") from None


def _documents(request: Request, chunk: int, processor: str) -> dict[str, bytes]:
    """Content of a store before anything is computed, by key."""
    unknown = {name: _unknown(OUTPUTS[name].dtype) for name in request.outputs}
    empty = {name: np.broadcast_to(value, request.shape) for name, value in unknown.items()}
    template = labelled(request, empty, processor=processor, chunk=chunk, store_format=FORMAT)
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


def open_store(url: str) -> Store:
    """Open a stored sweep; raise a `StoreError` if there is none."""
    if not is_store(url):
        raise StoreError(f"{url}: not the store of a sweep ({MANIFEST} is missing)")
    with _damage_named(url):
        group: Any = zarr.open_group(_locate(url)[2], mode="r")
        about: dict[str, Any] = group.attrs.asdict()
        if (written := about.get("store_format")) == FORMAT:
            described = json.loads(about["request"])
            options = {name: described.pop(name) for name in ("parameters", "combined", "outputs")}
            parameters = {name: np.asarray(group[name][...]) for name in PARAMETERS if name in options["parameters"]}
            request = Request(parameters, options["combined"] == "product", tuple(options["outputs"]), **described)
            chunks = chunk_shape(request.shape, about["chunk"])
            arrays = [(group[name], OUTPUTS[name].dtype) for name in request.outputs]
            held = all((one.shape, one.chunks, one.dtype) == (request.shape, chunks, dtype) for one, dtype in arrays)
            if held and request.digest == about["request_sha256"] and "processor" in about:
                return Store(url, request, about["chunk"], about)
    if written != FORMAT:
        raise StoreError(f"{url}: not a sweep, or one of format {written}; this version reads format {FORMAT}")
    raise StoreError(f"{url}: request and arrays do not agree: the store was tampered with or is damaged")


@contextmanager
def _damage_named(url: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # each codec raises its own errors on damaged bytes
        what = shortened(f"{type(error).__name__}: {error}")
        raise StoreError(f"{url}: the store of a sweep with a damaged manifest or axes ({what})") from None


def check_same(store: Store, request: Request, chunk: int | None) -> None:
    """Check that request and chunks of the store are the same; raise a `StoreError` naming what differs."""
    if store.request.digest != request.digest:
        (old, was), (new, now) = _parts(store.request), _parts(request)
        changed = (name for name in was | now if was.get(name) != now.get(name))
        differs = "; ".join(f"{name}: {old.get(name, 'not given')}, now {new.get(name, 'not given')}" for name in changed)
        raise StoreError(f"{store.url}: holds another sweep ({differs}); give it a store of its own")
    if chunk is not None and chunk != store.chunk:
        raise StoreError(f"{store.url}: has {store.chunk} points per chunk, not {chunk}; leave chunk out to resume it")


def _parts(request: Request) -> tuple[dict[str, str], dict[str, Any]]:
    """Parts of a request by name: in words, and by what they are compared."""
    described = request.describe()
    axes = described.pop("parameters")
    words = {name: repr(value) for name, value in described.items()} | {
        name: f"{values.size} values {values[0]:g} … {values[-1]:g}" if values.ndim else f"{values:g}"
        for name, values in request.parameters.items()
    }
    return words, described | axes
