"""Whole sequences of precursors, in NumPy and SciPy: what the examples' forces and lengths up to sliding are made with.

Imports nothing of the package. The elastic block is that of `independent_block.py`: finite elements in one sparse matrix.
"""

from typing import NamedTuple

import numpy as np

MOST_EVENTS, MARCH = 2000, 400


class Event(NamedTuple):
    """An event of a sequence: how far it gets, and the force as it begins."""

    length: float  # in contacts; inf where it breaks the last one
    force: float  # on the pusher, over that of friction μF_N
    left: int = 0  # first contact that breaks


def sequence(*block, **more):
    """Events of a block under a slow push, up to the one that spans it; numbers as of `events_of`."""
    found = []
    for event in events_of(*block, **more):
        found.append(event)
        if np.isinf(event.length):
            return found
    raise RuntimeError(f"none of {MOST_EVENTS} events spans the block")


def events_of(push, response, push_lost, lost, friction, threshold=1.0, ageing=None, residual=0.0):
    """Events of a block under a slow push, one after another; all contacts start relaxed.

    The first four arguments are those of `independent_block.precursor`, `threshold` is that of every contact, `ageing` the
    strength of a contact that has just broken, over that of an old one, and the rise of the push in which it recovers. The push
    rises until a contact reaches its strength, and is held while contacts break, the most overloaded next; each keeps the share
    `residual` of its strength. By balance of forces, the pusher carries the sum of what the contacts carry.
    """
    weak, recovery = ageing or (1.0, 1.0)
    n, load = len(push), 0.0
    stress, relief, broken_at = np.zeros(n), np.zeros(n), np.full(n, -np.inf)

    def strength(rise):
        aged = threshold * (1 - (1 - weak) * np.exp(-(load + rise - broken_at) / recovery))
        return aged * (1 - friction * (relief + rise * push_lost))

    def over(rise):
        return stress + rise * push - strength(rise)

    for _ in range(MOST_EVENTS):
        rise, j = first_crossing(over, push + friction * threshold * push_lost, threshold * (1 - friction * relief) - stress)
        load, stress, relief, first_over = load + rise, stress + rise * push, relief + rise * push_lost, {}
        force, excess = stress.mean(), over(0.0)
        while not first_over or excess.max() >= 0:
            j = j if not first_over else int(np.argmax(excess))
            first_over.setdefault(j, max(excess[j], 0.0))
            released = stress[j] - residual * strength(0.0)[j]
            stress, relief = stress + response[:, j] * released, relief + lost[:, j] * released
            stress[j] -= released
            broken_at[j] = load
            excess = over(0.0)
        last = max(first_over)
        stops = last + first_over[last] / (first_over[last] - excess[last + 1]) if last + 1 < n else np.inf
        yield Event(stops, force, min(first_over))


def first_crossing(over, rate, lacking):
    """Rise at which the first contact reaches its strength, and which it is.

    No later than a contact that has recovered would reach it, at `lacking` over `rate`; by a march to there, and bisection.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        latest = max(np.where(rate > 0, lacking / rate, np.inf).min(), 0.0)
    marched = np.linspace(0, latest * (1 + 1e-12) + 1e-15, MARCH)
    high = int(np.argmax([over(rise).max() >= 0 for rise in marched[1:]])) + 1
    low, high = marched[high - 1], marched[high]
    while high - low > 1e-15 * (1 + high):
        middle = (low + high) / 2
        low, high = (middle, high) if over(middle).max() < 0 else (low, middle)
    return high, int(np.argmax(over(high)))


def visible(events, least=1.5):
    """Events that advance the front by more than `least` contacts; what creeps between them is not seen."""
    seen, reached = [], 0.0
    for event in events:
        if event.length > reached + least:
            seen.append(event)
        reached = max(reached, event.length)
    return seen
