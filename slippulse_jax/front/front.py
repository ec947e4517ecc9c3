r"""The first precursor by a recursion of fixed-size state.

It costs O(1) per break, over the modes of any waveguide.

Load the left edge until contact 0 carries its threshold θ_0. It breaks, repins at zero stretch and overloads contact 1, and so
on. With all contacts before s broken in turn, contact s carries, in σ_s and before it breaks,

    t(s) = φ_s + Σ_m e_m(s) Z_m,    Z_m = w_m S_m + r_m^s (A C_m + Σ_n R_mn T_n),    A = θ_0 − φ_0,

with the modes of `slippulse_jax.bodies.modes`, the prestress φ_s, and two sums over what the contacts behind gave up,
S_m = Σ_{j<s} r_m^{s−j} t(j) and T_n = Σ_{j<s} e_n(j) r_n^j t(j). Only the n numbers Z_m are carried: breaking contact s maps

    Z_m → r_m [Z_m + v_m t],    v_m = w_m + Σ_n Q_mn e_n(s),    Q_mn = r_m^s R_mn r_n^s → r_m r_n Q_mn.

Where contacts repin with the stress r θ, these are the equations of what they can lose, t − r θ, whose threshold is (1 − r) θ
and whose prestress is φ − r θ (`contact_at`). What is released, and with it every load and displacement, stays as it is.

Under the paper's rule the front goes on while t(s) ≥ θ_s, and Λ = s0 λc, where s0 is the first s with t(s) < θ_s. ℓ, the length
without steps, ends where a polynomial through the overloads t − θ of the last contacts reached falls to zero (`end_of_front`).

A smooth rule (`slippulse_jax.rules`) says which fraction p(t) of a contact breaks when the front reaches it; the contact then
gives up p(t) t. Contact 0 always breaks as a whole. The front does not stop at a contact but fades. With t linear between
contacts its length is

    ℓ_w = p(t(1)) + Σ_{s ≥ 1} ∫_s^{s+1} p(t(x)) dx,

where the first term is the step from contact 0 to its neighbour.

Run-away, of r = 0. Far from the edge every contact behind the front gave up the same stress t, and t = φ + t Σ_{j≥1} G_0j
with Σ_j G_0j = 1 over the endless lattice, so t → 2φ/(1 + G_00): it stays above a uniform threshold of 1 if and only if
φ ≥ φ_c = (1 + G_00)/2. Below φ_c (or with rising thresholds) every front stops. Above it the front never stops, unless it
stops on its way to that state: far from the edge t approaches its limit as ρ_2^s, and on a soft, short slider it does so from
below. So only for φ ≥ φ_c, uniform, the recursion is cut off where that approach is over to rounding; on a profile, as long
after its last site. Under a smooth rule the prestress alone breaks a little of every contact, however far ahead. So the
recursion is cut off at the same place wherever p(φ/φ_c) is more than rounding; if then more than `FADED` of the contact ahead
still breaks, the front never stops.

Notes
-----
Q is carried, rather than r_m^s, because its tangent costs two products per number.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from slippulse_jax.bodies.modes import Modes, equilibrium_fields, inverse, lattice_modes
from slippulse_jax.bulk.compiler import in_full
from slippulse_jax.interface import AnyInterface, Interface, Profile
from slippulse_jax.rules import BreakRule, fraction_broken
from slippulse_jax.slider import Fields, Slider

APPROACH = 45.0
"""Decay lengths after which e^{−s/length} is nothing in float64."""

FADED = 1e-9
"""Largest fraction of the contact ahead that still breaks where a front has stopped. On an endless chain that is what the
prestress alone may break; what lies ahead would then add less to ℓ than can be measured."""

REACHED = 6
"""Contacts through whose overloads the curve passes on which ℓ ends."""

NEWTON_STEPS = 4
"""Steps from the straight line to the end of the curve: four reach rounding, on contacts stiffer than any block more.
They are written out: XLA aborts on a loop, such as that of `root_between`, within the loop over lanes."""

# --- one step ----------------------------------------------------------------------------------------------------------


class Front(NamedTuple):
    """State of a front; modes are the leading axis of three fields."""

    loads: Any  # what loads the contacts ahead: Z_m, counted as `passage` does; or the readings of every contact
    reflected: Any  # Q_mn
    reach: Any  # (w_n + Σ_m e_m(0) R_mn) r_n^s, what the next break adds to the stress on contact 0; None where not wanted
    position: Any  # s
    edge: Any = None  # stress on contact 0; None where not wanted


def stress_ahead(front: Front, echo: Any = None) -> Any:
    """Σ_m e_m(s) Z_m, the leading axis kept, without the prestress."""
    return (front.loads if echo is None else echo * front.loads).sum(0, keepdims=True)


def advance(guide: Any, front: Front, released: Any, echo: Any = None, start: Any = None) -> Front:
    """Pass the contact ahead, which gives up the stress `released`.

    That is p(t) t of contact s, or a part of it. Multiplying by r_m is written x − (1 − r_m) x: r_m itself, rounded, would be
    a systematic error of s·10⁻¹⁶. A guide is `Modes`, or anything with a `gap` 1 − r_m and a `weight` w_m; `echo` is e_m(s) of
    a finite one. `start` is Z_m before contact 0 broke, where `front.loads` holds the change since then: soft interfaces
    change Z_m by as little as b, of which single precision would lose the digits.
    """
    gap, Q, reach, edge = guide.gap, front.reflected, front.reach, front.edge
    both = gap[:, None] + gap[None] - gap[:, None] * gap[None]  # 1 − r_m r_n
    loads = front.loads + (guide.weight + (Q if echo is None else Q * echo[None]).sum(1)) * released
    if reach is not None:
        edge = edge + (reach if echo is None else reach * echo).sum(0, keepdims=True) * released
        reach = reach - gap * reach
    lost = gap * (loads if start is None else start + loads)
    return Front(loads - lost, Q - both * Q, reach, front.position + 1, edge)


# --- where a front ends ------------------------------------------------------------------------------------------------


def degree_of(contacts: AnyInterface) -> int:
    """Degree of the curve on which ℓ ends; 1 where neighbours differ.

    Elsewhere the overload is an analytic function of the position, and the curve all but coincides with it.
    """
    return 1 if isinstance(contacts, Profile) else REACHED - 1


def end_of_front(position: Any, over: Sequence[Any], degree: Any = REACHED - 1) -> Any:
    """ℓ, where the polynomial through the last overloads falls to zero.

    Parameters
    ----------
    position : array
        s0, the first contact that holds.
    over : sequence of array
        Overload, the stress less the threshold, of contact s0; and of those before it as they broke, the nearest first. Those
        before contact 0 may be any finite numbers.
    degree : int or array
        Highest degree; s0 where that is less.
    """
    row, coefficients = list(over), [jnp.zeros_like(over[0])] * len(over)
    for order in range(len(over)):
        difference = jnp.where((order <= position) & (order <= degree), row[0], 0)
        for power in range(order > 0, order + 1):
            coefficients[power] = coefficients[power] + float(BACKWARD[order, power]) * difference
        row = [near - far for near, far in pairwise(row)]
    return position + _last_zero(*coefficients)


def _backward() -> np.ndarray:
    rows, basis = np.zeros((REACHED, REACHED)), np.ones(1)
    for order in range(REACHED):
        rows[order, : order + 1] = basis
        basis = np.polynomial.polynomial.polymul(basis, [order / (order + 1), 1 / (order + 1)])
    return rows


BACKWARD = _backward()
"""Newton's basis x (x + 1) … (x + j − 1)/j! of the differences of order j, in powers of x."""


@jax.custom_jvp
def _last_zero(*coefficients: Array) -> Array:
    """Zero in [−1, 0] of a polynomial that there turns negative."""
    first, behind = coefficients[0], _with_slope(coefficients, -1)[0]
    x, low, high = first / (behind - first), jnp.full_like(first, -1), jnp.zeros_like(first)
    for _ in range(NEWTON_STEPS):
        value, slope = _with_slope(coefficients, x)
        low, high = jnp.where(value >= 0, x, low), jnp.where(value >= 0, high, x)
        after = x - value / slope
        x = jnp.where((after >= low) & (after <= high), after, (low + high) / 2)
    return x


@_last_zero.defjvp
def _(coefficients: tuple[Array, ...], changes: tuple[Array, ...]) -> tuple[Array, Array]:  # pyright: ignore[reportUnusedFunction]
    x = _last_zero(*coefficients)
    return x, -_with_slope(changes, x)[0] * inverse(_with_slope(coefficients, x)[1])


def _with_slope(coefficients: Sequence[Any], x: Any) -> tuple[Any, Any]:
    """Value of a polynomial by ascending powers, and its slope."""
    value, slope = coefficients[-1], 0
    for one in reversed(coefficients[:-1]):
        value, slope = one + x * value, value + x * slope
    return value, slope


# --- one front ---------------------------------------------------------------------------------------------------------


def follow(
    rule: BreakRule | None,
    start: Any,
    ahead: Callable[[Any], tuple[Array, Array]],
    release: Callable[[Any, Array, Array], Any],
    limit: int | Array,
    degree: int = REACHED - 1,
) -> tuple[Any, tuple[Array, Array], Array, Array]:
    """Follow a front until nothing ahead breaks, or contact `limit` is ahead.

    Differentiable forward. It starts after contact 0 has broken as a whole, and is any state with the `position` of the
    contact ahead, whose stress and threshold are ``ahead(front)``; ``release(front, part, stress)`` is the front after that
    part of it has broken, under that stress. Return the front, stress and threshold of the contact ahead of it, the fraction
    of it that would break, and ℓ, which ends on a curve of that `degree` under the paper's rule.
    """

    def passed(way: tuple[Array, ...], here: tuple[Array, Array], after: tuple[Array, Array]) -> tuple[Array, ...]:
        """Overloads behind, nearest first; under a smooth rule the length."""
        if rule is None:
            return (here[0] - here[1], *way[:-1])
        return (way[0] + rule.overloaded_length(here[0], after[0], here[1], after[1]),)

    def step(now: tuple) -> tuple:
        front, here, part, way = now
        front = release(front, part, here[0])
        after = ahead(front)
        return front, after, fraction_broken(rule, *after), passed(way, here, after)

    first = ahead(start)
    part = fraction_broken(rule, *first)
    way = (jnp.zeros_like(part),) * (REACHED - 1) if rule is None else (part,)  # contact 0 breaks at its threshold exactly
    # the neglected remainder is at most this fraction times the sum of a decay no slower than ρ_2 < 1
    nothing = rounding(part)
    end, last, part, way = lax.while_loop(
        lambda now: (now[2] > nothing) & (now[0].position < limit), step, (start, first, part, way)
    )
    length = end_of_front(end.position, (last[0] - last[1], *way), degree) if rule is None else way[0]
    return end, last, part, length


def rounding(part: Array) -> float:
    """Fraction of a contact that no digit of a length shows."""
    return 1e-4 * float(jnp.finfo(part.dtype).eps)


def nucleate(modes: Modes, drive: Any = 1) -> Front:
    """The front before contact 0, loaded by the stress `drive`, breaks."""
    reach = modes.weight + (modes.echo_factor(0 * modes.load)[:, None] * modes.reflection).sum(0)
    return Front(drive * modes.drive, modes.reflection, reach, jnp.int32(0), 0 * reach[:1])


def echo_at(modes: Modes, site: Array) -> Array | None:
    """e_m of a finite chain."""
    return None if modes.echo is None else modes.echo_factor(site)


def contact_at(modes: Modes, contacts: AnyInterface, site: Any) -> tuple[Array, Array]:
    """θ and φ of a contact, less what it keeps, in σ_s."""
    site = jnp.asarray(site).astype(modes.gap.dtype)
    if contacts is None:
        return jnp.ones_like(site), jnp.zeros_like(site)
    kept, own = kept_at(contacts, site), (contacts.threshold_at(site), contacts.prestress_at(site))
    return (own[0] - kept).astype(site.dtype), (own[1] - kept).astype(site.dtype)


def kept_at(contacts: AnyInterface, site: Array) -> Array | float:
    """Stress r θ with which a contact repins, in σ_s."""
    if contacts is None or contacts.residual_strength is None:
        return 0.0
    return jnp.asarray(contacts.residual_strength) * contacts.threshold_at(site)


def passage(
    modes: Modes, contacts: AnyInterface = None, rule: BreakRule | None = None
) -> tuple[Front, Callable[[Front], tuple[Array, Array]], Callable[[Front, Array, Array], Front]]:
    """How a front passes contacts: `start`, `ahead`, `release` for `follow`.

    The paper's rule compares stresses, so they are counted from contact 0 at nucleation, where small changes keep their
    digits. A smooth rule asks for the stress itself, from zero: of its change the rounding would not fade.
    """
    nucleated = contact_at(modes, contacts, 0)
    at_0, hard = nucleate(modes, nucleated[0] - nucleated[1]), rule is None
    threshold, prestress = nucleated if hard else (0 * x for x in nucleated)
    loaded = at_0.loads if hard else None

    def ahead(front: Front) -> tuple[Array, Array]:
        here, carried = contact_at(modes, contacts, front.position)
        stress = stress_ahead(front, echo_at(modes, front.position))[0] + (carried - prestress)
        if hard and modes.echo is not None:
            stress = stress + (modes.echo_growth(front.position) * at_0.loads).sum()
        return stress, here - threshold

    def release(front: Front, part: Any, stress: Array) -> Front:
        return advance(modes, front, part * (threshold + stress), echo_at(modes, front.position), loaded)

    start = release(at_0._replace(loads=0 * at_0.loads) if hard else at_0, 1, nucleated[0] - threshold)
    return start, ahead, release


# --- past the arrest ---------------------------------------------------------------------------------------------------


def run_over(
    modes: Modes, loaded: Array, prestress: Float[Array, " n"], part: Callable[..., Any] = lambda stress: 1, *values: Array
) -> Float[Array, " n"]:
    """Stress t(s) on each contact as a front runs over all.

    In reverse mode a derivative in all thresholds and prestresses is one pass back, O(1) per contact.

    Parameters
    ----------
    modes : Modes
    loaded : array, shape ()
        Stress on contact 0 under the drive, its threshold: t(0).
    prestress : array, shape (n,)
        φ_i.
    part : callable
        Fraction of a contact that breaks, of its stress and of its `values`; all of it by default.
    *values : array, shape (n,)
    """

    def step(front: Front, here: tuple[Array, ...]) -> tuple[Front, Array]:
        carried, *more = here
        # of Z_m itself and not of its change, whose rounding would not fade
        echo = echo_at(modes, front.position)
        stress = jnp.where(front.position == 0, loaded, carried + stress_ahead(front, echo)[0])
        return advance(modes, front, part(stress, *more) * stress, echo), stress

    start = nucleate(modes, loaded - prestress[0])._replace(reach=None, edge=None)
    return lax.scan(step, start, (prestress, *values))[1]


def length_of_run(rule: BreakRule | None, stress: Float[Array, " n"], threshold: Float[Array, " n"]) -> tuple[Array, Array]:
    """ℓ of a run, on a straight line, and whether it ended."""
    site, part = jnp.arange(stress.size), jax.vmap(partial(fraction_broken, rule))(stress, threshold)
    ends = (part <= rounding(part)) & (site > 0)
    s0 = jnp.where(ends.any(), jnp.argmax(ends), stress.size - 1)
    if rule is None:
        over = stress - threshold
        return end_of_front(s0.astype(over.dtype), (over[s0], over[s0 - 1]), 1), (s0 > 0) & ~(part[s0] > 0)
    steps = jax.vmap(rule.overloaded_length)(stress[1:-1], stress[2:], threshold[1:-1], threshold[2:])
    return part[1:2].sum() + jnp.where(site[1:-1] < s0, steps, 0).sum(), (s0 > 0) & (part[s0] <= FADED)


@in_full
def slip_and_stress(
    slider: Slider, prestress: Array, position: Array, count: int, residual_strength: Any = 0.0
) -> tuple[Array, Array]:
    r"""Slip, in u_s, and contact stress, in σ_s, behind a front.

    At the first `count` contacts after a front that stopped at `position`: how far the interfacial layer moved while the front
    ran, and what each contact carries (label cra06). When the contacts before `position` have broken in turn, pinning points
    have moved by p_j, and at contact i

        slip(i)   = Σ_j G_ij p_j,
        stress(i) = φ + A Σ_m C_m r_m^i + slip(i) − p_i,      A = 1 − φ.

    `position` is at most `count`; of the last contact a part f may be broken, f²(3 − 2f) of it, so that fields change smoothly
    from one whole number to the next. Contact i lies at x = i λc; beyond a free end the fields have no meaning. Contacts of a
    `residual_strength` r release what they carry beyond r.
    """
    modes, site = lattice_modes(slider), jnp.arange(count, dtype=position.dtype)
    part = jnp.clip(position - site, 0, 1)
    broken = part**2 * (3 - 2 * part)
    loaded = jnp.ones_like(modes.load) - residual_strength  # contact 0 carries its threshold
    moved = broken * run_over(modes, loaded, prestress - residual_strength + 0 * site, lambda _, broken: broken, broken)
    slip = equilibrium_fields(modes, jnp.zeros_like(modes.load), moved).layer
    driven = (1 - prestress) * jax.vmap(modes.profile)(site) @ modes.drive
    return slip, prestress + driven + slip - moved


@partial(jax.jit, static_argnames="count")
def front_stress(modes: Modes, count: int, contacts: AnyInterface = None) -> Float[Array, " count"]:
    """t(0) … t(count − 1) under the paper's rule."""
    site = jnp.arange(count)
    threshold, prestress = contact_at(modes, contacts, site)
    return run_over(modes, threshold[0], prestress) + kept_at(contacts, site)


@partial(jax.jit, static_argnames="sites")
def front_fields(slider: Slider, interface: AnyInterface = None, *, position: Any, sites: int) -> Fields:
    """Fields once the contacts of a slider before `position` have broken.

    At the load of nucleation, on the first `sites` contacts: position 0 is nucleation, `contacts_broken` is arrest. Those of
    `slippulse_jax.exact.front.exact_fields`, by the recursion.
    """
    modes, site = lattice_modes(slider), jnp.arange(sites)
    threshold, prestress = contact_at(modes, interface, site)
    pinning = jnp.where(site < position, run_over(modes, threshold[0], prestress), 0)
    load, prestress = modes.load * (threshold[0] - prestress[0]), prestress + kept_at(interface, site)
    return equilibrium_fields(modes, load, pinning, prestress)


# --- run-away ----------------------------------------------------------------------------------------------------------


def runaway_prestress(modes: Modes) -> Array:
    """φ_c = (1 + G_00)/2, in σ_s, of a semi-infinite chain."""
    return (1 + modes.weight.sum(axis=0)) / 2


def slowest_approach(modes: Modes) -> Array:
    """Slow rate 1 − ρ_2 at which the front stress settles.

    ρ solves (ρ − r_1)(ρ − r_2) = w_1 r_1 (ρ − r_2) + w_2 r_2 (ρ − r_1). Two modes only: with n it is an eigenvalue of an n × n
    matrix, which has no closed form for a loop to carry.
    """
    (r1, r2), (w1, w2), (g1, g2) = modes.ratio, modes.weight, modes.gap
    # with x = 1 − μ: (g1 − x)(g2 − x) − w1 r1 (g2 − x) − w2 r2 (g1 − x) = 0
    total = g1 + g2 - w1 * r1 - w2 * r2
    product = g1 * g2 - w1 * r1 * g2 - w2 * r2 * g1
    return 2 * product / (total + jnp.sqrt(jnp.maximum(total**2 - 4 * product, 0)))


def never_stops_after(modes: Modes, contacts: AnyInterface, rule: BreakRule | None = None) -> Array:
    """Breaks after which a front never stops; inf if all stop."""
    if contacts is None:
        return jnp.full_like(modes.load, jnp.inf)
    if isinstance(contacts, Interface):
        uniform, since = jnp.asarray(contacts.threshold_slope) == 0, 0
    else:
        uniform, since = jnp.ones((), bool), np.shape(contacts.threshold)[0]
    threshold, prestress = contact_at(modes, contacts, max(since - 1, 0))
    settled = since + APPROACH / slowest_approach(modes) + 10
    part = fraction_broken(rule, prestress / runaway_prestress(modes), threshold)
    endless = uniform & (part > rounding(part)) if modes.echo is None else jnp.zeros((), bool)
    return jnp.ceil(jnp.minimum(jnp.where(endless, settled, jnp.inf), contacts.last_site()))
