"""A million lengths: the exact solution beside the recursion in numba, one core each unless JAX takes more.

Usage: python exact_vs_numba.py [sliders [of them by the recursion]]. The recursion's time is scaled up from its sample, each
slider taken at even steps in order of expected length.
"""

import sys
import time

import jax
import numba
import numpy as np

import slippulse_jax as sp
from slippulse_jax.lattice.modes import lattice_modes

CHUNK = 1000


@numba.njit(cache=False)
def recursion(gap, w, R, C, out):
    for i in range(len(out)):
        g1, g2 = gap[i]
        S1 = S2 = T1 = T2 = 0.0
        E1 = E2 = 1.0
        t, s = 1.0, 0
        before = 1.0
        while t >= 1 and s < 10_000_000:
            S1 += t
            S2 += t
            S1 -= g1 * S1
            S2 -= g2 * S2
            T1 += E1 * t
            T2 += E2 * t
            E1 -= g1 * E1
            E2 -= g2 * E2
            before, s = t, s + 1
            t = w[i, 0] * S1 + w[i, 1] * S2
            t += E1 * (C[i, 0] + R[i, 0, 0] * T1 + R[i, 0, 1] * T2) + E2 * (C[i, 1] + R[i, 1, 0] * T1 + R[i, 1, 1] * T2)
        out[i] = s - 1 + (before - 1) / (before - t)


def main(count, sample):
    rng = np.random.default_rng(0)
    u = rng.uniform(size=(3, count))
    H, q, nu = 2 * 5e4 ** u[0], 1e-6 ** u[1], u[2] / 2
    # lanes of one chunk take as many Newton steps as the slowest: alike together
    order = np.argsort(q * H)
    with jax.enable_x64(True):
        lanes = tuple(x[order].reshape(-1, CHUNK) for x in (H, q, nu))
        exact = jax.jit(lambda *x: jax.lax.map(lambda y: sp.exact_length(sp.Slider(*y)), x))
        exact(*lanes).block_until_ready()
        start = time.perf_counter()
        length = np.asarray(exact(*lanes)).ravel()
        first = time.perf_counter() - start
        step = count // sample
        chosen = order[step // 2 :: step]
        modes = jax.jit(jax.vmap(lambda h, k, n: lattice_modes(sp.Slider(h, k, n))))(H[chosen], q[chosen], nu[chosen])
        inputs = [np.asarray(x) for x in (modes.gap, modes.weight, modes.reflection, modes.drive)]
    out = np.empty(len(chosen))
    recursion(*(x[:2] for x in inputs), out[:2])
    start = time.perf_counter()
    recursion(*inputs, out)
    second = time.perf_counter() - start
    first_sample = length[step // 2 :: step]
    per_slider = first / count, second / len(out)
    print(f"exact: {count} sliders in {first:.2f} s; recursion: {len(out)} in {second:.2f} s")
    print(f"per slider: {per_slider[0]:.2e} s and {per_slider[1]:.2e} s, ratio {per_slider[1] / per_slider[0]:.1f}")
    count_difference = np.abs(np.maximum(np.ceil(first_sample), 1) - np.maximum(np.ceil(out), 1))
    print(f"largest difference of whole counts: {np.max(count_difference):.0f}")


if __name__ == "__main__":
    numbers = [int(x) for x in sys.argv[1:]] or [1_000_000]
    main(numbers[0], numbers[-1])
