"""How often fits of stiffness and of what contacts keep hold the truth, on lengths of dense matrices.

Every study is six sliders of H/λc 50–300 on one interface, with b from 0.3 to 3 at H/λc = 150, whose contacts keep 0 to 0.6 of
their strength; lengths have errors of 1 %.

Run: python -m benchmarks keeping_coverage [--studies N, 100 by default] [--seed N]
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import slippulse_jax as sp
from benchmarks.sequence_coverage import Tally

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from oracles import dense_chain  # pyright: ignore[reportMissingImports]

SMALLEST = "--studies 1"

POISSON, ERROR, SITES, REACH = 0.3, 0.01, 900, 420


def length(height: float, stiffness: float, kept: float) -> float:
    """ℓ of contacts that keep some; NaN where there is no domino, or none that stops on the contacts resolved."""
    load, pinning = dense_chain.responses(height, stiffness, POISSON, SITES, "semi-infinite", REACH)
    excess = dense_chain.front_stress(load, pinning, REACH, 0.0, kept) - 1
    ended = np.flatnonzero(excess[1:] < 0)
    return dense_chain.crossing(np.append(0, excess[1 : ended[0] + 2])) if ended.size and ended[0] else np.nan


def study(random: np.random.Generator) -> tuple[sp.Measurements, dict[str, float]]:
    """Draw an interface, six heights, and the lengths measured."""
    while True:
        height = np.sort(np.exp(random.uniform(np.log(50), np.log(300), 6)))
        stiffness = np.exp(random.uniform(np.log(0.3), np.log(3))) / (2 * (1 + POISSON) * 150)
        kept = random.uniform(0, 0.6)
        found = np.array([length(one, stiffness, kept) for one in height])
        if np.isfinite(found).all():
            break
    measured = found * (1 + ERROR * random.standard_normal(6))
    m = sp.Measurements(height=height, poisson=POISSON, length=measured, length_sigma=ERROR * found)
    return m, {"stiffness": stiffness, "residual_strength": kept}


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description="Coverage of fits of what contacts keep.")
    asked.add_argument("--studies", type=int, default=100)
    asked.add_argument("--seed", type=int, default=0)
    given, tally, began = asked.parse_args(), Tally(), time.perf_counter()
    for number in range(given.studies):
        m, truth = study(np.random.default_rng([given.seed, number]))
        tally.add(sp.fit(m, [*truth]), truth)
    tally.show("six lengths")
    print(f"  {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
