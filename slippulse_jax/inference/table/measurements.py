"""Measurements of first precursors, and readings of gauges along the interface.

`slippulse_jax.inference.table.columns` describes their columns, `slippulse_jax.inference.table.tables` reads the text of both.
"""

import dataclasses
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from slippulse_jax.base.domains import CORRELATION_LENGTH, real_numbers
from slippulse_jax.base.shown import html, short
from slippulse_jax.inference.table import tables
from slippulse_jax.inference.table.columns import (
    COLUMNS,
    GAUGE_COLUMNS,
    IN_LC,
    NUMERIC,
    OVER_ALL,
    UNITS_OF_LENGTH,
    MeasurementError,
    check_needs,
    check_rows,
    convert,
    converted,
    entries,
    named,
    named_of_gauges,
    numbers,
    numbers_or_none,
    table,
)

if TYPE_CHECKING:
    import pandas as pd


class MeasurementWarning(UserWarning):
    """Measurements that can be fitted but are probably not what was meant."""


@table
class Gauges:
    """Readings of gauges along the interface after measured precursors, one entry each.

    Parameters
    ----------
    row : array_like of int, shape (r,)
        Which measurement's precursor had just stopped.
    {columns}
    lines : sequence of int, optional
        Line of each reading in the file it came from.
    source : str
        Name of that file.
    skipped : tuple of int
        Lines of it that hold no reading and are not blank.

    Raises
    ------
    MeasurementError
        If a value is not finite, a standard error is missing or not positive, or nothing was read.
    """

    row: np.ndarray = converted(converter=numbers)
    position: np.ndarray = converted(converter=numbers)
    slip: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    slip_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    stress: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    stress_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    lines: tuple[int, ...] = converted(converter=entries, default=())
    source: str = "gauges"
    skipped: tuple[int | str, ...] = ()

    def __post_init__(self) -> None:
        given = convert(self)
        if not (self.row == np.round(self.row)).all():
            i = int(np.argmax(self.row != np.round(self.row)))
            raise MeasurementError(f"{self.source}, column row: {self.row[i]:g}: must be the number of a measurement")
        object.__setattr__(self, "row", self.row.astype(int))
        given.remove("row")
        check_needs(given, {}, self.source)
        check_rows({name: getattr(self, name) for name in given}, self.place)
        unread = ~(self.there("slip") | self.there("stress"))
        if unread.any():
            raise MeasurementError(f"{self.place(int(np.argmax(unread)))}: neither slip nor stress was read")

    def __len__(self) -> int:
        return len(self.position)

    def place(self, i: int) -> str:
        """Where reading i came from, for messages."""
        return f"{self.source}, line {self.lines[i]}" if self.lines else f"{self.source}, reading {i}"

    def there(self, name: str) -> np.ndarray:
        """Which readings have a value of `name`, bool, shape (r,)."""
        values = getattr(self, name)
        return np.zeros(len(self), bool) if values is None else np.isfinite(values)


@table
class Measurements:
    """Measured first precursors, one entry per measurement.

    Columns are of shape (n,), or one number or text for all; NaN and None are blank cells. Lengths are in λc, also where
    `correlation_length` is given (`from_si` takes metres).

    Parameters
    ----------
    {columns}
    gauges : Gauges, optional
        Readings of slip and stress along the interface after arrest; need `correlation_length` and `young`.
    lines, rows : sequence, optional
        Line of each measurement in the file that it came from, or its index label in the DataFrame.
    skipped : sequence
        Lines or rows that hold no measurement: titles, units and comments.
    source : str
        Name of that file, for messages and reports.
    other : dict of str to list of str
        Columns that were kept but not used.
    columns : dict of str to str
        Name in the file of each quantity's column, for messages, which are then in its unit.

    Raises
    ------
    MeasurementError
        If a value is missing, not finite or outside its domain, the lengths of the columns differ, or a column is given without
        one that it needs.
    """

    height: np.ndarray = converted(converter=numbers)
    poisson: np.ndarray = converted(converter=numbers)
    length: np.ndarray = converted(converter=numbers)
    length_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    correlation_length: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    young: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    kind: tuple[str, ...] = converted(converter=entries, default=())
    prestress: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    threshold_slope: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    residual_strength: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    visible: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    block_length: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    push_height: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    push_width: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    push_control: tuple[str, ...] = converted(converter=entries, default=())
    friction: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    normal_stiffness: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    contact_law: tuple[str, ...] = converted(converter=entries, default=())
    top: tuple[str, ...] = converted(converter=entries, default=())
    machine_stiffness: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    block_width: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    height_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    block_length_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    push_width_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    normal_stiffness_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    machine_stiffness_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    block_width_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    normal_load_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    poisson_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    correlation_length_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    young_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    push_height_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    friction_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    displacement: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    displacement_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    force: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    force_sigma: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    largest_force: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    normal_load: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    event: np.ndarray | None = converted(converter=numbers_or_none, default=None)
    sequence: tuple[str, ...] = converted(converter=entries, default=())
    specimen: tuple[str, ...] = converted(converter=entries, default=())
    thresholds: tuple[str, ...] = converted(converter=entries, default=())
    provenance: tuple[str, ...] = converted(converter=entries, default=())
    label: tuple[str, ...] = converted(converter=entries, default=())
    gauges: Gauges | None = None
    lines: tuple[int, ...] = converted(converter=entries, default=())
    source: str = "measurements"
    other: Mapping[str, Sequence[str]] = dataclasses.field(default_factory=dict)
    columns: Mapping[str, str] = dataclasses.field(default_factory=dict)
    rows: tuple[str, ...] = converted(converter=entries, default=())
    skipped: tuple[int | str, ...] = ()

    @classmethod
    def from_si(cls, *, correlation_length: ArrayLike, **columns: Any) -> "Measurements":
        """Measurements of arrays in SI units.

        Parameters
        ----------
        correlation_length : array_like
            λc, in m.
        **columns
            As of `Measurements`, but with heights and lengths, and their standard errors, in m.
        """
        owner = "Measurements.from_si"
        unit = real_numbers(f"{owner}: correlation_length", correlation_length, "m")
        CORRELATION_LENGTH.check(f"{owner}: correlation_length", unit)
        in_lc: dict[str, Any] = {
            name: numbers(x, f"{owner}: {name}", "m") / unit if name in IN_LC and x is not None else x
            for name, x in columns.items()
        }
        return cls(correlation_length=unit, **in_lc)

    @classmethod
    def from_dataframe(cls, table: "pd.DataFrame") -> "Measurements":
        """Measurements of a pandas.DataFrame with the columns of a CSV file.

        Raises
        ------
        MeasurementError
            As `read_measurements`, but with the row's index label instead of a line.
        TypeError
            If it is no DataFrame.
        """
        return cls(**tables.read(tables.of_dataframe(table), named))

    def __post_init__(self) -> None:
        given = convert(self)
        for name in given:
            if COLUMNS[name].may_be_blank and np.isnan(getattr(self, name)).all():  # as if it were not there
                object.__setattr__(self, name, None)
        if not self.kind:
            object.__setattr__(self, "kind", ("length",) * len(self))
        if self.length_sigma is None and "length" not in self.kind:
            object.__setattr__(self, "length_sigma", np.zeros(len(self)))  # counts need no σ
        for field in (field for field in dataclasses.fields(self) if "converter" in field.metadata):
            values = getattr(self, field.name)
            if isinstance(values, tuple) and len(values) not in (0, len(self)):
                raise MeasurementError(f"{self.source}: {field.name} has {len(values)} entries for {len(self)} lengths")
        values = {name: getattr(self, name) for name in COLUMNS if getattr(self, name, None) is not None}
        check_needs([name for name, x in values.items() if len(x)], self.columns, self.source)
        self._check_gauges()
        check_rows(values, self.place)

    def _check_gauges(self) -> None:
        if self.gauges is None:
            return
        if self.young is None:
            raise MeasurementError(f"{self.gauges.source}: gauges are in SI: the lengths need correlation_length and young too")
        for i, row in enumerate(self.gauges.row):
            if not 0 <= row < len(self):
                raise MeasurementError(f"{self.gauges.place(i)}: row = {row}: there are {len(self)} measurements")
            if self.block_length is not None and self.correlation_length is not None:
                end = self.block_length[row] * self.correlation_length[row]
                if self.gauges.position[i] > end:
                    where = f"{self.gauges.position[i]:g} m: beyond the end of the block, at {end:g} m"
                    raise MeasurementError(f"{self.gauges.place(i)}: position = {where}")
            if self.kind[row] == "at_least":
                raise MeasurementError(f"{self.gauges.place(i)}: that front did not stop, so nothing was read after its arrest")

    def __len__(self) -> int:
        return len(self.height)

    def __repr__(self) -> str:
        size, unit = self.unit
        heights, lengths = (f"{short(x * size)} {unit}" for x in (self.height, self.length))
        return f"Measurements({len(self)} of {self.source}: heights {heights}, lengths {lengths})"

    def _repr_html_(self) -> str:
        given = [name for name in ("specimen", "label") if getattr(self, name)]
        counted, numbers = self.numbered
        rows = [
            [str(numbers[i]), *(getattr(self, name)[i] for name in given)]
            + [self.in_its_unit(i, self.height[i]), f"{self.poisson[i]:g}"]
            + [self.in_its_unit(i, self.length[i]), "" if np.isnan(self.sigma[i]) else self.in_its_unit(i, self.sigma[i])]
            + [self.kind[i]]
            for i in range(len(self))
        ]
        return html(self.source, rows, (counted, *given, "height", "ν", "length", "σ", "kind"))

    def place(self, i: int) -> str:
        """Where measurement i came from, for messages."""
        return f"{self.source}, {self.number(i)}"

    def heading(self, name: str) -> str:
        """Name of a quantity's column in the file, or the quantity."""
        return self.columns.get(name, name)

    def number(self, i: int) -> str:
        """Name of measurement i within its source: ``line 3``, ``row 1``."""
        counted, numbers = self.numbered
        return f"{'measurement' if counted == 'no.' else counted} {numbers[i]}"

    @property
    def numbered(self) -> tuple[str, Sequence[int | str]]:
        """Heading and numbers, or index labels, of the measurements."""
        if self.lines:
            return "line", self.lines
        return ("row", self.rows) if self.rows else ("no.", range(len(self)))

    def option(self, command: str, python: str) -> str:
        """Write an option of a fit as this user would give it."""
        return f"{command}, in Python {python}" if self.lines else python

    @property
    def unit(self) -> tuple[np.ndarray, str]:
        """λc, (n,), in the table's unit of length, and that unit."""
        if self.correlation_length is None:
            return np.ones(len(self)), "λc"
        unit = self.columns.get("length", "length_mm").rpartition("_")[2]
        return self.correlation_length / UNITS_OF_LENGTH[unit], unit

    def in_its_unit(self, i: int, length: float) -> str:
        """Write a length given in λc in the table's unit: ``14.03 mm``."""
        size, unit = self.unit
        return f"{length * size[i]:.5g} {unit}"

    @property
    def in_si(self) -> bool:
        """Whether the correlation length is known in metres."""
        return self.correlation_length is not None

    @property
    def metres(self) -> np.ndarray:
        """λc in m, or 1 where lengths have no unit; (n,)."""
        return np.ones(len(self)) if self.correlation_length is None else self.correlation_length

    @property
    def sigma(self) -> np.ndarray:
        """Standard errors of the lengths in λc, NaN where none is given."""
        return np.full(len(self), np.nan) if self.length_sigma is None else self.length_sigma

    @property
    def stated_sigma(self) -> np.ndarray:
        """Standard errors of the lengths in λc, 1 where none is given."""
        return np.ones(len(self)) if self.length_sigma is None else self.length_sigma

    @property
    def is_sequence(self) -> bool:
        """Whether entries are forces and the places that fronts reached."""
        return self.force is not None and self.push_height is not None

    @property
    def unit_of_force(self) -> tuple[np.ndarray, str]:
        """1 N/m, (n,), in the table's unit of force, and that unit."""
        if self.block_width is not None and self.heading("force").endswith(OVER_ALL):
            return self.block_width, "N"
        return np.full(len(self), 1e-3), "N/mm"

    @property
    def distinct(self) -> int:
        """Number of different measurements: lines copied from another count once."""
        columns = [
            np.nan_to_num(getattr(self, name), nan=np.inf).tolist() for name in NUMERIC if getattr(self, name) is not None
        ]
        texts = [getattr(self, name) for name in ("kind", "specimen", "push_control", "contact_law", "top")]
        texts = [column for column in texts if column]
        return len(set(zip(*columns, *texts, strict=True)))

    def or_zero(self, name: str) -> np.ndarray:
        """Column `name`, or zeros where it was not given; shape (n,)."""
        column = getattr(self, name)
        return np.zeros(len(self)) if column is None else column


def read_measurements(path: str | os.PathLike[str], *, gauges: str | os.PathLike[str] | None = None) -> Measurements:
    """Read a CSV file of measured first precursors.

    The page "Columns of a table" of the documentation (docs/reference/columns.md) lists its columns.

    Parameters
    ----------
    path : path
        UTF-8 text; comma, semicolon or tab between the columns. ``-`` is standard input.
    gauges : path, optional
        A second file: readings along the interface after arrest (`read_gauges`).

    Returns
    -------
    Measurements

    Raises
    ------
    OSError
        If there is no such file, or it cannot be opened.
    MeasurementError
        If a column is missing or there twice, or a value is missing, not a number, or outside its domain: the message names
        file, line and column.
    """
    lengths = Measurements(**tables.read(tables.of_file(path), named))
    return lengths if gauges is None else dataclasses.replace(lengths, gauges=read_gauges(gauges, lengths.label))


def read_gauges(path: str | os.PathLike[str], labels: Sequence[str]) -> Gauges:
    """Read a CSV file of gauges, one reading per line.

    Lines are skipped as in the table of lengths. A cell is blank where one of slip and stress was not measured.

    Parameters
    ----------
    path : path
    labels : sequence of str
        Labels of the measured precursors.

    Raises
    ------
    MeasurementError
        Naming file, line and column.
    """
    found = tables.read(tables.of_file(path), named_of_gauges)
    count, row = Counter(labels), {label: row for row, label in enumerate(labels)}
    for line, label in zip(found["lines"], found["label"], strict=True):
        if count[label] != 1:
            many = f"{count[label]} measurements have" if count[label] else "no measurement has"
            where = f"{found['source']}, line {line}, column label"
            raise MeasurementError(f"{where}: {many} the label {label!r}; each needs its own, in a column label")
    given = {name: found[name] for name in (*GAUGE_COLUMNS, "lines", "source", "skipped") if name in found}
    return Gauges([row[label] for label in found["label"]], **given)


def measurements_of(given: Any) -> Measurements:
    """Return measurements, or read them from a DataFrame or a file."""
    if isinstance(given, Measurements):
        return given
    if isinstance(given, str | os.PathLike):
        return read_measurements(given)
    if hasattr(type(given), "columns"):
        return Measurements.from_dataframe(given)
    raise TypeError(f"measurements is {type(given).__name__}: must be Measurements, pandas.DataFrame or the path of a CSV file")
