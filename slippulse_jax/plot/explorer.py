"""Interactive explorer of fields, length and sensitivities."""

import functools
import io
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slippulse_jax.base.status import Outcome
from slippulse_jax.events.first import FirstPrecursor
from slippulse_jax.front.front import front_fields
from slippulse_jax.interface import Interface
from slippulse_jax.plot import style
from slippulse_jax.plot.labels import AGAIN, DISTANCE, KEPT, axis_label
from slippulse_jax.precursor import first_precursor, precursor_length
from slippulse_jax.slider import Fields, Slider

SITES = 320
"""Contacts computed and shown, the same for every slider and compiled program."""

LOW = float(np.log10(0.03)) - 1.5  # so that the paper's 0.03 is a step of the slider
STEPS = {
    "+1 % height": (0, 0.01, True),
    "+1 % stiffness": (1, 0.01, True),
    "+0.01 Poisson": (2, 0.01, False),
    "+0.01 prestress": (3, 0.01, False),
    "+0.001 slope": (4, 0.001, False),
    "+0.01 residual": (5, 0.01, False),
}
"""Changes whose effect is shown: parameter, size, and whether it is relative."""


class View(NamedTuple):
    """Everything drawn, in arrays of fixed shapes."""

    front: FirstPrecursor
    fields: Fields  # with the front at a position
    position: Array
    slopes: Array  # of the length, in (H/λc, k/K, ν, φ, ε, r)
    again: Array  # number of broken contacts at which the edge contact is back at its threshold; −1 where it never is


@jax.jit
def view(theta: Array, position: Array) -> View:
    """Compute the view of one slider, with the front at a position.

    `theta` is (H/λc, k/K, ν, φ, ε, r); `position` is a number of broken contacts, or −1 for where the front stops.
    """

    def model(x: Array) -> tuple[Slider, Interface]:
        return Slider(x[0], x[1], x[2]), Interface(x[3], x[4], x[5])

    def length(x: Array) -> Array:
        return precursor_length(*model(x))

    slider, interface = model(theta)
    front = first_precursor(slider, interface, sites=SITES)

    def fields_at(position: Array) -> Fields:
        return front_fields(slider, interface, position=position, sites=SITES)

    at = jnp.where(position < 0, front.contacts_broken, position)
    sites = jnp.arange(SITES)
    # repinned behind the front
    again = (jax.vmap(lambda s: fields_at(s).stress[0])(sites) >= 1) & (sites > 0)
    breaks = again.any() & ((front.status == Outcome.REBREAK) | (front.status == Outcome.RUN_AWAY))
    return View(front, fields_at(at), at, jax.jacfwd(length)(theta), jnp.where(breaks, again.argmax(), -1))


def explore(*, dark: bool = False) -> Any:
    """Show fields, length and sensitivities beside sliders for the parameters.

    The sliders set H/λc, k/K, ν, prestress, threshold slope and residual strength. The play button runs the front from
    nucleation to arrest. It is for notebooks, and needs the extra ``explore`` (ipywidgets).

    Parameters
    ----------
    dark : bool
        For a dark page.

    Returns
    -------
    ipywidgets.VBox
        Show it as the last value of a cell.

    Raises
    ------
    ImportError
        If ipywidgets is not installed.
    """
    try:
        import ipywidgets as widgets
    except ImportError as error:
        raise ImportError("explore needs ipywidgets: pip install 'slippulse_jax[explore]'") from error
    wide = {"style": {"description_width": "10em"}, "layout": widgets.Layout(width="24em")}
    number = functools.partial(widgets.FloatSlider, **wide)
    ratio = widgets.FloatLogSlider(value=0.03, min=LOW, max=LOW + 2.5, step=0.02, description="stiffness k/K", **wide)
    parameters = {
        "height": number(value=25, min=5, max=60, step=0.5, description="height H/λc"),
        "stiffness": ratio,
        "poisson": number(value=0.3, min=0, max=0.5, step=0.01, description="Poisson ν"),
        "prestress": number(value=0, min=0, max=0.7, step=0.01, description="prestress φ"),
        "slope": number(value=0, min=-0.005, max=0.01, step=0.0005, description="slope ε", readout_format=".4f"),
        "residual": number(value=0, min=0, max=0.9, step=0.01, description="residual strength r"),
    }
    position = widgets.IntSlider(value=26, min=0, max=26, description="contacts broken", **wide)
    play = widgets.Play(value=0, min=0, max=26, interval=120)
    numbers, picture = widgets.HTML(), widgets.Image(format="png", layout=widgets.Layout(max_width="100%"))
    drawing = Drawing(dark)

    def show(at: int) -> View:
        theta = np.array([control.value for control in parameters.values()])
        with jax.enable_x64(True):
            seen = jax.tree.map(np.asarray, view(jnp.asarray(theta), jnp.asarray(at)))
        numbers.value, picture.value = describe(seen), drawing(seen, theta)
        return seen

    def move(_: Any) -> None:
        show(position.value)

    def restart(_: Any = None) -> None:
        broken = int(show(-1).front.contacts_broken)
        position.unobserve(move, "value")
        position.max = play.max = min(broken, SITES) if broken > 0 else SITES
        position.value = position.max
        position.observe(move, "value")

    for control in parameters.values():
        control.observe(restart, "value")
    position.observe(move, "value")
    widgets.jslink((play, "value"), (position, "value"))
    # side by side, so that the picture stays in sight while a slider is moved
    row = widgets.HBox([*parameters.values(), position, play], layout=widgets.Layout(flex_flow="row wrap"))
    restart()
    shown = widgets.VBox([numbers, row, picture])
    for name, part in {**parameters, "position": position, "play": play, "numbers": numbers, "picture": picture}.items():
        setattr(shown, name, part)
    return shown


def describe(seen: View) -> str:
    """Format the line of numbers, as HTML."""
    front, stops = seen.front, np.isfinite(seen.front.length)
    length = f"{float(front.length):.2f} λ<sub>c</sub>" if stops else "none: the front does not stop"
    count = int(front.contacts_broken) if stops else "–"
    return (
        f"<b>length ℓ = {length}</b> &nbsp; whole contacts: {count} &nbsp; "
        f"load at nucleation: {float(front.load):.3f} u<sub>s</sub><br><small>{Outcome(int(front.status)).message}</small>"
    )


class Drawing:
    """Four panels whose lines are moved, not redrawn."""

    def __init__(self, dark: bool) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._laid_out = False
        with style.use(dark=dark):
            self.figure = Figure(figsize=(8.6, 5.0), dpi=100, layout="constrained")
            self.canvas = FigureCanvasAgg(self.figure)
            grid = self.figure.subplot_mosaic([["fields", "front"], ["stress", "slopes"]])
            self.fields, self.front, self.stress, self.slopes = (grid[x] for x in ("fields", "front", "stress", "slopes"))
            c = style.colours(self.fields)
            x = np.arange(SITES)
            (self.upper,) = self.fields.plot(x, x, color=c.blue, label="upper layer $u_t$")
            (self.layer,) = self.fields.plot(x, x, color=c.vermilion, label="interfacial layer $u$")
            (self.carried,) = self.stress.plot(x, x, color=c.ink, label="stress")
            (self.held,) = self.stress.plot(x, x, ":", color=c.grey, label="threshold")
            (self.kept,) = self.stress.plot(x, x, "-.", color=c.grey, lw=0.6, label=KEPT)
            (self.tip,) = self.front.plot(x, x, "o-", ms=2.5, lw=1, color=c.blue, label="front stress")
            (self.limit,) = self.front.plot(x, x, ":", color=c.grey, label="threshold")
            self.arrest = self.front.axvline(0, color=c.vermilion, ls="--", lw=1, label="length, $\\ell$")
            self.again = self.front.axvline(0, color=c.purple, lw=1, label=AGAIN)
            panels = (self.fields, self.stress, self.front)
            self.marks = [ax.axvline(0, color=c.green, lw=1, ls="--", label="front") for ax in panels]
            self.bars = self.slopes.barh(list(STEPS), np.zeros(len(STEPS)), color=c.blue)
            self.slopes.axvline(0, color=c.ink, lw=0.8)
            self.slopes.invert_yaxis()
            self.words = self.slopes.text(0.5, 0.5, "", transform=self.slopes.transAxes, ha="center", va="center")
            for ax, name, unit in ((self.fields, "displacement", "u_s"), (self.stress, "stress", "σ_s")):
                ax.set(xlabel=DISTANCE, ylabel=axis_label(name, unit))
                ax.legend(**style.ABOVE, ncols=4)
            self.front.set(xlabel="contact, $s$ ($x/\\lambda_c$)", ylabel=axis_label("front_stress", "σ_s"))
            self.front.legend(**style.ABOVE, ncols=3)
            self.slopes.set(xlabel="change of the length, $\\lambda_c$")

    def __call__(self, seen: View, theta: np.ndarray) -> bytes:
        """Draw one view, as PNG."""
        front, fields, threshold = seen.front, seen.fields, 1 + theta[4] * np.arange(SITES)
        stops = bool(np.isfinite(front.length))
        broken = min(int(front.contacts_broken), SITES) if stops else SITES
        shown = int(min(SITES, max(20, 1.7 * broken)))
        for line, y in (
            (self.upper, fields.upper), (self.layer, fields.layer), (self.carried, fields.stress), (self.held, threshold),
            (self.tip, front.front_stress), (self.limit, threshold), (self.kept, (theta[5] or np.nan) * threshold),
        ):  # fmt: skip
            line.set_ydata(y)
        for mark in self.marks:
            mark.set_xdata([float(seen.position) - 0.5] * 2)
        self.arrest.set_xdata([float(front.length) if stops else -10] * 2)
        self.again.set_xdata([float(seen.again) if seen.again > 0 else -10] * 2)
        for ax, y, least in (
            (self.fields, fields.upper, 0.1),
            (self.stress, fields.stress, 1.3),
            (self.front, front.front_stress, 1.3),
        ):
            ax.set_xlim(-1, shown)
            ax.set_ylim(0, 1.1 * max(float(np.max(y[:shown])), least))
        self._draw_slopes(seen, theta, stops)
        if not self._laid_out:
            self.figure.draw_without_rendering()
            self.figure.set_layout_engine("none")  # lay out once: it takes longer than the drawing
            self._laid_out = True
        picture = io.BytesIO()
        self.canvas.print_png(picture)
        return picture.getvalue()

    def _draw_slopes(self, seen: View, theta: np.ndarray, stops: bool) -> None:
        changes = [
            float(seen.slopes[i]) * step * (theta[i] if relative else 1.0) if stops else 0.0
            for i, step, relative in STEPS.values()
        ]
        for bar, change in zip(self.bars, changes, strict=True):
            bar.set_width(change)
        self.words.set_text("" if stops else "the front does not stop")
        reach = 1.15 * max(*map(abs, changes), 0.1)
        self.slopes.set_xlim(-reach, reach)
