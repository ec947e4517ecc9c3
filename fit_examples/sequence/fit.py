"""Areal stiffness and friction from one block up to sliding."""

from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

TRUE = {"areal_stiffness": 5.8e10, "friction": 0.35}  # Pa/m, what make_data.py put in


def main() -> FitResult:
    """Fit the sequence, and check that both numbers are found again."""
    table = Path(__file__).with_name("lengths.csv")
    result = sp.fit(table)
    print(result.report())
    for name, truth in TRUE.items():
        (interval,) = result.intervals[name][0.95]
        assert interval.low < truth < interval.high
    assert result.deviance < 11.07  # the 95 % quantile of χ² for 5 degrees of freedom
    return result


if __name__ == "__main__":
    main()
