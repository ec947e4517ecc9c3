"""Stored sweeps: whole or not at all, gone on with bit for bit, refused where they are not what was asked for."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import slippulse_jax as sp
from slippulse_jax.sweeps import run
from slippulse_jax.sweeps.store import StoreError

ROOT = Path(__file__).resolve().parent.parent
REQUEST = {
    "height": np.linspace(10, 50, 30), "stiffness": np.geomspace(1e-3, 0.1, 20), "poisson": np.array([0.2, 0.3]), "outputs": ("length",)
}  # fmt: skip
CHUNK = 5  # 240 files


def contents(store):
    """Bytes of every file of a store."""
    return {path.relative_to(store).as_posix(): path.read_bytes() for path in sorted(store.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    store = tmp_path_factory.mktemp("sweep") / "reference"
    sp.sweep(**REQUEST, store=store, chunk=CHUNK)
    return store


def test_store_reads_back_as_the_sweep_in_memory(reference):
    kept, stored = sp.sweep(**REQUEST), sp.open_sweep(reference)
    xr.testing.assert_equal(stored.load(), kept)
    assert stored.length.attrs == kept.length.attrs
    assert stored.attrs["request_sha256"] == kept.attrs["request_sha256"]
    assert stored.attrs["complete"] == 1


@pytest.mark.parametrize(
    "where",
    [
        {"height": 3},
        {"height": slice(3, 20, 4), "poisson": [1, 0]},
        {"stiffness": [3, 3, 1]},
        {"poisson": -1, "height": slice(None, None, -1)},
        {"height": slice(5, 5)},
        {"height": [29, 0], "stiffness": slice(-3, None), "poisson": 0},
    ],
)
def test_reading_is_lazy_and_right(reference, where, monkeypatch):
    kept, stored = sp.sweep(**REQUEST), sp.open_sweep(reference)
    opened = []
    monkeypatch.setattr(Path, "read_bytes", lambda path, read=Path.read_bytes: (opened.append(path), read(path))[1])
    part = stored.length.isel(where)
    assert not opened, "nothing is read before values are asked for"
    xr.testing.assert_equal(part, kept.length.isel(where))
    if "poisson" not in where:  # the last axis lies within a file
        assert len(opened) < 240


def test_dataset_of_a_store_can_be_pickled_and_plotted(reference):
    import pickle

    stored = pickle.loads(pickle.dumps(sp.open_sweep(reference)))
    assert float(stored.length.sel(height=50, poisson=0.3).isel(stiffness=0)) > 20
    stored.length.sel(poisson=0.3).plot()


def test_memory_does_not_grow_with_the_sweep(tmp_path, monkeypatch):
    """No more than two chunks of columns are alive at any time: the one computed and the one being written."""
    import weakref

    alive, most = set(), 0
    evaluate = run.evaluate

    def watched(*arguments):
        nonlocal most
        columns = evaluate(*arguments)
        array = columns["length"]
        alive.add(id(array))
        weakref.finalize(array, alive.discard, id(array))
        most = max(most, len(alive))
        return columns

    monkeypatch.setattr(run, "evaluate", watched)
    sp.sweep(**REQUEST, store=tmp_path / "s", chunk=40)
    assert most <= 3


def child(store):
    """A process that runs the sweep."""
    code = (
        "import numpy as np, slippulse_jax as sp\n"
        "sp.sweep(height=np.linspace(10, 50, 30), stiffness=np.geomspace(1e-3, 0.1, 20), poisson=[0.2, 0.3],"
        f" outputs='length', store={str(store)!r}, chunk={CHUNK})\n"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), "JAX_ENABLE_COMPILATION_CACHE": "0"},
        stderr=subprocess.PIPE,
    )


def kill_at_random(store, rng, how):
    """Run the sweep and end its process after a random number of its chunks, at a random moment."""
    target = rng.integers(0, 230)
    with child(store) as process:
        while process.poll() is None and len(list((store / "chunks").glob("*.npz"))) < target:
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.02))
        process.send_signal(how)
        process.wait(timeout=60)


@pytest.mark.parametrize("kills", [2, pytest.param(50, marks=pytest.mark.slow)])
def test_killed_and_resumed_is_the_same_to_the_last_bit(reference, tmp_path, kills):
    rng = np.random.default_rng(kills)
    unfinished = 0
    for number in range(kills):
        store = tmp_path / str(number)
        kill_at_random(store, rng, signal.SIGKILL)
        unfinished += len(list((store / "chunks").glob("*.npz"))) < 240
        sp.sweep(**REQUEST, store=store, chunk=CHUNK)
        assert contents(store) == contents(reference)
    assert unfinished >= kills * 0.8, "most were killed while they ran"


def test_interrupted_and_resumed(reference, tmp_path, monkeypatch):
    """Ctrl-C in any place leaves whole chunks."""
    evaluate, calls = run.evaluate, iter(range(100))

    def interrupted(*arguments):
        if next(calls) == 30:
            raise KeyboardInterrupt
        return evaluate(*arguments)

    monkeypatch.setattr(run, "evaluate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK)
    monkeypatch.undo()
    part = sp.open_sweep(tmp_path / "s")
    assert part.attrs["complete"] == 0
    assert np.isfinite(part.length.values.ravel()[: 30 * CHUNK]).all()
    assert np.isnan(part.length.values.ravel()[30 * CHUNK :]).all(), "what is not computed is not a number"
    sp.sweep(**REQUEST, store=tmp_path / "s")
    assert contents(tmp_path / "s") == contents(reference)


def test_full_disk_and_resumed(reference, tmp_path, monkeypatch):
    fsync, calls = os.fsync, iter(range(1000))

    def full(handle):
        if next(calls) == 50:
            raise OSError(28, "No space left on device")
        fsync(handle)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK)
    monkeypatch.undo()
    sp.sweep(**REQUEST, store=tmp_path / "s")
    assert contents(tmp_path / "s") == contents(reference)


def damage(path, at):
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(bytes(content))


@pytest.mark.parametrize("at", [0, 60, -300, -100, -1])
def test_one_flipped_bit_is_found_refused_and_mended(reference, tmp_path, at):
    store = tmp_path / "s"
    sp.sweep(**REQUEST, store=store, chunk=CHUNK)
    damage(store / "chunks" / "000003.npz", at)
    with pytest.raises(StoreError, match=r"000003.npz: damaged chunk .*; the same sweep, resumed, computes it again"):
        sp.open_sweep(store).length.load()
    with pytest.warns(RuntimeWarning, match="000003.npz: damaged chunk .* computing it again"):
        sp.sweep(**REQUEST, store=store)
    assert contents(store) == contents(reference)


def test_cut_off_chunk_and_chunk_of_another_place(reference, tmp_path):
    store = tmp_path / "s"
    sp.sweep(**REQUEST, store=store, chunk=CHUNK)
    one, two = store / "chunks" / "000001.npz", store / "chunks" / "000002.npz"
    one.write_bytes(one.read_bytes()[:100])
    two.write_bytes((store / "chunks" / "000003.npz").read_bytes())
    with pytest.warns(RuntimeWarning, match="damaged") as caught:
        sp.sweep(**REQUEST, store=store)
    assert len(caught) == 2
    assert contents(store) == contents(reference)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poisson": 0.25}, r"poisson: 2 values 0.2 … 0.3, now 0.25"),
        ({"stiffness": np.geomspace(1e-3, 0.2, 20)}, r"stiffness: 20 values 0.001 … 0.1, now 20 values 0.001 … 0.2"),
        ({"outputs": ("length", "status")}, r"outputs: \['length'\], now \['length', 'status'\]"),
        ({"max_contacts": 99}, "max_contacts: 10000000, now 99"),
        ({"prestress": 0.1}, "prestress: not given, now 0.1"),
        ({"chunk": 7}, "has 5 points per chunk, not 7"),
        ({"resume": False}, "holds a sweep already"),
    ],
)
def test_another_sweep_is_refused(reference, change, message):
    before = contents(reference)
    with pytest.raises(StoreError, match=message):
        sp.sweep(**{**REQUEST, **change}, store=reference)
    assert contents(reference) == before


def test_another_version_is_refused(reference, tmp_path):
    manifest = json.loads((reference / "manifest.json").read_text())
    store = tmp_path / "s"
    sp.sweep(**REQUEST, store=store, chunk=CHUNK)
    (store / "manifest.json").write_text(json.dumps(manifest | {"versions": manifest["versions"] | {"jax": "0.1"}}))
    with pytest.raises(StoreError, match=r"was computed with jax 0.1, now "):
        sp.sweep(**REQUEST, store=store)
    assert sp.open_sweep(store).attrs["jax"] == "0.1", "reading it stays possible"
    (store / "manifest.json").write_text(json.dumps(manifest | {"format": 2}))
    with pytest.raises(StoreError, match="a store of format 2"):
        sp.open_sweep(store)


def test_machine_that_rounds_differently_is_refused(reference, monkeypatch):
    evaluate = run.evaluate
    monkeypatch.setattr(run, "evaluate", lambda *a: {name: np.nextafter(v, 99) for name, v in evaluate(*a).items()})
    with pytest.raises(StoreError, match="the first points of length have other digits than stored"):
        sp.sweep(**REQUEST, store=reference)


def test_one_point_and_no_points(tmp_path):
    one = sp.sweep(height=25.0, stiffness=0.03, poisson=0.3, store=tmp_path / "one")
    assert float(one.length.load()) == pytest.approx(25.789811, abs=1e-6)
    few = sp.sweep(height=[25.0, 26.0], stiffness=[0.03, 0.04, 0.05], poisson=0.3, store=tmp_path / "few")
    for axis, shape in (("height", (0, 3)), ("stiffness", (2, 0))):
        assert few.length.isel({axis: slice(0, 0)}).load().shape == shape
        assert few.length.isel({axis: []}).load().shape == shape


def test_any_damage_to_the_manifest_is_a_store_error(reference, tmp_path):
    """Bytes changed, cut and put in; values of other types: a store of the same sweep, or a `StoreError`."""
    rng = np.random.default_rng(3)
    store = tmp_path / "s"
    (store / "chunks").mkdir(parents=True)
    whole = {name: (reference / name).read_bytes() for name in ("manifest.json", "axes.npz")}
    manifest = json.loads(whole["manifest.json"])
    damaged = []
    for name, content in whole.items():
        for _ in range(120):
            bad, at = bytearray(content), rng.integers(len(content))
            bad[at : at + rng.integers(0, 3)] = rng.bytes(rng.integers(0, 4))
            damaged.append({**whole, name: bytes(bad)})
        damaged += [{**whole, name: bad} for bad in (b"", content[: len(content) // 2], b"\xff\xfe", b"[" * 200_000, b"null")]
    for place in (manifest, manifest["request"]):
        for key, kept in list(place.items()):
            for value in (None, "x", -1, 1e400, [], {}, [[0]], 2**70):
                place[key] = value
                damaged.append({**whole, "manifest.json": json.dumps(manifest).encode()})
            place[key] = kept
    refused = []
    for files in damaged:
        for name, content in files.items():
            (store / name).write_bytes(content)
        try:
            assert sp.open_sweep(store).length.shape == sp.open_sweep(reference).length.shape
        except StoreError as error:
            refused.append(str(error))
    assert len(refused) > len(damaged) / 2
    assert max(map(len, refused)) < 3000


def test_two_writers_of_one_chunk(tmp_path, monkeypatch):
    """One clears away the temporary file of the other, as if of a process that was killed."""
    replace, calls = os.replace, iter(range(1000))

    def lost(source, target):
        if Path(target).name == "000000.npz" and next(calls) == 0:
            Path(source).unlink()
        replace(source, target)

    monkeypatch.setattr(os, "replace", lost)
    found = sp.sweep(height=[25.0, 26.0], stiffness=0.03, poisson=0.3, store=tmp_path / "s")
    assert np.isfinite(found.length.load()).all()


def test_what_is_not_a_store(tmp_path):
    with pytest.raises(StoreError, match="not the store of a sweep"):
        sp.open_sweep(tmp_path)
    (tmp_path / "data.txt").write_text("mine")
    with pytest.raises(StoreError, match="other things in it"):
        sp.sweep(**REQUEST, store=tmp_path)
    with pytest.raises(StoreError, match="is a file"):
        sp.sweep(**REQUEST, store=tmp_path / "data.txt")
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "manifest.json").write_text("{")
    with pytest.raises(StoreError, match="damaged manifest"):
        sp.open_sweep(tmp_path / "s")


def test_shares_together_are_the_whole(reference, tmp_path):
    for index in (2, 0, 1):
        part = sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK, share=(index, 3))
        assert part.attrs["complete"] == (index == 1)
    assert contents(tmp_path / "s") == contents(reference)
