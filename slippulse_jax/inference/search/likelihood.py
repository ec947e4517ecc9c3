"""Log density of measurements and priors, of which every inference consists.

A `Problem` is −ln p of the data of every observable given their predictions, summed with the Gaussian priors.
`Problem.traced` is a JAX function of one θ. A fit evaluates it for thousands of θ at once by calling the `Problem`: exact
predictions and their derivatives come from the models, by a compiled kernel of each, value and derivatives of the same density
from `jax.grad`, and the chain rule, θ being linear in the inputs, joins the two. Predictions by an emulator have an error of
their own, which depends on θ too: JAX differentiates the density of all of them as a whole.

Constants are left out such that a datum the model meets exactly costs nothing: twice the sum is χ² for plain lengths.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import chdtrc, digamma
from scipy.stats import pearson3

from slippulse_jax.base.shown import TIED, format_number, listed, plural
from slippulse_jax.bulk.chunks import Kernel, Layout, over_lanes
from slippulse_jax.bulk.compiler import compiled, local_devices
from slippulse_jax.bulk.derivatives import by_forward_mode
from slippulse_jax.inference.choices import Loss
from slippulse_jax.inference.model.emulator import NOWHERE, Emulator, Points
from slippulse_jax.inference.model.front import IMPROBABLE, Front
from slippulse_jax.inference.observables.observable import (
    SHARPEST,
    STUDENT_DOF,
    Observable,
    Observations,
    Prediction,
    Reading,
    loss_of,
    whitened,
)
from slippulse_jax.inference.parameters import ParameterSet
from slippulse_jax.inference.table.measurements import Measurements

PART = 0.1
"""Part of χ² from fitted inputs and priors from which on it is stated."""

LAYOUT = Layout(chunk=128, fusion_emitters=False)
"""Layout of data for the compiled densities."""
BEND = 1e-4
"""Step of differences of a gradient, over the range searched."""
AT_ONCE = 16
"""Points at which the density of emulated data is evaluated by one call."""

ELEMENTS = 2_000_000
"""Elements of the largest array held at once; more points are evaluated in turns."""

SIMULATED = 200
"""Tables that say how probable a deviance of draws is."""
OUTLIERS = 0.01
"""Share of draws that are none of the model's."""
INFORMATION = {"normal": 1.0, "student": (STUDENT_DOF + 1) / (STUDENT_DOF + 3)}
"""Information of one datum with σ = 1: 1/variance of the estimate if its errors are distributed as the loss assumes."""
EXPECTED = {"normal": 1.0, "student": (STUDENT_DOF + 1) * float(digamma((STUDENT_DOF + 1) / 2) - digamma(STUDENT_DOF / 2))}
"""Mean deviance of one datum whose errors are distributed as the loss assumes."""

How = tuple[tuple[Any, ...], tuple[Observable, ...], Callable]
"""What of a problem is no number: observables, model, whether it is relaxed, and options of exact data; and observables and
the coordinates of emulated ones."""


@cache
def _derivatives(observable: Observable) -> Kernel:
    """Cost of data (μ, value, σ), its slope and two bends.

    A positive bend, and the full one, in μ.
    """

    def one(mu: Array, value: Array, sigma: Array) -> tuple[Array, ...]:
        first = partial(jax.value_and_grad(_cost_of), value=value, sigma=sigma, observable=observable)
        (found, slope), (_, second) = jax.jvp(first, (mu,), (jnp.ones_like(mu),))
        if observable.is_value:
            # the Gauss–Newton part, which weights the residual by the slope of the loss
            r2 = jnp.where(jnp.isfinite(mu), jnp.square((mu - value) / sigma), 0)
            bend = jnp.where(jnp.isfinite(mu), jax.grad(loss_of)(r2 / 2, observable.loss) / jnp.square(sigma), 0)
        else:
            # log-concave: between zero and the curvature of a single edge
            bend = second = jnp.clip(second, 0, 1 / jnp.square(jnp.maximum(sigma, SHARPEST)))
        return found, slope, bend, second

    return lambda columns: jax.vmap(one)(*columns)


def costs(mu: np.ndarray, data: Observations, lane: np.ndarray) -> np.ndarray:
    """−ln p of every datum of exact predictions, with derivatives.

    Of shape (4, B, n); the third is a positive bend, the last the full one. `mu` are predictions, (B, n), of replicates
    `lane`, (B,).
    """
    value, weight = data.value[lane], data.weight[lane]
    given = np.broadcast_arrays(mu, value, data.sigma)
    found = over_lanes(_derivatives(data.observable), [x.ravel() for x in given], LAYOUT)
    columns = np.reshape(found, (4, *mu.shape))
    return weight * np.where(weight > 0, columns, 0)  # a datum that is left out may cost inf, and 0 times inf is NaN


def log_densities(observable: Observable, mu: np.ndarray, value: np.ndarray, sigma: Any) -> np.ndarray:
    """Log density of each datum given its prediction.

    Arrays that broadcast; predictions are inf where a front never stops.
    """
    numbers = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (mu, value, sigma)))
    return -np.reshape(over_lanes(_values(observable), [x.ravel() for x in numbers], LAYOUT)[0], numbers[0].shape)


@cache
def _values(observable: Observable) -> Kernel:
    """Cost of data (μ, value, σ)."""
    return lambda columns: (jax.vmap(partial(_cost_of, observable=observable))(*columns),)


def _cost_of(mu: Array, value: Array, sigma: Array, observable: Observable) -> Array:
    return -observable.log_density(Prediction(mu[None]), Reading(value[None], sigma[None], jnp.ones(1, mu.dtype)))


# --- data with an error of the model --------------------------------------------------------------------------------------


class Joint(NamedTuple):
    """Density of data that err together at one θ."""

    value: Any  # −ln p; the others only if they were asked for
    slope: Any = None  # (p,)
    information: Any = None  # (p, p), Fisher's, of means and covariances
    means: tuple[Any, ...] = ()  # (n,) of each observable
    covariances: tuple[Any, ...] = ()  # (n, n), of what the model leaves open


def emulated(
    kinds: tuple[Observable, ...], coordinates: Callable, numbers: tuple[Observations, ...], emulator: Emulator, theta: Array
) -> list[Prediction]:
    """Predictions of every observable by an emulator at one θ."""
    inputs = numbers[0].inputs.at(theta)
    outputs = jax.vmap(lambda one, place: one(place))(emulator, coordinates(inputs, jnp))
    return [data.predicted(kind.emulate(outputs, inputs, data), theta) for kind, data in zip(kinds, numbers, strict=True)]


def _joint(
    kinds: tuple[Observable, ...],
    coordinates: Callable,
    slopes: bool,
    numbers: Any,
    emulator: Emulator,
    theta: Array,
    value: Any,
    weight: Any,
) -> Joint:
    """Evaluate `Joint` at many θ, (B, p), against replicates.

    Values and weights are (B, n) for each observable.
    """

    def one(theta: Array, value: Any, weight: Any) -> Joint:
        read = [data.reading(*own) for data, *own in zip(numbers, value, weight, strict=True)]

        def every(theta: Array) -> list[Prediction]:
            return emulated(kinds, coordinates, numbers, emulator, theta)

        def along(way: Array) -> tuple[Any, Any]:  # of means and covariances
            return jax.jvp(lambda x: [one._replace(draws=None) for one in every(x)], (theta,), (way,))

        if not slopes:
            return Joint(_cost(kinds, every(theta), read))
        cost, slope = jax.value_and_grad(lambda x: _cost(kinds, every(x), read))(theta)
        slope = jnp.where(jnp.isfinite(cost), slope, 0)  # beside an impossible point, differences of slopes stay finite
        found, moves = jax.vmap(along, out_axes=(None, -1))(jnp.eye(len(theta)))
        information = jnp.stack([_information(*each) for each in zip(found, moves, read, strict=True)]).sum(axis=0)
        return Joint(cost, slope, information, *zip(*(one[:2] for one in found), strict=True))

    return jax.vmap(one)(theta, value, weight)


def _cost(kinds: tuple[Observable, ...], found: Iterable[Prediction], read: Iterable[Reading]) -> Array:
    """−ln p of the data of every observable."""
    every = list(zip(kinds, found, read, strict=True))
    each = [kind.log_density(one, own) for kind, one, own in every if one.draws is None]
    return -jnp.stack([*each, *_of_draws([one for one in every if one[1].draws is not None])]).sum()


def _of_draws(every: list[tuple[Observable, Prediction, Reading]]) -> list[Array]:
    """Log density of data that are draws.

    The mean over the draws of each event, of which all that was measured goes together; and outliers.
    """
    if not every:
        return []
    draws: list[Any] = [one.draws for _, one, _ in every]
    groups = [one.group.astype(int) for one in draws]
    kernels = [(jnp.where(one.stops, one.value, jnp.inf), one.width) for one in draws]
    wide = [(one.mean[:, None], jnp.abs(one.mean)[:, None]) for _, one, _ in every]
    weight = jnp.concatenate([one.weight for one in draws])

    def of_groups(predicted: list[tuple[Array, Array]]) -> Array:
        each = zip(every, predicted, groups, strict=True)
        return jnp.stack([kind.of_events(*own, read, at, len(weight)) for (kind, _, read), own, at in each]).sum(axis=0)

    # an event's draws have the weights of its last datum; those of none add up to 1
    share = jnp.zeros_like(weight).at[:, 0].set(1.0).at[jnp.concatenate(groups)].set(weight)
    like = jax.scipy.special.logsumexp(of_groups(kernels), axis=1, b=share)
    outlier = of_groups(wide)[:, 0]
    return [jnp.logaddexp(like + np.log1p(-OUTLIERS), outlier + np.log(OUTLIERS)).sum()]


def _information(found: Prediction, slope: Prediction, read: Reading) -> Float[Array, "p p"]:
    """Fisher's information of mean and covariance of a normal distribution."""
    used = (read.weight > 0) & jnp.isfinite(found.mean)
    both = used[:, None] & used[None]
    every = jnp.where(both, found.covariance, 0) + jnp.diag(jnp.where(used, read.sigma**2, 1.0))
    if found.heavy is not None:
        size = jnp.where(found.heavy > 0, INFORMATION["student"], 1.0) ** -0.5
        every = every * size[:, None] * size[None]
    n, p = slope.mean.shape
    columns = jnp.concatenate([slope.mean, slope.covariance.reshape(n, n * p)], axis=1)
    white, _ = whitened(every, jnp.where(used[:, None], columns, 0))
    mean, half = white[:, :p], white[:, p:].reshape(n, n, p)
    full = whitened(every, jnp.where(used[:, None, None], jnp.moveaxis(half, 0, 1), 0).reshape(n, n * p))[0].reshape(n * n, p)
    return mean.T @ mean + full.T @ full / 2


_emulated = jax.jit(emulated, static_argnums=(0, 1))


@cache
def _program(kinds: tuple[Observable, ...], coordinates: Callable, slopes: bool, tree: Any, shapes: tuple[Any, ...]) -> Any:
    """`_joint` of arrays of these shapes, and the tree of its results."""

    def flat(*arrays: Array) -> tuple[Array, ...]:
        return tuple(jax.tree.leaves(_joint(kinds, coordinates, slopes, *jax.tree.unflatten(tree, arrays))))

    given = [jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in shapes]
    named = (_joint, slopes, [(kind.name, kind.loss, kind.drawn) for kind in kinds])
    program = compiled(flat, *given, device=local_devices(cpu=True)[0], fusion_emitters=False, named=named)
    each = (0,) * len(kinds)
    return program, jax.tree.structure(Joint(0, 0, 0, each, each) if slopes else Joint(0))  # known without tracing it


class Evaluation(NamedTuple):
    """Values at B points; derivatives that were not requested are empty."""

    value: Float[np.ndarray, " B"]  # −ln(likelihood × prior); inf where the model has no finite length
    gradient: Float[np.ndarray, "B p"] = np.empty(0)
    metric: Float[np.ndarray, "B p p"] = np.empty(0)  # Gauss–Newton part of the second derivative
    curvature: Float[np.ndarray, "B p p"] = np.empty(0)  # the full second derivative


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """Measurements and parameters: everything the log density depends on apart from θ.

    The standard errors that a fit uses are those of `observed`: as stated, enlarged by `widened`, or scaled by `with_sigma`.
    """

    measurements: Measurements
    parameters: ParameterSet
    observed: tuple[Observations, ...]  # what the rows of the table are about first
    prior_mean: np.ndarray  # (R, p), one for each replicate
    prior_weight: np.ndarray  # 1/σ² of the priors, (p,)
    points: Points = NOWHERE  # at which an expensive model was followed
    through: np.ndarray | None = None  # those of them through which the emulator goes
    emulator: Emulator | None = None  # of them, along its first axis of each distinct input
    known: bool = True  # whether errors were stated, so that the deviance tests the model
    simulated: tuple[float, ...] | None = None  # skewness, mean and spread of deviances of tables drawn at the fit
    held: np.ndarray | None = None  # (p,), θ that stay where they are: derivatives in them are left 0
    tick: Callable[[int], object] | None = None  # called with the number of lengths computed, to show progress

    @property
    def of_rows(self) -> list[Observations]:
        """What the rows of the table are about: one datum each."""
        return [data for data in self.observed if data.observable.of_rows]

    def by_row(self, each: Callable[[Observations], np.ndarray]) -> np.ndarray:
        """Numbers of what the rows are about, in their order; (…, n)."""
        every = [(data.measurement, np.asarray(each(data))) for data in self.of_rows]
        found = np.full((*every[0][1].shape[:-1], len(self.measurements)), np.nan)
        for rows, numbers in every:
            found[..., rows] = numbers
        return found

    @property
    def loss(self) -> Loss:
        """Loss function of the residuals of values."""
        return self.observed[0].observable.loss

    @property
    def p(self) -> int:
        """Number of fitted parameters."""
        return len(self.prior_weight)

    @property
    def count(self) -> int:
        """Number of data, including the priors, which were measured too."""
        return sum(len(data.rows) for data in self.observed) + int((self.prior_weight > 0).sum())

    @property
    def values(self) -> int:
        """Number of values and priors; not of counts and limits."""
        return self.count - sum(len(data.rows) for data in self.observed if not data.observable.is_value)

    @property
    def exact_values(self) -> bool:
        """Whether every datum is a value with an error."""
        return self.values == self.count

    @property
    def emulates(self) -> bool:
        """Whether data are predicted by an emulator."""
        return any(data.observable.emulated for data in self.observed)

    def testable(self, theta: np.ndarray) -> int | None:
        """Degrees of freedom of the deviance at its minimum θ.

        Beyond `perfect`; None where its distribution is not known. Of values and priors it is χ², with a degree for each less
        one for each parameter. That holds beside counts and fronts without arrest too, if these cost nothing at the minimum. If
        some do, the degrees of freedom are an upper bound: none is subtracted for parameters, and one with an error adds two,
        since a datum of probability below P occurs with a probability of at most P (2 P for counts, which are off either way),
        so that −2 ln P is at most χ² of two degrees. If there is no other datum, those without an error add two each as well.
        """
        if self.loss != "normal" or not self.known:
            return None
        binding, blurred = 0, 0
        for data in (data for data in self.observed if not data.observable.is_value):
            cost = costs(self.predicted(theta, data), data, np.zeros(1, int))[0, 0]
            there = cost - data.observable.perfect(data.reading()) > 1e-6  # which the model does not meet
            binding, blurred = binding + int(there.sum()), blurred + int((there & (data.sigma > 0)).sum())
        dof = (self.values + 2 * blurred or 2 * binding) if binding else self.values - self.p
        return dof if dof > 0 else None

    def p_value(self, theta: np.ndarray, deviance: float, dof: int | None) -> float | None:
        """Probability of so large a deviance at θ.

        With `testable` degrees of freedom; of an emulator, by tables drawn at the fit.
        """
        if dof is None or (self.drawn and self.simulated is None):
            return None
        if self.simulated is not None:
            return float(pearson3.sf(deviance, *self.simulated))
        return float(chdtrc(dof, deviance - self.perfect(theta)))

    @property
    def alike(self) -> bool:
        """Whether contacts of a sequence are taken as alike."""
        scatter = self.parameters.inputs.more.get("log_scatter")
        return self.emulates and scatter is not None and bool(np.isneginf(scatter.base).all())

    @property
    def drawn(self) -> bool:
        """Whether data are draws, of contacts that differ."""
        return self.parameters.front.drawn

    def draws(self, theta: np.ndarray) -> list[Any]:
        """What data may be at θ, as `Draws` of each observable."""
        kinds = tuple(data.observable for data in self.learnt)
        with jax.enable_x64(True):
            found = _emulated(kinds, self.parameters.front.coordinates, self._numbers, self.emulator, theta)
        return [jax.tree.map(np.asarray, one.draws) for one in found]

    def accepts(self, theta: np.ndarray, deviance: float, most: float = np.inf) -> bool:
        """Whether the data fit at a minimum.

        By p, or where none is known, or takes long, by a deviance of `most` at the most.
        """
        if self.drawn:
            return deviance <= most
        p = self.p_value(theta, deviance, self.testable(theta)) if np.isfinite(deviance) else 0.0
        return deviance <= most if p is None else p >= IMPROBABLE

    def perfect(self, theta: np.ndarray, lane: int = 0) -> float:
        """Deviance if the model met all data at θ.

        0, but for blurred counts and errors of the model.
        """
        least = 0.0
        for data in self.observed:
            used = data.weight[lane] > 0
            least += 2 * float((data.weight[lane] * data.observable.perfect(data.reading(data.value[lane])))[used].sum())
            if data.observable.emulated:
                spread = (self.covariance(theta, data) + np.diag(data.sigma**2))[np.ix_(used, used)]
                least += float(np.linalg.slogdet(spread)[1] - 2 * np.log(data.sigma[used]).sum())
        return least

    def __call__(self, theta: Float[np.ndarray, "B p"], lane: np.ndarray | None = None, order: int = 0) -> Evaluation:
        """Evaluate −ln(likelihood × prior) at every θ, with derivatives to `order`.

        Against replicate `lane`, by default the measurements.
        """
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        lane = np.zeros(len(theta), dtype=int) if lane is None else lane
        widest = max(len(data.rows) for data in self.observed) * self.p**order
        at_once = max(1, ELEMENTS // widest)
        parts = [
            self._evaluate(theta[start : start + at_once], lane[start : start + at_once], order)
            for start in range(0, len(theta), at_once)
        ]
        return Evaluation(*map(np.concatenate, zip(*parts, strict=True)))

    def traced(self, theta: Float[Array, " p"]) -> Float[Array, ""]:
        """The value at one θ, (p,), as a JAX function.

        For `jax.jit`, `jax.vmap` and `jax.grad`, and up to rounding that of a call; in double precision only under
        ``jax.enable_x64``. θ is in the order of `parameters.names`; the bounds are not part of it.
        """
        return density(*self.parts, theta)

    @property
    def parts(self) -> tuple[How, Any]:
        """What of a problem is no number, and its numbers."""
        q, how, exact, front = self.parameters, [], [], self.parameters.front
        for every, own in self._together:
            relaxed = own.inputs.relaxed
            options = own.observable.options(front, own, q.low, q.high)
            how.append((tuple(data.observable for data in every), front, relaxed, options))
            exact.append((own._replace(observable=None), tuple(data.reading() for data in every)))
        kinds = tuple(data.observable for data in self.learnt)
        read = tuple(data.reading() for data in self.learnt)
        learnt = (self._numbers, self.emulator, read) if kinds else None
        return (tuple(how), kinds, front.coordinates), (self.prior_mean[0], self.prior_weight, tuple(exact), learnt)

    def _evaluate(self, theta: np.ndarray, lane: np.ndarray, order: int) -> Evaluation:
        """Sum the cost over priors and observables, with its derivatives."""
        off = theta - self.prior_mean[lane]
        value = (self.prior_weight * off**2).sum(axis=1) / 2
        gradient = self.prior_weight * off
        metric = np.broadcast_to(np.diag(self.prior_weight), (len(theta), self.p, self.p)).copy()
        curvature = metric.copy()
        if self.emulates:
            found = self.jointly(theta, lane, slopes=order > 0 or not self.learnt[0].observable.drawn)
            value = value + found.value
            if found.slope is not None:
                gradient, metric = gradient + found.slope, metric + found.information
            curvature = curvature + self._bends(theta, lane) if order > 1 else curvature
        for data, mu, first, second in self._each_exact(theta, order):
            cost, slope, positive, bend = costs(mu, data, lane)
            value = value + cost.sum(axis=1)
            if first is None:
                continue
            across = np.swapaxes(first, 1, 2)
            gradient = gradient + np.einsum("bn,bnp->bp", slope, first)
            metric = metric + np.matmul(across * positive[:, None, :], first)
            if second is not None:
                curvature = curvature + np.matmul(across * bend[:, None, :], first) + np.einsum("bn,bnpq->bpq", slope, second)
        return Evaluation(*(value, gradient, metric, curvature)[: (1, 3, 4)[order]])

    @cached_property
    def of_points(self) -> np.ndarray:
        """−ln(likelihood × prior) by the emulator at its points, (t,)."""
        return self(self.points.theta).value

    @property
    def learnt(self) -> list[Observations]:
        """Data that an emulator predicts."""
        return [data for data in self.observed if data.observable.emulated]

    @property
    def exact(self) -> list[Observations]:
        """Data that the model predicts exactly."""
        return [data for data in self.observed if not data.observable.emulated]

    @cached_property
    def _together(self) -> list[tuple[list[Observations], Observations]]:
        """Exact data that are predicted alike, as lengths and counts, joined."""
        alike: dict[Any, list[Observations]] = {}
        for data in self.exact:
            kind = data.observable
            alike.setdefault((kind.column.quantity, type(kind).predict, type(kind).evaluate), []).append(data)
        return [(every, _joined(every)) for every in alike.values()]

    def _each_exact(self, theta: np.ndarray, order: int) -> Iterator[tuple[Observations, np.ndarray, Any, Any]]:
        """Exact data of each observable, and their `_predictions`."""
        for every, own in self._together:
            found, start = self._predictions(own, theta, order), 0
            for data in every:
                mine = slice(start, start := start + len(data.rows))
                mu, first, second = (None if x is None else x[:, mine] for x in found)
                assert mu is not None
                yield data, mu, first, second

    @cached_property
    def _numbers(self) -> tuple[Any, ...]:
        inputs = self.learnt[0].inputs.stacked()
        return tuple(data._replace(observable=None, inputs=inputs, value=None, weight=None) for data in self.learnt)

    def jointly(self, theta: np.ndarray, lane: np.ndarray | None = None, *, slopes: bool = True) -> Joint:
        """Density of emulated data at every θ, (B, p).

        With `slopes`, and predictions, or its value alone.
        """
        lane = np.zeros(len(theta), int) if lane is None else lane
        kinds, parts = tuple(data.observable for data in self.learnt), []
        if self.tick is not None:
            self.tick(len(theta))
        for start in range(0, len(theta), AT_ONCE):
            count = len(theta[start : start + AT_ONCE])
            rows = np.resize(np.arange(start, start + count), AT_ONCE)  # one shape, so that one program is compiled
            value, weight = ([getattr(data, name)[lane[rows]] for data in self.learnt] for name in ("value", "weight"))
            arrays, tree = jax.tree.flatten((self._numbers, self.emulator, theta[rows], value, weight))
            arrays = [np.asarray(x) for x in arrays]
            shapes = tuple((x.shape, x.dtype) for x in arrays)
            program, results = _program(kinds, self.parameters.front.coordinates, slopes, tree, shapes)
            with jax.enable_x64(True):
                found = program(*arrays)
            parts.append(jax.tree.unflatten(results, [np.asarray(x)[:count] for x in found]))
        found = jax.tree.map(lambda *x: np.concatenate(x), *parts)
        return found._replace(value=np.where(np.isnan(found.value), np.inf, found.value))

    def _bends(self, theta: np.ndarray, lane: np.ndarray) -> np.ndarray:
        """Second derivatives of emulated data, by differences of the gradient.

        Of shape (B, p, p).

        JAX's own take 10 s of processor to compile, where the gradient takes 5; these agree to 1e-4.
        """
        q, p, count = self.parameters, self.p, len(theta)
        step = BEND * np.diag(q.high - q.low)
        sides = [self.jointly((theta + side * step[:, None]).reshape(-1, p), np.tile(lane, p)).slope for side in (1, -1)]
        found = (sides[0] - sides[1]).reshape(p, count, p) / (2 * np.diag(step)[:, None, None])
        return (np.moveaxis(found, 0, 1) + np.moveaxis(found, 0, 2)) / 2

    def _predictions(
        self, data: Observations, theta: np.ndarray, order: int
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Predict every datum exactly, (B, n), with derivatives in θ.

        Of shapes (B, n, p) and (B, n, p, p). Those in θ that are held are 0; those above `order` None.
        """
        p, free = self.p, np.arange(self.p) if self.held is None else np.flatnonzero(~self.held)
        if not order or not len(free):
            (mu,) = self._along(data, theta, None)
            first, second = (np.zeros((*mu.shape, *[p] * k)) if k <= order else None for k in (1, 2))
            return mu, first, second
        pairs = list(itertools.combinations(range(len(free)), 2)) if order == 2 else []
        axes = np.eye(p)[free]
        mu, slope, bend = self._along(data, theta, np.array([*axes, *(axes[i] + axes[j] for i, j in pairs)]))
        first = np.zeros((*mu.shape, p))
        first[..., free] = np.moveaxis(slope[: len(free)], 0, -1)
        if order == 1:
            return mu, first, None
        second = np.zeros((*mu.shape, p, p))
        second[..., free, free] = np.moveaxis(bend[: len(free)], 0, -1)
        for (i, j), both in zip(pairs, bend[len(free) :], strict=True):  # d²/dθ_i dθ_j from the bend along both
            second[..., free[i], free[j]] = second[..., free[j], free[i]] = (both - bend[i] - bend[j]) / 2
        return mu, first, second

    def _along(self, data: Observations, theta: np.ndarray, directions: np.ndarray | None) -> tuple[np.ndarray, ...]:
        """μ, (B, n), and its two derivatives along directions, (D, B, n)."""
        inputs, names, evaluate = data.inputs.at(theta), data.inputs.names, data.observable.evaluate
        lanes, distinct = inputs.poisson.shape
        scale, offset = np.exp(data.scale(theta)), data.offset(theta)
        if self.tick is not None:
            self.tick(lanes * distinct)
        if directions is None:
            (found,) = evaluate(self.parameters.front, inputs.ravel())
            return (found.reshape(lanes, distinct)[:, data.rows] * scale + offset,)
        count = len(directions)
        moves = np.stack([directions @ data.inputs.get(name).slope.T for name in names], axis=-1)  # (D, distinct, inputs)
        way = np.repeat(moves[:, None], lanes, axis=1).reshape(-1, len(names))
        every = inputs.map(lambda x: np.broadcast_to(x, (count, lanes, distinct))).ravel()
        found = evaluate(self.parameters.front, every, way)
        value, first, second = found.reshape(3, count, lanes, distinct)[..., data.rows] * scale
        # scales and offset change the prediction even where no input does, as with a held stiffness
        size = np.where(np.isfinite(value), value, 0)
        s, o = ((directions @ x.slope.T)[:, None] for x in (data.scale, data.offset))
        return value[0] + offset, first + s * size + o, second + s * (2 * first + s * size)

    @property
    def plain(self) -> bool:
        """Whether the deviance beyond `perfect` is a sum of squares.

        Of Gaussian values.
        """
        return self.exact_values and self.loss == "normal" and not self.drawn

    @property
    def simulable(self) -> bool:
        """Whether predictions alone say how probable each datum is."""
        return self.plain and not self.emulates

    @property
    def named_deviance(self) -> str:
        """``chi-squared``, where it is one."""
        return "chi-squared" if self.plain else "deviance"

    def fits(self, theta: np.ndarray, deviance: float, p_value: float | None, dof: int | None) -> str:
        """State χ², its probability, and the part from inputs and priors.

        That part is of values off their means, and no residual; it is left out below `PART` of χ².
        """
        if self.drawn and p_value is not None:
            return f"of {SIMULATED} tables drawn at the fit {100 * p_value:.2g} % are less probable"
        misfit = round(deviance - self.perfect(theta), 9)  # no rounding errors
        parts = self.prior_weight * (theta - self.prior_mean[0]) ** 2
        pulled = dict.fromkeys(one.symbol for one, x in zip(self.parameters.free, parts, strict=True) if x > 0.1 * parts.sum())
        of = ""
        if parts.sum() > PART * misfit:
            of = f"; the fitted {listed([*pulled])} add{'s' * (len(pulled) == 1)} {parts.sum():.3g} of it"
        tested = "" if p_value is None else self.tested(p_value, dof)
        return f"{'the ' * (not self.plain)}{self.named_deviance} is {format_number(misfit, 3)}{tested}{of}"

    def tested(self, p_value: float | None, dof: int | None) -> str:
        """State ``for 5 degrees of freedom (p = 0.82)``.

        The probability alone where `testable` gives a bound on it.
        """
        p = "p < 1e-300" if not p_value or p_value < 1e-300 else f"p = {p_value:.2g}".replace("e-0", "e-")
        p = p.replace(" ", TIED)
        by = f", by {SIMULATED} simulated tables" * (self.simulated is not None)
        if self.drawn:
            return f" ({p}{by})"
        if (dof or 0) > self.values - self.p:
            return f" ({p.replace('=', 'at most')})"
        return f" for {plural(dof or 0, 'degree')} of freedom ({p}{by})"

    @property
    def sharp(self) -> bool:
        """Whether counts or limits without an error have edges."""
        return self.blurred(SHARPEST) is not self

    @property
    def steps(self) -> bool:
        """Whether predictions step from contact to contact, as fields that gauges read."""
        return any(data.observable.steps for data in self.observed)

    def predictions(self, theta: np.ndarray) -> np.ndarray:
        """Predictions for the data of all observables in turn; (B, N)."""
        at_once = max(1, ELEMENTS // max(len(data.rows) for data in self.observed))
        parts = [theta[start : start + at_once] for start in range(0, max(len(theta), 1), at_once)]
        return np.concatenate([np.concatenate([self.predicted(part, data) for data in self.observed], 1) for part in parts])

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """Residuals in σ, priors last, if `simulable`; shape (B, N + p).

        Very large where the front never stops.
        """
        value, sigma = (np.concatenate(x) for x in zip(*((one.value[0], one.sigma) for one in self.observed), strict=True))
        known = np.sqrt(self.prior_weight) * (theta - self.prior_mean[0])
        with np.errstate(invalid="ignore"):  # inf of a front that never stops
            found = np.concatenate([(self.predictions(theta) - value) / sigma, known], axis=1)
        return np.where(np.isfinite(found), found, 1e9)

    def predicted(self, theta: np.ndarray, data: Observations) -> np.ndarray:
        """Predict the data of one observable, (B, n).

        In λc, m or N/m.
        """
        theta = np.atleast_2d(theta)
        if data.observable.emulated:
            return self.jointly(theta).means[self._place(data)]
        return self._predictions(data, theta, 0)[0]

    def covariance(self, theta: np.ndarray, data: Observations) -> np.ndarray:
        """Covariance of what the model leaves open of one observable.

        Of shape (n, n), at one θ.
        """
        if not data.observable.emulated:
            return np.zeros((len(data.rows), len(data.rows)))
        return self.jointly(np.atleast_2d(theta)).covariances[self._place(data)][0]

    def _place(self, data: Observations) -> int:
        """Which of the emulated data these are."""
        return [one.observable for one in self.learnt].index(data.observable)

    def predict(self, theta: np.ndarray) -> np.ndarray:
        """Mean predictions of what the rows are about, (B, n), as `predicted`."""
        return self.by_row(lambda data: self.predicted(theta, data))

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Jacobian over σ, priors last; its square is Fisher's information.

        Of a value that is what the loss expects, of counts and limits the bend of their cost, of data that err together p rows.
        """
        theta, zero = np.atleast_2d(theta), np.zeros(1, int)
        rows = []
        if self.emulates:
            size, axes = np.linalg.eigh(self.jointly(theta).information[0])
            rows.append((axes * np.sqrt(np.maximum(size, 0))).T)
        for data, mu, first, _ in self._each_exact(theta, 1):
            if data.observable.is_value:
                expected = np.where(np.isfinite(mu[0]), INFORMATION[self.loss] / data.sigma**2, 0) * data.weight[0]
            else:
                expected = costs(mu, data, zero)[2, 0]
            rows.append(np.sqrt(expected)[:, None] * first[0])
        rows.append(np.diag(np.sqrt(self.prior_weight)))
        return np.concatenate(rows)

    # --- problems like it

    def changed(self, change: Callable[[Observations], Observations], *, of_rows: bool = False) -> "Problem":
        """Change all data, or only those that the rows are about."""
        observed = tuple(change(data) if data.observable.of_rows or not of_rows else data for data in self.observed)
        return dataclasses.replace(self, observed=observed)

    def widened(self, off: np.ndarray) -> "Problem":
        """Add an error of every row, in λc, in quadrature."""
        return self.with_errors(np.hypot(self.by_row(lambda data: data.sigma), off))

    def with_errors(self, sigma: np.ndarray) -> "Problem":
        """Replace the error of every row, in λc."""
        return self.changed(lambda data: data._replace(sigma=sigma[data.measurement]), of_rows=True)

    def with_sigma(self, factor: float, *, of_lengths: bool) -> "Problem":
        """Scale σ of all data, or of lengths alone, by a factor."""
        return self.changed(lambda data: data._replace(sigma=factor * data.sigma), of_rows=of_lengths)

    def blurred(self, width: float) -> "Problem":
        """Blur counts and limits by at least `width` λc; itself if blurred."""

        def blunt(data: Observations) -> Observations:
            return data if data.observable.is_value else data._replace(sigma=np.maximum(data.sigma, width))

        sharp = any(not data.observable.is_value and (data.sigma < width).any() for data in self.observed)
        return self.changed(blunt) if sharp else self

    def with_tables(self, theta: np.ndarray, values: Sequence[np.ndarray], random: np.random.Generator) -> "Problem":
        """Replace measurements, and prior means, by drawn ones.

        ``values`` are (R, n) for each kind of data; prior means are drawn about ``theta``.
        """
        count, known = len(values[0]), self.prior_weight > 0
        means = np.repeat(self.prior_mean[:1], count, axis=0)
        off = random.standard_normal((count, int(known.sum()))) / np.sqrt(self.prior_weight[known])
        means[:, known] = theta[known] + off
        weights = (np.repeat(data.weight[:1], count, axis=0) for data in self.observed)
        return self.with_replicates(zip(values, weights, strict=True), means)

    def with_replicates(self, drawn: Iterable[tuple[np.ndarray, np.ndarray]], means: np.ndarray) -> "Problem":
        """Replace values and weights, (R, n) each, and prior means, (R, p)."""
        both = zip(self.observed, drawn, strict=True)
        observed = tuple(data._replace(value=value, weight=weight) for data, (value, weight) in both)
        return dataclasses.replace(self, observed=observed, prior_mean=means)


def density(how: How, numbers: Any, theta: Float[Array, " p"]) -> Float[Array, ""]:
    """−ln(likelihood × prior) of the `parts` of a problem."""
    (exact, kinds, coordinates), (mean, weight, observed, learnt) = how, numbers
    total = (weight * (theta - mean) ** 2).sum() / 2
    for (observables, front, relaxed, options), (own, every) in zip(exact, observed, strict=True):
        predicted, start = _exactly(observables[0], front, relaxed, options, own, theta), 0
        for observable, reading in zip(observables, every, strict=True):
            found = Prediction(predicted[start : (start := start + len(reading.sigma))])
            total = total - observable.log_density(found, reading)
    if kinds:
        own, emulator, read = learnt
        found = emulated(kinds, coordinates, own, emulator, theta)
        total = total + _cost(kinds, found, read)
    return total


def _exactly(observable: Observable, front: Front, relaxed: bool, options: tuple, data: Any, theta: Array) -> Array:
    """Exact predictions for data that are predicted alike, at one θ."""

    def predict(data: Any, theta: Array) -> Array:
        found = observable.in_rows(front, data.inputs.at(theta), relaxed, *options)
        return data.predicted(Prediction(found[data.rows]), theta).mean

    return by_forward_mode(predict, held=data)(theta)  # the loop over breaks has no other mode


def _joined(every: Sequence[Observations]) -> Observations:
    """Data of several observables that are predicted as those of the first."""
    first, start = every[0], np.cumsum([0, *(len(data.inputs.poisson.base) for data in every)])
    rows = np.concatenate([data.rows + at for data, at in zip(every, start, strict=False)])
    linear = ((data.inputs, data.scale, data.offset) for data in every)
    inputs, scale, offset = jax.tree.map(lambda *each: np.concatenate(each), *linear)
    return first._replace(inputs=inputs, rows=rows, scale=scale, offset=offset) if len(every) > 1 else first


def make_problem(m: Measurements, parameters: ParameterSet) -> Problem:
    """Set up the density of measurements."""
    observed, outputs = [], {}
    for data in filter(None, (one.data(m, parameters) for one in parameters.observables)):
        each = data.observable.outputs
        if each:  # which output of an emulator is the first of each datum
            column = np.empty(len(data.rows), int)
            for i, unit in enumerate(data.rows.tolist()):
                column[i] = outputs.get(unit, 0)
                outputs[unit] = outputs.get(unit, 0) + each
            data = data._replace(more={**data.more, "column": column})
        observed.append(data)
    prior_sigma = np.array([one.prior_sigma for one in parameters.free])
    return Problem(
        measurements=m,
        parameters=parameters,
        observed=tuple(observed),
        prior_mean=np.array([[one.prior_mean for one in parameters.free]]),
        prior_weight=1 / prior_sigma**2,
    )
