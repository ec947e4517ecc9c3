"""Symbols, units and names of quantities, and conversions to SI.

They are kept on the fields and properties that hold the numbers.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array
from numpy.typing import ArrayLike

from slippulse_jax.base.domains import in_unit, real_numbers
from slippulse_jax.base.files import shortened

Numbers = Array | ArrayLike
"""Types that a constructor accepts as numbers, including sequences."""


def machine_ratio(per_width: Any, young: Any) -> Any:
    """Convert the stiffness of a machine to M/K.

    Given are that over the width of the block, in N/m², and Young's modulus, in Pa. A block of width W is W/λc slices in
    parallel, each λc wide. Of a machine of S N/m each slice has M = S λc/W, and K = Eλc (label cra04): M/K = (S/W)/E, whatever
    λc.
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
    """Quantities of the fields and properties of `cls`, by name."""
    found = {f.name: f.metadata["quantity"] for f in dataclasses.fields(cls) if "quantity" in f.metadata}
    for name, value in vars(cls).items():
        mark = getattr(getattr(value, "fget", None), "quantity", None)
        if mark is not None:
            found[name] = mark
    return found


def as_float(name: str, x: Any, unit: str = "") -> Any:
    """Convert to floating point.

    JAX arrays and tracers keep their precision, at least single; all else becomes NumPy float64. Quantities are converted to
    `unit`; what holds no real numbers is refused as `real_numbers` does, by the argument's `name`.
    """
    given = in_unit(name, x, unit)
    if not isinstance(given, jax.Array):
        return real_numbers(name, given)
    if jnp.issubdtype(given.dtype, jnp.floating):
        return at_least_single(given)
    if not jnp.issubdtype(given.dtype, jnp.integer):
        raise TypeError(f"{name} = {shortened(repr(x))}: must be a real number, or several")
    return given.astype(float)


def at_least_single(x: Array) -> Array:
    """Convert half precision, in which no length has a digit, to single."""
    return x.astype(jnp.float32) if jnp.issubdtype(x.dtype, jnp.floating) and x.dtype.itemsize < 4 else x
