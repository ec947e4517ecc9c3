"""Result of a fit, with its errors, verdicts and report."""

import dataclasses
import functools
import itertools
import json
import os
from typing import Any, NamedTuple

import numpy as np

from slippulse_jax.base.files import write_atomically
from slippulse_jax.inference.model.front import Regime
from slippulse_jax.inference.observables import Observable
from slippulse_jax.inference.parameters import STIFFNESSES, ParameterSet
from slippulse_jax.inference.result import predicted, record, samples
from slippulse_jax.inference.result import report as printer
from slippulse_jax.inference.result.changes import find_changes, total, total_intervals, total_of_ratio
from slippulse_jax.inference.result.remarks import notes
from slippulse_jax.inference.result.suggestions import suggestions
from slippulse_jax.inference.result.verdict import GIVEN, GRAVITY, Identifiability, Verdict, directions
from slippulse_jax.inference.search.intervals import LEVELS, Interval, Intervals, rise_of
from slippulse_jax.inference.search.likelihood import Problem
from slippulse_jax.inference.search.minima import Curve, Root, describe
from slippulse_jax.inference.table.measurements import Measurements


class Compared(NamedTuple):
    """Data of one observable beside the fitted model.

    In λc, or SI.
    """

    observable: str
    value: np.ndarray
    sigma: np.ndarray  # with what the model leaves open
    fitted: np.ndarray
    residuals: np.ndarray  # (fitted − measured)/σ; of counts and limits what lies outside
    places: list[str]  # where each was measured, for messages
    measurement: np.ndarray  # which measurement each belongs to


@dataclasses.dataclass(frozen=True, eq=False)
class FitResult:
    """Result of `fit`. Start with `report()`, `identifiability` and `intervals`.

    What else would move it (`changes`, `next_steps`) is found by fitting again, once, when it is first asked for: by one of
    these names, or by `report`, `str`, `to_dict` and `save`, which contain them. A result that `load_fit` reads has them.
    """

    measurements: Measurements
    problem: Problem = dataclasses.field(metadata={"written": False})
    request: dict[str, Any]  # the arguments of `fit`, as given
    theta: np.ndarray  # of the first minimum, (p,)
    deviance: float  # there; χ² (with that of the priors) for plain lengths
    minima: list[Root]  # of the deviance, up to `SLACK` above the least; best first, those that break again last (`ordered`)
    curves: dict[str, Curve]  # profile of each parameter, over its θ
    intervals: dict[str, Intervals]  # by parameter and confidence level, in units
    verdicts: dict[str, Verdict]  # by parameter
    scatter: float | None  # factor on the stated σ, or on 1 λc, by which they match the scatter; None where σ are as stated
    scatter_dof: float | None  # degrees of freedom left over by that
    closest: float | None  # relative distance of the lengths from the fit, where it is too small to be scatter
    testable_dof: int | None  # degrees of freedom where χ² tests the model
    unconverged: list[str]  # messages of the starts that did not converge and might matter
    attainable: np.ndarray  # longest length of each measurement at any stiffness searched, in λc
    attainable_at: np.ndarray  # k/K where
    between_contacts: np.ndarray | None  # in λc, of each length by interpolation, in σ already; None where small
    covered: dict[str, tuple[float, float]]  # shares of simulated estimates within 1 and 1.96 standard errors, if simulated
    suspicions: tuple[str, ...] = ()  # likely mistakes of the table or the request, such as another unit

    @functools.cached_property
    def roots(self) -> list[Root]:
        """Minima not excluded at 95 %, best first."""
        return [root for root in self.minima if root.deviance <= self.deviance + self.rise(LEVELS[-1])]

    @property
    def calibrated(self) -> bool:
        """Whether the intervals are those of simulated measurements."""
        return bool(self.covered)

    @property
    def parameters(self) -> ParameterSet:
        """What was fitted, and how it enters the model."""
        return self.problem.parameters

    @property
    def names(self) -> list[str]:
        """Requested parameters, by label; those beside them are in `inputs`."""
        return list(self.verdicts)

    @property
    def given(self) -> list[str]:
        """Requested parameters with a value."""
        return [name for name, verdict in self.verdicts.items() if verdict.identifiability in GIVEN]

    @property
    def moved(self) -> list[str]:
        """Parameters that an input can move.

        With a value, or with several of which the first stands for all.
        """
        several = Identifiability.SEVERAL_ROOTS if self.points else None
        return [name for name, verdict in self.verdicts.items() if verdict.identifiability in (*GIVEN, several)]

    @property
    def points(self) -> bool:
        """Whether several points fit, not ranges of values."""
        return len(self.roots) > 1 and any(error is not None for root in self.roots for error in root.stderrs.values())

    @property
    def identifiability(self) -> Identifiability:
        """The gravest verdict on any requested parameter."""
        return self._gravest[1].identifiability

    @property
    def _gravest(self) -> tuple[str, Verdict]:
        return min(self.verdicts.items(), key=lambda item: GRAVITY.index(item[1].identifiability))

    @property
    def rejected(self) -> bool:
        """Whether the data reject the model, or lengths exceed its maximum."""
        return self.identifiability in (Identifiability.POOR_FIT, Identifiability.AT_MAXIMUM)

    @property
    def reason(self) -> str:
        """Why there is no plain standard error; empty if there is."""
        name, (_, reason) = self._gravest
        return f"{name}: {reason}" if reason and len(self.verdicts) > 1 else reason

    @property
    def converged(self) -> bool:
        """Whether every start that mattered ended at a minimum."""
        return not self.unconverged

    @property
    def values(self) -> dict[str, float]:
        """Values of highest likelihood; k/K too where it is one number."""
        values, ratio = self.parameters.values(self.theta), self.parameters.common_ratio(self.theta)
        if ratio is not None:
            values.setdefault("stiffness", ratio)
        return values

    @property
    def inputs(self) -> dict[str, float]:
        """Fitted values of the inputs that came with errors of their own."""
        return self.parameters.values(self.theta, nuisance=True)

    def rise(self, level: float, parameters: int = 1) -> float:
        """Rise of the deviance at ends of intervals, or of regions."""
        return rise_of(level, parameters, self.scatter_dof)

    @functools.cached_property
    def _at_best(self) -> Root:
        return describe(self.problem, self.theta, self.deviance)

    @property
    def covariance(self) -> np.ndarray | None:
        """Covariance of all θ, (p, p); None where the information is singular."""
        return None if self._at_best.singular.any() else self._at_best.covariance

    @property
    def scaled(self) -> bool:
        """Whether the size of the errors was taken from the scatter."""
        return self.scatter is not None

    @functools.cached_property
    def data(self) -> list[Compared]:
        """Data of every observable, and the model's values for them."""
        m, found = self.measurements, []
        for data in self.problem.observed:
            kind, open_ = data.observable, np.diag(self.problem.covariance(self.theta, data))
            fitted, sigma = self.problem.predicted(self.theta, data)[0], np.sqrt(data.sigma**2 + open_)
            residuals = kind.outside(fitted - data.value[0]) / np.where(sigma > 0, sigma, 1)
            places = kind.places(m, data)
            found.append(Compared(kind.name, data.value[0], sigma, fitted, residuals, places, data.measurement))
        return found

    @property
    def main(self) -> Observable:
        """What the rows of the table are about."""
        return self.problem.observed[0].observable

    def observable(self, name: str) -> Observable:
        """The observable of this name."""
        return next(data.observable for data in self.problem.observed if data.observable.name == name)

    @property
    def further(self) -> list[Compared]:
        """Data other than what the rows of the table are about."""
        return [one for one, data in zip(self.data, self.problem.observed, strict=True) if not data.observable.of_rows]

    def _by_row(self, name: str) -> np.ndarray:
        found = np.full(len(self.measurements), np.nan)
        for one, data in zip(self.data, self.problem.observed, strict=True):
            if data.observable.of_rows:
                found[data.measurement] = getattr(one, name)
        return found

    @property
    def sigma(self) -> np.ndarray:
        """Standard error of each row that was used, (n,).

        Of lengths in λc, of forces of a sequence in N/m.

        As stated, or scaled to the scatter; with `between_contacts`, or what the model leaves open, in quadrature. 0 for counts
        without an error.
        """
        return self._by_row("sigma")

    @property
    def fitted(self) -> np.ndarray:
        """Fitted value of each row, (n,).

        Lengths with model factor and offset, in stated λc; or forces of a sequence in N/m.
        """
        return self._by_row("fitted")

    @property
    def residuals(self) -> np.ndarray:
        """(fitted − measured)/σ of each row, (n,).

        For counts and fronts without arrest what lies outside, else 0.
        """
        return self._by_row("residuals")

    @property
    def stderrs(self) -> dict[str, float | None]:
        """Standard errors by Fisher information; None where `verdicts` say why."""
        q, sound, values = self.parameters, Identifiability.IDENTIFIED, self.values
        covariance, singular = self._at_best.covariance, self._at_best.singular
        found: dict[str, float | None] = dict.fromkeys(values)
        for name, verdict in self.verdicts.items():
            j = q.index(name)
            if verdict.identifiability is sound and not singular[j]:
                found[name] = float(np.sqrt(covariance[j, j])) * (values[name] if q.free[j].log else 1.0)
        slope = q.inputs.log_stiffness.slope[0]
        if "stiffness" in values and "stiffness" not in self.verdicts:
            # of k/K, where λc and E may have errors too
            moving = [v.identifiability for name, v in self.verdicts.items() if slope[q.index(name)]]
            if all(one is sound for one in moving) and not singular[slope != 0].any():
                found["stiffness"] = values["stiffness"] * float(np.sqrt(slope @ covariance @ slope))
        return found

    @property
    def correlations(self) -> dict[tuple[str, str], float]:
        """Correlations between fitted θ; empty where the information is singular."""
        if self.covariance is None:
            return {}
        error = np.sqrt(np.diag(self.covariance))
        pairs = itertools.combinations(enumerate(self.parameters.names), 2)
        return {(a, b): float(self.covariance[i, j] / (error[i] * error[j])) for (i, a), (j, b) in pairs}

    @property
    def stiffness_ratios(self) -> dict[tuple[str, str], tuple[float, float | None]]:
        """Ratios of the stiffnesses of specimens, with standard errors, by labels.

        Errors that both share cancel. The error is None where one of the two has none.
        """
        q, errors = self.parameters, self.stderrs
        each = [q.index(name) for name in self.names if q.named(name).name in STIFFNESSES]
        found: dict[tuple[str, str], tuple[float, float | None]] = {}
        for i, j in itertools.combinations(each, 2):
            above, below = q.names[j], q.names[i]
            ratio, error = float(np.exp(self.theta[j] - self.theta[i])), None
            if None not in (errors[above], errors[below]):
                covariance = self._at_best.covariance
                variance = covariance[i, i] + covariance[j, j] - 2 * covariance[i, j]
                error = ratio * float(np.sqrt(variance))
            found[above, below] = ratio, error
        return found

    @functools.cached_property
    def contacts_broken(self) -> np.ndarray:
        """Whole contacts that each front breaks.

        Of sequences those up to the place measured; of others without model factor and offset, which belong to the
        measurement. −1 where it never stops; shape (n,).
        """
        return self.parameters.front.contacts_broken(self.measurements, self.parameters.inputs.at(self.theta))

    @functools.cached_property
    def front_status(self) -> np.ndarray:
        """`Outcome` of each front as fitted, or event as measured; (n,)."""
        return self.parameters.front.outcomes(self.measurements, self.parameters.inputs.at(self.theta))

    @functools.cached_property
    def regime(self) -> Regime:
        """Find b and 1/κ_2 of each measurement at the best fit.

        Lengths in λc of the table, where λc is fitted too.
        """
        q = self.parameters
        none = np.zeros(len(self.measurements))
        found, contact = q.front.regime(q.inputs.at(self.theta)), np.exp(q.linear(none, {"correlation_length": 1})(self.theta))
        return found._replace(slow_decay_length=found.slow_decay_length * contact)

    @property
    def block_length_over_height(self) -> np.ndarray | None:
        """L/H of each measurement, NaN without end; None if not stated."""
        m = self.measurements
        return None if m.block_length is None else m.block_length / m.height

    @property
    def dof(self) -> int:
        """Degrees of freedom: data, priors included, minus fitted parameters."""
        return self.problem.count - self.problem.p

    @property
    def p_value(self) -> float | None:
        """Probability of so large a misfit, or its bound; None if unknown."""
        return self.problem.p_value(self.theta, self.deviance, self.testable_dof)

    @property
    def misfit(self) -> float:
        """Deviance beyond that of a perfect match: χ² for plain lengths."""
        return self.deviance - self.problem.perfect(self.theta)

    def starts(self, q: ParameterSet, count: int = 9) -> np.ndarray:
        """Minima and the range of stiffness, in other parameters; (s, p)."""
        every = [
            dict(zip(self.parameters.names, at, strict=True)) for at in (self.theta, *(root.theta for root in self.minima))
        ]
        known = np.array([[values.get(one.label, values.get(one.name, 0.0)) for one in q.free] for values in every])
        spread = q.low + (q.high - q.low) * np.linspace(0, 1, count + 2)[1:-1, None]
        return np.vstack([known, np.where([one.name in STIFFNESSES for one in q.free], spread, known[0])])

    changes = functools.cached_property(find_changes)
    next_steps = functools.cached_property(suggestions)
    groups = functools.cached_property(predicted.groups)
    curve = predicted.curve
    field = predicted.field
    bootstrap = samples.bootstrap
    posterior = samples.posterior
    notes = property(notes)
    report = printer.report
    methods = printer.methods
    _repr_html_ = printer.html_of
    to_dict = record.to_dict
    to_dataframe = record.to_dataframe

    @functools.cached_property
    def totals(self) -> dict[str, tuple[float | None, Interval | None]]:
        """Total standard error and 68 % interval of each parameter.

        Those of the inputs taken as exact (`changes`); None where there is none.
        """
        known = {name: self.intervals_with_inputs.get(name, {}).get(LEVELS[0], []) for name in self.names}
        return {
            name: (total(self, name, self.changes), pieces[0] if len(pieces) == 1 and not any(pieces[0][2:]) else None)
            for name, pieces in known.items()
        }

    @functools.cached_property
    def intervals_with_inputs(self) -> dict[str, Intervals]:
        """The intervals, widened by usual errors of the inputs taken as exact."""
        return {name: total_intervals(self, name, self.changes) for name in self.moved}

    @functools.cached_property
    def totals_of_ratios(self) -> dict[tuple[str, str], float | None]:
        """Total standard errors of `stiffness_ratios`; None where there is none."""
        return {labels: total_of_ratio(self, labels, self.changes) for labels in self.stiffness_ratios}

    @property
    def stderrs_with_inputs(self) -> dict[str, float | None]:
        """Standard errors with usual errors of inputs; None as in `stderrs`."""
        return {name: error for name, (error, _) in self.totals.items()}

    @property
    def errors_with_inputs(self) -> dict[str, tuple[float, float] | None]:
        """Errors to publish, below and above each value.

        The sides of the 68 % interval, each widened by the errors of inputs taken as exact; else the standard error twice. None
        where there is no value.
        """
        found: dict[str, tuple[float, float] | None] = dict.fromkeys(self.names)
        for name in self.given:
            value, (error, piece) = self.values[name], self.totals[name]
            found[name] = None if error is None else (error, error)
            if piece is not None and piece.encloses(value):
                found[name] = value - piece.low, piece.high - value
        return found

    @functools.cached_property
    def directions(self) -> list[dict[str, Any]]:
        """`combination`, `stderr`, `coefficients` of combinations, best determined first."""
        return directions(self.problem, self.theta)

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {value:.4g}" for name, value in self.values.items())
        return f"FitResult({self.identifiability.name}: {values}; report() says more)"

    def __str__(self) -> str:
        return self.report()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write JSON as ``slippulse fit --json`` prints it, for `load_fit`."""
        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
        write_atomically(path, (text + "\n").encode())


def load_fit(path: str | os.PathLike[str]) -> FitResult:
    """Read a fit that `FitResult.save` wrote, or ``slippulse fit --json`` printed.

    Nothing is fitted again: measurements, request, what the search found, and what else would move the result are in the file.

    Raises
    ------
    OSError
        If there is no such file, or it cannot be opened.
    ValueError
        If it is no fit, or has another schema.
    """
    result, known = record.of_dict(FitResult, record.read_record(path))
    vars(result).update(known)  # where `cached_property` keeps them
    return result
