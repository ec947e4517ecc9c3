"""Pictures draw what they are given on the Axes they are given, with a unit on every axis."""

import jax.numpy as jnp
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest
from chains import ended

import slippulse_jax as sp
from slippulse_jax import plot
from slippulse_jax.bodies.chain import chain
from slippulse_jax.events.rupture import nucleate, rupture
from slippulse_jax.front.sensitivity import sensitivity
from slippulse_jax.plot.labels import KEPT

FIG2 = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)


@pytest.fixture(scope="module")
def event():
    c = chain(FIG2, sites=80)
    state, site = nucleate(c)
    return c, rupture(c, state, trigger=site)


@pytest.fixture
def ax():
    figure, ax = plt.subplots()
    yield ax
    plt.close(figure)


def has_units(ax, across, up):
    return across in ax.get_xlabel() and up in ax.get_ylabel()


def test_displacements(ax, event):
    _, found = event
    plot.displacements(found.after, before=found.before, sites=40, ax=ax)
    assert has_units(ax, "lambda_c", "u_s")
    assert len(ax.lines) == 4
    np.testing.assert_array_equal(ax.lines[3].get_ydata(), found.after.layer[:40])


def test_stress(ax, event):
    c, found = event
    plot.stress(found.after, chain=c, before=found.before, ax=ax)
    assert has_units(ax, "lambda_c", "sigma_s")
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), found.after.stress)


@pytest.mark.parametrize("kept", [0.0, 0.3])
def test_what_contacts_keep(ax, event, kept):
    """A line at r θ, of a chain and of a front, where contacts keep something."""
    weaker = chain(FIG2, sites=80, threshold=np.linspace(1, 1.1, 80), residual_strength=kept)
    plot.stress(event[1].after, chain=weaker, sites=40, ax=ax)
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    assert list(lines) == ["stress", "threshold", *[KEPT] * (kept > 0)]
    if kept:
        np.testing.assert_allclose(lines[KEPT], 0.3 * np.linspace(1, 1.1, 80)[:40])
    assert [text.get_text() for text in ax.get_legend().get_texts()] == list(lines)
    ax.clear()
    plot.front_stress(np.array([1.0, 1.1, 0.9]), length=1.5, threshold=1.05, residual_strength=kept, ax=ax)
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    assert (KEPT in lines) == (kept > 0)
    if kept:
        np.testing.assert_allclose(lines[KEPT], 0.3 * 1.05)


def test_front_stress(ax, event):
    _, found = event
    plot.front_stress(found.released[:26], length=float(found.length), ax=ax)
    assert has_units(ax, "lambda_c", "sigma_s")
    assert "25.79" in ax.lines[2].get_label()


def test_break_order(ax, event):
    _, found = event
    plot.break_order(found, ax=ax)
    assert has_units(ax, "lambda_c", "breaks")
    np.testing.assert_array_equal(ax.collections[0].get_offsets()[:, 0], np.arange(26))


def test_sensitivity(ax):
    plot.sensitivity(sensitivity(FIG2, sites=60), sites=32, ax=ax)
    assert has_units(ax, "lambda_c", "sigma_s")
    assert jnp.allclose(ax.patches[5].get_height(), 0)


def test_precursors_of_another_body_are_refused():
    """A short chain breaks to its end; one of fewer contacts cannot have had that event."""
    long, short = (sp.chain(ended(sp.Slider(10.0, 0.03, 0.3), sites)) for sites in (40, 20))
    catalogue = sp.series(long, events=10)
    reached = int(catalogue.extent.max())
    assert reached > 20
    sp.plot.precursors(catalogue, long)
    with pytest.raises(ValueError, match=f"body has 20 contacts, and the catalogue an event of {reached}"):
        sp.plot.precursors(catalogue, short)
