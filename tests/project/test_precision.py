"""What a process computes that leaves JAX in single precision, its default; the rest of the suite runs in double."""

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import default_precision
import documented
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.bulk import chunks

pytestmark = pytest.mark.ci

ROOT = Path(__file__).resolve().parents[2]
AS_IT_IS = {name: value for name, value in os.environ.items() if name != "JAX_ENABLE_X64"} | {"MPLBACKEND": "Agg"}


@pytest.mark.slow
def test_public_functions_by_default():
    """In one fresh process, against double precision in this one."""
    strict = ["-W", "error::RuntimeWarning", "-W", "error:Explicitly requested dtype"]  # which JAX cuts off elsewhere
    program = [sys.executable, *strict, default_precision.__file__]
    done = subprocess.run(program, capture_output=True, text=True, env=AS_IT_IS, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    found, exact = json.loads(done.stdout), default_precision.results()
    assert found.keys() == exact.keys()
    for name, (_, error) in default_precision.CALLS.items():
        scale = np.max(np.abs(exact[name]))
        assert np.isfinite(scale), name
        np.testing.assert_allclose(found[name], exact[name], rtol=error, atol=error * scale, err_msg=name)
    assert found["slider"] != exact["slider"], "the process was in double precision"
    for one in (found, exact):
        assert one["a tall block"] == one["a push at a third"], "the length and the record of one block"


def test_blocks_that_single_precision_cannot_do(float32):
    """Traced by jit or vmap there is no double precision inside single: it says so."""

    def length(height):
        return sp.precursor_length(sp.Block(height, 0.05, 0.3), sites=64)

    def record(height):
        return sp.first_precursor(sp.Block(height, 0.05, 0.3), sites=64).load

    def many(height):
        return sp.series(sp.Block(height, 0.05, 0.3), events=2, sites=64).load

    heights = jnp.array([10.0, 12.0])
    for traced in (jax.jit, lambda f: lambda x: jax.vmap(f)(heights), lambda f: jax.jit(jax.grad(f))):
        for function in (length, record, many):
            with pytest.raises(ValueError, match=r"a block needs double precision: work under jax.enable_x64\(True\)"):
                traced(function)(10.0)
    for function in (record, many):
        with pytest.raises(ValueError, match="under jit, vmap and grad a block needs double precision"):
            jax.grad(function)(10.0)


def test_precision_of_blocks(float32):
    """Numbers count as they were given, results come in the caller's precision, and a record keeps its block."""
    assert sp.precursor_length(sp.Block(10.0, 0.05, 0.3)).dtype == jnp.float32
    block = sp.Block(10.0, 0.05, 0.3)
    found = sp.first_precursor(block)
    assert found.body is block
    assert {x.dtype.name for x in (found.length, found.stress, found.load, found.breaks)} == {"float32", "int32"}
    with jax.enable_x64(True):
        assert sp.precursor_length(sp.Block(jnp.float32(10.0), 0.05, 0.3)).dtype == jnp.float64


@pytest.mark.slow
def test_a_block_that_a_program_in_single_precision_holds(float32):
    """JAX 0.10 remembers an array in single precision while a program holds that, and takes it for the array in double too."""
    block = sp.Block(10.0, 0.05, 0.3)
    expected = float(sp.precursor_length(sp.Block(10.0, 0.05, 0.3, sp.Push(0.25))))
    program = jax.make_jaxpr(lambda: jnp.add(block.push.height, 1.0))()
    for function in (sp.precursor_length, lambda one: sp.first_precursor(one).length):
        assert float(function(block)) == pytest.approx(expected, rel=1e-6)
        with jax.enable_x64(True):
            assert function(block).dtype == jnp.float64
    assert sp.series(block, events=2, sites=64).load.shape == (2,)
    assert "f32" in str(program)


PROGRAMS = ["README.md", "docs/howto/extend.md"]


@pytest.mark.slow
@pytest.mark.parametrize("page", PROGRAMS)
def test_pages_pasted_into_a_new_process(page, tmp_path):
    """All programs of a page, one after another; `test_docs.py` runs every page with JAX's defaults, but after others."""
    program = tmp_path / "pasted.py"
    text = "\n".join(text for _, text in documented.blocks(ROOT / page, "python"))
    program.write_text(text, encoding="utf-8")
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, env=AS_IT_IS, cwd=ROOT)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("flag", "call"),
    [
        (jax.checking_leaks, lambda: sp.precursor_lengths(default_precision.SLIDER)),
        (jax.checking_leaks, lambda: sp.precursor_length(sp.Block(8.0, 0.05, 0.3), sites=64)),
        (partial(jax.numpy_dtype_promotion, "strict"), lambda: sp.theory.length_frozen(default_precision.SLIDER)),
        (
            partial(jax.numpy_dtype_promotion, "strict"),
            lambda: sp.simulate_inertial(sp.chain(default_precision.SLIDER, sites=8), duration=2.0),
        ),
        (partial(jax.debug_infs, True), lambda: sp.rupture(sp.chain(default_precision.SLIDER, sites=8))),
        (partial(jax.debug_infs, True), lambda: sp.series(sp.chain(default_precision.SLIDER, sites=8), events=4)),
        (
            partial(jax.debug_infs, True),
            lambda: sp.simulate_inertial(sp.chain(default_precision.SLIDER, sites=8), duration=2.0),
        ),
    ],
)
def test_the_checks_that_jax_offers_stop_nothing(flag, call, float32):
    """As a user turns them on for a program of his own; the programs are traced under them."""
    chunks._program.cache_clear()
    jax.clear_caches()
    with flag():
        call()
