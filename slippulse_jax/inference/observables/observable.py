"""Protocol of an observable: its data, predictions and words.

A prediction is a distribution at θ: a mean, and the covariance of what the model leaves open there. Its log density is that of
the normal distribution with the errors of reading added; an observable whose readings are no numbers with errors, as a count,
has its own. Data of several observables add up.
"""

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.inference.choices import Loss
from slippulse_jax.inference.model.emulator import Outputs
from slippulse_jax.inference.model.front import Along, Front, Predicted, by_jax
from slippulse_jax.inference.model.inputs import Input, Inputs, Linear
from slippulse_jax.inference.table.columns import COLUMNS, ERROR_OF_READING, NUMBER, OVER_ALL, Column, MeasurementError
from slippulse_jax.inference.table.measurements import Measurements

if TYPE_CHECKING:
    from slippulse_jax.inference.parameters import ParameterSet
    from slippulse_jax.inference.result.result import Compared, FitResult

STUDENT_DOF = 4.0
SHARPEST = 1e-4
"""Blur, in λc, used for σ = 0 at the ends of a count's interval, so that the likelihood has a slope there."""


class Draws(NamedTuple):
    """What n data may be on contacts that differ: K draws."""

    value: Any  # (n, K)
    stops: Any  # (n, K), whether it is a number, and not inf
    width: Any  # (n, K), of what stands for each in the density
    weight: Any  # (n, K), how probable each is
    group: Any  # (n,), number of the event that each datum belongs to, less than n


class Prediction(NamedTuple):
    """What a model says of n data at one θ."""

    mean: Any  # (n,), inf where a front never stops, or nothing is known
    covariance: Any = None  # (n, n), of what the model leaves open; None where it is exact
    draws: Draws | None = None  # where the data are draws
    heavy: Any = (
        None  # (n,), above 0 where the error has heavy tails, in the order in which each follows on others; None without
    )


class Reading(NamedTuple):
    """What was measured: n values, their errors, and how often each counts."""

    value: Any  # (n,)
    sigma: Any  # (n,)
    weight: Any  # (n,)


class Observations(NamedTuple):
    """Data of one observable: n of R replicates, 1 as measured."""

    observable: "Observable"
    value: np.ndarray  # (R, n), in λc, m or N/m; the count, or the length run past
    sigma: np.ndarray  # (n,)
    weight: np.ndarray  # (R, n), how often a datum counts
    measurement: np.ndarray  # (n,), which measurement each datum belongs to
    inputs: Inputs  # a `Linear` of length m each: the distinct inputs of the model
    rows: np.ndarray  # (n,), which of them each datum has
    scale: Linear  # (n,), ln of the unit of the data in that of the model
    offset: Linear  # (n,)
    more: dict[str, np.ndarray] = {}  # what else each datum is read by, (n,)

    def predicted(self, found: Prediction, theta: Array) -> Prediction:
        """Convert a prediction to the unit of the data."""
        size, covariance = jnp.exp(self.scale(theta)), found.covariance
        covariance = None if covariance is None else covariance * size[:, None] * size[None]
        offset, draws = self.offset(theta), found.draws
        if draws is not None:
            draws = draws._replace(value=draws.value * size[:, None] + offset[:, None], width=draws.width * size[:, None])
        return found._replace(mean=found.mean * size + offset, covariance=covariance, draws=draws)

    def reading(self, value: Any = None, weight: Any = None) -> Reading:
        """Readings as measured, or of a replicate."""
        return Reading(self.value[0] if value is None else value, self.sigma, self.weight[0] if weight is None else weight)


@dataclasses.dataclass(frozen=True)
class Observable:
    """A kind of datum: its column, data, prediction and words.

    A new kind is a class with `name`, `noun`, `column`, `acts` and `predict`; the rest follows.
    """

    loss: Loss = "normal"
    drawn: bool = False  # whether the model draws its data, of contacts that differ

    name: ClassVar[str]
    noun: ClassVar[str]  # one datum in words, as "length"
    column: ClassVar[Column]  # of its values; that of their errors follows
    of_rows: ClassVar[bool] = False  # whether it is what the rows of a table are about
    is_value: ClassVar[bool] = True  # whether a datum is a value with an error, and no interval
    inputs: ClassVar[Mapping[str, Input]] = {}  # beside those of the model
    outputs: ClassVar[int] = 0  # of an emulator for each datum; 0 where predictions are exact
    drawn_as: ClassVar[int] = 0  # which number of an event that was drawn it is
    counts: ClassVar[bool] = False  # whether a datum is a number of contacts
    steps: ClassVar[bool] = False  # whether predictions step from contact to contact
    acts: ClassVar[Mapping[str, float]] = {}  # what a unit of θ adds to ln of the unit of the data, by parameter
    added: ClassVar[str] = ""  # parameter that is added to the prediction

    # --- data

    def there(self, m: Measurements) -> bool:
        """Whether measurements have it."""
        return bool(np.isfinite(self.read(m)[0]).any())

    def stated_by(self, m: Measurements) -> str:
        """What states it, for messages."""
        return f"{m.source}, column {self.heading(m)}: what it states"

    def heading(self, m: Measurements) -> str:
        """Name of its column in the table."""
        own = m.heading(self.column.quantity)
        return next((name for name in (own, *m.other) if name in self.column.names(m.in_si)), own)

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse rows and parameters without a meaning; a ValueError names them."""

    def data(self, m: Measurements, q: "ParameterSet") -> Observations | None:
        """Data that measurements have; None without any."""
        value, sigma = self.read(m)
        rows = np.flatnonzero(np.isfinite(value))
        return self.observations(q, rows, value[rows], sigma[rows], q.inputs.take(rows)) if rows.size else None

    def read(self, m: Measurements) -> tuple[np.ndarray, np.ndarray]:
        """Values and errors of every measurement, (n,) each.

        NaN where there is none.

        From the columns that measurements have, or those that they kept as text.
        """
        value, sigma = (_numbers(m, column) for column in (self.column, self._error))
        for i in np.flatnonzero(np.isfinite(value) & np.isnan(sigma)).tolist():
            own = self._error.name(m.in_si)
            raise MeasurementError(f"{m.place(i)}, column {own}: missing: the value beside it has no standard error")
        return value, sigma

    @property
    def _error(self) -> Column:
        """Column of the errors of its values."""
        return Column(f"{self.column.quantity}_sigma", self.column.unit, self.column.plain, ERROR_OF_READING)

    def observations(
        self, q: "ParameterSet", rows: np.ndarray, value: np.ndarray, sigma: np.ndarray, inputs: Inputs, **more: np.ndarray
    ) -> Observations:
        """Collect data, with each distinct input once."""
        if self.drawn:  # of one event, whatever was measured of it
            found, own = q.inputs.distinct()
            m = q.measurements
            kept = [m.specimen.index(m.specimen[i]) if m.thresholds and m.thresholds[i] == "kept" else i for i in range(len(m))]
            own, more = own[rows], {**more, "group": np.array(kept)[rows]}
        else:
            found, own = inputs.distinct()
        scale = q.linear(*self.unit(q.measurements))
        offset = q.linear(np.zeros(len(scale.base)), {self.added: 1} if self.added else {})
        return Observations(
            observable=self,
            value=value[None],
            sigma=sigma,
            weight=np.ones((1, len(rows))),
            measurement=rows,
            inputs=found,
            rows=own,
            scale=scale[rows],
            offset=offset[rows],
            more=more,
        )

    def unit(self, m: Measurements) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Logarithm of the unit, (n,), and what acts on it.

        Of the data, in the unit of the model.
        """
        return np.zeros(len(m)), self.acts

    # --- predictions

    @property
    def emulated(self) -> bool:
        """Whether an emulator predicts it, with an error of its own."""
        return self.outputs > 0 or self.drawn

    def predict(self, model: Front, inputs: Inputs, relaxed: bool, *options: Any) -> Array:
        """Predict one row of inputs, in JAX.

        With derivatives in forward mode.
        """
        raise NotImplementedError

    def in_rows(self, model: Front, inputs: Inputs, relaxed: bool, *options: Any) -> Float[Array, " m"]:
        """`predict` of every row."""
        return jax.vmap(lambda one: self.predict(model, one, relaxed, *options))(inputs)

    def evaluate(self, model: Front, inputs: Inputs, along: Along = None) -> Predicted:
        """Predictions of many lanes, and their derivatives along a line."""
        return by_jax(of_one, model, inputs, along, observable=self)

    def options(self, model: Front, data: Observations, low: np.ndarray, high: np.ndarray) -> tuple[Any, ...]:
        """What `in_rows` needs of the range searched, (p,) each."""
        return ()

    def emulate(self, outputs: Outputs, inputs: Inputs, data: Observations, *, single: bool = False) -> Prediction:
        """Predict by the outputs of emulators, or of `single` points.

        One for each row of inputs. Here by draws (`model.scattered.Drawn`).
        """
        one = jax.tree.map(lambda x: x[data.rows], outputs)
        size, which = self.of_drawn(inputs)[data.rows], self.drawn_as
        stops = jnp.isfinite(one.value[:, which])  # inf times a slope of 0 is NaN
        one = one._replace(value=jnp.where(jnp.isfinite(one.value), one.value, 0))
        mean, spread, value, width = (x[:, which] * size.reshape(-1, *[1] * (x.ndim - 2)) for x in one[:4])
        return Prediction(mean, jnp.diag(spread**2), Draws(value, stops, width, one.weight, 1.0 * data.more["group"]))

    def of_drawn(self, inputs: Inputs) -> Any:
        """What draws are over: the prediction of contacts that are alike."""
        return jax.vmap(lambda one: self.predict(Front(), one, False))(inputs)

    def read_series(self, series: Any, sites: np.ndarray, inputs: Inputs, more: Mapping[str, np.ndarray]) -> np.ndarray:
        """Read outputs of n data of one unit from t points.

        Of shape (t, n, outputs); what could not be read is NaN.
        """
        raise NotImplementedError

    # --- density

    def of_events(self, mean: Array, width: Array, read: Reading, group: Array, count: int) -> Float[Array, "e K"]:
        """Log density of all that was read of each event.

        By means of n readings, (n, K), with an error that those of one of the `count` events share; `group` is the event of
        each.
        """

        def added(x: Array) -> Array:
            return jax.ops.segment_sum(x, group, count)

        def alone(mean: Array, width: Array, *datum: Array) -> Array:
            return self.log_density(Prediction(mean[None], width[None, None] ** 2), Reading(*(x[None] for x in datum)))

        if not self.is_value:
            return added(jax.vmap(jax.vmap(alone, (0, 0, None, None, None)))(mean, width, *read))
        there = jnp.isfinite(mean)
        each = (read.weight / read.sigma**2)[:, None]
        off = jnp.where(there, read.value[:, None] - jnp.where(there, mean, 0), 0)
        known, first, second = map(added, (jnp.broadcast_to(each, off.shape), each * off, each * off**2))
        shared = jnp.zeros_like(known).at[group].set(width**2)
        found = -(second - shared * first**2 / (1 + shared * known) + jnp.log1p(shared * known)) / 2
        return jnp.where(added(jnp.where(there, 0.0, each)) > 0, -jnp.inf, found)

    def log_density(self, predicted: Prediction, read: Reading) -> Float[Array, ""]:
        """Log density of readings, without the constant of errors of reading alone."""
        finite = jnp.isfinite(predicted.mean)
        off = jnp.where(finite, predicted.mean, read.value) - read.value
        if predicted.covariance is None:
            cost = loss_of((off / read.sigma) ** 2 / 2, self.loss)
            return -weighted(jnp.where(finite, cost, jnp.inf), read.weight)
        used, heavy = read.weight > 0, jnp.zeros(len(off)) if predicted.heavy is None else predicted.heavy
        last = jnp.argsort(heavy, stable=True)  # those with heavy tails, each given all before it
        left = _left(predicted.covariance, read.sigma, used)[last][:, last]
        off, log_det = whitened(left, jnp.where(used, off, 0)[last, None])
        half = jnp.square(off[:, 0]) / 2
        cost = jnp.where(heavy[last] > 0, loss_of(half, "student"), half).sum()
        cost = cost + log_det - jnp.where(used, jnp.log(read.sigma), 0).sum()
        return -jnp.where((finite | ~used).all(), cost, jnp.inf)

    def perfect(self, read: Reading) -> np.ndarray:
        """Cost of each reading that the model meets exactly, (n,)."""
        return np.zeros(len(read.sigma))

    def outside(self, off: np.ndarray) -> np.ndarray:
        """How far a prediction lies outside what was read.

        Of prediction less value.
        """
        return off

    def simulated(self, drawn: np.ndarray, value: np.ndarray) -> np.ndarray:
        """What would be read of values with errors."""
        return drawn

    def uses(self, m: Measurements) -> set[str]:
        """Columns that measurements kept as text, and that it reads."""
        return {*m.other} & {name for one in (self.column, self._error) for name in one.names(m.in_si)}

    # --- words and pictures

    @property
    def named(self) -> str:
        """Heading of its data in a report."""
        return self.noun

    @property
    def several(self) -> str:
        """What its data are called in a list."""
        return self.noun

    framed: ClassVar[str] = ""  # beginning of the names of its columns in a DataFrame, where it is not that of its own column
    rows_are: ClassVar[str] = "lengths"  # of what the rows of a table are about

    def places(self, m: Measurements, data: Observations) -> list[str]:
        """Where each datum was measured, for messages."""
        return [m.place(i) for i in data.measurement.tolist()]

    def in_table(self, m: Measurements) -> tuple[np.ndarray, str]:
        """Factor to the unit of the table, (n,), and that unit."""
        own, column = self.heading(m), self.column
        size = column.names(in_si=True).get(own)
        if size is None:
            return np.ones(len(m)), column.si
        width = m.or_zero("block_width") if own.endswith(OVER_ALL) else 1.0
        return width / np.full(len(m), size), own.removeprefix(f"{column.quantity}_").replace("_per_", "/")

    def shown(self, m: Measurements, one: "Compared") -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
        """Convert values, errors and fitted values to the table's unit.

        With the name of that unit.
        """
        size, unit = self.in_table(m)
        each = size[one.measurement]
        return one.value * each, one.sigma * each, one.fitted * each, unit

    def table(self, result: "FitResult") -> list[list[str]]:
        """Rows of the table of a report, the heading first."""
        raise NotImplementedError

    def draw(self, result: "FitResult", one: "Compared", ax: Any) -> None:
        """Draw readings ± σ, and fitted values, against the height."""
        m, (value, sigma, fitted, unit) = result.measurements, self.shown(result.measurements, one)
        scale, of_height = m.unit
        x = (m.height * scale)[one.measurement]
        ax.errorbar(x, value, sigma, fmt="o", capsize=2, label="measured ± σ")
        ax.plot(x, fitted, "_", ms=10, mew=2, label="fitted")
        ax.set(xlabel=f"height, $H$ ({of_height})", ylabel=f"{self.noun} ({unit})" if unit else self.noun)

    def notes(self, result: "FitResult") -> Iterator[str]:
        """Remarks to read before using the numbers."""
        return iter(())

    def details(self, result: "FitResult") -> Iterator[str]:
        """Further lines of a verbose report."""
        return iter(())

    def runs(self, m: Measurements) -> np.ndarray | None:
        """Number of the sequence of each row, (n,), if any."""
        return None

    def extent(self, m: Measurements) -> np.ndarray | None:
        """Extent over the block of each row, for pictures, if any."""
        return None


def of_one(model: Front, inputs: Inputs, relaxed: bool, *, observable: Observable, options: tuple[Any, ...] = ()) -> Array:
    """Predict one row, as a function of all that it depends on."""
    return observable.predict(model, inputs, relaxed, *options)


def loss_of(half_square: Any, loss: Loss = "normal") -> Array:
    """Loss as a function of r²/2; its derivative weights a residual."""
    u = jnp.asarray(half_square)
    return (STUDENT_DOF + 1) / 2 * jnp.log1p(2 * u / STUDENT_DOF) if loss == "student" else u


def weighted(cost: Array, weight: Array) -> Float[Array, ""]:
    """Sum costs by weight.

    A datum that is left out may cost inf, and 0 times inf is NaN.
    """
    return (weight * jnp.where(weight > 0, cost, 0)).sum()


def _left(covariance: Array, sigma: Array, used: Array) -> Array:
    """Add errors of reading to a covariance.

    Data that are left out are independent, of σ = 1.
    """
    every = covariance + jnp.diag(sigma**2)
    return jnp.where(used[:, None] & used[None], every, 0) + jnp.diag(jnp.where(used, 0.0, 1.0))


def whitened(covariance: Float[Array, "n n"], off: Float[Array, "n c"]) -> tuple[Float[Array, "n c"], Float[Array, ""]]:
    """Convert columns to independent errors; return ln(determinant)/2 too.

    By elimination in order, with derivatives in every mode: a library's, of many matrices, may wait for its own threads.
    """

    def eliminate(left: tuple[Array, Array], k: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        matrix, columns = left
        pivot = matrix[k, k]
        share = matrix[:, k] / pivot
        white = columns[k] / jnp.sqrt(pivot)
        rest = matrix - share[:, None] * matrix[k][None], columns - share[:, None] * columns[k][None]
        return rest, (white, jnp.log(pivot) / 2)

    _, (white, logs) = lax.scan(eliminate, (covariance, off), jnp.arange(len(covariance)))
    return white, logs.sum()


def _numbers(m: Measurements, column: Column) -> np.ndarray:
    """Read a column of numbers in SI or λc, (n,).

    NaN where it is blank, or not there.
    """
    known = getattr(m, column.quantity, None)
    if column.quantity in COLUMNS:
        return np.full(len(m), np.nan) if known is None else known
    for own, size in column.names(m.in_si).items():
        if own not in m.other:
            continue
        found = np.full(len(m), np.nan)
        for i, cell in enumerate(m.other[own]):
            if not NUMBER.fullmatch(cell or "0"):
                raise MeasurementError(f"{m.place(i)}, column {own}: {cell!r}: must be a number")
            found[i] = float(cell) * size if cell else np.nan
            if cell and not column.domain.holds(found[i]):
                raise MeasurementError(f"{m.place(i)}, column {own}: {cell}: {column.domain.requirement}")
        return found
    return np.full(len(m), np.nan)
