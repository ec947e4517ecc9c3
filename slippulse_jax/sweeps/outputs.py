"""Outputs of a sweep: their functions, the table, and the choice."""

import functools
from collections.abc import Callable, Iterable
from operator import attrgetter
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from slippulse_jax import lengths as bulk
from slippulse_jax import theory
from slippulse_jax.base.choices import RightEnd, did_you_mean
from slippulse_jax.base.status import FRONT_OUTCOMES, Outcome
from slippulse_jax.blocks import size
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.bulk.chunks import Kernel, Layout, over_lanes
from slippulse_jax.exact.bulk import ARREST_OUTCOMES, exact_arrests
from slippulse_jax.interface import Interface
from slippulse_jax.rules import SmoothBreak
from slippulse_jax.slider import Slider
from slippulse_jax.sweeps.request import INTERFACE, PARAMETERS, PUSH, SLIDER, Columns, Region, Request, shape_of

Compute = Callable[[Request, Columns], Any]
"""Values of an output from the parameters of all points, or of several outputs by name."""

# --- functions -----------------------------------------------------------------------------------------------------------


def _in_bulk(function: Callable[..., Any]) -> Compute:
    """Evaluate a function of sliders and interface."""

    def evaluated(request: Request, columns: Columns) -> Any:
        interface = _interface(columns) if INTERFACE.keys() & columns.keys() else None
        return function(Slider(*_fields(columns, *SLIDER), length=request.sites, right=request.right), interface)

    return evaluated


def _fields(columns: Columns, *names: str) -> list[np.ndarray]:
    """The columns of these parameters, zeros for those not given."""
    zeros = np.zeros(len(columns["height"]))
    return [columns.get(name, zeros) for name in names]


def _interface(columns: Columns) -> Interface:
    prestress, slope = _fields(columns, "prestress", "threshold_slope")
    return Interface(prestress, slope, columns.get("residual_strength"))


@_in_bulk
def _front(slider: Slider, interface: Interface | None) -> Columns:
    found = bulk.arrests(slider, interface)._asdict()
    del found["length"]  # always by itself, whatever the other outputs: two ways may round differently
    return found | {"is_one_domino": found["status"] == Outcome.ARRESTED}


@_in_bulk
def _gradients(slider: Slider, interface: Interface | None) -> Columns:
    found = bulk.lengths(slider, interface, derivatives=1)
    return {
        f"dlength_d{name}": getattr(owner, name)
        for owner, names in ((found.slider, SLIDER), (found.interface, INTERFACE))
        if owner is not None
        for name in names
    }


def _exact(_: Request, columns: Columns) -> Columns:
    contacts = _interface(columns)
    lanes = *_fields(columns, *SLIDER), contacts.equivalent_prestress, contacts.threshold_slope
    length, status = exact_arrests(np.stack(lanes))
    return {"exact_length": length, "exact_status": status}


def _smooth(request: Request, columns: Columns) -> np.ndarray:
    slider = Slider(*_fields(columns, *SLIDER))
    return bulk.lengths(slider, rule=SmoothBreak(columns["width"]))


def _block(request: Request, columns: Columns) -> np.ndarray:
    numbers = _fields(columns, *SLIDER, "push_height")
    block = size.many(
        *numbers,
        control=request.push_control,
        contact_law=request.contact_law,
        top=request.top,
        **{name: columns.get(name) for name in PUSH if name != "push_height"},
    )
    return size.lengths(block, _interface(columns), "full")


def _formula(formula: Callable[..., Any]) -> Compute:
    """Evaluate a formula, whose bits do not depend on the other outputs."""

    @functools.cache
    def kernel(right: RightEnd, sites: int | None) -> Kernel:
        return lambda lanes: (formula(Slider(*lanes[:3], length=sites, right=right), *lanes[3:]),)

    def evaluated(request: Request, columns: Columns) -> np.ndarray:
        lanes = _fields(columns, *SLIDER, "prestress", *columns.keys() & {"residual_strength"})
        return over_lanes(kernel(request.right, request.sites), lanes, Layout(chunk=512))[0]

    return evaluated


def _of_slider(formula: Callable[[Slider], Any]) -> Compute:
    return _formula(lambda slider, *_: formula(slider))


def _load(slider: Slider, prestress: Array, *_: Array) -> Array:
    # from its prestress to its threshold, which for contact 0 is 1 whatever the gradient of thresholds
    numbers, end = (slider.height, slider.stiffness, slider.poisson), {"length": slider.length, "right": slider.right}
    return (1 - prestress) * jax.vmap(lambda *one: lattice_modes(Slider(*one, **end)).load)(*numbers)


def _macroscopic(slider: Slider, prestress: Array, kept: Any = 0.0) -> Any:
    return slider.height * theory.macroscopic_length(slider.b, slider.poisson, prestress=prestress, residual_strength=kept)


def _is_continuous(slider: Slider) -> Any:
    return (slider.kappa_1 < 1 / 3) & (slider.height > 10)


def _is_frozen(slider: Slider) -> Any:
    return _is_continuous(slider) & (slider.kappa_T**2 / slider.kappa**2 < 0.1)


def _is_far_from_edge(slider: Slider) -> Any:
    return _is_frozen(slider) & (slider.kappa * theory.length_eq25(slider) > 3)


# --- the table -----------------------------------------------------------------------------------------------------------


class Output(NamedTuple):
    """One output, and the function that computes it."""

    long_name: str
    unit: str
    function: Compute
    takes: frozenset[str] = frozenset()  # parameters and "right", on which it depends beyond the slider
    dtype: str = "float64"
    outcomes: tuple[Outcome, ...] = ()  # what its values stand for
    comment: str = ""


_INTERFACE = frozenset(INTERFACE)
_FRONT = _INTERFACE | {"right"}
_CONDITIONS = "the approximation's own conditions hold: "


def _flag(long_name: str, function: Compute, condition: str, takes: frozenset[str] = frozenset()) -> Output:
    """Output that is 1 where a condition holds."""
    return Output(long_name, "1", function, takes, "int8", comment=f"1 where {condition}")


OUTPUTS = {
    "length": Output("length of the first precursor", "lambda_c", _in_bulk(bulk.lengths), _FRONT),
    "contacts_broken": Output("whole contacts broken", "1", _front, _FRONT, "int32"),
    "status": Output("how the front ended", "1", _front, _FRONT, "int8", FRONT_OUTCOMES),
    "edge_stress": Output("stress on contact 0 behind the front", "sigma_s", _front, _FRONT),
    "nucleation_load": Output("displacement of the left edge at nucleation, U0", "u_s", _formula(_load), _FRONT),
    "dlength_dheight": Output("derivative of length with respect to height", "lambda_c", _gradients, _FRONT),
    "dlength_dstiffness": Output("derivative of length with respect to stiffness", "lambda_c", _gradients, _FRONT),
    "dlength_dpoisson": Output("derivative of length with respect to Poisson's ratio", "lambda_c", _gradients, _FRONT),
    "dlength_dprestress": Output("derivative of length with respect to prestress", "lambda_c/sigma_s", _gradients, _FRONT),
    "dlength_dthreshold_slope": Output(
        "derivative of length with respect to the threshold gradient", "lambda_c sites/sigma_s", _gradients, _FRONT
    ),
    "dlength_dresidual_strength": Output(
        "derivative of length with respect to the residual strength", "lambda_c", _gradients, _FRONT
    ),
    "exact_length": Output("length by the exact solution, the real crossing t(l*) = threshold", "lambda_c", _exact, _INTERFACE),
    "exact_status": Output("what the exact front stress says", "1", _exact, _INTERFACE, "int8", ARREST_OUTCOMES),
    "block_precursor_length": Output(
        "length of the whole event of a block under two-dimensional elasticity", "lambda_c", _block, _INTERFACE | PUSH.keys()
    ),
    "smooth_length": Output("length under the smooth break rule", "lambda_c", _smooth, frozenset({"width"})),
    "length_eq25": Output("length by the paper's Eq. (25)", "lambda_c", _of_slider(theory.length_eq25)),
    "length_eq58": Output("length by Eq. (58), corrected", "lambda_c", _of_slider(theory.length)),
    "length_frozen": Output(
        "length in the continuum with the upper layer frozen (Appendix)", "lambda_c", _of_slider(theory.length_frozen)
    ),
    "length_continuum": Output("length in the self-consistent continuum", "lambda_c", _of_slider(theory.length_continuum)),
    "length_envelope": Output("length by a closed formula", "lambda_c", _of_slider(theory.envelope_length)),
    "length_macroscopic": Output(
        "length by the macroscopic law (lambda_c -> 0)",
        "lambda_c",
        _formula(_macroscopic),
        _INTERFACE - {"threshold_slope"},
    ),
    "runaway_prestress": Output(
        "prestress beyond which nothing far from the edge stops a front",
        "sigma_s",
        _formula(lambda slider, _, *kept: theory.runaway_prestress(slider, *kept)),
        _INTERFACE,
    ),
    "b": Output("areal shear stiffness of the interface times H over the shear modulus", "1", _of_slider(attrgetter("b"))),
    "slow_decay_length": Output(
        "decay length of the slow mode, 1/kappa_2", "lambda_c", _of_slider(attrgetter("slow_decay_length"))
    ),
    "is_one_domino": _flag(
        "the event is one domino from the edge",
        _front,
        "at least two contacts broke, the front arrested, and no contact behind it came back to its threshold",
        _FRONT,
    ),
    "is_continuous": _flag(
        "the continuum applies", _of_slider(_is_continuous), f"{_CONDITIONS}kappa_1 lambda_c < 1/3 and H/lambda_c > 10"
    ),
    "is_frozen": _flag(
        "the frozen upper layer applies",
        _of_slider(_is_frozen),
        f"{_CONDITIONS}those of is_continuous, and kappa_T^2/kappa^2 < 0.1",
    ),
    "is_far_from_edge": _flag(
        "Eq. (25) applies", _of_slider(_is_far_from_edge), f"{_CONDITIONS}those of is_frozen, and kappa times this length > 3"
    ),
}
"""Every output, by name."""

SETS = {
    "gradients": tuple(name for name, output in OUTPUTS.items() if output.function is _gradients),
    "theory": (*(name for name in OUTPUTS if name.startswith("length_")), "runaway_prestress"),
    "validity": ("is_one_domino", "is_continuous", "is_frozen", "is_far_from_edge"),
}
"""Sets of outputs; those that the request does not allow are left out."""


def choose(requested: str | Iterable[str], parameters: Iterable[str]) -> tuple[str, ...]:
    """Resolve the names of outputs and sets, each once, in order.

    A ValueError names one that is unknown, or that does not depend on a parameter that was given.
    """
    beyond = set(parameters) - set(SLIDER)
    chosen: dict[str, None] = {}
    for name in (requested,) if isinstance(requested, str) else requested:
        if name not in OUTPUTS and name not in SETS:
            known = *OUTPUTS, *SETS
            raise ValueError(f"output {name!r}: must be one of {', '.join(known)}{did_you_mean(name, known)}")
        if name in OUTPUTS and (objection := _objection(name, beyond)):
            raise ValueError(objection)
        chosen |= {one: None for one in SETS.get(name, (name,)) if not _objection(one, beyond)}
    if not chosen:
        raise ValueError("a sweep needs at least one output")
    if unused := beyond.difference(*(OUTPUTS[name].takes for name in chosen)):
        takers = [name for name, output in OUTPUTS.items() if unused <= set(output.takes)]
        ask = f": ask for {' or '.join(takers)} in outputs" * bool(takers)
        raise ValueError(f"no output takes account of {', '.join(sorted(unused))}{ask}")
    return tuple(chosen)


def _objection(name: str, given: set[str]) -> str:
    takes = OUTPUTS[name].takes
    for needed in ("width", "push_height"):
        if needed in takes and needed not in given:
            return f"output {name!r} needs {needed}: {PARAMETERS[needed].name}"
    needed = name.removeprefix("dlength_d")
    if needed in INTERFACE and not given & ({needed} if needed == "residual_strength" else INTERFACE.keys()):
        return f"output {name!r} needs {needed}: give it, 0 for instance"
    ignored = given - takes - {"width", *PUSH}  # each serves one output and does not affect the others
    return f"output {name!r} takes no account of {', '.join(sorted(ignored))}" if ignored else ""


def evaluate(request: Request, region: Region) -> Columns:
    """Compute the outputs of a region; no point depends on another."""
    columns, shape = request.columns(region), shape_of(region)
    found: Columns = {}
    for name in request.outputs:
        if name not in found:
            values = OUTPUTS[name].function(request, columns)
            found |= values if isinstance(values, dict) else {name: values}
    return {name: found[name].astype(OUTPUTS[name].dtype, copy=False).reshape(shape) for name in request.outputs}
