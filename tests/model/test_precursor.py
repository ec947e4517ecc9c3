"""Records and batches: what they hold."""

import jax
import numpy as np
import pytest
from chains import ended
from oracles import dense_chain

from slippulse_jax import Profile, Slider, SmoothBreak, first_precursor, precursor_length, precursor_lengths
from slippulse_jax import lengths as bulk
from slippulse_jax.base.status import Outcome
from slippulse_jax.bulk.chunks import over_lanes
from slippulse_jax.front.arrest import MOST_BREAKS, Arrest
from slippulse_jax.front.front import front_fields


@pytest.mark.ci
@pytest.mark.parametrize("right", ["semi-infinite", "free", "clamped"])
def test_fields_solve_the_chain(right):
    """u and u_t at every front position satisfy the matrix equations of the independent program."""
    n = 100
    record = first_precursor(ended(Slider(25, 0.03, 0.3), n, right), sites=n)
    matrix = dense_chain.chain_matrix(25, 0.03, 0.3, n, right)
    for position in (0, 1, 13, int(record.contacts_broken)):
        fields = front_fields(record.body, position=position, sites=n)
        rhs = np.concatenate([np.zeros(n), 0.03 * np.where(np.arange(n) < position, record.front_stress, 0)])
        rhs[0] = record.load
        solution = np.linalg.solve(matrix, rhs)
        still = np.linalg.solve(matrix, np.eye(2 * n)[0] * record.load)
        np.testing.assert_allclose(fields.upper, solution[:n], atol=2e-12)
        np.testing.assert_allclose(fields.layer, solution[n:], atol=2e-12)
        if position == int(record.contacts_broken):
            np.testing.assert_allclose(record.slip, (solution - still)[n:], atol=2e-12)
            np.testing.assert_allclose(record.stress, fields.stress, atol=1e-13)
    np.testing.assert_allclose(record.stress_before[0], 1, atol=1e-13)
    np.testing.assert_allclose(record.front_stress[0], 1)
    assert (record.stress[int(record.contacts_broken) :] < 1).all()
    assert float(record.edge_stress) == pytest.approx(float(record.stress[0]), abs=1e-12)


def test_front_stress_is_the_stress_ahead():
    record = first_precursor(Slider(25, 0.03, 0.3))
    s0 = int(record.contacts_broken)
    at = np.arange(s0 + 1)
    stress = jax.jit(jax.vmap(lambda s: front_fields(record.body, position=s, sites=64).stress))(at)
    np.testing.assert_allclose(np.asarray(stress)[at, at], record.front_stress[: s0 + 1], rtol=0, atol=1e-13)
    assert (record.front_stress[:s0] >= 1).all()
    assert record.front_stress[s0] < 1


@pytest.mark.ci
def test_record_under_vmap_and_what_it_refuses():
    heights = np.array([10.0, 25.0, 50.0])
    records = jax.vmap(lambda h: first_precursor(Slider(h, 0.03, 0.3), sites=60))(heights)
    assert records.contacts_broken.tolist() == [10, 26, 52]
    assert records.front_stress.shape == (3, 60)
    with pytest.raises(ValueError, match="needs sites"):
        jax.jit(lambda h: first_precursor(Slider(h, 0.03, 0.3)).length)(25.0)
    with pytest.raises(ValueError, match="sites = 20, but 26 contacts broke"):
        first_precursor(Slider(25, 0.03, 0.3), sites=20)
    with pytest.raises(ValueError, match=r"got a batch of shape \(3,\): use jax.vmap"):
        first_precursor(Slider(heights, 0.03, 0.3))


def test_lengths_in_bulk_are_those_one_by_one():
    rng = np.random.default_rng(2)
    height, stiffness = rng.uniform(3, 80, 20), 10 ** rng.uniform(-4, 0, 20)
    whole = precursor_lengths(Slider(height, stiffness, 0.3))
    assert whole.dtype == np.float64
    singly = np.array([precursor_length(Slider(h, q, 0.3)) for h, q in zip(height, stiffness, strict=True)])
    np.testing.assert_allclose(whole, singly, rtol=1e-12)


def test_a_bad_lane_leaves_the_others_alone():
    with pytest.warns(RuntimeWarning, match=r"1 of 3 fronts, the first at index \(2,\)"):
        lengths = precursor_lengths(Slider([10.0, 25.0, 1e170], 0.03, 0.3))
    np.testing.assert_array_equal(lengths[:2], precursor_lengths(Slider([10.0, 25.0], 0.03, 0.3)))
    assert np.isnan(lengths[2])


@pytest.mark.ci
def test_break_rules_behind_one_name():
    """The smooth rule is reached by precursor_length, with its derivative in the width; its length tends to that of a profile."""
    slider = Slider(25.0, 0.01, 0.3)
    hard = float(precursor_length(slider))
    line = float(precursor_length(slider, Profile(np.ones(1))))
    assert float(precursor_length(slider, rule=SmoothBreak(1e-6))) == pytest.approx(line, abs=1e-4)
    assert 1e-4 < abs(line - hard) < 1e-3
    assert np.isfinite(jax.grad(lambda w: precursor_length(slider, rule=SmoothBreak(w)))(0.02))
    assert precursor_length(Slider([10.0, 25.0], 0.01, 0.3), rule=SmoothBreak(0.02)).shape == (2,)
    with pytest.raises(TypeError, match="must be None"):
        precursor_length(slider, rule=0.01)


def test_empty_batch():
    assert precursor_lengths(Slider(np.empty(0), 0.03, 0.3)).shape == (0,)


def test_status_messages_are_for_people():
    assert [status.value for status in Outcome] == list(range(len(Outcome))), "values are stored in files: they never change"
    for status in Outcome:
        assert len(status.message) > 20


@pytest.mark.ci
def test_bulk_lengths_equal_the_recursion_everywhere():
    """Two ways of writing the recursion, over the whole domain: lanes without a domino, tall ones, Poisson's ratio below zero."""
    rng = np.random.default_rng(8)
    n = 3000
    sliders = Slider(1 + 10 ** rng.uniform(-1, 3.3, n), 10 ** rng.uniform(-8, 0, n), rng.uniform(-0.9, 0.5, n))
    columns = [sliders.height, sliders.stiffness, sliders.poisson]
    kind = jax.tree.structure((Slider(25.0, 0.03, 0.3), None, None))
    general = over_lanes(bulk.general_arrest_kernel(kind, MOST_BREAKS), columns, bulk.ANY)
    together, arrests = precursor_lengths(sliders), Arrest(*general)
    assert (arrests.status == Outcome.NO_DOMINO).any()
    assert arrests.length.max() > 1000
    np.testing.assert_array_equal(np.maximum(np.ceil(together), 1), arrests.contacts_broken)
    # on the softest interfaces the stress barely passes the threshold, and its last digit moves the crossing
    firm = sliders.stiffness > 1e-5
    np.testing.assert_allclose(together[firm], arrests.length[firm], rtol=1e-10, atol=1e-11)
    np.testing.assert_allclose(together, arrests.length, rtol=1e-8)
