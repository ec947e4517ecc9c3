"""What a λ-contact does at its threshold."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.nn import sigmoid
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.quantities import quantity_field


class HardBreak(eqx.Module):
    """The paper's rule: a contact at or above its threshold breaks as a whole and repins at once with zero stretch."""


class SmoothBreak(eqx.Module):
    """A λ-contact whose micro-junctions do not all have the same threshold: the part that has reached its own breaks.

    Parameters
    ----------
    width : float
        w, scale of the distribution of thresholds, in σ_s; in [1e-6, 1]. Their standard deviation is π w/√3.

    Notes
    -----
    The thresholds follow a logistic law around the contact's threshold θ, cut off at zero because a junction without
    stress does not break. Under a stress t the fraction

        p(t) = [σ((t − θ)/w) − σ(−θ/w)] / σ(θ/w),        σ(x) = 1/(1 + e^{−x}),

    of them breaks and repins with zero stretch, so that the contact gives up the stress p t. p → 1 [t ≥ θ] as w → 0.
    """

    width: Float[AnyArrayLike, "..."] = quantity_field("w", "\\sigma_s", default=0.01)

    def __check_init__(self) -> None:
        if not isinstance(self.width, Tracer):
            width = np.asarray(self.width)
            if not np.all((width >= 0.999e-6) & (width <= 1)):
                raise ValueError(f"SmoothBreak.width = {self.width}: must lie in [1e-6, 1], in σ_s")

    def broken(self, stress: Array, threshold: Array) -> Array:
        """p(t), the fraction of a contact's junctions that break under a stress; 0 without stress or under a negative one."""
        w = jnp.asarray(self.width)
        pulled = jnp.where(stress > 0, stress, 0)
        # σ(a) − σ(b) = σ(a) σ(−b) (1 − e^{b−a}): no difference of near equals, so that p is exact down to t = 0; the
        # factor σ(−b) cancels the normalisation
        return jnp.where(stress > 0, sigmoid((pulled - threshold) / w) * -jnp.expm1(-pulled / w), 0)

    def overloaded_length(self, before: Array, after: Array, threshold_before: Array, threshold_after: Array) -> Array:
        """∫ p(t(x)) dx from one contact to the next, with t − θ and t linear in between; in λc.

        For w → 0: the length over which the stress exceeds the threshold. Without the cut-off at zero it is
        [S(b) − S(a)]/(b − a), with S(x) = ln(1 + e^x) and a, b = (t − θ)/w at the two ends.
        """
        w = jnp.asarray(self.width)
        a, b = (before - threshold_before) / w, (after - threshold_after) / w
        # the junctions with thresholds below zero that the logistic law would count, and its normalisation
        cut = _mean_sigmoid(-threshold_before / w, -threshold_after / w)
        return (_mean_sigmoid(a, b) - cut) / (1 - cut)


def _mean_sigmoid(a: Array, b: Array) -> Array:
    """Mean of σ between a and b, which may coincide, and may be as large as 10⁶."""
    d, m = b - a, (a + b) / 2
    close = jnp.abs(d) < (0.03 if m.dtype == jnp.float64 else 0.3)
    step = jnp.where(close, 1, d)
    # S(x) = max(x, 0) + ln(1 + e^{−|x|}): the first part's mean slope is exactly 0 or 1 but where the sign changes
    ramp = (jnp.maximum(b, 0) - jnp.maximum(a, 0)) / step
    bend = (jnp.log1p(jnp.exp(-jnp.abs(b))) - jnp.log1p(jnp.exp(-jnp.abs(a)))) / step
    s = sigmoid(m)
    q = s * (1 - s)  # σ'; σ'' = q (1 − 2s), σ'''' = σ'' (1 − 12 q)
    curvature = q * (1 - 2 * s)
    d = jnp.where(close, d, 0)
    return jnp.where(close, s + d**2 / 24 * curvature * (1 + d**2 / 80 * (1 - 12 * q)), ramp + bend)


BreakRule = HardBreak | SmoothBreak


def check_rule(rule: Any) -> None:
    """Refuse anything that is not a break rule."""
    if not isinstance(rule, BreakRule):
        raise TypeError(f"rule = {rule!r}: must be HardBreak() or SmoothBreak(width)")
