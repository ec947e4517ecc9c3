"""Read CSV files and DataFrames into columns of numbers and texts.

What cannot be read is refused by line and column. docs/reference/columns.md has the form of a table, of which
`slippulse_jax.inference.table.measurements` makes measurements.
"""

import csv
import math
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import Any, NamedTuple
from unicodedata import category
from unicodedata import name as name_of

import numpy as np

from slippulse_jax.base.files import file_name, read_whole
from slippulse_jax.inference.table.columns import (
    COLUMNS,
    IN_LC,
    KNOWN,
    NUMBER,
    OVER_ALL,
    MeasurementError,
    Named,
    check_rows,
    with_units,
)

LARGEST = 16 * 2**20
"""Bytes of the largest table that is read: some 300 000 measurements."""


class Table(NamedTuple):
    """Cells of a table, as text."""

    rows: Iterator[tuple[Any, list[str]]]  # number of the line, or label of the row, and cells; the header first
    name: str
    skipped: list[Any]  # numbers of lines that hold no measurement; more while the rows are read
    counted: str = "line"  # or "row", of a DataFrame
    commas: bool = False  # whether numbers may have decimal commas


_MADE_BY = (
    ("collect", "table.collect().to_pandas()"),
    ("compute", "table.compute()"),
    ("to_pandas", "table.to_pandas()"),
    ("toPandas", "table.toPandas()"),
    ("to_frame", "series.to_frame().T"),
)
"""A method that frames of other libraries have, and what makes a pandas.DataFrame of them."""


def of_dataframe(table: Any) -> Table:
    """Cells of a pandas.DataFrame."""
    kind = type(table)  # and not the table, which may have columns of these names
    makes = next((makes for has, makes in _MADE_BY if hasattr(kind, has)), "pandas.DataFrame(…)" * isinstance(table, Mapping))
    if makes or not hasattr(kind, "itertuples"):
        hint = f": {makes} makes one of it" * bool(makes)
        raise TypeError(f"table is {kind.__name__}: must be a pandas.DataFrame{hint}")
    if index := [name for name in table.index.names if name in KNOWN and name not in table.columns]:
        raise MeasurementError(f"table: {', '.join(index)} in the index, not among the columns: give table.reset_index()")
    header = (0, [str(column) for column in table.columns])
    blank = iter(table.isna().to_numpy().ravel())
    cells = (
        ["" if next(blank) else repr(float(x)) if isinstance(x, float | np.floating) else str(x) for x in row]
        for row in table.itertuples(index=False, name=None)
    )
    return Table(chain([header], zip(map(str, table.index), cells, strict=True)), "table", [], "row")


def read(table: Table, find: Callable[[list[str], str], Named]) -> dict[str, Any]:
    """Read a table into arguments of `Measurements` or `Gauges`."""
    known, numbers, cells = _columns(table, find)

    def place(i: int) -> str:
        return f"{table.name}, {table.counted} {numbers[i]}"

    of_numbers = {column.quantity: own for own, (column, _) in known.items() if column.choices is None}
    cells |= {own: [_visible(cell) for cell in cells[own]] for own, (column, _) in known.items() if column.choices != ()}
    if table.commas:
        _write_points(cells, of_numbers.values(), numbers, table.name)
    texts = {
        column.quantity: [column.choices[0] if column.choices and _missing(cell) else cell for cell in cells[own]]
        for own, (column, _) in known.items()
        if column.choices is not None
    }
    check_rows(texts, place)
    kind = texts.get("kind", ["length"] * len(numbers))
    spans = texts.pop("spans", None)
    if spans is not None:
        kind = ["at_least" if own == "yes" else how for own, how in zip(spans, kind, strict=True)]
        texts["kind"] = kind
    values = _numbers(cells, {own: known[own] for own in of_numbers.values()}, place, kind, spans)
    check_rows({**values, "kind": kind}, place, of_numbers, cells)
    other = {own: column for own, column in cells.items() if own not in known}
    if "block_width" in values:
        for name in values:
            if of_numbers[name].endswith(OVER_ALL):
                values[name] = values[name] / values["block_width"]
    found = {**values, **texts, f"{table.counted}s": numbers, "source": table.name, "other": other, "columns": of_numbers}
    return {**found, "skipped": tuple(table.skipped)}


def _columns(table: Table, find: Callable[[list[str], str], Named]) -> tuple[Named, list[Any], dict[str, list[str]]]:
    """Find the known columns, the numbers of the rows, and all cells."""
    name, counted = table.name, table.counted
    first, header = next(table.rows, (1, []))
    if len(header) < 2:
        alone = f"{header[0]!r} alone: columns are separated by commas, semicolons or tabs" if header else ""
        raise MeasurementError(f"{name}: {alone or 'empty: a header line and at least one more are needed'}")
    header = [_visible(cell) for cell in header]
    second = list(islice(table.rows, 1))
    names = with_units(header, second[0][1], f"{name}, {counted} {second[0][0]}") if second else None
    if names:
        table.skipped.append(second.pop()[0])
    names = names or header
    known = find([own for own in names if own], f"{name}, line {first}" if counted == "line" else name)
    numbers, columns = [], [[] for _ in names]
    for number, row in chain(second, table.rows):
        if len(row) != len(header):
            raise MeasurementError(f"{name}, {counted} {number}: {len(row)} columns, but the header has {len(header)}")
        numbers.append(number)
        for column, cell in zip(columns, row, strict=True):
            column.append(cell.strip())
    if not numbers:
        raise MeasurementError(f"{name}: a header line and at least one more are needed")
    cells = {}
    for i, (own, column) in enumerate(zip(names, columns, strict=True)):
        row = next((row for row, cell in enumerate(column) if not _missing(cell)), None)
        if own or row is not None:
            cells[own or "(no name)"] = column
        if not own and row is not None and i > 0:  # the first may be that of running numbers
            raise MeasurementError(f"{name}, {counted} {numbers[row]}, column {i + 1}: {column[row]!r} stands below no name")
    return known, numbers, cells


def _numbers(
    cells: Mapping[str, list[str]],
    known: Named,
    place: Callable[[int], str],
    kind: Sequence[str],
    spans: Sequence[str] | None,
) -> dict[str, np.ndarray]:
    """Convert numbers to λc, m, Pa and N/m, blanks to NaN."""
    raw: dict[str, list[float]] = {own: [] for own in known}
    for i in range(len(kind)):
        for own, (column, _) in known.items():
            cell = cells[own][i]
            plain = cell if cell.isascii() else cell.translate(_MINUS)
            if NUMBER.fullmatch(plain):
                raw[own].append(float(plain))
            elif not _missing(cell):
                raise MeasurementError(
                    f"{place(i)}, column {own}: {cell!r} is not a number{_advice(cell, own, column.quantity)}"
                )
            elif column.may_be_blank or (column.quantity == "length" and spans is not None and spans[i] == "yes"):
                raw[own].append(math.nan)
            elif column.quantity == "length_sigma" and kind[i] != "length":
                raw[own].append(0.0)
            else:
                advice = "" if column.required else ": write it in every line, or leave out the column"
                raise MeasurementError(f"{place(i)}, column {own}: {cell}{': ' * bool(cell)}missing value{advice}")
    values = {column.quantity: (np.array(raw[own]), unit) for own, (column, unit) in known.items()}
    with np.errstate(all="ignore"):  # a correlation length of 0 is refused later
        contact = math.prod(values.get("correlation_length", (1.0,)))
        found = {name: x * (unit / contact if name in IN_LC else unit) for name, (x, unit) in values.items()}
        if spans is not None and "block_length" in found:
            found["length"] = np.where(np.isnan(found["length"]), found["block_length"], found["length"])
        if "whole" in kind:  # whole numbers before they were divided by λc
            near = np.round(found["length"])
            whole = (np.array(kind) == "whole") & (abs(found["length"] - near) < 1e-6)
            found["length"] = np.where(whole, near, found["length"])
    return found


def read_text(path: str | os.PathLike[str]) -> str:
    """Read a file of UTF-8 text of at most `LARGEST` bytes."""
    name = file_name(path)
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
    return text.lstrip("\ufeff\u200b")


def of_file(path: str | os.PathLike[str]) -> Table:
    """Find the header of a file, and the data below it."""
    name, text = file_name(path), read_text(path)
    given = _SEPARATOR.match(text)
    separator = (given[1] or "\t") if given else ""

    def mark(line: str) -> str:
        def columns(one: str) -> tuple[int, int]:
            return len(KNOWN.intersection(next(csv.reader([line], delimiter=one, skipinitialspace=True)))), line.count(one)

        return separator or max(",;\t", key=columns)

    titles, best, first, delimiter = [], (), 0, ","
    for line, cells, tried, _ in _records(text, name, mark):
        names = [_visible(cell) for cell in cells]
        commented, names[0] = tried.join(names).startswith(_MARKS), _uncommented(names[0])
        known = len(KNOWN.intersection(names))
        if (commented and known < 2) or names[0].lower().startswith("sep="):
            continue
        rank = (known > 1 and not commented, known * (known > 1), not commented, sum(map(bool, names)))
        digits = 0 if commented else sum(NUMBER.fullmatch(one.replace(",", ".")) is not None for one in names)
        data = digits > 1 and (known < 2 or best[:1] == (True,))
        if not best or (rank > best and not data):
            best, first, delimiter = rank, line, tried
        if data:
            break
        titles += [line] * (not commented)
    if not best:
        return Table(iter(()), name, [])
    skipped = [line for line in titles if line < first]
    return Table(_below(text, name, first, delimiter, skipped), name, skipped, commas=delimiter != ",")


def _below(text: str, name: str, first: int, delimiter: str, skipped: list[int]) -> Iterator[tuple[int, list[str]]]:
    """Yield the header in line `first` and rows below; note `skipped` lines."""
    header: list[str] = []
    for line, cells, _, lines in _records(text, name, lambda _: delimiter, first):
        width, count = len(header), len(cells)
        if not header:
            header = [_uncommented(_visible(cells[0])), *(_visible(cell) for cell in cells[1:])]
            yield line, header
            continue
        if count != width and not "".join((*header[count:], *cells[width:])).strip():
            cells = [*cells, *[""] * (width - count)][:width]
        start = _visible(cells[0])
        comment = start.startswith(_MARKS) and (len(cells) != width or not "".join(cells[1:]).strip())
        again = _uncommented(start) == header[0] and [_visible(cell) for cell in cells[1:]] == header[1:]
        if comment or again:  # as between two files in one
            if comment and lines > 1:
                raise MeasurementError(f"{name}, line {line}: a comment, or {count} columns where the header has {width}?")
            skipped.append(line)
        else:
            yield line, cells


def _records(text: str, name: str, mark: Callable[[str], str], first: int = 0) -> Iterator[tuple[int, list[str], str, int]]:
    """Yield line, cells, delimiter and number of lines of every record.

    From line `first` on, without blank ones, a quoted cell whole; where that is 0, before the header is known, a comment ends
    with its line.
    """
    line = max(first, 1)
    lines = islice(_lines(text), line - 1, None)
    for start in lines:
        if not start.strip():
            line += 1
            continue
        comment = not first and start.lstrip().startswith(_MARKS)
        try:
            delimiter = mark(start)
            rest = [start] if comment else chain([start], lines)
            blanks = not start.lstrip().startswith(_MARKS)  # before a quotation mark are left out
            reader = csv.reader(rest, delimiter=delimiter, strict=first > 0, skipinitialspace=blanks)
            cells = next(reader)
        except csv.Error as error:
            raise MeasurementError(f"{name}, line {line}: {str(error).partition(' - ')[0]}") from None
        if any(cell.strip() for cell in cells):
            yield line, cells, delimiter, reader.line_num
        line += reader.line_num


def _lines(text: str) -> Iterator[str]:
    """Lines with their ends: carriage returns where there are no others."""
    end = "\n" if "\n" in text else "\r"
    return (found[0] for found in re.finditer(f"[^{end}]*{end}|[^{end}]+", text))


_MARKS = ("#", "%", "!", ";", "//")
"""What comments begin with."""
_SEPARATOR = re.compile(r'(?:\s|[#%!;/][^\r\n]*[\r\n])*+"?sep=([^\r\n"]?)"?[ \t]*(?:[\r\n]|\Z)', re.IGNORECASE)
"""The line in which Excel names the separator."""
_MISSING = {"", "-", "--", "—", "nan", "na", "n/a", "n.a.", "#n/a", "<na>", "null", "none"}
"""Cells of numbers that are blank."""
_MINUS = str.maketrans(dict.fromkeys("−–‐‑‒﹣－", "-"))
_DECIMAL = {mark: re.compile(rf"[+−–-]?\d*[{mark}]\d+(e[+−–-]?\d+)?", re.IGNORECASE | re.ASCII) for mark in ".,"}
"""Numbers with a decimal point, and with a comma."""


def _visible(cell: str) -> str:
    """Leave out outer spaces, and characters without width."""
    return (cell if cell.isascii() else "".join(one for one in cell if category(one) != "Cf")).strip()


def _missing(cell: str) -> bool:
    """Whether a cell stands for a missing value."""
    return cell.translate(_MINUS).casefold() in _MISSING


def _uncommented(name: str) -> str:
    """A known name of a first column without a comment's mark."""
    bare = name.lstrip("#%!;/ ")
    return bare if bare in KNOWN else name


def _write_points(cells: dict[str, list[str]], of_numbers: Collection[str], numbers: Sequence[Any], name: str) -> None:
    """Write points for decimal commas; refuse a table with both."""
    first = {}
    for own in of_numbers:
        for line, cell in zip(numbers, cells[own], strict=True):
            first.setdefault(next((mark for mark in ".," if _DECIMAL[mark].fullmatch(cell)), None), (line, cell))
    if "." in first and "," in first:
        (line, cell), (other, example) = first["."], first[","]
        both = f"{cell!r} has a decimal point, and {example!r} in line {other} a comma"
        raise MeasurementError(f"{name}, line {line}: {both}: write all numbers with one of them")
    for own in [own for own in cells if "," in first and not any("." in one for one in cells[own])]:
        cells[own] = [one.replace(",", ".") if _DECIMAL[","].fullmatch(one) else one for one in cells[own]]


def _advice(text: str, own: str, quantity: str) -> str:
    """What to write instead of a cell that is no number."""
    plain, beside = text.translate(_MINUS), f"{quantity}_sigma"
    words = not any(map(str.isnumeric, text))
    strange = re.search(r"[^\d.eE+\s-]", plain, re.ASCII) or re.search(r"\s", plain)
    if _DECIMAL[","].fullmatch(plain):
        return "; write a decimal point, or semicolons between the columns (pandas.read_csv: decimal=',')"
    if quantity == "length" and (
        re.match(r"[>≥⩾]|.*(?:\d\s*\+$|least|through|past)", text) or (words and text[0].isalpha() and len(text) > 2)
    ):
        return "; of a front that ran past a length without arrest write that length, and at_least in a column kind"
    if words:
        return ""
    if text.startswith(_MARKS):
        return "; as it has the cells of the header the line is no comment: leave it out"
    if re.search(r"\d\s*(?:±|\+/?-|\(\d)", text):
        return f"; write its error in a column {own.replace(quantity, beside, 1)}" if beside in COLUMNS else "; write no error"
    if strange:
        named = "" if strange[0].isascii() else f" ({name_of(strange[0], '?')})"
        return f": it holds {strange[0]!r}{named}; write digits and a decimal point"
    return "; write one, such as 14.03 or 2e-3"
