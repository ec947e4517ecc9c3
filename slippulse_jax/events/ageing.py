r"""Ageing of contacts: thresholds that grow with the age of a contact.

A contact of age a has the threshold θ_i [ν + (1 − ν) g(a)], with ν the strength of a newborn contact relative to an old one.
Age is measured in load (displacement of the left edge or of the driver, in u_s), or in time if the drive has a velocity.

Under an increasing load the stress on a contact grows linearly, and its pressure, where that is read, changes linearly, while
its strength, concave in age, grows ever more slowly. It breaks where stress = threshold × strength × pressure for the first
time. That load is found exactly, not by small steps, from both sides: a chord of the strength lies below it, so the stress
meets the chord before the crossing; a tangent lies above it, so the stress meets the tangent after it. Either meeting is the
root of a quadratic, and the two close in faster than Newton's method.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.base.domains import Domain, check_choice
from slippulse_jax.base.units import quantity_field

Law = Literal["exponential", "logarithmic"]
Clock = Literal["load", "time"]

NEWBORN = Domain(0, 1, "must lie in (0, 1]: the threshold of a newborn contact over that of an old one", closed="high")
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
        nu, tau = jnp.asarray(self.newborn), jnp.asarray(self.scale) * (velocity if self.clock == "time" else 1.0)
        old = jnp.isinf(age)
        x = jnp.where(old, 0, age) / tau
        # of the two slopes at x = 1 that of what follows: a tangent there lies above it
        grown = -jnp.expm1(-x) if self.law == "exponential" else jnp.where(x < 1, jnp.log1p(x) / jnp.log(2.0), 1)
        return jnp.where(old, 1, nu + (1 - nu) * grown)


LAST_PLACES = 4
"""Units in the last place of the load within which a crossing is known."""
MOST_STEPS = 60
"""Most pairs of chord and tangent; three to five are usual."""


def next_crossing(
    push: Float[Array, "r N"],
    threshold: Float[Array, " N"],
    readings: Float[Array, "r N"],
    *,
    ageing: Ageing,
    age: Float[Array, " N"],
    velocity: Array | float = 1.0,
) -> Float[Array, " N"]:
    """Rise of the load that brings each ageing contact to its threshold.

    As `rises`, of contacts of an age in load, inf for one that never broke, whose threshold is that of one that never did.
    Beyond the first crossing of any contact the numbers are lower bounds; inf where no load brings a contact there.
    """
    there = jnp.isfinite(threshold)
    theta, none = jnp.where(there, threshold, 1), jnp.zeros_like(threshold)
    gain, lost = push[0], push[1] if len(push) > 1 else none
    stress, pressure = readings[0], readings[1] if len(readings) > 1 else none + 1

    def strength(rise: Array) -> Array:
        return ageing.strength(age + rise, velocity)

    def farther(rise: Array, now: Array, growth: Array) -> Array:
        """Rise where the stress meets a strength that grows linearly from here."""
        left = pressure + lost * rise
        short = jnp.maximum(theta * now * left - stress - gain * rise, 0)
        slope, bend = theta * (growth * left + now * lost) - gain, theta * growth * lost
        root = slope**2 - 4 * bend * short
        closing = jnp.sqrt(jnp.maximum(root, 0)) - slope
        meets = there & (root >= 0) & (closing > 0)
        return rise + jnp.where(short > 0, jnp.where(meets, 2 * short / jnp.where(meets, closing, 1), jnp.inf), 0)

    def step(state: tuple) -> tuple:
        low, high, _, count = state
        at, wide = strength(low), jnp.isfinite(high) & (high > low)
        chord = jnp.where(wide, (strength(high) - at) / jnp.where(wide, high - low, 1), 0)
        closer = jnp.minimum(farther(low, at, chord), high)
        known = jnp.where(jnp.isfinite(closer), closer, 0)
        above, growth = jax.jvp(strength, (known,), (jnp.ones_like(known),))
        high = jnp.minimum(high, jnp.where(jnp.isfinite(closer), farther(known, above, growth), jnp.inf))
        return closer, high, closer > low + LAST_PLACES * jnp.finfo(low.dtype).eps * (1 + low), count + 1

    def going(state: tuple) -> Array:
        low, high, moved, count = state
        return (moved & (low < high.min())).any() & (count < MOST_STEPS)

    begin = none, farther(none, none + 1, none), there, jnp.zeros((), jnp.int32)
    return lax.while_loop(going, step, begin)[0]
