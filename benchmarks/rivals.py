"""What else a user has for the length of a front: the same recursion in numba, and a linear solve for every break, banded or dense."""

import math
import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # waiting busily, numba's threads would slow whatever is measured next

import numba
import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded


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
    """A chain of N sites, one banded solve per break."""
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


def dense(height: float, q: float, nu: float, sites: int = 200) -> float:
    """A dense matrix of 2N equations, solved for each break."""
    b = 1 / (2 * (1 + nu) * height)
    bond = 2 * np.eye(sites) - np.eye(sites, k=1) - np.eye(sites, k=-1)
    layer = bond.copy()
    layer[0, 0] = layer[-1, -1] = 1
    upper = height * bond
    upper[-1, -1] = height
    matrix = np.block([[upper + b * np.eye(sites), -b * np.eye(sites)], [-b * np.eye(sites), layer + (b + q) * np.eye(sites)]])
    matrix[0] = 0
    matrix[0, 0] = 1
    force = np.zeros(2 * sites)
    force[0] = 1
    force[0] /= np.linalg.solve(matrix, force)[sites]
    stress = 1.0
    for front in range(sites - 1):
        force[sites + front] += q * stress
        ahead = np.linalg.solve(matrix, force)[sites + front + 1]
        if ahead < 1:
            return front + (stress - 1) / (stress - ahead)
        stress = ahead
    return np.inf
