"""The interface of a slider: prestress and thresholds of its contacts.

The paper's own interface is relaxed and uniform. Its Discussion asks how each of the two changes the first precursor; the fast
recursion treats both exactly. A delay before contacts repin is an argument of `rupture` and `series`.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.base.domains import PRESTRESS, THRESHOLD, THRESHOLD_SLOPE, check_domain
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

    Raises
    ------
    ValueError
        If a value lies outside its domain, naming it.

    Notes
    -----
    `prestress` and `threshold_slope` broadcast with the fields of a `Slider`.
    """

    prestress: Float[AnyArrayLike, "..."] = quantity_field(
        "\\varphi", "\\sigma_s", name="prestress of the contacts", default=0.0
    )
    threshold_slope: Float[AnyArrayLike, "..."] = quantity_field(
        "\\epsilon", "\\sigma_s", name="threshold gradient", default=0.0
    )

    def __init__(self, prestress: Numbers = 0.0, threshold_slope: Numbers = 0.0) -> None:
        self.prestress = as_float("Interface.prestress", prestress)
        self.threshold_slope = as_float("Interface.threshold_slope", threshold_slope)

    def __repr__(self) -> str:
        return in_a_line(self)

    def __check_init__(self) -> None:
        PRESTRESS.check("Interface.prestress", self.prestress)
        THRESHOLD_SLOPE.check("Interface.threshold_slope", self.threshold_slope)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the batch; () for one interface."""
        return np.broadcast_shapes(np.shape(self.prestress), np.shape(self.threshold_slope))

    def in_domain(self) -> Array:
        """Whether the values, traced ones too, lie in their domains."""
        return PRESTRESS.holds(jnp.asarray(self.prestress)) & THRESHOLD_SLOPE.holds(jnp.asarray(self.threshold_slope))

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

    def __init__(self, threshold: Numbers, prestress: Numbers = 0.0) -> None:
        self.threshold, self.prestress = as_float("Profile.threshold", threshold), as_float("Profile.prestress", prestress)

    def __check_init__(self) -> None:
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
        threshold = jnp.asarray(self.threshold)
        return (THRESHOLD.holds(threshold) & (jnp.abs(jnp.asarray(self.prestress)) < threshold)).all()

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
"""Thresholds and prestress of the contacts; None for the paper's own, relaxed and uniform."""
