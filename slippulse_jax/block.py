"""A block under two-dimensional elasticity, and what pushes its side.

Lengths are in λc, stiffnesses in K = Eλc, contact stretches in u_s = f_s/k, hence stresses in σ_s, as for a slider.
"""

import functools
import operator
from collections.abc import Container
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax.base import domains
from slippulse_jax.base.choices import ContactLaw, Control, Top
from slippulse_jax.base.shown import html, in_a_line, short
from slippulse_jax.base.units import Numbers, as_float, machine_ratio, quantity_field
from slippulse_jax.slider import Real, Slider, from_si

if TYPE_CHECKING:
    from slippulse_jax.events.first import Relaxed
    from slippulse_jax.interface import Interface, Profile

Plane = Literal["stress", "strain"]

USUAL_NORMAL_STIFFNESS = 1.2
"""k_n/k where thresholds follow the pressure and none is given: (2 − ν)/(2 − 2ν) of rough elastic contacts, 1.21 at ν = 0.3."""
RIGID = 1e12
"""k_n/k so large that no digit tells it from infinity, where the pressure is still to be read."""

MOST_CONTACTS = 2**13
"""Largest number of contacts resolved of a block, whose response is a matrix of that size."""
LENGTH = domains.Domain(2, 2**31 - 1, "a block is at least two contacts long, and less than 2**31 - 1", closed="low")
_DOMAIN = {
    "height": domains.HEIGHT, "stiffness": domains.STIFFNESS, "poisson": domains.POISSON,
    "normal_stiffness": domains.NORMAL_STIFFNESS, "friction": domains.FRICTION, "machine": domains.MACHINE,
}  # fmt: skip
OF_SIDE = domains.Domain(0, 1, "must lie in (0, 1): a part of the height of the block")


def _one(name: str, x: Any) -> Any:
    x = as_float(name, x)
    if np.shape(x):
        raise ValueError(f"{name} has shape {np.shape(x)}: one block at a time; use jax.vmap")
    return x


def _one_or_none(name: str, x: Any) -> Any:
    return None if x is None else _one(name, x)


def _finite_or_none(name: str, x: Any) -> Any:
    x = _one_or_none(name, x)
    return x if x is None or isinstance(x, Tracer) or not np.isposinf(x) else None


def _whole_or_none(x: Any) -> Any:
    if x is None or (isinstance(x, Tracer) and jnp.issubdtype(x.dtype, jnp.integer)):
        return x
    if isinstance(x, Tracer):
        raise ValueError("Block.length is traced, and no integer: it is a number of contacts, in which there is no derivative")
    length = np.asarray(_one("Block.length", x))
    LENGTH.check("Block.length", length)
    if np.rint(length) != length:
        raise ValueError(f"Block.length = {x}: must be a whole number of contacts")
    return length.astype(np.int32)


class Push(eqx.Module):
    """A pusher on the left side of a block.

    It is rigid where it imposes a displacement.

    Parameters
    ----------
    height : float, optional
        Height of its centre over H; without `width`, of its lower end: it then covers everything above. Without either it
        covers the whole side.
    width : float, optional
        Height of the part of the side that it covers, over H.
    control : {"displacement", "force"}
        What is held while an event runs: its displacement; or its force, a uniform traction.

    Raises
    ------
    ValueError
        If it does not lie on the side; values traced by JAX are not checked.
    """

    height: Float[Real, ""] | None = None
    width: Float[Real, ""] | None = None
    control: Control = eqx.field(default="displacement", static=True)

    def __init__(self, height: Numbers | None = None, width: Numbers | None = None, control: Control = "displacement") -> None:
        self.height, self.width, self.control = _one_or_none("Push.height", height), _one_or_none("Push.width", width), control

    def __check_init__(self) -> None:
        domains.check_choice("Push.control", self.control, Control)
        if self.height is None:
            if self.width is not None:
                raise ValueError("Push.width is given without a height: say at what height its centre is")
            return
        OF_SIDE.check("Push.height", self.height)
        if self.width is None:
            return
        OF_SIDE.check("Push.width", self.width)
        low, high = self.reach
        if not isinstance(low, Tracer) and not (low > 0 and high < 1):
            raise ValueError(
                f"Push.width = {float(self.width):g} about height = {float(self.height):g}: reaches from {float(low):g} to "
                f"{float(high):g} H, beyond the side of the block"
            )

    def __repr__(self) -> str:
        return in_a_line(self)

    @property
    def reach(self) -> tuple[Array, Array]:
        """Heights of its ends, over H."""
        if self.height is None:
            return jnp.zeros(()), jnp.ones(())
        centre = jnp.asarray(self.height)
        if self.width is None:
            return centre, jnp.ones_like(centre)
        half = jnp.asarray(self.width) / 2
        return centre - half, centre + half


def checked_sites(body: Any, sites: Any) -> int:
    """Number of contacts to resolve: all of a body that ends."""
    own = getattr(body, "sites", None)
    count = sites if own is None or isinstance(own, Tracer) else int(own)
    if count is None:
        raise ValueError(f"sites = None: {body} states no end, so give the number of contacts to resolve")
    domains.check_whole("sites", count if sites is None else sites, 2)
    found = int(count)
    if found > MOST_CONTACTS:
        raise ValueError(f"sites = {found}: at most {MOST_CONTACTS} contacts of a body are resolved")
    if sites is not None and sites < found:
        raise ValueError(f"sites = {sites}: a {type(body).__name__.lower()} of {found} contacts needs all of them")
    return found


def has_push(given: Container[str], control: Control) -> bool:
    """Whether columns describe a push; refuse a width without a height."""
    Push(control=control)
    if "push_height" not in given and ("push_width" in given or control != "displacement"):
        raise ValueError("push_width and push_control describe a push: give push_height too")
    return "push_height" in given


class Block(eqx.Module):
    """An elastic block on λ-contacts, pushed at its left side.

    Its right end, if it has one, is free. With a friction coefficient, thresholds follow the pressure, which the push tilts.

    Parameters
    ----------
    height : float
        H/λc; > 1.
    stiffness : float
        k/K of one contact, with K = Eλc; > 0.
    poisson : float
        ν; in (−1, 0.5], below 0.5 in plane strain.
    push : Push
        Everything above a quarter of the height by default.
    plane : {"stress", "strain"}
    length : int, optional
        L/λc, the number of contacts; ≥ 2. Without it the block is half-infinite to the right.
    normal_stiffness : float, optional
        k_n/k, by which the interface resists its bottom moving up or down, per area that of shear; > 0. Without it, and at inf,
        the bottom may neither leave the track nor enter it (u_y = 0). With a friction coefficient it is 1.2 by default, the
        (2 − ν)/(2 − 2ν) of rough elastic contacts at ν = 0.3.
    friction : float, optional
        μ ≥ 0: a contact breaks at the shear stress μp. The load that presses the block alone gives a uniform pressure p̄;
        stresses are then in σ_s = μp̄. Without it every contact breaks at σ_s.
    contact_law : {"amontons", "multicontact"}
        What follows the pressure: the threshold; or the threshold and both stiffnesses, p = p̄ exp(−u_y/ℓ_n), as of rough
        surfaces in contact, which then break at a constant displacement.
    top : {"free", "held"}
        Whether the top is free under a dead load, or held level and at its height (u_y = 0 once pressed).
    machine : float, optional
        M/K, the stiffness of the machine over the width of the block and E; > 0. The machine stays where it is while an event
        runs, and displaces the pusher through that spring; loads are then its displacement. Without it, and at inf, the
        displacement of the pusher is imposed.

    Raises
    ------
    ValueError
        If a value lies outside its domain; values traced by JAX are not checked.
    """

    height: Float[Real, ""] = quantity_field("H/\\lambda_c", "1", "", "height of the block, H/λc")
    stiffness: Float[Real, ""] = quantity_field("k/K", "1", "cra41", "contact stiffness, k/K")
    poisson: Float[Real, ""] = quantity_field("\\nu", "1", "cra05", "Poisson's ratio")
    push: Push = eqx.field(default_factory=lambda: Push(0.25))
    plane: Plane = eqx.field(default="stress", static=True)
    length: Int[Array | np.ndarray, ""] | None = None
    normal_stiffness: Float[Real, ""] | None = None
    friction: Float[Real, ""] | None = None
    contact_law: ContactLaw = eqx.field(default="amontons", static=True)
    top: Top = eqx.field(default="free", static=True)
    machine: Float[Real, ""] | None = None

    def __init__(
        self,
        height: Numbers,
        stiffness: Numbers,
        poisson: Numbers,
        push: Push = Push(0.25),  # noqa: B008 - a constant
        plane: Plane = "stress",
        length: Numbers | None = None,
        normal_stiffness: Numbers | None = None,
        friction: Numbers | None = None,
        contact_law: ContactLaw = "amontons",
        top: Top = "free",
        machine: Numbers | None = None,
    ) -> None:
        self.height, self.stiffness = _one("Block.height", height), _one("Block.stiffness", stiffness)
        self.poisson, self.friction = _one("Block.poisson", poisson), _one_or_none("Block.friction", friction)
        self.push, self.plane, self.contact_law, self.top = push, plane, contact_law, top
        self.length, self.machine = _whole_or_none(length), _finite_or_none("Block.machine", machine)
        self.normal_stiffness = _finite_or_none("Block.normal_stiffness", normal_stiffness)
        if friction is not None and self.normal_stiffness is None:
            self.normal_stiffness = np.asarray(USUAL_NORMAL_STIFFNESS if normal_stiffness is None else RIGID)

    def __check_init__(self) -> None:
        for name, choices in (("plane", Plane), ("contact_law", ContactLaw), ("top", Top)):
            domains.check_choice(f"Block.{name}", getattr(self, name), choices)
        if self.friction is None and self.contact_law != "amontons":
            raise ValueError(f"Block.contact_law = {self.contact_law!r}: says what follows the pressure: give friction too")
        domains.check_kind("Block.push", self.push, Push)
        for name, domain in _DOMAIN.items():
            value = getattr(self, name)
            if value is not None:
                domain.check(f"Block.{name}", value)
        if self.machine is not None and self.push.control == "force":
            raise ValueError("Block.machine beside push.control = 'force': a machine displaces the pusher")
        if self.plane == "strain" and not isinstance(self.poisson, Tracer) and np.any(self.poisson == 0.5):
            raise ValueError("Block.poisson = 0.5: an incompressible block has no plane strain here; take 0.499")

    @classmethod
    def from_material(
        cls,
        *,
        height: Real,
        correlation_length: Real,
        areal_stiffness: Real,
        poisson: Real,
        young: Real,
        push_height: Real,
        push_width: Real | None = None,
        push_control: Control = "displacement",
        plane: Plane = "stress",
        length: Real | None = None,
        normal_stiffness: Real | None = None,
        friction: Real | None = None,
        contact_law: ContactLaw = "amontons",
        top: Top = "free",
        machine_stiffness: Real | None = None,
    ) -> "Block":
        """Block from material constants in SI units.

        Parameters
        ----------
        height, correlation_length, areal_stiffness, poisson, young
            As for `Slider.from_material`: H and λc in m, k/λc² in Pa/m, ν, and E in Pa.
        push_height : float
            Height of the middle of the pusher over the interface, in m; without `push_width`, of its lower end.
        push_width : float, optional
            Height of the pusher itself, in m; by default it covers everything above `push_height`.
        push_control, plane, normal_stiffness, friction, contact_law, top
            As for `Push` and `Block`.
        length : float, optional
            L, in m; rounded to whole contacts.
        machine_stiffness : float, optional
            Stiffness of the machine over the width of the block, in N/m².
        """
        given = {"push_height": push_height, "push_width": push_width, "length": length}
        lengths, stiffness = from_si(
            "Block.from_material",
            height=height,
            correlation_length=correlation_length,
            areal_stiffness=areal_stiffness,
            young=young,
            **{name: x for name, x in given.items() if x is not None},
        )
        height = lengths["height"]
        push = Push(
            *(lengths[name] / height for name in ("push_height", "push_width") if name in lengths), control=push_control
        )
        whole = None if length is None else np.rint(lengths["length"])
        machine = None
        if machine_stiffness is not None:
            of_both = ("machine_stiffness", machine_stiffness), ("young", young)
            machine = machine_ratio(*(as_float(f"Block.from_material: {name}", x, "Pa") for name, x in of_both))
        return cls(height, stiffness, poisson, push, plane, whole, normal_stiffness, friction, contact_law, top, machine)

    def in_domain(self) -> Array:
        """Whether the values, traced ones too, are those of a block."""
        given = ((getattr(self, name), domain) for name, domain in _DOMAIN.items())
        return functools.reduce(operator.and_, (domain.holds(jnp.asarray(x)) for x, domain in given if x is not None))

    def __repr__(self) -> str:
        return in_a_line(self)

    def _repr_html_(self) -> str:
        push = "the whole side" if self.push.height is None else short(self.push.height)
        rows = [
            ("height, H/λc", short(self.height)),
            ("contact stiffness, k/K", short(self.stiffness)),
            ("Poisson's ratio, ν", short(self.poisson)),
            ("pushed at, over H", push if self.push.width is None else f"{push}, over {short(self.push.width)} H"),
            ("held while an event runs", self.push.control),
            ("length, in λc", "without end" if self.length is None else short(self.length)),
            ("b, areal stiffness times H over the shear modulus", short(self.slider.b)),
        ]
        if self.friction is not None:
            rows.append(("friction coefficient, μ", f"{short(self.friction)}, {self.contact_law}, top {self.top}"))
        if self.machine is not None:
            rows.append(("stiffness of the machine, M/K", short(self.machine)))
        return html(f"Block (plane {self.plane})", rows)

    @property
    def sites(self) -> int | None:
        """Number of contacts of a block that ends; else None."""
        return None if self.length is None or isinstance(self.length, Tracer) else int(self.length)

    def contacts(self, interface: "Interface | Profile | None", sites: int) -> "Relaxed":
        """First contacts before loading, with their response."""
        from slippulse_jax.blocks.event import contacts_of  # above: the body says where, and loads nothing else

        return contacts_of(self, interface, sites)

    @property
    def slider(self) -> Slider:
        """The slider of the same height and contacts."""
        return Slider(self.height, self.stiffness, self.poisson)

    @property
    def plane_constants(self) -> tuple[Array, Array]:
        """Poisson's ratio and E of the plane-stress problem that this one is."""
        nu = jnp.asarray(self.poisson)
        return (nu, jnp.ones_like(nu)) if self.plane == "stress" else (nu / (1 - nu), 1 / (1 - nu**2))
