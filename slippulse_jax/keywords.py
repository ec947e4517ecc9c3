"""Unknown arguments of the public names: errors that say which one was meant."""

import functools
import inspect
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from types import ModuleType
from typing import Any

INSTEAD = {
    "measurements": "; its first argument is a table: read_measurements(file) or Measurements.from_si(height=…, length=…, …)",
    "Measurements": "; Measurements.from_si takes SI units, Measurements.from_dataframe columns such as height_mm",
}
"""What to write instead: in place of arguments of a function that takes measurements first, and of a class."""


def public(module: ModuleType, name: str) -> Any:
    """Get a public class or function of a module, and name its unknown arguments from now on."""
    found = getattr(module, name)
    if not isinstance(found, type):
        if not hasattr(found, "checked_by_name"):
            setattr(module, name, _checked(found, name, 0))  # where pickle looks for it
    elif not hasattr(found.__init__, "checked_by_name"):
        makers = {own: one for own, one in vars(found).items() if isinstance(one, classmethod) and own[0] != "_"}
        for own, one in makers.items():
            type.__setattr__(found, own, classmethod(_checked(one.__func__, f"{name}.{own}", 1)))
        # not by Equinox's, which would make a method of it
        type.__setattr__(found, "__init__", _checked(found.__init__, name, 1))
    return getattr(module, name)


def did_you_mean(wrong: Any, known: Iterable[str], before: str = "; ") -> str:
    """The name that was meant, as a question; nothing where none is alike."""
    meant = get_close_matches(str(wrong), map(str, known), n=1)
    return f"{before}did you mean {meant[0]}?" if meant else ""


def _checked(function: Callable, name: str, own: int) -> Callable:
    """Wrap a function, of whose arguments the first, `own` of them, are not the caller's."""
    known = list(inspect.signature(function).parameters.values())[own:]
    kinds = [one.kind for one in known]
    names = [one.name for one in known if one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL)]
    most = own + sum(one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD) for one in known)
    some, any_more = inspect.Parameter.VAR_POSITIONAL in kinds, inspect.Parameter.VAR_KEYWORD in kinds

    @functools.wraps(function)
    def checked(*given: Any, **named: Any) -> Any:
        if len(given) > most and not some:
            by_name = f"{name}(**request)" if isinstance(given[most], dict) else f"{name}({names[-1]}=…)"
            others = f"; give the others by name, such as {by_name}" if len(names) > most - own else ""
            raise TypeError(f"{name} takes {most - own or 'no'} arguments by place{others}")
        if not any_more and (unknown := named.keys() - names):
            wrong = min(unknown)
            told = did_you_mean(wrong, names, ": ") or INSTEAD.get(names[0], f": it takes {', '.join(names)}")
            raise TypeError(f"{name} has no argument {wrong}{told}{INSTEAD.get(name, '').replace('; ', ' ')}")
        return function(*given, **named)

    checked.checked_by_name = True  # pyright: ignore[reportAttributeAccessIssue]
    return checked
