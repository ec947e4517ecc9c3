"""Static friction of a block: against its series and an independent program, and what it refuses."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.events.catalogue import EventClass

PUSH, FRICTION = sp.Push(0.15, 0.1), 0.35
NONE_KEPT = sp.Interface(residual_strength=0.0)


def of_b(height, lengths, b, **more):
    return sp.Block(height, b / (2.6 * height), 0.3, PUSH, length=round(lengths * height), **{"friction": FRICTION, **more})


def dense(height, lengths, b, kept=0.0):
    """Force over that of friction as each event begins, and contacts up to the farthest that it breaks, until it is the last.

    By the finite elements of `fit_examples`, which share no code or mesh with the package.
    """
    from independent_block import responses

    contacts = round(lengths * height)
    push, response, push_lost, lost = responses(
        height, contacts, 0.1 * height, 0.2 * height, b / (2.6 * height), 0.3, 1.2
    )  # fmt: skip
    stress, relief, forces, reach = np.zeros(contacts), np.zeros(contacts), [], []
    rate = push + FRICTION * push_lost
    while not reach or reach[-1] < contacts:
        lacking = 1 - stress - FRICTION * relief
        rises = np.where(rate > 0, lacking / np.where(rate > 0, rate, 1), np.inf)
        j, coulomb = int(np.argmin(rises)), np.inf
        stress, relief = stress + rises[j] * push, relief + rises[j] * push_lost
        forces.append(stress.mean())
        broken = []
        while coulomb >= 1:
            broken.append(j)
            released = stress[j] - kept * (1 - FRICTION * relief[j])
            stress, relief = stress + response[:, j] * released, relief + lost[:, j] * released
            stress[j] -= released
            j = int(np.argmax(stress + FRICTION * relief))
            coulomb = stress[j] + FRICTION * relief[j]
        reach.append(max(broken) + 1)
    return np.array(forces), np.array(reach)


CASES = [  # H/λc, L/H, b, r
    *((16, lengths, 0.3, 0.0) for lengths in (1, 2, 3, 4)),
    *((24, 3, 1.0, kept) for kept in (0.0, 0.2, 0.5, 0.7, 0.9)),
    (16, 1, 1.0, 0.0), (16, 2, 0.1, 0.0), (16, 3, 3.0, 0.6),
]  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("case", CASES, ids=str)
def test_against_finite_elements_that_share_no_code(case, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "fit_examples")
    *block, kept = case
    forces, _ = dense(*case)
    found = sp.static_friction(of_b(*block), sp.Interface(residual_strength=kept), events=2000)
    assert float(found) == pytest.approx(forces.max(), rel=5e-4)


BLOCK = of_b(8, 2, 1.0)
"""Of sixteen contacts."""


@pytest.mark.parametrize("ageing", [None, pytest.param(sp.Ageing(0.6, 0.5), marks=pytest.mark.ci)])
def test_it_is_the_largest_force_of_the_catalogue(ageing):
    """Up to the event that spans, which need not begin at the largest force."""
    catalogue = sp.series(BLOCK, events=128, interface=NONE_KEPT, ageing=ageing)
    assert catalogue.status == Outcome.SPANNED
    table = catalogue.table()
    last = int(np.argmax(table["kind"] == EventClass.SPANNING))
    forces = table["force_before"][: last + 1] / (BLOCK.sites * BLOCK.stiffness)
    assert forces.max() > 1.01 * forces[-1]
    found = sp.static_friction(BLOCK, NONE_KEPT, ageing=ageing, events=128)
    assert found.shape == ()
    assert float(found) == pytest.approx(forces.max(), rel=1e-12)


def test_too_few_events():
    """Contacts that keep nearly all creep through hundreds of events."""
    with pytest.raises(NotConverged, match=r"no front spans Block\(.*after 128 events"):
        sp.static_friction(BLOCK, sp.Interface(residual_strength=0.99), events=128)


@pytest.mark.ci
def test_as_many_events_as_needed():
    """None given: 8 per contact, and four times as many until the block slides."""
    assert float(sp.static_friction(BLOCK)) == pytest.approx(float(sp.static_friction(BLOCK, NONE_KEPT)), rel=1e-12)
    kept, most = sp.Interface(residual_strength=0.97), 128 * BLOCK.sites
    needed = int(sp.series(BLOCK, events=most, interface=kept).number)
    assert 8 * BLOCK.sites < needed < most
    assert float(sp.static_friction(BLOCK, kept)) == pytest.approx(
        float(sp.static_friction(BLOCK, kept, events=most)), rel=1e-12
    )


@pytest.mark.ci
def test_jit_and_vmap_over_what_contacts_keep():
    """It rises, and tends to 1: contacts that keep nearly all share the load. NaN where the events are too few."""
    kept = jnp.array([0.0, 0.2, 0.5, 0.7, 0.9, 0.97, 0.9999])
    of_r = jax.jit(jax.vmap(lambda r: sp.static_friction(BLOCK, sp.Interface(residual_strength=r), events=1024)))
    found = np.asarray(of_r(kept))
    assert np.isnan(found).tolist() == [False] * 6 + [True]
    assert (np.diff(found[1:6]) > 0).all()
    assert 0.97 < found[5] < 1
    for r, one in zip(kept[:6], found, strict=False):
        alone = sp.static_friction(BLOCK, sp.Interface(residual_strength=r), events=1024)
        assert float(alone) == pytest.approx(one, rel=1e-12)


def test_of_a_slider():
    """Its catalogue; pushed at its left edge, of contacts that all carry σ_s: in (0, 1)."""
    slider = sp.Slider(8.0, 0.05, 0.3, length=16)
    catalogue = sp.series(slider, events=128)
    assert catalogue.status == Outcome.SPANNED
    found = float(sp.static_friction(slider, events=128))
    assert found == pytest.approx(np.nanmax(catalogue.force_before) / (16 * 0.05), rel=1e-12)
    assert 0.3 < found < 1


@pytest.mark.ci
def test_soft_contacts_share_the_load():
    """On contacts that give way, a block is rigid, and without a tilt all contacts break at once."""
    assert float(sp.static_friction(of_b(8, 2, 1e-4, friction=None), NONE_KEPT, events=128)) == pytest.approx(1, abs=2e-3)


def test_refusals():
    with pytest.raises(ValueError, match=r"sites = None: .* states no end"):
        sp.static_friction(sp.Block(8.0, 0.05, 0.3, PUSH))
    with pytest.raises(ValueError, match=r"push.control = 'force'"):
        sp.static_friction(sp.Block(8.0, 0.05, 0.3, sp.Push(0.15, 0.1, "force"), length=16))
    with pytest.raises(ValueError, match="Ageing.newborn = 0.3 beside residual_strength = 0.5"):
        sp.static_friction(BLOCK, sp.Interface(residual_strength=0.5), ageing=sp.Ageing(0.3, 1.0))
    with pytest.raises(TypeError, match="interface"):
        sp.static_friction(BLOCK, 0.5)  # pyright: ignore[reportArgumentType]
