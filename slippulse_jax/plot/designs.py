"""Pictures of a design of experiments."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from slippulse_jax.inference.design import BIT
from slippulse_jax.plot.labels import AGAIN, axis_label
from slippulse_jax.plot.style import (
    NARROW,
    SMALL,
    axes,
    colours,
    dashed_where,
    drawn,
    handles_of,
    label_decades,
    legend_above,
    new_figure,
    width_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from slippulse_jax.inference.design import Design
    from slippulse_jax.inference.knowledge import Knowledge


def design_figure(found: "Design", *, width: float | None = None, ax: "Axes | None" = None) -> "Figure":
    """Draw `design` and `design_lengths` side by side.

    `width` in mm and `ax` are those of `fit`. Of tables the information alone.
    """
    wide, high = width_of(width, ax), max(1.8, 0.3 * len(found.candidates))
    beside = wide >= NARROW
    if found.parameters is None:
        with new_figure(wide, 1 + high, ax) as figure:
            design(found, ax=figure.subplots())
        return figure
    with new_figure(wide, 1 + high if beside else 3.5 + high, ax) as figure:
        left, right = figure.subplots(*(1, 2) if beside else (2, 1))
        design(found, ax=left)
        design_lengths(found, ax=right)
    return figure


@drawn
def design(found: "Design", *, ax: "Axes | None" = None) -> "Axes":
    """Draw the expected information of every candidate, the most informative on top."""
    ax = axes(ax)
    c = colours(ax)
    order = found.ranking[::-1]
    y = np.arange(len(order))
    bits = found.information[order] / BIT
    ax.barh(y, bits, 0.6, color=c.blue)
    for place, i, longer in zip(y, order, bits, strict=True):
        said = f"ln k ± {found.log_stderr[i]:.2g}"
        if len(found.knowledge.roots) > 1:
            said += f", roots apart {found.told_apart[i]:.0%}"
        ax.text(longer + 0.015 * bits.max(), float(place), said, va="center", fontsize=SMALL - 0.5, color=c.grey)
    ax.set_yticks(y, np.array(found.names)[order])
    room = 2.3 if len(found.knowledge.roots) > 1 else 1.5  # for what is written beside the longest
    ax.set(xlabel="expected information (bits)", xlim=(0, room * bits.max()))
    return ax


@drawn
def design_lengths(found: "Design", *, ax: "Axes | None" = None) -> "Axes":
    """Draw ℓ/H ± σ of the best candidates against stiffness.

    Below them is the density of the present knowledge. A ValueError for tables.
    """
    if found.parameters is None:
        raise ValueError("the candidates are tables, not lengths: use plot.design")
    ax = axes(ax)
    c = colours(ax)
    known = found.knowledge.log_stiffness
    theta = np.linspace(known[0], known[-1], 400)  # the samples may form two distant clusters
    length = found.lengths(theta)
    again = found.breaks_again(theta)
    shown = found.ranking[: len(c.data)]
    top, low = 0.0, np.inf
    for i, color in zip(shown, c.data, strict=False):
        one = found.candidates[int(i)]
        height, sigma = (x / np.nan_to_num(one.correlation_length, nan=1.0) for x in (one.height, one.sigma))
        share = np.where(np.isfinite(length[:, i]), length[:, i], np.nan) / height
        dashed_where(ax, np.exp(theta), share, again[:, i], color=color, label=found.names[i])
        ax.fill_between(np.exp(theta), share - sigma / height, share + sigma / height, color=color, alpha=0.2, lw=0)
        top = max(top, np.nanmax(share + sigma / height, initial=0.0))
        low = min(low, np.nanmin(share - sigma / height, initial=np.inf))
    # the density has its own strip below the lengths
    strip = 0.35 * (top - low) if low < top else 0.0
    base = max(low - strip, 0.0) if strip else 0.0
    densities = list(_densities(found.knowledge))
    highest = max(density.max() for _, density in densities)
    for (middle, density), rebreaks in zip(densities, found.knowledge.rebreaks, strict=True):
        height = 0.8 * (strip or 0.3 * top) * density / highest
        look: dict[str, Any] = {"hatch": "////" * bool(rebreaks), "label": "known so far" + f", {AGAIN}" * bool(rebreaks)}
        ax.fill_between(np.exp(middle), base, base + height, color=c.grey, alpha=0.35, lw=0, **look)
    ax.set(
        xscale="log",
        xlabel=axis_label("areal_stiffness", "Pa/m") if found.knowledge.in_si else axis_label("stiffness"),
        ylabel="length over height, $\\ell/H$ (± σ)",
        ylim=(base, top + 0.1 * (top - base) if top > 0 else 1),
    )
    label_decades(ax.xaxis)
    some = f"the {len(shown)} most informative of {len(found.names)}" if len(shown) < len(found.names) else None
    # lengths and density leave no corner free
    legend_above(ax, handles_of(ax, again=bool(again[:, shown].any())), title=some)
    return ax


def _densities(knowledge: "Knowledge") -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the density of ln(stiffness) about each root."""
    for weight in knowledge.by_root.T:
        own = weight > 1e-6 * knowledge.weight.max()  # where it is not negligible
        weights, edges = np.histogram(knowledge.log_stiffness[own], 40, weights=weight[own])
        yield (edges[1:] + edges[:-1]) / 2, weights / np.diff(edges)
