"""Compute and draw how a block's coefficient of static friction depends on its length, load and residual strength.

For docs/model/amontons.md. Run: python docs/tools/make_amontons.py (five minutes).
"""

import functools
from pathlib import Path
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

import slippulse_jax as sp

DOCS = Path(__file__).resolve().parents[1]
POISSON, FRICTION, PUSH = 0.3, 0.35, sp.Push(0.15, 0.1)
COARSE, DRAWN, FINE = 16, 24, 48
"""H/λc: where the stiffness of each contact follows its own pressure, which takes long; of the picture; of the table."""
LENGTHS, STIFFNESSES = (1, 2, 3, 4), (0.1, 0.3, 1.0, 3.0)
"""L/H and b of the table."""
LONG = 3
"""L/H where it is fixed."""
KEPT = (0.0, 0.2, 0.5, 0.7, 0.9)
REFERENCE = 0.1
"""Stiffness b at the reference load."""
LOADS = np.geomspace(0.1, 30, 50)
"""Normal load over that of reference; of the other law every fifth."""
EVENTS = 20_000
"""More than any series has here; one number for all, so that they share programs."""


def block_of(height: int, length: float, b: float, law: Any = "amontons") -> sp.Block:
    """Make a block from H/λc, L/H, b = areal stiffness times H over the shear modulus, and what follows the pressure."""
    sites, stiffness = round(length * height), b / (2 * (1 + POISSON) * height)
    return sp.Block(height, stiffness, POISSON, PUSH, length=sites, friction=FRICTION, contact_law=law)


@functools.cache
def coefficient(height: int, length: float, b: float, kept: float = 0.0, law: Any = "amontons") -> float:
    """Coefficient of static friction of a block over that of its contacts, which keep a share of their strength."""
    contacts = sp.Interface(residual_strength=kept)
    return float(sp.static_friction(block_of(height, length, b, law), contacts, events=EVENTS))


def at_largest(height: int, length: float, b: float) -> tuple[int, float]:
    """Event that begins at the largest force, and how far fronts have come before, over L."""
    found = sp.series(block_of(height, length, b), interface=sp.Interface(residual_strength=0.0), events=EVENTS)
    event = int(np.nanargmax(found.force_before))
    return event, float(np.max(found.extent[:event], initial=0)) / round(length * height)


@functools.cache
def creep_begins(height: int, length: float) -> float:
    """Stiffness b from which the first break is no longer at the largest force."""
    low, high = 0.01, 10.0
    while high / low > 1.003:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if at_largest(height, length, middle)[0] == 0 else (low, middle)
    return float(np.sqrt(low * high))


def table() -> str:
    """Table of the page: lengths by stiffnesses."""
    lines = ["| $L/H$ | " + " | ".join(f"$b$ = {b:g}" for b in STIFFNESSES) + " |", "|---|" + "---|" * len(STIFFNESSES)]
    for length in LENGTHS:
        row = (f"{coefficient(FINE, length, b):.3f}" for b in STIFFNESSES)
        lines.append(f"| {length} | " + " | ".join(row) + " |")
    return "\n".join(lines) + "\n"


def changes(coarse: int, fine: int) -> dict[float, float]:
    """Largest change of the table with finer contacts, by stiffness."""
    return {b: max(abs(coefficient(fine, x, b) - coefficient(coarse, x, b)) for x in LENGTHS) for b in STIFFNESSES}


def level() -> np.ndarray:
    """Coefficients of long blocks on stiffer interfaces, up to b = 3."""
    return np.array(
        [
            coefficient(FINE, length, round(b, 4))
            for length in LENGTHS[1:]
            for b in np.geomspace(1.1 * creep_begins(FINE, length), 3, 25)
        ]
    )


def other_law() -> np.ndarray:
    """Loads, and coefficients under both laws, where the contacts are coarse."""
    loads = LOADS[::5]
    laws = ([coefficient(COARSE, LONG, REFERENCE * x, law=law) for x in loads] for law in ("amontons", "multicontact"))
    return np.array([loads, *laws])


def draw() -> Any:
    """Draw it against length, residual strength and load."""
    with sp.plot.style.use():
        figure, axes = plt.subplots(1, 3, figsize=(sp.plot.style.PAGE, 2.4), sharey=True)
    c = sp.plot.style.colours(axes[0])
    looks = list(zip((0.03, 0.1, 0.3, 1.0), (c.sky, c.blue, c.green, c.vermilion), strict=True))
    by_length, by_kept, by_load = axes
    begins = {"color": c.ink, "markerfacecolor": c.paper, "markeredgewidth": 0.9, "markersize": 4.5, "zorder": 4}
    lengths = np.arange(12, 145, 3) / DRAWN
    for b, colour in looks:
        by_length.plot(lengths, [coefficient(DRAWN, x, b) for x in lengths], color=colour, label=f"b = {b:g}")
        later = [x for x in lengths if at_largest(DRAWN, x, b)[0] > 0]
        if later:
            by_length.plot(later[0], coefficient(DRAWN, later[0], b), "o", **begins)
    by_length.set(xlabel="length over height, L/H", ylabel="block's coefficient over μ", xlim=(0, 6), ylim=(0.5, 1))
    kept = np.append(np.arange(0, 0.96, 0.05), 0.98)
    for b, colour in looks[1:]:
        by_kept.plot(kept, [coefficient(DRAWN, LONG, b, round(r, 2)) for r in kept], color=colour, label=f"b = {b:g}")
    by_kept.set(xlabel="residual strength, r", xlim=(0, 1), xticks=(0, 0.5, 1), xticklabels=("0", "0.5", "1"))
    by_load.axhline(coefficient(FINE, LONG, REFERENCE), color=c.grey, linewidth=0.8, linestyle="--", label="k fixed")
    by_load.plot(LOADS, [coefficient(FINE, LONG, REFERENCE * x) for x in LOADS], color=c.ink, label="k ∝ load")
    loads, _, local = other_law()
    by_load.plot(loads, local, "s", color=c.orange, markeredgecolor=c.paper, markeredgewidth=0.4, markersize=4.5,
                 label="k ∝ local pressure")  # fmt: skip
    turn = creep_begins(FINE, LONG)
    by_load.plot(turn / REFERENCE, coefficient(FINE, LONG, turn), "o", **begins)
    by_load.set(xlabel="normal load over a reference", xscale="log", xlim=(0.095, 30))
    by_load.xaxis.set_major_locator(FixedLocator([0.1, 1, 10]))
    by_load.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    by_load.xaxis.set_minor_formatter(NullFormatter())
    for ax in axes:
        sp.plot.style.legend_above(ax, most=2)
    sp.plot.style.letter_panels(*axes)
    return figure


def main() -> None:
    """Write the table and the picture; print the numbers of the text."""
    jax.config.update("jax_enable_x64", True)
    (DOCS / "tables" / "amontons.md").write_text(table(), encoding="utf-8")
    sp.plot.save(draw(), DOCS / "pictures" / "amontons.png", dpi=120)
    print(table())
    for coarse, fine in ((COARSE, DRAWN), (DRAWN, FINE)):
        by_b = (f"{change:.3f} at {b:g}" for b, change in changes(coarse, fine).items())
        print(f"H/λc {coarse} to {fine}: changes by up to", ", ".join(by_b))
    print("kept at b = 1:", *(f"{r:g}: {coefficient(FINE, LONG, 1.0, r):.3f}" for r in KEPT))
    print("at 1, 2, 5, 10 times the load:", *(f"{coefficient(DRAWN, LONG, REFERENCE * x):.3f}" for x in (1, 2, 5, 10)))
    print("first break no longer at the largest force from b =", *(f"{creep_begins(FINE, x):.3f}" for x in LENGTHS))
    print(f"there: {level().min():.3f} to {level().max():.3f}; front before", f"{at_largest(FINE, LONG, 1.0)[1]:.2f} L")
    loads, own, local = other_law()
    more = local - own
    print(f"stiffness of each contact by its pressure: {more.max():+.3f}; beyond the reference load", more[loads > 1])
    print(f"twice as high, as long: {coefficient(DRAWN, 4, 0.1):.3f} to {coefficient(FINE, 2, 0.2):.3f}")
    print(f"twice as high and long: {coefficient(DRAWN, 3, 0.1):.3f} to {coefficient(FINE, 3, 0.2):.3f}")


if __name__ == "__main__":
    main()
