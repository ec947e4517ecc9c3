"""Records of a fit for JSON, by their type hints, and requests."""

import dataclasses
import enum
import hashlib
import json
import os
import platform
import tomllib
import types
import typing
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin

import numpy as np

from slippulse_jax.base.files import file_name, plain, read_whole, shortened
from slippulse_jax.base.status import Outcome
from slippulse_jax.inference.choices import Loss
from slippulse_jax.inference.model.emulator import Points, through
from slippulse_jax.inference.model.front import Front
from slippulse_jax.inference.model.models import front_of
from slippulse_jax.inference.parameters import Parameter, checked, where_contacts_differ, with_errors_of_measuring
from slippulse_jax.inference.result.changes import Change
from slippulse_jax.inference.search.learning import learnt as learnt_again
from slippulse_jax.inference.search.learning import model_error_of, with_model_error
from slippulse_jax.inference.search.likelihood import make_problem
from slippulse_jax.inference.table.columns import GAUGE_COLUMNS, NUMERIC
from slippulse_jax.inference.table.measurements import Gauges, Measurements
from slippulse_jax.theory import rebreaking_b

if TYPE_CHECKING:
    import pandas as pd

    from slippulse_jax.inference.result.result import FitResult

Record = TypeVar("Record")

SCHEMA = 3
"""Version of the record: larger where its form has changed."""
SETTINGS = ("loss", "sigma", "method", "max_steps", "seed", "intervals", "event", "body", "model_error", "observables")
"""Arguments of a fit that a request holds beside its parameters."""
LARGEST = 64 * 2**20
"""Bytes of the largest request or saved fit that is read."""
LONGEST, DEEPEST = 2000, 64
"""Most characters and dots on one line of TOML: the time to read a dotted key grows as the square of its parts."""


# --- records by their type hints --------------------------------------------------------------------------------------------


def encode(x: Any) -> Any:
    """Convert a record to plain values.

    What is not finite becomes None, what is absent is left out.
    """
    if isinstance(x, enum.Enum):
        return x.name.lower()
    if dataclasses.is_dataclass(x) or hasattr(x, "_fields"):
        return {name: encode(getattr(x, name)) for name in _written(type(x)) if getattr(x, name) is not None}
    if isinstance(x, dict):
        return {str(key): encode(value) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [encode(value) for value in x]
    return plain(x)


def decode(hint: Any, x: Any, missing: float = np.inf, **given: Any) -> Any:
    """Restore what `encode` made of a value of this type.

    Of a class with annotated fields, an enumeration, or a type of numbers, texts, arrays and collections of these. None among
    numbers means `missing`; in tables of measurements NaN. Fields in `given` are not written, for every record that has them.
    """
    if isinstance(hint, types.UnionType):
        return None if x is None else decode(next(one for one in get_args(hint) if one is not type(None)), x, missing, **given)
    origin, of = get_origin(hint), get_args(hint)
    if origin in (list, tuple):
        each = of if origin is tuple and of[-1] is not ... else (of[0],) * len(x)
        return origin(decode(one, value, missing, **given) for one, value in zip(each, x, strict=True))
    if origin is dict:
        return {of[0](key): decode(of[1], value, missing, **given) for key, value in x.items()}
    if not isinstance(hint, type) or hint is dict:
        return x
    if issubclass(hint, enum.Enum):
        return hint[x.upper()]
    if dataclasses.is_dataclass(hint) or hasattr(hint, "_fields"):
        missing = np.nan if hint in (Measurements, Gauges) else missing
        hints, names = typing.get_type_hints(hint), set(_written(hint))
        fields = {name: decode(hints[name], value, missing, **given) for name, value in x.items() if name in names}
        absent = {name: given[name] for name in hints if name in given and name not in names}
        return hint(**{name: None for name in names - {*fields} if type(None) in get_args(hints[name])}, **fields, **absent)
    if hint is np.ndarray:
        found = np.array(x) if x and all(isinstance(one, bool) for one in x) else np.array(x, dtype=float)
        return found if found.dtype == bool else np.where(np.isnan(found), missing, found)
    return missing if x is None and hint is float else x


def _written(hint: type) -> tuple[str, ...]:
    """Names of the fields of a record that are written."""
    if dataclasses.is_dataclass(hint):
        return tuple(one.name for one in dataclasses.fields(hint) if one.metadata.get("written", True))
    return hint._fields  # pyright: ignore[reportAttributeAccessIssue]


# --- a fit ------------------------------------------------------------------------------------------------------------------


def to_dict(result: "FitResult") -> dict[str, Any]:
    """Return the whole result as plain Python values.

    Open ends and missing numbers are None. The record itself, by the fields of `FitResult`, stands after what follows from it.
    """
    q, request = result.parameters, as_request(result.request)
    units = {one.label: one.unit for one in q.free}
    follows = {
        "schema": SCHEMA,
        "identifiability": result.identifiability.name.lower(),
        "statement": result.identifiability.value,
        "reason": result.reason or None,
        "model": {"body": q.front.body, "event": q.front.event},
        "values": result.values,
        "stderr": result.stderrs,
        "stderr_with_inputs": result.stderrs_with_inputs,
        "error_with_inputs": result.errors_with_inputs,
        "intervals_with_inputs": encode(result.intervals_with_inputs),
        "directions": result.directions,
        "notes": result.notes,
        "units": {name: units.get(name, "") for name in result.values},
        "correlations": [[a, b, value] for (a, b), value in result.correlations.items()],
        "stiffness_ratios": [[*labels, *found] for labels, found in result.stiffness_ratios.items()],
        "inputs": result.inputs,
        "searched": {one.label: [one.value(one.low), one.value(one.high)] for one in q.free},
        "chi2": result.deviance if result.problem.plain else None,
        "dof": result.dof,
        "p_value": result.p_value,
        "sigma": result.sigma,
        "fitted": result.fitted,
        "residuals": result.residuals,
        "contacts_broken": result.contacts_broken,
        "front_status": [Outcome(int(one)).name.lower() for one in result.front_status],
        "further": [encode(one) for one in result.further],
        "regime": {
            "b": result.regime.b,
            "rebreaking_b": rebreaking_b(),
            "slow_decay_length": result.regime.slow_decay_length,
            "block_length_over_height": result.block_length_over_height,
        },
    }
    problem, learnt = result.problem, {}
    if (emulator := problem.emulator) is not None and not result.parameters.front.drawn:
        learnt = {"points": problem.points, "known": problem.known, "model_error": model_error_of(problem)}
        learnt |= {"count": emulator.place.shape[1], "reach": emulator.reach, "scatter": emulator.scatter}
    after = {
        "learnt": encode(learnt) or None,
        "simulated": problem.simulated and [*problem.simulated],
        "changes": encode(result.changes),
        "next_steps": result.next_steps,
        "data_sha256": data_hash(result.measurements),
        "versions": versions(),
    }
    return plain(follows) | encode(result) | {"request": request} | after


def of_dict(kind: type[Record], content: dict[str, Any]) -> tuple[Record, dict[str, Any]]:
    """Restore a fit, and its `changes` and `next_steps`, from `to_dict`.

    `kind` is `FitResult`. A ValueError if this version has no model for it.
    """
    request: dict[str, Any] = {"event": None, "body": None} | from_request(content["request"])
    if (loss := request.get("loss", "normal")) not in get_args(Loss):
        raise ValueError(f"loss = {loss!r}, which this version does not have: repeat the fit with another")
    m = decode(Measurements, content["measurements"])
    size_known = m.length_sigma is not None and request["sigma"] == "absolute"
    front = front_of(m, request["event"], request["body"])
    how = size_known and loss == "normal"
    front = where_contacts_differ(front, m, request["event"], request["free"], size_known=how)
    wanted = with_errors_of_measuring(m, request["free"], front, size_known=size_known)
    q = checked(m, wanted, front, loss=request["loss"])
    problem = make_problem(m, q)
    if learnt := content.get("learnt"):
        points = decode(Points, learnt["points"])
        like = decode(np.ndarray, learnt["reach"]), decode(np.ndarray, learnt["scatter"])
        problem = with_model_error(problem, learnt["model_error"])
        problem = dataclasses.replace(
            problem, points=points, emulator=through(points, learnt["count"], like=like), known=learnt["known"]
        )
    problem = learnt_again(problem, request["seed"]) if front.drawn else problem
    problem = dataclasses.replace(problem, simulated=tuple(content["simulated"]) if content.get("simulated") else None)
    if content.get("between_contacts") is not None:
        problem = problem.widened(np.array(content["between_contacts"], dtype=float))
    if content.get("scatter") is not None:
        problem = problem.with_sigma(content["scatter"], of_lengths=m.length_sigma is None)
    found = decode(kind, {**content, "request": {}}, problem=problem, parameters=q)
    known = {"changes": list[Change], "next_steps": list[str]}
    known = {name: decode(hint, content[name], np.nan) for name, hint in known.items()}
    return dataclasses.replace(found, request=request), known  # pyright: ignore[reportArgumentType]


def read_record(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the JSON of a fit.

    A ValueError if it is none, or of another schema, an OSError if it cannot be opened.
    """
    name, content = os.fspath(path), read_request_file(path)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise ValueError(
            f"{name}: not a fit that this version can read (its schema is not {SCHEMA}); repeat it (slippulse fit TABLE.CSV "
            f"--request {name})"
        )
    return content


def to_dataframe(result: "FitResult") -> "pd.DataFrame":
    """Return measurements and model as a pandas.DataFrame.

    One row per measurement; lengths in the unit of the table.
    """
    import pandas as pd

    m = result.measurements
    scale, unit = m.unit
    unit = f"_{unit}" * m.in_si
    text = {"line": m.lines, "row": m.rows, "label": m.label, "specimen": m.specimen, "sequence": m.sequence, "kind": m.kind}
    lengths = {"height": m.height, "push_height": m.push_height, "length": m.length}
    found = {name + unit: x * scale for name, x in lengths.items() if x is not None}
    for one in result.data:
        if len(set(one.measurement.tolist())) < len(one.measurement):
            continue  # several readings of one precursor
        kind = result.observable(one.observable)
        value, sigma, fitted, own = kind.shown(m, one)
        own, quantity = own.replace("/", "_per_"), kind.framed or kind.column.quantity
        own = f"_{own}" * (bool(own) and (m.in_si or own != "λc"))
        columns = {f"{quantity}{own}": value, f"{quantity}_sigma{own}": sigma, f"{quantity}_fitted{own}": fitted}
        for name, x in (columns | {"residual" if kind.of_rows else f"{quantity}_residual": one.residuals}).items():
            found.setdefault(name, np.full(len(m), np.nan))[one.measurement] = x
    if np.isfinite(result.attainable).any():
        found[f"length_attainable{unit}"] = result.attainable * scale
    outcome = [Outcome(int(status)).name.lower() for status in result.front_status]
    return pd.DataFrame({name: list(column) for name, column in text.items() if column} | found | {"outcome": outcome})


def data_hash(m: Measurements) -> str:
    """Hash (SHA-256) what entered the fit.

    Specimens and provenance included, to match a result to its data.
    """
    digest = hashlib.sha256()
    for table, names in ((m, NUMERIC), (m.gauges, GAUGE_COLUMNS)):
        for name in names if table is not None else ():
            column = getattr(table, name)
            if column is not None:
                digest.update(name.encode() + b"=" + np.ascontiguousarray(column, "<f8").tobytes())
    since = [name for name in ("contact_law", "top", "sequence") if getattr(m, name)]  # as in the hashes of tables without them
    for name in ("kind", "push_control", "specimen", "provenance", *since):
        digest.update(json.dumps([name, *getattr(m, name)]).encode())
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Versions of the packages that computed the result."""
    packages = ("slippulse_jax", "jax", "numpy", "scipy", "optax")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


# --- requests ---------------------------------------------------------------------------------------------------------------


def as_request(request: dict[str, Any]) -> dict[str, Any]:
    """Convert the arguments of a fit to a request file's form."""
    settable = dataclasses.fields(Parameter)[1:]  # after its name
    free = {
        one.name: {field.name: x for field in settable if (x := getattr(one, field.name)) is not field.default}
        for one in request["free"]
    }
    if request.get("observables"):
        raise ValueError("observables of one's own, which no file can hold: keep the table, and fit it again")
    if isinstance(request.get("event"), Front):
        raise ValueError("event is a model of one's own, which no file can hold: keep the table, and fit it again")
    settings = {key: value for key, value in request.items() if key != "free" and value is not None}
    return plain({"parameters": free, **settings})


def from_request(request: dict[str, Any]) -> dict[str, Any]:
    """Convert a request to arguments of `fit`; a ValueError names mistakes."""
    request = dict(request)
    parameters = request.pop("parameters", None)
    unknown = set(request) - {*SETTINGS}
    if unknown:
        raise ValueError(shortened(f"request: {', '.join(sorted(unknown))} not understood"))
    free = []
    for name, settings in (parameters or {}).items():
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
    return {"free": None if parameters is None else free, **request}


def read_request(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a request from TOML, or the JSON of a fit.

    A ValueError if it is neither, an OSError if it cannot be opened.
    """
    content = read_request_file(path)
    content = content.get("request", content)
    parameters = content.get("parameters", {}) if isinstance(content, dict) else None
    if not isinstance(parameters, dict) or not all(isinstance(x, dict) for x in parameters.values()):
        raise ValueError(f"{os.fspath(path)}: [parameters.NAME] tables are expected, each with its settings")
    return content


def read_request_file(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML or JSON file; a ValueError otherwise."""
    name = file_name(path)
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
