r"""Lengths of many fronts with first and second derivatives, in NumPy: nothing to compile.

At the crossing F = t(s) − 1 − εs = Σ_j c_j Σ_ka τ (E − 1) − εs, E = μ^s. The amplitudes hang on the table through
Σ_j c_j A_j = 1 and Σ_j c_j B_j = t(1) − t(0), with A = Σ τ and B = −Σ τ (1 − μ); multipliers y_0 A_j + y_1 B_j = Σ τ (E − 1),
j = 1, 2, turn that into weights on the terms,

    dF = Σ_j c_j Σ_ka d[τ (E − 1 − y_0 + y_1 (1 − μ))] + y_1 d[t(1) − t(0)] + …,

and the weights run through the recursion of the rows from the last to the first: one pass gives ∂F by all inputs x of the
table. The length is implicit, g = dℓ*/dθ = −(∂F/∂x · ∂x/∂θ)/(∂F/∂s). Everything is analytic: the same pass, at inputs moved by
an imaginary ih along (∂x/∂θ_k, g_k), has in its imaginary part h times the derivative of ∂F/∂x; no difference is taken.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from slippulse_jax.lattice.lane_crossing import UNSETTLED
from slippulse_jax.lattice.lane_series import ROW_TOLERANCE, ROWS, Inputs, entries
from slippulse_jax.lattice.mode_jets import flatten, input_jets, unflatten
from slippulse_jax.status import Outcome

Lanes = np.ndarray  # shape (lanes,)
Search = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

STEP = 1e-40
"""The imaginary step h: its square is nothing beside 1."""

MAX_TURNS = 40


class Table(NamedTuple):
    """Rows of the series of a chunk of lanes."""

    rows: list[np.ndarray]  # τ_ka of row k, shape (3, 2k + 1, lanes)
    total: np.ndarray  # A
    gaps: np.ndarray  # −B
    bend: np.ndarray  # −Σ τ ln μ
    own_last: Lanes  # the last row of the lane
    amplitude: np.ndarray  # c_j


def lengths(theta: Float[np.ndarray, "5 lanes"], order: int, search: Search) -> tuple[np.ndarray, ...]:
    """ℓ*, status, gradient (lanes, 5) and, if `order` is 2, Hessian (lanes, 5, 5).

    `search` finds length and status of the lanes, given by their numbers, that Newton's method is not sure of.
    """
    with np.errstate(all="ignore"):
        inputs, first, second = input_jets(theta[:4])
        table, sound = tabulate(inputs)
        s, status = crossing(inputs, table, theta, sound)
        left = np.flatnonzero(status == UNSETTLED)
        if len(left):
            s[left], status[left] = search(left)
        arrested = status == Outcome.ARRESTED
        at = np.where(arrested, s, 1.0)
        elsewhere = np.where(status == Outcome.NO_DOMINO, 0, np.nan)  # never a number where there is no length
        change, slope = adjoint(inputs, table, at)
        slope = slope - theta[4]
        of_theta = np.concatenate([np.einsum("xl,xil->il", change, first), -at[None]])
        gradient = -of_theta / slope
        found = (s, status, np.where(arrested, gradient, elsewhere).T)
        if order < 2:
            return found
        bend, bend_slope = _second(inputs, table, at, first, gradient)
        # d(∂F/∂θ_l) along k: by the adjoint's own change, and by that of ∂x/∂θ_l
        curved = np.zeros((5, 5, at.size))
        curved[:, :4] = np.einsum("kxl,xil->kil", bend, first)
        curved[:4, :4] += np.einsum("xl,xkil->kil", change, second)
        curved[:, 4] = -gradient
        bend_slope[4] -= 1
        hessian = -(curved + gradient * bend_slope[:, None]) / slope
        return *found, np.where(arrested, hessian, elsewhere).transpose(2, 0, 1)


def _second(inputs: Inputs, table: Table, s: Lanes, first: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of `adjoint` along each parameter k, the length moving with it: shapes (5, 26, lanes) and (5, lanes)."""
    flat, lanes = flatten(inputs), s.size
    moved = np.repeat(flat[:, None], 5, axis=1).astype(complex)
    moved[:, :4] += 1j * STEP * first
    there = unflatten(moved.reshape(len(flat), -1))
    again, _ = tabulate(there, np.tile(table.own_last, 5))
    change, slope = adjoint(there, again, (s + 1j * STEP * gradient).ravel())
    return np.imag(change).reshape(-1, 5, lanes).swapaxes(0, 1) / STEP, np.imag(slope).reshape(5, lanes) / STEP


def tabulate(inputs: Inputs, own_last: Lanes | None = None) -> tuple[Table, np.ndarray]:
    """Rows until every lane has ended, and whether it has all its digits; lanes end at `own_last` where that is given."""
    start, rho = inputs.start_gap, 1 - inputs.start_gap
    one = np.ones_like(start)
    rows, total, gaps, bend = [one[:, None]], one, start, inputs.rate
    running, last, k = np.ones(start.shape[1:], bool), np.zeros(start.shape[1:]), 1
    scale, powers = np.ones(start.shape[1:]), _powers(inputs, 1.0, ROWS)
    while running.any() and k <= ROWS:
        gap = powers.row(k)
        tau = np.where(running, entries(inputs, _beside(rows[-1]), gap), 0)
        rows.append(tau)
        sums = tau.sum(1)
        total = total + sums
        gaps = gaps + start * sums + rho * (tau * gap).sum(1)
        bend = bend + (inputs.rate + k * inputs.level_rate) * sums + inputs.column_rate * (tau * _columns(k)).sum(1)
        last = np.where(running, k, last)
        if own_last is None:
            size = np.abs(tau).sum((0, 1))
            scale = np.minimum(size, 1) if k == 1 else scale
            running = running & (size > ROW_TOLERANCE * scale)
        else:
            running = own_last > k
        k += 1
    known_0, known_1 = 1 - inputs.plateau * total[2], inputs.first_step + inputs.plateau * gaps[2]
    determinant = total[1] * gaps[0] - total[0] * gaps[1]
    c1, c2 = -(known_0 * gaps[1] + total[1] * known_1) / determinant, (total[0] * known_1 + known_0 * gaps[0]) / determinant
    amplitude = np.stack([c1, c2, inputs.plateau])
    sound = ~running & (np.abs(c1) < 1e3) & (np.abs(c2) < 1e3)
    return Table(rows, total, gaps, bend, last, amplitude), sound


class _Powers(NamedTuple):
    """1 − (μ/start)^s of every row, from few exponentials."""

    levels: Float[np.ndarray, "k lanes"]  # 1 − r_2^{2ks}
    columns: Float[np.ndarray, "a lanes"]  # 1 − (r_1/r_2)^{as}

    def row(self, k: int) -> np.ndarray:
        level = self.levels[k]
        return level + (1 - level) * self.columns[: 2 * k + 1]


def _powers(inputs: Inputs, s: Lanes | float, last: int) -> _Powers:
    k, a = np.arange(last + 1.0)[:, None], np.arange(2.0 * last + 1)[:, None]
    return _Powers(-np.expm1(-k * (s * inputs.level_rate)), -np.expm1(-a * (s * inputs.column_rate)))


def _columns(k: int) -> np.ndarray:
    """A along row k."""
    return np.arange(2.0 * k + 1)[:, None]


def _beside(row: np.ndarray) -> np.ndarray:
    """A row with two columns of zeros on either side."""
    wide = np.zeros((row.shape[0], row.shape[1] + 4, row.shape[2]), row.dtype)
    wide[:, 2:-2] = row
    return wide


def sums_at(inputs: Inputs, table: Table, s: Lanes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each family Σ τ (1 − E), Σ τ E and −Σ τ E ln μ."""
    gone = -np.expm1(-s * inputs.rate)
    left, powers = 1 - gone, _powers(inputs, s, len(table.rows) - 1)
    lost, kept, bent = gone, left, left * inputs.rate
    for k, tau in enumerate(table.rows[1:], 1):
        at_s = tau * powers.row(k)
        missing, rest = at_s.sum(1), tau - at_s
        total = rest.sum(1)
        lost = lost + missing + gone * total
        kept = kept + left * total
        slope = (inputs.rate + k * inputs.level_rate) * total + inputs.column_rate * (rest * _columns(k)).sum(1)
        bent = bent + left * slope
    return lost, kept, bent


def crossing(inputs: Inputs, table: Table, theta: np.ndarray, sound: np.ndarray) -> tuple[Lanes, np.ndarray]:
    """ℓ* and status, as `lane_crossing.crossing`: Newton's method in ln t, or in t on rising thresholds."""
    slope = theta[4]
    moves = -(table.amplitude * table.bend).sum(0) > slope
    regular = sound & (inputs.plateau < 0.999) & (slope >= 0)
    height, stiffness, poisson = theta[:3]
    b = 2 * (1 + poisson) * stiffness * height
    excess = table.amplitude[1] / (1 - np.minimum(inputs.plateau, 0.999)) - 1
    by_tail = excess > 0.1
    # short of its tail the front follows the macroscopic law on a rigid upper layer, where ρ_2 is near r_2
    s = np.log1p(np.where(by_tail, excess, b / (2 + b))) / np.where(by_tail, inputs.rate[1], inputs.level_rate / 2)
    active = moves & regular
    s, done = np.where(active, s, 0), ~active
    for _ in range(MAX_TURNS):
        if done.all():
            break
        lost, _, bent = sums_at(inputs, table, s)
        rise, rate = -(table.amplitude * lost).sum(0), -(table.amplitude * bent).sum(0)
        by_log = np.log1p(np.maximum(rise, -0.9)) * (1 + rise) / rate
        newton = s - np.where(slope == 0, by_log, (rise - slope * s) / (rate - slope))
        after = np.where(rate < slope, np.clip(newton, s / 4, 4 * s + 10), 2 * s + 0.25)
        after = np.where(done, s, after)
        done, s = done | ((np.abs(after - s) <= 1e-9 * s) & (rate < slope)), after
    status = np.where(regular & done, np.where(moves, 0, 1), UNSETTLED).astype(np.int32)
    return np.where(status == 0, s, 0), status


def adjoint(inputs: Inputs, table: Table, s: Lanes) -> tuple[Float[np.ndarray, "26 lanes"], Lanes]:
    """∂F/∂`Inputs`, flat, and t'(s)."""
    c, A, gaps = table.amplitude, table.total, table.gaps
    lost, kept, bent = sums_at(inputs, table, s)
    determinant = A[1] * gaps[0] - A[0] * gaps[1]
    y0, y1 = (lost[0] * gaps[1] - gaps[0] * lost[1]) / determinant, (A[1] * lost[0] - A[0] * lost[1]) / determinant
    found = _backwards(inputs, table, s, y0, y1)
    change = Inputs(
        reflected=found["reflected"],
        # 1 − μ = start_gap + start (1 − μ/start), where Σ τ μ/start is left of A
        start_gap=found["start_gap"] + y1 * c * (A - gaps) / (1 - inputs.start_gap),
        to_roots=found["to_roots"],
        to_modes=found["to_modes"],
        rate=-s * c * kept,
        level_rate=found["level_rate"],
        column_rate=found["column_rate"],
        first_step=y1,
        plateau=-lost[2] - y0 * A[2] + y1 * gaps[2],
    )
    return flatten(change), -(c * bent).sum(0)


def _backwards(inputs: Inputs, table: Table, s: Lanes, y0: Lanes, y1: Lanes) -> dict[str, np.ndarray]:
    """The weights through the recursion of the rows, from the last to the first: the mirror image of `entries`."""
    c, rho = table.amplitude[:, None], (1 - inputs.start_gap)[:, None]
    to_1, to_2, from_1, from_2 = (y[:, None] for y in (*inputs.to_roots, *inputs.to_modes))
    (R11, R12), (R21, R22) = inputs.reflected
    lost, last = -np.expm1(-s * inputs.rate)[:, None], len(table.rows) - 1
    step, whole = _powers(inputs, 1.0, last), _powers(inputs, s, last)
    sums = {name: np.zeros_like(getattr(inputs, name)) for name in Inputs._fields}
    incoming = np.zeros_like(table.rows[-1])
    for k in range(last, 0, -1):
        tau, above = table.rows[k], _beside(table.rows[k - 1])
        two, one, zero = above[:, :-2], above[:, 1:-1], above[:, 2:]
        gap, gap_s = step.row(k), whole.row(k)
        gone = lost + (1 - lost) * gap_s
        x, kept = rho * gap, 1 - gap
        weight = np.where(k <= table.own_last, c * (y1 * (1 - rho * kept) - y0 - gone) + incoming, 0)
        q = weight / ((to_1 - x) * (to_2 - x))
        h1, h2 = q * (from_1 - x), q * (from_2 - x)
        g1, g2 = R11 * two + R12 * one, R21 * one + R22 * zero
        of_x = q * (tau * (to_1 - x + to_2 - x) - g1 - g2)
        of_rates = rho * kept * (of_x + y1 * c * tau) - s * c * tau * (1 - gone)
        for place, product in (((0, 0), h2 * two), ((0, 1), h2 * one), ((1, 0), h1 * one), ((1, 1), h1 * zero)):
            sums["reflected"][place] += product.sum((0, 1))
        sums["to_roots"] -= np.stack([(q * tau * (to_2 - x)).sum(1), (q * tau * (to_1 - x)).sum(1)])
        sums["to_modes"] += np.stack([(q * g2).sum(1), (q * g1).sum(1)])
        sums["start_gap"] -= (of_x * gap).sum(1)
        sums["level_rate"] += k * of_rates.sum((0, 1))
        sums["column_rate"] += (_columns(k) * of_rates).sum((0, 1))
        incoming = (R11 * h2)[:, 2:] + (R12 * h2 + R21 * h1)[:, 1:-1] + (R22 * h1)[:, :-2]
    return sums
