r"""Chain with inertia, in which waves run ahead of the front.

A block of the interfacial layer has mass m = 1, one of the upper layer H/λc, so that sound travels one site per time unit
√(m/K) in both. A stiffer bond carries sound faster and adds no mass. Positions and velocities are advanced by velocity Verlet,
which is symplectic, between two exact half steps of viscous damping. Every loss of energy is recorded where it occurs: kinetic
energy in damping, stretch energy of breaking contacts, friction of sliding contacts. The remaining imbalance is the
integrator's error, of second order in the step.

A general-purpose integrator would do no better: the right-hand side jumps at every break, breaks must fall between two steps of
one fixed size, and a method of higher order loses its order there.

A simulation has no derivative. A contact breaks at the first whole step after its stress reaches the threshold, so the time of
a break would have the derivative of the step, and so would all that follows.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int
from jaxtyping import ArrayLike as AnyArrayLike

from slippulse_jax.base.domains import check_domain
from slippulse_jax.base.outcomes import first_of
from slippulse_jax.base.shown import short
from slippulse_jax.base.status import Outcome
from slippulse_jax.base.units import as_float
from slippulse_jax.bodies.chain import Chain, State, check_linear, potential_energy
from slippulse_jax.bodies.equilibrium import equilibrium, forces
from slippulse_jax.bulk.derivatives import without_derivative
from slippulse_jax.events.rupture import nucleate
from slippulse_jax.rules import CrackLike, SelfHealing


class Motion(NamedTuple):
    """Final state and energies of a simulation.

    Displacements are in u_s, times in √(m/K), energies in K u_s². The status is an `Outcome`: ARRESTED (at rest), RAN_THROUGH
    (the last contact broke), TIME_OVER (still moving at the end) or INVALID.
    """

    state: State
    upper: Float[Array, " N"]
    layer: Float[Array, " N"]
    upper_velocity: Float[Array, " N"]
    layer_velocity: Float[Array, " N"]
    first_break: Float[Array, " N"]  # time at which each contact first broke; inf if it did not
    breaks: Int[Array, " N"]
    extent: Int[Array, ""]  # sites from the left edge to the rightmost broken contact, which is among them
    time: Float[Array, ""]
    step: Float[Array, ""]
    kinetic: Float[Array, ""]
    potential: Float[Array, ""]
    work: Float[Array, ""]  # of the left edge
    broken: Float[Array, ""]  # stretch energy lost by breaking contacts
    damped: Float[Array, ""]
    rubbed: Float[Array, ""]  # work of friction on sliding contacts
    imbalance: Float[Array, ""]  # largest error of the energy balance over all steps
    status: Int[Array, ""]

    def __repr__(self) -> str:
        if np.ndim(self.status) or isinstance(self.status, Tracer):
            return f"Motion(extent={short(self.extent)}, time={short(self.time)}, status={short(self.status)})"
        return f"Motion(extent={int(self.extent)}, time={float(self.time):g}, status={Outcome(int(self.status)).name})"


class MotionState(NamedTuple):
    """State after a time step."""

    x: tuple[Array, Array]
    v: tuple[Array, Array]
    pull: tuple[Array, Array]
    pinning: Array
    sliding: Bool[Array, " N"]
    first_break: Array
    breaks: Array
    n: Array
    since: Array  # time since the last break
    work: Array  # energies, as of `Motion`
    broken: Array
    damped: Array
    rubbed: Array
    imbalance: Array  # largest error of their balance so far


def stable_step(chain: Chain, safety: AnyArrayLike = 0.2) -> Array:
    """Compute the time step: `safety` times the largest stable one.

    The latter is 2/ω_max for velocity Verlet, with ω_max² bounded by Gershgorin's discs.
    """

    def bonds(inner: Array, beyond: Array) -> Array:
        """Bound a row's diagonal plus off-diagonal, inside and at the end."""
        return 2 * inner.max() + jnp.maximum(2 * inner.max(), beyond)

    across = 2 * (chain.across.max() + chain.end.across)
    upper = (bonds(chain.upper, chain.end.upper) + across) / chain.height
    layer = bonds(chain.layer, chain.end.layer) + across + chain.contact.max()
    return 2 * jnp.asarray(safety) / jnp.sqrt(jnp.maximum(upper, layer))


def simulate_inertial(
    chain: Chain,
    state: State | None = None,
    *,
    duration: AnyArrayLike,
    damping: AnyArrayLike = 0.0,
    rule: SelfHealing | CrackLike = SelfHealing(),  # noqa: B008 - a constant
    velocity: AnyArrayLike = 0.0,
    trigger: int | Int[Array, ""] | None = None,
    safety: AnyArrayLike = 0.2,
    rest: AnyArrayLike = 1e-12,
) -> Motion:
    """Simulate the motion of a chain from rest.

    Parameters
    ----------
    chain : Chain
        With linear contacts. A semi-infinite end has the stiffness of an endless chain at rest; it reflects waves.
    state : State, optional
        Pinning points and load of a chain in equilibrium; by default the relaxed chain, loaded until its first contact breaks.
    duration : float
        In √(m/K).
    damping : float
        γ ≥ 0, rate at which every block loses momentum, per √(m/K).
    rule : SelfHealing or CrackLike
    velocity : float
        Velocity of the left edge of the upper layer, in u_s per √(m/K); 0 holds it fixed, as it is for a fast front.
    trigger : int, optional
        Contact that breaks at time 0; −1 for none. By default the one that nucleates, or none if `state` is given.
    safety : float
        Ratio of the step to the largest stable one, between 0 and 1.
    rest : float
        Kinetic energy, in K u_s², below which a damped chain without overloaded contacts counts as at rest.

    Returns
    -------
    Motion
        It carries a status (`Outcome`) instead of raising an exception. Composes with ``jit`` and ``vmap``.

    Raises
    ------
    ValueError
        If a number lies outside its domain; the message names it. A number traced by JAX gives `Outcome.INVALID` instead.
    TypeError
        If the rule is neither of these, or if a derivative is taken, which would be that of the time step.
    """
    check_linear(chain, "the inertial chain")
    if not isinstance(rule, SelfHealing | CrackLike):
        raise TypeError(f"rule = {rule!r}: must be SelfHealing(break_time) or CrackLike(friction)")
    with jax.debug_infs(False):
        least = jnp.where(chain.contact > 0, chain.threshold, jnp.inf).min()

    def given(name: str, value: Any, inside: Callable[[Any], Any], requirement: str) -> Array:
        """Check a number; a traced one outside its domain becomes NaN."""
        value = as_float(name, value)
        if not isinstance(inside(value), Tracer):
            check_domain(name, value, inside, requirement)
        number = jnp.asarray(value, chain.contact.dtype)
        return jnp.where(inside(number), number, jnp.nan)

    numbers = (
        given("duration", duration, lambda x: x > 0, "must be positive, in √(m/K)"),
        given("damping", damping, lambda x: x >= 0, "must be 0 or more, per √(m/K)"),
        given("velocity", velocity, jnp.isfinite, "must be finite, in u_s per √(m/K)"),
        given("safety", safety, lambda x: (x > 0) & (x < 1), "must lie between 0 and 1"),
        given("rest", rest, lambda x: x >= 0, "must be 0 or more, in K u_s²"),
    )
    sites = chain.sites
    first = -1 if trigger is None else trigger
    given("trigger", first, lambda x: (x >= -1) & (x < sites), f"must be −1 … {sites - 1}")
    if isinstance(rule, CrackLike):
        below = "must be 0 or more and below every threshold, in σ_s"
        none = "must be 0 under CrackLike, whose contacts carry its friction"
        of_rule = given("CrackLike.friction", rule.friction, lambda x: (x >= 0) & (x < least), below)
        of_rule = of_rule + given("residual_strength of the chain", chain.residual_strength, lambda x: x == 0, none)
    else:
        of_rule = given("SelfHealing.break_time", rule.break_time, lambda x: x >= 0, "must be 0 or more, in √(m/K)")
    if state is None:
        state, found = nucleate(chain)
        first = found if trigger is None else trigger
    with jax.debug_infs(False):  # a block that never moved has first moved at inf
        return _undifferentiated(chain, state, jax.tree.map(lambda _: of_rule, rule), numbers, jnp.asarray(first, jnp.int32))


def _simulate(
    chain: Chain, state: State, rule: SelfHealing | CrackLike, numbers: tuple[Array, ...], trigger: Int[Array, ""]
) -> Motion:
    duration, damping, velocity, safety, rest = numbers
    start = equilibrium(chain, state)
    dt = stable_step(chain, safety)
    number = jnp.ceil(duration / dt)
    known = jnp.isfinite(jnp.stack([*numbers, *jax.tree.leaves(rule)])).all()
    valid = known & (number < 2.0**31) & (trigger >= -1) & (trigger < chain.sites)
    steps = jnp.where(valid, number, 0).astype(jnp.int32)
    mass = (chain.height, jnp.ones_like(dt))
    keep = jnp.exp(-damping * dt / 2)
    k = chain.stiffness
    attached = chain.contact > 0
    soft = k / jnp.where(attached, chain.contact, jnp.inf)
    sites = jnp.arange(chain.sites)
    held = jnp.where(sites == 0, 0.0, 1.0)  # u_t[0] is imposed
    kept: Any = rule.friction if isinstance(rule, CrackLike) else chain.residual_strength * chain.threshold  # by a break

    def kinetic(v: tuple[Array, Array]) -> Array:
        return ((mass[0] * v[0] ** 2 * held).sum() + (v[1] ** 2).sum()) / 2

    def damp(now: MotionState) -> MotionState:
        v = (jnp.where(sites == 0, velocity, keep * now.v[0]), keep * now.v[1])
        return now._replace(v=v, damped=now.damped + kinetic(now.v) - kinetic(v))

    def verlet(now: MotionState) -> MotionState:
        v = (now.v[0] + held * now.pull[0] * dt / (2 * mass[0]), now.v[1] + now.pull[1] * dt / 2)
        x = (now.x[0] + dt * v[0], now.x[1] + dt * v[1])
        # the pinning point of a sliding contact moves with the layer, so that the contact always carries the friction
        moved = jnp.where(now.sliding, x[1] - now.x[1], 0)
        pinning = now.pinning + moved
        pull = forces(chain, pinning, x)
        v = (v[0] + held * pull[0] * dt / (2 * mass[0]), v[1] + pull[1] * dt / 2)
        after = now._replace(x=x, v=v, pull=pull, pinning=pinning, n=now.n + 1, since=now.since + dt)
        work = now.work - (now.pull[0][0] + pull[0][0]) / 2 * velocity * dt  # of the force that holds the left edge
        return after._replace(work=work, rubbed=now.rubbed + k * (kept * moved).sum())

    def break_those(now: MotionState, those: Array) -> MotionState:
        t = chain.stress(now.x[1], now.pinning)
        lost = jnp.where(those, t - kept, 0)
        pinning = now.pinning + lost * soft
        energy = (jnp.where(those, (t**2 - kept**2) * soft, 0) * k / 2).sum()
        return now._replace(
            pinning=pinning,
            sliding=now.sliding | those if isinstance(rule, CrackLike) else now.sliding,
            pull=(now.pull[0], now.pull[1] + k * lost),
            first_break=jnp.where(those, jnp.minimum(now.first_break, now.n.astype(dt.dtype) * dt), now.first_break),
            breaks=now.breaks + those.astype(now.breaks.dtype),
            since=jnp.where(those.any(), 0, now.since),
            broken=now.broken + energy,
        )

    def overloaded(now: MotionState) -> Array:
        over = chain.stress(now.x[1], now.pinning) - chain.threshold
        return jnp.where(attached & ~now.sliding, over, -jnp.inf)

    def step(now: MotionState) -> MotionState:
        now = damp(verlet(damp(now)))
        if isinstance(rule, CrackLike):
            now = now._replace(sliding=now.sliding & (now.v[1] > 0))
            those = overloaded(now) >= 0
        else:
            over = overloaded(now)
            most = (sites == jnp.argmax(over)) & (over >= 0) & (now.since >= rule.break_time * (1 - 1e-9))
            those = jnp.where(jnp.asarray(rule.break_time) > 0, most, over >= 0)
        now = break_those(now, those)
        energy = kinetic(now.v) + potential_energy(chain, now.x, now.pinning)
        error = jnp.abs(energy - initial - now.work + now.broken + now.damped + now.rubbed)
        return now._replace(imbalance=jnp.maximum(now.imbalance, error))

    def going(now: MotionState) -> Array:
        at_rest = (kinetic(now.v) < rest) & (overloaded(now).max() < 0) & ~now.sliding.any()
        return (now.n < steps) & ~(at_rest & (damping > 0) & (now.since > 10 * dt))

    zero = jnp.zeros_like(dt)
    x = (start.upper, start.layer)
    initial = potential_energy(chain, x, state.pinning)
    v = (jnp.zeros_like(start.upper).at[0].set(velocity), jnp.zeros_like(start.layer))
    none, never = jnp.zeros(chain.sites, jnp.int32), jnp.full_like(start.upper, jnp.inf)
    energies = {name: zero for name in ("work", "broken", "damped", "rubbed", "imbalance")}
    pull = forces(chain, state.pinning, x)
    now = MotionState(x, v, pull, state.pinning, none > 0, never, none, none[0], zero + jnp.inf, **energies)
    now = lax.while_loop(going, step, break_those(now, sites == trigger))
    extent = jnp.where(now.breaks > 0, sites + 1, 0).max()
    moving = kinetic(now.v)
    finite = valid & jnp.isfinite(moving) & (start.status == Outcome.SOLVED)
    endings = {Outcome.INVALID: ~finite, Outcome.RAN_THROUGH: extent == chain.sites, Outcome.TIME_OVER: now.n >= steps}
    kept = {name: x for name, x in now._asdict().items() if name in Motion._fields}
    return Motion(
        state=State(now.pinning, now.x[0][0]),
        upper=now.x[0],
        layer=now.x[1],
        upper_velocity=now.v[0],
        layer_velocity=now.v[1],
        extent=extent,
        time=now.n.astype(dt.dtype) * dt,
        step=dt,
        kinetic=moving,
        potential=potential_energy(chain, now.x, now.pinning),
        status=first_of(endings),
        **kept,
    )


_undifferentiated = without_derivative(
    _simulate,
    "simulate_inertial cannot be differentiated: contacts break at whole time steps, so every later derivative would be "
    "that of the step. For the length of a first precursor without inertia, precursor_length has an exact derivative.",
)


def quasi_static_break_time(chain: Chain, damping: float) -> float:
    """Break time in which the slowest mode decays by e^{−30}.

    It is computed from the dense spectrum, O(N³), for checks on short chains.
    """
    n = chain.sites
    flat = jax.jacfwd(lambda x: jnp.concatenate(forces(chain, jnp.zeros(n), (x[:n], x[n:]))))(jnp.zeros(2 * n))
    root = np.sqrt(np.append(np.full(n, float(chain.height)), np.ones(n)))
    squares = np.linalg.eigvalsh(-np.asarray(flat)[1:, 1:] / np.outer(root[1:], root[1:]))
    slowest = squares.min()
    rate = damping / 2 if damping**2 < 4 * slowest else damping / 2 - np.sqrt(damping**2 / 4 - slowest)
    return float(30 / rate)
