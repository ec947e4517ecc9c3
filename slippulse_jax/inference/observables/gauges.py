"""Slip and stress that gauges read along the interface after arrest.

The fields of the model go over smoothly from one whole count of contacts to the next.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slippulse_jax.inference.model.front import Along, Front, Predicted, by_jax
from slippulse_jax.inference.model.inputs import Input, Inputs, Linear
from slippulse_jax.inference.observables.observable import Observable, Observations, of_one
from slippulse_jax.inference.table.columns import OF_GAUGES
from slippulse_jax.inference.table.measurements import Measurements

if TYPE_CHECKING:
    from slippulse_jax.inference.parameters import ParameterSet

INPUTS = {
    "log_position": Input("x/λc", -np.inf, np.inf, ""),  # ln of a gauge's distance from the pushed edge
    "beyond": Input("", 0.0, 1.0, ""),  # contacts broken beyond ℓ, 0 to 1, when gauges were read
    "counted": Input("", 0.0, np.inf, ""),  # contacts counted as broken when gauges were read; 0 where they were not
}
"""Inputs of readings beside those of the front."""
FEW_SITES, MORE_SITES, MOST_SITES = 64, 4, 2**20
"""Smallest and largest number of contacts whose fields are computed, by steps of a factor; where a front runs farther than the
largest the prediction is inf."""


class Gauge(Observable):
    """What a gauge read after arrest."""

    which: ClassVar[int]  # of the fields of a model
    inputs = INPUTS
    noun = "reading"
    steps = True

    @property
    def named(self) -> str:
        """What was read."""
        return self.name

    @property
    def several(self) -> str:
        """Readings of any kind."""
        return "readings"

    def there(self, m: Measurements) -> bool:
        """Whether gauges read it."""
        return m.gauges is not None and bool(m.gauges.there(self.name).any())

    def stated_by(self, m: Measurements) -> str:
        """The table of gauges."""
        return f"{m.gauges.source}: what gauges read" if m.gauges is not None else ""

    def data(self, m: Measurements, q: "ParameterSet") -> Observations | None:
        """Readings of this kind."""
        gauges = m.gauges
        if gauges is None or m.correlation_length is None or not (there := gauges.there(self.name)).any():
            return None
        rows, still = gauges.row[there], np.zeros((there.sum(), len(q.free)))
        # a gauge at the very edge is placed a billionth of λc from it
        place = np.log(np.maximum(gauges.position[there] / m.correlation_length[rows], 1e-9))
        counted = np.where(np.array(m.kind)[rows] == "whole", m.length[rows], 0.0)
        none = np.zeros(len(m))
        unit = q.linear(none, {"correlation_length": 1})[rows]
        inputs = q.inputs.take(rows).given(
            log_position=Linear(place - unit.base, -unit.slope),  # x/λc shrinks as λc grows
            beyond=q.linear(none, {"arrest": 1})[rows],
            counted=Linear(counted, still),
        )
        value, sigma = (getattr(gauges, self.name + end)[there] for end in ("", "_sigma"))
        return self.observations(q, rows, value, sigma, inputs)

    def predict(self, model: Front, inputs: Inputs, relaxed: bool, *options: Any) -> Array:
        """Slip in u_s, or stress in σ_s, at a gauge.

        On the first contacts, of the number in `options`.

        By a straight line between two contacts; inf without arrest, and if the contacts are too few.
        """
        (sites,), lone = options, inputs.without(*INPUTS)
        # contact 0 has broken even where no domino starts
        free = jnp.maximum(model.length(lone, relaxed) + inputs.get("beyond"), 1)
        stopped = jnp.where(inputs.get("counted") > 0, inputs.get("counted"), free)
        place = jnp.exp(inputs.get("log_position"))
        known = (stopped < sites) & (place + 1 < sites)
        left = jnp.where(known, jnp.floor(place), 0).astype(jnp.int32)
        field = model.fields(lone, jnp.where(known, stopped, 1), sites)[self.which]
        return jnp.where(known, field[left] + (place - left) * (field[left + 1] - field[left]), jnp.inf)

    def evaluate(self, model: Front, inputs: Inputs, along: Along = None) -> Predicted:
        """Readings of many lanes, on few numbers of contacts."""
        counted = inputs.get("counted")
        stopped = np.where(counted > 0, counted, model.lengths(inputs.without(*INPUTS)) + inputs.get("beyond"))
        reach = np.maximum(stopped, np.exp(inputs.get("log_position"))) + 2
        # few array sizes, so that few programs are compiled
        steps = np.ceil(np.log(np.maximum(reach, FEW_SITES) / FEW_SITES) / np.log(MORE_SITES) - 1e-9)
        size = np.where(reach < MOST_SITES, FEW_SITES * MORE_SITES ** np.where(reach < MOST_SITES, steps, 0), 0).astype(int)
        found = np.zeros((1 if along is None else 3, len(reach)))
        found[0] = np.inf
        for count in np.unique(size[size > 0]).tolist():
            here, direction = size == count, None if along is None else along[size == count]
            found[:, here] = by_jax(of_one, model, inputs.take(here), direction, observable=self, options=(count,))
        return found

    def places(self, m: Measurements, data: Observations) -> list[str]:
        """Lines of the table of gauges."""
        return [m.gauges.place(i) for i in np.flatnonzero(m.gauges.there(self.name)).tolist()] if m.gauges is not None else []

    def options(self, model: Front, data: Observations, low: np.ndarray, high: np.ndarray) -> tuple[Any, ...]:
        """Number of contacts traced: eight times those needed amid the range."""
        middle = data.inputs.at((low + high) / 2)
        return (64 + 8 * int(max(np.exp(middle.get("log_position")).max(), middle.get("counted").max())),)


class Slip(Gauge):
    """Slip of the slider's side of the interface during the event."""

    name = "slip"
    which = 0
    column = OF_GAUGES["slip"]
    acts: ClassVar[Mapping[str, float]] = {"strength": 1, "areal_stiffness": -1}


class Stress(Gauge):
    """Shear stress on the contacts after arrest."""

    name = "stress"
    which = 1
    column = OF_GAUGES["stress"]
    acts: ClassVar[Mapping[str, float]] = {"strength": 1}
