"""Write lengths.csv: one block of k/K = 0.01 under five known shears of its top, each length with an error of 0.5 λc."""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
from independent_lattice import front_stress, length, write  # noqa: E402

if __name__ == "__main__":
    rng = np.random.default_rng(2014)
    rows = []
    for prestress in (0.0, 0.1, 0.2, 0.3, 0.4):
        true = length(front_stress(20, 0.01, 0.3, prestress=prestress))
        rows.append((20, 0.3, prestress, round(true + 0.5 * rng.standard_normal(), 2), 0.5, "synthetic"))
    header = ("height", "poisson", "prestress", "length", "length_sigma", "provenance")
    write(HERE / "lengths.csv", header, rows, "synthetic: make_data.py, k/K = 0.01, NumPy seed 2014")
