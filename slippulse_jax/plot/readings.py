"""Readings of gauges along the interface, and the fitted fields."""

import itertools
from typing import TYPE_CHECKING

import numpy as np

from slippulse_jax.inference.table.columns import READINGS
from slippulse_jax.plot.labels import DISTANCE_MM, as_written
from slippulse_jax.plot.style import NARROW, PAGE, axes, colours, drawn, legend_above, letter_panels, new_figure, width_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from slippulse_jax.inference.fit import FitResult
    from slippulse_jax.inference.table.measurements import Gauges

GAUGE_UNITS = {"slip": (1e6, "slip (µm)"), "stress": (1e-6, "contact stress, $t$ (MPa)")}


def gauges(result: "FitResult", *, width: float | None = None, ax: "Axes | None" = None) -> "Figure":
    """Draw gauge readings of slip and stress, and the fitted fields.

    Readings are drawn ± σ, with one colour per precursor. `width` in mm and `ax` are those of `fit`.

    Raises
    ------
    ValueError
        If the measurements have no gauges.
    """
    readings = _readings(result)
    names = [name for name in READINGS if readings.there(name).any()]
    wide = width_of(width, ax, PAGE * len(names) / 2)
    rows = 1 if wide >= NARROW else len(names)
    with new_figure(wide, 2.5 * rows, ax) as figure:
        panels = np.ravel(figure.subplots(rows, len(names) // rows, squeeze=False))
        for name, panel in zip(names, panels, strict=True):
            gauge_readings(result, name, ax=panel)
        letter_panels(*panels)
    return figure


@drawn
def gauge_readings(result: "FitResult", name: str, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the gauge readings of one kind, and the fitted fields.

    The kind is ``"slip"`` or ``"stress"``.
    """
    ax = axes(ax)
    readings = _readings(result)
    scale, label = GAUGE_UNITS[name]
    there = readings.there(name)
    (errors,) = (one.sigma for one in result.further if one.observable == name)
    m, values, length = result.measurements, getattr(readings, name), result.fitted
    assert m.correlation_length is not None  # gauges need it
    for color, row in zip(itertools.cycle(colours(ax).data), dict.fromkeys(readings.row[there].tolist()), strict=False):
        own = there & (readings.row == row)
        arrest = length[row] * m.correlation_length[row] if np.isfinite(length[row]) else 0.0
        x = np.linspace(0, 1.08 * max(readings.position[own].max(), arrest), 801)
        title = m.label[row] if m.label else m.place(row)
        ax.plot(x * 1e3, result.field(row, name, x) * scale, color=color, label=as_written(title))
        at, read, sigma = readings.position[own] * 1e3, values[own] * scale, errors[own[there]] * scale
        ax.errorbar(at, read, sigma, fmt="o", capsize=2, color=color)
    ax.set_xlim(left=0)
    ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    ax.set_xlabel(DISTANCE_MM)
    ax.set_ylabel(label)
    legend_above(ax, most=4, title="lines: fit; points: gauges ± σ, after arrest")
    return ax


def _readings(result: "FitResult") -> "Gauges":
    if result.measurements.gauges is None:
        raise ValueError("no gauges were read: give read_measurements a table of them")
    return result.measurements.gauges
