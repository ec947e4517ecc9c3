"""Changes that would move a fit: usual errors of its inputs, another body, richer models.

An input without a standard error of its own is taken as exact, and a table rarely states everything. What that leaves out is
found by fitting again, near the best fit, with one thing changed for all measurements alike, as by a wrong ruler or modulus.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.inference.columns import IN_LC
from slippulse_jax.inference.fitted import IMPROBABLE, LEVELS, SCATTERED, Fitted, Identifiability
from slippulse_jax.inference.fronts import BlockEvent
from slippulse_jax.inference.interpolation import packaged_b
from slippulse_jax.inference.intervals import Interval
from slippulse_jax.inference.likelihood import Problem, make_problem
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.minimise import minimise
from slippulse_jax.inference.parameters import (
    MODEL_ERROR,
    OF_MEASURING,
    STIFFNESSES,
    Parameter,
    ParameterSet,
    parameter_set,
)
from slippulse_jax.shown import format_number


class Usual(NamedTuple):
    """An input whose error is rarely stated."""

    symbol: str
    error: float  # usual error: of ν itself, else of the logarithm; negative where it is taken smaller
    in_words: str
    both: bool = False  # whether it is taken both ways: no body of other proportions is needed
    of_a_specimen: bool = False  # measured separately on each specimen


USUAL = {
    "height": Usual("H", float(np.log1p(0.01)), "larger by 1 %", of_a_specimen=True),
    "length": Usual("every length", float(np.log1p(0.01)), "larger by 1 %", both=True),
    "young": Usual("E", float(np.log1p(0.05)), "larger by 5 %", both=True),
    "poisson": Usual("ν", -0.02, "smaller by 0.02"),
    "correlation_length": Usual("λc", -float(np.log(2)), "smaller by a factor 2"),
    "push_height": Usual("height of the push", float(np.log1p(0.05)), "larger by 5 %", both=True, of_a_specimen=True),
}
"""By column: a gauge's reading, the scale of a camera, tables of a material. λc is rarely known to better than a factor 2.

Heights are taken larger, ν and λc smaller, so that H/λc does not fall below one."""

SMALL = 0.01
"""Part of a usual error that is tried where the data exclude all of it."""
END, STIFF = 4.0, 10.0
"""Length of a block over 1/κ_2, and stiffness of a machine over that of the block, assumed where the table states none."""
PUSHES = (0.5, 0.25, 0.1)
"""Heights above which a block is assumed to be pushed where the table does not say, over H."""
NARROW, NARROW_PUSHER = 0.1, "0.1 H high"
"""Height over H of a pusher that may cover less than all of the side above, where the table does not say; and in words."""
TALL, HIGHEST = 1e4, 0.55
"""H/λc and highest push over H of the fits with another pusher, which the packaged nodes serve."""
SCATTERING = (0.6, 0.8)
"""Share of the stiffness that thresholds take off which scatter by 5 % between contacts (docs/evidence/scatter.md)."""
STARTS, MOST_STEPS = 9, 25
"""Starts over the range of the stiffness, and steps of each, where the best fit may be far away."""
MANY = 3.0
"""Factor from which on a change counts, and is given, as one instead of in per cent."""
MUCH = 0.2
"""Largest share of χ² per degree of freedom that a richer model may leave, if it does not lead to an accepted fit."""
MOST_OUTLIERS = 5


class Change(NamedTuple):
    """Something that may be otherwise than the fit takes it, and how far it would move each fitted parameter.

    A move is that of the logarithm of a positive parameter, else of the parameter itself; NaN where nothing then fits.
    """

    name: str  # the column, or what else changes
    what: str  # the same in words, with its size
    moves: dict[str, tuple[float, ...]]  # by parameter; several where `what` names several, or a range
    opposite: dict[str, float] = {}  # of an input taken as exact: the moves by the opposite of its usual error
    otherwise: str = "none fits"  # what NaN means

    def both(self, name: str) -> tuple[float, float]:
        """Moves of a parameter by the usual error of an input, and by its opposite."""
        (move,), opposite = self.moves[name], self.opposite[name]
        return (-opposite if math.isnan(move) else move), opposite

    def by(self, name: str) -> float:
        """Mean move of a parameter with the usual error of an input."""
        move, opposite = self.both(name)
        return (move - opposite) / 2


def changes(fitted: Fitted) -> list[Change]:
    """List what would move the parameters that have a value, largest first."""
    if not fitted.given:
        return []
    every = [*_of_inputs(fitted), *_of_ends(fitted), *_of_bodies(fitted)]
    return sorted((one for one in every if one.moves), key=lambda one: -_size(one, fitted))


def _size(change: Change, fitted: Fitted) -> float:
    """Size of the largest move, in the order in which a report has them: per cent, then factors; −1 where none is computed."""
    if change.otherwise == "not computed":
        return -1.0 if change.name == "drive" else math.inf
    sizes = [0.0]
    for name, moves in change.moves.items():
        if any(map(math.isnan, moves)):
            return math.inf
        if fitted.parameters.named(name).log:
            ratios = [math.exp(by) for by in moves]
            sizes += [abs(ratio - 1) if 1 / MANY < ratio < MANY else max(ratio, 1 / ratio) for ratio in ratios]
        else:
            sizes += [abs(by / (fitted.values[name] or 1.0)) for by in moves]
    return max(sizes)


# --- usual errors of inputs -----------------------------------------------------------------------------------------------


def _of_inputs(fitted: Fitted) -> Iterator[Change]:
    """Usual errors of the inputs taken as exact."""
    m, q = fitted.measurements, fitted.parameters
    beside = {one.name for one in q.free}
    beside |= {"length"} if "model_factor" in beside else set()  # which contains a scale of all lengths
    for name, usual in USUAL.items():
        if name in beside or not _taken_as_exact(m, name) or (name == "push_height" and q.front.body == "slider"):
            continue
        moves = _moves(fitted, *_refitted(fitted, _moved(m, name, usual.error), name, usual.error), rejected=True)
        opposite = {one: -by for one, by in moves.items()}
        if np.isnan(list(moves.values())).any():
            allowed = _allowed(fitted, name, usual.error)
            opposite = {one: -float(allowed[q.index(one)]) for one in moves}
        elif usual.both:
            other = _moves(fitted, *_refitted(fitted, _moved(m, name, -usual.error), name, -usual.error), rejected=True)
            opposite = {one: opposite[one] if np.isnan(by) else by for one, by in other.items()}
        counted = " (counts stay as they are)" * (name == "correlation_length" and m.in_si and "whole" in m.kind)
        yield Change(name, f"{usual.symbol} {usual.in_words}{counted}", {one: (by,) for one, by in moves.items()}, opposite)


def _allowed(fitted: Fitted, name: str, error: float) -> np.ndarray:
    """Moves of θ by an input whose usual error the data exclude: by its error in a fit in which it is fitted too.

    To first order, from refits with the input moved a little either way: as the deviance rises by (step/σ)², the data know the
    input to σ, beside what is usual.
    """
    steps = SMALL * error * np.array([-1.0, 1.0])
    (low, below), (high, above) = (_refitted(fitted, _moved(fitted.measurements, name, by), name, by) for by in steps)
    rise = max(below + above - 2 * fitted.deviance, 0.0) / 2 / SMALL**2
    return (high - low) / 2 / SMALL / np.sqrt(1 + rise)


def _moves(fitted: Fitted, theta: np.ndarray, deviance: float, *, rejected: bool = False) -> dict[str, float]:
    """Moves of the parameters that have a value to θ; NaN where its fit is run through or, if that counts, `rejected`."""
    lost = not np.isfinite(deviance) or (rejected and _improbable(fitted, deviance))
    moved = np.full(len(theta), np.nan) if lost else theta - fitted.theta
    return {one: float(moved[fitted.parameters.index(one)]) for one in fitted.given}


def _improbable(fitted: Fitted, deviance: float) -> bool:
    dof = fitted.testable_dof
    return dof is not None and bool(chdtrc(dof, deviance - fitted.problem.perfect) < IMPROBABLE)


def _refitted(fitted: Fitted, m: Measurements, name: str = "", by: float = 0.0, *held: Parameter) -> tuple[np.ndarray, float]:
    """θ of least deviance near the best fit, for other measurements or with more parameters held, and that deviance."""
    sigma, q = fitted.sigma, fitted.parameters
    if name == "correlation_length":
        sigma = np.where(np.array(m.kind) == "whole", sigma, sigma * np.exp(-by))
    other = parameter_set(m, [*q.wanted, *held], q.front.event, q.front.body)
    problem = make_problem(m, other, fitted.problem.loss, sigma)
    found = minimise(problem, fitted.theta[None], other.low, other.high)
    return found.theta[0], 2 * float(found.value[0])


def _taken_as_exact(m: Measurements, name: str) -> bool:
    """Whether the table has this input without an error; counted contacts have no scale of length."""
    if name == "length":
        return set(m.kind) != {"whole"}
    errors = getattr(m, f"{name}_sigma")
    return getattr(m, name) is not None and (errors is None or not np.any(errors))


def _moved(m: Measurements, name: str, by: float) -> Measurements:
    """Measurements with one input larger by `by` throughout; lengths in metres stay the same as λc changes."""
    if name == "poisson":
        return dataclasses.replace(m, poisson=m.poisson + by)
    factor, counted = np.exp(by), np.array(m.kind) == "whole"
    if name == "length":
        return dataclasses.replace(m, length=np.where(counted, m.length, m.length * factor))
    moved = dataclasses.replace(m, **{name: getattr(m, name) * factor})
    if name != "correlation_length":
        return moved
    shorter = _in_larger_units(m, factor)
    for column in ("length", "length_sigma"):
        if column in shorter:
            shorter[column] = np.where(counted, getattr(m, column), shorter[column])
    return dataclasses.replace(moved, **shorter)


def _in_larger_units(m: Measurements, factor: float) -> dict[str, np.ndarray]:
    """Columns in λc, for a λc `factor` times as large."""
    return {name: getattr(m, name) / factor for name in IN_LC if getattr(m, name) is not None}


# --- ends, pushes and bodies ----------------------------------------------------------------------------------------------


def _of_ends(fitted: Fitted) -> Iterator[Change]:
    """An end of the block, a machine that gives way and a model factor, as far as the table states none.

    Ends and machines for lengths of first fronts only: gauges take long to compute again, and whole events are for blocks
    without end. Moves are NaN where such a block would be run through.
    """
    m, at, q = fitted.measurements, fitted.regime, fitted.parameters
    supposed = {
        "block_length": ("a block that ends at 4/κ₂", END * np.maximum(at.slow_decay_length, m.length / 4)),
        "machine_stiffness": (
            "a machine ten times as stiff as the block",
            STIFF * at.edge_stiffness * (1.0 if m.young is None else m.young),
        ),
    }
    for name, (what, size) in supposed.items() if q.front.event == "domino" and m.gauges is None else ():
        if getattr(m, name) is not None or (name == "machine_stiffness" and m.in_si and m.young is None):
            continue
        moves = _moves(fitted, *_refitted(fitted, dataclasses.replace(m, **{name: size})))
        yield Change(name, what, {one: (by,) for one, by in moves.items()}, otherwise="run through")
    scaled = {one.name for one in q.free} | {*q.held}
    if _taken_as_exact(m, "length") and not any(m.provenance) and "model_factor" not in scaled:
        factor = 1 + MODEL_ERROR
        what = f"a model factor of {factor:g}, if the lengths were measured (provenance = measured fits it)"
        moves = _moves(fitted, *_refitted(fitted, m, "", 0.0, Parameter("model_factor", value=factor)))
        yield Change("model_factor", what, {one: (by,) for one, by in moves.items()}, otherwise="run through")
    if q.front.body == "block":
        force = ", or a pusher of which the force is held" * (not m.push_control)
        none = dict.fromkeys(fitted.given, (np.nan,))
        yield Change("drive", f"an end of the block, a machine that gives way{force}", none, otherwise="not computed")


def _of_bodies(fitted: Fitted) -> Iterator[Change]:
    """Another body or push for the same lengths, and thresholds that scatter."""
    m, q = fitted.measurements, fitted.parameters
    stiff, unit = [name for name in fitted.given if q.named(name).name in STIFFNESSES], f"_{m.unit[1]}" * m.in_si
    if not stiff:
        return
    if width_is_unstated(fitted):
        what = f"a pusher {NARROW_PUSHER} (column push_width{unit} states it)"
        yield Change("push_width", what, {name: (by,) for name, by in _narrower(fitted).items() if name in stiff})
    if push_is_unstated(fitted):
        at, moves = _real_blocks(fitted, stiff)
        if moves:
            what = f"a real block, pushed from {', '.join(at)} H up (column push_height{unit} fits one)"
            yield Change("block", what, moves)
        else:
            none = dict.fromkeys(stiff, (np.nan,))
            yield Change("block", f"a real block (column push_height{unit} fits one)", none, otherwise="not computed")
    if q.front.event != "crack":  # not studied for crack-like fronts
        ends = tuple(-math.log1p(-share) for share in SCATTERING)
        what = "thresholds that scatter by 5 % between contacts (found for sliders of b = 0.3 to 3)"
        yield Change("threshold", what, dict.fromkeys(stiff, ends))
    if q.front.body == "block":
        wanted = [one for one in q.wanted if one.name != "push_height"]
        other = parameter_set(m, wanted, "domino", "slider")
        theta, deviance = _anew(fitted, m, other, fitted.sigma)
        known = {one.label: float(t) for one, t in zip(other.free, theta, strict=True)}
        lost = not np.isfinite(deviance) or _improbable(fitted, deviance)
        moves = {name: (np.nan if lost else known[name] - float(fitted.theta[q.index(name)]),) for name in stiff}
        yield Change("slider", "the paper's slider", moves)


def _anew(fitted: Fitted, m: Measurements, q: ParameterSet, sigma: np.ndarray) -> tuple[np.ndarray, float]:
    """θ of least deviance for another body, from starts all over the range of the stiffness, and that deviance."""
    problem = make_problem(m, q, fitted.problem.loss, sigma)
    known = dict(zip(fitted.parameters.names, fitted.theta, strict=True))
    start = np.clip([known.get(one.label, 0.0) for one in q.free], q.low, q.high)
    ends = minimise(problem, _starts(q, start), q.low, q.high)
    best = int(np.argmin(ends.value))
    return ends.theta[best], 2 * float(ends.value[best])


def _starts(q: ParameterSet, start: np.ndarray) -> np.ndarray:
    """Start at a point and all over the range of the stiffness: a misfit may have driven it far away."""
    stiff = np.array([one.name in STIFFNESSES for one in q.free])
    spread = q.low + (q.high - q.low) * np.linspace(0, 1, STARTS + 2)[1:-1, None]
    return np.vstack([start, np.where(stiff, spread, start)])


def _real_blocks(fitted: Fitted, stiff: list[str]) -> tuple[list[str], dict[str, tuple[float, ...]]]:
    """Heights of pushes over H, and the moves to the stiffness of a block so pushed that has the same length.

    For that measurement on which the stiffness acts whose length over H is the median. Empty where the lengths share an offset
    or a model factor, which would take other values in a fit of a block, and where the package has no such blocks.
    """
    m, q = fitted.measurements, fitted.parameters
    if shares_errors(fitted):
        return [], {}
    ratio, moves, known = fitted.fitted / m.height, {}, []
    for name in stiff:
        rows = q.rows_of(q.index(name))
        i = int(rows[np.argsort(ratio[rows])[len(rows) // 2]])
        each = {at: packaged_b(float(ratio[i]), float(m.poisson[i]), at) for at in PUSHES}
        found = {at: b for at, b in each.items() if b is not None}
        if found:
            known = [f"{at:g}" for at in found]
            moves[name] = tuple(float(np.log(b / fitted.regime.b[i])) for b in found.values())
    return known, moves


def _narrower(fitted: Fitted) -> dict[str, float]:
    """Move of each stiffness if the pusher is narrow; NaN where the lengths are then rejected.

    From two fits within the packaged nodes, for which nothing is followed anew: of a tall block, as lengths over H hardly
    depend on λc/H, at ν = 0.3, and pushed from `NARROW` to `HIGHEST` H up.
    """
    m, q = fitted.measurements, fitted.parameters
    assert m.push_height is not None
    taller = float(np.ceil(TALL / m.height.min()))
    changed: dict[str, Any] = _in_larger_units(m, 1 / taller)
    if m.correlation_length is not None:
        changed["correlation_length"] = m.correlation_length / taller
    share = np.clip(m.push_height / m.height, NARROW, HIGHEST)
    changed |= {"push_height": share * changed["height"]}
    changed |= {"poisson": np.full(len(m), 0.3), "poisson_sigma": None}
    wanted = [one for one in q.wanted if one.name not in ("push_height", "poisson")]
    found, deviance, labels = [], 0.0, []
    for width in (None, NARROW * changed["height"]):
        other = dataclasses.replace(m, **changed, push_width=width)
        every = parameter_set(other, wanted, q.front.event, q.front.body)
        theta, deviance = _anew(fitted, other, every, fitted.sigma * taller)
        labels = [one.label for one in every.free if one.name in STIFFNESSES]
        found.append(np.array([theta[every.index(label)] for label in labels]))
    lost = not np.isfinite(deviance) or bool(fitted.testable_dof and chdtrc(fitted.testable_dof, deviance) < IMPROBABLE)
    return dict(zip(labels, (np.full(len(labels), np.nan) if lost else found[1] - found[0]).tolist(), strict=True))


def width_is_unstated(fitted: Fitted) -> bool:
    """Whether a fit of a block on a relaxed interface takes the pusher to cover all of the side above the stated height."""
    m, q = fitted.measurements, fitted.parameters
    return q.front.body == "block" and m.push_width is None and not m.or_zero("prestress").any() and "prestress" not in q.names


def push_is_unstated(fitted: Fitted) -> bool:
    """Whether to compare with blocks: first fronts of a slider on a relaxed interface, whose push is not stated."""
    m, q = fitted.measurements, fitted.parameters
    stiff = any(one.startswith(name) for one in fitted.given for name in STIFFNESSES)
    relaxed = q.front.event == "domino" and not m.or_zero("prestress").any() and "prestress" not in q.names
    return stiff and relaxed and q.front.body == "slider" and m.push_height is None


def shares_errors(fitted: Fitted) -> bool:
    """Whether an offset or a model factor of all lengths is fitted, or held at a value that changes them."""
    q = fitted.parameters
    beside = any(one.name in OF_MEASURING for one in q.free)
    return beside or q.held.get("offset", 0.0) != 0 or q.held.get("model_factor", 1.0) != 1


# --- errors with those of inputs ------------------------------------------------------------------------------------------


def of_inputs(moved: Sequence[Change]) -> list[Change]:
    """The usual errors of inputs among changes."""
    return [one for one in moved if one.opposite]


def total(fitted: Fitted, name: str, moved: Sequence[Change]) -> float | None:
    """Standard error of a parameter, inputs taken as exact included; None where there is none."""
    stderr = fitted.stderrs[name]
    if stderr is None:
        return None
    unit = fitted.values[name] if fitted.parameters.named(name).log else 1.0
    return float(np.hypot(stderr, unit * np.linalg.norm([one.by(name) for one in of_inputs(moved)])))


def total_interval(fitted: Fitted, name: str, moved: Sequence[Change]) -> Interval | None:
    """The 68 % interval of a parameter, each side widened by the errors of the inputs taken as exact.

    In quadrature; of a positive parameter in its logarithm. None where the interval is open or in pieces.
    """
    pieces = fitted.intervals.get(name, {}).get(LEVELS[0], [])
    moves, ways = np.array([one.both(name) for one in of_inputs(moved)]), np.array([-1.0, 1.0])
    by, value = np.linalg.norm([moves.min(axis=1), moves.max(axis=1)], axis=1), fitted.values[name]
    if len(pieces) != 1 or pieces[0].open_low or pieces[0].open_high or not np.isfinite(by + value).all():
        return None
    ends = np.array(pieces[0][:2])
    if fitted.parameters.named(name).log:
        low, high = value * np.exp(ways * np.hypot(np.log(ends / value), by))
    else:
        low, high = value + ways * np.hypot(ends - value, by)
    return Interval(float(low), float(high), False, False)


def total_of_ratio(fitted: Fitted, labels: tuple[str, str], moved: Sequence[Change]) -> float | None:
    """Standard error of the ratio of two stiffnesses, inputs taken as exact included; None where there is none.

    Errors of inputs measured on each specimen are independent; the others move both stiffnesses.
    """
    ratio, error = fitted.stiffness_ratios[labels]
    inputs = of_inputs(moved)
    if error is None or not all(label in one.moves for one in inputs for label in labels):
        return None
    above, below = (np.array([one.by(label) for one in inputs]) for label in labels)
    own = np.array([USUAL[one.name].of_a_specimen for one in inputs], dtype=bool)
    return float(np.hypot(error, ratio * np.linalg.norm(np.where(own, np.hypot(above, below), above - below))))


# --- what to try next -----------------------------------------------------------------------------------------------------


def next_steps(fitted: Fitted) -> list[str]:
    """Suggest what to try next, with the option: what the residuals of a rejected fit indicate, or inputs that may be shared.

    Each fit with one freedom more starts from the best fit. It is suggested if the data would then be accepted, or if χ² per
    degree of freedom falls to a fifth; the best first. Where the fit is not rejected but scatters more than σ implies, it is
    suggested if it then no longer does.
    """
    if fitted.given and len(fitted.given) == len(fitted.names):
        scattered = fitted.p_value is not None and fitted.p_value < SCATTERED and fitted.problem.plain
        return [*(text for _, text in sorted(_richer(fitted) if scattered else [])), *_shared(fitted)]
    at_maximum = fitted.identifiability is Identifiability.AT_MAXIMUM
    if not at_maximum and fitted.identifiability is not Identifiability.POOR_FIT:
        return []
    dof = fitted.testable_dof
    rejected = dof and (fitted.p_value or 0.0) < IMPROBABLE and fitted.problem.plain
    steps = [text for _, text in sorted([*_richer(fitted), *_outliers(fitted)])] if rejected else []
    if at_maximum:
        steps.append(
            "check the units of heights and lengths, and that the height is the effective one, of the line where the load acts"
        )
    if at_maximum or _trend(fitted):
        steps += _of_a_block(fitted)
    if dof and rejected and not steps:
        factor = np.sqrt(fitted.deviance / dof)
        relative = fitted.measurements.option("--sigma relative", 'sigma="relative"')
        larger = f"{factor:.2g} times as large"
        steps.append(f"if σ is a guess, it would have to be {larger}; take it from the scatter by {relative}")
    return steps


def _shared(fitted: Fitted) -> Iterator[str]:
    """Suggest sharing a material constant whose value and error are stated alike for all specimens."""
    m, found = fitted.measurements, fitted.parameters.free
    for name in ("young", "poisson", "correlation_length"):
        each = [one for one in found if one.name == name and one.nuisance]
        value, sigma = getattr(m, name), getattr(m, f"{name}_sigma")
        if len(each) > 1 and np.ptp(value) == 0 and np.ptp(sigma) == 0:
            column, symbol = m.columns.get(f"{name}_sigma", f"{name}_sigma"), each[0].symbol
            mean, deviation = f"{value[0]:.6g}", f"{sigma[0]:.6g}"
            prior = f'sp.Parameter("{name}", prior=({mean}, {deviation}))'
            option = m.option(f"--prior {name}={mean},{deviation}", _as_argument(fitted.parameters.wanted, prior))
            yield (
                f"each specimen has an error of {symbol} of its own: if one source gives {symbol} of all, they share "
                f"its error: leave {column} out, and give {option}"
            )


def _of_a_block(fitted: Fitted) -> list[str]:
    """Suggest a block, where the table says neither at what height its side is pushed nor what a fit of a block refuses."""
    m = fitted.measurements
    refused = any(getattr(m, name) is not None for name in BlockEvent.refused) or m.or_zero("threshold_slope").any()
    if m.push_height is not None or refused:
        return []
    unit = f"_{m.unit[1]}" * m.in_si
    return [f"state where the side is pushed, in columns push_height{unit} and push_width{unit}: a block is then fitted"]


def _trend(fitted: Fitted) -> str:
    """Describe a trend of the residuals with the height; empty where there is none, or fewer than three heights."""
    height, off = fitted.measurements.height, fitted.residuals
    if len(set(height.tolist())) < 3 or np.abs(np.corrcoef(np.log(height), off)[0, 1]) < 0.8:
        return ""
    falls = np.corrcoef(np.log(height), off)[0, 1] < 0
    low, tall = ("long", "short") if falls else ("short", "long")
    return f"the fitted lengths are too {low} on low blocks and too {tall} on tall ones"


def _richer(fitted: Fitted) -> Iterator[tuple[float, str]]:
    """χ² per degree of freedom and a suggestion, for each additional freedom that helps."""
    m, wanted = fitted.measurements, list(fitted.parameters.wanted)
    stiffness = next((one for one in wanted if one.name in STIFFNESSES and one.value is None and one.each is None), None)
    if stiffness is not None and len(set(m.specimen)) > 1:
        each = [
            Parameter("stiffness", stiffness.bounds, stiffness.prior, "specimen") if one is stiffness else one for one in wanted
        ]
        signs = [set(np.sign(fitted.residuals[np.array(m.specimen) == one]).tolist()) for one in dict.fromkeys(m.specimen)]
        pattern = "the residuals of each specimen have one sign: " * all(len(one) == 1 for one in signs)
        option = m.option("--each-specimen stiffness", _as_argument(each))
        yield from _helps(fitted, each, f"{pattern or 'the specimens may differ: '}try one stiffness for each: {option}")
    if fitted.parameters.front.body == "slider" and m.prestress is None and all(one.name != "prestress" for one in wanted):
        pattern = f"{_trend(fitted)}: " * bool(_trend(fitted))
        more = [*wanted, Parameter("prestress")]
        command = " ".join(f"--free {one.name}" for one in _asked(more))
        option = m.option(command, _as_argument(more))
        yield from _helps(fitted, more, f"{pattern}try a prestress, the same for all: {option}")


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


def _helps(fitted: Fitted, wanted: list[Parameter], text: str) -> Iterator[tuple[float, str]]:
    """Give the suggestion if a fit of these parameters is so much better."""
    old = fitted.parameters
    q = parameter_set(fitted.measurements, wanted, old.front.event, old.front.body)
    problem = make_problem(fitted.measurements, q, fitted.problem.loss, fitted.sigma)
    values = dict(zip(old.names, fitted.theta, strict=True))
    start = np.array([values.get(one.label, values.get(one.label.partition("[")[0], 0.0)) for one in q.free])
    deviance = 2 * float(minimise(problem, _starts(q, start), q.low, q.high, max_steps=MOST_STEPS).value.min())
    yield from _offered(fitted, deviance, fitted.problem.p - problem.p, text)


def _outliers(fitted: Fitted) -> Iterator[tuple[float, str]]:
    """Point out a measurement without which the others agree, if there is one."""
    m, problem, q = fitted.measurements, fitted.problem, fitted.parameters
    suspects = np.argsort(-np.abs(fitted.residuals))[:MOST_OUTLIERS]
    count = len(suspects)
    if len(m) < 4:
        return
    weights = {data.observable: np.ones((count, len(data.measurement))) for data in problem.observed}
    for lane, i in enumerate(suspects):
        for data in problem.observed:
            weights[data.observable][lane, data.measurement == i] = 0.0
    values = {data.observable: np.repeat(data.value, count, axis=0) for data in problem.observed}
    without: Problem = problem.with_replicates(values, weights, np.repeat(problem.prior_mean, count, axis=0))
    starts = _starts(q, fitted.theta)
    lane = np.repeat(np.arange(count), len(starts))
    value = minimise(without, np.tile(starts, (count, 1)), q.low, q.high, lane=lane, max_steps=MOST_STEPS).value
    best = int(np.argmin(value))
    text = (
        f"{m.place(int(suspects[lane[best]]))} is at odds with the others: check it, or let outliers count less: "
        + m.option("--loss student", 'loss="student"')
    )
    yield from _offered(fitted, 2 * float(value[best]), -1, text)


def _offered(fitted: Fitted, deviance: float, more_dof: int, text: str) -> Iterator[tuple[float, str]]:
    """Give the suggestion with its χ², if that is accepted or much lower."""
    dof = (fitted.testable_dof or 0) + more_dof
    if dof < 1:
        return
    rejected = (fitted.p_value or 0.0) < IMPROBABLE
    accepted = chdtrc(dof, deviance) >= (IMPROBABLE if rejected else SCATTERED)
    if accepted or deviance / dof < MUCH * fitted.deviance / (fitted.testable_dof or 1):
        yield deviance / dof, f"{text} (chi-squared {format_number(deviance, 3)} for {dof} degree{'s' * (dof > 1)} of freedom)"
