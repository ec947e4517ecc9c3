"""What a table of a sequence states: its events, the errors of its inputs, and sentences that are true of it."""

import dataclasses
import io
import re

import numpy as np
import pandas as pd
import pytest
from reports import unfolded

import slippulse_jax as sp
from slippulse_jax.inference.model.series import BlockSeries
from slippulse_jax.inference.observables import PlaceForce
from slippulse_jax.inference.observables.sequence import no_record, record_of
from slippulse_jax.inference.parameters import PARAMETERS, Parameter, checked, parameter_set, stated_errors, suspicions
from slippulse_jax.inference.result.remarks import _of_model, _of_sigma
from slippulse_jax.inference.result.report import _holds_for
from slippulse_jax.inference.table.columns import MeasurementError

EVENTS = """
height_mm,block_length_mm,block_width_mm,correlation_length_um,poisson,young_GPa,push_height_mm,push_width_mm,normal_stiffness,\
normal_load_N,event,force_N,force_sigma_N,length_mm,length_sigma_mm,spans,provenance
30,90,10,1250,0.3,3,4.5,3,1.2,1000,1,128.8,1.3,10.25,0.31,no,synthetic
30,90,10,1250,0.3,3,4.5,3,1.2,1000,2,199.9,2.0,57.84,1.74,no,synthetic
30,90,10,1250,0.3,3,4.5,3,1.2,1000,3,194.1,1.9,72.32,2.17,no,synthetic
30,90,10,1250,0.3,3,4.5,3,1.2,1000,4,195.9,1.9,76.83,2.31,no,synthetic
30,90,10,1250,0.3,3,4.5,3,1.2,1000,5,196.2,1.9,81.91,2.46,no,synthetic
30,90,10,1250,0.3,3,4.5,3,1.2,1000,6,195.5,1.9,90.0,,yes,synthetic
"""
BOTH = [Parameter("stiffness"), Parameter("friction")]
OF_INPUTS = {
    "height": 0.3, "block_length": 0.9, "push_height": 0.045, "push_width": 0.03, "normal_stiffness": 0.012, "poisson": 0.003,
    "young": 3e7, "block_width": 0.1, "normal_load": 10.0, "correlation_length": 12.5, "machine_stiffness": 3e5,
}  # fmt: skip
"""Errors of 1 % of all inputs, in the units of their columns but for young and machine_stiffness."""
UNITS = {"height": "mm", "block_length": "mm", "push_height": "mm", "push_width": "mm", "block_width": "mm",
         "normal_load": "N", "correlation_length": "um", "young": "Pa", "machine_stiffness": "N_per_m"}  # fmt: skip


def table(**changed):
    """The six events, some columns changed."""
    return pd.read_csv(io.StringIO(EVENTS)).assign(**changed)


def measured(**changed):
    return sp.Measurements.from_dataframe(table(**changed))


@pytest.fixture(scope="module")
def six():
    return sp.fit(measured(), BOTH)


# --- events ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("events", "message"),
    [
        ([1, 1.5, 3, 4, 5, 6], r"row 1, column event: 1.5: events are numbered by whole numbers"),
        ([1, 2, 3, 4, 5, -1], r"row 5, column event: -1: events are numbered from 1"),
        ([1, 2, 3, 4, np.inf, 6], r"row 4, column event: inf"),
        ([1, 2, 3, 4, np.nan, 6], r"row 4, column event: "),
        ([True, 2, 3, 4, 5, 6], r"row 0, column event: 'True' is not a number"),
        (["first", 2, 3, 4, 5, 6], r"row 0, column event: 'first'"),
        ([1, 2, 2, 4, 5, 6], r"row 2, column event: 2: a second time; name the runs in a column sequence"),
        ([1, 2, 3, 1, 2, 3], r"row 3, column event: 1: a second time; name the runs in a column sequence"),
    ],
)
def test_numbers_of_events_are_looked_at(events, message):
    with pytest.raises(ValueError, match=message):
        checked(measured(event=events), BOTH, "sequence")


def test_every_event_has_a_run_or_none_has():
    for blank in ("", None, np.nan):
        with pytest.raises(
            MeasurementError, match=r"row 4, column sequence: .*missing: name the run of every event, or of none"
        ):
            measured(sequence=["A", "A", "A", "B", blank, "B"])
    runs = measured(event=[1, 2, 3, 1, 2, 3], sequence=list("AAABBB"))
    assert np.flatnonzero(record_of(runs).first).tolist() == [0, 3]
    assert np.flatnonzero(record_of(measured(sequence="")).first).tolist() == [0]


RECORD = [10.25, 57.84, 72.32, 76.83, 81.91, 90.0]


@pytest.mark.parametrize(
    ("events", "lengths", "first", "said"),
    [
        ([1, 2, 3, 4, 5, 6], RECORD, [0], []),
        ([2, 3, 4, 5, 6, 7], RECORD, [], ["there is no event 1: its first length is not known, and not fitted"]),
        ([1, 3, 2, 4, 5, 6], [10, 30, 20, 40, 50, 90], [0], ["events are taken in the order of their numbers, which is not"]),
        ([2, 1, 3, 4, 5, 6], [30, 10, 40, 50, 60, 90], [1], ["events are taken in the order of their numbers, which is not"]),
        ([1, 2, 3, 4, 5, 6], [10, 30, 20, 40, 50, 90], [0], ["table, row 2: event 3 gets no farther than one before"]),
        ([1, 2, 3, 4, 5, 6], [10, 30, 30, 30, 50, 90], [0], ["table, row 2: event 3 gets no", "table, row 3: event 4 gets no"]),
        ([1, 3, 2, 4, 5, 6], RECORD, [0], ["events are taken in the order", "table, row 1: event 3 gets no farther"]),
    ],
)
def test_what_is_no_record_is_said(events, lengths, first, said):
    m = measured(event=events, length_mm=lengths)
    assert np.flatnonzero(record_of(m).first).tolist() == first
    found = [*no_record(m)]
    assert len(found) == len(said)
    for text, expected in zip(found, said, strict=True):
        assert text.startswith(expected)


@pytest.mark.ci
def test_events_without_the_first_are_fitted_and_say_so(six):
    """The same forces, without the one length: the box counts none, and values agree."""
    late = sp.fit(table()[1:], BOTH)
    text = unfolded(late.report())
    assert "There is no event 1: its first length is not known, and not fitted" in text
    assert "first length  " not in late.report()
    assert "From 5 forces of" in text
    pieces = late.intervals["friction"][0.95]
    assert pieces[0].low < six.values["friction"] < pieces[-1].high


@pytest.mark.ci
def test_a_spanning_row_alone_is_a_datum():
    """The force of sliding at the stated stiffness: the friction is that of a series on a block of other contacts."""
    stiffness = 5.88e10
    one = sp.fit(table()[5:], "friction", fixed={"areal_stiffness": stiffness})
    block = sp.Block.from_material(
        height=0.03, length=0.09, correlation_length=1.25e-3, areal_stiffness=stiffness, poisson=0.3, young=3e9, push_height=4.5e-3,
        push_width=3e-3, friction=one.values["friction"], normal_stiffness=1.2,
    )  # fmt: skip
    found = sp.series(block, events=400)
    force = float(found.force_at(block.sites)) * float(found.strength) / float(block.stiffness) / block.sites
    assert 1000 * one.values["friction"] * force == pytest.approx(195.5, rel=0.02)
    text = unfolded(one.report())
    assert "no event 1" not in text
    assert "one force cannot test the model" in text


# --- errors of inputs -----------------------------------------------------------------------------------------------------


def in_the_model(m, error=0.0):
    """What series depend on, and forces, places and lengths as they are compared, at one stiffness, with a nuisance moved."""
    q = parameter_set(m, BOTH, BlockSeries())
    theta = np.array([np.log(5.9e10), 0.35, *(one.prior_mean + error for one in q.free[2:])])
    inputs, record = q.inputs.at(theta), record_of(m)
    extent, arrested = inputs.get("log_extent"), record.error > 0
    place = np.where(arrested, record.place * np.exp(-extent), record.place)
    data = PlaceForce().data(m, q)
    force = (m.force - data.offset(theta)) / np.exp(data.scale(theta))
    length = np.log(m.length / m.block_length) - extent
    return np.nan_to_num(q.front.numbers(inputs)[:, :-2], posinf=99.0), inputs.get("log_sites"), force, place, length[arrested]


@pytest.mark.parametrize(("name", "forces"), [*((name, "N") for name in OF_INPUTS), ("block_width", "N_per_mm")])
def test_an_error_of_an_input_is_a_nuisance_that_acts_as_its_column(name, forces):
    """Moved by 1 %, it changes all that a series and its data depend on as a table whose column is larger by 1 %."""
    unit = f"_{UNITS[name]}" if name in UNITS else ""
    rows = table(**({"machine_stiffness_N_per_m": 3e7} if name in ("machine_stiffness", "block_width") else {}))
    rows = rows.rename(columns={f"force{end}_N": f"force{end}_{forces}" for end in ("", "_sigma")})
    rows = rows.rename(columns={"young_GPa": "young_Pa"}).assign(young_Pa=3e9) if name == "young" else rows
    m = sp.Measurements.from_dataframe(rows.assign(**{f"{name}_sigma{unit}": OF_INPUTS[name]}))
    assert [*stated_errors(m, BlockSeries())] == [name]
    (nuisance,) = parameter_set(m, BOTH, BlockSeries()).free[2:]
    assert (nuisance.name, nuisance.nuisance) == (name, True)
    assert nuisance.prior_sigma == pytest.approx(0.003 if name == "poisson" else 0.01, rel=1e-9)
    larger = sp.Measurements.from_dataframe(rows.assign(**{f"{name}{unit}": 1.01 * rows[f"{name}{unit}"]}))
    end = larger.block_length if name == "block_length" else np.where(np.isnan(larger.block_length), 0, larger.block_length)
    larger = dataclasses.replace(larger, length=np.where(np.array(larger.kind) == "at_least", end, larger.length))
    by = 0.003 if name == "poisson" else np.log(1.01)
    moved = in_the_model(m, by)
    for own, other in zip(moved, in_the_model(larger), strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-12)
    assert any(np.abs(own - still).max() > 1e-4 for own, still in zip(moved, in_the_model(m), strict=True))


@pytest.mark.parametrize("load", ["N", "N_per_mm"])
@pytest.mark.parametrize("force", ["N", "N_per_mm"])
@pytest.mark.parametrize("machine", [None, 3e7])
def test_a_width_acts_on_what_is_stated_over_all_of_it(force, load, machine):
    rows = table(**({} if machine is None else {"machine_stiffness_N_per_m": machine})).assign(block_width_sigma_mm=0.1)
    if (force, load, machine) == ("N_per_mm", "N_per_mm", None):
        return  # no width
    names = {f"force{end}_N": f"force{end}_{force}" for end in ("", "_sigma")} | {"normal_load_N": f"normal_load_{load}"}
    m = sp.Measurements.from_dataframe(rows.rename(columns=names))
    q = parameter_set(m, BOTH, BlockSeries())
    at = [one.name for one in q.free].index("block_width")
    assert PlaceForce().data(m, q).scale.slope[0, at] == (force == "N") - (load == "N")
    moved = [q.inputs.at(np.eye(len(q.free))[at] * x).get("log_machine") for x in (0.0, 1.0)]
    np.testing.assert_array_equal(moved[1] - moved[0], -1.0) if machine else np.testing.assert_array_equal(*moved)


def test_the_length_over_which_places_are_read_is_a_coordinate_of_surfaces():
    """With errors of all lengths of a block stated, no combination of them leaves a series and its reading as they were."""
    errors = {"height_sigma_mm": 0.3, "push_height_sigma_mm": 0.05, "push_width_sigma_mm": 0.03, "block_length_sigma_mm": 0.9}
    m = sp.Measurements.from_dataframe(table().assign(**errors))
    q = parameter_set(m, BOTH, BlockSeries())
    theta = np.array([one.prior_mean if one.nuisance else (one.low + one.high) / 2 for one in q.free])
    numbers = [q.front.numbers(q.inputs.at(theta + step))[0] for step in (0 * theta, *(1e-3 * np.eye(len(theta))))]
    still, *moved = np.nan_to_num(numbers, posinf=0.0)
    assert np.linalg.matrix_rank((moved - still) / 1e-3, tol=0.1) == len(theta) == 6


@pytest.mark.ci
def test_forces_have_errors_as_other_inputs_have(six):
    """Forces larger by 1 % are a friction larger by 1 %, and by what it tilts the pressure more (1.036 %); F_N the opposite."""
    moves = {change.name: change for change in six.changes}
    of_stiffness = [moves[name].moves["areal_stiffness"][0] for name in ("force", "normal_load")]
    assert of_stiffness[0] == pytest.approx(-of_stiffness[1], abs=1e-3)
    by = {name: moves[name].moves["friction"][0] for name in ("force", "normal_load", "force_offset")}
    assert by["force"] == pytest.approx(0.01 * six.values["friction"], rel=0.06)
    assert by["force"] == pytest.approx(-by["normal_load"], rel=0.03)
    assert by["force_offset"] == pytest.approx(0.01 * six.values["friction"], rel=0.5)
    own = six.covariance[1, 1] ** 0.5
    assert six.errors_with_inputs["friction"][1] > 0.99 * np.linalg.norm([own, by["force"], by["normal_load"]])
    text = six.report()
    for row in ("every force larger by 1 %", "F_N larger by 1 %", "zero of the load cell off by 1 % of the largest force"):
        assert row in text
    assert "every force (1 %)" in six.methods()


@pytest.mark.slow
def test_a_stated_error_of_the_load_is_in_the_error_of_the_fit(six):
    """In quadrature; and no row of the report takes it as exact."""
    stated = sp.fit(measured(normal_load_sigma_N=20.0), BOTH)
    own, of_load = six.covariance[1, 1] ** 0.5, 0.02 * six.values["friction"]
    assert stated.covariance[1, 1] ** 0.5 == pytest.approx(np.hypot(own, of_load), rel=0.1)
    assert "normal_load" not in {change.name for change in stated.changes}


@pytest.mark.slow
def test_a_load_cell_whose_zero_is_known(six):
    """Forces all larger by 15 N, and the offset held or fitted within its error: the values of the table without it."""
    off = table().assign(force_N=table().force_N + 15.0)
    held = sp.fit(off, BOTH, fixed={"force_offset": 15.0 / 0.01})
    q, other = held.parameters, six.parameters
    for theta in (six.theta, six.theta + [0.01, -0.002]):
        np.testing.assert_array_equal(q.inputs.at(theta).table(), other.inputs.at(theta).table())
    assert held.values == pytest.approx(six.values, rel=5e-3)
    loose = sp.fit(off, [*BOTH, Parameter("force_offset", prior=(1500.0, 200.0))])
    assert loose.values["friction"] == pytest.approx(six.values["friction"], rel=0.01)
    assert loose.covariance[1, 1] ** 0.5 > 1.3 * six.covariance[1, 1] ** 0.5
    assert "force offset" in loose.report()
    assert "force_offset" not in {change.name for change in loose.changes}


@pytest.mark.parametrize(
    ("one", "hint"),
    [
        (Parameter("normal_load", prior=(1000, 20)), r"normal_load = 1000 N/m, .*; is it in N\?"),
        (Parameter("normal_load", bounds=(500, 2000)), r"normal_load = 500 to 2000 N/m, .*; is it in N\?"),
        (Parameter("normal_load", value=1e5), None),
        (Parameter("normal_load", prior=(1.2e5, 1e4)), None),
        (Parameter("machine_stiffness", value=3e7), r"machine_stiffness = 3e\+07 Pa, .*; is it in N/m\?"),
        (Parameter("machine_stiffness", prior=(3, 0.3)), r"machine_stiffness = 3 Pa, .*; is it in GPa\?"),
        (Parameter("machine_stiffness", value=3e9), None),
        (Parameter("time_constant", value=1e-6), "time_constant = 1e-06 u_s, usually 0.02 to 50 u_s: .* are in u_s"),
        (Parameter("time_constant", bounds=(0.02, 50)), None),
        (Parameter("young", prior=(3, 0.2)), r"young = 3 Pa, .*; is it in GPa\?"),
        (Parameter("push_width", value=3), r"push_width = 3 m, .*; is it in mm\?"),
        (Parameter("block_length", prior=(90, 1)), r"block_length = 90 m, .*; is it in mm\?"),
    ],
)
def test_numbers_over_the_width_of_the_block_have_a_unit_too(one, hint):
    """Whether the table states the parameter or not."""
    m = measured(machine_stiffness_N_per_m=3e7)
    for stated in (m, dataclasses.replace(m, normal_load=None)) if one.name == "normal_load" else (m,):
        said = suspicions(stated, [*BOTH, one])
        assert len(said) == (hint is not None), said
        assert hint is None or re.search(hint, said[0])


# --- sentences ------------------------------------------------------------------------------------------------------------


def test_no_two_parameters_share_a_symbol():
    kinds = [kind.symbol for name, kind in PARAMETERS.items() if kind.symbol]
    assert len({*kinds}) == len(kinds)


def remarks(result):
    """What the report says of the data, the model and what the fit holds for; without the refits of its rows."""
    return " ".join([*_of_sigma(result), *result.main.notes(result), *_of_model(result), *_holds_for(result)])


@pytest.mark.ci
@pytest.mark.parametrize(
    ("dropped", "options", "said", "unsaid"),
    [
        (
            "length_sigma_mm",
            {},
            ["no standard errors of lengths were given: places count as exact"],
            ["equal ones are assumed"],
        ),
        (None, {"fixed": {"newborn": 0.6}}, ["assumed: contacts age over τ = 1 u_s"], ["ageing contacts"]),
        pytest.param(
            None,
            {"fixed": {"newborn": 0.6, "time_constant": 1.0}},
            [],
            ["ageing contacts", "assumed: contacts age"],
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "push_width_mm",
            {},
            ["guessed: the pusher covers the whole side above the push", "ageing contacts"],
            [],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_sentences_are_true_of_this_table(dropped, options, said, unsaid):
    rows = table() if dropped is None else table().drop(columns=dropped)
    found = sp.fit(rows, BOTH, **options)
    for text in said:
        assert text in remarks(found)
    for text in unsaid:
        assert text not in remarks(found)


@pytest.mark.ci
def test_thresholds_that_scatter_are_a_refit_or_fit_nothing(six):
    """A fit with the scatter held, in one round: to half the error that such a fit has."""
    (change,) = (one for one in six.changes if one.name == "threshold_scatter")
    again = sp.fit(measured(), BOTH, fixed={"threshold_scatter": 0.05})
    if np.isnan(change.moves["areal_stiffness"]).all():
        assert "thresholds that scatter by 5 % from contact to contact  none fits" in six.report()
        assert again.p_value < 1e-3
    else:
        moved = np.log(again.values["areal_stiffness"] / six.values["areal_stiffness"])
        error = again.stderrs["areal_stiffness"] / again.values["areal_stiffness"]
        assert change.moves["areal_stiffness"][0] == pytest.approx(moved, abs=error / 2)


DIGITS = "height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm\n" + "".join(
    f"{height},12.54,0.3456,3.254,{length},0.5\n" for height, length in ((25.25, 14.03), (45.5, 30.1), (75.5, 59.2))
)


def test_stated_numbers_are_printed_as_stated():
    result = sp.fit(pd.read_csv(io.StringIO(DIGITS)), fixed={"prestress": 0.01234})
    for text in (result.methods(), unfolded(result.report())):
        assert "prestress = 0.01234" in text
    for stated in ("E = 3.254 GPa", "ν = 0.3456", "λc = 12.54 µm", "heights of 25.25 to 75.5 mm"):
        assert stated in result.methods()
