"""Ruptures, break by break, against numba loops, in one run.

The numba loop breaks the most overloaded contact and adds its response to all stresses in O(N), by the same 2×2 propagators
sent out from the broken site in both directions. It is given them and the stresses ready made, while the package's time
includes its response (computed once where lanes share a chain), both equilibria and the record of the rupture. *Breaks alone* is
the package's event given the same: the response and the stresses.

    python -m benchmarks cascade
"""

from functools import partial

import jax
import jax.numpy as jnp
import numba
import numpy as np

import slippulse_jax as sp
from benchmarks.timing import side_by_side
from slippulse_jax.bodies.chain import State, eliminate
from slippulse_jax.bodies.response import into_blocks, propagators, response
from slippulse_jax.bulk.compiler import compile_loops_whole, lane_by_lane
from slippulse_jax.events.event import event
from slippulse_jax.paper import FIG2

compile_loops_whole()
jax.config.update("jax_enable_x64", True)


@numba.njit(cache=False)
def events(P, Q, source, contact, threshold, stress, max_breaks):
    n = len(stress)
    t = stress.copy()
    order = np.empty(max_breaks, np.int64)
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
    return order[:breaks]


def order_of_breaks(stress, resp, chain):
    size = resp.push.shape[1]
    log = jnp.full(1001, -1, jnp.int32), jnp.zeros(1001), 0
    held, threshold = into_blocks(stress, size), into_blocks(chain.threshold, size, jnp.inf)
    return event(resp, held, threshold, limit=1000, log=log).record.order[:-1]


def ruptures(sizes=(300, 3000), lanes=(1, 64)):
    """Sites, lanes, breaks, and shortest times in s: of a rupture, of its breaks alone, and of numba's, the same breaks."""
    for n in sizes:
        c = sp.chain(FIG2, sites=n)
        links = [np.asarray(x) for x in jax.jit(propagators)(c, jax.jit(eliminate)(c, c.contact))[:3]]
        arrays = *links, np.asarray(c.contact), np.asarray(c.threshold)
        resp = jax.jit(lambda c: response(c, eliminate(c, c.contact)))(c)
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
            theirs = [events(*arrays, row, 1000) for row in rows]
            for expected, k, mine in zip(theirs, np.atleast_1d(found.breaks), np.atleast_2d(found.order), strict=True):
                np.testing.assert_array_equal(expected, mine[:k])
            taken = side_by_side(
                {
                    "ours": lambda run=run, given=given: jax.block_until_ready(run(given)),
                    "alone": lambda alone=alone, stress=stress: jax.block_until_ready(alone(stress)),
                    "theirs": lambda arrays=arrays, rows=rows: [events(*arrays, row, 1000) for row in rows],
                },
                100 if count == 1 else 10,
            )
            yield n, count, int(found.breaks.sum()), taken["ours"], taken["alone"], taken["theirs"]


def main():
    print(
        "| N | lanes | breaks | slippulse_jax, ms | breaks alone, ms | numba, ms | numba / slippulse_jax | numba / breaks alone |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for n, lanes, breaks, ours, alone, theirs in ruptures():
        cells = (
            n,
            lanes,
            breaks,
            *(f"{1e3 * t:.3g}" for t in (ours, alone, theirs)),
            f"{theirs / ours:.2f}",
            f"{theirs / alone:.2f}",
        )
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
