"""What the report of a fit says beside the numbers: which error to publish, what specimens share, what a block leaves out."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from reports import moves, section, unfolded
from scipy.optimize import minimize

import slippulse_jax as sp
from slippulse_jax.base.shown import value_with_error
from slippulse_jax.cli.fit import command
from slippulse_jax.inference.model.family import Families
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.result.changes import PUSHES, Change, of_inputs, total_intervals, total_of_ratio
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.intervals import LEVELS, Interval

EXAMPLES = Path(__file__).resolve().parents[2] / "fit_examples"
HEIGHT = np.array([250.0, 350.0, 450.0, 550.0, 650.0, 750.0])
LENGTH = np.asarray(sp.exact_lengths(sp.Slider(HEIGHT, 3e-4, 0.3)))
NOISE = np.array([0.4, -1.1, 0.8, -0.3, 1.0, -0.7])


def lengths(sigma=0.01, noise=NOISE, **columns):
    """Six lengths of one stiffness, with relative errors."""
    return sp.Measurements(HEIGHT, 0.3, LENGTH * (1 + sigma * noise), sigma * LENGTH, **columns)


def two_specimens(scale=(1.0, 1.0), **columns):
    """Three heights of each of two specimens with the same stated modulus; the true ones are `scale` times as large."""
    height = np.array([25.0, 45.0, 65.0] * 2)
    young = 3.0 * np.repeat(scale, 3)
    slider = sp.Slider.from_material(
        height=height / 1e3, correlation_length=1e-4, areal_stiffness=2e10, poisson=0.3, young=young * 1e9
    )
    length = 0.1 * np.asarray(sp.exact_lengths(slider))
    table = {"specimen": list("AAABBB"), "height_mm": height, "correlation_length_um": 100.0, "poisson": 0.3, "young_GPa": 3.0}
    table |= {"young_sigma_GPa": 0.2, "length_mm": length + 0.3 * NOISE, "length_sigma_mm": 0.3}
    return pd.DataFrame(table | columns)


# --- which error to publish ---------------------------------------------------------------------------------------------


@pytest.mark.ci
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
        said[deviation] = [note for note in result.notes if "quote the 68 % interval" in note]
    assert said[0.05] == []
    assert len(said[0.2]) == 1
    reach = rf"reaches {sides[0]:.2f} standard errors below the value and {sides[1]:.2f} above; the likelihood is not parabolic"
    assert re.search(reach, said[0.2][0])


def test_a_size_of_errors_from_few_lengths_widens_the_interval():
    """By Student's t for two degrees of freedom, 1.32, which ± does not contain."""
    result = sp.fit(sp.Measurements(HEIGHT[:3], 0.3, LENGTH[:3] * (1 + 0.01 * NOISE[:3])))
    (note,) = [note for note in result.notes if "quote the 68 % interval" in note]
    assert "the size of σ is known from 2 degrees of freedom only" in note
    found = [float(x) for x in re.findall(r"([0-9.]+)(?: standard errors below| above)", note)]
    assert found == pytest.approx([1.32, 1.32], abs=0.06)


@pytest.mark.ci
@pytest.mark.parametrize("level", LEVELS)
def test_total_interval_is_that_of_a_fit_with_the_error_stated(level):
    """A modulus known to 30 %: its error is in the budget of one fit, and in the intervals of the other."""
    m = sp.read_measurements(EXAMPLES / "pmma_block/lengths.csv")
    exact, known = sp.fit(m), sp.fit(dataclasses.replace(m, specimen=(), young_sigma=0.3 * m.young))
    (stated,) = known.intervals["areal_stiffness"][level]
    moved = Change("young", "E larger by a third", {"areal_stiffness": (0.3,)}, {"areal_stiffness": -0.3})
    (found,) = total_intervals(exact, "areal_stiffness", [moved])[level]
    assert found[:2] == pytest.approx(stated[:2], rel=0.01)
    assert found.high - exact.values["areal_stiffness"] > 1.3 * (exact.values["areal_stiffness"] - found.low)


@pytest.mark.ci
@pytest.mark.parametrize("known", [False, True])
def test_errors_to_publish_have_two_sides_wherever_there_is_a_value(known):
    """As the box prints them, also beside inputs that all have errors of their own."""
    errors = {"height_sigma": 0.2, "poisson_sigma": 0.01, "provenance": ("measured",) * 3} if known else {}
    m = sp.Measurements([20.0, 30.0, 50.0], 0.3, [11.6, 19.0, 35.1], 0.5, **errors)
    result = sp.fit(m, intervals="profile", fixed={"threshold_scatter": 0})
    below, above = result.errors_with_inputs["stiffness"]
    (piece,) = result.intervals["stiffness"][LEVELS[0]]
    value = result.values["stiffness"]
    assert below >= 0.999 * (value - piece.low)
    assert above >= 0.999 * (piece.high - value)
    assert (len(of_inputs(result.changes)) == 0) == known
    assert 0.5 * (below + above) == pytest.approx(result.stderrs_with_inputs["stiffness"], rel=0.1)
    beyond = sp.fit(
        dataclasses.replace(m, length=[23.0, 34.5, 57.5]), fixed={"threshold_scatter": 0}
    )  # any length, where a model factor is fitted
    assert (beyond.errors_with_inputs["stiffness"] is None) == (not known)


@pytest.mark.slow
def test_the_total_of_a_block_is_an_interval_too(worked):
    """As high as by two fits with the push moved: the report has the interval where it is not that of ±."""
    result = worked("pushed_block")
    value, by = result.values["areal_stiffness"], result.changes
    ((low, high, *_),) = total_intervals(result, "areal_stiffness", by)[LEVELS[0]]
    others = np.linalg.norm([one.by("areal_stiffness") for one in of_inputs(by) if one.name != "push_height"])
    for end, factor, mine in ((low, 1.05, 0), (high, 0.95, 1)):
        m = result.measurements
        moved = sp.fit(dataclasses.replace(m, push_height=factor * m.push_height)).values["areal_stiffness"]
        own = result.intervals["areal_stiffness"][LEVELS[0]][0][mine]
        side = np.hypot(np.hypot(np.log(moved / value), others), np.log(own / value))
        assert abs(np.log(end / value)) == pytest.approx(side, rel=0.05)
    sides = re.search(r"k/λc² \(Pa/m\)  \((\S+) -(\S+) \+(\S+)\)e10 ", result.report()).groups()
    assert [float(x) * 1e10 for x in sides] == pytest.approx([value, value - low, high - value], abs=0.06e10)
    even = worked("pmma_block").report()
    assert re.search(r"k/λc² \(Pa/m\)  \(1.96 ± 0.17\)e10 ", even)


def test_half_widths_and_errors_of_inputs_add_in_quadrature_side_by_side():
    """In ln k, about the root in each piece; an open side stays open, and pieces that meet are one."""
    exact = sp.fit(lengths())
    best = exact.values["stiffness"]
    moves = [Change("young", "", {"stiffness": (0.2,)}, {"stiffness": -0.1})]
    moves.append(Change("height", "", {"stiffness": (0.05,)}, {"stiffness": -0.05}))
    below, above = np.hypot(0.1, 0.05), np.hypot(0.2, 0.05)

    def wider(pieces, level=0.95, moved=moves):
        found = dataclasses.replace(exact, intervals={"stiffness": {level: [Interval(*one) for one in pieces]}})
        return total_intervals(found, "stiffness", moved).get(level)

    size = {0.68: 0.9944579, 0.95: 1.959964}  # of the normal distribution, from its table
    for level, z in size.items():
        (piece,) = wider([(0.9 * best, 1.2 * best, False, False)], level)
        assert np.log(best / piece.low) == pytest.approx(np.hypot(np.log(1 / 0.9), z * below), rel=1e-5)
        assert np.log(piece.high / best) == pytest.approx(np.hypot(np.log(1.2), z * above), rel=1e-5)
    (piece,) = wider([(0.9 * best, 30 * best, False, True)])
    assert (piece.open_low, piece.open_high, piece.high) == (False, True, 30 * best)
    assert piece.low == pytest.approx(best * np.exp(-np.hypot(np.log(0.9), size[0.95] * below)), rel=1e-5)
    far = [(0.9 * best, 1.1 * best, False, False), (20 * best, 30 * best, False, False)]
    assert [one.low < wide.low for one, wide in zip(wider(far), (Interval(*one) for one in far), strict=True)] == [True, True]
    (met,) = wider([(0.9 * best, 1.1 * best, False, False), (1.2 * best, 30 * best, False, True)])
    assert met.low < 0.9 * best
    assert met.open_high
    assert wider(far, moved=[Change("young", "", {"stiffness": (float("nan"),)}, {"stiffness": float("nan")})]) is None


def test_the_box_names_both_intervals_wherever_they_are_shown(worked):
    """In the box, the sentences, the table of a notebook, the dict and the figure: total, and of the lengths only."""
    result = worked("pmma_block")
    (own,), (total,) = (found["areal_stiffness"][0.95] for found in (result.intervals, result.intervals_with_inputs))
    assert total.low < own.low < own.high < total.high
    shown = [f"({piece.low / 1e10:.{digits}f} to {piece.high / 1e10:.{digits}f})" for piece, digits in ((total, 2), (own, 3))]
    head, row = (line.split("  ") for line in result.report().splitlines()[1:3])
    assert [cell.strip() for cell in head if "95 %" in cell] == ["95 %, total", "95 %, these only"]
    assert [cell.strip() for cell in row if " to " in cell] == [f"{text}e10" for text in shown]
    said = result.methods()
    where = [said.index(f"95 % interval is k/λc² = {text} × 10¹⁰ Pa/m") for text in shown]
    assert where[0] < said.index("From the lengths only") < where[1]
    assert all(f"{text}e10" in result._repr_html_() for text in shown)
    assert "95% interval, total" in result._repr_html_()
    written = result.to_dict()["intervals_with_inputs"]["areal_stiffness"]
    assert [total.low, total.high] == pytest.approx(
        [*dict(written)["0.95" if "0.95" in dict(written) else 0.95][0].values()][:2]
    )
    ax = sp.plot.length_versus_stiffness(result)
    bands = {patch.get_label(): patch.get_extents().transformed(ax.transData.inverted()) for patch in ax.patches}
    for label, piece in (("95%, total", total), ("95%, lengths only", own)):
        assert [bands[label].x0, bands[label].x1] == pytest.approx([piece.low, piece.high])
    bare = sp.fit(two_specimens(young_sigma_GPa=0.2, height_sigma_mm=0.2, correlation_length_sigma_um=5.0, poisson_sigma=0.01))
    assert "95 % interval" in bare.report() or any(of_inputs(bare.changes))


# --- specimens ----------------------------------------------------------------------------------------------------------


@pytest.mark.ci
@pytest.mark.parametrize("shared", [True, False])
def test_ratio_of_two_stiffnesses_is_that_of_its_profile(shared, tmp_path):
    """The deviance minimised with the ratio held, by SciPy: it rises by one at a standard error. Shared errors cancel."""
    table = two_specimens(young_sigma_GPa=None).drop(columns="young_sigma_GPa") if shared else two_specimens()
    free = [sp.Parameter("stiffness", each="specimen")] + [sp.Parameter("young", prior=(3e9, 2e8))] * shared
    result = sp.fit(table, free, intervals="profile")
    ((labels, (ratio, error)),) = result.stiffness_ratios.items()
    assert labels == ("areal_stiffness[B]", "areal_stiffness[A]")
    assert ratio == pytest.approx(result.values[labels[0]] / result.values[labels[1]], rel=1e-12)
    i, j = (result.parameters.index(name) for name in labels)
    rest = [k for k in range(result.problem.p) if k != i]

    def deviance(log_ratio):
        def of_others(x):
            theta = np.empty(result.problem.p)
            theta[rest] = x
            theta[i] = theta[j] + log_ratio
            return 2 * float(result.problem(theta[None]).value[0])

        return minimize(of_others, result.theta[rest], method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-8}).fun

    rises = [deviance(np.log(ratio) + side * error / ratio) - result.deviance for side in (-1, 1)]
    assert np.mean(rises) == pytest.approx(1, abs=0.03)
    alone = [result.stderrs[name] / result.values[name] for name in labels]
    assert (error / ratio < 0.6 * np.hypot(*alone)) == shared
    assert re.search(rf"│ B over A .*  {re.escape(value_with_error(ratio, error))}  ", result.report())
    result.save(tmp_path / "fit.json")
    assert sp.load_fit(tmp_path / "fit.json").stiffness_ratios == result.stiffness_ratios
    assert result.to_dict()["stiffness_ratios"] == [[*labels, ratio, error]]


def test_of_many_specimens_ratios_to_the_first_are_shown():
    m = lengths(specimen=tuple("ABCDEF"))
    result = sp.fit(m, sp.Parameter("stiffness", bounds=(1e-5, 2e-3), each="specimen"))
    assert len(result.stiffness_ratios) == 15
    assert re.findall(r"│ (\w) over (\w) ", result.report()) == [(one, "A") for one in "BCDEF"]
    few = sp.fit(
        dataclasses.replace(m, specimen=tuple("AABBCC")), sp.Parameter("stiffness", bounds=(1e-5, 2e-3), each="specimen")
    )
    assert re.findall(r"│ (\w) over (\w) ", few.report()) == [("B", "A"), ("C", "A"), ("C", "B")]
    assert sp.fit(m).stiffness_ratios == {}


@pytest.mark.ci
def test_an_error_that_specimens_may_share_is_named_with_its_option(tmp_path):
    """Done as it says, the error of the stiffness is larger: an error that all share does not average out."""
    apart = sp.fit(two_specimens())
    (step,) = apart.next_steps
    assert "\n  - Each specimen has its own error of E. If one source gives E of all, they share that error. " in apart.report()
    assert "leave young_sigma_GPa out, and give free=[" in step
    path = tmp_path / "together.csv"
    two_specimens().to_csv(path, index=False)
    (said,) = sp.fit(path).next_steps
    assert "leave young_sigma_GPa out, and give --prior young=3e+09,2e+08, in Python free=[" in said
    two_specimens().drop(columns="young_sigma_GPa").to_csv(path, index=False)
    options = re.findall(r"--prior [^, ]+,[^, ]+", said)[0].split()
    assert CliRunner().invoke(command, [str(path), *options, "--json"]).exit_code == 0
    together = sp.fit(path, **eval(f"dict({step.partition('and give ')[2]})", {"sp": sp}))
    assert together.next_steps == []
    assert together.stderrs["areal_stiffness"] > 1.2 * apart.stderrs["areal_stiffness"]
    own = two_specimens(young_sigma_GPa=[0.2, 0.2, 0.2, 0.3, 0.3, 0.3])
    assert sp.fit(own).next_steps == []
    assert sp.fit(two_specimens(specimen="A")).next_steps == []


@pytest.mark.parametrize("wrong", [False, True])
def test_inputs_that_are_pulled_far_are_remarked_on(wrong):
    """Of two specimens whose moduli are as stated, or one 15 % softer and one 15 % stiffer than that."""
    result = sp.fit(two_specimens(scale=(0.85, 1.15) if wrong else (1.0, 1.0)))
    assert result.identifiability is Identifiability.IDENTIFIED
    notes = [note for note in result.notes if "more than chance would" in note]
    assert len(notes) == wrong
    if wrong:
        assert re.search(r"E \(A\) [1-3]\.\d\d σ below and E \(B\) [1-3]\.\d\d σ above what was stated", notes[0])
        assert "check the stated value and its error; or the specimens may differ in stiffness" in notes[0]
        assert '(free=[sp.Parameter("stiffness", each="specimen")])' in notes[0]


@pytest.mark.slow
def test_pulls_scatter_as_the_remark_supposes():
    """Of studies with moduli drawn by their stated error, a remark on one in twenty."""
    rng = np.random.default_rng(8)
    seen = 0
    for _ in range(40):
        table = two_specimens(scale=1 + 0.2 / 3 * rng.standard_normal(2))
        table["length_mm"] += 0.3 * (rng.standard_normal(6) - NOISE)
        seen += any("more than chance" in note for note in sp.fit(table, intervals="profile").notes)
    assert seen <= 6  # more than that have a probability of 0.3 %


@pytest.mark.ci
def test_a_pulled_model_factor_is_remarked_on():
    """Lengths that grow with the height less than those of any slider do."""
    m = lengths(provenance=("measured",) * 6)
    bent = dataclasses.replace(m, length=m.length * (HEIGHT / 450) ** -0.07)
    assert not any("more than chance" in note for note in sp.fit(m, fixed={"threshold_scatter": 0}).notes)
    (note,) = [note for note in sp.fit(bent, fixed={"threshold_scatter": 0}).notes if "more than chance" in note]
    assert re.search(r"model factor 2\.\d\d σ below.*the lengths do not vary with the height as the model's do", note)
    assert "check what is stated" not in note


# --- blocks -------------------------------------------------------------------------------------------------------------


@pytest.mark.ci
@pytest.mark.parametrize("held", [None, 1.0, 1.1])
def test_the_ratio_to_a_block_beside_a_factor_of_all_lengths(held):
    """Fitted, or held at any value, the factor is that of the fit of the block too."""
    fixed = {"threshold_scatter": 0} | ({} if held is None else {"offset": 0, "model_factor": held})
    result = sp.fit(lengths(provenance=("measured",) * 6), fixed=fixed)
    report = result.report()
    rows = [line for line in section(report, "What else") if "a real block" in line]
    assert ["(column push_height fits one)" in row for row in rows] == [True, *[False] * (len(rows) - 1)]
    found = dict(zip(PUSHES, {one.name: one for one in result.changes}["block"].moves["stiffness"], strict=True))
    shown = {}
    for row in rows:
        for push in re.search(r"pushed above (.*) H ", row).group(1).replace(" or ", ", ").split(", "):
            shown[float(push)] = row.endswith("  none fits")
    assert shown == {push: bool(np.isnan(by)) for push, by in found.items()}
    finite = np.isfinite([*found.values()])
    assert ("A real block would need " in unfolded(report)) == finite.any()
    assert ("Pushed low on its side, no stiffness fits these lengths." in unfolded(report)) == (finite.any() and not finite[-1])


@pytest.mark.ci
def test_the_report_of_a_block_says_what_it_takes_for_granted():
    m = sp.read_measurements(EXAMPLES / "pushed_block/lengths.csv")
    said = sp.fit(m).report()
    assert "Not included: block end, compliant machine, force control" in said
    guess = "Guessed: the pusher covers the whole side above push_height_mm, as no push_width_mm is stated. If it is 0.1 H high"
    assert guess in unfolded(said)
    stated = dataclasses.replace(m, push_width=0.2 * m.height, push_control=("displacement",) * 6)
    said = sp.fit(stated, intervals="profile").report()
    assert "Guessed" not in said
    assert "force control" not in said
    assert "Guessed" not in sp.fit(m, body="slider", sigma="relative").report()
    assert "a model factor of 1.1, if the lengths were measured" in sp.fit(dataclasses.replace(m, provenance=())).report()


@pytest.mark.ci
def test_fronts_are_longer_or_shorter_as_the_report_says():
    pushes = sp.Push(0.25), sp.Push(0.25, control="force"), sp.Push(0.4, 0.3)
    above, force, part = (float(sp.precursor_length(sp.Block(40.0, 1 / (2.6 * 40), 0.3, one), sites=256)) for one in pushes)
    ended = float(sp.precursor_length(sp.Block(40.0, 1 / (2.6 * 40), 0.3, sp.Push(0.25), length=120)))
    assert part < 0.97 * above
    assert force > 1.2 * above
    assert ended > 1.1 * above


# --- several specimens ----------------------------------------------------------------------------------------------------


EACH = sp.Parameter("stiffness", each="specimen")


@pytest.mark.ci
def test_the_total_of_a_ratio_has_what_specimens_do_not_share():
    """Heights are measured of each specimen; Poisson's ratio is one. By refits with the inputs moved by their usual errors."""
    specimen, noise = np.array(["A"] * 3 + ["B"] * 3), 0.01 * NOISE

    def found(height=(1.0, 1.0), length=1.0, poisson=0.3):
        slider = HEIGHT * np.where(specimen == "A", *height)
        m = sp.Measurements(slider, poisson, length * measured, 0.01 * LENGTH, specimen=specimen.tolist())
        return sp.fit(m, EACH)

    stiffness = np.where(specimen == "A", 2e-4, 4e-4)
    measured = np.asarray(sp.exact_lengths(sp.Slider(HEIGHT, stiffness, 0.3))) * (1 + noise)
    result = found()
    (labels,) = result.stiffness_ratios
    ratio, error = result.stiffness_ratios[labels]
    moved = [
        np.log(one.stiffness_ratios[labels][0] / ratio)
        for one in (found((1.01, 1.0)), found((1.0, 1.01)), found(length=1.01), found(poisson=0.32))
    ]
    whole = total_of_ratio(result, labels, result.changes)
    assert whole == pytest.approx(ratio * np.hypot(error / ratio, np.linalg.norm(moved)), rel=0.02)
    assert re.search(rf"│ B over A +{re.escape(value_with_error(ratio, whole))}  ", result.report())


@pytest.mark.ci
def test_one_specimen_that_is_not_determined_leaves_the_error_of_the_other():
    """Three lengths of A, one count of whole contacts of B: each as it is alone."""
    m = sp.Measurements(
        height=[40, 60, 80, 30],
        poisson=0.3,
        length=[15.0, 25.0, 36.0, 14.0],
        length_sigma=[0.5, 0.5, 0.5, 0.0],
        kind=["length"] * 3 + ["whole"],
        specimen=list("AAAB"),
    )
    result = sp.fit(m, EACH)
    alone = sp.fit(sp.Measurements([40, 60, 80], 0.3, [15.0, 25.0, 36.0], 0.5))
    assert result.stderrs["stiffness[A]"] == pytest.approx(alone.stderrs["stiffness"], rel=1e-3)
    assert result.stderrs["stiffness[B]"] is None
    assert result.verdicts["stiffness[B]"].identifiability is Identifiability.EQUAL
    assert result.stiffness_ratios["stiffness[B]", "stiffness[A]"][1] is None
    assert re.search(r"│ k/K\[B\] .*any in the interval", result.report())
    assert re.search(r"k/K\[A\]: identified\.", unfolded(result.report()), flags=re.IGNORECASE)
    either = sp.fit(dataclasses.replace(m, length=[15.0, 25.0, 36.0, 20.0]), EACH).verdicts["stiffness[B]"]
    assert either.identifiability is Identifiability.SEVERAL_ROOTS
    ends = np.array([float(x) for x in re.findall(r"[0-9.]+(?:e-[0-9]+)?", either.reason)])
    assert np.asarray(sp.exact_lengths(sp.Slider(30.0, ends, 0.3))) == pytest.approx([19, 20, 20, 19], abs=0.05)


@pytest.mark.ci
def test_where_the_scatter_is_larger_than_sigma_one_stiffness_for_each_is_tried():
    """A fit that is not rejected, of two specimens that differ by a little more than chance."""
    table = two_specimens(length_sigma_mm=0.3).drop(columns="young_sigma_GPa")
    table.loc[table.specimen == "B", "length_mm"] *= 1.022
    result = sp.fit(table)
    assert result.identifiability is Identifiability.IDENTIFIED
    assert 1e-3 < result.p_value < 0.05
    (step,) = [step for step in result.next_steps if "one stiffness for each" in step]
    assert 'free=[sp.Parameter("stiffness", each="specimen")]' in step
    assert not any("one stiffness" in step for step in sp.fit(two_specimens()).next_steps)


@pytest.mark.ci
def test_what_to_try_next_keeps_the_priors_of_the_fit():
    prior = sp.Parameter("model_factor", prior=(1, 0.05))
    result = sp.fit(two_specimens(), [EACH, prior])
    (step,) = [step for step in result.next_steps if "share" in step]
    kept = 'free=[sp.Parameter("stiffness", each="specimen"), sp.Parameter("model_factor", prior=(1, 0.05)), '
    assert kept + 'sp.Parameter("young", prior=(3e+09, 2e+08))]' in step


# --- how intervals were found -------------------------------------------------------------------------------------------


@pytest.mark.ci
def test_intervals_by_simulation_are_called_so(tmp_path):
    """By default too, where valleys compete; and not those of counts, which no simulation has."""
    near = sp.Measurements(30.0, 0.3, [27.0, 29.0, 30.0], 1.2)
    by_default, asked = sp.fit(near), sp.fit(near, intervals="calibrated")
    assert by_default.intervals == asked.intervals
    for result in (by_default, asked):
        assert result.calibrated
        assert "95 %, these only (simulated)" in result.report()
    drawn = [line for line in sp.plot.profile(by_default, "stiffness").lines if line.get_label() == "interval, simulated"]
    pieces = [piece for every in by_default.intervals["stiffness"].values() for piece in every]
    assert [tuple(line.get_xdata()) for line in drawn] == [piece[:2] for piece in pieces]
    by_default.save(tmp_path / "fit.json")
    assert sp.load_fit(tmp_path / "fit.json").calibrated
    plain = sp.fit(lengths(), intervals="profile")
    assert not plain.calibrated
    assert "(simulated)" not in plain.report(verbose=True)


@pytest.mark.ci
def test_a_block_without_the_like_of_a_slider_has_a_report(monkeypatch):
    """Where no fit of a slider is found to the lengths of a block, the report says so instead of failing."""
    result = sp.fit(EXAMPLES / "pushed_block/lengths.csv")

    monkeypatch.setattr("slippulse_jax.inference.search.likelihood.Problem.accepts", lambda *_: False)
    assert np.isnan(moves(result)["slider"]["areal_stiffness"])
    assert re.search(r"\n  the paper's slider +none fits\n", result.report())


@pytest.mark.ci
def test_of_many_roots_the_best_are_listed():
    """Each of three specimens has a root on either side of the peak of its length: eight points that fit."""
    m = sp.Measurements([10, 16, 25], 0.3, [8.64, 15.75, 24.82], 0.4, specimen=["a", "b", "c"])
    result = sp.fit(m, sp.Parameter("stiffness", each="specimen"), intervals="profile")
    assert len(result.roots) == 8
    _, heads, *listed, more, keep, whole = section(result.report(), "Points that fit")
    assert heads.split() == ["k/K[a]", "k/K[b]", "k/K[c]", "chi-squared"]
    assert len(listed) == 4
    assert more == "  … and 4 more (FitResult.roots)"
    assert keep == "  To keep one, with its errors: bounds=(low, high)"
    assert whole == '  If whole events were measured, give event="full".'


# --- what the report uses is what it shows ----------------------------------------------------------------------------------


TABLES = sorted(path.parent.name for path in EXAMPLES.glob("*/lengths.csv"))


@pytest.mark.ci
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name == "pressed_block" else ()) for name in TABLES]
)
def test_the_deviance_is_that_of_the_residuals_shown(name, worked):
    """And a report has room on a page: its box is no wider than its widest sentence allows, or a row of a table."""
    result = worked(name)
    if result.problem.plain:
        assert result.problem.emulates == (name == "sequence")
        parts = []
        for one, data in zip(result.data, result.problem.observed, strict=True):
            open_ = result.problem.covariance(result.theta, data)  # of forces of a sequence, which err together
            off, heavy = one.residuals * one.sigma, data.more.get("spans", np.zeros(len(data.rows), bool))
            last = np.argsort(heavy, kind="stable")  # of a force that spans, given the others, Student's with 4 degrees
            white = np.linalg.solve(np.linalg.cholesky((open_ + np.diag(data.sigma**2))[np.ix_(last, last)]), off[last]) ** 2
            parts.append(np.where(heavy[last], 5 * np.log1p(white / 4), white).sum())
        for one, t in zip(result.parameters.free, result.theta, strict=True):
            parts.append(((t - one.prior_mean) / one.prior_sigma) ** 2 if np.isfinite(one.prior_sigma) else 0.0)
        assert result.misfit == pytest.approx(sum(parts), rel=1e-9, abs=1e-12)
    report = result.report()
    box = [line for line in report.splitlines() if line.startswith(("┌", "│", "└"))]
    values = 1 + len(result.names) + len(result.stiffness_ratios)
    assert ("Neighbours err together" in unfolded(report)) == (name == "sequence")
    assert max(map(len, box)) <= max(114, *(len(line.rstrip("│ ")) + 2 for line in box[1 : 1 + values]))
    if name == "pmma_block":
        assert len(report.splitlines()) <= 36


@pytest.mark.ci
def test_sigma_is_shown_with_what_is_added_to_it():
    """Whole events are interpolated, which counts beside small errors; the error shown is the one that was used."""
    height = np.array([15.0, 20.0, 25.0, 30.0, 40.0])
    length = sp.precursor_lengths(sp.Slider(height, 0.15, 0.3), event="full")
    result = sp.fit(sp.Measurements(height, 0.3, length, 0.02), event="full", intervals="profile")
    assert result.between_contacts is not None
    np.testing.assert_allclose(result.sigma, np.hypot(0.02, result.between_contacts), rtol=1e-12)
    np.testing.assert_allclose(result.residuals, (result.fitted - length) / result.sigma, rtol=1e-6, atol=1e-9)
    said = result.report()
    shown = [float(x) for x in re.findall(r"\n .* ± (\S+) +\S+ +[+-]\d\.\d\d", said)]
    assert shown == pytest.approx(result.sigma.tolist(), rel=0.06)
    assert "σ as given" not in unfolded(said)
    assert "This is added to σ in quadrature" in said


@pytest.mark.ci
@pytest.mark.parametrize("verbose", [False, True])
def test_counts_have_no_best_value_and_no_sigma(verbose, worked):
    result = worked("counts_and_run_throughs")
    assert result.identifiability is Identifiability.EQUAL
    report = unfolded(result.report(verbose=verbose))
    assert "k/K any in the interval" in report
    assert "σ as given" not in report
    assert "highest likelihood" not in report
    value = value_with_error(result.values["stiffness"], None)
    assert f"k/K = {value}" not in report
    assert f"k/K {value}" not in report


@pytest.mark.slow
def test_a_guessed_width_of_the_pusher_is_named_with_what_it_does():
    """Lengths of a pusher 0.1 H high, fitted as if it covered all above: the factor leads from one stiffness to the other."""
    push, k = np.arange(0.25, 0.56, 0.05), 8e-3
    inputs = Inputs.of(np.full(len(push), 200.0), k, 0.3)
    inputs = inputs.given(
        log_push=np.log(push), log_push_width=np.full(len(push), np.log(0.1)), push_force=np.zeros(len(push), bool)
    )
    length, _ = Families()(inputs)
    assert np.isfinite(length).all()
    m = sp.Measurements(200.0, 0.3, length, 0.08 * length, push_height=200 * push)
    unstated = sp.fit(m, intervals="profile")
    factor = np.exp(moves(unstated)["push_width"]["stiffness"])
    assert factor * unstated.values["stiffness"] == pytest.approx(k, rel=0.25)
    guess = "Guessed: the pusher covers the whole side above push_height, as no push_width is stated. If it is 0.1 H high, "
    assert f"{guess}the stiffness is about {factor:.2g} times as large." in unfolded(unstated.report())
    stated = sp.fit(dataclasses.replace(m, push_width=20.0), intervals="profile")
    assert stated.values["stiffness"] == pytest.approx(k, rel=0.05)
    assert "push_width" not in moves(stated)
    assert "Guessed" not in stated.report()


# --- what the box says ----------------------------------------------------------------------------------------------------


def test_effects_are_in_the_order_of_what_is_printed():
    """A stiffness near the longest length, which every input moves by some 10 %, up or down."""
    height = np.array([25.0, 22.0, 20.0])
    found = sp.fit(sp.Measurements(height, 0.3, [25.5, 22.4, 20.1], 0.15, provenance=("synthetic",) * 3), intervals="profile")
    cells = [re.split(r" {2,}", row)[-1] for row in section(found.report(), "What else would move it")[1:]]
    percent = [abs(float(cell[:-2])) for cell in cells if cell.endswith("%")]
    assert len(percent) >= 4
    assert percent == sorted(percent, reverse=True)
    assert not any(cell.endswith("%") for cell in cells[: len(cells) - len(percent)])


@pytest.mark.ci
def test_what_the_errors_come_from_is_said():
    """Of the lengths alone; of stated errors; of an offset and a model factor; of readings; of priors."""
    stated = sp.fit(two_specimens())
    measured = sp.fit(lengths(provenance=("measured",) * 6), fixed={"threshold_scatter": 0})
    known = sp.fit(lengths(), ["stiffness", sp.Parameter("poisson", prior=(0.3, 0.02))])
    alone = sp.fit(lengths())
    for result, said in (
        (alone, "from the lengths only"),
        (stated, "from lengths and stated errors only"),
        (measured, "from lengths and shared errors only"),
        (known, "from lengths and priors only"),
    ):
        assert f"  {said}  " in result.report()
        assert f". F{said[1:]}, k/{'λc²' if result is stated else 'K'} = " in result.methods()
    assert "Also fitted, within their errors: offset = 0.0 ± 2.8 λc and model factor = 1.00 ± 0.10." in measured.methods()
    assert "The error of the model" not in measured.methods()
    assert "The error of the model is not included." in alone.methods()


@pytest.mark.ci
@pytest.mark.parametrize("made", ["stated", "measured"])
def test_the_deviance_is_that_of_residuals_and_inputs(made):
    """Where inputs are fitted within their errors χ² is more than the residuals squared: the report says how much more."""
    shorter = sp.Measurements(HEIGHT, 0.3, LENGTH * (HEIGHT / 500) ** 0.1, 0.01 * LENGTH, provenance=("measured",) * 6)
    result = sp.fit(two_specimens((1.05, 0.9)) if made == "stated" else shorter, fixed={"threshold_scatter": 0})
    inputs = result.deviance - (result.residuals**2).sum()
    assert inputs > 0.05
    text = unfolded(result.report())
    assert re.search(rf"Chi-squared is {result.deviance:.3g} for .* The fitted [^.]+ adds? {inputs:.3g} of it\.", text)
    assert result.to_dict()["residuals"] == pytest.approx(result.residuals.tolist())


def test_one_of_two_values_that_fit_equally():
    """Neither is the best; and methods give the interval."""
    result = sp.fit(sp.Measurements(25.0, 0.3, [25.5], 0.15))
    own = r"0\.02\d+ to 0\.03\d+ or 0\.06\d+ to 0\.08"
    assert re.search(rf"│ k/K  0\.01\d+ to 0\.0\d+ or 0\.05\d+ to 0\.1\d+  0\.0\d+ \(one of 2\)  +{own}", result.report())
    assert "(one of 2)" in result.report(verbose=True).split("Details")[1]
    assert re.search(rf"From the lengths only, the 95 % interval is k/K = {own}", result.methods())


def test_counts_hold_or_are_off_by_contacts():
    """A count has no σ to divide by."""
    length = np.ceil(LENGTH)
    holds = sp.fit(sp.Measurements(HEIGHT, 0.3, length, 0.0, kind=["whole"] * 6))
    rows = section(holds.report(), "no.")[1:]
    assert all(row.endswith("  holds") and f"{int(n)} contacts" in row for row, n in zip(rows, length, strict=True))
    length[0] += 30
    odd = sp.fit(sp.Measurements(HEIGHT, 0.3, length, 0.0, kind=["whole"] * 6))
    assert odd.identifiability is Identifiability.POOR_FIT
    assert re.search(r"off by [+-]\d+\.\d\d λc", odd.report())


@pytest.mark.slow
def test_an_end_is_as_long_as_said_where_the_contacts_have_another_size():
    """λc known to a factor only: a block that ends at 4/κ₂, where κ₂ is that of the fitted λc; as a fit of such a table."""
    table = two_specimens(young_sigma_GPa=None, correlation_length_sigma_um=100.0).drop(columns="young_sigma_GPa")
    table = table.assign(correlation_length_um=50.0, correlation_length_sigma_um=30.0)
    found = sp.fit(table)
    fitted = np.array([found.inputs[f"correlation_length[{name}, 5e-05]"] for name in table["specimen"]])
    assert abs(np.log(fitted / 5e-5)).max() > 0.1
    inputs = found.parameters.inputs.at(found.theta)
    own = np.asarray(sp.Slider(np.exp(inputs.log_height), inputs.ratio, inputs.poisson).slow_decay_length) * fitted * 1e3
    np.testing.assert_allclose(found.regime.slow_decay_length * 0.05, own, rtol=1e-12)  # in mm
    ended = sp.fit(table.assign(block_length_mm=4 * np.maximum(own, table["length_mm"] / 4)))
    moved = np.log(ended.values["areal_stiffness"] / found.values["areal_stiffness"])
    assert moves(found)["block_length"]["areal_stiffness"] == pytest.approx(moved, rel=0.05)


def test_one_specimen_that_breaks_again_leaves_the_verdict_of_the_other():
    """A's lengths are those of a soft interface; B's one length has a second, stiff value, where its edge breaks again."""
    m = sp.Measurements([40, 60, 80, 100, 30], 0.3, [15.0, 25.0, 36.0, 47.5, 30.0], [0.3] * 4 + [0.5], specimen=list("AAAAB"))
    found = sp.fit(m, EACH, intervals="profile").verdicts
    assert found["stiffness[A]"].identifiability is Identifiability.IDENTIFIED
    assert found["stiffness[B]"].identifiability is not Identifiability.IDENTIFIED


def test_an_error_that_the_data_exclude_is_not_one_of_the_result():
    """Counts with readings in mm determine λc: half of it fits nothing, and the total has its effect for a small change."""
    result = sp.fit(two_specimens())
    none = Change("young", "", {"areal_stiffness": (float("nan"),)}, {"areal_stiffness": -0.2})
    assert none.by("areal_stiffness") == 0.2
    (found,) = total_intervals(result, "areal_stiffness", [none])[LEVELS[0]]
    assert found.low < result.values["areal_stiffness"] * np.exp(-0.2)


# --- what a reader would compute again ----------------------------------------------------------------------------------


def in_mm(**columns):
    """Six lengths in mm, of λc = 0.1 mm, with an offset of half a millimetre."""
    length = 0.1 * np.asarray(sp.exact_lengths(sp.Slider(HEIGHT, 3e-4, 0.3))) + 0.5
    table = {"height_mm": 0.1 * HEIGHT, "correlation_length_um": 100.0, "poisson": 0.3, "young_GPa": 3.0, "length_mm": length}
    return pd.DataFrame(table | {"length_sigma_mm": 0.1} | columns)


def test_an_offset_is_in_the_unit_of_the_table_wherever_it_is_printed():
    result = sp.fit(in_mm(), ["stiffness", "offset"])
    value, error = (1e3 * one["offset"] for one in (result.values, result.stderrs))
    shown = value_with_error(value, error)
    said = result.report(verbose=True)
    assert f"offset = {shown} mm" in said
    (low, high, *_), = result.intervals["offset"][LEVELS[0]]  # fmt: skip
    ends = re.search(r"offset = .*\n +68% interval  (\S+) to (\S+)\n", said).groups()
    np.testing.assert_allclose([float(end) for end in ends], [1e3 * low, 1e3 * high], rtol=0.02)
    assert f"<td>{shown}</td>" in result._repr_html_()
    assert "<td>mm</td>" in result._repr_html_()
    assert "<td>m</td>" not in result._repr_html_()
    (row,) = [line for line in section(said, "What else would move it") if line.startswith("  H larger by 1 %")]
    by = 1e3 * moves(result)["height"]["offset"]
    assert row.endswith(f"  {by:+.2g} mm")


def test_changes_of_an_offset_are_in_order_too():
    result = sp.fit(in_mm(length_sigma_mm=0.3), ["offset"], fixed={"areal_stiffness": 9e9})
    rows = section(result.report(), "What else would move it")[1:]
    moved = [abs(float(re.search(r"([+-][\d.e-]+|0)( mm)?$", row).group(1))) for row in rows if row.endswith("mm")]
    assert len(moved) > 5
    assert moved == sorted(moved, reverse=True)
    assert "longest attainable" not in result.report()  # that is a matter of the stiffness, which is held


MIXED = {"kind": ["whole", "whole", "length", "length", "at_least", "length"]}


@pytest.mark.ci
@pytest.mark.parametrize("made", ["counts and limits", "an offset"])
def test_a_model_factor_moves_the_result_as_one_that_is_held(made):
    if made == "an offset":
        m, free = in_mm(), ["stiffness", "offset"]
    else:
        shorter = LENGTH * np.array([1, 1, 1.01, 0.99, 0.9, 1])
        sigma = np.array([0.5, 0.5, 3, 3, 3, 3])
        m, free = (
            sp.Measurements(HEIGHT, 0.3, np.where(np.arange(6) < 2, np.ceil(LENGTH), shorter), sigma, **MIXED),
            ["stiffness"],
        )
    result = sp.fit(m, free)
    held = sp.fit(m, free, fixed={"model_factor": 1.1})
    assert "model_factor" not in moves(held)  # a second factor is no question
    for name, moved in moves(result)["model_factor"].items():
        by = np.log(held.values[name] / result.values[name]) if name != "offset" else held.values[name] - result.values[name]
        assert moved == pytest.approx(by, rel=1e-3)


@pytest.mark.ci
def test_fronts_without_arrest_alone_bound_the_stiffness_and_have_no_best_value():
    m = sp.Measurements([200.0, 400.0], 0.3, [100.0, 250.0], 5.0, kind=["at_least"] * 2)
    result = sp.fit(m)
    assert result.identifiability is Identifiability.EQUAL
    report = unfolded(result.report())
    assert "any in the interval" in report
    assert "attainable" not in report
    (piece,) = result.intervals["stiffness"][LEVELS[1]]
    assert f"{value_with_error(piece.low, None)[:3]}" in report  # not rounded away beside the upper end
    lowest = np.asarray(sp.exact_lengths(sp.Slider([200.0, 400.0], piece.low, 0.3)))
    assert (lowest / [100, 250]).min() == pytest.approx(1, abs=0.1)
    assert "without a best value" in result.methods()


@pytest.mark.ci
def test_each_specimen_has_the_factor_of_a_block_of_its_own_lengths():
    stiffness = np.repeat([3e-4, 1e-3], 6)
    height = np.tile(HEIGHT, 2)
    length = np.asarray(sp.exact_lengths(sp.Slider(height, stiffness, 0.3)))
    m = sp.Measurements(height, 0.3, length, 0.01 * length, specimen=list("A" * 6 + "B" * 6))
    (both,) = (one.moves for one in sp.fit(m, EACH).changes if one.name == "block")
    for name, own in (("A", slice(0, 6)), ("B", slice(6, 12))):
        alone = sp.fit(sp.Measurements(height[own], 0.3, length[own], 0.01 * length[own]))
        (moved,) = (one.moves["stiffness"] for one in alone.changes if one.name == "block")
        np.testing.assert_allclose(both[f"stiffness[{name}]"], moved, atol=0.01)  # blocks followed by the lengths of both
    assert both["stiffness[A]"][0] != pytest.approx(both["stiffness[B]"][0], abs=0.05)


def test_errors_of_measuring_are_those_of_what_was_measured():
    provenance = ["measured", "measured", "", "", "", ""]
    result = sp.fit(lengths(provenance=provenance), fixed={"threshold_scatter": 0})
    q = result.parameters
    scale, offset = q.of_lengths
    assert offset.slope[:, q.index("offset")].tolist() == [1, 1, 0, 0, 0, 0]
    assert scale.slope[:, q.index("model_factor")].tolist() == [1, 1, 0, 0, 0, 0]


def test_no_size_of_errors_from_a_scatter_that_counts_do_not_have():
    """`sigma="relative"` is not suggested where it would be refused."""
    off = LENGTH + np.array([0, 9, -9, 9, -9, 9])
    kind = ["whole", *["length"] * 5]
    m = sp.Measurements(HEIGHT, 0.3, np.where(np.arange(6) < 1, np.ceil(off), off), 5.0, kind=kind)
    result = sp.fit(m)
    (note,) = [one for one in result.notes if one.startswith("the scatter is larger")]
    assert "relative" not in note
    with pytest.raises(ValueError, match="no scatter"):
        sp.fit(m, sigma="relative")


@pytest.mark.slow
def test_a_narrow_pusher_is_judged_with_the_error_of_its_height():
    """As a fit of the table with the width stated, and not as if the height were exact."""
    table = {"height_cm": [1.2, 4.0], "correlation_length_um": 20, "poisson": 0.38, "young_MPa": 2400, "length_cm": [0.41, 2.1]}
    table |= {"length_sigma_cm": [0.008, 0.042], "push_height_cm": [0.3, 1.0], "push_height_sigma_cm": 0.02}
    wide = sp.fit(pd.DataFrame(table))
    narrow = sp.fit(pd.DataFrame(table | {"push_width_cm": [0.12, 0.4]}))
    ratio = narrow.values["areal_stiffness"] / wide.values["areal_stiffness"]
    assert np.exp(moves(wide)["push_width"]["areal_stiffness"]) == pytest.approx(ratio, rel=0.25)
    assert "the stiffness is about" in unfolded(wide.report())
