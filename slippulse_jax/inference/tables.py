"""Read tables of measurements and of gauges from CSV files.

An error names file, line and column.

One first precursor per line, with the units in the column names, in one of two forms:

SI-prefixed
    ``height_mm``, ``correlation_length_um``, ``poisson``, ``length_mm``, ``length_sigma_mm``, and optionally ``young_GPa``
dimensionless (lengths in λc)
    ``height``, ``poisson``, ``length``, ``length_sigma``

Without a column of σ the errors are taken as equal, and their size from the scatter. Further columns, all optional:

``kind``
    ``length`` (default), ``whole`` (a count of whole contacts: the length in λc lies within one below it), ``at_least``
    (the front ran past this length without arrest); σ may be 0 or blank for the last two
``height_sigma_mm`` or ``height_sigma``, ``correlation_length_sigma_um``, ``poisson_sigma``, ``young_sigma_GPa``
    standard errors of the inputs; lines of one specimen with the same value and error share one true value
``prestress``, ``threshold_slope``
    known conditions: σ_0/σ_s, and the relative rise of the threshold per contact
``displacement_um``, ``displacement_sigma_um``, ``force_N_per_mm``, ``force_sigma_N_per_mm``
    edge displacement, and driving force over the width of the block, at nucleation; SI with ``young_GPa``, blank where not
    measured
``block_length_mm`` or ``block_length``
    length of the block, from the pushed edge to its free end; blank for one without end. A front that ran through all of it has
    that length and the kind ``at_least``
``machine_stiffness_N_per_m`` with ``block_width_mm``, or ``machine_stiffness`` (over the width of the block and E)
    stiffness of the machine that pushes, from its own frame to the edge; SI with ``young_GPa``, blank where the edge is held
``push_height_mm`` with ``push_width_mm``, ``push_height_sigma_mm``, ``push_control``; or ``push_height`` … in λc
    where the side is pushed: height of the middle of the pusher over the interface, and its own height; with the width blank,
    height of its lower end, all above being pushed. ``displacement`` (default) or ``force`` is held. `fit` then takes
    the body for a block under two-dimensional elasticity
``specimen``, ``provenance``
    any text, which ``--each-specimen`` refers to; and one of measured, printed, digitised, synthetic
``label``
    a name for the precursor, by which the table of gauges refers to it (`read_gauges`)

Lengths may be given in ``m``, ``cm``, ``mm``, ``um`` or ``nm``, and Young's modulus in ``Pa``, ``kPa``, ``MPa`` or ``GPa``, by
the ending of the column's name. Other columns are kept and named in the report, and have no effect; but one that seems to mean
a quantity that the table lacks, in another language or unit, is refused (`slippulse_jax.inference.names`). Lines that start
with ``#`` are comments.

Columns are separated by commas, semicolons or tabs; between semicolons and tabs all numbers of a table may have decimal commas.
"""

import csv
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from slippulse_jax.files import read_whole
from slippulse_jax.inference.measurements import MAY_BE_BLANK, PROVENANCES, Gauges, MeasurementError, Measurements, check_domain
from slippulse_jax.inference.names import meant
from slippulse_jax.units import UNITS_OF_LENGTH, UNITS_OF_MODULUS, split_unit

LARGEST = 16 * 2**20
"""Bytes of the largest table that is read: some 300 000 measurements."""


class _Column(NamedTuple):
    quantity: str
    unit: float = 1.0  # in SI
    over_correlation_length: bool = False
    required: bool = False


def _columns(*names: str, over: bool = False, required: bool = False) -> dict[str, _Column]:
    """Columns of these names, which end in their units; ``young_sigma_GPa`` holds the ``young_sigma``."""
    return {name: _Column(*split_unit(name), over, required) for name in names}


_BOTH = {**_columns("poisson", required=True), **_columns("poisson_sigma", "prestress", "threshold_slope")}
_SI = {
    **_columns("correlation_length_um", required=True),
    **_columns("height_mm", "length_mm", over=True, required=True),
    **_columns("length_sigma_mm", over=True),
    **_columns("young_GPa"),
    **_columns("height_sigma_mm", over=True),
    **_columns("correlation_length_sigma_um", "young_sigma_GPa"),
    **_columns("block_length_mm", "push_height_mm", "push_height_sigma_mm", "push_width_mm", over=True),
    **_columns("machine_stiffness_N_per_m", "block_width_mm"),
    **_columns("displacement_um", "displacement_sigma_um", "force_N_per_mm", "force_sigma_N_per_mm"),
}
_ALIASES = {
    f"{column.removesuffix('_' + unit)}_{other}": (column, size / units[unit])
    for column in _SI
    for units in (UNITS_OF_LENGTH, UNITS_OF_MODULUS)
    for unit in units
    if column.endswith("_" + unit) and "_per_" not in column
    for other, size in units.items()
}
"""By a name in another unit: the usual column, and the other unit in that of the column."""
_PLAIN = {
    **_columns("height", "length", required=True),
    **_columns("length_sigma", "height_sigma", "block_length", "machine_stiffness"),
    **_columns("push_height", "push_height_sigma", "push_width"),
}
_QUANTITIES = {meaning.quantity: column for column, meaning in {**_BOTH, **_SI}.items()}
MOST_GUESSED = 50
"""Largest number of unknown columns whose meaning is guessed."""
_TEXT = ("specimen", "provenance", "kind", "label", "push_control")
_FORMS = (
    "either height_mm, correlation_length_um, poisson, length_mm, length_sigma_mm or height, poisson, length, length_sigma "
    "(a table without σ is read too)"
)


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
    table_rows = rows(read_text(path), name)
    line, header = next(table_rows, (1, []))
    lengths = _parse(header, table_rows, name, header_place=f"{name}, line {line}", counted="line")
    return lengths if gauges is None else replace(lengths, gauges=read_gauges(gauges, lengths.label))


def from_dataframe(table: Any, name: str = "table") -> Measurements:
    """Measurements of a pandas.DataFrame with the columns of a CSV file; NaN and None are blank cells.

    Raises
    ------
    MeasurementError
        As `read_measurements`, but with the row's index label instead of a line.
    TypeError
        If it is no DataFrame.
    """
    if not (hasattr(table, "itertuples") and hasattr(table, "columns")):
        makes = "series.to_frame().T" if hasattr(table, "to_frame") else "pandas.DataFrame(…)" * isinstance(table, Mapping)
        hint = f": {makes} makes one of it" * bool(makes)
        raise TypeError(f"{name} is {type(table).__name__}: must be a pandas.DataFrame{hint}")
    missing = table.isna()
    cells = [
        [
            "" if none else repr(float(x)) if isinstance(x, float | np.floating) else str(x)
            for x, none in zip(row, blank, strict=True)
        ]
        for row, blank in zip(table.itertuples(index=False, name=None), missing.itertuples(index=False, name=None), strict=True)
    ]
    header = [str(column) for column in table.columns]
    return _parse(header, zip(map(str, table.index), cells, strict=True), name, header_place=name, counted="row")


def measurements_of(given: Any) -> Measurements:
    """Return measurements as they are, or read them from a DataFrame or a CSV file."""
    if isinstance(given, Measurements):
        return given
    if isinstance(given, str | os.PathLike):
        return read_measurements(given)
    if hasattr(given, "itertuples") and hasattr(given, "columns"):
        return from_dataframe(given)
    raise TypeError(f"measurements is {type(given).__name__}: must be Measurements, pandas.DataFrame or the path of a CSV file")


def _parse(
    header: list[str], table_rows: Iterable[tuple[Any, list[str]]], name: str, *, header_place: str, counted: str
) -> Measurements:
    """Measurements of a header and of rows of text, numbered as lines of a file or rows of a DataFrame."""
    if not header:
        raise MeasurementError(f"{name}: empty: expected a header line with {_FORMS}")
    header = [cell.strip() for cell in header]
    columns = _known_columns(header, header_place)
    table: dict[str, list[float]] = {column.quantity: [] for column in columns.values() if column.quantity != "block_width"}
    texts: dict[str, list[str]] = {column: [] for column in header if column not in columns}
    numbers = []
    for number, cells in table_rows:
        numbers.append(number)
        where = f"{name}, {counted} {number}"
        if len(cells) != len(header):
            raise MeasurementError(f"{where}: {len(cells)} columns, but the header has {len(header)}")
        row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
        for quantity, value in _quantities(row, columns, where).items():
            table[quantity].append(value)
        if row.get("provenance", "") not in ("", *PROVENANCES):
            raise MeasurementError(f"{where}, column provenance: {row['provenance']!r}: one of {', '.join(PROVENANCES)}")
        for column, cells_so_far in texts.items():
            cells_so_far.append(row[column])
    if not numbers:
        raise MeasurementError(f"{name}: a header and no measurements")
    quantities: dict[str, Any] = {quantity: np.array(values) for quantity, values in table.items()}
    return Measurements(
        **quantities,
        kind=tuple(text or "length" for text in texts.pop("kind", ())),
        specimen=tuple(texts.pop("specimen", ())),
        provenance=tuple(texts.pop("provenance", ())),
        label=tuple(texts.pop("label", ())),
        push_control=tuple(text or "displacement" for text in texts.pop("push_control", ())),
        lines=tuple(numbers) if counted == "line" else (),
        rows=tuple(numbers) if counted == "row" else (),
        source=name,
        other=texts,
        columns={column.quantity: name for name, column in columns.items()},
    )


def _in_usual_units(given: list[str], where: str) -> list[str]:
    """Rename the columns to the units of `_SI`; refuse one that occurs twice, or in two units."""
    usual = [_ALIASES.get(column, (column,))[0] for column in given]
    for column, count in Counter(usual).items():
        if count == 1:
            continue
        twice = [own for own, known in zip(given, usual, strict=True) if known == column]
        if len(set(twice)) > 1:
            raise MeasurementError(f"{where}, columns {' and '.join(twice)}: one quantity in two units")
        raise MeasurementError(f"{where}, column {column or '(no name)'}: there {count} times")
    return usual


def _known_columns(given: list[str], where: str) -> dict[str, _Column]:
    """Find the numeric columns of this table; refuse one with columns of neither form, or of both."""
    header = _in_usual_units(given, where)
    folded = {known.casefold(): known for known in (*_SI, *_PLAIN, *_BOTH, *_TEXT)}
    for column in header:
        meant = folded.get(column.casefold(), column)
        if meant != column and meant not in header:
            raise MeasurementError(f"{where}, column {column}: did you mean {meant}? Upper and lower case count in units")
    only_si = [column for column in _SI if column in header]
    only_plain = [column for column in _PLAIN if column in header]
    if only_si and only_plain:
        raise MeasurementError(f"{where}: columns of both forms, {only_si[0]} and {only_plain[0]}: choose one")
    _refuse_misnamed([own for own, column in zip(given, header, strict=True) if column not in folded.values()], header, where)
    known = {**_BOTH, **(_SI if only_si else _PLAIN)}
    missing = [column for column, meaning in known.items() if meaning.required and column not in header]
    if missing:
        wanted = [column for column, meaning in known.items() if meaning.required]
        expected = f"the columns {', '.join(wanted)}" if only_si or only_plain else _FORMS
        if missing == ["correlation_length_um"]:
            expected = "a guess where λc is not known, such as 10, with correlation_length_sigma_um (docs/fit/own_csv.md)"
        raise MeasurementError(f"{where}: no column {', '.join(missing)} among {', '.join(given)}; expected {expected}")
    for column in header:
        partner = _value_column(column)
        if column in known and partner in known and partner not in header:
            raise MeasurementError(f"{where}, column {column}: there is no column {partner} that it could be the error of")
    machine, width = "machine_stiffness_N_per_m", "block_width_mm"
    if only_si and (machine in header) != (width in header):
        there, missed = (machine, width) if machine in header else (width, machine)
        raise MeasurementError(f"{where}, column {there}: needs the column {missed}: the model is one of a unit width")
    factors = (_ALIASES.get(column, (column, 1.0))[1] for column in given)
    return {
        own: known[column]._replace(unit=known[column].unit * factor)
        for own, column, factor in zip(given, header, factors, strict=True)
        if column in known
    }


def _refuse_misnamed(unknown: list[str], header: list[str], where: str) -> None:
    """Refuse columns that seem to mean a quantity that the table lacks, and suggest the name.

    Symbols and words of other languages are always refused. A name that is only like a known one is refused if it has a unit,
    or if the known one is required.
    """
    guesses = {own: meant(own, {**_QUANTITIES, **_PLAIN, "specimen": None}) for own in unknown[:MOST_GUESSED]}
    plain = any(column in _PLAIN for column in header)
    in_si = not plain and (any(column in _SI for column in header) or any(guess.unit for guess in guesses.values()))
    form = {meaning.quantity: (column, meaning) for column, meaning in {**_BOTH, **(_SI if in_si else _PLAIN)}.items()}
    form["specimen"] = ("specimen", _Column("specimen"))
    said = []
    for own, guess in guesses.items():
        lacking = [one for one in guess.quantities if one in form and form[one][0] not in header]
        if lacking and (guess.sure or guess.unit or any(form[one][1].required for one in lacking)):
            names = [name if (name := f"{one}_{guess.unit}") in {*_SI, *_ALIASES} else form[one][0] for one in lacking]
            remark = "" if any(form[one][1].required for one in lacking) else " If not, give it another name."
            said.append(f"{own}: did you mean {' or '.join(names)}?{remark}")
    if said:
        raise MeasurementError(f"{where}, column {' Column '.join(said)}")


def _value_column(column: str) -> str:
    """``young_GPa`` for ``young_sigma_GPa``."""
    return column.replace("_sigma", "")


def _quantities(row: dict[str, str], columns: dict[str, _Column], where: str) -> dict[str, float]:
    """Values of one line as quantities in λc, m, Pa and N/m, checked."""
    kind = row.get("kind", "") or "length"
    raw: dict[str, float] = {}
    correlation_length = 1.0
    for column, meaning in columns.items():
        place = f"{where}, column {column}"
        if not row[column] and meaning.quantity in MAY_BE_BLANK:
            raw[column] = np.nan
        elif not row[column] and meaning.quantity == "length_sigma" and kind != "length":
            raw[column] = 0.0
        else:
            raw[column] = number(row[column], place)
        if meaning.quantity == "correlation_length":  # 0 is refused below, not by a division
            correlation_length = raw[column] * meaning.unit or np.nan
    quantities, shown = {}, {}
    for column, meaning in columns.items():
        scale = meaning.unit / correlation_length if meaning.over_correlation_length else meaning.unit
        quantities[meaning.quantity] = raw[column] * scale
        shown[meaning.quantity] = (column, row[column])
    if np.isfinite(quantities["length"]) and kind == "whole":
        # what was a whole number before it was divided by λc
        near = round(quantities["length"])
        quantities["length"] = float(near) if abs(quantities["length"] - near) < 1e-6 else quantities["length"]
    # the correlation length comes first: it may be the reason why a height or length is out of its domain
    check_domain(dict(sorted(quantities.items(), key=lambda item: item[0] != "correlation_length")), kind, where, shown)
    if "block_width" in quantities:
        width = quantities.pop("block_width")
        if np.isnan(width) and not np.isnan(quantities["machine_stiffness"]):
            raise MeasurementError(f"{where}, column block_width_mm: missing value: machine_stiffness_N_per_m is divided by it")
        quantities["machine_stiffness"] /= width
    return quantities


_GAUGE_COLUMNS = ("position_mm", "slip_um", "slip_sigma_um", "stress_MPa", "stress_sigma_MPa")


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
    table = labelled_table(path, labels, _GAUGE_COLUMNS, required=("position_mm",))
    return Gauges(table.row, **table.columns, lines=table.lines, source=os.fspath(path))


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
                if column not in _TEXT and form.fullmatch(cell):
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


class LabelledTable(NamedTuple):
    """Columns of a table whose lines refer to measurements by label, in SI, by quantity; NaN where a cell was blank."""

    row: np.ndarray  # which measurement
    columns: dict[str, np.ndarray]
    lines: tuple[int, ...]


def labelled_table(
    path: str | os.PathLike[str], labels: Sequence[str], names: Sequence[str], required: Sequence[str]
) -> LabelledTable:
    """Read a table with a column ``label`` and columns of numbers, whose names end in their units.

    Raises
    ------
    MeasurementError
        Naming file, line and column; a blank cell in a `required` column is one that is missing.
    """
    name = os.fspath(path)
    body = rows(read_text(path), name)
    line, header = next(body, (1, []))
    if not header:
        raise MeasurementError(f"{name}: a header line and at least one more are needed")
    header = [cell.strip() for cell in header]
    known, needed = {"label", *names}, {"label", *required}
    if not needed <= set(header) <= known or len(set(header)) < len(header):
        optional = [column for column in names if column not in required]
        more = f", and {', '.join(optional)} as measured" if optional else ""
        raise MeasurementError(
            f"{name}, line {line}: columns {', '.join(header)}; expected label, {', '.join(required)}{more}, each once"
        )
    columns: dict[str, list[float]] = {column: [] for column in header if column != "label"}
    count, place = Counter(labels), {label: row for row, label in enumerate(labels)}
    row, lines = [], []
    for line, cells in body:
        where = f"{name}, line {line}"
        if len(cells) != len(header):
            raise MeasurementError(f"{where}: {len(cells)} columns, but the header has {len(header)}")
        by_name = dict(zip(header, (cell.strip() for cell in cells), strict=True))
        label = by_name["label"]
        if count[label] != 1:
            found = f"{count[label]} measurements have" if count[label] else "no measurement has"
            raise MeasurementError(f"{where}, column label: {found} the label {label!r}; each needs its own, in a column label")
        row.append(place[label])
        lines.append(line)
        for column, values in columns.items():
            blank = not by_name[column] and column not in required
            values.append(np.nan if blank else number(by_name[column], f"{where}, column {column}"))
    if not row:
        raise MeasurementError(f"{name}: a header line and at least one more are needed")
    meanings = ((split_unit(column), values) for column, values in columns.items())
    quantities = {quantity: np.array(values) * unit for (quantity, unit), values in meanings}
    return LabelledTable(np.array(row), quantities, tuple(lines))
