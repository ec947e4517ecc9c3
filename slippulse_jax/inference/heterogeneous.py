"""Lengths of first precursors on a heterogeneous interface, and their derivatives.

The edge is pushed until some contact reaches its threshold, which need not be contact 0: where the threshold falls or the
prestress rises away from the edge, contact i breaks first, at the load

    A = min_i (θ_i − φ_i)/D(i),    D(i) = Σ_m C_m r_m^i,

the stress that the edge puts on contact 0. From there the event spreads both ways. In the model the contacts break from the
edge on under that load, which gives ℓ to some 0.01 λc where the event starts within a few λc of the edge. Breaking the most
overloaded contact each time (`slippulse_jax.events.event`) shows what that leaves out: events that start far inside, stop short
of the edge, or break a contact twice.

Two functions of the unknown u, which is the profile at its knots (ln(θ/θ_0), or φ in σ_s) followed by the shift of ln k:

- the lengths, which jump where a strong place begins to stop a front that used to pass it;
- the excess stress e = t − θ at the measured arrest, which is zero where the model agrees. It is smooth in u wherever the front
  stops, so a search starts with it. Near the solution both are equivalent: ℓ − measured = −e/e'.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, Int

from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.events.event import first_to_break
from slippulse_jax.events.first import first_event
from slippulse_jax.front.front import end_of_front, run_over
from slippulse_jax.inference.table.measurements import MeasurementError, Measurements
from slippulse_jax.slider import Slider

ProfileKind = Literal["threshold", "prestress"]

MOST_KNOTS = 256
"""Most knots of a profile; between them it is a straight line."""

LANES = 8
"""Fronts computed together: one compiled program serves any number of measurements."""


class Linearised(NamedTuple):
    """Lengths of n fronts at one u, with derivatives in u."""

    length: np.ndarray  # (n,) ℓ in λc; NaN where the front does not stop within the sites
    by_length: np.ndarray  # (n, k + 1)
    excess: np.ndarray  # (n,) e at the measured arrest, in σ_s
    by_excess: np.ndarray  # (n, k + 1)
    slope: np.ndarray  # (n,) e' there, per λc
    stress: np.ndarray  # (n,) t there


class ProfileProblem(NamedTuple):
    """Lengths measured on one interface under n sliders."""

    kind: ProfileKind
    knots: np.ndarray  # (k,) in λc
    between: np.ndarray  # (sites, k), share of each knot in the profile at each contact, a straight line between knots
    measured: np.ndarray  # (n,) lengths, in λc
    sigma: np.ndarray  # (n,) their standard errors, in λc
    sliders: tuple[np.ndarray, ...]  # (n,) H/λc, k/K and ν
    threshold: np.ndarray  # (n, sites), known factor of the threshold
    prestress: np.ndarray  # (n, 1), known part of the prestress

    def chi2(self, length: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "..."]:
        """Σ [(ℓ − measured)/σ]²."""
        return (((length - self.measured) / self.sigma) ** 2).sum(axis=-1)

    def lanes(self, u: Float[np.ndarray, "... k1"]) -> tuple[np.ndarray, ...]:
        """H/λc, k/K, ν by front, θ and φ by contact."""
        height, stiffness, poisson = self.sliders
        along = (u[..., :-1] @ self.between.T)[..., None, :]
        factor, more = (np.exp(along), 0 * along) if self.kind == "threshold" else (1 + 0 * along, along)
        return height, stiffness * np.exp(u[..., -1:]), poisson, self.threshold * factor, self.prestress + more

    def linearised(self, u: Float[np.ndarray, " k1"]) -> Linearised:
        """Lengths and excess stresses of all fronts, with derivatives."""
        *sliders, theta, phi = self.lanes(u)
        n = len(self.measured)
        padded = np.resize(np.arange(n), LANES * -(-n // LANES))
        with jax.enable_x64(True):
            found = _linearised(*(lane[padded] for lane in (*sliders, theta, phi, self.measured)))
        length, excess, *slopes, slope, stress = (np.array(x)[:n] for x in found)

        def in_u(by_theta: np.ndarray, by_phi: np.ndarray, by_log_k: np.ndarray) -> np.ndarray:
            by_site = by_phi
            if self.kind == "threshold":
                by_site = by_theta * theta
                by_site[:, 0] = 0  # θ_0 is the unit
            return np.column_stack([by_site @ self.between, by_log_k])

        return Linearised(length, in_u(*slopes[:3]), excess, in_u(*slopes[3:]), slope, stress)


def profile_problem(m: Measurements, kind: ProfileKind, stiffness: ArrayLike) -> ProfileProblem:
    """Set up the problem, with k/K of shape () or (n,).

    Their prestress and threshold slope are known parts of the interface. A MeasurementError if one is neither a length nor a
    count, a standard error is missing, or they are not of one interface under sliders.
    """
    measured, sigma = _lengths(m)
    sites = 64 * int(np.ceil((1.3 * (measured + 4 * sigma).max() + 16) / 64))
    phi, slope = (m.or_zero(name)[:, None] for name in ("prestress", "threshold_slope"))
    slider = Slider(m.height, np.asarray(stiffness, dtype=np.float64), m.poisson)
    sliders = tuple(np.broadcast_to(x, (len(m),)) for x in (slider.height, slider.stiffness, slider.poisson))
    knots = np.linspace(0, sites - 1, min(sites, MOST_KNOTS))
    return ProfileProblem(
        kind=kind,
        knots=knots,
        between=np.stack([np.interp(np.arange(sites), knots, one) for one in np.eye(len(knots))], axis=1),
        measured=measured,
        sigma=sigma,
        sliders=sliders,
        threshold=1 + slope * np.arange(sites),
        prestress=phi,
    )


def _lengths(m: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Lengths and errors in λc; counts at their last contact's middle."""
    if m.correlation_length is not None and np.ptp(m.correlation_length) > 1e-9 * m.correlation_length[0]:
        raise MeasurementError(f"{m.source}: several correlation lengths: these lengths are not from one interface")
    if m.push_height is not None:
        raise MeasurementError(f"{m.source}, column {m.heading('push_height')}: recover_profile takes sliders")
    if not np.isfinite(m.sigma).all():
        raise MeasurementError(f"{m.source}: recover_profile needs the standard errors of the lengths")
    whole = np.array(m.kind) == "whole"
    for i in np.flatnonzero(~whole & (np.array(m.kind) != "length")).tolist():
        raise MeasurementError(f"{m.place(i)}: kind {m.kind[i]!r}: recover_profile takes lengths and whole-contact counts")
    return m.length - 0.5 * whole, np.sqrt(m.sigma**2 + whole / 12)


def followed(
    height: ArrayLike,
    stiffness: ArrayLike,
    poisson: ArrayLike,
    theta: Float[np.ndarray, "*batch sites"],
    phi: Float[np.ndarray, "*batch sites"],
    *,
    next_break: Literal["neighbour", "most overloaded"],
) -> tuple[Float[np.ndarray, "*batch"], Int[np.ndarray, "*batch"]]:
    """Follow events from the load at which the first contact breaks.

    H/λc, k/K and ν broadcast with the batch of profiles, threshold and prestress of every contact in σ_s. Contacts break one
    after another from the edge on, or each time the most overloaded. Return ℓ of each event in λc, NaN where it does not stop
    within the sites, and the contact that breaks first.
    """
    shape, sites = theta.shape[:-1], theta.shape[-1]
    numbers = [np.broadcast_to(x, shape).ravel() for x in (height, stiffness, poisson)]
    program = _fronts if next_break == "neighbour" else _ruptures
    with jax.enable_x64(True):
        found = program(*numbers, theta.reshape(-1, sites), phi.reshape(-1, sites))
    length, start = (np.asarray(x).reshape(shape) for x in found)
    return length, start


def _front(height: Array, stiffness: Array, poisson: Array, theta: Array, phi: Array) -> tuple[Array, Array, Array]:
    """ℓ or NaN, the contact that sets the load, and all t."""
    modes = lattice_modes(Slider(height, stiffness, poisson))
    site = jnp.arange(theta.size)
    push = jax.vmap(modes.profile)(site.astype(theta.dtype)) @ modes.drive
    first, load = first_to_break(push[None], theta, phi[None])
    stress = run_over(modes, load + phi[0], phi)
    excess = stress - theta
    holds = (excess < 0) & (site > first)  # contacts up to the one that breaks first have broken by then
    s0 = jnp.argmax(holds)
    behind = jnp.where(s0 == 1, 0.0, excess[s0 - 1])  # contact 0 breaks at its threshold exactly
    length = end_of_front(s0, (excess[s0], behind))  # neighbours differ: a straight line
    return jnp.where(holds.any(), length, jnp.nan), first, stress


_fronts = jax.jit(jax.vmap(lambda *lane: _front(*lane)[:2]))


@jax.jit
def _ruptures(*lanes: Array) -> tuple[Array, Array]:
    def one(lane: tuple[Array, ...]) -> tuple[Array, Array]:
        height, stiffness, poisson, theta, phi = lane
        contacts = Slider(height, stiffness, poisson).contacts(None, theta.size)
        found, start = first_event(contacts._replace(threshold=theta, prestress=phi), kind="full")
        excess = found.stress - theta
        stopped = (excess < 0).all() & (found.rightmost < theta.size - 1)
        return jnp.where(stopped, found.length(excess, theta.size - 1), jnp.nan), start.first

    return lax.map(one, lanes)


@jax.jit
@jax.vmap
def _linearised(height: Array, stiffness: Array, poisson: Array, theta: Array, phi: Array, at: Array) -> tuple[Array, ...]:
    """ℓ, e at the arrest, their derivatives, and e' and t there."""

    def values(theta: Array, phi: Array, log_factor: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        length, _, stress = _front(height, stiffness * jnp.exp(log_factor), poisson, theta, phi)
        excess, slope = _between(stress - theta, at)
        return (length, excess), (slope, _between(stress, at)[0])

    found, pulled, there = jax.vjp(values, theta, phi, jnp.zeros_like(stiffness), has_aux=True)
    one, zero = jnp.ones_like(at), jnp.zeros_like(at)
    return *found, *pulled((one, zero)), *pulled((zero, one)), *there


def _between(values: Array, at: Array) -> tuple[Array, Array]:
    """Interpolate linearly between sites: value and slope at a real position."""
    left = jnp.clip(jnp.floor(at).astype(jnp.int32), 0, values.size - 2)
    slope = values[left + 1] - values[left]
    return values[left] + (at - left) * slope, slope
