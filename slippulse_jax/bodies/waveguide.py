r"""A half-infinite uniform waveguide on contacts that are attached at all times: what pinning points and the push do to them.

Columns of n freedoms x_0, x_1 … lie one λc apart. Between two of them is a slab with one contact, whose spring k holds their
mean along the interface, ⟨u⟩_i = w_l·x_i + w_r·x_{i+1} (and s times its own force), to a pinning point. A break only moves that
point, so the stiffness stays as it is. With the driving-point stiffness X of the half-infinite guide, Y = (X + D_11)⁻¹, the
transfer T = −Y D_01ᵀ from column to column, and Y_0, the inverse of X on what the pusher leaves free,

    q_0 = w_r,    q_{a+1} = (Tᵀ)^a (w_l + Tᵀ w_r),
    t_i = q_{i+1}·u_0,    A_ij = q_{i+1}ᵀ Y_0 q_{j+1} + Σ_{l=1}^{min(i,j)+1} q_{i+1−l}ᵀ Y q_{j+1−l} + s δ_ij,    R = k A:

stretches of the contacts are U t + (R − 1) u_b. The slider is the case n = 2; its columns are u_t and u.

A guide of L slabs with a free end is the half-infinite one without what pulls at its column L, the stiffness X. With
G_L = Σ_{m<L} T^m Y (Tᵀ)^m + T^L Y_0 (Tᵀ)^L, the response of that column to a force on itself, a force X (1 − G_L X)⁻¹ x_L on it
takes X away, x_L being its displacement in the half-infinite guide: so the end sends back whatever arrives.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.bodies.response import Response, of_matrix
from slippulse_jax.bulk.compiler import in_full

DOUBLINGS = 40
"""Most doublings of a slab; one of 2⁴⁰ contacts is as long as any decay."""


class Slab(NamedTuple):
    """Stiffness between two columns, and how the interface beneath reads them; symmetric in all but its ends."""

    left: Float[Array, "n n"]  # D_00
    across: Float[Array, "n n"]  # D_01
    right: Float[Array, "n n"]  # D_11
    reading_left: Float[Array, " n"]  # w_l
    reading_right: Float[Array, " n"]  # w_r
    own: Float[Array, ""]  # s, response of a contact within its slab


class Guide(NamedTuple):
    """A waveguide that is pushed at column 0, in the quantities of this module."""

    slab: Slab
    step: Array  # Y
    transfer: Array  # T
    free: Array  # Y_0
    pushed: Array  # u_0, column 0 per unit of the load
    # of a free end: L, the number of contacts before it, and X (1 − G_L X)⁻¹, force on column L per its displacement in the
    # half-infinite guide
    end: tuple[Array, Array] | None = None


@jax.custom_batching.sequential_vmap
def _one_after_another(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    return jnp.linalg.inv(matrix)


@jax.custom_jvp
def inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Inverse of a matrix; of many on a CPU one after another.

    There jaxlib's elimination of a batch waits, within a thread of XLA's pool, for others of the same pool: two batches at once
    were seen to wait for each other for ever, in one program on two cores.
    """
    return lax.platform_dependent(matrix, cpu=_one_after_another, default=jnp.linalg.inv)


@inverse.defjvp
@in_full
def _inverse_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    found = inverse(primals[0])
    return found, -found @ tangents[0] @ found


@in_full
def joined_slabs(a: Slab, b: Slab) -> Slab:
    """Join two slabs in a row; readings of the column between them are passed on to the outer columns."""
    between, read = inverse(a.right + b.left), a.reading_right + b.reading_left
    moved = between @ read
    left, right = a.left - a.across @ between @ a.across.T, b.right - b.across.T @ between @ b.across
    return Slab(
        (left + left.T) / 2, -a.across @ between @ b.across, (right + right.T) / 2,
        a.reading_left - a.across @ moved, b.reading_right - b.across.T @ moved, a.own + b.own + read @ moved,
    )  # fmt: skip


def attached(slab: Slab, contact: Array) -> Slab:
    """Attach the contact of a slab, of stiffness k; its readings are then those per displacement of the pinning point."""
    share = 1 / (1 + contact * slab.own)
    left, right, k = slab.reading_left, slab.reading_right, contact * share
    return Slab(
        slab.left + k * jnp.outer(left, left),
        slab.across + k * jnp.outer(left, right),
        slab.right + k * jnp.outer(right, right),
        share * left, share * right, share * slab.own,
    )  # fmt: skip


@jax.custom_jvp
def driving_point(slab: Slab) -> Float[Array, "n n"]:
    """X of the half-infinite guide: twice as many slabs each time, until the far end is not felt."""

    def felt(state: tuple[Slab, Int[Array, ""]]) -> Array:
        slabs, count = state
        return (jnp.abs(slabs.across).max() > jnp.finfo(slabs.left.dtype).eps * jnp.abs(slabs.left).max()) & (count < DOUBLINGS)

    def twice(state: tuple[Slab, Int[Array, ""]]) -> tuple[Slab, Int[Array, ""]]:
        slabs, count = state
        return joined_slabs(slabs, slabs), count + 1

    unread = 0 * slab.reading_left
    return lax.while_loop(felt, twice, (slab._replace(reading_left=unread, reading_right=unread), jnp.int32(0)))[0].left


@driving_point.defjvp
@in_full
def _driving_point_jvp(primals: tuple[Slab], tangents: tuple[Slab]) -> tuple[Array, Array]:
    """One slab more changes nothing: dX = F + Tᵀ dX T, F from the change of that slab. The sum of (Tᵀ)^m F T^m, by doubling."""
    (slab,), (change,) = primals, tangents
    X = driving_point(slab)
    T = -inverse(X + slab.right) @ slab.across.T
    across = change.across @ T
    F = change.left + across + across.T + T.T @ change.right @ T

    def felt(state: tuple[Array, Array, Array]) -> Array:
        power, _, count = state
        return (jnp.abs(power).max() > jnp.finfo(power.dtype).eps) & (count < DOUBLINGS)

    def twice(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        power, total, count = state
        return power @ power, total + power.T @ total @ power, count + 1

    return X, lax.while_loop(felt, twice, (T, F, jnp.int32(0)))[1]


@in_full
def guide(slab: Slab, displaced: Float[Array, " n"], force: Float[Array, " n"], length: Int[Array, ""] | None = None) -> Guide:
    """The guide of a slab with its contact attached; half-infinite, or of `length` slabs with a free end.

    Parameters
    ----------
    slab : Slab
    displaced : array, shape (n,)
        1 for the freedoms of column 0 that move with the pusher.
    force : array, shape (n,)
        Force on the others per unit of the load.
    length : int, optional
    """
    X = driving_point(slab)
    step = inverse(X + slab.right)
    keep = 1 - displaced
    # freedoms that the pusher displaces are cut out, and held at one instead
    inner = keep[:, None] * X * keep[None] + jnp.diag(displaced)
    free = keep[:, None] * inverse(inner) * keep[None]
    pushed = displaced + free @ (force - X @ displaced)
    found = Guide(slab, step, -step @ slab.across.T, free, pushed)
    if length is None:
        return found
    back = X @ inverse(jnp.eye(X.shape[0], dtype=X.dtype) - _column_response(found, jnp.asarray(length)) @ X)
    return found._replace(end=(jnp.asarray(length), (back + back.T) / 2))


def _column_response(guide: Guide, column: Int[Array, ""]) -> Float[Array, "n n"]:
    """G_L of one column of the half-infinite guide, by doubling: as many columns at a time as the bits of L say."""

    def twice(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        bits, T, steps, G = state  # T^m, G of m columns whose first is held, and G of the columns so far
        G = jnp.where(bits % 2 == 1, steps + T @ G @ T.T, G)
        return bits // 2, T @ T, steps + T @ steps @ T.T, G

    return lax.while_loop(lambda state: state[0] > 0, twice, (column, guide.transfer, guide.step, guide.free))[-1]


@in_full
def readings(guide: Guide, sites: int) -> Float[Array, "N+1 n"]:
    """q_0 … q_N."""
    slab, T = guide.slab, guide.transfer
    first = slab.reading_left + slab.reading_right @ T
    rest = lax.scan(lambda q, _: (q @ T, q), first, length=sites)[1]
    return jnp.concatenate([slab.reading_right[None], rest])


@in_full
def response(guide: Guide, contact: Array, sites: int) -> Response:
    """Response of the first `sites` contacts, in O(sites² n); of a guide that ends, of at least all, and nothing beyond."""
    slab, T, q = guide.slab, guide.transfer, readings(guide, sites)
    behind, ahead = q[:-1], q[1:]
    # sums along the diagonals: each row adds the one above, shifted by a contact
    direct = lax.scan(lambda above, row: (jnp.pad(row + above, (1, 0))[:-1], row + above), jnp.zeros_like(q[1:, 0]),
                      behind @ guide.step @ behind.T)[1]  # fmt: skip
    A = ahead @ guide.free @ ahead.T + direct + slab.own * jnp.eye(sites, dtype=q.dtype)
    t = ahead @ guide.pushed
    if guide.end is None:
        # the pusher carries all contacts, beyond those of the response too
        every = ahead[0] @ inverse(jnp.eye(T.shape[0], dtype=T.dtype) - T) @ guide.pushed
        return of_matrix(contact * A, t, contact * every)
    length, back = guide.end
    pushed, reached = _at_column(guide, length, q)
    there = jnp.arange(sites, dtype=length.dtype) < length
    t = jnp.where(there, t + reached @ back @ pushed, 0)
    A = jnp.where(there[:, None] & there[None], A + reached @ back @ reached.T, 0)
    return of_matrix(contact * A, t, contact * t.sum())


def _at_column(guide: Guide, column: Int[Array, ""], q: Float[Array, "N+1 n"]) -> tuple[Array, Float[Array, "N n"]]:
    """Displacements of one column in the half-infinite guide: per load, and per force on the contacts before it."""
    T, one, sites = guide.transfer, jnp.eye(q.shape[1], dtype=q.dtype), jnp.arange(q.shape[0] - 1, dtype=column.dtype)

    def beside(state: tuple[Array, Array], ahead: Array) -> tuple[tuple[Array, Array], Array]:
        power, direct = state  # T^i, and G_i q_1 but for its last term
        found = guide.step @ q[0] + T @ (direct + power @ (guide.free @ ahead))
        return (power @ T, direct + power @ (guide.step @ ahead)), found

    next_to = lax.scan(beside, (one, jnp.zeros_like(q[0])), q[1:])[1]  # column i + 1 per force on contact i

    def on(power: Array, distance: Array) -> tuple[Array, tuple[Array, Array]]:
        return power @ T, (power @ next_to[column - 1 - distance], power @ guide.pushed)

    far, pushed = lax.scan(on, one, sites)[1]
    return T @ pushed[column - 1], jnp.where((sites < column)[:, None], far[column - 1 - sites], 0)


@in_full
def columns(guide: Guide, contact: Array, load: Array, pinning: Float[Array, " N"]) -> Float[Array, "N+1 n"]:
    """Displacements of columns 0 … N under a load and pinning points of the first N contacts; of a guide that ends, of all."""
    slab, T = guide.slab, guide.transfer
    force = jnp.outer(jnp.pad(pinning, (0, 1)), slab.reading_left) + jnp.outer(jnp.pad(pinning, (1, 0)), slab.reading_right)

    def under(load: Array, force: Float[Array, "N+1 n"]) -> Float[Array, "N+1 n"]:
        arriving = lax.scan(lambda g, f: (f + g @ T, f + g @ T), jnp.zeros_like(force[0]), force, reverse=True)[1]
        first = guide.pushed * load + guide.free @ arriving[0]
        rest = lax.scan(lambda x, g: ((y := T @ x + guide.step @ g), y), first, arriving[1:])[1]
        return jnp.concatenate([first[None], rest])

    found = under(load, contact * force)
    if guide.end is None:
        return found
    length, back = guide.end
    return found + under(0 * load, jnp.zeros_like(force).at[length].set(back @ found[length]))
