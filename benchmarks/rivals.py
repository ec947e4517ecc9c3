"""What else a user has for the length of a front: the same recursion in numba, and a linear solve for every break, banded or dense."""

import math
import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # waiting busily, numba's threads would slow whatever is measured next

import numba
import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded


@numba.njit
def end_of_front(position, over):
    """ℓ, where the polynomial through the last overloads, that of the contact that holds first, falls to zero.

    Backward differences and false position (Illinois).
    """
    o0, o1, o2, o3, o4, o5 = over
    n = min(position, 5)
    d1 = o0 - o1
    d2 = d1 - (o1 - o2) if n > 1 else 0.0
    d3 = d2 - (o1 - 2 * o2 + o3) if n > 2 else 0.0
    d4 = d3 - (o1 - 3 * o2 + 3 * o3 - o4) if n > 3 else 0.0
    d5 = d4 - (o1 - 4 * o2 + 6 * o3 - 4 * o4 + o5) if n > 4 else 0.0
    low, high, above, below = -1.0, 0.0, max(o1, 0.0), o0
    x, side = low, 0
    if above == 0:
        return position + low
    for _ in range(60):
        before, x = x, (low * below - high * above) / (below - above)
        value = o0 + x * (d1 + (x + 1) / 2 * (d2 + (x + 2) / 3 * (d3 + (x + 3) / 4 * (d4 + (x + 4) / 5 * d5))))
        if value == 0 or abs(x - before) < 1e-15:
            break
        if value > 0:
            low, above = x, value
            below, side = below / 2 if side == 1 else below, 1
        else:
            high, below = x, value
            above, side = above / 2 if side == -1 else above, -1
    return position + x


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
    E1 = E2 = t = 1.0
    over = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    s = 0
    while t >= 1:
        S1, S2, T1, T2, E1, E2 = r1 * (S1 + t), r2 * (S2 + t), T1 + E1 * t, T2 + E2 * t, r1 * E1, r2 * E2
        t = w1 * S1 + w2 * S2 + E1 * (c1 + R11 * T1 + R12 * T2) + E2 * (c2 + R21 * T1 + R22 * T2)
        s += 1
        over = (t - 1, over[0], over[1], over[2], over[3], over[4])
    return end_of_front(s, over)


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
    stress, over = 1.0, (0.0,) * 6
    for front in range(sites - 1):
        force[2 * front] += q * stress
        stress = cho_solve_banded(factor, force)[2 * front + 2]
        over = (stress - 1, *over[:5])
        if stress < 1:
            return end_of_front(front + 1, over)
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
    stress, over = 1.0, (0.0,) * 6
    for front in range(sites - 1):
        force[sites + front] += q * stress
        stress = np.linalg.solve(matrix, force)[sites + front + 1]
        over = (stress - 1, *over[:5])
        if stress < 1:
            return end_of_front(front + 1, over)
    return np.inf
