"""Write lengths.csv: first precursors of one block, pushed above six heights, by finite elements in NumPy alone.

Imports nothing of the package, and shares the kind of element with it, but no code, mesh or method: biquadratic elements over a
block twelve heights long with a free end, one column of them over each contact, eliminated one after another from that end.
Takes two minutes.
"""

import csv
from pathlib import Path

import numpy as np

AREAL_STIFFNESS, YOUNG, POISSON = 9.0e10, 3.0e9, 0.3  # Pa/m, Pa
HEIGHT, CORRELATION_LENGTH = 10e-3, 50e-6  # m
PUSHED_ABOVE = (1.5e-3, 2e-3, 2.5e-3, 3.2e-3, 4e-3, 5e-3)  # m
ERROR, SEED = 0.02, 2014
LONG, FOLLOWED = 12, 480  # length of the block over its height, and contacts that may break


def graded(length: float, first: float) -> np.ndarray:
    """Edges from 0 to `length`, the first element about so high and each next one 1.35 times as high."""
    count = int(np.ceil(np.log1p(0.35 * length / first) / np.log(1.35)))
    edge = np.cumsum(np.append(0.0, 1.35 ** np.arange(count)))
    return edge * length / edge[-1]


def edges_of(height: float, push: float) -> np.ndarray:
    """Edges of the elements from the interface up, close to each other there and about the lower end of the pusher."""
    below, above = graded(push / 2, 0.4), graded(push / 2, height / 150)
    top = graded(height - push, height / 150)
    return np.concatenate([below[:-1], push - above[:0:-1], push + top])


def element(height: float) -> np.ndarray:
    """Stiffness of a biquadratic element one λc wide, in plane stress, E = 1.

    Its freedoms are u_x and u_y of each of nine nodes, row by row from below.
    """
    at, weight = np.polynomial.legendre.leggauss(3)
    elastic = np.array([[1, POISSON, 0], [POISSON, 1, 0], [0, 0, (1 - POISSON) / 2]]) / (1 - POISSON**2)
    stiffness = np.zeros((18, 18))
    for y, wy in zip(at, weight, strict=True):
        for x, wx in zip(at, weight, strict=True):
            (across, dx), (up, dy) = (
                ((s * (s - 1) / 2, 1 - s * s, s * (s + 1) / 2), (s - 0.5, -2 * s, s + 0.5)) for s in (x, y)
            )
            strain = np.zeros((3, 18))
            strain[0, 0::2] = strain[2, 1::2] = 2 * np.outer(up, dx).ravel()
            strain[1, 1::2] = strain[2, 0::2] = 2 / height * np.outer(dy, across).ravel()
            stiffness += wx * wy * height / 4 * strain.T @ elastic @ strain
    return stiffness


def column(edges: np.ndarray) -> np.ndarray:
    """Stiffness of a column of elements; its freedoms are u_x and u_y upwards of its left, its middle and its right nodes."""
    rows = 2 * len(edges) - 1
    stiffness = np.zeros((3 * rows * 2,) * 2)
    for i, size in enumerate(np.diff(edges)):
        node = np.arange(3)[None, :] * rows + 2 * i + np.arange(3)[:, None]
        freedom = (2 * node[..., None] + np.arange(2)).ravel()
        stiffness[np.ix_(freedom, freedom)] += element(size)
    return stiffness


def responses(height: float, contact: float, push: float) -> tuple[np.ndarray, np.ndarray]:
    """Stretch of the first contacts per unit of the push, and their slip per unit of each pinning point."""
    edges = edges_of(height, push)
    y = np.sort(np.concatenate([edges, (edges[1:] + edges[:-1]) / 2]))
    kept = np.arange(y.size * 2) != 1  # the bottom stays on the track
    m, every = kept.sum(), np.tile(kept, 3)
    mean = np.zeros(3 * m)
    mean[[0, m, 2 * m]] = np.array([1, 4, 1]) / 6  # of u_x over the contact
    K = column(edges)[np.ix_(every, every)] + contact * np.outer(mean, mean)
    left, rest, right = slice(0, m), slice(m, 3 * m), slice(m, 2 * m)  # the last counted within the rest

    beyond, eliminated = np.zeros((m, m)), []
    for _ in range(round(LONG * height)):
        inner = K[rest, rest].copy()
        inner[right, right] += beyond
        eliminated.append(np.linalg.inv(inner))
        beyond = K[left, left] - K[left, rest] @ eliminated[-1] @ K[rest, left]
        del eliminated[:-FOLLOWED]
    eliminated = eliminated[::-1]  # of the columns over the first contacts, from the edge on

    # pinning points pull at their own column; their forces are carried to the side from the last of them on
    force = contact * mean[:, None]
    carried, held = np.zeros((m, FOLLOWED)), []
    for i in range(FOLLOWED)[::-1]:
        own = np.zeros((2 * m, FOLLOWED))
        own[right] = carried
        own[:, i] += force[rest, 0]
        held.append(eliminated[i] @ own)
        carried = -K[left, rest] @ held[-1]
        carried[:, i] += force[left, 0]
    held = held[::-1]

    at = y.repeat(2)[kept]
    pushed = (np.arange(y.size * 2)[kept] % 2 == 0) & (at >= push * (1 - 1e-9))
    free = ~pushed
    side = np.zeros((m, 1 + FOLLOWED))  # under the push, and under each pinning point
    side[pushed, 0] = 1
    load = np.hstack([-beyond[np.ix_(free, pushed)].sum(1, keepdims=True), carried[free]])
    side[free] = np.linalg.solve(beyond[np.ix_(free, free)], load)

    slip = []
    for i in range(FOLLOWED):
        within = -eliminated[i] @ (K[rest, left] @ side)
        within[:, 1:] += held[i]
        slip.append(mean[left] @ side + mean[rest] @ within)
        side = within[right]
    found = np.array(slip)
    return found[:, 0], found[:, 1:]


def precursor(push: np.ndarray, response: np.ndarray) -> float:
    """Length: the most overloaded contact breaks next, the pusher held; a straight line from the last overload to the next."""
    stress, overload = push / push.max(), {}
    while not overload or stress.max() >= 1:
        j = int(np.argmax(stress))
        overload.setdefault(j, stress[j] - 1)
        released = stress[j]
        stress = stress + response[:, j] * released
        stress[j] -= released
    last = max(overload)
    assert last + 1 < push.size, "follow more contacts"
    return last + overload[last] / (overload[last] + 1 - stress[last + 1])


def main() -> None:
    """Write the table."""
    scatter, rows = np.random.default_rng(SEED).standard_normal(len(PUSHED_ABOVE)), []
    for push, error in zip(PUSHED_ABOVE, scatter, strict=True):
        unit = CORRELATION_LENGTH
        found = precursor(*responses(HEIGHT / unit, AREAL_STIFFNESS * unit / YOUNG, push / unit))
        length = found * unit * 1e3
        print(f"pushed above {push * 1e3:g} mm: {length:.4f} mm", flush=True)
        row = (HEIGHT * 1e3, unit * 1e6, POISSON, YOUNG / 1e9, length * (1 + ERROR * error), ERROR * length, push * 1e3)
        rows.append([*(f"{x:.4g}" for x in row), "synthetic"])
    with Path(__file__).with_name("lengths.csv").open("w", encoding="utf-8", newline="") as file:
        file.write("# synthetic: make_data.py, finite elements, areal stiffness 9e10 Pa/m; 2 % errors\n")
        names = "height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm,push_height_mm,provenance"
        csv.writer(file, lineterminator="\n").writerows([names.split(","), *rows])


if __name__ == "__main__":
    main()
