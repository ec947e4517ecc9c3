"""Changes that would move a fit: usual errors of its inputs, another body, richer models.

An input without a standard error of its own is taken as exact, and a table rarely states everything. What that leaves out is
found by fitting again, near the best fit, with one thing changed for all measurements alike, as by a wrong ruler or modulus.
"""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.block import USUAL_NORMAL_STIFFNESS
from slippulse_jax.inference.block_lengths import CLOSE, FAR, UNIT, BlockLengths, b_of_tall, geometry_of
from slippulse_jax.inference.columns import COLUMNS, IN_LC
from slippulse_jax.inference.fitted import IMPROBABLE, LEVELS, SCATTERED, Fitted, Identifiability
from slippulse_jax.inference.fronts import BlockEvent
from slippulse_jax.inference.intervals import Interval
from slippulse_jax.inference.likelihood import Problem, make_problem
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.minimise import minimise
from slippulse_jax.inference.parameters import (
    HEIGHTS,
    MODEL_ERROR,
    OF_MEASURING,
    STIFFNESSES,
    Parameter,
    ParameterSet,
    parameter_set,
)
from slippulse_jax.shown import format_number, plural

USUAL = ("height", "length", "young", "poisson", "correlation_length", "push_height", "friction")
"""Columns with a usual error, in the order in which a paper states them."""
OF_BLOCKS = ("push_height", "friction")
SMALL = 0.01
"""Part of a usual error that is tried where the data exclude all of it."""
END, STIFF = 4.0, 10.0
"""Length of a block over 1/κ_2, and stiffness of a machine over that of the block, assumed where the table states none."""
NARROW, NARROW_PUSHER = 0.1, "0.1 H high"
"""Height over H of a pusher that may cover less than all of the side above, where the table does not say; and in words."""
PRESSED, SCANNED = (0.3, 0.6), 257
"""Friction coefficients tried where a table of a block states none, and stiffnesses at which a length is looked for."""
NORMAL = (1.0, 1.4)
"""k_n/k tried where a table with friction states none."""
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
    found = sorted((one for one in every if one.moves), key=lambda one: -_size(one, fitted))
    if fitted.parameters.front.body == "block":
        force = ", or a pusher of which the force is held" * (not fitted.measurements.push_control)
        end = "an end of the block, " * (fitted.measurements.block_length is None)
        what = f"{end}a machine that gives way{force}"
        found.append(Change("drive", what, dict.fromkeys(fitted.given, (math.nan,)), otherwise="not computed"))
    return found


def _size(change: Change, fitted: Fitted) -> float:
    """Size of the largest move, in the order in which a report has them: none known, factors, then per cent."""
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
    for name in USUAL:
        if name in beside or not _taken_as_exact(m, name) or (name in OF_BLOCKS and q.front.body == "slider"):
            continue
        what, error, *other = COLUMNS[name].usual
        moves = _moves(fitted, _moved(m, name, error), rejected=True)
        opposite = {one: -by for one, (by,) in moves.items()}
        if np.isnan(list(moves.values())).any():
            allowed = _allowed(fitted, name, error)
            opposite = {one: -float(allowed[q.index(one)]) for one in moves}
        elif other:
            back = _moves(fitted, _moved(m, name, *other), rejected=True)
            opposite = {one: opposite[one] if np.isnan(by) else by for one, (by,) in back.items()}
        counted = " (counts stay as they are)" * (name == "correlation_length" and m.in_si and "whole" in m.kind)
        yield Change(name, what + counted, moves, opposite)


def _allowed(fitted: Fitted, name: str, error: float) -> np.ndarray:
    """Moves of θ by an input whose usual error the data exclude: by its error in a fit in which it is fitted too.

    To first order, from refits with the input moved a little either way: as the deviance rises by (step/σ)², the data know the
    input to σ, beside what is usual.
    """
    steps = (-SMALL * error, SMALL * error)
    (low, below), (high, above) = (_refitted(fitted, _moved(fitted.measurements, name, by)) for by in steps)
    rise = max(below + above - 2 * fitted.deviance, 0.0) / 2 / SMALL**2
    return (high - low) / 2 / SMALL / np.sqrt(1 + rise)


def _moves(fitted: Fitted, m: Measurements, *held: Parameter, rejected: bool = False) -> dict[str, tuple[float]]:
    """Moves of the parameters that have a value; NaN where the block is run through or, if that counts, the fit `rejected`."""
    theta, deviance = _refitted(fitted, m, *held)
    lost = _rejected(fitted, deviance) if rejected else not np.isfinite(deviance)
    moved = np.full(len(theta), np.nan) if lost else theta - fitted.theta
    return {one: (float(moved[fitted.parameters.index(one)]),) for one in fitted.given}


def _rejected(fitted: Fitted, deviance: float) -> bool:
    """Whether nothing fits, or so badly that model and σ do not describe the data."""
    dof = fitted.testable_dof
    improbable = dof is not None and chdtrc(dof, deviance - fitted.problem.perfect) < IMPROBABLE
    return bool(improbable or not np.isfinite(deviance))


def _refitted(fitted: Fitted, m: Measurements, *held: Parameter) -> tuple[np.ndarray, float]:
    """θ of least deviance near the best fit, for other measurements or with more parameters held, and that deviance."""
    sigma, q, own = fitted.sigma, fitted.parameters, fitted.measurements.correlation_length
    if m.correlation_length is not None and own is not None:
        sigma = np.where(np.array(m.kind) == "whole", sigma, sigma * (own / m.correlation_length))
    front = q.front if q.front.body == "block" else None  # blocks like the one that was followed
    other = parameter_set(m, [*q.wanted, *held], q.front.event, q.front.body, front=front)
    return _least(fitted, m, other, sigma, fitted.theta[None])


def _least(
    fitted: Fitted, m: Measurements, q: ParameterSet, sigma: np.ndarray, starts: np.ndarray, **options: Any
) -> tuple[np.ndarray, float]:
    """θ of least deviance from some starts, for other measurements or parameters, and that deviance."""
    found = minimise(make_problem(m, q, fitted.problem.loss, sigma), starts, q.low, q.high, **options)
    best = int(np.argmin(found.value))
    return found.theta[best], 2 * float(found.value[best])


def _starts(fitted: Fitted, q: ParameterSet) -> np.ndarray:
    """Start at the best fit and all over the range of the stiffness: a misfit may have driven it far away."""
    known = dict(zip(fitted.parameters.names, fitted.theta, strict=True))
    start = np.array([known.get(one.label, known.get(one.name, 0.0)) for one in q.free])
    stiff = np.array([one.name in STIFFNESSES for one in q.free])
    spread = q.low + (q.high - q.low) * np.linspace(0, 1, STARTS + 2)[1:-1, None]
    return np.vstack([start, np.where(stiff, spread, start)])


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
    changed = {name: getattr(m, name) * factor}
    if name == "correlation_length":
        changed |= _in_larger_units(m, factor)
    for column in {"length", "length_sigma"} & {*changed}:
        changed[column] = np.where(counted, getattr(m, column), changed[column])
    return dataclasses.replace(m, **changed)


def _in_larger_units(m: Measurements, factor: float) -> dict[str, np.ndarray]:
    """Columns in λc, for a λc `factor` times as large."""
    return {name: getattr(m, name) / factor for name in IN_LC if getattr(m, name) is not None}


# --- ends, pushes and bodies ----------------------------------------------------------------------------------------------


def _of_ends(fitted: Fitted) -> Iterator[Change]:
    """An end of the block, a machine that gives way and a model factor, as far as the table states none.

    Ends and machines for lengths of first fronts only: gauges take long to compute again, and whole events are for blocks
    without end.
    """
    m, at, q = fitted.measurements, fitted.regime, fitted.parameters
    young = 1.0 if m.young is None else m.young
    supposed = {
        "block_length": ("a block that ends at 4/κ₂", END * np.maximum(at.slow_decay_length, m.length / 4)),
        "machine_stiffness": ("a machine ten times as stiff as the block", STIFF * at.edge_stiffness * young),
    }
    for name, (what, size) in supposed.items() if q.front.event == "domino" and m.gauges is None else ():
        if getattr(m, name) is not None or (name == "machine_stiffness" and m.in_si and m.young is None):
            continue
        yield Change(name, what, _moves(fitted, dataclasses.replace(m, **{name: size})), otherwise="run through")
    scaled = {one.name for one in q.free} | {*q.held}
    if _taken_as_exact(m, "length") and not any(m.provenance) and "model_factor" not in scaled:
        factor = 1 + MODEL_ERROR
        what = f"a model factor of {factor:g}, if the lengths were measured (provenance = measured fits it)"
        moves = _moves(fitted, m, Parameter("model_factor", value=factor))
        yield Change("model_factor", what, moves, otherwise="run through")


def _of_bodies(fitted: Fitted) -> Iterator[Change]:
    """Another body or push for the same lengths, and thresholds that scatter."""
    m, q = fitted.measurements, fitted.parameters
    stiff, unit = [name for name in fitted.given if q.named(name).name in STIFFNESSES], f"_{m.unit[1]}" * m.in_si
    if not stiff:
        return
    relaxed = not m.or_zero("prestress").any() and "prestress" not in q.names
    if q.front.body == "block" and relaxed and m.push_width is None:  # fitted as if pushed all over the side above the push
        what = f"a pusher {NARROW_PUSHER} (column push_width{unit} states it)"
        yield Change("push_width", what, {name: by for name, by in _narrower(fitted).items() if name in stiff})
    if q.front.body == "slider" and relaxed and m.push_height is None and q.front.event == "domino":
        at, moves = _real_blocks(fitted, stiff)
        pushed = f", pushed from {', '.join(at)} H up" if at else ""
        what = f"a real block{pushed} (column push_height{unit} fits one)"
        none = dict.fromkeys(stiff, (np.nan,))
        yield Change("block", what, moves or none, otherwise="none fits" if moves else "not computed")
    if q.front.body == "block":
        if m.friction is None:
            tried, what = (
                PRESSED,
                f"thresholds that follow the pressure, at μ = {PRESSED[0]:g} or {PRESSED[1]:g} (column friction)",
            )
        else:
            tried, what = (0.0,), "thresholds that do not follow the pressure (μ = 0)"
        i = _median(fitted, q.rows_of(q.index(stiff[0])))
        moves = tuple(_pressed(fitted, i, friction=friction) for friction in tried)
        yield Change("pressure", what, dict.fromkeys(stiff, moves))
        if m.friction is not None and m.normal_stiffness is None:
            what = "k_n/k of {:g} or {:g}, for {:g} (column normal_stiffness states it)".format(*NORMAL, USUAL_NORMAL_STIFFNESS)
            moves = tuple(_pressed(fitted, i, log_normal_stiffness=math.log(ratio)) for ratio in NORMAL)
            yield Change("normal_stiffness", what, dict.fromkeys(stiff, moves))
    if q.front.event != "crack":  # not studied for crack-like fronts
        ends = tuple(-math.log1p(-share) for share in SCATTERING)
        what = "thresholds that scatter by 5 % between contacts (found for sliders of b = 0.3 to 3)"
        yield Change("threshold", what, dict.fromkeys(stiff, ends))
    if q.front.body == "block":
        wanted = [one for one in q.wanted if one.name != "push_height"]
        other = parameter_set(m, wanted, "domino", "slider")
        theta, deviance = _least(fitted, m, other, fitted.sigma, _starts(fitted, other))
        theta = np.full(len(theta), np.nan) if _rejected(fitted, deviance) else theta
        moves = {name: (float(theta[other.index(name)] - fitted.theta[q.index(name)]),) for name in stiff}
        yield Change("slider", "the paper's slider", moves)


def _real_blocks(fitted: Fitted, stiff: list[str]) -> tuple[list[str], dict[str, tuple[float, ...]]]:
    """Heights of pushes over H, and the moves to the stiffness of a block so pushed that has the same length.

    For that measurement on which the stiffness acts whose length over H is the median. Empty where the lengths share an offset
    or a model factor, which would take other values in a fit of a block, and where the package has no such blocks.
    """
    m, q = fitted.measurements, fitted.parameters
    held = q.held.get("offset", 0.0) != 0 or q.held.get("model_factor", 1.0) != 1
    if held or any(one.name in OF_MEASURING for one in q.free):
        return [], {}
    ratio, moves, known = fitted.fitted / m.height, {}, []
    for name in stiff:
        i = _median(fitted, q.rows_of(q.index(name)))
        found = b_of_tall(float(ratio[i]), float(m.poisson[i]))
        known, moves[name] = [*found], tuple(float(np.log(b / fitted.regime.b[i])) for b in found.values())
    return known, moves


def _median(fitted: Fitted, rows: np.ndarray) -> int:
    """Which of some measurements has the median fitted length over the height."""
    ratio = (fitted.fitted / fitted.measurements.height)[rows]
    return int(rows[np.argsort(ratio)[len(rows) // 2]])


def _pressed(fitted: Fitted, i: int, **given: float) -> float:
    """Move of ln k to where one measurement has the same length at another μ, or another ln k_n/k; NaN where none is.

    The nearest such stiffness.
    """
    q, m = fitted.parameters, fitted.measurements
    one = q.inputs_at(fitted.theta).take([i])
    length, normal = q.front.lengths(one), one.get("log_normal_stiffness")
    normal = np.where(np.isinf(normal), math.log(USUAL_NORMAL_STIFFNESS), normal)
    other = one.given(**({"log_normal_stiffness": normal} | {name: np.array([x]) for name, x in given.items()}))
    grid = np.linspace(np.log(q.front.softest(m)[i]), np.log(q.front.stiffest(m)[i]), SCANNED)
    followed = BlockLengths(geometry_of(other), length / np.exp(one.log_height), np.exp(one.log_height))

    def lengths(log_stiffness: np.ndarray) -> np.ndarray:
        return followed(other.take(np.zeros(log_stiffness.size, int))._replace(log_stiffness=log_stiffness))[0]

    off = lengths(grid) - length
    with np.errstate(invalid="ignore"):  # inf − inf
        crossed = np.flatnonzero(np.isfinite(off[:-1] + off[1:]) & (np.sign(off[:-1]) != np.sign(off[1:])))
    found = grid[crossed] + np.diff(grid)[crossed] * off[crossed] / (off[crossed] - off[crossed + 1])
    # between nodes of which one has an event of few breaks, there is none of this length
    if found.size:
        around = found[:, None] + CLOSE * UNIT * np.array([-1, 1])[None]
        found = found[(lengths(around.ravel()).reshape(around.shape) > length / FAR).all(axis=1)]
    return float((found - one.log_stiffness)[np.abs(found - one.log_stiffness).argmin()]) if found.size else math.nan


def _narrower(fitted: Fitted) -> dict[str, tuple[float]]:
    """Move of each stiffness if the pusher is narrow; NaN where the lengths are then rejected."""
    m, q = fitted.measurements, fitted.parameters
    assert m.push_height is not None
    at = np.clip(m.push_height, NARROW * m.height, (1 - NARROW) * m.height)
    other = dataclasses.replace(m, push_height=at, push_width=NARROW * m.height)
    every = parameter_set(other, q.wanted, q.front.event, q.front.body)
    theta, deviance = _least(fitted, other, every, fitted.sigma, _starts(fitted, every))
    moved = np.full(len(theta), np.nan) if _rejected(fitted, deviance) else theta - fitted.theta
    return {one.label: (float(by),) for one, by in zip(every.free, moved, strict=True) if one.name in STIFFNESSES}


# --- errors with those of inputs ------------------------------------------------------------------------------------------


def of_inputs(moved: Sequence[Change]) -> list[Change]:
    """The usual errors of inputs among changes, in the order of `USUAL`."""
    return sorted((one for one in moved if one.opposite), key=lambda one: USUAL.index(one.name))


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
    pieces, one = fitted.intervals.get(name, {}).get(LEVELS[0], []), fitted.parameters.named(name)
    moves, value = np.array([one.both(name) for one in of_inputs(moved)]), fitted.values[name]
    by = np.linalg.norm([moves.min(axis=1), moves.max(axis=1)], axis=1)
    if len(pieces) != 1 or pieces[0].open_low or pieces[0].open_high or not np.isfinite(by + value).all():
        return None
    low, high = (abs(one.theta(end) - one.theta(value)) for end in pieces[0][:2])
    sides = np.hypot([low, high], by)
    return Interval(one.value(one.theta(value) - sides[0]), one.value(one.theta(value) + sides[1]), False, False)


def total_of_ratio(fitted: Fitted, labels: tuple[str, str], moved: Sequence[Change]) -> float | None:
    """Standard error of the ratio of two stiffnesses, inputs taken as exact included; None where there is none.

    Errors of inputs measured on each specimen, its heights, are independent; the others move both stiffnesses.
    """
    ratio, error = fitted.stiffness_ratios[labels]
    inputs = of_inputs(moved)
    if error is None or not all(label in one.moves for one in inputs for label in labels):
        return None
    above, below = (np.array([one.by(label) for one in inputs]) for label in labels)
    own = np.array([one.name in HEIGHTS for one in inputs], dtype=bool)
    return float(np.hypot(error, ratio * np.linalg.norm(np.where(own, np.hypot(above, below), above - below))))


# --- what to try next -----------------------------------------------------------------------------------------------------


def next_steps(fitted: Fitted) -> list[str]:
    """Suggest what to try next, with the option: what the residuals of a rejected fit indicate, or inputs that may be shared.

    Each fit with one freedom more starts from the best fit. It is suggested if the data would then be accepted, or if χ² per
    degree of freedom falls to a fifth; the best first. Where the fit is not rejected but scatters more than σ implies, it is
    suggested if it then no longer does.
    """
    m, dof = fitted.measurements, fitted.testable_dof
    p_value = fitted.p_value if fitted.problem.plain else None
    if fitted.given and len(fitted.given) == len(fitted.names):
        scattered = p_value is not None and p_value < SCATTERED
        return [*_offered(fitted, _richer(fitted) if scattered else ()), *_shared(fitted)]
    at_maximum = fitted.identifiability is Identifiability.AT_MAXIMUM
    if not at_maximum and fitted.identifiability is not Identifiability.POOR_FIT:
        return []
    rejected = p_value is not None and p_value < IMPROBABLE
    steps = _offered(fitted, [*_richer(fitted), *_outliers(fitted)]) if rejected else []
    if at_maximum:
        steps.append(
            "check the units of heights and lengths, and that the height is the effective one, of the line where the load acts"
        )
    refused = any(getattr(m, name) is not None for name in BlockEvent.refused) or m.or_zero("threshold_slope").any()
    if (at_maximum or _trend(fitted)) and m.push_height is None and not refused:
        unit = f"_{m.unit[1]}" * m.in_si
        steps.append(
            f"state where the side is pushed, in columns push_height{unit} and push_width{unit}: a block is then fitted"
        )
    if dof and rejected and not steps:
        larger = f"{np.sqrt(fitted.deviance / dof):.2g} times as large"
        relative = m.option("--sigma relative", 'sigma="relative"')
        steps.append(f"if σ is a guess, it would have to be {larger}; take it from the scatter by {relative}")
    return steps


def _shared(fitted: Fitted) -> Iterator[str]:
    """Suggest sharing a material constant whose value and error are stated alike for all specimens."""
    m, found = fitted.measurements, fitted.parameters.free
    for name in ("young", "poisson", "correlation_length", "push_height"):
        each = [one for one in found if one.name == name and one.nuisance]
        value, sigma = getattr(m, name), getattr(m, f"{name}_sigma")
        at = name == "push_height"
        if len(each) > 1 and (at or (np.ptp(value) == 0 and np.ptp(sigma) == 0)):
            column, symbol = m.columns.get(f"{name}_sigma", f"{name}_sigma"), each[0].symbol
            size = m.correlation_length[0] if at and m.correlation_length is not None else 1.0
            mean, deviation = f"{value[0] * size:.6g}", f"{sigma[0] * size:.6g}"
            prior = f'sp.Parameter("{name}", prior=({mean}, {deviation}))'
            option = m.option(f"--prior {name}={mean},{deviation}", _as_argument(fitted.parameters.wanted, prior))
            source = "they were measured from one zero" if at else f"one source gives {symbol} of all"
            yield (
                f"each {'push' if at else 'specimen'} has an error of {symbol} of its own: if {source}, they share "
                f"its error: leave {column} out, and give {option}"
            )


def _trend(fitted: Fitted) -> str:
    """Describe a trend of the residuals with the height; empty where there is none, or fewer than three heights."""
    height = fitted.measurements.height
    if len(set(height.tolist())) < 3:
        return ""
    correlation = np.corrcoef(np.log(height), fitted.residuals)[0, 1]
    low, tall = ("long", "short") if correlation < 0 else ("short", "long")
    return f"the fitted lengths are too {low} on low blocks and too {tall} on tall ones" * bool(np.abs(correlation) >= 0.8)


def _richer(fitted: Fitted) -> Iterator[tuple[float, int, str]]:
    """Try one stiffness for each specimen, and a prestress: the least deviance, the additional freedoms, and how to fit it."""
    m, wanted = fitted.measurements, list(fitted.parameters.wanted)
    shared = next((one for one in wanted if one.name in STIFFNESSES and one.value is None and one.each is None), None)
    if shared is not None and len(set(m.specimen)) > 1:
        own = Parameter("stiffness", shared.bounds, shared.prior, "specimen")
        each = [own if one is shared else one for one in wanted]
        signs = [set(np.sign(fitted.residuals[np.array(m.specimen) == one]).tolist()) for one in dict.fromkeys(m.specimen)]
        one_sign = all(len(one) == 1 for one in signs)
        pattern = "the residuals of each specimen have one sign: " if one_sign else "the specimens may differ: "
        option = m.option("--each-specimen stiffness", _as_argument(each))
        yield *_with(fitted, each), f"{pattern}try one stiffness for each: {option}"
    if fitted.parameters.front.body == "slider" and m.prestress is None and all(one.name != "prestress" for one in wanted):
        trend, more = _trend(fitted), [*wanted, Parameter("prestress")]
        option = m.option(" ".join(f"--free {one.name}" for one in _asked(more)), _as_argument(more))
        yield *_with(fitted, more), f"{trend}{': ' * bool(trend)}try a prestress, the same for all: {option}"


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


def _with(fitted: Fitted, wanted: list[Parameter]) -> tuple[float, int]:
    """Least deviance of a fit of these parameters, and how many more they are."""
    m, front = fitted.measurements, fitted.parameters.front
    q = parameter_set(m, wanted, front.event, front.body, front=front)
    _, deviance = _least(fitted, m, q, fitted.sigma, _starts(fitted, q), max_steps=MOST_STEPS)
    return deviance, len(q.free) - fitted.problem.p


def _outliers(fitted: Fitted) -> Iterator[tuple[float, int, str]]:
    """Try to leave one measurement out, that without which the deviance is least; as `_richer`."""
    m, problem, q = fitted.measurements, fitted.problem, fitted.parameters
    if len(m) < 4:
        return
    suspects = np.argsort(-np.abs(fitted.residuals))[:MOST_OUTLIERS]
    count = len(suspects)
    weights = {data.observable: (data.measurement != suspects[:, None]).astype(float) for data in problem.observed}
    values = {data.observable: np.repeat(data.value, count, axis=0) for data in problem.observed}
    without: Problem = problem.with_replicates(values, weights, np.repeat(problem.prior_mean, count, axis=0))
    starts = _starts(fitted, q)
    lane = np.repeat(np.arange(count), len(starts))
    value = minimise(without, np.tile(starts, (count, 1)), q.low, q.high, lane=lane, max_steps=MOST_STEPS).value
    best = int(np.argmin(value))
    less = m.option("--loss student", 'loss="student"')
    text = f"{m.place(int(suspects[lane[best]]))} is at odds with the others: check it, or let outliers count less: {less}"
    yield 2 * float(value[best]), 1, text


def _offered(fitted: Fitted, tried: Iterable[tuple[float, int, str]]) -> list[str]:
    """Suggestions with their χ², if that is accepted or much lower per degree of freedom; the best first."""
    least = IMPROBABLE if (fitted.p_value or 0.0) < IMPROBABLE else SCATTERED
    most, found = MUCH * fitted.deviance / (fitted.testable_dof or 1), []
    for deviance, more, text in tried:
        dof = (fitted.testable_dof or 0) - more
        if dof > 0 and (chdtrc(dof, deviance) >= least or deviance / dof < most):
            of = f"(chi-squared {format_number(deviance, 3)} for {plural(dof, 'degree')} of freedom)"
            found.append((deviance / dof, f"{text} {of}"))
    return [text for _, text in sorted(found)]
