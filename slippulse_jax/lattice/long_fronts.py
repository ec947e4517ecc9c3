"""Lengths of long fronts by the exact solution, at a cost that does not grow with the length.

The recursion costs a nanosecond or two per lane and contact; the series (`slippulse_jax.double_series`), a microsecond or
a few per lane. ℓ joins the stresses at whole contacts by a straight line, so it follows from the series at the two
contacts around ℓ*.

Where a front crosses so far from the edge that only one family and one column of the series matter, a step of Newton's method
costs next to nothing, and a lane little more than its table.
"""

import functools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from slippulse_jax import double_series as series
from slippulse_jax.bulk.chunks import Kernel, Lanes, Layout, over_lanes
from slippulse_jax.lattice.crossing import crossing_far, crossing_in_bulk, system_of
from slippulse_jax.lattice.front import straight_line
from slippulse_jax.status import Outcome

LONG = 2000.0
"""Expected length from which the series is cheaper than the recursion, in λc (`benchmarks/lengths.py` measures where)."""

NEAR, FAR = Layout(chunk=128), Layout(chunk=240)
"""Lanes per chunk for which the table of the series, or the rows of a narrow one, fit into the second-level cache."""

NEGLIGIBLE, LIFT = 35, 0.01
"""Expected decay exponent at the crossing, and b, from which the far series is tried. A front is 5 to 11 % longer than
expected; the series holds from the exponent `slippulse_jax.double_series.FAR` on, and loses the digits of b."""


def which_are_long(lanes: Lanes) -> Int[np.ndarray, " m"]:
    """Lanes for which the series is used."""
    # no front is expected to be longer than √3 · ⅔ = 1.155 times the height
    tall = np.flatnonzero(lanes[0] >= LONG / 1.2)
    return tall[_expected([field[tall] for field in lanes[:3]])[0] >= LONG] if len(tall) else tall


def which_are_far(lanes: Lanes) -> Bool[np.ndarray, " n"]:
    """Relaxed lanes that are expected to cross where the far series holds."""
    return _expected(lanes)[1] >= NEGLIGIBLE


def _expected(lanes: Lanes) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Length in λc, and −ln of what is left of ρ_1^s there; 0 for the latter where b is too small for the far series.

    By a lane's own numbers and correctly rounded operations alone, which round the same way everywhere. The length is the
    leading term of Eq. (25), ln[2/(1+β)]/κ_2, with ln(1 + x) ≈ 2x/(2 + x); −ln ρ_1 is about κ_1 [1 − b/(2 + 2b)] for tall
    sliders.
    """
    height, stiffness, poisson = lanes[:3]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        shape = 2 * (1 + poisson)
        b = shape * stiffness * height
        x = b / (2 + b)
        expected = 2 * x / (2 + x) * height * np.sqrt(shape * (1 + 1 / b))
        exponents = expected * np.sqrt((1 + b) / (shape * height)) * (2 + b) / (2 + 2 * b)
    return expected, np.where(b >= LIFT, exponents, 0)


def long_lengths(lanes: Lanes, max_contacts: int) -> Float[np.ndarray, " n"]:
    """ℓ of relaxed lanes; NaN where the search did not settle, which the recursion then has to decide."""
    found = np.full(len(lanes[0]), np.nan)
    for kernel, layout, tried in ((_far, FAR, which_are_far(lanes)), (_near, NEAR, True)):
        left = np.flatnonzero(np.isnan(found) & tried)
        if len(left):
            (found[left],) = over_lanes(kernel(max_contacts), [x[left] for x in lanes], layout)
    return found


@functools.cache
def _far(max_contacts: int) -> Kernel:
    def lengths(parameters: Float[Array, "3 lanes"]) -> tuple[Array, ...]:
        with jax.numpy_rank_promotion("allow"):
            found = series.solve_far(system_of(parameters, prestressed=False))
            return _straight(partial(series.rise_far, found), crossing_far(found, parameters), max_contacts)

    return lengths


@functools.cache
def _near(max_contacts: int) -> Kernel:
    def lengths(parameters: Float[Array, "3 lanes"]) -> tuple[Array, ...]:
        with jax.numpy_rank_promotion("allow"):
            found = series.solve(system_of(parameters, prestressed=False), regular=False)
            relaxed = jnp.concatenate([parameters, jnp.zeros((2, parameters.shape[1]))])
            return _straight(partial(series.rise, found), crossing_in_bulk(found, relaxed), max_contacts)

    return lengths


def _straight(rise: series.Rise, crossed: tuple[Array, Array], max_contacts: int) -> tuple[Array, ...]:
    """ℓ from ℓ* and its outcome."""
    exact, status = crossed
    last = jnp.floor(exact)  # the last contact that breaks
    length = straight_line(last, rise(last)[0], rise(last + 1)[0])
    return (jnp.where((status == Outcome.ARRESTED) & (length < max_contacts), length, jnp.nan),)
