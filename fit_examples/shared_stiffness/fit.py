"""Six heights that share one stiffness; each alone would leave two."""

from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

TRUE_STIFFNESS = 0.02


def main() -> FitResult:
    """Fit all together, and the tallest alone."""
    data = sp.read_measurements(Path(__file__).with_name("lengths.csv"))
    tallest = {"height": data.height[-1], "length": data.length[-1]}
    alone = sp.fit(sp.Measurements(**tallest, poisson=0.3, length_sigma=0.4))
    print(f"The tallest alone: {alone.identifiability.value}")
    together = sp.fit(data)
    print(together.report())
    (interval,) = together.intervals["stiffness"][0.95]
    assert interval.low < TRUE_STIFFNESS < interval.high
    wide = alone.intervals["stiffness"][0.95]
    width = interval.high - interval.low
    assert sum(piece.high - piece.low for piece in wide) > 2 * width
    return together


if __name__ == "__main__":
    main()
