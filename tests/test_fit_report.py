"""What the report of a fit says beside the numbers: which error to publish, what a block leaves out."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.inference.budget import total_interval
from slippulse_jax.inference.verdict import LEVELS, Identifiability

EXAMPLES = Path(__file__).resolve().parent.parent / "fit_examples"
HEIGHT = np.array([250.0, 350.0, 450.0, 550.0, 650.0, 750.0])
LENGTH = np.asarray(sp.exact_lengths(sp.Slider(HEIGHT, 3e-4, 0.3)))
NOISE = np.array([0.4, -1.1, 0.8, -0.3, 1.0, -0.7])


def lengths(sigma=0.01, noise=NOISE, **columns):
    """Six lengths of one stiffness, with relative errors."""
    return sp.Measurements(HEIGHT, 0.3, LENGTH * (1 + sigma * noise), sigma * LENGTH, **columns)


# --- which error to publish ---------------------------------------------------------------------------------------------


def test_an_uneven_interval_is_the_one_to_publish():
    """Where the profile interval and ± differ by more than a fifth, and nowhere else."""
    said = {}
    for deviation in (0.05, 0.2):
        factor = sp.Parameter("model_factor", prior=(1, deviation), nuisance=True)
        result = sp.fit(lengths(0.03, 0), ["stiffness", factor], intervals="profile")
        assert result.identifiability is Identifiability.IDENTIFIED
        (piece,) = result.intervals["stiffness"][LEVELS[0]]
        value, error = result.values["stiffness"], result.stderrs["stiffness"]
        sides = np.array([value - piece.low, piece.high - value]) / error
        assert (abs(sides - 1).max() > 0.2) == (deviation == 0.2)
        said[deviation] = [note for note in result.notes if "publish the 68 % interval" in note]
    assert said[0.05] == []
    assert len(said[0.2]) == 1
    reach = rf"rather than ±: the likelihood is not parabolic.* {sides[0]:.2f} times ± below the value and {sides[1]:.2f} times"
    assert re.search(reach, said[0.2][0])


def test_a_size_of_errors_from_few_lengths_widens_the_interval():
    """By Student's t for two degrees of freedom, 1.32, which ± does not contain."""
    result = sp.fit(sp.Measurements(HEIGHT[:3], 0.3, LENGTH[:3] * (1 + 0.01 * NOISE[:3])))
    (note,) = [note for note in result.notes if "publish the 68 % interval" in note]
    assert "the size of σ is known from 2 degrees of freedom only" in note
    found = [float(x) for x in re.findall(r"([0-9.]+) times ±", note)]
    assert found == pytest.approx([1.32, 1.32], abs=0.06)


def test_total_interval_is_that_of_a_fit_with_the_error_stated():
    """A modulus known to 30 %: its error is in the budget of one fit, and in the interval of the other."""
    m = sp.read_measurements(EXAMPLES / "pmma_block/lengths.csv")
    exact, known = sp.fit(m), sp.fit(dataclasses.replace(m, specimen=(), young_sigma=0.3 * m.young))
    (stated,) = known.intervals["areal_stiffness"][LEVELS[0]]
    found = total_interval(exact, "areal_stiffness", {"young": exact.budget["young"]._replace(error=0.3)})
    assert found[:2] == pytest.approx(stated[:2], rel=0.01)
    assert found.high - exact.values["areal_stiffness"] > 1.3 * (exact.values["areal_stiffness"] - found.low)


def test_the_total_of_a_block_is_an_interval_too():
    """As high as by two fits with the push moved: the report has the interval where it is not that of ±."""
    result = sp.fit(EXAMPLES / "pushed_block/lengths.csv")
    value, by = result.values["areal_stiffness"], result.budget
    low, high, *_ = total_interval(result, "areal_stiffness", by)
    others = np.linalg.norm([one.by("areal_stiffness") for name, one in by.items() if name != "push_height"])
    for end, factor, mine in ((low, 1.05, 0), (high, 0.95, 1)):
        m = result.measurements
        moved = sp.fit(dataclasses.replace(m, push_height=factor * m.push_height)).values["areal_stiffness"]
        own = result.intervals["areal_stiffness"][LEVELS[0]][0][mine]
        side = np.hypot(np.hypot(np.log(moved / value), others), np.log(own / value))
        assert abs(np.log(end / value)) == pytest.approx(side, rel=0.05)
    assert "with these, k/λc² = (9.2 ± 2.2)e10 Pa/m, 68 % interval (7.3 to 11.7)e10 Pa/m" in result.report()
    even = sp.fit(EXAMPLES / "pmma_block/lengths.csv").report()
    assert re.search(r"with these, k/λc² = \(1.96 ± 0.17\)e10 Pa/m\n", even)


# --- blocks -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("held", [None, 1.0, 1.1])
def test_no_ratio_to_a_block_beside_a_factor_of_all_lengths(held):
    """A fit of a block would find another factor; held at one, it has nothing to take up."""
    fixed = None if held is None else {"offset": 0, "model_factor": held}
    result = sp.fit(lengths(provenance=("measured",) * 6), fixed=fixed)
    report = result.report()
    assert bool(result.unstated_push) == ("times this" in report) == (held == 1.0)
    assert "A column push_height (and push_width) has it fitted as a block" in report
    assert ("no ratio to this is given" in report) == ("(--body block)" in report) == (held != 1.0)


def test_the_report_of_a_block_says_what_it_takes_for_granted():
    m = sp.read_measurements(EXAMPLES / "pushed_block/lengths.csv")
    said = sp.fit(m).report()
    assert "Not stated, and not in any error above\n  a block that ends, and a machine that gives way, lengthen fronts" in said
    assert "without push_width_mm the pusher covers all of the side above push_height_mm" in said
    assert "without push_control the displacement of the pusher is held" in said
    stated = dataclasses.replace(m, push_width=0.2 * m.height, push_control=("displacement",) * 6)
    said = sp.fit(stated).report()
    assert "without push" not in said
    assert "without push" not in sp.fit(m, body="slider", sigma="relative").report()
    assert "model factor of 1 ± 0.1, which alone would add" in sp.fit(dataclasses.replace(m, provenance=())).report()


def test_fronts_are_longer_or_shorter_as_the_report_says():
    pushes = sp.Push(0.25), sp.Push(0.25, control="force"), sp.Push(0.4, 0.3)
    above, force, part = (float(sp.precursor_length(sp.Block(40.0, 1 / (2.6 * 40), 0.3, one), sites=256)) for one in pushes)
    ended = float(sp.precursor_length(sp.Block(40.0, 1 / (2.6 * 40), 0.3, sp.Push(0.25), length=120)))
    assert part < 0.97 * above
    assert force > 1.2 * above
    assert ended > 1.1 * above
