r"""Contacts of rough surfaces, whose stiffness and threshold follow the pressure.

The push tilts it. Where ever more asperities touch, the pressure is p = p̄ exp(−u_y/ℓ_n), both stiffnesses of a contact are
proportional to it, and so is its threshold μp: it breaks at one stretch, u_s = μ ℓ_n k_n/k, whatever its pressure. With
π_i = exp(−μ q_i), q_i = (k_n/k)⟨u_y⟩_i/u_s, and the stretch s_i = ⟨u_x⟩_i − u_b,i, a contact pulls at the block by π_i s_i and
(1 − π_i)/μ, in σ_s.

The springs of the uniform pressure belong to the block (`slippulse_jax.blocks.guide`), and what the contacts fall short of
them acts on it as a force. Newton's method finds their balance and the load at which one breaks. While an event runs, the
stiffnesses are those at its nucleation; a break then moves every stretch by a known amount again.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.blocks.guide import Guide, compliance, held_by_all, inverse
from slippulse_jax.bodies.response import Response, of_matrix
from slippulse_jax.events.event import first_to_break, rises

BALANCE_STEPS = 100
"""Most steps of Newton's method; ten to twenty are usual."""


class Balance(NamedTuple):
    """Contacts in balance under a load."""

    load: Array
    stretch: Float[Array, " N"]  # in u_s
    pressure: Float[Array, " N"]  # π
    force: Float[Array, " 2N"]  # what they fall short of the springs of the uniform pressure
    first: Int[Array, ""]  # contact that reaches its threshold first


class Pressed(NamedTuple):
    """Response of N contacts, ⟨u_x⟩ then ⟨u_y⟩, on springs of uniform pressure."""

    matrix: Float[Array, "2N 2N"]  # displacement per force, both in those of a contact at its threshold
    push: Float[Array, " 2N"]  # displacement per load
    edge_stiffness: Array  # force on the pusher per load, in K, of the springs of the uniform pressure
    normal: Array  # k_n/k
    friction: Array  # μ

    def through(self, spring: Any, stiffness: Any) -> "Pressed":
        """The same contacts with the pusher pulled through a spring, as `Response.through`."""
        whole = spring + self.edge_stiffness
        matrix, share = self.matrix + stiffness / whole * jnp.outer(self.push, self.push), spring / whole
        return self._replace(matrix=matrix, push=self.push * share, edge_stiffness=self.edge_stiffness * share)

    def balance(
        self,
        threshold: Float[Array, " N"],
        prestress: Float[Array, " N"],
        pinning: Float[Array, " N"],
        load: Array,
        rises: Callable[..., Float[Array, " N"]] = rises,
    ) -> Balance:
        """Balance contacts at the first load at which one reaches its threshold.

        The first from `load` on, or `load` itself if none will. The rise of the load to there is that of `rises`, given push,
        threshold and stretch. Differentiable: after Newton's method, with the derivatives of its first point, has converged,
        one true step carries those of the result.
        """
        sites, free = threshold.size, pinning - prestress

        def at(z: Array) -> tuple[Array, Array, Array]:
            stretch, q = z[:sites] - free, self.normal * z[sites:]
            fall = self.friction * q
            pressure, none = jnp.exp(-fall), fall == 0
            pull = q * jnp.where(none, 1, -jnp.expm1(-fall) / jnp.where(none, 1, fall))  # (1 − π)/μ, also at μ = 0
            return stretch, pressure, jnp.concatenate([z[:sites] + prestress - pressure * stretch, q - pull])

        def linear(z: Array) -> tuple[tuple[Array, Array], Array]:
            """Derivatives D of force in ⟨u_x⟩, ⟨u_y⟩, and (1 − M D)⁻¹."""
            stretch, pressure, _ = at(z)
            less = 1 - pressure
            along, across = jnp.concatenate([less, self.normal * less]), self.normal * self.friction * pressure * stretch
            coupled = self.matrix * along[None]
            coupled = coupled.at[:, sites:].add(self.matrix[:, :sites] * across[None])
            return (along, across), inverse(jnp.eye(2 * sites, dtype=z.dtype) - coupled)

        def step(z: Array, slopes: tuple[Array, Array], solve: Array) -> tuple[Array, Array, Array]:
            along, across = slopes
            short = (at(z)[2] - along * z).at[:sites].add(-across * z[sites:])
            still, moved = solve @ (self.matrix @ short), solve @ self.push
            per_load = moved[:sites]
            first, rise = first_to_break(per_load[None], threshold, (still[:sites] + load * per_load - free)[None], rises)
            at_load = load + jnp.where(jnp.isfinite(rise), jnp.maximum(rise, 0), 0)
            return still + at_load * moved, at_load, first

        def far(state: tuple[Array, Array, Array]) -> Array:
            z, before, count = state
            return (jnp.abs(z - before).max() > 1e3 * jnp.finfo(z.dtype).eps * jnp.abs(z).max()) & (count < BALANCE_STEPS)

        def search(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            return step(state[0], *near)[0], state[0], state[2] + 1

        begin = load * self.push + self.matrix[:, :sites] @ pinning
        begin = step(begin, *linear(begin))[0]
        near = linear(begin)
        found = lax.while_loop(far, search, (step(begin, *near)[0], begin, jnp.int32(0)))[0]
        found = lax.stop_gradient(found)
        z, at_load, first = step(found, *linear(found))
        stretch, pressure, force = at(z)
        return Balance(at_load, stretch, pressure, force, first)

    def frozen(self, at: Balance) -> Response:
        """What breaks do to the stretches while stiffnesses stay as they are."""
        sites = at.pressure.size
        less = jnp.concatenate([at.pressure - 1, self.normal * (at.pressure - 1)])
        matrix = self.matrix @ inverse(jnp.eye(2 * sites, dtype=less.dtype) + less[:, None] * self.matrix)
        push = self.push - matrix @ (less * self.push)
        pull = at.pressure[:, None] * matrix[:sites, :sites].T
        return of_matrix(pull[:, None], (at.pressure * push[:sites])[None], self.edge_stiffness)


def under_pressure(guide: Guide, contact: Array, sites: int, normal: Array, friction: Array) -> Pressed:
    """Contacts of stiffness k on a guide."""
    A, t = compliance(guide, sites, 2, 2)
    matrix = A.transpose(2, 3, 1, 0).reshape(2 * sites, 2 * sites)
    return Pressed(contact * matrix, t.reshape(-1), contact * held_by_all(guide, t), normal, friction)
