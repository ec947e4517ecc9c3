"""What samples of the parameters of a fit say of each, whether they are refits or draws from a posterior."""

from typing import Any

import numpy as np

from slippulse_jax.inference.verdict import LEVELS


class Samples:
    """Base of those who have `names` and `values`, of shape (…, parameters) in the units of the parameters."""

    names: tuple[str, ...]
    values: np.ndarray

    def of(self, name: str) -> np.ndarray:
        """All samples of one parameter, shape (count,)."""
        return self.values[..., self.names.index(name)].ravel()

    def stderr(self, name: str) -> float:
        """Standard deviation of a parameter."""
        return float(self.of(name).std(ddof=1))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Central interval of a parameter, by its percentiles."""
        low, high = np.quantile(self.of(name), [(1 - level) / 2, (1 + level) / 2])
        return float(low), float(high)

    def summary(self) -> dict[str, Any]:
        """Standard deviations and intervals of all parameters as plain Python values."""
        return {
            "stderr": {name: self.stderr(name) for name in self.names},
            "intervals": {name: {f"{level:g}": list(self.interval(name, level)) for level in LEVELS} for name in self.names},
        }

    def line(self, name: str) -> str:
        """A parameter in words."""
        low, high = self.interval(name)
        mean, sd = self.of(name).mean(), self.stderr(name)
        return f"  {name}: mean {mean:.5g}, standard deviation {sd:.3g}, 95% {low:.5g} to {high:.5g}"
