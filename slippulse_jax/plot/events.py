"""Pictures of one event, and of series of events."""

import warnings
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from slippulse_jax.block import Block
from slippulse_jax.bodies.chain import Chain
from slippulse_jax.bodies.equilibrium import Equilibrium
from slippulse_jax.events.catalogue import Catalogue, EventClass
from slippulse_jax.events.rupture import Rupture
from slippulse_jax.front.sensitivity import Sensitivity
from slippulse_jax.interface import Interface, Profile
from slippulse_jax.plot.labels import DISTANCE, EXTENT, as_written, axis_label
from slippulse_jax.plot.style import axes, colours, draw_kept, drawn, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {
    EventClass.EDGE: "blue",
    EventClass.RENUCLEATED: "orange",
    EventClass.INTERIOR: "green",
    EventClass.SPANNING: "vermilion",
}
"""Colour of each class of event, by its name in `slippulse_jax.plot.style.Colours`."""

LARGE_DROP = 0.1
"""Drops of the force that are marked, over the largest."""

OVER_STRENGTH = r"force over strength of all contacts, $F/\Sigma\sigma_s\lambda_c^2$"
OVER_FRICTION = {  # of blocks with friction; a held top presses more or less as the push grows
    "free": r"force over that of friction, $F/\mu F_N$",
    "held": r"force over that of friction at rest, $F/\mu F_{N,0}$",
}
"""Labels of a force over the sum of thresholds, by the top."""


@drawn
def displacements(
    found: Equilibrium, *, before: Equilibrium | None = None, sites: int | None = None, ax: "Axes | None" = None
) -> "Axes":
    """Draw the displacements of the two layers, in u_s.

    Those `before` a rupture are dashed.

    Parameters
    ----------
    found, before : Equilibrium
    sites : int, optional
        Number of sites to show, from the left edge; all by default.
    ax : matplotlib.axes.Axes, optional
    """
    ax = axes(ax)
    c = colours(ax)
    shown = slice(sites)
    for state, style, when in ((before, "--", " before"), (found, "-", " after" if before is not None else "")):
        if state is not None:
            ax.plot(np.asarray(state.upper)[shown], style, color=c.blue, label=f"upper $u_t${when}")
            ax.plot(np.asarray(state.layer)[shown], style, color=c.vermilion, label=f"layer $u${when}")
    ax.set(xlabel=DISTANCE, ylabel=axis_label("displacement", "u_s"))
    legend_above(ax, most=2)
    return ax


@drawn
def stress(
    found: Equilibrium,
    *,
    chain: Chain | None = None,
    before: Equilibrium | None = None,
    sites: int | None = None,
    ax: "Axes | None" = None,
) -> "Axes":
    """Draw the stress on every contact, in σ_s.

    Thresholds, and what contacts keep, are those of `chain`; stresses `before` a rupture are dashed.
    """
    ax = axes(ax)
    c = colours(ax)
    shown = slice(sites)
    if before is not None:
        ax.plot(np.asarray(before.stress)[shown], "--", color=c.blue, label="before")
    ax.plot(np.asarray(found.stress)[shown], "-", color=c.vermilion, label="after" if before is not None else "stress")
    if chain is not None:
        threshold = np.asarray(chain.threshold)[shown]
        ax.plot(threshold, ":", color=c.grey, label="threshold")
        draw_kept(ax, np.arange(threshold.size), float(chain.residual_strength) * threshold)
    ax.set(xlabel=DISTANCE, ylabel=axis_label("stress", "σ_s"))
    legend_above(ax)
    return ax


@drawn
def front_stress(
    stress: np.ndarray,
    *,
    length: float | None = None,
    threshold: float = 1.0,
    residual_strength: float = 0.0,
    ax: "Axes | None" = None,
) -> "Axes":
    """Draw the stress on each contact as the front reaches it.

    A line marks the length ℓ, where the stress falls below threshold; a thin one what contacts keep as they break.
    """
    ax = axes(ax)
    c = colours(ax)
    stress = np.asarray(stress)
    ax.plot(stress, "o-", color=c.blue, markersize=3, linewidth=1, label="front")
    ax.axhline(threshold, color=c.grey, linestyle=":", label="threshold")
    draw_kept(ax, np.arange(stress.size), np.full(stress.shape, residual_strength * threshold))
    if length is not None and np.isfinite(length):
        ax.axvline(length, color=c.vermilion, linestyle="--", label=f"$\\ell = {float(length):.2f}\\,\\lambda_c$")
    ax.set(xlabel="contact, $s$ (distance from the trailing edge in $\\lambda_c$)", ylabel=axis_label("front_stress", "σ_s"))
    legend_above(ax)  # inside, it would lie on the threshold or on the curve
    return ax


@drawn
def break_order(found: Rupture, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the breaks of a rupture under the hard rule.

    Site is against order, and the colour is the stress drop. The model has no time beyond the order of breaks.
    """
    ax = axes(ax)
    n = int(found.breaks)
    order, released = np.asarray(found.order)[:n], np.asarray(found.released)[:n]
    points = ax.scatter(
        order, np.arange(1, n + 1), c=released, s=np.clip(4000 / max(n, 1), 2, 25), cmap="cividis", linewidths=0
    )
    ax.set(xlabel=DISTANCE, ylabel="breaks since the first")
    ax.figure.colorbar(points, ax=ax, label="stress drop, $t/\\sigma_s$")
    return ax


@drawn
def sensitivity(found: Sensitivity, *, sites: int | None = None, ax: "Axes | None" = None) -> "Axes":
    """Draw the derivatives of the length by every threshold and prestress.

    Parameters
    ----------
    found : Sensitivity
    sites : int, optional
        Number of contacts to show; by default up to a little beyond the arrest, behind which all derivatives are 0.
    ax : matplotlib.axes.Axes, optional
    """
    ax = axes(ax)
    c = colours(ax)
    if sites is None and np.isfinite(found.length):
        sites = int(1.15 * float(found.length)) + 2
    shown = slice(sites)
    theta, phi = np.asarray(found.threshold)[shown], np.asarray(found.prestress)[shown]
    x = np.arange(theta.size)
    ax.axhline(0, color=c.grey, linewidth=0.8)
    ax.bar(x - 0.2, theta, 0.4, color=c.blue, label="threshold, $\\partial\\ell/\\partial\\theta_i$")
    ax.bar(x + 0.2, phi, 0.4, color=c.vermilion, label="prestress, $\\partial\\ell/\\partial\\varphi_i$")
    length = float(found.length)
    if np.isfinite(length):
        ax.axvline(length, color=c.green, linestyle="--", linewidth=1, label=f"$\\ell = {length:.2f}\\,\\lambda_c$")
    ax.set_yscale("symlog", linthresh=1, linscale=0.7)
    ax.set(xlabel=DISTANCE, ylabel="derivative of $\\ell$ ($\\lambda_c/\\sigma_s$)")
    legend_above(ax)
    return ax


@drawn
def friction_curve(catalogue: Catalogue, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the driving force against the load.

    Points mark where events begin that drop the force by at least a tenth of the largest drop, coloured by class.
    """
    ax = axes(ax)
    c = colours(ax)
    events = catalogue.table()
    load = np.repeat(np.append(0.0, events["load"]), 2)[1:]
    force = np.append(0.0, np.stack([events["force_before"], events["force_after"]], axis=1).ravel())
    ax.plot(load, force, color=c.ink, lw=1, label="force")
    drop = events["force_before"] - events["force_after"]
    large = drop >= LARGE_DROP * drop.max(initial=0)
    _points(ax, *(events[name][large] for name in ("load", "force_before", "kind")), ms=5)
    ax.set(xlabel=axis_label("load", "u_s"), ylabel="driving force, $F/(K u_s)$")
    ax.margins(x=0.02)
    legend_above(ax, title="points: drops of at least a tenth of the largest")
    return ax


def _points(ax: "Axes", x: np.ndarray, y: np.ndarray, kinds: np.ndarray, **look: Any) -> None:
    """Draw points of events, each class in its colour."""
    for kind, colour in COLOURS.items():
        chosen = kinds == kind
        if chosen.any():
            ax.plot(x[chosen], y[chosen], ".", color=getattr(colours(ax), colour), label=kind.name.lower(), **look)


@drawn
def precursors(
    catalogue: Catalogue,
    body: Block | Chain,
    *,
    interface: Interface | Profile | None = None,
    least_advance: float = 1.5,
    label: str | None = None,
    colour: str = "blue",
    ax: "Axes | None" = None,
) -> "Axes":
    """Draw the extent of precursors against the driving force.

    As experiments report it: the extent over the length of the body, against the force as the event starts over that at which
    all contacts would be at their threshold, which on a block with friction and equal contacts is μ times the normal load. The
    line follows the farthest contact broken so far; open points are events that do not begin at the edge.

    Parameters
    ----------
    catalogue : Catalogue
        Of a series on `body`.
    body : Block or Chain
        With an end.
    interface : Interface or Profile, optional
        Of the contacts of a block, as `series` had it.
    least_advance : float
        Events that take the farthest broken contact no more than this forward, in λc, have no point, except where they span.
        By default creep by single contacts has none; −inf draws every event.
    label : str, optional
        Legend entry, drawn as written, for several series in one picture.
    colour : str
        Name in `slippulse_jax.plot.style.Colours`.
    ax : matplotlib.axes.Axes, optional

    Raises
    ------
    ValueError
        If the block has no end, the catalogue is of a longer one, or it is a batch.
    """
    contacts, strength, name = _driving(body, interface)
    if (largest := int(np.max(catalogue.extent, initial=0))) > contacts:
        raise ValueError(f"body has {contacts} contacts, and the catalogue an event of {largest}: it is of another body")
    ax = axes(ax)
    c, events = getattr(colours(ax), colour), catalogue.table()
    force, extent = events["force_before"] / strength, events["extent"]
    farthest = np.maximum.accumulate(np.append(0, extent))
    advance, spans, edge = extent - farthest[:-1], events["kind"] == EventClass.SPANNING, events["site"] == 0
    name_of_line = as_written(label) if label else "farthest contact broken"
    ax.plot(force[advance > 0], extent[advance > 0] / contacts, color=c, lw=1, label=name_of_line)
    for chosen, marker, size, what in (((advance > least_advance) & ~spans, "o", 3, "precursor"), (spans, "D", 5, "spanning")):
        for here, style in ((chosen & edge, "full"), (chosen & ~edge, "none")):
            if here.any():
                look = {"ms": size, "color": c, "fillstyle": style, "label": None if label else what}
                ax.plot(force[here], extent[here] / contacts, marker, **look)
    name = name if ax.get_xlabel() in ("", name) else OVER_STRENGTH  # of what else is drawn
    ax.margins(x=0.08)
    ax.set(xlabel=name, ylabel=EXTENT, ylim=(0, 1.05))
    opened = any(line.get_fillstyle() == "none" for line in ax.lines)
    title = "open: does not begin at the edge" if opened else None
    legend_above(ax, title=title)
    return ax


def _driving(body: Block | Chain, interface: Interface | Profile | None) -> tuple[int, float, str]:
    """Number of contacts, sum of their thresholds, and label of the force."""
    if isinstance(body, Chain):
        return body.sites, float(body.stiffness * np.sum(body.threshold, where=np.asarray(body.contact) > 0)), OVER_STRENGTH
    if body.sites is None:
        raise ValueError("a block without end has no length that a precursor could be compared with: give Block.length")
    threshold = np.asarray((interface or Interface()).threshold_at(jnp.arange(body.sites)))
    name = OVER_FRICTION[body.top] if body.friction and (threshold == 1).all() else OVER_STRENGTH
    return body.sites, float(body.stiffness * threshold.sum()), name


@drawn
def space_time(catalogue: Catalogue, *, ax: "Axes | None" = None) -> "Axes":
    """Draw every recorded break, load against site.

    The colour is the class of the event; a renucleated one begins where an earlier one was arrested. Breaks that were not
    recorded give a warning.
    """
    ax = axes(ax)
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
    _points(ax, site, load, kinds, ms=3)
    ax.set(xlabel=DISTANCE, ylabel=axis_label("load", "u_s"))
    legend_above(ax, markerscale=2, title="breaks, by the class of the event")
    return ax
