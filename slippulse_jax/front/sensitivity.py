"""Derivatives of the length in threshold and prestress of every contact.

By reverse mode through a front that runs past its arrest.
"""

from functools import partial
from types import NoneType
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slippulse_jax.base.domains import check_kind, check_single, check_whole
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.front.front import contact_at, kept_at, length_of_run, run_over
from slippulse_jax.interface import AnyInterface, Interface, Profile, kept_share
from slippulse_jax.rules import BreakRule, check_rule
from slippulse_jax.slider import Slider, check_endless


class Sensitivity(NamedTuple):
    """Length of a first precursor, and what each contact does to it."""

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
    rule: BreakRule | None = None,
) -> Sensitivity:
    """Length of the first precursor, and its derivative in every contact.

    The interface is semi-infinite.

    Parameters
    ----------
    slider : Slider
        One slider (fields of shape ()).
    interface : Interface or Profile, optional
        Thresholds and prestress; relaxed and uniform by default. The first is loaded to θ_0.
    sites : int
        Number of contacts; more than the length, and for a smooth rule as many as the front takes to fade.
    rule : BreakRule, optional

    Notes
    -----
    The length is that of a `Profile`, on a straight line between two contacts. Under the paper's rule the threshold of a
    contact the front has passed has no effect: it breaks, whatever that is. Only the last contact broken and the one that
    stops the front have a dℓ/dθ, and contact 0, whose threshold sets the load; a smooth rule spreads it over contacts near
    theirs. The prestress of every contact matters, since it is released. Composes with ``jit`` and ``vmap``.

    Raises
    ------
    ValueError
        If slider or interface is a batch.
    """
    check_endless("sensitivity", slider)
    check_kind("interface", interface, Interface, Profile, NoneType)
    check_whole("sites", sites, 1)
    check_rule(rule, one=True)
    check_single("sensitivity", slider=slider, interface=interface)
    return _worked_out(slider, interface, sites, rule)


@partial(jax.jit, static_argnames="sites")
def _worked_out(slider: Slider, interface: AnyInterface, sites: int, rule: BreakRule | None) -> Sensitivity:
    modes, site, share = lattice_modes(slider), jnp.arange(sites), kept_share(interface)

    def part(stress: Array, threshold: Array, site: Array) -> Array:
        # contact 0 breaks as a whole, and under the paper's rule those past the arrest too, which no length depends on
        return jnp.ones_like(stress) if rule is None else jnp.where(site == 0, 1, rule.broken(stress, threshold))

    def length(theta: Array, phi: Array) -> tuple[Array, tuple[Array, Array]]:
        kept = share * theta
        stress = run_over(modes, theta[0] - kept[0], phi - kept, part, theta - kept, site)
        length, complete = length_of_run(rule, stress, theta - kept)
        return length, (stress + kept, complete)

    kept = kept_at(interface, site)
    theta, phi = (jnp.broadcast_to(x + kept, (sites,)) for x in contact_at(modes, interface, site))
    (found, (stress, complete)), slopes = jax.value_and_grad(length, (0, 1), has_aux=True)(theta, phi)
    known = [jnp.where(complete, x, jnp.nan) for x in (found, *slopes)]
    return Sensitivity(known[0], stress, known[1], known[2], complete)
