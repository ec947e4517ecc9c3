"""The first precursor of a uniform interface in closed form: a length that is analytic in the parameters.

The stress t(s) that the front meets at contact s extends from whole numbers to real s as a convergent double series
(`slippulse_jax.double_series`, derivation in ``docs/exact_solution.md``). The length ℓ* is its crossing with the threshold,

    t(ℓ*) = 1 + ε ℓ*,

so that ceil(ℓ*) contacts break. Unlike the ℓ of `slippulse_jax.lattice.front`, which joins t(s) at whole s by straight
lines, ℓ* has no kinks: it has derivatives of every order, in every mode, at a cost that does not grow with Λ.

Nothing like it is in the paper. The prestress φ and the threshold slope ε are those of its Discussion: φ = σ_0/σ_s on every
contact, released when it breaks and borne anew by its successor, and σ_s(i) = σ_s0 (1 + ε i).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax import double_series as series
from slippulse_jax.lattice.front import in_domain
from slippulse_jax.lattice.modes import Modes, lattice_modes
from slippulse_jax.slider import Slider, broadcast, check_domain, of_one_type
from slippulse_jax.status import Status

MAX_STEPS = 100
"""Newton or bisection steps before a crossing is given up (length NaN); five to eight are usual."""

ROUNDED = 1e-4
"""Last step, in contacts or relative to the length, with which it counts as found all the same: where the stress is all but
level beside the threshold, rounding moves the crossing by as much, and the steps never get small."""


class ExactStatus(Status):
    """What the exact front stress says of the first precursor."""

    ARRESTED = 0, "arrested: the front stress crosses the threshold at the length"
    NO_DOMINO = 1, "no domino: the stress falls from contact 0 on, so only that contact breaks (length 0)"
    NEVER_STOPS = 2, "never stops: the front stress stays above the threshold for ever (length inf)"
    NOT_CONVERGED = 3, "given up: the crossing was not found in MAX_STEPS steps (length NaN)"
    INVALID = 4, "no such slider or interface: a value outside its domain (length NaN)"


class ExactFront(NamedTuple):
    """The first precursor by the exact solution; every field has the shape of the batch."""

    length: Float[Array, "..."]  # ℓ*, in λc
    contacts_broken: Int[Array, "..."]  # ceil(ℓ*), at least 1; −1 where the length is not finite
    load: Float[Array, "..."]  # displacement of the left edge at nucleation, in u_s
    status: Int[Array, "..."]  # `ExactStatus`


class ExactFields(NamedTuple):
    """Displacements in u_s and stress in σ_s at the sites asked for."""

    upper: Float[Array, "..."]  # u_t
    layer: Float[Array, "..."]  # u
    stress: Float[Array, "..."]  # σ_c


def exact_length(slider: Slider, *, prestress: AnyArrayLike = 0.0, threshold_slope: AnyArrayLike = 0.0) -> Float[Array, "..."]:
    """Length ℓ* of the first precursor: the real crossing t(ℓ*) = 1 + ε ℓ*, in λc.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast.
    prestress : array_like
        φ = σ_0/σ_s in (−1, 1), uniform shear stress on every contact before loading.
    threshold_slope : array_like
        ε per contact, σ_s(i) = σ_s0 (1 + ε i). With ε < 0 the thresholds vanish at i = 1/|ε|: the length is then that of
        the front that starts at contact 0, meant for chains that end before.

    Returns
    -------
    array
        ℓ*, of the common shape. 0 where nothing follows the first contact (there the derivative is zero because the length
        is constant); inf where the front never stops; NaN for traced values outside the domain, or where Newton's
        method did not converge. `exact_front` says which. Derivatives are non-finite wherever the length is.

    Raises
    ------
    ValueError
        If a concrete `prestress` or `threshold_slope` lies outside its domain, naming value and index.

    Notes
    -----
    Relative error ≤ 1e-11 in float64 over H/λc 2–10⁵, k/K 1e-6–1, ν 0–0.5; in float32 1e-3 where ℓ* > 1. ℓ* and the ℓ of
    `precursor_length` have the same ceiling beyond 1, and differ by the curvature of t between two contacts: by less than
    0.2 λc, most on soft interfaces where two contacts break.
    """
    return _map(_length, slider, prestress, threshold_slope)


def exact_front(slider: Slider, *, prestress: AnyArrayLike = 0.0, threshold_slope: AnyArrayLike = 0.0) -> ExactFront:
    """Length, whole contacts, load at nucleation and status of the first precursor. Parameters as for `exact_length`."""
    return ExactFront(*_map(_front, slider, prestress, threshold_slope))


def exact_front_stress(slider: Slider, s: AnyArrayLike, *, prestress: AnyArrayLike = 0.0) -> Float[Array, "..."]:
    """Stress t(s) on contact s just before it would break, all contacts before it having broken; real s ≥ 0, in σ_s.

    Parameters
    ----------
    slider : Slider
        Fields that broadcast with `s`.
    s : array_like
        Position of the front in λc. Whole numbers give the stresses of the recursion, past the arrest too. The series is solved
        once for each slider, however many positions are asked for.
    prestress : array_like
        φ = σ_0/σ_s in (−1, 1).

    Raises
    ------
    ValueError
        If a concrete `s` is negative or not finite, or `prestress` outside its domain.
    """
    _require("s", s, lambda x: x >= 0, "must be a front position, ≥ 0, in λc")
    _require("prestress", prestress, lambda x: abs(x) < 1, "must lie in (−1, 1): σ_0/σ_s")
    return _each(_stress, _is_zero(prestress), *of_one_type(slider, prestress, s))


def _stress(no_prestress: bool, *arguments: Array) -> Array:
    *theta, s = arguments
    return series.stress(_solve(jnp.stack(theta), no_prestress), s)


def exact_fields(slider: Slider, s: AnyArrayLike, site: AnyArrayLike, *, prestress: AnyArrayLike = 0.0) -> ExactFields:
    """Displacements and stress at `site` when the front has broken contacts 0 … s − 1 and the next has not broken yet.

    Parameters
    ----------
    slider : Slider
    s : array_like
        Whole number ≥ 0 of broken contacts (0: nucleation).
    site : array_like
        Whole number i ≥ 0: behind (i < s) or ahead of the front. `slider`, `s` and `site` broadcast together.
    prestress : array_like
        φ; part of the stress, not of the displacements, which are counted from the state under the prestress alone.

    Raises
    ------
    ValueError
        If a concrete `s`, `site` or `prestress` lies outside its domain.

    Notes
    -----
    The stress behind the front is what the later breaks have put back on a contact repinned at zero stretch:
    σ(i) = Σ_m w_m X_m + Σ_mn R_mn (r_m r_n)^i X_n with X_m = Σ_{i≤j<s} r_m^{j−i} t(j), a sum in closed form.
    """
    for name, value in (("s", s), ("site", site)):
        _require(name, value, lambda x: (x >= 0) & (x == np.round(x)), "must be a whole number of contacts, ≥ 0")
    _require("prestress", prestress, lambda x: abs(x) < 1, "must lie in (−1, 1): σ_0/σ_s")
    return ExactFields(*_each(_fields, _is_zero(prestress), *of_one_type(slider, prestress, s, site)))


def _fields(no_prestress: bool, *arguments: Array) -> tuple[Array, Array, Array]:
    height, stiffness, poisson, phi, s, site = arguments
    modes = lattice_modes(Slider(height, stiffness, poisson))
    solution = front_series(modes, None if no_prestress else phi)
    rate, behind = solution.roots.rate, site < s
    ahead = jnp.exp(-jnp.maximum(site - s, 0) * rate) * series.parts(solution, jnp.minimum(site, s))
    later = jnp.where(behind, series.stress_sums(solution, site, jnp.maximum(s, site)), 0)
    back = modes.weight * later
    echo = jnp.exp(-site * rate) * (modes.reflection @ (jnp.exp(-site * rate) * later))
    mode = ahead + back + echo
    held = jnp.where(behind, (back + echo).sum(), solution.prestress + mode.sum())
    return modes.upper @ mode, mode.sum(), held


def check_interface(prestress: AnyArrayLike, threshold_slope: AnyArrayLike) -> None:
    """Refuse concrete values outside their domain."""
    _require("prestress", prestress, lambda x: abs(x) < 1, "must lie in (−1, 1): σ_0/σ_s")
    _require("threshold_slope", threshold_slope, lambda x: x > -1, "must exceed −1: relative rise of the threshold per contact")


def _map(function: Any, slider: Slider, prestress: AnyArrayLike, threshold_slope: AnyArrayLike) -> Any:
    check_interface(prestress, threshold_slope)
    plain = (_is_zero(prestress), _is_zero(threshold_slope))
    return _each(function, plain, *broadcast(slider, prestress, threshold_slope))


@partial(jax.jit, static_argnums=(0, 1))
def _each(function: Any, static: Any, *arguments: Array) -> Any:
    """`function` of scalars, mapped over arguments that broadcast; compiled once for each function and set of shapes.

    What depends on some of the arguments alone, as the series does on the slider, is worked out once for those: `jnp.vectorize`
    maps only the axes that an argument has.
    """
    return jnp.vectorize(lambda *scalars: function(static, *scalars))(*arguments)


def _require(name: str, value: Any, inside: Any, requirement: str) -> None:
    if not isinstance(value, Tracer):
        check_domain(name, np.asarray(value, dtype=float), inside, requirement)


def _is_zero(value: Any) -> bool:
    """Whether the caller left `value` at zero, so that compiled code need not carry it."""
    return isinstance(value, (int, float)) and value == 0


def _solve(theta: Float[Array, " n"], no_prestress: bool) -> series.Solution:
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


def _length(plain: Plain, *theta: Array) -> Array:
    return _differentiable_crossing(jnp.stack(theta), plain)[0]


def _front(plain: Plain, *arguments: Array) -> tuple[Array, Array, Array, Array]:
    theta = jnp.stack(arguments)
    length, code = _differentiable_crossing(theta, plain)
    status = code.astype(jnp.int32)
    load = lattice_modes(Slider(theta[0], theta[1], theta[2])).load
    if not plain[0]:
        load = (1 - theta[3]) * load
    finite = (status == ExactStatus.ARRESTED) | (status == ExactStatus.NO_DOMINO)
    count = jnp.where(finite, jnp.maximum(jnp.ceil(jnp.where(finite, length, 0)), 1), -1).astype(jnp.int32)
    return length, count, jnp.where(status == ExactStatus.INVALID, jnp.nan, load), status


def _differentiable_crossing(theta: Float[Array, "5"], plain: Plain) -> tuple[Array, Array]:
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
        arrested = status == ExactStatus.ARRESTED
        at = jnp.where(arrested, length, 1)
        _, change = jax.jvp(lambda x, y: _excess(x, y, at, plain), primals, tangents)
        _, slope = jax.jvp(lambda s: _excess(theta, solution, s, plain), (at,), (jnp.ones_like(at),))
        # a constant where nothing follows contact 0; never a number where there is no length
        elsewhere = jnp.where(status == ExactStatus.NO_DOMINO, 0, jnp.nan)
        return (length, status), (jnp.where(arrested, -1 / slope, elsewhere) * change, jnp.zeros_like(status))

    return crossing(theta, _solve(theta, plain[0]))


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
            inside = (newton > 0) & (newton >= low) & (newton <= high)
            further = jnp.where((slope < 0) | (plateau >= 1), 1.25 * s + 0.25, 2 * s + 1)
            fallback = jnp.where(jnp.isfinite(high), (low + high) / 2, further)
            # where the threshold falls, a stress that no longer gains on it from above never meets it
            runs = jnp.zeros((), bool)
            if plain != (True, True):
                bend = jax.jvp(lambda x: rise(x)[1], (s,), (jnp.ones_like(s),))[1]
                gone = (rate >= slope) & (bend >= 0) | (s * roots.root_rate[1] > 60)
                runs = over & ((slope < 0) | (plateau >= 1) & (slope <= 0)) & gone
            after = jnp.where(inside, newton, fallback)
            return _Search(after, low, high, jnp.abs(after - s), search.steps + 1, runs)

        zero, inf = jnp.zeros_like(start), jnp.full_like(start, jnp.inf)
        first = _Search(start, zero, inf, inf, jnp.zeros((), jnp.int32), at_edge <= 0)
        return lax.while_loop(unfinished, improve, first)

    found = solve(jnp.zeros_like(slope), start) if plain[1] else _with_slope(solve, slope, start, plateau)
    length, steps, runs = found.at, found.steps, found.runs
    given_up = ~(steps < MAX_STEPS) & ~(found.step <= ROUNDED * jnp.maximum(length, 1))
    valid = in_domain(slider) & jnp.isfinite(theta).all() & (jnp.abs(theta[3]) < 1)
    status = jnp.select(
        [~valid | ~(theta[4] > -1) | ~jnp.isfinite(at_edge), at_edge <= 0, runs, given_up],
        [
            ExactStatus.INVALID,
            ExactStatus.NO_DOMINO,
            ExactStatus.NEVER_STOPS,
            ExactStatus.NOT_CONVERGED,
        ],
        ExactStatus.ARRESTED,
    ).astype(length.dtype)
    values = jnp.asarray([0, 0, jnp.inf, jnp.nan, jnp.nan], length.dtype)
    return jnp.where(status == 0, length, values[status.astype(jnp.int32)]), status


def _with_slope(solve: Any, slope: Array, start: Array, plateau: Array) -> _Search:
    """First the crossing with a level threshold, which is a lower (ε < 0) or an upper (ε > 0) bound, then the true one."""
    level = solve(jnp.zeros_like(slope), start)
    has_level = (plateau < 1) & jnp.isfinite(level.at) & (level.at > 0.01)
    return solve(slope, jnp.where(has_level, level.at, 0.5))
