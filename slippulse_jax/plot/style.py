"""The look of every picture, light or dark.

Its colours are safe for colour-blind readers, and its type is legible at column width. Drawing functions take ``ax=None``,
begin with `axes`, and take their colours from `colours`, which depend on the background: so a picture suits the page, whoever
made the Axes.
"""

import functools
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import numpy as np

from slippulse_jax.base.files import FIGURE_FORMATS, write_atomically
from slippulse_jax.plot.labels import AGAIN, KEPT
from slippulse_jax.plot.labels import DISTANCE as DISTANCE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Draw = TypeVar("Draw", bound=Callable[..., Any])

MM = 1 / 25.4
"""A millimetre in inches."""

COLUMN, PAGE = 84 * MM, 170 * MM
"""Widths of a journal's column and page, in inches."""

HEIGHT = 2.5
"""Height of a figure of one panel, in inches."""

NARROW = 125 * MM
"""Width below which the panels of a figure stand one below the other."""

SMALL = 6.7
"""Size of the type of legends and remarks, in points."""

FRAMELESS: dict[str, Any] = {
    "frameon": False, "fontsize": SMALL, "title_fontsize": SMALL, "alignment": "left", "handlelength": 1.4, "columnspacing": 1.2
}  # fmt: skip
"""Options of every legend."""

ABOVE: dict[str, Any] = FRAMELESS | {"loc": "lower left", "bbox_to_anchor": (-0.02, 1), "borderpad": 0}
"""Options of ``ax.legend`` above the Axes, where lines leave no room inside."""


class Colours(NamedTuple):
    """Six colours for data, in order of use, and three others."""

    blue: str
    vermilion: str
    green: str
    orange: str
    purple: str
    sky: str
    grey: str  # what is secondary
    ink: str  # text
    paper: str  # background

    @property
    def data(self) -> tuple[str, ...]:
        """Colours for data."""
        return tuple(self[:6])


LIGHT = Colours("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#737373", "#000000", "#FFFFFF")
"""Okabe and Ito's colours, for white pages."""

DARK = Colours("#5B8DD9", "#E0603A", "#4FE3A0", "#F0BE3C", "#E7A6CC", "#B9DDF5", "#9AA3AD", "#E8EAED", "#131619")
"""The same hues, lighter, for a dark page."""


def colours(ax: Any) -> Colours:
    """Choose `DARK` for an Axes on a dark background, else `LIGHT`."""
    from matplotlib.colors import to_rgba

    face = ax.get_facecolor()
    return DARK if _is_dark(face if to_rgba(face)[3] >= 0.5 else ax.figure.get_facecolor()) else LIGHT


def _is_dark(colour: Any) -> bool:
    from matplotlib.colors import to_rgba

    red, green, blue, alpha = to_rgba(colour)
    return alpha >= 0.5 and 0.2126 * red + 0.7152 * green + 0.0722 * blue < 0.4


def settings(*, dark: bool = False) -> dict[str, Any]:
    """Matplotlib's rcParams of the look, for ``plt.rcParams.update``."""
    from cycler import cycler

    c = DARK if dark else LIGHT
    return {
        "axes.prop_cycle": cycler(color=c.data),
        "axes.facecolor": c.paper, "figure.facecolor": c.paper, "savefig.facecolor": c.paper,
        "text.color": c.ink, "axes.labelcolor": c.ink, "axes.edgecolor": c.ink, "xtick.color": c.ink, "ytick.color": c.ink,
        "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.7,
        "xtick.major.width": 0.7, "ytick.major.width": 0.7, "lines.linewidth": 1.4, "lines.markersize": 3.5,
        "font.size": 8, "axes.labelsize": 8, "axes.titlesize": 8.5, "axes.titlelocation": "left",
        "xtick.labelsize": 7.5, "ytick.labelsize": 7.5, "legend.fontsize": SMALL, "legend.frameon": False,
        "mathtext.fontset": "dejavusans", "image.cmap": "cividis",
        "figure.figsize": (COLUMN, HEIGHT), "figure.dpi": 120, "savefig.dpi": 300, "figure.constrained_layout.use": True,
        "pdf.fonttype": 42, "svg.fonttype": "none", "animation.html": "jshtml",
    }  # fmt: skip


@contextmanager
def use(*, dark: bool = False, **changes: Any) -> Iterator[None]:
    """Use the look inside ``with sp.plot.style.use():``.

    The settings are restored afterwards.

    Parameters
    ----------
    dark : bool
        For a dark page.
    **changes
        Other rcParams, with ``__`` in place of the dot: ``use(figure__figsize=(7, 3))``.
    """
    import matplotlib as mpl

    look: Any = settings(dark=dark) | {name.replace("__", "."): value for name, value in changes.items()}
    with mpl.rc_context(look):
        yield


def _in_force() -> Any:
    """Apply the look, unless the settings are the look already."""
    import matplotlib as mpl

    data = mpl.rcParams["axes.prop_cycle"].by_key().get("color", [])
    return nullcontext() if tuple(data) in (LIGHT.data, DARK.data) else use(dark=_is_dark(mpl.rcParams["figure.facecolor"]))


def axes(ax: "Axes | None" = None, *, height: float = HEIGHT) -> "Axes":
    """Return `ax`, or the Axes of a new pyplot figure.

    The figure has the look, and by default the width of a column and this height in inches.
    """
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    with _in_force():
        chosen = tuple(plt.rcParams["figure.figsize"])
        return plt.subplots(figsize=(COLUMN, height) if chosen == (COLUMN, HEIGHT) else chosen)[1]


UNDATED: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""What a file says of itself by its format: the same figure is the same file."""


def save(figure: "Figure | Axes", path: str | os.PathLike[str], *, dpi: float = 300) -> None:
    """Write a figure as journals take it, whole or not at all.

    Whatever the settings, fonts of a PDF are embedded as TrueType and not as Type 3, and text of an SVG stays text.

    Parameters
    ----------
    figure : Figure or Axes
        The figure, or an Axes on it.
    path : str or path
        A name that ends in ``.png``, ``.pdf`` or ``.svg``; else a ValueError.
    dpi : float
        Points per inch of a PNG, and of images in the others.
    """
    import matplotlib as mpl

    if not hasattr(figure, "get_figure"):
        raise TypeError(f"figure: give a Matplotlib Figure, or an Axes of one, not {type(figure).__name__}")
    form, drawn = Path(path).suffix.lstrip(".").lower(), cast("Figure", figure)
    if form not in FIGURE_FORMATS:
        known = f"{', '.join(f'.{one}' for one in FIGURE_FORMATS[:-1])} or .{FIGURE_FORMATS[-1]}"
        raise ValueError(f"{os.fspath(path)}: must end in {known}; for another format call figure.savefig(path)")
    while not hasattr(drawn, "savefig"):  # an Axes, or a SubFigure
        drawn = cast("Figure", drawn.figure)
    content = io.BytesIO()
    with mpl.rc_context({"pdf.fonttype": 42, "pdf.use14corefonts": False, "svg.fonttype": "none", "svg.hashsalt": "same"}):
        drawn.savefig(content, format=form, dpi=dpi, facecolor=drawn.get_facecolor(), metadata=UNDATED.get(form))
    write_atomically(path, content.getvalue())


def letter_panels(*panels: "Axes") -> None:
    """Letter panels (a), (b), (c) …, above their vertical axes."""
    for number, ax in enumerate(panels):
        where: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "annotation_clip": False}
        letter = ax.annotate(f"({chr(ord('a') + number)})", (0, 1), (-14, 3), fontweight="bold", ha="right", **where)
        letter.set_in_layout(False)  # it stands where labels of the axis have left room


def width_of(width: float | None, ax: "Axes | None", otherwise: float = PAGE) -> float:
    """Width that the panels of a figure have, in inches.

    That of `ax` if they take its place, else `width` in mm, else `otherwise`.
    """
    if ax is None:
        return otherwise if width is None else width * MM
    if width is not None:
        raise ValueError("width is that of a figure of its own, and ax has one: give one of them")
    place = ax.get_subplotspec()
    share = 1.0 if place is None else len(place.colspan) / place.get_gridspec().ncols
    return share * ax.figure.bbox.width / ax.figure.dpi


@contextmanager
def new_figure(width: float, height: float, ax: "Axes | None" = None) -> "Iterator[Figure]":
    """Make a figure of several panels, and draw it in the look.

    Sizes are in inches. The figure is unknown to pyplot. With `ax`, an Axes of a grid as ``plt.subplots`` makes them, the
    panels take its place, on a `SubFigure`.
    """
    from matplotlib.figure import Figure

    if ax is None:
        with _in_force():
            yield Figure(figsize=(width, height), layout="constrained")
        return
    place, figure = ax.get_subplotspec(), ax.get_figure()
    if place is None or figure is None:
        raise ValueError("ax: a figure of several panels takes the place of an Axes of a grid, as plt.subplots() makes it")
    ax.remove()
    yield cast("Figure", figure.add_subfigure(place))


def drawn(function: Draw) -> Draw:
    """Decorate a drawing function, so that its own figures have the look."""

    @functools.wraps(function)
    def draw(*arguments: Any, ax: "Axes | None" = None, **options: Any) -> Any:
        with _in_force() if ax is None else nullcontext():
            return function(*arguments, ax=ax, **options)

    return draw  # pyright: ignore[reportReturnType]


def dashed_where(ax: Any, x: np.ndarray, y: np.ndarray, again: np.ndarray, **options: Any) -> None:
    """Draw a line, dashed where the edge contact breaks again."""
    ax.plot(x, np.where(again, np.nan, y), **options)
    if again.any():  # starting at the point before, so that the line has no gap
        near = again | np.append(again[1:], False) | np.append(False, again[:-1])
        ax.plot(x, np.where(near, y, np.nan), **options | {"linestyle": "--", "linewidth": 0.8, "label": None})


def draw_kept(ax: Any, x: Any, kept: np.ndarray) -> list[Any]:
    """Draw the stress that contacts keep, if any; return the lines."""
    return ax.plot(x, kept, "-.", color=colours(ax).grey, linewidth=0.6, label=KEPT) if np.any(kept) else []


def handles_of(ax: Any, *, again: bool = False) -> list[Any]:
    """Handles for a legend: one per label, and dashes if `again`."""
    from matplotlib.lines import Line2D

    key = Line2D([], [], color=colours(ax).ink, linestyle="--", linewidth=0.8, label=AGAIN)
    handles, labels = ax.get_legend_handles_labels()
    return [handle for i, handle in enumerate(handles) if labels[i] not in labels[:i]] + [key] * again


def legend_above(ax: Any, handles: list[Any] | None = None, *, most: int = 3, **options: Any) -> None:
    """Draw a legend above the Axes, in at most `most` columns."""
    look = ABOVE | {"handles": handles_of(ax) if handles is None else handles} | options
    frame = ax.get_window_extent()
    room = min(1.2 * frame.width, 0.9 * (ax.figure.bbox.x1 - frame.x0))
    for columns in range(most, 0, -1):  # as many as do not press panels together
        if ax.legend(**look, ncols=columns).get_window_extent().width < room:
            return


def label_decades(axis: "Axis") -> None:
    """Label decades of a logarithmic axis, or their parts if few."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if axis.get_scale() != "log":
        return
    low, high = np.log10(axis.get_view_interval())
    few = np.floor(high + 1e-6) - np.ceil(low - 1e-6) < 1
    shown = [sub for sub in (1, 2, 5) if np.floor(high - np.log10(sub)) >= np.ceil(low - np.log10(sub))]
    axis.set_major_locator(LogLocator(subs=(1,) if not few else (1, 2, 5) if len(shown) > 1 else (1, 2, 3, 5, 7), numticks=6))
    if few:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
