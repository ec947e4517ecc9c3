r"""λ-contacts of many micro-junctions, and the condition for smooth sliding.

Each junction breaks when its stretch reaches its threshold, and repins at once with zero stretch and a new threshold drawn from
P_c. The force on a contact of many junctions pulled by X, in units of its stiffness, is the mean stretch

    F(X) = X J(X) + ∫_0^X P_c(y) F(X − y) dy,        J = 1 − ∫ P_c

(the master equation of Braun and Peyrard, written for the force: a junction either has not yet broken, or first broke at y
and has been as new since). It tends to ⟨x²⟩/2⟨x⟩. A narrow P_c gives a sawtooth, a wide one a law that hardly falls.

A contact in surroundings of stiffness K_s is stable where its force falls less steeply than that of the surroundings,
k F' > −K_s. On the lattice K_s = k(1 − G_00)/G_00, with G_00 the response of the site to its own pinning point. Neighbours that
weaken too are softer, so the whole chain loses stability earlier: where its load decreases as the first contact is stretched.
"""

import functools
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.special import gamma, ndtr
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as AnyArrayLike
from scipy.optimize.elementwise import find_root

from slippulse_jax.base.domains import Domain, check_choice
from slippulse_jax.base.units import quantity_field
from slippulse_jax.bodies.chain import Chain, State
from slippulse_jax.bodies.equilibrium import imbalance
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.slider import Slider

Kind = Literal["normal", "uniform", "weibull"]

LEAST_WIDTH = 1e-3
"""Smallest width searched for smooth sliding."""


class ThresholdDistribution(eqx.Module):
    """Distribution P_c(f_s) of the thresholds of a contact's junctions, in u_s.

    Parameters
    ----------
    kind : {"normal", "uniform", "weibull"}
        The normal law is cut off at zero and at two.
    width : float
        Normal: σ before the cut, > 0. Uniform: standard deviation, at most 1/√3. Weibull: 1/shape, in (0, 1]; 1 is
        exponential, and small widths have a standard deviation of about 1.28 times theirs.
    """

    kind: Kind = eqx.field(static=True)
    width: Float[AnyArrayLike, ""] = quantity_field("w", "u_s")

    def __check_init__(self) -> None:
        check_choice("ThresholdDistribution.kind", self.kind, Kind)
        most = {"normal": np.inf, "uniform": 1 / np.sqrt(3), "weibull": 1.0}[self.kind]
        domain = Domain(0, most, f"must be positive and at most {most:.4g}", closed="high")
        domain.check("ThresholdDistribution.width", self.width)

    def cumulative(self, x: Array) -> Array:
        """Integrate P_c from 0 to x."""
        w = jnp.asarray(self.width)
        if self.kind == "normal":
            low, high = ndtr(-1 / w), ndtr(1 / w)
            return jnp.clip((ndtr((x - 1) / w) - low) / (high - low), 0, 1)
        if self.kind == "uniform":
            half = jnp.sqrt(3.0) * w
            return jnp.clip((x - 1 + half) / (2 * half), 0, 1)
        return -jnp.expm1(-((jnp.maximum(x, 0) * gamma(1 + w)) ** (1 / w)))

    def sample(self, key: Array, shape: tuple[int, ...]) -> Array:
        """Draw thresholds from P_c."""
        w = jnp.asarray(self.width, float)
        if self.kind == "normal":
            return 1 + w * jax.random.truncated_normal(key, -1 / w, 1 / w, shape)
        u = jax.random.uniform(key, shape, w.dtype)
        if self.kind == "uniform":
            return 1 + jnp.sqrt(3.0) * w * (2 * u - 1)
        return (-jnp.log1p(-u)) ** w / gamma(1 + w)


class ForceLaw(eqx.Module):
    """Force law F(X), linear between grid points.

    It can be used as the `law` of a `chain`.
    """

    spacing: Float[Array, ""]
    force: Float[Array, " G"]  # F at 0, spacing, 2 spacing …

    @property
    def stretch(self) -> Float[Array, " G"]:
        """Stretch X at the grid points, in u_s."""
        return self.spacing * jnp.arange(self.force.shape[0])

    @property
    def steepest_fall(self) -> Array:
        """Smallest slope F' between grid points."""
        return (jnp.diff(self.force) / self.spacing).min()

    def __call__(self, stretch: Array) -> Array:
        """Interpolate the force at any stretch.

        The contact is a linear spring under compression; beyond the grid the last value holds.
        """
        grid = self.force.shape[0]
        position = jnp.clip(stretch / self.spacing, 0, grid - 1)
        left = jnp.clip(jnp.floor(position).astype(jnp.int32), 0, grid - 2)
        part = position - left
        inside = self.force[left] + part * (self.force[left + 1] - self.force[left])
        return jnp.where(stretch < 0, stretch, inside)


@functools.partial(jax.jit, static_argnames="points")
def force_law(thresholds: ThresholdDistribution, *, reach: float = 4.0, points: int = 801) -> ForceLaw:
    """Solve the master equation for the force law of infinitely many junctions.

    Parameters
    ----------
    thresholds : ThresholdDistribution
    reach : float
        Largest X, in u_s.
    points : int
        Number of grid points. P_c enters through its probabilities between grid points, so that any width is resolved. The
        error is of second order in the spacing if P_c is smooth on that scale.
    """
    dx = jnp.asarray(reach / (points - 1), jnp.result_type(float))
    x = dx * jnp.arange(points)
    upto = thresholds.cumulative(x)
    mass = jnp.append(0.0, jnp.diff(upto))  # of ((j − 1) dx, j dx]
    # a first break in ((j−1)dx, j dx] is in its middle on average, so F there is the mean over the two ends
    alone = x * (1 - upto)

    def step(force: Array, n: Array) -> tuple[Array, None]:
        # Σ_j mass_j [F(n−j) + F(n−j+1)]/2; the term F(n) itself has the weight mass_1/2
        back = n - jnp.arange(points)
        older, newer = force[jnp.maximum(back, 0)], force[jnp.maximum(back + 1, 0)]
        counted = (back >= 0) & (jnp.arange(points) > 0)
        newer = jnp.where(back + 1 == n, 0.0, newer)
        total = alone[n] + (jnp.where(counted, mass, 0.0) * (older + newer)).sum() / 2
        return force.at[n].set(total / (1 - mass[1] / 2)), None

    force, _ = lax.scan(step, jnp.zeros(points, x.dtype), jnp.arange(1, points))
    return ForceLaw(dx, force)


@functools.partial(jax.jit, static_argnames="junctions")
def ensemble_force(thresholds: ThresholdDistribution, junctions: int, stretch: Array, key: Array) -> Float[Array, " G"]:
    """Simulate explicit junctions pulled by X ≥ 0, in u_s, increasing; return their mean stretch.

    Every junction breaks at exactly its threshold.
    """

    def pull(carry: tuple, x: Array) -> tuple[tuple, Array]:
        def late(carry: tuple) -> Array:
            return (carry[1] <= x).any()

        def repin(carry: tuple) -> tuple:
            pinned, next_break, key = carry
            key, use = jax.random.split(key)
            due = next_break <= x
            fresh = next_break + thresholds.sample(use, (junctions,))
            return jnp.where(due, next_break, pinned), jnp.where(due, fresh, next_break), key

        carry = lax.while_loop(late, repin, carry)
        return carry, (x - carry[0]).mean()

    key, use = jax.random.split(key)
    start = (jnp.zeros(junctions), thresholds.sample(use, (junctions,)), key)
    return lax.scan(pull, start, jnp.asarray(stretch))[1]


class Stability(NamedTuple):
    """Stability of contacts with a distribution of thresholds on a slider."""

    steepest_fall: Array  # smallest F'
    surroundings: Array  # K_s/k of a contact in the bulk
    surroundings_at_edge: Array  # K_s/k of the contact at the left edge
    smooth: Array  # no single contact is unstable: F' > −K_s/k at the edge, where the surroundings are softest


def stability(slider: Slider, thresholds: ThresholdDistribution, *, points: int = 801) -> Stability:
    """Compare the force law's slope with the stiffness around one contact."""
    modes = lattice_modes(slider)
    bulk = modes.weight.sum()
    edge = bulk + modes.reflection.sum()
    fall = force_law(thresholds, points=points).steepest_fall
    bulk, edge = (1 - bulk) / bulk, (1 - edge) / edge
    return Stability(fall, bulk, edge, fall > -jnp.minimum(bulk, edge))


@jax.custom_batching.sequential_vmap
def _solve(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Solve equations; of many one set after another, because jaxlib's elimination of a batch can wait for ever."""
    return jnp.linalg.solve(matrix, right)


def edge_loads(chain: Chain, stretch: Float[AnyArrayLike, " L"]) -> Float[Array, " L"]:
    """Compute the load for each stretch of the first contact, in u_s; NaN where Newton's method did not converge.

    The relaxed chain, with a force law, is followed as the stretch of its first contact grows, even where the load must
    decrease. The whole chain slides smoothly if and only if the load increases throughout. Where it decreases, a chain under
    increasing load jumps: an event begins. For tens of sites, since the matrix is dense; stretches increase from near zero, in
    steps much smaller than the width of the thresholds.
    """
    n = chain.sites
    pinning = jnp.zeros_like(chain.contact)

    def forces(free: Array, stretch: Array) -> Array:
        upper, layer = free[:n], jnp.append(stretch, free[n:])
        left = imbalance(chain, State(pinning, upper[0]), (upper, layer))
        return jnp.concatenate([left[0][1:], left[1]])

    def step(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        free, stretch, _, count = carry
        moved = -_solve(jax.jacfwd(forces)(free, stretch), forces(free, stretch))
        return free + moved, stretch, jnp.abs(moved).max(), count + 1

    def going(carry: tuple) -> Array:
        _, _, moved, count = carry
        return (moved > 1e-11) & (count < 50)

    def follow(free: Array, stretch: Array) -> tuple[Array, Array]:
        start = free, stretch, jnp.full_like(stretch, jnp.inf), jnp.zeros((), jnp.int32)
        free, _, moved, _ = lax.while_loop(going, step, start)
        return free, jnp.where(moved <= 1e-11, free[0], jnp.nan)

    return lax.scan(follow, jnp.zeros(2 * n - 1, chain.contact.dtype), jnp.asarray(stretch))[1]


def smooth_width(slider: Slider, kind: Kind, *, points: int = 801) -> float:
    """Find the smallest width of the distribution at which sliding is smooth.

    The result is inf if sliding is smooth at none. A hundred widths over the domain are tried.

    Not every wider law slides smoothly. A normal one, cut off at zero and at two, falls least steeply at a width near 0.5; as
    it grows wider it becomes a uniform one, which falls more steeply.
    """
    most = {"normal": 1.0, "uniform": 1 / np.sqrt(3), "weibull": 1.0}[kind]

    @jax.jit
    def margin(width: Array) -> Array:
        found = stability(slider, ThresholdDistribution(kind, width), points=points)
        return found.steepest_fall + jnp.minimum(found.surroundings, found.surroundings_at_edge)

    widths = most * np.arange(1, 101) / 100
    best = max(widths, key=lambda width: float(margin(jnp.asarray(width))))
    if margin(jnp.asarray(best)) <= 0:
        return float("inf")
    if margin(jnp.asarray(LEAST_WIDTH)) > 0:
        return LEAST_WIDTH
    return float(find_root(np.vectorize(lambda width: float(margin(jnp.asarray(width)))), (LEAST_WIDTH, best)).x)
