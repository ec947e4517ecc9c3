"""Columns of tables of measurements and of gauges, one row each.

From a row follow how the column is read and checked, the names suggested for a header, the help of the command line, the
docstrings of `Measurements` and `Gauges`, and the tables of the documentation. Loads no JAX.
"""

import dataclasses
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from textwrap import wrap
from typing import Any, NamedTuple, TypeVar, dataclass_transform, get_args
from unicodedata import normalize

import numpy as np
from numpy.typing import ArrayLike

from slippulse_jax.base.choices import ContactLaw, Control, Top
from slippulse_jax.base.domains import (
    CORRELATION_LENGTH,
    FRICTION,
    NORMAL_STIFFNESS,
    POISSON,
    PRESTRESS,
    RESIDUAL_STRENGTH,
    THRESHOLD_SLOPE,
    YOUNG,
    Domain,
    real_numbers,
)
from slippulse_jax.base.files import shortened
from slippulse_jax.inference.choices import Template

OVER_ALL = ("_N", "_N_per_m")
"""Ends of the names of columns that are of the whole width of a block, by which they are divided."""
WITH_WIDTH = ("machine_stiffness", "force", "largest_force", "normal_load")
"""Columns that have such names too."""
SI = {"N": 1.0, "N_per_mm": 1e3, "N_per_m": 1.0, "mm": 1e-3, "um": 1e-6, "MPa": 1e6, "GPa": 1e9}
"""Units in which names of columns and options end, in SI."""
UNITS_OF_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9}
UNITS_OF_MODULUS = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9}
UNITS_OF_FORCE = {"N": 1.0, "N_per_mm": 1e3}
"""Units in which columns of a table of measurements may end, in SI; a force in N is divided by the width of the block."""
PROVENANCES = ("measured", "printed", "digitised", "synthetic")
NUMBER = re.compile(r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?|inf(?:inity)?)", re.IGNORECASE | re.ASCII)
"""A number as text: `float` would take 14_03 for 1403."""
READINGS = ("slip", "stress")
"""Quantities that gauges read."""
INDENT = 4 * " "


class MeasurementError(ValueError):
    """Measurements that cannot be used; the message says where and why."""

    def __init__(self, message: str) -> None:
        super().__init__(shortened(message))


class Column(NamedTuple):
    """A column of a table, as a row of `COLUMNS`."""

    quantity: str  # that of a standard error ends in _sigma
    unit: str = ""  # in which its name usually ends in SI form
    plain: str | None = ""  # unit in the form in λc; None where the quantity does not occur there
    domain: Domain = Domain(-np.inf, np.inf, "must be finite")
    says: str = ""  # what it holds; that of a standard error follows from its quantity
    required: bool = False  # in the forms in which it occurs
    may_be_blank: bool = False
    needs: str = ""  # quantities without which it means nothing
    choices: tuple[str, ...] | None = None  # of a column of text, any text if empty; a blank cell means the first
    symbols: str = ""  # other names that authors give it; the case of single letters matters
    usual: tuple[Any, ...] = ()
    """Usual error where none is stated, in words; added to its logarithm, to ν itself; and the opposite, if that may be too.

    Heights are taken larger, ν and λc smaller, so that H/λc does not fall below one.
    """
    likely: Domain | None = None  # in SI, outside which another unit is suspected

    @property
    def value(self) -> str:
        """The quantity whose standard error this is, or the quantity itself."""
        return self.quantity.removesuffix("_sigma")

    def names(self, in_si: bool) -> dict[str, float]:
        """Names in a form, the usual one first, and their units."""
        if not in_si or not self.unit:
            return {self.quantity: 1.0} if in_si or self.plain is not None else {}
        others = next((units for units in (UNITS_OF_LENGTH, UNITS_OF_MODULUS, UNITS_OF_FORCE) if self.unit in units), {})
        return {f"{self.quantity}_{unit}": {**SI, **others}[unit] for unit in (self.unit, *others)}

    def name(self, in_si: bool) -> str:
        """Usual name in a form."""
        return next(iter(self.names(in_si)), self.quantity)

    @property
    def si(self) -> str:
        """Its unit in SI; forces are over the width of the block."""
        units = {"mm": "m", "um": "m", "GPa": "Pa", "MPa": "Pa", "N_per_mm": "N/m", "N": "N/m", "N_per_m": "Pa"}
        return units.get(self.unit, self.unit)

    @property
    def sentence(self) -> str:
        """What it holds, takes and needs, for documentation and help."""
        text = self.says or f"Standard error of `{self.value}`{'; 0: exactly known' * bool(self.domain.holds(0))}"
        text += f". Needed{' in SI' * (self.plain is None)}" * self.required
        if self.choices:
            text += f". One of {', '.join(f'`{one}`' for one in self.choices if one)}; blank: {self.choices[0] or 'unknown'}"
        text += f". Needs {' and '.join(f'`{one}`' for one in self.needs.split())}" * bool(self.needs)
        return text + ". May be blank" * (self.may_be_blank and "lank" not in text) + "."

    def likely_unit(self, value: float, name: str = "", likely: Domain | None = None) -> str:
        """Unit in which a number would be likely, if any.

        The nearest by factors of 1000. The value is in SI, by the unit in which the `name` of its column ends.
        """
        likely = likely or self.likely
        units = UNITS_OF_MODULUS if self.unit in UNITS_OF_MODULUS else UNITS_OF_LENGTH if self.unit in UNITS_OF_LENGTH else {}
        units = units or ({} if self.unit else {"per cent": 1e-2})
        own = units.get(name.rpartition("_")[2], 1.0)
        others = {unit: size / own for unit, size in units.items() if unit.isascii() and size != own}
        found = [unit for unit, size in others.items() if likely is not None and likely.holds(value * size)]
        return min(found, key=lambda unit: (unit == "cm", abs(math.log(others[unit]))), default="")


def _positive(requirement: str) -> Domain:
    return Domain(0, np.inf, requirement)


ERROR = Domain(0, np.inf, "a standard error cannot be negative", closed="low")
"""0 included: exactly known."""
ERROR_OF_READING = _positive("the standard error must be positive")
HEIGHT = Domain(1, np.inf, "the height must exceed the correlation length λc")
LENGTH = _positive("a length must be positive")
BLOCK_LENGTH = Domain(2, np.inf, "a block must be at least two correlation lengths λc long", closed="low")
PUSH_HEIGHT = _positive("the push must lie above the interface")
PUSH_WIDTH = _positive("the height of a pusher must be positive; blank where it covers everything above")
MACHINE = _positive("the stiffness of a machine must be positive")
WIDTH = _positive("the width of a block must be positive")
DISPLACEMENT = _positive("a displacement at nucleation must be positive")
VISIBLE = _positive("the least extent of an event that is noticed must be positive")
FORCE = _positive("a driving force must be positive")
EVENT = Domain(1, np.inf, "events are numbered from 1", closed="low")
POSITION = Domain(0, np.inf, "a position must be finite and not negative", closed="low")

_ROWS = (
    Column("height", "mm", "λc", HEIGHT, "Height H of the slider or block", required=True,
           symbols="H h block_height slider_height sample_height",
           usual=("H larger by 1 %", math.log(1.01)), likely=Domain(1e-3, np.inf, "below 1 mm")),
    Column("poisson", "", "", POISSON, "Poisson's ratio ν", required=True, symbols="ν nu poisson_ratio poissons_ratio",
           usual=("ν smaller by 0.02", -0.02)),
    Column("length", "mm", "λc", LENGTH, "Measured length of the precursor", required=True,
           symbols="L l Λ precursor_length front_length arrest_length",
           usual=("every length larger by 1 %", math.log(1.01), -math.log(1.01))),
    Column("length_sigma", "mm", "λc", ERROR, "Standard error of `length`; may be 0 for counts and fronts without arrest. "
           "Without it the errors are taken as equal, and their size from the scatter"),
    Column("correlation_length", "um", None, CORRELATION_LENGTH, "Correlation length λc of the interface", required=True,
           symbols="λ λc λ_c lambda lambda_c lc l_c", usual=("λc smaller by a factor 2", -math.log(2)),
           likely=Domain(1e-7, np.inf, "that of no rough interface")),
    Column("young", "GPa", None, YOUNG, "Young's modulus E, by which k/K becomes an areal stiffness k/λc² in Pa/m",
           needs="correlation_length", symbols="E young_modulus youngs_modulus elastic_modulus",
           usual=("E larger by 5 %", math.log(1.05), -math.log(1.05)), likely=Domain(0, 1.2e12, "above diamond's")),
    Column("prestress", "", "", PRESTRESS, "Known prestress φ = σ_0/σ_s, in (−1, 1)", symbols="φ phi"),
    Column("threshold_slope", "", "", THRESHOLD_SLOPE, "Known relative rise of the threshold per contact"),
    Column("residual_strength", "", "", RESIDUAL_STRENGTH, "Known share r of its strength that a contact keeps when it breaks",
           symbols="r"),
    Column("visible", "mm", "λc", VISIBLE, "Least extent of an event that would have been noticed, by the apparatus. Blank: of "
           "contacts that differ a tenth of the height, or the shortest length if that is less. Of numbered events the least "
           "advance that is listed: where it is stated no larger one lies between two numbers", may_be_blank=True,
           symbols="resolution detection_limit"),
    Column("block_length", "mm", "λc", BLOCK_LENGTH, "Length of the block from its pushed edge to its free end; blank for a "
           "block without end. A front that ran through all of it has that length and the kind `at_least`",
           may_be_blank=True, symbols="L sample_length slider_length"),
    Column("push_height", "mm", "λc", PUSH_HEIGHT, "Height of the middle of the pusher of a block over the interface; without "
           "`push_width` that of its lower end: it then covers everything above", may_be_blank=True,
           symbols="h load_height loading_height pusher_height",
           usual=("height of the push larger by 5 %", math.log(1.05), -math.log(1.05))),
    Column("push_width", "mm", "λc", PUSH_WIDTH, "Height of the pusher itself", may_be_blank=True, needs="push_height",
           symbols="pusher_height"),
    Column("friction", "", "", FRICTION, "Friction coefficient μ: thresholds follow the pressure, which the push tilts",
           needs="push_height", symbols="μ mu μ_s mu_s friction_coefficient static_friction",
           usual=("μ larger by 10 %", math.log(1.1), -math.log(1.1)),
           likely=Domain(0, 2, "that of no dry contact", closed="low")),
    Column("normal_stiffness", "", "", NORMAL_STIFFNESS, "Normal over shear stiffness, k_n/k, of the contacts of a block: 1.2 "
           "where `friction` is given, else without limit", needs="push_height"),
    Column("machine_stiffness", "N_per_m", "E", MACHINE, "Stiffness of the machine, from its own frame to the edge; as an "
           "array, over the width of the block. Blank for an edge that is held while the front runs",
           may_be_blank=True, needs="young"),
    Column("block_width", "mm", None, WIDTH, "Width of the block, by which the stiffness of the machine, and forces in N, are "
           "divided", may_be_blank=True),
    Column("height_sigma", "mm", "λc", ERROR),
    Column("block_length_sigma", "mm", "λc", ERROR, may_be_blank=True),
    Column("push_width_sigma", "mm", "λc", ERROR, may_be_blank=True),
    Column("normal_stiffness_sigma", "", "", ERROR),
    Column("machine_stiffness_sigma", "N_per_m", "E", ERROR, may_be_blank=True),
    Column("block_width_sigma", "mm", None, ERROR, may_be_blank=True),
    Column("normal_load_sigma", "N", None, ERROR),
    Column("poisson_sigma", "", "", ERROR),
    Column("correlation_length_sigma", "um", None, ERROR),
    Column("young_sigma", "GPa", None, ERROR),
    Column("push_height_sigma", "mm", "λc", ERROR, may_be_blank=True),
    Column("friction_sigma", "", "", ERROR),
    Column("displacement", "um", None, DISPLACEMENT, "Displacement of the pushed edge at nucleation", may_be_blank=True,
           needs="displacement_sigma young"),
    Column("displacement_sigma", "um", None, ERROR_OF_READING, may_be_blank=True),
    Column("force", "N_per_mm", None, FORCE, "Driving force at nucleation, per width of the block; of a block that is pushed "
           "at a height that of any event, as a sequence (docs/fit/sequence.md)", may_be_blank=True, needs="force_sigma young",
           usual=("every force larger by 1 %", math.log(1.01), -math.log(1.01))),
    Column("force_sigma", "N_per_mm", None, ERROR_OF_READING, may_be_blank=True),
    Column("largest_force", "N_per_mm", None, FORCE, "Largest force since the start of the run, up to this event and with it",
           may_be_blank=True, needs="force push_height"),
    Column("normal_load", "N", None, FORCE, "Force that presses the block on the track; per width as an array",
           needs="force push_height", usual=("F_N larger by 1 %", math.log(1.01), -math.log(1.01))),
    Column("event", "", "", EVENT, "Number of the event in its sequence, the first 1; without it `length` is a place, and "
           "`force` that at which the front first reached it", needs="force"),
    Column("kind", says="How the length was measured; `whole` counts contacts, so that the length lies within one below; past "
           "a length `at_least` the front ran without arrest", choices=("length", "whole", "at_least")),
    Column("spans", says="Whether the event broke the last contact; its length, which may be blank, is then that of the block",
           choices=("no", "yes"), needs="block_length"),
    Column("sequence", says="Any name of the run that an event belongs to, where a table has several", choices=(),
           needs="force"),
    Column("push_control", says="What is held while an event runs", choices=get_args(Control), needs="push_height"),
    Column("contact_law", says="What follows the pressure: thresholds, or thresholds and stiffnesses",
           choices=get_args(ContactLaw), needs="friction"),
    Column("top", says="Whether the top of a block may tilt", choices=get_args(Top), needs="push_height"),
    Column("provenance", says="Where the length comes from; measured contacts differ", choices=("", *PROVENANCES)),
    Column("specimen", says='Any name, to which `each="specimen"` of a parameter refers', choices=(),
           symbols="block blocks specimens sample"),
    Column("thresholds", says="Whether thresholds are new in every run, or those of the `specimen` stay as they are, so that "
           "its lengths are one draw; of a fit of contacts that differ", choices=("new", "kept"), needs="specimen"),
    Column("label", says="Name of the precursor, by which readings of gauges refer to it", choices=()),
)  # fmt: skip
_ROWS_OF_GAUGES = (
    Column("label", says="Precursor after which it was read, by its label in the table of lengths", choices=(), required=True),
    Column("position", "mm", "", POSITION, "Distance from the pushed edge", required=True),
    Column("slip", "um", "", says="How far the slider's side of the interface moved while the front ran", may_be_blank=True,
           needs="slip_sigma"),
    Column("slip_sigma", "um", "", ERROR_OF_READING, may_be_blank=True),
    Column("stress", "MPa", "", says="Shear stress on the contacts after arrest, prestress included", may_be_blank=True,
           needs="stress_sigma"),
    Column("stress_sigma", "MPa", "", ERROR_OF_READING, may_be_blank=True),
)  # fmt: skip

COLUMNS = {column.quantity: column for column in _ROWS}
OF_GAUGES = {column.quantity: column for column in _ROWS_OF_GAUGES}
EVERY = {**OF_GAUGES, **COLUMNS}
TEXTS = tuple(name for name, column in COLUMNS.items() if column.choices is not None)
"""Columns of text."""
NUMERIC = tuple(name for name in COLUMNS if name not in TEXTS)
"""Columns of numbers that `Measurements` holds."""
IN_LC = tuple(name for name, column in COLUMNS.items() if column.plain == "λc")
"""Columns held in λc."""
GAUGE_COLUMNS = ("row", *(name for name in OF_GAUGES if name != "label"))
"""Columns that `Gauges` holds."""


def documented(names: Iterable[str]) -> str:
    """Describe the columns among fields as parameters in a docstring."""
    lines = []
    for column in (EVERY[name] for name in names if name in EVERY):
        kind = "sequence of str" if column.choices is not None else "array_like"
        unit = "λc" if column.plain == "λc" else column.si + "; without `young` in E" * (column.plain == "E")
        lines += [f"{column.quantity} : {kind}" + ", optional" * (not column.required or column.plain is None)]
        lines += wrap(column.sentence + f" In {unit}." * bool(unit), 120, initial_indent=INDENT, subsequent_indent=INDENT)
    return f"\n{INDENT}".join(lines)


Named = dict[str, tuple[Column, float]]
"""By name in a table: the column, and the unit of its numbers in SI."""

NAMES: dict[bool, Named] = {
    in_si: {name: (one, size) for one in _ROWS for name, size in one.names(in_si).items()} for in_si in (True, False)
}
"""In SI form, and in the form in λc."""
_MICRO = str.maketrans("µμ", "uu")
_NAMES_OF_GAUGES: Named = {
    name: (one, size)
    for one in _ROWS_OF_GAUGES
    for name, size in one.names(True).items()
    if name.translate(_MICRO) == one.name(True)
}
_IN_SI = {**_NAMES_OF_GAUGES, **NAMES[True]}
KNOWN = {*_IN_SI, *EVERY}
"""All names, also those of readings of gauges and those that stand without the unit that they need."""

_LENGTHS = {"specimen": "A", "height": "25", "correlation_length": "100", "poisson": "0.3", "young": "3", "length": "14.03"}
_LENGTHS |= {"length_sigma": "0.5", "kind": "length", "provenance": "measured"}
_EVENTS = {"height": "30", "block_length": "90", "block_width": "10", "correlation_length": "625", "poisson": "0.3"}
_EVENTS |= {"young": "3", "push_height": "4.5", "push_width": "3", "normal_load": "1000", "sequence": "A", "event": "1 2 3"}
_EVENTS |= {"force_N": "160.4 201.8 176.6", "force_sigma_N": "1.6 2 1.8", "length": "10.22 47.63 90"}
_EVENTS |= {"length_sigma": "0.3 1.49 0", "spans": "no no yes", "provenance": "measured"}
_EXAMPLES: dict[Template, dict[str, str]] = {
    "slider": _LENGTHS,
    "block": _LENGTHS | {"block_length": "75", "push_height": "5", "push_width": "2", "friction": "0.3"},
    "sequence": _EVENTS,
}
"""Cells by column, one a line; a single one is that of every line."""


def template(kind: Template) -> str:
    """Write a table to fill in, with an example."""
    cells = {name if name in NAMES[True] else COLUMNS[name].name(in_si=True): x for name, x in _EXAMPLES[kind].items()}
    example = {name: every.split() for name, every in cells.items()}
    choices = {name: NAMES[True][name][0].choices for name in example}
    one = "event" if kind == "sequence" else "precursor"
    lines = [f"# Replace the example by your own, one {one} per line. Leave out the columns that you do not know."]
    lines += [f"# {name}: {', '.join(filter(None, every))}" for name, every in choices.items() if every]
    rows = [[x[i % len(x)] for x in example.values()] for i in range(max(map(len, example.values())))]
    return "\n".join((*lines, ",".join(example), *map(",".join, rows), ""))


def named(header: Sequence[str], where: str) -> Named:
    """Find the columns of measurements that a header names."""
    si, plain = ([own for own in header if own in NAMES[form] and own not in NAMES[not form]] for form in (True, False))
    if si and plain:
        raise MeasurementError(f"{where}: columns of both forms, {si[0]} and {plain[0]}: choose one")
    names = NAMES[bool(si)]
    _refuse_repeated(header, names, where)
    known = {own: names[own] for own in header if own in names}
    there = {column.quantity for column, _ in known.values()}
    _refuse_misnamed([own for own in header if own not in names], there, bool(si), bool(plain), where)
    in_si = bool(si) or (not plain and any(_UNIT.search(_BETWEEN.sub("_", own).strip("_")) for own in header))
    wanted = {form: {one.quantity: one.name(form) for one in _ROWS if one.required and one.names(form)} for form in NAMES}
    missing = [name for quantity, name in wanted[in_si].items() if quantity not in there]
    if missing:
        expected = " or ".join(", ".join(wanted[form].values()) for form in NAMES if form == in_si or not (in_si or plain))
        expected = f"the columns {expected}"
        if missing == ["correlation_length_um"]:
            expected = "a guess where λc is not known, such as 10, with correlation_length_sigma_um (docs/fit/own_csv.md)"
        raise MeasurementError(f"{where}: no column {', '.join(missing)} among {', '.join(header)}; expected {expected}")
    whole = [own for own in known if own.endswith(OVER_ALL)]
    of_width = [own for own, (column, _) in known.items() if column.value == "block_width"]
    if si and bool(whole) != bool(of_width):
        missed = COLUMNS["block_width"].name(in_si=True) if whole else "machine_stiffness_N_per_m, or forces in N"
        raise MeasurementError(
            f"{where}, column {(whole + of_width)[0]}: needs the column {missed}: the model is one of a unit width"
        )
    return known


def named_of_gauges(header: Sequence[str], where: str) -> Named:
    """Find the columns of gauges that a header names; refuse others."""
    known = {own: _NAMES_OF_GAUGES[own] for own in header if own in _NAMES_OF_GAUGES}
    there = {column.quantity for column, _ in known.values()}
    if len(header) != len(there) or any(one.required and one.quantity not in there for one in _ROWS_OF_GAUGES):
        needed, others = (
            ", ".join(one.name(in_si=True) for one in _ROWS_OF_GAUGES if one.required is required) for required in (True, False)
        )
        raise MeasurementError(f"{where}: columns {', '.join(header)}; expected {needed}, and {others} as measured, each once")
    return known


def with_units(header: Sequence[str], row: Sequence[str], where: str) -> list[str] | None:
    """Join units in the row below a header to its names."""
    units = [cell.translate(_MICRO).strip("[]() ").replace("/", "_per_") for cell in row]
    if not any(unit in _SIZES for unit in units) or any(re.match(r"[+-]?\.?\d", unit) for unit in units if unit != "1"):
        return None
    names = []
    for own, unit in zip(header, units, strict=False):
        column, size = _IN_SI.get(own, (EVERY.get(own), None))
        stated = column is not None and own != column.quantity
        silent = unit in ("", "-", "–", "1") or (unit not in _SIZES if column is None else column.choices is not None)
        if not silent and (unit not in _SIZES or (stated and _SIZES[unit] != size)):
            need = "its name has another unit" if stated else f"one of {', '.join(_SIZES)} is needed"
            raise MeasurementError(f"{where}, column {own}: {unit!r}: {need}")
        names.append(own if silent or stated or unit == "λc" else f"{own}_{unit}")
    return names


def _refuse_repeated(header: Sequence[str], names: Named, where: str) -> None:
    """Refuse a column that is there twice, or in two units."""
    columns = [names[own][0] if own in names else own for own in header]
    for column, count in Counter(columns).items():
        twice = [own for own, one in zip(header, columns, strict=True) if one == column] if count > 1 else []
        if len(set(twice)) > 1:
            raise MeasurementError(f"{where}, columns {' and '.join(twice)}: one quantity in two units")
        if twice:
            raise MeasurementError(f"{where}, column {twice[0] or '(no name)'}: there {count} times")


_ERROR = re.compile(r"(?:^|_)(?:sigma|σ|error|err|std|sd|stderr|uncertainty)(?=_|$)", re.IGNORECASE)
_BETWEEN = re.compile(r"[\s()\[\]{}/.,:-]+")
_SIZES = {unit: size for unit, size in (UNITS_OF_LENGTH | UNITS_OF_MODULUS | SI).items() if unit.isascii()} | {"λc": math.nan}
_READ = {unit.casefold(): unit for unit in (*UNITS_OF_LENGTH, *UNITS_OF_MODULUS) if unit in _SIZES} | {"μm": "um"}
_OTHER = "in|inch|ft|dm|km|psi|kgf?|gf?|lbf?|[kMmu]?N(?:_per_[cm]?m)?"
_UNIT = re.compile(rf"(?:_in)?(?:^|_)({'|'.join(_READ)}|{_OTHER})$", re.IGNORECASE)
"""Units in which a name may end, also those that are not read."""


def _refuse_misnamed(unknown: Sequence[str], there: Container[str], si: bool, plain: bool, where: str) -> None:
    """Refuse misnamed columns of quantities that the table lacks, with the name.

    The first 50 unknown names of at most 60 characters are looked at.

    A known name in other case, or a symbol or word of authors, is always refused. A name that is only like a known one is
    refused if it has a unit, or if the known one is required.
    """
    guesses = {own: _meant(own) for own in unknown[:50] if len(own) <= 60}
    si = si or (not plain and any(unit for _, unit, _ in guesses.values()))
    said = []
    for own, (columns, unit, sure) in guesses.items():
        lacking = [one for one in columns if one.quantity not in there and one.names(si)]
        required = any(one.required for one in lacking)
        if lacking and (sure or unit or required):
            units = [unit] if "_per_" in unit else [unit, "N"]  # a force of all the width
            names = [next((x for end in units if (x := f"{one.quantity}_{end}") in NAMES[si]), one.name(si)) for one in lacking]
            known = " or ".join(names)
            remark = "" if required else " If not, give it another name."
            if own.casefold() in (name.casefold() for name in names):
                remark = " Upper and lower case count"
            read = not unit or any(name.casefold().endswith(f"_{unit.casefold()}") for name in names)
            converted = f"numbers in {unit} are not read: convert them, for {known}."
            said.append(f"{own}: " + (f"did you mean {known}?{remark}" if read else converted))
    if said:
        raise MeasurementError(f"{where}, column {' Column '.join(said)}")


def _meant(own: str) -> tuple[list[Column], str, bool]:
    """Columns that a name may mean, its unit, and whether certainly."""
    whole = _BETWEEN.sub("_", normalize("NFKC", own).replace("'", "")).strip("_")
    word = _ERROR.sub("", whole).strip("_")
    error = word != whole
    wanted = [column for column in _ROWS if (column.value != column.quantity) == error]
    ending, unit = _UNIT.search(word), ""
    if ending and (ending.start() > 0 or error):
        word, unit = word[: ending.start()], _READ.get(ending[1].casefold(), ending[1])
    if error and not word:  # σ by itself
        word = "length"
    symbol = word if len(word) == 1 else word.casefold()
    found = [column for column in wanted if symbol in (column.value, *COLUMNS[column.value].symbols.split())]
    if found or len(word) < 4:
        return found, unit, bool(found)
    alike = get_close_matches(symbol, [column.value for column in wanted if column.value[0] == symbol[0]], n=1, cutoff=0.8)
    return [column for column in wanted if column.value in alike], unit, False


T = TypeVar("T")


def converted(*, converter: Callable[[Any], Any], **default: Any) -> Any:
    """Field of a table that holds what `converter` makes of an argument."""
    return dataclasses.field(metadata={"converter": converter}, **default)


@dataclass_transform(field_specifiers=(converted, dataclasses.field), frozen_default=True, eq_default=False)
def table(cls: type[T]) -> type[T]:
    """Make a frozen dataclass, and describe its columns in its docstring."""
    cls.__doc__ = (cls.__doc__ or "").replace("{columns}", documented(cls.__annotations__))
    return dataclasses.dataclass(frozen=True, eq=False)(cls)


def numbers(x: ArrayLike, name: str = "", unit: str = "") -> np.ndarray:
    """Convert to a column: quantities to a unit, blanks to NaN."""
    return np.atleast_1d(real_numbers(name, x, unit, _cell))


def _cell(one: Any) -> float:
    if isinstance(one, bool | np.bool | bytes) or (isinstance(one, str) and not NUMBER.fullmatch(one)):
        raise TypeError(f"{one!r} is not a number")
    return math.nan if one is None else float(one)


def numbers_or_none(x: ArrayLike | None, name: str = "", unit: str = "") -> np.ndarray | None:
    """Convert numbers, if they are given."""
    return None if x is None else numbers(x, name, unit)


def entries(x: Sequence[T]) -> tuple[T, ...]:
    """Convert to a tuple."""
    return tuple(x)


def convert(one: Any) -> list[str]:
    """Convert the fields of a table; return the columns of numbers given.

    One number, or one text, is repeated.
    """
    given, alike, n, first = [], {}, 1, ""
    for field in (field for field in dataclasses.fields(one) if "converter" in field.metadata):
        where, converter = f"{one.source}, column {field.name}", field.metadata["converter"]
        unit = "" if field.name not in EVERY or field.name in IN_LC else EVERY[field.name].si
        try:
            value = converter(getattr(one, field.name), *(() if converter is entries else ("", unit)))
        except (TypeError, ValueError) as error:
            needed = "a sequence" if converter is entries else "numbers"
            raise MeasurementError(f"{where}: must be {needed} ({error})") from None
        if converter is entries and isinstance(getattr(one, field.name), str):
            alike[field.name] = getattr(one, field.name)
        object.__setattr__(one, field.name, value)
        if not isinstance(value, np.ndarray):
            continue
        given.append(field.name)
        if value.ndim != 1 or value.size == 0:
            raise MeasurementError(f"{where}: must be a non-empty one-dimensional column")
        if value.size > 1 and first and value.size != n:
            raise MeasurementError(f"{where}: {value.size} entries, where {first} has {n}")
        if value.size > 1 and not first:
            n, first = value.size, field.name
    for name in given:
        object.__setattr__(one, name, np.array(np.broadcast_to(getattr(one, name), n)))
    for name, text in alike.items():
        object.__setattr__(one, name, (text,) * n)
    return given


def check_needs(given: Collection[str], columns: Mapping[str, str], source: str) -> None:
    """Refuse quantities without one they need, by names in the file."""
    for name in given:
        column = EVERY[name]
        for needed in (column.value, *column.needs.split()):
            of_si_only = EVERY[needed].plain is None and column.plain is not None
            if needed not in given and not (of_si_only and "correlation_length" not in given):
                own = columns.get(name, name)
                missed = needed if own == name else EVERY[needed].name(in_si=True)
                missed = alike if (alike := own.replace(name, needed)) in _IN_SI else missed
                raise MeasurementError(f"{source}: {own} is given without {missed}")


Fault = tuple[str, Any, str]
"""A quantity, in which rows it breaks a rule, and the rule."""


def check_rows(
    values: Mapping[str, Any],
    place: Callable[[int], str],
    columns: Mapping[str, str] | None = None,
    cells: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """Check columns, in the units of `Measurements`, row by row.

    The message names the first row that breaks a rule, by `place`; `columns` has the names in the file by quantity, and `cells`
    the text by these names.
    """
    with np.errstate(all="ignore"):
        faults = [(int(np.argmax(bad)), name, rule) for name, bad, rule in _faults(values) if np.any(bad)]
    if not faults:
        return
    i, name, rule = min(faults, key=lambda fault: fault[0])
    own, value = (columns or {}).get(name, name), values[name][i]
    text = repr(value) if isinstance(value, str) else f"{value:g}" + " λc" * (name in IN_LC)
    text = cells[own][i] if cells else text
    unit = "" if isinstance(value, str) else _other_units(name, i, values, columns or {})
    raise MeasurementError(f"{place(i)}, column {own}: {text}{': ' * bool(text)}{rule}{unit}")


def _faults(values: Mapping[str, Any]) -> Iterator[Fault]:
    """Rules and the rows that break them, that of λc first."""
    for name, x in sorted(values.items(), key=lambda item: item[0] != "correlation_length"):
        column = EVERY[name]
        if column.choices is None:
            blank = np.isnan(x) & column.may_be_blank
            yield name, blank & ~np.isnan(values.get(column.value, x)), "missing: the value beside it has no standard error"
            yield name, ~blank & ~np.isfinite(x), "must be finite" + "; blank where there is none" * column.may_be_blank
            yield name, np.isfinite(x) & ~column.domain.holds(x), column.domain.requirement
        elif column.choices:
            yield name, [text not in column.choices for text in x], f"one of {', '.join(filter(None, column.choices))}"
        elif name == "sequence" and any(x):
            yield name, [not text for text in x], "missing: name the run of every event, or of none"
    if "event" in values:
        yield "event", values["event"] % 1 != 0, "events are numbered by whole numbers"
    if "length" in values:
        yield from _faults_of_length(values)
        yield from _faults_of_push(values)
    if "largest_force" in values:
        less = values["largest_force"] < values.get("force", 0.0) * (1 - 1e-9)
        yield "largest_force", less, "less than the force of this event, which is one of those up to it"
    if "block_width" in values:
        divided = [~np.isnan(x) for name, x in values.items() if name in WITH_WIDTH]
        missing = np.isnan(values["block_width"]) & np.any(divided, axis=0)
        yield "block_width", missing, "missing value: machine_stiffness_N_per_m and forces in N are divided by it"


def _faults_of_length(values: Mapping[str, Any]) -> Iterator[Fault]:
    """Rules of a length and its error, by how it was measured."""
    length, kind, sigma = values["length"], np.array(values["kind"]), values.get("length_sigma", 1.0)
    broken = (kind == "whole") & (abs(length - np.round(length)) > 1e-9 * length)
    yield "length", broken, "a count of whole contacts must be a whole number of λc"
    beyond = length > values.get("block_length", np.inf) * (1 + 1e-9)
    yield "length", beyond, "longer than the block; of a front that ran through it, the block's length as kind at_least"
    yield "length_sigma", (kind == "length") & (sigma == 0), "the standard error of a length must be positive"
    yield "length_sigma", (sigma > 0) & (sigma < 1e-9 * length), "below a billionth of the length, which nothing measures"


def _faults_of_push(values: Mapping[str, Any]) -> Iterator[Fault]:
    """Rules by which the pusher lies on the side of the block."""
    height, none = values["height"], np.full_like(values["height"], np.nan)
    at, width = values.get("push_height", none), values.get("push_width", none)
    yield "push_height", at >= height, "not below the height of the block"
    yield "push_width", width >= height, "not less than the height of the block"
    yield "push_width", np.isnan(at) & ~np.isnan(width), "needs the height of its middle, which is missing"
    yield "push_width", (at - width / 2 <= 0) | (at + width / 2 >= height), "reaches beyond the side of the block"


def _other_units(name: str, i: int, values: Mapping[str, Any], columns: Mapping[str, str]) -> str:
    """Ask for the likely unit of a number outside its domain."""
    asked = [(name, values[name][i], EVERY[name].likely)]
    if name == "height" and "correlation_length" in columns:  # one of two is in another unit
        contact = values["correlation_length"][i]
        height = values["height"][i] * contact
        low, high = Domain(max(contact, 1e-3), np.inf, ""), Domain(1e-7, height, "")
        asked = [("height", height, low), ("correlation_length", contact, high)]
    named = [(columns.get(one, one), EVERY[one].likely_unit(x, columns.get(one, one), likely)) for one, x, likely in asked]
    guesses = [f"{own} in {unit}" for own, unit in named if unit]
    return f": is {', or '.join(guesses)}?" * bool(guesses)
