"""Crack-like first precursors: closed form against chains solved densely, the macroscopic limit, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.sliding_chain import dense, nucleated

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.exact import crack
from slippulse_jax.theory import macroscopic_crack_length

SLIDERS = [(25.0, 0.03, 0.3, 0.3, 0.0), (25.0, 0.03, 0.3, 0.0, 0.0), (10.0, 0.1, 0.2, 0.2, 0.1), (50.0, 0.003, 0.4, 0.6, -0.2),
           (8.0, 0.5, 0.0, 0.1, 0.15)]  # fmt: skip


@jax.jit
def stresses_ahead(slider, ratio):
    return jax.vmap(lambda n: crack.stress_ahead(slider, ratio, n))(jnp.arange(1.0, 101))


@jax.jit
def fields_after(slider, friction, prestress, slides):
    return jax.vmap(lambda i: crack.fields(slider, friction, prestress, slides, i))(jnp.arange(300.0))


@pytest.mark.parametrize(("height", "q", "nu", "friction", "prestress"), SLIDERS)
def test_front_is_that_of_a_dense_chain(height, q, nu, friction, prestress):
    """The chain is broken contact by contact; its end is some forty decay lengths away."""
    sites = int(40 / float(sp.Slider(height, q, nu).kappa_2)) + 200
    load = nucleated(height, q, nu, prestress, sites)
    slides, ahead, layer, stress = 0, [1.0], np.zeros(sites), np.zeros(sites)
    while ahead[-1] >= 1 - 1e-12:
        slides += 1
        _, layer, stress = dense(height, q, nu, friction, prestress, slides, load, sites)
        ahead.append(stress[slides])
        assert stress[slides + 1 :].max() < max(stress[slides], 1)
    slider = sp.Slider(height, q, nu)
    ratio = jnp.asarray((friction - prestress) / (1 - prestress))
    found = stresses_ahead(slider, ratio)[:slides]
    np.testing.assert_allclose(prestress + (1 - prestress) * found, ahead[1:], rtol=0, atol=1e-11)

    length = float(sp.exact_length(slider, sp.Interface(prestress=prestress), rule=sp.CrackLike(friction)))
    assert np.ceil(length) == slides
    here = crack.sliding(slider, ratio, jnp.asarray(length))[0](jnp.asarray(length))[1]
    assert float(here) == pytest.approx(1, abs=1e-12)

    slip, carried = fields_after(slider, friction, prestress, float(slides))
    before = dense(height, q, nu, 0, 0, 0, load, sites)[1]
    np.testing.assert_allclose(carried[: 3 * slides], stress[: 3 * slides], atol=1e-10)
    np.testing.assert_allclose(slip[: 3 * slides], (layer - before)[: 3 * slides], atol=1e-10)


@pytest.mark.parametrize("friction", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("b", [0.05, 0.5, 2.0, 10.0])
def test_macroscopic_limit(b, friction):
    """As √(λc/H) → 0, by Richardson's extrapolation; and derived by hand, not from the lattice."""
    nu = 0.25
    heights = 10.0 ** np.array([6, 6.6, 7.2])
    found = [float(sp.exact_length(sp.Slider(H, b / (2 * (1 + nu) * H), nu), rule=sp.CrackLike(friction))) / H for H in heights]
    x = heights**-0.5
    limit = np.polyfit(x, found, 2)[-1]
    assert float(macroscopic_crack_length(b, nu, friction)) == pytest.approx(limit, rel=2e-4)


def test_without_friction_there_is_no_ceiling():
    b = 1e4
    assert float(macroscopic_crack_length(b, 0.3, 0.0)) == pytest.approx(np.sqrt(2.6 * b), rel=0.02)
    assert float(macroscopic_crack_length(b, 0.3, 0.0)) > 100 * float(sp.theory.length_ceiling(0.3))


@pytest.mark.ci
def test_friction_as_strong_as_the_contacts_stops_at_once():
    lengths = sp.exact_length(sp.Slider(25.0, 0.03, 0.3), rule=sp.CrackLike(jnp.array([0.5, 0.9, 0.97, 0.999])))
    assert list(np.diff(lengths) < 0) == [True, True, True] or lengths[-1] == 0
    assert float(lengths[-1]) == 0  # the neighbour of contact 0 holds


@pytest.mark.ci
def test_prestress_above_the_friction_runs_away():
    slider = sp.Slider(25.0, 0.03, 0.3)
    length, status = jax.jit(crack.length)(slider, 0.0, 0.6)
    assert (float(length), int(status)) == (np.inf, Outcome.RUN_AWAY)
    # without a bound the stress at the tip grows with its distance
    far = jax.jit(jax.vmap(crack.stress_ahead, (None, None, 0)))(slider, -1.5, jnp.array([500.0, 1000.0, 2000.0]))
    np.testing.assert_allclose(np.diff(far)[1] / np.diff(far)[0], 2, rtol=0.01)


@pytest.mark.ci
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_against_differences(mode):
    at = jnp.array([40.0, 0.004, 0.3, 0.35, 0.1])

    def length(x):
        return sp.exact_length(sp.Slider(*x[:3]), sp.Interface(prestress=x[4]), rule=sp.CrackLike(x[3]))

    step = 1e-5 * np.maximum(np.abs(at), 1e-2)
    around = [(length(at + d) - length(at - d)) / (2 * d.sum()) for d in np.diag(step)]
    np.testing.assert_allclose(mode(length)(at), around, rtol=1e-6)


@pytest.mark.ci
def test_a_simulation_with_strong_damping_stops_there():
    """With inertia, and contacts that repin when their slip rate vanishes: far from both ends of what claim C15 compares."""
    slider = sp.Slider(25.0, 0.03, 0.3)
    chain = sp.chain(slider, sites=200)
    state, first = sp.nucleate(chain)
    motion = sp.simulate_inertial(chain, state, rule=sp.CrackLike(0.5), duration=4000.0, damping=3.0, trigger=first)
    length = float(sp.exact_length(slider, rule=sp.CrackLike(0.5)))
    assert abs(int(motion.extent) - length) < 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rule": 1.0}, r"CrackLike.friction = 1: must be 0 or more"),
        ({"rule": -0.1}, r"CrackLike.friction = -0.1: must be 0 or more"),
        ({"rule": 0.3, "interface": sp.Interface(threshold_slope=1e-3)}, r"level thresholds only"),
    ],
)
def test_refusals(arguments, message):
    arguments["rule"] = sp.CrackLike(arguments["rule"])
    with pytest.raises(ValueError, match=message):
        sp.exact_length(sp.Slider(25.0, 0.03, 0.3), **arguments)
