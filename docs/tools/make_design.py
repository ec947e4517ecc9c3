"""Draw the picture of docs/fit/design.md: what to measure once one length has left two roots."""

import io
from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.base.files import write_atomically

FIRST = sp.Measurements(height=25.0, poisson=0.3, length=25.9, length_sigma=0.1)


def main() -> None:
    """Six blocks, σ = 0.5 λc."""
    known = sp.Knowledge.from_measurements(FIRST)
    found = sp.design(known, height=[5, 10, 25, 50, 100, 400], sigma=0.5, experiments=2)
    content = io.BytesIO()
    sp.plot.design_figure(found).savefig(content, format="png", dpi=100)
    write_atomically(Path(__file__).resolve().parents[1] / "pictures" / "design.png", content.getvalue())
    print(found)


if __name__ == "__main__":
    main()
