"""A block from first principles, in NumPy and SciPy: what these examples' lengths of real blocks are made with.

Imports nothing of the package, and shares the kind of element with it, but no code, mesh or method: biquadratic elements over
the whole block in one sparse matrix, graded to the ends of the pusher, and contacts that break one by one. In λc and E = 1.
"""

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import splu

CORNER, GROWTH, AT_INTERFACE, PER_CONTACT = 1e-4, 1.5, 0.25, 2
"""Size of the elements at an end of the pusher, over H; of each over the one before it; of those at the interface, in λc; and
their number along a contact."""
AT_ONCE = 64
"""Contacts pulled at once."""


def graded(length, first, last=None):
    """Edges from 0 to `length`: about `first` at the start, at the end too if told to, each element larger than the next."""
    if last is not None:
        start, end = graded(length / 2, first), graded(length / 2, last)
        return np.append(start, length - end[-2::-1])
    count = max(int(np.ceil(np.log1p((GROWTH - 1) * length / first) / np.log(GROWTH))), 1)
    edge = np.cumsum(np.append(0.0, GROWTH ** np.arange(count)))
    return edge * length / edge[-1]


def element(width, height, poisson):
    """Stiffness of a biquadratic element in plane stress; u_x and u_y of each of nine nodes, row by row from below."""
    at, weight = np.polynomial.legendre.leggauss(3)
    elastic = np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]]) / (1 - poisson**2)
    shape = np.array([at * (at - 1) / 2, 1 - at * at, at * (at + 1) / 2])
    slope = np.array([at - 0.5, -2 * at, at + 0.5])
    stiffness = np.zeros((18, 18))
    for i, wy in enumerate(weight):
        for j, wx in enumerate(weight):
            strain = np.zeros((3, 18))
            strain[0, 0::2] = strain[2, 1::2] = 2 / width * np.outer(shape[:, i], slope[:, j]).ravel()
            strain[1, 1::2] = strain[2, 0::2] = 2 / height * np.outer(slope[:, i], shape[:, j]).ravel()
            stiffness += wx * wy * width * height / 4 * strain.T @ elastic @ strain
    return stiffness


def responses(height, contacts, low, high, stiffness, poisson, normal=None, reach=None):
    """Stress of the first contacts and what their pressure has lost, over σ_s and p̄/μ, per unit of push and pinning points.

    The left side is pushed from `low` to `high`; the top and the right end are free. A spring k = `stiffness` acts on the mean
    of u_x over each contact, and `normal` times as much on u_y, spread evenly; None: the bottom stays on the track.
    """
    reach = contacts if reach is None else reach
    fine = CORNER * height
    y = np.append(graded(low, AT_INTERFACE, fine), low + graded(high - low, fine, fine if high < height else None)[1:])
    y = np.append(y, high + graded(height - high, fine)[1:]) if high < height else y
    first, rest = graded(1.0, fine), np.arange(1, PER_CONTACT * (contacts - 1) + 1) / PER_CONTACT
    x, rows = np.append(first, 1 + rest), 2 * len(y) - 1
    contact = np.append(np.zeros(len(first) - 1, int), np.repeat(np.arange(1, contacts), PER_CONTACT))  # of each column
    # nodes are numbered upwards, column by column
    up, along = np.divmod(np.arange(9), 3)
    node = 2 * np.arange(len(x) - 1)[:, None, None] * rows + 2 * np.arange(len(y) - 1)[:, None] + along * rows + up
    freedom = (2 * node[..., None] + np.arange(2)).reshape(-1, 18)
    width, kind = np.unique(np.diff(x).round(12), return_inverse=True)
    every = np.array([[element(w, h, poisson) for h in np.diff(y)] for w in width])[kind].reshape(-1, 18, 18)
    size = 2 * rows * (2 * len(x) - 1)
    K = assembled(every, freedom, size)
    below = 2 * node[:, 0, :3]  # u_x of the three lowest nodes of each column
    part = np.diff(x)[:, None] * np.array([1, 4, 1]) / 6
    at = np.repeat(contact, 3), below.ravel()
    mean, across = (sparse.csc_matrix((part.ravel(), (at[0], at[1] + axis)), (contacts, size)) for axis in (0, 1))
    K = K + stiffness * mean.T @ mean
    if normal is not None:
        spread = np.array([[4, 2, -1], [2, 16, 2], [-1, 2, 4]]) / 30
        K = K + assembled(normal * stiffness * np.diff(x)[:, None, None] * spread, below + 1, size)
    K = K.tocsc()
    side = np.zeros(rows)
    side[0::2], side[1::2] = y, (y[1:] + y[:-1]) / 2
    held = 2 * np.flatnonzero((side >= low * (1 - 1e-9)) & (side <= high * (1 + 1e-9)))
    free = np.setdiff1d(np.arange(size), held if normal is not None else np.append(held, below + 1))
    solve = splu(K[free][:, free], permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve
    pushed = solve(-K[free][:, held] @ np.ones(len(held)))
    mean, across = mean[:reach, free], across[:reach, free]
    pulls = [mean[n : n + AT_ONCE].T.toarray() for n in range(0, reach, AT_ONCE)]
    slip = [solve(stiffness * pull) for pull in pulls]
    response, lost = (np.hstack([part @ one for one in slip]) for part in (mean, across))
    relief = normal or 0
    return mean @ pushed, response, relief * (across @ pushed), relief * lost


def assembled(every, freedom, size):
    """Sum of the elements' matrices."""
    i, j, v = np.broadcast_arrays(freedom[:, :, None], freedom[:, None, :], every)
    return sparse.csc_matrix((v.ravel(), (i.ravel(), j.ravel())), (size, size))


def precursor(push, response, push_lost, lost, friction=0.0):
    """Length of the first precursor: largest Coulomb stress s + μ q breaks next, down to 1, the pusher held meanwhile.

    A straight line from what the last contact had too much to what the next one lacks. It is inf if no contact is left.
    """
    coulomb = push + friction * push_lost
    load, over = 1 / coulomb.max(), {}
    stress, coulomb = load * push, load * coulomb
    while not over or coulomb.max() >= 1:
        j = int(np.argmax(coulomb))
        if j + 1 == len(stress):
            return np.inf
        over.setdefault(j, coulomb[j] - 1)
        released = stress[j]
        stress, coulomb = stress + response[:, j] * released, coulomb + (response[:, j] + friction * lost[:, j]) * released
        stress[j], coulomb[j] = stress[j] - released, coulomb[j] - released
    last = max(over)
    return last + over[last] / (over[last] + 1 - coulomb[last + 1])
