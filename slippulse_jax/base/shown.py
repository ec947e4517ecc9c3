"""Numbers, lines and tables that show objects, the tables in notebooks."""

import dataclasses
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

SHOWN = 6
"""Largest size of an array shown in full; larger ones are shown by size and range."""
TIED = "\u00a0"
"""Space at which no line is folded."""
AS_GIVEN = 9
"""Digits with which a stated number is repeated: all that anyone gives, and no rounding of an arithmetic."""
MOST_ROWS = 20
"""Rows of a table that are shown."""


def short(x: Any) -> str:
    """Format a number, a small array, or the range of a larger.

    Anything else has its repr.

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
    """Power of ten for writing a value; 0 for everyday sizes."""
    if value == 0 or not np.isfinite(value):
        return 0
    exponent = int(np.floor(np.log10(abs(value))))
    return 0 if -2 <= exponent < 4 else exponent


def format_number(value: float, digits: int = 4) -> str:
    """``1.955e10`` or ``0.03``: to four digits."""
    exponent = exponent_of(value)
    text = f"{float(f'{value / 10.0**exponent:.{digits}g}'):.{max(digits, 6)}g}"
    return f"{text}e{exponent}" if exponent else text


def value_with_error(value: float, error: float | None, above: float | None = None) -> str:
    """Format a value with its error: ``(1.955 ± 0.032)e10``.

    With another error `above`: ``(9.2 -1.9 +2.5)e10``. The smaller error has two digits. The other numbers are written to the
    same place; without an error the value is, to four digits.
    """
    if error is None or not 0 < error < np.inf:
        return format_number(value)
    exponent = exponent_of(value)
    numbers = [x / 10.0**exponent for x in (value, error, error if above is None else above)]
    digits = 1 - int(np.floor(np.log10(min(numbers[1:]))))
    digits = digits if above is None else max(0, digits)
    middle, down, up = (f"{round(x, digits):.{max(0, digits)}f}" for x in numbers)
    text = f"{middle} ± {down}" if down == up else f"{middle} -{down} +{up}"
    return f"({text})e{exponent}" if exponent else text


def interval(piece: Any, near: float | None = None, width: float = 0.0) -> str:
    """Format an `Interval`: ``(1.92 to 1.99)e10``.

    It has the power of ten of the value `near`, and two digits of half of `width`, by default its own, as of a standard error;
    six digits in all at most. Open ends are said in words.
    """
    low, high, open_low, open_high = piece
    if open_low or open_high:
        one_sided = f"below {format_number(high)}" if open_low else f"above {format_number(low)}"
        return "unbounded" if open_low and open_high else one_sided
    exponent = exponent_of(low if near is None else near)
    if not -3 <= _power(max(abs(low), abs(high))) - exponent <= 3:  # far from the value, as at the second root
        exponent, width = exponent_of(high), 0.0
    low, high = low / 10.0**exponent, high / 10.0**exponent
    digits = 1 - _power((width / 10.0**exponent or high - low) / 2)
    digits = min(max(digits, 0), max(0, 5 - _power(max(abs(low), abs(high)))))
    if low and not round(low, digits):
        return " to ".join(format_number(end, 3) for end in piece[:2])
    style = ".6g" if round(low, digits) == round(high, digits) else f".{digits}f"
    text = f"{low:{style}} to {high:{style}}"
    return f"({text})e{exponent}" if exponent else text


def _power(x: float) -> int:
    """Power of ten of the first digit."""
    return int(np.floor(np.log10(max(x, 1e-300))))


def ends(x: ArrayLike, digits: int = 2) -> str:
    """``0.42 to 1.3``, smallest and largest number, or the only one."""
    return " to ".join(dict.fromkeys(format_number(float(end), digits) for end in (np.nanmin(x), np.nanmax(x))))


def plural(count: int, noun: str) -> str:
    """``1 length``, ``2 lengths``, ``2 stresses``."""
    return f"{count} {noun}" + ("es" if noun.endswith("s") else "s") * (count != 1)


def listed(texts: Sequence[str]) -> str:
    """``a, b and c``."""
    return ", ".join(texts[:-1]) + " and " * (len(texts) > 1) + texts[-1]


def either(texts: Sequence[str]) -> str:
    """``a, b or c``."""
    return listed(texts).replace(" and ", " or ")


def in_a_line(made: Any, *names: str) -> str:
    """Format the call that makes a dataclass, without default values."""
    fields = [field for field in dataclasses.fields(made) if not names or field.name in names]
    values = ((field.name, getattr(made, field.name), field.default) for field in fields)
    shown = [f"{name}={short(value)}" for name, value, default in values if value is not None and value is not default]
    return f"{type(made).__name__}({', '.join(shown)})"


def html(title: str, rows: Iterable[Sequence[str]], heads: Sequence[str] = (), below: str = "") -> str:
    """Format a table for a notebook, of at most `MOST_ROWS` rows."""
    rows = list(rows)
    lines = [f"<tr>{''.join(f'<th>{escape(head)}</th>' for head in heads)}</tr>"] * bool(heads)
    lines += [f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows[:MOST_ROWS]]
    more = f"<tr><td>… {len(rows) - MOST_ROWS} more</td></tr>" * (len(rows) > MOST_ROWS)
    after = f"<div>{escape(below)}</div>" * bool(below)
    return f'<div style="overflow-x: auto"><b>{escape(title)}</b><table>{"".join(lines)}{more}</table>{after}</div>'
