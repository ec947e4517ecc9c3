"""The picture of a fit: data with the fitted curve, what no stiffness can reach, and what each length says of the stiffness."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from slippulse_jax.inference.result import FitResult
from slippulse_jax.lattice.bulk import precursor_lengths
from slippulse_jax.slider import Slider
from slippulse_jax.style import LIGHT

BLUE, VERMILION, GREY = LIGHT.blue, LIGHT.vermilion, LIGHT.grey
FAMILY = LIGHT.data
STIFFNESS_LABELS = {
    "stiffness": "stiffness $k/K$",
    "areal_stiffness": r"areal stiffness $k/\lambda_c^2$ (Pa/m)",
    "areal_stiffness_over_young": r"areal stiffness over Young's modulus $(k/\lambda_c^2)/E$ (1/m)",
}
BAND_LEVEL = 0.95
MOST_CURVES = 6


def draw_fit(result: FitResult) -> Figure:
    """Figure of two panels: length against height, and length over height against stiffness."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    against_height, against_stiffness = figure.subplots(1, 2)
    draw_lengths(result, against_height)
    draw_information(result, against_stiffness)
    return figure


def draw_lengths(result: FitResult, ax: Axes) -> None:
    """Measured lengths against height with the fitted curve, its 95 % band, and the lengths beyond every stiffness."""
    m = result.measurements
    scale, unit = _display_unit(result)
    groups = _groups(result)
    for number, rows in enumerate(groups):
        one = rows[0]
        height = np.linspace(m.height[rows].min() * 0.85, m.height[rows].max() * 1.15, 41)
        x, y = height * scale[one], scale[one]

        def lengths(value: float, height: np.ndarray = height, one: int = one) -> np.ndarray:
            ratio = value * result.parameter.ratio_per_unit[one]
            return precursor_lengths(Slider(height, ratio, m.poisson[one]))

        first = number == 0
        ax.plot(x, lengths(result.value) * y, color=BLUE, label="fit" if first else None)
        for piece in result.level_intervals[BAND_LEVEL]:
            family = np.array([lengths(v) for v in np.geomspace(piece.low, piece.high, 25)]) * y
            label = f"{BAND_LEVEL:.0%} band" if first and piece is result.level_intervals[BAND_LEVEL][0] else None
            ax.fill_between(x, family.min(axis=0), family.max(axis=0), color=BLUE, alpha=0.2, lw=0, label=label)
        longest = _longest(result, height, one) * y
        beyond = "beyond any stiffness" if first else None
        ax.plot(x, longest, color=GREY, ls="--", lw=1)
        ax.fill_between(x, longest, longest.max() * 1.12, color=GREY, alpha=0.15, lw=0, label=beyond)
    x, y, error = m.height * scale, m.length * scale, m.length_sigma * scale
    ax.errorbar(x, y, error, fmt="o", ms=4, color=VERMILION, capsize=2, label="measured ± σ")
    ax.set_xlabel(f"height $H$ ({unit})" if m.in_si else r"height $H/\lambda_c$")
    ax.set_ylabel(f"precursor length ({unit})" if m.in_si else r"precursor length $\ell/\lambda_c$")
    ax.set_ylim(bottom=0)
    ax.margins(x=0, y=0)
    ax.legend(frameon=False, loc="upper left" if len(set(m.height)) > 1 else "lower right")
    ax.set_title("Lengths and fit", loc="left", fontsize="medium")


def draw_information(result: FitResult, ax: Axes) -> None:
    """ℓ/H against stiffness for up to six heights, with each measured value, and the allowed stiffnesses shaded."""
    m, curve = result.measurements, result.curve
    scale, unit = _display_unit(result)
    stiffness = np.exp(curve.theta)
    _, first_of_height = np.unique(m.height, return_index=True)
    shown = first_of_height[np.unique(np.linspace(0, len(first_of_height) - 1, MOST_CURVES).round().astype(int))]
    for color, i in zip(FAMILY, shown, strict=False):
        tall = m.height[i]
        name = f"$H$ = {tall * scale[i]:.4g} {unit}" if m.in_si else rf"$H/\lambda_c$ = {tall:.4g}"
        ax.plot(stiffness, curve.length[:, i] / tall, color=color, label=name)
        low, high = (m.length[i] - m.length_sigma[i]) / tall, (m.length[i] + m.length_sigma[i]) / tall
        ax.axhspan(float(low), float(high), color=color, alpha=0.15, lw=0)
    for n, piece in enumerate(result.level_intervals[BAND_LEVEL]):
        ax.axvspan(piece.low, piece.high, color=GREY, alpha=0.3, lw=0, label=f"{BAND_LEVEL:.0%} interval" if n == 0 else None)
    ax.axvline(result.value, color="k", lw=0.8)
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(LogLocator(numticks=8))
    share = (curve.length / m.height).max(axis=1)
    if share.any():
        # from where a precursor is worth a hundredth of the longest; room above for the legend
        ax.set_xlim(stiffness[share > 0.01 * share.max()][0], stiffness[-1])
        ax.set_ylim(0, 1.25 * share.max())
    ax.set_xlabel(STIFFNESS_LABELS[result.parameter.name])
    ax.set_ylabel(r"length over height $\ell/H$")
    ax.legend(frameon=False, fontsize="small", loc="upper left")
    ax.set_title("What each length says of the stiffness (bands: measured ± σ)", loc="left", fontsize="medium")


def _display_unit(result: FitResult) -> tuple[np.ndarray, str]:
    m = result.measurements
    if m.correlation_length is None:
        return np.ones(len(m)), "λc"
    return m.correlation_length * 1e3, "mm"


def _groups(result: FitResult) -> list[np.ndarray]:
    """Rows that lie on one curve of length against height: same ν, λc and E."""
    m = result.measurements
    correlation_length = np.ones(len(m)) if m.correlation_length is None else m.correlation_length
    keys = np.stack([m.poisson, result.parameter.ratio_per_unit, correlation_length], axis=1)
    _, group = np.unique(keys, axis=0, return_inverse=True)
    return [np.nonzero(group.ravel() == g)[0] for g in range(group.max() + 1)]


def _longest(result: FitResult, height: np.ndarray, row: int) -> np.ndarray:
    """Longest length at any stiffness within the bounds, at each height, in λc."""
    low, high = (bound * result.parameter.ratio_per_unit[row] for bound in result.parameter.bounds)
    ratio = np.geomspace(low, high, 120)[:, None]
    return precursor_lengths(Slider(height, ratio, result.measurements.poisson[row])).max(axis=0)
