"""Pictures of a series of events: friction curve and space–time map."""

import warnings
from typing import TYPE_CHECKING

import numpy as np

from slippulse_jax.events.catalogue import Catalogue, EventClass, table
from slippulse_jax.plot.labels import DISTANCE, axis_label
from slippulse_jax.plot.style import ABOVE, axes, colours, drawn

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {
    EventClass.EDGE: "blue",
    EventClass.RENUCLEATED: "orange",
    EventClass.INTERIOR: "green",
    EventClass.SPANNING: "vermilion",
}
"""Colour of each class of event, by its name in `slippulse_jax.plot.style.Colours`."""

NAMES = {EventClass.RENUCLEATED: "at an earlier arrest"}
"""Legend entry of a class whose name says too little."""


@drawn
def friction_curve(catalogue: Catalogue, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the force on the left edge against the load."""
    ax = axes(ax)
    c = colours(ax)
    events = table(catalogue)
    load = np.repeat(np.append(0.0, events["load"]), 2)[1:]
    force = np.append(0.0, np.stack([events["force_before"], events["force_after"]], axis=1).ravel())
    ax.plot(load, force, color=c.ink, lw=1)
    for kind in (EventClass.EDGE, EventClass.SPANNING):
        chosen = events["kind"] == kind
        if chosen.any():
            ax.plot(
                events["load"][chosen],
                events["force_before"][chosen],
                ".",
                color=getattr(c, COLOURS[kind]),
                label=NAMES.get(kind, kind.name.lower()),
            )
    ax.set(xlabel=axis_label("load", "u_s"), ylabel="force on the left edge, $F/(K u_s)$")
    ax.margins(x=0.02)
    ax.legend(**ABOVE, ncols=2, title="event", alignment="left")
    return ax


@drawn
def space_time(catalogue: Catalogue, *, ax: "Axes | None" = None) -> "Axes":
    """Draw every recorded break by site and load.

    Its colour is the class of its event. Missing breaks give a warning.
    """
    ax = axes(ax)
    c = colours(ax)
    site, event = np.asarray(catalogue.break_site), np.asarray(catalogue.break_event)
    recorded = event >= 0
    if not recorded.any():
        raise ValueError("no break was recorded: make the series with recorded_breaks")
    breaks = int(np.sum(catalogue.breaks))
    if recorded.sum() < breaks:
        missing = f"{breaks - recorded.sum()} of {breaks} breaks are not drawn, the latest ones"
        warnings.warn(f"{missing}: make the series with recorded_breaks={breaks}", RuntimeWarning, stacklevel=3)
    site, event = site[recorded], event[recorded]
    load, kinds = np.asarray(catalogue.load)[event], np.asarray(catalogue.kind)[event]
    for kind, colour in COLOURS.items():
        chosen = kinds == kind
        if chosen.any():
            ax.plot(site[chosen], load[chosen], ".", ms=3, color=getattr(c, colour), label=NAMES.get(kind, kind.name.lower()))
    ax.set(xlabel=DISTANCE, ylabel=axis_label("load", "u_s"))
    ax.legend(**ABOVE, ncols=2, title="event", alignment="left", markerscale=3)
    return ax
