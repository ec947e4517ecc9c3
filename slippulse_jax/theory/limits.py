"""Limits and closed forms of lengths and stresses.

Run-away prestress, macroscopic law, edge behind a front, envelope, decay along a block. Derivations in
``docs/appendix/theory.md``. Lengths in λc unless said otherwise.
"""

import functools
import operator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from slippulse_jax.base.domains import POISSON, PRESTRESS, RESIDUAL_STRENGTH, Domain, real_numbers
from slippulse_jax.base.units import as_float
from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.bulk.derivatives import root_between
from slippulse_jax.exact.double_series import exponential_terms, overlap
from slippulse_jax.slider import Slider, each_slider

_DOMAIN = {
    "b": Domain(0, np.inf, "must be positive: areal stiffness times height over shear modulus"),
    "poisson": POISSON,
    "prestress": PRESTRESS,
    "residual_strength": RESIDUAL_STRENGTH,
}

NO_CHANGE = -1
"""Status of `find_root` where both ends have the same sign."""

EDGE_TERMS = 16
"""Terms of the edge stress: each is at most λ/2n ≤ 1/4n of the one before, and the first one left out below 1e-20."""


def runaway_prestress(slider: Slider, residual_strength: Any = 0.0) -> Float[Array, "..."]:
    """φ_c = (1 + G_00)/2, the prestress from which fronts run away.

    With σ_0/σ_s ≥ φ_c the stress far from the edge settles at φ/φ_c ≥ 1, and nothing stops the front. G_00 = Σ_m q
    share_m/(κ_m √(4 + κ_m²)) is the response of an endless lattice to its own pinning point. A soft interface whose domino
    dies beside the edge never reaches that far stress: there φ ≥ φ_c is necessary, not sufficient (`slippulse_jax.exact_front`
    decides). Contacts that keep a share r of their strength (`residual_strength`, in [0, 1)) run away from r + (1 − r) φ_c on.
    """
    RESIDUAL_STRENGTH.check("residual_strength", residual_strength)
    (kept,) = _numbers(residual_strength=residual_strength)
    return jnp.where(RESIDUAL_STRENGTH.holds(kept), kept + (1 - kept) * _runaway(slider), jnp.nan)


@jax.jit
def _runaway(slider: Slider) -> Array:
    def one(slider: Slider) -> Array:
        k = jnp.stack([slider.kappa_1, slider.kappa_2])
        share = jnp.stack([-slider.alpha_1, slider.alpha_2]) * slider.kappa_T**2 / slider.mode_splitting
        return (1 + (jnp.asarray(slider.stiffness) * share / (k * jnp.sqrt(4 + k**2))).sum()) / 2

    return each_slider(one, slider)


def _numbers(**given: Any) -> list[Array]:
    """Arguments as JAX's numbers."""
    return [jnp.asarray(as_float(name, x), dtype=float) for name, x in given.items()]


def length_ceiling(poisson: Any) -> Float[Array, "..."]:
    """Largest Λ/H of the macroscopic law, √(2(1+ν)) ln 2 (b → ∞)."""
    (nu,) = _numbers(poisson=poisson)
    return jnp.sqrt(2 * (1 + nu)) * np.log(2)


def macroscopic_length(b: Any, poisson: Any, *, prestress: Any = 0.0, residual_strength: Any = 0.0) -> Float[Array, "..."]:
    """Λ/H for λc → 0 at fixed b.

    Self-consistent in the upper layer.

    Parameters
    ----------
    b : array_like
        Areal shear stiffness of the interface times H over the shear modulus; > 0.
    poisson : array_like
        ν.
    prestress : array_like
        φ = σ_0/σ_s in (−1, 1). inf for φ ≥ ½, the macroscopic run-away threshold; of contacts that keep something, for
        φ ≥ (1 + r)/2.
    residual_strength : array_like
        r in [0, 1), what contacts keep of their strength: the length is that of φ' = (φ − r)/(1 − r).

    Raises
    ------
    ValueError
        If a value lies outside its domain; of one traced by JAX, which cannot be looked at, the length is NaN.

    Notes
    -----
    Composes with ``jit``, ``vmap`` and derivatives of every order; a length that is not finite has no finite derivative.

    With z = κ_2Λ, p(z) = [z + (β/2)(1 − e^{−2z})]/(1 + β) and κ_2⁻¹ = H √(2(1+ν)(1+1/b)):

        e^{−p(z)} [1 + φ ∫_0^z e^{p(y)} dy] = (1 + β)/2;     without prestress  p(z) = ln[2/(1 + β)].
    """
    given = dict(zip(_DOMAIN, (b, poisson, prestress, residual_strength), strict=True))
    for name, value in given.items():
        _DOMAIN[name].check(name, value)
    numbers = _numbers(**given)
    inside = functools.reduce(operator.and_, (domain.holds(x) for domain, x in zip(_DOMAIN.values(), numbers, strict=True)))
    b, nu, phi, kept = jnp.broadcast_arrays(*numbers)
    return _macroscopic(b, nu, (phi - kept) / (1 - kept) * jnp.where(inside, 1, jnp.nan))  # so that its slope is NaN too


@jax.jit
def _macroscopic(b: Array, nu: Array, phi: Array) -> Array:
    def one(b: Array, nu: Array, phi: Array) -> Array:
        beta, released = 1 / (1 + b), b / (1 + b)

        def excess(p: tuple[Array, Array, Array], z: Array) -> Array:
            """(1 + β)(t − 1)/2 from ln t, which keeps small b."""
            beta, released, phi = p
            fall = (z - beta / 2 * jnp.expm1(-2 * z)) / (1 + beta)
            drive = jnp.expm1(jnp.log1p(released / (1 + beta)) - fall)
            return (1 + beta) / 2 * drive + phi * _held(beta, z)

        plateau = 2 * phi
        far = jnp.log(4 / jnp.maximum(1 - plateau, 1e-12)) * (1 + beta) + 2
        z = root_between(excess, (beta, released, phi), jnp.zeros_like(b), far)
        # beyond, inf by a function without a finite derivative; before, one that reverse mode can multiply by zero
        z = jnp.where(plateau < 1, z, -jnp.log(jnp.maximum(1 - plateau, 0)))
        return z * jnp.sqrt(2 * (1 + nu) / released) * jnp.where(jnp.isnan(phi), jnp.nan, 1)

    return jnp.vectorize(one)(b, nu, phi)


@in_full
def _held(beta: Array, z: Array) -> Array:
    """e^{−p(z)} ∫_0^z e^{p(y)} dy, the factor e^{−g e^{−2y}} expanded (g ≤ 1/4)."""
    g = beta / (2 * (1 + beta))
    terms = exponential_terms(-g)
    rates = 2 * jnp.arange(terms.size, dtype=z.dtype)
    return terms @ overlap(1 / (1 + beta), rates, z) * jnp.exp(g * jnp.exp(-2 * z))


def macroscopic_crack_length(b: Any, poisson: Any, friction: Any) -> Float[Array, "..."]:
    """ℓ/H of the crack-like first precursor for λc → 0.

    At fixed b, without prestress; NaN outside the domain.

    Parameters
    ----------
    b : array_like
        As for `macroscopic_length`.
    poisson : array_like
        ν.
    friction : array_like
        σ_k of the contacts that slide behind the tip, in σ_s; in [0, 1).

    Notes
    -----
    The upper layer is held at u_t = 1/β and bends under the friction as far as the tip; there the layer hands on half of a
    step, as in a pulse, so that u_t = V = [1 + σ_k (1 − √β)/√β]/√β where the contact carries its threshold. With z = κ_2ℓ:

        (σ_k/2β) z² + V (1 + z) = 1/β;    without friction  z = √(1 + b) − 1,  which has no ceiling.
    """
    b, nu, friction = jnp.broadcast_arrays(*_numbers(b=b, poisson=poisson, friction=friction))
    beta = 1 / (1 + b)
    root, step = jnp.sqrt(beta), -jnp.expm1(-jnp.log1p(b) / 2)  # √β and 1 − √β
    V = (1 + friction * step / root) / root
    excess = (1 - friction) * step / beta  # 1/β − V
    z = 2 * excess / (V + jnp.sqrt(V**2 + 2 * friction / beta * excess))
    inside = (b > 0) & POISSON.holds(nu) & (friction >= 0) & (friction < 1)
    return jnp.where(inside, z * jnp.sqrt(2 * (1 + nu) * (1 + b) / b), jnp.nan)


def macroscopic_correction(b: Any, poisson: Any) -> Float[Array, "..."]:
    """Coefficient c of the first correction to `macroscopic_length`.

    Λ/H = `macroscopic_length` + c (H/λc)^{−1/2} + O(λc/H), at fixed b, without prestress. With g(z) = (1 + βe^{−2z})/(1 + β)
    at z = κ_2Λ, two effects of the same order: the layer at the edge and the gradient of the stress, both of order κ_2/κ =
    √(β(1−β)λc/H), and discreteness, of order λcκ = √((1+b)λc/(2(1+ν)H)):

        g δz = (κ_2/κ) [1 + (1−β)g/(1+β) + β(1−β)/(1+β)² ∫_0^z (1 − e^{−2y}) g dy]
               − λcκ (1−β)/2(1+β) [1 + β/(1+β) (z − (1 − e^{−2z})/2)].
    """
    b, nu = jnp.broadcast_arrays(*_numbers(b=b, poisson=poisson))
    beta, released = 1 / (1 + b), b / (1 + b)
    unit = jnp.sqrt(2 * (1 + nu) / released)  # 1/(κ_2 H)
    z = macroscopic_length(b, nu) / unit
    once, twice = -jnp.expm1(-2 * z) / 2, -jnp.expm1(-4 * z) / 4  # ∫e^{−2y}, ∫e^{−4y}
    g = (1 + beta * jnp.exp(-2 * z)) / (1 + beta)
    integral = (z - (1 - beta) * once - beta * twice) / (1 + beta)
    layer = 1 + released / (1 + beta) * g + beta * released / (1 + beta) ** 2 * integral
    discrete = released / (2 * (1 + beta)) * (1 + beta / (1 + beta) * (z - once))
    return (jnp.sqrt(beta * released) * layer - jnp.sqrt((1 + b) / (2 * (1 + nu))) * discrete) * unit / g


def macroscopic_edge_stress(b: Any) -> Float[Array, "..."]:
    """Stress on contact 0 behind a front (λc → 0), in σ_s.

    At fixed b, of contacts that keep nothing; E becomes r + (1 − r) E of those that keep r. Neither ν nor a uniform prestress
    enters.

    Parameters
    ----------
    b : array_like
        Areal shear stiffness of the interface times H over the shear modulus; > 0.

    Notes
    -----
    Within a few 1/κ of the edge the slow mode is level, and the front stress obeys, with y = κs and λ = (1 − β)/2,

        dT/dy = 1 − T (1 − λ − λ e^{−2y}),     T(0) = 1,

    while contact 0, repinned, carries E = 2λ ∫_0^∞ T e^{−y} dy once the front is far away. The moments M_k = ∫ T e^{−ky} dy
    obey (k + 1 − λ) M_k = 1 + 1/k + λ M_{k+2}, so that

        E = 2λ M_1 = 2 Σ_n λ^{n+1} (2n + 2)/(2n + 1) / Π_{j≤n} (2j + 2 − λ),     λ = b/2(1 + b).
    """
    (b,) = _numbers(b=b)
    share, total = b / (2 * (1 + b)), jnp.zeros_like(b)
    for n in range(EDGE_TERMS - 1, -1, -1):  # by Horner's rule
        total = share / (2 * n + 2 - share) * ((2 * n + 2) / (2 * n + 1) + total)
    return 2 * total


def rebreaking_b() -> float:
    """b* = 3.0872…, beyond which contact 0 breaks again (λc → 0).

    It does so before the front stops. The root of `macroscopic_edge_stress` = 1; `slippulse_jax.rebreaking_onset` gives it for
    any H/λc.
    """
    return 3.087225261382635  # a number, because each report of a fit names it; a test holds it to the last digits


def block_decay_length(b: ArrayLike, poisson: ArrayLike) -> Float[np.ndarray, "..."]:
    """Decay length of an edge load along a block, over H.

    Under two-dimensional elasticity, in plane stress. It is 1/ζ, of the smallest root of b[4 − (1+ν)²ζ² − (3−ν)(1+ν) sin²ζ] =
    4(1+ν)ζ(sin ζ cos ζ + ζ): the slowest mode of a strip without normal displacement at its lower edge, free at its upper one.
    At least 1/π.
    """
    from scipy.optimize.elementwise import find_root  # here, because it takes half a second, and most fits have no block

    def excess(zeta: np.ndarray, b: np.ndarray, nu: np.ndarray) -> np.ndarray:
        sine = np.sin(zeta)
        held = b * (4 - (1 + nu) ** 2 * zeta**2 - (3 - nu) * (1 + nu) * sine**2)
        return held - 4 * (1 + nu) * zeta * (sine * np.cos(zeta) + zeta)

    found = find_root(excess, (0.0, np.pi), args=(real_numbers("b", b), real_numbers("poisson", poisson)))
    return 1 / np.where(found.status == NO_CHANGE, np.pi, found.x)


@jax.jit
def envelope_length(slider: Slider) -> Float[Array, "..."]:
    """A closed formula for Λ.

    Within max(0.4 λc, 1.6 %) of the exact length over H/λc 5–10⁵, k/K 1e-6–1, ν 0–0.5.

    Notes
    -----
    With B = β + (1−β)κ/√(4+κ²), L = ln[2/(1+B)] and c = 1.93 − 0.83β,

        P = (κ/κ_2) {L + β [L − ½ + (1+B)²/8] / [1 + B − β + β(1+B)²/4]},
        Λ ≈ κ⁻¹ {P + c [1 − (1 + 1.15 P/c)⁻²]} − 0.29 − 0.12 β.

    P is the macroscopic law with the lattice's response and one step of Newton's method in place of its solution; c is the
    layer at the edge (2 → 1 from stiff to soft, exactly) as it fades for soft interfaces. The other numbers are fitted.
    Never negative.
    """

    def one(slider: Slider) -> Array:
        k, k2, beta = slider.kappa, slider.kappa_2, slider.beta
        released = slider.b * beta
        lattice = released * k / jnp.sqrt(4 + k**2)
        B = beta + lattice
        # 2/(1+B) = 1 + (1−B)/(1+B), and 1 − B = (1−β)(1 − κ/√(4+κ²))
        L = jnp.log1p((released - lattice) / (1 + B))
        P = k / k2 * (L + beta * (L + jnp.expm1(-2 * L) / 2) / (1 + lattice + beta * jnp.exp(-2 * L)))
        c = 1.93 - 0.83 * beta
        return jnp.maximum((P + c * (1 - (1 + 1.15 * P / c) ** -2)) / k - 0.29 - 0.12 * beta, 0)

    return each_slider(one, slider)
