"""Log density of measurements and priors, of which every inference consists.

A `Problem` is −ln p of each datum given its prediction (`length_cost`, `count_cost`, `at_least_cost`), summed with the Gaussian
priors. `Problem.traced` is a JAX function of one θ. A fit evaluates it for thousands of θ at once by calling the `Problem`: the
predictions and their derivatives come from the models of `slippulse_jax.inference.model.fronts`, value and derivatives of the
same cost functions from `jax.grad`, and the chain rule, θ being linear in the inputs, joins the two.

Constants are left out such that a datum the model meets exactly costs nothing: twice the sum is χ² for plain lengths.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterable
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy import special
from jax.typing import ArrayLike
from jaxtyping import Array, Float
from scipy.special import chdtrc, digamma, erf

from slippulse_jax.base.shown import TIED, format_number, listed, plural
from slippulse_jax.bulk.chunks import Kernel, Layout, over_lanes
from slippulse_jax.bulk.derivatives import by_forward_mode
from slippulse_jax.inference.choices import Loss
from slippulse_jax.inference.model.fronts import BlockSequence, Front
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.observables import OBSERVED, predicted
from slippulse_jax.inference.model.parameters import Linear, ParameterSet
from slippulse_jax.inference.table.columns import READINGS
from slippulse_jax.inference.table.measurements import Gauges, Measurements

STUDENT_DOF = 4.0
SHARPEST = 1e-3
"""Blur, in λc, used for σ = 0 at the ends of a count's interval, so that the likelihood has a slope there."""

EXACT = 1e-12
"""Blur where no slope is needed: the interval itself, to rounding."""

SCATTERED = 0.05
"""Probability of χ², or of the largest pull, below which the report remarks on it."""
LEFT_OUT = 1e12
"""What the variance of a correlated datum that is left out is multiplied by."""
PART = 0.1
"""Part of χ² from fitted inputs and priors from which on it is stated."""
IMPROBABLE = 1e-3
"""Probability of χ² below which model and σ do not describe the data."""

LAYOUT = Layout(chunk=128, fusion_emitters=False)
"""Layout of data for the compiled cost functions."""

ELEMENTS = 2_000_000
"""Elements of the largest array held at once; more points are evaluated in turns."""

INFORMATION = {"normal": 1.0, "student": (STUDENT_DOF + 1) / (STUDENT_DOF + 3)}
"""Information of one datum with σ = 1: 1/variance of the estimate if its errors are distributed as the loss assumes."""
EXPECTED = {"normal": 1.0, "student": (STUDENT_DOF + 1) * float(digamma((STUDENT_DOF + 1) / 2) - digamma(STUDENT_DOF / 2))}
"""Mean deviance of one datum whose errors are distributed as the loss assumes."""


def loss_of(half_square: ArrayLike, loss: Loss = "normal") -> Array:
    """Loss as a function of r²/2; its derivative weights a residual."""
    u = jnp.asarray(half_square)
    return (STUDENT_DOF + 1) / 2 * jnp.log1p(2 * u / STUDENT_DOF) if loss == "student" else u


# −ln p of a datum given the prediction μ.


def length_cost(mu: Array, value: ArrayLike, sigma: ArrayLike, loss: Loss = "normal") -> Array:
    """−ln p of a value, beyond a perfect match's; inf for inf."""
    finite = jnp.isfinite(mu)
    r = (jnp.where(finite, mu, value) - value) / sigma
    return jnp.where(finite, loss_of(r**2 / 2, loss), jnp.inf)


def count_cost(mu: Array, value: ArrayLike, sigma: ArrayLike, sharpest: float = SHARPEST) -> Array:
    """−ln p of n counted contacts.

    A length between n − 1 and n: −ln[Φ((n − μ)/σ) − Φ((n − 1 − μ)/σ)], with a blur σ. A count of 1 is any length up to 1, 0
    included: contact 0 breaks even where no domino starts. It costs −ln Φ((1 − μ)/σ).
    """
    blur = jnp.maximum(sigma, sharpest)
    finite = jnp.isfinite(mu)
    inside = jnp.where(finite, mu, value)
    a, b = (value - 1 - inside) / blur, (value - inside) / blur
    # in the upper tail subtract the two tails, not two numbers close to one
    bounded = jnp.asarray(value) > 1
    flip = bounded & (a > 0)
    lower, upper = jnp.where(flip, -b, a), jnp.where(flip, -a, b)
    top = log_ndtr(upper)
    below = jnp.where(bounded, jnp.minimum(log_ndtr(lower) - top, -1e-300), -jnp.inf)
    return jnp.where(finite, -top - jnp.log1p(-jnp.exp(below)), jnp.inf)


def at_least_cost(mu: Array, value: ArrayLike, sigma: ArrayLike) -> Array:
    """−ln Φ((μ − value)/σ): a front past `value`; 0 for inf."""
    finite = jnp.isfinite(mu)
    cost = -log_ndtr((jnp.where(finite, mu, value) - value) / jnp.maximum(sigma, SHARPEST))
    return jnp.where(finite, cost, jnp.where(jnp.isnan(mu), jnp.inf, 0))


def log_ndtr(x: Array) -> Array:
    """Logarithm of the normal distribution function, far down by its series."""
    is_far = x < -20
    far = jnp.where(is_far, x, -20.0)
    series = jnp.ones_like(far)
    for k in range(10, 0, -1):
        series = 1 - (2 * k - 1) / far**2 * series
    tail = -(far**2) / 2 - jnp.log(-far) - np.log(2 * np.pi) / 2 + jnp.log(series)
    return jnp.where(is_far, tail, special.log_ndtr(jnp.where(is_far, -20.0, x)))


How = tuple[Front, Loss, tuple[tuple[str, tuple[str, ...], bool, tuple[Any, ...]], ...]]
"""What of a problem is no number: model, loss, and of each observable name, kinds of data, whether relaxed, and options."""
COSTS = {"length": length_cost, "whole": count_cost, "at_least": at_least_cost}
"""By the kind of a measurement."""


def _cost(kind: str, loss: Loss) -> Callable[..., Array]:
    return partial(length_cost, loss=loss) if kind == "length" else COSTS[kind]


def data_log_density(mu: ArrayLike, value: ArrayLike, sigma: ArrayLike, kind: str) -> np.ndarray:
    """Log density of data given their predictions, without the constants.

    Arrays that broadcast, NumPy float64; predictions are inf where the front never stops. A count with σ = 0 is its interval
    itself, and not one blurred as in a fit.
    """
    numbers = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (mu, value, sigma)))
    cost = over_lanes(_values(kind), [x.ravel() for x in numbers], LAYOUT)[0]
    return -cost.reshape(numbers[0].shape)


@cache
def _values(kind: str) -> Kernel:
    """Cost of data (μ, value, σ)."""
    cost = partial(count_cost, sharpest=EXACT) if kind == "whole" else COSTS[kind]
    return lambda columns: (jax.vmap(cost)(*columns),)


@cache
def _derivatives(kind: str, loss: Loss) -> Kernel:
    """Cost of data, its slope, and positive and full bend in μ."""
    cost = _cost(kind, loss)

    def one(mu: Array, value: Array, sigma: Array) -> tuple[Array, ...]:
        def first(mu: Array) -> tuple[Array, Array]:
            return jax.value_and_grad(cost)(mu, value, sigma)

        (found, slope), (_, second) = jax.jvp(first, (mu,), (jnp.ones_like(mu),))
        if kind == "length":
            # the Gauss–Newton part, which weights the residual by the slope of the loss
            r2 = jnp.where(jnp.isfinite(mu), jnp.square((mu - value) / sigma), 0)
            bend = jnp.where(jnp.isfinite(mu), jax.grad(loss_of)(r2 / 2, loss) / jnp.square(sigma), 0)
        else:
            # log-concave: between zero and the curvature of a single edge
            bend = second = jnp.clip(second, 0, 1 / jnp.square(jnp.maximum(sigma, SHARPEST)))
        return found, slope, bend, second

    return lambda columns: jax.vmap(one)(*columns)


class Observations(NamedTuple):
    """Data of one observable: n of R replicates, 1 as measured."""

    kind: np.ndarray  # (n,) of "length", "whole", "at_least"
    value: np.ndarray  # (R, n), in λc, m or N/m; the count, or the length run past
    sigma: np.ndarray  # (n,)
    weight: np.ndarray  # (R, n), how often a datum counts
    observable: str
    measurement: np.ndarray  # (n,), which measurement each datum belongs to
    inputs: Inputs  # a `Linear` of length m each: the distinct inputs of the model
    rows: np.ndarray  # (n,), which of them each datum has
    scale: Linear  # (n,), ln of the unit of the data in that of the model
    offset: Linear  # (n,)
    whitening: np.ndarray | None = None  # (n, n), which makes residuals of correlated errors independent, of σ = 1

    def independent(
        self, lane: np.ndarray, mu: np.ndarray, *derivatives: np.ndarray | None
    ) -> tuple["Observations", np.ndarray, list[np.ndarray | None]]:
        """Data of independent errors, with their predictions and derivatives.

        Themselves, or of correlated data their residuals.
        """
        if self.whitening is None:
            return self, mu, [*derivatives]
        each, used = self._whitening()[lane], self.weight[lane] > 0
        finite, value = np.isfinite(mu), self.value[lane]
        off = np.einsum("bij,bj->bi", each, np.where(finite & used, mu, value) - value)
        off = np.where((finite | ~used).all(axis=1, keepdims=True), off, np.inf)
        white = [x if x is None else np.einsum("bij,bj...->bi...", each, x) for x in derivatives]
        zero = np.zeros(self.value.shape)
        return self._replace(value=zero, sigma=zero[0] + 1, weight=zero + 1, whitening=None), off, white

    def _whitening(self) -> np.ndarray:
        """`whitening` of every replicate, (R, n, n), without data left out."""
        assert self.whitening is not None
        if self.weight.all():
            return np.broadcast_to(self.whitening, (len(self.weight), *self.whitening.shape))
        left_out = np.where(self.weight > 0, 0.0, LEFT_OUT * self.sigma**2)
        covariance = np.linalg.inv(self.whitening.T @ self.whitening)
        return np.linalg.inv(np.linalg.cholesky(covariance + left_out[:, None] * np.eye(len(self.sigma))))


def costs(mu: np.ndarray, data: Observations, lane: np.ndarray, loss: Loss) -> np.ndarray:
    """−ln p of every datum, with its slope and bends in μ.

    Of shape (4, B, n); the third is a positive bend, the last the full one. `mu` are predictions, (B, n), of replicates
    `lane`, (B,).
    """
    value, weight = data.value[lane], data.weight[lane]
    given = np.broadcast_arrays(mu, value, data.sigma)
    columns = np.empty((4, *mu.shape))
    for kind in COSTS:
        there = data.kind == kind
        if there.any():
            found = over_lanes(_derivatives(kind, loss), [x[:, there].ravel() for x in given], LAYOUT)
            columns[:, :, there] = np.reshape(found, (4, len(mu), there.sum()))
    return weight * np.where(weight > 0, columns, 0)  # a datum that is left out may cost inf, and 0 times inf is NaN


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
    observed: tuple[Observations, ...]  # of the lengths first
    loss: Loss
    prior_mean: np.ndarray  # (R, p), one for each replicate
    prior_weight: np.ndarray  # 1/σ² of the priors, (p,)
    held: np.ndarray | None = None  # (p,), θ that stay where they are: derivatives in them are left 0
    tick: Callable[[int], object] | None = None  # called with the number of lengths computed, to show progress

    @property
    def lengths(self) -> Observations:
        """The lengths, counts and fronts without arrest."""
        return self.observed[0]

    @property
    def p(self) -> int:
        """Number of fitted parameters."""
        return len(self.prior_weight)

    @property
    def count(self) -> int:
        """Number of data, including the priors, which were measured too."""
        return sum(data.value.shape[1] for data in self.observed) + int((self.prior_weight > 0).sum())

    @property
    def exact_values(self) -> bool:
        """Whether every datum is a value with an error."""
        return self.known == self.count

    def testable(self, theta: np.ndarray) -> int | None:
        """Degrees of freedom of the deviance at its minimum θ.

        Beyond `perfect`; None where its distribution is not known. Of values and priors it is χ², with a degree for each less
        one for each parameter. That holds beside counts and fronts without arrest too, if these cost nothing at the minimum. If
        some do, the degrees of freedom are an upper bound: none is subtracted for parameters, and one with an error adds two,
        since a datum of probability below P occurs with a probability of at most P (2 P for counts, which are off either way),
        so that −2 ln P is at most χ² of two degrees.
        """
        front = self.parameters.front
        if self.loss != "normal" or (isinstance(front, BlockSequence) and front.error_is_fitted):
            return None  # or the size of the errors was taken from the data
        data, lane = self.lengths, np.zeros(1, int)  # counts and fronts without arrest are lengths
        cost = costs(self.predict(theta), data, lane, self.loss)[0, 0]
        binding = (data.kind != "length") & (cost - self._least > 1e-6)  # which the model does not meet
        dof = self.known + 2 * int((binding & (data.sigma > 0)).sum()) if binding.any() else self.known - self.p
        return dof if dof > 0 else None

    def p_value(self, deviance: float, dof: int | None) -> float | None:
        """Probability of so large a deviance, with `testable` degrees of freedom."""
        return None if dof is None else float(chdtrc(dof, deviance - self.perfect))

    @property
    def improbable(self) -> float:
        """Probability of the deviance below which a model is refused.

        5 % where contacts of a sequence are taken as alike: those of a real interface are not, and what χ² hardly sees moves
        the stiffness by many of its errors.
        """
        front = self.parameters.front
        alike = isinstance(front, BlockSequence) and not self.parameters.inputs.get("threshold_scatter").base.any()
        return SCATTERED if alike else IMPROBABLE

    def accepts(self, theta: np.ndarray, deviance: float, most: float = np.inf) -> bool:
        """Whether the data fit at a minimum.

        By p, or where none is known by a deviance of `most` at the most.
        """
        p = self.p_value(deviance, self.testable(theta)) if np.isfinite(deviance) else 0.0
        return deviance <= most if p is None else p >= self.improbable

    @property
    def perfect(self) -> float:
        """Deviance where the model meets all: 0, but for blurred counts."""
        return 2 * float(self._least.sum())

    @property
    def _least(self) -> np.ndarray:
        """Least cost of each length: that of the middle of a count."""
        data = self.lengths
        between = (data.kind == "whole") & (data.value[0] > 1)
        return np.where(between, -np.log(erf(1 / (np.sqrt(8) * np.maximum(data.sigma, SHARPEST)))), 0.0)

    @property
    def known(self) -> int:
        """Number of values and priors; not of counts and limits."""
        return self.count - int((self.lengths.kind != "length").sum())

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
        front, ends, how = self.parameters.front, np.stack([self.parameters.low, self.parameters.high]), []
        for data in self.observed:
            relaxed = not any(x.base.any() or x.slope.any() for x in (data.inputs.prestress, data.inputs.threshold_slope))
            options = (_sites(self, data),) if data.observable in READINGS else ()
            if data.observable in ("length", "first"):
                options = front.most(data.inputs.log_height(ends).max(axis=0), data.inputs.names)
            how.append((data.observable, tuple(data.kind.tolist()), relaxed, options))
        numbers = tuple(data._replace(kind=None, observable=None) for data in self.observed)
        return (front, self.loss, tuple(how)), (self.prior_mean[0], self.prior_weight, numbers)

    def _evaluate(self, theta: np.ndarray, lane: np.ndarray, order: int) -> Evaluation:
        """Sum the cost over priors and observables, with its derivatives."""
        off = theta - self.prior_mean[lane]
        value = (self.prior_weight * off**2).sum(axis=1) / 2
        gradient = self.prior_weight * off
        metric = np.broadcast_to(np.diag(self.prior_weight), (len(theta), self.p, self.p)).copy()
        curvature = metric.copy()
        for data in self.observed:
            mu, *derivatives = self._predictions(data, theta, order)
            data, mu, (first, second) = data.independent(lane, mu, *derivatives)
            cost, slope, positive, bend = costs(mu, data, lane, self.loss)
            value = value + cost.sum(axis=1)
            if first is None:
                continue
            across = np.swapaxes(first, 1, 2)
            gradient = gradient + np.einsum("bn,bnp->bp", slope, first)
            metric = metric + np.matmul(across * positive[:, None, :], first)
            if second is not None:
                curvature += np.matmul(across * bend[:, None, :], first) + np.einsum("bn,bnpq->bpq", slope, second)
        return Evaluation(*(value, gradient, metric, curvature)[: (1, 3, 4)[order]])

    def _predictions(
        self, data: Observations, theta: np.ndarray, order: int
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Predict every datum, (B, n), with derivatives in θ.

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
        inputs, names = data.inputs.at(theta), data.inputs.names
        lanes, distinct = inputs.poisson.shape
        scale, offset = np.exp(data.scale(theta)), data.offset(theta)
        if self.tick is not None:
            self.tick(lanes * distinct)
        if directions is None:
            (found,) = predicted(data.observable, self.parameters.front, inputs.ravel())
            return (found.reshape(lanes, distinct)[:, data.rows] * scale + offset,)
        count = len(directions)
        moves = np.stack([directions @ data.inputs.get(name).slope.T for name in names], axis=-1)  # (D, distinct, inputs)
        way = np.repeat(moves[:, None], lanes, axis=1).reshape(-1, len(names))
        every = inputs.map(lambda x: np.broadcast_to(x, (count, lanes, distinct))).ravel()
        found = predicted(data.observable, self.parameters.front, every, way)
        value, first, second = found.reshape(3, count, lanes, distinct)[..., data.rows] * scale
        # scales and offset change the prediction even where no input does, as with a held stiffness
        size = np.where(np.isfinite(value), value, 0)
        s, o = ((directions @ x.slope.T)[:, None] for x in (data.scale, data.offset))
        return value[0] + offset, first + s * size + o, second + s * (2 * first + s * size)

    @property
    def plain(self) -> bool:
        """Whether the deviance is a sum of squares of Gaussian values."""
        return self.exact_values and self.loss == "normal"

    @property
    def named_deviance(self) -> str:
        """``chi-squared``, where it is one."""
        return "chi-squared" if self.plain else "deviance"

    def fits(self, theta: np.ndarray, deviance: float, p_value: float | None, dof: int | None) -> str:
        """State χ², its probability, and the part from inputs and priors.

        That part is of values off their means, and no residual; it is left out below `PART` of χ².
        """
        misfit = round(deviance - self.perfect, 9)  # no rounding errors
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
        if (dof or 0) > self.known - self.p:
            return f" ({p.replace('=', 'at most')})"
        return f" for {plural(dof or 0, 'degree')} of freedom ({p})"

    @property
    def only_counts(self) -> bool:
        """Whether one parameter is fitted to counts alone.

        Or to fronts without arrest, all without errors, and without a prior.
        """
        data, *others = self.observed
        exact = not (data.kind == "length").any() and not data.sigma.any()
        return self.p == 1 and not others and exact and not self.prior_weight.any()

    @property
    def gauged(self) -> bool:
        """Whether gauges were read, whose fields step from contact to contact."""
        return any(data.observable in READINGS for data in self.observed)

    def predictions(self, theta: np.ndarray) -> np.ndarray:
        """Predictions for the data of all observables in turn; (B, N)."""
        at_once = max(1, ELEMENTS // max(len(data.rows) for data in self.observed))
        parts = [theta[start : start + at_once] for start in range(0, max(len(theta), 1), at_once)]
        return np.concatenate(
            [np.concatenate([self._predictions(data, part, 0)[0] for data in self.observed], 1) for part in parts]
        )

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """Residuals in σ, priors last, if `plain`; shape (B, N + p).

        Very large where the front never stops.
        """
        value = np.concatenate([data.value[0] for data in self.observed])
        known = np.sqrt(self.prior_weight) * (theta - self.prior_mean[0])
        found = np.concatenate([self.in_errors(self.predictions(theta) - value), known], axis=1)
        return np.where(np.isfinite(found), found, 1e9)

    def in_errors(self, off: np.ndarray) -> np.ndarray:
        """Differences of predictions, (B, N), in independent errors."""
        ends = np.cumsum([len(data.rows) for data in self.observed])[:-1]
        parts = zip(self.observed, np.split(off, ends, axis=1), strict=True)
        with np.errstate(invalid="ignore"):  # inf of a front that never stops
            white = [part / data.sigma if data.whitening is None else part @ data.whitening.T for data, part in parts]
        return np.concatenate(white, axis=1)

    def predict(self, theta: np.ndarray, observable: str = "length") -> np.ndarray:
        """Predictions for one observable, (B, n), in λc, m or N/m."""
        (data,) = (one for one in self.observed if one.observable == observable)
        return self._predictions(data, np.atleast_2d(theta), 0)[0]

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Jacobian over σ, (n + priors, p); its square is Fisher's information.

        Of a value that is what the loss expects, of counts and limits the bend of their cost.
        """
        theta = np.atleast_2d(theta)
        rows = []
        for data in self.observed:
            mu, first, _ = self._predictions(data, theta, 1)
            data, mu, (first,) = data.independent(np.zeros(1, int), mu, first)
            assert first is not None
            exact, (positive,) = data.kind == "length", costs(mu, data, np.zeros(1, int), self.loss)[2]
            expected = np.where(np.isfinite(mu[0]), INFORMATION[self.loss] / np.where(exact, data.sigma, 1) ** 2, 0)
            rows.append(np.sqrt(np.where(exact, data.weight[0] * expected, positive))[:, None] * first[0])
        rows.append(np.diag(np.sqrt(self.prior_weight)))
        return np.concatenate(rows)

    def widened(self, off: np.ndarray) -> "Problem":
        """Add an error of every length, in λc, in quadrature."""
        lengths = self.lengths._replace(sigma=np.hypot(self.lengths.sigma, off))
        return dataclasses.replace(self, observed=(lengths, *self.observed[1:]))

    def with_sigma(self, factor: float, *, of_lengths: bool) -> "Problem":
        """Scale σ of all data, or of lengths alone, by a factor."""

        def scaled(data: Observations) -> Observations:
            return data._replace(sigma=factor * data.sigma)

        kept = self.observed[1:] if of_lengths else tuple(scaled(data) for data in self.observed[1:])
        return dataclasses.replace(self, observed=(scaled(self.lengths), *kept))

    def blurred(self, width: float) -> "Problem":
        """Blur counts and limits by at least `width` λc; itself if blurred."""
        data = self.lengths
        sharp = (data.kind != "length") & (data.sigma < width)
        blunt = data._replace(sigma=np.where(sharp, width, data.sigma))
        return dataclasses.replace(self, observed=(blunt, *self.observed[1:])) if sharp.any() else self

    def with_replicates(self, drawn: Iterable[tuple[np.ndarray, np.ndarray]], means: np.ndarray) -> "Problem":
        """Replace values and weights, (R, n) each, and prior means, (R, p)."""
        both = zip(self.observed, drawn, strict=True)
        observed = tuple(data._replace(value=value, weight=weight) for data, (value, weight) in both)
        return dataclasses.replace(self, observed=observed, prior_mean=means)


def density(how: How, numbers: Any, theta: Float[Array, " p"]) -> Float[Array, ""]:
    """−ln(likelihood × prior) of the `parts` of a problem."""
    (front, loss, each), (mean, weight, observed) = how, numbers
    prior = (weight * (theta - mean) ** 2).sum() / 2
    return sum((_traced(front, loss, *one, data, theta) for one, data in zip(each, observed, strict=True)), prior)


def _traced(
    front: Front, loss: Loss, observable: str, kinds: tuple[str, ...], relaxed: bool, options: tuple, data: Any, theta: Array
) -> Array:
    """−ln p of the data of one observable at one θ."""

    def predict(data: Any, theta: Array) -> Array:
        inputs = data.inputs.at(theta)
        if observable in ("length", "first"):
            found = front.in_rows(inputs, relaxed, *options)
        else:
            found = jax.vmap(lambda one: OBSERVED[observable](front, one, relaxed, *options))(inputs)
        return found[data.rows] * jnp.exp(data.scale(theta)) + data.offset(theta)

    mu = by_forward_mode(predict, held=data)(theta)  # the loop over breaks has no other mode
    if data.whitening is not None:
        finite = jnp.isfinite(mu)
        off = data.whitening @ (jnp.where(finite, mu, data.value[0]) - data.value[0])
        return jnp.where(finite.all(), jnp.square(off).sum() / 2, jnp.inf)
    total = jnp.zeros(())
    for kind in COSTS:
        there = np.nonzero(np.array(kinds) == kind)[0]
        if len(there):
            cost = _cost(kind, loss)(mu[there], data.value[0][there], data.sigma[there])
            total = total + (data.weight[0][there] * cost).sum()
    return total


def _sites(problem: Problem, data: Observations) -> int:
    """Number of contacts traced: eight times those needed amid the range."""
    middle = data.inputs.at((problem.parameters.low + problem.parameters.high) / 2)
    return 64 + 8 * int(max(np.exp(middle.get("log_position")).max(), middle.get("counted").max()))


def make_problem(m: Measurements, parameters: ParameterSet, loss: Loss, sigma: np.ndarray) -> Problem:
    """Set up the density of measurements; `sigma` of lengths, in λc."""
    every = np.arange(len(m))
    if isinstance(parameters.front, BlockSequence):
        observed = _of_sequences(m, parameters, parameters.front)
    else:
        observed = [_observations(parameters, "length", every, m.length, sigma, parameters.inputs, np.array(m.kind))]
    for observable in () if m.is_sequence else ("displacement", "force"):
        values = getattr(m, observable)
        if values is None or not np.isfinite(values).any():
            continue
        rows = np.nonzero(np.isfinite(values))[0]
        errors = getattr(m, f"{observable}_sigma")[rows]
        observed.append(_observations(parameters, observable, rows, values[rows], errors, parameters.inputs.take(rows)))
    if m.gauges is not None:
        observed += [_readings(m, m.gauges, parameters, name) for name in READINGS if m.gauges.there(name).any()]
    prior_sigma = np.array([one.prior_sigma for one in parameters.free])
    return Problem(
        measurements=m,
        parameters=parameters,
        observed=tuple(observed),
        loss=loss,
        prior_mean=np.array([[one.prior_mean for one in parameters.free]]),
        prior_weight=1 / prior_sigma**2,
    )


def _observations(
    q: ParameterSet,
    observable: str,
    rows: np.ndarray,
    value: np.ndarray,
    sigma: np.ndarray,
    inputs: Inputs,
    kind: np.ndarray | None = None,
) -> Observations:
    """Collect the data of one observable, with each distinct input once."""
    n = len(rows)
    given = [inputs.get(name) for name in inputs.names]
    key = np.concatenate([np.column_stack([one.base, one.slope]) for one in given], axis=1)
    _, first, own = np.unique(key, axis=0, return_index=True, return_inverse=True)
    none, added = Linear(np.zeros(n), np.zeros((n, len(q.free)))), {"length": "offset", "force": "force_offset"}
    return Observations(
        kind=np.full(n, "length") if kind is None else kind,
        value=value[None],
        sigma=sigma,
        weight=np.ones((1, n)),
        observable=observable,
        measurement=rows,
        inputs=inputs.take(first),
        rows=own.ravel(),
        scale=q.scales[observable][rows],
        offset=q.scales[added[observable]][rows] if observable in added else none,
    )


def _of_sequences(m: Measurements, q: ParameterSet, front: BlockSequence) -> list[Observations]:
    """Collect forces by place, and first lengths of numbered events.

    The forces stand where lengths do in other fits.
    """
    assert m.force is not None
    assert m.force_sigma is not None
    assert m.block_length is not None
    inputs, first, n, sigma = q.inputs, front.first, len(m), m.force_sigma
    forces = _observations(q, "length", np.arange(n), m.force, sigma, inputs)
    found = [forces._replace(scale=q.scales["reach"], offset=q.scales["force_offset"])]
    if len(first) and m.length_sigma is not None:
        own = inputs.take(first).given(datum=Linear(n + first.astype(float), np.zeros((len(first), len(q.free)))))
        value, error = np.log(m.length[first] / m.block_length[first]), m.length_sigma[first] / m.length[first]
        found.append(_observations(q, "first", first, value, error, own))
    return found


def _readings(m: Measurements, gauges: Gauges, q: ParameterSet, name: str) -> Observations:
    """Collect the gauges' readings of one kind."""
    there = gauges.there(name)
    rows = gauges.row[there]
    assert m.correlation_length is not None
    # a gauge at the very edge is placed a billionth of λc from it
    place = np.log(np.maximum(gauges.position[there] / m.correlation_length[rows], 1e-9))
    counted = np.where(np.array(m.kind)[rows] == "whole", m.length[rows], 0.0)
    unit = q.scales["position"][rows]
    inputs = q.inputs.take(rows).given(
        log_position=Linear(place - unit.base, -unit.slope),  # x/λc shrinks as λc grows
        beyond=q.scales["beyond"][rows],
        counted=Linear(counted, np.zeros_like(unit.slope)),
    )
    sigma = getattr(gauges, f"{name}_sigma")[there]
    return _observations(q, name, rows, getattr(gauges, name)[there], sigma, inputs)
