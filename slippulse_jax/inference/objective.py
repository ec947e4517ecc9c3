"""−ln(likelihood × prior) of measurements over the fitted θ, for any number of points at once, with its derivatives.

Everything that follows (search, profiles, bootstrap, posterior, design) is made of this one function.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from slippulse_jax.inference.forward import Prediction, displacements, forces, lengths
from slippulse_jax.inference.forward_gauges import slips, stresses
from slippulse_jax.inference.gauges import READINGS, Gauges
from slippulse_jax.inference.likelihood import Data, Loss, terms
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.parameters import WIDTH, ParameterSet

PREDICTED = {"length": lengths, "displacement": displacements, "force": forces, "slip": slips, "stress": stresses}
"""The model of every observable."""

ELEMENTS = 2_000_000  # of the largest array held at once; more points than that are taken in turns


class Evaluation(NamedTuple):
    """At B points; the derivatives are None where they were not asked for."""

    value: Float[np.ndarray, " B"]  # −ln(likelihood × prior); inf where the model has no finite length
    gradient: Float[np.ndarray, "B p"] | None = None
    metric: Float[np.ndarray, "B p p"] | None = None  # Gauss and Newton's part of the second derivative
    curvature: Float[np.ndarray, "B p p"] | None = None  # the whole of it


class _Block(NamedTuple):
    """The data of one observable."""

    observable: str
    measurement: np.ndarray  # (n,), which measurement each datum belongs to
    rows: np.ndarray  # (n,), which of the distinct model inputs each datum has
    base: np.ndarray  # (m, c), those inputs: y, and of gauges three more
    slope: np.ndarray  # (m, c, p)
    scale_base: np.ndarray  # (n,)
    scale_slope: np.ndarray  # (n, p)
    offset: np.ndarray  # (n, p)
    data: Data


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """Measurements and parameters as one objective."""

    parameters: ParameterSet
    blocks: tuple[_Block, ...]
    loss: Loss
    prior_mean: np.ndarray  # (R, p), one for each replicate
    prior_weight: np.ndarray  # 1/σ² of the priors, (p,)
    held: np.ndarray | None = None  # (p,), θ that stay where they are: derivatives in them are left 0

    @property
    def p(self) -> int:
        """Number of fitted parameters."""
        return len(self.prior_weight)

    @property
    def count(self) -> int:
        """Number of data, priors of inputs with errors among them: they were measured too."""
        return sum(block.data.value.shape[1] for block in self.blocks) + int((self.prior_weight > 0).sum())

    def __call__(self, theta: Float[np.ndarray, "B p"], lane: np.ndarray | None = None, order: int = 0) -> Evaluation:
        """Evaluate at every θ, against replicate `lane` (the measurements by default), with derivatives to `order`."""
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        lane = np.zeros(len(theta), dtype=int) if lane is None else lane
        widest = max(len(block.rows) for block in self.blocks) * (self.p if order else 1)
        at_once = max(1, ELEMENTS // widest)
        parts = [
            self._evaluate(theta[start : start + at_once], lane[start : start + at_once], order)
            for start in range(0, len(theta), at_once)
        ]
        joined = [None if column[0] is None else np.concatenate(column) for column in zip(*parts, strict=True)]
        found = Evaluation(*joined)  # pyright: ignore[reportArgumentType] - the first is always there
        return found._replace(curvature=self._curvature(theta, lane, found)) if order > 1 else found

    def _curvature(self, theta: np.ndarray, lane: np.ndarray, at: Evaluation) -> np.ndarray:
        """Central differences of the gradient, which is exact; steps of 10⁻⁴ standard errors, all in one evaluation."""
        assert at.metric is not None
        b, p = theta.shape
        diagonal = np.einsum("bpp->bp", at.metric)
        reach = self.parameters.high - self.parameters.low
        step = np.clip(1e-4 / np.sqrt(np.where(diagonal > 0, diagonal, 1)), 1e-7 * reach, 1e-3 * reach)
        free = np.arange(p) if self.held is None else np.nonzero(~self.held)[0]
        shifts = step[:, None, :] * np.eye(p)[free]
        around = np.concatenate([theta[:, None] + shifts, theta[:, None] - shifts], axis=1)
        slope = self(around.reshape(-1, p), np.repeat(lane, around.shape[1]), 1).gradient
        assert slope is not None
        up, down = np.split(slope.reshape(around.shape), 2, axis=1)
        second = np.zeros((b, p, p))
        second[:, free] = (up - down) / (2 * step[:, free, None])
        return (second + np.swapaxes(second, 1, 2)) / 2

    def _evaluate(self, theta: np.ndarray, lane: np.ndarray, order: int) -> Evaluation:
        off = theta - self.prior_mean[lane]
        value = (self.prior_weight * off**2).sum(axis=1) / 2
        gradient = self.prior_weight * off
        metric = np.broadcast_to(np.diag(self.prior_weight), (len(theta), self.p, self.p)).copy()
        d = self.parameters.discrepancy
        log_discrepancy = None if d is None else theta[:, d]
        for block in self.blocks:
            mu, first = predictions(block, theta, order, self.held)
            cost = terms(mu, block.data, lane, self.loss, log_discrepancy)
            value = value + cost.value.sum(axis=1)
            if first is None:
                continue
            gradient = gradient + np.einsum("bn,bnp->bp", cost.slope, first)
            metric = metric + np.matmul(np.swapaxes(first, 1, 2) * cost.curvature[:, None, :], first)
            if d is not None and cost.log_discrepancy_slope is not None and cost.log_discrepancy_information is not None:
                gradient[:, d] += cost.log_discrepancy_slope.sum(axis=1)
                metric[:, d, d] += cost.log_discrepancy_information.sum(axis=1)
        return Evaluation(value, gradient, metric) if order else Evaluation(value)

    def predict(self, theta: np.ndarray, observable: str = "length") -> np.ndarray:
        """Predictions for the data of one observable, shape (B, n), in λc, m or N/m."""
        (block,) = (block for block in self.blocks if block.observable == observable)
        return predictions(block, np.atleast_2d(theta), 0)[0]

    def information(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fisher information at one θ, shape (p, p), and the scaled Jacobian that makes it up, (n + priors, p)."""
        theta = np.atleast_2d(theta)
        d = self.parameters.discrepancy
        rows = []
        for block in self.blocks:
            mu, first = predictions(block, theta, 1)
            cost = terms(mu, block.data, np.zeros(1, int), self.loss, None if d is None else theta[:, d])
            assert first is not None
            rows.append(np.sqrt(cost.information[0])[:, None] * first[0])
            if d is not None and cost.log_discrepancy_information is not None:
                own = np.zeros((mu.shape[1], self.p))
                own[:, d] = np.sqrt(cost.log_discrepancy_information[0])
                rows.append(own)
        rows.append(np.diag(np.sqrt(self.prior_weight)))
        jacobian = np.concatenate(rows)
        return jacobian.T @ jacobian, jacobian

    def with_replicates(self, values: dict[str, np.ndarray], weights: dict[str, np.ndarray], means: np.ndarray) -> "Problem":
        """The same problem with R other sets of numbers measured: by observable, shape (R, n), and means of priors, (R, p)."""
        blocks = tuple(
            block._replace(data=block.data._replace(value=values[block.observable], weight=weights[block.observable]))
            for block in self.blocks
        )
        return dataclasses.replace(self, blocks=blocks, prior_mean=means)


def predictions(block: _Block, theta: np.ndarray, order: int, held: np.ndarray | None = None) -> Prediction:
    """μ of every datum, (B, n), and its derivatives in θ but for those `held`, (B, n, p)."""
    y = block.base + np.moveaxis(block.slope @ theta.T, -1, 0)
    lanes, rows = y.shape[:2]
    moving = block.slope if held is None else block.slope[:, :, ~held]
    columns = np.nonzero(moving.any(axis=(0, 2)))[0].tolist()
    model = PREDICTED[block.observable](y.reshape(-1, y.shape[2]), min(order, 1), columns)
    own = block.rows
    scale = np.exp(block.scale_base + theta @ block.scale_slope.T)
    value = model.value.reshape(lanes, rows)[:, own] * scale
    mu = value + theta @ block.offset.T
    if not order:
        return Prediction(mu, None)
    by_theta = 0  # where no input moves, as under a held stiffness, scales, offset and discrepancy still do
    if model.first is not None:
        by_y = model.first.reshape(lanes, rows, 1, -1)
        by_theta = np.matmul(by_y, block.slope)[:, own, 0] * scale[:, :, None]
    size = np.where(np.isfinite(value), value, 0)[:, :, None]
    return Prediction(mu, by_theta + size * block.scale_slope + block.offset)


def make_problem(m: Measurements, parameters: ParameterSet, loss: Loss, sigma: np.ndarray) -> Problem:
    """The objective of these measurements; `sigma` is the standard error of each length, in λc."""
    every = np.arange(len(m))
    blocks = [_block(parameters, "length", every, m.length, sigma, np.array(m.kind))]
    hard = parameters.base[:, :WIDTH], parameters.slope[:, :WIDTH]
    for observable in ("displacement", "force"):
        values = getattr(m, observable)
        if values is None or not np.isfinite(values).any():
            continue
        rows = np.nonzero(np.isfinite(values))[0]
        errors, inputs = getattr(m, f"{observable}_sigma")[rows], (hard[0][rows], hard[1][rows])
        blocks.append(_block(parameters, observable, rows, values[rows], errors, inputs=inputs))
    if m.gauges is not None:
        blocks += [_gauge_block(m, m.gauges, parameters, name) for name in READINGS if m.gauges.there(name).any()]
    prior_sigma = np.array([one.prior_sigma for one in parameters.free])
    return Problem(
        parameters=parameters,
        blocks=tuple(blocks),
        loss=loss,
        prior_mean=np.array([[one.prior_mean for one in parameters.free]]),
        prior_weight=1 / prior_sigma**2,
    )


def _block(
    q: ParameterSet,
    observable: str,
    rows: np.ndarray,
    value: np.ndarray,
    sigma: np.ndarray,
    kind: np.ndarray | None = None,
    inputs: tuple[np.ndarray, np.ndarray] | None = None,
) -> _Block:
    """Data of one observable, each distinct input of the model once; `inputs` are base and slope, y's own by default."""
    n = len(rows)
    base, slope = (q.base[rows], q.slope[rows]) if inputs is None else inputs
    key = np.concatenate([base, slope.reshape(n, -1)], axis=1)
    _, first, own = np.unique(key, axis=0, return_index=True, return_inverse=True)
    of_length = observable == "length"
    data = Data(
        kind=np.full(n, "length") if kind is None else kind,
        value=value[None],
        sigma=sigma,
        weight=np.ones((1, n)),
        has_discrepancy=np.full(n, of_length),
    )
    return _Block(
        observable=observable,
        measurement=rows,
        rows=own.ravel(),
        base=base[first],
        slope=slope[first],
        scale_base=q.scale_base[observable][rows],
        scale_slope=q.scale_slope[observable][rows],
        offset=q.offset[rows] if of_length else np.zeros((n, len(q.free))),
        data=data,
    )


def _gauge_block(m: Measurements, gauges: Gauges, q: ParameterSet, name: str) -> _Block:
    """Readings of one kind; y goes on with ln x/λc, contacts broken beyond ℓ*, and how many broke where that was counted."""
    there = gauges.there(name)
    rows = gauges.row[there]
    assert m.correlation_length is not None
    # a gauge at the very edge is one a billionth of λc from it
    place = np.log(np.maximum(gauges.position[there] / m.correlation_length[rows], 1e-9))
    counted = np.where(np.array(m.kind)[rows] == "whole", m.length[rows], 0.0)
    # x/λc shrinks as λc grows, which the logarithm of the length's scale does
    by_theta = -q.scale_slope["position"][rows]
    base = np.column_stack([q.base[rows], place - q.scale_base["position"][rows], np.zeros(len(rows)), counted])
    further = [by_theta, q.arrest[rows], np.zeros_like(by_theta)]
    slope = np.concatenate([q.slope[rows], np.stack(further, axis=1)], axis=1)
    sigma = getattr(gauges, f"{name}_sigma")[there]
    return _block(q, name, rows, getattr(gauges, name)[there], sigma, inputs=(base, slope))
