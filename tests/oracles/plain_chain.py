"""An independent program: the chain of the paper as a dense matrix, broken contact by contact. Imports nothing of the package.

Rows and columns: u_t[0…N−1], then u[0…N−1], in units of K. u_t[0] = U is imposed. A semi-infinite right end is the surface block of
a half-line, found by decimation (each step removes every other site), which knows nothing of modes.
"""

import numpy as np


def surface_block(bulk: np.ndarray, coupling: np.ndarray) -> np.ndarray:
    """Effective diagonal block of the first site of a half-line of sites `bulk` joined by `coupling`."""
    surface, inner, left, right = bulk.copy(), bulk.copy(), coupling.copy(), coupling.copy()
    for _ in range(60):
        inverse = np.linalg.inv(inner)
        there, back = left @ inverse @ right, right @ inverse @ left
        surface = surface - there
        inner = inner - there - back
        left, right = left @ inverse @ left, right @ inverse @ right
        if abs(left).max() < 1e-300:
            break
    return surface


def chain_matrix(height, stiffness, poisson, sites, right="semi-infinite"):
    transverse, upper = 1 / (2 * (1 + poisson) * height), height
    n = sites
    dtype = np.result_type(height, stiffness, poisson, float)
    a = np.zeros((2 * n, 2 * n), dtype)
    for layer, bond in ((0, upper), (n, 1.0)):
        for i in range(n - 1):
            a[layer + i, layer + i] += bond
            a[layer + i + 1, layer + i + 1] += bond
            a[layer + i, layer + i + 1] -= bond
            a[layer + i + 1, layer + i] -= bond
        if right == "clamped":
            a[layer + n - 1, layer + n - 1] += bond
    for i in range(n):
        a[i, i] += transverse
        a[n + i, n + i] += transverse + stiffness
        a[i, n + i] -= transverse
        a[n + i, i] -= transverse
    if right == "semi-infinite":
        bulk = np.array([[2 * upper + transverse, -transverse], [-transverse, 2 + transverse + stiffness]], dtype)
        surface = surface_block(bulk, np.diag([upper, 1.0]).astype(dtype))
        last = np.ix_([n - 1, 2 * n - 1], [n - 1, 2 * n - 1])
        a[last] = surface
    a[0] = 0
    a[0, 0] = 1
    return a


def responses(height, stiffness, poisson, sites, right, reach):
    """u of the first `reach` sites, for a unit load, shape (reach,), and for unit pinning points, shape (reach, reach)."""
    a = chain_matrix(height, stiffness, poisson, sites, right)
    rhs = np.zeros((2 * sites, 1 + reach), a.dtype)
    rhs[0, 0] = 1
    rhs[sites + np.arange(reach), 1 + np.arange(reach)] = stiffness
    solution = np.linalg.solve(a, rhs)
    solution += np.linalg.solve(a, rhs - a @ solution)  # one step of refinement
    interface = solution[sites : sites + reach]
    return interface[:, 0], interface[:, 1:]


def interpolated(stress, s0):
    """ℓ for a front whose contacts carried stress[0…s0] as it came to them."""
    return s0 - 1 + (stress[s0 - 1] - 1) / (stress[s0 - 1] - stress[s0])


def front_stress(load, pinning, count):
    """Stress on contacts 0…count−1 as the front comes to each, in units of the threshold."""
    scale = 1 / load[0]
    stress = np.zeros(count, load.dtype)
    for s in range(count):
        stress[s] = scale * load[s] + pinning[s, :s] @ stress[:s]
    return stress


def first_precursor(height, stiffness, poisson, sites=400, right="semi-infinite"):
    """s0, ℓ, load U0 and the largest stress behind the front (and where) at any moment; s0 = sites if it ran through."""
    reach = sites if right != "semi-infinite" else min(sites, 120)
    load, pinning = responses(height, stiffness, poisson, sites, right, reach)
    stress = front_stress(load, pinning, reach)
    below = np.nonzero(stress[1:] < 1)[0]
    if not len(below):
        assert right != "semi-infinite"
        return reach, np.inf, 1 / load[0], None
    s0 = int(below[0]) + 1
    worst = (0.0, 0)
    for s in range(1, s0 + 1):
        broken = np.where(np.arange(reach) < s, stress, 0)
        behind = (load / load[0] + pinning @ broken - broken)[:s]
        worst = max(worst, (float(behind.max()), int(behind.argmax())))
    return s0, interpolated(stress, s0), 1 / load[0], worst
