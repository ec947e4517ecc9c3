"""The interface of a slider: prestress and thresholds, and what contacts keep.

The paper's own interface is relaxed and uniform, and its contacts lose everything when they break. Its Discussion asks how the
first precursor changes with each; the fast recursion treats all exactly. A delay before contacts repin is an argument of
`rupture` and `series`.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.base.domains import PRESTRESS, RESIDUAL_STRENGTH, THRESHOLD, THRESHOLD_SLOPE, check_domain
from slippulse_jax.base.shown import in_a_line
from slippulse_jax.base.units import Numbers, as_float, quantity_field


def check_bulk(interface: "Interface | None") -> None:
    """Check that the numbers of `interface` broadcast with a slider's.

    Those of a `Profile` do not. A TypeError names the functions that take a profile.
    """
    if interface is not None and not isinstance(interface, Interface):
        raise TypeError(
            f"interface = {type(interface).__name__}(…): must be an Interface, whose numbers broadcast with the slider's; "
            "for the Profile of one slider use precursor_length or first_precursor"
        )


class Interface(eqx.Module):
    """Contacts with uniform prestress and linearly varying thresholds.

    Parameters
    ----------
    prestress : array_like
        φ = σ_0/σ_s, the stress every contact carries before the left edge is pushed (top shear), in σ_s; in (−1, 1),
        negative where the top is sheared against the push.
    threshold_slope : array_like
        ε > −1, the rise of the threshold from site to site: θ_i = 1 + ε i, in σ_s. With ε < 0 the interface ends where the
        threshold has fallen to the prestress, or to zero: a front that gets there runs away (inf).
    residual_strength : array_like, optional
        r in [0, 1): a contact that breaks repins with the stress rθ, and releases what it carried beyond. By default it repins
        with none, as in the paper, and there is no derivative in r.

    Raises
    ------
    ValueError
        If a value lies outside its domain, naming it.

    Notes
    -----
    The numbers broadcast with the fields of a `Slider`.
    """

    prestress: Float[AnyArrayLike, "..."] = quantity_field(
        "\\varphi", "\\sigma_s", name="prestress of the contacts", default=0.0
    )
    threshold_slope: Float[AnyArrayLike, "..."] = quantity_field(
        "\\epsilon", "\\sigma_s", name="threshold gradient", default=0.0
    )
    residual_strength: Float[AnyArrayLike, "..."] | None = quantity_field(
        "r", "1", name="residual strength of the contacts", default=None
    )

    def __init__(
        self, prestress: Numbers = 0.0, threshold_slope: Numbers = 0.0, residual_strength: Numbers | None = None
    ) -> None:
        self.prestress = as_float("Interface.prestress", prestress)
        self.threshold_slope = as_float("Interface.threshold_slope", threshold_slope)
        self.residual_strength = _or_none("Interface.residual_strength", residual_strength)

    def __repr__(self) -> str:
        return in_a_line(self)

    def __check_init__(self) -> None:
        PRESTRESS.check("Interface.prestress", self.prestress)
        THRESHOLD_SLOPE.check("Interface.threshold_slope", self.threshold_slope)
        RESIDUAL_STRENGTH.check("Interface.residual_strength", kept_share(self))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the batch; () for one interface."""
        return np.broadcast_shapes(*(np.shape(x) for x in (self.prestress, self.threshold_slope, kept_share(self))))

    def in_domain(self) -> Array:
        """Whether the values, traced ones too, lie in their domains."""
        inside = PRESTRESS.holds(jnp.asarray(self.prestress)) & THRESHOLD_SLOPE.holds(jnp.asarray(self.threshold_slope))
        return inside & RESIDUAL_STRENGTH.holds(jnp.asarray(kept_share(self)))

    @property
    def equivalent_prestress(self) -> Any:
        """(φ − r)/(1 − r), below 1; φ where contacts keep nothing.

        On level thresholds a front of contacts that keep nothing, under this prestress, runs as far: (t − rθ)/(1 − r) obeys the
        rule of r = 0.
        """
        kept = kept_share(self)
        return (self.prestress - kept) / (1 - kept)

    def threshold_at(self, site: Array) -> Array:
        """θ_i, in σ_s."""
        return 1 + jnp.asarray(self.threshold_slope) * site

    def prestress_at(self, site: Array) -> Array:
        """φ_i, in σ_s."""
        return jnp.asarray(self.prestress) + 0.0 * site

    def last_site(self) -> Array:
        """Site beyond which no contact holds; inf if none.

        The threshold has fallen there to the prestress, or to zero.
        """
        falling = jnp.asarray(self.threshold_slope) < 0
        fall = jnp.where(falling, -jnp.asarray(self.threshold_slope), 1)
        return jnp.where(falling, (1 - jnp.maximum(self.prestress, 0)) / fall, jnp.inf)


class Profile(eqx.Module):
    """Contacts whose thresholds and prestress are given per site.

    Parameters
    ----------
    threshold : array_like, shape (n,)
        θ_i > 0, in σ_s; the last value holds for all sites beyond.
    prestress : array_like, shape () or (n,)
        φ_i, in σ_s; likewise. In (−θ_i, θ_i): beyond, a contact would break before the slider is pushed.
    residual_strength : float, optional
        As for `Interface`; one number of all contacts.

    Raises
    ------
    ValueError
        If a shape does not fit or a value lies outside its domain, naming it. Values traced by JAX are not checked:
        lengths computed from invalid ones are NaN.

    Notes
    -----
    The fast recursion takes a profile as it takes an `Interface`, for one slider. It follows the domino from the left edge.
    Where a contact far ahead is overloaded first, or one behind the front breaks again, use `slippulse_jax.rupture` of a
    `slippulse_jax.chain` with the same profile.
    """

    threshold: Float[AnyArrayLike, " n"] = quantity_field("\\theta_i", "\\sigma_s")
    prestress: Float[AnyArrayLike, "..."] = quantity_field("\\varphi_i", "\\sigma_s", default=0.0)
    residual_strength: Float[AnyArrayLike, ""] | None = quantity_field("r", "1", default=None)

    def __init__(self, threshold: Numbers, prestress: Numbers = 0.0, residual_strength: Numbers | None = None) -> None:
        self.threshold, self.prestress = as_float("Profile.threshold", threshold), as_float("Profile.prestress", prestress)
        self.residual_strength = _or_none("Profile.residual_strength", residual_strength)

    def __check_init__(self) -> None:
        if np.shape(kept_share(self)):
            raise ValueError(f"Profile.residual_strength has shape {np.shape(kept_share(self))}: must be one number")
        RESIDUAL_STRENGTH.check("Profile.residual_strength", kept_share(self))
        if np.ndim(self.threshold) != 1 or np.size(self.threshold) == 0:
            raise ValueError(f"Profile.threshold has shape {np.shape(self.threshold)}: must be (n,), with at least one value")
        if np.shape(self.prestress) not in ((), np.shape(self.threshold)):
            raise ValueError(
                f"Profile.prestress has shape {np.shape(self.prestress)}: must be () or {np.shape(self.threshold)}"
            )
        THRESHOLD.check("Profile.threshold", self.threshold)
        if not isinstance(self.prestress, Tracer) and not isinstance(self.threshold, Tracer):
            carried, most = np.broadcast_arrays(np.asarray(self.prestress, dtype=float), np.asarray(self.threshold))
            requirement = "must lie within the threshold of its contact, in σ_s"
            check_domain("Profile.prestress", carried, lambda x: abs(x) < most, requirement)

    @property
    def shape(self) -> tuple[int, ...]:
        """One interface: ()."""
        return ()

    def in_domain(self) -> Array:
        """Whether the values, traced ones too, lie in their domains."""
        threshold, kept = jnp.asarray(self.threshold), jnp.asarray(kept_share(self))
        inside = THRESHOLD.holds(threshold) & (jnp.abs(jnp.asarray(self.prestress)) < threshold)
        return inside.all() & RESIDUAL_STRENGTH.holds(kept)

    def _at(self, values: Any, site: Array) -> Array:
        values = jnp.asarray(values)
        if values.ndim == 0:
            return values + 0.0 * site
        return values[jnp.clip(jnp.asarray(site).astype(jnp.int32), 0, values.shape[0] - 1)]

    def threshold_at(self, site: Array) -> Array:
        """θ_i, in σ_s."""
        return self._at(self.threshold, site)

    def prestress_at(self, site: Array) -> Array:
        """φ_i, in σ_s."""
        return self._at(self.prestress, site)

    def last_site(self) -> Array:
        """None (inf): the last values hold for all sites beyond."""
        return jnp.asarray(jnp.inf)


AnyInterface = Interface | Profile | None
"""Contacts by thresholds, prestress and what they keep; None for the paper's own, relaxed and uniform."""


def kept_share(contacts: AnyInterface) -> Any:
    """Share r of its threshold that a contact keeps; 0 by default."""
    kept = None if contacts is None else contacts.residual_strength
    return 0.0 if kept is None else kept


def _or_none(name: str, x: Any) -> Any:
    return None if x is None else as_float(name, x)
