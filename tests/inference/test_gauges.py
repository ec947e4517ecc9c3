"""Slip and stress along the interface: the fields against a dense program, and what a fit makes of readings of them."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner
from oracles import dense_chain
from reports import unfolded

import slippulse_jax as sp
from benchmarks import gauge_coverage
from slippulse_jax.cli.fit import command
from slippulse_jax.front.front import slip_and_stress
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.observables import EVERY
from slippulse_jax.inference.parameters import parameter_set
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.likelihood import make_problem
from slippulse_jax.inference.search.minimise import minimise
from slippulse_jax.inference.table.measurements import MeasurementError, read_measurements

LC, YOUNG, STRENGTH, AREAL = 1e-4, 3e9, 2e6, 6e11
RATIO = AREAL * LC / YOUNG
UNIT = STRENGTH / AREAL  # u_s, in m


def dense_fields(height, stiffness, prestress=0.0, broken=None):
    """Contacts broken, slip and stress after arrest, of the first 120 contacts, by solving the whole chain."""
    load, pinning = dense_chain.responses(height, stiffness, 0.3, 400, "semi-infinite", 120)
    edge, stress = (1 - prestress) * load / load[0], dense_chain.front_stress(load, pinning, 120, prestress)
    count = int(np.nonzero(stress[1:] < 1)[0][0]) + 1 if broken is None else broken
    moved = np.where(np.arange(120) < count, stress, 0)
    slip = pinning @ moved
    return count, slip, prestress + edge + slip - moved


def at_gauges(height, stiffness, prestress, place, beyond, counted):
    """Inputs of the model for readings of gauges."""
    further = np.broadcast_arrays(np.log(place), beyond, counted, height)[:3]
    names = ("log_position", "beyond", "counted")
    return Inputs.of(height, stiffness, 0.3, prestress).given(**dict(zip(names, further, strict=True)))


@pytest.mark.ci
@pytest.mark.parametrize(("height", "stiffness", "prestress"), [(25.0, 0.03, 0.0), (40.0, 0.01, 0.2), (15.0, 0.1, 0.3)])
def test_fields_are_those_of_the_dense_program(height, stiffness, prestress):
    """Whole counts to rounding; between them a smooth step; between contacts a straight line."""
    count, slip, stress = dense_fields(height, stiffness, prestress)
    _, slip_before, stress_before = dense_fields(height, stiffness, prestress, count - 1)
    with jax.enable_x64(True):
        slider = sp.Slider(height, stiffness, 0.3)
        whole, between = (
            slip_and_stress(slider, jnp.asarray(prestress), jnp.asarray(x), 64) for x in (float(count), count - 0.3)
        )
    np.testing.assert_allclose(whole, (slip[:64], stress[:64]), atol=1e-12)
    step = 0.7**2 * (3 - 2 * 0.7)
    np.testing.assert_allclose(between[0], step * slip[:64] + (1 - step) * slip_before[:64], atol=1e-12)
    np.testing.assert_allclose(between[1], step * stress[:64] + (1 - step) * stress_before[:64], atol=1e-12)
    places = np.array([3.25, count - 1.5, count + 20])
    inputs = at_gauges(np.full(3, height), stiffness, prestress, places, 0.0, count)
    np.testing.assert_allclose(
        EVERY["slip"]().evaluate(FirstFront(), inputs)[0], np.interp(places, np.arange(120), slip), atol=1e-12
    )
    np.testing.assert_allclose(
        EVERY["stress"]().evaluate(FirstFront(), inputs)[0], np.interp(places, np.arange(120), stress), atol=1e-12
    )


@pytest.mark.ci
def test_a_front_without_a_count_stops_at_its_length():
    """At ℓ* + δ; beyond the contacts looked at in the first batch too; nowhere where it never stops."""
    inputs = at_gauges([2000.0, 20.0], [1e-3, 0.02], [0.0, 0.99], [1500.0, 1.6], 0.4, 0.0)
    length = sp.exact_lengths(sp.Slider(2000.0, 1e-3, 0.3)) + 0.4
    with jax.enable_x64(True):
        slip, _ = slip_and_stress(sp.Slider(2000.0, 1e-3, 0.3), jnp.asarray(0.0), jnp.asarray(float(length)), 4096)
    found = EVERY["slip"]().evaluate(FirstFront(), inputs)[0]
    assert found[0] == pytest.approx(float(slip[1500]), abs=1e-9)
    assert found[1] == np.inf


def table(kind="whole", noise=None, heights=(25.0, 50.0)):
    """Measured by an independent program: slip ± 0.05 µm and stress ± 0.06 MPa at nine gauges a precursor."""
    lengths, columns = [], []
    for row, height in enumerate(heights):
        count, slip, stress = dense_fields(height, RATIO)
        lengths.append(count - 0.5 * (kind == "length"))
        i = np.linspace(1, 1.3 * count, 9).round().astype(int)
        columns.append(np.stack([np.full(9, row), i * LC, slip[i] * UNIT, stress[i] * STRENGTH]))
    row, position, slip, stress = np.concatenate(columns, axis=1)
    sigma = 0.05e-6, 0.06e6
    if noise is not None:
        slip, stress = slip + sigma[0] * noise.standard_normal(len(slip)), stress + sigma[1] * noise.standard_normal(len(slip))
        lengths = np.array(lengths) + (kind == "length") * noise.standard_normal(len(lengths))
    gauges = sp.Gauges(row, position, slip, sigma[0], stress, sigma[1])
    return sp.Measurements(
        height=heights, poisson=0.3, length=lengths, length_sigma=1.0 * (kind == "length"), kind=(kind,) * len(heights),
        correlation_length=LC, young=YOUNG, gauges=gauges,
    )  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("kind", [pytest.param("whole", marks=pytest.mark.slow), "length"])
def test_objective(kind):
    """Its gradient against differences of its value; the density that a sampler sees is the same function."""
    m = table(kind, np.random.default_rng(0))
    q = parameter_set(m, ["stiffness", "strength", "prestress", sp.Parameter("correlation_length", prior=(LC, LC / 10))])
    assert [one.label for one in q.free if one.nuisance] == (["arrest[0]", "arrest[1]"] if kind == "length" else [])
    problem = make_problem(m, q)
    theta = np.array([np.log(AREAL) - 0.05, np.log(STRENGTH) + 0.03, 0.02, np.log(1.02 * LC), 0.35, 0.6])[: problem.p]
    step = 1e-5 * np.eye(problem.p)
    slope = (problem(theta + step).value - problem(theta - step).value) / 2e-5
    found = problem(theta, order=1)
    np.testing.assert_allclose(found.gradient[0], slope, rtol=1e-5, atol=1e-3)
    if kind == "length":  # the other case is a part of this one
        with jax.enable_x64(True):
            density = jax.jit(problem.traced)(jnp.asarray(theta))
        np.testing.assert_allclose(density, found.value[0], rtol=1e-9)


@pytest.mark.ci
def test_fit_to_what_the_dense_program_makes():
    """Without noise the counted precursors give the truth back, stiffness and strength."""
    m = dataclasses.replace(table(), label=("A", "B"))
    result = sp.fit(m, ["stiffness", "strength"])
    assert result.values["areal_stiffness"] == pytest.approx(AREAL, rel=1e-6)
    assert result.values["strength"] == pytest.approx(STRENGTH, rel=1e-6)
    assert "slip         18 readings" in result.report()
    assert [one.observable for one in result.further] == ["slip", "stress"]
    assert max(np.abs(one.residuals).max() for one in result.further) < 1e-5
    _, slip, stress = dense_fields(25.0, RATIO)
    places = np.arange(1, 40)
    np.testing.assert_allclose(result.field(0, "slip", places * LC), slip[places] * UNIT, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(result.field(0, "stress", places * LC), stress[places] * STRENGTH, rtol=1e-5, atol=1e-2)
    assert len(sp.plot.gauges(result).axes) == 2


@pytest.mark.ci
def test_contacts_that_were_not_counted_make_no_second_value():
    """D bends from contact to contact, but has one valley, and the search converges."""
    result = sp.fit(table("length", np.random.default_rng(3), heights=(25.0,)), ["stiffness", "strength"])
    assert len(result.roots) == 1
    assert result.identifiability is Identifiability.IDENTIFIED
    for name, truth in (("areal_stiffness", AREAL), ("strength", STRENGTH)):
        assert abs(result.values[name] - truth) < 3 * result.stderrs[name]
        assert any(piece.low < truth < piece.high for piece in result.intervals[name][0.95])


def rises(kind, studies, seed):
    """−2 ln L at the true stiffness and strength over its minimum, what is not known of the arrests fitted at both."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(studies):
        m = table(kind, rng)
        q = parameter_set(m, ["stiffness", "strength"])
        problem = make_problem(m, q)
        start = np.append(np.log([AREAL, STRENGTH]), np.full(problem.p - 2, 0.5))
        best, true = (minimise(problem, start, q.low, q.high, held=np.arange(problem.p) < n).value[0] for n in (0, 2))
        found.append(2 * (true - best))
    return np.array(found)


@pytest.mark.ci
@pytest.mark.parametrize("kind", ["whole", "length"])
@pytest.mark.parametrize("studies", [pytest.param(6, id="sample"), pytest.param(300, id="full", marks=pytest.mark.slow)])
def test_errors_are_honest(kind, studies):
    """Regions of 68 and 95 % hold the truth as often as they say, counted or measured to a contact."""
    found = rises(kind, studies, 3)
    for level in (0.68, 0.95):
        inside = np.mean(found < -2 * np.log(1 - level))  # of χ² with two degrees of freedom
        assert abs(inside - level) < 4 * np.sqrt(level * (1 - level) / studies)


@pytest.mark.ci
def test_coverage_where_contacts_break_once_and_again():
    """A sample of benchmarks/gauge_coverage.py: the intervals hold unless contacts behind the front break again."""
    found = gauge_coverage.coverage(14, seed=0)
    assert found["once"].region[1].value > 0.8
    assert found["again"].region[1].value == 0
    assert found["once"].refused.value == 0
    assert found["again"].refused.value == 1


@pytest.mark.ci
@pytest.mark.parametrize("ratio", [0.05, 0.1])
def test_gauges_refuse_where_contacts_break_again(ratio):
    """Readings after the whole event do not fit those of its front: no number, whether the best fit lies beyond the onset or not."""
    m, _, again = gauge_coverage.measured(np.array([25.0, 40.0]), ratio, np.random.default_rng(1))
    assert again > 0
    result = sp.fit(m, ["stiffness", "strength"], intervals="profile")
    assert result.identifiability is Identifiability.POOR_FIT
    assert set(result.stderrs.values()) == {None}
    assert not any(piece for found in result.intervals.values() for piece in found.values())
    assert "The model does not describe these data" in unfolded(result.report())
    assert ("of the first front alone" in result.report()) == (ratio == 0.1)
    with pytest.raises(ValueError, match="gauges, block_length and machine_stiffness need the model of one front"):
        sp.fit(m, ["stiffness", "strength"], event="full")


LENGTHS = (
    "label,height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm,kind\nA,2.5,100,0.3,3,2.5,0,whole\n"
)


def write(tmp_path, gauges, lengths=LENGTHS):
    for name, text in (("lengths.csv", lengths), ("gauges.csv", gauges)):
        (tmp_path / name).write_text(text)
    return str(tmp_path / "lengths.csv"), str(tmp_path / "gauges.csv")


@pytest.mark.parametrize(
    ("gauges", "lengths", "message"),
    [
        (
            "label,position_mm,slip_um,slip_sigma_um\nB,1,2,0.1\n",
            LENGTHS,
            r"line 2, column label: no measurement has the label 'B'",
        ),
        ("label,position_mm,slip_um\nA,1,2\n", LENGTHS, "slip is given without slip_sigma"),
        ("label,position_mm,slip_mm\nA,1,2\n", LENGTHS, "line 1: columns label, position_mm, slip_mm; expected"),
        (
            "label,position_mm,slip_um,slip_sigma_um\nA,-1,2,0.1\n",
            LENGTHS,
            "line 2, column position_mm: -1: a position must be finite",
        ),
        (
            "label,position_mm,slip_um,slip_sigma_um\nA,1,2,0\n",
            LENGTHS,
            "line 2, column slip_sigma_um: 0: the standard error must be",
        ),
        ("label,position_mm,slip_um,slip_sigma_um\nA,1,,\n", LENGTHS, "line 2: neither slip nor stress was read"),
        ("label,position_mm,slip_um,slip_sigma_um\nA,1,2,x\n", LENGTHS, "line 2, column slip_sigma_um: 'x' is not a number"),
        ("label,position_mm,slip_um,slip_sigma_um\nA,1,2\n", LENGTHS, "line 2: 3 columns, but the header has 4"),
        ("label,position_mm\n", LENGTHS, "a header line and at least one more"),
        (
            "label,position_mm,slip_um,slip_sigma_um\nA,1,2,0.1\n",
            LENGTHS.replace("whole", "at_least"),
            "that front did not stop",
        ),
        (
            "label,position_mm,slip_um,slip_sigma_um\nA,1,2,0.1\n",
            "label,height,poisson,length,length_sigma\nA,25,0.3,25,0.5\n",
            "gauges are in SI",
        ),
    ],
)
def test_bad_tables_are_refused(tmp_path, gauges, lengths, message):
    lengths, gauges = write(tmp_path, gauges, lengths)
    with pytest.raises(MeasurementError, match=message):
        read_measurements(lengths, gauges=gauges)


def test_without_strength_readings_mean_nothing():
    with pytest.raises(ValueError, match=r"gauges: what gauges read scales with σ_s: fit strength too, or hold it"):
        sp.fit(table())


def test_command_line(tmp_path):
    m = table()
    rows = zip(m.gauges.row, m.gauges.position, m.gauges.slip, strict=True)
    body = "".join(f"A,{x * 1e3},{slip * 1e6},0.05\n" for row, x, slip in rows if row == 0)
    lengths, gauges = write(tmp_path, "label,position_mm,slip_um,slip_sigma_um\n" + body)
    figure = tmp_path / "gauges.png"
    asked = [
        lengths,
        "--gauges",
        gauges,
        "--free",
        "stiffness",
        "--fix",
        "strength=2e6",
        "--gauge-figure",
        str(figure),
        "--json",
    ]
    done = CliRunner().invoke(command, asked)
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["values"]["areal_stiffness"] == pytest.approx(AREAL, rel=1e-3)
    assert [(one["observable"], len(one["fitted"])) for one in found["further"]] == [("slip", 9)]
    assert figure.stat().st_size > 5000
    refused = CliRunner().invoke(command, [lengths, "--gauge-figure", str(figure)])
    assert refused.exit_code == 2
    assert "--gauge-figure needs --gauges" in refused.output
