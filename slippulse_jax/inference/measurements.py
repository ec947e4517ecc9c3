"""Measured precursor lengths: what a table must hold, and how it is read.

A CSV file has one measured length a line and its units in the column names. Two forms are understood:

SI-prefixed
    ``height_mm``, ``correlation_length_um``, ``poisson``, ``length_mm``, ``length_sigma_mm``, and optionally ``young_GPa``
dimensionless (lengths in λc)
    ``height``, ``poisson``, ``length``, ``length_sigma``

Both may have ``specimen`` (any text) and ``provenance`` (measured, printed, digitised or synthetic). Other columns are kept
and named in the report, and have no effect. Lines that start with ``#`` are comments.
"""

import csv
import dataclasses
import io
import os
from collections import Counter
from pathlib import Path

import numpy as np

SI_COLUMNS = ("height_mm", "correlation_length_um", "poisson", "length_mm", "length_sigma_mm")
DIMENSIONLESS_COLUMNS = ("height", "poisson", "length", "length_sigma")
YOUNG_COLUMN = "young_GPa"
PROVENANCES = ("measured", "printed", "digitised", "synthetic")


class MeasurementError(ValueError):
    """A table of measurements that cannot be used; the message says where and why."""


@dataclasses.dataclass(frozen=True, eq=False)
class Measurements:
    """Measured first-precursor lengths, one entry a measurement.

    Parameters
    ----------
    height, poisson, length, length_sigma : array_like, shape (n,)
        H/λc, ν, the measured length and its standard error, lengths in λc. Scalars are repeated.
    correlation_length : array_like, shape (n,), optional
        λc in m; given for data in SI.
    young : array_like, shape (n,), optional
        E in Pa; with `correlation_length` it turns k/K into an areal stiffness k/λc² in Pa/m.
    specimen, provenance : sequence of str, optional
    lines : array_like of int, optional
        Line of each measurement in the file it came from.
    source : str
        Name of that file, for messages and reports.
    other : dict of str to list of str
        Columns that were kept and not understood.

    Raises
    ------
    MeasurementError
        If a value is missing, not finite or outside its domain, or the lengths of the columns differ.
    """

    height: np.ndarray
    poisson: np.ndarray
    length: np.ndarray
    length_sigma: np.ndarray
    correlation_length: np.ndarray | None = None
    young: np.ndarray | None = None
    specimen: tuple[str, ...] = ()
    provenance: tuple[str, ...] = ()
    lines: tuple[int, ...] = ()
    source: str = "measurements"
    other: dict[str, list[str]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        numeric = ("height", "poisson", "length", "length_sigma", "correlation_length", "young")
        given = {name: getattr(self, name) for name in numeric if getattr(self, name) is not None}
        columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, dtype=np.float64)) for x in given.values()))
        if columns[0].ndim != 1 or columns[0].size == 0:
            raise MeasurementError(f"{self.source}: measurements must be non-empty one-dimensional columns")
        for name, column in zip(given, columns, strict=True):
            object.__setattr__(self, name, np.array(column))
        n = len(self)
        for name in ("specimen", "provenance", "lines"):
            values = tuple(getattr(self, name))
            if values and len(values) != n:
                raise MeasurementError(f"{self.source}: {name} has {len(values)} entries for {n} lengths")
            object.__setattr__(self, name, values)
        for i in range(n):
            where = f"{self.source}, line {self.lines[i]}" if self.lines else f"{self.source}, measurement {i}"
            _check_domain({name: float(getattr(self, name)[i]) for name in given}, where, {})

    def __len__(self) -> int:
        return len(self.height)

    @property
    def in_si(self) -> bool:
        """Whether the correlation length is known in metres."""
        return self.correlation_length is not None


# quantity -> (test, requirement)
_DOMAIN = {
    "height": (lambda x: x > 1, "the height must exceed the correlation length λc"),
    "poisson": (lambda x: -1 < x <= 0.5, "Poisson's ratio must lie in (-1, 0.5]"),
    "length": (lambda x: x > 0, "a length must be positive"),
    "length_sigma": (lambda x: x > 0, "the standard error of a length must be positive"),
    "correlation_length": (lambda x: x > 0, "the correlation length must be positive"),
    "young": (lambda x: x > 0, "Young's modulus must be positive"),
}


def _check_domain(values: dict[str, float], where: str, columns: dict[str, tuple[str, str]]) -> None:
    """Refuse the first value outside its domain; `columns` gives the column and the text as the file has them."""
    for name, value in values.items():
        inside, requirement = _DOMAIN[name]
        if not (np.isfinite(value) and inside(value)):
            column, text = columns.get(name, (name, f"{value:g}"))
            raise MeasurementError(f"{where}, column {column}: {text}: {requirement}")
    if 0 < values["length_sigma"] < 1e-9 * values["length"]:
        column, text = columns.get("length_sigma", ("length_sigma", f"{values['length_sigma']:g}"))
        raise MeasurementError(f"{where}, column {column}: {text}: below a billionth of the length, which nothing measures")


def read_measurements(path: str | os.PathLike[str]) -> Measurements:
    """Read a CSV file of measured lengths (its schema is in the documentation of this module).

    Parameters
    ----------
    path : path
        UTF-8 text; comma, semicolon or tab between the columns, a point as decimal mark.

    Returns
    -------
    Measurements

    Raises
    ------
    MeasurementError
        If the file cannot be read, a column is missing or there twice, or a value is missing, not a number, or outside its
        domain: the message names file, line and column.
    """
    name = os.fspath(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise MeasurementError(f"{name}: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise MeasurementError(f"{name}: not UTF-8 text (byte {error.start}); save it as CSV UTF-8") from None
    if "\0" in text:
        raise MeasurementError(f"{name}: holds NUL bytes: not a text file; save it as CSV UTF-8")
    return _parse(text, name)


def _parse(text: str, name: str) -> Measurements:
    rows = _rows(text, name)
    if not rows:
        raise MeasurementError(f"{name}: empty: expected a header line with {_forms()}")
    header_line, header = rows[0]
    header = [cell.strip() for cell in header]
    si = _check_header(header, f"{name}, line {header_line}")
    if len(rows) == 1:
        raise MeasurementError(f"{name}: a header and no measurements")
    numeric: list[str] = [*(SI_COLUMNS if si else DIMENSIONLESS_COLUMNS), *[YOUNG_COLUMN] * (si and YOUNG_COLUMN in header)]
    table: dict[str, list[float]] = {}
    texts: dict[str, list[str]] = {column: [] for column in header if column not in numeric}
    for line, cells in rows[1:]:
        where = f"{name}, line {line}"
        if len(cells) != len(header):
            raise MeasurementError(f"{where}: {len(cells)} columns, but the header has {len(header)}")
        row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
        values = {column: _number(row[column], f"{where}, column {column}") for column in numeric}
        quantities, columns = _to_quantities(values, si)
        shown = {quantity: (column, row[column]) for quantity, column in columns.items()}
        _check_domain(quantities, where, shown)
        if row.get("provenance", "") not in ("", *PROVENANCES):
            raise MeasurementError(f"{where}, column provenance: {row['provenance']!r}: one of {', '.join(PROVENANCES)}")
        for quantity, value in quantities.items():
            table.setdefault(quantity, []).append(value)
        for column, cells_so_far in texts.items():
            cells_so_far.append(row[column])
    return Measurements(
        **{quantity: np.array(values) for quantity, values in table.items()},
        specimen=tuple(texts.pop("specimen", ())),
        provenance=tuple(texts.pop("provenance", ())),
        lines=tuple(line for line, _ in rows[1:]),
        source=name,
        other=texts,
    )


def _rows(text: str, name: str) -> list[tuple[int, list[str]]]:
    """Line number and cells of every line that is neither blank nor a comment."""
    # a quoted cell may run over several lines: comments are blanked, not removed, so that line numbers stay true
    kept = "\n".join("" if line.lstrip().startswith("#") else line for line in text.splitlines())
    first = next((line for line in kept.splitlines() if line.strip()), "")
    delimiter = max(",;\t", key=first.count)
    rows, line = [], 1
    reader = csv.reader(io.StringIO(kept), delimiter=delimiter, strict=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows.append((line, cells))
            line = reader.line_num + 1
    except csv.Error as error:
        raise MeasurementError(f"{name}, line {reader.line_num}: {error}") from None
    return rows


def _check_header(header: list[str], where: str) -> bool:
    """Whether the table is in SI-prefixed form; refuses one that is in neither form, or in both."""
    for column, count in Counter(header).items():
        if count > 1:
            raise MeasurementError(f"{where}, column {column or '(no name)'}: there {count} times")
    folded = {
        known.casefold(): known for known in (*SI_COLUMNS, *DIMENSIONLESS_COLUMNS, YOUNG_COLUMN, "specimen", "provenance")
    }
    for column in header:
        meant = folded.get(column.casefold(), column)
        if meant != column and meant not in header:
            raise MeasurementError(f"{where}, column {column}: did you mean {meant}? Upper and lower case count in units")
    only_si = [c for c in SI_COLUMNS if c not in DIMENSIONLESS_COLUMNS and c in header]
    only_plain = [c for c in DIMENSIONLESS_COLUMNS if c not in SI_COLUMNS and c in header]
    if only_si and only_plain:
        raise MeasurementError(f"{where}: columns of both forms, {only_si[0]} and {only_plain[0]}: choose one")
    wanted = SI_COLUMNS if only_si else DIMENSIONLESS_COLUMNS
    missing = [column for column in wanted if column not in header]
    if missing:
        expected = f"the columns {', '.join(wanted)}" if only_si or only_plain else _forms()
        raise MeasurementError(f"{where}: no column {', '.join(missing)} among {', '.join(header)}; expected {expected}")
    return bool(only_si)


def _forms() -> str:
    return f"either {', '.join(SI_COLUMNS)} or {', '.join(DIMENSIONLESS_COLUMNS)}"


def _number(text: str, where: str) -> float:
    if not text:
        raise MeasurementError(f"{where}: missing value")
    try:
        return float(text)
    except ValueError:
        hint = "; write a decimal point" if text.count(",") == 1 and text.replace(",", "").isdigit() else ""
        raise MeasurementError(f"{where}: {text!r} is not a number{hint}") from None


def _to_quantities(values: dict[str, float], si: bool) -> tuple[dict[str, float], dict[str, str]]:
    """Values of one line as quantities in λc, m and Pa, and the column each came from."""
    if not si:
        return values, {column: column for column in values}
    correlation_length = values["correlation_length_um"] * 1e-6
    # a correlation length of 0 is refused for itself, not for the division by it
    per_mm = 1e-3 / correlation_length if correlation_length else np.nan
    quantities = {
        "correlation_length": correlation_length,
        "height": values["height_mm"] * per_mm,
        "poisson": values["poisson"],
        "length": values["length_mm"] * per_mm,
        "length_sigma": values["length_sigma_mm"] * per_mm,
    }
    columns = dict(
        zip(quantities, ("correlation_length_um", *[c for c in SI_COLUMNS if c != "correlation_length_um"]), strict=True)
    )
    if YOUNG_COLUMN in values:
        quantities["young"] = values[YOUNG_COLUMN] * 1e9
        columns["young"] = YOUNG_COLUMN
    return quantities, columns
