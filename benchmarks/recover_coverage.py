"""How often the errors of a recovered profile hold the truth, wherever the events start.

Eight blocks of H/λc 5–30 with k/K = 0.03 on one interface, errors of 0.1 or 0.4 λc; thresholds or prestress drawn from smooth
priors. The lengths are those of a dense program that breaks the most overloaded contact again and again, from the first that
reaches its threshold on. Prints a table, every share with its sampling error.
Run: python -m benchmarks recover_coverage [studies of each kind, 500 by default] [kind …] [--seed N]
"""

import argparse
import sys
import time
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

import slippulse_jax as sp
from slippulse_jax.inference.recover import Determination, RecoveredProfile
from slippulse_jax.inference.search.intervals import LEVELS

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from oracles.dense_chain import responses  # pyright: ignore[reportMissingImports]

SMALLEST = "1"

STIFFNESS, POISSON, SITES = 0.03, 0.3, 128
HEIGHTS = np.linspace(5, 30, 8)
LONGEST = 60.0
X = np.arange(SITES, dtype=float)
PLACES = 6


class Event(NamedTuple):
    """Of the first precursor of one block."""

    length: float  # ℓ, in λc; inf if it ran through
    start: int  # the contact that broke first
    left: int  # the leftmost that broke


class Study(NamedTuple):
    """A profile, and what was measured on it."""

    truth: np.ndarray  # (SITES,), ln θ or φ
    measurements: sp.Measurements
    start: np.ndarray  # (n,)


class Outcome(NamedTuple):
    """What a recovery made of one study, at `PLACES` places."""

    found: RecoveredProfile
    inside: np.ndarray  # (2, places), whether the intervals of 68 and 95 % hold the truth
    determined: np.ndarray
    start: int  # farthest contact at which an event started


@cache
def transfer(height: float) -> tuple[np.ndarray, np.ndarray]:
    """Stress on every contact per load of the edge, and per stress released at each, of the dense chain."""
    load, pinning = responses(height, STIFFNESS, POISSON, 2 * SITES, "semi-infinite", SITES)
    return load / load[0], pinning


def event(height: float, threshold: np.ndarray, prestress: np.ndarray) -> Event:
    """Load until a contact reaches its threshold; break the most overloaded until none is."""
    driven, pinning = transfer(height)
    wait = (threshold - prestress) / driven
    site = start = int(wait.argmin())
    stress, overload = prestress + wait[start] * driven, {}
    while not overload or stress[site] >= threshold[site]:
        overload[site], released = stress[site] - threshold[site], stress[site]
        stress = stress + pinning[:, site] * released
        stress[site] -= released
        site = int((stress - threshold).argmax())
    last = max(overload)
    if last == SITES - 1:
        return Event(np.inf, start, min(overload))
    behind = max(overload[last], 0.0)
    return Event(last + behind / (behind - (stress - threshold)[last + 1]), start, min(overload))


def study(rng: np.random.Generator, kind: str) -> Study:
    """A profile on which all events stop within 60 λc, chosen by the truth alone, and its lengths with errors."""
    while True:
        amplitude, scale = rng.choice([0.01, 0.03, 0.1]), rng.choice([8.0, 15.0, 30.0])
        prior = amplitude**2 * np.exp(-((X[:, None] - X) ** 2) / (2 * scale**2))
        if kind == "threshold":
            prior = prior - np.outer(prior[:, 0], prior[0]) / prior[0, 0]
        truth = np.linalg.cholesky(prior + 1e-12 * np.eye(SITES)) @ rng.standard_normal(SITES)
        truth = truth - truth[0] if kind == "threshold" else truth + 0.15
        threshold, prestress = (np.exp(truth), 0 * X) if kind == "threshold" else (1 + 0 * X, truth)
        events = [event(h, threshold, prestress) for h in HEIGHTS.tolist()]
        length = np.array([one.length for one in events])
        sigma = rng.choice([0.1, 0.4])
        if length.min() > 2 and length.max() < LONGEST and max(one.left for one in events) == 0:
            break
    m = sp.Measurements(
        height=HEIGHTS, poisson=POISSON, length=length + sigma * rng.standard_normal(len(HEIGHTS)), length_sigma=sigma
    )
    return Study(truth, m, np.array([one.start for one in events]))


def recover(one: Study, kind: str) -> Outcome:
    """Recover the profile, and compare it with the truth."""
    found = sp.recover_profile(one.measurements, stiffness=STIFFNESS, kind=kind)  # pyright: ignore[reportArgumentType]
    at = np.linspace(3, one.measurements.length.max(), PLACES).round()
    nearest = abs(found.position[:, None] - at).argmin(axis=0)
    truth = np.interp(found.position[nearest], X, one.truth)
    truth = np.exp(truth) if kind == "threshold" else truth
    ends = [[end[nearest] for end in found.interval(level)] for level in LEVELS]
    inside = np.array([(low <= truth) & (truth <= high) for low, high in ends])
    return Outcome(found, inside, found.determined[nearest], int(one.start.max()))


GIVEN_UP = (Determination.NOT_CONVERGED, Determination.NOT_EXPLAINED)


class Held(NamedTuple):
    """How often the intervals of 68 and 95 % hold the truth at the places chosen."""

    studies: int
    places: int
    share: np.ndarray  # (2,)
    error: np.ndarray  # (2,), sampling error: that of the mean over studies, whose places err together


class Tally(NamedTuple):
    """Studies recovered, and the number given up."""

    outcomes: list[Outcome]
    given_up: int

    def held(self, start: str = "anywhere", *, determined: bool = False) -> Held:
        """Count places, all or those called determined, in studies whose events start "anywhere", at the "edge" or "inside"."""
        wanted = {"anywhere": lambda one: True, "edge": lambda one: one.start == 0, "inside": lambda one: one.start > 0}[start]
        chosen = [one.inside[:, one.determined] if determined else one.inside for one in self.outcomes if wanted(one)]
        chosen = [inside for inside in chosen if inside.shape[1]]
        hits, tries = np.array([one.sum(axis=1) for one in chosen]).T.reshape(2, -1), np.array([one.shape[1] for one in chosen])
        places = int(tries.sum())
        share = hits.sum(axis=1) / max(places, 1)
        error = np.sqrt(((hits - share[:, None] * tries) ** 2).sum(axis=1)) / max(places, 1)
        return Held(len(chosen), places, share, error)


def coverage(studies: int, kind: str, seed: int) -> Tally:
    """Recover so many profiles of one kind."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    outcomes = [recover(study(rng, kind), kind) for _ in range(studies)]
    kept = [one for one in outcomes if one.found.determination not in GIVEN_UP]
    return Tally(kept, studies - len(kept))


KINDS = ("threshold", "prestress")


def main() -> None:
    """Print one table."""
    asked = argparse.ArgumentParser(description="Coverage of recovered profiles.")
    asked.add_argument("studies", nargs="?", type=int, default=500)
    asked.add_argument("kinds", nargs="*", default=list(KINDS))
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    print("| profile | events start | places | studies | number | 68 % | 95 % |\n|---|---|---|---|---|---|---|")
    for kind in given.kinds:
        began = time.perf_counter()
        found = coverage(given.studies, kind, given.seed)
        for start in ("anywhere", "edge", "inside"):
            for determined in (False, True):
                held = found.held(start, determined=determined)
                cells = [f"{100 * share:.1f} ± {100 * error:.1f}" for share, error in zip(held.share, held.error, strict=True)]
                of = "determined" if determined else "all"
                print(f"| {kind} | {start} | {of} | {held.studies} | {held.places} | {' | '.join(cells)} |", flush=True)
        print(f"({found.given_up} given up; {time.perf_counter() - began:.0f} s)", file=sys.stderr)


if __name__ == "__main__":
    main()
