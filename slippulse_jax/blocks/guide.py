r"""Response of contacts that stay attached to a half-infinite uniform waveguide.

Columns of n freedoms x_0, x_1 … lie one λc apart. Between two of them is a slab with one contact, whose spring k holds their
mean along the interface, ⟨u⟩_i = w_l·x_i + w_r·x_{i+1} (and s times its own force), to a pinning point. A break only moves that
point, so the stiffness stays as it is. With the driving-point stiffness X of the half-infinite guide, Y = (X + D_11)⁻¹, and the
transfer T = −Y D_01ᵀ from column to column,

    q_0 = w_r,    q_{a+1} = (Tᵀ)^a (w_l + Tᵀ w_r),
    t_i = q_i·u_1,    A_ij = q_iᵀ G_1 q_j + Σ_{l=1}^{min(i,j)} q_{i−l}ᵀ Y q_{j−l} + s δ_ij,    R = k A:

stretches of the contacts are U t + (R − 1) u_b. Here i, j ≥ 1: what lies left of column 1, the pusher and contact 0, is
eliminated, and gives G_1, the response of column 1 to a force on itself, u_1, its displacement per load, and the row of
contact 0. The slider is the case n = 2; its columns are u_t and u.

A second reading of the same columns is the mean across the interface, ⟨u_y⟩, of which nothing but the pressure takes notice.

Slabs are made without the springs of the interface, which hold what the slabs read: the mean along it, and, if it gives way,
the nodes across it. Springs of softness C on readings of own response s pull by (C + s)⁻¹, and leave C (C + s)⁻¹ of each
reading. So the slab itself serves every stiffness of the contacts.

A guide of L slabs with a free end is the half-infinite one without what pulls at its column L, the stiffness X: a force
X (1 − G_L X)⁻¹ x_L on that column takes it away, x_L being its displacement in the half-infinite guide. So the end sends back
whatever arrives. A slab is its own mirror image, so what a force on column L does is seen in a mirror, S, as far as it travels
left: with X' = S X S and T' = S T S, column m moves by T'^{L−m} (X + X')⁻¹ until that meets the edge, of stiffness E, which
sends back T^{m−1} (X + E)⁻¹ (X' − E) times what arrives at column 1; G_L is the sum at column L.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from slippulse_jax.bodies.response import Response, of_matrix
from slippulse_jax.bulk.compiler import inverse_without_pivots

DOUBLINGS = 40
"""Most doublings of a slab; one of 2⁴⁰ contacts is as long as any decay."""


Along = tuple[int, ...]
"""Numbers of the freedoms of a column along the guide."""


Springs = tuple[Float[Array, "r r"], Float[Array, "s r"]]
"""Displacement of the springs of a slab per force, C; and what of their displacements is read once they are attached."""


class Slab(NamedTuple):
    """Stiffness between two columns, and how the interface beneath reads them."""

    left: Float[Array, "l l"]  # D_00; l = n freedoms, or one, the load
    across: Float[Array, "l n"]  # D_01
    right: Float[Array, "n n"]  # D_11
    reading_left: Float[Array, "r l"]  # w_l: along the interface, which the contact holds, and perhaps across it
    reading_right: Float[Array, "r n"]  # w_r
    own: Float[Array, "r r"]  # s, response of a contact within its slab


Edge = tuple[Slab, Float[Array, "n 1+r+n"]]
"""What lies left of column 1, the pusher and contact 0: the slab from the load, its left column of one freedom, to column 1.

And the displacements of column 0 per unit of the load, per force on what the slab reads, and per displacement of column 1.
"""


class End(NamedTuple):
    """A free end at column L, and responses to a force there."""

    length: Array  # L, the number of contacts before it
    back: Array  # (X⁻¹ − G_L)⁻¹, force that takes X away per displacement of column L
    pushed: Array  # that displacement per unit of the load
    mirrored: Array  # what it sends left from column L, seen in a mirror
    reflected: Array  # what of it the edge sends back from column 1
    first: Array  # displacement of column 1


class Guide(NamedTuple):
    """A waveguide pushed at column 0, in the quantities of this module."""

    edge: Slab  # from the load to column 1
    start: Float[Array, "n 2+n"]  # column 0 per unit of the load, of the pinning point of contact 0, and of column 1
    slab: Slab
    step: Array  # Y
    transfer: Array  # T
    free: Array  # G_1, column 1 per force on it
    pushed: Array  # u_1, column 1 per unit of the load
    end: End | None = None


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


@jax.custom_jvp
def inverse_of_definite(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Inverse of a symmetric positive definite matrix."""
    return inverse_without_pivots(matrix)


def _inverse_jvp(inverse: Callable[[Array], Array], primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    found = inverse(primals[0])
    return found, -found @ tangents[0] @ found


inverse.defjvp(partial(_inverse_jvp, inverse))
inverse_of_definite.defjvp(partial(_inverse_jvp, inverse_of_definite))


@jax.custom_jvp
def taken_away(X: Float[Array, "n n"], G: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """(X⁻¹ − G)⁻¹ of symmetric matrices, definite as their difference.

    Corrected once: X may be far stiffer across the guide than along it.
    """
    passed = X @ inverse_of_definite(X - X @ G @ X)
    found = passed @ X
    found = found + passed @ (X - found + X @ (G @ found))
    return (found + found.T) / 2


@taken_away.defjvp
def _taken_away_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (X, G), (dX, dG) = primals, tangents
    found = taken_away(X, G)
    share = jnp.eye(len(X), dtype=X.dtype) + G @ found  # X⁻¹ times what is found
    return found, share.T @ dX @ share + found @ dG @ found


def placed(slab: Slab, rows: Float[np.ndarray, "... s r"]) -> Slab:
    """A slab whose readings lie among those of several in a row."""
    own = rows @ slab.own @ jnp.swapaxes(rows, -1, -2)
    return slab._replace(reading_left=rows @ slab.reading_left, reading_right=rows @ slab.reading_right, own=own)


def doubled(slab: Slab, along: Along, rows: Float[np.ndarray, "2 s r"] | None = None) -> Slab:
    """Join two slabs in a row; readings coincide unless `rows` place them."""
    first, second = (slab, slab) if rows is None else (placed(slab, one) for one in rows)
    apart = Slab(
        slab.left, jnp.zeros_like(slab.across), slab.right, first.reading_left, second.reading_right, first.own + second.own
    )
    return joined(apart, slab.across, 2 * slab.left, first.reading_right + second.reading_left, along)


def joined(
    sides: Slab, toward: Float[Array, "n n"], middle: Float[Array, "n n"], read: Float[Array, "r n"], along: Along
) -> Slab:
    """Eliminate a slab's middle column; its outer `sides` take over the readings.

    A slab is its own mirror image: with S, 1 along the guide and −1 across it, D_11 = S D_00 S. So displacements of the middle
    along and across the guide do not act on each other: each half is inverted by itself. `toward` is the stiffness between the
    left column and the middle; of `middle` only what acts within either half is used; `read` is how the interface reads it.
    """
    parts, sign = _halves(along, len(toward))
    moved, halves = jnp.zeros_like(read), []
    for part in parts:
        between = inverse_of_definite(middle[part[:, None], part])
        halves.append(toward[:, part] @ between @ toward[:, part].T)
        moved = moved.at[:, part].set(read[:, part] @ between)
    left, across = sides.left - (halves[0] + halves[1]), sides.across * sign[None] + halves[1] - halves[0]
    left, across = (left + left.T) / 2, (across + across.T) / 2
    return Slab(
        left, across * sign[None], sign[:, None] * left * sign[None], sides.reading_left - moved @ toward.T,
        sides.reading_right - ((moved * sign[None]) @ toward.T) * sign[None], sides.own + read @ moved.T,
    )  # fmt: skip


def _halves(along: Along, n: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Numbers of the freedoms along the guide and across it, and S."""
    of_x = np.isin(np.arange(n), along)
    return [np.flatnonzero(of_x).astype(np.int32), np.flatnonzero(~of_x).astype(np.int32)], np.where(of_x, 1.0, -1.0)


def attached(slab: Slab, springs: Springs) -> tuple[Slab, Float[Array, "r r"]]:
    """Attach the springs of a slab, and return their stiffness there.

    Its readings are then those per displacement of what holds the springs.
    """
    softness, read = springs
    pull = inverse_of_definite(softness + slab.own)
    felt = read @ softness @ pull  # of 1 − own pull, which cancels where springs are stiff
    left, right = slab.reading_left, slab.reading_right
    return Slab(
        slab.left + left.T @ pull @ left,
        slab.across + left.T @ pull @ right,
        slab.right + right.T @ pull @ right,
        felt @ left,
        felt @ right,
        felt @ slab.own @ read.T,
    ), pull


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def driving_point(slab: Slab, along: Along) -> Float[Array, "n n"]:
    """X of the half-infinite guide, by doubling until no end is felt."""

    def felt(state: tuple[Slab, Int[Array, ""]]) -> Array:
        slabs, count = state
        return (jnp.abs(slabs.across).max() > jnp.finfo(slabs.left.dtype).eps * jnp.abs(slabs.left).max()) & (count < DOUBLINGS)

    def twice(state: tuple[Slab, Int[Array, ""]]) -> tuple[Slab, Int[Array, ""]]:
        slabs, count = state
        return doubled(slabs, along), count + 1

    unread = 0 * slab.reading_left
    return lax.while_loop(felt, twice, (slab._replace(reading_left=unread, reading_right=unread), jnp.int32(0)))[0].left


@driving_point.defjvp
def _driving_point_jvp(along: Along, primals: tuple[Slab], tangents: tuple[Slab]) -> tuple[Array, Array]:
    """One slab more changes nothing: dX = F + Tᵀ dX T."""
    (slab,), (change,) = primals, tangents
    X = driving_point(slab, along)
    T = -inverse_of_definite(X + slab.right) @ slab.across.T
    across = change.across @ T
    F = change.left + across + across.T + T.T @ change.right @ T
    return X, _by_doubling(T, F, lambda power, sum: power.T @ sum @ power)


def _by_doubling(T: Float[Array, "n n"], first: Array, carried: Callable[[Array, Array], Array]) -> Array:
    """Sum over m of what T^m carries on, by doubling."""

    def summed(T: Float[Array, "n n"], first: Array) -> Array:
        return lax.while_loop(felt, twice, (T, first, jnp.int32(0)))[1]

    def felt(state: tuple[Array, Array, Array]) -> Array:
        power, _, count = state
        return (jnp.abs(power).max() > jnp.finfo(power.dtype).eps) & (count < DOUBLINGS)

    def twice(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        power, total, count = state
        return power @ power, total + carried(power, total), count + 1

    return lax.custom_linear_solve(
        lambda sum: sum - carried(T, sum), first, lambda _, x: summed(T, x), lambda _, x: summed(T.T, x)
    )


def edge(layers: Slab, displaced: Float[Array, " n"], force: Float[Array, " n"]) -> Edge:
    """Eliminate what lies left of column 1, except springs of contact 0.

    The `layers` lie over contact 0 from the pusher on, along a leading axis; `displaced` is 1 for the freedoms of column 0 that
    move with the pusher, and `force` that on the others per unit of the load.
    """
    readings, n = layers.reading_left.shape[1:]
    none = jnp.zeros((n, n), force.dtype)
    begin = Slab(none[:1, :1], -force[None], none, none[:readings, :1], none[:readings], none[:readings, :readings])

    def pass_layer(so_far: tuple[Slab, Array, Array], layer: Slab) -> tuple[tuple[Slab, Array, Array], None]:
        behind, start, held = so_far
        keep, reading = 1 - held, behind.reading_right + layer.reading_left
        # freedoms that the pusher displaces are cut out, and held at one instead
        inner = keep[:, None] * (behind.right + layer.left) * keep[None] + jnp.diag(held)
        free = keep[:, None] * inverse_of_definite(inner) * keep[None]
        load, read = -behind.across[0] - layer.left @ held, reading @ free
        moved, back = held + free @ load, free @ layer.across
        stiffness = layer.right - layer.across.T @ back
        found = Slab(
            left=behind.left + held @ layer.left @ held - load @ free @ load,
            across=(moved @ layer.across)[None],
            right=(stiffness + stiffness.T) / 2,  # what rounding leaves beside would grow from layer to layer
            reading_left=behind.reading_left + (reading @ moved)[:, None],
            reading_right=layer.reading_right - reading @ back,
            own=behind.own + layer.own + read @ reading.T,
        )
        before, follow = jnp.split(start, [1 + readings], 1)
        start = (follow @ jnp.column_stack([moved, read.T, -back])).at[:, : 1 + readings].add(before)
        return (found, start, 0 * held), None

    start = jnp.eye(n, 1 + readings + n, 1 + readings, dtype=force.dtype)
    return lax.scan(pass_layer, (begin, start, displaced), layers)[0][:2]


def guide(
    edge: Edge, slab: Slab, springs: tuple[Springs, Springs], along: Along, length: Int[Array, ""] | None = None
) -> Guide:
    """Guide of a slab on contacts, half-infinite or with a free end.

    It ends after `length` slabs, two or more. Edge and slab are without springs. Freedoms not `along` the guide are across it.
    """
    (bare, start), slab = edge, attached(slab, springs[1])[0]
    at_edge, pull = attached(bare, springs[0])
    per_load, per_force, per_column = jnp.split(start, [1, 1 + len(pull)], 1)
    per_force = per_force @ pull
    start = jnp.concatenate(
        [per_load - per_force @ bare.reading_left, per_force[:, :1], per_column - per_force @ bare.reading_right], axis=1
    )
    X = driving_point(slab, along)
    step, free = inverse_of_definite(X + slab.right), inverse_of_definite(X + at_edge.right)
    found = Guide(at_edge, start, slab, step, -step @ slab.across.T, free, -free @ at_edge.across[0])
    if length is None:
        return found
    length, mirror = jnp.asarray(length), jnp.asarray(_halves(along, len(X))[1])
    reflected_in = mirror[:, None] * X * mirror[None]
    far = _power(found.transfer, length - 1)
    sent = inverse_of_definite(X + reflected_in)
    arriving = mirror[:, None] * (far @ (mirror[:, None] * sent))
    reflected = free @ ((reflected_in - at_edge.right) @ arriving)
    felt = sent + far @ reflected
    back = taken_away(X, (felt + felt.T) / 2)
    end = End(length, back, far @ found.pushed, mirror[:, None] * sent, reflected, arriving + reflected)
    return found._replace(end=end)


def _power(T: Float[Array, "n n"], exponent: Int[Array, ""]) -> Float[Array, "n n"]:
    """T^m of a whole number m, by squaring."""

    def square(bits: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        power, found = state
        return power @ power, jnp.where(bits % 2 == 1, power @ found, found)

    every = exponent >> jnp.arange(jnp.iinfo(exponent.dtype).bits - 1, dtype=exponent.dtype)
    begin = T, jnp.eye(len(T), dtype=T.dtype)
    return lax.scan(lambda x, bits: (lax.cond(bits > 0, square, lambda _, x: x, bits, x), None), begin, every)[0][1]


@jax.custom_jvp
def _carried(T: Float[Array, "n n"], given: Float[Array, "N r n"]) -> Float[Array, "N r n"]:
    """Rows that T carries from column to column, adding what is `given`."""
    return lax.scan(lambda q, here: ((after := q @ T + here), after), jnp.zeros_like(given[0]), given)[1]


@_carried.defjvp
def _carried_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    """Differentiate by one product for all columns, in reverse mode too."""
    T, found = primals[0], _carried(*primals)
    return found, _carried(T, tangents[1].at[1:].add(found[:-1] @ tangents[0]))


def compliance(
    guide: Guide, sites: int, read: int = 1, sources: int = 1
) -> tuple[Float[Array, "N s r N"], Float[Array, "r N"]]:
    """A and t of the first `sites` contacts, in O(sites² n).

    A, of shape (sites, sources, read, sites), is the reading per force, that of the source first; t the reading per load. With
    so many of the readings, and of those along which forces act. On one that ends, `sites` cover all; both are 0 beyond.
    """
    slab, T = guide.slab, guide.transfer
    first = slab.reading_left + slab.reading_right @ T
    q = _carried(T, jnp.zeros((sites - 1, *first.shape), T.dtype).at[0].set(first))
    q = jnp.concatenate([slab.reading_right[None], q])[:, :read]  # q_0 … q_{N−1}
    none = jnp.zeros_like(q[:1])
    behind, ahead = jnp.concatenate([none, q[:-1]]), jnp.concatenate([none, q[1:]])

    def between(matrix: Array, at: Float[Array, "N r n"]) -> Float[Array, "N s r N"]:
        acting, felt = at[:, :sources] @ matrix, jnp.moveaxis(at, 1, 0)
        found = acting.reshape(-1, len(matrix)) @ felt.reshape(-1, len(matrix)).T
        return found.reshape(*acting.shape[:2], *felt.shape[:2])

    # sums along the diagonals: each row adds the one above, shifted by a contact
    rows = between(guide.step, behind)
    direct = lax.scan(lambda above, row: (jnp.pad(row + above, ((0, 0), (0, 0), (1, 0)))[..., :-1], row + above),
                      jnp.zeros_like(rows[0]), rows)[1]  # fmt: skip
    site = jnp.arange(sites)
    A = (direct + between(guide.free, ahead)).at[site, :, :, site].add(slab.own[None, :sources, :read])
    # contact 0 on itself, on the others, and they on it
    own, reading = guide.edge.own[:sources, :read], guide.edge.reading_right[:read]
    from_next = reading @ guide.free
    onto, back = jnp.einsum("sm,jrm->srj", from_next[:sources], ahead), jnp.einsum("rm,ism->isr", from_next, ahead[:, :sources])
    A = A.at[0].set(onto).at[..., 0].set(back).at[0, ..., 0].set(from_next[:sources] @ reading.T + own)
    t = (ahead @ guide.pushed).T.at[:, 0].set(reading @ guide.pushed + guide.edge.reading_left[:read, 0])
    if guide.end is None:
        return A, t
    # the reading of each contact per force on the last column; of displacements across, a mirror changes the sign
    length, signs = guide.end.length, np.array([[1.0], [-1.0]])[:read]
    distance = length - site.astype(length.dtype)
    arriving = jnp.where((distance > 0)[:, None, None], q[jnp.clip(distance, 0, sites - 1)], 0) * signs[None]
    reached = arriving @ guide.end.mirrored + q @ guide.end.reflected
    reached = reached.at[0].set(reading @ guide.end.first)
    there = (distance > 0).astype(q.dtype)
    both = there[:, None, None, None] * there[None, None, None]
    A, t = A + between(guide.end.back, reached), t + (reached @ (guide.end.back @ guide.end.pushed)).T
    return A * both, t * there[None]


def held_by_all(guide: Guide, t: Float[Array, "r N"]) -> Array:
    """Sum of t over all contacts, beyond those resolved too."""
    if guide.end is not None:
        return t[0].sum()
    slab, T = guide.slab, guide.transfer
    first = slab.reading_left[0] + slab.reading_right[0] @ T
    return t[0, 0] + first @ _by_doubling(T, guide.pushed, jnp.dot)


def response(guide: Guide, contact: Array, sites: int, relief: Array | None = None) -> Response:
    """Response of the first `sites` contacts of stiffness `contact`, in K.

    With `relief`, the pressure that a contact loses per displacement across it, that of their pressure too.
    """
    readings = 1 if relief is None else 2
    A, t = compliance(guide, sites, readings)
    sign = jnp.ones((1, 1), A.dtype) if relief is None else jnp.stack([jnp.ones_like(relief), -relief])[:, None]
    return of_matrix(contact * A[:, 0] * sign[None], t * sign, contact * held_by_all(guide, t))


def columns(guide: Guide, contact: Array, load: Array, pinning: Float[Array, " N"]) -> Float[Array, "N+1 n"]:
    """Displacements of columns 0 … N, given load and N pinning points.

    Those of the first N contacts; of a guide that ends, of all.
    """
    edge, slab, T = guide.edge, guide.slab, guide.transfer
    left, right = (jnp.outer(pinning[1:], x[0]) for x in (slab.reading_left, slab.reading_right))
    force = jnp.pad(left, ((0, 1), (0, 0))) + jnp.pad(right, ((1, 0), (0, 0)))
    force = contact * force.at[0].add(pinning[0] * edge.reading_right[0])

    def under(load: Array, force: Float[Array, "N n"]) -> Float[Array, "N n"]:
        arriving = lax.scan(lambda g, f: (f + g @ T, f + g @ T), jnp.zeros_like(force[0]), force, reverse=True)[1]
        first = guide.pushed * load + guide.free @ arriving[0]
        rest = lax.scan(lambda x, g: ((y := T @ x + guide.step @ g), y), first, arriving[1:])[1]
        return jnp.concatenate([first[None], rest])

    found = under(load, force)
    if guide.end is not None:
        last = guide.end.length - 1
        found = found + under(0 * load, jnp.zeros_like(force).at[last].set(guide.end.back @ found[last]))
    # column 0 follows the load, contact 0 and column 1
    first = guide.start @ jnp.concatenate([jnp.stack([load, pinning[0]]), found[0]])
    return jnp.concatenate([first[None], found])
