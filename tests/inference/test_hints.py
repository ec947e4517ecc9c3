"""Hints: what a table may have wrong, and what a rejected fit suggests to try next, by options that there are."""

import dataclasses
import re

import numpy as np
import pytest
from click.testing import CliRunner
from reports import unfolded

import slippulse_jax as sp
from slippulse_jax.base.domains import Domain
from slippulse_jax.cli.fit import command
from slippulse_jax.inference.parameters import Parameter, suspicions
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.table.columns import COLUMNS
from slippulse_jax.inference.table.measurements import MeasurementError, Measurements, MeasurementWarning

HEIGHT = np.array([15.0, 25.0, 40.0, 60.0, 80.0, 100.0])
NOISE = 0.3 * np.random.default_rng(0).standard_normal(6)


def lengths(stiffness, **interface):
    return sp.exact_lengths(sp.Slider(HEIGHT, stiffness, 0.3), sp.Interface(**interface))


def rejected(length, **columns):
    """The steps offered after a rejected fit; an option is one of `fit`, and of the command where they came from a file."""
    arrays = Measurements(height=HEIGHT, poisson=0.3, length=length, length_sigma=0.3, **columns)
    steps_of(dataclasses.replace(arrays, lines=range(2, 8), source="some.csv"))
    steps = steps_of(arrays)
    assert "--" not in " ".join(steps)
    return arrays, steps


def steps_of(m):
    result = sp.fit(m)
    assert result.identifiability in (Identifiability.POOR_FIT, Identifiability.AT_MAXIMUM)
    text = unfolded(result.report())
    assert text.count(result.identifiability.value[1:]) == 1
    assert "What to try next" in text
    known = {option for one in command.params for option in one.opts}
    assert set(re.findall(r"--[a-z-]+", " ".join(result.next_steps))) <= known
    assert result.to_dict()["next_steps"] == result.next_steps
    for step in result.next_steps:
        for argument in re.findall(r"(?:free=\[.*\]|loss=\S+|sigma=\S+)", step):
            again = sp.fit(m, **eval(f"dict({argument})", {"sp": sp}), intervals="profile")
            chi2 = re.search(r"chi-squared (\S+) for", step)
            assert chi2 is None or "loss" in argument or f"{again.deviance:.3g}" == chi2[1], step
    return result.next_steps


@pytest.mark.ci
def test_specimens_of_different_stiffness():
    two = np.where(np.arange(6) % 2, lengths(0.002), lengths(0.008))
    m, steps = rejected(two + NOISE, specimen=tuple("ABABAB"))
    assert 'try one stiffness for each: free=[sp.Parameter("stiffness", each="specimen")] (chi-squared' in steps[0]
    each = sp.fit(m, [sp.Parameter("stiffness", each="specimen")], intervals="profile")
    assert each.values["stiffness[A]"] == pytest.approx(0.008, rel=0.2)
    assert each.next_steps == []
    ax = sp.plot.fit_lengths(each)
    curves = [line for line in ax.lines if "best fit" in str(line.get_label())]
    assert [curve.get_color() for curve in curves] == [drawn[0].get_color() for drawn in ax.containers]


@pytest.mark.ci
def test_one_outlier():
    typo = (lengths(0.004) + NOISE) * np.where(np.arange(6) == 2, 1.6, 1)
    m, steps = rejected(typo)
    assert "measurement 2 is at odds with the others" in steps[0]
    assert 'loss="student"' in steps[0]
    (step,) = [one for one in steps_of(dataclasses.replace(m, lines=range(2, 8))) if "line 4" in one]
    assert '--loss student, in Python loss="student"' in step
    assert sp.fit(m, loss="student").values["stiffness"] == pytest.approx(0.004, rel=0.1)


@pytest.mark.ci
def test_a_trend_in_height():
    _, steps = rejected(lengths(0.004, prestress=0.3) + NOISE)
    assert "too long on low blocks and too short on tall ones" in steps[0]
    assert 'the same for all: free=["stiffness", "prestress"] (chi-squared' in steps[0]
    assert any("columns push_height and push_width" in step for step in steps)


@pytest.mark.ci
def test_mere_scatter():
    _, steps = rejected(lengths(0.004) + 8 * NOISE)
    assert len(steps) == 1
    assert '3.3 times as large; if it is a guess, take it from the scatter: sigma="relative"' in steps[0]


HEADER = "height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm"


@pytest.mark.ci
@pytest.mark.parametrize(
    ("header", "rows", "hint"),
    [
        (HEADER, "14.03,10,0.3,3,25,0.5\n36.2,10,0.3,3,50,0.5\n9,10,0.3,3,20,0.5", "are height_mm and length_mm exchanged"),
        (HEADER, "0.025,10,0.3,3,14.03,0.5\n0.05,10,0.3,3,36.2,0.5", "is height_mm in m, or is length_mm in um?"),
        (HEADER, "0.025,10,0.3,3,14.03,0.5\n0.05,10,0.3,3,36.2,0.5", "times the longest attainable, 0.0[0-9]+ mm"),
        (HEADER, "25,10,0.3,3,0.01403,0.0005\n50,10,0.3,3,0.0362,0.0005", "is height_mm in um, or is length_mm in m?"),
        (HEADER, "25,0.01,0.3,3,14.03,0.5", "correlation_length_um = 0.01 is that of no rough interface: is it in mm?"),
        (HEADER, "0.025,10,0.3,3,0.01403,0.0005", "height_mm = 0.025 is below 1 mm: is it in m?"),
        (HEADER, "25,10,0.3,3000,14.03,0.5", "young_GPa = 3000 is above diamond's: is it in MPa?"),
        (HEADER.replace("height_mm", "height_cm"), "25,10,0.3,3,14.03,0.5\n50,10,0.3,3,4,0.5", None),
        (HEADER, "25,10,0.3,3,14.03,0.5\n50,10,0.3,3,36.2,0.5", None),
        (
            "height,poisson,length,length_sigma",
            "14,0.3,25,0.5\n36,0.3,80,0.5\n9,0.3,20,0.5",
            "are height and length exchanged?",
        ),
    ],
)
def test_slips_are_named_before_the_fit(tmp_path, header, rows, hint):
    path = tmp_path / "slip.csv"
    path.write_text(f"{header}\n{rows}\n")
    said = CliRunner().invoke(command, [str(path)])
    if hint is None:
        assert "?" not in said.stderr
    else:
        named = said.stdout if "attainable" in hint else said.stderr
        assert re.search(hint, named), named
        box = unfolded(said.stdout.partition("└")[0])
        assert re.search(f"Check first: .*{re.escape(hint)}", box) or "attainable" in hint


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0.025,1e-5,0.3,3e9,0.01403,5e-4", "correlation_length_um: 1e-5: .* 0.1 nm: is correlation_length_um in m?"),
        ("25,10,0.3,3e9,14.03,0.5", "young_GPa: 3e9: .*diamond's: is young_GPa in Pa?"),
        ("0.005,10,0.3,3,14.03,0.5", "λc: is height_mm in m?"),
    ],
)
def test_slips_that_are_refused_are_named(tmp_path, row, message):
    path = tmp_path / "slip.csv"
    path.write_text(f"{HEADER}\n{row}\n")
    with pytest.raises(MeasurementError, match=message):
        sp.read_measurements(path)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("correlation_length", 1e-11, "0.1 nm"),
        ("young", 3e18, "diamond's"),
        ("young", -1.0, "must be positive"),
        ("height", -1.0, "must be positive, in m"),
        ("height", 1e-6, "must exceed 1"),
        ("poisson", 0.6, "must lie in"),
        ("areal_stiffness", 0.0, "in Pa/m"),
    ],
)
def test_a_slider_of_materials_is_checked_like_a_table(name, value, message):
    material = {"height": 0.02, "correlation_length": 1e-5, "areal_stiffness": 1e10, "poisson": 0.3, "young": 3e9}
    with pytest.raises(ValueError, match=message):
        sp.Slider.from_material(**(material | {name: value}))


@pytest.mark.parametrize(
    ("column", "name", "value", "unit"),
    [
        ("young", "young_GPa", 3e12, "MPa"),  # the next unit in which it is a likely one
        ("young", "young_GPa", 3e18, "Pa"),
        ("young", "young_MPa", 3e18, ""),
        ("young", "young", 3e12, ""),  # in Pa there is none
        ("correlation_length", "correlation_length_um", 1e-8, "mm"),
        ("correlation_length", "correlation_length_um", 1e-11, "m"),
        ("correlation_length", "correlation_length_um", 1e-6, "nm"),
        ("height", "height_mm", 2.5e-5, "m"),
        ("height", "height_mm", 5e-4, "m"),
        ("friction", "friction", 30.0, "per cent"),
        ("friction", "friction", 300.0, ""),
    ],
)
def test_units_are_guessed_by_one_rule(column, name, value, unit):
    one = COLUMNS[column]
    likely = Domain(0, 1e-8, "") if unit == "nm" else None
    assert one.likely_unit(value, name, likely) == unit


def test_a_low_sample_is_no_suspicion_unless_a_unit_makes_it_a_usual_one(tmp_path):
    low = sp.Measurements.from_si(height=[3e-4, 5e-4], correlation_length=1e-5, poisson=0.3, length=[3e-4, 4e-4])
    assert suspicions(low, []) == ()
    path = tmp_path / "low.csv"
    path.write_text("height_mm,correlation_length_um,poisson,length_mm\n0.3,10,0.3,0.3\n50,10,0.3,40\n")
    assert suspicions(sp.read_measurements(path), []) == ("height_mm = 0.3 is below 1 mm: is it in m?",)


def test_a_prior_in_the_unit_of_the_table_is_named():
    """Priors are in SI: 3 for a modulus that the table has as 3 GPa."""
    table = sp.Measurements.from_si(
        height=[0.025, 0.05], correlation_length=1e-5, poisson=0.3, length=[0.014, 0.0362], length_sigma=5e-4, young=3e9
    )
    with (
        pytest.warns(MeasurementWarning, match=r"young = 3 Pa, where young says 3e\+09 Pa: .* in Pa; is it in GPa\?"),
        pytest.raises(ValueError, match=r"^young = 3 Pa, where young says 3e\+09 Pa"),
    ):
        sp.fit(table, [Parameter("areal_stiffness"), Parameter("young", prior=(3, 0.2))])


@pytest.mark.parametrize(
    ("one", "hint"),
    [
        (Parameter("height", prior=(25, 1)), "height = 25 m, where height says 0.025 m: .*; is it in mm?"),
        (Parameter("height", prior=(2.5, 0.1)), "is it in cm?"),
        (Parameter("height", value=25e-6), "height = 2.5e-05 m"),
        (Parameter("push_height", bounds=(4, 6)), "push_height = 4 to 6 m, where push_height says 0.005 m: .*; is it in mm?"),
        (Parameter("correlation_length", prior=(10, 1)), "correlation_length = 10 m, .*; is it in um?"),
        (Parameter("young", value=3), "is it in GPa?"),
        (Parameter("height", prior=(0.03, 0.001)), None),
        (Parameter("correlation_length", value=1e-4), None),
        (Parameter("young", bounds=(1e9, 1e10)), None),
        (Parameter("poisson", value=0.4), None),
    ],
)
def test_numbers_in_another_unit_than_si_are_named(one, hint):
    table = sp.Measurements.from_si(
        height=[0.025, 0.05], correlation_length=1e-5, poisson=0.3, length=[0.014, 0.0362], young=3e9, push_height=0.005
    )
    said = suspicions(table, [Parameter("stiffness", bounds=(1e-4, 1)), one])
    assert len(said) == (hint is not None)
    assert hint is None or re.search(hint.replace("?", r"\?"), said[0])


def test_without_a_correlation_length_heights_are_in_its_units():
    table = Measurements(height=[25.0, 50.0], poisson=0.3, length=[14.0, 36.0])
    (said,) = suspicions(table, [Parameter("height", prior=(0.025, 1e-3))])
    assert said == "height = 0.025 λc, where height says 25 λc: priors, bounds and held values are in λc"


@pytest.mark.ci
def test_lengths_that_nothing_reaches_and_a_single_one():
    """Where no domino starts no length is so many times the longest; one length is no "1 of 1 lengths"."""

    def said(m, attainable):
        found = dataclasses.replace(sp.fit(m, intervals="profile"), attainable=np.array(attainable))
        return next(note for note in found.notes if "longest" in note)

    two = Measurements(height=[25.0, 50.0], poisson=0.3, length=[14.0, 36.0], length_sigma=0.5)
    note = said(two, [0.0, 0.0])
    assert note.startswith("2 lengths lie more than σ above the longest")
    assert note.endswith("the worst is measurement 0: 14 λc, where no domino starts")
    assert said(two, [1.0, 0.0]).endswith("the worst is measurement 1: 36 λc, where no domino starts")
    note = said(Measurements(25.0, 0.3, 26.2, 0.3), [26.3])
    assert note.startswith("the length lies within 3 % of the longest attainable, where it constrains stiffness little")


@pytest.mark.slow
def test_no_block_is_suggested_where_the_table_states_what_one_cannot_take():
    """Of the lengths that suggest one otherwise (`test_a_trend_in_height`)."""
    length = lengths(0.004, prestress=0.3) + NOISE
    _, steps = rejected(length, machine_stiffness=1e5)
    assert not any("push_height" in step for step in steps)


def test_a_coefficient_of_friction_may_be_in_per_cent():
    push = {"push_height": [5.0], "normal_stiffness": 1.2}
    for friction, count in ((0.6, 0), (30.0, 1)):
        m = sp.Measurements(height=[25.0], poisson=0.3, length=[14.0], length_sigma=[0.5], friction=friction, **push)
        assert sum("friction = 30 is that of no dry contact: is it in per cent?" in one for one in suspicions(m, [])) == count
