"""Fitted parameters as a report writes them."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slippulse_jax.base.shown import interval, listed, value_with_error
from slippulse_jax.inference.parameters import OF_MEASURING, Free
from slippulse_jax.inference.result.changes import of_inputs
from slippulse_jax.inference.result.verdict import GIVEN, Identifiability
from slippulse_jax.inference.search.intervals import LEVELS, Interval, Intervals
from slippulse_jax.inference.table.columns import UNITS_OF_LENGTH
from slippulse_jax.inference.table.measurements import Measurements

if TYPE_CHECKING:
    from slippulse_jax.inference.result.result import FitResult

WITHOUT_VALUE = {
    Identifiability.EQUAL: "any in the interval",
    Identifiability.ONE_SIDED: "bounded only",
    Identifiability.UNINFORMATIVE: "any",
}
"""Verdicts under which no value is preferred."""
UNEVEN, UNEVEN_TOTAL = 0.2, 0.1
"""Relative difference between a side of the 68 % interval and the standard error, without and with inputs taken as exact, above
which the error is given as an interval."""


def fitted_beside(result: "FitResult") -> list[Free]:
    """Inputs and the like, fitted only because of their errors."""
    return [one for one in result.parameters.free if one.nuisance and one.name != "arrest"]


def error_source(result: "FitResult") -> str:
    """State what the errors without those of inputs come from."""
    beside = {one.name for one in fitted_beside(result)}
    rows = result.main.rows_are
    other = sorted({result.observable(one.observable).several for one in result.further})
    other += ["priors"] * any(math.isfinite(one.prior_sigma) for one in result.parameters.free if not one.nuisance)
    shared = {*OF_MEASURING, "threshold_scatter"}
    other += ["stated errors"] * bool(beside - shared) + ["shared errors"] * bool(beside & shared)
    return f"from {listed([rows, *other])} only" if other else f"from the {rows} only"


class Shown(NamedTuple):
    """A fitted parameter, or k/K from one, as the report writes it."""

    symbol: str
    unit: str
    size: float  # of one in SI, or without a unit, in that unit
    prior: str  # ``0 ± 0.5 mm``; empty without one
    own: str  # its value with the error from the data, or why there is none
    whole: str  # with the usual errors of inputs too; empty where there are none to add
    intervals: dict[float, str]  # by level
    wider: dict[float, str]  # with these errors; empty likewise
    sides: np.ndarray  # distances of the ends of its 68 % interval from it, over its error; inf where it lacks either

    def in_words(self, result: "FitResult") -> str:
        """Write ``k/λc² = (1.96 ± 0.17)e10 Pa/m`` and the error alone."""
        return self.equals(self.whole or self.own) + (f"; {self.own} {error_source(result)}" if self.whole else "")

    def equals(self, value: str) -> str:
        """Write ``k/λc² = value Pa/m``."""
        return f"{self.symbol} = {value} {self.unit}".rstrip()

    def within(self, intervals: dict[float, str]) -> str:
        """Write ``k/λc² = (1.89 to 2.02)e10 Pa/m``, or an end of it."""
        return self.equals(intervals.get(LEVELS[-1], "none")).replace("= above", "above").replace("= below", "below")


def with_totals(result: "FitResult") -> dict[str, Shown]:
    """Show every parameter, with usual errors of inputs, if any."""
    return shown_of(result, result.totals if of_inputs(result.changes) else {})


def shown_of(result: "FitResult", totals: Mapping[str, tuple[float | None, Interval | None]]) -> dict[str, Shown]:
    """Show every parameter by label, and k/K that follows from them."""
    q, symbols, errors = result.parameters, _symbols(result), result.stderrs
    free, found = {one.label: one for one in q.free}, {}
    for name, value in (result.values | result.inputs).items():
        size, unit, prior = _unit_and_prior(result.measurements, free.get(name))
        texts = _ranges(result.intervals.get(name, {}), value, size)
        wider = _ranges(result.intervals_with_inputs.get(name, {}), value, size) if totals else {}
        every = result.intervals.get(name, {}).get(LEVELS[0], [])
        own = errors.get(name), every[0] if len(every) == 1 else None
        sides, whole = _sides(value, *own), ""
        uneven = np.abs(sides - 1).max() > UNEVEN
        if name in totals and name in result.given:
            uneven = uneven or np.abs(_sides(value, *totals[name]) - 1).max() > UNEVEN_TOTAL
            whole = _with_error(result, name, value, size, *totals[name], uneven=uneven)
        by_data = _with_error(result, name, value, size, *own, uneven=uneven)
        found[name] = Shown(symbols.get(name, "k/K"), unit, size, prior, by_data, whole, texts, wider, sides)
    return found


def _ranges(intervals: Intervals, value: float, size: float) -> dict[float, str]:
    """Write intervals by level, in a unit of some `size`."""
    by_level = {
        level: [piece._replace(low=piece.low * size, high=piece.high * size) for piece in pieces]
        for level, pieces in intervals.items()
    }
    closed = [piece.high - piece.low for pieces in by_level.values() for piece in pieces if not any(piece[2:])]
    alone = all(len(pieces) < 2 for pieces in by_level.values())
    digits = (value * size, min(closed, default=0.0)) if alone else ()  # those of the narrowest for all
    return {level: " or ".join(interval(x, *digits) for x in pieces) or "none" for level, pieces in by_level.items()}


def _symbols(result: "FitResult") -> dict[str, str]:
    """Short name of each parameter, by label.

    ``E (block A)`` for ``young[block A, 3e+09]`` where that is unambiguous.
    """
    long = {one.label: one.symbol + "".join(one.label.partition("[")[1:]) for one in result.parameters.free}
    short = dict(long)
    for one in (one for one in result.parameters.free if one.nuisance):
        specimen = one.label.partition("[")[2].rpartition(", ")[0]
        short[one.label] = one.symbol + f" ({specimen})" * bool(specimen)
    return {label: name if [*short.values()].count(name) == 1 else long[label] for label, name in short.items()}


def _unit_and_prior(m: Measurements, one: Free | None) -> tuple[float, str, str]:
    """Factor, unit and prior of a parameter; none for k/K.

    In the unit of the table for lengths and forces.
    """
    if one is None:
        return 1.0, "", ""
    size, unit, mean = 1.0, one.unit, one.value(one.prior_mean)
    if unit == "m" and one.name != "correlation_length":
        unit = m.unit[1]
        size = 1 / UNITS_OF_LENGTH[unit]
    if unit == "N/m":
        (size, *_), unit = m.unit_of_force
    error = one.prior_sigma * size * (mean if one.log else 1)
    return size, unit, f"{value_with_error(mean * size, error)} {unit}".rstrip() if math.isfinite(error) else ""


def _sides(value: float, error: float | None, piece: Interval | None) -> np.ndarray:
    """Sides of an interval over the standard error; infinite without."""
    ends_of = (math.inf, math.inf) if error is None or piece is None else (value - piece.low, piece.high - value)
    return np.array(ends_of) / (error or 1.0)


def _with_error(
    result: "FitResult", name: str, value: float, size: float, error: float | None, piece: Interval | None, *, uneven: bool
) -> str:
    """Write ``1.2 ± 0.3``, or ``1.2 -0.2 +0.5`` by an uneven interval.

    The value alone, or none, where the verdict says so.
    """
    judged = result.verdicts.get(name)
    verdict = judged.identifiability if judged else result.identifiability
    if uneven and piece is not None and piece.encloses(value) and verdict in GIVEN:
        return value_with_error(value * size, (value - piece.low) * size, (piece.high - value) * size)
    text = WITHOUT_VALUE.get(verdict) or value_with_error(value * size, None if error is None else error * size)
    if verdict is not Identifiability.SEVERAL_ROOTS or not judged:
        return text
    alike = sum(root.deviance < result.deviance + 0.05 for root in result.roots)  # of which none is preferred
    some = f"{text} ({'one' if alike > 1 else 'best'} of {len(result.roots)})"
    return some if result.points else WITHOUT_VALUE[Identifiability.EQUAL]
