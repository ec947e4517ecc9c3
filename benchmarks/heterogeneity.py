"""What thresholds that scatter from contact to contact do to the first precursor, and to a fit that takes them as uniform.

Blocks of five heights, each with an interface of its own: thresholds 1 + scatter times a normal number for every contact, not below
0.1. The edge is moved until an event breaks at least a quarter of the contacts that the front of the uniform interface would break;
that is taken as the precursor. Five lengths make a study, which `fit` takes as uniform, with errors from the scatter about the fit,
and stiffnesses up to b = 4 for the middle height: beyond lie the peak and the second root.
Run: python -m benchmarks heterogeneity [studies in a cell, 12 by default] [--heights H …] [--b b …] [--scatter S …] [--seed N]
"""

import argparse
import sys
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import slippulse_jax as sp
from benchmarks.fit_coverage import holds

SMALLEST = "1 --heights 25 --b 1 --scatter 0.1"

AROUND = np.array([0.64, 0.8, 1.0, 1.25, 1.5625])
"""Heights of a study, over the one in the middle."""
POISSON, LOWEST, EVENTS, SHARE, SOFT = 0.3, 0.1, 600, 0.25, 4.0


@partial(jax.jit, static_argnames="sites")
def catalogues(slider: sp.Slider, threshold: jax.Array, sites: int):
    """One series per slider, with thresholds (n, sites)."""

    def one(slider, threshold):
        found = sp.series(sp.chain(slider, sites=sites, threshold=threshold), events=EVENTS)
        return found.site, found.leftmost, found.length, found.breaks

    return jax.vmap(one)(slider, threshold)


def cell(height: float, b: float, scatter: float, studies: int, rng: np.random.Generator) -> str:
    """One row of the table."""
    heights = np.tile(height * AROUND, studies)
    stiffness = b / (2 * (1 + POISSON) * height)
    slider = sp.Slider(heights, np.full(heights.shape, stiffness), np.full(heights.shape, POISSON))
    uniform = sp.precursor_lengths(slider)
    sites = int(64 * np.ceil(2 * uniform.max() / 64))
    threshold = np.maximum(1 + scatter * rng.standard_normal((len(heights), sites)), LOWEST)
    site, leftmost, length, breaks = map(np.asarray, catalogues(slider, jnp.asarray(threshold), sites))
    large = breaks >= SHARE * np.ceil(uniform)[:, None]
    there, which = large.any(axis=1), large.argmax(axis=1)
    rows = np.arange(len(heights))
    ratio = (length[rows, which] / uniform)[there]
    stiff = []
    for study in np.split(rows, studies):
        if there[study].all() and np.isfinite(length[study, which[study]]).all():
            m = sp.Measurements(height=heights[study], poisson=POISSON, length=length[study, which[study]])
            bounds = (1e-3 * stiffness, SOFT / b * stiffness)
            found = sp.fit(m, bounds=bounds, intervals="profile")
            held = holds(found.intervals["stiffness"][0.95], stiffness)
            stiff.append((found.values["stiffness"] / stiffness, found.stderrs["stiffness"] is not None, held))
    fits = "– | – | –"
    if stiff:
        values, number, held = np.array(stiff).T
        low, middle, high = np.quantile(values, [0.16, 0.5, 0.84])
        fits = f"{middle:.2f} ({low:.2f}–{high:.2f}) | {number.mean():.0%} | {held.mean():.0%}"
    finite = ratio[np.isfinite(ratio)]
    numbers = [
        f"{height:g} | {b:g} | {scatter:.0%} | {(site[:, 0] > 0).mean():.0%} | {(breaks[:, 0] == 1).mean():.0%}",
        f"{np.median(which[there]):.0f}" if there.any() else "–",
        f"{there.mean():.0%}",
        f"{(leftmost[rows, which] > 0)[there].mean():.0%} | {finite.mean():.2f} ± {finite.std():.2f}"
        if len(finite)
        else "– | –",
        fits,
    ]
    return f"| {' | '.join(numbers)} |".replace("%", " %")


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description="Uniform fits of precursors on interfaces that scatter.")
    asked.add_argument("studies", nargs="?", type=int, default=12)
    asked.add_argument("--heights", nargs="+", type=float, default=[25.0, 100.0, 400.0])
    asked.add_argument("--b", nargs="+", type=float, default=[0.3, 1.0, 3.0])
    asked.add_argument("--scatter", nargs="+", type=float, default=[0.05, 0.1, 0.2])
    asked.add_argument("--seed", type=int, default=16)
    given = asked.parse_args()
    rng = np.random.default_rng(given.seed)
    print(f"({given.studies} studies of {len(AROUND)} blocks a row, seed {given.seed})\n")
    print(
        "| H/λc | b | scatter | first break off the edge | of one contact | events before the precursor | has a precursor"
        " | leaves the edge out | ℓ/ℓ uniform | k/k true: median (16–84 %) | standard error given | 95 % interval holds |"
    )
    print("|" + "---|" * 12)
    for height in given.heights:
        for b in given.b:
            for scatter in given.scatter:
                began = time.perf_counter()
                with jax.enable_x64(True):
                    row = cell(height, b, scatter, given.studies, rng)
                print(row, flush=True)
                print(f"({time.perf_counter() - began:.0f} s)", file=sys.stderr)


if __name__ == "__main__":
    main()
