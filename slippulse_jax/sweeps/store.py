"""A sweep on disk: request, axes, and one file per chunk.

::

    manifest.json       request, digest of the request, versions, points per chunk
    axes.npz            values of the parameters
    chunks/000000.npz   outputs of the first points, one member each; its SHA-256 is the file's zip comment

Every file is written whole or not at all, and every process writes the same bytes for a chunk. So any process may be killed
at any moment, and every file there is counts. A chunk is a NumPy archive, readable without this package.
"""

import functools
import hashlib
import io
import json
import struct
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from slippulse_jax.files import write_atomically
from slippulse_jax.plain import shortened
from slippulse_jax.sweeps.request import PARAMETERS, Columns, Request

FORMAT = 1
VERSIONS = ("slippulse_jax", "jax", "jaxlib")
"""Packages on which the digits of a result depend, beside the request and the processor."""

_COMMENT = "sha256 {} of all before; request {} chunk {:06d}"


class StoreError(ValueError):
    """A store that cannot be used: of another request or version, damaged, or no store at all."""


class Store:
    """The folder of one sweep.

    Attributes
    ----------
    path : Path
    request : Request
    chunk : int
        Points per file; the last may have fewer.
    versions : dict
        Of the packages that computed it.
    """

    def __init__(self, path: Path, request: Request, chunk: int, versions: dict[str, str]) -> None:
        self.path, self.request, self.chunk, self.versions = path, request, chunk, versions

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, {self.request.size} points in {self.chunks} chunks)"

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.request.size // self.chunk)

    def span(self, index: int) -> tuple[int, int]:
        """First point of a chunk, and the first of the next."""
        return index * self.chunk, min((index + 1) * self.chunk, self.request.size)

    def file(self, index: int) -> Path:
        """File of a chunk."""
        return self.path / "chunks" / f"{index:06d}.npz"

    def write(self, index: int, columns: Columns) -> None:
        """Write one chunk, whole or not at all."""
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **{k: v.astype(v.dtype.newbyteorder("<")) for k, v in columns.items()})
        sealed = _sealed(content.getvalue(), self.request.digest, index)
        try:
            write_atomically(self.file(index), sealed)
        except FileNotFoundError:  # another process took the temporary file for the remains of one that was killed
            write_atomically(self.file(index), sealed)

    def read(self, index: int) -> Columns:
        """Read one chunk.

        Raises
        ------
        FileNotFoundError
            If it has not been computed.
        StoreError
            If it is damaged, or not the chunk it should be.
        """
        path = self.file(index)
        start, stop = self.span(index)
        try:
            columns = _opened(path.read_bytes(), self.request.digest, index)
        except FileNotFoundError:
            raise
        except Exception as error:  # damaged bytes fail in as many ways as there are readers
            raise StoreError(f"{path}: damaged chunk ({error}); the same sweep, resumed, computes it again") from None
        if set(columns) != set(self.request.outputs) or any(v.shape != (stop - start,) for v in columns.values()):
            raise StoreError(f"{path}: holds other outputs or points than this sweep; delete it, then resume")
        return columns

    def present(self) -> list[int]:
        """Chunks whose files exist; the files are not read."""
        names = (p.stem for p in (self.path / "chunks").glob("*.npz"))
        return sorted(i for i in (int(name) for name in names if name.isdigit()) if i < self.chunks)

    def clear_leftovers(self, index: int) -> None:
        """Remove temporary files of a process that was killed while writing this chunk."""
        for left in (self.path / "chunks").glob(f".{index:06d}.npz.*.tmp"):
            left.unlink(missing_ok=True)


def create(path: Path, request: Request, chunk: int) -> Store:
    """Make the folder of a new sweep; another process may have just made it."""
    if path.exists() and not path.is_dir():
        raise StoreError(f"{path}: is a file; a store is a folder")
    if path.is_dir() and any(p.name not in ("chunks", "axes.npz") and not p.name.startswith(".") for p in path.iterdir()):
        raise StoreError(f"{path}: is a folder with other things in it; give a new or empty one")
    (path / "chunks").mkdir(parents=True, exist_ok=True)
    axes = io.BytesIO()
    np.savez(axes, allow_pickle=False, **request.parameters)
    write_atomically(path / "axes.npz", axes.getvalue())
    manifest = {
        "format": FORMAT,
        "request": request.describe(),
        "digest": request.digest,
        "versions": current_versions(),
        "points": request.size,
        "chunk": chunk,
    }
    write_atomically(path / "manifest.json", (json.dumps(manifest, indent=2, ensure_ascii=False) + "\n").encode())
    return open_store(path)


def open_store(path: Path) -> Store:
    """Open the sweep in a folder.

    Raises
    ------
    StoreError
        If there is none, or one of another format.
    """
    try:
        manifest: dict[str, Any] = json.loads((path / "manifest.json").read_bytes())
        described = manifest["request"]
        if manifest["format"] != FORMAT:
            raise StoreError(f"{path}: a store of format {manifest['format']}; this version reads format {FORMAT}")
        with np.load(io.BytesIO((path / "axes.npz").read_bytes()), allow_pickle=False) as axes:
            parameters = {name: axes[name] for name in PARAMETERS if name in axes}
        request = Request(
            parameters,
            described["combined"] == "product",
            tuple(described["outputs"]),
            described["right"],
            described["sites"],
            described["max_contacts"],
            described.get("push_control", "displacement"),
        )
        agrees = request.digest == manifest["digest"] and manifest["points"] == request.size
        store = Store(path, request, manifest["chunk"], dict(manifest["versions"]))
        if agrees and not (isinstance(store.chunk, int) and store.chunk > 0 and store.chunks >= 0):
            raise ValueError(f"chunk = {store.chunk!r}")
    except FileNotFoundError as missing:
        raise StoreError(f"{path}: not the store of a sweep ({missing.filename} is missing)") from None
    except StoreError:
        raise
    except Exception as error:  # damaged bytes fail in as many ways as there are readers
        what = shortened(f"{type(error).__name__}: {error}")
        raise StoreError(f"{path}: the store of a sweep with a damaged manifest or axes ({what})") from None
    if not agrees:
        raise StoreError(f"{path}: request and axes do not agree: the store was tampered with or is damaged")
    return store


def exists(path: Path) -> bool:
    """Whether the folder holds a sweep."""
    return (path / "manifest.json").exists()


def check_same(store: Store, request: Request, chunk: int | None) -> None:
    """Check that the store is of the same request and versions.

    Raises
    ------
    StoreError
        Saying what differs.
    """
    if store.request.digest != request.digest:
        old, new = store.request.describe(), request.describe()
        differs = [
            *(f"{key}: {old[key]!r}, now {new[key]!r}" for key in old if key != "parameters" and old[key] != new[key]),
            *(
                f"{name}: {_brief(store.request, name)}, now {_brief(request, name)}"
                for name in PARAMETERS
                if old["parameters"].get(name) != new["parameters"].get(name)
            ),
        ]
        raise StoreError(f"{store.path}: holds another sweep ({'; '.join(differs)}); give it a store of its own")
    if chunk is not None and chunk != store.chunk:
        raise StoreError(f"{store.path}: has {store.chunk} points per chunk, not {chunk}; leave chunk out to resume it")
    if changed := {k: (v, store.versions.get(k)) for k, v in current_versions().items() if v != store.versions.get(k)}:
        differs = "; ".join(f"{name} {old}, now {new}" for name, (new, old) in changed.items())
        raise StoreError(f"{store.path}: was computed with {differs}: digits may differ. Finish it there, or start a new store")


def current_versions() -> dict[str, str]:
    """Versions of the packages on which the digits depend."""
    return {name: _version(name) for name in VERSIONS}


@functools.cache
def _version(name: str) -> str:
    return version(name)


def _brief(request: Request, name: str) -> str:
    values = request.parameters.get(name)
    if values is None:
        return "not given"
    return f"{values.size} values {values[0]:g} … {values[-1]:g}" if values.ndim else f"{values:g}"


def _sealed(archive: bytes, digest: str, index: int) -> bytes:
    """The zip archive with its own checksum as the comment at its end."""
    comment = _COMMENT.format(hashlib.sha256(archive).hexdigest(), digest, index).encode()
    return archive[:-2] + struct.pack("<H", len(comment)) + comment


def _opened(content: bytes, digest: str, index: int) -> Columns:
    length = len(_COMMENT.format("0" * 64, digest, index))
    archive = content[: -length - 2] + b"\0\0"
    expected = _COMMENT.format(hashlib.sha256(archive).hexdigest(), digest, index)
    if content[-length:] != expected.encode():
        raise ValueError("its checksum does not fit")
    with np.load(io.BytesIO(content), allow_pickle=False) as columns:
        return {name: columns[name] for name in columns.files}
