"""Lengths by the hundred thousand: this package beside the alternatives a user has, in one run. Prints times and ratios.

The same recursion in numba, serial and on all cores; a plain ``vmap``; and, for 200 of the points, one SciPy banded solve
a break. Points: H/λc uniform 10–50, k/K log-uniform 1e-3–0.03, ν uniform 0.1–0.45. Run: python -m benchmarks.lengths.
"""

import math
import time

import jax
import numba
import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from slippulse_jax import Slider, precursor_length, precursor_lengths

POINTS, BANDED_POINTS, REPEATS = 200_000, 200, 9


@numba.njit
def one(height, q, nu):
    b = 1 / (2 * (1 + nu) * height)
    a = b / height
    root = math.sqrt((b + q - a) ** 2 + 4 * a * b)
    kappa_1 = math.sqrt((b + q + a + root) / 2)
    kappa_2 = math.sqrt(a * q) / kappa_1
    x1, x2 = kappa_1 / 2, kappa_2 / 2
    h1, h2 = math.sqrt(1 + x1 * x1), math.sqrt(1 + x2 * x2)
    r1, r2 = 1 / (h1 + x1) ** 2, 1 / (h2 + x2) ** 2
    g1, g2 = 2 * x1 / (h1 + x1), 2 * x2 / (h2 + x2)
    alpha_1, alpha_2 = 1 - kappa_1**2 / a, 1 - kappa_2**2 / a
    w1, w2 = -q * alpha_1 * a / root / (4 * x1 * h1), q * alpha_2 * a / root / (4 * x2 * h2)
    s1, s2 = g1 / r1, g2 / r2
    determinant = s2 / alpha_1 - s1 / alpha_2
    R11 = -w1 * (s2 / alpha_1 + g1 / alpha_2) / determinant
    R12 = -w2 * (s2 + g2) / alpha_2 / determinant
    R21 = w1 * (g1 + s1) / alpha_1 / determinant
    R22 = w2 * (g2 / alpha_1 + s1 / alpha_2) / determinant
    c1, c2 = -s2 / (s1 - s2), s1 / (s1 - s2)
    S1 = S2 = T1 = T2 = 0.0
    E1 = E2 = t = before = 1.0
    s = 0
    while t >= 1:
        before = t
        S1, S2, T1, T2, E1, E2 = r1 * (S1 + t), r2 * (S2 + t), T1 + E1 * t, T2 + E2 * t, r1 * E1, r2 * E2
        t = w1 * S1 + w2 * S2 + E1 * (c1 + R11 * T1 + R12 * T2) + E2 * (c2 + R21 * T1 + R22 * T2)
        s += 1
    return s - 1 + (before - 1) / (before - t)


@numba.njit
def serial(height, q, nu, out):
    for i in range(height.size):
        out[i] = one(height[i], q[i], nu[i])


@numba.njit(parallel=True)
def parallel(height, q, nu, out):
    for i in numba.prange(height.size):
        out[i] = one(height[i], q[i], nu[i])


def banded(height, q, nu, sites=400):
    """A chain of N sites, one banded solve a break."""
    b = 1 / (2 * (1 + nu) * height)
    u, ut = np.arange(0, 2 * sites - 1, 2), np.arange(1, 2 * sites - 1, 2)
    band = np.zeros((3, 2 * sites - 1))
    band[2, u], band[2, ut] = 2 + b + q, 2 * height + b
    band[2, u[[0, -1]]] -= 1
    band[2, ut[-1]] -= height
    band[1, u[1:]], band[0, u[1:]], band[0, ut[1:]] = -b, -1.0, -height
    factor = (cholesky_banded(band), False)
    force = np.zeros(2 * sites - 1)
    force[0], force[1] = b, height
    force /= cho_solve_banded(factor, force)[0]
    stress = 1.0
    for front in range(sites - 1):
        force[2 * front] += q * stress
        ahead = cho_solve_banded(factor, force)[2 * front + 2]
        if ahead < 1:
            return front + (stress - 1) / (stress - ahead)
        stress = ahead
    return np.inf


def best(function) -> float:
    function()
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return min(times)


def main() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(10, 50, POINTS), 10 ** rng.uniform(-3, math.log10(0.03), POINTS), rng.uniform(0.1, 0.45, POINTS)
    slider, out = Slider(*points), np.empty(POINTS)
    lengths = precursor_lengths(slider)
    serial(*points, out)
    print(f"largest difference from numba: {np.abs(lengths - out).max():.1e} λc; mean length {lengths.mean():.1f} λc")
    with jax.enable_x64(True):
        vmapped = jax.jit(precursor_length)
        times = {
            "precursor_lengths": best(lambda: precursor_lengths(slider)),
            "numba, all cores": best(lambda: parallel(*points, out)),
            "numba, serial": best(lambda: serial(*points, out)),
            "plain vmap": best(lambda: vmapped(slider).block_until_ready()),
        }
    began = time.perf_counter()
    for point in zip(*(x[:BANDED_POINTS] for x in points), strict=True):
        banded(*point)
    times["SciPy banded, a solve a break"] = (time.perf_counter() - began) * POINTS / BANDED_POINTS
    print(f"{'':32s} {'s':>9s} {'points/s':>10s} {'ratio':>8s}")
    for name, seconds in times.items():
        print(f"{name:32s} {seconds:9.4f} {POINTS / seconds:10.3g} {seconds / times['precursor_lengths']:8.2f}")


if __name__ == "__main__":
    main()
