"""The inputs of the double series with their first and second derivatives in (H/λc, k/K, ν, φ), in NumPy.

The formulas are those of `Slider`, `lattice_modes` and `lane_series.inputs_of` (a test compares them), worked in numbers that
carry their derivatives along: nothing to compile, which is what a fit of a few lengths would otherwise wait for.
"""

from typing import Any

import numpy as np

from slippulse_jax.lattice.lane_series import Inputs


class Jet:
    """Values of lanes with gradient and Hessian in n parameters."""

    __slots__ = ("gradient", "hessian", "value")

    def __init__(self, value: Any, gradient: Any, hessian: Any) -> None:
        self.value, self.gradient, self.hessian = value, gradient, hessian

    def of(self, f: np.ndarray, first: np.ndarray, second: np.ndarray) -> "Jet":
        """Chain rule for a function of one variable with value and derivatives given."""
        g = self.gradient
        return Jet(f, first * g, first * self.hessian + second * (g[:, None] * g))

    def __add__(self, other: Any) -> "Jet":
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.gradient + other.gradient, self.hessian + other.hessian)
        return Jet(self.value + other, self.gradient, self.hessian)

    def __mul__(self, other: Any) -> "Jet":
        if not isinstance(other, Jet):
            return Jet(self.value * other, self.gradient * other, self.hessian * other)
        cross = self.gradient[:, None] * other.gradient
        return Jet(
            self.value * other.value,
            self.value * other.gradient + other.value * self.gradient,
            self.value * other.hessian + other.value * self.hessian + cross + np.swapaxes(cross, 0, 1),
        )

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> "Jet":
        return self * -1.0

    def __sub__(self, other: Any) -> "Jet":
        return self + -other

    def __rsub__(self, other: Any) -> "Jet":
        return -self + other

    def __truediv__(self, other: Any) -> "Jet":
        return self * (other.inverse() if isinstance(other, Jet) else 1 / other)

    def __rtruediv__(self, other: float) -> "Jet":
        return self.inverse() * other

    def inverse(self) -> "Jet":
        """1/x."""
        x = 1 / self.value
        return self.of(x, -(x**2), 2 * x**3)

    def sqrt(self) -> "Jet":
        """√x."""
        x = np.sqrt(self.value)
        return self.of(x, 0.5 / x, -0.25 / x**3)

    def decay_rate(self) -> "Jet":
        """−ln(1 − x)."""
        left = 1 / (1 - self.value)
        return self.of(-np.log1p(-self.value), left, left**2)


def where(condition: np.ndarray, x: Jet, y: Jet) -> Jet:
    """`numpy.where` of jets."""
    return Jet(*(np.where(condition, getattr(x, name), getattr(y, name)) for name in ("value", "gradient", "hessian")))


def parameters(theta: np.ndarray) -> list[Jet]:
    """Jets of the parameters themselves; theta of shape (n, lanes)."""
    n, lanes = theta.shape
    flat = np.zeros((n, n, lanes))
    return [Jet(x, np.repeat(np.eye(n)[i][:, None], lanes, axis=1), flat) for i, x in enumerate(theta)]


def input_jets(theta: np.ndarray) -> tuple[Inputs, np.ndarray, np.ndarray]:
    """`Inputs` of three families for lanes (H/λc, k/K, ν, φ), and all their numbers' derivatives in one array each.

    Returns
    -------
    Inputs, numpy.ndarray of shape (26, 4, lanes), numpy.ndarray of shape (26, 4, 4, lanes)
        The first axis runs over the numbers in the order of `flatten`.
    """
    jets = _inputs(*parameters(theta))
    values, first, second = (np.stack([getattr(x, name) for x in jets]) for name in ("value", "gradient", "hessian"))
    return unflatten(values), first, second


def unflatten(x: np.ndarray) -> Inputs:
    """`Inputs` from their 26 numbers."""
    return Inputs(
        reflected=x[0:4].reshape(2, 2, -1),
        start_gap=x[4:7],
        to_roots=x[7:13].reshape(2, 3, -1),
        to_modes=x[13:19].reshape(2, 3, -1),
        rate=x[19:22],
        level_rate=x[22],
        column_rate=x[23],
        first_step=x[24],
        plateau=x[25],
    )


def flatten(inputs: Inputs) -> np.ndarray:
    """The 26 numbers of `Inputs`, lanes last."""
    lanes = inputs.level_rate.shape[-1]
    return np.concatenate([np.reshape(x, (-1, lanes)) for x in inputs])


def _inputs(H: Jet, q: Jet, nu: Jet, phi: Jet) -> list[Jet]:
    KT = 1 / (2 * (1 + nu) * H)
    upper = KT / H  # κ_T²
    apart = KT + q - upper
    splitting = (apart * apart + 4 * upper * KT).sqrt()
    kappa = [((KT + q + upper + splitting) / 2).sqrt()]
    kappa.append((upper * q).sqrt() / kappa[0])
    # α_m, the sums of positive terms of `Slider`
    z = q - KT - upper
    larger = (splitting + where(z.value < 0, -z, z)) / 2
    alpha = [-(apart + splitting) / (2 * upper), where(z.value < 0, larger, KT * q / larger) / (kappa[0] * kappa[0])]
    half = [x / 2 for x in kappa]
    root = [(1 + x * x).sqrt() for x in half]
    ratio = [1 / ((a + b) * (a + b)) for a, b in zip(root, half, strict=True)]
    gap = [2 * b / (a + b) for a, b in zip(root, half, strict=True)]
    share = [-alpha[0] * upper / splitting, alpha[1] * upper / splitting]
    w = [q * x / (4 * h * y) for x, h, y in zip(share, half, root, strict=True)]
    u = [1 / x for x in alpha]
    slope = [g / r for g, r in zip(gap, ratio, strict=True)]
    determinant = u[0] * slope[1] - u[1] * slope[0]
    drive = [slope[1] / (slope[1] - slope[0]), -slope[0] / (slope[1] - slope[0])]
    R = [
        [(-w[n] * u[n] * slope[1] - w[n] * gap[n] * u[1]) / determinant for n in (0, 1)],
        [(w[n] * gap[n] * u[0] + w[n] * u[n] * slope[0]) / determinant for n in (0, 1)],
    ]
    reflected = [ratio[m] * R[m][n] for m in (0, 1) for n in (0, 1)]
    coupling = [r * x for r, x in zip(ratio, w, strict=True)]
    return _roots(gap, w, coupling, reflected, drive, phi)


def _roots(gap: list[Jet], w: list[Jet], coupling: list[Jet], reflected: list[Jet], drive: list[Jet], phi: Jet) -> list[Jet]:
    d = [g - c for g, c in zip(gap, coupling, strict=True)]
    difference = d[0] - d[1]
    split = (difference * difference + 4 * coupling[0] * coupling[1]).sqrt()
    falls = difference.value < 0
    larger = (where(falls, -difference, difference) + split) / 2
    smaller = coupling[0] * coupling[1] / larger
    up, down = where(falls, smaller, larger), where(falls, larger, smaller)
    runaway = (1 + w[0] + w[1]) / 2
    gap_1 = (d[0] + d[1] + split) / 2
    gap_2 = gap[0] * gap[1] * runaway / gap_1
    apart, zero = gap[0] - gap[1], 0.0 * gap[0]
    to_modes = [
        *(coupling[0] * apart / (up + coupling[0]), up + coupling[0], gap[0]),
        *(-(coupling[1] * apart) / (down + coupling[1]), down + coupling[1], gap[1]),
    ]
    rate = [g.decay_rate() for g in gap]
    pushed = gap[0] * drive[0] + gap[1] * drive[1]
    first_step = coupling[0] + coupling[1] + sum(reflected[1:], reflected[0]) - (1 - phi) * pushed
    return [
        *reflected,
        *(gap_1, gap_2, zero),
        *(zero, split, gap_1, -split, zero, gap_2),
        *to_modes,
        *(gap_1.decay_rate(), gap_2.decay_rate(), zero),
        *(2 * rate[1], rate[0] - rate[1], first_step, phi / runaway),
    ]
