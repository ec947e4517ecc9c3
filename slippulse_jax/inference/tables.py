"""Read tables of measurements and of gauges from CSV files.

One first precursor per line. The columns are arguments of `Measurements`, where they are described, in one of two forms:

SI, with the unit at the end of the name
    ``height_mm``, ``poisson``, ``length_mm``, ``correlation_length_um``; optionally ``length_sigma_mm``, ``young_GPa``,
    ``block_length_mm``, ``push_height_mm``, ``push_width_mm``, ``machine_stiffness_N_per_m`` with ``block_width_mm``; errors of
    the inputs ``height_sigma_mm``, ``correlation_length_sigma_um``, ``young_sigma_GPa``, ``push_height_sigma_mm``; and with
    their errors ``displacement_um``, ``displacement_sigma_um``, ``force_N_per_mm``, ``force_sigma_N_per_mm``. Lengths may be in
    ``m``, ``cm``, ``mm``, ``um`` or ``nm``, and Young's modulus in ``Pa``, ``kPa``, ``MPa`` or ``GPa``.
lengths in λc
    ``height``, ``poisson``, ``length``; optionally ``length_sigma``, ``block_length``, ``push_height``, ``push_width``,
    ``machine_stiffness`` over the width of the block and E, ``height_sigma``, ``push_height_sigma``
optional in both
    ``prestress``, ``threshold_slope``, ``poisson_sigma``, ``friction``, ``friction_sigma``, ``normal_stiffness``,
    ``contact_law``, ``top``, ``kind``, ``push_control``, ``specimen``, ``provenance``, ``label``

A cell is blank where NaN is described, and in a column of σ beside a kind other than ``length``. Other columns are kept and
named in the report, and have no effect; but one that seems to mean a quantity that the table lacks, by a symbol, an English
word or a typing error, is refused. Lines that start with ``#`` are comments. Columns are separated by commas, semicolons or
tabs; between semicolons and tabs all numbers of a table may have decimal commas. An error names file, line and column.
"""

import csv
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from slippulse_jax.files import read_whole
from slippulse_jax.inference.columns import (
    GAUGE_COLUMNS,
    IN_LC,
    TEXTS,
    MeasurementError,
    Named,
    check,
    named,
    named_of_gauges,
)
from slippulse_jax.inference.measurements import Gauges, Measurements

LARGEST = 16 * 2**20
"""Bytes of the largest table that is read: some 300 000 measurements."""


def read_measurements(path: str | os.PathLike[str], *, gauges: str | os.PathLike[str] | None = None) -> Measurements:
    """Read a CSV file of measured first precursors.

    Its columns are described in the documentation of this module.

    Parameters
    ----------
    path : path
        UTF-8 text; comma, semicolon or tab between the columns.
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
    name = os.fspath(path)
    lengths = _measurements(rows(read_text(path), name), name, "line")
    return lengths if gauges is None else replace(lengths, gauges=read_gauges(gauges, lengths.label))


def from_dataframe(table: Any, name: str = "table") -> Measurements:
    """Read a pandas.DataFrame, as `Measurements.from_dataframe` describes."""
    if not (hasattr(table, "itertuples") and hasattr(table, "columns")):
        makes = "series.to_frame().T" if hasattr(table, "to_frame") else "pandas.DataFrame(…)" * isinstance(table, Mapping)
        hint = f": {makes} makes one of it" * bool(makes)
        raise TypeError(f"{name} is {type(table).__name__}: must be a pandas.DataFrame{hint}")
    header = (0, [str(column) for column in table.columns])
    blank = iter(table.isna().to_numpy().ravel())
    cells = (
        ["" if next(blank) else repr(float(x)) if isinstance(x, float | np.floating) else str(x) for x in row]
        for row in table.itertuples(index=False, name=None)
    )
    return _measurements(chain([header], zip(map(str, table.index), cells, strict=True)), name, "row")


def measurements_of(given: Any) -> Measurements:
    """Return measurements as they are, or read them from a DataFrame or a CSV file."""
    if isinstance(given, Measurements):
        return given
    if isinstance(given, str | os.PathLike):
        return read_measurements(given)
    if hasattr(given, "itertuples") and hasattr(given, "columns"):
        return from_dataframe(given)
    raise TypeError(f"measurements is {type(given).__name__}: must be Measurements, pandas.DataFrame or the path of a CSV file")


def _measurements(table: Iterator[tuple[Any, list[str]]], name: str, counted: str) -> Measurements:
    """Measurements of rows of text, the header first, which are numbered as lines of a file or rows of a DataFrame."""
    found = _read(table, name, counted, named)
    if "block_width" in found:
        found["machine_stiffness"] = found["machine_stiffness"] / found.pop("block_width")
    return Measurements(**found)


def _read(
    table: Iterator[tuple[Any, list[str]]], name: str, counted: str, find: Callable[[list[str], str], Named]
) -> dict[str, Any]:
    """Read rows of text, the header first, into arguments of `Measurements`."""
    first, header = next(table, (1, []))
    if not header:
        raise MeasurementError(f"{name}: empty: a header line and at least one more are needed")
    header = [cell.strip() for cell in header]
    known = find(header, f"{name}, line {first}" if counted == "line" else name)
    numbers, cells = [], {own: [] for own in header}
    for number, row in table:
        if len(row) != len(header):
            raise MeasurementError(f"{name}, {counted} {number}: {len(row)} columns, but the header has {len(header)}")
        numbers.append(number)
        for own, cell in zip(header, row, strict=True):
            cells[own].append(cell.strip())
    if not numbers:
        raise MeasurementError(f"{name}: a header line and at least one more are needed")

    def place(i: int) -> str:
        return f"{name}, {counted} {numbers[i]}"

    texts = {
        column.quantity: [cell or next(iter(column.choices), "") for cell in cells[own]]
        for own, (column, _) in known.items()
        if column.choices is not None
    }
    check(texts, place)
    kind = texts.get("kind", ["length"] * len(numbers))
    columns = {column.quantity: own for own, (column, _) in known.items() if column.choices is None}
    values = _numbers(cells, {own: known[own] for own in columns.values()}, place, kind)
    check({**values, "kind": kind}, place, columns, cells)
    other = {own: cells[own] for own in header if own not in known}
    return {**values, **texts, f"{counted}s": numbers, "source": name, "other": other, "columns": columns}


def _numbers(
    cells: Mapping[str, list[str]], known: Named, place: Callable[[int], str], kind: Sequence[str]
) -> dict[str, np.ndarray]:
    """Convert columns of numbers, by quantity, to λc, m, Pa and N/m; NaN where a cell may be blank and is."""
    raw: dict[str, list[float]] = {own: [] for own in known}
    for i in range(len(kind)):
        for own, (column, _) in known.items():
            cell = cells[own][i]
            if not cell and column.may_be_blank:
                cell = "nan"
            elif not cell and column.quantity == "length_sigma" and kind[i] != "length":
                cell = "0"
            raw[own].append(number(cell, f"{place(i)}, column {own}"))
    values = {column.quantity: (np.array(raw[own]), unit) for own, (column, unit) in known.items()}
    with np.errstate(all="ignore"):  # a correlation length of 0 is refused later
        contact = math.prod(values.get("correlation_length", (1.0,)))
        found = {name: x * (unit / contact if name in IN_LC else unit) for name, (x, unit) in values.items()}
        if "whole" in kind:  # whole numbers before they were divided by λc
            near = np.round(found["length"])
            whole = (np.array(kind) == "whole") & (abs(found["length"] - near) < 1e-6)
            found["length"] = np.where(whole, near, found["length"])
    return found


def read_gauges(path: str | os.PathLike[str], labels: Sequence[str]) -> Gauges:
    """Read a CSV file of gauges, one reading per line.

    The columns are ``label`` (of the precursor, as in the table of lengths), ``position_mm`` from the pushed edge, and
    ``slip_um`` with ``slip_sigma_um``, or ``stress_MPa`` with ``stress_sigma_MPa``, or both; blank where one was not measured.
    Lines that start with ``#`` are comments.

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
    name = os.fspath(path)
    found = _read(rows(read_text(path), name), name, "line", named_of_gauges)
    count, row = Counter(labels), {label: row for row, label in enumerate(labels)}
    for line, label in zip(found["lines"], found["label"], strict=True):
        if count[label] != 1:
            many = f"{count[label]} measurements have" if count[label] else "no measurement has"
            where = f"{name}, line {line}, column label"
            raise MeasurementError(f"{where}: {many} the label {label!r}; each needs its own, in a column label")
    read = {column: found[column] for column in GAUGE_COLUMNS if column in found}
    return Gauges([row[label] for label in found["label"]], **read, lines=found["lines"], source=name)


def read_text(path: str | os.PathLike[str]) -> str:
    """The file's text.

    Raises
    ------
    OSError
        If there is no such file, or it cannot be opened.
    MeasurementError
        If it is larger than `LARGEST` or not UTF-8 text.
    """
    name = os.fspath(path)
    try:
        content = read_whole(path, LARGEST)
    except ValueError as error:  # too large
        raise MeasurementError(str(error)) from None
    if content.startswith(b"PK\x03\x04"):
        raise MeasurementError(f"{name}: an Excel workbook, or another zip file: save it as CSV UTF-8")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MeasurementError(f"{name}: not UTF-8 text (byte {error.start}); save it as CSV UTF-8") from None
    if "\0" in text:
        raise MeasurementError(f"{name}: holds NUL bytes: not a text file; save it as CSV UTF-8")
    return text


def rows(text: str, name: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of every line that is neither blank nor a comment."""
    said = next(_lines(text), "").strip().strip('"').lower()
    separated = said.startswith("sep=")  # as Excel writes it
    delimiter = said.removeprefix("sep=") or "\t" if separated else ""
    if len(delimiter) != 1:
        delimiter = max(",;\t", key=next((line for line in _kept(text, separated) if line.strip()), "").count)
    found = partial(_cells, text, separated, delimiter, name)
    if delimiter == "," or _mark(found(), name) == ".":
        return found()
    with_comma = _DECIMAL[","].fullmatch
    return ((line, [cell.replace(",", ".") if with_comma(cell) else cell for cell in cells]) for line, cells in found())


def _cells(text: str, separated: bool, delimiter: str, name: str) -> Iterator[tuple[int, list[str]]]:
    reader, line = csv.reader(_kept(text, separated), delimiter=delimiter, strict=True), 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield line, cells
            line = reader.line_num + 1
    except csv.Error as error:
        raise MeasurementError(f"{name}, line {reader.line_num}: {error}") from None


def _mark(found: Iterator[tuple[int, list[str]]], name: str) -> str:
    """Find the decimal mark of all numbers; refuse a table with both, where 1,234 may be a thousand."""
    header = [cell.strip() for cell in next(found, (1, []))[1]]
    count, first = Counter(), {}
    for line, cells in found:
        for column, cell in zip(header, cells, strict=False):
            for mark, form in _DECIMAL.items():
                if column not in TEXTS and form.fullmatch(cell):
                    count[mark] += 1
                    first.setdefault(mark, (line, cell.strip()))
    if len(count) == 2:
        odd, usual = sorted(_DECIMAL, key=count.__getitem__)
        words = {".": "point", ",": "comma"}
        (line, cell), (other, example) = first[odd], first[usual]
        raise MeasurementError(
            f"{name}, line {line}: {cell!r} has a decimal {words[odd]}, and {example!r} in line {other} a {words[usual]}: "
            f"write all numbers with one of them"
        )
    return next(iter(count), ".")


def _lines(text: str) -> Iterator[str]:
    """Lines without their ends."""
    return (found[1] for found in re.finditer(r"([^\r\n]*)(?:\r\n?|\n|\Z)", text))


def _kept(text: str, separated: bool) -> Iterator[str]:
    """Blank the comments, and a first line that names the separator.

    They are not left out: a quoted cell may run over several lines, and line numbers stay true.
    """
    for number, line in enumerate(_lines(text)):
        yield "\n" if line.lstrip().startswith("#") or (separated and number == 0) else line + "\n"


_DECIMAL = {mark: re.compile(rf"\s*[+-]?\d*[{mark}]\d+(e[+-]?\d+)?\s*", flags=re.IGNORECASE) for mark in ".,"}
"""Numbers with a decimal point, and with a comma."""


def number(text: str, where: str) -> float:
    """Convert a cell to a number; `where` names it in messages."""
    if not text:
        raise MeasurementError(f"{where}: missing value")
    try:
        return float(text)
    except ValueError:
        hint = "; write a decimal point, or semicolons between the columns (pandas.read_csv: decimal=',')"
        hint *= _DECIMAL[","].fullmatch(text) is not None
        raise MeasurementError(f"{where}: {text!r} is not a number{hint}") from None
