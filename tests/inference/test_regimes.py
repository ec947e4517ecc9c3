"""A search that misses no minimum, counts as sets, and intervals that cover where valleys compete."""

import numpy as np
import pytest

import slippulse_jax as sp
from benchmarks.regimes import counts, roots_missed, run, two
from slippulse_jax.inference.fitted import Identifiability
from slippulse_jax.inference.intervals import allowed_by_counts
from slippulse_jax.inference.likelihood import make_problem
from slippulse_jax.inference.parameters import parameter_set
from slippulse_jax.inference.search import _minimised, scan, search
from slippulse_jax.status import Outcome


def whole(height, length):
    count = np.size(length)
    return sp.Measurements(height=height, poisson=0.3, length=length, length_sigma=np.zeros(count), kind=["whole"] * count)


def problem_of(m, *free):
    return make_problem(m, parameter_set(m, free), "normal", np.ones(len(m)) if m.length_sigma is None else m.sigma)


@pytest.mark.ci
@pytest.mark.parametrize("count", [57, 47])
def test_both_sets_of_one_count(count):
    """Against the recursion, which breaks the contacts one by one, at 20 001 stiffnesses."""
    node = np.geomspace(1e-4, 1, 20_001)
    breaks = np.ceil(sp.precursor_lengths(sp.Slider(80.0, node, 0.3))) == count
    result = sp.fit(whole(80.0, float(count)))
    pieces = result.intervals["stiffness"][0.95]
    assert result.converged
    assert result.identifiability is Identifiability.SEVERAL_ROOTS
    assert len(pieces) == np.count_nonzero(breaks[1:] & ~breaks[:-1]) == 2
    np.testing.assert_array_equal(np.any([(piece.low < node) & (node < piece.high) for piece in pieces], axis=0), breaks)


def test_counts_that_exclude_each_other_are_named():
    height = np.array([20.0, 40.0, 80.0])
    true = np.ceil(sp.exact_lengths(sp.Slider(height, 0.004, 0.3)))
    result = sp.fit(whole(height, true - [0.0, 9.0, 0.0]))
    assert result.identifiability is Identifiability.POOR_FIT
    assert "measurement 1" in result.reason
    assert not result.intervals["stiffness"][0.95]
    assert allowed_by_counts(problem_of(whole(height, true), "stiffness"))[0]


def test_a_count_of_one_holds_where_no_domino_starts():
    result = sp.fit(whole(80.0, 1.0))
    (piece,) = result.intervals["stiffness"][0.95]
    assert piece.open_low
    assert result.identifiability is Identifiability.ONE_SIDED


@pytest.mark.ci
def test_a_root_in_the_last_cell():
    length = float(sp.precursor_length(sp.Slider(60.0, 0.97, 0.3)))
    result = sp.fit(sp.Measurements(height=60.0, poisson=0.3, length=length, length_sigma=0.01))
    soft, stiff = sorted(root.values["stiffness"] for root in result.roots)
    assert stiff == pytest.approx(0.97, rel=1e-3)
    assert soft < 0.01
    assert sp.precursor_length(sp.Slider(60.0, soft, 0.3)) == pytest.approx(length, abs=0.01)


@pytest.mark.ci
def test_every_root_of_a_dense_scan_is_reported():
    share, total = roots_missed(6, seed=1, nodes=10_001)
    assert share.hits == share.of
    assert total > share.of


@pytest.mark.ci
def test_the_scan_keeps_every_point_the_data_do_not_exclude():
    """Against the deviance on a fine grid: every value that near the least lies in a cell, and the least is found."""
    study = two(np.random.default_rng(5), 8, 80)
    problem = problem_of(study.measurements, "stiffness", "correlation_length")
    cells, q = scan(problem), problem.parameters
    assert cells.complete
    axes = [np.linspace(a, b, 160) for a, b in zip(q.low, q.high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    deviance = 2 * problem(grid).value
    found = search(problem, method="lm", max_steps=60, seed=0)
    assert found.roots[0].deviance <= deviance.min() + 1e-9
    near = grid[deviance < found.roots[0].deviance + 12]
    assert len(near) > 3
    held = ((cells.low <= near[:, None]) & (near[:, None] <= cells.high)).all(-1).any(-1)
    assert held.all()


@pytest.mark.parametrize("kind", ["length", "whole"])
def test_no_cell_may_be_left(kind):
    """Where rounding or the linear models leave none, the search ends without, and does not fail."""
    m = sp.Measurements(height=[20.0, 40.0], poisson=0.3, length=[9.0, 21.0], length_sigma=0.1, kind=[kind] * 2)
    problem = problem_of(m, "stiffness")
    none = _minimised(problem, *np.empty((2, 0, 1)), np.empty((0, 2, 2)), np.empty((0, 2)), 1.0, True)
    assert none.theta.shape == (0, 1)
    cells = scan(problem)
    edges = np.stack([cells.low, cells.high])
    corner = np.moveaxis([problem.predictions(edge) for edge in edges], 0, 1)
    # no deviance is below zero
    lost = _minimised(problem, *edges, corner, problem.predictions(edges.mean(axis=0)), -1.0, True)
    assert len(lost.low) == 0


@pytest.mark.ci
def test_counts_always_hold_the_truth():
    (found,) = run(counts, 6, seed=3).values()
    assert [share.hits for share in found.holds] == [6, 6]
    assert found.unconverged == 0


@pytest.mark.ci
@pytest.mark.filterwarnings("ignore:every height is below 1 mm")
def test_no_number_where_a_wrong_valley_wins():
    """Errors of this study favour a valley at five times the true λc, by more than any test of χ² would doubt."""
    study = two(np.random.default_rng([0, 13]), 8, 80)
    result = sp.fit(study.measurements, study.free, seed=13, intervals="profile")
    wrong = abs(np.log(result.values["correlation_length"] / study.truth["correlation_length"]))
    assert wrong > 1
    j = result.parameters.index("correlation_length")
    assert 5 * np.sqrt(result.roots[0].covariance[j, j]) < wrong
    assert result.stderrs["correlation_length"] is None


def test_prestress_of_either_sign_lies_in_the_default_range():
    assert parameter_set(whole(80.0, 57.0), ["stiffness", "prestress"]).low[1] < -0.9


@pytest.mark.slow
@pytest.mark.parametrize("regime", ["counts", "two", "two-tall", "three"])
def test_regimes(regime):
    from benchmarks.regimes import REGIMES, STUDIES

    studies = STUDIES[regime]
    for found in run(REGIMES[regime][1], studies, seed=11).values():
        assert found.unconverged == 0
        assert found.worst < 5
        for share, level in zip(found.holds, (0.6827, 0.95), strict=True):
            slack = 3 * np.sqrt(level * (1 - level) / studies)
            assert share.value > level - slack


@pytest.mark.ci
@pytest.mark.parametrize(("b", "again"), [(1.0, False), (2.9, True)])
def test_no_standard_error_where_the_edge_breaks_again(b, again):
    """b of the middle height; that of the tallest reaches beyond b* = 3.09 in the second case."""
    height = np.array([300.0, 500.0, 800.0])
    slider = sp.Slider(height, b / (2.6 * 500), 0.3)
    length = sp.precursor_lengths(slider)
    result = sp.fit(sp.Measurements(height=height, poisson=0.3, length=length, length_sigma=0.01 * length))
    assert result.identifiability is (Identifiability.REBREAKS if again else Identifiability.IDENTIFIED)
    assert (result.stderrs["stiffness"] is None) == again
    assert (int(sp.first_precursor(sp.Slider(800.0, b / (2.6 * 500), 0.3)).status) == Outcome.REBREAK) == again
    np.testing.assert_allclose(result.regime.b, slider.b, rtol=0.01)
    assert "Regime: b = " in result.report(verbose=True)
