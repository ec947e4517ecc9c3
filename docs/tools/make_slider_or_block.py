"""Draw slider and block, and draw and tabulate what the slider makes of the lengths of blocks.

Run: python docs/tools/make_slider_or_block.py (a minute).
"""

import io
from pathlib import Path

import jax
import numpy as np
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

import slippulse_jax as sp
from slippulse_jax.base.files import write_atomically
from slippulse_jax.inference.model.family import Families
from slippulse_jax.inference.model.inputs import Inputs

DOCS = Path(__file__).resolve().parents[1]
POISSON = 0.3
B = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
PUSHES = {
    "above 0.1 H": (0.1, np.inf, "displacement"),
    "above 0.25 H": (0.25, np.inf, "displacement"),
    "above 0.5 H": (0.5, np.inf, "displacement"),
    "above 0.75 H": (0.75, np.inf, "displacement"),
    "0.1 H around 0.1 H": (0.1, 0.1, "displacement"),
    "0.1 H around 0.25 H": (0.25, 0.1, "displacement"),
    "0.1 H around 0.5 H": (0.5, 0.1, "displacement"),
    "0.1 H around 0.25 H, constant force": (0.25, 0.1, "force"),
}


def shares(height: float, b: np.ndarray, push: np.ndarray, width: float = np.inf, control: str = "displacement") -> np.ndarray:
    """ℓ/H of blocks of these b, pushed at these heights over H."""
    inputs = Inputs.of(np.full(b.shape, height), b / (2 * (1 + POISSON) * height), POISSON)
    of_width, force = np.full(b.shape, np.log(width)), np.full(b.shape, float(control == "force"))
    return Families()(inputs.given(log_push=np.log(push), log_push_width=of_width, push_force=force))[0] / height


def bias(height: float, b: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ℓ of the block over that of the slider; and k of the softest slider with that length over the true k, nan if none has."""
    grid = np.geomspace(1e-3, 200, 4001)
    curve = sp.exact_lengths(sp.Slider(height, grid / (2 * (1 + POISSON) * height), POISSON)) / height
    rising = slice(0, int(np.argmax(curve)) + 1)
    fitted = np.exp(np.interp(share, curve[rising], np.log(grid[rising]), right=np.nan))
    return share / np.interp(b, grid, curve), fitted / b


def table() -> str:
    """Both ratios, at H/λc = 100 and 1000."""
    lines = []
    for height in (100.0, 1000.0):
        lines += [f"| H/λc = {height:g} | " + " | ".join(f"b = {b:g}" for b in B) + " |", "|---" * (len(B) + 1) + "|"]
        for name, (at, width, control) in PUSHES.items():
            share = shares(height, B, np.full(B.shape, at), width, control)
            cells = [
                "no precursor" if not x else f"{length:.2f} (none)" if np.isnan(k) else f"{length:.2f} ({k:.2g})"
                for x, length, k in zip(share, *bias(height, B, share), strict=True)
            ]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def fits() -> str:
    """Fits of the slider to the lengths of four blocks pushed alike, each length with an error of 2 % and without scatter."""
    heights, b = np.array([300.0, 450.0, 700.0, 1000.0]), np.array([0.1, 1.0, 3.0])
    lines = ["| pushed | " + " | ".join(f"b = {x:g} at H/λc = 550" for x in b) + " |", "|---" * (len(b) + 1) + "|"]
    for name in ("above 0.1 H", "above 0.25 H", "above 0.5 H", "0.1 H around 0.1 H"):
        at, width, control = PUSHES[name]
        cells = []
        for x in b:
            k = x / (2 * (1 + POISSON) * 550)
            each = [shares(H, np.array([x * H / 550]), np.array([at]), width, control)[0] * H for H in heights]
            length = np.array(each)
            found = sp.fit(sp.Measurements(height=heights, poisson=POISSON, length=length, length_sigma=0.02 * length))
            cells.append(f"{found.values['stiffness'] / k:.2g}, χ² {found.deviance:.2g}: {found.identifiability.value}")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def lucky(height: float, b: float) -> float:
    """Height over H above which a push gives the slider's length."""
    at = np.linspace(0.05, 0.6, 221)
    ratio = bias(height, np.full(at.shape, b), shares(height, np.full(at.shape, b), at))[0]
    return float(np.interp(1.0, ratio, at))


def draw() -> Figure:
    """Both ratios over b and the height above which the side is pushed, at H/λc = 1000."""
    b, at = np.geomspace(0.02, 30, 90), np.linspace(0.05, 0.9, 69)
    every_b, every_at = (x.ravel() for x in np.meshgrid(b, at))
    length, stiffness = (x.reshape(len(at), len(b)) for x in bias(1000.0, every_b, shares(1000.0, every_b, every_at)))
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    drawn = (
        (axes[0], np.log2(length), 2.0, "Length of the block over that of the slider", [0.25, 0.5, 1, 1.5, 2, 3]),
        (
            axes[1],
            np.log10(stiffness),
            1.5,
            "Stiffness that the slider finds, over the true one",
            [0.03, 0.1, 0.3, 1, 3, 10, 30],
        ),
    )
    for ax, value, reach, title, levels in drawn:
        scale = 2.0 if ax is axes[0] else 10.0
        ax.set_facecolor("0.85")
        ax.pcolormesh(b, at, value, norm=TwoSlopeNorm(0, -reach, reach), cmap="PuOr_r", rasterized=True)
        lines = ax.contour(b, at, scale**value, levels=levels, colors="0.2", linewidths=[0.6 + (x == 1) for x in levels])
        ax.clabel(lines, fmt="%g", fontsize=8)
        ax.set(xscale="log", xlabel="$b = (k/\\lambda_c^2) H/G$")
        ax.set_title(title, loc="left", fontsize=10)
    axes[1].text(0.5, 0.7, "no slider has so long a precursor", transform=axes[1].transAxes, ha="center", fontsize=9)
    axes[0].set_ylabel("pushed above, $h/H$")
    return figure


def bodies() -> Figure:
    """Schematics of both."""
    with sp.plot.style.use():
        figure = Figure(figsize=(9, 2.9), layout="constrained")
        slider, block = figure.subplots(1, 2)
        sp.plot.schematic(sp.Slider(100.0, 3e-3, POISSON), ax=slider)
        sp.plot.schematic(sp.Block(100.0, 3e-3, POISSON, sp.Push(0.4, 0.3)), ax=block)
    return figure


def front() -> Figure:
    """Stress in a block at nucleation, half way, and when its front has stopped."""
    with jax.enable_x64(True), sp.plot.style.use():
        found = sp.first_precursor(sp.Block(100.0, 3e-3, POISSON, sp.Push(0.3)))
        figure = Figure(figsize=(9, 2.6), layout="constrained")
        for ax, breaks in zip(figure.subplots(1, 3, sharey=True), (0, int(found.breaks) // 2, None), strict=True):
            sp.plot.block_stress(found, breaks, colorbar=breaks is None, ax=ax)
    return figure


def main() -> None:
    """Write the pictures and the tables."""
    for name, figure in (("bodies", bodies()), ("slider_or_block", draw()), ("block_stress", front())):
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=110)
        write_atomically(DOCS / "pictures" / f"{name}.png", content.getvalue())
    with jax.enable_x64(True):
        sp.plot.animate(sp.first_precursor(sp.Block(24.0, 1 / 75, POISSON, sp.Push(0.4))), DOCS / "pictures" / "block.gif")
    for name, text in (("slider_or_block", table()), ("slider_or_block_fits", fits())):
        (DOCS / "tables" / f"{name}.md").write_text(text, encoding="utf-8")
    for height in (100.0, 1000.0, 1e4):
        print(f"H/λc = {height:g}: the slider's length above", ", ".join(f"{lucky(height, b):.3f} H (b = {b:g})" for b in B))


if __name__ == "__main__":
    main()
