"""Fits whose body is a block under two-dimensional elasticity, pushed at a height."""

import dataclasses
import importlib.util
import json
import re
import sys
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from reports import moves, section, unfolded

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.blocks.size import tall_length
from slippulse_jax.cli.fit import command
from slippulse_jax.cli.length import command as length_command
from slippulse_jax.inference.model import family
from slippulse_jax.inference.model.block import BlockEvent
from slippulse_jax.inference.model.family import Families, geometry_of
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.result.record import as_request, from_request
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.theory import block_decay_length

ROOT = Path(__file__).resolve().parents[2]
HEIGHT = np.array([300.0, 400.0, 520.0, 700.0, 900.0])


def inputs_of(height, b, push, poisson=0.3, width=np.inf, force=0.0):
    height, b, push = np.broadcast_arrays(height, b, push)
    plain = Inputs.of(height, b / (2 * (1 + poisson) * height), poisson)
    return plain.given(log_push=np.log(push), log_push_width=np.log(width) + 0 * push, push_force=force + 0 * push)


def stiffness_at(b):
    """k/K of contacts that have this b in the middle of the heights."""
    return b / (2.6 * float(np.median(HEIGHT)))


@pytest.fixture(scope="module")
def study():
    """Lengths without scatter above a quarter of each height, by the cascade on ever coarser blocks, and their k/K."""
    stiffness = stiffness_at(0.8)
    length = np.array([float(sp.precursor_length(sp.Block(h, stiffness, 0.3), sites=None, event="full")) for h in HEIGHT])
    return stiffness, sp.Measurements(
        height=HEIGHT, poisson=0.3, length=length, length_sigma=0.02 * length, push_height=0.25 * HEIGHT
    )


@pytest.fixture(scope="module")
def fitted(study):
    return sp.fit(study[1])


# --- lengths ------------------------------------------------------------------------------------------------------------


@pytest.mark.ci
@pytest.mark.parametrize(("b", "push"), [(0.1, 0.25), (1.0, 0.5), (8.0, 0.25)])
def test_coarser_blocks_have_the_length_to_the_error_they_state(b, push):
    """Against every contact of the block, as many as it has."""
    block = sp.Block(350.0, b / (2.6 * 350), 0.3, sp.Push(push))
    found, off = map(float, tall_length(block, None, "full"))
    assert found == pytest.approx(float(sp.precursor_length(block, sites=1024, event="full")), abs=max(off, 0.002 * found))
    assert off < 0.02 * found


@pytest.mark.slow
def test_derivatives_of_a_tall_block_at_a_fixed_order_of_breaks():
    def length(height, stiffness):
        return sp.precursor_length(sp.Block(height, stiffness, 0.3, sp.Push(0.3)))

    at, step = (800.0, 1 / (2.6 * 800)), 1e-6
    found = jax.grad(length, (0, 1))(*at)
    for i in (0, 1):
        up, down = (float(length(*(x * (1 + side * step * (i == j)) for j, x in enumerate(at)))) for side in (1, -1))
        assert float(found[i]) == pytest.approx((up - down) / (2 * step * at[i]), rel=1e-5)


@pytest.mark.ci
def test_a_length_varies_as_the_inverse_of_the_number_of_contacts():
    """What the extrapolation rests on: halving the contacts' size twice halves the change."""
    lengths = [float(sp.precursor_length(sp.Block(h, 1 / (2.6 * h), 0.3), sites=256)) / h for h in (50.0, 100.0, 200.0)]
    assert (lengths[1] - lengths[0]) / (lengths[2] - lengths[1]) == pytest.approx(2, rel=0.15)


@pytest.mark.ci
def test_lengths_of_a_fit_are_those_of_the_cascade():
    rng = np.random.default_rng(3)
    height, b = rng.uniform(250, 3000, 6), np.exp(rng.uniform(np.log(0.05), np.log(3), 6))
    push = rng.uniform(0.25, 0.5, 6)
    found, off = Families()(inputs_of(height, b, push))
    for i in range(6):
        block = sp.Block(height[i], b[i] / (2.6 * height[i]), 0.3, sp.Push(push[i]))
        assert found[i] == pytest.approx(float(tall_length(block, None, "full")[0]), rel=0.005)
    assert np.all(off < 0.01 * found)


@pytest.mark.slow
def test_blocks_followed_from_measured_ones_have_the_length_of_the_cascade():
    """At every b near a measured length; and of blocks that differ in all that may have an error: to what mixed errors leave."""
    rng, n = np.random.default_rng(5), 8
    height = rng.uniform(300, 2000, n)
    measured = inputs_of(height, 1.0, np.resize([0.25, 0.4], n), width=np.resize([np.inf, 0.1], n))
    ratio = Families()(measured)[0] / height
    followed = Families().add(geometry_of(measured), ratio)
    assert len(followed.measured) == 2
    b = np.exp(rng.uniform(-1, 1, n))
    near = measured._replace(log_stiffness=measured.log_stiffness + np.log(b))
    found, off = followed(near)
    np.testing.assert_allclose(found, Families()(near)[0], rtol=0.006)
    assert np.all(off < 0.01 * found)
    moved = near._replace(poisson=near.poisson - 0.03, log_height=near.log_height + np.log(1.5))
    moved = moved.given(log_push=moved.get("log_push") + 0.05, log_push_width=moved.get("log_push_width") + 0.1)
    expected = Families()(moved)[0]
    assert np.all(np.abs(expected / found / 1.5 - 1) > 0.01)
    np.testing.assert_allclose(followed(moved)[0], expected, rtol=0.015)
    pressed = near._replace(prestress=near.prestress + 0.25)
    np.testing.assert_allclose(followed(pressed)[0], Families()(pressed)[0], rtol=0.02)


def test_a_measured_block_is_followed_the_same_whatever_was_followed_before():
    measured = inputs_of([100.0], 1.0, 0.3)
    geometry = geometry_of(measured)
    alone, events = Families().add(geometry, np.array([0.8]))(measured)[0], family.Events()
    Families(events).add(geometry, np.array([0.75]))(measured)  # puts nodes elsewhere
    assert Families(events).add(geometry, np.array([0.8]))(measured)[0] == alone


@pytest.mark.ci
def test_tried_blocks_take_fewer_events_for_the_same_lengths():
    """Within the steps of a length, up to where it falls: for what another block would make of a fit."""
    b = np.exp(np.linspace(-1.5, 3.5, 40))
    found, nodes = [], []
    for tried in (False, True):
        followed = Families(tried=tried).add(geometry_of(inputs_of([100.0], 1.0, 0.3)), np.array([0.8]))
        found.append(followed(inputs_of([100.0], b, 0.3))[0] / 100)
        nodes.append(followed.measured[0].nodes)
    np.testing.assert_allclose(found[1], found[0], rtol=0.01)
    assert nodes[1] < nodes[0]
    assert [int(np.diff(sorted(every)).min()) for every in nodes] == [1, family.BESIDE]  # next to a fall


@pytest.mark.ci
def test_blocks_far_from_measured_ones_have_no_other_kind_of_length():
    """Pushed half as high again, up to b where events stop early: within those of every such block, and where it stops early."""
    measured = inputs_of([200.0], 1.0, 0.3)
    b = np.exp(np.linspace(-2, 6.5, 60))
    moved = inputs_of([200.0], b, 0.45)
    found = Families().add(geometry_of(measured), Families()(measured)[0] / 200)(moved)[0]
    expected = Families()(moved)[0]
    long = expected > 0.3 * expected.max()
    assert found.max() < 1.05 * expected.max()
    last = np.exp(2 * family.WIDEST * family.UNIT)  # node before those at which events stop early
    np.testing.assert_allclose(found[long & (b < last)], expected[long & (b < last)], rtol=0.04)
    np.testing.assert_allclose(found[long & (b < 20)], expected[long & (b < 20)], rtol=0.06)


@pytest.mark.ci
def test_soft_blocks_have_no_precursor():
    """Below b = 0.01 or so the neighbour of the first contact stays below its threshold, however fine the contacts."""
    found, _ = Families()(inputs_of([400.0, 4000.0], [0.004, 0.004], 0.25))
    assert np.all(found < 0.01 * np.array([400, 4000]))
    for height in (400.0, 4000.0):
        lengths = [
            float(sp.precursor_length(sp.Block(height, b / (2.6 * height), 0.3), sites=1024, event="full"))
            for b in (0.0117, 0.0134)
        ]
        assert lengths[1] > 3 * lengths[0]


def at_prestress(height, b, push, prestress):
    return sp.Block(height, b / (2.6 * height), 0.3, sp.Push(push)), sp.Interface(prestress)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("b", "push", "prestress", "known"),
    # every contact of a block of H/λc = 5000; of 3000; the limit by 240 and 480
    [(10.0, 0.1, 0.4, 1.2064), (1.0, 0.1, 0.55, 1.6654), (1.0, 0.1, 0.53, 1.07)],
)
def test_prestressed_tall_blocks_have_the_length_of_every_contact(b, push, prestress, known):
    """Known values followed every contact, up to 8192."""
    found, off = tall_length(*at_prestress(5000.0, b, push, prestress), "full")
    assert float(found) / 5000 == pytest.approx(known, rel=0.025)
    assert float(off) < 0.03 * float(found)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("b", "prestress"),
    [(1.0, 0.56), *(pytest.param(10.0, phi, marks=pytest.mark.slow) for phi in (0.5, 0.8, 0.53, 0.6))],
)
def test_tall_blocks_whose_event_does_not_stop_are_refused(b, prestress):
    """Coarser contacts would stop it: after 3.9, 2.1, 2.9, 0 and 1.4 heights."""
    with pytest.raises(ValueError, match=r"the event of Block\(height=5000.* farther than can be followed; .* may never stop"):
        sp.precursor_length(*at_prestress(5000.0, b, 0.1, prestress))


def test_a_tall_block_on_falling_thresholds_is_refused():
    """Its length was NaN."""
    block, _ = at_prestress(5000.0, 1.0, 0.1, 0.0)
    with pytest.raises(ValueError, match="reaches beyond 16 heights, farther .* falling thresholds"):
        sp.precursor_length(block, sp.Interface(0.0, -1e-4))


@pytest.mark.slow
@pytest.mark.parametrize(("height", "b", "prestress"), [(30.0, 10.0, 0.6), (20.0, 10.0, 0.7), (120.0, 1.0, 0.56)])
def test_short_blocks_run_away_where_tall_ones_do(height, b, prestress):
    """By contacts of their own; the taller, the sooner."""
    block, interface = at_prestress(height, b, 0.1, prestress)
    with pytest.raises(ValueError, match=r"reaches beyond (4096|8192) contacts, farther than can be followed"):
        sp.precursor_length(block, interface)
    with pytest.raises(ValueError, match="farther than can be followed"):
        tall_length(block, interface, "full")


@pytest.mark.slow
def test_events_that_do_not_stop_are_inf_in_bulk():
    interface = {"poisson": 0.3, "push_height": 0.1, "prestress": [0.3, 0.6]}
    found = sp.sweep(height=[30.0, 5000.0], stiffness=0.1, **interface, outputs="block_precursor_length")
    assert np.isinf(found.block_precursor_length.sel(prestress=0.6)).all()
    assert np.isfinite(found.block_precursor_length.sel(prestress=0.3)).all()


def test_a_fit_of_lengths_where_no_event_stops():
    m = sp.Measurements(
        height=[30.0, 40.0], poisson=0.3, length=[20.0, 30.0], length_sigma=0.5, push_height=[3.0, 4.0], prestress=0.8
    )
    with pytest.raises(ValueError, match="the front never stops anywhere in the range searched"):
        sp.fit(m, bounds=(0.02, 0.03))
    inputs = inputs_of([30.0, 40.0], 2.0, 0.1)._replace(prestress=np.array([0.8, 0.8]))
    assert np.isinf(Families()(inputs)[0]).all()
    assert (BlockEvent().status(inputs) == Outcome.RUN_AWAY).all()


@pytest.mark.slow
def test_an_event_that_runs_through_a_block_is_not_one_that_never_stops():
    inputs = inputs_of([30.0, 30.0], [2.0, 2.0], 0.4)
    found = BlockEvent().status(inputs.given(log_sites=np.log([30.0, np.inf])))
    assert found.tolist() == [Outcome.RAN_THROUGH, Outcome.ARRESTED]


@pytest.mark.parametrize(("b", "decay"), [(0.1, 5.193), (0.3, 3.105), (1, 1.896), (3, 1.373), (10, 1.140), (1e9, 1.027)])
def test_decay_of_an_edge_load(b, decay):
    """Values of a separate program."""
    assert float(block_decay_length(b, 0.3)) == pytest.approx(decay, abs=6e-4)


# --- fits ---------------------------------------------------------------------------------------------------------------


@pytest.mark.ci
def test_a_table_that_says_where_it_is_pushed_is_fitted_as_a_block(study, fitted):
    stiffness, m = study
    assert fitted.parameters.front.body == "block"
    assert fitted.identifiability is Identifiability.IDENTIFIED
    assert fitted.values["stiffness"] == pytest.approx(stiffness, rel=0.02)
    (piece,) = fitted.intervals["stiffness"][0.95]
    assert piece.low < stiffness < piece.high
    slider = sp.fit(m, body="slider")
    moved = np.exp(moves(fitted)["slider"]["stiffness"])
    assert moved == pytest.approx(slider.values["stiffness"] / fitted.values["stiffness"], rel=1e-6)
    report = fitted.report()
    assert "block under two-dimensional elasticity" in unfolded(report)
    rows = section(report, "What else would move it")
    (row,) = [row for row in rows if row.startswith("  the paper's slider")]
    assert float(row.split()[-2]) == pytest.approx(
        100 * (slider.values["stiffness"] / fitted.values["stiffness"] - 1), abs=0.06
    )
    assert any(row.startswith("  height of the push larger by 5 %") for row in rows)


@pytest.mark.ci
def test_where_the_side_is_pushed_decides(study):
    """The same lengths, pushed higher up, are those of a much softer interface; the slider does not know."""
    stiffness, m = study
    higher = sp.fit(dataclasses.replace(m, push_height=0.5 * HEIGHT))
    assert higher.values["stiffness"] < 0.2 * stiffness
    slider = sp.fit(m, body="slider")
    assert "slider" not in moves(slider)
    moved = np.exp(moves(higher)["slider"]["stiffness"])
    assert slider.values["stiffness"] == pytest.approx(higher.values["stiffness"] * moved, rel=1e-6)


@pytest.mark.ci
def test_an_error_of_the_height_of_the_push_is_fitted_beside(study, fitted):
    _, m = study
    found = sp.fit(dataclasses.replace(m, push_height_sigma=0.02 * m.push_height))
    assert len([name for name in found.inputs if name.startswith("push_height")]) == len(HEIGHT)
    assert found.stderrs["stiffness"] > fitted.stderrs["stiffness"]
    assert moves(fitted)["push_height"]["stiffness"] < 0  # a higher push makes longer fronts, so the interface must be softer


@pytest.mark.ci
def test_the_command_reads_it_and_a_request_repeats_it(study, tmp_path):
    _, m = study
    table = tmp_path / "lengths.csv"
    rows = [f"{h * 0.05:.9g},50,0.3,3.0,{x * 0.05:.9g},{s * 0.05:.9g},{h * 0.0125:.9g},displacement" for h, x, s in
            zip(m.height, m.length, m.sigma, strict=True)]  # fmt: skip
    head = "height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm,push_height_mm,push_control"
    table.write_text("\n".join([head, *rows]))
    found = CliRunner().invoke(command, [str(table), "--json"])
    assert found.exit_code == 0, found.output
    content = json.loads(found.stdout)
    assert content["model"]["body"] == "block"
    assert "body" not in content["request"]  # it was not asked for
    assert "slider" in {one["name"] for one in content["changes"]}
    again = sp.fit(sp.read_measurements(table), **from_request(content["request"]))
    assert again.values["areal_stiffness"] == pytest.approx(content["values"]["areal_stiffness"], rel=1e-12)
    assert as_request(again.request) == content["request"]
    slider = CliRunner().invoke(command, [str(table), "--body", "slider", "--verbose"])
    assert "semi-infinite slider" in slider.stdout


@pytest.mark.ci
def test_interpolated_lengths_that_bend_are_not_at_their_maximum():
    """Two blocks far below the longest lengths, each with a modulus of its own: the curvature is that of the interpolation."""
    height, sigma = np.repeat([2400.0, 6000], 4), np.repeat([40.0, 150], 4)
    known = {"correlation_length": 1e-5, "young": 3.3e9, "young_sigma": 2e8, "specimen": ("A",) * 4 + ("B",) * 4}
    push = {"push_height": height / 4, "length": [1420.0, 1440, 1410, 1380, 4780, 4700, 4860, 5040], "length_sigma": sigma}
    result = sp.fit(sp.Measurements(height=height, poisson=0.37, **known, **push))
    assert (result.fitted < 0.9 * result.attainable).all()
    assert result.identifiability is Identifiability.IDENTIFIED


@pytest.mark.ci
def test_budget_of_a_block_is_that_of_fits_with_the_input_moved():
    """Of the height of the push, beside an offset and a model factor."""
    height = np.array([1500.0, 2500, 4000, 6000])
    known = {"correlation_length": 1e-5, "young": 3.3e9, "length_sigma": [50.0, 50, 60, 80], "provenance": ("measured",) * 4}
    m = sp.Measurements(height=height, poisson=0.37, length=[800.0, 1630, 3120, 5200], push_height=height / 4, **known)
    result = sp.fit(m)
    assert "threshold_scatter" not in result.parameters.names  # as there are too many contacts
    moved = np.log(sp.fit(dataclasses.replace(m, push_height=1.05 * m.push_height)).values["areal_stiffness"])
    moved -= np.log(result.values["areal_stiffness"])
    assert moves(result)["push_height"]["areal_stiffness"] == pytest.approx(moved, abs=0.015)  # 0.3 % of a length
    assert abs(moved) > 0.05


@pytest.mark.ci
def test_what_follows_a_fit_of_a_block(study, fitted):
    """Refits and designs are of blocks; samples by NUTS and cracks are not, and say so."""
    compared = sp.pulse_or_crack(study[1], simulations=20)
    assert compared.pulse.parameters.front.body == compared.crack.parameters.front.body == "slider"
    drawn = fitted.bootstrap(20)
    relative = fitted.stderrs["stiffness"] / fitted.values["stiffness"]
    assert float(np.std(drawn.theta[:, 0])) == pytest.approx(relative, rel=0.6)
    assert sp.plot.fit(fitted).axes
    known = sp.Knowledge.from_fit(fitted)
    assert known.log_sd == pytest.approx(relative, rel=0.05)
    with pytest.raises(ValueError, match="from measurements of a block, the candidates are sliders"):
        sp.design(known, height=400, sigma=5.0)


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({"push_height": 1.2 * HEIGHT}, {}, r"measurement 0, column push_height: 360 λc: not below the height of the block"),
        ({"push_width": 2 * HEIGHT}, {}, r"column push_width: 600 λc: not less than the height of the block"),
        ({"push_width": 0.8 * HEIGHT}, {}, r"column push_width: 240 λc: reaches beyond the side of the block"),
        ({"push_height": 0 * HEIGHT}, {}, r"column push_height: 0 λc: the push must lie above the interface"),
        ({"push_control": ("speed",) * 5}, {}, r"column push_control: 'speed': one of displacement, force"),
        ({"push_height": None, "push_width": 9.0}, {}, r"push_width is given without push_height"),
        ({"push_height": None}, {"body": "block"}, r"needs the height of the push: give push_height"),
        ({"push_height": [75, np.nan, 130, 175, 225]}, {"body": "block"}, r"measurement 1, column push_height: missing"),
        ({"machine_stiffness": 1.0}, {}, r"machine_stiffness beside push_height: a fit of a block takes one whose pusher is held"),
        ({"friction": -0.1}, {}, r"column friction: -0.1: must be 0 or more, and finite: the friction coefficient"),
        ({"push_height": None, "friction": 0.3}, {}, r"friction is given without push_height"),
        ({"contact_law": ("multicontact",) * 5}, {}, r"contact_law is given without friction"),
        ({"top": ("clamped",) * 5}, {}, r"column top: 'clamped': one of free, held"),
        ({}, {"free": ["stiffness", "friction"]}, r"parameter friction: the measurements state no friction to start from"),
        ({"threshold_slope": 1e-4}, {}, r"threshold_slope: a fit of a block takes level thresholds"),
        pytest.param({}, {"body": "block", "event": "domino"}, r"so its length is that of the whole event: 'full'", marks=pytest.mark.ci),
        ({}, {"body": "brick"}, r"body = 'brick': must be one of 'slider', 'block'"),
    ],
)  # fmt: skip
def test_refusals(changes, options, message):
    m = sp.Measurements(height=HEIGHT, poisson=0.3, length=0.7 * HEIGHT, length_sigma=5, push_height=0.25 * HEIGHT)
    with pytest.raises(ValueError, match=message):
        sp.fit(dataclasses.replace(m, **changes), **options)


@pytest.mark.ci
def test_the_command_has_lengths_of_blocks():
    given = ["--height", "60", "--stiffness", "0.006", "--poisson", "0.3", "--push-height", "0.5"]
    found = CliRunner().invoke(length_command, [*given, "--json"])
    assert found.exit_code == 0, found.output
    content = json.loads(found.stdout)
    assert content["length"] == pytest.approx(float(sp.precursor_length(sp.Block(60.0, 0.006, 0.3, sp.Push(0.5)))), rel=1e-12)
    assert content["length_of_slider"] == pytest.approx(float(sp.exact_length(sp.Slider(60.0, 0.006, 0.3))), rel=1e-12)
    text = CliRunner().invoke(length_command, [*given, "--push-width", "0.1"]).stdout
    assert "pushed over 0.1 H about 0.5 H, displacement held" in text
    on_springs = [*given, "--normal-stiffness", "2", "--top", "held"]
    content = json.loads(CliRunner().invoke(length_command, [*on_springs, "--json"]).stdout)
    assert (content["normal_stiffness"], content["friction"], content["top"]) == (2, None, "held")
    assert "displacement held; k_n/k = 2\n" in CliRunner().invoke(length_command, on_springs).stdout
    for more, message in [(["--sites", "30"], "are a slider's"), (["--push-width", "1.4"], "must lie in (0, 1)")]:
        refused = CliRunner().invoke(length_command, [*given, *more])
        assert refused.exit_code == 2
        assert message in refused.output


@pytest.mark.slow
def test_lengths_by_finite_elements_that_share_no_code_with_the_package():
    """The program of `fit_examples/independent_block.py`, whose mesh leaves 0.03 %: within 0.1 %, with friction and without."""
    spec = importlib.util.spec_from_file_location("independent_block", ROOT / "fit_examples/independent_block.py")
    assert spec is not None
    assert spec.loader is not None
    program = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(program)
    for height, low, high, b, normal, every in [
        (24, 0.25, 1.0, 1.0, 1.2, (0.0, 0.1, 0.25)), (40, 0.2, 0.3, 1.0, 1.2, (0.0, 0.25)), (48, 0.1, 1.0, 0.3, 1.2, (0.0, 0.1)),
        (32, 0.3, 1.0, 0.5, None, (0.0,)),
    ]:  # fmt: skip
        push = sp.Push(low) if high == 1 else sp.Push((low + high) / 2, high - low)
        found = program.responses(height, 3 * height, low * height, high * height, b / (2.6 * height), 0.3, normal)
        for friction in every:
            pressed = {"friction": friction, "normal_stiffness": normal} if normal else {}
            block = sp.Block(float(height), b / (2.6 * height), 0.3, push, length=3 * height, **pressed)
            expected = program.precursor(*found, friction)
            assert float(sp.precursor_length(block, event="full")) == pytest.approx(expected, rel=1e-3)


@pytest.mark.ci
def test_counts_and_run_throughs_of_blocks(study):
    stiffness, m = study
    whole = dataclasses.replace(m, length=np.ceil(m.length), length_sigma=0 * m.length, kind=("whole",) * 5)
    counted = sp.fit(whole)
    (piece,) = counted.intervals["stiffness"][0.95]
    assert piece.low < stiffness < piece.high < 1.03 * piece.low
    past = dataclasses.replace(m, length=[*m.length[:4], 0.5 * m.length[4]], kind=("length",) * 4 + ("at_least",),
                               length_sigma=[*m.sigma[:4], 0])  # fmt: skip
    assert sp.fit(past).values["stiffness"] == pytest.approx(stiffness, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("control", ["displacement", "force"])
def test_a_push_on_a_patch_is_fitted_as_one(control):
    """A force that is held lets a contact inside break first, and its lengths say little of the stiffness."""
    height, stiffness = np.array([300.0, 520.0]), 0.8 / (2.6 * 400)
    push = sp.Push(0.25, 0.1, control)
    length = np.array([float(sp.precursor_length(sp.Block(h, stiffness, 0.3, push), event="full")) for h in height])
    m = sp.Measurements(height=height, poisson=0.3, length=length, length_sigma=0.02 * length, push_height=0.25 * height,
                        push_width=0.1 * height, push_control=(control,) * 2)  # fmt: skip
    found = sp.fit(m, bounds=(stiffness / 1.5, stiffness * 1.5))
    assert found.fitted[0] == pytest.approx(length[0], rel=0.01)
    if control == "displacement":
        assert found.values["stiffness"] == pytest.approx(stiffness, rel=0.03)
        assert found.identifiability is Identifiability.IDENTIFIED
    else:
        assert found.identifiability is not Identifiability.IDENTIFIED


@pytest.mark.ci
def test_one_block_pushed_at_several_heights_is_drawn_against_them():
    block = [sp.Block(400.0, 7e-4, 0.3, sp.Push(push)) for push in (0.25, 0.35, 0.5)]
    length = np.array([float(sp.precursor_length(one, event="full")) for one in block])
    m = sp.Measurements(height=400, poisson=0.3, length=length, length_sigma=0.02 * length, push_height=[100, 140, 200])
    lengths, stiffness, residuals = sp.plot.fit(sp.fit(m)).axes
    assert residuals.get_xlabel() == r"height of the push, $h/\lambda_c$"
    assert sum("best fit" in text.get_text() for text in lengths.get_legend().get_texts()) == 1
    assert [text.get_text() for text in stiffness.get_legend().get_texts()][:3] == [
        rf"$h/\lambda_c$ = {h}" for h in (100, 140, 200)
    ]


def test_a_machine_beside_a_push_is_refused_by_the_names_of_its_columns():
    """It says what to do: no other body is recommended, since the slider would give another stiffness."""
    table = pd.read_csv(ROOT / "fit_examples/pmma_block/lengths.csv")
    table = table.assign(machine_stiffness_N_per_m=1e9, block_width_mm=10.0, push_height_mm=5.0)
    with pytest.raises(ValueError, match="machine_stiffness_N_per_m beside push_height_mm") as refused:
        sp.fit(table)
    assert "slider" not in str(refused.value)
    assert "leave it out. The stiffness is then too large" in str(refused.value)


# --- progress -----------------------------------------------------------------------------------------------------------


def test_events_are_announced_at_once_and_counted_one_by_one(capsys, monkeypatch):
    """By one line on a stderr that is no terminal, by a bar on one."""
    monkeypatch.setattr(family, "workers", lambda: 1)
    monkeypatch.setattr(family, "FEW", 2)
    events, three = family.Events(), [["a"], ["b", "c"], ["d"]]
    parts = events.announced(three)
    assert next(parts) == [["a"]]
    assert capsys.readouterr() == ("", "following at least 4 events of blocks\n")
    assert list(parts) == [[["b", "c"]], [["d"]]]
    events.known["a key"] = family.Node(1.0)
    assert list(events.announced(three)) == [[part] for part in three]
    assert list(events.announced([])) == []
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with monkeypatch.context() as quick:
        quick.setattr(family, "tqdm", partial(family.tqdm, mininterval=0, miniters=1))
        shown = []
        for _ in events.announced(three):
            shown.append(capsys.readouterr().err)
    assert ["| 0/4 [" in shown[0], "| 1/4 [" in shown[1], "| 3/4 [" in shown[2]] == [True] * 3


@pytest.mark.parametrize("compiling", [0.0, 7.0, 300.0])
@pytest.mark.parametrize("pace", [0.001, 0.5, 20.0])
def test_a_time_that_is_announced_is_the_one_that_comes(capsys, monkeypatch, compiling, pace):
    """By a clock of the test's own: from the events before, without what was compiled, and only where it is long."""
    clock = [0.0]
    monkeypatch.setattr(family, "workers", lambda: 2)
    monkeypatch.setattr(family.time, "monotonic", lambda: clock[0])
    events = family.Events()
    for call in range(3):
        said = {}
        for number, some in enumerate(events.announced([["key"] * 8] * 6)):
            said.update((clock[0], text) for text in capsys.readouterr().err.splitlines() if "about" in text)
            clock[0] += pace * sum(map(len, some)) + compiling * (number == call == 0)
        events.known["a key"] = family.Node(1.0)
        assert len(said) == (pace * (16 if call == 0 else 48) > family.LONG)
        for begun, text in said.items():
            assert float(re.search(r"about (\d+) s$", text)[1]) == pytest.approx(clock[0] - begun, abs=0.51)


# --- pressure ------------------------------------------------------------------------------------------------------------


def of_pressed(stiffness=4e-3, ratio=None, **given):
    """Lengths of blocks with friction on their own contacts, with errors of 2 %, as a table."""
    rows = [(h, at) for h in (40.0, 60.0, 80.0) for at in (0.15, 0.25)]
    height, push = np.array(rows).T
    law = {"contact_law": given.get("contact_law", "amontons"), "top": given.get("top", "free")}
    ends = [None if ratio is None else round(ratio * h) for h in height]
    blocks = [
        sp.Block(h, stiffness, 0.3, sp.Push(at, 0.1), length=end, friction=given["friction"], **law)
        for h, at, end in zip(height, push, ends, strict=True)
    ]
    length = np.array([float(sp.precursor_length(one, event="full")) for one in blocks])
    noise = np.random.default_rng(3).normal(size=len(length))
    columns = {name: (x,) * len(height) if isinstance(x, str) else x for name, x in given.items() if x is not None}
    return sp.Measurements(
        height=height, poisson=0.3, length=length * (1 + 0.02 * noise), length_sigma=0.02 * length, push_height=push * height,
        push_width=0.1 * height, block_length=None if ratio is None else ratio * height, **columns,
    )  # fmt: skip


@pytest.fixture(scope="module")
def with_friction():
    m = of_pressed(friction=0.25)
    return m, sp.fit(m)


@pytest.mark.slow
def test_a_fit_of_blocks_with_friction(with_friction):
    m, found = with_friction
    assert found.identifiability is Identifiability.IDENTIFIED
    (piece,) = found.intervals["stiffness"][0.95]
    assert piece.low < 4e-3 < piece.high
    assert "thresholds that follow the pressure" in unfolded(found.report())
    assert "μ = 0.25" in found.methods()
    assert 0.7 < np.exp(moves(found)["friction"]["stiffness"]) < 1.3  # μ larger by 10 %
    # without friction a length is that of contacts more than twice as stiff, and so is a fit of all
    moved = np.exp(moves(found)["pressure"]["stiffness"])
    ratio = found.fitted / m.height
    i = int(np.argsort(ratio)[len(ratio) // 2])
    block = sp.Block(
        m.height[i], moved * found.values["stiffness"], 0.3, sp.Push(m.push_height[i] / m.height[i], 0.1), normal_stiffness=1.2
    )
    assert float(sp.precursor_length(block, event="full")) == pytest.approx(found.fitted[i], rel=0.03)
    without = sp.fit(dataclasses.replace(m, friction=0.0))
    (other,) = without.intervals["stiffness"][0.95]
    assert other.low > 2 * piece.high * 0.9
    assert without.deviance > found.deviance + 4


@pytest.mark.slow
def test_a_fit_of_blocks_that_end():
    """Lengths followed are those of the block itself, pressure and end included, to what contacts of two sizes leave."""
    m = of_pressed(friction=0.25, ratio=3)
    found = sp.fit(m)
    (piece,) = found.intervals["stiffness"][0.95]
    assert piece.low < 4e-3 < piece.high
    assert "with the stated end" in unfolded(found.report())
    assert "guessed: k_n/k = 1.2, as no normal_stiffness is stated" in unfolded(found.report()).lower()
    moved = np.exp(next(one for one in found.changes if one.name == "normal_stiffness").moves["stiffness"])
    i = int(np.argsort(found.fitted / m.height)[len(m) // 2])
    for factor, normal in zip(moved, (1.0, 1.4), strict=True):
        block = sp.Block(m.height[i], factor * found.values["stiffness"], 0.3, sp.Push(m.push_height[i] / m.height[i], 0.1),
                         length=round(m.block_length[i]), friction=0.25, normal_stiffness=normal)  # fmt: skip
        assert float(sp.precursor_length(block, event="full")) == pytest.approx(found.fitted[i], rel=0.04)
    assert "block with a free end under two-dimensional elasticity" in unfolded(found.report(verbose=True))
    for i in (0, 3):
        push = sp.Push(m.push_height[i] / m.height[i], 0.1)
        block = sp.Block(m.height[i], found.values["stiffness"], 0.3, push, length=round(m.block_length[i]), friction=0.25)
        assert found.fitted[i] == pytest.approx(float(sp.precursor_length(block, event="full")), rel=0.03)


@pytest.mark.slow
def test_friction_with_an_error_is_fitted_beside(with_friction):
    m, exact = with_friction
    found = sp.fit(dataclasses.replace(m, friction_sigma=0.025))
    assert "friction[0.25]" in found.inputs
    (wide,), (narrow,) = (one.intervals["stiffness"][0.95] for one in (found, exact))
    assert wide.low < narrow.low < 4e-3 < wide.high
    assert wide.high - wide.low > narrow.high - narrow.low
    fitted = sp.fit(m, free=["stiffness", sp.Parameter("friction", prior=(0.3, 0.05))])
    assert fitted.parameters.named("friction").symbol == "μ"
    low, high = fitted.values["friction"] - 0.1, fitted.values["friction"] + 0.1
    assert low < 0.25 < high


@pytest.mark.ci
def test_lengths_over_friction_have_no_jump_and_are_those_of_the_blocks():
    """At every b, also where events are of another kind than the measured one; between blocks that are followed to 0.5 %."""
    log_b = np.linspace(np.log(0.02), np.log(200), 40)
    height = np.full(40, 50.0)
    ended = {"log_sites": np.log(3 * height), "log_normal_stiffness": np.full(40, np.log(1.2))}
    flags = {name: np.zeros(40) for name in ("multicontact", "top_held")}

    def at(friction):
        return inputs_of(height, np.exp(log_b), 0.25, width=0.1).given(**ended, **flags, friction=np.full(40, friction))

    followed = Families().add(geometry_of(at(0.3))[:1], np.array([0.8]), 50.0)
    length, (_, error) = followed(at(0.3))[0], followed(at(0.3))
    assert np.isfinite(length).any()
    falls = error > 1e-12  # elsewhere it is followed on its own contacts
    assert np.all(error[falls & np.isfinite(length)] < length.max() / 2)
    assert np.mean(falls & np.isfinite(length)) < 0.1
    for friction in (0.3 - 1e-7, 0.3 + 1e-7):
        np.testing.assert_allclose(followed(at(friction))[0], length, rtol=1e-3, atol=1e-3)
    i = int(np.argmin(np.abs(log_b)))
    for friction in (0.26, 0.28, 0.34):
        block = sp.Block(50.0, np.exp(log_b[i]) / 130, 0.3, sp.Push(0.25, 0.1), length=150, friction=friction)
        expected = float(sp.precursor_length(block, event="full"))
        assert followed(at(friction))[0][i] == pytest.approx(expected, rel=5e-3)


@pytest.mark.slow
def test_a_length_is_followed_to_where_it_falls():
    """At b = 1 and 0.5 a third of H falls to a contact or two at μ = 0.4025 and 0.3975; 0.0025 before, it is right to 2 %."""
    height, b = np.full(8, 60.0), np.repeat([1.0, 0.5], 4)
    ended = {"log_sites": np.log(3 * height), "log_normal_stiffness": np.full(8, np.log(1.2))}
    flags = {name: np.zeros(8) for name in ("multicontact", "top_held")}
    friction = np.array([0.385, 0.4, 0.405, 0.41, 0.38, 0.395, 0.4, 0.405])
    given = inputs_of(height, b, 0.2).given(**ended, **flags)
    followed = Families().add(geometry_of(given.given(friction=np.full(8, 0.39)))[:1], np.array([0.38]), 60.0)
    found = followed(given.given(friction=friction))[0]
    for i in range(8):
        block = sp.Block(60.0, b[i] / 156, 0.3, sp.Push(0.2), length=180, friction=friction[i])
        expected = float(sp.precursor_length(block, event="full"))
        assert (expected < 3) == (found[i] < 3) == (i % 4 > 1)
        if expected > 3:
            assert found[i] == pytest.approx(expected, rel=0.02)
    # between the two coefficients followed, it may be either, and says so
    part = np.array([0.0, 0.3, 0.5, 1.0])
    given = given.take(np.arange(4))
    (long, _), (short, _) = (followed(given.given(friction=np.full(4, side))) for side in (0.4, 0.4025))
    length, error = followed(given.given(friction=0.4 + 0.0025 * part))
    assert np.all(4 * short < long)
    np.testing.assert_allclose(length, (1 - part) * long + part * short, rtol=1e-9)
    np.testing.assert_allclose(error, np.sqrt(part * (1 - part)) * (long - short), atol=1e-5)


@pytest.mark.slow
def test_next_to_a_fall_a_length_says_that_it_may_be_either():
    """At μ = 0.4 a third of H falls to three contacts between b = 1.13 and 1.17."""
    log_b = np.arange(0.085, 0.2, 0.01)
    count = len(log_b)
    ended = {"log_sites": np.log(np.full(count, 180.0)), "log_normal_stiffness": np.full(count, np.log(1.2))}
    flags = {name: np.zeros(count) for name in ("multicontact", "top_held")}
    given = inputs_of(np.full(count, 60.0), np.exp(log_b), 0.2).given(**ended, **flags, friction=np.full(count, 0.4))
    length, error = Families().add(geometry_of(given)[:1], np.array([0.38]), 60.0)(given)
    unsure = error > 0.1
    assert unsure.sum() == 4  # a spacing of nodes, 0.04
    for i, stiffness in enumerate(np.exp(log_b) / 156):
        exact = float(sp.precursor_length(sp.Block(60.0, stiffness, 0.3, sp.Push(0.2), length=180, friction=0.4), event="full"))
        if unsure[i]:
            assert abs(length[i] - exact) < 2 * error[i]
        else:
            assert length[i] == pytest.approx(exact, rel=0.02 if exact > 3 else 0.1)


@pytest.mark.ci
def test_heights_of_pushes_may_share_their_error(study):
    _, m = study
    found = sp.fit(dataclasses.replace(m, push_height_sigma=0.02 * m.push_height))
    (step,) = [one for one in found.next_steps if "each push has its own error" in one]
    assert "leave push_height_sigma out" in step
    shared = sp.fit(m, free=["stiffness", sp.Parameter("push_height", prior=(m.push_height[0], 0.02 * m.push_height[0]))])
    assert shared.stderrs["stiffness"] > found.stderrs["stiffness"]


@pytest.mark.ci
@pytest.mark.slow
def test_a_fit_of_rough_contacts():
    """Of exact lengths; their errors of this seed pull the stiffness by two standard errors."""
    m = of_pressed(friction=0.25, contact_law="multicontact", ratio=2)
    found = sp.fit(dataclasses.replace(m, length=m.length_sigma / 0.02))
    assert found.values["stiffness"] == pytest.approx(4e-3, abs=0.3 * found.stderrs["stiffness"])


@pytest.mark.ci
def test_no_predicted_length_exceeds_the_longest_attainable():
    """Under friction a length may fall with stiffness from the softest on, so that the whole range must be looked at."""
    table = pd.DataFrame({"height_mm": [20.0, 40.0], "length_mm": [12.0, 29.0], "push_height_mm": 6.0})
    table = table.assign(
        push_width_mm=4.0, length_sigma_mm=1.0, poisson=0.36, correlation_length_um=200.0, young_GPa=3.2, friction=0.4
    )
    found = sp.fit(table)
    (stiffness,) = found.parameters.free
    theta = np.linspace(stiffness.low, stiffness.high, 200)[:, None]
    assert (np.array([found.problem.predict(one) for one in theta]).squeeze() <= found.attainable * (1 + 1e-9)).all()


def test_the_stated_block_is_tried_where_the_slider_is_fitted():
    """The largest systematic has its row whichever body was fitted."""
    table = pd.DataFrame({"height_mm": [20.0, 30.0], "length_mm": [16.1, 26.9], "push_height_mm": [5.0, 7.5]})
    table = table.assign(length_sigma_mm=0.4, poisson=0.3, correlation_length_um=20.0, young_GPa=3.0)
    slider, block = sp.fit(table, body="slider"), sp.fit(table)
    (row,) = (change for change in slider.changes if change.name == "block")
    factor = block.values["areal_stiffness"] / slider.values["areal_stiffness"]
    assert np.exp(row.moves["areal_stiffness"]) == pytest.approx([factor], rel=0.03)
    said = unfolded(slider.report())
    assert re.search(r"The block, pushed as the table states, would need 0\.7\d times this stiffness\.", said)
