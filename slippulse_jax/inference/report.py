"""Report of a fit as text, with its notes."""

import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
from scipy.special import ndtr

from slippulse_jax.inference.changes import (
    END,
    MANY,
    NARROW_PUSHER,
    USUAL,
    Change,
    of_inputs,
    total,
    total_interval,
    total_of_ratio,
)
from slippulse_jax.inference.columns import READINGS
from slippulse_jax.inference.fitted import (
    GIVEN,
    GRAVITY,
    IMPROBABLE,
    LEVELS,
    SCATTERED,
    Fitted,
    Identifiability,
    gravest,
)
from slippulse_jax.inference.fronts import ENDED
from slippulse_jax.inference.intervals import Interval
from slippulse_jax.inference.measurements import Measurements, likely_mistakes
from slippulse_jax.inference.parameters import OF_MEASURING, STIFFNESSES, Free
from slippulse_jax.inference.search import SCANNED
from slippulse_jax.inference.verdict import PLATEAU, degrees_of_freedom, of_inputs_in_words
from slippulse_jax.shown import exponent_of, format_number, html
from slippulse_jax.theory import length_ceiling, rebreaking_b

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
NONE = 1e-6
"""Change of a prestress, or of another number of either sign, that is none."""
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


def report(result: Fitted, changes: Sequence[Change], next_steps: Sequence[str], *, verbose: bool = False) -> str:
    """Format a fit: the result in a box, what else would move it, the data, remarks on this table.

    `verbose` adds the model, the range searched, all intervals, fitted inputs, correlations, the regime, and contacts broken.
    """
    remarks = [note for note in notes(result) if note not in set(_mistakes(result))]
    parts = [
        _boxed([*_values(result, changes), *(line for text in sentences(result, changes) for line in folded(text, WIDEST))]),
        _roots(result),
        _moving(result, changes),
        _table(result),
        _further(result),
        ["What to try next", *(f"  - {step}" for step in next_steps)] if next_steps else [],
        ["Remarks", *(f"  - {note}" for note in remarks)] if remarks else [],
        _details(result, changes) if verbose else [],
    ]
    return "\n\n".join("\n".join(part) for part in parts if part)


def methods(result: Fitted, changes: Sequence[Change]) -> str:
    """Write a sentence for the methods section of a paper, filled in with the numbers of this fit."""
    m, q, given = result.measurements, result.parameters, result.given
    moved, scale = sorted(of_inputs(changes), key=lambda one: [*USUAL].index(one.name)), m.unit[0]
    values = [value_in_words(result, name, changes) for name in given]
    body = "the two-layer slider of Braun and Scheibert (Tribology Letters, 2014)"
    if q.front.body == "block" and m.push_height is not None:
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
        usual = ", ".join(f"{USUAL[one.name].symbol} ({USUAL[one.name].in_words.partition(' by ')[2]})" for one in moved)
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


def _data(result: Fitted) -> str:
    """``6 lengths``, ``2 counts and 16 readings``."""
    counts = {_measured_as(result): len(result.measurements)}
    for one in result.further:
        kind = "reading" if one.observable in READINGS else one.observable
        counts[kind] = counts.get(kind, 0) + len(one.value)
    return _listed([_plural(count, kind) for kind, count in counts.items()])


def _priors(result: Fitted, *names: str) -> list[str]:
    """Inputs, offset and model factor fitted beside, each with its prior: ``offset = 0 ± 0.5 mm``."""
    nuisance = [one for one in result.parameters.free if one.nuisance and one.name != "arrest"]
    beside = [one for one in nuisance if one.name in names] if names else nuisance
    return list(dict.fromkeys(f"{one.symbol} = {_prior(result, one)}" for one in beside))  # what specimens share, once


def _prior(result: Fitted, one: Free) -> str:
    """``0 ± 0.5 mm``, a length in the unit of the table."""
    size, unit = _in_its_unit(result, one.label)
    mean = one.value(one.prior_mean)
    return f"{value_with_error(mean * size, one.prior_sigma * size * (mean if one.log else 1))} {unit}".rstrip()


def _in_its_unit(result: Fitted, name: str) -> tuple[float, str]:
    """Unit in which to show a parameter, by its label: that of the table for heights and an offset; none for k/K beside."""
    m, one = result.measurements, next((one for one in result.parameters.free if one.label == name), None)
    if one is None:
        return 1.0, ""
    if one.unit != "m" or one.name == "correlation_length" or m.correlation_length is None:
        return 1.0, one.unit
    return float(m.unit[0][0] / m.correlation_length[0]), m.unit[1]


def value_in_words(result: Fitted, name: str, changes: Sequence[Change]) -> str:
    """``k/λc² = (1.96 ± 0.17)e10 Pa/m; (1.956 ± 0.032)e10 from the lengths alone``: with usual errors of inputs first."""
    whole, own = _errors(result, name, changes)
    unit, alone = _in_its_unit(result, name)[1], f"; {own} {_alone(result)}" if whole else ""
    return f"{_shown(result)[name]} = {whole or own} {unit}".rstrip() + alone


def _alone(result: Fitted) -> str:
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


def _errors(result: Fitted, name: str, changes: Sequence[Change]) -> tuple[str, str]:
    """A value with the usual errors of inputs, empty where there are none to add, and without them."""
    pieces, moved = result.intervals.get(name, {}).get(LEVELS[0], []), of_inputs(changes)
    own = result.stderrs[name], pieces[0] if len(pieces) == 1 else None
    if not moved or not all(name in one.moves for one in moved):
        return "", _with_error(result, name, *own, uneven=_uneven(result, name, *own, UNEVEN))
    whole = total(result, name, moved), total_interval(result, name, moved)
    uneven = _uneven(result, name, *whole, UNEVEN_TOTAL) or _uneven(result, name, *own, UNEVEN)
    return _with_error(result, name, *whole, uneven=uneven), _with_error(result, name, *own, uneven=uneven)


def _uneven(result: Fitted, name: str, error: float | None, piece: Interval | None, most: float) -> bool:
    """Whether an interval differs from value ± standard error by more than a part of the error, or stands without one."""
    by = _sides(result.values[name], error, piece)
    return by is None or max(abs(x - 1) for x in by) > most


def _measured_as(result: Fitted) -> str:
    kinds = set(result.measurements.kind)
    return "length" if kinds == {"length"} else "count" if kinds == {"whole"} else "measurement"


# --- the box ------------------------------------------------------------------------------------------------------------


def sentences(result: Fitted, changes: Sequence[Change]) -> list[str]:
    """State the verdict, what to check first, and the body that the result holds for, a paragraph each."""
    mistakes = [f"check first: {one}" for one in _mistakes(result)]
    said = [*_verdicts(result), _quality(result)], mistakes, _holds_for(result, changes)
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


def _values(result: Fitted, changes: Sequence[Change]) -> list[str]:
    """Tabulate values with their errors, with those of inputs taken as exact and without; ratios of specimens too."""
    moved, shown = of_inputs(changes), _shown(result)
    rows = [["", "with usual errors of inputs", _alone(result), "95 % interval" + " (simulated)" * result.calibrated]]
    for name in result.names:
        unit = _in_its_unit(result, name)[1]
        rows.append([shown[name] + f" ({unit})" * bool(unit), *_errors(result, name, changes), _ends(result, name)])
    for labels, ratio in _shown_ratios(result).items():
        own = value_with_error(ratio, result.stiffness_ratios[labels][1])
        rows.append([_over(labels), value_with_error(ratio, total_of_ratio(result, labels, moved)) if moved else "", own, ""])
    kept = [i for i in range(len(rows[0])) if i == 0 or any(row[i] for row in rows[1:])]
    return _aligned([[row[i] for i in kept] for row in rows], str.ljust, indent="")


def _ends(result: Fitted, name: str, level: float = LEVELS[-1]) -> str:
    """The interval of a parameter, in its pieces."""
    size = _in_its_unit(result, name)[0]
    by_level = {level: [_scaled(piece, size) for piece in own] for level, own in result.intervals.get(name, {}).items()}
    narrow, value = _narrowest(by_level), result.values[name] * size
    return " or ".join(interval(piece, value, narrow) for piece in by_level.get(level, [])) or "none"


def _scaled(piece: Interval, size: float) -> Interval:
    return piece._replace(low=piece.low * size, high=piece.high * size)


def _with_error(result: Fitted, name: str, error: float | None, piece: Interval | None, *, uneven: bool) -> str:
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


def _with_error_of_derived(result: Fitted, name: str) -> str:
    """k/K beside an areal stiffness: with its error, by the 68 % interval where that is uneven."""
    verdict = result.verdicts[gravest(result.verdicts)].identifiability
    value, error, pieces = result.values[name], result.stderrs[name], result.intervals.get(name, {}).get(LEVELS[0], [])
    if verdict in GIVEN and len(pieces) == 1 and pieces[0].encloses(value) and _uneven(result, name, error, pieces[0], UNEVEN):
        return value_with_sides(value, value - pieces[0].low, pieces[0].high - value)
    return WITHOUT_VALUE.get(verdict) or value_with_error(value, error)


def _points(result: Fitted) -> bool:
    """Whether what fits are several points, not ranges of values that fit equally."""
    return len(result.roots) > 1 and any(error is not None for root in result.roots for error in root.stderrs.values())


def _verdicts(result: Fitted) -> Iterator[str]:
    """State the verdicts in words: one where all parameters share it, else each with the parameters that it is on."""
    found, shown = result.verdicts, _shown(result)
    kinds = sorted({one.identifiability for one in found.values()}, key=GRAVITY.index)
    for kind in kinds:
        own = [name for name, one in found.items() if one.identifiability is kind]
        reasons = {found[name].reason for name in own} - {""} if kind is not Identifiability.EQUAL else set()
        named = f"{', '.join(shown[name] for name in own)}: " * (len(kinds) > 1)
        yield named + kind.value + (f"; {reasons.pop()}" if len(reasons) == 1 else "")


def _holds_for(result: Fitted, changes: Sequence[Change]) -> Iterator[str]:
    """State the kind of body that the result holds for, and what was guessed or held."""
    q, m = result.parameters, result.measurements
    scale, unit = m.unit
    longest = format_number(float(f"{4 * np.max(result.regime.slow_decay_length * scale):.2g}"))
    ended, machine = (name in q.inputs.more for name in ENDED)
    stated = ["end"] * ended + ["machine"] * machine
    body = q.front.carrier + f" with the stated {' and '.join(stated)}" * bool(stated)
    still = "" if machine or "force" in m.push_control else q.front.held
    needed = [f"{'it' if np.ptp(m.height) == 0 else 'the tallest'} is longer than {longest} {unit}"] * (not ended)
    needed += [f"{still} does not move during the event"] * bool(still)
    body += f", if {' and '.join(needed)}" * bool(needed)
    with_ = q.front.lengths_are_of
    tried = result.identifiability in NOTHING_HOLDS
    yield f"{'tried with' if tried else 'holds for'} {body}, with uniform thresholds" + f" and {with_}" * bool(with_)
    factors = {one.name: [math.exp(by) for moves in one.moves.values() for by in moves] for one in changes}
    for name, ratios in factors.items():
        found = [ratio for ratio in ratios if not math.isnan(ratio)]
        if name == "block":
            none = ", or none fits" * (len(found) < len(ratios))
            factor = f"{_span(found)} times this{none}" if found else "another"
            yield f"for a real block the stiffness is {factor}, depending on where its side is pushed"
        elif name == "push_width":
            suffix = f"_{unit}" * m.in_si
            would = f"the stiffness is about {_span(found)} times as large" if found else "no stiffness fits these lengths"
            yield (
                f"guessed: the pusher covers all of the side above push_height{suffix}, as no push_width{suffix} is stated; if "
                f"it is {NARROW_PUSHER}, {would}"
            )
    if q.held:
        yield "held: " + ", ".join(f"{name} = {format_number(value)}" for name, value in q.held.items())


def _span(factors: Sequence[float]) -> str:
    """``0.052 to 0.66``, or one number."""
    return " to ".join(dict.fromkeys(format_number(x, 2) for x in (min(factors), max(factors))))


def html_of(result: Fitted, changes: Sequence[Change]) -> str:
    """Format the result as a table for a notebook: values with errors and intervals, the verdict, the data."""
    shown = {one.label: _symbol(one.label, one.symbol) for one in result.parameters.free}
    rows = []
    for name in result.values:
        symbol = shown.get(name, "k/K")
        whole, own = _errors(result, name, changes) if name in result.verdicts else ("", _with_error_of_derived(result, name))
        ends = [_ends(result, name, level) if result.intervals.get(name) else "" for level in LEVELS]
        rows.append((symbol, whole or own, own, *ends, _in_its_unit(result, name)[1]))
    heads = ("", "with usual errors of inputs", _alone(result), *(f"{level:.0%} interval" for level in LEVELS), "unit")
    m = result.measurements
    said = [result.reason, f"{_plural(len(m), 'length')} of {m.source}", _quality(result), "report() says more"]
    return html(f"Result: {result.identifiability.value}", rows, heads, "; ".join(text for text in said if text))


def _body(result: Fitted) -> str:
    """What carries the contacts in the model, with the end and the machine that the table states."""
    more, body = result.parameters.inputs.more, result.parameters.front.body_modelled
    body = "block with a free end" if "log_sites" in more else body
    return f"{body} pushed through a spring" if "log_machine" in more else body


def _ratios(result: Fitted) -> str:
    """State the range of k/K, and why it is not one number."""
    ratio, m = result.parameters.inputs_at(result.theta).ratio, result.measurements
    low, high = format_number(ratio.min()), format_number(ratio.max())
    several = sum(one.name in STIFFNESSES for one in result.parameters.free) > 1
    differ = [sign for sign, x in (("λc", m.correlation_length), ("E", m.young)) if x is not None and np.ptp(x) > 0]
    why = ["one for each specimen"] * (several or not differ)
    why += [f"as {' and '.join(differ)} differ{'s' * (len(differ) == 1)} between measurements"] * bool(differ)
    return low if low == high else f"{low} to {high}, {', '.join(why)}"


def _shown_ratios(result: Fitted) -> dict[tuple[str, str], float]:
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


def _shown(result: Fitted) -> dict[str, str]:
    """Short name of each parameter, by label: ``E (block A)`` for ``young[block A, 3e+09]`` where that is unambiguous."""
    long = {one.label: _symbol(one.label, one.symbol) for one in result.parameters.free}
    short = dict(long)
    for one in result.parameters.free:
        specimen = one.label.partition("[")[2].rpartition(", ")[0]
        short[one.label] = one.symbol + f" ({specimen})" * bool(specimen) if one.nuisance else long[one.label]
    return {label: name if list(short.values()).count(name) == 1 else long[label] for label, name in short.items()}


def _inputs(result: Fitted) -> list[str]:
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


def _correlations(result: Fitted) -> list[str]:
    """List the strongest with a requested parameter; `FitResult.correlations` has all."""
    shown, asked = _shown(result), set(result.names)
    strong = sorted(result.correlations.items(), key=lambda item: -abs(item[1]))
    rows = [
        f"    C({shown[a]}, {shown[b]}) = {value:+.3f}"
        for (a, b), value in strong
        if abs(value) > CORRELATED and asked & {a, b}
    ]
    return [f"  correlations above {CORRELATED:g}:", *rows[:MOST_CORRELATIONS]] if rows else []


def _roots(result: Fitted) -> list[str]:
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


def _quality(result: Fitted) -> str:
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
        tested = f"{name} {least}{of_inputs_in_words(result.problem, result.theta)} for {degrees} ({p})"
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


def _regime(result: Fitted) -> str:
    """State b and where contacts break again, and the slow decay length next to the length of the block."""
    at, m = result.regime, result.measurements
    scale, unit = m.unit
    decay = at.slow_decay_length * scale
    if result.parameters.front.body == "block":
        return (
            f"Regime: b = {_range(at.b)}; an edge load decays over {_range(decay)} {unit}, so this holds only for blocks "
            f"longer than 4 times that, {_range(4 * decay)} {unit}"
        )
    again = f" (from {rebreaking_b():.3g} on the edge contact of a tall slider breaks again)" * (
        result.parameters.front.event != "crack"
    )
    ends = f", so this holds only for blocks longer than 4/κ₂ = {_range(4 * decay)} {unit}"
    if result.block_length_over_height is not None:
        ends = f"; L/H = {_range(result.block_length_over_height)}"
    return f"Regime: b = {_range(at.b)}{again}; 1/κ₂ = {_range(decay)} {unit}{ends}"


def _range(x: np.ndarray) -> str:
    """``0.42 to 1.3``, or one number."""
    low, high = (format_number(end, 2) for end in (np.nanmin(x), np.nanmax(x)))
    return low if low == high else f"{low} to {high}"


def _scatter(result: Fitted) -> str:
    """State the standard error of a length that the scatter gives, equal for all in λc."""
    m, size = result.measurements, result.scatter or 1.0
    scale, unit = m.unit
    return f"σ = {size:.3g} λc" if np.ptp(scale) > 0 else f"σ = {size * float(scale[0]):.3g} {unit}"


def _table(result: Fitted) -> list[str]:
    """Tabulate the lengths: where, height, measured with the σ used, fitted, and how far that is off."""
    m, fitted = result.measurements, result.fitted
    scale, unit = m.unit
    counted, numbers = m.numbered
    known = result.identifiability is not Identifiability.NO_SCATTER  # whether σ has a size
    several, pushed = len(set(m.specimen)) > 1, result.parameters.front.body == "block" and m.push_height is not None
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
                f"{fitted[i] * scale[i]:.5g}",
                _residual(result, i),
            ]
        )
    return _aligned(rows, str.rjust)


def _aligned(rows: list[list[str]], justify: Callable[[str, int], str], indent: str = "  ") -> list[str]:
    """Align the columns of a table."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [indent + "  ".join(map(justify, row, widths)).rstrip() for row in rows]


def _further(result: Fitted) -> list[str]:
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


def _moving(result: Fitted, changes: Sequence[Change]) -> list[str]:
    """Tabulate what else would move the result, largest first."""
    names = [name for name in result.names if any(name in one.moves for one in changes)]
    if not names:
        return []
    shown = _shown(result)
    rows = [["What else would move it", f"{shown[names[0]]} would be"]]
    if len(names) > 1:
        rows = [["What else would move it, and to what", *(shown[name] for name in names)]]
    rows += [[f"  {one.what}", *(_effect(result, one, name) for name in names)] for one in changes]
    return _aligned(rows, str.ljust, indent="")


def _effect(result: Fitted, change: Change, name: str) -> str:
    """Where a change moves a parameter: ``+5.0 %``, ``× 0.66, none fits``, ``× 2.5 to 5``."""
    if name not in change.moves:
        return ""
    moves = change.moves[name]
    if not result.parameters.named(name).log:
        scale, unit = _in_its_unit(result, name)
        texts = [f"{by * scale:+.2g} {unit}".rstrip() if abs(by) > NONE else "0" for by in moves if not math.isnan(by)]
        return ", ".join(texts) or change.otherwise
    if change.name == "threshold":  # a range
        return f"× {' to '.join(format_number(math.exp(by), 2) for by in moves)}"
    factors = change.name in ("block", "push_width")  # whatever their size
    return ", ".join(change.otherwise if math.isnan(by) else _times(math.exp(by), factors) for by in moves)


def _times(ratio: float, factor: bool = False) -> str:
    """``+5.0 %`` or ``× 5.7``."""
    text = f"× {format_number(ratio, 2)}"
    if 1 / MANY < ratio < MANY and not factor:
        text = f"{ratio - 1:+.1%}".replace("%", " %")
    return text[1:] if text[1:] == "0.0 %" else text


def _sides(value: float, error: float | None, piece: Interval | None) -> tuple[float, float] | None:
    """Distances of the ends of an interval from the value, over the standard error."""
    return None if error is None or piece is None else ((value - piece.low) / error, (piece.high - value) / error)


def _shown_interval(result: Fitted, name: str, piece: Interval) -> str:
    size, unit = _in_its_unit(result, name)
    return f"{interval(_scaled(piece, size), result.values[name] * size)} {unit}".rstrip()


def _measured(m: Measurements, i: int, sigma: float) -> str:
    """``14.03 ± 0.5``, ``> 30``, or ``5 contacts``, in the unit of the table."""
    error = f" ± {float(f'{sigma:.2g}'):g}" if sigma > 0 else ""
    length = f"{m.length[i] * m.unit[0][i]:.5g}{error}"
    if m.kind[i] == "whole":
        return f"{length} ({m.length[i]:g} contacts)" if m.in_si else f"{m.length[i]:g}{error} contacts"
    return f"{'> ' if m.kind[i] == 'at_least' else ''}{length}"


def _residual(result: Fitted, i: int) -> str:
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


def _details(result: Fitted, changes: Sequence[Change]) -> list[str]:
    """Everything that the result rests on, and intervals at both levels."""
    m, shown = result.measurements, {one.label: _symbol(one.label, one.symbol) for one in result.parameters.free}
    specimens, front = len(set(m.specimen)), result.parameters.front
    rows = [
        "Details",
        f"  data    {m.source} ({_plural(len(m), 'measurement')}"
        + f", {_plural(specimens, 'specimen')}" * bool(specimens)
        + ")",
        f"  model   {front.name}, uniform interface, {_body(result)} ({front.length_modelled})",
        *_searched(result),
        "  result",
    ]
    for name in result.values:
        unit = _in_its_unit(result, name)[1]
        text = _errors(result, name, changes)[1] if name in result.verdicts else _with_error_of_derived(result, name)
        rows.append(f"    {shown.get(name, 'k/K')} = {text} {unit}".rstrip())
        for level in result.intervals.get(name, {}):
            rows.append(f"      {level:.0%} interval{' (simulated)' * result.calibrated}  {_ends(result, name, level)}")
    if "stiffness" not in result.values:
        rows.append(f"    k/K = {_ratios(result)}")
    rows += [*_inputs(result), *_correlations(result), f"  {_regime(result)}"]
    scale, unit = m.unit
    rows += ["  broken contacts, and the longest length attainable at any stiffness searched:"]
    for i in range(len(m)):
        broken = result.contacts_broken[i]
        rows.append(f"    {m.number(i)}: {broken if broken > 0 else 'all'}, {result.attainable[i] * scale[i]:.5g} {unit}")
    return rows


def _searched(result: Fitted) -> list[str]:
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


def _mistakes(result: Fitted) -> Iterator[str]:
    return likely_mistakes(result.measurements, prestressed="prestress" in {one.name for one in result.parameters.free})


def notes(result: Fitted) -> Iterator[str]:
    """Remarks to read before using the numbers, most of them about the data."""
    yield from _of_data(result)
    yield from _of_sigma(result)
    yield from _of_pulls(result)
    yield from _of_shape(result)
    yield from _mistakes(result)
    if any(one.name in STIFFNESSES for one in result.parameters.free):
        yield from _of_attainable(result)
    yield from _of_intervals(result)
    if result.parameters.front.event == "domino" and any(root.rebreaks for root in result.roots[:1]):
        yield (
            "at the fitted stiffness the contact at the edge would be back at its threshold before the front stops: the length "
            "is that of the first front alone"
        )
    yield from _of_short_blocks(result)


def _of_attainable(result: Fitted) -> Iterator[str]:
    """Warn of lengths near or above the longest that any stiffness gives."""
    m, attainable, front = result.measurements, result.attainable, result.parameters.front
    sigma = np.where(np.isnan(m.sigma), 0, m.sigma)
    lowest = np.where(np.array(m.kind) == "whole", m.length - 1, m.length) - sigma
    above = lowest > attainable
    if above.any():
        i = int(np.argmin(attainable / m.length))
        count = int(above.sum())
        reached = "where no domino starts"
        if attainable[i] > 0:
            reached = f"{m.length[i] / attainable[i]:.3g} times the longest attainable, {m.in_its_unit(i, attainable[i])}"
        yield (
            f"{count} length{'s lie' if count > 1 else ' lies'} more than σ above the longest that a stiffness in the range "
            f"searched gives; worst at {m.number(i)}: {m.in_its_unit(i, m.length[i])}, {reached}"
        )
    plateau = ~above & (m.length > PLATEAU * attainable)
    if plateau.any() and front.event != "crack":
        poisson = m.poisson[plateau][0]
        ceiling = float(length_ceiling(poisson))
        of_slider = f" (no first front of a tall slider exceeds {ceiling:.3f} H at ν = {poisson:g})" * (front.body == "slider")
        count = int(plateau.sum())
        lie, they = ("lie", "they constrain") if count > 1 else ("lies", "it constrains")
        some = f"{count} of {len(m)} lengths {lie}" if len(m) > 1 else "the length lies"
        yield f"{some} within {1 - PLATEAU:.0%} of the longest attainable, where {they} stiffness little{of_slider}"


def _of_short_blocks(result: Fitted) -> Iterator[str]:
    m = result.measurements
    if m.block_length is not None:
        ratio, usual = m.block_length / result.regime.slow_decay_length, END
        short = ratio < usual
        if short.any():
            yield (
                f"{int(short.sum())} of {len(m)} blocks are shorter than {usual:g}/κ₂ (the shortest {np.nanmin(ratio):.2g}/κ₂)"
                ": the lengths depend on the far end, which is taken to be free"
            )


def _of_data(result: Fitted) -> Iterator[str]:
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


def _of_sigma(result: Fitted) -> Iterator[str]:
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
    if result.problem.loss != "normal":
        yield f"loss: {result.problem.loss}; outliers count less than their σ implies"


def _of_pulls(result: Fitted) -> Iterator[str]:
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


def _of_shape(result: Fitted) -> Iterator[str]:
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
        elif result.scatter_dof is not None and max(by) / min(by) < 1 + UNEVEN:
            why = f"the size of σ is known from {_plural(result.dof, 'degree')} of freedom only"
        one = result.parameters.named(name)
        ends = _shown_interval(result, name, pieces[0])
        yield (
            f"{_symbol(name, one.symbol)}: the error {_alone(result)} is the 68 % interval, {ends}, not ±: "
            f"{why}, and the interval reaches {by[0]:.2f} times ± below the value and {by[1]:.2f} times ± above it"
        )


def _of_intervals(result: Fitted) -> Iterator[str]:
    if result.between_contacts is not None:
        i = int(np.argmax(result.between_contacts))
        off = result.measurements.in_its_unit(i, float(f"{result.between_contacts[i]:.2g}"))
        yield (
            f"{result.parameters.front.uncertain_as} up to {off} ({result.measurements.place(i)}), which is added to σ in "
            "quadrature"
        )
    if not result.complete and result.problem.p <= SCANNED:
        yield "the range searched was not resolved completely: a minimum elsewhere cannot be excluded; give narrower bounds"
