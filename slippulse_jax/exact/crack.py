r"""Crack-like first precursors, whose contacts slide until the front has stopped.

The quasi-static limit of `slippulse_jax.rules.CrackLike`, with which the paper compares its pulses. The left edge is loaded
until contact 0 carries its threshold; a contact that reaches it slides at the friction σ_k. With displacements beyond those of
the prestress φ in units of 1 − φ, and ρ = (σ_k − φ)/(1 − φ), the layers behind a tip that has passed n contacts obey

    K_L Δ²u_t = K_T (u_t − u),    K Δ²u = K_T (u − u_t) + kρ,

so that P = K_L u_t + u is a parabola, and D = u_t − u decays from both ends:

    P = c_0 + c_1 i + kρ i²/2,    D = kρ/m + c_2 r^i + c_3 r^{n−i},    m = K_T (1 + 1/K_L),    r + 1/r = 2 + m.

Ahead of it they are sums of the two modes. Four conditions determine the c: u_t(0) = U0 and u(−1) = u(0) at the pushed edge,
and in each mode a decay by r_m from n − 1 to n. The tip stops where contact n carries its threshold, u(n) = 1; n is real.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array

from slippulse_jax.base.outcomes import first_of, length_or_reason
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.modes import Modes, lattice_modes
from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.bulk.derivatives import root_between
from slippulse_jax.slider import Slider

FARTHEST = 1e3
"""Largest length searched, in H (1 + b): without prestress every tip has stopped long before."""

NODES = 96
"""Number of positions, in geometric progression, among which the first stop is searched."""

NOISE = 1e9
"""Error of a length in units of rounding: on soft contacts the stress at the tip hardly changes from one to the next."""


Displacements = Callable[[Array], tuple[Array, Array]]
"""Displacements u_t and u at a site."""


def sliding(slider: Slider, ratio: Array, position: Array) -> tuple[Displacements, Displacements, Modes]:
    """Displacements behind the tip, and from the tip on; and the modes.

    Of scalars, `ratio` being ρ. In equilibrium with contacts 0 … n − 1 sliding, beyond the prestress and in units of 1 − φ.
    """
    modes = lattice_modes(slider)
    K_L, K_T, n = jnp.asarray(slider.K_L), jnp.asarray(slider.K_T), position
    kr, m = jnp.asarray(slider.stiffness) * ratio, K_T * (1 + 1 / K_L)
    rate = -2 * jnp.arcsinh(jnp.sqrt(m) / 2)
    gap, far, apart = -jnp.expm1(rate), jnp.exp(rate * n), kr / m
    r, g, r_m = 1 - gap, modes.gap, modes.ratio
    # c_0 and c_1 by the conditions at the edge, in terms of c_2 and c_3
    constant = (1 + K_L) * modes.load - apart, -1.0, -far
    slope = kr / 2, -K_L * gap / r, K_L * gap * far
    # P (1 − o_m) + D (1 + o_m K_L), o_m being u_t/u of the other mode, falls by r_m
    o = modes.upper[::-1]
    far_end = g * n + r_m

    def falls(c0: Array | float, c1: Array, P: Array | float, D: Array) -> Array:
        return (1 - o) * (g * c0 + far_end * c1 + P) + (1 + o * K_L) * D

    b = -falls(constant[0], slope[0], kr * (n**2 - r_m * (n - 1) ** 2) / 2, g * apart)
    A2 = falls(constant[1], slope[1], 0.0, far * (g - gap) / r)
    A3 = falls(constant[2], slope[2], 0.0, g + gap - g * gap)
    determinant = A2[0] * A3[1] - A2[1] * A3[0]
    c2, c3 = (b[0] * A3[1] - b[1] * A3[0]) / determinant, (A2[0] * b[1] - A2[1] * b[0]) / determinant
    c0, c1 = (x[0] + x[1] * c2 + x[2] * c3 for x in (constant, slope))

    def behind(site: Array) -> tuple[Array, Array]:
        P = c0 + (c1 + kr * site / 2) * site
        D = apart + c2 * jnp.exp(rate * site) + c3 * jnp.exp(rate * (n - site))
        return (P + D) / (1 + K_L), (P - K_L * D) / (1 + K_L)

    @in_full
    def ahead(site: Array) -> tuple[Array, Array]:
        (upper, layer), (a, b) = behind(n), modes.upper
        amplitude = jnp.stack([upper - b * layer, a * layer - upper]) / (a - b)
        here = amplitude * jnp.exp((site - n) * jnp.log1p(-g))
        return modes.upper @ here, here.sum()

    return behind, ahead, modes


def stress_ahead(slider: Slider, ratio: Array, position: Array) -> Array:
    """Stress (t − φ)/(1 − φ) at the tip, before it slides."""
    return sliding(slider, ratio, position)[0](position)[1]


def length(slider: Slider, friction: Array, prestress: Array) -> tuple[Array, Array]:
    """Length of the crack-like first precursor in λc, and its `Outcome`.

    Of one slider, with derivatives in every mode.

    `RUN_AWAY` where nothing stops the tip, as contacts whose prestress exceeds their friction may not; 0 where the neighbour of
    contact 0 stays below its threshold.
    """
    q = jnp.asarray(slider.stiffness)
    ratio = (friction - prestress) / (1 - prestress)
    far = FARTHEST * jnp.asarray(slider.height) * (1 + slider.b)
    node = jnp.exp(jnp.linspace(0, 1, NODES, dtype=q.dtype) * jnp.log(far))

    def above(parameters: tuple[Slider, Array], n: Array) -> Array:
        return stress_ahead(*parameters, n) - 1

    below = jax.vmap(lambda n: above((slider, ratio), n))(jax.lax.stop_gradient(node)) < 0
    first, stops = jnp.argmax(below), below.any()
    low, high = node[jnp.maximum(first - 1, 0)], node[jnp.maximum(first, 1)]
    found = root_between(above, (slider, ratio), low, high, NOISE)
    inside = (friction >= 0) & (friction < 1) & (jnp.abs(prestress) < 1) & slider.in_domain()
    endings = {
        Outcome.INVALID: ~inside,
        Outcome.RUN_AWAY: ~stops,
        Outcome.NO_DOMINO: first == 0,
        Outcome.NOT_CONVERGED: jnp.isnan(found),
    }
    status = first_of(endings)
    return length_or_reason(status, jnp.where(status == Outcome.ARRESTED, found, 1)), status


@in_full
def fields(slider: Slider, friction: Array, prestress: Array, position: Array, site: Array) -> tuple[Array, Array]:
    """Slip and stress at a contact beside the tip at `position`.

    Contacts before it slide, or slid until the front stopped; scalars.
    """
    behind, ahead, modes = sliding(slider, (friction - prestress) / (1 - prestress), position)
    slides = site < position
    layer = jnp.where(slides, behind(jnp.minimum(site, position))[1], ahead(jnp.maximum(site, position))[1])
    before = modes.profile(site) @ modes.drive
    held = prestress + (1 - prestress) * layer
    return (1 - prestress) * (layer - before), jnp.where(slides, friction, held)
