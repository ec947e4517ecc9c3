"""Parameters of a fit, and the linear map to the model's inputs.

Positive parameters are fitted as θ = ln(value), the others as they are. Every input of the model (`Inputs`), and the logarithm
of every scale that turns model units into measured ones, is then **linear** in θ. Heights, moduli and correlation lengths with
errors of their own are parameters with a prior, like any other.
"""

import dataclasses
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from slippulse_jax.base.choices import did_you_mean
from slippulse_jax.base.domains import in_unit, real_numbers
from slippulse_jax.bulk.chunks import distinct_rows
from slippulse_jax.inference.model.fronts import Front, front_of
from slippulse_jax.inference.model.inputs import COMMON, Inputs
from slippulse_jax.inference.table.columns import OVER_ALL
from slippulse_jax.inference.table.measurements import Measurements

SCALES = ("length", "reach", "first", "displacement", "force", "slip", "stress", "position", "offset", "force_offset", "beyond")
"""ln(unit of measurement per unit of the model) of each observable, `reach` that of forces by place; what is added to a length,
in λc, and to a force; and the contacts broken beyond ℓ when gauges were read."""
PRIOR_REACH = 6.0
"""Standard deviations of a prior searched on either side where no bounds are given."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Linear:
    """One number per measurement, linear in θ."""

    base: np.ndarray  # (n,)
    slope: np.ndarray  # (n, p)

    def __call__(self, theta: Any) -> Any:
        """Values at θ of shape (…, p); shape (…, n)."""
        return self.base + theta @ self.slope.T

    def __getitem__(self, rows: Any) -> "Linear":
        """Select some measurements."""
        return Linear(self.base[rows], self.slope[rows])


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
        if self.value is not None and not (np.isfinite(self.value) and (self.value > 0 or not positive)):
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


@dataclasses.dataclass(frozen=True, eq=False)
class ParameterSet:
    """The map from θ, (p,), to the inputs of every measurement."""

    free: tuple[Free, ...]
    held: dict[str, float]  # by name, in their units
    inputs: Inputs  # a `Linear` each
    scales: dict[str, Linear]  # what else θ acts on, by the names of `SCALES`
    front: Front  # the model of a length
    wanted: tuple[Parameter, ...]  # of which it was made, with those that measuring adds

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
        return longest * np.exp(self.scales["length"](theta)) + self.scales["offset"](theta), where

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
    acts: dict[str, float]  # what a unit of θ adds to each of the inputs and `SCALES`
    bounds: tuple[float, float] | None = None  # searched by default
    factor: float | None = None  # of one that measurements may state: up to which multiple of it is searched, if no bounds are
    limits: tuple[float, float] = (-np.inf, np.inf)  # of a range that follows from a prior


PARAMETERS: dict[str, ParameterKind] = {
    "stiffness": ParameterKind("k/K", ("", ""), True, {"log_stiffness": 1}),
    "areal_stiffness": ParameterKind("k/λc²", ("Pa/m", "Pa/m"), True, {"log_stiffness": 1, "displacement": -1, "slip": -1}),
    "areal_stiffness_over_young": ParameterKind("(k/λc²)/E", ("1/m", "1/m"), True, {"log_stiffness": 1}),
    "height": ParameterKind("H", ("λc", "m"), True, {"log_height": 1, "log_push": -1, "log_push_width": -1}, factor=2.0),
    "correlation_length": ParameterKind(
        "λc", ("", "m"), True,
        # H/λc falls; k/K = (k/λc²) λc/E rises
        {"log_height": -1, "log_stiffness": 1, "length": 1, "force": 1, "position": 1, "log_sites": -1},
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
    "friction": ParameterKind("", ("", ""), False, {"friction": 1}, (0.0, 0.95), 1.0, limits=(0.0, np.inf)),
    "newborn": ParameterKind("newborn", ("", ""), False, {"newborn": 1}, (0.05, 1.0), limits=(0.01, 1.0)),
    "time_constant": ParameterKind("τ", ("u_s", "u_s"), True, {"log_time": 1}, (0.02, 50.0)),
    "threshold_scatter": ParameterKind("scatter", ("", ""), False, {"threshold_scatter": 1}, (0.0, 0.15), limits=(0.0, 0.3)),
    "machine_stiffness": ParameterKind("M", ("E", "Pa"), True, {"log_machine": 1}, factor=10.0),
    "normal_load": ParameterKind("F_N", ("", "N/m"), True, {"reach": 1}, factor=10.0),
    "strength": ParameterKind("σ_s", ("", "Pa"), True, {"displacement": 1, "force": 1, "slip": 1, "stress": 1}, (1.0, 1e12)),
    "offset": ParameterKind("offset", ("λc", "m"), False, {"offset": 1}),
    "force_offset": ParameterKind("force offset", ("", "N/m"), False, {"force_offset": 1}),
    "model_factor": ParameterKind("model factor", ("", ""), True, {"length": 1}),
    "arrest": ParameterKind("contacts beyond ℓ", ("λc", "λc"), False, {"beyond": 1}),
}  # fmt: skip
"""Every parameter by name; k/K, areal stiffness and its ratio to E are one parameter, named by what the data determine."""
STIFFNESSES = ("stiffness", "areal_stiffness", "areal_stiffness_over_young")
HEIGHTS = ("height", "push_height", "push_width", "block_length")
"""Lengths held in λc and shown in metres where λc is known; fitted as one factor on all of their rows."""
NEEDS_SI = ("correlation_length", "young", "strength")
OF_MEASURING = ("offset", "model_factor")
"""What is fitted beside for lengths of provenance "measured", and acts on these."""
MODEL_ERROR = 0.1
"""Default relative error of the model's length for measured blocks: about the difference to a block under two-dimensional
elasticity that is pushed over all but the lowest quarter of its side. Other pushers: docs/model/limits.md."""


def parameter_set(
    m: Measurements,
    wanted: Iterable[str | Parameter],
    front: Front | None = None,
) -> ParameterSet:
    """Map the parameters of a fit to the inputs of the model.

    Everything that is neither fitted nor held is as stated with the measurements; "stiffness" stands for whichever stiffness
    they determine. The model of a length is `front`, by default that of `front_of`. What a user asks for is checked before
    (`slippulse_jax.inference.model.check.checked`).
    """
    wanted = tuple(Parameter(one) if isinstance(one, str) else one for one in wanted)
    front, chosen = front or front_of(m), with_names(m, wanted)
    log_lc, log_young = np.log(m.metres), 0.0 if m.young is None else np.log(m.young)
    every = np.log(m.height), log_lc - log_young, m.poisson, m.or_zero("prestress"), m.or_zero("threshold_slope")
    inputs = dict(zip(COMMON, every, strict=True)) | front.stated(m)
    base = inputs | {name: log_lc if name == "force" else np.zeros(len(m)) for name in SCALES}
    if m.normal_load is not None:
        base["reach"] = np.log(m.normal_load)
    free: list[Free] = []
    slopes: list[dict[str, np.ndarray]] = []
    held: dict[str, float] = {}
    for parameter, label, rows in (*_asked(m, chosen), *_uncertain(m, front), *_arrests(m)):
        name = parameter.name
        reference, unit = inputs.get(name, _reference(m, name)), m.metres if name == "offset" else 1
        of_kind = _by_width(m) if name == "block_width" else PARAMETERS[name].acts
        acts = {target: size * rows / unit for target, size in of_kind.items()}  # of a unit of θ
        if parameter.value is not None:
            held[name] = parameter.value
            shift = (np.log(parameter.value) if PARAMETERS[name].log else parameter.value) - reference
        else:
            free.append(_free(m, front, parameter, label, rows, float(reference[rows][0])))
            slopes.append(acts)
            # a height is fitted as one factor on all of its rows, and shown as the height of the first
            shift = np.where(rows, -reference[rows][0], 0.0) if name in HEIGHTS else -reference
        base |= {target: base[target] + size * shift for target, size in acts.items() if target in base}

    def linear(target: str) -> Linear:
        columns = [acts.get(target, np.zeros(len(m))) for acts in slopes]
        return Linear(base[target], np.stack(columns, axis=-1).astype(float))

    maps = Inputs(*map(linear, COMMON), more={name: linear(name) for name in inputs if name not in COMMON})
    return ParameterSet(tuple(free), held, maps, {name: linear(name) for name in SCALES}, front, wanted)


def with_errors_of_measuring(m: Measurements, wanted: Sequence[Parameter], *, size_known: bool) -> list[Parameter]:
    """Add the errors that all measured lengths share, unless they are named.

    These are reading edge and tip, and what the model leaves out. Only for lengths of provenance "measured": a model factor of
    1 ± `MODEL_ERROR` and, where the size of σ is known, an offset of 0 ± their median.
    """
    of_lengths = np.array([kind == "length" for kind in m.kind])
    if "measured" not in m.provenance or not of_lengths.any() or m.is_sequence:
        return list(wanted)
    priors = {"model_factor": (1.0, MODEL_ERROR)}
    if size_known and m.length_sigma is not None:
        priors = {"offset": (0.0, float(np.median((m.length_sigma * m.metres)[of_lengths])))} | priors
    named = {one.name for one in wanted}
    return [*wanted, *(Parameter(name, prior=prior, nuisance=True) for name, prior in priors.items() if name not in named)]


def _asked(m: Measurements, chosen: Sequence[Parameter]) -> Iterator[tuple[Parameter, str, np.ndarray]]:
    """Label and rows of each value that the requested parameters take."""
    every = np.ones(len(m), dtype=bool)
    measured = np.array([one == "measured" for one in m.provenance], dtype=bool)
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


def _by_width(m: Measurements) -> dict[str, float]:
    """What a block's width acts on: all that is stated over it."""
    columns = map(m.heading, ("force", "normal_load", "machine_stiffness"))
    force, load, machine = (float(column.endswith(OVER_ALL)) for column in columns)
    return {"force": force, "reach": force - load, "log_machine": -machine}


def stated_errors(m: Measurements, front: Front) -> dict[str, np.ndarray]:
    """Errors of inputs that the measurements state, as `stated`."""
    names = ["height", "poisson", "correlation_length", "young"]
    names += ["push_height", "push_width", "friction", "normal_stiffness"] * (front.body == "block")
    names += ["block_length"] * ("log_sites" in front.inputs)
    names += ["machine_stiffness", "block_width"] * ("log_machine" in front.inputs)
    names += ["normal_load"] * (front.event == "sequence")
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
            reach = PRIOR_REACH * sigma / mean
            return mean * np.exp(-reach), mean * np.exp(reach)
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


def default_free(m: Measurements, held: Container[str]) -> list[str]:
    """The stiffness, and what a sequence needs and no column states."""
    unstated = [name for name in ("friction", "normal_load") if m.is_sequence and getattr(m, name) is None]
    stiffness = [] if any(name in held for name in STIFFNESSES) else ["stiffness"]
    return [*stiffness, *(name for name in unstated if name not in held)]


def wanted_parameters(
    m: Measurements, free: Any, bounds: tuple[float, float] | None, fixed: Mapping[str, float] | None
) -> list[Parameter]:
    """Collect the parameters, fitted or held, that the arguments of `fit` name."""
    free = default_free(m, fixed or ()) if free is None else free
    free = (free,) if isinstance(free, (str, Parameter)) else tuple(free)
    if not free:
        raise ValueError("free = (): nothing to fit")
    wanted = [Parameter(one) if isinstance(one, str) else one for one in free]
    if bounds is not None:
        bounded = ["stiffness" in one.name and one.value is None for one in wanted]
        if not any(bounded):
            raise ValueError(f"bounds = {bounds}: these are bounds of the stiffness, which is not fitted")
        wanted = [dataclasses.replace(one, bounds=bounds) if own else one for one, own in zip(wanted, bounded, strict=True)]
    if not isinstance(fixed, Mapping | None):
        raise TypeError(f"fixed is {type(fixed).__name__}: must be a dict of parameters and values, as {{'poisson': 0.3}}")
    return wanted + [Parameter(name, value=value) for name, value in (fixed or {}).items()]
