"""Lengths against height, and against stiffness, with the fit."""

from typing import TYPE_CHECKING, Any

import numpy as np

from slippulse_jax.inference.result.predicted import alike
from slippulse_jax.inference.search.intervals import LEVELS
from slippulse_jax.plot.labels import axis_label, equation
from slippulse_jax.plot.marks import (
    BEYOND,
    MEASURED,
    curve_names,
    curves_of,
    differing,
    marked,
    name_axis,
    named_best,
    open_where_shared,
    places_of,
    told_apart,
)
from slippulse_jax.plot.style import axes, colours, dashed_where, drawn, handles_of, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slippulse_jax.inference.fit import FitResult
    from slippulse_jax.inference.result.predicted import LengthCurve

BAND_LEVEL = LEVELS[-1]
MOST_CURVES = 6
AROUND = 1.5
"""Decades of stiffness that are drawn on either side of its interval."""


@drawn
def fit_lengths(result: "FitResult", *, ax: "Axes | None" = None) -> "Axes":
    """Draw measured lengths against height, and the fitted curve.

    Against the height of the push where one block was pushed at several. With its 95 % band, and the lengths that no stiffness
    gives; of contacts that differ, instead of the band, the range of 95 % of the events at each height. The curve is dashed
    where the edge contact breaks again before the front stops, so that the event goes on. Ticks mark the fitted lengths that
    lie off it, where inputs differ between the points of a curve. Points are open where several are at the same place. A
    ValueError for a sequence.
    """
    from matplotlib.patches import Patch

    _check_lengths(result)
    ax = axes(ax)
    c = colours(ax)
    m = result.measurements
    (scale, unit), along, groups = m.unit, result.groups[0], curves_of(result, ax)
    at = getattr(m, along)
    top, curves, bands = 0.0, [], []
    for (color, rows), name in zip(groups, curve_names(result, groups), strict=True):
        size = scale[rows[0]]
        near = (at * scale)[slice(None) if len(groups) <= MOST_CURVES else rows]
        height = np.linspace(near.min() * 0.85, near.max() * 1.15, 41) / size
        tall = m.height[rows[0]]
        of_push = min(0.05 * tall, 0.9 * at[rows].min()), max(0.9 * tall, 1.01 * at[rows].max())
        low, high = of_push if along == "push_height" else (1.01, np.inf)
        height = height[(height > low) & (height < high)]
        x, curve = height * size, result.curve(rows, height, along=along)
        longest = _longest(result, rows, height, along, curve) * size
        curves.append((x, longest, curve.breaks_again.any()))
        dashed_where(ax, x, curve.length * size, curve.breaks_again, color=color, label=name)
        for low, high in () if result.rejected or result.problem.drawn else curve.bands:
            ax.fill_between(x, low * size, high * size, color=color, alpha=0.25, lw=0)
            bands.append(np.max(high - low) * size)
        top = max(top, 1.12 * np.nanmax(longest, initial=0.0), 1.05 * (m.length * scale)[rows].max())
    x, longest, _ = max(curves, key=lambda one: np.nanmax(one[1], initial=0.0))
    label = "longer than possible"
    beyond = ax.fill_between(x, longest, 10 * np.nanmax(longest, initial=0.0), fc=c.grey, alpha=0.15, lw=0, label=label)
    if result.problem.drawn:
        _draw_events(result, ax)
    _draw_data(result, ax)
    _draw_fitted(result, ax, 0.01 * top)
    ax.set(xlabel=axis_label(along, unit), ylabel=axis_label("length", unit))
    ax.margins(x=0, y=0)
    ax.set_ylim(0, top)
    handles = handles_of(ax, again=any(again for *_, again in curves))
    if not result.rejected and not result.problem.drawn:
        thin = max(bands, default=0) < 0.03 * top
        label = f"{BAND_LEVEL:.0%} band" + " (thin)" * bool(thin)
        band = Patch(color=c.blue if len(groups) == 1 else c.ink, alpha=0.25, lw=0, label=label)
        handles.insert(handles.index(beyond), band)
    legend_above(ax, handles, most=2)
    return ax


def _longest(result: "FitResult", rows: np.ndarray, height: np.ndarray, along: str, curve: "LengthCurve") -> np.ndarray:
    """Longest length at each height, in λc; NaN where none stops.

    Where each costs many whole events, it is in proportion to the height as at the two nearest that were measured, or the
    fitted length if that is longer.
    """
    if result.parameters.front.interpolated:
        at, first = np.unique(getattr(result.measurements, along)[rows], return_index=True)
        longest = np.fmax(height * np.interp(height, at, result.attainable[rows][first] / at), curve.length)
    else:
        longest = curve.longest
    return np.where(np.isfinite(longest), longest, np.nan)


def _draw_events(result: "FitResult", ax: "Axes") -> None:
    """Draw the range of 95 % of the events at each height."""
    x, scale, label = places_of(result), result.measurements.unit[0], f"{BAND_LEVEL:.0%} of events"
    for data, events in zip(result.problem.learnt, result.problem.draws(result.theta), strict=True):
        for i in np.unique(x[data.measurement], return_index=True)[1] if data.observable.of_rows else ():
            order = np.argsort(events.value[i])
            share = np.cumsum(events.weight[i][order])
            low, high = events.value[i][order][np.searchsorted(share, share[-1] * (1 + np.array([-1, 1]) * BAND_LEVEL) / 2)]
            row = data.measurement[i]
            ax.vlines(x[row], low * scale[row], high * scale[row], color=colours(ax).grey, lw=7, alpha=0.3, label=label)
            label = "_"


def _draw_data(result: "FitResult", ax: "Axes") -> None:
    m, kind, scale = result.measurements, np.array(result.measurements.kind), result.measurements.unit[0]
    x, y, sigma = places_of(result), m.length * scale, result.sigma * scale
    style: dict[str, Any] = {"capsize": 2, "zorder": 3, "linestyle": "none", "elinewidth": 0.8, **open_where_shared(result)}
    thick: dict[str, Any] = style | {"elinewidth": 3}
    for marker, color, name, rows in marked(result, ax):
        plain, whole, beyond = (rows[kind[rows] == one] for one in ("length", "whole", "at_least"))
        if plain.size:
            ax.errorbar(x[plain], y[plain], sigma[plain], fmt=marker, color=color, label=f"{name} ± σ", **style)
        if whole.size:
            half, label = scale[whole] / 2, "whole contacts" if name == MEASURED else f"{name}, counted"
            ends = y[whole] - half, half + sigma[whole]
            ax.errorbar(x[whole], *ends, fmt="none", color=color, label=label, **thick)
        if beyond.size:
            ax.plot(x[beyond], y[beyond], BEYOND, color=color, ms=6, label="at least this long")


def _draw_fitted(result: "FitResult", ax: "Axes", visible: float) -> None:
    """Mark fitted lengths farther than `visible` from their mean curve."""
    m, fitted, along, x = result.measurements, result.fitted, result.groups[0], places_of(result)
    scale = m.unit[0]
    for color, rows in curves_of(result, ax):
        curve = result.curve(rows, getattr(m, along)[rows], along=along).length
        off = rows[np.isfinite(fitted[rows]) & (np.abs(fitted[rows] - curve) * scale[rows] > visible)]
        if len(off):
            look = {"ms": 6, "mew": 2, "color": color, "zorder": 4}
            ax.plot(x[off], fitted[off] * scale[off], "_", label="fitted (own inputs)", **look)


def _check_lengths(result: "FitResult") -> None:
    if result.main.extent(result.measurements) is not None:
        raise ValueError("the measurements are forces of a sequence, not lengths: use plot.fit or plot.fit_sequence")


@drawn
def length_versus_stiffness(result: "FitResult", *, ax: "Axes | None" = None) -> "Axes":
    """Draw ℓ/H against stiffness for up to six measured heights.

    Of the block, or of its push. With the measured ℓ/H, and the interval of the stiffness, a decade and a half around which is
    drawn; dashed, and a ValueError, as in `fit_lengths`.
    """
    _check_lengths(result)
    ax = axes(ax)
    c = colours(ax)
    m, q, (scale, unit), along = result.measurements, result.parameters, result.measurements.unit, result.groups[0]
    at = getattr(m, along)
    theta = _around(result)
    stiffness = np.exp(theta)
    # in the order of the axis, and of the curves where heights are equal
    conditions = sorted(alike(result, result.theta), key=lambda rows: round(float(at[rows[0]]), 9))
    shown = [conditions[i] for i in np.unique(np.linspace(0, len(conditions) - 1, MOST_CURVES).round().astype(int))]
    first = np.array([rows[0] for rows in shown])
    one = q.inputs.at(result.theta).take(first)
    differ = differing(one if along == "height" else one.without("log_push"), [np.full(len(shown), True)])
    largest, highest, any_again = np.zeros_like(theta), 0.0, False
    palette = (*c.data[:-1], c.ink)  # the last two blues look alike
    places = [[equation(along, float(at[i] * scale[i]), unit)] if np.ptp(at[first]) > 0 or not differ else [] for i in first]
    labels = [", ".join([*place, *(f"{sign} = {x[i]:.3g}" for sign, x in differ)]) for i, place in enumerate(places)]
    for color, rows, label in zip(palette, shown, told_apart(result, labels, shown), strict=False):
        i, name = rows[0], label + (f" ({len(rows)}×)" if len(rows) > 1 else "")
        curve = result.curve(i, at[i], theta[:, None], along=along)
        share, again = curve.length[:, 0] / m.height[i], curve.breaks_again[:, 0]
        dashed_where(ax, stiffness, share, again, color=color, label=name)
        low, high = _measured_share(result, rows)
        if high < np.inf:
            ax.axhspan(low, high, color=color, alpha=0.2, lw=0)
        else:
            ax.axhline(low, color=color, lw=1, ls=":")
        largest, any_again = np.maximum(largest, share), any_again or bool(again.any())
        highest = max(highest, high if high < np.inf else low)
    name, level = result.names[0], f"{BAND_LEVEL:.0%} interval"
    wider = result.intervals_with_inputs.get(name, {}).get(BAND_LEVEL, [])
    of_lengths = f"{BAND_LEVEL:.0%}, lengths only" if wider else level
    for pieces, alpha, label in (
        (wider, 0.2, f"{BAND_LEVEL:.0%}, total"),
        (result.intervals[name][BAND_LEVEL], 0.35, of_lengths),
    ):
        for piece in pieces:
            ax.axvspan(piece.low, piece.high, facecolor=c.grey, edgecolor=c.ink, alpha=alpha, lw=0.8, label=label)
    ax.axvline(result.values[result.names[0]], color=c.ink, lw=1, ls=":", label=named_best(result))
    ax.set_xscale("log")
    if (top := largest.max()) > 0:
        # from where a precursor reaches a hundredth of the longest
        ax.set_xlim(*stiffness[np.flatnonzero(largest > 0.01 * top)[[0, -1]]])
        ax.set_ylim(0, 1.1 * max(top, highest))
    name_axis(q.free[0], ax.xaxis)
    ax.set_ylabel(r"length over height, $\ell/H$")
    kinds = np.array(m.kind)[np.concatenate(shown)]
    bands = [text for kind, text in (("length", "measured ± σ"), ("whole", "counted contacts")) if kind in kinds]
    said = [f"Bands: {' or '.join(bands)}"] * bool(bands) + ["Dotted: at least this long"] * ("at_least" in kinds)
    said += [f"{len(shown)} of {len(conditions)} conditions"] * (len(shown) < len(conditions))
    legend_above(ax, handles_of(ax, again=any_again), columnspacing=0.8, handlelength=1.2, title="\n".join(said))
    return ax


def _around(result: "FitResult") -> np.ndarray:
    """Logarithms of stiffnesses around those that the lengths allow, for curves."""
    q = result.parameters
    pieces = result.intervals[result.names[0]][BAND_LEVEL]
    ends = np.log([end for piece in pieces for end in (piece.low, piece.high)] or [result.values[result.names[0]]])
    reach = AROUND * np.log(10)
    return np.linspace(max(q.low[0], ends.min() - reach), min(q.high[0], ends.max() + reach), 301)


def _measured_share(result: "FitResult", rows: np.ndarray) -> tuple[float, float]:
    """Range of ℓ/H measured under one condition.

    Mean ± standard error of lengths; all that counts hold; else no upper end.
    """
    m, kind = result.measurements, np.array(result.measurements.kind)[rows]
    measured, counted = rows[kind == "length"], rows[kind == "whole"]
    if len(measured):
        weight = 1 / result.sigma[measured] ** 2
        mean, error = np.average(m.length[measured], weights=weight), weight.sum() ** -0.5
        low, high = mean - error, mean + error
    elif len(counted):
        low, high = m.length[counted].min() - 1, m.length[counted].max()
    else:
        low, high = m.length[rows].max(), np.inf
    return float(low / m.height[rows[0]]), float(high / m.height[rows[0]])
