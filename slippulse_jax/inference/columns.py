"""Columns of tables of measurements and of gauges: one row for each, from which all else about it follows.

Reading a table, the checks of its numbers, and the suggestion of a name that a header may have meant.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Container, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, NamedTuple, get_args
from unicodedata import normalize

import numpy as np

from slippulse_jax.block import ContactLaw, Control, Top
from slippulse_jax.domains import (
    CORRELATION_LENGTH,
    FRICTION,
    NORMAL_STIFFNESS,
    POISSON,
    PRESTRESS,
    THRESHOLD_SLOPE,
    YOUNG,
    Domain,
)
from slippulse_jax.files import shortened
from slippulse_jax.inference.choices import Body
from slippulse_jax.units import SI, UNITS_OF_LENGTH, UNITS_OF_MODULUS

KINDS = ("length", "whole", "at_least")
"""Kind of a measurement: a length with a standard error; a count of whole contacts; a length the front ran past (censored)."""
PROVENANCES = ("measured", "printed", "digitised", "synthetic")
NUMBER = re.compile(r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?|inf(?:inity)?)", re.IGNORECASE | re.ASCII)
"""A number as text: `float` would take 14_03 for 1403."""
READINGS = ("slip", "stress")
"""Quantities that gauges read."""


class MeasurementError(ValueError):
    """Measurements that cannot be used; the message says where and why."""

    def __init__(self, message: str) -> None:
        super().__init__(shortened(message))


class Column(NamedTuple):
    """A column of a table, as a row of the table of columns."""

    quantity: str  # that of a standard error ends in _sigma
    unit: str = ""  # in which its name usually ends in SI form
    plain: str | None = ""  # unit in the form in λc; None where the quantity does not occur there
    domain: Domain = Domain(-np.inf, np.inf, "must be finite")
    required: bool = False  # in the forms in which it occurs
    may_be_blank: bool = False
    needs: str = ""  # quantities without which it means nothing
    choices: tuple[str, ...] | None = None  # of a column of text, any text if empty; a blank cell means the first
    symbols: str = ""  # other names that authors give it; the case of single letters matters
    usual: tuple[Any, ...] = ()
    """Usual error where none is stated, in words; added to its logarithm, to ν itself; and the opposite, if that may be too.

    Heights are taken larger, ν and λc smaller, so that H/λc does not fall below one.
    """

    @property
    def value(self) -> str:
        """The quantity whose standard error this is, or the quantity itself."""
        return self.quantity.removesuffix("_sigma")

    def names(self, in_si: bool) -> dict[str, float]:
        """Names in a form, the usual one first, and the unit in SI that each ends in; none where it does not occur."""
        if not in_si or not self.unit:
            return {self.quantity: 1.0} if in_si or self.plain is not None else {}
        others = next((units for units in (UNITS_OF_LENGTH, UNITS_OF_MODULUS) if self.unit in units), {})
        return {f"{self.quantity}_{unit}": {**SI, **others}[unit] for unit in (self.unit, *others)}

    def name(self, in_si: bool) -> str:
        """Usual name in a form."""
        return next(iter(self.names(in_si)), self.quantity)


def _positive(requirement: str) -> Domain:
    return Domain(0, np.inf, requirement)


ERROR = Domain(-1e-300, np.inf, "a standard error cannot be negative")
"""0 included: exactly known."""
ERROR_OF_READING = _positive("the standard error must be positive")
HEIGHT = Domain(1, np.inf, "the height must exceed the correlation length λc")
LENGTH = _positive("a length must be positive")
BLOCK_LENGTH = Domain(np.nextafter(2, 0), np.inf, "a block must be at least two correlation lengths λc long")
PUSH_HEIGHT = _positive("the push must lie above the interface")
PUSH_WIDTH = _positive("the height of a pusher must be positive; blank where it covers everything above")
MACHINE = _positive("the stiffness of a machine must be positive")
WIDTH = _positive("the width of a block must be positive")
DISPLACEMENT = _positive("a displacement at nucleation must be positive")
FORCE = _positive("a driving force must be positive")
POSITION = Domain(-1e-300, np.inf, "a position must be finite and not negative")

_ROWS = (
    Column("height", "mm", "λc", HEIGHT, required=True, symbols="H h block_height slider_height sample_height",
           usual=("H larger by 1 %", math.log(1.01))),
    Column("poisson", "", "", POISSON, required=True, symbols="ν nu poisson_ratio poissons_ratio",
           usual=("ν smaller by 0.02", -0.02)),
    Column("length", "mm", "λc", LENGTH, required=True, symbols="L l Λ precursor_length front_length arrest_length",
           usual=("every length larger by 1 %", math.log(1.01), -math.log(1.01))),
    Column("length_sigma", "mm", "λc", ERROR),
    Column("correlation_length", "um", None, CORRELATION_LENGTH, required=True, symbols="λ λc λ_c lambda lambda_c lc l_c",
           usual=("λc smaller by a factor 2", -math.log(2))),
    Column("young", "GPa", None, YOUNG, needs="correlation_length", symbols="E young_modulus youngs_modulus elastic_modulus",
           usual=("E larger by 5 %", math.log(1.05), -math.log(1.05))),
    Column("prestress", "", "", PRESTRESS, symbols="φ phi"),
    Column("threshold_slope", "", "", THRESHOLD_SLOPE),
    Column("block_length", "mm", "λc", BLOCK_LENGTH, may_be_blank=True, symbols="L sample_length slider_length"),
    Column("push_height", "mm", "λc", PUSH_HEIGHT, may_be_blank=True, symbols="h load_height loading_height pusher_height",
           usual=("height of the push larger by 5 %", math.log(1.05), -math.log(1.05))),
    Column("push_width", "mm", "λc", PUSH_WIDTH, may_be_blank=True, needs="push_height", symbols="pusher_height"),
    Column("friction", "", "", FRICTION, needs="push_height", symbols="μ mu μ_s mu_s friction_coefficient static_friction",
           usual=("μ larger by 10 %", math.log(1.1), -math.log(1.1))),
    Column("normal_stiffness", "", "", NORMAL_STIFFNESS, needs="push_height"),
    Column("machine_stiffness", "N_per_m", "E", MACHINE, may_be_blank=True, needs="young"),
    Column("block_width", "mm", None, WIDTH, may_be_blank=True),  # by which the stiffness of the machine is divided
    Column("height_sigma", "mm", "λc", ERROR),
    Column("poisson_sigma", "", "", ERROR),
    Column("correlation_length_sigma", "um", None, ERROR),
    Column("young_sigma", "GPa", None, ERROR),
    Column("push_height_sigma", "mm", "λc", ERROR, may_be_blank=True),
    Column("friction_sigma", "", "", ERROR),
    Column("displacement", "um", None, DISPLACEMENT, may_be_blank=True, needs="displacement_sigma young"),
    Column("displacement_sigma", "um", None, ERROR_OF_READING, may_be_blank=True),
    Column("force", "N_per_mm", None, FORCE, may_be_blank=True, needs="force_sigma young"),
    Column("force_sigma", "N_per_mm", None, ERROR_OF_READING, may_be_blank=True),
    Column("kind", choices=KINDS),
    Column("push_control", choices=get_args(Control), needs="push_height"),
    Column("contact_law", choices=get_args(ContactLaw), needs="friction"),
    Column("top", choices=get_args(Top), needs="push_height"),
    Column("provenance", choices=("", *PROVENANCES)),
    Column("specimen", choices=(), symbols="block blocks specimens sample"),
    Column("label", choices=()),
)  # fmt: skip
_ROWS_OF_GAUGES = (
    Column("label", choices=(), required=True),
    Column("position", "mm", None, POSITION, required=True),
    Column("slip", "um", None, may_be_blank=True, needs="slip_sigma"),
    Column("slip_sigma", "um", None, ERROR_OF_READING, may_be_blank=True),
    Column("stress", "MPa", None, may_be_blank=True, needs="stress_sigma"),
    Column("stress_sigma", "MPa", None, ERROR_OF_READING, may_be_blank=True),
)

COLUMNS = {column.quantity: column for column in _ROWS}
_OF_GAUGES = {column.quantity: column for column in _ROWS_OF_GAUGES}
_EVERY = {**_OF_GAUGES, **COLUMNS}
TEXTS = tuple(name for name, column in COLUMNS.items() if column.choices is not None)
"""Columns of text."""
NUMERIC = tuple(name for name in COLUMNS if name not in (*TEXTS, "block_width"))
"""Columns of numbers that `Measurements` holds."""
IN_LC = tuple(name for name, column in COLUMNS.items() if column.plain == "λc")
"""Columns held in λc."""
GAUGE_COLUMNS = ("row", *(name for name in _OF_GAUGES if name != "label"))
"""Columns that `Gauges` holds."""

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
KNOWN = {*_IN_SI, *_EVERY}
"""All names, also those of readings of gauges and those that stand without the unit that they need."""

_EXAMPLE = {"specimen": "A", "height": "25", "correlation_length": "100", "poisson": "0.3", "young": "3", "length": "14.03"}
_EXAMPLE |= {"length_sigma": "0.5", "kind": "length", "provenance": "measured"}
_OF_BLOCKS = {"block_length": "75", "push_height": "5", "push_width": "2", "friction": "0.3"}


def template(body: Body) -> str:
    """Write a table to fill in, with one line as an example."""
    example = _EXAMPLE | (_OF_BLOCKS if body == "block" else {})
    columns = [COLUMNS[quantity] for quantity in example]
    lines = ["# Replace the example by your own, one precursor per line. Leave out the columns that you do not know."]
    lines += [f"# {one.quantity}: {', '.join(filter(None, one.choices))}" for one in columns if one.choices]
    return "\n".join((*lines, ",".join(one.name(in_si=True) for one in columns), ",".join(example.values()), ""))


def named(header: Sequence[str], where: str) -> Named:
    """Find the columns of a table of measurements by the names in its header; others are left out."""
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
    pair = {"machine_stiffness", "block_width"}
    if si and len(pair & there) == 1:
        own = next(own for own, (column, _) in known.items() if column.quantity in pair)
        missed = next(COLUMNS[one].name(in_si=True) for one in pair - there)
        raise MeasurementError(f"{where}, column {own}: needs the column {missed}: the model is one of a unit width")
    return known


def named_of_gauges(header: Sequence[str], where: str) -> Named:
    """Find the columns of a table of gauges by the names in its header; refuse others, and a missing one."""
    known = {own: _NAMES_OF_GAUGES[own] for own in header if own in _NAMES_OF_GAUGES}
    there = {column.quantity for column, _ in known.values()}
    if len(header) != len(there) or any(one.required and one.quantity not in there for one in _ROWS_OF_GAUGES):
        needed, others = (
            ", ".join(one.name(in_si=True) for one in _ROWS_OF_GAUGES if one.required is required) for required in (True, False)
        )
        raise MeasurementError(f"{where}: columns {', '.join(header)}; expected {needed}, and {others} as measured, each once")
    return known


def with_units(header: Sequence[str], row: Sequence[str], where: str) -> list[str] | None:
    """Join the units in the row below the header to its names; None if it holds no units, or a number."""
    units = [cell.translate(_MICRO).strip("[]() ").replace("/", "_per_") for cell in row]
    if not any(unit in _SIZES for unit in units) or any(re.match(r"[+-]?\.?\d", unit) for unit in units if unit != "1"):
        return None
    names = []
    for own, unit in zip(header, units, strict=False):
        column, size = _IN_SI.get(own, (_EVERY.get(own), None))
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
_UNIT = re.compile(rf"(?:_in)?(?:^|_)({'|'.join(_READ)}|in|inch|ft|dm|km|psi|k?N(?:_per_mm?)?)$", re.IGNORECASE)
ALIKE = 0.8
"""Similarity (difflib) above which a name counts as a typing error."""
LONGEST, MOST = 60, 50
"""Length of the longest unknown name whose meaning is guessed, and how many of them are."""


def _refuse_misnamed(unknown: Sequence[str], there: Container[str], si: bool, plain: bool, where: str) -> None:
    """Refuse columns that seem to mean a quantity that the table lacks, and suggest the name.

    A known name in other case, or a symbol or word of authors, is always refused. A name that is only like a known one is
    refused if it has a unit, or if the known one is required.
    """
    guesses = {own: _meant(own) for own in unknown[:MOST] if len(own) <= LONGEST}
    si = si or (not plain and any(unit for _, unit, _ in guesses.values()))
    said = []
    for own, (columns, unit, sure) in guesses.items():
        lacking = [one for one in columns if one.quantity not in there and one.names(si)]
        required = any(one.required for one in lacking)
        if lacking and (sure or unit or required):
            names = [name if si and (name := f"{one.quantity}_{unit}") in NAMES[True] else one.name(si) for one in lacking]
            remark = "" if required else " If not, give it another name."
            if own.casefold() in (name.casefold() for name in names):
                remark = " Upper and lower case count"
            said.append(f"{own}: did you mean {' or '.join(names)}?{remark}")
    if said:
        raise MeasurementError(f"{where}, column {' Column '.join(said)}")


def _meant(own: str) -> tuple[list[Column], str, bool]:
    """Columns that a name may mean, the unit that it ends in, and whether it is a known word and not only like one."""
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
    alike = get_close_matches(symbol, [column.value for column in wanted if column.value[0] == symbol[0]], n=1, cutoff=ALIKE)
    return [column for column in wanted if column.value in alike], unit, False


def check_needs(given: Collection[str], columns: Mapping[str, str], source: str) -> None:
    """Refuse quantities without one that they need; `columns` has their names in the file."""
    for name in given:
        column = _EVERY[name]
        for needed in (column.value, *column.needs.split()):
            of_si_only = _EVERY[needed].plain is None and column.plain is not None
            if needed not in given and not (of_si_only and "correlation_length" not in given):
                own = columns.get(name, name)
                missed = needed if own == name else _EVERY[needed].name(in_si=True)
                raise MeasurementError(f"{source}: {own} is given without {missed}")


Fault = tuple[str, Any, str]
"""A quantity, in which rows it breaks a rule, and the rule."""


def check(
    values: Mapping[str, Any],
    place: Callable[[int], str],
    columns: Mapping[str, str] | None = None,
    cells: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """Check columns, by quantity and in the units of `Measurements` or `Gauges`, against their domains and each other.

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
    unit = "" if isinstance(value, str) else _likely_unit(name, value, columns or {})
    raise MeasurementError(f"{place(i)}, column {own}: {text}{': ' * bool(text)}{rule}{unit}")


def _faults(values: Mapping[str, Any]) -> Iterator[Fault]:
    """Rules and the rows that break them; λc comes first, as it may be why a height or length is out of its domain."""
    for name, x in sorted(values.items(), key=lambda item: item[0] != "correlation_length"):
        column = _EVERY[name]
        if column.choices is None:
            blank = np.isnan(x) & column.may_be_blank
            yield name, blank & ~np.isnan(values.get(column.value, x)), "missing: the value beside it has no standard error"
            yield name, ~blank & ~np.isfinite(x), "must be finite" + "; blank where there is none" * column.may_be_blank
            yield name, np.isfinite(x) & ~column.domain.holds(x), column.domain.requirement
        elif column.choices:
            yield name, [text not in column.choices for text in x], f"one of {', '.join(filter(None, column.choices))}"
    if "length" in values:
        yield from _faults_of_length(values)
        yield from _faults_of_push(values)
    if "block_width" in values:
        missing = np.isnan(values["block_width"]) & ~np.isnan(values.get("machine_stiffness", np.nan))
        yield "block_width", missing, "missing value: machine_stiffness_N_per_m is divided by it"


def _faults_of_length(values: Mapping[str, Any]) -> Iterator[Fault]:
    """Rules of the length and its error, which depend on how it was measured."""
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
    yield "push_width", width >= height, "wider than the block is high"
    yield "push_width", np.isnan(at) & ~np.isnan(width), "needs the height of its middle, which is missing"
    yield "push_width", (at - width / 2 <= 0) | (at + width / 2 >= height), "reaches beyond the side of the block"


def _likely_unit(name: str, value: float, columns: Mapping[str, str]) -> str:
    """Guess the unit of a number outside its domain: ``: is it in Pa?``; empty where none is likely."""
    own = columns.get(name, name)
    if name == "young" and value > YOUNG.high and not own.endswith("_Pa"):
        return ": is it in Pa?"
    if name == "correlation_length" and 0 < value <= CORRELATION_LENGTH.low and not own.endswith("_m"):
        return ": is it in m?"
    if name == "height" and 0 < value <= 1 and "correlation_length" in columns:
        return f": is {own} in m, or {columns['correlation_length']} in nm?"
    return ""
