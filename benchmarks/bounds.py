"""The bounds that must hold, one row each: speed beside numba, start-up, and the way from a function to the physics.

``python -m benchmarks bounds`` runs all rows, ``python -m benchmarks bounds points start`` some of them. With ``--share 0.01`` points,
studies and turns are fewer by this factor. Every speed is a ratio of runs taken in turns. Ruptures have rows for N = 300 and 3000; long fronts are H/λc log-uniform in 10⁴–10⁵, b in 0.2–5.
"""

import argparse
import functools
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import rivals
from benchmarks.lengths import long_fronts
from benchmarks.regimes import three, two
from benchmarks.timing import side_by_side
from slippulse_jax import Block, Push, Slider, exact_lengths, fit, precursor_length, precursor_lengths
from slippulse_jax.bulk.compiler import compile_loops_whole

SMALLEST = "--share 0.01"

ROOT = Path(__file__).resolve().parent.parent
LENGTHS = ROOT / "fit_examples" / "pmma_block" / "lengths.csv"

Row = tuple[str, float, str]
"""What, how much, and the bound."""


def part(share: float, count: int) -> int:
    """This share of a count, at least one."""
    return math.ceil(share * count)


def points(share: float) -> Iterator[Row]:
    """Random points on all cores, and what their derivatives add."""
    rng, n = np.random.default_rng(0), part(share, 200_000)
    given = rng.uniform(10, 50, n), 10 ** rng.uniform(-3, np.log10(0.03), n), rng.uniform(0.1, 0.45, n)
    slider, out = Slider(*given), np.empty(n)
    value = functools.partial(precursor_lengths, slider)
    taken = side_by_side({"value": value, "numba": lambda: rivals.parallel(*given, out)}, part(share, 12))
    yield f"{n} points, numba on all cores over this package", taken["numba"] / taken["value"], "≥ 2.5"
    taken = side_by_side({"value": value, "derivatives": functools.partial(value, derivatives=1)}, part(share, 36))
    yield "value with three derivatives over value", taken["derivatives"] / taken["value"], "≤ 3"


def long(share: float) -> Iterator[Row]:
    """Long fronts; numba by every five-hundredth of them."""
    n, few = part(share, 100_000), part(share, 200)
    given = long_fronts(n)
    slider, out = Slider(*given), np.empty(few)
    taken = side_by_side(
        {
            "ℓ": lambda: precursor_lengths(slider),
            "ℓ*": lambda: exact_lengths(slider),
            "numba": lambda: rivals.parallel(*(x[:few] for x in given), out),
        },
        part(share, 3),
    )
    for name in ("ℓ", "ℓ*"):
        yield f"{n} long fronts, numba over {name}, per point", taken["numba"] * n / few / taken[name], "≥ 10"


def ruptures(share: float) -> Iterator[Row]:
    """Single ruptures beside the numba loop of `benchmarks.cascade`."""
    from benchmarks.cascade import SITES, ruptures

    for sites, _, _, ours, alone, whole, theirs in ruptures([part(share, n) for n in SITES], lanes=(1,)):
        paid = "≥ 1" if sites < 1000 else "≥ 0.005: the response is a matrix"
        yield f"a rupture of {sites} sites, set-up and equilibria in both, numba over this package", whole / ours, paid
        yield "its breaks alone, given stresses and response, numba over this package", theirs / alone, "≥ 1"


def series(share: float) -> Iterator[Row]:
    """Events beside the numba loop of `benchmarks.series`, which is given its responses."""
    from benchmarks.series import single

    events = part(share, 10_000)
    ours, theirs, _ = single(2000, events)
    yield f"{events} events at N = 2000, numba over this package", theirs / ours, "as before"


def blocks(share: float) -> Iterator[Row]:
    """The length of a block, and what its derivatives in H/λc, k/K, ν and the push add; compiled."""
    for height, friction in ((100.0, None), (400.0, None), (100.0, 0.25), (400.0, 0.25)):
        sites = max(64, part(share, 256 if height < 200 else 512))

        def length(x: jax.Array, sites: int = sites, friction: float | None = friction) -> jax.Array:
            return precursor_length(Block(x[0], x[1], x[2], Push(x[3]), friction=friction), sites=sites)

        with jax.enable_x64(True):
            at = jnp.array([height, 1 / (2.6 * height), 0.3, 0.25])
            programs = {"value": jax.jit(length), "both": jax.jit(jax.value_and_grad(length))}
            each = {name: (lambda f=f, x=at: jax.block_until_ready(f(x))) for name, f in programs.items()}
            taken = side_by_side(each, part(share, 48))
        where = f"of a block, H/λc = {height:.0f}" + (f", μ = {friction}" if friction else "")
        yield f"length {where}, ms", 1e3 * taken["value"], "≤ 30"
        yield f"value with four derivatives over value, {where}", taken["both"] / taken["value"], "≤ 3"


def fits(share: float) -> Iterator[Row]:
    """Fits with two and three parameters: the slowest of some studies, programs compiled."""
    for number, make, bound in (("two", lambda rng: two(rng, 8, 80), "≤ 1"), ("three", three, "≤ 5")):
        rng, taken = np.random.default_rng(5), []
        studies = [make(rng) for _ in range(part(share, 10))]
        fit(studies[0].measurements, studies[0].free)
        for study in studies:
            began = time.perf_counter()
            fit(study.measurements, study.free)
            taken.append(time.perf_counter() - began)
        yield f"fit with {number} parameters, s", max(taken), bound


def start(share: float) -> Iterator[Row]:
    """Start-up in s, with an empty folder of compiled programs and with what the first call left there."""

    def python(code: str) -> float:
        return min(_seconds([sys.executable, "-c", code], _user()) for _ in range(part(share, 3)))

    yield "import, s", python("import slippulse_jax as sp; sp.precursor_length") - python("pass"), "≤ 1"
    command = [sys.executable, "-m", "slippulse_jax.cli.main"]
    for name, words, first, second in (
        ("length", ["length", "--height", "25", "--stiffness", "0.03", "--poisson", "0.3"], "≤ 2.5", "≤ 1.5"),
        ("fit", ["fit", str(LENGTHS)], "≤ 5", "≤ 2.5"),
    ):
        cold, warm = [], []
        for _ in range(part(share, 3)):
            with tempfile.TemporaryDirectory() as folder:
                keep = _user() | {"XDG_CACHE_HOME": folder}
                cold.append(_seconds([*command, *words], keep))
                warm.append(_seconds([*command, *words], keep))
        yield f"slippulse {name}, first call, s", min(cold), first
        yield f"slippulse {name}, second call, s", min(warm), second


def _user() -> dict[str, str]:
    """Environment of a user who has set nothing for JAX."""
    return {key: value for key, value in os.environ.items() if not key.startswith(("JAX_", "XLA_"))}


def _seconds(command: list[str], environment: dict[str, str]) -> float:
    began = time.perf_counter()
    subprocess.run(command, capture_output=True, check=True, cwd=ROOT, env=environment)
    return time.perf_counter() - began


def _visits(code: str) -> tuple[list[str], int, int]:
    """Modules of the package a program passes through, in order; the deepest nest of its functions, and those not of bulk/."""
    watch = f"""
import sys
import slippulse_jax as sp
for name in sp.__all__: getattr(sp, name)
seen, depth = [], []
def watch(frame, event, argument):
    name = frame.f_globals.get("__name__", "")
    if event == "call" and name.startswith("slippulse_jax") and frame.f_code.co_name[0] != "<":
        if not seen or seen[-1] != name: seen.append(name)
        if (name + ".").split(".")[1] in ("bodies", "front", "exact", "events", "lengths", "precursor"):
            above = []
            while frame is not None:
                where = frame.f_globals.get("__name__", "")
                if where.startswith("slippulse_jax") and frame.f_code.co_name[0] != "<": above.append(where)
                frame = frame.f_back
            depth.append((len(above), sum(not where.startswith("slippulse_jax.bulk") for where in above)))
sys.setprofile(watch)
{code}
sys.setprofile(None)
print(",".join(seen), *max(depth, default=(0, 0)), sep=";")
"""
    done = subprocess.run([sys.executable, "-c", watch], capture_output=True, text=True, check=True, cwd=ROOT)
    modules, depth, physics = done.stdout.strip().splitlines()[-1].split(";")
    return modules.split(","), int(depth), int(physics)


def path(_: float) -> Iterator[Row]:
    """How far it is from a public function to a line of physics, and how many modules a fit passes through."""
    _, frames, physics = _visits("sp.precursor_lengths(sp.Slider([25.0, 30.0], 0.03, 0.3))")
    yield "functions of the package from precursor_lengths to the physics, nested", frames, "≤ 7"
    yield "of them, those not of bulk/", physics, ""
    visited, *_ = _visits(f"sp.fit(sp.read_measurements({str(LENGTHS)!r}))")
    fitting = [name for name in visited if name.startswith("slippulse_jax.inference")]
    yield "modules that a fit passes through", len(set(visited)), "≤ 12"
    yield "of them, those of inference", len(set(fitting)), ""


ROWS = {
    "points": points,
    "long": long,
    "ruptures": ruptures,
    "series": series,
    "fits": fits,
    "blocks": blocks,
    "start": start,
    "path": path,
}


def main() -> None:
    """Print a table."""
    asked = argparse.ArgumentParser(description="The bounds that must hold, one row each.")
    asked.add_argument("rows", nargs="*", default=list(ROWS))
    asked.add_argument("--share", type=float, default=1.0, help="of the points, studies and turns")
    given = asked.parse_args()
    compile_loops_whole()  # as ruptures and series ask for; it makes no difference to the other rows
    print("| | found | bound |\n|---|---|---|")
    for name in given.rows:
        for what, value, bound in ROWS[name](given.share):
            print(f"| {what} | {value:.3g} | {bound} |", flush=True)


if __name__ == "__main__":
    main()
