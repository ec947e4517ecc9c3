"""Animation of a front: displacements and contact stress as it passes."""

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from slippulse_jax.base.files import write_atomically
from slippulse_jax.events.first import FirstPrecursor
from slippulse_jax.front.front import front_fields
from slippulse_jax.interface import AnyInterface, Interface, kept_share
from slippulse_jax.plot import style
from slippulse_jax.plot.blocks import Frames, draw_block, frames_of
from slippulse_jax.plot.labels import DISTANCE, axis_label
from slippulse_jax.slider import Fields, Slider

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes

SUFFIXES = (".gif", ".mp4", ".html")


def animate(
    precursor: FirstPrecursor,
    path: str | Path | None = None,
    *,
    sites: int | None = None,
    fps: float = 12.0,
    hold: float = 1.0,
    dark: bool = False,
) -> "FuncAnimation":
    """Animate a first precursor, from nucleation to arrest.

    The upper panel has the displacements of a slider or the shear stress in a block, the lower one the contact stress. There
    is one frame per break, at most 150. The model has no time: frames count breaks.

    Parameters
    ----------
    precursor : FirstPrecursor
        Result of `first_precursor` for the front of one slider, or for one block; it must have stopped.
    path : path, optional
        File to write: ``.gif``, ``.mp4`` (needs ffmpeg) or ``.html``; it appears whole or not at all.
    sites : int, optional
        Number of contacts to show of a slider; by default twice the number that break.
    fps : float
        Frames per second.
    hold : float
        Pause at the end, in seconds.
    dark : bool
        For a dark page.

    Returns
    -------
    matplotlib.animation.FuncAnimation
        A notebook shows it as the last value of a cell.

    Raises
    ------
    ValueError
        If the precursor is a batch or did not stop, or the format is not supported.
    RuntimeError
        If ffmpeg, which MP4 needs, is not installed.
    """
    import matplotlib.pyplot as plt
    from matplotlib import animation

    if np.ndim(precursor.contacts_broken):
        raise ValueError("animate takes one precursor, not a batch")
    of_front, broken, recorded = precursor.front_stress is not None, int(precursor.breaks), precursor.stress.shape[0]
    if not of_front and isinstance(precursor.body, Slider):
        raise ValueError("animate shows the front of a slider (event='domino'), or the event of a block")
    if not np.isfinite(float(precursor.length)) or (broken > recorded and of_front):
        raise ValueError(f"this front did not stop within the {recorded} contacts recorded: there is no arrest to show")
    if not (fps > 0 and hold >= 0):
        raise ValueError(f"fps = {fps}, hold = {hold}: fps must be positive, hold 0 or more")
    writer = None if path is None else _writer(Path(path), fps)
    positions = np.unique(np.linspace(0, broken, min(broken + 1, 150)).round().astype(int))

    with style.use(dark=dark, figure__figsize=(5.2, 3.9), figure__dpi=100):
        if not of_front:
            frames = frames_of(precursor, positions)
            tall = float(np.clip(4.5 * float(precursor.body.height) / frames.shown, 1, 4))  # true to scale where it fits
            figure, panels = plt.subplots(2, 1, sharex=True, figsize=(5.2, tall + 2.5), height_ratios=(tall, 1.6))
            draw = _scene_of_block(panels, frames)
        else:
            figure, panels = plt.subplots(2, 1, sharex=True)
            shown = min(recorded, max(2 * broken, 16) if sites is None else sites)
            at = jax.vmap(lambda s: front_fields(precursor.body, precursor.interface, position=s, sites=recorded))
            draw = _scene(panels, at(jnp.asarray(positions)), positions, shown, precursor.interface)
        still = [len(positions) - 1] * round(hold * fps)
        movie = animation.FuncAnimation(figure, draw, frames=[*range(len(positions)), *still], interval=1000 / fps)
        draw(0)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # lay out once: it takes far longer than a frame
        if path is not None:
            _save(movie, Path(path), writer, fps)
        movie._repr_html_ = lambda: movie.to_jshtml(fps=fps)  # pyright: ignore[reportAttributeAccessIssue, reportArgumentType]
    plt.close(figure)
    return movie


def _scene(panels: Any, fields: Fields, positions: np.ndarray, shown: int, interface: AnyInterface) -> Any:
    """Draw the first frame; return the function that draws any other."""
    above, below = panels
    c = style.colours(above)
    x = np.arange(shown)
    upper, layer = (np.asarray(y)[:, :shown] for y in (fields.upper, fields.layer))
    stress = np.asarray(fields.stress)[:, :shown]
    threshold = np.asarray((interface or Interface()).threshold_at(jnp.asarray(x)))
    above.plot(x, upper[0], ":", color=c.blue, lw=1)
    above.plot(x, layer[0], ":", color=c.vermilion, lw=1)
    carried, levels, words = _contact_stress(below, x, stress, threshold[None], kept_share(interface))
    (on_top,) = above.plot(x, upper[0], color=c.blue, label="upper layer $u_t$")
    (in_layer,) = above.plot(x, layer[0], color=c.vermilion, label="interfacial layer $u$")
    fronts = [ax.axvline(0, color=c.green, lw=1, ls="--", label="front") for ax in (above, below)]
    above.set(ylabel=axis_label("displacement", "u_s"), ylim=(0, 1.08 * upper.max()), xlim=(-0.5, shown - 0.5))
    below.set_ylim(0, 1.15 * max(stress.max(), threshold.max()))
    above.legend(loc="upper right")

    def frame(number: int) -> list[Any]:
        on_top.set_ydata(upper[number])
        in_layer.set_ydata(layer[number])
        carried.set_ydata(stress[number])
        for line in fronts:
            line.set_xdata([positions[number] - 0.5] * 2)
        words.set_text(f"contacts broken: {positions[number]}{_at_end(number, positions)}")
        return [on_top, in_layer, carried, *fronts, words]

    return frame


def _scene_of_block(panels: Any, frames: Frames) -> Any:
    """Draw the first frame of a block, whose shear stress is above."""
    above, below = panels
    mesh = draw_block(above, frames, 0)
    above.figure.colorbar(mesh, ax=above, label=r"$\sigma_{xy}/\sigma_s$", extend="both", location="top", aspect=40)
    x, stress, threshold = np.arange(frames.shown) + 0.5, frames.contact[:, : frames.shown], frames.threshold[:, : frames.shown]
    kept = kept_share(frames.found.interface)
    carried, levels, words = _contact_stress(below, x, stress, threshold, kept)
    below.set_ylim(min(0, 1.1 * stress.min()), 1.15 * max(stress.max(), threshold[:, -1].max(), 1))

    def frame(number: int) -> list[Any]:
        mesh.set_array(frames.shear[number, : frames.shown].T)
        carried.set_ydata(stress[number])
        for line, share in zip(levels, (1, kept), strict=False):
            line.set_ydata(share * threshold[number])
        words.set_text(f"breaks: {frames.breaks[number]}{_at_end(number, frames.breaks)}")
        return [mesh, carried, *levels, words]

    return frame


def _contact_stress(below: "Axes", x: np.ndarray, stress: np.ndarray, threshold: np.ndarray, kept: Any) -> tuple[Any, ...]:
    """Draw stress and levels; return what changes between frames."""
    c = style.colours(below)
    below.plot(x, stress[0], ":", color=c.ink, lw=1, label="at nucleation")
    levels = below.plot(x, threshold[0], color=c.grey, lw=0.8, label="threshold")
    levels += style.draw_kept(below, x, kept * threshold[0])
    (carried,) = below.plot(x, stress[0], color=c.ink)
    below.legend(**style.ABOVE, ncols=3)
    below.set(xlabel=DISTANCE, ylabel=axis_label("stress", "σ_s"))
    return carried, levels, below.text(0.98, 0.93, "", transform=below.transAxes, ha="right", va="top")


def _at_end(number: int, frames: np.ndarray) -> str:
    return ", it stops" if number == len(frames) - 1 else ""


def _writer(path: Path, fps: float) -> Any:
    from matplotlib import animation

    if path.suffix not in SUFFIXES:
        raise ValueError(f"{path}: an animation is written as {', '.join(SUFFIXES)}")
    if path.suffix == ".gif":
        return animation.PillowWriter(fps=fps)  # pyright: ignore[reportArgumentType]
    if path.suffix == ".mp4":
        if not animation.FFMpegWriter.isAvailable():
            raise RuntimeError(f"{path}: MP4 needs ffmpeg, which is not installed; GIF and HTML do not")
        return animation.FFMpegWriter(fps=fps)  # pyright: ignore[reportArgumentType]
    return None


def _save(movie: "FuncAnimation", path: Path, writer: Any, fps: float) -> None:
    if writer is None:
        page = f'<!doctype html><meta charset="utf-8"><title>slip pulse</title>{movie.to_jshtml(fps=fps)}'  # pyright: ignore[reportArgumentType]
        write_atomically(path, page.encode())
        return
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / f"movie{path.suffix}"
        movie.save(whole, writer=writer, dpi=100)
        write_atomically(path, whole.read_bytes())
