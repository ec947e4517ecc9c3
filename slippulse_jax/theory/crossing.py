"""Zero crossings of a function, differentiated as implicit functions."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

MAX_STEPS = 100


def crossing(function: Callable[[Any, Array], Array], parameters: Any, low: Array, high: Array) -> Array:
    """Find the x in [low, high] at which a function turns negative.

    ``function(parameters, x)`` changes sign there from + to −; the result is NaN if it does not. Newton's method is used,
    with bisection wherever it leaves the bracket. The result has derivatives of every order, forward and reverse, with
    respect to `parameters` (any pytree), dx = −(∂f/∂θ · dθ)/(∂f/∂x), but none with respect to the bracket `low`, `high`.
    Compute whatever does not depend on x beforehand and pass it in `parameters`, so that the search does not repeat it.
    """

    @jax.custom_jvp
    def find(parameters: Any, low: Array, high: Array) -> Array:
        def value(x: Array) -> tuple[Array, Array]:
            return jax.jvp(lambda y: function(parameters, y), (x,), (jnp.ones_like(x),))

        def unfinished(state: Any) -> Array:
            x, _, _, step, steps = state
            return ~(step <= 16 * jnp.finfo(x.dtype).eps * jnp.abs(x)) & (steps < MAX_STEPS)

        def improve(state: Any) -> Any:
            x, left, right, _, steps = state
            f, slope = value(x)
            left, right = jnp.where(f > 0, x, left), jnp.where(f > 0, right, x)
            newton = x - f / slope
            after = jnp.where((newton >= left) & (newton <= right), newton, (left + right) / 2)
            return after, left, right, jnp.abs(after - x), steps + 1

        start = ((low + high) / 2, low, high, jnp.full_like(low, jnp.inf), jnp.zeros((), jnp.int32))
        x, _, _, step, _ = lax.while_loop(unfinished, improve, start)
        changes = (value(low)[0] >= 0) & (value(high)[0] <= 0)
        close = step <= 1e4 * jnp.finfo(x.dtype).eps * jnp.abs(x)
        return jnp.where(changes & close, x, jnp.nan)

    @find.defjvp
    def _rule(primals: Any, tangents: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        x = find(*primals)
        _, change = jax.jvp(lambda p: function(p, x), primals[:1], tangents[:1])
        _, slope = jax.jvp(lambda y: function(primals[0], y), (x,), (jnp.ones_like(x),))
        return x, -change / slope

    return find(parameters, lax.stop_gradient(low), lax.stop_gradient(high))
