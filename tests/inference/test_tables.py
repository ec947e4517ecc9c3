"""Tables as people have them: no row and no digit is lost, and what has not one meaning is refused by line and column."""

import csv
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import strategies  # noqa: F401, the profile of hypothesis
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

import slippulse_jax as sp
from slippulse_jax.cli.fit import command
from slippulse_jax.inference.model.models import model_of
from slippulse_jax.inference.table.columns import COLUMNS
from slippulse_jax.inference.table.measurements import MeasurementError, read_gauges

SI = "height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm"
BARE = "height,correlation_length,poisson,young,length,length_sigma"
ONE, TWO = "25,10,0.3,3,14.03,0.5", "45,10,0.3,3,29.95,0.5"
BOTH = f"{ONE}\n{TWO}\n"


def read(folder, text):
    path = folder / "t.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return sp.read_measurements(path)


READ = {
    # `#` in the first column is data
    "labels": (f"label,{SI}\n#1,{ONE}\n#2,{TWO}\n", ()),
    "one label": (f"specimen,{SI}\nA,{ONE}\n#2,{TWO}\n", ()),
    "running numbers": (f"no.,{SI}\n#1,{ONE}\n#2,{TWO}\n", ()),
    "a column of that name": (f"#,{SI}\n1,{ONE}\n2,{TWO}\n", ()),
    "a name that begins so": (f"#run,{SI}\n#1,{ONE}\n#2,{TWO}\n", ()),
    "labels of other marks": (f"label,{SI}\n%1,{ONE}\n//2,{TWO}\n", ()),
    "in quotes": (f'label,{SI}\n"#1",{ONE}\n"#2",{TWO}\n', ()),
    "in a cell of several lines": (f'label,{SI}\n"run\n#2",{ONE}\nb,{TWO}\n', ()),
    "at the start of its second line": (f'label,{SI}\na,{ONE}\n"x\n# y, z\n#",{TWO}\n', ()),
    "in the last column": (f"{SI},note\n{ONE},# of runs: 3\n{TWO},#\n", ()),
    # comments
    "comments above": (f'# Bob\'s "rig, 5"\n#\n\n% of\n! all\n; kinds\n// "\n{SI}\n{BOTH}', ()),
    "comments below": (f"{SI}\n# camera off\n{ONE}\n# a, b\n{TWO}\n# end", (2, 4, 6)),
    "comments of other programs": (f"{SI}\n% x\n{ONE}\n! x\n// y, z\n; x\n{TWO}\n", (2, 4, 5, 6)),
    "comments padded by Excel": (f"# a,,,,,\n{SI}\n# b,,,,,\n{ONE}\n# c, , ,,,\n{TWO}\n", (3, 5)),
    "quoted comments": (f'"# a, b",,,,,\n{SI}\n{ONE}\n"# a, b",,,,,\n{TWO}\n', (4,)),
    "a quotation mark in a comment": (f'{SI}\n# 5", "x" y\n{BOTH}', (2,)),
    "comments between semicolons": (f"; x\n{SI}\n# x; y\n{ONE}\n#; x\n{TWO}\n".replace(",", ";"), (3, 5)),
    # the header
    "numpy.savetxt": (f"# {SI}\n{BOTH}", ()),
    "numpy.savetxt without a space": (f"#{SI}\n{BOTH}", ()),
    "numpy.savetxt, comments": (f"# made today\n# {SI}\n{BOTH}", ()),
    "MATLAB": (f"% {SI}\n{BOTH}", ()),
    "columns listed in a comment": (f"# {SI},kind,specimen\n{SI}\n{BOTH}", ()),
    "a header that is commented out": (f"# {SI.replace('mm', 'cm')}\n{SI}\n{BOTH}", ()),
    "titles": (f"Precursor lengths,,,,,\nrig 2,,,,,\n{SI}\n{BOTH}", (1, 2)),
    "a title of many commas": (f"Rig 2, Paris, France, May, June, July, August\n{SI}\n{BOTH}", (1,)),
    "a title of semicolons": (f"rig; a; b; c; d; e; f; g\n{SI}\n{BOTH}", (1,)),
    "a title in quotes": (f'"Lengths\nof rig 2",,,,,\n"Precursors" of May\n{SI}\n{BOTH}', (1, 3)),
    "names and values": (f"E,3,GPa\ndate,27.11.2026\n\n{SI}\n{BOTH}", (1, 2)),
    "two files in one": (f"{SI}\n{ONE}\n\ufeff{SI}\n{TWO}\n", (3,)),
    "two of numpy.savetxt": (f"# {SI}\n{ONE}\n# {SI}\n{TWO}\n", (3,)),
    # units in a second row
    "units": (f"{BARE}\nmm,um,-,GPa,mm,mm\n{BOTH}", (2,)),
    "units in brackets": (f"{BARE}\n[mm],[µm],[-],[GPa],[mm],[mm]\n{BOTH}", (2,)),
    "units in parentheses": (f"{BARE}\n(mm),(μm),,(GPa),(mm),(mm)\n{BOTH}", (2,)),
    "other units": (f"{BARE}\ncm,nm,1,MPa,m,um\n2.5,1e4,.3,3e3,.01403,500\n4.5,1e4,.3,3e3,.02995,500\n", (2,)),
    "units that agree": (f"{SI}\nmm,µm,,GPa,mm,mm\n{BOTH}", (2,)),
    "units and texts": (f"label,{BARE}\nname,mm,um,–,GPa,mm,mm\na,{ONE}\nb,{TWO}\n", (2,)),
    "units below a title and a comment": (f"rig 2\n{BARE}\n# x\nmm,um,-,GPa,mm,mm\n{BOTH}", (1, 3, 4)),
    # columns without a name
    "empty columns": (f"{SI},,,\n{ONE},,,\n{TWO},,,\n", ()),
    "empty columns in the header only": (f"{SI},,\n{BOTH}", ()),
    "empty columns in the rows only": (f"{SI}\n{ONE},,\n{TWO},\n", ()),
    "empty columns anywhere": (
        f",{SI.replace(',', ',,', 1)}\n,{ONE.replace(',', ',,', 1)}\n,{TWO.replace(',', ', ,', 1)}\n",
        (),
    ),
    "numbers of rows": (f",{SI}\n0,{ONE}\n1,{TWO}\n", ()),
    # characters
    "sep= after a comment": (f"# x\n\nsep=;\n{SI}\n{BOTH}".replace(",", ";"), ()),
    "sep= of any separator": (f"Sep=|\n{SI}\n{BOTH}".replace(",", "|"), ()),
    "two marks of the byte order": (f"\ufeff\ufeff{SI}\n{BOTH}", ()),
    "the same before a comment": (f"\ufeff\ufeff# x\n{SI}\n{BOTH}", ()),
    "no width": (f"\u200b{SI.replace(',', chr(0x2060) + ',')}\n{BOTH.replace('0.5', chr(0x200E) + '0.5' + chr(0xFEFF))}", ()),
    "spaces that do not break": (f"{SI.replace(',', chr(0xA0) + ',')}\n{BOTH.replace(',', chr(0x202F) + ',')}", ()),
    "U+00B5": (f"{SI.replace('um', 'µm')}\n{BOTH}", ()),
    "U+03BC": (f"{SI.replace('um', 'μm')}\n{BOTH}", ()),
    "carriage returns": (f"{SI}\n{BOTH}".replace("\n", "\r"), ()),
    "spaces": (f"{SI}\n{BOTH}".replace(",", " , "), ()),
    "numbers in quotes": (f'{SI}\n"{ONE}"\n"{TWO}"\n'.replace(",", '","').replace('","', ",", 5), ()),
    "forms of numbers": (f"{SI}\n25.,1e1,.3,+3,1403E-2,5e−1\n+45,10.0,0.30,3,29.95,0.5\n", ()),
    "decimal commas": (f"{SI};note\n{BOTH}".replace(",", ";").replace(".", ",").replace("5\n", "5;x.y\n"), ()),
    # blank cells
    "no end": (f"{SI},block_length_mm\n{ONE},\n{TWO},-\n", ()),
    "no end, in words": (f"{SI},block_length_mm\n{ONE},NaN\n{TWO},n/a\n", ()),
    "no kind": (f"{SI},kind\n{ONE},\n{TWO},NA\n", ()),
    "kind and no width": (f"{SI},kind\n{ONE},length\u200b\n{TWO},\u00a0length\n", ()),
}


@pytest.mark.parametrize(("text", "skipped"), READ.values(), ids=READ)
def test_what_has_one_meaning_is_read(tmp_path, text, skipped):
    found, usual = read(tmp_path, text), read(tmp_path, f"{SI}\n{BOTH}")
    for name in ("height", "correlation_length", "poisson", "young", "length", "length_sigma"):
        np.testing.assert_allclose(getattr(found, name), getattr(usual, name), rtol=1e-14)
    assert found.skipped == skipped
    assert (found.kind, found.block_length) == (("length",) * 2, None)
    assert {*found.lines}.isdisjoint(skipped)


def test_texts_are_kept_as_written(tmp_path):
    found = read(tmp_path, f'label,specimen,{SI},note\n"#\r\n2",$\\alpha_{{P,{ONE},#\n%1,1_000,{TWO},"a,""b"\n'.encode())
    assert found.lines == (2, 4)
    assert (found.label, found.specimen) == (("#\r\n2", "%1"), ("$\\alpha_{P", "1_000"))
    assert found.other == {"note": ["#", 'a,"b']}
    assert read(tmp_path, f",{SI}\n0,{ONE}\n").other == {"(no name)": ["0"]}


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        *((cell, r"not a number: it holds '_'") for cell in ("0_5", "14_03", "1_4.0_3", "1e0_1", "_14", "14_")),
        *((cell, r"not a number: it holds '.' \([A-Z- ]*\)") for cell in ("１４", "١٤", "14٫03", "1.4×10", "14½")),
        *((cell, r"not a number: it holds '\S'") for cell in ("0x10", "1,234.5", "1.234,5", "5%", "1/3", "14.03*", "=14")),
        *((cell, r"not a number: it holds ' '") for cell in ("1 234", "14 .03")),
        *((cell, r"not a number: it holds '[<~cm]'") for cell in ("<14", "~14", "ca. 14", "14.03 mm", "14.03mm")),
        *((cell, "not a number; write one, such as 14.03") for cell in ("1.2.3", "--5", "1e", "14-15", "14–15", "2026-11-27")),
        *(
            (cell, "write its error in a column length_sigma_mm$")
            for cell in ("14.03 ± 0.5", "14.03+/-0.5", "14+-1", "14.03(5)")
        ),
        *(
            (cell, "and at_least in a column kind$")
            for cell in (">14", "≥ 14", ">= 14.03", "14+", "at least 14", "30 (ran through)", "ran through", "full")
        ),
        *((cell, rf"column length_mm: {cell}: missing value") for cell in ("NA", "nan", "N/A", "-", "–", "None", "#N/A")),
        *((cell, rf"column length_mm: {cell}: must be finite") for cell in ("inf", "-inf", "Infinity", "1e400")),
        ("1\u2009234", r"it holds '\\u2009' \(THIN SPACE\)"),
        ("1'234", """it holds "'"; write digits"""),
        ("", "column length_mm: missing value"),
        ("−14", "column length_mm: −14: a length must be positive"),
        ("14,03", "'14,03' is not a number; write a decimal point"),
        *((cell, "is not a number$") for cell in ("#REF!", "x", ".", "%")),
    ],
)
def test_what_has_not_is_refused(tmp_path, cell, message):
    with pytest.raises(MeasurementError, match=message) as caught:
        read(tmp_path, f"{SI}\n{ONE.replace('14.03', chr(34) + cell + chr(34))}\n{TWO}\n")
    assert f"{tmp_path}/t.csv, line 2, column length_mm: " in str(caught.value)
    assert "\n" not in str(caught.value)
    table = pd.DataFrame({"height_mm": [25], "correlation_length_um": 10, "poisson": 0.3, "length_mm": [cell]})
    with pytest.raises(MeasurementError, match="^table, row 0, column length_mm: "):
        sp.Measurements.from_dataframe(table)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            f"{SI}\n#{ONE}\n{TWO}\n",
            "line 2, column height_mm: '#25' is not a number; as it has the cells of the header the line is",
        ),
        (f"{SI}\n# a,b,c,d,e,f\n{BOTH}", "line 2, column height_mm: '# a' is not a number"),
        (f'label,{SI}\n# x,"see\na,{ONE}\nb"","",{TWO}\n', "line 2: "),
        (
            f"{SI}\n25,10,0.3,3,14.03,\n{TWO}\n",
            "column length_sigma_mm: missing value: write it in every line, or leave out the col",
        ),
        (f"{SI}\n25,10,0.3,3,14.03,inf\n{TWO}\n", "column length_sigma_mm: inf: must be finite$"),
        (
            f"{SI}\n25,10,0.3,3,14.03,± 0.5\n{TWO}\n",
            r"column length_sigma_mm: '± 0.5' is not a number: it holds '±' \(PLUS-MINUS",
        ),
        (
            f"{SI}\n25,10,−0.3 ± 1,3,14.03,1\n{TWO}\n",
            "column poisson: '−0.3 ± 1' is not a number; write its error in a column poisson_s",
        ),
        (
            f"{SI},block_length_mm\n{ONE},inf\n{TWO},\n",
            "column block_length_mm: inf: must be finite; blank where there is none",
        ),
        (
            f"{SI.replace('young', ',young')}\n25,10,.3,,3,14,1\n45,10,.3,7,3,30,1\n",
            "line 3, column 4: '7' stands below no name",
        ),
        (f"{SI},\n{ONE},7\n", "line 2, column 7: '7' stands below no name"),
        (f"{BARE}\ncm,um,-,GPa,furlong,mm\n{BOTH}", "line 2, column length: 'furlong': one of m, cm, mm"),
        (f"{SI}\ncm,um,-,GPa,mm,mm\n{BOTH}", "line 2, column height_mm: 'cm': its name has another unit"),
        (f"{BARE}\nmm,um,%,GPa,mm,mm\n{BOTH}", "line 2, column poisson: '%': one of"),
        (f"{BARE}\nmm,um,-,GPa,,mm\n{BOTH}", "columns of both forms, height_mm and length"),
        (f"{SI}\n{ONE}\n25,mm,0.3,3,1,1\n", "line 3, column correlation_length_um: 'mm' is not a number"),
        (SI.replace(",", " ") + "\n" + ONE.replace(",", " "), "alone: columns are separated by commas, semicolons or tabs"),
        (f"rig 2,May\n{SI.replace('height_mm', 'H (mm)')}\n{ONE}\n", r"line 2, column H \(mm\): did you mean height_mm\?"),
        (
            f"rig 2\nH (mm),nu,E (GPa)\n{ONE}\n",
            r"line 2, column H \(mm\): did you mean height_mm\? Column nu: did you mean poisson\?",
        ),
        (f"{ONE}\n{SI}\n{TWO}\n", "line 1: no column height, "),
        (
            "Höhe [mm];Länge [mm]\n25;14,03\n",
            "no column height_mm, .*expected the columns height_mm, poisson, length_mm, correlation_l",
        ),
        (f"{SI}\n{ONE}\nmean,,,,14.03,\n", "line 3, column height_mm: 'mean' is not a number"),
        (f"{SI}\n{ONE}\n{TWO},7\n", "line 3: 7 columns, but the header has 6"),
        (f"{SI}\n{ONE}\n25,10\n", "line 3: 2 columns, but the header has 6"),
        (f"{SI}\n".encode() + "25,10,0.3,3,14,½\n".encode("cp1252"), "not UTF-8 text .*save it as CSV UTF-8"),
        (f"{SI}\n{ONE}\n".encode("utf-16"), "not UTF-8 text"),
    ],
)
def test_odd_tables_are_refused(tmp_path, text, message):
    with pytest.raises(MeasurementError, match=message) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path}/t.csv")


@pytest.mark.parametrize("micro", ["um", "µm", "μm"])
def test_every_unit_of_micrometres(tmp_path, micro):
    """Of every column of lengths, in its name, in a row below it, and of gauges."""
    names = [name for name, one in COLUMNS.items() if f"{name}_um" in one.names(in_si=True) and not one.needs.count("young")]
    sizes = {"correlation_length": 10.0, "push_height": 3e3, "push_width": 3e3, "length": 5e3}
    table = pd.DataFrame(
        {name: [sizes.get(name, 1e4)] for name in names if name[:5] not in ("block", "displ")} | {"poisson": 0.3}
    )
    usual = sp.Measurements.from_dataframe(table.rename(columns=lambda name: f"{name}_um" * (name in names) or name))
    table.rename(columns=lambda name: f"{name}_{micro}" * (name in names) or name).to_csv(tmp_path / "a.csv", index=False)
    units = pd.DataFrame({name: [f"[{micro}]" if name in names else "-"] for name in table})
    pd.concat([units, table.astype(object)]).to_csv(tmp_path / "b.csv", index=False)
    for found in (sp.read_measurements(tmp_path / "a.csv"), sp.read_measurements(tmp_path / "b.csv")):
        for name in {*names} & {*table}:
            np.testing.assert_array_equal(getattr(found, name), getattr(usual, name), err_msg=name)
        assert found.in_its_unit(0, found.length[0]) in (f"5000 {micro}", "5000 um")
    (tmp_path / "g.csv").write_text(f"label,position_mm,slip_{micro},slip_sigma_{micro}\na,1,2,0.1\n")
    assert read_gauges(tmp_path / "g.csv", ["a"]).slip == 2e-6


def test_gauges_are_read_like_lengths(tmp_path):
    header, first, second = "label,position_mm,slip_um,slip_sigma_um", "#1,0.5,2,0.1", "#2,0.5,−1,0.1"
    path = tmp_path / "g.csv"
    for text, skipped in (
        (f"{header}\n{first}\n{second}\n", ()),
        (f"rig 2,,,\n{header},\n{first}\n# x\n{second},\n", (1, 4)),
        (f"# {header}\n{first}\n{second}\n", ()),
        ("label,position,slip,slip_sigma\n,mm,µm,μm\n" + f"{first}\n{second}\n", (2,)),
    ):
        path.write_text(text)
        found = read_gauges(path, ["#1", "#2"])
        assert (found.row.tolist(), found.slip.tolist(), found.skipped) == ([0, 1], [2e-6, -1e-6], skipped)
    path.write_text(f"{header}\n{first.replace('2', '0_2')}\n")
    with pytest.raises(MeasurementError, match="line 2, column slip_um: '0_2' is not a number: it holds '_'"):
        read_gauges(path, ["#1"])


@pytest.mark.parametrize("length", [["14", "0_5"], ["14", None, "1_4"], ["１４", "14"], np.array(["14_03"]), ["14_03"]])
def test_texts_in_arrays_are_read_by_the_same_pattern(length):
    with pytest.raises(MeasurementError, match=r"measurements, column length: must be numbers \('.*' is not a number\)"):
        sp.Measurements(25.0, 0.3, length)
    assert sp.Measurements(25.0, 0.3, ["14", "1.4e1"]).length.tolist() == [14, 14]


ODD = [
    "#1",
    "# x",
    "#",
    "//",
    ";",
    "a,b",
    'q"',
    "run\n#2",
    "a\rb",
    "sep=;",
    "nan",
    "-",
    "",
    " x",
    "\ufeffa",
    "1.5",
    "mm",
    "height_mm",
    "−1",
]
TEXTS = st.sampled_from(ODD) | st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=5)
SIZES = st.floats(20, 100)
FIELDS = {
    "length_sigma_mm": st.floats(0.1, 2),
    "block_length_mm": st.none() | st.floats(200, 500),
    "kind": st.sampled_from(["length", "at_least", None]),
    "label": TEXTS,
    "specimen": TEXTS,
    "#run": TEXTS,
    "remark, 2": TEXTS,
    "a; b; c; d; e; f; g": st.integers() | st.floats(),
}


@pytest.mark.ci
@given(st.data())
def test_what_pandas_writes_is_read_back_whole(tmp_path_factory, data):
    """Numbers to the last bit, texts but for outer spaces, in any order of columns, or refused by name."""
    count = data.draw(st.integers(1, 3))
    fields = {
        "height_mm": SIZES,
        "correlation_length_um": st.floats(1, 20),
        "poisson": st.floats(-0.5, 0.5),
        "length_mm": SIZES,
    }
    fields |= {name: FIELDS[name] for name in data.draw(st.lists(st.sampled_from([*FIELDS]), unique=True))}
    columns = {name: data.draw(st.lists(one, min_size=count, max_size=count)) for name, one in fields.items()}
    table = pd.DataFrame(columns)[data.draw(st.permutations([*columns]))]
    mark = data.draw(st.sampled_from(",;\t"))
    path = tmp_path_factory.mktemp("pandas") / "t.csv"
    table.to_csv(
        path,
        sep=mark,
        decimal=data.draw(st.sampled_from("." if mark == "," else ".,")),
        index=data.draw(st.booleans()),
        na_rep=data.draw(st.sampled_from(["", "nan"])),
        lineterminator=data.draw(st.sampled_from(["\n", "\r\n", "\r"])),
        quoting=data.draw(st.sampled_from([csv.QUOTE_MINIMAL, csv.QUOTE_ALL, csv.QUOTE_NONNUMERIC])),
    )
    found, broken = (
        None,
        any(set(text) & {"\r", "\n"} for column in columns.values() for text in column if isinstance(text, str)),
    )
    with suppress(MeasurementError) if broken else nullcontext():  # pandas quotes line ends of its own kind only
        found = sp.read_measurements(path)
    if found is None:
        return
    usual = sp.Measurements.from_dataframe(table)
    assert found.skipped == ()
    for name in ("height", "correlation_length", "poisson", "length", "length_sigma", "block_length", "kind"):
        np.testing.assert_array_equal(getattr(found, name), getattr(usual, name))
    for name in {"label", "specimen"} & {*columns}:
        assert getattr(found, name) == tuple(text.strip() for text in columns[name])
    for name in {"#run", "remark, 2"} & {*columns}:
        assert found.other[name] == [text.strip() for text in columns[name]]


@pytest.mark.parametrize("body", ["slider", "block"])
def test_the_template_is_a_table(tmp_path, body):
    done = CliRunner().invoke(command, ["--template", body])
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.isascii()
    found = read(tmp_path, done.stdout)
    assert len(found) == 1
    assert found.skipped == ()
    assert found.other == {}
    assert (found.push_height is not None) == (body == "block")
    assert found.young is not None
    assert set(found.provenance) == {"measured"}


def test_the_template_of_sequences_is_one(tmp_path):
    """Of which the events are numbered and the last one spans."""
    done = CliRunner().invoke(command, ["--template", "sequence"])
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.isascii()
    assert "# spans: no, yes\n" in done.stdout
    found = read(tmp_path, done.stdout)
    assert model_of(found).event == "sequence"
    assert (found.skipped, found.other) == ((), {})
    np.testing.assert_array_equal(found.event, [1, 2, 3])
    np.testing.assert_allclose(found.force / found.normal_load, [0.1604, 0.2018, 0.1766], rtol=1e-12)
    assert found.kind == ("length", "length", "at_least")
    assert found.length[-1] == found.block_length[-1]
    assert set(found.sequence) == {"A"}


def test_bundled_tables_have_no_line_that_is_skipped():
    tables = [sp.read_measurements(path) for path in Path(__file__).parents[2].glob("fit_examples/*/lengths.csv")]
    assert len(tables) == 11
    assert all(table.skipped == () for table in tables)
