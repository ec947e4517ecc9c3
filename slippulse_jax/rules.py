"""What a λ-contact does at its threshold."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.nn import sigmoid
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.units import quantity_field


class HardBreak(eqx.Module):
    """The paper's rule: a contact at or above its threshold breaks as a whole and repins at once with zero stretch."""


class SmoothBreak(eqx.Module):
    """A λ-contact whose micro-junctions do not all have the same threshold: the part that has reached its own breaks.

    Parameters
    ----------
    width : float
        w, scale of the distribution of thresholds, in σ_s; in [1e-6, 1]. Their standard deviation is π w/√3.

    Raises
    ------
    ValueError
        If the width lies outside its domain.

    Notes
    -----
    The thresholds follow a logistic law around the contact's threshold θ, cut off at zero because a junction without
    stress does not break. Under a stress t the fraction

        p(t) = [σ((t − θ)/w) − σ(−θ/w)] / σ(θ/w),        σ(x) = 1/(1 + e^{−x}),

    of them breaks and repins with zero stretch, so that the contact gives up the stress p t. p → 1 [t ≥ θ] as w → 0.

    Another law is a class derived from this one, with `broken` and `overloaded_length` of its own, called with scalars. It may
    have further fields: a number takes part in batches and derivatives as the width does; anything else is
    ``equinox.field(static=True)``, and hashable.
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


NUMBER = (jax.Array, np.ndarray, np.generic, int, float)


def check_rule(rule: Any, *, one: bool = False) -> None:
    """Refuse what is no break rule, and a rule of one's own of which a part would not be used.

    Parameters
    ----------
    rule : HardBreak, or SmoothBreak or a class derived from it
    one : bool
        Whether it must be a single rule, not a batch.

    Raises
    ------
    TypeError
        If it is no rule; or a class derived from `SmoothBreak` that has a field that is neither a number nor static, or
        that says anew which fraction breaks but not its mean between two contacts.
    ValueError
        If it is a batch, and must not be.
    """
    if type(rule) is HardBreak:
        return
    name = type(rule).__name__
    if not isinstance(rule, SmoothBreak):
        raise TypeError(f"rule = {rule!r}: must be HardBreak(), or SmoothBreak(width) or a rule derived from it")
    if _depth(rule, "broken") < _depth(rule, "overloaded_length"):
        raise TypeError(f"{name} has its own `broken`, but not its mean between two contacts, `overloaded_length`: write both")
    for path, value in jax.tree_util.tree_leaves_with_path(rule):
        field = name + jax.tree_util.keystr(path)
        if not isinstance(value, NUMBER):
            raise TypeError(f"{field} = {value!r}: must be a number or an array, or equinox.field(static=True)")
        if one and np.shape(value):
            raise ValueError(f"{field} has shape {np.shape(value)}: one rule is taken here; use jax.vmap for several")


def _depth(rule: SmoothBreak, method: str) -> int:
    """How many classes up from that of `rule` the method is defined."""
    return next(i for i, ancestor in enumerate(type(rule).__mro__) if method in vars(ancestor))
