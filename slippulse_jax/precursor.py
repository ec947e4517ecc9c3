"""The first precursor: its length, and the full record."""

import contextlib
import functools
import math
import warnings
from functools import partial
from types import NoneType
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from slippulse_jax.base.choices import EventKind
from slippulse_jax.base.domains import check_choice, check_kind, check_single, check_whole
from slippulse_jax.base.status import Outcome
from slippulse_jax.base.units import at_least_single
from slippulse_jax.block import Block
from slippulse_jax.blocks import size
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.bodies.response import MOST_SITES
from slippulse_jax.bulk.derivatives import under_grad_too
from slippulse_jax.bulk.double import is_traced
from slippulse_jax.events import first
from slippulse_jax.events.first import FirstPrecursor
from slippulse_jax.front import front
from slippulse_jax.front.arrest import arrest, quantity, report_without_length
from slippulse_jax.interface import AnyInterface, Interface, Profile
from slippulse_jax.lengths import ROOM, whole_lengths
from slippulse_jax.rules import BreakRule, check_rule
from slippulse_jax.slider import Slider

FLOAT32_HEIGHT = 1000.0
"""Largest H/λc for which single precision is taken without a warning: see `precursor_length`."""


def precursor_length(
    body: Any,
    interface: Interface | Profile | None = None,
    *,
    rule: BreakRule | None = None,
    sites: int | None = None,
    event: EventKind = "domino",
) -> Float[Array, "..."]:
    """Length ℓ of the first precursor, in λc.

    ℓ is where the stress on the contact ahead falls to its threshold, on a polynomial through the last six contacts reached;
    through two, a straight line, where contacts differ (`Profile`) or break again. The whole-contact count of the
    paper is s0 = ceil(ℓ) (for s0 > 1), and Λ = s0 λc. Where the neighbour of the edge contact does not break there is no
    domino: s0 = 1, ℓ = 0, and ℓ is flat; where it starts to break, ℓ jumps from 0 to 1. On tall and stiff bodies a contact
    behind the front may be back at its threshold before the front stops: ℓ is the length of that front (status `REBREAK`).

    Parameters
    ----------
    body : Slider or Block
        One slider or a batch; ℓ has its shape. Or one block, or a body of yours (docs/howto/extend.md), whose events are any
        contacts in any order, the most overloaded next, and end at the rightmost; derivatives are then those at a fixed order
        of breaks.
    interface : Interface or Profile, optional
        Prestress and thresholds; the paper's own (relaxed, uniform) by default. An `Interface`
        broadcasts with the slider; a `Profile` belongs to one slider.
    rule : BreakRule, optional
        What a contact does at its threshold: breaks as a whole (the paper's rule, the default), or gradually, over a width.
        The smooth length tends to that on a straight line as it gets narrower, and has a derivative in the width too; of
        blocks, where the event begins at the edge.
    sites : int, optional
        Number of contacts resolved of a block, of a body of yours, or of a slider in a whole event; all that there are of one
        with a `length`. Needed under ``jit`` and ``vmap``, and by a body of yours; otherwise as many as the event needs.
    event : {"domino", "full"}
        The first front, in which each contact breaks at most once; or the whole event, in which contacts may break again, under
        the paper's rule. Both agree where none does, below b = 3.09 on relaxed sliders.

    Returns
    -------
    array
        ℓ ≥ 0; inf where the front reaches the right end of a finite chain or block, or, with a warning where nothing is traced,
        the last contact resolved of a block without end; NaN in the lanes of a batch, or under
        ``jit`` and ``vmap``, where the front was given up or the (traced) slider is not physical. A length that is not
        finite has no finite derivative.

    Raises
    ------
    FrontNotArrested
        If a single front, called outside ``jit``, was given up. A batch warns instead, and says which.
    ValueError
        If the event of a block does not stop within the contacts that can be followed. If a block, or the whole event of a
        slider, is traced by ``jit`` or ``vmap`` in single precision.

    Notes
    -----
    Differentiable in all numbers of the slider to any order, forward and reverse: the crossing is
    differentiated implicitly, by one pass of the recursion that carries a tangent each. From 1 on ℓ is continuous in the
    parameters, and agrees with the closed form ℓ* of `exact_length` to 1.4e-3 λc from six contacts on, 1e-9 from a hundred on.
    On a straight line the slope jumps at whole contacts: the longer side's is returned. Time is proportional to ℓ.

    In single precision the error stays below 0.01 λc up to H/λc = 1000, however soft the interface, and reaches 6e-4 of the
    length at H/λc = 1e5: above 1000 a warning says so, once; not under ``jit`` and ``vmap``, where the height is not known.
    Near the run-away prestress, where the length grows without bound, and on finite chains much shorter than 1/κ_2 it is up to
    a hundredth of the length. Work under ``jax.enable_x64(True)`` there. Blocks are computed in double precision whatever the
    JAX flags, under ``grad`` too.

    Examples
    --------
    >>> length = precursor_length(Slider(height=25.0, stiffness=0.03, poisson=0.3))
    >>> print(f"{float(length):.3f} λc")
    25.789 λc
    """
    _check(body, interface, event)
    check_rule(rule, one=not isinstance(body, Slider) or isinstance(interface, Profile))
    if event == "full" and rule is not None:
        raise ValueError("event = 'full': under a smooth rule a front passes each contact once, so there is no other event")
    if not isinstance(body, Slider):
        return size.precursor_length(body, interface, sites, rule, event)
    if isinstance(interface, Profile):
        check_single("a Profile", slider=body)
    if event == "full":
        return _whole(body, interface, sites)
    if sites is not None:
        raise ValueError(f"sites = {sites}: the front of a slider needs none; one that ends is Slider(…, length={sites})")
    warn_single_precision(body)
    length = quantity("length", body, interface, rule)
    if not isinstance(length, Tracer) and np.isnan(length).any():
        status = np.asarray(quantity("status", body, interface, rule))
        report_without_length(status, raises=length.ndim == 0)
    return length


def _whole(slider: Slider, interface: AnyInterface, sites: int | None) -> Array:
    """Lengths of whole events, on `sites` contacts or as many as needed."""
    numbers, kind = jax.tree.flatten((slider, interface))
    shape = () if isinstance(interface, Profile) else np.broadcast_shapes(*map(np.shape, numbers))
    on = under_grad_too(partial(size.resolved, sites=sites, event=partial(first.length, kind="full")))
    if sites is None and not isinstance(interface, Profile) and not is_traced(numbers):
        front, status = (quantity(name, slider, interface) for name in ("length", "status"))
        if not shape and status == Outcome.REBREAK and ROOM * front <= MOST_SITES:
            with contextlib.suppress(size.NotFollowed):
                return on(slider, interface)
        found = np.asarray(whole_lengths(slider, interface))  # many; the front alone; on larger contacts; without a length
        missing = np.where(np.isnan(found), Outcome.LIMIT, Outcome.ARRESTED)
        report_without_length(missing, raises=found.ndim == 0, stacklevel=4)
        return jnp.asarray(found)
    if not shape:
        return on(slider, interface)
    lanes = [jnp.broadcast_to(x, shape).ravel() for x in numbers]
    if sites is None:  # each has a number of its own
        return jnp.stack([on(*jax.tree.unflatten(kind, one)) for one in zip(*lanes, strict=True)]).reshape(shape)
    return jax.vmap(lambda *one: on(*jax.tree.unflatten(kind, one)))(*lanes).reshape(shape)


def first_precursor(
    body: Any,
    interface: Interface | Profile | None = None,
    *,
    sites: int | None = None,
    event: EventKind = "domino",
) -> FirstPrecursor:
    """Record of the first precursor: count, length, load, stresses, slip, status.

    Parameters
    ----------
    body : Slider or Block
        One slider (fields of shape ()); ``jax.vmap`` over a batch. Or one block, or a body of yours.
    interface
        As for `precursor_length`.
    sites : int, optional
        As for `precursor_length`; of the front of a slider, the number of contacts on which stress and slip are given: all of
        one that ends, else four to eight times the length by default. Needed under ``jit`` and ``vmap``, where the length is
        not known beforehand, and there at least `contacts_broken` for the record to be complete.
    event : {"domino", "full"}
        As for `precursor_length`.

    Raises
    ------
    FrontNotArrested
        If the front was given up. Under ``jit`` and ``vmap`` nothing is raised: the record has the status LIMIT.
    ValueError
        If `body` is a batch, or if `sites` is needed and missing or does not reach the arrest; if a block, or the whole event
        of a slider, is traced in single precision.
    """
    _check(body, interface, event)
    if isinstance(body, Slider):
        check_single("first_precursor (precursor_lengths for many)", slider=body, interface=interface)
    if not isinstance(body, Slider) or event == "full":
        return size.first_precursor(body, interface, sites, event)
    if sites is not None:
        check_whole("sites", sites, 1)
    slider = cast(Slider, jax.tree.map(at_least_single, body))
    interface = jax.tree.map(at_least_single, interface)
    warn_single_precision(slider)
    ended = _counted(*lax.stop_gradient((slider, interface)))
    traced = isinstance(ended.contacts_broken, Tracer)
    if not traced:
        report_without_length(np.asarray(ended.status), raises=True)
    if sites is None:
        if traced and (slider.length is None or isinstance(slider.length, Tracer)):
            raise ValueError(
                "first_precursor under jit or vmap needs sites, because the length is not known beforehand: "
                "jax.vmap(lambda slider: first_precursor(slider, sites=200))(sliders)"
            )
        if slider.length is not None and np.isfinite(slider.length):
            sites = math.ceil(np.asarray(slider.length) - 0.5)
        else:  # a power of two, so that fronts of about the same length share a program
            sites = 1 << max(4 * int(ended.contacts_broken) - 1, 15).bit_length()
    if not traced and sites < int(ended.contacts_broken):
        raise ValueError(f"sites = {sites}, but {int(ended.contacts_broken)} contacts broke")
    broken, length = jnp.asarray(ended.contacts_broken), quantity("length", slider, interface)
    fields = _of_front(slider, interface, broken, sites)
    return FirstPrecursor(
        slider, interface, broken, length, status=jnp.asarray(ended.status), first=0 * broken, breaks=broken, **fields
    )


_counted = jax.jit(arrest)


@partial(jax.jit, static_argnames="sites")
def _of_front(slider: Slider, interface: AnyInterface, broken: Array, sites: int) -> dict[str, Array]:
    """Fields of the record of a front that broke some contacts."""
    before, after = (front.front_fields(slider, interface, position=s, sites=sites) for s in (0 * broken, broken))
    modes = lattice_modes(slider)
    threshold, prestress = front.contact_at(modes, interface, 0)
    stress = front.front_stress(modes, sites, interface)
    return {
        "load": modes.load * (threshold - prestress),
        "stress_before": before.stress,
        "stress": after.stress,
        "slip": after.layer - before.layer,
        "pinning": jnp.where(jnp.arange(sites) < broken, stress - front.kept_at(interface, jnp.arange(sites)), 0),
        "front_stress": stress,
    }


def _check(body: Any, interface: Any, event: Any) -> None:
    if not hasattr(body, "contacts"):
        check_kind("body", body, Slider, Block)
    check_kind("interface", interface, Interface, Profile, NoneType)
    check_choice("event", event, EventKind)


@functools.lru_cache
def _warn_once(message: str) -> None:
    warnings.warn(f"single precision {message}. Use jax.enable_x64(True)", RuntimeWarning, stacklevel=4)


def warn_single_precision(slider: Slider) -> None:
    """Say once what single precision costs there."""
    if jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        return
    tall = slider.height > FLOAT32_HEIGHT
    try:
        if np.any(tall) if not isinstance(tall, Tracer) else bool(tall.any()):
            _warn_once(
                f"with H/λc above {FLOAT32_HEIGHT:g}: a precursor length is off by more than 0.01 λc (by 6e-4 of itself at "
                "H/λc = 1e5), those of precursor_lengths are not"
            )
    except jax.errors.TracerBoolConversionError:  # the number is known under grad, not under jit and vmap
        return
