"""Derivatives of functions whose loops have no reverse mode.

For functions of few parameters; for zero crossings, as implicit functions; and a guard for functions that must not be
differentiated.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.bulk.double import IN_DOUBLE, as_type, in_double

Function = Callable[..., Float[Array, "..."]]

MAX_STEPS = 100


def with_jacobian(f: Function) -> Function:
    """`f` and its Jacobian along a new last axis, by forward mode."""

    def value_and_jacobian(*given: Array) -> Float[Array, "... numbers"]:
        arguments = tuple(jnp.asarray(x) for x in given)
        ends = np.cumsum([0, *(x.size for x in arguments)])
        axes = [
            jnp.eye(ends[-1], dtype=x.dtype)[:, start:stop].reshape(-1, *x.shape)
            for x, start, stop in zip(arguments, ends[:-1], ends[1:], strict=True)
        ]
        values, slopes = jax.vmap(lambda *way: jax.jvp(f, arguments, way))(*axes)
        return jnp.concatenate([values[0][..., None], jnp.moveaxis(slopes, 0, -1)], axis=-1)

    return value_and_jacobian


def with_gradient(f: Function) -> Function:
    """As `with_jacobian`, of a number, by one pass of reverse mode."""

    def value_and_gradient(*arguments: Array) -> Float[Array, " numbers"]:
        value, slopes = jax.value_and_grad(f, argnums=tuple(range(len(arguments))))(*arguments)
        return jnp.concatenate([value[None], *(x.reshape(-1) for x in slopes)])

    return value_and_gradient


def by_forward_mode(f: Function, first: Callable[[Function], Function] = with_jacobian, held: Any = None) -> Function:
    """Give `f` derivatives of every order in every mode, all computed forward.

    ``lax.while_loop`` has a forward derivative but no reverse one. With n parameters, one pass of the loop that carries
    n tangents yields the value and the whole Jacobian; the tangent is then a plain product with it, which JAX can
    transpose. The pass itself is wrapped again, so that ``hessian``, ``grad`` of ``grad`` and so on work too.

    `f` maps arrays, of n numbers in all, to an array. Under ``vmap`` an argument without the mapped axis stays without it: what
    depends on it alone is computed once. `first` computes the first derivatives: `with_gradient` where `f` has a reverse mode.
    `held` is a tree of arrays, which `f` takes first, and in which it is not differentiated.
    """
    differentiable, start = jax.custom_jvp(f), 0 if held is None else 1

    @differentiable.defjvp
    @in_full
    def _rule(primals, tangents):  # pyright: ignore[reportUnusedFunction]
        both = by_forward_mode(lambda held, *x: first(partial(f, *held))(*x), held=primals[:start])(*primals[start:])
        return both[..., 0], both[..., 1:] @ jnp.concatenate([jnp.ravel(x) for x in tangents[start:]])

    return differentiable if held is None else partial(differentiable, held)


def known(given: Any, why: str) -> Any:
    """Strip numbers of their derivatives; refuse those that JAX does not know."""
    try:
        return jax.tree.map(np.asarray, lax.stop_gradient(given))
    except jax.errors.JAXTypeError:
        raise ValueError(f"under jit and vmap {why}") from None


def under_grad_too(function: Callable[..., Array]) -> Callable[..., Array]:
    """As `in_double`, of an array, and under ``grad`` in single precision."""

    def traced(*given: Any) -> Array:
        known(given, IN_DOUBLE)
        moving, held = eqx.partition(given, lambda x: isinstance(x, Tracer) and jnp.issubdtype(x.dtype, jnp.floating))
        numbers, tree = jax.tree.flatten(moving)
        held = known(held, IN_DOUBLE)

        def one(*numbers: Array) -> Array:
            with jax.enable_x64(True):  # in here, because JAX computes derivatives later
                every = eqx.combine(jax.tree.unflatten(tree, numbers), held)
                return as_type(function(*jax.tree.map(lambda x: as_type(x, np.float64), every)), np.float32)

        return by_forward_mode(one)(*numbers)

    return in_double(function, traced)


def without_derivative(f: Callable[..., Any], why: str, static_argnums: tuple[int, ...] = ()) -> Callable[..., Any]:
    """Compile `f`, and make its differentiation a TypeError.

    The derivative would be silently zero or an artefact. The message is `why`: what is not differentiable, and what to use
    instead.
    """
    refusing = jax.custom_jvp(f, nondiff_argnums=static_argnums)

    @refusing.defjvp
    def _refuse(*arguments: Any) -> NoReturn:  # pyright: ignore[reportUnusedFunction]
        raise TypeError(why)

    return jax.jit(refusing, static_argnums=static_argnums)  # outermost: a rule by itself is bound anew in every call


def root_between(
    function: Callable[[Any, Array], Array], parameters: Any, low: Array, high: Array, accept: float = 1e4
) -> Array:
    """Find the x in [low, high] at which a function turns negative.

    ``function(parameters, x)`` changes sign there from + to −; the result is NaN if it does not. Newton's method is used,
    with bisection wherever it leaves the bracket. The result has derivatives of every order, forward and reverse, with
    respect to `parameters` (any pytree), dx = −(∂f/∂θ · dθ)/(∂f/∂x), but none with respect to the bracket `low`, `high`.
    The last step, over x, may be `accept` times the rounding error, which is more where the function is noisy beside its slope.
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
        close = step <= accept * jnp.finfo(x.dtype).eps * jnp.abs(x)
        return jnp.where(changes & close, x, jnp.nan)

    @find.defjvp
    def _rule(primals: Any, tangents: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        x = find(*primals)
        _, change = jax.jvp(lambda p: function(p, x), primals[:1], tangents[:1])
        _, slope = jax.jvp(lambda y: function(primals[0], y), (x,), (jnp.ones_like(x),))
        return x, -change / slope

    return find(parameters, lax.stop_gradient(low), lax.stop_gradient(high))
