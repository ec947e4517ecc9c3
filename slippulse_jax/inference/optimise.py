"""Minimise a smooth function from several starts at once, each inside a box of its own, with optax."""

import enum
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from jaxtyping import Array, Float, Int

AnyArray = Array | np.ndarray
Objective = Callable[[Float[Array, ""]], Float[Array, ""]]


class Outcome(enum.IntEnum):
    """What became of one start."""

    CONVERGED = 0, "converged"
    FLAT = 1, "flat: the function does not change here, so nothing was learnt"
    AT_BOUND = 2, "at a bound: the minimum lies at the edge of the range that was searched"
    NOT_CONVERGED = 3, "did not converge within the allowed steps"

    message: str

    def __new__(cls, value: int, message: str) -> "Outcome":
        """Member whose message is shown to the user."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.message = message
        return member


class Minimum(NamedTuple):
    """Where a start ended; every field has the shape of the starts."""

    theta: Float[AnyArray, ""]
    value: Float[AnyArray, ""]
    gradient: Float[AnyArray, ""]
    curvature: Float[AnyArray, ""]
    steps: Int[AnyArray, ""]
    outcome: Int[AnyArray, ""]


def minimise(objective: Objective, start: Array, low: Array, high: Array, *, max_steps: int = 60) -> Minimum:
    """Minimise `objective` between `low` and `high`; ``jax.vmap`` over starts.

    L-BFGS with a backtracking line search, chosen by measurement (benchmarks/optimisers.py): it reaches every minimum, like
    the zoom search, and compiles in half the time; Adam misses some within twenty times the steps. The box is mapped to the
    whole line, θ = low + (high − low)/(1 + e^{−z}), so that no step leaves it.

    A start is called converged only where the Newton decrement g²/h says that the minimum is within 10⁻⁴ standard errors,
    and only if there is curvature h to say so: a plateau has neither gradient nor curvature and is called flat.
    """

    def inside(z: Array) -> Array:
        return low + (high - low) * jax.nn.sigmoid(z)

    def in_line(z: Array) -> Array:
        return objective(inside(z))

    optimiser = optax.lbfgs()
    value_and_grad = optax.value_and_grad_from_state(in_line)

    class Search(NamedTuple):
        z: Array
        state: optax.OptState
        step: Array
        moving: Array

    def step(search: Search) -> Search:
        value, grad = value_and_grad(search.z, state=search.state)
        updates, state = optimiser.update(grad, search.state, search.z, value=value, grad=grad, value_fn=in_line)
        z = search.z + jnp.asarray(updates)
        moving = jnp.abs(inside(z) - inside(search.z)) > 4 * jnp.finfo(z.dtype).eps * jnp.maximum(1, jnp.abs(inside(z)))
        return Search(z, state, search.step + 1, moving)

    fraction = (start - low) / (high - low)
    z0 = jnp.log(fraction / (1 - fraction))
    first = Search(z0, optimiser.init(z0), jnp.zeros((), jnp.int32), jnp.ones((), bool))
    last = lax.while_loop(lambda search: search.moving & (search.step < max_steps), step, first)
    theta = inside(last.z)
    (value, gradient), (_, curvature) = jax.jvp(jax.value_and_grad(objective), (theta,), (jnp.ones_like(theta),))
    decrement = gradient**2 / jnp.where(curvature > 0, curvature, 1)
    outcome = jnp.select(
        [
            (gradient == 0) & (curvature == 0),
            (curvature > 0) & (decrement <= 1e-8),
            jnp.minimum(theta - low, high - theta) < 1e-6,
        ],
        [Outcome.FLAT, Outcome.CONVERGED, Outcome.AT_BOUND],
        Outcome.NOT_CONVERGED,
    )
    return Minimum(theta, value, gradient, curvature, last.step, outcome)
