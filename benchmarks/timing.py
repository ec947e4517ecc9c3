"""Times of functions that are compared, in s."""

import time
from collections.abc import Callable


def seconds(function: Callable[[], object]) -> float:
    """Time of one run in s."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def in_turns(functions: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Times of each in s, in turns, so that a busy moment of the machine falls on all alike; compiled before."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for turn in range(repeats + 1):
        for name, function in functions.items():
            taken = seconds(function)
            if turn:
                times[name].append(taken)
    return times


def side_by_side(functions: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Shortest time of each in s."""
    return {name: min(taken) for name, taken in in_turns(functions, repeats).items()}
