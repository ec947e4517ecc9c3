"""Write lengths.csv: the precursors of one block up to sliding, by `independent_sequence.py`.

Takes a few seconds.
"""

import csv
import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from independent_block import responses
from independent_sequence import sequence, visible

AREAL_STIFFNESS, FRICTION = 5.8e10, 0.35  # Pa/m
YOUNG, POISSON, NORMAL = 3.0e9, 0.3, 1.2  # Pa; k_n/k
HEIGHT, LENGTH, WIDTH, CONTACT = 30.0, 90.0, 10.0, 1.25  # mm; H/λc = 24
PUSH_HEIGHT, PUSH_WIDTH, NORMAL_LOAD = 4.5, 3.0, 1000.0  # mm, N
ERROR_OF_FORCE, ERROR_OF_LENGTH, SEED = 0.01, 0.03, 2014


def main() -> None:
    """Write the table."""
    sites, patch = round(LENGTH / CONTACT), (PUSH_HEIGHT - PUSH_WIDTH / 2, PUSH_HEIGHT + PUSH_WIDTH / 2)
    low, high = (end / CONTACT for end in patch)
    k = AREAL_STIFFNESS * CONTACT * 1e-3 / YOUNG
    events = sequence(*responses(HEIGHT / CONTACT, sites, low, high, k, POISSON, NORMAL), FRICTION)
    seen, rows = visible(events), []
    noise = np.random.default_rng(SEED).standard_normal((len(seen), 2))
    for number, (event, error) in enumerate(zip(seen, noise, strict=True), start=1):
        force, spans = event.force * FRICTION * NORMAL_LOAD, math.isinf(event.length)
        print(f"event {number}: {event.length * CONTACT:.2f} mm at {force:.2f} N")
        length = LENGTH if spans else event.length * CONTACT * (1 + ERROR_OF_LENGTH * error[1])
        ends = ["", "yes"] if spans else [f"{ERROR_OF_LENGTH * length:.2f}", "no"]
        rows.append([f"{HEIGHT:g}", f"{LENGTH:g}", f"{WIDTH:g}", f"{CONTACT * 1e3:g}", POISSON, f"{YOUNG / 1e9:g}",
                     PUSH_HEIGHT, f"{PUSH_WIDTH:g}", f"{NORMAL:g}", f"{NORMAL_LOAD:g}", number,
                     f"{force * (1 + ERROR_OF_FORCE * error[0]):.1f}", f"{ERROR_OF_FORCE * force:.1f}", f"{length:.2f}",
                     *ends, "synthetic"])  # fmt: skip
    with Path(__file__).with_name("lengths.csv").open("w", encoding="utf-8", newline="") as file:
        file.write(
            "# synthetic: make_data.py, finite elements, areal stiffness 5.8e10 Pa/m, friction 0.35; 1 % and 3 % errors\n"
        )
        names = (
            "height_mm,block_length_mm,block_width_mm,correlation_length_um,poisson,young_GPa,push_height_mm,push_width_mm,"
            "normal_stiffness,normal_load_N,event,force_N,force_sigma_N,length_mm,length_sigma_mm,spans,provenance"
        )
        csv.writer(file, lineterminator="\n").writerows([names.split(","), *rows])


if __name__ == "__main__":
    main()
