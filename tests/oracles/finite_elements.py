"""A whole block by sparse finite elements: every column of every contact in one matrix, with a free right end far away.

Shares the positions of the nodes and the kind of element with the package, and no code: the element is integrated in closed
form by polynomials, the contacts are springs on the mean of their patch, and there is no waveguide.
"""

import numpy as np
import scipy.sparse as sparse
from numpy.polynomial import Polynomial
from scipy.sparse.linalg import splu


def _integral(f, g, size):
    """∫ f g over an edge of length `size`; polynomials on [−1, 1]."""
    whole = (f * g).integ()
    return (whole(1) - whole(-1)) * size / 2


def rectangle(width, height, poisson):
    """Four-node rectangle with incompatible modes 1 − ξ² and 1 − η², plane stress, E = 1."""
    line = Polynomial([0.5, -0.5]), Polynomial([0.5, 0.5])
    bubble, one = Polynomial([1, 0, -1]), Polynomial([1])
    shapes = [(line[a], line[b]) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))] + [(bubble, one), (one, bubble)]

    def products(d, e):
        """∫ ∂_d N_i ∂_e N_j for all shapes; 0 is x, 1 is y."""
        found = np.zeros((6, 6))
        for i, f in enumerate(shapes):
            for j, g in enumerate(shapes):
                fs = [
                    p.deriv() * (2 / s) if d == axis else p for axis, (p, s) in enumerate(zip(f, (width, height), strict=True))
                ]
                gs = [
                    p.deriv() * (2 / s) if e == axis else p for axis, (p, s) in enumerate(zip(g, (width, height), strict=True))
                ]
                found[i, j] = _integral(fs[0], gs[0], width) * _integral(fs[1], gs[1], height)
        return found

    xx, xy, yy = products(0, 0), products(0, 1), products(1, 1)
    stiff, shear = 1 / (1 - poisson**2), 1 / (2 * (1 + poisson))
    K = np.zeros((12, 12))
    K[0::2, 0::2] = stiff * xx + shear * yy
    K[1::2, 1::2] = stiff * yy + shear * xx
    K[0::2, 1::2] = stiff * poisson * xy + shear * xy.T
    K[1::2, 0::2] = K[0::2, 1::2].T
    nodal, mixed, inner = K[:8, :8], K[:8, 8:], K[8:, 8:]
    return nodal - mixed @ np.linalg.solve(inner, mixed.T)


class WholeBlock:
    """A block of so many contacts, two elements side by side over each."""

    def __init__(self, y, stiffness, poisson, contacts, pushed, force=None):
        rows, columns = y.size, 2 * contacts + 1
        index = np.arange(2 * rows * columns).reshape(columns, rows, 2)
        elements = [rectangle(0.5, h, poisson) for h in np.diff(y)]
        i, j, v = [], [], []
        for c in range(columns - 1):
            for r, K in enumerate(elements):
                at = np.concatenate([index[c, r], index[c + 1, r], index[c + 1, r + 1], index[c, r + 1]])
                i.append(np.repeat(at, 8))
                j.append(np.tile(at, 8))
                v.append(K.ravel())
        size = index.size
        K = sparse.csr_matrix((np.concatenate(v), (np.concatenate(i), np.concatenate(j))), (size, size))
        mean = sparse.lil_matrix((contacts, size))
        for n in range(contacts):
            mean[n, index[2 * n : 2 * n + 3, 0, 0]] = [0.25, 0.5, 0.25]
        mean = mean.tocsr()
        K = K + stiffness * mean.T @ mean
        held = np.zeros(size, bool)
        held[index[:, 0, 1]] = True
        load = np.zeros(size)
        at = index[0, :, 0]
        if force is None:
            held[at[pushed]] = True
        else:
            load[at] = force
        free = np.nonzero(~held)[0]
        solve = splu(sparse.csc_matrix(K[free][:, free])).solve
        x = np.zeros(size)
        if force is None:
            x[at[pushed]] = 1
        x[free] = solve(load[free] - K[free] @ x)
        self.push = mean @ x
        inner = mean[:, free]
        self.matrix = stiffness * (inner @ solve(np.ascontiguousarray(inner.T.toarray())))


def break_all(push, matrix):
    """Contacts in the order in which they break, the most overloaded next; plain NumPy."""
    stress = push / push.max()
    order = [int(np.argmax(push))]
    while True:
        j = order[-1]
        released = stress[j]
        stress = stress + matrix[:, j] * released
        stress[j] -= released
        j = int(np.argmax(stress))
        if stress[j] < 1:
            return order, stress
        order.append(j)
