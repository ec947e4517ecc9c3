"""Every program of benchmarks/, at its smallest size."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from benchmarks.__main__ import PROGRAMS, smallest

ROOT = Path(__file__).resolve().parents[2]
QUICKEST = {"equilibrium", "sweeps"}
"""Of those that need no rival but SciPy."""


def written():
    """What benchmarks write, at the size that means something."""
    return {path: path.read_bytes() for path in [*ROOT.glob("benchmarks/*.json"), *ROOT.glob("docs/*/*.md")]}


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_benchmark_has_a_smallest_size(name):
    assert isinstance(smallest(name), list)


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.ci if one in QUICKEST else pytest.mark.slow) for one in PROGRAMS]
)
def test_a_benchmark_runs(name):
    """It prints numbers, and leaves the pages as they are."""
    if name not in QUICKEST:
        assert importlib.util.find_spec("numba") is not None, "install the extra bench"
    before = written()
    done = subprocess.run([sys.executable, "-m", "benchmarks", name, "--smallest"], cwd=ROOT, capture_output=True, text=True)
    if name == "gpu" and jax.default_backend() == "cpu":
        assert (done.returncode, done.stderr) == (1, "no GPU here that JAX can use\n")
        return
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert "nan" not in done.stdout
    assert written() == before
