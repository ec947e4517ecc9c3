"""How often the intervals of a fit hold the truth on short blocks pushed by soft machines.

Three blocks of H/λc 15–60 and L/H 3–6, b = 0.3–2, and a machine 1 to 10 times as stiff as the block without an end; lengths by the
dense program with 2 % errors, and blocks that were run through, as such. Fitted with both stated, and with neither.
Prints a table, every share with its sampling error. Run: python -m benchmarks ends_coverage [studies, 200 by default] [--seed N]
[--intervals auto]
"""

import argparse
import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

import slippulse_jax as sp
from benchmarks.fit_coverage import Share, holds
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.intervals import LEVELS

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from oracles import dense_chain  # pyright: ignore[reportMissingImports]

SMALLEST = "1"

SIGMA, SPECIMENS, POISSON = 0.02, 3, 0.3


def study(rng: np.random.Generator) -> tuple[sp.Measurements, float]:
    """What is measured, and k/K; another study where every block is run through."""
    height = rng.uniform(15, 60, SPECIMENS)
    middle = float(np.median(height))
    stiffness = np.exp(rng.uniform(*np.log([0.3, 2.0]))) / (2 * (1 + POISSON) * middle)
    sites = np.round(rng.uniform(3, 6) * height)
    block = FirstFront().regime(Inputs.of([middle], stiffness, POISSON)).edge_stiffness[0]
    machine = float(np.exp(rng.uniform(0, np.log(10))) * block)
    fronts = [
        dense_chain.first_precursor(h, stiffness, POISSON, int(n), "free", machine) for h, n in zip(height, sites, strict=True)
    ]
    length = np.array([front[1] for front in fronts])
    if np.isinf(length).all():
        return study(rng)
    ran = np.isinf(length)
    sigma = np.where(ran, 0.0, SIGMA * np.where(ran, 0.0, length))
    value = np.where(ran, sites, np.minimum(np.where(ran, 0, length) + sigma * rng.standard_normal(SPECIMENS), sites))
    kind = ["at_least" if one else "length" for one in ran]
    return sp.Measurements(
        height=height,
        poisson=POISSON,
        length=value,
        length_sigma=sigma,
        kind=kind,
        block_length=sites,
        machine_stiffness=machine,
    ), float(stiffness)


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description="Coverage of fits to short blocks pushed by soft machines.")
    asked.add_argument("studies", nargs="?", type=int, default=200)
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--intervals", default="auto")
    given = asked.parse_args()
    rng = np.random.default_rng(given.seed)
    names = ("both stated", "neither stated")
    hits = {name: np.zeros(len(LEVELS), int) for name in names}
    off: dict[str, list[float]] = {name: [] for name in names}
    identified, unconverged, ran = dict.fromkeys(names, 0), dict.fromkeys(names, 0), 0
    began = time.perf_counter()
    for _ in range(given.studies):
        m, truth = study(rng)
        ran += m.kind.count("at_least")
        for name, table in zip(names, (m, dataclasses.replace(m, block_length=None, machine_stiffness=None)), strict=True):
            result = sp.fit(table, intervals=given.intervals)
            pieces = result.intervals["stiffness"]
            hits[name] += [holds(pieces[level], truth) for level in LEVELS]
            off[name].append(np.log(result.values["stiffness"] / truth))
            identified[name] += result.identifiability is Identifiability.IDENTIFIED
            unconverged[name] += not result.converged
    print(f"({given.studies} studies, seed {given.seed}, {time.perf_counter() - began:.0f} s; {ran} blocks were run through)\n")
    print("| fit | 68 % | 95 % | median of fitted over true k | identified | unconverged |\n|---|---|---|---|---|---|")
    for name in names:
        shares = " | ".join(str(Share(int(hit), given.studies)) for hit in hits[name])
        share = Share(identified[name], given.studies)
        print(f"| {name} | {shares} | {np.exp(np.median(off[name])):.2f} | {share} | {unconverged[name]} |")


if __name__ == "__main__":
    main()
