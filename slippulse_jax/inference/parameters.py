"""Parameters of a fit, their check, and their map to inputs.

Positive parameters are fitted as θ = ln(value), the others as they are. Every input of the model (`Inputs`), and the logarithm
of every scale that turns model units into measured ones, is then **linear** in θ. Heights, moduli and correlation lengths with
errors of their own are parameters with a prior, like any other.

A request that has no meaning is an error. Numbers that may be in another unit, and columns that may be exchanged, are
suspicions. A table checks its own rows (`slippulse_jax.inference.table.columns`), a model what it takes (`Front.check`).
"""

import dataclasses
import functools
import warnings
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from slippulse_jax.base.choices import did_you_mean
from slippulse_jax.base.domains import Domain, in_unit, real_numbers
from slippulse_jax.bulk.chunks import distinct_rows
from slippulse_jax.inference.choices import Body, Loss, MeasuredEvent
from slippulse_jax.inference.model.front import STIFFEST, Front
from slippulse_jax.inference.model.inputs import COMMON, Inputs, Linear
from slippulse_jax.inference.model.models import FRONTS, front_for, front_of, model_of
from slippulse_jax.inference.observables import EVERY as EVERY_OBSERVABLE
from slippulse_jax.inference.observables import Length, Observable
from slippulse_jax.inference.table.columns import COLUMNS, EVERY, IN_LC, NUMERIC, OVER_ALL, MeasurementError
from slippulse_jax.inference.table.measurements import Measurements, MeasurementWarning

LIKELY = Domain(0.02, 1.2, "")
"""Usual range of the length over the height."""
PRIOR_REACH = 6.0
"""Standard deviations of a prior searched on either side where no bounds are given."""


def _is_number(x: Any) -> bool:
    if not isinstance(x, int | float | np.number | np.ndarray | jax.Array) or (isinstance(x, int) and abs(x) >= 2**63):
        return False  # NumPy takes no larger ones
    try:
        return in_unit("", x) is x and not np.ndim(real_numbers("", x))
    except (TypeError, ValueError):
        return False


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One parameter of a fit.

    Parameters
    ----------
    name : str
        One of `PARAMETERS`.
    bounds : (float, float), optional
        Range searched, in the unit of the parameter.
    prior : (float, float), optional
        Mean and standard deviation of an independent Gaussian prior, both in the unit of the parameter, as (3.3e9, 2e8) for
        "young" in Pa. Of a positive parameter it is the logarithm that is normal, with the deviation over the mean.
    each : {"specimen"}, optional
        One value per specimen instead of one that all share.
    value : float, optional
        Held at this value, not fitted.
    nuisance : bool
        Fitted only because it has an error: it needs a prior, and gets neither a verdict nor an interval of its own.
    """

    name: str
    bounds: tuple[float, float] | None = None
    prior: tuple[float, float] | None = None
    each: str | None = None
    value: float | None = None
    nuisance: bool = False

    def __post_init__(self) -> None:
        if self.name not in PARAMETERS:
            raise ValueError(f"parameter {self.name!r}: one of {', '.join(PARAMETERS)}{did_you_mean(self.name, PARAMETERS)}")
        if self.each not in (None, "specimen"):
            raise ValueError(f"parameter {self.name}: each = {self.each!r}: 'specimen' or nothing")
        positive = PARAMETERS[self.name].log
        self._check_numbers()
        if self.bounds is not None:
            low, high = self.bounds
            if not (np.isfinite(low) and np.isfinite(high) and low < high and (low > 0 or not positive)):
                must = "positive, finite and in increasing order" if positive else "finite and in increasing order"
                raise ValueError(f"bounds = ({low:g}, {high:g}) of {self.name}: must be {must}")
        if self.prior is not None:
            mean, sigma = self.prior
            if not (np.isfinite(mean) and np.isfinite(sigma) and sigma > 0 and (mean > 0 or not positive)):
                raise ValueError(f"prior = ({mean:g}, {sigma:g}) of {self.name}: a mean{' > 0' * positive} and a deviation > 0")
            if positive and sigma < 1e-6 * mean:  # in another unit
                raise ValueError(
                    f"prior = ({mean:g}, {sigma:g}) of {self.name}: the deviation is {sigma / mean:.1g} of the mean; give it "
                    "in the unit of the mean, or hold the parameter by `value`"
                )
        if self.nuisance and self.prior is None:
            raise ValueError(f"parameter {self.name}: nuisance = True, but no prior says what its error is")
        alike = self.value == PARAMETERS[self.name].limits[0]  # of contacts that do not differ
        if self.value is not None and not (np.isfinite(self.value) and (self.value > 0 or not positive or alike)):
            raise ValueError(f"value = {self.value:g} of {self.name}: must be {'positive and ' * positive}finite")

    def _check_numbers(self) -> None:
        for key, wanted in (("bounds", "two numbers"), ("prior", "two numbers"), ("value", "a number")):
            given = getattr(self, key)
            each = given if key != "value" and isinstance(given, Sequence | np.ndarray) else (given,)
            count = 1 if key == "value" else 2
            if given is not None and not (len(each) == count and all(map(_is_number, each))):
                unit = f", in {kind.unit[1]}" if (kind := PARAMETERS[self.name]).unit[1] else ""
                raise ValueError(f"parameter {self.name}: {key} = {given!r}: must be {wanted}{unit}")
        if self.value is not None and (self.prior, self.bounds, self.each) != (None, None, None):
            raise ValueError(f"parameter {self.name}: held by `value`, so that a prior, bounds and `each` have no effect")


class Free(NamedTuple):
    """One fitted number θ; limits and prior in θ."""

    label: str  # its name, followed by the specimen where there is one value per specimen
    name: str
    symbol: str
    unit: str
    log: bool
    low: float
    high: float
    prior_mean: float
    prior_sigma: float  # inf without a prior
    nuisance: bool  # fitted only because it has an error of its own

    def value(self, theta: Any) -> Any:
        """Convert θ to the parameter in its unit."""
        value = np.exp(theta) if self.log else theta
        return value if np.ndim(theta) else float(value)

    def theta(self, value: float) -> float:
        """Convert a value to θ."""
        return float(np.log(value)) if self.log else float(value)


class Effect(NamedTuple):
    """What one parameter changes, of some measurements."""

    name: str
    rows: np.ndarray  # (n,), 1 where it acts
    shift: np.ndarray  # (n,), added to what is stated
    theta: int | None  # number of the θ that is added too; None where the parameter is held


@dataclasses.dataclass(frozen=True, eq=False)
class ParameterSet:
    """The map from θ, (p,), to the inputs of every measurement."""

    measurements: Measurements
    free: tuple[Free, ...]
    held: dict[str, float]  # by name, in their units
    effects: tuple[Effect, ...]
    front: Front  # the model
    observables: tuple[Observable, ...]  # that it predicts
    wanted: tuple[Parameter, ...]  # of which it was made, with those that measuring adds

    def linear(self, base: np.ndarray, acts: Mapping[str, Any]) -> Linear:
        """Make a number per measurement linear in θ.

        From its value as stated, (n,), and what a unit of θ of each parameter adds.
        """
        slope = np.zeros((len(base), len(self.free)))
        for one in (one for one in self.effects if one.name in acts):
            size = acts[one.name] * one.rows
            base = base + acts[one.name] * one.shift
            if one.theta is not None:
                slope[:, one.theta] += size
        return Linear(base, slope)

    @functools.cached_property
    def inputs(self) -> Inputs:
        """Inputs of the model, a `Linear` each."""
        m = self.measurements
        log_lc, log_young = np.log(m.metres), 0.0 if m.young is None else np.log(m.young)
        every = np.log(m.height), log_lc - log_young, m.poisson, m.or_zero("prestress"), m.or_zero("threshold_slope")
        base = dict(zip(COMMON, every, strict=True)) | self.front.stated(m)
        if "residual_strength" in self.front.inputs and (
            m.or_zero("residual_strength").any() or any(one.name == "residual_strength" for one in self.effects)
        ):
            base["residual_strength"] = m.or_zero("residual_strength")
        if "log_scatter" in base and all(one.name != "threshold_scatter" for one in self.effects):
            base["log_scatter"] = base["log_scatter"] - np.inf  # contacts are alike
        acts: dict[str, dict[str, Any]] = {name: {} for name in base}
        for parameter in {one.name for one in self.effects}:
            for name, size in acts_of(m, parameter).items():
                acts.get(name, {})[parameter] = size
        found = {name: self.linear(x, acts[name]) for name, x in base.items()}
        return Inputs(*(found.pop(name) for name in COMMON), more=found)

    def observed_with(self, front: Front) -> tuple[Observable, ...]:
        """The same observables, or those that another model predicts."""
        return self.observables if type(front) is type(self.front) else observables_of(front, self.observables[0].loss)

    @property
    def names(self) -> list[str]:
        """Label of every θ."""
        return [one.label for one in self.free]

    def index(self, name: str) -> int:
        """Index of the θ called `name`; a ValueError names those there are."""
        if name not in self.names:
            raise ValueError(f"{name!r} is not fitted here: one of {', '.join(self.names)}")
        return self.names.index(name)

    def named(self, name: str) -> Free:
        """The parameter called `name`; raises as `index` does."""
        return self.free[self.index(name)]

    def values(self, theta: np.ndarray, *, nuisance: bool = False) -> dict[str, float]:
        """Values at θ, (p,), of the requested parameters, or of nuisances."""
        return {one.label: one.value(t) for one, t in zip(self.free, theta, strict=True) if one.nuisance == nuisance}

    @property
    def low(self) -> np.ndarray:
        """Lower limits of θ."""
        return np.array([one.low for one in self.free])

    @property
    def high(self) -> np.ndarray:
        """Upper limits of θ."""
        return np.array([one.high for one in self.free])

    def rows_of(self, index: int) -> np.ndarray:
        """Measurements whose inputs depend on a parameter; all if none do."""
        slopes = np.array([self.inputs.get(name).slope[:, index] for name in self.inputs.names])
        own = np.flatnonzero(slopes.any(axis=0))
        return own if own.size else np.arange(slopes.shape[1])

    def longest(self, theta: np.ndarray, inputs: Inputs) -> tuple[np.ndarray, np.ndarray]:
        """Longest lengths, in true λc without offset, and the k/K where."""
        at = inputs.at(theta)
        low, high = np.array(at.log_stiffness), np.array(at.log_stiffness)
        for i, one in enumerate(self.free):
            if one.name in STIFFNESSES:
                on = inputs.log_stiffness.slope[:, i] != 0
                low[on], high[on] = (at.log_stiffness[on] + end - theta[i] for end in (one.low, one.high))
        distinct, own = distinct_rows(np.column_stack([at.table(), low, high]))
        given = Inputs.from_table(at.names, distinct[:, :-2])
        longest, where = self.front.longest(given, distinct[:, -2], distinct[:, -1])
        return longest[own], np.exp(where[own])

    def attainable(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Longest length of each measurement, in λc, and the k/K where.

        Both of shape (n,). At any stiffness searched; the other parameters stay as in `theta`.
        """
        longest, where = self.longest(theta, self.inputs)
        scale, offset = self.of_lengths
        return longest * np.exp(scale(theta)) + offset(theta), where

    @property
    def of_lengths(self) -> tuple[Linear, Linear]:
        """Logarithm of the factor on lengths, and their offset, in stated λc."""
        none = np.zeros(len(self.measurements))
        return self.linear(none, Length.acts), self.linear(none, {Length.added: 1})

    def common_ratio(self, theta: np.ndarray) -> float | None:
        """k/K at θ where one is fitted for all measurements."""
        fitted = any("stiffness" in one.label for one in self.free if not one.nuisance)
        ratio = self.inputs.at(theta).ratio
        return float(ratio[0]) if fitted and np.ptp(ratio) <= 1e-12 * ratio[0] else None


class ParameterKind(NamedTuple):
    """A row of the table of parameters."""

    symbol: str
    unit: tuple[str, str]  # for lengths in λc, and in SI
    log: bool
    acts: dict[str, float]  # what a unit of θ adds to each of the inputs; observables say on which of them it acts
    bounds: tuple[float, float] | None = None  # searched by default
    factor: float | None = None  # of one that measurements may state: up to which multiple of it is searched, if no bounds are
    limits: tuple[float, float] = (-np.inf, np.inf)  # of a range that follows from a prior


PARAMETERS: dict[str, ParameterKind] = {
    "stiffness": ParameterKind("k/K", ("", ""), True, {"log_stiffness": 1}),
    "areal_stiffness": ParameterKind("k/λc²", ("Pa/m", "Pa/m"), True, {"log_stiffness": 1}),
    "areal_stiffness_over_young": ParameterKind("(k/λc²)/E", ("1/m", "1/m"), True, {"log_stiffness": 1}),
    "height": ParameterKind("H", ("λc", "m"), True, {"log_height": 1, "log_push": -1, "log_push_width": -1}, factor=2.0),
    "correlation_length": ParameterKind(
        "λc", ("", "m"), True,
        # H/λc falls; k/K = (k/λc²) λc/E rises
        {"log_height": -1, "log_stiffness": 1, "log_sites": -1},
        factor=10.0,
    ),
    "push_height": ParameterKind("h", ("λc", "m"), True, {"log_push": 1}, factor=2.0),
    "push_width": ParameterKind("w", ("λc", "m"), True, {"log_push_width": 1}, factor=2.0),
    "block_length": ParameterKind("L", ("λc", "m"), True, {"log_sites": 1, "log_extent": 1}, factor=2.0),
    "block_width": ParameterKind("W", ("", "m"), True, {"log_machine": -1}, factor=2.0),
    "normal_stiffness": ParameterKind("k_n/k", ("", ""), True, {"log_normal_stiffness": 1}, factor=2.0),
    "young": ParameterKind("E", ("", "Pa"), True, {"log_stiffness": -1, "log_machine": -1}, factor=10.0),
    "poisson": ParameterKind("ν", ("", ""), False, {"poisson": 1}, (0.0, 0.5), 1.0, (-0.99, 0.5)),
    "prestress": ParameterKind("φ", ("σ_s", "σ_s"), False, {"prestress": 1}, (-0.95, 0.95), 1.0, (-0.99, 0.99)),
    "threshold_slope": ParameterKind("ε", ("1/λc", "1/λc"), False, {"threshold_slope": 1}, None, 1.0),
    "residual_strength": ParameterKind("r", ("", ""), False, {"residual_strength": 1}, (0.0, 0.9), 1.0, (0.0, 0.99)),
    "friction": ParameterKind("", ("", ""), False, {"friction": 1}, (0.0, 0.95), 1.0, limits=(0.0, np.inf)),
    "newborn": ParameterKind("newborn", ("", ""), False, {"newborn": 1}, (0.05, 1.0), limits=(0.01, 1.0)),
    "time_constant": ParameterKind("τ", ("u_s", "u_s"), True, {"log_time": 1}, (0.02, 50.0)),
    "threshold_scatter": ParameterKind("scatter", ("", ""), True, {"log_scatter": 1}, (0.002, 0.15), limits=(0.0, 0.3)),
    "machine_stiffness": ParameterKind("M", ("E", "Pa"), True, {"log_machine": 1}, factor=10.0),
    "normal_load": ParameterKind("F_N", ("", "N/m"), True, {}, factor=10.0),
    "strength": ParameterKind("σ_s", ("", "Pa"), True, {}, (1.0, 1e12)),
    "offset": ParameterKind("offset", ("λc", "m"), False, {}),
    "force_offset": ParameterKind("force offset", ("", "N/m"), False, {}),
    "model_factor": ParameterKind("model factor", ("", ""), True, {}),
    "arrest": ParameterKind("contacts beyond ℓ", ("λc", "λc"), False, {}),
}  # fmt: skip
"""Every parameter by name; k/K, areal stiffness and its ratio to E are one parameter, named by what the data determine."""
STIFFNESSES = ("stiffness", "areal_stiffness", "areal_stiffness_over_young")
HEIGHTS = ("height", "push_height", "push_width", "block_length")
"""Lengths held in λc and shown in metres where λc is known; fitted as one factor on all of their rows."""
NEEDS_SI = ("correlation_length", "young", "strength")
OF_MEASURING = ("offset", "model_factor")
"""What is fitted beside for lengths that were measured, and acts on these."""
MEASURED = ("measured", "digitised")
"""Provenances of real contacts."""
USUAL_SCATTER = (0.03, 0.03 * np.log(2))
"""Prior of the scatter of their thresholds: 3 %, within a factor of two."""
STARTS = ("young", "push_height", "push_width", "block_length", "block_width", "normal_stiffness")
"""Parameters that are nothing without a column."""
COMPARED = (*HEIGHTS, "young", "correlation_length", "normal_load", "machine_stiffness", "strength", "time_constant")
"""Parameters whose priors, values and bounds are held against what the table states, or what is usual."""
USUALLY = {"strength": (1e3, 1e9), "time_constant": (0.02, 50.0)}
"""Usual ranges of parameters that no table states."""
IN_UNIT = {"m": "height", "Pa": "young"}
"""Columns by whose units a parameter in one of SI may be meant."""
IN_ALL = {"normal_load": "N", "machine_stiffness": "N/m"}
"""Units in which those over the width of the block may be given by mistake."""
SUSPECT = (0.01, 1.5)
"""Range of the length over the height outside which a unit is suspected."""
MODEL_ERROR = 0.1
"""Default relative error of the model's length for measured blocks: about the difference to a block under two-dimensional
elasticity that is pushed over all but the lowest quarter of its side. Other pushers: docs/model/limits.md."""


def parameter_set(
    m: Measurements,
    wanted: Iterable[str | Parameter],
    front: Front | None = None,
    observables: Sequence[Observable] | None = None,
) -> ParameterSet:
    """Map the parameters of a fit to the inputs of the model.

    Everything that is neither fitted nor held is as stated with the measurements; "stiffness" stands for whichever stiffness
    they determine. The model is `front`, by default that of `front_of`, with its `observables`. What a user asks for is checked
    before (`checked`).
    """
    every = tuple(map(_as_parameter, wanted))
    front, chosen = front or front_of(m), with_names(m, every)
    stated_inputs, free, effects = front.stated(m), list[Free](), list[Effect]()
    held: dict[str, float] = {}
    for parameter, label, rows in (*_asked(m, chosen), *_uncertain(m, front), *_arrests(m)):
        name, index = parameter.name, None
        reference, unit = stated_inputs.get(name, _reference(m, name)), m.metres if name == "offset" else 1
        if parameter.value is not None:
            held[name] = parameter.value
            with np.errstate(divide="ignore"):
                shift = (np.log(parameter.value) if PARAMETERS[name].log else parameter.value) - reference
        else:
            index = len(free)
            free.append(_free(m, front, parameter, label, rows, float(reference[rows][0])))
            # a height is fitted as one factor on all of its rows, and shown as the height of the first
            shift = np.where(rows, -reference[rows][0], 0.0) if name in HEIGHTS else -reference
        effects.append(Effect(name, rows / unit, shift * rows / unit, index))
    observables = observables_of(front) if observables is None else tuple(observables)
    return ParameterSet(m, tuple(free), held, tuple(effects), front, observables, every)


def acts_of(m: Measurements, name: str) -> dict[str, float]:
    """How much a unit of θ adds to each input.

    A width acts on the machine if its stiffness is stated over all of it.
    """
    if name == "block_width":
        return {"log_machine": -float(m.heading("machine_stiffness").endswith(OVER_ALL))}
    return PARAMETERS[name].acts


def _as_parameter(one: str | Parameter) -> Parameter:
    return Parameter(one) if isinstance(one, str) else one


def was_measured(m: Measurements) -> np.ndarray:
    """Which measurements are of real contacts, (n,)."""
    return np.isin(np.array(m.provenance or ("",) * len(m)), MEASURED)


def scatter_of_measured(m: Measurements, front: Front) -> Parameter:
    """How thresholds of real contacts are taken to scatter.

    By 3 %, within a factor of two: what 100 to 1000 asperities that break alone do on average.
    """
    bounds = front.ranges(m).get("threshold_scatter", PARAMETERS["threshold_scatter"].bounds)
    return Parameter("threshold_scatter", bounds, USUAL_SCATTER, nuisance=True)


def with_errors_of_measuring(
    m: Measurements, wanted: Sequence[Parameter], front: Front | None = None, *, size_known: bool
) -> list[Parameter]:
    """Add what measurements share or do not tell, unless it is named.

    Only for those of a provenance in `MEASURED`. Of lengths these are reading edge and tip, and what the model leaves out: a
    model factor of 1 ± `MODEL_ERROR` and, where the size of σ is known, an offset of 0 ± their median. Where the model has a
    scatter of thresholds, that (`scatter_of_measured`).
    """
    front, named, found = front or front_of(m), {one.name for one in wanted}, list[Parameter]()
    of_lengths = np.array([kind == "length" for kind in m.kind]) & ("length" in front.observes)
    if not was_measured(m).any():
        return list(wanted)
    if of_lengths.any() and size_known and m.length_sigma is not None:
        own = (0.0, float(np.median((m.length_sigma * m.metres)[of_lengths])))
        found.append(Parameter("offset", prior=own, nuisance=True))
    if of_lengths.any():
        found.append(Parameter("model_factor", prior=(1.0, MODEL_ERROR), nuisance=True))
    if "log_scatter" in front.inputs:
        found.append(scatter_of_measured(m, front))
    return [*wanted, *(one for one in found if one.name not in named)]


def _asked(m: Measurements, chosen: Sequence[Parameter]) -> Iterator[tuple[Parameter, str, np.ndarray]]:
    """Label and rows of each value that the requested parameters take."""
    every = np.ones(len(m), dtype=bool)
    measured = was_measured(m)
    for parameter in chosen:
        name = parameter.name
        specimens = list(dict.fromkeys(m.specimen)) if parameter.each else []
        shared = parameter.nuisance and name in OF_MEASURING and measured.any()
        groups = {f"{name}[{one}]": np.array([s == one for s in m.specimen]) for one in specimens}
        groups = groups or {name: measured if shared else every}
        for label, rows in groups.items():
            given = getattr(m, name, None) if PARAMETERS[name].factor and name not in HEIGHTS else None
            if parameter.value is None and given is not None and np.ptp(given[rows]) > 0:
                raise ValueError(f"parameter {label}: the measurements state more than one value of it; one must be shared")
            yield parameter, label, rows


def stated(m: Measurements, name: str, error: str = "") -> np.ndarray | None:
    """What the measurements state of a parameter, in its unit; (n,)."""
    column = getattr(m, name + error, None)
    return column if column is None or name not in HEIGHTS else column * m.metres


def _reference(m: Measurements, name: str) -> np.ndarray:
    """θ of the value stated with the measurements, which adds nothing."""
    value = stated(m, name)
    if value is None:
        return np.zeros(len(m))
    return np.log(value) if PARAMETERS[name].log else value


def _free(m: Measurements, front: Front, parameter: Parameter, label: str, rows: np.ndarray, reference: float) -> Free:
    """The θ of a parameter: its range and its prior."""
    kind = PARAMETERS[parameter.name]
    low, high = parameter.bounds or default_bounds(m, front, parameter, rows, reference)
    mean, sigma = parameter.prior or (1.0, np.inf)
    if kind.log:
        low, high, mean, sigma = np.log(low), np.log(high), np.log(mean), sigma / mean
    numbers, unit = (float(low), float(high), mean, sigma), kind.unit[m.in_si]
    symbol = kind.symbol or front.inputs[parameter.name].symbol
    return Free(label, parameter.name, symbol, unit, kind.log, *numbers, parameter.nuisance)


def stated_errors(m: Measurements, front: Front) -> dict[str, np.ndarray]:
    """Errors of inputs that the measurements state, as `stated`."""
    names = ["height", "poisson", "correlation_length", "young"]
    names += ["push_height", "push_width", "friction", "normal_stiffness"] * (front.body == "block")
    names += ["block_length"] * ("log_sites" in front.inputs)
    names += ["machine_stiffness", "block_width"] * ("log_machine" in front.inputs)
    names += ["normal_load"] * any("normal_load" in one.acts for one in observables_of(front))
    every = {name: stated(m, name, "_sigma") for name in names}
    return {name: sigma for name, sigma in every.items() if sigma is not None and np.nan_to_num(sigma).any()}


def _uncertain(m: Measurements, front: Front) -> Iterator[tuple[Parameter, str, np.ndarray]]:
    """A parameter with a prior per true value of an uncertain input.

    Rows of the same specimen, stated value and error share one.
    """
    for name, sigma in stated_errors(m, front).items():
        column = stated(m, name)
        assert column is not None  # as it has an error
        keys = list(zip(m.specimen or ("",) * len(m), column, sigma, strict=True))
        for key in dict.fromkeys(keys):
            specimen, value, error = key
            if error > 0:
                label = f"{name}[{specimen + ', ' if specimen else ''}{value:.6g}]"
                prior = float(value), float(error)
                yield Parameter(name, prior=prior, nuisance=True), label, np.array([one == key for one in keys])


def _arrests(m: Measurements) -> Iterator[tuple[Parameter, str, np.ndarray]]:
    """A parameter per precursor with gauges whose contacts were not counted.

    The number of contacts that break, ceil(ℓ), is above ℓ by what is uniform from 0 to 1.
    """
    for i in () if m.gauges is None else dict.fromkeys(m.gauges.row):
        if m.kind[i] != "whole":
            label = f"arrest[{m.label[i] if m.label else i}]"
            yield Parameter("arrest", prior=(0.5, 12**-0.5), nuisance=True), label, np.arange(len(m)) == i


def default_bounds(
    m: Measurements, front: Front, parameter: Parameter, rows: np.ndarray, reference: float
) -> tuple[float, float]:
    """Default range of the search, in the unit of the parameter."""
    name, longest = parameter.name, float(m.length[rows].max())
    if parameter.prior is not None:
        mean, sigma = parameter.prior
        if PARAMETERS[name].log:
            reach, usual = PRIOR_REACH * sigma / mean, PARAMETERS[name].bounds
            low, high = mean * np.exp(-reach), mean * np.exp(reach)
            return (max(low, usual[0]), min(high, usual[1])) if usual and usual[0] < mean < usual[1] else (low, high)
        low, high = PARAMETERS[name].limits
        if name in front.inputs:
            high = min(high, 0.99 * front.inputs[name].high)
        return max(low, mean - PRIOR_REACH * sigma), min(high, mean + PRIOR_REACH * sigma)
    if name in STIFFNESSES:
        per_unit = ratio_per_unit(m)[rows]
        lowest, highest = front.softest(m)[rows] / per_unit, front.stiffest(m)[rows] / per_unit
        # where b is bounded, it is not too large for any; of blocks, all have a precursor
        low, high = lowest.max() if front.body == "block" else lowest.min(), highest.min()
        return (float(low), float(high)) if front.interpolated and low < high else (float(lowest.min()), float(highest.max()))
    size = float(m.metres[rows].max())
    most = float(np.nanmax(m.or_zero("force")))
    own = {"offset": (-longest * size, longest * size), "threshold_slope": (-0.5 / longest, 2 / longest)}
    own = (own | {"force_offset": (-most, most)}).get(name)
    if bounds := front.ranges(m).get(name) or PARAMETERS[name].bounds or own:
        return bounds
    if name == "push_height" and m.push_height is not None:
        ratio = m.push_height[rows] / m.height[rows]
        return float(np.exp(reference)) * min(0.5, 0.02 / ratio.min()), float(np.exp(reference)) * min(2.0, 0.98 / ratio.max())
    factor = PARAMETERS[name].factor or 10.0
    lowest = 1.01 / m.height[rows].min()
    low = max(1 / factor, lowest) if name == "height" else 1 / factor
    high = min(factor, 1 / lowest) if name == "correlation_length" else factor
    return float(np.exp(reference)) * low, float(np.exp(reference)) * high


def ratio_per_unit(m: Measurements) -> np.ndarray:
    """k/K of each measurement per unit of its stiffness; without E, 1."""
    return m.metres if m.young is None else m.metres / m.young


def stiffness_name(m: Measurements) -> str:
    """Name of the stiffness that these measurements determine."""
    if not m.in_si:
        return "stiffness"
    return "areal_stiffness_over_young" if m.young is None else "areal_stiffness"


def with_names(m: Measurements, wanted: Iterable[Parameter]) -> list[Parameter]:
    """Name the stiffness as these measurements determine it."""
    return [replace(one, name=stiffness_name(m)) if one.name == "stiffness" else one for one in wanted]


def default_free(m: Measurements, held: Container[str], front: Front | type[Front]) -> list[str]:
    """The stiffness, and what the model needs and no column states."""
    unstated = [name for name in front.needs if getattr(m, name) is None]
    stiffness = [] if any(name in held for name in STIFFNESSES) else ["stiffness"]
    return [*stiffness, *(name for name in unstated if name not in held)]


def observables_of(model: Front, loss: Loss = "normal") -> tuple[Observable, ...]:
    """Observables that a model predicts."""
    return tuple(EVERY_OBSERVABLE[name](loss=loss, drawn=model.drawn) for name in model.observes)


def wanted_parameters(
    m: Measurements,
    free: Any,
    bounds: tuple[float, float] | None,
    fixed: Mapping[str, float] | None,
    front: Front | type[Front] | None = None,
) -> list[Parameter]:
    """Collect the parameters, fitted or held, that the arguments of `fit` name."""
    free = default_free(m, fixed or (), front or model_of(m)) if free is None else free
    free = (free,) if isinstance(free, (str, Parameter)) else tuple(free)
    if not free:
        raise ValueError("free = (): nothing to fit")
    wanted = [*map(_as_parameter, free)]
    if bounds is not None:
        bounded = ["stiffness" in one.name and one.value is None for one in wanted]
        if not any(bounded):
            raise ValueError(f"bounds = {bounds}: these are bounds of the stiffness, which is not fitted")
        wanted = [dataclasses.replace(one, bounds=bounds) if own else one for one, own in zip(wanted, bounded, strict=True)]
    if not isinstance(fixed, Mapping | None):
        raise TypeError(f"fixed is {type(fixed).__name__}: must be a dict of parameters and values, as {{'poisson': 0.3}}")
    return wanted + [Parameter(name, value=value) for name, value in (fixed or {}).items()]


def where_contacts_differ(
    front: Front,
    m: Measurements,
    event: MeasuredEvent | Front | None,
    free: Any,
    fixed: Mapping[str, float] | None = None,
    *,
    size_known: bool = True,
) -> Front:
    """Choose draws instead of a model of contacts that are alike.

    Where their scatter is named, if no event is; or where lengths were measured, of which the size of errors is known, if draws
    are followed for such a table.
    """
    if event is not None or (front.body, "scattered") not in FRONTS or "length" not in front.observes:
        return front
    given = (free,) if isinstance(free, (str, Parameter)) else tuple(free or ())
    held = fixed.items() if isinstance(fixed, Mapping) else ()
    every = [*map(_as_parameter, given), *(Parameter(name, value=value) for name, value in held)]
    named = {one.name: one for one in every}
    if "threshold_scatter" in named:
        return front if named["threshold_scatter"].value == 0 else front_for(front.body, "scattered", m)
    moving = {one.name for one in every if one.value is None} & {"prestress", "residual_strength"}
    if not was_measured(m).any() or not size_known or moving:
        return front
    with suppress(ValueError):
        draws = front_for(front.body, "scattered", m)
        draws.check(m, named | {"threshold_scatter": scatter_of_measured(m, draws)})
        return draws
    return front


# --- what is asked for --------------------------------------------------------------------------------------------------


def checked(
    m: Measurements,
    wanted: Iterable[str | Parameter],
    event: MeasuredEvent | Front | None = None,
    body: Body | None = None,
    loss: Loss = "normal",
    own: Iterable[Observable] = (),
) -> ParameterSet:
    """Check the parameters of a fit, and map them to inputs.

    With the observables of the model, and those of one's `own`.

    A ValueError if one is given twice, has no meaning for these measurements, is needed and missing, or its limits leave the
    domain of the model, or the range in which a domino starts.
    """
    front, wanted = front_of(m, event, body), [*map(_as_parameter, wanted)]
    chosen = with_names(m, wanted)
    names = [one.name for one in chosen]
    for one in chosen:
        _check_meaning(m, one, names)
    if missing := [name for name in front.columns if name not in m.other]:
        raise ValueError(f"{m.source}: the model reads the column {missing[0]}, which is not there")
    observables = _with_own(m, observables_of(front, loss), own)
    for one in observables:
        one.check(m, names)
    _check_complete(m, chosen, observables)
    front.check(m, {one.name: one for one in chosen})
    _check_separable(m, chosen, front, observables)
    known = {name for one in observables for name in (*one.acts, one.added)} | {"block_width"}
    for name in names:
        alike = name == "threshold_scatter" and next(one for one in chosen if one.name == name).value == 0
        if not PARAMETERS[name].acts.keys() & {*front.inputs, *COMMON} and name not in known and not alike:
            raise ValueError(f"parameter {name}: no part of the model, of a {front.name}")
    for name in stated_errors(m, front):
        if name in names:
            error = "the measurements state its error: give it a prior there, or leave it out here"
            raise ValueError(f"{name} is to be fitted, and {error}")
    q = parameter_set(m, wanted, front, observables)
    _check_domain(m, q)
    _check_reached(m, q)
    return q


def _with_own(m: Measurements, known: tuple[Observable, ...], own: Iterable[Observable]) -> tuple[Observable, ...]:
    """Add observables of one's own.

    A ValueError names one that has no data, or a name that is taken.
    """
    for one in (own := tuple(own)):
        if not isinstance(one, Observable):
            raise TypeError(f"observables: {one!r}: give instances of Observable (docs/howto/extend.md)")
        if one.name in EVERY_OBSERVABLE or [other.name for other in own].count(one.name) > 1:
            raise ValueError(f"observables: the name {one.name!r} is taken")
        if not one.there(m):
            raise ValueError(f"observables: {m.source} has no column {one.column.name(m.in_si)}, or no value in it")
    return (*known, *own)


def _check_meaning(m: Measurements, one: Parameter, names: Sequence[str]) -> None:
    """Check that a parameter has a meaning for these measurements."""
    stiffness = stiffness_name(m)
    if names.count(one.name) > 1:
        raise ValueError(f"parameter {one.name} is given {names.count(one.name)} times")
    if one.name == "arrest":
        raise ValueError("parameter arrest: it is fitted wherever gauges were read; do not name it")
    if one.name in STIFFNESSES and one.name != stiffness:
        raise ValueError(f"parameter {one.name}: these measurements determine {stiffness}")
    if one.name in NEEDS_SI and not m.in_si:
        raise ValueError(f"parameter {one.name}: needs measurements in SI, with their correlation length")
    _check_stated(m, one)
    if one.each == "specimen" and not m.specimen:
        raise ValueError(f"parameter {one.name}: each = 'specimen', but the measurements name no specimens")
    if one.name == "model_factor" and one.prior is None and one.value is None:
        raise ValueError(
            "parameter model_factor: needs a prior, as (1, 0.05): the lengths alone cannot separate it from stiffness"
        )


def _check_stated(m: Measurements, one: Parameter) -> None:
    """Check that the table states what a parameter starts from."""
    if one.name in STARTS and (getattr(m, one.name) is None or not np.isfinite(getattr(m, one.name)).all()):
        raise ValueError(f"parameter {one.name}: the measurements state no {EVERY[one.name].name(in_si=m.in_si)} to start from")
    if one.name == "force_offset" and m.force is None:
        raise ValueError("parameter force_offset: the measurements have no forces")


def _check_complete(m: Measurements, chosen: Sequence[Parameter], observables: Iterable[Observable]) -> None:
    """Check that what the measurements need is fitted or held."""
    stiffness, names = stiffness_name(m), [one.name for one in chosen]
    if stiffness not in names:
        option = m.option(f"--free stiffness, or --fix {stiffness}=VALUE", f"fixed={{{stiffness!r}: …}}, or free with it")
        raise ValueError(f"{stiffness} is neither fitted nor held: name it: {option}")
    if "strength" not in names and (carrier := _carries_strength(m, observables)):
        asked = ["stiffness" if one.name == stiffness else one.name for one in chosen if one.value is None and not one.nuisance]
        both = dict.fromkeys([*asked, "strength"])
        option = m.option(" ".join(f"--free {name}" for name in both), f"free={[*both]}".replace("'", '"'))
        raise ValueError(f"{carrier} scales with σ_s: fit strength too, or hold it at its value in Pa: {option}")
    if all(one.value is not None for one in chosen):
        raise ValueError("nothing is fitted: every parameter is held")


def _carries_strength(m: Measurements, observables: Iterable[Observable]) -> str:
    """Name what was measured that scales with σ_s; empty without any."""
    own = dict.fromkeys(one.stated_by(m) for one in observables if "strength" in one.acts and one.there(m))
    return " and ".join(own)


def _check_separable(m: Measurements, chosen: Sequence[Parameter], front: Front, observables: Iterable[Observable]) -> None:
    """Refuse prestress and what contacts keep together, where only lengths were measured."""
    free = [one for one in chosen if one.name in ("prestress", "residual_strength") and one.value is None and not one.prior]
    if len(free) == 2 and "length" in front.observes and all(isinstance(x, Length) or not x.there(m) for x in observables):
        option = m.option("--fix prestress=0", 'fixed={"prestress": 0}')
        raise ValueError(
            f"parameters prestress and residual_strength: lengths determine only (φ − r)/(1 − r): hold one ({option}), state a "
            "prior of it, or measure forces or the stress behind the tip too"
        )


# --- the range that is searched -----------------------------------------------------------------------------------------


def _check_domain(m: Measurements, q: ParameterSet) -> None:
    """Check that no limit leads outside the domain of the model."""
    every = {**COMMON, **q.front.inputs}
    for name in q.inputs.names:
        linear, (symbol, low, high, requirement) = q.inputs.get(name), every[name][:4]
        reach = [float(end) for end in (_reach(q, linear)[0].min(), _reach(q, linear)[1].max())]
        if low - 1e-9 <= reach[0] and reach[1] <= high + 1e-9:
            continue
        if mistaken := "; ".join(
            _far_from_the_table(m, [one for one in q.wanted if name in PARAMETERS[one.name].acts], q.front)
        ):
            raise ValueError(mistaken)
        shown = [np.exp(x) if name.startswith("log") else x for x in reach]
        moving = " and ".join(one.label for one, by in zip(q.free, linear.slope.any(axis=0), strict=True) if by)
        held = " and ".join(f"{one} = {x:g}" for one, x in q.held.items() if name in PARAMETERS[one].acts)
        searched = f"the range searched for {moving}" + f" with {held}" * bool(held) if moving else held
        raise ValueError(
            f"{searched} means {symbol} {_span(*shown)} for some measurement: {requirement}; give "
            + ("other bounds or another prior" if moving else "another value")
        )


def _check_reached(m: Measurements, q: ParameterSet) -> None:
    """Refuse a range of stiffness in which no domino starts.

    It is probably in another unit: no measurement is of more than the contact at the edge, whatever the other parameters.
    """
    name = stiffness_name(m)
    one = next(one for one in q.wanted if one.name in ("stiffness", name))
    key = next((key for key in ("bounds", "prior", "value") if getattr(one, key) is not None), None)
    if key is None or m.length.min() <= 1 or "length" not in q.front.observes:
        return
    reach = {each: _reach(q, q.inputs.get(each)) for each in q.inputs.names}
    easiest = {
        each: ends[each not in ("threshold_slope", "friction", "log_machine", "residual_strength")]
        for each, ends in reach.items()
    }
    low, high = reach["log_stiffness"]
    softest = np.log(front_for("slider", "domino").softest(m))
    some = np.flatnonzero(high > softest)
    from_, to = np.maximum(low, softest)[some], high[some]
    rows = Inputs.from_table([*easiest], np.stack([*easiest.values()], axis=-1)).take(some)
    for share in (0.5, 1.0, 0.0, *np.linspace(0, 1, 65)) if len(some) else ():
        at = rows._replace(log_stiffness=from_ + share * (to - from_))
        if (q.front.starts(at) > 1).any():
            return
    lowest, highest = default_bounds(m, q.front, Parameter(name), np.ones(len(m), dtype=bool), 0.0)
    lowest *= 1 if q.front.body == "block" else 100  # the default range of sliders begins where none starts
    numbers, unit = np.atleast_1d(getattr(one, key)), PARAMETERS[name].unit[m.in_si]
    shown = ", ".join(f"{x:g}" for x in numbers)
    meant = f" (k/K = {numbers[0]:g} is {numbers[0] / ratio_per_unit(m).max():.2g} {unit})"
    raise ValueError(
        f"{key} = {f'({shown})' if key != 'value' else shown} of {name}{f', in {unit}' * m.in_si}: no domino starts at k/K "
        f"{_span(np.exp(low.min()), np.exp(high.max()))}; expected within {lowest:.2g} to {highest:.2g} {unit}".rstrip()
        + meant * bool(m.in_si and numbers[0] <= STIFFEST)
    )


def _span(low: float, high: float) -> str:
    """Write a range, or a number: ``from 0.1 to 0.7``, ``= 3``."""
    return f"from {low:.4g} to {high:.4g}" if low < high else f"= {low:.4g}"


def _reach(q: ParameterSet, linear: Linear) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest number that each measurement gets from any θ searched."""
    down, up = np.minimum(linear.slope, 0), np.maximum(linear.slope, 0)
    return linear.base + up @ q.low + down @ q.high, linear.base + up @ q.high + down @ q.low


# --- suspicions ---------------------------------------------------------------------------------------------------------


def suspicions(m: Measurements, parameters: Iterable[Parameter], front: Front | None = None) -> tuple[str, ...]:
    """Find columns that may be exchanged, and numbers in another unit.

    `parameters` are those of the fit, requested or held.
    """
    wanted, front = list(parameters), front or front_of(m)
    exchanged = _exchanged(m, wanted) if "length" in front.observes else ()
    return (*exchanged, *_unlikely(m), *_far_from_the_table(m, wanted, front))


def _exchanged(m: Measurements, wanted: Sequence[Parameter]) -> Iterator[str]:
    """Compare lengths and heights, which prestress, ends and machines may lengthen."""
    prestressed = any(one.name == "prestress" for one in wanted) or m.or_zero("prestress").any()
    lengthened = prestressed or m.machine_stiffness is not None or m.block_length is not None
    over = float(np.median(m.length / m.height))
    if SUSPECT[0] <= over <= SUSPECT[1] * (5 if lengthened else 1):
        return
    height, length = m.heading("height"), m.heading("length")
    may_be = [f"are {height} and {length} exchanged"] * bool(LIKELY.holds(1 / over))
    factors = Domain(over / LIKELY.high, over / LIKELY.low, "")  # on the heights
    for name, own, value, likely in (("height", height, 1.0, factors), ("length", length, over, LIKELY)):
        unit = COLUMNS[name].likely_unit(value, own, likely) if m.in_si else ""
        may_be += [f"is {own} in {unit}"] * bool(unit)
    if may_be:
        yield f"the lengths are about {over:.3g} times the heights: {', or '.join(may_be)}?"


def _unlikely(m: Measurements) -> Iterator[str]:
    """Find numbers that hardly any experiment has."""
    for name in (name for name in NUMERIC if COLUMNS[name].likely is not None):
        column, x = COLUMNS[name], getattr(m, name)
        if x is None or (column.unit and not m.in_si) or column.likely is None:
            continue
        in_si = x * m.metres if name in IN_LC else x
        off, own = in_si[~column.likely.holds(in_si)], m.heading(name)
        unit = column.likely_unit(off[0], own) if off.size else ""
        if off.size and (unit or name != "height"):  # a low sample may be what was meant
            number = off[0] / column.names(in_si=True).get(own, 1.0)
            yield f"{own} = {number:.4g} is {column.likely.requirement}" + f": is it in {unit}?" * bool(unit)


def _far_from_the_table(m: Measurements, wanted: Iterable[Parameter], front: Front) -> Iterator[str]:
    """Find priors, values and bounds far from what is stated or usual."""
    usual = USUALLY | front.usual(m)
    for one in (one for one in wanted if one.name in COMPARED):
        key = next((key for key in ("prior", "value", "bounds") if getattr(one, key) is not None), None)
        column = stated(m, one.name)
        if key is None or (column is None and one.name not in usual):
            continue
        table = np.array(usual[one.name]) if column is None else column[np.isfinite(column)]
        if one.name in HEIGHTS and one.each is None:  # shown as that of the first
            table = table[:1]
        low, high = getattr(one, key) if key == "bounds" else np.repeat(getattr(one, key), 2)[:2]
        unit, widest = PARAMETERS[one.name].unit[m.in_si], 3 if column is None else 50  # m and cm are 100 apart
        likely = Domain(table[0] / 1.5 * low / high, table[-1] * 1.5, "")  # of the lower end, in the unit that was meant
        meant = COLUMNS[IN_UNIT[unit]].likely_unit(low, likely=likely) if unit in IN_UNIT else ""
        of_all = IN_ALL.get(one.name, "") if m.block_width is not None and likely.holds(low / m.block_width[0]) else ""
        if max(low / table.max(), table.min() / high) > widest or (of_all and not likely.holds(low)):
            number = f"{low:g} to {high:g}" if key == "bounds" else f"{low:g}"
            where = f"where {m.heading(one.name)} says {table[0]:.4g} {unit}"
            where = where if column is not None else f"usually {table[0]:.2g} to {table[1]:.2g} {unit}"
            asked = f"; is it in {of_all or meant}?" * bool(of_all or meant)
            yield f"{one.name} = {number} {unit}, {where}: priors, bounds and held values are in {unit}{asked}"


# --- other uses of measurements -----------------------------------------------------------------------------------------


def check_used(m: Measurements, what: str) -> None:
    """Refuse ends and machines, for a caller that ignores them.

    A warning names other columns that are not used: errors of inputs, errors that measured lengths share, and gauges would have
    changed the errors of the result.
    """
    if "length" not in model_of(m).observes:
        raise MeasurementError(f"{m.source}: {what} takes first precursors, and not the forces of a sequence: leave out force")
    for name in ("block_length", "machine_stiffness"):
        if getattr(m, name) is not None and np.isfinite(getattr(m, name)).any():
            raise MeasurementError(f"{m.source}, column {name}: {what} takes blocks without end, whose edge is held")
    if m.or_zero("residual_strength").any():
        raise MeasurementError(f"{m.source}, column residual_strength: {what} takes contacts that lose everything")
    errors = [one for one in COLUMNS if one.endswith("_sigma") and COLUMNS[one].value in PARAMETERS]
    unused = [m.heading(name) for name in errors if getattr(m, name) is not None and np.any(getattr(m, name))]
    unused += ["gauges"] * (m.gauges is not None) + ["what lengths of provenance measured share"] * ("measured" in m.provenance)
    if unused:
        text = f"{m.source}: {what} takes the inputs as exact and errors as independent, without {', '.join(unused)}"
        warnings.warn(text, MeasurementWarning, stacklevel=3)
