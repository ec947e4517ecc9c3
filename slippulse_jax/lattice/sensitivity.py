"""Derivatives of the length in threshold and prestress of every contact.

The stress on contact s when the front reaches it is linear in what the contacts before it gave up,

    t(s) = φ_s + D(s) (θ_0 − φ_0) + Σ_{j<s} K(s, j) g(j),

with g = t under the hard rule, p(t) t under the smooth one, D the drive and K the kernel of `slippulse_jax.lattice.front`.
With λ_s the derivative of ℓ in the stress on contact s, everything it causes included,

    λ_s = ∂ℓ/∂t_s + g'(t_s) Σ_{i>s} K(i, s) λ_i,        K(i, s) = Σ_m w_m r_m^{i−s} + Σ_mn r_m^i R_mn r_n^s,

which needs four sums over the contacts ahead: one pass from the arrest back to the edge, O(1) per contact.
"""

from functools import partial
from types import NoneType
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.domains import check_kind, check_single, check_whole
from slippulse_jax.interface import Interface, Profile
from slippulse_jax.lattice.front import Contacts, Front, advance, contact_at, nucleate, straight_line, stress_ahead
from slippulse_jax.lattice.modes import Modes, lattice_modes
from slippulse_jax.rules import BreakRule, HardBreak, SmoothBreak, check_rule
from slippulse_jax.slider import Slider


class Sensitivity(NamedTuple):
    """Of a first precursor on a semi-infinite interface, site by site over the first `sites` contacts."""

    length: Float[Array, ""]  # ℓ, or ℓ_w, in λc
    stress: Float[Array, " sites"]  # t_s as the front reaches contact s, in σ_s
    threshold: Float[Array, " sites"]  # dℓ/dθ_i, in λc/σ_s
    prestress: Float[Array, " sites"]  # dℓ/dφ_i, in λc/σ_s
    complete: Array  # whether the front arrested, or faded, within `sites`


def sensitivity(
    slider: Slider,
    interface: Interface | Profile | None = None,
    *,
    sites: int,
    rule: BreakRule = HardBreak(),  # noqa: B008 - a constant without fields
) -> Sensitivity:
    """Length of the first precursor, and its derivative in every contact.

    The interface is semi-infinite.

    Parameters
    ----------
    slider : Slider
        One slider (fields of shape ()).
    interface : Interface or Profile, optional
        Thresholds and prestress; relaxed and uniform by default. Contacts repin at once. The first is loaded to θ_0.
    sites : int
        Number of contacts; more than the length, and for a smooth rule as many as the front takes to fade.
    rule : HardBreak or SmoothBreak, or one derived from it

    Notes
    -----
    Under the hard rule the threshold of a contact the front has passed has no effect: the contact breaks, whatever it is.
    Only the last contact broken and the one that stops the front have a dℓ/dθ, and contact 0, whose threshold sets the load.
    A smooth rule spreads it over the contacts near their threshold. The prestress of every contact matters under either,
    since it is released. Composes with ``jit`` and ``vmap``.

    Raises
    ------
    ValueError
        If the interface repins after a delay, or slider or interface is a batch.
    """
    check_kind("slider", slider, Slider)
    check_kind("interface", interface, Interface, Profile, NoneType)
    check_whole("sites", sites, 1)
    check_rule(rule, one=True)
    if interface is not None and interface.repin_delay:
        raise ValueError(
            f"interface.repin_delay = {interface.repin_delay}: sensitivity needs contacts that repin at once; for a delay, "
            "differentiate precursor_length of a Profile"
        )
    check_single("sensitivity", slider=slider, interface=interface)
    return _worked_out(slider, interface, sites, rule)


@partial(jax.jit, static_argnames="sites")
def _worked_out(slider: Slider, interface: Contacts, sites: int, rule: BreakRule) -> Sensitivity:
    modes = lattice_modes(slider)
    theta, phi = (jnp.broadcast_to(x, (sites,)) for x in contact_at(modes, interface, jnp.arange(sites)))
    front = _sweep(modes, rule, theta, phi)
    if isinstance(rule, SmoothBreak):
        length, direct, direct_theta, gain, gain_theta, complete = _faded(rule, front, theta)
    else:
        length, direct, direct_theta, gain, gain_theta, complete = _arrested(front, theta)
    adjoint, ahead, drive = _backward(modes, direct, gain)
    by_theta = direct_theta + gain_theta * ahead
    return Sensitivity(
        length=length,
        stress=front,
        threshold=by_theta.at[0].add(drive),
        prestress=adjoint.at[0].add(-drive),
        complete=complete,
    )


def _given_up(rule: BreakRule, stress: Array, threshold: Array, first: Array) -> Array:
    """g(t); contact 0 breaks whole."""
    if isinstance(rule, HardBreak):
        return stress
    return jnp.where(first, stress, rule.broken(stress, threshold) * stress)


def _sweep(modes: Modes, rule: BreakRule, theta: Array, phi: Array) -> Float[Array, " sites"]:
    """t_s, past the arrest too; the drive is that which loads contact 0 to its threshold."""
    first = jnp.arange(theta.size) == 0

    def step(front: Front, here: tuple[Array, Array, Array]) -> tuple[Front, Array]:
        theta, phi, first = here
        total = jnp.where(first, theta, phi + stress_ahead(front)[0])
        return advance(modes, front, _given_up(rule, total, theta, first)), total

    return lax.scan(step, nucleate(modes, theta[0] - phi[0]), (theta, phi, first))[1]


def _arrested(stress: Array, theta: Array) -> tuple:
    """ℓ of the hard rule, its direct derivatives, and g' = 1 for the contacts broken."""
    n = stress.size
    over = stress - theta
    held = over < 0
    s0 = jnp.argmax(held.at[0].set(False))
    complete = held[1:].any()

    def length(stress: Array, theta: Array) -> Array:
        over = stress - theta
        behind = jnp.where(s0 == 1, 0.0, over[s0 - 1])  # contact 0 breaks at its threshold exactly
        return straight_line((s0 - 1).astype(over.dtype), behind, over[s0])

    direct, direct_theta = jax.grad(length, (0, 1))(stress, theta)
    gain = (jnp.arange(n) < s0).astype(stress.dtype)
    value = jnp.where(complete, length(stress, theta), jnp.nan)
    good = jnp.where(complete, 1, jnp.nan)
    return value, good * direct, good * direct_theta, gain, jnp.zeros_like(gain), complete


def _faded(rule: SmoothBreak, stress: Array, theta: Array) -> tuple:
    """ℓ_w, its direct derivatives, and those of g; the derivatives of a contact's own function, site by site."""
    first = jnp.arange(stress.size) == 0

    def length(stress: Array, theta: Array) -> Array:
        steps = jax.vmap(rule.overloaded_length)(stress[1:-1], stress[2:], theta[1:-1], theta[2:])
        return rule.broken(stress[1], theta[1]) + steps.sum()

    direct, direct_theta = jax.grad(length, (0, 1))(stress, theta)
    slopes = jax.vmap(jax.grad(lambda t, theta, first: _given_up(rule, t, theta, first), (0, 1)))
    gain, gain_theta = slopes(stress, theta, first)
    complete = rule.broken(stress[-1], theta[-1]) < 1e-9
    good = jnp.where(complete, 1, jnp.nan)
    return length(stress, theta) * good, direct * good, direct_theta, gain, gain_theta, complete


@in_full
def _backward(
    modes: Modes, direct: Array, gain: Array
) -> tuple[Float[Array, " sites"], Float[Array, " sites"], Float[Array, ""]]:
    """λ_s; Σ_{i>s} K(i, s) λ_i, the derivative in what contact s gives up; and Σ_s D(s) λ_s, that in the load."""
    profiles = jax.vmap(modes.profile)(jnp.arange(direct.size).astype(direct.dtype))

    def step(sums: tuple[Array, Array], here: tuple) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        near, edge = sums
        direct, gain, profile = here
        ahead = _arriving(modes, near, edge, profile)
        adjoint = direct + gain * ahead
        return (_one_back(modes, near + adjoint), edge + profile * adjoint), (adjoint, ahead)

    none = jnp.zeros_like(modes.weight)
    (_, edge), (adjoint, ahead) = lax.scan(step, (none, none), (direct, gain, profiles), reverse=True)
    return adjoint, ahead, modes.drive @ edge


@in_full
def _arriving(modes: Modes, near: Array, edge: Array, profile: Array) -> Array:
    """Σ_m w_m A_m + Σ_mn B_m R_mn r_n^s, with A_m = Σ_{i>s} r_m^{i−s} λ_i and B_m = Σ_{i>s} r_m^i λ_i."""
    return modes.weight @ near + edge @ modes.reflection @ profile


def _one_back(modes: Modes, near: Array) -> Array:
    """r_m A_m; written with the gap, as in `slippulse_jax.lattice.front.advance`."""
    return near - modes.gap * near
