"""Faults that no other file tries: an interrupt while a file is written, two writers of one file, a clock that jumps.

docs/appendix/robustness.md lists all faults, what is promised, and the tests that hold it.
"""

import os
import threading
import time

import pytest

from slippulse_jax.base.files import write_atomically
from slippulse_jax.cli import cache


@pytest.mark.parametrize("stage", ["fsync", "replace"])
def test_interrupt_while_a_file_is_written(tmp_path, monkeypatch, stage):
    """The former content stays, and nothing else is left."""
    path = tmp_path / "fit.json"
    write_atomically(path, b"old")

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, stage, interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, b"new and longer")
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["fit.json"]


@pytest.mark.ci
def test_many_writers_of_one_file(tmp_path):
    """It holds what one of them wrote, whole, at any time."""
    path = tmp_path / "fit.json"
    contents = [bytes([n]) * 100_000 for n in range(6)]
    write_atomically(path, contents[0])
    writers = [threading.Thread(target=lambda c=c: [write_atomically(path, c) for _ in range(5)]) for c in contents]
    for writer in writers:
        writer.start()
    seen = set()
    while any(writer.is_alive() for writer in writers):
        seen.add(path.read_bytes())
    assert seen | {path.read_bytes()} <= set(contents)
    assert [p.name for p in tmp_path.iterdir()] == ["fit.json"]


@pytest.mark.parametrize(("now", "kept"), [(0.0, True), (4e9, False)])
def test_clock_that_jumps(tmp_path, monkeypatch, now, kept):
    """Nothing but the age of compiled programs depends on it: a clock of 1970 keeps them, one of 2096 compiles them again."""
    folder = tmp_path / "compiled"
    folder.mkdir()
    (folder / "length-cache").touch()
    monkeypatch.setattr(cache, "_folder", lambda: folder)
    monkeypatch.setattr(time, "time", lambda: now)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "")  # so that it is restored
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("SLIPPULSE_PROGRAMS", "")
    cache.keep_compiled_programs()
    assert (folder / "length-cache").exists() == kept
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == str(folder)
    assert os.environ["SLIPPULSE_PROGRAMS"] == str(folder / "whole")


def test_only_the_newest_programs_are_kept(tmp_path, monkeypatch):
    names = ("JAX_COMPILATION_CACHE_DIR", "SLIPPULSE_PROGRAMS", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")
    for name in names:
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setattr(cache, "_folder", lambda: tmp_path)
    monkeypatch.setattr(cache, "MOST_KEPT", 3)
    (tmp_path / "whole").mkdir()
    for age, name in enumerate(["a-cache", "whole/b", "c-cache", "whole/d", "e-cache"]):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (time.time() - age, time.time() - age))
    cache.keep_compiled_programs()
    assert {path.name for path in tmp_path.rglob("*") if path.is_file()} == {"a-cache", "b", "c-cache"}
