"""Changes that would move a fit: inputs, bodies, richer models.

An input without a standard error of its own is taken as exact, and a table rarely states everything. What that leaves out is
found by fitting again with one thing changed for all measurements alike: near the fit where it is a usual error, as of a wrong
ruler or modulus; else over the whole range, as `fit` does with the changed table.
"""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import chdtrc, ndtri

from slippulse_jax.base.shown import either, ends
from slippulse_jax.base.status import NotConverged
from slippulse_jax.block import USUAL_NORMAL_STIFFNESS
from slippulse_jax.inference.model.block import BlockEvent
from slippulse_jax.inference.model.emulator import Points
from slippulse_jax.inference.model.front import IMPROBABLE, Front
from slippulse_jax.inference.model.models import front_for, front_of
from slippulse_jax.inference.model.scattered import HALF, visible
from slippulse_jax.inference.parameters import (
    HEIGHTS,
    MODEL_ERROR,
    PARAMETERS,
    STIFFNESSES,
    Parameter,
    parameter_set,
)
from slippulse_jax.inference.search.intervals import LEVELS, Interval, Intervals
from slippulse_jax.inference.search.learning import about, followed, learnt, model_error_of, single, with_model_error
from slippulse_jax.inference.search.likelihood import Problem, make_problem
from slippulse_jax.inference.search.minima import DevianceGrid, between_contacts, first_look, ordered, search
from slippulse_jax.inference.search.minimise import minimise
from slippulse_jax.inference.table.columns import COLUMNS, IN_LC, NUMERIC
from slippulse_jax.inference.table.measurements import Measurements

if TYPE_CHECKING:
    from slippulse_jax.inference.result.result import FitResult

USUAL = ("height", "length", "young", "poisson", "correlation_length", "push_height", "friction", "force", "normal_load")
"""Columns with a usual error, in the order in which a paper states them."""
OF_DATA = ("force", "normal_load", "force_offset")
"""Of these what changes the data, and no series."""
SMALL = 0.01
"""Part of a usual error that is tried where the data exclude all of it."""
END, MACHINES = 4.0, (1.0, 1 / 3)
"""Length of a block over 1/κ_2, and stiffnesses of a machine over that of the block, tried where the table states none."""
PUSHES = (0.5, 0.25, 0.1, 0.05)
"""Heights over H of the lower end of a pusher that are tried on a real block; published ones are below 0.07."""
NARROW, NARROW_PUSHER = 0.1, "0.1 H high"
"""Height over H of a pusher that may cover less than all of the side above, where the table does not say; and in words."""
PRESSED, NORMAL = (0.3, 0.6), (1.0, 1.4)
"""Friction coefficients tried where a table of a block states none, and k_n/k where one with friction states none."""
SPRUNG = f"k_n/k = 1 or 1.4, not {USUAL_NORMAL_STIFFNESS:g} (column normal_stiffness)", *(f"{ratio:g}" for ratio in NORMAL)
"""How the report calls these k_n/k."""
SCATTER, MOST_SCATTER, ALIKE = 0.05, 0.29, "contacts that are alike"
"""How thresholds of contacts are tried to scatter; twice what is held, if more, and at most this."""
KEPT = 0.1
"""Share of their strength that contacts are tried to keep, beyond what is stated or held."""
SERIES = 16
"""Series near a fit of sequences, over which what a change does to them is averaged."""
MOST_STEPS = 25
"""Steps of every start of another fit."""
MOST_CONTACTS = 5e4
"""Contacts of the longest front, above which ends and machines, which are followed break by break, are not tried."""
STATED = "the block, pushed as the table states"
MANY = 3.0
"""Factor from which on a change counts, and is given, as one instead of in per cent."""


class Change(NamedTuple):
    """Something that may be otherwise, and how far parameters would move.

    A move is that of the logarithm of a positive parameter, else of the parameter itself; NaN where nothing then fits.
    """

    name: str  # the column, or what else changes
    what: str  # the same in words, with its size
    moves: dict[str, tuple[float, ...]]  # by parameter; several where `what` names several, or a range
    opposite: dict[str, float] = {}  # of an input taken as exact: the moves by the opposite of its usual error
    otherwise: str = "none fits"  # what NaN means
    several: tuple[bool, ...] = ()  # which of the moves are by a fit with more than one value, of which this is the first
    tried: tuple[str, ...] = ()  # what each move is of, in the words of `what`; empty where `what` is one thing

    @property
    def every(self) -> list[float]:
        """All moves of all parameters."""
        return [by for moves in self.moves.values() for by in moves]

    def what_of(self, tried: Sequence[str]) -> str:
        """`what` of some of those tried only."""
        return self.what.replace(either(self.tried), either(tried))

    def both(self, name: str) -> tuple[float, float]:
        """Moves of a parameter by a usual error and its opposite."""
        (move,), opposite = self.moves[name], self.opposite[name]
        return (-opposite if math.isnan(move) else move), opposite

    def by(self, name: str) -> float:
        """Mean move of a parameter with the usual error of an input."""
        move, opposite = self.both(name)
        return (move - opposite) / 2


def find_changes(result: "FitResult") -> list[Change]:
    """List what would move the parameters, largest first."""
    if not result.moved:
        return []
    if result.parameters.front.drawn:
        every = [*_of_draws(result)]
    elif result.problem.emulates:
        every = [*_of_sequence(result)]
    else:
        every = [*_of_inputs(result), *_of_ends(result), *_of_bodies(result), *_of_contacts(result)]
    return sorted((one for one in every if one.moves), key=lambda one: -_size(one, result))


def _of_sequence(result: "FitResult") -> Iterator[Change]:
    """Usual errors of the inputs of sequences, and other contacts.

    Thresholds that scatter by a refit, the others to first order.
    """
    m, q = result.measurements, result.parameters
    beside, force = {one.name for one in q.free} | {*q.held}, m.or_zero("force")
    inputs = [name for name in ("height", "young", "poisson", "push_height", "normal_load") if _taken_as_exact(m, name)]
    of_inputs = [(name, *COLUMNS[name].usual[:2]) for name in ("force", *inputs) if name not in beside]
    rows = {name: (what, [_moved(m, name, error)]) for name, what, error in of_inputs}
    rows["block_length"] = "a block longer by 1 %", [_moved(m, "block_length", math.log(1.01))]
    if m.normal_stiffness is None:
        rows["normal_stiffness"] = SPRUNG[0], [dataclasses.replace(m, normal_stiffness=np.full(len(m), x)) for x in NORMAL]
    if "force_offset" not in beside:
        off = 0.01 * force.max()
        largest = None if m.largest_force is None else m.largest_force + off
        zero = dataclasses.replace(m, force=force + off, largest_force=largest)
        rows["force_offset"] = "zero of the load cell off by 1 % of the largest force", [zero]
    for name, moves in _shifted(result, {name: tables for name, (_, tables) in rows.items()}).items():
        opposite = {one: -by[0] for one, by in moves.items()} if name in USUAL else {}
        yield Change(name, rows[name][0], moves, opposite, tried=SPRUNG[1:] if len(rows[name][1]) > 1 else ())
    scatter = min(max(SCATTER, 2 * math.exp(q.inputs.at(result.theta).get("log_scatter")[0])), MOST_SCATTER)
    scatter = 0.0 if "threshold_scatter" in q.names else scatter
    what = f"thresholds that scatter by {100 * scatter:.2g} % from contact to contact" if scatter else ALIKE
    yield _followed(result, "threshold_scatter", what, scattered(q.wanted, scatter))
    if (more := _keeping_more(result)) is not None:
        yield _followed(result, "residual_strength", *more)


def _of_draws(result: "FitResult") -> Iterator[Change]:
    """What may be noticed, and contacts that are alike; by fits again."""
    m, q = result.measurements, result.parameters
    moves: dict[str, tuple[float, ...]] = dict.fromkeys(result.moved, ())
    tried = "half", "twice"
    for factor in (1 / HALF, HALF):
        other = dataclasses.replace(m, visible=factor * visible(m))
        problem = learnt(make_problem(other, parameter_set(other, q.wanted, q.front, q.observables)), result.request["seed"])
        theta = search(problem, method="lm", max_steps=MOST_STEPS, seed=0).theta
        if ((np.array(m.kind) == "length") & (m.length < visible(other))).any():  # which were seen
            theta = np.full(len(theta), np.nan)
        moves = {one: (*by, float(theta[q.index(one)] - result.theta[q.index(one)])) for one, by in moves.items()}
    yield Change("visible", f"events that would be noticed from {either(tried)} of that extent on", moves, tried=tried)
    wanted = [one for one in q.wanted if one.name != "threshold_scatter"]
    stiff = [name for name in result.moved if q.named(name).name in STIFFNESSES]
    if q.front.body == "slider" and stiff:
        front = front_for("slider", "full", m)
        yield _again(result, "threshold_scatter", ALIKE, [m], stiff, wanted=wanted, front=front)


def _keeping_more(result: "FitResult") -> tuple[str, list[Parameter], Measurements] | None:
    """Contacts that keep more of their strength: in words, parameters, table.

    None where that is fitted, or no part of the model.
    """
    m, q = result.measurements, result.parameters
    sloping = m.or_zero("threshold_slope").any() or "threshold_slope" in {*q.names, *q.held}
    if sloping or "residual_strength" in q.names or "residual_strength" not in q.front.inputs:
        return None
    kept = np.minimum(q.held.get("residual_strength", m.or_zero("residual_strength")) + np.full(len(m), KEPT), 0.99)
    what = f"contacts that keep {ends(np.round(100 * kept, 3))} % of their strength"
    wanted = [one for one in q.wanted if one.name != "residual_strength"]
    return what, wanted, dataclasses.replace(m, residual_strength=kept)


def _followed(result: "FitResult", name: str, what: str, wanted: Sequence[Parameter], m: Measurements | None = None) -> Change:
    """Fit sequences again, over the whole range."""
    problem, theta, deviance = followed_again(result, wanted, m)
    found = theta if problem.accepts(theta, deviance) else np.full(len(theta), np.nan)
    index, before = problem.parameters.index, result.parameters.index
    return Change(name, what, {one: (float(found[index(one)] - result.theta[before(one)]),) for one in result.moved})


def scattered(wanted: Iterable[Parameter], scatter: float) -> list[Parameter]:
    """These parameters, with thresholds that scatter."""
    return [*(one for one in wanted if one.name != "threshold_scatter"), Parameter("threshold_scatter", value=float(scatter))]


def followed_again(
    result: "FitResult", wanted: Sequence[Parameter], m: Measurements | None = None
) -> tuple[Problem, np.ndarray, float]:
    """Fit sequences with other parameters: the problem, θ, and its deviance."""
    m, error = result.measurements if m is None else m, result.request.get("model_error")
    problem = make_problem(m, parameter_set(m, wanted, observables=result.parameters.observables))
    problem = learnt(problem, result.request["seed"], error, quick=True)
    theta = first_look(problem, 0)
    return problem, theta, 2 * float(problem(theta[None]).value[0])


def _shifted(result: "FitResult", changed: dict[str, list[Measurements]]) -> dict[str, dict[str, tuple[float, ...]]]:
    """Moves by other tables, fitted to data that these change.

    By the mean over series near the fit, each followed with the table and without: one alone would differ by the order of its
    breaks.
    """
    problem, q, at = result.problem, result.parameters, result.theta[None]
    near, moves = about(problem, result.theta, SERIES), {}
    still = _near(problem, result.measurements, near)
    for name, tables in changed.items():
        moved = []
        for m in tables:
            other = _near(problem, m, near, still.points if name in OF_DATA else None)
            off = [a - b for a, b in zip(_off_data(other), _off_data(still), strict=True)]
            shift = [np.nan_to_num(np.nanmean(np.where(np.isfinite(one), one, np.nan), axis=0)) for one in off]
            # data that are lower by what predictions become higher
            other = problem.with_replicates(
                [(data.value - one, data.weight) for data, one in zip(problem.observed, shift, strict=True)], problem.prior_mean
            )
            moved.append(minimise(other, at, q.low, q.high, max_steps=MOST_STEPS).theta[0] - result.theta)
        by = np.array(moved)
        moves[name] = {one: tuple(by[:, q.index(one)].tolist()) for one in result.moved}
    return moves


def _near(problem: Problem, m: Measurements, theta: np.ndarray, points: Points | None = None) -> Problem:
    """The problem of other measurements, with series at θ, or those known."""
    other = with_model_error(
        make_problem(m, parameter_set(m, problem.parameters.wanted, observables=problem.parameters.observables)),
        model_error_of(problem),
    )
    return followed(other, theta) if points is None else dataclasses.replace(other, points=points)


def _off_data(problem: Problem) -> list[np.ndarray]:
    """Compare single series with the measurements, (t, n) by observable."""
    return [found - data.value[0] for found, data in zip(single(problem)[1], problem.observed, strict=True)]


def _size(change: Change, result: "FitResult") -> float:
    """Size of the largest move: none known, factors, then per cent."""
    sizes = [0.0]
    for name, moves in change.moves.items():
        if any(map(math.isnan, moves)):
            return math.inf
        if result.parameters.named(name).log:
            ratios = [math.exp(by) for by in moves]
            sizes += [abs(ratio - 1) if 1 / MANY < ratio < MANY else max(ratio, 1 / ratio) for ratio in ratios]
        else:
            sizes += [abs(by / (result.values[name] or 1.0)) for by in moves]
    return max(sizes)


# --- usual errors of inputs -----------------------------------------------------------------------------------------------


def _of_inputs(result: "FitResult") -> Iterator[Change]:
    """Usual errors of the inputs taken as exact."""
    m, q = result.measurements, result.parameters
    beside = {one.name for one in q.free}
    beside |= {"length"} if "model_factor" in beside else set()  # which contains a scale of all lengths
    for name in USUAL:
        if name in beside or not _taken_as_exact(m, name) or (name in ("push_height", "friction") and q.front.body == "slider"):
            continue
        what, error, *other = COLUMNS[name].usual
        moves = _moves(result, _moved(m, name, error))
        opposite = {one: -by for one, (by,) in moves.items()}
        if np.isnan(list(moves.values())).any():
            allowed = _allowed(result, name, error)
            opposite = {one: -float(allowed[q.index(one)]) for one in moves}
        elif other:
            back = _moves(result, _moved(m, name, *other))
            opposite = {one: opposite[one] if np.isnan(by) else by for one, (by,) in back.items()}
        counted = " (counts stay as they are)" * (name == "correlation_length" and m.in_si and "whole" in m.kind)
        yield Change(name, what + counted, moves, opposite)


def _allowed(result: "FitResult", name: str, error: float) -> np.ndarray:
    """Moves of θ by an input whose usual error the data exclude.

    By its error in a fit in which it is fitted too. To first order, from refits with the input moved a little either way: as
    the deviance rises by (step/σ)², the data know the input to σ, beside what is usual.
    """
    steps = (-SMALL * error, SMALL * error)
    (low, below), (high, above) = (_refitted(result, _moved(result.measurements, name, by)) for by in steps)
    rise = max(below + above - 2 * result.deviance, 0.0) / 2 / SMALL**2
    return (high - low) / 2 / SMALL / np.sqrt(1 + rise)


def _moves(result: "FitResult", m: Measurements) -> dict[str, tuple[float]]:
    """Moves of the parameters that have a value; NaN where nothing fits."""
    theta, deviance = _refitted(result, m)
    dof, misfit = result.testable_dof, deviance - result.problem.perfect(theta)
    lost = not np.isfinite(deviance) or (dof is not None and chdtrc(dof, misfit) < IMPROBABLE)
    moved = np.full(len(theta), np.nan) if lost else theta - result.theta
    return {one: (float(moved[result.parameters.index(one)]),) for one in result.moved}


def _refitted(result: "FitResult", m: Measurements) -> tuple[np.ndarray, float]:
    """θ and deviance of the first minimum nearby, for other measurements."""
    q = result.parameters
    starts = np.array([result.theta, *(root.theta for root in result.minima)])
    problem = make_problem(m, parameter_set(m, q.wanted, q.front, q.observables)).with_errors(_sigma(result, m))
    found = search(problem, method="lm", max_steps=MOST_STEPS, seed=0, extra=starts)
    first = next(iter(ordered(problem, found.minima)), found)
    return first.theta, first.deviance


def _sigma(result: "FitResult", m: Measurements) -> np.ndarray:
    """Standard errors of the fit, for measurements in another λc."""
    sigma, own = result.sigma, result.measurements.correlation_length
    if m.correlation_length is None or own is None:
        return sigma
    return np.where(np.array(m.kind) == "whole", sigma, sigma * (own / m.correlation_length))


def _again(
    result: "FitResult",
    name: str,
    what: str,
    every: Iterable[Measurements],
    names: Iterable[str],
    *,
    wanted: Sequence[Parameter] = (),
    front: Front | None = None,
    tried: Iterable[str] = (),
) -> Change:
    """Fit other measurements over the whole range, as `fit` does.

    Each for one move of the parameters named. `wanted` parameters and `front` are those of the fit unless given.
    """
    q, seed = result.parameters, result.request["seed"]
    front = q.front if front is None and q.front.body == "slider" else front
    moves: dict[str, tuple[float, ...]] = dict.fromkeys(names, ())
    several = []
    for m in every:
        theta, fits = None, 0
        try:
            model = front or front_of(m, q.front.event, q.front.body)
            problem = make_problem(m, changed := parameter_set(m, wanted or q.wanted, model, q.observed_with(model)))
            problem = problem.with_errors(_sigma(result, m)) if result.scaled else problem
            between = None if result.scaled else between_contacts(problem, seed)
            if between is not None:
                problem = problem.widened(between)
            starts = None
            if not changed.front.interpolated:  # its lengths are smooth
                points = result.starts(changed, 65)
                starts = points[DevianceGrid(points, 2 * problem(points).value).lows()]
            found = search(problem, method="lm", max_steps=MOST_STEPS, seed=seed, extra=starts)
            roots = ordered(problem, found.minima)
            first = next(iter(roots), found)
            # at an end of the range searched no value fits
            room = np.minimum(first.theta - changed.low, changed.high - first.theta) > 1e-6 * (changed.high - changed.low)
            if problem.accepts(first.theta, first.deviance) and room[[one in moves for one in changed.names]].all():
                theta = dict(zip(changed.names, first.theta.tolist(), strict=True))
            fits = sum(root.deviance <= first.deviance + result.rise(LEVELS[-1]) for root in roots)
        except (ValueError, NotConverged):  # nothing starts, or nothing stops, in the range that was asked for
            pass
        for one in moves:
            moves[one] += (math.nan if theta is None else theta[one] - float(result.theta[q.index(one)]),)
        several.append(fits > 1 and not result.points)
    return Change(name, what, moves, several=tuple(several), tried=tuple(tried))


def _taken_as_exact(m: Measurements, name: str) -> bool:
    """Whether the table has this input without an error.

    Counted contacts have no scale of length.
    """
    if name == "length":
        return set(m.kind) != {"whole"}
    errors = getattr(m, f"{name}_sigma")
    return getattr(m, name) is not None and (errors is None or not np.any(errors))


def _moved(m: Measurements, name: str, by: float) -> Measurements:
    """Enlarge one input of all measurements by `by`.

    Lengths in metres stay the same as λc changes.
    """
    if name == "poisson":
        return dataclasses.replace(m, poisson=m.poisson + by)
    factor, counted = np.exp(by), np.array(m.kind) == "whole"
    changed = {name: getattr(m, name) * factor}
    if name == "force" and m.largest_force is not None:
        changed["largest_force"] = m.largest_force * factor
    if name == "correlation_length":
        changed |= {one: getattr(m, one) / factor for one in IN_LC if getattr(m, one) is not None}
    for column in {"length", "length_sigma"} & {*changed}:
        changed[column] = np.where(counted, getattr(m, column), changed[column])
    return dataclasses.replace(m, **changed)


# --- ends, pushes and bodies ----------------------------------------------------------------------------------------------


def _of_ends(result: "FitResult") -> Iterator[Change]:
    """End of the block, soft machine, model factor, if none stated.

    Ends and machines for lengths of first fronts only: gauges take long to compute again, as do fronts of very many contacts,
    and whole events are for blocks without end.
    """
    m, at, q = result.measurements, result.regime, result.parameters
    if q.front.event == "domino" and m.gauges is None and result.fitted.max() < MOST_CONTACTS:
        if m.block_length is None:
            ended = dataclasses.replace(m, block_length=END * np.maximum(at.slow_decay_length, m.length / 4))
            assert ended.block_length is not None
            (scale, unit), some = m.unit, "a block" if np.ptp(ended.block_length) == 0 else "blocks"
            what = f"{some} only {ends(ended.block_length * scale)} {unit} long"
            yield _again(result, "block_length", what, [ended], result.moved)
        if m.machine_stiffness is None and (m.young is not None or not m.in_si):
            own = at.edge_stiffness * (1.0 if m.young is None else m.young)
            driven = [dataclasses.replace(m, machine_stiffness=share * own) for share in MACHINES]
            tried = "as stiff", "a third as stiff"
            what = f"a machine {either(tried)} as the block"
            yield _again(result, "machine_stiffness", what, driven, result.moved, tried=tried)
    scaled = {one.name for one in q.free} | {*q.held}
    if _taken_as_exact(m, "length") and not any(m.provenance) and "model_factor" not in scaled:
        factor = 1 + MODEL_ERROR
        what = f"a model factor of {factor:g}, if the lengths were measured (provenance = measured fits it)"
        wanted = [*q.wanted, Parameter("model_factor", value=factor)]
        yield _again(result, "model_factor", what, [m], result.moved, wanted=wanted)


def _of_bodies(result: "FitResult") -> Iterator[Change]:
    """Another body or push for the same lengths."""
    m, q = result.measurements, result.parameters
    stiff, unit = [name for name in result.moved if q.named(name).name in STIFFNESSES], f"_{m.unit[1]}" * m.in_si
    if not stiff:
        return
    block = q.front.body == "block"
    relaxed = not m.or_zero("prestress").any() and not {"prestress", "threshold_slope"} & {*q.names, *q.held}
    if block and relaxed and m.push_width is None:  # fitted as if pushed all over the side above the push
        assert m.push_height is not None
        at = np.clip(m.push_height, NARROW * m.height, (1 - NARROW) * m.height)
        narrow = dataclasses.replace(m, push_height=at, push_width=NARROW * m.height)
        what = f"a pusher {NARROW_PUSHER} (column push_width{unit} states it)"
        yield _again(result, "push_width", what, [narrow], stiff, front=BlockEvent(narrow, tried=True))
    if not block and relaxed and q.front.event == "domino" and not m.or_zero("threshold_slope").any():
        refused = [name for name in (*NUMERIC, "gauges") if name.removesuffix("_sigma") in BlockEvent.refused]
        lengths = dataclasses.replace(m, **dict.fromkeys(refused))
        wanted = [one for one in q.wanted if one.name != "strength"]
        if m.push_height is None:
            pushed = [dataclasses.replace(lengths, push_height=at * m.height) for at in PUSHES]
            tried = [str(at) for at in PUSHES]
            what = f"a real block, pushed above {either(tried)} H (column push_height{unit} fits one)"
        else:
            pushed, tried, what = [lengths], [], STATED
        yield _again(result, "block", what, pushed, stiff, wanted=wanted, front=BlockEvent(*pushed, tried=True), tried=tried)
    if block:
        wanted = [one for one in q.wanted if one.name != "friction"]
        friction, tried, what = (0.0,), [], "thresholds that do not follow the pressure (μ = 0)"
        if m.friction is None:
            friction, tried = PRESSED, [f"{mu:g}" for mu in PRESSED]
            what = f"thresholds that follow the pressure, at μ = {either(tried)} (column friction)"
        pressed = [dataclasses.replace(m, friction=np.full(len(m), mu), friction_sigma=None) for mu in friction]
        front = BlockEvent(*pressed, tried=True)
        yield _again(result, "pressure", what, pressed, stiff, wanted=wanted, front=front, tried=tried)
        if m.friction is not None and m.normal_stiffness is None:
            sprung = [dataclasses.replace(m, normal_stiffness=np.full(len(m), ratio)) for ratio in NORMAL]
            front = BlockEvent(*sprung, tried=True)
            yield _again(result, "normal_stiffness", SPRUNG[0], sprung, stiff, front=front, tried=SPRUNG[1:])
    if block:
        wanted = [one for one in q.wanted if one.name not in ("push_height", "friction")]
        yield _again(result, "slider", "the paper's slider", [m], stiff, wanted=wanted, front=front_for("slider", "domino"))


def _of_contacts(result: "FitResult") -> Iterator[Change]:
    """Contacts that keep more, and thresholds that scatter."""
    front = result.parameters.front
    stiff = [name for name in result.moved if result.parameters.named(name).name in STIFFNESSES]
    if stiff and (more := _keeping_more(result)) is not None:
        what, wanted, keeping = more
        body = BlockEvent(keeping, tried=True) if front.body == "block" else None
        yield _again(result, "residual_strength", what, [keeping], result.moved, wanted=wanted, front=body)
    if stiff and front.event in ("domino", "full"):
        what = "thresholds that scatter from contact to contact (free threshold_scatter)"
        yield Change("threshold_scatter", what, dict.fromkeys(stiff, (math.nan,)), otherwise="not computed")


# --- errors with those of inputs ------------------------------------------------------------------------------------------


def of_inputs(moved: Sequence[Change]) -> list[Change]:
    """The usual errors of inputs among changes, in the order of `USUAL`."""
    return sorted((one for one in moved if one.opposite), key=lambda one: USUAL.index(one.name))


def total(result: "FitResult", name: str, moved: Sequence[Change]) -> float | None:
    """Total standard error of a parameter; None where there is none."""
    stderr = result.stderrs[name]
    if stderr is None:
        return None
    unit = result.values[name] if result.parameters.named(name).log else 1.0
    return float(np.hypot(stderr, unit * np.linalg.norm([one.by(name) for one in of_inputs(moved)])))


def total_intervals(result: "FitResult", name: str, moved: Sequence[Change]) -> Intervals:
    """The intervals widened by errors of inputs, where these are known.

    Piece by piece, on either side of the root in it, in quadrature; of a positive parameter in its logarithm. An open side
    stays open, and pieces that meet are one. None reaches beyond the domain.
    """
    one, roots, found = result.parameters.named(name), [result.values[name], *(root.values[name] for root in result.roots)], {}
    least, most = PARAMETERS[one.name].limits
    moves = np.array([change.both(name) for change in of_inputs(moved)]).reshape(-1, 2)
    by = np.linalg.norm([moves.min(axis=1), moves.max(axis=1)], axis=1)
    for level, pieces in result.intervals.get(name, {}).items() if np.isfinite(by).all() else ():
        wider: list[Interval] = []
        for piece in pieces:
            low, high = one.theta(piece.low), one.theta(piece.high)
            centre = next((one.theta(root) for root in roots if piece.low <= root <= piece.high), (low + high) / 2)
            down, up = np.hypot([centre - low, high - centre], ndtri((1 + level) / 2) * by).tolist()
            low = piece.low if piece.open_low else max(one.value(centre - down), min(least, piece.low))
            high = piece.high if piece.open_high else min(one.value(centre + up), max(most, piece.high))
            before = wider.pop() if wider and wider[-1].high >= low else piece._replace(low=low)
            wider.append(piece._replace(low=before.low, high=high, open_low=before.open_low))
        found[level] = wider
    return found


def total_of_ratio(result: "FitResult", labels: tuple[str, str], moved: Sequence[Change]) -> float | None:
    """Total standard error of a ratio of stiffnesses, or None.

    Errors of inputs measured on each specimen, its heights, are independent; the others move both stiffnesses.
    """
    ratio, error = result.stiffness_ratios[labels]
    inputs = of_inputs(moved)
    if error is None or not all(label in one.moves for one in inputs for label in labels):
        return None
    above, below = (np.array([one.by(label) for one in inputs]) for label in labels)
    own = np.array([one.name in HEIGHTS for one in inputs], dtype=bool)
    return float(np.hypot(error, ratio * np.linalg.norm(np.where(own, np.hypot(above, below), above - below))))
