"""What XLA is asked for on a CPU: a loop as one function, and several results from one loop over the elements."""

import inspect
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import jaxlib.version
import numpy as np
import pytest
from jax import lax

import slippulse_jax as sp
from slippulse_jax.bulk import compiler as kernel
from slippulse_jax.front import lanes

CHAIN = sp.chain(sp.Slider(25.0, 0.03, 0.3), sites=80)


def event(chain):
    state, site = sp.nucleate(chain)
    return sp.rupture(chain, state, trigger=site)


def count(threshold):
    """One output of many, of a chain that is all constants but for its threshold."""
    return event(sp.chain(sp.Slider(25.0, 0.03, 0.3), sites=80, threshold=threshold)).breaks


@pytest.fixture(scope="module")
def breaks():
    return int(event(CHAIN).breaks)


def run(code, **environment):
    """What a new process prints."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ, **environment}
    )
    return done.stdout.strip()


def loops_are_whole():
    """Whether XLA compiles loops that touch more than a kilobyte per turn as one function in this process."""

    def loop(x):
        return lax.while_loop(lambda x: x.sum() < 1, lambda x: x + 1, x)

    return "xla_cpu_small_call" in str(jax.jit(loop).lower(jnp.zeros(1000)).compile().as_text())


WHOLE = """
import numpy as np, jax, jax.numpy as jnp
from jax import lax
import slippulse_jax as sp
from slippulse_jax.bulk.compiler import compile_loops_whole
compile_loops_whole()
jax.config.update("jax_enable_x64", True)
chain = sp.chain(sp.Slider(25.0, 0.03, 0.3), sites=80)
state, site = sp.nucleate(chain)
constant = jax.jit(lambda: sp.rupture(chain, state, trigger=site).breaks)()  # all constants, one output used
found = sp.series(chain, events=9).breaks
lengths = sp.precursor_lengths(sp.Slider(np.linspace(10, 50, 500), 0.03, 0.3))
print(loops_are_whole(), int(constant), *np.asarray(found), *lengths)
"""


@pytest.mark.slow
def test_whole_loops_give_the_same(breaks):
    """Loops compiled as one function each, in a process that asks for it; the bits of lengths in bulk do not depend on it."""
    whole, constant, *found = run(inspect.getsource(loops_are_whole) + WHOLE, XLA_FLAGS="").split()
    assert whole == "True", "of this release of jaxlib too: else series take four times as long"
    assert not loops_are_whole()
    assert int(constant) == breaks
    assert breaks > 10
    expected = [*sp.series(CHAIN, events=9).breaks]
    lengths = sp.precursor_lengths(sp.Slider(np.linspace(10, 50, 500), 0.03, 0.3))
    assert found == [*map(str, map(int, expected)), *map(str, lengths)]


def test_options_of_the_user_stay(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_backend_extra_options=xla_cpu_disable_loop_unrolling")
    kernel.compile_loops_whole()
    assert os.environ["XLA_FLAGS"] == "--xla_backend_extra_options=xla_cpu_disable_loop_unrolling"


@pytest.mark.parametrize("option", ["xla_backend_extra_options", "xla_cpu_small_while_loop_byte_threshold"])
def test_an_option_that_xla_does_not_know_is_not_given(monkeypatch, option):
    """It would end the process."""
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.setattr(kernel, "knows", lambda name: name != option)
    kernel._say_once.cache_clear()
    with pytest.warns(RuntimeWarning, match=rf"jaxlib {jax.lib.__version__} has no option {option}: ruptures and series take"):
        kernel.compile_loops_whole()
    kernel.compile_loops_whole()  # and says no more
    assert not os.environ["XLA_FLAGS"]


@pytest.mark.ci
def test_known_options_are_those_that_xla_takes():
    """XLA ends a process that names another one."""
    for name in ("xla_backend_optimization_level", "xla_cpu_parallel_codegen_split_count", "xla_no_such_option", "xla_backend"):
        done = subprocess.run(
            [sys.executable, "-c", "import jax; jax.jit(lambda x: x + 1)(1)"],
            capture_output=True, text=True, env={**os.environ, "XLA_FLAGS": f"--{name}=1"},
        )  # fmt: skip
        assert kernel.knows(name) == (f"Unknown flag in XLA_FLAGS: --{name}=1" not in done.stderr)
        assert kernel.knows(name) == (done.returncode == 0)


def test_options_that_xla_does_not_know_are_left_out(monkeypatch):
    """Quietly if this XLA lacks the name; if it has the name and refuses the option, it is said once. The results are the same."""
    kernel._say_once.cache_clear()
    monkeypatch.setattr(kernel, "OPTIONS", {"xla_no_such_option": 1})

    def added(more):
        number = jax.ShapeDtypeStruct((), np.float64)
        program = kernel.compiled(lambda x: x + more, number, device=jax.devices("cpu")[0], fusion_emitters=True)
        with jax.enable_x64(True):
            return program(np.float64(0.1))

    assert added(3.0) == 3.1
    monkeypatch.setattr(kernel, "knows", lambda name: True)
    with pytest.warns(RuntimeWarning, match="compiled without the options slippulse_jax asks for, .*xla_no_such_option"):
        assert added(1.0) == 1.1
    assert added(2.0) == 2.1


def test_any_release_of_jaxlib_that_does_it_is_used_in_silence(monkeypatch):
    """What counts is what it compiles, not its name."""
    monkeypatch.setattr(jaxlib.version, "__version__", "99.0")
    monkeypatch.setenv("XLA_FLAGS", "")
    kernel.compile_loops_whole()
    assert "xla_cpu_small_while_loop_byte_threshold" in os.environ["XLA_FLAGS"]
    x = jnp.ones(3)
    assert " reduce[" in str(jax.make_jaxpr(lambda *given: kernel.in_one_loop(swapped, given, x))(x, x))


def pairs(rows, starts, take, axes):
    """Rows are first reduced among themselves, and then with the start."""
    first, second = (tuple(x[i] for x in rows) for i in (0, 1))
    return tuple(take(starts, take(first, second)))


def apart(rows, starts, take, axes):
    """The right results, but not from one loop."""
    return tuple(map(lax.optimization_barrier, take(starts, tuple(x[1] for x in rows))))


def failing(rows, starts, take, axes):
    raise jax.errors.JaxRuntimeError("UNIMPLEMENTED: reductions")


@pytest.mark.ci
@pytest.mark.parametrize(
    ("reduction", "said"),
    [
        pytest.param(pairs, "in another order", marks=pytest.mark.slow),
        (apart, r"in \d+ loops"),
        (failing, r"with an error \(UNIMPLEMENTED: reductions\)"),
    ],
)
def test_a_compiler_without_the_habit(monkeypatch, reduction, said):
    """It is seen, said once, and lengths are the same to rounding."""
    kernel._say_once.cache_clear()
    kernel.reduces_in_one_loop.cache_clear()
    sliders = np.array([[10.0, 25, 50, 1.2], [0.03, 0.01, 0.003, 1e-3], [0.3, 0.1, 0.45, 0.3]])
    try:
        with jax.enable_x64(True):
            expected = jax.jit(lanes.gradient_kernel.__wrapped__(1000))(sliders)[0]
            kernel.reduces_in_one_loop.cache_clear()
            monkeypatch.setattr(lax, "reduce", reduction)
            with pytest.warns(
                RuntimeWarning, match=f"jaxlib {jax.lib.__version__} compiles reductions {said}: lengths in bulk"
            ):
                found = jax.jit(lanes.gradient_kernel.__wrapped__(1000))(sliders)[0]
            assert not kernel.reduces_in_one_loop()
        np.testing.assert_allclose(found, expected, rtol=1e-11)
    finally:
        kernel.reduces_in_one_loop.cache_clear()


@pytest.mark.ci
def test_all_constants_and_one_output_used(breaks):
    assert int(jax.jit(lambda: event(CHAIN).breaks)()) == breaks


@pytest.mark.ci
@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.slow)])
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


@pytest.mark.ci
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


@pytest.mark.ci
def test_lengths_without_it(monkeypatch):
    """The same lengths and derivatives, to rounding; and this release of jaxlib does it."""
    parameters = np.array([[10.0, 25, 50, 1.2], [0.03, 0.01, 0.003, 1e-3], [0.3, 0.1, 0.45, 0.3]])
    make = lanes.gradient_kernel.__wrapped__(1000)
    with jax.enable_x64(True):
        reductions = str(jax.make_jaxpr(make)(parameters)).count(" reduce[")
        assert reductions > 0, "of this release of jaxlib too: else lengths in bulk take three times as long"
        found = jax.jit(make)(parameters)
        monkeypatch.setattr(kernel, "reduces_in_one_loop", lambda: False)
        make = lanes.gradient_kernel.__wrapped__(1000)
        assert str(jax.make_jaxpr(make)(parameters)).count(" reduce[") == 0
        np.testing.assert_allclose(found[0], jax.jit(make)(parameters)[0], rtol=1e-11)
