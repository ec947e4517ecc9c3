"""How often fits of sequences hold the truth, on forces and lengths of an independent finite-element program.

Every study is another block of H/λc 30–40, 2.5 to 3.5 heights long, with b from 0.3 to 3, a friction of 0.2–0.5, and a pusher of
0.1 H at 0.1–0.25 H. Forces have errors of 1 %; places 0.5 %, arrests of numbered events 3 %. A kind is one of

places      forces at ten places and at the end; stiffness and friction fitted
events      events that advance by more than 1.5 contacts
first       the first of these; stiffness fitted, at the true friction

and any of, joined by ``_``,

load        the normal load fitted too
ageing      contacts that age; newborn and time_constant fitted too
keeping     contacts that keep 0 to 0.6 of their strength; residual_strength fitted too
measured    thresholds whose scatter is drawn from its prior, of provenance measured: that prior is fitted too
scattered   thresholds that scatter by 5 %; threshold_scatter is held at that
uniform     the same, fitted as if they did not scatter
fitted      the same as uniform, with model_error = "fitted"

Of a table of fewer rows, places stand further apart, and events are drawn from those that were seen. With --scatter every
scatter is that.

Run: python -m benchmarks sequence_coverage [kind …] [--studies N, 100 by default] [--rows N, 11 by default] [--scatter S] [--seed N]
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

import slippulse_jax as sp
from benchmarks.fit_coverage import Share, holds
from slippulse_jax.inference.fit import FitResult
from slippulse_jax.inference.parameters import USUAL_SCATTER
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.intervals import LEVELS
from slippulse_jax.inference.search.learning import model_error_of

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "fit_examples"))

import independent_block  # pyright: ignore[reportMissingImports]
import independent_sequence  # pyright: ignore[reportMissingImports]

SMALLEST = "--studies 1 places_ageing events"

HEIGHT, YOUNG, POISSON, NORMAL, LOAD, WIDTH, PUSHER = 30.0, 3.0, 0.3, 1.2, 1000.0, 10.0, 0.1  # mm, GPa, N; k_n/k; over H
OF_FORCE, OF_PLACE, OF_ARREST, SCATTER, MOST_KEPT = 0.01, 0.005, 0.03, 0.05, 0.6
ROWS = 11
BY = ("places", "events", "first")
KINDS = (
    "places", "places_load", "places_ageing", "events", "places_keeping", "events_keeping", "places_scattered",
    "places_uniform", "places_fitted", "events_measured",
)  # fmt: skip


class Study(NamedTuple):
    """A block, what is measured of it, and how it is fitted."""

    table: dict[str, Any]
    free: list[str]
    options: dict[str, Any]
    truth: dict[str, float]


def study(kind: str, random: np.random.Generator, rows: int = ROWS, scatter: float | None = None) -> Study:
    """Draw a block and what is measured of it, in so many rows; of numbered events, in at most so many if fewer than 11."""
    by, *more = kind.split("_")
    b, friction, at = np.exp(random.uniform(np.log(0.3), np.log(3))), random.uniform(0.2, 0.5), random.uniform(0.1, 0.25)
    contacts, lengths = int(random.choice([30, 36, 40])), random.choice([2.5, 3.0, 3.5])
    ageing = (random.uniform(0.3, 0.85), np.exp(random.uniform(np.log(0.4), np.log(3)))) if "ageing" in more else None
    sites, contact = round(lengths * contacts), HEIGHT / contacts
    mean, error = USUAL_SCATTER
    usual = mean * np.exp(error / mean * random.standard_normal()) if "measured" in more else SCATTER
    scatter = usual if scatter is None else scatter
    differ = {"scattered", "uniform", "fitted", "measured"} & {*more}
    threshold = random.normal(1, scatter, sites) if differ else 1.0
    low, high = (at - PUSHER / 2) * contacts, (at + PUSHER / 2) * contacts
    elastic = independent_block.responses(contacts, sites, low, high, b / (2 * (1 + POISSON) * contacts), POISSON, NORMAL)
    kept, numbered = random.uniform(0, MOST_KEPT) if "keeping" in more else 0.0, by != "places"
    events = independent_sequence.sequence(*elastic, friction, threshold, ageing, kept)
    if numbered:
        events = independent_sequence.visible(events)
    reached = np.minimum(np.maximum.accumulate([event.length for event in events]), sites)
    forces = np.array([event.force for event in events])
    place = reached if numbered else np.append(np.linspace(0.1, 0.95, rows - 1) if rows > 2 else 0.5, 1.0) * sites
    force = friction * LOAD * forces[np.searchsorted(reached, place - 1e-9)]
    number = 1 + np.arange(place.size)
    if by == "first":
        place, force, number = place[:1], force[:1], number[:1]
    elif numbered and rows < min(ROWS, place.size):
        some = np.sort(random.permutation(place.size)[:rows])
        place, force, number = place[some], force[some], number[some]
    spans, error = place >= sites, (OF_ARREST if numbered else OF_PLACE) * place
    noise = random.standard_normal((2, place.size))
    measured = np.where(spans, place, np.minimum(place + error * noise[0], sites))
    table = {
        "height_mm": HEIGHT, "block_length_mm": sites * contact, "block_width_mm": WIDTH,
        "correlation_length_um": 1e3 * contact, "poisson": POISSON, "young_GPa": YOUNG, "normal_stiffness": NORMAL,
        "push_height_mm": at * HEIGHT, "push_width_mm": PUSHER * HEIGHT, "force_N": force * (1 + OF_FORCE * noise[1]),
        "force_sigma_N": OF_FORCE * force, "length_mm": measured * contact,
        "length_sigma_mm": np.where(spans, np.nan, error * contact), "spans": np.where(spans, "yes", "no"),
    }  # fmt: skip
    table |= {} if "load" in more else {"normal_load_N": LOAD}
    table |= {"event": number} if numbered else {}
    table |= {"provenance": "measured"} if "measured" in more else {}
    truth = {"areal_stiffness": b * YOUNG * 1e9 / (2 * (1 + POISSON) * HEIGHT * 1e-3)}
    truth |= {} if by == "first" else {"friction": friction}
    truth |= {"normal_load": LOAD / (WIDTH * 1e-3)} if "load" in more else {}
    truth |= {"residual_strength": kept} if "keeping" in more else {}
    truth |= dict(zip(("newborn", "time_constant"), ageing, strict=True)) if ageing is not None else {}
    held = {"friction": friction} if by == "first" else {}
    held |= {"threshold_scatter": scatter} if "scattered" in more else {}
    options = {"fixed": held, **({"model_error": "fitted"} if "fitted" in more else {})}
    return Study(table, ["stiffness", *[*truth][1:]], options, truth)


class Tally:
    """What became of the fits of one kind."""

    def __init__(self) -> None:
        self.held: dict[str, list[list[bool]]] = {}
        self.pulls: dict[str, list[float]] = {}
        self.off: dict[str, list[float]] = {}
        self.wide: dict[str, list[float]] = {}
        self.far, self.refused, self.large, self.count = 0, 0, 0, 0

    def add(self, found: FitResult, truth: dict[str, float]) -> None:
        """Compare a fit with the truth."""
        self.count += 1
        self.refused += found.identifiability is Identifiability.POOR_FIT
        self.large += model_error_of(found.problem) >= 0.02
        if found.identifiability is Identifiability.POOR_FIT:
            return
        for name, true in truth.items():
            within = [holds(found.intervals[name][level], true) for level in LEVELS]
            self.held.setdefault(name, []).append(within)
            inner = found.intervals[name][LEVELS[0]]
            log = found.parameters.named(name).log
            ends = [np.log(x) if log else x for x in (inner[0].low, inner[-1].high)] if inner else [-np.inf, np.inf]
            self.wide.setdefault(name, []).append((ends[1] - ends[0]) / 2)
            self.off.setdefault(name, []).append(np.log(found.values[name] / true) if log else found.values[name] - true)
            error = found.stderrs[name]
            if error is not None:
                self.pulls.setdefault(name, []).append((found.values[name] - true) / error)
                self.far += abs(self.pulls[name][-1]) > 3

    def show(self, kind: str) -> None:
        """Print a table."""
        print(f"\n{kind}: {self.count} studies, {self.refused} refused by χ², {self.large} with a model error of 0.02 or more")
        for name, held in self.held.items():
            shares = ", ".join(
                f"{level:.0%} {Share(int(sum(x)), len(x))}" for level, x in zip(LEVELS, zip(*held, strict=True), strict=True)
            )
            pulls = np.array(self.pulls.get(name, []))
            low, middle, high = np.quantile(self.off[name], [0.16, 0.5, 0.84])
            print(f"  {name:16} intervals hold the truth: {shares}; 68 % are ± {np.median(self.wide[name]):.2g} wide", end="")
            print(f"; off by {middle:+.2g} ({low:+.2g} to {high:+.2g}); {pulls.size} standard errors", end="")
            if pulls.size:
                quartiles = np.ptp(np.quantile(pulls, [0.25, 0.75])) / 1.349
                print(f", pulls {pulls.mean():+.2f}, spread {pulls.std():.2f} ({quartiles:.2f} by quartiles)", end="")
            print()
        print(f"  {self.far} numbers off by more than three of their errors")


def coverage(studies: int, kind: str, seed: int = 0, rows: int = ROWS, scatter: float | None = None) -> Tally:
    """Fit so many studies of a kind, each of so many rows."""
    tally = Tally()
    for number in range(studies):
        one = study(kind, np.random.default_rng([seed, number]), rows, scatter)
        tally.add(sp.fit(pd.DataFrame(one.table), one.free, **one.options), one.truth)
    return tally


def main() -> None:
    """Print the tables."""
    asked = argparse.ArgumentParser(description="Coverage of fits of sequences.")
    asked.add_argument("--studies", type=int, default=100)
    asked.add_argument("kinds", nargs="*", metavar="kind", help=f"of {', '.join(KINDS)}; all by default")
    asked.add_argument("--rows", type=int, default=ROWS)
    asked.add_argument("--scatter", type=float)
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    if wrong := [kind for kind in given.kinds if kind.split("_")[0] not in BY]:
        asked.error(f"{wrong[0]}: must begin with one of {', '.join(BY)}")
    for kind in given.kinds or KINDS:
        began = time.perf_counter()
        coverage(given.studies, kind, given.seed, given.rows, given.scatter).show(kind)
        print(f"  {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
