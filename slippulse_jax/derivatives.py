"""Derivatives of functions whose loops have no reverse mode.

For functions of few parameters; and a guard for functions that must not be differentiated.
"""

from collections.abc import Callable
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Function = Callable[..., Float[Array, "..."]]


def by_forward_mode(f: Function) -> Function:
    """Give `f` derivatives of every order in every mode, all computed forward.

    ``lax.while_loop`` has a forward derivative but no reverse one. With n parameters, one pass of the loop that carries
    n tangents yields the value and the whole Jacobian; the tangent is then a plain product with it, which JAX can
    transpose. The pass itself is wrapped again, so that ``hessian``, ``grad`` of ``grad`` and so on work too.

    Parameters
    ----------
    f : callable
        From arrays, of n numbers in all, to an array; differentiable forward. Under ``vmap`` an argument without the mapped
        axis stays without it: what depends on it alone is computed once.

    Returns
    -------
    callable
        The same function, with derivatives. Differentiating costs one pass with n tangents whatever the mode.
    """

    def value_and_jacobian(*arguments: Array) -> Float[Array, "... numbers"]:
        every = tuple(range(len(arguments)))
        jacobians, value = jax.jacfwd(lambda *x: (f(*x),) * 2, argnums=every, has_aux=True)(*arguments)
        return jnp.concatenate([value[..., None], *(x.reshape(*value.shape, -1) for x in jacobians)], axis=-1)

    differentiable = jax.custom_jvp(f)

    @differentiable.defjvp
    def _rule(primals, tangents):  # pyright: ignore[reportUnusedFunction]
        both = by_forward_mode(value_and_jacobian)(*primals)
        return both[..., 0], both[..., 1:] @ jnp.concatenate([jnp.ravel(x) for x in tangents])

    return differentiable


def without_derivative(f: Callable[..., Any], why: str, nondiff_argnums: tuple[int, ...] = ()) -> Callable[..., Any]:
    """`f`, whose derivative would be silently zero or an artefact: to differentiate it, in any mode, is a TypeError.

    Parameters
    ----------
    f : callable
        Of pytrees of arrays.
    why : str
        The message: what is not differentiable, and what to use instead.
    nondiff_argnums : tuple of int
        As for ``jax.custom_jvp``.
    """
    refusing = jax.custom_jvp(f, nondiff_argnums=nondiff_argnums)

    @refusing.defjvp
    def _refuse(*arguments: Any) -> NoReturn:  # pyright: ignore[reportUnusedFunction]
        raise TypeError(why)

    return refusing
