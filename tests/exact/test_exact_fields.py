"""The exact fields and front stress at many places at once, beside a dense chain."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.dense_chain import chain_matrix

import slippulse_jax as sp
from slippulse_jax.exact.front import exact_fields, exact_front_stress

FIG2 = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)


@pytest.mark.ci
@pytest.mark.parametrize("prestress", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])
def test_fields_behind_and_ahead_against_a_dense_chain(prestress):
    height, stiffness, poisson, sites = 12.0, 0.05, 0.2, 600
    slider = sp.Slider(height, stiffness, poisson)
    A, f = (
        chain_matrix(height, stiffness, poisson, sites, "clamped"),
        np.zeros(2 * sites),
    )  # the wall is too far away to be felt
    f[0] = 1.0
    unit = np.linalg.solve(A, f)
    load = (1 - prestress) / unit[sites]
    positions, site, pinned = [0, 1, 7, 14], np.arange(40), np.zeros(sites)
    fields = exact_fields(slider, np.array(positions)[:, None], site, sp.Interface(prestress))
    np.testing.assert_allclose(fields.upper[0, 0], load, rtol=1e-11)
    for s in range(15):
        f[0], f[sites:] = load, stiffness * pinned
        u = np.linalg.solve(A, f)
        carried = u[sites:] - pinned + prestress
        if s in positions:
            here = positions.index(s)
            np.testing.assert_allclose(fields.upper[here], u[:40], rtol=1e-11)
            np.testing.assert_allclose(fields.layer[here], u[sites : sites + 40], rtol=1e-11)
            # a contact broken under φ repins at zero stretch of the whole stress
            np.testing.assert_allclose(fields.stress[here], carried[:40], rtol=1e-10, atol=1e-13)
        pinned[s] += carried[s]


@pytest.mark.ci
def test_series_is_solved_once_for_all_positions():
    """One slider at many s: nothing with an axis of s goes through the loop over degrees."""
    positions = jnp.arange(7.0)
    program = str(jax.make_jaxpr(lambda s: exact_front_stress(FIG2, s))(positions))
    assert "f64[2,35]" in program
    assert not re.search(r"f64\[(7,2,35|2,7,35)\]", program)
    slider = sp.Slider(np.array([[10.0], [25.0]]), 0.03, 0.3)
    both = exact_front_stress(slider, positions)
    assert both.shape == (2, 7)
    np.testing.assert_allclose(both[1], exact_front_stress(FIG2, positions), rtol=1e-13)
