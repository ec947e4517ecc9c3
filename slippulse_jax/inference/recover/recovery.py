r"""A threshold or prestress that varies along the interface, from the lengths of precursors that stop at different places.

Under the hard rule what a contact gives up as the front passes is the stress it carries, whatever its threshold. So for given
prestress the front stress t(s) does not depend on the thresholds, but for the first, which sets the load, and a front that
stops at ℓ reads one of them:

    θ(ℓ)/θ_0 = t(ℓ),

to within σ |t' − θ'|, and says of the contacts before only that they were weaker than t. A prestress is released all along the
way: t is linear in it, and a length sees a weighted mean of it, with most weight near the arrest (`docs/sensitivity.md`).

Between the readings the profile is what a smooth function would do: ln(θ/θ_0), or φ, is a Gaussian process of standard
deviation s and length scale L (`slippulse_jax.inference.recover.prior`). Gauss–Newton steps, damped so that each descends, go
through the backward recursion's derivatives in every contact; s and L are weighed by their evidence.
"""

import dataclasses
import enum
from typing import Any, NamedTuple, get_args

import numpy as np
from jaxtyping import ArrayLike
from scipy.special import chdtrc, ndtri

from slippulse_jax.inference.measurements import MeasurementError, Measurements
from slippulse_jax.inference.recover.model import Kind, Look, profile_model
from slippulse_jax.inference.recover.prior import Smoothness, mixture
from slippulse_jax.inference.recover.report import report, to_dict
from slippulse_jax.inference.recover.search import LEVEL, Found, Problem, search

MOST_KNOTS = 256
"""Positions at which a profile is described; between them it is a straight line."""

_AMPLITUDES = {"threshold": np.geomspace(0.005, 0.3, 6), "prestress": np.geomspace(0.005, 0.2, 6)}
_LENGTH_SCALES = np.geomspace(0.08, 1.5, 6)  # over the longest length


class Determination(enum.Enum):
    """How much of the profile the lengths determine; the value is what the report says."""

    DETERMINED = "determined between the first and the last arrest"
    PARTLY = "determined in places only"
    AVERAGES = "determined as averages over long stretches only, not place by place"
    UNDERDETERMINED = "under-determined: this is the prior, bent to fit, and not a measured profile"
    NOT_EXPLAINED = "no smooth profile gives these lengths"
    NOT_CONVERGED = "given up: no smooth profile was found that lets every front run to its arrest"


class Readings(NamedTuple):
    """What each length says by itself of the threshold where its front stopped."""

    position: np.ndarray  # (n,), in λc
    value: np.ndarray  # (n,), θ(ℓ)/θ_0 = t(ℓ)
    stderr: np.ndarray  # (n,), σ |t' − θ'|


@dataclasses.dataclass(frozen=True, eq=False)
class RecoveredProfile:
    """Outcome of `recover_profile`. Look at `determination` first."""

    kind: Kind
    measurements: Measurements
    position: np.ndarray  # (k,) knots, in λc from the left edge
    profile: np.ndarray  # (k,) θ/θ_0, or φ in σ_s
    stderr: np.ndarray  # (k,) in the same unit
    prior_stderr: np.ndarray  # (k,) what `stderr` would be without the lengths
    covariance: np.ndarray  # (k, k) of ln(θ/θ_0), or of φ
    determined: np.ndarray  # (k,) where the standard error is at most half of what the prior lets the profile vary
    resolution: np.ndarray  # (k, k) row i is the averaging kernel of knot i, for ln(θ/θ_0) or φ
    fitted: np.ndarray  # (n,) lengths on `profile`, in λc
    chi2: float  # Σ [(fitted − measured)/σ]²
    prior_misfit: float  # fᵀK⁻¹f at the best setting: what the prior objects to
    smoothness: Smoothness  # the setting of most evidence
    settings: list[Smoothness]
    weight: np.ndarray  # (h,) probability of each of `settings`
    readings: Readings | None  # for a threshold
    determination: Determination
    steps: int
    log_stiffness_shift: float  # by which ln k was moved, where it was uncertain

    @property
    def degrees(self) -> float:
        """Numbers determined by the lengths rather than by the prior: the trace of the resolution."""
        return float(np.trace(self.resolution))

    def interval(self, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Ends of the interval at each knot, in the unit of the profile; both of shape (k,)."""
        half = ndtri((1 + level) / 2) * _stderr(self.covariance)
        if self.kind == "threshold":
            return self.profile * np.exp(-half), self.profile * np.exp(half)
        return self.profile - half, self.profile + half

    def at(self, x: ArrayLike) -> np.ndarray:
        """The profile at positions x in λc; beyond the last knot it stays what it is there."""
        return np.interp(np.asarray(x, dtype=np.float64), self.position, self.profile)

    def report(self) -> str:
        """Text to read."""
        return report(self)

    def __str__(self) -> str:
        return self.report()

    def __repr__(self) -> str:
        return f"RecoveredProfile({self.kind}, {self.determination.name}: {self.degrees:.1f} numbers; report() says more)"

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain Python values, ready for JSON."""
        return to_dict(self)


def recover_profile(
    measurements: Measurements,
    *,
    stiffness: ArrayLike,
    kind: Kind = "threshold",
    log_stiffness_sd: float = 0.0,
    mean: float = 0.0,
    amplitude: float | None = None,
    length_scale: float | None = None,
    max_steps: int = 50,
) -> RecoveredProfile:
    """Threshold or prestress along one interface, from first-precursor lengths under several conditions.

    Parameters
    ----------
    measurements : Measurements
        Lengths of precursors on the same interface under sliders of different height, or with different uniform top shear
        (`prestress`). In SI all must have one correlation length. A whole-contact count n stands for n − ½ ± 12^{−1/2}.
    stiffness : array_like, shape () or (n,)
        k/K, known.
    kind : {"threshold", "prestress"}
        What varies: the threshold, relative to that of contact 0 (lengths do not depend on σ_s), or the prestress in σ_s,
        under a uniform threshold of 1 and on top of the `prestress` of the measurements.
    log_stiffness_sd : float
        Standard error of ln k, the same for all measurements; it then widens the profile's.
    mean : float
        Prior mean of a prestress, in σ_s; its standard deviation is `LEVEL`.
    amplitude, length_scale : float, optional
        Standard deviation of the profile about its mean (of ln θ, or of φ in σ_s) and the distance in λc over which it varies.
        Weighed by evidence where not given.
    max_steps : int
        Gauss–Newton steps.

    Returns
    -------
    RecoveredProfile

    Raises
    ------
    ValueError
        If an argument lies outside its domain, or a measurement is no length, naming it.
    """
    m = measurements
    _check(m, kind, log_stiffness_sd, amplitude, length_scale, max_steps)
    measured, sigma = _lengths(m)
    sites = 64 * int(np.ceil((1.3 * (measured + 4 * sigma).max() + 16) / 64))
    model = profile_model(m, kind, np.asarray(stiffness, dtype=np.float64), measured, sites, MOST_KNOTS)
    knots, k = model.knots, len(model.knots)
    middle = np.append(np.full(k, mean if kind == "prestress" else 0.0), 0.0)
    problem = Problem(model, sigma, middle, log_stiffness_sd)
    settings = [
        Smoothness(float(s), float(scale))
        for s in (_AMPLITUDES[kind] if amplitude is None else [amplitude])
        for scale in (_LENGTH_SCALES * measured.max() if length_scale is None else [length_scale])
    ]
    found = search(problem, settings, max_steps)
    mean_u, covariance, resolution = mixture(found.posteriors, found.weight)
    f, covariance, resolution = (problem.mean + mean_u)[:k], covariance[:k, :k], resolution[:k, :k]
    prior_variance = np.sum([w * np.diag(problem.prior(s))[:k] for w, s in zip(found.weight, settings, strict=True)], axis=0)
    # what is learnt of the level of a prestress is not learnt of any place
    varying = prior_variance - (LEVEL**2 if kind == "prestress" else 0)
    at_mean = model.lengths(problem.mean + mean_u)
    fitted = at_mean.value
    chi2 = float((((fitted - measured) / sigma) ** 2).sum())
    profile = np.exp(f) if kind == "threshold" else f
    unit = profile if kind == "threshold" else 1.0
    error = _stderr(covariance)
    determined = (error <= 0.5 * np.sqrt(np.maximum(varying, 0))) & (varying > 1e-10)
    return RecoveredProfile(
        kind=kind,
        measurements=m,
        position=knots,
        profile=profile,
        stderr=error * unit,
        prior_stderr=np.sqrt(prior_variance) * unit,
        covariance=covariance,
        determined=determined,
        resolution=resolution,
        fitted=fitted,
        chi2=chi2,
        prior_misfit=found.prior_misfit,
        smoothness=settings[int(np.argmax(found.weight))],
        settings=settings,
        weight=found.weight,
        readings=_readings(at_mean, measured, sigma) if kind == "threshold" else None,
        determination=_judge(found, chi2, knots, determined, measured),
        steps=found.steps,
        log_stiffness_shift=float(mean_u[k]),
    )


def _check(
    m: Measurements, kind: str, log_stiffness_sd: float, amplitude: float | None, length_scale: float | None, max_steps: int
) -> None:
    if kind not in get_args(Kind):
        raise ValueError(f"kind = {kind!r}: must be one of {', '.join(map(repr, get_args(Kind)))}")
    if not 0 <= log_stiffness_sd < np.inf:
        raise ValueError(f"log_stiffness_sd = {log_stiffness_sd:g}: must be 0 or more")
    for name, value in (("amplitude", amplitude), ("length_scale", length_scale)):
        if value is not None and not 0 < value < np.inf:
            raise ValueError(f"{name} = {value:g}: must be positive")
    if max_steps < 1:
        raise ValueError(f"max_steps = {max_steps}: must be at least 1")
    if m.correlation_length is not None and np.ptp(m.correlation_length) > 1e-9 * m.correlation_length[0]:
        raise MeasurementError(f"{m.source}: several correlation lengths: the lengths are not of one interface")


def _lengths(m: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Lengths and standard errors in λc."""
    if m.length_sigma is None or not np.isfinite(m.length_sigma).all():
        raise MeasurementError(f"{m.source}: a profile needs the standard errors of the lengths")
    kinds = np.array(m.kind)
    whole = kinds == "whole"
    for i in np.flatnonzero(~whole & (kinds != "length")).tolist():
        raise MeasurementError(f"{m.place(i)}: kind {m.kind[i]!r}: a profile takes lengths and whole-contact counts")
    sigma = np.sqrt(m.length_sigma**2 + whole / 12)
    if not (sigma > 0).all():
        raise MeasurementError(f"{m.place(int(np.argmin(sigma)))}: a standard error must be positive")
    return m.length - 0.5 * whole, sigma


def _readings(at: Look, measured: np.ndarray, sigma: np.ndarray) -> Readings:
    """t(ℓ) at the measured ℓ, in θ_0."""
    site = np.arange(at.stress.shape[1])
    value = np.array([np.interp(x, site, t / t[0]) for x, t in zip(measured, at.stress, strict=True)])
    return Readings(measured, value, sigma * abs(at.slope))


def _stderr(covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(np.diag(covariance), 0))


def _judge(found: Found, chi2: float, knots: np.ndarray, determined: np.ndarray, measured: np.ndarray) -> Determination:
    if not found.converged:
        return Determination.NOT_CONVERGED
    # not weighed by evidence: where no variation is seen that prefers a stiff prior, which needs no data
    degrees = np.mean([np.trace(p.resolution[: len(knots), : len(knots)]) for p in found.posteriors])
    spare = max(len(measured) - degrees, 1.0)
    if not np.isfinite(chi2) or chdtrc(spare, chi2) < 1e-3:
        return Determination.NOT_EXPLAINED
    if degrees < 2:
        return Determination.UNDERDETERMINED
    if not determined.any():
        return Determination.AVERAGES
    between = (knots >= measured.min()) & (knots <= measured.max())
    return Determination.DETERMINED if between.any() and determined[between].all() else Determination.PARTLY
