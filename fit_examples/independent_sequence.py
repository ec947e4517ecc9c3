"""Whole sequences of precursors, in NumPy and SciPy: what the examples' forces and lengths up to sliding are made with.

Imports nothing of the package. The elastic block is that of `independent_block.py`: finite elements in one sparse matrix.
"""

from typing import NamedTuple

import numpy as np

MOST_EVENTS = 2000


class Event(NamedTuple):
    """An event of a sequence: how far it gets, and the force as it begins."""

    length: float  # in contacts; inf where it breaks the last one
    force: float  # on the pusher, over that of friction μF_N


def sequence(push, response, push_lost, lost, friction):
    """Events of a block under a slow push, up to the one that spans it; all contacts start relaxed.

    Arguments are those of `independent_block.precursor`. The push rises until a contact reaches its Coulomb stress, and is held
    while contacts break, the most overloaded next; each lets go of all its stress. By balance of forces, the pusher carries the
    sum of what the contacts carry.
    """
    rate, change = push + friction * push_lost, response + friction * lost
    change = change - np.eye(len(push))
    stress, coulomb, events = np.zeros_like(push), np.zeros_like(push), []
    while len(events) < MOST_EVENTS:
        with np.errstate(divide="ignore", invalid="ignore"):
            rise = np.where(rate > 0, (1 - coulomb) / rate, np.inf)
        j = int(np.argmin(rise))
        stress, coulomb, over = stress + rise[j] * push, coulomb + rise[j] * rate, {}
        force = stress.mean()
        while not over or coulomb.max() >= 1:
            j = j if not over else int(np.argmax(coulomb))
            over.setdefault(j, coulomb[j] - 1)
            released = stress[j]
            stress, coulomb = stress + response[:, j] * released, coulomb + change[:, j] * released
            stress[j] -= released
        last = max(over)
        if last + 1 == len(push):
            return [*events, Event(np.inf, force)]
        beyond = over[last] / (over[last] + 1 - coulomb[last + 1])
        events.append(Event(last + beyond, force))
    raise RuntimeError(f"none of {MOST_EVENTS} events spans the block")


def visible(events, least=1.5):
    """Events that advance the front by more than `least` contacts; what creeps between them is not seen."""
    seen, reached = [], 0.0
    for event in events:
        if event.length > reached + least:
            seen.append(event)
        reached = max(reached, event.length)
    return seen
