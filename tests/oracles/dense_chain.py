"""A chain of contacts as a textbook would program it: dense matrices, NumPy, one event after another.

Independent of the package: it imports nothing of it, assembles the whole stiffness matrix from the springs one by one,
solves it afresh after every break, and gets the semi-infinite end by adding one site after another to a wall until
nothing changes.
"""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Dense:
    K_L: np.ndarray  # N−1 bonds of the upper layer, in K
    K: np.ndarray  # N−1 bonds of the interfacial layer
    K_T: np.ndarray  # N transverse springs
    k: np.ndarray  # N contacts
    threshold: np.ndarray
    prestress: np.ndarray
    k_ref: float
    end: np.ndarray  # 2×2 stiffness the last site is tied to: (upper, layer)
    matrix: np.ndarray = field(init=False)
    inverse: np.ndarray = field(init=False)

    def __post_init__(self):
        n = len(self.k)
        A = np.zeros((2 * n, 2 * n))  # unknowns: u_t[0 … n−1], then u[0 … n−1]

        def spring(i, j, stiffness):
            A[i, i] += stiffness
            A[j, j] += stiffness
            A[i, j] -= stiffness
            A[j, i] -= stiffness

        for i in range(n - 1):
            spring(i, i + 1, self.K_L[i])
            spring(n + i, n + i + 1, self.K[i])
        for i in range(n):
            spring(i, n + i, self.K_T[i])
            A[n + i, n + i] += self.k[i]
        last = np.array([n - 1, 2 * n - 1])
        A[np.ix_(last, last)] += self.end
        self.matrix = A.copy()
        A[0] = 0
        A[0, 0] = 1  # u_t[0] = U
        self.clamped = A
        self.inverse = np.linalg.inv(A)

    def solve(self, pinning, load):
        """(u_t, u) in equilibrium: a dense solve, polished by one step of iterative refinement."""
        n = len(self.k)
        rhs = np.concatenate([np.zeros(n), self.k * pinning])
        rhs[0] = load
        x = self.inverse @ rhs
        x += self.inverse @ (rhs - self.clamped @ x)
        return x[:n], x[n:]

    def stress(self, pinning, load):
        u = self.solve(pinning, load)[1]
        t = self.k / self.k_ref * (u - pinning) + self.prestress
        return np.where(self.k > 0, t, 0.0)

    def energy(self, pinning, load):
        """Potential energy of springs, contacts and the dead loads that balance the prestress, in K u_s²."""
        n = len(self.k)
        u_t, u = self.solve(pinning, load)
        x = np.concatenate([u_t, u])
        springs = self.matrix.copy()
        springs[range(n, 2 * n), range(n, 2 * n)] -= self.k
        on = self.k > 0
        stretch = (u - pinning)[on] + self.prestress[on] * self.k_ref / self.k[on]
        dead = self.k_ref * self.prestress[on] @ u[on]
        return 0.5 * x @ springs @ x + 0.5 * self.k[on] @ stretch**2 - dead

    def nucleate(self, pinning):
        """Smallest U > 0 at which a contact reaches its threshold, and that contact."""
        rest = self.stress(pinning, 0.0)
        per_load = self.stress(np.zeros_like(pinning), 1.0) - self.stress(np.zeros_like(pinning), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            load = np.where((self.k > 0) & (per_load > 0), (self.threshold - rest) / per_load, np.inf)
        return load.min(), int(load.argmin())

    def rupture(self, pinning, load, first, max_breaks):
        """Break contact `first`, then the most overloaded contact again and again, until none is over its threshold."""
        pinning = pinning.copy()
        order = []
        j = first
        while len(order) < max_breaks:
            u = self.solve(pinning, load)[1]
            pinning[j] = u[j] + self.prestress[j] * self.k_ref / self.k[j]
            order.append(j)
            over = np.where(self.k > 0, self.stress(pinning, load) - self.threshold, -np.inf)
            j = int(over.argmax())
            if over[j] < 0:
                break
        return pinning, order


def end_stiffness(right, K_L, K, K_T, k):
    """2×2 stiffness of what lies beyond the last site; a half-line is built up from a wall, doubling nothing."""
    if right == "free":
        return np.zeros((2, 2))
    bond = np.diag([K_L, K])
    if right == "clamped":
        return bond
    site = np.array([[K_T, -K_T], [-K_T, K_T + k]])
    E = bond
    for _ in range(100_000):
        new = bond - bond @ np.linalg.solve(bond + site + E, bond)
        if np.abs(new - E).max() < 1e-16 * np.abs(new).max():
            return new
        E = new
    return E
