"""Readings of gauges along the interface after measured precursors have stopped, and the CSV file they come in.

One reading a line, with the units in the column names: ``label`` (of the precursor, as in the table of lengths),
``position_mm`` from the pushed edge, and ``slip_um`` with ``slip_sigma_um``, or ``stress_MPa`` with ``stress_sigma_MPa``, or
both; blank where one was not measured. Lines that start with ``#`` are comments.
"""

import dataclasses
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from slippulse_jax.inference.csv_text import labelled_table
from slippulse_jax.inference.measurements import MeasurementError, set_columns

UNITS = {"position_mm": 1e-3, "slip_um": 1e-6, "slip_sigma_um": 1e-6, "stress_MPa": 1e6, "stress_sigma_MPa": 1e6}
READINGS = ("slip", "stress")


@dataclasses.dataclass(frozen=True, eq=False)
class Gauges:
    """Readings along the interface, one entry a reading.

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
        set_columns(self, NUMERIC)
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


NUMERIC = ("row", "position", "slip", "slip_sigma", "stress", "stress_sigma")


def read_gauges(path: str | os.PathLike[str], labels: Sequence[str]) -> Gauges:
    """Read a CSV file of gauges (its columns are in the documentation of this module).

    Parameters
    ----------
    path : path
    labels : sequence of str
        Labels of the measured precursors.

    Raises
    ------
    MeasurementError
        Naming file, line and column.
    """
    table = labelled_table(path, labels, UNITS, required=("position_mm",))
    return Gauges(table.row, **table.columns, lines=table.lines, source=os.fspath(path))
