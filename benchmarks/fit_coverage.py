"""How often the intervals of a fit hold the truth, and how often degenerate studies are refused a number.

Prints two tables, every share with its own sampling error. Run: python -m benchmarks fit_coverage [studies, 500 by default]
[part …] [--seed N] [--profile-only], a part being identifiable, near-plateau (with :1, :3 or :8 for so many specimens alone) or
degenerate.

With one specimen whose length some stiffness gives, the rise of D at the true value is the square of the one error drawn, in σ:
the 68 % interval holds the truth if and only if that error is below σ. The share of such errors is printed as `errors within`.
"""

import argparse
import sys
import time
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from slippulse_jax import Measurements, Parameter, fit
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.intervals import LEVELS, Interval, calibrated

SMALLEST = "1 --profile-only"

SIGMA = 0.02  # of the length
REGIMES = ("identifiable", "near-plateau")


class Share(NamedTuple):
    """So many of so many."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        return self.hits / max(self.of, 1)

    @property
    def error(self) -> float:
        """Standard deviation of a binomial share."""
        return float(np.sqrt(self.value * (1 - self.value) / max(self.of, 1)))

    def __str__(self) -> str:
        return f"{100 * self.value:.1f} ± {100 * self.error:.1f}"


def holds(pieces: Iterable[Interval], truth: float) -> bool:
    """Whether an interval, which may be in pieces, holds the true value."""
    return any(piece.low <= truth <= piece.high for piece in pieces)


def model(height: np.ndarray, stiffness: float, poisson: float = 0.3) -> np.ndarray:
    """ℓ* in λc."""
    return FirstFront().lengths(Inputs.of(height, stiffness, poisson))


def stiffness_at(height: float, share: float) -> float:
    """k/K below the peak at which the length is this share of the longest."""
    longest, top = FirstFront().longest(Inputs.of([height], 1.0, 0.3), np.array([np.log(1e-4)]), np.array([0.0]))
    log_stiffness = np.linspace(np.log(1e-4), top[0], 401)
    length = FirstFront().lengths(Inputs.of(height, np.exp(log_stiffness), 0.3))
    return float(np.exp(np.interp(share * longest[0], length, log_stiffness)))


def study(rng: np.random.Generator, specimens: int, regime: str) -> tuple[Measurements, float]:
    """Heights 15–60 λc, 2 % errors; stiffness where lengths respond, or where they are 90–99.5 % of the longest attainable."""
    height = rng.uniform(15, 60, specimens)
    share = rng.uniform(0.4, 0.8) if regime == "identifiable" else rng.uniform(0.9, 0.995)
    truth = stiffness_at(float(np.median(height)), share)
    length = model(height, truth)
    sigma = SIGMA * length
    return Measurements(
        height=height, poisson=0.3, length=length + sigma * rng.standard_normal(specimens), length_sigma=sigma
    ), truth


def coverage(studies: int, specimens: int, regime: str, seed: int, *, careful: bool = True) -> dict[str, list[Share]]:
    """Of how many studies the intervals hold the truth: profile, calibrated (if `careful`), and from the covariance."""
    rng = np.random.default_rng([REGIMES.index(regime), specimens, seed])
    names = ("errors within", "profile", "calibrated", "covariance", "covariance, where a standard error is given")
    hits = {name: [0, 0] for name in names if (careful or name != "calibrated") and (specimens == 1 or name != "errors within")}
    given = 0
    for number in range(studies):
        m, truth = study(rng, specimens, regime)
        plain = fit(m, intervals="profile")
        intervals = {"profile": plain.intervals["stiffness"]}
        if careful:
            found, _ = calibrated(plain.problem, number)
            intervals["calibrated"] = {level: _values(pieces) for level, pieces in found.items()}
        best = plain.roots[0] if plain.roots else None
        error = best and best.stderrs["stiffness"]
        told = plain.identifiability is Identifiability.IDENTIFIED
        given += told
        for i, (level, reach) in enumerate(zip(LEVELS, (1.0, 1.96), strict=True)):
            for name, pieces in intervals.items():
                hits[name][i] += holds(pieces[level], truth)
            if specimens == 1:
                hits["errors within"][i] += bool(abs(m.length[0] - model(m.height, truth)[0]) <= reach * m.sigma[0])
            inside = (
                error is not None and abs(np.log(best.values["stiffness"] / truth)) <= reach * error / best.values["stiffness"]
            )
            hits["covariance"][i] += inside
            hits["covariance, where a standard error is given"][i] += inside and told
    shares = {name: [Share(hit, given if "given" in name else studies) for hit in pair] for name, pair in hits.items()}
    shares["standard error given"] = [Share(given, studies)]
    return shares


def _values(pieces: list[Interval]) -> list[Interval]:
    return [piece._replace(low=np.exp(piece.low), high=np.exp(piece.high)) for piece in pieces]


def degenerate(rng: np.random.Generator, kind: str) -> bool:
    """Whether a study that cannot give a number is refused one."""
    height = rng.uniform(15, 60, 3)
    truth = np.exp(rng.uniform(*np.log([1e-3, 6e-3])))
    if kind == "k and E both free":
        length = model(100 * height, 1e-2 * truth)
        m = Measurements(
            height=100 * height, poisson=0.3, length=length * (1 + SIGMA * rng.standard_normal(3)), length_sigma=SIGMA * length,
            correlation_length=1e-5, young=3e9,
        )  # fmt: skip
        free: list = ["stiffness", Parameter("young")]
    elif kind == "one specimen, two roots":
        # so long that the second root lies within the range searched, below k/K = 1
        length = model(height[:1], stiffness_at(float(height[0]), rng.uniform(0.7, 0.97)))
        m, free = Measurements(height=height[:1], poisson=0.3, length=length, length_sigma=SIGMA * length), ["stiffness"]
    elif kind == "length above the ceiling":
        longest = FirstFront().longest(Inputs.of(height[:1], 1.0, 0.3), np.array([np.log(1e-6)]), np.array([0.0]))[0]
        length = longest * rng.uniform(1.02, 1.5)
        m, free = Measurements(height=height[:1], poisson=0.3, length=length, length_sigma=SIGMA * length), ["stiffness"]
    else:
        length = model(height, truth) * rng.uniform(0.3, 1)
        m = Measurements(height=height, poisson=0.3, length=length, length_sigma=SIGMA * length, kind=["at_least"] * 3)
        free = ["stiffness"]
    result = fit(m, free)
    return result.identifiability is not Identifiability.IDENTIFIED and all(
        result.stderrs[name] is None for name in result.names
    )


DEGENERATE = ("k and E both free", "one specimen, two roots", "length above the ceiling", "every front ran past")


def main() -> None:
    """Print both tables, or the part asked for."""
    asked = argparse.ArgumentParser(description="Coverage of the intervals of a fit.")
    asked.add_argument("studies", nargs="?", type=int, default=500)
    asked.add_argument("parts", nargs="*", default=["identifiable", "near-plateau", "degenerate"])
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--profile-only", action="store_true", help="leave out calibrated intervals, most of the time taken")
    given = asked.parse_args()
    studies, parts = given.studies, given.parts
    for part in [part for part in parts if part != "degenerate"]:
        regime, _, only = part.partition(":")
        print(
            f"| regime | specimens | interval | 68 % | 95 % |  ({studies} studies each, seed {given.seed})\n|---|---|---|---|---|"
        )
        for specimens in [int(only)] if only else [1, 3, 8]:
            began = time.perf_counter()
            found = coverage(studies, specimens, regime, seed=given.seed, careful=not given.profile_only)
            for name, shares in found.items():
                print(f"| {regime} | {specimens} | {name} | " + " | ".join(map(str, shares)) + " |", flush=True)
            print(f"({time.perf_counter() - began:.0f} s)", file=sys.stderr)
    if "degenerate" in parts:
        print("\n| degenerate study | refused a number |\n|---|---|")
        for number, kind in enumerate(DEGENERATE):
            rng = np.random.default_rng(number)
            refused = sum(degenerate(rng, kind) for _ in range(studies))
            print(f"| {kind} | {refused} of {studies} |", flush=True)


if __name__ == "__main__":
    main()
