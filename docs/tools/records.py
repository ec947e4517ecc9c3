"""What the reference says of a record's fields and of an outcome's members: both are taken from the class itself.

A field is described by the comment beside it and by its `Quantity`, a member by its value and message.
"""

import dataclasses
import enum
import inspect
import re
from typing import Any

FIELD = re.compile(r"^    (\w+): (?:.*?)(?:  # (?!noqa|pyright)(.*))?$", flags=re.M)


def described(cls: type) -> list[str]:
    """One item of a reStructuredText list for each member of an enumeration or field of a record; else nothing."""
    if issubclass(cls, enum.Enum):
        return [_member(one) for one in cls]
    names = getattr(cls, "_fields", None) or [f.name for f in dataclasses.fields(cls)] if is_record(cls) else []
    beside = dict(FIELD.findall(inspect.getsource(cls))) if names else {}
    return [_item(name, [*_unit(cls, name), beside.get(name, "")]) for name in names if not name.startswith("_")]


def is_record(cls: type) -> bool:
    """A tuple with names or a dataclass, whose docstring does not list the fields already."""
    listed = re.search(r"^\s*(Parameters|Attributes)\n\s*-{3,}$", cls.__doc__ or "", flags=re.M)
    return not listed and (hasattr(cls, "_fields") or dataclasses.is_dataclass(cls))


def _member(one: Any) -> str:
    value = f" = {int(one)}" if isinstance(one, int) else ""
    return _item(one.name + value, [one.message if hasattr(one, "message") else one.value])


def _unit(cls: type, name: str) -> list[str]:
    found = {f.name: f.metadata.get("quantity") for f in dataclasses.fields(cls)} if dataclasses.is_dataclass(cls) else {}
    quantity = found.get(name)
    return [] if quantity is None else [f":math:`{quantity.symbol}`, in :math:`{quantity.unit}`"]


def _item(name: str, parts: list[str]) -> str:
    text = "; ".join(part for part in parts if part)
    return f"- ``{name}``" + (f": {text}" if text else "")


def append(app: object, what: str, name: str, obj: Any, options: object, lines: list[str]) -> None:
    """Fields and members, below a class's own words."""
    if what == "class" and (items := described(obj)):
        lines += ["", *items, ""]


def skip(app: object, what: str, name: str, obj: Any, skipped: bool, options: object) -> bool | None:
    """Leave out the fields of a named tuple, of which Python only knows the number."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def setup(app: Any) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", append)
    app.connect("autodoc-skip-member", skip)
    return {"parallel_read_safe": True}
