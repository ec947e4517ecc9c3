"""Catalogue of the events of a series, and its export with units."""

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, Int

from slippulse_jax.bodies.chain import State
from slippulse_jax.domains import real_numbers
from slippulse_jax.files import write_atomically
from slippulse_jax.shown import html, short
from slippulse_jax.status import Outcome, Status

if TYPE_CHECKING:
    import pandas as pd


class EventClass(Status):
    """Class of an event; the first one that applies."""

    SPANNING = 0, "broke the last contact of the chain"
    EDGE = 1, "nucleated at the left edge"
    RENUCLEATED = 2, "nucleated at the stress peak just ahead of where an earlier event had been arrested"
    INTERIOR = 3, "nucleated elsewhere"


class Catalogue(NamedTuple):
    """Events of a series, in order.

    Displacements are in u_s, stresses in σ_s, forces in K u_s and energies in K u_s². Rows beyond `number` are empty: kind −1,
    numbers NaN or 0.
    """

    load: Float[Array, " E"]  # U (with a spring, that of the driver)
    force_before: Float[Array, " E"]  # on the left edge, as the event starts
    force_after: Float[Array, " E"]
    site: Int[Array, " E"]  # site that broke first
    leftmost: Int[Array, " E"]
    extent: Int[Array, " E"]  # sites from the left edge to the rightmost broken one, which is among them
    length: Float[Array, " E"]  # ℓ, as of `rupture`; inf where the last contact broke
    breaks: Int[Array, " E"]
    slip: Float[Array, " E"]  # sum over contacts of the shifts of their pinning points
    stress_drop: Float[Array, " E"]  # sum over contacts of the stress before − after
    work: Float[Array, " E"]  # of the drive since the previous event
    stored: Float[Array, " E"]  # potential energy after the event: all work so far minus broken and relaxed
    broken: Float[Array, " E"]  # energy of the stretch of the contacts that broke
    relaxed: Float[Array, " E"]  # energy released as the chain relaxed after the breaks
    kind: Int[Array, " E"]  # an EventClass
    number: Int[Array, ""]  # number of events
    break_site: Int[Array, " L"]  # site of every break in order, up to `recorded_breaks`; −1 beyond
    break_event: Int[Array, " L"]
    state: State  # at the end
    strength: Float[Array, ""]  # force with all contacts at their thresholds, in K u_s: with friction μF_N, of μ times the load
    drift: Float[Array, ""]  # largest error of a stress, accumulated over all breaks, in σ_s
    energy_drift: Float[Array, ""]  # difference of `stored` at the end from the energy of the chain solved afresh
    status: Int[Array, ""]  # an Outcome

    def table(self) -> dict[str, np.ndarray]:
        """Return the columns of the catalogue, without its empty rows."""
        return table(self)

    def __repr__(self) -> str:
        if np.ndim(self.number):
            return f"Catalogue(a batch of shape {np.shape(self.number)})"
        return f"Catalogue(number={short(self.number)}, load={short(self.load)}, length={short(self.length)})"

    def _repr_html_(self) -> str:
        if np.ndim(self.number):
            return html(repr(self), [])
        frame = self.to_dataframe()[["load", "kind", "site", "length", "breaks", "slip", "stress_drop"]]
        rows = [
            [str(event), *(x if isinstance(x, str) else f"{x:g}" for x in row)]
            for event, row in zip(frame.index, frame.itertuples(index=False), strict=True)
        ]
        return html("Catalogue of events", rows, _heads(frame), Outcome(int(self.status)).message)

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the events as a pandas.DataFrame, one per row, with the class of each in words and units in ``attrs``."""
        import pandas as pd

        frame = pd.DataFrame(table(self)).rename_axis("event")
        frame["kind"] = [EventClass(kind).name.lower() for kind in frame["kind"]]
        frame.attrs["units"] = {name: unit for name, (unit, _) in COLUMNS.items()}
        return frame

    def reach(self, load: ArrayLike) -> np.ndarray:
        """Interpolate the farthest position reached by fronts at a load, in λc.

        The interpolation is linear between the events that got farther than all earlier ones. After the last of these the
        position stays constant, up to the load at which the series ends. The number of events depends on how finely the edge
        is moved; the position reached at a load hardly does (``docs/model/series.md``).

        Parameters
        ----------
        load : array_like
            In u_s.

        Returns
        -------
        numpy.ndarray
            0 before the first event, inf from the load at which the last contact breaks. NaN where the position is unknown:
            beyond the load of the last event (unless the series ended because no load breaks a further contact), and from
            the load of an event that reached `max_breaks`.

        Raises
        ------
        ValueError
            If the catalogue is a batch.
        """
        events, status, asked = table(self), int(self.status), real_numbers("load", load)
        loads, lengths = events["load"], events["length"]
        if status == Outcome.LIMIT:
            loads, lengths, known = loads[:-1], lengths[:-1], asked < loads[-1]
        else:
            known = (asked <= loads.max(initial=0)) | (status == Outcome.NOTHING_LEFT)
        farther = lengths > np.maximum.accumulate(np.append(0, lengths))[:-1]
        stopped, spanned = farther & np.isfinite(lengths), loads[np.isinf(lengths)].min(initial=np.inf)
        found = np.interp(asked, loads[stopped], lengths[stopped], left=0.0) if stopped.any() else np.zeros(asked.shape)
        return np.select([asked >= spanned, known], [np.inf, found], np.nan)

    def force_at(self, position: ArrayLike, strength: ArrayLike = 1.0) -> Float[Array, "..."]:
        """Force at which the front first reaches a position, F^x(x): the twin of `reach`.

        That on the edge, or on the pusher, as the first event begins that gets as far. An event that reached ℓ at the force F
        says F^x(ℓ) = F, however the front crept before it, and this hardly depends on how finely the edge is moved or on the
        size of the contacts, as the number and the length of events do. Composes with ``jit`` and ``vmap``.

        Parameters
        ----------
        position : array_like
            In λc, from the left edge.
        strength : array_like
            μF_N in the unit of the force wanted, as 400.0 for 400 N; by default forces are over μF_N or, without friction,
            over the force at which all contacts would be at their thresholds.

        Returns
        -------
        array
            NaN beyond what the series reached or the body has.
        """
        asked = jnp.asarray(position, self.length.dtype)
        there = jnp.arange(self.length.size, dtype=jnp.int32) < self.number
        farthest = lax.cummax(jnp.where(there, self.length, -jnp.inf))
        event = jnp.searchsorted(farthest, asked)
        known = (event < self.number) & (asked >= 0) & (asked <= self.state.pinning.size)
        force = self.force_before[jnp.minimum(event, self.length.size - 1)]
        return jnp.where(known, force / self.strength * jnp.asarray(strength), jnp.nan)


COLUMNS = {
    "load": ("u_s", "displacement of the left edge, or of the driver, at the event"),
    "force_before": ("K u_s", "force on the left edge as the event starts"),
    "force_after": ("K u_s", "force on the left edge after the event"),
    "site": ("1", "contact that broke first, from 0 at the left edge"),
    "leftmost": ("1", "leftmost broken contact"),
    "extent": ("lambda_c", "distance from the left edge to beyond the rightmost broken contact"),
    "length": ("lambda_c", "the same between contacts: where the stress ahead falls to the threshold"),
    "breaks": ("1", "number of breaks"),
    "slip": ("u_s", "sum over contacts of how far their pinning points moved"),
    "stress_drop": ("sigma_s", "sum over contacts of stress before minus after"),
    "work": ("K u_s^2", "work of the drive since the event before"),
    "stored": ("K u_s^2", "potential energy after the event"),
    "broken": ("K u_s^2", "energy of the stretch of the contacts that broke"),
    "relaxed": ("K u_s^2", "energy released as the chain relaxed"),
    "kind": ("1", "class of the event: " + ", ".join(f"{c.value} {c.name.lower()}" for c in EventClass)),
}


def table(catalogue: Catalogue) -> dict[str, np.ndarray]:
    """Return a catalogue's columns as NumPy arrays, without its empty rows.

    Raises
    ------
    ValueError
        If the catalogue is a batch.
    """
    if np.ndim(catalogue.number):
        raise ValueError(f"the catalogue is a batch of shape {np.shape(catalogue.number)}: write one series at a time")
    rows = int(catalogue.number)
    return {name: np.asarray(getattr(catalogue, name))[:rows] for name in COLUMNS}


def _heads(columns: Iterable[str]) -> list[str]:
    """Names of columns with their units, after that of the event's number."""
    return ["event", *(name if COLUMNS[name][0] == "1" else f"{name} ({COLUMNS[name][0]})" for name in columns)]


def to_csv(catalogue: Catalogue) -> str:
    """Format a catalogue as CSV: names with their units, then numbers in full precision."""
    columns = table(catalogue)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_heads(columns))
    for event, row in enumerate(zip(*columns.values(), strict=True)):
        cells = [EventClass(int(x)).name.lower() if name == "kind" else x.item() for name, x in zip(columns, row, strict=True)]
        writer.writerow([event, *cells])
    return text.getvalue()


def to_dataset(catalogue: Catalogue) -> Any:
    """Convert a catalogue to an ``xarray.Dataset`` with units and descriptions."""
    import xarray

    variables = {
        name: ("event", values, {"units": COLUMNS[name][0], "long_name": COLUMNS[name][1]})
        for name, values in table(catalogue).items()
    }
    status = Outcome(int(catalogue.status))
    attributes = {
        "status": status.name.lower(),
        "message": status.message,
        "drift": float(catalogue.drift),
        "energy_drift": float(catalogue.energy_drift),
    }
    return xarray.Dataset(variables, attrs=attributes)


def write_series(path: str | Path, catalogue: Catalogue) -> None:
    """Write a catalogue to ``.csv`` or ``.nc``, atomically.

    Raises
    ------
    ValueError
        If the suffix is neither of these, or the catalogue is a batch.
    """
    path = Path(path)
    if path.suffix == ".csv":
        write_atomically(path, to_csv(catalogue).encode())
    elif path.suffix == ".nc":
        content = to_dataset(catalogue).to_netcdf(engine="h5netcdf")
        write_atomically(path, bytes(content))
    else:
        raise ValueError(f"{path}: the suffix of a series must be .csv or .nc")
