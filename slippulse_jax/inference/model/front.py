"""Models of a measured length: inputs, lengths, range, status, words.

A model is `length`, a JAX function of the inputs of one measurement, or a table of `values` that were computed before, such as
those of whole events and blocks. From it come lengths and derivatives of many lanes at once (`evaluate`), which a compiled
kernel may compute. A new model is a new class, of a user too, given as ``event``.
"""

import functools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.bodies.modes import FARTHEST as NO_END
from slippulse_jax.bulk.chunks import Kernel, Layout, distinct_rows, over_lanes
from slippulse_jax.bulk.derivatives import without_derivative
from slippulse_jax.front.front import slip_and_stress
from slippulse_jax.inference.choices import Body
from slippulse_jax.inference.model.inputs import COMMON, Input, Inputs
from slippulse_jax.inference.table.measurements import Measurements
from slippulse_jax.slider import Slider

SCATTERED, IMPROBABLE = 0.05, 1e-3
"""Probability of χ², or of the largest pull, below which the report remarks on it; and below which a model is refused."""
ENDED = ("log_sites", "log_machine")
"""Inputs of a slider that ends, or is pushed by a machine that gives way; inf in rows without."""
RISING = 0.01
"""b up to which every length of a slider certainly rises with stiffness."""
STIFFEST = 1.0
"""Largest k/K searched: a contact stiffer than the block of bulk it is attached to is outside the model."""
LANES = Layout(chunk=256, fusion_emitters=False)
"""Layout of lanes of models without a kernel of their own."""


Predicted = Float[np.ndarray, "order L"]
"""Values for L lanes, (1, L); or with two derivatives along a line of inputs, (3, L), 0 where a value is not finite."""
Along = Float[np.ndarray, "L inputs"] | None
"""Direction of each lane's line, in as many inputs as there are; None for values alone."""


class Regime(NamedTuple):
    """Where in the model's range each row of the inputs lies."""

    b: np.ndarray  # areal stiffness times H over the shear modulus
    slow_decay_length: np.ndarray  # 1/κ_2, or that of an edge load of a block, in λc
    edge_stiffness: np.ndarray  # of a block without end, pushed at its edge, in K


class Front:
    """A model of a measured length."""

    event: ClassVar[Any] = "own"  # a `MeasuredEvent`, of the models here
    body: ClassVar[Body] = "slider"
    inputs: ClassVar[Mapping[str, Input]] = {}  # beside those of every model
    columns: ClassVar[Collection[str]] = ()  # that it reads from `Measurements.other`
    observes: ClassVar[Collection[str]] = (
        "length", "count", "limit", "displacement", "force", "slip", "stress",
    )  # fmt: skip
    """Names of the observables that it predicts."""
    needs: ClassVar[Collection[str]] = ()  # parameters that are fitted where no column states them
    interpolated: ClassVar[bool] = False  # whether its lengths are interpolated, so that no count holds or fails for certain
    drawn: ClassVar[bool] = False  # whether what is measured is a draw, of contacts that differ
    most_off: ClassVar[float] = 0.0  # largest `uncertainty` of a length, in λc

    # in words
    measured: ClassVar[str] = "first precursors"
    name: ClassVar[str] = "first self-healing precursor"
    carrier: ClassVar[str] = "the paper's slider"
    body_modelled: str = "semi-infinite slider"
    length_modelled: ClassVar[str] = "continuous length"
    lengths_are_of: ClassVar[str] = ""  # where that is not the first front
    held: str = "the edge"  # does not move during the event
    thresholds: str = "uniform thresholds"
    rising: ClassVar[float] = 0.0  # b up to which every length is known to rise with stiffness
    uncertain_as: ClassVar[str] = "a length of this model is known only"  # within its `uncertainty`

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Refuse columns and parameters without a meaning; a ValueError names them.

        `names` are those of the parameters, a `Parameter` each by `dict`.
        """
        if "friction" in names:
            raise ValueError("parameter friction: contacts slide only behind a crack-like front: event = 'crack'")
        if "machine_stiffness" in names:
            raise ValueError("parameter machine_stiffness: of sequences of a block, with a force for every length")
        if all(name in names or m.or_zero(name).any() for name in ("threshold_slope", "residual_strength")):
            raise ValueError(f"{m.source}: threshold_slope beside residual_strength: a fit takes one of the two")

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """Its own inputs that the measurements state, each of shape (n,)."""
        return {}

    def values(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """Lengths of many lanes, in λc.

        0 where no domino starts, inf where nothing stops, NaN where there is none.
        """
        raise NotImplementedError

    def length(self, inputs: Inputs, relaxed: bool) -> Array:
        """Length of one lane in λc, a JAX function.

        With derivatives in forward mode. `relaxed` says that prestress, slope and what contacts keep are zero for certain.
        """
        return self._from_table(inputs)

    @staticmethod
    def most(log_height: np.ndarray, names: tuple[str, ...]) -> tuple[Any, ...]:
        """What `in_rows` needs of the largest ln H/λc of each row."""
        return ()

    def in_rows(self, inputs: Inputs, relaxed: bool, *most: Any) -> Float[Array, " m"]:
        """`length` of every row."""
        return jax.vmap(lambda one: self.length(one, relaxed))(inputs)

    def lengths(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """Lengths of many lanes, in λc, as `values`."""
        return self.evaluate(inputs)[0]

    def starts(self, inputs: Inputs) -> Float[np.ndarray, " L"]:
        """Lengths of the fronts with which events start."""
        return self.lengths(inputs)

    def evaluate(self, inputs: Inputs, along: Along = None) -> Predicted:
        """Lengths of many lanes, and their derivatives along a line."""
        if type(self).values is Front.values:
            return by_jax(type(self).length, self, inputs, along)
        return self.values(inputs)[None] if along is None else self._by_differences(inputs, along)

    def _by_differences(self, inputs: Inputs, along: np.ndarray) -> Predicted:
        """Values of a table, and their central differences along a line."""
        table, every = inputs.table(), {**COMMON, **self.inputs}
        steps = np.array([every[name].step for name in inputs.names])
        steps = steps * np.where(np.array(inputs.names) == "threshold_slope", np.exp(-table[:, :1]), 1.0)
        moves = (along != 0).any(axis=1)
        reach = 1 / np.where(moves, np.max(np.abs(along) / steps, axis=1), 1)  # the largest step is that of its input
        low, high = (np.array([every[name].domain[i] for name in inputs.names]) for i in (0, 1))
        with np.errstate(invalid="ignore"):  # inf − inf of blocks without end, and where nothing stops
            places = [np.where(along != 0, np.clip(table + k * reach[:, None] * along, low, high), table) for k in (0, 1, -1)]
            rows, own = distinct_rows(np.concatenate(places))
            value, *sides = self.values(Inputs.from_table(inputs.names, rows))[own].reshape(3, -1)
            # next to where nothing stops, and at the side of a domain, one side counts
            there = [np.isfinite(x) & (place != table).any(axis=1) for x, place in zip(sides, places[1:], strict=True)]
            up, down = (np.where(known, x, value) for x, known in zip(sides, there, strict=True))
            slope = (up - down) / (np.maximum(sum(there), 1) * reach)
            bend = (up - 2 * value + down) / reach**2 * (there[0] & there[1])
        stops = np.isfinite(value) & moves
        return np.stack([value, np.where(stops, slope, 0), np.where(stops, bend, 0)])

    def _from_table(self, inputs: Inputs) -> Array:
        """Length from a table as a JAX function, with first derivatives."""
        names = inputs.names

        def called(of: Callable[..., np.ndarray], *lanes: Array) -> Array:
            dtype = lanes[0].dtype
            words = (dtype.itemsize // 4,)[: dtype.itemsize > 4]  # in a thread of XLA's, JAX would round what is double

            def on_host(*lanes: Any) -> np.ndarray:
                given = [np.ascontiguousarray(x).view(dtype).reshape(*x.shape[: x.ndim - len(words)]) for x in lanes]
                rows, *along = (x.reshape(-1, len(names)).astype(float) for x in given)
                found = np.asarray(of(Inputs.from_table(names, rows), *along), dtype)
                return found.view(np.uint32).reshape(*given[0].shape[:-1], *words)

            bits = [lax.bitcast_convert_type(x, jnp.uint32) for x in lanes]
            found = jax.pure_callback(on_host, jax.ShapeDtypeStruct(words, jnp.uint32), *bits, vmap_method="broadcast_all")
            return lax.bitcast_convert_type(found, dtype)

        @jax.custom_jvp
        def length(lane: Array) -> Array:
            return called(self.lengths, lane)

        @length.defjvp
        def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:  # pyright: ignore[reportUnusedFunction]
            return length(*primals), slope(*primals, *tangents)

        slope = without_derivative(
            lambda lane, along: called(lambda at, way: self.evaluate(at, way)[1], lane, along),
            "the length of a whole event comes from a table, which has first derivatives only",
        )

        return length(jnp.stack([jnp.asarray(inputs.get(name)) for name in names]))

    def status(self, inputs: Inputs) -> np.ndarray:
        """`Outcome` of each, by its length."""
        found = self.lengths(inputs)
        ends = np.isfinite(inputs.get("log_sites")) if "log_sites" in inputs.names else np.zeros(found.shape, bool)
        endless = np.isinf(found)
        kinds = {Outcome.RAN_THROUGH: endless & ends, Outcome.RUN_AWAY: endless, Outcome.ARRESTED: found > 0}
        kinds |= {Outcome.LIMIT: np.isnan(found)}
        return np.select(list(kinds.values()), list(kinds), Outcome.NO_DOMINO)

    def follow(self, inputs: Inputs, *, first: int = 0) -> Iterator[tuple[Any, np.ndarray, np.ndarray]]:
        """Follow what an emulator is learnt from, at inputs (t, u).

        For each of u units what observables read, the number of contacts, and how much too large they are over its length.
        """
        raise NotImplementedError(f"{self.name}: nothing for an emulator")

    def ensembles(self, inputs: Inputs, reach: np.ndarray, near: Inputs | None = None, *, alone: bool = True) -> Any:
        """Draw events at all places of `reach`, and more `near` some."""
        raise NotImplementedError(f"{self.name}: of contacts that are alike")

    @classmethod
    def coordinates(cls, inputs: Inputs, numpy: Any = np) -> Any:
        """Coordinates of an emulator, each in its unit, (…, d).

        `numpy` may be JAX's.
        """
        raise NotImplementedError

    @staticmethod
    def unit(acts: Iterable[str]) -> float:
        """Least half-width of a cloud in a parameter.

        By the inputs on which it acts.
        """
        raise NotImplementedError

    def guesses(self, m: Measurements) -> list[str]:
        """Assumptions in place of what measurements do not state."""
        return []

    def left_out(self, m: Measurements, names: Collection[str]) -> list[str]:
        """What the model leaves out; of fitted and held parameters' names."""
        return []

    def remarks(self, m: Measurements) -> Iterator[str]:
        """What to know of the measurements before using the numbers."""
        return iter(())

    def outcomes(self, m: Measurements, inputs: Inputs) -> np.ndarray:
        """`Outcome` of each measurement."""
        return self.status(inputs)

    def contacts_broken(self, m: Measurements, inputs: Inputs) -> np.ndarray:
        """Whole contacts that each front breaks; −1 where it never stops."""
        front = self.lengths(inputs)
        stops = np.isfinite(front)
        return np.where(stops, np.maximum(np.ceil(np.where(stops, front, 0)), 1), -1).astype(int)

    def breaks_again(self, inputs: Inputs) -> np.ndarray:
        """Whether the edge would break again, which the model leaves out; (L,)."""
        return np.zeros(inputs.poisson.shape, bool)

    def uncertainty(self, inputs: Inputs) -> np.ndarray | None:
        """Typical error of each length, in λc, shape (L,); None without one."""
        return None

    def softest(self, m: Measurements) -> np.ndarray:
        """k/K of each measurement below which certainly no domino starts.

        There b is far below (λc/H)², and the length is zero.
        """
        return 1e-2 / (2 * (1 + m.poisson) * m.height**3)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K of each measurement searched by default."""
        return np.full(len(m), STIFFEST)

    def ranges(self, m: Measurements) -> dict[str, tuple[float, float]]:
        """Ranges of other parameters searched by default, where it has its own."""
        return {}

    def fields(self, inputs: Inputs, stopped: Array, count: int) -> tuple[Array, Array]:
        """Slip and stress of the first contacts when `stopped` have broken.

        Traced, each of shape (count,); inf where that is not beyond all that have broken, on which fields depend.
        """
        kept = inputs.more.get("residual_strength", 0.0)
        slip, stress = slip_and_stress(sliders(inputs, jnp.exp), inputs.prestress, stopped, count, kept)
        return jnp.where(stopped < count, slip, jnp.inf), jnp.where(stopped < count, stress, jnp.inf)

    def regime(self, inputs: Inputs) -> Regime:
        """Find b and 1/κ_2 of each row of the inputs."""
        with jax.enable_x64(True):
            return Regime(*map(np.asarray, _regime(sliders(inputs))))

    def usual(self, m: Measurements) -> dict[str, tuple[float, float]]:
        """Usual ranges of parameters that measurements like these have."""
        return {}

    def longest(self, inputs: Inputs, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the longest length over ln k/K from `low` to `high`.

        By a scan, and closer scans around its top.

        Where lengths are known to rise with stiffness, up to b = `rising`, nothing softer is looked at. Those of blocks under
        friction, and of models of one's own, may fall there.
        """
        rising = (np.log(self.rising) if self.rising else -np.inf) + inputs.log_stiffness - inputs.log_b
        low = np.minimum(np.maximum(low, rising), high)
        best, where = np.empty(len(low)), np.empty(len(low))
        for count in (129, 17, 17, 17, 17):
            grid = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, count)
            lanes = inputs.take(np.repeat(np.arange(len(low)), count))._replace(log_stiffness=grid.ravel())
            length = np.nan_to_num(self.lengths(lanes), posinf=np.inf).reshape(grid.shape)
            top = length.argmax(axis=1)
            rows = np.arange(len(low))
            best, where = length[rows, top], grid[rows, top]
            step = (high - low) / (count - 1)
            low, high = np.maximum(where - step, low), np.minimum(where + step, high)
        return best, where


# --- derivatives -------------------------------------------------------------------------------------------------------


def is_relaxed(inputs: Inputs, along: Along = None) -> bool:
    """Whether contacts are relaxed, and stay so along a line."""
    return inputs.relaxed and not (along is not None and along[:, 3:5].any())


def by_jax(function: Any, front: Front, inputs: Inputs, along: Along, **options: Any) -> Predicted:
    """Values and derivatives of a ``function(front, inputs, relaxed)`` of one lane."""
    table = inputs.table()
    rows, own = distinct_rows(table if along is None else np.concatenate([table, along], axis=1))
    kernel = _jets(function, front, inputs.names, along is not None, is_relaxed(inputs, along), **options)
    value, *slopes = over_lanes(kernel, rows.T, LANES)[0]
    if np.isnan(value).any():
        where = ", ".join(f"{x:.9g}" for x in rows[np.argmax(np.isnan(value))])
        raise NotConverged(f"no {front.name} at {inputs.names} = ({where})")
    return np.stack([value, *(np.where(np.isfinite(value), x, 0) for x in slopes)])[:, own]


@functools.cache
def _jets(function: Any, front: Front, names: tuple[str, ...], slopes: bool, relaxed: bool, **options: Any) -> Kernel:
    def one(lane: Float[Array, " fields"]) -> Array:
        at, along = lane[: len(names)], lane[len(names) :]

        def value(t: Array) -> Array:
            return function(front, Inputs.from_table(names, at + t * along if slopes else at), relaxed, **options)

        def slope(t: Array) -> Array:
            return jax.jvp(value, (t,), (jnp.ones_like(t),))[1]

        zero = jnp.zeros_like(lane[0])
        return jnp.stack([value(zero), *(jax.jvp(slope, (zero,), (zero + 1,)) if slopes else ())])

    return lambda lanes: (jax.vmap(one, in_axes=1, out_axes=-1)(lanes),)


def joined(first: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Join results of lanes that were taken apart."""
    found = np.empty((*x.shape[:-1], len(first)))
    found[..., first], found[..., ~first] = x, y
    return found


# --- numbers of sliders -------------------------------------------------------------------------------------------------


def sliders(inputs: Inputs, exp: Any = np.exp) -> Slider:
    """Sliders of the inputs; of traced ones by JAX's ``exp``.

    Where there is no end or machine, with one so far away, or so stiff, that no digit changes.
    """
    most = np.log(NO_END)
    length, machine = (exp(inputs.more[name].clip(max=most)) if name in inputs.more else None for name in ENDED)
    return Slider(exp(inputs.log_height), exp(inputs.log_stiffness), inputs.poisson, length=length, machine=machine)


def numbers_of(inputs: Inputs) -> Float[np.ndarray, "5 L"]:
    """H/λc, k/K, ν, φ, ε, as of contacts that keep nothing."""
    prestress = inputs.interface.equivalent_prestress
    return np.stack([np.exp(inputs.log_height), inputs.ratio, inputs.poisson, prestress, inputs.threshold_slope])


@jax.jit
def _regime(slider: Slider) -> tuple[Array, Array, Array]:
    """`Regime` of sliders, as one program, which compiles sooner than a dozen."""
    k1, k2 = slider.kappa_1, slider.kappa_2
    # the layer is free at the edge: in amplitudes of u_t, A_1 α_1 κ_1 + A_2 α_2 κ_2 = 0 (continuum)
    first, second = slider.alpha_2 * k2, -slider.alpha_1 * k1
    return slider.b, slider.slow_decay_length, slider.K_L * (first * k1 + second * k2) / (first + second)
