"""What a fit found: values, errors, intervals, roots, and whether the data can tell at all."""

import dataclasses
import hashlib
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from slippulse_jax.inference.identifiability import Identifiability
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.objective import Curve
from slippulse_jax.inference.parameters import Stiffness
from slippulse_jax.inference.uncertainty import Interval, chi_squared_tail
from slippulse_jax.lattice.front import Arrest, FrontStatus

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, eq=False)
class Root:
    """One minimum of χ²."""

    value: float
    chi2: float
    log_stderr: float | None  # standard error of ln(value) from the Fisher information; None at a corner of ℓ
    share_of_information: float | None  # what the response of the length makes up of the curvature of χ²/2; 1 at a good root
    ratio: np.ndarray  # k/K of each measurement
    rebreaks: np.ndarray  # whether the edge contact would break again before the front stops

    @property
    def stderr(self) -> float | None:
        """Standard error of the value, in its unit."""
        return None if self.log_stderr is None else self.value * self.log_stderr


@dataclasses.dataclass(frozen=True, eq=False)
class FitResult:
    """Outcome of `fit`. Start with `report()`, `identifiability` and `intervals`."""

    measurements: Measurements
    parameter: Stiffness
    value: float  # of highest likelihood, in parameter.unit
    log_stderr: float | None  # of ln(value), where there is one
    identifiability: Identifiability
    reason: str  # why, where there is no plain standard error
    level_intervals: dict[float, list[Interval]]
    roots: list[Root]  # not excluded at 95 %, best first
    chi2: float
    converged: bool
    outcomes: list[str]  # of the starts that did not converge
    fitted: Arrest  # count, length in λc, status of each measurement at `value`
    attainable: np.ndarray  # longest length of each measurement at any stiffness, in λc
    attainable_at: np.ndarray  # k/K where
    curve: Curve

    @property
    def values(self) -> dict[str, float]:
        """Value of highest likelihood: by the name of the parameter, and k/K where it is one number for all measurements."""
        return self._by_name(self.value)

    @property
    def stderr(self) -> dict[str, float | None]:
        """Standard error of each of `values`, from the Fisher information; None where `reason` says why."""
        return {name: None if self.log_stderr is None else value * self.log_stderr for name, value in self.values.items()}

    @property
    def intervals(self) -> dict[str, dict[float, list[Interval]]]:
        """Allowed values at each confidence level, in as many pieces as there are."""
        scale = {name: value / self.value for name, value in self.values.items()}
        return {
            name: {
                level: [piece._replace(low=piece.low * x, high=piece.high * x) for piece in pieces]
                for level, pieces in self.level_intervals.items()
            }
            for name, x in scale.items()
        }

    @property
    def correlations(self) -> dict[tuple[str, str], float]:
        """Correlations between fitted parameters: none while one is fitted."""
        return {}

    @property
    def dof(self) -> int:
        """Degrees of freedom, measurements less fitted parameters."""
        return len(self.measurements) - 1

    @property
    def p_value(self) -> float | None:
        """Probability of a χ² at least this large if model and σ are right; None without degrees of freedom."""
        return chi_squared_tail(self.chi2, self.dof) if self.dof else None

    @property
    def residuals(self) -> np.ndarray:
        """(fitted − measured)/σ, shape (n,)."""
        m = self.measurements
        return (np.asarray(self.fitted.length) - m.length) / m.length_sigma

    @property
    def notes(self) -> list[str]:
        """What a careful reader should know before using the numbers."""
        return list(_notes(self))

    def _by_name(self, value: float) -> dict[str, float]:
        ratio = self.parameter.ratio(value)
        named = {self.parameter.name: value}
        if np.ptp(ratio) <= 1e-12 * ratio[0]:
            named["stiffness"] = float(ratio[0])
        return named

    def report(self) -> str:
        """Text to read, and to paste into a paper's supplement."""
        from slippulse_jax.inference.report import report

        return report(self)

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {value:.4g}" for name, value in self.values.items())
        return f"FitResult({self.identifiability.name}: {values}; report() says more)"

    def __str__(self) -> str:
        return self.report()

    def to_dict(self) -> dict[str, Any]:
        """Everything of the result as plain Python values, ready for JSON; open ends and missing numbers are None."""
        m, p = self.measurements, self.parameter
        return {
            "identifiability": self.identifiability.name.lower(),
            "statement": self.identifiability.value,
            "reason": self.reason or None,
            "converged": self.converged,
            "values": self.values,
            "stderr": self.stderr,
            "units": {name: p.unit if name == p.name else "" for name in self.values},
            "intervals": {
                name: {f"{level:g}": [_ends(piece) for piece in pieces] for level, pieces in by_level.items()}
                for name, by_level in self.intervals.items()
            },
            "roots": [
                {
                    "values": self._by_name(root.value),
                    "stderr": _by_ratio(self._by_name(root.value), root),
                    "delta_chi2": _finite(root.chi2 - self.chi2),
                    "rebreaks": bool(root.rebreaks.any()),
                }
                for root in self.roots
            ],
            "searched": dict(zip(("low", "high"), p.bounds, strict=True)),
            "chi2": _finite(self.chi2),
            "dof": self.dof,
            "p_value": self.p_value,
            "measurements": [
                {
                    "line": m.lines[i] if m.lines else None,
                    "height": float(m.height[i]),
                    "poisson": float(m.poisson[i]),
                    "measured": float(m.length[i]),
                    "sigma": float(m.length_sigma[i]),
                    "fitted": _finite(float(self.fitted.length[i])),
                    "contacts_broken": int(self.fitted.contacts_broken[i]),
                    "front_status": FrontStatus(int(self.fitted.status[i])).name.lower(),
                    "attainable": float(self.attainable[i]),
                    "attainable_at_stiffness": float(self.attainable_at[i]),
                }
                for i in range(len(m))
            ],
            "notes": self.notes,
            "source": m.source,
            "data_sha256": data_hash(m),
        }

    def plot(self) -> "Figure":
        """Figure of data, fitted curve with its band, attainable range, and length against stiffness."""
        from slippulse_jax.inference.figure import draw_fit

        return draw_fit(self)


def data_hash(measurements: Measurements) -> str:
    """SHA-256 of the numbers that entered the fit, so that a result can be matched to its data."""
    m = measurements
    columns = [m.height, m.poisson, m.length, m.length_sigma, m.correlation_length, m.young]
    digest = hashlib.sha256()
    for column in columns:
        digest.update(b"none" if column is None else np.ascontiguousarray(column, "<f8").tobytes())
    return digest.hexdigest()


def _notes(result: FitResult):
    m = result.measurements
    if m.other:
        yield f"columns kept and not used: {', '.join(m.other)}"
    kinds = sorted({text for text in m.provenance if text})
    if kinds and kinds != ["measured"]:
        yield f"provenance: {', '.join(kinds)}"
    rows = set(zip(m.specimen or [""] * len(m), m.height, m.poisson, m.length, m.length_sigma, strict=True))
    if len(rows) < len(m):
        yield f"{len(m) - len(rows)} measurement(s) repeat another one exactly: each counts as a measurement of its own"
    if m.in_si and m.young is None:
        yield "no young_GPa: the areal stiffness in Pa/m cannot be had, only its ratio to Young's modulus"
    above = m.length - m.length_sigma > result.attainable
    if above.any():
        i = int(np.argmax(m.length / result.attainable))
        where = f"line {m.lines[i]}" if m.lines else f"measurement {i}"
        yield (
            f"{int(above.sum())} length(s) lie more than σ above the longest that a stiffness in the range searched gives; "
            f"worst at {where}: "
            f"{m.length[i]:.6g} λc, attainable {result.attainable[i]:.6g} λc"
        )
    if any(root.rebreaks.any() for root in result.roots[:1]):
        yield (
            "at the fitted stiffness the contact at the edge would be back at its threshold before the front stops: the length "
            "is that of the first front alone"
        )
    for outcome in result.outcomes:
        yield f"a start {outcome}"


def _by_ratio(values: dict[str, float], root: Root) -> dict[str, float | None]:
    return {name: None if root.log_stderr is None else value * root.log_stderr for name, value in values.items()}


def _finite(x: float) -> float | None:
    return x if math.isfinite(x) else None


def _ends(piece: Interval) -> list[float | None]:
    return [None if piece.open_low else piece.low, None if piece.open_high else piece.high]
