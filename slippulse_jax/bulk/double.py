"""Double precision where single loses the digits, whatever JAX's flags."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer

IN_DOUBLE = "a block needs double precision: work under jax.enable_x64(True)"

Computed = TypeVar("Computed", bound=Callable)


def in_double(function: Computed, traced: Callable | None = None) -> Computed:
    """Compute a function in double precision, whatever the JAX flags.

    Results are in the caller's precision. Where an argument is traced while JAX is in single precision `traced` takes its
    place; without it that is a ValueError.
    """

    @functools.wraps(function)
    def computed(*given: Any) -> Any:
        single = not jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
        if single and is_traced(given):
            if traced is None:
                raise ValueError(f"under jit, vmap and grad {IN_DOUBLE}")
            return traced(*given)
        with jax.enable_x64(True):
            found = function(*jax.tree.map(lambda x: as_type(x, np.float64), given))
            return jax.tree.map(lambda x: as_type(x, np.float32), found) if single else found

    return computed  # pyright: ignore[reportReturnType]


def is_traced(given: Any) -> bool:
    """Whether JAX traces any of these numbers."""
    return any(isinstance(x, Tracer) for x in jax.tree.leaves(given))


def as_type(x: Any, dtype: Any) -> Any:
    """`x` in this floating type; anything else as it is."""
    if isinstance(x, jax.Array):
        return lax.convert_element_type(x, dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x
    # a copy: as long as JAX holds the single-precision version of an array, it takes that for the array in double precision too
    return np.array(x, dtype) if isinstance(x, float | np.ndarray) and np.asarray(x).dtype.kind == "f" else x
