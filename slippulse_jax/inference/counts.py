"""Counts of whole contacts: the set of values under which the model breaks just as many.

A count without an error of its own holds or does not: n contacts are counted where n − 1 < ℓ* ≤ n, one also where no domino
starts. For one fitted parameter the ends of that set are crossings of ℓ* with n − 1 and n, on either side of every peak; with
several measurements it is the intersection. The set is the answer; or there is none, and some counts are at odds.
"""

import numpy as np

from slippulse_jax.inference.likelihood import Problem
from slippulse_jax.inference.profile import Interval, pieces_of
from slippulse_jax.inference.search import first_edges

HALVINGS = 48  # of a bracket of the scan: to rounding


def allowed_by_counts(problem: Problem) -> tuple[list[Interval], list[int]]:
    """Values of the parameter under which every count holds, as pieces in increasing order.

    If there are none: the fewest measurements without which there would be some, by index.

    Between two edges of the scan, which has the peak of every length among them, each length is taken to be monotonic.
    """
    block = problem.blocks[0]
    kind, value = block.data.kind, block.data.value[0]
    edge = first_edges(problem)[0]
    length = problem.predictions(edge[:, None])
    # a count holds between n − 1 and n, a front without arrest from the length it ran past
    limits = [(i, x) for i in range(len(value)) for x in ((value[i] - 1, value[i]) if kind[i] == "whole" else (value[i],))]
    datum = np.array([i for i, _ in limits])
    limit = np.array([x for _, x in limits])
    above = length[:, datum] > limit
    cell, which = np.nonzero(above[1:] != above[:-1])
    low, high = edge[cell], edge[cell + 1]
    rises = above[cell + 1, which]
    rows = np.arange(len(cell))
    for _ in range(HALVINGS if len(cell) else 0):
        middle = (low + high) / 2
        beyond = (problem.predictions(middle[:, None])[rows, datum[which]] > limit[which]) == rises
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    ends = np.unique(np.concatenate([edge[[0, -1]], high]))
    found = problem.predictions(((ends[1:] + ends[:-1]) / 2)[:, None])
    holds = np.where(
        kind == "whole", (found <= value) & ((found > value - 1) | (value <= 1)), found >= value
    )  # fmt: skip
    inside = holds.all(axis=1)
    if not inside.any():
        best = int(np.argmax(holds.sum(axis=1)))
        return [], block.measurement[~holds[best]].tolist()
    starts = np.nonzero(inside & ~np.concatenate([[False], inside[:-1]]))[0]
    stops = np.nonzero(inside & ~np.concatenate([inside[1:], [False]]))[0]
    own = [end for start, stop in zip(starts, stops, strict=True) for end in (float(ends[start]), float(ends[stop + 1]))]
    return pieces_of(own, bool(inside[0]), bool(inside[-1])), []
