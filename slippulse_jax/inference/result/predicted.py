"""Curves of a fit: lengths over heights, fields along the interface."""

import dataclasses
import functools
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from slippulse_jax.base.domains import real_numbers
from slippulse_jax.inference.model.inputs import Inputs, Linear
from slippulse_jax.inference.search.intervals import LEVELS

if TYPE_CHECKING:
    from slippulse_jax.inference.result.result import FitResult

Abscissa = Literal["height", "push_height"]
INPUTS: dict[Abscissa, str] = {"height": "log_height", "push_height": "log_push"}
"""Input of the model that varies along a curve, by the column of the table."""


@dataclasses.dataclass(frozen=True, eq=False)
class LengthCurve:
    """Predicted lengths at n heights, as measured, in λc.

    Every number is computed when it is first asked for.
    """

    result: "FitResult"
    theta: np.ndarray  # (p,), or (t, p) for a curve of each
    inputs: Inputs  # a `Linear` each, one entry per height
    scale: Linear  # ln of the factor on the model's lengths
    offset: Linear

    @functools.cached_property
    def length(self) -> np.ndarray:
        """Predicted lengths, shape (n,) or (t, n).

        0 where no domino starts, inf where nothing stops.
        """
        return self._lengths(self.theta)

    @functools.cached_property
    def breaks_again(self) -> np.ndarray:
        """Whether the edge contact breaks again before the front stops."""
        inputs = self.inputs.at(self.theta)
        return self.result.parameters.front.breaks_again(inputs.ravel()).reshape(inputs.poisson.shape)

    @functools.cached_property
    def longest(self) -> np.ndarray:
        """Longest length at any stiffness searched, else as fitted; (n,)."""
        theta = self.result.theta
        longest, _ = self.result.parameters.longest(theta, self.inputs)
        return longest * np.exp(self.scale(theta)) + self.offset(theta)

    @functools.cached_property
    def bands(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Ends of the 95 % band of the best fit, (n,).

        One band for each piece of the interval where one parameter is fitted; of several, one by propagation of their
        errors, or none where their covariance is singular.
        """
        result, level = self.result, LEVELS[-1]
        if result.problem.p == 1:
            free, pieces = result.parameters.free[0], result.intervals[result.names[0]][level]
            each = [np.linspace(free.theta(piece.low), free.theta(piece.high), 25)[:, None] for piece in pieces]
            return [(family.min(axis=0), family.max(axis=0)) for family in map(self._lengths, each)]
        if result.covariance is None or result.parameters.front.drawn:  # one curve is no draw
            return []
        step = 1e-3 * np.sqrt(np.diag(result.covariance))
        middle = self._lengths(result.theta)
        up, down = (self._lengths(result.theta + side * np.diag(step)) for side in (1, -1))
        slope = (up - down) / (2 * step[:, None])
        half = ndtri((1 + level) / 2) * np.sqrt(np.einsum("pn,pq,qn->n", slope, result.covariance, slope))
        return [(np.maximum(middle - half, 0), middle + half)]

    def _lengths(self, theta: np.ndarray) -> np.ndarray:
        inputs = self.inputs.at(theta)
        length = self.result.parameters.front.lengths(inputs.ravel()).reshape(inputs.poisson.shape)
        return length * np.exp(self.scale(theta)) + self.offset(theta)


def curve(
    result: "FitResult", rows: ArrayLike, heights: ArrayLike, theta: np.ndarray | None = None, *, along: Abscissa = "height"
) -> LengthCurve:
    """Predict the lengths of measurements like some of these at other heights.

    Parameters
    ----------
    rows : int or sequence of int
        Measurements that they are like: every other input is the mean of theirs.
    heights : array_like, shape (n,)
        Heights in λc of the table (of ``measurements.unit[0]`` each, in the unit of the table).
    theta : array, shape (p,) or (t, p), optional
        Other θ than those of the best fit, in the order of ``parameters.names``.
    along : {"height", "push_height"}
        Whether `heights` are those of the block, whose push stays at its share of the height, or of the push.

    Returns
    -------
    LengthCurve
        ``length``, ``bands``, ``longest`` in λc of the table, and ``breaks_again``.

    Raises
    ------
    ValueError
        If the measurements state no such height.
    """
    q, at = result.parameters, getattr(result.measurements, along)
    if at is None:
        raise ValueError(f"along = {along!r}: the measurements state no {along}")
    rows, heights = np.atleast_1d(rows), np.atleast_1d(real_numbers("heights", heights))

    def mean(one: Linear) -> Linear:
        return Linear(np.full(len(heights), one.base[rows].mean()), np.tile(one.slope[rows].mean(axis=0), (len(heights), 1)))

    inputs = q.inputs.map(mean)
    inputs.get(INPUTS[along]).base[:] += np.log(heights) - np.log(at[rows]).mean()
    scale, offset = map(mean, q.of_lengths)
    return LengthCurve(result, result.theta if theta is None else theta, inputs, scale, offset)


def groups(result: "FitResult") -> tuple[Abscissa, list[np.ndarray]]:
    """What lengths are drawn against, and which measurements lie on one curve.

    The height of block or push, whichever leaves fewer curves. Measurements on a curve are equal but for that: in the inputs
    fitted, if every curve then has two heights, else in those stated.
    """
    q, m, along = result.parameters, result.measurements, "height"
    if (run := result.main.runs(m)) is not None:
        return along, [np.flatnonzero(run == i) for i in np.unique(run)]
    if m.push_height is not None and q.front.body == "block":
        along = min(INPUTS, key=lambda one: len(alike(result, result.theta, one)))
    found = alike(result, result.theta, along)
    if not all(np.ptp(getattr(m, along)[rows]) > 0 for rows in found):
        stated = [one.prior_mean if one.nuisance else t for one, t in zip(q.free, result.theta, strict=True)]
        found = alike(result, np.array(stated), along)
    return along, found


def alike(result: "FitResult", theta: np.ndarray, apart_from: Abscissa | None = None) -> list[np.ndarray]:
    """Group measurements of equal inputs at θ, apart from a height."""
    inputs, contact = result.parameters.inputs.at(theta), result.measurements.correlation_length
    same = [inputs.get(name) for name in inputs.names if apart_from is None or name != INPUTS[apart_from]]
    keys = np.column_stack([np.round(same, 9).T, np.zeros_like(inputs.poisson) if contact is None else contact])
    _, group = np.unique(keys, axis=0, return_inverse=True)
    return sorted((np.flatnonzero(group.ravel() == g) for g in range(group.max() + 1)), key=lambda rows: rows[0])


def field(result: "FitResult", row: int, observable: str, position: ArrayLike) -> np.ndarray:
    """Predict the slip or stress along the interface after one precursor.

    Parameters
    ----------
    row : int
        Measurement, for which gauges read this.
    observable : {"slip", "stress"}
    position : array_like, shape (n,)
        Distances from the pushed edge, in m.

    Returns
    -------
    array, shape (n,)
        Slip in m, or stress in Pa; inf where the front never stops.

    Raises
    ------
    ValueError
        If no gauge read it.
    """
    q, contact = result.parameters, result.measurements.correlation_length
    x = np.atleast_1d(real_numbers("position", position, "m"))
    read = next((data for data in result.problem.observed if data.observable.name == observable), None)
    if read is None or contact is None or row not in read.measurement:
        raise ValueError(f"no gauge read {observable} in measurement {row}")
    datum = np.flatnonzero(read.measurement == row)[0]
    inputs = read.inputs.at(result.theta).take(np.full(len(x), read.rows[datum]))
    true_contact = np.exp(q.linear(np.zeros(len(contact)), {"correlation_length": 1})(result.theta)[row])
    place = np.log(np.maximum(x / (contact[row] * true_contact), 1e-9))
    found = read.observable.evaluate(q.front, inputs.given(log_position=place))[0]
    return found * np.exp(read.scale(result.theta)[datum])
