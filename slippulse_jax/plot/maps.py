"""Pictures of sweeps: maps, and families of lines."""

from textwrap import fill
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from slippulse_jax.base.status import Outcome
from slippulse_jax.plot import style
from slippulse_jax.plot.labels import AGAIN, NAMES, as_written, axis_label, in_unit, symbol

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.contour import ContourSet
    from matplotlib.figure import Figure

UNIT_OF = {"height": "λc", "prestress": "σ_s", "threshold_slope": "σ_s per site", "width": "σ_s"}
"""Units of the parameters of a sweep that are not dimensionless."""

OUTPUTS = {
    "length": axis_label("length", "λc"),
    "exact_length": axis_label("length", "λc"),
    "block_precursor_length": axis_label("length", "λc"),
    "nucleation_load": "load at nucleation, $U_0/u_s$",
    "edge_stress": r"stress on contact 0, $t(0)/\sigma_s$",
}
"""Labels of outputs that other pictures draw too; others have their own long name."""

WIDEST = 34
"""Most characters per line of a label as high as a figure."""

BESIDE = 16
"""Most characters per line of a legend next to the lines."""


@style.drawn
def sweep(found: "xr.Dataset | xr.DataArray", name: str | None = None, *, ax: "Axes | None" = None) -> "Axes":
    """Draw one output of a sweep.

    With one axis it is a line, with two a line for each value of an axis of at most 8, or a map. If the sweep has a status,
    lines are dashed and maps hatched where the edge contact breaks again.

    Parameters
    ----------
    found : xarray.Dataset or xarray.DataArray
        Result of `sweep` with one or two axes of more than one value; select from the others with ``.sel`` first.
    name : str, optional
        Output to draw; by default the length if there is one, else the first.
    ax : matplotlib.axes.Axes, optional

    Raises
    ------
    ValueError
        If the number of such axes is neither one nor two.
    """
    if not hasattr(found, "data_vars"):  # one output
        found = cast("xr.DataArray", found).to_dataset(name=str(name or found.name or "value"))
    first = "length" if "length" in found else str(next(iter(found.data_vars)))  # a store opened by xarray sorts its names
    column = found[first if name is None else name].squeeze()
    axes = sorted((str(dim) for dim in column.dims), key=lambda dim: column.sizes[dim])
    if "point" in axes:
        raise ValueError(not_drawn(axes, "leave out points=True"))
    if len(axes) > 2:
        chosen = ", ".join(f"{name}={float(column[name][0])!r}" for name in axes[:-2])
        raise ValueError(not_drawn(axes, f"select one value of the others first, such as .sel({chosen})"))
    if not axes:
        raise ValueError(not_drawn(axes, "sweep several values of a parameter, such as height=[10, 20, 30]"))
    ax = style.axes(ax)
    status = next((found[name] for name in ("status", "exact_status") if name in found), None)
    again = column.copy(data=np.zeros(column.shape, bool)) if status is None else status.squeeze() == Outcome.REBREAK
    if len(axes) == 1 or column.sizes[axes[0]] <= 8:
        _lines(ax, column, again, axes[-1], axes[0] if len(axes) == 2 else None)
    else:
        _map(ax, column, again, *(axes if axes[0] == column.dims[1] else axes[::-1]))
    fixed = [
        f"{symbol(name, UNIT_OF.get(name, ''))} = {float(column[name]):.4g}"
        for name in NAMES
        if name in column.coords and not column[name].ndim
    ]
    above = ax.get_legend() is not None and (not len(ax.lines) or len(axes) == 1)  # with no family of lines at the side
    ax.set_title(", ".join(fixed), fontsize="medium", pad=16 if above else None)
    return ax


def not_drawn(axes: "Sequence[str]", instead: str) -> str:
    """Message about axes that cannot be drawn, and what to do instead."""
    return f"a picture needs one or two axes of several values, not {len(axes)} ({', '.join(axes) or 'none'}): {instead}"


def _lines(ax: "Axes", column: "xr.DataArray", again: "xr.DataArray", along: str, family: str | None) -> None:
    import matplotlib as mpl

    every = [{}] if family is None else [{family: i} for i in range(column.sizes[family])]
    members = [column.isel(one) for one in every]
    least, most = (0.4, 1.0) if style.colours(ax) is style.DARK else (0.0, 0.9)
    colours = mpl.colormaps["cividis"](np.linspace(least, most, len(members)))
    labels = [None] if family is None else _short(column[family].values)
    for one, member, colour, label in zip(every, members, colours, labels, strict=True):
        x, y = member[along].values, np.where(np.isfinite(member.values), member.values, np.nan)
        style.dashed_where(ax, x, y, again.isel(one).values, color=colour, label=label)
    _scale(ax.set_xscale, column[along].values)
    style.label_decades(ax.xaxis)
    ax.set(xlabel=_axis(along), ylabel=fill(_label(column), WIDEST))
    handles = style.handles_of(ax, again=bool(again.any()))
    if handles:
        if family is None:
            ax.legend(handles=handles, **style.ABOVE)
        else:  # lines leave no room inside
            title = fill(_axis(family), BESIDE)
            side = ax.legend(handles=handles, title=title, bbox_to_anchor=(1, 1), loc="upper left", **style.FRAMELESS)
            for text in side.get_texts():
                text.set_text(fill(text.get_text(), BESIDE))


def _map(ax: "Axes", column: "xr.DataArray", again: "xr.DataArray", vertical: str, horizontal: str) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Patch
    from matplotlib.ticker import LogLocator, MaxNLocator

    x, y = column[horizontal].values, column[vertical].values
    shown = column.transpose(vertical, horizontal).values.astype(float)
    shown = np.ma.masked_invalid(shown)  # fronts that never stop, or were given up, stay blank
    is_float = column.dtype.kind == "f"
    positive = shown.compressed()[shown.compressed() > 0]
    decades = is_float and bool(positive.size) and shown.min() >= 0 and spans_decades(positive)
    # over four decades at most, with the lowest colour for what is smaller, such as lengths of zero
    low = max(positive.min(), 1e-4 * positive.max()) if decades else shown.min()
    norm = LogNorm(low, positive.max(), clip=True) if decades else None
    mesh = ax.pcolormesh(x, y, shown, shading="nearest", cmap="cividis", norm=norm, rasterized=True)
    for axis, set_scale, values in ((ax.xaxis, ax.set_xscale, x), (ax.yaxis, ax.set_yscale, y)):
        _scale(set_scale, values)
        style.label_decades(axis)
    labelled = None
    if is_float and shown.count() and np.ptp(shown) > 0:
        subs = (1, 2, 5) if shown.max() < 1e3 * low else (1, 3)
        locator = LogLocator(subs=subs, numticks=9) if decades else MaxNLocator(7)
        levels = np.asarray(locator.tick_values(low, shown.max()))
        levels = levels[(levels > shown.min()) & (levels < shown.max())]  # not the edge of an area of zeros
        labelled = ax.contour(x, y, shown, levels=levels, colors="white", linewidths=0.7)
    if again.any():
        shaded = again.transpose(vertical, horizontal).values
        hatched = ax.contourf(x, y, shaded, levels=[0.5, 1.5], colors="none", hatches=["//"])
        hatched.set(edgecolor=(1, 1, 1, 0.5), linewidth=0)
        key = Patch(facecolor=mesh.cmap(0.5), edgecolor="white", hatch="//", label=AGAIN)
        ax.legend(handles=[key], **style.ABOVE)
    ax.set(xlabel=_axis(horizontal), ylabel=_axis(vertical))
    extend = "min" if decades and shown.min() < low else "neither"
    bar = ax.figure.colorbar(mesh, ax=ax, label=fill(_label(column), WIDEST), extend=extend)
    style.label_decades(bar.ax.yaxis)
    if labelled is not None:
        _label_contours(ax, labelled)


def _label_contours(ax: "Axes", lines: "ContourSet") -> None:
    """Label each level away from the frame and from other labels."""
    cast("Figure", ax.figure.figure).draw_without_rendering()  # for the layout to be final
    frame = ax.get_window_extent()
    center = np.add(frame.p0, frame.p1) / 2
    em = 10 * ax.figure.dpi / 72
    taken: list[np.ndarray] = []
    for level, path in zip(lines.levels, lines.get_paths(), strict=True):
        half = np.array([0.3 * len(f"{level:g}") + 0.5, 0.9]) * em  # of the label, upright or not
        room = np.array([half.max(), half.max()])
        at = ax.transData.transform(path.vertices)
        free = np.all((at > frame.min + room) & (at < frame.max - room), axis=1)
        for other in taken:
            free &= np.hypot(*(at - other).T) > 2 * half.max()
        if free.any():
            middle = at[free][np.argmin(np.hypot(*((at[free] - center) / frame.size).T))]
            taken.append(middle)
            ax.clabel(lines, [level], fontsize="small", manual=[tuple(ax.transData.inverted().transform(middle))])


def spans_decades(values: np.ndarray) -> bool:
    """Whether a logarithmic scale suits: positive, over a factor of 30."""
    return bool(values.min() > 0 and values.max() / values.min() > 30)


def _scale(set_scale: Any, values: np.ndarray) -> None:
    """Choose a logarithmic scale for positive values that span decades."""
    if spans_decades(values):
        set_scale("log")


def _short(values: np.ndarray) -> list[str]:
    """Format values with the fewest digits that distinguish them, three or more."""
    written: list[str] = []
    for digits in range(3, 17):
        written = [f"{float(f'{value:.{digits}g}'):.{digits + 3}g}" for value in values]
        if len(set(written)) == len(values):
            break
    return written


def _axis(name: str) -> str:
    return axis_label(name, UNIT_OF.get(name, "")) if name in NAMES else as_written(name)


def _label(column: "xr.DataArray") -> str:
    if column.name in OUTPUTS:
        return OUTPUTS[str(column.name)]
    words = as_written(str(column.attrs.get("long_name", column.name)), 2 * WIDEST)
    return in_unit(words, as_written(str(column.attrs.get("units", ""))))
