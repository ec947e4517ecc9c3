"""Error budget of a fit: shifts of its result with each input, beside the errors of the measured lengths.

An input without a standard error of its own is taken as exact. What that leaves out is found by fitting again, near the best
fit, with one input moved by its usual error: that of all measurements alike, as by a wrong ruler or modulus.
"""

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

from slippulse_jax.inference.interpolation import packaged_b
from slippulse_jax.inference.likelihood import make_problem
from slippulse_jax.inference.measurements import IN_LC, Measurements
from slippulse_jax.inference.optimise import minimise
from slippulse_jax.inference.parameters import MODEL_ERROR, OF_MEASURING, STIFFNESSES, Parameter, parameter_set
from slippulse_jax.inference.profile import Interval
from slippulse_jax.inference.verdict import GIVEN, IMPROBABLE, LEVELS, Identifiability

if TYPE_CHECKING:
    from slippulse_jax.inference.result import FitResult


class Usual(NamedTuple):
    """An input whose error is rarely stated."""

    symbol: str
    error: float  # usual error: of ν itself, else of the logarithm
    in_words: str
    smaller: bool = False  # whether it is taken smaller, so that H/λc does not fall below one
    both: bool = False  # whether it is taken both ways: no body of other proportions is needed
    of_a_specimen: bool = False  # measured separately on each specimen


USUAL = {
    "height": Usual("H", float(np.log1p(0.01)), "1 %", of_a_specimen=True),
    "length": Usual("every length", float(np.log1p(0.01)), "1 %", both=True),
    "young": Usual("E", float(np.log1p(0.05)), "5 %", both=True),
    "poisson": Usual("ν", 0.02, "0.02", smaller=True),
    "correlation_length": Usual("λc", float(np.log(2)), "a factor 2", smaller=True),
    "push_height": Usual("height of the push", float(np.log1p(0.05)), "5 %", both=True, of_a_specimen=True),
}
"""By column: a gauge's reading, the scale of a camera, tables of a material. λc is rarely known to better than a factor 2."""

SMALL = 0.01
"""Part of a usual error that is tried where the data exclude all of it."""

SUPPOSED = {
    "block_length": ("a block that ends at 4/κ₂", 4.0),
    "machine_stiffness": ("a machine ten times as stiff as the block", 10.0),
    "provenance": (
        f"a model factor of {1 + MODEL_ERROR:g}, if the lengths were measured (provenance = measured fits it)",
        1 + MODEL_ERROR,
    ),
}
"""Assumed where the table states none: description, and value over 1/κ_2, over the stiffness of the block, or of the factor."""

PUSHES = (0.5, 0.25, 0.1)
"""Heights above which a block is assumed to be pushed where the table does not say, over H."""

NARROW, NARROW_PUSHER = 0.1, "0.1 H high"
"""Height over H of a pusher that may cover less than all of the side above, where the table does not say; and in words."""

TALL, HIGHEST, STARTS = 1e4, 0.55, 9
"""H/λc and highest push over H of the fits with another pusher, which the packaged nodes serve, and the starts of each."""

BOTH_WAYS = np.array([-1.0, 1.0])


class Moved(NamedTuple):
    """Effect of a usual error of one input on the fitted parameters."""

    error: float  # change of the input: of ν itself, else of its logarithm; as in `USUAL`, negative where it is taken smaller
    change: dict[str, float]  # by parameter: of its logarithm where it is positive, else of the parameter itself
    """NaN where the data exclude such an error: they are rejected with it."""
    opposite: dict[str, float]
    """The same by the opposite error; if not computed, minus the change, or minus that by the error that the data allow."""

    def both(self, name: str) -> tuple[float, float]:
        """Changes of a parameter by the error and its opposite."""
        change, opposite = self.change[name], self.opposite[name]
        return (-opposite if np.isnan(change) else change), opposite

    def by(self, name: str) -> float:
        """Mean change of a parameter with the error."""
        change, opposite = self.both(name)
        return (change - opposite) / 2


class AsSlider(NamedTuple):
    """A fit of the paper's slider to the lengths of a block, by parameter."""

    values: dict[str, float]
    stderrs: dict[str, float | None]
    verdicts: dict[str, Identifiability]


def budget(result: "FitResult") -> dict[str, Moved]:
    """Changes of the fitted parameters with each input that is taken as exact, by the name of its column."""
    names = [name for name, verdict in result.verdicts.items() if verdict.identifiability in GIVEN]
    m = result.measurements
    fitted = {one.name for one in result.parameters.free}
    exact = [name for name in USUAL if name not in fitted and _taken_as_exact(m, name)]
    if result.parameters.body == "slider":
        exact = [name for name in exact if name != "push_height"]
    if "model_factor" in fitted:  # it contains a scale of all lengths
        exact = [name for name in exact if name != "length"]
    found = {}
    for name in exact if names else ():
        error = -USUAL[name].error if USUAL[name].smaller else USUAL[name].error
        change = _changes(result, _moved(m, name, error), name, error)
        opposite = {one: -by for one, by in change.items()}
        if np.isnan(list(change.values())).any():
            allowed = _allowed(result, name, error)
            opposite = {one: -float(allowed[result.parameters.index(one)]) for one in change}
        elif USUAL[name].both:
            other = _changes(result, _moved(m, name, -error), name, -error)
            opposite = {one: opposite[one] if np.isnan(by) else by for one, by in other.items()}
        found[name] = Moved(error, change, opposite)
    return found


def _allowed(result: "FitResult", name: str, error: float) -> np.ndarray:
    """Changes of θ by an input whose usual error the data exclude: by its error in a fit in which it is fitted too.

    To first order, from refits with the input moved a little either way: as the deviance rises by (step/σ)², the data know the
    input to σ, beside what is usual.
    """
    steps = SMALL * error * BOTH_WAYS
    (low, below), (high, above) = (_refitted(result, _moved(result.measurements, name, by), name, by) for by in steps)
    rise = max(below + above - 2 * result.deviance, 0.0) / 2 / SMALL**2
    return (high - low) / 2 / SMALL / np.sqrt(1 + rise)


def _changes(result: "FitResult", m: Measurements, name: str, by: float, *held: Parameter) -> dict[str, float]:
    """Changes of the parameters that have a value, for other measurements; NaN where these are rejected or run through."""
    (theta, deviance), q, dof = _refitted(result, m, name, by, *held), result.parameters, result.testable_dof
    rejected = dof is not None and chdtrc(dof, deviance - result.problem.perfect) < IMPROBABLE
    moved = theta - result.theta if np.isfinite(deviance) and not (rejected and name in USUAL) else np.full(len(theta), np.nan)
    return {one: float(moved[q.index(one)]) for one, verdict in result.verdicts.items() if verdict.identifiability in GIVEN}


def unstated_ends(result: "FitResult") -> dict[str, dict[str, float]]:
    """Changes of the fitted parameters with a block that ends, a machine that gives way and a model factor, as in `SUPPOSED`.

    Only of what the table does not state; by column and parameter, of the logarithm of a positive parameter. NaN where such a
    block would be run through. Ends and machines for lengths of first fronts only: gauges take long to compute again, and whole
    events and smooth rules are for blocks without end.
    """
    names = [name for name, verdict in result.verdicts.items() if verdict.identifiability in GIVEN]
    m, at = result.measurements, result.regime
    young = 1.0 if m.young is None else m.young
    supposed = {"block_length": np.maximum(at.slow_decay_length, m.length / 4), "machine_stiffness": at.edge_stiffness * young}
    found = {}
    plain = not result.parameters.smooth and result.parameters.event == "domino" and m.gauges is None
    for name, size in supposed.items() if names and plain else ():
        if getattr(m, name) is not None or (name == "machine_stiffness" and m.in_si and m.young is None):
            continue
        found[name] = _changes(result, dataclasses.replace(m, **{name: SUPPOSED[name][1] * size}), name, 0.0)
    if "length" in result.budget and not any(m.provenance) and "model_factor" not in result.parameters.held:
        found["provenance"] = _changes(result, m, "provenance", 0.0, Parameter("model_factor", value=SUPPOSED["provenance"][1]))
    return found


def unstated_push(result: "FitResult") -> dict[str, dict[str, float]]:
    """Factors on each stiffness by where the side is pushed, as far as the table does not say, for the same lengths.

    By push, and by parameter. Of a slider, those of a block pushed from some heights over H up, for that measurement on which
    the stiffness acts whose length over H is the median. Of a block whose pusher has no stated height, that of a pusher
    `NARROW_PUSHER`. NaN where no stiffness gives the lengths. Only for relaxed interfaces whose stiffness has a value. Empty
    where the lengths of a slider share an offset or a model factor, which would take other values in a fit of a block.
    """
    given = {name for name, verdict in result.verdicts.items() if verdict.identifiability in GIVEN}
    if width_is_unstated(result):
        return {NARROW_PUSHER: {name: factor for name, factor in _narrower(result).items() if name in given}}
    if not push_is_unstated(result) or shares_errors(result):
        return {}
    m = result.measurements
    q, ratio = result.parameters, result.fitted.length / m.height
    found: dict[str, dict[str, float]] = {}
    for one in (one for one in q.free if one.name in STIFFNESSES and one.label in given):
        rows = q.rows_of(q.index(one.label))
        i = int(rows[np.argsort(ratio[rows])[len(rows) // 2]])
        for at in PUSHES:
            b = packaged_b(float(ratio[i]), float(m.poisson[i]), at)
            if b is not None:
                found.setdefault(f"{at:g}", {})[one.label] = b / float(result.regime.b[i])
    return found


def _narrower(result: "FitResult") -> dict[str, float]:
    """Factor on each stiffness if the pusher is narrow; NaN where the lengths are then rejected.

    From two fits within the packaged nodes, for which nothing is followed anew: of a tall block, as lengths over H hardly
    depend on λc/H, at ν = 0.3, and pushed from `NARROW` to `HIGHEST` H up.
    """
    m, q = result.measurements, result.parameters
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
        every = parameter_set(other, wanted, q.event, q.body)
        problem = make_problem(other, every, result.problem.loss, result.sigma * taller)
        stiff = [j for j, one in enumerate(every.free) if one.name in STIFFNESSES]
        labels = [every.free[j].label for j in stiff]
        known = dict(zip(q.names, result.theta, strict=True))
        start = np.clip([known.get(one.label, 0.0) for one in every.free], every.low, every.high)
        starts = np.repeat(start[None], STARTS, axis=0)
        starts[:, stiff] = np.linspace(every.low[stiff], every.high[stiff], STARTS + 2)[1:-1]
        ends = minimise(problem, starts, every.low, every.high)
        best = int(np.argmin(ends.value))
        found.append(ends.theta[best][stiff])
        deviance = 2 * float(ends.value[best])
    rejected = result.testable_dof and chdtrc(result.testable_dof, deviance) < IMPROBABLE
    factors = np.where(rejected or not np.isfinite(deviance), np.nan, np.exp(found[1] - found[0]))
    return dict(zip(labels, map(float, factors), strict=True))


def width_is_unstated(result: "FitResult") -> bool:
    """Whether a fit of a block on a relaxed interface takes the pusher to cover all of the side above the stated height."""
    m, q = result.measurements, result.parameters
    return q.body == "block" and m.push_width is None and not m.or_zero("prestress").any() and "prestress" not in q.names


def push_is_unstated(result: "FitResult") -> bool:
    """Whether to compare with blocks: first fronts of a slider on a relaxed interface, whose push is not stated."""
    m, q = result.measurements, result.parameters
    given = [name for name, verdict in result.verdicts.items() if verdict.identifiability in GIVEN]
    stiff = any(one.startswith(name) for one in given for name in STIFFNESSES)
    relaxed = q.event == "domino" and not q.smooth and not m.or_zero("prestress").any() and "prestress" not in q.names
    return stiff and relaxed and q.body == "slider" and m.push_height is None


def shares_errors(result: "FitResult") -> bool:
    """Whether an offset or a model factor of all lengths is fitted, or held at a value that changes them."""
    q = result.parameters
    fitted = any(one.name in OF_MEASURING for one in q.free)
    return fitted or q.held.get("offset", 0.0) != 0 or q.held.get("model_factor", 1.0) != 1


def total(result: "FitResult", name: str, moved: dict[str, Moved]) -> float | None:
    """Standard error of a parameter, inputs taken as exact included; None where there is none."""
    stderr = result.stderrs[name]
    if stderr is None:
        return None
    q = result.parameters
    unit = result.values[name] if q.named(name).log else 1.0
    return float(np.hypot(stderr, unit * np.linalg.norm([one.by(name) for one in moved.values()])))


def total_interval(result: "FitResult", name: str, moved: dict[str, Moved]) -> Interval | None:
    """The 68 % interval of a parameter, each side widened by the errors of the inputs taken as exact.

    In quadrature; of a positive parameter in its logarithm. None where the interval is open or in pieces.
    """
    pieces = result.intervals.get(name, {}).get(LEVELS[0], [])
    moves = np.array([one.both(name) for one in moved.values()])
    by, value = np.linalg.norm([moves.min(axis=1), moves.max(axis=1)], axis=1), result.values[name]
    if len(pieces) != 1 or pieces[0].open_low or pieces[0].open_high or not np.isfinite(by + value).all():
        return None
    ends = np.array(pieces[0][:2])
    if result.parameters.named(name).log:
        low, high = value * np.exp(BOTH_WAYS * np.hypot(np.log(ends / value), by))
    else:
        low, high = value + BOTH_WAYS * np.hypot(ends - value, by)
    return Interval(float(low), float(high), False, False)


def total_of_ratio(result: "FitResult", labels: tuple[str, str], moved: dict[str, Moved]) -> float | None:
    """Standard error of the ratio of two stiffnesses, inputs taken as exact included; None where there is none.

    Errors of inputs measured on each specimen are independent; the others move both stiffnesses.
    """
    ratio, error = result.stiffness_ratios[labels]
    if error is None or not all(label in one.change for one in moved.values() for label in labels):
        return None
    above, below = (np.array([one.by(label) for one in moved.values()]) for label in labels)
    own = np.array([USUAL[name].of_a_specimen for name in moved])
    return float(np.hypot(error, ratio * np.linalg.norm(np.where(own, np.hypot(above, below), above - below))))


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
    names = (*IN_LC, "length_sigma", "height_sigma", "push_height_sigma")
    return {name: getattr(m, name) / factor for name in names if getattr(m, name) is not None}


def _refitted(result: "FitResult", m: Measurements, name: str, by: float, *held: Parameter) -> tuple[np.ndarray, float]:
    """θ of least deviance near the best fit, for other measurements or with more parameters held, and that deviance."""
    sigma = result.problem.blocks[0].data.sigma
    if name == "correlation_length":
        sigma = np.where(np.array(m.kind) == "whole", sigma, sigma * np.exp(-by))
    q = parameter_set(m, [*result.parameters.wanted, *held], result.parameters.event, result.parameters.body)
    problem = make_problem(m, q, result.problem.loss, sigma)
    found = minimise(problem, result.theta[None], q.low, q.high)
    return found.theta[0], 2 * float(found.value[0])
