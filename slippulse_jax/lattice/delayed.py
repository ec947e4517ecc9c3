r"""The first precursor on an interface with prestress, varying thresholds or delayed repinning, by a recursion of fixed size.

A contact that carries the prestress φ and is pinned at p carries t = u − p + φ, in σ_s; when it breaks and repins, p grows by
t. A detached contact carries t = 0, as one pinned at p = u + φ does. So with a delay of n sites the n contacts behind the front
are pinning points that follow the layer, p = u + φ, and those before them are at rest. In modes,

    t(s) = φ_s + Σ_m e_m(s) [ w_m S_m + r_m^s (A C_m + Σ_n R_mn T_n) ] + Σ_{window} G_sj p_j,        A = θ_0 − φ_0,

with S and T as in `slippulse_jax.lattice.front`, over the contacts at rest. The front goes on while t(s) ≥ θ_s. Without delay
there is no window and a break costs what it does there; with one it costs a solution of n equations.

Run-away. Behind a front far from the edge every contact gave up the same stress t, and t = φ + t Σ_{j≥1} G_{0j} with
Σ_j G_0j = 1 over the endless lattice, so t → 2φ/(1 + G_00): it stays above a uniform threshold of 1 if and only if
φ ≥ φ_c = (1 + G_00)/2. Below φ_c (or with rising thresholds) every front stops. Above it the front never stops, unless it
stops on its way to that state: far from the edge t approaches its limit as ρ_2^s, and on a soft, short slider it does so from
below. So only for φ ≥ φ_c, uniform, the recursion is cut off where that approach is over to rounding; on a profile,
as long after its last site.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.interface import Interface, Profile
from slippulse_jax.lattice.front import Arrest, in_domain
from slippulse_jax.lattice.modes import Modes, RightEnd, lattice_modes
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

APPROACH = 45.0
"""Decay lengths after which e^{−s/length} is nothing in float64."""


class DelayedFront(NamedTuple):
    """State of a front that has broken contacts 0 … position − 1."""

    position: Int[Array, ""]
    stress: Float[Array, ""]  # t(s)
    stress_before: Float[Array, ""]  # t(s−1) as it broke
    near: Float[Array, "2"]  # S_m, over contacts at rest
    edge: Float[Array, "2"]  # T_m, likewise
    window: Float[Array, " n"]  # p of the detached contacts, the one next to the front last; 0 left of the edge


def runaway_prestress(modes: Modes) -> Array:
    """φ_c = (1 + G_00)/2, in σ_s, of a semi-infinite chain (physics of the module's docstring)."""
    return (1 + modes.weight.sum(axis=0)) / 2


def _window(modes: Modes, prestress: Array, drive: Array, front: DelayedFront) -> tuple[Array, Array]:
    """Pinning points of the detached contacts, and the stress on the contact ahead."""
    n, s = front.window.shape[0], front.position
    offset = jnp.arange(n + 1)
    site = s - n + offset  # the last is the contact ahead
    inside = site >= 0
    log_ratio = jnp.log1p(-modes.gap)
    near = jnp.exp(jnp.outer(offset.astype(drive.dtype), log_ratio))
    # y at site s − n + a; the exponent is never positive where the site exists
    power = jnp.where(inside, site, 0).astype(drive.dtype)
    echo = jnp.stack([modes.echo_factor(jnp.maximum(i, 0)) for i in site]) if modes.echo is not None else jnp.ones_like(near)
    y = echo * jnp.exp(jnp.outer(power, log_ratio)) * inside[:, None]
    amplitude = drive * modes.drive + modes.reflection @ front.edge
    base = (echo * near) @ (modes.weight * front.near) + y @ amplitude
    if n == 0:
        return front.window, base[0] + prestress[0]
    apart = jnp.abs(offset[:, None] - offset[None, :]).astype(drive.dtype)
    later = jnp.maximum(offset[:, None], offset[None, :])
    endless = jnp.exp(apart[..., None] * log_ratio[None, None]) * (echo[later] if modes.echo is not None else 1)
    green = (endless @ modes.weight + y @ modes.reflection @ y.T) * inside[:, None] * inside[None, :]
    follow = jnp.eye(n) - green[:n, :n]
    window = jnp.linalg.solve(follow, jnp.where(inside, base + prestress, 0)[:n])
    return window, base[n] + prestress[n] + green[n, :n] @ window


def advance(modes: Modes, interface: Interface | Profile, drive: Array, front: DelayedFront) -> DelayedFront:
    """Break the contact ahead; the contact that has been detached longest repins first, where it is."""
    n, s = front.window.shape[0], front.position
    joined = jnp.append(front.window, front.stress)
    settled = joined[0]  # with n = 0 the breaking contact itself: p = t
    here = s - n
    echo = modes.echo_factor(jnp.maximum(here, 0))
    y = echo * jnp.exp(jnp.maximum(here, 0) * jnp.log1p(-modes.gap))
    near = front.near + settled
    moved = front._replace(
        position=s + 1,
        stress_before=front.stress,
        near=near - modes.gap * near,
        edge=front.edge + y * settled,
        window=joined[1:],
    )
    prestress = interface.prestress_at(jnp.maximum(s + 1 - n + jnp.arange(n + 1), 0))
    window, ahead = _window(modes, prestress, drive, moved)
    return moved._replace(window=window, stress=ahead)


def nucleate(modes: Modes, interface: Interface | Profile) -> tuple[DelayedFront, Array]:
    """The front about to break contact 0, which carries its threshold exactly, and the drive A = θ_0 − φ_0 for it."""
    zero = jnp.zeros_like(modes.load)
    threshold = interface.threshold_at(zero)
    drive = threshold - interface.prestress_at(zero)
    pair, window = jnp.zeros_like(modes.ratio), jnp.zeros(interface.repin_delay, modes.load.dtype)
    start = DelayedFront(jnp.zeros((), jnp.int32), threshold + zero, threshold + zero, pair, pair, window)
    return start, drive + zero


def slowest_approach(modes: Modes) -> Array:
    """1 − ρ_2 for the slow decay of the front stress: ρ solves (ρ − r_1)(ρ − r_2) = w_1 r_1 (ρ − r_2) + w_2 r_2 (ρ − r_1)."""
    (r1, r2), (w1, w2), (g1, g2) = modes.ratio, modes.weight, modes.gap
    # with x = 1 − μ: (g1 − x)(g2 − x) − w1 r1 (g2 − x) − w2 r2 (g1 − x) = 0
    total = g1 + g2 - w1 * r1 - w2 * r2
    product = g1 * g2 - w1 * r1 * g2 - w2 * r2 * g1
    return 2 * product / (total + jnp.sqrt(jnp.maximum(total**2 - 4 * product, 0)))


def arrest(slider: Slider, interface: Interface | Profile, right: RightEnd, sites: int | None, max_contacts: int) -> Arrest:
    """Length and status of the first precursor of one slider on one interface; differentiable forward."""
    modes = lattice_modes(slider, right, sites)
    start, drive = nucleate(modes, interface)
    uniform, since, prestress = _far_away(interface)
    never_stops = uniform & (prestress >= runaway_prestress(modes)) & (right == "semi-infinite")
    enough = jnp.minimum(since + APPROACH / slowest_approach(modes) + 10 + interface.repin_delay, 2.0e9)
    end = jnp.ceil(jnp.minimum(jnp.where(never_stops, enough, 2.0e9), interface.last_site()))
    chain_end = 2**31 - 1 if sites is None else sites
    limit = jnp.minimum(jnp.minimum(jnp.minimum(end, 2.0e9).astype(jnp.int32), max_contacts), chain_end)

    def excess(front: DelayedFront) -> Array:
        return front.stress - interface.threshold_at(front.position.astype(front.stress.dtype))

    def over_threshold(front: DelayedFront) -> Array:
        return (excess(front) >= 0) & (front.position < limit)

    front = lax.while_loop(over_threshold, lambda f: advance(modes, interface, drive, f), start)
    s0, ahead = front.position, excess(front)
    behind = front.stress_before - interface.threshold_at((s0 - 1).astype(front.stress.dtype))
    at_edge = edge_stress(modes, interface, drive, front)
    valid = in_domain(slider) & interface.in_domain() & jnp.isfinite(ahead)
    endings = {
        Outcome.INVALID: ~valid,
        Outcome.RAN_THROUGH: (s0 == sites) if sites is not None else jnp.zeros((), bool),
        Outcome.RUN_AWAY: (ahead >= 0) & (s0 >= end),
        Outcome.LIMIT: ahead >= 0,
        Outcome.NO_DOMINO: s0 == 1,
        Outcome.REBREAK: at_edge >= interface.threshold_at(jnp.zeros_like(ahead)),
    }
    status = jnp.select(list(endings.values()), list(endings), Outcome.ARRESTED).astype(jnp.int32)
    length = s0 - 1 + behind / (behind - ahead)
    infinite = (status == Outcome.RAN_THROUGH) | (status == Outcome.RUN_AWAY)
    undefined = jnp.where(infinite, jnp.inf, jnp.nan)
    return Arrest(s0, jnp.where(status <= Outcome.REBREAK, length, undefined * (1 + jnp.abs(length))), status, at_edge)


def _far_away(interface: Interface | Profile) -> tuple[Array, int, Array]:
    """Whether the interface is uniform in the end, from which site on, and its prestress there over its threshold."""
    if isinstance(interface, Interface):
        return jnp.asarray(interface.threshold_slope) == 0, 0, jnp.asarray(interface.prestress)
    sites = np.shape(interface.threshold)[0]
    last = jnp.asarray(sites - 1)
    return jnp.ones((), bool), sites, interface.prestress_at(last) / interface.threshold_at(last)


def edge_stress(modes: Modes, interface: Interface | Profile, drive: Array, front: DelayedFront) -> Array:
    """Stress on contact 0 behind the front, in σ_s; 0 while it is detached."""
    n, s = front.window.shape[0], front.position
    zero = jnp.zeros_like(drive)
    e = modes.echo_factor(zero)
    site = jnp.arange(n) + s - n
    y = jnp.stack([modes.profile(jnp.maximum(i, 0).astype(drive.dtype)) for i in site]) if n else jnp.zeros((0, 2))
    sources = front.edge + (y * jnp.where(site >= 0, front.window, 0)[:, None]).sum(0)
    layer = jnp.dot(modes.weight, sources) + jnp.dot(e, drive * modes.drive + modes.reflection @ sources)
    broke_at = interface.threshold_at(zero)  # contact 0 was pinned at u + φ as it broke, or when it repinned
    phi = interface.prestress_at(zero)
    if n:
        return jnp.where(s <= n, 0.0, layer + phi - _edge_pinning(modes, interface, drive, front))
    return layer + phi - broke_at


def _edge_pinning(modes: Modes, interface: Interface | Profile, drive: Array, front: DelayedFront) -> Array:
    """P of contact 0 where it had been detached for n sites: run the first n breaks again."""
    n = front.window.shape[0]
    start, drive = nucleate(modes, interface)
    for _ in range(n):
        start = advance(modes, interface, drive, start)
    return start.window[0]


@partial(jax.jit, static_argnames="count")
def front_stress(
    modes: Modes, interface: Interface | Profile, count: int
) -> tuple[Float[Array, " count"], Float[Array, " count"]]:
    """t(0) … t(count − 1) as the front comes to each contact, past the arrest too, and their thresholds."""
    start, drive = nucleate(modes, interface)

    def step(front: DelayedFront, _: None) -> tuple[DelayedFront, Array]:
        return advance(modes, interface, drive, front), front.stress

    stress = lax.scan(step, start, length=count)[1]
    return stress, interface.threshold_at(jnp.arange(count, dtype=stress.dtype))


@partial(jax.jit, static_argnames="count")
def pinning(modes: Modes, interface: Interface | Profile, count: int, position: Array) -> Float[Array, " count"]:
    """u_b of the first `count` sites when contacts before `position` have broken; detached ones follow the layer."""
    start, drive = nucleate(modes, interface)
    n = interface.repin_delay
    site = jnp.arange(count)

    def step(carry: tuple[DelayedFront, Array], _: None) -> tuple[tuple[DelayedFront, Array], None]:
        front, held = carry
        going = front.position < position
        joined = jnp.append(front.window, front.stress)
        held = jnp.where((site == front.position - n) & going, joined[0], held)
        after = advance(modes, interface, drive, front)
        front = type(front)(*(jnp.where(going, a, b) for a, b in zip(after, front, strict=True)))
        return (front, held), None

    (front, held), _ = lax.scan(step, (start, jnp.zeros(count, modes.load.dtype)), length=count)
    for a in range(n):
        held = jnp.where(site == front.position - n + a, front.window[a], held)
    return held
