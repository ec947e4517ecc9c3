"""Every row of "What else would move it" against a fit of the table that it describes, changed here column by column."""

import io
import math
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import slippulse_jax as sp
from slippulse_jax.inference.result.changes import END, MACHINES, NORMAL, PRESSED, PUSHES
from slippulse_jax.inference.result.verdict import GIVEN, Identifiability
from slippulse_jax.inference.table.columns import COLUMNS

EXAMPLES = Path(__file__).parents[2] / "fit_examples"
LARGER = {"height": 1.01, "length": 1.01, "young": 1.05, "correlation_length": 0.5, "push_height": 1.05, "friction": 1.1}
SLIDERS = ["pmma_block", "own_csv", "inertial_experiment", "shared_stiffness", "prestressed_slider"]

TWO_BLOCKS = """\
specimen,height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm,push_height_mm,push_width_mm
A,20,20,0.37,3.2,8.1,0.5,4,2
A,20,20,0.37,3.2,12.6,0.5,6,2
A,20,20,0.37,3.2,18.2,0.5,8,2
B,30,20,0.37,3.2,12.0,0.5,6,2
B,30,20,0.37,3.2,22.0,0.5,9,2
B,30,20,0.37,3.2,30.5,0.5,12,2
"""
"""Blocks that no pressure that tilts describes, though each length alone is described by one."""
TWO_ROOTS = """\
height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm
20,10,0.37,3.2,14.2,0.6
30,10,0.37,3.2,22,0.6
"""
"""The stiffer of two values, at which the edge breaks again, fits better."""


def changed(table, result, change):  # noqa: C901 (a case for each kind of row)
    """Tables and options of `fit` that a row describes, one for each of its moves."""
    in_si, m, at = result.measurements.in_si, result.measurements, result.regime
    name = {quantity: column.name(in_si) for quantity, column in COLUMNS.items()}
    mm = 1e3 * m.correlation_length if in_si else 1.0
    own = [one for one in result.request["free"] if one.name != "strength"]

    def given(drop=(), **columns):
        return table.drop(columns=[name[one] for one in drop if name[one] in table]).assign(
            **{name.get(one, one): x for one, x in columns.items()}
        )

    column = name.get(change.name)
    if change.name in LARGER:
        return [(table.assign(**{column: table[column] * LARGER[change.name]}), {})]
    if change.name == "poisson":
        return [(table.assign(**{column: table[column] - 0.02}), {})]
    if change.name == "block_length":
        return [(given(block_length=END * np.maximum(at.slow_decay_length, m.length / 4) * mm), {})]
    if change.name == "machine_stiffness":
        size = at.edge_stiffness * (m.young if m.young is not None else 1.0)  # of a block one metre wide
        width = {"block_width": 1000.0} if in_si else {}
        return [(given(machine_stiffness=share * size, **width), {}) for share in MACHINES]
    if change.name == "model_factor":
        return [(table, {"fixed": {"model_factor": 1.1}})]
    if change.name == "block":
        lengths = {"drop": ["displacement", "displacement_sigma", "force", "force_sigma"]}
        return [(given(push_height=share * m.height * mm, **lengths), {"free": own}) for share in PUSHES]
    if change.name == "push_width":
        where = np.clip(m.push_height, 0.1 * m.height, 0.9 * m.height)
        return [(given(push_height=where * mm, push_width=0.1 * m.height * mm), {})]
    if change.name == "pressure":
        tried = PRESSED if m.friction is None else (0.0,)
        return [(given(friction=mu, drop=["friction_sigma"]), {}) for mu in tried]
    if change.name == "residual_strength":
        return [(given(residual_strength=0.1), {})]
    if change.name == "normal_stiffness":
        return [(given(normal_stiffness=ratio), {}) for ratio in NORMAL]
    assert change.name == "slider"
    return [(table, {"event": "domino", "body": "slider"})]


def check_rows(text, rows=None, **options):
    """Every row, or those named, against fits of the changed tables; the names of the rows there are."""
    table = pd.read_csv(io.StringIO(text), comment="#")
    result = sp.fit(sp.Measurements.from_dataframe(table), **options)
    for change in result.changes:
        if change.otherwise == "not computed" or (rows and change.name not in rows):
            continue
        cases = changed(table, result, change)
        for i, (other, more) in enumerate(cases):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", sp.inference.table.measurements.MeasurementWarning)
                try:
                    found = sp.fit(sp.Measurements.from_dataframe(other), **{**options, **more})
                except ValueError:
                    found = None
            for name, moves in change.moves.items():
                assert len(moves) == len(cases)
                told = (*GIVEN, Identifiability.SEVERAL_ROOTS)
                fits = found is not None and found.verdicts[name].identifiability in told
                where = f"{change.what}, {i}, {name}: {np.exp(moves)}, {found and (found.values, found.identifiability)}"
                assert math.isnan(moves[i]) != fits, where
                if fits:
                    log = result.parameters.named(name).log
                    off = np.log(found.values[name] / result.values[name]) if log else found.values[name] - result.values[name]
                    assert moves[i] == pytest.approx(off, abs=0.02, rel=0 if log else 0.02), where
    return [change.name for change in result.changes]


QUICK = ("pmma_block", "prestressed_slider")


@pytest.mark.ci
@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in SLIDERS])
def test_each_row_of_a_slider_is_a_fit_of_the_changed_table(name):
    """Of each bundled table of lengths, a real block included, with the verdict "none fits"."""
    text = (EXAMPLES / name / "lengths.csv").read_text(encoding="utf-8")
    rows = check_rows(text)
    assert {"machine_stiffness", "poisson"} <= {*rows}
    assert ("block" in rows) == (name != "prestressed_slider")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pushed_block", "pressed_block"])
def test_each_row_of_a_block_is_a_fit_of_the_changed_table(name):
    """As of a slider; each changed block is followed by itself."""
    rows = check_rows((EXAMPLES / name / "lengths.csv").read_text(encoding="utf-8"))
    assert {"pressure", "slider", "push_height"} <= {*rows}


@pytest.mark.slow
@pytest.mark.parametrize("each", [False, True])
def test_a_pressure_that_tilts_is_fitted_to_the_whole_table(each):
    """Of two specimens, each with its own rows: not the factor of one length, given to all."""
    options = {"free": [sp.Parameter("stiffness", each="specimen")]} if each else {}
    assert "pressure" in check_rows(TWO_BLOCKS, {"pressure", "slider"}, **options)


@pytest.mark.ci
def test_rows_where_several_values_fit_and_the_value_that_stands_first():
    """The soft one, although the stiff one fits better: the edge breaks again there, which the model leaves out."""
    rows = check_rows(TWO_ROOTS, {"young", "length", "machine_stiffness"})
    assert {"block", "young", "machine_stiffness"} <= {*rows}


@pytest.mark.ci
@pytest.mark.parametrize("provenance", ["measured", "digitised"])
def test_measured_lengths_have_the_factor_of_a_real_block(provenance):
    """With an offset and a model factor fitted beside them where they were measured."""
    text = (EXAMPLES / "pmma_block/lengths.csv").read_text(encoding="utf-8").replace("synthetic", provenance)
    assert "block" in check_rows(text, {"block", "young"}, free=["stiffness", sp.Parameter("threshold_scatter", value=0)])
