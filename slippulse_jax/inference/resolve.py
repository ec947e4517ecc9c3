"""From the parameters asked for to the linear map that takes θ to the inputs of the model for every measurement."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from slippulse_jax.domains import POISSON, PRESTRESS, THRESHOLD_SLOPE
from slippulse_jax.inference.asked import as_asked
from slippulse_jax.inference.measurements import MeasurementError, Measurements
from slippulse_jax.inference.parameters import (
    ARREST,
    INPUTS,
    PARAMETERS,
    PRIOR_REACH,
    SCALES,
    STIFFEST,
    STIFFNESSES,
    Free,
    Parameter,
    ParameterSet,
)


def resolve(m: Measurements, wanted: Iterable[str | Parameter]) -> ParameterSet:
    """Parameters of a fit to these measurements.

    Parameters
    ----------
    m : Measurements
    wanted : sequence of str or Parameter
        What is fitted or held; everything else is as stated with the measurements. "stiffness" stands for the form of it
        that the measurements can give.

    Raises
    ------
    ValueError
        If a parameter is there twice, has no meaning for these measurements, or its limits leave the model's domain.
    """
    chosen = as_asked(m, wanted)
    builder = _Builder(m, smooth=any(one.name == "width" for one in chosen))
    for parameter in chosen:
        if parameter.value is not None:
            builder.hold(parameter)
        else:
            for label, rows in _groups(m, parameter):
                builder.add(parameter, label, rows)
    fitted = {parameter.name for parameter in chosen}
    for name in ("height", "poisson", "correlation_length", "young"):
        sigma = getattr(m, f"{name}_sigma")
        if sigma is None or not sigma.any():
            continue
        if name in fitted:
            raise ValueError(f"{name} is asked for, and the measurements state its error: give it a prior, or leave it out")
        builder.add_uncertain(name, sigma)
    builder.add_arrests()
    return builder.build()


def _groups(m: Measurements, parameter: Parameter) -> list[tuple[str, np.ndarray]]:
    """Label and rows of each value that the parameter takes."""
    name = parameter.name
    specimens = list(dict.fromkeys(m.specimen)) if parameter.each else []
    groups = [(f"{name}[{one}]", np.array([s == one for s in m.specimen])) for one in specimens]
    groups = groups or [(name, np.ones(len(m), dtype=bool))]
    stated = PARAMETERS[name].stated
    if stated and name != "height" and getattr(m, stated) is not None:
        for label, rows in groups:
            if np.ptp(getattr(m, stated)[rows]) > 0:
                raise ValueError(f"parameter {label}: the measurements state more than one value of it; one must be shared")
    return groups


class _Effect(NamedTuple):
    """What a unit of θ adds to y, to the scales, to the length, and to the contacts broken when gauges were read."""

    inputs: np.ndarray
    scales: dict[str, np.ndarray]
    offset: np.ndarray
    arrest: np.ndarray


class _Builder:
    """Collects the columns of base and slope."""

    def __init__(self, m: Measurements, smooth: bool) -> None:
        self.m = m
        n = len(m)
        self.stated = {
            "height": m.height,
            "correlation_length": m.correlation_length,
            "young": m.young,
            "poisson": m.poisson,
            "prestress": m.or_zero("prestress"),
            "threshold_slope": m.or_zero("threshold_slope"),
        }
        log_lc = np.zeros(n) if m.correlation_length is None else np.log(m.correlation_length)
        log_young = np.zeros(n) if m.young is None else np.log(m.young)
        self.log_lc = log_lc
        self.base = np.stack([np.log(m.height), log_lc - log_young, *(self.stated[k] for k in INPUTS[2:])], axis=1)
        self.smooth = smooth
        if smooth:
            self.base = np.column_stack([self.base, np.zeros(n)])
        self.scale_base = {scale: np.zeros(n) for scale in SCALES} | {"force": log_lc.copy()}
        self.free: list[Free] = []
        self.columns: list[_Effect] = []
        self.held: dict[str, float] = {}

    def _effect(self, name: str, rows: np.ndarray) -> _Effect:
        kind, on = PARAMETERS[name], rows.astype(float)
        inputs = np.zeros(self.base.shape)
        if kind.input is not None:
            inputs[:, kind.input] = kind.sign * on
        if name == "correlation_length":
            inputs[:, 0], inputs[:, 1] = -on, on  # H/λc falls; k/K = (k/λc²) λc/E rises
        scales = {scale: kind.scales.get(scale, 0.0) * on for scale in SCALES}
        offset = np.zeros(len(rows))
        if name == "offset":
            offset = on if self.m.correlation_length is None else on / self.m.correlation_length
        return _Effect(inputs, scales, offset, on * (name == "arrest"))

    def _reference(self, name: str) -> np.ndarray:
        """θ at which the parameter adds nothing, for every row: what is stated with the measurements."""
        column = self.stated.get(PARAMETERS[name].stated or "")
        if column is None:
            return np.zeros(len(self.m))
        if name == "height" and self.m.correlation_length is not None:
            column = column * self.m.correlation_length
        return np.log(column) if PARAMETERS[name].log else column

    def _shift(self, name: str, rows: np.ndarray, theta: float | np.ndarray) -> None:
        effect = self._effect(name, rows)
        self.base += effect.inputs * np.broadcast_to(theta, rows.shape)[:, None]
        for scale in SCALES:
            self.scale_base[scale] = self.scale_base[scale] + effect.scales[scale] * theta

    def hold(self, parameter: Parameter) -> None:
        """Put a parameter at its value."""
        name = parameter.name
        if name in ("offset", "discrepancy"):
            raise ValueError(f"parameter {name}: it is fitted or absent, not held; add it to the stated errors instead")
        assert parameter.value is not None
        theta = np.log(parameter.value) if PARAMETERS[name].log else parameter.value
        rows = np.ones(len(self.m), dtype=bool)
        self._shift(name, rows, theta - self._reference(name))
        self.held[name] = parameter.value

    def add(self, parameter: Parameter, label: str, rows: np.ndarray, nuisance: bool = False) -> None:
        """Make a parameter one of the θ."""
        name = parameter.name
        kind = PARAMETERS[name]
        reference = self._reference(name)[rows]
        # a height is fitted as one factor on all of its rows, shown as the height of the first
        self._shift(name, rows, np.where(rows, -reference[0], 0.0) if name == "height" else -self._reference(name))
        low, high = parameter.bounds or _default_bounds(self.m, parameter, rows, float(reference[0]), self.smooth)
        prior_mean, prior_sigma = parameter.prior or (1.0, np.inf)
        if kind.log:
            low, high = np.log(low), np.log(high)
            prior_mean, prior_sigma = np.log(prior_mean), prior_sigma / prior_mean
        unit = kind.unit[self.m.correlation_length is not None]
        one = Free(label, name, kind.symbol, unit, kind.log, float(low), float(high), prior_mean, prior_sigma, nuisance)
        self.free.append(one)
        self.columns.append(self._effect(name, rows))

    def add_uncertain(self, name: str, sigma: np.ndarray) -> None:
        """A θ with a prior for every true value that the rows share: same specimen, same stated value and error."""
        stated = self.stated[name]
        if stated is None:
            raise MeasurementError(f"{self.m.source}: {name}_sigma is given without {name}")
        specimen = self.m.specimen or ("",) * len(self.m)
        in_m = self.m.correlation_length if name == "height" and self.m.correlation_length is not None else 1.0
        keys = list(zip(specimen, stated * in_m, sigma * in_m, strict=True))
        for key in dict.fromkeys(keys):
            _, value, error = key
            if error > 0:
                rows = np.array([one == key for one in keys])
                self.add(Parameter(name, prior=(float(value), float(error))), _input_label(name, key), rows, nuisance=True)

    def add_arrests(self) -> None:
        """A θ for every precursor that gauges were read after and whose contacts were not counted."""
        if self.m.gauges is None:
            return
        for i in dict.fromkeys(self.m.gauges.row):
            if self.m.kind[i] != "whole":
                rows = np.arange(len(self.m)) == i
                self.add(
                    Parameter("arrest", prior=ARREST), f"arrest[{self.m.label[i] if self.m.label else i}]", rows, nuisance=True
                )

    def build(self) -> ParameterSet:
        """The finished map, its limits checked against the domain of the model."""
        slope = _columns([one.inputs for one in self.columns])
        names = [one.name for one in self.free]
        result = ParameterSet(
            free=tuple(self.free),
            held=self.held,
            base=self.base,
            slope=slope,
            scale_base=self.scale_base,
            scale_slope={scale: _columns([one.scales[scale] for one in self.columns]) for scale in SCALES},
            offset=_columns([one.offset for one in self.columns]),
            arrest=_columns([one.arrest for one in self.columns]),
            discrepancy=names.index("discrepancy") if "discrepancy" in names else None,
        )
        _check_domain(result)
        return result


def _columns(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.stack(parts, axis=-1)


def _input_label(name: str, key: tuple[str, float, float]) -> str:
    specimen, value, _ = key
    return f"{name}[{specimen + ', ' if specimen else ''}{value:.6g}]"


def _default_bounds(
    m: Measurements, parameter: Parameter, rows: np.ndarray, reference: float, smooth: bool
) -> tuple[float, float]:
    """Range searched where none is given, in the unit of the parameter."""
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
        lowest = softest(m)[rows] * (100 if smooth else 1)
        return float((lowest / per_unit).min()), float((STIFFEST / per_unit).max())
    size = 1.0 if m.correlation_length is None else float(m.correlation_length[rows].max())
    by_name = {
        "offset": (-longest * size, longest * size),
        "threshold_slope": (-0.5 / longest, 2 / longest),
        "discrepancy": (1e-4, 1.0),
        "strength": (1.0, 1e12),
        "width": (1e-4, 0.02),
        "poisson": (0.0, 0.5),
        "prestress": (0.0, 0.95),
    }
    if name in by_name:
        return by_name[name]
    factor = {"height": 2.0}.get(name, 10.0)
    lowest = 1.01 / m.height[rows].min()
    low = max(1 / factor, lowest) if name == "height" else 1 / factor
    high = min(factor, 1 / lowest) if name == "correlation_length" else factor
    return float(np.exp(reference)) * low, float(np.exp(reference)) * high


_LIMITS = {"poisson": (-0.99, 0.5), "prestress": (-0.99, 0.99)}


def softest(m: Measurements) -> np.ndarray:
    """k/K of each measurement, far below b = (λc/H)², at which no neighbour of the edge contact breaks: the length is zero."""
    return 1e-2 / (2 * (1 + m.poisson) * m.height**3)


def ratio_per_unit(m: Measurements) -> np.ndarray:
    """k/K of each measurement for a stiffness of 1, in its unit; E of 1 where the table has none."""
    if m.correlation_length is None:
        return np.ones(len(m))
    return m.correlation_length if m.young is None else m.correlation_length / m.young


def _check_domain(parameters: ParameterSet) -> None:
    """Refuse limits that lead outside the domain of the model."""
    down, up = np.minimum(parameters.slope, 0), np.maximum(parameters.slope, 0)
    lowest = parameters.base + up @ parameters.low + down @ parameters.high
    highest = parameters.base + up @ parameters.high + down @ parameters.low
    limits = {
        "log_height": (0.0, np.inf, "H/λc", "must exceed 1"),
        "log_stiffness": (np.log(1e-30), np.log(1e3), "k/K", "must lie in 1e-30 to 1e3"),
        "poisson": (POISSON.low, POISSON.high, "ν", POISSON.requirement),
        "prestress": (PRESTRESS.low, PRESTRESS.high, "φ", PRESTRESS.requirement),
        "threshold_slope": (THRESHOLD_SLOPE.low, THRESHOLD_SLOPE.high, "ε", THRESHOLD_SLOPE.requirement),
        "log_width": (np.log(1e-6), np.log(0.1), "w", "must lie in 1e-6 to 0.1, beyond which a front hardly fades"),
    }
    logarithms = [i for i, name in enumerate(limits) if name.startswith("log")]
    for column, (low, high, symbol, requirement) in enumerate(list(limits.values())[: lowest.shape[1]]):
        reach = [float(lowest[:, column].min()), float(highest[:, column].max())]
        if reach[0] < low - 1e-9 or reach[1] > high + 1e-9:
            shown = [np.exp(x) if column in logarithms else x for x in reach]
            raise ValueError(f"bounds mean {symbol} from {shown[0]:g} to {shown[1]:g} for some measurement: {requirement}")
