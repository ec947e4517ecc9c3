"""Break rules: what a λ-contact does at its threshold.

The paper's rule is ``rule=None``: a contact at or above its threshold breaks as a whole and repins at once, at zero stretch.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.nn import sigmoid
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.base.domains import Domain
from slippulse_jax.base.units import quantity_field

WIDTH = Domain(1e-6, 1, "must lie in [1e-6, 1], in σ_s", closed="both")


class BreakRule(eqx.Module):
    """Base of break rules: how much of a contact breaks.

    Derive a class that defines `broken` and `overloaded_length`, and pass an object of it as ``rule=``. Both methods are called
    with scalars: of contacts that keep a share r of their strength, with what one can lose, t − r θ, and the threshold of that,
    (1 − r) θ. A field that is a number broadcasts and has derivatives, as `SmoothBreak.width` does; any other field must be
    ``equinox.field(static=True)``, and hashable.

    Raises
    ------
    TypeError
        If the class defines only one of the two methods.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        given = [name for name in ("broken", "overloaded_length") if name in vars(cls)]
        if len(given) == 1:
            raise TypeError(f"{cls.__name__} defines `{given[0]}` alone: a break rule defines `broken` and `overloaded_length`")

    @abstractmethod
    def broken(self, stress: Array, threshold: Array) -> Array:
        """Fraction of a contact, 0 to 1, that breaks; stresses in σ_s."""

    @abstractmethod
    def overloaded_length(self, before: Array, after: Array, threshold_before: Array, threshold_after: Array) -> Array:
        """Integral of that fraction from one contact to the next, in λc.

        Stress and threshold are linear in between.
        """

    def in_domain(self) -> Any:
        """Whether its numbers, traced ones too, lie in their domains."""
        return True


def fraction_broken(rule: BreakRule | None, stress: Array, threshold: Array) -> Array:
    """Fraction of a contact that breaks, under the paper's rule whole."""
    return (stress >= threshold).astype(stress.dtype) if rule is None else rule.broken(stress, threshold)


class SmoothBreak(BreakRule):
    """A λ-contact of many micro-junctions with thresholds of their own.

    Those that reach theirs break.

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

    of them breaks and repins at zero stretch, so that the contact releases the stress p t. p → 1 [t ≥ θ] as w → 0. Where
    contacts keep r θ, the law is cut off there, and w stays in σ_s.
    """

    width: Float[AnyArrayLike, "..."] = quantity_field("w", "\\sigma_s", name="width of the smooth break rule", default=0.01)

    def __check_init__(self) -> None:
        WIDTH.check("SmoothBreak.width", self.width)

    def in_domain(self) -> Array:
        """Whether the width, a traced one too, is positive."""
        return jnp.asarray(self.width) > 0

    def broken(self, stress: Array, threshold: Array) -> Array:
        """Fraction p(t) of a contact's junctions that break under a stress.

        0 where the stress is not positive.
        """
        w = jnp.asarray(self.width)
        pulled = jnp.where(stress > 0, stress, 0)
        # σ(a) − σ(b) = σ(a) σ(−b) (1 − e^{b−a}): no difference of near equals, so that p is exact down to t = 0; the
        # factor σ(−b) cancels the normalisation
        return jnp.where(stress > 0, sigmoid((pulled - threshold) / w) * -jnp.expm1(-pulled / w), 0)

    def overloaded_length(self, before: Array, after: Array, threshold_before: Array, threshold_after: Array) -> Array:
        """Integral ∫ p(t(x)) dx from one contact to the next, in λc.

        t and t − θ are linear in between; where t is negative nothing breaks.

        As w → 0, the length over which the stress exceeds the threshold. Without the cut-off at zero it is
        [S(b) − S(a)]/(b − a), with S(x) = ln(1 + e^x) and a, b = (t − θ)/w at the two ends.
        """
        w = jnp.asarray(self.width)
        # from there, or up to there, the stress is positive
        falls, rises = (before > 0) & (after < 0), (before < 0) & (after > 0)
        share = jnp.where(falls | rises, before / jnp.where(before == after, 1, before - after), 1)
        crossed = threshold_before + share * (threshold_after - threshold_before)
        start, end = jnp.where(rises, crossed, threshold_before), jnp.where(falls, crossed, threshold_after)
        pulled = jnp.where(rises, 1 - share, jnp.where((before > 0) | (after > 0), share, 0))
        a, b = (jnp.maximum(before, 0) - start) / w, (jnp.maximum(after, 0) - end) / w
        # the junctions with thresholds below zero that the logistic law would count, and its normalisation
        cut = _mean_sigmoid(-start / w, -end / w)
        return pulled * (_mean_sigmoid(a, b) - cut) / (1 - cut)


class SelfHealing(eqx.Module):
    """The paper's rule with inertia: contacts repin at once.

    With what they keep (`residual_strength` of the chain), in the paper with zero stretch.

    Parameters
    ----------
    break_time : float
        Shortest time between two breaks anywhere in the chain, in √(m/K), 0 or more; the most overloaded contact breaks
        first. The paper's hierarchy of times, sound much faster than the front, is a break time much longer than the
        relaxation time of the chain. With 0 a contact breaks as soon as it reaches its threshold.
    """

    break_time: Float[AnyArrayLike, ""] = 0.0


class CrackLike(eqx.Module):
    """Amontons–Coulomb rule: contacts slide at constant friction.

    A contact slides from its threshold on, and repins when its slip rate vanishes.

    Parameters
    ----------
    friction : float
        σ_k, the stress on a sliding contact, in σ_s; 0 or more, and below every threshold.
    """

    friction: Float[AnyArrayLike, ""] = 0.5


def _mean_sigmoid(a: Array, b: Array) -> Array:
    """Mean of σ between a and b, which may coincide."""
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


NUMBER = (jax.Array, np.ndarray, np.generic, int, float)


def check_rule(rule: Any, *, one: bool = False) -> None:
    """Check that `rule` is a break rule, a single one if `one`.

    A TypeError if it is no rule, or has a field that is neither a number nor static; a ValueError if it is a batch where a
    single rule is needed.
    """
    if rule is None:
        return
    name = type(rule).__name__
    if not isinstance(rule, BreakRule):
        raise TypeError(f"rule = {rule!r}: must be None, SmoothBreak(width), or a rule derived from BreakRule")
    for path, value in jax.tree_util.tree_leaves_with_path(rule):
        field = name + jax.tree_util.keystr(path)
        if not isinstance(value, NUMBER):
            raise TypeError(f"{field} = {value!r}: must be a number or an array, or equinox.field(static=True)")
        if one and np.shape(value):
            raise ValueError(f"{field} has shape {np.shape(value)}: must be one rule; use jax.vmap for several")
