"""The paper's own number: 26 contacts at H/λc = 25. What does it say about k/K?"""

from pathlib import Path

import numpy as np

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

PRINTED_STIFFNESS = 0.03  # k/K of the numerical solution the length was read from


def main() -> FitResult:
    """Fit, and check that the ranges are those of 26 contacts, with the paper's k/K."""
    result = sp.fit(sp.read_measurements(Path(__file__).with_name("lengths.csv")))
    print(result.report())
    pieces = result.intervals["stiffness"][0.95]
    assert any(piece.low < PRINTED_STIFFNESS < piece.high for piece in pieces)
    ends = np.array([end for piece in pieces for end in piece[:2]])
    # as finely as the ends are searched for
    lengths = sp.precursor_lengths(sp.Slider(25.0, ends, 0.3))
    assert np.allclose(lengths, [25, 26, 26, 25], atol=5e-3)
    return result


if __name__ == "__main__":
    main()
