"""The request of a sweep, described in full but never materialised.

So 10⁸ points take the memory of their axes.
"""

import hashlib
import itertools
import json
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from slippulse_jax.base import domains
from slippulse_jax.base.files import plain
from slippulse_jax.base.units import Quantity, quantities
from slippulse_jax.block import OF_SIDE, Block, ContactLaw, Control, Push, Top, has_push
from slippulse_jax.bodies.modes import RightEnd
from slippulse_jax.front.arrest import MOST_BREAKS
from slippulse_jax.interface import Interface, check_bulk
from slippulse_jax.rules import WIDTH, SmoothBreak
from slippulse_jax.slider import Slider

Columns = dict[str, np.ndarray]
"""Values by name of parameter or output, one per point."""

Region = tuple[slice, ...]
"""Part of the result: a slice along each dimension."""

SLIDER = {name: quantities(Slider)[name] for name in ("height", "stiffness", "poisson")}
INTERFACE = quantities(Interface)
PUSH = {
    "push_height": Quantity("h/H", "1", name="height of the push over that of the block, h/H"),
    "push_width": Quantity("w/H", "1", name="height of the pusher over that of the block, w/H"),
    "friction": Quantity("\\mu", "1", name="friction coefficient by which thresholds follow the pressure, μ"),
    "normal_stiffness": Quantity("k_n/k", "1", name="normal over shear stiffness of a contact, k_n/k"),
}
PARAMETERS: dict[str, Quantity] = {**SLIDER, **INTERFACE, **quantities(SmoothBreak), **PUSH}
"""Parameters that can be swept, in the order of the axes."""

DOMAINS = {
    "height": ("Slider.", domains.HEIGHT), "stiffness": ("Slider.", domains.STIFFNESS),
    "poisson": ("Slider.", domains.POISSON), "prestress": ("Interface.", domains.PRESTRESS),
    "threshold_slope": ("Interface.", domains.THRESHOLD_SLOPE),
    "residual_strength": ("Interface.", domains.RESIDUAL_STRENGTH), "width": ("SmoothBreak.", WIDTH),
    "push_height": ("", OF_SIDE), "push_width": ("", OF_SIDE), "friction": ("", domains.FRICTION),
    "normal_stiffness": ("", domains.NORMAL_STIFFNESS),
}  # fmt: skip
"""Owner and domain of each parameter."""


class Request(NamedTuple):
    """A sweep whose parameters have been checked.

    `axes` has them as coordinates: numbers, and axes, each along a dimension of its own; or all of them along ``point``, to be
    taken together. The rest is as for `slippulse_jax.precursor_length`, `slippulse_jax.Push` and `slippulse_jax.Block`.
    """

    axes: xr.Dataset
    outputs: tuple[str, ...]
    right: RightEnd = "semi-infinite"
    sites: int | None = None
    push_control: Control = "displacement"
    contact_law: ContactLaw = "amontons"
    top: Top = "free"

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the result."""
        return tuple(self.axes.sizes.values())

    def columns(self, region: Region) -> Columns:
        """Parameters of the points of a region, the last axis running fastest."""
        part = self.axes.isel(dict(zip(self.axes.sizes, region, strict=True)))
        return {str(name): one.set_dims(part.sizes).values.ravel() for name, one in part.variables.items()}

    def describe(self) -> dict[str, Any]:
        """The request for JSON; the values of the axes by their digest."""
        return {
            "parameters": {
                name: {"size": one.size, "sha256": _digest(one.values)} if one.ndim else {"value": one.values.item()}
                for name, one in self.axes.variables.items()
            },
            "combined": "points" if "point" in self.axes.sizes else "product",
            "outputs": list(self.outputs),
            "right": self.right,
            "sites": plain(self.sites),
            "max_contacts": MOST_BREAKS,
            **({"push_control": self.push_control} if "push_height" in self.axes else {}),
            **({"contact_law": self.contact_law} if self.contact_law != "amontons" else {}),
            **({"top": self.top} if self.top != "free" else {}),
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
    """Shape of chunks of at most `points` points: trailing axes first."""
    sizes: list[int] = []
    for n in reversed(shape):
        sizes.insert(0, -(-n // -(-n // points)))  # as many parts as needed, all but the last of one size
        points //= sizes[0]
    return tuple(sizes)


def regions(shape: tuple[int, ...], points: int) -> list[Region]:
    """Cut a shape into such chunks, the last axis running fastest."""
    steps = zip(shape, chunk_shape(shape, points), strict=True)
    return list(itertools.product(*([slice(a, min(a + step, n)) for a in range(0, n, step)] for n, step in steps)))


def _with_interface(given: dict[str, Any], interface: Interface | None) -> dict[str, Any]:
    """Add the numbers of an interface; an axis may replace a 0."""
    check_bulk(interface)
    if interface is None:
        return given
    if interface.shape:
        raise ValueError(f"interface has shape {interface.shape}: must be one; give arrays as axes, such as prestress=…")
    numbers = {name: getattr(interface, name) for name in INTERFACE}
    if twice := [name for name, number in numbers.items() if number and given[name] is not None]:
        raise ValueError(f"{twice[0]} is given twice: in the interface and as an axis")
    return given | {name: number for name, number in numbers.items() if given[name] is None}


def make_axes(
    given: dict[str, Any],
    interface: Interface | None = None,
    *,
    points: bool = False,
    push_control: Control = "displacement",
    contact_law: ContactLaw = "amontons",
    top: Top = "free",
) -> xr.Dataset:
    """Check all parameters before anything is computed, and label them.

    None is one that is not given. A ValueError names one that is missing, of more than one dimension, empty or out of domain.
    """
    given = _with_interface(given, interface)
    if missing := [name for name in SLIDER if given.get(name) is None]:
        raise ValueError(f"a sweep needs {', '.join(missing)}: a number, or an array to sweep over")
    values = {name: _values(name, given[name]) for name in PARAMETERS if given.get(name) is not None}
    sizes = {name: one.size for name, one in values.items() if one.ndim}
    if points and len(set(sizes.values())) != 1:
        raise ValueError(f"points are given as arrays of one length, got {sizes or 'no array'}")
    axes = labelled_axes(values, points=points)
    Block(2, 1, 0.3, friction=0.0 if "friction" in axes else None, contact_law=contact_law, top=top)  # which checks them
    pushed = has_push(axes, push_control)
    of_block = [name for name in ("friction", "normal_stiffness") if name in axes] + ["top"] * (top != "free")
    if of_block and not pushed:
        raise ValueError(f"{of_block[0]} describes a block: give push_height too")
    if pushed and "push_width" in axes:
        at, width = (one.values.ravel() for one in xr.broadcast(axes["push_height"], axes["push_width"]))
        beyond = (at - width / 2 <= 0) | (at + width / 2 >= 1)
        if beyond.any():
            Push(at[beyond][0], width[beyond][0], push_control)  # which says how it leaves the side of the block
    return axes


def _values(name: str, given: Any) -> np.ndarray:
    values = np.array(domains.real_numbers(name, given))  # a copy: the caller's array may change while the sweep runs
    if values.ndim > 1 or values.size == 0:
        raise ValueError(f"{name} has shape {values.shape}: must be a number or a one-dimensional array with values")
    owner, domain = DOMAINS[name]
    domain.check(owner + name, values)
    return values


def labelled_axes(values: Columns, *, points: bool) -> xr.Dataset:
    """Label the values of parameters with units and dimensions."""
    coords = {}
    for name in (name for name in PARAMETERS if name in values):
        symbol, unit, label, long_name = PARAMETERS[name]
        about = {"long_name": long_name, "units": unit, "symbol": symbol} | ({"equation": label} if label else {})
        coords[name] = xr.Variable(("point" if points else name,) * values[name].ndim, values[name], about)
    return xr.Dataset(coords=coords)
