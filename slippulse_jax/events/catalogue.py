"""Catalogue of the events of a series."""

from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, Int

from slippulse_jax.base.domains import real_numbers
from slippulse_jax.base.shown import html, short
from slippulse_jax.base.status import Outcome, Status
from slippulse_jax.bodies.chain import State

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
        """Return the columns as NumPy arrays, without the empty rows.

        Raises
        ------
        ValueError
            If the catalogue is a batch.
        """
        if np.ndim(self.number):
            raise ValueError(f"the catalogue is a batch of shape {np.shape(self.number)}: take one series at a time")
        rows = int(self.number)
        return {name: np.asarray(getattr(self, name))[:rows] for name in COLUMNS}

    def __repr__(self) -> str:
        if np.ndim(self.number):
            return f"Catalogue(a batch of shape {np.shape(self.number)})"
        return f"Catalogue(number={short(self.number)}, load={short(self.load)}, length={short(self.length)})"

    def _repr_html_(self) -> str:
        if np.ndim(self.number):
            return html(repr(self), [])
        frame: Any = self.to_dataframe()[["load", "kind", "site", "length", "breaks", "slip", "stress_drop"]]
        rows = [
            [str(event), *(x if isinstance(x, str) else f"{x:g}" for x in row)]
            for event, row in zip(frame.index, frame.itertuples(index=False), strict=True)
        ]
        return html("Catalogue of events", rows, ["event", *map(heading, frame)], Outcome(int(self.status)).message)

    def to_dataframe(self) -> "pd.DataFrame":
        """Return a pandas.DataFrame with classes in words and ``attrs["units"]``; pandas writes it."""
        import pandas as pd

        frame = pd.DataFrame(self.table()).rename_axis("event")
        frame["kind"] = [EventClass(kind).name.lower() for kind in frame["kind"]]
        frame.attrs["units"] = dict(COLUMNS)
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
        events, status, asked = self.table(), int(self.status), real_numbers("load", load)
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
        """Force at which the front first reaches a position, F^x(x).

        That on the edge, or on the pusher, as the first event begins that gets as far. An event that reached ℓ at the force F
        says F^x(ℓ) = F, however the front crept before it, and this hardly depends on how finely the edge is moved or on the
        size of the contacts, as the number and the length of events do. Twin of `reach`; composes with ``jit`` and ``vmap``.

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
    "load": "u_s", "force_before": "K u_s", "force_after": "K u_s", "site": "1", "leftmost": "1", "extent": "lambda_c",
    "length": "lambda_c", "breaks": "1", "slip": "u_s", "stress_drop": "sigma_s", "work": "K u_s^2", "stored": "K u_s^2",
    "broken": "K u_s^2", "relaxed": "K u_s^2", "kind": "1",
}  # fmt: skip
"""Columns of a catalogue and their units."""


def heading(name: str) -> str:
    """Name of a column with its unit."""
    return name if COLUMNS[name] == "1" else f"{name} ({COLUMNS[name]})"
