"""Picture of slip and stress along the interface, as gauges read them and as fitted."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slippulse_jax.inference.gauges import READINGS, Gauges
from slippulse_jax.inference.objective import PREDICTED
from slippulse_jax.inference.result import FitResult
from slippulse_jax.plot.style import LIGHT

UNITS = {"slip": (1e6, "slip (µm)"), "stress": (1e-6, "contact stress after arrest (MPa)")}
POINTS = 801


def draw_gauges(result: FitResult) -> Figure:
    """One panel each for slip and stress: readings ± σ and the fitted profile, a colour each precursor.

    Raises
    ------
    ValueError
        If no gauges were read.
    """
    gauges = result.measurements.gauges
    if gauges is None:
        raise ValueError("no gauges were read: give read_measurements a table of them")
    names = [name for name in READINGS if gauges.there(name).any()]
    figure = Figure(figsize=(5.2 * len(names), 4.0), layout="constrained")
    for name, ax in zip(names, np.ravel(figure.subplots(1, len(names), squeeze=False)), strict=True):
        draw_readings(result, gauges, name, ax)
    return figure


def draw_readings(result: FitResult, gauges: Gauges, name: str, ax: Axes) -> None:
    """Readings of one kind."""
    scale, label = UNITS[name]
    there = gauges.there(name)
    for color, row in zip(LIGHT.data * 9, dict.fromkeys(gauges.row[there].tolist()), strict=False):
        own = there & (gauges.row == row)
        x = np.linspace(0, 1.08 * max(gauges.position[own].max(), _arrest(result, row)), POINTS)
        title = result.measurements.label[row] if result.measurements.label else result.measurements.place(row)
        ax.plot(x * 1e3, _profile(result, row, name, x) * scale, color=color, label=title)
        sigma = getattr(gauges, f"{name}_sigma")[own] * np.sqrt(result.variance_factor)
        value = getattr(gauges, name)[own]
        ax.errorbar(gauges.position[own] * 1e3, value * scale, sigma * scale, fmt="o", ms=4, capsize=2, color=color)
    ax.set_xlim(left=0)
    ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    ax.set_xlabel("distance from the pushed edge (mm)")
    ax.set_ylabel(label)
    ax.legend(frameon=False, title="fit (line), gauges ± σ", fontsize="small", title_fontsize="small")


def _arrest(result: FitResult, row: int) -> float:
    """Fitted length of one precursor, in m; 0 where the front never stops."""
    m, length = result.measurements, result.fitted.length[row]
    return float(length * m.correlation_length[row]) if np.isfinite(length) and m.correlation_length is not None else 0.0


def _profile(result: FitResult, row: int, name: str, x: np.ndarray) -> np.ndarray:
    """What is predicted for one precursor at distances `x`, in SI."""
    q = result.parameters
    block = next(one for one in result.problem.blocks if one.observable == name)
    datum = int(np.nonzero(block.measurement == row)[0][0])
    y = np.repeat((block.base + block.slope @ result.theta)[block.rows[datum]][None], len(x), axis=0)
    assert result.measurements.correlation_length is not None
    true_unit = np.exp(q.scale_base["position"][row] + q.scale_slope["position"][row] @ result.theta)
    y[:, 5] = np.log(np.maximum(x / (result.measurements.correlation_length[row] * true_unit), 1e-9))
    unit = np.exp(q.scale_base[name][row] + q.scale_slope[name][row] @ result.theta)
    return PREDICTED[name](y, 0).value * unit
