"""What a quasi-static fit makes of lengths that the quasi-static model did not make, and which error model is honest about it.

Counts of broken contacts less a half, of the chain with inertia and of a second precursor on contacts that age (and of the model
itself, as a check), at five heights and four stiffnesses, with 2 % of noise; σ² is that of the noise and 1/12 for the count. Prints
the bias of k/K, the share of estimates over five times the truth (at the second root), and the coverage of the intervals, in %
and with their sampling errors.
Run: python -m benchmarks misspecification [studies for each stiffness, 8 by default] [source …: itself, inertia, ageing]
[--errors "error model" …] [--seed N]
"""

import argparse
import sys
import time

import jax
import numpy as np

import slippulse_jax as sp
from benchmarks.fit_coverage import Share, holds

SMALLEST = "1"

HEIGHTS = np.array([12.0, 18.0, 25.0, 35.0, 50.0])
STIFFNESS = np.geomspace(2e-3, 1e-2, 4)
SIGMA, SITES = 0.02, 160

ERRORS = {
    "σ alone": [],
    "model factor 1 ± 0.1": [sp.Parameter("model_factor", prior=(1, 0.1))],
}


def itself(slider: sp.Slider) -> float:
    """The model of the fit."""
    return float(np.ceil(sp.exact_lengths(slider))) - 0.5


def inertial(slider: sp.Slider) -> float:
    """Extent of the first precursor of a slightly damped chain."""
    motion = sp.simulate_inertial(sp.chain(slider, sites=SITES), duration=600.0, damping=0.1)
    return float(motion.extent) - 0.5


def ageing(slider: sp.Slider) -> float:
    """Extent of the second precursor that reaches past the first, on contacts reborn at 0.3 σ_s that recover over 3 u_s."""
    chain = sp.chain(slider, sites=SITES)
    catalogue = sp.series(chain, events=40, ageing=sp.Ageing(newborn=0.3, scale=3.0))
    extent = np.asarray(catalogue.extent)
    beyond = np.nonzero(extent > extent[0])[0]
    return float(extent[beyond[0]] if len(beyond) else extent[0]) - 0.5


SOURCES = {"itself": itself, "inertia": inertial, "ageing": ageing}


def coverage(lengths: np.ndarray, extra: list, studies: int, seed: int) -> str:
    """Median bias of k/K, share of estimates beyond the peak, coverage at both levels; `lengths` is (stiffness, height)."""
    rng = np.random.default_rng(seed)
    bias, hits = [], np.zeros(2, dtype=int)
    for truth, length in zip(STIFFNESS, lengths, strict=True):
        for _ in range(studies):
            noisy = length * (1 + SIGMA * rng.standard_normal(len(length)))
            sigma = np.sqrt((SIGMA * length) ** 2 + 1 / 12)
            m = sp.Measurements(height=HEIGHTS, poisson=0.3, length=noisy, length_sigma=sigma)
            result = sp.fit(m, ["stiffness", *extra])
            bias.append(np.log(result.values["stiffness"] / truth))
            hits += [holds(pieces, truth) for pieces in result.intervals["stiffness"].values()]
    beyond = int(np.sum(np.array(bias) > np.log(5)))
    shares = [str(Share(int(hit), len(bias))) for hit in (beyond, *hits)]
    return f"{100 * np.expm1(np.median(bias)):+.0f} % | " + " | ".join(shares)


def main() -> None:
    """Print one table."""
    asked = argparse.ArgumentParser(description="Quasi-static fits of lengths that another model made.")
    asked.add_argument("studies", nargs="?", type=int, default=8, help="for each of the four stiffnesses")
    asked.add_argument("sources", nargs="*", default=list(SOURCES))
    asked.add_argument("--errors", nargs="+", default=list(ERRORS), choices=list(ERRORS))
    asked.add_argument("--seed", type=int, default=5)
    given = asked.parse_args()
    print(f"({given.studies * len(STIFFNESS)} studies a row, seed {given.seed})\n")
    print("| data from | error model | median bias of k/K | beyond the peak | 68 % | 95 % |\n|---|---|---|---|---|---|")
    for name in given.sources:
        began = time.perf_counter()
        with jax.enable_x64(True):
            lengths = np.array([[SOURCES[name](sp.Slider(h, k, 0.3)) for h in HEIGHTS] for k in STIFFNESS])
            true = sp.exact_lengths(sp.Slider(HEIGHTS, STIFFNESS[:, None], 0.3))
        ratio = np.array2string((lengths / true).mean(axis=0), precision=2)
        print(f"({name}: length over the model's {ratio} by height; {time.perf_counter() - began:.0f} s)", file=sys.stderr)
        for label in given.errors:
            began = time.perf_counter()
            print(f"| {name} | {label} | {coverage(lengths, ERRORS[label], given.studies, given.seed)} |", flush=True)
            print(f"({time.perf_counter() - began:.0f} s)", file=sys.stderr)


if __name__ == "__main__":
    main()
