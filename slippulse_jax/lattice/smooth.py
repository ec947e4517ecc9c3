"""The first precursor under a smooth break rule, by the fast recursion.

A contact that carries the stress t when the front reaches it releases p(t) t instead of all or nothing; p is the fraction of
its micro-junctions whose own threshold has been reached (`slippulse_jax.rules.SmoothBreak`). The front no longer stops at a
contact but fades. Its length generalises the definition of the hard length (physics of `slippulse_jax.lattice.front`). With t
linear between contacts,

    ℓ_w = p(t(1)) + Σ_{s ≥ 1} ∫_s^{s+1} p(t(x)) dx,

where the first term is the step from contact 0, which always breaks completely, to its neighbour. As w → 0 every integral
becomes the length over which t ≥ θ, so that ℓ_w → ℓ.

In a chain of any interface the same sweep is `slippulse_jax.lattice.rupture.smooth_rupture`; in a block it is `fade` too.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.derivatives import by_forward_mode
from slippulse_jax.lattice.front import (
    DEFAULT_MAX_CONTACTS,
    Front,
    advance,
    first_of,
    in_domain,
    length_or_reason,
    nucleate,
    stress_ahead,
)
from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.rules import SmoothBreak
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome


class Fading(NamedTuple):
    """Fading front: the last contact it reached, and its length so far."""

    front: Any  # with its `position`
    length: Float[Array, ""]


def fade(
    rule: SmoothBreak,
    start: Any,
    stress: Callable[[Any], Array],
    threshold: Callable[[Array], Array],
    release: Callable[[Any, Array], Any],
    limit: int | Array,
    negligible: float,
) -> tuple[Fading, Array]:
    """Let a front fade after contact 0 has broken completely, and whether it has not by the contact `limit`.

    Parameters
    ----------
    start : front
        Its `position` is that of the contact ahead.
    stress : callable
        Of a front: on the contact ahead, in σ_s.
    threshold : callable
        Of a contact.
    release : callable
        The front after the contact ahead has released a stress.
    limit : int
    negligible : float
        Fraction of a contact that breaks, below which the front has faded.
    """

    def broken(front: Any) -> Array:
        return rule.broken(stress(front), threshold(front.position))

    def step(now: Fading) -> Fading:
        before, at = stress(now.front), threshold(now.front.position)
        front = release(now.front, rule.broken(before, at) * before)
        return Fading(front, now.length + rule.overloaded_length(before, stress(front), at, threshold(front.position)))

    end = lax.while_loop(
        lambda now: (broken(now.front) > negligible) & (now.front.position < limit), step, Fading(start, broken(start))
    )
    return end, broken(end.front) > negligible


def smooth_length(
    slider: Slider, rule: SmoothBreak, max_contacts: int = DEFAULT_MAX_CONTACTS
) -> tuple[Float[Array, "..."], Int[Array, "..."]]:
    """Length of the first precursor under a smooth rule.

    The interface is uniform and semi-infinite.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast with each other and with those of the rule.
    rule : SmoothBreak
        Or a subclass of it.
    max_contacts : int
        Largest number of contacts; a front that has not faded by then gives LIMIT.

    Returns
    -------
    length : array
        ℓ_w, in λc. Never NaN for a slider and a width in their domains. It has derivatives of every order, forward and
        reverse, with respect to the numbers of the slider and of the rule; each takes one pass with as many tangents.
    status : int array
        `Outcome`: ARRESTED, LIMIT or INVALID.

    Notes
    -----
    Composes with ``jit``, ``vmap``, ``grad``, ``jvp``, ``jacfwd``, ``hessian``.
    """
    numbers, kind = jax.tree.flatten((slider, rule))
    dtype = jnp.result_type(*(jnp.asarray(x).dtype for x in numbers))
    theta = jnp.stack(jnp.broadcast_arrays(*(jnp.asarray(x, dtype) for x in numbers)), axis=-1)
    flat = theta.reshape(-1, len(numbers))
    by_lane = by_forward_mode(lambda x: _length(x, kind, max_contacts)[0])
    lengths = jax.vmap(by_lane)(flat)
    status = lax.stop_gradient(jax.vmap(lambda x: _length(x, kind, max_contacts)[1])(lax.stop_gradient(flat)))
    shape = theta.shape[:-1]
    return lengths.reshape(shape), status.reshape(shape)


def _length(theta: Float[Array, " n"], kind: Any, max_contacts: int) -> tuple[Array, Array]:
    """Compute ℓ_w and the status of one lane.

    `theta` holds the numbers of a slider and a rule, which `kind` assembles. A number outside its domain gives a status.
    """
    slider, rule = jax.tree.unflatten(kind, list(theta))
    modes = lattice_modes(slider)
    one = jnp.ones_like(modes.load)
    # the neglected remainder is at most the broken fraction times the sum of a decay no slower than ρ_2 < 1
    negligible = 1e-4 * float(jnp.finfo(one.dtype).eps)

    def release(front: Front, given: Array) -> Front:
        return advance(modes, front, given)

    def stress(front: Front) -> Array:  # itself and not its change, whose rounding would not fade
        return stress_ahead(front)[0]

    start = release(nucleate(modes), one)  # contact 0 breaks completely
    end, fading = fade(rule, start, stress, lambda _: one, release, max_contacts, negligible)
    valid = in_domain(slider) & (rule.width > 0)
    status = first_of({Outcome.INVALID: ~valid | ~jnp.isfinite(end.length), Outcome.LIMIT: fading})
    return length_or_reason(status, end.length), status
