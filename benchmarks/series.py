"""10⁴ events at N = 2000, beside a numba event loop with the same O(N) update per break: python benchmarks/series.py."""

import argparse
import time

import jax
import numpy as np
from numba import njit

import slippulse_jax as sp
from slippulse_jax.lattice.response import dense, response


@njit(cache=True)
def event_loop(green, per_load, events):
    """One event after another: stresses held, a row of the response added per break."""
    n = len(per_load)
    stress, load = np.zeros(n), 0.0
    loads, breaks = np.zeros(events), np.zeros(events, np.int64)
    for e in range(events):
        site, rise = 0, np.inf
        for i in range(n):
            missing = (1 - stress[i]) / per_load[i]
            if missing < rise:
                site, rise = i, missing
        rise = max(rise, 0.0)
        load += rise
        for i in range(n):
            stress[i] += rise * per_load[i]
        going = True
        while going:
            t = stress[site]
            stress[site] = 0.0
            most = -np.inf
            here = site
            for i in range(n):
                stress[i] += green[here, i] * t
                if stress[i] > most:
                    most, site = stress[i], i
            breaks[e] += 1
            going = most >= 1
        loads[e] = load
    return loads, breaks


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--sites", type=int, default=2000)
    parser.add_argument("--events", type=int, default=10_000)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--batch-events", type=int, default=500)
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)

    def chain(height=25.0):
        return sp.chain(sp.Slider(height, 0.03, 0.3), sites=given.sites)

    def prepare(one):
        green = np.asarray(dense(response(one)))
        per_load = np.asarray(sp.equilibrium(one, sp.State(np.zeros(given.sites), np.asarray(1.0))).stress)
        return np.ascontiguousarray(green[: given.sites, : given.sites]), per_load

    def timed(work):
        work()
        times = []
        for _ in range(3):
            start = time.perf_counter()
            out = work()
            times.append(time.perf_counter() - start)
        return min(times), out

    green, per_load = prepare(chain())
    numba_s, (loads, breaks) = timed(lambda: event_loop(green, per_load, given.events))
    jax_s, got = timed(lambda: jax.block_until_ready(sp.series(chain(), events=given.events)))
    same = bool(np.array_equal(breaks, got.breaks))
    print(f"N = {given.sites}, {given.events} events, {breaks.sum()} breaks; same breaks in every event: {same}")
    print(f"numba {numba_s:.2f} s, JAX {jax_s:.2f} s: numba/JAX = {numba_s / jax_s:.2f}; drift {float(got.drift):.1e} σ_s")
    heights = np.linspace(20, 30, given.batch)
    prepared = [prepare(chain(h)) for h in heights[:4]]
    numba_s, _ = timed(lambda: [event_loop(*p, given.batch_events) for p in prepared])
    numba_s *= given.batch / len(prepared)
    batch = jax.jit(jax.vmap(lambda h: sp.series(chain(h), events=given.batch_events).load))
    jax_s, _ = timed(lambda: jax.block_until_ready(batch(heights)))
    print(f"batch of {given.batch}, {given.batch_events} events: numba (from 4) {numba_s:.2f} s, JAX {jax_s:.2f} s: "
          f"numba/JAX = {numba_s / jax_s:.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
