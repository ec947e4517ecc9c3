"""Outputs of a sweep, and the functions that compute them: a formula each, or one function for a group of them."""

import functools
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from slippulse_jax import lengths as bulk
from slippulse_jax import theory
from slippulse_jax.bodies.modes import Ends, RightEnd, lattice_modes
from slippulse_jax.bulk.chunks import Kernel, Layout, over_lanes
from slippulse_jax.events import block as blocks
from slippulse_jax.exact.bulk import ARREST_OUTCOMES, exact_arrests
from slippulse_jax.front.front import FRONT_OUTCOMES
from slippulse_jax.interface import Interface
from slippulse_jax.rules import SmoothBreak
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome
from slippulse_jax.sweeps.request import INTERFACE, PUSH, SLIDER, Columns, Region, Request, shape_of


class Output(NamedTuple):
    """One output, and the group of outputs that are computed together."""

    long_name: str
    unit: str
    group: str
    takes: frozenset[str] = frozenset()  # parameters it depends on beyond those of the slider
    dtype: str = "float64"
    outcomes: tuple[Outcome, ...] = ()  # what its values stand for
    comment: str = ""


_FRONT = frozenset({"prestress", "threshold_slope", "repin_delay"})
_EXACT = frozenset({"prestress", "threshold_slope"})
_FLAG = "1 where the approximation's own conditions hold: "

OUTPUTS = {
    "length": Output("length of the first precursor", "lambda_c", "length", _FRONT),
    "contacts_broken": Output("whole contacts broken", "1", "front", _FRONT, "int32"),
    "status": Output("how the front ended", "1", "front", _FRONT, "int8", FRONT_OUTCOMES),
    "edge_stress": Output("stress on contact 0 behind the front", "sigma_s", "front", _FRONT),
    "nucleation_load": Output("displacement of the left edge at nucleation, U0", "u_s", "load", _FRONT),
    "dlength_dheight": Output("derivative of length with respect to height", "lambda_c", "gradient", _FRONT),
    "dlength_dstiffness": Output("derivative of length with respect to stiffness", "lambda_c", "gradient", _FRONT),
    "dlength_dpoisson": Output("derivative of length with respect to Poisson's ratio", "lambda_c", "gradient", _FRONT),
    "dlength_dprestress": Output("derivative of length with respect to prestress", "lambda_c/sigma_s", "gradient", _FRONT),
    "dlength_dthreshold_slope": Output(
        "derivative of length with respect to the threshold gradient", "lambda_c sites/sigma_s", "gradient", _FRONT
    ),
    "exact_length": Output("length by the exact solution, the real crossing t(l*) = threshold", "lambda_c", "exact", _EXACT),
    "exact_status": Output("what the exact front stress says", "1", "exact", _EXACT, "int8", ARREST_OUTCOMES),
    "block_precursor_length": Output(
        "length of the whole event of a block under two-dimensional elasticity",
        "lambda_c",
        "block",
        _EXACT | {"push_height", "push_width"},
    ),
    "smooth_length": Output("length under the smooth break rule", "lambda_c", "smooth", frozenset({"width"})),
    "length_eq25": Output("length by the paper's Eq. (25)", "lambda_c", "theory"),
    "length_eq58": Output("length by Eq. (58), corrected", "lambda_c", "theory"),
    "length_frozen": Output("length in the continuum with the upper layer frozen (Appendix)", "lambda_c", "theory"),
    "length_continuum": Output("length in the self-consistent continuum", "lambda_c", "theory"),
    "length_envelope": Output("length by a closed formula", "lambda_c", "theory"),
    "length_macroscopic": Output(
        "length by the macroscopic law (lambda_c -> 0)", "lambda_c", "theory", frozenset({"prestress"})
    ),
    "runaway_prestress": Output("prestress beyond which nothing far from the edge stops a front", "sigma_s", "theory", _FRONT),
    "b": Output("areal shear stiffness of the interface times H over the shear modulus", "1", "slider"),
    "slow_decay_length": Output("decay length of the slow mode, 1/kappa_2", "lambda_c", "slider"),
    "is_one_domino": Output(
        "the event is one domino from the edge",
        "1",
        "front",
        _FRONT,
        "int8",
        comment="1 where at least two contacts broke, the front arrested, and no contact behind it came back to its threshold",
    ),
    "is_continuous": Output(
        "the continuum applies", "1", "validity", dtype="int8", comment=_FLAG + "kappa_1 lambda_c < 1/3 and H/lambda_c > 10"
    ),
    "is_frozen": Output(
        "the frozen upper layer applies",
        "1",
        "validity",
        dtype="int8",
        comment=_FLAG + "those of is_continuous, and kappa_T^2/kappa^2 < 0.1",
    ),
    "is_far_from_edge": Output(
        "Eq. (25) applies", "1", "validity", dtype="int8", comment=_FLAG + "those of is_frozen, and kappa times this length > 3"
    ),
}
"""Every output, by name."""

SETS = {
    "gradients": tuple(name for name, output in OUTPUTS.items() if output.group == "gradient"),
    "theory": tuple(name for name, output in OUTPUTS.items() if output.group == "theory"),
    "validity": ("is_one_domino", "is_continuous", "is_frozen", "is_far_from_edge"),
}
"""Names of sets of outputs; those that the request does not allow are left out."""


def choose(requested: str | Iterable[str], parameters: set[str]) -> tuple[str, ...]:
    """Resolve the names of outputs and sets, each output once, in the order requested.

    Raises
    ------
    ValueError
        For an unknown name, or an output that does not depend on a parameter that was given.
    """
    beyond = parameters - set(SLIDER)
    chosen: dict[str, None] = {}
    for name in (requested,) if isinstance(requested, str) else requested:
        if name in SETS:
            chosen |= {one: None for one in SETS[name] if not _objection(one, beyond)}
        elif name not in OUTPUTS:
            raise ValueError(f"output {name!r}: must be one of {', '.join((*OUTPUTS, *SETS))}")
        elif objection := _objection(name, beyond):
            raise ValueError(objection)
        else:
            chosen[name] = None
    if not chosen:
        raise ValueError("a sweep needs at least one output")
    if unused := beyond.difference(*(OUTPUTS[name].takes for name in chosen)):
        raise ValueError(f"no output takes account of {', '.join(sorted(unused))}")
    return tuple(chosen)


NEEDED = {
    "smooth_length": ("width", "that of the smooth break rule"),
    "block_precursor_length": ("push_height", "where the side of the block is pushed"),
}
"""Parameters without which an output has no meaning."""


def _objection(name: str, given: set[str]) -> str:
    output = OUTPUTS[name]
    if name in NEEDED and NEEDED[name][0] not in given:
        return f"output {name!r} needs {', '.join(NEEDED[name])}"
    needed = name.removeprefix("dlength_d")
    if output.group == "gradient" and needed in _FRONT and not given & _FRONT:
        return f"output {name!r} needs {needed}: give it, 0 for instance"
    ignored = given - output.takes - {"width", *PUSH}  # each serves one output and does not affect the others
    return f"output {name!r} takes no account of {', '.join(sorted(ignored))}" if ignored else ""


def evaluate(request: Request, region: Region) -> Columns:
    """Compute the outputs of a region, in its shape; the bits of a point do not depend on the other points."""
    columns, shape = request.columns(region), shape_of(region)
    found: Columns = {}
    for name in request.outputs:
        if name in FORMULAS:
            lanes = _fields(columns, *SLIDER, "prestress")
            (found[name],) = over_lanes(_formula(name, request.right, request.sites), lanes, Layout(chunk=512))
        elif name not in found:
            found |= GROUPS[OUTPUTS[name].group](request, columns)
    return {name: found[name].astype(OUTPUTS[name].dtype, copy=False).reshape(shape) for name in request.outputs}


# --- formulas ------------------------------------------------------------------------------------------------------------


def _load(slider: Slider, prestress: Array, ends: Ends) -> Array:
    # from its prestress to its threshold, which for contact 0 is 1 whatever the gradient of thresholds
    return (1 - prestress) * jax.vmap(lambda one: lattice_modes(one, ends).load)(slider)


def _is_continuous(slider: Slider) -> Any:
    return (slider.kappa_1 < 1 / 3) & (slider.height > 10)


def _is_frozen(slider: Slider) -> Any:
    return _is_continuous(slider) & (slider.kappa_T**2 / slider.kappa**2 < 0.1)


FORMULAS: dict[str, Callable[[Slider, Array, Ends], Any]] = {
    "nucleation_load": _load,
    "length_eq25": lambda slider, *_: theory.length_eq25(slider),
    "length_eq58": lambda slider, *_: theory.length(slider),
    "length_frozen": lambda slider, *_: theory.length_frozen(slider),
    "length_continuum": lambda slider, *_: theory.length_continuum(slider),
    "length_envelope": lambda slider, *_: theory.envelope_length(slider),
    "length_macroscopic": lambda slider, prestress, _: (
        slider.height * theory.macroscopic_length(slider.b, slider.poisson, prestress=prestress)
    ),
    "runaway_prestress": lambda slider, *_: theory.runaway_prestress(slider),
    "b": lambda slider, *_: slider.b,
    "slow_decay_length": lambda slider, *_: slider.slow_decay_length,
    "is_continuous": lambda slider, *_: _is_continuous(slider),
    "is_frozen": lambda slider, *_: _is_frozen(slider),
    "is_far_from_edge": lambda slider, *_: _is_frozen(slider) & (slider.kappa * theory.length_eq25(slider) > 3),
}
"""Outputs that a formula computes from sliders, their prestress and the ends of the chain."""


@functools.cache
def _formula(name: str, right: RightEnd, sites: int | None) -> Kernel:
    """Kernel of one formula; each has a program of its own, so that no bit depends on which outputs are requested."""
    return lambda lanes: (FORMULAS[name](Slider(*lanes[:3]), lanes[3], Ends(right, sites)),)


# --- groups of outputs ---------------------------------------------------------------------------------------------------


def _by_delay(request: Request, columns: Columns, function: Callable[..., Columns]) -> Columns:
    """Evaluate ``function(slider, **options)`` for one repinning delay after another; each needs its own compiled program."""
    options: dict[str, Any] = {"ends": Ends(request.right, request.sites), "max_contacts": request.max_contacts}
    if not INTERFACE.keys() & request.parameters:
        return function(_slider(columns), **options)
    delays = columns.get("repin_delay", np.zeros(len(columns["height"]), np.int64))
    found: Columns = {}
    for delay in np.unique(delays):
        here = {name: values[delays == delay] for name, values in columns.items()}
        interface = Interface(*_fields(here, "prestress", "threshold_slope"), repin_delay=int(delay))
        for name, values in function(_slider(here), interface=interface, **options).items():
            found.setdefault(name, np.empty(delays.size, values.dtype))[delays == delay] = values
    return found


def _slider(columns: Columns) -> Slider:
    return Slider(*(columns[name] for name in SLIDER))


def _fields(columns: Columns, *names: str) -> list[np.ndarray]:
    """The columns of these parameters, zeros for those not given."""
    zeros = np.zeros(len(columns["height"]))
    return [columns.get(name, zeros) for name in names]


def _length(request: Request, columns: Columns) -> Columns:
    return _by_delay(request, columns, lambda slider, **options: {"length": bulk.lengths(slider, **options)})


def _front(request: Request, columns: Columns) -> Columns:
    found = _by_delay(request, columns, lambda slider, **options: bulk.arrests(slider, **options)._asdict())
    del found["length"]  # always from `_length`, whatever the other outputs: two ways may round differently
    return found | {"is_one_domino": found["status"] == Outcome.ARRESTED}


def _gradient(request: Request, columns: Columns) -> Columns:
    def gradients(slider: Slider, **options: Any) -> Columns:
        found = bulk.lengths(slider, derivatives=1, **options)
        numbers = vars(found.slider) | ({} if found.interface is None else vars(found.interface))
        return {f"dlength_d{name}": slope for name, slope in numbers.items() if name != "repin_delay"}

    return _by_delay(request, columns, gradients)


def _exact(_: Request, columns: Columns) -> Columns:
    length, status = exact_arrests(np.stack(_fields(columns, *SLIDER, "prestress", "threshold_slope")))
    return {"exact_length": length, "exact_status": status}


def _smooth(request: Request, columns: Columns) -> Columns:
    rule = SmoothBreak(columns["width"])
    return {"smooth_length": bulk.lengths(_slider(columns), rule=rule, max_contacts=request.max_contacts)}


def _block(request: Request, columns: Columns) -> Columns:
    columns = {"push_width": np.full(len(columns["height"]), np.nan)} | columns
    lanes = blocks.BlockNumbers(*_fields(columns, *SLIDER, "prestress", "threshold_slope", *PUSH))
    return {"block_precursor_length": blocks.lengths(lanes, request.push_control, "full")}


GROUPS: dict[str, Callable[[Request, Columns], Columns]] = {
    "length": _length,
    "front": _front,
    "gradient": _gradient,
    "exact": _exact,
    "smooth": _smooth,
    "block": _block,
}
"""Functions that compute several outputs together."""
