r"""The Green's function of the lattice: two modes, their reflection at the left edge and at the right end.

The two bulk equations (section "Equations to be solved") couple u_t and u through one 2×2 matrix, the same whether
space is a lattice or a line: its eigenvalues are κ_m², its eigenvectors (u_t, u) ∝ (1, α_m). On the lattice mode m
decays by the ratio r_m per site, r_m + 1/r_m = 2 + κ_m². A pinning point u_b[j] = 1 moves the interfacial layer by

    u[i] = Σ_m e_m(max(i, j)) w_m r_m^|i−j|  +  Σ_mn y_m(i) R_mn y_n(j),      y_m(i) = e_m(i) r_m^i:

the response of an endless lattice, the echo e_m of the right end, and the reflection R at the left edge, where u_t[0]
is imposed and u is free. For a semi-infinite chain e_m = 1.
"""

from typing import Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.slider import Slider

RightEnd = Literal["semi-infinite", "free", "clamped"]


class Echo(NamedTuple):
    """What the right end of a finite chain sends back."""

    amplitude: Float[Array, "2"]  # η_m: r_m from a free end, −r_m² from a clamped one
    last: Int[Array, ""]  # index of the last site, N − 1


class Modes(eqx.Module):
    """Everything the response of a uniform chain depends on; the leading axis runs over the two modes.

    The `gap` 1 − r_m is held beside the ratio: for tall sliders r_2 is so near 1 that 1 − r_2 must not be recomputed.
    """

    ratio: Float[Array, "2"]  # r_m, decay per site
    gap: Float[Array, "2"]  # 1 − r_m
    weight: Float[Array, "2"]  # w_m, response of an endless lattice, as u per u_b
    upper: Float[Array, "2"]  # u_t/u in the mode, 1/α_m
    reflection: Float[Array, "2 2"]  # R_mn
    drive: Float[Array, "2"]  # C_m, u at nucleation is Σ C_m y_m(i), in u_s: 1 at i = 0
    load: Float[Array, ""]  # U0, displacement of the left edge at nucleation, in u_s
    echo: Echo | None  # None for a semi-infinite chain

    def echo_factor(self, site: Array) -> Float[Array, "2"]:
        """e_m(i) = 1 + η_m r_m^{2(N−1−i)}."""
        if self.echo is None:
            return jnp.ones_like(self.ratio)
        return 1 + self.echo.amplitude * jnp.exp(2 * (self.echo.last - site) * jnp.log1p(-self.gap))

    def profile(self, site: Array) -> Float[Array, "2"]:
        """y_m(i) = e_m(i) r_m^i."""
        return self.echo_factor(site) * jnp.exp(site * jnp.log1p(-self.gap))


def lattice_modes(slider: Slider, right: RightEnd = "semi-infinite", sites: int | None = None) -> Modes:
    """Modes of the chain of one slider.

    Parameters
    ----------
    slider : Slider
        One slider (fields of shape ()).
    right : {"semi-infinite", "free", "clamped"}
        What the chain does beyond its last site: goes on for ever; nothing; is tied to a wall one bond further.
    sites : int, optional
        Number of sites N ≥ 2 of a finite chain.
    """
    check_right_end(right, sites)
    half = jnp.stack([slider.kappa_1, slider.kappa_2]) / 2
    root = jnp.sqrt(1 + half**2)
    ratio = 1 / (root + half) ** 2
    gap = 2 * half / (root + half)
    alpha = jnp.stack([slider.alpha_1, slider.alpha_2])
    # (0, 1) = Σ g_m (1, α_m) splits a force on the interfacial layer between the modes; share = α_m g_m, both positive
    share = jnp.stack([-alpha[0], alpha[1]]) * slider.kappa_T**2 / slider.mode_splitting
    weight = jnp.asarray(slider.stiffness) * share / (4 * half * root)
    upper = 1 / alpha

    if sites is None:
        echo, returned = None, jnp.zeros_like(gap)
    else:
        echo = Echo(ratio if right == "free" else -(ratio**2), jnp.asarray(sites - 1))
        returned = echo.amplitude * jnp.exp(2 * echo.last * jnp.log1p(-gap))

    # At the left edge, for amplitudes B_m of y_m and a source at j:
    #   u_t[0] = U      :  Σ e_m(0) B_m/α_m = U − Σ w_n/α_n y_n(j)
    #   u[−1] = u[0]    :  Σ slope_m B_m    =     Σ w_n (1 − r_n) y_n(j)
    e = 1 + returned
    slope = gap / ratio - gap * returned
    determinant = e[0] * upper[0] * slope[1] - e[1] * upper[1] * slope[0]
    at_edge = e[0] * slope[1] - e[1] * slope[0]
    imposed, freed = -weight * upper, weight * gap
    reflection = jnp.stack([imposed * slope[1] - freed * e[1] * upper[1], freed * e[0] * upper[0] - imposed * slope[0]])
    return Modes(
        ratio=ratio,
        gap=gap,
        weight=weight,
        upper=upper,
        reflection=reflection / determinant,
        drive=jnp.stack([slope[1], -slope[0]]) / at_edge,
        load=determinant / at_edge,
        echo=echo,
    )


class Fields(eqx.Module):
    """Displacements along the chain, in u_s = f_s/k; the leading axis runs over the sites."""

    upper: Float[Array, " sites"]  # u_t
    layer: Float[Array, " sites"]  # u
    pinning: Float[Array, " sites"]  # u_b, where each contact holds to the track
    prestress: Float[Array, " sites"]  # φ_i, what the contact carries when u = u_b, in σ_s

    @property
    def stress(self) -> Float[Array, " sites"]:
        """All that the contact carries: σ_c = k(u − u_b)/λc² (label cra06), and its prestress, in σ_s."""
        return self.layer - self.pinning + self.prestress


def equilibrium_fields(
    modes: Modes, load: Array, pinning: Float[Array, " sites"], prestress: Float[Array, " sites"] | None = None
) -> Fields:
    """Fields of a uniform chain in equilibrium (labels discr1, discr2), in O(sites).

    Parameters
    ----------
    modes : Modes
        Of the chain. Sites beyond those given are pinned at zero.
    load : array, shape ()
        U, displacement of the left edge of the upper layer, in u_s.
    pinning : array, shape (sites,)
        u_b, in u_s.
    prestress : array, shape (sites,), optional
        φ_i, in σ_s; none by default. It is balanced from outside (top shear), and moves nothing by itself.
    """
    site = jnp.arange(pinning.shape[0], dtype=pinning.dtype)
    echo, y = jax.vmap(modes.echo_factor)(site), jax.vmap(modes.profile)(site)
    sources = jnp.stack([pinning, pinning], axis=1)

    def accumulate(carry: Array, source: Array) -> tuple[Array, Array]:
        carry = carry - modes.gap * carry + source
        return carry, carry

    zero = jnp.zeros_like(modes.ratio)
    up_to = lax.scan(accumulate, zero, sources)[1]
    from_here = lax.scan(accumulate, zero, echo * sources, reverse=True)[1]
    endless = echo * up_to + from_here - echo * sources
    amplitude = modes.drive * load / modes.load + modes.reflection @ jnp.sum(y * sources, axis=0)
    in_mode = jax.vmap(lambda direct, at_site: modes.weight * direct + at_site * amplitude)(endless, y)
    carried = jnp.zeros_like(pinning) if prestress is None else prestress
    return Fields(in_mode @ modes.upper, in_mode.sum(axis=1), pinning, carried)


def check_right_end(right: RightEnd, sites: int | None) -> None:
    """Refuse an unknown right end, or a number of sites that does not go with it."""
    if right not in get_args(RightEnd):
        raise ValueError(f"right = {right!r}: must be one of {', '.join(map(repr, get_args(RightEnd)))}")
    if right == "semi-infinite":
        if sites is not None:
            raise ValueError(f"sites = {sites}: a semi-infinite chain has no number of sites; choose right='free' or 'clamped'")
    elif sites is None or sites < 2:
        raise ValueError(f"sites = {sites}: a chain with a {right} right end needs a number of sites, at least 2")
