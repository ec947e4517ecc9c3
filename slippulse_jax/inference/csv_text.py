"""Text of a CSV file as numbered rows of cells; what is wrong is named with file, line and column."""

import csv
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slippulse_jax.inference.measurements import MeasurementError


def read_text(path: str | os.PathLike[str]) -> str:
    """The file's text.

    Raises
    ------
    MeasurementError
        If it cannot be read or is not UTF-8 text.
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
    return text


def rows(text: str, name: str) -> list[tuple[int, list[str]]]:
    """Line number and cells of every line that is neither blank nor a comment."""
    # a quoted cell may run over several lines: comments are blanked, not removed, so that line numbers stay true
    kept = "\n".join("" if line.lstrip().startswith("#") else line for line in text.splitlines())
    first = next((line for line in kept.splitlines() if line.strip()), "")
    delimiter = max(",;\t", key=first.count)
    found, line = [], 1
    reader = csv.reader(io.StringIO(kept), delimiter=delimiter, strict=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                found.append((line, cells))
            line = reader.line_num + 1
    except csv.Error as error:
        raise MeasurementError(f"{name}, line {reader.line_num}: {error}") from None
    return found


def number(text: str, where: str) -> float:
    """A cell as a number; `where` names it."""
    if not text:
        raise MeasurementError(f"{where}: missing value")
    try:
        return float(text)
    except ValueError:
        hint = "; write a decimal point" if text.count(",") == 1 and text.replace(",", "").isdigit() else ""
        raise MeasurementError(f"{where}: {text!r} is not a number{hint}") from None


class LabelledTable(NamedTuple):
    """Columns of a table whose lines refer to measurements by label, in SI, by quantity; NaN where a cell was blank."""

    row: np.ndarray  # which measurement
    columns: dict[str, np.ndarray]
    lines: tuple[int, ...]


def labelled_table(
    path: str | os.PathLike[str], labels: Sequence[str], units: Mapping[str, float], required: Sequence[str]
) -> LabelledTable:
    """Read a table with a column ``label`` and columns of numbers, `units` giving the SI value of each unit.

    Raises
    ------
    MeasurementError
        Naming file, line and column; a blank cell in a `required` column is one that is missing.
    """
    name = os.fspath(path)
    table = rows(read_text(path), name)
    if len(table) < 2:
        raise MeasurementError(f"{name}: a header line and at least one more are needed")
    (line, header), *body = table
    header = [cell.strip() for cell in header]
    known, needed = {"label", *units}, {"label", *required}
    if not needed <= set(header) <= known or len(set(header)) < len(header):
        optional = [column for column in units if column not in required]
        more = f", and {', '.join(optional)} as measured" if optional else ""
        raise MeasurementError(
            f"{name}, line {line}: columns {', '.join(header)}; expected label, {', '.join(required)}{more}, each once"
        )
    columns: dict[str, list[float]] = {column: [] for column in header if column != "label"}
    row = []
    for line, cells in body:
        where = f"{name}, line {line}"
        if len(cells) != len(header):
            raise MeasurementError(f"{where}: {len(cells)} columns, but the header has {len(header)}")
        by_name = dict(zip(header, (cell.strip() for cell in cells), strict=True))
        row.append(_row_of(by_name["label"], labels, where))
        for column, values in columns.items():
            blank = not by_name[column] and column not in required
            values.append(np.nan if blank else number(by_name[column], f"{where}, column {column}") * units[column])
    quantities = {column.rpartition("_")[0]: np.array(values) for column, values in columns.items()}
    return LabelledTable(np.array(row), quantities, tuple(line for line, _ in body))


def _row_of(label: str, labels: Sequence[str], where: str) -> int:
    """Which measurement is labelled so."""
    count = list(labels).count(label)
    if count != 1:
        found = "no measurement has" if count == 0 else f"{count} measurements have"
        raise MeasurementError(f"{where}, column label: {found} the label {label!r}; each needs its own, in a column label")
    return list(labels).index(label)
