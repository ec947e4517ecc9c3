"""Results of a fit: values, errors, intervals, roots, and whether the data determine them at all."""

import dataclasses
import functools
import itertools
import json
import os
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.files import write_atomically
from slippulse_jax.inference.bayes import posterior
from slippulse_jax.inference.bootstrap import Bootstrap, bootstrap
from slippulse_jax.inference.budget import AsSlider, Moved, budget, total, unstated_ends, unstated_push
from slippulse_jax.inference.hints import next_steps
from slippulse_jax.inference.likelihood import Loss, Problem, make_problem
from slippulse_jax.inference.measurements import READINGS, Measurements
from slippulse_jax.inference.model import Regime, lengths, recursion_status, regime
from slippulse_jax.inference.parameters import (
    STIFFNESSES,
    Inputs,
    ParameterSet,
    event_and_body,
    parameter_set,
    with_errors_of_measuring,
)
from slippulse_jax.inference.profile import Curve, Interval, Rise
from slippulse_jax.inference.record import (
    changes_of_record,
    from_request,
    measurements_of_record,
    read_record,
    to_dataframe,
    to_dict,
)
from slippulse_jax.inference.report import html_of, methods, notes, report
from slippulse_jax.inference.search import Minimum, describe
from slippulse_jax.inference.verdict import Direction, Identifiability, Verdict, directions, gravest
from slippulse_jax.status import NotConverged, Outcome

if TYPE_CHECKING:
    import pandas as pd


@dataclasses.dataclass(frozen=True, eq=False)
class Root:
    """One minimum of the deviance."""

    values: dict[str, float]  # by parameter
    stderrs: dict[str, float | None]  # from the information at this minimum
    theta: np.ndarray  # (p,)
    deviance: float
    covariance: np.ndarray  # of θ, (p, p)
    inputs: Inputs  # of the model for each measurement, (n,)

    @property
    def ratio(self) -> np.ndarray:
        """k/K of each measurement, shape (n,)."""
        return self.inputs.ratio

    @functools.cached_property
    def rebreaks(self) -> bool:
        """Whether, for some measurement, the edge contact would break again before the front stops."""
        return bool((recursion_status(self.inputs) == Outcome.REBREAK).any())


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """The model at the best fit, one entry per measurement."""

    length: np.ndarray  # as it would be measured, with the fitted model factor and offset, in stated λc
    contacts_broken: np.ndarray  # of the front itself, without these; −1 where it never stops
    status: np.ndarray  # `Outcome`


@dataclasses.dataclass(frozen=True, eq=False)
class Further:
    """One further observable at the best fit, one entry per datum; in SI."""

    observable: str
    value: np.ndarray
    sigma: np.ndarray
    fitted: np.ndarray
    places: list[str]  # where each was measured, for messages

    @property
    def residuals(self) -> np.ndarray:
        """(fitted − measured)/σ."""
        return (self.fitted - self.value) / self.sigma


@dataclasses.dataclass(frozen=True, eq=False)
class FitResult:
    """Result of `fit`. Start with `report()`, `identifiability` and `intervals`.

    What else would move the result (`budget`, `unstated_ends`, `unstated_push`, `next_steps`, `as_slider`) is found by fitting
    again, once, when it is first asked for: by one of these names, or by `report`, `str`, `to_dict` and `save`, which contain
    them. That takes a fraction of a second for a slider, and up to ten for a block. A result that `load_fit` reads has them.
    """

    measurements: Measurements
    problem: Problem
    request: dict[str, Any]  # the arguments of `fit`, as given
    theta: np.ndarray  # of least deviance, (p,)
    deviance: float  # its least value; χ² (with that of the priors) for plain lengths
    roots: list[Root]  # minima not excluded at 95 %, best first
    curves: dict[str, Curve]  # profile of each parameter, over its θ
    intervals: dict[str, dict[float, list[Interval]]]  # by parameter and confidence level, in units
    verdicts: dict[str, Verdict]  # by parameter
    rise: Rise
    scatter: float | None  # factor on the stated σ, or on 1 λc, by which they match the scatter; None where σ are as stated
    testable_dof: int | None  # degrees of freedom where χ² tests the model
    unconverged: list[str]  # messages of the starts that did not converge and might matter
    attainable: np.ndarray  # longest length of each measurement at any stiffness searched, in λc
    attainable_at: np.ndarray  # k/K where
    between_contacts: np.ndarray | None  # |ℓ − ℓ*| of each length in λc, added to σ in quadrature; None where it is small
    complete: bool  # whether the search left no part of the range unresolved
    calibrated: bool  # whether the intervals are those of simulated measurements

    @property
    def parameters(self) -> ParameterSet:
        """What was fitted, and how it enters the model."""
        return self.problem.parameters

    @property
    def names(self) -> list[str]:
        """Requested parameters, by label; inputs fitted only because of their errors are in `inputs`."""
        return list(self.verdicts)

    @property
    def identifiability(self) -> Identifiability:
        """The gravest verdict on any requested parameter."""
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
        return not self.unconverged

    @property
    def values(self) -> dict[str, float]:
        """Values of highest likelihood; k/K too where it is one number for all measurements."""
        return named_values(self.parameters, self.theta)

    @property
    def inputs(self) -> dict[str, float]:
        """Fitted values of the inputs that came with errors of their own."""
        return self.parameters.values(self.theta, nuisance=True)

    @functools.cached_property
    def _at_best(self) -> Minimum:
        return describe(self.problem, self.theta, self.deviance)

    @property
    def covariance(self) -> np.ndarray | None:
        """Covariance of all θ, (p, p), from the Fisher information at the best fit; None where that is singular."""
        return None if self._at_best.singular.any() else self._at_best.covariance

    @property
    def scaled(self) -> bool:
        """Whether the size of the errors was taken from the scatter."""
        return self.scatter is not None

    @property
    def sigma(self) -> np.ndarray:
        """Standard error of each length that the fit used, in λc; shape (n,).

        As stated, or scaled to the scatter; with `between_contacts` added in quadrature. 0 for counts without an error.
        """
        return self.problem.blocks[0].data.sigma

    @property
    def stderrs(self) -> dict[str, float | None]:
        """Standard error of each of `values`, from the Fisher information; None where `verdicts` say why."""
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
    def stderrs_with_inputs(self) -> dict[str, float | None]:
        """Standard errors with usual errors of inputs taken as exact (`budget`): those to publish; None as in `stderrs`."""
        return {name: total(self, name, self.budget) for name in self.names}

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

    @property
    def stiffness_ratios(self) -> dict[tuple[str, str], tuple[float, float | None]]:
        """Stiffness of one specimen over that of another, with its standard error, by the labels of both.

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
    def directions(self) -> list[Direction]:
        """Combinations of the parameters by how well they are determined."""
        return directions(self.problem, self.theta)

    @functools.cached_property
    def fitted(self) -> Fitted:
        """The model at the best fit: length, whole contacts, and whether the edge contact would break again."""
        q = self.parameters
        inputs = q.inputs_at(self.theta)
        front = lengths(inputs, event=q.event).value  # without model factor and offset, which belong to the measurement
        counted = np.where(np.isfinite(front), np.maximum(np.ceil(np.where(np.isfinite(front), front, 0)), 1), -1)
        return Fitted(self.problem.predict(self.theta)[0], counted.astype(int), recursion_status(inputs))

    @functools.cached_property
    def regime(self) -> Regime:
        """Find b and 1/κ_2 of each measurement at the best fit; lengths in λc of the table, where λc is fitted too."""
        q = self.parameters
        found, contact = regime(q.inputs_at(self.theta)), np.exp(q.scales["position"](self.theta))
        return found._replace(slow_decay_length=found.slow_decay_length * contact)

    @property
    def block_length_over_height(self) -> np.ndarray | None:
        """L/H of each measurement, NaN for a block without end; None where no length is stated."""
        m = self.measurements
        return None if m.block_length is None else m.block_length / m.height

    @functools.cached_property
    def budget(self) -> dict[str, Moved]:
        """Effect of usual errors of the inputs taken as exact, by input."""
        return budget(self)

    @functools.cached_property
    def next_steps(self) -> list[str]:
        """Suggestions with their options: what a rejected fit lacks, or errors of inputs that specimens may share."""
        return next_steps(self)

    @functools.cached_property
    def unstated_ends(self) -> dict[str, dict[str, float]]:
        """Shifts due to a usual end of the block and a usual machine where none is stated, by column and parameter."""
        return unstated_ends(self)

    @functools.cached_property
    def unstated_push(self) -> dict[str, dict[str, float]]:
        """Stiffness of a block over that fitted, by what the table does not say of its push, and by parameter."""
        return unstated_push(self)

    @functools.cached_property
    def as_slider(self) -> "AsSlider | None":
        """What the same lengths give with the paper's slider, for a fit of a block.

        None where the body is a slider, and where no fit of a slider is found.
        """
        if self.parameters.body == "slider":
            return None
        from slippulse_jax.inference.fit import fit  # which makes results

        asked = {name: value for name, value in self.request.items() if name not in ("event", "body")}
        free = [one for one in asked.pop("free") if one.name != "push_height"]
        try:
            found = fit(self.measurements, free, body="slider", **asked)
        except (ValueError, NotConverged):
            return None
        return AsSlider(found.values, found.stderrs, {name: one.identifiability for name, one in found.verdicts.items()})

    @functools.cached_property
    def further(self) -> list[Further]:
        """Data other than lengths, and the model's values for them."""
        m, found = self.measurements, []
        for block in self.problem.blocks[1:]:
            places = [m.place(i) for i in block.measurement.tolist()]
            if m.gauges is not None and block.observable in READINGS:
                places = [m.gauges.place(i) for i in np.nonzero(m.gauges.there(block.observable))[0].tolist()]
            fitted = self.problem.predict(self.theta, block.observable)[0]
            found.append(Further(block.observable, block.data.value[0], block.data.sigma, fitted, places))
        return found

    @property
    def dof(self) -> int:
        """Degrees of freedom: data, priors included, minus fitted parameters."""
        return self.problem.count - self.problem.p

    @property
    def p_value(self) -> float | None:
        """Probability of so large a misfit if model and σ are right, or its upper bound; None where none is known."""
        return None if self.testable_dof is None else float(chdtrc(self.testable_dof, self.misfit))

    @property
    def misfit(self) -> float:
        """Deviance beyond that of data which the model meets: χ² for plain lengths."""
        return self.deviance - self.problem.perfect

    @property
    def residuals(self) -> np.ndarray:
        """(fitted − measured)/σ of the lengths, shape (n,); for counts and fronts without arrest what lies outside, else 0."""
        m = self.measurements
        off = self.fitted.length - m.length
        kind = np.array(m.kind)
        off = np.where(kind == "whole", np.where(off > 0, off, np.minimum(off + 1, 0)), off)
        off = np.where(kind == "at_least", np.minimum(off, 0), off)
        return off / np.where(self.sigma > 0, self.sigma, 1)

    @property
    def notes(self) -> list[str]:
        """Remarks to read before using the numbers."""
        return list(notes(self))

    def report(self, *, verbose: bool = False) -> str:
        """Format the result as text: a box, what else would move it, the data, remarks; everything else if `verbose`."""
        return report(self, verbose=verbose)

    def methods(self) -> str:
        """Write a sentence for the methods section of a paper, with the numbers of this fit."""
        return methods(self)

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {value:.4g}" for name, value in self.values.items())
        return f"FitResult({self.identifiability.name}: {values}; report() says more)"

    def _repr_html_(self) -> str:
        return html_of(self)

    def __str__(self) -> str:
        return self.report()

    def to_dict(self) -> dict[str, Any]:
        """Return the whole result as plain Python values for JSON; open ends and missing numbers are None."""
        return to_dict(self)

    def to_dataframe(self) -> "pd.DataFrame":
        """Return measurements and model as a pandas.DataFrame, one row per measurement, in the unit of the table."""
        return to_dataframe(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result as JSON, as ``slippulse fit --json`` prints it; `load_fit` reads it."""
        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
        write_atomically(path, (text + "\n").encode())

    def bootstrap(self, count: int = 1000, *, kind: str = "parametric", seed: int = 0) -> Bootstrap:
        """Refit simulated or resampled measurements: see `slippulse_jax.inference.bootstrap`."""
        return bootstrap(self, count, kind=kind, seed=seed)

    def posterior(
        self, *, samples: int = 1000, warmup: int = 500, chains: int = 4, seed: int = 0, progress: bool | None = None
    ) -> Any:
        """Sample the posterior by NUTS, for ArviZ: see `slippulse_jax.inference.bayes`; needs the extra ``bayes``."""
        return posterior(self, samples=samples, warmup=warmup, chains=chains, seed=seed, progress=progress)


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
    content = read_record(path)
    measurements, request, found = measurements_of_record(content), from_request(content["request"]), content["search"]
    size_known = measurements.length_sigma is not None and request["sigma"] == "absolute"
    wanted = with_errors_of_measuring(measurements, request["free"], size_known=size_known)
    event, body = event_and_body(measurements, request.get("event"), request.get("body"))
    request = {**request, "event": request.get("event"), "body": request.get("body")}
    parameters = parameter_set(measurements, wanted, event, body)
    sigma, scatter = measurements.stated_sigma, content["sigma_scaled_by"]
    between = found["between_contacts"] and np.array(found["between_contacts"], dtype=float)
    problem = make_problem(
        measurements, parameters, Loss(request["loss"]), sigma if between is None else np.hypot(sigma, between)
    )
    if scatter is not None:
        problem = problem.with_sigma(scatter, of_lengths=measurements.length_sigma is None)

    def finite_or_inf(x: Any) -> np.ndarray:
        return np.nan_to_num(np.array(x, dtype=float), nan=np.inf)

    def root(one: dict[str, Any]) -> Root:
        theta = np.array(one["theta"])
        covariance = finite_or_inf(one["covariance"])
        return Root(parameters.values(theta), one["stderr"], theta, one["deviance"], covariance, parameters.inputs_at(theta))

    result = FitResult(
        measurements=measurements,
        problem=problem,
        request=request,
        theta=np.array(found["theta"]),
        deviance=content["deviance"] if "deviance" in content else content["chi2"],  # the name of version 0.2
        roots=[root(one) for one in found["roots"]],
        curves={name: Curve(*(finite_or_inf(x) for x in curve.values())) for name, curve in found["curves"].items()},
        intervals={
            name: {float(level): [Interval(*piece) for piece in pieces] for level, pieces in by_level.items()}
            for name, by_level in found["intervals"].items()
        },
        verdicts={
            name: Verdict(Identifiability[one["identifiability"].upper()], one["reason"] or "")
            for name, one in content["verdicts"].items()
        },
        rise=Rise(**found["rise"]),
        scatter=scatter,
        testable_dof=found["testable_dof"],
        unconverged=found["unconverged"],
        attainable=finite_or_inf([one["attainable"] for one in content["measurements"]]),
        attainable_at=finite_or_inf([one["attainable_at_stiffness"] for one in content["measurements"]]),
        between_contacts=between,
        complete=found["complete"],
        calibrated=found.get("calibrated", False),
    )
    vars(result).update(changes_of_record(content))  # where `cached_property` keeps what was computed before
    return result


def root_of(problem: Problem, one: Minimum) -> Root:
    """Convert a minimum over θ to the units of the parameters."""
    q = problem.parameters
    values = q.values(one.theta)
    errors: dict[str, float | None] = dict.fromkeys(values)
    for j, p in enumerate(q.free):
        spread = float(np.sqrt(one.covariance[j, j]))
        if not (p.nuisance or one.singular[j]) and spread <= p.high - p.low:
            errors[p.label] = spread * (values[p.label] if p.log else 1.0)
    return Root(values, errors, one.theta, one.deviance, one.covariance, q.inputs_at(one.theta))


def named_values(q: ParameterSet, theta: np.ndarray) -> dict[str, float]:
    """Requested parameters at θ by label, in units, and k/K where a stiffness is fitted and k/K is one number."""
    values, ratio = q.values(theta), q.common_ratio(theta)
    if ratio is not None:
        values.setdefault("stiffness", ratio)
    return values
