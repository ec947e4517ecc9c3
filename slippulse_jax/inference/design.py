"""Candidate experiments ranked by the information expected about the interface.

A candidate is one datum, or a table of them: lengths, counts, forces, a whole sequence. What it would read is a distribution at
every draw of the knowledge, that of the problem that would be fitted. Of weighted draws θ_i the expected information (mutual
information, in nats) is

    I = Σ_i w_i ∫ dy p(y|θ_i) ln[p(y|θ_i)/p(y)],        p(y) = Σ_i w_i p(y|θ_i),

the mean of the logarithm over (θ, y) drawn together: p(y) being an exact sum over the draws, it has no bias, and scrambled
Sobol points give its standard error. Several experiments add their ln p. A front that never stops is an outcome of its own.
"""

import dataclasses
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import ArrayLike
from scipy.special import logsumexp, ndtri

from slippulse_jax.base.domains import HEIGHT, check_choice, check_domain
from slippulse_jax.base.files import plain
from slippulse_jax.base.shown import html, plural
from slippulse_jax.base.status import NotConverged
from slippulse_jax.block import ContactLaw, Control, Top
from slippulse_jax.inference.knowledge import Knowledge, moments
from slippulse_jax.inference.model.inputs import COMMON
from slippulse_jax.inference.model.models import front_for, front_of
from slippulse_jax.inference.observables import Count, Length, Limit
from slippulse_jax.inference.observables.observable import Observations
from slippulse_jax.inference.parameters import PARAMETERS, ParameterSet, checked, observables_of, parameter_set
from slippulse_jax.inference.search.learning import over
from slippulse_jax.inference.search.likelihood import log_densities, make_problem
from slippulse_jax.inference.table.columns import TEXTS, numbers
from slippulse_jax.inference.table.measurements import Measurements, measurements_of

if TYPE_CHECKING:
    import pandas as pd

LengthKind = Literal["length", "whole"]

BIT = np.log(2)
MOST_EXPERIMENTS = 12
SURE = 0.95  # smallest posterior of one root from which the roots count as distinguished
REPLICATES, POINTS = 8, 256  # scrambled Sobol sequences, and points of each
FOLLOWED = 100  # series of each candidate, for each parameter
LOST = 0.01  # weight of draws about which no series was followed, above which a candidate is refused
AT_ONCE = 2_000_000  # numbers held at once
TABLES = [("name", object), ("measured", object)]
USUAL = {"push_control": "displacement", "contact_law": "amontons", "top": "free"}
OUTCOMES = Length(), Count(sharpest=1e-12)
"""Observables of lengths; a count is its interval itself, and not one blurred as in a fit."""


# --- information ---------------------------------------------------------------------------------------------------------


class Gain(NamedTuple):
    """What experiments are expected to add to the knowledge."""

    information: float  # in nats
    error: float  # its standard error, with what fewer samples would change
    log_stderr: float  # standard deviation of ln k afterwards
    told_apart: float  # probability that one root will have a posterior of `SURE` or more


class Predictions(NamedTuple):
    """What each of m draws predicts of n data of one observable."""

    data: Observations
    mean: np.ndarray  # (m, n); inf where a front never stops
    covariance: np.ndarray | None = None  # (m, n, n), of what the model leaves open


Experiment = list[Predictions]


def size(one: Experiment) -> int:
    """Number of data of an experiment."""
    return sum(part.mean.shape[1] for part in one)


def draw(known: Knowledge, errors: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw truths and errors of experiments, common to all candidates.

    `REPLICATES` independently scrambled Sobol sequences, one after another: the sample that is the truth, shape (s,), and
    standard normal errors, shape (s, errors).
    """
    from scipy.stats.qmc import Sobol

    rng = np.random.default_rng(seed)
    u = np.concatenate([Sobol(errors + 1, rng=rng).random(POINTS) for _ in range(REPLICATES)])
    truth = np.searchsorted(np.cumsum(known.weight), u[:, 0] * (1 - 1e-12))
    return np.minimum(truth, len(known) - 1), ndtri(np.clip(u[:, 1:], 1e-12, 1 - 1e-12))


def log_likelihoods(one: Experiment, truth: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Ln p(y|θ_j) of readings at each truth, for draw j; (s, m)."""
    total, start = np.zeros((len(truth), len(one[0].mean))), 0
    for data, mean, covariance in one:
        error = noise[:, start : (start := start + mean.shape[1])]
        if covariance is not None:
            total += _normal(mean, covariance + np.diag(data.sigma**2), truth, error)
            continue
        for k, (value, sigma) in enumerate(zip(data.value[0], data.sigma, strict=True)):
            y = data.observable.simulated(mean[truth, k] + sigma * error[:, k], np.array(value))
            y, own = np.unique(y, return_inverse=True)  # far fewer counts than draws
            found, stops = np.where(np.isinf(mean[:, k]), 0.0, -np.inf) + np.zeros((len(y), 1)), np.isfinite(y)
            found[stops] = log_densities(data.observable, mean[:, k], y[stops, None], sigma)
            total += found[own]
    return total


def _normal(mean: np.ndarray, covariance: np.ndarray, truth: np.ndarray, error: np.ndarray) -> np.ndarray:
    """The same for data that err together."""
    root = np.linalg.cholesky(covariance)
    y = mean[truth] + np.einsum("sab,sb->sa", root[truth], error)
    white, log_det = np.linalg.inv(root), np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    middle = np.einsum("jab,jb->ja", white, mean)
    parts = np.array_split(y, -(-mean.size * len(y) // AT_ONCE))
    return np.concatenate([-np.square(np.einsum("jab,sb->sja", white, x) - middle).sum(-1) / 2 for x in parts]) - log_det


def gain(known: Knowledge, truth: np.ndarray, log_p: np.ndarray) -> Gain:
    """Gain of experiments, from the sum of their `log_likelihoods`."""
    with np.errstate(divide="ignore"):
        joint = log_p + np.log(known.weight)
    total = np.asarray(logsumexp(joint, axis=1))
    each = log_p[np.arange(len(log_p)), truth] - total
    means = each.reshape(REPLICATES, -1).mean(axis=1)
    posterior, theta = np.exp(joint - total[:, None]), known.log_stiffness - known.mean
    mean = posterior @ theta
    sd = np.sqrt(np.maximum(posterior @ theta**2 - mean**2, 0))
    sure = (posterior @ (known.by_root > 0)).max(axis=1) >= SURE
    # every other sample of each root, with the probability of the root
    kept = np.sort(np.concatenate([np.flatnonzero(own)[::2] for own in known.by_root.T]))
    own, root = np.isin(truth, kept), known.root[kept]
    share, left = (weight.sum(axis=0)[root] for weight in (known.by_root, known.by_root[kept]))
    with np.errstate(divide="ignore", invalid="ignore"):
        fewer = logsumexp(joint[np.ix_(own, kept)] + np.log(share / left), axis=1) - total[own]
    fewer = float(np.abs(np.nanmean(fewer))) if np.isfinite(fewer).any() else 0.0
    error = np.hypot(means.std(ddof=1) / np.sqrt(REPLICATES), fewer)
    return Gain(float(means.mean()), float(error), float(sd.mean()), float(sure.mean()))


def greedy(known: Knowledge, every: list[Experiment], experiments: int, seed: int) -> tuple[list[Gain], list[tuple[int, Gain]]]:
    """Find the gain of each candidate, and which add most in turn."""
    first: list[Gain] = []
    chosen, so_far = [], 0.0
    widest = max(map(size, every))
    truth, noise = draw(known, experiments * widest, seed)
    for step in range(experiments):
        error = noise[:, step * widest : (step + 1) * widest]
        gains = [gain(known, truth, so_far + log_likelihoods(one, truth, error)) for one in every]
        best = int(np.argmax([one.information for one in gains]))
        chosen.append((best, gains[best]))
        first = first or gains
        if step + 1 < experiments:
            so_far = so_far + log_likelihoods(every[best], truth, error)
    return first, chosen


# --- designs -------------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """Outcome of `design`, one entry per candidate; information in nats.

    Candidates and sequence are NumPy record arrays: ``candidates.height`` is a column, ``candidates[0].height`` a number. Of
    tables there is a name only, and lengths are NaN.
    """

    knowledge: Knowledge
    candidates: np.recarray  # (c,) what `design` was given; NaN where it was not
    names: list[str]  # the conditions in which candidates differ, or the names of tables
    parameters: ParameterSet | None  # by which lengths follow from the stiffness; None for tables
    information: np.ndarray  # (c,) expected
    information_error: np.ndarray  # (c,) its standard error, with what fewer samples would change
    log_stderr: np.ndarray  # (c,) expected standard error of ln k afterwards, over all roots
    told_apart: np.ndarray  # (c,) probability that one root will have a posterior of 95 % or more
    length: np.ndarray  # (m, c) of every sample, in λc
    sequence: np.recarray  # of each step the candidate, and information, error, log_stderr, told_apart of all so far

    def lengths(self, log_stiffness: np.ndarray) -> np.ndarray:
        """Lengths of all candidates at stiffnesses, in λc; shape (m, c).

        ℓ of a slider's front, or the length of the whole event; of a block always that. inf where the front never stops.
        """
        return _lengths(self._parameters, log_stiffness)

    def breaks_again(self, log_stiffness: np.ndarray) -> np.ndarray:
        """Whether edge contacts break again before the fronts stop; shape (m, c)."""
        q = self._parameters
        return q.front.breaks_again(q.inputs.at(log_stiffness[:, None]).ravel()).reshape(len(log_stiffness), -1)

    @property
    def _parameters(self) -> ParameterSet:
        if self.parameters is None:
            raise ValueError("the candidates are tables, not lengths")
        return self.parameters

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
        """Mean and standard deviation of finite lengths, in λc; (c, 2)."""
        return np.stack(moments(self.length, self.knowledge.weight[:, None] * np.isfinite(self.length)), axis=1)

    @property
    def never_stops(self) -> np.ndarray:
        """Probability that the front of each candidate never stops, shape (c,)."""
        return self.knowledge.weight @ np.isinf(self.length)

    @property
    def measured(self) -> list[str]:
        """What each candidate would read: a length, or how many data."""
        if self.parameters is None:
            return self.candidates.measured.tolist()
        unit = "mm" if self.knowledge.in_si else "λc"
        every = self.expected_length * self._scale[:, None]
        return [f"{mean:.4g} ± {sd:.2g} {unit}" if np.isfinite(mean) else "never stops" for mean, sd in every]

    @property
    def _scale(self) -> np.ndarray:
        """Size of λc in mm, or 1, for each candidate; (c,)."""
        return np.nan_to_num(self.candidates.correlation_length, nan=1e-3) * 1e3

    @property
    def notes(self) -> list[str]:
        """Warnings to read before the experiment."""
        said = [f"Note: {note}" for note in self.knowledge.notes]
        first = self.candidates[0]
        if self.parameters is None:
            said.append("Values of the tables do not matter, their errors and conditions do.")
        elif np.isfinite(first.push_height):
            over = "on a patch" if np.isfinite(first.push_width) else "over everything above"
            said.append(f"Blocks under two-dimensional elasticity, pushed {over} at the height h, {first.push_control} held.")
        elif self.knowledge.event == "full":
            said.append("Lengths are those of whole events, in which contacts may break again.")
        if (self.information_error > 0.1 * np.maximum(self.information, 0.05)).any():
            said.append("Note: too few samples for an error this small; give more (nodes, or a longer chain).")
        for name, endless in zip(self.names, self.never_stops, strict=True):
            if endless > 1e-3:
                said.append(f"Note: {name}: with probability {endless:.0%} the front never stops.")
        if self.information.max() < 0.1:
            why = "what it would read is on a plateau, or already known to within σ"
            said.append(f"Note: no candidate adds much information: {why}.")
        return said

    def report(self) -> str:
        """Report as text."""
        k, names, measured, best = self.knowledge, self.names, self.measured, self.best
        several = len(k.roots) > 1
        wide, broad = max(map(len, names)), max(len("measured"), *map(len, measured))
        apart = f" {'roots apart':>11}" if several else ""
        lines = [
            f"Known: {k.statement}",
            f"       standard deviation of ln k, over all roots: {k.log_sd:.3g}",
            f"{'':4} {'candidate':{wide}} {'measured':>{broad}} {'information':>18} {'se of ln k':>11}{apart}",
        ]
        for place, i in enumerate(self.ranking, 1):
            last = f" {self.told_apart[i]:11.0%}" if several else ""
            lines.append(
                f"{place:3}. {names[i]:{wide}} {measured[i]:>{broad}} "
                f"{_bits(self.information[i], self.information_error[i], 6)} {self.log_stderr[i]:11.3g}{last}"
            )
        lines.append(f"Next: {names[best]}{'' if self.parameters is None else self._expected(best)}.")
        if len(self.sequence) > 1:
            lines.append("Sequence, each adding most to those before it:")
            for place, (i, information, error, log_stderr, told_apart) in enumerate(self.sequence, 1):
                last = f", roots apart {told_apart:.0%}" if several else ""
                together = _bits(information, error)
                lines.append(f"{place:3}. {names[i]:{wide}} together {together}, se of ln k {log_stderr:.3g}{last}")
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def _expected(self, i: int) -> str:
        """What a length is at each root."""
        k, lengths = self.knowledge, self.length[:, i, None]
        expected, _ = moments(lengths, k.by_root * np.isfinite(lengths))
        again = self.breaks_again(np.log([value for _, value, _ in k.roots]))[:, i]
        unit = "mm" if k.in_si else "λc"
        return "; expect " + ", ".join(
            f"{length * self._scale[i]:.4g} {unit} if {k.symbol} = {value:.3g}{' (edge breaks again)' * bool(more)}"
            for length, (_, value, _), more in zip(np.nan_to_num(expected, nan=np.inf), k.roots, again, strict=True)
        )

    def __str__(self) -> str:
        return self.report()

    def _repr_html_(self) -> str:
        columns = self.names, self.measured, self.information / BIT, self.log_stderr
        rows = [(name, span, f"{bits:.3f} bit", f"{sd:.3g}") for name, span, bits, sd in zip(*columns, strict=True)]
        heads = ("candidate", "measured", "information", "se of ln k")
        return html("Design, the most informative first", [rows[i] for i in self.ranking], heads)

    def __repr__(self) -> str:
        return f"Design({len(self.candidates)} candidates, best {self.best}: {self.information[self.best]:.3g} nats)"

    def to_dict(self) -> dict[str, Any]:
        """Plain Python values of all but the samples, ready for JSON."""
        k = self.knowledge
        mean, sd = self.expected_length.T
        names = ("never_stops", "information", "information_error", "log_stderr", "told_apart")
        results = {"label": self.names, "rank": np.argsort(self.ranking) + 1, "length": mean, "length_sd": sd}
        results |= {name: getattr(self, name) for name in names}
        candidates = enumerate(plain(self.candidates))
        return plain(
            {
                "knowledge": {
                    "unit": "Pa/m" if k.in_si else "",
                    "log_sd": k.log_sd,
                    "event": k.event,
                    "roots": [
                        {"probability": p, "stiffness": value, "log_sd": sd, "rebreaks": again}
                        for (p, value, sd), again in zip(k.roots, k.rebreaks, strict=True)
                    ],
                },
                "units": {"information": "nat", "length": "λc", "height": "m" if k.in_si else "λc", "push": "H"},
                "candidates": [one | {name: column[i] for name, column in results.items()} for i, one in candidates],
                "sequence": self.sequence,
                "notes": self.notes,
            }
        )


def _named(candidates: np.recarray) -> list[str]:
    """Name each candidate by the conditions in which they differ."""
    each = [_in_words(one) for one in candidates]
    differ = [field for field in each[0] if np.unique(candidates[field]).size > 1] or ["height"]
    return [", ".join(words[field] for field in differ) for words in each]


def _in_words(c: Any) -> dict[str, str]:
    """Conditions of a candidate in words, by field."""
    in_lc = np.isnan(c.correlation_length)
    size, unit = (1, "λc") if in_lc else (1e3, "mm")
    side, of_side = (1, "H") if in_lc else (c.height * size, unit)
    return {
        "height": f"H = {c.height * size:.5g} {unit}",
        "poisson": f"ν = {c.poisson:g}",
        "prestress": f"φ = {c.prestress:g}",
        "threshold_slope": f"ε = {c.threshold_slope:g}",
        "sigma": f"σ = {c.sigma * size:.3g} {unit}",
        "correlation_length": f"λc = {c.correlation_length * 1e6:.4g} µm",
        "young": f"E = {c.young * 1e-9:.4g} GPa",
        "push_height": f"h = {c.push_height * side:.4g} {of_side}",
        "push_width": f"pusher {c.push_width * side:.4g} {of_side}",
        "friction": f"μ = {c.friction:g}",
        "normal_stiffness": f"k_n/k = {c.normal_stiffness:g}",
    }


def _bits(information: Any, error: Any, width: int = 0) -> str:
    """Format an information in nats, with its error, in bits."""
    error = error / BIT
    small = f"{error:.3f}" if error >= 5e-4 else "0.001" if error > 1e-4 else "0.000"
    return f"{information / BIT:z{width}.3f} ± {small} bit"


def design(
    knowledge: Knowledge,
    candidates: "Mapping[str, Measurements | pd.DataFrame | str | os.PathLike[str]] | None" = None,
    *,
    height: ArrayLike | None = None,
    sigma: ArrayLike | None = None,
    poisson: ArrayLike = 0.3,
    prestress: ArrayLike = 0.0,
    threshold_slope: ArrayLike = 0.0,
    correlation_length: ArrayLike | None = None,
    young: ArrayLike | None = None,
    push_height: ArrayLike | None = None,
    push_width: ArrayLike | None = None,
    push_control: Control = "displacement",
    friction: ArrayLike | None = None,
    normal_stiffness: ArrayLike | None = None,
    contact_law: ContactLaw = "amontons",
    top: Top = "free",
    kind: LengthKind = "length",
    experiments: int = 1,
    seed: int = 0,
) -> Design:
    """Rank candidate experiments by the information expected about the interface.

    Of lengths, whose conditions broadcast against each other, and each entry is a candidate; or of tables.

    Parameters
    ----------
    knowledge : Knowledge
        Knowledge of k/K, or of the areal stiffness where the material is given, and of what event the lengths will be.
    candidates : dict of Measurements, pandas.DataFrame or path, optional
        Experiments by name, each a table as it would be measured and given to `fit`: forces, lengths, a sequence. Its values do
        not matter, its errors and conditions do. What else the knowledge holds, as friction, is left open where the table does
        not state it.
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
    friction, normal_stiffness : array_like, optional
        μ, by which the thresholds of the blocks follow the pressure, and k_n/k, as for `Block`.
    contact_law : {"amontons", "multicontact"}
    top : {"free", "held"}
        As for `Block`.
    kind : {"length", "whole"}
        Whether a length is measured, or whole contacts are counted.
    experiments : int
        Length of the planned sequence, in which each experiment adds most to those before it. A candidate may be repeated.
    seed : int
        Seed of the scrambled Sobol points, by which truths and errors are drawn.

    Returns
    -------
    Design

    Raises
    ------
    ValueError
        If a value lies outside its domain, the shapes do not broadcast, or the knowledge is about another kind of stiffness,
        or from measurements of another body.
    NotConverged
        If the exact solution did not converge for a candidate, or its events could not be followed.

    Notes
    -----
    The information of outcomes that are independent given the stiffness is submodular, so the greedy sequence obtains at
    least 1 − 1/e of the information of the best set.
    """
    given = {
        "height": height, "sigma": sigma, "poisson": poisson, "prestress": prestress, "threshold_slope": threshold_slope,
        "correlation_length": correlation_length, "young": young, "kind": kind,
        "push_height": push_height, "push_width": push_width, "push_control": push_control,
        "friction": friction, "normal_stiffness": normal_stiffness, "contact_law": contact_law, "top": top,
    }  # fmt: skip
    if not 1 <= experiments <= MOST_EXPERIMENTS:
        raise ValueError(f"experiments = {experiments}: must be from 1 to {MOST_EXPERIMENTS}")
    if candidates is not None:
        usual = {"poisson": 0.3, "prestress": 0.0, "threshold_slope": 0.0, "kind": "length", **USUAL}
        if stated := [name for name, x in given.items() if x is not None and (np.ndim(x) or x != usual.get(name))]:
            raise ValueError(f"design: {stated[0]} beside candidates: their tables state it")
        if not candidates:
            raise ValueError("design: candidates = {}: at least one is needed")
        every, known, tables = [], knowledge, {name: measurements_of(one) for name, one in candidates.items()}
        for name, m in tables.items():
            try:
                found, weight = of_table(known, m)
            except (ValueError, NotConverged) as error:
                raise type(error)(f"candidate {name!r}: {error}") from None
            every, known = [*every, found], dataclasses.replace(known, weight=weight)
        measured = [", ".join(plural(part.mean.shape[1], part.data.observable.noun) for part in one) for one in every]
        table = np.rec.fromarrays([np.array([*candidates], object), np.array(measured, object)], dtype=TABLES)
        nowhere = np.full((len(known), len(every)), np.nan)
        return _ranked(known, table, [*candidates], None, every, nowhere, experiments, seed)
    if height is None or sigma is None:
        raise ValueError("design: give candidates, or height and sigma")
    if "residual_strength" in knowledge.more:
        raise ValueError("design: contacts keep a share of their strength, which only candidates that are tables take")
    table, m = _candidates(given)
    body = "slider" if push_height is None else "block"
    _check_body(knowledge, body, m)
    q = parameter_set(m, ["stiffness"], front_for(body, "full" if body == "block" else knowledge.event), OUTCOMES)
    length = _lengths(q, knowledge.log_stiffness)
    every = [
        [Predictions(data._replace(value=data.value[:, [i]], sigma=data.sigma[[i]]), length[:, [row]])]
        for data in make_problem(m, q).observed
        for i, row in enumerate(data.measurement.tolist())
    ]
    return _ranked(knowledge, table, _named(table), q, every, length, experiments, seed)


def _ranked(
    known: Knowledge, table: Any, names: list[str], q: Any, every: Any, length: np.ndarray, experiments: int, seed: int
) -> Design:
    """Compute gains, and choose."""
    gains, chosen = greedy(known, every, experiments, seed)
    kinds = [("candidate", int), *((name, float) for name in Gain._fields)]
    sequence = np.rec.fromrecords([(i, *one) for i, one in chosen], dtype=kinds)
    return Design(known, table, names, q, *np.transpose(gains), length=length, sequence=sequence)


def _check_body(knowledge: Knowledge, body: str, m: Measurements) -> None:
    """Refuse candidates of which the knowledge tells nothing."""
    if knowledge.body not in (None, body):
        raise ValueError(
            f"the knowledge is from measurements of a {knowledge.body}, the candidates are {body}s "
            "(push_height makes them blocks)"
        )
    if knowledge.in_si and m.young is None:
        raise ValueError("the knowledge is about areal stiffness in Pa/m: give correlation_length and young")
    if not knowledge.in_si and m.young is not None:
        raise ValueError("the knowledge is about k/K: it must be areal (in_si=True) where the material is given")


def of_table(known: Knowledge, m: Measurements) -> tuple[Experiment, np.ndarray]:
    """Predict a table at every draw; weigh those that could be followed."""
    front = front_of(m)
    front = front if front.body == "block" or front.event == known.event else front_for("slider", known.event)
    _check_body(known, front.body, m)
    known_to = {*COMMON, *front.inputs} | {name for one in observables_of(front) for name in (*one.acts, one.added)}
    names = [one for one in known.more if {one, *PARAMETERS[one].acts} & known_to and getattr(m, one, None) is None]
    problem = make_problem(m, checked(m, ["stiffness", *names], front))
    if any(isinstance(data.observable, Limit) for data in problem.observed):
        raise ValueError("a lower limit is no plan; state lengths")
    theta = np.column_stack([known.log_stiffness, *(known.more[one] for one in names)])
    if not problem.emulates:
        return [Predictions(data, problem.predicted(theta, data)) for data in problem.observed], known.weight
    # some of everywhere, as tails are predicted too
    share = np.cumsum(0.7 * known.weight + 0.3 / len(known))
    count = FOLLOWED * len(names) + FOLLOWED
    problem = over(problem, theta[np.searchsorted(share, (np.arange(count) + 0.5) / count * share[-1])])
    found = problem.jointly(theta)
    lost = np.isinf(np.concatenate(found.means, axis=1).sum(axis=1))
    if known.weight @ lost > LOST:
        at = known.log_stiffness[int(np.argmax(lost))]
        raise NotConverged(f"no series near ln k = {at:.6g} could be followed")
    means = [np.where(lost[:, None], 0.0, mean) for mean in found.means]
    return list(map(Predictions, problem.observed, means, found.covariances)), np.where(lost, 0.0, known.weight)


def _lengths(q: ParameterSet, log_stiffness: np.ndarray) -> np.ndarray:
    found = q.front.lengths(q.inputs.at(log_stiffness[:, None]).ravel()).reshape(len(log_stiffness), -1)
    if np.isnan(found).any():
        at, candidate = np.argwhere(np.isnan(found))[0]
        raise NotConverged(f"no length of candidate {candidate} at ln k = {log_stiffness[at]:.6g}")
    return found


def _candidates(given: dict[str, Any]) -> tuple[np.recarray, Measurements]:
    """Gather the conditions, and check them as measurements of one contact.

    In the table a condition that is not given is NaN.
    """
    check_choice("kind", given["kind"], LengthKind)
    if (given["correlation_length"] is None) != (given["young"] is None):
        raise ValueError("correlation_length and young: give both, or neither")
    units = {} if given["young"] is None else {"height": "m", "sigma": "m", "correlation_length": "m", "young": "Pa"}
    every = {name: x for name, x in given.items() if x is not None and name not in TEXTS}
    columns = {name: numbers(x, f"design: {name}", units.get(name, "")) for name, x in every.items()}
    try:
        columns = dict(zip(columns, np.broadcast_arrays(*columns.values()), strict=True))
    except ValueError:
        shapes = ", ".join(f"{name} {x.shape}" for name, x in columns.items())
        raise ValueError(f"the conditions of the candidates must broadcast together: {shapes}") from None
    shape = columns["height"].shape
    if len(shape) != 1 or shape == (0,):
        raise ValueError("the conditions of the candidates must be one-dimensional, with at least one candidate")
    contact, counted = columns.get("correlation_length", 1.0), given["kind"] == "whole"
    check_domain("sigma", columns["sigma"], lambda x: x >= 0 if counted else x > 0, "must be positive; of counts 0 or more")
    height = columns["height"] / contact
    HEIGHT.check("height over correlation length", height)
    pushes = {name: columns[name] for name in ("push_height", "push_width") if name in columns}
    for name, x in pushes.items():
        over = f"must lie in (0, 1), as it is over the height of the block, {'w' if name == 'push_width' else 'h'}/H"
        check_domain(name, x, lambda x: (x > 0) & (x < 1), over)
    if "push_height" in pushes:
        HEIGHT.check("height of the push over correlation length", pushes["push_height"] * height)
        if columns["threshold_slope"].any():
            raise ValueError("threshold_slope: the thresholds under a block are level here")
    more: dict[str, Any] = {name: x for name, x in columns.items() if name not in ("height", "sigma")}
    more |= {name: (given[name],) * len(height) for name in USUAL if given[name] != USUAL[name]}
    more |= {name: x * height for name, x in pushes.items()}
    more |= {"kind": (given["kind"],) * len(height), "rows": tuple(map(str, range(len(height)))), "source": "candidates"}
    m = Measurements(height=height, length=np.ones(len(height)), length_sigma=columns["sigma"] / contact, **more)
    columns |= {name: np.full(shape, np.nan if x is None else x) for name, x in given.items() if name not in columns}
    table = np.rec.fromarrays([columns[name] for name in given], dtype=[(name, columns[name].dtype) for name in given])
    return table, m
