"""What XLA is asked for on a CPU: a loop as one function (it ends the process where it does not like one), many results a loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import slippulse_jax as sp
from slippulse_jax.bulk import compiler as kernel
from slippulse_jax.lattice import lanes
from slippulse_jax.lattice.chain import relaxed

CHAIN = sp.chain(sp.Slider(25.0, 0.03, 0.3), sites=60)


def event(chain):
    state, site = sp.nucleate(chain, relaxed(chain))
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
    assert asked_for() == (jax.lib.__version__ in kernel.TRIED)
    monkeypatch.setattr(kernel, "TRIED", ("none",))
    jax.clear_caches()
    kernel._say_once.cache_clear()
    with pytest.warns(RuntimeWarning, match="is not among the releases slippulse_jax was tuned for"):
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


def swapped(pair, third):
    """Not its own repetition: XLA has to apply it once."""
    return (pair[1] - third, pair[0] + third), third * pair[0] + 1, jnp.sqrt(third)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_in_one_loop(dtype):
    """Applied once to every element, in jit, loops and vmap; trees in and out."""
    with jax.enable_x64(dtype == np.float64):
        numbers = tuple(jnp.asarray(x, dtype) for x in np.random.default_rng(0).uniform(1, 2, (3, 1001)))
        given = numbers[:2], numbers[2]

        def once(pair, third):
            return kernel.in_one_loop(swapped, pair, third)

        def close(found, expected):
            assert jax.tree.structure(found) == jax.tree.structure(expected)
            for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
                np.testing.assert_allclose(a, b, rtol=0, atol=100 * np.finfo(dtype).eps)

        expected = swapped(*given)
        close(once(*given), expected)
        close(jax.jit(once)(*given), expected)
        close(
            jax.vmap(once)(*jax.tree.map(lambda x: x.reshape(7, 143), given)),
            jax.tree.map(lambda x: x.reshape(7, 143), expected),
        )
        repeated = lax.fori_loop(0, 3, lambda _, now: kernel.in_one_loop(swapped, *now)[:2], given)
        close(repeated, swapped(*swapped(*swapped(*given)[:2])[:2])[:2])
        with pytest.raises(ValueError, match="3 arguments, 2 results"):
            kernel.in_one_loop(lambda pair, third: (pair[0], third), *given)


def test_lengths_without_it(monkeypatch):
    """Under a release of jaxlib that was not tried the same lengths and derivatives, to rounding; and it is asked for here."""
    parameters = np.array([[10.0, 25, 50, 1.2], [0.03, 0.01, 0.003, 1e-3], [0.3, 0.1, 0.45, 0.3]])
    make = lanes.gradient_kernel.__wrapped__(1000)
    with jax.enable_x64(True):
        reductions = str(jax.make_jaxpr(make)(parameters)).count(" reduce[")
        assert (reductions > 0) == (jax.lib.__version__ in kernel.TRIED)
        found = jax.jit(make)(parameters)
        monkeypatch.setattr(kernel, "TRIED", ("none",))
        make = lanes.gradient_kernel.__wrapped__(1000)
        assert str(jax.make_jaxpr(make)(parameters)).count(" reduce[") == 0
        np.testing.assert_allclose(found[0], jax.jit(make)(parameters)[0], rtol=1e-11)
