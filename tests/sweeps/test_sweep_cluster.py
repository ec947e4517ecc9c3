"""Sweeps shared by devices and by the workers of a Dask cluster: what one process on one device computes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from stores import contents, reference_of, written

import slippulse_jax as sp
from slippulse_jax.cli.main import slippulse
from slippulse_jax.sweeps import dataset, run

dask = pytest.importorskip("dask")  # of the extra ci; tests/project/test_project.py fails where CI lacks it
Client, LocalCluster, WorkerPlugin = (
    getattr(pytest.importorskip("distributed"), name) for name in ("Client", "LocalCluster", "WorkerPlugin")
)

pytestmark = pytest.mark.ci

ROOT = Path(__file__).resolve().parents[2]
GRID = "height=np.linspace(10, 50, 40), stiffness=np.geomspace(1e-3, 0.1, 30), poisson=np.linspace(0.2, 0.35, 4)"
OUTPUTS = "outputs=('length', 'length_envelope')"
REQUEST = eval(f"dict({GRID}, {OUTPUTS})", {"np": np, "dict": dict})
CHUNK, CHUNKS = 100, 80  # of 15 × 4 points

reference = reference_of(REQUEST, CHUNK)


class Counted(WorkerPlugin):
    """Notes every region that a worker computes, in a file, and takes its time over it."""

    def __init__(self, log, pause):
        self.log, self.pause = log, pause

    def setup(self, worker):
        evaluate = run.evaluate

        def counted(request, region):
            with open(self.log, "a") as file:
                file.write(f"{region}\n")
            time.sleep(self.pause)
            return evaluate(request, region)

        run.evaluate = counted


def cluster(workers, threads=1):
    return LocalCluster(n_workers=workers, threads_per_worker=threads, dashboard_address="127.0.0.1:0", host="127.0.0.1")


@pytest.fixture(scope="module")
def two_workers():
    with cluster(2) as found:
        yield found


@pytest.fixture
def client(two_workers):
    with Client(two_workers) as found:
        yield found


@pytest.mark.parametrize(("workers", "threads"), [pytest.param(n, t, marks=pytest.mark.slow) for n, t in [(1, 3), (4, 1)]])
def test_any_number_of_workers(reference, tmp_path, workers, threads):
    with cluster(workers, threads) as found, Client(found) as client:
        sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK, client=client)
        assert contents(tmp_path / "s") == contents(reference)
        xr.testing.assert_equal(sp.sweep(**REQUEST, client=client), sp.open_sweep(reference).load())


def test_workers_write_the_store_and_return_values(reference, tmp_path, client):
    store = tmp_path / "s"
    found = sp.sweep(**REQUEST, store=store, chunk=CHUNK, client=client)
    assert found.attrs["complete"] == 1
    assert contents(store) == contents(reference)
    bad = bytearray((store / "length/c/3/0/0").read_bytes())
    bad[9] ^= 1
    (store / "length/c/3/0/0").write_bytes(bytes(bad))
    (store / "length_envelope/c/7/1/0").unlink()
    with pytest.warns(RuntimeWarning, match="damaged chunk length/c/3/0/0 .*: computing it again"):
        sp.sweep(**REQUEST, store=store, client=client)
    assert contents(store) == contents(reference)
    in_memory = sp.sweep(**REQUEST)
    assert sp.sweep(**REQUEST, client=client).identical(in_memory)
    one = {"height": 25.0, "stiffness": 0.03, "poisson": 0.3}
    assert sp.sweep(**one, client=client).identical(sp.sweep(**one))


def test_only_what_is_needed_is_computed_lazily(reference, client, monkeypatch):
    """With the workers of a client, and without."""
    exact = sp.open_sweep(reference).load()
    lazy = sp.sweep(**REQUEST, lazy=True, chunk=CHUNK)
    assert dict(lazy.length.chunksizes) == {"height": (1,) * 40, "stiffness": (15, 15), "poisson": (4,)}
    xr.testing.assert_equal(lazy.compute(), exact)  # on the workers
    regions, evaluate = [], run.evaluate
    monkeypatch.setattr("slippulse_jax.sweeps.run.evaluate", lambda *a: (regions.append(a), evaluate(*a))[1])
    mean = lazy.length.sel(height=[10, 50]).isel(stiffness=slice(0, 3)).mean("poisson").compute(scheduler="threads")
    xr.testing.assert_allclose(mean, exact.length.sel(height=[10, 50]).isel(stiffness=slice(0, 3)).mean("poisson"), rtol=1e-15)
    assert len(regions) == 2
    assert {request.outputs for request, _ in regions} == {("length",)}, "and no output that is not wanted"


def test_a_fit_is_a_task_too(client):
    """It comes back from a worker as it is computed here."""
    heights = np.array([60.0, 100.0, 200.0])
    lengths = np.asarray(sp.exact_lengths(sp.Slider(heights, 0.1, 0.3)))
    table = sp.Measurements(height=heights, poisson=0.3, length=lengths, length_sigma=0.02 * lengths)
    assert str(client.submit(sp.fit, table).result()) == str(sp.fit(table))


@pytest.mark.slow
def test_worker_of_another_processor(reference, tmp_path, client):
    """It computes its chunks, and one warning names both processors."""
    _, second = client.scheduler_info()["workers"]

    def disguised():
        dataset.processor = lambda: "abacus"

    sp.sweep(**REQUEST, store=tmp_path / "s", chunk=CHUNK, share=(0, 2))
    try:
        client.run(disguised, workers=[second])
        with pytest.warns(RuntimeWarning, match=f"begun on {dataset.processor()}, .* and resumed on abacus, ") as caught:
            sp.sweep(**REQUEST, store=tmp_path / "s", client=client)
    finally:
        client.restart()
    assert len(caught) == 1
    assert contents(tmp_path / "s") == contents(reference)


@pytest.mark.parametrize("kills", [2, pytest.param(50, marks=pytest.mark.slow)])
def test_workers_are_killed(reference, tmp_path, kills):
    """Dask starts them anew and gives their chunks to others; nothing is computed twice but what was cut off."""
    rng = np.random.default_rng(kills)
    # on a busy machine a worker may take longer to start anew than the 15 s after which Dask gives it up
    patient = dask.config.set({"distributed.deploy.lost-worker-timeout": "10 minutes"})
    with patient, cluster(2 if kills < 10 else 4) as found, Client(found) as client:
        found.scheduler.allowed_failures = 100  # of tasks on lost workers; 50 kills in a few seconds are no cluster's usual day
        client.register_plugin(Counted(tmp_path / "log", 0.5 if kills > 10 else 0.05))
        killed = 0
        store = tmp_path / "s"
        script = sweeping(found.scheduler_address, store)
        while script.poll() is None and killed < kills:
            enough, began = written(store, "length_envelope") + 1, time.monotonic()
            while script.poll() is None and written(store, "length_envelope") < enough:
                assert time.monotonic() - began < 120, f"nothing written after {killed} kills"
                time.sleep(0.005)
            time.sleep(rng.uniform(0, 0.05))
            workers = [nanny for nanny in found.workers.values() if nanny.pid]
            if workers and script.poll() is None:
                os.kill(workers[rng.integers(len(workers))].pid, signal.SIGKILL)
                killed += 1
        _, err = script.communicate(timeout=300)
        assert script.returncode == 0, err
    assert contents(store) == contents(reference)
    assert killed >= 0.8 * kills
    computed = len((tmp_path / "log").read_text().splitlines())
    assert CHUNKS <= computed <= CHUNKS + killed, "nothing twice but what was cut off"
    print(f"{killed} kills; {computed} computations of {CHUNKS} chunks")


def sweeping(address, store):
    """A process that runs the sweep on a cluster."""
    code = (
        "import numpy as np, slippulse_jax as sp\nfrom distributed import Client\n"
        f"with Client({address!r}) as client:\n"
        f"    sp.sweep({GRID}, {OUTPUTS}, store={str(store)!r}, chunk={CHUNK}, client=client)\n"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip


@pytest.mark.slow
def test_client_is_killed_and_the_sweep_resumed(reference, tmp_path, client, two_workers):
    store = tmp_path / "s"
    client.register_plugin(Counted(tmp_path / "log", 0.05), name="counted")
    with sweeping(two_workers.scheduler_address, store) as script:
        while script.poll() is None and written(store, "length_envelope") < 10:
            time.sleep(0.005)
        script.kill()
        script.communicate()
    assert written(store, "length_envelope") < CHUNKS, "killed while it ran"
    sp.sweep(**REQUEST, store=store, client=client)
    assert contents(store) == contents(reference)
    assert len((tmp_path / "log").read_text().splitlines()) <= CHUNKS + 2
    client.restart()


def test_command_with_a_scheduler(reference, tmp_path, two_workers):
    axes = ["--height", "10:50:40", "--stiffness", "1e-3:0.1:30:log", "--poisson", "0.2:0.35:4"]
    arguments = ["sweep", *axes, "--outputs", "length,length_envelope", "--scheduler", two_workers.scheduler_address]
    done = CliRunner().invoke(slippulse, [*arguments, "--store", str(tmp_path / "s"), "--chunk", "100"])
    assert done.exit_code == 0, done.output
    xr.testing.assert_equal(sp.open_sweep(tmp_path / "s").load(), sp.open_sweep(reference).load())


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_local_devices_share_a_sweep(reference, tmp_path, count):
    """In pieces small enough that every device gets some."""
    store = tmp_path / "s"
    code = (
        "import jax, numpy as np, slippulse_jax as sp\n"
        f"assert jax.local_device_count() == {count}\n"
        "from slippulse_jax.bulk import chunks\n"
        "from slippulse_jax import lengths\n"
        "lengths.LENGTHS, chunks.PIECE = chunks.Layout(chunk=64), 4\n"
        f"sp.sweep({GRID}, {OUTPUTS}, store={str(store)!r}, chunk=1000)\n"
        f"sp.sweep({GRID}, {OUTPUTS}, store={str(store)!r} + '1', chunk={CHUNK})\n"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT), "XLA_FLAGS": f"--xla_force_host_platform_device_count={count}"}
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, env=environment)
    assert contents(tmp_path / "s1") == contents(reference)
    xr.testing.assert_equal(sp.open_sweep(store).load(), sp.open_sweep(reference).load())
