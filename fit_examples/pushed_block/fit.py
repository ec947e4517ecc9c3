"""Areal stiffness from one block pushed at six heights; the slider is refused."""

import math
from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

TRUE_AREAL_STIFFNESS = 9.0e10  # Pa/m, what make_data.py put in


def main() -> FitResult:
    """Fit, and check that the known stiffness is found and the slider refused."""
    result = sp.fit(sp.read_measurements(Path(__file__).with_name("lengths.csv")))
    print(result.report())
    (interval,) = result.intervals["areal_stiffness"][0.95]
    assert interval.low < TRUE_AREAL_STIFFNESS < interval.high
    (slider,) = (one for one in result.changes if one.name == "slider")
    assert math.isnan(*slider.moves["areal_stiffness"])  # none fits
    return result


if __name__ == "__main__":
    main()
