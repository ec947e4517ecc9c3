"""A GPU beside all cores of its machine, in one run: prints times, ratios and the largest differences; writes docs/tables/gpu.md.

``python -m benchmarks gpu`` runs everything; names of rows some of it, and writes nothing.
"""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

import slippulse_jax as sp
from benchmarks.lengths import long_fronts, random_points
from benchmarks.timing import in_turns

SMALLEST = "'`precursor_lengths`, 2000 points' '`exact_lengths`, 2000 points' '`series` of 200 events on 300 sites'"

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "tables" / "gpu.md"
MEASURED = ROOT / "fit_examples" / "pmma_block" / "lengths.csv"


def lengths(count: int, derivatives: Any = 0, drawn: Callable = random_points) -> Callable[[], Any]:
    slider = sp.Slider(*drawn(count))
    return lambda: sp.precursor_lengths(slider, derivatives=derivatives)


def exact(count: int, derivatives: Any = 0, **interface: float) -> Callable[[], Any]:
    slider, on = sp.Slider(*random_points(count)), sp.Interface(**interface) if interface else None
    return lambda: sp.exact_lengths(slider, on, derivatives=derivatives)


def vmapped(f: Callable, count: int) -> Callable[[], Any]:
    """`f` of many sliders under ``jit`` and ``vmap``."""
    slider, many = sp.Slider(*random_points(count)), jax.jit(jax.vmap(f))
    return lambda: jax.block_until_ready(many(slider))


def rupture(slider: sp.Slider) -> jax.Array:
    chain = sp.chain(slider, sites=300)
    state, site = sp.nucleate(chain)
    return sp.rupture(chain, state, trigger=site).length


def blocks(count: int) -> Callable[[], Any]:
    height, push = np.linspace(20, 60, count), np.linspace(0.1, 0.6, count)
    many = jax.jit(jax.vmap(lambda height, push: sp.precursor_length(sp.Block(height, 0.01, 0.3, sp.Push(push)), sites=256)))
    return lambda: jax.block_until_ready(many(height, push))


def one_block(height: float) -> Callable[[], Any]:
    block = sp.Block(height, 1 / (2.6 * height), 0.3, sp.Push(0.25))
    return lambda: jax.block_until_ready(sp.precursor_length(block))


def series() -> Callable[[], Any]:
    chain = sp.chain(sp.Slider(25.0, 0.03, 0.3, length=300))
    return lambda: jax.block_until_ready(sp.series(chain, events=200).load)


ROWS: dict[str, Callable[[], Callable[[], Any]]] = {
    "`precursor_lengths`, 2000 points": lambda: lengths(2000),
    "`precursor_lengths`, 200 000 points": lambda: lengths(200_000),
    "`precursor_lengths`, 10⁷ points": lambda: lengths(10**7),
    "`precursor_lengths` with derivatives, 200 000 points": lambda: lengths(200_000, 1),
    "`precursor_lengths` with derivatives, 10⁶ points": lambda: lengths(10**6, 1),
    "`precursor_lengths`, 100 000 long fronts": lambda: lengths(100_000, drawn=long_fronts),
    "`exact_lengths`, 2000 points": lambda: exact(2000),
    "`exact_lengths`, 10⁶ points": lambda: exact(10**6),
    "`exact_lengths` with a prestress, 200 000 points": lambda: exact(200_000, prestress=0.05),
    "`exact_lengths` with derivatives, 100 000 points": lambda: exact(100_000, 1),
    "`vmap` of `precursor_length`, 200 000 points": lambda: vmapped(sp.precursor_length, 200_000),
    "`vmap` of its gradient, 200 000 points": lambda: vmapped(lambda s: jax.grad(sp.precursor_length)(s).stiffness, 200_000),
    "`vmap` of `exact_length`, 20 000 points": lambda: vmapped(sp.exact_length, 20_000),
    "`vmap` of `rupture` on 300 sites, 1000 chains": lambda: vmapped(rupture, 1000),
    "`vmap` of `precursor_length` of a block, 64 blocks, 256 contacts": lambda: blocks(64),
    "`precursor_length` of a block, H/λc = 100": lambda: one_block(100.0),
    "`precursor_length` of a block, H/λc = 400": lambda: one_block(400.0),
    "`series` of 200 events on 300 sites": series,
    "`fit` to six lengths": lambda: lambda: sp.fit(MEASURED).values["stiffness"],
}


def on(device: Any, run: Callable[[], Any]) -> Callable[[], Any]:
    def there() -> list[np.ndarray]:
        with jax.enable_x64(True), jax.default_device(device):
            return [np.asarray(x, float) for x in jax.tree.leaves(run())]

    return there


def row(name: str) -> str:
    """Compare one computation on both."""
    devices = {"gpu": jax.devices()[0], "cpu": jax.devices("cpu")[0]}
    with jax.enable_x64(True):
        work = ROWS[name]()
    run = {where: on(device, work) for where, device in devices.items()}
    first, found = {}, {}
    for where, there in run.items():
        began = time.perf_counter()
        found[where] = there()
        first[where] = time.perf_counter() - began
    taken = {where: min(times) for where, times in in_turns(run, 3).items()}
    apart = max(
        float(np.max(np.abs(a - b) / np.maximum(np.abs(b), np.finfo(float).tiny), initial=0, where=np.isfinite(b) & (a != b)))
        for a, b in zip(found["gpu"], found["cpu"], strict=True)
    )
    assert all(np.array_equal(np.isfinite(a), np.isfinite(b)) for a, b in zip(found["gpu"], found["cpu"], strict=True))
    print(f"{name}: gpu first {first['gpu']:.1f} s, cpu first {first['cpu']:.1f} s", flush=True)
    return f"| {name} | {taken['gpu']:.2g} | {taken['cpu']:.2g} | {taken['cpu'] / taken['gpu']:.2g} | {apart:.0e} |"


def main(names: list[str]) -> None:
    if jax.default_backend() == "cpu":
        sys.exit("no GPU here that JAX can use")
    table = [
        f"On one {jax.devices()[0].device_kind} and the {os.cpu_count()} cores beside it, jax {jax.__version__}, double precision; "
        "compiled before, the shortest of three runs. The last column is the largest relative difference of a result.",
        "",
        "| | GPU, s | CPU, s | CPU over GPU | difference |",
        "|---|---|---|---|---|",
    ]
    for name in names or ROWS:
        table.append(row(name))
        print(table[-1], flush=True)
    if not names:
        PAGE.write_text("\n".join([*table, ""]), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
