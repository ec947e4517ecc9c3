"""Areal stiffness of a PMMA-like block from precursor lengths at six heights."""

from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

TRUE_AREAL_STIFFNESS = 2.0e10  # Pa/m, what make_data.py put in


def main() -> FitResult:
    """Fit, print the report, and check that the known stiffness is found again."""
    result = sp.fit(sp.read_measurements(Path(__file__).with_name("lengths.csv")))
    print(result.report())
    (interval,) = result.intervals["areal_stiffness"][0.95]
    assert interval.low < TRUE_AREAL_STIFFNESS < interval.high
    return result


if __name__ == "__main__":
    main()
