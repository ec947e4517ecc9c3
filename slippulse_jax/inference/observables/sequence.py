"""Sequences of a block: forces at places, and first lengths.

An event that reached ℓ at the force F says that the front first reaches ℓ at F, whatever crept before it; so data are paired by
place, never by the number of the event.
"""

import itertools
from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from slippulse_jax.inference.model.emulator import UNSURE, Outputs
from slippulse_jax.inference.model.inputs import Inputs, Linear
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
"""Contacts by which an event advances, at least, to be seen; where no other advance is stated."""
AT_PLACE = 2.0
"""Errors of a place within which an event that ends there is the one that was listed."""


class Record(NamedTuple):
    """What a table says of its sequences, by row."""

    run: np.ndarray  # number of the sequence
    place: np.ndarray  # over the length of the block; just below 1 where the event spans
    error: np.ndarray  # of the place; 0 where the event spans
    first: np.ndarray  # whether it is the first event of its sequence, by its number
    heads: np.ndarray  # the first row of each sequence
    visible: np.ndarray  # least advance that is listed as an event, over the length of the block; 0 where it is not stated


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
    visible = np.nan_to_num(m.or_zero("visible") / ends)
    return Record(run, place, error, m.or_zero("event") == 1, np.unique(run, return_index=True)[1], visible)


class OfSequence(Observable):
    """A datum of a sequence, predicted by an emulator through many series."""

    def of_run(
        self, q: "ParameterSet", rows: np.ndarray, value: np.ndarray, sigma: np.ndarray, record: Record, **more: np.ndarray
    ) -> Observations:
        """Collect data of rows, with the inputs of each sequence once."""
        found = self.observations(q, rows, value, sigma, q.inputs.take(rows), **more)
        return found._replace(inputs=q.inputs.take(record.heads), rows=record.run[rows])


def least_of(sites: np.ndarray, more: Mapping[str, np.ndarray]) -> np.ndarray:
    """Least advance of a listed event over the length, (t,)."""
    return np.maximum(VISIBLE / sites, more["visible"].max())


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
        force, load = (float(m.heading(name).endswith(OVER_ALL)) for name in (self.column.quantity, "normal_load"))
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
        read_as |= {"visible": record.visible, "spans": np.array(m.kind) == "at_least"}
        return self.of_run(q, rows, value, sigma, record, **read_as)

    def read_series(self, series: Followed, sites: np.ndarray, inputs: Inputs, more: Mapping[str, np.ndarray]) -> np.ndarray:
        """Forces over the normal load, and spreads by errors of places."""
        arrested = more["error"] > 0
        place = more["place"] * np.exp(-inputs.get("log_extent")[:, None] * arrested)  # over the length that the block then has
        found = series.force_at(place, more["error"])
        ends = more["numbered"] & arrested
        if ends.any():
            found[:, :, ends] = series.force_of_arrest(place[:, ends], more["error"][ends], least_of(sites, more))
        if (own := more["first"] & ends).any():
            found[0][:, own], found[1][:, own] = series.first(least_of(sites, more))[1][:, None], 0.0
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

        Neighbours, which may be of one event, err together. Tails are heavy where thresholds scatter, and of the force at which
        a block is spanned: it jumps as the last event becomes another.
        """
        friction, rough = inputs.get("friction")[data.rows], ROUGHNESS * single
        own = outputs.mean[data.rows, data.more["column"] + 1] ** 2
        own = own + friction**2 * (inputs.get("model_error")[data.rows] ** 2 + rough**2)
        heavy = data.more["spans"] | (inputs.get("log_scatter")[data.rows] > -jnp.inf)
        found = joint(outputs, data)
        return Prediction(found.mean, found.covariance + jnp.diag(own), heavy=jnp.where(heavy, 1 + data.more["place"], 0))


class LargestForce(OfSequence):
    """Largest force since the start of a run, up to an event.

    Of an event whose own force that is, that less its own: no force before was larger.
    """

    name = "largest_force"
    noun = "largest force"
    column = COLUMNS["largest_force"]
    outputs = 1
    acts = PlaceForce.acts
    added = PlaceForce.added
    unit = PlaceForce.unit

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse a largest force below one that came before."""
        if (most := m.largest_force) is None:
            return
        record = record_of(m)
        later = record.place if m.event is None else m.event
        for run in range(record.run.max() + 1):
            rows = np.flatnonzero((record.run == run) & np.isfinite(most))
            order = rows[np.argsort(later[rows], kind="stable")]
            for i in order[1:][np.diff(most[order]) < 0].tolist():
                raise ValueError(f"{m.place(i)}, column {m.heading('largest_force')}: less than of an event or place before")

    def data(self, m: Measurements, q: "ParameterSet") -> Observations | None:
        """One datum for each row, with the error of its force."""
        if m.largest_force is None or not np.isfinite(m.largest_force).any():
            return None
        record, rows = record_of(m), np.flatnonzero(np.isfinite(m.largest_force))
        most, force = m.largest_force[rows], m.or_zero("force")[rows]
        own = np.isclose(most, force, rtol=1e-9)
        ends = m.event is not None and record.error[rows] > 0
        read_as = {"place": record.place, "error": record.error, "first": record.first, "visible": record.visible}
        more = {name: x[rows] for name, x in read_as.items()} | {"own": own, "numbered": np.full(len(rows), ends)}
        found = self.of_run(q, rows, np.where(own, 0.0, most), m.or_zero("force_sigma")[rows], record, **more)
        zero = found.offset  # of the load cell, which a difference has not
        return found._replace(offset=Linear(zero.base * ~own, zero.slope * ~own[:, None]))

    def read_series(self, series: Followed, sites: np.ndarray, inputs: Inputs, more: Mapping[str, np.ndarray]) -> np.ndarray:
        """Largest forces over the normal load.

        Or by how much they exceed those of their events.
        """
        largest = series._replace(force=np.fmax.accumulate(series.force, axis=1))
        arrested = more["error"] > 0
        place = more["place"] * np.exp(-inputs.get("log_extent")[:, None] * arrested)
        found = largest.force_at(place, more["error"])[0] * inputs.get("friction")[:, None]
        force = PlaceForce().read_series(series, sites, inputs, more)[..., 0]
        return np.where(more["own"], np.maximum(found - force, 0.0), found)[..., None]

    def shown(self, m: Measurements, one: "Compared") -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
        """Forces in the unit of the table."""
        (size, unit), rows = m.unit_of_force, one.measurement
        least = np.where(one.value == 0, m.or_zero("force")[rows], 0.0)
        return (one.value + least) * size[rows], one.sigma * size[rows], (one.fitted + least) * size[rows], unit

    def emulate(self, outputs: Outputs, inputs: Inputs, data: Observations, *, single: bool = False) -> Prediction:
        """Predict forces, with errors of model and emulator."""
        friction = inputs.get("friction")[data.rows]
        own = friction**2 * (inputs.get("model_error")[data.rows] ** 2 + (ROUGHNESS * single) ** 2)
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
        return self.of_run(q, rows, value, m.sigma[rows] / m.length[rows], record, visible=record.visible[rows])

    def read_series(self, series: Followed, sites: np.ndarray, inputs: Inputs, more: Mapping[str, np.ndarray]) -> np.ndarray:
        """The first length that is seen; without an event none."""
        length, _ = series.first(least_of(sites, more))
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


class Between(OfSequence):
    """How far an event between two listed ones advances, beyond `visible`.

    Over the length of the block; where `visible` is stated there is none.
    """

    name = framed = "between"
    noun = "unlisted advance"
    column = COLUMNS["visible"]
    outputs = 1

    def data(self, m: Measurements, q: "ParameterSet") -> Observations | None:
        """A datum for each number that follows on another, or is 1."""
        if m.event is None or m.visible is None:
            return None
        record, rows, last = record_of(m), [], []
        for run in range(record.run.max() + 1):
            own = np.flatnonzero((record.run == run) & (record.visible > 0))
            own = own[np.argsort(m.event[own], kind="stable")]
            number = {-1: 0.0} | dict(
                zip(own.tolist(), m.event[own].tolist(), strict=True)
            )  # before the first there is the edge
            pairs = [(i, j) for j, i in itertools.pairwise(number) if number[i] == number[j] + 1]
            rows, last = rows + [i for i, _ in pairs], last + [j for _, j in pairs]
        if not rows:
            return None
        known = {name: np.append(getattr(record, name), 0.0) for name in ("place", "error")}
        more = {f"{name}{after}": x[at] for name, x in known.items() for after, at in (("", rows), ("_before", last))}
        sigma = np.hypot(more["error"], more["error_before"])
        some = np.array(rows)
        return self.of_run(q, some, np.zeros(len(some)), sigma, record, visible=record.visible[some], **more)

    def read_series(self, series: Followed, sites: np.ndarray, inputs: Inputs, more: Mapping[str, np.ndarray]) -> np.ndarray:
        """Largest advance of events that end between two places."""
        long = np.exp(-inputs.get("log_extent"))[:, None]
        low, high = (
            np.where(error > 0, place * long, place) + side * AT_PLACE * error
            for place, error, side in ((more["place_before"], more["error_before"], 1), (more["place"], more["error"], -1))
        )
        ends = series.reached[:, None]
        advance = np.where((ends > low[..., None]) & (ends < high[..., None]), series.advance[:, None], 0.0).max(axis=-1)
        return np.maximum(advance - more["visible"], 0.0)[..., None]

    def shown(self, m: Measurements, one: "Compared") -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
        """Advances in the unit of the table."""
        (scale, unit), rows = m.unit, one.measurement
        size = m.or_zero("block_length")[rows] * scale[rows]
        most = m.or_zero("visible")[rows] * scale[rows]
        return most, size * one.sigma, most + size * one.fitted, unit

    def emulate(self, outputs: Outputs, inputs: Inputs, data: Observations, *, single: bool = False) -> Prediction:
        """The advance: none of most series, large of some."""
        return joint(outputs, data)._replace(heavy=1 + data.more["place"])


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
    one_of = set(NUMERIC) - {"length", "length_sigma", "force", "force_sigma", "largest_force", "event"}
    for name in (name for name in NUMERIC if name in one_of and getattr(m, name) is not None):
        x = np.nan_to_num(getattr(m, name), nan=-1.0)
        first = x[[int(np.argmax(run == one)) for one in run]]
        if (x != first).any():
            raise ValueError(
                f"{m.place(int(np.argmax(x != first)))}, column {m.heading(name)}: another one than in the first row of its "
                "sequence, which is of one block: tell sequences apart in a column sequence"
            )
