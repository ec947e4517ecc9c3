"""Observables beside the length: force and displacement at nucleation, slip and stress at gauges after arrest.

Force and displacement are closed forms in the two lattice modes. Gauges read slip and stress along the interface when the
front has stopped, which go over smoothly from one whole count of contacts to the next.
"""

from collections.abc import Callable, Collection
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.bulk.chunks import Layout, distinct_rows, over_lanes
from slippulse_jax.inference.fronts import ENDED, Front, Prediction, by_differences, ends_of, sliders
from slippulse_jax.inference.inputs import COMMON, Input, Inputs

LANES = 256
"""Lanes of a chunk."""
OF_GAUGES = {
    "log_position": Input("x/λc", -np.inf, np.inf, ""),  # ln of a gauge's distance from the pushed edge
    "beyond": Input("", 0.0, 1.0, ""),  # contacts broken beyond ℓ*, 0 to 1, when gauges were read
    "counted": Input("", 0.0, np.inf, ""),  # contacts counted as broken when gauges were read; 0 where they were not
}
"""Inputs of readings beside those of the front."""
FIELD_STEP = 0.1
"""Factor on the steps of differences for fields, which bend from contact to contact more than a length does."""
FEW_SITES, MOST_SITES = 64, 2**20
"""Smallest and largest number of contacts whose fields are computed; where a front runs farther the prediction is inf."""
TOGETHER = 32
"""Fronts whose fields are computed in one call, which always computes all of them; a fit often needs few."""


def displacements(front: Front, inputs: Inputs, wanted: Collection[str] = ()) -> Prediction:
    """Displacement of the pushed edge at nucleation, in u_s = f_s/k; exact derivatives."""
    return _at_nucleation(0, inputs, wanted)


def forces(front: Front, inputs: Inputs, wanted: Collection[str] = ()) -> Prediction:
    """Driving force at nucleation, which is the sum over the contacts, in f_s, the threshold of one contact."""
    return _at_nucleation(1, inputs, wanted)


def _nucleation(inputs: Inputs) -> Float[Array, " 2"]:
    """Displacement and force at nucleation; the force is Σ_i Σ_m C_m y_m(i), a geometric series in each mode.

    The displacement is that of the edge, whatever pushes it.
    """
    ends = ends_of(inputs.without("log_machine"), jnp.exp)
    modes = lattice_modes(sliders(inputs, jnp.exp), ends)
    force = modes.drive / modes.gap
    if ends.sites is not None:  # there and, from the free end, back again: 1 + r + … + r^{2N − 1}
        force = force * -jnp.expm1(2 * ends.sites * jnp.log1p(-modes.gap))
    return (1 - inputs.prestress) * jnp.stack([modes.load, force.sum()])


def _nucleation_with_slopes(lanes: Float[Array, "n L"]) -> tuple[Array, Array]:
    """Both quantities of many lanes, and their derivatives, (2, n, L): they are usually measured together."""

    def one(lane: Array) -> Array:
        return _nucleation(Inputs(*lane[:5], more={"log_sites": lane[5]} if len(lane) > 5 else {}))

    return jax.vmap(one, 1, -1)(lanes), jax.vmap(jax.jacfwd(one), 1, -1)(lanes)


def _at_nucleation(which: int, inputs: Inputs, wanted: Collection[str]) -> Prediction:
    names = (*COMMON, *(name for name in ENDED[:1] if name in inputs.more))  # on nothing else does it depend
    lanes = [inputs.get(name) for name in names]
    value, slopes = over_lanes(_nucleation_with_slopes, lanes, Layout(chunk=LANES))
    none = np.zeros(len(value[which]))
    by_name = dict(zip(names, slopes[which], strict=True))
    return Prediction(value[which], {name: by_name.get(name, none) for name in wanted})


def slips(front: Front, inputs: Inputs, wanted: Collection[str] = ()) -> Prediction:
    """Slip of the interface at each gauge when the front has stopped, in u_s; inf where it never stops."""
    return by_differences(lambda at: _readings(front, at)[0], inputs, wanted, {**front.inputs, **OF_GAUGES}, FIELD_STEP)


def stresses(front: Front, inputs: Inputs, wanted: Collection[str] = ()) -> Prediction:
    """Stress on the contacts at each gauge when the front has stopped, in σ_s; inf where it never stops."""
    return by_differences(lambda at: _readings(front, at)[1], inputs, wanted, {**front.inputs, **OF_GAUGES}, FIELD_STEP)


def _readings(front: Front, inputs: Inputs) -> np.ndarray:
    """Slip and stress at every lane's position, (2, L); each front runs once for all its gauges."""
    table = inputs.table()
    return _readings_of(front, inputs.names, table.tobytes(), table.shape)


@lru_cache(maxsize=2)  # slip and stress are mostly read at the same places
def _readings_of(front: Front, names: tuple[str, ...], numbers: bytes, shape: tuple[int, ...]) -> np.ndarray:
    inputs = Inputs.from_table(names, np.frombuffer(numbers).reshape(shape))
    place = np.exp(inputs.get("log_position"))
    without = inputs.without("log_position")
    fronts, own = distinct_rows(without.table())
    distinct = Inputs.from_table(without.names, fronts)
    stopped = np.array(distinct.get("counted"))
    free = stopped == 0
    lone = distinct.without(*OF_GAUGES)
    # contact 0 has broken even where no domino starts
    stopped[free] = np.maximum(front.lengths(lone.take(free)) + distinct.get("beyond")[free], 1)
    reach = np.maximum(stopped, 0)
    np.maximum.at(reach, own, place)
    found = np.full((2, shape[0]), np.inf)
    known = np.isfinite(reach) & (reach < MOST_SITES)
    # few array sizes, so that few programs are compiled
    size = FEW_SITES * 4 ** np.ceil(np.log(np.maximum(np.where(known, reach, 0) + 2, FEW_SITES) / FEW_SITES) / np.log(4) - 1e-9)
    for count in np.unique(size[known]).astype(int):
        chosen = np.nonzero(known & (size == count))[0]
        at_once = min(TOGETHER, max(1, LANES * 1024 // count))
        for start in range(0, len(chosen), at_once):
            part = chosen[start : start + at_once]
            padded = np.resize(part, at_once)
            with jax.enable_x64(True):
                fields = np.stack(_fields(lone.take(padded), stopped[padded], front, int(count)))
            lanes = np.nonzero(np.isin(own, part))[0]
            found[:, lanes] = _between(fields[:, np.searchsorted(part, own[lanes])], place[lanes])
    found.setflags(write=False)  # cached: the next caller gets the same array
    return found


@partial(jax.jit, static_argnums=(2, 3))
def _fields(inputs: Inputs, stopped: Array, front: Front, count: int) -> tuple[Array, Array]:
    """Slip and stress of the first `count` contacts, each of shape (fronts, count)."""
    return jax.vmap(lambda one, at: front.fields(one, at, count))(inputs, stopped)


def _between(fields: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Interpolate fields, (2, lanes, sites), at one place per lane."""
    low = np.floor(place).astype(int)
    lanes = np.arange(len(place))
    left, right = fields[:, lanes, low], fields[:, lanes, low + 1]
    return left + (place - low) * (right - left)


PREDICTED: dict[str, Callable[[Front, Inputs, Collection[str]], Prediction]] = {
    "length": lambda front, inputs, wanted=(): front.predict(inputs, wanted),
    "displacement": displacements,
    "force": forces,
    "slip": slips,
    "stress": stresses,
}
"""Model of every observable, for many lanes at once."""


def traced(front: Front, observable: str, inputs: Inputs, *, relaxed: bool, sites: int = 0) -> Array:
    """Prediction of one of `PREDICTED` for one lane as a JAX function; forward mode only for gauges.

    Where it is `relaxed`, prestress and threshold slope are zero for certain, which halves the program. For gauges the fields
    of so many `sites` are computed; inf where the front runs farther.
    """
    if observable == "length":
        return front.traced(inputs, relaxed)
    if observable in ("displacement", "force"):
        return _nucleation(inputs)[("displacement", "force").index(observable)]
    lone = inputs.without(*OF_GAUGES)
    # contact 0 has broken even where no domino starts
    free = jnp.maximum(front.traced(lone, relaxed) + inputs.get("beyond"), 1)
    stopped = jnp.where(inputs.get("counted") > 0, inputs.get("counted"), free)
    place = jnp.exp(inputs.get("log_position"))
    left = jnp.floor(place).astype(jnp.int32)
    field = front.fields(lone, stopped, sites)[("slip", "stress").index(observable)]
    known = (stopped < sites) & (place + 1 < sites)
    return jnp.where(known, field[left] + (place - left) * (field[left + 1] - field[left]), jnp.inf)
