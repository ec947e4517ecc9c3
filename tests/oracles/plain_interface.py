"""An independent program: a front over contacts with prestress, any thresholds and a repinning delay. Imports nothing of the package.

Detached contacts are springs taken out of the matrix; the chain is solved anew after every break.
"""

import numpy as np

from oracles.plain_chain import chain_matrix


def front(height, stiffness, poisson, threshold, prestress, delay, sites=200, right="semi-infinite"):
    """Count, excess stress (t − θ) at each contact as the front came to it, load, and contact stresses at arrest."""
    n, q = sites, stiffness
    matrix = chain_matrix(height, stiffness, poisson, n, right)
    pinned, attached = np.zeros(n), np.ones(n, bool)

    def stresses(load):
        a = matrix.copy()
        for i in np.nonzero(~attached)[0]:
            a[n + i, n + i] -= q
        rhs = np.zeros(2 * n)
        rhs[0] = load
        # the traction that balances the prestress is −q φ away from balance where the contact is gone
        rhs[n:] = np.where(attached, q * pinned, q * prestress)
        layer = np.linalg.solve(a, rhs)[n:]
        return layer, np.where(attached, layer - pinned + prestress, 0)

    unit = stresses(1.0)[1][0] - stresses(0.0)[1][0]
    load = (threshold[0] - prestress[0]) / unit
    excess, s = [0.0], 0
    while excess[-1] >= 0 and s < n:
        layer, stress = stresses(load)
        back = s - delay
        attached[s] = False
        if back >= 0:
            pinned[back] = layer[back] + prestress[back]
            attached[back] = True
        s += 1
        layer, stress = stresses(load)
        if s < n:
            excess.append(stress[s] - threshold[s])
    return s, np.array(excess), load, stress


def length(excess):
    s0 = len(excess) - 1
    return s0 - 1 + excess[s0 - 1] / (excess[s0 - 1] - excess[s0])
