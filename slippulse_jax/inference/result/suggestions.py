"""What to try next: richer models, doubtful data, inputs that are shared.

A richer model is fitted before it is suggested. To first order, without a fit, two of four tables that the tests reject, of
specimens that differ and of one typing error, would have no suggestion but a larger σ.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.base.shown import format_number, plural
from slippulse_jax.inference.model.block import BlockEvent
from slippulse_jax.inference.model.front import IMPROBABLE, SCATTERED
from slippulse_jax.inference.model.models import front_of
from slippulse_jax.inference.parameters import STIFFNESSES, Parameter, parameter_set
from slippulse_jax.inference.result.changes import MOST_STEPS, SCATTER, followed_again, scattered
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.likelihood import make_problem
from slippulse_jax.inference.search.minimise import minimise
from slippulse_jax.inference.table.measurements import Measurements

if TYPE_CHECKING:
    from slippulse_jax.inference.result.result import FitResult


def suggestions(result: "FitResult") -> list[str]:
    """Suggest what to try next, with the option.

    What the residuals of a rejected fit indicate, or inputs that may be shared. Each fit with one freedom more starts from the
    best fit. It is suggested if the data would then be accepted, or if χ² per degree of freedom falls to a fifth; the best
    first. Where the fit is not rejected but scatters more than σ implies, it is suggested if it then no longer does.
    """
    m, dof = result.measurements, result.testable_dof
    p_value = result.p_value if result.problem.plain else None
    if result.given and len(result.given) == len(result.names):
        enough = p_value is None or p_value >= SCATTERED
        return [*_offered(result, () if enough else _richer(result)), *_shared(result)]
    at_maximum = result.identifiability is Identifiability.AT_MAXIMUM
    if not at_maximum and result.identifiability is not Identifiability.POOR_FIT:
        return []
    rejected = p_value is not None and p_value < IMPROBABLE
    steps = _offered(result, [*_richer(result), *_outliers(result)]) if rejected else []
    if at_maximum:
        steps.append(
            "check the units of heights and lengths; the height is the effective one, that of the line where the load acts"
        )
    refused = any(getattr(m, name) is not None for name in BlockEvent.refused) or m.or_zero("threshold_slope").any()
    if (at_maximum or _trend(result)) and m.push_height is None and not refused:
        unit = f"_{m.unit[1]}" * m.in_si
        steps.append(
            f"state where the side is pushed, in columns push_height{unit} and push_width{unit}; a block is then fitted"
        )
    if dof and rejected and not steps:
        larger = f"{np.sqrt(result.misfit / dof):.2g} times as large"
        steps.append(f"σ would have to be {larger}; if it is a guess, take it from the scatter: {size_from_scatter(m)}")
    return steps


def size_from_scatter(m: Measurements) -> str:
    """Option that takes the size of errors from the scatter."""
    if "length" not in front_of(m).observes:
        return m.option("--model-error fitted", 'model_error="fitted"')
    return m.option("--sigma relative", 'sigma="relative"')


def _shared(result: "FitResult") -> Iterator[str]:
    """Suggest sharing a constant that is stated alike for all specimens."""
    m, found = result.measurements, result.parameters.free
    for name in ("young", "poisson", "correlation_length", "push_height"):
        each = [one for one in found if one.name == name and one.nuisance]
        value, sigma = getattr(m, name), getattr(m, f"{name}_sigma")
        at = name == "push_height"
        if len(each) > 1 and (at or (np.ptp(value) == 0 and np.ptp(sigma) == 0)):
            column, symbol = m.heading(f"{name}_sigma"), each[0].symbol
            size = m.correlation_length[0] if at and m.correlation_length is not None else 1.0
            mean, deviation = f"{value[0] * size:.6g}", f"{sigma[0] * size:.6g}"
            prior = f'sp.Parameter("{name}", prior=({mean}, {deviation}))'
            option = m.option(f"--prior {name}={mean},{deviation}", _as_argument(result.parameters.wanted, prior))
            source = "they were measured from one zero" if at else f"one source gives {symbol} of all"
            yield (
                f"each {'push' if at else 'specimen'} has its own error of {symbol}; if {source}, they share that error; "
                f"then leave {column} out, and give {option}"
            )


def _trend(result: "FitResult") -> str:
    """Describe a trend of residuals with three heights or more, if any."""
    height = result.measurements.height
    if len(set(height.tolist())) < 3:
        return ""
    correlation = np.corrcoef(np.log(height), result.residuals)[0, 1]
    low, tall = ("long", "short") if correlation < 0 else ("short", "long")
    return f"the fitted lengths are too {low} on low blocks and too {tall} on tall ones" * bool(np.abs(correlation) >= 0.8)


def _richer(result: "FitResult") -> Iterator[tuple[float, int, str]]:
    """Try one stiffness for each specimen, and a prestress.

    Each with the least deviance, the additional freedoms, and how to fit it.
    """
    m, wanted = result.measurements, list(result.parameters.wanted)
    shared = next((one for one in wanted if one.name in STIFFNESSES and one.value is None and one.each is None), None)
    if shared is not None and len(set(m.specimen)) > 1:
        own = Parameter("stiffness", shared.bounds, shared.prior, "specimen")
        each = [own if one is shared else one for one in wanted]
        signs = [set(np.sign(result.residuals[np.array(m.specimen) == one]).tolist()) for one in dict.fromkeys(m.specimen)]
        one_sign = all(len(one) == 1 for one in signs)
        pattern = "the residuals of each specimen have one sign; " if one_sign else "the specimens may differ; "
        option = m.option("--each-specimen stiffness", _as_argument(each))
        yield *_with(result, each), f"{pattern}try one stiffness for each: {option}"
    if result.problem.alike:
        option = m.option(f"--fix threshold_scatter={SCATTER}", f'fixed={{"threshold_scatter": {SCATTER}}}')
        text = f"thresholds of real contacts scatter; try {100 * SCATTER:.0f} % from contact to contact: {option}"
        yield *_with(result, scattered(wanted, SCATTER)), text
    if result.parameters.front.body == "slider" and m.prestress is None and all(one.name != "prestress" for one in wanted):
        # instead of what contacts keep, as lengths do not tell both
        others = [one for one in wanted if one.name != "residual_strength" or one.value is not None]
        trend, more = _trend(result), [*others, Parameter("prestress")]
        option = m.option(" ".join(f"--free {one.name}" for one in _asked(more)), _as_argument(more))
        yield *_with(result, more), f"{trend}{'; ' * bool(trend)}try a prestress, the same for all: {option}"


def _asked(wanted: Sequence[Parameter]) -> list[Parameter]:
    """The parameters that the user asked to fit."""
    return [one for one in wanted if one.value is None and not one.nuisance]


def _as_argument(wanted: Sequence[Parameter], *more: str) -> str:
    """Write the argument `free` of a fit of these parameters and `more`."""
    return f"free=[{', '.join([*map(_in_python, _asked(wanted)), *more])}]"


def _in_python(one: Parameter) -> str:
    """Write a parameter in Python."""
    more = [f'each="{one.each}"'] * bool(one.each)
    for name, given in (("prior", one.prior), ("bounds", one.bounds)):
        more += [f"{name}=({given[0]:.6g}, {given[1]:.6g})"] if given else []
    return f'sp.Parameter("{one.name}", {", ".join(more)})' if more else f'"{one.name}"'


def _with(result: "FitResult", wanted: list[Parameter]) -> tuple[float, int]:
    """Least deviance with these parameters, and how many more they are."""
    m, front = result.measurements, result.parameters.front
    if result.problem.emulates:
        problem, theta, deviance = followed_again(result, wanted)
        return deviance - problem.perfect(theta), problem.p - result.problem.p
    q = parameter_set(m, wanted, front, result.parameters.observables)
    problem = make_problem(m, q).with_errors(result.sigma)
    ends = minimise(problem, result.starts(q), q.low, q.high, max_steps=MOST_STEPS)
    return 2 * float(ends.value.min()) - problem.perfect(ends.theta[np.argmin(ends.value)]), problem.p - result.problem.p


def _outliers(result: "FitResult") -> Iterator[tuple[float, int, str]]:
    """Try to leave out the measurement that fits worst; as `_richer`."""
    m, problem, q = result.measurements, result.problem, result.parameters
    if len(m) < 4:
        return
    suspects = np.argsort(-np.abs(result.residuals))[:5]
    count = len(suspects)
    kept = [(data.measurement != suspects[:, None]).astype(float) for data in problem.observed]
    every = [(np.repeat(data.value, count, axis=0), weight) for data, weight in zip(problem.observed, kept, strict=True)]
    without = problem.with_replicates(every, np.repeat(problem.prior_mean, count, axis=0))
    starts = result.starts(q)
    lane = np.repeat(np.arange(count), len(starts))
    ends = minimise(without, np.tile(starts, (count, 1)), q.low, q.high, lane=lane, max_steps=MOST_STEPS)
    best = int(np.argmin(ends.value))
    less = "" if problem.emulates else ", or let outliers count less: " + m.option("--loss student", 'loss="student"')
    text = f"{m.place(int(suspects[lane[best]]))} is at odds with the others; check it{less}"
    yield 2 * float(ends.value[best]) - without.perfect(ends.theta[best], int(lane[best])), 1, text


def _offered(result: "FitResult", tried: Iterable[tuple[float, int, str]]) -> list[str]:
    """Suggestions with their χ², the best first.

    If that is accepted, or falls to a fifth per degree of freedom.
    """
    least = IMPROBABLE if (result.p_value or 0.0) < IMPROBABLE else SCATTERED
    most, found = 0.2 * result.misfit / (result.testable_dof or 1), []
    for deviance, more, text in tried:
        dof = (result.testable_dof or 0) - more
        enough = least if more else IMPROBABLE  # where a scatter is held nothing more is fitted, and contacts are not alike
        if dof > 0 and (chdtrc(dof, deviance) >= enough or deviance / dof < most):
            of = f"(chi-squared {format_number(deviance, 3)} for {plural(dof, 'degree')} of freedom)"
            found.append((deviance / dof, f"{text} {of}"))
    return [text for _, text in sorted(found)]
