"""A virtual experiment whose blocks have mass; those of the fitted model have none."""

from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

TRUE_STIFFNESS = 0.01
INERTIA = 1.14  # by what inertia lengthens fronts at this damping, known from elsewhere


def main() -> FitResult:
    """Fit as if the model were true; then with what is known of how it differs."""
    data = sp.read_measurements(Path(__file__).with_name("lengths.csv"))
    naive = sp.fit(data)
    print(naive.report())
    (interval,) = naive.intervals["stiffness"][0.95]
    assert interval.low > 1.5 * TRUE_STIFFNESS  # far beyond the error bar …
    assert naive.p_value is not None
    assert naive.p_value > 0.05  # … and nothing in the data objects
    informed = sp.fit(data, sigma="relative", fixed={"model_factor": INERTIA})
    print(informed.report())
    pieces = informed.intervals["stiffness"][0.95]
    assert any(piece.low < TRUE_STIFFNESS < piece.high for piece in pieces)
    return informed


if __name__ == "__main__":
    main()
