"""Pictures of a fit: data with the fitted curve, what each length says of the stiffness, residuals, profiles, corner."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from scipy.special import ndtri

from slippulse_jax.inference.attainable import attainable_of
from slippulse_jax.inference.forward import lengths
from slippulse_jax.inference.parameters import Free
from slippulse_jax.inference.profile import profile_2d
from slippulse_jax.inference.result import FitResult
from slippulse_jax.plot.style import LIGHT

BLUE, VERMILION, GREY = LIGHT.blue, LIGHT.vermilion, LIGHT.grey
FAMILY = LIGHT.data
BAND_LEVEL = 0.95
MOST_CURVES = 6
LABELS = {
    "stiffness": "stiffness $k/K$",
    "areal_stiffness": r"areal stiffness $k/\lambda_c^2$ (Pa/m)",
    "areal_stiffness_over_young": r"areal stiffness over $E$ (1/m)",
    "height": "height $H$",
    "correlation_length": r"correlation length $\lambda_c$ (m)",
    "young": "Young's modulus $E$ (Pa)",
    "poisson": r"Poisson's ratio $\nu$",
    "prestress": r"prestress $\sigma_0/\sigma_s$",
    "threshold_slope": r"threshold slope $\varepsilon$ ($1/\lambda_c$)",
    "strength": r"strength $\sigma_s$ (Pa)",
    "width": r"width of the break rule $w$ ($\sigma_s$)",
}


def draw_fit(result: FitResult) -> Figure:
    """Figure of two panels: length against height; and what each length says of the stiffness, or the first profile."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    against_height, other = figure.subplots(1, 2)
    draw_lengths(result, against_height)
    if len(result.parameters.free) == 1 and "stiffness" in result.names[0]:
        draw_information(result, other)
    else:
        draw_profile(result, result.names[0], other)
    return figure


def draw_lengths(result: FitResult, ax: Axes) -> None:
    """Measured lengths against height with the fitted curve, its 95 % band, and the lengths beyond every stiffness."""
    m = result.measurements
    scale, unit = _display_unit(result)
    groups = _groups(result)
    top = 0.0
    for number, rows in enumerate(groups):
        color, first = FAMILY[number % len(FAMILY)] if len(groups) > 1 else BLUE, number == 0
        one = rows[0]
        height = np.linspace(m.height[rows].min() * 0.85, m.height[rows].max() * 1.15, 41)
        x, y = height * scale[one], scale[one]
        label = _group_name(result, one) if len(groups) > 1 else "best fit"
        ax.plot(x, _lengths_at(result, result.theta, one, height) * y, color=color, label=label)
        for i, (low, high) in enumerate(_bands(result, one, height)):
            thin = " (thinner than the line)" if np.max(high - low) * y < 0.012 * float(m.length.max() * y) else ""
            label = f"{BAND_LEVEL:.0%} band{thin}" if first and i == 0 else None
            ax.fill_between(x, low * y, high * y, color=color, alpha=0.25, lw=0, label=label)
        longest = _longest(result, height, one) * y
        ax.plot(x, longest, color=GREY, ls="--", lw=1)
        beyond = "beyond any stiffness" if first else None
        ax.fill_between(x, longest, 10 * longest.max(), color=GREY, alpha=0.15, lw=0, label=beyond)
        top = max(top, 1.12 * float(longest.max()), 1.05 * float((m.length[rows] * scale[rows]).max()))
    _draw_data(result, ax, scale)
    ax.set_xlabel(f"height $H$ ({unit})" if m.in_si else r"height $H/\lambda_c$")
    ax.set_ylabel(f"precursor length ({unit})" if m.in_si else r"precursor length $\ell/\lambda_c$")
    ax.margins(x=0, y=0)
    ax.set_ylim(0, top)
    ax.legend(frameon=False, loc="upper left" if len(set(m.height)) > 1 else "lower right")
    ax.set_title("Lengths and fit", loc="left", fontsize="medium")


def _draw_data(result: FitResult, ax: Axes, scale: np.ndarray) -> None:
    m, kind = result.measurements, np.array(result.measurements.kind)
    x, y = m.height * scale, m.length * scale
    sigma = np.where(np.isnan(m.sigma), np.sqrt(result.variance_factor), m.sigma * np.sqrt(result.variance_factor)) * scale
    style = {"color": VERMILION, "capsize": 2, "zorder": 3, "linestyle": "none"}
    plain = kind == "length"
    if plain.any():
        ax.errorbar(x[plain], y[plain], sigma[plain], fmt="o", ms=4, label="measured ± σ", **style)
    whole = kind == "whole"
    if whole.any():
        half = scale[whole] / 2
        ax.errorbar(x[whole], y[whole] - half, half + sigma[whole], fmt="none", elinewidth=3, label="whole contacts", **style)
    beyond = kind == "at_least"
    if beyond.any():
        ax.plot(x[beyond], y[beyond], "^", color=VERMILION, ms=7, label="ran past, no arrest")


def _bands(result: FitResult, one: int, height: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Lengths that the allowed values give: exact for one parameter, by error propagation for several."""
    if result.problem.p == 1:
        for piece in result.theta_intervals[result.names[0]][BAND_LEVEL]:
            family = _lengths_over(result, np.linspace(piece.low, piece.high, 25)[:, None], one, height)
            yield family.min(axis=0), family.max(axis=0)
        return
    if result.covariance is None:
        return
    middle = _lengths_at(result, result.theta, one, height)
    step = 1e-3 * np.sqrt(np.diag(result.covariance))
    up, down = (_lengths_over(result, result.theta + side * np.diag(step), one, height) for side in (1, -1))
    slope = (up - down) / (2 * step[:, None])
    half = float(ndtri((1 + BAND_LEVEL) / 2)) * np.sqrt(np.einsum("pn,pq,qn->n", slope, result.covariance, slope))
    yield np.maximum(middle - half, 0), middle + half


def draw_information(result: FitResult, ax: Axes) -> None:
    """ℓ/H against stiffness for up to six heights, with what was measured at each, and the allowed stiffnesses shaded."""
    m, q = result.measurements, result.parameters
    scale, unit = _display_unit(result)
    theta = np.linspace(q.low[0], q.high[0], 301)
    stiffness = np.exp(theta)
    _, first_of_height = np.unique(m.height, return_index=True)
    shown = first_of_height[np.unique(np.linspace(0, len(first_of_height) - 1, MOST_CURVES).round().astype(int))]
    largest = 0.0
    visible = []
    for color, i in zip(FAMILY, shown, strict=False):
        tall = m.height[i]
        together = np.nonzero(m.height == tall)[0]
        name = f"$H$ = {tall * scale[i]:.4g} {unit}" if m.in_si else rf"$H/\lambda_c$ = {tall:.4g}"
        name += f" ({len(together)} measured)" if len(together) > 1 else ""
        share = _lengths_over(result, theta[:, None], i, np.array([tall]))[:, 0] / tall
        ax.plot(stiffness, share, color=color, label=name)
        ax.axhspan(*_measured_share(result, together), color=color, alpha=0.2, lw=0)
        largest = max(largest, float(share.max()))
        visible.append(share)
    for n, piece in enumerate(result.level_intervals[BAND_LEVEL]):
        label = f"{BAND_LEVEL:.0%} interval" if n == 0 else None
        ax.axvspan(piece.low, piece.high, facecolor=GREY, edgecolor=LIGHT.ink, alpha=0.35, lw=0.8, label=label)
    ax.axvline(result.value, color=LIGHT.ink, lw=1, ls=":", label="best fit")
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(LogLocator(numticks=8))
    if largest > 0:
        # from where a precursor is worth a hundredth of the longest
        ax.set_xlim(stiffness[np.max(visible, axis=0) > 0.01 * largest][0], stiffness[-1])
        ax.set_ylim(0, 1.1 * largest)
    ax.set_xlabel(LABELS[q.free[0].name])
    ax.set_ylabel(r"length over height $\ell/H$")
    # below the curves, to the right of where they rise
    columns = 1 if len(shown) < 4 else 2
    title = "bands: measured ± σ"
    box = ax.legend(fontsize="x-small", loc="lower right", ncols=columns, title=title, title_fontsize="x-small", framealpha=0.9)
    box.get_frame().set_linewidth(0)
    ax.set_title("What each length says of the stiffness", loc="left", fontsize="medium")


def _measured_share(result: FitResult, rows: np.ndarray) -> tuple[float, float]:
    """ℓ/H measured at one height, all its measurements together, less and plus a standard error."""
    m = result.measurements
    sigma = np.where(m.sigma[rows] > 0, m.sigma[rows], 0.5) * np.sqrt(result.variance_factor)
    weight = 1 / sigma**2
    middle = np.where(np.array(m.kind)[rows] == "whole", m.length[rows] - 0.5, m.length[rows])
    mean, error = (weight * middle).sum() / weight.sum(), weight.sum() ** -0.5
    return float((mean - error) / m.height[rows[0]]), float((mean + error) / m.height[rows[0]])


def draw_residuals(result: FitResult, ax: Axes) -> None:
    """(fitted − measured)/σ against the fitted length."""
    m = result.measurements
    scale, unit = _display_unit(result)
    ax.axhspan(-1, 1, color=BLUE, alpha=0.12, lw=0, label="± σ")
    ax.axhline(0, color=GREY, lw=0.8)
    ax.plot(result.fitted.length * scale, result.residuals, "o", color=VERMILION, ms=4)
    ax.set_xlabel(f"fitted length ({unit})" if m.in_si else r"fitted length $\ell/\lambda_c$")
    ax.set_ylabel("(fitted − measured)/σ")
    reach = max(2.5, 1.15 * float(np.abs(result.residuals).max()))
    ax.set_ylim(-reach, reach)
    ax.legend(frameon=False, loc="upper right")


def draw_profile(result: FitResult, name: str, ax: Axes) -> None:
    """Rise of the deviance along one parameter, all others fitted anew, with the intervals it gives."""
    curve = result.curves[name]
    one = result.parameters.free[result.parameters.index(name)]
    limit = 2.2 * result.rise(BAND_LEVEL)
    rise = curve.deviance - result.deviance
    ax.plot(one.value(curve.node), rise, color=BLUE, marker=".", ms=3, label="profile")
    covariance = result.covariance
    if covariance is not None:
        j = result.parameters.index(name)
        error = np.sqrt(covariance[j, j])
        theta = np.linspace(result.theta[j] - 3 * error, result.theta[j] + 3 * error, 101)
        parabola = result.rise(0.6827) * ((theta - result.theta[j]) / error) ** 2
        ax.plot(one.value(theta), parabola, color=GREY, ls="--", lw=1, label="from the covariance")
    for level, dash in ((0.6827, ":"), (BAND_LEVEL, "-.")):
        ax.axhline(result.rise(level), color=LIGHT.ink, lw=0.8, ls=dash, label=f"{level:.0%}")
    below = curve.node[rise < limit]
    if len(below) > 1:
        pad = 0.1 * (below[-1] - below[0])
        ax.set_xlim(float(one.value(max(one.low, below[0] - pad))), float(one.value(min(one.high, below[-1] + pad))))
        if one.log and below[-1] - below[0] > 1:
            ax.set_xscale("log")
    ax.set_ylim(0, limit)
    _name(one, ax.xaxis)
    ax.set_ylabel("rise of the deviance")
    ax.legend(frameon=False, fontsize="small")


def draw_profiles(result: FitResult) -> Figure:
    """One panel for each parameter asked for, and one of residuals."""
    count = len(result.names) + 1
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = Figure(figsize=(3.6 * columns, 3.2 * rows), layout="constrained")
    axes = np.ravel(figure.subplots(rows, columns, squeeze=False))
    for name, ax in zip(result.names, axes, strict=False):
        draw_profile(result, name, ax)
    draw_residuals(result, axes[count - 1])
    for ax in axes[count:]:
        ax.set_visible(False)
    return figure


def draw_corner(result: FitResult, samples: np.ndarray | None = None, *, nodes: int = 31) -> Figure:
    """Every pair of the parameters asked for: regions allowed at 68 and 95 % by the profile, and samples if given.

    Parameters
    ----------
    samples : array, shape (n, p), optional
        θ of a bootstrap or a posterior.
    """
    names = result.names
    figure = Figure(figsize=(2.9 * len(names), 2.7 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), len(names), squeeze=False)
    for row, vertical in enumerate(names):
        for column, horizontal in enumerate(names):
            ax = axes[row, column]
            if column > row:
                ax.set_visible(False)
            elif column == row:
                draw_profile(result, vertical, ax)
            else:
                draw_pair(result, horizontal, vertical, ax, samples, nodes=nodes)
    return figure


def draw_pair(
    result: FitResult, horizontal: str, vertical: str, ax: Axes, samples: np.ndarray | None = None, *, nodes: int = 31
) -> None:
    """Region of two parameters that the data allow at 68 and 95 %."""
    q = result.parameters
    i, j = q.index(horizontal), q.index(vertical)
    grids = [_window(result, k, nodes) for k in (i, j)]
    starts = np.array([root.theta for root in result.found] or [result.theta])[:4]
    surface = profile_2d(result.problem, i, j, grids[0], grids[1], starts)
    rise = surface.deviance - result.deviance
    first, second = q.free[i].value(grids[0]), q.free[j].value(grids[1])
    levels = [0, result.rise(0.6827, 2), result.rise(0.95, 2)]
    ax.contourf(first, second, rise.T, levels=levels, colors=[BLUE, LIGHT.sky], alpha=0.5)
    if samples is not None:
        ax.plot(q.free[i].value(samples[:, i]), q.free[j].value(samples[:, j]), ".", color=LIGHT.ink, ms=1, alpha=0.4)
    ax.plot(q.free[i].value(result.theta[i]), q.free[j].value(result.theta[j]), "+", color=VERMILION, ms=8)
    _name(q.free[i], ax.xaxis)
    _name(q.free[j], ax.yaxis)


def _window(result: FitResult, k: int, nodes: int) -> np.ndarray:
    """Values of θ_k around what its profile allows at 95 %."""
    one = result.parameters.free[k]
    pieces = result.theta_intervals[one.label][BAND_LEVEL]
    low, high = (pieces[0].low, pieces[-1].high) if pieces else (one.low, one.high)
    pad = 0.35 * (high - low)
    return np.linspace(max(one.low, low - pad), min(one.high, high + pad), nodes)


def _name(one: Free, axis: Axis) -> None:
    """Label a finished axis; a power of ten goes into the unit, where Matplotlib would print it over a neighbour's label."""
    text = LABELS.get(one.name, one.symbol)
    power = int(np.floor(np.log10(max(np.abs(axis.get_view_interval()).max(), 1e-300))))
    if axis.get_scale() == "linear" and not -2 <= power < 4:
        axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.10g}")
        head, bracket, unit = text.removesuffix(")").rpartition("(") if text.endswith(")") else (text + " ", "(", "")
        text = f"{head}{bracket}$10^{{{power}}}$ {unit}".rstrip() + ")"
    text += f" {one.label[one.label.index('[') :]}" if "[" in one.label else ""
    axis.set_label_text(text)


def _display_unit(result: FitResult) -> tuple[np.ndarray, str]:
    m = result.measurements
    if m.correlation_length is None:
        return np.ones(len(m)), "λc"
    return m.correlation_length * 1e3, "mm"


def _inputs_at(result: FitResult, theta: np.ndarray, row: int, height: np.ndarray) -> np.ndarray:
    """Inputs of the model for a measurement like that of `row`, at other heights."""
    y = np.repeat(result.parameters.inputs(theta)[row][None], len(height), axis=0)
    y[:, 0] += np.log(height / result.measurements.height[row])
    return y


def _lengths_at(result: FitResult, theta: np.ndarray, row: int, height: np.ndarray) -> np.ndarray:
    """Predicted lengths in stated λc."""
    return _lengths_over(result, theta[None], row, height)[0]


def _lengths_over(result: FitResult, theta: np.ndarray, row: int, height: np.ndarray) -> np.ndarray:
    """The same at many θ, (t, p), in one batch; shape (t, heights)."""
    q = result.parameters
    y = np.concatenate([_inputs_at(result, one, row, height) for one in theta])
    scale = np.exp(q.scale_base["length"][row] + theta @ q.scale_slope["length"][row])
    return lengths(y, 0).value.reshape(len(theta), -1) * scale[:, None] + (theta @ q.offset[row])[:, None]


def _groups(result: FitResult) -> list[np.ndarray]:
    """Measurements that lie on one curve of length against height: same everything else."""
    m, q = result.measurements, result.parameters
    y = q.inputs(result.theta)
    correlation_length = np.ones(len(m)) if m.correlation_length is None else m.correlation_length
    keys = np.column_stack([np.round(y[:, 1:], 9), correlation_length])
    _, group = np.unique(keys, axis=0, return_inverse=True)
    return [np.nonzero(group.ravel() == g)[0] for g in range(group.max() + 1)]


def _group_name(result: FitResult, row: int) -> str:
    y = result.parameters.inputs(result.theta)[row]
    condition = rf", $\varphi$ = {y[3]:.3g}" if y[3] else ""
    return f"best fit, $k/K$ = {np.exp(y[1]):.3g}, ν = {y[2]:.3g}{condition}"


def _longest(result: FitResult, height: np.ndarray, row: int) -> np.ndarray:
    """Longest length at any stiffness searched, at each height, in stated λc."""
    q = result.parameters
    y = _inputs_at(result, result.theta, row, height)
    scale = np.exp(q.scale_base["length"][row] + q.scale_slope["length"][row] @ result.theta)
    return attainable_of(q, result.theta, np.full(len(height), row), y)[0] * scale
