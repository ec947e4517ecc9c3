"""The model as a fit sees it: what it predicts at inputs y = (ln H/λc, ln k/K, ν, φ, ε), with derivatives in y.

The length is ℓ*, the exact solution's crossing (`slippulse_jax.exact_lengths`): it has no kinks, starts continuously where
the domino starts, and costs microseconds a lane. What is measured at nucleation is closed in the two lattice modes.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.inference.parameters import WIDTH
from slippulse_jax.lattice import lengths as bulk
from slippulse_jax.lattice.exact_lanes import exact_fronts
from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.rules import SmoothBreak
from slippulse_jax.slider import Slider
from slippulse_jax.status import NotConverged, Outcome

LANES = 256


class Prediction(NamedTuple):
    """Of L lanes; the derivatives are None where they were not asked for, and 0 where there is no length."""

    value: Float[np.ndarray, " L"]
    first: Float[np.ndarray, "L 5"] | None


def lengths(y: Float[np.ndarray, "L c"], order: int, columns: Sequence[int] = range(5)) -> Prediction:
    """ℓ*, in λc: 0 where no domino starts, inf where the front never stops; ℓ_w of a smooth rule where y goes on with ln w.

    Its slopes, in the `columns` of y asked for, are central differences: good to 1e-8 of the larger of slope and length but
    next to run-away and where the domino just starts. A difference takes two lengths, an exact slope the time of more.

    Raises
    ------
    NotConverged
        If the exact solution did not converge somewhere, or a front did not fade; never seen.
    """
    return by_differences(values_of_length, y, columns if order else ())


STEPS = (1e-4, 1e-4, 1e-5, 1e-5, 5e-6, 1e-4, 1e-4, 0)
"""Of the differences in y, ln w or ln x/λc, and the contacts beyond ℓ*; that of ε, which acts multiplied by ℓ*, over H/λc."""


def by_differences(
    values: Callable[[np.ndarray], np.ndarray], y: Float[np.ndarray, "L c"], columns: Sequence[int], size: float = 1.0
) -> Prediction:
    """Values of a model at y and their slopes in `columns`, by central differences, all in one call.

    The steps are `STEPS` times `size`.
    """
    if not len(columns):
        return Prediction(values(y), None)
    # a profile comes to the same inputs from several starts
    y, own = distinct_rows(y)
    shifted = [y]
    steps = np.tile(size * np.array(STEPS[: y.shape[1]]), (len(y), 1))
    steps[:, 4] *= np.exp(-y[:, 0])
    for column in columns:
        for sign in (1, -1):
            moved = y.copy()
            moved[:, column] += sign * steps[:, column]
            # ν = 1/2 is the end of the domain
            moved[:, 2] = np.minimum(moved[:, 2], 0.5)
            shifted.append(moved)
    value, *around = values(np.concatenate(shifted)).reshape(len(shifted), -1)
    first = np.zeros(y.shape)
    for i, column in enumerate(columns):
        up, down = around[2 * i : 2 * i + 2]
        apart = shifted[2 * i + 1][:, column] - shifted[2 * i + 2][:, column]
        # beside the run-away one side has no value
        ends = np.isfinite(up), np.isfinite(down)
        apart = np.where(ends[0] & ends[1], apart, steps[:, column])
        with np.errstate(invalid="ignore"):
            first[:, column] = (np.where(ends[0], up, value) - np.where(ends[1], down, value)) / apart
    first[~np.isfinite(value)] = 0
    return Prediction(value[own], first[own])


def distinct_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows that differ, and which of them each row is: by a number made of a row's bits, ten times as fast as sorting rows."""
    odd = np.random.default_rng(0).integers(2**63, size=rows.shape[1], dtype=np.uint64) * 2 + 1
    _, first, own = np.unique(np.ascontiguousarray(rows).view(np.uint64) @ odd, return_index=True, return_inverse=True)
    if not np.array_equal(rows[first][own], rows):  # two rows of one number: never seen
        different, own = np.unique(rows, axis=0, return_inverse=True)
        return different, own.ravel()
    return rows[first], own


def values_of_length(y: Float[np.ndarray, "L 5"]) -> Float[np.ndarray, " L"]:
    """ℓ* of every lane, in λc, or ℓ_w where y goes on with ln w; raises as `lengths` does."""
    if y.shape[1] > WIDTH:
        found = bulk.lengths(Slider(np.exp(y[:, 0]), np.exp(y[:, 1]), y[:, 2]), rule=SmoothBreak(np.exp(y[:, WIDTH])))
        if np.isnan(found).any():
            where = ", ".join(f"{x:.9g}" for x in y[np.argmax(np.isnan(found))])
            raise NotConverged(f"no length under the smooth rule at (ln H/λc, ln k/K, ν, φ, ε, ln w) = ({where})")
        return found
    lanes = y.T.copy()
    lanes[:2] = np.exp(lanes[:2])
    found, status = exact_fronts(lanes)
    lost = ~np.isin(status, (Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.RUN_AWAY))
    if lost.any():
        where = ", ".join(f"{x:.9g}" for x in lanes[:, np.argmax(lost)])
        why = Outcome(int(status[lost][0])).message
        raise NotConverged(f"no exact length at (H/λc, k/K, ν, φ, ε) = ({where}): {why}")
    return found


def displacements(y: Float[np.ndarray, "L 5"], order: int, columns: Sequence[int] = range(5)) -> Prediction:
    """Displacement of the pushed edge at nucleation, in u_s = f_s/k."""
    del columns  # all five cost nothing here
    return _at_nucleation(0, y, order)


def forces(y: Float[np.ndarray, "L 5"], order: int, columns: Sequence[int] = range(5)) -> Prediction:
    """Driving force at nucleation over that on one contact at its threshold, f_s: all that the contacts carry."""
    del columns
    return _at_nucleation(1, y, order)


def displacement_at(y: Array) -> Array:
    """Displacement of the pushed edge at nucleation at one y, in u_s."""
    return (1 - y[3]) * lattice_modes(Slider(jnp.exp(y[0]), jnp.exp(y[1]), y[2])).load


def force_at(y: Array) -> Array:
    """Driving force at nucleation at one y, in f_s: Σ_i Σ_m C_m r_m^i, a geometric series in each mode."""
    modes = lattice_modes(Slider(jnp.exp(y[0]), jnp.exp(y[1]), y[2]))
    return (1 - y[3]) * (modes.drive / modes.gap).sum()


@jax.jit
def _both_with_slopes(y: Float[Array, "L 5"]) -> tuple[Float[Array, "L 2"], Float[Array, "L 2 5"]]:
    """Displacement and force: one program, since whoever measures one of them mostly measures the other."""

    def both(y: Array) -> Array:
        return jnp.stack([displacement_at(y), force_at(y)])

    return jax.vmap(both)(y), jax.vmap(jax.jacfwd(both))(y)


def _at_nucleation(which: int, y: np.ndarray, order: int) -> Prediction:
    value, first = np.empty(len(y)), np.empty((len(y), 5))
    with jax.enable_x64(True):
        for start in range(0, len(y), LANES):
            part = slice(start, start + LANES)
            chosen = y[part]
            padded = np.concatenate([chosen, np.repeat(chosen[-1:], LANES - len(chosen), axis=0)])
            found, slopes = (np.asarray(x)[: len(chosen), which] for x in _both_with_slopes(padded))
            value[part], first[part] = found, slopes
    return Prediction(value, first if order else None)
