"""A crack-like front, behind which contacts slide."""

from collections.abc import Collection

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.bulk.chunks import over_lanes
from slippulse_jax.exact import crack
from slippulse_jax.inference.model.front import (
    LANES,
    RISING,
    Front,
    numbers_of,
    sliders,
)
from slippulse_jax.inference.model.inputs import Input, Inputs
from slippulse_jax.inference.table.measurements import Measurements
from slippulse_jax.slider import Slider


class CrackFront(Front):
    """A crack-like front, behind which contacts slide, in closed form."""

    event = "crack"
    rising = RISING
    inputs = {"friction": Input("σ_k/σ_s", 0.0, 1.0, "must be 0 or more, and below 1", 1e-5, (0.0, np.inf))}
    name = "first crack-like precursor"
    length_modelled = "contacts behind it slide at the friction σ_k; exact length"
    lengths_are_of = "crack-like fronts"

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Ask for a friction, and refuse ends and sloping thresholds."""
        if "friction" not in names:
            raise ValueError("event = 'crack': friction is neither fitted nor held; in σ_s, as fixed = {'friction': 0.3}")
        if "threshold_slope" in names:
            raise ValueError("parameter threshold_slope: a crack-like front has a closed form on level thresholds only")
        if m.or_zero("residual_strength").any():
            raise ValueError(f"{m.source}: event = 'crack': contacts carry their friction: leave out residual_strength")
        if m.block_length is not None or m.machine_stiffness is not None:
            raise ValueError("event = 'crack': for a block without end, whose edge is held")
        if m.or_zero("threshold_slope").any():
            raise ValueError(f"{m.source}: event = 'crack' takes level thresholds, without threshold_slope")

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """No friction: it is fitted or held."""
        return {"friction": np.zeros(len(m))}

    def length(self, inputs: Inputs, relaxed: bool) -> Array:
        """Length of one crack-like front, in λc."""
        return crack.length(sliders(inputs, jnp.exp), inputs.get("friction"), inputs.prestress)[0]

    def status(self, inputs: Inputs) -> np.ndarray:
        """Outcome of each crack-like front."""
        return over_lanes(_crack_status, [*numbers_of(inputs)[:4], inputs.get("friction")], LANES)[0]

    def fields(self, inputs: Inputs, stopped: Array, count: int) -> tuple[Array, Array]:
        """Slip and stress of the first `count` contacts of one front, traced."""
        slider, friction = sliders(inputs, jnp.exp), inputs.get("friction")
        site = jnp.arange(count, dtype=jnp.result_type(stopped))
        return jax.vmap(lambda one: crack.fields(slider, friction, inputs.prestress, stopped, one))(site)


def _crack_status(lanes: Float[Array, "5 L"]) -> tuple[Array]:
    """Status of crack-like fronts at H/λc, k/K, ν, φ and σ_k."""
    return (jax.vmap(lambda lane: crack.length(Slider(*lane[:3]), lane[4], lane[3])[1], 1)(lanes),)
