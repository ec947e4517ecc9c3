"""A loop compiled as one function, wherever a user may put it: XLA ends the process where it does not like one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import slippulse_jax as sp
from slippulse_jax.lattice import kernel

CHAIN = sp.chain(sp.Slider(25.0, 0.03, 0.3), sites=60)


def event(chain):
    state, site = sp.nucleate(chain, sp.relaxed(chain))
    return sp.rupture(chain, state, trigger=site)


def count(threshold):
    """One output of many, of a chain that is all constants but for its threshold."""
    return event(sp.chain(sp.Slider(25.0, 0.03, 0.3), sites=60, threshold=threshold)).breaks


@pytest.fixture(scope="module")
def breaks():
    return int(event(CHAIN).breaks)


def asked_for():
    """Whether a rupture's program asks XLA for one function."""
    return "xla_cpu_small_call" in jax.jit(lambda: event(CHAIN).breaks).lower().as_text()


def test_with_and_without(breaks, monkeypatch):
    assert breaks > 10
    assert asked_for() == jax.lib.__version__.startswith(kernel.TRIED)
    monkeypatch.setattr(kernel, "TRIED", ("none",))
    jax.clear_caches()
    assert not asked_for()
    assert int(event(CHAIN).breaks) == breaks
    jax.clear_caches()


def test_all_constants_and_one_output_used(breaks):
    assert int(jax.jit(lambda: event(CHAIN).breaks)()) == breaks


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_in_the_loops_of_jax(breaks, dtype):
    """Inside map, scan, cond and vmap; the count does not depend on a threshold common to all."""
    with jax.enable_x64(dtype == np.float64):
        thresholds = jnp.asarray([1.0, 2.0], dtype)

        def everywhere(thresholds):
            scanned = lax.scan(lambda total, x: (total + count(x), None), jnp.int32(0), thresholds)[0]
            chosen = lax.cond(thresholds[0] > 0, count, lambda x: jnp.int32(0), thresholds[0])
            return lax.map(count, thresholds), jax.vmap(count)(thresholds), scanned, chosen

        mapped, batched, scanned, chosen = jax.jit(everywhere)(thresholds)
    assert [*mapped, *batched, scanned, chosen] == [breaks] * 4 + [2 * breaks, breaks]
