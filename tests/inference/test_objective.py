"""The density that a fit minimises as a JAX function: for optax, samplers and code of one's own."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import slippulse_jax as sp
from slippulse_jax.inference.fit import fit

HEIGHT = np.array([15.0, 25.0, 40.0])
LENGTH = sp.precursor_lengths(sp.Slider(HEIGHT, 0.01, 0.3))
PLAIN = sp.Measurements(HEIGHT, 0.3, LENGTH * [1.02, 0.99, 1.01], 0.02 * LENGTH)
CASES = {
    "lengths": (PLAIN, {}),
    "prestress": (PLAIN, {"free": ["stiffness", sp.Parameter("prestress", prior=(0.0, 0.1))]}),
    "student": (PLAIN, {"loss": "student"}),
    "priors": (sp.Measurements(HEIGHT, 0.3, LENGTH, 0.02 * LENGTH, poisson_sigma=0.02), {}),
    "kinds": (
        sp.Measurements(HEIGHT, 0.3, [np.ceil(LENGTH[0]), *LENGTH[1:]], [0.1, 0.4, 0.6], kind=["whole", "length", "at_least"]),
        {},
    ),
    "ends": (sp.Measurements(HEIGHT, 0.3, LENGTH, 0.02 * LENGTH, block_length=4 * HEIGHT, machine_stiffness=30.0), {}),
    "specimens": (
        sp.Measurements(HEIGHT, 0.3, LENGTH, 0.02 * LENGTH, specimen=("a", "a", "b")),
        {"free": [sp.Parameter("stiffness", each="specimen")]},
    ),
    "crack": (PLAIN, {"event": "crack", "fixed": {"friction": 0.2}}),
    "whole events": (PLAIN, {"event": "full"}),
}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("name", [x if x in ("lengths", "kinds") else pytest.param(x, marks=pytest.mark.ci) for x in CASES])
def test_value_and_slope_are_those_of_the_fit(name):
    """Compiled and mapped, at θ away from the best fit."""
    m, options = CASES[name]
    f, found = sp.objective(m, **options), fit(m, intervals="profile", **options)
    assert f.names == list(found.parameters.names)
    theta = found.theta + [[0.03], [-0.02]]
    at = found.problem(theta, order=1)
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(f)))(dict(zip(f.names, theta.T, strict=True)))
    np.testing.assert_allclose(value, at.value, rtol=1e-9)
    np.testing.assert_allclose(np.stack([slope[x] for x in f.names], -1), at.gradient, rtol=1e-6, atol=1e-6)
    assert f.values(dict(zip(f.names, found.theta, strict=True))) == pytest.approx(found.values)
    start = f.start()
    assert float(f(start)) >= found.deviance / 2 - 1e-9
    assert all(low <= start[x] <= high for x, (low, high) in f.bounds.items())


@pytest.mark.parametrize("name", ["lengths", pytest.param("prestress", marks=pytest.mark.ci)])
def test_second_derivatives_are_those_of_the_fit(name):
    """Both mixed ones too; and continuous where a front passes a contact."""
    m, options = CASES[name]
    f, found = sp.objective(m, **options), fit(m, intervals="profile", **options)
    theta = dict(zip(f.names, map(jnp.asarray, found.theta + 0.01), strict=True))
    bend = jax.jit(jax.hessian(f))(theta)
    square = [[bend[x][y] for y in f.names] for x in f.names]
    np.testing.assert_allclose(square, found.problem(found.theta + 0.01, order=2).curvature[0], rtol=1e-7, atol=1e-6)


def test_adam_from_the_start_reaches_the_fit():
    f, found = sp.objective(PLAIN), fit(PLAIN, intervals="profile")
    theta, optimiser = f.start(), optax.adam(optax.cosine_decay_schedule(0.05, 400))

    @jax.jit
    def descend(theta):
        def step(_, now):
            change, state = optimiser.update(jax.grad(f)(now[0]), now[1])
            return optax.apply_updates(now[0], change), state

        return jax.lax.fori_loop(0, 400, step, (theta, optimiser.init(theta)))[0]

    value = f.values(descend(theta))["stiffness"]
    assert abs(value - found.values["stiffness"]) < 1e-4 * found.stderrs["stiffness"]
    np.testing.assert_array_equal(f.sigma, PLAIN.length_sigma)


@pytest.mark.parametrize("method", ["adam", pytest.param("lbfgs", marks=pytest.mark.ci)])
def test_optimisers_of_optax_find_the_roots_of_the_fit(method):
    """Two roots on both sides of the peak of one length."""
    m = sp.Measurements(25.0, 0.3, 25.0, 0.3)
    usual, found = fit(m, intervals="profile"), fit(m, intervals="profile", method=method)
    assert len(found.roots) == len(usual.roots) == 2
    for mine, theirs in zip(found.roots, usual.roots, strict=True):
        assert abs(mine.theta[0] - theirs.theta[0]) < 1e-3 * np.sqrt(theirs.covariance[0, 0])


@pytest.mark.ci
def test_start_beside_narrow_priors_and_calls_that_compile_once():
    """Offset and factor of measured lengths, whose priors are narrower than the grid, start at their means."""
    f = sp.objective(sp.Measurements(HEIGHT, 0.3, LENGTH, 0.3, provenance=("measured",) * 3))
    assert "offset" in f.names
    start = f.start()
    assert float(f(start)) < 1
    compiled = f._compiled._cache_size()
    for shift in (0.1, 0.2):
        f({name: x + shift for name, x in start.items()})
    assert f._compiled._cache_size() == compiled


def test_what_it_does_not_take():
    with pytest.raises(ValueError, match=r"lengths without σ have no likelihood: give their standard errors"):
        sp.objective(sp.Measurements(HEIGHT, 0.3, LENGTH))
    f = sp.objective(PLAIN)
    with pytest.raises(ValueError, match=r"theta: 'stifness' is not fitted; did you mean stiffness\?: stiffness"):
        f({"stifness": -4.0})
    with pytest.raises(ValueError, match=r"theta: no 'stiffness': needs stiffness"):
        f({})
    with jax.enable_x64(False), pytest.warns(RuntimeWarning, match="objective in single precision"):
        sp.objective(PLAIN)


def test_outside_the_domain_it_is_infinite():
    """A sampler that starts from the function alone must not leave ν ≤ 0.5; within the range it has slopes up to its ends."""
    table = sp.Measurements([20.0, 35.0, 50.0], 0.3, [12.7, 24.6, 38.0], 0.3)
    f = sp.objective(table, ["stiffness", sp.Parameter("poisson", prior=(0.4, 0.1))])
    start = f.start()
    assert [float(f({**start, "poisson": nu})) for nu in (0.5001, 0.9, -0.995)] == [np.inf] * 3
    assert np.isfinite(f({**start, "poisson": 0.5}))
    assert jax.grad(f)({**start, "poisson": 0.5})["poisson"] > 0
