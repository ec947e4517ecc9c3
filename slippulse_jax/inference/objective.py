"""The function that a fit minimises, for optimisers of one's own."""

import dataclasses
import functools
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.domains import check_choice
from slippulse_jax.inference.choices import Body, Loss, MeasuredEvent
from slippulse_jax.inference.model.check import checked
from slippulse_jax.inference.model.fronts import Front
from slippulse_jax.inference.model.parameters import PARAMETERS, Parameter, wanted_parameters, with_errors_of_measuring
from slippulse_jax.inference.search.clouds import gathered, refuse_model_error
from slippulse_jax.inference.search.likelihood import Problem, make_problem
from slippulse_jax.inference.search.minima import lowest_look
from slippulse_jax.inference.table.measurements import Measurements, measurements_of
from slippulse_jax.keywords import did_you_mean

if TYPE_CHECKING:
    import pandas as pd


@dataclasses.dataclass(frozen=True, eq=False)
class Objective:
    """−ln(likelihood × prior) as a JAX function of {name: θ}.

    Half the deviance of a fit of the same measurements. θ is the logarithm of a positive parameter, else the parameter itself.
    It has first and second derivatives in every mode (of whole events and blocks, which are tables, the first), and can be
    compiled and mapped.
    """

    problem: Problem

    def __call__(self, theta: Mapping[str, Any]) -> Float[Array, ""]:
        """Evaluate at θ by name; a perfect match costs nothing."""
        if unknown := [name for name in theta if name not in self.names]:
            raise ValueError(
                f"theta: {unknown[0]!r} is not fitted{did_you_mean(unknown[0], self.names)}: {', '.join(self.names)}"
            )
        if missing := [name for name in self.names if name not in theta]:
            raise ValueError(f"theta: no {missing[0]!r}: needs {', '.join(self.names)}")
        return self._compiled(jnp.stack([jnp.asarray(theta[name]) for name in self.names]))

    @functools.cached_property
    def _compiled(self) -> Callable[[Array], Array]:
        low, high = np.array([PARAMETERS[one.name].limits for one in self.problem.parameters.free]).T

        def within(theta: Array) -> Array:
            inside = ((theta >= low) & (theta <= high)).all()
            return jnp.where(inside, self.problem.traced(theta), jnp.inf)

        return jax.jit(within)

    @property
    def names(self) -> list[str]:
        """Names of θ, among them inputs with errors of their own."""
        return list(self.problem.parameters.names)

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Range of each θ that `fit` searches.

        The function itself has no such limits, but is inf outside the domain, as for ν > 0.5. Its slopes mean
        nothing there.
        """
        return {one.label: (one.low, one.high) for one in self.problem.parameters.free}

    @property
    def sigma(self) -> np.ndarray:
        """Standard error of each length in λc, (n,); 0 if none."""
        return self.problem.lengths.sigma

    def start(self) -> dict[str, Array]:
        """θ of the least value on a grid or in a sample."""
        best = lowest_look(self.problem)
        return {name: jnp.asarray(x) for name, x in zip(self.names, best, strict=True)}

    def values(self, theta: Mapping[str, Any]) -> dict[str, float]:
        """Values of the parameters asked for, in their units."""
        return self.problem.parameters.values(np.array([float(theta[name]) for name in self.names]))


def objective(
    measurements: "Measurements | pd.DataFrame | str | os.PathLike[str]",
    free: str | Parameter | Sequence[str | Parameter] = ("stiffness",),
    *,
    bounds: tuple[float, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    loss: Loss = "normal",
    event: MeasuredEvent | Front | None = None,
    body: Body | None = None,
    model_error: float | Literal["fitted"] | None = None,
) -> Objective:
    """Return the function that `fit` minimises.

    Parameters
    ----------
    measurements, free, bounds, fixed, loss, event, body, model_error
        As for `fit`, with priors, counts, limits, gauges, several specimens and offsets. Every length needs its σ.

    Returns
    -------
    Objective
        Call it at {name: θ}, as `Objective.start` gives one.

    Raises
    ------
    ValueError
        If an argument has no meaning for these measurements, or lengths come without σ.

    Examples
    --------
    >>> f = objective(Measurements([20.0, 35.0], 0.3, [12.7, 24.6], 0.3))
    >>> float(f(f.start())) < 2
    True
    """
    m = measurements_of(measurements)
    if m.length_sigma is None and not m.is_sequence:
        raise ValueError(
            f"{m.source}: lengths without σ have no likelihood: give their standard errors; fit takes σ from the scatter"
        )
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        what = "objective in single precision: flat to rounding near its minimum. Use jax.enable_x64(True)"
        warnings.warn(what, RuntimeWarning, stacklevel=2)
    check_choice("loss", loss, Loss)
    wanted = with_errors_of_measuring(m, wanted_parameters(free, bounds, fixed), size_known=True)
    problem = make_problem(m, checked(m, wanted, event, body), loss, m.stated_sigma)
    if m.is_sequence:
        return Objective(gathered(problem, 0, model_error))
    refuse_model_error(model_error)
    return Objective(problem)
