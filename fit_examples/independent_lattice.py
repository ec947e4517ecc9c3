"""The model from first principles, in NumPy: what these examples' synthetic data are made with. Imports nothing of the package.

The chain as one dense matrix, one contact broken after another. `make_data.py` of each folder says with which numbers.
"""

import numpy as np


def front_stress(height, stiffness, poisson, *, prestress=0.0, sites=None, most=400):
    """Stress on each contact as the front reaches it, in σ_s, at the load at which the contact at the edge carries 1."""
    sites = max(int(40 * height), 2 * most) if sites is None else sites
    bond = np.diag(np.full(sites - 1, 1.0), 1)
    laplacian = np.diag((bond + bond.T).sum(1)) - bond - bond.T
    K_T, one = 1 / (2 * (1 + poisson) * height), np.eye(sites)
    matrix = np.block([[height * laplacian + K_T * one, -K_T * one], [-K_T * one, laplacian + (K_T + stiffness) * one]])
    matrix[0] = 0
    matrix[0, 0] = 1  # the imposed edge
    wanted = np.concatenate([[0], sites + np.arange(most)])  # the load, and the pinning points the front may reach
    unit = np.zeros((2 * sites, wanted.size))
    unit[wanted, np.arange(wanted.size)] = np.where(wanted == 0, 1, stiffness)
    response = np.linalg.solve(matrix, unit)[sites : sites + most]
    ahead = response[:, 0] * (1 - prestress) / response[0, 0] + prestress
    stress = []
    for s in range(most):
        stress.append(ahead[s])
        ahead = ahead + response[:, 1 + s] * ahead[s]  # contact s breaks, and is pinned where it is
    return np.array(stress)


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
