"""What a record says beside its events: largest forces up to them, and that none lies between two; and what is refused."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.inference.model.series import BlockSeries, Followed
from slippulse_jax.inference.observables import Between, LargestForce, PlaceForce
from slippulse_jax.inference.parameters import parameter_set
from slippulse_jax.inference.result.verdict import Identifiability

TABLE = Path(__file__).resolve().parent / "tables" / "two_events.csv"
FIRST = TABLE.with_name("first_two_events.csv")
BOTH = ["stiffness", "friction"]


def table(**changed):
    return dataclasses.replace(sp.read_measurements(TABLE), **changed)


def observed(m, kind=LargestForce):
    """Largest forces and forces of a table, with the inputs at some parameters."""
    q = parameter_set(m, [sp.Parameter("stiffness"), sp.Parameter("friction", value=0.4)], BlockSeries())
    data = kind().data(m, q)
    return data, data.inputs.at(np.array([[24.0]]))


def test_what_is_read_is_the_largest_of_all_events_up_to_a_place():
    """Of an event whose own force that is, by how much one before was larger."""
    m = table(length_sigma=None)
    data, inputs = observed(m)
    assert data.more["own"].tolist() == [True, False]
    assert data.value[0].tolist() == [0.0, m.largest_force[1]]
    ends = m.length / m.block_length
    series = Followed(
        np.array([[0.02, ends[0], 0.5, ends[1], np.inf]]) + 1e-4,
        np.array([[0.3, 0.2, 0.7, 0.1, 0.9]]),
        *(np.zeros((1, 5)) for _ in range(3)),
    )
    exact = {**data.more, "error": np.full(2, 1e-6)}
    own = inputs.map(lambda x: x[:, 0])
    read = LargestForce().read_series(series, np.array([100.0]), own, exact)
    forces = PlaceForce().read_series(series, np.array([100.0]), own, exact)[0, :, 0]
    assert read[0, :, 0] == pytest.approx([0.3 * 0.4 - forces[0], 0.7 * 0.4])


@pytest.mark.ci
def test_an_event_between_two_rows_excludes_a_valley():
    """The table alone allows two stiffnesses and names the wrong one first; with the largest force one is left, the true one."""
    alone, known = sp.fit(table(largest_force=None), BOTH), sp.fit(table(), BOTH)
    assert alone.identifiability is Identifiability.SEVERAL_ROOTS
    assert len(alone.intervals["areal_stiffness"][0.95]) == 2
    assert alone.values["areal_stiffness"] < 0.8 * 2.973e10
    (piece,) = known.intervals["areal_stiffness"][0.95]
    assert piece.encloses(2.973e10)
    assert piece.high / piece.low < 1.3
    (friction,) = known.intervals["friction"][0.95]
    assert friction.encloses(0.378)
    text = known.report()
    assert "2 largest forces" in text
    assert "largest force 232.0 ± 1.9 N, fitted 2" in text
    frame = known.to_dataframe()
    assert frame["largest_force_N"].tolist() == pytest.approx([180.71, 232.04])


def test_rows_without_a_largest_force_have_none():
    """Blank at the second event: one datum, and no row is less than the one before."""
    m = table(largest_force=[18071.0, np.nan])
    LargestForce().check(m, [])
    data, _ = observed(m)
    assert data.measurement.tolist() == [0]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"largest_force": [18071.0, 18000.0]}, "column largest_force: 18000: less than the force of this event"),
        ({"largest_force": [25000.0, 23204.0]}, "column largest_force_N: less than of an event or place before"),
    ],
    ids=str,
)
def test_largest_forces_that_cannot_be(changed, message):
    with pytest.raises(ValueError, match=message):
        sp.fit(table(**changed), BOTH)


@pytest.mark.parametrize(
    ("event", "rows"), [([1, 2], [0, 1]), ([2, 1], [1, 0]), ([1, 3], [0]), ([2, 3], [1]), ([3, 5], [])], ids=str
)
def test_between_which_events_there_is_none(event, rows):
    """Of numbers that follow on one another, and before the first; only where it is stated what would have been listed."""
    m = dataclasses.replace(sp.read_measurements(FIRST), event=np.array(event, float), provenance=())
    q = parameter_set(m, [sp.Parameter("stiffness"), sp.Parameter("friction", value=0.4)], BlockSeries())
    data = Between().data(m, q)
    assert ([] if data is None else data.measurement.tolist()) == rows
    assert Between().data(dataclasses.replace(m, visible=None), q) is None
    assert Between().data(dataclasses.replace(m, event=None), q) is None


def test_how_far_an_event_between_two_advances():
    """Beyond what would have been listed; those that end at a listed place, by its error, are the listed ones."""
    m = dataclasses.replace(sp.read_measurements(FIRST), length_sigma=None)
    data, inputs = observed(m, Between)
    low, high = m.length / m.block_length
    seen = data.more["visible"][0]
    assert seen == pytest.approx(1.25 / 105)
    own = inputs.map(lambda x: x[:, 0])
    for reached, expected in (
        ([0.1, low, high, np.inf], [0.1 - seen, 0]),
        ([low, 0.5, high, np.inf], [0, 0.5 - low - seen]),
        ([low, low + 0.05, 0.5, high, np.inf], [0, 0.45 - low - seen]),
        ([low, high - 1e-4, high, np.inf], [0, 0]),
        ([low + 1e-4, high, 0.9, np.inf], [0, 0]),
    ):
        none = np.zeros((1, len(reached)))
        series = Followed(np.array([reached]), *(none for _ in range(4)))
        error = {name: np.where(data.more[name] > 0, 1e-3, 0) for name in ("error", "error_before")}
        read = Between().read_series(series, np.array([126.0]), own, {**data.more, **error})
        assert read[0, :, 0] == pytest.approx(expected, abs=1e-9), reached


@pytest.mark.ci
def test_that_all_events_are_listed_excludes_a_valley():
    """Two stiffnesses allowed by the table alone; one, the true one, where it states what would have been listed."""
    m = sp.read_measurements(FIRST)
    alone, known = (sp.fit(one, BOTH) for one in (dataclasses.replace(m, visible=None), m))
    assert len(alone.intervals["areal_stiffness"][0.95]) == 2
    (piece,) = known.intervals["areal_stiffness"][0.95]
    assert piece.encloses(2.188e10)
    assert "2 unlisted advances" in known.report()
