"""The interface: what loads, holds and re-forms the contacts of a uniform slider.

The paper's own interface is relaxed, uniform and repins at once; its Discussion asks what each of the three does to the
first precursor. All three are exact in the fast recursion (`slippulse_jax.lattice.interface_front`).
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.quantities import as_float, quantity_field


class Interface(eqx.Module):
    """Contacts with a uniform prestress, thresholds that vary linearly along the interface, and a delay in repinning.

    Parameters
    ----------
    prestress : array_like
        φ = σ_0/σ_s, the stress every contact carries before the left edge is pushed (top shear), in σ_s; in [0, 1).
    threshold_slope : array_like
        ε, by which thresholds rise from site to site: θ_i = 1 + ε i, in σ_s. With ε < 0 the interface ends where the
        threshold is down to the prestress: a front that gets there is running away (inf).
    repin_delay : int
        n, how many sites a broken contact stays detached for: contact i repins, at zero stretch, when contact i + n
        breaks. 0 is the paper's immediate repinning.

    Raises
    ------
    ValueError
        If a value lies outside its domain, naming it.

    Notes
    -----
    `prestress` and `threshold_slope` broadcast with the fields of a `Slider`.
    """

    prestress: Float[AnyArrayLike, "..."] = quantity_field("\\varphi", "\\sigma_s", default=0.0, converter=as_float)
    threshold_slope: Float[AnyArrayLike, "..."] = quantity_field("\\epsilon", "\\sigma_s", default=0.0, converter=as_float)
    repin_delay: int = eqx.field(default=0, static=True)

    def __check_init__(self) -> None:
        if isinstance(self.repin_delay, bool) or not isinstance(self.repin_delay, int) or self.repin_delay < 0:
            raise ValueError(f"Interface.repin_delay = {self.repin_delay!r}: must be a whole number of sites, 0 or more")
        if not isinstance(self.prestress, Tracer):
            bad = ~((np.asarray(self.prestress) >= 0) & (np.asarray(self.prestress) < 1))
            if bad.any():
                value = np.asarray(self.prestress)[bad].flat[0]
                raise ValueError(f"Interface.prestress = {value:g}: must lie in [0, 1), in σ_s")
        if not isinstance(self.threshold_slope, Tracer) and not np.isfinite(np.asarray(self.threshold_slope)).all():
            raise ValueError(f"Interface.threshold_slope = {self.threshold_slope}: must be finite, in σ_s per site")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the batch; () for one interface."""
        return np.broadcast_shapes(np.shape(self.prestress), np.shape(self.threshold_slope))

    def threshold_at(self, site: Array) -> Array:
        """θ_i, in σ_s."""
        return 1 + jnp.asarray(self.threshold_slope) * site

    def prestress_at(self, site: Array) -> Array:
        """φ_i, in σ_s."""
        return jnp.asarray(self.prestress) + 0.0 * site

    def last_site(self) -> Array:
        """First site whose threshold is no more than its prestress, so that it cannot hold; inf if there is none."""
        falling = jnp.asarray(self.threshold_slope) < 0
        fall = jnp.where(falling, -jnp.asarray(self.threshold_slope), 1)
        return jnp.where(falling, (1 - jnp.asarray(self.prestress)) / fall, jnp.inf)


class Profile(eqx.Module):
    """Contacts whose thresholds and prestress are given site by site.

    Parameters
    ----------
    threshold : array_like, shape (n,)
        θ_i > 0, in σ_s; the last value holds for all sites beyond.
    prestress : array_like, shape () or (n,)
        φ_i, in σ_s; likewise. At the first site below its threshold.
    repin_delay : int
        As for `Interface`.

    Notes
    -----
    The fast recursion takes a profile as it takes an `Interface`, for one slider. It follows the domino from the left edge:
    where a contact further on is overloaded before its neighbours, or one behind the front breaks again, the general
    cascade (`slippulse_jax.rupture` of a `slippulse_jax.chain` with the same profile) is the judge.
    """

    threshold: Float[AnyArrayLike, " n"] = quantity_field("\\theta_i", "\\sigma_s", converter=as_float)
    prestress: Float[AnyArrayLike, "..."] = quantity_field("\\varphi_i", "\\sigma_s", default=0.0, converter=as_float)
    repin_delay: int = eqx.field(default=0, static=True)

    def __check_init__(self) -> None:
        if np.ndim(self.threshold) != 1:
            raise ValueError(f"Profile.threshold has shape {np.shape(self.threshold)}: must be (n,)")
        if np.shape(self.prestress) not in ((), np.shape(self.threshold)):
            raise ValueError(
                f"Profile.prestress has shape {np.shape(self.prestress)}: must be () or {np.shape(self.threshold)}"
            )
        if self.repin_delay < 0:
            raise ValueError(f"Profile.repin_delay = {self.repin_delay}: must be 0 or more")
        if not isinstance(self.threshold, Tracer) and not (np.asarray(self.threshold) > 0).all():
            raise ValueError("Profile.threshold: every value must be positive, in σ_s")

    @property
    def shape(self) -> tuple[int, ...]:
        """One interface: ()."""
        return ()

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
        """There is none: the last values hold for ever."""
        return jnp.asarray(jnp.inf)
