"""Tables in and out: a fit that is saved and loaded is the same; DataFrames and arrays in SI."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import slippulse_jax as sp
from slippulse_jax.cli.fit import command
from slippulse_jax.inference.result.record import data_hash
from slippulse_jax.inference.table.measurements import MeasurementError, MeasurementWarning

EXAMPLES = Path(__file__).resolve().parents[2] / "fit_examples"
LENGTHS = EXAMPLES / "pmma_block/lengths.csv"


def two_specimens():
    return sp.Measurements(
        height=[20, 40, 20, 40],
        poisson=0.3,
        length=[15.0, 33, 17, 36],
        length_sigma=0.3,
        specimen=tuple("AABB"),
        poisson_sigma=0.02,
    )


@pytest.mark.parametrize(
    ("table", "options"),
    [
        pytest.param(str(LENGTHS), {}, marks=pytest.mark.ci),
        pytest.param(str(LENGTHS), {"sigma": "relative"}, marks=pytest.mark.ci),
        pytest.param(
            two_specimens(), {"free": [sp.Parameter("stiffness", bounds=(1e-4, 0.1), each="specimen"), "offset"], "intervals": "profile"},
            marks=pytest.mark.ci,
        ),
        pytest.param(
            sp.Measurements(height=[20, 40], poisson=0.3, length=[15, 60], kind=("whole", "at_least")), {}, marks=pytest.mark.ci
        ),
        (pd.DataFrame({"height": [20, 40], "poisson": 0.3, "length": [15.0, 33], "length_sigma": 0.3}, index=["A", "B"]), {}),
        pytest.param(sp.Measurements(height=25, poisson=0.3, length=35, length_sigma=1), {}, marks=pytest.mark.ci),
        pytest.param(two_specimens(), {"free": ["stiffness", "prestress"], "fixed": {"offset": 0}}, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_a_loaded_fit_is_the_one_saved(tmp_path, table, options):
    """Report and record to the last digit, and what is computed from a result later on."""
    path = tmp_path / "fit.json"
    result = sp.fit(table, **options)
    result.save(path)
    loaded = sp.load_fit(path)
    assert loaded.report() == result.report()
    assert loaded.to_dict() == result.to_dict()
    np.testing.assert_array_equal(
        loaded.problem(loaded.theta, order=1).gradient, result.problem(result.theta, order=1).gradient
    )


@pytest.mark.ci
def test_the_commands_json_is_that_of_save(tmp_path):
    path = tmp_path / "fit.json"
    path.write_text(CliRunner().invoke(command, [str(LENGTHS), "--json"]).stdout)
    loaded = sp.load_fit(path)
    saved = tmp_path / "again.json"
    loaded.save(saved)
    assert json.loads(saved.read_text()) == json.loads(path.read_text())


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "fit.json"
    with pytest.raises(FileNotFoundError):
        sp.load_fit(path)
    for content, message in (
        ("{}", "its schema is not 3"),
        ('{"schema": 1}', "its schema is not 3"),
        ('{"schema": 99}', "its schema is not 3"),
        ("[1", "fit.json"),
    ):
        path.write_text(content)
        with pytest.raises(ValueError, match=message):
            sp.load_fit(path)


def test_arrays_in_si_are_those_of_a_table():
    table = sp.read_measurements(LENGTHS)
    frame = pd.read_csv(LENGTHS, comment="#")
    read = sp.Measurements.from_dataframe(frame)
    arrays = sp.Measurements.from_si(
        height=frame["height_mm"] * 1e-3,
        length=frame["length_mm"] * 1e-3,
        length_sigma=frame["length_sigma_mm"] * 1e-3,
        correlation_length=frame["correlation_length_um"] * 1e-6,
        poisson=frame["poisson"],
        young=frame["young_GPa"] * 1e9,
    )
    for name in ("height", "length", "length_sigma", "correlation_length", "young", "poisson"):
        np.testing.assert_allclose(getattr(arrays, name), getattr(table, name), rtol=1e-14)
        np.testing.assert_array_equal(getattr(read, name), getattr(table, name))
    with pytest.raises(ValueError, match="correlation_length = 0: .*0.1 nm"):
        sp.Measurements.from_si(height=1.0, length=1.0, poisson=0.3, correlation_length=0.0)
    with pytest.raises(MeasurementError, match="the height must exceed"):
        sp.Measurements.from_si(height=1e-6, length=1.0, poisson=0.3, correlation_length=1e-5)


def test_a_catalogue_as_a_dataframe():
    catalogue = sp.series(sp.chain(sp.Slider(5.0, 0.1, 0.3), sites=30), sp.Steps(0.5), events=4)
    frame = catalogue.to_dataframe()
    assert len(frame) == int(catalogue.number) > 0
    assert frame["kind"][0] == "edge"
    assert frame.attrs["units"]["load"] == "u_s"
    np.testing.assert_array_equal(frame["length"], catalogue.table()["length"])


def measured(scale=1.0, **columns):
    height = np.array([20.0, 40.0, 60.0])
    length = scale * np.asarray(sp.exact_lengths(sp.Slider(height, 0.003, 0.3))) * [1.01, 0.99, 1.0]
    return sp.Measurements(height, 0.3, length, columns.pop("sigma", 0.3), provenance=("measured",) * 3, **columns)


@pytest.mark.ci
def test_the_request_is_the_arguments_of_the_fit():
    """Without what measuring adds, so that another table gets errors of its own."""
    result = sp.fit(measured(), fixed={"threshold_scatter": 0})
    assert {"offset", "model_factor"} <= set(result.parameters.names)
    assert [one.name for one in result.request["free"]] == ["stiffness", "threshold_scatter"]
    again = sp.fit(measured(), **result.request)
    assert again.values == result.values
    assert again.intervals == result.intervals


@pytest.mark.ci
def test_a_request_of_one_measured_table_leaves_another_its_own_errors(tmp_path):
    sp.fit(measured(), fixed={"threshold_scatter": 0}).save(tmp_path / "fit.json")
    pd.DataFrame(
        {"height": [20, 40, 60], "poisson": 0.3, "length": measured().length, "length_sigma": 0.6, "provenance": "measured"}
    ).to_csv(tmp_path / "other.csv", index=False)
    found = CliRunner().invoke(command, [str(tmp_path / "other.csv"), "--request", str(tmp_path / "fit.json"), "--json"])
    assert found.exit_code == 0, found.output
    (tmp_path / "other.json").write_text(found.stdout)
    assert sp.load_fit(tmp_path / "other.json").parameters.named("offset").prior_sigma == pytest.approx(0.6)


@pytest.mark.ci
@pytest.mark.parametrize(
    "name", ["pmma_block", *(pytest.param(name, marks=pytest.mark.ci) for name in ("pushed_block", "threshold_profile"))]
)
def test_a_loaded_fit_fits_nothing_again(name, tmp_path, monkeypatch, worked):
    result = worked(name)
    result.save(tmp_path / "fit.json")
    said, content = result.report(verbose=True), result.to_dict()

    def refuse(*_, **__):
        raise AssertionError("fitted again")

    for module in ("result.changes", "result.suggestions", "search.minima", "search.intervals", "result.samples"):
        monkeypatch.setattr(f"slippulse_jax.inference.{module}.minimise", refuse)
    for name in ("changes._refitted", "changes._again", "suggestions._with"):
        monkeypatch.setattr(f"slippulse_jax.inference.result.{name}", refuse)
    monkeypatch.setattr("slippulse_jax.inference.fit.fit", refuse)
    loaded = sp.load_fit(tmp_path / "fit.json")
    assert loaded.report(verbose=True) == said
    assert loaded.to_dict() == content
    loaded.save(tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == json.loads((tmp_path / "fit.json").read_text())


@pytest.mark.ci
def test_likely_mistakes_are_found_once_and_kept(tmp_path):
    """Told by a warning, in the box and in the record."""
    m = sp.read_measurements(LENGTHS)
    longer = dataclasses.replace(m, length=10 * m.length, length_sigma=10 * m.length_sigma)
    path = tmp_path / "fit.json"
    with pytest.warns(MeasurementWarning) as told:
        result = sp.fit(longer, ["stiffness", sp.Parameter("height", prior=(25.0, 1.0))], intervals="profile")
    assert result.suspicions == tuple(str(one.message) for one in told)
    assert told[0].filename == __file__
    assert len(result.suspicions) == 2
    result.save(path)
    assert json.loads(path.read_text())["suspicions"] == list(result.suspicions)
    loaded = sp.load_fit(path)
    assert loaded.suspicions == result.suspicions
    assert loaded.report() == result.report()


def test_the_hash_of_the_data_has_specimens_and_provenance():
    """Which decide what is fitted beside the stiffness."""
    m = measured()
    others = [m, dataclasses.replace(m, provenance=()), dataclasses.replace(m, specimen=tuple("AAB"))]
    assert len({data_hash(one) for one in others}) == 3
