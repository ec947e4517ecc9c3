"""Reading a table: both forms, what is kept, and a clear refusal of everything that is wrong."""

import dataclasses
import re
from pathlib import Path

import generate_pages
import numpy as np
import pandas as pd
import pytest

import slippulse_jax as sp
from slippulse_jax import Measurements, fit, read_measurements
from slippulse_jax.inference.table import columns
from slippulse_jax.inference.table.measurements import Gauges, MeasurementError, MeasurementWarning, measurements_of

SI = "height_mm,correlation_length_um,poisson,length_mm,length_sigma_mm"
PLAIN = "height,poisson,length,length_sigma"


def write(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "lengths.csv"
    path.write_bytes(text.encode(encoding) if isinstance(text, str) else text)
    return path


def test_si_form(tmp_path):
    text = f"# a comment\n\n{SI},young_GPa,specimen,humidity\n50,10,0.3,20,0.5,3,A,40\n75, 5 ,0.3,30,0.5,3,B,45\n"
    m = read_measurements(write(tmp_path, text))
    assert m.in_si
    np.testing.assert_allclose(m.height, [5000, 15000])
    np.testing.assert_allclose(m.length, [2000, 6000])
    np.testing.assert_allclose(m.length_sigma, [50, 100])
    np.testing.assert_allclose(m.correlation_length, [1e-5, 5e-6])
    np.testing.assert_allclose(m.young, 3e9)
    assert m.specimen == ("A", "B")
    assert m.lines == (4, 5)
    assert m.other == {"humidity": ["40", "45"]}


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_dimensionless_form_and_separators(tmp_path, separator):
    text = "\ufeff" + f"{PLAIN}\r\n25,0.3,26,0.5\r\n".replace(",", separator)
    m = read_measurements(write(tmp_path, text))
    assert not m.in_si
    assert (m.height[0], m.poisson[0], m.length[0], m.length_sigma[0]) == (25, 0.3, 26, 0.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("# only a comment\n", "empty"),
        (f"{PLAIN}\n", "a header line and at least one more are needed"),
        (
            "height,length\n1,2\n",
            "line 1: no column poisson among height, length; expected the columns height, poisson, length$",
        ),
        (
            "a,b\n1,2\n",
            "no column height, poisson, length among a, b; expected the columns height_mm, .* or height, poisson, length$",
        ),
        (f"{PLAIN},height_sigma_mm\n25,0.3,26,0.5,1\n", "columns of both forms, height_sigma_mm and height"),
        (f"{PLAIN},kind\n25,0.3,26,0.5,about\n", "line 2, column kind: 'about': one of length, whole, at_least"),
        (f"{PLAIN},kind\n25,0.3,26.5,0.5,whole\n", "column length: 26.5: a count of whole contacts must be a whole number"),
        (f"{PLAIN},prestress\n25,0.3,26,0.5,1.2\n", "column prestress: 1.2: must lie in"),
        (f"{PLAIN},poisson_sigma\n25,0.3,26,0.5,-1\n", "column poisson_sigma: -1: a standard error cannot be negative"),
        (f"{SI},young_sigma_GPa\n50,10,0.3,20,0.5,3\n", "young_sigma_GPa is given without young_GPa$"),
        (
            f"{SI},young_GPa,displacement_um,displacement_sigma_um\n50,10,0.3,20,0.5,3,4,\n",
            "column displacement_sigma_um: missing: the value beside it has no standard error",
        ),
        (f"{SI},push_width_mm\n50,10,0.3,20,0.5,3\n", "line 2, column push_width_mm: 3: needs the height of its middle"),
        (f"{SI},displacement_um\n50,10,0.3,20,0.5,3\n", "displacement_um is given without displacement_sigma_um$"),
        ("height_mm,correlation_length_um,poisson,\n50,10,0.3,20\n", "no column length_mm among"),
        (f"{PLAIN},height\n25,0.3,26,0.5,25\n", "line 1, column height: there 2 times"),
        (f"{PLAIN},height_mm\n25,0.3,26,0.5,25\n", "columns of both forms, height_mm and height"),
        (f"{PLAIN}\n25,0.3,,0.5\n", "line 2, column length: missing value"),
        (f"{PLAIN}\n25,0.3,26,0.5\n25,0.3,abc,0.5\n", "line 3, column length: 'abc' is not a number"),
        (
            f"{PLAIN.replace(',', ';')}\n25;0,3;26;0.5\n",
            "line 2: '0.5' has a decimal point, and '0,3' in line 2 a comma: write",
        ),
        (f"{PLAIN.replace(',', ';')}\n2,4;0,3;2,1;0,5\n2,5;0,3;2.2;0,5\n", "line 3: '2.2' has a decimal point, and '2,4'"),
        (f'{PLAIN}\n25,"0,3",26,0.5\n', "column poisson: '0,3' is not a number; write a decimal point, or semicolons"),
        (
            "height_cm,poisson,length_cm\n5,0.3,2\n",
            "no column correlation_length_um among height_cm, poisson, length_cm; expected a guess .* such as 10",
        ),
        (f"{SI.replace('sigma', 'error')}\n50,10,0.3,20,0.5\n", "column length_error_mm: did you mean length_sigma_mm?"),
        (f"{PLAIN}\n25,0.3,-26,0.5\n", "line 2, column length: -26: a length must be positive"),
        (f"{PLAIN}\n25,0.3,26,0\n", "column length_sigma: 0: the standard error of a length must be positive"),
        (f"{PLAIN}\n25,0.6,26,0.5\n", r"column poisson: 0.6: must lie in \(-1, 0.5\]"),
        (f"{PLAIN}\n0.9,0.3,26,0.5\n", "column height: 0.9: the height must exceed the correlation length"),
        (f"{PLAIN}\n25,nan,26,0.5\n", "column poisson: nan"),
        (f"{PLAIN}\n25,0.3,inf,0.5\n", "column length: inf"),
        (f"{PLAIN}\n25,0.3,26\n", "line 2: 3 columns, but the header has 4"),
        (f"{PLAIN}\n25,0.3,26,0.5,7\n", "line 2: 5 columns, but the header has 4"),
        (f"{PLAIN},provenance\n25,0.3,26,0.5,guessed\n", "column provenance: 'guessed': one of measured, printed"),
        (f"{SI}\n50,0,0.3,20,0.5\n", "column correlation_length_um: 0: the correlation length must be positive"),
        (f"{SI}\n0.005,10,0.3,20,0.5\n", "column height_mm: 0.005: the height must exceed the correlation length"),
        (
            f"{SI},young_psi\n50,10,0.3,20,0.5,3000\n",
            "column young_psi: numbers in psi are not read: convert them, for young_GPa",
        ),
        (f"{SI},young_MPa,young_GPa\n50,10,0.3,20,0.5,3000,3\n", "columns young_MPa and young_GPa: one quantity in two units"),
        (f"{SI},young\n50,10,0.3,20,0.5,3\n", "column young: did you mean young_GPa"),
        (
            f"{SI},force_kN_per_m\n50,10,0.3,20,0.5,1\n",
            "column force_kN_per_m: numbers in kN_per_m are not read: convert them, for force_N_per_mm",
        ),
        (
            "height_in,poisson,length,length_sigma\n5,0.3,20,1\n",
            "column height_in: numbers in in are not read: convert them, for height",
        ),
        ("height_cm,poisson,length,length_sigma\n5,0.3,20,1\n", "columns of both forms, height_cm and length"),
        (f"{SI.replace('height_mm', 'height_cm')}\n5e-9,10,0.3,20,0.5\n", "column height_cm: 5e-9: the height must exceed"),
        (f"{SI}\n50,1e-5,0.3,20,0.5\n", "column correlation_length_um: 1e-5: .*an atom's size"),
        (f"{SI},young_GPa\n50,10,0.3,20,0.5,3e9\n", "column young_GPa: 3e9: .*diamond"),
        (f"{SI},young_gpa\n50,10,0.3,20,0.5,3\n", r"column young_gpa: did you mean young_GPa\? Upper and lower case count$"),
        (f"{PLAIN}\n25,0.3,26,1e-200\n", "column length_sigma: 1e-200: below a billionth of the length"),
        (f"{SI},young_GPa\n50,10,0.3,20,0.5,-3\n", "column young_GPa: -3: Young's modulus must be positive"),
        (f"{SI},young_GPa\n50,10,0.3,20,0.5,\n", "column young_GPa: missing value"),
        (f'{PLAIN}\n25,0.3,"26,0.5\n', "unexpected end of data"),
        (b"\xff\xfe\x00", "not UTF-8 text"),
        (b"height\0,", "NUL"),
        (b"PK\x03\x04\x14", "an Excel workbook"),
    ],
)
def test_refusals_name_file_line_and_column(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(MeasurementError, match=message) as caught:
        read_measurements(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


OR_REMARK = r"If not, give it another name\.$"


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("Höhe_cm,correlation_length_um,poisson,length_mm", r"no column height_mm among Höhe_cm, "),
        ("H (mm),correlation_length_um,poisson,length_mm", r"column H \(mm\): did you mean height_mm\?$"),
        ("H in mm,correlation_length_um,poisson,length_mm", r"column H in mm: did you mean height_mm\?$"),
        ("heigth_mm,correlation_length_um,poisson,length_mm", r"column heigth_mm: did you mean height_mm\?$"),
        (
            "height_psi,correlation_length_um,poisson,length_mm",
            r"column height_psi: numbers in psi are not read: convert them, for height_mm\.$",
        ),
        ("Height_cm,correlation_length_um,poisson,length_mm", r"column Height_cm: did you mean height_cm\? Upper"),
        ("height_mm,lambda_c_um,poisson,length_mm", r"column lambda_c_um: did you mean correlation_length_um\?$"),
        ("height_mm,λc_µm,poisson,length_mm", r"column λc_µm: did you mean correlation_length_um\?$"),
        ("height_mm,correlation_length_um,nu,length_mm", r"column nu: did you mean poisson\?$"),
        ("height_mm,correlation_length_um,poisson,ℓ_mm", r"column ℓ_mm: did you mean length_mm\?$"),
        ("height_mm,correlation_length_um,poisson,Λ_mm", r"column Λ_mm: did you mean length_mm\?$"),
        ("height_mm,correlation_length_um,poisson,L_mm", r"column L_mm: did you mean length_mm or block_length_mm\?$"),
        ("height_mm,correlation_length_um,poisson,length_mm,L_mm", rf"column L_mm: did you mean block_length_mm\? {OR_REMARK}"),
        ("height_mm,correlation_length_um,poisson,length_mm,h_mm", rf"column h_mm: did you mean push_height_mm\? {OR_REMARK}"),
        ("height_mm,correlation_length_um,poisson,length_mm,E_GPa", rf"column E_GPa: did you mean young_GPa\? {OR_REMARK}"),
        (
            "height_mm,correlation_length_um,poisson,length_mm,Young's modulus [MPa]",
            rf"Young's modulus \[MPa\]: did you mean young_MPa\? {OR_REMARK}",
        ),
        ("height_mm,correlation_length_um,poisson,length_mm,E", rf"column E: did you mean young_GPa\? {OR_REMARK}"),
        (
            "height_mm,correlation_length_um,poisson,length_mm,yuong_GPa",
            rf"column yuong_GPa: did you mean young_GPa\? {OR_REMARK}",
        ),
        (
            "height_mm,correlation_length_um,poisson,length_mm,sigma_mm",
            rf"sigma_mm: did you mean length_sigma_mm\? {OR_REMARK}",
        ),
        (
            "height_mm,correlation_length_um,poisson,length_mm,std_cm",
            rf"column std_cm: did you mean length_sigma_cm\? {OR_REMARK}",
        ),
        (
            "height_mm,correlation_length_um,poisson,length_mm,sigma_H_mm",
            rf"sigma_H_mm: did you mean height_sigma_mm\? {OR_REMARK}",
        ),
        (
            "height_mm,correlation_length_um,poisson,length_mm,H_err_mm",
            rf"H_err_mm: did you mean height_sigma_mm\? {OR_REMARK}",
        ),
        ("H_mm,λc_um,ν,ℓ_mm", r"H_mm: did you mean height_mm\? Column λc_um: did .*\? Column ν: did you mean poisson\? Col"),
        ("H,ν,ℓ", r"column H: did you mean height\? Column ν: did you mean poisson\? Column ℓ: did you mean length\?$"),
        ("heigth,poisson,length", r"column heigth: did you mean height\?$"),
        ("height_mm,correlation_length_um,poisson,length_mm,length_mm_std", rf"did you mean length_sigma_mm\? {OR_REMARK}"),
        ("height,poisson,length,Block", rf"column Block: did you mean specimen\? {OR_REMARK}"),
        (
            "height_cm,correlation_length_um,poisson,length_cm,load height_cm",
            r"load height_cm: did you mean push_height_cm\? If",
        ),
    ],
)
def test_a_likely_name_is_suggested(tmp_path, header, message):
    path = write(tmp_path, f"{header}\n{','.join('1' for _ in header.split(','))}\n")
    with pytest.raises(MeasurementError, match=message):
        read_measurements(path)


@pytest.mark.parametrize("column", ["Höhe_cm", "H", "L", "remark", "front_speed_m", "prestressed", "lenght", "x" * 10_000])
def test_remarks_beside_what_is_there_are_kept(tmp_path, column):
    """A name is suggested only for a quantity that the table lacks."""
    table = read_measurements(write(tmp_path, f"{SI},block_length_mm,{column}\n50,10,0.3,20,0.5,900,7\n"))
    assert table.other == {column: ["7"]}
    assert read_measurements(write(tmp_path, f"{PLAIN},E_GPa\n25,0.3,26,0.5,3\n")).other == {"E_GPa": ["3"]}


def test_the_table_of_columns_is_that_of_the_fields_and_of_the_documentation():
    """In the order of the fields, which is that of the hash of a table."""
    for of_table, record, more in ((columns.NUMERIC, Measurements, columns.TEXTS), (columns.GAUGE_COLUMNS, Gauges, ())):
        held = [field.name for field in dataclasses.fields(record) if "converter" in field.metadata]
        assert [name for name in held if name not in (*more, "lines", "rows")] == [*of_table]
        assert set(more) - {"spans"} <= set(held), "spans says what kind says"
    for name, text in generate_pages.TABLES.items():
        assert text == (Path(__file__).parents[2] / "docs" / f"{name}.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"`(\w+)`", generate_pages.TABLES["tables/columns"]))
    assert {one.name(in_si) for one in columns.COLUMNS.values() for in_si in (True, False) if one.names(in_si)} <= documented
    assert set(re.findall(r"\w+", " ".join(one.needs for one in columns.COLUMNS.values()))) <= set(columns.COLUMNS)
    for name, one in {**columns.COLUMNS, **columns.OF_GAUGES}.items():
        assert name == "spans" or f"{name} : " in f"{Measurements.__doc__}{Gauges.__doc__}"
        assert set(re.findall(r"`(\w+)`", one.sentence)) <= {
            *columns.COLUMNS,
            *columns.OF_GAUGES,
            *(one.choices or ()),
            "at_least",
        }


def test_refuses_what_is_not_a_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_measurements(tmp_path / "none.csv")
    with pytest.raises(IsADirectoryError):
        read_measurements(tmp_path)


def test_measurements_from_arrays():
    m = Measurements(height=[25, 50], poisson=0.3, length=[20, 40], length_sigma=1)
    assert len(m) == 2
    np.testing.assert_array_equal(m.poisson, [0.3, 0.3])
    one_text = Measurements(height=[25, 50], poisson=0.3, length=[20, 40], kind="whole", specimen="A", label="")
    assert (one_text.kind, one_text.specimen, one_text.label) == (("whole",) * 2, ("A",) * 2, ("",) * 2)
    with pytest.raises(MeasurementError, match="measurement 1, column length: -4 λc: "):
        Measurements(height=[25, 50], poisson=0.3, length=[20, -4], length_sigma=1)
    with pytest.raises(MeasurementError, match="specimen has 1 entries for 2 lengths"):
        Measurements(height=[25, 50], poisson=0.3, length=20, length_sigma=1, specimen=("A",))
    with pytest.raises(MeasurementError, match="column height: must be a non-empty"):
        Measurements(height=[], poisson=[], length=[], length_sigma=[])
    with pytest.raises(MeasurementError, match=r"column height: 0\.05 λc: the height must exceed the correlation length"):
        Measurements(height=0.05, poisson=0.3, length=0.02, correlation_length=1e-5)


@pytest.mark.parametrize(
    ("column", "message"),
    [
        ({"length": [20, 30, 40]}, "measurements, column length: 3 entries, where height has 2"),
        ({"poisson": [0.3, 0.3, 0.3]}, "column poisson: 3 entries, where height has 2"),
        ({"prestress": [0.1, 0.1, 0.1], "source": "mine.csv"}, "mine.csv, column prestress: 3 entries, where height has 2"),
        ({"length": [[20, 30]]}, "column length: must be a non-empty one-dimensional column"),
        ({"length": []}, "column length: must be a non-empty"),
        ({"length": ["20", "long"]}, "column length: must be numbers .*'long'"),
        ({"length": [20, None]}, "column length: nan"),
    ],
)
def test_columns_that_do_not_fit_are_named(column, message):
    with pytest.raises(MeasurementError, match=message):
        Measurements(**({"height": [25, 50], "poisson": 0.3, "length": [20, 30]} | column))


def test_lengths_and_moduli_in_other_units(tmp_path):
    header = "height_cm,correlation_length_nm,poisson,young_MPa,length_m,length_sigma_um"
    found = read_measurements(write(tmp_path, f"{header}\n5,10000,0.3,3000,0.02,500\n"))
    usual = read_measurements(write(tmp_path, f"{SI},young_GPa\n50,10,0.3,20,0.5,3\n"))
    for name in ("height", "correlation_length", "length", "length_sigma", "young"):
        np.testing.assert_allclose(getattr(found, name), getattr(usual, name), rtol=1e-14)


@pytest.mark.parametrize("first", ["", "sep=;\n", '"sep=;"\r\n'])
@pytest.mark.parametrize("mark", [";", "\t"])
def test_decimal_commas_between_semicolons_and_tabs(tmp_path, first, mark):
    if mark == "\t" and first:
        first = first.replace(";", "\t")
    text = f"{SI},specimen\n50,10,0.3,20,0.5,1,5\n".replace(",", mark).replace(".", ",").replace(f"1{mark}5\n", "1,5\n")
    m = read_measurements(write(tmp_path, first + text))
    assert (m.poisson[0], m.length_sigma[0] * 1e-5, m.specimen) == (0.3, pytest.approx(0.5e-3), ("1.5",))


def test_a_dataframe_and_a_path_are_measurements_too(tmp_path):
    path = write(tmp_path, f"{SI},kind,specimen\n50,10,0.3,20,0.5,,A\n75,10,0.3,30,,at_least,B\n")
    table = pd.read_csv(path)
    usual = read_measurements(path)
    for found in (measurements_of(path), measurements_of(table), Measurements.from_dataframe(table)):
        for name in ("height", "length", "length_sigma", "correlation_length", "kind", "specimen"):
            np.testing.assert_array_equal(getattr(found, name), getattr(usual, name))
    table.loc[1, "length_mm"] = np.nan
    with pytest.raises(MeasurementError, match="^table, row 1, column length_mm: missing value"):
        measurements_of(table)
    with pytest.raises(MeasurementError, match="^table, row B7, column length_mm: missing value"):
        measurements_of(table.set_index(pd.Index(["B6", "B7"])))
    with pytest.raises(MeasurementError, match="^table, column young_psi: numbers in psi are not read"):
        measurements_of(table.assign(young_psi=3))
    with pytest.raises(MeasurementError, match=r"'2,40' is not a number; .*pandas.read_csv: decimal=','"):
        measurements_of(table.assign(length_mm="2,40"))
    with pytest.raises(TypeError, match="measurements is int: must be Measurements, pandas.DataFrame or the path"):
        measurements_of(3)


def test_a_fit_takes_a_path_and_gives_a_dataframe(tmp_path):
    path = write(tmp_path, f"rig 2\n{SI},young_GPa,specimen\n25,10,0.3,14.03,0.5,3,A\n# camera off\n75,10,0.3,59,0.5,3,B\n")
    result = fit(path)
    assert f"skipped 2 lines of {path} that hold no measurement: 1, 4" in result.notes
    result.save(tmp_path / "fit.json")
    assert sp.load_fit(tmp_path / "fit.json").notes == result.notes
    table = result.to_dataframe()
    assert list(table.specimen) == ["A", "B"]
    np.testing.assert_allclose(table.length_mm, [14.03, 59])
    np.testing.assert_allclose((table.length_fitted_mm - table.length_mm) / table.length_sigma_mm, table.residual)
    frame = pd.read_csv(path, skiprows=1, comment="#").set_index(pd.Index(["one", "two"]))
    again = fit(frame)
    assert again.values == result.values
    assert again.measurements.place(1) == "table, row two"
    assert (list(again.to_dataframe().row), list(table.line)) == (["one", "two"], [3, 5])
    assert "<th>row</th>" in again.measurements._repr_html_()


def test_what_design_and_recovery_do_not_use_is_said():
    """Errors of inputs change the error of a fit; knowledge from the same table is without them, and says so."""
    m = Measurements(30.0, 0.3, 20.0, 0.5, height_sigma=5.0, provenance=["measured"])
    with pytest.warns(
        MeasurementWarning, match="design takes the inputs as exact .* without height_sigma, what lengths of prov"
    ):
        known = sp.Knowledge.from_measurements(m)
    plain = sp.Knowledge.from_measurements(Measurements(30.0, 0.3, 20.0, 0.5))
    assert known.log_sd == plain.log_sd
    with pytest.raises(MeasurementError, match="column push_height: recover_profile takes sliders"):
        sp.recover_profile(Measurements([30.0, 40.0], 0.3, [20.0, 25.0], 0.5, push_height=[3.0, 4.0]), stiffness=0.01)


@pytest.mark.parametrize("row", [0.7, np.nan])
def test_a_gauge_is_of_a_whole_row(row):
    with pytest.raises(MeasurementError, match="gauges, column row: (0.7|nan): must be the number of a measurement"):
        Gauges(row=[row], position=[1.0], slip=[0.1], slip_sigma=[0.01])


def test_what_is_no_dataframe_is_named():
    """With what makes one: of a single row it is not `pandas.DataFrame(row)`, which makes one column."""
    table = pd.DataFrame({"height": [20.0], "poisson": 0.3, "length": 14.0})
    with pytest.raises(TypeError, match=r"table is dict: must be a pandas.DataFrame: pandas.DataFrame\(…\) makes one of it$"):
        Measurements.from_dataframe(table.to_dict("list"))
    row = table.iloc[0]
    with pytest.raises(TypeError, match=r"table is Series: must be a pandas.DataFrame: series.to_frame\(\).T makes one of it$"):
        Measurements.from_dataframe(row)
    from_dataframe = Measurements.from_dataframe
    assert from_dataframe(row.to_frame().T).length == from_dataframe(table).length


@pytest.mark.ci
def test_an_optional_column_of_blanks_is_as_if_absent():
    table = pd.DataFrame({"height_mm": [25.0, 50, 75], "correlation_length_um": 10, "poisson": 0.3, "young_GPa": 3.0})
    table = table.assign(length_mm=[14.0, 34, 59], length_sigma_mm=0.5)
    usual = sp.fit(table, intervals="profile").report()
    for column in ("block_length_mm", "push_height_mm"):
        assert sp.fit(table.assign(**{column: [None] * 3}), intervals="profile").report() == usual
