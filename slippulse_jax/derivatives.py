"""Derivatives of functions of few parameters whose loops have no reverse mode."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Function = Callable[[Float[Array, " n"]], Float[Array, "..."]]


def by_forward_mode(f: Function) -> Function:
    """Give `f` derivatives of every order in every mode, all computed forward.

    ``lax.while_loop`` has a forward derivative but no reverse one. With n parameters, one pass of the loop that carries
    n tangents yields the value and the whole Jacobian; the tangent is then a plain product with it, which JAX can
    transpose. The pass itself is wrapped again, so that ``hessian``, ``grad`` of ``grad`` and so on work too.

    Parameters
    ----------
    f : callable
        From a vector of n parameters to an array; differentiable forward.

    Returns
    -------
    callable
        The same function, with derivatives. Differentiating costs one pass with n tangents whatever the mode.
    """

    def value_and_jacobian(theta: Float[Array, " n"]) -> Float[Array, "... n+1"]:
        jacobian, value = jax.jacfwd(lambda x: (f(x),) * 2, has_aux=True)(theta)
        return jnp.concatenate([value[..., None], jacobian], axis=-1)

    differentiable = jax.custom_jvp(f)

    @differentiable.defjvp
    def _rule(primals, tangents):  # pyright: ignore[reportUnusedFunction]
        both = by_forward_mode(value_and_jacobian)(*primals)
        return both[..., 0], both[..., 1:] @ tangents[0]

    return differentiable
