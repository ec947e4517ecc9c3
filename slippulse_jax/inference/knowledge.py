"""Knowledge of the interface: weighted draws of its parameters.

Knowledge is weighted samples of ln(stiffness), each with its own friction and whatever else a fit left open. They represent any
distribution: a normal one, one that ends abruptly, or the two roots that one length may have. On a grid the weights are those
of the quadrature, and sums over the samples are integrals.
"""

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import ArrayLike

from slippulse_jax.base.choices import EventKind
from slippulse_jax.base.domains import check_choice, check_domain
from slippulse_jax.base.shown import format_number
from slippulse_jax.inference.choices import Body
from slippulse_jax.inference.model.models import front_of
from slippulse_jax.inference.parameters import STIFFNESSES, Parameter, ParameterSet, check_used, checked
from slippulse_jax.inference.search.likelihood import Problem, make_problem
from slippulse_jax.inference.table.columns import NUMERIC, converted, numbers, table
from slippulse_jax.inference.table.measurements import MeasurementError, Measurements

if TYPE_CHECKING:
    from slippulse_jax.inference.result.result import FitResult

NODES = 1201  # samples of a grid
NEGLIGIBLE = 1e-9  # weight, relative to the largest, below which a sample is left out
FAINT = 40.0  # fall of ln p from its largest beyond which a grid need not be fine
VALLEY = 0.5  # two peaks of a density are two roots where it falls between them below this fraction of the lower one
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
    more : dict of array_like, shape (m,), optional
        Other parameters of each sample, by name, as they are fitted: "friction", or the logarithm of a "normal_load".

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
    more: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

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
        more = {name: numbers(x, f"Knowledge.more: {name}") for name, x in self.more.items()}
        for name, x in more.items():
            if x.shape != theta.shape:
                raise ValueError(f"Knowledge.more: {name} has shape {x.shape}: one for each of {len(theta)} samples")
        object.__setattr__(self, "more", {name: x[order] for name, x in more.items()})
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

        With one parameter this is the posterior of `from_measurements`; with several it approximates the marginal posterior,
        and each sample has a draw of the others, normal about the profile.

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
        q, front = result.parameters, result.parameters.front
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
        event, j = "full" if front.body == "block" else front.event, q.index(asked[0])
        others = [i for i, one in enumerate(q.free) if i != j and one.label == one.name and not one.nuisance]
        about = np.reshape([np.interp(theta, curve.node, curve.theta[:, i]) for i in others], (-1, len(theta))).T
        if others and result.covariance is not None:
            spread = np.linalg.pinv(np.linalg.pinv(result.covariance)[np.ix_(others, others)])  # of these at one stiffness
            about = about + np.random.default_rng(0).multivariate_normal(0 * about[0], spread, len(theta), method="eigh")
        more = {q.names[i]: np.clip(about[:, k], q.low[i], q.high[i]) for k, i in enumerate(others)}
        held = np.unique(q.inputs.at(result.theta).more.get("residual_strength", 0.0))
        if "residual_strength" not in more and held.any():  # stated, or held
            if held.size > 1:
                raise ValueError("the fit has several values of residual_strength: designs take one for all contacts")
            more["residual_strength"] = np.full(len(theta), held[0])
        known = cls(
            theta, density * np.gradient(theta), _roots(density), result.measurements.in_si, event, front.body, more=more
        )
        return known._marked(q, lambda at: curve.theta[abs(curve.node - at[:, None]).argmin(axis=1)])

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
