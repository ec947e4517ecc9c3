"""The model from first principles, in NumPy and SciPy: what these examples' data are made with. Imports nothing of the package.

The chain as one sparse matrix, one contact broken after another. `make_data.py` of each folder says with which numbers.
"""

import numpy as np
from scipy.sparse import block_array, diags_array, eye_array
from scipy.sparse.linalg import splu


def front_stress(height, stiffness, poisson, *, prestress=0.0, sites=None, most=400):
    """Stress on each contact as the front reaches it, in σ_s, at the load at which the contact at the edge carries 1."""
    load, response = responses(height, stiffness, poisson, sites=sites, most=most)
    ahead = load * (1 - prestress) / load[0] + prestress
    stress = []
    for s in range(most):
        stress.append(ahead[s])
        ahead = ahead + response[:, s] * ahead[s]  # contact s breaks, and is pinned where it is
    return np.array(stress)


def responses(height, stiffness, poisson, *, sites=None, most=400):
    """Displacement of the first `most` contacts by that of the edge, and by that of the pinning point of each of them."""
    sites = max(int(40 * height), 2 * most) if sites is None else sites
    bond = diags_array(np.ones(sites - 1), offsets=1, shape=(sites, sites))
    laplacian = diags_array((bond + bond.T) @ np.ones(sites)) - bond - bond.T
    K_T, one = 1 / (2 * (1 + poisson) * height), eye_array(sites)
    matrix = block_array([[height * laplacian + K_T * one, -K_T * one], [-K_T * one, laplacian + (K_T + stiffness) * one]])
    inside, edge = np.ones(2 * sites), np.zeros(2 * sites)
    inside[0], edge[0] = 0, 1  # the imposed edge
    matrix = diags_array(inside) @ matrix + diags_array(edge)
    wanted = np.concatenate([[0], sites + np.arange(most)])  # the load, and the pinning points the front may reach
    unit = np.zeros((2 * sites, wanted.size))
    unit[wanted, np.arange(wanted.size)] = np.where(wanted == 0, 1, stiffness)
    found = splu(matrix.tocsc()).solve(unit)[sites : sites + most]
    return found[:, 0], found[:, 1:]


def length(stress, threshold: "float | np.ndarray" = 1.0):
    """Where the front stress, drawn as straight lines, falls below the threshold, in λc; inf if it does not."""
    excess = stress - threshold
    stopped = np.nonzero(excess[1:] < 0)[0]
    if not stopped.size:
        return np.inf
    s = stopped[0] + 1
    return s - 1 + excess[s - 1] / (excess[s - 1] - excess[s])


def write(path, header, rows, comment):
    """A CSV file whose first line says where the numbers come from."""
    with open(path, "w", encoding="utf-8") as file:
        file.write(f"# {comment}\n{','.join(header)}\n")
        file.writelines(",".join(str(x) for x in row) + "\n" for row in rows)
