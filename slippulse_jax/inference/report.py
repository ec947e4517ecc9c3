"""Report of a fit as text, with its notes."""

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from slippulse_jax.inference.budget import (
    SUPPOSED,
    USUAL,
    Moved,
    push_is_unstated,
    shares_errors,
    total,
    total_interval,
    total_of_ratio,
)
from slippulse_jax.inference.hints import of_attainable
from slippulse_jax.inference.measurements import likely_mistakes
from slippulse_jax.inference.parameters import MODEL_ERROR, STIFFNESSES
from slippulse_jax.inference.profile import Interval
from slippulse_jax.inference.search import SCANNED
from slippulse_jax.inference.verdict import GIVEN, IMPROBABLE, LEVELS, SCATTERED, Identifiability, gravest
from slippulse_jax.shown import html
from slippulse_jax.theory import rebreaking_b

if TYPE_CHECKING:
    from slippulse_jax.inference.result import FitResult

WITHOUT_INTERVALS = (Identifiability.POOR_FIT, Identifiability.NO_SCATTER)
"""Verdicts whose reason already explains why there are no intervals."""
CORRELATED, MOST_CORRELATIONS = 0.5, 5
"""Correlation above which one is shown, and how many at most."""
MOST_ROOTS = 4
"""Largest number of points that fit that are listed."""
MOST_RATIOS = 6
"""Largest number of ratios of stiffnesses for which all pairs of specimens are shown."""
PULLED = 1.0
"""Pull, in stated errors of an input, below which it is not mentioned: it hardly moves the result."""
UNEVEN = 0.2
"""Relative difference between a side of the 68 % interval and the standard error above which the report mentions it."""
UNEVEN_TOTAL = 0.1
"""The same for the total with inputs taken as exact, above which it is given as an interval too."""


def report(result: "FitResult") -> str:
    """Format a fit: result, intervals, quality, the measurements one by one, notes."""
    m = result.measurements
    specimens, mistakes = len(set(m.specimen)), list(_mistakes(result))
    counts = _plural(len(m), "measurement") + (f", {_plural(specimens, 'specimen')}" if specimens else "")
    lines = [
        "Interface from first-precursor lengths",
        f"  data    {m.source} ({counts})",
        f"  model   {_front(result)}, uniform interface, {_body(result)} ({_length(result)})",
        *_searched(result),
        *_held(result),
        "",
        _headline(result),
        *(f"  but check first: {one}" for one in mistakes),
        *_values(result),
        *_of_specimens(result),
        *_inputs(result),
        *_correlations(result),
        *_roots(result),
        "",
        _quality(result),
        _regime(result),
        "",
        *_table(result),
        *_further(result),
        *_next_steps(result),
        *_budget(result),
        *_bodies(result),
        *_unstated(result),
        *_unstated_push(result),
    ]
    if notes_below := [note for note in result.notes if note not in mistakes]:
        lines += ["", "Notes", *(f"  - {note}" for note in notes_below)]
    return "\n".join(lines)


def html_of(result: "FitResult") -> str:
    """Format the result as a table for a notebook: values with errors and intervals, the verdict, the data."""
    shown = {one.label: (_symbol(one.label, one.symbol), one.unit) for one in result.parameters.free}
    rows = []
    for name, value in result.values.items():
        symbol, unit = shown.get(name, ("k/K", ""))
        by_level = result.intervals.get(name, {})
        ends = [" or ".join(interval(piece, value, _narrowest(by_level)) for piece in pieces) for pieces in by_level.values()]
        rows.append((symbol, value_with_error(value, result.stderrs[name]), *(ends or ["", ""]), unit))
    heads = ("", "value", *(f"{level:.0%} interval" for level in LEVELS), "unit")
    m = result.measurements
    said = [result.reason, f"{_plural(len(m), 'length')} of {m.source}", _quality(result), "report() says more"]
    return html(f"Result: {result.identifiability.value}", rows, heads, "; ".join(text for text in said if text))


def _front(result: "FitResult") -> str:
    if result.parameters.body == "block":
        return "first precursor"
    return "first crack-like precursor" if result.parameters.event == "crack" else "first self-healing precursor"


def _body(result: "FitResult") -> str:
    inputs = result.parameters.inputs
    if result.parameters.body == "block":
        return "semi-infinite block under two-dimensional elasticity, pushed at a height"
    block = "semi-infinite slider" if inputs.log_sites is None else "block with a free end"
    return block if inputs.log_machine is None else f"{block} pushed through a spring"


def _length(result: "FitResult") -> str:
    if result.parameters.event == "crack":
        return "contacts behind it slide at the friction σ_k; exact length"
    if result.parameters.event == "full":
        return "length of the whole event, in which contacts may break again"
    if result.parameters.inputs.log_sites is not None or result.parameters.inputs.log_machine is not None:
        return "length by the recursion"
    return "length under the smooth break rule" if result.parameters.smooth else "exact length"


def _headline(result: "FitResult") -> str:
    text = result.identifiability.value
    return f"Result: {text}" + (f"\n  {result.reason}" if result.reason else "")


def _values(result: "FitResult") -> list[str]:
    rows = []
    shown = {one.label: (_symbol(one.label, one.symbol), one.unit) for one in result.parameters.free}
    intervals = result.intervals
    verdict = result.verdicts[gravest(result.verdicts)]  # the headline states it
    width = max(10, *(len(shown.get(name, ("k/K", ""))[0]) for name in result.values))
    for name, value in result.values.items():
        symbol, unit = shown.get(name, ("k/K", ""))
        rows.append(f"  {symbol:{width}s} {value_with_error(value, result.stderrs[name])} {unit}".rstrip())
        by_level = intervals.get(name, {})
        narrow = _narrowest(by_level)
        for level, pieces in by_level.items():
            text = " or ".join(interval(piece, value, narrow) for piece in pieces)
            how = " (calibrated)" * result.calibrated
            if text or any(by_level.values()):
                rows.append(f"  {'':{width}s} {level:.0%} interval{how}  {text or 'none'}")
        if (
            by_level
            and not any(by_level.values())
            and result.verdicts.get(name, verdict).identifiability not in WITHOUT_INTERVALS
        ):
            rows.append(f"  {'':{width}s} intervals  none: no value gives these lengths within σ")
        own = result.verdicts.get(name)
        if own not in (None, verdict) and own.identifiability is not Identifiability.IDENTIFIED:
            reason = f": {own.reason}" if own.reason else ""
            rows.append(f"  {'':{width}s} {own.identifiability.value}{reason}")
    if "stiffness" not in result.values:
        rows.append(f"  {'k/K':{width}s} {_ratios(result)}")
    without = [name for name in result.names if result.stderrs[name] is None]
    if without:
        of = f" of {', '.join(shown[name][0] for name in without)}" * (len(without) < len(result.names))
        rows.append(f"  standard error{of} unavailable, for the reason above; the value is the one of highest likelihood")
    return rows


def _ratios(result: "FitResult") -> str:
    """State the range of k/K, and why it is not one number."""
    ratio, m = result.parameters.inputs_at(result.theta).ratio, result.measurements
    low, high = f"{ratio.min():.4g}", f"{ratio.max():.4g}"
    differ = any(np.ptp(x) > 0 for x in (m.correlation_length, m.young) if x is not None)
    why = "as λc and E differ between measurements" if differ else "one for each specimen"
    return low if low == high else f"{low} to {high}, {why}"


def _of_specimens(result: "FitResult") -> list[str]:
    """List the ratios of the stiffnesses of specimens."""
    found = result.stiffness_ratios
    rows = [f"    {_over(labels)} = {value_with_error(*found[labels])}" for labels in _shown_ratios(result)]
    return ["  ratios of these stiffnesses (errors that both share cancel):", *rows] if rows else []


def _shown_ratios(result: "FitResult") -> dict[tuple[str, str], float]:
    """Ratios that have an error; of many specimens, only those to the first."""
    found = {labels: ratio for labels, (ratio, error) in result.stiffness_ratios.items() if error is not None}
    many, first = len(found) > MOST_RATIOS, result.names[0]
    return {labels: ratio for labels, ratio in found.items() if not many or labels[1] == first}


def _over(labels: tuple[str, str]) -> str:
    """``B over A`` of the labels of two stiffnesses."""
    return " over ".join(label.partition("[")[2][:-1] for label in labels)


def _narrowest(by_level: dict[float, list[Interval]]) -> float:
    """Width of the narrowest closed piece, which sets the digits of all ends."""
    closed = [p.high - p.low for pieces in by_level.values() for p in pieces if not (p.open_low or p.open_high)]
    return min(closed, default=0.0)


def _symbol(label: str, symbol: str) -> str:
    return symbol + label[label.index("[") :] if "[" in label else symbol


def _shown(result: "FitResult") -> dict[str, str]:
    """Short name of each parameter, by label: ``E (block A)`` for ``young[block A, 3e+09]`` where that is unambiguous."""
    long = {one.label: _symbol(one.label, one.symbol) for one in result.parameters.free}
    short = dict(long)
    for one in result.parameters.free:
        specimen = one.label.partition("[")[2].rpartition(", ")[0]
        short[one.label] = one.symbol + f" ({specimen})" * bool(specimen) if one.nuisance else long[one.label]
    return {label: name if list(short.values()).count(name) == 1 else long[label] for label, name in short.items()}


def _inputs(result: "FitResult") -> list[str]:
    """Fitted values of inputs with an error of their own, and their pulls."""
    pulls = [
        (one, float(t), (float(t) - one.prior_mean) / one.prior_sigma)
        for one, t in zip(result.parameters.free, result.theta, strict=True)
        if one.nuisance
    ]
    if not pulls:
        return []
    priors = [(one.name, one.prior_mean, one.prior_sigma) for one, _, _ in pulls if one.name != "arrest"]
    each = ", inputs separately for each specimen" * (len(set(priors)) < len(priors))
    rows, shown = [f"  also fitted, within their errors{each}:"], _shown(result)
    for one, t, pull in pulls:
        stated = value_with_error(
            one.value(one.prior_mean), one.prior_sigma * (float(np.exp(one.prior_mean)) if one.log else 1)
        )
        fitted = format_number(one.value(t), 5)
        rows.append(f"    {shown[one.label]}: stated {stated} {one.unit}".rstrip() + f", fitted {fitted} ({pull:+.2f} σ)")
    return rows


def _correlations(result: "FitResult") -> list[str]:
    """List the strongest with a requested parameter; `FitResult.correlations` has all."""
    shown, asked = _shown(result), set(result.names)
    strong = sorted(result.correlations.items(), key=lambda item: -abs(item[1]))
    rows = [
        f"    C({shown[a]}, {shown[b]}) = {value:+.3f}"
        for (a, b), value in strong
        if abs(value) > CORRELATED and asked & {a, b}
    ]
    return [f"  correlations above {CORRELATED:g}:", *rows[:MOST_CORRELATIONS]] if rows else []


def _roots(result: "FitResult") -> list[str]:
    if len(result.roots) < 2:
        return []
    several = len(result.names) > 1
    keep = "points" if several else "values"
    option = result.measurements.option("--bounds LOW HIGH", "bounds=(low, high)")
    rows = [f"  {keep} that fit (not excluded at 95 %; to keep one, with its errors, give {option}):"]
    units = {one.label: one.unit for one in result.parameters.free}
    for root in result.roots[:MOST_ROOTS]:
        again = "; edge contact breaks again before the arrest" if root.rebreaks else ""
        named = ", ".join(
            (f"{name} = " if several else "") + f"{value_with_error(value, root.stderrs[name])} {units[name]}".rstrip()
            for name, value in root.values.items()
        )
        rise = max(0.0, root.deviance - result.deviance)
        rows.append(f"    {named}  (chi-squared + {rise:.2f}{again})")
    if len(result.roots) > MOST_ROOTS:
        rows.append(f"    … and {len(result.roots) - MOST_ROOTS} more (FitResult.roots)")
    return rows


def _quality(result: "FitResult") -> str:
    name = "chi-squared" if result.problem.plain else "deviance"
    if result.scaled and result.identifiability is Identifiability.NO_SCATTER:
        return "Fit: the lengths have no scatter from which to take the size of their errors"
    if result.scaled:
        size = f": {_scatter(result)}" if result.measurements.length_sigma is None else ""
        return f"Fit: the size of the errors is taken from the scatter ({_plural(result.dof, 'degree')} of freedom){size}"
    if result.p_value is None:
        why = "one length cannot test the model" if len(result.measurements) == 1 else "it cannot be tested"
        if result.dof <= 0:
            return f"Fit: {name} {result.deviance:.3g} with no degree of freedom: {why}"
        return f"Fit: {name} {result.deviance:.3g}, {_plural(result.dof, 'degree')} of freedom; σ as given, not rescaled"
    degrees = _plural(result.testable_dof or 0, "degree") + " of freedom"
    return f"Fit: {name} {result.deviance:.3g} for {degrees} ({_probability(result.p_value)}); σ as given, not rescaled"


def _regime(result: "FitResult") -> str:
    """State b and where contacts break again, and the slow decay length next to the length of the block."""
    at, m = result.regime, result.measurements
    scale, unit = m.unit
    decay = at.slow_decay_length * scale
    if result.parameters.body == "block":
        return (
            f"Regime: b = {_range(at.b)}; an edge load decays over {_range(decay)} {unit}, so this holds only for blocks "
            f"longer than 4 times that, {_range(4 * decay)} {unit}"
        )
    again = f" (from {rebreaking_b():.3g} on the edge contact of a tall slider breaks again)" * (
        result.parameters.event != "crack"
    )
    ends = f", so this holds only for blocks longer than 4/κ₂ = {_range(4 * decay)} {unit}"
    if result.block_length_over_height is not None:
        ends = f"; L/H = {_range(result.block_length_over_height)}"
    return f"Regime: b = {_range(at.b)}{again}; 1/κ₂ = {_range(decay)} {unit}{ends}"


def _range(x: np.ndarray) -> str:
    """``0.42 to 1.3``, or one number."""
    low, high = (f"{float(f'{end:.2g}'):g}" for end in (np.nanmin(x), np.nanmax(x)))
    return low if low == high else f"{low} to {high}"


def _scatter(result: "FitResult") -> str:
    """State the standard error of a length that the scatter gives, equal for all in λc."""
    m, size = result.measurements, result.scatter or 1.0
    scale, unit = m.unit
    return f"σ = {size:.3g} λc" if np.ptp(scale) > 0 else f"σ = {size * float(scale[0]):.3g} {unit}"


def _table(result: "FitResult") -> list[str]:
    m, fitted = result.measurements, result.fitted
    scale, unit = m.unit
    whole = np.where(fitted.contacts_broken > 0, fitted.contacts_broken, np.inf) * scale
    counted, numbers = m.numbered
    heads = [
        counted,
        *(["specimen"] if m.specimen else []),
        f"H/{unit}",
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
                str(numbers[i]),
                *([m.specimen[i]] if m.specimen else []),
                f"{m.height[i] * scale[i]:.6g}",
                _measured(m.kind[i], m.length[i] * scale[i], m.sigma[i] * scale[i]),
                f"{fitted.length[i] * scale[i]:.5g}",
                f"{whole[i]:.5g}",
                f"{result.attainable[i] * scale[i]:.5g}",
                f"{result.residuals[i]:+.2f}",
            ]
        )
    return _aligned(rows, str.rjust)


def _aligned(rows: list[list[str]], justify: Callable[[str, int], str]) -> list[str]:
    """Align the columns of a table."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(map(justify, row, widths)).rstrip() for row in rows]


def _further(result: "FitResult") -> list[str]:
    """Summarise the data other than lengths: how many, how well they are fitted, and the worst."""
    if not result.further:
        return []
    rows = ["", "Other data"]
    for one in result.further:
        worst = int(np.argmax(np.abs(one.residuals)))
        rows.append(
            f"  {one.observable:12s} {_plural(len(one.residuals), 'datum').replace('datums', 'data')}, "
            f"chi-squared {(one.residuals**2).sum():.3g}; "
            f"worst at {one.places[worst]}: (fit-meas)/σ = {one.residuals[worst]:+.2f}"
        )
    return rows


def _next_steps(result: "FitResult") -> list[str]:
    return ["", "What to try next", *(f"  - {step}" for step in result.next_steps)] if result.next_steps else []


def _budget(result: "FitResult") -> list[str]:
    """Tabulate what usual errors of the inputs taken as exact would add, and the total errors."""
    moved = result.budget
    if not moved:
        return []
    names = list(next(iter(moved.values())).slope)
    q = result.parameters
    free = {name: q.named(name) for name in names}
    rows = [["input", "if larger by", *(f"moves {_symbol(name, one.symbol)} by" for name, one in free.items())]]
    for name, one in moved.items():
        by = {"poisson": f"{one.error:g}", "correlation_length": "a factor 2"}.get(name, f"{one.error:.0%}")
        changes = [f"{one.by(j):+.1%}" if free[j].log else f"{one.by(j):+.2g}" for j in names]
        rows.append([USUAL[name].symbol, by, *changes])
    lines = ["", "Inputs taken as exact, and what their usual errors would change", *_aligned(rows, str.ljust)]
    for name in names:
        whole, wide = total(result, name, moved), total_interval(result, name, moved)
        value = value_with_error(result.values[name], whole)
        by = _sides(result.values[name], whole, wide)
        even = by is not None and max(abs(x - 1) for x in by) < UNEVEN_TOTAL
        ends = "" if wide is None or even else f", 68 % interval {_shown_interval(result, name, wide)}"
        if whole is not None or ends:
            lines.append(f"  with these, {_symbol(name, free[name].symbol)} = {value} {free[name].unit}".rstrip() + ends)
    for labels, ratio in _shown_ratios(result).items():
        whole = total_of_ratio(result, labels, moved)
        lines += [f"  with these, {_over(labels)} = {value_with_error(ratio, whole)} ({_kept_apart(moved)})"]
    return lines


def _kept_apart(moved: dict[str, Moved]) -> str:
    """State which errors of inputs two specimens share."""
    own = [USUAL[name].symbol for name in moved if USUAL[name].of_a_specimen]
    return f"{' and '.join(own)} of each specimen separately, the rest shared" if own else "all shared"


def _sides(value: float, error: float | None, piece: Interval | None) -> tuple[float, float] | None:
    """Distances of the ends of an interval from the value, over the standard error."""
    return None if error is None or piece is None else ((value - piece.low) / error, (piece.high - value) / error)


def _shown_interval(result: "FitResult", name: str, piece: Interval) -> str:
    unit = result.parameters.named(name).unit
    return f"{interval(piece, result.values[name])} {unit}".rstrip()


def _bodies(result: "FitResult") -> list[str]:
    """Compare with the stiffness that the same lengths give with the paper's slider."""
    slider = result.as_slider
    if slider is None:
        return ["", "The same lengths with the slider: no fit was found"] if result.parameters.body == "block" else []
    rows = ["", "The same lengths with"]
    for name in result.names:
        if any(name.startswith(one) for one in STIFFNESSES):
            free = result.parameters.named(name)
            for body, found in (("this block", result), ("the slider", slider)):
                value = value_with_error(found.values[name], found.stderrs[name])
                verdict = found.verdicts[name].identifiability
                said = "" if verdict is Identifiability.IDENTIFIED else f" ({verdict.value})"
                rows.append(f"  {body}  {_symbol(name, free.symbol)} = {value} {free.unit}".rstrip() + said)
            rows.append(f"  slider over block: {slider.values[name] / result.values[name]:.3g}")
    return rows


def _unstated(result: "FitResult") -> list[str]:
    """List the shifts due to an end of the block and a soft machine, which both lengthen the front."""
    rows = [*_of_measuring(result), *_of_a_block(result)]
    for name, moved in result.unstated_ends.items():
        free = {one: result.parameters.named(one) for one in moved}
        changes = [
            f"{_symbol(one, free[one].symbol)} by " + (f"{np.expm1(by):+.1%}" if free[one].log else f"{by:+.2g}")
            for one, by in moved.items()
        ]
        would = "would be run through" if np.isnan(list(moved.values())).any() else f"would move {', '.join(changes)}"
        rows.append(f"  {SUPPOSED[name][0]} {would}")
    return ["", "Not stated, and not in any error above", *rows] if rows else []


def _of_a_block(result: "FitResult") -> Iterator[str]:
    """List the assumptions of a fit of a block: about its end, the machine, and the pusher where the table does not say."""
    m = result.measurements
    if result.parameters.body != "block" or result.identifiability not in GIVEN:
        return
    yield (
        "  an end of the block and a soft machine lengthen fronts, so the stiffness comes out too large where lengths grow "
        "with it; a fit of a block includes neither"
    )
    unit = f"_{m.unit[1]}" * m.in_si
    if m.push_width is None or np.isnan(m.push_width).any():
        yield (
            f"  without push_width{unit} the pusher covers all of the side above push_height{unit}: one that ends lower makes "
            "shorter fronts"
        )
    if not m.push_control:
        yield "  without push_control the displacement of the pusher is held while the front runs; a held force lengthens it"


def _of_measuring(result: "FitResult") -> Iterator[str]:
    """State the errors that measured lengths share, where the table does not say whether they were measured."""
    m, moved = result.measurements, result.budget.get("length")
    if moved is None or any(m.provenance):
        return
    adds = []
    for name, slope in moved.slope.items():
        one = result.parameters.named(name)
        adds.append(f"± {abs(slope) * MODEL_ERROR:{'.0%' if one.log else '.2g'}} to {_symbol(name, one.symbol)}")
    offset, fitted = ("", "it is") if result.scaled else ("an offset and ", "both are")
    yield (
        f"  measured lengths share {offset}a model factor of 1 ± {MODEL_ERROR:g}, which alone would add "
        f"{', '.join(adds)}; with provenance = measured {fitted} fitted"
    )


def _unstated_push(result: "FitResult") -> list[str]:
    """State the stiffness of a block for the same lengths, by where its side is pushed."""
    found = result.unstated_push
    unit = f"_{result.measurements.unit[1]}" * result.measurements.in_si
    column = f"  Add a column push_height{unit} (and push_width{unit}) to fit a block"
    if push_is_unstated(result) and shares_errors(result):
        why = "it depends on where its side is pushed; with an offset or a model factor no ratio to this is given"
        return ["", f"Stiffness of a real block: {why}.", f"{column}."]
    if not found:
        return []
    means = "; ".join(
        f"from {at} H up: {'none gives these lengths' if math.isnan(ratio) else f'{ratio:.2g} times this'}"
        for at, ratio in found.items()
    )
    return ["", f"Stiffness of a real block, pushed on its side {means}.", f"{column}."]


def _measured(kind: str, length: float, sigma: float) -> str:
    error = f" ± {sigma:.2g}" if sigma > 0 else ""
    if kind == "whole":
        return f"{length:.5g} counted{error}"
    return f"{'> ' if kind == 'at_least' else ''}{length:.5g}{error}"


def _exponent(value: float) -> int:
    """Power of ten with which to write a value; 0 for everyday sizes."""
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


def _searched(result: "FitResult") -> list[str]:
    rows = []
    stated = np.array([one.prior_mean if one.nuisance else one.high for one in result.parameters.free])
    stiffest = result.parameters.inputs_at(stated).ratio.max()
    for one in result.parameters.free:
        if one.nuisance:
            continue
        low, high = (format_number(one.value(x), 2) for x in (one.low, one.high))
        prior = ""
        if math.isfinite(one.prior_sigma):
            mean = one.value(one.prior_mean)
            prior = f"; prior {value_with_error(mean, one.prior_sigma * (mean if one.log else 1))}"
        top = f" (k/K up to {stiffest:.3g})" if "areal" in one.name else ""
        rows.append(f"  range   {_symbol(one.label, one.symbol)} from {low} to {high} {one.unit}".rstrip() + top + prior)
    return rows


def _held(result: "FitResult") -> list[str]:
    return [f"  held    {name} = {format_number(value)}" for name, value in result.parameters.held.items()]


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}" + "s" * (count != 1)


def _mistakes(result: "FitResult") -> Iterator[str]:
    return likely_mistakes(result.measurements, prestressed="prestress" in {one.name for one in result.parameters.free})


def notes(result: "FitResult") -> Iterator[str]:
    """Remarks to read before using the numbers, most of them about the data."""
    yield from _of_data(result)
    yield from _of_sigma(result)
    yield from _of_pulls(result)
    yield from _of_shape(result)
    yield from _mistakes(result)
    yield from of_attainable(result.measurements, result.attainable, result.parameters.event, result.parameters.body)
    yield from _of_intervals(result)
    if result.parameters.event == "domino" and any(root.rebreaks for root in result.roots[:1]):
        yield (
            "at the fitted stiffness the contact at the edge would be back at its threshold before the front stops: the length "
            "is that of the first front alone"
        )
    if result.parameters.event != "crack":  # not studied for crack-like fronts
        yield (
            "thresholds are taken as uniform: a scatter of 5 % from contact to contact would make precursors 16-34 % shorter "
            "and the fitted stiffness 60-80 % too small (documentation: Thresholds that scatter)"
        )
    yield from _of_ends(result)
    for message in result.unconverged:
        yield f"a start {message}"


def _of_ends(result: "FitResult") -> Iterator[str]:
    m = result.measurements
    if m.block_length is not None:
        ratio, usual = m.block_length / result.regime.slow_decay_length, SUPPOSED["block_length"][1]
        short = ratio < usual
        if short.any():
            yield (
                f"{int(short.sum())} of {len(m)} blocks are shorter than {usual:g}/κ₂ (the shortest {np.nanmin(ratio):.2g}/κ₂)"
                ": the lengths depend on the far end, which is taken to be free"
            )


def _of_data(result: "FitResult") -> Iterator[str]:
    m = result.measurements
    if m.other:
        yield f"columns kept but not used: {', '.join(m.other)}"
    kinds = sorted({text for text in m.provenance if text})
    if kinds and kinds != ["measured"]:
        yield f"provenance: {', '.join(kinds)}"
    copies = len(m) - m.distinct
    if copies:
        yield (
            f"{_plural(copies, 'measurement')} repeat{'s' * (copies == 1)} another one exactly, and each counts as a "
            "measurement of its own: leave out those that were copied"
        )
    if result.problem.count - copies < result.problem.p:
        hold = m.option("--fix NAME=VALUE", "fixed={name: value}")
        state = m.option("--prior NAME=MEAN,DEVIATION", "sp.Parameter(name, prior=(mean, deviation))")
        yield (
            f"{_plural(result.problem.p, 'parameter')} are fitted, but only {result.problem.count - copies} of the data are "
            f"different: hold some ({hold}), state what is known of them ({state}), or measure at more heights"
        )
    beside = {one.name for one in result.parameters.free if one.nuisance}
    if "model_factor" in beside:
        held = {"offset": 0, "model_factor": 1} if "offset" in beside else {"model_factor": 1}
        option = m.option(" ".join(f"--fix {name}={value}" for name, value in held.items()), f"fixed={held}".replace("'", '"'))
        shared = (
            "an offset and a model factor that they share are" if "offset" in beside else "a model factor that they share is"
        )
        yield (
            f"as the lengths were measured, {shared} fitted too, with the priors shown; "
            f"{option} leaves the errors of the lengths alone"
        )
    if m.in_si and m.young is None:
        yield "no young_GPa: the data determine the areal stiffness only as its ratio to Young's modulus"


def _of_sigma(result: "FitResult") -> Iterator[str]:
    if result.measurements.length_sigma is None:
        yield "no standard errors were given: equal errors were assumed, and their size taken from the scatter about the fit"
    elif result.scaled:
        yield f"the stated σ are taken as relative, and scaled by {result.scatter:.3g} to the scatter about the fit"
    if result.p_value is not None and IMPROBABLE <= result.p_value < SCATTERED:
        factor = np.sqrt(result.deviance / (result.testable_dof or 1))
        relative = result.measurements.option("--sigma relative", 'sigma="relative"')
        yield (
            f"the scatter is larger than σ says (p = {result.p_value:.2g}): σ would have to be {factor:.2g} times as large; "
            f"{relative} takes its size from the scatter"
        )
    if result.problem.loss.name != "normal":
        yield f"loss: {result.problem.loss.name}; outliers count less than their σ implies"


def _of_pulls(result: "FitResult") -> Iterator[str]:
    """Name the inputs that the lengths pull farther from their stated values than chance would.

    The difference between fitted and stated value scatters by √(σ² − s²), with the stated error σ and that of the fit, s.
    """
    if result.covariance is None or result.identifiability not in GIVEN:
        return
    error, shown, q = np.sqrt(np.diag(result.covariance)), _shown(result), result.parameters
    known = [j for j, one in enumerate(q.free) if math.isfinite(one.prior_sigma) and one.name != "arrest"]
    pulled = {}
    for j in known:
        one = q.free[j]
        off = float(result.theta[j]) - one.prior_mean
        usual = np.sqrt(max(one.prior_sigma**2 - error[j] ** 2, 1e-12 * one.prior_sigma**2))
        chance = 1 - (1 - 2 * ndtr(-abs(off) / usual)) ** len(known)
        if abs(off) > PULLED * one.prior_sigma and chance < SCATTERED:
            pulled[one.name] = [*pulled.get(one.name, []), f"{shown[one.label]} by {off / one.prior_sigma:+.2f} σ"]
    if not pulled:
        return
    which = ", ".join(text for every in pulled.values() for text in every)
    shared = pulled.keys() & {"offset", "model_factor"}
    together = len(set(result.measurements.specimen)) > 1 and any(name in STIFFNESSES for name in result.names)
    checks = ["check the stated value and its error"] * bool(pulled.keys() - shared)
    each = result.measurements.option("--each-specimen stiffness", 'free=[sp.Parameter("stiffness", each="specimen")]')
    checks += [f"the specimens may differ in stiffness ({each})"] * together
    checks += ["the lengths do not vary with the height as the model's do"] * bool(shared)
    yield f"the lengths pull {which}, more than chance would: {'; or '.join(checks)}"


def _of_shape(result: "FitResult") -> Iterator[str]:
    """Name the parameters whose 68 % interval differs from value ± standard error."""
    for name in result.names:
        if math.isfinite(result.parameters.named(name).prior_sigma):
            continue  # an input with a stated error
        pieces = result.intervals.get(name, {}).get(LEVELS[0], [])
        by = _sides(result.values[name], result.stderrs[name], pieces[0]) if len(pieces) == 1 else None
        if by is None or max(abs(x - 1) for x in by) <= UNEVEN:
            continue
        why = "the likelihood is not parabolic"
        if result.calibrated:
            why = "the interval is that of simulated measurements"
        elif result.rise.dof is not None and max(by) / min(by) < 1 + UNEVEN:
            why = f"the size of σ is known from {_plural(result.dof, 'degree')} of freedom only"
        one = result.parameters.named(name)
        ends = _shown_interval(result, name, pieces[0])
        yield (
            f"{_symbol(name, one.symbol)}: publish the 68 % interval, {ends}, rather than ±: "
            f"{why}, and the interval reaches {by[0]:.2f} times ± below the value and {by[1]:.2f} times ± above it"
        )


def _of_intervals(result: "FitResult") -> Iterator[str]:
    if result.between_contacts is not None:
        i = int(np.argmax(result.between_contacts))
        what = "the definition of a length between two whole contacts changes it by"
        if result.parameters.body == "block":
            what = "the length of an event on a block is interpolated between coarser blocks, which may change it by"
        elif result.parameters.event == "full":
            what = (
                "the length of an event steps where the order of its breaks changes, and is interpolated, which changes it by"
            )
        yield (
            f"{what} up to {result.measurements.in_its_unit(i, float(f'{result.between_contacts[i]:.2g}'))} "
            f"({result.measurements.place(i)}), which is added to σ in quadrature"
        )
    if not result.complete and result.problem.p <= SCANNED:
        yield "the range searched was not resolved completely: a minimum elsewhere cannot be excluded; give narrower bounds"
