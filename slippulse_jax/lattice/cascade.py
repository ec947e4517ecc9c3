"""One rupture of any interface: the most overloaded contact breaks and repins, again and again, until none is overloaded.

Every break raises the stress everywhere else, by a known amount (`slippulse_jax.lattice.response`). The loop keeps, for each
block of about √N contacts, a bound on its largest overload and what has arrived at its edges since it was last looked at. It
opens the block with the largest bound, reads off the stresses there, and breaks a contact only when no other block can hold
a more overloaded one. So the order of breaks is exactly that of looking at all contacts after every break, at O(√N) a break.

Accuracy. A break multiplies and adds positive numbers, so it can only pass on the relative error of the stresses and add
its own: with ε the relative error of the response (a few units u in the last place per site over the decay length) and
positive stresses, n breaks leave |δt_i| ≤ n (ε + 8u) t_i for every contact. Contacts that repin forget most of it, and
what is seen is far less; the final fields are solved afresh, and `Rupture.drift` is the difference found.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float, Int

from slippulse_jax.lattice.chain import Chain, State
from slippulse_jax.lattice.equilibrium import Equilibrium, EquilibriumStatus, equilibrium, or_harmless
from slippulse_jax.lattice.response import Response, arriving, into_blocks, response
from slippulse_jax.rules import BreakRule, HardBreak, check_rule
from slippulse_jax.status import Status

BREAKS_PER_SITE = 20
"""Breaks per site after which a rupture is given up, unless the caller says otherwise."""


class RuptureStatus(Status):
    """How a rupture ended."""

    ARRESTED = 0, "arrested: no contact is at its threshold any more"
    NOTHING_BROKE = 1, "nothing broke: no contact was at its threshold"
    RAN_THROUGH = (
        2,
        (
            "ran through: the last site of the chain broke, so the rupture has no length (inf); of a semi-infinite chain "
            "more sites must be resolved"
        ),
    )
    LIMIT = 3, "given up: contacts were still over threshold after max_breaks breaks (length NaN)"
    SINGULAR = 4, "no equilibrium: a part of the chain is held by nothing (length NaN)"
    INVALID = 5, "no such chain or state: a value is not a number, or outside its domain (length NaN)"


class Rupture(NamedTuple):
    """What one rupture did; displacements in u_s, stresses in σ_s, energy in K u_s²."""

    state: State  # after the rupture
    before: Equilibrium
    after: Equilibrium
    order: Int[Array, " L"]  # sites in order of breaking, −1 where none
    released: Float[Array, " L"]  # the stress each break gave up
    breaks: Int[Array, ""]
    broken: Float[Array, " N"]  # how often each contact broke; with a smooth rule, how much of it
    slip: Float[Array, " N"]  # how far each contact's pinning point moved
    stress_drop: Float[Array, " N"]
    energy: Float[Array, ""]  # potential energy given up
    extent: Int[Array, ""]  # sites from the left edge to the rightmost broken contact, which is among them
    length: Float[Array, ""]  # ℓ, in λc from the left edge
    drift: Float[Array, ""]  # largest error of a stress accumulated over the breaks, in σ_s
    status: Int[Array, ""]


class Progress(NamedTuple):
    """A rupture under way; B blocks of M sites, room for L breaks."""

    stress: Float[Array, "B M"]  # as of when the block was last opened
    inbox: Float[Array, "B 4"]  # arrived at the block's edges since
    worst: Float[Array, " B"]  # largest overload of the block when it was last opened
    bound: Float[Array, " B"]  # no contact of the block can be more overloaded than this
    slip: Float[Array, "B M"]  # stress given up so far, in σ_s
    order: Int[Array, " L"]  # sites in order of breaking, −1 where none
    released: Float[Array, " L"]  # stress each break gave up
    energy: Float[Array, ""]  # released, in K u_s²
    breaks: Int[Array, ""]
    furthest: Int[Array, ""]  # rightmost site broken so far
    overload: Float[Array, ""]  # its overload when it first broke


def advance(resp: Response, threshold: Array, contact: Array, now: Progress, trigger: Array) -> Progress:
    """Open the block with the largest bound; break its most overloaded contact if none elsewhere can be more so."""
    size = now.stress.shape[1]
    slack = 1 + 64 * jnp.finfo(now.stress.dtype).eps  # room for rounding in the bound
    start = (now.breaks == 0) & (trigger >= 0)
    block = jnp.where(start, trigger // size, jnp.argmax(now.bound))
    stress = now.stress[block] + (now.inbox[block][:, None] * resp.read[block]).sum(0)
    over = stress - threshold[block]
    site = jnp.where(start, trigger % size, jnp.argmax(over))
    bound = now.bound.at[block].set(over[site])
    fires = start | ((jnp.argmax(bound) == block) & (over[site] >= 0))

    t = jnp.where(fires, stress[site], 0)
    here = (jnp.arange(size) == site) & fires
    after = jnp.where(here, 0, stress) + resp.near[block, site] * t
    inbox = now.inbox.at[block].set(0) + arriving(resp, block, site) * t
    worst = now.worst.at[block].set((after - threshold[block]).max())
    index = block * size + site
    drop = jnp.where(fires, now.breaks, now.order.shape[0])  # beyond the end: dropped
    further = fires & (index > now.furthest)
    k = contact[block, site]
    return Progress(
        stress=now.stress.at[block].set(after),
        inbox=inbox,
        worst=worst,
        bound=worst + (inbox * resp.reach).sum(-1) * slack,
        slip=now.slip.at[block, site].add(t),
        order=now.order.at[drop].set(index.astype(jnp.int32), mode="drop"),
        released=now.released.at[drop].set(t, mode="drop"),
        energy=now.energy + t * (t + after[site]) / jnp.where(k > 0, 2 * k, jnp.inf),
        breaks=now.breaks + fires,
        furthest=jnp.where(further, index, now.furthest).astype(jnp.int32),
        overload=jnp.where(further, over[site], now.overload),
    )


def run(max_breaks: int, resp: Response, stress: Array, threshold: Array, contact: Array, trigger: Array) -> Progress:
    """Break contacts until none is over threshold, or `max_breaks` have broken; `trigger` first unless negative."""
    worst = (stress - threshold).max(-1)
    none, zero = jnp.zeros((), stress.dtype), jnp.zeros((), jnp.int32)
    start = Progress(
        stress=stress,
        inbox=jnp.zeros_like(resp.reach),
        worst=worst,
        bound=worst,
        slip=jnp.zeros_like(stress),
        order=jnp.full(max_breaks, -1, jnp.int32),
        released=jnp.zeros(max_breaks, stress.dtype),
        energy=none,
        breaks=zero,
        furthest=zero - 1,
        overload=none,
    )

    def going(now: Progress) -> Array:
        overloaded = (now.bound.max() >= 0) | ((now.breaks == 0) & (trigger >= 0))
        return overloaded & (now.breaks < max_breaks)

    end = lax.while_loop(going, lambda now: advance(resp, threshold, contact, now, trigger), start)
    return end._replace(stress=end.stress + (end.inbox[:, :, None] * resp.read).sum(1))


def _lane_by_lane(f: Callable, *given: Any) -> Any:
    """f(*given), under ``jax.vmap`` for each lane in turn, as if alone: so the bits cannot depend on the batch.

    On a CPU, where a lane that is done costs nothing this way, and lanes in step cost more. An accelerator runs them in step.
    """
    return lax.platform_dependent(*given, cpu=_one_by_one(f), default=f)


def _one_by_one(f: Callable) -> Callable:
    one = custom_vmap(f)

    @one.def_vmap
    def _rule(axis_size, in_batched, *args):  # pyright: ignore[reportUnusedFunction]
        leaves, tree = jax.tree.flatten(args)
        batched = jax.tree.leaves(in_batched)
        # a loop over one lane would be compiled as no loop, and might round otherwise: never fewer than two
        twice = [jnp.concatenate([x, x]) if b and axis_size == 1 else x for x, b in zip(leaves, batched, strict=True)]

        def lane(mapped: list) -> Any:
            mapped = list(mapped)
            return one(*jax.tree.unflatten(tree, [mapped.pop(0) if b else x for x, b in zip(twice, batched, strict=True)]))

        out = lax.map(lane, [x for x, b in zip(twice, batched, strict=True) if b])
        return jax.tree.map(lambda x: x[:axis_size], out), jax.tree.map(lambda _: True, out)

    return one


def _hard_rupture(max_breaks: int, chain: Chain, state: State, trigger: Array) -> Rupture:
    # where all lanes share one chain its response is worked out once
    resp = _lane_by_lane(response, chain)
    return _lane_by_lane(partial(_one_rupture, max_breaks), resp, chain, state, trigger)


def _one_rupture(max_breaks: int, resp: Response, chain: Chain, state: State, trigger: Array) -> Rupture:
    before = equilibrium(chain, state)
    good = before.status == EquilibriumStatus.SOLVED
    safe, state = or_harmless(before.status != EquilibriumStatus.INVALID, chain, state)
    size, n = resp.near.shape[1], chain.sites
    threshold = jnp.where(safe.contact > 0, safe.threshold, jnp.inf)  # a detached contact has nothing to break
    done = run(
        max_breaks,
        resp,
        into_blocks(jnp.where(good, before.stress, 0), size),
        into_blocks(jnp.where(good, threshold, jnp.inf), size, jnp.inf),
        into_blocks(safe.contact, size),
        jnp.where(good, trigger, -1),
    )
    stress = done.stress.reshape(-1)[:n]
    slip = done.slip.reshape(-1)[:n] * safe.stiffness / jnp.where(safe.contact > 0, safe.contact, jnp.inf)
    after_state = State(state.pinning + slip, state.load)
    after = equilibrium(safe, after_state)
    ahead = jnp.minimum(done.furthest + 1, n - 1)
    short_by = stress[ahead] - safe.threshold[ahead]
    endings = {
        RuptureStatus.INVALID: before.status == EquilibriumStatus.INVALID,
        RuptureStatus.SINGULAR: ~good,
        RuptureStatus.NOTHING_BROKE: done.breaks == 0,
        RuptureStatus.LIMIT: done.bound.max() >= 0,
        RuptureStatus.RAN_THROUGH: done.furthest == n - 1,
    }
    status = jnp.select(list(endings.values()), list(endings), RuptureStatus.ARRESTED).astype(jnp.int32)
    length = done.furthest + done.overload / (done.overload - jnp.minimum(short_by, 0))
    return Rupture(
        state=after_state,
        before=before,
        after=after,
        order=done.order,
        released=done.released,
        breaks=done.breaks,
        broken=jnp.zeros_like(slip).at[done.order].add(done.order >= 0, mode="drop"),
        slip=slip,
        stress_drop=before.stress - after.stress,
        energy=done.energy * safe.stiffness**2,
        extent=done.furthest + 1,
        length=length_or_reason(status, length),
        drift=jnp.abs(stress - after.stress).max(),
        status=status,
    )


_undifferentiated = jax.custom_jvp(jax.jit(_hard_rupture, static_argnums=0), nondiff_argnums=(0,))


@_undifferentiated.defjvp
def _refuse(max_breaks, primals, tangents):
    raise TypeError(
        "the hard cascade cannot be differentiated: which contact breaks next is a comparison, whose derivative would "
        "silently be zero. Use rupture(..., rule=SmoothBreak(width)), which can be; for the length of a first precursor, "
        "precursor_length, which has an exact derivative."
    )


def rupture(
    chain: Chain,
    state: State,
    *,
    rule: BreakRule = HardBreak(),  # noqa: B008 - a constant without fields
    trigger: int | Int[Array, ""] = -1,
    max_breaks: int | None = None,
) -> Rupture:
    """One rupture at a fixed load.

    The most overloaded contact (largest t_i − θ_i; the leftmost of equals) breaks and repins with zero stretch, stresses
    adjust, and so on until no contact is at or above its threshold. Contacts may break many times.

    Parameters
    ----------
    chain : Chain
        With linear contacts.
    state : State
    rule : HardBreak or SmoothBreak
        With ``SmoothBreak(width)``, the differentiable stand-in of `slippulse_jax.lattice.surrogate`.
    trigger : int
        Site that breaks first, even if rounding leaves it a digit below its threshold (see `nucleate`); −1 for none.
    max_breaks : int, optional
        Breaks after which the rupture is given up, and room for their record; 20 N by default.

    Returns
    -------
    Rupture
        With a status (`RuptureStatus`) instead of an exception.

    Raises
    ------
    TypeError
        If the hard rupture is differentiated; the message names the surrogate.
    ValueError
        If the chain has nonlinear contacts, is a batch, or does not match the state.

    Notes
    -----
    Composes with ``jit`` and ``vmap``; each lane's result is the same, bit for bit, whatever the batch. The length is that
    of a first precursor (`slippulse_jax.lattice.front`) for any thresholds: from the overload of the rightmost broken contact
    when it first broke, and the one its neighbour is left with.
    """
    check_rule(rule)
    _check(chain, state)
    if not isinstance(rule, HardBreak):
        from slippulse_jax.lattice.surrogate import smooth_rupture

        return smooth_rupture(chain, state, rule, trigger)
    max_breaks = BREAKS_PER_SITE * chain.sites if max_breaks is None else max_breaks
    return _undifferentiated(max_breaks, chain, state, jnp.asarray(trigger, jnp.int32))


def length_or_reason(status: Array, length: Array) -> Array:
    """ℓ, or 0, inf or NaN as the status has it; where there is no length the derivative is NaN, never a silent zero."""
    arrested = status == RuptureStatus.ARRESTED
    reasons = [status == RuptureStatus.NOTHING_BROKE, status == RuptureStatus.RAN_THROUGH]
    return jnp.where(arrested, length * jnp.where(arrested, 1, jnp.nan), jnp.select(reasons, [0.0, jnp.inf], jnp.nan))


def nucleate(chain: Chain, state: State) -> tuple[State, Int[Array, ""]]:
    """Load a chain until a contact reaches its threshold.

    Parameters
    ----------
    chain : Chain
        With linear contacts.
    state : State

    Returns
    -------
    state : State
        The same pinning points at the smallest load, no less than the given one, at which a contact is at its threshold;
        the load is inf if none ever is. Differentiable.
    site : int array
        That contact, to be passed on as ``rupture(..., trigger=site)``: rounding may leave it a digit below threshold. −1
        if one was over threshold already.
    """
    _check(chain, state)
    return _nucleate(chain, state)


@jax.jit
def _nucleate(chain: Chain, state: State) -> tuple[State, Int[Array, ""]]:
    now = equilibrium(chain, state).stress
    per_load = (equilibrium(chain, State(state.pinning, state.load + 1)).stress - now) * (chain.contact > 0)
    pulled = per_load > 0
    missing = jnp.where(pulled, (chain.threshold - now) / jnp.where(pulled, per_load, 1), jnp.inf)
    overloaded = ((now >= chain.threshold) & (chain.contact > 0)).any()
    site = jnp.argmin(missing).astype(jnp.int32)
    return State(state.pinning, state.load + jnp.where(overloaded, 0, missing[site])), jnp.where(overloaded, -1, site)


def _check(chain: Chain, state: State) -> None:
    if chain.law is not None:
        raise ValueError("a rupture needs linear contacts: this chain has a force law")
    if chain.contact.ndim != 1:
        raise ValueError(f"the chain is a batch, with contacts of shape {chain.contact.shape}: use jax.vmap")
    if jnp.shape(state.pinning) != (chain.sites,):
        raise ValueError(f"state.pinning has shape {jnp.shape(state.pinning)}: must be ({chain.sites},) for this chain")
