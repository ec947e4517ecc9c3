"""What a number is: symbol, unit and where the paper defines it, kept on the field or property that holds it; and its type."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike

Numbers = Array | ArrayLike
"""A number or many: what a constructor takes, sequences among them, and holds as an array."""

F = TypeVar("F", bound=Callable[..., Any])


class Quantity(NamedTuple):
    """Symbol as printed in the paper, unit, and the LaTeX label(s) of the defining equation(s)."""

    symbol: str
    unit: str
    label: str = ""


def quantity_field(symbol: str, unit: str, label: str = "", **kwargs: Any) -> Any:
    """Dataclass field that carries its `Quantity`."""
    return eqx.field(metadata={"quantity": Quantity(symbol, unit, label)}, **kwargs)


def quantity(symbol: str, unit: str, label: str = "") -> Callable[[F], F]:
    """Mark a function (to be wrapped by ``property``) with its `Quantity`."""

    def mark(function: F) -> F:
        function.quantity = Quantity(symbol, unit, label)  # pyright: ignore[reportFunctionMemberAccess]
        return function

    return mark


def quantities(cls: type) -> dict[str, Quantity]:
    """Every field and property of `cls` that carries a `Quantity`, by name, in order of definition."""
    found = {f.name: f.metadata["quantity"] for f in dataclasses.fields(cls) if "quantity" in f.metadata}
    for name, value in vars(cls).items():
        mark = getattr(getattr(value, "fget", None), "quantity", None)
        if mark is not None:
            found[name] = mark
    return found


def as_float(x: Any) -> Any:
    """Leave JAX arrays (tracers included) to JAX; hold anything else in float64 until JAX asks for it."""
    if isinstance(x, jax.Array):
        return x if jnp.issubdtype(x.dtype, jnp.inexact) else x.astype(float)
    return np.asarray(x, dtype=np.float64)
