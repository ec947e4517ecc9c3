"""The labelled dataset of a sweep: units, meanings of flags, the request, and what computed it."""

import functools
import json
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr

from slippulse_jax.sweeps.outputs import OUTPUTS
from slippulse_jax.sweeps.request import PARAMETERS, Request


def labelled(request: Request, data: dict[str, Any], **about: Any) -> xr.Dataset:
    """Make a dataset of arrays of the request's shape, with units; request, versions and `about` become attributes."""
    coords = {
        name: xr.Variable(() if not values.ndim else (name if request.product else "point"), values, _parameter(name))
        for name, values in request.parameters.items()
    }
    variables = {name: xr.Variable(request.dims, data[name], _output(name)) for name in request.outputs}
    attributes = {
        "title": "first precursor to sliding, slippulse_jax sweep",
        "source": "Braun & Scheibert, Tribology Letters (2014): the lattice model, and theory where an output says so",
        "request": json.dumps(request.describe()),
        "request_sha256": request.digest,
    }
    return xr.Dataset(variables, coords, attributes | current_versions() | about)


@functools.cache
def current_versions() -> dict[str, str]:
    """Versions of the packages on which the last digits of a result depend."""
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
    """Name the processor and the versions in the attributes of a sweep, or those of this process."""
    about = about or current_versions() | {"processor": processor()}
    return ", ".join([str(about["processor"]), *(f"{name} {about.get(name)}" for name in current_versions())])


def _parameter(name: str) -> dict[str, Any]:
    symbol, unit, label, long_name = PARAMETERS[name]
    return {"long_name": long_name, "units": unit, "symbol": symbol} | ({"equation": label} if label else {})


def _output(name: str) -> dict[str, Any]:
    output = OUTPUTS[name]
    about: dict[str, Any] = {"long_name": output.long_name, "units": output.unit}
    if output.comment:
        about["comment"] = output.comment
    if output.outcomes:
        about["flag_values"] = np.array([one.value for one in output.outcomes], output.dtype)
        about["flag_meanings"] = " ".join(one.name.lower() for one in output.outcomes)
        about["comment"] = "; ".join(f"{one.value}: {one.message}" for one in output.outcomes)
    return about
