"""Pictures of blocks: the stress in them as the front passes, and schematics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

import slippulse_jax as sp
from slippulse_jax.blocks.event import stages

BLOCK = sp.Block(20.0, 0.02, 0.3, sp.Push(0.4))


@pytest.fixture(scope="module")
def found():
    with jax.enable_x64(True):
        return sp.first_precursor(BLOCK)


def test_stresses_from_nucleation_to_the_end(found):
    with jax.enable_x64(True):
        first, half, last = range(3)
        breaks = jnp.array([0, int(found.breaks) // 2, int(found.breaks)])
        contact, threshold, shear = stages(BLOCK, None, found.stress.size, breaks, found.event)
    np.testing.assert_allclose(contact[first], found.stress_before, atol=1e-12)
    np.testing.assert_allclose(contact[last], found.stress, atol=1e-12)
    assert np.max(contact[half]) > 1
    assert np.all(threshold == 1)
    # over a contact the lowest cell carries what the contact does, away from the corner and the jump at the front
    near = np.abs(np.asarray(shear)[:, 2:, 0] - np.asarray(contact)[:, 2:])
    assert near[first].max() < 0.02
    assert np.median(near[[half, last]]) < 0.005
    # and the free top none, but for half a cell
    assert np.abs(shear[:, :, -1]).max() < 0.1 * np.abs(shear).max()


def test_pictures(found):
    with jax.enable_x64(True):
        for breaks in (0, None):
            ax = sp.plot.block_stress(found, breaks, ax=Figure().subplots())
            assert ax.get_title() == ("at nucleation" if breaks == 0 else f"{int(found.breaks)} breaks")
        with pytest.raises(ValueError, match="breaks = 999: this event has 0 to"):
            sp.plot.block_stress(found, 999)


@pytest.mark.slow
def test_a_movie(tmp_path):
    with jax.enable_x64(True):
        sp.plot.animate(sp.first_precursor(sp.Block(6.0, 0.1, 0.3, sp.Push(0.4))), tmp_path / "block.gif")
    assert (tmp_path / "block.gif").read_bytes().startswith(b"GIF")


@pytest.mark.parametrize(
    "body", [sp.Slider(25.0, 0.03, 0.3), sp.Block(100.0, 3e-3, 0.3), sp.Block(100.0, 3e-3, 0.3, sp.Push(0.5, 0.2, "force"))]
)
def test_schematics(body):
    ax = sp.plot.schematic(body, ax=Figure().subplots())
    said = {text.get_text() for text in ax.texts}
    assert r"$\lambda_c$" in said
    assert ("$u_y = 0$ along the interface" in said) == isinstance(body, sp.Block)
    with pytest.raises(ValueError, match="one body, not a batch"):
        sp.plot.schematic(sp.Slider(np.array([25.0, 30.0]), 0.03, 0.3))
