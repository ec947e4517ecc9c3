r"""What gauges along the interface would read after a front has passed: slip and stress, contact by contact.

When the contacts before `position` have broken in turn (of the last a part, where `position` is no whole number: f²(3 − 2f) of
it for a fraction f, so that fields are smooth in the position), pinning points have moved by p_j, and at site i, in units of
u_s and σ_s,

    slip(i)   = Σ_m [ w_m (Σ_{j≤i} r_m^{i−j} p_j + Σ_{j>i} r_m^{j−i} p_j) + r_m^i Σ_n R_mn T_n ],      T_n = Σ_j r_n^j p_j,
    stress(i) = φ + A Σ_m C_m r_m^i + slip(i) − p_i,      A = 1 − φ:

how far the interfacial layer moved while the front ran, and what the contact carries (label cra06). The first sum is the one
that the recursion of `slippulse_jax.lattice.front` carries; the second is the same from the other side.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.slider import Slider


class Readings(NamedTuple):
    """At every contact from the edge on, when a front has stopped."""

    slip: Float[Array, " sites"]  # in u_s
    stress: Float[Array, " sites"]  # in σ_s


class _Passing(NamedTuple):
    """A front that has broken contacts 0 … site − 1; every pair is one number per mode."""

    stress: Array  # t(site)
    near: tuple[Array, Array]  # Σ_j r^{site−j} p_j
    edge: tuple[Array, Array]  # T
    decay: tuple[Array, Array]  # r^site


def readings(slider: Slider, prestress: Array, position: Array, count: int) -> Readings:
    """Slip and contact stress at the first `count` contacts after a front that stopped at `position`, semi-infinite chain.

    Parameters
    ----------
    slider : Slider
        One slider.
    prestress : array, shape ()
        φ, in σ_s.
    position : array, shape ()
        Contacts broken, at most `count`; between whole numbers what is left behind goes over smoothly from one to the next.
    count : int
        Contact i lies at x = i λc.
    """
    modes = lattice_modes(slider)
    g, w, (R1, R2), C = modes.gap, modes.weight, modes.reflection, (1 - prestress) * modes.drive

    def from_edge(edge: tuple[Array, Array], decay: tuple[Array, Array]) -> Array:
        return decay[0] * (R1[0] * edge[0] + R1[1] * edge[1]) + decay[1] * (R2[0] * edge[0] + R2[1] * edge[1])

    def breaks(now: _Passing, site: Array) -> tuple[_Passing, tuple[Array, ...]]:
        part = jnp.clip(position - site, 0, 1)
        moved = now.stress * (part**2 * (3 - 2 * part))
        joined = now.near[0] + moved, now.near[1] + moved
        near = joined[0] - g[0] * joined[0], joined[1] - g[1] * joined[1]
        edge = now.edge[0] + now.decay[0] * moved, now.edge[1] + now.decay[1] * moved
        decay = now.decay[0] - g[0] * now.decay[0], now.decay[1] - g[1] * now.decay[1]
        driven = decay[0] * C[0] + decay[1] * C[1]
        ahead = prestress + (w[0] * near[0] + w[1] * near[1]) + (driven + from_edge(edge, decay))
        return _Passing(ahead, near, edge, decay), (moved, w[0] * joined[0] + w[1] * joined[1], *now.decay)

    def back(ahead: tuple[Array, Array], moved: Array) -> tuple[tuple[Array, Array], Array]:
        joined = ahead[0] + moved, ahead[1] + moved
        return (joined[0] - g[0] * joined[0], joined[1] - g[1] * joined[1]), w[0] * ahead[0] + w[1] * ahead[1]

    none, one = jnp.zeros_like(position), jnp.ones_like(position)
    # the edge is loaded until contact 0 carries its threshold, which rounding must not spoil
    start = _Passing(one, (none, none), (none, none), (one, one))
    end, (moved, behind, *decay) = lax.scan(breaks, start, jnp.arange(count, dtype=position.dtype))
    ahead = lax.scan(back, (none, none), moved, reverse=True)[1]
    slip = behind + ahead + from_edge(end.edge, (decay[0], decay[1]))
    return Readings(slip, prestress + (C[0] * decay[0] + C[1] * decay[1]) + slip - moved)
