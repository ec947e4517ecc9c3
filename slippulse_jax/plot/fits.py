"""Pictures of a fit: all panels, residuals, profiles and regions."""

import itertools
import textwrap
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from slippulse_jax.inference.result.report import title
from slippulse_jax.inference.search.intervals import LEVELS, profile_2d
from slippulse_jax.plot.labels import EXTENT, as_written, axis_label
from slippulse_jax.plot.lengths import fit_lengths, length_versus_stiffness
from slippulse_jax.plot.marks import BEYOND, curves_of, marked, name_axis, named_best, open_where_shared, places_of
from slippulse_jax.plot.sequences import SPANNING, fit_sequence
from slippulse_jax.plot.style import (
    COLUMN,
    FRAMELESS,
    NARROW,
    PAGE,
    SMALL,
    axes,
    colours,
    dashed_where,
    drawn,
    handles_of,
    legend_above,
    letter_panels,
    new_figure,
    width_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

    from slippulse_jax.inference.fit import FitResult

ONE_SIGMA, BAND_LEVEL = LEVELS
CAPTION = 132
"""Most characters per line of a caption that fits a page of 170 mm."""
BESIDE: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": SMALL, "annotation_clip": False}
"""Of words at the right of the Axes."""


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
    own = [color for color, rows in curves_of(result, ax) if specimen and f"[{specimen[rows[0]]}" in name]
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
        label, x = axis_label(result.groups[0], m.unit[1]), places_of(result)
    else:
        label, x = axis_label("length", m.unit[1]).replace("precursor", "fitted"), result.fitted * m.unit[0]
    ax.axhspan(-1, 1, color=c.blue, alpha=0.12, lw=0, label="± σ")
    ax.axhline(0, color=c.grey, lw=0.8)
    limit, look = np.array(m.kind) == "at_least", open_where_shared(result) if along_height and extent is None else {}
    for marker, color, _, rows in marked(result, ax):
        for own, sign, size in ((rows[~limit[rows]], marker, None), (rows[limit[rows]], *beyond)):
            ax.plot(x[own], result.residuals[own], sign, ms=size, color=color, **look)
        for number, one in enumerate(further):  # the larger, the later, as several may lie on one another
            own, at, noun = np.isin(one.measurement, rows), one.measurement, result.observable(one.observable).noun
            ax.plot(x[at[own]], one.residuals[own], marker, ms=6 + 3 * number, color=color, mfc="none", label=f"of the {noun}")
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
    name_axis(one, ax.xaxis)
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
    name_axis(q.free[i], ax.xaxis)
    name_axis(q.free[j], ax.yaxis)
    regions = "rises of 2.3 and 6.0" if result.rejected else "68% and 95% regions"
    ax.set_title(f"{regions}, + {named_best(result)}", pad=6 + (14 if ax.get_legend() else 0))
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
