"""Pictures of sweeps: maps, and families of lines."""

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from slippulse_jax.plot import style
from slippulse_jax.plot.labels import AGAIN, NAMES, axis_label, in_unit, symbol
from slippulse_jax.status import Outcome

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes

UNIT_OF = {"height": "λc", "prestress": "σ_s", "threshold_slope": "σ_s per site", "repin_delay": "sites", "width": "σ_s"}
"""Units of the parameters of a sweep that are not dimensionless."""

WIDEST = 44
"""Characters in a line of the label of a colour bar."""

LINES = 8
"""Largest number of lines in a family; an axis with more values makes a map."""


@style.drawn
def sweep(found: "xr.Dataset", name: str | None = None, *, ax: "Axes | None" = None) -> "Axes":
    """Draw one output of a sweep.

    It is a line for each of at most 8 values of an axis, or a map over two axes. If the sweep has a status, lines are dashed
    and maps hatched where the edge contact breaks again.

    Parameters
    ----------
    found : xarray.Dataset
        Result of `sweep` with one or two axes of more than one value; select from the others with ``.sel`` first.
    name : str, optional
        Output to draw; the first by default.
    ax : matplotlib.axes.Axes, optional

    Raises
    ------
    ValueError
        If the number of such axes is neither one nor two.
    """
    column = found[str(next(iter(found.data_vars))) if name is None else name].squeeze()
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
    if len(axes) == 1 or column.sizes[axes[0]] <= LINES:
        _lines(ax, column, again, axes[-1], axes[0] if len(axes) == 2 else None)
    else:
        _map(ax, column, again, *(axes if axes[0] == column.dims[1] else axes[::-1]))
    fixed = [
        f"{symbol(name, UNIT_OF.get(name, ''))} = {float(column[name]):.4g}"
        for name in NAMES
        if name in column.coords and not column[name].ndim
    ]
    above = ax.get_legend() is not None and not len(ax.lines)  # that of a map
    ax.set_title(", ".join(fixed), fontsize="medium", pad=16 if above else None)
    return ax


def not_drawn(axes: "Sequence[str]", instead: str) -> str:
    """Why a sweep over these axes is not drawn, and what to do instead."""
    return f"a picture needs one or two axes of several values, not {len(axes)} ({', '.join(axes) or 'none'}): {instead}"


def _lines(ax: "Axes", column: "xr.DataArray", again: "xr.DataArray", along: str, family: str | None) -> None:
    import matplotlib as mpl

    every = [{}] if family is None else [{family: i} for i in range(column.sizes[family])]
    members = [column.isel(one) for one in every]
    least, most = (0.4, 1.0) if style.colours(ax) is style.DARK else (0.0, 0.9)
    colours = mpl.colormaps["cividis"](np.linspace(least, most, len(members)))
    for one, member, colour in zip(every, members, colours, strict=True):
        label = None if family is None else f"{float(member[family]):.4g}"
        x, y = member[along].values, np.where(np.isfinite(member.values), member.values, np.nan)
        style.dashed_where(ax, x, y, again.isel(one).values, color=colour, label=label)
    _scale(ax.set_xscale, column[along].values)
    ax.set(xlabel=_axis(along), ylabel=_label(column))
    handles = style.handles_of(ax, again=bool(again.any()))
    if handles:
        title = None if family is None else _axis(family)
        ax.legend(handles=handles, title=title, loc="upper left", bbox_to_anchor=(1.0, 1.0))  # lines leave no room inside


def _map(ax: "Axes", column: "xr.DataArray", again: "xr.DataArray", vertical: str, horizontal: str) -> None:
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    x, y = column[horizontal].values, column[vertical].values
    shown = column.transpose(vertical, horizontal).values.astype(float)
    shown = np.ma.masked_invalid(shown)  # fronts that never stop, or were given up, stay blank
    mesh = ax.pcolormesh(x, y, shown, shading="nearest", cmap="cividis", rasterized=True)
    if shown.count() and np.ptp(shown) > 0 and column.dtype.kind == "f":
        levels = MaxNLocator(7).tick_values(shown.min(), shown.max())
        levels = levels[(levels > shown.min()) & (levels < shown.max())]  # not the edge of a plain of zeros
        lines = ax.contour(x, y, shown, levels=levels, colors="white", linewidths=0.7)
        ax.clabel(lines, fontsize="small")
    if again.any():
        shaded = again.transpose(vertical, horizontal).values
        hatched = ax.contourf(x, y, shaded, levels=[0.5, 1.5], colors="none", hatches=["//"])
        hatched.set(edgecolor=(1, 1, 1, 0.5), linewidth=0)
        key = Patch(facecolor=mesh.cmap(0.5), edgecolor="white", hatch="//", label=AGAIN)
        ax.legend(handles=[key], **style.ABOVE)
    _scale(ax.set_xscale, x)
    _scale(ax.set_yscale, y)
    ax.set(xlabel=_axis(horizontal), ylabel=_axis(vertical))
    ax.figure.colorbar(mesh, ax=ax, label=fill(_label(column), WIDEST))


def _scale(set_scale: Any, values: np.ndarray) -> None:
    """Choose a logarithmic scale for positive values that span more than a factor of 30."""
    if values.min() > 0 and values.max() / values.min() > 30:
        set_scale("log")


def _axis(name: str) -> str:
    return axis_label(name, UNIT_OF.get(name, ""))


def _label(column: "xr.DataArray") -> str:
    return in_unit(str(column.attrs.get("long_name", column.name)), column.attrs.get("units", ""))
