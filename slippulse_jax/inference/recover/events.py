"""Events on given profiles, in NumPy: many profiles by their fronts, one profile contact by contact.

`fronts` breaks the contacts from the edge on, as `slippulse_jax.inference.recover.model` does, for many profiles at once.
`follow` breaks the most overloaded contact again and again, wherever it lies, and so finds what the first leaves out: events
that start far inside, stop short of the edge, or break a contact twice.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from slippulse_jax.lattice.front import Front, advance, straight_line, stress_ahead
from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.slider import Slider

MOST_BREAKS = 20
"""Breaks per contact followed at most."""


class Blocks(NamedTuple):
    """Responses of blocks; the leading axes run over the modes, the others over the blocks."""

    gap: Float[np.ndarray, "2 ..."]  # 1 − r_m
    weight: Float[np.ndarray, "2 ..."]
    reflection: Float[np.ndarray, "2 2 ..."]
    amplitude: Float[np.ndarray, "2 ..."]  # C_m

    def profile(self, sites: int) -> Float[np.ndarray, "2 sites ..."]:
        """r_m^s."""
        site = np.arange(sites).reshape(-1, *(1,) * (self.gap.ndim - 1))
        return np.exp(site * np.log1p(-self.gap)[:, None])

    def drive(self, sites: int) -> Float[np.ndarray, "sites ..."]:
        """D(s), the stress that the edge puts on contact s per stress on contact 0."""
        return (self.amplitude[:, None] * self.profile(sites)).sum(axis=0)

    def take(self, which: Any) -> "Blocks":
        """Some of the blocks."""
        which = which if isinstance(which, tuple) else (which,)
        return Blocks(*(x[(..., *which)] for x in self))


class Fronts(NamedTuple):
    """One per block and profile."""

    length: Float[np.ndarray, "..."]  # ℓ, in λc; NaN where the front does not stop
    start: Int[np.ndarray, "..."]  # contact that breaks first


class Event(NamedTuple):
    """One event, followed contact by contact."""

    length: float  # ℓ, in λc; NaN where it does not stop within the contacts followed
    start: int
    left: int  # the leftmost contact that broke
    again: bool  # whether a contact broke twice


def blocks(height: np.ndarray, stiffness: np.ndarray, poisson: np.ndarray) -> Blocks:
    """Responses of blocks, given by arrays that broadcast."""
    numbers = np.broadcast_arrays(height, stiffness, poisson)
    shape, count = numbers[0].shape, numbers[0].size
    padded = np.resize(np.arange(count), 4 ** int(np.ceil(np.log(max(count, 16)) / np.log(4) - 1e-9)))  # few shapes to compile
    with jax.enable_x64(True):
        found = _modes(Slider(*(x.ravel()[padded] for x in numbers)))
    return Blocks(*(np.moveaxis(np.asarray(x)[:count], 0, -1).reshape(*x.shape[1:], *shape) for x in found))


@jax.jit
def _modes(slider: Slider) -> tuple[jax.Array, ...]:
    found = jax.vmap(lattice_modes)(slider)
    return found.gap, found.weight, found.reflection, found.drive


def fronts(of: Blocks, theta: Float[np.ndarray, "... sites"], phi: Float[np.ndarray, "... sites"]) -> Fronts:
    """Follow fronts whose contacts break from the edge on, under the load at which the first contact breaks.

    Parameters
    ----------
    of : Blocks
    theta, phi : array, shape (..., sites)
        Threshold and prestress of every contact, in σ_s; their leading axes broadcast with the blocks.
    """
    theta, phi = np.moveaxis(theta, -1, 0), np.moveaxis(phi, -1, 0)
    wait = (theta - phi) / of.drive(len(phi))
    start, load = wait.argmin(axis=0), wait.min(axis=0)
    at = Front(of.amplitude * load, of.reflection, None, 0, 0, None)
    length, behind = np.full(load.shape, np.nan), np.zeros(load.shape)
    for site in range(len(phi)):
        stress = phi[site] + stress_ahead(at)[0]
        ahead = stress - theta[site]
        stops = np.isnan(length) & (ahead < 0) & (site > start)
        # contact 0 breaks at its threshold exactly
        length[stops] = straight_line(site - 1, behind[stops] if site > 1 else 0.0, ahead[stops])
        if not np.isnan(length).any():
            break
        behind, at = ahead, advance(of, at, stress)
    return Fronts(length, start)


def follow(of: Blocks, theta: Float[np.ndarray, " sites"], phi: Float[np.ndarray, " sites"]) -> Event:
    """Break the most overloaded contact of one block until none is at its threshold, starting with the first to reach it."""
    sites = len(theta)
    profile, drive = of.profile(sites), of.drive(sites)
    wait = (theta - phi) / drive
    start = site = int(wait.argmin())
    stress = phi + wait[start] * drive
    excess, overload, again = stress - theta, np.full(sites, np.nan), False
    for _ in range(MOST_BREAKS * sites):
        if np.isnan(overload[site]):
            overload[site] = excess[site]
        else:
            again = True
        released = stress[site]
        stress = stress + released * transfer(of, profile, site)
        stress[site] -= released
        excess = stress - theta
        site = int(excess.argmax())
        if excess[site] < 0:
            break
    broken = np.flatnonzero(~np.isnan(overload))
    last = int(broken[-1])
    stopped = excess[site] < 0 and last < sites - 1
    # as `event_length`, in double precision whatever the flag
    length = float(straight_line(last, max(overload[last], 0.0), excess[last + 1])) if stopped else np.nan
    return Event(length, start, int(broken[0]), bool(again))


def transfer(of: Blocks, profile: Float[np.ndarray, "2 sites"], site: int) -> Float[np.ndarray, " sites"]:
    """Stress on every contact of one block per stress released at one: directly, and by way of the edge."""
    direct = np.concatenate([profile[:, site:0:-1], profile[:, : profile.shape[1] - site]], axis=1)
    return of.weight @ direct + (of.reflection @ profile[:, site]) @ profile
