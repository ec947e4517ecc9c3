"""What is fitted, what is held, and how both become the inputs of the model for every measurement.

The model has five inputs a measurement, y = (ln H/λc, ln k/K, ν, φ, ε). Positive parameters are fitted as their logarithm
θ = ln(value), the others as they are. Every parameter then enters y, and the logarithms of the scales that turn model
units into measured ones, **linearly**: y = base + slope·θ. Heights, moduli and correlation lengths with errors of their own
are parameters with a prior, like any other.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

STIFFEST = 1.0
"""Largest k/K looked at: a contact stiffer than the block of bulk it is attached to is outside the model."""
INPUTS = ("log_height", "log_stiffness", "poisson", "prestress", "threshold_slope")
WIDTH = len(INPUTS)
"""Which input the width of a smooth break rule is, where there is one."""
SCALES = ("length", "displacement", "force", "slip", "stress", "position")
PRIOR_REACH = 6.0  # standard deviations of a prior that are searched where no bounds are given


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
        Mean and standard deviation of an independent, Gaussian knowledge of it; of its logarithm, with the relative
        deviation, where the parameter is positive.
    each : {"specimen"}, optional
        A value of its own for every specimen, instead of one that all share.
    value : float, optional
        Held at this value, not fitted.
    """

    name: str
    bounds: tuple[float, float] | None = None
    prior: tuple[float, float] | None = None
    each: str | None = None
    value: float | None = None

    def __post_init__(self) -> None:
        if self.name not in PARAMETERS:
            raise ValueError(f"parameter {self.name!r}: one of {', '.join(PARAMETERS)}")
        if self.each not in (None, "specimen"):
            raise ValueError(f"parameter {self.name}: each = {self.each!r}: 'specimen' or nothing")
        positive = PARAMETERS[self.name].log
        if self.bounds is not None:
            low, high = self.bounds
            if not (np.isfinite(low) and np.isfinite(high) and low < high and (low > 0 or not positive)):
                must = "positive, finite and in increasing order" if positive else "finite and in increasing order"
                raise ValueError(f"bounds = ({low:g}, {high:g}) of {self.name}: must be {must}")
        if self.prior is not None:
            mean, sigma = self.prior
            if not (np.isfinite(mean) and np.isfinite(sigma) and sigma > 0 and (mean > 0 or not positive)):
                raise ValueError(f"prior = ({mean:g}, {sigma:g}) of {self.name}: a mean{' > 0' * positive} and a deviation > 0")
        if self.value is not None and not (np.isfinite(self.value) and (self.value > 0 or not positive)):
            raise ValueError(f"value = {self.value:g} of {self.name}: must be {'positive and ' * positive}finite")


class Free(NamedTuple):
    """One number that is fitted, θ; limits and prior in θ."""

    label: str  # its name, with the specimen where it has one each
    name: str
    symbol: str
    unit: str
    log: bool
    low: float
    high: float
    prior_mean: float
    prior_sigma: float  # inf without a prior
    nuisance: bool  # an input with an error of its own, not asked for

    def value(self, theta: np.ndarray | float) -> np.ndarray | float:
        """The parameter in its unit."""
        return np.exp(theta) if self.log else theta

    def theta(self, value: float) -> float:
        """θ of a value."""
        return float(np.log(value)) if self.log else float(value)


@dataclasses.dataclass(frozen=True, eq=False)
class ParameterSet:
    """The map from θ, shape (p,), to the inputs of the model for every measurement."""

    free: tuple[Free, ...]
    held: dict[str, float]  # by name, in their units
    base: np.ndarray  # (n, 5); with the width of a smooth rule (n, 6), y going on with its logarithm
    slope: np.ndarray  # (n, 5 or 6, p)
    scale_base: dict[str, np.ndarray]  # ln(unit of measurement per unit of the model), (n,) for each of SCALES
    scale_slope: dict[str, np.ndarray]  # (n, p)
    offset: np.ndarray  # (n, p), added to a length in λc
    arrest: np.ndarray  # (n, p), added to ℓ* for the contacts broken when gauges were read
    discrepancy: int | None  # which θ is the logarithm of the model's own relative error

    @property
    def names(self) -> list[str]:
        """Label of every θ."""
        return [one.label for one in self.free]

    def index(self, name: str) -> int:
        """Which θ is called `name`.

        Raises
        ------
        ValueError
            If none is, naming those there are.
        """
        if name not in self.names:
            raise ValueError(f"{name!r} is not fitted here: one of {', '.join(self.names)}")
        return self.names.index(name)

    @property
    def low(self) -> np.ndarray:
        """Lower limits of θ."""
        return np.array([one.low for one in self.free])

    @property
    def high(self) -> np.ndarray:
        """Upper limits of θ."""
        return np.array([one.high for one in self.free])

    def ratio(self, theta: np.ndarray) -> np.ndarray:
        """k/K of each measurement, shape (n,)."""
        return np.exp(self.base[:, 1] + self.slope[:, 1] @ theta)

    def inputs(self, theta: np.ndarray) -> np.ndarray:
        """Y of each measurement, shape (n, 5 or 6)."""
        return self.base + self.slope @ theta


class _Kind(NamedTuple):
    symbol: str
    unit: tuple[str, str]  # for lengths in λc, and in SI
    log: bool
    input: int | None  # which of INPUTS it adds to
    sign: float
    scales: dict[str, float]  # which SCALES its logarithm adds to
    stated: str | None  # column of Measurements that gives its value where it is not fitted


PARAMETERS: dict[str, _Kind] = {
    "stiffness": _Kind("k/K", ("", ""), True, 1, 1, {}, None),
    "areal_stiffness": _Kind("k/λc²", ("Pa/m", "Pa/m"), True, 1, 1, {"displacement": -1, "slip": -1}, None),
    "areal_stiffness_over_young": _Kind("(k/λc²)/E", ("1/m", "1/m"), True, 1, 1, {}, None),
    "height": _Kind("H", ("λc", "m"), True, 0, 1, {}, "height"),
    "correlation_length": _Kind("λc", ("", "m"), True, None, 1, {"length": 1, "force": 1, "position": 1}, "correlation_length"),
    "young": _Kind("E", ("", "Pa"), True, 1, -1, {}, "young"),
    "poisson": _Kind("ν", ("", ""), False, 2, 1, {}, "poisson"),
    "prestress": _Kind("φ", ("σ_s", "σ_s"), False, 3, 1, {}, "prestress"),
    "threshold_slope": _Kind("ε", ("1/λc", "1/λc"), False, 4, 1, {}, "threshold_slope"),
    "strength": _Kind("σ_s", ("", "Pa"), True, None, 1, {"displacement": 1, "force": 1, "slip": 1, "stress": 1}, None),
    "offset": _Kind("offset", ("λc", "m"), False, None, 1, {}, None),
    "model_factor": _Kind("model factor", ("", ""), True, None, 1, {"length": 1}, None),
    "width": _Kind("w", ("σ_s", "σ_s"), True, WIDTH, 1, {}, None),
    "arrest": _Kind("contacts beyond ℓ", ("λc", "λc"), False, None, 1, {}, None),
    "discrepancy": _Kind("discrepancy", ("", ""), True, None, 1, {}, None),
}
"""Every parameter by name; k/K, areal stiffness and its ratio to E are one parameter, named by what the data allow."""
STIFFNESSES = ("stiffness", "areal_stiffness", "areal_stiffness_over_young")
ARREST = (0.5, 12**-0.5)
"""Mean and deviation of what lies between ℓ* and the whole number of contacts that break, ceil(ℓ*): anything from 0 to 1."""
NEEDS_SI = ("correlation_length", "young", "strength")
