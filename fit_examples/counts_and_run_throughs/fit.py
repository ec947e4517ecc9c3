"""Whole contacts, and fronts that ran out of sight, without errors of their own."""

from pathlib import Path

import numpy as np

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

TRUE_STIFFNESS = 0.006


def main() -> FitResult:
    """Fit counts as counts; then see what is lost without fronts that ran through."""
    data = sp.read_measurements(Path(__file__).with_name("lengths.csv"))
    result = sp.fit(data)
    print(result.report())
    (interval,) = result.intervals["stiffness"][0.95]
    assert interval.low < TRUE_STIFFNESS < interval.high
    through = np.asarray(data.kind) == "at_least"
    assert through.sum() >= 2
    passed = sp.Measurements(
        height=data.height[through],
        poisson=0.3,
        length=data.length[through],
        length_sigma=0.0,
        kind=["at_least"] * through.sum(),
    )
    only = sp.fit(passed)
    print(f"The run-throughs alone: {only.identifiability.value}")
    pieces = only.intervals["stiffness"][0.95]
    assert any(piece.low <= TRUE_STIFFNESS <= piece.high for piece in pieces)
    return result


if __name__ == "__main__":
    main()
