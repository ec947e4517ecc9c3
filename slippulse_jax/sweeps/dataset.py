"""The labelled dataset of a sweep, as CSV, NetCDF, JSON and text.

It holds units, meanings of flags, the request, and what computed it. Rows are written as they are read, in constant memory.
"""

import functools
import io
import json
import math
import platform
from collections import Counter
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, TextIO

import jax
import numpy as np
import xarray as xr

from slippulse_jax.base.files import plain, write_atomically
from slippulse_jax.sweeps.outputs import OUTPUTS
from slippulse_jax.sweeps.request import Request

POINTS_READ = 1 << 18
"""Points read at a time."""


def labelled(request: Request, data: dict[str, Any], **about: Any) -> xr.Dataset:
    """Label arrays of the request's shape; request, versions and `about` become attributes."""
    variables = {name: xr.Variable(tuple(request.axes.sizes), data[name], about_output(name)) for name in request.outputs}
    attributes = {
        "title": "first precursor to sliding, slippulse_jax sweep",
        "source": "Braun & Scheibert, Tribology Letters (2014): the lattice model, and theory where an output says so",
        "request": json.dumps(request.describe()),
        "request_sha256": request.digest,
    }
    return xr.Dataset(variables, request.axes.coords, attributes | current_versions() | about)


def about_output(name: str) -> dict[str, Any]:
    """Attributes of an output: meaning, unit, and what its flags stand for."""
    output = OUTPUTS[name]
    about: dict[str, Any] = {"long_name": output.long_name, "units": output.unit}
    if output.comment:
        about["comment"] = output.comment
    if output.outcomes:
        about["flag_values"] = np.array([one.value for one in output.outcomes], output.dtype)
        about["flag_meanings"] = " ".join(one.name.lower() for one in output.outcomes)
        about["comment"] = "; ".join(f"{one.value}: {one.message}" for one in output.outcomes)
    return about


@functools.cache
def current_versions() -> dict[str, str]:
    """Versions of the packages on which the last digits depend."""
    return {name: version(name) for name in ("slippulse_jax", "jax", "jaxlib")}


@functools.cache
def processor() -> str:
    """Name of the processor that computes sweeps here."""
    device = jax.devices()[0]
    if device.platform != "cpu":
        return device.device_kind
    described = Path("/proc/cpuinfo")  # of Linux
    lines = described.read_text(encoding="utf-8").splitlines() if described.exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def computed_by(about: dict[str, Any] | None = None) -> str:
    """Name processor and versions of a sweep, or of this process."""
    about = about or {"processor": processor()} | current_versions()
    return ", ".join([str(about["processor"]), *(f"{name} {about.get(name)}" for name in current_versions())])


# --- files and summaries -------------------------------------------------------------------------------------------------


def write(found: xr.Dataset, path: Path) -> None:
    """Write ``.nc``, with units, request and versions, or ``.csv``, atomically."""
    if path.suffix == ".nc":
        content = bytes(found.drop_encoding().to_netcdf(engine="h5netcdf"))
    else:
        table = io.StringIO()
        write_csv(found, table)
        content = table.getvalue().encode()
    write_atomically(path, content)


def write_csv(found: xr.Dataset, file: TextIO) -> None:
    """Write swept parameters and outputs, the last axis running fastest."""
    columns = [*(name for name in found.coords if found[name].ndim), *found.data_vars]
    for number, part in enumerate(_pieces(found)):
        table = part.to_dataframe(dim_order=list(part.sizes)).reset_index()[columns]
        table.to_csv(file, index=False, header=number == 0, na_rep="nan", lineterminator="\n")


def _pieces(found: Any) -> Iterator[Any]:
    """Parts of a dataset or variable, cut along its first dimension."""
    found = found if found.sizes else found.expand_dims("point")
    first, n = next(iter(found.sizes.items()))
    step = max(1, POINTS_READ * n // math.prod(found.sizes.values()))
    yield from (found.isel({first: slice(start, start + step)}) for start in range(0, n, step))


def as_json(found: xr.Dataset, *, values: bool) -> dict[str, Any]:
    """Request, axes, and all values or the range of each output."""
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
        content["data"] = {str(name): plain(column.values) for name, column in found.data_vars.items()}
    else:
        content["ranges"] = {str(name): list(_range(column)) for name, column in found.data_vars.items()}
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
    counts = Counter()
    for piece in _pieces(column):
        counts.update(dict(zip(*np.unique(piece.values, return_counts=True), strict=True)))
    outcomes = zip(column.attrs["flag_meanings"].split(), column.attrs["flag_values"], strict=True)
    return ", ".join(f"{name} {counts[value]}" for name, value in outcomes if counts[value])


def _range(column: xr.DataArray) -> tuple[float | None, float | None, int]:
    """Smallest and largest finite value, and number of others, read in pieces."""
    ends, missing = [], 0
    for piece in _pieces(column):
        values = piece.values
        finite = values[np.isfinite(values)]
        missing += values.size - finite.size
        ends += [float(finite.min()), float(finite.max())] if finite.size else []
    return (min(ends), max(ends), missing) if ends else (None, None, missing)
