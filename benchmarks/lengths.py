"""Lengths in bulk: prints ratios, and writes benchmarks/lengths.json, docs/appendix/benchmarks.md and a figure.

``python -m benchmarks lengths`` runs everything; ``python -m benchmarks lengths points heights`` some parts, the others being
taken from the file. Where other programs were running, the page says so. With ``--most N`` batches are no larger, and nothing is
written.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np

from benchmarks import rivals
from benchmarks.timing import in_turns, side_by_side
from slippulse_jax import Slider, precursor_length, precursor_lengths
from slippulse_jax.bulk import chunks
from slippulse_jax.front import lanes
from slippulse_jax.lengths import LENGTHS

SMALLEST = "--most 1000"

HERE = Path(__file__).resolve().parent
RESULTS, PAGE, FIGURE = (
    HERE / "lengths.json",
    HERE.parent / "docs" / "appendix" / "benchmarks.md",
    HERE.parent / "docs" / "pictures" / "benchmarks.png",
)
GRADIENTS = "this package, with all three derivatives"
POINTS, FEW, MAX_CONTACTS = 200_000, 50, 10_000_000


def random_points(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """H/λc uniform 10–50, k/K log-uniform 1e-3–0.03, ν uniform 0.1–0.45."""
    rng = np.random.default_rng(0)
    return rng.uniform(10, 50, count), 10 ** rng.uniform(-3, np.log10(0.03), count), rng.uniform(0.1, 0.45, count)


def long_fronts(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """H/λc log-uniform in 10⁴–10⁵, b log-uniform in 0.2–5, ν uniform in 0–0.5."""
    rng = np.random.default_rng(1)
    height, b = 10 ** rng.uniform(4, 5, count), np.exp(rng.uniform(np.log(0.2), np.log(5), count))
    nu = rng.uniform(0, 0.5, count)
    return height, b / (2 * (1 + nu) * height), nu


def points(most: int) -> dict:
    """200 000 random points by every means there is."""
    count = min(POINTS, most)
    given = random_points(count)
    slider, out = Slider(*given), np.empty(count)
    length = precursor_lengths(slider)
    few = list(zip(*(x[:FEW] for x in given), strict=True))
    taken = in_turns(
        {
            "this package": lambda: precursor_lengths(slider),
            "numba, all cores": lambda: rivals.parallel(*given, out),
            "numba, one core": lambda: rivals.serial(*given, out),
            GRADIENTS: lambda: precursor_lengths(slider, derivatives=1),
        },
        12,
    )
    times, medians = ({name: float(pick(t)) for name, t in taken.items()} for pick in (min, np.median))
    difference = float(np.abs(length - out).max())
    with jax.enable_x64(True):
        vmapped = jax.jit(precursor_length)
        times |= side_by_side({"plain vmap of `precursor_length`": lambda: vmapped(slider).block_until_ready()}, 2)
    times |= {
        name: seconds * count / FEW
        for name, seconds in side_by_side(
            {
                "SciPy, a banded solve per break": lambda: [rivals.banded(*point) for point in few],
                "NumPy, a dense solve per break": lambda: [rivals.dense(*point) for point in few[:5] * (FEW // 50)],
            },
            1,
        ).items()
    }
    times["NumPy, a dense solve per break"] *= FEW / 5
    return {"seconds": times, "medians": medians, "difference from numba": difference, "mean length": float(length.mean())}


def heights(most: int) -> dict:
    """Cost of one point against H/λc: by the recursion, and as the batch takes it; k/K = 1/(2.6 H/λc), so that b = 1."""
    found: dict = {"height": [], "contacts": [], "recursion": [], "batch": []}
    for height in [x for x in np.geomspace(1e2, 1e6, 5) if x <= max(most, 1e4)]:
        q = 1 / (2.6 * height)
        one, n, batch = np.array([[height], [q], [0.3]]), 64, min(2048, most)

        def recursion(one: np.ndarray = one, n: int = n) -> object:
            return chunks.over_lanes(lanes.length_kernel(MAX_CONTACTS), np.repeat(one, n, axis=1), LENGTHS)

        many = Slider(np.full(batch, height), np.full(batch, q), np.full(batch, 0.3))
        taken = side_by_side({"recursion": recursion}, 1 if height > 1e5 else 3)
        taken |= side_by_side({"batch": lambda many=many: precursor_lengths(many)}, 2)
        found["height"].append(float(height))
        found["contacts"].append(float(precursor_lengths(Slider(height, q, 0.3))))
        found["recursion"].append(taken["recursion"] / n)
        found["batch"].append(taken["batch"] / batch)
    slope = np.polyfit(np.log(found["contacts"][1:]), np.log(found["recursion"][1:]), 1)[0]
    return found | {"slope of the recursion": float(slope)}


def counts(most: int) -> dict:
    """Cost against the number of points, 1 to 10⁷: with all threads there are, and with one."""
    found: dict = {"points": [], "seconds": [], "one thread": []}
    cores = os.sched_getaffinity(0)

    def alone(slider: Slider) -> None:
        os.sched_setaffinity(0, {min(cores)})  # of this thread: the package takes no more threads than it may use cores
        precursor_lengths(slider)
        os.sched_setaffinity(0, cores)

    for count in [10**power for power in range(8) if 10**power <= most]:
        slider = Slider(*random_points(count))
        both = {"seconds": lambda slider=slider: precursor_lengths(slider), "one thread": lambda slider=slider: alone(slider)}
        found["points"].append(int(count))
        for name, taken in side_by_side(both, int(np.clip(10**7 // count, 3, 100))).items():
            found[name].append(taken)
    return found


def tall(most: int) -> dict:
    """Points of H/λc = 10⁵ beside the recursion in numba on all cores; 20 000 and 200 of them, scaled to a million."""
    rng = np.random.default_rng(1)
    n, few = min(20_000, most), min(200, most)
    q, nu = 10 ** rng.uniform(-6, -2, n), rng.uniform(0.1, 0.45, n)
    slider, out = Slider(np.full(n, 1e5), q, nu), np.empty(few)
    taken = side_by_side({"this package": lambda: precursor_lengths(slider)}, 2)
    taken |= side_by_side({"numba, all cores": lambda: rivals.parallel(np.full(few, 1e5), q[:few], nu[:few], out)}, 2)
    return {"this package": taken["this package"] * 1e6 / n, "numba, all cores": taken["numba, all cores"] * 1e6 / few}


def start(_: int) -> dict:
    """A new process: to the first length, to 200 000, again; and its memory at the end."""
    code = (
        "import time; began = time.perf_counter()\n"
        "import numpy as np, slippulse_jax as sp\n"
        "sp.precursor_lengths(sp.Slider(25.0, 0.03, 0.3)); first = time.perf_counter() - began\n"
        "h = np.linspace(10, 50, 200_000); began = time.perf_counter()\n"
        "sp.precursor_lengths(sp.Slider(h, 0.01, 0.3)); cold = time.perf_counter() - began; began = time.perf_counter()\n"
        "sp.precursor_lengths(sp.Slider(h, 0.01, 0.3)); warm = time.perf_counter() - began\n"
        # (what getrusage gives counts the process that started this one)
        "peak = next(x for x in open('/proc/self/status') if x.startswith('VmHWM'))\n"
        "print(first, cold, warm, int(peak.split()[1]) / 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=HERE.parent)
    names = (
        "import and first length, s",
        "200 000 points, compilation included, s",
        "200 000 points again, s",
        "memory at most, MiB",
    )
    return dict(zip(names, map(float, done.stdout.split()), strict=True))


PARTS = {"points": points, "heights": heights, "counts": counts, "tall": tall, "start": start}


def page(found: dict) -> str:
    """The page of the documentation."""
    seconds = found["points"]["seconds"]
    ours = seconds["this package"]
    lines = [
        "# Benchmarks", "",
        "This page shows how fast lengths are computed in bulk. It is for readers who plan large scans.", "",
        "Written by `python -m benchmarks lengths`; every number of a table is from one run. "
        f"Machine: {found['machine']}.{found['remark']}", "",
        "## 200 000 random points", "",
        "H/λc uniform in 10–50, k/K log-uniform in 10⁻³–0.03, ν uniform in 0.1–0.45, unsorted; sorting counts. "
        f"Mean length {found['points']['mean length']:.1f} λc; largest difference from numba "
        f"{found['points']['difference from numba']:.0e} λc. The two solvers are timed on a few points and scaled.", "",
        "Shortest of 12 runs in turns, and their median in brackets.", "",
        "| | points/s | time over ours |", "|---|---|---|",
        *(_row(name, found["points"]) for name in seconds), "",
        *_gradients(seconds[GRADIENTS] / ours),
        *_heights(found),
        "## Cost against the number of points", "", "Shortest of 3 to 100 runs.", "",
        "| points | s | µs per point | µs per point, one thread |", "|---|---|---|---|",
        *(f"| {n} | {t:.2g} | {1e6 * t / n:.3g} | {1e6 * o / n:.3g} |" for n, t, o in zip(*found["counts"].values(), strict=True)), "",
        *_flat(found["counts"]),
        *_start(found),
        "On a GPU: [Use a GPU](gpu.md).", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _row(name: str, points: dict) -> str:
    t, ours, median = points["seconds"][name], points["seconds"]["this package"], points["medians"].get(name)
    also = "" if median is None else f" ({POINTS / median:.3g})"
    return f"| {name} | {POINTS / t:.3g}{also} | {t / ours:.3g} |"


def _gradients(ratio: float) -> list[str]:
    return [
        f"The value with its three derivatives takes {ratio:.1f} times as long as the value. One loop over the lanes computes all "
        "four (`slippulse_jax.bulk.compiler.in_one_loop`). Every six breaks it reads and writes 38 numbers per lane, and 11 for "
        "the value alone.", "",
    ]  # fmt: skip


def _heights(found: dict) -> list[str]:
    if "heights" not in found or "tall" not in found:
        return []
    return [
        "## Cost of a point against its height", "", "At b = 1, ν = 0.3, in µs per point; the batch takes the series from some 8000 contacts on.", "",
        "| H/λc | contacts | recursion | batch |", "|---|---|---|---|",
        *(
            f"| {h:.0e} | {n:.0f} | {1e6 * r:.3g} | {1e6 * b:.3g} |"
            for h, n, r, b in zip(*(found["heights"][k] for k in ("height", "contacts", "recursion", "batch")), strict=True)
        ), "",
        f"Log–log slope of the recursion's cost against contacts, from the second row on: {found['heights']['slope of the recursion']:.2f}.",
        f"A million points at H/λc = 10⁵, k/K log-uniform in 10⁻⁶–10⁻²: {found['tall']['this package']:.1f} s; numba on all cores, "
        f"scaled from 200 points, {found['tall']['numba, all cores']:.0f} s "
        f"({found['tall']['numba, all cores'] / found['tall']['this package']:.0f} times as long).", "",
    ]  # fmt: skip


def _flat(counts: dict) -> list[str]:
    of, alone = ({n: t / n for n, t in zip(counts["points"], counts[name], strict=True)} for name in ("seconds", "one thread"))
    return [
        f"A point costs the same from 10⁴ points on for one thread (at 10⁴ {alone[10**4] / alone[10**7]:.2f} times that at 10⁷), and "
        f"from 10⁵ on for two (at 10⁵ {of[10**5] / of[10**7]:.2f} times, at 10⁴ {of[10**4] / of[10**7]:.2f} times). "
        f"Below {2 * LENGTHS.worth_a_thread * LENGTHS.chunk} points there is one thread: so little work is not worth handing over. "
        "Python lets one thread at a time prepare its lanes: at 10⁴ points the second thread started 0.2 ms after the first.", "",
    ]  # fmt: skip


def _start(found: dict) -> list[str]:
    if "start" not in found:
        return []
    return [
        "## A new process", "", "| | |", "|---|---|", *(f"| {name} | {value:.3g} |" for name, value in found["start"].items()), "",
    ]  # fmt: skip


def draw(found: dict) -> None:
    """Cost against contacts, and against the number of points."""
    from matplotlib.figure import Figure

    from slippulse_jax.plot import style

    with style.use():
        figure = Figure(figsize=(style.PAGE, 2.6))
        left, right = figure.subplots(1, 2)
        tall, counts = found["heights"], found["counts"]
        left.loglog(tall["contacts"], 1e6 * np.array(tall["recursion"]), "o-", label="recursion")
        left.loglog(tall["contacts"], 1e6 * np.array(tall["batch"]), "s--", label="batch")
        left.set(xlabel="contacts broken", ylabel="time per point (µs)")
        left.legend()
        right.loglog(counts["points"], 1e6 * np.array(counts["seconds"]) / np.array(counts["points"]), "o-")
        right.set(xlabel="points in the batch", ylabel="time per point (µs)")
        figure.savefig(FIGURE, dpi=150)


def _others() -> float:
    """Cores that other programs keep busy, over a second in which this one sleeps (Linux)."""

    def ticks() -> tuple[int, int]:
        all_of = [int(x) for x in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]]
        return sum(all_of), all_of[3] + all_of[4]  # idle, and waiting for a disk

    before = ticks()
    time.sleep(1)
    total, idle = (after - then for after, then in zip(ticks(), before, strict=True))
    return (os.cpu_count() or 1) * (1 - idle / max(total, 1))


def main() -> None:
    asked = argparse.ArgumentParser(description="Lengths in bulk.")
    asked.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; all by default")
    asked.add_argument("--most", type=int)
    given = asked.parse_args()
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    busy = _others() > 0.1
    found["remark"] = " Other programs were running: trust ratios within a table, and no time by itself." if busy else ""
    for name in given.parts or PARTS:
        found[name] = PARTS[name](given.most or 10**7)
        print(name, json.dumps(found[name], indent=1), flush=True)
    found["machine"] = f"{os.cpu_count()} cores, {platform.machine()}, jax {jax.__version__}, no GPU"
    found["memory, MiB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if given.most:
        return
    RESULTS.write_text(json.dumps(found, indent=1) + "\n")
    if {"points", "counts"} <= set(found):
        PAGE.write_text(page(found))
    if {"heights", "counts"} <= set(found):
        draw(found)


if __name__ == "__main__":
    main()
