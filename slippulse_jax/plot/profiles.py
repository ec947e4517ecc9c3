"""Pictures of a recovered profile and of its resolution."""

from typing import TYPE_CHECKING

import numpy as np

from slippulse_jax.inference.search.intervals import LEVELS
from slippulse_jax.plot.labels import DISTANCE, axis_label
from slippulse_jax.plot.style import axes, colours, dashed_where, drawn, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slippulse_jax.inference.recover import RecoveredProfile

LABEL = {"threshold": "threshold, $\\theta/\\theta_0$", "prestress": axis_label("prestress", "σ_s")}


@drawn
def recovered_profile(found: "RecoveredProfile", *, ax: "Axes | None" = None) -> "Axes":
    """Draw a recovered profile with its 68 % and 95 % bands.

    The band of the prior alone and the arrests are drawn too. The line is dashed where the lengths do not determine it.
    """
    ax = axes(ax)
    c = colours(ax)
    x = found.position
    if found.kind == "threshold":
        prior = found.prior_stderr / found.profile
        ax.fill_between(x, np.exp(-1.96 * prior), np.exp(1.96 * prior), color=c.grey, alpha=0.13, lw=0, label="prior, 95%")
    for level, alpha in zip(LEVELS[::-1], (0.2, 0.35), strict=True):
        ax.fill_between(x, *found.interval(level), color=c.blue, alpha=alpha, lw=0, label=f"{level:.0%} band")
    dashed_where(ax, x, found.profile, ~found.determined, color=c.blue, label="recovered")
    if found.at_arrest is not None:
        along = {"fmt": "o", "ms": 3, "lw": 0.8, "color": c.vermilion, "label": "one length each"}
        ax.errorbar(found.arrest, found.at_arrest, found.at_arrest_stderr, found.measurements.length_sigma, **along)
    else:
        ax.axhline(0, color=c.grey, lw=0.6)
        at_bottom = {"transform": ax.get_xaxis_transform(), "clip_on": False}
        ax.plot(found.measurements.length, 0 * found.fitted, "|", ms=8, color=c.vermilion, label="arrests", **at_bottom)
    shown = x <= 1.15 * found.measurements.length.max()
    if not found.determined[shown].all():
        ax.plot([], [], "--", color=c.blue, lw=0.8, label="not determined")
    low, high = (end[shown] for end in found.interval(LEVELS[-1]))
    room = 0.15 * (high.max() - low.min())
    ax.set(xlabel=DISTANCE, ylabel=LABEL[found.kind], xlim=(0, x[shown][-1]), ylim=(low.min() - room, high.max() + room))
    legend_above(ax)  # the bands leave no corner free
    return ax


@drawn
def resolution(found: "RecoveredProfile", *, ax: "Axes | None" = None) -> "Axes":
    """Draw the averaging kernels of a recovered profile.

    A kernel is the weight per λc that a recovered value gives to the true profile at each place.
    """
    ax = axes(ax)
    shown = found.position <= found.measurements.length.max() + 1
    x = found.position[shown]
    per_length = found.resolution[np.ix_(shown, shown)] / np.gradient(x)
    most = abs(per_length[:, 1:]).max()
    image = ax.pcolormesh(x, x, per_length, cmap="RdBu_r", vmin=-most, vmax=most, shading="nearest", rasterized=True)
    beyond = "both" if abs(per_length[:, 0]).max() > most else "neither"
    ax.figure.colorbar(image, ax=ax, label="weight, per $\\lambda_c$", extend=beyond)
    ax.plot(x, x, color=colours(ax).grey, lw=0.6, ls=":")
    ax.set(xlabel="true profile at $x'/\\lambda_c$", ylabel="recovered profile at $x/\\lambda_c$")
    return ax
