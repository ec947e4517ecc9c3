"""Symbols, units and names of quantities, and conversions to SI.

They are kept on the fields and properties that hold the numbers.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike

from slippulse_jax.files import shortened

Numbers = Array | ArrayLike
"""Types that a constructor accepts as numbers, including sequences."""


def machine_ratio(per_width: Any, young: Any) -> Any:
    """M/K of a machine, from its stiffness over the width of the block, in N/m², and Young's modulus, in Pa.

    A block of width W is W/λc slices in parallel, each λc wide. Of a machine of S N/m each slice has M = S λc/W, and K = Eλc
    (label cra04): M/K = (S/W)/E, whatever λc.
    """
    return per_width / young


F = TypeVar("F", bound=Callable[..., Any])


class Quantity(NamedTuple):
    """Symbol, unit and source of a number."""

    symbol: str  # as printed in the paper
    unit: str
    label: str = ""  # LaTeX label of the defining equation, or several
    name: str = ""  # in words, for the axes of sweeps


def quantity_field(symbol: str, unit: str, label: str = "", name: str = "", **kwargs: Any) -> Any:
    """Dataclass field that carries its `Quantity`."""
    return eqx.field(metadata={"quantity": Quantity(symbol, unit, label, name)}, **kwargs)


def quantity(symbol: str, unit: str, label: str = "") -> Callable[[F], F]:
    """Mark a function (to be wrapped by ``property``) with its `Quantity`."""

    def mark(function: F) -> F:
        function.quantity = Quantity(symbol, unit, label)  # pyright: ignore[reportFunctionMemberAccess]
        return function

    return mark


def quantities(cls: type) -> dict[str, Quantity]:
    """Quantities of the fields and properties of `cls`, by name, in order of definition."""
    found = {f.name: f.metadata["quantity"] for f in dataclasses.fields(cls) if "quantity" in f.metadata}
    for name, value in vars(cls).items():
        mark = getattr(getattr(value, "fget", None), "quantity", None)
        if mark is not None:
            found[name] = mark
    return found


def as_float(x: Any) -> Any:
    """Convert to floating point: JAX arrays and tracers in their own precision, at least single; all else to NumPy float64.

    A TypeError if it holds no real numbers (text, dates, complex numbers, other objects), a ValueError if it is a masked array
    with masked values.
    """
    array = x if isinstance(x, jax.Array) else np.asanyarray(x)
    if isinstance(array, np.ma.MaskedArray) and array.mask.any():
        raise ValueError(f"{shortened(repr(x))}: has masked values; fill them, or leave them out")
    if isinstance(x, jax.Array):
        real = not jnp.issubdtype(x.dtype, jnp.complexfloating)
    elif array.dtype.kind == "O":  # such as large whole numbers
        real = not any(isinstance(one, str | bytes | None) for one in array.ravel())
    else:
        real = array.dtype.kind in "fiub" or jnp.issubdtype(array.dtype, jnp.floating)  # such as bfloat16
    if not real:
        raise TypeError(f"{shortened(repr(x))}: must be a real number, or several")
    if isinstance(x, jax.Array):
        return at_least_single(x) if jnp.issubdtype(x.dtype, jnp.inexact) else x.astype(float)
    return np.asarray(x, dtype=np.float64)


def at_least_single(x: Array) -> Array:
    """Convert half precision, in which no length has a digit, to single; anything else stays as it is."""
    return x.astype(jnp.float32) if jnp.issubdtype(x.dtype, jnp.floating) and x.dtype.itemsize < 4 else x
