"""What is fitted, and how it becomes the k/K of every measurement."""

import dataclasses

import numpy as np

from slippulse_jax.inference.measurements import MeasurementError, Measurements

STIFFEST = 1.0
"""Largest k/K looked at: a contact stiffer than the block of bulk it is attached to is outside the model."""


@dataclasses.dataclass(frozen=True, eq=False)
class Stiffness:
    """The interface stiffness shared by all measurements, in the units the data allow; fitted as its logarithm.

    The interface has an areal stiffness k/λc². Then k/K = (k/λc²) λc/E for each measurement, with its own λc and E.
    Where E is unknown only the ratio (k/λc²)/E can be had, and where lengths are in λc only k/K itself.
    """

    name: str
    symbol: str
    unit: str
    ratio_per_unit: np.ndarray  # k/K of each measurement for a parameter value of 1
    bounds: tuple[float, float]

    def ratio(self, value: float) -> np.ndarray:
        """k/K of each measurement, shape (n,)."""
        return value * self.ratio_per_unit


def stiffness_parameter(measurements: Measurements, bounds: tuple[float, float] | None = None) -> Stiffness:
    """Parameter for these data; by default from where no domino starts up to k/K = `STIFFEST`.

    Parameters
    ----------
    measurements : Measurements
    bounds : (float, float), optional
        Lowest and highest value of the parameter, in its own unit.
    """
    m = measurements
    if m.correlation_length is None:
        if m.young is not None:
            raise MeasurementError(f"{m.source}: young is given without correlation_length: no areal stiffness can be formed")
        name, symbol, unit, per_unit = "stiffness", "k/K", "", np.ones(len(m))
    elif m.young is None:
        name, symbol, unit, per_unit = "areal_stiffness_over_young", "(k/λc²)/E", "1/m", m.correlation_length
    else:
        name, symbol, unit, per_unit = "areal_stiffness", "k/λc²", "Pa/m", m.correlation_length / m.young
    if bounds is None:
        # far below b = (λc/H)² no neighbour of the edge contact ever breaks: all lengths are zero
        softest = 1e-2 / (2 * (1 + m.poisson) * m.height**3)
        bounds = float((softest / per_unit).min()), float((STIFFEST / per_unit).max())
    low, high = bounds
    if not 0 < low < high < np.inf:
        raise ValueError(f"bounds = ({low:g}, {high:g}) of {name}: must be positive, finite and in increasing order")
    softest, stiffest = (low * per_unit).min(), (high * per_unit).max()
    if softest < 1e-30 or stiffest > 1e3:
        raise ValueError(
            f"bounds = ({low:g}, {high:g}) of {name} mean k/K from {softest:g} to {stiffest:g}: must lie in 1e-30 to 1e3"
        )
    return Stiffness(name, symbol, unit, per_unit, (low, high))
