"""Files of stored sweeps, as tests look at them."""

from pathlib import Path

import pytest

import slippulse_jax as sp


def contents(store):
    """Bytes of every file of a store but those that a killed writer left unfinished."""
    files = (path for path in sorted(Path(store).rglob("*")) if path.is_file() and path.suffix not in (".partial", ".tmp"))
    return {path.relative_to(store).as_posix(): path.read_bytes() for path in files}


def written(store, output="length"):
    """Number of finished chunks, by their names: a writer at work renames the files that are listed."""
    return sum(path.is_file() and path.suffix == "" for path in (Path(store) / output / "c").rglob("*"))


def reference_of(request, chunk):
    """Fixture: the folder of a sweep that nothing disturbed."""

    @pytest.fixture(scope="module")
    def reference(tmp_path_factory):
        store = tmp_path_factory.mktemp("sweep") / "reference"
        sp.sweep(**request, store=store, chunk=chunk)
        return store

    return reference
