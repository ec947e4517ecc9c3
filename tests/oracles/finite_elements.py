"""A whole block by sparse finite elements: every column of every contact in one matrix, with a free right end far away.

Shares the positions of the nodes and the kind of element with the package, and no code: the element is integrated in closed
form by polynomials, the contacts are springs on the mean of their patch, and there is no waveguide.
"""

import numpy as np
import scipy.sparse as sparse
from numpy.polynomial import Polynomial
from scipy.sparse.linalg import splu

# on an edge from −1 to 1: its two linear shapes, a bubble, and a constant; ∫ f g, ∫ f′ g and ∫ f′ g′
EDGE = [Polynomial([0.5, -0.5]), Polynomial([0.5, 0.5]), Polynomial([1, 0, -1]), Polynomial([1])]
PRODUCTS = [
    np.array([[np.diff((f.deriv(m) * g.deriv(n)).integ()([-1, 1]))[0] for g in EDGE] for f in EDGE])
    for m, n in ((0, 0), (1, 0), (1, 1))
]
ALONG, ACROSS = np.array([0, 1, 1, 0, 2, 3]), np.array([0, 0, 1, 1, 3, 2])
"""Which of them, along x and along y, make up the four nodal shapes and the two incompatible modes."""


def rectangle(width, height, poisson):
    """Four-node rectangle with incompatible modes 1 − ξ² and 1 − η², plane stress, E = 1."""
    plain_x, mixed_x, bent_x = (one[np.ix_(ALONG, ALONG)] for one in PRODUCTS)
    plain_y, mixed_y, bent_y = (one[np.ix_(ACROSS, ACROSS)] for one in PRODUCTS)
    xx, xy, yy = bent_x * plain_y * height / width, mixed_x * mixed_y.T, plain_x * bent_y * width / height
    stiff, shear = 1 / (1 - poisson**2), 1 / (2 * (1 + poisson))
    K = np.zeros((12, 12))
    K[0::2, 0::2] = stiff * xx + shear * yy
    K[1::2, 1::2] = stiff * yy + shear * xx
    K[0::2, 1::2] = stiff * poisson * xy + shear * xy.T
    K[1::2, 0::2] = K[0::2, 1::2].T
    nodal, mixed, inner = K[:8, :8], K[:8, 8:], K[8:, 8:]
    return nodal - mixed @ np.linalg.solve(inner, mixed.T)


class WholeBlock:
    """A block of so many contacts, two elements side by side over each; the response to the pinning of the first `reach` of them."""

    def __init__(self, y, stiffness, poisson, contacts, pushed, force=None, reach=None, normal=None):
        rows, columns = y.size, 2 * contacts + 1
        index = np.arange(2 * rows * columns).reshape(columns, rows, 2)
        elements = np.array([rectangle(0.5, h, poisson) for h in np.diff(y)])
        corners = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        at = np.concatenate(corners, axis=-1)  # of every element its eight freedoms
        i, j, v = np.broadcast_arrays(at[..., :, None], at[..., None, :], elements)
        size = index.size
        K = sparse.csr_matrix((v.ravel(), (i.ravel(), j.ravel())), (size, size))
        mean = sparse.lil_matrix((contacts, size))
        for n in range(contacts):
            mean[n, index[2 * n : 2 * n + 3, 0, 0]] = [0.25, 0.5, 0.25]
        mean = mean.tocsr()
        K = K + stiffness * mean.T @ mean
        held = np.zeros(size, bool)
        if normal is None:
            held[index[:, 0, 1]] = True
        else:  # a spring under every point of the lower edge, by Simpson's rule exact for its linear shapes
            for left, right in zip(index[:-1, 0, 1], index[1:, 0, 1], strict=True):
                for weight, at_left in ((1, 1.0), (4, 0.5), (1, 0.0)):
                    shape = sparse.csr_matrix(([at_left, 1 - at_left], ([0, 0], [left, right])), (1, size))
                    K = K + normal * stiffness * 0.5 * weight / 6 * shape.T @ shape
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
        inner = mean[:reach, free]
        self.push = self.push[:reach]
        self.matrix = stiffness * (inner @ solve(np.ascontiguousarray(inner.T.toarray())))


def break_all(push, matrix, once=False):
    """Contacts in the order in which they break, the most overloaded next, until the last one does; plain NumPy.

    In the first front each breaks once: those that broke are passed over.
    """
    stress = push / push.max()
    order = [int(np.argmax(push))]
    while True:
        j = order[-1]
        released = stress[j]
        stress = stress + matrix[:, j] * released
        stress[j] -= released
        left = [i for i in range(stress.size) if not (once and i in order)]
        j = max(left, key=stress.__getitem__, default=j)
        if not left or stress[j] < 1 or order[-1] == stress.size - 1:
            return order, stress
        order.append(j)


def events_of(push, matrix, events):
    """Load at which each event begins, and the contacts that it breaks in order; the pusher is held meanwhile."""
    pinning, load, loads, orders = np.zeros(push.size), 0.0, [], []
    for _ in range(events):
        stress = load * push - pinning + matrix @ pinning
        rise = np.where(push > 0, (1 - stress) / np.where(push > 0, push, 1), np.inf)
        j, load, order = int(np.argmin(rise)), load + rise.min(), []
        while not order or stress[j] >= 1:
            order.append(j)
            pinning[j] += 1 if len(order) == 1 else stress[j]
            stress = load * push - pinning + matrix @ pinning
            j = int(np.argmax(stress))
        loads.append(load)
        orders.append(order)
    return np.array(loads), orders
