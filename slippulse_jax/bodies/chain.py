"""Chain of sites whose springs, contacts, thresholds and prestress may vary.

The part of the chain beyond a site is a network of springs with two terminals, u_t and u. However long it is, it is
equivalent to three springs: one from each layer to the ground and one across. The right end of a chain is therefore
three springs too (`Springs`): none for a free end, two bonds to a wall for a clamped end, and for a semi-infinite chain
the equivalent of an endless uniform interface, which makes the end exactly absorbing.
"""

from collections.abc import Callable
from types import NoneType
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.base.domains import RESIDUAL_STRENGTH, check_domain, check_kind, check_single, check_whole
from slippulse_jax.base.units import as_float, at_least_single, quantity_field
from slippulse_jax.interface import AnyInterface, Interface, Profile, kept_share
from slippulse_jax.slider import Slider

if TYPE_CHECKING:
    from slippulse_jax.events.first import Relaxed

ForceLaw = Callable[[Float[Array, " N"]], Float[Array, " N"]]


class Springs(NamedTuple):
    """A network of springs with two terminals, in K."""

    upper: Array  # from u_t to the ground
    layer: Array  # from u to the ground
    across: Array  # between u_t and u


class State(NamedTuple):
    """Pinning points and load of a chain."""

    pinning: Float[Array, " N"]  # u_b, in u_s
    load: Float[Array, ""]  # U, displacement of the left edge of the upper layer, in u_s


class Chain(eqx.Module):
    """Chain of N sites, each with two layers and a contact.

    Made by `chain`. Forces are in K u_s, displacements in u_s and stresses in σ_s, where u_s, σ_s and `stiffness` are those
    of the slider's own λ-contact. The stress on contact i is t_i = (k_i/k) f(u_i − u_b,i) + φ_i, with f(z) = z unless `law`
    specifies another; a detached contact (k_i = 0) carries none. One that breaks repins with r θ_i, `residual_strength` r.
    `height` is that of the slider: the ratio of the masses of a block of the upper layer and one of the interfacial layer,
    whatever the stiffness of the bonds.
    """

    upper: Float[Array, " N-1"] = quantity_field("K_L", "K", "cra03")
    layer: Float[Array, " N-1"] = quantity_field("K", "K", "cra04")
    across: Float[Array, " N"] = quantity_field("K_T", "K", "cra05")
    contact: Float[Array, " N"] = quantity_field("k_i", "K")
    threshold: Float[Array, " N"] = quantity_field("\\theta_i", "\\sigma_s")
    prestress: Float[Array, " N"] = quantity_field("\\varphi_i", "\\sigma_s")
    stiffness: Float[Array, ""] = quantity_field("k", "K", "cra41")
    height: Float[Array, ""] = quantity_field("H/\\lambda_c", "1", "cra41")
    end: Springs = eqx.field(kw_only=True)  # equivalent of all that lies beyond the last site
    law: ForceLaw | None = None
    residual_strength: Float[Array, ""] | float = quantity_field("r", "1", default=0.0)

    @property
    def sites(self) -> int:
        """Number of sites, N."""
        return self.contact.shape[-1]

    def relaxed(self, load: AnyArrayLike = 0.0) -> State:
        """State with pinning points at zero, under load U (in u_s)."""
        return State(jnp.zeros_like(self.contact), jnp.asarray(as_float("load", load), dtype=self.contact.dtype))

    def contact_force(self, stretch: Array) -> Array:
        """Force of each contact beyond its prestress, in K u_s."""
        return self.contact * (stretch if self.law is None else self.law(stretch))

    def stress(self, layer: Array, pinning: Array) -> Float[Array, " N"]:
        """Stress t_i on each contact, in σ_s."""
        attached = self.contact > 0
        return jnp.where(attached, self.contact_force(layer - pinning) / self.stiffness + self.prestress, 0)

    def contacts(self, interface: AnyInterface = None, sites: int | None = None) -> "Relaxed":
        """All contacts of this chain before loading, and their response."""
        from slippulse_jax.events.first import contacts_of_chain  # above: the body says where, and loads nothing else

        check_linear(self, "what breaks do to a chain")
        if interface is not None or sites not in (None, self.sites):
            given = f"sites = {sites}" if interface is None else f"interface = {interface!r}"
            raise ValueError(f"{given}: a chain of {self.sites} sites has its own contacts")
        return contacts_of_chain(self)


def chain(
    slider: Slider,
    *,
    sites: int | None = None,
    interface: Interface | Profile | None = None,
    contact: AnyArrayLike | None = None,
    threshold: AnyArrayLike | None = None,
    prestress: AnyArrayLike | None = None,
    residual_strength: AnyArrayLike | None = None,
    upper: AnyArrayLike | None = None,
    layer: AnyArrayLike = 1.0,
    law: ForceLaw | None = None,
) -> Chain:
    """Make a chain of `sites` sites with uniform or varying properties.

    Parameters
    ----------
    slider : Slider
        One slider (fields of shape ()); use ``jax.vmap`` for a batch. Beyond its last site the chain continues without end,
        uniform, relaxed and unbroken, stops (free), or is tied to a wall one bond further (clamped), as its right end says.
    sites : int, optional
        N ≥ 2; by default that of a slider that ends, in which all are resolved.
    interface : Interface or Profile, optional
        Thresholds and prestress of the contacts; uniform and relaxed by default.
    contact : array_like, shape () or (N,), optional
        k_i/K; 0 for a detached contact. The slider's k/K by default.
    threshold : array_like, shape () or (N,), optional
        θ_i > 0, the stress at which contact i breaks, in σ_s; replaces that of the interface.
    prestress : array_like, shape () or (N,), optional
        φ_i, the stress on contact i when u_i = u_b,i = 0, balanced by a constant traction (top shear), in σ_s; replaces
        that of the interface.
    residual_strength : array_like, shape (), optional
        r in [0, 1), the share of its threshold with which a contact repins; replaces that of the interface.
    upper, layer : array_like, shape () or (N−1,), optional
        Stiffness of each bond of the two layers, in K. K_L = H/λc and 1 by default.
    law : callable, optional
        f, the force law of a contact in units of its stiffness: a function of the stretches of all contacts in u_s, shape
        (N,), that returns an array of the same shape; f(0) = 0 and f'(0) = 1 keep the meaning of `contact`. Linear by
        default. To differentiate with respect to its parameters, pass an ``equinox.Module`` or ``jax.tree_util.Partial``
        that holds them.

    Raises
    ------
    ValueError
        If a value lies outside its domain or a shape does not fit (the message names both; traced values are not checked).
    """
    check_kind("slider", slider, Slider)
    check_kind("interface", interface, Interface, Profile, NoneType)
    check_single("chain", slider=slider, interface=interface)
    sites = _sites_of(slider, sites)
    slider = jax.tree.map(at_least_single, slider)
    numbers = jnp.arange(sites)
    of_interface = (1.0, 0.0) if interface is None else (interface.threshold_at(numbers), interface.prestress_at(numbers))
    threshold = of_interface[0] if threshold is None else threshold
    prestress = of_interface[1] if prestress is None else prestress
    kept = kept_share(interface) if residual_strength is None else residual_strength
    RESIDUAL_STRENGTH.check("residual_strength", kept)
    if np.shape(kept):
        raise ValueError(f"residual_strength has shape {np.shape(kept)}: must be one number, of all contacts")
    if law is not None and (interface is not None and interface.residual_strength is not None or residual_strength is not None):
        raise ValueError("residual_strength beside a force law: what a contact keeps is stated for linear contacts")
    contact = slider.stiffness if contact is None else contact
    upper = slider.K_L if upper is None else upper

    def per_site(name: str, value: AnyArrayLike, count: int, domain: str, inside: Callable[[Any], Any]) -> Array:
        check_domain(name, value, inside, f"must be {domain}")
        if np.shape(value) not in ((), (count,)):
            raise ValueError(f"{name} has shape {np.shape(value)}: must be () or ({count},) for {sites} sites")
        array = at_least_single(jnp.asarray(value))
        # a Python number takes the slider's precision: a weak type would compile another program
        typed = jnp.issubdtype(array.dtype, jnp.inexact) and not array.weak_type
        return jnp.broadcast_to(array if typed else array.astype(q.dtype), (count,))

    K_T, q = slider.K_T, jnp.asarray(slider.stiffness)
    zero = jnp.zeros_like(K_T)
    ends = {
        "free": lambda: Springs(zero, zero, zero),
        "clamped": lambda: Springs(slider.K_L, jnp.ones_like(zero), zero),
        "semi-infinite": lambda: endless(Springs(slider.K_L, jnp.ones_like(zero), K_T), q),
    }
    return Chain(
        upper=per_site("upper", upper, sites - 1, "zero or more, in K", lambda x: x >= 0),
        layer=per_site("layer", layer, sites - 1, "zero or more, in K", lambda x: x >= 0),
        across=jnp.broadcast_to(K_T, (sites,)),
        contact=per_site("contact", contact, sites, "zero or more, in K", lambda x: x >= 0),
        threshold=per_site("threshold", threshold, sites, "positive, in σ_s", lambda x: x > 0),
        prestress=per_site("prestress", prestress, sites, "finite, in σ_s", np.isfinite),
        stiffness=q,
        height=jnp.asarray(slider.height),
        end=ends[slider.right](),
        law=law if law is None or isinstance(law, eqx.Module | Partial) else Partial(law),  # pyright: ignore[reportArgumentType]
        residual_strength=at_least_single(jnp.asarray(kept, q.dtype)),
    )


def _sites_of(slider: Slider, sites: int | None) -> int:
    """Number of sites, all of a slider that ends; refuse a machine."""
    if slider.machine is not None:
        raise ValueError(
            f"Slider.machine = {slider.machine}: the edge of a chain is displaced; pull it through Spring(…) in a series"
        )
    if slider.length is not None and not isinstance(slider.length, Tracer):
        length = float(slider.length)
        if sites not in (None, length) or not length.is_integer():
            raise ValueError(f"sites = {sites}: must be Slider.length = {length:g}, a whole number, of a slider that ends")
        return int(length)
    check_whole("sites", sites, 2)
    return cast(int, sites)


def check_linear(chain: Chain, owner: str) -> None:
    """Refuse a chain whose contacts have a force law."""
    if chain.law is not None:
        raise ValueError(f"{owner} needs linear contacts: this chain has a force law")


def potential_energy(chain: Chain, x: tuple[Array, Array], pinning: Array) -> Float[Array, ""]:
    """Potential energy of a chain with linear contacts, in K u_s².

    Prestress is included.
    """
    upper, layer = x
    bonds = (chain.upper * jnp.diff(upper) ** 2).sum() + (chain.layer * jnp.diff(layer) ** 2).sum()
    sites = (chain.across * (upper - layer) ** 2).sum() + (chain.contact * (layer - pinning) ** 2).sum()
    end = chain.end.upper * upper[-1] ** 2 + chain.end.layer * layer[-1] ** 2
    end = end + chain.end.across * (upper[-1] - layer[-1]) ** 2
    return (bonds + sites + end) / 2 - chain.stiffness * (chain.prestress * pinning).sum(where=chain.contact > 0)


def endless(bonds: Springs, contact: Array) -> Springs:
    """Reduce an endless uniform half-line to three equivalent springs.

    It begins with its first bond. In mode m the displacement falls by a factor r_m per site, so a bond pulls back with its
    stiffness times (1 − r_m): the end is B g(M), with B = diag(K_L, K), M the 2×2 matrix of the bulk equations with
    eigenvalues κ_m², and g(κ²) = 1 − r. For a 2×2 matrix g(M) = g_2 + (M − κ_2²)(g_1 − g_2)/(κ_1² − κ_2²).
    """
    K_L, K, K_T = bonds
    kT2, b, q = K_T / K_L, K_T / K, contact / K
    splitting = jnp.sqrt((b + q - kT2) ** 2 + 4 * kT2 * b)
    larger = (b + q + kT2 + splitting) / 2
    smaller = kT2 * q / larger  # from the product: the difference of squares would cancel

    def gap(square: Array) -> Array:
        half = jnp.sqrt(square) / 2
        return 2 * half / (half + jnp.sqrt(1 + half**2))

    g_1, g_2 = gap(larger), gap(smaller)
    slope = (g_1 - g_2) / splitting
    # row sums: (M − κ_2²)(1, 1) = (−κ_2², q − κ_2²), and q − κ_2² = q (κ_1² − κ_T²)/κ_1²
    beyond_upper = (b + q - kT2 + splitting) / 2
    return Springs(
        upper=K_L * (g_2 - slope * smaller), layer=K * (g_2 + slope * q * beyond_upper / larger), across=K_L * slope * kT2
    )


# --- elimination, site by site ---

Pair = tuple[Array, Array]
"""One number per layer: (upper, interfacial)."""


def beside(far: Springs, across: Array, contact: Array) -> Springs:
    """Add the springs of one site to `far`, in parallel."""
    return Springs(far.upper, far.layer + contact, far.across + across)


def determinant(springs: Springs) -> Array:
    """Determinant of the springs' 2×2 stiffness matrix; zero where a part floats."""
    return springs.upper * springs.layer + springs.across * (springs.upper + springs.layer)


def solve_pair(springs: Springs, force: Pair) -> Pair:
    """Displace the two terminals by given forces; zero where a part floats."""
    det = determinant(springs)
    det = jnp.where(det > 0, det, jnp.inf)
    f, g = force
    return (
        ((springs.layer + springs.across) * f + springs.across * g) / det,
        ((springs.upper + springs.across) * g + springs.across * f) / det,
    )


def pass_site(far: Springs, here: tuple[Pair, Array, Array]) -> tuple[Springs, Springs]:
    """Reduce `far`, a site and one bond per layer to three springs.

    In a scan: `here` are that bond, and what lies across and below the site; the springs are carried on and kept.
    """
    (B, K), across, contact = here
    far = beside(far, across, contact)
    held = Springs(B + far.upper, K + far.layer, far.across)
    upper, layer = solve_pair(held, (far.upper, far.layer))
    det = determinant(held)
    seen = Springs(B * upper, K * layer, B * K * far.across / jnp.where(det > 0, det, jnp.inf))
    return seen, seen


def eliminate(chain: Chain, contact: Float[Array, " N"]) -> Springs:
    """Eliminate a chain from its right end, site by site.

    `contact` holds the (tangent) stiffness of every contact. Returns `beyond`, shape (N,): the springs equivalent to everything
    right of each site, with the bond next to it; the last are the chain's end.
    """
    end = Springs(*(jnp.asarray(x, contact.dtype) for x in chain.end))
    _, beyond = lax.scan(pass_site, end, ((chain.upper, chain.layer), chain.across[1:], contact[1:]), reverse=True)
    return Springs(*(jnp.append(x, e) for x, e in zip(beyond, end, strict=True)))


def floats(chain: Chain, beyond: Springs) -> Bool[Array, ""]:
    """Whether a part of a chain is attached to nothing."""
    site = beside(beyond, chain.across, chain.contact)
    return (determinant(held_from_left(chain, site)) <= 0).any() | (site.layer[0] + site.across[0] <= 0)


def held_from_left(chain: Chain, site: Springs) -> Springs:
    """Springs that hold sites 1 … N − 1, left bond included."""
    return Springs(site.upper[1:] + chain.upper, site.layer[1:] + chain.layer, site.across[1:])


def carried_over(chain: Chain, site: Springs) -> tuple[Pair, Pair]:
    """Displacements of every site per displacement of the one before.

    The first pair is per displacement of the upper layer.
    """
    held, zero = held_from_left(chain, site), jnp.zeros_like(chain.upper)
    return solve_pair(held, (chain.upper, zero)), solve_pair(held, (zero, chain.layer))


def respond(chain: Chain, contact: Array, beyond: Springs, force: Pair) -> Pair:
    """Solve for the displacements due to given forces, with u_t[0] held.

    Forces are passed from the right end to the left edge, displacements back, each by the same 2×2 matrix, which `beyond`
    determines (`eliminate`, for the same `contact`). The result is zero where a part floats.
    """
    site = beside(beyond, chain.across, contact)
    held = held_from_left(chain, site)
    by_upper, by_layer = carried_over(chain, site)

    def collect(arriving: Pair, here: tuple) -> tuple[Pair, Pair]:
        (a, b), (c, d), (f, g) = here
        f, g = arriving[0] + f, arriving[1] + g
        return (a * f + b * g, c * f + d * g), (f, g)

    zero = jnp.zeros_like(force[0][0])
    arriving, total = lax.scan(collect, (zero, zero), (by_upper, by_layer, tuple(f[1:] for f in force)), reverse=True)
    stiff = site.layer[0] + site.across[0]
    first = (zero, (force[1][0] + arriving[1]) / jnp.where(stiff > 0, stiff, jnp.inf))

    def spread(before: Pair, here: tuple) -> tuple[Pair, Pair]:
        (a, b), (c, d), (f, g) = here
        after = (a * before[0] + c * before[1] + f, b * before[0] + d * before[1] + g)
        return after, after

    _, after = lax.scan(spread, first, (by_upper, by_layer, solve_pair(held, total)))
    return jnp.append(first[0], after[0]), jnp.append(first[1], after[1])
