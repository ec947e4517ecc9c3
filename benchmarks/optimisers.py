"""The optimisers of `fit` on the same studies: Levenberg–Marquardt, optax's L-BFGS and Adam.

Three uses of each, on studies of one, two and four parameters, of lengths with 2 % errors or of counts of whole contacts:

- starts: 32 points drawn evenly over the range searched, one descent from each, nothing else;
- search: the starts that a fit chooses (the local minima of its grid, or the best of 512 Sobol points);
- fit: all of `fit`, whose profiles are Levenberg and Marquardt's under every method, and send the search where they go deeper.

Reached: D lies no more than 10⁻³ above the least that anything found; said so: and the end called itself converged.
Milliseconds: of one start, search or fit (median); optax's methods compile a program for every table.
Adam, by far the slowest, gets every fourth study.
Run: python -m benchmarks optimisers [studies, 20 by default] [beginning of a problem's name …]
"""

import argparse
import sys
import time
from typing import NamedTuple, get_args

import numpy as np

from benchmarks.fit_coverage import SIGMA, stiffness_at
from slippulse_jax import Measurements, Parameter, fit
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.parameters import parameter_set
from slippulse_jax.inference.search.likelihood import make_problem
from slippulse_jax.inference.search.minima import search
from slippulse_jax.inference.search.minimise import Convergence, Method, minimise

SMALLEST = "1 'two: prior'"

STARTS, STEPS, CLOSE = 32, 60, 1e-3
EVERY = {"adam": 4}  # which studies it is given

Free = list[str | Parameter]


class Kind(NamedTuple):
    """Studies of one kind."""

    heights: int
    share: tuple[float, float]  # of the longest length
    free: Free
    prestress: float = 0.0
    whole: bool = False


PHI, POISSON = Parameter("prestress", bounds=(0.0, 0.5)), Parameter("poisson", prior=(0.3, 0.02))
FACTOR = Parameter("model_factor", prior=(1.0, 0.05))
KINDS = {
    "one": Kind(3, (0.4, 0.8), ["stiffness"]),
    "one, near the peak": Kind(3, (0.9, 0.995), ["stiffness"]),
    "two: with φ": Kind(5, (0.4, 0.8), ["stiffness", PHI], prestress=0.15),
    "two: prior on ν, near the peak": Kind(3, (0.9, 0.995), ["stiffness", POISSON]),
    "four: with φ, priors on ν and a factor": Kind(5, (0.4, 0.8), ["stiffness", PHI, POISSON, FACTOR], prestress=0.15),
}
KINDS |= {f"counts: {name}": kind._replace(whole=True) for name, kind in KINDS.items()}


def draw(rng: np.random.Generator, kind: Kind) -> Measurements:
    """Heights of 15–60 λc, at a stiffness where the longest of them is this share of its longest."""
    height = np.sort(rng.uniform(15, 60, kind.heights))
    truth = stiffness_at(float(np.median(height)), rng.uniform(*kind.share))
    length = FirstFront().lengths(Inputs.of(height, truth, 0.3, kind.prestress))
    sigma = SIGMA * length
    measured = length + sigma * rng.standard_normal(len(height))
    if kind.whole:
        measured = np.maximum(np.ceil(measured), 1)
    return Measurements(
        height=height,
        poisson=0.3,
        length=measured,
        length_sigma=sigma,
        kind=["whole" if kind.whole else "length"] * len(height),
    )


class Run(NamedTuple):
    """One use of one method on one study."""

    lowest: np.ndarray  # D at each end, one or many
    converged: np.ndarray  # whether each said so
    seconds: float


def runs(m: Measurements, kind: Kind, method: Method, seed: int) -> list[Run]:
    """By starts, by search, by fit."""
    parameters = parameter_set(m, [Parameter(one) if isinstance(one, str) else one for one in kind.free])
    problem = make_problem(m, parameters)
    points = np.random.default_rng(seed).uniform(parameters.low, parameters.high, (STARTS, problem.p))

    def by_starts() -> tuple[np.ndarray, np.ndarray]:
        end = minimise(problem, points, parameters.low, parameters.high, method=method, max_steps=STEPS)
        return 2 * end.value, end.convergence == Convergence.CONVERGED

    def by_search() -> tuple[np.ndarray, np.ndarray]:
        found = search(problem, method=method, max_steps=STEPS, seed=0)
        return np.array([found.deviance]), np.array([bool(found.minima)])

    def by_fit() -> tuple[np.ndarray, np.ndarray]:
        result = fit(m, kind.free, method=method, max_steps=STEPS)
        return np.array([result.deviance]), np.array([result.converged])

    out = []
    for use in (by_starts, by_search, by_fit):
        began = time.perf_counter()
        lowest, converged = use()
        out.append(Run(lowest, converged, time.perf_counter() - began))
    return out


def table(name: str, kind: Kind, studies: int) -> None:
    """Rows of one problem."""
    found: dict[Method, dict[int, list[Run]]] = {method: {} for method in get_args(Method)}
    for number in range(studies):
        m = draw(np.random.default_rng([number, len(kind.free), kind.whole]), kind)
        for method, own in found.items():
            if number % EVERY.get(method, 1) == 0:
                own[number] = runs(m, kind, method, number)
    least = [min(run.lowest.min() for own in found.values() for run in own.get(number, ())) for number in range(studies)]
    for method, own in found.items():
        cells = []
        for use in range(3):
            pairs = [(three[use], least[number]) for number, three in own.items()]
            reached = np.concatenate([run.lowest <= low + CLOSE for run, low in pairs])
            said = np.concatenate([run.converged for run, _ in pairs])
            spent = 1e3 * np.median([run.seconds / len(run.lowest) for run, _ in pairs])
            cells.append(f"{100 * np.mean(reached):.0f} | {100 * np.mean(reached & said):.0f} | {spent:.0f}")
        print(f"| {name} | {method} | {len(own)} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    """Print one table."""
    asked = argparse.ArgumentParser(description="The optimisers of a fit on the same studies.")
    asked.add_argument("studies", nargs="?", type=int, default=20)
    asked.add_argument("problems", nargs="*", default=list(KINDS), help="beginnings of their names")
    given = asked.parse_args()
    columns = " | ".join(f"{use}: reached, % | and said so, % | ms" for use in ("a start", "search", "fit"))
    print(f"| fitted | method | studies | {columns} |\n|" + "---|" * 12)
    for name, kind in KINDS.items():
        if any(name.startswith(one) for one in given.problems):
            began = time.perf_counter()
            table(name, kind, given.studies)
            print(f"({name}: {time.perf_counter() - began:.0f} s)", file=sys.stderr)


if __name__ == "__main__":
    main()
