"""Fits to blocks that end and machines that give way: lengths of chains solved as matrices."""

import dataclasses
import functools
import re

import jax
import numpy as np
import pytest
from oracles import dense_chain
from reports import moves, unfolded
from slopes import slopes_of

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.observables import EVERY
from slippulse_jax.inference.table.measurements import MeasurementError

HEIGHT, TRUTH = np.array([12.0, 16.0, 20.0]), 0.0126
LENGTH = 4 * HEIGHT
MACHINE = 10.0


@functools.cache
def dense_lengths(machine=None, right="free"):
    return np.array(
        [dense_chain.first_precursor(h, TRUTH, 0.3, int(n), right, machine)[1] for h, n in zip(HEIGHT, LENGTH, strict=True)]
    )


def measured(length, **more):
    return sp.Measurements(height=HEIGHT, poisson=0.3, length=length, length_sigma=0.01 * length, **more)


@pytest.mark.ci
@pytest.mark.parametrize("machine", [MACHINE, pytest.param(None, marks=pytest.mark.ci)])
def test_a_fit_that_knows_the_ends_recovers_the_stiffness(machine):
    """Lengths of the dense program; the fit that takes the block as endless is far off, and says so by nothing."""
    length = dense_lengths(machine)
    aware = sp.fit(measured(length, block_length=LENGTH, machine_stiffness=machine), intervals="profile")
    assert aware.values["stiffness"] == pytest.approx(TRUTH, rel=1e-6)
    assert aware.deviance < 1e-12
    assert (aware.front_status == Outcome.ARRESTED).all()
    assert "; L/H = 4" in aware.report(verbose=True)
    assert re.search(r"Assumes the paper's slider with the stated end( and machine)?: uniform", unfolded(aware.report()))
    assert aware.to_dict()["regime"]["block_length_over_height"] == [4, 4, 4]
    plain = sp.fit(measured(length), intervals="profile")
    assert plain.values["stiffness"] > 2 * TRUTH


def test_rows_without_an_end_are_those_of_an_endless_block():
    """Blank cells mean a block without end whose edge is held, to rounding."""
    inputs = Inputs.of(HEIGHT, TRUTH, 0.3)
    blank = inputs.given(log_sites=np.array([np.inf, np.log(64.0), np.inf]), log_machine=np.full(3, np.inf))
    found, plain = FirstFront().lengths(blank), FirstFront().lengths(inputs)
    np.testing.assert_allclose(found[[0, 2]], plain[[0, 2]], rtol=1e-13)
    assert found[1] == pytest.approx(dense_lengths()[1], abs=1e-9)
    slopes = slopes_of(FirstFront(), blank, ["log_sites"])
    assert slopes["log_sites"][[0, 2]].tolist() == [0, 0]
    assert slopes["log_sites"][1] < 0


@pytest.mark.ci
def test_observables_at_nucleation_and_gauges():
    """Edge displacement and driving force, slip and stress, on blocks that end, by the dense program."""
    height, sites = 16.0, 64
    inputs = Inputs.of(np.full(4, height), TRUTH, 0.3).given(log_sites=np.full(4, np.log(sites)))
    load, _ = dense_chain.responses(height, TRUTH, 0.3, sites, "free", sites)
    assert EVERY["displacement"]().evaluate(FirstFront(), inputs)[0, 0] == pytest.approx(1 / load[0], rel=1e-9)
    assert EVERY["force"]().evaluate(FirstFront(), inputs)[0, 0] == pytest.approx(load.sum() / load[0], rel=1e-9)
    pushed = inputs.given(log_machine=np.full(4, np.log(MACHINE)))
    assert EVERY["displacement"]().evaluate(FirstFront(), pushed)[0, 0] == pytest.approx(1 / load[0], rel=1e-9), (
        "of the edge, not of the machine"
    )
    chain = dense_chain.DenseChain.uniform((height, TRUTH, 0.3), np.ones(sites), 0.0, "free", spring=MACHINE)
    chain.at(load=chain.next_break()[0])
    before = chain.fields()[1]
    chain.rupture(0)
    place = np.array([0.0, 3.0, 10.0, 40.0])
    count = float(np.count_nonzero(chain.pinning))
    read = pushed.given(log_position=np.log(np.maximum(place, 1e-9)), beyond=np.zeros(4), counted=np.full(4, count))
    at = place.astype(int)
    np.testing.assert_allclose(EVERY["slip"]().evaluate(FirstFront(), read)[0], (chain.fields()[1] - before)[at], atol=1e-7)
    np.testing.assert_allclose(EVERY["stress"]().evaluate(FirstFront(), read)[0], chain.stress()[at], atol=1e-7)


@pytest.mark.ci
def test_the_traced_density_is_that_of_the_fit():
    """With an end and a drive in some rows, value and slope."""
    end, machine = np.array([np.nan, 64.0, 80.0]), np.array([np.nan, np.nan, MACHINE])
    found = sp.fit(measured(dense_lengths(), block_length=end, machine_stiffness=machine), intervals="profile")
    theta = found.theta + 0.02
    with jax.enable_x64(True):
        density = jax.jit(found.problem.traced)
        value, slope = jax.jvp(density, (theta,), (np.ones_like(theta),))
    at = found.problem(theta, order=1)
    assert float(value) == pytest.approx(at.value[0], rel=1e-9)
    assert float(slope) == pytest.approx(at.gradient[0, 0], rel=1e-9)


@pytest.mark.ci
def test_a_front_that_ran_through_the_block():
    """A length at least that of the block: certain where the model's front runs through, impossible elsewhere."""
    ran = measured(np.append(dense_lengths()[:2], 80.0), block_length=LENGTH, kind=["length", "length", "at_least"])
    ran = dataclasses.replace(ran, length_sigma=np.where(np.array(ran.kind) == "length", ran.sigma, 0.0))
    short = dataclasses.replace(ran, block_length=np.array([48.0, 64.0, 28.0]), length=np.append(ran.length[:2], 28.0))
    assert sp.fit(short, intervals="profile").values["stiffness"] == pytest.approx(TRUTH, rel=0.02)
    assert sp.fit(ran, intervals="profile").deviance > 100


@pytest.mark.ci
def test_a_minimum_beside_a_whole_contact_is_found():
    """Study 150 of benchmarks/ends_coverage.py: 1e-4 in ln k from the least deviance a length reaches a whole contact."""
    m = sp.Measurements(
        height=[44.99653712, 55.52521332, 26.32281471], poisson=0.3, length=[71.09147129, 78.8317992, 82.0],
        length_sigma=[1.38137999, 1.60939883, 0.0], kind=["length", "length", "at_least"], block_length=[140.0, 173.0, 82.0],
        machine_stiffness=0.65879817,
    )  # fmt: skip
    result = sp.fit(m, intervals="profile")
    assert result.converged
    assert result.values["stiffness"] == pytest.approx(0.016354, rel=1e-4)
    around = result.theta + np.linspace(-1e-3, 1e-3, 201)[:, None]
    assert result.problem(around).value.min() > result.deviance / 2 - 1e-9


HEADER = "height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm"


def read(tmp_path, header, *rows):
    path = tmp_path / "lengths.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return sp.read_measurements(path)


@pytest.mark.ci
def test_columns_of_ends_and_their_units(tmp_path):
    """L over λc; the machine's stiffness over the width of the block, and M/K that over E, whatever λc."""
    more = "block_length_mm,machine_stiffness_N_per_m,block_width_mm"
    m = read(tmp_path, f"{HEADER},{more}", "25,100,0.3,3,20,0.5,100,6e7,10", "25,100,0.3,3,20,0.5,,,")
    np.testing.assert_allclose(m.block_length, [1000, np.nan])
    np.testing.assert_allclose(m.machine_stiffness, [6e9, np.nan])
    inputs = sp.fit(m, intervals="profile").parameters.inputs.at(np.zeros(1))
    np.testing.assert_allclose(np.exp(inputs.get("log_machine")), [2, np.inf])
    np.testing.assert_allclose(np.exp(inputs.get("log_sites")), [1000, np.inf])
    plain = read(tmp_path, "height,poisson,length,length_sigma,block_length,machine_stiffness", "25,0.3,20,0.5,100,2")
    assert (plain.block_length, plain.machine_stiffness) == (100, 2)


@pytest.mark.parametrize(
    ("columns", "cells", "message"),
    [
        ("block_length_mm", "15", "column length_mm: 20: longer than the block"),
        ("block_length_mm", "0.1", "column block_length_mm: 0.1: a block must be at least two"),
        ("block_length", "100", "columns of both forms"),
        ("block_length_in", "0.1", "numbers in in are not read: convert them, for block_length_mm"),
        ("machine_stiffness_N_per_m", "1e7", "needs the column block_width_mm"),
        ("machine_stiffness_N_per_m,block_width_mm", "1e7,", "column block_width_mm: missing value"),
        ("machine_stiffness_N_per_m,block_width_mm", "-1,10", "the stiffness of a machine must be positive"),
        (
            "machine_stiffness_N_per_mm,block_width_mm",
            "1,10",
            "numbers in N_per_mm are not read: convert them, for machine_stiffness_N_per_m",
        ),
    ],
)
def test_bad_ends_are_named_by_line_and_column(tmp_path, columns, cells, message):
    with pytest.raises(MeasurementError, match=message):
        read(tmp_path, f"{HEADER},{columns}", f"25,100,0.3,3,20,0.5,{cells}")


def test_what_takes_no_ends_refuses_them():
    m = measured(dense_lengths(), block_length=LENGTH)
    with pytest.raises(MeasurementError, match="recover_profile takes blocks without end"):
        sp.recover_profile(m, stiffness=TRUTH)
    with pytest.raises(MeasurementError, match="machine_stiffness is given without young"):
        sp.Measurements(25.0, 0.3, 20.0, 0.5, correlation_length=1e-4, machine_stiffness=1e9)


@pytest.mark.ci
def test_the_report_says_what_an_unstated_end_and_machine_would_move():
    """As full fits of the table with both stated; nothing where they are stated."""
    height = np.array([30.0, 40.0, 50.0])
    length = sp.exact_lengths(sp.Slider(height, 0.004, 0.3))
    plain = sp.Measurements(height=height, poisson=0.3, length=length, length_sigma=0.01 * length)
    found = sp.fit(plain, intervals="profile")
    decay = found.regime.slow_decay_length
    given = {"block_length": 4 * decay, "machine_stiffness": found.regime.edge_stiffness}
    for name, column in given.items():
        again = sp.fit(dataclasses.replace(plain, **{name: column}), intervals="profile")
        moved = np.log(again.values["stiffness"] / found.values["stiffness"])
        assert moves(found)[name]["stiffness"] == pytest.approx(moved, rel=0.02)
    assert -0.05 < moves(found)["block_length"]["stiffness"] < 0
    assert -2 < moves(found)["machine_stiffness"]["stiffness"] < -0.5
    report = found.report()
    longest = f"the tallest block longer than {float(f'{4 * decay.max():.2g}'):g} λc."
    assert f"the edge held still during the event, and {longest}" in unfolded(report)
    assert "; blocks must be longer than 4/κ₂ = " in found.report(verbose=True)
    moved = np.exp(moves(found)["machine_stiffness"]["stiffness"])
    assert re.search(rf"\n  a machine as stiff as the block +× {moved:.2g}\n  a machine a third as stiff.* (× 0|none)", report)
    stated = {"block_length": 2 * decay, "machine_stiffness": 100.0, "provenance": ("synthetic",) * 3}
    known = sp.fit(dataclasses.replace(plain, **stated), intervals="profile")
    assert not {"block_length", "machine_stiffness", "model_factor"} & moves(known).keys()
    report = known.report(verbose=True)
    assert "3 of 3 blocks are shorter than 4/κ₂ (the shortest " in report
    assert "block with a free end pushed through a spring (continuous length)" in report
    dense = dense_chain.chain_matrix(40.0, 0.004, 0.3, 400)
    pushed = np.linalg.solve(dense, np.eye(800)[0])
    force = 40.0 * (pushed[0] - pushed[1]) + (pushed[0] - pushed[400]) / (2.6 * 40)
    assert force == pytest.approx(FirstFront().regime(Inputs.of([40.0], 0.004, 0.3)).edge_stiffness[0], rel=0.03)


@pytest.mark.ci
@pytest.mark.filterwarnings("ignore:the lengths are about 3.34 times")
def test_fronts_that_ran_through_blocks_taken_as_endless_are_a_misfit():
    """Far beyond the longest length of the model, by counts without error: no number, and no failure of the search."""
    data = sp.Measurements(
        height=[52.88447582, 33.81130519, 32.6610521],
        poisson=0.3,
        length=[77.52355522, 113.0, 109.0],
        length_sigma=[1.58070834, 0.0, 0.0],
        kind=["length", "at_least", "at_least"],
    )
    found = sp.fit(data, intervals="profile")
    assert found.deviance > 1e6
    assert found.stderrs["stiffness"] is None


def test_what_never_stops_alone_does_not_stop_under_ends_either():
    """By a prestress or falling thresholds; and whatever else is computed with it."""
    rng = np.random.default_rng(0)
    height, ratio, prestress = rng.uniform(10, 60, 60), 10 ** rng.uniform(-3, -1, 60), rng.uniform(0, 0.9, 60)
    slope = np.where(rng.random(60) < 0.5, -rng.uniform(0, 0.01, 60), 0.0)
    machine = rng.uniform(np.log(1e-2), np.log(10.0), 60)
    alone = Inputs.of(height, ratio, 0.3, prestress)._replace(threshold_slope=slope)
    ended = alone.given(log_sites=np.log(np.where(rng.random(60) < 0.3, 3 * height, np.inf)), log_machine=machine)
    front = FirstFront()
    length, found = front.lengths(alone), front.lengths(ended)
    assert (np.isinf(length) & (prestress < 0.5)).sum() > 5
    assert np.isinf(found[np.isinf(length)]).all()
    assert np.isfinite(found).sum() > 10
    np.testing.assert_array_equal(np.concatenate([front.lengths(ended.take([i])) for i in range(60)]), found)
    along = np.eye(len(ended.names))[np.ones(60, int)]
    np.testing.assert_allclose(front.evaluate(ended, along)[0], found, rtol=1e-9)
