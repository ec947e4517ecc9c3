"""Lengths of precursors: values, counts of contacts, and lower limits."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax.scipy import special
from jax.typing import ArrayLike
from jaxtyping import Array, Float
from scipy.special import erf

from slippulse_jax.inference.model.front import Along, Front, Predicted
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.observables.observable import SHARPEST, Observable, Observations, Prediction, Reading, weighted
from slippulse_jax.inference.table.columns import COLUMNS
from slippulse_jax.inference.table.measurements import Measurements

if TYPE_CHECKING:
    from slippulse_jax.inference.parameters import ParameterSet
    from slippulse_jax.inference.result.result import FitResult


class Length(Observable):
    """A measured length ± σ."""

    name = "length"
    noun = "length"
    kind = "length"  # by which the table states it
    column = COLUMNS["length"]
    of_rows = True
    acts: ClassVar[Mapping[str, float]] = {"correlation_length": 1, "model_factor": 1}
    added = "offset"

    def data(self, m: Measurements, q: "ParameterSet") -> Observations | None:
        """Rows of this kind."""
        rows = np.flatnonzero(np.array(m.kind) == self.kind)
        return self.observations(q, rows, m.length[rows], m.stated_sigma[rows], q.inputs.take(rows)) if rows.size else None

    def predict(self, model: Front, inputs: Inputs, relaxed: bool, *options: Any) -> Array:
        """Length in λc."""
        return model.length(inputs, relaxed)

    def in_rows(self, model: Front, inputs: Inputs, relaxed: bool, *options: Any) -> Float[Array, " m"]:
        """Lengths of every row, by the model's own loop."""
        return model.in_rows(inputs, relaxed, *options)

    def evaluate(self, model: Front, inputs: Inputs, along: Along = None) -> Predicted:
        """Lengths of many lanes, as the model computes them."""
        return model.evaluate(inputs, along)

    def of_drawn(self, inputs: Inputs) -> Any:
        """What is drawn is over this: H, in λc."""
        return jnp.exp(inputs.log_height)

    def in_table(self, m: Measurements) -> tuple[np.ndarray, str]:
        """λc in the unit of the table, and that unit."""
        return m.unit

    def table(self, result: "FitResult") -> list[list[str]]:
        """Every length of the table: measured with the σ used, fitted, misfit."""
        m, (scale, unit), (counted, numbers) = result.measurements, result.measurements.unit, result.measurements.numbered
        sigma = result.sigma * (result.identifiability.name != "NO_SCATTER")  # whether σ has a size
        several, push = len(set(m.specimen)) > 1, m.push_height if result.parameters.front.body == "block" else None
        height = f"H/{unit}" if push is None else f"H, push/{unit}"
        rows = [[counted + ", specimen" * several, height, f"measured/{unit}", f"fitted/{unit}", "(fit-meas)/σ"]]
        for i, number in enumerate(numbers):
            off, error = f"{result.residuals[i]:+.2f}".replace("-0.00", "+0.00"), sigma[i] * scale[i]
            if m.kind[i] != "length" and result.residuals[i] == 0:
                off = "holds"  # a count or a front without arrest
            elif not result.sigma[i] > 0:
                off = f"off by {off} λc"
            text = f" ± {float(f'{error:.2g}'):g}" if error > 0 else ""
            length = f"{m.length[i] * scale[i]:.5g}{text}"
            if m.kind[i] == "whole":
                length = f"{length} ({m.length[i]:g} contacts)" if m.in_si else f"{m.length[i]:g}{text} contacts"
            rows.append(
                [
                    f"{number} {m.specimen[i]}" if several else str(number),
                    f"{m.height[i] * scale[i]:.6g}" + ("" if push is None else f", {push[i] * scale[i]:.4g}"),
                    "> " * (m.kind[i] == "at_least") + length,
                    f"{result.fitted[i] * scale[i]:.5g}",
                    off,
                ]
            )
        return rows

    def notes(self, result: "FitResult") -> Iterator[str]:
        """What the model has to say."""
        return result.parameters.front.remarks(result.measurements)

    def details(self, result: "FitResult") -> Iterator[str]:
        """Broken contacts, and the longest length of each measurement."""
        m, (scale, unit) = result.measurements, result.measurements.unit
        yield "broken contacts, and the longest length attainable at any stiffness searched:"
        for i, broken in enumerate(result.contacts_broken):
            yield f"  {m.number(i)}: {broken if broken > 0 else 'all'}, {result.attainable[i] * scale[i]:.5g} {unit}"

    def options(self, model: Front, data: Observations, low: np.ndarray, high: np.ndarray) -> tuple[Any, ...]:
        """What the model needs of the largest height of each row."""
        return model.most(data.inputs.log_height(np.stack([low, high])).max(axis=0), data.inputs.names)


@dataclasses.dataclass(frozen=True)
class Count(Length):
    """A count of n broken contacts, whose front ended in the n-th.

    A length between n − 1 and n. A count of 1 is any length up to 1, 0 included: contact 0 breaks even where no domino starts.
    """

    sharpest: float = SHARPEST  # least blur of its ends

    name = noun = "count"
    kind = "whole"
    is_value = False
    counts = True

    def log_density(self, predicted: Prediction, read: Reading) -> Float[Array, ""]:
        """Logarithm of Φ((n − μ)/σ) − Φ((n − 1 − μ)/σ).

        With a blur σ; of a count of 1 ln Φ((1 − μ)/σ).
        """
        value, blur = read.value, jnp.maximum(blurred(predicted, read), self.sharpest)
        finite = jnp.isfinite(predicted.mean)
        inside = jnp.where(finite, predicted.mean, value)
        a, b = (value - 1 - inside) / blur, (value - inside) / blur
        # in the upper tail subtract the two tails, not two numbers close to one
        bounded = value > 1
        flip = bounded & (a > 0)
        lower, upper = jnp.where(flip, -b, a), jnp.where(flip, -a, b)
        top = log_ndtr(upper)
        below = jnp.where(bounded, jnp.minimum(log_ndtr(lower) - top, -1e-300), -jnp.inf)
        return -weighted(jnp.where(finite, -top - jnp.log1p(-jnp.exp(below)), jnp.inf), read.weight)

    def perfect(self, read: Reading) -> np.ndarray:
        """Cost of the middle of each count."""
        middle = -np.log(erf(1 / (np.sqrt(8) * np.maximum(read.sigma, SHARPEST))))
        return np.where(np.asarray(read.value) > 1, middle, 0.0)

    def outside(self, off: np.ndarray) -> np.ndarray:
        """How far a length lies outside the last contact."""
        return np.where(off > 0, off, np.minimum(off + 1, 0))

    def simulated(self, drawn: np.ndarray, value: np.ndarray) -> np.ndarray:
        """Counts of whole contacts."""
        return np.maximum(np.ceil(drawn), 1)


class Limit(Length):
    """A length that a front ran past, without arrest."""

    name = "limit"
    noun = "lower limit"
    kind = "at_least"
    is_value = False

    def log_density(self, predicted: Prediction, read: Reading) -> Float[Array, ""]:
        """Ln Φ((μ − value)/σ); 0 where the front never stops."""
        finite = jnp.isfinite(predicted.mean)
        off = jnp.where(finite, predicted.mean, read.value) - read.value
        cost = -log_ndtr(off / jnp.maximum(blurred(predicted, read), SHARPEST))
        return -weighted(jnp.where(finite, cost, jnp.where(jnp.isnan(predicted.mean), jnp.inf, 0)), read.weight)

    def outside(self, off: np.ndarray) -> np.ndarray:
        """How much shorter a length is."""
        return np.minimum(off, 0)

    def simulated(self, drawn: np.ndarray, value: np.ndarray) -> np.ndarray:
        """The same limit again."""
        return np.broadcast_to(value, drawn.shape)


def blurred(predicted: Prediction, read: Reading) -> Array:
    """Errors of reading, and of what the model leaves open."""
    return read.sigma if predicted.covariance is None else jnp.sqrt(read.sigma**2 + jnp.diag(predicted.covariance))


def log_ndtr(x: ArrayLike) -> Array:
    """Logarithm of the normal distribution function, far down by its series."""
    x = jnp.asarray(x)
    is_far = x < -20
    far = jnp.where(is_far, x, -20.0)
    series = jnp.ones_like(far)
    for k in range(10, 0, -1):
        series = 1 - (2 * k - 1) / far**2 * series
    tail = -(far**2) / 2 - jnp.log(-far) - np.log(2 * np.pi) / 2 + jnp.log(series)
    return jnp.where(is_far, tail, special.log_ndtr(jnp.where(is_far, -20.0, x)))
