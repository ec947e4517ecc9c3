"""Pictures of a fit."""

import itertools
import textwrap
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.observables.sequence import record_of
from slippulse_jax.inference.result.predicted import alike
from slippulse_jax.inference.result.report import title
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.intervals import LEVELS, profile_2d
from slippulse_jax.inference.table.columns import READINGS
from slippulse_jax.plot.labels import DISTANCE_MM, EXTENT, OVER_LOAD, POSITION, as_written, axis_label, equation, printed
from slippulse_jax.plot.style import (
    COLUMN,
    FRAMELESS,
    NARROW,
    PAGE,
    SMALL,
    Colours,
    axes,
    colours,
    dashed_where,
    drawn,
    handles_of,
    label_decades,
    legend_above,
    letter_panels,
    new_figure,
    width_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

    from slippulse_jax.inference.fit import FitResult
    from slippulse_jax.inference.model.series import BlockSeries, Followed
    from slippulse_jax.inference.parameters import Free
    from slippulse_jax.inference.result.predicted import LengthCurve
    from slippulse_jax.inference.table.measurements import Gauges

ONE_SIGMA, BAND_LEVEL = LEVELS
MOST_CURVES = 6
MARKERS, BEYOND = "osDXv<>P", "^"
"""Of specimens, and of fronts without arrest."""
MEASURED = "measured"
"""Name of the measurements where no specimens are told apart."""
CAPTION = 132
"""Most characters per line of a caption that fits a page of 170 mm."""
SPANNING = "D"
"""Of the event of a sequence that spans the block."""
DRAWS = 40
"""Series of which 95 % lie in the band of a sequence."""
AROUND = 1.5
"""Decades of stiffness that are drawn on either side of its interval."""
BESIDE: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": SMALL, "annotation_clip": False}
"""Of words at the right of the Axes."""
GAUGE_UNITS = {"slip": (1e6, "slip (µm)"), "stress": (1e-6, "contact stress, $t$ (MPa)")}


def fit(result: "FitResult", *, caption: bool = False, width: float | None = None, ax: "Axes | None" = None) -> "Figure":
    """Draw a fit: lengths, residuals, and length versus stiffness or profiles.

    Lengths are drawn against height; the extent of a sequence against the force (`fit_sequence`), its events by another
    function (`sequence_events`). A single stiffness is drawn against the lengths. Of several parameters the profiles of the
    first four are drawn, without those that a prior holds if there are others; `fit_profiles` draws all.

    Parameters
    ----------
    result : FitResult
    caption : bool
        Whether to write result, verdict, material and specimens above the panels.
    width : float, optional
        Of the figure, in mm; by default that of a page. In a column the panels stand one below the other.
    ax : matplotlib.axes.Axes, optional
        One of a grid; the panels take its place.
    """
    names, wide = _determined(result)[:4], width_of(width, ax)
    sequence, beside = result.main.extent(result.measurements) is not None, wide >= NARROW
    one = len(result.parameters.free) == 1 and "stiffness" in names[0] and not sequence
    most = round(CAPTION * wide / PAGE)
    heading = [as_written(line, most) for text in title(result, most) for line in textwrap.wrap(text, most)] if caption else []
    # heights of lengths with residuals, and of other panels
    left, each = 2.7 + 0.6 * (sequence or not beside), 2.1 if one else 1.6
    high = max(left, each * len(names)) if beside else left + each * len(names)
    with new_figure(wide, high + 0.12 * len(heading), ax) as figure:
        if caption:
            figure.suptitle("\n".join(heading), x=0.01, ha="left", fontsize=SMALL)
        if beside:
            grid = figure.add_gridspec(2, 2, height_ratios=[3, 1])
            places, right = [grid[0, 0], grid[1, 0]], grid[:, 1]  # where one panel is level with the lengths
        else:
            grid = figure.add_gridspec(2, 1, height_ratios=[left, each * len(names)])
            places, right = [*grid[0].subgridspec(2, 1, height_ratios=[3, 1])], grid[1]
        above = figure.add_subplot(places[0])
        others = [figure.add_subplot(place) for place in (right.subgridspec(len(names), 1) if len(names) > 1 else [right])]
        below = figure.add_subplot(places[1])
        (fit_sequence if sequence else fit_lengths)(result, ax=above)
        residuals(result, along_height=True, ax=below)
        if not sequence:
            above.set_xlabel("")
            above.tick_params(labelbottom=False)
            below.set_xlim(above.get_xlim())
        if one:
            length_versus_stiffness(result, ax=others[0])
        else:
            _profiles(result, list(zip(names, others, strict=True)))
        letter_panels(above, below, *others)
        if ax is None:  # with room for the legends
            legends = [legend.get_window_extent().height / figure.dpi for a in figure.axes if (legend := a.get_legend())]
            figure.set_figheight(figure.get_figheight() + (max if beside else sum)(legends))
    return figure


def _determined(result: "FitResult") -> list[str]:
    """Names of requested parameters that no prior holds, else all.

    One does if the standard error is more than half of its deviation.
    """
    q, covariance = result.parameters, result.covariance
    prior = np.array([one.prior_sigma for one in q.free])
    error = np.full(len(prior), np.inf) if covariance is None else np.sqrt(np.diag(covariance))
    held = np.isfinite(prior) & (error > 0.5 * prior)
    return [name for name in result.names if not held[q.index(name)]] or result.names


def _profiles(result: "FitResult", panels: "list[tuple[str, Axes]]") -> None:
    """Draw profiles one below the other, under one legend."""
    entries: dict[str, Any] = {}
    for name, panel in panels:
        _profile(result, name, panel)
        if len(panels) > 1:
            panel.set_ylabel("rise of\nthe deviance")
        if legend := panel.get_legend():
            for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True):
                entries.setdefault(text.get_text(), handle)
            legend.remove()
    every = result.measurements.option("--profiles FILE", "sp.plot.fit_profiles(result)")
    some = f"{len(panels)} of {len(result.names)} parameters; all by {every}"
    head = textwrap.fill(some, 48) if len(panels) < len(result.names) else None
    legend_above(panels[0][1], [*entries.values()], most=2, labels=[*entries], title=head)


def _profile(result: "FitResult", name: str, ax: "Axes") -> None:
    """Draw a profile in the colour of its specimen's curve, if any."""
    specimen = result.measurements.specimen
    own = [color for color, rows in _curves(result, ax) if specimen and f"[{specimen[rows[0]]}" in name]
    profile(result, name, ax=ax, color=own[0] if len(own) == 1 else None)


def fit_profiles(result: "FitResult", *, width: float | None = None, ax: "Axes | None" = None) -> "Figure":
    """Draw the profile of every fitted parameter, and the residuals.

    `width` in mm and `ax` are those of `fit`.
    """
    count = len(result.names) + 1
    wide = width_of(width, ax, PAGE * min(max(count, 2), 3) / 3)
    columns = min(count, 3 if wide > 0.9 * PAGE else 2 if wide >= NARROW - 0.5 else 1)
    rows = -(-count // columns)
    with new_figure(wide, 2.3 * rows, ax) as figure:
        panels = np.ravel(figure.subplots(rows, columns, squeeze=False))
        for name, panel in zip(result.names, panels, strict=False):
            _profile(result, name, panel)
        residuals(result, ax=panels[count - 1])
        for unused in panels[count:]:
            unused.set_visible(False)
        letter_panels(*panels[:count])
    return figure


def corner(
    result: "FitResult", samples: Any = None, *, nodes: int = 61, width: float | None = None, ax: "Axes | None" = None
) -> "Figure":
    """Draw the confidence regions of every pair of fitted parameters.

    `samples` and `nodes` are those of `confidence_region`; `width` in mm and `ax` are those of `fit`. Three parameters need the
    width of a page.
    """
    names = result.names
    wide = width_of(width, ax, max(2.2 * len(names), COLUMN))
    entries: dict[str, Any] = {}
    with new_figure(wide, 0.9 * max(wide, COLUMN), ax) as figure:
        panels = figure.subplots(len(names), len(names), squeeze=False)
        for (row, column), panel in np.ndenumerate(panels):
            if column > row:
                panel.set_visible(False)
                continue
            if column == row:
                _profile(result, names[row], panel)
            else:
                confidence_region(result, names[column], names[row], samples, nodes=nodes, ax=panel)
                panel.set_title("")
            panel.set_xlabel(panel.get_xlabel() if row == len(names) - 1 else "")
            panel.set_ylabel("" if 0 < column < row else panel.get_ylabel())
            if wide < 1.9 * len(names):
                _abridge(panel)
            if (legend := panel.get_legend()) and len(names) > 1:
                entries |= {
                    text.get_text(): handle for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True)
                }
                legend.remove()
        if entries:  # in the empty corner
            figure.legend([*entries.values()], [*entries], **FRAMELESS, loc="upper right")
    return figure


def _abridge(panel: "Axes") -> None:
    """Label a small panel by symbols, with few ticks."""
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_label_text(axis.get_label_text().split(", ", 1)[-1].replace(" (", "\n(").replace(" the", "\nthe"))
        axis.get_label().set_fontsize(SMALL)
    panel.locator_params(nbins=2)
    panel.tick_params(labelsize=6)
    for text in panel.texts:
        text.set_visible(False)


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
def fit_lengths(result: "FitResult", *, ax: "Axes | None" = None) -> "Axes":
    """Draw measured lengths against height, and the fitted curve.

    Against the height of the push where one block was pushed at several. With its 95 % band, and the lengths that no stiffness
    gives. The curve is dashed where the edge contact breaks again before the front stops, so that the event goes on. Ticks mark
    the fitted lengths that lie off it, where inputs differ between the points of a curve. Points are open where several are at
    the same place. A ValueError for a sequence.
    """
    from matplotlib.patches import Patch

    _check_lengths(result)
    ax = axes(ax)
    c = colours(ax)
    m = result.measurements
    (scale, unit), along, groups = m.unit, result.groups[0], _curves(result, ax)
    at = getattr(m, along)
    top, curves, bands = 0.0, [], []
    for (color, rows), name in zip(groups, _curve_names(result, groups), strict=True):
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
        for low, high in () if result.rejected else curve.bands:
            ax.fill_between(x, low * size, high * size, color=color, alpha=0.25, lw=0)
            bands.append(np.max(high - low) * size)
        top = max(top, 1.12 * np.nanmax(longest, initial=0.0), 1.05 * (m.length * scale)[rows].max())
    x, longest, _ = max(curves, key=lambda one: np.nanmax(one[1], initial=0.0))
    label = "longer than possible"
    beyond = ax.fill_between(x, longest, 10 * np.nanmax(longest, initial=0.0), fc=c.grey, alpha=0.15, lw=0, label=label)
    _draw_data(result, ax)
    _draw_fitted(result, ax, 0.01 * top)
    ax.set(xlabel=axis_label(along, unit), ylabel=axis_label("length", unit))
    ax.margins(x=0, y=0)
    ax.set_ylim(0, top)
    handles = handles_of(ax, again=any(again for *_, again in curves))
    if not result.rejected:
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


def _draw_data(result: "FitResult", ax: "Axes") -> None:
    m, kind, scale = result.measurements, np.array(result.measurements.kind), result.measurements.unit[0]
    x, y, sigma = _places(result), m.length * scale, result.sigma * scale
    style: dict[str, Any] = {"capsize": 2, "zorder": 3, "linestyle": "none", "elinewidth": 0.8, **_open_where_shared(result)}
    thick: dict[str, Any] = style | {"elinewidth": 3}
    for marker, color, name, rows in _series(result, ax):
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
    m, fitted, along, x = result.measurements, result.fitted, result.groups[0], _places(result)
    scale = m.unit[0]
    for color, rows in _curves(result, ax):
        curve = result.curve(rows, getattr(m, along)[rows], along=along).length
        off = rows[np.isfinite(fitted[rows]) & (np.abs(fitted[rows] - curve) * scale[rows] > visible)]
        if len(off):
            look = {"ms": 6, "mew": 2, "color": color, "zorder": 4}
            ax.plot(x[off], fitted[off] * scale[off], "_", label="fitted (own inputs)", **look)


def _curves(result: "FitResult", ax: "Axes") -> list[tuple[str, np.ndarray]]:
    """Colour and measurements of each curve."""
    groups = result.groups[1]
    return list(zip(_palette(colours(ax), len(groups)), groups, strict=True))


def _series(result: "FitResult", ax: "Axes") -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Marker, colour, name and measurements of each specimen per curve.

    The colour is the curve's if there are several.
    """
    curves, specimen = _curves(result, ax), np.array(result.measurements.specimen)
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


def _places(result: "FitResult") -> np.ndarray:
    """Places of measurements along the axis, in the table's unit."""
    return getattr(result.measurements, result.groups[0]) * result.measurements.unit[0]


def _open_where_shared(result: "FitResult") -> dict[str, Any]:
    """Open markers if several measurements are at one place of a curve."""
    at = _places(result)
    shared = any(len(np.unique(at[rows])) < len(rows) for rows in result.groups[1])
    return {"mfc": "none"} if shared else {}


def _check_lengths(result: "FitResult") -> None:
    if result.main.extent(result.measurements) is not None:
        raise ValueError("the measurements are forces of a sequence, not lengths: use plot.fit or plot.fit_sequence")


@drawn
def fit_sequence(result: "FitResult", *, ax: "Axes | None" = None) -> "Axes":
    """Draw the extent of a sequence of precursors against the force.

    As experiments report it: the extent over the length of the block, against the force over the normal load or, where that is
    unknown, the force. Thick errors are those stated, thin ones contain those of the model. The line is the series at the best
    fit: how far the front got, and at which force. In the band are 95 % of `DRAWS` series with parameters that the data allow.
    Ticks are the fitted forces, means over many series, each of which has its own order of breaks. A ValueError for lengths.
    """
    size, name = _force_of(result)
    ax = axes(ax)
    m, curves, draws, place = result.measurements, _curves(result, ax), _draws(result), np.arange(0.5, 256) / 256
    extent = record_of(m).place
    every = _followed(result, np.concatenate([result.theta[None], draws]))
    for (color, rows), (_, found) in zip(curves, every, strict=True):
        farther, reached = found.advance[0] > 0, np.minimum(found.reached[0], 1.0)
        stairs = np.repeat(found.force[0][farther], 2), np.append(0.0, np.repeat(reached[farther], 2)[:-1])
        of, last = f"{as_written(m.sequence[rows[0]])}: " if len(curves) > 1 else "", rows is curves[-1][1]
        ax.plot(*stairs, color=color, lw=1, label=of + _best(result))
        if len(draws):
            band = np.quantile(found.force_at(place, 0 * place)[0, 1:], [0.5 - BAND_LEVEL / 2, 0.5 + BAND_LEVEL / 2], axis=0)
            label = f"{BAND_LEVEL:.0%} band of series" if last else None
            ax.fill_betweenx(place, *band, color=color, alpha=0.25, lw=0, label=label)
        label = "fitted: mean of series" if last else None
        ax.plot((result.fitted * size)[rows], extent[rows], "|", color=color, ms=7, mew=1.5, label=label)
    force, used = m.or_zero("force") * size, result.sigma * size
    stated, along = m.or_zero("force_sigma") * size, np.nan_to_num(m.sigma) / m.or_zero("block_length")
    spans = np.array(m.kind) == "at_least"
    for marker, color, what, rows in _series(result, ax):
        shown = (rows[~spans[rows]], marker, 3.5, f"{what} ± σ"), (rows[spans[rows]], SPANNING, 5, "spanning ± σ")
        for own, sign, wide, label in (one for one in shown if one[0].size):
            at, look = (force[own], extent[own]), {"color": color, "zorder": 3}
            ax.errorbar(*at, along[own], stated[own], fmt=sign, ms=wide, capsize=2, label=label, **look)
            ax.errorbar(*at, None, used[own], fmt="none", elinewidth=0.6, label="± σ with the model's", **look)
    ax.set(xlabel=name, ylabel=EXTENT, ylim=(0, 1.06))
    legend_above(ax, most=2)
    return ax


def _draws(result: "FitResult") -> np.ndarray:
    """Draw θ by importance, (`DRAWS`, p); none of a rejected fit."""
    if result.rejected or result.covariance is None:
        return np.empty((0, len(result.theta)))
    random, q = np.random.default_rng(0), result.parameters
    error = np.sqrt(2 * np.diag(result.covariance))
    narrowed = np.minimum(error, q.high - q.low) / error  # where hardly anything is known
    covariance = 2 * result.covariance * np.outer(narrowed, narrowed)
    theta = random.multivariate_normal(result.theta, covariance, 50 * DRAWS, method="eigh")
    theta = np.vstack([result.theta, theta[((theta >= q.low) & (theta <= q.high)).all(axis=1)]])
    off = theta - result.theta
    log = np.einsum("ti,ij,tj->t", off, np.linalg.pinv(covariance), off) / 2 - result.problem(theta).value
    weight = np.exp(log - np.nanmax(log), where=log > -np.inf, out=np.zeros(len(log)))
    return theta[random.choice(len(theta), DRAWS, p=weight / weight.sum())]


def _force_of(result: "FitResult") -> tuple[np.ndarray, str]:
    """Drawn force per N/m, and its label."""
    m = result.measurements
    if result.main.extent(m) is None:
        raise ValueError("the measurements are lengths, not forces of a sequence: use plot.fit or plot.fit_lengths")
    if m.normal_load is not None:
        return 1 / m.normal_load, OVER_LOAD
    return m.unit_of_force[0], axis_label("force", m.unit_of_force[1])


def _followed(result: "FitResult", theta: np.ndarray) -> "Iterator[tuple[np.ndarray, Followed]]":
    """Rows of each sequence, and its series at θ, (t, p)."""
    (size, _), (data, *_) = _force_of(result), result.problem.observed
    front, inputs, record = cast("BlockSeries", result.parameters.front), data.inputs.at(theta), record_of(result.measurements)
    scale, friction = np.exp(data.scale(theta)), inputs.get("friction")
    for run, (found, *_) in enumerate(front.follow(inputs)):
        rows = np.flatnonzero(record.run == run)
        size_of = size[rows[0]] * friction[:, run] * scale[:, rows[0]]
        yield rows, found._replace(force=found.force * size_of[:, None])


@drawn
def sequence_events(result: "FitResult", name: str | None = None, *, ax: "Axes | None" = None) -> "Axes":
    """Draw which part of the interface breaks at which load and force.

    Each event of the series at the best fit is a bar from the first to the last contact that breaks. Upwards is the load,
    which only rises, while forces return to what they were. Of several sequences `name` chooses one; by default the first. A
    ValueError for lengths, and for a name that is not there.
    """
    _, label = _force_of(result)
    names = result.measurements.sequence or ("",) * len(result.measurements)
    if name is not None and name not in names:
        raise ValueError(f"name = {name!r}: one of {', '.join(map(repr, sorted({*names})))}")
    ax = axes(ax)
    every = [(names[rows[0]], found) for rows, found in _followed(result, result.theta[None])]
    own, found = next(one for one in every if name in (None, one[0]))
    events = found.end[0] > 0
    force, load, begin, end = (x[0][events] for x in (found.force, found.load, found.begin, found.end))
    bars = ax.hlines(load, begin, end, array=force, cmap="cividis", lw=1.5)
    ax.set(xlabel=f"{POSITION}, $x/L$", ylabel=axis_label("load", "u_s"), xlim=(0, 1.02))
    ax.set_title(f"Events: {_best(result)}" + f", {as_written(own)}" * bool(own))
    ax.figure.colorbar(bars, ax=ax, label=label)
    return ax


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
    differ = _differing(one if along == "height" else one.without("log_push"), [np.full(len(shown), True)])
    largest, highest, any_again = np.zeros_like(theta), 0.0, False
    palette = (*c.data[:-1], c.ink)  # the last two blues look alike
    places = [[equation(along, float(at[i] * scale[i]), unit)] if np.ptp(at[first]) > 0 or not differ else [] for i in first]
    labels = [", ".join([*place, *(f"{sign} = {x[i]:.3g}" for sign, x in differ)]) for i, place in enumerate(places)]
    for color, rows, label in zip(palette, shown, _told_apart(result, labels, shown), strict=False):
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
    ax.axvline(result.values[result.names[0]], color=c.ink, lw=1, ls=":", label=_best(result))
    ax.set_xscale("log")
    if (top := largest.max()) > 0:
        # from where a precursor reaches a hundredth of the longest
        ax.set_xlim(*stiffness[np.flatnonzero(largest > 0.01 * top)[[0, -1]]])
        ax.set_ylim(0, 1.1 * max(top, highest))
    _name(q.free[0], ax.xaxis)
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


def _told_apart(result: "FitResult", labels: list[str], shown: list[np.ndarray]) -> list[str]:
    """Add specimens, or lines of the table, to labels that are alike."""
    m = result.measurements
    named = [", ".join(dict.fromkeys(as_written(m.specimen[row]) for row in rows)) if m.specimen else "" for rows in shown]
    for more in (named, [as_written(m.place(rows[0])) for rows in shown]):
        alike = [labels.count(label) > 1 for label in labels]
        labels = [f"{label}, {own}" if again and own else label for label, again, own in zip(labels, alike, more, strict=True)]
    return labels


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


@drawn
def residuals(result: "FitResult", *, along_height: bool = False, ax: "Axes | None" = None) -> "Axes":
    """Draw (fitted − measured)/σ against the fitted length.

    Or against what `fit_lengths` has along its axis. Those of a sequence are of its forces, against the extent, and of first
    lengths.
    """
    ax = axes(ax)
    c = colours(ax)
    m, sigma, extent = result.measurements, result.sigma, result.main.extent(result.measurements)
    further, beyond = [], (BEYOND, 6)
    if extent is not None:
        label, x, further, beyond = EXTENT, extent, result.further, (SPANNING, 5)
        ax.set_xlim(0, 1.06)
    elif along_height:
        label, x = axis_label(result.groups[0], m.unit[1]), _places(result)
    else:
        label, x = axis_label("length", m.unit[1]).replace("precursor", "fitted"), result.fitted * m.unit[0]
    ax.axhspan(-1, 1, color=c.blue, alpha=0.12, lw=0, label="± σ")
    ax.axhline(0, color=c.grey, lw=0.8)
    limit, look = np.array(m.kind) == "at_least", _open_where_shared(result) if along_height and extent is None else {}
    for marker, color, _, rows in _series(result, ax):
        for own, sign, size in ((rows[~limit[rows]], marker, None), (rows[limit[rows]], *beyond)):
            ax.plot(x[own], result.residuals[own], sign, ms=size, color=color, **look)
        for one in further:
            own, first = np.isin(one.measurement, rows), one.measurement
            ax.plot(x[first[own]], one.residuals[own], marker, color=color, mfc="none", label="of the first length")
    per = "σ"
    ax.set_xlabel(label)
    if not sigma.all():
        per = r"σ, counts: $\lambda_c$" if sigma.any() else r"$\lambda_c$"
    ax.set_ylabel("residual" + ("\n" if along_height and "," in per else " ") + f"({per})")  # a panel below the lengths is low
    reach = max(3.0, 1.15 * float(np.abs(np.concatenate([result.residuals, *(one.residuals for one in further)])).max()))
    ax.set_ylim(-reach, reach)
    if not along_height or further:
        legend_above(ax, title=None if along_height else "residual: fitted − measured")
    else:
        ax.margins(x=0.12)
        corner: dict[str, Any] = BESIDE | {"va": "bottom", "ha": "right", "xycoords": ax.get_yaxis_transform()}
        ax.annotate("± σ", (1, 1), (-1, 1), **corner, color=c.ink)
    return ax


@drawn
def profile(result: "FitResult", name: str, *, color: str | None = None, ax: "Axes | None" = None) -> "Axes":
    """Draw the profile of the deviance along one parameter.

    Blue unless a color is given. All others are fitted anew; lines mark the levels of its intervals, and how far these reach
    where they are those of simulated measurements, for which no level is the same everywhere. Dashed as in `fit_lengths`, for
    the lengths on which the parameter acts.
    """
    ax = axes(ax)
    c = colours(ax)
    curve, one, q, j = result.curves[name], result.parameters.named(name), result.parameters, result.parameters.index(name)
    limit = 2.2 * result.rise(BAND_LEVEL)
    x, rise = one.value(curve.node), curve.deviance - result.deviance
    inputs = q.inputs.at(curve.theta).map(lambda each: each[:, q.rows_of(j)])
    again = np.array([each.any() for each in q.front.breaks_again(inputs.ravel()).reshape(inputs.poisson.shape)])
    label = "profile" + " (rejected)" * result.rejected
    dashed_where(ax, x, rise, again, color=color or c.blue, marker=".", ms=3, label=label)
    covariance, judged = result.covariance, not result.rejected
    if covariance is not None and judged:
        error = np.sqrt(covariance[j, j])
        off = np.linspace(-3, 3, 101)
        parabola = one.value(result.theta[j] + off * error), result.rise(ONE_SIGMA) * off**2
        ax.plot(*parabola, color=c.grey, ls="-.", lw=1, label="from covariance")
    for level in LEVELS if judged else ():  # the rise of a rejected fit measures its misfit
        height = result.rise(level)
        if result.calibrated:
            for piece in result.intervals[name].get(level, []):
                ax.plot(piece[:2], [height, height], color=c.ink, lw=1.5, label="interval, simulated")
        else:
            ax.axhline(height, color=c.ink, lw=0.8, ls=":")
        ax.annotate(f"{level:.0%}", (1, height), (2, 0), **BESIDE, xycoords=ax.get_yaxis_transform(), color=c.ink)
    below, wider = curve.node[rise < limit], result.intervals_with_inputs.get(name, {}).get(BAND_LEVEL, []) if judged else []
    for piece in wider:
        ax.plot(piece[:2], [result.rise(BAND_LEVEL)] * 2, color=c.grey, lw=2.5, alpha=0.6, label=f"{BAND_LEVEL:.0%}, total")
        below = np.sort(np.clip([*below, *map(one.theta, piece[:2])], one.low, one.high))
    if len(below) > 1:
        pad = 0.1 * (below[-1] - below[0])
        ax.set_xlim(one.value(max(one.low, below[0] - pad)), one.value(min(one.high, below[-1] + pad)))
        if one.log and below[-1] - below[0] > np.log(10):
            ax.set_xscale("log")
    ax.set_ylim(0, limit)
    _name(one, ax.xaxis)
    ax.set_ylabel("rise of the deviance")
    low, high = ax.get_xlim()
    shown = (x >= low) & (x <= high) & (rise < limit)
    legend_above(ax, handles_of(ax, again=bool(again[shown].any())), most=2)
    return ax


@drawn
def confidence_region(
    result: "FitResult", horizontal: str, vertical: str, samples: Any = None, *, nodes: int = 61, ax: "Axes | None" = None
) -> "Axes":
    """Draw the 68 % and 95 % confidence regions of two parameters.

    All others are fitted anew.

    Parameters
    ----------
    result : FitResult
    horizontal, vertical : str
        Names of the two parameters.
    samples : Samples or array of θ, shape (n, p), or a dict of these by name, optional
        Drawn as points; several in colours of their own, with a legend.
    nodes : int
        Values of each of the two.
    ax : matplotlib.axes.Axes, optional
    """
    ax = axes(ax)
    c = colours(ax)
    q = result.parameters
    i, j = q.index(horizontal), q.index(vertical)
    grids = [_window(result, k, nodes) for k in (i, j)]
    starts = np.array([root.theta for root in result.roots] or [result.theta])[:4]
    surface = profile_2d(result.problem, i, j, grids[0], grids[1], starts)
    rise = surface - result.deviance
    first, second = q.free[i].value(grids[0]), q.free[j].value(grids[1])
    levels = [0, result.rise(ONE_SIGMA, 2), result.rise(BAND_LEVEL, 2)]
    ax.contourf(first, second, rise.T, levels=levels, colors=[c.blue, c.sky], alpha=0.5)
    drawn_from = samples if isinstance(samples, dict) else {} if samples is None else {"": samples}
    for (name, one), color in zip(drawn_from.items(), itertools.cycle((c.ink, c.green, c.purple)), strict=False):
        theta = np.reshape(getattr(one, "theta", one), (-1, len(q.free)))
        x, y = q.free[i].value(theta[:, i]), q.free[j].value(theta[:, j])
        ax.plot(x, y, ".", color=color, ms=1.5, alpha=0.4, label=as_written(name) or None)
    if len(drawn_from) > 1:
        legend_above(ax, markerscale=6)
        for handle in filter(None, cast("Legend", ax.get_legend()).legend_handles):
            handle.set_alpha(1)
    ax.plot(q.free[i].value(result.theta[i]), q.free[j].value(result.theta[j]), "+", color=c.vermilion, ms=8)
    _name(q.free[i], ax.xaxis)
    _name(q.free[j], ax.yaxis)
    regions = "rises of 2.3 and 6.0" if result.rejected else "68% and 95% regions"
    ax.set_title(f"{regions}, + {_best(result)}", pad=6 + (14 if ax.get_legend() else 0))
    return ax


def _window(result: "FitResult", k: int, nodes: int) -> np.ndarray:
    """Values of θ_k around its 95 % interval."""
    one = result.parameters.free[k]
    pieces = result.intervals[one.label][BAND_LEVEL]
    curve = result.curves[one.label]
    near = curve.node[curve.deviance - result.deviance < 2 * result.rise(BAND_LEVEL)]
    low, high = (one.theta(pieces[0].low), one.theta(pieces[-1].high)) if pieces else (near.min(), near.max())
    pad = 0.35 * (high - low)
    return np.linspace(max(one.low, low - pad), min(one.high, high + pad), nodes)


def _name(one: "Free", axis: "Axis") -> None:
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


def _curve_names(result: "FitResult", groups: list[tuple[str, np.ndarray]]) -> list[str]:
    """Name the curves by specimen and what differs within one."""
    one = result.parameters.inputs.at(result.theta).take([rows[0] for _, rows in groups])
    specimen = np.array(result.measurements.specimen or ("",) * len(result.measurements))
    owners = [set(specimen[rows]) for _, rows in groups]
    alone = len(groups) > 1 and len(set(specimen)) > 1 and all(len(owner) == 1 for owner in owners)
    names = [f"{as_written(min(owner))}: {_best(result, min(owner))}" if alone else _best(result) for owner in owners]
    differ = _differing(one, [np.array(names) == name for name in set(names)])
    labels = [", ".join([name, *(f"{sign} = {x[i]:.3g}" for sign, x in differ)]) for i, name in enumerate(names)]
    return _told_apart(result, labels, [rows for _, rows in groups])


def _differing(one: Inputs, alike: list[np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Symbol and values of inputs that differ within selected rows."""
    numbers = {"$k/K$": one.ratio, "ν": one.poisson, r"$\varphi$": one.prestress, "ε": one.threshold_slope}
    if "log_push" in one.more:
        numbers["$h/H$"] = np.exp(one.get("log_push"))
    return [(sign, x) for sign, x in numbers.items() if any(np.ptp(x[which]) > 1e-9 * np.abs(x).max() for which in alike)]


def _best(result: "FitResult", specimen: str = "") -> str:
    """Name the curve of least deviance.

    Not a fit if the model is rejected, nor the best if others fit equally.
    """
    if result.rejected:
        return "closest (rejected)"
    own = [one.identifiability for name, one in result.verdicts.items() if specimen and f"[{specimen}]" in name]
    alike = {Identifiability.SEVERAL_ROOTS, Identifiability.EQUAL, Identifiability.UNINFORMATIVE}
    return "one that fits" if alike & set(own or [result.identifiability]) else "best fit"


@drawn
def observable(result: "FitResult", name: str, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the data of one observable, and what is fitted.

    As the observable draws itself, by its name; a ValueError for one without data.
    """
    one = next((one for one in result.data if one.observable == name), None)
    if one is None:
        raise ValueError(f"name = {name!r}: one of {', '.join(one.observable for one in result.data)}")
    result.observable(name).draw(result, one, ax := axes(ax))
    legend_above(ax)
    return ax


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
