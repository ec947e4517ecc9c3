"""`slippulse series` and `slippulse claims`: output, files read back, pictures, and bad input."""

import io
import json

import jax
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas
import pytest
from click.testing import CliRunner

import slippulse_jax as sp
from slippulse_jax.cli import claims as claims_command
from slippulse_jax.cli import series as series_command
from slippulse_jax.events.catalogue import COLUMNS, EventClass
from slippulse_jax.plot import friction_curve, precursors, space_time

SMALL = ["--height", "10", "--stiffness", "0.03", "--poisson", "0.3", "--sites", "40", "--events", "12"]


@pytest.fixture(scope="module")
def catalogue():
    """The same series as the command's, with its breaks."""
    chain = sp.chain(sp.Slider(10.0, 0.03, 0.3), sites=40)
    return sp.series(chain, events=12, recorded_breaks=600)


def run(command, *arguments):
    return CliRunner().invoke(command.command, list(arguments))


@pytest.mark.ci
def test_csv_on_stdout(catalogue):
    done = run(series_command, *SMALL)
    assert (done.exit_code, done.stderr) == (0, "done: reached the requested number of events or load\n")
    found = pandas.read_csv(io.StringIO(done.stdout))
    assert list(found)[:5] == ["event", "load (u_s)", "force_before (K u_s)", "force_after (K u_s)", "site"]
    assert len(found) == 12
    assert all(pandas.api.types.is_numeric_dtype(column) for column in found.drop(columns="kind").dtypes), (
        "numbers are read as numbers"
    )
    for (name, unit), column in zip(COLUMNS.items(), found.columns[1:], strict=True):
        assert column == (name if unit == "1" else f"{name} ({unit})")
        if name != "kind":
            np.testing.assert_allclose(found[column], np.asarray(getattr(catalogue, name)), rtol=1e-15)
    assert found["kind"][0] == "edge"


def test_json_and_figure(tmp_path, catalogue):
    done = run(series_command, *SMALL, "--json", "--figure", str(tmp_path / "series.png"))
    content = json.loads(done.stdout)
    assert content["status"] == "done"
    assert content["breaks"] == [int(x) for x in catalogue.breaks]
    assert (tmp_path / "series.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.ci
def test_figure_has_every_break(tmp_path, monkeypatch, catalogue):
    """Also where there was no room for them at first."""
    drawn = []
    monkeypatch.setattr(series_command, "BREAKS_AN_EVENT", 0)
    monkeypatch.setattr("slippulse_jax.plot.space_time", lambda found, ax: drawn.append(space_time(found, ax=ax)))
    done = run(series_command, *SMALL, "--figure", str(tmp_path / "series.png"))
    assert done.exit_code == 0, done.output
    assert sum(len(line.get_xdata()) for line in drawn[0].lines) == int(catalogue.breaks.sum())


def test_files_instead_of_stdout(tmp_path):
    done = run(series_command, *SMALL, "--out", str(tmp_path / "series.csv"), "--step", "0.3", "--repin-delay", "1")
    assert (done.exit_code, done.stdout) == (0, "")
    *_, last = (tmp_path / "series.csv").read_text().splitlines()
    assert last.endswith("spanning")
    assert done.stderr.startswith("ended by an event that broke the last contact")


@pytest.mark.ci
def test_a_series_that_spans_has_no_length_in_json():
    done = run(series_command, *SMALL, "--json", "--step", "0.3", "--repin-delay", "1")
    assert done.exit_code == 0, done.output
    content = json.loads(done.stdout)
    assert (content["status"], content["kind"][-1]) == ("spanned", EventClass.SPANNING)
    assert content["length"][-1] is None
    assert content["extent"][-1] == 40


@pytest.mark.ci
def test_contacts_that_keep_a_share_of_their_strength(catalogue):
    done = run(series_command, *SMALL, "--residual-strength", "0.4", "--json")
    content = json.loads(done.stdout)
    expected = sp.series(sp.chain(sp.Slider(10.0, 0.03, 0.3), sites=40, residual_strength=0.4), events=12)
    np.testing.assert_allclose(content["load"], expected.load, rtol=1e-13)
    np.testing.assert_array_equal(content["breaks"], expected.breaks)
    assert content["load"][0] == pytest.approx(float(catalogue.load[0])), "the first event begins as without"
    assert content["stress_drop"][0] < catalogue.stress_drop[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--residual-strength", "1"], "residual_strength = 1: must lie in [0, 1)"),
        (
            ["--residual-strength", "0.5", "--newborn", "0.4", "--recovery", "1"],
            "Ageing.newborn = 0.4 beside residual_strength",
        ),
        (["--step", "0.5", "--spring", "1"], "two protocols"),
        (["--newborn", "0.5"], "needs both --newborn and --recovery"),
        (["--newborn", "1.5", "--recovery", "1"], "Ageing.newborn = 1.5"),
        (["--step", "-1"], "Steps.size = -1"),
        (["--spring", "0"], "Spring.stiffness = 0"),
        (["--out", "series.nc"], "must end in .csv"),
        (["--out", "no/such/folder/series.csv"], "there is no folder no/such/folder"),
        (["--figure", "series.gif"], "must end in"),
        (["--repin-delay", "-2"], "-2 is not in the range"),
        (["--height", "0.5"], "Slider.height = 0.5"),
        (["--sites", "1"], "1 is not in the range"),
    ],
)
def test_bad_input(arguments, message):
    done = run(series_command, *SMALL, *arguments)
    assert done.exit_code == 2
    assert message in done.stderr
    assert done.stdout == ""


@pytest.mark.ci
def test_claims_command(tmp_path):
    done = run(claims_command, "C18", "C16", "--json", "--write", str(tmp_path / "claims.md"))
    assert done.exit_code == 0
    found = json.loads(done.stdout)["claims"]
    assert [(c["number"], c["verdict"]) for c in found] == [("C16", "holds"), ("C18", "holds")]
    assert "| C18 | K_T/K_L" in (tmp_path / "claims.md").read_text()
    assert "HOLDS" in run(claims_command, "C18").stdout


def test_unknown_claim():
    done = run(claims_command, "C0")
    assert (done.exit_code, done.stdout) == (2, "")
    assert "no claim 'C0'" in done.stderr


@pytest.fixture
def ax():
    figure, ax = plt.subplots()
    yield ax
    plt.close(figure)


@pytest.mark.slow
def test_precursors_against_force(ax):
    """Of a chain and of a block: the force over that of all thresholds, and how far events got."""
    chain = sp.chain(sp.Slider(5.0, 0.1, 0.3), sites=30)
    block = sp.Block(10.0, 0.04, 0.3, sp.Push(0.25), length=20, friction=0.3)
    for body, contacts in ((chain, 30), (block, 20)):
        found = sp.series(body, events=60)
        ax.clear()
        precursors(found, body, least_advance=-np.inf, ax=ax)
        events = found.table()
        drawn = [line.get_xydata() for line in ax.lines[1:]]
        expected = np.stack([events["force_before"] / body.stiffness / contacts, events["extent"] / contacts], axis=1)
        np.testing.assert_allclose(np.sort(np.concatenate(drawn), axis=0), np.sort(expected, axis=0))
        force = expected[:, 0]
        assert (np.diff(ax.lines[0].get_ydata()) > 0).all()  # ever farther
    # as the first contact breaks, the mean stress on all contacts
    first = sp.first_precursor(block, event="full")
    assert force[0] == pytest.approx(float(first.stress_before.mean()), rel=1e-9)
    with pytest.raises(ValueError, match="give Block.length"):
        precursors(found, sp.Block(10.0, 0.04, 0.3), ax=ax)


@pytest.mark.ci
def test_friction_curve(ax, catalogue):
    friction_curve(catalogue, ax=ax)
    assert "u_s" in ax.get_xlabel()
    assert "K u_s" in ax.get_ylabel()
    load, force = ax.lines[0].get_data()
    np.testing.assert_array_equal(force[1::2], catalogue.force_before)
    np.testing.assert_array_equal(force[2::2], catalogue.force_after)
    np.testing.assert_array_equal(load[1::2], catalogue.load)
    edge = np.asarray(catalogue.kind) == EventClass.EDGE
    np.testing.assert_array_equal(ax.lines[1].get_xdata(), np.asarray(catalogue.load)[edge])
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["force", "edge"]


def test_space_time(ax, catalogue):
    space_time(catalogue, ax=ax)
    assert "lambda_c" in ax.get_xlabel()
    assert "u_s" in ax.get_ylabel()
    assert sum(len(line.get_xdata()) for line in ax.lines) == int(catalogue.breaks.sum())
    with pytest.raises(ValueError, match="recorded_breaks"):
        space_time(catalogue._replace(break_event=catalogue.break_event * 0 - 1), ax=ax)
    breaks = int(catalogue.breaks.sum())
    with pytest.warns(RuntimeWarning, match=f"{breaks - 9} of {breaks} breaks are not drawn.*recorded_breaks={breaks}"):
        space_time(catalogue._replace(break_site=catalogue.break_site[:9], break_event=catalogue.break_event[:9]), ax=ax)


@pytest.mark.slow
def test_single_precision(float32, catalogue):
    """A series follows the precision of its chain: the same events while no two contacts are as near to their thresholds as 1e-5."""
    chain = sp.chain(sp.Slider(10.0, 0.03, 0.3), sites=40)
    got = sp.series(chain, events=12)
    assert got.load.dtype == np.float32
    assert np.array_equal(got.breaks, catalogue.breaks)
    assert np.allclose(got.load, np.asarray(catalogue.load), rtol=1e-5)
    assert got.drift < 1e-5
    assert jax.numpy.asarray(got.energy_drift).dtype == np.float32
