"""The slider: three numbers, and the stiffnesses and lengths they give.

Lengths are in λc, stiffnesses in K = Eλc (label cra04), contact stretches in u_s = f_s/k, hence stresses in σ_s.
"""

import functools
import operator
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax.base import domains
from slippulse_jax.base.choices import RightEnd
from slippulse_jax.base.shown import html, in_a_line, short
from slippulse_jax.base.units import Numbers, as_float, at_least_single, quantity, quantity_field

if TYPE_CHECKING:
    from slippulse_jax.events.first import Relaxed
    from slippulse_jax.interface import Interface, Profile

Real = Array | np.ndarray | np.floating | float

_DOMAIN = {
    "height": domains.HEIGHT, "stiffness": domains.STIFFNESS, "poisson": domains.POISSON,
    "length": domains.SITES, "machine": domains.MACHINE,
}  # fmt: skip


class Fields(NamedTuple):
    """Displacements in u_s = f_s/k, and stress on contacts in σ_s."""

    upper: Float[Array, "..."]  # u_t
    layer: Float[Array, "..."]  # u
    stress: Float[Array, "..."]  # σ_c and the prestress


class Slider(eqx.Module):
    """An elastic slider on an interface of λ-contacts.

    Parameters
    ----------
    height : array_like
        H/λc, the effective height of the slider over the elastic correlation length; > 1.
    stiffness : array_like
        k/K, the stiffness of one λ-contact over that of an interfacial bond K = Eλc; > 0.
    poisson : array_like
        ν, Poisson's ratio of the bulk; in (−1, 0.5].
    length : array_like, optional
        L/λc, the number N of its contacts. Without it, and at inf, the slider is semi-infinite, as in the paper. The formulas
        take any real N ≥ 2: a free end is then a mirror at (N − ½) λc from contact 0, and contacts are those before it.
    right : {"semi-infinite", "free", "clamped"}, optional
        Right end of one with a length: free by default, or tied to a wall one bond beyond its last contact.
    machine : array_like, optional
        M/K, the stiffness of the machine over the width of the block and E (K = Eλc is that of a slice one λc wide); > 0. The
        machine stays where it is while the front runs, and pushes the edge through that spring; without it, and at inf, the
        displacement of the edge is imposed.

    Raises
    ------
    ValueError
        If a value lies outside its domain or is not finite, naming field, value and index; or if the shapes do not
        broadcast. Values traced by JAX are not checked: lengths computed from invalid ones are NaN.

    Notes
    -----
    The numbers broadcast against each other: a `Slider` of arrays is a batch of sliders. It is a pytree, so that ``jax.vmap``
    and ``jax.grad`` work through it. ``jax.vmap(f)`` maps an axis of every field, and where a field has none JAX says only that
    "its rank should be at least 1": broadcast them, ``Slider(*jnp.broadcast_arrays(height, 0.03, 0.3))``, or map the numbers,
    ``jax.vmap(lambda height: f(Slider(height, 0.03, 0.3)))``.

    Examples
    --------
    >>> slider = Slider(height=25.0, stiffness=0.03, poisson=0.3)
    >>> print(f"{float(slider.kappa_2):.4f} per λc")
    0.0201 per λc
    """

    height: Float[Real, "..."] = quantity_field("H/\\lambda_c", "1", "cra41", "height of the slider, H/λc")
    stiffness: Float[Real, "..."] = quantity_field("k/K", "1", "cra41", "contact stiffness, k/K")
    poisson: Float[Real, "..."] = quantity_field("\\nu", "1", "cra05", "Poisson's ratio")
    length: Float[Real, "..."] | None = None
    right: RightEnd = eqx.field(default="semi-infinite", static=True)
    machine: Float[Real, "..."] | None = None

    def __init__(
        self,
        height: Numbers,
        stiffness: Numbers,
        poisson: Numbers,
        *,
        length: Numbers | None = None,
        right: RightEnd | None = None,
        machine: Numbers | None = None,
    ) -> None:
        given = zip(_DOMAIN, (height, stiffness, poisson), strict=False)
        self.height, self.stiffness, self.poisson = (as_float(f"Slider.{name}", x) for name, x in given)
        ends = ("length", length), ("machine", machine)
        self.length, self.machine = (None if x is None else as_float(f"Slider.{name}", x) for name, x in ends)
        self.right = right or ("semi-infinite" if length is None else "free")

    def __check_init__(self) -> None:
        domains.check_choice("Slider.right", self.right, RightEnd)
        if (self.right == "semi-infinite") != (self.length is None):
            needed = "has no length" if self.length is not None else "needs a length, the number of its contacts"
            raise ValueError(f"Slider.right = {self.right!r}: a slider with this end {needed}")
        for name, domain in _DOMAIN.items():
            value = getattr(self, name)
            if name in ("length", "machine") and not isinstance(value, Tracer | None):
                value = np.where(np.isposinf(value), 2, value)  # none
            if value is not None:
                domain.check(f"Slider.{name}", value)
        try:
            self.shape  # noqa: B018
        except ValueError:
            shapes = ", ".join(f"{name} {np.shape(getattr(self, name))}" for name in _DOMAIN if getattr(self, name) is not None)
            raise ValueError(f"the fields of a Slider must broadcast together: {shapes}") from None

    def in_domain(self) -> Array:
        """Whether the values, traced ones too, are those of a slider."""
        given = [(name, jnp.asarray(x)) for name in _DOMAIN if (x := getattr(self, name)) is not None]
        held = (_DOMAIN[name].holds(x) | (x == jnp.inf) & (name in ("length", "machine")) for name, x in given)
        return functools.reduce(operator.and_, held)

    @classmethod
    def from_material(
        cls, *, height: Real, correlation_length: Real, areal_stiffness: Real, poisson: Real, young: Real
    ) -> "Slider":
        """Slider from material constants in SI units.

        Parameters
        ----------
        height : array_like
            H, in m.
        correlation_length : array_like
            λc, in m; smaller than `height`.
        areal_stiffness : array_like
            k/λc², the shear stiffness of the interface per area, in Pa/m.
        poisson : array_like
            ν.
        young : array_like
            E, in Pa.

        Notes
        -----
        H/λc is a ratio of lengths, and k/K = (k/λc²) λc/E with K = Eλc (label cra04).
        """
        lengths, stiffness = from_si(
            "Slider.from_material",
            height=height,
            correlation_length=correlation_length,
            areal_stiffness=areal_stiffness,
            young=young,
        )
        return cls(lengths["height"], stiffness, poisson)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the batch; () for one slider."""
        given = self.height, self.stiffness, self.poisson, self.length, self.machine
        return np.broadcast_shapes(*(np.shape(x) for x in given if x is not None))

    @property
    def sites(self) -> Int[Array, "..."] | None:
        """Number of contacts of a slider that ends, N rounded; else None."""
        return None if self.length is None else jnp.ceil(jnp.minimum(jnp.asarray(self.length) - 0.5, 2e9)).astype(jnp.int32)

    def __repr__(self) -> str:
        return in_a_line(self)

    def _repr_html_(self) -> str:
        rows = [
            ("height, H/λc", short(self.height)),
            ("contact stiffness, k/K", short(self.stiffness)),
            ("Poisson's ratio, ν", short(self.poisson)),
            ("b, areal stiffness times H over the shear modulus", short(self.b)),
            ("slow decay length, 1/κ₂ in λc", short(self.slow_decay_length)),
        ]
        if self.length is not None:
            rows.append((f"length, in λc, its end {self.right}", short(self.length)))
        if self.machine is not None:
            rows.append(("stiffness of the machine, M/K", short(self.machine)))
        return html("Slider", rows)

    @property
    @quantity("K_L", "K", "cra03")
    def K_L(self) -> Array:
        """Stiffness of a bond of the upper layer."""
        return jnp.asarray(self.height)

    @property
    @quantity("K_T", "K", "cra05")
    def K_T(self) -> Array:
        """Stiffness of the transverse spring between the two layers."""
        return 1 / (2 * (1 + jnp.asarray(self.poisson)) * self.height)

    @property
    @quantity("b", "1", "cra42")
    def b(self) -> Array:
        """Contact over transverse stiffness, k/K_T.

        It is the areal stiffness times H over the shear modulus. The only parameter of the macroscopic limit.
        """
        return 2 * (1 + jnp.asarray(self.poisson)) * self.stiffness * self.height

    @property
    @quantity("\\varepsilon", "1", "cra42")
    def epsilon(self) -> Array:
        """κ_T²/κ² = (λc/H)/(1 + b), the small number of the paper's Appendix."""
        return self.beta / self.height

    @property
    @quantity("\\beta", "1", "cra10")
    def beta(self) -> Array:
        """K_T/(K_T + k)."""
        return 1 / (1 + self.b)

    @property
    @quantity("\\kappa", "1/\\lambda_c", "cra10")
    def kappa(self) -> Array:
        """Inverse screening length of the interfacial layer under a rigid upper layer."""
        return jnp.sqrt(self.stiffness + self.K_T)

    @property
    @quantity("\\kappa_T", "1/\\lambda_c", "cra10")
    def kappa_T(self) -> Array:
        """Inverse screening length of the upper layer on a rigid interfacial layer."""
        return jnp.sqrt(self.K_T / self.K_L)

    @property
    @quantity("\\sqrt{\\mathcal D}", "1/\\lambda_c^2", "cra18")
    def mode_splitting(self) -> Array:
        """κ_1² − κ_2² = √[(κ² − κ_T²)² + 4βκ²κ_T²], from positive terms."""
        coupling = self.K_T
        return jnp.sqrt((coupling + self.stiffness - self.kappa_T**2) ** 2 + 4 * self.kappa_T**2 * coupling)

    @property
    @quantity("\\kappa_1", "1/\\lambda_c", "cra18")
    def kappa_1(self) -> Array:
        """Larger inverse decay length of the two layers together."""
        return jnp.sqrt((self.kappa**2 + self.kappa_T**2 + self.mode_splitting) / 2)

    @property
    @quantity("\\kappa_2", "1/\\lambda_c", "cra18")
    def kappa_2(self) -> Array:
        """Smaller inverse decay length, from the product κ_1²κ_2² without cancellation."""
        return self.kappa_T * jnp.sqrt(jnp.asarray(self.stiffness)) / self.kappa_1

    @property
    @quantity("\\kappa_2^{-1}", "\\lambda_c", "cra18")
    def slow_decay_length(self) -> Array:
        """1/κ_2, over which the slow mode decays.

        A block shorter than three or four of them is not semi-infinite.
        """
        return 1 / self.kappa_2

    @property
    @quantity("\\alpha_1", "1", "cra18")
    def alpha_1(self) -> Array:
        """u/u_t in the fast mode, 1 − κ_1²/κ_T² (negative).

        Erratum: below label cra18 the bracket is misplaced; α_m = ½[1 − (κ² ± √D)/κ_T²] is meant.
        """
        return -self._excess_over_upper / self.kappa_T**2

    @property
    @quantity("\\alpha_2", "1", "cra18")
    def alpha_2(self) -> Array:
        """u/u_t in the slow mode, 1 − κ_2²/κ_T² (erratum as for `alpha_1`)."""
        return self._excess_over_contacts / self.kappa_1**2

    def contacts(self, interface: "Interface | Profile | None", sites: int) -> "Relaxed":
        """First contacts, or all, before loading, with their response."""
        from slippulse_jax.events.first import contacts_of_slider  # above: the body says where, and loads nothing else

        return contacts_of_slider(self, interface, sites)

    def driving_stress(self, upper: Real, layer: Real) -> Array:
        """Stress of the upper layer on the interfacial one, in σ_s.

        σ_d = K_T(u_t − u)/λc², label cra07.

        Parameters
        ----------
        upper, layer : array_like
            u_t and u, in u_s.
        """
        return (jnp.asarray(upper) - layer) / self.b

    @property
    def _excess_over_upper(self) -> Array:
        """κ_1² − κ_T² without cancellation (κ² > κ_T² because H > λc)."""
        return (self.K_T + self.stiffness - self.kappa_T**2 + self.mode_splitting) / 2

    @property
    def _excess_over_contacts(self) -> Array:
        """κ_1² − k/K: positive root e of e² + ze = (K_T/K)(k/K)."""
        z = self.stiffness - self.K_T - self.kappa_T**2
        larger = (self.mode_splitting + jnp.where(z < 0, -z, z)) / 2
        return jnp.where(z < 0, larger, self.K_T * self.stiffness / larger)


def from_si(
    owner: str, *, correlation_length: Any, areal_stiffness: Any, young: Any, **lengths: Any
) -> tuple[dict[str, Any], Any]:
    """Lengths over λc, and k/K = (k/λc²) λc/E, from SI."""
    given = {**lengths, "correlation_length": correlation_length, "areal_stiffness": areal_stiffness, "young": young}
    units = {"areal_stiffness": "Pa/m", "young": "Pa"}
    known = {"correlation_length": domains.CORRELATION_LENGTH, "young": domains.YOUNG}
    si = {name: as_float(f"{owner}: {name}", x, units.get(name, "m")) for name, x in given.items()}
    for name, value in si.items():
        positive = domains.Domain(0, np.inf, f"must be positive, in {units.get(name, 'm')}")
        known.get(name, positive).check(f"{owner}: {name}", value)
    in_contacts = {name: si[name] / si["correlation_length"] for name in lengths}
    return in_contacts, si["areal_stiffness"] * si["correlation_length"] / si["young"]


def of_one_type(slider: Slider, *others: Any) -> list[Array]:
    """Fields of `slider` and `others`, of one type and rank, not broadcast."""
    values = [at_least_single(jnp.asarray(x)) for x in (slider.height, slider.stiffness, slider.poisson, *others)]
    rank, dtype = max(x.ndim for x in values), jnp.result_type(float, *values)
    return [x.astype(dtype).reshape((1,) * (rank - x.ndim) * (x.ndim > 0) + x.shape) for x in values]


def broadcast(slider: Slider, *others: Any) -> list[Array]:
    """The fields of `slider` and `others`, broadcast, in one floating type."""
    return list(jnp.broadcast_arrays(*of_one_type(slider, *others)))


def check_endless(owner: str, slider: Slider) -> None:
    """Refuse what is no slider, or has an end or machine."""
    domains.check_kind("slider", slider, Slider)
    for name in ("length", "machine"):
        if getattr(slider, name) is not None:
            why = f"{owner} is of semi-infinite sliders whose edge is displaced; use precursor_length or first_precursor"
            raise ValueError(f"Slider.{name} = {getattr(slider, name)}: {why}")


def each_slider(function: Any, slider: Slider, *others: Any) -> Any:
    """Map a function of one slider and scalars over arrays that broadcast.

    What depends on the slider alone is computed once per slider: `jnp.vectorize` maps only the axes that an argument has.
    """
    check_endless("this formula", slider)
    return jnp.vectorize(lambda h, q, n, *rest: function(Slider(h, q, n), *rest))(*of_one_type(slider, *others))
