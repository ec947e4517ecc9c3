"""A sweep as a Zarr group: one array per output, the swept parameters as coordinates, the request in the attributes.

Nothing but Zarr and xarray is needed to read it. A killed writer leaves whole chunks only, because Zarr's local store renames
whole files and object stores take whole objects. The attributes of the group are written after all else when a store is made,
and the last output of the request after the others of a chunk: so a group with attributes is a store, and a chunk whose last
output is there is finished.
"""

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import xarray as xr
import zarr
from fsspec.implementations.local import LocalFileSystem
from zarr.codecs import BytesCodec, Crc32cCodec
from zarr.storage import FsspecStore, LocalStore, MemoryStore

from slippulse_jax.files import plain, shortened, write_atomically
from slippulse_jax.sweeps.dataset import computed_by, labelled
from slippulse_jax.sweeps.outputs import OUTPUTS
from slippulse_jax.sweeps.request import Columns, Region, Request, chunk_shape, labelled_axes, regions

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
        there = {path.rstrip("/").rsplit("/", 1)[-1] for path in files.ls(root, detail=False)} if files.exists(root) else set()
        # a process killed while creating the store left some of ours
        others = {name for name in there if not name.startswith(".")} - {key.split("/")[0] for key in documents}
        if (others or any(files.exists(f"{root}/{name}/c") for name in request.outputs)) and not is_store(url):
            left = any(files.exists(f"{root}/{name}/{MANIFEST}") for name in there)
            other = f"what is left of a store whose {MANIFEST} is missing" if left else "a folder with other things in it"
            what = "a file" if files.isfile(root) else other
            raise StoreError(f"{url}: is {what}; give a new or empty folder")
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
    empty = {name: np.broadcast_to(np.zeros((), OUTPUTS[name].dtype), request.shape) for name in request.outputs}
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
            fill_value=np.nan if variable.dtype.kind == "f" else -1,  # of points that have not been computed
            filters=None,
            serializer=BytesCodec(endian="little"),
            compressors=[Crc32cCodec()],
            dimension_names=[str(dim) for dim in variable.dims],
            attributes=plain(variable.attrs) | ({"coordinates": " ".join(map(str, request.axes.coords))} if is_output else {}),
        )
        if not is_output:
            array[...] = variable.values
    with warnings.catch_warnings():  # other implementations of Zarr read the metadata of each array instead
        warnings.filterwarnings("ignore", "Consolidated metadata")
        zarr.consolidate_metadata(MemoryStore(made))
    return {key: content.to_bytes() for key, content in made.items()}


def open_store(url: str) -> tuple[xr.Dataset, Request]:
    """Open a stored sweep, finished or not, to be read on demand; raise a `StoreError` if there is none."""
    if not is_store(url):
        raise StoreError(f"{url}: not the store of a sweep ({MANIFEST} is missing)")
    files, root, content = _locate(url)
    try:
        about = json.loads(files.cat_file(f"{root}/{MANIFEST}")).get("attributes", {})
        if (written := about.get("store_format")) == FORMAT:
            found = xr.open_zarr(content, chunks=None, consolidated=True)
            request = _request_of(found)
            outputs = [(found[name], OUTPUTS[name].dtype) for name in request.outputs]
            form = request.shape, chunk_shape(request.shape, about["chunk"])
            held = all((one.shape, one.encoding["chunks"], one.dtype) == (*form, dtype) for one, dtype in outputs)
            held = held and json.loads(about["request"]) == request.describe()
            for one, dtype in outputs:
                if "flag_values" in one.attrs:
                    one.attrs["flag_values"] = np.array(one.attrs["flag_values"], dtype)
            if held and request.digest == about["request_sha256"] and "processor" in about:
                return found[[*request.axes.coords, *request.outputs]].assign_attrs(store=url), request
    except Exception as error:  # each codec raises its own errors on damaged bytes
        what = shortened(f"{type(error).__name__}: {error}")
        raise StoreError(f"{url}: the store of a sweep with a damaged manifest or axes ({what})") from None
    if written != FORMAT:
        raise StoreError(f"{url}: not a sweep, or one of format {written}; this version reads format {FORMAT}")
    raise StoreError(f"{url}: request and arrays do not agree: the store was tampered with or is damaged")


def _request_of(found: xr.Dataset) -> Request:
    """Request of a stored sweep, from its attributes and its axes."""
    described = json.loads(found.attrs["request"])
    values = {name: found[name].values for name in described.pop("parameters")}
    axes = labelled_axes(values, points=described.pop("combined") != "product")
    return Request(axes, tuple(described.pop("outputs")), **described)


def check_same(stored: xr.Dataset, old: Request, new: Request, chunk: int | None) -> None:
    """Check that the store holds the request, in these chunks; raise a `StoreError` naming what differs."""
    url, held = stored.attrs["store"], stored.attrs["chunk"]
    if old.digest != new.digest:
        was, now, absent = _parts(old), _parts(new), (None, "not given")
        pairs = {name: (was.get(name, absent), now.get(name, absent)) for name in was | now}
        differs = "; ".join(f"{name}: {a[1]}, now {b[1]}" for name, (a, b) in pairs.items() if a != b)
        raise StoreError(f"{url}: holds another sweep ({differs}); give it a store of its own")
    if chunk is not None and chunk != held:
        raise StoreError(f"{url}: has {held} points per chunk, not {chunk}; leave chunk out to resume it")


def _parts(request: Request) -> dict[str, tuple[Any, str]]:
    """Parts of a request by name: by what they are compared, and in words."""
    described = request.describe()
    axes = described.pop("parameters")
    words = {
        name: f"{one.size} values {one.values[0]:g} … {one.values[-1]:g}" if one.ndim else f"{one.values:g}"
        for name, one in request.axes.variables.items()
    }
    return {name: (value, words.get(name, repr(value))) for name, value in (described | axes).items()}


def _key(name: str, region: Region, steps: tuple[int, ...]) -> str:
    """Place in the store of a chunk of one output."""
    return "/".join((name, "c", *(str(part.start // step) for part, step in zip(region, steps, strict=True))))


def is_complete(stored: xr.Dataset, request: Request) -> bool:
    """Whether every chunk is there."""
    files, root, _ = _locate(stored.attrs["store"])
    last, chunk = request.outputs[-1], stored.attrs["chunk"]
    there, steps = set(files.find(f"{root}/{last}/c")), chunk_shape(request.shape, chunk)
    return all(f"{root}/{_key(last, region, steps)}" in there for region in regions(request.shape, chunk))


def open_arrays(url: str, request: Request) -> dict[str, zarr.Array]:
    """Arrays of the outputs, for `fill`."""
    group: Any = zarr.open_group(_locate(url)[2], mode="r+", use_consolidated=True)
    config: Any = {"write_empty_chunks": True}  # a chunk of NaN is a result too
    found = [(name, group[name]) for name in request.outputs]
    return {name: zarr.Array(zarr.AsyncArray(one.metadata, one.store_path, config)) for name, one in found}


def fill(about: dict[str, Any], arrays: dict[str, zarr.Array], region: Region, compute: Callable[[], Columns]) -> set[str]:
    """Compute and write a chunk, unless it is there and intact; return what to warn of. `about` are the store's attributes."""
    url = about["store"]
    files, root, _ = _locate(url)
    keys = [_key(name, region, array.chunks) for name, array in arrays.items()]
    remarks = set()
    if files.exists(f"{root}/{keys[-1]}"):
        damage = (_damage(files, root, key, array, region) for key, array in zip(keys, arrays.values(), strict=True))
        if not (first := next(filter(None, damage), "")):
            return set()
        remarks.add(f"{url}: damaged chunk {first}: computing it again")
    columns = compute()
    try:
        files.info(f"{root}/{MANIFEST}")  # Zarr would recreate a folder that was removed
        for name, array in arrays.items():
            array[region] = columns[name]
    except FileNotFoundError:
        raise StoreError(f"{url}: the store was removed while the sweep ran") from None
    if (began := computed_by(about)) != (here := computed_by()):
        remarks.add(f"{url}: begun on {began}, and resumed on {here}; the last digits may differ")
    return remarks


def _damage(files: Any, root: str, key: str, array: zarr.Array, region: Region) -> str:
    """Name a damaged chunk, and what is wrong with it. Reads it to find out."""
    if not files.exists(f"{root}/{key}"):
        return f"{key} (it is missing)"
    try:
        array[region]
    except OSError:
        raise
    except Exception as error:  # each codec raises its own errors on damaged bytes
        return f"{key} ({shortened(str(error))})"
    return ""
