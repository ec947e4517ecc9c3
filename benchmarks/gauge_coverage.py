"""How often gauges along the interface, with counted contacts, hold the true stiffness and strength.

Two blocks of H/λc 20–50 with k/K = 0.005–0.05 and σ_s = 2 MPa. Slip (± 0.05 µm) and stress (± 0.06 MPa) after arrest at nine
gauges each, by a dense program that breaks the most overloaded contact until none is; the contacts that broke were counted. The
deviance of a fit is scanned over the stiffness, the strength taken where it is least, which follows in closed form.
Prints a table, every share with its sampling error: studies in which every contact broke once, and in which some broke again; and
the share in which `fit` would say, by χ², that the model does not describe the data.
Run: python -m benchmarks gauge_coverage [studies, 500 by default] [--seed N]
"""

import argparse
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

import slippulse_jax as sp
from benchmarks.fit_coverage import Share
from slippulse_jax.inference.model.front import IMPROBABLE
from slippulse_jax.inference.parameters import parameter_set
from slippulse_jax.inference.search.intervals import LEVELS
from slippulse_jax.inference.search.likelihood import make_problem

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from oracles import dense_chain  # pyright: ignore[reportMissingImports]

SMALLEST = "5"

LC, YOUNG, STRENGTH, POISSON = 1e-4, 3e9, 2e6, 0.3
SIGMA = 0.05e-6, 0.06e6
SITES = 120
GAUGES = 9
SCANNED = 0.2  # either side of ln k


class Study(NamedTuple):
    """What was measured, and the truth; the strength is `STRENGTH`."""

    measurements: sp.Measurements
    stiffness: float  # areal, in Pa/m
    again: int  # breaks of contacts that had broken


class Event(NamedTuple):
    """First precursor of one block, and the fields after it, contact by contact."""

    contacts: int  # that broke
    slip: np.ndarray  # in u_s
    stress: np.ndarray  # in σ_s
    again: int  # breaks beyond one per contact


def event(height: float, stiffness: float) -> Event:
    """Load until contact 0 is at its threshold, break the most overloaded until none is; the whole chain is solved."""
    load, pinning = dense_chain.responses(height, stiffness, POISSON, 2 * SITES, "semi-infinite", SITES)
    stress, moved, breaks, site = load / load[0], np.zeros(SITES), 0, 0
    while not breaks or stress[site] >= 1:
        released = stress[site]
        stress = stress + pinning[:, site] * released
        stress[site] -= released
        moved[site] += released
        breaks += 1
        site = int(stress.argmax())
    count = int(np.flatnonzero(moved)[-1]) + 1
    return Event(count, pinning @ moved, stress, breaks - count)


def study(rng: np.random.Generator) -> Study:
    """Two blocks of one stiffness."""
    return measured(rng.uniform(20, 50, 2), float(np.exp(rng.uniform(*np.log([0.005, 0.05])))), rng)


def measured(heights: np.ndarray, ratio: float, rng: np.random.Generator) -> Study:
    """Blocks of one k/K; gauges at contacts, from the edge to 1.3 times the length."""
    unit = STRENGTH / (ratio * YOUNG / LC)  # u_s, in m
    events, columns = [event(height, ratio) for height in heights.tolist()], []
    for row, one in enumerate(events):
        i = np.linspace(1, 1.3 * one.contacts, GAUGES).round().astype(int)
        columns.append(np.stack([np.full(GAUGES, row), i * LC, one.slip[i] * unit, one.stress[i] * STRENGTH]))
    row, position, slip, stress = np.concatenate(columns, axis=1)
    slip, stress = (x + s * rng.standard_normal(len(x)) for x, s in zip((slip, stress), SIGMA, strict=True))
    m = sp.Measurements(
        height=heights, poisson=POISSON, length=[one.contacts for one in events], length_sigma=0.0, kind=("whole",) * len(heights),
        correlation_length=LC, young=YOUNG, gauges=sp.Gauges(row, position, slip, SIGMA[0], stress, SIGMA[1]),
    )  # fmt: skip
    return Study(m, ratio * YOUNG / LC, sum(one.again for one in events))


def rises(one: Study) -> np.ndarray:
    """Rise of the deviance at the truth: of both parameters, of the stiffness, of the strength; and its least value."""
    m = one.measurements
    problem = make_problem(m, parameter_set(m, ["stiffness", "strength"]))
    log_stiffness = np.log(one.stiffness) + np.concatenate([[0], np.linspace(-SCANNED, SCANNED, 401)])
    theta = np.column_stack([log_stiffness, np.full(len(log_stiffness), np.log(STRENGTH))])
    assert m.gauges is not None
    pairs = [("slip", m.gauges.slip, SIGMA[0]), ("stress", m.gauges.stress, SIGMA[1])]
    of = {data.observable.name: data for data in problem.observed}
    predicted = np.concatenate([problem.predicted(theta, of[name]) / sigma for name, _, sigma in pairs], axis=1)
    read = np.concatenate([np.asarray(values) / sigma for _, values, sigma in pairs])
    at_strength = 2 * problem(theta).value
    counts = at_strength - ((read - predicted) ** 2).sum(axis=1)
    # readings are proportional to the strength
    factor = predicted @ read / (predicted**2).sum(axis=1)
    profile = counts + ((read - factor[:, None] * predicted) ** 2).sum(axis=1)
    least = profile.min()
    return np.array([at_strength[0] - least, profile[0] - least, at_strength.min() - least, least])


class Held(NamedTuple):
    """Shares of studies whose regions and intervals of 68 and 95 % hold the truth."""

    region: list[Share]  # of stiffness and strength together
    stiffness: list[Share]
    strength: list[Share]
    refused: Share  # studies whose χ² is improbable


def coverage(studies: int, seed: int) -> dict[str, Held]:
    """By whether every contact broke once, or some again."""
    rng = np.random.default_rng(seed)
    found: dict[str, list[np.ndarray]] = {"once": [], "again": []}
    for _ in range(studies):
        one = study(rng)
        found["again" if one.again else "once"].append(rises(one))
    limits = [[-2 * np.log(1 - level) for level in LEVELS], *([chdtri(1, 1 - level) for level in LEVELS] for _ in range(2))]
    result = {}
    for name, rows in found.items():
        if rows:
            column = np.array(rows).T
            held = [[Share(int((column[j] <= x).sum()), len(rows)) for x in limits[j]] for j in range(3)]
            refused = chdtrc(4 * GAUGES, column[3]) < IMPROBABLE
            result[name] = Held(*held, Share(int(refused.sum()), len(rows)))
    return result


def main() -> None:
    """Print one table."""
    asked = argparse.ArgumentParser(description="Coverage of gauges with counted contacts.")
    asked.add_argument("studies", nargs="?", type=int, default=500)
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    began = time.perf_counter()
    print("| contacts broke | studies | of | 68 % | 95 % |\n|---|---|---|---|---|")
    for name, held in coverage(given.studies, given.seed).items():
        for of in ("region", "stiffness", "strength"):
            shares = getattr(held, of)
            print(f"| {name} | {shares[0].of} | {of} | {shares[0]} | {shares[1]} |", flush=True)
        print(f"(χ² refuses {held.refused} % of those that broke {name})")
    print(f"({time.perf_counter() - began:.0f} s)", file=sys.stderr)


if __name__ == "__main__":
    main()
