"""Text of a CSV file as numbered rows of cells; what is wrong is named with file, line and column."""

import csv
import io
import os
from pathlib import Path

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
