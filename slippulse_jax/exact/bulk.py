"""The exact solution by the million: ℓ* with derivatives, ℓ of long fronts, and where the edge breaks again.

NumPy in and out, double precision, every lane by itself.

**Long fronts.** The recursion costs a nanosecond or two per lane and contact; the series (`slippulse_jax.double_series`), a
microsecond or a few per lane. There ℓ is ℓ* to rounding. Where a front crosses so far from the edge that only one family and
one column of the series matter, a step of Newton's method costs next to nothing, and a lane little more than its table.

**Breaking again.** Contact 0 repins as the front starts, and every later break adds to the stress that it carries. Beyond an
onset of the areal stiffness it is back at its threshold before the front stops.
"""

import functools
import warnings
from typing import Any, Literal, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax import double_series
from slippulse_jax.base.domains import HEIGHT, POISSON, PRESTRESS, check_kind
from slippulse_jax.base.status import Outcome
from slippulse_jax.bulk.chunks import Kernel, Lanes, Layout, over_lanes
from slippulse_jax.double_series import Table
from slippulse_jax.exact.crossing import excess, expected_length, first_crossing, series_of
from slippulse_jax.exact.front import uniform
from slippulse_jax.front.arrest import LengthDerivatives
from slippulse_jax.interface import Interface
from slippulse_jax.slider import Slider

EXACT_OUTCOMES = (Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.INVALID, Outcome.RUN_AWAY, Outcome.NOT_CONVERGED)
"""Possible outcomes of an exact front."""

ARREST_OUTCOMES = (*EXACT_OUTCOMES, Outcome.REBREAK)
"""Possible outcomes of an exact front, with the stress on the edge behind it."""

LAYOUTS: dict[Table, Layout] = {
    "far": Layout(chunk=240),
    "plain": Layout(chunk=128, fusion_emitters=False),
    "regular": Layout(chunk=32, fusion_emitters=False),
}
"""Lanes per chunk for which the second-level cache holds the rows of a far table; a plain table; a regular one, with or without
derivatives."""

LONG = 2000.0
"""Expected length from which the series is cheaper than the recursion, in λc (`benchmarks/lengths.py` measures where)."""

DECAY, LIFT = 35, 0.01
"""Expected decay exponent at the crossing, and b, from which a far table is tried. A front is 5 to 11 % longer than expected;
the table holds from the exponent `slippulse_jax.double_series.ROUNDING_EXPONENT` on, and loses the digits of b."""

NEVER = 3.0
"""b below which contact 0 of a relaxed interface on level thresholds never breaks again: the onset falls towards 3.0872
(`slippulse_jax.theory.rebreaking_b`) as H/λc grows, and never below."""


# --- ℓ* and its derivatives ---------------------------------------------------------------------------------------------


@overload
def exact_lengths(slider: Slider, interface: Interface | None = None, *, derivatives: Literal[0] = 0) -> np.ndarray: ...
@overload
def exact_lengths(slider: Slider, interface: Interface | None = None, *, derivatives: Literal[1, 2]) -> LengthDerivatives: ...
def exact_lengths(
    slider: Slider, interface: Interface | None = None, *, derivatives: Literal[0, 1, 2] = 0
) -> np.ndarray | LengthDerivatives:
    """Lengths ℓ* of a batch of any size, and their derivatives.

    Lengths are in λc.

    The numbers of `exact_length` in double precision whatever the JAX flags, at a cost that does not grow with ℓ*. The
    result of a lane depends on that lane alone. Not traceable: inside ``jit`` use `exact_length`.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast.
    interface : Interface, optional
        As for `exact_length`.
    derivatives : {0, 1, 2}
        Highest order of derivatives, with respect to H/λc, k/K, ν and, with an `interface`, φ, ε.

    Returns
    -------
    numpy.ndarray or LengthDerivatives
        float64, of the shape of the batch: 0 where no domino starts, inf where the front never stops, NaN where the crossing
        was not found, with a warning. With derivatives also these and, for the order 2, the Hessian.

    Notes
    -----
    Relative error ≤ 1e-11, of derivatives 1e-8 of the largest. Each order of derivatives is a program of its own, compiled on
    first use; the length is the same number in all.

    Raises
    ------
    ValueError, TypeError
        If `derivatives` is none of 0, 1, 2; if the closed form does not hold for `interface`; if a value is traced by JAX.
    """
    check_kind("slider", slider, Slider)
    if derivatives not in (0, 1, 2):
        raise ValueError(f"derivatives = {derivatives!r}: must be 0, 1 or 2, the highest order of derivatives")
    numbers = slider.height, slider.stiffness, slider.poisson, *uniform(interface)
    if any(isinstance(x, Tracer) for x in numbers):
        raise TypeError("exact_lengths needs NumPy arrays; inside jit, grad or vmap use exact_length")
    shape = np.broadcast_shapes(*(np.shape(x) for x in numbers))
    lanes = np.stack([np.broadcast_to(np.asarray(x, np.float64), shape).ravel() for x in numbers])
    length, status = exact_fronts(lanes)
    lost = np.isnan(length)
    if lost.any():
        first = tuple(int(i) for i in np.unravel_index(np.argmax(lost), shape))
        why = Outcome(int(status[lost][0])).message
        message = f"{lost.sum()} of {lost.size} exact lengths, the first at index {first}, are NaN: {why}"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
    length = length.reshape(shape)
    if not derivatives:
        return length
    count = 3 if interface is None else 5
    flat = np.where(status == Outcome.ARRESTED, length.ravel(), 1)
    found = over_lanes(_derivatives(count, derivatives), np.vstack([lanes, flat]), LAYOUTS["regular"])
    # a constant where nothing follows contact 0; never a number where there is no length
    elsewhere = np.where(status == Outcome.NO_DOMINO, 0, np.nan)
    first, *second = (np.where(status == Outcome.ARRESTED, x, elsewhere) for x in found)
    hessian = np.moveaxis(second[0], -1, 0).reshape(*shape, count, count) if second else None
    slopes = jax.tree.unflatten(jax.tree.structure((slider, interface)), [x.reshape(shape) for x in first])
    return LengthDerivatives(length, *slopes, hessian=hessian)


def exact_fronts(
    lanes: Float[np.ndarray, "5 n"], *, one_program: bool = False
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Length ℓ* and `Outcome` of every column (H/λc, k/K, ν, φ, ε), whose domains the caller has checked.

    The values of a lane choose its program; lanes that one program leaves go to the next. Relaxed lanes that cross far from the
    edge use a far table; the others a plain one, which has one more family of terms with a prestress. The few lanes for which
    that does not give every digit use a regular table, which takes longer.

    With `one_program` lanes far from the edge have no program of their own, and their last digits differ: compiling one more
    takes longer than some thousand lanes do.
    """
    found = np.full((2, lanes.shape[1]), float(Outcome.NOT_CONVERGED))
    relaxed = lanes[3] == 0
    far = relaxed & (lanes[4] == 0) & (not one_program) & which_are_far(lanes)

    def settle(table: Table, prestressed: bool, wanted: Any) -> None:
        left = (found[1] == Outcome.NOT_CONVERGED) & wanted
        if left.any():
            rank = _effort if table == "plain" else None
            (found[:, left],) = over_lanes(fronts(table, prestressed), lanes[:, left], LAYOUTS[table], rank)

    settle("far", False, far)
    settle("plain", False, relaxed)
    settle("plain", True, ~relaxed)
    settle("regular", True, True)
    return found[0], found[1].astype(np.int32)


@functools.cache
def fronts(table: Table, prestressed: bool) -> Kernel:
    """ℓ* and `Outcome` of lanes by one kind of table."""

    def kernel(theta: Float[Array, "5 lanes"]) -> tuple[Array]:
        found = series_of(theta if prestressed else theta[:3], table)
        return (jnp.stack(first_crossing(found, theta)),)

    return kernel


@functools.cache
def _derivatives(count: int, order: int) -> Kernel:
    """Slopes of ℓ* in the first `count` parameters, and with the order 2 their slopes, at (θ, ℓ*)."""

    def slopes(theta: Float[Array, "5 lanes"], length: Float[Array, " lanes"]) -> Float[Array, "{count} lanes"]:
        def at_length(theta: Array) -> tuple[Array, Array]:
            return excess(series_of(theta[:count]), theta[:count], length)

        def slope_along(direction: Array) -> tuple[Array, Array]:
            (_, slope), (change, _) = jax.jvp(at_length, (theta,), (direction,))
            return change, slope

        change, slope = jax.vmap(slope_along, out_axes=(0, None))(axes(theta))
        return -change / slope

    def axes(theta: Array) -> Array:
        """Directions along the parameters."""
        return jnp.broadcast_to(jnp.eye(5)[:count, :, None], (count, *theta.shape))

    def kernel(lanes: Float[Array, "6 lanes"]) -> tuple[Array, ...]:
        theta, length = lanes[:5], lanes[5]
        first = slopes(theta, length)
        if order == 1:
            return (first,)
        second = jax.vmap(lambda way, moves: jax.jvp(slopes, (theta, length), (way, moves))[1])(axes(theta), first)
        return first, second

    return kernel


def _effort(lanes: Lanes) -> np.ndarray:
    """Rank lanes by expected work, so that similar ones share a chunk.

    b determines the number of Newton steps of soft lanes (b < 1/2), κ the number of rows of stiff ones. A prestress above 1/2
    may exceed that of run-away, where the search is a different one.
    """
    height, stiffness, poisson, *more = (np.asarray(x, np.float32) for x in lanes[:4])
    with np.errstate(all="ignore"):
        transverse = 1 / (2 * (1 + poisson) * height)
        b = stiffness / transverse
        rank = (
            np.log2(np.where(b < 0.5, b, 2**40 * (stiffness + transverse))) * 256
            + 16384
            + 32768 * (more[0] > 0.5 if more else 0)
        )
    return np.nan_to_num(rank, nan=65535).clip(0, 65535).astype(np.uint16)


# --- ℓ of long fronts ---------------------------------------------------------------------------------------------------


def which_are_long(lanes: Lanes) -> Int[np.ndarray, " m"]:
    """Lanes for which the series is used."""
    # no front is expected to be longer than √3 · ⅔ = 1.155 times the height
    tall = np.flatnonzero(lanes[0] >= LONG / 1.2)
    return tall[_expected([field[tall] for field in lanes[:3]])[0] >= LONG] if len(tall) else tall


def which_are_far(lanes: Lanes) -> Bool[np.ndarray, " n"]:
    """Relaxed lanes that are expected to cross where the far series holds."""
    return _expected(lanes)[1] >= DECAY


def _expected(lanes: Lanes) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Length in λc, and −ln of what is left of ρ_1^s there; 0 for the latter where b is too small for the far series.

    By a lane's own numbers alone, as in `expected_length`; −ln ρ_1 is about κ_1 [1 − b/(2 + 2b)] for tall sliders.
    """
    height, stiffness, poisson = lanes[:3]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        shape = 2 * (1 + poisson)
        b = shape * stiffness * height
        expected = expected_length(height, stiffness, poisson)
        exponents = expected * np.sqrt((1 + b) / (shape * height)) * (2 + b) / (2 + 2 * b)
    return expected, np.where(b >= LIFT, exponents, 0)


def long_lengths(lanes: Lanes, max_contacts: int) -> Float[np.ndarray, " n"]:
    """ℓ of relaxed lanes; NaN where the search did not settle, which the recursion then has to decide."""
    found = np.full(len(lanes[0]), np.nan)
    tables: dict[Table, Any] = {"far": which_are_far(lanes), "plain": True}
    for table, tried in tables.items():
        left = np.flatnonzero(np.isnan(found) & tried)
        if len(left):
            rank = _effort if table == "plain" else None
            (found[left],) = over_lanes(_long(table, max_contacts), [x[left] for x in lanes], LAYOUTS[table], rank)
    return found


@functools.cache
def _long(table: Table, max_contacts: int) -> Kernel:
    """ℓ*, from which the curve of ℓ departs by less than rounding."""

    def lengths(theta: Float[Array, "3 lanes"]) -> tuple[Array]:
        length, status = first_crossing(series_of(theta, table), theta)
        long = (length > LONG / 2) & (length < max_contacts)  # on stiff contacts it may be short after all
        return (jnp.where((status == Outcome.ARRESTED) & long, length, jnp.nan),)

    return lengths


# --- where contact 0 breaks again ---------------------------------------------------------------------------------------


def exact_arrests(lanes: Float[np.ndarray, "5 n"]) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """As `exact_fronts`, with `REBREAK` among the outcomes."""
    length, status, edge = _with_edge(lanes)
    return length, np.where(edge >= 1, np.int32(Outcome.REBREAK), status)


def _with_edge(
    lanes: Float[np.ndarray, "5 n"],
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """As `exact_fronts`, with the stress on contact 0 behind the front; NaN where it cannot reach its threshold."""
    length, status = exact_fronts(lanes)
    edge = np.full(length.shape, np.nan)
    b = 2 * (1 + lanes[2]) * lanes[1] * lanes[0]
    may = (status == Outcome.ARRESTED) & ((b >= NEVER) | (lanes[3:] != 0).any(0))
    for table in ("plain", "regular"):
        left = may & np.isnan(edge)
        if left.any():
            behind = np.vstack([lanes[:, left], np.maximum(np.ceil(length[left]), 1)])
            (edge[left],) = over_lanes(_edges(table), behind, LAYOUTS[table])
    return length, status, edge


@functools.cache
def _edges(table: Table) -> Kernel:
    """Stress on contact 0 at (θ, contacts broken)."""
    return lambda lanes: (double_series.edge_stress(series_of(lanes[:5], table), lanes[5]),)


def rebreaking_onset(height: Any, poisson: Any, prestress: Any = 0.0) -> Float[np.ndarray, "..."]:
    """Smallest b at which contact 0 breaks again before the front stops.

    b is the areal shear stiffness of the interface times H over the shear modulus (`Slider.b`). Beyond the onset the event is
    no longer one front, and goes farther than it: the status is `REBREAK`.

    Parameters
    ----------
    height, poisson, prestress : array_like
        H/λc, ν and φ, which broadcast.

    Returns
    -------
    numpy.ndarray
        float64; inf where contact 0 never breaks again, as in sliders of H/λc < 7. It tends to
        `slippulse_jax.theory.rebreaking_b` = 3.0872 for tall sliders, about as 5.5 (H/λc)^{−1/2}.

    Notes
    -----
    The first change of status on a grid of b, refined. In short sliders contact 0 holds again where b is large, because
    the front is shorter there.
    """
    from scipy.optimize.elementwise import find_root  # here, because it adds a third to the import of all that ℓ needs

    for name, domain, value in (("height", HEIGHT, height), ("poisson", POISSON, poisson), ("prestress", PRESTRESS, prestress)):
        domain.check(f"rebreaking_onset: {name}", value)
    height, poisson, prestress = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (height, poisson, prestress)))

    def overload(b: Float[np.ndarray, "*n"], *given: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Excess on contact 0 behind the front, in σ_s; −1 where it cannot break again."""
        b, H, nu, phi = np.broadcast_arrays(b, *given)
        lanes = np.stack([x.ravel() for x in (H, b / (2 * (1 + nu) * H), nu, phi, np.zeros(b.shape))])
        return np.nan_to_num(_with_edge(lanes)[2] - 1, nan=-1).reshape(b.shape)

    every = [x.ravel() for x in (height, poisson, prestress)]
    grid = np.geomspace(NEVER, 100 * NEVER, 128)
    again = overload(grid, *(x[:, None] for x in every)) >= 0
    first, onset = again.argmax(1), np.full(height.size, np.inf)
    some = again.any(1)
    bracket = [grid[np.maximum(first[some] - before, 0)] for before in (1, 0)]
    onset[some] = find_root(overload, bracket, args=tuple(x[some] for x in every), tolerances={"xrtol": 1e-12}).bracket[1]
    return onset.reshape(height.shape)
