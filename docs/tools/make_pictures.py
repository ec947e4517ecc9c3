"""Draw the pictures of README.md and of the pages about gauges and precursors. Run: python docs/tools/make_pictures.py."""

import re
import tempfile
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

DOCS = Path(__file__).resolve().parents[1]


def main() -> None:
    """Draw every picture again."""
    result = sp.fit(sp.read_measurements(DOCS.parent / "fit_examples/pmma_block/lengths.csv"))
    save(sp.plot.fit(result), "fit")
    front = sp.first_precursor(sp.Slider(height=25.0, stiffness=0.03, poisson=0.3))
    sp.plot.animate(front, DOCS / "pictures" / "front.gif")
    save(sp.plot.gauges(gauges()), "gauges")
    save(precursors(), "precursors")
    save(sp.plot.front_stress(front.front_stress[:40], length=float(front.length)).figure, "tutorial")


def gauges() -> FitResult:
    """The fit of the two tables on the page about gauges."""
    tables = re.findall(r"^```csv\n(.*?)^```$", (DOCS / "fit" / "gauges.md").read_text("utf-8"), flags=re.M | re.S)
    with tempfile.TemporaryDirectory() as folder:
        lengths, readings = (Path(folder) / name for name in ("lengths.csv", "gauges.csv"))
        lengths.write_text(tables[0], encoding="utf-8")
        readings.write_text(tables[1], encoding="utf-8")
        return sp.fit(sp.read_measurements(lengths, gauges=readings), ["stiffness", "strength"])


def precursors() -> Any:
    """Series of blocks with friction: by μ and contact law, by the height of the push, by the length."""
    panels = (
        {
            "μ = 0": {"friction": 0.0},
            "0.25": {},
            "0.5": {"friction": 0.5},
            "0.5, rough": {"friction": 0.5, "contact_law": "multicontact"},
        },
        {"h = 0.1 H": {"push": sp.Push(0.1, 0.1)}, "0.25 H": {}, "0.5 H": {"push": sp.Push(0.5, 0.1)}},
        {"L = 1.5 H": {"length": 75}, "2 H": {}, "4 H": {"length": 200}},
    )
    with sp.plot.style.use(figure__figsize=(sp.plot.style.PAGE, 2.8)):
        figure, every = plt.subplots(1, 3, sharey=True)
    for ax, cases in zip(every, panels, strict=True):
        for (label, case), colour in zip(cases.items(), ("blue", "orange", "green", "vermilion"), strict=False):
            given = {"push": sp.Push(0.25, 0.1), "length": 100, "friction": 0.25} | case
            block = sp.Block(50.0, 1 / (2.6 * 50), 0.3, **given)
            sp.plot.precursors(sp.series(block, events=600), block, label=label, colour=colour, ax=ax)
        ax.set_xlabel(ax.get_xlabel().replace(", ", ",\n"))
    for ax in every[1:]:
        ax.set_ylabel("")
    return figure


def save(figure: Any, name: str) -> None:
    """Write one picture, whole."""
    sp.plot.save(figure, DOCS / "pictures" / f"{name}.png", dpi=120 if figure.get_figwidth() > 5 else 180)


if __name__ == "__main__":
    main()
