"""An independent program: a series of events, event by event, each from dense solves. Imports nothing of the package."""

import numpy as np
from scipy.optimize import brentq

from oracles.plain_chain import chain_matrix


class PlainSeries:
    """`strength(age)`: threshold over that of an unbroken contact; None for no ageing. `spring`: stiffness of the drive."""

    def __init__(self, slider, theta, phi, right="free", strength=None, spring=None):
        self.n, self.q, self.theta, self.phi = len(theta), slider[1], theta, phi
        n, height = self.n, slider[0]
        matrix = chain_matrix(*slider, n, right)
        self.strength, self.u_b, self.born = strength, np.zeros(n), np.full(n, -np.inf)
        a = matrix
        transverse = 1 / (2 * (1 + slider[2]) * height)
        self.rhs_edge = np.zeros(2 * n)
        if spring is None:
            self.rhs_edge[0] = 1
        else:
            a[0] = 0
            a[0, 0], a[0, 1], a[0, n] = height + transverse + spring, -height, -transverse
            self.rhs_edge[0] = spring
        self.spring, self.transverse, self.height, self.load = spring, transverse, height, 0.0
        self.inverse = np.linalg.inv(a)

    def fields(self, load):
        rhs = self.rhs_edge * load
        rhs[self.n :] += self.q * self.u_b
        x = self.inverse @ rhs
        return x[: self.n], x[self.n :]

    def stress(self, load):
        return self.fields(load)[1] - self.u_b + self.phi

    def push(self):
        u_t, u = self.fields(self.load)
        if self.spring is not None:
            return self.spring * (self.load - u_t[0])
        return self.height * (u_t[0] - u_t[1]) + self.transverse * (u_t[0] - u[0])

    def energy(self):
        """Of all springs, summed one by one, and of the tractions that balance the prestress; of a free chain."""
        u_t, u = self.fields(self.load)
        springs = self.height * (np.diff(u_t) ** 2).sum() + (np.diff(u) ** 2).sum() + self.transverse * ((u_t - u) ** 2).sum()
        drive = 0 if self.spring is None else self.spring * (self.load - u_t[0]) ** 2
        return (springs + self.q * ((u - self.u_b) ** 2).sum() + drive) / 2 - self.q * (self.phi * self.u_b).sum()

    def thresholds(self, load):
        if self.strength is None:
            return self.theta
        return self.theta * np.where(np.isinf(self.born), 1, self.strength(np.where(np.isinf(self.born), 0, load - self.born)))

    def next_load(self):
        """By bracketing and root finding on a fine grid for each contact, or directly without ageing."""
        now, c = self.stress(self.load), self.stress(self.load + 1) - self.stress(self.load)
        if self.strength is None:
            rise = (self.theta - now) / c
            return self.load + max(rise.min(), 0), int(rise.argmin())
        best = (np.inf, -1)
        for i in range(self.n):

            def gap(d, i=i):
                age = self.load + d - self.born[i]
                return self.theta[i] * (1.0 if np.isinf(age) else self.strength(age)) - now[i] - c[i] * d

            grid = np.linspace(0, 30, 3001)
            below = np.nonzero(np.array([gap(d) for d in grid]) <= 0)[0]
            if len(below):
                j = below[0]
                root = 0.0 if j == 0 else brentq(gap, grid[j - 1], grid[j], xtol=1e-15, rtol=1e-15)
                best = min(best, (root, i))
        return self.load + best[0], best[1]

    def event(self, step=None):
        target, first = self.next_load()
        if step is None:
            self.load = target
        else:
            while True:
                self.load += step
                over = self.stress(self.load) - self.thresholds(self.load)
                if (over >= 0).any():
                    first = int(over.argmax())
                    break
        order, site, self.overload = [], first, {}
        while site is not None:
            u = self.fields(self.load)[1]
            self.overload[site] = (u - self.u_b + self.phi - self.thresholds(self.load))[site]  # as it broke last
            self.u_b[site] = u[site] + self.phi[site]
            self.born[site] = self.load
            order.append(site)
            over = self.stress(self.load) - self.thresholds(self.load)
            site = int(over.argmax()) if over.max() >= 0 else None
        return order

    def length(self, order):
        """Of the event just over: where the stress over threshold, straight from the rightmost contact on, passes zero."""
        right = max(order)
        if right == self.n - 1:
            return np.inf
        behind = max(self.overload[right], 0)
        ahead = (self.stress(self.load) - self.thresholds(self.load))[right + 1]
        return right + behind / (behind - ahead)
