"""Schematics of a slider and of a block on their contacts."""

from typing import TYPE_CHECKING

import numpy as np

from slippulse_jax.block import Block
from slippulse_jax.plot.style import axes, colours, drawn
from slippulse_jax.slider import Slider

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CONTACTS = 7
"""Number drawn."""


@drawn
def schematic(body: Slider | Block, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the parts of the model.

    They are a slider's two layers and springs, or a block, its pusher and its contacts. A few contacts stand for many, of which
    the first two have broken and are pinned where they are, at zero stretch. Only the pusher of a block is to scale.

    Parameters
    ----------
    body : Slider or Block
        One of them, not a batch.
    ax : matplotlib.axes.Axes, optional
    """
    ax = axes(ax, height=1.9)
    if np.shape(body.height):
        raise ValueError(f"schematic takes one body, not a batch of shape {np.shape(body.height)}")
    x = np.arange(CONTACTS) + 0.5
    if isinstance(body, Block):
        _block(ax, body)
    else:
        _slider(ax, x)
    _contacts(ax, x)
    numbers = f"$H/\\lambda_c$ = {float(body.height):g}, $k/K$ = {float(body.stiffness):g}, ν = {float(body.poisson):g}"
    ax.set_title(("Block" if isinstance(body, Block) else "Slider") + f": {numbers}")
    ax.set(xlim=(-1.9, CONTACTS + 0.5), ylim=(-1.6, 2.75), aspect="equal")
    ax.axis("off")
    return ax


def _slider(ax: "Axes", x: np.ndarray) -> None:
    """Draw two layers of rigid slices, joined by springs."""
    c = colours(ax)
    for i, at in enumerate(x):
        _box(ax, at - 0.3, 1.3, 0.6, 1.0, c.blue)
        _box(ax, at - 0.3, 0.0, 0.6, 0.3, c.orange)
        _spring(ax, (at, 0.3), (at, 1.3))
        if i:
            _spring(ax, (at - 0.7, 1.8), (at - 0.3, 1.8), coils=3)
            _spring(ax, (at - 0.7, 0.15), (at - 0.3, 0.15), coils=3)
    for y in (1.8, 0.15):
        _spring(ax, (x[-1] + 0.3, y), (x[-1] + 0.75, y), coils=3)
    _push(ax, 0.2, 1.8)
    ax.text(-0.7, 1.8, "$U$", ha="right", va="center")
    names = {"$u_t$: slices of height $H$": (x[3], 2.38), "$K_L$": (1.0, 1.95), "$K$": (1.0, 0.33), "$K_T$": (1.0, 0.7)}
    for name, (at, y) in (names | {"$u$": (x[3], 0.04)}).items():
        ax.text(at, y, name, ha="center", va="bottom", fontsize="small")


def _block(ax: "Axes", body: Block) -> None:
    """Draw an elastic body that is pushed over part of its side."""
    c = colours(ax)
    height, right = 2.6, CONTACTS + 0.25
    edge = np.linspace(0, height, 80)
    ends = body.length is not None
    torn = right + 0.12 * np.sin(edge * 9) * (not ends)
    ax.fill(np.concatenate([[0, 0], torn[::-1]]), np.concatenate([[0, height], edge[::-1]]), color=c.blue, alpha=0.25, lw=0)
    ax.plot([right, 0, 0, right] + [right] * ends, [height, height, 0, 0] + [height] * ends, color=c.ink, lw=1)
    low, high = (float(part) * height for part in body.push.reach)
    ax.fill([-0.3, 0, 0, -0.3], [low, low, high, high], color=c.vermilion, lw=0)
    force = body.push.control == "force"
    for y in np.linspace(low, high, 7)[1::2] if force else [(low + high) / 2]:
        _push(ax, -0.3, float(y))
    ax.text(-1.2, (low + high) / 2, "$F$" if force else "$U$", ha="right", va="center")
    marks = {"$H$": (0.0, height, 6.2)}
    if body.push.height is not None:
        marks["$h$"] = (0.0, float(body.push.height) * height, 0.9)
    if body.push.width is not None:
        marks["$w$"] = (low, high, 0.2)
    for name, (start, end, at) in marks.items():
        ends = "|-|,widthA=0.2,widthB=0.2" if name == "$w$" else "<->"
        arrow = {"arrowstyle": ends, "color": c.ink, "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", (at, end), (at, start), arrowprops=arrow)
        ax.text(at + 0.1, (start + end) / 2, name, va="center")
    ax.text(3.4, 1.5, r"$\nabla\cdot\sigma = 0$" + f", plane {body.plane}", ha="center")
    rests = "$u_y = 0$" if body.normal_stiffness is None else f"$k_n/k$ = {float(body.normal_stiffness):g}"
    ax.text(3.4, 0.25, f"{rests} along the interface", ha="center", fontsize="small")


def _contacts(ax: "Axes", x: np.ndarray) -> None:
    """Draw contacts with the track, two of them pinned again."""
    c = colours(ax)
    track = -0.85
    for i, at in enumerate(x):
        lag = 0.0 if i < 2 else 0.22 * np.exp(-(i - 2) / 2.5)
        _spring(ax, (at, 0), (at - lag, track), colour=c.vermilion if i < 2 else c.ink)
        ax.plot(at - lag, track, "o", ms=2.5, color=c.vermilion if i < 2 else c.ink)
    ax.plot([-0.2, CONTACTS + 0.3], [track, track], color=c.ink, lw=1)
    for at in np.arange(-0.1, CONTACTS + 0.3, 0.25):
        ax.plot([at, at - 0.12], [track, track - 0.12], color=c.ink, lw=0.5)
    ax.text(x[0] - 0.22, track / 2, "$k$", ha="right", va="center")
    ax.annotate("", (x[6], -1.12), (x[5], -1.12), arrowprops={"arrowstyle": "<->", "color": c.ink, "lw": 0.7})
    ax.text((x[5] + x[6]) / 2, -1.2, r"$\lambda_c$", ha="center", va="top")
    ax.text(x[0], -1.08, "broken, pinned at zero stretch", va="top", fontsize="small", color=c.vermilion)


def _box(ax: "Axes", x: float, y: float, width: float, height: float, colour: str) -> None:
    from matplotlib.patches import Rectangle

    ax.add_patch(Rectangle((x, y), width, height, facecolor=colour, alpha=0.35, edgecolor="none"))
    ax.add_patch(Rectangle((x, y), width, height, facecolor="none", edgecolor=colours(ax).ink, lw=0.8))


def _spring(
    ax: "Axes", start: tuple[float, float], end: tuple[float, float], *, coils: int = 5, colour: str | None = None
) -> None:
    """Draw a zigzag from one point to another."""
    a, b = np.array(start), np.array(end)
    along = b - a
    across = 0.09 * np.array([-along[1], along[0]]) / np.hypot(*along)
    share = np.concatenate([[0, 0.15], np.linspace(0.15, 0.85, 2 * coils + 1)[1:-1], [0.85, 1]])
    side = np.concatenate([[0, 0], np.resize([1, -1], 2 * coils - 1), [0, 0]])
    ax.plot(*(a[:, None] + along[:, None] * share + across[:, None] * side), color=colour or colours(ax).ink, lw=0.7)


def _push(ax: "Axes", x: float, y: float) -> None:
    ax.annotate("", (x, y), (x - 0.8, y), arrowprops={"arrowstyle": "-|>", "color": colours(ax).vermilion, "lw": 1.6})
