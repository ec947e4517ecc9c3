"""Lengths of long fronts by the exact solution, at a cost that does not grow with the length.

The recursion costs a nanosecond or two per lane and contact; the series (`slippulse_jax.double_series`), some microseconds per
lane. ℓ joins the stresses at whole contacts by a straight line, so it follows from the series at the two
contacts around ℓ*.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from slippulse_jax import double_series as series
from slippulse_jax.bulk.chunks import Kernel, Lanes, Layout
from slippulse_jax.lattice.crossing import crossing_in_bulk, system_of
from slippulse_jax.lattice.front import straight_line
from slippulse_jax.status import Outcome

LONG = 2000.0
"""Expected length from which the series is cheaper than the recursion, in λc (`benchmarks/lengths.py` measures where)."""

LAYOUT = Layout(chunk=128)
"""As many lanes a chunk as leave the table of the series in the second-level cache."""


def which_are_long(lanes: Lanes) -> Int[np.ndarray, " m"]:
    """Lanes for which the series is used, by a rule that looks at a lane's own numbers and rounds the same way everywhere.

    The leading term of Eq. (25), ln[2/(1+β)]/κ_2, with ln(1 + x) ≈ 2x/(2 + x): correctly rounded operations only.
    """
    # no front is expected to be longer than √3 · ⅔ = 1.155 times the height
    tall = np.flatnonzero(lanes[0] >= LONG / 1.2)
    if not len(tall):
        return tall
    height, stiffness, poisson = (field[tall] for field in lanes[:3])
    shape = 2 * (1 + poisson)
    b = shape * stiffness * height
    x = b / (2 + b)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        return tall[2 * x / (2 + x) * height * np.sqrt(shape * (1 + 1 / b)) >= LONG]


@functools.cache
def long_length_kernel(max_contacts: int) -> Kernel:
    """ℓ of relaxed lanes; NaN where the search did not settle, which the recursion then has to decide."""

    def lengths(parameters: Float[Array, "3 lanes"]) -> tuple[Array, ...]:
        with jax.numpy_rank_promotion("allow"):
            found = series.solve(system_of(parameters, prestressed=False), regular=False)
            relaxed = jnp.concatenate([parameters, jnp.zeros((2, parameters.shape[1]))])
            exact, status = crossing_in_bulk(found, relaxed)
            last = jnp.floor(exact)  # the last contact that breaks
            behind, ahead = series.rise(found, last)[0], series.rise(found, last + 1)[0]
        length = straight_line(last, behind, ahead)
        return (jnp.where((status == Outcome.ARRESTED) & (length < max_contacts), length, jnp.nan),)

    return lengths
