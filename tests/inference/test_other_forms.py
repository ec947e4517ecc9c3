"""What is given in another form than a table: other units, frames of other libraries, an index, a text; and what a fit then does."""

import io
import re
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from inference.test_sequence_inputs import BOTH, table

import slippulse_jax as sp
from slippulse_jax.cli import fit as fit_command
from slippulse_jax.inference.parameters import wanted_parameters
from slippulse_jax.inference.result.record import from_request, read_request
from slippulse_jax.inference.table.columns import COLUMNS, MeasurementError
from slippulse_jax.inference.table.measurements import read_gauges

ROOT = Path(__file__).resolve().parents[2]
LENGTHS = """height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm
25,10,0.3,3,14.03,0.5
45,10,0.3,3,29.95,0.5
"""


def lengths():
    return pd.read_csv(io.StringIO(LENGTHS))


def said_of(header):
    """What the reader says of a table with this header."""
    with pytest.raises(MeasurementError) as refused:
        sp.Measurements.from_dataframe(pd.DataFrame([["1"] * len(header)] * 2, columns=header))
    return str(refused.value)


# --- units ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["kN", "mN", "MN", "uN", "kgf", "lbf", "kg", "kN_per_m", "mN_per_mm", "N_per_cm"])
@pytest.mark.parametrize("column", ["force_N", "force_sigma_N", "normal_load_N"])
def test_forces_in_another_unit_name_it(column, unit):
    """And the column for the converted numbers; no other column is asked for, and no rename without conversion."""
    other = column.removesuffix("N") + unit
    said = said_of([other if name == column else name for name in table().columns])
    per = "_per_" in unit
    assert (
        f"column {other}: numbers in {unit} are not read: convert them, for {column.removesuffix('N')}{'N' if not per else ''}"
        in said
    )
    assert "did you mean" not in said
    assert "machine_stiffness" not in said


@pytest.mark.parametrize(
    ("own", "of", "unit"),
    [
        ("height_inch", "height_mm", "inch"),
        ("height [ft]", "height_mm", "ft"),
        ("length_km", "length_mm", "km"),
        ("length_sigma_in", "length_sigma_mm", "in"),
        ("young_psi", "young_GPa", "psi"),
        ("correlation_length_dm", "correlation_length_um", "dm"),
    ],
)
def test_so_do_other_columns(own, of, unit):
    said = said_of([own if name == of else name for name in lengths().columns])
    assert f"column {own}: numbers in {unit} are not read: convert them, for {of}" in said


@pytest.mark.parametrize(("own", "of"), [("young_gpa", "young_GPa"), ("force_n", "force_N"), ("height_MM", "height_mm")])
def test_a_name_in_other_case_is_no_other_unit(own, of):
    columns = table().columns if of == "force_N" else lengths().columns
    assert f"column {own}: did you mean {of}? Upper and lower case count" in said_of(
        [own if name == of else name for name in columns]
    )


def test_every_unit_of_a_column_is_read_or_named():
    """No unit of one quantity is taken for a column of its own that nobody reads."""
    for name, column in COLUMNS.items():
        if column.required and column.unit:
            header = [f"{name}_furlong" if own == column.name(True) else own for own in lengths().columns]
            assert column.name(True) in said_of(header)


def test_a_width_needs_something_that_is_divided_by_it():
    said = said_of([*lengths().columns, "block_width_mm"])
    assert "block_width_mm: needs the column machine_stiffness_N_per_m, or forces in N" in said


# --- frames, an index, a text -----------------------------------------------------------------------------------------------


def frame(*methods, rows=True):
    """An object that has columns, these methods, and perhaps rows, as frames of other libraries have."""
    members = dict.fromkeys(methods, lambda self: None) | {"columns": property(lambda self: [*lengths().columns])}
    return type("Frame", (), members | ({"itertuples": None} if rows else {}))()


@pytest.mark.parametrize("door", [sp.fit, sp.objective, sp.Measurements.from_dataframe])
@pytest.mark.parametrize(
    ("given", "advice"),
    [
        (frame("to_pandas", rows=False), r"table\.to_pandas\(\)"),  # polars and arrow
        (frame("collect", "lazy", rows=False), r"table\.collect\(\)\.to_pandas\(\)"),  # polars, lazy
        (frame("compute", "persist"), r"table\.compute\(\)"),  # Dask
        (frame("to_pandas"), r"table\.to_pandas\(\)"),  # cuDF
        (frame("toPandas", rows=False), r"table\.toPandas\(\)"),  # Spark
    ],
)
def test_frames_of_other_libraries_say_what_to_call(door, given, advice):
    with pytest.raises(TypeError, match=rf"table is Frame: must be a pandas.DataFrame: {advice} makes one of it"):
        door(given)


@pytest.mark.parametrize("name", ["collect", "compute", "to_pandas", "toPandas", "to_frame", "itertuples", "dims", "mask"])
def test_a_column_may_have_the_name_of_what_other_frames_do(name):
    m = sp.Measurements.from_dataframe(lengths().assign(**{name: "x"}))
    assert m.other[name] == ["x"] * len(m)
    assert len(sp.fit(lengths().assign(**{name: 1.0}), intervals="profile").measurements) == len(m)


@pytest.mark.parametrize("index", [["height_mm"], ["poisson", "height_mm"], ["length_mm"]])
def test_columns_in_the_index_are_named(index):
    with pytest.raises(
        MeasurementError, match=rf"table: {', '.join(index)} in the index, not among the columns: .*reset_index"
    ):
        sp.Measurements.from_dataframe(lengths().set_index(index))
    again = sp.Measurements.from_dataframe(lengths().set_index(index).reset_index())
    np.testing.assert_array_equal(again.height, sp.Measurements.from_dataframe(lengths()).height)


@pytest.mark.parametrize("name", ["sample", None])
def test_an_index_of_another_kind_is_no_column(name):
    m = sp.Measurements.from_dataframe(lengths().set_index(pd.Index(["a", "b"], name=name)))
    assert m.place(1) == "table, row b"


DOORS = {
    "fit": sp.fit,
    "objective": sp.objective,
    "read_measurements": sp.read_measurements,
    "read_gauges": lambda given: read_gauges(given, ["A"]),
    "load_fit": sp.load_fit,
    "read_request": read_request,
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("text", [LENGTHS, LENGTHS * 200, '{\n"schema": 2}', LENGTHS.replace("\n", "\r\n"), Path(LENGTHS)])
def test_a_text_is_no_name_of_a_file(door, text):
    with pytest.raises(ValueError, match=r"^'\S+.* …: a text, and no file's name; give its file, or pandas.read_csv"):
        DOORS[door](text)


def test_a_file_may_have_any_name(tmp_path, monkeypatch):
    path = tmp_path / "two\nlines.csv"
    path.write_text(LENGTHS)
    assert len(sp.read_measurements(path)) == 2
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError):
        sp.read_measurements("missing.csv")


@pytest.mark.parametrize("between", [", ", ",  ", ";  ", "; ", "\t "])
def test_blanks_before_a_quote_are_no_part_of_a_cell(between, tmp_path):
    """In the header and in cells; as spreadsheets and people write them."""
    rows = [line.split(",") for line in LENGTHS.splitlines()]
    path = tmp_path / "table.csv"
    path.write_text("\n".join(between.join(f'"{cell}"' for cell in row) for row in rows))
    m, plain = sp.read_measurements(path), sp.Measurements.from_dataframe(lengths())
    np.testing.assert_array_equal(m.length, plain.length)
    np.testing.assert_array_equal(m.height, plain.height)


@pytest.mark.parametrize(
    ("width", "why"), [(30.0, "not less than the height of the block"), (31.0, "not less than"), (16.0, "reaches beyond")]
)
def test_a_pusher_as_wide_as_the_block_is_high(width, why):
    with pytest.raises(MeasurementError, match=why):
        sp.Measurements([30.0, 30.0], 0.3, [9.0, 9.1], 0.5, push_height=24.0, push_width=width)


# --- what is fitted ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rows",
    [
        lengths(),
        lengths().assign(push_height_mm=5.0, push_width_mm=2.0),
        lengths().assign(block_length_mm=100.0),
        table().drop(columns=["force_N", "force_sigma_N", "normal_load_N", "event", "block_width_mm"]),
    ],
)
@pytest.mark.parametrize("door", [sp.fit, sp.objective])
def test_a_sequence_without_forces_says_that_they_lack(rows, door):
    with pytest.raises(
        ValueError, match=r"event = 'sequence' needs forces of a block: columns force, force_sigma, push_height"
    ):
        door(rows, event="sequence")


UNSTATED = {
    "pmma_block": ["push_height", "push_width", "block_length", "block_width", "normal_stiffness", "force_offset"],
    "pushed_block": ["push_width", "block_length", "block_width", "normal_stiffness", "force_offset"],
    "sequence": ["push_width", "block_width", "normal_stiffness"],
}
"""Worked fits, and parameters whose columns they do without."""


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize(("example", "name"), [(example, name) for example, names in UNSTATED.items() for name in names])
def test_a_parameter_without_its_column_is_refused(example, name, held):
    """Held at a value it was added to a default, or to nothing; what no part of the model has moved nothing."""
    rows = pd.read_csv(ROOT / "fit_examples" / example / "lengths.csv", comment="#")
    rows = rows.drop(columns=[one for one in rows if one.startswith(name)])
    if name == "block_width":
        rows.columns = [f"{one}_per_mm" if one.endswith("_N") else one for one in rows]
    options = {"fixed": {name: 0.003}, "free": ["stiffness"]} if held else {"free": ["stiffness", name]}
    if example == "sequence":
        options["free"].append("friction")
    for door in (sp.fit, sp.objective):
        with pytest.raises(ValueError, match=f"parameter {name}: "):
            door(rows, **options)


@pytest.mark.parametrize(
    ("columns", "held", "free"),
    [
        ({}, {}, ["stiffness", "friction"]),
        ({"friction": 0.35}, {}, ["stiffness"]),
        ({}, {"friction": 0.35}, ["stiffness"]),
        ({"normal_load_N": None}, {}, ["stiffness", "friction", "normal_load"]),
        ({}, {"areal_stiffness": 6e10}, ["friction"]),
    ],
)
def test_what_the_table_identifies_is_fitted(columns, held, free, monkeypatch):
    """By `fit`, `objective`, the command and a request, where no parameter is named; and named ones are taken as they are."""
    m = sp.Measurements.from_dataframe(table(**columns).dropna(axis="columns", how="all"))
    every = wanted_parameters(m, None, None, held)
    assert [one.name for one in every if one.value is None] == free
    assert [one.name for one in wanted_parameters(m, "stiffness", None, {})] == ["stiffness"]
    assert [one.name for one in wanted_parameters(m, BOTH, None, {})] == ["stiffness", "friction"]
    nothing = {
        "free": (),
        "fix": {name: [value] for name, value in held.items()},
        "prior": {},
        "ranges": {},
        "each_specimen": (),
    }
    request = wanted_parameters(m, from_request(fit_command._with_options({}, nothing, m))["free"], None, None)
    assert [one.name for one in request if one.value is None] == free
    assert {one.name: one.value for one in request if one.value is not None} == held
    assert from_request({})["free"] is None


@pytest.mark.slow  # in CI the example's own program does so
def test_the_example_of_a_sequence_is_fitted_by_its_name(tmp_path):
    done = CliRunner().invoke(fit_command.command, ["--example", "sequence"])
    assert done.exit_code == 0, done.output
    assert re.search(r"│ k/λc² .*\n│ μ ", done.stdout)
    with pytest.raises(ValueError, match="parameter friction: neither stated"):
        sp.fit(ROOT / "fit_examples/sequence/lengths.csv", "stiffness")
    assert sp.objective(ROOT / "fit_examples/sequence/lengths.csv").names == ["areal_stiffness", "friction"]


@pytest.mark.ci
@pytest.mark.parametrize(
    "lengths_mm", [[88, 88.5, 88.9, 89, 89.5, 90], pytest.param([1, 2, 3, 4, 5, 90], marks=pytest.mark.slow)]
)
def test_no_number_is_divided_by_nothing_on_the_way(lengths_mm):
    """Events that hardly any series has: every warning is an error here."""
    found = sp.fit(table(length_mm=lengths_mm))
    assert np.isfinite(found.theta).all()
    assert found.identifiability.value


# --- without jit ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "door",
    [
        lambda: sp.fit(lengths()),
        lambda: sp.fit(lengths().assign(push_height_mm=5.0)),
        lambda: sp.fit(table()),
        lambda: sp.objective(lengths())({"areal_stiffness": 24.0}),
        lambda: sp.objective(lengths()).start(),
        lambda: sp.sweep(height=[20.0, 25.0], stiffness=0.03, poisson=0.3),
        lambda: sp.exact_lengths(sp.Slider(25.0, 0.03, 0.3)),
        lambda: sp.precursor_lengths(sp.Slider(25.0, 0.03, 0.3)),
    ],
)
def test_without_jit_this_package_says_that_it_needs_it(door):
    with (
        jax.disable_jit(),
        pytest.raises(RuntimeError, match=r"jax_disable_jit is set \(JAX_DISABLE_JIT\), and this package needs jit"),
    ):
        door()
