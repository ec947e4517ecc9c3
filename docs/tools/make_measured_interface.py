"""Tabulate and draw what a measured interface says about the law of one contact.

For docs/appendix/measured_interface.md. Run: python docs/tools/make_measured_interface.py (half a minute).
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import matplotlib.pyplot as plt
import numpy as np
from scipy import stats
from scipy.optimize import brentq
from scipy.special import gamma, gammainc

import slippulse_jax as sp
from slippulse_jax.paper.distribution import ThresholdDistribution, force_law
from slippulse_jax.plot.style import SMALL

DOCS = Path(__file__).resolve().parents[1]
KEPT = (0.0, 0.3, 0.6, 0.9, 0.99)
NARROW = (0.05, 0.1, 0.2, 0.4)
BEYOND = 300.0
"""Stretch over threshold up to which breaks are summed."""


class Runs(NamedTuple):
    """The measured runs, and their ratios of forces."""

    load: np.ndarray  # N
    sliding: np.ndarray  # over the peak
    half_slope: np.ndarray  # over the peak


class Law(NamedTuple):
    """Mean stretch of an array's asperities, in u_s, pulled by X."""

    stretch: np.ndarray
    force: np.ndarray
    half_slope: float  # force at which F' = 1/2
    sliding: float  # force far beyond

    @property
    def peak(self) -> float:
        """Largest force."""
        return max(float(self.force.max()), self.sliding)


def read() -> Runs:
    """Read the 19 runs."""
    load, _, peak, sliding, half = np.loadtxt(DOCS / "tables" / "measured_interface.csv", delimiter=",", skiprows=2).T
    return Runs(load, sliding / peak, half / peak)


def renewed(width: float) -> Law:
    """Law of asperities that keep nothing and get a new threshold each time they break: the paper's, by the master equation."""
    law = force_law(ThresholdDistribution("weibull", width), reach=6.0, points=2401)
    x, force = np.asarray(law.stretch), np.asarray(law.force)
    slope = np.diff(force) / np.diff(x)
    after = int(np.argmax(slope < 0.5))  # slopes belong to the middle between grid points
    part = (slope[after - 1] - 0.5) / (slope[after - 1] - slope[after])
    half = np.interp((x[after - 1] + x[after]) / 2 + part * (x[1] - x[0]), x, force)
    return Law(x, force, float(half), gamma(1 + 2 * width) / (2 * gamma(1 + width) ** 2))


def keeping(kept: float, width: float) -> Law:
    """Law of asperities that keep the share r of thresholds that stay the same.

    An asperity of threshold θ breaks at X = θ c_m, c_m = 1 + m (1 − r), and loses (1 − r) θ each time, so that
    F = X − (1 − r) Σ_m ⟨θ; θ < X/c_m⟩ and F' = 1 − (1 − r) Σ_m p(X/c_m) X/c_m².
    """
    scale, released = 1 / gamma(1 + width), 1 - kept
    c = np.arange(1.0, BEYOND, released)

    def force(x: float) -> float:
        return x - released * gammainc(1 + width, (x / c / scale) ** (1 / width)).sum()

    def over_half(x: float) -> float:
        return 0.5 - released * (stats.weibull_min.pdf(x / c, 1 / width, scale=scale) * x / c**2).sum()

    stretch = np.linspace(0, 4, 201)
    half = brentq(over_half, 0.2, 1.3)
    return Law(stretch, np.array([force(x) for x in stretch]), force(half), (1 + kept) / 2)


def width_of(law: Any, half_slope: float) -> float:
    """Width with which a law has its half slope at this share of its peak."""

    def missing(width: float) -> float:
        found = law(width)
        return found.half_slope / found.peak - half_slope

    return float(brentq(missing, 0.3, 0.95, xtol=1e-5))


def relative_spread(width: float) -> float:
    """Standard deviation of thresholds over their mean."""
    return float(np.sqrt(gamma(1 + 2 * width) / gamma(1 + width) ** 2 - 1))


def laws_table(half_slope: float) -> str:
    """Arrays with the measured half slope: their widths, and what they make of the other ratio."""
    lines = ["| asperities keep | thresholds | width | sliding/peak |", "|---|---|---|---|"]
    width = width_of(renewed, half_slope)
    law = renewed(width)
    lines.append(f"| 0 | new at each break | {width:.2f} | {law.sliding / law.peak:.3f} |")
    for kept in KEPT:
        width = width_of(lambda w, kept=kept: keeping(kept, w), half_slope)
        law = keeping(kept, width)
        lines.append(f"| {kept:g} | unchanged | {width:.2f} | {law.sliding / law.peak:.3f} |")
    return "\n".join(lines) + "\n"


def kept_by_array(width: float) -> float:
    """Share of its first peak that an array of the paper's asperities has at its lowest afterwards."""
    force = renewed(width).force
    first = int(np.argmax(force))
    return float(force[first:].min() / force[first])


def draw(runs: Runs) -> Any:
    """The runs, and two laws with the same half slope."""
    half = float(np.median(runs.half_slope))
    width, other = width_of(renewed, half), width_of(lambda w: keeping(0.99, w), half)
    paper = renewed(width)
    with sp.plot.style.use(figure__figsize=(sp.plot.style.PAGE, 2.6)):
        figure, (left, right) = plt.subplots(1, 2, width_ratios=(1, 1.35))
    c = sp.plot.style.colours(left)
    ratios = (("sliding", runs.sliding, c.blue, "o"), ("where the slope has halved", runs.half_slope, c.vermilion, "s"))
    for name, value, colour, marker in ratios:
        middle = float(np.median(value))
        left.axhline(middle, color=colour, linewidth=0.7, linestyle=":")
        left.annotate(
            f"median {middle:.3f}", (1, middle), (0, 2), textcoords="offset points", ha="right", va="bottom", fontsize=SMALL
        )
        left.plot(
            runs.load, value, marker, color=colour, markeredgecolor=c.paper, markeredgewidth=0.4, markersize=4.5, label=name
        )
    left.set(xlabel="normal load (N)", ylabel="force over its peak", xlim=(0, 1), ylim=(0.5, 1.04))
    for law, look in (
        (paper, {"color": c.blue, "linewidth": 3, "label": f"keep 0, width {width:.2f}"}),
        (keeping(0.99, other), {"color": c.orange, "linestyle": (0, (3, 1.5)), "label": f"keep 0.99, width {other:.2f}"}),
        (renewed(0.05), {"color": c.grey, "linewidth": 0.8, "zorder": 1}),
    ):
        right.plot(law.stretch / law.peak, law.force / law.peak, **look)
    right.text(1.46, 0.14, "keep 0, width 0.05", color=c.grey, fontsize=SMALL)
    there = float(np.interp(half, paper.force / paper.peak, paper.stretch / paper.peak))
    right.plot(there, half, "s", color=c.vermilion, markeredgecolor=c.paper, markeredgewidth=0.4, markersize=5.5, zorder=3)
    right.set(xlabel="displacement (peak force over stiffness)", xlim=(0, 3), ylim=(0, 1.06))
    for ax in (left, right):
        sp.plot.style.legend_above(ax)
    sp.plot.style.letter_panels(left, right)
    return figure


def main() -> None:
    """Write the table and the picture; print the numbers of the text."""
    jax.config.update("jax_enable_x64", True)
    runs = read()
    half, sliding = np.median(runs.half_slope), np.median(runs.sliding)
    (DOCS / "tables" / "measured_interface.md").write_text(laws_table(float(half)), encoding="utf-8")
    sp.plot.save(draw(runs), DOCS / "pictures" / "measured_interface.png", dpi=120)
    for name, value in (("sliding/peak", runs.sliding), ("half slope/peak", runs.half_slope)):
        with_load = stats.spearmanr(runs.load, value).statistic
        print(
            f"{name}: {value.min():.3f} to {value.max():.3f}, median {np.median(value):.3f}, rank correlation {with_load:.2f}"
        )
    print(f"rank correlation of both: {stats.spearmanr(runs.sliding, runs.half_slope).statistic:.2f}")
    fitted = width_of(renewed, float(half))
    other = brentq(lambda w: renewed(w).sliding / renewed(w).peak - sliding, 0.3, 0.7, xtol=1e-5)
    print(f"width by half slope {fitted:.3f} (σ/mean {relative_spread(fitted):.3f}), by sliding/peak {other:.3f}")
    print("single runs:", *(f"{width_of(renewed, x):.2f}" for x in (runs.half_slope.max(), runs.half_slope.min())))
    print("kept by arrays:", *(f"{w:g}: {kept_by_array(w):.2f}" for w in (*NARROW, fitted)))
    paper, keep = renewed(fitted), keeping(0.99, width_of(lambda w: keeping(0.99, w), float(half)))
    at = np.linspace(0, 4, 401)
    curves = [np.interp(at, law.stretch / law.peak, law.force / law.peak) for law in (paper, keep)]
    print(f"curves differ by at most {abs(curves[0] - curves[1]).max():.3f} of the peak")


if __name__ == "__main__":
    main()
