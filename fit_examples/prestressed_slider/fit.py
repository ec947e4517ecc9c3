"""One block under different shears of its top: its stiffness, or an unknown shear."""

import dataclasses
from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

TRUE_STIFFNESS, UNKNOWN = 0.01, 0.4


def main() -> FitResult:
    """Fit with the shear stated; then take the last line's shear for unknown."""
    data = sp.read_measurements(Path(__file__).with_name("lengths.csv"))
    result = sp.fit(data)
    print(result.report())
    pieces = result.intervals["stiffness"][0.95]
    assert any(piece.low < TRUE_STIFFNESS < piece.high for piece in pieces)
    # forgetting the shear: no stiffness explains lengths that differ on one block
    blind = sp.fit(dataclasses.replace(data, prestress=None))
    print(f"Without the shear: {blind.identifiability.value}")
    assert blind.deviance > 100 * result.deviance
    # the other way: a block of known stiffness is a gauge of shear
    length = data.length[-1:]
    last = sp.Measurements(height=20, poisson=0.3, length=length, length_sigma=0.5)
    gauge = sp.fit(last, free=("prestress",), fixed={"stiffness": TRUE_STIFFNESS})
    print(gauge.report())
    (shear,) = gauge.intervals["prestress"][0.95]
    assert shear.low < UNKNOWN < shear.high
    return result


if __name__ == "__main__":
    main()
