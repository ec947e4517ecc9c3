"""Domains of the numbers of the model, and their checks."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from slippulse_jax.base.choices import did_you_mean
from slippulse_jax.base.files import shortened
from slippulse_jax.base.process import check_process


class Domain(NamedTuple):
    """An interval, and the message for a value outside."""

    low: float
    high: float
    requirement: str
    closed: Literal["neither", "low", "high", "both"] = "neither"  # ends that are included

    def holds(self, x: Any) -> Any:
        """Whether `x` lies in it, element by element."""
        above = x >= self.low if self.closed in ("low", "both") else x > self.low
        return above & (x <= self.high if self.closed in ("high", "both") else x < self.high)

    def check(self, name: str, value: Any) -> None:
        """Check a value as `check_domain` does."""
        check_domain(name, value, self.holds, self.requirement)


HEIGHT = Domain(1, np.inf, "must exceed 1: the height in units of the correlation length λc")
STIFFNESS = Domain(0, np.inf, "must be positive: the contact stiffness k in units of K = Eλc")
NORMAL_STIFFNESS = Domain(0, np.inf, "must be positive: the normal stiffness of the interface over that in shear")
FRICTION = Domain(0, np.inf, "must be 0 or more, and finite: the friction coefficient μ of a contact", closed="low")
THRESHOLD = Domain(0, np.inf, "must be positive: the stress θ at which a contact breaks, in σ_s")
MACHINE = Domain(0, np.inf, "must be positive: the stiffness M of the machine in units of K = Eλc, both per slice λc wide")
SITES = Domain(2, np.inf, "at least two contacts are a chain", closed="low")
CORRELATION_LENGTH = Domain(
    1e-10, np.inf, "the correlation length must be positive, and no less than an atom's size, 0.1 nm", closed="low"
)
YOUNG = Domain(0, 1e13, "Young's modulus must be positive, and below 10⁴ GPa, ten times diamond's")
POISSON = Domain(-1, 0.5, "must lie in (-1, 0.5]: Poisson's ratio ν", closed="high")
PRESTRESS = Domain(-1, 1, "must lie in (-1, 1): the prestress φ = σ_0/σ_s")
"""At 1 a contact breaks without a push; at −1 it breaks backwards."""
THRESHOLD_SLOPE = Domain(-1, np.inf, "must exceed -1: the rise ε of the threshold from contact to contact, in σ_s")
"""At −1 contact 1 holds nothing."""
THRESHOLD_SCATTER = Domain(0, 1, "must lie in [0, 1): the standard deviation s of thresholds over their mean", closed="low")
RESIDUAL_STRENGTH = Domain(0, 1, "must lie in [0, 1): the stress r that a contact keeps over its threshold", closed="low")
"""At 1 a contact releases nothing: it slides."""


PLAIN = float, int, np.float64
"""Types of a number that needs no look."""


def in_unit(name: str, x: Any, unit: str = "") -> Any:
    """Convert quantities of Astropy, Pint or unxt to a unit.

    One or several; anything else stays as it is. A TypeError names the argument where a quantity cannot be converted: most
    arguments are ratios, without a unit.
    """
    if type(x) in (*PLAIN, np.ndarray) or (isinstance(x, list | tuple) and {*map(type, x)} <= {*PLAIN}):
        return x
    if isinstance(x, list | tuple):
        return [in_unit(name, one, unit) for one in x]
    held = getattr(x, "data", x) if hasattr(x, "dims") else x  # of an xarray.DataArray
    convert = getattr(held, "to_value", getattr(held, "m_as", None))
    try:
        return x if convert is None else convert(unit)
    except Exception as error:
        wanted = f"in {unit}" if unit else "a number without a unit; from_material and from_si take units"
        raise TypeError(f"{_named(name, str(x))}: must be {wanted} ({error})") from None


def _named(name: str, value: str) -> str:
    return f"{name} = {shortened(value)}" if name else shortened(value)


def _real(one: Any) -> float:
    if isinstance(one, str | bytes | bool | np.bool | None):
        raise TypeError(f"{one!r} is not a number")
    return float(one)


def real_numbers(name: str, x: Any, unit: str = "", cell: Callable[[Any], float] = _real) -> np.ndarray:
    """Convert real numbers to NumPy float64, and quantities to `unit`.

    `cell` converts what is an object or a text. A TypeError names the argument and what it is instead: text, dates, complex
    numbers, booleans, records, nothing, or a quantity in another unit. A ValueError says that it is masked.
    """
    given, why = in_unit(name, x, unit), ""
    if type(given) in (float, np.float64) or (type(given) is np.ndarray and given.dtype.kind == "f"):
        return np.asarray(given, dtype=np.float64)
    for one in given if isinstance(given, list | tuple) else (given,):
        mask = getattr(one, "mask", None)
        if isinstance(mask, np.ndarray | np.bool) and mask.any():
            raise ValueError(f"{_named(name, repr(one))}: has masked values; fill them, or leave them out")
        if isinstance(one, bool | np.bool):
            raise TypeError(f"{_named(name, repr(x))}: must be a real number, or several ({one!r} is not a number)")
    try:
        array = np.asarray(given)
        if array.dtype.kind in "OU":
            array = np.reshape([cell(one) for one in array.ravel().tolist()], array.shape)
        # bfloat16 is of kind V, as records are
        if array.dtype.kind in "fiu" or (array.dtype.kind == "V" and array.dtype.type is not np.void):
            return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        if not name:
            raise TypeError(str(error)) from None
        why = f" ({error})"
    raise TypeError(f"{_named(name, repr(x))}: must be a real number, or several{why}")


def check_kind(name: str, value: object, *kinds: type) -> None:
    """Check that an argument is an object of one of these classes.

    It also checks that this process can compute with it. A TypeError names the argument, what it is, and what it must be; a
    RuntimeError is as that of `check_process`.
    """
    check_process()
    if not isinstance(value, kinds):
        expected = " or ".join("None" if kind is type(None) else kind.__name__ for kind in kinds)
        raise TypeError(f"{name} is {type(value).__name__}: must be {expected}")


def check_whole(name: str, value: object, least: int) -> None:
    """Check that an argument is a whole number, `least` or more."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} = {value!r}: must be a whole number, at least {least}")


def check_choice(name: str, value: object, choices: Any) -> None:
    """Check that an argument is one of the values of a ``Literal``."""
    known = get_args(choices)
    if value not in known:
        raise ValueError(f"{name} = {value!r}: must be one of {', '.join(map(repr, known))}{did_you_mean(value, known)}")


def check_single(owner: str, **given: Any) -> None:
    """Check that arguments with a `shape` are no batches.

    None stands for one that was not given. A ValueError names the owner, the argument, and its shape.
    """
    for name, value in given.items():
        if value is not None and value.shape != ():
            raise ValueError(f"{owner} takes one {name}, got a batch of shape {value.shape}: use jax.vmap")


def check_domain(name: str, value: Any, inside: Any, requirement: str) -> None:
    """Check that all values are finite and inside a domain.

    Values that JAX traces are not checked. A ValueError has name, value and index of the first that is not, and `requirement`.
    """
    from jax.core import Tracer  # here, because a table of measurements is read without JAX

    if isinstance(value, Tracer):
        return
    if in_unit(name, value) is not value and not isinstance(value, list | tuple):
        raise TypeError(f"{name} = {shortened(str(value))}: must be a number, not a quantity")
    single = getattr(value, "dtype", None) == np.float32  # in which ends are rounded as the value is
    value = real_numbers(name, value)
    bad = ~(np.isfinite(value) & inside(value.astype(np.float32) if single else value))
    if bad.any():
        index = [int(i) for i in np.argwhere(bad)[0]]
        where = f" at index {index[0] if len(index) == 1 else tuple(index)}" if index else ""
        more = f" ({int(bad.sum())} such values)" if bad.sum() > 1 else ""
        raise ValueError(f"{name} = {value[tuple(index)]:g}{where}{more}: {requirement}")
