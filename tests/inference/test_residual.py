"""What contacts keep, in fits: values and errors of independent programs, derivatives, refusals, words."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.dense_chain import crossing, front_stress, responses
from reports import unfolded

import slippulse_jax as sp
from slippulse_jax.front.front import slip_and_stress
from slippulse_jax.inference.mechanism import pulse_or_crack
from slippulse_jax.inference.model.inputs import Inputs, interface_of
from slippulse_jax.inference.model.models import front_for
from slippulse_jax.inference.result.verdict import GIVEN, Identifiability

TABLES = Path(__file__).parent / "tables"
HEIGHTS = np.array([100, 130, 170, 210, 250, 300.0])
BOTH = ["stiffness", "residual_strength"]


def dense_lengths(heights, stiffness, kept, prestress=0.0):
    """ℓ of contacts that keep some, by dense matrices."""
    found = []
    for height in heights:
        load, pinning = responses(height, stiffness, 0.3, 900, "semi-infinite", 400)
        stress = front_stress(load, pinning, 400, prestress, kept)
        s0 = int(np.argmax(stress[1:] < 1)) + 1
        found.append(crossing(np.append(0, stress[1 : s0 + 1] - 1)))
    return np.array(found)


def six(b=0.3, kept=0.2, noise=0.0, seed=0, **more):
    """Six lengths of 1 %, each at its height."""
    length = dense_lengths(HEIGHTS, b / (2.6 * 200), kept)
    error = 0.01 * length
    measured = length + noise * error * np.random.default_rng(seed).standard_normal(6)
    return sp.Measurements(height=HEIGHTS, poisson=0.3, length=measured, length_sigma=error, **more)


@pytest.fixture(scope="module")
def lengths():
    return sp.fit(six(), BOTH)


def test_six_lengths(lengths):
    """The truth without noise; errors as a regression on an independent program has them; and what r = 0 would say."""
    assert lengths.values["stiffness"] == pytest.approx(0.3 / 520, rel=1e-5)
    assert lengths.values["residual_strength"] == pytest.approx(0.2, abs=1e-5)
    assert lengths.stderrs["stiffness"] / lengths.values["stiffness"] == pytest.approx(0.15, rel=0.1)
    assert lengths.stderrs["residual_strength"] == pytest.approx(0.047, rel=0.1)
    known = sp.fit(six(), fixed={"residual_strength": 0.2})
    assert known.stderrs["stiffness"] / known.values["stiffness"] == pytest.approx(0.012, rel=0.1)
    none = sp.fit(six())
    assert none.values["stiffness"] == pytest.approx(0.3 / 520 / 1.89, rel=0.1)
    assert none.identifiability is Identifiability.IDENTIFIED, "nothing looks wrong"


def test_a_column_states_it():
    stated = sp.fit(six(residual_strength=np.full(6, 0.2)))
    held = sp.fit(six(), fixed={"residual_strength": 0.2})
    assert stated.values["stiffness"] == pytest.approx(held.values["stiffness"], rel=1e-9)
    assert stated.deviance == pytest.approx(held.deviance, abs=1e-9)


@pytest.mark.parametrize("event", ["domino", "full"])
def test_prestress_of_the_same_lengths(event):
    """(φ − r)/(1 − r) is all that lengths know; beyond −1 too."""
    m = six(b=3.0, kept=0.2) if event == "full" else six()
    for kept, phi in ((0.2, 0.0), (0.3, 0.1), (0.7, 0.2)):
        one = sp.fit(m, fixed={"residual_strength": kept, "prestress": phi}, event=event)
        if (same := (phi - kept) / (1 - kept)) > -0.95:
            other = sp.fit(m, fixed={"prestress": same}, event=event)
            assert one.deviance == pytest.approx(other.deviance, abs=1e-6)
            assert one.values["stiffness"] == pytest.approx(other.values["stiffness"], rel=1e-6)
        assert np.isfinite(one.deviance)
    far = interface_of(np.array([-0.5, -0.99, -1.5, -40.0, 0.3]))
    assert far.equivalent_prestress == pytest.approx([-0.5, -0.99, -1.5, -40.0, 0.3], rel=1e-12)


@pytest.mark.parametrize("more", [{}, {"block_length": 900.0}, {"machine_stiffness": 1.0}], ids=str)
def test_derivatives(more):
    """Objective under grad, jit and vmap; slopes and curvature against differences."""
    m = six(**{name: np.full(6, x) for name, x in more.items()})
    density = sp.objective(m, BOTH)

    def cost(x):
        return density({"stiffness": x[0], "residual_strength": x[1]})

    with jax.enable_x64(True):
        at = jnp.array([np.log(5e-4), 0.25])
        gradient, hessian = jax.jit(jax.grad(cost))(at), jax.hessian(cost)(at)
        for i, h in enumerate((1e-6, 1e-6)):
            step = h * jnp.eye(2)[i]
            assert gradient[i] == pytest.approx(float(cost(at + step) - cost(at - step)) / (2 * h), rel=1e-5)
            bend = (jax.grad(cost)(at + step) - jax.grad(cost)(at - step)) / (2 * h)
            assert np.asarray(hessian[i]) == pytest.approx(np.asarray(bend), rel=1e-3, abs=1e-4 * float(abs(hessian[i]).max()))
        other = at + jnp.array([0.02, 0.1])
        assert jax.vmap(cost)(jnp.stack([at, other])) == pytest.approx([float(cost(at)), float(cost(other))], rel=1e-12)


def test_lengths_of_every_model():
    """Inputs with r against one length at a time, by another door."""
    height, ratio, kept = np.array([60.0, 150.0]), np.array([2e-3, 4e-3]), np.array([0.15, 0.6])
    inputs = Inputs.of(height, ratio, 0.3, 0.1).given(residual_strength=kept)
    contacts = sp.Interface(0.1, residual_strength=kept)
    for event in ("domino", "full"):
        found = (
            front_for("slider", event).lengths(inputs)
            if event == "domino"
            else front_for("slider", event, six()).lengths(inputs)
        )
        assert found == pytest.approx(sp.precursor_lengths(sp.Slider(height, ratio, 0.3), contacts, event=event), rel=1e-3)
    pushed = inputs.given(
        log_push=np.log([0.25, 0.25]), log_push_width=np.full(2, np.inf), friction=np.zeros(2), push_force=np.zeros(2),
        log_normal_stiffness=np.full(2, np.inf), multicontact=np.zeros(2), top_held=np.zeros(2),
    )  # fmt: skip
    table = six(push_height=0.25 * HEIGHTS, prestress=np.full(6, 0.1))
    found = front_for("block", "full", table).lengths(pushed)
    for i in (0, 1):
        block = sp.Block(height[i], ratio[i], 0.3)
        own = sp.precursor_length(block, sp.Interface(0.1, residual_strength=kept[i]), event="full")
        assert found[i] == pytest.approx(float(own), rel=0.03)


def test_gauges_behind_the_tip():
    """Slip and stress of the record of a front."""
    slider, contacts = sp.Slider(60.0, 4e-3, 0.3), sp.Interface(0.1, residual_strength=0.35)
    record = sp.first_precursor(slider, contacts, sites=128)
    count = jnp.asarray(float(record.contacts_broken))
    slip, stress = slip_and_stress(slider, jnp.asarray(0.1), count, 128, 0.35)
    assert slip == pytest.approx(np.asarray(record.slip), abs=1e-10)
    assert stress == pytest.approx(np.asarray(record.stress), abs=1e-10)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "truth", "within"),
    [
        ("residual_places", (3.077e10, 0.35, 0.3), (0.12, 0.03, 0.05)),
        ("residual_events", (5.769e10, 0.35, 0.15), (np.inf, np.inf, np.inf)),
    ],
)
def test_sequences_of_a_dense_program(name, truth, within):
    """Stiffness, friction and r from forces by place and by event: inside the 95 % intervals, and near."""
    result = sp.fit(sp.read_measurements(TABLES / f"{name}.csv"), ["stiffness", "friction", "residual_strength"])
    assert result.identifiability in GIVEN
    for i, label in enumerate(("areal_stiffness", "friction", "residual_strength")):
        assert any(piece.low < truth[i] < piece.high for piece in result.intervals[label][0.95]), label
        off = abs(result.values[label] - truth[i]) / (1 if i == 2 else truth[i])
        assert off < within[i], label
    if name == "residual_places":
        none = sp.fit(sp.read_measurements(TABLES / f"{name}.csv"))
        assert none.p_value < 0.2, "with r = 0 the fit need not look wrong"
        assert none.values["areal_stiffness"] > 1.5 * truth[0], "and the stiffness is off by a factor"


def test_words(lengths):
    """The row of what would move it, its size by a fit of one's own, and the sentence for a paper."""
    none = sp.fit(six(kept=0.0))
    row = next(one for one in none.changes if one.name == "residual_strength")
    assert row.what == "contacts that keep 10 % of their strength"
    own = sp.fit(six(kept=0.0), fixed={"residual_strength": 0.1})
    assert np.exp(row.moves["stiffness"][0]) == pytest.approx(own.values["stiffness"] / none.values["stiffness"], rel=1e-3)
    assert np.exp(row.moves["stiffness"][0]) == pytest.approx(1.33, rel=0.02)
    text = "With contacts that keep 10 % of their strength as they break, k/K would be 1.3"
    assert text in none.methods()
    assert "contacts that keep 10 % of their strength" in unfolded(none.report())
    assert "contacts that keep" not in lengths.report(), "it is fitted"
    held = sp.fit(six(), fixed={"residual_strength": 0.2})
    assert any(one.what == "contacts that keep 30 % of their strength" for one in held.changes)


def test_refusals():
    m = six()
    with pytest.raises(ValueError, match=r"lengths determine only \(φ − r\)/\(1 − r\): hold one"):
        sp.fit(m, [*BOTH, "prestress"])
    sp.fit(m, [*BOTH, sp.Parameter("prestress", prior=(0.0, 0.05))])
    with pytest.raises(ValueError, match="threshold_slope beside residual_strength"):
        sp.fit(m, BOTH, fixed={"threshold_slope": 1e-4})
    with pytest.raises(ValueError, match="residual_strength: no part of the model, of a first crack-like precursor"):
        sp.fit(m, [*BOTH, "friction"], event="crack")
    with pytest.raises(ValueError, match="leave out residual_strength"):
        sp.fit(six(residual_strength=np.full(6, 0.1)), ["stiffness", "friction"], event="crack")
    with pytest.raises(ValueError, match=r"residual_strength.*must lie in \[0, 1\)"):
        six(residual_strength=np.full(6, 1.0))
    with pytest.raises(ValueError, match=r"residual_strength = 1 means r = 1 .*must lie in \[0, 0.999\)"):
        sp.fit(m, fixed={"residual_strength": 1.0})
    with pytest.raises(ValueError, match="takes contacts that lose everything"):
        sp.recover_profile(six(residual_strength=np.full(6, 0.1)), stiffness=5e-4)
    places = sp.read_measurements(TABLES / "residual_places.csv")
    with pytest.raises(ValueError, match=r"newborn = 0.4: a new contact is weaker than the share 0.5 of its strength"):
        sp.fit(places, ["stiffness", "friction"], fixed={"residual_strength": 0.5, "newborn": 0.4})


@pytest.mark.parametrize("how", [{"fixed": {"residual_strength": 0.2}}, {"free": BOTH}])
def test_designs_take_what_contacts_keep_from_tables_alone(how):
    """Held, or fitted; and a table that does not state it has it from the fit."""
    known = sp.Knowledge.from_fit(sp.fit(six(), **how))
    assert known.more["residual_strength"] @ known.weight == pytest.approx(0.2, abs=0.05)
    with pytest.raises(ValueError, match="only candidates that are tables take"):
        sp.design(known, height=[100.0, 200.0], sigma=1.0)
    assert np.isfinite(sp.design(known, {"again": six()}).information).all()


def test_what_lengths_cannot_tell_is_not_suggested():
    """A prestress instead of what contacts keep, not beside it."""
    pulled = six()
    length = np.asarray(sp.precursor_length(sp.Slider(HEIGHTS, 0.3 / 520, 0.3), sp.Interface(0.4)))
    found = sp.fit(dataclasses.replace(pulled, length=length, length_sigma=0.01 * length), BOTH)
    assert found.identifiability is Identifiability.POOR_FIT
    report = found.report()
    assert 'free=["stiffness", "prestress"]' in report
    assert '"residual_strength", "prestress"' not in report


@pytest.mark.ci
def test_pulse_or_crack_of_lengths():
    """Each with what it leaves free: lengths cannot tell."""
    found = pulse_or_crack(six(noise=1.0), simulations=20)
    assert [*found.pulse.values] == BOTH
    assert [*found.crack.values] == ["stiffness", "friction"]
    assert "lengths alone cannot separate a pulse from a crack" in found.statement
