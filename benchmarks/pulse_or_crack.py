"""What the lengths of six heights say of pulse or crack: fits of either front to lengths of pulses, cracks and ageing contacts.

Six heights, H/λc 200–2000, one areal stiffness; b is that of the tallest block. Lengths of self-healing fronts, whose contacts keep
nothing or a share of their strength, of crack-like ones, and of the first event of contacts that are reborn weak (`Ageing`; none
recovers while the event runs). Each is fitted as a pulse (stiffness), as one with what contacts keep (residual_strength), and as a
crack (stiffness, friction) without scatter, and 200 times with 2 % errors.
Prints a table: for each fit χ² without scatter, the stiffness over the true one, the stress retained over σ_s, and how often χ²
rejects the fit at 5 %.
Run: python -m benchmarks pulse_or_crack [replicates, 200 by default] [--b B …] [--seed N]
"""

import argparse
import itertools
import sys
import time

import jax
import numpy as np
from scipy.special import chdtrc

import slippulse_jax as sp
from slippulse_jax.inference.result.samples import refitted

SMALLEST = "2 --b 1"

HEIGHT, POISSON, SIGMA, LEVEL, SITES = np.geomspace(200, 2000, 6), 0.3, 0.02, 0.05, 4096
KEPT, FRICTIONS, NEWBORN = (0.2, 0.5), (0.1, 0.3, 0.5, 0.7), (0.6, 0.4, 0.2)
FITS: tuple[tuple[str, str, list[str]], ...] = (
    ("r = 0", "domino", ["stiffness"]),
    ("pulse", "domino", ["stiffness", "residual_strength"]),
    ("crack", "crack", ["stiffness", "friction"]),
)


def reborn(slider: sp.Slider, strength: float) -> np.ndarray:
    """Lengths of first events in which contacts that broke hold `strength` times as much, one block after another."""
    found = []
    for height in np.asarray(slider.height):
        chain = sp.chain(sp.Slider(height, slider.stiffness, POISSON), sites=SITES)
        first = sp.series(chain, events=1, ageing=sp.Ageing(strength, 1e9), max_breaks=10**7)
        found.append(float(first.length[0]))
    return np.array(found)


def row(name: str, b: float, length: np.ndarray, stiffness: float, replicates: int, rng: np.random.Generator) -> str:
    """All fits to the same lengths."""
    m = sp.Measurements(HEIGHT, POISSON, length, SIGMA * length)
    drawn = length * (1 + SIGMA * rng.standard_normal((replicates, len(HEIGHT))))
    cells = []
    for _, event, free in FITS:
        fitted = sp.fit(m, free, event=event, intervals="profile")  # pyright: ignore[reportArgumentType]
        means = np.repeat(fitted.problem.prior_mean, replicates, axis=0)
        problem = fitted.problem.with_replicates([(drawn, np.ones_like(drawn))], means)
        _, deviance, _ = refitted(fitted, problem, replicates)
        rejected = float((chdtrc(fitted.dof, deviance) < LEVEL).mean())
        cells += [f"{fitted.deviance:.2f}", f"{fitted.values['stiffness'] / stiffness:.2f}"]
        cells += [f"{fitted.values[retained]:.2f}" for retained in free[1:]]
        cells += [f"{100 * rejected:.0f} %"]
    return f"| {name} | {b:g} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description="Pulse or crack, from lengths alone.")
    asked.add_argument("replicates", nargs="?", type=int, default=200)
    asked.add_argument("--b", nargs="+", type=float, default=[1.0, 3.0])
    asked.add_argument("--seed", type=int, default=16)
    given = asked.parse_args()
    rng = np.random.default_rng(given.seed)
    print(f"({given.replicates} sets of six lengths with {SIGMA:.0%} errors a row, seed {given.seed})\n")
    heads = [[f"{name}: χ²", "k/k true", *["retained"] * (len(free) - 1), "rejected"] for name, _, free in FITS]
    columns = ["lengths of", "b", *itertools.chain(*heads)]
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|", flush=True)
    for b in given.b:
        stiffness = b / (2 * (1 + POISSON) * HEIGHT[-1])
        slider = sp.Slider(HEIGHT, stiffness, POISSON)
        began = time.perf_counter()
        with jax.enable_x64(True):
            every = {"pulse": np.asarray(sp.exact_length(slider))}
            for r in KEPT:
                every[f"pulse, {r:g}"] = np.asarray(sp.exact_length(slider, sp.Interface(residual_strength=r)))
            every |= {f"crack, {x:g}": np.asarray(sp.exact_length(slider, rule=sp.CrackLike(x))) for x in FRICTIONS}
            every |= {f"reborn at {x:g}": reborn(slider, x) for x in NEWBORN}
        for name, length in every.items():
            print(row(name, b, length, stiffness, given.replicates, rng), flush=True)
        print(f"({time.perf_counter() - began:.0f} s)", file=sys.stderr)


if __name__ == "__main__":
    main()
