"""Fits of contacts that differ: their density against draws of its own, the table of another program, and what is refused."""

import dataclasses
from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.bulk.kept import FOLDER
from slippulse_jax.inference.model import scattered
from slippulse_jax.inference.model.models import front_of
from slippulse_jax.inference.model.scattered import KERNEL
from slippulse_jax.inference.parameters import (
    checked,
    scatter_of_measured,
    wanted_parameters,
    where_contacts_differ,
    with_errors_of_measuring,
)
from slippulse_jax.inference.search.likelihood import OUTLIERS

TABLE = Path(__file__).resolve().parent / "tables" / "scattered_lengths.csv"
EXAMPLES = Path(__file__).resolve().parents[2] / "fit_examples"
BOTH = ["stiffness", "threshold_scatter"]


@cache
def fitted():
    return sp.fit(TABLE, BOTH)


@pytest.mark.ci
def test_the_table_of_another_program():
    """Thresholds that scatter by 5 %, and k = 3.846e10 Pa/m: both inside 95 %, with σ as given."""
    result = fitted()
    for name, true in (("areal_stiffness", 3.846e10), ("threshold_scatter", 0.05)):
        assert [one.encloses(true) for one in result.intervals[name][0.95]] == [True], name
        assert 0.6 < result.values[name] / true < 1.5
    np.testing.assert_array_equal(result.problem.by_row(lambda data: data.sigma), result.measurements.length_sigma)
    assert result.problem.parameters.front.event == "scattered"
    text = result.report()
    assert "each a draw" in text
    assert "Events are taken to be noticed from 1.5 to 5.2 mm on" in text
    assert "only if every run meets new contacts" in text
    half, alike = (next(line for line in text.splitlines() if what in line) for what in ("half of that extent", "are alike"))
    assert "×" in half
    assert "none fits" in alike
    assert "did not converge" not in text


@pytest.mark.ci
def test_a_saved_fit_is_the_same_fit(tmp_path, monkeypatch):
    monkeypatch.setattr(scattered.ScatteredEvent, "_draws", known_draws(fitted().problem.parameters.front))
    fitted().save(tmp_path / "fit.json")
    again = sp.load_fit(tmp_path / "fit.json")
    assert again.intervals == fitted().intervals
    np.testing.assert_allclose(again.problem(fitted().theta).value, fitted().problem(fitted().theta).value)


def known_draws(front):
    """Draws of a front that has them all, for another."""
    draw = scattered.ScatteredEvent._draws

    def of(self, nodes, wanted):
        self.known |= front.known
        return draw(self, nodes, wanted)

    return of


def small(height=(24.0, 32.0), length=(14.0, 9.0, 18.0), **more):
    """A table of low sliders, which are quick."""
    heights, lengths = np.repeat(height, len(length)), np.tile(length, len(height))
    return sp.Measurements(heights, 0.3, lengths, 0.3, visible=3.0, **more)


@cache
def problem():
    with jax.enable_x64(True):
        return sp.objective(small(), BOTH).problem


def directly(m, theta, draws=4000):
    """Deviance by draws at these very numbers: nothing is interpolated, and nothing shared but `sp.scattered`."""
    stiffness, scatter = np.exp(theta)
    total = 0.0
    for height in np.unique(m.height):
        slider = sp.Slider(height, stiffness, 0.3)
        with jax.enable_x64(True):
            found = sp.scattered(slider, threshold_scatter=scatter, visible=3.0, draws=draws, seed=5, sites=128)
        ends = np.asarray(found.length)
        low, high = np.quantile(ends, [0.16, 0.84])
        for value, sigma in zip(m.length[m.height == height], m.length_sigma[m.height == height], strict=True):
            kernel = KERNEL * (high - low) / 2  # with lengths drawn together, so that it leaves their spread
            near = ends.mean() + (ends - ends.mean()) * np.sqrt(max(1 - (kernel / ends.std()) ** 2, 0.7))
            wide = np.hypot(sigma, kernel)
            own = np.mean(np.exp(-(((near - value) / wide) ** 2) / 2)) / wide
            far = np.hypot(sigma, ends.mean())
            outlier = np.exp(-(((ends.mean() - value) / far) ** 2) / 2) / far
            total -= 2 * np.log(sigma * ((1 - OUTLIERS) * own + OUTLIERS * outlier))
    return total


POINTS = [(0.005, 0.05), (0.007, 0.08), (0.012, 0.1), (0.016, 0.12), (0.02, 0.14), (0.009, 0.12)]


@pytest.mark.ci
def test_the_density_is_that_of_draws_made_there():
    """To the noise of draws, wherever nodes lie, near the data: it is rough elsewhere, where few are worth it."""
    theta = np.log(np.array(POINTS))
    mine, direct = 2 * problem()(theta).value, [directly(small(), one) for one in theta]
    near = np.array(direct) < min(direct) + 8
    off = (mine - np.array(direct))[near]
    assert near.sum() >= 4
    assert np.abs(off).max() < 1.2
    assert off.std() < 0.6


@pytest.mark.ci
def test_other_seeds_change_the_density_little(monkeypatch):
    """By 0.3 in ln L at the best fit, the bound that was asked for."""
    monkeypatch.delenv(FOLDER, raising=False)  # where other fits would find these draws
    best = np.log(np.array([0.009, 0.1]))
    values = [problem()(best).value[0]]
    for salt in range(4):
        monkeypatch.setattr(scattered, "_seed", lambda node, salt=salt: hash((node, salt)) % 2**31)
        with jax.enable_x64(True):
            values.append(sp.objective(small(), BOTH).problem(best).value[0])
    assert np.std(values, ddof=1) < 0.3


@pytest.mark.ci
def test_the_objective_has_derivatives_and_maps():
    objective = sp.objective(small(), BOTH)
    with jax.enable_x64(True):
        at = {"stiffness": np.log(0.016), "threshold_scatter": np.log(0.061)}
        slope = jax.grad(lambda x: objective(at | {"stiffness": x}))(at["stiffness"])
        sides = [float(objective(at | {"stiffness": at["stiffness"] + h})) for h in (1e-5, -1e-5)]
        assert float(slope) == pytest.approx((sides[0] - sides[1]) / 2e-5, rel=1e-4)
        mapped = jax.jit(jax.vmap(lambda s: objective(at | {"threshold_scatter": s})))(np.log(np.array([0.03, 0.061])))
        assert float(mapped[1]) == pytest.approx(float(objective(at)), rel=1e-12)
        curved = jax.hessian(lambda s: objective(at | {"threshold_scatter": s}))(at["threshold_scatter"])
        assert np.isfinite(curved)
    best = objective.problem(np.array([[*at.values()]]), order=1)
    assert best.gradient[0, 0] == pytest.approx(float(slope), rel=1e-9)


@pytest.mark.ci
def test_lengths_of_kept_thresholds_are_one_draw():
    """Repeats of one surface tell its length better, and its scatter hardly."""
    new = small((32.0,), (27.0, 27.2, 26.8), specimen="A")
    kept = dataclasses.replace(new, thresholds=("kept",) * 3)
    with jax.enable_x64(True):
        scatters = np.linspace(0.01, 0.12, 12)
        theta = np.log(np.column_stack([np.full(12, 0.016), scatters]))
        alike, one = (sp.objective(m, BOTH).problem(theta).value for m in (new, kept))
    assert scatters[np.argmin(alike)] < 0.04  # three new surfaces that agree scatter little
    assert one[-1] - one.min() < 0.5 * (alike[-1] - alike.min())


@pytest.mark.ci
def test_the_force_of_the_same_event_goes_with_its_length():
    """Both of one draw: as pairs drawn at these very numbers say, to 1 in ln L, forces of one length being taken as normal."""
    contact, young, strength, k, scatter, height = 1e-4, 3e9, 2e5, 0.012, 0.08, 32.0
    slider = sp.Slider(height, k, 0.3)
    with jax.enable_x64(True):
        found = sp.scattered(slider, threshold_scatter=scatter, visible=3.0, draws=4000, seed=5, sites=128)
        length, force = np.asarray(found.length), np.asarray(found.force) / k * strength * contact
        one = int(np.argsort(length)[1200])
        read = {"length": [length[one]], "length_sigma": 0.3, "force": [force[one]], "force_sigma": 0.01 * force[one]}
        m = sp.Measurements([height], 0.3, **read, correlation_length=contact, young=young, visible=3.0)
        free = ["stiffness", "threshold_scatter", "strength"]
        problem = sp.objective(m, free).problem
        theta = np.log([k * young / contact, scatter, strength])
        near = theta + [[0, 0, x] for x in (-0.1, -0.03, 0.0, 0.03, 0.1)]
        mine = 2 * problem(near).value
    (low, high), direct = np.quantile(length, [0.16, 0.84]), []
    kernel = KERNEL * (high - low) / 2
    drawn = length.mean() + (length - length.mean()) * np.sqrt(max(1 - (kernel / length.std()) ** 2, 0.7))
    for at in np.exp(near[:, 2]) / strength:
        each = ((drawn - length[one]) / np.hypot(0.3, kernel)) ** 2
        each = each + ((force * at - force[one]) / (0.01 * force[one])) ** 2
        direct.append(-2 * np.log((1 - OUTLIERS) * np.mean(np.exp(-each / 2)) + 1e-6))
    off = (mine - mine.min()) - (np.array(direct) - min(direct))
    assert np.abs(off).max() < 2.0
    assert mine[-1] > mine.min() + 10


@pytest.mark.ci
def test_limits_and_counts_are_draws_too():
    m = small((24.0,), (14.0, 9.0, 18.0), kind=("length", "whole", "at_least"))
    with jax.enable_x64(True):
        found = sp.objective(m, BOTH).problem
        assert np.isfinite(found(np.array(np.log([[0.02, 0.06]])), order=1).gradient).all()
        # nothing as long as 60 is ever seen here but as an outlier
        far = dataclasses.replace(m, length=np.array([14.0, 9.0, 60.0]))
        assert sp.objective(far, BOTH).problem(np.log([[0.02, 0.06]])).value[0] > found(np.log([[0.02, 0.06]])).value[0] + 2


@pytest.mark.ci
def test_a_block_of_contacts_that_scatter():
    """Lengths drawn on blocks with friction, the scatter held: the truth is inside, and contacts taken as alike are far off."""
    heights, b, random = np.array([24.0, 32.0, 40.0]), 1.0, np.random.default_rng(3)
    stiffness, length = b / (2.6 * 32), []
    with jax.enable_x64(True):
        for height in heights:
            block = sp.Block(height, stiffness, 0.3, sp.Push(0.15, 0.1), length=3 * height, friction=0.3)
            seed = int(random.integers(2**31))
            drawn = sp.scattered(block, threshold_scatter=0.05, visible=0.1 * height, draws=3, seed=seed)
            length.append(np.asarray(drawn.length))
    height, length = np.repeat(heights, 3), np.concatenate(length)
    m = sp.Measurements(
        height, 0.3, length, 0.02 * length, visible=0.1 * height, push_height=0.15 * height, push_width=0.1 * height,
        block_length=3 * height, friction=0.3,
    )  # fmt: skip
    result = sp.fit(m, "stiffness", fixed={"threshold_scatter": 0.05})
    assert [one.encloses(stiffness) for one in result.intervals["stiffness"][0.95]] == [True]
    assert result.problem.parameters.front.body == "block"
    soft, (drawn,) = 0.65 * stiffness, result.problem.draws(np.log([0.65 * stiffness]))
    block = sp.Block(24.0, soft, 0.3, sp.Push(0.15, 0.1), length=72.0, friction=0.3)
    with jax.enable_x64(True):
        there = np.asarray(sp.scattered(block, threshold_scatter=0.05, visible=2.4, draws=600, seed=9).length)
    for far in (8, 16, 22):  # few get twice as far as most, and count as much as these do
        assert drawn.weight[0][drawn.value[0] > far].sum() == pytest.approx((there > far).mean(), abs=0.04)
    assert drawn.weight[0][drawn.value[0] > 22].sum() > 0.005
    assert (there > 22).mean() > 0.005
    for changed, message in (
        ({"friction_sigma": 0.02}, "friction beside threshold_scatter: draws are of one geometry and friction, so hold it"),
        ({"push_control": "force"}, "threshold_scatter on a block: the pusher is displaced"),
    ):
        with pytest.raises(ValueError, match=message):
            sp.fit(dataclasses.replace(m, **changed), "stiffness", fixed={"threshold_scatter": 0.05})


def measured(provenance="measured", **more):
    return small(provenance=(provenance,) * 6, **more)


@pytest.mark.ci
def test_contacts_that_were_measured_differ_unless_it_is_said(tmp_path):
    """By 3 % within a factor of two, beside what lengths share; k of contacts that are alike is in the box, on a line of its own."""
    height, length = np.repeat([24.0, 32.0, 48.0], 2), [16.0, 18, 22, 24, 35, 37]
    result = sp.fit(sp.Measurements(height, 0.3, length, 0.3, visible=3.0, provenance=("digitised",) * 6))
    (scatter,) = (one for one in result.parameters.free if one.name == "threshold_scatter")
    assert scatter.nuisance
    assert scatter.prior_sigma == pytest.approx(np.log(2))
    assert result.names == ["stiffness"]
    assert {*result.inputs} == {"offset", "model_factor", "threshold_scatter"}
    box = result.report().partition("└")[0]
    assert "Thresholds of real contacts are taken to scatter by 3 %, within a factor of two." in " ".join(
        line.strip("│ ") for line in box.splitlines()
    )
    last = [line.strip("│ ") for line in box.splitlines()]
    assert any(line.startswith(("If contacts were alike: k/K = ", "If contacts were alike: no k/K fits")) for line in last)
    result.save(tmp_path / "fit.json")
    again = sp.load_fit(tmp_path / "fit.json")
    assert again.parameters.names == result.parameters.names
    assert again.problem(result.theta).value == pytest.approx(result.problem(result.theta).value)


def model_of_fit(m, event, body, *asked, **more):
    return where_contacts_differ(front_of(m, event, body), m, event, *asked, **more)


def test_which_measured_tables_are_of_contacts_that_differ():
    """Those that draws are followed for; the others are fitted as if contacts were alike."""
    differ = [
        (measured(), "stiffness", None, True),
        (measured("digitised"), None, {"poisson": 0.3}, True),
        (measured("synthetic"), None, None, False),
        (measured("printed"), None, None, False),
        (measured(), "stiffness", {"threshold_scatter": 0}, False),
        (measured("synthetic"), "stiffness", {"threshold_scatter": 0.02}, True),
        (measured("synthetic"), BOTH, None, True),
        (measured(), ["stiffness", "prestress"], None, False),
        (measured(block_length=90.0), "stiffness", None, False),
        (measured(machine_stiffness=1.0), "stiffness", None, False),
        (measured(threshold_slope=0.01), "stiffness", None, False),
        (measured(push_height=4.8, friction=0.3), "stiffness", None, True),
        (measured(push_height=4.8, push_control="force"), "stiffness", None, False),
        (measured(push_height=4.8, friction=0.3, friction_sigma=0.02), "stiffness", None, False),
        (dataclasses.replace(measured(), height=np.full(6, 2e5)), "stiffness", None, False),
    ]
    for m, free, fixed, expected in differ:
        assert model_of_fit(m, None, None, free, fixed).drawn == expected, (m, free, fixed)
    assert not model_of_fit(measured(), None, None, None, size_known=False).drawn
    assert not model_of_fit(measured(), "domino", None, None).drawn


def test_a_prior_of_the_scatter_is_searched_where_it_may_be():
    m = small(prestress=0.5)
    free = ["stiffness", sp.Parameter("threshold_scatter", prior=(0.03, 0.02))]
    with pytest.raises(ValueError, match="must be at most 1 − 5 s = 0.25"):
        sp.fit(m, free)
    q = checked(small(), with_errors_of_measuring(small(), wanted_parameters(small(), free, None, None), size_known=True),
                model_of_fit(small(), None, None, free))  # fmt: skip
    assert np.exp(q.named("threshold_scatter").high) == pytest.approx(0.15)
    own = scatter_of_measured(m, model_of_fit(m, None, None, BOTH))
    assert own.bounds == (0.002, 0.1)


@pytest.mark.ci
def test_a_sequence_that_was_measured_has_contacts_that_differ():
    m = sp.read_measurements(EXAMPLES / "sequence/lengths.csv")
    known = sp.fit(dataclasses.replace(m, provenance=("measured",) * len(m)))
    assert known.parameters.names == ["areal_stiffness", "friction", "threshold_scatter"]
    alike = sp.fit(dataclasses.replace(m, provenance=("measured",) * len(m)), fixed={"threshold_scatter": 0})
    assert alike.parameters.names == ["areal_stiffness", "friction"]
    (wide,), (narrow,) = (one.intervals["areal_stiffness"][0.95] for one in (known, alike))
    assert np.log(wide.high / wide.low) > 2 * np.log(narrow.high / narrow.low)
    assert wide.low < narrow.low < narrow.high < wide.high
    text = known.report()
    assert "Thresholds of real contacts are taken to scatter by 3 %" in text
    assert "If contacts were alike: k/λc² = " in text


@pytest.mark.parametrize(
    ("table", "options", "message"),
    [
        ({}, {"event": "domino"}, "parameter threshold_scatter: no part of the model"),
        ({"block_length": 90.0}, {}, "event = 'scattered': gauges, block_length and machine_stiffness need"),
        ({"threshold_slope": 0.01}, {}, "threshold_slope beside threshold_scatter"),
        ({"visible": 10.0}, {}, r"measurement 1: the length is below 10 λc, the least that is noticed by column visible"),
        ({"length_sigma": None}, {}, "cannot give the size of errors too: give"),
        ({"prestress": 0.8}, {"free": ["stiffness"], "fixed": {"threshold_scatter": 0.05}}, "must be at most 1 − 5 s = 0.75"),
        ({}, {"loss": "student"}, "loss = 'student': of contacts that scatter"),
        ({"height": np.full(3, 1.2e5), "length": [5e4, 6e4, 7e4], "visible": 1e4}, {}, "H/λc = 1.2e.05: .* up to 100000 only"),
        ({}, {"event": "scattered", "free": ["stiffness"]}, "event = 'scattered': free or hold threshold_scatter"),
        (
            {"height": np.full(3, 400.0), "length": [300.0, 310.0, 290.0], "push_height": 60.0},
            {"free": ["stiffness"], "fixed": {"threshold_scatter": 0.05}},
            "a block of too many contacts that differ: events are followed on up to 1024",
        ),
        ({"thresholds": "kept"}, {}, "thresholds is given without specimen"),
    ],
    ids=str,
)
def test_what_has_no_meaning_is_refused(table, options, message):
    m = {"height": np.full(3, 24.0), "poisson": 0.3, "length": [14.0, 9.0, 18.0], "length_sigma": 0.3}
    with pytest.raises(ValueError, match=message):
        sp.fit(sp.Measurements(**m | {"visible": 3.0} | table), **{"free": BOTH} | options)
