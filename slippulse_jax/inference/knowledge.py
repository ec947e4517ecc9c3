"""Knowledge of the interface stiffness, and the information expected from an experiment.

Knowledge is weighted samples of ln(stiffness). They represent any distribution: a normal one, one that ends abruptly, or the
two roots that one length may have. On a grid the weights are those of the quadrature, and sums over the samples are integrals.

An experiment measures a length ℓ(θ) with a normal error σ, or counts whole contacts, ceil(ℓ + error); a front that never stops
is an outcome of its own. Of weighted samples θ_i the expected information (mutual information, in nats) is

    I = Σ_i w_i ∫ dy p(y|θ_i) ln[p(y|θ_i)/p(y)],        p(y) = Σ_i w_i p(y|θ_i),

a one-dimensional quadrature for one experiment. For several, I is the mean of the same logarithm over (θ, y) drawn together:
p(y) being an exact sum over the samples, that estimate has no bias, and scrambled Sobol points give its standard error.
"""

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from jaxtyping import ArrayLike
from scipy.special import logsumexp, ndtri, xlogy

from slippulse_jax.base.choices import EventKind
from slippulse_jax.base.domains import check_choice, check_domain
from slippulse_jax.base.shown import format_number
from slippulse_jax.inference.choices import Body
from slippulse_jax.inference.model.models import front_of
from slippulse_jax.inference.observables import Count, Length
from slippulse_jax.inference.parameters import STIFFNESSES, Parameter, ParameterSet, check_used, checked
from slippulse_jax.inference.search.likelihood import Problem, log_densities, make_problem
from slippulse_jax.inference.table.columns import NUMERIC
from slippulse_jax.inference.table.measurements import MeasurementError, Measurements, converted, numbers, table

if TYPE_CHECKING:
    from slippulse_jax.inference.result.result import FitResult

LengthKind = Literal["length", "whole"]

NODES = 1201  # samples of a grid
NEGLIGIBLE = 1e-9  # weight, relative to the largest, below which a sample is left out
FAINT = 40.0  # fall of ln p from its largest beyond which a grid need not be fine
VALLEY = 0.5  # two peaks of a density are two roots where it falls between them below this fraction of the lower one
REACH = 7.0  # range of the outcomes summed over, in standard errors beyond the lengths
STEP = 0.25  # spacing of the outcomes summed over, in standard errors
SURE = 0.95  # smallest posterior of one root from which the roots count as distinguished
REPLICATES, POINTS = 8, 512  # scrambled Sobol sequences, and points of each

OUTCOMES = {"length": Length(), "whole": Count(sharpest=1e-12)}
"""Observables by the kind of a measurement; a count is its interval itself, and not one blurred as in a fit."""
UNUSED = (*(one for one in NUMERIC if one.endswith("_sigma") and one != "length_sigma"), "displacement", "force", "gauges")
"""Columns of measurements that are left out: inputs are taken as exact, and lengths alone are used."""


@table
class Knowledge:
    """Weighted samples of ln(stiffness).

    Parameters
    ----------
    log_stiffness : array_like, shape (m,)
        ln of k/K, or of the areal stiffness k/λc² in Pa/m where the material is given.
    weight : array_like, shape (m,), optional
        Probabilities, normalised on input; equal by default, as for samples of a Markov chain.
    root : array_like of int, shape (m,), optional
        Root (mode) that each sample belongs to; one for all by default.
    in_si : bool
        Whether the stiffness is areal, in Pa/m.
    event : {"domino", "full"}
        Event whose length is measured, by which `design` predicts: the first front, or the whole event (`precursor_lengths`).
    body : {"slider", "block"}, optional
        What the measurements were made on, where the knowledge comes from some: a design is for no other.
    rebreaks : array_like of bool, shape (r,), optional
        Roots at which the edge contact breaks again before the measured front stops.

    Raises
    ------
    ValueError
        If the shapes differ, a value is not finite, or a weight is negative or all are zero.
    """

    log_stiffness: np.ndarray = converted(converter=numbers)
    weight: np.ndarray = converted(converter=numbers, default=None)
    root: np.ndarray = converted(converter=np.asarray, default=None)
    in_si: bool = False
    event: EventKind = "domino"
    body: Body | None = None
    rebreaks: np.ndarray = converted(converter=np.asarray, default=None)

    def __post_init__(self) -> None:
        check_choice("event", self.event, EventKind)
        theta = numbers(self.log_stiffness, "Knowledge.log_stiffness")
        weight = np.ones(theta.shape) if self.weight is None else numbers(self.weight, "Knowledge.weight")
        root = np.zeros(theta.shape, int) if self.root is None else np.asarray(self.root)
        if theta.ndim != 1 or weight.shape != theta.shape or root.shape != theta.shape:
            raise ValueError(
                f"Knowledge: samples {theta.shape}, weights {weight.shape} and roots {root.shape} must be one column each"
            )
        check_domain("Knowledge.log_stiffness", theta, lambda x: abs(x) < 100, "must be the logarithm of a stiffness")
        check_domain("Knowledge.weight", weight, lambda x: x >= 0, "must be 0 or more")
        if not weight.sum() > 0:
            raise ValueError("Knowledge.weight: all zero")
        order = np.argsort(theta, kind="stable")
        object.__setattr__(self, "log_stiffness", theta[order])
        object.__setattr__(self, "weight", weight[order] / weight.sum())
        object.__setattr__(self, "root", np.unique(root[order], return_inverse=True)[1])
        again = np.zeros(self.root.max() + 1, bool) if self.rebreaks is None else np.asarray(self.rebreaks)
        object.__setattr__(self, "rebreaks", again)

    def __len__(self) -> int:
        return len(self.log_stiffness)

    @classmethod
    def lognormal(
        cls, stiffness: ArrayLike, log_sd: ArrayLike, *, share: ArrayLike = 1.0, in_si: bool = False, nodes: int = NODES
    ) -> "Knowledge":
        """Build from a lognormal distribution, or a mixture of several roots.

        Parameters
        ----------
        stiffness : array_like, shape () or (r,)
            Median of each root: k/K, or Pa/m with `in_si`.
        log_sd : array_like
            Standard deviation of ln(stiffness).
        share : array_like
            Probability of each root, normalised on input.
        in_si : bool
        nodes : int
            Samples of the grid.
        """
        middle = numbers(stiffness, "stiffness", "Pa/m" if in_si else "")
        middle, sd, share = np.broadcast_arrays(middle, numbers(log_sd, "log_sd"), numbers(share, "share"))
        check_domain("stiffness", middle, lambda x: x > 0, "must be positive")
        check_domain("log_sd", sd, lambda x: x > 0, "must be positive: the standard deviation of ln(stiffness)")
        check_domain("share", share, lambda x: x > 0, "must be positive")
        x = np.linspace(-5, 5, max(nodes // len(middle), 3))
        theta, weight = np.log(middle)[:, None] + np.outer(sd, x), np.outer(share, np.exp(-(x**2) / 2))
        return cls(theta.ravel(), weight.ravel(), np.repeat(np.arange(len(middle)), len(x)), in_si)

    @classmethod
    def from_measurements(
        cls,
        measurements: Measurements,
        *,
        prior: "Knowledge | None" = None,
        bounds: tuple[float, float] | None = None,
        event: EventKind | None = None,
        nodes: int = NODES,
    ) -> "Knowledge":
        """Compute the posterior of the stiffness after earlier measurements.

        It is computed on a grid; each mode is a root.

        Parameters
        ----------
        measurements : Measurements
            Lengths, counts and censored lengths. In SI with Young's modulus the stiffness is areal, in Pa/m. Those that say
            where the side is pushed are of whole events of blocks, as in `fit`.
        prior : Knowledge, optional
            Knowledge of the same kind of stiffness, whose samples are weighted by the likelihood. By default ln(stiffness) is
            uniform.
        bounds : (float, float), optional
            Range of the stiffness; of a uniform prior by default from the softest interface with a precursor up to k/K = 1.
        event : {"domino", "full"}, optional
            Event that was measured; by default that of the prior, or the first front.
        nodes : int
            Samples of the grid.

        Raises
        ------
        MeasurementError, ValueError
            If standard errors are missing, the data are in SI without Young's modulus, or no stiffness gives the data.
        """
        m = measurements
        check_used(m, "design")
        if m.in_si and m.young is None:
            raise MeasurementError(f"{m.source}: lengths in SI need young_GPa for an areal stiffness")
        if not np.isfinite(m.sigma).all():
            raise MeasurementError(f"{m.source}: the standard errors of the lengths are needed")
        if prior is not None and prior.in_si != m.in_si:
            raise ValueError("prior: must be of the same kind of stiffness as the measurements: k/K, or areal in Pa/m")
        body = front_of(m).body
        event = "full" if body == "block" else event or ("domino" if prior is None else prior.event)
        m = dataclasses.replace(m, **dict.fromkeys(UNUSED))
        problem = make_problem(m, checked(m, [Parameter("stiffness", bounds=bounds)], event, body))
        theta = _grid(problem, nodes) if prior is None else prior.log_stiffness
        # the density, not the weight, has peaks: samples may be unevenly spaced
        share = np.gradient(theta) if prior is None else prior.weight
        with np.errstate(divide="ignore"):
            log_weight = np.log(share) - problem(theta[:, None]).value
        if prior is not None and bounds is not None:
            log_weight[(np.exp(theta) < bounds[0]) | (np.exp(theta) > bounds[1])] = -np.inf
        if not np.isfinite(log_weight).any():
            raise ValueError(f"{m.source}: no stiffness in the range gives these measurements")
        weight = np.exp(log_weight - log_weight.max())
        kept = weight > NEGLIGIBLE
        root = prior.root if prior is not None and prior.root.any() else _roots(weight / (share if prior is None else 1))
        known = cls(theta[kept], weight[kept], root[kept], m.in_si, event, body)
        return known._marked(problem.parameters, lambda middle: middle[:, None])

    @classmethod
    def from_fit(cls, result: "FitResult", *, nodes: int = NODES) -> "Knowledge":
        """Take the profile likelihood of the stiffness of a fit.

        With one parameter this is the posterior of `from_measurements`; with several it approximates the marginal posterior.
        Designs take lengths as the fit did, of first fronts or of whole events, of sliders or of blocks; after a sequence they
        are of whole events.

        Parameters
        ----------
        result : FitResult
            Of a fit with one stiffness common to all measurements.
        nodes : int
            Samples of the grid, approximately.

        Raises
        ------
        ValueError
            If no stiffness was fitted, or one for each specimen, or the data are in SI without Young's modulus; or the fronts
            are crack-like, which designs do not predict.
        """
        from scipy.interpolate import PchipInterpolator

        asked = [name for name in result.names if name.partition("[")[0] in STIFFNESSES]
        if len(asked) != 1:
            raise ValueError(f"the fit has {len(asked)} stiffnesses ({', '.join(asked)}): one is needed")
        if asked[0] == "areal_stiffness_over_young":
            raise ValueError("the fit is of the areal stiffness over Young's modulus: give young_GPa with the measurements")
        front = result.parameters.front
        if front.event == "crack":
            raise ValueError("the fit is of crack-like fronts: designs predict self-healing ones only")
        curve = result.curves[asked[0]]
        low = np.flatnonzero(curve.deviance < result.deviance - 2 * np.log(NEGLIGIBLE))
        node = curve.node[max(low[0] - 1, 0) : low[-1] + 2]
        part = np.arange(len(node))
        theta = np.interp(np.linspace(0, part[-1], max(nodes, 2 * len(node))), part, node)
        # of nodes that give no such measurements the deviance is inf
        least = np.minimum(curve.deviance, result.deviance + 4 * FAINT)
        deviance = PchipInterpolator(curve.node, least)(theta)
        density = np.exp((deviance.min() - deviance) / 2)
        weight, in_si = density * np.gradient(theta), result.measurements.in_si
        known = cls(theta, weight, _roots(density), in_si, "full" if front.body == "block" else front.event, front.body)
        return known._marked(result.parameters, lambda at: curve.theta[abs(curve.node - at[:, None]).argmin(axis=1)])

    def _marked(self, q: ParameterSet, at: Callable[[np.ndarray], np.ndarray]) -> "Knowledge":
        """Find roots where the edge breaks again, by θ `at` ln k."""
        inputs = q.inputs.at(at(np.log([stiffness for _, stiffness, _ in self.roots])))
        again = q.front.breaks_again(inputs.ravel()).reshape(inputs.poisson.shape).any(axis=1)
        return dataclasses.replace(self, rebreaks=again)

    @property
    def symbol(self) -> str:
        """Symbol of the stiffness."""
        return "k/λc²" if self.in_si else "k/K"

    def __str__(self) -> str:
        return "\n".join([self.statement, *self.notes])

    @property
    def statement(self) -> str:
        """The stiffness at each root, its error, and its probability."""
        unit, several = " Pa/m" * self.in_si, len(self.roots) > 1
        each = [
            f"{format_number(value)}{unit} (ln ± {sd:.2g}{f', {share:.0%}' * several}{'; edge breaks again' * bool(again)})"
            for (share, value, sd), again in zip(self.roots, self.rebreaks, strict=True)
        ]
        return f"{self.symbol} {' or '.join(each)}"

    @property
    def notes(self) -> list[str]:
        """What to do where the edge contact breaks again."""
        if not self.rebreaks.any():
            return []
        whole = 'if whole events were measured, give --event full (event="full")'
        kept, gone = (self.log_stiffness[(self.weight > 0) & (self.rebreaks[self.root] == one)] for one in (False, True))
        if kept.size and kept.max() < gone.min():
            ends = np.exp(kept.min()) / 10, np.exp((kept.max() + gone.min()) / 2)
            low, high = (format_number(end, 2) for end in ends)
            whole = f"leave that root out by --bounds {low} {high} (bounds=({low}, {high})), or {whole}"
        return [f"Where the edge contact breaks again before the front stops, the event goes on: {whole}."]

    @property
    def mean(self) -> float:
        """Of ln(stiffness)."""
        return float(moments(self.log_stiffness, self.weight)[0])

    @property
    def log_sd(self) -> float:
        """Standard deviation of ln(stiffness), over all roots."""
        return float(moments(self.log_stiffness, self.weight)[1])

    @property
    def by_root(self) -> np.ndarray:
        """Weight of each sample in each of r roots, shape (m, r)."""
        return self.weight[:, None] * (self.root[:, None] == np.arange(self.root.max() + 1))

    @property
    def roots(self) -> list[tuple[float, float, float]]:
        """(probability, median-like e^mean, standard deviation of ln) of each root."""
        mean, sd = moments(self.log_stiffness[:, None], self.by_root)
        return list(zip(self.by_root.sum(axis=0).tolist(), np.exp(mean).tolist(), sd.tolist(), strict=True))


def moments(x: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean and standard deviation along the first axis; NaN without weight."""
    x = np.where(weight > 0, x, 0)
    with np.errstate(invalid="ignore"):
        mean = (weight * x).sum(axis=0) / weight.sum(axis=0)
        return mean, np.sqrt((weight * (x - mean) ** 2).sum(axis=0) / weight.sum(axis=0))


def _grid(problem: Problem, nodes: int) -> np.ndarray:
    """Choose a grid of one θ, finer where its likelihood is."""
    theta = np.linspace(problem.parameters.low[0], problem.parameters.high[0], nodes)
    for _ in range(2):
        cost = problem(theta[:, None]).value
        # cells with any weight share the nodes of the next grid, and are seen by it with a neighbour on each side
        near = np.convolve(cost < cost.min() + FAINT, np.ones(5), "same") > 0
        if not 0 < near.sum() <= nodes // 3:
            break
        theta = np.unique(np.interp(np.linspace(0, near.sum() - 1, nodes), np.arange(near.sum()), theta[near]))
    return theta


def _roots(density: np.ndarray) -> np.ndarray:
    """Number the mode of each node; valleys (`VALLEY`) separate them."""
    from scipy.signal import find_peaks  # slow to import, and needed here alone

    with np.errstate(divide="ignore"):
        log = np.pad(np.log(density), 1, constant_values=-np.inf)
    peaks, _ = find_peaks(log, height=log.max() + np.log(1e-3), prominence=-np.log(VALLEY))
    cuts = [first + int(np.argmin(log[first:last])) - 1 for first, last in pairwise(peaks.tolist())]
    return np.searchsorted(np.array(cuts, dtype=int), np.arange(len(density)), side="right")


# --- information ---------------------------------------------------------------------------------------------------------


class Gain(NamedTuple):
    """What experiments are expected to add to the knowledge."""

    information: float  # in nats
    error: float  # of it: of the quadrature, or a standard error
    log_stderr: float  # standard deviation of θ afterwards
    told_apart: float  # probability that one root will have a posterior of `SURE` or more


def log_likelihood(y: np.ndarray, length: np.ndarray, sigma: float, kind: LengthKind) -> np.ndarray:
    """Ln p(y | ℓ) of a fit, without its constant; (n, m).

    Of outcomes y of shape (n,), ∞ where the front did not stop, and lengths of shape (m,); σ may be 0 for counts.
    """
    stops = np.isfinite(y)
    found = np.where(np.isinf(length), 0.0, -np.inf) + np.zeros((len(y), 1))
    found[stops] = log_densities(OUTCOMES[kind], length, y[stops, None], sigma)
    return found


def outcomes(length: np.ndarray, sigma: float, kind: LengthKind, step: float = STEP) -> tuple[np.ndarray, np.ndarray]:
    """Outcomes to sum over, and weights with the density's constant; (n,)."""
    finite = length[np.isfinite(length)]
    y, dy = np.empty(0), np.empty(0)
    if finite.size and kind == "length":
        # only near the lengths, which may lie in clumps far apart
        edges = np.unique(np.floor(finite[:, None] / sigma) + np.arange(-REACH, REACH + 1))
        y = (edges[:, None] + step * np.arange(round(1 / step))).ravel() * sigma
        dy = np.full(len(y), step / np.sqrt(2 * np.pi))
    elif finite.size:
        low, high = np.floor(finite.min() - REACH * sigma), np.ceil(finite.max() + REACH * sigma)
        y = np.arange(max(low, 1), max(high, 1) + 1)
        dy = np.ones(len(y))
    if finite.size < length.size:
        y, dy = np.append(y, np.inf), np.append(dy, 1.0)
    return y, dy


def expected_gain(known: Knowledge, length: np.ndarray, sigma: float, kind: LengthKind) -> Gain:
    """Gain of one experiment, by quadrature over lengths of shape (m,)."""
    information, *afterwards = _quadrature(known, length, sigma, kind, STEP)
    # every other sample of each root, with the probability of the root
    kept = np.sort(np.concatenate([np.flatnonzero(own)[::2] for own in known.by_root.T]))
    root = known.root[kept]
    share, left = (weight.sum(axis=0)[root] for weight in (known.by_root, known.by_root[kept]))
    thin = Knowledge(known.log_stiffness[kept], known.weight[kept] * (share / left), root)
    coarse = _quadrature(thin, length[kept], sigma, kind, STEP), _quadrature(known, length, sigma, kind, 2 * STEP)
    return Gain(information, max(abs(information - other[0]) for other in coarse), *afterwards)


def _quadrature(
    known: Knowledge, length: np.ndarray, sigma: float, kind: LengthKind, step: float
) -> tuple[float, float, float]:
    """Information, later standard deviation of θ, and chance of certainty."""
    y, dy = outcomes(length, sigma, kind, step)
    information = stderr = apart = 0.0
    for part in np.array_split(np.arange(len(y)), max(len(y) * len(length) // 2_000_000, 1)):
        p = np.exp(log_likelihood(y[part], length, sigma, kind))
        total = p @ known.weight
        # outcomes that no sample leads to have no probability
        seen = total > 0
        p, total, dy_seen = p[seen], total[seen], dy[part][seen]
        entropy = xlogy(p, p) @ known.weight - xlogy(total, total)
        information += dy_seen @ entropy
        sd, sure = _afterwards(known, p * known.weight / total[:, None])
        stderr += (dy_seen * total) @ sd
        apart += (dy_seen * total) @ sure
    return float(information), float(stderr), float(apart)


def _afterwards(known: Knowledge, posterior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviation and certainty of posteriors of shape (n, m)."""
    theta = known.log_stiffness - known.weight @ known.log_stiffness
    mean = posterior @ theta
    variance = posterior @ theta**2 - mean**2
    return np.sqrt(np.maximum(variance, 0)), (posterior @ (known.by_root > 0)).max(axis=1) >= SURE


def draw(known: Knowledge, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw truths and errors of experiments, common to all candidates.

    `REPLICATES` independently scrambled Sobol sequences, one after another: the sample that is the truth, shape (n,), and
    standard normal errors, shape (n, steps).
    """
    from scipy.stats.qmc import Sobol

    rng = np.random.default_rng(seed)
    u = np.concatenate([Sobol(steps + 1, rng=rng).random(POINTS) for _ in range(REPLICATES)])
    truth = np.searchsorted(np.cumsum(known.weight), u[:, 0] * (1 - 1e-12))
    return np.minimum(truth, len(known) - 1), ndtri(np.clip(u[:, 1:], 1e-12, 1 - 1e-12))


def log_likelihoods(truth: np.ndarray, noise: np.ndarray, length: np.ndarray, sigma: float, kind: LengthKind) -> np.ndarray:
    """Ln p(y|θ_j) of each draw's outcome and sample j; (n, m)."""
    y = length[truth] + sigma * noise
    if kind == "length":
        return log_likelihood(y, length, sigma, kind)
    # far fewer counts than draws
    counts, own = np.unique(np.maximum(np.ceil(y), 1), return_inverse=True)
    return log_likelihood(counts, length, sigma, kind)[own]


def joint_gain(known: Knowledge, truth: np.ndarray, log_p: np.ndarray) -> Gain:
    """Gain of several experiments, from summed `log_likelihoods`, (n, m)."""
    with np.errstate(divide="ignore"):
        joint = log_p + np.log(known.weight)
    total = np.asarray(logsumexp(joint, axis=1))
    own = log_p[np.arange(len(log_p)), truth]
    means = (own - total).reshape(REPLICATES, -1).mean(axis=1)
    sd, sure = _afterwards(known, np.exp(joint - total[:, None]))
    return Gain(float(means.mean()), float(means.std(ddof=1) / np.sqrt(REPLICATES)), float(sd.mean()), float(sure.mean()))


def greedy(
    known: Knowledge, length: np.ndarray, error: np.ndarray, kind: LengthKind, gains: list[Gain], experiments: int, seed: int
) -> list[tuple[int, Gain]]:
    """Choose experiments one by one, each adding most to those before."""
    best = int(np.argmax([gain.information for gain in gains]))
    sequence, so_far = [(best, gains[best])], 0.0
    if experiments == 1:
        return sequence
    truth, noise = draw(known, experiments, seed)
    for step in range(1, experiments):
        so_far = so_far + log_likelihoods(truth, noise[:, step - 1], length[:, best], error[best], kind)
        columns = zip(length.T, error, strict=True)
        each = (so_far + log_likelihoods(truth, noise[:, step], one, sigma, kind) for one, sigma in columns)
        gains = [joint_gain(known, truth, log_p) for log_p in each]
        best = int(np.argmax([gain.information for gain in gains]))
        sequence.append((best, gains[best]))
    return sequence
