"""Make lengths.csv: first-precursor lengths of a PMMA-like block, by a SciPy banded solver of its own.

Run ``python make_data.py`` (about a minute). Every contact is a row of a banded matrix, every break one banded solve; nothing
of the package is imported, so that fitting these data tests the package against an independent program.
"""

import csv
from pathlib import Path

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

YOUNG = 3.0e9  # Pa
POISSON = 0.3
CORRELATION_LENGTH = 10e-6  # m
AREAL_STIFFNESS = 2.0e10  # Pa/m, the value to be found again
HEIGHTS = np.array([25e-3, 35e-3, 45e-3, 55e-3, 65e-3, 75e-3])  # m
NOISE = 0.5e-3  # m, standard deviation of the position at which a front is seen to stop
SEED = 20141
CHAIN_LENGTH = 20  # sites of the chain, in units of H/λc: nine decay lengths, beyond which nothing is felt


def banded_chain(height: float, stiffness: float, sites: int) -> np.ndarray:
    """Upper band of the symmetric matrix for u[0], u_t[1], u[1], u_t[2], u[2] … in units of K; u_t[0] is imposed."""
    transverse, longitudinal = 1 / (2 * (1 + POISSON) * height), height
    size = 2 * sites - 1
    band = np.zeros((3, size))  # second and first superdiagonal, diagonal
    u, ut = np.arange(0, size, 2), np.arange(1, size, 2)
    bonds = np.full(sites, 2.0)
    bonds[[0, -1]] = 1
    band[2, u] = bonds + transverse + stiffness
    band[2, ut] = longitudinal * np.where(np.arange(1, sites) == sites - 1, 1, 2) + transverse
    band[1, u[1:]] = -transverse  # u_t[i] – u[i]
    band[0, u[1:]] = -1.0  # u[i−1] – u[i]
    band[0, ut[1:]] = -longitudinal  # u_t[i−1] – u_t[i]
    return band


def first_precursor_length(height: float, stiffness: float) -> float:
    """Arrest length in λc, linearly interpolated between the last contact that broke and the first that did not."""
    sites = int(CHAIN_LENGTH * height)
    transverse, longitudinal = 1 / (2 * (1 + POISSON) * height), height
    factor = (cholesky_banded(banded_chain(height, stiffness, sites), check_finite=False), False)
    force = np.zeros(2 * sites - 1)
    force[0], force[1] = transverse, longitudinal  # unit displacement of the left edge
    response = cho_solve_banded(factor, force, check_finite=False)
    force /= response[0]  # loaded until contact 0 carries its threshold
    stress = 1.0
    for front in range(sites - 1):
        force[2 * front] += stiffness * stress  # contact `front` repins where it is
        ahead = cho_solve_banded(factor, force, check_finite=False)[2 * (front + 1)]
        if ahead < 1:
            return front + (stress - 1) / (stress - ahead)
        stress = ahead
    raise RuntimeError("the front ran through the chain")


def main() -> None:
    """Compute, add noise, write."""
    rng = np.random.default_rng(SEED)
    stiffness = AREAL_STIFFNESS * CORRELATION_LENGTH / YOUNG
    rows = []
    for height in HEIGHTS:
        length = first_precursor_length(height / CORRELATION_LENGTH, stiffness) * CORRELATION_LENGTH
        measured = length + NOISE * rng.standard_normal()
        print(f"H = {height * 1e3:g} mm: {length * 1e3:.4f} mm, measured {measured * 1e3:.2f} mm", flush=True)
        rows.append(
            ["block A", f"{height * 1e3:g}", f"{CORRELATION_LENGTH * 1e6:g}", POISSON, f"{YOUNG / 1e9:g}"]
            + [f"{measured * 1e3:.2f}", f"{NOISE * 1e3:g}", "synthetic"]
        )
    header = ["specimen", "height_mm", "correlation_length_um", "poisson", "young_GPa"]
    header += ["length_mm", "length_sigma_mm", "provenance"]
    with open(Path(__file__).with_name("lengths.csv"), "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


if __name__ == "__main__":
    main()
