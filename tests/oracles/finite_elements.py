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
    """A block on contacts, each under elements of given widths; the response to the pinning of the first `reach` of them.

    `matrix` and `push` are those of their means of u_x; with springs across, `across` and `push_across` of those of u_y.
    """

    def __init__(self, y, widths, stiffness, poisson, pushed, force=None, reach=None, normal=None, top="free"):
        contacts, every, ends = len(widths), np.concatenate(widths), np.append(0, np.cumsum([len(x) for x in widths]))
        rows, columns = y.size, every.size + 1
        index = np.arange(2 * rows * columns).reshape(columns, rows, 2)
        of_width = {w: [rectangle(w, h, poisson) for h in np.diff(y)] for w in set(every.tolist())}
        elements = np.array([of_width[w] for w in every.tolist()])
        corners = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        at = np.concatenate(corners, axis=-1)  # of every element its eight freedoms
        i, j, v = np.broadcast_arrays(at[..., :, None], at[..., None, :], elements)
        size = index.size
        K = sparse.csr_matrix((v.ravel(), (i.ravel(), j.ravel())), (size, size))
        mean, across = sparse.lil_matrix((contacts, size)), sparse.lil_matrix((contacts, size))
        for n, (start, own) in enumerate(zip(ends, widths, strict=False)):
            shape = (np.append(own, 0) + np.append(0, own)) / 2  # of ∫ u dx over a contact, of length 1
            mean[n, index[start : start + len(own) + 1, 0, 0]] = shape
            across[n, index[start : start + len(own) + 1, 0, 1]] = shape
        mean, across = mean.tocsr(), across.tocsr()
        K = K + stiffness * mean.T @ mean
        held = np.zeros(size, bool)
        if normal is None:
            held[index[:, 0, 1]] = True
        else:  # a spring under every point of the lower edge, by Simpson's rule exact for its linear shapes
            for weight, at_left in ((1, 1.0), (4, 0.5), (1, 0.0)):
                for a, first in ((at_left, index[:-1, 0, 1]), (1 - at_left, index[1:, 0, 1])):
                    for b, second in ((at_left, index[:-1, 0, 1]), (1 - at_left, index[1:, 0, 1])):
                        spring = normal * stiffness * every * weight / 6 * a * b
                        K = K + sparse.csr_matrix((spring, (first, second)), (size, size))
        if top == "held":
            held[index[:, -1, 1]] = True
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
        self.push, self.push_across = (mean @ x)[:reach], (across @ x)[:reach]
        inner = mean[:reach, free]
        moved = solve(np.ascontiguousarray(inner.T.toarray()))
        self.matrix, self.across = stiffness * (inner @ moved), stiffness * (across[:reach, free] @ moved)
        self.x, self.lower, self.heights = np.append(0, np.cumsum(every)), index[:, 0, 1], y
        self.under_push = x
        reaction = K @ x - load
        self.at_pusher = reaction[at] if force is None else np.asarray(load[at])


def break_all(push, matrix, once=False, push_relief=0.0, relief=None):
    """Contacts in the order in which they break, the most overloaded next, until the last one does; plain NumPy.

    In the first front each breaks once: those that broke are passed over. With a `relief` of the pressure, the Coulomb stress
    s + relief decides; the event ends too where a contact loses all its pressure. Returns order, stress, pressure, and where
    the straight line of the Coulomb stress falls to the threshold.
    """
    relief = np.zeros_like(matrix) if relief is None else relief
    coulomb = push + push_relief
    stress, lost, order, over = push / coulomb.max(), push_relief / coulomb.max() + 0 * push, [int(np.argmax(coulomb))], {}
    while True:
        j = order[-1]
        released = stress[j]
        over.setdefault(j, released + lost[j] - 1)
        stress, lost = stress + matrix[:, j] * released, lost + relief[:, j] * released
        stress[j] -= released
        left = [i for i in range(stress.size) if not (once and i in order)]
        total = stress + lost
        j = max(left, key=total.__getitem__, default=j)
        if not left or total[j] < 1 or order[-1] == stress.size - 1 or lost.max() > 1:
            last = max(order)
            behind, ahead = max(over[last], 0), min(total[min(last + 1, total.size - 1)] - 1, 0)
            return order, stress, 1 - lost, last + behind / (behind - ahead)
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
