"""The first precursor of a uniform, relaxed interface, by a recursion of fixed-size state: O(1) per break.

Load the left edge until contact 0 carries σ_s. It breaks, repins at zero stretch and overloads contact 1, and so on: with
all contacts before s broken in turn, the stress on contact s is (in σ_s, before it breaks)

    t(s) = Σ_m e_m(s) [ w_m S_m + r_m^s (C_m + Σ_n R_mn T_n) ],   S_m = Σ_{j<s} r_m^{s−j} t(j),   T_n = Σ_{j<s} y_n(j) t(j),

with the modes of `slippulse_jax.lattice.modes`. Four sums are the whole memory of the past. The front goes on while
t(s) ≥ 1; Λ = s0 λc, where s0 is the first s with t(s) < 1.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.domains import HEIGHT, POISSON, STIFFNESS
from slippulse_jax.lattice.modes import Modes, RightEnd, lattice_modes
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

DEFAULT_MAX_CONTACTS = 10_000_000
"""Breaks after which a front is given up: beyond any slider of H/λc up to several million."""

FRONT_OUTCOMES = tuple(outcome for outcome in Outcome if outcome <= Outcome.RUN_AWAY)
"""How a front can end."""

AnyArray = Array | np.ndarray


class LengthDerivatives(NamedTuple):
    """Lengths of a batch and their derivatives, NumPy float64 of the shape of the batch; in λc per unit of the parameter.

    The derivatives are NaN where the length is not finite, and 0 where no domino starts.
    """

    length: np.ndarray  # ℓ or ℓ*
    height: np.ndarray  # dℓ/d(H/λc)
    stiffness: np.ndarray  # dℓ/d(k/K)
    poisson: np.ndarray  # dℓ/dν
    prestress: np.ndarray | None = None  # dℓ/dφ, with an interface
    threshold_slope: np.ndarray | None = None  # dℓ/dε, with an interface
    rule: Any = None  # the break rule with the derivatives in the places of its numbers, with a smooth rule
    hessian: np.ndarray | None = None  # (..., n, n), second derivatives in the order of the fields above


class Front(NamedTuple):
    """State of a front that has broken contacts 0 … position − 1; every pair is one number per mode."""

    position: Int[Array, ""]
    stress: Float[Array, ""]  # t(s), on the next contact
    stress_before: Float[Array, ""]  # t(s−1), on the contact broken last
    near: tuple[Array, Array]  # S_m
    edge: tuple[Array, Array]  # T_m
    decay: tuple[Array, Array]  # r_m^s


class Arrest(NamedTuple):
    """Where and how the front ended, or many fronts; of NumPy arrays where computed in bulk."""

    contacts_broken: Int[AnyArray, "..."]
    length: Float[AnyArray, "..."]  # ℓ, in λc
    status: Int[AnyArray, "..."]
    edge_stress: Float[AnyArray, "..."]  # stress on contact 0 behind the front, in σ_s


def nucleate(modes: Modes) -> Front:
    """The front about to break contact 0, which carries σ_s exactly."""
    one, zero = jnp.ones_like(modes.load), jnp.zeros_like(modes.load)
    return Front(jnp.zeros((), jnp.int32), one, one, (zero, zero), (zero, zero), (one, one))


def advance(modes: Modes, front: Front) -> Front:
    """Break the contact ahead, whatever stress it carries.

    Multiplying by r_m is written x − (1 − r_m) x: r_m itself, rounded, would be a systematic error of s·10⁻¹⁶.
    """
    s, t = front.position, front.stress
    (r1_gap, r2_gap), (w1, w2), (c1, c2), R = modes.gap, modes.weight, modes.drive, modes.reflection
    (S1, S2), (T1, T2), (E1, E2) = front.near, front.edge, front.decay
    y1, y2 = E1, E2
    if modes.echo is not None:
        e1, e2 = modes.echo_factor(s)
        y1, y2 = e1 * E1, e2 * E2
    S1, S2 = S1 + t, S2 + t
    S1, S2 = S1 - r1_gap * S1, S2 - r2_gap * S2
    T1, T2 = T1 + y1 * t, T2 + y2 * t
    E1, E2 = E1 - r1_gap * E1, E2 - r2_gap * E2
    u1 = w1 * S1 + E1 * (c1 + R[0, 0] * T1 + R[0, 1] * T2)
    u2 = w2 * S2 + E2 * (c2 + R[1, 0] * T1 + R[1, 1] * T2)
    if modes.echo is not None:
        e1, e2 = modes.echo_factor(s + 1)
        u1, u2 = e1 * u1, e2 * u2
    return Front(s + 1, u1 + u2, t, (S1, S2), (T1, T2), (E1, E2))


def edge_stress(modes: Modes, front: Front) -> Array:
    """Stress on contact 0 behind the front: Σ_n (w_n + Σ_m e_m(0) R_mn) T_n, in σ_s.

    It grows with every break and is the largest stress behind the front, so that contact 0 is the first to break again.
    """
    e = modes.echo_factor(jnp.zeros_like(modes.load))
    return jnp.dot(modes.weight + e @ modes.reflection, jnp.stack(front.edge))


def run(modes: Modes, max_contacts: int) -> Front:
    """Let the front go until the contact ahead stays below threshold, the chain ends, or `max_contacts` have broken."""
    limit = max_contacts if modes.echo is None else jnp.minimum(max_contacts, modes.echo.last + 1)

    def over_threshold(front: Front) -> Array:
        return (front.stress >= 1) & (front.position < limit)

    return lax.while_loop(over_threshold, lambda front: advance(modes, front), nucleate(modes))


def arrest(slider: Slider, right: RightEnd, sites: int | None, max_contacts: int) -> Arrest:
    """Length and status of the first precursor of one slider; differentiable forward."""
    modes = lattice_modes(slider, right, sites)
    front = run(modes, max_contacts)
    s0, behind, ahead = front.position, front.stress_before, front.stress
    at_edge = edge_stress(modes, front)
    through = (s0 == sites) if sites is not None else jnp.zeros((), bool)
    stopped = ahead < 1
    status = jnp.select(
        [~jnp.isfinite(ahead) | ~in_domain(slider), through, ~stopped, s0 == 1, at_edge >= 1],
        [Outcome.INVALID, Outcome.RAN_THROUGH, Outcome.LIMIT, Outcome.NO_DOMINO, Outcome.REBREAK],
        Outcome.ARRESTED,
    ).astype(jnp.int32)
    # t(ℓ) = 1 on the straight line between t(s0−1) and t(s0)
    length = s0 - 1 + (behind - 1) / (behind - ahead)
    # never a number, nor the derivative of one, where there is no length: both come out non-finite together
    undefined = jnp.where(status == Outcome.RAN_THROUGH, jnp.inf, jnp.nan)
    has_length = status <= Outcome.REBREAK
    return Arrest(s0, jnp.where(has_length, length, undefined * (1 + jnp.abs(length))), status, at_edge)


def in_domain(slider: Slider) -> Array:
    """Whether the values, traced ones included, are those of a slider."""
    height, stiffness, poisson = (jnp.asarray(x) for x in (slider.height, slider.stiffness, slider.poisson))
    return HEIGHT.holds(height) & STIFFNESS.holds(stiffness) & POISSON.holds(poisson)


def front_stress(modes: Modes, count: int) -> Float[Array, " count"]:
    """t(0) … t(count − 1): the stress each contact would carry had all before it broken, past the arrest too."""

    def step(front: Front, _: None) -> tuple[Front, Array]:
        return advance(modes, front), front.stress

    return lax.scan(step, nucleate(modes), length=count)[1]
