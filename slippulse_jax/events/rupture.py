"""One rupture of any chain, under the hard or a smooth rule.

Under the hard rule the most overloaded contact breaks and repins, again and again, until none is overloaded
(`slippulse_jax.events.event`). Under a smooth rule the front sweeps once from left to right. The stress released behind it
reaches the next site as two displacements, u_t and u, carried from site to site by the 2×2 propagators of
`slippulse_jax.bodies.response`.

Notes
-----
Accuracy. A break only multiplies and adds positive numbers, so it passes on the relative error of the stresses and adds its
own. With ε the relative error of the response (a few units u in the last place per site over the decay length) and positive
stresses, |δt_i| ≤ n (ε + 8u) t_i for every contact after n breaks. The errors observed are far smaller, because contacts that
repin lose most of theirs. The final fields are solved afresh, and `Rupture.drift` is the difference.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slippulse_jax.base.domains import check_kind, check_whole
from slippulse_jax.base.outcomes import first_of, length_or_reason
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.chain import Chain, Springs, State, check_linear, eliminate
from slippulse_jax.bodies.equilibrium import Equilibrium, all_numbers, equilibrium, in_balance, or_harmless
from slippulse_jax.bodies.response import Response, propagators, with_response
from slippulse_jax.bulk.derivatives import without_derivative
from slippulse_jax.events.event import BREAKS_PER_SITE, empty_log, event, first_to_break, most
from slippulse_jax.events.first import ROUNDING, alike
from slippulse_jax.rules import BreakRule, check_rule

CLOSEST = -(2**31)
"""For a trigger: the contact closest to its threshold, where only rounding keeps it below."""


class Rupture(NamedTuple):
    """Record of one rupture.

    Displacements are in u_s, stresses in σ_s, energy in K u_s². The status is an `Outcome`: ARRESTED, NOTHING_BROKE,
    RAN_THROUGH (in a semi-infinite chain more sites must then be resolved), LIMIT, SINGULAR, NOT_CONVERGED or INVALID.
    """

    state: State  # after the rupture
    before: Equilibrium
    after: Equilibrium
    order: Int[Array, " L"]  # sites in order of breaking, −1 where none
    released: Float[Array, " L"]  # the stress each break released
    breaks: Int[Array, ""]
    broken: Float[Array, " N"]  # how often each contact broke; under a smooth rule, the fraction of it that broke
    slip: Float[Array, " N"]  # how far each contact's pinning point moved
    stress_drop: Float[Array, " N"]
    energy: Float[Array, ""]  # potential energy released
    extent: Int[Array, ""]  # sites from the left edge to the rightmost broken contact, which is among them
    length: Float[Array, ""]  # ℓ, in λc from the left edge
    drift: Float[Array, ""]  # largest error of a stress, accumulated over the breaks, in σ_s
    status: Int[Array, ""]

    @property
    def rebreaks(self) -> Array:
        """Whether a contact broke more than once: `REBREAK` of a first precursor."""
        return (self.broken > 1).any(-1)


def rupture(
    chain: Chain,
    state: State | None = None,
    *,
    rule: BreakRule | None = None,
    trigger: int | Int[Array, ""] | None = None,
    max_breaks: int | None = None,
    repin_delay: int = 0,
) -> Rupture:
    """Follow one rupture at a fixed load.

    The most overloaded contact (largest t_i − θ_i; the leftmost of equals) breaks and repins with what it keeps, nothing in the
    paper, and the stresses adjust. This is repeated until no contact is at or above its threshold. Contacts may break many
    times.

    Parameters
    ----------
    chain : Chain
        With linear contacts.
    state : State, optional
        By default that of the relaxed chain under the load that brings a first contact to its threshold (`nucleate`), which
        then breaks.
    rule : BreakRule, optional
        `SmoothBreak`, or one of your own, is the differentiable surrogate: one sweep from left to right.
    trigger : int, optional
        Site that breaks first, as returned by `nucleate`, even if rounding leaves it just below its threshold; −1 for none. By
        default, where no contact is at its threshold, one that only rounding keeps below it; under a smooth rule none. The
        status is INVALID if that contact does not exist, is detached, or lies below its threshold by more than rounding.
    max_breaks : int, optional
        Limit on the number of breaks, and length of their record; 50 N by default.
    repin_delay : int
        Number n of breaks for which a broken contact stays detached: it repins, with what it kept, when the nth contact after
        it breaks, or when the rupture ends. For a front that breaks one contact after another this is a delay in sites, as
        of a pulse n sites wide.

    Returns
    -------
    Rupture
        It carries a status (`Outcome`) instead of raising an exception.

    Raises
    ------
    TypeError
        If the hard rupture is differentiated; the message names the surrogate.
    ValueError
        If the chain has nonlinear contacts, is a batch, or does not match the state; if `trigger` is no site of it.

    Notes
    -----
    Composes with ``jit`` and ``vmap``; each lane's result is the same, bit for bit, whatever the batch. The length extends
    that of a first precursor to any event (`slippulse_jax.events.event.Event.length`): it interpolates between the overloads of
    the rightmost contacts as they first broke and that ahead of them; on a straight line, unless all contacts are alike, repin
    at once, none breaks twice, and none broke before.
    """
    check_kind("chain", chain, Chain)
    check_rule(rule, one=True)
    if state is None:
        state, nucleus = nucleate(chain)
        trigger = nucleus if trigger is None else trigger
    _check(chain, state)
    check_whole("repin_delay", repin_delay, 0)
    if max_breaks is not None:
        check_whole("max_breaks", max_breaks, 1)
    sites = range(-1, chain.sites)
    if not isinstance(trigger, Tracer | None) and (np.ndim(trigger) or np.asarray(trigger).item() not in sites):
        raise ValueError(f"trigger = {trigger!r}: must be one of the sites 0 … {chain.sites - 1}, or −1 for none")
    none_given = CLOSEST if rule is None else -1
    first = trigger.astype(jnp.int32) if isinstance(trigger, Tracer) else np.int32(none_given if trigger is None else trigger)
    if rule is not None:
        if repin_delay:
            raise ValueError(f"repin_delay = {repin_delay}: contacts of a smooth rule repin at once; use rule=None")
        return smooth_rupture(chain, state, rule, first)
    max_breaks = BREAKS_PER_SITE * chain.sites if max_breaks is None else max_breaks
    with jax.debug_infs(False):  # the length of an event that runs through is inf
        return _undifferentiated((max_breaks, repin_delay), chain, state, first)


def nucleate(chain: Chain, state: State | None = None) -> tuple[State, Int[Array, ""]]:
    """Load a chain until a contact reaches its threshold.

    Parameters
    ----------
    chain : Chain
        With linear contacts.
    state : State, optional
        The relaxed chain without load by default.

    Returns
    -------
    state : State
        The same pinning points under the smallest load, not below the given one, that brings a contact to its threshold;
        the load is inf if none does. Differentiable.
    site : int array
        That contact, to be passed on as ``rupture(..., trigger=site)``, since rounding may leave it just below its
        threshold; −1 if a contact was already at or above its threshold, or if none can be loaded.
    """
    check_kind("chain", chain, Chain)
    state = chain.relaxed() if state is None else state
    _check(chain, state)
    return _nucleate(chain, state)


@jax.jit
def _nucleate(chain: Chain, state: State) -> tuple[State, Int[Array, ""]]:
    load = jnp.asarray(state.load, chain.contact.dtype)
    now, push = jax.jvp(lambda load: equilibrium(chain, State(state.pinning, load)).stress, (load,), (jnp.ones_like(load),))
    threshold = jnp.where(chain.contact > 0, chain.threshold, jnp.inf)
    site, rise = first_to_break(push[None], threshold, now[None])
    rise = jnp.where((now >= threshold).any(), 0, rise)
    return State(state.pinning, load + rise), jnp.where((rise == 0) | jnp.isinf(rise), -1, site)


def _check(chain: Chain, state: State) -> None:
    check_kind("state", state, State)
    check_linear(chain, "a rupture")
    if chain.contact.ndim != 1:
        raise ValueError(f"the chain is a batch, with contacts of shape {chain.contact.shape}: use jax.vmap")
    if jnp.shape(state.pinning) != (chain.sites,):
        raise ValueError(f"state.pinning has shape {jnp.shape(state.pinning)}: must be ({chain.sites},) for this chain")


def _can_break(chain: Chain, stress: Array, trigger: Array) -> Array:
    """Whether the trigger is none, or attached and at threshold within rounding."""
    site = jnp.clip(trigger, 0, chain.sites - 1)
    rounding = jnp.finfo(stress.dtype).eps ** 0.25 * jnp.maximum(chain.threshold[site], jnp.abs(stress).max())
    reached = (chain.contact[site] > 0) & (stress[site] >= chain.threshold[site] - rounding)
    return (trigger == -1) | (trigger == site) & reached


def _or_closest(chain: Chain, stress: Array, trigger: Array) -> Array:
    """Replace `CLOSEST` by the contact it means, −1 where there is none."""
    overload = jnp.where(chain.contact > 0, stress - chain.threshold, -jnp.inf)
    site, most_overloaded = most(overload)
    rounding = ROUNDING * jnp.finfo(stress.dtype).eps * jnp.maximum(chain.threshold[site], jnp.abs(stress).max())
    closest = jnp.where((most_overloaded < 0) & (most_overloaded >= -rounding), site, -1)
    return jnp.where(trigger == CLOSEST, closest, trigger)


Broken = tuple[dict[Outcome, Array], dict[str, Any]]
"""How a rupture may end beside what the equilibria show; and the fields of its record that they do not give, perhaps with the
`stress` on every contact as it was followed."""


def _between_equilibria(
    chain: Chain,
    state: State,
    trigger: Array,
    beyond: Springs | None,
    breaking: Callable[[Chain, Springs, Array, Array, Array], Broken],
) -> Rupture:
    """Record of the rupture of one chain between two equilibria.

    ``breaking(chain, beyond, stress, trigger, good)`` breaks contacts, from their stress on; where not `good` its result has no
    meaning. `beyond` is the elimination from the right end of the chain, where it is known.
    """
    valid = all_numbers(chain, state)
    chain, state, beyond = or_harmless(valid, (chain, state, beyond))
    beyond = eliminate(chain, chain.contact) if beyond is None else beyond
    before = in_balance(valid, chain, state, beyond)
    trigger = _or_closest(chain, before.stress, trigger)
    meant = _can_break(chain, before.stress, trigger)
    endings, found = breaking(chain, beyond, before.stress, trigger, (before.status == Outcome.SOLVED) & meant)
    end, finite = State(state.pinning + found["slip"], state.load), jnp.isfinite(found["slip"]).all()
    after = in_balance(finite, chain, or_harmless(finite, end), beyond)
    usual = {
        Outcome.INVALID: (before.status == Outcome.INVALID) | (after.status == Outcome.INVALID) | ~meant,
        Outcome.SINGULAR: before.status == Outcome.SINGULAR,
        Outcome.NOT_CONVERGED: before.status != Outcome.SOLVED,
    }
    status = first_of(usual | endings)
    found["length"] = length_or_reason(status, found["length"])
    # all is linear, so each slip acts against the mean of the stress before and after
    energy = chain.stiffness * (found["slip"] * (before.stress + after.stress)).sum() / 2
    drift = jnp.abs(found.pop("stress", after.stress) - after.stress).max()
    drop = before.stress - after.stress
    return Rupture(end, before, after, stress_drop=drop, energy=energy, drift=drift, status=status, **found)


# --- the hard rule ---


def one_rupture(
    limits: tuple[int, int], beyond: Springs, response: Response, chain: Chain, state: State, trigger: Array
) -> Rupture:
    """Follow the `rupture` of one chain.

    `limits` are the largest number of breaks, and the delay; `beyond` is the elimination of the chain from its right end.
    """
    max_breaks, delay = limits

    def breaking(chain: Chain, _: Springs, stress: Array, trigger: Array, good: Array) -> Broken:
        # a detached contact cannot break
        threshold = jnp.where(good & (chain.contact > 0), chain.threshold, jnp.inf)
        found = event(
            response,
            jnp.where(good, stress, 0)[None],
            threshold,
            limit=max_breaks,
            residual_strength=chain.residual_strength,
            trigger=jnp.where(good, trigger, -1),
            delay=delay,
            log=empty_log(max_breaks, threshold.dtype),
        )
        excess, last = found.stress - threshold, chain.sites - 1
        return {
            Outcome.NOTHING_BROKE: found.breaks == 0,
            Outcome.LIMIT: (excess >= 0).any(),
            Outcome.RAN_THROUGH: found.rightmost == last,
        }, {
            "order": found.order[:-1],
            "released": found.each[:-1],
            "breaks": found.breaks,
            "broken": found.times.astype(stress.dtype),
            "slip": found.released * response.soft,
            "extent": found.rightmost + 1,
            "length": found.length(excess, last, alike(chain, state.pinning) & (delay == 0)),
            "stress": found.stress,
        }

    return _between_equilibria(chain, state, trigger, beyond, breaking)


_undifferentiated = without_derivative(
    lambda limits, *given: with_response(partial(one_rupture, limits), *given),
    "the hard cascade cannot be differentiated: which contact breaks next is a comparison, whose derivative would "
    "silently be zero. Use rupture(..., rule=SmoothBreak(width)), which can be; for the length of a first precursor use "
    "precursor_length, which has an exact derivative.",
    static_argnums=(0,),
)


# --- a smooth rule ---


@jax.jit
def smooth_rupture(chain: Chain, state: State, rule: BreakRule, trigger: Array) -> Rupture:
    """Follow one rupture under a smooth rule; differentiable in every field.

    The front sweeps from the left edge to the right. It reaches each contact once, loaded by all the stress that the
    contacts before it released, and the contact releases p(t) t, or that share of what it can lose. The trigger breaks
    completely. The order of breaks is fixed and no contact breaks twice; this makes the sweep smooth, and is its approximation.
    As w → 0 it becomes the hard rupture, where that is a single front from left to right.

    `order` lists the sites in the order of the sweep, `released` the stress each released, `broken` the fraction of each
    contact that broke, and `length` is ℓ_w, from the left edge to where p has faded. `breaks` and `extent` count the contacts
    of which more than half broke; RAN_THROUGH if the last one is among them.
    """

    def breaking(chain: Chain, beyond: Springs, stress: Array, trigger: Array, _: Array) -> Broken:
        (right, source, _, _), kept = propagators(chain, beyond), chain.residual_strength * chain.threshold
        theta = chain.threshold - kept  # of what contacts can lose, as the stress in what follows

        def step(arriving: Array, here: tuple) -> tuple[Array, tuple]:
            P, source, stress, threshold, contact, site = here
            t = stress + contact * arriving[1]
            p = jnp.where(contact > 0, jnp.where(site == trigger, 1, rule.broken(t, threshold)), 0)
            return (P * (arriving + source * p * t)[None, :]).sum(-1), (p, t)

        sites = jnp.arange(chain.sites, dtype=jnp.int32)
        in_turn = (right, source, stress - kept, theta, chain.contact, sites)
        _, (p, t) = lax.scan(step, jnp.zeros(2, theta.dtype), in_turn)
        first, most = jnp.maximum(trigger, 0), p > 0.5
        steps = jax.vmap(rule.overloaded_length)(t[:-1], t[1:], theta[:-1], theta[1:])
        # the trigger breaks completely: to its neighbour the step is that neighbour's part
        steps = jnp.where(sites[:-1] >= first, jnp.where(sites[:-1] == trigger, p[1:], steps), 0)
        return {Outcome.NOTHING_BROKE: ~most.any(), Outcome.RAN_THROUGH: most[-1]}, {
            "order": sites,
            "released": p * t,
            "breaks": most.sum(),
            "broken": p,
            "slip": p * t * chain.stiffness / jnp.where(chain.contact > 0, chain.contact, jnp.inf),
            "extent": jnp.where(most, sites + 1, 0).max(),
            "length": first.astype(steps.dtype) + steps.sum(),
        }

    return _between_equilibria(chain, state, trigger, None, breaking)
