"""Pictures of states, ruptures and sensitivities; each is drawn on an Axes it is given, with units.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart.
"""

from typing import TYPE_CHECKING

import numpy as np

from slippulse_jax.lattice.cascade import Rupture
from slippulse_jax.lattice.chain import Chain
from slippulse_jax.lattice.equilibrium import Equilibrium
from slippulse_jax.lattice.sensitivity import Sensitivity

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "0.45"
DISTANCE = "distance from the trailing edge, $x/\\lambda_c$"


def displacements(ax: "Axes", found: Equilibrium, *, before: Equilibrium | None = None, sites: int | None = None) -> None:
    """Displacements of the two layers, in u_s; dashed: those `before` a rupture.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    found, before : Equilibrium
    sites : int, optional
        How many sites from the left edge to show; all by default.
    """
    shown = slice(sites)
    for state, style, when in ((before, "--", " before"), (found, "-", " after" if before is not None else "")):
        if state is not None:
            ax.plot(np.asarray(state.upper)[shown], style, color=BLUE, label=f"upper layer $u_t${when}")
            ax.plot(np.asarray(state.layer)[shown], style, color=ORANGE, label=f"interfacial layer $u${when}")
    ax.set(xlabel=DISTANCE, ylabel="displacement, $u/u_s$")
    ax.legend(frameon=False)


def stress(
    ax: "Axes",
    found: Equilibrium,
    *,
    chain: Chain | None = None,
    before: Equilibrium | None = None,
    sites: int | None = None,
) -> None:
    """Stress on every contact, in σ_s; with `chain`, its thresholds; dashed: the stress `before` a rupture."""
    shown = slice(sites)
    if before is not None:
        ax.plot(np.asarray(before.stress)[shown], "--", color=BLUE, label="before")
    ax.plot(np.asarray(found.stress)[shown], "-", color=ORANGE, label="after" if before is not None else "stress")
    if chain is not None:
        ax.plot(np.asarray(chain.threshold)[shown], ":", color=GREY, label="threshold")
    ax.set(xlabel=DISTANCE, ylabel="contact stress, $t/\\sigma_s$")
    ax.legend(frameon=False)


def front_stress(ax: "Axes", stress: np.ndarray, *, length: float | None = None, threshold: float = 1.0) -> None:
    """Stress each contact carries as the front reaches it, in σ_s, and the length ℓ where it falls below threshold."""
    stress = np.asarray(stress)
    ax.plot(stress, "o-", color=BLUE, markersize=3, linewidth=1, label="stress at the front")
    ax.axhline(threshold, color=GREY, linestyle=":", label="threshold")
    if length is not None and np.isfinite(length):
        ax.axvline(length, color=ORANGE, linestyle="--", label=f"$\\ell = {float(length):.2f}\\,\\lambda_c$")
    ax.set(xlabel="contact, $s$ (distance from the trailing edge in $\\lambda_c$)", ylabel="front stress, $t(s)/\\sigma_s$")
    ax.legend(frameon=False)


def space_time(ax: "Axes", found: Rupture) -> None:
    """Which contact broke when: every break of a rupture, coloured by the stress it gave up; time counts breaks.

    Of a rupture under the hard rule; the model is quasi-static, so the order is all there is to time.
    """
    n = int(found.breaks)
    order, released = np.asarray(found.order)[:n], np.asarray(found.released)[:n]
    points = ax.scatter(
        order, np.arange(1, n + 1), c=released, s=np.clip(4000 / max(n, 1), 2, 25), cmap="cividis", linewidths=0
    )
    ax.set(xlabel=DISTANCE, ylabel="breaks since the first")
    ax.figure.colorbar(points, ax=ax, label="stress given up, $t/\\sigma_s$")


def sensitivity(ax: "Axes", found: Sensitivity, *, sites: int | None = None) -> None:
    """Which contacts hold the front: the change of its length per change of threshold and of prestress, contact by contact."""
    shown = slice(sites)
    theta, phi = np.asarray(found.threshold)[shown], np.asarray(found.prestress)[shown]
    x = np.arange(theta.size)
    ax.axhline(0, color=GREY, linewidth=0.8)
    ax.bar(x - 0.2, theta, 0.4, color=BLUE, label="threshold, $\\partial\\ell/\\partial\\theta_i$")
    ax.bar(x + 0.2, phi, 0.4, color=ORANGE, label="prestress, $\\partial\\ell/\\partial\\varphi_i$")
    length = float(found.length)
    if np.isfinite(length):
        ax.axvline(length, color=GREEN, linestyle="--", linewidth=1, label=f"$\\ell = {length:.2f}\\,\\lambda_c$")
    ax.set_yscale("symlog", linthresh=1, linscale=0.7)
    ax.set(xlabel=DISTANCE, ylabel="change of length, $\\lambda_c/\\sigma_s$")
    ax.legend(frameon=False)
