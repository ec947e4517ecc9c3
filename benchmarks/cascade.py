"""Ruptures, break by break, against numba loops, in one run.

The numba loop breaks the most overloaded contact and adds its response to all stresses in O(N), by the same 2×2 propagators
sent out from the broken site in both directions. *numba, whole* begins with the springs of the chain as the package does:
elimination, propagators, the equilibrium before the rupture, and the one after it as a check. *numba, breaks* is given
propagators and stresses ready made, and *breaks alone* is the package's event given its response and the stresses.

    python -m benchmarks cascade [sites …, 300 and 3000 by default]
"""

import sys
from functools import partial

import jax
import jax.numpy as jnp
import numba
import numpy as np

import slippulse_jax as sp
from benchmarks.timing import side_by_side
from slippulse_jax.bodies.chain import State, eliminate
from slippulse_jax.bodies.response import of_chain
from slippulse_jax.bulk.compiler import compile_loops_whole, lane_by_lane
from slippulse_jax.events.event import event
from slippulse_jax.paper import FIG2

SMALLEST = "100"
SITES = 300, 3000

compile_loops_whole()
jax.config.update("jax_enable_x64", True)


@numba.njit(cache=False)
def events(P, Q, source, contact, threshold, stress, max_breaks):
    n = len(stress)
    t = stress.copy()
    order, released = np.empty(max_breaks, np.int64), np.zeros(n)
    breaks = 0
    while breaks < max_breaks:
        j, worst = 0, t[0] - threshold[0]
        for i in range(1, n):
            over = t[i] - threshold[i]
            if over > worst:
                j, worst = i, over
        if worst < 0:
            break
        give = t[j]
        t[j] = 0.0
        released[j] += give
        a, b = source[j, 0] * give, source[j, 1] * give
        t[j] += contact[j] * b
        x, y = a, b
        for i in range(j, n - 1):
            x, y = P[i, 0, 0] * x + P[i, 0, 1] * y, P[i, 1, 0] * x + P[i, 1, 1] * y
            t[i + 1] += contact[i + 1] * y
        x, y = a, b
        for i in range(j, 0, -1):
            x, y = Q[i, 0, 0] * x + Q[i, 0, 1] * y, Q[i, 1, 0] * x + Q[i, 1, 1] * y
            t[i - 1] += contact[i - 1] * y
        order[breaks] = j
        breaks += 1
    return order[:breaks], released


@numba.njit(cache=False, inline="always")
def transfer(u, w, x, B, K, out):
    """Displacements of a site held by three springs per displacement beyond a bond of each layer; the bond's springs included."""
    det = u * w + x * (u + w)
    out[0, 0], out[0, 1] = (w + x) * B / det, x * K / det
    out[1, 0], out[1, 1] = x * B / det, (u + x) * K / det


@numba.njit(cache=False, inline="always")
def through(far_u, far_l, far_x, B, K):
    """Three springs that stand for those beyond a bond of each layer, in series with it."""
    u, w, x = B + far_u, K + far_l, far_x
    det = u * w + x * (u + w)
    return B * ((w + x) * far_u + x * far_l) / det, K * ((u + x) * far_l + x * far_u) / det, B * K * x / det


@numba.njit(cache=False)
def whole(upper, layer, across, contact, end, threshold, k, load, max_breaks):
    """A rupture from the springs of a chain that is relaxed: sites in order, stresses when it is over, propagators."""
    n = len(contact)
    right, P, Q, source = np.empty((n, 3)), np.zeros((n, 2, 2)), np.zeros((n, 2, 2)), np.empty((n, 2))
    right[n - 1] = end
    for i in range(n - 1, 0, -1):
        B, K = upper[i - 1], layer[i - 1]
        u, w, x = right[i, 0], right[i, 1] + contact[i], right[i, 2] + across[i]
        transfer(B + u, K + w, x, B, K, P[i - 1])
        right[i - 1] = through(u, w, x, B, K)
    ground = across[0] + contact[0]
    share = layer[0] / (layer[0] + ground)
    u, w, x = upper[0], share * ground, 0.0
    Q[1, 1, 1] = share
    for i in range(1, n):
        a, b, c = u + right[i, 0], w + right[i, 1] + contact[i], x + right[i, 2] + across[i]
        det = a * b + c * (a + b)
        source[i, 0], source[i, 1] = c / det, (a + c) / det
        if i < n - 1:
            w, x = w + contact[i], x + across[i]
            transfer(u + upper[i], w + layer[i], x, upper[i], layer[i], Q[i + 1])
            u, w, x = through(u, w, x, upper[i], layer[i])
    source[0] = 0.0, 1 / (right[0, 1] + right[0, 2] + ground)
    stress, moved = np.empty(n), np.empty((n, 2))
    moved[0] = load, (right[0, 2] + across[0]) * source[0, 1] * load
    for i in range(n - 1):
        moved[i + 1, 0] = P[i, 0, 0] * moved[i, 0] + P[i, 0, 1] * moved[i, 1]
        moved[i + 1, 1] = P[i, 1, 0] * moved[i, 0] + P[i, 1, 1] * moved[i, 1]
    for i in range(n):
        stress[i] = contact[i] / k * moved[i, 1]
    order, released = events(P, Q, source, contact, threshold, stress, max_breaks)
    a = b = 0.0  # what arrives from the left, and then from the right
    for i in range(n):
        own = k * released[i]
        moved[i, 1] += b + source[i, 1] * own
        a, b = a + source[i, 0] * own, b + source[i, 1] * own
        a, b = P[i, 0, 0] * a + P[i, 0, 1] * b, P[i, 1, 0] * a + P[i, 1, 1] * b
    a = b = 0.0
    for i in range(n - 1, -1, -1):
        own = k * released[i]
        moved[i, 1] += b
        a, b = a + source[i, 0] * own, b + source[i, 1] * own
        a, b = Q[i, 0, 0] * a + Q[i, 0, 1] * b, Q[i, 1, 0] * a + Q[i, 1, 1] * b
        stress[i] = contact[i] / k * moved[i, 1] - released[i]
    return order, stress, (P, Q, source)


def order_of_breaks(stress, resp, chain):
    log = jnp.full(1001, -1, jnp.int32), jnp.zeros(1001), 0
    return event(resp, stress[None], chain.threshold, limit=1000, log=log).order[:-1]


def ruptures(sizes=SITES, lanes=(1, 64)):
    """Sites, lanes, breaks, and shortest times in s: of a rupture and of its breaks alone, by this package and by numba."""
    for n in sizes:
        c = sp.chain(FIG2, sites=n)
        springs = [np.asarray(x) for x in (c.upper, c.layer, c.across, c.contact, np.stack(c.end), c.threshold)]
        every = partial(whole, *springs, float(c.stiffness))
        arrays = *every(0.0, 1)[2], np.asarray(c.contact), np.asarray(c.threshold)
        resp = jax.jit(lambda c: of_chain(c, eliminate(c, c.contact)))(c)
        for count in lanes:
            loads = jnp.linspace(6.0, 8.0, count) if count > 1 else jnp.array([6.0])
            one = lambda load, c=c, n=n: sp.rupture(c, State(jnp.zeros(n), load), max_breaks=1000)  # noqa: E731
            breaks = partial(order_of_breaks, resp=resp, chain=c)
            run = jax.jit(one if count == 1 else jax.vmap(one))
            alone = jax.jit(breaks if count == 1 else jax.vmap(partial(lane_by_lane, breaks)))
            given = loads[0] if count == 1 else loads
            found = jax.block_until_ready(run(given))
            stresses = jax.vmap(lambda u, c=c, n=n: sp.equilibrium(c, State(jnp.zeros(n), u)).stress)(loads)
            stress = stresses[0] if count == 1 else stresses
            np.testing.assert_array_equal(alone(stress), found.order)
            rows = np.asarray(stresses)
            after, numbers = np.atleast_2d(found.after.stress), np.asarray(loads)
            for load, row, k, mine, left in zip(
                loads, rows, np.atleast_1d(found.breaks), np.atleast_2d(found.order), after, strict=True
            ):
                order, in_balance, _ = every(float(load), 1000)
                np.testing.assert_array_equal(order, mine[:k])
                np.testing.assert_array_equal(events(*arrays, row, 1000)[0], order)
                np.testing.assert_allclose(in_balance, left, atol=1e-11)
            taken = side_by_side(
                {
                    "ours": lambda run=run, given=given: jax.block_until_ready(run(given)),
                    "alone": lambda alone=alone, stress=stress: jax.block_until_ready(alone(stress)),
                    "whole": lambda every=every, loads=numbers: [every(load, 1000) for load in loads],
                    "breaks": lambda arrays=arrays, rows=rows: [events(*arrays, row, 1000) for row in rows],
                },
                100 if count == 1 else 10,
            )
            yield n, count, int(found.breaks.sum()), taken["ours"], taken["alone"], taken["whole"], taken["breaks"]


def main(sizes):
    print(
        "| N | lanes | breaks | whole, ms | numba, whole, ms | breaks alone, ms | numba, breaks, ms | numba / whole | numba / breaks |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for n, lanes, breaks, ours, alone, whole, theirs in ruptures(sizes):
        times = (f"{1e3 * t:.3g}" for t in (ours, whole, alone, theirs))
        cells = n, lanes, breaks, *times, f"{whole / ours:.2f}", f"{theirs / alone:.2f}"
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main([int(x) for x in sys.argv[1:]] or SITES)
