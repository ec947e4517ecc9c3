"""Report of a fit as text, with its notes."""

import math
import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

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
from slippulse_jax.inference.columns import COLUMNS, READINGS
from slippulse_jax.inference.fitted import (
    GIVEN,
    GRAVITY,
    IMPROBABLE,
    LEVELS,
    SCATTERED,
    Fitted,
    Identifiability,
)
from slippulse_jax.inference.fronts import ENDED
from slippulse_jax.inference.intervals import Interval
from slippulse_jax.inference.measurements import likely_mistakes
from slippulse_jax.inference.parameters import OF_MEASURING, STIFFNESSES, Free
from slippulse_jax.inference.search import SCANNED
from slippulse_jax.inference.verdict import PLATEAU, degrees_of_freedom, of_inputs_in_words
from slippulse_jax.shown import ends, format_number, html, interval, listed, plural, value_with_error
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
MOST_ROOTS, MOST_RATIOS = 4, 6
"""Most points that fit, and most ratios of stiffnesses between all pairs of specimens, that are listed."""
PULLED = 1.0
"""Pull, in stated errors of an input, below which it is not mentioned: it hardly moves the result."""
UNEVEN, UNEVEN_TOTAL = 0.2, 0.1
"""Relative difference between a side of the 68 % interval and the standard error, without and with inputs taken as exact, above
which the error is given as an interval."""


def report(result: Fitted, changes: Sequence[Change], next_steps: Sequence[str], *, verbose: bool = False) -> str:
    """Format a fit: the result in a box, what else would move it, the data, remarks on this table.

    `verbose` adds the model, the range searched, all intervals, fitted inputs, correlations, the regime, and contacts broken.
    """
    mistakes = set(_mistakes(result))
    remarks = [note for note in notes(result) if note not in mistakes]
    shown = shown_with(result, changes)
    parts = [
        _boxed(
            [*_values(result, shown, changes), *(line for one in sentences(result, changes) for line in folded(one, WIDEST))]
        ),
        _roots(result),
        _moving(result, changes),
        _table(result),
        _further(result),
        ["What to try next", *(f"  - {step}" for step in next_steps)] if next_steps else [],
        ["Remarks", *(f"  - {note}" for note in remarks)] if remarks else [],
        _details(result, shown) if verbose else [],
    ]
    return "\n\n".join("\n".join(part) for part in parts if part)


def methods(result: Fitted, changes: Sequence[Change]) -> str:
    """Write a sentence for the methods section of a paper, filled in with the numbers of this fit."""
    m, q, given, shown = result.measurements, result.parameters, result.given, shown_with(result, changes)
    scale, unit = m.unit
    body = "the two-layer slider of Braun and Scheibert (Tribology Letters, 2014)"
    if q.front.body == "block" and m.push_height is not None:
        where = "about" if m.push_width is not None else "above"
        body = f"a block under two-dimensional elasticity, pushed on its side {where} {ends(m.push_height / m.height)} H"
    constants = (("E", m.young, 1e-9, " GPa"), ("ν", m.poisson, 1.0, ""), ("λc", m.correlation_length, 1e6, " µm"))
    model = [body, *(f"{sign} = {ends(x * size)}{of}" for sign, x, size, of in constants if x is not None), *_held(result)]
    verdict, errors = "; ".join(_verdicts(result)), []
    bounded = [shown[name] for name in result.names if any(result.intervals.get(name, {}).values())]
    if given:
        obtained = f"we obtain {', and '.join(shown[name].in_words(result) for name in given)}"
        moved = sorted(of_inputs(changes), key=lambda one: USUAL.index(one.name))
        usual = [re.split(" larger by | smaller by ", COLUMNS[one.name].usual[0]) for one in moved]
        errors += [f"The error contains usual errors of {', '.join(f'{sign} ({by})' for sign, by in usual)}."] * bool(usual)
        fitted = _priors(result)
        errors += [f"Fitted with it: {', '.join(fitted)}."] * bool(fitted)
        errors += ["The error does not contain that of the model."] * all(one.name != "model_factor" for one in q.free)
    elif bounded:
        all_ends = ", and ".join(f"{one.symbol} = {one.intervals[LEVELS[-1]]} {one.unit}".rstrip() for one in bounded)
        obtained = f"the 95 % interval is {all_ends}: {verdict}"
    else:
        obtained = f"no number is obtained: {verdict}"
    tested = ""
    if result.p_value is not None:
        sign, dof = "χ²" if result.problem.plain else "deviance", degrees_of_freedom(result.problem, result.testable_dof)
        tested = f" ({sign} = {format_number(result.misfit, 3)} for {dof})"
    heights = ("a height of " if np.ptp(m.height * scale) == 0 else "heights of ") + ends(m.height * scale)
    said = (
        f"From {_data(result)} of first precursors at {heights} {unit}, fitted by maximum likelihood{tested} with "
        f"{', '.join(model)}, {obtained} (slippulse_jax {version('slippulse_jax')})."
    )
    return " ".join([said, *errors])


def _data(result: Fitted) -> str:
    """``6 lengths``, ``2 counts and 16 readings``."""
    kinds = {*result.measurements.kind}
    counts = {"length" if kinds == {"length"} else "count" if kinds == {"whole"} else "measurement": len(result.measurements)}
    for one in result.further:
        kind = "reading" if one.observable in READINGS else one.observable
        counts[kind] = counts.get(kind, 0) + len(one.value)
    return listed([plural(count, kind) for kind, count in counts.items()])


def _held(result: Fitted) -> list[str]:
    return [f"{name} = {format_number(value)}" for name, value in result.parameters.held.items()]


def _priors(result: Fitted, *names: str) -> list[str]:
    """Inputs, offset and model factor fitted beside, each with its prior: ``offset = 0 ± 0.5 mm``."""
    beside = [one for one in result.parameters.free if one.nuisance and one.name != "arrest"]
    chosen = [one for one in beside if one.name in (names or (one.name,))]
    return list(dict.fromkeys(f"{one.symbol} = {_prior(result, one)}" for one in chosen))  # what specimens share, once


def _prior(result: Fitted, one: Free) -> str:
    """``0 ± 0.5 mm``, a length in the unit of the table."""
    size, unit = _unit(result, one)
    mean = one.value(one.prior_mean)
    return f"{value_with_error(mean * size, one.prior_sigma * size * (mean if one.log else 1))} {unit}".rstrip()


def _alone(result: Fitted) -> str:
    """State what the errors without those of inputs taken as exact come from."""
    free = result.parameters.free
    beside = {one.name for one in free if one.nuisance} - {"arrest"}
    other = sorted({"readings" if one.observable in READINGS else one.observable for one in result.further})
    other += ["priors"] * any(math.isfinite(one.prior_sigma) for one in free if not one.nuisance)
    other += ["stated errors"] * bool(beside - set(OF_MEASURING))
    other += ["errors of measuring"] * bool(beside & set(OF_MEASURING))
    return f"from {listed(['lengths', *other])} alone" if other else "from the lengths alone"


# --- parameters as they are shown -----------------------------------------------------------------------------------------


class Shown(NamedTuple):
    """A parameter as the report writes it, in the unit of the table."""

    symbol: str
    unit: str
    own: str  # its value with the error from the data, or why there is none
    whole: str  # with the usual errors of inputs too; empty where there are none to add
    intervals: dict[float, str]  # by level

    def in_words(self, result: Fitted) -> str:
        """``k/λc² = (1.96 ± 0.17)e10 Pa/m; (1.956 ± 0.032)e10 from the lengths alone``."""
        alone = f"; {self.own} {_alone(result)}" if self.whole else ""
        return f"{self.symbol} = {self.whole or self.own} {self.unit}".rstrip() + alone


def shown_with(result: Fitted, changes: Sequence[Change]) -> dict[str, Shown]:
    """The requested parameters, and k/K that follows from them, by label."""
    symbols, known = _symbols(result), {one.label: one for one in result.parameters.free}
    found, moved = {}, of_inputs(changes)
    for name, value in result.values.items():
        by_level = result.intervals.get(name, {})
        pieces = by_level.get(LEVELS[0], [])
        size, unit = _unit(result, known.get(name))
        own = result.stderrs[name], pieces[0] if len(pieces) == 1 else None
        uneven, whole = _uneven(_sides(value, *own), UNEVEN), ""
        if moved and all(name in one.moves for one in moved):
            both = total(result, name, moved), total_interval(result, name, moved)
            uneven = uneven or _uneven(_sides(value, *both), UNEVEN_TOTAL)
            whole = _with_error(result, name, *both, uneven)
        closed = [piece.high - piece.low for every in by_level.values() for piece in every if not any(piece[2:])]
        digits = value * size, min(closed, default=0.0) * size  # those of the narrowest for all
        intervals = {
            level: " or ".join(interval(_scaled(piece, size), *digits) for piece in every) or "none"
            for level, every in by_level.items()
        }
        found[name] = Shown(symbols.get(name, "k/K"), unit, _with_error(result, name, *own, uneven), whole, intervals)
    return found


def _symbols(result: Fitted) -> dict[str, str]:
    """Short name of each parameter, by label: ``E (block A)`` for ``young[block A, 3e+09]`` where that is unambiguous."""
    long = {one.label: one.symbol + "".join(one.label.partition("[")[1:]) for one in result.parameters.free}
    short = dict(long)
    for one in result.parameters.free:
        if one.nuisance:
            specimen = one.label.partition("[")[2].rpartition(", ")[0]
            short[one.label] = one.symbol + f" ({specimen})" * bool(specimen)
    return {label: name if list(short.values()).count(name) == 1 else long[label] for label, name in short.items()}


def _unit(result: Fitted, one: Free | None) -> tuple[float, str]:
    """Factor and unit with which to show a parameter: that of the table for heights and an offset; none for k/K beside."""
    m = result.measurements
    if one is None or one.unit != "m" or one.name == "correlation_length" or m.correlation_length is None:
        return 1.0, one.unit if one else ""
    return float(m.unit[0][0] / m.correlation_length[0]), m.unit[1]


def _scaled(piece: Interval, size: float) -> Interval:
    return piece._replace(low=piece.low * size, high=piece.high * size)


def _sides(value: float, error: float | None, piece: Interval | None) -> tuple[float, float] | None:
    """Distances of the ends of an interval from the value, over the standard error."""
    return None if error is None or piece is None else ((value - piece.low) / error, (piece.high - value) / error)


def _uneven(sides: tuple[float, float] | None, most: float) -> bool:
    """Whether an interval differs from value ± standard error by more than a part of the error, or stands without one."""
    return sides is None or max(abs(side - 1) for side in sides) > most


def _with_error(result: Fitted, name: str, error: float | None, piece: Interval | None, uneven: bool) -> str:
    """``1.2 ± 0.3``; ``1.2 -0.2 +0.5`` by an uneven 68 % interval; the value alone, or none, where the verdict says so."""
    judged, one = result.verdicts.get(name), next((one for one in result.parameters.free if one.label == name), None)
    size, verdict = _unit(result, one)[0], judged.identifiability if judged else result.identifiability
    value = result.values[name] * size
    if uneven and piece is not None and piece.encloses(result.values[name]) and verdict in GIVEN:
        piece = _scaled(piece, size)
        return value_with_error(value, value - piece.low, piece.high - value)
    if verdict is Identifiability.SEVERAL_ROOTS and judged and not _points(result):
        return WITHOUT_VALUE[Identifiability.EQUAL]
    text = WITHOUT_VALUE.get(verdict) or value_with_error(value, None if error is None else error * size)
    if verdict is not Identifiability.SEVERAL_ROOTS or not judged:
        return text
    alike = sum(root.deviance < result.deviance + ALIKE for root in result.roots)
    return f"{text} ({'one' if alike > 1 else 'best'} of {len(result.roots)})"


def _points(result: Fitted) -> bool:
    """Whether what fits are several points, not ranges of values that fit equally."""
    return len(result.roots) > 1 and any(error is not None for root in result.roots for error in root.stderrs.values())


def html_of(result: Fitted, changes: Sequence[Change]) -> str:
    """Format the result as a table for a notebook: values with errors and intervals, the verdict, the data."""
    rows = [
        (one.symbol, one.whole or one.own, one.own, *(one.intervals.get(level, "") for level in LEVELS), one.unit)
        for one in shown_with(result, changes).values()
    ]
    heads = ("", "with usual errors of inputs", _alone(result), *(f"{level:.0%} interval" for level in LEVELS), "unit")
    m = result.measurements
    said = [result.reason, f"{plural(len(m), 'length')} of {m.source}", _quality(result), "report() says more"]
    return html(f"Result: {result.identifiability.value}", rows, heads, "; ".join(text for text in said if text))


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


def _values(result: Fitted, shown: dict[str, Shown], changes: Sequence[Change]) -> list[str]:
    """Tabulate values with their errors, with those of inputs taken as exact and without; ratios of specimens too."""
    rows = [["", "with usual errors of inputs", _alone(result), "95 % interval" + " (simulated)" * result.calibrated]]
    for one in (shown[name] for name in result.names):
        symbol = one.symbol + f" ({one.unit})" * bool(one.unit)
        rows.append([symbol, one.whole, one.own, one.intervals.get(LEVELS[-1], "none")])
    moved = of_inputs(changes)
    ratios = {labels: found for labels, found in result.stiffness_ratios.items() if found[1] is not None}
    for labels, found in ratios.items():
        if len(ratios) <= MOST_RATIOS or labels[1] == result.names[0]:  # of many specimens, only those to the first
            above, below = (label.partition("[")[2][:-1] for label in labels)
            whole = value_with_error(found[0], total_of_ratio(result, labels, moved)) if moved else ""
            rows.append([f"{above} over {below}", whole, value_with_error(*found), ""])
    kept = [i for i in range(len(rows[0])) if i == 0 or any(row[i] for row in rows[1:])]
    return _aligned([[row[i] for i in kept] for row in rows], str.ljust, indent="")


def _verdicts(result: Fitted) -> Iterator[str]:
    """State the verdicts in words: one where all parameters share it, else each with the parameters that it is on."""
    found, symbols = result.verdicts, _symbols(result)
    kinds = sorted({one.identifiability for one in found.values()}, key=GRAVITY.index)
    for kind in kinds:
        own = [name for name, one in found.items() if one.identifiability is kind]
        reasons = {found[name].reason for name in own} - {""} if kind is not Identifiability.EQUAL else set()
        named = f"{', '.join(symbols[name] for name in own)}: " * (len(kinds) > 1)
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
    with_ = f" and {q.front.lengths_are_of}" * bool(q.front.lengths_are_of)
    tried = result.identifiability in NOTHING_HOLDS
    yield f"{'tried with' if tried else 'holds for'} {body}, with uniform thresholds{with_}"
    for change in changes:
        moves = [by for moves in change.moves.values() for by in moves]
        factors = [math.exp(by) for by in moves if not math.isnan(by)]
        if change.name == "block":
            none = ", or none fits" * (len(factors) < len(moves))
            factor = f"{ends(factors)} times this{none}" if factors else "another"
            yield f"for a real block the stiffness is {factor}, depending on where its side is pushed"
        elif change.name == "push_width":
            suffix = f"_{unit}" * m.in_si
            would = f"the stiffness is about {ends(factors)} times as large" if factors else "no stiffness fits these lengths"
            yield (
                f"guessed: the pusher covers all of the side above push_height{suffix}, as no push_width{suffix} is stated; if "
                f"it is {NARROW_PUSHER}, {would}"
            )
    if q.held:
        yield "held: " + ", ".join(_held(result))


def _quality(result: Fitted) -> str:
    """State what was fitted, how well, and the size of the errors that was used."""
    m, problem, degrees = result.measurements, result.problem, plural(result.dof, "degree")
    specimens = len(set(m.specimen))
    data = f"from {_data(result)} of {Path(m.source).name}" + f" on {specimens} specimens" * (specimens > 1)
    if result.scaled and result.identifiability is Identifiability.NO_SCATTER:
        return f"{data}: no scatter from which to take the size of their errors"
    if result.scaled:
        (scale, unit), scatter = m.unit, result.scatter or 1.0
        size = f": σ = {scatter:.3g} λc" if np.ptp(scale) > 0 else f": σ = {scatter * float(scale[0]):.3g} {unit}"
        size *= m.length_sigma is None  # equal errors of all lengths
        return f"{data}: the size of the errors is taken from the scatter ({degrees} of freedom){size}"
    if result.identifiability is Identifiability.POOR_FIT or (result.p_value is None and not problem.plain):
        return data  # the verdict has the rest; counts and limits that hold cost nothing
    misfit = f"{problem.named_deviance} {format_number(round(result.misfit, 9), 3)}"  # no rounding errors
    if result.p_value is not None:
        degrees = degrees_of_freedom(problem, result.testable_dof)
        p = _probability(result.p_value)
        p = (p.replace("= ", "at most ") if degrees.startswith("at most") else p).replace(" ", TIED)
        tested = f"{misfit}{of_inputs_in_words(problem, result.theta)} for {degrees} ({p})"
    elif result.dof > 0:
        tested = f"{misfit}, {degrees} of freedom"
    else:
        why = "one length cannot test the model" if len(m) == 1 else "the model cannot be tested"
        tested = f"{misfit} with no degree of freedom, so {why}"
    used = "; σ as given" if result.between_contacts is None else "; σ enlarged as remarked below"
    return f"{data}: {tested}{used * bool((m.stated_sigma > 0).any())}"


def _probability(p_value: float) -> str:
    return f"p = {p_value:.2g}".replace("e-0", "e-") if p_value > 1e-300 else "p < 1e-300"


def _roots(result: Fitted) -> list[str]:
    """Tabulate the points that fit, where there are several, with their own errors."""
    if not _points(result):
        return []
    keep = "Points" if len(result.names) > 1 else "Values"
    option = result.measurements.option("--bounds LOW HIGH", "bounds=(low, high)")
    symbols = _symbols(result)
    rows = [[*(symbols[name] for name in result.roots[0].values), "chi-squared" if result.problem.plain else "deviance"]]
    for root in result.roots[:MOST_ROOTS]:
        again = "; edge contact breaks again before the arrest" if root.rebreaks else ""
        values = [value_with_error(value, root.stderrs[name]) for name, value in root.values.items()]
        rows.append([*values, f"+ {max(0.0, root.deviance - result.deviance):.2f}{again}"])
    more = len(result.roots) - MOST_ROOTS
    return [
        f"{keep} that fit (not excluded at 95 %; to keep one, with its errors, give {option})",
        *_aligned(rows, str.ljust),
        *[f"  … and {more} more (FitResult.roots)"] * (more > 0),
    ]


# --- the data, and what else would move the result ------------------------------------------------------------------------


def _table(result: Fitted) -> list[str]:
    """Tabulate the lengths: where, height, measured with the σ used, fitted, and how far that is off."""
    m, (scale, unit), (counted, numbers) = result.measurements, result.measurements.unit, result.measurements.numbered
    known = result.identifiability is not Identifiability.NO_SCATTER  # whether σ has a size
    several, push = len(set(m.specimen)) > 1, m.push_height if result.parameters.front.body == "block" else None
    height = f"H/{unit}" if push is None else f"H, push/{unit}"
    rows = [[counted + ", specimen" * several, height, f"measured/{unit}", f"fitted/{unit}", "(fit-meas)/σ"]]
    for i in range(len(m)):
        pushed = "" if push is None else f", {push[i] * scale[i]:.4g}"
        rows.append(
            [
                f"{numbers[i]} {m.specimen[i]}" if several else str(numbers[i]),
                f"{m.height[i] * scale[i]:.6g}{pushed}",
                _measured(result, i, result.sigma[i] * scale[i] * known),
                f"{result.fitted[i] * scale[i]:.5g}",
                _residual(result, i),
            ]
        )
    return _aligned(rows, str.rjust)


def _measured(result: Fitted, i: int, sigma: float) -> str:
    """``14.03 ± 0.5``, ``> 30``, or ``5 contacts``, in the unit of the table."""
    m, error = result.measurements, f" ± {float(f'{sigma:.2g}'):g}" if sigma > 0 else ""
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
            f"  {one.observable:12s} {plural(len(one.residuals), 'reading')}, "
            f"chi-squared {format_number((one.residuals**2).sum(), 3)}; "
            f"worst at {one.places[worst]}: (fit-meas)/σ = {one.residuals[worst]:+.2f}"
        )
    return rows


def _moving(result: Fitted, changes: Sequence[Change]) -> list[str]:
    """Tabulate what else would move the result, largest first."""
    names = [name for name in result.names if any(name in one.moves for one in changes)]
    if not names:
        return []
    symbols = _symbols(result)
    rows = [["What else would move it", f"{symbols[names[0]]} would be"]]
    if len(names) > 1:
        rows = [["What else would move it, and to what", *(symbols[name] for name in names)]]
    rows += [[f"  {one.what}", *(_effect(result, one, name) for name in names)] for one in changes]
    return _aligned(rows, str.ljust, indent="")


def _effect(result: Fitted, change: Change, name: str) -> str:
    """Where a change moves a parameter: ``+5.0 %``, ``× 0.66, none fits``, ``× 2.5 to 5``."""
    one, moves = result.parameters.named(name), change.moves.get(name, ())
    if not one.log:
        size, unit = _unit(result, one)
        texts = [f"{by * size:+.2g} {unit}".rstrip() if abs(by) > NONE else "0" for by in moves if not math.isnan(by)]
        return ", ".join(texts) or change.otherwise * bool(moves)
    if change.name == "threshold" and moves:  # a range
        return f"× {' to '.join(format_number(math.exp(by), 2) for by in moves)}"
    factors = change.name in ("block", "push_width")  # whatever their size
    return ", ".join(change.otherwise if math.isnan(by) else _times(math.exp(by), factors) for by in moves)


def _times(ratio: float, factor: bool) -> str:
    """``+5.0 %`` or ``× 5.7``."""
    text = f"× {format_number(ratio, 2)}"
    if 1 / MANY < ratio < MANY and not factor:
        text = f"{ratio - 1:+.1%}".replace("%", " %")
    return text[1:] if text[1:] == "0.0 %" else text


# --- details --------------------------------------------------------------------------------------------------------------


def _details(result: Fitted, shown: dict[str, Shown]) -> list[str]:
    """Everything that the result rests on, and intervals at both levels."""
    m, q = result.measurements, result.parameters
    scale, unit = m.unit
    specimens = len(set(m.specimen))
    counted = plural(len(m), "measurement") + f", {plural(specimens, 'specimen')}" * bool(specimens)
    body = "block with a free end" if "log_sites" in q.inputs.more else q.front.body_modelled
    body += " pushed through a spring" * ("log_machine" in q.inputs.more)
    rows = [
        "Details",
        f"  data    {m.source} ({counted})",
        f"  model   {q.front.name}, uniform interface, {body} ({q.front.length_modelled})",
        *_searched(result),
        "  result",
    ]
    for one in shown.values():
        rows.append(f"    {one.symbol} = {one.own} {one.unit}".rstrip())
        for level, text in one.intervals.items():
            rows.append(f"      {level:.0%} interval{' (simulated)' * result.calibrated}  {text}")
    if "stiffness" not in shown:
        rows.append(f"    k/K = {_ratios(result)}")
    rows += [*_inputs(result), *_correlations(result), f"  {_regime(result)}"]
    rows += ["  broken contacts, and the longest length attainable at any stiffness searched:"]
    for i, broken in enumerate(result.contacts_broken):
        rows.append(f"    {m.number(i)}: {broken if broken > 0 else 'all'}, {result.attainable[i] * scale[i]:.5g} {unit}")
    return rows


def _searched(result: Fitted) -> Iterator[str]:
    """State the range searched of each requested parameter, and its prior."""
    q, symbols = result.parameters, _symbols(result)
    stiffest = q.inputs_at(np.array([one.prior_mean if one.nuisance else one.high for one in q.free])).ratio.max()
    for one in q.free:
        if not one.nuisance:
            low, high = (format_number(one.value(x), 2) for x in (one.low, one.high))
            prior = f"; prior {_prior(result, one)}" if math.isfinite(one.prior_sigma) else ""
            top = f" (k/K up to {stiffest:.3g})" if "areal" in one.name else ""
            yield f"  range   {symbols[one.label]} from {low} to {high} {one.unit}".rstrip() + top + prior


def _ratios(result: Fitted) -> str:
    """State the range of k/K, and why it is not one number."""
    q, m = result.parameters, result.measurements
    ratio = ends(q.inputs_at(result.theta).ratio, 4)
    several = sum(one.name in STIFFNESSES for one in q.free) > 1
    differ = [sign for sign, x in (("λc", m.correlation_length), ("E", m.young)) if x is not None and np.ptp(x) > 0]
    why = ["one for each specimen"] * (several or not differ)
    why += [f"as {' and '.join(differ)} differ{'s' * (len(differ) == 1)} between measurements"] * bool(differ)
    return f"{ratio}, {', '.join(why)}" if " to " in ratio else ratio


def _inputs(result: Fitted) -> list[str]:
    """Fitted values of inputs with an error of their own, and their pulls."""
    beside = [(one, float(t)) for one, t in zip(result.parameters.free, result.theta, strict=True) if one.nuisance]
    priors, symbols = (
        [(one.name, one.prior_mean, one.prior_sigma) for one, _ in beside if one.name != "arrest"],
        _symbols(result),
    )
    each = ", inputs separately for each specimen" * (len(set(priors)) < len(priors))
    rows = [f"  also fitted, within their errors{each}:"] * bool(beside)
    for one, t in beside:
        fitted = format_number(one.value(t) * _unit(result, one)[0], 5)
        pull = f"{(t - one.prior_mean) / one.prior_sigma:+.2f} σ"
        rows.append(
            f"    {symbols[one.label]}: stated {_prior(result, one)}, fitted {fitted} ({pull})".replace("-0.00", "+0.00")
        )
    return rows


def _correlations(result: Fitted) -> list[str]:
    """List the strongest with a requested parameter; `FitResult.correlations` has all."""
    symbols, asked = _symbols(result), set(result.names)
    strong = sorted(result.correlations.items(), key=lambda item: -abs(item[1]))
    strong = [(pair, value) for pair, value in strong if abs(value) > CORRELATED and asked & {*pair}]
    rows = [f"    C({symbols[a]}, {symbols[b]}) = {value:+.3f}" for (a, b), value in strong[:MOST_CORRELATIONS]]
    return [f"  correlations above {CORRELATED:g}:", *rows] if rows else []


def _regime(result: Fitted) -> str:
    """State b and where contacts break again, and the slow decay length next to the length of the block."""
    at, front, (scale, unit) = result.regime, result.parameters.front, result.measurements.unit
    decay, shortest = ends(at.slow_decay_length * scale), ends(4 * (at.slow_decay_length * scale))
    if front.body == "block":
        holds = f"so this holds only for blocks longer than 4 times that, {shortest} {unit}"
        return f"Regime: b = {ends(at.b)}; an edge load decays over {decay} {unit}, {holds}"
    again = f" (from {rebreaking_b():.3g} on the edge contact of a tall slider breaks again)" * (front.event != "crack")
    end = f", so this holds only for blocks longer than 4/κ₂ = {shortest} {unit}"
    if result.block_length_over_height is not None:
        end = f"; L/H = {ends(result.block_length_over_height)}"
    return f"Regime: b = {ends(at.b)}{again}; 1/κ₂ = {decay} {unit}{end}"


# --- remarks --------------------------------------------------------------------------------------------------------------


def _mistakes(result: Fitted) -> Iterator[str]:
    return likely_mistakes(result.measurements, prestressed="prestress" in {one.name for one in result.parameters.free})


def notes(result: Fitted) -> Iterator[str]:
    """Remarks to read before using the numbers, most of them about the data."""
    yield from _of_data(result)
    yield from _of_sigma(result)
    yield from _of_pulls(result)
    yield from _of_shape(result)
    yield from _mistakes(result)
    yield from _of_attainable(result)
    yield from _of_model(result)


def _of_data(result: Fitted) -> Iterator[str]:
    m, p = result.measurements, result.problem.p
    if m.other:
        yield f"columns kept but not used: {', '.join(m.other)}"
    kinds = sorted({text for text in m.provenance if text})
    if kinds and kinds != ["measured"]:
        yield f"provenance: {', '.join(kinds)}"
    copies = len(m) - m.distinct
    if copies:
        yield (
            f"{plural(copies, 'measurement')} repeat{'s' * (copies == 1)} another one exactly, and each counts as a "
            "measurement of its own: leave out those that were copied"
        )
    if result.problem.count - copies < p:
        hold = m.option("--fix NAME=VALUE", "fixed={name: value}")
        state = m.option("--prior NAME=MEAN,DEVIATION", "sp.Parameter(name, prior=(mean, deviation))")
        yield (
            f"{plural(p, 'parameter')} are fitted, but only {result.problem.count - copies} of the data are different: hold "
            f"some ({hold}), state what is known of them ({state}), or measure at more heights"
        )
    beside = {one.name for one in result.parameters.free if one.nuisance}
    if "model_factor" in beside:
        shared, held = "a model factor that they share is", {"model_factor": 1}
        if "offset" in beside:
            shared, held = "an offset and a model factor that they share are", {"offset": 0, "model_factor": 1}
        option = m.option(" ".join(f"--fix {name}={value}" for name, value in held.items()), f"fixed={held}".replace("'", '"'))
        yield (
            f"as the lengths were measured, {shared} fitted too ({', '.join(_priors(result, 'offset', 'model_factor'))}); "
            f"{option} leaves the errors of the lengths alone"
        )
    if m.in_si and m.young is None:
        yield "no young_GPa: the data determine the areal stiffness only as its ratio to Young's modulus"


def _of_sigma(result: Fitted) -> Iterator[str]:
    m = result.measurements
    if m.length_sigma is None:
        yield "no standard errors were given: equal errors were assumed, and their size taken from the scatter about the fit"
    elif result.scaled:
        yield f"the stated σ are taken as relative, and scaled by {result.scatter:.3g} to the scatter about the fit"
    if result.p_value is not None and IMPROBABLE <= result.p_value < SCATTERED:
        factor, relative = np.sqrt(result.misfit / (result.testable_dof or 1)), m.option("--sigma relative", 'sigma="relative"')
        taken = f"; {relative} takes its size from the scatter" * result.problem.exact_values
        probability = _probability(result.p_value)
        yield f"the scatter is larger than σ says ({probability}): σ would have to be {factor:.2g} times as large{taken}"
    if result.problem.loss != "normal":
        yield f"loss: {result.problem.loss}; outliers count less than their σ implies"


def _of_pulls(result: Fitted) -> Iterator[str]:
    """Name the inputs that the lengths pull farther from their stated values than chance would.

    The difference between fitted and stated value scatters by √(σ² − s²), with the stated error σ and that of the fit, s.
    """
    if result.covariance is None or result.identifiability not in GIVEN:
        return
    error, symbols, free = np.sqrt(np.diag(result.covariance)), _symbols(result), result.parameters.free
    known = [j for j, one in enumerate(free) if math.isfinite(one.prior_sigma) and one.name != "arrest"]
    pulled: dict[str, list[str]] = {}
    for j in known:
        one = free[j]
        off = float(result.theta[j]) - one.prior_mean
        usual = np.sqrt(max(one.prior_sigma**2 - error[j] ** 2, 1e-12 * one.prior_sigma**2))
        chance = 1 - (1 - 2 * ndtr(-abs(off) / usual)) ** len(known)
        if abs(off) > PULLED * one.prior_sigma and chance < SCATTERED:
            pulled.setdefault(one.name, []).append(f"{symbols[one.label]} by {off / one.prior_sigma:+.2f} σ")
    if not pulled:
        return
    which = ", ".join(text for every in pulled.values() for text in every)
    shared = pulled.keys() & {*OF_MEASURING}
    together = len(set(result.measurements.specimen)) > 1 and any(name in STIFFNESSES for name in result.names)
    checks = ["check the stated value and its error"] * bool(pulled.keys() - shared)
    each = result.measurements.option("--each-specimen stiffness", 'free=[sp.Parameter("stiffness", each="specimen")]')
    checks += [f"the specimens may differ in stiffness ({each})"] * together
    checks += ["the lengths do not vary with the height as the model's do"] * bool(shared)
    yield f"the lengths pull {which}, more than chance would: {'; or '.join(checks)}"


def _of_shape(result: Fitted) -> Iterator[str]:
    """Name the parameters whose 68 % interval differs from value ± standard error."""
    symbols = _symbols(result)
    for name in result.names:
        one, pieces = result.parameters.named(name), result.intervals.get(name, {}).get(LEVELS[0], [])
        by = _sides(result.values[name], result.stderrs[name], pieces[0]) if len(pieces) == 1 else None
        if math.isfinite(one.prior_sigma) or by is None or not _uneven(by, UNEVEN):
            continue  # an input with a stated error, or no difference
        why = "the likelihood is not parabolic"
        if result.calibrated:
            why = "the interval is that of simulated measurements"
        elif result.scatter_dof is not None and max(by) / min(by) < 1 + UNEVEN:
            why = f"the size of σ is known from {plural(result.dof, 'degree')} of freedom only"
        size, unit = _unit(result, one)
        text = f"{interval(_scaled(pieces[0], size), result.values[name] * size)} {unit}".rstrip()
        yield (
            f"{symbols[name]}: the error {_alone(result)} is the 68 % interval, {text}, not ±: {why}, and the interval reaches "
            f"{by[0]:.2f} times ± below the value and {by[1]:.2f} times ± above it"
        )


def _of_attainable(result: Fitted) -> Iterator[str]:
    """Warn of lengths near or above the longest that any stiffness gives."""
    m, attainable, front = result.measurements, result.attainable, result.parameters.front
    if not any(one.name in STIFFNESSES for one in result.parameters.free):
        return
    lowest = np.where(np.array(m.kind) == "whole", m.length - 1, m.length) - np.where(np.isnan(m.sigma), 0, m.sigma)
    above = lowest > attainable
    if above.any():
        i, count = int(np.argmin(attainable / m.length)), int(above.sum())
        reached = "where no domino starts"
        if attainable[i] > 0:
            reached = f"{m.length[i] / attainable[i]:.3g} times the longest attainable, {m.in_its_unit(i, attainable[i])}"
        yield (
            f"{count} length{'s lie' if count > 1 else ' lies'} more than σ above the longest that a stiffness in the range "
            f"searched gives; worst at {m.number(i)}: {m.in_its_unit(i, m.length[i])}, {reached}"
        )
    plateau = ~above & (m.length > PLATEAU * attainable)
    if plateau.any() and front.event != "crack":
        poisson, count = m.poisson[plateau][0], int(plateau.sum())
        ceiling = f" (no first front of a tall slider exceeds {float(length_ceiling(poisson)):.3f} H at ν = {poisson:g})"
        lie, they = ("lie", "they constrain") if count > 1 else ("lies", "it constrains")
        some = f"{count} of {len(m)} lengths {lie}" if len(m) > 1 else "the length lies"
        nearly = f"within {1 - PLATEAU:.0%} of the longest attainable, where {they} stiffness little"
        yield f"{some} {nearly}{ceiling * (front.body == 'slider')}"


def _of_model(result: Fitted) -> Iterator[str]:
    """Say where the search, the definition of a length, the edge contact or the end of a block leave a result uncertain."""
    m, front = result.measurements, result.parameters.front
    if result.between_contacts is not None:
        i = int(np.argmax(result.between_contacts))
        off = m.in_its_unit(i, float(f"{result.between_contacts[i]:.2g}"))
        yield f"{front.uncertain_as} up to {off} ({m.place(i)}), which is added to σ in quadrature"
    if not result.complete and result.problem.p <= SCANNED:
        yield "the range searched was not resolved completely: a minimum elsewhere cannot be excluded; give narrower bounds"
    if front.event == "domino" and any(root.rebreaks for root in result.roots[:1]):
        yield (
            "at the fitted stiffness the contact at the edge would be back at its threshold before the front stops: the length "
            "is that of the first front alone"
        )
    if m.block_length is not None and (short := (ratio := m.block_length / result.regime.slow_decay_length) < END).any():
        yield (
            f"{int(short.sum())} of {len(m)} blocks are shorter than {END:g}/κ₂ (the shortest {np.nanmin(ratio):.2g}/κ₂): the "
            "lengths depend on the far end, which is taken to be free"
        )
