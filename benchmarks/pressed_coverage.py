"""How often fits of blocks with an end hold the truth, on lengths of an independent finite-element program.

Six blocks of H/λc 48–84, three heights long, pushed above a height or on a patch, k_n/k = 1.2, b one of 0.5, 0.7, 1, 1.4, 2 at
H/λc = 60. Lengths are those of `fit_examples/independent_block.py`. First without friction, with 0.5 % errors; then with a
coefficient of friction of 0.1–0.4 known to 10 %, from which the true one is drawn, and 2 % errors, fitted with it and without.
Run: python -m benchmarks pressed_coverage [studies, 200 by default] [--seed N] [--scale 1, a factor of all H/λc]
"""

import argparse
import functools
import sys
import time
from pathlib import Path

import numpy as np

import slippulse_jax as sp
from benchmarks.fit_coverage import Share, holds
from slippulse_jax.inference.fit import FitResult
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.intervals import LEVELS

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "fit_examples"))

import independent_block  # pyright: ignore[reportMissingImports]

SMALLEST = "1 --scale 0.25"

BLOCKS = [(48, 0.15, 1), (60, 0.2, 1), (72, 0.25, 1), (48, 0.2, 0.3), (60, 0.25, 0.35), (84, 0.3, 0.4)]
"""H/λc, and from where to where over H the side is pushed."""
B, POISSON, NORMAL, LONG = (0.5, 0.7, 1.0, 1.4, 2.0), 0.3, 1.2, 3
STATED, KNOWN_TO, SHORTEST = (0.1, 0.2, 0.3, 0.4), 0.1, 0.1
"""Coefficients of friction, their relative error, and the least length that is measured, over H."""


def measurable(lengths: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Which precursors stop and are long enough."""
    return np.isfinite(lengths) & (lengths > SHORTEST * heights)


def table(
    lengths: np.ndarray, measured: np.ndarray, error: float, scale: float, friction: float | None = None
) -> sp.Measurements:
    """What is measured of the blocks whose precursors stop."""
    height, low, high = np.array(BLOCKS, float).T
    height = height * scale
    stops = measurable(lengths, height)
    H, low, high = height[stops], low[stops], high[stops]
    patch = high < 1
    pressed = {} if friction is None else {"friction": friction, "friction_sigma": KNOWN_TO * friction}
    return sp.Measurements(
        height=H, poisson=POISSON, length=measured[stops], length_sigma=error * lengths[stops],
        push_height=H * np.where(patch, (low + high) / 2, low), push_width=np.where(patch, H * (high - low), np.nan),
        normal_stiffness=NORMAL, block_length=LONG * H, **pressed,
    )  # fmt: skip


class Tally:
    """What became of the fits of one kind."""

    def __init__(self, name: str) -> None:
        self.name, self.pulls, self.ratios, self.refused = name, [], [], 0
        self.held: dict[float, list[bool]] = {level: [] for level in LEVELS}

    def add(self, found: FitResult, true: float) -> None:
        self.refused += found.identifiability is Identifiability.POOR_FIT
        self.ratios.append(found.values["stiffness"] / true)
        for level in LEVELS:
            self.held[level].append(holds(found.intervals["stiffness"][level], true))
        error = found.stderrs["stiffness"]
        if error is not None:
            self.pulls.append(np.log(found.values["stiffness"] / true) * found.values["stiffness"] / error)

    def show(self) -> None:
        if not (count := len(self.ratios)):
            return
        low, middle, high = np.quantile(self.ratios, [0.16, 0.5, 0.84])
        held = ", ".join(f"{level:.0%} {Share(sum(self.held[level]), count)}" for level in LEVELS)
        print(f"\n{self.name}: {count} studies\n  intervals hold the truth: {held}")
        print(f"  best over truth {middle:.3f} ({low:.3f} to {high:.3f}); refused by χ² {Share(self.refused, count)}")
        if self.pulls:
            print(f"  {len(self.pulls)} standard errors; pulls {np.mean(self.pulls):+.3f}, spread {np.std(self.pulls):.3f}")


def main() -> None:
    """Print the tables."""
    asked = argparse.ArgumentParser(description="Coverage of fits of blocks with an end and friction.")
    asked.add_argument("studies", nargs="?", type=int, default=200)
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--scale", type=float, default=1.0, help="factor of all H/λc")
    given = asked.parse_args()
    scale, heights = given.scale, given.scale * np.array([height for height, _, _ in BLOCKS])
    began, rng = time.perf_counter(), np.random.default_rng(given.seed)
    stiffness = [b / (2 * (1 + POISSON) * 60 * scale) for b in B]

    @functools.cache
    def blocks(number: int) -> list:
        """Responses of the blocks, by the independent program: minutes for each stiffness."""
        return [
            independent_block.responses(int(H), LONG * int(H), low * H, high * H, stiffness[number], POISSON, NORMAL)
            for H, (_, low, high) in zip(heights, BLOCKS, strict=True)
        ]

    def lengths(number: int, friction: float) -> np.ndarray:
        return np.array([independent_block.precursor(*block, friction) for block in blocks(number)])

    plain, without = Tally("no friction, 0.5 % errors"), Tally("the studies with friction, fitted without")
    pressed = {friction: Tally(f"friction {friction:g} known to 10 %, 2 % errors") for friction in STATED}
    for study in range(given.studies):
        number = int(rng.integers(len(B)))
        exact = lengths(number, 0.0)
        m = table(exact, exact * (1 + 0.005 * rng.standard_normal(exact.size)), 0.005, scale)
        plain.add(sp.fit(m), stiffness[number])
        exact = np.zeros(len(BLOCKS))
        while measurable(exact, heights).sum() < 3:
            number, stated = int(rng.integers(len(B))), float(rng.choice(STATED))
            exact = lengths(number, stated * (1 + KNOWN_TO * rng.standard_normal()))
        measured = exact * (1 + 0.02 * rng.standard_normal(exact.size))
        pressed[stated].add(sp.fit(table(exact, measured, 0.02, scale, stated)), stiffness[number])
        without.add(sp.fit(table(exact, measured, 0.02, scale)), stiffness[number])
        if study % 20 == 19:
            print(f"{study + 1} studies after {time.perf_counter() - began:.0f} s", flush=True)
    for tally in (plain, *pressed.values(), without):
        tally.show()
    print(f"\n{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
