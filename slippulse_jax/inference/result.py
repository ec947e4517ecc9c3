"""What a fit found: values, errors, intervals, roots, and whether the data can tell at all."""

import dataclasses
import functools
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.inference.fitted import Fitted, Further, Root, recursion_status
from slippulse_jax.inference.gauges import READINGS
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.objective import Problem
from slippulse_jax.inference.parameters import ParameterSet
from slippulse_jax.inference.profile import Curve, Interval, Rise
from slippulse_jax.inference.search import Found, describe
from slippulse_jax.inference.verdict import Identifiability, Verdict, directions, gravest
from slippulse_jax.status import Outcome

if TYPE_CHECKING:
    from slippulse_jax.inference.bayes import Posterior
    from slippulse_jax.inference.bootstrap import Bootstrap


@dataclasses.dataclass(frozen=True, eq=False)
class FitResult:
    """Outcome of `fit`. Start with `report()`, `identifiability` and `intervals`."""

    measurements: Measurements
    problem: Problem
    request: dict[str, Any]  # the arguments of `fit`
    theta: np.ndarray  # of least deviance, (p,)
    deviance: float
    found: list[Found]  # roots not excluded at 95 %, best first
    curves: dict[str, Curve]  # profile of each parameter asked for
    theta_intervals: dict[str, dict[float, list[Interval]]]
    verdicts: dict[str, Verdict]
    rise: Rise
    testable_dof: int | None
    outcomes: list[str]  # of the starts that did not converge
    attainable: np.ndarray  # longest length of each measurement at any stiffness searched, in λc
    attainable_at: np.ndarray  # k/K where

    @property
    def parameters(self) -> ParameterSet:
        """What was fitted, and how it enters the model."""
        return self.problem.parameters

    @property
    def names(self) -> list[str]:
        """Parameters asked for, by label; inputs fitted beside them because of their errors are in `inputs`."""
        return list(self.verdicts)

    @property
    def identifiability(self) -> Identifiability:
        """The gravest verdict on any parameter asked for."""
        return self.verdicts[gravest(self.verdicts)].identifiability

    @property
    def reason(self) -> str:
        """Why there is no plain standard error; empty where there is one for every parameter."""
        name = gravest(self.verdicts)
        reason = self.verdicts[name].reason
        return f"{name}: {reason}" if reason and len(self.verdicts) > 1 else reason

    @property
    def converged(self) -> bool:
        """Whether every start that mattered ended at a minimum."""
        return not self.outcomes

    @property
    def value(self) -> float:
        """Of the first parameter, in its unit."""
        return self.values[self.names[0]]

    @property
    def log_stderr(self) -> float | None:
        """Standard error of the first θ, which for a positive parameter is its logarithm; None where `reason` says why."""
        return self._theta_stderr(self.names[0])

    @property
    def values(self) -> dict[str, float]:
        """Values of highest likelihood; k/K too where it is one number for all measurements."""
        return self._named(self.theta)

    @property
    def inputs(self) -> dict[str, float]:
        """Fitted values of the inputs that came with errors of their own."""
        return {one.label: float(one.value(t)) for one, t in zip(self.parameters.free, self.theta, strict=True) if one.nuisance}

    @functools.cached_property
    def covariance(self) -> np.ndarray | None:
        """Of all θ, (p, p), from the Fisher information at the best fit; None where that is singular."""
        one = describe(self.problem, self.theta, self.deviance)
        return None if one.singular.any() else one.covariance * self.variance_factor

    @property
    def variance_factor(self) -> float:
        """What σ² is multiplied by: one, but where the size of the errors was taken from the scatter."""
        return self.deviance / self.dof if self.scaled else 1.0

    @property
    def scaled(self) -> bool:
        """Whether the size of the errors was taken from the scatter."""
        return self.rise.dof is not None and self.rise.fitted_variance is None

    def _theta_stderr(self, name: str) -> float | None:
        if self.verdicts[name].identifiability is not Identifiability.IDENTIFIED or self.covariance is None:
            return None
        j = self.parameters.index(name)
        return float(np.sqrt(self.covariance[j, j]))

    @property
    def stderr(self) -> dict[str, float | None]:
        """Standard error of each of `values`, from the Fisher information; None where `verdicts` say why."""
        found: dict[str, float | None] = {}
        for name in self.names:
            error = self._theta_stderr(name)
            one = self.parameters.free[self.parameters.index(name)]
            found[name] = None if error is None else error * (self.values[name] if one.log else 1.0)
        if "stiffness" in self.values and "stiffness" not in found:
            found["stiffness"] = self._ratio_stderr()
        return found

    def _ratio_stderr(self) -> float | None:
        """Of k/K, where λc and E may have errors too."""
        slope = self.parameters.slope[0, 1]
        bad = any(
            v.identifiability is not Identifiability.IDENTIFIED for n, v in self.verdicts.items() if slope[self._index(n)]
        )
        if bad or self.covariance is None:
            return None
        return self.values["stiffness"] * float(np.sqrt(slope @ self.covariance @ slope))

    def _index(self, name: str) -> int:
        return self.parameters.index(name)

    @property
    def intervals(self) -> dict[str, dict[float, list[Interval]]]:
        """Allowed values at each confidence level, in as many pieces as there are."""
        found = {}
        for name, by_level in self.theta_intervals.items():
            one = self.parameters.free[self._index(name)]
            found[name] = {
                level: [p._replace(low=float(one.value(p.low)), high=float(one.value(p.high))) for p in pieces]
                for level, pieces in by_level.items()
            }
        first = self.names[0]
        slope = self.parameters.slope[0, 1]
        if (
            "stiffness" in self.values
            and "stiffness" not in found
            and np.count_nonzero(slope) == 1
            and slope[self._index(first)]
        ):
            scale = self.values["stiffness"] / self.values[first]
            found["stiffness"] = {
                level: [p._replace(low=p.low * scale, high=p.high * scale) for p in pieces]
                for level, pieces in found[first].items()
            }
        return found

    @property
    def level_intervals(self) -> dict[float, list[Interval]]:
        """Of the first parameter."""
        return self.intervals[self.names[0]]

    @property
    def correlations(self) -> dict[tuple[str, str], float]:
        """Correlations between fitted parameters (of their θ); empty where the information is singular."""
        if self.covariance is None:
            return {}
        error = np.sqrt(np.diag(self.covariance))
        names = self.parameters.names
        return {
            (names[i], names[j]): float(self.covariance[i, j] / (error[i] * error[j]))
            for i in range(len(names))
            for j in range(i + 1, len(names))
        }

    @functools.cached_property
    def directions(self) -> list:
        """Combinations of the parameters by how well they are determined."""
        return directions(self.problem, self.theta)

    @functools.cached_property
    def roots(self) -> list[Root]:
        """Minima not excluded at 95 %, best first."""
        return [self._root(one) for one in self.found]

    def _root(self, one: Found) -> Root:
        free = [p for p in self.parameters.free if not p.nuisance]
        values = {p.label: float(p.value(t)) for p, t in zip(self.parameters.free, one.theta, strict=True) if not p.nuisance}
        errors: dict[str, float | None] = dict.fromkeys(values)
        spread = np.where(one.singular, np.nan, np.sqrt(np.diag(one.covariance) * self.variance_factor))
        told = {p.label: float(spread[self._index(p.label)]) for p in free if not one.singular[self._index(p.label)]}
        errors = errors | {p.label: told[p.label] * (values[p.label] if p.log else 1.0) for p in free if p.label in told}
        log_stderr = told.get(free[0].label)
        y = self.parameters.inputs(one.theta)
        rebreaks = recursion_status(y) == Outcome.REBREAK
        return Root(values[free[0].label], values, one.deviance, log_stderr, errors, np.exp(y[:, 1]), rebreaks)

    @functools.cached_property
    def fitted(self) -> Fitted:
        """The model at the best fit: length, whole contacts, and whether the edge contact would break again."""
        length = self.problem.predict(self.theta)[0]
        counted = np.where(np.isfinite(length), np.maximum(np.ceil(np.where(np.isfinite(length), length, 0)), 1), -1)
        return Fitted(length, counted.astype(int), recursion_status(self.parameters.inputs(self.theta)))

    @functools.cached_property
    def further(self) -> list[Further]:
        """What was measured beside the lengths, and the model there."""
        m, found = self.measurements, []
        for block in self.problem.blocks[1:]:
            places = [m.place(i) for i in block.measurement.tolist()]
            if m.gauges is not None and block.observable in READINGS:
                places = [m.gauges.place(i) for i in np.nonzero(m.gauges.there(block.observable))[0].tolist()]
            fitted = self.problem.predict(self.theta, block.observable)[0]
            found.append(Further(block.observable, block.data.value[0], block.data.sigma, fitted, places))
        return found

    @property
    def chi2(self) -> float:
        """Least deviance; χ² (with that of the priors) for plain lengths."""
        return self.deviance

    @property
    def dof(self) -> int:
        """Degrees of freedom: data, with the priors among them, less fitted parameters."""
        return self.problem.count - self.problem.p

    @property
    def p_value(self) -> float | None:
        """Probability of a χ² at least this large if model and σ are right; None where it cannot be had."""
        return None if self.testable_dof is None else float(chdtrc(self.testable_dof, self.deviance))

    @property
    def residuals(self) -> np.ndarray:
        """(fitted − measured)/σ of the lengths, shape (n,); for counts and fronts without arrest what lies outside, else 0."""
        m = self.measurements
        off = self.fitted.length - m.length
        kind = np.array(m.kind)
        off = np.where(kind == "whole", np.where(off > 0, off, np.minimum(off + 1, 0)), off)
        off = np.where(kind == "at_least", np.minimum(off, 0), off)
        sigma = np.ones(len(m)) if m.length_sigma is None else np.where(m.length_sigma > 0, m.length_sigma, 1)
        return off / (sigma * np.sqrt(self.variance_factor))

    @property
    def notes(self) -> list[str]:
        """What a careful reader should know before using the numbers."""
        from slippulse_jax.inference.notes import notes

        return list(notes(self))

    def _named(self, theta: np.ndarray) -> dict[str, float]:
        named = {one.label: float(one.value(t)) for one, t in zip(self.parameters.free, theta, strict=True) if not one.nuisance}
        ratio = self.parameters.ratio(theta)
        # k/K is shown where a stiffness is fitted, and one number
        if np.ptp(ratio) <= 1e-12 * ratio[0] and any("stiffness" in name for name in named):
            named.setdefault("stiffness", float(ratio[0]))
        return named

    def report(self) -> str:
        """Text to read, and to paste into a paper's supplement."""
        from slippulse_jax.inference.report import report

        return report(self)

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {value:.4g}" for name, value in self.values.items())
        return f"FitResult({self.identifiability.name}: {values}; report() says more)"

    def __str__(self) -> str:
        return self.report()

    def to_dict(self) -> dict[str, Any]:
        """Everything of the result as plain Python values, ready for JSON; open ends and missing numbers are None."""
        from slippulse_jax.inference.record import to_dict

        return to_dict(self)

    def bootstrap(self, count: int = 1000, *, kind: str = "parametric", seed: int = 0) -> "Bootstrap":
        """Refits of simulated or resampled measurements: see `slippulse_jax.inference.bootstrap`."""
        from slippulse_jax.inference.bootstrap import bootstrap

        return bootstrap(self, count, kind=kind, seed=seed)

    def posterior(self, *, samples: int = 1000, warmup: int = 500, chains: int = 4, seed: int = 0) -> "Posterior":
        """Posterior by NUTS: see `slippulse_jax.inference.bayes`; needs the extra ``bayes``."""
        from slippulse_jax.inference.bayes import posterior

        return posterior(self, samples=samples, warmup=warmup, chains=chains, seed=seed)
