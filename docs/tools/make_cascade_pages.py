"""Regenerate tables and figures of docs/model/chain.md, gradients.md and their appendices.

python docs/tools/make_cascade_pages.py
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import slippulse_jax as sp
from slippulse_jax.front.arrest import arrest

jax.config.update("jax_enable_x64", True)
DOCS = Path(__file__).resolve().parents[1]
FIG2 = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)
WIDTHS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 1.0)


def table(name, header, rows):
    """Write a Markdown table for a page to include."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(map(str, row)) + " |" for row in rows]
    (DOCS / "tables" / f"{name}.md").write_text("\n".join(lines) + "\n")


def picture(figure, name):
    """Save a figure as a PNG for a page to show."""
    figure.savefig(DOCS / "pictures" / f"{name}.png", dpi=110)
    plt.close(figure)


even = sp.Profile(np.ones(1))  # on a straight line, to which a smooth rule tends
hard = jax.jit(jax.vmap(lambda h, q: arrest(sp.Slider(h, q, 0.3), even, most=100_000).length))
smooth = jax.jit(lambda h, q, w: sp.precursor_length(sp.Slider(h, q, 0.3), rule=sp.SmoothBreak(width=w)))


def lengths(height, stiffness, width=None):
    """Return ℓ or ℓ_w of sliders with ν = 0.3; the arguments broadcast."""
    given = (height, stiffness) if width is None else (height, stiffness, width)
    numbers = np.broadcast_arrays(*(np.asarray(x, float) for x in given))
    return np.asarray((hard if width is None else smooth)(*(x.ravel() for x in numbers))).reshape(numbers[0].shape)


def bias():
    """Tabulate and draw the surrogate's bias over the range of the paper's Fig. 3.

    H/λc runs from 5 to 50, k/K from 0.003 to 0.03.
    """
    height = np.linspace(5, 50, 46)
    stiffness = np.geomspace(0.003, 0.03, 11)
    h, q = np.meshgrid(height, stiffness)
    exact = lengths(h, q)
    rows = []
    for w in WIDTHS:
        relative = (lengths(h, q, w) - exact) / exact
        worst = np.abs(relative).max()
        rows.append(
            (f"{w:g}", f"{100 * relative.mean():+.3g}", f"{100 * np.abs(relative).mean():.3g}", f"{100 * worst:.3g}")
            + tuple(
                f"{lengths(a, b, w) - lengths(a, b):+.3g}" for a, b in ((10.0, 0.03), (25.0, 0.03), (50.0, 0.03), (25.0, 0.003))
            )
        )
    header = (
        "$w$ (σ_s)",
        "mean bias, %",
        "mean size, %",
        "largest, %",
        "(10, 0.03), λc",
        "(25, 0.03), λc",
        "(50, 0.03), λc",
        "(25, 0.003), λc",
    )
    table("surrogate_bias", header, rows)

    rng = np.random.default_rng(0)
    h, q = rng.uniform(5, 50, 2000), 10 ** rng.uniform(np.log10(0.003), np.log10(0.03), 2000)
    exact = lengths(h, q)
    widths = 10.0 ** -np.arange(1.0, 5.1, 0.5)
    size = [np.abs(lengths(h, q, w) - exact).mean() for w in widths]
    rates = np.diff(np.log(size)) / np.diff(np.log(widths))
    table(
        "surrogate_rate",
        ("$w$ (σ_s)", "mean $|\\ell_w - \\ell|$, λc", "observed rate to here"),
        [(f"{w:.2g}", f"{s:.3g}", r) for w, s, r in zip(widths, size, ["–", *(f"{x:.2f}" for x in rates)], strict=True)],
    )

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    colours = ("#000000", "#0072B2", "#009E73", "#E69F00", "#D55E00")
    for w, colour in zip((None, 1e-3, 3e-3, 1e-2, 3e-2), colours, strict=True):
        line = lengths(height, 0.03, w)
        left.plot(
            height, line, color=colour, lw=2 if w is None else 1.2, label="hard" if w is None else f"w = {w:g} $\\sigma_s$"
        )
    left.set(xlabel="height, $H/\\lambda_c$", ylabel="length, $\\ell/\\lambda_c$", title="k/K = 0.03, ν = 0.3")
    left.legend(frameon=False)
    for (a, b), colour, marker in zip(((10.0, 0.03), (25.0, 0.03), (50.0, 0.03), (25.0, 0.003)), colours, "osv^", strict=False):
        ws = np.geomspace(1e-5, 1, 60)
        one = lengths(a, b, ws)
        right.loglog(
            ws,
            np.abs(one / lengths(a, b) - 1) + 1e-12,
            color=colour,
            marker=marker,
            markevery=6,
            ms=4,
            lw=1,
            label=f"H/λc = {a:g}, k/K = {b:g}",
        )
    right.loglog(widths, np.array(size) / exact.mean(), "k--", lw=2, label="mean over Fig. 3's range")
    right.loglog(widths[4:], 0.3 * (widths[4:] / widths[4]) ** 2 * size[4] / exact.mean(), ":", color="0.4", label="slope 2")
    right.set(xlabel="width, $w/\\sigma_s$", ylabel="bias, $|\\ell_w - \\ell|/\\ell$", ylim=(1e-8, 2))
    right.legend(frameon=False, fontsize=7.5, loc="lower right")
    picture(figure, "surrogate_bias")


def float32_errors():
    """Tabulate first precursors in float32 against float64."""
    rows = []
    for height, stiffness in ((10.0, 0.03), (25.0, 0.03), (50.0, 0.03), (25.0, 0.003)):

        def run(height, stiffness, poisson):
            c = sp.chain(sp.Slider(height=height, stiffness=stiffness, poisson=poisson), sites=300)
            state, site = sp.nucleate(c)
            return sp.equilibrium(c, state), sp.rupture(c, state, trigger=site)

        numbers = [jnp.asarray(x) for x in (height, stiffness, 0.3)]
        at_rest, event = jax.jit(run)(*numbers)
        length = smooth(*numbers[:2], jnp.asarray(0.01))
        with jax.enable_x64(False):
            single = [jnp.asarray(np.float32(x)) for x in (height, stiffness, 0.3)]
            at_rest32, event32 = jax.jit(run)(*single)
            length32 = smooth(*single[:2], jnp.asarray(np.float32(0.01)))
        rows.append(
            (
                f"{height:g}, {stiffness:g}",
                f"{np.abs(np.asarray(at_rest32.layer, float) - at_rest.layer).max():.1e}",
                f"{float(at_rest32.residual):.1e}",
                "the same" if int(event32.breaks) == int(event.breaks) else f"{int(event32.breaks)} for {int(event.breaks)}",
                f"{float(event32.length) - float(event.length):+.1e}",
                f"{float(event32.drift):.1e}",
                f"{float(length32) - float(length):+.1e}",
            )
        )
    header = ("H/λc, k/K", "u, u_s", "imbalance", "breaks", "ℓ, λc", "drift, σ_s", "ℓ_w (w = 0.01), λc")
    table("float32", header, rows)


def drift():
    """Tabulate the error accumulated over many breaks of one rupture."""
    rows = []
    for sites, load, most in ((300, 20.0, 10**3), (300, 2e3, 10**4), (3000, 2e5, 10**5)):
        c = sp.chain(sp.Slider(25.0, 0.03, 0.3, length=sites))
        found = jax.jit(lambda s, c=c, most=most: sp.rupture(c, s, max_breaks=most))(c.relaxed(load))
        n, u = int(found.breaks), float(jnp.abs(found.after.layer).max())
        eps = np.finfo(float).eps
        rows.append((sites, n, int(found.broken.max()), f"{float(found.drift):.1e}", f"{n * 16 * eps:.1e}", f"{u * eps:.1e}"))
    table(
        "drift",
        ("N", "breaks", "most breaks of one contact", "drift, σ_s", "bound 16 n ε, relative", "one digit of u, σ_s"),
        rows,
    )


def pictures():
    """Draw a rupture and the sensitivity of its length."""
    c = sp.chain(FIG2, sites=200)
    state, site = sp.nucleate(c)
    event = sp.rupture(c, state, trigger=site)
    figure, axes = plt.subplots(2, 2, figsize=(10, 7.2), layout="constrained")
    sp.plot.displacements(event.after, before=event.before, sites=70, ax=axes[0, 0])
    sp.plot.stress(event.after, chain=c, before=event.before, sites=70, ax=axes[0, 1])
    sp.plot.front_stress(sp.sensitivity(FIG2, sites=40).stress, length=float(event.length), ax=axes[1, 0])
    weak = sp.chain(sp.Slider(25.0, 0.03, 0.3, length=120), threshold=1 + 0.1 * np.sin(np.arange(120)))
    sp.plot.break_order(sp.rupture(weak, weak.relaxed(9.0)), ax=axes[1, 1])
    picture(figure, "rupture")
    figure, (hard, soft) = plt.subplots(1, 2, figsize=(10.5, 4), layout="constrained", sharey=True)
    sp.plot.sensitivity(sp.sensitivity(FIG2, sites=60), sites=31, ax=hard)
    hard.set_title("hard rule")
    sp.plot.sensitivity(sp.sensitivity(FIG2, sites=400, rule=sp.SmoothBreak(width=0.01)), sites=31, ax=soft)
    soft.set_title("smooth rule, w = 0.01 $\\sigma_s$")
    picture(figure, "sensitivity")


if __name__ == "__main__":
    for make in (bias, float32_errors, drift, pictures):
        make()
