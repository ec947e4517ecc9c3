"""Equilibrium of any chain, with derivatives of any order.

The displacements solve the two lattice equations of section "Equations to be solved", where every spring may have its own
stiffness. If the contacts are nonlinear, Newton's method runs around the O(N) elimination. Derivatives with respect to every
input come from the equations that the solution satisfies (implicit function theorem), not from the iteration: one more linear
solve in forward mode, one with the transposed matrix, which is the same, in reverse mode.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.base.domains import check_kind
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.chain import Chain, Pair, Springs, State, eliminate, floats, respond

T = TypeVar("T")

MAX_NEWTON_STEPS = 50
DAMPING = tuple(0.5**n for n in range(12))
"""Fractions of a Newton step that are tried; the one with the least imbalance is taken."""


class Equilibrium(NamedTuple):
    """Chain in equilibrium.

    Displacements are in u_s, stresses in σ_s, forces in K u_s.
    """

    upper: Float[Array, " N"]  # u_t
    layer: Float[Array, " N"]  # u
    stress: Float[Array, " N"]  # t_i
    push: Float[Array, ""]  # force that keeps the left edge of the upper layer at U, the sum of all that holds the chain
    residual: Float[Array, ""]  # largest imbalance of a site, relative to the largest sum of |stiffness × displacement|
    status: Int[Array, ""]


@jax.jit
def equilibrium(chain: Chain, state: State) -> Equilibrium:
    """Solve for the equilibrium of a chain in a given state.

    Parameters
    ----------
    chain : Chain
    state : State
        Pinning points u_b, shape (N,), and load U, both in u_s.

    Returns
    -------
    Equilibrium
        It carries a status (`Outcome`) instead of raising an exception, so that a bad lane of ``jax.vmap`` does not
        affect the others. Where a part floats or a value is not a number the fields are finite but meaningless. The status is
        SOLVED only where all results are finite and the residual is at most the root of the precision's ε.

    Notes
    -----
    Composes with ``jit``, ``vmap``, ``grad``, ``jvp``, ``hessian`` …, for every field of the chain and of the state. The
    precision is that of the input: in float32 relative errors are a few 10⁻⁶ (docs/model/chain.md).
    Detaching every contact does not make a chain singular, since u_t[0] is imposed: the chain then moves as a rigid body.
    Cutting both bonds of a part without contacts does make it singular.

    The residual is computed from the displacements returned, whose last digits are forces too. It compares them with what each
    spring would exert by itself: when a chain moves as a rigid body these are large, however small the forces that are left.
    """
    check_kind("chain", chain, Chain)
    check_kind("state", state, State)
    valid = all_numbers(chain, state)
    safe, state = or_harmless(valid, (chain, state))
    return in_balance(valid, safe, state, eliminate(safe, safe.contact))


def in_balance(valid: Array, safe: Chain, state: State, beyond: Springs) -> Equilibrium:
    """Solve for the `equilibrium` of a chain that has been eliminated.

    `beyond` is that elimination, with its contacts; `valid`, shape (), is false where `or_harmless` replaced chain and state.
    """
    (upper, layer), converged = solve(safe, state, lax.stop_gradient(beyond))
    end = safe.end.upper * upper[-1] + safe.end.layer * layer[-1]
    push = safe.contact_force(layer - state.pinning).sum() + end
    found = lax.stop_gradient((safe, state, (upper, layer)))
    worst, scale = jnp.abs(jnp.stack(imbalance(*found))).max(), _gross(*found)
    residual = worst / jnp.where(scale > 0, scale, 1)
    stress = safe.stress(layer, state.pinning)
    finite = jnp.stack([jnp.isfinite(x).all() for x in (upper, layer, stress, push, residual)]).all()
    balanced = converged & (residual <= jnp.finfo(residual.dtype).eps ** 0.5)
    status = jnp.select(
        [~valid, floats(safe, beyond), ~finite, ~balanced],
        [Outcome.INVALID, Outcome.SINGULAR, Outcome.INVALID, Outcome.NOT_CONVERGED],
        Outcome.SOLVED,
    ).astype(jnp.int32)
    return Equilibrium(upper, layer, stress, push, residual, status)


@jax.custom_jvp
def solve(chain: Chain, state: State, beyond: Springs) -> tuple[Pair, Array]:
    """Solve for the displacements; also return whether Newton's method converged.

    `beyond` is the elimination of the chain with linear contacts; the derivative takes it as constant.
    """
    start = (jnp.zeros_like(chain.contact).at[0].set(state.load), jnp.zeros_like(chain.contact))
    if chain.law is not None:
        return _newton(chain, state, start)
    moved = respond(chain, chain.contact, beyond, imbalance(chain, state, start))
    return (start[0] + moved[0], moved[1]), jnp.ones((), bool)


@solve.defjvp  # pyright: ignore[reportArgumentType]
def _implicit_derivative(primals, tangents):
    """Differentiate the solution x implicitly.

    0 = d imbalance = −(tangent stiffness) dx + ∂imbalance at the solution x, which can itself be differentiated again.
    """
    chain, state, beyond = primals
    x, converged = solve(chain, state, beyond)
    unmoved = (jnp.zeros_like(x[0]).at[0].set(tangents[1].load), jnp.zeros_like(x[1]))
    unbalanced = jax.jvp(imbalance, (chain, state, x), (*tangents[:2], unmoved))[1]
    if chain.law is None:
        moved = _solve_linear(chain, chain.contact, beyond, unbalanced)
    else:
        contact = _tangent(chain, x[1] - state.pinning)
        moved = _solve_linear(chain, contact, eliminate(chain, contact), unbalanced)
    none = np.zeros(np.shape(converged), jax.dtypes.float0)
    return (x, converged), ((unmoved[0] + moved[0], moved[1]), none)


def imbalance(chain: Chain, state: State, x: Pair) -> Pair:
    """Compute the net force on every site of the two layers.

    In K u_s; zero on u_t[0], which is held.
    """
    upper, layer = forces(chain, state.pinning, x)
    return upper.at[0].set(0), layer


def forces(chain: Chain, pinning: Array, x: Pair) -> Pair:
    """Sum spring and contact forces per site, without prestress, in K u_s.

    Of linear contacts minus the gradient of `potential_energy`; written out, because the compiled gradient is a third slower.
    """
    upper, layer = _springs(chain, x)
    return upper, layer - chain.contact_force(x[1] - pinning)


def _springs(chain: Chain, x: Pair) -> Pair:
    """Sum the forces of all springs except the contacts on every site."""
    upper, layer = x
    none = jnp.zeros(1, upper.dtype)
    along = (chain.upper * jnp.diff(upper), chain.layer * jnp.diff(layer))
    across = chain.across * (layer - upper)
    end = chain.end
    last = end.across * (layer[-1] - upper[-1])
    of_upper, of_layer = (jnp.concatenate([x, none]) - jnp.concatenate([none, x]) for x in along)
    return (
        (of_upper + across).at[-1].add(last - end.upper * upper[-1]),
        (of_layer - across).at[-1].add(-last - end.layer * layer[-1]),
    )


def _gross(chain: Chain, state: State, x: Pair) -> Array:
    """Largest sum of |stiffness × displacement| over the springs of a site."""
    upper, layer = jnp.abs(x[0]), jnp.abs(x[1])
    none, end = jnp.zeros(1, upper.dtype), chain.end
    along = (chain.upper * (upper[:-1] + upper[1:]), chain.layer * (layer[:-1] + layer[1:]))
    across = (chain.across * (layer + upper)).at[-1].add(end.across * (layer[-1] + upper[-1]))
    of_upper, of_layer = (jnp.concatenate([f, none]) + jnp.concatenate([none, f]) + across for f in along)
    contacts = jnp.abs(chain.contact_force(x[1] - state.pinning)) + chain.contact * (layer + jnp.abs(state.pinning))
    of_upper, of_layer = of_upper.at[-1].add(end.upper * upper[-1]), (of_layer + contacts).at[-1].add(end.layer * layer[-1])
    return jnp.maximum(of_upper.max(), of_layer.max())


def _solve_linear(chain: Chain, contact: Array, beyond: Springs, force: Pair) -> Pair:
    """`respond` as a linear map that JAX can differentiate and transpose."""

    # one array for both layers: custom_linear_solve fails on a pair in which one tangent is a symbolic zero
    def stiffness(x: Array) -> Array:
        upper, layer = _springs(chain, (x[0].at[0].set(0), x[1]))
        return jnp.stack([(-upper).at[0].set(x[0, 0]), contact * x[1] - layer])

    def solver(_, b: Array) -> Array:
        upper, layer = respond(chain, contact, beyond, (b[0], b[1]))
        return jnp.stack([upper.at[0].set(b[0, 0]), layer])  # the identity on u_t[0], so that the map is symmetric

    upper, layer = lax.custom_linear_solve(stiffness, jnp.stack(force), solver, symmetric=True)
    return upper, layer


def _tangent(chain: Chain, stretch: Array) -> Array:
    """Derivative of every contact's force with respect to its own stretch."""
    return jax.jvp(chain.contact_force, (stretch,), (jnp.ones_like(stretch),))[1]


def _newton(chain: Chain, state: State, start: Pair) -> tuple[Pair, Array]:
    """Take damped Newton steps until none lowers the imbalance."""
    parts = jnp.asarray(DAMPING, start[0].dtype)

    def size(x: Pair) -> Array:
        return jnp.sum(jnp.stack(imbalance(chain, state, x)) ** 2)

    def step(carry):
        x, now, n, _ = carry
        contact = _tangent(chain, x[1] - state.pinning)
        dx = respond(chain, contact, eliminate(chain, contact), imbalance(chain, state, x))
        tried = jax.vmap(lambda part: size(jax.tree.map(lambda a, b: a + part * b, x, dx)))(parts)
        best = jnp.nanargmin(tried)
        after = jnp.where(jnp.isnan(tried[best]), jnp.inf, tried[best])
        better = after < now
        moved = jax.tree.map(lambda a, b: jnp.where(better, a + parts[best] * b, a), x, dx)
        return moved, jnp.where(better, after, now), n + 1, better

    def going(carry) -> Array:
        _, now, n, better = carry
        return better & (now > 0) & (n < MAX_NEWTON_STEPS)

    n = jnp.zeros((), jnp.int32)
    x, now, n, _ = lax.while_loop(going, step, (start, size(start), n, jnp.ones((), bool)))
    pull, push = chain.contact_force(x[1] - state.pinning), chain.upper[0] * (x[0][0] - x[0][1])
    scale = jnp.maximum(jnp.abs(pull).max(), jnp.abs(push)) + jnp.finfo(now.dtype).tiny
    rounding = 1e3 * jnp.finfo(now.dtype).eps * chain.sites**0.5
    return x, jnp.sqrt(now) <= rounding * scale * (1 + chain.upper.max())


def all_numbers(chain: Chain, state: State) -> Array:
    """Check that all values are finite and all stiffnesses in their domains."""
    leaves = [x for x in jax.tree.leaves((chain, state)) if jnp.issubdtype(jnp.asarray(x).dtype, jnp.inexact)]
    finite = jnp.stack([jnp.isfinite(x).all() for x in leaves]).all()
    positive = [(x >= 0).all() for x in (chain.upper, chain.layer, chain.across, chain.contact, *chain.end)]
    return finite & jnp.stack(positive).all() & (chain.stiffness > 0)


def or_harmless(valid: Array, given: T) -> T:
    """Replace what belongs to an invalid chain or state by ones.

    This keeps NaN out of loops and derivatives.
    """
    return jax.tree.map(lambda x: jnp.where(valid, x, jnp.ones_like(x)), given)
