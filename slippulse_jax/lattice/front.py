r"""The first precursor by a recursion of fixed-size state.

It costs O(1) per break, over the modes of any waveguide.

Load the left edge until contact 0 carries its threshold θ_0. It breaks, repins at zero stretch and overloads contact 1, and so
on. With all contacts before s broken in turn, contact s carries, in σ_s and before it breaks,

    t(s) = φ_s + Σ_m e_m(s) Z_m,    Z_m = w_m S_m + r_m^s (A C_m + Σ_n R_mn T_n),    A = θ_0 − φ_0,

with the modes of `slippulse_jax.lattice.modes`, the prestress φ_s, and two sums over what the contacts behind gave up,
S_m = Σ_{j<s} r_m^{s−j} t(j) and T_n = Σ_{j<s} e_n(j) r_n^j t(j). Only the n numbers Z_m are carried: breaking contact s maps

    Z_m → r_m [Z_m + v_m t],    v_m = w_m + Σ_n Q_mn e_n(s),    Q_mn = r_m^s R_mn r_n^s → r_m r_n Q_mn.

The front goes on while t(s) ≥ θ_s; Λ = s0 λc, where s0 is the first s with t(s) < θ_s.

Run-away. Far from the edge every contact behind the front gave up the same stress t, and t = φ + t Σ_{j≥1} G_0j with
Σ_j G_0j = 1 over the endless lattice, so t → 2φ/(1 + G_00): it stays above a uniform threshold of 1 if and only if
φ ≥ φ_c = (1 + G_00)/2. Below φ_c (or with rising thresholds) every front stops. Above it the front never stops, unless it
stops on its way to that state: far from the edge t approaches its limit as ρ_2^s, and on a soft, short slider it does so from
below. So only for φ ≥ φ_c, uniform, the recursion is cut off where that approach is over to rounding; on a profile, as long
after its last site.

Notes
-----
`advance` and `stress_ahead` use only sums and products and the leading axis of the modes, two for the slider and n, partly
complex, for a block. So they also take the NumPy arrays of single numbers of the loop over lanes
(`slippulse_jax.lattice.lanes`). Q is carried, rather than r_m^s, because its tangent costs two products per number.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.block import Block
from slippulse_jax.domains import HEIGHT, POISSON, STIFFNESS, check_choice
from slippulse_jax.interface import Interface, Profile
from slippulse_jax.lattice.modes import Modes
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

DEFAULT_MAX_CONTACTS = 10_000_000
"""Breaks after which a front is given up: beyond any slider of H/λc up to several million."""

EventKind = Literal["domino", "full"]
"""Event whose length is meant: the first front, in which each contact breaks once; or the whole event."""

FRONT_OUTCOMES = tuple(outcome for outcome in Outcome if outcome <= Outcome.RUN_AWAY)
"""Possible outcomes of a front."""

APPROACH = 45.0
"""Decay lengths after which e^{−s/length} is nothing in float64."""

AnyArray = Array | np.ndarray
Contacts = Interface | Profile | None
"""Thresholds and prestress of the contacts; None for the paper's own, relaxed and uniform."""


def check_event(event: str) -> None:
    """Refuse an unknown kind of event."""
    check_choice("event", event, EventKind)


class LengthDerivatives(NamedTuple):
    """Lengths of a batch and their derivatives, NumPy float64 of the shape of the batch; in λc per unit of the parameter.

    The derivatives are NaN where the length is not finite, and 0 where no domino starts.
    """

    length: np.ndarray  # ℓ or ℓ*
    height: np.ndarray  # dℓ/d(H/λc)
    stiffness: np.ndarray  # dℓ/d(k/K)
    poisson: np.ndarray  # dℓ/dν
    prestress: np.ndarray | None = None  # dℓ/dφ, with an interface
    threshold_slope: np.ndarray | None = None  # dℓ/dε, with an interface
    rule: Any = None  # the break rule with the derivatives in the places of its numbers, with a smooth rule
    hessian: np.ndarray | None = None  # (..., n, n), second derivatives in the order of the fields above
    sites: np.ndarray | None = None  # dℓ/dN, of a finite chain
    machine: np.ndarray | None = None  # dℓ/d(M/K), with a machine


class Arrest(NamedTuple):
    """Where and how the front ended, or many fronts; of NumPy arrays where computed in bulk."""

    contacts_broken: Int[AnyArray, "..."]
    length: Float[AnyArray, "..."]  # ℓ, in λc
    status: Int[AnyArray, "..."]
    edge_stress: Float[AnyArray, "..."]  # stress on contact 0 behind the front, in σ_s


# --- one step ----------------------------------------------------------------------------------------------------------


class Waveguide(Protocol):
    """What a break depends on: the decay of each mode, and the response of an endless waveguide."""

    @property
    def gap(self) -> Any:
        """1 − r_m."""
        ...

    @property
    def weight(self) -> Any:
        """w_m."""
        ...


class Front(NamedTuple):
    """State of a front that has broken contacts 0 … position − 1; the leading axis of the first three runs over the modes."""

    stress: Any  # Z_m, in σ_s
    reflected: Any  # Q_mn
    reach: Any  # (w_n + Σ_m e_m(0) R_mn) r_n^s, what the next break adds to the stress on contact 0; None where not wanted
    position: Any  # s
    behind: Any  # excess over the threshold on contact s − 1 as it broke
    edge: Any  # stress on contact 0; None where not wanted


def stress_ahead(front: Front, echo: Any = None) -> Any:
    """Σ_m e_m(s) Z_m, with the leading axis kept; the prestress comes on top."""
    return (front.stress if echo is None else echo * front.stress).sum(0, keepdims=True).real


def advance(guide: Waveguide, front: Front, released: Any, echo: Any = None, start: Any = None) -> Front:
    """Break the contact ahead, which gives up the stress `released`.

    Multiplying by r_m is written x − (1 − r_m) x: r_m itself, rounded, would be a systematic error of s·10⁻¹⁶.

    Parameters
    ----------
    guide : Waveguide
    front : Front
    released : array, shape () or (1,)
        t(s), or a part of it.
    echo : array, optional
        e_m(s), of a finite waveguide.
    start : array, optional
        Z_m before contact 0 broke, where `front.stress` holds the change since then: soft interfaces change Z_m by as little
        as b, of which single precision would lose the digits.
    """
    gap, Q, reach, edge = guide.gap, front.reflected, front.reach, front.edge
    both = gap[:, None] + gap[None] - gap[:, None] * gap[None]  # 1 − r_m r_n
    stress = front.stress + (guide.weight + (Q if echo is None else Q * echo[None]).sum(1)) * released
    if reach is not None:
        edge = edge + (reach if echo is None else reach * echo).sum(0, keepdims=True).real * released
        reach = reach - gap * reach
    lost = gap * (stress if start is None else start + stress)
    return Front(stress - lost, Q - both * Q, reach, front.position + 1, front.behind, edge)


def straight_line(last: Any, behind: Any, ahead: Any) -> Any:
    """ℓ, where the excess over the threshold, linear between contacts `last` and last + 1, falls to zero.

    Parameters
    ----------
    last : array
        Index of the last contact that broke.
    behind, ahead : array
        Excess of the stress over the threshold on contacts last and last + 1.
    """
    return last + behind / (behind - ahead)


def first_of(endings: dict[Any, Any]) -> Int[Array, "..."]:
    """The first `Outcome` whose condition holds; `ARRESTED` if none does."""
    return jnp.select(jnp.broadcast_arrays(*endings.values()), list(endings), Outcome.ARRESTED).astype(jnp.int32)


def outcome(
    broken: Array, ahead: Array, edge: Array, *, valid: Any = True, through: Any = False, endless: Any = False
) -> Int[Array, "..."]:
    """`Outcome` of fronts from the contacts broken, the excess ahead, and the excess on contact 0 behind the front."""
    endings = {
        Outcome.INVALID: ~(valid & jnp.isfinite(ahead)),
        Outcome.RAN_THROUGH: through,
        Outcome.RUN_AWAY: (ahead >= 0) & endless,
        Outcome.LIMIT: ahead >= 0,
        Outcome.NO_DOMINO: broken == 1,
        Outcome.REBREAK: edge >= 0,
    }
    return first_of(endings)


def length_or_reason(status: Array, length: Array) -> Array:
    """`length` of a front that stopped; 0 where none started; else inf or NaN, with a derivative that is not finite either."""
    stopped = (status == Outcome.ARRESTED) | (status == Outcome.REBREAK)
    none = (status == Outcome.NO_DOMINO) | (status == Outcome.NOTHING_BROKE)
    infinite = (status == Outcome.RAN_THROUGH) | (status == Outcome.RUN_AWAY)
    # 0 where the length itself is taken too: reverse mode multiplies what is not taken by zero, and NaN stays NaN
    instead = jnp.where(stopped | none, 0, jnp.where(infinite, jnp.inf, jnp.nan))
    # where nothing is left to break, the straight line may have no end
    return jnp.where(stopped, length, instead * (1 + jnp.where(jnp.isnan(length), 0, jnp.abs(length))))


# --- one slider --------------------------------------------------------------------------------------------------------


class Passage(NamedTuple):
    """How a front passes over the contacts of one slider; its states have a `position` and a `behind`."""

    start: Any  # contact 0 has broken, at its threshold exactly
    advance: Callable[[Any], Any]  # break the contact ahead
    excess: Callable[[Any], Array]  # on the contact ahead over its threshold, in σ_s
    threshold: Callable[[Array], Array]  # of a contact
    edge: Callable[[Any], Array]  # stress on contact 0


def nucleate(modes: Modes, drive: Any = 1) -> Front:
    """The front before contact 0 breaks; `drive` is the stress by which it is loaded."""
    one = jnp.ones_like(modes.load)
    reach = modes.weight + (modes.echo_factor(0 * one)[:, None] * modes.reflection).sum(0)
    return Front(drive * modes.drive, modes.reflection, reach, jnp.int32(0), 0 * one, 0 * reach[:1].real)


def echo_at(modes: Modes, site: Array) -> Array | None:
    """e_m of a finite chain."""
    return None if modes.echo is None else modes.echo_factor(site)


def contact_at(modes: Modes, contacts: Contacts, site: Any) -> tuple[Array, Array]:
    """θ and φ of a contact, in σ_s."""
    site = jnp.asarray(site).astype(modes.gap.real.dtype)
    if contacts is None:
        return jnp.ones_like(site), jnp.zeros_like(site)
    return contacts.threshold_at(site).astype(site.dtype), contacts.prestress_at(site).astype(site.dtype)


def nucleation_load(modes: Modes, contacts: Contacts) -> Array:
    """Displacement of the drive when contact 0 carries its threshold, in u_s."""
    threshold, prestress = contact_at(modes, contacts, 0)
    return modes.load * (threshold - prestress)


def passage(modes: Modes, contacts: Contacts = None) -> Passage:
    """Passage over contacts that repin at once; its fronts hold what Z_m has changed by since nucleation."""
    threshold, prestress = contact_at(modes, contacts, 0)
    at_0 = nucleate(modes, threshold - prestress)
    loaded, first_echo = at_0.stress, echo_at(modes, at_0.position)

    def excess(front: Front) -> Array:
        echo, (here, carried) = echo_at(modes, front.position), contact_at(modes, contacts, front.position)
        change = stress_ahead(front, echo)[0] + ((carried - prestress) - (here - threshold))
        return change if echo is None else change + (modes.echo_growth(front.position) * loaded).sum()

    def step(front: Front) -> Front:
        over = excess(front)
        released = contact_at(modes, contacts, front.position)[0] + over
        return advance(modes, front, released, echo_at(modes, front.position), loaded)._replace(behind=over)

    start = advance(modes, at_0._replace(stress=0 * loaded), threshold, first_echo, loaded)
    return Passage(start, step, excess, lambda site: contact_at(modes, contacts, site)[0], lambda front: front.edge[0])


def let_run(over: Passage, valid: Array, end: Array, contacts: Array | None, max_contacts: int) -> Arrest:
    """Let the front go until the contact ahead holds, the chain ends, or it is given up; differentiable forward.

    Parameters
    ----------
    over : Passage
    valid : bool array
        Whether slider and contacts lie in their domains.
    end : array
        Breaks after which a front never stops.
    contacts : array, optional
        How many a finite chain has.
    max_contacts : int
    """
    limit = jnp.minimum(jnp.minimum(end, 2.0e9).astype(jnp.int32), max_contacts)
    limit = limit if contacts is None else jnp.minimum(limit, contacts)

    front = lax.while_loop(lambda f: (over.excess(f) >= 0) & (f.position < limit), over.advance, over.start)
    s0, ahead, edge = front.position, over.excess(front), over.edge(front)
    through = s0 == (-1 if contacts is None else contacts)
    status = outcome(
        s0, ahead, edge - over.threshold(0 * s0), valid=valid, through=through, endless=s0.astype(end.dtype) >= end
    )
    length = straight_line((s0 - 1).astype(ahead.dtype), front.behind, ahead)
    return Arrest(s0, length_or_reason(status, length), status, edge)


def in_domain(body: Slider | Block) -> Array:
    """Whether the values, traced ones included, are those of a slider or block."""
    height, stiffness, poisson = (jnp.asarray(x) for x in (body.height, body.stiffness, body.poisson))
    return HEIGHT.holds(height) & STIFFNESS.holds(stiffness) & POISSON.holds(poisson)


@partial(jax.jit, static_argnames="count")
def front_stress(modes: Modes, count: int, contacts: Contacts = None) -> Float[Array, " count"]:
    """t(0) … t(count − 1): the stress each contact would carry had all before it broken, past the arrest too.

    Of Z_m itself and not of its change, whose rounding would not fade.
    """
    threshold, prestress = contact_at(modes, contacts, 0)

    def step(front: Front, _: None) -> tuple[Front, Array]:
        echo = echo_at(modes, front.position)
        stress = stress_ahead(front, echo)[0] + contact_at(modes, contacts, front.position)[1]
        return advance(modes, front, stress, echo), stress

    at_0 = nucleate(modes, threshold - prestress)
    start = advance(modes, at_0, threshold, echo_at(modes, at_0.position))
    return jnp.concatenate([threshold[None], lax.scan(step, start, length=count - 1)[1]])


# --- run-away ----------------------------------------------------------------------------------------------------------


def runaway_prestress(modes: Modes) -> Array:
    """φ_c = (1 + G_00)/2, in σ_s, of a semi-infinite chain."""
    return (1 + modes.weight.sum(axis=0)) / 2


def slowest_approach(modes: Modes) -> Array:
    """Slow rate 1 − ρ_2 at which the front stress of a slider settles.

    ρ solves (ρ − r_1)(ρ − r_2) = w_1 r_1 (ρ − r_2) + w_2 r_2 (ρ − r_1). Two modes only: with n it is an eigenvalue of an n × n
    matrix, which has no closed form for a loop to carry.
    """
    (r1, r2), (w1, w2), (g1, g2) = modes.ratio, modes.weight, modes.gap
    # with x = 1 − μ: (g1 − x)(g2 − x) − w1 r1 (g2 − x) − w2 r2 (g1 − x) = 0
    total = g1 + g2 - w1 * r1 - w2 * r2
    product = g1 * g2 - w1 * r1 * g2 - w2 * r2 * g1
    return 2 * product / (total + jnp.sqrt(jnp.maximum(total**2 - 4 * product, 0)))


def never_stops_after(modes: Modes, contacts: Contacts) -> Array:
    """Breaks after which a front that is still running never stops; inf where every front stops. Lanes last."""
    if contacts is None:
        return jnp.full_like(modes.load, jnp.inf)
    if isinstance(contacts, Interface):
        uniform, since, prestress = jnp.asarray(contacts.threshold_slope) == 0, 0, jnp.asarray(contacts.prestress)
    else:
        since = np.shape(contacts.threshold)[0]
        threshold, prestress = contact_at(modes, contacts, since - 1)
        uniform, prestress = jnp.ones((), bool), prestress / threshold
    settled = since + APPROACH / slowest_approach(modes) + 10 + contacts.repin_delay
    endless = uniform & (prestress >= runaway_prestress(modes)) if modes.echo is None else jnp.zeros((), bool)
    return jnp.ceil(jnp.minimum(jnp.where(endless, settled, jnp.inf), contacts.last_site()))
