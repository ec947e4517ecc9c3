"""Inputs of the models of a length, by name, and their domains.

Five of them every model takes; what only some take, as the height of a push, each names for itself.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import ArrayLike

from slippulse_jax.base.domains import POISSON, PRESTRESS, RESIDUAL_STRENGTH, THRESHOLD_SLOPE
from slippulse_jax.interface import Interface


class Input(NamedTuple):
    """One input: its symbol, its domain, and its step of differences."""

    symbol: str
    low: float
    high: float
    requirement: str
    step: float = 1e-4  # half-width of central differences, of tables
    domain: tuple[float, float] = (-np.inf, np.inf)  # to which they are clipped


COMMON = {
    "log_height": Input("H/λc", 1e-9, np.inf, "must exceed 1"),
    "log_stiffness": Input("k/K", np.log(1e-30), np.log(1e3), "must lie in 1e-30 to 1e3"),
    "poisson": Input("ν", POISSON.low, POISSON.high, POISSON.requirement, 1e-5, (-np.inf, 0.5)),
    "prestress": Input("φ", PRESTRESS.low, PRESTRESS.high, PRESTRESS.requirement, 1e-5),
    # over H/λc: it acts multiplied by ℓ
    "threshold_slope": Input("ε", THRESHOLD_SLOPE.low, THRESHOLD_SLOPE.high, THRESHOLD_SLOPE.requirement, 5e-6),
}
"""Inputs of every model."""
KEPT = Input("r", RESIDUAL_STRENGTH.low, 0.999, "must lie in [0, 0.999)", 1e-4, (0.0, 0.99))
"""What contacts keep of their strength, an input of all self-healing events; there only where it may be more than 0."""
STEEPEST = 0.99
"""Largest |φ| of an `Interface` by which a table of lengths computes one far below."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Linear:
    """One number per measurement, linear in θ."""

    base: np.ndarray  # (n,)
    slope: np.ndarray  # (n, p)

    def __call__(self, theta: Any) -> Any:
        """Values at θ of shape (…, p); shape (…, n)."""
        return self.base + theta @ self.slope.T

    def __getitem__(self, rows: Any) -> "Linear":
        """Select some measurements."""
        return Linear(self.base[rows], self.slope[rows])


class Inputs(NamedTuple):
    """Inputs of a model, of one shape; before θ, `Linear`."""

    log_height: Any  # ln H/λc
    log_stiffness: Any  # ln k/K
    poisson: Any
    prestress: Any  # φ, in σ_s
    threshold_slope: Any  # ε, per contact
    more: dict[str, Any] = {}  # what only some models take, by name

    @classmethod
    def of(
        cls,
        height: ArrayLike,
        stiffness: ArrayLike,
        poisson: ArrayLike,
        prestress: ArrayLike = 0,
        threshold_slope: ArrayLike = 0,
        **more: ArrayLike,
    ) -> "Inputs":
        """Inputs from H/λc, k/K, ν, φ, ε and others, which broadcast."""
        numbers = np.log(height), np.log(stiffness), poisson, prestress, threshold_slope, *more.values()
        columns = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in numbers))
        return cls(*columns[:5], more=dict(zip(more, columns[5:], strict=True)))

    @classmethod
    def from_table(cls, names: Sequence[str], table: Any) -> "Inputs":
        """Inverse of `table`."""
        columns = {name: table[..., i] for i, name in enumerate(names)}
        return cls(*(columns.pop(name) for name in COMMON), more=columns)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return (*COMMON, *self.more)

    def get(self, name: str) -> Any:
        """The input of this name."""
        return getattr(self, name) if name in COMMON else self.more[name]

    def table(self) -> np.ndarray:
        """Stack them as columns, shape (…, len(names))."""
        return np.stack([*self[:5], *self.more.values()], axis=-1)

    def map(self, function: Callable[[Any], Any]) -> "Inputs":
        """Apply a function to every input."""
        return Inputs(*map(function, self[:5]), more={name: function(x) for name, x in self.more.items()})

    def at(self, theta: Any) -> "Inputs":
        """Values of linear inputs, (…, n), at θ of shape (…, p)."""
        return self.map(lambda one: one(theta))

    def take(self, rows: Any) -> "Inputs":
        """Select some rows of every input."""
        return self.map(lambda one: one[rows])

    def distinct(self) -> tuple["Inputs", np.ndarray]:
        """Distinct rows of linear inputs, and which of them each is."""
        every = [self.get(name) for name in self.names]
        key = np.concatenate([np.column_stack([one.base, one.slope]) for one in every], axis=1)
        _, first, own = np.unique(key, axis=0, return_index=True, return_inverse=True)
        return self.take(first), own.ravel()

    def ravel(self) -> "Inputs":
        """Flatten every input."""
        return self.map(np.ravel)

    def given(self, **more: Any) -> "Inputs":
        """Add inputs, or replace them."""
        return self._replace(more=self.more | more)

    def without(self, *names: str) -> "Inputs":
        """Leave inputs out."""
        return self._replace(more={name: x for name, x in self.more.items() if name not in names})

    @property
    def relaxed(self) -> bool:
        """Whether prestress, slope and what contacts keep are 0 for certain."""
        none = (not (x.base.any() or x.slope.any()) if isinstance(x, Linear) else not x.any() for x in self[3:5])
        return "residual_strength" not in self.more and all(none)

    @property
    def interface(self) -> Interface:
        """The contacts."""
        return Interface(self.prestress, self.threshold_slope, self.more.get("residual_strength"))

    @property
    def log_b(self) -> Any:
        """Logarithm of b, the areal stiffness times H over the shear modulus."""
        return np.log(2 * (1 + self.poisson)) + self.log_stiffness + self.log_height

    @property
    def ratio(self) -> Any:
        """k/K."""
        return np.exp(self.log_stiffness)

    def stacked(self) -> "Stacked":
        """Stack linear inputs to two arrays, for a smaller program."""
        every = [self.get(name) for name in self.names]
        return Stacked(
            self.names, np.stack([one.base for one in every], axis=-1), np.stack([one.slope for one in every], axis=-1)
        )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Stacked:
    """Linear inputs as arrays."""

    names: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    base: Any  # (n, inputs)
    slope: Any  # (n, p, inputs)

    def at(self, theta: Any) -> Inputs:
        """Values at one θ, (p,); (n,) each."""
        return Inputs.from_table(self.names, self.base + (theta[None, :, None] * self.slope).sum(axis=1))


def interface_of(equivalent: np.ndarray, slope: Any = 0.0) -> Interface:
    """Contacts of an equivalent prestress below 1, however far below −1."""
    prestress = np.clip(equivalent, -STEEPEST, STEEPEST)
    far = equivalent < -STEEPEST
    return Interface(prestress, slope, np.where(far, (prestress - equivalent) / (1 - equivalent), 0.0) if far.any() else None)
