"""10⁴ events at N = 2000, beside a numba event loop with the same O(N) update per break: python -m benchmarks.series."""

import argparse
import os
import time
from concurrent.futures import ThreadPoolExecutor

import jax
import numba
import numpy as np
from numba import njit, prange

import slippulse_jax as sp
from slippulse_jax.lattice.chain import State
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


@njit(parallel=True, cache=True)
def event_loops(greens, per_loads, events):
    """Chains side by side, on all cores."""
    breaks = np.zeros((len(greens), events), np.int64)
    for i in prange(len(greens)):
        breaks[i] = event_loop(greens[i], per_loads[i], events)[1]
    return breaks


def best_of(work, times=3):
    """Seconds and result; compiled before."""
    out, seconds = work(), []
    for _ in range(times):
        start = time.perf_counter()
        out = work()
        seconds.append(time.perf_counter() - start)
    return min(seconds), out


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--sites", type=int, default=2000)
    parser.add_argument("--events", type=int, default=10_000)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--batch-events", type=int, default=500)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    numba.set_num_threads(given.threads)

    def chain(height=25.0):
        return sp.chain(sp.Slider(height, 0.03, 0.3), sites=given.sites)

    responses = jax.jit(lambda height: dense(response(chain(height)))[: given.sites, : given.sites])

    def prepare(height):
        state = State(np.zeros(given.sites), np.asarray(1.0))
        return np.asarray(responses(height)), np.asarray(sp.equilibrium(chain(height), state).stress)

    green, per_load = prepare(25.0)
    numba_s, (_, breaks) = best_of(lambda: event_loop(green, per_load, given.events))
    one = jax.jit(lambda: sp.series(chain(), events=given.events))
    jax_s, got = best_of(lambda: jax.block_until_ready(one()))
    print(f"N = {given.sites}, {given.events} events, {breaks.sum()} breaks; the same in every event: "
          f"{np.array_equal(breaks, got.breaks)}; drift {float(got.drift):.1e} σ_s")  # fmt: skip
    print(f"one chain, one core: numba {numba_s:.4f} s, JAX {jax_s:.4f} s: numba/JAX = {numba_s / jax_s:.2f}")

    # numba's dense responses are too large for all lanes at once: as many as there are threads, the rest by proportion
    heights = np.linspace(20, 30, given.batch)
    prepare_s, pairs = best_of(lambda: [prepare(h) for h in heights[: given.threads]], times=1)
    greens, per_loads = (np.stack(x) for x in zip(*pairs, strict=True))
    share = given.batch / given.threads
    serial_s, _ = best_of(lambda: [event_loop(*pair, given.batch_events) for pair in pairs])
    parallel_s, breaks = best_of(lambda: event_loops(greens, per_loads, given.batch_events))
    batch = jax.jit(jax.vmap(lambda h: sp.series(chain(h), events=given.batch_events).breaks))
    jax_s, got = best_of(lambda: np.asarray(batch(heights)))
    halves = np.split(heights, given.threads)
    with ThreadPoolExecutor(given.threads) as pool:
        threads_s, _ = best_of(lambda: list(pool.map(lambda h: np.asarray(batch(h)), halves)))
    print(f"batch of {given.batch} chains, {given.batch_events} events, {got.sum()} breaks; the same in every event of the first: "
          f"{np.array_equal(breaks, got[: given.threads])}")  # fmt: skip
    print(f"one core: numba {share * serial_s:.3f} s, JAX {jax_s:.3f} s: numba/JAX = {share * serial_s / jax_s:.2f}")
    print(f"{given.threads} threads: numba {share * parallel_s:.3f} s, JAX {threads_s:.3f} s: "
          f"numba/JAX = {share * parallel_s / threads_s:.2f}")  # fmt: skip
    print(f"making numba's responses, {1e3 * prepare_s / given.threads:.1f} ms a chain, is not counted; JAX's set-up is")


if __name__ == "__main__":
    main()
