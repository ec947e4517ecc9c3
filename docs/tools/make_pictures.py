"""Draw the pictures of README.md and of the page about gauges. Run: python docs/tools/make_pictures.py."""

import io
import re
import tempfile
from pathlib import Path
from typing import Any

import slippulse_jax as sp
from slippulse_jax.files import write_atomically
from slippulse_jax.inference.fit import FitResult

DOCS = Path(__file__).resolve().parents[1]


def main() -> None:
    """Draw every picture again."""
    result = sp.fit(sp.read_measurements(DOCS.parent / "fit_examples/pmma_block/lengths.csv"))
    save(sp.plot.fit(result), "fit")
    front = sp.first_precursor(sp.Slider(height=25.0, stiffness=0.03, poisson=0.3))
    save(sp.plot.gauges(gauges()), "gauges")
    save(sp.plot.front_stress(front.front_stress[:40], length=float(front.length)).figure, "tutorial")


def gauges() -> FitResult:
    """The fit of the two tables on the page about gauges."""
    tables = re.findall(r"^```csv\n(.*?)^```$", (DOCS / "fit" / "gauges.md").read_text("utf-8"), flags=re.M | re.S)
    with tempfile.TemporaryDirectory() as folder:
        lengths, readings = (Path(folder) / name for name in ("lengths.csv", "gauges.csv"))
        lengths.write_text(tables[0], encoding="utf-8")
        readings.write_text(tables[1], encoding="utf-8")
        return sp.fit(sp.read_measurements(lengths, gauges=readings), ["stiffness", "strength"])


def save(figure: Any, name: str) -> None:
    """Write one picture, whole."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=110 if figure.get_figwidth() > 5 else 180)
    write_atomically(DOCS / "pictures" / f"{name}.png", content.getvalue())


if __name__ == "__main__":
    main()
