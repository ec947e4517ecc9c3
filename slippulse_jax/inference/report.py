"""Report of a fit as text, with its notes."""

import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import ndtr

from slippulse_jax.inference.budget import (
    NARROW_PUSHER,
    SUPPOSED,
    USUAL,
    push_is_unstated,
    total,
    total_interval,
    total_of_ratio,
)
from slippulse_jax.inference.hints import of_attainable
from slippulse_jax.inference.measurements import READINGS, Measurements, likely_mistakes
from slippulse_jax.inference.parameters import OF_MEASURING, STIFFNESSES
from slippulse_jax.inference.profile import Interval
from slippulse_jax.inference.search import SCANNED
from slippulse_jax.inference.verdict import (
    GIVEN,
    GRAVITY,
    IMPROBABLE,
    LEVELS,
    SCATTERED,
    Identifiability,
    degrees_of_freedom,
    gravest,
    of_inputs,
)
from slippulse_jax.shown import exponent_of, format_number, html
from slippulse_jax.theory import rebreaking_b

if TYPE_CHECKING:
    from slippulse_jax.inference.parameters import Free
    from slippulse_jax.inference.result import FitResult

WITHOUT_VALUE = {
    Identifiability.EQUAL: "any in the interval",
    Identifiability.ONE_SIDED: "bounded only",
    Identifiability.UNINFORMATIVE: "any",
}
"""Verdicts under which no value is preferred."""
NOTHING_HOLDS = (
    Identifiability.POOR_FIT,
    Identifiability.NOT_CONVERGED,
    Identifiability.AT_MAXIMUM,
    Identifiability.AT_BOUND,
    Identifiability.UNINFORMATIVE,
)
"""Verdicts that leave nothing to hold for a body."""
SCATTERING = (0.6, 0.8)
"""Share of the stiffness that thresholds take off which scatter by 5 % from contact to contact (docs/evidence/scatter.md)."""
NONE = 1e-6
"""Change of a prestress, or of another number of either sign, that is none."""
MANY = 3.0
"""Factor from which on a change is given as one instead of in per cent."""
WIDEST, TIED = 110, "\u00a0"
"""Characters of the longest sentence in the box, and the space at which it is not folded."""
CORRELATED, MOST_CORRELATIONS = 0.5, 5
"""Correlation above which one is shown, and how many at most."""
ALIKE = 0.05
"""Difference of two deviances below which the report prefers neither point."""
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


def report(result: "FitResult", *, verbose: bool = False) -> str:
    """Format a fit: the result in a box, what else would move it, the data, remarks on this table.

    `verbose` adds the model, the range searched, all intervals, fitted inputs, correlations, the regime, and contacts broken.
    """
    remarks = [note for note in result.notes if note not in set(_mistakes(result))]
    parts = [
        _boxed([*_values(result), *(line for text in sentences(result) for line in folded(text, WIDEST))]),
        _roots(result),
        _changes(result),
        _table(result),
        _further(result),
        ["What to try next", *(f"  - {step}" for step in result.next_steps)] if result.next_steps else [],
        ["Remarks", *(f"  - {note}" for note in remarks)] if remarks else [],
        _details(result) if verbose else [],
    ]
    return "\n\n".join("\n".join(part) for part in parts if part)


def methods(result: "FitResult") -> str:
    """Write a sentence for the methods section of a paper, filled in with the numbers of this fit."""
    m, q, given = result.measurements, result.parameters, _given(result)
    moved, scale = result.budget, m.unit[0]
    values = [value_in_words(result, name) for name in given]
    body = "the two-layer slider of Braun and Scheibert (Tribology Letters, 2014)"
    if q.body == "block" and m.push_height is not None:
        where = "about" if m.push_width is not None else "above"
        body = f"a block under two-dimensional elasticity, pushed on its side {where} {_range(m.push_height / m.height)} H"
    constants = [
        f"{sign} = {_range(x * size)}{unit}"
        for sign, x, size, unit in (
            *(("E", m.young, 1e-9, " GPa"), ("ν", m.poisson, 1.0, "")),
            ("λc", m.correlation_length, 1e6, " µm"),
        )
        if x is not None
    ]
    heights = ("a height of " if np.ptp(m.height * scale) == 0 else "heights of ") + _range(m.height * scale)
    held = [f"{name} = {format_number(value)}" for name, value in q.held.items()]
    shown, verdict = _shown(result), "; ".join(_verdicts(result))
    bounded = [name for name in result.names if any(result.intervals.get(name, {}).values())]
    ends = [f"{shown[name]} = {_ends(result, name)} {_in_its_unit(result, name)[1]}".rstrip() for name in bounded]
    obtained = f"we obtain {', and '.join(values)}" if given else f"no number is obtained: {verdict}"
    if ends and not given:
        obtained = f"the 95 % interval is {', and '.join(ends)}: {verdict}"
    errors = []
    if given and moved:
        usual = ", ".join(f"{USUAL[name].symbol} ({USUAL[name].in_words})" for name in moved)
        errors.append(f"The error contains usual errors of {usual}.")
    if given and (fitted := _priors(result)):
        errors.append(f"Fitted with it: {', '.join(fitted)}.")
    if given and not any(one.name == "model_factor" for one in q.free):
        errors.append("The error does not contain that of the model.")
    sign = "χ²" if result.problem.plain else "deviance"
    tested = f" ({sign} = {format_number(result.misfit, 3)} for {degrees_of_freedom(result.problem, result.testable_dof)})"
    return " ".join(
        [
            f"From {_data(result)} of first precursors at {heights} "
            f"{m.unit[1]}, fitted by maximum likelihood{tested * (result.p_value is not None)} with {body}, "
            f"{', '.join([*constants, *held])}, {obtained} (slippulse_jax {version('slippulse_jax')}).",
            *errors,
        ]
    )


def _data(result: "FitResult") -> str:
    """``6 lengths``, ``2 counts and 16 readings``."""
    counts = {_measured_as(result): len(result.measurements)}
    for one in result.further:
        kind = "reading" if one.observable in READINGS else one.observable
        counts[kind] = counts.get(kind, 0) + len(one.value)
    return _listed([_plural(count, kind) for kind, count in counts.items()])


def _priors(result: "FitResult", *names: str) -> list[str]:
    """Inputs, offset and model factor fitted beside, each with its prior: ``offset = 0 ± 0.5 mm``."""
    nuisance = [one for one in result.parameters.free if one.nuisance and one.name != "arrest"]
    beside = [one for one in nuisance if one.name in names] if names else nuisance
    return list(dict.fromkeys(f"{one.symbol} = {_prior(result, one)}" for one in beside))  # what specimens share, once


def _prior(result: "FitResult", one: "Free") -> str:
    """``0 ± 0.5 mm``, a length in the unit of the table."""
    size, unit = _in_its_unit(result, one.label)
    mean = one.value(one.prior_mean)
    return f"{value_with_error(mean * size, one.prior_sigma * size * (mean if one.log else 1))} {unit}".rstrip()


def _in_its_unit(result: "FitResult", name: str) -> tuple[float, str]:
    """Unit in which to show a parameter, by its label: that of the table for heights and an offset; none for k/K beside."""
    m, one = result.measurements, next((one for one in result.parameters.free if one.label == name), None)
    if one is None:
        return 1.0, ""
    if one.unit != "m" or one.name == "correlation_length" or m.correlation_length is None:
        return 1.0, one.unit
    return float(m.unit[0][0] / m.correlation_length[0]), m.unit[1]


def value_in_words(result: "FitResult", name: str) -> str:
    """``k/λc² = (1.96 ± 0.17)e10 Pa/m; (1.956 ± 0.032)e10 from the lengths alone``: with usual errors of inputs first."""
    whole, own = _errors(result, name)
    unit, alone = _in_its_unit(result, name)[1], f"; {own} {_alone(result)}" if whole else ""
    return f"{_shown(result)[name]} = {whole or own} {unit}".rstrip() + alone


def _alone(result: "FitResult") -> str:
    """State what the errors without those of inputs taken as exact come from."""
    free = result.parameters.free
    beside = {one.name for one in free if one.nuisance} - {"arrest"}
    other = sorted({"readings" if one.observable in READINGS else one.observable for one in result.further})
    other += ["priors"] * any(math.isfinite(one.prior_sigma) for one in free if not one.nuisance)
    other += ["stated errors"] * bool(beside - set(OF_MEASURING))
    other += ["errors of measuring"] * bool(beside & set(OF_MEASURING))
    return f"from {_listed(['lengths', *other])} alone" if other else "from the lengths alone"


def _listed(texts: list[str]) -> str:
    """``a, b and c``."""
    return ", ".join(texts[:-1]) + " and " * (len(texts) > 1) + texts[-1]


def _errors(result: "FitResult", name: str) -> tuple[str, str]:
    """A value with the usual errors of inputs, empty where there are none to add, and without them."""
    pieces, moved = result.intervals.get(name, {}).get(LEVELS[0], []), result.budget
    own = result.stderrs[name], pieces[0] if len(pieces) == 1 else None
    if not moved or not all(name in one.change for one in moved.values()):
        return "", _with_error(result, name, *own, uneven=_uneven(result, name, *own, UNEVEN))
    whole = total(result, name, moved), total_interval(result, name, moved)
    uneven = _uneven(result, name, *whole, UNEVEN_TOTAL) or _uneven(result, name, *own, UNEVEN)
    return _with_error(result, name, *whole, uneven=uneven), _with_error(result, name, *own, uneven=uneven)


def _uneven(result: "FitResult", name: str, error: float | None, piece: Interval | None, most: float) -> bool:
    """Whether an interval differs from value ± standard error by more than a part of the error, or stands without one."""
    by = _sides(result.values[name], error, piece)
    return by is None or max(abs(x - 1) for x in by) > most


def _measured_as(result: "FitResult") -> str:
    kinds = set(result.measurements.kind)
    return "length" if kinds == {"length"} else "count" if kinds == {"whole"} else "measurement"


# --- the box ------------------------------------------------------------------------------------------------------------


def sentences(result: "FitResult") -> list[str]:
    """State the verdict, what to check first, and the body that the result holds for, a paragraph each."""
    mistakes = [f"check first: {one}" for one in _mistakes(result)]
    said = [*_verdicts(result), _quality(result)], mistakes, _holds_for(result)
    return [text for texts in said if (text := " ".join(_sentences(*texts)))]


def folded(text: str, width: int) -> list[str]:
    """Fold a paragraph into lines, but not at `TIED`."""
    return [line.replace(TIED, " ") for line in textwrap.wrap(text, width, break_on_hyphens=False)]


def _boxed(lines: list[str]) -> list[str]:
    width = max(map(len, lines))
    return ["┌" + "─" * (width + 2) + "┐", *(f"│ {line:{width}s} │" for line in lines), "└" + "─" * (width + 2) + "┘"]


def _sentences(*texts: str) -> list[str]:
    """Begin each text with a capital letter, unless it is a symbol, and end it with a full stop."""
    begun = [(text[0].upper() if text[:2].strip().isalpha() else text[0]) + text[1:].rstrip(".") for text in texts if text]
    return [text + "." * (not text.endswith("?")) for text in begun]


def _values(result: "FitResult") -> list[str]:
    """Tabulate values with their errors, with those of inputs taken as exact and without; ratios of specimens too."""
    moved, shown = result.budget, _shown(result)
    rows = [["", "with usual errors of inputs", _alone(result), "95 % interval" + " (simulated)" * result.calibrated]]
    for name in result.names:
        unit = _in_its_unit(result, name)[1]
        rows.append([shown[name] + f" ({unit})" * bool(unit), *_errors(result, name), _ends(result, name)])
    for labels, ratio in _shown_ratios(result).items():
        own = value_with_error(ratio, result.stiffness_ratios[labels][1])
        rows.append([_over(labels), value_with_error(ratio, total_of_ratio(result, labels, moved)) if moved else "", own, ""])
    kept = [i for i in range(len(rows[0])) if i == 0 or any(row[i] for row in rows[1:])]
    return _aligned([[row[i] for i in kept] for row in rows], str.ljust, indent="")


def _ends(result: "FitResult", name: str, level: float = LEVELS[-1]) -> str:
    """The interval of a parameter, in its pieces."""
    size = _in_its_unit(result, name)[0]
    by_level = {level: [_scaled(piece, size) for piece in own] for level, own in result.intervals.get(name, {}).items()}
    narrow, value = _narrowest(by_level), result.values[name] * size
    return " or ".join(interval(piece, value, narrow) for piece in by_level.get(level, [])) or "none"


def _scaled(piece: Interval, size: float) -> Interval:
    return piece._replace(low=piece.low * size, high=piece.high * size)


def _with_error(result: "FitResult", name: str, error: float | None, piece: Interval | None, *, uneven: bool) -> str:
    """``1.2 ± 0.3``; ``1.2 -0.2 +0.5`` by an uneven 68 % interval; the value alone, or none, where the verdict says so."""
    verdict, size = result.verdicts[name].identifiability, _in_its_unit(result, name)[0]
    value, error = result.values[name] * size, None if error is None else error * size
    piece = None if piece is None else _scaled(piece, size)
    if uneven and piece is not None and piece.encloses(value) and verdict in GIVEN:
        return value_with_sides(value, value - piece.low, piece.high - value)
    if verdict is not Identifiability.SEVERAL_ROOTS:
        return WITHOUT_VALUE.get(verdict) or value_with_error(value, error)
    if not _points(result):
        return WITHOUT_VALUE[Identifiability.EQUAL]
    alike = sum(root.deviance < result.deviance + ALIKE for root in result.roots)
    return f"{value_with_error(value, error)} ({'one' if alike > 1 else 'best'} of {len(result.roots)})"


def _with_error_of_derived(result: "FitResult", name: str) -> str:
    """k/K beside an areal stiffness: with its error, by the 68 % interval where that is uneven."""
    verdict = result.verdicts[gravest(result.verdicts)].identifiability
    value, error, pieces = result.values[name], result.stderrs[name], result.intervals.get(name, {}).get(LEVELS[0], [])
    if verdict in GIVEN and len(pieces) == 1 and pieces[0].encloses(value) and _uneven(result, name, error, pieces[0], UNEVEN):
        return value_with_sides(value, value - pieces[0].low, pieces[0].high - value)
    return WITHOUT_VALUE.get(verdict) or value_with_error(value, error)


def _points(result: "FitResult") -> bool:
    """Whether what fits are several points, not ranges of values that fit equally."""
    return len(result.roots) > 1 and any(error is not None for root in result.roots for error in root.stderrs.values())


def _verdicts(result: "FitResult") -> Iterator[str]:
    """State the verdicts in words: one where all parameters share it, else each with the parameters that it is on."""
    found, shown = result.verdicts, _shown(result)
    kinds = sorted({one.identifiability for one in found.values()}, key=GRAVITY.index)
    for kind in kinds:
        own = [name for name, one in found.items() if one.identifiability is kind]
        reasons = {found[name].reason for name in own} - {""} if kind is not Identifiability.EQUAL else set()
        named = f"{', '.join(shown[name] for name in own)}: " * (len(kinds) > 1)
        yield named + kind.value + (f"; {reasons.pop()}" if len(reasons) == 1 else "")


def _holds_for(result: "FitResult") -> Iterator[str]:
    """State the kind of body that the result holds for, and what was guessed or held."""
    q, m = result.parameters, result.measurements
    scale, unit = m.unit
    longest = format_number(float(f"{4 * np.max(result.regime.slow_decay_length * scale):.2g}"))
    ended, machine = q.inputs.log_sites is not None, q.inputs.log_machine is not None
    if q.body == "block":
        body, still = "a block under two-dimensional elasticity", "the pusher" * ("force" not in m.push_control)
    else:
        stated = ["end"] * ended + ["machine"] * machine
        body = "the paper's slider" + f" with the stated {' and '.join(stated)}" * bool(stated)
        still = "the edge" * (not machine)
    needed = [f"{'it' if np.ptp(m.height) == 0 else 'the tallest'} is longer than {longest} {unit}"] * (not ended)
    needed += [f"{still} does not move during the event"] * bool(still)
    body += f", if {' and '.join(needed)}" * bool(needed)
    fronts = {"crack": "crack-like fronts", "full": "whole events" * (q.body == "slider")}
    with_ = fronts.get(q.event, "the smooth break rule" * q.smooth)
    tried = result.identifiability in NOTHING_HOLDS
    yield f"{'tried with' if tried else 'holds for'} {body}, with uniform thresholds" + f" and {with_}" * bool(with_)
    ratios = [x for factors in result.unstated_push.values() for x in factors.values()]
    found = [x for x in ratios if not math.isnan(x)]
    if push_is_unstated(result):
        none = ", or none fits" * (len(found) < len(ratios))
        factor = f"{_span(found)} times this{none}" if found else "another"
        yield f"for a real block the stiffness is {factor}, depending on where its side is pushed"
    if result.unstated_push.get(NARROW_PUSHER):
        suffix = f"_{unit}" * m.in_si
        would = "no stiffness fits these lengths"
        if found:
            would = f"the stiffness is about {_span(found)} times as large"
        yield (
            f"guessed: the pusher covers all of the side above push_height{suffix}, as no push_width{suffix} is stated; if it "
            f"is {NARROW_PUSHER}, {would}"
        )
    if q.held:
        yield "held: " + ", ".join(f"{name} = {format_number(value)}" for name, value in q.held.items())


def _span(factors: Sequence[float]) -> str:
    """``0.052 to 0.66``, or one number."""
    return " to ".join(dict.fromkeys(format_number(x, 2) for x in (min(factors), max(factors))))


def html_of(result: "FitResult") -> str:
    """Format the result as a table for a notebook: values with errors and intervals, the verdict, the data."""
    shown = {one.label: _symbol(one.label, one.symbol) for one in result.parameters.free}
    rows = []
    for name in result.values:
        symbol = shown.get(name, "k/K")
        whole, own = _errors(result, name) if name in result.verdicts else ("", _with_error_of_derived(result, name))
        ends = [_ends(result, name, level) if result.intervals.get(name) else "" for level in LEVELS]
        rows.append((symbol, whole or own, own, *ends, _in_its_unit(result, name)[1]))
    heads = ("", "with usual errors of inputs", _alone(result), *(f"{level:.0%} interval" for level in LEVELS), "unit")
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


def _ratios(result: "FitResult") -> str:
    """State the range of k/K, and why it is not one number."""
    ratio, m = result.parameters.inputs_at(result.theta).ratio, result.measurements
    low, high = format_number(ratio.min()), format_number(ratio.max())
    several = sum(one.name in STIFFNESSES for one in result.parameters.free) > 1
    differ = [sign for sign, x in (("λc", m.correlation_length), ("E", m.young)) if x is not None and np.ptp(x) > 0]
    why = ["one for each specimen"] * (several or not differ)
    why += [f"as {' and '.join(differ)} differ{'s' * (len(differ) == 1)} between measurements"] * bool(differ)
    return low if low == high else f"{low} to {high}, {', '.join(why)}"


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
        fitted = format_number(one.value(t) * _in_its_unit(result, one.label)[0], 5)
        rows.append(
            f"    {shown[one.label]}: stated {_prior(result, one)}, fitted {fitted} ({pull:+.2f} σ)".replace("-0.00", "+0.00")
        )
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
    """Tabulate the points that fit, where there are several, with their own errors."""
    if not _points(result):
        return []
    keep = "points" if len(result.names) > 1 else "values"
    option = result.measurements.option("--bounds LOW HIGH", "bounds=(low, high)")
    shown, names = _shown(result), list(result.roots[0].values)
    rows = [[*(shown[name] for name in names), "chi-squared" if result.problem.plain else "deviance"]]
    for root in result.roots[:MOST_ROOTS]:
        again = "; edge contact breaks again before the arrest" if root.rebreaks else ""
        values = [value_with_error(value, root.stderrs[name]) for name, value in root.values.items()]
        rows.append([*values, f"+ {max(0.0, root.deviance - result.deviance):.2f}{again}"])
    more = len(result.roots) - MOST_ROOTS
    return [
        f"{keep.capitalize()} that fit (not excluded at 95 %; to keep one, with its errors, give {option})",
        *_aligned(rows, str.ljust),
        *([f"  … and {more} more (FitResult.roots)"] if more > 0 else []),
    ]


def _quality(result: "FitResult") -> str:
    """State what was fitted, how well, and the size of the errors that was used."""
    m, scaled = result.measurements, result.scaled
    specimens = len(set(m.specimen))
    data = f"from {_data(result)} of {Path(m.source).name}"
    data += f" on {specimens} specimens" * (specimens > 1)
    name = result.problem.named_deviance
    if scaled and result.identifiability is Identifiability.NO_SCATTER:
        return f"{data}: no scatter from which to take the size of their errors"
    if scaled:
        size = f": {_scatter(result)}" if m.length_sigma is None else ""
        return f"{data}: the size of the errors is taken from the scatter ({_plural(result.dof, 'degree')} of freedom){size}"
    if result.identifiability is Identifiability.POOR_FIT:
        return data  # the verdict has the rest
    tested, least = "", format_number(round(result.misfit, 9), 3)  # no rounding errors
    if result.p_value is not None:
        degrees = degrees_of_freedom(result.problem, result.testable_dof)
        p = _probability(result.p_value)
        p = (p.replace("= ", "at most ") if degrees.startswith("at most") else p).replace(" ", TIED)
        tested = f"{name} {least}{of_inputs(result.problem, result.theta)} for {degrees} ({p})"
    elif not result.problem.plain:
        return data  # counts and limits that hold cost nothing
    elif result.dof > 0:
        tested = f"{name} {least}, {_plural(result.dof, 'degree')} of freedom"
    else:
        why = "one length cannot test the model" if len(m) == 1 else "the model cannot be tested"
        tested = f"{name} {least} with no degree of freedom, so {why}"
    used = ""
    if (m.stated_sigma > 0).any():
        used = "; σ as given" if result.between_contacts is None else "; σ enlarged as remarked below"
    return f"{data}: {tested}{used}"


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
    low, high = (format_number(end, 2) for end in (np.nanmin(x), np.nanmax(x)))
    return low if low == high else f"{low} to {high}"


def _scatter(result: "FitResult") -> str:
    """State the standard error of a length that the scatter gives, equal for all in λc."""
    m, size = result.measurements, result.scatter or 1.0
    scale, unit = m.unit
    return f"σ = {size:.3g} λc" if np.ptp(scale) > 0 else f"σ = {size * float(scale[0]):.3g} {unit}"


def _table(result: "FitResult") -> list[str]:
    """Tabulate the lengths: where, height, measured with the σ used, fitted, and how far that is off."""
    m, fitted = result.measurements, result.fitted
    scale, unit = m.unit
    counted, numbers = m.numbered
    known = result.identifiability is not Identifiability.NO_SCATTER  # whether σ has a size
    several, pushed = len(set(m.specimen)) > 1, result.parameters.body == "block" and m.push_height is not None
    rows = [
        [
            counted + ", specimen" * several,
            "H, push/" * pushed + "H/" * (not pushed) + unit,
            f"measured/{unit}",
            f"fitted/{unit}",
            "(fit-meas)/σ",
        ]
    ]
    for i in range(len(m)):
        push = f", {m.push_height[i] * scale[i]:.4g}" if pushed and m.push_height is not None else ""
        rows.append(
            [
                f"{numbers[i]} {m.specimen[i]}" if several else str(numbers[i]),
                f"{m.height[i] * scale[i]:.6g}{push}",
                _measured(m, i, result.sigma[i] * scale[i] * known),
                f"{fitted.length[i] * scale[i]:.5g}",
                _residual(result, i),
            ]
        )
    return _aligned(rows, str.rjust)


def _aligned(rows: list[list[str]], justify: Callable[[str, int], str], indent: str = "  ") -> list[str]:
    """Align the columns of a table."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [indent + "  ".join(map(justify, row, widths)).rstrip() for row in rows]


def _further(result: "FitResult") -> list[str]:
    """Summarise the data other than lengths: how many, how well they are fitted, and the worst."""
    if not result.further:
        return []
    rows = ["Other data"]
    for one in result.further:
        worst = int(np.argmax(np.abs(one.residuals)))
        rows.append(
            f"  {one.observable:12s} {_plural(len(one.residuals), 'reading')}, "
            f"chi-squared {format_number((one.residuals**2).sum(), 3)}; "
            f"worst at {one.places[worst]}: (fit-meas)/σ = {one.residuals[worst]:+.2f}"
        )
    return rows


# --- what else would move it ----------------------------------------------------------------------------------------------


class _Change(NamedTuple):
    """A row: what might be otherwise, and the effect on each parameter in words."""

    what: str
    size: float  # of the largest effect, as it is printed: `_size`; inf where nothing fits, −1 where it is not computed
    effects: dict[str, str]


def _changes(result: "FitResult") -> list[str]:
    """Tabulate what else would move the result, largest first."""
    found = sorted([*_of_inputs(result), *_of_ends(result), *_of_bodies(result)], key=lambda one: -one.size)
    names = [name for name in result.names if any(name in one.effects for one in found)]
    if not names:
        return []
    shown = _shown(result)
    rows = [["What else would move it", f"{shown[names[0]]} would be"]]
    if len(names) > 1:
        rows = [["What else would move it, and to what", *(shown[name] for name in names)]]
    rows += [[f"  {one.what}", *(one.effects.get(name, "") for name in names)] for one in found]
    return _aligned(rows, str.ljust, indent="")


def _given(result: "FitResult") -> list[str]:
    """Parameters with a value that something can move."""
    return [name for name, verdict in result.verdicts.items() if verdict.identifiability in GIVEN]


def _stiff(result: "FitResult") -> list[str]:
    return [name for name in _given(result) if result.parameters.named(name).name in STIFFNESSES]


def _effects(result: "FitResult", moved: dict[str, float], none: str) -> tuple[float, dict[str, str]]:
    """The size of the largest change, and all in words; of a positive parameter the change is that of its logarithm."""
    words, size = {}, 0.0
    for name, by in moved.items():
        if math.isnan(by):
            words[name], size = none, math.inf
        elif result.parameters.named(name).log:
            words[name], size = _times(math.exp(by)), max(size, _size(math.exp(by)))
        else:
            scale, unit = _in_its_unit(result, name)
            words[name] = f"{by * scale:+.2g} {unit}".rstrip() if abs(by) > NONE else "0"
            size = max(size, abs(by / (result.values[name] or 1.0)))
    return size, words


def _size(ratio: float) -> float:
    """Size of a change by a factor, in the order of what `_times` prints: per cent, then factors."""
    return abs(ratio - 1) if 1 / MANY < ratio < MANY else max(ratio, 1 / ratio)


def _times(ratio: float) -> str:
    """``+5.0 %``, ``× 5.7``, or that nothing fits."""
    if math.isnan(ratio):
        return "none fits"
    text = f"{ratio - 1:+.1%}".replace("%", " %") if 1 / MANY < ratio < MANY else f"× {format_number(ratio, 2)}"
    return text[1:] if text[1:] == "0.0 %" else text


def _of_inputs(result: "FitResult") -> Iterator[_Change]:
    """Usual errors of inputs taken as exact."""
    for name, one in result.budget.items():
        usual = USUAL[name]
        m = result.measurements
        counted = " (counts stay as they are)" * (name == "correlation_length" and m.in_si and "whole" in m.kind)
        what = f"{usual.symbol} {'smaller' if usual.smaller else 'larger'} by {usual.in_words}{counted}"
        yield _Change(what, *_effects(result, one.change, "none fits"))


def _of_ends(result: "FitResult") -> Iterator[_Change]:
    """An end of the block and a soft machine, which lengthen the front, and a model factor, where the table states none."""
    for name, moved in result.unstated_ends.items():
        yield _Change(SUPPOSED[name][0], *_effects(result, moved, "run through"))
    if result.parameters.body == "block" and (given := _given(result)):
        force = ", or a pusher of which the force is held" * (not result.measurements.push_control)
        yield _Change(f"an end of the block, a machine that gives way{force}", -1.0, dict.fromkeys(given, "not computed"))


def _of_bodies(result: "FitResult") -> Iterator[_Change]:
    """Another body or push for the same lengths, and thresholds that scatter."""
    stiff, unit = _stiff(result), f"_{result.measurements.unit[1]}" * result.measurements.in_si
    if result.unstated_push and stiff:
        each = {name: [factors[name] for factors in result.unstated_push.values() if name in factors] for name in stiff}
        every = [ratio for ratios in each.values() for ratio in ratios]
        size = max((math.inf if math.isnan(ratio) else _size(ratio) for ratio in every), default=math.inf)
        what = f"a pusher {NARROW_PUSHER} (column push_width{unit} states it)"
        if result.parameters.body == "slider":
            what = f"a real block, pushed from {', '.join(result.unstated_push)} H up (column push_height{unit} fits one)"

        def in_words(ratio: float) -> str:
            return "none fits" if math.isnan(ratio) else f"× {format_number(ratio, 2)}"

        yield _Change(what, size, {name: ", ".join(map(in_words, ratios)) or "not computed" for name, ratios in each.items()})
    elif push_is_unstated(result) and stiff:
        what = f"a real block (column push_height{unit} fits one)"
        yield _Change(what, math.inf, dict.fromkeys(stiff, "not computed"))
    if result.parameters.event != "crack" and stiff:  # not studied for crack-like fronts
        least, most = (1 / (1 - share) for share in SCATTERING)
        what = "thresholds that scatter by 5 % between contacts (found for sliders of b = 0.3 to 3)"
        yield _Change(what, _size(most), dict.fromkeys(stiff, f"× {least:.2g} to {most:.2g}"))
    if result.parameters.body == "block" and stiff:
        slider = result.as_slider
        if slider is None:
            yield _Change("the paper's slider", math.inf, dict.fromkeys(stiff, "none fits"))
            return
        ratios = {name: slider.values[name] / result.values[name] for name in stiff if name in slider.values}
        verdicts = dict.fromkeys(slider.verdicts[name].value for name in ratios)
        what = "the paper's slider" + f" ({'; '.join(verdicts)})" * (list(verdicts) != [Identifiability.IDENTIFIED.value])
        size = max(map(_size, ratios.values()), default=0.0)
        yield _Change(what, size, {name: _times(ratio) for name, ratio in ratios.items()})


def _sides(value: float, error: float | None, piece: Interval | None) -> tuple[float, float] | None:
    """Distances of the ends of an interval from the value, over the standard error."""
    return None if error is None or piece is None else ((value - piece.low) / error, (piece.high - value) / error)


def _shown_interval(result: "FitResult", name: str, piece: Interval) -> str:
    size, unit = _in_its_unit(result, name)
    return f"{interval(_scaled(piece, size), result.values[name] * size)} {unit}".rstrip()


def _measured(m: Measurements, i: int, sigma: float) -> str:
    """``14.03 ± 0.5``, ``> 30``, or ``5 contacts``, in the unit of the table."""
    error = f" ± {float(f'{sigma:.2g}'):g}" if sigma > 0 else ""
    length = f"{m.length[i] * m.unit[0][i]:.5g}{error}"
    if m.kind[i] == "whole":
        return f"{length} ({m.length[i]:g} contacts)" if m.in_si else f"{m.length[i]:g}{error} contacts"
    return f"{'> ' if m.kind[i] == 'at_least' else ''}{length}"


def _residual(result: "FitResult", i: int) -> str:
    """(fitted − measured)/σ; of a count or a front without arrest that the model meets, that it holds."""
    off, m = result.residuals[i], result.measurements
    if m.kind[i] != "length" and off == 0:
        return "holds"
    text = f"{off:+.2f}".replace("-0.00", "+0.00")
    return text if result.sigma[i] > 0 else f"off by {text} λc"


def value_with_error(value: float, error: float | None) -> str:
    """``(1.955 ± 0.032)e10``: the error to two digits, the value to the same place; the value to four without one."""
    if error is None or not 0 < error < np.inf:
        return format_number(value)
    exponent = exponent_of(value)
    scaled, scaled_error = value / 10.0**exponent, error / 10.0**exponent
    digits = 1 - int(np.floor(np.log10(scaled_error)))
    text = " ± ".join(f"{round(x, digits):.{max(0, digits)}f}" for x in (scaled, scaled_error))
    return f"({text})e{exponent}" if exponent else text


def value_with_sides(value: float, below: float, above: float) -> str:
    """``(9.2 -1.9 +2.5)e10``: the smaller side to two digits, value and the other side to the same place."""
    exponent = exponent_of(value)
    numbers = [x / 10.0**exponent for x in (value, below, above)]
    digits = max(0, 1 - int(np.floor(np.log10(min(numbers[1:])))))
    middle, down, up = (f"{x:.{digits}f}" for x in numbers)
    text = f"{middle} ± {down}" if down == up else f"{middle} -{down} +{up}"
    return f"({text})e{exponent}" if exponent else text


def interval(piece: Interval, near: float | None = None, width: float = 0.0) -> str:
    """``(1.92 to 1.99)e10``, with the power of ten of the value `near`, and open ends in words."""
    if piece.open_low and piece.open_high:
        return "unbounded"
    if piece.open_low:
        return f"below {format_number(piece.high)}"
    if piece.open_high:
        return f"above {format_number(piece.low)}"
    exponent = exponent_of(piece.low if near is None else near)
    own = int(np.floor(np.log10(max(abs(piece.low), abs(piece.high), 1e-300))))
    if not -3 <= own - exponent <= 3:  # far from the value, as at the second root
        exponent, width = exponent_of(piece.high), 0.0
    low, high = piece.low / 10.0**exponent, piece.high / 10.0**exponent
    # two digits of half a width, as of a standard error, and never more than six in all
    half = (width / 10.0**exponent or high - low) / 2
    digits = 1 - int(np.floor(np.log10(max(half, 1e-300))))
    digits = min(max(digits, 0), max(0, 5 - int(np.floor(np.log10(max(abs(low), abs(high), 1e-300))))))
    if low and not round(low, digits):
        return " to ".join(format_number(end, 3) for end in piece[:2])
    style = ".6g" if round(low, digits) == round(high, digits) else f".{digits}f"
    text = f"{low:{style}} to {high:{style}}"
    return f"({text})e{exponent}" if exponent else text


def _probability(p_value: float) -> str:
    return f"p = {p_value:.2g}".replace("e-0", "e-") if p_value > 1e-300 else "p < 1e-300"


def _details(result: "FitResult") -> list[str]:
    """Everything that the result rests on, and intervals at both levels."""
    m, shown = result.measurements, {one.label: _symbol(one.label, one.symbol) for one in result.parameters.free}
    specimens = len(set(m.specimen))
    rows = [
        "Details",
        f"  data    {m.source} ({_plural(len(m), 'measurement')}"
        + f", {_plural(specimens, 'specimen')}" * bool(specimens)
        + ")",
        f"  model   {_front(result)}, uniform interface, {_body(result)} ({_length(result)})",
        *_searched(result),
        "  result",
    ]
    for name in result.values:
        unit = _in_its_unit(result, name)[1]
        text = _errors(result, name)[1] if name in result.verdicts else _with_error_of_derived(result, name)
        rows.append(f"    {shown.get(name, 'k/K')} = {text} {unit}".rstrip())
        for level in result.intervals.get(name, {}):
            rows.append(f"      {level:.0%} interval{' (simulated)' * result.calibrated}  {_ends(result, name, level)}")
    if "stiffness" not in result.values:
        rows.append(f"    k/K = {_ratios(result)}")
    rows += [*_inputs(result), *_correlations(result), f"  {_regime(result)}"]
    scale, unit = m.unit
    rows += ["  broken contacts, and the longest length attainable at any stiffness searched:"]
    for i in range(len(m)):
        broken = result.fitted.contacts_broken[i]
        rows.append(f"    {m.number(i)}: {broken if broken > 0 else 'all'}, {result.attainable[i] * scale[i]:.5g} {unit}")
    return rows


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
            prior = f"; prior {_prior(result, one)}"
        top = f" (k/K up to {stiffest:.3g})" if "areal" in one.name else ""
        rows.append(f"  range   {_symbol(one.label, one.symbol)} from {low} to {high} {one.unit}".rstrip() + top + prior)
    return rows


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
    if any(one.name in STIFFNESSES for one in result.parameters.free):
        yield from of_attainable(result.measurements, result.attainable, result.parameters.event, result.parameters.body)
    yield from _of_intervals(result)
    if result.parameters.event == "domino" and any(root.rebreaks for root in result.roots[:1]):
        yield (
            "at the fitted stiffness the contact at the edge would be back at its threshold before the front stops: the length "
            "is that of the first front alone"
        )
    yield from _of_short_blocks(result)


def _of_short_blocks(result: "FitResult") -> Iterator[str]:
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
            f"as the lengths were measured, {shared} fitted too ({', '.join(_priors(result, 'offset', 'model_factor'))}); "
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
        factor = np.sqrt(result.misfit / (result.testable_dof or 1))
        relative = result.measurements.option("--sigma relative", 'sigma="relative"')
        probability, taken = _probability(result.p_value), f"; {relative} takes its size from the scatter"
        larger = f"σ would have to be {factor:.2g} times as large" + taken * result.problem.exact_values
        yield f"the scatter is larger than σ says ({probability}): {larger}"
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
            f"{_symbol(name, one.symbol)}: the error {_alone(result)} is the 68 % interval, {ends}, not ±: "
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
