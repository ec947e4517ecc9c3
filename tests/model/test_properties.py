"""What holds of every slider, interface and chain, whatever hypothesis draws: against dense solves, and of the package by itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import strategies
from hypothesis import assume, given
from hypothesis import strategies as st
from oracles import dense_chain

import slippulse_jax as sp
from slippulse_jax.base import domains

pytestmark = pytest.mark.ci

SITES = 80


@jax.jit
def length(numbers):
    return sp.precursor_length(sp.Slider(numbers[0], numbers[1], numbers[2]), interface=sp.Interface(numbers[3], numbers[4]))


@given(strategies.sliders(), strategies.interfaces())
def test_length_of_any_slider_by_dense_solves(slider, interface):
    phi, slope = interface
    theta = 1 + slope * np.arange(SITES)
    count, excess, *_ = dense_chain.front(*slider, theta, np.full(SITES, phi), 0, SITES)
    assume(count < SITES)
    found = float(length(jnp.array([*slider, *interface])))
    assert abs(found - (dense_chain.crossing(excess) if count > 1 else 0)) < 1e-8
    assert max(np.ceil(found), 1) == count


@jax.jit
def profile_length(slider, theta, phi):
    return sp.precursor_length(sp.Slider(slider[0], slider[1], slider[2]), interface=sp.Profile(theta, phi))


@given(strategies.sliders(), strategies.profiles(40))
def test_length_on_any_profile_by_dense_solves(slider, profile):
    """Beyond its last value the profile is uniform."""
    theta, phi = (np.append(x, np.full(SITES - 40, x[-1])) for x in profile)
    count, excess, *_ = dense_chain.front(*slider, theta, phi, 0, SITES)
    assume(count < SITES)
    found = float(profile_length(jnp.array(slider), *map(jnp.asarray, profile)))
    assert abs(found - (dense_chain.crossing(excess, degree=1) if count > 1 else 0)) < 1e-8


@given(strategies.sliders(strategies.SLIDER), st.floats(0.5, 2.0))
def test_only_ratios_count(slider, unit):
    """Twice the correlation length on twice the block of the same material and areal stiffness halved: the same slider."""
    height, stiffness, poisson = slider
    lc, young = 1e-5 * unit, 3e9
    made = sp.Slider.from_material(
        height=height * lc, correlation_length=lc, areal_stiffness=stiffness * young / lc, poisson=poisson, young=young
    )
    np.testing.assert_allclose([float(made.height), float(made.stiffness)], [height, stiffness], rtol=1e-12)


NAMES = {"height": domains.HEIGHT, "stiffness": domains.STIFFNESS, "poisson": domains.POISSON}


@given(strategies.sliders(strategies.SLIDER), st.sampled_from(list(NAMES)), st.data())
def test_numbers_outside_their_domain_are_refused_or_nan(slider, name, data):
    """Refused by name where they can be looked at; NaN, and never a number, where they are traced."""
    values = dict(zip(NAMES, slider, strict=True)) | {name: data.draw(strategies.outside(NAMES[name]))}
    with pytest.raises(ValueError, match=f"{name} = "):
        sp.Slider(**values)
    assert np.isnan(length(jnp.array([*values.values(), 0.0, 0.0])))
