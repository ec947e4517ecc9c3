"""The density that a fit minimises as a JAX function: for optax, samplers and code of one's own."""

import pickle
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from inference.test_sequences import table_of
from scipy.optimize import minimize

import slippulse_jax as sp
from slippulse_jax.inference.fit import fit
from slippulse_jax.inference.model.front import Front
from slippulse_jax.inference.model.inputs import Input
from slippulse_jax.inference.objective import _together

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
    f = sp.objective(sp.Measurements(HEIGHT, 0.3, LENGTH, 0.3, provenance=("measured",) * 3), fixed={"threshold_scatter": 0})
    assert "offset" in f.names
    start = f.start()
    assert float(f(start)) < 1
    compiled = _together._cache_size()
    for shift in (0.1, 0.2):
        f({name: x + shift for name, x in start.items()})
    assert _together._cache_size() == compiled


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


class HalfTheHeight(Front):
    """A model of one's own, by a program of NumPy that stops at what it cannot compute."""

    inputs = {"log_part": Input("part", -2.0, 2.0, "must lie within a factor of seven")}
    name = "half the height"

    def stated(self, m):
        return {"log_part": np.zeros(len(m))}

    def values(self, inputs):
        assert (inputs.log_height > 0).all()
        assert (np.abs(inputs.poisson) <= 0.5).all()
        assert np.isfinite(inputs.table()).all()
        return 0.5 * np.exp(inputs.log_height + inputs.get("log_part")) / (1 + 0.01 / inputs.ratio)


POISSON = sp.Parameter("poisson", prior=(0.3, 0.1))
BLOCK = sp.Measurements([20.0, 30.0], 0.3, [9.0, 14.0], 0.5, push_height=[5.0, 7.5])
SEQUENCE = table_of(0.8, 0.35, places=4)
KINDS = {
    "slider": (PLAIN, {}),
    "whole events": (PLAIN, {"event": "full"}),
    "own": (PLAIN, {"event": HalfTheHeight()}),
    "crack": (PLAIN, {"event": "crack", "fixed": {"friction": 0.2}}),
    "block": (BLOCK, {}),
    "sequence": (SEQUENCE, {}),
}
QUICK = [x if x in ("slider", "own") else pytest.param(x, marks=pytest.mark.ci) for x in KINDS]


@cache
def of_two(kind):
    """An objective of stiffness and ν, or friction."""
    table, options = KINDS[kind]
    return sp.objective(table, ["stiffness", "friction" if kind == "sequence" else POISSON], **options)


@pytest.mark.parametrize("kind", QUICK)
def test_theta_is_one_number_for_each_name(kind):
    """Of shape (1,), as scipy.optimize gives it, it was another function: every length beside every stiffness."""
    f = of_two(kind)
    start = f.start()
    for name in f.names:
        for x in (np.array([start[name]]), jnp.full(3, start[name]), np.full((1, 1), start[name]), [float(start[name])]):
            for call in (f, f.values, jax.jit(f), jax.grad(f)):
                with pytest.raises(
                    ValueError, match=rf"theta: '{name}' has shape \(.*\): give one number, such as x\[0\]; jax.vmap"
                ):
                    call({**start, name: jnp.asarray(x)})
        for x in ("-4", None, 1j, np.ma.masked_array(-4.0, True), True):
            with pytest.raises((TypeError, ValueError), match=f"theta: {name}"):
                f({**start, name: x})
    mapped = jax.vmap(f)({name: jnp.full(2, x) for name, x in start.items()})
    np.testing.assert_allclose(mapped, f(start), rtol=1e-12)


def test_scipy_minimises_it():
    f, found = sp.objective(PLAIN), fit(PLAIN, intervals="profile")
    slope = jax.grad(f)
    end = minimize(
        lambda x: float(f({"stiffness": x[0]})), [-4.7], jac=lambda x: [float(slope({"stiffness": x[0]})["stiffness"])]
    )
    assert end.x[0] == pytest.approx(found.theta[0], abs=1e-4)
    assert 2 * end.fun == pytest.approx(found.deviance, abs=1e-6)


@pytest.mark.parametrize("kind", QUICK)
def test_it_can_be_kept(kind):
    """After a call and a derivative, as Dask and process pools send it."""
    f = of_two(kind)
    start = f.start()
    value = f(start), jax.grad(f)(start)
    again = pickle.loads(pickle.dumps(f))
    assert again.names == f.names
    assert (again(start), jax.grad(again)(start)) == value
    assert again.values(start) == f.values(start)


@pytest.mark.parametrize("kind", [x if x != QUICK[-1] else pytest.param("sequence", marks=pytest.mark.slow) for x in QUICK])
def test_outside_double_precision_it_says_so(kind):
    """Made and called under `enable_x64`, then called outside."""
    f = of_two(kind)
    start = f.start()
    value, slope = float(f(start)), jax.grad(f)(start)
    with jax.enable_x64(False), pytest.warns(RuntimeWarning, match="objective in single precision: flat to rounding"):
        single = jax.value_and_grad(f)({name: float(x) for name, x in start.items()})
    assert single[0].dtype == np.float32
    assert float(single[0]) == pytest.approx(value, rel=1e-3, abs=0.05)
    assert set(single[1]) == set(slope)


@pytest.mark.parametrize("kind", QUICK)
def test_no_bad_lane_spoils_the_others(kind):
    """inf outside the domain and NaN for NaN, of models that call the host and raise there, too."""
    f = of_two(kind)
    start = f.start()
    name = f.names[1]
    outside = {name: [-1.2, 2.0e3, np.inf, -np.inf] + ([0.6] if name.startswith("poisson") else [])}
    outside["areal_stiffness" if "areal_stiffness" in f.names else "stiffness"] = [np.inf, -np.inf, 800.0, -800.0]
    good = float(f(start))
    for which, values in outside.items():
        lanes = {one: jnp.full(len(values) + 2, x) for one, x in start.items()}
        lanes[which] = jnp.array([*values, np.nan, start[which]])
        found, slopes = jax.vmap(jax.value_and_grad(f))(lanes)
        assert np.isinf(found[:-2]).all()
        assert np.isnan(found[-2])
        np.testing.assert_allclose(found[-1], good, rtol=1e-9)
        assert np.isfinite(slopes[which][-1])
        assert [float(f({**start, which: x})) for x in values] == [np.inf] * len(values)


def test_tables_of_one_form_share_their_programs():
    """Seven objectives with gradient, map and second derivative took a gigabyte."""
    first, *others = (sp.objective(sp.Measurements(HEIGHT * (1 + 0.01 * i), 0.3, LENGTH, 0.3 + 0.1 * i)) for i in range(7))
    start = first.start()

    def every(f):
        return f(start), jax.grad(f)(start), jax.hessian(f)(start), jax.vmap(f)({"stiffness": jnp.linspace(-5, -4, 3)})

    every(first)
    compiled = _together._cache_size()
    values = {float(every(f)[0]) for f in others}
    assert len(values) == 6
    assert _together._cache_size() == compiled


@pytest.mark.parametrize("which", ["counts", "specimens"])
def test_the_start_is_where_the_fit_ends(which):
    """Where counts hold in a range narrower than a grid, and where each specimen has its own stiffness."""
    random = np.random.default_rng(3)
    for _ in range(3):
        height, stiffness = random.uniform(10, 300, 6), 10 ** random.uniform(-3, -1.5)
        if which == "counts":
            length = np.ceil(sp.precursor_lengths(sp.Slider(height, stiffness, 0.3)))
            m, free = sp.Measurements(height, 0.3, length, kind=("whole",) * 6), "stiffness"
        else:
            length = sp.precursor_lengths(sp.Slider(height, stiffness * np.repeat([1, 1.2, 9], 2), 0.3))
            m, free = (
                sp.Measurements(height, 0.3, length, 0.3, specimen=[*"aabbcc"]),
                sp.Parameter("stiffness", each="specimen"),
            )
        f = sp.objective(m, free)
        assert float(f(f.start())) < 1e-2 + fit(m, free, intervals="profile").deviance / 2


def test_outside_the_domain_it_is_infinite():
    """A sampler that starts from the function alone must not leave ν ≤ 0.5; within the range it has slopes up to its ends."""
    table = sp.Measurements([20.0, 35.0, 50.0], 0.3, [12.7, 24.6, 38.0], 0.3)
    f = sp.objective(table, ["stiffness", sp.Parameter("poisson", prior=(0.4, 0.1))])
    start = f.start()
    assert [float(f({**start, "poisson": nu})) for nu in (0.5001, 0.9, -0.995)] == [np.inf] * 3
    assert np.isfinite(f({**start, "poisson": 0.5}))
    assert jax.grad(f)({**start, "poisson": 0.5})["poisson"] > 0
