"""What a fit knows at one point: a root, the model there, and what was measured beside the lengths."""

import dataclasses

import numpy as np

from slippulse_jax.interface import Interface
from slippulse_jax.lattice.lengths import precursor_arrests
from slippulse_jax.slider import Slider


@dataclasses.dataclass(frozen=True, eq=False)
class Root:
    """One minimum of the deviance."""

    value: float  # of the first parameter
    values: dict[str, float]
    chi2: float
    log_stderr: float | None  # standard error of the first θ, which for a positive parameter is its logarithm
    stderrs: dict[str, float | None]
    ratio: np.ndarray  # k/K of each measurement
    rebreaks: np.ndarray  # whether the edge contact would break again before the front stops

    @property
    def stderr(self) -> float | None:
        """Standard error of the first value, in its unit."""
        return next(iter(self.stderrs.values()))


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """The model at the best fit, one entry a measurement."""

    length: np.ndarray  # in λc
    contacts_broken: np.ndarray
    status: np.ndarray  # `Outcome`


@dataclasses.dataclass(frozen=True, eq=False)
class Further:
    """One further observable at the best fit, one entry a datum; in SI."""

    observable: str
    value: np.ndarray
    sigma: np.ndarray
    fitted: np.ndarray
    places: list[str]  # where each was measured, for messages

    @property
    def residuals(self) -> np.ndarray:
        """(fitted − measured)/σ."""
        return (self.fitted - self.value) / self.sigma


def recursion_status(y: np.ndarray) -> np.ndarray:
    """What the recursion says of each front, with its contacts broken one by one."""
    distinct, own = np.unique(y[:, :5], axis=0, return_inverse=True)
    slider = Slider(np.exp(distinct[:, 0]), np.exp(distinct[:, 1]), distinct[:, 2])
    interface = None if not distinct[:, 3:].any() else Interface(prestress=distinct[:, 3], threshold_slope=distinct[:, 4])
    return np.asarray(precursor_arrests(slider, interface=interface).status)[own.ravel()]
