"""Numbers, lines and tables that show objects, the tables in notebooks."""

import dataclasses
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

SHOWN = 6
"""Largest size of an array shown in full; larger ones are shown by size and range."""
MOST_ROWS = 20
"""Rows of a table that are shown."""


def short(x: Any) -> str:
    """Format a number, a small array, or size and range of a larger one; anything else by its repr.

    Examples
    --------
    >>> short(0.030000001), short(np.array([10.0, 25.0])), short(np.arange(9.0).reshape(3, 3))
    ('0.03', '[10, 25]', '<3×3 from 0 to 8>')
    """
    try:
        array = np.asarray(x)
    except Exception:  # a value that JAX traces has no number
        return repr(x)
    if array.dtype.kind not in "biuf":
        return repr(x)
    if array.ndim == 0:
        return f"{array:g}"
    if array.size <= SHOWN:
        text = np.array2string(array, separator=", ", max_line_width=10000, formatter={"float": "{:g}".format})
        return " ".join(text.split()).replace("[ ", "[")
    return f"<{'×'.join(map(str, array.shape))} from {np.nanmin(array):g} to {np.nanmax(array):g}>"


def exponent_of(value: float) -> int:
    """Power of ten with which to write a value; 0 for everyday sizes."""
    if value == 0 or not np.isfinite(value):
        return 0
    exponent = int(np.floor(np.log10(abs(value))))
    return 0 if -2 <= exponent < 4 else exponent


def format_number(value: float, digits: int = 4) -> str:
    """``1.955e10`` or ``0.03``: to four digits."""
    exponent = exponent_of(value)
    text = f"{float(f'{value / 10.0**exponent:.{digits}g}'):g}"
    return f"{text}e{exponent}" if exponent else text


def in_a_line(made: Any, *names: str) -> str:
    """Format the call that makes a dataclass, with all or some of its fields, without default values."""
    fields = [field for field in dataclasses.fields(made) if not names or field.name in names]
    values = ((field.name, getattr(made, field.name), field.default) for field in fields)
    shown = [f"{name}={short(value)}" for name, value, default in values if value is not None and value is not default]
    return f"{type(made).__name__}({', '.join(shown)})"


def html(title: str, rows: Iterable[Sequence[str]], heads: Sequence[str] = (), below: str = "") -> str:
    """Format a table for a notebook, with scrolling where it is too wide; rows beyond `MOST_ROWS` are counted."""
    rows = list(rows)
    lines = [f"<tr>{''.join(f'<th>{escape(head)}</th>' for head in heads)}</tr>"] * bool(heads)
    lines += [f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows[:MOST_ROWS]]
    more = f"<tr><td>… {len(rows) - MOST_ROWS} more</td></tr>" * (len(rows) > MOST_ROWS)
    after = f"<div>{escape(below)}</div>" * bool(below)
    return f'<div style="overflow-x: auto"><b>{escape(title)}</b><table>{"".join(lines)}{more}</table>{after}</div>'
