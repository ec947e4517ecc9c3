"""Displacement and force at nucleation, in closed form."""

from collections.abc import Collection, Mapping
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.inference.model.front import Front, sliders
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.observables.observable import Observable
from slippulse_jax.inference.table.columns import COLUMNS, OVER_ALL
from slippulse_jax.inference.table.measurements import Measurements
from slippulse_jax.slider import Slider


class Displacement(Observable):
    """Displacement of the pushed edge at nucleation."""

    name = noun = "displacement"
    column = COLUMNS["displacement"]
    acts: ClassVar[Mapping[str, float]] = {"strength": 1, "areal_stiffness": -1}
    drawn_as = 2

    def predict(self, model: Front, inputs: Inputs, relaxed: bool, *options: Any) -> Array:
        """Displacement in u_s = f_s/k."""
        return (1 - inputs.prestress) * lattice_modes(_displaced(inputs)).load


class Force(Observable):
    """Driving force at nucleation, over the width of the block."""

    name = noun = "force"
    column = COLUMNS["force"]
    acts: ClassVar[Mapping[str, float]] = {"strength": 1, "correlation_length": 1}
    added = "force_offset"
    drawn_as = 1

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse later events: the model is of the first."""
        if (later := m.or_zero("event") > 1).any():
            i = int(np.argmax(later))
            raise ValueError(
                f"{m.place(i)}, column {m.heading('event')}: {m.or_zero('event')[i]:g}: later events are those of a block, "
                "with push_height and its length (docs/fit/sequence.md); leave them out to fit the first"
            )

    def unit(self, m: Measurements) -> tuple[np.ndarray, Mapping[str, float]]:
        """Unit σ_s λc; and the width, of forces stated over it."""
        return np.log(m.metres), {**self.acts, "block_width": m.heading("force").endswith(OVER_ALL)}

    def predict(self, model: Front, inputs: Inputs, relaxed: bool, *options: Any) -> Array:
        """Force in f_s, the threshold of one contact.

        It is the sum over the contacts, Σ_i Σ_m C_m y_m(i), a geometric series in each mode.
        """
        slider = _displaced(inputs)
        modes = lattice_modes(slider)
        every = modes.drive / modes.gap
        if slider.length is not None:  # there and, from the free end, back again: 1 + r + … + r^{2N − 1}
            every = every * -jnp.expm1(2 * slider.length * jnp.log1p(-modes.gap))
        return (1 - inputs.prestress) * every.sum()


def _displaced(inputs: Inputs) -> Slider:
    """The slider whose edge is displaced, without its machine."""
    return sliders(inputs.without("log_machine"), jnp.exp)
