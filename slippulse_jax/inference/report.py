"""The text of a fit result."""

import numpy as np

from slippulse_jax.inference.result import FitResult
from slippulse_jax.inference.uncertainty import Interval


def report(result: FitResult) -> str:
    """Report of a fit: result, intervals, quality, the measurements one by one, notes."""
    m = result.measurements
    specimens = len(set(m.specimen))
    counts = _plural(len(m), "length") + (f", {_plural(specimens, 'specimen')}" if specimens else "")
    lines = [
        "Interface stiffness from first-precursor lengths",
        f"  data    {m.source} ({counts})",
        "  model   first self-healing precursor, uniform relaxed interface, semi-infinite slider",
        f"  range   {_searched(result)}",
        "",
        f"{_headline(result)}",
        *_values(result),
        *_roots(result),
        "",
        _quality(result),
        "",
        *_table(result),
    ]
    if result.notes:
        lines += ["", "Notes", *(f"  - {note}" for note in result.notes)]
    return "\n".join(lines)


def _headline(result: FitResult) -> str:
    text = result.identifiability.value
    return f"Result: {text}" + (f"\n  {result.reason}" if result.reason else "")


def _values(result: FitResult) -> list[str]:
    rows = []
    symbols = {result.parameter.name: (result.parameter.symbol, result.parameter.unit), "stiffness": ("k/K", "")}
    for name, value in result.values.items():
        symbol, unit = symbols[name]
        rows.append(f"  {symbol:10s} {value_with_error(value, result.stderr[name])} {unit}".rstrip())
        for level, pieces in result.intervals[name].items():
            text = " or ".join(interval(piece) for piece in pieces) or "none: no stiffness gives these lengths within σ"
            rows.append(f"  {'':10s} {level:.0%} interval  {text}")
    if "stiffness" not in result.values:
        ratio = result.parameter.ratio(result.value)
        rows.append(f"  {'k/K':10s} {ratio.min():.4g} to {ratio.max():.4g}, as λc and E differ between measurements")
    if result.log_stderr is None:
        rows.append("  standard error unavailable, for the reason above; the value is the one of highest likelihood")
    return rows


def _roots(result: FitResult) -> list[str]:
    if len(result.roots) < 2:
        return []
    unit = result.parameter.unit
    rows = ["  stiffnesses that fit (not excluded at 95 %):"]
    for root in result.roots:
        again = "; edge contact breaks again before the arrest" if root.rebreaks.any() else ""
        value = f"{value_with_error(root.value, root.stderr)} {unit}".rstrip()
        rows.append(f"    {value}  (chi-squared + {max(0.0, root.chi2 - result.chi2):.2f}{again})")
    return rows


def _quality(result: FitResult) -> str:
    if result.p_value is None:
        return f"Fit: chi-squared {result.chi2:.3g} with no degree of freedom: one length cannot test the model"
    degrees = _plural(result.dof, "degree") + " of freedom"
    return f"Fit: chi-squared {result.chi2:.3g} for {degrees} ({_probability(result.p_value)}); σ as given, not rescaled"


def _table(result: FitResult) -> list[str]:
    m, fitted = result.measurements, result.fitted
    if m.correlation_length is not None:
        scale, unit, height_unit = m.correlation_length * 1e3, "mm", "mm"
    else:
        scale, unit, height_unit = np.ones(len(m)), "λc", "λc"
    whole = fitted.contacts_broken * scale
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
                f"{m.length[i] * scale[i]:.5g} ± {m.length_sigma[i] * scale[i]:.2g}",
                f"{fitted.length[i] * scale[i]:.5g}",
                f"{whole[i]:.5g}",
                f"{result.attainable[i] * scale[i]:.5g}",
                f"{result.residuals[i]:+.2f}",
            ]
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(heads))]
    return ["  " + "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]


def value_with_error(value: float, error: float | None) -> str:
    """``(1.955 ± 0.032)e10``: the error to two digits, the value to the same place; the value to four without one."""
    if error is None or not 0 < error < np.inf:
        return f"{value:.4g}"
    exponent = int(np.floor(np.log10(abs(value))))
    if -2 <= exponent < 4:
        exponent = 0
    scaled, scaled_error = value / 10.0**exponent, error / 10.0**exponent
    digits = max(0, 1 - int(np.floor(np.log10(scaled_error))))
    text = f"{scaled:.{digits}f} ± {scaled_error:.{digits}f}"
    return f"({text})e{exponent}" if exponent else text


def interval(piece: Interval) -> str:
    """``1.92e10 to 1.99e10``, with open ends in words."""
    if piece.open_low and piece.open_high:
        return "unbounded"
    if piece.open_low:
        return f"below {piece.high:.4g}"
    if piece.open_high:
        return f"above {piece.low:.4g}"
    return f"{piece.low:.4g} to {piece.high:.4g}"


def _probability(p_value: float) -> str:
    return f"p = {p_value:.2g}" if p_value > 1e-300 else "p < 1e-300"


def _searched(result: FitResult) -> str:
    low, high = result.parameter.bounds
    stiffest = result.parameter.ratio(high).max()
    return (
        f"{result.parameter.symbol} from {low:.2g} to {high:.2g} {result.parameter.unit}".rstrip()
        + f" (k/K up to {stiffest:.3g})"
    )


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}" + "s" * (count != 1)
