"""Measurements of first precursors, and readings of gauges along the interface.

`slippulse_jax.inference.tables` reads both; `slippulse_jax.inference.columns` describes their columns.
"""

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import ArrayLike

from slippulse_jax.domains import CORRELATION_LENGTH
from slippulse_jax.inference.columns import COLUMNS, IN_LC, NUMBER, NUMERIC, MeasurementError, check, check_needs
from slippulse_jax.shown import html, short
from slippulse_jax.units import UNITS_OF_LENGTH

if TYPE_CHECKING:
    import pandas as pd


class MeasurementWarning(UserWarning):
    """Measurements that can be fitted but are probably not what was meant."""


DIAMOND = 1.2e12
"""Young's modulus of diamond, in Pa."""
MOST_FRICTION = 2.0
"""Coefficient of friction above which it may be in per cent."""
LIKELY = (0.02, 1.2)
"""Usual range of the length over the height."""
SUSPECT = (0.01, 1.5)
"""Range of the length over the height outside which a unit is suspected."""
LENGTHENED = 5.0
"""Factor on the upper end of `SUSPECT` where something may lengthen fronts."""

T = TypeVar("T")


def held(*, converter: Callable[[Any], Any], **default: Any) -> Any:
    """Field of a table that holds what `converter` makes of an argument; type checkers let it take what that takes."""
    return dataclasses.field(metadata={"converter": converter}, **default)


@dataclass_transform(field_specifiers=(held, dataclasses.field), frozen_default=True, eq_default=False)
def table(cls: type[T]) -> type[T]:
    """Make a frozen dataclass; its ``__post_init__`` calls `convert`."""
    return dataclasses.dataclass(frozen=True, eq=False)(cls)


def numbers(x: ArrayLike) -> np.ndarray:
    """Convert to an array of float64, of one number at least one axis."""
    given = np.asarray(x)
    for one in given.ravel().tolist() if given.dtype.kind in "OU" else ():
        if isinstance(one, str) and not NUMBER.fullmatch(one):
            raise TypeError(f"{one!r} is not a number")
    return np.atleast_1d(given.astype(np.float64))


def numbers_or_none(x: ArrayLike | None) -> np.ndarray | None:
    """Convert numbers, if they are given."""
    return None if x is None else numbers(x)


def entries(x: Sequence[T]) -> tuple[T, ...]:
    """Convert to a tuple."""
    return tuple(x)


def convert(one: Any) -> list[str]:
    """Convert the fields of a table, and repeat a column of one number; return the names of the columns of numbers given."""
    given, n, first = [], 1, ""
    for field in (field for field in dataclasses.fields(one) if "converter" in field.metadata):
        where, converter = f"{one.source}, column {field.name}", field.metadata["converter"]
        try:
            value = converter(getattr(one, field.name))
        except (TypeError, ValueError) as error:
            needed = "a sequence" if converter is entries else "numbers"
            raise MeasurementError(f"{where}: must be {needed} ({error})") from None
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
    return given


@table
class Gauges:
    """Readings of gauges along the interface after measured precursors, one entry each.

    Parameters
    ----------
    row : array_like of int, shape (r,)
        Which measurement's precursor had just stopped.
    position : array_like, shape (r,)
        Distance from the pushed edge, in m.
    slip, slip_sigma : array_like, shape (r,), optional
        How far the slider's side of the interface moved while the front ran, in m; NaN where not measured.
    stress, stress_sigma : array_like, shape (r,), optional
        Shear stress on the contacts after arrest, prestress included, in Pa; NaN where not measured.
    lines : sequence of int, optional
        Line of each reading in the file it came from.
    source : str
        Name of that file.
    skipped : tuple of int
        Lines of it that hold no reading and are not blank.

    Raises
    ------
    MeasurementError
        If a value is not finite, a standard error is missing or not positive, or nothing was read.
    """

    row: np.ndarray = held(converter=numbers)
    position: np.ndarray = held(converter=numbers)
    slip: np.ndarray | None = held(converter=numbers_or_none, default=None)
    slip_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    stress: np.ndarray | None = held(converter=numbers_or_none, default=None)
    stress_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    lines: tuple[int, ...] = held(converter=entries, default=())
    source: str = "gauges"
    skipped: tuple[int | str, ...] = ()

    def __post_init__(self) -> None:
        given = convert(self)
        if not (self.row == np.round(self.row)).all():
            i = int(np.argmax(self.row != np.round(self.row)))
            raise MeasurementError(f"{self.source}, column row: {self.row[i]:g}: must be the number of a measurement")
        object.__setattr__(self, "row", self.row.astype(int))
        given.remove("row")
        check_needs(given, {}, self.source)
        check({name: getattr(self, name) for name in given}, self.place)
        unread = ~(self.there("slip") | self.there("stress"))
        if unread.any():
            raise MeasurementError(f"{self.place(int(np.argmax(unread)))}: neither slip nor stress was read")

    def __len__(self) -> int:
        return len(self.position)

    def place(self, i: int) -> str:
        """Where reading i came from, for messages."""
        return f"{self.source}, line {self.lines[i]}" if self.lines else f"{self.source}, reading {i}"

    def there(self, name: str) -> np.ndarray:
        """Which readings have a value of `name`, bool, shape (r,)."""
        values = getattr(self, name)
        return np.zeros(len(self), bool) if values is None else np.isfinite(values)


@table
class Measurements:
    """Measured first precursors, one entry per measurement.

    Its fields are the columns of a table; docs/reference/columns.md ("Columns of a table") says what each means. NaN and None
    are blank cells.

    Parameters
    ----------
    height, poisson, length : array_like, shape (n,)
        H/λc, ν, and the measured length over λc, also where `correlation_length` is given (`from_si` takes metres).
    length_sigma, block_length, push_height, push_width, height_sigma, push_height_sigma : array_like, shape (n,), optional
        In λc. Without `length_sigma` the errors are taken as equal and their size from the scatter.
    correlation_length, young, correlation_length_sigma, young_sigma : array_like, shape (n,), optional
        λc in m, given for data in SI, and E in Pa; both turn k/K into an areal stiffness k/λc² in Pa/m.
    prestress, threshold_slope, friction, normal_stiffness, poisson_sigma, friction_sigma : array_like, shape (n,), optional
        Numbers without unit.
    machine_stiffness : array_like, shape (n,), optional
        Over the width of the block, in Pa, or in E where `young` is not given.
    displacement, displacement_sigma, force, force_sigma : array_like, shape (n,), optional
        Displacement of the pushed edge at nucleation, in m, and driving force per width, in N/m. They need `young`.
    kind, push_control, contact_law, top, specimen, provenance, label : sequence of str, optional
        Texts of the columns of these names.
    gauges : Gauges, optional
        Readings of slip and stress along the interface after arrest; need `correlation_length` and `young`.
    lines, rows : sequence, optional
        Line of each measurement in the file that it came from, or its index label in the DataFrame.
    skipped : sequence
        Lines or rows that hold no measurement: titles, units and comments.
    source : str
        Name of that file, for messages and reports.
    other : dict of str to list of str
        Columns that were kept but not used.
    columns : dict of str to str
        Name in the file of each quantity's column, for messages, which are then in its unit.

    Raises
    ------
    MeasurementError
        If a value is missing, not finite or outside its domain, the lengths of the columns differ, or a column is given without
        one that it needs.
    """

    height: np.ndarray = held(converter=numbers)
    poisson: np.ndarray = held(converter=numbers)
    length: np.ndarray = held(converter=numbers)
    length_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    correlation_length: np.ndarray | None = held(converter=numbers_or_none, default=None)
    young: np.ndarray | None = held(converter=numbers_or_none, default=None)
    kind: tuple[str, ...] = held(converter=entries, default=())
    prestress: np.ndarray | None = held(converter=numbers_or_none, default=None)
    threshold_slope: np.ndarray | None = held(converter=numbers_or_none, default=None)
    block_length: np.ndarray | None = held(converter=numbers_or_none, default=None)
    push_height: np.ndarray | None = held(converter=numbers_or_none, default=None)
    push_width: np.ndarray | None = held(converter=numbers_or_none, default=None)
    push_control: tuple[str, ...] = held(converter=entries, default=())
    friction: np.ndarray | None = held(converter=numbers_or_none, default=None)
    normal_stiffness: np.ndarray | None = held(converter=numbers_or_none, default=None)
    contact_law: tuple[str, ...] = held(converter=entries, default=())
    top: tuple[str, ...] = held(converter=entries, default=())
    machine_stiffness: np.ndarray | None = held(converter=numbers_or_none, default=None)
    height_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    poisson_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    correlation_length_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    young_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    push_height_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    friction_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    displacement: np.ndarray | None = held(converter=numbers_or_none, default=None)
    displacement_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    force: np.ndarray | None = held(converter=numbers_or_none, default=None)
    force_sigma: np.ndarray | None = held(converter=numbers_or_none, default=None)
    specimen: tuple[str, ...] = held(converter=entries, default=())
    provenance: tuple[str, ...] = held(converter=entries, default=())
    label: tuple[str, ...] = held(converter=entries, default=())
    gauges: Gauges | None = None
    lines: tuple[int, ...] = held(converter=entries, default=())
    source: str = "measurements"
    other: Mapping[str, Sequence[str]] = dataclasses.field(default_factory=dict)
    columns: Mapping[str, str] = dataclasses.field(default_factory=dict)
    rows: tuple[str, ...] = held(converter=entries, default=())
    skipped: tuple[int | str, ...] = ()

    @classmethod
    def from_si(cls, *, correlation_length: ArrayLike, **columns: Any) -> "Measurements":
        """Measurements of arrays in SI units.

        Parameters
        ----------
        correlation_length : array_like
            λc, in m.
        **columns
            As of `Measurements`, but with heights and lengths, and their standard errors, in m.
        """
        unit = np.asarray(correlation_length, dtype=np.float64)
        CORRELATION_LENGTH.check("Measurements.from_si: correlation_length", unit)
        in_lc: dict[str, Any] = {
            name: np.asarray(x) / unit if name in IN_LC and x is not None else x for name, x in columns.items()
        }
        return cls(correlation_length=unit, **in_lc)

    @classmethod
    def from_dataframe(cls, table: "pd.DataFrame") -> "Measurements":
        """Measurements of a pandas.DataFrame with the columns of a CSV file; NaN and None are blank cells.

        Raises
        ------
        MeasurementError
            As `read_measurements`, but with the row's index label instead of a line.
        TypeError
            If it is no DataFrame.
        """
        from slippulse_jax.inference.tables import from_dataframe  # which makes measurements

        return from_dataframe(table)

    def __post_init__(self) -> None:
        given = convert(self)
        for name in given:
            if COLUMNS[name].may_be_blank and np.isnan(getattr(self, name)).all():  # as if it were not there
                object.__setattr__(self, name, None)
        if not self.kind:
            object.__setattr__(self, "kind", ("length",) * len(self))
        if self.length_sigma is None and "length" not in self.kind:
            object.__setattr__(self, "length_sigma", np.zeros(len(self)))  # counts need no σ
        for field in (field for field in dataclasses.fields(self) if "converter" in field.metadata):
            values = getattr(self, field.name)
            if isinstance(values, tuple) and len(values) not in (0, len(self)):
                raise MeasurementError(f"{self.source}: {field.name} has {len(values)} entries for {len(self)} lengths")
        values = {name: getattr(self, name) for name in COLUMNS if getattr(self, name, None) is not None}
        check_needs([name for name, x in values.items() if len(x)], self.columns, self.source)
        self._check_gauges()
        check(values, self.place)

    def _check_gauges(self) -> None:
        if self.gauges is None:
            return
        if self.young is None:
            raise MeasurementError(f"{self.gauges.source}: gauges are in SI: the lengths need correlation_length and young too")
        for i, row in enumerate(self.gauges.row):
            if not 0 <= row < len(self):
                raise MeasurementError(f"{self.gauges.place(i)}: row = {row}: there are {len(self)} measurements")
            if self.block_length is not None and self.correlation_length is not None:
                end = self.block_length[row] * self.correlation_length[row]
                if self.gauges.position[i] > end:
                    where = f"{self.gauges.position[i]:g} m: beyond the end of the block, at {end:g} m"
                    raise MeasurementError(f"{self.gauges.place(i)}: position = {where}")
            if self.kind[row] == "at_least":
                raise MeasurementError(f"{self.gauges.place(i)}: that front did not stop, so nothing was read after its arrest")

    def __len__(self) -> int:
        return len(self.height)

    def __repr__(self) -> str:
        size, unit = self.unit
        heights, lengths = (f"{short(x * size)} {unit}" for x in (self.height, self.length))
        return f"Measurements({len(self)} of {self.source}: heights {heights}, lengths {lengths})"

    def _repr_html_(self) -> str:
        given = [name for name in ("specimen", "label") if getattr(self, name)]
        counted, numbers = self.numbered
        rows = [
            [str(numbers[i]), *(getattr(self, name)[i] for name in given)]
            + [self.in_its_unit(i, self.height[i]), f"{self.poisson[i]:g}"]
            + [self.in_its_unit(i, self.length[i]), "" if np.isnan(self.sigma[i]) else self.in_its_unit(i, self.sigma[i])]
            + [self.kind[i]]
            for i in range(len(self))
        ]
        return html(self.source, rows, (counted, *given, "height", "ν", "length", "σ", "kind"))

    def place(self, i: int) -> str:
        """Where measurement i came from, for messages."""
        return f"{self.source}, {self.number(i)}"

    def number(self, i: int) -> str:
        """Name of measurement i within its source: ``line 3`` of a file, ``row 1`` of a DataFrame."""
        counted, numbers = self.numbered
        return f"{'measurement' if counted == 'no.' else counted} {numbers[i]}"

    @property
    def numbered(self) -> tuple[str, Sequence[int | str]]:
        """Heading for the numbers of the measurements, and these numbers or index labels."""
        if self.lines:
            return "line", self.lines
        return ("row", self.rows) if self.rows else ("no.", range(len(self)))

    def option(self, command: str, python: str) -> str:
        """Write an option of a fit in Python, and for the command line too if the measurements came from a file."""
        return f"{command}, in Python {python}" if self.lines else python

    @property
    def unit(self) -> tuple[np.ndarray, str]:
        """Size of λc in the unit of the table's lengths, (n,), and that unit: mm where arrays were given in metres."""
        if self.correlation_length is None:
            return np.ones(len(self)), "λc"
        unit = self.columns.get("length", "length_mm").rpartition("_")[2]
        return self.correlation_length / UNITS_OF_LENGTH[unit], unit

    def in_its_unit(self, i: int, length: float) -> str:
        """Write a length along the interface, given in λc, in the unit of the table: ``14.03 mm``."""
        size, unit = self.unit
        return f"{length * size[i]:.5g} {unit}"

    @property
    def in_si(self) -> bool:
        """Whether the correlation length is known in metres."""
        return self.correlation_length is not None

    @property
    def sigma(self) -> np.ndarray:
        """Standard errors of the lengths in λc, NaN where none is given."""
        return np.full(len(self), np.nan) if self.length_sigma is None else self.length_sigma

    @property
    def stated_sigma(self) -> np.ndarray:
        """Standard errors of the lengths in λc, 1 where none is given."""
        return np.ones(len(self)) if self.length_sigma is None else self.length_sigma

    @property
    def distinct(self) -> int:
        """Number of different measurements: lines copied from another count once."""
        columns = [
            np.nan_to_num(getattr(self, name), nan=np.inf).tolist() for name in NUMERIC if getattr(self, name) is not None
        ]
        texts = [getattr(self, name) for name in ("kind", "specimen", "push_control", "contact_law", "top")]
        texts = [column for column in texts if column]
        return len(set(zip(*columns, *texts, strict=True)))

    def or_zero(self, name: str) -> np.ndarray:
        """Column `name`, or zeros where it was not given; shape (n,)."""
        column = getattr(self, name)
        return np.zeros(len(self)) if column is None else column


def check_used(m: Measurements, what: str, *, stacklevel: int = 4) -> None:
    """Refuse blocks with an end and soft machines for a caller that ignores them, and warn of other unused columns.

    Errors of inputs, errors that measured lengths share, and gauges would have changed the errors of the result.
    """
    for name in ("block_length", "machine_stiffness"):
        if getattr(m, name) is not None and np.isfinite(getattr(m, name)).any():
            raise MeasurementError(f"{m.source}, column {name}: {what} takes blocks without end, whose edge is held")
    errors = [f"{name}_sigma" for name in ("height", "young", "poisson", "correlation_length", "push_height", "friction")]
    unused = [m.columns.get(name, name) for name in errors if getattr(m, name) is not None and np.any(getattr(m, name))]
    unused += ["gauges"] * (m.gauges is not None) + ["what lengths of provenance measured share"] * ("measured" in m.provenance)
    if unused:
        text = f"{m.source}: {what} takes the inputs as exact and errors as independent, without {', '.join(unused)}"
        warnings.warn(text, MeasurementWarning, stacklevel=stacklevel)


def likely_mistakes(m: Measurements, *, prestressed: bool = False) -> Iterator[str]:
    """Name the columns that may have been exchanged, or may be in another unit than their names say.

    A prestress, stated or to be fitted, may lengthen fronts several times, as may a machine that gives way and an end.
    """
    lengthened = prestressed or m.or_zero("prestress").any() or m.machine_stiffness is not None or m.block_length is not None
    most = SUSPECT[1] * (LENGTHENED if lengthened else 1)
    height, length = (m.columns.get(name, name) for name in ("height", "length"))
    over = float(np.median(m.length / m.height))
    if not SUSPECT[0] <= over <= most:
        may_be = [f"are {height} and {length} exchanged"] * (LIKELY[0] <= 1 / over <= LIKELY[1])
        if m.in_si:
            may_be += [f"is {height} in {unit}" for unit in _other_units(height, lambda factor: over / factor)]
            may_be += [f"is {length} in {unit}" for unit in _other_units(length, lambda factor: over * factor)]
        if may_be:
            yield f"the lengths are about {over:.3g} times the heights: {', or '.join(may_be)}?"
    if m.friction is not None and m.friction.max() > MOST_FRICTION:
        column = m.columns.get("friction", "friction")
        yield f"a coefficient of friction of {m.friction.max():g} is that of no dry contact: is {column} in per cent?"
    if m.correlation_length is None:
        return
    if (m.height * m.correlation_length).max() < 1e-3:
        yield f"every height is below 1 mm: is {height} in m?"
    shortest = float(m.correlation_length.min())
    if shortest < 1e-7:
        column = m.columns.get("correlation_length", "correlation_length")
        yield f"a correlation length of {shortest * 1e9:.3g} nm is that of no rough interface: is {column} in mm?"
    if m.young is not None and m.young.max() > DIAMOND:
        column = m.columns.get("young", "young")
        yield f"a Young's modulus of {m.young.max() / 1e9:.4g} GPa is above diamond's: is {column} in MPa?"


def _other_units(column: str, ratio: Callable[[float], float]) -> list[str]:
    """Units of length in which the column would have usual values."""
    own = UNITS_OF_LENGTH.get(column.rpartition("_")[2], 1.0)
    ratios = {unit: ratio(size / own) for unit, size in UNITS_OF_LENGTH.items() if unit not in ("µm", "μm", "nm")}
    found = [unit for unit, over in ratios.items() if LIKELY[0] <= over <= LIKELY[1]]
    return sorted(found, key=lambda unit: unit == "cm")  # a mistake by a factor of 1000 is likelier
