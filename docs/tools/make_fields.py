"""Draw the picture of docs/fit/profile.md: a threshold and a prestress profile, recovered from synthetic lengths."""

from pathlib import Path

import jax
import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

import slippulse_jax as sp

SITES, STIFFNESS, SIGMA = 192, 0.03, 0.2
HEIGHTS = np.linspace(6, 40, 12)
X = np.arange(SITES)


def measured(seed, threshold=1.0, prestress=0.0):
    """Lengths with errors, from profiles of shape (SITES,)."""
    profile = sp.Profile(np.broadcast_to(threshold, SITES), prestress)
    length = [float(sp.sensitivity(sp.Slider(h, STIFFNESS, 0.3), profile, sites=SITES).length) for h in HEIGHTS]
    noise = SIGMA * np.random.default_rng(seed).normal(size=len(HEIGHTS))
    return sp.Measurements(height=HEIGHTS, poisson=0.3, length=np.array(length) + noise, length_sigma=SIGMA)


def main():
    """Two rows: threshold, prestress; each with its resolution."""
    threshold = np.exp(0.06 * np.sin(X / 9))
    prestress = 0.15 + 0.05 * np.cos(X / 12)
    found = [
        sp.recover_profile(measured(0, threshold=threshold), stiffness=STIFFNESS),
        sp.recover_profile(measured(0, prestress=prestress), stiffness=STIFFNESS, kind="prestress"),
    ]
    with sp.plot.style.use(figure__figsize=(sp.plot.style.PAGE, 5)):
        figure, rows = plt.subplots(2, 2)
        for row, result, truth in zip(rows, found, (threshold, prestress), strict=True):
            sp.plot.recovered_profile(result, ax=row[0])
            row[0].plot(X, truth, "--", color="k", lw=1, label="true")
            sp.plot.style.legend_above(row[0])
            sp.plot.resolution(result, ax=row[1])
        figure.savefig(Path(__file__).resolve().parents[1] / "pictures" / "fields.png", dpi=150)
    for result in found:
        print(result.report())


if __name__ == "__main__":
    with jax.enable_x64(True):
        main()
