"""Exact solution of many sliders at once, in NumPy.

In double precision: lengths ℓ* with derivatives, ℓ of long fronts, and where the edge breaks again; every lane by itself.

**Long fronts.** The recursion costs a nanosecond or two per lane and contact; the series
(`slippulse_jax.exact.double_series`), ten to twenty microseconds per lane. There ℓ is ℓ* to rounding.

**Breaking again.** Contact 0 repins as the front starts, and every later break adds to the stress that it carries. Beyond an
onset of the areal stiffness it is back at its threshold before the front stops.
"""

import warnings
from typing import Any, Literal, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax.base.domains import HEIGHT, POISSON
from slippulse_jax.base.status import Outcome
from slippulse_jax.bulk.chunks import Lanes, Layout, over_lanes
from slippulse_jax.exact import double_series
from slippulse_jax.exact.crossing import excess, expected_length, first_crossing, series_of
from slippulse_jax.exact.front import uniform
from slippulse_jax.front.arrest import LengthDerivatives
from slippulse_jax.interface import Interface
from slippulse_jax.slider import Slider, check_endless

EXACT_OUTCOMES = (Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.INVALID, Outcome.RUN_AWAY, Outcome.NOT_CONVERGED)
"""Possible outcomes of an exact front."""

ARREST_OUTCOMES = (*EXACT_OUTCOMES, Outcome.REBREAK)
"""Possible outcomes of an exact front, with the stress on the edge behind it."""

LAYOUT = Layout(chunk=32, fusion_emitters=False)
"""Lanes per chunk for which the second-level cache holds the rows of a table, with or without derivatives."""

LONG = 8000.0
"""Expected length from which the series is cheaper than the recursion, in λc (`benchmarks/lengths.py` measures where)."""

NEVER = 3.0
"""b below which contact 0 of a relaxed interface on level thresholds never breaks again: the onset falls towards 3.0872
(`slippulse_jax.theory.rebreaking_b`) as H/λc grows, and never below."""


# --- ℓ* and its derivatives ---------------------------------------------------------------------------------------------


@overload
def exact_lengths(slider: Slider, interface: Interface | None = None, *, derivatives: Literal[0] = 0) -> np.ndarray: ...
@overload
def exact_lengths(slider: Slider, interface: Interface | None = None, *, derivatives: Literal[1]) -> LengthDerivatives: ...
def exact_lengths(
    slider: Slider, interface: Interface | None = None, *, derivatives: Literal[0, 1] = 0
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
    derivatives : {0, 1}
        1 for derivatives with respect to H/λc, k/K, ν and, with an `interface`, φ and ε, or φ and r. For second ones use
        `exact_length`.

    Returns
    -------
    numpy.ndarray or LengthDerivatives
        float64, of the shape of the batch: 0 where no domino starts, inf where the front never stops, NaN where the crossing
        was not found, with a warning. With derivatives also these.

    Notes
    -----
    Relative error ≤ 1e-11, of derivatives 1e-8 of the largest. Derivatives are a program of their own, compiled on first use;
    the length is the same number.

    Raises
    ------
    ValueError, TypeError
        If `derivatives` is neither 0 nor 1; if the closed form does not hold for `interface`; if a value is traced by JAX.
    """
    check_endless("exact_lengths", slider)
    if derivatives not in (0, 1):
        raise ValueError(f"derivatives = {derivatives!r}: must be 0 or 1, the highest order of derivatives")
    numbers = slider.height, slider.stiffness, slider.poisson, *(() if interface is None else uniform(interface))
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
    flat = np.where(status == Outcome.ARRESTED, length.ravel(), 1)
    (found,) = over_lanes(_slopes, np.vstack([lanes, flat]), LAYOUT)
    # a constant where nothing follows contact 0; never a number where there is no length
    elsewhere = np.where(status == Outcome.NO_DOMINO, 0, np.nan)
    slopes = [x.reshape(shape) for x in np.where(status == Outcome.ARRESTED, found, elsewhere)]
    if interface is not None and interface.residual_strength is not None:  # of φ' = (φ − r)/(1 − r)
        by_prestress = slopes[3] / (1 - interface.residual_strength)
        slopes[3:] = [by_prestress, np.full(shape, np.nan), by_prestress * (interface.equivalent_prestress - 1)]
    return LengthDerivatives(length, *jax.tree.unflatten(jax.tree.structure((slider, interface)), slopes))


def exact_fronts(lanes: Float[np.ndarray, "fields n"]) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Length ℓ* and `Outcome` of every column (H/λc, k/K, ν[, φ, ε]).

    The caller has checked their domains.
    """
    ((length, status),) = over_lanes(_crossings, lanes, LAYOUT, _effort)
    return length, status.astype(np.int32)


def _crossings(theta: Float[Array, "fields lanes"]) -> tuple[Array]:
    return (jnp.stack(first_crossing(series_of(theta), theta)),)


def _effort(lanes: Lanes) -> np.ndarray:
    """Rank lanes by b, which determines the number of Newton steps."""
    with np.errstate(all="ignore"):
        height, stiffness, poisson = (np.asarray(x, np.float32) for x in lanes[:3])
        rank = np.log2(2 * (1 + poisson) * stiffness * height) * 256 + 16384
    return np.nan_to_num(rank, nan=65535).clip(0, 65535).astype(np.uint16)


def _slopes(lanes: Float[Array, "fields lanes"]) -> tuple[Array]:
    """Slopes of ℓ* in every parameter, at (θ, ℓ*)."""
    theta, length = lanes[:-1], lanes[-1]

    def along(direction: Array) -> Array:
        (_, slope), (change, _) = jax.jvp(lambda x: excess(series_of(x), x, length), (theta,), (direction,))
        return -change / slope

    return (jax.vmap(along)(jnp.broadcast_to(jnp.eye(len(theta))[..., None], (len(theta), *theta.shape))),)


# --- ℓ of long fronts ---------------------------------------------------------------------------------------------------


def which_are_long(lanes: Lanes) -> Int[np.ndarray, " m"]:
    """Lanes for which the series is used."""
    # no front is expected to be longer than √3 · ⅔ = 1.155 times the height
    tall = np.flatnonzero(lanes[0] >= LONG / 1.2)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        return tall[expected_length(*(field[tall] for field in lanes[:3])) >= LONG] if len(tall) else tall


def long_lengths(lanes: Lanes, most: int) -> Float[np.ndarray, " n"]:
    """Lengths ℓ of long relaxed lanes; NaN where the recursion must decide."""
    length, status = exact_fronts(np.stack([*lanes]))
    long = (length > LONG / 2) & (length < most)  # on stiff contacts it may be short after all
    return np.where((status == Outcome.ARRESTED) & long, length, np.nan)


# --- where contact 0 breaks again ---------------------------------------------------------------------------------------


def exact_arrests(lanes: Float[np.ndarray, "5 n"]) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """As `exact_fronts`, with `REBREAK` among the outcomes."""
    length, status, edge = _with_edge(lanes)
    return length, np.where(edge >= 1, np.int32(Outcome.REBREAK), status)


def _with_edge(
    lanes: Float[np.ndarray, "5 n"],
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """As `exact_fronts`, with the stress on contact 0 behind the front.

    NaN where it cannot reach its threshold.
    """
    length, status = exact_fronts(lanes)
    edge = np.full(length.shape, np.nan)
    b = 2 * (1 + lanes[2]) * lanes[1] * lanes[0]
    may = (status == Outcome.ARRESTED) & ((b >= NEVER) | (lanes[3:] != 0).any(0))
    if may.any():
        behind = np.vstack([lanes[:, may], np.maximum(np.ceil(length[may]), 1)])
        (edge[may],) = over_lanes(_edges, behind, LAYOUT)
    return length, status, edge


def _edges(lanes: Float[Array, "6 lanes"]) -> tuple[Array]:
    """Stress on contact 0 at (θ, contacts broken)."""
    return (double_series.edge_stress(series_of(lanes[:5]), lanes[5]),)


def rebreaking_onset(height: Any, poisson: Any, prestress: Any = 0.0, residual_strength: Any = 0.0) -> Float[np.ndarray, "..."]:
    """Smallest b at which contact 0 breaks again before the front stops.

    b is the areal shear stiffness of the interface times H over the shear modulus (`Slider.b`). Beyond the onset the event is
    no longer one front, and goes farther than it: the status is `REBREAK`.

    Parameters
    ----------
    height, poisson, prestress, residual_strength : array_like
        H/λc, ν, φ and r, which broadcast.

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

    for name, domain, value in (("height", HEIGHT, height), ("poisson", POISSON, poisson)):
        domain.check(f"rebreaking_onset: {name}", value)
    equivalent = Interface(prestress, 0.0, residual_strength).equivalent_prestress
    height, poisson, prestress = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (height, poisson, equivalent)))

    def overload(b: Float[np.ndarray, "*n"], *given: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Excess on contact 0, in σ_s; −1 where it cannot break again."""
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
