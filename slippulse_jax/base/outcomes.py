"""Outcomes of events as arrays, and lengths with them."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Int

from slippulse_jax.base.status import Outcome


def first_of(endings: dict[Any, Any]) -> Int[Array, "..."]:
    """The first `Outcome` whose condition holds; `ARRESTED` if none does."""
    return jnp.select(jnp.broadcast_arrays(*endings.values()), list(endings), Outcome.ARRESTED).astype(jnp.int32)


def outcome(
    broken: Array, goes: Array, edge: Array, *, valid: Any, through: Any = False, endless: Any = False
) -> Int[Array, "..."]:
    """`Outcome` of fronts.

    Given are the contacts broken, whether the one ahead breaks, and the excess on contact 0 behind them.
    """
    endings = {
        Outcome.INVALID: ~valid,
        Outcome.RAN_THROUGH: through,
        Outcome.RUN_AWAY: goes & endless,
        Outcome.LIMIT: goes,
        Outcome.NO_DOMINO: broken == 1,
        Outcome.REBREAK: edge >= 0,
    }
    return first_of(endings)


def length_or_reason(status: Array, length: Array) -> Array:
    """`length` of fronts that stopped; else 0, inf or NaN."""
    stopped = (status == Outcome.ARRESTED) | (status == Outcome.REBREAK)
    none = (status == Outcome.NO_DOMINO) | (status == Outcome.NOTHING_BROKE)
    infinite = (status == Outcome.RAN_THROUGH) | (status == Outcome.RUN_AWAY)
    # 0 where the length itself is taken too: reverse mode multiplies what is not taken by zero, and NaN stays NaN
    instead = jnp.where(stopped | none, 0, jnp.where(infinite, jnp.inf, jnp.nan))
    # where nothing is left to break, the curve may have no end
    return jnp.where(stopped, length, instead * (1 + jnp.where(jnp.isnan(length), 0, jnp.abs(length))))
