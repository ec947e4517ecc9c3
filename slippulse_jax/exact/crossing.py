"""First crossing of the front stress and the threshold.

There t(ℓ*) = 1 + ε ℓ*. Any number of fronts is treated at once; the lane axis is last, and no lane depends on another. A front
well below run-away (φ < 0.999 φ_c) on thresholds that do not fall is *simple*: t has one maximum and one crossing beyond it,
which Newton's method finds inside a bracket. Near run-away, beyond it, and on falling thresholds the stress may dip to the
threshold and recover. A careful search then proceeds from the edge in steps that do not skip a dip, and accepts a crossing
only if the next contact stays below its threshold.

The parameters of a front are θ = (H/λc, k/K, ν) and, unless both are zero, φ and ε.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.exact import double_series
from slippulse_jax.exact.double_series import Lanes, Series
from slippulse_jax.front.front import runaway_prestress
from slippulse_jax.slider import Slider

SIMPLE = 0.999
"""Fraction of the run-away prestress below which a front is simple."""

CLOSE = 1e-7
"""Last step of Newton's method, relative to the length: its square is rounding."""

STEPS = 100
"""Steps after which a crossing is given up; five to eight are usual."""

ROUNDED = 1e-4
"""Last step with which a crossing still counts as found after `STEPS`: where the stress is nearly parallel to the threshold,
rounding moves the crossing by as much, and the steps never become small."""


def series_of(theta: Float[Array, "n *lanes"]) -> Series:
    """Series at θ; without a φ it has a family fewer."""

    def modes_of(height: Array, stiffness: Array, poisson: Array) -> Any:
        return lattice_modes(Slider(height, stiffness, poisson))

    for _ in theta.shape[1:]:
        modes_of = jax.vmap(modes_of, in_axes=-1, out_axes=-1)
    modes = modes_of(theta[0], theta[1], theta[2])
    phi = theta[3] if len(theta) > 3 else None
    start = modes.drive if phi is None else (1 - phi)[None] * modes.drive
    coupling, reflected = modes.ratio * modes.weight, modes.ratio[:, None] * modes.reflection
    system = double_series.system_of(modes.gap, coupling, reflected, start, phi, runaway_prestress(modes))
    return double_series.solve(system)


def first_crossing(found: Series, theta: Float[Array, "n *lanes"]) -> tuple[Lanes, Lanes]:
    """Find ℓ* and the `Outcome`, both in one floating type.

    Without φ and ε every front is simple.
    """
    slope, careful = _slope(theta), len(theta) > 3
    zero = jnp.zeros_like(slope)
    edge = double_series.rise(found, zero)[1]
    moves = edge > slope
    simple = _simple(found, slope) if careful else jnp.ones_like(moves)
    start = jnp.where(simple & moves, _start(found, theta), 0)
    low, dip, in_dip, passed = zero, zero, jnp.zeros_like(moves), ~moves
    if careful:
        low, dip, in_dip, passed = _first_dip(found, slope, ~simple, moves)
        # beyond the dips the stress meets a rising threshold once more, far out, where no step can skip a dip
        start = jnp.where(~simple & passed & (slope > 0), jnp.maximum(dip, 0.25), start)
        start = jnp.where(in_dip & (dip - low > 2 * _tiny(slope) * jnp.maximum(dip, 1)), dip, start)
        low = jnp.where(simple, 0, low)
    tolerance = max(CLOSE, _tiny(slope))
    s, before = _newton(partial(double_series.rise, found), slope, start, low, tolerance)
    settled = jnp.abs(s - before) <= ROUNDED * jnp.maximum(s, 1)
    s = jnp.where(in_dip & (start == 0), dip, s)
    none = jnp.where(simple, ~moves, in_dip & (dip == 0))
    # a front that stops only where the threshold is negative has run away
    runs = ~simple & ~in_dip & passed & (slope <= 0) | (1 + slope * s < 0)
    status = jnp.select(
        [~jnp.isfinite(edge), none, runs, ~settled | ~simple & ~in_dip & ~passed],
        [Outcome.INVALID, Outcome.NO_DOMINO, Outcome.RUN_AWAY, Outcome.NOT_CONVERGED],
        Outcome.ARRESTED,
    ).astype(edge.dtype)
    return length_of(s, status), status


def excess(found: Series, theta: Float[Array, "n *lanes"], s: Lanes) -> tuple[Lanes, Lanes]:
    """Excess t(s) − 1 − εs, and its slope in s."""
    (rise, fall), slope = double_series.rise(found, s), _slope(theta)
    return rise - slope * s, fall - slope


def length_of(s: Lanes, status: Lanes) -> Lanes:
    """Length of a crossing; 0 without a domino, inf for run-away."""
    without = jnp.where(status == Outcome.NO_DOMINO, 0, jnp.where(status == Outcome.RUN_AWAY, jnp.inf, jnp.nan))
    return jnp.where(status == Outcome.ARRESTED, s, without.astype(s.dtype))


def _slope(theta: Array) -> Lanes:
    """Slope ε of the thresholds."""
    return theta[4] if len(theta) > 3 else jnp.zeros_like(theta[0])


def _simple(found: Series, slope: Lanes) -> Bool[Array, "*lanes"]:
    return (found.system.plateau < SIMPLE) & (slope >= 0)


def _start(found: Series, theta: Array) -> Lanes:
    """First guess of the crossing.

    From the tail c_2 ρ_2^s far from the edge, or the length on a rigid upper layer.
    """
    excess = found.amplitude[1] / (1 - jnp.minimum(found.system.plateau, SIMPLE)) - 1
    return jnp.where(
        excess > 0.1, jnp.log1p(jnp.maximum(excess, 0.1)) / found.system.rate[1], expected_length(theta[0], theta[1], theta[2])
    )


def expected_length(height: Any, stiffness: Any, poisson: Any) -> Any:
    """Leading term ln[2/(1+β)]/κ_2 of Eq. (25), of tall relaxed sliders.

    In λc, of arrays of NumPy or JAX. With ln(1 + x) ≈ 2x/(2 + x): correctly rounded operations alone, which round the same way
    everywhere.
    """
    shape = 2 * (1 + poisson)
    b = shape * stiffness * height
    x = b / (2 + b)
    return 2 * x / (2 + x) * height * (shape * (1 + 1 / b)) ** 0.5


def _newton(
    rise: Callable[[Lanes], tuple[Lanes, Lanes]], slope: Lanes, start: Lanes, low: Lanes, tolerance: float
) -> tuple[Lanes, Lanes]:
    """Find crossings by Newton's method inside a bracket.

    From `low` on, until every lane is close; return s and the s before it. `rise` is t(s) − t(0) and t'(s). A lane that is
    close stays as it is; s = 0 marks a lane without a crossing.
    """

    # not `root_between`: without first guess, given slope and steps in ln t, `exact_lengths` takes 1.6 times as long
    def turn(carry: Any) -> Any:
        s, before, low, high, count = carry
        excess, rate = rise(s)
        over = excess >= slope * s
        low, high = jnp.where(over, s, low), jnp.where(over, high, s)
        # ln t is nearly straight: x (6 + x)/(6 + 4x) is ln(1 + x) near 0
        x = jnp.maximum(excess, -0.9)
        by_log = x * (6 + x) / (6 + 4 * x) * (1 + excess) / rate
        newton = jnp.clip(s - jnp.where(slope == 0, by_log, (excess - slope * s) / (rate - slope)), s / 4, 4 * s + 10)
        margin = tolerance * s  # at the crossing itself rounding may leave the bracket
        inside = (rate < slope) & (newton >= low - margin) & (newton <= high + margin)
        after = jnp.where(inside, newton, jnp.where(jnp.isfinite(high), (low + high) / 2, 2 * s + 0.25))
        done = _close(s, before, tolerance)
        return jnp.where(done, s, after), jnp.where(done, before, s), low, high, count + 1

    def unfinished(carry: Any) -> Array:
        return (~_close(carry[0], carry[1], tolerance)).any() & (carry[4] < STEPS)

    zero = jnp.zeros_like(start)
    return lax.while_loop(unfinished, turn, (start, zero, low, jnp.full_like(start, jnp.inf), 0))[:2]


def _close(s: Lanes, before: Lanes, tolerance: float) -> Bool[Array, "*lanes"]:
    return jnp.abs(s - before) <= tolerance * s


def _tiny(x: Array) -> float:
    """Smallest relative step, a few roundings."""
    return 64 * float(jnp.finfo(x.dtype).eps)


def _first_dip(found: Series, slope: Lanes, wanted: Array, moves: Array) -> tuple[Lanes, Lanes, Array, Array]:
    """Search from the edge for the first crossing that arrests the front.

    The excess over the threshold is concave near the edge and convex beyond, so that it lies above its parabola in the one
    part and above its tangent in the other: steps to their zeros approach a crossing and never skip a dip. (Far out, where
    the stress tends to its plateau, they may pass the only crossing there.) A crossing is accepted only if the contact beyond
    it stays below its threshold. Return the last point above the threshold, and the crossing, or the point reached where the
    search gave up; whether there is such a crossing; and whether none can follow as long as the threshold does not rise.
    """
    tiny = _tiny(slope)
    none = -jnp.ones_like(slope)

    def turn(carry: Any) -> Any:
        s, low, seen, stopped, passed, count = carry
        (excess, rate), (_, bend) = jax.jvp(lambda x: double_series.rise(found, x), (s,), (jnp.ones_like(s),))
        above, loss = excess - slope * s, slope - rate
        checked = (seen >= 0) & (above < 0)
        # the step to the zero of above − loss h + ½ min(bend, 0) h²
        room, down = jnp.maximum(above, 0), jnp.minimum(bend, 0)
        root = jnp.sqrt(loss**2 - 2 * room * down)
        step = jnp.where(
            loss > 0, 2 * room / jnp.where(loss > 0, loss + root, 1), (root - loss) / jnp.where(down < 0, -down, 1)
        )
        gone = ~checked & ((loss <= 0) & ~(bend < 0) | (s * found.system.rate[1] > 60))
        after = s + jnp.minimum(step, 4 * s + 10)
        close = ~checked & ~gone & (step <= tiny * jnp.maximum(s, 1)) & (s > 0)
        contact = jnp.maximum(jnp.ceil(after), 1)
        at_contact = close & (contact - after <= tiny * contact)
        now = stopped | checked | at_contact
        left = stopped | passed
        return (
            jnp.where(left, s, jnp.where(checked, seen, jnp.where(close & ~at_contact, contact, jnp.where(gone, s, after)))),
            jnp.where(left | (above < 0), low, s),
            jnp.where(left | checked, seen, jnp.where(close, after, none)),
            jnp.where(left, stopped, now),
            jnp.where(left, passed, gone),
            count + 1,
        )

    def unfinished(carry: Any) -> Array:
        return ~(carry[3] | carry[4]).all() & (carry[5] < STEPS)

    # a stress that falls at once may still be above the threshold of contact 1
    falls = wanted & ~moves
    zero = jnp.zeros_like(slope)
    begin = jnp.where(falls, 1, zero), zero, jnp.where(falls, 0, none), jnp.zeros_like(wanted), ~wanted, 0
    s, low, _, stopped, passed, _ = lax.while_loop(unfinished, turn, begin)
    return low, s, stopped & wanted, passed & wanted
