"""The longest precursor any stiffness gives: the ceiling of what a length can tell."""

import numpy as np

from slippulse_jax.inference.forward import lengths
from slippulse_jax.inference.parameters import STIFFNESSES, WIDTH, ParameterSet


def attainable(parameters: ParameterSet, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Longest length each measurement could have at any stiffness searched, in λc, and the k/K where; shapes (n,).

    The other parameters stay as in `theta`.
    """
    y = parameters.inputs(theta)
    longest, where = attainable_of(parameters, theta, np.arange(len(y)), y)
    scale = np.exp(parameters.scale_base["length"] + parameters.scale_slope["length"] @ theta)
    return longest * scale + parameters.offset @ theta, where


def attainable_of(parameters: ParameterSet, theta: np.ndarray, row: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same for inputs `y`, (k, 5 or 6), whose stiffness is that of the measurements `row`; in true λc, without offset."""
    reach = np.repeat(y[:, 1:2], 2, axis=1)
    for i, one in enumerate(parameters.free):
        if one.name in STIFFNESSES:
            on = parameters.slope[row, 1, i] != 0
            reach[on] = y[on, 1:2] + np.array([parameters.low[i], parameters.high[i]]) - theta[i]
    # of the hard rule: under a smooth one the length of a front on soft contacts grows without meaning
    distinct, own = np.unique(np.column_stack([y[:, :WIDTH], reach]), axis=0, return_inverse=True)
    longest, where = longest_over(distinct[:, :WIDTH], distinct[:, -2], distinct[:, -1])
    return longest[own.ravel()], np.exp(where[own.ravel()])


def longest_over(y: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Maximum of ℓ over ln k/K between `low` and `high`: a scan, then closer scans around its top."""
    best, where = np.empty(len(y)), np.empty(len(y))
    for count in (129, 17, 17, 17, 17):
        grid = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, count)
        lanes = np.repeat(y[:, None, :], count, axis=1)
        lanes[:, :, 1] = grid
        length = lengths(lanes.reshape(-1, 5), 0).value.reshape(grid.shape)
        top = length.argmax(axis=1)
        rows = np.arange(len(y))
        best, where = length[rows, top], grid[rows, top]
        step = (high - low) / (count - 1)
        low, high = np.maximum(where - step, low), np.minimum(where + step, high)
    return best, where
