"""Stored sweeps: whole or not at all, resumed bit for bit, refused where they are not what was asked for."""

import json
import os
import pickle
import resource
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import fsspec
import numpy as np
import pytest
import xarray as xr
from problems import PAPER
from stores import contents, reference_of, written

import slippulse_jax as sp
from slippulse_jax.sweeps import dataset, run
from slippulse_jax.sweeps import store as stores
from slippulse_jax.sweeps.outputs import choose
from slippulse_jax.sweeps.request import Request, chunk_shape, make_axes, regions
from slippulse_jax.sweeps.store import StoreError

ROOT = Path(__file__).resolve().parents[2]
REQUEST = {
    "height": np.linspace(10, 50, 30), "stiffness": np.geomspace(1e-3, 0.1, 20), "poisson": np.array([0.2, 0.3]), "outputs": ("length",)
}  # fmt: skip
CHUNK = 5  # 10 chunks of 2 × 2 for each height, so 300
CHUNKS = 300
FIRST = "length/c/0/0/0"

reference = reference_of(REQUEST, CHUNK)


@pytest.mark.ci
def test_store_reads_back_as_the_sweep_in_memory(reference):
    kept, stored = sp.sweep(**REQUEST), sp.open_sweep(reference)
    xr.testing.assert_equal(stored.load(), kept)
    assert stored.length.attrs == kept.length.attrs
    assert stored.attrs["request_sha256"] == kept.attrs["request_sha256"]
    assert stored.attrs["complete"] == 1


@pytest.mark.ci
@pytest.mark.parametrize(
    ("where", "chunks"),
    [
        ({"height": 3}, 10),
        ({"height": slice(3, 20, 4), "poisson": [1, 0]}, 50),
        ({"poisson": -1, "height": slice(None, None, -1)}, 300),
        ({"height": slice(5, 5)}, 0),
        ({"height": [29, 0], "stiffness": slice(-3, None), "poisson": 0}, 4),
    ],
)
def test_reading_is_lazy_and_right(reference, where, chunks, monkeypatch):
    kept, stored = sp.sweep(**REQUEST), sp.open_sweep(reference)
    opened = []
    monkeypatch.setattr(Path, "read_bytes", lambda path, read=Path.read_bytes: (opened.append(path), read(path))[1])
    part = stored.length.isel(where)
    assert not opened, "nothing is read before values are asked for"
    xr.testing.assert_equal(part, kept.length.isel(where))
    assert len(opened) == chunks


@pytest.mark.ci
@pytest.mark.parametrize("chunks", [None, {}], ids=["xarray", "dask"])
def test_opened_without_this_package(reference, chunks):
    """Labels, units, the meaning of flags and the request are Zarr's and xarray's; whole numbers stay whole."""
    kept, found = sp.sweep(**REQUEST), xr.open_zarr(reference, chunks=chunks)
    xr.testing.assert_equal(found.load(), kept)
    assert found.length.attrs == kept.length.attrs
    assert found.height.attrs == kept.height.attrs
    assert json.loads(found.attrs["request"])["outputs"] == ["length"]
    assert set(found.attrs) >= {"slippulse_jax", "jax", "jaxlib", "processor", "chunk", "request_sha256", "store_format"}


@pytest.mark.ci
def test_flags_and_points_and_scalars_are_labelled(tmp_path):
    given = {"height": [10.0, 25.0, 50.0], "stiffness": [0.03, 0.01, 0.3], "poisson": 0.3, "prestress": 0.1, "points": True}
    given |= {"threshold_slope": [0, 0.001, 0], "outputs": ("status", "length", "contacts_broken")}
    kept, stored = sp.sweep(**given), sp.sweep(**given, store=tmp_path / "s", chunk=2)
    assert list(stored.data_vars) == list(given["outputs"])
    assert list(stored.coords) == list(kept.coords)
    np.testing.assert_array_equal(stored.status.attrs["flag_values"], kept.status.attrs["flag_values"])
    found = xr.open_zarr(tmp_path / "s", chunks=None)
    assert (found.status.dtype, found.contacts_broken.dtype) == ("int8", "int32")
    assert set(found.coords) == set(kept.coords)
    assert found.status.attrs["flag_meanings"] == kept.status.attrs["flag_meanings"]
    xr.testing.assert_equal(stored.load(), kept)
    one = sp.sweep(height=25.0, stiffness=0.03, poisson=0.3, store=tmp_path / "one")
    assert float(one.length.load()) == pytest.approx(PAPER.length, abs=1e-6)
    few = sp.sweep(height=[25.0, 26.0], stiffness=[0.03, 0.04, 0.05], poisson=0.3, store=tmp_path / "few")
    for axis, shape in (("height", (0, 3)), ("stiffness", (2, 0))):
        assert few.length.isel({axis: slice(0, 0)}).load().shape == shape
        assert few.length.isel({axis: []}).load().shape == shape


@pytest.mark.ci
def test_lengths_that_are_no_number_are_results_too(tmp_path):
    """Zarr leaves out chunks of nothing but the fill value unless it is told otherwise."""
    given = {"height": [1e170, 2e170], "stiffness": 0.03, "poisson": 0.3, "outputs": ("status", "length")}
    found = sp.sweep(**given, store=tmp_path / "s", chunk=1)
    assert found.attrs["complete"] == 1
    assert np.isnan(found.length).all()


@pytest.mark.ci
@pytest.mark.parametrize("url", ["memory://sweeps/s.zarr", "file://{}/s.zarr"])
def test_any_address_that_fsspec_knows(tmp_path, url, reference):
    url = url.format(tmp_path)
    part = sp.sweep(**REQUEST, store=url, chunk=CHUNK, share=(0, 2))
    assert part.attrs["complete"] == 0
    files, root = fsspec.url_to_fs(url)
    bad = bytearray(files.cat_file(f"{root}/{FIRST}"))
    bad[5] ^= 1
    files.pipe_file(f"{root}/{FIRST}", bytes(bad))
    with pytest.warns(RuntimeWarning, match="s.zarr: damaged chunk length/c/0/0/0"):
        found = sp.sweep(**REQUEST, store=url)
    assert found.attrs["complete"] == 1
    assert sp.open_sweep(url).identical(found)
    xr.testing.assert_equal(xr.open_zarr(url, chunks=None).load(), sp.open_sweep(reference).load())
    files.rm(root, recursive=True)


@pytest.mark.parametrize("url", ["s4://bucket/s.zarr", "http://127.0.0.1:9/s.zarr"])
def test_addresses_of_nothing(url):
    with pytest.raises(StoreError, match="[Pp]rotocol|not the store|Cannot connect|requires|install"):
        sp.open_sweep(url)


@pytest.mark.parametrize("shape", [(), (7,), (30, 20, 2), (3, 1500), (5, 1, 4, 3), (1, 1), (1000, 1000, 100)])
@pytest.mark.parametrize("points", [1, 5, 97, 1 << 20])
def test_chunks_are_regular_and_large(shape, points):
    """Chunks hold at most so many points, and more than half of them where the sweep has so many."""
    chunk = chunk_shape(shape, points)
    size = int(np.prod(chunk, dtype=int))
    assert size <= points
    assert 2 * size > points or chunk == shape
    if np.prod(shape, dtype=int) < 1e5:
        found = np.zeros(shape, int)
        for region in regions(shape, points):
            found[region] += 1
        assert (found == 1).all()


@pytest.mark.parametrize(
    ("outputs", "points"),
    [("length", 1 << 20), (("length", "status"), 1 << 20), (("b", "edge_stress", "nucleation_load"), 1 << 20)]
    + [(("length", "exact_length"), 1 << 14), ("gradients", 1 << 14), (("status", "block_precursor_length"), 1 << 7)],
)
def test_chunks_of_quick_outputs_have_a_million_points(outputs, points):
    grid = {"height": np.linspace(10, 50, 3000), "stiffness": np.geomspace(1e-3, 0.1, 3000), "poisson": 0.3}
    pushed = {"push_height": 0.3} if "block_precursor_length" in outputs else {}
    request = Request(make_axes({**grid, **pushed}), choose(outputs, [*grid, *pushed]))
    assert run.default_chunk(request, tasks=False) == points


def test_dataset_of_a_store_can_be_pickled_and_plotted(reference):
    stored = pickle.loads(pickle.dumps(sp.open_sweep(reference)))
    assert float(stored.length.sel(height=50, poisson=0.3).isel(stiffness=0)) > 20
    stored.length.sel(poisson=0.3).plot()


@pytest.mark.ci
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


def child(store, before="", after=""):
    """A process that runs the sweep."""
    code = (
        f"import numpy as np, slippulse_jax as sp\n{before}"
        "sp.sweep(height=np.linspace(10, 50, 30), stiffness=np.geomspace(1e-3, 0.1, 20), poisson=[0.2, 0.3],"
        f" outputs='length', store={str(store)!r}, chunk={CHUNK})\n{after}"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), "JAX_ENABLE_COMPILATION_CACHE": "0"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def kill_at_random(store, rng, how):
    """Run the sweep and end its process after a random number of its chunks, at a random moment."""
    target = rng.integers(0, CHUNKS - 10)
    with child(store) as process:
        while process.poll() is None and written(store) < target:
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.02))
        process.send_signal(how)
        process.wait(timeout=60)


@pytest.mark.ci
@pytest.mark.parametrize("kills", [2, pytest.param(50, marks=pytest.mark.slow)])
def test_killed_and_resumed_is_the_same_to_the_last_bit(reference, tmp_path, kills):
    rng = np.random.default_rng(kills)
    unfinished = 0
    for number in range(kills):
        store = tmp_path / str(number)
        kill_at_random(store, rng, signal.SIGKILL)
        unfinished += written(store) < CHUNKS
        sp.sweep(**REQUEST, store=store, chunk=CHUNK)
        assert contents(store) == contents(reference)
    assert unfinished >= kills * 0.8, "most were killed while they ran"


@pytest.mark.ci
def test_interrupted_and_resumed(reference, tmp_path, monkeypatch):
    """Ctrl-C in any place leaves whole chunks; resuming computes the others and none of these."""
    evaluate, calls = run.evaluate, iter(range(100))

    def interrupted(*arguments):
        if next(calls) == 30:
            raise KeyboardInterrupt
        return evaluate(*arguments)

    monkeypatch.setattr(run, "evaluate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK)
    part = sp.open_sweep(tmp_path / "s")
    assert part.attrs["complete"] == 0
    computed = []
    monkeypatch.setattr(run, "evaluate", lambda request, region: (computed.append(region), evaluate(request, region))[1])
    assert np.isfinite(part.length.values[:3]).all()
    assert np.isnan(part.length.values[3:]).all(), "what is not computed is not a number"
    sp.sweep(**REQUEST, store=tmp_path / "s")
    assert contents(tmp_path / "s") == contents(reference)
    assert len(computed) == CHUNKS - 30


@pytest.mark.ci
def test_full_disk_and_resumed(reference, tmp_path, full_disk):
    part = sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK, share=(0, 3))
    assert part.attrs["complete"] == 0
    before = contents(tmp_path / "s")
    full_disk(20)
    with pytest.raises(OSError, match="too large"):
        sp.sweep(**REQUEST, store=tmp_path / "s")
    with pytest.raises(StoreError, match=r"no store can be made there \(File too large\)"):
        sp.sweep(**REQUEST, store=tmp_path / "t")
    full_disk(resource.RLIM_INFINITY)
    assert contents(tmp_path / "s") == before
    for store in ("s", "t"):
        sp.sweep(**REQUEST, store=tmp_path / store, chunk=CHUNK)
        assert contents(tmp_path / store) == contents(reference)


def test_no_store_where_nothing_can_be_written():
    with pytest.raises(StoreError, match="/proc/sweep: no store can be made there"):
        sp.sweep(**REQUEST, store="/proc/sweep")


def test_folder_that_vanishes(tmp_path, monkeypatch):
    evaluate, calls = run.evaluate, iter(range(1000))

    def removing(*arguments):
        if next(calls) == 30:
            (tmp_path / "s").rename(tmp_path / "elsewhere")
        return evaluate(*arguments)

    monkeypatch.setattr(run, "evaluate", removing)
    with pytest.raises(StoreError, match="the store was removed while the sweep ran"):
        sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK)
    assert not (tmp_path / "s" / "zarr.json").exists()
    assert sp.open_sweep(tmp_path / "elsewhere").attrs["complete"] == 0


def damage(path, at):
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(bytes(content))


@pytest.mark.ci
@pytest.mark.parametrize("at", [-1, 0, *(pytest.param(n, marks=pytest.mark.slow) for n in (17, -4))])
def test_one_flipped_bit_is_found_refused_and_mended(reference, tmp_path, at):
    store = tmp_path / "s"
    sp.sweep(**REQUEST, store=store, chunk=CHUNK)
    damage(store / "length/c/0/3/0", at)
    with pytest.raises(ValueError, match="checksum do not match"):
        sp.open_sweep(store).length.load()
    with pytest.warns(RuntimeWarning, match="damaged chunk length/c/0/3/0 .*: computing it again"):
        sp.sweep(**REQUEST, store=store)
    assert contents(store) == contents(reference)


@pytest.mark.ci
def test_cut_off_chunk_and_missing_output(tmp_path):
    given = {**REQUEST, "outputs": ("length", "status")}
    store = tmp_path / "s"
    whole = sp.sweep(**given, store=store, chunk=CHUNK).load()
    before = contents(store)
    cut = store / "length/c/0/1/0"
    cut.write_bytes(cut.read_bytes()[:11])
    (store / "length/c/0/2/0").write_bytes(b"")
    (store / "length/c/0/3/0").unlink()
    (store / "status/c/0/4/0").unlink()
    with pytest.warns(RuntimeWarning, match="damaged chunk length") as caught:
        found = sp.sweep(**given, store=store)
    assert len(caught) == 3
    assert contents(store) == before
    xr.testing.assert_equal(found.load(), whole)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poisson": 0.25}, r"poisson: 2 values 0.2 … 0.3, now 0.25"),
        ({"stiffness": np.geomspace(1e-3, 0.2, 20)}, r"stiffness: 20 values 0.001 … 0.1, now 20 values 0.001 … 0.2"),
        ({"outputs": ("length", "status")}, r"outputs: \['length'\], now \['length', 'status'\]"),
        ({"sites": 99, "right": "free"}, "right: 'semi-infinite', now 'free'; sites: None, now 99"),
        ({"prestress": 0.1}, "prestress: not given, now 0.1"),
        ({"residual_strength": 0.1}, "residual_strength: not given, now 0.1"),
        ({"chunk": 7}, "has 5 points per chunk, not 7"),
        ({"resume": False}, "holds a sweep already"),
    ],
)
def test_another_sweep_is_refused(reference, change, message):
    before = contents(reference)
    with pytest.raises(StoreError, match=message):
        sp.sweep(**{**REQUEST, **change}, store=reference)
    assert contents(reference) == before


def rewrite(store, change):
    """Change the attributes of a store."""
    content = json.loads((store / "zarr.json").read_bytes())
    change(content["attributes"])
    (store / "zarr.json").write_text(json.dumps(content))


@pytest.mark.ci
def test_another_processor_or_release_resumes_with_one_warning(reference, tmp_path):
    """It names both. The attributes keep what began the store; where nothing is left to compute, nothing is said."""
    store = Path(shutil.copytree(reference, tmp_path / "s"))
    rewrite(store, lambda about: about.update(jaxlib="0.1", slippulse_jax="0.1", processor="abacus"))
    assert sp.sweep(**REQUEST, store=store).attrs["complete"] == 1
    for chunk in ("7/0/0", "7/1/0"):
        (store / "length/c" / chunk).unlink()
    said = rf"{store}: begun on abacus, slippulse_jax 0.1, jax .*, jaxlib 0.1, and resumed on "
    with pytest.warns(RuntimeWarning, match=said) as caught:
        assert sp.sweep(**REQUEST, store=store).attrs["complete"] == 1
    assert [one.filename for one in caught] == [__file__]
    assert f"resumed on {dataset.computed_by()}; the last digits may differ" in str(caught[0].message)
    after = contents(store)
    assert after.pop("zarr.json") != (before := contents(reference)).pop("zarr.json")
    assert after == before
    found = sp.open_sweep(store).attrs
    assert (found["jaxlib"], found["slippulse_jax"], found["processor"]) == ("0.1", "0.1", "abacus")


@pytest.mark.ci
@pytest.mark.parametrize("part", ["sha256", "size", "max_contacts", "outputs", "sites", "combined", "more"])
def test_an_edited_request_is_refused(reference, tmp_path, part):
    store = Path(shutil.copytree(reference, tmp_path / "s"))

    def edit(attributes):
        request = json.loads(attributes["request"])
        axis = request["parameters"]["height"]
        changed = {"sha256": "0" * 64, "size": 7, "outputs": ["length", "status"], "combined": "points"}.get(part, 99)
        (axis if part in axis else request)[part] = changed
        attributes["request"] = json.dumps(request)

    rewrite(store, edit)
    before = contents(store)
    for way in (sp.open_sweep, lambda store: sp.sweep(**REQUEST, store=store)):
        with pytest.raises(StoreError, match=r"tampered with|damaged manifest"):
            way(store)
    assert contents(store) == before


def test_stores_written_before_can_be_resumed():
    """The digest of a request of format 2 stays: the numbers, in this order and these types."""
    fronts = {"height": np.array([10.0, 25, 50]), "stiffness": 0.03, "poisson": 0.3, "prestress": [0, 0.1]}
    axes = make_axes(fronts)
    found = Request(axes, ("length", "status"), "semi-infinite", None, "displacement")
    assert found.digest == "037023ea518ff01fb0ea992551503f578166831c80a585f19c731e1bd716ba94"
    block = {"height": 60.0, "stiffness": 4e-3, "poisson": 0.3, "push_height": np.array([0.25, 0.5])}
    axes = make_axes(block, push_control="force")
    found = Request(axes, ("block_precursor_length",), "semi-infinite", None, "force")
    assert found.digest == "5e67d884d8b16b18d09f4b94b2100311241023e1081ded81d129e7e009719354"


@pytest.mark.ci
def test_a_store_of_this_format_can_be_resumed(tmp_path):
    """Kept from an earlier release: half of its chunks, and the manifest of then."""
    given = {"height": [10.0, 25.0, 50.0], "stiffness": [0.003, 0.03], "poisson": 0.3, "outputs": ("length", "status")}
    store = Path(shutil.copytree(Path(__file__).parent / "format2.zarr", tmp_path / "s"))
    before = contents(store)
    part, exact = sp.open_sweep(store), sp.sweep(**given)
    assert part.attrs["complete"] == 0
    np.testing.assert_array_equal(np.isnan(part.length).all("stiffness"), [False, True, False])
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*and resumed on", RuntimeWarning)  # wherever this is not the machine of then
        found = sp.sweep(**given, store=store).load()
    assert found.attrs["complete"] == 1
    assert {key: contents(store)[key] for key in before} == before
    np.testing.assert_array_equal(found.status, exact.status)
    np.testing.assert_allclose(found.length, exact.length, rtol=1e-12)


def test_a_later_format_is_refused(reference, tmp_path):
    store = Path(shutil.copytree(reference, tmp_path / "s"))
    rewrite(store, lambda about: about.update(store_format=3))
    with pytest.raises(StoreError, match="one of format 3; this version reads format 2"):
        sp.open_sweep(store)


@pytest.mark.ci
def test_any_damage_to_the_manifest_is_a_store_error(reference, tmp_path):
    """Bytes changed, cut and put in; values of other types: a store of the same sweep, or a `StoreError`."""
    rng = np.random.default_rng(3)
    store = tmp_path / "s"
    places = "zarr.json", "height/c/0"
    whole = {key: content for key, content in contents(reference).items() if not key.startswith("length/c")}
    manifest = json.loads(whole["zarr.json"])
    damaged = []
    for name in places:
        content = whole[name]
        for _ in range(40):
            bad, at = bytearray(content), rng.integers(len(content))
            bad[at : at + rng.integers(0, 3)] = rng.bytes(rng.integers(0, 4))
            damaged.append({name: bytes(bad)})
        damaged += [{name: bad} for bad in (b"", content[: len(content) // 2], b"\xff\xfe", b"[" * 200_000, b"null")]
    described = json.loads(manifest["attributes"]["request"])
    for place in (manifest, manifest["attributes"], described):
        for key, kept in list(place.items()):
            for value in (None, "x", -1, 1e400, [[0]]):
                place[key] = value
                if place is described:
                    manifest["attributes"]["request"] = json.dumps(described)
                damaged.append({"zarr.json": json.dumps(manifest).encode()})
            place[key] = kept
    refused, shape = [], sp.open_sweep(reference).length.shape
    for files in damaged:
        for name, content in {**whole, **files}.items():
            (store / name).parent.mkdir(parents=True, exist_ok=True)
            (store / name).write_bytes(content)
        try:
            assert sp.open_sweep(store).length.shape == shape
        except StoreError as error:
            refused.append(str(error))
    assert len(refused) > len(damaged) / 2
    assert max(map(len, refused)) < 3000


def test_keys_that_lead_out_of_the_store(reference, tmp_path):
    store = Path(shutil.copytree(reference, tmp_path / "s"))
    shutil.copytree(reference / "length", tmp_path / "outside")

    def lead_out(about):
        described = json.loads(about["request"])
        about["request"] = json.dumps(described | {"outputs": ["../outside"]})

    rewrite(store, lead_out)
    before = contents(tmp_path)
    for way in (lambda: sp.open_sweep(store), lambda: sp.sweep(**REQUEST, store=store)):
        with pytest.raises(StoreError, match="damaged manifest or axes"):
            way()
    assert contents(tmp_path) == before


def test_what_is_not_a_store(tmp_path):
    with pytest.raises(StoreError, match="not the store of a sweep"):
        sp.open_sweep(tmp_path)
    (tmp_path / "data.txt").write_text("mine")
    with pytest.raises(StoreError, match="other things in it"):
        sp.sweep(**REQUEST, store=tmp_path)
    with pytest.raises(StoreError, match="is a file"):
        sp.sweep(**REQUEST, store=tmp_path / "data.txt")
    xr.Dataset({"x": ("n", [1.0])}).to_zarr(tmp_path / "other", zarr_format=3, consolidated=False)
    for way in (sp.open_sweep, lambda store: sp.sweep(**REQUEST, store=store)):
        with pytest.raises(StoreError, match="other: not a sweep"):
            way(tmp_path / "other")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "manifest.json").write_text("{}")
    for way in (sp.open_sweep, lambda store: sp.sweep(**REQUEST, store=store)):
        with pytest.raises(
            StoreError, match=r"old: a store of slippulse_jax 0.1 \(.npz files\), which only that version reads"
        ):
            way(tmp_path / "old")


@pytest.mark.ci
def test_killed_while_the_store_was_made(reference, tmp_path, monkeypatch):
    """What is there of a store without a manifest is made again; results without one are nobody's."""
    put, calls = stores.write_atomically, iter(range(100))

    def killed(*arguments):
        if next(calls) == 3:
            raise KeyboardInterrupt
        put(*arguments)

    monkeypatch.setattr(stores, "write_atomically", killed)
    with pytest.raises(KeyboardInterrupt):
        sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK)
    monkeypatch.undo()
    with pytest.raises(StoreError, match="not the store of a sweep"):
        sp.open_sweep(tmp_path / "s")
    sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK)
    assert contents(tmp_path / "s") == contents(reference)
    (tmp_path / "s" / "zarr.json").unlink()
    with pytest.raises(StoreError, match=r"left of a store whose zarr.json is missing"):
        sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK)


@pytest.mark.ci
def test_shares_together_are_the_whole(reference, tmp_path):
    for index in (2, 0, 1):
        part = sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK, share=(index, 3))
        assert part.attrs["complete"] == (index == 1)
    assert contents(tmp_path / "s") == contents(reference)


@pytest.mark.slow
def test_two_writers_of_one_store(reference, tmp_path):
    """They share the work without knowing of each other, and seldom compute the same chunk."""
    store = tmp_path / "s"
    sp.sweep(**REQUEST, store=store, chunk=CHUNK, share=(0, CHUNKS))  # made
    report = (
        "from slippulse_jax.sweeps import run\n"
        "evaluate, calls = run.evaluate, []\n"
        "run.evaluate = lambda *a: (calls.append(a), __import__('time').sleep(0.005), evaluate(*a))[2]\n"
    )
    writers = [child(store, before=report, after="print(len(calls))\n") for _ in range(2)]
    counts = []
    for writer in writers:
        out, err = writer.communicate(timeout=120)
        assert writer.returncode == 0, err
        counts.append(int(out))
    assert contents(store) == contents(reference)
    assert CHUNKS - 1 <= sum(counts) <= 1.15 * CHUNKS, counts
