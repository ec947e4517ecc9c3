"""The first precursor: its length, and the full record."""

import functools
import math
import warnings
from functools import partial
from types import NoneType
from typing import Any, cast, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax.base.choices import EventKind
from slippulse_jax.base.domains import check_choice, check_kind, check_single, check_whole
from slippulse_jax.base.shown import html, in_a_line, short
from slippulse_jax.base.status import Outcome
from slippulse_jax.base.units import at_least_single
from slippulse_jax.block import Block
from slippulse_jax.blocks import size
from slippulse_jax.blocks.event import BlockPrecursor
from slippulse_jax.bodies.modes import (
    ChainFields,
    Modes,
    equilibrium_fields,
    lattice_modes,
)
from slippulse_jax.bulk.derivatives import under_grad_too
from slippulse_jax.bulk.double import is_traced
from slippulse_jax.events import first
from slippulse_jax.front import front
from slippulse_jax.front.arrest import (
    DEFAULT_MAX_CONTACTS,
    arrest,
    check_max_contacts,
    quantity,
    report_without_length,
)
from slippulse_jax.interface import AnyInterface, Interface, Profile
from slippulse_jax.lengths import whole_lengths
from slippulse_jax.rules import BreakRule, check_rule
from slippulse_jax.slider import Slider

FLOAT32_HEIGHT = 1000.0
"""Largest H/λc for which single precision is taken without a warning: see `precursor_length`."""


class FirstPrecursor(eqx.Module):
    """The first precursor of one slider, with the state of the chain before and after it.

    Lengths are in λc, displacements in u_s, stresses in σ_s.
    """

    slider: Slider
    contacts_broken: Int[Array, ""]  # s0, so that Λ = s0 λc
    length: Float[Array, ""]  # ℓ, the continuous length
    load: Float[Array, ""]  # U0, displacement of the drive (without a machine, of the left edge) at nucleation
    status: Int[Array, ""]  # an `Outcome`
    front_stress: Float[Array, " sites"]  # t(s): on contact s once all before it have broken, past the arrest too
    modes: Modes
    interface: Interface | Profile | None = None

    def fields_at(self, front_position: int | Array) -> ChainFields:
        """Fields when contacts 0 … front_position − 1 have broken: 0 is nucleation, `contacts_broken` is arrest."""
        site = jnp.arange(self.front_stress.shape[0])
        prestress = front.contact_at(self.modes, self.interface, site)[1]
        pinning = jnp.where(site < front_position, self.front_stress, 0)
        return equilibrium_fields(self.modes, self.load, pinning, prestress)

    @property
    def edge_stress(self) -> Float[Array, ""]:
        """Stress on contact 0 at arrest, the largest behind the front; in σ_s."""
        return self.arrest.stress[0]

    def __repr__(self) -> str:
        return in_a_line(self, "slider", "contacts_broken", "length", "load", "interface")

    def _repr_html_(self) -> str:
        rows = [
            ("length, ℓ/λc", short(self.length)),
            ("contacts broken", short(self.contacts_broken)),
            ("load at nucleation, U/u_s", short(self.load)),
            ("on", repr(self.slider)),
        ]
        one = not isinstance(self.status, Tracer) and np.ndim(self.status) == 0
        return html("First precursor", rows, below=Outcome(int(self.status)).message if one else "")

    def __str__(self) -> str:
        if isinstance(self.length, Tracer) or self.length.ndim:
            return repr(self)
        status, broken = Outcome(int(self.status)), int(self.contacts_broken)
        return (
            f"first precursor: {broken} contact{'s' * (broken != 1)} broken, length {float(self.length):.6g} λc, "
            f"load at nucleation {float(self.load):.6g} u_s; {status.message}"
        )

    @property
    def nucleation(self) -> ChainFields:
        """Fields when contact 0 carries its threshold and nothing has broken."""
        return self.fields_at(0)

    @property
    def arrest(self) -> ChainFields:
        """Fields when the front has stopped."""
        return self.fields_at(self.contacts_broken)


def precursor_length(
    slider: Slider | Block,
    interface: Interface | Profile | None = None,
    *,
    rule: BreakRule | None = None,
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
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
    slider : Slider or Block
        One slider or a batch; ℓ has its shape. Or one block, or a body of yours (docs/howto/extend.md), whose events are any
        contacts in any order, the most overloaded next, and end at the rightmost; derivatives are then those at a fixed order
        of breaks.
    interface : Interface or Profile, optional
        Prestress and thresholds; the paper's own (relaxed, uniform) by default. An `Interface`
        broadcasts with the slider; a `Profile` belongs to one slider.
    rule : BreakRule, optional
        What a contact does at its threshold: breaks as a whole (the paper's rule, by default), or gradually, over a width. The smooth
        length tends to that on a straight line as it gets narrower, and has a derivative in the width too; of blocks, where
        the event begins at the edge.
    sites : int, optional
        Number of contacts resolved of a block, of a body of yours, or of a slider in a whole event; all that there are of one
        with a `length`. Needed under ``jit`` and ``vmap``, and by a body of yours; otherwise as many as the event needs.
    max_contacts : int
        Breaks after which the front is given up.
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
    if not hasattr(slider, "contacts"):
        check_kind("slider", slider, Slider, Block)
    check_kind("interface", interface, Interface, Profile, NoneType)
    check_choice("event", event, EventKind)
    if not isinstance(slider, Slider):
        _check_of_block(max_contacts=max_contacts)
        check_rule(rule, one=True)
        if event == "full" and rule is not None:
            raise ValueError("event = 'full': under a smooth rule a front passes each contact once, so there is no other event")
        if isinstance(slider, Block):
            return size.precursor_length(slider, interface, sites, rule, event)
        check_whole("sites", sites, 2)
        return under_grad_too(partial(first.length, sites=sites, kind=event))(slider, interface, rule)
    if event == "full":
        return _whole(slider, interface, rule, sites, max_contacts)
    if sites is not None:
        raise ValueError(f"sites = {sites}: the front of a slider needs none; one that ends is Slider(…, length={sites})")
    check_max_contacts(max_contacts)
    check_rule(rule, one=isinstance(interface, Profile))
    warn_single_precision(slider)
    if isinstance(interface, Profile):
        check_single("a Profile", slider=slider)
    length = quantity("length", slider, interface, max_contacts, rule)
    if not isinstance(length, Tracer) and np.isnan(length).any():
        status = np.asarray(quantity("status", slider, interface, max_contacts, rule))
        report_without_length(status, max_contacts, raises=length.ndim == 0)
    return length


def _whole(slider: Slider, interface: AnyInterface, rule: BreakRule | None, sites: int | None, max_contacts: int) -> Array:
    """Lengths of whole events of sliders, each on `sites` contacts or as many as it needs."""
    if rule is not None:
        raise ValueError("event = 'full': under a smooth rule a front passes each contact once, so there is no other event")
    if isinstance(interface, Profile):
        check_single("a Profile", slider=slider)
    elif sites is None and not is_traced((slider, interface)):
        found = np.asarray(whole_lengths(slider, interface, rule, max_contacts))
        missing = np.where(np.isnan(found), Outcome.LIMIT, Outcome.ARRESTED)
        report_without_length(missing, max_contacts, raises=found.ndim == 0, stacklevel=4)
        return jnp.asarray(found)
    numbers, kind = jax.tree.flatten((slider, interface))
    on = under_grad_too(partial(size.resolved, sites=sites, event=partial(first.length, kind="full")))
    if isinstance(interface, Profile) or not (shape := np.broadcast_shapes(*map(np.shape, numbers))):
        return on((slider, interface))
    lanes = [jnp.broadcast_to(x, shape).ravel() for x in numbers]
    if sites is None:  # each has a number of its own
        return jnp.stack([on(jax.tree.unflatten(kind, one)) for one in zip(*lanes, strict=True)]).reshape(shape)
    return jax.vmap(lambda *one: on(jax.tree.unflatten(kind, one)))(*lanes).reshape(shape)


@overload
def first_precursor(
    slider: Block,
    interface: Interface | Profile | None = None,
    *,
    sites: int | None = None,
    event: EventKind = "domino",
) -> BlockPrecursor: ...
@overload
def first_precursor(
    slider: Slider,
    interface: Interface | Profile | None = None,
    *,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
    recorded_sites: int | None = None,
    event: EventKind = "domino",
) -> FirstPrecursor: ...
def first_precursor(
    slider: Slider | Block,
    interface: Interface | Profile | None = None,
    *,
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
    recorded_sites: int | None = None,
    event: EventKind = "domino",
) -> FirstPrecursor | BlockPrecursor:
    """Record of the first precursor: count, length, load, front stress, fields, status.

    Parameters
    ----------
    slider : Slider or Block
        One slider (fields of shape ()); ``jax.vmap`` over a batch. Or one block.
    interface, sites, max_contacts
        As for `precursor_length`.
    recorded_sites : int, optional
        Number of sites on which stress and fields are given: the whole of a finite chain by default, otherwise four
        to eight times the length of the front. Needed under ``jit`` and ``vmap``, where the length is not known beforehand,
        and there at least `contacts_broken` for the fields to be complete.
    event : {"domino", "full"}
        As for `precursor_length`. The record of the whole event of a slider is a `Rupture`.

    Raises
    ------
    FrontNotArrested
        If the front was given up and `recorded_sites` is missing, so that the length of the record is unknown. With it, the
        record has the status LIMIT. Under ``jit`` and ``vmap`` nothing is raised.
    ValueError
        If `slider` is a batch, or if `recorded_sites` is needed and missing or does not reach the arrest; if the whole event of
        a slider is asked for, or a block is traced in single precision.
    """
    check_kind("slider", slider, Slider, Block)
    check_kind("interface", interface, Interface, Profile, NoneType)
    check_choice("event", event, EventKind)
    if recorded_sites is not None:
        check_whole("recorded_sites", recorded_sites, 1)
    if isinstance(slider, Block):
        _check_of_block(max_contacts=max_contacts, recorded_sites=recorded_sites)
        return size.first_precursor(slider, interface, sites, event)
    if event == "full":
        raise ValueError("event = 'full': the record of a whole event of a slider is sp.rupture(sp.chain(slider, sites=…))")
    if sites is not None:
        raise ValueError(f"sites = {sites}: the front of a slider needs none; one that ends is Slider(…, length={sites})")
    check_max_contacts(max_contacts)
    check_single("first_precursor (precursor_lengths for many)", slider=slider, interface=interface)
    slider = cast(Slider, jax.tree.map(at_least_single, slider))
    interface = jax.tree.map(at_least_single, interface)
    warn_single_precision(slider)
    ended = _counted(*lax.stop_gradient((slider, interface)), max_contacts)
    traced = isinstance(ended.contacts_broken, Tracer)
    if recorded_sites is None:
        if traced and (slider.length is None or isinstance(slider.length, Tracer)):
            raise ValueError(
                "first_precursor under jit or vmap needs recorded_sites, because the length is not known beforehand: "
                "jax.vmap(lambda slider: first_precursor(slider, recorded_sites=200))(sliders)"
            )
        if slider.length is None:
            report_without_length(np.asarray(ended.status), max_contacts, raises=True)
        if slider.length is not None and np.isfinite(slider.length):
            recorded_sites = math.ceil(np.asarray(slider.length) - 0.5)
        else:  # a power of two, so that fronts of about the same length share a program
            recorded_sites = 1 << max(4 * int(ended.contacts_broken) - 1, 15).bit_length()
    if not traced and recorded_sites < int(ended.contacts_broken):
        raise ValueError(f"recorded_sites = {recorded_sites}, but {int(ended.contacts_broken)} contacts broke")
    modes = lattice_modes(slider)
    load, stress = _recorded(modes, interface, recorded_sites)
    return FirstPrecursor(
        slider=slider,
        contacts_broken=jnp.asarray(ended.contacts_broken),
        length=quantity("length", slider, interface, max_contacts),
        load=load,
        status=jnp.asarray(ended.status),
        front_stress=stress,
        modes=modes,
        interface=interface,
    )


_counted = jax.jit(arrest, static_argnums=2)


@partial(jax.jit, static_argnames="sites")
def _recorded(modes: Modes, interface: AnyInterface, sites: int) -> tuple[Array, Array]:
    """Load at nucleation, and front stress."""
    threshold, prestress = front.contact_at(modes, interface, 0)
    return modes.load * (threshold - prestress), front.front_stress(modes, sites, interface)


def _check_of_block(**given: Any) -> None:
    """Refuse what a block does not have."""
    for name, value in given.items():
        if value is not None and (name, value) != ("max_contacts", DEFAULT_MAX_CONTACTS):
            raise ValueError(f"{name} = {value!r}: not an option of a block, which has its own: Block(…, length=…, machine=…)")


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
