"""What a simulation with inertia is asked for, and what it gives; `slippulse_jax.lattice.inertia` works it out."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.lattice.chain import Chain, State
from slippulse_jax.status import Status


class MotionStatus(Status):
    """How a simulation ended."""

    AT_REST = 0, "at rest: no contact over threshold, no motion left"
    TIME_OVER = 1, "time over: still moving after the given duration"
    SPANNED = 2, "the last contact of the chain broke"
    INVALID = 3, "no such chain or start, or the motion left the range of numbers"


class SelfHealing(eqx.Module):
    """A contact at its threshold breaks and repins at once with zero stretch: the paper's rule.

    Parameters
    ----------
    break_time : float
        Shortest time between two breaks anywhere, the most overloaded contact first; in √(m/K). The paper's hierarchy of
        times, sound much faster than the front, is a break time long beside the time the chain takes to relax. 0 (no less):
        a contact breaks the moment it reaches its threshold.
    """

    break_time: Float[AnyArrayLike, ""] = 0.0


class CrackLike(eqx.Module):
    """A contact at its threshold slides, under a constant friction, and repins when its slip rate vanishes (Amontons–Coulomb).

    Parameters
    ----------
    friction : float
        σ_k, the stress on a sliding contact, in σ_s; 0 or more, and below every threshold.
    """

    friction: Float[AnyArrayLike, ""] = 0.5


class Motion(NamedTuple):
    """A simulation at its end; displacements in u_s, times in √(m/K), energies in K u_s²."""

    state: State
    upper: Float[Array, " N"]
    layer: Float[Array, " N"]
    upper_velocity: Float[Array, " N"]
    layer_velocity: Float[Array, " N"]
    first_break: Float[Array, " N"]  # time at which each contact first broke; inf if it did not
    breaks: Int[Array, " N"]
    extent: Int[Array, ""]  # sites from the left edge to the rightmost broken contact, which is among them
    time: Float[Array, ""]
    step: Float[Array, ""]
    kinetic: Float[Array, ""]
    potential: Float[Array, ""]
    work: Float[Array, ""]  # of the left edge
    broken: Float[Array, ""]  # stretch lost by breaking contacts
    damped: Float[Array, ""]
    rubbed: Float[Array, ""]  # friction of sliding contacts
    imbalance: Float[Array, ""]  # largest error of the energy balance at any step
    status: Int[Array, ""]


class Asked(NamedTuple):
    """All that a simulation is asked for but the state it starts from."""

    chain: Chain
    rule: SelfHealing | CrackLike
    duration: Any
    damping: Any
    velocity: Any
    safety: Any
    rest: Any
    trigger: Any


def domains(asked: Asked) -> dict[str, tuple[Any, Callable[[Any], Any], str]]:
    """Every number that is asked for, whether it will do (traced or not), and what a user is told otherwise."""
    always: dict[str, tuple[Any, Callable[[Any], Any], str]] = {
        "duration": (asked.duration, lambda x: x > 0, "must be positive, in √(m/K)"),
        "damping": (asked.damping, lambda x: x >= 0, "must be 0 or more, per √(m/K)"),
        "velocity": (asked.velocity, jnp.isfinite, "must be finite, in u_s per √(m/K)"),
        "safety": (asked.safety, lambda x: (x > 0) & (x < 1), "must lie between 0 and 1"),
        "rest": (asked.rest, lambda x: x >= 0, "must be 0 or more, in K u_s²"),
        "trigger": (asked.trigger, lambda x: (x >= -1) & (x < asked.chain.sites), f"must be −1 … {asked.chain.sites - 1}"),
    }
    if isinstance(asked.rule, CrackLike):
        least = jnp.where(asked.chain.contact > 0, asked.chain.threshold, jnp.inf).min()
        below = "must be 0 or more and below every threshold, in σ_s"
        return {**always, "CrackLike.friction": (asked.rule.friction, lambda x: (x >= 0) & (x < least), below)}
    return {
        **always,
        "SelfHealing.break_time": (asked.rule.break_time, lambda x: x >= 0, "must be 0 or more, in √(m/K)"),
    }
