"""Check a fit against its measurements before anything is computed.

A request that has no meaning is an error. Numbers that may be in another unit, and columns that may be exchanged, are
suspicions. A table checks its own rows (`slippulse_jax.inference.table.columns`), a model what it takes (`Front.check`).
"""

import warnings
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from slippulse_jax.base.domains import Domain
from slippulse_jax.inference.choices import Body, MeasuredEvent
from slippulse_jax.inference.model.fronts import STIFFEST, Front, WholeEvent, front_for, front_of
from slippulse_jax.inference.model.inputs import COMMON, Inputs
from slippulse_jax.inference.model.parameters import (
    HEIGHTS,
    NEEDS_SI,
    PARAMETERS,
    SCALES,
    STIFFNESSES,
    Linear,
    Parameter,
    ParameterSet,
    default_bounds,
    parameter_set,
    ratio_per_unit,
    stated,
    stated_errors,
    stiffness_name,
    with_names,
)
from slippulse_jax.inference.table.columns import COLUMNS, EVERY, IN_LC, NUMERIC, MeasurementError
from slippulse_jax.inference.table.measurements import Measurements, MeasurementWarning

OF_SEQUENCES = ("newborn", "time_constant", "threshold_scatter", "machine_stiffness", "normal_load")
"""Parameters that only forces by place, up to sliding, determine."""
AGED = 0.45
"""Part of a block below which no event tells how its contacts age."""
LIKELY = Domain(0.02, 1.2, "")
"""Usual range of the length over the height."""
STARTS = ("young", "push_height", "push_width", "block_length", "block_width", "normal_stiffness")
"""Parameters that are nothing without a column."""
COMPARED = (*HEIGHTS, "young", "correlation_length", "normal_load", "machine_stiffness", "strength", "time_constant")
"""Parameters whose priors, values and bounds are held against what the table states, or what is usual."""
USUALLY = {"strength": (1e3, 1e9), "time_constant": (0.02, 50.0)}
"""Usual ranges of parameters that no table states."""
IN_UNIT = {"m": "height", "Pa": "young"}
"""Columns by whose units a parameter in one of SI may be meant."""
IN_ALL = {"normal_load": "N", "machine_stiffness": "N/m"}
"""Units in which those over the width of the block may be given by mistake."""
SUSPECT = (0.01, 1.5)
"""Range of the length over the height outside which a unit is suspected."""


def checked(
    m: Measurements,
    wanted: Iterable[str | Parameter],
    event: MeasuredEvent | Front | None = None,
    body: Body | None = None,
) -> ParameterSet:
    """Check the parameters of a fit, and map them to inputs.

    A ValueError if one is given twice, has no meaning for these measurements, is needed and missing, or its limits leave the
    domain of the model, or the range in which a domino starts.
    """
    front, wanted = front_of(m, event, body), [Parameter(one) if isinstance(one, str) else one for one in wanted]
    chosen = with_names(m, wanted)
    names = [one.name for one in chosen]
    for one in chosen:
        _check_meaning(m, one, names)
    _check_complete(m, chosen)
    if missing := [name for name in front.columns if name not in m.other]:
        raise ValueError(f"{m.source}: the model reads the column {missing[0]}, which is not there")
    front.check(m, {*names})
    for name in names:
        if not PARAMETERS[name].acts.keys() & {*front.inputs, *COMMON, *SCALES}:
            raise ValueError(f"parameter {name}: no part of the model, of a {front.name}")
    for name in stated_errors(m, front):
        if name in names:
            error = "the measurements state its error: give it a prior there, or leave it out here"
            raise ValueError(f"{name} is to be fitted, and {error}")
    q = parameter_set(m, wanted, front)
    _check_domain(m, q)
    _check_reached(m, q)
    return q


# --- what is asked for --------------------------------------------------------------------------------------------------


def _check_meaning(m: Measurements, one: Parameter, names: Sequence[str]) -> None:
    """Check that a parameter has a meaning for these measurements."""
    stiffness = stiffness_name(m)
    if names.count(one.name) > 1:
        raise ValueError(f"parameter {one.name} is given {names.count(one.name)} times")
    if one.name in OF_SEQUENCES:
        _check_of_sequences(m, one, names)
    if one.name == "arrest":
        raise ValueError("parameter arrest: it is fitted wherever gauges were read; do not name it")
    if one.name in STIFFNESSES and one.name != stiffness:
        raise ValueError(f"parameter {one.name}: these measurements determine {stiffness}")
    if one.name in NEEDS_SI and not m.in_si:
        raise ValueError(f"parameter {one.name}: needs measurements in SI, with their correlation length")
    _check_stated(m, one)
    if one.each == "specimen" and not m.specimen:
        raise ValueError(f"parameter {one.name}: each = 'specimen', but the measurements name no specimens")
    if one.name == "model_factor" and one.prior is None and one.value is None:
        raise ValueError(
            "parameter model_factor: needs a prior, as (1, 0.05): the lengths alone cannot separate it from stiffness"
        )


def _check_stated(m: Measurements, one: Parameter) -> None:
    """Check that the table states what a parameter starts from."""
    if one.name in STARTS and (getattr(m, one.name) is None or not np.isfinite(getattr(m, one.name)).all()):
        raise ValueError(f"parameter {one.name}: the measurements state no {EVERY[one.name].name(in_si=m.in_si)} to start from")
    if one.name == "force_offset" and m.force is None:
        raise ValueError("parameter force_offset: the measurements have no forces")


def _check_of_sequences(m: Measurements, one: Parameter, names: Sequence[str]) -> None:
    """Check a parameter that only a sequence determines."""
    if not m.is_sequence:
        raise ValueError(f"parameter {one.name}: of sequences of a block, with a force for every length")
    if one.name == "machine_stiffness" and m.machine_stiffness is None:
        raise ValueError("parameter machine_stiffness: the measurements state none to start from; a guess is enough")
    if one.name == "threshold_scatter" and one.value is None:
        option = m.option("--fix threshold_scatter=0.05", 'fixed={"threshold_scatter": 0.05}')
        raise ValueError(f"parameter threshold_scatter: held, not fitted, as forces hardly tell 2 % from 10 %: {option}")
    if one.name == "time_constant" and "newborn" not in names:
        raise ValueError('parameter time_constant: contacts that age need newborn too: free = [..., "newborn"]')
    if one.name in ("newborn", "time_constant") and one.value is None and m.block_length is not None:
        farthest = float(np.max(m.length / m.block_length))
        if farthest < AGED:
            where = f"the farthest place is {farthest:.2g} L, and nothing below {AGED:g} L tells how contacts age"
            raise ValueError(f"parameter {one.name}: {where}: hold it")


def _check_complete(m: Measurements, chosen: Sequence[Parameter]) -> None:
    """Check that what the measurements need is fitted or held."""
    stiffness, names = stiffness_name(m), [one.name for one in chosen]
    if stiffness not in names:
        option = m.option(f"--free stiffness, or --fix {stiffness}=VALUE", f"fixed={{{stiffness!r}: …}}, or free with it")
        raise ValueError(f"{stiffness} is neither fitted nor held: name it: {option}")
    if "strength" not in names and (carrier := _carries_strength(m)):
        asked = ["stiffness" if one.name == stiffness else one.name for one in chosen if one.value is None and not one.nuisance]
        both = dict.fromkeys([*asked, "strength"])
        option = m.option(" ".join(f"--free {name}" for name in both), f"free={[*both]}".replace("'", '"'))
        raise ValueError(f"{carrier} scales with σ_s: fit strength too, or hold it at its value in Pa: {option}")
    if all(one.value is not None for one in chosen):
        raise ValueError("nothing is fitted: every parameter is held")


def _carries_strength(m: Measurements) -> str:
    """Name the columns that scale with σ_s; empty without any."""
    if m.is_sequence:  # whose forces scale with the normal load
        return ""
    names = [name for name in ("displacement", "force") if getattr(m, name) is not None and np.isfinite(m.or_zero(name)).any()]
    if names:
        return f"{m.source}, column {' and '.join(map(m.heading, names))}: what it states"
    return f"{m.gauges.source}: what gauges read" if m.gauges is not None else ""


# --- the range that is searched -----------------------------------------------------------------------------------------


def _check_domain(m: Measurements, q: ParameterSet) -> None:
    """Check that no limit leads outside the domain of the model."""
    every = {**COMMON, **q.front.inputs}
    for name in q.inputs.names:
        linear, (symbol, low, high, requirement) = q.inputs.get(name), every[name][:4]
        reach = [float(end) for end in (_reach(q, linear)[0].min(), _reach(q, linear)[1].max())]
        if low - 1e-9 <= reach[0] and reach[1] <= high + 1e-9:
            continue
        if mistaken := "; ".join(_far_from_the_table(m, [one for one in q.wanted if name in PARAMETERS[one.name].acts])):
            raise ValueError(mistaken)
        shown = [np.exp(x) if name.startswith("log") else x for x in reach]
        moving = " and ".join(one.label for one, by in zip(q.free, linear.slope.any(axis=0), strict=True) if by)
        held = " and ".join(f"{one} = {x:g}" for one, x in q.held.items() if name in PARAMETERS[one].acts)
        searched = f"the range searched for {moving}" + f" with {held}" * bool(held) if moving else held
        raise ValueError(
            f"{searched} means {symbol} {_span(*shown)} for some measurement: {requirement}; give "
            + ("other bounds or another prior" if moving else "another value")
        )


def _check_reached(m: Measurements, q: ParameterSet) -> None:
    """Refuse a range of stiffness in which no domino starts.

    It is probably in another unit: no measurement is of more than the contact at the edge, whatever the other parameters.
    """
    name = stiffness_name(m)
    one = next(one for one in q.wanted if one.name in ("stiffness", name))
    key = next((key for key in ("bounds", "prior", "value") if getattr(one, key) is not None), None)
    if key is None or m.length.min() <= 1 or q.front.event == "sequence":
        return
    reach = {each: _reach(q, q.inputs.get(each)) for each in q.inputs.names}
    easiest = {each: ends[each not in ("threshold_slope", "friction", "log_machine")] for each, ends in reach.items()}
    low, high = reach["log_stiffness"]
    softest = np.log(front_for("slider", "domino").softest(m))
    some = np.flatnonzero(high > softest)
    from_, to = np.maximum(low, softest)[some], high[some]
    rows = Inputs.from_table([*easiest], np.stack([*easiest.values()], axis=-1)).take(some)
    front = front_for("slider", "domino") if isinstance(q.front, WholeEvent) else q.front  # whose events start with it
    for share in (0.5, 1.0, 0.0, *np.linspace(0, 1, 65)) if len(some) else ():
        at = rows._replace(log_stiffness=from_ + share * (to - from_))
        if (front.lengths(at) > 1).any():
            return
    lowest, highest = default_bounds(m, q.front, Parameter(name), np.ones(len(m), dtype=bool), 0.0)
    lowest *= 1 if q.front.body == "block" else 100  # the default range of sliders begins where none starts
    numbers, unit = np.atleast_1d(getattr(one, key)), PARAMETERS[name].unit[m.in_si]
    shown = ", ".join(f"{x:g}" for x in numbers)
    meant = f" (k/K = {numbers[0]:g} is {numbers[0] / ratio_per_unit(m).max():.2g} {unit})"
    raise ValueError(
        f"{key} = {f'({shown})' if key != 'value' else shown} of {name}{f', in {unit}' * m.in_si}: no domino starts at k/K "
        f"{_span(np.exp(low.min()), np.exp(high.max()))}; expected within {lowest:.2g} to {highest:.2g} {unit}".rstrip()
        + meant * bool(m.in_si and numbers[0] <= STIFFEST)
    )


def _span(low: float, high: float) -> str:
    """Write a range, or a number: ``from 0.1 to 0.7``, ``= 3``."""
    return f"from {low:.4g} to {high:.4g}" if low < high else f"= {low:.4g}"


def _reach(q: ParameterSet, linear: Linear) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest number that each measurement gets from any θ searched."""
    down, up = np.minimum(linear.slope, 0), np.maximum(linear.slope, 0)
    return linear.base + up @ q.low + down @ q.high, linear.base + up @ q.high + down @ q.low


# --- suspicions ---------------------------------------------------------------------------------------------------------


def suspicions(m: Measurements, parameters: Iterable[Parameter]) -> tuple[str, ...]:
    """Find columns that may be exchanged, and numbers in another unit.

    `parameters` are those of the fit, requested or held.
    """
    wanted = list(parameters)
    return (*_exchanged(m, wanted), *_unlikely(m), *_far_from_the_table(m, wanted))


def _exchanged(m: Measurements, wanted: Sequence[Parameter]) -> Iterator[str]:
    """Compare lengths and heights, which prestress, ends and machines may lengthen."""
    prestressed = any(one.name == "prestress" for one in wanted) or m.or_zero("prestress").any()
    lengthened = prestressed or m.machine_stiffness is not None or m.block_length is not None
    over = float(np.median(m.length / m.height))
    if m.is_sequence or SUSPECT[0] <= over <= SUSPECT[1] * (5 if lengthened else 1):
        return
    height, length = m.heading("height"), m.heading("length")
    may_be = [f"are {height} and {length} exchanged"] * bool(LIKELY.holds(1 / over))
    factors = Domain(over / LIKELY.high, over / LIKELY.low, "")  # on the heights
    for name, own, value, likely in (("height", height, 1.0, factors), ("length", length, over, LIKELY)):
        unit = COLUMNS[name].likely_unit(value, own, likely) if m.in_si else ""
        may_be += [f"is {own} in {unit}"] * bool(unit)
    if may_be:
        yield f"the lengths are about {over:.3g} times the heights: {', or '.join(may_be)}?"


def _unlikely(m: Measurements) -> Iterator[str]:
    """Find numbers that hardly any experiment has."""
    for name in (name for name in NUMERIC if COLUMNS[name].likely is not None):
        column, x = COLUMNS[name], getattr(m, name)
        if x is None or (column.unit and not m.in_si) or column.likely is None:
            continue
        in_si = x * m.metres if name in IN_LC else x
        off, own = in_si[~column.likely.holds(in_si)], m.heading(name)
        unit = column.likely_unit(off[0], own) if off.size else ""
        if off.size and (unit or name != "height"):  # a low sample may be what was meant
            number = off[0] / column.names(in_si=True).get(own, 1.0)
            yield f"{own} = {number:.4g} is {column.likely.requirement}" + f": is it in {unit}?" * bool(unit)


def _far_from_the_table(m: Measurements, wanted: Iterable[Parameter]) -> Iterator[str]:
    """Find priors, values and bounds far from what is stated or usual."""
    most = float(np.nanmax(m.or_zero("force")))
    usual = USUALLY | ({"normal_load": (most / 1.2, most / 0.015)} if m.is_sequence else {})
    for one in (one for one in wanted if one.name in COMPARED):
        key = next((key for key in ("prior", "value", "bounds") if getattr(one, key) is not None), None)
        column = stated(m, one.name)
        if key is None or (column is None and one.name not in usual):
            continue
        table = np.array(usual[one.name]) if column is None else column[np.isfinite(column)]
        if one.name in HEIGHTS and one.each is None:  # shown as that of the first
            table = table[:1]
        low, high = getattr(one, key) if key == "bounds" else np.repeat(getattr(one, key), 2)[:2]
        unit, widest = PARAMETERS[one.name].unit[m.in_si], 3 if column is None else 50  # m and cm are 100 apart
        likely = Domain(table[0] / 1.5 * low / high, table[-1] * 1.5, "")  # of the lower end, in the unit that was meant
        meant = COLUMNS[IN_UNIT[unit]].likely_unit(low, likely=likely) if unit in IN_UNIT else ""
        of_all = IN_ALL.get(one.name, "") if m.block_width is not None and likely.holds(low / m.block_width[0]) else ""
        if max(low / table.max(), table.min() / high) > widest or (of_all and not likely.holds(low)):
            number = f"{low:g} to {high:g}" if key == "bounds" else f"{low:g}"
            where = f"where {m.heading(one.name)} says {table[0]:.4g} {unit}"
            where = where if column is not None else f"usually {table[0]:.2g} to {table[1]:.2g} {unit}"
            asked = f"; is it in {of_all or meant}?" * bool(of_all or meant)
            yield f"{one.name} = {number} {unit}, {where}: priors, bounds and held values are in {unit}{asked}"


# --- other uses of measurements -----------------------------------------------------------------------------------------


def check_used(m: Measurements, what: str) -> None:
    """Refuse ends and machines, for a caller that ignores them.

    A warning names other columns that are not used: errors of inputs, errors that measured lengths share, and gauges would have
    changed the errors of the result.
    """
    if m.is_sequence:
        raise MeasurementError(f"{m.source}: {what} takes first precursors, and not the forces of a sequence: leave out force")
    for name in ("block_length", "machine_stiffness"):
        if getattr(m, name) is not None and np.isfinite(getattr(m, name)).any():
            raise MeasurementError(f"{m.source}, column {name}: {what} takes blocks without end, whose edge is held")
    errors = [one for one in COLUMNS if one.endswith("_sigma") and COLUMNS[one].value in PARAMETERS]
    unused = [m.heading(name) for name in errors if getattr(m, name) is not None and np.any(getattr(m, name))]
    unused += ["gauges"] * (m.gauges is not None) + ["what lengths of provenance measured share"] * ("measured" in m.provenance)
    if unused:
        text = f"{m.source}: {what} takes the inputs as exact and errors as independent, without {', '.join(unused)}"
        warnings.warn(text, MeasurementWarning, stacklevel=3)
