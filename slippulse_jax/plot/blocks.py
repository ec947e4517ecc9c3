"""Pictures of the stress in a block as a front passes."""

from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from slippulse_jax.blocks import event as blocks
from slippulse_jax.blocks.elements import heights
from slippulse_jax.events.first import FirstPrecursor
from slippulse_jax.plot.labels import DISTANCE, axis_label
from slippulse_jax.plot.style import axes, colours, drawn

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REACH = 2.0
"""Largest stress on the colour scale, in σ_s."""


class Frames(NamedTuple):
    """Stresses of a block after given numbers of breaks."""

    found: FirstPrecursor
    breaks: np.ndarray
    y: np.ndarray  # heights of the nodes, in λc
    contact: np.ndarray  # stress on the contacts, in σ_s; by breaks and contacts
    threshold: np.ndarray  # of the contacts
    shear: np.ndarray  # σ_xy in the block over each contact, from one node to the next
    shown: int  # contacts in sight: those that broke, and half as many again


def frames_of(found: FirstPrecursor, breaks: np.ndarray) -> Frames:
    """Compute the stresses after given numbers of breaks."""
    if np.ndim(found.length):
        raise ValueError("a picture shows one precursor, not a batch")
    last = int(found.breaks)
    if breaks.min() < 0 or breaks.max() > last:
        raise ValueError(f"breaks = {breaks.max() if breaks.max() > last else breaks.min()}: this event has 0 to {last}")
    every = blocks.stages(found.body, found.interface, found.stress.size, jnp.asarray(breaks), found.event)
    contact, threshold, shear = map(np.asarray, every)
    furthest = int(np.max(np.nonzero(np.asarray(found.pinning))[0], initial=0)) + 1
    shown = min(found.stress.size, max(round(1.5 * furthest), round(float(found.body.height))))
    return Frames(found, breaks, np.asarray(heights(found.body)), contact, threshold, shear, shown)


@drawn
def block_stress(
    found: FirstPrecursor, breaks: int | None = None, *, colorbar: bool = True, ax: "Axes | None" = None
) -> "Axes":
    """Draw the shear stress in a block after some breaks.

    Parameters
    ----------
    found : FirstPrecursor
        Result of `first_precursor` for a block.
    breaks : int, optional
        Number of breaks, 0 at nucleation; by default all, when the event is over.
    colorbar : bool
        Whether to draw one.
    ax : matplotlib.axes.Axes, optional

    Raises
    ------
    ValueError
        If the event has fewer breaks.
    """
    ax = axes(ax)
    many = int(found.breaks) if breaks is None else breaks
    frames = frames_of(found, np.array([many]))
    mesh = draw_block(ax, frames, 0)
    ax.set_aspect("equal")
    ax.set_title(f"{many} breaks" if many else "at nucleation")
    ax.set_xlabel(DISTANCE)
    if colorbar:
        ax.figure.colorbar(mesh, ax=ax, label=r"shear stress, $\sigma_{xy}/\sigma_s$", extend="both", shrink=0.7)
    return ax


def draw_block(ax: "Axes", frames: Frames, number: int) -> Any:
    """Draw the stress and the pusher; return the coloured cells."""
    c, block, n = colours(ax), frames.found.body, frames.shown
    height = float(block.height)
    mesh = ax.pcolormesh(
        np.arange(n + 1), frames.y, frames.shear[number, :n].T, cmap="PuOr_r", vmin=-REACH, vmax=REACH, rasterized=True
    )
    low, high = (float(part) * height for part in block.push.reach)
    ax.plot([0, n], [height, height], color=c.ink, lw=0.8)
    ax.fill([-0.03 * n, 0, 0, -0.03 * n], [low, low, high, high], color=c.vermilion, lw=0)
    ax.set(xlim=(-0.03 * n, n), ylim=(0, 1.02 * height), ylabel=axis_label("height_above", "λc"))
    return mesh
