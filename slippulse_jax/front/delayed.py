r"""The first precursor with a repinning delay of n sites.

A contact that carries the prestress φ and is pinned at p carries t = u − p + φ, in σ_s; when it breaks and repins, p grows by
t. A detached contact carries t = 0, as one pinned at p = u + φ does. So with a delay of n sites the n contacts behind the front
are pinning points that follow the layer, p = u + φ, and those before them are at rest: a front of
`slippulse_jax.front.front` that has passed only those. A break costs the solution of n equations for the others.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.bodies.modes import Modes
from slippulse_jax.bulk.compiler import solve_without_pivots
from slippulse_jax.front.front import Front, advance, contact_at, echo_at
from slippulse_jax.front.front import nucleate as at_rest
from slippulse_jax.interface import Interface, Profile


class DelayedFront(NamedTuple):
    """State of a front that has broken contacts 0 … position − 1."""

    position: Int[Array, ""]
    rest: Front  # that has passed the contacts at rest
    window: Float[Array, " n"]  # p of the detached contacts, the one next to the front last; 0 left of the edge
    ahead: Float[Array, ""]  # stress on the contact ahead
    first: Float[Array, ""]  # p of contact 0, once at rest


def nucleate(modes: Modes, contacts: Interface | Profile) -> DelayedFront:
    """The front before contact 0 breaks, loaded to its threshold."""
    threshold, prestress = contact_at(modes, contacts, 0)
    rest = at_rest(modes, threshold - prestress)
    return DelayedFront(rest.position, rest, jnp.zeros(contacts.repin_delay, threshold.dtype), threshold, 0 * threshold)


def release(modes: Modes, contacts: Interface | Profile, front: DelayedFront) -> DelayedFront:
    """Break the contact ahead as a whole; the one that has been detached longest repins first, where it is."""
    n, s, settled = contacts.repin_delay, front.position, front.window[0]
    passed = advance(modes, front.rest, settled, echo_at(modes, s - n))
    rest = jax.tree.map(lambda new, old: jnp.where(s >= n, new, old), passed, front.rest)
    window, ahead = _window(modes, contacts, rest, s + 1)
    return DelayedFront(s + 1, rest, window, ahead, jnp.where(s == n, settled, front.first))


def passage(
    modes: Modes, contacts: Interface | Profile
) -> tuple[DelayedFront, Callable[[DelayedFront], tuple[Array, Array]], Callable[..., DelayedFront]]:
    """How a front passes over contacts that repin after a delay: `start`, `ahead` and `release` for `front.follow`."""

    def ahead(front: DelayedFront) -> tuple[Array, Array]:
        return front.ahead, contact_at(modes, contacts, front.position)[0]

    start = release(modes, contacts, nucleate(modes, contacts))
    return start, ahead, lambda front, *_: release(modes, contacts, front)


def edge(modes: Modes, contacts: Interface | Profile, front: DelayedFront) -> Array:
    """Stress on contact 0; 0 while it is detached."""
    n = contacts.repin_delay
    site = front.position - n + jnp.arange(n, dtype=front.position.dtype)
    y = jnp.where((site >= 0)[:, None], _from(modes, front.rest, site), 0)
    layer = front.rest.edge[0] + (y * front.rest.reach[None] * front.window[:, None]).sum()
    return jnp.where(front.position <= n, 0, contact_at(modes, contacts, 0)[0] - front.first + layer)


def _from(modes: Modes, rest: Front, site: Array) -> Float[Array, "sites modes"]:
    """e_m(i) r_m^{i − s} at sites from the position s of the front at rest on."""
    beyond = jnp.maximum(site - rest.position, 0).astype(modes.gap.dtype)
    decay = jnp.exp(beyond[:, None] * jnp.log1p(-modes.gap)[None])
    return decay if modes.echo is None else decay * jax.vmap(modes.echo_factor)(jnp.maximum(site, 0))


def _window(modes: Modes, contacts: Interface | Profile, rest: Front, s: Array) -> tuple[Array, Array]:
    """Pinning points of the detached contacts behind contact s, and the stress on it."""
    n = contacts.repin_delay
    offset = jnp.arange(n + 1, dtype=s.dtype)
    site = s - n + offset  # the last is the contact ahead
    inside = site >= 0
    y = _from(modes, rest, site)
    base = (y * rest.stress[None]).sum(1) + contact_at(modes, contacts, jnp.maximum(site, 0))[1]
    apart = jnp.abs(offset[:, None] - offset[None]).astype(y.dtype)
    endless = modes.weight[None, None] * jnp.exp(apart[..., None] * jnp.log1p(-modes.gap)[None, None])
    if modes.echo is not None:
        echo = jax.vmap(modes.echo_factor)(jnp.maximum(site, 0))
        endless = endless * echo[jnp.maximum(offset[:, None], offset[None])]
    edge = ((y[:, :, None] * rest.reflected[None]).sum(1)[:, None] * y[None]).sum(2)
    green = jnp.where(inside[:, None] & inside[None], endless.sum(2) + edge, 0)
    window = solve_without_pivots(jnp.eye(n, dtype=base.dtype) - green[:n, :n], jnp.where(inside, base, 0)[:n])
    return window, base[n] + (green[n, :n] * window).sum()


@partial(jax.jit, static_argnames="count")
def front_stress(modes: Modes, count: int, contacts: Interface | Profile) -> Float[Array, " count"]:
    """t(0) … t(count − 1): the stress each contact would carry had all before it broken, past the arrest too."""
    start = nucleate(modes, contacts)
    return lax.scan(lambda front, _: (release(modes, contacts, front), front.ahead), start, length=count)[1]


@partial(jax.jit, static_argnames="count")
def pinning(modes: Modes, contacts: Interface | Profile, count: int, position: Array) -> Float[Array, " count"]:
    """u_b of the first `count` sites when contacts before `position` have broken; detached ones follow the layer."""
    n, site = contacts.repin_delay, jnp.arange(count, dtype=jnp.int32)

    def step(carry: tuple[DelayedFront, Array], _: None) -> tuple[tuple[DelayedFront, Array], None]:
        front, held = carry
        going = front.position < position
        held = jnp.where((site == front.position - n) & going, front.window[0], held)
        after = release(modes, contacts, front)
        return (jax.tree.map(lambda a, b: jnp.where(going, a, b), after, front), held), None

    start = nucleate(modes, contacts), jnp.zeros(count, modes.load.dtype)
    (front, held), _ = lax.scan(step, start, length=count)
    for a in range(n):
        held = jnp.where(site == front.position - n + a, front.window[a], held)
    return held
