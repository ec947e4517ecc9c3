"""What a sweep can compute at each point, and how: a table, and one function a group of outputs."""

import functools
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from slippulse_jax import theory
from slippulse_jax.bulk.threads import spread
from slippulse_jax.interface import Interface
from slippulse_jax.lattice import lengths as bulk
from slippulse_jax.lattice.exact_lanes import EXACT_OUTCOMES, exact_fronts
from slippulse_jax.lattice.front import FRONT_OUTCOMES
from slippulse_jax.lattice.modes import RightEnd, lattice_modes
from slippulse_jax.rules import SmoothBreak
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome, Status
from slippulse_jax.sweeps.request import Columns, Request

BLOCK = 512
"""Points a call of a compiled function that is not chunked by itself."""


class Output(NamedTuple):
    """One output: what it is, and which group computes it."""

    long_name: str
    unit: str
    group: str
    takes: frozenset[str] = frozenset()  # parameters beyond the slider's that it takes into account
    dtype: str = "float64"
    status: Iterable[Status] | None = None  # whose members its values are
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
    "exact_status": Output("what the exact front stress says", "1", "exact", _EXACT, "int8", EXACT_OUTCOMES),
    "smooth_length": Output("length under the smooth break rule", "lambda_c", "smooth", frozenset({"width"})),
    "length_eq25": Output("length by the paper's Eq. (25)", "lambda_c", "theory"),
    "length_eq58": Output("length by Eq. (58), corrected", "lambda_c", "theory"),
    "length_frozen": Output("length in the continuum with the upper layer frozen (Appendix)", "lambda_c", "theory"),
    "length_continuum": Output("length in the self-consistent continuum", "lambda_c", "theory"),
    "length_envelope": Output("length by a closed formula", "lambda_c", "theory"),
    "length_macroscopic": Output(
        "length by the macroscopic law (lambda_c -> 0)", "lambda_c", "macroscopic", frozenset({"prestress"})
    ),
    "runaway_prestress": Output("prestress beyond which nothing far from the edge stops a front", "sigma_s", "theory", _FRONT),
    "is_one_domino": Output(
        "the event is one domino from the edge", "1", "front", _FRONT, "int8",
        comment="1 where at least two contacts broke, the front arrested, and no contact behind it came back to its threshold",
    ),
    "is_continuous": Output(
        "the continuum applies", "1", "validity", dtype="int8", comment=_FLAG + "kappa_1 lambda_c < 1/3 and H/lambda_c > 10"
    ),
    "is_frozen": Output(
        "the frozen upper layer applies", "1", "validity", dtype="int8",
        comment=_FLAG + "those of is_continuous, and kappa_T^2/kappa^2 < 0.1",
    ),
    "is_far_from_edge": Output(
        "Eq. (25) applies", "1", "validity", dtype="int8", comment=_FLAG + "those of is_frozen, and kappa times this length > 3"
    ),
}  # fmt: skip
"""Every output, by name."""

SETS = {
    "gradients": tuple(name for name, output in OUTPUTS.items() if output.group == "gradient"),
    "theory": tuple(name for name, output in OUTPUTS.items() if output.group in ("theory", "macroscopic")),
    "validity": ("is_one_domino", "is_continuous", "is_frozen", "is_far_from_edge"),
}
"""Names that stand for several outputs; those that the request does not allow are left out."""


def choose(asked: Any, parameters: set[str]) -> tuple[str, ...]:
    """Names of outputs, sets resolved, each once, in the order asked for.

    Raises
    ------
    ValueError
        For a name that is none, or an output that takes no account of a parameter that was given.
    """
    beyond = parameters - {"height", "stiffness", "poisson"}
    chosen: dict[str, None] = {}
    for name in (asked,) if isinstance(asked, str) else tuple(asked):
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
    return tuple(chosen)


def _objection(name: str, given: set[str]) -> str:
    output = OUTPUTS[name]
    if name == "smooth_length" and "width" not in given:
        return "output 'smooth_length' needs width, that of the smooth break rule"
    needed = name.removeprefix("dlength_d")
    if output.group == "gradient" and needed in _FRONT and not given & _FRONT:
        return f"output {name!r} needs {needed}: give it, 0 for instance"
    # the width belongs to one output and does not disturb the others
    ignored = given - output.takes - {"width"}
    return f"output {name!r} takes no account of {', '.join(sorted(ignored))}" if ignored else ""


def evaluate(request: Request, start: int, stop: int) -> Columns:
    """Outputs of points `start` to `stop`. The bits of a point do not depend on which points are computed with it."""
    columns = request.columns(start, stop)
    found: Columns = {}
    for group in dict.fromkeys(OUTPUTS[name].group for name in request.outputs):
        found |= _GROUPS[group](request, columns)
    return {name: np.asarray(found[name]).astype(OUTPUTS[name].dtype, copy=False) for name in request.outputs}


def _by_delay(request: Request, columns: Columns, function: Callable[..., Columns]) -> Columns:
    """``function(slider, **options)`` on all points of one repinning delay at a time: it is compiled in."""
    options: dict[str, Any] = {"right": request.right, "sites": request.sites, "max_contacts": request.max_contacts}
    if not request.has_interface:
        return function(_slider(columns), **options)
    n = len(columns["height"])
    delays = columns.get("repin_delay", np.zeros(n, np.int64))
    found: Columns = {}
    for delay in np.unique(delays):
        here = delays == delay
        prestress, slope = (columns.get(name, np.zeros(n))[here] for name in ("prestress", "threshold_slope"))
        interface = Interface(prestress, slope, int(delay))
        part = function(_slider({name: values[here] for name, values in columns.items()}), interface=interface, **options)
        for name, values in part.items():
            found.setdefault(name, np.empty(n, values.dtype))[here] = values
    return found


def _slider(columns: Columns) -> Slider:
    return Slider(columns["height"], columns["stiffness"], columns["poisson"])


def _length(request: Request, columns: Columns) -> Columns:
    return _by_delay(request, columns, lambda slider, **options: {"length": bulk.lengths(slider, **options)})


def _front(request: Request, columns: Columns) -> Columns:
    found = _by_delay(request, columns, lambda slider, **options: bulk.precursor_arrests(slider, **options)._asdict())
    del found["length"]  # the same number, rounded otherwise: whatever else is asked for, `_length` gives it
    return found | {"is_one_domino": found["status"] == Outcome.ARRESTED}


def _gradient(request: Request, columns: Columns) -> Columns:
    def gradients(slider: Slider, **options: Any) -> Columns:
        found = bulk.length_gradients(slider, **options)._asdict()
        return {f"dlength_d{name}": values for name, values in found.items() if values is not None and name != "length"}

    return _by_delay(request, columns, gradients)


def _load(request: Request, columns: Columns) -> Columns:
    return _in_blocks(_load_of(request.right, request.sites), columns, "height", "stiffness", "poisson", "prestress")


@functools.cache
def _load_of(right: RightEnd, sites: int | None) -> Callable[..., Any]:
    def one(height: Any, stiffness: Any, poisson: Any, prestress: Any) -> Any:
        # contact 0 has to be brought from its prestress to its threshold, which the gradient of thresholds leaves at 1
        return {"nucleation_load": (1 - prestress) * lattice_modes(Slider(height, stiffness, poisson), right, sites).load}

    return jax.jit(jax.vmap(one))


def _exact(_: Request, columns: Columns) -> Columns:
    names, relaxed = ("height", "stiffness", "poisson", "prestress", "threshold_slope"), np.zeros_like(columns["height"])
    length, status = exact_fronts(np.stack([columns.get(name, relaxed) for name in names]))
    return {"exact_length": length, "exact_status": status}


def _smooth(request: Request, columns: Columns) -> Columns:
    rule = SmoothBreak(columns["width"])
    return {"smooth_length": bulk.lengths(_slider(columns), rule=rule, max_contacts=request.max_contacts)}


_THEORY = {
    "length_eq25": theory.length_eq25,
    "length_eq58": theory.length,
    "length_frozen": theory.length_frozen,
    "length_continuum": theory.length_continuum,
    "length_envelope": theory.envelope_length,
    "runaway_prestress": theory.runaway_prestress,
}


def _theory(request: Request, columns: Columns) -> Columns:
    chosen = {name: function for name, function in _THEORY.items() if name in request.outputs}

    def levels(height: Any, stiffness: Any, poisson: Any) -> Columns:
        slider = Slider(height, stiffness, poisson)
        return {name: function(slider) for name, function in chosen.items()}

    return _in_blocks(levels, columns, "height", "stiffness", "poisson")


def _macroscopic(_: Request, columns: Columns) -> Columns:
    def law(height: Any, stiffness: Any, poisson: Any, prestress: Any) -> Columns:
        b = np.asarray(Slider(height, stiffness, poisson).b)
        return {"length_macroscopic": height * np.asarray(theory.macroscopic_length(b, poisson, prestress=prestress))}

    return _in_blocks(law, columns, "height", "stiffness", "poisson", "prestress")


def _validity(_: Request, columns: Columns) -> Columns:
    return _in_blocks(_conditions, columns, "height", "stiffness", "poisson")


@jax.jit
def _conditions(height: Any, stiffness: Any, poisson: Any) -> Any:
    slider = Slider(height, stiffness, poisson)
    continuous = (slider.kappa_1 < 1 / 3) & (height > 10)
    frozen = continuous & (slider.kappa_T**2 / slider.kappa**2 < 0.1)
    far = frozen & (slider.kappa * theory.length_eq25(slider) > 3)
    return {"is_continuous": continuous, "is_frozen": frozen, "is_far_from_edge": far}


_GROUPS = {
    "length": _length,
    "front": _front,
    "load": _load,
    "gradient": _gradient,
    "exact": _exact,
    "smooth": _smooth,
    "theory": _theory,
    "macroscopic": _macroscopic,
    "validity": _validity,
}


def _in_blocks(function: Callable[..., Any], columns: Columns, *names: str) -> Columns:
    """Columns of ``function(*parameters)``, called on blocks of one size: one program, the same bits in any company."""
    n = len(columns["height"])
    given = [np.asarray(columns.get(name, np.zeros(n)), np.float64) for name in names]
    found: Columns = {}

    def run(start: int) -> dict[str, np.ndarray]:
        index = np.arange(start, min(start + BLOCK, n))
        block = function(*(values[np.resize(index, BLOCK)] for values in given))
        return {name: np.asarray(values)[: len(index)] for name, values in block.items()}

    def fill(start: int) -> None:
        for name, values in run(start).items():
            found[name][start : start + len(values)] = values

    with jax.enable_x64(True):
        found |= {name: np.empty(n, values.dtype) for name, values in run(0).items()}
    spread(fill, range(0, n, BLOCK))
    return found
