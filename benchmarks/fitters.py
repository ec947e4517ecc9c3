"""This package's fit beside scipy.optimize.curve_fit and lmfit: the same counts of whole contacts, the same starts.

A study is one or three counts at heights 15–60 λc: lengths of the model with 2 % of scatter, rounded up to whole contacts.
The others fit ln k to count − ½ with σ² = (2 % of ℓ)² + 1/12, as a user would; their model is the same compiled ℓ*. "Hard" is
the count itself as the model. They start at one value drawn log-uniformly from 1e-5 to 1, or at eight and keep the best; this
package chooses its own starts, but for the row "its search alone", which gets the same one start.

Reached: on the way from the estimate to the true value χ² nowhere rises by more than 3.84 above that of the true value.
Number: the share of studies given an error bar, one of more than a factor e not counted. Holds: of those, the share whose 68 %
bar holds the true value; for this package's intervals (which may be in pieces) too. (lmfit.conf_interval wants two parameters.)
Run: python -m benchmarks fitters [studies, 100 by default]
"""

import sys
import time
import warnings
from collections.abc import Callable
from typing import NamedTuple

import lmfit
import numpy as np
from scipy.optimize import curve_fit

from benchmarks.fit_coverage import SIGMA, model, stiffness_at
from slippulse_jax import Measurements, fit
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.parameters import parameter_set
from slippulse_jax.inference.search.intervals import LEVELS
from slippulse_jax.inference.search.likelihood import make_problem
from slippulse_jax.inference.search.minimise import minimise

SMALLEST = "1"

STARTS = np.log([1e-5, 1.0])
REGIMES = ("three, identifiable", "three, near the plateau", "one, two roots", "one, above the ceiling")

Answer = tuple[float, list[tuple[float, float]]]
"""Estimate of ln k/K, and what its 68 % bar covers."""


class Study(NamedTuple):
    """Counts, and where the fits start."""

    height: np.ndarray
    count: np.ndarray
    sigma: np.ndarray  # of the length itself
    truth: float  # ln k/K; NaN where no stiffness gives these counts
    starts: np.ndarray  # (8,), ln k/K

    @property
    def spread(self) -> np.ndarray:
        """σ with that of a count's rounding."""
        return np.sqrt(self.sigma**2 + 1 / 12)

    def residual(self, theta: float) -> np.ndarray:
        """What least squares sees."""
        return (model(self.height, float(np.exp(theta))) - (self.count - 0.5)) / self.spread

    def reached(self, theta: float) -> bool:
        """Whether the estimate and the true value lie in one valley."""
        if not np.isfinite(theta):
            return False
        way = [float((self.residual(x) ** 2).sum()) for x in np.linspace(self.truth, theta, 41)]
        return max(way) <= way[0] + 3.84


def draw(rng: np.random.Generator, regime: str) -> Study:
    many = 3 if regime.startswith("three") else 1
    height = rng.uniform(15, 60, many)
    middle = float(np.median(height))
    if regime == "one, above the ceiling":
        longest = FirstFront().longest(Inputs.of([middle], 1.0, 0.3), np.array([np.log(1e-6)]), np.array([0.0]))[0]
        length, truth = longest * rng.uniform(1.1, 1.5), np.nan
    else:
        share = rng.uniform(*{REGIMES[0]: (0.4, 0.8), REGIMES[1]: (0.9, 0.995), REGIMES[2]: (0.7, 0.97)}[regime])
        truth = float(np.log(stiffness_at(middle, share)))
        length = model(height, float(np.exp(truth)))
    sigma = SIGMA * length
    noisy = length if regime.startswith("one") else length + sigma * rng.standard_normal(many)
    return Study(height, np.maximum(np.ceil(noisy), 1), sigma, truth, rng.uniform(*STARTS, 8))


def bar(estimate: float, stderr: float | None) -> Answer:
    told = stderr is not None and np.isfinite(stderr) and stderr < 1
    return estimate, [(estimate - stderr, estimate + stderr)] if told else []


def by_curve_fit(study: Study, starts: int = 1, *, hard: bool = False, absolute: bool = True) -> Answer:
    """The best of so many starts."""

    def predicted(height: np.ndarray, theta: float) -> np.ndarray:
        length = model(height, float(np.exp(theta)))
        return np.ceil(length) - 0.5 if hard else length

    found = []
    for start in study.starts[:starts]:
        try:
            best, covariance = curve_fit(
                predicted, study.height, study.count - 0.5, p0=[start], sigma=study.spread, absolute_sigma=absolute
            )
        except RuntimeError:  # more than the calls allowed
            continue
        found.append((float((study.residual(best[0]) ** 2).sum()), float(best[0]), float(np.sqrt(covariance[0, 0]))))
    return bar(*min(found)[1:]) if found else (np.nan, [])


def by_lmfit(study: Study, starts: int = 1, *, absolute: bool = True) -> Answer:
    """The same; ln k/K within the range that this package searches."""
    found = []
    for start in study.starts[:starts]:
        parameters = lmfit.Parameters()
        parameters.add("theta", value=start, min=np.log(1e-6), max=0.0)
        out = lmfit.minimize(lambda p: study.residual(p["theta"].value), parameters, scale_covar=not absolute)
        found.append((out.chisqr, out.params["theta"].value, out.params["theta"].stderr or np.inf))
    return bar(*min(found)[1:])


def measurements(study: Study) -> Measurements:
    kind = ["whole"] * len(study.count)
    return Measurements(height=study.height, poisson=0.3, length=study.count, length_sigma=study.sigma, kind=kind)


def by_fit(study: Study) -> Answer:
    """Of this package, with the standard error that it reports or refuses."""
    result = fit(measurements(study))
    value, error = result.values["stiffness"], result.stderrs["stiffness"]
    return bar(float(np.log(value)), None if error is None else error / value)


def by_intervals(study: Study) -> Answer:
    """Of this package, with its 68 % interval."""
    result = fit(measurements(study))
    pieces = result.intervals["stiffness"][LEVELS[0]]
    return float(np.log(result.values["stiffness"])), [(np.log(piece.low), np.log(piece.high)) for piece in pieces]


def by_search(study: Study) -> Answer:
    """Of this package, Levenberg and Marquardt's search from the one start; no error bar."""
    m = measurements(study)
    q = parameter_set(m, ["stiffness"])
    end = minimise(make_problem(m, q), study.starts[:1, None], q.low, q.high)
    return float(end.theta[0, 0]), []


METHODS: dict[str, Callable[[Study], Answer]] = {
    "curve_fit, hard counts": lambda s: by_curve_fit(s, hard=True),
    "curve_fit, its defaults": lambda s: by_curve_fit(s, absolute=False),
    "curve_fit, absolute_sigma": by_curve_fit,
    "curve_fit, best of 8 starts": lambda s: by_curve_fit(s, 8),
    "lmfit, its defaults": lambda s: by_lmfit(s, absolute=False),
    "lmfit, scale_covar=False": by_lmfit,
    "lmfit, best of 8 starts": lambda s: by_lmfit(s, 8),
    "this package, its search alone": by_search,
    "this package, standard error": by_fit,
    "this package, intervals": by_intervals,
}


def row(method: Callable[[Study], Answer], studies: list[Study]) -> str:
    """Reached, number, holds, and milliseconds a fit."""
    method(studies[0])  # compiled
    began = time.perf_counter()
    found = [method(study) for study in studies]
    spent = 1e3 * (time.perf_counter() - began) / len(studies)
    given = f"{np.mean([bool(pieces) for _, pieces in found]):.0%}"
    if np.isnan(studies[0].truth):
        return f"– | {given} | – | {spent:.0f}"
    pairs = list(zip(studies, found, strict=True))
    reached = f"{np.mean([study.reached(estimate) for study, (estimate, _) in pairs]):.0%}"
    held = [any(low <= study.truth <= high for low, high in pieces) for study, (_, pieces) in pairs if pieces]
    return f"{reached} | {given} | {f'{np.mean(held):.0%}' if held else '–'} | {spent:.0f}"


def main() -> None:
    """Print one table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    warnings.filterwarnings("ignore", message="Covariance of the parameters")
    warnings.filterwarnings("ignore", category=UserWarning, module="lmfit")
    print(f"{count} studies of each kind\n")
    print("| specimens | method | reached | number | holds | ms |\n|---|---|---|---|---|---|")
    for seed, regime in enumerate(REGIMES):
        rng = np.random.default_rng(seed)
        studies = [draw(rng, regime) for _ in range(count)]
        for name, method in METHODS.items():
            print(f"| {regime} | {name} | {row(method, studies)} |", flush=True)


if __name__ == "__main__":
    main()
