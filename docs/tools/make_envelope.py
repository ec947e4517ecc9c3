"""Draw the error map of the envelope formula beside Eq. (25)'s. Run: python docs/tools/make_envelope.py."""

import io
from pathlib import Path

import jax
import numpy as np
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure

import slippulse_jax as sp
from slippulse_jax import theory
from slippulse_jax.base.files import write_atomically
from slippulse_jax.plot.labels import AGAIN
from slippulse_jax.plot.style import LIGHT

PICTURES = Path(__file__).resolve().parents[1] / "pictures"
LEVELS = [0, 0.25, 0.5, 0.75, 1, 2, 5, 10, 60]


def main() -> None:
    """Worst error over ν = 0, 0.25, 0.5, in units of max(0.5 λc, 2 %), for each H/λc and k/K."""
    height, stiffness = np.geomspace(5, 1e5, 100), np.geomspace(1e-6, 1, 100)
    q, nu, H = (x.ravel() for x in np.meshgrid(stiffness, [0.0, 0.25, 0.5], height, indexing="ij"))
    with jax.enable_x64(True):
        slider = sp.Slider(H, q, nu)
        exact = np.asarray(sp.exact_length(slider))
        found = [np.asarray(f(slider)) for f in (theory.envelope_length, theory.length_eq25)]
    onset = sp.rebreaking_onset(height, 0.3) / (2.6 * height)
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for ax, title, length in zip(axes, ("The envelope formula", "Eq. (25)"), found, strict=True):
        error = np.abs(length - exact) / np.maximum(0.5, 0.02 * exact)
        worst = error.reshape(100, 3, 100).max(axis=1)
        shown = ax.pcolormesh(height, stiffness, worst, norm=BoundaryNorm(LEVELS, 256), cmap="cividis", rasterized=True)
        ax.contour(height, stiffness, worst, levels=[1], colors="white", linewidths=1)
        ax.plot(height, onset, "--", color=LIGHT.vermilion, linewidth=1.2)
        ax.set(xscale="log", yscale="log", xlabel="$H/\\lambda_c$")
        ax.set_title(f"{title}: at most {worst.max():.2g}", loc="left", fontsize=10)
        print(f"{title}: worst {worst.max():.3g}, within 1 on {np.mean(worst <= 1):.1%}")
    label = f"above: {AGAIN} (ν = 0.3)"
    figure.legend(axes[0].lines, [label], loc="outside lower center", frameon=False, fontsize=9)
    axes[0].set(ylabel="$k/K$", ylim=(1e-6, 1))
    figure.colorbar(shown, ax=axes, ticks=LEVELS, label="error / max(0.5 $\\lambda_c$, 2 %), worst over $\\nu$")
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=110)
    write_atomically(PICTURES / "envelope.png", content.getvalue())


if __name__ == "__main__":
    main()
