"""The smooth break rule: its limit, its derivatives, and that it never turns into a NaN."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import expit

import slippulse_jax as sp
from slippulse_jax.lattice.chain import chain
from slippulse_jax.lattice.precursor import arrest
from slippulse_jax.lattice.rupture import nucleate, rupture
from slippulse_jax.lattice.smooth import smooth_length
from slippulse_jax.rules import SmoothBreak
from slippulse_jax.status import Outcome


@jax.jit
def length(height, stiffness, poisson, width):
    slider = sp.Slider(height=height, stiffness=stiffness, poisson=poisson)
    return smooth_length(slider, SmoothBreak(width=width))


@jax.jit
def hard(height, stiffness, poisson):
    return jax.vmap(lambda *x: arrest(sp.Slider(*x), max_contacts=10_000).length)(height, stiffness, poisson)


@jax.jit
def in_a_chain(height, width, threshold):
    c = chain(sp.Slider(height=height, stiffness=0.03, poisson=0.3), sites=120, threshold=threshold)
    state, site = nucleate(c)
    return rupture(c, state, trigger=site, rule=SmoothBreak(width=width))


def random_sliders(n, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(5, 60, n), 10 ** rng.uniform(-3, -1, n), rng.uniform(0.05, 0.45, n)


def test_fraction_broken_is_the_distribution_it_says():
    """A logistic law of thresholds around θ, cut off at zero: from its density, by quadrature."""
    for theta, w in [(1.0, 0.1), (0.7, 0.4), (1.3, 1.0)]:
        rule = SmoothBreak(width=w)

        def density(x, theta=theta, w=w):
            s = expit((x - theta) / w)
            return s * (1 - s) / w

        whole = quad(density, 0, np.inf)[0]
        for t in (0.05, 0.6, 1.0, 1.9):
            expected = quad(density, 0, t)[0] / whole
            np.testing.assert_allclose(rule.broken(jnp.asarray(t), jnp.asarray(theta)), expected, rtol=1e-8)
        assert rule.broken(jnp.asarray(-0.5), jnp.asarray(theta)) == 0
        # and the length between two contacts is its integral along the straight line
        for a, b in [(0.2, 1.4), (1.1, 1.1), (1.2, 1.2 + 1e-9), (1.3, 0.1)]:
            xs = np.polynomial.legendre.leggauss(60)
            inside = rule.broken(jnp.asarray(a + (b - a) * (xs[0] + 1) / 2), jnp.asarray(theta)[None])
            line = xs[1] @ np.asarray(inside) / 2
            found = rule.overloaded_length(*map(jnp.asarray, (a, b, theta, theta)))
            np.testing.assert_allclose(found, line, rtol=1e-7)


def test_narrow_rule_is_the_hard_model():
    h, q, nu = random_sliders(200, 1)
    exact = np.asarray(hard(h, q, nu))
    found, status = length(h, q, nu, np.full(200, 1e-6))
    assert np.all(status == Outcome.ARRESTED)
    # all but those with a contact within some 1e-5 of its threshold
    near = np.abs(np.asarray(found) - exact)
    assert (near < 1e-6).mean() > 0.98
    assert near.max() < 1


def test_mean_bias_vanishes_at_second_order():
    """Over many sliders, whose last contact comes as near to its threshold as it happens to.

    Only sliders within ~w of a contact on its threshold notice the width, a part of them in proportion to w, and those by
    about as much in proportion to w: w² on average, though for each slider alone the bias falls exponentially.
    """
    h, q, nu = random_sliders(2000, 2)
    exact = np.asarray(hard(h, q, nu))
    keep = exact > 2
    widths = 10.0 ** -np.arange(3.0, 4.6, 0.5)
    bias = [np.abs(np.asarray(length(h, q, nu, np.full(2000, w))[0]) - exact)[keep].mean() for w in widths]
    rates = np.diff(np.log(bias)) / np.diff(np.log(widths))
    np.testing.assert_allclose(rates, 2.0, atol=0.2)


def test_one_slider_has_an_exponentially_small_bias():
    """Once w is small beside every |t − θ|, the bias falls faster than any power of w."""
    widths = np.array([4e-3, 2e-3, 1e-3, 5e-4])
    bias = np.abs(np.asarray(length(25.0, 0.03, 0.3, widths)[0]) - 25.789811275)
    rates = np.diff(np.log(bias)) / np.diff(np.log(widths))
    assert np.all(np.diff(rates) > 0)
    assert rates[-1] > 3


@pytest.mark.parametrize(
    ("n", "tallest", "softest"), [(300, 50.0, 1e-3), pytest.param(3000, 300.0, 1e-5, marks=pytest.mark.slow)]
)
def test_never_a_nan_in_value_or_gradient(n, tallest, softest):
    rng = np.random.default_rng(3)
    h, q, nu = rng.uniform(1.05, tallest, n), 10 ** rng.uniform(np.log10(softest), 0, n), rng.uniform(-0.9, 0.5, n)
    w = 10 ** rng.uniform(-6, 0, n)
    w[: n // 30], w[n // 30 : n // 15] = 1e-6, 1.0
    found, status = length(h, q, nu, w)
    assert np.all(status == Outcome.ARRESTED)
    assert np.isfinite(found).all()
    gradient = jax.jit(jax.vmap(jax.grad(lambda x: length(*x)[0])))(jnp.stack(list(map(jnp.asarray, (h, q, nu, w))), -1))
    assert np.isfinite(gradient).all()


def test_derivatives_forward_and_reverse_at_200_points():
    h, q, nu = random_sliders(200, 4)
    w = 10 ** np.random.default_rng(5).uniform(-2.3, 0, 200)
    points = jnp.stack(list(map(jnp.asarray, (h, q, nu, w))), -1)
    ways = jnp.asarray(np.random.default_rng(6).uniform(-1, 1, (200, 4))) * points
    f = jax.jit(jax.vmap(lambda x: length(*x)[0]))
    forward = jax.jit(jax.vmap(lambda x, v: jax.jvp(lambda y: length(*y)[0], (x,), (v,))[1]))(points, ways)
    gradient = jax.jit(jax.vmap(jax.grad(lambda x: length(*x)[0])))(points)
    step = 1e-5
    e = step * np.minimum(1, points[:, 3:] / 0.05)  # the narrower the rule, the sharper the bends
    difference = (8 * (f(points + e * ways) - f(points - e * ways)) - f(points + 2 * e * ways) + f(points - 2 * e * ways)) / 12
    difference = np.asarray(difference / e[:, 0])
    scale = np.abs(np.asarray(gradient * ways)).sum(-1) + 1e-3
    assert np.abs((forward - (gradient * ways).sum(-1)) / scale).max() < 1e-10
    assert np.abs((np.asarray(forward) - difference) / scale).max() < 1e-4
    assert np.all(np.abs(gradient).max(-1) > 0)


def test_chain_and_recursion_give_the_same_smooth_length():
    for height, width in [(10.0, 0.01), (25.0, 0.03), (25.0, 1e-3)]:
        found = in_a_chain(height, width, jnp.ones(120))
        np.testing.assert_allclose(found.length, length(height, 0.03, 0.3, width)[0], rtol=1e-9)


def test_rupture_of_a_chain_approaches_the_hard_one():
    rng = np.random.default_rng(7)
    threshold = jnp.asarray(1 + 0.01 * rng.uniform(-1, 1, 120))
    c = chain(sp.Slider(height=25.0, stiffness=0.03, poisson=0.3), sites=120, threshold=threshold)
    state, site = nucleate(c)
    exact = rupture(c, state, trigger=site)
    order = np.asarray(exact.order[: int(exact.breaks)])
    assert site == 0
    assert np.all(np.diff(order) == 1)  # one front from left to right: the case the sweep stands for
    n = len(order)
    over = np.append(exact.released[1:n] - threshold[1:n], exact.after.stress[n] - threshold[n])
    for width in (1e-4, 3e-5, 1e-6):
        tolerance = 20 * np.exp(-np.abs(over).min() / width) + 1e-9
        found = in_a_chain(25.0, width, threshold)
        assert found.status == Outcome.ARRESTED
        np.testing.assert_allclose(found.length, exact.length, atol=tolerance)
        np.testing.assert_allclose(found.slip, exact.slip, atol=tolerance)
        np.testing.assert_allclose(found.energy, exact.energy, rtol=tolerance)


def test_rupture_from_the_middle_of_a_chain_approaches_the_hard_one():
    """Contacts before the trigger are too strong to break; the length counts them all the same."""
    threshold = jnp.where(jnp.arange(120) < 5, 10.0, 1.0)
    c = chain(sp.Slider(height=25.0, stiffness=0.03, poisson=0.3), sites=120, threshold=threshold)
    state, site = nucleate(c)
    exact = rupture(c, state, trigger=site)
    assert site == 5
    assert exact.order[: int(exact.breaks)].tolist() == list(range(5, 5 + int(exact.breaks)))
    found = in_a_chain(25.0, 1e-6, threshold)
    assert exact.breaks > 10
    assert (found.breaks, found.extent) == (exact.breaks, exact.extent)
    np.testing.assert_allclose(found.length, exact.length, atol=1e-9)
    np.testing.assert_allclose(found.slip, exact.slip, atol=1e-9)


@pytest.mark.parametrize("quantity", ["length", pytest.param("energy", marks=pytest.mark.slow)])
def test_derivatives_of_a_smooth_rupture_in_every_threshold(quantity):
    rng = np.random.default_rng(8)
    threshold = jnp.asarray(1 + 0.03 * rng.uniform(-1, 1, 120))

    def f(threshold):
        return getattr(in_a_chain(25.0, 0.02, threshold), quantity)

    reverse = jax.jit(jax.grad(f))(threshold)
    way = jnp.asarray(rng.uniform(-1, 1, 120))
    forward = jax.jit(lambda: jax.jvp(f, (threshold,), (way,))[1])()
    h = 1e-5
    difference = (f(threshold + h * way) - f(threshold - h * way)) / (2 * h)
    np.testing.assert_allclose(reverse @ way, forward, rtol=1e-9)
    np.testing.assert_allclose(forward, difference, rtol=1e-5)
    assert (np.abs(reverse[:20]) > 0).all()  # contacts passed by the front, too, hold it back a little


def test_broadcasting_and_statuses():
    slider = sp.Slider(height=np.array([10.0, 25.0])[:, None], stiffness=np.array([0.03, 0.01, 0.003]), poisson=0.3)
    found, status = smooth_length(slider, SmoothBreak(width=0.01))
    assert found.shape == status.shape == (2, 3)
    np.testing.assert_allclose(found[1, 0], length(25.0, 0.03, 0.3, 0.01)[0], rtol=1e-13)
    found, status = smooth_length(slider, SmoothBreak(width=0.01), max_contacts=5)
    assert np.all(status == Outcome.LIMIT)
    assert np.isnan(found).all()
    found, status = length(-1.0, 0.03, 0.3, 0.01)
    assert status == Outcome.INVALID
    assert np.isnan(found)


def test_float32():
    h, q, nu = random_sliders(100, 9)
    exact = np.asarray(length(h, q, nu, np.full(100, 0.02))[0])
    with jax.enable_x64(False):
        single = [jnp.asarray(x, jnp.float32) for x in (h, q, nu, np.full(100, 0.02))]
        found, _ = length(*single)
        assert found.dtype == jnp.float32
    np.testing.assert_allclose(np.asarray(found), exact, rtol=1e-3)
