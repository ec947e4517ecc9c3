"""How often fits of lengths hold the truth where thresholds scatter, on events of independent programs.

Every study is another interface: b from 0.3 to 3, and a scatter of thresholds drawn from its prior, 3 % within a factor of two.
Sliders have six heights of 60 to 210 λc, blocks (friction 0.3, three heights long) four of 24 to 48 λc; an event is noticed if
its extent is a tenth of the height. Lengths are read to 1 %, or to 3 % where each height has one. Kinds:

repeated    three lengths of each height; stiffness and scatter fitted, with that prior
single      one of each
blocks      three of each height of a block; the scatter is held at the truth
measured    as repeated, of provenance measured: an offset and a model factor are drawn too, and fitted within their priors
alike       as repeated, fitted as if contacts were alike
held        the same, with the scatter held at the truth
single_held as single, with the scatter held at the truth

With --scatter every scatter is that.

Run: python -m benchmarks scatter_coverage [kind …] [--studies N, 100 by default] [--scatter S] [--seed N]
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import slippulse_jax as sp
from benchmarks.fit_coverage import Share, holds
from slippulse_jax.inference.parameters import MODEL_ERROR, USUAL_SCATTER
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.intervals import LEVELS

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "fit_examples"))

import independent_block  # pyright: ignore[reportMissingImports]
import independent_lattice  # pyright: ignore[reportMissingImports]
import independent_sequence  # pyright: ignore[reportMissingImports]

SMALLEST = "--studies 1 held"

POISSON, VISIBLE, FRICTION, NORMAL = 0.3, 0.1, 0.3, 1.2
SLIDERS, BLOCKS, LONG = np.arange(60.0, 211.0, 30.0), np.array([24, 32, 40, 48]), 3
PUSH = 0.1, 0.2
"""Ends of the pusher of a block, over H."""
CHAIN = 16
"""Heights along which the chain of a slider goes."""
KINDS = ("repeated", "single", "blocks", "measured", "alike", "held", "single_held")


def lengths_of(
    body: str, height: float, stiffness: float, scatter: float, draws: int, random: np.random.Generator
) -> list[float]:
    """Lengths of the first events noticed, each with thresholds of its own."""
    friction = 0.0
    if body == "block":
        sites = LONG * int(height)
        elastic = independent_block.responses(
            int(height), sites, *(at * height for at in PUSH), stiffness, POISSON, NORMAL
        )  # fmt: skip
        friction = FRICTION
    else:
        sites = int(2 * height)  # that may break, of a chain of six decay lengths
        push, response = independent_lattice.responses(height, stiffness, POISSON, sites=int(CHAIN * height), most=sites)
        elastic = push, response, np.zeros(sites), np.zeros((sites, sites))
    found = []
    for _ in range(draws):
        threshold = np.maximum(1 + scatter * random.standard_normal(sites), 0.05)
        events = independent_sequence.events_of(*elastic, friction, threshold)
        found.append(next(one.length for one in events if one.length - one.left >= VISIBLE * height))
    return found


class Study:
    """An interface, what is measured of it, and how it is fitted."""

    def __init__(self, kind: str, scatter: float | None, random: np.random.Generator) -> None:
        """Draw one."""
        body, repeats = "block" if kind == "blocks" else "slider", 1 if kind.startswith("single") else 3
        b, middle = np.exp(random.uniform(np.log(0.3), np.log(3))), 120.0 if body == "slider" else 36.0
        prior = USUAL_SCATTER[0] * np.exp(random.standard_normal() * USUAL_SCATTER[1] / USUAL_SCATTER[0])
        scatter = float(np.clip(prior, 0.005, 0.12)) if scatter is None else scatter
        stiffness, heights = b / (2 * (1 + POISSON) * middle), BLOCKS.astype(float) if body == "block" else SLIDERS
        every = [lengths_of(body, height, stiffness, scatter, repeats, random) for height in heights]
        height, length = np.repeat(heights, repeats), np.ravel(every)
        sigma = (0.03 if repeats == 1 else 0.01) * length
        if kind == "measured":
            length = length * np.exp(MODEL_ERROR * random.standard_normal()) + np.median(sigma) * random.standard_normal()
        read = np.maximum(length + sigma * random.standard_normal(length.size), VISIBLE * height)
        more: dict[str, Any] = {"provenance": ("measured",) * length.size} if kind == "measured" else {}
        if body == "block":
            low, high = PUSH
            more = {
                "push_height": (low + high) / 2 * height, "push_width": (high - low) * height, "block_length": LONG * height,
                "friction": FRICTION, "normal_stiffness": NORMAL,
            }  # fmt: skip
        self.measurements = sp.Measurements(height, POISSON, read, sigma, visible=VISIBLE * height, **more)
        prior_of = sp.Parameter("threshold_scatter", prior=USUAL_SCATTER)
        self.free = ["stiffness", prior_of] if kind in ("repeated", "single") else ["stiffness"]
        self.options: dict[str, Any] = {}
        if kind in ("blocks", "alike") or kind.endswith("held"):
            self.options = {"fixed": {"threshold_scatter": 0.0 if kind == "alike" else scatter}}
        self.truth = {"stiffness": stiffness} | ({"threshold_scatter": scatter} if len(self.free) > 1 else {})


def coverage(studies: int, kind: str, scatter: float | None, seed: int = 0) -> None:
    """Fit so many studies of a kind, and print how often they hold the truth."""
    held: dict[str, list[list[bool]]] = {}
    off: dict[str, list[float]] = {}
    wide: dict[str, list[float]] = {}
    refused, began = 0, time.perf_counter()
    for number in range(studies):
        one = Study(kind, scatter, np.random.default_rng([seed, KINDS.index(kind), number]))
        found = sp.fit(one.measurements, one.free, **one.options)
        refused += found.identifiability is Identifiability.POOR_FIT
        for name, true in one.truth.items():
            held.setdefault(name, []).append([holds(found.intervals[name][level], true) for level in LEVELS])
            off.setdefault(name, []).append(np.log(found.values[name] / true) if true else np.nan)
            inner = found.intervals[name][LEVELS[0]]
            wide.setdefault(name, []).append(np.log(inner[-1].high / inner[0].low) / 2 if inner else np.inf)
        print(".", end="", file=sys.stderr, flush=True)
    given = "" if scatter is None else f", scatter {scatter:g}"
    print(f"\n{kind}{given}: {studies} studies, {refused} refused")
    for name, inside in held.items():
        shares = ", ".join(
            f"{level:.0%} {Share(int(sum(x)), len(x))}" for level, x in zip(LEVELS, zip(*inside, strict=True), strict=True)
        )
        low, middle, high = np.exp(np.quantile(off[name], [0.16, 0.5, 0.84]))
        print(f"  {name:18} intervals hold the truth: {shares}; best over true {middle:.2f} ({low:.2f} to {high:.2f})", end="")
        print(f"; 68 % intervals of ± {np.median(wide[name]):.2g} in the logarithm")
    print(f"  {time.perf_counter() - began:.0f} s", flush=True)


def main() -> None:
    """Print the tables."""
    asked = argparse.ArgumentParser(description="Coverage of fits of contacts that differ.")
    asked.add_argument("--studies", type=int, default=100)
    asked.add_argument("kinds", nargs="*", metavar="kind", help=f"of {', '.join(KINDS)}; the first four by default")
    asked.add_argument("--scatter", type=float)
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    for kind in given.kinds or KINDS[:4]:
        coverage(given.studies, kind, given.scatter, given.seed)


if __name__ == "__main__":
    main()
