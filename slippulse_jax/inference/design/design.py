r"""Rank candidate experiments by their expected information about the stiffness.

Two measures side by side. The **expected information** is Bayesian and global: it accounts for several roots, for a length
that saturates, and for a front that never stops (`information`). The **D-optimal** gain is local: with
J = dℓ/d ln k, s the standard deviation of ln k within a root and σ the error of the length,

    D = E[ ½ ln(1 + s²J²/σ²) ],

the information if ℓ were linear about each sample. They agree where ℓ is linear over the prior. Where the first is large and
the second small, the candidate distinguishes roots; where both are small, it lies on the plateau of Λ/H.
"""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from slippulse_jax.block import Control, Push, has_push
from slippulse_jax.domains import POISSON, PRESTRESS, THRESHOLD_SLOPE, check_choice, check_domain
from slippulse_jax.front.front import EventKind
from slippulse_jax.inference.design.information import Gain, Kind, Prior, draw, expected_gain, joint_gain, log_likelihoods
from slippulse_jax.inference.design.knowledge import Knowledge
from slippulse_jax.inference.design.report import BIT, labels, report, scale_of, to_dict
from slippulse_jax.inference.fronts import FRONTS, pushed
from slippulse_jax.inference.inputs import Inputs
from slippulse_jax.shown import html

MOST_EXPERIMENTS = 12


class Candidate(NamedTuple):
    """One candidate experiment; lengths in λc, or in m where `correlation_length` is given."""

    height: float
    sigma: float
    poisson: float
    prestress: float
    threshold_slope: float
    correlation_length: float | None  # m
    young: float | None  # Pa
    kind: Kind
    push_height: float | None = None  # of a block, h/H
    push_width: float | None = None  # w/H
    push_control: Control = "displacement"


class Step(NamedTuple):
    """One experiment of a sequence, and the gain expected from it together with all before."""

    candidate: int
    gain: Gain


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """Outcome of `design`: one entry per candidate, in the order given. Information is in nats."""

    knowledge: Knowledge
    candidates: list[Candidate]
    information: np.ndarray  # (c,) expected
    information_error: np.ndarray  # (c,) of its quadrature
    d_optimal: np.ndarray  # (c,) E ½ ln(1 + s²J²/σ²)
    log_stderr: np.ndarray  # (c,) expected standard error of ln k afterwards, over all roots
    told_apart: np.ndarray  # (c,) probability that one root will have a posterior of 95 % or more
    length: np.ndarray  # (m, c) of every sample, in λc
    sequence: list[Step]  # greedy: each adds most to those before it

    @property
    def ranking(self) -> np.ndarray:
        """Candidates from the most to the least informative."""
        return np.argsort(-self.information, kind="stable")

    @property
    def best(self) -> int:
        """The candidate of most expected information."""
        return int(self.ranking[0])

    @property
    def expected_length(self) -> np.ndarray:
        """Mean and standard deviation of the finite lengths of each candidate, in λc, NaN where none is; shape (c, 2)."""
        w = self.knowledge.probability[:, None] * np.isfinite(self.length)
        mass = np.where(w.any(axis=0), w.sum(axis=0), np.nan)
        finite = np.where(np.isfinite(self.length), self.length, 0)
        mean = (w * finite).sum(axis=0) / mass
        return np.stack([mean, np.sqrt((w * (finite - mean) ** 2).sum(axis=0) / mass)], axis=1)

    def report(self) -> str:
        """Report as text."""
        return report(self)

    def __str__(self) -> str:
        return self.report()

    def _repr_html_(self) -> str:
        scale, unit = scale_of(self)
        names = labels(self.candidates)
        rows = [
            (
                names[i],
                f"{self.expected_length[i, 0] * scale[i]:.4g} ± {self.expected_length[i, 1] * scale[i]:.2g} {unit}",
                f"{self.information[i] / BIT:.3f} bit",
                f"{self.log_stderr[i]:.3g}",
            )
            for i in self.ranking
        ]
        return html("Design, the most informative first", rows, ("candidate", "length", "information", "se of ln k"))

    def __repr__(self) -> str:
        return f"Design({len(self.candidates)} candidates, best {self.best}: {self.information[self.best]:.3g} nats)"

    def to_dict(self) -> dict[str, Any]:
        """Plain Python values of everything but the samples, ready for JSON."""
        return to_dict(self)


def design(
    knowledge: Knowledge,
    *,
    height: ArrayLike,
    sigma: ArrayLike,
    poisson: ArrayLike = 0.3,
    prestress: ArrayLike = 0.0,
    threshold_slope: ArrayLike = 0.0,
    correlation_length: ArrayLike | None = None,
    young: ArrayLike | None = None,
    push_height: ArrayLike | None = None,
    push_width: ArrayLike | None = None,
    push_control: Control = "displacement",
    kind: Kind = "length",
    experiments: int = 1,
    seed: int = 0,
) -> Design:
    """Rank candidate experiments by the information expected about the interface stiffness.

    The conditions broadcast against each other, and each entry is a candidate.

    Parameters
    ----------
    knowledge : Knowledge
        Knowledge of k/K, or of the areal stiffness where the material is given, and of what event the lengths will be.
    height, sigma : array_like, shape () or (c,)
        Height of the block, and standard error σ of a length measured on it: in λc, or in m where the material is given. σ may
        be 0 for counts.
    poisson, prestress, threshold_slope : array_like
        ν; φ = σ_0/σ_s in (−1, 1); ε, rise of the threshold per contact.
    correlation_length, young : array_like, optional
        λc in m and E in Pa: the material, both or neither.
    push_height, push_width : array_like, optional
        Height of the push and of the pusher itself over that of the block, h/H and w/H, as for `Push`: each candidate is then a
        block under two-dimensional elasticity, and its length that of the whole event.
    push_control : {"displacement", "force"}
        What is held while the event runs.
    kind : {"length", "whole"}
        Whether a length is measured, or whole contacts are counted.
    experiments : int
        Length of the planned sequence, in which each experiment adds most to those before it. A candidate may be repeated.
    seed : int
        Seed of the scrambled Sobol points with which sequences of two or more are evaluated.

    Returns
    -------
    Design

    Raises
    ------
    ValueError
        If a value lies outside its domain, the shapes do not broadcast, or the knowledge is about another kind of stiffness,
        or from measurements of another body.
    NotConverged
        If the exact solution did not converge for a candidate; never seen.

    Notes
    -----
    The information of outcomes that are independent given the stiffness is submodular, so the greedy sequence obtains at
    least 1 − 1/e of the information of the best set.
    """
    conditions = {
        "height": height, "sigma": sigma, "poisson": poisson, "prestress": prestress, "threshold_slope": threshold_slope,
        "correlation_length": correlation_length, "young": young, "push_height": push_height, "push_width": push_width,
    }  # fmt: skip
    candidates = _candidates({name: x for name, x in conditions.items() if x is not None}, kind, push_control)
    body = "slider" if push_height is None else "block"
    if knowledge.body not in (None, body):
        raise ValueError(
            f"the knowledge is from measurements of a {knowledge.body}, the candidates are {body}s "
            "(push_height makes them blocks)"
        )
    if knowledge.in_si != (correlation_length is not None):
        known, needed = ("areal stiffness in Pa/m", "give correlation_length and young") if knowledge.in_si else (
            "k/K", "it must be areal (in_si=True) where the material is given"
        )  # fmt: skip
        raise ValueError(f"the knowledge is about {known}: {needed}")
    if not 1 <= experiments <= MOST_EXPERIMENTS:
        raise ValueError(f"experiments = {experiments}: must be from 1 to {MOST_EXPERIMENTS}")
    prior = Prior(knowledge.theta, knowledge.probability, knowledge.labels)
    length, slope = lengths_of(candidates, knowledge.theta, knowledge.event)
    error = np.array([c.sigma / (c.correlation_length or 1) for c in candidates])
    gains = [expected_gain(prior, column, s, kind) for column, s in zip(length.T, error, strict=True)]
    # a count adds to σ² the variance of rounding to a whole contact
    variance = error**2 + (kind == "whole") / 12
    local = 0.5 * np.log1p(knowledge.within_sd**2 * slope**2 / variance)
    information, information_error, log_stderr, told_apart = (np.array(x) for x in zip(*gains, strict=True))
    return Design(
        knowledge=knowledge,
        candidates=candidates,
        information=information,
        information_error=information_error,
        d_optimal=prior.weight @ local,
        log_stderr=log_stderr,
        told_apart=told_apart,
        length=length,
        sequence=_greedy(prior, length, error, kind, gains, experiments, seed),
    )


def _candidates(given: dict[str, ArrayLike], kind: str, control: Control) -> list[Candidate]:
    check_choice("kind", kind, Kind)
    if ("correlation_length" in given) != ("young" in given):
        raise ValueError("correlation_length and young: give both, or neither")
    columns = {name: np.atleast_1d(np.asarray(x, dtype=np.float64)) for name, x in given.items()}
    try:
        columns = dict(zip(columns, np.broadcast_arrays(*columns.values()), strict=True))
    except ValueError:
        shapes = ", ".join(f"{name} {x.shape}" for name, x in columns.items())
        raise ValueError(f"the conditions of the candidates must broadcast together: {shapes}") from None
    if columns["height"].ndim != 1 or columns["height"].size == 0:
        raise ValueError("the conditions of the candidates must be one-dimensional, with at least one candidate")
    _check_columns(columns, kind)
    _check_push(columns, control)
    absent = {"correlation_length": None, "young": None}
    return [
        Candidate(**(absent | {name: float(x[i]) for name, x in columns.items()}), kind=kind, push_control=control)  # pyright: ignore
        for i in range(columns["height"].size)
    ]


def _check_columns(columns: dict[str, np.ndarray], kind: str) -> None:
    for name, requirement in (("correlation_length", "must be positive, in m"), ("young", "must be positive, in Pa")):
        check_domain(name, columns.get(name, np.ones(1)), lambda x: x > 0, requirement)
    if kind == "length":
        check_domain("sigma", columns["sigma"], lambda x: x > 0, "must be positive: the standard error of a length")
    check_domain("sigma", columns["sigma"], lambda x: x >= 0, "cannot be negative: a standard error")
    ratio = columns["height"] / columns.get("correlation_length", 1.0)
    check_domain("height over correlation length", ratio, lambda x: x > 1, "must exceed 1")
    for name, domain in (("poisson", POISSON), ("prestress", PRESTRESS), ("threshold_slope", THRESHOLD_SLOPE)):
        domain.check(name, columns[name])


def _check_push(columns: dict[str, np.ndarray], control: Control) -> None:
    """Check that every pusher lies on the side of its block, and covers more than a contact's length of it."""
    if not has_push(columns, control):
        return
    if columns["threshold_slope"].any():
        raise ValueError("threshold_slope: the thresholds under a block are level here")
    for name, symbol in (("push_height", "h/H"), ("push_width", "w/H")):
        if name in columns:
            over = f"must lie in (0, 1), as it is over the height of the block, {symbol}"
            check_domain(name, columns[name], lambda x: (x > 0) & (x < 1), over)
    at = columns["push_height"] * columns["height"] / columns.get("correlation_length", 1.0)
    check_domain("height of the push over correlation length", at, lambda x: x > 1, "must exceed 1")
    for at, width in zip(columns["push_height"], columns.get("push_width", ()), strict=False):
        Push(at, width)


def lengths_of(candidates: list[Candidate], theta: np.ndarray, event: EventKind) -> tuple[np.ndarray, np.ndarray]:
    """Length of every candidate at every ln(stiffness), in λc, and dℓ/d ln k, 0 where the front never stops.

    ℓ* of a slider's front, or the length of the whole event; of a block always that.
    """
    numbers = np.array([c[:5] for c in candidates])
    scale = np.array([c.correlation_length or 1.0 for c in candidates])
    per_unit = np.array([(c.correlation_length or 1.0) / (c.young or 1.0) for c in candidates])
    ratio = np.exp(theta)[:, None] * per_unit
    inputs = Inputs.of(numbers[:, 0] / scale, ratio, numbers[:, 2], numbers[:, 3], numbers[:, 4])
    front = FRONTS["slider", event]
    if candidates[0].push_height is not None:
        at, width = np.array([[c.push_height, c.push_width or np.nan] for c in candidates]).T
        push = pushed(np.ones(len(at)), at, width, [c.push_control for c in candidates])
        front, inputs = FRONTS["block", "full"], inputs.given(**{n: np.broadcast_to(x, ratio.shape) for n, x in push.items()})
    found = front.predict(inputs.ravel(), ("log_stiffness",))
    return found.value.reshape(ratio.shape), found.slopes["log_stiffness"].reshape(ratio.shape)


def _greedy(
    prior: Prior, length: np.ndarray, error: np.ndarray, kind: Kind, gains: list[Gain], experiments: int, seed: int
) -> list[Step]:
    best = int(np.argmax([g.information for g in gains]))
    steps = [Step(best, gains[best])]
    if experiments == 1:
        return steps
    drawn = draw(prior, experiments, seed)
    so_far = log_likelihoods(drawn, 0, length[:, best], error[best], kind)
    for step in range(1, experiments):
        taken: tuple[Gain, int, np.ndarray] | None = None
        for j in range(length.shape[1]):
            together = so_far + log_likelihoods(drawn, step, length[:, j], error[j], kind)
            gain = joint_gain(prior, drawn, together)
            if taken is None or gain.information > taken[0].information:
                taken = gain, j, together
        assert taken is not None
        gain, best, so_far = taken
        steps.append(Step(best, gain))
    return steps
