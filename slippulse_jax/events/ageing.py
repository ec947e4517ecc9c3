r"""Ageing of contacts: thresholds that grow with the age of a contact.

A contact of age a has the threshold θ_i [ν + (1 − ν) g(a)], with ν the strength of a newborn contact relative to an old one.
Age is measured in load (displacement of the left edge or of the driver, in u_s), or in time if the drive has a velocity.

Under an increasing load the stress on a contact grows linearly, while its threshold, concave in age, grows ever more slowly.
The next break occurs at the load where the first of these pairs of curves crosses. It is found exactly, not by small steps:
Newton's method starts where the curves approach each other. By concavity its first step lands beyond the crossing, and it then
returns to the crossing without overshooting.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.domains import Domain, check_choice
from slippulse_jax.units import quantity_field

Law = Literal["exponential", "logarithmic"]
Clock = Literal["load", "time"]

NEWBORN = Domain(0, 1, "must lie in (0, 1]: the threshold of a newborn contact over that of an old one", closed=True)
SCALE = Domain(0, float("inf"), "must be positive: the age by which a contact recovers")


class Ageing(eqx.Module):
    """Law by which thresholds recover.

    Parameters
    ----------
    newborn : float
        ν, threshold of a contact that has just repinned, relative to that of one that never broke; in (0, 1].
    scale : float
        τ > 0, characteristic age of recovery, in u_s of load (or in time, with ``clock="time"``).
    law : {"exponential", "logarithmic"}
        g(a) = 1 − e^{−a/τ}, or g(a) = ln(1 + a/τ)/ln 2 up to a = τ and 1 from there on: no contact becomes stronger than those
        that never broke, which are older than all others.
    clock : {"load", "time"}
        Measure of age. A protocol with velocity v converts time to load: τ_load = v τ.
    """

    newborn: Float[AnyArrayLike, ""] = quantity_field("\\nu", "1")
    scale: Float[AnyArrayLike, ""] = quantity_field("\\tau", "u_s")
    law: Law = eqx.field(default="exponential", static=True)
    clock: Clock = eqx.field(default="load", static=True)

    def __check_init__(self) -> None:
        check_choice("Ageing.law", self.law, Law)
        check_choice("Ageing.clock", self.clock, Clock)
        NEWBORN.check("Ageing.newborn", self.newborn)
        SCALE.check("Ageing.scale", self.scale)

    def strength(self, age: Array, velocity: Array | float = 1.0) -> Array:
        """Threshold relative to that of an old contact.

        A contact that never broke has the age inf.
        """
        nu, tau = jnp.asarray(self.newborn), self.load_scale(velocity)
        old = jnp.isinf(age)
        x = jnp.where(old, 0, age) / tau
        # of the two slopes at x = 1 that of what follows, as `next_crossing` needs it
        grown = -jnp.expm1(-x) if self.law == "exponential" else jnp.where(x < 1, jnp.log1p(x) / jnp.log(2.0), 1)
        return jnp.where(old, 1, nu + (1 - nu) * grown)

    def load_scale(self, velocity: Array | float) -> Array:
        """Convert τ to load."""
        return jnp.asarray(self.scale) * (velocity if self.clock == "time" else 1.0)

    def age_of_growth(self, growth: Array, velocity: Array | float = 1.0) -> Array:
        """Age from which on the strength grows no faster than a given rate; negative if it never grows that fast."""
        nu, tau = jnp.asarray(self.newborn), self.load_scale(velocity)
        ratio = growth * tau / (1 - nu)
        if self.law == "exponential":
            return jnp.where(nu < 1, -tau * jnp.log(ratio), -1.0)
        return jnp.where(nu < 1, tau * jnp.minimum(1 / (ratio * jnp.log(2.0)) - 1, 1), -1.0)


MAX_NEWTON_STEPS = 60


def next_crossing(
    ageing: Ageing, stress: Array, per_load: Array, threshold: Array, age: Array, velocity: Array | float = 1.0
) -> Float[Array, " N"]:
    """Find the load increase that brings each contact to its threshold; inf where none does.

    From its stress now, below threshold, and its growth per load, in σ_s and σ_s/u_s; the threshold of contacts that never
    broke, in σ_s; and its age in load, inf for a contact that never broke.
    """
    pulled = (per_load > 0) & (threshold < jnp.inf)
    c = jnp.where(pulled, per_load, 1)
    theta = jnp.where(pulled, threshold, 1)

    def gap(d: Array) -> Array:
        return theta * ageing.strength(age + d, velocity) - stress - c * d

    # where the threshold grows half as fast as the stress: the gap closes from there on, and a tangent overshoots the crossing
    ageless = jnp.isinf(age)
    start = ageing.age_of_growth(c / (2 * theta), velocity) - jnp.where(ageless, 0, age)
    start = jnp.where(ageless, 0, jnp.maximum(start, 0))

    def step(carry: tuple) -> tuple:
        d, _, n = carry
        short, slope = jax.jvp(gap, (d,), (jnp.ones_like(d),))
        after = jnp.maximum(d - short / slope, 0)
        after = jnp.where(pulled, after, 0)
        # the first step may go either way; after it the iterates only decrease, until rounding stops them
        moved = (n == 0) | (after < d)
        return jnp.where(moved, after, d), jnp.any(moved & (after != d)), n + 1

    def going(carry: tuple) -> Array:
        return carry[1] & (carry[2] < MAX_NEWTON_STEPS)

    n = jnp.zeros((), jnp.int32)
    crossing, _, _ = lax.while_loop(going, step, (start, jnp.ones((), bool), n))
    return jnp.where(pulled, crossing, jnp.inf)
