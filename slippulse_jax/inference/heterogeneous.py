"""Lengths of first precursors on one heterogeneous interface under several sliders, and their derivatives in its profile.

The edge is pushed until some contact reaches its threshold, which need not be contact 0: where the threshold falls or the
prestress rises away from the edge, contact i breaks first, at the load

    A = min_i (θ_i − φ_i)/D(i),    D(i) = Σ_m C_m r_m^i,

the stress that the edge puts on contact 0. From there the event spreads both ways. Here the contacts break from the edge on
under that load (`fronts`, many profiles at once), which gives ℓ to some 0.01 λc where the event starts within a few λc of the
edge. `followed` breaks the most overloaded contact again and again, wherever it lies (`slippulse_jax.events.event`), and so
finds what that leaves out: events that start far inside, stop short of the edge, or break a contact twice.

Two functions of the unknown u, which is the profile at its knots (ln(θ/θ_0), or φ in σ_s) followed by the shift of ln k:

- the lengths, which jump where a strong place begins to stop a front that used to pass it;
- the excess stress e = t − θ at the measured arrest, which is zero where the model agrees. It is smooth in u wherever the front
  stops, so a search starts with it. Near the solution both are equivalent: ℓ − measured = −e/e'.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, Int

from slippulse_jax.bodies.modes import Modes, lattice_modes
from slippulse_jax.bodies.response import of_slider
from slippulse_jax.events.event import first_event
from slippulse_jax.front.front import straight_line, sweep
from slippulse_jax.inference.measurements import MeasurementError, Measurements
from slippulse_jax.slider import Slider

ProfileKind = Literal["threshold", "prestress"]

Sliders = tuple[np.ndarray, np.ndarray, np.ndarray]
"""H/λc, k/K and ν, of shapes that broadcast."""

MOST_KNOTS = 256
"""Most knots of a profile; between them it is a straight line."""

LANES = 8
"""Fronts computed together: one compiled program serves any number of measurements."""


Linearised = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""The model at one u, of n fronts: lengths in λc, or excess stresses at the measured arrests in σ_s, shape (n,); derivatives of
these in u, (n, k + 1); t as each front comes to each contact, (n, sites); and e' at the measured arrests, per λc, (n,)."""


class ProfileProblem(NamedTuple):
    """Lengths measured on one interface under n sliders, and what is known of its profile before."""

    kind: ProfileKind
    knots: np.ndarray  # (k,) in λc
    between: np.ndarray  # (sites, k), share of each knot in the profile at each contact, a straight line between knots
    measured: np.ndarray  # (n,) lengths, in λc
    sigma: np.ndarray  # (n,) their standard errors, in λc
    mean: np.ndarray  # (k + 1,) of u before
    log_stiffness_sd: float
    sliders: Sliders  # (n,) each
    threshold: np.ndarray  # (n, sites), known factor of the threshold
    prestress: np.ndarray  # (n, sites), known part of the prestress

    def lengths(self, u: Float[np.ndarray, " k1"]) -> Linearised:
        """ℓ of every front; NaN where it does not stop within the sites."""
        return self._linearised(_LENGTHS, u)

    def excess(self, u: Float[np.ndarray, " k1"]) -> Linearised:
        """Excess stress t − θ at every measured arrest."""
        return self._linearised(_EXCESSES, u)

    def chi2(self, length: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "..."]:
        """Σ [(ℓ − measured)/σ]²."""
        return (((length - self.measured) / self.sigma) ** 2).sum(axis=-1)

    def sliders_at(self, u: Float[np.ndarray, "... k1"]) -> Sliders:
        """H/λc, k/K and ν, the stiffness moved as u says."""
        height, stiffness, poisson = self.sliders
        return height, stiffness * np.exp(u[..., -1:]), poisson

    def contacts(
        self, u: Float[np.ndarray, "... k1"]
    ) -> tuple[Float[np.ndarray, "... n sites"], Float[np.ndarray, "... n sites"]]:
        """θ and φ of every contact, in σ_s, as each block meets them."""
        along = (u[..., :-1] @ self.between.T)[..., None, :]
        if self.kind == "threshold":
            return self.threshold * np.exp(along), self.prestress + 0 * along
        return self.threshold + 0 * along, self.prestress + along

    def _linearised(self, function: Callable[..., tuple[Array, ...]], u: np.ndarray) -> Linearised:
        theta, phi = self.contacts(u)
        lanes = (*self.sliders_at(u), self.measured, theta, phi)
        n = len(self.measured)
        padded = np.resize(np.arange(n), LANES * -(-n // LANES))
        with jax.enable_x64(True):
            columns = function(*(lane[padded] for lane in lanes))
        value, by_theta, by_phi, by_log_k, stress, slope = (np.array(x)[:n] for x in columns)
        by_site = by_phi
        if self.kind == "threshold":
            by_site = by_theta * theta
            by_site[:, 0] = 0  # θ_0 is the unit
        return value, np.column_stack([by_site @ self.between, by_log_k]), stress, slope


def profile_problem(
    m: Measurements,
    kind: ProfileKind,
    stiffness: ArrayLike,
    *,
    mean: float = 0.0,
    log_stiffness_sd: float = 0.0,
    knots: int = MOST_KNOTS,
) -> ProfileProblem:
    """Set up the problem of these measurements, with their prestress and threshold slope as known parts of the interface.

    Parameters
    ----------
    m : Measurements
    kind : {"threshold", "prestress"}
    stiffness : array_like, shape () or (n,)
        k/K.
    mean : float
        Prior mean of a prestress, in σ_s.
    log_stiffness_sd : float
        Standard error of ln k.
    knots : int
        Largest number of positions at which the profile is described, evenly spaced.
    """
    measured, sigma = _lengths(m)
    sites = 64 * int(np.ceil((1.3 * (measured + 4 * sigma).max() + 16) / 64))
    phi, slope = (m.or_zero(name)[:, None] for name in ("prestress", "threshold_slope"))
    slider = Slider(m.height, np.asarray(stiffness, dtype=np.float64), m.poisson)
    height, ratio, poisson = (np.broadcast_to(x, (len(m),)) for x in (slider.height, slider.stiffness, slider.poisson))
    knot = np.linspace(0, sites - 1, min(sites, knots))
    k = len(knot)
    return ProfileProblem(
        kind=kind,
        knots=knot,
        between=np.stack([np.interp(np.arange(sites), knot, one) for one in np.eye(k)], axis=1),
        measured=measured,
        sigma=sigma,
        mean=np.append(np.full(k, mean if kind == "prestress" else 0.0), 0.0),
        log_stiffness_sd=log_stiffness_sd,
        sliders=(height, ratio, poisson),
        threshold=1 + slope * np.arange(sites),
        prestress=phi + np.zeros((len(m), sites)),
    )


def _lengths(m: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Lengths and standard errors in λc; a count stands for the middle of its last contact."""
    if m.push_height is not None:
        raise MeasurementError(
            f"{m.source}, column {m.columns.get('push_height', 'push_height')}: recover_profile takes sliders"
        )
    if m.length_sigma is None or not np.isfinite(m.length_sigma).all():
        raise MeasurementError(f"{m.source}: recover_profile needs the standard errors of the lengths")
    kinds = np.array(m.kind)
    whole = kinds == "whole"
    for i in np.flatnonzero(~whole & (kinds != "length")).tolist():
        raise MeasurementError(f"{m.place(i)}: kind {m.kind[i]!r}: recover_profile takes lengths and whole-contact counts")
    sigma = np.sqrt(m.length_sigma**2 + whole / 12)
    if not (sigma > 0).all():
        raise MeasurementError(f"{m.place(int(np.argmin(sigma)))}: a standard error must be positive")
    return m.length - 0.5 * whole, sigma


Followed = tuple[Float[np.ndarray, "..."], Int[np.ndarray, "..."]]
"""ℓ of each event in λc, NaN where it does not stop within the contacts followed; and the contact that breaks first."""


def fronts(sliders: Sliders, theta: Float[np.ndarray, "... sites"], phi: Float[np.ndarray, "... sites"]) -> Followed:
    """Follow fronts whose contacts break from the edge on, under the load at which the first contact breaks.

    Parameters
    ----------
    sliders : tuple of array
        Of shapes that broadcast with those of the profiles without their contacts.
    theta, phi : array, shape (..., sites)
        Threshold and prestress of every contact, in σ_s.
    """
    return _each(_fronts, sliders, theta, phi)


def followed(sliders: Sliders, theta: Float[np.ndarray, "... sites"], phi: Float[np.ndarray, "... sites"]) -> Followed:
    """Follow events in the order in which their contacts break, the most overloaded next.

    Parameters as for `fronts`.
    """
    return _each(_ruptures, sliders, theta, phi)


def _each(function: Callable[..., tuple[Array, Array]], sliders: Sliders, theta: np.ndarray, phi: np.ndarray) -> Followed:
    shape, sites = theta.shape[:-1], theta.shape[-1]
    numbers = [np.broadcast_to(x, shape).ravel() for x in sliders]
    with jax.enable_x64(True):
        length, start = function(*numbers, theta.reshape(-1, sites), phi.reshape(-1, sites))
    return np.asarray(length).reshape(shape), np.asarray(start).reshape(shape)


def _stress(slider: Slider, theta: Array, phi: Array) -> tuple[Array, Array]:
    """Stress on every contact as a front from the edge comes to it, and the contact whose threshold sets the load."""
    modes = lattice_modes(slider)
    load, first = edge_load(modes, theta, phi)
    return sweep(modes, load + phi[0], phi), first


@jax.jit
@jax.vmap
def _fronts(height: Array, stiffness: Array, poisson: Array, theta: Array, phi: Array) -> tuple[Array, Array]:
    stress, first = _stress(Slider(height, stiffness, poisson), theta, phi)
    return _length(stress - theta, first), first


@jax.jit
def _ruptures(*lanes: Array) -> tuple[Array, Array]:
    def one(lane: tuple[Array, ...]) -> tuple[Array, Array]:
        height, stiffness, poisson, theta, phi = lane
        response = of_slider(lattice_modes(Slider(height, stiffness, poisson)), theta.size)
        found, first, _, _ = first_event(response, theta, phi, kind="full")
        stress = found.contacts.stress[0]
        stopped = (stress < theta).all() & (found.rightmost < theta.size - 1)
        return jnp.where(stopped, found.length(stress, theta.size - 1), jnp.nan), first

    return lax.map(one, lanes)


def _along_the_front(function: Callable[[Array, Array, Array], Array]) -> Callable[..., tuple[Array, ...]]:
    """A function of the excess stress and the measured arrest, with its derivatives in θ, φ and ln k, for `LANES` fronts."""

    def one(height: Array, stiffness: Array, poisson: Array, at: Array, theta: Array, phi: Array) -> tuple[Array, ...]:
        def value(theta: Array, phi: Array, log_factor: Array) -> tuple[Array, Any]:
            stress, first = _stress(Slider(height, stiffness * jnp.exp(log_factor), poisson), theta, phi)
            excess = stress - theta
            return function(excess, at, first), (stress, _between(excess, at)[1])

        zero = jnp.zeros_like(stiffness)
        (found, (stress, slope)), derivatives = jax.value_and_grad(value, (0, 1, 2), has_aux=True)(theta, phi, zero)
        return found, *derivatives, stress, slope

    return jax.jit(jax.vmap(one))


_LENGTHS = _along_the_front(lambda excess, at, first: _length(excess, first))
_EXCESSES = _along_the_front(lambda excess, at, first: _between(excess, at)[0])


def edge_load(modes: Modes, theta: Array, phi: Array) -> tuple[Array, Array]:
    """A, the stress that the edge puts on contact 0 when the first contact reaches its threshold, and which contact that is."""
    drive = jax.vmap(modes.profile)(jnp.arange(theta.size, dtype=theta.dtype)) @ modes.drive
    load = (theta - phi) / drive
    return load.min(), load.argmin()


def _length(excess: Array, first: Array) -> Array:
    """ℓ, NaN where the front does not stop; contacts up to the one that breaks first have broken by then."""
    holds = (excess < 0) & (jnp.arange(excess.size) > first)
    s0 = jnp.argmax(holds)
    behind = jnp.where(s0 == 1, 0.0, excess[s0 - 1])  # contact 0 breaks at its threshold exactly
    length = straight_line((s0 - 1).astype(excess.dtype), behind, excess[s0])
    return jnp.where(holds.any(), length, jnp.nan)


def _between(values: Array, at: Array) -> tuple[Array, Array]:
    """Interpolate linearly between sites: value and slope at a real position."""
    left = jnp.clip(jnp.floor(at).astype(jnp.int32), 0, values.size - 2)
    slope = values[left + 1] - values[left]
    return values[left] + (at - left) * slope, slope
