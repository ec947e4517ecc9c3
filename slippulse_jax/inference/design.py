"""Candidate experiments ranked by the information expected about the interface stiffness."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from slippulse_jax.base.domains import HEIGHT, check_choice, check_domain
from slippulse_jax.base.files import plain
from slippulse_jax.base.shown import html
from slippulse_jax.base.status import NotConverged
from slippulse_jax.block import ContactLaw, Control, Top
from slippulse_jax.inference.knowledge import Gain, Knowledge, LengthKind, expected_gain, greedy, moments
from slippulse_jax.inference.model.models import front_for
from slippulse_jax.inference.parameters import ParameterSet, parameter_set
from slippulse_jax.inference.table.columns import TEXTS
from slippulse_jax.inference.table.measurements import Measurements, numbers

BIT = np.log(2)
MOST_EXPERIMENTS = 12


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """Outcome of `design`, one entry per candidate; information in nats.

    Candidates and sequence are NumPy record arrays: ``candidates.height`` is a column, ``candidates[0].height`` a number.
    """

    knowledge: Knowledge
    candidates: np.recarray  # (c,) what `design` was given; NaN where it was not
    parameters: ParameterSet  # by which lengths follow from the stiffness
    information: np.ndarray  # (c,) expected
    information_error: np.ndarray  # (c,) of its quadrature
    log_stderr: np.ndarray  # (c,) expected standard error of ln k afterwards, over all roots
    told_apart: np.ndarray  # (c,) probability that one root will have a posterior of 95 % or more
    length: np.ndarray  # (m, c) of every sample, in λc
    sequence: np.recarray  # of each step the candidate, and information, error, log_stderr, told_apart of all so far

    def lengths(self, log_stiffness: np.ndarray) -> np.ndarray:
        """Lengths of all candidates at stiffnesses, in λc; shape (m, c).

        ℓ of a slider's front, or the length of the whole event; of a block always that. inf where the front never stops.
        """
        return _lengths(self.parameters, log_stiffness)

    def breaks_again(self, log_stiffness: np.ndarray) -> np.ndarray:
        """Whether edge contacts break again before the fronts stop; shape (m, c)."""
        q = self.parameters
        return q.front.breaks_again(q.inputs.at(log_stiffness[:, None]).ravel()).reshape(len(log_stiffness), -1)

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
    def names(self) -> list[str]:
        """Name of each candidate: the conditions in which the candidates differ."""
        each = [_in_words(one) for one in self.candidates]
        differ = [field for field in each[0] if np.unique(self.candidates[field]).size > 1] or ["height"]
        return [", ".join(words[field] for field in differ) for words in each]

    @property
    def scale(self) -> np.ndarray:
        """Size of λc in mm, or 1, for each candidate; (c,)."""
        return np.nan_to_num(self.candidates.correlation_length, nan=1e-3) * 1e3

    @property
    def notes(self) -> list[str]:
        """Warnings to read before the experiment."""
        said = [f"Note: {note}" for note in self.knowledge.notes]
        first = self.candidates[0]
        if np.isfinite(first.push_height):
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
            why = "the lengths are on their plateau, or already known to within σ"
            said.append(f"Note: no candidate adds much information: {why}.")
        return said

    def report(self) -> str:
        """Report as text."""
        k, names, scale = self.knowledge, self.names, self.scale
        length_unit = "mm" if k.in_si else "λc"
        several = len(k.roots) > 1
        wide = max(map(len, names))
        apart = f" {'roots apart':>11}" if several else ""
        lines = [
            f"Known: {k.statement}",
            f"       standard deviation of ln k, over all roots: {k.log_sd:.3g}",
            f"{'':4} {'candidate':{wide}} {'length':>17} {'information':>18} {'se of ln k':>11}{apart}",
        ]
        for place, i in enumerate(self.ranking, 1):
            mean, sd = self.expected_length[i] * scale[i]
            span = f"{mean:8.4g} ± {sd:<6.2g}{length_unit}" if np.isfinite(mean) else "never stops"
            last = f" {self.told_apart[i]:11.0%}" if several else ""
            lines.append(
                f"{place:3}. {names[i]:{wide}} {span:{17 + len(length_unit)}} "
                f"{_bits(self.information[i], self.information_error[i], 6)} {self.log_stderr[i]:11.3g}{last}"
            )
        lengths = self.length[:, self.best, None]
        expected, _ = moments(lengths, k.by_root * np.isfinite(lengths))
        middle = np.log([value for _, value, _ in k.roots])
        again = self.breaks_again(middle)[:, self.best]
        by_root = ", ".join(
            f"{length * scale[self.best]:.4g} {length_unit} if {k.symbol} = {value:.3g}{' (edge breaks again)' * bool(more)}"
            for length, (_, value, _), more in zip(np.nan_to_num(expected, nan=np.inf), k.roots, again, strict=True)
        )
        lines.append(f"Next: {names[self.best]}; expect {by_root}.")
        if len(self.sequence) > 1:
            lines.append("Sequence, each adding most to those before it:")
            for place, (i, information, error, log_stderr, told_apart) in enumerate(self.sequence, 1):
                last = f", roots apart {told_apart:.0%}" if several else ""
                together = _bits(information, error)
                lines.append(f"{place:3}. {names[i]:{wide}} together {together}, se of ln k {log_stderr:.3g}{last}")
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def __str__(self) -> str:
        return self.report()

    def _repr_html_(self) -> str:
        unit = "mm" if self.knowledge.in_si else "λc"
        length = ["{:.4g} ± {:.2g} {}".format(*x, unit) for x in self.expected_length * self.scale[:, None]]
        columns = self.names, length, self.information / BIT, self.log_stderr
        rows = [(name, span, f"{bits:.3f} bit", f"{sd:.3g}") for name, span, bits, sd in zip(*columns, strict=True)]
        heads = ("candidate", "length", "information", "se of ln k")
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
    friction: ArrayLike | None = None,
    normal_stiffness: ArrayLike | None = None,
    contact_law: ContactLaw = "amontons",
    top: Top = "free",
    kind: LengthKind = "length",
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
        If the exact solution did not converge for a candidate.

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
    candidates, m = _candidates(given)
    body = "slider" if push_height is None else "block"
    if knowledge.body not in (None, body):
        raise ValueError(
            f"the knowledge is from measurements of a {knowledge.body}, the candidates are {body}s "
            "(push_height makes them blocks)"
        )
    if knowledge.in_si and correlation_length is None:
        raise ValueError("the knowledge is about areal stiffness in Pa/m: give correlation_length and young")
    if not knowledge.in_si and correlation_length is not None:
        raise ValueError("the knowledge is about k/K: it must be areal (in_si=True) where the material is given")
    if not 1 <= experiments <= MOST_EXPERIMENTS:
        raise ValueError(f"experiments = {experiments}: must be from 1 to {MOST_EXPERIMENTS}")
    q = parameter_set(m, ["stiffness"], front_for(body, "full" if body == "block" else knowledge.event))
    length = _lengths(q, knowledge.log_stiffness)
    gains = [expected_gain(knowledge, column, s, kind) for column, s in zip(length.T, m.sigma, strict=True)]
    chosen = greedy(knowledge, length, m.sigma, kind, gains, experiments, seed)
    kinds = [("candidate", int), *((name, float) for name in Gain._fields)]
    sequence = np.rec.fromrecords([(i, *gain) for i, gain in chosen], dtype=kinds)
    return Design(knowledge, candidates, q, *np.transpose(gains), length=length, sequence=sequence)


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
    usual = {"push_control": "displacement", "contact_law": "amontons", "top": "free"}
    more: dict[str, Any] = {name: x for name, x in columns.items() if name not in ("height", "sigma")}
    more |= {name: (given[name],) * len(height) for name in usual if given[name] != usual[name]}
    more |= {name: x * height for name, x in pushes.items()}
    more |= {"kind": (given["kind"],) * len(height), "rows": tuple(map(str, range(len(height)))), "source": "candidates"}
    m = Measurements(height=height, length=np.ones(len(height)), length_sigma=columns["sigma"] / contact, **more)
    columns |= {name: np.full(shape, np.nan if x is None else x) for name, x in given.items() if name not in columns}
    table = np.rec.fromarrays([columns[name] for name in given], dtype=[(name, columns[name].dtype) for name in given])
    return table, m
