"""The inertial chain in plain NumPy, from its dense stiffness matrix, by leapfrog in its textbook form."""

import numpy as np

from oracles.dense_chain import chain_matrix


def run(slider, sites, dt, steps, damping, friction=None, right="free", extra=None):
    """First precursor of a relaxed chain; `friction` None: self-healing, else crack-like. Positions, pinning, count, energies.

    `extra`: stiffness added to the bond of the upper layer to the right of a site ≥ 1, by site.
    """
    n, q, height = sites, slider[1], slider[0]
    a = chain_matrix(*slider, n, right)
    for i, more in (extra or {}).items():
        a[i : i + 2, i : i + 2] += more * np.array([[1, -1], [-1, 1]])
    held = np.linalg.solve(a, np.eye(2 * n)[0])
    load = 1 / held[n]
    x, pin = held * load, np.zeros(n)
    transverse = 1 / (2 * (1 + slider[2]) * height)
    a[0] = 0
    a[0, 0], a[0, 1], a[0, n] = height + transverse, -height, -transverse
    mass = np.append(np.full(n, height), np.ones(n))
    v, keep = np.zeros(2 * n), np.exp(-damping * dt / 2)
    sliding, count = np.zeros(n, bool), np.zeros(n, int)
    broken = damped = rubbed = 0.0
    sigma_k = 0.0 if friction is None else friction

    def force():
        f = -a @ x
        f[n:] += q * pin
        f[0] = 0
        return f

    def break_those(those):
        nonlocal broken
        t = x[n:] - pin
        broken += q * ((t**2 - sigma_k**2) / 2)[those].sum()
        pin[those] += t[those] - sigma_k
        count[those] += 1
        if friction is not None:
            sliding[those] = True

    break_those(np.arange(n) == 0)
    for _ in range(steps):
        before = (mass * v**2).sum() / 2
        v *= keep
        damped += before - (mass * v**2).sum() / 2
        half = v + dt / 2 * force() / mass
        old = x[n:].copy()
        x = x + dt * half
        moved = np.where(sliding, x[n:] - old, 0)
        pin += moved
        rubbed += q * sigma_k * moved.sum()
        v = half + dt / 2 * force() / mass
        before = (mass * v**2).sum() / 2
        v *= keep
        damped += before - (mass * v**2).sum() / 2
        sliding &= v[n:] > 0
        break_those((x[n:] - pin >= 1) & ~sliding)
    return x, pin, count, (broken, damped, rubbed)
