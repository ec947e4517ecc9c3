"""What a recovered profile says, in words, as plain values and as pictures."""

from typing import TYPE_CHECKING, Any

import numpy as np

from slippulse_jax.plain import plain
from slippulse_jax.plot.style import DISTANCE, axes, colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slippulse_jax.inference.recover.recovery import RecoveredProfile

SYMBOL = {"threshold": "θ/θ_0", "prestress": "φ"}
LABEL = {"threshold": "threshold, $\\theta/\\theta_0$", "prestress": "prestress, $\\varphi/\\sigma_s$"}


def stretches(found: "RecoveredProfile") -> list[tuple[float, float]]:
    """Ends, in λc, of each stretch of the interface that the lengths determine."""
    inside = np.concatenate([[False], found.determined, [False]])
    edges = np.flatnonzero(inside[1:] != inside[:-1])
    return [(float(found.position[a]), float(found.position[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def report(found: "RecoveredProfile") -> str:
    """Text to read."""
    n = len(found.measurements)
    low, high = found.interval(0.95)
    where = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in stretches(found)) or "nowhere"
    lines = [
        f"{found.kind.capitalize()} profile from {n} length{'s' * (n > 1)}: {found.determination.value}",
        f"  numbers determined by the lengths: {found.degrees:.2f} of {len(found.position)} values described",
        f"  standard error at most half the prior's at x/λc: {where}",
        f"  χ² = {found.chi2:.4g} for {n} lengths; prior misfit {found.prior_misfit:.4g}; {found.steps} steps",
        f"  prior: {_prior(found)}",
    ]
    if found.log_stiffness_shift:
        lines.append(f"  ln k moved by {found.log_stiffness_shift:+.3g}")
    lines += [f"  {'x/λc':>8} {SYMBOL[found.kind]:>9} {'± se':>9} {'95 % interval':>20} {'prior se':>9}  from"]
    for x in _rows(found):
        i = int(np.argmin(abs(found.position - x)))
        origin = "lengths" if found.determined[i] else "definition" if found.prior_stderr[i] < 1e-6 else "prior"
        lines.append(
            f"  {found.position[i]:8.4g} {found.profile[i]:9.4f} {found.stderr[i]:9.4f} {low[i]:10.4f} {high[i]:9.4f} "
            f"{found.prior_stderr[i]:9.4f}  {origin}"
        )
    if found.kind == "threshold":
        lines.append(
            "  A length reads the threshold where its front stopped, and says of the contacts before only that they broke."
        )
    return "\n".join(lines)


def _prior(found: "RecoveredProfile") -> str:
    s = found.smoothness
    given = f"amplitude {s.amplitude:.3g}, length scale {s.length_scale:.3g} λc"
    if len(found.settings) == 1:
        return f"{given}, as given"
    if np.ptp(found.weight) == 0:
        return f"{len(found.settings)} settings alike (too few lengths to choose)"
    return f"{given} of most evidence ({found.weight.max():.0%}), averaged over {len(found.settings)} settings"


def _rows(found: "RecoveredProfile") -> np.ndarray:
    """Some positions, those of the arrests among them where they are few."""
    last = found.measurements.length.max()
    arrests = np.unique(found.measurements.length.round())
    return np.unique(np.concatenate([np.linspace(0, last, 6).round(), arrests if len(arrests) <= 8 else []]))


def to_dict(found: "RecoveredProfile") -> dict[str, Any]:
    """Everything as plain Python values, ready for JSON; numbers that are not finite are None."""
    arrays = ("position", "profile", "stderr", "prior_stderr", "fitted")
    content = {
        "kind": found.kind,
        "determination": found.determination.name.lower(),
        "statement": found.determination.value,
        "degrees": found.degrees,
        "determined": stretches(found),
        "chi2": found.chi2,
        "prior_misfit": found.prior_misfit,
        "smoothness": found.smoothness._asdict(),
        "settings": [{**s._asdict(), "weight": w} for s, w in zip(found.settings, found.weight, strict=True)],
        "log_stiffness_shift": found.log_stiffness_shift,
        "units": {"position": "λc", "profile": "θ_0" if found.kind == "threshold" else "σ_s", "fitted": "λc"},
        **{name: getattr(found, name) for name in arrays},
    }
    return plain(content)


def draw_profile(found: "RecoveredProfile", ax: "Axes | None") -> "Axes":
    """The profile with its bands, what the prior alone allows, and where the fronts stopped."""
    ax = axes(ax)
    c = colours(ax)
    x = found.position
    middle = 1.0 if found.kind == "threshold" else 0.0
    prior = found.prior_stderr / (found.profile if found.kind == "threshold" else 1)
    if found.kind == "threshold":
        ax.fill_between(x, np.exp(-1.96 * prior), np.exp(1.96 * prior), color=c.grey, alpha=0.13, lw=0, label="prior, 95 %")
    for level, alpha in ((0.95, 0.2), (0.6827, 0.35)):
        ax.fill_between(x, *found.interval(level), color=c.blue, alpha=alpha, lw=0, label=f"{level:.0%} band")
    ax.plot(x, found.profile, color=c.blue, label="recovered")
    if found.readings is not None:
        r, sigma = found.readings, found.measurements.length_sigma
        ax.errorbar(
            r.position, r.value, r.stderr, sigma, fmt="o", ms=3, lw=0.8, color=c.vermilion, label="read by one length each"
        )
    else:
        ax.axhline(middle, color=c.grey, lw=0.6)
        at_bottom = {"transform": ax.get_xaxis_transform(), "clip_on": False}
        ax.plot(found.measurements.length, 0 * found.fitted, "|", ms=8, color=c.vermilion, label="arrests", **at_bottom)
    shown = x <= 1.15 * found.measurements.length.max()
    low, high = (end[shown] for end in found.interval(0.95))
    room = 0.25 * (high.max() - low.min())
    ax.set(xlabel=DISTANCE, ylabel=LABEL[found.kind], xlim=(0, x[shown][-1]), ylim=(low.min() - room, high.max() + room))
    ax.legend(fontsize="small", frameon=False)
    return ax


def draw_resolution(found: "RecoveredProfile", ax: "Axes | None") -> "Axes":
    """The resolution matrix up to the last arrest: what each recovered value takes from the true one at each place, per λc."""
    ax = axes(ax)
    shown = found.position <= found.measurements.length.max() + 1
    x = found.position[shown]
    per_length = found.resolution[np.ix_(shown, shown)] / np.gradient(x)
    most = abs(per_length[:, 1:]).max()
    image = ax.pcolormesh(x, x, per_length, cmap="RdBu_r", vmin=-most, vmax=most, shading="nearest", rasterized=True)
    beyond = "both" if abs(per_length[:, 0]).max() > most else "neither"
    ax.figure.colorbar(image, ax=ax, label="weight, per $\\lambda_c$", extend=beyond)
    ax.plot(x, x, color=colours(ax).grey, lw=0.6, ls=":")
    ax.set(xlabel="true profile at $x'/\\lambda_c$", ylabel="recovered profile at $x/\\lambda_c$")
    return ax
