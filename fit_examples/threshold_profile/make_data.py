"""Write lengths.csv: twelve blocks on one interface whose threshold rises and falls along it; k/K = 0.03, error 0.2 λc."""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
from independent_lattice import front_stress, length, write  # noqa: E402


def threshold(x):
    """θ/θ_0 at x, in λc."""
    return 1 + 0.12 * np.sin(2 * np.pi * np.asarray(x) / 45)


if __name__ == "__main__":
    rng = np.random.default_rng(12)
    rows = []
    for height in np.linspace(8, 44, 12).round(1):
        stress = front_stress(height, 0.03, 0.3)
        true = length(stress, threshold(np.arange(stress.size)))
        rows.append((height, 0.3, round(true + 0.2 * rng.standard_normal(), 2), 0.2, "synthetic"))
    header = ("height", "poisson", "length", "length_sigma", "provenance")
    write(HERE / "lengths.csv", header, rows, "synthetic: make_data.py, k/K = 0.03, NumPy seed 12")
