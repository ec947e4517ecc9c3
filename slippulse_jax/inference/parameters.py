"""Parameters of a fit, and the linear map from the fitted numbers θ to the named inputs of the model.

Positive parameters are fitted as θ = ln(value), the others as they are. Every input of the model (`Inputs`), and the logarithm
of every scale that turns model units into measured ones, is then **linear** in θ. Heights, moduli and correlation lengths with
errors of their own are parameters with a prior, like any other.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from slippulse_jax.domains import POISSON, PRESTRESS, THRESHOLD_SLOPE
from slippulse_jax.inference.measurements import MeasurementError, Measurements
from slippulse_jax.units import UNITS_OF_LENGTH, UNITS_OF_MODULUS, machine_ratio

MeasuredEvent = Literal["domino", "full", "crack"]
"""What the measured length is that of: the first front, whose contacts heal; the whole event, in which they may break again;
or the front of a crack, behind which they slide."""
Body = Literal["slider", "block"]
"""What carries the contacts: the paper's slider, or a block under two-dimensional elasticity that is pushed at a height."""
STIFFEST = 1.0
"""Largest k/K searched: a contact stiffer than the block of bulk it is attached to is outside the model."""
FULL_TO = 200.0
"""Largest b searched for whole events, unless bounds go farther: their cost grows with it."""
BLOCK_FROM, BLOCK_TO = 3e-3, 40.0
"""Range of b searched for blocks, unless bounds go farther. Below it hardly any push starts a domino; above it lengths on
coarse contacts do not predict those on finer ones."""
SCALES = ("length", "displacement", "force", "slip", "stress", "position")
PRIOR_REACH = 6.0
"""Standard deviations of a prior searched on either side where no bounds are given."""
HELD = 1e-6
"""Deviation of a prior, over the mean, below which it must have been given in another unit."""
FAR = 50.0
"""Factor between a parameter and the value in the table above which a unit is suspected: m and cm are 100 apart."""


class Inputs(NamedTuple):
    """Inputs of the model by name, all of one shape; None where a prediction does not depend on one."""

    log_height: Any  # ln H/λc
    log_stiffness: Any  # ln k/K
    poisson: Any
    prestress: Any  # φ, in σ_s
    threshold_slope: Any  # ε, per contact
    log_width: Any = None  # ln of the width of the smooth break rule, in σ_s
    log_position: Any = None  # ln of a gauge's distance from the pushed edge, in λc
    beyond: Any = None  # contacts broken beyond ℓ*, 0 to 1, when gauges were read
    counted: Any = None  # contacts counted as broken when gauges were read; 0 where they were not
    log_sites: Any = None  # ln L/λc of the block; inf for one without end
    log_machine: Any = None  # ln M/K of the drive; inf where the edge is held
    friction: Any = None  # σ_k behind a crack-like front, in σ_s
    log_push: Any = None  # of a block: ln of the height of the push over H
    log_push_width: Any = None  # ln of its width over H; inf where it covers everything above
    push_force: Any = None  # 1 where its force is held, 0 where its displacement is

    @property
    def of_front(self) -> "Inputs":
        """Inputs on which the front under the hard rule depends."""
        return self._replace(log_width=None, log_position=None, beyond=None, counted=None)

    @property
    def endless(self) -> "Inputs":
        """The inputs of blocks without end, whose edge is held."""
        return self._replace(log_sites=None, log_machine=None)

    @classmethod
    def of(
        cls,
        height: ArrayLike,
        stiffness: ArrayLike,
        poisson: ArrayLike,
        prestress: ArrayLike = 0,
        threshold_slope: ArrayLike = 0,
    ) -> "Inputs":
        """Inputs from H/λc, k/K, ν, φ and ε, which broadcast."""
        numbers = np.log(height), np.log(stiffness), poisson, prestress, threshold_slope
        return cls(*np.broadcast_arrays(*(np.asarray(x, np.float64) for x in numbers)))

    @property
    def log_b(self) -> Any:
        """Logarithm of b, the areal stiffness times H over the shear modulus."""
        return np.log(2 * (1 + self.poisson)) + self.log_stiffness + self.log_height

    @property
    def ratio(self) -> Any:
        """k/K."""
        return np.exp(self.log_stiffness)

    @property
    def common_ratio(self) -> float | None:
        """k/K where it is one number, to rounding."""
        ratio = self.ratio
        return float(ratio[0]) if np.ptp(ratio) <= 1e-12 * ratio[0] else None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs that are not None."""
        return tuple(name for name, value in self._asdict().items() if value is not None)

    def table(self) -> np.ndarray:
        """Stack those inputs as columns, shape (…, len(names))."""
        return np.stack([value for value in self if value is not None], axis=-1)

    @classmethod
    def from_table(cls, names: Sequence[str], table: np.ndarray) -> "Inputs":
        """Inverse of `table`."""
        return cls(**dict(zip(names, np.moveaxis(table, -1, 0), strict=True)))

    def take(self, rows: Any) -> "Inputs":
        """Select some rows of every input."""
        return Inputs(*(None if value is None else value[rows] for value in self))

    def ravel(self) -> "Inputs":
        """Flatten every input."""
        return Inputs(*(None if value is None else np.ravel(value) for value in self))


class Linear(NamedTuple):
    """One number per measurement, linear in θ."""

    base: np.ndarray  # (n,)
    slope: np.ndarray  # (n, p)

    def __call__(self, theta: Any) -> Any:
        """Values at θ of shape (…, p); shape (…, n)."""
        return self.base + theta @ self.slope.T

    def take(self, rows: Any) -> "Linear":
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
            raise ValueError(f"parameter {self.name!r}: one of {', '.join(PARAMETERS)}")
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
    scales: dict[str, Linear]  # ln(unit of measurement per unit of the model), for each of SCALES
    offset: Linear  # added to a length, in λc
    beyond: Linear  # contacts broken beyond ℓ* when gauges were read
    discrepancy: int | None  # which θ is the logarithm of the model's own relative error
    event: MeasuredEvent  # what a length is that of
    wanted: tuple[Parameter, ...]  # of which it was made, with those that measuring adds

    @property
    def body(self) -> Body:
        """What carries the contacts."""
        return "slider" if self.inputs.log_push is None else "block"

    @property
    def names(self) -> list[str]:
        """Label of every θ."""
        return [one.label for one in self.free]

    @property
    def smooth(self) -> bool:
        """Whether the lengths are those under a smooth break rule."""
        return self.inputs.log_width is not None

    def index(self, name: str) -> int:
        """Index of the θ called `name`.

        Raises
        ------
        ValueError
            If there is none, naming those there are.
        """
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
        slopes = np.array([one.slope[:, index] for one in self.inputs if one is not None])
        own = np.flatnonzero(slopes.any(axis=0))
        return own if own.size else np.arange(slopes.shape[1])

    def inputs_at(self, theta: np.ndarray) -> Inputs:
        """Inputs of each measurement, shape (…, n), at θ of shape (…, p)."""
        return at_theta(self.inputs, theta)

    def common_ratio(self, theta: np.ndarray) -> float | None:
        """k/K at θ where a stiffness is fitted and k/K is the same for all measurements."""
        fitted = any("stiffness" in one.label for one in self.free if not one.nuisance)
        return self.inputs_at(theta).common_ratio if fitted else None


def at_theta(inputs: Inputs, theta: Any) -> Inputs:
    """Values of linear inputs at θ."""
    return Inputs(*(None if one is None else one(theta) for one in inputs))


class _Kind(NamedTuple):
    symbol: str
    unit: tuple[str, str]  # for lengths in λc, and in SI
    log: bool
    acts: dict[str, float]  # what a unit of θ adds to each of Inputs, SCALES and "offset"
    stated: str | None = None  # column of Measurements that gives its value where it is not fitted


PARAMETERS: dict[str, _Kind] = {
    "stiffness": _Kind("k/K", ("", ""), True, {"log_stiffness": 1}),
    "areal_stiffness": _Kind("k/λc²", ("Pa/m", "Pa/m"), True, {"log_stiffness": 1, "displacement": -1, "slip": -1}),
    "areal_stiffness_over_young": _Kind("(k/λc²)/E", ("1/m", "1/m"), True, {"log_stiffness": 1}),
    "height": _Kind("H", ("λc", "m"), True, {"log_height": 1, "log_push": -1, "log_push_width": -1}, "height"),
    "correlation_length": _Kind(
        "λc", ("", "m"), True,
        # H/λc falls; k/K = (k/λc²) λc/E rises
        {"log_height": -1, "log_stiffness": 1, "length": 1, "force": 1, "position": 1, "log_sites": -1},
        "correlation_length",
    ),
    "push_height": _Kind("h", ("λc", "m"), True, {"log_push": 1}, "push_height"),
    "young": _Kind("E", ("", "Pa"), True, {"log_stiffness": -1, "log_machine": -1}, "young"),
    "poisson": _Kind("ν", ("", ""), False, {"poisson": 1}, "poisson"),
    "prestress": _Kind("φ", ("σ_s", "σ_s"), False, {"prestress": 1}, "prestress"),
    "threshold_slope": _Kind("ε", ("1/λc", "1/λc"), False, {"threshold_slope": 1}, "threshold_slope"),
    "friction": _Kind("σ_k", ("σ_s", "σ_s"), False, {"friction": 1}),
    "strength": _Kind("σ_s", ("", "Pa"), True, {"displacement": 1, "force": 1, "slip": 1, "stress": 1}),
    "offset": _Kind("offset", ("λc", "m"), False, {"offset": 1}),
    "model_factor": _Kind("model factor", ("", ""), True, {"length": 1}),
    "width": _Kind("w", ("σ_s", "σ_s"), True, {"log_width": 1}),
    "arrest": _Kind("contacts beyond ℓ", ("λc", "λc"), False, {"beyond": 1}),
    "discrepancy": _Kind("discrepancy", ("", ""), True, {}),
}  # fmt: skip
"""Every parameter by name; k/K, areal stiffness and its ratio to E are one parameter, named by what the data determine."""
STIFFNESSES = ("stiffness", "areal_stiffness", "areal_stiffness_over_young")
ARREST = (0.5, 12**-0.5)
"""Mean and deviation of the difference between ℓ* and the number of contacts that break, ceil(ℓ*): uniform from 0 to 1."""
HEIGHTS = ("height", "push_height")
"""Lengths held in λc and shown in metres where λc is known; fitted as one factor on all of their rows."""
NEEDS_SI = ("correlation_length", "young", "strength")
NOT_OF_BLOCKS = ("displacement", "force", "gauges", "block_length", "machine_stiffness")
"""What measurements may state beside lengths, and a fit of a block cannot take."""
OF_MEASURING = ("offset", "model_factor")
"""What is fitted beside for lengths of provenance "measured", and acts on these."""
MODEL_ERROR = 0.1
"""Default relative error of the model's length for measured blocks: about the difference to a block under two-dimensional
elasticity that is pushed over all but the lowest quarter of its side. Other pushers: docs/model/limits.md."""


def parameter_set(
    m: Measurements, wanted: Iterable[str | Parameter], event: MeasuredEvent = "domino", body: Body = "slider"
) -> ParameterSet:
    """Map the parameters of a fit to the inputs of the model for these measurements.

    Parameters
    ----------
    m : Measurements
    wanted : sequence of str or Parameter
        Parameters fitted or held; everything else is as stated with the measurements. "stiffness" stands for whichever
        stiffness the measurements determine.
    event : {"domino", "full", "crack"}
        What a length is that of, as in `precursor_lengths`.
    body : {"slider", "block"}
        What carries the contacts; a block needs event "full".

    Raises
    ------
    ValueError
        If a parameter is given twice, has no meaning for these measurements, is needed and missing, or its limits leave the
        domain of the model.
    """
    wanted = tuple(Parameter(one) if isinstance(one, str) else one for one in wanted)
    chosen = _validated(m, wanted)
    _check_friction({one.name for one in chosen}, event)
    if body == "block":
        _check_block(m, {one.name for one in chosen}, event)
    builder = _Builder(m, smooth=any(one.name == "width" for one in chosen), event=event, body=body)
    for parameter in chosen:
        if parameter.value is not None:
            builder.hold(parameter)
        else:
            for label, rows in _groups(m, parameter):
                builder.add(parameter, label, rows)
    fitted = {parameter.name for parameter in chosen}
    for name in ("height", "poisson", "correlation_length", "young", *(["push_height"] if body == "block" else [])):
        sigma = getattr(m, f"{name}_sigma")
        if sigma is None or not np.nan_to_num(sigma).any():
            continue
        if name in fitted:
            raise ValueError(
                f"{name} is to be fitted, and the measurements state its error: give it a prior there, or leave it out here"
            )
        builder.add_uncertain(name, sigma)
    builder.add_arrests()
    return builder.build(wanted)


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


def _groups(m: Measurements, parameter: Parameter) -> list[tuple[str, np.ndarray]]:
    """Label and rows of each value that the parameter takes."""
    name = parameter.name
    specimens = list(dict.fromkeys(m.specimen)) if parameter.each else []
    groups = [(f"{name}[{one}]", np.array([s == one for s in m.specimen])) for one in specimens]
    measured = np.array([one == "measured" for one in m.provenance], dtype=bool)
    shared = parameter.nuisance and name in OF_MEASURING and measured.any()
    groups = groups or [(name, measured if shared else np.ones(len(m), dtype=bool))]
    stated = PARAMETERS[name].stated
    if stated and name not in HEIGHTS and getattr(m, stated) is not None:
        for label, rows in groups:
            if np.ptp(getattr(m, stated)[rows]) > 0:
                raise ValueError(f"parameter {label}: the measurements state more than one value of it; one must be shared")
    return groups


class _Builder:
    """Collects base and slope of every linear map."""

    def __init__(self, m: Measurements, smooth: bool, event: MeasuredEvent, body: Body) -> None:
        self.m, self.smooth = m, smooth
        self.body: Body = body
        self.event: MeasuredEvent = event
        if event == "full" and smooth:
            raise ValueError("parameter width: the smooth rule follows one front; leave it out, or event = 'full'")
        of_front = m.gauges is not None or m.block_length is not None or m.machine_stiffness is not None
        if event == "full" and of_front:
            raise ValueError("event = 'full': gauges, block_length and machine_stiffness need the model of one front")
        if event == "crack" and (smooth or m.block_length is not None or m.machine_stiffness is not None):
            raise ValueError("event = 'crack': for the hard rule and a block without end, whose edge is held")
        if event == "crack" and m.or_zero("threshold_slope").any():
            raise ValueError(f"{m.source}: event = 'crack' takes level thresholds, without threshold_slope")
        n = len(m)
        self.stated = {
            "height": m.height,
            "correlation_length": m.correlation_length,
            "young": m.young,
            "poisson": m.poisson,
            "prestress": m.or_zero("prestress"),
            "threshold_slope": m.or_zero("threshold_slope"),
            "push_height": m.push_height,
        }
        log_lc = np.zeros(n) if m.correlation_length is None else np.log(m.correlation_length)
        log_young = np.zeros(n) if m.young is None else np.log(m.young)
        push = pushed(m.height, m.push_height, m.push_width, m.push_control) if body == "block" else {}
        self.inputs = (*Inputs._fields[: 5 + smooth], *_ends(m), *(["friction"] if event == "crack" else []), *push)
        self.base = {name: np.zeros(n) for name in (*self.inputs, *SCALES, "offset", "beyond")} | {
            "log_height": np.log(m.height),
            "log_stiffness": log_lc - log_young,
            **{name: np.array(self.stated[name]) for name in ("poisson", "prestress", "threshold_slope")},
            "force": log_lc.copy(),
            **_ends(m),
            **push,
        }
        self.free: list[Free] = []
        self.slopes: list[dict[str, np.ndarray]] = []
        self.held: dict[str, float] = {}

    def _acts(self, name: str, rows: np.ndarray) -> dict[str, np.ndarray]:
        """What a unit of θ adds to each map, for every measurement."""
        acts = {target: size * rows for target, size in PARAMETERS[name].acts.items() if target in self.base}
        if name == "offset" and self.m.correlation_length is not None:
            acts["offset"] = rows / self.m.correlation_length
        return acts

    def _reference(self, name: str) -> np.ndarray:
        """θ at which the parameter adds nothing to any row: the value stated with the measurements."""
        column = self.stated.get(PARAMETERS[name].stated or "")
        if column is None:
            return np.zeros(len(self.m))
        if name in HEIGHTS and self.m.correlation_length is not None:
            column = column * self.m.correlation_length
        return np.log(column) if PARAMETERS[name].log else column

    def _shift(self, name: str, rows: np.ndarray, theta: float | np.ndarray) -> None:
        for target, size in self._acts(name, rows).items():
            self.base[target] = self.base[target] + size * theta

    def hold(self, parameter: Parameter) -> None:
        """Hold a parameter at its value."""
        name = parameter.name
        if name == "discrepancy":
            raise ValueError(f"parameter {name}: it is fitted or absent, not held; add it to the stated errors instead")
        assert parameter.value is not None
        theta = np.log(parameter.value) if PARAMETERS[name].log else parameter.value
        rows = np.ones(len(self.m), dtype=bool)
        self._shift(name, rows, theta - self._reference(name))
        self.held[name] = parameter.value

    def add(self, parameter: Parameter, label: str, rows: np.ndarray) -> None:
        """Add a parameter to θ."""
        name = parameter.name
        kind = PARAMETERS[name]
        reference = self._reference(name)[rows]
        # a height is fitted as one factor on all of its rows, and shown as the height of the first
        self._shift(name, rows, np.where(rows, -reference[0], 0.0) if name in HEIGHTS else -self._reference(name))
        low, high = parameter.bounds or _default_bounds(self, parameter, rows, float(reference[0]))
        prior_mean, prior_sigma = parameter.prior or (1.0, np.inf)
        if kind.log:
            low, high = np.log(low), np.log(high)
            prior_mean, prior_sigma = np.log(prior_mean), prior_sigma / prior_mean
        unit = kind.unit[self.m.correlation_length is not None]
        limits = float(low), float(high)
        self.free.append(Free(label, name, kind.symbol, unit, kind.log, *limits, prior_mean, prior_sigma, parameter.nuisance))
        self.slopes.append(self._acts(name, rows))

    def add_uncertain(self, name: str, sigma: np.ndarray) -> None:
        """Add a θ with a prior per true value that rows share: same specimen, same stated value and error."""
        stated = self.stated[name]
        if stated is None:
            raise MeasurementError(f"{self.m.source}: {name}_sigma is given without {name}")
        specimen = self.m.specimen or ("",) * len(self.m)
        in_m = self.m.correlation_length if name in HEIGHTS and self.m.correlation_length is not None else 1.0
        keys = list(zip(specimen, stated * in_m, sigma * in_m, strict=True))
        for key in dict.fromkeys(keys):
            _, value, error = key
            if error > 0:
                rows = np.array([one == key for one in keys])
                prior = float(value), float(error)
                self.add(Parameter(name, prior=prior, nuisance=True), _input_label(name, key), rows)

    def add_arrests(self) -> None:
        """Add a θ per precursor whose gauges were read and whose contacts were not counted."""
        if self.m.gauges is None:
            return
        for i in dict.fromkeys(self.m.gauges.row):
            if self.m.kind[i] != "whole":
                rows = np.arange(len(self.m)) == i
                label = f"arrest[{self.m.label[i] if self.m.label else i}]"
                self.add(Parameter("arrest", prior=ARREST, nuisance=True), label, rows)

    def build(self, wanted: tuple[Parameter, ...]) -> ParameterSet:
        """Finish the map; check its limits against the domain of the model."""
        n, names = len(self.m), [one.name for one in self.free]

        def linear(target: str) -> Linear:
            slopes = [slope.get(target, np.zeros(n)) for slope in self.slopes]
            return Linear(self.base[target], np.stack(slopes, axis=-1).astype(float))

        result = ParameterSet(
            free=tuple(self.free),
            held=self.held,
            inputs=Inputs(**{name: linear(name) for name in self.inputs}),
            scales={scale: linear(scale) for scale in SCALES},
            offset=linear("offset"),
            beyond=linear("beyond"),
            discrepancy=names.index("discrepancy") if "discrepancy" in names else None,
            event=self.event,
            wanted=wanted,
        )
        _check_domain(self.m, result)
        _check_reached(self, result)
        return result


def event_and_body(m: Measurements, event: MeasuredEvent | None, body: Body | None) -> tuple[MeasuredEvent, Body]:
    """Choose the event and the body that are not given.

    A block and its whole event where every measurement states how its side is pushed, unless the event is one of sliders only;
    else a slider and its first front.
    """
    if body is None:
        said = m.push_height is not None and not np.isnan(m.push_height).any()
        body = "block" if said and event in (None, "full") else "slider"
    if event is None:
        event = "full" if body == "block" else "domino"
    return event, body


def pushed(
    height: np.ndarray, at: np.ndarray | None, width: np.ndarray | None, control: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """Inputs that describe the push on the side of a block, each of shape (n,)."""
    assert at is not None
    none = np.full(len(height), np.nan)
    share = (none if width is None else width) / height
    force = [one == "force" for one in control] or [False] * len(height)
    return {
        "log_push": np.log(at / height),
        "log_push_width": np.log(np.where(np.isnan(share), np.inf, share)),
        "push_force": np.array(force, dtype=float),
    }


def pushed_at(
    inputs: Inputs, height: np.ndarray, at: np.ndarray | None, width: np.ndarray | None, control: Sequence[str] = ()
) -> Inputs:
    """Add the push on blocks to inputs, whose last axis is that of the pushes."""
    push = pushed(height, at, width, control)
    return inputs._replace(**{name: np.broadcast_to(x, inputs.poisson.shape) for name, x in push.items()})


def _ends(m: Measurements) -> dict[str, np.ndarray]:
    """Logarithms of L/λc and M/K where stated; inf in rows without one."""
    found = {}
    if m.block_length is not None:
        found["log_sites"] = np.log(m.block_length)
    if m.machine_stiffness is not None:
        found["log_machine"] = np.log(machine_ratio(m.machine_stiffness, 1.0 if m.young is None else m.young))
    return {name: np.where(np.isnan(x), np.inf, x) for name, x in found.items() if not np.isnan(x).all()}


def _input_label(name: str, key: tuple[str, float, float]) -> str:
    specimen, value, _ = key
    return f"{name}[{specimen + ', ' if specimen else ''}{value:.6g}]"


def _default_bounds(builder: _Builder, parameter: Parameter, rows: np.ndarray, reference: float) -> tuple[float, float]:
    """Default range of the search, in the unit of the parameter."""
    m = builder.m
    name, longest = parameter.name, float(m.length[rows].max())
    if parameter.prior is not None:
        mean, sigma = parameter.prior
        if PARAMETERS[name].log:
            reach = PRIOR_REACH * sigma / mean
            return mean * np.exp(-reach), mean * np.exp(reach)
        low, high = _LIMITS.get(name, (-np.inf, np.inf))
        return max(low, mean - PRIOR_REACH * sigma), min(high, mean + PRIOR_REACH * sigma)
    if name in STIFFNESSES:
        per_unit = ratio_per_unit(m)[rows]
        # a smooth front on contacts softer than those at which a domino starts does not fade for long
        lowest = softest(m, builder.body)[rows] / per_unit * (100 if builder.smooth else 1)
        highest = stiffest(m, builder.event, builder.body)[rows] / per_unit
        # for blocks, the range in which all have a precursor and b is not too large for any
        all_of = builder.body == "block" and lowest.max() < highest.min()
        return (float(lowest.max()), float(highest.min())) if all_of else (float(lowest.min()), float(highest.max()))
    size = 1.0 if m.correlation_length is None else float(m.correlation_length[rows].max())
    by_name = {
        "offset": (-longest * size, longest * size),
        "threshold_slope": (-0.5 / longest, 2 / longest),
        "discrepancy": (1e-4, 1.0),
        "strength": (1.0, 1e12),
        "width": (1e-4, 0.02),
        "friction": (0.0, 0.95),
        "poisson": (0.0, 0.5),
        "prestress": (-0.95, 0.95),
    }
    if name in by_name:
        return by_name[name]
    if name == "push_height" and m.push_height is not None:
        ratio = m.push_height[rows] / m.height[rows]
        return float(np.exp(reference)) * min(0.5, 0.02 / ratio.min()), float(np.exp(reference)) * min(2.0, 0.98 / ratio.max())
    factor = {"height": 2.0}.get(name, 10.0)
    lowest = 1.01 / m.height[rows].min()
    low = max(1 / factor, lowest) if name == "height" else 1 / factor
    high = min(factor, 1 / lowest) if name == "correlation_length" else factor
    return float(np.exp(reference)) * low, float(np.exp(reference)) * high


def _check_reached(builder: _Builder, q: ParameterSet) -> None:
    """Refuse bounds, a prior or a value of the stiffness at which no domino starts: probably in another unit.

    That is, where no measurement is of more than the contact at the edge, whatever the other parameters searched.
    """
    from slippulse_jax.inference.model import lengths  # which takes `Inputs`

    m, name = builder.m, stiffness_name(builder.m)
    one = next(one for one in q.wanted if one.name in ("stiffness", name))
    key = next((key for key in ("bounds", "prior", "value") if getattr(one, key) is not None), None)
    if key is None or m.length.min() <= 1:
        return
    reach = {each: _reach(q, getattr(q.inputs, each)) for each in q.inputs.names}
    easiest = {each: ends[each not in ("threshold_slope", "friction", "log_machine")] for each, ends in reach.items()}
    low, high = reach["log_stiffness"]
    some = np.flatnonzero(high > np.log(softest(m)))
    from_, to = np.maximum(low, np.log(softest(m)))[some], high[some]
    rows = Inputs(**easiest).of_front.take(some)
    for share in (0.5, 1.0, 0.0, *np.linspace(0, 1, 65)) if len(some) else ():
        at = rows._replace(log_stiffness=from_ + share * (to - from_))
        if (lengths(at, event="full" if q.body == "block" else "domino").value > 1).any():
            return
    lowest, highest = _default_bounds(builder, Parameter(name), np.ones(len(m), dtype=bool), 0.0)
    lowest *= 1 if builder.smooth or q.body == "block" else 100  # the default range of sliders begins where none starts
    in_si, numbers = m.correlation_length is not None, np.atleast_1d(getattr(one, key))
    unit, ratio = PARAMETERS[name].unit[in_si], numbers[0] / ratio_per_unit(m).max()
    shown = ", ".join(f"{x:g}" for x in numbers)
    raise ValueError(
        f"{key} = {f'({shown})' if key != 'value' else shown} of {name}{f', in {unit}' * in_si}: no domino starts at k/K "
        f"{_span(np.exp(low.min()), np.exp(high.max()))}; expected within {lowest:.2g} to {highest:.2g} {unit}".rstrip()
        + f" (k/K = {numbers[0]:g} is {ratio:.2g} {unit})" * bool(in_si and numbers[0] <= STIFFEST)
    )


_LIMITS = {"poisson": (-0.99, 0.5), "prestress": (-0.99, 0.99), "friction": (0.0, 0.99)}


def softest(m: Measurements, body: Body = "slider") -> np.ndarray:
    """k/K of each measurement below which certainly no domino starts (b far below (λc/H)²), so that the length is zero."""
    if body == "block":
        return BLOCK_FROM / (2 * (1 + m.poisson) * m.height)
    return 1e-2 / (2 * (1 + m.poisson) * m.height**3)


def stiffest(m: Measurements, event: MeasuredEvent, body: Body = "slider") -> np.ndarray:
    """Largest k/K of each measurement searched by default."""
    most = np.inf if event != "full" else (BLOCK_TO if body == "block" else FULL_TO) / (2 * (1 + m.poisson) * m.height)
    return np.broadcast_to(np.minimum(STIFFEST, most), m.height.shape)


def ratio_per_unit(m: Measurements) -> np.ndarray:
    """k/K of each measurement per unit of its stiffness; with E = 1 where the table has none."""
    if m.correlation_length is None:
        return np.ones(len(m))
    return m.correlation_length if m.young is None else m.correlation_length / m.young


def _check_domain(m: Measurements, parameters: ParameterSet) -> None:
    """Check that no limit leads outside the domain of the model."""
    limits = {
        "log_height": (0.0, np.inf, "H/λc", "must exceed 1"),
        "log_stiffness": (np.log(1e-30), np.log(1e3), "k/K", "must lie in 1e-30 to 1e3"),
        "poisson": (POISSON.low, POISSON.high, "ν", POISSON.requirement),
        "prestress": (PRESTRESS.low, PRESTRESS.high, "φ", PRESTRESS.requirement),
        "threshold_slope": (THRESHOLD_SLOPE.low, THRESHOLD_SLOPE.high, "ε", THRESHOLD_SLOPE.requirement),
        "log_width": (np.log(1e-6), np.log(0.1), "w", "must lie in 1e-6 to 0.1, beyond which a front hardly fades"),
        "log_sites": (np.log(2.0), np.inf, "L/λc", "must be at least 2"),
        "friction": (0.0, 1.0, "σ_k", "must be 0 or more, and below 1"),
        "log_machine": (np.log(1e-30), np.inf, "M/K", "must be positive"),
        "log_push": (-np.inf, 0.0, "h/H", "the push must lie below the top of the block"),
        "log_push_width": (-np.inf, np.inf, "w/H", ""),
        "push_force": (0.0, 1.0, "", ""),
    }
    for name in parameters.inputs.names:
        linear = getattr(parameters.inputs, name)
        least, most = _reach(parameters, linear)
        reach = [float(least.min()), float(most.max())]
        low, high, symbol, requirement = limits[name]
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
    if "width" in names:
        _check_smooth(m, names)
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


def _check_friction(names: set[str], event: MeasuredEvent) -> None:
    """Check that the friction behind the front is given where there is one, and only there."""
    if event == "crack" and "friction" not in names:
        raise ValueError("event = 'crack': friction is neither fitted nor held; in σ_s, as fixed = {'friction': 0.3}")
    if event == "crack" and "threshold_slope" in names:
        raise ValueError("parameter threshold_slope: a crack-like front has a closed form on level thresholds only")
    if event != "crack" and "friction" in names:
        raise ValueError("parameter friction: contacts slide only behind a crack-like front: event = 'crack'")


def _check_block(m: Measurements, names: set[str], event: MeasuredEvent) -> None:
    """Check that the measurements state the push, and nothing that a fit of a block cannot take."""
    if m.push_height is None:
        raise ValueError(f"{m.source}: a block needs the height of the push: give push_height (push_height_mm in a table)")
    if np.isnan(m.push_height).any():
        blank = m.place(int(np.argmax(np.isnan(m.push_height))))
        raise ValueError(f"{blank}, column push_height: missing: a block needs the height of the push of every measurement")
    if event != "full":
        raise ValueError(
            f"event = {event!r}: contacts of a block break in any order, so its length is that of the whole event: 'full'"
        )
    for name in NOT_OF_BLOCKS:
        if getattr(m, name) is not None:
            own = m.columns.get(name, name)
            why = {
                "block_length": "without an end: leave it out where every front stopped well before the end; one that ran "
                "through has the length of the block and the kind at_least",
                "machine_stiffness": "whose pusher is held: leave it out",
            }.get(name, "from lengths alone: leave it out")
            push = m.columns.get("push_height", "push_height")
            raise ValueError(f"{m.source}: {own} beside {push}: a fit of a block takes one {why} (docs/fit/own_csv.md)")
    if "threshold_slope" in names or m.or_zero("threshold_slope").any():
        raise ValueError(f"{m.source}: threshold_slope: a fit of a block takes level thresholds")


def _check_smooth(m: Measurements, names: Sequence[str]) -> None:
    """Check that the interface is relaxed and uniform and the block endless: fits under a smooth rule take no others."""
    for name in ("prestress", "threshold_slope"):
        if name in names or m.or_zero(name).any():
            raise ValueError(f"parameter width: the smooth rule is for relaxed, uniform interfaces, without {name}")
    if _ends(m):
        raise ValueError("parameter width: the smooth rule is for blocks without end whose edge is held while the front runs")
    if m.gauges is not None:
        raise ValueError("parameter width: readings of gauges are those of the hard rule; leave one of them out")


def _carries_strength(m: Measurements) -> str:
    """Name the columns of a measured quantity that scales with σ_s, and their file; empty if there is none."""
    names = [name for name in ("displacement", "force") if getattr(m, name) is not None and np.isfinite(m.or_zero(name)).any()]
    if names:
        return f"{m.source}, column {' and '.join(m.columns.get(name, name) for name in names)}: what it states"
    return f"{m.gauges.source}: what gauges read" if m.gauges is not None else ""
