r"""A threshold or prestress that varies along the interface, from the lengths of precursors that stop at different places.

Under the hard rule a contact releases the stress it carries as the front passes, whatever its threshold. So for a given
prestress the front stress t(s) depends on one threshold only, that of contact 0, which sets the load; and a front that stops at
ℓ measures one more:

    θ(ℓ)/θ_0 = t(ℓ),

to within σ |t' − θ'|. Of the contacts before ℓ the length implies only that their thresholds were below t. A prestress is
released all along the way: t is linear in it, and a length determines a weighted mean of it, with most weight near the arrest
(`docs/model/gradients.md`).

The load is that at which the first contact reaches its threshold, contact 0 or another
(`slippulse_jax.inference.heterogeneous`).

Between the arrests the profile is assumed smooth: ln(θ/θ_0), or φ, is a Gaussian process of standard deviation s and length
scale L (`slippulse_jax.inference.gaussian`). The Gauss–Newton steps use the derivatives in every contact; s and L
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
from slippulse_jax.files import plain
from slippulse_jax.inference.gaussian import LEVEL, Inversion, Smoothness, invert, mixture, prior_covariance, quantile
from slippulse_jax.inference.heterogeneous import ProfileKind, ProfileProblem, followed, fronts, profile_problem
from slippulse_jax.inference.measurements import MeasurementError, Measurements, check_used

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
    settings: list[Smoothness]
    weight: np.ndarray  # (h,) probability of each of `settings`
    arrest: np.ndarray  # (n,) where each front stopped, in λc; the middle of a contact counted last
    at_arrest: np.ndarray | None  # (n,) threshold θ(ℓ)/θ_0 = t(ℓ) there, from that length alone, given the load
    at_arrest_stderr: np.ndarray | None  # (n,) σ |t' − θ'|
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

    @property
    def smoothness(self) -> Smoothness:
        """Settings of most evidence."""
        return self.settings[int(np.argmax(self.weight))]

    @property
    def stretches(self) -> list[tuple[float, float]]:
        """Ends, in λc, of each stretch of the interface that the lengths determine."""
        inside = np.concatenate([[False], self.determined, [False]])
        edges = np.flatnonzero(inside[1:] != inside[:-1])
        return [(float(self.position[a]), float(self.position[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]

    def report(self) -> str:
        """Report as text."""
        n = len(self.measurements)
        low, high = self.interval(0.95)
        where = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in self.stretches) or "nowhere"
        symbol = "θ/θ_0" if self.kind == "threshold" else "φ"
        lines = [
            f"{self.kind.capitalize()} profile from {n} length{'s' * (n > 1)}: {self.determination.value}",
            f"  independent values that the lengths determine: {self.degrees:.2f}, of {len(self.position)} knots",
            f"  determined (standard error at most 0.4 of the prior's, and checked by simulation) at x/λc: {where}",
            f"  χ² = {self.chi2:.4g} for {n} lengths; prior misfit {self.prior_misfit:.4g}; {self.steps} steps",
            f"  prior: {self._prior()}",
            f"  {self._starts()}",
            f"  simulated lengths agree with the linear error in {self.agreement:.0%} of draws from the posterior",
        ]
        if self.log_stiffness_shift:
            lines.append(f"  ln k moved by {self.log_stiffness_shift:+.3g}")
        lines.append(f"  {'x/λc':>8} {symbol:>9} {'± se':>9} {'95 % interval':>20} {'prior se':>9}  from")
        for x in self._rows():
            i = int(np.argmin(abs(self.position - x)))
            origin = "lengths" if self.determined[i] else "definition" if self.prior_stderr[i] < 1e-6 else "prior"
            lines.append(
                f"  {self.position[i]:8.4g} {self.profile[i]:9.4f} {self.stderr[i]:9.4f} {low[i]:10.4f} {high[i]:9.4f} "
                f"{self.prior_stderr[i]:9.4f}  {origin}"
            )
        if self.kind == "threshold":
            before = "before that it implies only that the contacts broke."
            lines.append(f"  A length determines the threshold where its front stopped; {before}")
        return "\n".join(lines)

    def _prior(self) -> str:
        """Describe the prior."""
        s = self.smoothness
        given = f"amplitude {s.amplitude:.3g}, length scale {s.length_scale:.3g} λc"
        if len(self.settings) == 1:
            return f"{given}, as given"
        if np.ptp(self.weight) == 0:
            return f"{len(self.settings)} settings, equal weights (too few lengths to choose)"
        return f"{given} of most evidence ({self.weight.max():.0%}), averaged over {len(self.settings)} settings"

    def _starts(self) -> str:
        """Describe where the events start."""
        contact, at_edge, length = self.nucleation
        moved = abs(length - self.fitted).max()
        where = f"contact {contact.min()}" + f" to {contact.max()}" * bool(np.ptp(contact))
        sure = f"{at_edge.min():.0%}" + f" to {at_edge.max():.0%}" * bool(np.ptp(at_edge) > 5e-3)
        text = f"events start at {where} on this profile (contact 0 in {sure} of draws from the posterior)"
        if self.nucleation.inside:
            text += f"; the order of the breaks moves ℓ by up to {moved:.2g} λc"
        elif self.kind == "prestress":
            text += "; if they were seen to start inside, do not rely on it"
        return text

    def _rows(self) -> np.ndarray:
        """Positions listed in the report: evenly spaced, and the arrests where they are few."""
        length = self.measurements.length
        arrests = np.unique(length.round())
        return np.unique(np.concatenate([np.linspace(0, length.max(), 6).round(), arrests if len(arrests) <= 8 else []]))

    def __str__(self) -> str:
        return self.report()

    def __repr__(self) -> str:
        return f"RecoveredProfile({self.kind}, {self.determination.name}: {self.degrees:.1f} numbers; report() says more)"

    def to_dict(self) -> dict[str, Any]:
        """Plain Python values, ready for JSON; numbers that are not finite are None."""
        same = ("degrees", "chi2", "prior_misfit", "log_stiffness_shift", "agreement")
        arrays = ("position", "profile", "stderr", "prior_stderr", "fitted")
        content = {
            "kind": self.kind,
            "determination": self.determination.name.lower(),
            "statement": self.determination.value,
            **{name: getattr(self, name) for name in same},
            "determined": self.stretches,
            "smoothness": self.smoothness._asdict(),
            "settings": [{**s._asdict(), "weight": w} for s, w in zip(self.settings, self.weight, strict=True)],
            "nucleation": self.nucleation._asdict(),
            "units": {"position": "λc", "profile": "θ_0" if self.kind == "threshold" else "σ_s", "fitted": "λc"},
            **{name: getattr(self, name) for name in arrays},
        }
        return plain(content)


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
    check_used(m, "recover_profile")
    problem = profile_problem(m, kind, stiffness, mean=mean, log_stiffness_sd=log_stiffness_sd)
    measured, sigma, k = problem.measured, problem.sigma, len(problem.knots)
    settings = [
        Smoothness(float(s), float(scale))
        for s in (_AMPLITUDES[kind] if amplitude is None else [amplitude])
        for scale in (_LENGTH_SCALES * measured.max() if length_scale is None else [length_scale])
    ]
    found = invert(problem, settings, max_steps)
    mean_u, covariance, resolution = mixture(found.posteriors, found.weight)
    u, covariance, resolution = problem.mean + mean_u, covariance[:k, :k], resolution[:k, :k]
    prior_variance = found.weight @ [np.diag(prior_covariance(problem, s))[:k] for s in settings]
    # better knowledge of the mean prestress does not determine it at any place
    varying = prior_variance - (LEVEL**2 if kind == "prestress" else 0)
    at_mean = problem.lengths(u)
    fitted = at_mean.value
    site = np.arange(at_mean.stress.shape[1])
    at_arrest = np.array([np.interp(x, site, t) for x, t in zip(measured, at_mean.stress, strict=True)])
    chi2 = float((((fitted - measured) / sigma) ** 2).sum())
    profile = np.exp(u[:k]) if kind == "threshold" else u[:k]
    unit = profile if kind == "threshold" else 1.0
    error = _stderr(covariance)
    determined = (error <= WITHIN * np.sqrt(np.maximum(varying, 0))) & (varying > 1e-10)
    nucleation, agreement = _simulated(problem, found, u)
    determination = _judge(problem, found, chi2, determined)
    if determination in _FOUND:
        if not (abs(nucleation.length - fitted) <= ORDER * sigma).all():
            determination = Determination.ORDER
        elif agreement < AGREEMENT and determination is not Determination.AVERAGES:
            determination = Determination.CURVED
    determined &= determination in _FOUND
    return RecoveredProfile(
        kind=kind,
        measurements=m,
        position=problem.knots,
        profile=profile,
        stderr=error * unit,
        prior_stderr=np.sqrt(prior_variance) * unit,
        covariance=covariance,
        determined=determined,
        resolution=resolution,
        fitted=fitted,
        chi2=chi2,
        prior_misfit=found.prior_misfit,
        settings=settings,
        weight=found.weight,
        arrest=measured,
        at_arrest=at_arrest if kind == "threshold" else None,
        at_arrest_stderr=sigma * abs(at_mean.slope) if kind == "threshold" else None,
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


def _simulated(problem: ProfileProblem, found: Inversion, u: np.ndarray) -> tuple[Nucleation, float]:
    """Follow the events on the profile `u`; compare lengths simulated on draws from the posterior with the straight lines."""
    theta, phi = problem.contacts(u)
    ruptured, contact = followed(problem.sliders_at(u), theta, phi)
    draws = _draws(problem, found)
    # parts of equal size share a compiled program
    least = theta.size * DRAWS / ELEMENTS
    parts = np.split(draws, next(n for n in range(1, DRAWS + 1) if n >= least and DRAWS % n == 0))
    those = [fronts(problem.sliders_at(part), *problem.contacts(part)) for part in parts]
    length, start = (np.concatenate(column) for column in zip(*those, strict=True))
    linear = found.at.value + (draws - problem.mean - found.place) @ found.at.derivative.T
    with np.errstate(invalid="ignore"):
        chi2, linear_chi2 = ((((x - problem.measured) / problem.sigma) ** 2).sum(axis=1) for x in (length, linear))
    log_weight = np.where(np.isfinite(chi2), linear_chi2 - chi2, -np.inf) / 2
    weight = np.exp(log_weight - max(log_weight.max(), -1e300))
    agreement = float(weight.sum() ** 2 / max((weight**2).sum(), 1e-300) / DRAWS)
    return Nucleation(contact, (start == 0).mean(axis=0), ruptured), agreement


def _draws(problem: ProfileProblem, found: Inversion) -> np.ndarray:
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


def _stderr(covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(np.diag(covariance), 0))


def _judge(problem: ProfileProblem, found: Inversion, chi2: float, determined: np.ndarray) -> Determination:
    """Say how much the lengths determine, before the events are followed."""
    if not found.converged:
        return Determination.NOT_CONVERGED
    knots, measured = problem.knots, problem.measured
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
