"""How improbable a measurement is, given what the model predicts: −ln p of each datum with its slope and curvature.

Constants are left out such that a datum the model meets exactly costs nothing: twice the sum is χ² for plain lengths.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr

LOSSES = ("normal", "huber", "student")
HUBER_AT = 1.345
STUDENT_DOF = 4.0
SHARPEST = 1e-3  # λc: what stands for σ = 0 at the ends of an interval, so that the likelihood has a slope there


class Data(NamedTuple):
    """What was measured, n data of R replicates each; R = 1 for the measurements themselves."""

    kind: np.ndarray  # (n,) of "length", "whole", "at_least"
    value: np.ndarray  # (R, n), in λc, m or N/m; the count, or the length run past
    sigma: np.ndarray  # (n,)
    weight: np.ndarray  # (R, n), how often a datum counts
    has_discrepancy: np.ndarray  # (n,), whether the model's own error, relative to the value, adds to σ

    def take(self, lane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and weights of the replicate of each lane, (B, n)."""
        return self.value[lane], self.weight[lane]


class Terms(NamedTuple):
    """−ln p of every datum, shape (B, n), and its derivatives in the prediction μ and in ln of the discrepancy."""

    value: np.ndarray
    slope: np.ndarray  # ∂/∂μ
    curvature: np.ndarray  # ∂²/∂μ², or the positive stand-in for it that robust losses use
    information: np.ndarray  # its expectation under the model
    log_discrepancy_slope: np.ndarray | None
    log_discrepancy_information: np.ndarray | None


@dataclasses.dataclass(frozen=True)
class Loss:
    """What a residual of r standard errors costs.

    "normal" is r²/2; "huber" is linear beyond 1.345 σ, "student" the t distribution with 4 degrees of freedom. Intervals keep
    their own likelihood under every loss.
    """

    name: str = "normal"

    def __post_init__(self) -> None:
        if self.name not in LOSSES:
            raise ValueError(f"loss = {self.name!r}: one of {', '.join(LOSSES)}")

    def __call__(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ρ(r), ψ = ρ' and ψ/r, the weight of a residual."""
        if self.name == "huber":
            near = np.abs(r) <= HUBER_AT
            size = np.where(near, 1, np.abs(r))
            rho = np.where(near, r**2 / 2, HUBER_AT * np.abs(r) - HUBER_AT**2 / 2)
            weight = np.where(near, 1, HUBER_AT / size)
            return rho, weight * r, weight
        if self.name == "student":
            weight = (STUDENT_DOF + 1) / (STUDENT_DOF + r**2)
            return (STUDENT_DOF + 1) / 2 * np.log1p(r**2 / STUDENT_DOF), weight * r, weight
        return r**2 / 2, r, np.ones_like(r)

    @property
    def information(self) -> float:
        """Information of one datum with σ = 1: 1/variance of the estimate, its errors being as the loss supposes."""
        if self.name == "huber":
            slope, variance = _huber_moments()
            return slope**2 / variance
        return (STUDENT_DOF + 1) / (STUDENT_DOF + 3) if self.name == "student" else 1.0

    @property
    def rise(self) -> float:
        """Factor on the rise of −2 ln p at the ends of an interval; not one for Huber's loss, which is not −ln p."""
        if self.name == "huber":
            slope, variance = _huber_moments()
            return variance / slope
        return 1.0


def _huber_moments() -> tuple[float, float]:
    """E ψ' and E ψ² for Gaussian errors."""
    c = HUBER_AT
    inside = 2 * float(ndtr(c)) - 1
    density = float(np.exp(-(c**2) / 2) / np.sqrt(2 * np.pi))
    return inside, inside - 2 * c * density + 2 * c**2 * (1 - float(ndtr(c)))


def terms(mu: np.ndarray, data: Data, lane: np.ndarray, loss: Loss, log_discrepancy: np.ndarray | None) -> Terms:
    """−ln p of every datum.

    Parameters
    ----------
    mu : array, shape (B, n)
        Predictions.
    data : Data
    lane : array of int, shape (B,)
        Which replicate each lane belongs to.
    loss : Loss
    log_discrepancy : array, shape (B,), optional
        ln δ: the model is off by δ times the length, at random, beside σ.
    """
    value, weight = data.take(lane)
    variance = np.broadcast_to(data.sigma**2, mu.shape)
    extra = np.zeros(mu.shape)
    if log_discrepancy is not None:
        extra = np.where(data.has_discrepancy, (np.exp(log_discrepancy)[:, None] * value) ** 2, 0)
    sigma = np.sqrt(variance + extra)
    plain = data.kind == "length"
    columns = [np.zeros(mu.shape) for _ in range(5)]
    if plain.any():
        for column, found in zip(columns, _plain(mu[:, plain], value[:, plain], sigma[:, plain], loss), strict=True):
            column[:, plain] = found
        # the normalisation that a variance which is itself fitted must carry
        columns[0][:, plain] += np.log(sigma[:, plain] / data.sigma[plain])
    if not plain.all():
        counted = ~plain
        low = np.where(data.kind == "whole", value - 1, value)[:, counted]
        high = np.where(data.kind == "whole", value, np.inf)[:, counted]
        soft = np.maximum(sigma[:, counted], SHARPEST)
        for column, found in zip(columns, _interval(mu[:, counted], low, high, soft), strict=True):
            column[:, counted] = found
    cost, slope, curvature, information, by_sigma = (weight * column for column in columns)
    if log_discrepancy is None:
        return Terms(cost, slope, curvature, information, None, None)
    share = extra / sigma**2  # d ln σ / d ln δ
    return Terms(cost, slope, curvature, information, by_sigma * share, weight * 2 * share**2)


def _plain(mu: np.ndarray, value: np.ndarray, sigma: np.ndarray, loss: Loss) -> tuple[np.ndarray, ...]:
    with np.errstate(invalid="ignore", over="ignore"):
        r = (mu - value) / sigma
        rho, psi, weight = loss(r)
    lost = ~np.isfinite(r)
    rho = np.where(lost, np.inf, rho)
    psi, weight, r = (np.where(lost, 0, x) for x in (psi, weight, r))
    return rho, psi / sigma, weight / sigma**2, np.where(lost, 0, loss.information) / sigma**2, 1 - psi * r


def _interval(mu: np.ndarray, low: np.ndarray, high: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, ...]:
    """−ln[Φ((high − μ)/σ) − Φ((low − μ)/σ)]: a length known to lie between `low` and `high`, with a blur σ."""
    endless = np.isinf(mu)
    at = np.where(endless, low + 40 * sigma, mu)
    a, b = (low - at) / sigma, (high - at) / sigma
    # in the upper tail the two tails beyond are subtracted, not two numbers near one
    flip = a > 0
    lower, upper = np.where(flip, -b, a), np.where(flip, -a, b)
    log_upper = log_ndtr(upper)
    log_p = log_upper + np.log1p(-np.exp(np.minimum(log_ndtr(lower) - log_upper, -1e-300)))
    log_density = [-(x**2) / 2 - np.log(2 * np.pi) / 2 - log_p for x in (a, b)]
    at_low, at_high = (np.exp(np.minimum(x, 700)) for x in log_density)
    slope = (at_high - at_low) / sigma
    b_finite = np.where(np.isinf(b), 0, b)
    bend = (b_finite * at_high - a * at_low) / sigma**2 + slope**2
    bend = np.clip(bend, 0, 1 / sigma**2)  # log-concave: between nothing and that of a single edge
    by_sigma = b_finite * at_high - a * at_low
    impossible = endless & np.isfinite(high)
    cost = np.where(impossible, np.inf, np.where(endless, 0, -log_p))
    slope, bend, by_sigma = (np.where(endless, 0, x) for x in (slope, bend, by_sigma))
    return cost, slope, bend, bend, by_sigma
