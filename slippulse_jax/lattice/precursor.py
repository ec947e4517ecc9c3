"""The first precursor as users ask for it: its length, the full record, and lengths by the million."""

import functools
import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax.derivatives import by_forward_mode
from slippulse_jax.interface import Interface, Profile
from slippulse_jax.lattice import interface_front
from slippulse_jax.lattice.front import (
    DEFAULT_MAX_CONTACTS,
    Arrest,
    FrontStatus,
    arrest,
    front_stress,
)
from slippulse_jax.lattice.modes import Fields, Modes, RightEnd, check_right_end, equilibrium_fields, lattice_modes
from slippulse_jax.slider import Slider

FLOAT32_HEIGHT = 1000.0
"""Largest H/λc for which single precision is taken without a warning: see `precursor_length`."""


class FrontNotArrested(RuntimeError):
    """The front was still running after the allowed number of breaks: there is no length to return."""


class FirstPrecursor(eqx.Module):
    """The first precursor of one slider, with the state of the chain before and after it.

    Lengths are in λc, displacements in u_s, stresses in σ_s.
    """

    slider: Slider
    contacts_broken: Int[Array, ""]  # s0, so that Λ = s0 λc
    length: Float[Array, ""]  # ℓ, the continuous length
    load: Float[Array, ""]  # U0, displacement of the left edge at nucleation
    status: Int[Array, ""]  # a FrontStatus
    edge_stress: Float[Array, ""]  # stress on contact 0 at arrest, the largest behind the front
    front_stress: Float[Array, " sites"]  # t(s): on contact s once all before it have broken, past the arrest too
    modes: Modes
    interface: Interface | Profile | None = None

    def fields_at(self, front_position: int | Array) -> Fields:
        """Fields when contacts 0 … front_position − 1 have broken: 0 is nucleation, `contacts_broken` is arrest.

        On an interface with prestress φ the contact stress is `Fields.stress` + φ.
        """
        if self.interface is not None:
            sites = self.front_stress.shape[0]
            pinning = interface_front.pinning(self.modes, self.interface, sites, jnp.asarray(front_position))
            return equilibrium_fields(self.modes, self.load, pinning)
        broken = jnp.arange(self.front_stress.shape[0]) < front_position
        return equilibrium_fields(self.modes, self.load, jnp.where(broken, self.front_stress, 0))

    @property
    def nucleation(self) -> Fields:
        """Fields when contact 0 carries σ_s and nothing has broken."""
        return self.fields_at(0)

    @property
    def arrest(self) -> Fields:
        """Fields when the front has stopped."""
        return self.fields_at(self.contacts_broken)


def precursor_length(
    slider: Slider,
    *,
    interface: Interface | Profile | None = None,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> Float[Array, "..."]:
    """Length ℓ of the first precursor, in λc.

    ℓ is where the stress on the contact ahead, drawn as a straight line between the last contact that broke and the
    first that did not, falls to its threshold. The whole-contact count of the paper is s0 = ceil(ℓ) (for s0 > 1), and
    Λ = s0 λc. Where the neighbour of the edge contact does not break there is no domino: s0 = 1, ℓ = 0, and ℓ is flat.

    Parameters
    ----------
    slider : Slider
        One slider or a batch; ℓ has its shape.
    interface : Interface or Profile, optional
        Prestress, thresholds and repinning; the paper's own (relaxed, uniform, immediate) by default. An `Interface`
        broadcasts with the slider; a `Profile` belongs to one slider.
    right : {"semi-infinite", "free", "clamped"}
        Right end of the chain; the paper's theory is semi-infinite.
    sites : int, optional
        Number of sites of a finite chain.
    max_contacts : int
        Breaks after which the front is given up.

    Returns
    -------
    array
        ℓ ≥ 0; inf where the front reaches the right end of a finite chain or runs away on a prestressed interface; NaN in the
        lanes of a batch, or under
        ``jit`` and ``vmap``, where the front was given up or the (traced) slider is not physical. A length that is not
        finite has no finite derivative.

    Raises
    ------
    FrontNotArrested
        If a single front, called outside ``jit``, was given up. A batch warns instead, and says which.

    Notes
    -----
    Differentiable in (height, stiffness, poisson) to any order, forward and reverse: the crossing is differentiated
    implicitly, by one pass of the recursion that carries three tangents. ℓ is continuous in the parameters and smooth
    between sites; where ℓ passes through a whole number the straight line changes, and the derivative returned is that
    of the longer side (contact broken at exactly its threshold). Time is proportional to ℓ, memory constant.

    In single precision the error stays below 0.01 λc up to H/λc = 1000 and reaches 3e-4 of the length at H/λc = 1e5:
    above 1000 a warning says so, once. Work under ``jax.enable_x64(True)`` there.
    """
    check_right_end(right, sites)
    _check_max_contacts(max_contacts)
    _warn_single_precision(slider)
    if interface is None:
        length = _length_function(right, sites, max_contacts)(_parameters(slider))
    else:
        length = _length_on(interface, slider, right, sites, max_contacts)
    if not isinstance(length, Tracer):
        _report_given_up(np.asarray(length), max_contacts, raises=length.ndim == 0)
    return length


def first_precursor(
    slider: Slider,
    *,
    interface: Interface | Profile | None = None,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
    recorded_sites: int | None = None,
) -> FirstPrecursor:
    """Record of the first precursor: count, length, load, front stress, fields, status.

    Parameters
    ----------
    slider : Slider
        One slider (fields of shape ()); ``jax.vmap`` over a batch.
    interface, right, sites, max_contacts
        As for `precursor_length`.
    recorded_sites : int, optional
        Number of sites on which stress and fields are given: the whole of a finite chain by default, four times the
        length of the front otherwise. Needed under ``jit`` and ``vmap``, where the length is not known beforehand, and
        there at least `contacts_broken` for the fields to be complete.

    Raises
    ------
    ValueError
        If `slider` is a batch, or if `recorded_sites` is needed and missing or does not reach the arrest.
    """
    check_right_end(right, sites)
    _check_max_contacts(max_contacts)
    if slider.shape != ():
        raise ValueError(f"first_precursor takes one slider, got a batch of shape {slider.shape}: use jax.vmap")
    _warn_single_precision(slider)
    if interface is not None and interface.shape != ():
        raise ValueError(f"first_precursor takes one interface, got a batch of shape {interface.shape}: use jax.vmap")
    modes, ended = _arrest_function(right, sites, max_contacts)(slider, interface)
    traced = isinstance(ended.contacts_broken, Tracer)
    if recorded_sites is None:
        if sites is None and traced:
            raise ValueError("first_precursor under jit or vmap needs recorded_sites: the length is not known beforehand")
        recorded_sites = sites if sites is not None else max(4 * int(ended.contacts_broken), 16)
    if not traced and recorded_sites < int(ended.contacts_broken):
        raise ValueError(f"recorded_sites = {recorded_sites}, but {int(ended.contacts_broken)} contacts broke")
    if interface is None:
        stress, load = front_stress(modes, recorded_sites), modes.load
    else:
        stress, _ = interface_front.front_stress(modes, interface, recorded_sites)
        load = modes.load * interface_front.nucleate(modes, interface)[1]
    return FirstPrecursor(
        slider=slider,
        contacts_broken=ended.contacts_broken,
        length=ended.length,
        load=load,
        status=ended.status,
        edge_stress=ended.edge_stress,
        front_stress=stress,
        modes=modes,
        interface=interface,
    )


def precursor_lengths(
    slider: Slider,
    *,
    interface: Interface | None = None,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> np.ndarray:
    """Lengths ℓ of a batch of any size, in λc, as NumPy float64.

    The same numbers as `precursor_length` in double precision whatever the JAX flags, computed lane by lane in the
    order of their expected length and in chunks of one fixed shape, so that no lane waits for a much longer one. A
    result never depends on the rest of the batch. Not traceable: inside ``jit`` use ``jax.vmap`` of `precursor_length`.

    Parameters
    ----------
    slider : Slider
        Fields of any shapes that broadcast.
    interface, right, sites, max_contacts
        As for `precursor_length`.

    Returns
    -------
    numpy.ndarray
        float64, of shape ``slider.shape``; inf and NaN as for `precursor_length`, with a warning for the latter.
    """
    lengths = precursor_arrests(slider, interface=interface, right=right, sites=sites, max_contacts=max_contacts).length
    _report_given_up(np.asarray(lengths), max_contacts, raises=False)
    return np.asarray(lengths)


def precursor_arrests(
    slider: Slider,
    *,
    interface: Interface | None = None,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> Arrest:
    """Count, length, status and edge stress of a batch of any size, as an `Arrest` of NumPy arrays of its shape.

    What `precursor_lengths` computes, with all that is known of each lane; nothing is raised or warned about a lane.
    """
    check_right_end(right, sites)
    _check_max_contacts(max_contacts)
    shape = slider.shape if interface is None else np.broadcast_shapes(slider.shape, interface.shape)
    fields = _fields(slider) if interface is None else (*_fields(slider), interface.prestress, interface.threshold_slope)
    parameters = np.stack([np.broadcast_to(np.asarray(x, np.float64), shape) for x in fields], axis=-1)
    lanes = parameters.reshape(-1, len(fields))
    order = np.argsort(_expected_length(lanes), kind="stable")
    result = Arrest(*(np.empty(len(lanes), dtype) for dtype in (np.int32, np.float64, np.int32, np.float64)))
    with jax.enable_x64(True):
        delay = None if interface is None else interface.repin_delay
        arrest_chunk = _chunk_function(delay, right, sites, max_contacts)
        for start in range(0, len(lanes), _LANES):
            chosen = order[start : start + _LANES]
            padded = np.resize(chosen, _LANES)
            for column, values in zip(result, arrest_chunk(lanes[padded]), strict=True):
                column[chosen] = np.asarray(values)[: len(chosen)]
    return Arrest(*(column.reshape(shape) for column in result))


_LANES = 1024  # lanes a chunk: the carried state of a chunk stays in the first-level cache


def _fields(slider: Slider) -> tuple[Any, Any, Any]:
    return slider.height, slider.stiffness, slider.poisson


def _parameters(slider: Slider) -> Float[Array, "... 3"]:
    return jnp.stack([jnp.broadcast_to(jnp.asarray(x), slider.shape) for x in _fields(slider)], axis=-1)


@functools.cache
def _length_function(right: RightEnd, sites: int | None, max_contacts: int) -> Callable[[Array], Array]:
    def length(parameters: Float[Array, "3"]) -> Array:
        return jnp.asarray(arrest(_slider(parameters), right, sites, max_contacts).length)

    return jax.jit(jnp.vectorize(by_forward_mode(length), signature="(n)->()"))


def _length_on(interface: Interface | Profile, slider: Slider, right: RightEnd, sites: int | None, max_contacts: int) -> Array:
    if isinstance(interface, Interface):
        shape = np.broadcast_shapes(slider.shape, interface.shape)
        fields = (*_fields(slider), interface.prestress, interface.threshold_slope)
        parameters = jnp.stack([jnp.broadcast_to(jnp.asarray(x), shape) for x in fields], axis=-1)
        return _interface_length_function(interface.repin_delay, right, sites, max_contacts)(parameters)
    if slider.shape != ():
        raise ValueError(f"a Profile belongs to one slider, got a batch of shape {slider.shape}: use jax.vmap")
    return jnp.asarray(_arrest_function(right, sites, max_contacts)(slider, interface)[1].length)


@functools.cache
def _interface_length_function(delay: int, right: RightEnd, sites: int | None, max_contacts: int) -> Callable[[Array], Array]:
    def length(parameters: Float[Array, "5"]) -> Array:
        return jnp.asarray(_arrest_of(parameters, delay, right, sites, max_contacts).length)

    return jax.jit(jnp.vectorize(by_forward_mode(length), signature="(n)->()"))


def _arrest_of(parameters: Array, delay: int | None, right: RightEnd, sites: int | None, max_contacts: int) -> Arrest:
    """`arrest` of (height, stiffness, poisson), or with prestress and threshold slope beside them where there is a delay."""
    if delay is None:
        return arrest(_slider(parameters), right, sites, max_contacts)
    interface = Interface(parameters[3], parameters[4], delay)
    return interface_front.arrest(_slider(parameters), interface, right, sites, max_contacts)


@functools.cache
def _chunk_function(delay: int | None, right: RightEnd, sites: int | None, max_contacts: int) -> Callable[[np.ndarray], Arrest]:
    return jax.jit(jax.vmap(lambda parameters: _arrest_of(parameters, delay, right, sites, max_contacts)))


@functools.cache
def _arrest_function(right: RightEnd, sites: int | None, max_contacts: int) -> Callable[..., Any]:
    def both(slider: Slider, interface: Interface | Profile | None) -> tuple[Modes, Arrest]:
        modes = lattice_modes(slider, right, sites)
        if interface is None:
            return modes, arrest(slider, right, sites, max_contacts)
        return modes, interface_front.arrest(slider, interface, right, sites, max_contacts)

    return eqx.filter_jit(both)


def _slider(parameters: Array) -> Slider:
    return Slider(parameters[0], parameters[1], parameters[2])


def _expected_length(lanes: np.ndarray) -> np.ndarray:
    """ln[2/(1+β)]/κ_2, the leading term of Eq. (25): good enough to put lanes of like length together."""
    height, stiffness, poisson = lanes.T[:3]
    b = 2 * (1 + poisson) * stiffness * height
    kappa_2 = np.sqrt(b / (1 + b) / (2 * (1 + poisson))) / height
    return np.log(2 / (1 + 1 / (1 + b))) / kappa_2


def _check_max_contacts(max_contacts: int) -> None:
    if not 1 <= max_contacts < 2**31 - 1:
        raise ValueError(f"max_contacts = {max_contacts}: must be at least 1 and below 2**31 - 1")


def _report_given_up(lengths: np.ndarray, max_contacts: int, *, raises: bool) -> None:
    given_up = np.isnan(lengths)
    if not given_up.any():
        return
    if raises:
        raise FrontNotArrested(f"{FrontStatus.LIMIT.message}; max_contacts = {max_contacts}")
    first = tuple(int(i) for i in np.argwhere(given_up)[0])
    warnings.warn(
        f"{int(given_up.sum())} of {lengths.size} fronts, the first at index {first}, have no length (NaN): "
        f"{FrontStatus.LIMIT.message}; max_contacts = {max_contacts}",
        RuntimeWarning,
        stacklevel=3,
    )


@functools.lru_cache(maxsize=1)
def _warn_once() -> None:
    warnings.warn(
        f"single precision with H/λc above {FLOAT32_HEIGHT:g}: a precursor length is off by more than 0.01 λc "
        "(by 3e-4 of itself at H/λc = 1e5). Use jax.enable_x64(True), or precursor_lengths.",
        RuntimeWarning,
        stacklevel=4,
    )


def _warn_single_precision(slider: Slider) -> None:
    if jax.config.jax_enable_x64 or isinstance(slider.height, Tracer):  # pyright: ignore[reportAttributeAccessIssue]
        return
    if np.any(np.asarray(slider.height) > FLOAT32_HEIGHT):
        _warn_once()
