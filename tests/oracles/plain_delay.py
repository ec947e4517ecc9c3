"""An independent program: breaks with delayed repinning, by taking the springs of detached contacts out of a dense matrix.

Imports nothing of the package. The most overloaded contact breaks, most overloaded first; a broken contact repins, at zero
stretch, as the nth contact after it breaks, or when the event ends.
"""

import numpy as np

from oracles.plain_chain import chain_matrix


class PlainDelay:
    def __init__(self, slider, theta, phi, delay, right="free"):
        self.n, self.q, self.slider = len(theta), slider[1], slider
        self.theta, self.phi, self.delay = theta, phi, delay
        self.matrix = chain_matrix(*slider, self.n, right)
        self.pinned, self.attached, self.load = np.zeros(self.n), np.ones(self.n, bool), 0.0

    def fields(self, load):
        n, a = self.n, self.matrix.copy()
        for i in np.nonzero(~self.attached)[0]:
            a[n + i, n + i] -= self.q
        rhs = np.zeros(2 * n)
        rhs[0] = load
        # the tractions that balance the prestress go on pulling where the contact is gone
        rhs[n:] = np.where(self.attached, self.q * self.pinned, self.q * self.phi)
        x = np.linalg.solve(a, rhs)
        return x[:n], x[n:]

    def stress(self, load):
        return np.where(self.attached, self.fields(load)[1] - self.pinned + self.phi, 0.0)

    def force(self):
        u_t, u = self.fields(self.load)
        height, poisson = self.slider[0], self.slider[2]
        return height * (u_t[0] - u_t[1]) + (u_t[0] - u[0]) / (2 * (1 + poisson) * height)

    def energy(self):
        """Of the springs, and of the tractions."""
        u_t, u = self.fields(self.load)
        height, transverse = self.slider[0], 1 / (2 * (1 + self.slider[2]) * self.slider[0])
        stretch = np.where(self.attached, u - self.pinned, -self.phi)
        anchor = np.where(self.attached, self.pinned, u + self.phi)
        springs = height * (np.diff(u_t) ** 2).sum() + (np.diff(u) ** 2).sum() + transverse * ((u_t - u) ** 2).sum()
        return (springs + self.q * (stretch**2).sum()) / 2 - self.q * (self.phi * anchor).sum()

    def repin(self, i):
        self.pinned[i] = self.fields(self.load)[1][i] + self.phi[i]
        self.attached[i] = True

    def event(self, load=None):
        now = self.stress(self.load)
        missing = (self.theta - now) / (self.stress(self.load + 1) - now)
        site = int(missing.argmin())
        self.load += missing[site]
        if load is not None:
            self.load = load
            site = int((self.stress(load) - self.theta).argmax())
        order, waiting = [], []
        while site is not None:
            if len(waiting) == self.delay:
                self.repin(waiting.pop(0)) if waiting else None
            if self.delay:
                waiting.append(site)
                self.attached[site] = False
            else:
                self.repin(site)
            order.append(site)
            over = np.where(self.attached, self.stress(self.load) - self.theta, -np.inf)
            site = int(over.argmax()) if over.max() >= 0 else None
        for i in waiting:
            self.repin(i)
        return order
