"""Where the stress of many fronts falls to the threshold: Newton's method, every lane until it has converged by itself."""

from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax.lattice import lane_series
from slippulse_jax.lattice.lane_series import Lanes, Series
from slippulse_jax.slider import Slider

UNSETTLED = -1
"""Status of a lane that this search leaves to `slippulse_jax.lattice.exact`."""

MAX_TURNS = 24
"""Newton steps before a lane is left to the safeguarded search; four to six are usual."""

_GONE = 40.0  # a decay by e^−40 is one to rounding


def crossing(series: Series, theta: Float[Array, "n lanes"], sloped: bool) -> tuple[Lanes, Int[Array, " lanes"]]:
    """ℓ* and its status, 0 arrested or 1 no domino as in `ExactStatus`, or `UNSETTLED`.

    Settled are fronts well below run-away (φ < 0.97 φ_c) on thresholds that do not fall: t then has one maximum, and one
    crossing beyond it, which a negative slope there certifies.
    """
    slope = theta[4] if sloped else jnp.zeros_like(theta[0])
    moves = series.at_edge() > slope
    regular = series.sound & (series.plateau < 0.97) & (slope >= 0)
    start = _start(series, theta)
    start = jnp.where(moves & regular, start, 0)

    def step(function: Any, s: Lanes) -> Lanes:
        excess, rate = function(series, s)
        # ln t is all but straight: x (6 + x)/(6 + 4x) is ln(1 + x) near 0
        x = jnp.maximum(excess, -0.9)
        by_log = x * (6 + x) / (6 + 4 * x) * (1 + excess) / rate
        newton = s - (jnp.where(slope == 0, by_log, (excess - slope * s) / (rate - slope)) if sloped else by_log)
        return jnp.where(rate < slope, jnp.clip(newton, s / 4, 4 * s + 10), 2 * s + 0.25)

    def far(s: Lanes) -> Bool[Array, " lanes"]:
        return s * series.column_rate > _GONE

    def iterate(function: Any, s: Lanes, close: Any, most: int) -> tuple[Lanes, Lanes]:
        """(s, the s before): a lane that is close stays where it is."""

        def turn(carry: Any) -> Any:
            s, before, count = carry
            done = close(s, before)
            return jnp.where(done, s, step(function, s)), jnp.where(done, before, s), count + 1

        def unfinished(carry: Any) -> Array:
            return (~close(*carry[:2])).any() & (carry[2] < most)

        return lax.while_loop(unfinished, turn, (s, jnp.where(start > 0, 0, s), 0))[:2]

    def converged(s: Lanes, before: Lanes, tolerance: Any = 1e-9) -> Bool[Array, " lanes"]:
        return jnp.abs(s - before) <= tolerance * s

    # the first column alone: the end of the search where the others have vanished, its start elsewhere
    s, before = iterate(
        lane_series.rise_far, start, lambda s, before: converged(s, before, jnp.where(far(s), 1e-9, 1e-2)), MAX_TURNS
    )
    arrived = far(s) & converged(s, before)
    s, before = iterate(lane_series.rise, s, lambda s, before: arrived | converged(s, before), MAX_TURNS)
    settled = regular & (~moves | arrived | converged(s, before))
    status = jnp.where(settled, jnp.where(moves, 0, 1), UNSETTLED)
    return jnp.where(settled & moves, s, 0), status


def _start(series: Series, theta: Array) -> Lanes:
    """By the tail c_2 ρ_2^s far from the edge, or the macroscopic law on a rigid upper layer, whichever makes sense."""
    slider = Slider(theta[0], theta[1], theta[2])
    excess = series.amplitude[1] / (1 - jnp.minimum(series.plateau, 0.97)) - 1
    b = slider.b
    by_tail = excess > 0.1
    return jnp.log1p(jnp.where(by_tail, excess, b / (2 + b))) / jnp.where(by_tail, series.rate[1], slider.kappa_2)
