"""Colours, marks and names of data, alike in all pictures."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.plot.labels import as_written, axis_label, printed
from slippulse_jax.plot.style import Colours, colours, label_decades

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

    from slippulse_jax.inference.fit import FitResult
    from slippulse_jax.inference.parameters import Free

MARKERS, BEYOND = "osDXv<>P", "^"
"""Of specimens, and of fronts without arrest."""
MEASURED = "measured"
"""Label of the measurements if the table names no specimens, or too many."""


def curves_of(result: "FitResult", ax: "Axes") -> list[tuple[str, np.ndarray]]:
    """Colour and measurements of each curve."""
    groups = result.groups[1]
    return list(zip(_palette(colours(ax), len(groups)), groups, strict=True))


def marked(result: "FitResult", ax: "Axes") -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Marker, colour, name and measurements of each specimen per curve.

    The colour is the curve's if there are several.
    """
    curves, specimen = curves_of(result, ax), np.array(result.measurements.specimen)
    names = list(dict.fromkeys(specimen.tolist()))
    if not 1 < len(names) <= len(MARKERS):
        names, specimen = [MEASURED], np.full(len(result.measurements), MEASURED)
    of_specimens = _palette(colours(ax), 1 + len(names))[1:]
    for color, group in curves:
        for marker, own, name in zip(MARKERS, of_specimens, names, strict=False):
            rows = group[specimen[group] == name]
            if rows.size:
                yield marker, color if len(curves) > 1 else own, as_written(name), rows


def _palette(c: Colours, count: int) -> Sequence[str]:
    """Choose different colours, of many from a scale."""
    if count <= len(c.data):
        return c.data[:count]
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colormaps["viridis"](0.95 * number / (count - 1))) for number in range(count)]


def places_of(result: "FitResult") -> np.ndarray:
    """Places of measurements along the axis, in the table's unit."""
    return getattr(result.measurements, result.groups[0]) * result.measurements.unit[0]


def open_where_shared(result: "FitResult") -> dict[str, Any]:
    """Open markers if several measurements are at one place of a curve."""
    at = places_of(result)
    shared = any(len(np.unique(at[rows])) < len(rows) for rows in result.groups[1])
    return {"mfc": "none"} if shared else {}


def told_apart(result: "FitResult", labels: list[str], shown: list[np.ndarray]) -> list[str]:
    """Add specimens, or lines of the table, to labels that are alike."""
    m = result.measurements
    named = [", ".join(dict.fromkeys(as_written(m.specimen[row]) for row in rows)) if m.specimen else "" for rows in shown]
    for more in (named, [as_written(m.place(rows[0])) for rows in shown]):
        alike = [labels.count(label) > 1 for label in labels]
        labels = [f"{label}, {own}" if again and own else label for label, again, own in zip(labels, alike, more, strict=True)]
    return labels


def name_axis(one: "Free", axis: "Axis") -> None:
    """Label a finished axis, with a power of ten in the unit.

    Matplotlib would print it over a neighbour's label.
    """
    unit, (low, high) = one.unit, axis.get_view_interval()
    power = int(np.floor(np.log10(max(abs(low), abs(high), 1e-300))))
    label_decades(axis)
    if (axis.get_scale() == "linear" or high < 100 * low) and not -2 <= power < 4:
        axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.10g}")
        unit = f"$10^{{{power}}}$ {printed(unit)}".rstrip()
    specimen = one.label.partition("[")[2][:-1]
    name = "friction_coefficient" if one.symbol == "μ" else one.name
    axis.set_label_text(axis_label(name, unit) + (f"\n[{as_written(specimen)}]" if specimen else ""))


def curve_names(result: "FitResult", groups: list[tuple[str, np.ndarray]]) -> list[str]:
    """Name the curves by specimen and what differs within one."""
    one = result.parameters.inputs.at(result.theta).take([rows[0] for _, rows in groups])
    specimen = np.array(result.measurements.specimen or ("",) * len(result.measurements))
    owners = [set(specimen[rows]) for _, rows in groups]
    alone = len(groups) > 1 and len(set(specimen)) > 1 and all(len(owner) == 1 for owner in owners)
    names = [f"{as_written(min(owner))}: {named_best(result, min(owner))}" if alone else named_best(result) for owner in owners]
    differ = differing(one, [np.array(names) == name for name in set(names)])
    labels = [", ".join([name, *(f"{sign} = {x[i]:.3g}" for sign, x in differ)]) for i, name in enumerate(names)]
    return told_apart(result, labels, [rows for _, rows in groups])


def differing(one: Inputs, alike: list[np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Symbol and values of inputs that differ within selected rows."""
    numbers = {"$k/K$": one.ratio, "ν": one.poisson, r"$\varphi$": one.prestress, "ε": one.threshold_slope}
    if "log_push" in one.more:
        numbers["$h/H$"] = np.exp(one.get("log_push"))
    return [(sign, x) for sign, x in numbers.items() if any(np.ptp(x[which]) > 1e-9 * np.abs(x).max() for which in alike)]


def named_best(result: "FitResult", specimen: str = "") -> str:
    """Name the curve of least deviance.

    Not a fit if the model is rejected, nor the best if others fit equally.
    """
    if result.rejected:
        return "closest (rejected)"
    own = [one.identifiability for name, one in result.verdicts.items() if specimen and f"[{specimen}]" in name]
    alike = {Identifiability.SEVERAL_ROOTS, Identifiability.EQUAL, Identifiability.UNINFORMATIVE}
    return "one that fits" if alike & set(own or [result.identifiability]) else "best fit"
