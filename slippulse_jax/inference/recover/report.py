"""A recovered profile as text and as plain values."""

from typing import TYPE_CHECKING, Any

import numpy as np

from slippulse_jax.files import plain

if TYPE_CHECKING:
    from slippulse_jax.inference.recover.recovery import RecoveredProfile

SYMBOL = {"threshold": "θ/θ_0", "prestress": "φ"}


def stretches(found: "RecoveredProfile") -> list[tuple[float, float]]:
    """Ends, in λc, of each stretch of the interface that the lengths determine."""
    inside = np.concatenate([[False], found.determined, [False]])
    edges = np.flatnonzero(inside[1:] != inside[:-1])
    return [(float(found.position[a]), float(found.position[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def report(found: "RecoveredProfile") -> str:
    """Format a recovered profile as text."""
    n = len(found.measurements)
    low, high = found.interval(0.95)
    where = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in stretches(found)) or "nowhere"
    lines = [
        f"{found.kind.capitalize()} profile from {n} length{'s' * (n > 1)}: {found.determination.value}",
        f"  independent values that the lengths determine: {found.degrees:.2f}, of {len(found.position)} knots",
        f"  determined (standard error at most 0.4 of the prior's, and checked by simulation) at x/λc: {where}",
        f"  χ² = {found.chi2:.4g} for {n} lengths; prior misfit {found.prior_misfit:.4g}; {found.steps} steps",
        f"  prior: {_prior(found)}",
        f"  {_starts(found)}",
        f"  simulated lengths agree with the linear error in {found.agreement:.0%} of draws from the posterior",
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
            "  A length determines the threshold where its front stopped; before that it implies only that the contacts broke."
        )
    return "\n".join(lines)


def _starts(found: "RecoveredProfile") -> str:
    contact, at_edge, length = found.nucleation
    moved = abs(length - found.fitted).max()
    where = f"contact {contact.min()}" + f" to {contact.max()}" * bool(np.ptp(contact))
    sure = f"{at_edge.min():.0%}" + f" to {at_edge.max():.0%}" * bool(np.ptp(at_edge) > 5e-3)
    text = f"events start at {where} on this profile (contact 0 in {sure} of draws from the posterior)"
    if found.nucleation.inside:
        text += f"; the order of the breaks moves ℓ by up to {moved:.2g} λc"
    elif found.kind == "prestress":
        text += "; if they were seen to start inside, do not rely on it"
    return text


def _prior(found: "RecoveredProfile") -> str:
    s = found.smoothness
    given = f"amplitude {s.amplitude:.3g}, length scale {s.length_scale:.3g} λc"
    if len(found.settings) == 1:
        return f"{given}, as given"
    if np.ptp(found.weight) == 0:
        return f"{len(found.settings)} settings, equal weights (too few lengths to choose)"
    return f"{given} of most evidence ({found.weight.max():.0%}), averaged over {len(found.settings)} settings"


def _rows(found: "RecoveredProfile") -> np.ndarray:
    """Positions listed in the report: evenly spaced, and the arrests where they are few."""
    last = found.measurements.length.max()
    arrests = np.unique(found.measurements.length.round())
    return np.unique(np.concatenate([np.linspace(0, last, 6).round(), arrests if len(arrests) <= 8 else []]))


def to_dict(found: "RecoveredProfile") -> dict[str, Any]:
    """Plain Python values, ready for JSON; numbers that are not finite are None."""
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
        "nucleation": found.nucleation._asdict(),
        "agreement": found.agreement,
        "units": {"position": "λc", "profile": "θ_0" if found.kind == "threshold" else "σ_s", "fitted": "λc"},
        **{name: getattr(found, name) for name in arrays},
    }
    return plain(content)
