"""The paper's own number: 26 contacts at H/λc = 25. What does it say about k/K?"""

from pathlib import Path

import slippulse_jax as sp

PRINTED_STIFFNESS = 0.03  # k/K of the numerical solution the length was read from


def main() -> sp.FitResult:
    """Fit, print the report, and check that the stiffness in the paper is among those allowed."""
    result = sp.fit(sp.read_measurements(Path(__file__).with_name("lengths.csv")))
    print(result.report())
    assert any(piece.low < PRINTED_STIFFNESS < piece.high for piece in result.intervals["stiffness"][0.6827])
    return result


if __name__ == "__main__":
    main()
