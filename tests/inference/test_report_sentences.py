"""Sentences of a report are short, and a verdict without a plain number names its answer in the documentation."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.inference.result.verdict import ANSWERS, FAQ, Identifiability

EXAMPLES = Path(__file__).resolve().parents[2] / "fit_examples"
MOST_WORDS = 25
HEIGHT = np.array([20.0, 30.0, 40.0])
SLOW = {"pressed_block", "pushed_block", "sequence"}
TABLES = sorted(path.parent.name for path in EXAMPLES.glob("*/lengths.csv"))


def box_of(report):
    """Lines of prose in the box: those of values have columns, two spaces apart."""
    lines = [line.strip("│ ") for line in report.splitlines() if line.startswith("│")]
    return [line for line in lines if "  " not in line and line]


def sentences(report):
    """Sentences of the box, then those of the lists, without the addresses."""
    box = " ".join(line for line in box_of(report) if not line.startswith("More: "))
    listed = [line[4:] for line in report.splitlines() if line.startswith("  - ")]
    return [one for text in (box, *listed) for one in re.split(r"(?<=[.?]) ", text)]


def words(sentence):
    return [word for word in sentence.split() if re.search(r"\w", word)]


def check(result):
    """Every sentence is short and begins as one; the addresses are those of the verdicts, and of rows that say none fits."""
    report = result.report()
    found = sentences(report)
    assert len(found) > 2
    for one in found:
        assert len(words(one)) <= MOST_WORDS, one
        assert not re.match(r"[a-z]{2,} ", one), one
    addresses = re.findall(rf"{re.escape(FAQ)}#([a-z-]+)", report)
    asked = {ANSWERS[one.identifiability] for one in result.verdicts.values() if one.identifiability in ANSWERS}
    asked |= {"none-fits"} if re.search(r"  none fits( |$)", report, flags=re.MULTILINE) else set()
    asked |= {"check-first"} if result.suspicions else set()
    assert sorted(addresses) == sorted(asked)
    return report


def test_every_verdict_but_one_has_an_answer_of_its_own():
    assert {*Identifiability} - {*ANSWERS} == {Identifiability.IDENTIFIED}
    assert len({*ANSWERS.values()}) == len(ANSWERS)
    assert all(re.fullmatch(r"[a-z-]+", slug) for slug in ANSWERS.values())


@pytest.mark.ci
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in TABLES])
def test_sentences_of_the_bundled_tables_are_short(name, worked):
    check(worked(name))


@pytest.mark.ci
@pytest.mark.parametrize("name", ["pmma_block", "own_csv"])
def test_sentences_of_measured_tables_are_short(name):
    """With the factor of a real block in the box, as for lengths that were made."""
    m = sp.read_measurements(EXAMPLES / name / "lengths.csv")
    report = check(sp.fit(dataclasses.replace(m, provenance=("measured",) * len(m)), fixed={"threshold_scatter": 0}))
    assert re.search(r"A real block would need 0\.0\d+ ", " ".join(box_of(report)))


def lengths(ratio=3e-3, sigma=0.01, noise=(0.5, -1.0, 0.7), height=HEIGHT, **columns):
    length = np.asarray(sp.exact_lengths(sp.Slider(height, ratio, 0.3))) * (1 + sigma * np.resize(noise, len(height)))
    return sp.Measurements(height, 0.3, length, sigma * length, **columns)


CASES = {
    Identifiability.POOR_FIT: lambda: sp.fit(sp.Measurements(HEIGHT, 0.3, [14.2, 9.0, 31.0], 0.1)),
    Identifiability.AT_BOUND: lambda: sp.fit(lengths(), sp.Parameter("stiffness", bounds=(1e-4, 2.95e-3))),
    Identifiability.AT_MAXIMUM: lambda: sp.fit(sp.Measurements(HEIGHT, 0.3, 1.3 * HEIGHT, 0.1 * HEIGHT)),
    Identifiability.NO_SCATTER: lambda: sp.fit(dataclasses.replace(lengths(noise=[0.0]), length_sigma=None)),
    Identifiability.SEVERAL_ROOTS: lambda: sp.fit(sp.Measurements([20.0, 30.0], 0.37, [14.2, 22.0], 0.6)),
    Identifiability.ONE_SIDED: lambda: sp.fit(sp.Measurements(HEIGHT, 0.3, [3.0, 9.0, 15.0], 0.5, kind=["at_least"] * 3)),
    Identifiability.UNINFORMATIVE: lambda: sp.fit(sp.Measurements(HEIGHT, 0.3, HEIGHT / 2, 1e4)),
    Identifiability.EQUAL: lambda: sp.fit(sp.Measurements(HEIGHT, 0.3, [10, 16, 22], 0.0, kind=["whole"] * 3)),
    Identifiability.REBREAKS: lambda: sp.fit(lengths(0.5), sp.Parameter("stiffness", bounds=(0.1, 1.0))),
}


@pytest.mark.ci
@pytest.mark.parametrize("verdict", CASES, ids=lambda one: one.name.lower())
def test_sentences_of_other_verdicts_are_short(verdict):
    result = CASES[verdict]()
    assert result.identifiability is verdict
    check(result)


@pytest.mark.ci
def test_a_root_at_which_the_edge_breaks_again_never_leads():
    """It fits better, stands second, and the option to keep the first alone does so."""
    m = sp.Measurements([2000.0, 3000.0], 0.37, [1420.0, 2200.0], 60.0)
    result = sp.fit(m)
    soft, stiff = result.roots
    assert stiff.deviance < soft.deviance
    assert [root.rebreaks for root in result.roots] == [False, True]
    low, high = map(
        float, re.search(r"  To keep the first, with its errors: bounds=\((\S+), (\S+)\)\n", result.report()).groups()
    )
    kept = sp.fit(m, sp.Parameter("stiffness", bounds=(low, high)))
    assert kept.identifiability is Identifiability.IDENTIFIED
    assert kept.values["stiffness"] == pytest.approx(soft.values["stiffness"], rel=1e-4)
    pieces = re.search(r"│ k/K .*\)  +(.*?) +│", result.report()).group(1).split(" or ")
    assert len(pieces) == 2
    assert all(len(re.findall(r"\d", number.partition("e")[0])) <= 4 for piece in pieces for number in piece.split(" to "))
