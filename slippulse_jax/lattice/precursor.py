"""The first precursor as users ask for it: its length, the full record, and lengths by the million."""

import functools
import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax.derivatives import by_forward_mode
from slippulse_jax.lattice.front import (
    DEFAULT_MAX_CONTACTS,
    Arrest,
    FrontStatus,
    arrest,
    front_stress,
)
from slippulse_jax.lattice.lanes import length_rank, sorted_lengths
from slippulse_jax.lattice.modes import Fields, Modes, RightEnd, check_right_end, equilibrium_fields, lattice_modes
from slippulse_jax.lattice.surrogate import smooth_length
from slippulse_jax.rules import BreakRule, HardBreak, SmoothBreak, check_rule
from slippulse_jax.slider import Slider

HARD = HardBreak()

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
    front_stress: Float[Array, " sites"]  # t(s): on contact s once all before it have broken, past the arrest too
    modes: Modes

    def fields_at(self, front_position: int | Array) -> Fields:
        """Fields when contacts 0 … front_position − 1 have broken: 0 is nucleation, `contacts_broken` is arrest."""
        broken = jnp.arange(self.front_stress.shape[0]) < front_position
        return equilibrium_fields(self.modes, self.load, jnp.where(broken, self.front_stress, 0))

    @property
    def edge_stress(self) -> Float[Array, ""]:
        """Stress on contact 0 at arrest, the largest behind the front; in σ_s."""
        return self.arrest.stress[0]

    def __str__(self) -> str:
        if isinstance(self.length, Tracer) or self.length.ndim:
            return repr(self)
        status = FrontStatus(int(self.status))
        return (
            f"first precursor: {int(self.contacts_broken)} contacts broken, length {float(self.length):.6g} λc, "
            f"load at nucleation {float(self.load):.6g} u_s; {status.message}"
        )

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
    rule: BreakRule = HARD,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> Float[Array, "..."]:
    """Length ℓ of the first precursor, in λc.

    ℓ is where the stress on the contact ahead, drawn as a straight line between the last contact that broke and the
    first that did not, falls to its threshold. The whole-contact count of the paper is s0 = ceil(ℓ) (for s0 > 1), and
    Λ = s0 λc. Where the neighbour of the edge contact does not break there is no domino: s0 = 1, ℓ = 0, and ℓ is flat; where
    it starts to break, ℓ jumps from 0 to 1. On tall and stiff sliders the contact at the edge may be back at its threshold
    before the front stops: ℓ is the length of that front, and `first_precursor` says so by its status.

    Parameters
    ----------
    slider : Slider
        One slider or a batch; ℓ has its shape.
    rule : HardBreak or SmoothBreak
        What a contact does at its threshold: breaks as a whole (the paper's rule), or gradually, over a width. The smooth
        length has no kinks, a bias that the documentation gives, and a derivative in the width too; semi-infinite chains only.
    right : {"semi-infinite", "free", "clamped"}
        Right end of the chain; the paper's theory is semi-infinite.
    sites : int, optional
        Number of sites of a finite chain.
    max_contacts : int
        Breaks after which the front is given up.

    Returns
    -------
    array
        ℓ ≥ 0; inf where the front reaches the right end of a finite chain; NaN in the lanes of a batch, or under
        ``jit`` and ``vmap``, where the front was given up or the (traced) slider is not physical. A length that is not
        finite has no finite derivative.

    Raises
    ------
    FrontNotArrested
        If a single front, called outside ``jit``, was given up. A batch warns instead, and says which.

    Notes
    -----
    Differentiable in (height, stiffness, poisson) to any order, forward and reverse: the crossing is differentiated
    implicitly, by one pass of the recursion that carries three tangents. From 1 on ℓ is continuous in the parameters, and
    smooth between sites; where ℓ passes through a whole number the straight line changes, and the derivative returned is that
    of the longer side (contact broken at exactly its threshold). Time is proportional to ℓ, memory constant.

    In single precision the error stays below 0.01 λc up to H/λc = 1000 and reaches 3e-4 of the length at H/λc = 1e5:
    above 1000 a warning says so, once. Work under ``jax.enable_x64(True)`` there.
    """
    check_right_end(right, sites)
    _check_max_contacts(max_contacts)
    check_rule(rule)
    _warn_single_precision(slider)
    if isinstance(rule, SmoothBreak):
        return _smooth_length(slider, rule, right, max_contacts)
    length = _length_function(right, sites, max_contacts)(_parameters(slider))
    if not isinstance(length, Tracer) and np.isnan(length).any():
        status = _status_function(right, sites, max_contacts)(_parameters(slider))
        _report_without_length(np.asarray(status), max_contacts, raises=length.ndim == 0)
    return length


def first_precursor(
    slider: Slider,
    *,
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
    right, sites, max_contacts
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
    # the count has no derivative and must not stop that of the rest: the length brings its own
    ended = _arrest_function(right, sites, max_contacts)(lax.stop_gradient(_parameters(slider)))
    modes = lattice_modes(slider, right, sites)
    traced = isinstance(ended.contacts_broken, Tracer)
    if recorded_sites is None:
        if sites is None and traced:
            raise ValueError("first_precursor under jit or vmap needs recorded_sites: the length is not known beforehand")
        recorded_sites = sites if sites is not None else max(4 * int(ended.contacts_broken), 16)
    if not traced and recorded_sites < int(ended.contacts_broken):
        raise ValueError(f"recorded_sites = {recorded_sites}, but {int(ended.contacts_broken)} contacts broke")
    return FirstPrecursor(
        slider=slider,
        contacts_broken=jnp.asarray(ended.contacts_broken),
        length=_length_function(right, sites, max_contacts)(_parameters(slider)),
        load=modes.load,
        status=jnp.asarray(ended.status),
        front_stress=front_stress(modes, recorded_sites),
        modes=modes,
    )


def precursor_lengths(
    slider: Slider,
    *,
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
    right, sites, max_contacts
        As for `precursor_length`.

    Returns
    -------
    numpy.ndarray
        float64, of shape ``slider.shape``; inf and NaN as for `precursor_length`, with a warning for the latter.
    """
    check_right_end(right, sites)
    _check_max_contacts(max_contacts)
    if right == "semi-infinite":
        lengths = sorted_lengths(_lanes(slider), max_contacts).reshape(slider.shape)
    else:
        lengths = precursor_arrests(slider, right=right, sites=sites, max_contacts=max_contacts).length
    if np.isnan(lengths).any():
        # in double precision every slider that could be made is one
        _report_without_length(np.where(np.isnan(lengths), FrontStatus.LIMIT, 0), max_contacts, raises=False)
    return np.asarray(lengths)


def precursor_arrests(
    slider: Slider,
    *,
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
) -> Arrest:
    """Count, length, status and edge stress of a batch of any size, as an `Arrest` of NumPy arrays of its shape.

    What `precursor_lengths` computes, with all that is known of each lane; nothing is raised or warned about a lane.
    """
    check_right_end(right, sites)
    _check_max_contacts(max_contacts)
    lanes = _lanes(slider).T
    order = np.argsort(length_rank(lanes.T), kind="stable")
    result = Arrest(*(np.empty(len(lanes), dtype) for dtype in (np.int32, np.float64, np.int32, np.float64)))
    with jax.enable_x64(True):
        arrest_chunk = _chunk_function(right, sites, max_contacts)
        for start in range(0, len(lanes), _LANES):
            chosen = order[start : start + _LANES]
            padded = np.resize(chosen, _LANES)
            for column, values in zip(result, arrest_chunk(lanes[padded]), strict=True):
                column[chosen] = np.asarray(values)[: len(chosen)]
    return Arrest(*(column.reshape(slider.shape) for column in result))


_LANES = 1024  # lanes a chunk: the carried state of a chunk stays in the first-level cache


def _smooth_length(slider: Slider, rule: SmoothBreak, right: RightEnd, max_contacts: int) -> Float[Array, "..."]:
    if right != "semi-infinite":
        raise ValueError(f"right = {right!r}: a smooth rule in the fast recursion needs a semi-infinite chain; use sp.rupture")
    length, status = _smooth_function(max_contacts)(slider, rule)
    if not isinstance(length, Tracer) and np.isnan(length).any():
        _report_without_length(np.asarray(status), max_contacts, raises=length.ndim == 0)
    return length


@functools.cache
def _smooth_function(max_contacts: int) -> Callable[[Slider, SmoothBreak], tuple[Array, Array]]:
    return eqx.filter_jit(lambda slider, rule: smooth_length(slider, rule, max_contacts=max_contacts))


def _fields(slider: Slider) -> tuple[Any, Any, Any]:
    return slider.height, slider.stiffness, slider.poisson


def _lanes(slider: Slider) -> Float[np.ndarray, "3 n"]:
    if any(isinstance(x, Tracer) for x in _fields(slider)):
        raise TypeError("lengths in bulk take numbers, not values traced by jit, grad or vmap: use precursor_length there")
    return np.stack([np.broadcast_to(np.asarray(x, np.float64), slider.shape).ravel() for x in _fields(slider)])


def _parameters(slider: Slider) -> Float[Array, "... 3"]:
    return jnp.stack([jnp.broadcast_to(jnp.asarray(x), slider.shape) for x in _fields(slider)], axis=-1)


@functools.cache
def _length_function(right: RightEnd, sites: int | None, max_contacts: int) -> Callable[[Array], Array]:
    def length(parameters: Float[Array, "3"]) -> Array:
        return jnp.asarray(arrest(_slider(parameters), right, sites, max_contacts).length)

    return jax.jit(jnp.vectorize(by_forward_mode(length), signature="(n)->()"))


@functools.cache
def _status_function(right: RightEnd, sites: int | None, max_contacts: int) -> Callable[[Array], Array]:
    def status(parameters: Float[Array, "3"]) -> Array:
        return jnp.asarray(arrest(_slider(parameters), right, sites, max_contacts).status)

    return jax.jit(jnp.vectorize(status, signature="(n)->()"))


@functools.cache
def _chunk_function(right: RightEnd, sites: int | None, max_contacts: int) -> Callable[[np.ndarray], Arrest]:
    return jax.jit(jax.vmap(lambda parameters: arrest(_slider(parameters), right, sites, max_contacts)))


@functools.cache
def _arrest_function(right: RightEnd, sites: int | None, max_contacts: int) -> Callable[[Array], Arrest]:
    return jax.jit(lambda parameters: arrest(_slider(parameters), right, sites, max_contacts))


def _slider(parameters: Array) -> Slider:
    return Slider(parameters[0], parameters[1], parameters[2])


def _check_max_contacts(max_contacts: int) -> None:
    if not 1 <= max_contacts < 2**31 - 1:
        raise ValueError(f"max_contacts = {max_contacts}: must be at least 1 and below 2**31 - 1")


def _report_without_length(status: np.ndarray, max_contacts: int, *, raises: bool) -> None:
    """Raise or warn about the fronts that were given up, or whose slider is none (rounded to single precision, say)."""
    for kind in (FrontStatus.LIMIT, FrontStatus.INVALID):
        lanes = status == kind
        if not lanes.any():
            continue
        why = kind.message + (f"; max_contacts = {max_contacts}" if kind is FrontStatus.LIMIT else "")
        if raises:
            raise FrontNotArrested(why) if kind is FrontStatus.LIMIT else ValueError(why)
        first = tuple(int(i) for i in np.argwhere(lanes)[0])
        message = f"{int(lanes.sum())} of {lanes.size} fronts, the first at index {first}, have no length (NaN): {why}"
        warnings.warn(message, RuntimeWarning, stacklevel=3)


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
