"""Parameters of a fit, and the linear map from the fitted numbers θ to the named inputs of the model.

Positive parameters are fitted as θ = ln(value), the others as they are. Every input of the model (`Inputs`), and the logarithm
of every scale that turns model units into measured ones, is then **linear** in θ. Heights, moduli and correlation lengths with
errors of their own are parameters with a prior, like any other.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from slippulse_jax.bulk.chunks import distinct_rows
from slippulse_jax.inference.choices import Body, MeasuredEvent
from slippulse_jax.inference.fronts import STIFFEST, Front, WholeEvent, front_for, front_of
from slippulse_jax.inference.inputs import COMMON, Inputs
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.keywords import did_you_mean
from slippulse_jax.units import UNITS_OF_LENGTH, UNITS_OF_MODULUS

SCALES = ("length", "displacement", "force", "slip", "stress", "position", "offset", "beyond")
"""ln(unit of measurement per unit of the model) of each observable; what is added to a length, in λc; and the contacts broken
beyond ℓ when gauges were read."""
PRIOR_REACH = 6.0
"""Standard deviations of a prior searched on either side where no bounds are given."""
HELD = 1e-6
"""Deviation of a prior, over the mean, below which it must have been given in another unit."""
FAR = 50.0
"""Factor between a parameter and the value in the table above which a unit is suspected: m and cm are 100 apart."""


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


def _is_number(x: object) -> bool:
    if isinstance(x, bool) or not isinstance(x, int | float | np.number | np.ndarray) or np.ndim(x):
        return False
    return not isinstance(x, int) or abs(x) < 2**63  # NumPy takes no larger ones


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
            if positive and sigma < HELD * mean:
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
                raise ValueError(f"parameter {self.name}: {key} = {given!r}: must be {wanted}")
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
        """Convert θ, a number or an array, to the parameter in its unit."""
        value = np.exp(theta) if self.log else theta
        return value if np.ndim(theta) else float(value)

    def theta(self, value: float) -> float:
        """Convert a value to θ."""
        return float(np.log(value)) if self.log else float(value)


@dataclasses.dataclass(frozen=True, eq=False)
class ParameterSet:
    """The map from θ, shape (p,), to the inputs of the model for every measurement."""

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
        """Values of the requested parameters at θ, shape (p,), or of those fitted because of their errors."""
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
        """Indices of the measurements whose inputs depend on a parameter; of all if none do."""
        slopes = np.array([self.inputs.get(name).slope[:, index] for name in self.inputs.names])
        own = np.flatnonzero(slopes.any(axis=0))
        return own if own.size else np.arange(slopes.shape[1])

    def inputs_at(self, theta: np.ndarray) -> Inputs:
        """Inputs of each measurement, shape (…, n), at θ of shape (…, p)."""
        return self.inputs.at(theta)

    def common_ratio(self, theta: np.ndarray) -> float | None:
        """k/K at θ where a stiffness is fitted and k/K is the same for all measurements."""
        fitted = any("stiffness" in one.label for one in self.free if not one.nuisance)
        return self.inputs_at(theta).common_ratio if fitted else None


class Kind(NamedTuple):
    """A row of the table of parameters."""

    symbol: str
    unit: tuple[str, str]  # for lengths in λc, and in SI
    log: bool
    acts: dict[str, float]  # what a unit of θ adds to each of the inputs and `SCALES`
    bounds: tuple[float, float] | None = None  # searched by default
    factor: float | None = None  # of one that measurements may state: up to which multiple of it is searched, if no bounds are
    limits: tuple[float, float] = (-np.inf, np.inf)  # of a range that follows from a prior


PARAMETERS: dict[str, Kind] = {
    "stiffness": Kind("k/K", ("", ""), True, {"log_stiffness": 1}),
    "areal_stiffness": Kind("k/λc²", ("Pa/m", "Pa/m"), True, {"log_stiffness": 1, "displacement": -1, "slip": -1}),
    "areal_stiffness_over_young": Kind("(k/λc²)/E", ("1/m", "1/m"), True, {"log_stiffness": 1}),
    "height": Kind("H", ("λc", "m"), True, {"log_height": 1, "log_push": -1, "log_push_width": -1}, factor=2.0),
    "correlation_length": Kind(
        "λc", ("", "m"), True,
        # H/λc falls; k/K = (k/λc²) λc/E rises
        {"log_height": -1, "log_stiffness": 1, "length": 1, "force": 1, "position": 1, "log_sites": -1},
        factor=10.0,
    ),
    "push_height": Kind("h", ("λc", "m"), True, {"log_push": 1}, factor=2.0),
    "young": Kind("E", ("", "Pa"), True, {"log_stiffness": -1, "log_machine": -1}, factor=10.0),
    "poisson": Kind("ν", ("", ""), False, {"poisson": 1}, (0.0, 0.5), 1.0, (-0.99, 0.5)),
    "prestress": Kind("φ", ("σ_s", "σ_s"), False, {"prestress": 1}, (-0.95, 0.95), 1.0, (-0.99, 0.99)),
    "threshold_slope": Kind("ε", ("1/λc", "1/λc"), False, {"threshold_slope": 1}, None, 1.0),
    "friction": Kind("", ("", ""), False, {"friction": 1}, (0.0, 0.95), 1.0, limits=(0.0, np.inf)),
    "strength": Kind("σ_s", ("", "Pa"), True, {"displacement": 1, "force": 1, "slip": 1, "stress": 1}, (1.0, 1e12)),
    "offset": Kind("offset", ("λc", "m"), False, {"offset": 1}),
    "model_factor": Kind("model factor", ("", ""), True, {"length": 1}),
    "arrest": Kind("contacts beyond ℓ", ("λc", "λc"), False, {"beyond": 1}),
}  # fmt: skip
"""Every parameter by name; k/K, areal stiffness and its ratio to E are one parameter, named by what the data determine."""
STIFFNESSES = ("stiffness", "areal_stiffness", "areal_stiffness_over_young")
ARREST = (0.5, 12**-0.5)
"""Mean and deviation of the difference between ℓ and the number of contacts that break, ceil(ℓ): uniform from 0 to 1."""
HEIGHTS = ("height", "push_height")
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
    event: MeasuredEvent | None = None,
    body: Body | None = None,
    *,
    front: Front | None = None,
) -> ParameterSet:
    """Map the parameters of a fit to the inputs of the model for these measurements.

    Everything that is neither fitted nor held is as stated with the measurements; "stiffness" stands for whichever stiffness
    they determine. `event` and `body` are as for `front_of`; or `front` is the model of a length, that of measurements much
    like these. A ValueError if a parameter is given twice, has no meaning for these measurements, is needed and missing, or its
    limits leave the domain of the model.
    """
    wanted = tuple(Parameter(one) if isinstance(one, str) else one for one in wanted)
    front, chosen = front_of(m, event, body) if front is None else front, _validated(m, wanted)
    front.check(m, {one.name for one in chosen})
    log_lc = np.zeros(len(m)) if m.correlation_length is None else np.log(m.correlation_length)
    log_young = np.zeros(len(m)) if m.young is None else np.log(m.young)
    stated = np.log(m.height), log_lc - log_young, m.poisson, m.or_zero("prestress"), m.or_zero("threshold_slope")
    inputs = dict(zip(COMMON, stated, strict=True)) | front.stated(m)
    base = inputs | {name: log_lc if name == "force" else np.zeros(len(m)) for name in SCALES}
    free: list[Free] = []
    slopes: list[dict[str, np.ndarray]] = []
    held: dict[str, float] = {}
    for parameter, label, rows in (*_asked(m, chosen), *_uncertain(m, front, chosen), *_arrests(m)):
        name = parameter.name
        reference, acts = inputs.get(name, _reference(m, name)), _acts(m, name, rows)
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
    q = ParameterSet(tuple(free), held, maps, {name: linear(name) for name in SCALES}, front, wanted)
    _check_domain(m, q)
    _check_reached(m, q)
    return q


def with_errors_of_measuring(m: Measurements, wanted: Sequence[Parameter], *, size_known: bool) -> list[Parameter]:
    """Add the errors that all measured lengths share, unless they are named.

    These are reading edge and tip, and what the model leaves out. Only for lengths of provenance "measured": a model factor of
    1 ± `MODEL_ERROR` and, where the size of σ is known, an offset of 0 ± their median.
    """
    of_lengths = np.array([kind == "length" for kind in m.kind])
    if "measured" not in m.provenance or not of_lengths.any():
        return list(wanted)
    priors = {"model_factor": (1.0, MODEL_ERROR)}
    if size_known and m.length_sigma is not None:
        metres = np.ones(len(m)) if m.correlation_length is None else m.correlation_length
        priors = {"offset": (0.0, float(np.median((m.length_sigma * metres)[of_lengths])))} | priors
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
            stated = getattr(m, name, None) if PARAMETERS[name].factor and name not in HEIGHTS else None
            if parameter.value is None and stated is not None and np.ptp(stated[rows]) > 0:
                raise ValueError(f"parameter {label}: the measurements state more than one value of it; one must be shared")
            yield parameter, label, rows


def _acts(m: Measurements, name: str, rows: np.ndarray) -> dict[str, np.ndarray]:
    """What a unit of θ adds to each input and scale of every measurement."""
    acts = {target: size * rows for target, size in PARAMETERS[name].acts.items()}
    if name == "offset" and m.correlation_length is not None:
        acts["offset"] = rows / m.correlation_length
    return acts


def _reference(m: Measurements, name: str) -> np.ndarray:
    """θ at which a parameter adds nothing to any row: the value stated with the measurements."""
    column = getattr(m, name, None)
    if column is None:
        return np.zeros(len(m))
    if name in HEIGHTS and m.correlation_length is not None:
        column = column * m.correlation_length
    return np.log(column) if PARAMETERS[name].log else column


def _free(m: Measurements, front: Front, parameter: Parameter, label: str, rows: np.ndarray, reference: float) -> Free:
    """The θ of a parameter: its range and its prior."""
    kind = PARAMETERS[parameter.name]
    low, high = parameter.bounds or _default_bounds(m, front, parameter, rows, reference)
    mean, sigma = parameter.prior or (1.0, np.inf)
    if kind.log:
        low, high, mean, sigma = np.log(low), np.log(high), np.log(mean), sigma / mean
    numbers, unit = (float(low), float(high), mean, sigma), kind.unit[m.correlation_length is not None]
    symbol = kind.symbol or front.inputs[parameter.name].symbol
    return Free(label, parameter.name, symbol, unit, kind.log, *numbers, parameter.nuisance)


def _uncertain(m: Measurements, front: Front, chosen: Sequence[Parameter]) -> Iterator[tuple[Parameter, str, np.ndarray]]:
    """A parameter with a prior per true value of an input that rows share: same specimen, same stated value and error."""
    of_blocks = ("push_height", "friction") if front.body == "block" else ()
    for name in ("height", "poisson", "correlation_length", "young", *of_blocks):
        sigma = getattr(m, f"{name}_sigma")
        if sigma is None or not np.nan_to_num(sigma).any():
            continue
        if any(one.name == name for one in chosen):
            raise ValueError(
                f"{name} is to be fitted, and the measurements state its error: give it a prior there, or leave it out here"
            )
        in_m = m.correlation_length if name in HEIGHTS and m.correlation_length is not None else 1.0
        keys = list(zip(m.specimen or ("",) * len(m), getattr(m, name) * in_m, sigma * in_m, strict=True))
        for key in dict.fromkeys(keys):
            specimen, value, error = key
            if error > 0:
                label = f"{name}[{specimen + ', ' if specimen else ''}{value:.6g}]"
                prior = float(value), float(error)
                yield Parameter(name, prior=prior, nuisance=True), label, np.array([one == key for one in keys])


def _arrests(m: Measurements) -> Iterator[tuple[Parameter, str, np.ndarray]]:
    """A parameter per precursor whose gauges were read and whose contacts were not counted."""
    for i in () if m.gauges is None else dict.fromkeys(m.gauges.row):
        if m.kind[i] != "whole":
            label = f"arrest[{m.label[i] if m.label else i}]"
            yield Parameter("arrest", prior=ARREST, nuisance=True), label, np.arange(len(m)) == i


def _default_bounds(
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
        # for blocks, the range in which all have a precursor and b is not too large for any
        all_of = front.body == "block" and lowest.max() < highest.min()
        return (float(lowest.max()), float(highest.min())) if all_of else (float(lowest.min()), float(highest.max()))
    size = 1.0 if m.correlation_length is None else float(m.correlation_length[rows].max())
    own = {"offset": (-longest * size, longest * size), "threshold_slope": (-0.5 / longest, 2 / longest)}.get(name)
    if bounds := PARAMETERS[name].bounds or own:
        return bounds
    if name == "push_height" and m.push_height is not None:
        ratio = m.push_height[rows] / m.height[rows]
        return float(np.exp(reference)) * min(0.5, 0.02 / ratio.min()), float(np.exp(reference)) * min(2.0, 0.98 / ratio.max())
    factor = PARAMETERS[name].factor or 10.0
    lowest = 1.01 / m.height[rows].min()
    low = max(1 / factor, lowest) if name == "height" else 1 / factor
    high = min(factor, 1 / lowest) if name == "correlation_length" else factor
    return float(np.exp(reference)) * low, float(np.exp(reference)) * high


def _check_reached(m: Measurements, q: ParameterSet) -> None:
    """Refuse bounds, a prior or a value of the stiffness at which no domino starts: probably in another unit.

    That is, where no measurement is of more than the contact at the edge, whatever the other parameters searched.
    """
    name, is_block = stiffness_name(m), q.front.body == "block"
    one = next(one for one in q.wanted if one.name in ("stiffness", name))
    key = next((key for key in ("bounds", "prior", "value") if getattr(one, key) is not None), None)
    if key is None or m.length.min() <= 1:
        return
    reach = {each: _reach(q, q.inputs.get(each)) for each in q.inputs.names}
    easiest = {each: ends[each not in ("threshold_slope", "friction", "log_machine")] for each, ends in reach.items()}
    low, high = reach["log_stiffness"]
    softest = np.log(front_for("slider", "domino").softest(m))
    some = np.flatnonzero(high > softest)
    from_, to = np.maximum(low, softest)[some], high[some]
    rows = Inputs.from_table([*easiest], np.stack([*easiest.values()], axis=-1)).take(some)
    front = front_for("slider", "domino") if isinstance(q.front, WholeEvent) else q.front  # whose events start with it
    for share in (0.5, 1.0, 0.0, *np.linspace(0, 1, 65)) if len(some) else ():
        at = rows._replace(log_stiffness=from_ + share * (to - from_))
        if (front.lengths(at) > 1).any():
            return
    lowest, highest = _default_bounds(m, q.front, Parameter(name), np.ones(len(m), dtype=bool), 0.0)
    lowest *= 1 if is_block else 100  # the default range of sliders begins where none starts
    in_si, numbers = m.correlation_length is not None, np.atleast_1d(getattr(one, key))
    unit, ratio = PARAMETERS[name].unit[in_si], numbers[0] / ratio_per_unit(m).max()
    shown = ", ".join(f"{x:g}" for x in numbers)
    raise ValueError(
        f"{key} = {f'({shown})' if key != 'value' else shown} of {name}{f', in {unit}' * in_si}: no domino starts at k/K "
        f"{_span(np.exp(low.min()), np.exp(high.max()))}; expected within {lowest:.2g} to {highest:.2g} {unit}".rstrip()
        + f" (k/K = {numbers[0]:g} is {ratio:.2g} {unit})" * bool(in_si and numbers[0] <= STIFFEST)
    )


def ratio_per_unit(m: Measurements) -> np.ndarray:
    """k/K of each measurement per unit of its stiffness; with E = 1 where the table has none."""
    if m.correlation_length is None:
        return np.ones(len(m))
    return m.correlation_length if m.young is None else m.correlation_length / m.young


def _check_domain(m: Measurements, parameters: ParameterSet) -> None:
    """Check that no limit leads outside the domain of the model."""
    every = {**COMMON, **parameters.front.inputs}
    for name in parameters.inputs.names:
        linear = parameters.inputs.get(name)
        least, most = _reach(parameters, linear)
        reach = [float(least.min()), float(most.max())]
        symbol, low, high, requirement = every[name][:4]
        if reach[0] < low - 1e-9 or reach[1] > high + 1e-9:
            acting = [one for one in parameters.wanted if name in PARAMETERS[one.name].acts]
            if mistaken := "; ".join(mistaken_priors(m, acting)):
                raise ValueError(mistaken)
            shown = [np.exp(x) if name.startswith("log") else x for x in reach]
            moving = " and ".join(one.label for one, by in zip(parameters.free, linear.slope.any(axis=0), strict=True) if by)
            held = " and ".join(f"{one} = {x:g}" for one, x in parameters.held.items() if name in PARAMETERS[one].acts)
            searched = f"the range searched for {moving}" + f" with {held}" * bool(held) if moving else held
            raise ValueError(
                f"{searched} means {symbol} {_span(*shown)} for some measurement: {requirement}; give "
                + ("other bounds or another prior" if moving else "another value")
            )


def _span(low: float, high: float) -> str:
    """Write a range, or the one number in it: ``from 0.1 to 0.7``, ``= 3``."""
    return f"from {low:.4g} to {high:.4g}" if low < high else f"= {low:.4g}"


def _reach(q: ParameterSet, linear: Linear) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest number that each measurement gets from any θ searched."""
    down, up = np.minimum(linear.slope, 0), np.maximum(linear.slope, 0)
    return linear.base + up @ q.low + down @ q.high, linear.base + up @ q.high + down @ q.low


def stiffness_name(m: Measurements) -> str:
    """Name of the stiffness that these measurements determine."""
    if m.correlation_length is None:
        return "stiffness"
    return "areal_stiffness_over_young" if m.young is None else "areal_stiffness"


def _validated(m: Measurements, wanted: Sequence[Parameter]) -> list[Parameter]:
    """Validate the requested parameters against the measurements; the stiffness takes the name it has for them."""
    stiffness = stiffness_name(m)
    # k/K in SI is the areal stiffness for a fixed λc/E
    chosen = [replace(one, name=stiffness) if one.name == "stiffness" else one for one in wanted]
    names = [one.name for one in chosen]
    for one in chosen:
        if names.count(one.name) > 1:
            raise ValueError(f"parameter {one.name} is given {names.count(one.name)} times")
        _check_meaning(m, one, stiffness)
    if stiffness not in names:
        option = m.option(f"--free stiffness, or --fix {stiffness}=VALUE", f"fixed={{{stiffness!r}: …}}, or free with it")
        raise ValueError(f"{stiffness} is neither fitted nor held: name it: {option}")
    if "strength" not in names and (carrier := _carries_strength(m)):
        asked = ["stiffness" if one.name == stiffness else one.name for one in chosen if one.value is None and not one.nuisance]
        both = dict.fromkeys([*asked, "strength"])
        option = m.option(" ".join(f"--free {name}" for name in both), f"free={[*both]}".replace("'", '"'))
        raise ValueError(f"{carrier} scales with σ_s: fit strength too, or hold it at its value in Pa: {option}")
    if not any(one.value is None for one in chosen):
        raise ValueError("nothing is fitted: every parameter is held")
    return chosen


def mistaken_priors(m: Measurements, wanted: Iterable[Parameter]) -> Iterator[str]:
    """Name the parameters whose priors, values or bounds are far from what the table states: they are taken in SI."""
    for one in wanted:
        key = next((key for key in ("prior", "value", "bounds") if getattr(one, key) is not None), None)
        stated = getattr(m, one.name, None)
        if key is None or stated is None or one.name not in (*HEIGHTS, "young", "correlation_length"):
            continue
        if one.name in HEIGHTS and m.correlation_length is not None:
            stated = stated * m.correlation_length
        stated = stated[np.isfinite(stated)]
        if one.name in HEIGHTS and one.each is None:  # shown as that of the first
            stated = stated[:1]
        low, high = getattr(one, key) if key == "bounds" else np.repeat(getattr(one, key), 2)[:2]
        if max(low / stated.max(), stated.min() / high) > FAR:
            unit, column = PARAMETERS[one.name].unit[m.in_si], m.columns.get(one.name, one.name)
            sizes = (UNITS_OF_MODULUS if one.name == "young" else UNITS_OF_LENGTH) if m.in_si else {}
            off = {other: abs(np.log(low * size / stated[0])) for other, size in sizes.items()}
            nearest = min(off, key=off.__getitem__, default="")
            guess = f"; is it in {nearest}?" * bool(nearest and off[nearest] < np.log(FAR))
            number = f"{low:g} to {high:g}" if key == "bounds" else f"{low:g}"
            yield (
                f"{one.name} = {number} {unit}, where {column} says {stated[0]:.4g} {unit}: priors, bounds and held values are "
                f"in {unit}{guess}"
            )


def _check_meaning(m: Measurements, one: Parameter, stiffness: str) -> None:
    """Check that a parameter has a meaning for these measurements."""
    if one.name == "push_height" and m.push_height is None:
        raise ValueError("parameter push_height: the measurements state no push_height to start from")
    if one.name == "arrest":
        raise ValueError("parameter arrest: it is fitted wherever gauges were read; do not name it")
    if one.name in STIFFNESSES and one.name != stiffness:
        raise ValueError(f"parameter {one.name}: these measurements determine {stiffness}")
    if one.name in NEEDS_SI and m.correlation_length is None:
        raise ValueError(f"parameter {one.name}: needs measurements in SI, with their correlation length")
    if one.name == "young" and m.young is None:
        raise ValueError("parameter young: the measurements state no young_GPa to start from")
    if one.each == "specimen" and not m.specimen:
        raise ValueError(f"parameter {one.name}: each = 'specimen', but the measurements name no specimens")
    if one.name == "model_factor" and one.prior is None and one.value is None:
        raise ValueError(
            "parameter model_factor: needs a prior, as (1, 0.05): the lengths alone cannot separate it from stiffness"
        )


def _carries_strength(m: Measurements) -> str:
    """Name the columns of a measured quantity that scales with σ_s, and their file; empty if there is none."""
    names = [name for name in ("displacement", "force") if getattr(m, name) is not None and np.isfinite(m.or_zero(name)).any()]
    if names:
        return f"{m.source}, column {' and '.join(m.columns.get(name, name) for name in names)}: what it states"
    return f"{m.gauges.source}: what gauges read" if m.gauges is not None else ""


def attainable(parameters: ParameterSet, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Longest length of each measurement at any stiffness searched, in λc, and the k/K where; shapes (n,).

    The other parameters stay as in `theta`.
    """
    longest, where = attainable_of(parameters, theta, parameters.inputs)
    return longest * np.exp(parameters.scales["length"](theta)) + parameters.scales["offset"](theta), where


def attainable_of(parameters: ParameterSet, theta: np.ndarray, inputs: Inputs) -> tuple[np.ndarray, np.ndarray]:
    """Longest length for other inputs, a `Linear` each, at any stiffness searched; in true λc, without offset."""
    at = inputs.at(theta)
    low, high = np.array(at.log_stiffness), np.array(at.log_stiffness)
    for i, one in enumerate(parameters.free):
        if one.name in STIFFNESSES:
            on = inputs.log_stiffness.slope[:, i] != 0
            low[on], high[on] = (at.log_stiffness[on] + end - theta[i] for end in (one.low, one.high))
    distinct, own = distinct_rows(np.column_stack([at.table(), low, high]))
    given = Inputs.from_table(at.names, distinct[:, :-2])
    longest, where = parameters.front.longest(given, distinct[:, -2], distinct[:, -1])
    return longest[own], np.exp(where[own])


def wanted_parameters(free: Any, bounds: tuple[float, float] | None, fixed: Mapping[str, float] | None) -> list[Parameter]:
    """Collect the parameters, fitted or held, that the arguments of `fit` name."""
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
