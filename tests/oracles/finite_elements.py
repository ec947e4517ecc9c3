"""A whole block by sparse finite elements: every column of every contact in one matrix, with a free right end far away.

Shares the positions of the nodes and the kind of element with the package, and no code: the element is integrated in closed
form by polynomials, the contacts are springs on the mean of their patch, and there is no waveguide.
"""

import numpy as np
import scipy.sparse as sparse
from numpy.polynomial import Polynomial
from scipy.sparse.linalg import splu

from oracles.dense_chain import end_of_event

# on an edge from −1 to 1: 1 at its start, its middle and its end, and 0 at the other two; ∫ f g, ∫ f′ g and ∫ f′ g′
EDGE = [Polynomial([0, -0.5, 0.5]), Polynomial([1, 0, -1]), Polynomial([0, 0.5, 0.5])]
PLAIN, MIXED, BENT = (
    np.array([[np.diff((f.deriv(m) * g.deriv(n)).integ()([-1, 1]))[0] for g in EDGE] for f in EDGE])
    for m, n in ((0, 0), (1, 0), (1, 1))
)


def rectangle(width, height, poisson):
    """Biquadratic element, plane stress, E = 1; u_x and u_y of nine nodes, row by row from below."""
    xx, yy = np.kron(PLAIN, BENT) * height / width, np.kron(BENT, PLAIN) * width / height
    xy = np.kron(MIXED.T, MIXED)
    stiff, shear = 1 / (1 - poisson**2), 1 / (2 * (1 + poisson))
    K = np.zeros((18, 18))
    K[0::2, 0::2] = stiff * xx + shear * yy
    K[1::2, 1::2] = stiff * yy + shear * xx
    K[0::2, 1::2] = stiff * poisson * xy + shear * xy.T
    K[1::2, 0::2] = K[0::2, 1::2].T
    return K


class WholeBlock:
    """A block on contacts, each under elements of given widths; the response to the pinning of the first `reach` of them.

    `matrix` and `push` are those of their means of u_x; with springs across, `across` and `push_across` of those of u_y.
    """

    def __init__(self, y, widths, stiffness, poisson, pushed, force=None, reach=None, normal=None, top="free"):
        contacts, every = len(widths), np.concatenate(widths)
        contact = np.repeat(np.arange(contacts), [len(own) for own in widths])
        rows, columns = y.size, 2 * every.size + 1
        index = np.arange(2 * rows * columns).reshape(columns, rows, 2)
        of_width = {w: [rectangle(w, h, poisson) for h in np.diff(y[::2])] for w in set(every.tolist())}
        elements = np.array([of_width[w] for w in every.tolist()])
        nodes = [index[i : columns - 2 + i : 2, j : rows - 2 + j : 2] for j in range(3) for i in range(3)]
        at = np.concatenate(nodes, axis=-1)  # of every element its eighteen freedoms
        i, j, v = np.broadcast_arrays(at[..., :, None], at[..., None, :], elements)
        size = index.size
        K = sparse.csr_matrix((v.ravel(), (i.ravel(), j.ravel())), (size, size))
        lower = [index[i : columns - 2 + i : 2, 0] for i in range(3)]
        mean, across = (  # ∫ u dx over a contact, of length 1
            sum(sparse.csr_matrix((every * w / 6, (contact, part[:, axis])), (contacts, size))
                for w, part in zip((1, 4, 1), lower, strict=True)) for axis in (0, 1)
        )  # fmt: skip
        K = K + stiffness * mean.T @ mean
        held = np.zeros(size, bool)
        if normal is None:
            held[index[:, 0, 1]] = True
        else:  # a spring under every point of the lower edge
            for i, first in enumerate(lower):
                for j, second in enumerate(lower):
                    spring = normal * stiffness * every / 2 * PLAIN[i, j]
                    K = K + sparse.csr_matrix((spring, (first[:, 1], second[:, 1])), (size, size))
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
        self.ends, self.lower, self.heights = np.append(0, np.cumsum(every)), index[:, 0, 1], y
        self.under_push = x
        reaction = K @ x - load
        self.at_pusher = reaction[at] if force is None else np.asarray(load[at])


def break_all(push, matrix, once=False, push_relief=0.0, relief=None):
    """Contacts in the order in which they break, the most overloaded next, until the last one does; plain NumPy.

    In the first front each breaks once: those that broke are passed over. With a `relief` of the pressure, the Coulomb stress
    s + relief decides; the event ends too where a contact loses all its pressure. Returns order, stress, pressure, and where
    the Coulomb stress falls to the threshold, on a curve as of `dense_chain.end_of_event`.
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
            ahead = total[min(max(order) + 1, total.size - 1)] - 1
            return order, stress, 1 - lost, end_of_event(order, over, ahead, alike=True)
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
