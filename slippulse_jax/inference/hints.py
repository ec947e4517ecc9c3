"""Hints: lengths that no stiffness gives, before a fit, and what to try after one that is rejected."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.inference.likelihood import Problem, make_problem
from slippulse_jax.inference.measurements import Measurements, likely_mistakes
from slippulse_jax.inference.model import longest_length
from slippulse_jax.inference.optimise import minimise
from slippulse_jax.inference.parameters import (
    NOT_OF_BLOCKS,
    STIFFNESSES,
    Body,
    Inputs,
    MeasuredEvent,
    Parameter,
    ParameterSet,
    parameter_set,
    softest,
    stiffest,
)
from slippulse_jax.inference.verdict import GIVEN, IMPROBABLE, PLATEAU, SCATTERED, Identifiability
from slippulse_jax.shown import format_number
from slippulse_jax.theory import length_ceiling

if TYPE_CHECKING:
    from slippulse_jax.inference.result import FitResult

MUCH = 0.2
"""Largest share of χ² per degree of freedom that a hint may leave, if it does not lead to an accepted fit."""
MOST_OUTLIERS = 5
STARTS = 7
MOST_STEPS = 25


def before_fit(
    m: Measurements, event: MeasuredEvent = "domino", body: Body = "slider", *, prestressed: bool = False
) -> Iterator[str]:
    """Warn of likely mistakes, and of lengths near or above the longest that any stiffness gives on a slider."""
    yield from likely_mistakes(m, prestressed=prestressed)
    # unknown before the fit: a friction, the lengths of a block, the errors that measured lengths share
    if event == "crack" or body == "block" or "measured" in m.provenance:
        return
    inputs = Inputs(np.log(m.height), np.zeros(len(m)), m.poisson, m.or_zero("prestress"), m.or_zero("threshold_slope"))
    longest, _ = longest_length(inputs, np.log(softest(m)), np.log(stiffest(m, event)), event)
    yield from of_attainable(m, longest, event)


def of_attainable(
    m: Measurements, attainable: np.ndarray, event: MeasuredEvent = "domino", body: Body = "slider"
) -> Iterator[str]:
    """Warn of lengths near or above the longest that any stiffness gives."""
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
    if plateau.any() and event != "crack":
        poisson = m.poisson[plateau][0]
        ceiling = float(length_ceiling(poisson))
        of_slider = f" (no first front of a tall slider exceeds {ceiling:.3f} H at ν = {poisson:g})" * (body == "slider")
        count = int(plateau.sum())
        lie, they = ("lie", "they constrain") if count > 1 else ("lies", "it constrains")
        some = f"{count} of {len(m)} lengths {lie}" if len(m) > 1 else "the length lies"
        yield f"{some} within {1 - PLATEAU:.0%} of the longest attainable, where {they} stiffness little{of_slider}"


def next_steps(result: "FitResult") -> list[str]:
    """Suggest what to try next, with the option: what the residuals of a rejected fit indicate, or inputs that may be shared.

    Each fit with one freedom more starts from the best fit. It is suggested if the data would then be accepted, or if χ² per
    degree of freedom falls to a fifth; the best first. Where the fit is not rejected but scatters more than σ implies, it is
    suggested if it then no longer does.
    """
    if result.identifiability in GIVEN:
        scattered = result.p_value is not None and result.p_value < SCATTERED and result.problem.plain
        return [*(text for _, text in sorted(_richer(result) if scattered else [])), *_shared(result)]
    at_maximum = result.identifiability is Identifiability.AT_MAXIMUM
    if not at_maximum and result.identifiability is not Identifiability.POOR_FIT:
        return []
    dof = result.testable_dof
    rejected = dof and (result.p_value or 0.0) < IMPROBABLE and result.problem.plain
    steps = [text for _, text in sorted([*_richer(result), *_outliers(result)])] if rejected else []
    if at_maximum:
        steps.append(
            "check the units of heights and lengths, and that the height is the effective one, of the line where the load acts"
        )
    if at_maximum or _trend(result):
        steps += _of_a_block(result)
    if dof and rejected and not steps:
        factor = np.sqrt(result.deviance / dof)
        relative = result.measurements.option("--sigma relative", 'sigma="relative"')
        larger = f"{factor:.2g} times as large"
        steps.append(f"if σ is a guess, it would have to be {larger}; take it from the scatter by {relative}")
    return steps


def _shared(result: "FitResult") -> Iterator[str]:
    """Suggest sharing a material constant whose value and error are stated alike for all specimens."""
    m, found = result.measurements, result.parameters.free
    for name in ("young", "poisson", "correlation_length"):
        each = [one for one in found if one.name == name and one.nuisance]
        value, sigma = getattr(m, name), getattr(m, f"{name}_sigma")
        if len(each) > 1 and np.ptp(value) == 0 and np.ptp(sigma) == 0:
            column, symbol = m.columns.get(f"{name}_sigma", f"{name}_sigma"), each[0].symbol
            mean, deviation = f"{value[0]:.6g}", f"{sigma[0]:.6g}"
            prior = f'sp.Parameter("{name}", prior=({mean}, {deviation}))'
            option = m.option(f"--prior {name}={mean},{deviation}", _as_argument(result.parameters.wanted, prior))
            yield (
                f"each specimen has an error of {symbol} of its own: if one source gives {symbol} of all, they share "
                f"its error: leave {column} out, and give {option}"
            )


def _of_a_block(result: "FitResult") -> list[str]:
    """Suggest a block, where the table says neither at what height its side is pushed nor what a fit of a block refuses."""
    m = result.measurements
    refused = any(getattr(m, name) is not None for name in NOT_OF_BLOCKS) or m.or_zero("threshold_slope").any()
    if m.push_height is not None or refused:
        return []
    unit = f"_{m.unit[1]}" * m.in_si
    return [f"state where the side is pushed, in columns push_height{unit} and push_width{unit}: a block is then fitted"]


def _trend(result: "FitResult") -> str:
    """Describe a trend of the residuals with the height; empty where there is none, or fewer than three heights."""
    height, off = result.measurements.height, result.residuals
    if len(set(height.tolist())) < 3 or np.abs(np.corrcoef(np.log(height), off)[0, 1]) < 0.8:
        return ""
    falls = np.corrcoef(np.log(height), off)[0, 1] < 0
    low, tall = ("long", "short") if falls else ("short", "long")
    return f"the fitted lengths are too {low} on low blocks and too {tall} on tall ones"


def _richer(result: "FitResult") -> Iterator[tuple[float, str]]:
    """χ² per degree of freedom and a hint, for each additional freedom that helps."""
    m, wanted = result.measurements, list(result.parameters.wanted)
    named = {one.name: one for one in wanted}
    stiffness = next((one for one in wanted if one.name in STIFFNESSES and one.value is None and one.each is None), None)
    if stiffness is not None and len(set(m.specimen)) > 1:
        each = [
            Parameter("stiffness", stiffness.bounds, stiffness.prior, "specimen") if one is stiffness else one for one in wanted
        ]
        signs = [set(np.sign(result.residuals[np.array(m.specimen) == one]).tolist()) for one in dict.fromkeys(m.specimen)]
        pattern = "the residuals of each specimen have one sign: " * all(len(one) == 1 for one in signs)
        option = m.option("--each-specimen stiffness", _as_argument(each))
        yield from _helps(result, each, f"{pattern or 'the specimens may differ: '}try one stiffness for each: {option}")
    plain = result.parameters.body == "slider" and not result.parameters.smooth
    if plain and "prestress" not in named and m.prestress is None:
        pattern = f"{_trend(result)}: " * bool(_trend(result))
        more = [*wanted, Parameter("prestress")]
        command = " ".join(f"--free {one.name}" for one in _asked(more))
        option = m.option(command, _as_argument(more))
        yield from _helps(result, more, f"{pattern}try a prestress, the same for all: {option}")


def _asked(wanted: Sequence[Parameter]) -> list[Parameter]:
    """The parameters that the user asked to fit."""
    return [one for one in wanted if one.value is None and not one.nuisance]


def _as_argument(wanted: Sequence[Parameter], *more: str) -> str:
    """Write the argument `free` of a fit of these parameters and `more`."""
    return f"free=[{', '.join([*map(_in_python, _asked(wanted)), *more])}]"


def _in_python(one: Parameter) -> str:
    """Write a parameter in Python."""
    more = [f'each="{one.each}"'] if one.each else []
    more += [
        f"{name}=({given[0]:.6g}, {given[1]:.6g})" for name in ("prior", "bounds") if (given := getattr(one, name)) is not None
    ]
    return f'sp.Parameter("{one.name}", {", ".join(more)})' if more else f'"{one.name}"'


def _helps(result: "FitResult", wanted: list[Parameter], text: str) -> Iterator[tuple[float, str]]:
    """Give the hint if a fit of these parameters is so much better."""
    old = result.parameters
    q = parameter_set(result.measurements, wanted, old.event, old.body)
    problem = make_problem(result.measurements, q, result.problem.loss, result.problem.blocks[0].data.sigma)
    values = dict(zip(old.names, result.theta, strict=True))
    start = np.array([values.get(one.label, values.get(one.label.partition("[")[0], 0.0)) for one in q.free])
    deviance = 2 * float(minimise(problem, _starts(q, start), q.low, q.high, max_steps=MOST_STEPS).value.min())
    yield from _offered(result, deviance, result.problem.p - problem.p, text)


def _starts(q: ParameterSet, start: np.ndarray) -> np.ndarray:
    """Start at the best fit and all over the range of the stiffness: the misfit may have driven it far away."""
    stiff = np.array([one.name in STIFFNESSES for one in q.free])
    spread = q.low + (q.high - q.low) * np.linspace(0.05, 0.95, STARTS)[:, None]
    return np.vstack([start, np.where(stiff, spread, start)])


def _outliers(result: "FitResult") -> Iterator[tuple[float, str]]:
    """Point out a measurement without which the others agree, if there is one."""
    m, problem, q = result.measurements, result.problem, result.parameters
    suspects = np.argsort(-np.abs(result.residuals))[:MOST_OUTLIERS]
    count = len(suspects)
    if len(m) < 4:
        return
    weights = {block.observable: np.ones((count, len(block.measurement))) for block in problem.blocks}
    for lane, i in enumerate(suspects):
        for block in problem.blocks:
            weights[block.observable][lane, block.measurement == i] = 0.0
    values = {block.observable: np.repeat(block.data.value, count, axis=0) for block in problem.blocks}
    without: Problem = problem.with_replicates(values, weights, np.repeat(problem.prior_mean, count, axis=0))
    starts = _starts(q, result.theta)
    lane = np.repeat(np.arange(count), len(starts))
    value = minimise(without, np.tile(starts, (count, 1)), q.low, q.high, lane=lane, max_steps=MOST_STEPS).value
    best = int(np.argmin(value))
    text = (
        f"{m.place(int(suspects[lane[best]]))} is at odds with the others: check it, or let outliers count less: "
        + m.option("--loss student", 'loss="student"')
    )
    yield from _offered(result, 2 * float(value[best]), -1, text)


def _offered(result: "FitResult", deviance: float, more_dof: int, text: str) -> Iterator[tuple[float, str]]:
    """Give the hint with its χ², if that is accepted or much lower."""
    dof = (result.testable_dof or 0) + more_dof
    if dof < 1:
        return
    rejected = (result.p_value or 0.0) < IMPROBABLE
    accepted = chdtrc(dof, deviance) >= (IMPROBABLE if rejected else SCATTERED)
    if accepted or deviance / dof < MUCH * result.deviance / (result.testable_dof or 1):
        yield deviance / dof, f"{text} (chi-squared {format_number(deviance, 3)} for {dof} degree{'s' * (dof > 1)} of freedom)"
