"""Knowledge of the interface stiffness as weighted samples of its logarithm.

Weighted samples represent any distribution: a normal one, one that ends abruptly, or the two roots that one length may have. On
a grid the weights are those of the quadrature, and sums over the samples are integrals.
"""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import ArrayLike

from slippulse_jax.domains import check_domain
from slippulse_jax.front.front import EventKind, check_event
from slippulse_jax.inference.choices import Body
from slippulse_jax.inference.fronts import front_of
from slippulse_jax.inference.likelihood import Problem, make_problem
from slippulse_jax.inference.measurements import MeasurementError, Measurements, check_used
from slippulse_jax.inference.parameters import STIFFNESSES, Parameter, parameter_set

if TYPE_CHECKING:
    from slippulse_jax.inference.fitted import Fitted

NODES = 1201
"""Samples of a grid."""

NEGLIGIBLE = 1e-9
"""Weight, relative to the largest, below which a sample is left out."""

FAINT = 40.0
"""Fall of ln p from its largest beyond which a grid need not be fine."""

VALLEY = 0.5
"""Two peaks of a density count as two roots where it falls between them below this fraction of the lower one."""

UNUSED = (
    "height_sigma", "poisson_sigma", "correlation_length_sigma", "young_sigma", "push_height_sigma",
    "displacement", "displacement_sigma", "force", "force_sigma", "gauges",
)  # fmt: skip
"""Columns of measurements that are left out: inputs are taken as exact, and lengths alone are used."""


@dataclasses.dataclass(frozen=True, eq=False, init=False)
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

    Raises
    ------
    ValueError
        If the shapes differ, a value is not finite, or a weight is negative or all are zero.
    """

    theta: np.ndarray  # (m,) ln(stiffness) of each sample, in increasing order
    probability: np.ndarray  # (m,) of each sample; adds up to one
    labels: np.ndarray  # (m,) root of each sample: 0, 1, …
    in_si: bool
    event: EventKind
    body: Body | None

    def __init__(
        self,
        log_stiffness: ArrayLike,
        weight: ArrayLike | None = None,
        root: ArrayLike | None = None,
        in_si: bool = False,
        event: EventKind = "domino",
        body: Body | None = None,
    ) -> None:
        check_event(event)
        theta = np.atleast_1d(np.asarray(log_stiffness, dtype=np.float64))
        p = np.full(theta.shape, 1.0) if weight is None else np.asarray(weight, dtype=np.float64)
        labels = np.zeros(theta.shape, int) if root is None else np.asarray(root)
        if theta.ndim != 1 or p.shape != theta.shape or labels.shape != theta.shape:
            raise ValueError(
                f"Knowledge: samples {theta.shape}, weights {p.shape} and roots {labels.shape} must be one column each"
            )
        check_domain("Knowledge.log_stiffness", theta, lambda x: abs(x) < 100, "must be the logarithm of a stiffness")
        check_domain("Knowledge.weight", p, lambda x: x >= 0, "must be 0 or more")
        if not p.sum() > 0:
            raise ValueError("Knowledge.weight: all zero")
        order = np.argsort(theta, kind="stable")
        samples = theta[order], p[order] / p.sum(), np.unique(labels[order], return_inverse=True)[1]
        for field, value in zip(dataclasses.fields(self), (*samples, in_si, event, body), strict=True):
            object.__setattr__(self, field.name, value)

    def __len__(self) -> int:
        return len(self.theta)

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
        middle, sd, share = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, np.float64)) for x in (stiffness, log_sd, share)))
        check_domain("stiffness", middle, lambda x: x > 0, "must be positive")
        check_domain("log_sd", sd, lambda x: x > 0, "must be positive: the standard deviation of ln(stiffness)")
        check_domain("share", share, lambda x: x > 0, "must be positive")
        each = max(nodes // len(middle), 3)
        x = np.linspace(-5, 5, each)
        return cls(
            np.concatenate([np.log(k) + s * x for k, s in zip(middle, sd, strict=True)]),
            np.concatenate([p * np.exp(-(x**2) / 2) for p in share]),
            np.repeat(np.arange(len(middle)), each),
            in_si,
        )

    @classmethod
    def from_measurements(
        cls,
        measurements: Measurements,
        *,
        prior: "Knowledge | None" = None,
        bounds: tuple[float, float] | None = None,
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
            Knowledge of the same kind of stiffness, whose samples are weighted by the likelihood, of its `event`. By default
            ln(stiffness) is uniform, and the lengths are those of first fronts.
        bounds : (float, float), optional
            Range of the uniform prior; by default from the softest interface with a precursor up to k/K = 1.
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
        event = "full" if body == "block" else "domino" if prior is None else prior.event
        m = dataclasses.replace(m, **dict.fromkeys(UNUSED))
        problem = make_problem(m, parameter_set(m, [Parameter("stiffness", bounds=bounds)], event, body), "normal", m.sigma)
        theta = _grid(problem, nodes) if prior is None else prior.theta
        # the density, not the weight, has peaks: samples may be unevenly spaced
        share = np.gradient(theta) if prior is None else prior.probability
        with np.errstate(divide="ignore"):
            log_weight = np.log(share) - problem(theta[:, None]).value
        if not np.isfinite(log_weight).any():
            raise ValueError(f"{m.source}: no stiffness in the range gives these measurements")
        weight = np.exp(log_weight - log_weight.max())
        kept = weight > NEGLIGIBLE
        root = prior.labels if prior is not None and prior.labels.any() else _roots(weight / (share if prior is None else 1))
        return cls(theta[kept], weight[kept], root[kept], m.in_si, event, body)

    @classmethod
    def from_fit(cls, result: "Fitted", *, nodes: int = NODES) -> "Knowledge":
        """Take the profile likelihood of the stiffness of a fit.

        With one parameter this is the posterior of `from_measurements`; with several it approximates the marginal posterior.
        Designs take lengths as the fit did, of first fronts or of whole events, of sliders or of blocks.

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
        event = result.parameters.front.event
        if event == "crack":
            raise ValueError("the fit is of crack-like fronts: designs predict self-healing ones only")
        curve = result.curves[asked[0]]
        low = np.flatnonzero(curve.deviance < result.deviance - 2 * np.log(NEGLIGIBLE))
        node = curve.node[max(low[0] - 1, 0) : low[-1] + 2]
        part = np.arange(len(node))
        theta = np.interp(np.linspace(0, part[-1], max(nodes, 2 * len(node))), part, node)
        deviance = PchipInterpolator(curve.node, curve.deviance)(theta)
        density = np.exp((deviance.min() - deviance) / 2)
        return cls(
            theta, density * np.gradient(theta), _roots(density), result.measurements.in_si, event, result.parameters.front.body
        )

    @property
    def mean(self) -> float:
        """Of ln(stiffness)."""
        return float(self.probability @ self.theta)

    @property
    def symbol(self) -> str:
        """Symbol of the stiffness."""
        return "k/λc²" if self.in_si else "k/K"

    @property
    def log_sd(self) -> float:
        """Standard deviation of ln(stiffness), over all roots."""
        return float(np.sqrt(self.probability @ (self.theta - self.mean) ** 2))

    @property
    def roots(self) -> list[tuple[float, float, float]]:
        """(probability, median-like e^mean, standard deviation of ln) of each root."""
        found = []
        for r in range(self.labels.max() + 1):
            w = self.probability * (self.labels == r)
            mean = w @ self.theta / w.sum()
            sd = np.sqrt(w @ (self.theta - mean) ** 2 / w.sum())
            found.append((float(w.sum()), float(np.exp(mean)), float(sd)))
        return found


def _grid(problem: Problem, nodes: int) -> np.ndarray:
    """Choose a grid of the one θ of a problem, finer where its likelihood is."""
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
    """Number the modes, and say which each node belongs to; they are separated by valleys (`VALLEY`)."""
    rises = np.concatenate([[True], density[1:] > density[:-1]])
    falls = np.concatenate([density[:-1] >= density[1:], [True]])
    peaks = np.flatnonzero(rises & falls)
    peaks = peaks[density[peaks] > 1e-3 * density.max()]
    kept: list[int] = []
    cuts: list[int] = []
    for peak in peaks.tolist():
        if kept:
            valley = kept[-1] + int(np.argmin(density[kept[-1] : peak + 1]))
            if density[valley] >= VALLEY * min(density[kept[-1]], density[peak]):
                if density[peak] > density[kept[-1]]:
                    kept = [*kept[:-1], peak]
                continue
            cuts.append(valley)
        kept = [*kept, peak]
    return np.searchsorted(np.array(cuts, dtype=int), np.arange(len(density)), side="right")
