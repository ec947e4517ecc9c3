"""A long chain whose first contacts slide at a constant friction, by banded solves; without modes and without closed forms."""

import numpy as np
from scipy.linalg import solveh_banded


def dense(height, q, nu, friction, prestress, slides, load, sites):
    """u_t, u beyond the prestress and stress of a long chain of which the first contacts slide, by one banded solve."""
    K_L, K_T = height, 1 / (2 * (1 + nu) * height)
    # unknowns u_0, u_t1, u_1, u_t2, u_2 …: the pushed end u_t0 is given
    bands, force = np.zeros((3, 2 * sites)), np.zeros(2 * sites)
    attached = np.arange(sites) >= slides
    upper, layer = np.zeros(sites), np.zeros(sites)  # diagonals
    upper[:], layer[:] = K_T, K_T + np.where(attached, q, 0)
    upper[:-1] += K_L
    upper[1:] += K_L
    layer[:-1] += 1
    layer[1:] += 1
    bands[2, 0::2], bands[2, 1::2] = upper, layer
    bands[1, 1::2] = -K_T
    bands[0, 2::2], bands[0, 3::2] = -K_L, -1
    force[1::2] -= np.where(attached, 0, q * (friction - prestress))
    force[1] += K_T * load
    force[2] += K_L * load
    bands[:, 0], bands[2, 0], bands[1, 1], bands[0, 2] = 0, 1, 0, 0
    force[0] = load
    x = solveh_banded(bands, force)
    stress = np.where(attached, prestress + x[1::2], friction)
    return x[0::2], x[1::2], stress


def nucleated(height, q, nu, prestress, sites):
    """Load at which contact 0 carries its threshold."""
    return (1 - prestress) / dense(height, q, nu, 0, 0, 0, 1.0, sites)[1][0]
