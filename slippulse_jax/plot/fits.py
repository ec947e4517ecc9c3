"""Pictures of a fit."""

import itertools
import re
import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri

from slippulse_jax.inference.columns import READINGS
from slippulse_jax.inference.fitted import LEVELS, Identifiability
from slippulse_jax.inference.inputs import Inputs
from slippulse_jax.inference.intervals import profile_2d
from slippulse_jax.inference.observables import PREDICTED
from slippulse_jax.inference.parameters import attainable_of
from slippulse_jax.inference.report import TIED, folded, sentences, value_in_words, value_with_error
from slippulse_jax.plot.labels import axis_label, equation, printed
from slippulse_jax.plot.style import (
    ABOVE,
    COLUMN,
    PAGE,
    Colours,
    axes,
    colours,
    dashed_where,
    drawn,
    handles_of,
    letter_panels,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from slippulse_jax.inference.fit import FitResult
    from slippulse_jax.inference.measurements import Gauges
    from slippulse_jax.inference.parameters import Free

ONE_SIGMA, BAND_LEVEL = LEVELS
MOST_CURVES = 6
MOST_PROFILES = 4
"""Most profiles next to the lengths; more would be too small to read."""
HELD_BY_PRIOR = 0.5
"""Standard error, over that of the prior, above which the prior determines a parameter."""
WIDEST_LEGEND, BESIDE = 60, 3
"""Most characters per line of a legend, and those that a sample of the line takes up."""
MARKERS, BEYOND = "osDXv<>P", "^"
"""Of specimens, and of fronts without arrest."""
MOST_VALUES = 4
"""Most parameters in a title."""
TITLE, LINE = 140, 0.13
"""Most characters per line of a title, and the height of a line in inches."""
CONSTANTS = {"young": ("E", 1e-9, " GPa"), "poisson": ("ν", 1.0, ""), "correlation_length": ("λc", 1e6, " µm")}
"""Constants of the material in a title, by column: symbol, factor and unit."""
INPUTS = {"height": "log_height", "push_height": "log_push"}
"""Input of the model that is drawn along the axis, by the column of the table."""
GAUGE_POINTS = 801
GAUGE_UNITS = {"slip": (1e6, "slip (µm)"), "stress": (1e-6, "contact stress after arrest (MPa)")}


def fit(result: "FitResult", *, ax: "Axes | None" = None) -> "Figure":
    """Draw a fit: lengths against height with residuals below, and length versus stiffness or the profiles.

    A single stiffness is drawn against the lengths. Of several parameters the profiles of the first four are drawn, without
    those that a prior holds if there are others; `fit_profiles` draws all. The title has the result, the material and the
    specimens. With `ax`, the panels take its place.
    """
    names = _determined(result)[:MOST_PROFILES]
    title = list(_title(result))
    with new_figure(PAGE, max(3.9, 1.5 + 1.4 * len(names)) + LINE * len(title), ax) as figure:
        figure.suptitle("\n".join(title), x=0.01, ha="left", fontsize="small")
        grid = figure.add_gridspec(2, 2, height_ratios=[4, 1])
        above, right = figure.add_subplot(grid[0, 0]), grid[:, 1]  # where one panel is level with the lengths
        others = [figure.add_subplot(place) for place in (right.subgridspec(len(names), 1) if len(names) > 1 else [right])]
        below = figure.add_subplot(grid[1, 0])
        fit_lengths(result, ax=above)
        above.set_xlabel("")
        above.tick_params(labelbottom=False)
        residuals(result, along_height=True, ax=below)
        below.set_xlim(above.get_xlim())
        if len(result.parameters.free) == 1 and "stiffness" in names[0]:
            length_versus_stiffness(result, ax=others[0])
        else:
            _profiles(result, list(zip(names, others, strict=True)))
        letter_panels(above, below, *others)
    return figure


def _determined(result: "FitResult") -> list[str]:
    """Names of the requested parameters that are not inputs, held by their prior; all where no other is left."""
    q, covariance = result.parameters, result.covariance

    def is_held(j: int) -> bool:
        prior = q.free[j].prior_sigma
        return bool(np.isfinite(prior)) and (covariance is None or covariance[j, j] > (HELD_BY_PRIOR * prior) ** 2)

    return [name for name in result.names if not is_held(q.index(name))] or result.names


def _profiles(result: "FitResult", panels: "list[tuple[str, Axes]]") -> None:
    """Draw the profiles of some parameters one below the other, under one legend."""
    first, said = panels[0][1], set()
    for name, panel in panels:
        profile(result, name, ax=panel, color=_of_specimen(result, name, colours(panel)))
        if len(panels) > 2:
            panel.set_ylabel("rise of\nthe deviance")
        legend = panel.get_legend()
        assert legend is not None
        labels = [text.get_text() for text in legend.get_texts()]
        new = [(one, label) for one, label in zip(legend.legend_handles, labels, strict=True) if label not in said]
        said.update(labels)
        if not new:
            legend.remove()
        elif len(new) < len(labels):
            panel.legend(*zip(*new, strict=True), **ABOVE, fontsize="small")
    if len(panels) < len(result.names):
        every = result.measurements.option("--profiles FILE", "sp.plot.fit_profiles(result)")
        legend = first.get_legend()
        assert legend is not None
        legend.set_title(textwrap.fill(f"{len(panels)} of {len(result.names)} parameters; all by {every}", 48))
        legend.set_alignment("left")


def _of_specimen(result: "FitResult", name: str, c: Colours) -> str:
    """Colour of the specimen whose parameter this is, where the lengths have one curve for each; else that of any profile."""
    groups, specimen = _groups(result), result.measurements.specimen
    own = [number for number, rows in enumerate(groups) if specimen and f"[{specimen[rows[0]]}" in name]
    return _of_curve(c, own[0], groups) if len(own) == 1 else c.blue


def _title(result: "FitResult") -> Iterator[str]:
    """Quote the box of the report, and the constants of the material."""
    one_of = {one.label: one for one in result.parameters.free}
    names = [name for name in result.names if not _is_constant(one_of[name])] or result.names
    given = [name for name in names if name in result.given]
    yield from (value_in_words(result, name, result.changes) for name in given[:MOST_VALUES])
    if len(given) > MOST_VALUES:
        yield f"… and {len(given) - MOST_VALUES} more"
    constants = ", ".join(text.replace(" ", TIED) for text in _constants(result))
    yield from folded(" ".join([*sentences(result, result.changes), constants]), TITLE)


def _is_constant(one: "Free") -> bool:
    """Whether a parameter is a material constant that was stated with an error."""
    return one.name in CONSTANTS and np.isfinite(one.prior_sigma)


def _constants(result: "FitResult") -> Iterator[str]:
    """List E, ν and λc; where they have an error, with the fitted value, or the stated one if there is no sound fit."""
    q, covariance = result.parameters, None if _rejected(result) else result.covariance
    for name, (sign, size, unit) in CONSTANTS.items():
        stated = getattr(result.measurements, name)
        each = [j for j, one in enumerate(q.free) if one.name == name]
        if stated is None or not all(_is_constant(q.free[j]) for j in each):
            continue  # a parameter without a prior is a result
        if not each:
            yield f"{sign} = {_ends_of(stated * size)}{unit}"
            continue
        if covariance is None:
            theta, error = [q.free[j].prior_mean for j in each], np.array([q.free[j].prior_sigma for j in each])
        else:
            theta, error = result.theta[each], np.sqrt(np.diag(covariance)[each])
        value = np.array([q.free[j].value(t) for j, t in zip(each, theta, strict=True)]) * size
        error = error * (value if q.free[each[0]].log else size)
        text = value_with_error(value[0], error[0]) if len(each) == 1 else f"{_ends_of(value, 3)} ± {error.max():.2g}"
        yield f"{sign} = {text}{unit} ({'stated' if covariance is None else 'fitted'})"


def _ends_of(x: np.ndarray, digits: int = 4) -> str:
    """Write one number, or the smallest and largest."""
    low, high = (f"{end:.{digits}g}" for end in (x.min(), x.max()))
    return low if low == high else f"{low} to {high}"


def fit_profiles(result: "FitResult", *, ax: "Axes | None" = None) -> "Figure":
    """Draw the profile of every fitted parameter, and the residuals."""
    count = len(result.names) + 1
    columns = min(count, 3)
    rows = -(-count // columns)
    with new_figure(PAGE * max(columns, 2) / 3, 2.4 * rows, ax) as figure:
        panels = np.ravel(figure.subplots(rows, columns, squeeze=False))
        for name, panel in zip(result.names, panels, strict=False):
            profile(result, name, ax=panel, color=_of_specimen(result, name, colours(panel)))
        residuals(result, ax=panels[count - 1])
        for unused in panels[count:]:
            unused.set_visible(False)
        letter_panels(*panels[:count])
    return figure


def corner(result: "FitResult", samples: Any = None, *, nodes: int = 61, ax: "Axes | None" = None) -> "Figure":
    """Draw the confidence regions of every pair of fitted parameters.

    The regions are those of 68 % and 95 %.

    Parameters
    ----------
    result : FitResult
    samples : Samples or array of θ, shape (n, p), or a dict of these by name, optional
        Drawn as points; several in colours of their own, with a legend.
    nodes : int
        Values of each parameter at which the others are fitted anew.
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take.
    """
    names = result.names
    with new_figure(max(2.4 * len(names), COLUMN), 2.2 * len(names), ax) as figure:
        panels = figure.subplots(len(names), len(names), squeeze=False)
        for row, vertical in enumerate(names):
            for column, horizontal in enumerate(names):
                panel = panels[row, column]
                if column > row:
                    panel.set_visible(False)
                    continue
                if column == row:
                    profile(result, vertical, ax=panel, color=_of_specimen(result, vertical, colours(panel)))
                else:
                    confidence_region(result, horizontal, vertical, samples, nodes=nodes, ax=panel)
                    panel.set_title("")
                if row < len(names) - 1:
                    panel.set_xlabel("")
                if 0 < column < row:
                    panel.set_ylabel("")
    return figure


def gauges(result: "FitResult", *, ax: "Axes | None" = None) -> "Figure":
    """Draw gauge readings of slip and stress, and the fitted fields.

    Readings are drawn ± σ, with one colour per precursor.

    Raises
    ------
    ValueError
        If the measurements have no gauges.
    """
    readings = _readings(result)
    names = [name for name in READINGS if readings.there(name).any()]
    with new_figure(PAGE * len(names) / 2, 2.8, ax) as figure:
        panels = np.ravel(figure.subplots(1, len(names), squeeze=False))
        for name, panel in zip(names, panels, strict=True):
            gauge_readings(result, name, ax=panel)
        letter_panels(*panels)
    return figure


@drawn
def fit_lengths(result: "FitResult", *, ax: "Axes | None" = None) -> "Axes":
    """Draw measured lengths against height, and the fitted curve.

    Against the height of the push where one block was pushed at several. With its 95 % band, and the longest lengths possible.
    The curve is dashed where the edge contact breaks again before the front stops, so that the event goes on. Ticks mark the
    fitted lengths that lie off it, where inputs differ between the points of a curve.
    """
    from matplotlib.patches import Patch

    ax = axes(ax)
    c = colours(ax)
    m = result.measurements
    scale, unit = m.unit
    along, at = _abscissa(result)
    groups, names = _groups(result), _group_names(result)
    far, few = at * scale, len(groups) <= MOST_CURVES
    top, any_again, tallest, narrow = 0.0, False, (0.0, far, far), True
    for number, rows in enumerate(groups):
        color, one = _of_curve(c, number, groups), rows[0]
        near = far if few else far[rows]
        height = np.linspace(near.min() * 0.85, near.max() * 1.15, 41) / scale[one]
        low, high = min(0.05 * m.height[one], 0.9 * at[rows].min()), max(0.9 * m.height[one], 1.01 * at[rows].max())
        allowed = (low, high) if along == "push_height" else (1.01, np.inf)
        height = height[(height > allowed[0]) & (height < allowed[1])]
        x, y = height * scale[one], scale[one]
        again = _breaks_again(result, _inputs_at(result, result.theta, rows, height))
        any_again |= bool(again.any())
        dashed_where(ax, x, _lengths_at(result, result.theta, rows, height) * y, again, color=color, label=names[number])
        for low, high in () if _rejected(result) else _bands(result, rows, height):
            ax.fill_between(x, low * y, high * y, color=color, alpha=0.25, lw=0)
            narrow &= bool(np.max(high - low) * y < 0.012 * float(m.length.max() * y))
        longest = _longest(result, height, rows) * y
        ax.plot(x, longest, color=c.grey, lw=0.8)
        tallest = max(tallest, (float(longest.max()), x, longest), key=lambda found: found[0])
        top = max(top, 1.12 * float(longest.max()), 1.05 * float((m.length[rows] * scale[rows]).max()))
    _, x, longest = tallest
    beyond = ax.fill_between(
        x, longest, 10 * longest.max(), color=c.grey, alpha=0.15, lw=0, label="longer than the model allows"
    )
    label = f"{BAND_LEVEL:.0%} band" + " (thinner than the line)" * narrow
    band = Patch(color=c.blue if len(groups) == 1 else c.ink, alpha=0.25, lw=0, label=label)
    _draw_data(result, ax, scale)
    _draw_fitted(result, ax, 0.01 * top)
    ax.set(xlabel=axis_label(along, unit), ylabel=axis_label("length", unit))
    ax.margins(x=0, y=0)
    ax.set_ylim(0, top)
    curves = handles_of(ax, again=any_again)
    if not _rejected(result):
        curves.insert(curves.index(beyond), band)
    ax.legend(
        handles=curves,
        **ABOVE,
        ncols=_columns([str(one.get_label()) for one in curves], most=2),
        fontsize="small",
        title="Lengths and fit",
        alignment="left",
    )
    return ax


def _columns(labels: list[str], most: int) -> int:
    """Number of columns of a legend: as many as fit without pressing panels together."""
    seen = [len(re.sub(r"\\[a-z]+", "x", text.replace("$", ""))) for text in labels]

    def width(columns: int) -> int:
        rows = -(-len(seen) // columns)
        return sum(max(seen[i : i + rows]) for i in range(0, len(seen), rows)) + BESIDE * columns

    return next((columns for columns in range(most, 1, -1) if width(columns) <= WIDEST_LEGEND), 1)


def _draw_data(result: "FitResult", ax: "Axes", scale: np.ndarray) -> None:
    m, kind = result.measurements, np.array(result.measurements.kind)
    x, y = _apart(result), m.length * scale
    sigma = result.sigma * scale
    style: dict[str, Any] = {"capsize": 2, "zorder": 3, "linestyle": "none"}
    labelled = set()
    for marker, color, name, rows in _series(result, colours(ax)):
        plain, whole, beyond = (rows & (kind == one) for one in ("length", "whole", "at_least"))

        def once(text: str) -> str | None:
            new = text not in labelled
            labelled.add(text)
            return text if new else None

        if plain.any():
            ax.errorbar(x[plain], y[plain], sigma[plain], fmt=marker, color=color, label=once(f"{name} ± σ"), **style)
        if whole.any():
            several = len(set(result.measurements.specimen)) > 1
            half, label = scale[whole] / 2, once(f"{name}, counted" if several else "whole contacts")
            ends = y[whole] - half, half + sigma[whole]
            ax.errorbar(x[whole], *ends, fmt="none", elinewidth=3, color=color, label=label, **style)
        if beyond.any():
            ax.plot(x[beyond], y[beyond], BEYOND, color=color, ms=6, label=once("at least this long: no arrest seen"))


def _draw_fitted(result: "FitResult", ax: "Axes", visible: float) -> None:
    """Mark fitted lengths farther than `visible` from the curve, which is drawn for the mean inputs of its points."""
    scale, at, c, groups = result.measurements.unit[0], _abscissa(result)[1], colours(ax), _groups(result)
    x, label = _apart(result), "fitted (own inputs)"
    for number, rows in enumerate(groups):
        fitted, curve = result.fitted.length[rows], _lengths_at(result, result.theta, rows, at[rows])
        off = rows[np.isfinite(fitted) & (np.abs(fitted - curve) * scale[rows] > visible)]
        if len(off):
            color = _of_curve(c, number, groups)
            ax.plot(x[off], result.fitted.length[off] * scale[off], "_", ms=6, mew=2, color=color, zorder=4, label=label)
            label = None


def _series(result: "FitResult", c: Colours) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Marker, colour, name and measurements of each specimen on each curve; the colour is the curve's if there are several."""
    m, groups = result.measurements, _groups(result)
    specimen = np.array(m.specimen or ("",) * len(m))
    names = list(dict.fromkeys(specimen.tolist()))
    named = 1 < len(names) <= len(MARKERS)
    for number, group in enumerate(groups):
        for i, name in enumerate(names if named else [""]):
            rows = np.isin(np.arange(len(m)), group) & ((specimen == name) | (not named))
            color = _of_curve(c, number, groups) if len(groups) > 1 else _of_many(c, i + 1, 1 + len(names) * named)
            if rows.any():
                yield MARKERS[i], color, name if named else "measured", rows


def _of_curve(c: Colours, number: int, groups: list[np.ndarray]) -> str:
    return _of_many(c, number, len(groups)) if len(groups) > 1 else c.blue


def _of_many(c: Colours, number: int, count: int) -> str:
    """One of `count` different colours: from a scale where they are more than the colours for data."""
    if count <= len(c.data):
        return c.data[number]
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return to_hex(colormaps["viridis"](0.95 * number / (count - 1)))


def _apart(result: "FitResult") -> np.ndarray:
    """Places of the measurements along the axis, in the unit of the table; those that coincide on a curve a little apart."""
    x = _abscissa(result)[1] * result.measurements.unit[0]
    step = 0.012 * (np.ptp(x) or 0.3 * np.abs(x).max())
    for rows in _groups(result):
        value, which, count = np.unique(x[rows], return_inverse=True, return_counts=True)
        order = np.array([int((which[:i] == which[i]).sum()) for i in range(len(rows))])
        x[rows] = value[which] + step * (order - (count[which] - 1) / 2) * np.minimum(1, 4 / np.maximum(count - 1, 1))[which]
    return x


def _bands(result: "FitResult", rows: np.ndarray, height: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the band of fitted lengths: over the intervals of one parameter, by error propagation for several."""
    if result.problem.p == 1:
        free = result.parameters.free[0]
        for piece in result.intervals[result.names[0]][BAND_LEVEL]:
            theta = np.linspace(free.theta(piece.low), free.theta(piece.high), 25)
            family = _lengths_over(result, theta[:, None], rows, height)
            yield family.min(axis=0), family.max(axis=0)
        return
    if result.covariance is None:
        return
    middle = _lengths_at(result, result.theta, rows, height)
    step = 1e-3 * np.sqrt(np.diag(result.covariance))
    up, down = (_lengths_over(result, result.theta + side * np.diag(step), rows, height) for side in (1, -1))
    slope = (up - down) / (2 * step[:, None])
    half = float(ndtri((1 + BAND_LEVEL) / 2)) * np.sqrt(np.einsum("pn,pq,qn->n", slope, result.covariance, slope))
    yield np.maximum(middle - half, 0), middle + half


@drawn
def length_versus_stiffness(result: "FitResult", *, ax: "Axes | None" = None) -> "Axes":
    """Draw ℓ/H against stiffness for up to six measured heights of the block, or of its push.

    With the measured ℓ/H, and the interval of the stiffness; dashed as in `fit_lengths`.
    """
    from matplotlib.ticker import LogLocator

    ax = axes(ax)
    c = colours(ax)
    m, q = result.measurements, result.parameters
    scale, unit = m.unit
    theta = np.linspace(q.low[0], q.high[0], 301)
    stiffness = np.exp(theta)
    along, at = _abscissa(result)
    conditions = _conditions(result)
    shown = [conditions[i] for i in np.unique(np.linspace(0, len(conditions) - 1, MOST_CURVES).round().astype(int))]
    one = q.inputs_at(result.theta).take([rows[0] for rows in shown])
    differ = _differing(one if along == "height" else one.without("log_push"), [np.full(len(shown), True)])
    places = np.array([at[rows[0]] for rows in shown])
    largest, highest, any_again = 0.0, 0.0, False
    visible = []
    palette = (*c.data[:-1], c.ink)  # the last two blues look alike
    for number, (color, together) in enumerate(zip(palette, shown, strict=False)):
        i = together[0]
        place = [equation(along, float(at[i] * scale[i]), unit)] if np.ptp(places) > 0 or not differ else []
        name = ", ".join([*place, *(f"{sign} = {x[number]:.3g}" for sign, x in differ)])
        name += f" ({len(together)}×)" if len(together) > 1 else ""
        share = _lengths_over(result, theta[:, None], i, at[i : i + 1])[:, 0] / m.height[i]
        again = _breaks_again(result, _inputs_at(result, theta[:, None], i, at[i : i + 1]))[:, 0]
        any_again |= bool(again.any())
        dashed_where(ax, stiffness, share, again, color=color, label=name)
        low, high = _measured_share(result, together)
        if high < np.inf:
            ax.axhspan(low, high, color=color, alpha=0.2, lw=0)
        else:
            ax.axhline(low, color=color, lw=1, ls=":")
        largest, highest = max(largest, float(share.max())), max(highest, high if high < np.inf else low)
        visible.append(share)
    for n, piece in enumerate(result.intervals[result.names[0]][BAND_LEVEL]):
        label = f"{BAND_LEVEL:.0%} interval" if n == 0 else None
        ax.axvspan(piece.low, piece.high, facecolor=c.grey, edgecolor=c.ink, alpha=0.35, lw=0.8, label=label)
    ax.axvline(result.values[result.names[0]], color=c.ink, lw=1, ls=":", label=_best(result))
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(LogLocator(numticks=8))
    if largest > 0:
        # from where a precursor reaches a hundredth of the longest
        ax.set_xlim(stiffness[np.max(visible, axis=0) > 0.01 * largest][0], stiffness[-1])
        ax.set_ylim(0, 1.1 * max(largest, highest))
    _name(q.free[0], ax.xaxis)
    ax.set_ylabel(r"length over height, $\ell/H$")
    look: dict[str, Any] = ABOVE | {"columnspacing": 0.8, "handlelength": 1.2}
    kinds = np.array(m.kind)[np.concatenate(shown)]
    bands = [text for kind, text in (("length", "measured ± σ"), ("whole", "counted contacts")) if (kinds == kind).any()]
    said = [f"Bands: {' or '.join(bands)}"] * bool(bands) + ["Dotted: at least this long"] * ("at_least" in kinds)
    handles = handles_of(ax, again=any_again)
    columns = _columns([str(one.get_label()) for one in handles], most=3)
    ax.legend(handles=handles, **look, ncols=columns, fontsize="small", title="\n".join(said), alignment="left")
    return ax


def _conditions(result: "FitResult") -> list[np.ndarray]:
    """Group the measurements whose inputs are all equal, in the order of the axis."""
    inputs, at = result.parameters.inputs_at(result.theta), _abscissa(result)[1]
    keys = np.column_stack([np.round(at, 9), np.round(inputs.table(), 9)])
    return sorted(
        _equal_rows(keys), key=lambda rows: (round(float(at[rows[0]]), 9), rows[0])
    )  # as the curves, where heights are equal


def _measured_share(result: "FitResult", rows: np.ndarray) -> tuple[float, float]:
    """Range of ℓ/H measured under one condition: mean ± standard error of lengths; all that counts hold; else no upper end."""
    m, kind = result.measurements, np.array(result.measurements.kind)[rows]
    measured, counted = rows[kind == "length"], rows[kind == "whole"]
    if len(measured):
        weight = 1 / result.sigma[measured] ** 2
        mean, error = (weight * m.length[measured]).sum() / weight.sum(), weight.sum() ** -0.5
        low, high = mean - error, mean + error
    elif len(counted):
        low, high = m.length[counted].min() - 1, m.length[counted].max()
    else:
        low, high = m.length[rows].max(), np.inf
    return float(low / m.height[rows[0]]), float(high / m.height[rows[0]])


@drawn
def residuals(result: "FitResult", *, along_height: bool = False, ax: "Axes | None" = None) -> "Axes":
    """Draw (fitted − measured)/σ against the fitted length, or against what `fit_lengths` has along its axis."""
    ax = axes(ax)
    c = colours(ax)
    scale, unit = result.measurements.unit
    along, at = _abscissa(result) if along_height else ("length", result.fitted.length)
    ax.axhspan(-1, 1, color=c.blue, alpha=0.12, lw=0, label="± σ")
    ax.axhline(0, color=c.grey, lw=0.8)
    x, limit = _apart(result) if along_height else at * scale, np.array(result.measurements.kind) == "at_least"
    for marker, color, _, rows in _series(result, c):
        ax.plot(x[rows & ~limit], result.residuals[rows & ~limit], marker, color=color)
        ax.plot(x[rows & limit], result.residuals[rows & limit], BEYOND, color=color, ms=6)
    label = axis_label(along, unit)
    ax.set_xlabel(label if along_height else label.replace("precursor", "fitted"))
    unblurred = ~(result.sigma > 0)
    per = "σ" if not unblurred.any() else r"$\lambda_c$" if unblurred.all() else r"σ (counts: $\lambda_c$)"
    ax.set_ylabel(f"misfit/{per}" if along_height else f"(fitted − measured)/{per}")
    reach = max(3.0, 1.15 * float(np.abs(result.residuals).max()))
    ax.set_ylim(-reach, reach)
    if not along_height:
        ax.legend(**ABOVE)
    return ax


@drawn
def profile(result: "FitResult", name: str, *, color: str | None = None, ax: "Axes | None" = None) -> "Axes":
    """Draw the profile of the deviance along one parameter, blue unless a color is given.

    All others are fitted anew; lines mark the levels of its intervals, and how far these reach where they are those of
    simulated measurements, for which no level is the same everywhere. Dashed as in `fit_lengths`, for the lengths on which
    the parameter acts.
    """
    ax = axes(ax)
    c = colours(ax)
    curve = result.curves[name]
    one = result.parameters.named(name)
    limit = 2.2 * result.rise(BAND_LEVEL)
    rise = curve.deviance - result.deviance
    rows = result.parameters.rows_of(result.parameters.index(name))
    again = np.asarray(_breaks_again(result, result.parameters.inputs_at(curve.theta))[:, rows].any(axis=1))
    label = "profile" + " (rejected)" * _rejected(result)
    dashed_where(ax, one.value(curve.node), rise, again, color=color or c.blue, marker=".", ms=3, label=label)
    covariance, judged = result.covariance, not _rejected(result)
    if covariance is not None and judged:
        j = result.parameters.index(name)
        error = np.sqrt(covariance[j, j])
        theta = np.linspace(result.theta[j] - 3 * error, result.theta[j] + 3 * error, 101)
        parabola = result.rise(ONE_SIGMA) * ((theta - result.theta[j]) / error) ** 2
        ax.plot(one.value(theta), parabola, color=c.grey, ls="-.", lw=1, label="from covariance")
    for level in LEVELS if judged else ():  # the rise of a rejected fit measures its misfit
        height = result.rise(level)
        if result.calibrated:
            for piece in result.intervals[name].get(level, []):
                ax.plot(piece[:2], [height, height], color=c.ink, lw=1.5, label="_interval")
        else:
            ax.axhline(height, color=c.ink, lw=0.8, ls=":")
        ax.annotate(f"{level:.0%}", (1, height), (2, 0), xycoords=("axes fraction", "data"), textcoords="offset points",
                    va="center", fontsize="small", color=c.ink)  # fmt: skip
    below = curve.node[rise < limit]
    if len(below) > 1:
        pad = 0.1 * (below[-1] - below[0])
        ax.set_xlim(one.value(max(one.low, below[0] - pad)), one.value(min(one.high, below[-1] + pad)))
        if one.log and below[-1] - below[0] > np.log(10):
            ax.set_xscale("log")
    ax.set_ylim(0, limit)
    _name(one, ax.xaxis)
    ax.set_ylabel("rise of the deviance")
    # among those shown
    seen = (one.value(curve.node) >= ax.get_xlim()[0]) & (one.value(curve.node) <= ax.get_xlim()[1]) & (rise < limit)
    handles = handles_of(ax, again=bool(again[seen].any()))
    ax.legend(handles=handles, **ABOVE, ncols=2 if len(handles) == 2 else 1, fontsize="small")
    return ax


@drawn
def confidence_region(
    result: "FitResult",
    horizontal: str,
    vertical: str,
    samples: Any = None,
    *,
    nodes: int = 61,
    ax: "Axes | None" = None,
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
        ax.plot(x, y, ".", color=color, ms=1.5, alpha=0.4, label=name or None)
    if len(drawn_from) > 1:
        for handle in filter(None, ax.legend(fontsize="small", markerscale=6).legend_handles):
            handle.set_alpha(1)
    ax.plot(q.free[i].value(result.theta[i]), q.free[j].value(result.theta[j]), "+", color=c.vermilion, ms=8)
    _name(q.free[i], ax.xaxis)
    _name(q.free[j], ax.yaxis)
    ax.set_title(f"68 % and 95 % regions, + {_best(result)}")
    return ax


def _window(result: "FitResult", k: int, nodes: int) -> np.ndarray:
    """Values of θ_k around its 95 % interval."""
    one = result.parameters.free[k]
    pieces = result.intervals[one.label][BAND_LEVEL]
    low, high = (one.theta(pieces[0].low), one.theta(pieces[-1].high)) if pieces else (one.low, one.high)
    pad = 0.35 * (high - low)
    return np.linspace(max(one.low, low - pad), min(one.high, high + pad), nodes)


def _name(one: "Free", axis: "Axis") -> None:
    """Label a finished axis; a power of ten goes into the unit, where Matplotlib would print it over a neighbour's label."""
    unit = one.unit
    power = int(np.floor(np.log10(max(np.abs(axis.get_view_interval()).max(), 1e-300))))
    if axis.get_scale() == "linear" and not -2 <= power < 4:
        axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.10g}")
        unit = f"$10^{{{power}}}$ {printed(unit)}".rstrip()
    specimen = f"\n{one.label[one.label.index('[') :]}" if "[" in one.label else ""
    axis.set_label_text(axis_label(one.name, unit) + specimen)


def _abscissa(result: "FitResult") -> tuple[str, np.ndarray]:
    """Abscissa of the lengths, in stated λc: height of the block, or of the push where that leaves fewer curves."""
    m = result.measurements
    if m.push_height is None or result.parameters.front.body != "block":
        return "height", m.height
    by_height, by_push = (len(_alike(result, result.theta, along)) for along in ("height", "push_height"))
    return ("push_height", m.push_height) if by_push < by_height else ("height", m.height)


def _inputs_at(result: "FitResult", theta: np.ndarray, rows: Any, height: np.ndarray) -> Inputs:
    """Inputs of the model for measurements like those of `rows`, their mean, at other heights; (…, heights) for θ of (…, p)."""
    along, at = _abscissa(result)
    each = result.parameters.inputs_at(theta)
    name = INPUTS[along]
    each = _shifted(each, name, -np.log(at))
    mean = each.map(lambda x: x[..., np.atleast_1d(rows)].mean(axis=-1, keepdims=True))
    one = _shifted(mean, name, np.log(height))
    shape = np.broadcast_shapes(one.log_height.shape, np.shape(height))
    return one.map(lambda x: np.broadcast_to(x, shape))


def _shifted(inputs: Inputs, name: str, by: np.ndarray) -> Inputs:
    """Inputs of which one, `INPUTS` of the axis, is shifted."""
    at = inputs.get(name) + by
    return inputs._replace(log_height=at) if name == "log_height" else inputs.given(**{name: at})


def _lengths_at(result: "FitResult", theta: np.ndarray, rows: Any, height: np.ndarray) -> np.ndarray:
    """Predicted lengths in stated λc."""
    return _lengths_over(result, theta[None], rows, height)[0]


def _lengths_over(result: "FitResult", theta: np.ndarray, rows: Any, height: np.ndarray) -> np.ndarray:
    """Predicted lengths at many θ, (t, p), in one batch; shape (t, heights)."""
    q = result.parameters
    inputs = _inputs_at(result, theta, rows, height)
    length = q.front.lengths(inputs.ravel()).reshape(len(theta), -1)
    log_scale, offset = (x(theta)[:, np.atleast_1d(rows)].mean(axis=-1)[:, None] for x in (q.scales["length"], q.offset))
    return length * np.exp(log_scale) + offset


def _breaks_again(result: "FitResult", inputs: Inputs) -> np.ndarray:
    """Whether the edge contact breaks again before the front stops, for models of a front under the hard rule."""
    return result.parameters.front.breaks_again(inputs.ravel()).reshape(np.shape(inputs.log_height))


def _groups(result: "FitResult") -> list[np.ndarray]:
    """Group the measurements that lie on one curve (equal but for the abscissa), in the order of the table.

    Inputs with an error are those fitted where every curve then has two heights, else those stated.
    """
    stated = [one.prior_mean if one.nuisance else t for one, t in zip(result.parameters.free, result.theta, strict=True)]
    along, at = _abscissa(result)
    fitted = _alike(result, result.theta, along)
    found = fitted if all(np.ptp(at[rows]) > 0 for rows in fitted) else _alike(result, np.array(stated), along)
    return sorted(found, key=lambda rows: rows[0])


def _alike(result: "FitResult", theta: np.ndarray, along: str) -> list[np.ndarray]:
    """Group the measurements whose inputs at θ are equal but for the abscissa."""
    m = result.measurements
    inputs = result.parameters.inputs_at(theta)
    same = [inputs.get(name) for name in inputs.names if name != INPUTS[along]]
    correlation_length = np.ones(len(m)) if m.correlation_length is None else m.correlation_length
    keys = np.column_stack([*(np.round(x, 9) for x in same), correlation_length])
    return _equal_rows(keys)


def _equal_rows(keys: np.ndarray) -> list[np.ndarray]:
    """Indices of the rows of each kind."""
    _, group = np.unique(keys, axis=0, return_inverse=True)
    return [np.nonzero(group.ravel() == g)[0] for g in range(group.max() + 1)]


def _group_names(result: "FitResult") -> list[str]:
    """Name the curves by specimen if each has one, and by what differs within a specimen."""
    groups = _groups(result)
    one = result.parameters.inputs_at(result.theta).take([rows[0] for rows in groups])
    specimen = np.array(result.measurements.specimen or ("",) * len(result.measurements))
    owners = [set(specimen[rows]) for rows in groups]
    alone = len(groups) > 1 and len(set(specimen)) > 1 and all(len(owner) == 1 for owner in owners)
    names = [f"{min(owner)}: {_best(result, min(owner))}" if alone else _best(result) for owner in owners]
    alike = [np.array(names) == name for name in set(names)]
    differ = _differing(one, alike)
    return [", ".join([name, *(f"{sign} = {x[i]:.3g}" for sign, x in differ)]) for i, name in enumerate(names)]


def _differing(one: Inputs, alike: list[np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Symbol and values of the inputs that differ within one of several selections of rows."""
    numbers = {"$k/K$": one.ratio, "ν": one.poisson, r"$\varphi$": one.prestress, "ε": one.threshold_slope}
    if "log_push" in one.more:
        numbers["$h/H$"] = np.exp(one.get("log_push"))
    return [(sign, x) for sign, x in numbers.items() if any(np.ptp(x[which]) > 1e-9 * np.abs(x).max() for which in alike)]


def _rejected(result: "FitResult") -> bool:
    return result.identifiability in (Identifiability.POOR_FIT, Identifiability.AT_MAXIMUM)


def _best(result: "FitResult", specimen: str = "") -> str:
    """Name the curve of least deviance: not a fit if the model is rejected, nor the best if others fit equally."""
    if _rejected(result):
        return "closest (rejected)"
    own = [one.identifiability for name, one in result.verdicts.items() if specimen and f"[{specimen}]" in name]
    alike = {Identifiability.SEVERAL_ROOTS, Identifiability.EQUAL, Identifiability.UNINFORMATIVE}
    return "one that fits" if alike & set(own or [result.identifiability]) else "best fit"


def _longest(result: "FitResult", height: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Longest length at any stiffness searched, at each height, in stated λc."""
    q = result.parameters
    inputs = _inputs_at(result, result.theta, rows, height)
    scale = np.exp(q.scales["length"](result.theta)[rows].mean())
    return attainable_of(q, result.theta, np.full(len(height), rows[0]), inputs)[0] * scale


@drawn
def gauge_readings(result: "FitResult", name: str, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the gauge readings of one kind, and the fitted fields.

    The kind is ``"slip"`` or ``"stress"``.
    """
    ax = axes(ax)
    readings = _readings(result)
    scale, label = GAUGE_UNITS[name]
    there = readings.there(name)
    (data,) = (one for one in result.problem.observed if one.observable == name)
    for color, row in zip(colours(ax).data * 9, dict.fromkeys(readings.row[there].tolist()), strict=False):
        own = there & (readings.row == row)
        x = np.linspace(0, 1.08 * max(readings.position[own].max(), _arrest(result, row)), GAUGE_POINTS)
        title = result.measurements.label[row] if result.measurements.label else result.measurements.place(row)
        ax.plot(x * 1e3, _field(result, row, name, x) * scale, color=color, label=title)
        sigma = data.sigma[own[there]]
        value = getattr(readings, name)[own]
        ax.errorbar(readings.position[own] * 1e3, value * scale, sigma * scale, fmt="o", capsize=2, color=color)
    ax.set_xlim(left=0)
    ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    ax.set_xlabel("distance from the pushed edge, $x$ (mm)")
    ax.set_ylabel(label)
    ax.legend(**ABOVE, ncols=4, title="lines: fit; points: gauges ± σ", alignment="left")
    return ax


def _readings(result: "FitResult") -> "Gauges":
    if result.measurements.gauges is None:
        raise ValueError("no gauges were read: give read_measurements a table of them")
    return result.measurements.gauges


def _arrest(result: "FitResult", row: int) -> float:
    """Fitted length of one precursor, in m; 0 where the front never stops."""
    m, length = result.measurements, result.fitted.length[row]
    return float(length * m.correlation_length[row]) if np.isfinite(length) and m.correlation_length is not None else 0.0


def _field(result: "FitResult", row: int, name: str, x: np.ndarray) -> np.ndarray:
    """Predicted slip or stress of one precursor at distances `x`, in SI."""
    q = result.parameters
    block = next(one for one in result.problem.observed if one.observable == name)
    datum = int(np.nonzero(block.measurement == row)[0][0])
    inputs = block.inputs.at(result.theta).take(np.full(len(x), block.rows[datum]))
    assert result.measurements.correlation_length is not None
    true_unit = np.exp(q.scales["position"](result.theta)[row])
    place = np.log(np.maximum(x / (result.measurements.correlation_length[row] * true_unit), 1e-9))
    unit = np.exp(q.scales[name](result.theta)[row])
    return PREDICTED[name](q.front, inputs.given(log_position=place), ()).value * unit
