"""Derivatives of ℓ in every mode, against complex steps through an independent matrix program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import ended
from oracles import dense_chain

import slippulse_jax as sp
from slippulse_jax import Slider, precursor_length
from slippulse_jax.lengths import arrests

STEP = 1e-30


def length(theta):
    return precursor_length(Slider(theta[0], theta[1], theta[2]))


def length_of_each(theta):
    return precursor_length(Slider(*theta.T))


def complex_step_gradient(theta, count):
    """Exact derivative of the interpolated crossing of a front that breaks `count` contacts."""
    gradient = np.zeros(3)
    for i in range(3):
        moved = theta.astype(complex)
        moved[i] += 1j * STEP
        load, pinning = dense_chain.responses(*moved, sites=count + 4, right="semi-infinite", reach=count + 1)
        gradient[i] = dense_chain.crossing(dense_chain.front_stress(load, pinning, count + 1) - 1).imag / STEP
    return gradient


@pytest.fixture(scope="module")
def points():
    """200 random sliders with a domino, away from whole contacts, where the dense count may round the other way."""
    rng = np.random.default_rng(11)
    theta = np.stack([rng.uniform(3, 60, 400), 10 ** rng.uniform(-4, 0, 400), rng.uniform(0, 0.49, 400)], axis=1)
    ended = arrests(Slider(*theta.T))
    fraction = ended.length - np.floor(ended.length)
    chosen = np.nonzero((ended.length > 0) & (fraction > 1e-3) & (fraction < 1 - 1e-3))[0][:200]
    assert len(chosen) == 200
    return theta[chosen], ended.contacts_broken[chosen]


@pytest.fixture(scope="module")
def gradients(points):
    return np.asarray(jax.vmap(jax.grad(length))(points[0]))


@pytest.mark.ci
def test_gradient_at_200_points(points, gradients):
    theta, counts = points
    for i, count in enumerate(counts):
        expected = complex_step_gradient(theta[i], int(count))
        worst = np.abs(gradients[i] - expected) * theta[i] / np.abs(expected * theta[i]).max()
        assert worst.max() <= 1e-7, theta[i]


@pytest.mark.ci
def test_all_modes_agree(points, gradients):
    """Forward and reverse, of a batch and of one, mapped and not, are one derivative."""
    theta = points[0]
    tangents = np.random.default_rng(0).normal(size=theta.shape)
    _, along = jax.jvp(length_of_each, (theta,), (tangents,))
    np.testing.assert_allclose(along, (gradients * tangents).sum(axis=1), rtol=1e-10)
    value, gradient = jax.jit(jax.value_and_grad(length))(theta[0])
    np.testing.assert_allclose(gradient, gradients[0], rtol=1e-13)
    np.testing.assert_allclose(value, length(theta[0]), rtol=1e-13)
    np.testing.assert_allclose(jax.jacfwd(length)(theta[0]), gradients[0], rtol=1e-13)


@pytest.mark.slow
def test_hessian_in_every_order_of_modes(points):
    theta = points[0][:6]

    def both(first):
        """Second derivatives forward and in reverse over `first`, from one linearisation: hessian is forward over reverse."""
        gradient, push = jax.linearize(jax.vmap(first), theta)
        pull = jax.linear_transpose(push, theta)
        every = np.broadcast_to(np.eye(3)[:, None], (3, *theta.shape))
        return np.asarray(gradient), np.stack([push(x) for x in every], -1), np.stack([pull(x)[0] for x in every], -2)

    _, forward, reverse = both(jax.jacfwd(length))
    for other in (reverse, *both(jax.grad(length))[1:]):
        np.testing.assert_allclose(other, forward, rtol=1e-9)
    # and against differences of complex-step gradients, which know nothing of JAX
    for t, hessian, count in zip(theta, forward, points[1][:6], strict=True):
        for i in range(3):
            step = 1e-5 * t[i] * np.eye(3)[i]
            column = (complex_step_gradient(t + step, int(count)) - complex_step_gradient(t - step, int(count))) / (2 * step[i])
            np.testing.assert_allclose(hessian[i], column, rtol=1e-5, atol=1e-6 * np.abs(hessian * t[i] / t).max())


@pytest.mark.parametrize(("height", "most"), [(10, 2e-3), (25, 2e-4), pytest.param(100, 2e-4, marks=pytest.mark.ci)])
def test_slopes_pass_whole_contacts_without_a_jump(height, most):
    """dℓ/d ln k and its slope, from contact to contact; the jumps of the straight line were 0.2, 0.1 and 0.1."""
    log_k = np.linspace(np.log(0.2 / (2.6 * height)), np.log(8 / (2.6 * height)), 20001)
    found = sp.precursor_lengths(Slider(height, np.exp(log_k), 0.3), derivatives=1)
    slope = found.slider.stiffness * np.exp(log_k)
    assert np.abs(np.diff(slope, 2)).max() <= most
    whole = np.flatnonzero(np.diff(np.ceil(found.length)))[1:4]
    beside = log_k[whole[:, None] + np.arange(2)]
    bend = jax.vmap(jax.vmap(jax.hessian(lambda x: precursor_length(Slider(float(height), jnp.exp(x), 0.3)))))(beside)
    np.testing.assert_allclose(
        bend[:, 0], bend[:, 1], rtol=0.01, atol=0.01 * np.abs(found.slider.stiffness * np.exp(log_k)).max()
    )


@pytest.mark.ci
def test_finite_chain_has_derivatives_too():
    theta = np.array([25.0, 0.03, 0.3])

    def finite(theta):
        return precursor_length(ended(Slider(theta[0], theta[1], theta[2]), 100))

    got = jax.grad(finite)(theta)
    for i in range(3):
        moved = theta.astype(complex)
        moved[i] += 1j * STEP
        load, pinning = dense_chain.responses(*moved, sites=100, right="free", reach=29)
        expected = dense_chain.crossing(dense_chain.front_stress(load, pinning, 29) - 1).imag / STEP
        assert abs(got[i] / expected - 1) < 1e-8


@pytest.mark.ci
def test_float32_gradient(float32):
    theta = np.array([25.0, 0.01, 0.3])
    single = jax.grad(length)(jnp.asarray(theta, jnp.float32))
    with jax.enable_x64(True):
        double = jax.grad(length)(theta)
    np.testing.assert_allclose(single, double, rtol=1e-3)
