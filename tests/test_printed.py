"""What is printed is what was computed: σ shown and σ used, requests and records, bounds, guesses, the box and its lines."""

import dataclasses
import functools
import json
import re
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import slippulse_jax as sp
from slippulse_jax.cli.fit import command
from slippulse_jax.inference import interpolation
from slippulse_jax.inference.parameters import Inputs, pushed
from slippulse_jax.inference.record import data_hash
from slippulse_jax.inference.verdict import Identifiability

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = sorted(path.parent.name for path in (ROOT / "fit_examples").glob("*/lengths.csv"))
PMMA, PUSHED = ROOT / "fit_examples/pmma_block/lengths.csv", ROOT / "fit_examples/pushed_block/lengths.csv"
NOISE = np.array([0.4, -1.1, 0.8, -0.3, 1.0, -0.7])


@functools.cache
def example(name):
    return sp.fit(ROOT / f"fit_examples/{name}/lengths.csv")


@functools.cache
def measured():
    """Six precise lengths, a fifth longer than those of any stiffness: a model factor is fitted, and an offset."""
    height = np.array([10.0, 16.0, 25.0, 40.0, 60.0, 90.0])
    length = 1.2 * np.asarray(sp.exact_lengths(sp.Slider(height, 0.003, 0.3)))
    return sp.fit(sp.Measurements(height, 0.3, length + 0.05 * NOISE, 0.05, provenance=["measured"] * 6))


@functools.cache
def between_contacts():
    """Precise lengths on short sliders, to which the definition of a length between two contacts matters."""
    height = np.array([6.0, 7.0, 8.0, 9.0, 10.0])
    return sp.fit(sp.Measurements(height, 0.3, np.asarray(sp.precursor_lengths(sp.Slider(height, 0.02, 0.3))), 0.02))


@functools.cache
def loaded():
    """With the displacement at nucleation, which is another datum per length."""
    m = sp.read_measurements(PMMA)
    moved = 1e-5 * (1 + 0.1 * NOISE)
    m = dataclasses.replace(m, displacement=moved, displacement_sigma=0.1 * moved, young_sigma=0.05 * m.young)
    return sp.fit(m, ["stiffness", "strength"])


@functools.cache
def rejected():
    """One length at odds with the others."""
    m = sp.read_measurements(PMMA)
    return sp.fit(dataclasses.replace(m, length=m.length * np.where(np.arange(6) == 2, 1.25, 1)))


@functools.cache
def narrow():
    """A block pushed by a patch 0.1 H high around 0.25 H: its true k/K, and fits with the width stated and without."""
    height, ratio = np.array([200.0, 400.0, 600.0, 800.0]), 0.1 / (2.6 * 200)  # b from 0.1 to 0.4
    inputs = Inputs.of(height, ratio, 0.3)._replace(**pushed(height, 0.25 * height, 0.1 * height))
    length, _ = interpolation.block_lengths(inputs)
    m = sp.Measurements(height, 0.3, length, 0.02 * length, push_height=0.25 * height)
    return ratio, sp.fit(dataclasses.replace(m, push_width=0.1 * height)), sp.fit(m)


def box(report):
    """The text in the box, unfolded."""
    return " ".join(" ".join(line.strip("│ ") for line in report.splitlines() if line.startswith("│")).split())


# --- σ ------------------------------------------------------------------------------------------------------------------


CASES = {name: functools.partial(example, name) for name in EXAMPLES}
CASES |= {"measured": measured, "loaded": loaded, "between contacts": between_contacts, "rejected": rejected}


@pytest.mark.parametrize("case", CASES)
def test_residuals_shown_add_up_to_the_deviance(case):
    """With those of further data and the pulls of priors: σ used is σ shown."""
    result = CASES[case]()
    if not result.problem.plain:
        assert case in ("counts_and_run_throughs", "own_csv", "paper_printed_value")
        return
    pulls = [
        (theta - one.prior_mean) / one.prior_sigma
        for theta, one in zip(result.theta, result.parameters.free, strict=True)
        if np.isfinite(one.prior_sigma)
    ]
    every = np.concatenate([result.residuals, *(one.residuals for one in result.further), pulls])
    assert result.deviance == pytest.approx((every**2).sum(), rel=1e-9, abs=1e-12)
    assert len(result.further) == (case == "loaded")
    assert bool(pulls) == (case in ("loaded", "measured"))


def test_an_enlarged_sigma_is_in_the_table():
    result = between_contacts()
    assert result.between_contacts is not None
    np.testing.assert_allclose(result.sigma, np.hypot(0.02, result.between_contacts), rtol=1e-12)
    report = result.report()
    shown = [float(x) for x in re.findall(r"\d ± (\S+) +\S+ +[+-]\d+\.\d\d$", report, re.MULTILINE)]
    assert shown == pytest.approx(result.sigma, rel=0.05)
    assert max(shown) > 0.03
    assert "σ as given" not in box(report)
    assert "σ enlarged as remarked below" in box(report)
    assert f"up to {max(result.between_contacts):.2g} λc" in report
    assert "which is added to σ in quadrature" in report
    assert "σ as given" in box(example("pmma_block").report())


# --- counted contacts ---------------------------------------------------------------------------------------------------


def test_broken_contacts_are_those_of_the_front_itself():
    """Model factor and offset belong to the measurement: they break no contacts."""
    result = measured()
    assert result.inputs["model_factor"] > 1.05
    inputs = result.parameters.inputs_at(result.theta)
    front = sp.exact_lengths(sp.Slider(np.exp(inputs.log_height), inputs.ratio, inputs.poisson))
    assert result.fitted.contacts_broken.tolist() == np.ceil(front).astype(int).tolist()
    assert (result.fitted.contacts_broken < np.ceil(result.fitted.length)).all()


# --- requests and records -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["measured", "pushed_block", "pmma_block"])
def test_the_request_of_a_result_are_the_arguments_of_fit(case):
    result = CASES[case]()
    assert [one.name for one in result.request["free"]] == ["stiffness"]
    assert (result.request["event"], result.request["body"]) == (None, None)
    again = sp.fit(result.measurements, **result.request)
    np.testing.assert_array_equal(again.theta, result.theta)
    assert again.parameters.names == result.parameters.names


def test_a_repeated_request_takes_the_offset_of_its_own_table(tmp_path):
    """The prior of the offset is the σ of the table, so it is no part of a request."""
    table = pd.read_csv(PMMA).assign(provenance="measured")
    table.to_csv(tmp_path / "first.csv", index=False)
    table.assign(length_sigma_mm=3.0).to_csv(tmp_path / "other.csv", index=False)

    def fitted(name, *options):
        found = CliRunner().invoke(command, [str(tmp_path / name), "--json", *options])
        assert found.exit_code == 0, found.output
        return found.stdout

    (tmp_path / "fit.json").write_text(fitted("first.csv"))
    first = json.loads((tmp_path / "fit.json").read_text())
    own, repeated = (
        json.loads(fitted("other.csv", *more)) for more in ([], ["--request", str(tmp_path / "fit.json")])
    )
    assert list(first["request"]["parameters"]) == ["stiffness"]
    assert "offset" in first["inputs"]
    assert repeated["stderr"] == own["stderr"]
    assert repeated["searched"] == own["searched"]
    assert repeated["searched"]["offset"] == pytest.approx([6 * x for x in first["searched"]["offset"]])
    assert repeated["stderr"]["areal_stiffness"] > 2 * first["stderr"]["areal_stiffness"]


@pytest.mark.parametrize("case", ["pmma_block", "pushed_block", "rejected"])
def test_a_saved_fit_is_reported_without_another_fit(case, tmp_path, monkeypatch):
    """What else would move it, and what to try next, are in the file."""
    result = CASES[case]()
    result.save(tmp_path / "fit.json")
    report, content = result.report(verbose=True), result.to_dict()
    assert bool(result.next_steps) == (case == "rejected")
    assert (result.as_slider is not None) == (case == "pushed_block")
    assert bool(result.unstated_push) == bool(result.budget) == (case != "rejected")

    def refuse(*_args, **_settings):
        raise AssertionError("fitted again")

    for name in ("budget._refitted", "budget._narrower", "hints._helps", "hints.minimise", "fit.fit"):
        monkeypatch.setattr(f"slippulse_jax.inference.{name}", refuse)
    again = sp.load_fit(tmp_path / "fit.json")
    assert again.report(verbose=True) == report
    assert again.to_dict() == content
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "fit.json").read_bytes()


def test_the_hash_of_data_differs_with_specimens_and_provenance():
    """Both decide what is fitted beside the stiffness."""
    m = sp.read_measurements(PMMA)
    others = [
        m,
        dataclasses.replace(m, specimen=list("AAABBB")),
        dataclasses.replace(m, specimen=list("ABABAB")),
        dataclasses.replace(m, specimen=()),
        dataclasses.replace(m, provenance=["measured"] * 6),
        dataclasses.replace(m, provenance=()),
        dataclasses.replace(m, specimen=m.provenance, provenance=()),
    ]
    assert len({data_hash(one) for one in others}) == len(others)
    assert data_hash(dataclasses.replace(m, source="another name")) == data_hash(m)


# --- bounds -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["pmma_block", "pushed_block"])
@pytest.mark.parametrize("as_parameter", [False, True])
def test_bounds_of_another_unit_are_refused(case, as_parameter):
    """Bounds in k/K, where those of the areal stiffness are expected; the range named is the one searched by default."""
    result = example(case)
    value, m = result.values["areal_stiffness"], result.measurements

    def bounded(low, high):
        if as_parameter:
            return sp.fit(m, sp.Parameter("stiffness", bounds=(low, high)))
        return sp.fit(m, bounds=(low, high))

    with pytest.raises(ValueError, match=r"bounds = \(1e-06, 0\.01\) of areal_stiffness are taken in Pa/m") as refused:
        bounded(1e-6, 1e-2)
    low, high = map(float, re.search(r"expected within (\S+) to (\S+) Pa/m", str(refused.value)).groups())
    assert [low, high] == pytest.approx(result.to_dict()["searched"]["areal_stiffness"], rel=0.05)
    meant = float(re.search(r"k/K = 0\.01 is (\S+) Pa/m\)", str(refused.value))[1])
    assert meant == pytest.approx(0.01 * value / result.values["stiffness"], rel=0.05)
    assert bounded(value / 2, 2 * value).values["areal_stiffness"] == pytest.approx(value, rel=1e-6)


# --- what the report says -----------------------------------------------------------------------------------------------


def test_where_all_values_fit_equally_none_is_preferred():
    result = example("counts_and_run_throughs")
    assert result.identifiability is Identifiability.EQUAL
    said = box(result.report())
    assert "any in the interval" in said
    assert "highest likelihood" not in said
    assert "σ as given" not in said


def test_a_guessed_pusher_is_said_with_its_effect():
    """The factor leads to the true stiffness; nothing is said to be guessed where the width is stated."""
    ratio, stated, guessed = narrow()
    assert stated.values["stiffness"] == pytest.approx(ratio, rel=1e-3)
    assert "guessed:" not in box(stated.report()).lower()
    assert stated.unstated_push == {}
    (factor,) = guessed.unstated_push.values()
    assert list(guessed.unstated_push) == ["0.1 H high"]
    assert factor * guessed.values["stiffness"] == pytest.approx(ratio, rel=0.25)
    assert abs(np.log(factor)) > 0.5
    said = box(guessed.report())
    assert "Guessed: the pusher covers all of the side above push_height" in said
    assert f"if it is 0.1 H high, the stiffness is about {factor:.2g} times as large" in said


def test_the_report_of_the_bundled_table_fits_a_screen():
    result = example("pmma_block")
    assert len(result.report().splitlines()) <= 30
    assert "k/λc² = (1.96 ± 0.17)e10 Pa/m; (1.956 ± 0.032)e10 from the lengths alone" in result.methods()
    for error in ("(1.96 ± 0.17)e10", "(1.956 ± 0.032)e10"):
        assert error in box(result.report())


def test_the_readme_shows_the_box_that_the_first_command_prints():
    readme = (ROOT / "README.md").read_text()
    shown = readme.partition("slippulse fit fit_examples/pmma_block/lengths.csv")[2].partition("```text\n")[2].splitlines()
    printed = sp.fit(PMMA).report().splitlines()
    last = next(i for i, line in enumerate(printed) if line.startswith("└"))
    assert shown[: last + 1] == printed[: last + 1]


def test_a_corner_plot_draws_every_kind_of_samples():
    result = sp.fit(PMMA, ["stiffness", sp.Parameter("poisson", prior=(0.3, 0.02))])
    drawn = result.bootstrap(20)
    posterior = result.theta + 0.01 * np.random.default_rng(0).standard_normal((30, 2))
    figure = sp.plot.corner(result, {"bootstrap": drawn, "posterior": posterior}, nodes=7)
    (panel,) = [ax for ax in figure.axes if ax.get_xlabel() and ax.get_legend() and ax.collections and len(ax.lines) == 3]
    points = {line.get_label(): line.get_xdata() for line in panel.lines[:2]}
    assert list(points) == ["bootstrap", "posterior"]
    np.testing.assert_allclose(points["bootstrap"], np.exp(drawn.theta[:, 0]))
    np.testing.assert_allclose(points["posterior"], np.exp(posterior[:, 0]))
    assert panel.lines[0].get_color() != panel.lines[1].get_color()
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["bootstrap", "posterior"]


# --- tables -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [pd.Series([1.0, 2.0], name="length"), {"length": [1.0, 2.0]}, [1.0, 2.0]])
def test_what_is_no_table_is_refused_by_its_type(given):
    with pytest.raises(TypeError, match=f"table is {type(given).__name__}: must be a pandas.DataFrame"):
        sp.Measurements.from_dataframe(given)


@pytest.mark.parametrize("column", ["block_length_mm", "push_height_mm", "push_width_mm"])
@pytest.mark.parametrize("blank", [None, np.nan])
def test_a_blank_column_is_as_if_it_were_not_there(column, blank):
    table = pd.read_csv(PMMA)
    empty = table.assign(**{column: pd.Series([blank] * len(table), dtype=object)})
    m = sp.Measurements.from_dataframe(empty)
    assert m.block_length is None
    assert m.push_height is None
    assert m.push_width is None
    if column != "push_width_mm":
        assert sp.fit(empty).report(verbose=True) == _without_column().report(verbose=True)


@functools.cache
def _without_column():
    return sp.fit(pd.read_csv(PMMA))


def test_a_block_that_ends_is_refused_by_the_names_of_its_columns():
    """No other body is recommended: the slider would give another stiffness."""
    table = pd.read_csv(PMMA).assign(block_length_mm=500.0, push_height_mm=5.0)
    with pytest.raises(ValueError, match="block_length_mm beside push_height_mm") as refused:
        sp.fit(table)
    assert "slider" not in str(refused.value)
    assert "leave it out" in str(refused.value)


# --- progress -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slow", [False, True])
def test_long_computations_are_announced_once(slow, capsys, monkeypatch):
    """On a stderr that is no terminal, where a bar would not be seen; quick ones are not."""
    if slow:
        monkeypatch.setattr(interpolation, "LONG", 0.05)

    def compute(place):
        time.sleep(0.03)
        return place

    place = np.arange(6 * interpolation.AT_ONCE, dtype=float)[:, None]
    grid = interpolation.Grid([1.0], compute)
    np.testing.assert_array_equal(grid(place), place)
    grid(place)  # known by now
    out, err = capsys.readouterr()
    assert out == ""
    assert bool(re.fullmatch(rf"following {len(place)} events of blocks, which takes about \d+ s more\n", err)) == slow
    assert bool(err) == slow
