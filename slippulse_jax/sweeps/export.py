"""A sweep as CSV, NetCDF, JSON or a summary.

Rows are written as they are read, in constant memory.
"""

import io
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import xarray as xr

from slippulse_jax.files import write_atomically
from slippulse_jax.shown import plain
from slippulse_jax.sweeps.dataset import current_versions

ROWS = 1 << 18
"""Points read at a time."""


def write(found: xr.Dataset, path: Path) -> None:
    """Write to ``.nc`` (with units, request and versions) or ``.csv``, atomically."""
    if path.suffix == ".nc":
        content = bytes(found.drop_encoding().to_netcdf(engine="h5netcdf"))
    else:
        table = io.StringIO()
        write_csv(found, table)
        content = table.getvalue().encode()
    write_atomically(path, content)


def write_csv(found: xr.Dataset, file: TextIO) -> None:
    """Write one line per point, swept parameters and outputs; the last axis runs fastest."""
    columns = [*(name for name in found.coords if found[name].ndim), *found.data_vars]
    for number, part in enumerate(_pieces(found)):
        table = part.to_dataframe(dim_order=list(part.sizes)).reset_index()[columns]
        table.to_csv(file, index=False, header=number == 0, na_rep="nan", lineterminator="\n")


def _pieces(found: Any) -> Iterator[Any]:
    """Parts of a dataset or variable, cut along its first dimension."""
    found = found if found.sizes else found.expand_dims("point")
    first, n = next(iter(found.sizes.items()))
    step = max(1, ROWS * n // math.prod(found.sizes.values()))
    yield from (found.isel({first: slice(start, start + step)}) for start in range(0, n, step))


def as_json(found: xr.Dataset, *, values: bool) -> dict[str, Any]:
    """Request, axes, and either all values (null if not finite) or the range of each output."""
    content: dict[str, Any] = {
        "points": math.prod(found.sizes.values()),
        "complete": bool(found.attrs["complete"]),
        "dims": list(found.sizes),
        "coords": {str(name): plain(found[name].values) for name in found.coords},
        "request": json.loads(found.attrs["request"]),
        "request_sha256": found.attrs["request_sha256"],
        "versions": {name: found.attrs[name] for name in current_versions()},
        "units": {str(name): found[name].attrs["units"] for name in (*found.coords, *found.data_vars)},
    }
    if values:
        content["data"] = {str(name): plain(found[name].values) for name in found.data_vars}
    else:
        content["ranges"] = {str(name): list(_range(found[name])) for name in found.data_vars}
    return content


def summary(found: xr.Dataset, where: str) -> str:
    """Number of points, and range or outcomes of each output, as text."""
    sizes = " × ".join(f"{dim} {n}" for dim, n in found.sizes.items()) or "one"
    lines = [f"{math.prod(found.sizes.values())} points ({sizes}) in {where}"]
    for name, column in found.data_vars.items():
        if "flag_meanings" in column.attrs:
            lines.append(f"{name!s:26s} {_outcomes(column)}")
            continue
        low, high, missing = _range(column)
        unit = f" {column.attrs['units']}" * (column.attrs["units"] != "1")
        span = "no finite value" if low is None else f"{low:.6g} … {high:.6g}{unit}"
        lines.append(f"{name!s:26s} {span}" + (f", {missing} not finite" if missing else ""))
    return "\n".join(lines)


def _outcomes(column: xr.DataArray) -> str:
    """Count each outcome: ``arrested 12, no_domino 3``."""
    values = np.asarray(column.attrs["flag_values"])
    count = np.sum(
        [(piece.values[..., None] == values).reshape(-1, len(values)).sum(axis=0) for piece in _pieces(column)], axis=0
    )
    return ", ".join(f"{name} {n}" for name, n in zip(column.attrs["flag_meanings"].split(), count, strict=True) if n)


def _range(column: xr.DataArray) -> tuple[float | None, float | None, int]:
    """Smallest and largest finite value and number of values not finite, read piece by piece."""
    low, high, missing = math.inf, -math.inf, 0
    for piece in _pieces(column):
        values = piece.values
        finite = values[np.isfinite(values)]
        missing += values.size - finite.size
        if finite.size:
            low, high = min(low, float(finite.min())), max(high, float(finite.max()))
    return (low, high, missing) if low <= high else (None, None, missing)
