r"""Threshold or prestress along the interface, from lengths of precursors.

Under the hard rule a front that stops at ℓ measures one threshold, θ(ℓ)/θ_0 = t(ℓ), or one weighted mean of the prestress
(docs/fit/profile.md); `slippulse_jax.inference.heterogeneous` follows the fronts.

Between the arrests the profile is assumed smooth: ln(θ/θ_0), or φ, is a Gaussian process of standard deviation s and length
scale L. The unknown u is the profile at its knots, followed by the shift of ln k. Linear data d = μ + G (u − m) + noise of
covariance Σ, and a prior of mean m and covariance K, give with S = G K Gᵀ + Σ and z = d − μ

    mean m + K c, c = Gᵀ S⁻¹ z,   covariance K − K Gᵀ S⁻¹ G K,   resolution R = K Gᵀ S⁻¹ G,   ln evidence −½ zᵀS⁻¹z − ½ ln|2πS|.

The mean is m + R (truth − m) + noise: row i of R is the averaging kernel of knot i, and the trace of R counts the numbers that
the data, rather than the prior, determine. K is never inverted, so it may be singular: pinned, or very smooth. Gauss–Newton
steps find where to linearise, by the derivatives in every contact; s and L are weighted by their evidence, and the posterior is
the mixture.

No place is called determined before two checks: on the recovered profile the events are followed in the order in which the
contacts break, and lengths on profiles drawn from the posterior are compared with the straight lines by which it was found.
"""

import dataclasses
import enum
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float
from scipy.linalg import block_diag
from scipy.special import chdtrc, ndtr

from slippulse_jax.base.domains import check_choice, check_domain, check_whole, real_numbers
from slippulse_jax.base.files import plain
from slippulse_jax.base.shown import plural
from slippulse_jax.inference.heterogeneous import Linearised, ProfileKind, ProfileProblem, followed, profile_problem
from slippulse_jax.inference.parameters import check_used
from slippulse_jax.inference.table.measurements import Measurements

_AMPLITUDES = {"threshold": np.geomspace(0.005, 0.3, 6), "prestress": np.geomspace(0.005, 0.2, 6)}
_LENGTH_SCALES = np.geomspace(0.08, 1.5, 6)  # over the longest length
LEVEL = 0.3  # standard deviation of the unknown mean prestress, in σ_s
ENOUGH = 4  # fewest lengths whose evidence weights the settings; with fewer all have the same weight
KINK = 0.1  # square of the last step, in the prior's standard deviations, below which a search that cannot descend has arrived
WITHIN = 0.4  # largest standard error of a determined place, over the standard deviation by which the prior lets it vary
DRAWS = 400  # profiles drawn from the posterior, on which lengths are simulated
PARTS = 20  # in which the draws are simulated: of equal size, so that they share a compiled program
JITTER = 1e-10  # share of the largest variance added to every variance of a posterior from which profiles are drawn
AGREEMENT = 0.3  # effective share of the draws below which the errors are too rough to call any place determined
ORDER = 0.5  # errors of a measured length by which the order of the breaks may move it


class Determination(enum.Enum):
    """How much of the profile the lengths determine, in a sentence."""

    DETERMINED = "determined between the first and the last arrest"
    PARTLY = "determined in places only"
    AVERAGES = "determined as averages over long stretches only, not place by place"
    UNDERDETERMINED = "under-determined: this is the prior bent to fit, not a measured profile"
    CURVED = "not determined: within its error the lengths do not follow the profile linearly, so that the error is rough"
    ORDER = "not determined: on this profile contacts do not break one after another from the edge on, as was supposed"
    NOT_EXPLAINED = "no smooth profile gives these lengths"
    NOT_CONVERGED = "given up: no smooth profile was found on which every front reaches its arrest"


@dataclasses.dataclass(frozen=True, eq=False)
class RecoveredProfile:
    """Outcome of `recover_profile`. Look at `determination` first.

    `settings` and `nucleation` are NumPy record arrays. Of each event `nucleation` has the ``contact`` that breaks first on the
    recovered profile; ``at_edge``, the probability that this is contact 0, from draws of the posterior; and ``length``, ℓ with
    the most overloaded contact breaking next, in λc.
    """

    kind: ProfileKind
    measurements: Measurements
    position: np.ndarray  # (k,) knots, in λc from the left edge
    profile: np.ndarray  # (k,) θ/θ_0, or φ in σ_s
    stderr: np.ndarray  # (k,) in the same unit
    prior_stderr: np.ndarray  # (k,) `stderr` without the lengths
    covariance: np.ndarray  # (k, k) of ln(θ/θ_0), or of φ
    determined: (
        np.ndarray
    )  # (k,) where, between arrests, the error is at most `WITHIN` of the prior's variation, and was checked
    resolution: np.ndarray  # (k, k) row i is the averaging kernel of knot i, for ln(θ/θ_0) or φ
    fitted: np.ndarray  # (n,) lengths on `profile`, in λc
    chi2: float  # Σ [(fitted − measured)/σ]²
    prior_misfit: float  # fᵀK⁻¹f at the best setting
    settings: np.recarray  # (h,) of the prior: amplitude, length_scale in λc, and weight, the probability of each
    arrest: np.ndarray  # (n,) where each front stopped, in λc; the middle of a contact counted last
    at_arrest: np.ndarray | None  # (n,) threshold θ(ℓ)/θ_0 = t(ℓ) there, from that length alone, given the load
    at_arrest_stderr: np.ndarray | None  # (n,) σ |t' − θ'|
    nucleation: np.recarray  # (n,) starts of the events: contact, at_edge, length
    agreement: float  # effective share of draws from the posterior whose simulated lengths agree with the straight lines
    determination: Determination
    steps: int
    log_stiffness_shift: float  # by which ln k was moved, where it was uncertain
    components: tuple[np.ndarray, np.ndarray]  # (h, k) mean and standard error of ln(θ/θ_0), or of φ, for each of `settings`

    @property
    def degrees(self) -> float:
        """Count the numbers that the lengths determine: trace of the resolution."""
        return float(np.trace(self.resolution))

    def interval(self, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Ends of the interval at each knot, both of shape (k,).

        They are quantiles of the mixture over `settings`, which is no Gaussian.
        """
        low, high = (quantile(share, *self.components, self.settings.weight) for share in ((1 - level) / 2, (1 + level) / 2))
        return (np.exp(low), np.exp(high)) if self.kind == "threshold" else (low, high)

    def at(self, x: ArrayLike) -> np.ndarray:
        """Evaluate the profile at x in λc, constant beyond the knots."""
        return np.interp(real_numbers("x", x), self.position, self.profile)

    @property
    def smoothness(self) -> Any:
        """Setting of most evidence: its amplitude, length_scale and weight."""
        return self.settings[int(np.argmax(self.settings.weight))]

    @property
    def stretches(self) -> list[tuple[float, float]]:
        """Ends, in λc, of the stretches that the lengths determine."""
        inside = np.concatenate([[False], self.determined, [False]])
        edges = np.flatnonzero(inside[1:] != inside[:-1])
        return [(float(self.position[a]), float(self.position[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]

    def report(self) -> str:
        """Report as text."""
        n = len(self.measurements)
        low, high = self.interval()
        where = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in self.stretches) or "nowhere"
        symbol = "θ/θ_0" if self.kind == "threshold" else "φ"
        lines = [
            f"{self.kind.capitalize()} profile from {plural(n, 'length')}: {self.determination.value}",
            f"  independent values that the lengths determine: {self.degrees:.2f}, of {len(self.position)} knots",
            f"  determined (between arrests, error at most {WITHIN} of the prior's, checked by simulation) at x/λc: {where}",
            f"  χ² = {self.chi2:.4g} for {n} lengths; prior misfit {self.prior_misfit:.4g}; {self.steps} steps",
            f"  prior: {self._prior()}",
            f"  {self._starts()}",
            f"  simulated lengths agree with the linear error in {self.agreement:.0%} of draws from the posterior",
        ]
        if self.log_stiffness_shift:
            lines.append(f"  ln k moved by {self.log_stiffness_shift:+.3g}")
        lines.append(f"  {'x/λc':>8} {symbol:>9} {'± se':>9} {'95 % interval':>20} {'prior se':>9}  from")
        length = self.measurements.length
        spaced, arrests = np.linspace(0, length.max(), 6).round(), np.unique(length.round())
        for x in np.unique([*spaced, *arrests] if len(arrests) <= 8 else spaced):
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
        if np.ptp(self.settings.weight) == 0:
            return f"{len(self.settings)} settings, equal weights (too few lengths to choose)"
        return f"{given} of most evidence ({s.weight:.0%}), averaged over {len(self.settings)} settings"

    def _starts(self) -> str:
        """Describe where the events start."""
        contact, at_edge = self.nucleation.contact, self.nucleation.at_edge
        moved = abs(self.nucleation.length - self.fitted).max()
        where = f"contact {contact.min()}" + f" to {contact.max()}" * bool(np.ptp(contact))
        ends = dict.fromkeys(round(share * DRAWS) for share in (at_edge.min(), at_edge.max()))
        sure = " to ".join({0: "none", DRAWS: "all"}.get(count, str(count)) for count in ends)
        text = f"events start at {where} on this profile (contact 0 in {sure} of {DRAWS} draws from the posterior)"
        if contact.any():
            text += f"; the order of the breaks moves ℓ by up to {moved:.2g} λc"
        elif self.kind == "prestress":
            text += "; if they were seen to start inside, do not rely on it"
        return text

    def __str__(self) -> str:
        return self.report()

    def __repr__(self) -> str:
        return f"RecoveredProfile({self.kind}, {self.determination.name}: {self.degrees:.1f} numbers; report() says more)"

    def to_dict(self) -> dict[str, Any]:
        """Plain Python values, ready for JSON; None where not finite."""
        names = ("degrees", "chi2", "prior_misfit", "log_stiffness_shift", "agreement")
        names += ("position", "profile", "stderr", "prior_stderr", "fitted", "settings")
        return plain(
            {
                "kind": self.kind,
                "determination": self.determination.name.lower(),
                "statement": self.determination.value,
                "determined": self.stretches,
                "smoothness": {name: self.smoothness[name] for name in ("amplitude", "length_scale")},
                "nucleation": {name: self.nucleation[name] for name in ("contact", "at_edge", "length")},
                "units": {"position": "λc", "profile": "θ_0" if self.kind == "threshold" else "σ_s", "fitted": "λc"},
                **{name: getattr(self, name) for name in names},
            }
        )


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
    m, of_threshold = measurements, kind == "threshold"
    check_choice("kind", kind, ProfileKind)
    check_domain("log_stiffness_sd", log_stiffness_sd, lambda x: x >= 0, "must be 0 or more")
    for name, value in (("amplitude", amplitude), ("length_scale", length_scale)):
        check_domain(name, 1.0 if value is None else value, lambda x: x > 0, "must be positive")
    check_whole("max_steps", max_steps, 1)
    stiffness = real_numbers("stiffness", stiffness)
    if np.shape(stiffness) not in ((), (1,), (len(m),)):
        wanted = f"one k/K for all, or one for each of {len(m)} measurements"
        raise ValueError(f"stiffness has shape {np.shape(stiffness)}: {wanted}")
    check_used(m, "recover_profile")
    problem = profile_problem(m, kind, stiffness)
    k, level = len(problem.knots), 0.0 if of_threshold else LEVEL
    amplitudes = _AMPLITUDES[kind] if amplitude is None else [amplitude]
    length_scales = _LENGTH_SCALES * problem.measured.max() if length_scale is None else [length_scale]
    settings = np.array([(s, scale) for s in amplitudes for scale in length_scales])
    of_profile = (squared_exponential(problem.knots, *one, level=level, pinned=of_threshold) for one in settings)
    priors = np.array([block_diag(one, log_stiffness_sd**2) for one in of_profile])
    middle = np.append(np.full(k, 0.0 if of_threshold else mean), 0.0)
    found = invert(problem, middle, priors, settings[:, 0], max_steps)
    u, covariance = mixture(found.mean, found.covariance, found.weight)
    covariance, resolution = covariance[:k, :k], np.tensordot(found.weight, found.resolution, 1)[:k, :k]
    prior_variance = found.weight @ np.diagonal(priors, axis1=1, axis2=2)[:, :k]
    # better knowledge of the mean prestress does not determine it at any place
    varying = prior_variance - level**2
    model = problem.linearised(u)
    profile = np.exp(u[:k]) if of_threshold else u[:k]
    unit = profile if of_threshold else 1.0
    error = _stderr(covariance)
    between = (problem.knots >= problem.measured.min()) & (problem.knots <= problem.measured.max())
    determined = between & (error <= WITHIN * np.sqrt(np.maximum(varying, 0))) & (varying > 1e-10)
    nucleation, agreement = _simulated(problem, found, u)
    determination = _judge(problem, found, model.length, determined, between, nucleation.length, agreement)
    determined &= determination in (Determination.DETERMINED, Determination.PARTLY, Determination.AVERAGES)
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
        fitted=model.length,
        chi2=float(problem.chi2(model.length)),
        prior_misfit=found.prior_misfit,
        settings=_table(amplitude=settings[:, 0], length_scale=settings[:, 1], weight=found.weight),
        arrest=problem.measured,
        at_arrest=model.stress if of_threshold else None,
        at_arrest_stderr=problem.sigma * abs(model.slope) if of_threshold else None,
        nucleation=nucleation,
        agreement=agreement,
        determination=determination,
        steps=found.steps,
        log_stiffness_shift=float(u[k]),
        components=(found.mean[:, :k], _stderr(found.covariance)[:, :k]),
    )


def _simulated(problem: ProfileProblem, found: "Posterior", u: np.ndarray) -> tuple[np.recarray, float]:
    """Follow the events on the profile `u` and on posterior draws.

    Return how they nucleate, and how far simulated lengths agree with the straight lines.
    """
    ruptured, contact = followed(*problem.lanes(u), next_break="most overloaded")
    draws = found.draws()
    those = [followed(*problem.lanes(part), next_break="neighbour") for part in np.split(draws, PARTS)]
    length, start = (np.concatenate(column) for column in zip(*those, strict=True))
    linear = found.model.length + (draws - found.at) @ found.model.by_length.T
    with np.errstate(invalid="ignore"):
        chi2, linear_chi2 = problem.chi2(length), problem.chi2(linear)
    log_weight = np.where(np.isfinite(chi2), linear_chi2 - chi2, -np.inf) / 2
    weight = np.exp(log_weight - max(log_weight.max(), -1e300))
    agreement = float(weight.sum() ** 2 / max((weight**2).sum(), 1e-300) / DRAWS)
    return _table(contact=contact, at_edge=(start == 0).mean(axis=0), length=ruptured), agreement


def _table(**columns: np.ndarray) -> np.recarray:
    return np.rec.fromarrays(list(columns.values()), dtype=[(name, x.dtype) for name, x in columns.items()])


def _stderr(covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0))


def _judge(
    problem: ProfileProblem,
    found: "Posterior",
    fitted: np.ndarray,
    determined: np.ndarray,
    between: np.ndarray,
    ruptured: np.ndarray,
    agreement: float,
) -> Determination:
    """Judge how much the lengths determine.

    `determined` are those knots `between` the arrests whose error is small enough.
    """
    if not found.converged:
        return Determination.NOT_CONVERGED
    knots, measured, chi2 = problem.knots, problem.measured, problem.chi2(fitted)
    # equal weights: where no variation is seen, the evidence prefers a stiff prior without being able to determine it
    degrees = np.trace(found.resolution[:, : len(knots), : len(knots)], axis1=1, axis2=2).mean()
    spare = max(len(measured) - degrees, 1.0)
    if not np.isfinite(chi2) or chdtrc(spare, chi2) < 1e-3:
        return Determination.NOT_EXPLAINED
    if degrees < 2:
        return Determination.UNDERDETERMINED
    if not (abs(ruptured - fitted) <= ORDER * problem.sigma).all():
        return Determination.ORDER
    if not determined.any():
        return Determination.AVERAGES
    if agreement < AGREEMENT:
        return Determination.CURVED
    return Determination.DETERMINED if between.any() and determined[between].all() else Determination.PARTLY


# --- inversion -----------------------------------------------------------------------------------------------------------


class Posterior(NamedTuple):
    """Posterior of u under each of h settings of the prior."""

    weight: np.ndarray  # (h,) probability of each setting
    mean: np.ndarray  # (h, k + 1)
    covariance: np.ndarray  # (h, k + 1, k + 1)
    resolution: np.ndarray  # (h, k + 1, k + 1)
    converged: bool
    steps: int
    at: np.ndarray  # (k + 1,) u where the search ended
    model: Linearised  # there
    prior_misfit: float  # (u − m)ᵀK⁻¹(u − m) there

    def draws(self) -> np.ndarray:
        """`DRAWS` of u, the same in every call."""
        rng = np.random.default_rng(0)
        chosen = rng.choice(len(self.weight), DRAWS, p=self.weight)
        draws = rng.standard_normal((DRAWS, self.mean.shape[1]))
        for setting in np.unique(chosen):
            own, covariance = chosen == setting, self.covariance[setting]
            # the covariance is singular to rounding; this makes it positive
            spread = covariance + JITTER * np.diag(covariance).max() * np.eye(len(covariance))
            draws[own] = self.mean[setting] + draws[own] @ np.linalg.cholesky(spread).T
        return draws


def squared_exponential(
    position: Float[np.ndarray, " k"], amplitude: float, length_scale: float, *, level: float = 0.0, pinned: bool = False
) -> Float[np.ndarray, "k k"]:
    """Covariance s² exp[−(x − x')²/2L²] of a smooth function.

    x are positions in λc, s is its amplitude, L its length scale. `level` is the standard deviation of an unknown constant
    added to it; a `pinned` function is known at the first position.
    """
    apart = (position[:, None] - position[None, :]) / length_scale
    kernel = amplitude**2 * np.exp(-(apart**2) / 2) + level**2
    if pinned:
        kernel = kernel - np.outer(kernel[:, 0], kernel[0]) / kernel[0, 0]
    return kernel


def condition(
    z: Float[np.ndarray, " n"],
    design: Float[np.ndarray, "n k"],
    noise: Float[np.ndarray, " n"],
    prior: Float[np.ndarray, "k k"],
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"], Float[np.ndarray, "k k"], float]:
    """Posterior of u − m given linear data z.

    z = G (u − m) + noise. Returns c, of which K c is the mean, covariance, resolution and ln evidence. G is the `design`, K the
    covariance of the `prior`, and `noise` the standard errors of z.
    """
    gain = prior @ design.T
    factor = np.linalg.cholesky(design @ gain + np.diag(noise**2))
    white = np.linalg.solve(factor, gain.T)  # (n, k): covariance removed is whiteᵀ white
    residual = np.linalg.solve(factor, z)
    c = design.T @ np.linalg.solve(factor.T, residual)
    log_evidence = -residual @ residual / 2 - np.log(np.diag(factor)).sum() - len(z) * np.log(2 * np.pi) / 2
    return c, prior - white.T @ white, white.T @ np.linalg.solve(factor, design), float(log_evidence)


def mixture(
    mean: Float[np.ndarray, "h k"], covariance: Float[np.ndarray, "h k k"], weight: Float[np.ndarray, " h"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """Mean and covariance of h distributions of these weights."""
    middle = weight @ mean
    return middle, np.tensordot(weight, covariance, 1) + (weight[:, None] * (mean - middle)).T @ (mean - middle)


def quantile(
    level: float, mean: Float[np.ndarray, "h k"], stderr: Float[np.ndarray, "h k"], weight: Float[np.ndarray, " h"]
) -> Float[np.ndarray, " k"]:
    """Quantile of each of k mixtures of Gaussians, by bisection."""
    width = np.maximum(stderr, 1e-12)
    low, high = (mean - 10 * width).min(axis=0), (mean + 10 * width).max(axis=0)
    for _ in range(60):
        middle = (low + high) / 2
        under = weight @ ndtr((middle - mean) / width) < level
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return (low + high) / 2


def invert(problem: ProfileProblem, middle: np.ndarray, priors: np.ndarray, amplitude: np.ndarray, max_steps: int) -> Posterior:
    """Fit with the setting of most evidence until it stays.

    All settings are weighted where each search ended. The priors have the mean `middle`, shape (k + 1,), and the covariances
    `priors`, shape (h, k + 1, k + 1), one for each setting; `amplitude` are the amplitudes of the settings.
    """
    weight = np.full(len(priors), 1 / len(priors))
    best, total, tried = len(priors) // 2, 0, set()
    while True:
        tried.add(best)
        c, model, steps, converged = _descend(problem, middle, priors[best], max_steps)
        total += steps
        place = priors[best] @ c
        z = problem.measured - model.length + model.by_length @ place
        each = [condition(z, model.by_length, problem.sigma, prior) for prior in priors]
        if len(z) >= ENOUGH:
            # a prior flat in the amplitude: the settings lie evenly along its logarithm
            evidence = np.array([log_evidence for *_, log_evidence in each]) + np.log(amplitude)
            weight = np.exp(evidence - evidence.max())
            weight /= weight.sum()
            best = int(np.argmax(weight))
        if best in tried:
            break
    misfit = float(c @ place)
    own, covariance, resolution, _ = zip(*each, strict=True)
    mean = np.stack([middle + prior @ c for prior, c in zip(priors, own, strict=True)])
    return Posterior(weight, mean, np.stack(covariance), np.stack(resolution), converged, total, middle + place, model, misfit)


def _descend(
    problem: ProfileProblem, middle: np.ndarray, prior: np.ndarray, max_steps: int
) -> tuple[np.ndarray, Linearised, int, bool]:
    """Minimise χ² + (u − m)ᵀK⁻¹(u − m) by descending Gauss–Newton steps.

    u − m = K c. Returns c, the model there, the number of steps, and whether the search arrived.
    """

    def tried(c: np.ndarray) -> tuple[float, np.ndarray, Linearised]:
        model = problem.linearised(middle + prior @ c)
        value = float(problem.chi2(model.length) + c @ prior @ c)
        return (value if np.isfinite(value) else np.inf), c, model

    starts = np.zeros(len(middle)), _by_excess(problem, middle, prior)
    value, c, model = min(map(tried, starts), key=lambda found: found[0])
    for step in range(1, max_steps + 1):
        z = problem.measured - model.length + model.by_length @ (prior @ c)
        move = condition(z, model.by_length, problem.sigma, prior)[0] - c
        size = move @ prior @ move
        for fraction in 0.5 ** np.arange(14):
            trial = tried(c + fraction * move)
            if trial[0] < value:
                break
        else:
            # no lower along the step: rounding if the step is small, else a kink of ℓ at a site
            return c, model, step, bool(size < KINK)
        gained = value - trial[0]
        value, c, model = trial
        if size < 1e-8 or gained < 1e-6:
            return c, model, step, True
    return c, model, max_steps, False


def _by_excess(problem: ProfileProblem, middle: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Start of a search: stress equals threshold at the measured arrests."""
    c = np.zeros(len(middle))
    for _ in range(6):
        model = problem.linearised(middle + prior @ c)
        noise = problem.sigma * np.maximum(abs(model.slope), 1e-4)
        if not np.isfinite(model.excess).all():
            break
        c = condition(model.by_excess @ (prior @ c) - model.excess, model.by_excess, noise, prior)[0]
    return c
