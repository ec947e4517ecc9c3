"""Stored sweeps: throughput beside the batch in memory, memory against size, and the time to open and draw one.

Lengths over 1000 stiffnesses, 100 Poisson's ratios and as many heights as the number of points asks for. Prints the table of
docs/tables/sweeps.md. Run: python -m benchmarks sweeps [points of the largest sweep, 1e8 by default]
"""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import slippulse_jax as sp
from benchmarks.timing import side_by_side

SMALLEST = "1e5"

BATCH, PLANES, TURNS = 10**7, 10, 5
"""Points of the comparison with the batch; heights of the sweep that is drawn; runs in turns."""

ALONE = """
import sys, threading, time
from pathlib import Path
from benchmarks.sweeps import request
import slippulse_jax as sp

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20

sp.sweep(**request(10**6))
before, most, done = resident(), [0], []

def watch():
    while not done:
        most[0] = max(most[0], resident())
        time.sleep(0.02)

watching = threading.Thread(target=watch)
watching.start()
began = time.perf_counter()
sp.sweep(**request(int(sys.argv[1])), store=sys.argv[2])
taken = time.perf_counter() - began
done.append(True)
watching.join()
print(taken, before, most[0])
"""
"""A process that stores a sweep: time in s, memory before and at most in MiB."""


def request(points: int) -> dict:
    """A sweep of so many points, a multiple of 10⁵."""
    return {
        "height": np.linspace(10, 50, points // 10**5), "stiffness": np.geomspace(1e-3, 0.1, 1000),
        "poisson": np.linspace(0.1, 0.45, 100), "outputs": "length", "progress": False,
    }  # fmt: skip


def throughput(points: int, folder: Path) -> str:
    """Rows with the time of a sweep, in memory and stored, over that of the batch."""
    given = request(points)
    grid = np.meshgrid(given["height"], given["stiffness"], given["poisson"], indexing="ij")
    slider = sp.Slider(*(axis.ravel() for axis in grid))

    def stored() -> None:
        shutil.rmtree(folder / "s", ignore_errors=True)
        sp.sweep(**given, store=folder / "s")

    took = side_by_side(
        {
            "`precursor_lengths`, a batch in memory": lambda: sp.precursor_lengths(slider),
            "`sweep` in memory": lambda: sp.sweep(**given),
            "`sweep` with a store": stored,
            "the same, resumed when complete": lambda: sp.sweep(**given, store=folder / "s"),
        },
        TURNS,
    )
    first = next(iter(took.values()))
    return "\n".join(f"| {name} | {first / taken:.2f} |" for name, taken in took.items())


def alone(points: int, folder: Path) -> str:
    """Row of a sweep stored by a process of its own."""
    code = [sys.executable, "-c", ALONE, str(points), str(folder / f"{points}")]
    done = subprocess.run(code, capture_output=True, text=True, check=True)
    taken, before, most = map(float, done.stdout.split())
    shutil.rmtree(folder / f"{points}")
    return f"| {powers(points)} | {points / taken / 1e6:.1f} | {before:.0f} | {most:.0f} |"


def powers(points: int) -> str:
    """10⁸ for 100000000."""
    power = round(np.log10(points))
    return "10" + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(digit)] for digit in str(power)) if points == 10**power else f"{points:.2g}"


def drawn(folder: Path) -> tuple[float, float]:
    """Seconds to open a stored sweep of a million points, and to draw a plane of it."""
    sp.sweep(**request(PLANES * 10**5), store=folder / "plane", chunk=1 << 14)
    opening, drawing = [], []
    for _ in range(TURNS):
        began = time.perf_counter()
        found = sp.open_sweep(folder / "plane")
        opening.append(time.perf_counter() - began)
        figure = Figure()
        sp.plot.sweep(found.sel(height=50), ax=figure.subplots())
        figure.savefig(folder / "plane.png")
        drawing.append(time.perf_counter() - began - opening[-1])
    return min(opening), min(drawing)


if __name__ == "__main__":
    most = int(float(sys.argv[1])) if len(sys.argv) > 1 else 10**8
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print("| | points per second, over the batch |\n|---|---|")
        print(throughput(min(BATCH, most), folder))
        print("\n| points | 10⁶ points per second | MiB before | MiB at most |\n|---|---|---|---|")
        for points in sorted({min(10**7, most), most}):
            print(alone(points, folder))
        opening, drawing = drawn(folder)
        print(f"\nA stored sweep of 10⁶ points opens in {opening:.3f} s, and a plane of it is drawn in {drawing:.2f} s.")
