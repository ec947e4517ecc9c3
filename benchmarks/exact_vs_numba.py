"""A million lengths over the whole domain: the exact solution, the recursion of this package, and the recursion in numba.

Points: H/λc 2–10⁵ and k/K 1e-6–1 log-uniform, ν 0–0.5 uniform, unsorted. The recursion's time goes with the length, the exact
solution's does not; `precursor_lengths` changes from one to the other at some 8000 contacts. Everything on all cores. numba is
timed on every n-th point of the same draw and scaled up.
Run: python -m benchmarks exact_vs_numba [points [of them by numba]].
"""

import sys
import time

import numpy as np

from benchmarks.rivals import parallel
from benchmarks.timing import seconds
from slippulse_jax import Slider, exact_lengths, precursor_lengths

SMALLEST = "2000 200"

POINTS, SAMPLE = 1_000_000, 20_000


def main(count: int, sampled: int) -> None:
    u = np.random.default_rng(0).uniform(size=(3, count))
    points = 2 * 5e4 ** u[0], 1e-6 ** u[1], u[2] / 2
    slider, few = Slider(*points), tuple(np.ascontiguousarray(x[:: count // sampled]) for x in points)
    began = time.perf_counter()
    found = exact_lengths(slider)
    cold = time.perf_counter() - began
    out = np.empty(few[0].size)
    parallel(*(x[:2] for x in few), out[:2])
    precursor_lengths(Slider(*few))
    times = {
        "exact_lengths": min(seconds(lambda: exact_lengths(slider)) for _ in range(2)),
        "precursor_lengths": seconds(lambda: precursor_lengths(slider)),
        "numba, the recursion": seconds(lambda: parallel(*few, out)) * count / out.size,
    }
    same = found[:: count // sampled]
    counts = np.maximum(np.ceil(same), 1), np.maximum(np.ceil(out), 1)
    print(f"{count} points, numba on {out.size} of them; mean length {found.mean():.0f} λc, median {np.median(found):.1f} λc")
    print(
        f"whole counts that differ from numba's: {(counts[0] != counts[1]).sum()}; first call, compilation included: {cold:.1f} s"
    )
    print(f"{'':24s} {'s':>8s} {'µs / point':>11s} {'ratio':>7s}")
    for name, took in times.items():
        print(f"{name:24s} {took:8.2f} {took / count * 1e6:11.2f} {took / times['exact_lengths']:7.1f}")
    # where each stands: by height
    print(f"{'H/λc':>15s} {'exact, µs':>10s} {'numba, µs':>10s} {'ratio':>7s}")
    for low, high in ((2, 30), (30, 1e3), (1e3, 1e4), (1e4, 1e5), (9e4, 1e5)):
        here = np.flatnonzero((points[0] >= low) & (points[0] < high))[:100_000]
        part = Slider(*(x[here] for x in points))
        fewer = tuple(x[here[:2000]] for x in points)
        exact = min(seconds(lambda part=part: exact_lengths(part)) for _ in range(2)) / here.size
        numba = seconds(lambda fewer=fewer: parallel(*fewer, np.empty(fewer[0].size))) / fewer[0].size
        print(f"{low:7.0f}–{high:<7.0f} {exact * 1e6:10.2f} {numba * 1e6:10.2f} {numba / exact:7.1f}")


if __name__ == "__main__":
    numbers = [int(x) for x in sys.argv[1:]]
    main(*(numbers + [POINTS, SAMPLE][len(numbers) :]))
