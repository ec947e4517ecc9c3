"""10⁴ events at N = 2000, beside a numba event loop with the same O(N) update per break: python -m benchmarks series."""

import argparse
import functools
import os
import time
from concurrent.futures import ThreadPoolExecutor

import jax
import numba
import numpy as np
from numba import njit, prange

import slippulse_jax as sp
from benchmarks.timing import side_by_side
from slippulse_jax.bodies.chain import State, eliminate
from slippulse_jax.bodies.response import of_chain
from slippulse_jax.bulk.compiler import compile_loops_whole

SMALLEST = "--sites 100 --events 50 --batch 2 --batch-events 20 --threads 2"


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


def chain(sites, height=25.0):
    return sp.chain(sp.Slider(height, 0.03, 0.3), sites=sites)


@functools.cache
def responses(sites):
    def green(height):
        body = chain(sites, height)
        resp = of_chain(body, eliminate(body, body.contact))
        return resp.matrix[:, 0]

    return jax.jit(green)


def prepare(sites, height=25.0):
    """What numba's loop is given: every response, and the stresses under a unit load."""
    state = State(np.zeros(sites), np.asarray(1.0))
    return np.asarray(responses(sites)(height)), np.asarray(sp.equilibrium(chain(sites, height), state).stress)


def single(sites, events):
    """Shortest time of this package and of numba in s, and the catalogue; both must break the same."""
    jax.config.update("jax_enable_x64", True)
    green, per_load = prepare(sites)
    one = jax.jit(lambda: sp.series(chain(sites), events=events))
    taken = side_by_side(
        {"ours": lambda: jax.block_until_ready(one()), "theirs": lambda: event_loop(green, per_load, events)}, 3
    )
    got, (_, breaks) = one(), event_loop(green, per_load, events)
    np.testing.assert_array_equal(breaks, got.breaks)
    return taken["ours"], taken["theirs"], got


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--sites", type=int, default=2000)
    parser.add_argument("--events", type=int, default=10_000)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--batch-events", type=int, default=500)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    given = parser.parse_args()
    compile_loops_whole()
    jax.config.update("jax_enable_x64", True)
    numba.set_num_threads(given.threads)

    ours, theirs, got = single(given.sites, given.events)
    print(
        f"N = {given.sites}, {given.events} events, {int(got.breaks.sum())} breaks, the same as numba's; drift {float(got.drift):.1e} σ_s"
    )
    print(f"one chain, one core: numba {theirs:.4f} s, JAX {ours:.4f} s: numba/JAX = {theirs / ours:.2f}")

    # numba's dense responses are too large for all lanes at once: as many as there are threads, the rest by proportion
    heights = np.linspace(20, 30, given.batch)
    began = time.perf_counter()
    pairs = [prepare(given.sites, h) for h in heights[: given.threads]]
    prepare_s = time.perf_counter() - began
    greens, per_loads = (np.stack(x) for x in zip(*pairs, strict=True))
    share = given.batch / given.threads
    batch = jax.jit(jax.vmap(lambda h: sp.series(chain(given.sites, h), events=given.batch_events).breaks))
    got = np.asarray(batch(heights))
    np.testing.assert_array_equal(event_loops(greens, per_loads, given.batch_events), got[: given.threads])
    halves = np.split(heights, given.threads)
    with ThreadPoolExecutor(given.threads) as pool:
        taken = side_by_side(
            {
                "numba": lambda: [event_loop(*pair, given.batch_events) for pair in pairs],
                "JAX": lambda: np.asarray(batch(heights)),
                "numba, threads": lambda: event_loops(greens, per_loads, given.batch_events),
                "JAX, threads": lambda: list(pool.map(lambda h: np.asarray(batch(h)), halves)),
            },
            3,
        )
    print(f"batch of {given.batch} chains, {given.batch_events} events, {got.sum()} breaks, the same as numba's in the first")
    for cores, also in (("one core", ""), (f"{given.threads} threads", ", threads")):
        theirs, ours = share * taken["numba" + also], taken["JAX" + also]
        print(f"{cores}: numba {theirs:.3f} s, JAX {ours:.3f} s: numba/JAX = {theirs / ours:.2f}")
    print(f"making numba's responses, {1e3 * prepare_s / given.threads:.1f} ms per chain, is not counted; JAX's set-up is")


if __name__ == "__main__":
    main()
