"""Sequences of a block: forces at places, and first lengths.

An event that reached ℓ at the force F says that the front first reaches ℓ at F, whatever crept before it; so data are paired by
place, never by the number of the event.
"""

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from slippulse_jax.inference.model.emulator import UNSURE, Outputs
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.series import SITES, Followed
from slippulse_jax.inference.observables.observable import Observable, Observations, Prediction
from slippulse_jax.inference.table.columns import COLUMNS, NUMERIC, OVER_ALL
from slippulse_jax.inference.table.measurements import Measurements

if TYPE_CHECKING:
    from slippulse_jax.inference.parameters import ParameterSet
    from slippulse_jax.inference.result.result import Compared, FitResult

ROUGHNESS = 0.01
"""How far forces by place of a single series lie from the trend, in μF_N: to rank series before there is an emulator."""
NEAR_END = 0.05
"""Part of the block within which a length that is stated of an event that spans is its end."""
VISIBLE = 1.5
"""Contacts by which an event advances, at least, to be seen."""


class Record(NamedTuple):
    """What a table says of its sequences, by row."""

    run: np.ndarray  # number of the sequence
    place: np.ndarray  # over the length of the block; just below 1 where the event spans
    error: np.ndarray  # of the place; 0 where the event spans
    first: np.ndarray  # whether it is the first event of its sequence, by its number
    heads: np.ndarray  # the first row of each sequence


def record_of(m: Measurements) -> Record:
    """Read the sequences of a table."""
    none = np.zeros(len(m), int)
    keys = list(zip(m.sequence or none, m.specimen or none, strict=True))
    run = np.array([list(dict.fromkeys(keys)).index(key) for key in keys])
    ends = np.full(len(m), np.nan) if m.block_length is None else m.block_length
    spans = np.array(m.kind) == "at_least"
    place = np.where(spans, np.nextafter(1.0, 0), m.length / ends)
    # of a front between two contacts; and of contacts of another size
    own = np.where(ends > SITES, 1.0, 0.5) / np.minimum(ends, SITES)
    error = np.where(spans, 0.0, np.hypot(np.nan_to_num(m.sigma) / ends, own))
    return Record(run, place, error, m.or_zero("event") == 1, np.unique(run, return_index=True)[1])


class OfSequence(Observable):
    """A datum of a sequence, predicted by an emulator through many series."""

    def of_run(
        self, q: "ParameterSet", rows: np.ndarray, value: np.ndarray, sigma: np.ndarray, record: Record, **more: np.ndarray
    ) -> Observations:
        """Collect data of rows, with the inputs of each sequence once."""
        found = self.observations(q, rows, value, sigma, q.inputs.take(rows), **more)
        return found._replace(inputs=q.inputs.take(record.heads), rows=record.run[rows])


class PlaceForce(OfSequence):
    """Force at which the front of a block first reaches a place.

    Or that of a numbered event that ends there.
    """

    name = "place_force"
    noun = "force"
    column = COLUMNS["force"]
    of_rows = True
    outputs = 2
    acts: ClassVar[Mapping[str, float]] = {"normal_load": 1}
    added = "force_offset"

    def unit(self, m: Measurements) -> tuple[np.ndarray, Mapping[str, float]]:
        """Unit of forces over the normal load.

        And the width, if only one of the two is stated over all of it.
        """
        force, load = (float(m.heading(name).endswith(OVER_ALL)) for name in ("force", "normal_load"))
        base = np.zeros(len(m)) if m.normal_load is None else np.log(m.normal_load)
        return base, {**self.acts, "block_width": force - load}

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse rows of several blocks, and lengths that are no places."""
        if shared := {"model_factor", "offset"} & {*names}:
            raise ValueError(
                f"parameter {min(shared)}: of lengths; what a model of a sequence leaves out is an error of forces"
            )
        _check_alike(m)
        kind = np.array(m.kind)
        short = (kind == "at_least") & (m.length < (1 - NEAR_END) * m.or_zero("block_length"))
        if (wrong := (kind == "whole") | short).any():
            where = "a sequence has places, and the end of the block where the event spans (spans, or kind at_least)"
            raise ValueError(f"{m.place(i := int(np.argmax(wrong)))}: {m.in_its_unit(i, m.length[i])}, {kind[i]}: {where}")
        for name, row in (("force", m.force), ("normal_load", m.normal_load)):
            if row is not None and np.isnan(row).any():
                raise ValueError(f"{m.place(int(np.argmax(np.isnan(row))))}, column {m.heading(name)}: missing")

    def data(self, m: Measurements, q: "ParameterSet") -> Observations | None:
        """The force of every row."""
        value, sigma = self.read(m)
        record, rows = record_of(m), np.arange(len(m))
        numbered = np.full(len(m), m.event is not None)
        read_as = {"place": record.place, "error": record.error, "numbered": numbered, "first": record.first}
        return self.of_run(q, rows, value, sigma, record, **read_as)

    def read_series(self, series: Followed, sites: np.ndarray, inputs: Inputs, more: Mapping[str, np.ndarray]) -> np.ndarray:
        """Forces over the normal load, and spreads by errors of places."""
        arrested = more["error"] > 0
        place = more["place"] * np.exp(-inputs.get("log_extent")[:, None] * arrested)  # over the length that the block then has
        found = series.force_at(place, more["error"])
        ends = more["numbered"] & arrested
        if ends.any():
            found[:, :, ends] = series.force_of_arrest(place[:, ends], more["error"][ends], VISIBLE / sites)
        if (own := more["first"] & ends).any():
            found[0][:, own], found[1][:, own] = series.first(VISIBLE / sites)[1][:, None], 0.0
        return np.moveaxis(found, 0, -1) * inputs.get("friction")[:, None, None]

    rows_are = "forces"

    def runs(self, m: Measurements) -> np.ndarray:
        """Number of the sequence."""
        return record_of(m).run

    def extent(self, m: Measurements) -> np.ndarray:
        """Place over the length of the block."""
        return record_of(m).place

    def table(self, result: "FitResult") -> list[list[str]]:
        """Places, and the forces at which the front first reached them."""
        m, (scale, unit), (counted, numbers) = result.measurements, result.measurements.unit, result.measurements.numbered
        (size, newton), named, (one, *_) = m.unit_of_force, bool(m.sequence), result.data
        rows = [[counted + ", sequence" * named, f"reached/{unit}", f"force/{newton}", f"fitted/{newton}", "(fit-meas)/σ"]]
        for i, number in enumerate(numbers):
            rows.append(
                [
                    f"{number} {m.sequence[i]}" if named else str(number),
                    f"{m.length[i] * scale[i]:.4g}" + " (spans)" * (m.kind[i] == "at_least"),
                    f"{one.value[i] * size[i]:.5g} ± {float(f'{one.sigma[i] * size[i]:.2g}'):g}",
                    f"{one.fitted[i] * size[i]:.5g}",
                    f"{one.residuals[i]:+.2f}".replace("-0.00", "+0.00"),
                ]
            )
        return rows

    def notes(self, result: "FitResult") -> Iterator[str]:
        """State what σ contains, what is no record, and assumptions."""
        m, problem, q = result.measurements, result.problem, result.parameters
        if m.length_sigma is None:
            yield "no standard errors of lengths were given: places count as exact, and no first length is fitted"
        error = float(problem.observed[0].inputs.get("model_error").base[0])
        of_model = f"; it also contains {error:.2g} μF_N for what the model leaves out" if error else ""
        taken = "" if problem.known else ", taken from how far the forces lie from the fit"
        if problem.known and result.request.get("model_error") == "fitted":
            taken = ", the largest that is taken from data, and not enough"
        yield (
            "σ of every force contains the error of its place, and the spread of single series about their trend"
            f"{of_model}{taken}; neighbours err together, so χ² is not the sum of these squares"
        )
        yield from no_record(m)
        names = {one.name for one in q.free} | {*q.held}
        if "newborn" in names and "time_constant" not in names:
            yield "assumed: contacts age over τ = 1 u_s, as time_constant is neither fitted nor held"

    def emulate(self, outputs: Outputs, inputs: Inputs, data: Observations, *, single: bool = False) -> Prediction:
        """Predict forces, with errors of places, model and emulator.

        Neighbours, which may be of one event, err together.
        """
        friction, rough = inputs.get("friction")[data.rows], ROUGHNESS * single
        own = outputs.mean[data.rows, data.more["column"] + 1] ** 2
        own = own + friction**2 * (inputs.get("model_error")[data.rows] ** 2 + rough**2)
        found = joint(outputs, data)
        return Prediction(found.mean, found.covariance + jnp.diag(own))


class FirstLength(OfSequence):
    """First length of numbered events over that of the block.

    Its logarithm.
    """

    name = framed = "first_length"
    noun = "first length"
    column = COLUMNS["length"]
    outputs = 1

    def data(self, m: Measurements, q: "ParameterSet") -> Observations | None:
        """One datum for each sequence whose first length has an error."""
        record = record_of(m)
        rows = np.flatnonzero(record.first & (record.error > 0) & (m.sigma > 0))
        if not rows.size or m.block_length is None:
            return None
        value = np.log(m.length[rows] / m.block_length[rows])
        return self.of_run(q, rows, value, m.sigma[rows] / m.length[rows], record)

    def read_series(self, series: Followed, sites: np.ndarray, inputs: Inputs, more: Mapping[str, np.ndarray]) -> np.ndarray:
        """The first length that is seen; without an event none."""
        length, _ = series.first(VISIBLE / sites)
        with np.errstate(divide="ignore"):
            return (np.log(length) + inputs.get("log_extent"))[:, None, None]

    def shown(self, m: Measurements, one: "Compared") -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
        """Lengths in the unit of the table."""
        (scale, unit), rows = m.unit, one.measurement
        ends = m.or_zero("block_length")[rows] * scale[rows]
        return np.exp(one.value) * ends, np.exp(one.value) * ends * one.sigma, np.exp(one.fitted) * ends, unit

    def emulate(self, outputs: Outputs, inputs: Inputs, data: Observations, *, single: bool = False) -> Prediction:
        """The length, with how far series lie from the emulator."""
        return joint(outputs, data)


def joint(outputs: Outputs, data: Observations) -> Prediction:
    """Outputs of each datum; those of one sequence err together.

    inf where the emulator knows nothing.
    """
    unit, column = data.rows, data.more["column"]
    covariance = outputs.covariance[unit[:, None], column[:, None], column[None]]
    mean = jnp.where(outputs.unsure[unit] > UNSURE, jnp.inf, outputs.mean[unit, column])
    return Prediction(jnp.where(jnp.isnan(mean), jnp.inf, mean), jnp.where(unit[:, None] == unit[None], covariance, 0))


def no_record(m: Measurements) -> Iterator[str]:
    """Say where numbers of events are not those of a whole record."""
    record = record_of(m)
    for run in range(record.run.max() + 1) if m.event is not None else ():
        rows = np.flatnonzero(record.run == run)
        event, order = m.or_zero("event")[rows], rows[np.argsort(m.or_zero("event")[rows])]
        named = f" of sequence {m.sequence[rows[0]]}" if m.sequence else ""
        if event.min() > 1 and (record.error[rows] > 0).any():
            yield f"there is no event 1{named}: its first length is not known, and not fitted"
        if (np.diff(event) < 0).any():
            yield f"events{named} are taken in the order of their numbers, which is not that of the table"
        before = np.maximum.accumulate(m.length[order])[:-1]
        for i in order[1:][m.length[order][1:] <= before]:
            yield f"{m.place(i)}: event {m.or_zero('event')[i]:g} gets no farther than one before, and is no record"


def _check_alike(m: Measurements) -> None:
    """Refuse a sequence of several blocks, or of several runs."""
    run = record_of(m).run
    keys = list(zip(run.tolist(), m.or_zero("event").tolist(), strict=True))
    for i in (i for i, key in enumerate(keys) if m.event is not None and key in keys[:i]):
        again = f"{keys[i][1]:g}: a second time; name the runs in a column sequence"
        raise ValueError(f"{m.place(i)}, column {m.heading('event')}: {again}")
    one_of = set(NUMERIC) - {"length", "length_sigma", "force", "force_sigma", "event"}
    for name in (name for name in NUMERIC if name in one_of and getattr(m, name) is not None):
        x = np.nan_to_num(getattr(m, name), nan=-1.0)
        first = x[[int(np.argmax(run == one)) for one in run]]
        if (x != first).any():
            raise ValueError(
                f"{m.place(int(np.argmax(x != first)))}, column {m.heading(name)}: another one than in the first row of its "
                "sequence, which is of one block: tell sequences apart in a column sequence"
            )
