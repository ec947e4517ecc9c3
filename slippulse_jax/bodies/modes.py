r"""The Green's function of the lattice: modes and their reflections.

A slider has two modes, reflected at the left edge and at the right end.

The two bulk equations (section "Equations to be solved") couple u_t and u through one 2×2 matrix, the same whether
space is a lattice or a line: its eigenvalues are κ_m², its eigenvectors (u_t, u) ∝ (1, α_m). On the lattice mode m
decays by the ratio r_m per site, r_m + 1/r_m = 2 + κ_m². A pinning point u_b[j] = 1 moves the interfacial layer by

    u[i] = Σ_m e_m(max(i, j)) w_m r_m^|i−j|  +  Σ_mn y_m(i) R_mn y_n(j),      y_m(i) = e_m(i) r_m^i:

the response of an endless lattice, the echo e_m of the right end, and the reflection R at the left edge, where u_t[0]
is imposed and u is free. For a semi-infinite chain e_m = 1.

A machine of stiffness M drives the edge through that spring: u_t[0] = U − F/M, where U is the displacement of the machine and
F = K_L (u_t[−1] − u_t[0]) its force, with u_t[−1] as the modes continue it. Only the left edge changes. A chain of N sites has
the mirror of a free end at (N − ½) λc from contact 0, a clamped wall at N λc. The formulas hold for any real N; contacts are
then those that lie before (N − ½) λc.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.base.choices import RightEnd
from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.slider import Fields, Slider, of_one_type

Number = Float[Array, "..."]
Pair = tuple[Number, Number]


FARTHEST = 1e30
"""N from which on no digit tells a chain from one without end: finite, so that derivatives are."""


class Modes(eqx.Module):
    """Everything the response of a uniform chain depends on.

    The leading axis runs over the modes. The `gap` 1 − r_m is held too: r_2 of tall sliders is too near 1 to recompute it.
    """

    ratio: Float[Array, "2"]  # r_m, decay per site
    gap: Float[Array, "2"]  # 1 − r_m
    weight: Float[Array, "2"]  # w_m, response of an endless lattice, as u per u_b
    upper: Float[Array, "2"]  # u_t/u in the mode, 1/α_m
    reflection: Float[Array, "2 2"]  # R_mn
    drive: Float[Array, "2"]  # C_m, u at nucleation is Σ C_m y_m(i), in u_s: 1 at i = 0
    load: Float[Array, ""]  # U0, displacement of the drive (without a machine, of the left edge) at nucleation, in u_s
    echo: Float[Array, "2"] | None = None  # η_m of the right end: r_m if free, −r_m² if clamped; None for a semi-infinite chain
    last: Float[Array, ""] | None = None  # N − 1, index of the last site; likewise

    def echo_factor(self, site: Array) -> Float[Array, "2"]:
        """e_m(i) = 1 + η_m r_m^{2(N−1−i)}."""
        if self.echo is None or self.last is None:
            return jnp.ones_like(self.ratio)
        beyond = jnp.maximum(self.last - site.astype(self.gap.dtype), -1)  # past the end nothing grows
        return 1 + self.echo * jnp.exp(2 * beyond * jnp.log1p(-self.gap))

    def echo_growth(self, site: Array) -> Float[Array, "2"]:
        """e_m(i) − e_m(0), with all its digits."""
        if self.echo is None or self.last is None:
            return jnp.zeros_like(self.ratio)
        rate = 2 * jnp.log1p(-self.gap)
        return -self.echo * jnp.exp((self.last - site) * rate) * jnp.expm1(site * rate)

    def profile(self, site: Array) -> Float[Array, "2"]:
        """y_m(i) = e_m(i) r_m^i."""
        return self.echo_factor(site) * jnp.exp(site * jnp.log1p(-self.gap))


def lattice_modes(slider: Slider) -> Modes:
    """Modes of the chain of one slider (fields of shape ())."""
    given = {name: getattr(slider, name) for name in ("length", "machine") if getattr(slider, name) is not None}
    height, stiffness, poisson, *more = of_one_type(slider, *given.values())
    more = dict(zip(given, more, strict=True))
    end = (slider.right, more["length"]) if "length" in more else None
    numbers = mode_numbers(height, stiffness, poisson, end, more.get("machine"))
    return Modes(**{name: jnp.array(x) for name, x in numbers.items()})


def mode_numbers(
    height: Number,
    stiffness: Number,
    poisson: Number,
    end: tuple[RightEnd, Number] | None = None,
    machine: Number | None = None,
) -> dict[str, Any]:
    """Fields of the `Modes` of one slider, as tuples of single numbers.

    A loop over lanes computes each once. `end` is the right end of a finite chain and its number of sites, `machine` is M/K.

    Notes
    -----
    With a = K_T/K_L, c = K_T/K, q = k/K, μ_m = κ_m², S = μ_1 − μ_2, X = μ_1 − a (a sum of positive terms),
    h_m = √(1 + μ_m/4) and p_m = h_m + κ_m/2:

        r_m = 1/p_m²,    1/α_1 = −a/X,    1/α_2 = X/c,    w_1 = q X/(S · 2κ_1 h_1),    w_2 = q a c/(X S · 2κ_2 h_2).

    Quotients and roots take longest. Each is taken once, and `_root` and `inverse` keep their derivatives to products.
    """
    q, double = stiffness, 2 * (1 + poisson)
    c = inverse(double * height)
    over_height = c * double
    a = c * over_height
    split, over_split = _root((c + q - a) ** 2 + 4 * a * c)
    X = (c + q - a + split) / 2
    over_X, mu1 = inverse(X), a + X
    mu2 = a * q * inverse(mu1)  # the difference of squares would cancel
    (k1, over_k1), (k2, over_k2) = _root(mu1), _root(mu2)
    (h1, over_h1), (h2, over_h2) = _root(1 + mu1 / 4), _root(1 + mu2 / 4)
    p1, p2 = h1 + k1 / 2, h2 + k2 / 2
    over_p1, over_p2 = inverse(p1), inverse(p2)
    r1, r2, g1, g2 = over_p1 * over_p1, over_p2 * over_p2, k1 * over_p1, k2 * over_p2
    w1 = q * X * over_split * (over_k1 * over_h1 / 2)
    w2 = q * a * c * over_X * over_split * (over_k2 * over_h2 / 2)
    U1, U2 = -a * over_X, X * double * height

    # At the left edge, for amplitudes B_m of y_m and a source at j:
    #   u_t[0] = U      :  Σ e_m(0) B_m/α_m = U − Σ w_n/α_n y_n(j)
    #   u[−1] = u[0]    :  Σ slope_m B_m    =     Σ w_n (1 − r_n) y_n(j)
    # and with a machine, u_t[0] + δ (u_t[−1] − u_t[0]) = U with δ = K_L/M, e_m(0) becomes e_m(0) + δ slope_m on the left,
    # 1/α_n becomes (1 − δ (1 − r_n))/α_n on the right
    s1, s2 = k1 * p1, k2 * p2  # (1 − r_m)/r_m
    both = s2 + g2
    e1, e2 = 1, 1
    if end is not None:
        # e_m(0) = 1 + η_m r_m^{2(N−1)}, and the slope (1 − r_m)(1/r_m − η_m r_m^{2(N−1)}): no difference of near equals where a
        # soft chain is stiffer than its contacts, 1 − r_2^{2N} ≪ 1
        right, sites = end[0], jnp.minimum(end[1], FARTHEST)
        from_end = 2 * sites * jnp.log1p(-g1), 2 * sites * jnp.log1p(-g2)  # ln r_m^{2N}
        lost, back = [-jnp.expm1(x) for x in from_end], [jnp.exp(x) for x in from_end]
        if right == "free":
            e1, e2, s1, s2 = 1 + back[0] * p1 * p1, 1 + back[1] * p2 * p2, s1 * lost[0], s2 * lost[1]
        else:
            e1, e2, s1, s2 = *lost, s1 + g1 * back[0], s2 + g2 * back[1]
    determinant, at_edge = e1 * U1 * s2 - e2 * U2 * s1, e1 * s2 - e2 * s1
    back1, back2 = U1 * s2 + g1 * e2 * U2, g2 * e1 * U1 + U2 * s1
    if machine is not None:
        give = height * inverse(machine) * (U2 - U1)
        determinant, back1, back2 = determinant - give * s1 * s2, back1 + give * g1 * s2, back2 - give * g2 * s1
    over_determinant, over_edge = inverse(determinant), inverse(at_edge)
    between = -w2 * U2 * both * over_determinant
    of_end = {} if end is None else {"echo": (r1, r2) if end[0] == "free" else (-r1 * r1, -r2 * r2), "last": end[1] - 1}
    return of_end | {
        "ratio": (r1, r2),
        "gap": (g1, g2),
        "weight": (w1, w2),
        "upper": (U1, U2),
        "reflection": ((-w1 * back1 * over_determinant, between), (between, w2 * back2 * over_determinant)),
        "drive": (s2 * over_edge, -s1 * over_edge),
        "load": determinant * over_edge,
    }


@jax.custom_jvp
def inverse(x: Number) -> Number:
    """1/x, whose derivatives take no further quotient."""
    return 1 / x


@inverse.defjvp
def _(primals: tuple[Number], tangents: tuple[Number]) -> tuple[Number, Number]:  # pyright: ignore[reportUnusedFunction]
    over = inverse(*primals)
    return over, -over * over * tangents[0]


@jax.custom_jvp
def _root(x: Number) -> Pair:
    """√x and 1/√x, as a quotient: XLA's reciprocal root is approximate."""
    root = jnp.sqrt(x)
    return root, root / x


@_root.defjvp
def _(primals: tuple[Number], tangents: tuple[Number]) -> tuple[Pair, Pair]:  # pyright: ignore[reportUnusedFunction]
    root, over = _root(*primals)
    slope = over * tangents[0] / 2
    return (root, over), (slope, -over * over * slope)


@in_full
def equilibrium_fields(
    modes: Modes, load: Array, pinning: Float[Array, " sites"], prestress: Float[Array, " sites"] | None = None
) -> Fields:
    """Fields of a uniform chain in equilibrium (labels discr1, discr2), in O(sites).

    At the load U and with pinning u_b, in u_s; sites beyond those given are pinned at zero. A prestress φ_i, in σ_s, is
    balanced from outside (top shear), and moves nothing by itself. The stress is σ_c = k(u − u_b)/λc² (label cra06) and that.
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
    layer = in_mode.sum(axis=1)
    return Fields(in_mode @ modes.upper, layer, layer - pinning + (0 if prestress is None else prestress))
