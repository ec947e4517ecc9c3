"""Measurements of first precursors, and readings of gauges along the interface.

`slippulse_jax.inference.tables` reads both.
"""

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from slippulse_jax.block import Control
from slippulse_jax.domains import CORRELATION_LENGTH, POISSON, PRESTRESS, THRESHOLD_SLOPE, YOUNG
from slippulse_jax.files import shortened
from slippulse_jax.shown import html, short
from slippulse_jax.units import UNITS_OF_LENGTH

if TYPE_CHECKING:
    import pandas as pd

PROVENANCES = ("measured", "printed", "digitised", "synthetic")
KINDS = ("length", "whole", "at_least")
"""Kind of a measurement: a length with a standard error; a count of whole contacts; a length the front ran past (censored)."""


class MeasurementError(ValueError):
    """Measurements that cannot be used; the message says where and why."""

    def __init__(self, message: str) -> None:
        super().__init__(shortened(message))


class MeasurementWarning(UserWarning):
    """Measurements that can be fitted but are probably not what was meant."""


DIAMOND = 1.2e12
"""Young's modulus of diamond, in Pa."""
LIKELY = (0.02, 1.2)
"""Usual range of the length over the height."""
SUSPECT = (0.01, 1.5)
"""Range of the length over the height outside which a unit is suspected."""
LENGTHENED = 5.0
"""Factor on the upper end of `SUSPECT` where something may lengthen fronts."""
READINGS = ("slip", "stress")
"""Quantities that gauges read."""
GAUGE_COLUMNS = ("row", "position", "slip", "slip_sigma", "stress", "stress_sigma")


@dataclasses.dataclass(frozen=True, eq=False)
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

    Raises
    ------
    MeasurementError
        If a value is not finite, a standard error is missing or not positive, or nothing was read.
    """

    row: np.ndarray
    position: np.ndarray
    slip: np.ndarray | None = None
    slip_sigma: np.ndarray | None = None
    stress: np.ndarray | None = None
    stress_sigma: np.ndarray | None = None
    lines: tuple[int, ...] = ()
    source: str = "gauges"

    if TYPE_CHECKING:  # what is taken, and held as arrays and tuples

        def __init__(
            self,
            row: ArrayLike,
            position: ArrayLike,
            slip: ArrayLike | None = None,
            slip_sigma: ArrayLike | None = None,
            stress: ArrayLike | None = None,
            stress_sigma: ArrayLike | None = None,
            lines: Sequence[int] = (),
            source: str = "gauges",
        ) -> None: ...

    def __post_init__(self) -> None:
        set_columns(self, GAUGE_COLUMNS)
        if not (self.row == np.round(self.row)).all():
            i = int(np.argmax(self.row != np.round(self.row)))
            raise MeasurementError(f"{self.source}, column row: {self.row[i]:g}: must be the number of a measurement")
        object.__setattr__(self, "row", self.row.astype(int))
        for name in READINGS:
            if getattr(self, name) is not None and getattr(self, f"{name}_sigma") is None:
                raise MeasurementError(f"{self.source}: {name} is given without {name}_sigma")
        for i in range(len(self)):
            self._check(i)

    def __len__(self) -> int:
        return len(self.position)

    def place(self, i: int) -> str:
        """Where reading i came from, for messages."""
        return f"{self.source}, line {self.lines[i]}" if self.lines else f"{self.source}, reading {i}"

    def there(self, name: str) -> np.ndarray:
        """Which readings have a value of `name`, bool, shape (r,)."""
        values = getattr(self, name)
        return np.zeros(len(self), bool) if values is None else np.isfinite(values)

    def _check(self, i: int) -> None:
        if not (np.isfinite(self.position[i]) and self.position[i] >= 0):
            raise MeasurementError(f"{self.place(i)}: position = {self.position[i]:g} m: must be finite and not negative")
        read = [name for name in READINGS if self.there(name)[i]]
        if not read:
            raise MeasurementError(f"{self.place(i)}: neither slip nor stress was read")
        for name in read:
            sigma = getattr(self, f"{name}_sigma")[i]
            if not (np.isfinite(sigma) and sigma > 0):
                raise MeasurementError(f"{self.place(i)}: {name}_sigma = {sigma:g}: the standard error must be positive")


@dataclasses.dataclass(frozen=True, eq=False)
class Measurements:
    """Measured first precursors, one entry per measurement.

    Parameters
    ----------
    height, poisson, length : array_like, shape (n,)
        H/λc, ν, and the measured length over λc: numbers of λc, also where `correlation_length` says how many metres that is
        (`from_si` takes metres). Scalars are repeated.
    length_sigma : array_like, shape (n,), optional
        Standard error of the length, in λc; 0 is allowed for counts and for fronts without arrest, and meant where there is
        nothing else. Without it the errors are taken as equal and their size from the scatter.
    correlation_length : array_like, shape (n,), optional
        λc in m; given for data in SI.
    young : array_like, shape (n,), optional
        E in Pa; with `correlation_length` it turns k/K into an areal stiffness k/λc² in Pa/m.
    kind : sequence of str, optional
        One of `KINDS` per measurement; "length" by default.
    prestress, threshold_slope : array_like, shape (n,), optional
        Known conditions: φ = σ_0/σ_s in (−1, 1), and the relative rise of the threshold per contact.
    block_length : array_like, shape (n,), optional
        L/λc, length of the block from its pushed edge to its free end; NaN, like None, for a block without end.
    push_height, push_width : array_like, shape (n,), optional
        Height of the middle of the pusher over the interface, and its own height, in λc; without a width, NaN or None, the
        height of its lower end: it then covers everything above. They describe the push on a block (`fit`, body "block").
    push_control : sequence of str, optional
        What is held while an event runs, "displacement" (by default) or "force".
    machine_stiffness : array_like, shape (n,), optional
        Stiffness of the drive over the width of the block, in Pa, or in E where `young` is not given; NaN, like None, for an
        edge that is held while the front runs.
    height_sigma, poisson_sigma, correlation_length_sigma, young_sigma, push_height_sigma : array_like, shape (n,), optional
        Standard errors of the inputs, in their units (of the heights in λc). 0 means exactly known.
    displacement, displacement_sigma : array_like, shape (n,), optional
        Displacement of the pushed edge at nucleation, in m; NaN where it was not measured.
    force, force_sigma : array_like, shape (n,), optional
        Driving force at nucleation per width of the block, in N/m; NaN where it was not measured.
    specimen, provenance : sequence of str, optional
    label : sequence of str, optional
        Name of each precursor, by which tables of further observations refer to it.
    gauges : Gauges, optional
        Readings of slip and stress along the interface after arrest; need `correlation_length` and `young`.
    lines : array_like of int, optional
        Line of each measurement in the file it came from.
    source : str
        Name of that file, for messages and reports.
    other : dict of str to list of str
        Columns that were kept but not used.
    columns : dict of str to str
        Name in the file of each quantity's column, for messages, which are then in its unit.
    rows : sequence of str, optional
        Index label of each measurement in the DataFrame it came from.

    Raises
    ------
    MeasurementError
        If a value is missing, not finite or outside its domain, or the lengths of the columns differ.
    """

    height: np.ndarray
    poisson: np.ndarray
    length: np.ndarray
    length_sigma: np.ndarray | None = None
    correlation_length: np.ndarray | None = None
    young: np.ndarray | None = None
    kind: tuple[str, ...] = ()
    prestress: np.ndarray | None = None
    threshold_slope: np.ndarray | None = None
    block_length: np.ndarray | None = None
    push_height: np.ndarray | None = None
    push_width: np.ndarray | None = None
    push_control: tuple[str, ...] = ()
    machine_stiffness: np.ndarray | None = None
    height_sigma: np.ndarray | None = None
    poisson_sigma: np.ndarray | None = None
    correlation_length_sigma: np.ndarray | None = None
    young_sigma: np.ndarray | None = None
    push_height_sigma: np.ndarray | None = None
    displacement: np.ndarray | None = None
    displacement_sigma: np.ndarray | None = None
    force: np.ndarray | None = None
    force_sigma: np.ndarray | None = None
    specimen: tuple[str, ...] = ()
    provenance: tuple[str, ...] = ()
    label: tuple[str, ...] = ()
    gauges: Gauges | None = None
    lines: tuple[int, ...] = ()
    source: str = "measurements"
    other: dict[str, list[str]] = dataclasses.field(default_factory=dict)
    columns: dict[str, str] = dataclasses.field(default_factory=dict)
    rows: tuple[str, ...] = ()

    if TYPE_CHECKING:  # what is taken, and held as arrays and tuples

        def __init__(
            self,
            height: ArrayLike,
            poisson: ArrayLike,
            length: ArrayLike,
            length_sigma: ArrayLike | None = None,
            correlation_length: ArrayLike | None = None,
            young: ArrayLike | None = None,
            kind: Sequence[str] = (),
            prestress: ArrayLike | None = None,
            threshold_slope: ArrayLike | None = None,
            block_length: ArrayLike | None = None,
            push_height: ArrayLike | None = None,
            push_width: ArrayLike | None = None,
            push_control: Sequence[str] = (),
            machine_stiffness: ArrayLike | None = None,
            height_sigma: ArrayLike | None = None,
            poisson_sigma: ArrayLike | None = None,
            correlation_length_sigma: ArrayLike | None = None,
            young_sigma: ArrayLike | None = None,
            push_height_sigma: ArrayLike | None = None,
            displacement: ArrayLike | None = None,
            displacement_sigma: ArrayLike | None = None,
            force: ArrayLike | None = None,
            force_sigma: ArrayLike | None = None,
            specimen: Sequence[str] = (),
            provenance: Sequence[str] = (),
            label: Sequence[str] = (),
            gauges: Gauges | None = None,
            lines: Sequence[int] = (),
            source: str = "measurements",
            other: Mapping[str, Sequence[str]] = {},
            columns: Mapping[str, str] = {},
            rows: Sequence[str] = (),
        ) -> None: ...

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
        lengths = {*IN_LC, *(f"{name}_sigma" for name in IN_LC)}
        in_lc: dict[str, Any] = {
            name: np.asarray(x) / unit if name in lengths and x is not None else x for name, x in columns.items()
        }
        return cls(correlation_length=unit, **in_lc)

    @classmethod
    def from_dataframe(cls, table: "pd.DataFrame") -> "Measurements":
        """Measurements of a pandas.DataFrame with the columns of a CSV file; NaN and None are blank cells.

        Raises
        ------
        MeasurementError
            As `read_measurements`, but with the row's index label instead of a line.
        """
        from slippulse_jax.inference.tables import from_dataframe  # which makes measurements

        return from_dataframe(table)

    def __post_init__(self) -> None:
        given = set_columns(self, NUMERIC)
        for name in set(given) & set(MAY_BE_BLANK):
            if np.isnan(getattr(self, name)).all():  # blank everywhere: as if it were not there
                object.__setattr__(self, name, None)
                given.remove(name)
        n = len(self)
        for name in ("kind", "specimen", "provenance", "label", "lines", "rows", "push_control"):
            values = tuple(getattr(self, name))
            if values and len(values) != n:
                raise MeasurementError(f"{self.source}: {name} has {len(values)} entries for {n} lengths")
            object.__setattr__(self, name, values)
        if not self.kind:
            object.__setattr__(self, "kind", ("length",) * n)
        if self.length_sigma is None and "length" not in self.kind:
            object.__setattr__(self, "length_sigma", np.zeros(n))  # counts need no σ
        self._check_companions()
        self._check_gauges()
        for i in range(n):
            check_domain({name: float(getattr(self, name)[i]) for name in given}, self.kind[i], self.place(i), {})

    def _check_companions(self) -> None:
        if self.push_height is None and (self.push_width is not None or self.push_control):
            given = "push_width" if self.push_width is not None else "push_control"
            raise MeasurementError(f"{self.source}: {given} is given without push_height")
        for i, control in enumerate(self.push_control):
            if control not in get_args(Control):
                raise MeasurementError(
                    f"{self.place(i)}, column push_control: {control!r}: one of {', '.join(get_args(Control))}"
                )
        if self.young is not None and self.correlation_length is None:
            raise MeasurementError(
                f"{self.source}: young is given without correlation_length: no areal stiffness can be formed"
            )
        if self.machine_stiffness is not None and self.in_si and self.young is None:
            raise MeasurementError(f"{self.source}: machine_stiffness needs young, with which it is compared")
        for name in ("displacement", "force"):
            if getattr(self, name) is None:
                continue
            if getattr(self, f"{name}_sigma") is None:
                raise MeasurementError(f"{self.source}: {name} is given without {name}_sigma")
            if self.young is None:
                raise MeasurementError(f"{self.source}: {name} needs correlation_length and young: it is in SI")

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
        texts = [column for column in (self.kind, self.specimen, self.push_control) if column]
        return len(set(zip(*columns, *texts, strict=True)))

    def or_zero(self, name: str) -> np.ndarray:
        """Column `name`, or zeros where it was not given; shape (n,)."""
        column = getattr(self, name)
        return np.zeros(len(self)) if column is None else column


def check_used(m: Measurements, what: str, *, stacklevel: int = 3) -> None:
    """Refuse blocks with an end and soft machines for a caller that ignores them, and warn of other unused columns.

    Errors of inputs, errors that measured lengths share, and gauges would have changed the errors of the result.
    """
    for name in ("block_length", "machine_stiffness"):
        if getattr(m, name) is not None and np.isfinite(getattr(m, name)).any():
            raise MeasurementError(f"{m.source}, column {name}: {what} takes blocks without end, whose edge is held")
    errors = [f"{name}_sigma" for name in ("height", "young", "poisson", "correlation_length", "push_height")]
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
    ratios = {unit: ratio(size / own) for unit, size in UNITS_OF_LENGTH.items() if unit not in ("µm", "nm")}
    found = [unit for unit, over in ratios.items() if LIKELY[0] <= over <= LIKELY[1]]
    return sorted(found, key=lambda unit: unit == "cm")  # a mistake by a factor of 1000 is likelier


def set_columns(table: Any, names: Sequence[str]) -> list[str]:
    """Convert the columns of a frozen table to float64 arrays of one length; return the names of those given.

    Raises
    ------
    MeasurementError
        Naming the column that holds no numbers, is empty, has more than one axis, or another length than those before it.
    """
    given = [name for name in names if getattr(table, name) is not None]
    n, first = 1, ""
    for name in given:
        try:
            column = np.atleast_1d(np.asarray(getattr(table, name), dtype=np.float64))
        except (TypeError, ValueError) as error:
            raise MeasurementError(f"{table.source}, column {name}: must be numbers ({error})") from None
        if column.ndim != 1 or column.size == 0:
            raise MeasurementError(f"{table.source}, column {name}: must be a non-empty one-dimensional column")
        if column.size > 1 and first and column.size != n:
            raise MeasurementError(f"{table.source}, column {name}: {column.size} entries, where {first} has {n}")
        if column.size > 1 and not first:
            n, first = column.size, name
        object.__setattr__(table, name, column)
    for name in given:
        object.__setattr__(table, name, np.array(np.broadcast_to(getattr(table, name), n)))
    return given


NUMERIC = tuple(
    field.name
    for field in dataclasses.fields(Measurements)
    if field.name
    not in ("kind", "specimen", "provenance", "label", "push_control", "gauges", "lines", "source", "other", "columns", "rows")
)

# quantity -> (test, requirement)
_DOMAIN: dict[str, tuple[Any, str]] = {
    "height": (lambda x: x > 1, "the height must exceed the correlation length λc"),
    "poisson": (POISSON.holds, POISSON.requirement),
    "length": (lambda x: x > 0, "a length must be positive"),
    "length_sigma": (lambda x: x >= 0, "a standard error cannot be negative"),
    "correlation_length": (CORRELATION_LENGTH.holds, CORRELATION_LENGTH.requirement),
    "young": (YOUNG.holds, YOUNG.requirement),
    "prestress": (PRESTRESS.holds, PRESTRESS.requirement),
    "threshold_slope": (THRESHOLD_SLOPE.holds, THRESHOLD_SLOPE.requirement),
    "block_length": (lambda x: x >= 2, "a block must be at least two correlation lengths λc long"),
    "push_height": (lambda x: x > 0, "the push must lie above the interface"),
    "push_width": (lambda x: x > 0, "the height of a pusher must be positive; blank where it covers everything above"),
    "machine_stiffness": (lambda x: x > 0, "the stiffness of a machine must be positive"),
    "block_width": (lambda x: x > 0, "the width of a block must be positive"),
    "displacement": (lambda x: x > 0, "a displacement at nucleation must be positive"),
    "force": (lambda x: x > 0, "a driving force must be positive"),
    "displacement_sigma": (lambda x: x > 0, "the standard error must be positive"),
    "force_sigma": (lambda x: x > 0, "the standard error must be positive"),
}
IN_LC = ("height", "length", "block_length", "push_height", "push_width")
"""Quantities held in λc."""
_ERROR_OF_INPUT = (lambda x: x >= 0, "a standard error cannot be negative")
MAY_BE_BLANK = (
    *("displacement", "displacement_sigma", "force", "force_sigma"),
    *("block_length", "machine_stiffness", "block_width", "push_height", "push_height_sigma", "push_width"),
)


def check_domain(values: Mapping[str, float], kind: str, where: str, columns: Mapping[str, tuple[str, str]]) -> None:
    """Refuse the first value outside its domain; `columns` gives the column and the text as the file has them.

    Raises
    ------
    MeasurementError
        Naming `where`, the column and the requirement.
    """

    def refuse(name: str, requirement: str) -> None:
        requirement += _likely_unit(name, values[name], columns)
        column, text = columns.get(name, (name, f"{values[name]:g}" + " λc" * (name.removesuffix("_sigma") in IN_LC)))
        raise MeasurementError(f"{where}, column {column}: {text}: {requirement}")

    if kind not in KINDS:
        raise MeasurementError(f"{where}, column kind: {kind!r}: one of {', '.join(KINDS)}")
    for name, value in values.items():
        if name in MAY_BE_BLANK and np.isnan(value):
            if not np.isnan(values.get(name.removesuffix("_sigma"), np.nan)):
                refuse(name, "missing: the value beside it has no standard error")
            continue
        inside, requirement = _DOMAIN.get(name, _ERROR_OF_INPUT)
        if not (np.isfinite(value) and inside(value)):
            refuse(name, requirement)
    _check_kind(values, kind, refuse)
    _check_push(values, refuse)


def _likely_unit(name: str, value: float, columns: Mapping[str, tuple[str, str]]) -> str:
    """Guess the unit of a number outside its domain: ``: is it in Pa?``; empty where none is likely."""
    column = columns.get(name, ("", ""))[0]
    if name == "young" and value > YOUNG.high and not column.endswith("_Pa"):
        return ": is it in Pa?"
    if name == "correlation_length" and 0 < value <= CORRELATION_LENGTH.low:
        return ": is it in m?" * (not column.endswith("_m"))
    if name == "height" and 0 < value <= 1 and "correlation_length" in columns:
        return f": is {column} in m, or {columns['correlation_length'][0]} in nm?"
    return ""


def _check_push(values: Mapping[str, float], refuse: Callable[[str, str], None]) -> None:
    """Check that the pusher lies on the side of the block."""
    height, at, width = values["height"], values.get("push_height", np.nan), values.get("push_width", np.nan)
    if at >= height:
        refuse("push_height", "not below the height of the block")
    if width >= height:
        refuse("push_width", "wider than the block is high")
    if not np.isnan(width) and np.isnan(at):
        refuse("push_height", "missing: the width beside it needs the height of its middle")
    if at - width / 2 <= 0 or at + width / 2 >= height:
        refuse("push_width", "reaches beyond the side of the block")


def _check_kind(values: Mapping[str, float], kind: str, refuse: Callable[[str, str], None]) -> None:
    """Check the length and its error, which depend on how it was measured."""
    if kind == "whole" and abs(values["length"] - round(values["length"])) > 1e-9 * values["length"]:
        refuse("length", "a count of whole contacts must be a whole number of λc")
    if values["length"] > values.get("block_length", np.inf) * (1 + 1e-9):
        refuse("length", "longer than the block; of a front that ran through it, the block's length as kind at_least")
    sigma = values.get("length_sigma", 1.0)
    if kind == "length" and sigma == 0:
        refuse("length_sigma", "the standard error of a length must be positive")
    if 0 < sigma < 1e-9 * values["length"]:
        refuse("length_sigma", "below a billionth of the length, which nothing measures")
