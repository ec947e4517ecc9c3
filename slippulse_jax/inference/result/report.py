"""Report of a fit as text."""

import itertools
import math
import re
import textwrap
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slippulse_jax.base.shown import AS_GIVEN, TIED, ends, format_number, html, listed, plural, value_with_error
from slippulse_jax.block import USUAL_NORMAL_STIFFNESS
from slippulse_jax.inference.model.front import ENDED, SCATTERED
from slippulse_jax.inference.parameters import STIFFNESSES, USUAL_SCATTER
from slippulse_jax.inference.result.changes import ALIKE, MANY, NARROW_PUSHER, NORMAL, STATED, Change, of_inputs
from slippulse_jax.inference.result.values import Shown, error_source, fitted_beside, with_totals
from slippulse_jax.inference.result.verdict import ANSWERS, FAQ, GRAVITY, Identifiability, whole_events
from slippulse_jax.inference.search.intervals import LEVELS
from slippulse_jax.inference.search.minima import SLACK
from slippulse_jax.inference.table.columns import COLUMNS
from slippulse_jax.theory import rebreaking_b

if TYPE_CHECKING:
    from slippulse_jax.inference.result.result import FitResult

NOTHING_HOLDS = GRAVITY[: 1 + GRAVITY.index(Identifiability.AT_MAXIMUM)]
"""Verdicts that leave nothing to hold for a body."""
CONSTANTS = {
    "young": ("E", 1e-9, " GPa"),
    "poisson": ("ν", 1.0, ""),
    "correlation_length": ("λc", 1e6, " µm"),
    "friction": ("μ", 1.0, ""),
}
"""Constants of the material by column: symbol, factor and unit with which papers state them."""
FEW = 3
"""Data of one observable that are shown one by one."""
FEW_ROWS = 8
"""Rows of a sequence below which the misfit cannot tell whether thresholds scatter."""
MOST_VALUES = 4
"""Most values in the title of a picture."""
CORRELATED, MOST_CORRELATIONS = 0.5, 5
"""Correlation above which one is shown, and how many at most."""
MOST_ROOTS, MOST_RATIOS = 4, 6
"""Most points that fit, and most ratios of stiffnesses between all pairs of specimens, that are listed."""
POWER, DIGITS = re.compile(r"(?<=[\d)])e(-?\d+)(?![\w\]])"), str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
"""A power of ten as the report writes it, ``e10``, and the digits of exponents in a paper."""


def report(result: "FitResult", *, verbose: bool = False) -> str:
    """Format a fit: a box, what would move it, data, remarks.

    `verbose` adds the model, the range searched, all intervals, fitted inputs, correlations, the regime, and contacts broken.
    """
    _, steps = result.totals, result.next_steps  # by refits, before anything is written
    lists = {"What to try next": steps, "Remarks": [note for note in result.notes if note not in result.suspicions]}
    shown = with_totals(result)
    said = [*_sentences(result, shown), *_answered(result)]
    box = [*_values(result, shown), *(line for text in said for line in _folded(text, 110))]
    width = max(map(len, box))
    parts = [
        [f"┌{'─' * (width + 2)}┐", *(f"│ {line:{width}s} │" for line in box), f"└{'─' * (width + 2)}┘"],
        _roots(result, shown),
        _moving(result, shown),
        _aligned(result.main.table(result), str.rjust),
        [*_further(result)],
        *([head, *(f"  - {_prose(line)[:-1]}" for line in lines)] if lines else [] for head, lines in lists.items()),
        _details(result, shown) if verbose else [],
    ]
    return "\n\n".join("\n".join(part) for part in parts if part)


def methods(result: "FitResult") -> str:
    """Write sentences for the methods section of a paper."""
    m, q, shown = result.measurements, result.parameters, with_totals(result)
    scale, unit = m.unit
    heights = ("a height of " if np.ptp(m.height * scale) == 0 else "heights of ") + ends(m.height * scale, AS_GIVEN)
    how = f"by maximum likelihood (slippulse_jax {version('slippulse_jax')})"
    said = [f"We fitted {_data(result)} of {q.front.measured} at {heights} {unit} {how}.", _model(result)]
    fits = ""
    if result.p_value is not None:
        sign, tested = "χ²" if result.problem.plain else "deviance", result.problem.tested(result.p_value, result.testable_dof)
        tested = re.sub(r" ?\((.*)\)", r", \1", tested)
        misfit = "" if result.problem.drawn else f"{sign} = {format_number(result.misfit, 3)}"
        fits = f" ({(misfit + tested).removeprefix(', ')})".replace(TIED, " ")
    given, bare = [shown[name] for name in result.given], ("none", "unbounded")
    told = given or [one for one in map(shown.__getitem__, result.names) if one.intervals.get(LEVELS[-1], "none") not in bare]
    if given:
        said.append(f"We obtain {listed([one.equals(one.whole or one.own) for one in given])}{fits}.")
        fits = ""
    elif not told:
        said.append(f"We obtain no number{fits}.")
    if told:
        said.append(f"The 95 % interval is {listed([one.within(one.wider or one.intervals) for one in told])}{fits}.")
    usual = [re.split(" larger by | smaller by ", COLUMNS[change.name].usual[0]) for change in of_inputs(result.changes)]
    if usual and any(one.wider for one in told):
        which = "Error and interval include" if given else "The interval includes"
        said.append(f"{which} usual errors of {listed([f'{sign} ({by})' for sign, by in usual])}.")
    fitted = dict.fromkeys(f"{one.symbol} = {shown[one.label].prior}" for one in fitted_beside(result))  # what is shared, once
    if fitted and given:
        said.append(f"Also fitted, within their errors: {listed([*fitted])}.")
    if any(one.wider for one in told):
        alone = [one.equals(one.own) for one in told if one.whole]
        values = f"{listed(alone)}, and " if alone else ""
        own = f"the 95 % interval is {listed([one.within(one.intervals) for one in told])}"
        said.append(_sentence(f"{error_source(result)}, {values}{own}"))
    if given:
        said += ["The error of the model is not included."] * all(one.name != "model_factor" for one in q.free)
        said += [_prose(_of_real_block(change)) for change in result.changes if change.name == "block"]
        said += [text for change in result.changes if change.name == "residual_strength" and (text := _of_kept(result, change))]
    if len(result.given) < len(result.names):
        said += map(_sentence, _verdicts(result, shown, reasons=False))
    return POWER.sub(lambda found: f" × 10{found[1].translate(DIGITS)}", " ".join(said)).replace("< 1 × 10", "< 10")


def _of_kept(result: "FitResult", change: Change) -> str:
    """State what contacts that keep more would move beyond its error."""
    would = []
    for name in result.given:
        one, (by,) = result.parameters.named(name), change.moves.get(name, (0.0,))
        error = (result.stderrs[name] or math.inf) / (result.values[name] if one.log else 1.0)
        if math.isnan(by):
            return f"With {change.what} as they break, the model would not describe these data."
        if abs(by) > error:
            moved = f"be {math.exp(by):.3g} times as large" if one.log else f"change by {by:+.2g}"
            would.append(f"{one.symbol or one.name} would {moved}")
    return f"With {change.what} as they break, {listed(would)}." if would else ""


def _model(result: "FitResult") -> str:
    """Name the body and its constants."""
    m, q = result.measurements, result.parameters
    body = "the two-layer slider of Braun and Scheibert (Tribology Letters, 2014)"
    if q.front.body == "block" and m.push_height is not None:
        where = "about" if m.push_width is not None else "above"
        body = f"a block under two-dimensional elasticity, pushed on its side {where} {ends(m.push_height / m.height, 4)} H"
    constants = [(getattr(m, name), *how) for name, how in CONSTANTS.items()]
    stated = [*(f"{sign} = {ends(x * size, AS_GIVEN)}{of}" for x, sign, size, of in constants if x is not None), *_held(result)]
    return f"The model is {body}. We took {listed(stated)}."


def _data(result: "FitResult") -> str:
    """``6 lengths``, ``2 counts and 16 readings``."""
    counts: dict[str, int] = {}
    for one in result.data:
        noun = result.observable(one.observable).noun
        counts[noun] = counts.get(noun, 0) + len(one.value)
    return listed([plural(count, noun) for noun, count in counts.items()])


def _held(result: "FitResult") -> list[str]:
    return [f"{name} = {format_number(value, AS_GIVEN)}" for name, value in result.parameters.held.items()]


def html_of(result: "FitResult") -> str:
    """Format values, intervals and verdict as a table for a notebook."""
    shown, m = with_totals(result), result.measurements
    rows = [
        (one.symbol, one.whole or one.own, *(one.wider.get(level, "") for level in LEVELS))
        + (one.own, *(one.intervals.get(level, "") for level in LEVELS), one.unit)
        for one in map(shown.__getitem__, result.values)
    ]
    levels, alone = [f"{level:.0%} interval" for level in LEVELS], error_source(result)
    heads = (
        "",
        "total error",
        *(f"{level}, total" for level in levels),
        alone,
        *(f"{level}, {alone}" for level in levels),
        "unit",
    )
    below = [result.reason, f"{_data(result)} of {m.source}", _quality(result), "report() says more"]
    return html(f"Result: {result.identifiability.value}", rows, heads, "; ".join(text for text in below if text))


# --- the box ------------------------------------------------------------------------------------------------------------


def _sentences(result: "FitResult", shown: dict[str, Shown]) -> list[str]:
    """State verdict, what to check first, and the body, in paragraphs."""
    verdict = [*_verdicts(result, shown), _quality(result)]
    mistakes = [f"check first: {mistake}" for mistake in result.suspicions]
    paragraphs = verdict, mistakes, _holds_for(result), _of_scatter(result), _as_alike(result, shown)
    return [text for texts in paragraphs if (text := " ".join(map(_prose, texts)))]


def _answered(result: "FitResult") -> list[str]:
    """Name the answers of `FAQ` to verdicts and messages."""
    gravest = sorted({one.identifiability for one in result.verdicts.values()}, key=GRAVITY.index)
    none = any(change.otherwise == "none fits" and np.isnan(change.every).any() for change in result.changes)
    asked = ["check first"] * bool(result.suspicions) + gravest + ["none fits"] * none
    answers = [f"{FAQ}#{ANSWERS[one]}" for one in asked if one in ANSWERS]
    return [f"More: {', '.join(answers)}"] * bool(answers)


def _prose(text: str) -> str:
    """Write clauses, apart by semicolons, as sentences."""
    return " ".join(map(_sentence, text.split("; ")))


def _sentence(text: str) -> str:
    """Begin with a capital, unless with a symbol; end with a stop."""
    first, begun = text.partition(" ")[0], text.rstrip(".")
    if first == "a" or (first[:2].isascii() and first[:2].isalpha() and len(first) > 1 and not {*"_.=("} & {*first}):
        begun = begun[0].upper() + begun[1:]
    return begun + "." * (not begun.endswith("?"))


def _folded(text: str, width: int) -> list[str]:
    """Fold a paragraph into lines, but not at `TIED`."""
    return [line.replace(TIED, " ") for line in textwrap.wrap(text, width, break_on_hyphens=False)]


def _values(result: "FitResult", shown: dict[str, Shown]) -> list[str]:
    """Tabulate values and ratios of specimens, with both errors."""
    level, alone, simulated = LEVELS[-1], error_source(result), " (simulated)" * result.calibrated
    own = "95 %, these only" if any(shown[name].wider for name in result.names) else "95 % interval"
    rows = [["", "total error", "95 %, total", alone, own + simulated]]
    for one in (shown[name] for name in result.names):
        symbol = one.symbol + f" ({one.unit})" * bool(one.unit)
        rows.append([symbol, one.whole, one.wider.get(level, ""), one.own, one.intervals.get(level, "none")])
    added = of_inputs(result.changes)
    ratios = {labels: found for labels, found in result.stiffness_ratios.items() if found[1] is not None}
    for labels, found in ratios.items():
        if len(ratios) <= MOST_RATIOS or labels[1] == result.names[0]:  # of many specimens, only those to the first
            above, below = (label.partition("[")[2][:-1] for label in labels)
            whole = value_with_error(found[0], result.totals_of_ratios[labels]) if added else ""
            rows.append([f"{above} over {below}", whole, "", value_with_error(*found), ""])
    kept = [i for i in range(len(rows[0])) if i == 0 or any(row[i] for row in rows[1:])]
    return _aligned([[row[i] for i in kept] for row in rows], str.ljust, indent="")


def _verdicts(result: "FitResult", shown: dict[str, Shown], *, reasons: bool = True) -> Iterator[str]:
    """State the verdicts in words, each with its parameters if several."""
    found = result.verdicts
    kinds = sorted({one.identifiability for one in found.values()}, key=GRAVITY.index)
    for kind in kinds:
        own = [name for name, one in found.items() if one.identifiability is kind]
        why = {found[name].reason for name in own} - {""} if reasons and kind is not Identifiability.EQUAL else set()
        named = f"{', '.join(shown[name].symbol for name in own)}: " * (len(kinds) > 1)
        yield named + kind.value + (f"; {why.pop()}" if len(why) == 1 else "")


def _holds_for(result: "FitResult") -> Iterator[str]:
    """State the body that the result holds for, guesses and held values."""
    q, m = result.parameters, result.measurements
    scale, unit = m.unit
    longest = format_number(float(f"{4 * np.max(result.regime.slow_decay_length * scale):.2g}"))
    ended, machine = (name in q.inputs.more and bool(np.isfinite(q.inputs.get(name).base).any()) for name in ENDED)
    stated = ["end"] * ended + ["machine"] * machine
    still = "" if machine or "force" in m.push_control else q.front.held
    assumed = [q.front.thresholds, *[q.front.lengths_are_of] * bool(q.front.lengths_are_of)]
    assumed += [f"{still} held still during the event"] * bool(still)
    assumed += [f"{'a' if np.ptp(m.height) == 0 else 'the tallest'} block longer than {longest} {unit}"] * (not ended)
    body = f"{'the model tried is' if result.identifiability in NOTHING_HOLDS else 'assumes'} {q.front.carrier}"
    *others, last = assumed
    listing = ", ".join(others) + "," * (len(others) > 1) + " and " * bool(others) + last
    yield body + f" with the stated {' and '.join(stated)}" * bool(stated) + f": {listing}"
    for change in result.changes:
        every = change.every
        factors = [math.exp(by) for by in every if not math.isnan(by)]
        if change.name == "block":
            yield _of_real_block(change, "the first value" if result.points else "this stiffness")
        elif change.name == "push_width":
            suffix = f"_{unit}" * m.in_si
            would = f"the stiffness is about {ends(factors)} times as large" if factors else "no stiffness fits these lengths"
            yield (
                f"guessed: the pusher covers the whole side above push_height{suffix}, as no push_width{suffix} is stated; if "
                f"it is {NARROW_PUSHER}, {would}"
            )
        elif change.name == "normal_stiffness":
            would = f"the stiffness is {ends(factors)} times this" + ", or none fits" * (len(factors) < len(every))
            yield (
                f"guessed: k_n/k = {USUAL_NORMAL_STIFFNESS:g}, as no normal_stiffness is stated; at {NORMAL[0]:g} or "
                f"{NORMAL[1]:g} {would if factors else 'no stiffness fits'}"
            )
    yield from (f"guessed: {guess}" for guess in q.front.guesses(m))
    if q.held:
        yield "held: " + ", ".join(_held(result))


def _of_scatter(result: "FitResult") -> Iterator[str]:
    """State how contacts are taken to differ, where nobody said."""
    if any(one.name == "threshold_scatter" for one in fitted_beside(result)):
        usual, found = 100 * USUAL_SCATTER[0], 100 * result.inputs["threshold_scatter"]
        off = result.measurements.option("--fix threshold_scatter=0", 'fixed={"threshold_scatter": 0}')
        yield (
            f"thresholds of real contacts are taken to scatter by {usual:.2g} %, within a factor of two; fitted: {found:.2g} % "
            f"({off} takes them as alike)"
        )
    elif doubt := _doubt(result):
        yield doubt


def _doubt(result: "FitResult") -> str:
    """Say whether contacts taken as alike may differ, if that is open."""
    p_value = result.p_value
    if not result.problem.alike or p_value is None or result.identifiability is Identifiability.POOR_FIT:
        return ""
    if p_value < SCATTERED:
        return f"doubtful: of {1 / p_value:.2g} such tables one fits as badly, or thresholds scatter"
    return "so few rows cannot tell whether thresholds scatter" * (len(result.measurements) < FEW_ROWS)


def _as_alike(result: "FitResult", shown: dict[str, Shown]) -> Iterator[str]:
    """State values if contacts were alike, or were not."""
    open_ = bool(_doubt(result))
    for change in (one for one in result.changes if one.what == ALIKE or (open_ and one.name == "threshold_scatter")):
        found = []
        for name, (by, *_) in change.moves.items():
            one, value = shown[name], result.values[name]
            value = value * math.exp(by) if result.parameters.named(name).log else value + by
            found.append(
                f"no {one.symbol} fits" if math.isnan(by) else one.equals(f"{value * one.size:.3g}".replace("e+", "e"))
            )
        yield f"{'if contacts were alike' if change.what == ALIKE else f'with {change.what}'}: {listed(found)}"


def _of_real_block(change: Change, first: str = "this stiffness") -> str:
    """State the stiffness that a real block would need."""
    every = change.every
    factors = [math.exp(by) for by in every if not math.isnan(by)]
    if not change.tried:
        needed = f"{STATED}, would need {ends(factors)} times {first}" if factors else ""
        return needed or f"no stiffness of {STATED}, fits these lengths"
    if not factors:
        return "no stiffness of a real block fits these lengths, wherever its side is pushed"
    where = "pushed low on its side" if all(math.isnan(moves[-1]) for moves in change.moves.values()) else "at some pushes"
    none = f"; {where}, no stiffness fits these lengths" * (len(factors) < len(every))
    return f"a real block would need {ends(factors)} times {first}{none}"


def _quality(result: "FitResult") -> str:
    """State what was fitted, how well, and the errors used."""
    m, problem, degrees = result.measurements, result.problem, plural(result.dof, "degree")
    specimens = len(set(m.specimen))
    data = f"from {_data(result)} of {Path(m.source).name}" + f" on {specimens} specimens" * (specimens > 1)
    if result.scaled and result.identifiability is Identifiability.NO_SCATTER:
        return f"{data}; they have no scatter that gives the size of their errors"
    if result.scaled:
        (scale, unit), scatter = m.unit, result.scatter or 1.0
        size = f"{scatter:.3g} λc" if np.ptp(scale) > 0 else f"{scatter * float(scale[0]):.3g} {unit}"
        size = f"σ = {size}" if m.length_sigma is None else "the size of the errors"  # equal errors of all lengths, or stated
        return f"{data}; the scatter gives {size} ({degrees} of freedom)"
    if result.identifiability is Identifiability.POOR_FIT or (result.p_value is None and not problem.plain):
        return data  # the verdict has the rest; counts and limits that hold cost nothing
    fits = problem.fits(result.theta, result.deviance, result.p_value, result.testable_dof)
    if result.p_value is None and result.dof > 0:
        fits += f", with {degrees} of freedom"
    elif result.p_value is None:
        one = f"one {result.main.noun} cannot test the model"
        why = one if len(m) == 1 else "the model cannot be tested"
        fits += f" with no degree of freedom, so {why}"
    enlarged = problem.emulates or result.between_contacts is not None
    used = ", with σ enlarged (see the remarks)" if enlarged else ", with σ as given"
    used = ", each a draw, with σ as given" if result.parameters.front.drawn else used
    return f"{data}{used * bool((m.stated_sigma > 0).any())}; {fits}"


def title(result: "FitResult", width: int) -> list[str]:
    """Quote the box for a picture, in lines, with the constants."""
    shown, free = with_totals(result), result.parameters
    names = [name for name in result.names if not (free.named(name).name in CONSTANTS and shown[name].prior)] or result.names
    names = [name for name in names if name in result.given]
    more = [f"… and {len(names) - MOST_VALUES} more"] * (len(names) > MOST_VALUES)
    constants = ", ".join(text.replace(" ", TIED) for text in _constants(result, shown))
    text = " ".join([*_sentences(result, shown), constants])
    return [*(shown[name].in_words(result) for name in names[:MOST_VALUES]), *more, *_folded(text, width)]


def _constants(result: "FitResult", shown: dict[str, Shown]) -> Iterator[str]:
    """List E, ν, λc and μ, fitted or stated.

    Those with an error as they are fitted; as stated if there is no sound fit.
    """
    q, covariance = result.parameters, None if result.rejected else result.covariance
    for name, (sign, size, unit) in CONSTANTS.items():
        stated, own = getattr(result.measurements, name), [one for one in q.free if one.name == name]
        if stated is None or not all(shown[one.label].prior for one in own):
            continue  # a parameter without a prior is a result
        if not own:
            yield f"{sign} = {ends(stated * size, AS_GIVEN)}{unit}"
            continue
        theta, error = np.array([(one.prior_mean, one.prior_sigma) for one in own]).T
        if covariance is not None:
            each = [q.index(one.label) for one in own]
            theta, error = result.theta[each], np.sqrt(np.diag(covariance)[each])
        value = own[0].value(theta) * size
        error = error * (value if own[0].log else size)
        text = value_with_error(value[0], error[0]) if len(own) == 1 else f"{ends(value, 3)} ± {error.max():.2g}"
        yield f"{sign} = {text}{unit} ({'stated' if covariance is None else 'fitted'})"


# --- tables ---------------------------------------------------------------------------------------------------------------


def _aligned(rows: list[list[str]], justify: Callable[[str, int], str], indent: str = "  ") -> list[str]:
    """Align the columns of a table."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [indent + "  ".join(map(justify, row, widths)).rstrip() for row in rows]


def _roots(result: "FitResult", shown: dict[str, Shown]) -> list[str]:
    """Tabulate the points that fit, if several, with their own errors."""
    if not result.points:
        return []
    rows = [[*(shown[name].symbol for name in result.roots[0].values), result.problem.named_deviance]]
    for root in result.roots[:MOST_ROOTS]:
        again = "; the edge contact breaks again before the front stops" if root.rebreaks else ""
        values = [value_with_error(value, root.stderrs[name]) for name, value in root.values.items()]
        rows.append([*values, f"{root.deviance - result.deviance:+.2f}{again}"])
    more, m, bounds = len(result.roots) - MOST_ROOTS, result.measurements, _bounds(result)
    keep = "Points" if len(result.names) > 1 else "Values"
    low, high = (re.sub("e[+]?(-?)0?", r"e\1", f"{x:g}") for x in bounds) if bounds else ("LOW", "HIGH")
    option = m.option(f"--bounds {low} {high}", f"bounds=({low.lower()}, {high.lower()})")
    return [
        f"{keep} that fit (not excluded at 95 %)",
        *_aligned(rows, str.ljust),
        *[f"  … and {more} more (FitResult.roots)"] * (more > 0),
        f"  To keep {'the first' if bounds else 'one'}, with its errors: {option}",
        *[f"  {_prose(whole_events(result.measurements))}" for _ in range(any(root.rebreaks for root in result.roots))],
    ]


def _bounds(result: "FitResult") -> tuple[float, float] | None:
    """Round bounds of a stiffness that hold only the first root.

    From four decades below it.
    """
    stiff = [name for name in result.names if result.parameters.named(name).name in STIFFNESSES]
    if len(stiff) != 1:
        return None
    one, curve, j = result.parameters.named(stiff[0]), result.curves[stiff[0]], result.parameters.index(stiff[0])
    first, *others = (root.theta[j] for root in result.roots)
    limits = [max(one.low, math.log(10) * (math.floor(first / math.log(10)) - 4)), one.high]
    for other in others:
        between = (curve.node > min(first, other)) & (curve.node < max(first, other))
        if not between.any():
            return None
        top = curve.node[between][np.argmax(curve.deviance[between])]
        middle = math.log(10) * round((first + other) / 2 / math.log(10))
        high = np.interp([middle, top], curve.node, np.minimum(curve.deviance, result.deviance + 1e6))
        limit = (
            middle
            if min(first, other) < middle < max(first, other) and high[0] > min(high[1], result.deviance + SLACK)
            else top
        )
        limits = [max(limits[0], limit), limits[1]] if other < first else [limits[0], min(limits[1], limit)]
    return tuple(float(f"{one.value(limit):.2g}") for limit in limits)  # pyright: ignore[reportReturnType]


def _moving(result: "FitResult", shown: dict[str, Shown]) -> list[str]:
    """Tabulate what else would move the result, largest first."""
    names = [name for name in result.names if any(name in change.moves for change in result.changes)]
    if not names:
        return []
    symbols = [shown[name].symbol for name in names]
    rows = [["What else would move it, and to what", *symbols]]
    if len(names) == 1:
        rows = [["What else would move it", f"{symbols[0]} would be"]]
    for change in result.changes:
        columns = [[*_cells(result, shown, change, name)] for name in names]
        if not change.tried:
            rows.append([f"  {change.what}", *(", ".join(cells) for cells in columns)])
            continue
        each, hint = zip(change.tried, itertools.zip_longest(*columns, fillvalue=""), strict=True), True
        for cells, same in itertools.groupby(each, key=lambda one: one[1]):
            what = change.what_of([tried for tried, _ in same])
            rows.append([f"  {what if hint else what.partition(' (')[0]}", *cells])
            hint = False  # of the column, said once
    return _aligned(rows, str.ljust, indent="")


def _cells(result: "FitResult", shown: dict[str, Shown], change: Change, name: str) -> Iterator[str]:
    """Each move of a change, remarked on where several fit."""
    for i, by in enumerate(change.moves.get(name, ())):
        several = i < len(change.several) and change.several[i] and not math.isnan(by)
        yield _move(result, shown, change, name, by) + " (one of several)" * several


def _move(result: "FitResult", shown: dict[str, Shown], change: Change, name: str, by: float) -> str:
    """Write a move: ``+5.0 %``, ``× 5.7``, ``-0.12 mm`` or ``none fits``."""
    if math.isnan(by):
        return change.otherwise
    if not result.parameters.named(name).log:
        return f"{by * shown[name].size:+.2g} {shown[name].unit}".rstrip() if abs(by) > 1e-6 else "0"
    ratio = math.exp(by)
    if len(change.moves[name]) > 1 or change.name in ("push_width", "pressure") or not 1 / MANY < ratio < MANY:
        return f"× {format_number(ratio, 2)}"
    text = f"{ratio - 1:+.1%}".replace("%", " %")
    return text[1:] if text[1:] == "0.0 %" else text


def _further(result: "FitResult") -> Iterator[str]:
    """Summarise the data beside the rows.

    Each of few, else their number, fit and the worst.
    """
    if result.further:
        yield "Other data"
    for one in result.further:
        noun, off, m = result.observable(one.observable).named, one.residuals, result.measurements
        if len(off) <= FEW:
            value, sigma, fitted, unit = result.observable(one.observable).shown(m, one)
            for i, place in enumerate(one.places):
                read = value_with_error(value[i], sigma[i])
                yield f"  {noun:12s} {read} {unit}, fitted {fitted[i]:.4g} {unit}; {place}: (fit-meas)/σ = {off[i]:+.2f}"
            continue
        worst = int(np.argmax(np.abs(off)))
        fitted = f"{plural(len(off), 'reading')}, chi-squared {format_number((off**2).sum(), 3)}"
        yield f"  {noun:12s} {fitted}; worst at {one.places[worst]}: (fit-meas)/σ = {off[worst]:+.2f}"


# --- details --------------------------------------------------------------------------------------------------------------


def _details(result: "FitResult", shown: dict[str, Shown]) -> list[str]:
    """Everything that the result rests on, and intervals at both levels."""
    m, q = result.measurements, result.parameters
    scale, unit = m.unit
    specimens = len(set(m.specimen))
    counted = plural(len(m), "measurement") + f", {plural(specimens, 'specimen')}" * bool(specimens)
    ended = "log_sites" in q.inputs.more and q.front.body == "slider"
    body = "block with a free end" if ended else q.front.body_modelled
    driven = "log_machine" in q.inputs.more and bool(np.isfinite(q.inputs.get("log_machine").base).any())
    body += ", through a spring" * (driven and q.front.body == "block")
    body += " pushed through a spring" * (driven and q.front.body == "slider")
    rows = [
        "Details",
        f"  data    {m.source} ({counted})",
        f"  model   {q.front.name}, uniform interface, {body} ({q.front.length_modelled})",
    ]
    stiffest = q.inputs.at(np.array([one.prior_mean if one.nuisance else one.high for one in q.free])).ratio.max()
    for name, one in ((name, q.named(name)) for name in result.names):
        low, high = (format_number(one.value(x), 2) for x in (one.low, one.high))
        top, prior = f" (k/K up to {stiffest:.3g})" * ("areal" in one.name), shown[name].prior
        text = f"{shown[name].symbol} from {low} to {high} {one.unit}".rstrip()
        rows.append(f"  range   {text}{top}{'; prior ' * bool(prior)}{prior}")
    rows.append("  result")
    for one in map(shown.__getitem__, result.values):
        rows.append(f"    {one.symbol} = {one.own} {one.unit}".rstrip())
        simulated = " (simulated)" * result.calibrated
        rows += [f"      {level:.0%} interval{simulated}  {text}" for level, text in one.intervals.items()]
    if "stiffness" not in result.values:
        rows.append(f"    k/K = {_ratios(result)}")
    rows += _inputs(result, shown)
    strong = sorted(result.correlations.items(), key=lambda item: -abs(item[1]))
    strong = [(pair, value) for pair, value in strong if abs(value) > CORRELATED and {*result.names} & {*pair}]
    rows += [f"  correlations above {CORRELATED:g}:"] * bool(strong)
    rows += [f"    C({shown[a].symbol}, {shown[b].symbol}) = {value:+.3f}" for (a, b), value in strong[:MOST_CORRELATIONS]]
    rows += [f"  {line}" for line in _regime(result)]
    return [*rows, *(f"  {line}" for line in result.main.details(result))]


def _ratios(result: "FitResult") -> str:
    """State the range of k/K, and why it is not one number."""
    q, m = result.parameters, result.measurements
    ratio = ends(q.inputs.at(result.theta).ratio, 4)
    several = sum(one.name in STIFFNESSES for one in q.free) > 1
    differ = [sign for sign, x in (("λc", m.correlation_length), ("E", m.young)) if x is not None and np.ptp(x) > 0]
    why = ["one for each specimen"] * (several or not differ)
    why += [f"as {' and '.join(differ)} differ{'s' * (len(differ) == 1)} between measurements"] * bool(differ)
    return f"{ratio}, {', '.join(why)}" if " to " in ratio else ratio


def _inputs(result: "FitResult", shown: dict[str, Shown]) -> list[str]:
    """Fitted values of inputs with errors, and their pulls."""
    priors = [(one.name, one.prior_mean, one.prior_sigma) for one in fitted_beside(result)]
    each = ", inputs separately for each specimen" * (len(set(priors)) < len(priors))
    rows = [f"  also fitted, within their errors{each}:"] * bool(result.inputs)
    for name, value in result.inputs.items():
        one, this = result.parameters.named(name), shown[name]
        pull = f"{(one.theta(value) - one.prior_mean) / one.prior_sigma:+.2f}".replace("-0.00", "+0.00")
        rows.append(f"    {this.symbol}: stated {this.prior}, fitted {format_number(value * this.size, 5)} ({pull} σ)")
    return rows


def _regime(result: "FitResult") -> list[str]:
    """State b, where contacts break again, and the slow decay length."""
    at, front, (scale, unit) = result.regime, result.parameters.front, result.measurements.unit
    decay, shortest = ends(at.slow_decay_length * scale), ends(4 * (at.slow_decay_length * scale))
    if front.body == "block":
        needed = f"blocks must be longer than 4 times that, {shortest} {unit}"
        if result.measurements.block_length is not None:
            needed = f"the blocks are {ends(result.measurements.block_length * scale)} {unit} long"
        return [f"Regime: b = {ends(at.b)}", f"An edge load decays over {decay} {unit}; {needed}"]
    again = f"; from {rebreaking_b():.3g} on, the edge contact of a tall slider breaks again" * (front.event != "crack")
    needed = f"blocks must be longer than 4/κ₂ = {shortest} {unit}"
    if result.block_length_over_height is not None:
        needed = f"L/H = {ends(result.block_length_over_height)}"
    return [f"Regime: b = {ends(at.b)}{again}", f"Decay length 1/κ₂ = {decay} {unit}; {needed}"]
