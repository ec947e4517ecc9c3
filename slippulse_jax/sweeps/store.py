"""A sweep as a Zarr group.

One array per output, the swept parameters as coordinates, the request in the attributes: Zarr and xarray alone can read it.
A killed writer leaves whole chunks only, because Zarr's local store renames whole files and object stores take whole objects.
The attributes of the group are written last when a store is made, and the last output of the request after the others of a
chunk: so a group with attributes is a store, and a chunk whose last output is there is finished. Zarr's arrays are written
directly: xarray's ``to_zarr(region=…)`` opens the store for each chunk, and takes two to nine times as long.
"""

import json
import warnings
from collections.abc import Callable
from typing import Any

import fsspec
import numpy as np
import xarray as xr
import zarr
from fsspec.implementations.dirfs import DirFileSystem
from fsspec.implementations.local import LocalFileSystem
from zarr.codecs import BytesCodec, Crc32cCodec
from zarr.storage import FsspecStore, LocalStore, MemoryStore

from slippulse_jax.base.files import plain, shortened, write_atomically
from slippulse_jax.front.arrest import MOST_BREAKS
from slippulse_jax.sweeps.dataset import about_output, computed_by, labelled
from slippulse_jax.sweeps.outputs import OUTPUTS
from slippulse_jax.sweeps.request import Columns, Region, Request, chunk_shape, labelled_axes, regions

FORMAT, MANIFEST, COORDINATE_CHUNK = 2, "zarr.json", 1 << 20


class StoreError(ValueError):
    """A store of another request, a damaged one, or none."""


def _locate(url: str) -> tuple[DirFileSystem, LocalStore | FsspecStore]:
    """Files by key, and Zarr's view, of a folder or of ``s3://bucket/scan.zarr``."""
    try:
        files, root = fsspec.url_to_fs(url, use_listings_cache=False)  # others write there too
        content = LocalStore(root) if isinstance(files, LocalFileSystem) else FsspecStore.from_url(url)
        return DirFileSystem(root, files), content
    except (ValueError, ImportError) as error:  # no such protocol, or its package is not installed
        raise StoreError(f"{url}: {error}") from None


def is_store(url: str) -> bool:
    """Whether there is a Zarr group; refuse a store of version 0.1."""
    files, _ = _locate(url)
    if files.exists("manifest.json"):
        raise StoreError(f"{url}: a store of slippulse_jax 0.1 (.npz files), which only that version reads")
    return files.exists(MANIFEST)


def create(url: str, request: Request, chunk: int, processor: str) -> None:
    """Create a store in an empty place, unless another process did."""
    files, content = _locate(url)
    documents = _documents(request, chunk, processor)
    try:
        there = {str(path).rsplit("/", 1)[-1] for path in files.ls("", detail=False)} if files.exists("") else set()
        # a process killed while creating the store left some of ours
        others = {name for name in there if not name.startswith(".")} - {key.split("/")[0] for key in documents}
        others |= {name for name in request.outputs if files.exists(f"{name}/c")}
        if is_store(url):
            return
        if others:
            left = any(files.exists(f"{name}/{MANIFEST}") for name in there)
            other = f"what is left of a store whose {MANIFEST} is missing" if left else "a folder with other things in it"
            raise StoreError(f"{url}: is {'a file' if files.isfile('') else other}; give a new or empty folder")
        for key, document in documents.items():
            if isinstance(content, LocalStore):
                (content.root / key).parent.mkdir(parents=True, exist_ok=True)
                write_atomically(content.root / key, document)
            else:
                files.pipe_file(key, document)
    except OSError as error:
        raise StoreError(f"{url}: no store can be made there ({error.strerror or error})") from None


def _documents(request: Request, chunk: int, processor: str) -> dict[str, bytes]:
    """Content of a store without values, by key, the manifest last."""
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
    made[MANIFEST] = made.pop(MANIFEST)
    return {key: content.to_bytes() for key, content in made.items()}


def open_store(url: str) -> tuple[xr.Dataset, Request]:
    """Open a stored sweep, finished or not, to be read on demand."""
    if not is_store(url):
        raise StoreError(f"{url}: not the store of a sweep ({MANIFEST} is missing)")
    files, content = _locate(url)
    try:
        about = json.loads(files.cat_file(MANIFEST)).get("attributes", {})
        if (written := about.get("store_format")) != FORMAT:
            raise StoreError(f"{url}: not a sweep, or one of format {written}; this version reads format {FORMAT}")
        found = xr.open_zarr(content, chunks=None, consolidated=True)
        request = _request_of(found)
        agree = json.loads(about["request"]) == request.describe() and about["request_sha256"] == request.digest
        form = request.shape, chunk_shape(request.shape, about["chunk"])
        for name in request.outputs:
            one = found[name]
            agree = agree and (one.shape, one.encoding["chunks"], one.dtype) == (*form, OUTPUTS[name].dtype)
            one.attrs = about_output(name)  # in which flags are numbers of its own type
        if not agree or "processor" not in about:
            raise StoreError(f"{url}: request and arrays do not agree: the store was tampered with or is damaged")
        return found[[*request.axes.coords, *request.outputs]].assign_attrs(store=url), request
    except StoreError:
        raise
    except Exception as error:  # each codec raises its own errors on damaged bytes
        what = shortened(f"{type(error).__name__}: {error}")
        raise StoreError(f"{url}: the store of a sweep with a damaged manifest or axes ({what})") from None


def _request_of(found: xr.Dataset) -> Request:
    """Request of a stored sweep, from its attributes and its axes."""
    described = json.loads(found.attrs["request"])
    values = {name: found[name].values for name in described.pop("parameters")}
    axes = labelled_axes(values, points=described.pop("combined") != "product")
    if (most := described.pop("max_contacts")) != MOST_BREAKS:
        raise ValueError(f"max_contacts = {most}: fronts are given up after {MOST_BREAKS} breaks")
    return Request(axes, tuple(described.pop("outputs")), **described)


def check_same(stored: xr.Dataset, old: Request, new: Request, chunk: int | None) -> None:
    """Check that the store holds the request, in these chunks."""
    url, held = stored.attrs["store"], stored.attrs["chunk"]
    if old.digest != new.digest:
        was, now, absent = _parts(old), _parts(new), (None, "not given")
        pairs = {name: (was.get(name, absent), now.get(name, absent)) for name in was | now}
        differs = "; ".join(f"{name}: {a[1]}, now {b[1]}" for name, (a, b) in pairs.items() if a != b)
        raise StoreError(f"{url}: holds another sweep ({differs}); give it a store of its own")
    if chunk is not None and chunk != held:
        raise StoreError(f"{url}: has {held} points per chunk, not {chunk}; leave chunk out to resume it")


def _parts(request: Request) -> dict[str, tuple[Any, str]]:
    """Parts of a request by name: value to compare, and words."""
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
    last, chunk = request.outputs[-1], stored.attrs["chunk"]
    keys = {_key(last, region, chunk_shape(request.shape, chunk)) for region in regions(request.shape, chunk)}
    # array.nchunks_initialized searches the listing once per chunk: minutes for 10⁵ of them
    return keys <= set(_locate(stored.attrs["store"])[0].find(f"{last}/c"))


def open_arrays(url: str, request: Request) -> dict[str, zarr.Array]:
    """Arrays of the outputs, for `fill`."""
    with zarr.config.set({"array.write_empty_chunks": True}):  # a chunk of NaN is a result too
        group: Any = zarr.open_group(_locate(url)[1], mode="r+", use_consolidated=True)
        return {name: group[name] for name in request.outputs}


def fill(about: dict[str, Any], arrays: dict[str, zarr.Array], region: Region, compute: Callable[[], Columns]) -> set[str]:
    """Compute and write a chunk, unless it is there and intact.

    `about` are the attributes of the store. Return what to warn of.
    """
    url = about["store"]
    files, _ = _locate(url)
    keys = [_key(name, region, array.chunks) for name, array in arrays.items()]
    remarks = set()
    if files.exists(keys[-1]):
        damage = {key: _damage(files, key, array, region) for key, array in zip(keys, arrays.values(), strict=True)}
        if not (first := next((f"{key} ({what})" for key, what in damage.items() if what), "")):
            return set()
        remarks.add(f"{url}: damaged chunk {first}: computing it again")
    columns = compute()
    try:
        files.info(MANIFEST)  # Zarr would recreate a folder that was removed
        for name, array in arrays.items():
            array[region] = columns[name]
    except FileNotFoundError:
        raise StoreError(f"{url}: the store was removed while the sweep ran") from None
    if (began := computed_by(about)) != (here := computed_by()):
        remarks.add(f"{url}: begun on {began}, and resumed on {here}; the last digits may differ")
    return remarks


def _damage(files: DirFileSystem, key: str, array: zarr.Array, region: Region) -> str:
    """Read a chunk, and say what is wrong with it, if anything."""
    if not files.exists(key):
        return "it is missing"
    try:
        array[region]
    except OSError:
        raise
    except Exception as error:  # each codec raises its own errors on damaged bytes
        return shortened(str(error))
    return ""
