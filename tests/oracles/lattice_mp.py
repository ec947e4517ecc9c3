"""The lattice front in arbitrary precision, written a second time: no code, and no trick against rounding, is shared."""

from itertools import product

import mpmath as mp


class Chain:
    """Modes of the semi-infinite chain from the 2×2 matrix of its bulk equations, at the working precision of mpmath."""

    def __init__(self, height, stiffness, poisson):
        H, q, nu = mp.mpf(height), mp.mpf(stiffness), mp.mpf(poisson)
        KT = 1 / (2 * (1 + nu) * H)
        a = KT / H
        trace, determinant = a + KT + q, a * q
        larger = (trace + mp.sqrt(trace**2 - 4 * determinant)) / 2
        mu = [larger, determinant / larger]
        self.r = [1 + m / 2 - mp.sqrt(m * (1 + m / 4)) for m in mu]
        alpha = [1 - m / a for m in mu]
        share = [alpha[0] / (alpha[0] - alpha[1]), alpha[1] / (alpha[1] - alpha[0])]
        self.w = [q * g * r / (1 - r**2) for g, r in zip(share, self.r, strict=True)]
        self.upper = [1 / x for x in alpha]
        edge = mp.matrix([self.upper, [1 / r - 1 for r in self.r]])  # rows: u_t[0], u[−1] − u[0]
        self.R = mp.matrix(2, 2)
        for n in (0, 1):
            x = mp.lu_solve(edge, mp.matrix([-self.w[n] * self.upper[n], self.w[n] * (1 - self.r[n])]))
            self.R[0, n], self.R[1, n] = x
        x = mp.lu_solve(edge, mp.matrix([1, 0]))
        self.load = 1 / (x[0] + x[1])
        self.C = [self.load * y for y in x]

    def recursion(self, count, prestress=0):
        """t(0) … t(count − 1), break by break."""
        r, w, R, phi = self.r, self.w, self.R, mp.mpf(prestress)
        S, T, E, out = [mp.mpf(0)] * 2, [mp.mpf(0)] * 2, [mp.mpf(1)] * 2, []
        for _ in range(count):
            P = [E[m] * ((1 - phi) * self.C[m] + R[m, 0] * T[0] + R[m, 1] * T[1]) for m in (0, 1)]
            t = phi + w[0] * S[0] + w[1] * S[1] + P[0] + P[1]
            out.append(t)
            S = [r[m] * (S[m] + t) for m in (0, 1)]
            T = [T[m] + E[m] * t for m in (0, 1)]
            E = [E[m] * r[m] for m in (0, 1)]
        return out

    def roots(self):
        """ρ_1 < ρ_2 of (μ − r_1)(μ − r_2) = w_1 r_1 (μ − r_2) + w_2 r_2 (μ − r_1)."""
        (r1, r2), (w1, w2) = self.r, self.w
        half = (r1 * (1 + w1) + r2 * (1 + w2)) / 2
        off = mp.sqrt(half**2 - r1 * r2 * (1 + w1 + w2))
        return half - off, half + off

    def series(self, degree, prestress=0):
        """t as a function of real s, by the plain double series: poles at its resonances, which 60 digits can afford."""
        r, w, R, phi = self.r, self.w, self.R, mp.mpf(prestress)
        rho = self.roots()
        families = []
        for start in (*rho, mp.mpf(1)) if phi else rho:
            tau = {(0, 0): mp.mpf(1) if start != 1 else phi / (1 - sum(w[m] * r[m] / (1 - r[m]) for m in (0, 1)))}
            V = {(0, 0): [r[m] * w[m] * tau[0, 0] / (start - r[m]) for m in (0, 1)]}
            for d, a in [(2 * k, a) for k in range(1, degree // 2 + 1) for a in range(2 * k + 1)]:
                mu = start * r[0] ** a * r[1] ** (d - a)
                g = [mp.mpf(0), mp.mpf(0)]
                for m, n in product((0, 1), repeat=2):
                    below = (a - (m == 0) - (n == 0), d - a - (m == 1) - (n == 1))
                    if min(below) >= 0:
                        g[m] += r[m] * R[m, n] * tau[below]
                tau[a, d - a] = (g[0] * (mu - r[1]) + g[1] * (mu - r[0])) / ((mu - rho[0]) * (mu - rho[1]))
                V[a, d - a] = [(r[m] * w[m] * tau[a, d - a] + g[m]) / (mu - r[m]) for m in (0, 1)]
            families.append((start, tau, V))
        total = [[sum(v[m] for v in V.values()) for m in (0, 1)] for _, _, V in families]
        right = [(1 - phi) * self.C[m] - (total[2][m] if phi else 0) for m in (0, 1)]
        c = mp.lu_solve(mp.matrix([[total[0][m], total[1][m]] for m in (0, 1)]), mp.matrix(right))
        amplitudes = [c[0], c[1], mp.mpf(1)]

        def t(s):
            s = mp.mpf(s)
            p, q = ([(x**s) ** n for n in range(degree + 1)] for x in r)
            return sum(
                amplitudes[i] * start**s * sum(v * p[a] * q[b] for (a, b), v in tau.items())
                for i, (start, tau, _) in enumerate(families)
            )

        return t


class Line:
    """The continuum's two levels in arbitrary precision: self-consistent by its plain double series, frozen by quadrature."""

    def __init__(self, height, stiffness, poisson):
        H, q, nu = mp.mpf(height), mp.mpf(stiffness), mp.mpf(poisson)
        KT = 1 / (2 * (1 + nu) * H)
        a, k2 = KT / H, KT + q
        larger = (a + k2 + mp.sqrt((a + k2) ** 2 - 4 * a * q)) / 2
        mu = [larger, a * q / larger]
        self.k = [mp.sqrt(m) for m in mu]
        alpha = [1 - m / a for m in mu]
        share = [alpha[0] / (alpha[0] - alpha[1]), alpha[1] / (alpha[1] - alpha[0])]
        self.W = [q * g / (2 * k) for g, k in zip(share, self.k, strict=True)]
        upper = [1 / x for x in alpha]
        edge = mp.matrix([upper, [k + k2 for k in self.k]])  # rows: u_t(0), κ²u(0) − u'(0)
        self.R = mp.matrix(2, 2)
        for n in (0, 1):
            x = mp.lu_solve(edge, mp.matrix([-self.W[n] * upper[n], self.W[n] * (self.k[n] - k2)]))
            self.R[0, n], self.R[1, n] = x
        x = mp.lu_solve(edge, mp.matrix([1, KT]))
        load = 1 / (x[0] + x[1])
        released = mp.lu_solve(edge, mp.matrix([0, q]))
        self.V0 = [load * x[m] + released[m] for m in (0, 1)]
        self.kappa, self.beta, self.q, self.KT = mp.sqrt(k2), KT / k2, q, KT

    def series(self, degree):
        """t as a function of s."""
        k, W, R = self.k, self.W, self.R
        half = (k[0] - W[0] + k[1] - W[1]) / 2
        off = mp.sqrt(half**2 - k[0] * k[1] * (1 - W[0] / k[0] - W[1] / k[1]))
        families = []
        for start in (half + off, half - off):
            tau = {(0, 0): mp.mpf(1)}
            V = {(0, 0): [W[m] / (k[m] - start) for m in (0, 1)]}
            for d, a in [(2 * n, a) for n in range(1, degree // 2 + 1) for a in range(2 * n + 1)]:
                x = start + a * k[0] + (d - a) * k[1]
                g = [mp.mpf(0), mp.mpf(0)]
                for m, n in product((0, 1), repeat=2):
                    below = (a - (m == 0) - (n == 0), d - a - (m == 1) - (n == 1))
                    if min(below) >= 0:
                        g[m] += R[m, n] * tau[below]
                response = sum(W[m] / (k[m] - x) for m in (0, 1))
                tau[a, d - a] = sum(g[m] / (k[m] - x) for m in (0, 1)) / (1 - response)
                V[a, d - a] = [(W[m] * tau[a, d - a] + g[m]) / (k[m] - x) for m in (0, 1)]
            families.append((start, tau, V))
        total = [[sum(v[m] for v in V.values()) for m in (0, 1)] for _, _, V in families]
        c = mp.lu_solve(mp.matrix([[total[0][m], total[1][m]] for m in (0, 1)]), mp.matrix(self.V0))

        def t(s):
            p, q = ([mp.exp(-x * s * n) for n in range(degree + 1)] for x in k)
            return sum(
                c[i] * mp.exp(-start * s) * sum(v * p[a] * q[b] for (a, b), v in tau.items())
                for i, (start, tau, _) in enumerate(families)
            )

        return t

    def frozen(self, s):
        """Front stress under a frozen upper layer: F = t e^{κs} obeys F' = ½(1−β)κ (1 + even e^{−2κs}) F + (drive e^{κs})'."""
        k, beta, KT, k2 = self.kappa, self.beta, self.KT, self.k[1]
        p = beta * k**2 / (k**2 - k2**2)
        c = (KT - p * (k2 + k**2)) / (k + k**2)
        even, half = (1 - k) / (1 + k), (1 - beta) * k / 2

        def grown(y):
            return half * (y - even * mp.expm1(-2 * k * y) / (2 * k))

        def source(y):
            return p / (p + c) * (k - k2) * mp.exp((k - k2) * y - k * s + grown(s) - grown(y))

        # e^{−κ(s−y)/2} at most: what lies 300/κ back is below 1e-60
        steps = [mp.mpf(x) / k for x in (300, 200, 120, 60, 40, 20, 10, 5, 2)]
        points = [mp.mpf(0), *(1 / k,) * (s > 2 / k)] if s <= 300 / k else []
        points += [s - x for x in steps if s - x > (points[-1] if points else 0)] + [s]
        first = (1 + self.q / (k + k**2)) * mp.exp(grown(s) - k * s)
        return first + mp.quad(source, points)

    def frozen_slope(self, s, t):
        """t' where the frozen front stress is t, from its own equation: t' = −κt + ½(1−β)κ(1 + even e^{−2κs})t + drive e^{−κ_2 s}."""
        k, k2 = self.kappa, self.k[1]
        half, even = (1 - self.beta) * k / 2, (1 - k) / (1 + k)
        return (half * (1 + even * mp.exp(-2 * k * s)) - k) * t + self._drive() * mp.exp(-k2 * s)

    def _drive(self):
        k, k2, KT = self.kappa, self.k[1], self.KT
        p = self.beta * k**2 / (k**2 - k2**2)
        return p / (p + (KT - p * (k2 + k**2)) / (k + k**2)) * (k - k2)

    def edge_and_tail(self):
        """t(0), t'(0)/t(0) and 𝒜 of t → 𝒜e^{−κ_2 s}."""
        k, k2, half, drive = self.kappa, self.k[1], (1 - self.beta) * self.kappa / 2, self._drive()
        first = 1 + self.q / (k + k**2)
        return first, self.frozen_slope(mp.mpf(0), first) / first, drive / (k - k2 - half)

    def fitted_length(self):
        """Eq. (58) by labels cra57a–cra58, without any Ψ or A of the Appendix; nan where there is none."""
        first, slope, far = self.edge_and_tail()
        k2, target, over = self.k[1], mp.log(far / first), max(slope, 0)

        def mismatch(x):
            """Label cra57c, in x = ln(κ_3 − max(γ, 0))."""
            k3 = mp.exp(x) + over
            return (1 + k2 / k3) * mp.log((k2 + k3) / (k3 - slope)) - target

        low, high = mp.log(self.kappa) - 30, mp.log(self.kappa) + 30
        if not mismatch(low) > 0 > mismatch(high):
            return mp.nan
        k3 = mp.exp(bisected(mismatch, low, high)) + over
        alpha, C = 1 + k2 / k3, (k2 + slope) / (k3 - slope)
        B = (1 + C) ** alpha * first
        # By = (y + C)^α beyond the edge, y = e^{κ_3 s} = 1, where the left side is the larger
        far_enough = 10 * mp.log(2) / k2 * k3
        return bisected(lambda x: mp.log(B) + x - alpha * mp.log(mp.exp(x) + C), mp.mpf(0), far_enough) / k3


def bisected(function, low, high):
    """Where `function` falls through zero."""
    while high - low > mp.eps * 8 * max(abs(low), abs(high)):
        middle = (low + high) / 2
        low, high = (middle, high) if function(middle) > 0 else (low, middle)
    return (low + high) / 2
