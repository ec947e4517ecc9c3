"""Records of a fit for JSON, and the request that repeats it."""

import dataclasses
import hashlib
import json
import math
import os
import platform
import tomllib
from collections.abc import Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from slippulse_jax.files import plain, read_whole, shortened
from slippulse_jax.inference.budget import AsSlider, Moved
from slippulse_jax.inference.measurements import GAUGE_COLUMNS, NUMERIC, Gauges, Measurements
from slippulse_jax.inference.parameters import Parameter
from slippulse_jax.inference.profile import Interval
from slippulse_jax.inference.verdict import Identifiability
from slippulse_jax.status import Outcome
from slippulse_jax.theory import rebreaking_b

if TYPE_CHECKING:
    import pandas as pd

    from slippulse_jax.inference.result import FitResult, Root


SCHEMA = 1
"""Version of the record: larger where a record written before could not be read."""


def to_dict(result: "FitResult") -> dict[str, Any]:
    """Return the whole result as plain Python values; open ends and missing numbers are None."""
    q = result.parameters
    units = {one.label: one.unit for one in q.free}
    content = {
        "schema": SCHEMA,
        "identifiability": result.identifiability.name.lower(),
        "statement": result.identifiability.value,
        "reason": result.reason or None,
        "verdicts": {
            name: {"identifiability": v.identifiability.name.lower(), "reason": v.reason or None}
            for name, v in result.verdicts.items()
        },
        "converged": result.converged,
        "model": {"body": q.body, "event": q.event},
        "values": result.values,
        "stderr": result.stderrs,
        "stderr_with_inputs": result.stderrs_with_inputs,
        "units": {name: units.get(name, "") for name in result.values},
        "intervals": {
            name: {f"{level:g}": [_ends(piece) for piece in pieces] for level, pieces in by_level.items()}
            for name, by_level in result.intervals.items()
        },
        "correlations": [[a, b, value] for (a, b), value in result.correlations.items()],
        "stiffness_ratios": [[*labels, *found] for labels, found in result.stiffness_ratios.items()],
        "inputs": result.inputs,
        "directions": [
            {"combination": one.text, "stderr": one.stderr, "coefficients": one.coefficients} for one in result.directions
        ],
        "roots": [_root(root, result) for root in result.roots],
        "searched": {one.label: [one.value(one.low), one.value(one.high)] for one in q.free},
        "deviance": result.deviance,
        "chi2": result.deviance if result.problem.plain else None,
        "dof": result.dof,
        "p_value": result.p_value,
        "sigma_scaled_by": result.scatter,
        "measurements": [_measurement(result, i) for i in range(len(result.measurements))],
        "further": [
            {"observable": one.observable, "place": place, "measured": value, "sigma": sigma, "fitted": fitted}
            for one in result.further
            for place, value, sigma, fitted in zip(
                one.places, one.value.tolist(), one.sigma.tolist(), one.fitted.tolist(), strict=True
            )
        ],
        "regime": {
            "b": result.regime.b,
            "rebreaking_b": rebreaking_b(),
            "slow_decay_length": result.regime.slow_decay_length,
            "block_length_over_height": result.block_length_over_height,
        },
        "as_slider": None
        if result.as_slider is None
        else {
            "values": result.as_slider.values,
            "stderr": result.as_slider.stderrs,
            "verdicts": {name: one.name.lower() for name, one in result.as_slider.verdicts.items()},
        },
        "budget": {name: moved._asdict() for name, moved in result.budget.items()},
        "unstated_ends": result.unstated_ends,
        "unstated_push": result.unstated_push,
        "next_steps": result.next_steps,
        "notes": result.notes,
        "source": result.measurements.source,
        "data_sha256": data_hash(result.measurements),
        "request": as_request(result.request),
        "table": _columns(result.measurements),
        "search": _search(result),
        "versions": versions(),
    }
    return plain(content)


def _columns(table: Any) -> dict[str, Any]:
    """Columns of a table of measurements or gauges that are not None."""
    held = {field.name: getattr(table, field.name) for field in dataclasses.fields(table)}
    return {name: _columns(x) if isinstance(x, Gauges) else x for name, x in held.items() if x is not None}


def measurements_of_record(content: dict[str, Any]) -> Measurements:
    """Restore the measurements of a record."""
    table = dict(content["table"])
    if "gauges" in table:
        table["gauges"] = Gauges(**_numeric(table["gauges"], GAUGE_COLUMNS))
    return Measurements(**_numeric(table, NUMERIC))


def changes_of_record(content: dict[str, Any]) -> dict[str, Any]:
    """Restore what else would move the result, by the attribute of `FitResult` that holds it."""

    def number(x: float | None) -> float:
        return math.nan if x is None else x

    def numbers(given: dict[str, Any]) -> dict[str, float]:
        return {name: number(x) for name, x in given.items()}

    slider, other = content["as_slider"], None
    older = any("opposite" not in one for one in content["budget"].values())
    if older or (slider is not None and "verdicts" not in slider):  # version 0.2, which left them out
        return {}
    if slider is not None:
        verdicts = {name: Identifiability[one.upper()] for name, one in slider["verdicts"].items()}
        other = AsSlider(slider["values"], slider["stderr"], verdicts)
    return {
        "budget": {
            name: Moved(one["error"], numbers(one["change"]), numbers(one["opposite"]))
            for name, one in content["budget"].items()
        },
        "unstated_ends": {name: numbers(moved) for name, moved in content["unstated_ends"].items()},
        "unstated_push": {at: numbers(factors) for at, factors in content["unstated_push"].items()},
        "next_steps": content["next_steps"],
        "as_slider": other,
    }


def _numeric(table: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Convert columns of numbers to arrays, with NaN for null."""
    return {name: np.array(x, dtype=float) if name in names else x for name, x in table.items()}


def _search(result: "FitResult") -> dict[str, Any]:
    """Results of the search that restore the fit without another one."""
    return {
        "theta": result.theta,
        "roots": [
            {"theta": root.theta, "deviance": root.deviance, "covariance": root.covariance, "stderr": root.stderrs}
            for root in result.roots
        ],
        "curves": {name: curve._asdict() for name, curve in result.curves.items()},
        "intervals": {
            name: {f"{level:g}": pieces for level, pieces in by_level.items()} for name, by_level in result.intervals.items()
        },
        "rise": dataclasses.asdict(result.rise),
        "testable_dof": result.testable_dof,
        "unconverged": result.unconverged,
        "between_contacts": result.between_contacts,
        "complete": result.complete,
        "calibrated": result.calibrated,
    }


def read_record(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the JSON of a fit.

    Raises
    ------
    OSError
        If there is no such file, or it cannot be opened.
    ValueError
        If it is no such record, or was written by a version whose record is another.
    """
    name, content = os.fspath(path), read_request_file(path)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise ValueError(
            f"{name}: not a fit that this version can read (its schema is not {SCHEMA}); repeat it (slippulse fit TABLE.CSV "
            f"--request {name})"
        )
    return content


def _root(root: "Root", result: "FitResult") -> dict[str, Any]:
    return {
        "values": root.values,
        "stderr": root.stderrs,
        "stiffness": root.inputs.common_ratio,
        "delta_chi2": root.deviance - result.deviance,
        "rebreaks": root.rebreaks,
    }


def _measurement(result: "FitResult", i: int) -> dict[str, Any]:
    m = result.measurements
    return {
        "line": m.lines[i] if m.lines else None,
        "row": m.rows[i] if m.rows else None,
        "kind": m.kind[i],
        "height": float(m.height[i]),
        "poisson": float(m.poisson[i]),
        "measured": float(m.length[i]),
        "sigma": float(result.sigma[i]),
        "fitted": float(result.fitted.length[i]),
        "residual": float(result.residuals[i]),
        "contacts_broken": int(result.fitted.contacts_broken[i]),
        "front_status": Outcome(int(result.fitted.status[i])).name.lower(),
        "attainable": float(result.attainable[i]),
        "attainable_at_stiffness": float(result.attainable_at[i]),
    }


def as_request(request: dict[str, Any]) -> dict[str, Any]:
    """Convert the arguments of a fit to the form of a request file."""
    free = {
        one.name: {key: value for key, value in dataclasses.asdict(one).items() if key != "name" and value not in (None, False)}
        for one in request["free"]
    }
    settings = {key: value for key, value in request.items() if key != "free" and value is not None}
    return {"parameters": free, **settings}


def from_request(request: dict[str, Any]) -> dict[str, Any]:
    """Convert a request to the arguments of `fit`.

    Raises
    ------
    ValueError
        Naming what is not understood.
    """
    request = dict(request)
    parameters = request.pop("parameters", {"stiffness": {}})
    unknown = set(request) - {"loss", "sigma", "method", "max_steps", "seed", "intervals", "event", "body"}
    if unknown:
        raise ValueError(shortened(f"request: {', '.join(sorted(unknown))} not understood"))
    free = []
    for name, settings in parameters.items():
        known = {field.name for field in dataclasses.fields(Parameter)} - {"name"}
        strange = set(settings) - known
        if strange:
            wrong = shortened(f"request, parameter {name}: {', '.join(sorted(strange))} not understood")
            raise ValueError(f"{wrong}; {', '.join(sorted(known))} are")
        pairs: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in settings.items()}
        for key in ("bounds", "prior"):
            if key in pairs and not (isinstance(pairs[key], tuple) and len(pairs[key]) == 2):
                raise ValueError(f"request, parameter {name}: {key} = {pairs[key]!r}: two numbers are needed")
        free.append(Parameter(name, **pairs))
    return {"free": free, **request}


def read_request(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a request from a TOML file, or from the JSON that an earlier fit printed.

    Raises
    ------
    OSError
        If there is no such file, or it cannot be opened.
    ValueError
        If it is neither.
    """
    content = read_request_file(path)
    content = content.get("request", content)
    parameters = content.get("parameters", {}) if isinstance(content, dict) else None
    if not isinstance(parameters, dict) or not all(isinstance(x, dict) for x in parameters.values()):
        raise ValueError(f"{os.fspath(path)}: [parameters.NAME] tables are expected, each with its settings")
    return content


LARGEST = 64 * 2**20
"""Bytes of the largest request or saved fit that is read."""

LONGEST, DEEPEST = 2000, 64
"""Most characters and dots on one line of TOML: the time to read a dotted key grows as the square of its parts."""


def read_request_file(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML or JSON file.

    Raises
    ------
    ValueError
        If it is neither, or larger than `LARGEST`.
    """
    name = os.fspath(path)
    try:
        text = read_whole(path, LARGEST).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{name}: not UTF-8 text") from None
    in_json = text.lstrip().startswith("{")
    for number, line in enumerate(() if in_json else text.splitlines(), start=1):
        if len(line) > LONGEST:
            raise ValueError(f"{name}, line {number}: longer than {LONGEST} characters")
        if line.count(".") > DEEPEST and not line.lstrip().startswith("#"):
            raise ValueError(f"{name}, line {number}: nested too deeply")
    try:
        content = json.loads(text) if in_json else tomllib.loads(text)
    except ValueError as error:  # of either format, or a number of too many digits
        raise ValueError(f"{name}: {error}") from None
    except RecursionError:
        raise ValueError(f"{name}: nested too deeply") from None
    return content


def to_dataframe(result: "FitResult") -> "pd.DataFrame":
    """Return measurements and model as a pandas.DataFrame, one row per measurement; lengths in the unit of the table."""
    import pandas as pd

    m = result.measurements
    scale, unit = m.unit
    unit = f"_{unit}" * m.in_si
    text = {"line": m.lines, "row": m.rows, "label": m.label, "specimen": m.specimen, "kind": m.kind}
    lengths = {
        "height": m.height,
        "push_height": m.push_height,
        "length": m.length,
        "length_sigma": result.sigma,
        "length_fitted": result.fitted.length,
        "length_attainable": result.attainable,
    }
    return pd.DataFrame(
        {name: list(column) for name, column in text.items() if column}
        | {name + unit: x * scale for name, x in lengths.items() if x is not None}
        | {"residual": result.residuals, "outcome": [Outcome(int(status)).name.lower() for status in result.fitted.status]}
    )


MAY_BE_ABSENT = ("block_length", "machine_stiffness", "push_height", "push_width", "push_height_sigma")
"""Columns that enter the hash only where a table has them."""


def data_hash(measurements: Measurements) -> str:
    """Hash (SHA-256) what entered the fit, specimens and provenance included, to match a result to its data."""
    digest = hashlib.sha256()
    for name in NUMERIC:
        column = getattr(measurements, name)
        if column is None and name in MAY_BE_ABSENT:  # added later
            continue
        digest.update(name.encode() + b"=")
        digest.update(b"none" if column is None else np.ascontiguousarray(column, "<f8").tobytes())
    digest.update(",".join(measurements.kind + measurements.push_control).encode())
    for name in ("specimen", "provenance"):  # which decide what is fitted beside the stiffness
        if getattr(measurements, name):
            digest.update(json.dumps([name, *getattr(measurements, name)]).encode())
    if measurements.gauges is not None:
        for name in GAUGE_COLUMNS:
            column = getattr(measurements.gauges, name)
            digest.update(b"none" if column is None else np.ascontiguousarray(column, "<f8").tobytes())
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Versions of the packages that computed the result."""
    packages = ("slippulse_jax", "jax", "numpy", "scipy", "optax")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


def _ends(piece: Interval) -> list[float | None]:
    return [None if piece.open_low else piece.low, None if piece.open_high else piece.high]
