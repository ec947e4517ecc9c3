"""Extent of sequences against force, and events at the best fit."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, cast

import numpy as np

from slippulse_jax.inference.observables.sequence import record_of
from slippulse_jax.inference.search.intervals import LEVELS
from slippulse_jax.plot.labels import EXTENT, OVER_LOAD, POSITION, as_written, axis_label
from slippulse_jax.plot.marks import curves_of, marked, named_best
from slippulse_jax.plot.style import axes, drawn, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slippulse_jax.inference.fit import FitResult
    from slippulse_jax.inference.model.series import BlockSeries, Followed

BAND_LEVEL = LEVELS[-1]
SPANNING = "D"
"""Of the event of a sequence that spans the block."""
DRAWS = 40
"""Series of which 95 % lie in the band of a sequence."""


@drawn
def fit_sequence(result: "FitResult", *, ax: "Axes | None" = None) -> "Axes":
    """Draw the extent of a sequence of precursors against the force.

    As experiments report it: the extent over the length of the block, against the force over the normal load or, where that is
    unknown, the force. Thick errors are those stated, thin ones contain those of the model. The line is the series at the best
    fit: how far the front got, and at which force. In the band are 95 % of `DRAWS` series with parameters that the data allow.
    Ticks are the fitted forces, means over many series, each of which has its own order of breaks. A ValueError for lengths.
    """
    size, name = _force_of(result)
    ax = axes(ax)
    m, curves, draws, place = result.measurements, curves_of(result, ax), _draws(result), np.arange(0.5, 256) / 256
    extent = record_of(m).place
    every = _followed(result, np.concatenate([result.theta[None], draws]))
    for (color, rows), (_, found) in zip(curves, every, strict=True):
        farther, reached = found.advance[0] > 0, np.minimum(found.reached[0], 1.0)
        stairs = np.repeat(found.force[0][farther], 2), np.append(0.0, np.repeat(reached[farther], 2)[:-1])
        of, last = f"{as_written(m.sequence[rows[0]])}: " if len(curves) > 1 else "", rows is curves[-1][1]
        ax.plot(*stairs, color=color, lw=1, label=of + named_best(result))
        if len(draws):
            band = np.quantile(found.force_at(place, 0 * place)[0, 1:], [0.5 - BAND_LEVEL / 2, 0.5 + BAND_LEVEL / 2], axis=0)
            label = f"{BAND_LEVEL:.0%} band of series" if last else None
            ax.fill_betweenx(place, *band, color=color, alpha=0.25, lw=0, label=label)
        label = "fitted: mean of series" if last else None
        ax.plot((result.fitted * size)[rows], extent[rows], "|", color=color, ms=7, mew=1.5, label=label)
    force, used = m.or_zero("force") * size, result.sigma * size
    stated, along = m.or_zero("force_sigma") * size, np.nan_to_num(m.sigma) / m.or_zero("block_length")
    spans = np.array(m.kind) == "at_least"
    for marker, color, what, rows in marked(result, ax):
        shown = (rows[~spans[rows]], marker, 3.5, f"{what} ± σ"), (rows[spans[rows]], SPANNING, 5, "spanning ± σ")
        for own, sign, wide, label in (one for one in shown if one[0].size):
            at, look = (force[own], extent[own]), {"color": color, "zorder": 3}
            ax.errorbar(*at, along[own], stated[own], fmt=sign, ms=wide, capsize=2, label=label, **look)
            ax.errorbar(*at, None, used[own], fmt="none", elinewidth=0.6, label="± σ with the model's", **look)
    ax.set(xlabel=name, ylabel=EXTENT, ylim=(0, 1.06))
    legend_above(ax, most=2)
    return ax


def _draws(result: "FitResult") -> np.ndarray:
    """Draw θ by importance, (`DRAWS`, p); none of a rejected fit."""
    if result.rejected or result.covariance is None:
        return np.empty((0, len(result.theta)))
    random, q = np.random.default_rng(0), result.parameters
    error = np.sqrt(2 * np.diag(result.covariance))
    narrowed = np.minimum(error, q.high - q.low) / error  # where hardly anything is known
    covariance = 2 * result.covariance * np.outer(narrowed, narrowed)
    theta = random.multivariate_normal(result.theta, covariance, 50 * DRAWS, method="eigh")
    theta = np.vstack([result.theta, theta[((theta >= q.low) & (theta <= q.high)).all(axis=1)]])
    off = theta - result.theta
    log = np.einsum("ti,ij,tj->t", off, np.linalg.pinv(covariance), off) / 2 - result.problem(theta).value
    weight = np.exp(log - np.nanmax(log), where=log > -np.inf, out=np.zeros(len(log)))
    return theta[random.choice(len(theta), DRAWS, p=weight / weight.sum())]


def _force_of(result: "FitResult") -> tuple[np.ndarray, str]:
    """Drawn force per N/m, and its label."""
    m = result.measurements
    if result.main.extent(m) is None:
        raise ValueError("the measurements are lengths, not forces of a sequence: use plot.fit or plot.fit_lengths")
    if m.normal_load is not None:
        return 1 / m.normal_load, OVER_LOAD
    return m.unit_of_force[0], axis_label("force", m.unit_of_force[1])


def _followed(result: "FitResult", theta: np.ndarray) -> "Iterator[tuple[np.ndarray, Followed]]":
    """Rows of each sequence, and its series at θ, (t, p)."""
    (size, _), (data, *_) = _force_of(result), result.problem.observed
    front, inputs, record = cast("BlockSeries", result.parameters.front), data.inputs.at(theta), record_of(result.measurements)
    scale, friction = np.exp(data.scale(theta)), inputs.get("friction")
    for run, (found, *_) in enumerate(front.follow(inputs)):
        rows = np.flatnonzero(record.run == run)
        size_of = size[rows[0]] * friction[:, run] * scale[:, rows[0]]
        yield rows, found._replace(force=found.force * size_of[:, None])


@drawn
def sequence_events(result: "FitResult", name: str | None = None, *, ax: "Axes | None" = None) -> "Axes":
    """Draw which part of the interface breaks at which load and force.

    Each event of the series at the best fit is a bar from the first to the last contact that breaks. Upwards is the load,
    which only rises, while forces return to what they were. Of several sequences `name` chooses one; by default the first. A
    ValueError for lengths, and for a name that is not there.
    """
    _, label = _force_of(result)
    names = result.measurements.sequence or ("",) * len(result.measurements)
    if name is not None and name not in names:
        raise ValueError(f"name = {name!r}: one of {', '.join(map(repr, sorted({*names})))}")
    ax = axes(ax)
    every = [(names[rows[0]], found) for rows, found in _followed(result, result.theta[None])]
    own, found = next(one for one in every if name in (None, one[0]))
    events = found.end[0] > 0
    force, load, begin, end = (x[0][events] for x in (found.force, found.load, found.begin, found.end))
    bars = ax.hlines(load, begin, end, array=force, cmap="cividis", lw=1.5)
    ax.set(xlabel=f"{POSITION}, $x/L$", ylabel=axis_label("load", "u_s"), xlim=(0, 1.02))
    ax.set_title(f"Events: {named_best(result)}" + f", {as_written(own)}" * bool(own))
    ax.figure.colorbar(bars, ax=ax, label=label)
    return ax
