"""First events that would be noticed, of contacts whose thresholds differ.

The weakest contact breaks first, wherever it is, and small events go before the first that an apparatus shows. So what is
measured is a draw from a distribution: each set of thresholds has its own series of events, from the relaxed body.
"""

from types import NoneType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, Int
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.base.domains import THRESHOLD_SCATTER, Domain, check_domain, check_kind, check_single, check_whole
from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.base.units import as_float
from slippulse_jax.block import Block, checked_sites
from slippulse_jax.bodies.response import MOST_SITES
from slippulse_jax.bulk.compiler import lane_by_lane
from slippulse_jax.bulk.derivatives import without_derivative
from slippulse_jax.bulk.double import in_double
from slippulse_jax.events.event import BREAKS_PER_SITE, MORE_SITES
from slippulse_jax.events.first import Relaxed
from slippulse_jax.events.series import Adiabatic, Loading, check_pusher, load_through
from slippulse_jax.interface import AnyInterface, Interface, Profile
from slippulse_jax.slider import Slider

VISIBLE = Domain(0, np.inf, "must be positive: the least extent of an event that is noticed, in λc")
HEIGHTS = 3
"""Heights of a body without end along which contacts may break at first."""
FARTHEST_DRAW = 5
"""Errors of a normal distribution beyond which no threshold is expected."""


class Scattered(NamedTuple):
    """First events that would be noticed, one per draw of thresholds."""

    length: Float[Array, " draws"]  # ℓ, from the edge to where the event ends; inf where it reaches the end of the body
    load: Float[Array, " draws"]  # displacement of the pusher at which it begins, in u_s
    force: Float[Array, " draws"]  # on the pusher as it begins, in K u_s
    left: Int[Array, " draws"]  # leftmost contact that broke; 0 where the event touches the edge
    before: Int[Array, " draws"]  # events before it, which nobody sees
    status: Int[Array, " draws"]  # an `Outcome`


def scattered(
    body: Any,
    interface: Interface | Profile | None = None,
    *,
    threshold_scatter: Float[AnyArrayLike, ""],
    visible: Float[AnyArrayLike, ""],
    draws: int = 200,
    seed: int = 0,
    sites: int | None = None,
) -> Scattered:
    """Draw first events of contacts whose thresholds scatter.

    Events follow one another from the relaxed body, its edge displaced. The first is returned whose own extent, from its left
    end to its right one, is at least `visible`.

    Parameters
    ----------
    body : Slider or Block
        One, or a body of yours (docs/howto/extend.md).
    interface : Interface or Profile, optional
        Mean thresholds, prestress, and what contacts keep.
    threshold_scatter : array_like, shape ()
        Standard deviation s of the thresholds over their mean. They are normal, independent from contact to contact, and at
        least a twentieth of the mean.
    visible : array_like, shape ()
        Least extent of an event that is noticed, in λc. It belongs to the apparatus, and moves the length more than most.
    draws : int
        Number of draws. The first draws are the same whatever their number, as are the first contacts of longer bodies.
    seed : int
        Seed of the draws.
    sites : int, optional
        Number of contacts of a body without end that may break. By default three heights, and more where an event needs them.
        Needed under ``jit`` and ``vmap``.

    Returns
    -------
    Scattered
        ``length``, ``load``, ``force``, ``left``, ``before`` and ``status``, of shape (draws,).

    Raises
    ------
    ValueError
        If an argument is outside its domain, or the prestress so near to 1 that a contact would begin beyond its threshold.
    NotConverged
        If an event of a body without end does not stop within the contacts that can be resolved, and nothing is traced.
    TypeError
        If it is differentiated: a comparison decides which contact breaks next.

    Notes
    -----
    Some 3 µs a break on one core: 65 µs a draw at H/λc = 50, 350 µs at 200. A program is compiled for each number of contacts.

    Examples
    --------
    >>> found = scattered(Slider(50.0, 0.01, 0.3), threshold_scatter=0.05, visible=5.0)
    >>> print(f"{float(found.length.mean()):.0f} λc")
    35 λc
    """
    if not hasattr(body, "contacts"):
        check_kind("body", body, Slider, Block)
    check_kind("interface", interface, Interface, Profile, NoneType)
    check_pusher(body, Adiabatic())
    if isinstance(body, Slider):
        check_single("scattered", slider=body)
    given = []
    for name, value, domain in (("threshold_scatter", threshold_scatter, THRESHOLD_SCATTER), ("visible", visible, VISIBLE)):
        domain.check(name, value)
        given.append(as_float(name, value))
        if given[-1].ndim:
            raise ValueError(f"{name} has shape {given[-1].shape}: give one number; jax.vmap for many")
    check_whole("draws", draws, 1)
    if not isinstance(seed, Tracer):
        check_whole("seed", seed, 0)
    check_prestress(interface, threshold_scatter)
    ends = sites is not None or getattr(body, "sites", None) is not None
    for count in _sites(body, sites):
        found = in_double(_hard_draws)((int(draws), count), body, interface, *given, jnp.asarray(seed))
        if not isinstance(found.status, Tracer) and (found.status == Outcome.INVALID).any():
            raise ValueError(f"{body}: {Outcome.INVALID.message}, or a threshold that was drawn is below the prestress")
        if isinstance(found.status, Tracer) or ends or not (found.status == Outcome.SPANNED).any():
            return found
    raise NotConverged(f"{body}: of some draws events reach beyond {MOST_SITES} contacts")


def check_prestress(interface: AnyInterface, scatter: Any) -> None:
    """Refuse a prestress at which contacts of low threshold would break unloaded."""
    prestress = 0.0 if interface is None else interface.prestress
    if not isinstance(prestress, Tracer) and not isinstance(scatter, Tracer):
        most = 1 - FARTHEST_DRAW * float(scatter)
        what = f"must be at most 1 − {FARTHEST_DRAW} s = {most:g}, or a contact begins beyond its threshold"
        check_domain("prestress", prestress, lambda x: x <= most, what)


def _sites(body: Any, sites: int | None) -> list[int]:
    """Numbers of contacts to try in turn."""
    if sites is not None or getattr(body, "sites", None) is not None:
        return [checked_sites(body, sites)]
    height = getattr(body, "height", None)
    if height is None or isinstance(height, Tracer):
        return [checked_sites(body, None)]  # which says what is missing
    found, every = min(int(np.ceil(HEIGHTS * float(height))), MOST_SITES), []
    while found < MOST_SITES:
        every.append(found)
        found *= MORE_SITES
    return [*every, MOST_SITES]


def _draws(
    shape: tuple[int, int], body: Any, interface: AnyInterface, scatter: Array, visible: Array, seed: Array
) -> Scattered:
    draws, sites = shape

    def resolved(body: Any, interface: AnyInterface, scatter: Array, visible: Array, seed: Array) -> Scattered:
        contacts = body.contacts(interface, sites)

        def one(key: Array) -> Scattered:
            found = events_noticed(contacts.scattered(scatter, key), visible, visible, 1)
            return found._replace(**{name: getattr(found, name)[0] for name in ("length", "load", "force", "left")})

        return lax.map(one, jax.random.split(jax.random.key(seed), draws))

    return lane_by_lane(resolved, body, interface, scatter, visible, seed)


_hard_draws = without_derivative(
    _draws,
    "events of contacts that scatter cannot be differentiated: a comparison decides which contact breaks next",
    static_argnums=(0,),
)


def events_noticed(contacts: Relaxed, least: Array, visible: Array, most: int) -> Scattered:
    """Follow one draw until an event is noticed.

    Returned are the first event whose own extent is at least `least`, and all after it that are larger than those before, up to
    the one that is at least `visible`; of length `most` each, NaN after the last.
    """
    contacts = contacts.up_to(contacts.last)
    sound = (contacts.threshold > contacts.prestress).all() & jnp.isfinite(contacts.response.matrix[:, 0]).all()
    limit, no_load = jnp.int32(BREAKS_PER_SITE * contacts.threshold.size), jnp.asarray(jnp.inf)
    loading = Loading(
        Adiabatic(), None, no_load, jnp.ones((), bool), limit, jnp.asarray(contacts.last), noticed=(least, visible)
    )
    body = contacts._replace(valid=contacts.valid & sound)
    end = load_through((most, 0, 0, contacts.threshold.size), body, loading)
    length, load, force, left = (end.rows[name][:-1] for name in ("length", "load", "force_before", "leftmost"))
    return Scattered(length, load, force, left, end.number - 1, end.ending)
