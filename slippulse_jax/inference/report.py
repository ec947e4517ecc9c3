"""The text of a fit result."""

import math

import numpy as np

from slippulse_jax.inference.parameters import WIDTH
from slippulse_jax.inference.profile import Interval
from slippulse_jax.inference.result import FitResult
from slippulse_jax.inference.verdict import Identifiability


def report(result: FitResult) -> str:
    """Report of a fit: result, intervals, quality, the measurements one by one, notes."""
    m = result.measurements
    specimens = len(set(m.specimen))
    counts = _plural(len(m), "measurement") + (f", {_plural(specimens, 'specimen')}" if specimens else "")
    lines = [
        "Interface from first-precursor lengths",
        f"  data    {m.source} ({counts})",
        f"  model   first self-healing precursor, uniform interface, semi-infinite slider ({_length(result)})",
        *_searched(result),
        *_held(result),
        "",
        _headline(result),
        *_values(result),
        *_inputs(result),
        *_correlations(result),
        *_roots(result),
        "",
        _quality(result),
        "",
        *_table(result),
        *_further(result),
    ]
    if result.notes:
        lines += ["", "Notes", *(f"  - {note}" for note in result.notes)]
    return "\n".join(lines)


def _length(result: FitResult) -> str:
    return "length under the smooth break rule" if result.parameters.base.shape[1] > WIDTH else "exact length"


def _headline(result: FitResult) -> str:
    text = result.identifiability.value
    return f"Result: {text}" + (f"\n  {result.reason}" if result.reason else "")


def _values(result: FitResult) -> list[str]:
    rows = []
    shown = {one.label: (_symbol(one.label, one.symbol), one.unit) for one in result.parameters.free}
    intervals = result.intervals
    width = max(10, *(len(shown.get(name, ("k/K", ""))[0]) for name in result.values))
    for name, value in result.values.items():
        symbol, unit = shown.get(name, ("k/K", ""))
        rows.append(f"  {symbol:{width}s} {value_with_error(value, result.stderr[name])} {unit}".rstrip())
        narrow = _narrowest(intervals.get(name, {}))
        for level, pieces in intervals.get(name, {}).items():
            text = (
                " or ".join(interval(piece, value, narrow) for piece in pieces) or "none: nothing gives these lengths within σ"
            )
            how = " (calibrated)" if result.request["intervals"] == "calibrated" else ""
            rows.append(f"  {'':{width}s} {level:.0%} interval{how}  {text}")
        verdict = result.verdicts.get(name)
        if verdict is not None and len(result.verdicts) > 1 and verdict.identifiability is not Identifiability.IDENTIFIED:
            reason = f": {verdict.reason}" if verdict.reason else ""
            rows.append(f"  {'':{width}s} {verdict.identifiability.value}{reason}")
    if "stiffness" not in result.values:
        ratio = result.parameters.ratio(result.theta)
        each = any("stiffness[" in name for name in result.names)
        why = "one for each specimen" if each else "as λc and E differ between measurements"
        rows.append(f"  {'k/K':{width}s} {ratio.min():.4g} to {ratio.max():.4g}, {why}")
    if any(result.stderr[name] is None for name in result.names):
        rows.append("  standard error unavailable, for the reason above; the value is the one of highest likelihood")
    return rows


def _narrowest(by_level: dict[float, list[Interval]]) -> float:
    """Width of the narrowest closed piece: all ends are then written to the same place."""
    closed = [p.high - p.low for pieces in by_level.values() for p in pieces if not (p.open_low or p.open_high)]
    return min(closed, default=0.0)


def _symbol(label: str, symbol: str) -> str:
    return symbol + label[label.index("[") :] if "[" in label else symbol


def _inputs(result: FitResult) -> list[str]:
    """Inputs with an error of their own: where the fit put them, in their standard errors."""
    pulls = [
        (one, float(t), (float(t) - one.prior_mean) / one.prior_sigma)
        for one, t in zip(result.parameters.free, result.theta, strict=True)
        if one.nuisance
    ]
    if not pulls:
        return []
    rows = ["  inputs with errors of their own, fitted beside:"]
    for one, t, pull in pulls:
        stated = value_with_error(
            float(one.value(one.prior_mean)), one.prior_sigma * (float(np.exp(one.prior_mean)) if one.log else 1)
        )
        fitted = format_number(float(one.value(t)), 5)
        rows.append(f"    {one.label}: stated {stated} {one.unit}".rstrip() + f", fitted {fitted} ({pull:+.2f} σ)")
    return rows


def _correlations(result: FitResult) -> list[str]:
    strong = sorted(result.correlations.items(), key=lambda item: -abs(item[1]))
    rows = [f"    C({a}, {b}) = {value:+.3f}" for (a, b), value in strong if abs(value) >= 0.1]
    if rows:
        rows = ["  correlations (0.1 and above):", *rows]
    if result.problem.p > 1:
        rows += ["  determined, best first (of the logarithms of positive parameters):"]
        for one in result.directions[:6]:
            size = "not at all" if math.isinf(one.stderr) else f"to ± {one.stderr:.2g}"
            rows.append(f"    {one.text}  {size}")
    return rows


def _roots(result: FitResult) -> list[str]:
    if len(result.roots) < 2:
        return []
    several = len(result.names) > 1
    rows = [f"  {'points' if several else 'values'} that fit (not excluded at 95 %):"]
    units = {one.label: one.unit for one in result.parameters.free}
    for root in result.roots:
        again = "; edge contact breaks again before the arrest" if root.rebreaks.any() else ""
        named = ", ".join(
            (f"{name} = " if several else "") + f"{value_with_error(value, root.stderrs[name])} {units[name]}".rstrip()
            for name, value in root.values.items()
        )
        rise = max(0.0, root.chi2 - result.chi2) / result.variance_factor
        rows.append(f"    {named}  (chi-squared + {rise:.2f}{again})")
    return rows


def _quality(result: FitResult) -> str:
    plain = set(result.measurements.kind) == {"length"} and result.problem.loss.name == "normal"
    name = "chi-squared" if plain and result.parameters.discrepancy is None else "deviance"
    if result.scaled:
        size = f": {_scatter(result)}" if result.measurements.length_sigma is None else ""
        return f"Fit: the size of the errors is taken from the scatter ({_plural(result.dof, 'degree')} of freedom){size}"
    if result.p_value is None:
        why = "one length cannot test the model" if len(result.measurements) == 1 else "it cannot be tested"
        if result.dof <= 0:
            return f"Fit: {name} {result.chi2:.3g} with no degree of freedom: {why}"
        return f"Fit: {name} {result.chi2:.3g}, {_plural(result.dof, 'degree')} of freedom; σ as given, not rescaled"
    degrees = _plural(result.dof, "degree") + " of freedom"
    return f"Fit: {name} {result.chi2:.3g} for {degrees} ({_probability(result.p_value)}); σ as given, not rescaled"


def _scatter(result: FitResult) -> str:
    """The standard error of a length that the scatter gives; fitted as equal in λc."""
    m, size = result.measurements, float(np.sqrt(result.variance_factor))
    if m.correlation_length is None or np.ptp(m.correlation_length) > 0:
        return f"σ = {size:.3g} λc"
    return f"σ = {size * float(m.correlation_length[0]) * 1e3:.3g} mm"


def _table(result: FitResult) -> list[str]:
    m, fitted = result.measurements, result.fitted
    if m.correlation_length is not None:
        scale, unit, height_unit = m.correlation_length * 1e3, "mm", "mm"
    else:
        scale, unit, height_unit = np.ones(len(m)), "λc", "λc"
    whole = np.where(fitted.contacts_broken > 0, fitted.contacts_broken, np.inf) * scale
    heads = [
        "line" if m.lines else "no.",
        *(["specimen"] if m.specimen else []),
        f"H/{height_unit}",
        f"measured/{unit}",
        f"fitted/{unit}",
        f"whole contacts/{unit}",
        f"attainable/{unit}",
        "(fit-meas)/σ",
    ]
    rows = [heads]
    for i in range(len(m)):
        rows.append(
            [
                str(m.lines[i] if m.lines else i),
                *([m.specimen[i]] if m.specimen else []),
                f"{m.height[i] * scale[i]:.6g}",
                _measured(m.kind[i], m.length[i] * scale[i], m.sigma[i] * scale[i]),
                f"{fitted.length[i] * scale[i]:.5g}",
                f"{whole[i]:.5g}",
                f"{result.attainable[i] * scale[i]:.5g}",
                f"{result.residuals[i]:+.2f}",
            ]
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(heads))]
    return ["  " + "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]


def _further(result: FitResult) -> list[str]:
    """What was measured beside the lengths: how many, how well they are met, and the worst."""
    if not result.further:
        return []
    rows = ["", "Measured beside the lengths"]
    for one in result.further:
        off = one.residuals / np.sqrt(result.variance_factor)
        worst = int(np.argmax(np.abs(off)))
        rows.append(
            f"  {one.observable:12s} {_plural(len(off), 'datum').replace('datums', 'data')}, chi-squared {(off**2).sum():.3g}; "
            f"worst at {one.places[worst]}: (fit-meas)/σ = {off[worst]:+.2f}"
        )
    return rows


def _measured(kind: str, length: float, sigma: float) -> str:
    error = f" ± {sigma:.2g}" if sigma > 0 else ""
    if kind == "whole":
        return f"{length:.5g} counted{error}"
    return f"{'> ' if kind == 'at_least' else ''}{length:.5g}{error}"


def _exponent(value: float) -> int:
    """Power of ten that a value is written with; 0 for everyday sizes."""
    if value == 0:
        return 0
    exponent = int(np.floor(np.log10(abs(value))))
    return 0 if -2 <= exponent < 4 else exponent


def value_with_error(value: float, error: float | None) -> str:
    """``(1.955 ± 0.032)e10``: the error to two digits, the value to the same place; the value to four without one."""
    if error is None or not 0 < error < np.inf:
        return format_number(value)
    exponent = _exponent(value)
    scaled, scaled_error = value / 10.0**exponent, error / 10.0**exponent
    digits = max(0, 1 - int(np.floor(np.log10(scaled_error))))
    text = f"{scaled:.{digits}f} ± {scaled_error:.{digits}f}"
    return f"({text})e{exponent}" if exponent else text


def format_number(value: float, digits: int = 4) -> str:
    """``1.955e10`` or ``0.03``, written as `value_with_error` writes it."""
    exponent = _exponent(value)
    return f"{value / 10.0**exponent:.{digits}g}e{exponent}" if exponent else f"{value:.{digits}g}"


def interval(piece: Interval, near: float | None = None, width: float = 0.0) -> str:
    """``(1.92 to 1.99)e10``, with the power of ten of the value `near`, and open ends in words."""
    if piece.open_low and piece.open_high:
        return "unbounded"
    if piece.open_low:
        return f"below {format_number(piece.high)}"
    if piece.open_high:
        return f"above {format_number(piece.low)}"
    exponent = _exponent(piece.low if near is None else near)
    own = int(np.floor(np.log10(max(abs(piece.low), abs(piece.high), 1e-300))))
    if not -3 <= own - exponent <= 3:  # far from the value, as at the second root
        exponent, width = _exponent(piece.high), 0.0
    low, high = piece.low / 10.0**exponent, piece.high / 10.0**exponent
    # two digits of half a width, as of a standard error, and never more than six in all
    half = (width / 10.0**exponent or high - low) / 2
    digits = 1 - int(np.floor(np.log10(max(half, 1e-300))))
    digits = min(max(digits, 0), max(0, 5 - int(np.floor(np.log10(max(abs(low), abs(high), 1e-300))))))
    style = ".6g" if round(low, digits) == round(high, digits) else f".{digits}f"
    text = f"{low:{style}} to {high:{style}}"
    return f"({text})e{exponent}" if exponent else text


def _probability(p_value: float) -> str:
    return f"p = {p_value:.2g}" if p_value > 1e-300 else "p < 1e-300"


def _searched(result: FitResult) -> list[str]:
    rows = []
    for one in result.parameters.free:
        if one.nuisance:
            continue
        low, high = (format_number(float(one.value(x)), 2) for x in (one.low, one.high))
        prior = ""
        if math.isfinite(one.prior_sigma):
            mean = float(one.value(one.prior_mean))
            prior = f"; prior {value_with_error(mean, one.prior_sigma * (mean if one.log else 1))}"
        top = f" (k/K up to {result.parameters.ratio(result.parameters.high).max():.3g})" if "areal" in one.name else ""
        rows.append(f"  range   {_symbol(one.label, one.symbol)} from {low} to {high} {one.unit}".rstrip() + top + prior)
    return rows


def _held(result: FitResult) -> list[str]:
    return [f"  held    {name} = {format_number(value)}" for name, value in result.parameters.held.items()]


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}" + "s" * (count != 1)
