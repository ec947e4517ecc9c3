"""``slippulse sweep`` as a person or a script meets it."""

import csv
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import slippulse_jax as sp
from slippulse_jax.cli.main import slippulse
from slippulse_jax.sweeps import run
from slippulse_jax.sweeps.outputs import OUTPUTS, SETS

ROOT = Path(__file__).resolve().parents[2]
GRID = ["--height", "10:50:5", "--stiffness", "1e-3:0.1:3:log", "--poisson", "0.3"]
FIG2 = sp.Slider(25.0, 0.03, 0.3)
SAME = {"height": np.linspace(10, 50, 5), "stiffness": np.geomspace(1e-3, 0.1, 3), "poisson": 0.3}


def invoke(*arguments):
    return CliRunner().invoke(slippulse, ["sweep", *arguments])


@pytest.mark.ci
def test_csv_and_json_on_stdout():
    exact = sp.sweep(**SAME)
    done = invoke(*GRID)
    assert (done.exit_code, done.stderr) == (0, "")
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    assert list(rows[0]) == ["height", "stiffness", "length", "status"]
    np.testing.assert_array_equal([float(row["length"]) for row in rows], exact.length.values.ravel())
    np.testing.assert_array_equal([float(row["stiffness"]) for row in rows[:3]], SAME["stiffness"])
    content = json.loads(invoke(*GRID, "--json").stdout)
    assert content["dims"] == ["height", "stiffness"]
    assert content["data"]["length"] == exact.length.values.tolist()
    assert content["units"]["length"] == "lambda_c"


@pytest.mark.ci
def test_a_front_that_never_stops_is_null_in_json():
    done = invoke("--height", "25", "--stiffness", "0.03", "--poisson", "0.3", "--prestress", "0.1,0.54", "--json")
    assert json.loads(done.stdout)["data"]["length"][1] is None
    one = invoke("--height", "25", "--stiffness", "0.03", "--poisson", "0.3", "--outputs", "length")
    assert one.stdout.split() == ["length", str(float(sp.precursor_lengths(sp.Slider(25.0, 0.03, 0.3))))]


@pytest.mark.ci
def test_what_contacts_keep():
    done = invoke("--height", "25", "--stiffness", "0.03", "--poisson", "0.3", "--residual-strength", "0,0.3",
                  "--outputs", "length,dlength_dresidual_strength")  # fmt: skip
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    for row, r in zip(rows, (0.0, 0.3), strict=True):
        length, slope = jax.value_and_grad(lambda r: sp.precursor_length(FIG2, sp.Interface(residual_strength=r)))(r)
        assert float(row["residual_strength"]) == r
        assert float(row["length"]) == pytest.approx(float(length), abs=1e-10)
        assert float(row["dlength_dresidual_strength"]) == pytest.approx(float(slope), rel=1e-8)


@pytest.mark.ci
def test_files(tmp_path):
    done = invoke(*GRID, "--out", str(tmp_path / "sweep.nc"), "--figure", str(tmp_path / "sweep.svg"))
    assert done.exit_code == 0
    assert "15 points (height 5 × stiffness 3)" in done.stdout
    assert re.search(r"^status +(arrested \d+|no_domino \d+)", done.stdout, flags=re.M)
    xr.testing.assert_identical(xr.load_dataset(tmp_path / "sweep.nc", engine="h5netcdf"), sp.sweep(**SAME))
    assert (tmp_path / "sweep.svg").read_bytes().startswith(b"<?xml")
    assert invoke(*GRID, "--out", str(tmp_path / "sweep.csv")).exit_code == 0
    assert len((tmp_path / "sweep.csv").read_text().splitlines()) == 16


def test_help_names_every_output():
    shown = invoke("--help").stdout
    names = set(OUTPUTS) - set(SETS["gradients"]) | set(SETS)
    assert names <= set(re.findall(r"\w+", shown))


@pytest.mark.parametrize("chunk", [(), ("--chunk", "4")])
def test_share_is_done_then_the_whole(tmp_path, chunk):
    """A job array calls a task that has done its part finished; the whole, as a file, is not there yet."""
    store = str(tmp_path / "s")
    done = invoke(*GRID, "--store", store, *chunk, "--share", "0/2", "--json")
    assert done.exit_code == 0
    assert done.stderr == f"share 0/2 is done; other shares of {store} are not there yet\n"
    assert json.loads(done.stdout)["complete"] is False
    done = invoke(*GRID, "--store", store, *chunk, "--share", "0/2", "--out", str(tmp_path / "whole.csv"))
    assert done.exit_code == 4
    assert not (tmp_path / "whole.csv").exists()
    done = invoke(*GRID, "--store", store, "--no-resume")
    assert done.exit_code == 2
    assert "holds a sweep already" in done.stderr
    done = invoke(*GRID, "--store", store, "--json")
    assert done.exit_code == 0
    content = json.loads(done.stdout)
    assert content["complete"] is True
    assert "data" not in content, "a store may hold more than anyone wants to see"
    exact = sp.sweep(**SAME).length
    assert content["ranges"]["length"] == [float(exact.min()), float(exact.max()), 0]
    xr.testing.assert_equal(sp.open_sweep(store).length.load(), exact)


@pytest.mark.ci
def test_another_processor_is_one_line_on_stderr(tmp_path):
    """The sweep is done all the same."""
    store = tmp_path / "s"
    sp.sweep(**SAME, outputs="length", store=store, chunk=4, share=(0, 2))
    about = json.loads((store / "zarr.json").read_bytes())
    about["attributes"]["processor"] = "abacus"
    (store / "zarr.json").write_text(json.dumps(about))
    command = [sys.executable, "-m", "slippulse_jax.cli.main", "sweep", *GRID, "--outputs", "length", "--store", str(store)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0
    warnings = [line for line in done.stderr.splitlines() if "sweep: " not in line]  # of tqdm
    assert len(warnings) == 1
    assert warnings[0].startswith(f"Warning: {store}: begun on abacus, ")


def test_full_disk_is_incomplete(tmp_path, full_disk):
    store = str(tmp_path / "s")
    sp.sweep(**SAME, store=store, chunk=4, share=(0, 2))
    full_disk(10)
    done = invoke(*GRID, "--store", store)
    assert done.exit_code == 4
    assert "File too large; what was computed is kept in" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    done = invoke(*GRID, "--store", str(tmp_path / "t"))
    assert (done.exit_code, len(done.stderr.splitlines())) == (2, 1)
    assert "no store can be made there" in done.stderr


def test_store_that_vanishes(tmp_path, monkeypatch):
    evaluate = run.evaluate
    monkeypatch.setattr(run, "evaluate", lambda *a: (shutil.rmtree(tmp_path / "s", ignore_errors=True), evaluate(*a))[1])
    done = invoke(*GRID, "--store", str(tmp_path / "s"), "--chunk", "4")
    assert done.exit_code == 2
    assert done.stderr == f"Error: {tmp_path}/s: the store was removed while the sweep ran\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--height", "10:50", *GRID[2:]], "'10:50' is not a number, a list a,b,c or a range first:last:count[:log]"),
        (["--height", "0:50:5:log", *GRID[2:]], "'0:50:5:log': even steps of the logarithm need both ends above 0"),
        (["--height", "10:50:0", *GRID[2:]], "'10:50:0' is not"),
        (["--height", "tall", *GRID[2:]], "'tall' is not"),
        (["--height", "0.5", *GRID[2:]], "Slider.height = 0.5: must exceed 1"),
        ([*GRID, "--outputs", "len"], "output 'len': must be one of length,"),
        ([*GRID, "--chunk", "4"], "go with --store"),
        ([*GRID, "--share", "0/2"], "go with --store"),
        pytest.param([*GRID, "--scheduler", "127.0.0.1:1"], "no Dask scheduler answers at 127.0.0.1:1", marks=pytest.mark.ci),
        ([*GRID, "--scheduler", "s", "--store", "s", "--share", "0/2"], "--share is for processes without a scheduler"),
        ([*GRID, "--store", "s4://bucket/s"], "s4://bucket/s: Protocol not known: s4"),
        ([*GRID, "--store", "s", "--share", "half"], "'half' is not index/number"),
        ([*GRID, "--out", "sweep.xlsx"], "must end in .csv, .nc"),
        ([*GRID, "--out", "no/such/folder/sweep.nc"], "there is no folder no/such/folder"),
        (["--height", "10", *GRID[4:]], "Missing option '--stiffness'"),
        (
            [*GRID[:5], "0.2,0.3", "--figure", "s.png"],
            "such as --poisson 0.2; or write --out FILE.nc and draw "
            'sp.plot.sweep(xarray.open_dataset("FILE.nc").sel(poisson=0.2)) in Python',
        ),
        ([*GRID[:5], "0.2,0.3", "--store", "s", "--figure", "s.png"], 'sp.plot.sweep(sp.open_sweep("s").sel(poisson=0.2))'),
        ([*GRID, "--points", "--figure", "s.png"], "not 0 (none): leave out --points"),
        (["--height", "10", "--stiffness", "0.03", "--poisson", "0.3", "--figure", "s.png"], "such as --height 10:50:41"),
    ],
)
def test_bad_usage(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("slippulse_jax.sweeps.run.TIMEOUT", 1)
    done = invoke(*arguments)
    assert done.exit_code == 2
    assert message in done.stderr
    assert done.stdout == ""
    assert not list(tmp_path.iterdir())


@pytest.mark.ci
def test_interrupt_leaves_a_store_to_resume(tmp_path):
    """Ctrl-C: exit 130, a line on how to go on, and going on gives what an undisturbed run gives."""
    store = tmp_path / "s"
    arguments = [
        "--height",
        "10:50:60",
        "--stiffness",
        "1e-3:0.1:60:log",
        "--poisson",
        "0.3",
        "--outputs",
        "length",
        "--chunk",
        "4",
    ]
    # the signal is ignored where the tests run in the background
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from slippulse_jax.cli.main import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", code, "sweep", *arguments, "--store", str(store)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), "JAX_ENABLE_COMPILATION_CACHE": "0"},
    ) as process:  # fmt: skip
        while process.poll() is None and len(list((store / "length").rglob("c/*/*"))) < 5:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        err = process.stderr.read()
    assert process.returncode == 130
    assert "the same command resumes it" in err
    assert "Traceback" not in err
    assert sp.open_sweep(store).attrs["complete"] == 0
    assert invoke(*arguments, "--store", str(store)).exit_code == 0
    exact = sp.sweep(height=np.linspace(10, 50, 60), stiffness=np.geomspace(1e-3, 0.1, 60), poisson=0.3, outputs="length")
    xr.testing.assert_equal(sp.open_sweep(store).length.load(), exact.length)
