"""Write lengths.csv: six heights on one interface of k/K = 0.02, each length with an error of 0.4 λc."""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
from independent_lattice import front_stress, length, write  # noqa: E402

if __name__ == "__main__":
    rng = np.random.default_rng(2014)
    rows = []
    for i, height in enumerate((10, 16, 25, 32, 40, 50)):
        true = length(front_stress(height, 0.02, 0.3))
        rows.append((height, 0.3, round(true + 0.4 * rng.standard_normal(), 2), 0.4, f"block {i + 1}", "synthetic"))
    header = ("height", "poisson", "length", "length_sigma", "specimen", "provenance")
    write(HERE / "lengths.csv", header, rows, "synthetic: make_data.py, k/K = 0.02, NumPy seed 2014")
