"""Lengths of first precursors on one profile under several sliders, and their derivatives in the profile.

Two functions of the unknown u, which is the profile at its knots (ln(θ/θ_0), or φ in σ_s) followed by the shift of ln k:

- the lengths, which jump where a strong place begins to stop a front that used to pass it;
- the excess stress e = t − θ at the measured arrest, which is zero where the model agrees. It is smooth in u wherever the front
  stops, so a search starts with it. Near the solution both are equivalent: ℓ − measured = −e/e'.
"""

import functools
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.interface import Profile
from slippulse_jax.lattice.front import front_stress
from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.lattice.sensitivity import sensitivity
from slippulse_jax.slider import Slider

Kind = Literal["threshold", "prestress"]

LANES = 8
"""Fronts computed together: one compiled program serves any number of measurements."""


class Look(NamedTuple):
    """The model at one u."""

    value: np.ndarray  # (n,) lengths in λc, or excess stresses at the measured arrests in σ_s
    derivative: np.ndarray  # (n, k + 1), in u
    stress: np.ndarray  # (n, sites), t as each front comes to each contact
    slope: np.ndarray  # (n,) e' at the measured arrest, per λc


class ProfileModel(NamedTuple):
    """One interface under n sliders."""

    kind: Kind
    knots: np.ndarray  # (k,)
    measured: np.ndarray  # (n,) lengths, in λc
    lanes: tuple[np.ndarray, np.ndarray, np.ndarray]  # height, stiffness, poisson, each (n,)
    threshold: np.ndarray  # (n, sites), known factor of the threshold
    prestress: np.ndarray  # (n, sites), known part of the prestress

    def lengths(self, u: Float[np.ndarray, " k1"]) -> Look:
        """ℓ of every front; NaN where it does not stop within the sites."""
        return self._look(_lengths, u)

    def excess(self, u: Float[np.ndarray, " k1"]) -> Look:
        """Excess stress t − θ at every measured arrest."""
        return self._look(_excesses, u)

    def _look(self, function: Any, u: np.ndarray) -> Look:
        sites = self.threshold.shape[1]
        along = np.interp(np.arange(sites), self.knots, u[:-1])
        varies = self.kind == "threshold"
        theta = self.threshold * np.exp(along) if varies else self.threshold
        phi = self.prestress if varies else self.prestress + along
        height, stiffness, poisson = self.lanes
        lanes = (height, stiffness * np.exp(u[-1]), poisson, self.measured, theta, phi)
        padded = np.resize(np.arange(len(height)), LANES * -(-len(height) // LANES))
        with jax.enable_x64(True):
            columns = function()(*(lane[padded] for lane in lanes))
        value, by_theta, by_phi, by_log_k, stress, slope = (np.array(x)[: len(height)] for x in columns)
        by_site = by_theta * theta if varies else by_phi
        if varies:
            by_site[:, 0] = 0  # θ_0 is the unit
        return Look(value, np.column_stack([_onto_knots(by_site, self.knots), by_log_k]), stress, slope)


def profile_model(
    m: Measurements, kind: Kind, stiffness: np.ndarray, measured: np.ndarray, sites: int, knots: int
) -> ProfileModel:
    """Build the model of these measurements, with their prestress and threshold slope as known parts.

    Parameters
    ----------
    m : Measurements
    kind : {"threshold", "prestress"}
    stiffness : array, shape () or (n,)
        k/K.
    measured : array, shape (n,)
        Lengths in λc.
    sites : int
        Contacts followed.
    knots : int
        Largest number of positions at which the profile is described, evenly spaced.
    """
    n = len(m)
    site = np.arange(sites)
    phi, slope = (m.or_zero(name)[:, None] for name in ("prestress", "threshold_slope"))
    slider = Slider(m.height, stiffness, m.poisson)
    lanes = tuple(np.broadcast_to(np.asarray(x), (n,)) for x in (slider.height, slider.stiffness, slider.poisson))
    return ProfileModel(
        kind=kind,
        knots=np.linspace(0, sites - 1, min(sites, knots)),
        measured=measured,
        lanes=(lanes[0], lanes[1], lanes[2]),
        threshold=1 + slope * site,
        prestress=phi + np.zeros((n, sites)),
    )


@functools.cache
def _lengths() -> Callable[..., tuple[Array, ...]]:
    def one(height: Array, stiffness: Array, poisson: Array, at: Array, theta: Array, phi: Array) -> tuple[Array, ...]:
        def length(log_factor: Array) -> tuple[Array, Any]:
            slider = Slider(height, stiffness * jnp.exp(log_factor), poisson)
            found = sensitivity(slider, Profile(theta, phi), sites=theta.size)
            return found.length, found

        zero = jnp.zeros_like(stiffness)
        _, by_log_k, found = jax.jvp(length, (zero,), (jnp.ones_like(zero),), has_aux=True)
        _, slope = _between(found.stress - theta, at)
        return found.length, found.threshold, found.prestress, by_log_k, found.stress, slope

    return jax.jit(jax.vmap(one))


@functools.cache
def _excesses() -> Callable[..., tuple[Array, ...]]:
    def one(height: Array, stiffness: Array, poisson: Array, at: Array, theta: Array, phi: Array) -> tuple[Array, ...]:
        def excess(theta: Array, phi: Array, log_factor: Array) -> tuple[Array, Any]:
            modes = lattice_modes(Slider(height, stiffness * jnp.exp(log_factor), poisson))
            stress = front_stress(modes, theta.size, Profile(theta, phi))
            value, slope = _between(stress - theta, at)
            return value, (stress, slope)

        zero = jnp.zeros_like(stiffness)
        (value, (stress, slope)), derivatives = jax.value_and_grad(excess, (0, 1, 2), has_aux=True)(theta, phi, zero)
        return value, *derivatives, stress, slope

    return jax.jit(jax.vmap(one))


def _between(values: Array, at: Array) -> tuple[Array, Array]:
    """Interpolate linearly between sites: value and slope at a real position."""
    left = jnp.clip(jnp.floor(at).astype(jnp.int32), 0, values.size - 2)
    slope = values[left + 1] - values[left]
    return values[left] + (at - left) * slope, slope


def _onto_knots(by_site: Float[np.ndarray, "n sites"], knots: np.ndarray) -> Float[np.ndarray, "n k"]:
    """Turn derivatives in the sites into derivatives in the knots, between which the profile is linear."""
    site = np.arange(by_site.shape[1])
    left = np.clip(np.searchsorted(knots, site, side="right") - 1, 0, len(knots) - 2)
    share = (site - knots[left]) / (knots[left + 1] - knots[left])
    result = np.zeros((len(by_site), len(knots)))
    for row, values in zip(result, by_site, strict=True):
        row += np.bincount(left, values * (1 - share), len(knots)) + np.bincount(left + 1, values * share, len(knots))
    return result
