"""Compute and draw the paper's Figures 2 and 3."""

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from slippulse_jax import theory
from slippulse_jax.base.files import FIGURE_FORMATS, write_atomically
from slippulse_jax.base.status import Outcome
from slippulse_jax.exact.bulk import exact_lengths
from slippulse_jax.exact.front import exact_fields, exact_front_stress
from slippulse_jax.lengths import arrests, precursor_lengths
from slippulse_jax.paper import FIG2
from slippulse_jax.plot.labels import AGAIN
from slippulse_jax.plot.style import LIGHT, save
from slippulse_jax.slider import Slider

POISSON, SITES = 0.3, 100
"""Poisson's ratio and L/λc of Fig. 3."""

STIFFNESSES = {0.03: LIGHT.vermilion, 0.01: LIGHT.blue, 0.003: LIGHT.ink}
HEIGHTS = {10: LIGHT.vermilion, 25: LIGHT.blue, 50: LIGHT.ink}
MARKERS = {LIGHT.vermilion: "D", LIGHT.blue: "s", LIGHT.ink: "o"}
"""The paper's symbols."""


Table = dict[str, np.ndarray]


def fig2_fields() -> Table:
    """Fig. 2 a, b: displacements (u_s) and stress (σ_s) against x/λc."""
    x = np.arange(61)
    table: Table = {"x": x}
    for s in (0, 13, 26):  # nucleation, on the way, arrest
        for name, value in exact_fields(FIG2, s, x)._asdict().items():
            table[f"{name}_s{s}"] = np.asarray(value)
    return table


def fig2_stress() -> Table:
    """Fig. 2 c: stress (σ_s) at nucleation and at the passing front."""
    x = np.arange(61)
    tip, before = np.asarray(exact_front_stress(FIG2, x)), np.asarray(exact_fields(FIG2, 0, x).stress)
    # at x = 0 their limit, contact 0 having broken
    continuum, frozen = (np.asarray(f(FIG2, x)) for f in (theory.continuum_stress, theory.frozen_stress))
    return {"x": x, "nucleation": before, "front": tip, "extra": tip - before, "continuum": continuum, "frozen": frozen}


def lengths(height: np.ndarray, stiffness: np.ndarray) -> Table:
    """Λ/λc by every level of theory, and contacts broken (NaN: all)."""
    slider = Slider(height, stiffness, POISSON)
    lattice = exact_lengths(slider)
    table = {
        "lattice": lattice,
        "contacts": _contacts(lattice),
        "breaks_again": arrests(slider).status == Outcome.REBREAK,
        "continuum": theory.length_continuum(slider),
        "frozen": theory.length_frozen(slider),
        "eq58": theory.length(slider),
        "eq25": theory.length_eq25(slider),
        "envelope": theory.envelope_length(slider),
    }
    for right in ("free", "clamped"):
        table[f"{right}_L{SITES}"] = _contacts(precursor_lengths(Slider(height, stiffness, POISSON, length=SITES, right=right)))
    return {"height": height, "stiffness": stiffness} | {k: np.asarray(v) for k, v in table.items()}


def _contacts(length: np.ndarray) -> np.ndarray:
    """Whole contacts broken; NaN where the front does not stop."""
    return np.where(np.isfinite(length), np.maximum(np.ceil(length), 1), np.nan)


def fig3a() -> Table:
    """Fig. 3 a: Λ against H/λc at three stiffnesses of the interface."""
    H, q = (x.ravel() for x in np.meshgrid(np.arange(5.0, 61.0), list(STIFFNESSES)))
    return lengths(H, q)


def fig3b() -> Table:
    """Fig. 3 b: Λ against k/K at three heights."""
    q, H = (x.ravel() for x in np.meshgrid(np.geomspace(1e-3, 1e-1, 41), [float(h) for h in HEIGHTS]))
    return lengths(H, q)


def draw_figures(
    directory: str | Path, formats: Iterable[str] = FIGURE_FORMATS, names: Iterable[str] = ("fig2", "fig3")
) -> list[Path]:
    """Draw the figures into a directory, with their numbers as CSV.

    It is created if missing, and each file appears whole or not at all. Return the files written; a ValueError for an unknown
    format or name.
    """
    formats, names = list(formats), list(names)
    for value, known in ((formats, FIGURE_FORMATS), (names, tuple(_FIGURES))):
        for x in value:
            if x not in known:
                raise ValueError(f"unknown {x!r}: must be one of {', '.join(known)}")
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    written = []
    with jax.enable_x64(True):
        for name in names:
            tables, draw = _FIGURES[name]
            data = {key: make() for key, make in tables.items()}
            for key, table in data.items():
                written.append(directory / f"{key}.csv")
                write_atomically(written[-1], _csv(table))
            figure = draw(data)
            for form in formats:
                written.append(directory / f"{name}.{form}")
                save(figure, written[-1], dpi=200)
    return written


def _csv(table: Table) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(table)
    for row in zip(*table.values(), strict=True):
        writer.writerow([f"{float(x):.10g}" for x in row])
    return text.getvalue().encode()


def _axes(count: int, width: float) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width * count, 3.4), layout="constrained")
    axes = figure.subplots(1, count)
    for ax, letter in zip(axes, "abc", strict=False):
        ax.spines[["top", "right"]].set_visible(False)
        ax.set_title(f"({letter})", loc="left", fontsize=10)
    return figure, axes


def _draw_fig2(data: dict[str, Table]) -> Any:
    figure, (a, b, c) = _axes(3, 4.0)
    fields, tip = data["fig2_fields"], data["fig2_stress"]
    x, styles = fields["x"], {0: ":", 13: "--", 26: "-"}
    for s, style in styles.items():
        a.plot(x, fields[f"upper_s{s}"], style, color=LIGHT.blue)
        a.plot(x, fields[f"layer_s{s}"], style, color=LIGHT.vermilion)
        b.plot(x, fields[f"stress_s{s}"], style, color=LIGHT.ink)
    a.text(6, 3.0, "upper layer $u_t$", color=LIGHT.blue)
    a.text(0.8, 0.42, "interfacial layer $u$", color=LIGHT.vermilion)
    a.set(xlabel="$x/\\lambda_c$", ylabel="displacement ($u_s$)", ylim=(0, 3.4), xlim=(0, 60))
    handles = [a.plot([], [], style, color="0.3")[0] for style in styles.values()]
    a.legend(handles, ["nucleation, $s=0$", "$s=13\\,\\lambda_c$", "arrest, $s=26\\,\\lambda_c$"], frameon=False, fontsize=8)
    for s, where in ((0, (14, 0.56)), (13, (14.5, 1.22)), (26, (27.5, 1.03))):
        b.text(*where, f"$s={s}$", fontsize=9)
    b.axhline(1, color="0.75", lw=0.8, zorder=0)
    b.set(xlabel="$x/\\lambda_c$", ylabel="interface stress $\\sigma_c$ ($\\sigma_s$)", xlim=(0, 60), ylim=(0, 1.5))
    c.plot(x, tip["nucleation"], "--", color=LIGHT.blue)
    c.plot(x, tip["front"], "-", color=LIGHT.ink)
    c.plot(x, tip["extra"], ":", color=LIGHT.vermilion)
    for level in ("continuum", "frozen"):
        c.plot(x, tip[level], "-", color="0.55", lw=0.8, zorder=1)
    c.text(59, 1.36, "thin: continuum, self-consistent\n(above) and with frozen slider", color="0.45", fontsize=8, ha="right")
    c.axhline(1, color="0.75", lw=0.8, zorder=0)
    c.axvline(26, color="0.75", lw=0.8, zorder=0)
    c.text(27, 0.03, "$\\Lambda=26\\,\\lambda_c$", fontsize=9)
    c.text(28, 1.06, "at the passing front", color=LIGHT.ink)
    b.text(59, 1.42, "$H/\\lambda_c=25$, $k/K=0.03$, $\\nu=0.3$", fontsize=9, ha="right")
    c.text(1.2, 0.62, "at nucleation", color=LIGHT.blue)
    c.text(40, 0.17, "extra $\\Delta\\sigma_c$", color=LIGHT.vermilion)
    c.set(xlabel="$x/\\lambda_c$", ylabel="interface stress ($\\sigma_s$)", xlim=(0, 60), ylim=(0, 1.5))
    return figure


def _draw_fig3(data: dict[str, Table]) -> Any:
    from matplotlib.legend_handler import HandlerTuple

    figure, (a, b) = _axes(2, 5.6)
    for ax, table, group, along, colours in (
        (a, data["fig3a"], "stiffness", "height", STIFFNESSES),
        (b, data["fig3b"], "height", "stiffness", HEIGHTS),
    ):
        for value, colour in colours.items():
            here = np.isclose(table[group], value)
            x = table[along][here]
            sparse = slice(None, None, 5 if ax is a else 4)
            again = table["breaks_again"][here]
            for face, shown in (("white", ~again), (colour, again)):
                contacts = np.where(shown, table["contacts"][here], np.nan)
                ax.plot(x[sparse], contacts[sparse], MARKERS[colour], color=colour, ms=4.5, mfc=face, zorder=5)
            for end, marker in (("free", "x"), ("clamped", "+")):
                ax.plot(x[sparse], table[f"{end}_L{SITES}"][here][sparse], marker, color=colour, ms=5, mew=0.9, zorder=6)
            for level, style, width in (
                ("eq58", "-", 1.4),
                ("eq25", ":", 1.4),
                ("continuum", "-.", 0.8),
                ("frozen", "--", 0.8),
            ):
                ax.plot(x, table[level][here], style, color=colour, lw=width)
            label = f"$k/K={value}$" if ax is a else f"$H/\\lambda_c={value}$"
            ax.annotate(label, (x[-1], table["eq25"][here][-1]), (5, -3), textcoords="offset points", color=colour, fontsize=9)
        ax.set(ylabel="$\\Lambda/\\lambda_c$", ylim=(0, 88))
    a.set(xlabel="$H/\\lambda_c$", xlim=(0, 74))
    b.set(xlabel="$k/K$", xscale="log", xlim=(9e-4, 0.28))
    a.text(73, 2, "$\\nu=0.3$", fontsize=9, ha="right")
    kinds = [
        a.plot([], [], style, color="0.3", ms=5, lw=width)[0]
        for style, width in (("x", 1), ("+", 1), ("-", 1.4), (":", 1.4), ("-.", 0.8), ("--", 0.8))
    ]
    symbols, filled = (
        tuple(a.plot([], [], m, color=colour, mfc=face or colour, ms=4.5)[0] for colour, m in MARKERS.items())
        for face in ("white", None)
    )
    labels = [
        "lattice, semi-infinite",
        f"the same, {AGAIN}",
        "lattice, $L=100\\,\\lambda_c$, free end (none: runs through)",
        "the same, clamped end",
        "Eq. (58), corrected",
        "Eq. (25)",
        "continuum, self-consistent",
        "continuum, frozen slider",
    ]
    together = {tuple: HandlerTuple(ndivide=None)}
    a.legend([symbols, filled, *kinds], labels, frameon=False, fontsize=8, handler_map=together)
    return figure


_FIGURES: dict[str, tuple[dict[str, Any], Any]] = {
    "fig2": ({"fig2_fields": fig2_fields, "fig2_stress": fig2_stress}, _draw_fig2),
    "fig3": ({"fig3a": fig3a, "fig3b": fig3b}, _draw_fig3),
}
