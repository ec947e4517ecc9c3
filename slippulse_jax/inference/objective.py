"""The function that a fit minimises, for optimisers of one's own."""

import dataclasses
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.base.choices import did_you_mean
from slippulse_jax.base.domains import check_choice
from slippulse_jax.base.units import as_float
from slippulse_jax.bulk.compiler import check_jit
from slippulse_jax.inference.choices import Body, Loss, MeasuredEvent
from slippulse_jax.inference.model.front import Front
from slippulse_jax.inference.model.inputs import COMMON
from slippulse_jax.inference.model.models import front_of
from slippulse_jax.inference.observables.observable import Observable, Observations
from slippulse_jax.inference.parameters import (
    PARAMETERS,
    Parameter,
    checked,
    wanted_parameters,
    where_contacts_differ,
    with_errors_of_measuring,
)
from slippulse_jax.inference.search.learning import check_model_error, learnt, sized
from slippulse_jax.inference.search.likelihood import How, Problem, density, make_problem
from slippulse_jax.inference.search.minima import lowest_look
from slippulse_jax.inference.table.measurements import Measurements, measurements_of

if TYPE_CHECKING:
    import pandas as pd


@dataclasses.dataclass(frozen=True, eq=False)
class Objective:
    """−ln(likelihood × prior) as a JAX function of {name: θ}.

    Half the deviance of a fit of the same measurements. θ is the logarithm of a positive parameter, else the parameter itself.
    It has first and second derivatives in every mode (of whole events and lengths on blocks, which are tables, the first), and
    can be compiled and mapped. Of a sequence the series that it needs are followed when it is made.
    """

    problem: Problem

    def __call__(self, theta: Mapping[str, Any]) -> Float[Array, ""]:
        """Evaluate at θ by name; a perfect match costs nothing."""
        check_jit()
        found = self._numbers(theta)
        _warn_of_single_precision()
        return self._compiled(jnp.stack(found))

    def _numbers(self, theta: Mapping[str, Any]) -> list[Any]:
        """θ in order, each one number."""
        if unknown := [name for name in theta if name not in self.names]:
            raise ValueError(
                f"theta: {unknown[0]!r} is not fitted{did_you_mean(unknown[0], self.names)}: {', '.join(self.names)}"
            )
        if missing := [name for name in self.names if name not in theta]:
            raise ValueError(f"theta: no {missing[0]!r}: needs {', '.join(self.names)}")
        found = {name: as_float(f"theta: {name}", theta[name]) for name in self.names}
        for name, shape in ((name, np.shape(x)) for name, x in found.items()):
            if shape:
                raise ValueError(f"theta: {name!r} has shape {shape}: give one number, such as x[0]; jax.vmap for many")
        return list(found.values())

    @cached_property
    def _compiled(self) -> Callable[[Array], Array]:
        how, numbers = self.problem.parts
        q = self.problem.parameters
        limits = np.array([PARAMETERS[one.name].limits for one in q.free])
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = np.where([[one.log] for one in q.free], np.log(np.maximum(limits, 0)), limits).T
        box = low, high, (q.low + q.high) / 2
        domains = [(data.inputs, self._domain(data)) for data in self.problem.observed]
        # a model with tables, or of one's own, ends with its objective; of others all objectives share their programs
        own = any(front.interpolated or front.event == "own" for _, front, *_ in how[0])
        return partial(jax.jit(partial(_within, how)) if own else partial(_together, how), numbers, box, domains)

    def _domain(self, data: Observations) -> dict[str, tuple[float, float]]:
        """Domain of each input of an observable."""
        every = {**COMMON, **self.problem.parameters.front.inputs, **data.observable.inputs}
        return {name: every[name][1:3] for name in data.inputs.names}

    def __getstate__(self) -> dict[str, Any]:
        return {"problem": self.problem}

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
        """Standard error of each row, (n,); 0 if none.

        Of lengths in λc, of forces of a sequence in N/m.
        """
        return self.problem.by_row(lambda data: data.sigma)

    def start(self) -> dict[str, Array]:
        """θ of the least value on a grid or in a sample."""
        best = lowest_look(self.problem)
        return {name: jnp.asarray(x) for name, x in zip(self.names, best, strict=True)}

    def values(self, theta: Mapping[str, Any]) -> dict[str, float]:
        """Values of the parameters asked for, in their units."""
        return self.problem.parameters.values(np.array(self._numbers(theta), dtype=float))


def _within(how: How, numbers: Any, box: tuple[Any, Any, Any], domains: Any, theta: Array) -> Array:
    """The density; inf outside the domain, and NaN for NaN.

    What calls the host is called with θ inside.
    """
    low, high, middle = box
    inside = (theta >= low) & (theta <= high) & jnp.isfinite(theta)
    for inputs, domain in domains:
        for name, (least, most) in domain.items():
            inside &= ((x := inputs.get(name)(theta)) >= least).all() & (x <= most).all()
    inside = inside.all()
    value = density(how, numbers, jnp.where(inside, theta, middle))
    return jnp.where(inside, value, jnp.where(jnp.isnan(theta).any(), jnp.nan, jnp.inf))


_together = jax.jit(_within, static_argnums=0)


def _warn_of_single_precision() -> None:
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        what = "objective in single precision: flat to rounding near its minimum. Use jax.enable_x64(True)"
        warnings.warn(what, RuntimeWarning, stacklevel=3)


def objective(
    measurements: "Measurements | pd.DataFrame | str | os.PathLike[str]",
    free: str | Parameter | Sequence[str | Parameter] | None = None,
    *,
    bounds: tuple[float, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    loss: Loss = "normal",
    event: MeasuredEvent | Front | None = None,
    body: Body | None = None,
    model_error: float | Literal["fitted"] | None = None,
    seed: int = 0,
    observables: Sequence[Observable] = (),
) -> Objective:
    """Return the function that `fit` minimises.

    Parameters
    ----------
    measurements, free, bounds, fixed, loss, event, body, model_error, seed, observables
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
    size_known = loss == "normal" and m.length_sigma is not None
    front = where_contacts_differ(front_of(m, event, body), m, event, free, fixed, size_known=size_known)
    if m.length_sigma is None and "length" in front.observes:
        raise ValueError(
            f"{m.source}: lengths without σ have no likelihood: give their standard errors; fit takes σ from the scatter"
        )
    _warn_of_single_precision()
    check_choice("loss", loss, Loss)
    wanted = with_errors_of_measuring(m, wanted_parameters(m, free, bounds, fixed, front), front, size_known=True)
    problem = make_problem(m, checked(m, wanted, front, None, loss, observables))
    check_model_error(problem, model_error)
    if not problem.emulates:
        return Objective(problem)
    problem = learnt(problem, seed, model_error)
    return Objective(sized(problem) if model_error == "fitted" else problem)
