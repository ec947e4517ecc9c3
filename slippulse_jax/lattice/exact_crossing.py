"""Where the exact front stress crosses the threshold: the search, and its derivative as that of an implicit function."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from slippulse_jax import double_series as series
from slippulse_jax.domains import PRESTRESS, THRESHOLD_SLOPE
from slippulse_jax.lattice.front import in_domain
from slippulse_jax.lattice.modes import Modes, lattice_modes
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

MAX_STEPS = 100
"""Newton or bisection steps before a crossing is given up (length NaN); five to eight are usual."""

ROUNDED = 1e-4
"""Last step, in contacts or relative to the length, with which it counts as found all the same: where the stress is all but
level beside the threshold, rounding moves the crossing by as much, and the steps never get small."""


def solve_series(theta: Float[Array, " n"], no_prestress: bool) -> series.Solution:
    """Series of θ = (H/λc, k/K, ν, φ, …)."""
    return front_series(lattice_modes(Slider(theta[0], theta[1], theta[2])), None if no_prestress else theta[3])


def front_series(modes: Modes, prestress: Array | None) -> series.Solution:
    """The series of one chain; where one front is asked for at many s, solved once and summed by `double_series.stress`."""
    reflected = modes.ratio[:, None] * modes.reflection
    roots = series.roots_of(modes.gap, modes.ratio * modes.weight, reflected, modes.weight)
    return series.solve(roots, (modes.drive[0], modes.drive[1]), prestress)


Plain = tuple[bool, bool]  # whether prestress, threshold slope are zero for certain


def _excess(theta: Float[Array, "5"], solution: series.Solution, s: Array, plain: Plain) -> Array:
    """t(s) − (1 + εs)."""
    rise = series.rise(solution, s)
    return rise if plain[1] else rise - theta[4] * s


def differentiable_crossing(theta: Float[Array, "5"], plain: Plain) -> tuple[Array, Array]:
    """(ℓ*, status), with the derivatives of an implicit function: dℓ* = −d(excess) / (∂excess/∂s), d at fixed s.

    The series is solved outside the rule: value and derivatives of any order share it, and its own derivatives are JAX's.
    """

    @jax.custom_jvp
    def crossing(theta: Array, solution: series.Solution) -> tuple[Array, Array]:
        return _crossing(theta, solution, plain)

    @crossing.defjvp
    def _rule(primals: Any, tangents: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        # through `crossing` itself, so that the rule can be differentiated again
        theta, solution = primals
        length, status = crossing(theta, solution)
        arrested = status == Outcome.ARRESTED
        at = jnp.where(arrested, length, 1)
        _, change = jax.jvp(lambda x, y: _excess(x, y, at, plain), primals, tangents)
        _, slope = jax.jvp(lambda s: _excess(theta, solution, s, plain), (at,), (jnp.ones_like(at),))
        # a constant where nothing follows contact 0; never a number where there is no length
        elsewhere = jnp.where(status == Outcome.NO_DOMINO, 0, jnp.nan)
        return (length, status), (jnp.where(arrested, -1 / slope, elsewhere) * change, jnp.zeros_like(status))

    return crossing(theta, solve_series(theta, plain[0]))


class _Search(NamedTuple):
    """The crossing lies between `low`, where the stress exceeds the threshold, and `high`, where it does not."""

    at: Array
    low: Array
    high: Array
    step: Array
    steps: Array
    runs: Bool[Array, ""]


def _crossing(theta: Float[Array, "5"], solution: series.Solution, plain: Plain) -> tuple[Array, Array]:
    """The first crossing beyond 0, by Newton's method, and its status (in floating point)."""
    roots = solution.roots
    slope = jnp.zeros_like(theta[0]) if plain[1] else theta[4]

    def rise(s: Array) -> tuple[Array, Array]:
        """t(s) − 1 and its derivative."""
        return jax.jvp(lambda x: series.rise(solution, x), (s,), (jnp.ones_like(s),))

    at_edge = rise(jnp.zeros_like(slope))[1] - slope
    plateau = solution.prestress / roots.runaway
    # far from the edge t = plateau + c_2 ρ_2^s; short of that, on a rigid upper layer, t ∝ e^{−κ_2 s}
    slider = Slider(theta[0], theta[1], theta[2])
    amplitude = solution.others[0].terms[0][0, 0] + solution.others[0].terms[1][0, 0]
    excess = amplitude / jnp.where(plateau < 1, 1 - plateau, 0.5)
    by_tail = jnp.log(jnp.maximum(excess, 1)) / roots.root_rate[1]
    start = jnp.where(excess > 1.1, by_tail, jnp.log(2 / (1 + slider.beta)) / slider.kappa_2)
    # above the run-away prestress the stress may still fall below the threshold once, near the edge, before it recovers
    start = jnp.where(plateau < 1, start, 0.5)

    def solve(slope: Array, start: Array) -> _Search:
        def unfinished(search: _Search) -> Array:
            # Newton's last step is far below this; what remains is the rounding of t
            close = search.step <= 64 * jnp.finfo(start.dtype).eps * jnp.maximum(search.at, 1)
            return ~close & ~search.runs & (search.steps < MAX_STEPS)

        def improve(search: _Search) -> _Search:
            s, (excess, rate) = search.at, rise(search.at)
            over = excess >= slope * s
            low, high = jnp.where(over, s, search.low), jnp.where(over, search.high, s)
            # a level threshold is met by ln t, which is all but straight; a falling one is approached from below only
            by_log = jnp.log1p(jnp.maximum(excess, -0.9)) * (1 + excess) / rate
            by_line = (excess - slope * s) / (rate - slope)
            newton = jnp.minimum(s - jnp.where((slope == 0) & (plateau < 1), by_log, by_line), 4 * s + 10)
            # where the threshold falls, a stress that no longer gains on it from above never meets it
            runs = jnp.zeros((), bool)
            if plain != (True, True):
                bend = jax.jvp(lambda x: rise(x)[1], (s,), (jnp.ones_like(s),))[1]
                gone = (rate >= slope) & (bend >= 0) | (s * roots.root_rate[1] > 60)
                careful = over & ((slope < 0) | (plateau >= 1) & (slope <= 0))
                runs = careful & gone
                # it may meet it in a shallow dip alone, over which no step must leap: the stress, bent downward near the edge
                # and upward from there on, lies above its parabola in the one part and above its tangent in the other
                above, loss = jnp.maximum(excess - slope * s, 0), slope - rate
                fall = loss + jnp.sqrt(loss**2 - 2 * above * jnp.minimum(bend, 0))
                newton = jnp.where(careful, s + 2 * above / jnp.where(fall > 0, fall, jnp.inf), newton)
            inside = (newton > 0) & (newton >= low) & (newton <= high)
            further = jnp.where((slope < 0) | (plateau >= 1), 1.25 * s + 0.25, 2 * s + 1)
            fallback = jnp.where(jnp.isfinite(high), (low + high) / 2, further)
            after = jnp.where(inside, newton, fallback)
            return _Search(after, low, high, jnp.abs(after - s), search.steps + 1, runs)

        zero, inf = jnp.zeros_like(start), jnp.full_like(start, jnp.inf)
        first = _Search(start, zero, inf, inf, jnp.zeros((), jnp.int32), at_edge <= 0)
        return lax.while_loop(unfinished, improve, first)

    found = solve(jnp.zeros_like(slope), start) if plain[1] else _with_slope(solve, slope, start, plateau)
    # what stops only where the threshold has fallen below nothing has run away
    length, steps, runs = found.at, found.steps, found.runs | (1 + slope * found.at < 0)
    given_up = ~(steps < MAX_STEPS) & ~(found.step <= ROUNDED * jnp.maximum(length, 1))
    valid = in_domain(slider) & PRESTRESS.holds(theta[3]) & THRESHOLD_SLOPE.holds(theta[4])
    status = jnp.select(
        [~valid | ~jnp.isfinite(at_edge), at_edge <= 0, runs, given_up],
        [
            Outcome.INVALID,
            Outcome.NO_DOMINO,
            Outcome.RUN_AWAY,
            Outcome.NOT_CONVERGED,
        ],
        Outcome.ARRESTED,
    ).astype(length.dtype)
    without = jnp.select([status == Outcome.NO_DOMINO, status == Outcome.RUN_AWAY], [0.0, jnp.inf], jnp.nan)
    return jnp.where(status == Outcome.ARRESTED, length, without.astype(length.dtype)), status


def _with_slope(solve: Any, slope: Array, start: Array, plateau: Array) -> _Search:
    """First the crossing with a level threshold, which is a lower (ε < 0) or an upper (ε > 0) bound, then the true one."""
    level = solve(jnp.zeros_like(slope), start)
    has_level = (plateau < 1) & jnp.isfinite(level.at) & (level.at > 0.01)
    return solve(slope, jnp.where(has_level, level.at, 0.5))
