r"""A threshold or prestress that varies along the interface, from the lengths of precursors that stop at different places.

Under the hard rule a contact releases the stress it carries as the front passes, whatever its threshold. So for a given
prestress the front stress t(s) depends on one threshold only, that of contact 0, which sets the load; and a front that stops at
ℓ measures one more:

    θ(ℓ)/θ_0 = t(ℓ),

to within σ |t' − θ'|. Of the contacts before ℓ the length implies only that their thresholds were below t. A prestress is
released all along the way: t is linear in it, and a length determines a weighted mean of it, with most weight near the arrest
(`docs/model/gradients.md`).

The load is that at which the first contact reaches its threshold, contact 0 or another
(`slippulse_jax.inference.recover.model`).

Between the arrests the profile is assumed smooth: ln(θ/θ_0), or φ, is a Gaussian process of standard deviation s and length
scale L (`slippulse_jax.inference.recover.inversion`). The Gauss–Newton steps use the derivatives in every contact; s and L
are weighted by their evidence, and the posterior is the mixture.

Two checks follow, without which no place is called determined: on the recovered profile the events are followed in the order
in which the contacts break, and the lengths on profiles drawn from the posterior are compared with those of the straight lines
by which it was found.
"""

import dataclasses
import enum
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike
from scipy.special import chdtrc

from slippulse_jax.domains import check_choice
from slippulse_jax.inference.measurements import MeasurementError, Measurements, check_used
from slippulse_jax.inference.recover.events import followed, fronts
from slippulse_jax.inference.recover.inversion import LEVEL, Found, Inversion, Smoothness, invert, mixture, quantile
from slippulse_jax.inference.recover.model import Look, ProfileKind, profile_model
from slippulse_jax.inference.recover.report import report, to_dict

MOST_KNOTS = 256
"""Most knots of a profile; between them it is a straight line."""

_AMPLITUDES = {"threshold": np.geomspace(0.005, 0.3, 6), "prestress": np.geomspace(0.005, 0.2, 6)}
_LENGTH_SCALES = np.geomspace(0.08, 1.5, 6)  # over the longest length


WITHIN = 0.4
"""Largest standard error of a determined place, over the standard deviation by which the prior lets the profile vary."""

DRAWS = 400
"""Profiles drawn from the posterior, on which lengths are simulated."""

AGREEMENT = 0.3
"""Effective share of the draws below which the errors are too rough to call any place determined."""

ORDER = 0.5
"""Errors of a measured length by which the order of the breaks may move it."""

JITTER = 1e-10
"""Share of the largest variance added to every variance of a posterior from which profiles are drawn."""

ELEMENTS = 4_000_000
"""Numbers of the largest array of simulated contacts."""


class Determination(enum.Enum):
    """How much of the profile the lengths determine; the value is the sentence of the report."""

    DETERMINED = "determined between the first and the last arrest"
    PARTLY = "determined in places only"
    AVERAGES = "determined as averages over long stretches only, not place by place"
    UNDERDETERMINED = "under-determined: this is the prior bent to fit, not a measured profile"
    CURVED = "not determined: within its error the lengths do not follow the profile linearly, so that the error is rough"
    ORDER = "not determined: on this profile contacts do not break one after another from the edge on, as was supposed"
    NOT_EXPLAINED = "no smooth profile gives these lengths"
    NOT_CONVERGED = "given up: no smooth profile was found on which every front reaches its arrest"


class Nucleation(NamedTuple):
    """Where the events start, and whether it matters; n measurements."""

    contact: np.ndarray  # (n,), the contact that reaches its threshold first, on the recovered profile
    at_edge: np.ndarray  # (n,), probability that it is contact 0: the share of draws from the posterior
    length: np.ndarray  # (n,), ℓ on the recovered profile with the most overloaded contact breaking next, in λc

    @property
    def inside(self) -> bool:
        """Whether an event starts elsewhere than at contact 0."""
        return bool((self.contact > 0).any())


class Readings(NamedTuple):
    """The threshold at each arrest, from that length alone, given the load."""

    position: np.ndarray  # (n,), in λc
    value: np.ndarray  # (n,), θ(ℓ)/θ_0 = t(ℓ)
    stderr: np.ndarray  # (n,), σ |t' − θ'|


@dataclasses.dataclass(frozen=True, eq=False)
class RecoveredProfile:
    """Outcome of `recover_profile`. Look at `determination` first."""

    kind: ProfileKind
    measurements: Measurements
    position: np.ndarray  # (k,) knots, in λc from the left edge
    profile: np.ndarray  # (k,) θ/θ_0, or φ in σ_s
    stderr: np.ndarray  # (k,) in the same unit
    prior_stderr: np.ndarray  # (k,) `stderr` without the lengths
    covariance: np.ndarray  # (k, k) of ln(θ/θ_0), or of φ
    determined: np.ndarray  # (k,) where the error is at most `WITHIN` of what the prior lets the profile vary, and was checked
    resolution: np.ndarray  # (k, k) row i is the averaging kernel of knot i, for ln(θ/θ_0) or φ
    fitted: np.ndarray  # (n,) lengths on `profile`, in λc
    chi2: float  # Σ [(fitted − measured)/σ]²
    prior_misfit: float  # fᵀK⁻¹f at the best setting
    smoothness: Smoothness  # the setting of most evidence
    settings: list[Smoothness]
    weight: np.ndarray  # (h,) probability of each of `settings`
    readings: Readings | None  # for a threshold
    nucleation: Nucleation
    agreement: float  # effective share of draws from the posterior whose simulated lengths agree with the straight lines
    determination: Determination
    steps: int
    log_stiffness_shift: float  # by which ln k was moved, where it was uncertain
    components: tuple[np.ndarray, np.ndarray]  # (h, k) mean and standard error of ln(θ/θ_0), or of φ, for each of `settings`

    @property
    def degrees(self) -> float:
        """Count the numbers that the lengths rather than the prior determine: the trace of the resolution."""
        return float(np.trace(self.resolution))

    def interval(self, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper ends of the interval at each knot, in the unit of the profile; both of shape (k,).

        They are quantiles of the mixture over `settings`, which is no Gaussian.
        """
        low, high = (quantile(share, *self.components, self.weight) for share in ((1 - level) / 2, (1 + level) / 2))
        return (np.exp(low), np.exp(high)) if self.kind == "threshold" else (low, high)

    def at(self, x: ArrayLike) -> np.ndarray:
        """Evaluate the profile at positions x in λc; it is constant beyond the last knot."""
        return np.interp(np.asarray(x, dtype=np.float64), self.position, self.profile)

    def report(self) -> str:
        """Report as text."""
        return report(self)

    def __str__(self) -> str:
        return self.report()

    def __repr__(self) -> str:
        return f"RecoveredProfile({self.kind}, {self.determination.name}: {self.degrees:.1f} numbers; report() says more)"

    def to_dict(self) -> dict[str, Any]:
        """Plain Python values, ready for JSON."""
        return to_dict(self)


def recover_profile(
    measurements: Measurements,
    *,
    stiffness: ArrayLike,
    kind: ProfileKind = "threshold",
    log_stiffness_sd: float = 0.0,
    mean: float = 0.0,
    amplitude: float | None = None,
    length_scale: float | None = None,
    max_steps: int = 50,
) -> RecoveredProfile:
    """Recover threshold or prestress along one interface from first-precursor lengths.

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
        Standard error of ln k, common to all measurements; it adds to that of the profile.
    mean : float
        Prior mean of a prestress, in σ_s; its standard deviation is `LEVEL`.
    amplitude, length_scale : float, optional
        Standard deviation of the profile about its mean (of ln θ, or of φ in σ_s) and the distance in λc over which it varies.
        Averaged over 6 values each, weighted by evidence, where not given: a priori the amplitude is as likely in any equal
        interval, the length scale in any equal ratio.
    max_steps : int
        Gauss–Newton steps.

    Returns
    -------
    RecoveredProfile

    Raises
    ------
    ValueError
        If an argument lies outside its domain, or a measurement is neither a length nor a count.
    """
    m = measurements
    _check(m, kind, log_stiffness_sd, amplitude, length_scale, max_steps)
    measured, sigma = _lengths(m)
    sites = 64 * int(np.ceil((1.3 * (measured + 4 * sigma).max() + 16) / 64))
    model = profile_model(m, kind, np.asarray(stiffness, dtype=np.float64), measured, sites, MOST_KNOTS)
    knots, k = model.knots, len(model.knots)
    middle = np.append(np.full(k, mean if kind == "prestress" else 0.0), 0.0)
    problem = Inversion(model, sigma, middle, log_stiffness_sd)
    settings = [
        Smoothness(float(s), float(scale))
        for s in (_AMPLITUDES[kind] if amplitude is None else [amplitude])
        for scale in (_LENGTH_SCALES * measured.max() if length_scale is None else [length_scale])
    ]
    found = invert(problem, settings, max_steps)
    mean_u, covariance, resolution = mixture(found.posteriors, found.weight)
    f, covariance, resolution = (problem.mean + mean_u)[:k], covariance[:k, :k], resolution[:k, :k]
    prior_variance = np.sum([w * np.diag(problem.prior(s))[:k] for w, s in zip(found.weight, settings, strict=True)], axis=0)
    # better knowledge of the mean prestress does not determine it at any place
    varying = prior_variance - (LEVEL**2 if kind == "prestress" else 0)
    at_mean = model.lengths(problem.mean + mean_u)
    fitted = at_mean.value
    chi2 = float((((fitted - measured) / sigma) ** 2).sum())
    profile = np.exp(f) if kind == "threshold" else f
    unit = profile if kind == "threshold" else 1.0
    error = _stderr(covariance)
    determined = (error <= WITHIN * np.sqrt(np.maximum(varying, 0))) & (varying > 1e-10)
    nucleation, agreement = _simulated(problem, found, problem.mean + mean_u)
    determination = _judge(found, chi2, knots, determined, measured)
    if determination in _FOUND:
        if not (abs(nucleation.length - fitted) <= ORDER * sigma).all():
            determination = Determination.ORDER
        elif agreement < AGREEMENT and determination is not Determination.AVERAGES:
            determination = Determination.CURVED
    determined &= determination in _FOUND
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
        nucleation=nucleation,
        agreement=agreement,
        determination=determination,
        steps=found.steps,
        log_stiffness_shift=float(mean_u[k]),
        components=(
            np.array([problem.mean[:k] + p.mean[:k] for p in found.posteriors]),
            np.array([_stderr(p.covariance)[:k] for p in found.posteriors]),
        ),
    )


_FOUND = (Determination.DETERMINED, Determination.PARTLY, Determination.AVERAGES)


def _simulated(problem: Inversion, found: Found, u: np.ndarray) -> tuple[Nucleation, float]:
    """Follow the events on the profile `u`; compare lengths simulated on draws from the posterior with the straight lines."""
    model, (height, stiffness, poisson) = problem.model, problem.model.lanes
    theta, phi = model.contacts(u)
    event = followed((height, stiffness * np.exp(u[-1]), poisson), theta, phi)
    draws = _draws(problem, found)
    # parts of equal size share a compiled program
    least = theta.size * DRAWS / ELEMENTS
    parts = np.split(draws, next(n for n in range(1, DRAWS + 1) if n >= least and DRAWS % n == 0))
    those = [fronts((height, stiffness * np.exp(part[:, -1:]), poisson), *model.contacts(part)) for part in parts]
    length, start = (np.concatenate(column) for column in zip(*those, strict=True))
    linear = found.at.value + (draws - problem.mean - found.place) @ found.at.derivative.T
    with np.errstate(invalid="ignore"):
        chi2, linear_chi2 = ((((x - model.measured) / problem.sigma) ** 2).sum(axis=1) for x in (length, linear))
    log_weight = np.where(np.isfinite(chi2), linear_chi2 - chi2, -np.inf) / 2
    weight = np.exp(log_weight - max(log_weight.max(), -1e300))
    agreement = float(weight.sum() ** 2 / max((weight**2).sum(), 1e-300) / DRAWS)
    return Nucleation(event.start, (start == 0).mean(axis=0), event.length), agreement


def _draws(problem: Inversion, found: Found) -> np.ndarray:
    """Draws of u from the posterior, shape (DRAWS, k + 1); the same in every call."""
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(found.weight), DRAWS, p=found.weight)
    draws = rng.standard_normal((DRAWS, len(problem.mean)))
    for setting in np.unique(chosen):
        own, posterior = chosen == setting, found.posteriors[setting]
        # the covariance is singular to rounding; this makes it positive
        spread = posterior.covariance + JITTER * np.diag(posterior.covariance).max() * np.eye(len(problem.mean))
        draws[own] = problem.mean + posterior.mean + draws[own] @ np.linalg.cholesky(spread).T
    return draws


def _check(
    m: Measurements, kind: str, log_stiffness_sd: float, amplitude: float | None, length_scale: float | None, max_steps: int
) -> None:
    check_choice("kind", kind, ProfileKind)
    if not 0 <= log_stiffness_sd < np.inf:
        raise ValueError(f"log_stiffness_sd = {log_stiffness_sd:g}: must be 0 or more")
    for name, value in (("amplitude", amplitude), ("length_scale", length_scale)):
        if value is not None and not 0 < value < np.inf:
            raise ValueError(f"{name} = {value:g}: must be positive")
    if max_steps < 1:
        raise ValueError(f"max_steps = {max_steps}: must be at least 1")
    if m.correlation_length is not None and np.ptp(m.correlation_length) > 1e-9 * m.correlation_length[0]:
        raise MeasurementError(f"{m.source}: several correlation lengths: these lengths are not from one interface")


def _lengths(m: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Lengths and standard errors in λc."""
    check_used(m, "recover_profile", stacklevel=4)
    if m.push_height is not None:
        raise MeasurementError(
            f"{m.source}, column {m.columns.get('push_height', 'push_height')}: recover_profile takes sliders"
        )
    if m.length_sigma is None or not np.isfinite(m.length_sigma).all():
        raise MeasurementError(f"{m.source}: recover_profile needs the standard errors of the lengths")
    kinds = np.array(m.kind)
    whole = kinds == "whole"
    for i in np.flatnonzero(~whole & (kinds != "length")).tolist():
        raise MeasurementError(f"{m.place(i)}: kind {m.kind[i]!r}: recover_profile takes lengths and whole-contact counts")
    sigma = np.sqrt(m.length_sigma**2 + whole / 12)
    if not (sigma > 0).all():
        raise MeasurementError(f"{m.place(int(np.argmin(sigma)))}: a standard error must be positive")
    return m.length - 0.5 * whole, sigma


def _readings(at: Look, measured: np.ndarray, sigma: np.ndarray) -> Readings:
    """t(ℓ) at the measured ℓ, in θ_0."""
    site = np.arange(at.stress.shape[1])
    value = np.array([np.interp(x, site, t) for x, t in zip(measured, at.stress, strict=True)])
    return Readings(measured, value, sigma * abs(at.slope))


def _stderr(covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(np.diag(covariance), 0))


def _judge(found: Found, chi2: float, knots: np.ndarray, determined: np.ndarray, measured: np.ndarray) -> Determination:
    if not found.converged:
        return Determination.NOT_CONVERGED
    # equal weights: where no variation is seen, the evidence prefers a stiff prior without being able to determine it
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
