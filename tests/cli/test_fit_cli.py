"""``slippulse fit``: options, request files, a run repeated from its own JSON, and refusals with exit status 2."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from reports import unfolded

from slippulse_jax.cli.fit import command
from slippulse_jax.inference.fit import fit
from slippulse_jax.inference.result.record import from_request, read_request
from slippulse_jax.inference.table.measurements import Measurements

ROOT = Path(__file__).resolve().parents[2]
DATA = str(ROOT / "fit_examples/pmma_block/lengths.csv")


def run(*arguments):
    return CliRunner().invoke(command, [DATA, *arguments])


@pytest.mark.ci
def test_options_and_request_say_the_same(tmp_path):
    """A TOML file, the options, and the JSON of the run itself give the same fit to the last bit."""
    (tmp_path / "request.toml").write_text("[parameters.stiffness]\n[parameters.poisson]\nprior = [0.3, 0.02]\n")
    by_file = run("--request", str(tmp_path / "request.toml"), "--json", "--bootstrap", "20")
    assert by_file.exit_code == 0, by_file.output
    first = json.loads(by_file.stdout)
    by_options = json.loads(run("--free", "stiffness", "--free", "poisson", "--prior", "poisson=0.3,0.02", "--json").stdout)
    assert first["values"] == by_options["values"]
    assert set(first["bootstrap"]["stderr"]) == {"areal_stiffness", "poisson"}
    assert {"slippulse_jax", "jax", "numpy"} <= set(first["versions"])
    (tmp_path / "run.json").write_text(by_file.stdout)
    again = json.loads(run("--request", str(tmp_path / "run.json"), "--json").stdout)
    for key in ("values", "stderr", "intervals", "request", "data_sha256", "chi2"):
        assert again[key] == first[key]


@pytest.mark.ci
def test_pictures(tmp_path):
    names = {option: tmp_path / f"{option}.png" for option in ("figure", "profiles", "corner")}
    done = run("--intervals", "calibrated", *[x for option, path in names.items() for x in (f"--{option}", str(path))])
    assert done.exit_code == 0, done.output
    assert "(simulated)" in done.stdout
    assert all(path.stat().st_size > 5000 for path in names.values())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--free", "k"], "parameter 'k': one of stiffness"),
        (["--prior", "poisson=a"], "NAME=NUMBER"),
        (["--prior", "poisson=0.3"], "prior = .*two numbers"),
        (["--fix", "prestress=0.1,0.2"], "--fix prestress: one value"),
        (["--request", "none.toml"], "none.toml: No such file"),
        (["--sigma", "relative", "--intervals", "calibrated"], "calibrated intervals need absolute standard errors"),
        (["--case"], "--case says how --bootstrap draws"),
        (["--json", "--verbose"], "--verbose adds to the report, and --json prints none"),
        (["--json", "--methods"], "--methods adds to the report, and --json prints none"),
        (["--fix", "poisson=3"], r"poisson = 3 means ν = 3 for some measurement: must lie in \(-1, 0.5\]: Poisson's ratio ν"),
        (["--prior", "young=3,0.1"], r"Error: young = 3 Pa, where young_GPa says 3e\+09 Pa: .*; is it in GPa\?"),
        (["--fix", "young=3"], r"Error: young = 3 Pa, where young_GPa says 3e\+09 Pa: .*; is it in GPa\?"),
        (["--range", "young=1,5"], r"Error: young = 1 to 5 Pa, where young_GPa says 3e\+09 Pa: .*; is it in GPa\?"),
        (["--bounds", "10", "30"], r"no domino starts at k/K from 3\.333e-14 to 1e-13; expected within \S+ to \S+ Pa/m"),
        (["--sigma", "relative", "--posterior", "10"], "a posterior needs a likelihood"),
        (["--each-specimen", "offset", "--range", "offset=1,0"], "increasing order"),
    ],
)
def test_refusals(arguments, message):
    done = run(*arguments)
    assert done.exit_code == 2, done.output
    assert re.search(message, done.output)


@pytest.mark.ci
def test_lengths_on_the_plateau_are_named_in_the_remarks(tmp_path):
    path = tmp_path / "plateau.csv"
    path.write_text("height,poisson,length,length_sigma\n25,0.3,26.2,0.3\n40,0.3,30,0.3\n")
    done = CliRunner().invoke(command, [str(path)])
    assert "\n  - 1 of 2 lengths lies within 3 % of the longest attainable" in done.stdout
    assert run("--free", "stiffness", "--json").stderr == ""


@pytest.mark.ci
def test_a_prior_in_the_unit_of_the_table_is_said():
    """It can be fitted, so that it is a warning."""
    done = run("--free", "stiffness", "--free", "height", "--prior", "height=25,1", "--intervals", "profile")
    assert done.exit_code == 0, done.output
    hint = "height = 25 m, where height_mm says 0.025 m: priors, bounds and held values are in m; is it in mm?"
    sentences = hint.replace("; is", ". Is")
    assert done.stderr.count(hint) == 1
    assert f"check first: {hint}\n" in done.stderr
    assert f"Check first: {sentences}" in unfolded(done.stdout)


@pytest.mark.ci
def test_where_no_length_is_the_longest_attainable_json_has_null(monkeypatch):
    """As beyond run-away, where no stiffness stops the front."""

    def endless(q, theta):
        return (np.full(len(q.inputs.at(theta).ratio), np.inf),) * 2

    monkeypatch.setattr("slippulse_jax.inference.parameters.ParameterSet.attainable", endless)
    done = run("--json")
    assert done.exit_code == 0, done.output
    assert set(json.loads(done.stdout)["attainable"]) == {None}


@pytest.mark.ci
def test_intervals_are_simulated_where_two_sides_of_the_peak_fit(tmp_path):
    path = tmp_path / "peak.csv"
    path.write_text("height,poisson,length,length_sigma\n25,0.3,25.9,0.4\n40,0.3,41.6,0.6\n")
    by_default, calibrated, profile = (
        json.loads(CliRunner().invoke(command, [str(path), "--json", *option]).stdout)["intervals"]
        for option in ([], ["--intervals", "calibrated"], ["--intervals", "profile"])
    )
    assert by_default == calibrated != profile


def test_request_that_is_not_one(tmp_path):
    for text, message in (("loss = ", "Invalid value"), ("lss = 'normal'", "lss not understood"), ("parameters = 3", "tables"),
                          ("[parameters.stiffness]\nbound = [1, 2]", "bound not understood")):  # fmt: skip
        path = tmp_path / "request.toml"
        path.write_text(text)
        done = run("--request", str(path))
        assert done.exit_code == 2, text
        assert message in done.output


WRONG = [None, "x", -1, 1.5, True, [], ["a", "b"], [2, 1], {"a": 1}, [[1], [2]], float("nan")]


def test_requests_of_wrong_types_are_refused(tmp_path):
    """ValueError, which the command line turns into one line and exit status 2; never a TypeError or a RecursionError."""
    path = tmp_path / "request.json"

    def refused(text):
        path.write_text(text)
        with pytest.raises(ValueError):  # noqa: PT011 - any message, but no other error
            fit(table, **from_request(read_request(path)))

    table = Measurements(height=[25.0, 30.0], poisson=[0.3, 0.3], length=[25.0, 28.0], length_sigma=[1.0, 1.0])
    for key in ("loss", "sigma", "method", "intervals", "seed", "max_steps"):
        for value in WRONG:
            refused(json.dumps({key: value, "parameters": {"stiffness": {}}}))
    for key in ("bounds", "prior", "value", "each"):
        for value in WRONG:
            if value is not None and (key, value) not in (("prior", [2, 1]), ("value", 1.5)):
                refused(json.dumps({"parameters": {"stiffness": {key: value}}}))
    for value in WRONG:
        refused(json.dumps({"parameters": value}))
    for text in ('{"a":' * 100_000, "a=" + "[" * 100_000, '{"request": 3}'):
        refused(text)


def test_an_example_is_a_worked_fit(monkeypatch, tmp_path):
    """The wheel has the table of each worked fit, and `--example` finds them all, wherever it is run."""
    monkeypatch.chdir(tmp_path)
    tables = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.glob("fit_examples/*/lengths.csv"))
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["force-include"] == {table: f"slippulse_jax/{table}" for table in tables}
    read = []
    monkeypatch.setattr(
        "slippulse_jax.inference.table.measurements.read_measurements", lambda path, **_: read.append(path) or 1 / 0
    )
    for table in tables:
        done = CliRunner().invoke(command, ["--example", Path(table).parent.name])
        assert isinstance(done.exception, ZeroDivisionError)
        assert read[-1].read_bytes() == (ROOT / table).read_bytes()
    assert len(set(read)) == len(tables) >= 8


@pytest.mark.ci
def test_an_example_is_fitted_as_its_table():
    assert CliRunner().invoke(command, ["--example", "pmma_block", "--json"]).stdout == run("--json").stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--example", "pmma_blok"], r"'pmma_blok': one of counts_.*, threshold_profile; did you mean pmma_block\?"),
        (["--example", "my.csv"], "'my.csv': one of counts_.*, threshold_profile$"),
        (["my.csv", "--example", "pmma_block"], "--example pmma_block and my.csv are two tables to fit: give one"),
        ([], "Missing argument 'LENGTHS.CSV': give a table, or --example pmma_block"),
    ],
)
def test_one_table_is_fitted(arguments, message):
    done = CliRunner().invoke(command, arguments)
    assert done.exit_code == 2
    assert re.search(message, done.output, flags=re.M)
