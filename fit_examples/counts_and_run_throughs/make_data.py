"""Write lengths.csv: whole contacts of k/K = 0.006 on short blocks, and long ones that ran through a finite interface."""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
from independent_lattice import front_stress, length, write  # noqa: E402

INTERFACE = 30  # contacts of the track that were watched

if __name__ == "__main__":
    rows = []
    for height in (8, 12, 18, 24, 30, 36, 44, 56):
        true = length(front_stress(height, 0.006, 0.3))
        whole = int(np.ceil(true))
        if whole > INTERFACE:
            rows.append((height, 0.3, INTERFACE, "", "at_least", "synthetic"))
        else:
            rows.append((height, 0.3, whole, 0, "whole", "synthetic"))
    header = ("height", "poisson", "length", "length_sigma", "kind", "provenance")
    write(HERE / "lengths.csv", header, rows, "synthetic: make_data.py, k/K = 0.006, no noise; 30 contacts were watched")
