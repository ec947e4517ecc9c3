"""The first precursor of a uniform interface in closed form.

Its length is analytic in the parameters.

The stress t(s) that the front meets at contact s extends from whole numbers to real s as a convergent double series
(`slippulse_jax.exact.double_series`, derived in ``docs/appendix/exact_solution.md``). The length ℓ* is its crossing with the
threshold,

    t(ℓ*) = 1 + ε ℓ*,

so that ceil(ℓ*) contacts break. It shares no step but the modes with the ℓ of `slippulse_jax.front.front`, which it is there to
check, and costs the same whatever Λ: the fast way for very tall sliders. It has derivatives of every order, in every mode.

Nothing like it is in the paper. The prestress φ and the threshold slope ε are those of its Discussion: φ = σ_0/σ_s on every
contact, released when it breaks and borne anew by its successor, and σ_s(i) = σ_s0 (1 + ε i). On level thresholds contacts that
repin with the stress r follow from those that repin with none: (t − r)/(1 − r) is their stress under the prestress
(φ − r)/(1 − r), and loads and displacements are over 1 − r (`Interface.equivalent_prestress`).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.base.domains import THRESHOLD_SLOPE, check_domain
from slippulse_jax.base.shown import short
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.bulk.derivatives import by_forward_mode
from slippulse_jax.exact import crack, double_series
from slippulse_jax.exact.crossing import excess, first_crossing, length_of, series_of
from slippulse_jax.interface import Interface, kept_share
from slippulse_jax.rules import CrackLike
from slippulse_jax.slider import Fields, Slider, broadcast, check_endless, of_one_type


class ExactFront(NamedTuple):
    """First precursor by the exact solution; fields have the batch's shape."""

    length: Float[Array, "..."]  # ℓ*, in λc
    contacts_broken: Int[Array, "..."]  # ceil(ℓ*), at least 1; −1 where the length is not finite
    load: Float[Array, "..."]  # displacement of the left edge at nucleation, in u_s
    status: Int[Array, "..."]  # `Outcome`


def exact_length(slider: Slider, interface: Interface | None = None, *, rule: CrackLike | None = None) -> Float[Array, "..."]:
    """Exact length ℓ* of the first precursor, in λc.

    ℓ* is the real crossing t(ℓ*) = 1 + ε ℓ*.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast.
    interface : Interface, optional
        Uniform prestress φ, threshold slope ε and residual strength r, which broadcast with `slider`; relaxed and level by
        default. With ε < 0 the thresholds vanish at i = 1/|ε|: the length is then that of the front that starts at contact 0,
        for chains that end before. The closed form has no `Profile`, and no slope beside a residual strength.
    rule : CrackLike, optional
        Length of the quasi-static crack-like front instead, behind which contacts slide at constant friction, on thresholds
        that are level; its friction broadcasts too (`slippulse_jax.exact.crack`).

    Returns
    -------
    array
        ℓ*, of the common shape. 0 where nothing follows the first contact (there the derivative is zero because the length
        is constant); inf where the front never stops; NaN for traced values outside the domain, or where Newton's
        method did not converge. `exact_front` says which. Derivatives are non-finite wherever the length is.

    Raises
    ------
    TypeError, ValueError
        If `interface` is a `Profile`, or has a slope and a residual strength: use `precursor_length` or `first_precursor`. If a
        crack-like front is to meet thresholds with a slope, or contacts with a residual strength, or its friction lies outside
        [0, 1).

    Notes
    -----
    Relative error ≤ 1e-11 in float64 over H/λc 2–10⁵, k/K 1e-6–1, ν 0–0.5; in float32 1e-3 where ℓ* > 1. ℓ* and the ℓ of
    `precursor_length` have the same ceiling beyond 1, and agree to 1.4e-3 λc from six contacts on, to 1e-9 from a hundred on;
    where two break they differ by up to 0.11 λc. ℓ takes a tenth of the time to compile: ℓ* is evidence, and for tall sliders.
    """
    check_endless("exact_length", slider)
    if rule is None:
        return _each(_length, *broadcast(slider, *_contacts(interface)))
    prestress, threshold_slope = uniform(interface)
    if interface is not None and interface.residual_strength is not None:
        raise ValueError("rule = CrackLike(…): its contacts carry their friction; leave Interface.residual_strength out")
    if not _is_zero(threshold_slope):
        raise ValueError("a crack-like front has a closed form on level thresholds only: interface.threshold_slope must be 0")
    requirement = "must be 0 or more and below the threshold of 1"
    check_domain("CrackLike.friction", rule.friction, lambda x: (x >= 0) & (x < 1), requirement)
    return _each(_crack_length, *of_one_type(slider, rule.friction, prestress))


def _crack_length(*numbers: Array) -> Array:
    return crack.length(Slider(*numbers[:3]), *numbers[3:])[0]


def exact_front(slider: Slider, interface: Interface | None = None) -> ExactFront:
    """Length, contacts broken, load at nucleation and status of the first precursor.

    Parameters as for `exact_length`.

    Notes
    -----
    Each break adds to the stress on contact 0 behind the front, so that the contact is back at its threshold before the front
    stops if, and only if, it carries at least σ_s at the arrest: ``exact_fields(slider, contacts_broken, 0).stress``. The
    status is then `REBREAK`, as in `first_precursor`, and ℓ* the length of the front, not of the event.
    """
    check_endless("exact_front", slider)
    found, lost = ExactFront(*_each(_front, *broadcast(slider, *_contacts(interface)))), 1 - jnp.asarray(kept_share(interface))
    return found._replace(load=lost * found.load)


def exact_front_stress(slider: Slider, s: AnyArrayLike, interface: Interface | None = None) -> Float[Array, "..."]:
    """Stress t(s) on contact s just before it would break, in σ_s.

    All contacts before it have broken; s ≥ 0 is real.

    Parameters
    ----------
    slider : Slider
        Fields that broadcast with `s`.
    s : array_like
        Position of the front in λc. Whole numbers give the stresses of the recursion, past the arrest too. The series is solved
        once per slider, however many positions are asked for.
    interface : Interface, optional
        As for `exact_length`. Its prestress is part of the stress; thresholds decide where the front stops, not what it meets.

    Raises
    ------
    ValueError, TypeError
        If a concrete `s` is negative or not finite; if the closed form does not hold for `interface`.
    """
    check_endless("exact_front_stress", slider)
    check_domain("s", s, lambda x: x >= 0, "must be a front position, ≥ 0, in λc")
    kept = jnp.asarray(kept_share(interface))
    return kept + (1 - kept) * _each(_stress, *of_one_type(slider, *_contacts(interface), s))


def _stress(*arguments: Array) -> Array:
    *theta, s = arguments
    return by_forward_mode(lambda theta, s: double_series.stress(series_of(theta), s)[0])(jnp.stack(theta), s)


def exact_fields(slider: Slider, s: AnyArrayLike, site: AnyArrayLike, interface: Interface | None = None) -> Fields:
    """Displacements and stress at `site` when the front has reached s.

    It has broken contacts 0 … s − 1, and the next has not broken yet.

    Parameters
    ----------
    slider : Slider
    s : array_like
        Whole number ≥ 0 of broken contacts (0: nucleation).
    site : array_like
        Whole number i ≥ 0: behind (i < s) or ahead of the front. `slider`, `s` and `site` broadcast together.
    interface : Interface, optional
        As for `exact_front_stress`. The prestress is part of the stress, not of the displacements, which are counted from the
        state under the prestress alone.

    Raises
    ------
    ValueError, TypeError
        If a concrete `s` or `site` lies outside its domain; if the closed form does not hold for `interface`.

    Notes
    -----
    The stress behind the front is what the later breaks have put back on a contact that repinned, a sum in closed form
    (`slippulse_jax.exact.double_series.fields`).
    """
    check_endless("exact_fields", slider)
    for name, value in (("s", s), ("site", site)):
        check_domain(name, value, lambda x: (x >= 0) & (x == np.round(x)), "must be a whole number of contacts, ≥ 0")
    found = Fields(*_each(_fields, *of_one_type(slider, *_contacts(interface), s, site)))
    kept = jnp.asarray(kept_share(interface))
    return Fields(*((1 - kept) * x for x in found[:2]), stress=kept + (1 - kept) * found.stress)


def _fields(*arguments: Array) -> tuple[Array, Array, Array]:
    @in_full
    def fields(theta: Array, s: Array, site: Array) -> Array:
        modes = lattice_modes(Slider(theta[0], theta[1], theta[2]))
        mode, stress = double_series.fields(series_of(theta), s, site)
        return jnp.stack([modes.upper @ mode, mode.sum(), stress])

    *theta, s, site = arguments
    upper, layer, stress = by_forward_mode(fields)(jnp.stack(theta), s, site)
    return upper, layer, stress


def uniform(interface: Interface | None) -> tuple[AnyArrayLike, AnyArrayLike]:
    """Return prestress and threshold slope of a uniform interface.

    Of contacts that keep something, the prestress of those that keep nothing and whose front runs as far. A TypeError, if it is
    a profile, and a ValueError, if it has a slope too, name the function to use instead.
    """
    if interface is None:
        return 0.0, 0.0
    if not isinstance(interface, Interface):
        raise TypeError(
            f"interface = {type(interface).__name__}(…): the closed form holds for an Interface, whose prestress is uniform; "
            "use precursor_length or first_precursor"
        )
    slope, kept = interface.threshold_slope, interface.residual_strength
    prestress = interface.prestress if kept is None else interface.equivalent_prestress
    if isinstance(prestress, Tracer):  # which may be any number below 1 where contacts keep something
        prestress = jnp.where(interface.in_domain(), prestress, jnp.nan)
    if kept is None:
        return prestress, slope
    if isinstance(slope, Tracer) or np.any(np.asarray(slope) != 0):
        raise ValueError(
            f"Interface.threshold_slope = {short(slope)} beside residual_strength: the closed form has one of the two; "
            "use precursor_length or first_precursor"
        )
    return prestress, 0.0


def _contacts(interface: Interface | None) -> tuple[AnyArrayLike, ...]:
    """Return φ and ε; nothing where both are left at zero.

    Compiled code then leaves them out.
    """
    numbers = uniform(interface)
    return () if all(map(_is_zero, numbers)) else numbers


def _is_zero(value: Any) -> bool:
    """Whether the caller left `value` at zero."""
    return not isinstance(value, jax.Array) and np.ndim(value) == 0 and value == 0


@partial(jax.jit, static_argnums=0)
def _each(function: Any, *arguments: Array) -> Any:
    """Map a `function` of scalars over arguments that broadcast.

    It is compiled once for each function and set of shapes. Quantities that depend on some of the arguments only, as the
    series does on the slider, are computed once for those: `jnp.vectorize` maps only the axes that an argument has.
    """
    return jnp.vectorize(function)(*arguments)


def _length(*theta: Array) -> Array:
    return by_forward_mode(lambda x: crossing_of(x)[0])(jnp.stack(theta))


def _front(*theta: Array) -> tuple[Array, Array, Array, Array]:
    both = by_forward_mode(lambda x: jnp.stack(crossing_of(x, rebreaks=True)))(jnp.stack(theta))
    length, status = both[0], both[1].astype(jnp.int32)
    load = lattice_modes(Slider(*theta[:3])).load
    if len(theta) > 3:
        load = (1 - theta[3]) * load
    finite = jnp.isfinite(length)
    count = jnp.where(finite, double_series.whole_contacts(jnp.where(finite, length, 0)), -1).astype(jnp.int32)
    return length, count, jnp.where(status == Outcome.INVALID, jnp.nan, load), status


def crossing_of(theta: Float[Array, " n"], *, rebreaks: bool = False) -> tuple[Array, Array]:
    """Find ℓ* and status, with forward derivatives of the implicit function.

    dℓ* = −d(t − 1 − εs)/(t' − ε), d at fixed s. `REBREAK` is told from `ARRESTED` with `rebreaks` only, since that takes one
    more sum.
    """

    @jax.custom_jvp
    def crossed(theta: Array) -> tuple[Array, Array]:
        found = series_of(theta)
        length, status = first_crossing(found, theta)
        valid = Slider(theta[0], theta[1], theta[2]).in_domain()
        if len(theta) > 3:
            valid = valid & (theta[3] < 1) & THRESHOLD_SLOPE.holds(theta[4])
        status = jnp.where(valid, status, Outcome.INVALID)
        length = length_of(length, status)
        if rebreaks:
            arrested = status == Outcome.ARRESTED
            edge = double_series.edge_stress(found, double_series.whole_contacts(jnp.where(arrested, length, 1)))
            status = jnp.where(arrested & (edge >= 1), Outcome.REBREAK, status).astype(status.dtype)
        return length, status

    @crossed.defjvp
    def _rule(primals: Any, tangents: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        # through `crossed` itself, so that the rule can be differentiated again
        length, status = crossed(*primals)
        arrested = (status == Outcome.ARRESTED) | (status == Outcome.REBREAK)
        at = jnp.where(arrested, length, 1)
        (_, slope), (change, _) = jax.jvp(lambda x: excess(series_of(x), x, at), primals, tangents)
        # a constant where nothing follows contact 0; never a number where there is no length
        elsewhere = jnp.where(status == Outcome.NO_DOMINO, 0, jnp.nan)
        return (length, status), (jnp.where(arrested, -1 / slope, elsewhere) * change, jnp.zeros_like(status))

    return crossed(theta)
