"""How often the intervals of a fit of a block hold the truth, and what the slider makes of the same lengths.

Six blocks of H/λc 250–2000, pushed above a quarter of their height, b = 0.3–3 for the middle one, lengths with 2 % errors from
the cascade on coarser blocks, each its own: nothing of the fit's interpolation. Fitted as a block and as a slider.
Run: python -m benchmarks block_coverage [studies, 200 by default] [--push H] [--seed N]
"""

import argparse
import time

import numpy as np

import slippulse_jax as sp
from benchmarks.fit_coverage import Share, holds
from slippulse_jax.blocks.size import many, tall_lengths
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.intervals import LEVELS

SMALLEST = "2"

SIGMA, SPECIMENS, POISSON = 0.02, 6, 0.3


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description="Coverage of fits of blocks.")
    asked.add_argument("studies", nargs="?", type=int, default=200)
    asked.add_argument("--push", type=float, default=0.25)
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    began, rng = time.perf_counter(), np.random.default_rng(given.seed)
    height = np.exp(rng.uniform(*np.log([250, 2000]), (given.studies, SPECIMENS)))
    b = np.exp(rng.uniform(*np.log([0.3, 3]), given.studies))
    stiffness = b / (2 * (1 + POISSON) * np.median(height, axis=1))
    block, none = many(height.ravel(), np.repeat(stiffness, SPECIMENS), POISSON, given.push), np.zeros(height.size)
    length = tall_lengths(block, sp.Interface(none, none), "full")[0].reshape(height.shape)
    measured = length * (1 + SIGMA * rng.standard_normal(height.shape))
    pulls, held, ratio, verdicts = [], {level: [] for level in LEVELS}, [], []
    for H, x, true, exact in zip(height, measured, stiffness, length, strict=True):
        m = sp.Measurements(height=H, poisson=POISSON, length=x, length_sigma=SIGMA * exact, push_height=given.push * H)
        block, slider = sp.fit(m), sp.fit(m, body="slider")
        verdicts.append(block.identifiability)
        for level in LEVELS:
            held[level].append(holds(block.intervals["stiffness"][level], true))
        error = block.stderrs["stiffness"]
        if error is not None:
            pulls.append(np.log(block.values["stiffness"] / true) * block.values["stiffness"] / error)
        ratio.append((slider.values["stiffness"] / true, slider.identifiability is Identifiability.POOR_FIT))
    bias, refused = np.array(ratio).T
    print(f"{given.studies} studies, push above {given.push:g} H, seed {given.seed}\n")
    print(f"standard error given      {Share(sum(v is Identifiability.IDENTIFIED for v in verdicts), given.studies)}")
    print(f"pulls                     mean {np.mean(pulls):+.3f}, spread {np.std(pulls):.3f}")
    for level in LEVELS:
        print(f"{level:.0%} interval holds        {Share(sum(held[level]), given.studies)}")
    low, middle, high = np.quantile(bias, [0.16, 0.5, 0.84])
    print(f"slider over truth         {middle:.3f} ({low:.3f} to {high:.3f}); refused by its χ² in {refused.mean():.0%}")
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
