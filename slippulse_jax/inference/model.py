"""Predictions of the model from its named inputs: for many lanes at once with derivatives, and traced by JAX for one.

The length is ℓ*, the exact solution's crossing (`slippulse_jax.exact_length`): it has no kinks, starts continuously where the
domino starts, and costs microseconds per lane. Force and displacement at nucleation are closed forms in the two lattice modes.
Gauges read slip and stress along the interface when the front has stopped, which go over smoothly from one whole count of
contacts to the next.
"""

from collections.abc import Callable, Collection
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax import lengths as bulk
from slippulse_jax.bodies.modes import NO_END, Ends, lattice_modes
from slippulse_jax.bulk.chunks import Layout, distinct_rows, over_lanes
from slippulse_jax.exact import crack
from slippulse_jax.exact.bulk import exact_fronts
from slippulse_jax.exact.front import exact_length
from slippulse_jax.front.arrest import quantity
from slippulse_jax.front.front import DEFAULT_MAX_CONTACTS, readings
from slippulse_jax.inference.interpolation import block_lengths, whole_over_front
from slippulse_jax.inference.parameters import STIFFNESSES, Inputs, MeasuredEvent, ParameterSet
from slippulse_jax.interface import Interface
from slippulse_jax.rules import SmoothBreak
from slippulse_jax.slider import Slider
from slippulse_jax.status import NotConverged, Outcome
from slippulse_jax.theory import block_decay_length

LANES = 256
"""Lanes of a chunk."""

HALF_WIDTHS = {
    "log_height": 1e-4,
    "log_stiffness": 1e-4,
    "poisson": 1e-5,
    "prestress": 1e-5,
    "threshold_slope": 5e-6,  # over H/λc: it acts multiplied by ℓ*
    "log_width": 1e-4,
    "log_position": 1e-4,
    "beyond": 1e-4,
    "log_sites": 1e-4,
    "log_machine": 1e-4,
    "friction": 1e-5,
    "log_push": 1e-4,
    "log_push_width": 1e-4,
}
"""Half-widths of central differences."""

FIELD_STEP = 0.1
"""Factor on `HALF_WIDTHS` for fields, which bend from contact to contact more than a length does."""

RISING = 0.01
"""b up to which every length certainly rises with stiffness."""

CRACKS = Layout(chunk=250)
"""Layout of crack-like fronts."""

FEW_SITES, MOST_SITES = 64, 2**20
"""Smallest and largest number of contacts whose fields are computed; where a front runs farther the prediction is inf."""

TOGETHER = 32
"""Fronts whose fields are computed in one call, which always computes all of them; a fit often needs few."""


class Prediction(NamedTuple):
    """Values for L lanes, and derivatives by the name of the input; 0 where there is no finite value."""

    value: Float[np.ndarray, " L"]
    slopes: dict[str, Float[np.ndarray, " L"]]


def lengths(inputs: Inputs, wanted: Collection[str] = (), event: MeasuredEvent = "domino") -> Prediction:
    """ℓ*, in λc, or ℓ_w of the smooth rule where `log_width` is given; 0 where no domino starts, inf where nothing stops.

    The closed form is that of a block without end whose edge is held. Where a block ends or a machine gives way it is ℓ of the
    recursion, which has a kink at every whole contact: the slope jumps there by about the curvature of the front's stress.
    Of the whole event, with `event` "full", it is ℓ* times the interpolated `whole_over_front`, or that of a block
    (`block_lengths`) where its push is given. Where `friction` is given it is that of a crack-like front.

    Parameters
    ----------
    inputs : Inputs
        Arrays of shape (L,).
    wanted : collection of str
        Inputs for which derivatives are wanted: central differences, good to 1e-8 of the larger of derivative and length
        except next to run-away and where the domino just starts.

    Raises
    ------
    NotConverged
        If the exact solution did not converge somewhere, or a front did not fade; never seen.
    """
    return by_differences(_whole_lengths if event == "full" else _lengths, inputs, wanted)


def _whole_lengths(inputs: Inputs) -> np.ndarray:
    if inputs.log_push is not None:
        return block_lengths(inputs)[0]
    front, lanes = _lengths(inputs), _lanes(inputs)
    stops = np.isfinite(front) & (front > 0)
    found = front.copy()
    found[stops] *= whole_over_front(lanes[:, stops])
    if np.isnan(found).any():
        where = ", ".join(f"{x:.9g}" for x in lanes[:, np.argmax(np.isnan(found))])
        raise NotConverged(f"the event was given up at (H/λc, k/K, ν, φ, ε) = ({where}): give narrower bounds")
    return found


def _lanes(inputs: Inputs) -> Float[np.ndarray, "5 L"]:
    """H/λc, k/K, ν, φ, ε."""
    return np.stack([np.exp(inputs.log_height), inputs.ratio, *inputs[2:5]])


def _lengths(inputs: Inputs) -> np.ndarray:
    if inputs.log_width is not None:
        slider = _slider(inputs)
        return _all_found(bulk.lengths(slider, rule=SmoothBreak(np.exp(inputs.log_width))), inputs, "under the smooth rule")
    ended = np.isfinite([x for x in (inputs.log_sites, inputs.log_machine) if x is not None]).any(axis=0)
    if ended.any():
        inputs, found = inputs.of_front, np.empty(ended.shape)
        found[ended] = _all_found(straight_lengths(inputs.take(ended)), inputs.take(ended), "by the recursion")
        if not ended.all():
            found[~ended] = _lengths(inputs.endless.take(~ended))
        return found
    lanes = _lanes(inputs)
    if inputs.friction is not None:
        return _all_found(over_lanes(_cracks, [*lanes[:4], inputs.friction], CRACKS)[0], inputs, "of a crack-like front")
    found, status = exact_fronts(lanes, one_program=True)
    lost = ~np.isin(status, (Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.RUN_AWAY))
    if lost.any():
        where = ", ".join(f"{x:.9g}" for x in lanes[:, np.argmax(lost)])
        why = Outcome(int(status[lost][0])).message
        raise NotConverged(f"no exact length at (H/λc, k/K, ν, φ, ε) = ({where}): {why}")
    return found


def _cracks(lanes: Float[Array, "5 L"]) -> tuple[Array, Array]:
    """Length and status of crack-like fronts at H/λc, k/K, ν, φ and σ_k."""
    return jax.vmap(lambda lane: crack.length(Slider(*lane[:3]), lane[4], lane[3]), 1)(lanes)


def crack_status(inputs: Inputs) -> np.ndarray:
    """Outcome of each crack-like front, shape (L,)."""
    return over_lanes(_cracks, [*_lanes(inputs)[:4], inputs.friction], CRACKS)[1]


def _all_found(length: np.ndarray, inputs: Inputs, how: str) -> np.ndarray:
    lost = np.isnan(length)
    if lost.any():
        where = ", ".join(f"{x:.9g}" for x in inputs.table()[np.argmax(lost)])
        raise NotConverged(f"no length {how} at {inputs.names} = ({where})")
    return length


def straight_lengths(inputs: Inputs, event: MeasuredEvent = "domino") -> np.ndarray:
    """ℓ, where the straight line between the stresses on two contacts falls to the threshold; for inputs of shape (L,)."""
    slider, interface, ends = recursion_inputs(inputs)
    return bulk.lengths(slider, interface, ends=ends, event="full" if event == "full" else "domino")


def recursion_inputs(inputs: Inputs) -> tuple[Slider, Interface | None, Ends]:
    """Sliders, interfaces and ends for the recursion."""
    slider = _slider(inputs)
    relaxed = not (inputs.prestress.any() or inputs.threshold_slope.any())
    return slider, None if relaxed else Interface(inputs.prestress, inputs.threshold_slope), _ends(inputs)


def _slider(inputs: Inputs, exp: Callable = np.exp) -> Slider:
    """Slider of the inputs; of traced ones by JAX's ``exp``."""
    return Slider(exp(inputs.log_height), exp(inputs.log_stiffness), inputs.poisson)


def _ends(inputs: Inputs, exp: Callable = np.exp) -> Ends:
    """Free end and machine; where there is none, one so far away, or so stiff, that no digit changes."""
    most = np.log(NO_END)
    sites, machine = (x if x is None else exp(x.clip(max=most)) for x in (inputs.log_sites, inputs.log_machine))
    return Ends("semi-infinite" if sites is None else "free", sites, machine)


def by_differences(
    values: Callable[[Inputs], np.ndarray], inputs: Inputs, wanted: Collection[str], size: float = 1.0
) -> Prediction:
    """Values of a model and their derivatives in the `wanted` inputs by central differences, all in one call.

    The steps are `HALF_WIDTHS` times `size`. Two more lengths per derivative cost some 25 µs per lane, the exact derivatives of
    `exact_lengths` 1100 µs, measured with version 0.1.
    """
    wanted = [name for name in HALF_WIDTHS if name in wanted]
    if not wanted:
        return Prediction(values(inputs), {})
    # nodes of a profile are reached from several starts: each distinct row once
    names = inputs.names
    rows, own = distinct_rows(inputs.table())
    shifted = [rows]
    for name in wanted:
        column = names.index(name)
        step = size * HALF_WIDTHS[name] * (np.exp(-rows[:, 0]) if name == "threshold_slope" else 1.0)
        for sign in (1, -1):
            moved = rows.copy()
            moved[:, column] += sign * step
            # ν = 1/2 is the end of the domain
            moved[:, 2] = np.minimum(moved[:, 2], 0.5)
            if "friction" in names:  # and so is no friction
                moved[:, names.index("friction")] = np.maximum(moved[:, names.index("friction")], 0.0)
            shifted.append(moved)
    value, *around = values(Inputs.from_table(names, np.concatenate(shifted))).reshape(len(shifted), -1)
    slopes = {}
    for i, name in enumerate(wanted):
        column = names.index(name)
        ends, at = around[2 * i : 2 * i + 2], [x[:, column] for x in shifted[2 * i + 1 : 2 * i + 3]]
        # next to run-away one side has no value
        up, down = (np.where(np.isfinite(end), end, value) for end in ends)
        right, left = (np.where(np.isfinite(end), x, rows[:, column]) for end, x in zip(ends, at, strict=True))
        with np.errstate(invalid="ignore"):  # inf − inf for a block without end
            apart = right - left
            slope = (up - down) / np.where(apart > 0, apart, 1)
        slopes[name] = np.where(np.isfinite(value), slope, 0)[own]
    return Prediction(value[own], slopes)


def displacements(inputs: Inputs, wanted: Collection[str] = ()) -> Prediction:
    """Displacement of the pushed edge at nucleation, in u_s = f_s/k; exact derivatives."""
    return _at_nucleation(0, inputs, wanted)


def forces(inputs: Inputs, wanted: Collection[str] = ()) -> Prediction:
    """Driving force at nucleation, which is the sum over the contacts, in f_s, the threshold of one contact."""
    return _at_nucleation(1, inputs, wanted)


def _nucleation(inputs: Inputs) -> Float[Array, " 2"]:
    """Displacement and force at nucleation; the force is Σ_i Σ_m C_m y_m(i), a geometric series in each mode.

    The displacement is that of the edge, whatever pushes it.
    """
    slider = _slider(inputs, jnp.exp)
    ends = _ends(inputs._replace(log_machine=None), jnp.exp)
    modes = lattice_modes(slider, ends)
    force = modes.drive / modes.gap
    if ends.sites is not None:  # there and, from the free end, back again: 1 + r + … + r^{2N − 1}
        force = force * -jnp.expm1(2 * ends.sites * jnp.log1p(-modes.gap))
    return (1 - inputs.prestress) * jnp.stack([modes.load, force.sum()])


def _nucleation_with_slopes(lanes: Float[Array, "n L"]) -> tuple[Array, Array]:
    """Both quantities of many lanes, and their derivatives, (2, n, L): they are usually measured together."""

    def one(lane: Array) -> Array:
        return _nucleation(Inputs(*lane[:5], log_sites=lane[5] if len(lane) > 5 else None))

    return jax.vmap(one, 1, -1)(lanes), jax.vmap(jax.jacfwd(one), 1, -1)(lanes)


def _at_nucleation(which: int, inputs: Inputs, wanted: Collection[str]) -> Prediction:
    given = inputs.of_front._replace(log_machine=None, friction=None)
    lanes = [x for x in given if x is not None]
    value, slopes = over_lanes(_nucleation_with_slopes, lanes, Layout(chunk=LANES))
    none = np.zeros(len(value[which]))
    by_name = {name: slopes[which, i] for i, name in enumerate(given.names)} | {"log_machine": none, "friction": none}
    return Prediction(value[which], {name: slope for name, slope in by_name.items() if name in wanted})


def slips(inputs: Inputs, wanted: Collection[str] = ()) -> Prediction:
    """Slip of the interface at each gauge when the front has stopped, in u_s; inf where it never stops."""
    return by_differences(lambda at: _readings(at)[0], inputs, wanted, FIELD_STEP)


def stresses(inputs: Inputs, wanted: Collection[str] = ()) -> Prediction:
    """Stress on the contacts at each gauge when the front has stopped, in σ_s; inf where it never stops."""
    return by_differences(lambda at: _readings(at)[1], inputs, wanted, FIELD_STEP)


def _readings(inputs: Inputs) -> np.ndarray:
    """Slip and stress at every lane's position, (2, L); each front runs once for all its gauges."""
    table = inputs.table()
    return _readings_of(inputs.names, table.tobytes(), table.shape)


@lru_cache(maxsize=2)  # slip and stress are mostly read at the same places
def _readings_of(names: tuple[str, ...], numbers: bytes, shape: tuple[int, ...]) -> np.ndarray:
    inputs = Inputs.from_table(names, np.frombuffer(numbers).reshape(shape))
    place = np.exp(inputs.log_position)
    fronts, own = distinct_rows(inputs._replace(log_position=None).table())
    front = Inputs.from_table([name for name in names if name != "log_position"], fronts)
    stopped = np.array(front.counted)
    free = stopped == 0
    lone = front._replace(beyond=None, counted=None).take(free)
    # contact 0 has broken even where no domino starts
    stopped[free] = np.maximum(_lengths(lone) + front.beyond[free], 1)
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
            fields = _after(front.take(padded), stopped[padded], count)
            lanes = np.nonzero(np.isin(own, part))[0]
            found[:, lanes] = _between(fields[:, np.searchsorted(part, own[lanes])], place[lanes])
    found.setflags(write=False)  # cached: the next caller gets the same array
    return found


def _after(front: Inputs, stopped: np.ndarray, count: int) -> np.ndarray:
    """Slip and stress of the first `count` contacts, shape (2, fronts, count)."""
    with jax.enable_x64(True):
        slider = _slider(front)
        if front.friction is not None:
            return np.stack(_fields_after_crack(slider, front.friction, front.prestress, stopped, count))
        return np.stack(_fields_after(slider, _ends(front), front.prestress, stopped, count))


@partial(jax.jit, static_argnums=4)
def _fields_after(slider: Slider, ends: Ends, prestress: Array, stopped: Array, count: int) -> tuple[Array, Array]:
    def one(slider: Slider, ends: Ends, prestress: Array, stopped: Array) -> tuple[Array, Array]:
        return readings(slider, prestress, stopped, count, ends)

    return jax.vmap(one)(slider, ends, prestress, stopped)


@partial(jax.jit, static_argnums=4)
def _fields_after_crack(slider: Slider, friction: Array, prestress: Array, stopped: Array, count: int) -> tuple[Array, Array]:
    site = jnp.arange(count, dtype=stopped.dtype)
    return jax.vmap(lambda *one: jax.vmap(partial(crack.fields, *one))(site))(slider, friction, prestress, stopped)


def _between(fields: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Interpolate fields, (2, lanes, sites), at one place per lane."""
    low = np.floor(place).astype(int)
    lanes = np.arange(len(place))
    left, right = fields[:, lanes, low], fields[:, lanes, low + 1]
    return left + (place - low) * (right - left)


PREDICTED: dict[str, Callable[..., Prediction]] = {
    "length": lengths,
    "displacement": displacements,
    "force": forces,
    "slip": slips,
    "stress": stresses,
}
"""Model of every observable, for many lanes at once."""


def traced(observable: str, inputs: Inputs, *, relaxed: bool, sites: int = 0) -> Array:
    """Prediction for one lane as a JAX function; forward mode only for gauges.

    Parameters
    ----------
    observable : str
        One of `PREDICTED`.
    inputs : Inputs
        Scalars.
    relaxed : bool
        Whether prestress and threshold slope are zero for certain, which halves the program.
    sites : int
        Contacts whose fields are computed, for gauges; inf where the front runs farther.
    """
    if observable == "length":
        return traced_length(inputs, relaxed)
    if observable in ("displacement", "force"):
        return _nucleation(inputs)[("displacement", "force").index(observable)]
    # contact 0 has broken even where no domino starts
    free = jnp.maximum(traced_length(inputs, relaxed) + inputs.beyond, 1)
    stopped = jnp.where(inputs.counted > 0, inputs.counted, free)
    place = jnp.exp(inputs.log_position)
    left = jnp.floor(place).astype(jnp.int32)
    slider = _slider(inputs, jnp.exp)
    if inputs.friction is None:
        fields = readings(slider, inputs.prestress, stopped, sites, _ends(inputs, jnp.exp))
    else:
        at = partial(crack.fields, slider, inputs.friction, inputs.prestress, stopped)
        fields = jax.vmap(at)(jnp.arange(sites, dtype=place.dtype))
    field = fields[("slip", "stress").index(observable)]
    known = (stopped < sites) & (place + 1 < sites)
    return jnp.where(known, field[left] + (place - left) * (field[left + 1] - field[left]), jnp.inf)


def traced_length(inputs: Inputs, relaxed: bool) -> Array:
    """ℓ* of one lane as a JAX function, or ℓ where the block ends or the machine gives way."""
    slider = _slider(inputs, jnp.exp)
    if inputs.friction is not None:
        return crack.length(slider, inputs.friction, inputs.prestress)[0]
    interface = None if relaxed else Interface(inputs.prestress, inputs.threshold_slope)
    exact = exact_length(slider, interface)
    stated = [x for x in (inputs.log_sites, inputs.log_machine) if x is not None]
    if not stated:
        return exact
    straight = quantity("length", slider, interface, _ends(inputs, jnp.exp), DEFAULT_MAX_CONTACTS)
    return jnp.where(jnp.isfinite(jnp.stack(stated)).any(), straight, exact)


def attainable(parameters: ParameterSet, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Longest length of each measurement at any stiffness searched, in λc, and the k/K where; shapes (n,).

    The other parameters stay as in `theta`.
    """
    inputs = parameters.inputs_at(theta)
    longest, where = attainable_of(parameters, theta, np.arange(len(inputs.poisson)), inputs)
    return longest * np.exp(parameters.scales["length"](theta)) + parameters.offset(theta), where


def attainable_of(
    parameters: ParameterSet, theta: np.ndarray, rows: np.ndarray, inputs: Inputs
) -> tuple[np.ndarray, np.ndarray]:
    """Longest length for other `inputs`, over the stiffness range of the measurements `rows`; in true λc, without offset."""
    low, high = np.array(inputs.log_stiffness), np.array(inputs.log_stiffness)
    for i, one in enumerate(parameters.free):
        if one.name in STIFFNESSES:
            on = parameters.inputs.log_stiffness.slope[rows, i] != 0
            low[on], high[on] = (inputs.log_stiffness[on] + end - theta[i] for end in (parameters.low[i], parameters.high[i]))
    # under the hard rule: under a smooth one the length on soft contacts grows without meaning
    inputs = inputs.of_front
    distinct, own = distinct_rows(np.column_stack([inputs.table(), low, high]))
    given = Inputs.from_table(inputs.names, distinct[:, :-2])
    longest, where = longest_length(given, distinct[:, -2], distinct[:, -1], parameters.event)
    return longest[own], np.exp(where[own])


def longest_length(
    inputs: Inputs, low: np.ndarray, high: np.ndarray, event: MeasuredEvent = "domino"
) -> tuple[np.ndarray, np.ndarray]:
    """Find the maximum of the length over ln k/K from `low` to `high`, by a scan and closer scans around its top.

    Below b = `RISING` a length rises with stiffness, so that nothing softer is looked at.
    """
    rising = np.log(RISING) + inputs.log_stiffness - inputs.log_b
    low = np.minimum(np.maximum(low, rising), high)
    best, where = np.empty(len(low)), np.empty(len(low))
    for count in (129, 17, 17, 17, 17):
        grid = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, count)
        lanes = inputs.take(np.repeat(np.arange(len(low)), count))._replace(log_stiffness=grid.ravel())
        length = lengths(lanes, event=event).value.reshape(grid.shape)
        top = length.argmax(axis=1)
        rows = np.arange(len(low))
        best, where = length[rows, top], grid[rows, top]
        step = (high - low) / (count - 1)
        low, high = np.maximum(where - step, low), np.minimum(where + step, high)
    return best, where


def recursion_status(inputs: Inputs) -> np.ndarray:
    """Outcome of each front, by the recursion that breaks its contacts one by one, or of each event; shape (n,)."""
    inputs = inputs.of_front
    if inputs.friction is not None:
        return crack_status(inputs)
    if inputs.log_push is not None:
        found = block_lengths(inputs)[0]
        return np.select([np.isinf(found), found > 0], [Outcome.RUN_AWAY, Outcome.ARRESTED], Outcome.NO_DOMINO)
    distinct, own = distinct_rows(inputs.table())
    slider, interface, ends = recursion_inputs(Inputs.from_table(inputs.names, distinct))
    return np.asarray(bulk.arrests(slider, interface, ends=ends).status)[own]


class Regime(NamedTuple):
    """Where in the model's range each row of the inputs lies."""

    b: np.ndarray  # areal stiffness times H over the shear modulus
    slow_decay_length: np.ndarray  # 1/κ_2, or that of an edge load of a block, in λc
    edge_stiffness: np.ndarray  # of a block without end, pushed at its edge, in K


def regime(inputs: Inputs) -> Regime:
    """Find b and 1/κ_2 of each row of the inputs."""
    with jax.enable_x64(True):
        b, decay, stiffness = map(np.asarray, _regime(_slider(inputs)))
    if inputs.log_push is not None:
        decay = np.exp(inputs.log_height) * block_decay_length(b, inputs.poisson)
    return Regime(b, decay, stiffness)


@jax.jit
def _regime(slider: Slider) -> tuple[Array, Array, Array]:
    """`Regime` of sliders, as one program: a dozen small ones take a third of a second to compile."""
    k1, k2 = slider.kappa_1, slider.kappa_2
    # the layer is free at the edge: in amplitudes of u_t, A_1 α_1 κ_1 + A_2 α_2 κ_2 = 0 (continuum)
    first, second = slider.alpha_2 * k2, -slider.alpha_1 * k1
    return slider.b, slider.slow_decay_length, slider.K_L * (first * k1 + second * k2) / (first + second)
