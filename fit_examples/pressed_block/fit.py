"""Areal stiffness from blocks whose thresholds follow the pressure."""

import math
from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

TRUE_AREAL_STIFFNESS = 9.0e10  # Pa/m, what make_data.py put in


def main() -> FitResult:
    """Fit, and check that the known stiffness is found, and without friction is not."""
    result = sp.fit(sp.read_measurements(Path(__file__).with_name("lengths.csv")))
    print(result.report())
    (interval,) = result.intervals["areal_stiffness"][0.95]
    assert interval.low < TRUE_AREAL_STIFFNESS < interval.high
    (without,) = (one for one in result.changes if one.name == "pressure")
    assert math.isnan(without.moves["areal_stiffness"][0])  # none fits
    return result


if __name__ == "__main__":
    main()
