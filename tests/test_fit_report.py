"""What the report of a fit says beside the numbers: what a block is and leaves out."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import slippulse_jax as sp

EXAMPLES = Path(__file__).resolve().parent.parent / "fit_examples"
HEIGHT = np.array([250.0, 350.0, 450.0, 550.0, 650.0, 750.0])
LENGTH = np.asarray(sp.exact_lengths(sp.Slider(HEIGHT, 3e-4, 0.3)))
NOISE = np.array([0.4, -1.1, 0.8, -0.3, 1.0, -0.7])


def lengths(sigma=0.01, noise=NOISE, **columns):
    """Six lengths of one stiffness, with relative errors."""
    return sp.Measurements(HEIGHT, 0.3, LENGTH * (1 + sigma * noise), sigma * LENGTH, **columns)


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
