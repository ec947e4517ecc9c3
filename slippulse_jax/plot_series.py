"""Pictures of a series of events; each is drawn on an Axes it is given, with units. Colours of Okabe and Ito."""

from typing import TYPE_CHECKING

import numpy as np

from slippulse_jax.lattice.catalogue import table
from slippulse_jax.lattice.events import Catalogue, EventClass

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {
    EventClass.EDGE: "#0072B2",
    EventClass.CREEP: "#E69F00",
    EventClass.INTERIOR: "#009E73",
    EventClass.SPANNING: "#D55E00",
}


def friction_curve(ax: "Axes", catalogue: Catalogue) -> None:
    """Force on the left edge against the load: rising between events, dropping at each."""
    events = table(catalogue)
    load = np.repeat(np.append(0.0, events["load"]), 2)[1:]
    force = np.append(0.0, np.stack([events["force_before"], events["force_after"]], axis=1).ravel())
    ax.plot(load, force, color="0.2", lw=1)
    for kind in (EventClass.EDGE, EventClass.SPANNING):
        chosen = events["kind"] == kind
        if chosen.any():
            ax.plot(events["load"][chosen], events["force_before"][chosen], ".", color=COLOURS[kind], label=kind.name.lower())
    ax.set(xlabel="load, $U/u_s$", ylabel="force on the left edge, $F/(K u_s)$")
    ax.margins(x=0.02)
    ax.legend(frameon=False, title="event", loc="lower right")


def space_time(ax: "Axes", catalogue: Catalogue) -> None:
    """Every recorded break, by site and load, in the colour of its event's class."""
    site, event = np.asarray(catalogue.break_site), np.asarray(catalogue.break_event)
    recorded = event >= 0
    if not recorded.any():
        raise ValueError("no break was recorded: make the series with recorded_breaks")
    site, event = site[recorded], event[recorded]
    load, kinds = np.asarray(catalogue.load)[event], np.asarray(catalogue.kind)[event]
    for kind, colour in COLOURS.items():
        chosen = kinds == kind
        if chosen.any():
            ax.plot(site[chosen], load[chosen], ".", ms=3, color=colour, label=kind.name.lower())
    ax.set(xlabel="distance from the trailing edge, $x/\\lambda_c$", ylabel="load, $U/u_s$")
    ax.legend(frameon=False, title="event", loc="lower right", markerscale=3)
