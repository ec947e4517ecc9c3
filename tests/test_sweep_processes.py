"""Sweeps shared by devices and by processes: the union is, to the last bit, what one process on one device computes."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import slippulse_jax as sp

ROOT = Path(__file__).resolve().parent.parent
REQUEST = "height=np.linspace(10, 50, 40), stiffness=np.geomspace(1e-3, 0.1, 30), poisson=np.linspace(0.2, 0.35, 4)"
OUTPUTS = "outputs=('length', 'length_envelope')"


def contents(store):
    return {path.relative_to(store).as_posix(): path.read_bytes() for path in sorted(store.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    store = tmp_path_factory.mktemp("sweep") / "reference"
    exec(f"sp.sweep({REQUEST}, {OUTPUTS}, store=store, chunk=100)", {"np": np, "sp": sp, "store": store})
    return store


# a process that is killed could leave a half-written program for the others
ALONE = {"JAX_ENABLE_COMPILATION_CACHE": "0"}


def child(code, **environment):
    return subprocess.Popen(
        [sys.executable, "-c", "import numpy as np, jax, slippulse_jax as sp\n" + code],
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT), "XLA_FLAGS": ""} | environment,  # compiled as users' programs are
    )  # fmt: skip


def members(store, count, chunk=100, **environment):
    """Processes of one job, as a launcher would start them."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{probe.getsockname()[1]}"
    return [
        child(
            f"jax.distributed.initialize('{address}', {count}, {index})\n"
            f"found = sp.sweep({REQUEST}, {OUTPUTS}, store={str(store)!r}, chunk={chunk})\n"
            "assert found.attrs['complete'] and np.isfinite(found.length).all()\n",
            **environment,
        )
        for index in range(count)
    ]


def finish(processes):
    for process in processes:
        _, err = process.communicate(timeout=120)
        assert process.returncode == 0, err


@pytest.mark.slow  # the test of a killed process has two of them share a sweep
@pytest.mark.parametrize("count", [2, 4])
def test_processes_share_a_sweep(reference, tmp_path, count):
    store = tmp_path / "s"
    finish(members(store, count))
    assert contents(store) == contents(reference)


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_one_process_is_killed_and_the_job_resumed(reference, tmp_path, count):
    store = tmp_path / "s"
    *others, last = members(store, count, **ALONE)
    while last.poll() is None and len(list((store / "chunks").glob("*.npz"))) < 10:
        time.sleep(0.002)
    last.kill()
    time.sleep(0.2)
    for process in others:  # they would wait until jax.distributed misses the dead one: end them as a launcher does
        process.kill()
        process.communicate()
    last.communicate()
    assert len(list((store / "chunks").glob("*.npz"))) < 48, "killed while it ran"
    finish(members(store, count))
    assert contents(store) == contents(reference)


def test_the_tasks_of_a_slurm_job_find_each_other(reference, tmp_path):
    """The command line under the variables that srun sets for two tasks on this machine."""
    store = tmp_path / "s"
    arguments = [
        "--height", "10:50:40", "--stiffness", "1e-3:0.1:30:log", "--poisson", "0.2:0.35:4", "--outputs", "length,length_envelope",
        "--store", str(store), "--chunk", "100", "--distributed",
    ]  # fmt: skip
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    slurm = {
        "SLURM_JOB_ID": "7", "SLURM_STEP_NODELIST": "localhost", "SLURM_NTASKS": "2", "SLURM_STEP_NUM_TASKS": "2",
        "JAX_COORDINATOR_ADDRESS": f"localhost:{port}",  # the port by itself follows from the number of the job
    }  # fmt: skip
    code = f"import sys; sys.argv = ['slippulse', 'sweep', *{arguments}]\nfrom slippulse_jax.cli.main import main\nmain()"
    finish([child(code, **slurm, SLURM_PROCID=str(index), SLURM_LOCALID=str(index)) for index in range(2)])
    together = sp.open_sweep(store)
    assert together.attrs["complete"] == 1
    np.testing.assert_array_equal(together.length, sp.open_sweep(reference).length)


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_local_devices_share_a_sweep(reference, tmp_path, count):
    """In pieces small enough that every device gets some."""
    store = tmp_path / "s"
    code = (
        f"assert jax.local_device_count() == {count}\n"
        "from slippulse_jax.bulk import chunks\n"
        "from slippulse_jax.lattice import lengths\n"
        "from slippulse_jax.sweeps import outputs\n"
        "lengths.LENGTHS, chunks.PIECE, outputs.BLOCK = chunks.Layout(chunk=64), 64, 64\n"
        f"sp.sweep({REQUEST}, {OUTPUTS}, store={str(store)!r}, chunk=1000)\n"
        f"sp.sweep({REQUEST}, {OUTPUTS}, store={str(store)!r} + '1', chunk=100)\n"
    )
    finish([child(code, XLA_FLAGS=f"--xla_force_host_platform_device_count={count}")])
    assert contents(tmp_path / "s1") == contents(reference)
    np.testing.assert_array_equal(sp.open_sweep(store).length, sp.open_sweep(reference).length)
    np.testing.assert_array_equal(sp.open_sweep(store).length_envelope, sp.open_sweep(reference).length_envelope)


def test_without_a_store_there_is_nothing_to_share(monkeypatch):
    monkeypatch.setattr("jax.process_count", lambda: 2)
    with pytest.raises(ValueError, match="2 processes share this sweep: give it a store"):
        sp.sweep(height=25.0, stiffness=0.03, poisson=0.3)
