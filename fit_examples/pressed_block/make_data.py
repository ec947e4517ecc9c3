"""Write lengths.csv: first precursors of blocks whose thresholds follow the pressure, by `independent_block.py`.

Takes a minute or two.
"""

import csv
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from independent_block import precursor, responses

AREAL_STIFFNESS, YOUNG, POISSON, FRICTION = 9.0e10, 3.0e9, 0.3, 0.3  # Pa/m, Pa
NORMAL = (2 - POISSON) / (2 * (1 - POISSON))  # k_n/k of rough contacts (Mindlin)
CORRELATION_LENGTH, LONG = 0.2, 3  # mm; length of a block over its height
PUSHED = [(10, 1.5, 10), (10, 1.5, 3.5), (12, 2.5, 12), (12, 3, 4.5), (15, 2, 15), (15, 4, 6)]
"""Height, and from where to where the side is pushed, in mm."""
ERROR, SEED = 0.02, 2014


def main() -> None:
    """Write the table."""
    scatter, unit, rows = np.random.default_rng(SEED).standard_normal(len(PUSHED)), CORRELATION_LENGTH, []
    k = AREAL_STIFFNESS * unit * 1e-3 / YOUNG
    for (height, low, high), error in zip(PUSHED, scatter, strict=True):
        H = height / unit
        length = precursor(*responses(H, round(LONG * H), low / unit, high / unit, k, POISSON, NORMAL), FRICTION) * unit
        print(f"{height} mm, pushed from {low:g} to {high:g} mm: {length:.4f} mm", flush=True)
        patch = [(low + high) / 2, high - low] if high < height else [low, ""]
        row = [height, unit * 1e3, POISSON, YOUNG / 1e9, LONG * height, f"{length * (1 + ERROR * error):.4g}",
               f"{ERROR * length:.2g}", *patch, FRICTION, FRICTION / 10, f"{NORMAL:.4g}", "synthetic"]  # fmt: skip
        rows.append([x if isinstance(x, str) else f"{x:g}" for x in row])
    with Path(__file__).with_name("lengths.csv").open("w", encoding="utf-8", newline="") as file:
        file.write("# synthetic: make_data.py, finite elements, areal stiffness 9e10 Pa/m, friction 0.3; 2 % errors\n")
        names = (
            "height_mm,correlation_length_um,poisson,young_GPa,block_length_mm,length_mm,length_sigma_mm,push_height_mm,"
            "push_width_mm,friction,friction_sigma,normal_stiffness,provenance"
        )
        csv.writer(file, lineterminator="\n").writerows([names.split(","), *rows])


if __name__ == "__main__":
    main()
