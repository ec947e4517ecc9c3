"""Programs are ready for a GPU, as far as a CPU can tell."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import ended

import slippulse_jax as sp
from slippulse_jax import lengths, theory
from slippulse_jax.bulk import chunks
from slippulse_jax.bulk.compiler import local_devices
from slippulse_jax.exact import crack
from slippulse_jax.exact import front as exact
from slippulse_jax.front.front import slip_and_stress

pytestmark = pytest.mark.ci

SLIDER = sp.Slider(25.0, 0.03, 0.3)
BLOCK = sp.Block(20.0, 1 / 52, 0.3, sp.Push(0.3))


def products(f, x):
    """Type and precision of every product of matrices in the program of f at x."""
    inside = [jax.make_jaxpr(f)(x).jaxpr]
    while inside:
        for equation in inside.pop().eqns:
            if equation.primitive.name == "dot_general":
                yield equation.outvars[0].aval.dtype, equation.params["precision"]
            for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda v: hasattr(v, "eqns")):
                inside += [getattr(value, "jaxpr", value)] if hasattr(value, "eqns") or hasattr(value, "jaxpr") else []


def chain(slider):
    return sp.chain(ended(slider, 40))


def forward(f):
    return lambda x: jax.jvp(f, (x,), (x,))[1]


def backward(f):
    return lambda x: jax.vjp(f, x)[1](jnp.ones(()))


PROGRAMS = {
    "length, forward": (forward(sp.precursor_length), SLIDER),
    "length, backward": (backward(sp.precursor_length), SLIDER),
    "exact length": (backward(sp.exact_length), SLIDER),
    "exact fields": (lambda x: exact.exact_fields(x, 3.0, jnp.arange(9.0)), SLIDER),
    "fields": (lambda x: slip_and_stress(x, jnp.float32(0.1), jnp.float32(3.5), 9), SLIDER),
    "crack": (lambda x: crack.fields(x, jnp.float32(0.3), jnp.float32(0.1), jnp.float32(5.0), jnp.float32(7.0)), SLIDER),
    "equilibrium": (lambda x: sp.equilibrium(chain(x), sp.nucleate(chain(x))[0]), SLIDER),
    "rupture": (lambda x: sp.rupture(chain(x), sp.nucleate(chain(x))[0], trigger=0), SLIDER),
    "smooth rupture": (
        backward(lambda x: sp.rupture(chain(x), sp.nucleate(chain(x))[0], rule=sp.SmoothBreak(0.05)).length),
        SLIDER,
    ),
    "sensitivity": (lambda x: sp.sensitivity(x, sites=80), SLIDER),
    "frozen": (backward(theory.length_frozen), SLIDER),
    "continuum": (lambda x: theory.continuum_fields(x, 3.0, 1.0), SLIDER),
    "macroscopic": (lambda x: theory.macroscopic_length(x, 0.3), 0.5),
    "block": (backward(lambda x: sp.precursor_length(x, sites=64)), BLOCK),
    "record of a block": (lambda x: sp.first_precursor(x, sites=64), BLOCK),
    "block with an end": (lambda x: sp.first_precursor(sp.Block(x, 1 / 52, 0.3, length=50), sites=64), 20.0),
    "series of a block": (lambda x: sp.series(x, sp.Spring(1.0), events=3, sites=64), BLOCK),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_products_are_multiplied_in_full(name, float32):
    """An accelerator rounds the factors of a product in single precision to ten bits unless it is told not to."""
    f, x = PROGRAMS[name]
    with jax.enable_x64("block" in name):  # blocks are traced in double precision only, in which nothing is rounded
        for g in (f, jax.vmap(f)):
            x = jax.tree.map(jnp.float32, x) if g is f else jax.tree.map(lambda leaf: jnp.stack([leaf] * 2), x)
            in_full = jnp.float64 if "block" in name else (jax.lax.Precision.HIGHEST,) * 2
            assert all(in_full in found for found in products(g, x))


def test_products_are_found():
    assert list(products(lambda x: x @ x, jnp.eye(2))) == [(jnp.float64, None)]
    assert len(list(products(PROGRAMS["block"][0], jax.tree.map(float, BLOCK)))) > 100


@pytest.mark.parametrize("count", [0, 1, 128, 129, 3000])
def test_one_chunk_per_call(count, monkeypatch):
    """As an accelerator takes lanes: a narrow chunk, a wide one, several."""
    slider = sp.Slider(np.linspace(10, 50, count), np.geomspace(1e-3, 0.03, count), 0.3)
    expected = sp.precursor_lengths(slider)
    plan = chunks._plan
    monkeypatch.setattr(chunks, "_plan", lambda count, layout, in_step, devices: plan(count, layout, True, devices))
    monkeypatch.setattr(lengths, "LENGTHS", chunks.Layout(chunk=4))
    np.testing.assert_allclose(sp.precursor_lengths(slider), expected, rtol=1e-13)


def test_device_chosen():
    cpu, expected = jax.devices("cpu"), sp.precursor_lengths(SLIDER)
    assert list(local_devices()) == jax.local_devices()
    assert list(local_devices(cpu=True)) == cpu
    with jax.default_device(cpu[-1]):
        assert local_devices() == [cpu[-1]]
        np.testing.assert_allclose(sp.precursor_lengths(SLIDER), expected, rtol=1e-13)
    with jax.default_device("cpu"):
        assert local_devices() == [cpu[0]]
