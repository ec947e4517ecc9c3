"""The request of a sweep, described in full but never materialised.

So 10⁸ points take the memory of their axes.
"""

import hashlib
import itertools
import json
import math
from typing import Any, NamedTuple

import numpy as np

from slippulse_jax.block import OF_SIDE, Control, Push, has_push
from slippulse_jax.bodies.modes import RightEnd, check_right_end
from slippulse_jax.front.arrest import check_max_contacts
from slippulse_jax.front.front import DEFAULT_MAX_CONTACTS
from slippulse_jax.interface import Interface, check_bulk
from slippulse_jax.rules import SmoothBreak
from slippulse_jax.slider import Slider
from slippulse_jax.units import Quantity, quantities

Columns = dict[str, np.ndarray]
"""Values by name of parameter or output, one per point."""

Region = tuple[slice, ...]
"""Part of the result: a slice along each dimension."""

SLIDER = {name: quantities(Slider)[name] for name in ("height", "stiffness", "poisson")}
INTERFACE = {**quantities(Interface), "repin_delay": Quantity("n", "sites", name="delay before a contact repins")}
PUSH = {
    "push_height": Quantity("h/H", "1", name="height of the push over that of the block, h/H"),
    "push_width": Quantity("w/H", "1", name="height of the pusher over that of the block, w/H"),
}
PARAMETERS: dict[str, Quantity] = {**SLIDER, **INTERFACE, **quantities(SmoothBreak), **PUSH}
"""Parameters that can be swept, in the order of the axes."""


class Request(NamedTuple):
    """A sweep whose parameters have been checked.

    Attributes
    ----------
    parameters : dict of numpy.ndarray
        Shape () where fixed, (n,) where swept, float64 (``repin_delay``: int64); only those given.
    product : bool
        Every combination of the axes; or, if false, points: axes of one length, taken together.
    outputs : tuple of str
    right, sites, max_contacts
        As for `slippulse_jax.precursor_length`.
    push_control
        As for `slippulse_jax.Push`.
    """

    parameters: Columns
    product: bool
    outputs: tuple[str, ...]
    right: RightEnd = "semi-infinite"
    sites: int | None = None
    max_contacts: int = DEFAULT_MAX_CONTACTS
    push_control: Control = "displacement"

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the swept parameters."""
        return tuple(name for name, values in self.parameters.items() if values.ndim)

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the result."""
        return self.axes if self.product else ("point",)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the result."""
        sizes = tuple(self.parameters[name].size for name in self.axes)
        return sizes if self.product else sizes[:1]

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    def columns(self, region: Region) -> Columns:
        """Parameters of the points of a region, the last axis running fastest."""
        shape = shape_of(region)
        found = {}
        for name, values in self.parameters.items():
            if values.ndim:
                axis = self.axes.index(name) if self.product else 0
                values = values[region[axis]].reshape(-1, *[1] * (len(shape) - axis - 1))
            found[name] = np.broadcast_to(values, shape).ravel()
        return found

    def describe(self) -> dict[str, Any]:
        """The request for JSON; the values of the axes, which are coordinates of the result, by their digest."""
        parameters = {
            name: {"size": values.size, "sha256": _digest(values)} if values.ndim else {"value": values.item()}
            for name, values in self.parameters.items()
        }
        return {
            "parameters": parameters,
            "combined": "product" if self.product else "points",
            "outputs": list(self.outputs),
            "right": self.right,
            "sites": self.sites,
            "max_contacts": self.max_contacts,
            **({"push_control": self.push_control} if "push_height" in self.parameters else {}),
        }

    @property
    def digest(self) -> str:
        """SHA-256 of everything that the result depends on."""
        return hashlib.sha256(json.dumps(self.describe(), sort_keys=True).encode()).hexdigest()


def _digest(values: np.ndarray) -> str:
    return hashlib.sha256(values.astype(values.dtype.newbyteorder("<")).tobytes()).hexdigest()


def shape_of(region: Region) -> tuple[int, ...]:
    """Number of points of a region along each dimension."""
    return tuple(part.stop - part.start for part in region)


def chunk_shape(shape: tuple[int, ...], points: int) -> tuple[int, ...]:
    """Shape of chunks of at most `points` points: trailing axes whole as far as they fit, one axis in equal parts."""
    sizes: list[int] = []
    for n in reversed(shape):
        sizes.insert(0, -(-n // -(-n // points)))  # as many parts as needed, all but the last of one size
        points //= sizes[0]
    return tuple(sizes)


def regions(shape: tuple[int, ...], points: int) -> list[Region]:
    """Cut a shape into chunks of at most `points` points, the last axis running fastest."""
    steps = zip(shape, chunk_shape(shape, points), strict=True)
    return list(itertools.product(*([slice(a, min(a + step, n)) for a in range(0, n, step)] for n, step in steps)))


def make_request(
    given: dict[str, Any],
    points: bool,
    outputs: tuple[str, ...],
    right: RightEnd,
    sites: int | None,
    max_contacts: int,
    push_control: Control,
) -> Request:
    """Check all parameters before anything is computed.

    Raises
    ------
    ValueError
        For a parameter that is missing, of more than one dimension, empty or outside its domain, naming it.
    """
    check_right_end(right, sites)
    check_max_contacts(max_contacts)
    parameters = {name: _values(name, given[name]) for name in PARAMETERS if given.get(name) is not None}
    if missing := [name for name in SLIDER if name not in parameters]:
        raise ValueError(f"a sweep needs {', '.join(missing)}: a number, or an array to sweep over")
    _check_domains(parameters)
    if points:
        sizes = {name: values.size for name, values in parameters.items() if values.ndim}
        if not sizes or len(set(sizes.values())) > 1:
            raise ValueError(f"points are given as arrays of one length, got {sizes or 'no array'}")
    _check_push(parameters, points, push_control)
    return Request(parameters, not points, outputs, right, sites, max_contacts, push_control)


def with_interface(given: dict[str, Any], interface: Interface | None) -> dict[str, Any]:
    """Add the numbers of `interface` to the parameters; an axis may replace one that is 0.

    Raises
    ------
    TypeError
        If `interface` is a `Profile`.
    ValueError
        If it holds arrays, or a number other than 0 that is given as an axis too.
    """
    check_bulk(interface)
    if interface is None:
        return given
    if interface.shape:
        raise ValueError(f"interface has shape {interface.shape}: must be one; give arrays as axes, such as prestress=…")
    numbers = {name: getattr(interface, name) for name in INTERFACE}
    if twice := [name for name, number in numbers.items() if number != 0 and given[name] is not None]:
        raise ValueError(f"{twice[0]} is given twice: in the interface and as an axis")
    if interface.repin_delay == 0:
        del numbers["repin_delay"]  # which the closed form does not include
    return given | {name: number for name, number in numbers.items() if given[name] is None}


def _values(name: str, given: Any) -> np.ndarray:
    values = np.array(given, dtype=np.float64)  # a copy: the caller's array may change while the sweep runs
    if values.ndim > 1 or values.size == 0:
        raise ValueError(f"{name} has shape {values.shape}: must be a number or a one-dimensional array with values")
    if name == "repin_delay":
        if not (values == np.round(values)).all():
            raise ValueError(f"repin_delay = {given}: must be whole numbers of sites")
        values = values.astype(np.int64)
    return values


def _check_domains(parameters: Columns) -> None:
    """Check each axis by the class that owns its parameter."""
    fixed = {"height": 2.0, "stiffness": 1.0, "poisson": 0.0}
    for name in SLIDER:
        Slider(**{**fixed, name: parameters[name]})
    zero = np.zeros(())
    Interface(parameters.get("prestress", zero))
    Interface(threshold_slope=parameters.get("threshold_slope", zero))
    for delay in np.unique(parameters.get("repin_delay", 0)):
        Interface(repin_delay=int(delay))
    if "width" in parameters:
        SmoothBreak(parameters["width"])
    for name in PUSH:
        if name in parameters:
            OF_SIDE.check(name, parameters[name])


def _check_push(parameters: Columns, points: bool, control: Control) -> None:
    """Check every pusher that the sweep combines: it must lie on the side of the block."""
    if not has_push(parameters, control) or "push_width" not in parameters:
        return
    at, width = parameters["push_height"], parameters["push_width"]
    at, width = np.broadcast_arrays(at, width) if points else np.broadcast_arrays(at, np.expand_dims(width, -1))
    beyond = np.ravel((at - width / 2 <= 0) | (at + width / 2 >= 1))
    if beyond.any():
        Push(at.ravel()[beyond][0], width.ravel()[beyond][0], control)
