"""The fit: honest errors, every root, and plain words where the data cannot tell."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from reports import moves, section, unfolded

from slippulse_jax import Measurements, Parameter, fit, plot, read_measurements
from slippulse_jax.base.shown import interval, value_with_error
from slippulse_jax.inference.model.front import RISING
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.result.changes import of_inputs, total
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search import minima
from slippulse_jax.inference.search.intervals import Interval
from slippulse_jax.inference.search.minima import undetermined_axes
from slippulse_jax.inference.search.minimise import Convergence

ROOT = Path(__file__).resolve().parents[2]
PMMA = ROOT / "fit_examples/pmma_block/lengths.csv"


def exact(height, stiffness, poisson=0.3):
    """ℓ* of sliders whose fields broadcast."""
    inputs = Inputs.of(height, stiffness, poisson)
    return FirstFront().lengths(inputs.ravel()).reshape(inputs.poisson.shape)


def study(height, stiffness, relative_sigma, rng=None, poisson=0.3):
    length = exact(height, stiffness, poisson)
    sigma = relative_sigma * length
    noise = 0 if rng is None else sigma * rng.standard_normal(length.shape)
    return Measurements(height=np.atleast_1d(height), poisson=poisson, length=length + noise, length_sigma=sigma)


@pytest.mark.ci
@pytest.mark.parametrize("height", [10.0, 25.0, 50.0])
def test_both_roots_of_one_length(height):
    """A length below the peak belongs to two stiffnesses; each, put back into the model, gives it."""
    target = 0.8 * exact(height, np.geomspace(1e-3, 1, 400)).max()
    result = fit(Measurements(height=[height], poisson=0.3, length=target, length_sigma=0.01 * target))
    assert result.identifiability is Identifiability.SEVERAL_ROOTS
    assert len(result.roots) == 2
    assert len(result.intervals["stiffness"][0.95]) == 2
    assert result.stderrs["stiffness"] is None
    for root in result.roots:
        assert abs(float(exact(height, root.values["stiffness"])) - target) < 1e-6
        assert any(piece.low < root.values["stiffness"] < piece.high for piece in result.intervals["stiffness"][0.6827])
    assert "\nValues that fit (not excluded at 95 %)\n" in result.report()
    low, high = map(float, re.search(r"To keep the first, with its errors: bounds=\((\S+), (\S+)\)", result.report()).groups())
    kept = fit(result.measurements, bounds=(low, high))
    assert kept.values["stiffness"] == pytest.approx(result.values["stiffness"], rel=1e-6)
    assert len(kept.roots) == 1


def test_two_close_roots_either_side_of_the_peak():
    """Roots a tenth of an e-fold apart are both found, not merged."""
    grid = np.geomspace(0.03, 0.07, 2001)
    peak = exact(25.0, grid).max()
    result = fit(Measurements(height=[25.0], poisson=0.3, length=peak - 0.003, length_sigma=1e-4))
    assert len(result.roots) == 2
    low, high = sorted(root.values["stiffness"] for root in result.roots)
    assert 0.03 < low < high < 0.07
    assert np.log(high / low) < 0.4


def test_two_heights_leave_one_root():
    """What one height cannot tell, two can."""
    result = fit(study(np.array([15.0, 60.0]), 0.01, 0.01))
    assert result.identifiability is Identifiability.IDENTIFIED
    assert result.values["stiffness"] == pytest.approx(0.01, rel=1e-6)


@pytest.mark.ci
@pytest.mark.filterwarnings("ignore:the lengths are about 2.09 times")
@pytest.mark.parametrize("excess", [1.02, 1.2, 2.0])
def test_length_above_the_maximum_is_not_identifiable(excess):
    peak = exact(25.0, np.geomspace(0.01, 0.2, 2001)).max()
    result = fit(Measurements(height=[25.0], poisson=0.3, length=excess * peak, length_sigma=0.5))
    assert result.identifiability is Identifiability.AT_MAXIMUM
    assert result.stderrs["stiffness"] is None
    assert result.attainable[0] == pytest.approx(peak, abs=1e-4)
    assert "attainable maximum" in result.report()
    if excess > 1.1:  # more than 3.84 in chi-squared away: no stiffness is allowed, so none is given a narrow interval
        assert result.intervals["stiffness"][0.95] == []
        assert "none" in result.report()


@pytest.mark.ci
@pytest.mark.parametrize("sigma", [1.0, 0.1, 1e-3, 1e-6])
@pytest.mark.parametrize("height", [10.0, pytest.param(25.0, marks=pytest.mark.slow)])
def test_length_exactly_at_the_maximum(height, sigma):
    """χ² is zero and the slope too: no number, no failure of the search."""
    peak = exact(height, np.geomspace(0.01, 0.2, 20_001)).max()
    result = fit(Measurements(height=[height], poisson=0.3, length=peak, length_sigma=sigma))
    assert result.converged
    assert result.identifiability in (Identifiability.AT_MAXIMUM, Identifiability.SEVERAL_ROOTS, Identifiability.SKEWED)
    assert result.stderrs["stiffness"] is None
    assert result.deviance < 1e-3


def test_minimum_at_the_step_where_the_domino_starts():
    """ℓ jumps from 0 to 1 when the second contact starts to break: χ² can have its minimum at that step."""
    m = Measurements(height=[9.3697, 3.3015, 8.7588], poisson=0.3, length=[5.2007, 1.0644, 5.2191], length_sigma=0.3)
    result = fit(m)
    assert result.converged
    grid = np.geomspace(1e-4, 1, 4001)[:, None]
    scan = (((exact(m.height, grid) - m.length) / 0.3) ** 2).sum(axis=1)
    assert result.deviance <= scan.min() + 1e-6


@pytest.mark.ci
def test_short_sliders_with_noise_always_get_an_answer():
    """H/λc 3–10, where whole contacts are large beside the length: the search ends, with a root or a reason."""
    rng = np.random.default_rng(12)
    for _ in range(12):
        height = rng.uniform(3, 10, 3)
        length = exact(height, np.exp(rng.uniform(*np.log([3e-3, 0.3]))))
        result = fit(
            Measurements(
                height=height, poisson=0.3, length=np.abs(length + 0.5 * rng.standard_normal(3)) + 0.1, length_sigma=0.5
            )
        )
        assert result.converged, result.report()
        assert result.reason or result.stderrs["stiffness"]


@pytest.mark.parametrize("sigma", [1e-6, 1e-7])
def test_tiny_sigma_keeps_the_minimum(sigma):
    m = study(np.array([15.0, 30.0, 60.0]), 0.003, 0.01)
    result = fit(Measurements(height=m.height, poisson=0.3, length=m.length * [1.1, 0.95, 1.02], length_sigma=sigma))
    assert result.identifiability is Identifiability.POOR_FIT
    assert result.values["stiffness"] == pytest.approx(0.0031, rel=0.05)


@pytest.mark.ci
def test_many_rows_of_few_heights_cost_little():
    """3 000 measurements at three heights are three curves."""
    rng = np.random.default_rng(5)
    height = np.repeat([15.0, 30.0, 60.0], 1000)
    length = exact(height, 0.004)
    result = fit(Measurements(height=height, poisson=0.3, length=length + 0.5 * rng.standard_normal(3000), length_sigma=0.5))
    assert abs(result.values["stiffness"] - 0.004) < 3 * result.stderrs["stiffness"]
    assert result.stderrs["stiffness"] < 0.01 * 0.004


def test_hopeless_sigma_allows_every_stiffness():
    result = fit(Measurements(height=[25.0], poisson=0.3, length=13.0, length_sigma=100.0))
    assert result.identifiability is Identifiability.UNINFORMATIVE
    assert "unbounded" in result.report()
    assert result.to_dict()["intervals"]["stiffness"]["0.95"][0]["open_low"] is True


@pytest.mark.ci
def test_information_too_small_to_invert_is_none():
    """Fronts that ran far past where they were seen last: 1/information overflows, or is a million ranges."""
    for sigma in (0.05, 0.3, 2.0):
        result = fit(Measurements(height=[20, 30], poisson=0.3, length=[8, 12], length_sigma=sigma, kind=["at_least"] * 2))
        assert result.stderrs["stiffness"] is None
        assert np.isfinite([root.covariance for root in result.roots]).all()
    assert undetermined_axes(np.array([[1e-310]])).all()
    assert not undetermined_axes(np.array([[1e-3]])).any()


@pytest.mark.ci
def test_plateau_without_domino_is_never_called_converged(monkeypatch):
    """Where no domino starts ℓ is 0 and flat: bounds there are refused, and the search itself finds nothing."""
    m = Measurements(height=[5.0], poisson=0.3, length=3.0, length_sigma=0.1)
    with pytest.raises(ValueError, match="no domino starts at k/K from 1e-09 to 0.0001; expected within"):
        fit(m, bounds=(1e-9, 1e-4))
    monkeypatch.setattr("slippulse_jax.inference.parameters._check_reached", lambda *_: None)
    result = fit(m, bounds=(1e-9, 1e-4))
    assert result.roots == []
    assert result.stderrs["stiffness"] is None
    assert result.identifiability is not Identifiability.IDENTIFIED


@pytest.mark.ci
def test_bounds_cut_off_the_minimum():
    """Far below it nothing fits, which is said before anything else; near it the best fit is the end."""
    m = study(np.array([15.0, 30.0, 60.0]), 0.01, 0.01)
    far, near = fit(m, bounds=(1e-4, 5e-3)), fit(m, bounds=(1e-4, 0.0096))
    assert far.identifiability is Identifiability.POOR_FIT
    assert "The best fit is at the upper end of the range." in unfolded(far.report())
    assert not any(far.intervals["stiffness"].values())
    assert near.identifiability is Identifiability.AT_BOUND
    assert "at an end of the range searched. It is the upper end. Widen the range: bounds=(low, high)" in unfolded(
        near.report()
    )
    assert "│ More: docs/fit/faq.md#at-a-bound " in near.report()


def test_unfinished_search_says_so(monkeypatch):
    descend = minima.descend

    def unfinished(*arguments, **options):
        ends = descend(*arguments, **options)
        return ends._replace(convergence=np.full(len(ends.value), Convergence.NOT_CONVERGED))

    monkeypatch.setattr(minima, "descend", unfinished)
    result = fit(study(np.array([15.0, 30.0, 60.0]), 0.0123, 0.01))
    assert not result.converged
    assert "did not converge" in unfolded(result.report())
    assert result.stderrs["stiffness"] is None


def test_bundled_pmma_block_gives_back_its_stiffness(worked):
    """Data made by an independent banded solver with 2.0e10 Pa/m: within two standard errors, and a sensible χ²."""
    result = worked("pmma_block")
    value, error = result.values["areal_stiffness"], result.stderrs["areal_stiffness"]
    assert result.identifiability is Identifiability.IDENTIFIED
    assert abs(value - 2.0e10) < 2 * error
    assert 0.01 < result.p_value < 0.99
    assert result.values["stiffness"] == pytest.approx(value * 10e-6 / 3e9)
    assert result.stderrs["stiffness"] / result.values["stiffness"] == pytest.approx(error / value)


def test_bundled_printed_count_gives_a_range_around_the_papers_stiffness(worked):
    result = worked("paper_printed_value")
    soft, stiff = result.intervals["stiffness"][0.6827]
    assert soft.low < 0.03 < soft.high < stiff.low
    assert result.identifiability is Identifiability.SEVERAL_ROOTS
    between = FirstFront().lengths(Inputs.of(25.0, [(soft.high + stiff.low) / 2], 0.3))
    assert np.ceil(between) == 27


@pytest.mark.ci
def test_units_of_the_result():
    """λc and E may differ between measurements; the areal stiffness is what they share."""
    areal, young = 2e10, np.array([3e9, 70e9])
    correlation = np.array([10e-6, 40e-6])
    height, ratio = np.array([0.05, 0.03]) / correlation, areal * correlation / young
    length = exact(height, ratio)
    common = {
        "height": height,
        "poisson": 0.3,
        "length": length,
        "length_sigma": 0.01 * length,
        "correlation_length": correlation,
    }
    result = fit(Measurements(**common, young=young))
    assert list(result.values) == ["areal_stiffness"]
    assert result.values["areal_stiffness"] == pytest.approx(areal, rel=1e-6)
    assert "as λc and E differ" in result.report(verbose=True)
    without = fit(Measurements(**{**common, "correlation_length": 10e-6, "height": height[:1], "length": length[:1],
                                  "length_sigma": length[:1] / 100}))  # fmt: skip
    assert list(without.values) == ["areal_stiffness_over_young", "stiffness"]
    assert without.values["areal_stiffness_over_young"] == pytest.approx(areal / young[0], rel=1e-6)
    assert any("young_GPa" in note for note in without.notes)


@pytest.mark.ci
def test_wrong_sigma_and_repeated_lines_are_remarked():
    m = study(np.array([15.0, 30.0, 60.0]), 0.003, 0.01)
    off = Measurements(height=m.height, poisson=0.3, length=m.length * [1.2, 1, 0.8], length_sigma=m.length_sigma)
    poor = fit(off)
    assert poor.identifiability is Identifiability.POOR_FIT
    assert poor.stderrs["stiffness"] is None
    assert poor.intervals["stiffness"][0.95] == []
    assert "does not describe these data" in poor.report()
    twice = Measurements(height=[25, 25], poisson=0.3, length=20, length_sigma=1, other={"humidity": ["40", "50"]})
    notes = fit(twice).notes
    assert any("repeats another" in note or "repeat another" in note for note in notes)
    assert any("humidity" in note for note in notes)


@pytest.mark.parametrize("sigma", ["absolute", "relative"])
def test_copies_show_no_scatter(sigma):
    """Of copied lines no size of errors can be taken: NaN in another column does not make them different."""
    m = Measurements(height=[25] * 3, poisson=0.3, length=[15] * 3, length_sigma=None if sigma == "absolute" else 0.5)
    with pytest.raises(ValueError, match=r"3 data, of which 2 repeat another one exactly, for 1 fitted .* give σ"):
        fit(m, sigma=sigma)
    blank = [np.nan, np.nan, 300]
    assert Measurements(height=[25] * 3, poisson=0.3, length=15, block_length=blank).distinct == 2
    assert Measurements(height=[25] * 3, poisson=0.3, length=15, specimen=("A", "B", "A")).distinct == 2
    assert "1 measurement repeats another exactly" in fit(Measurements([25, 25, 50], 0.3, [15, 15, 32])).report()


def test_hardly_any_scatter_is_one_search(monkeypatch):
    """Where σ is that of the least scatter believed, the deviance compared is that under this σ: no search need be repeated."""
    searches = []
    monkeypatch.setattr(
        "slippulse_jax.inference.fit.search", lambda *x, **options: searches.append(x) or minima.search(*x, **options)
    )
    height = np.array([15.0, 30.0, 60.0, 90.0])
    length = exact(height, 0.003) * (1 + 1e-5 * np.array([1, -1, 0.5, -0.5]))
    m = Measurements(height=height, poisson=0.3, length=length, length_sigma=1e-7 * length)
    assert fit(m, sigma="relative").identifiability is Identifiability.NO_SCATTER
    assert len(searches) == 1


@pytest.mark.ci
def test_lengths_without_scatter_have_no_error():
    """Computed lengths without σ give their stiffness, and no error of 1e-11; rounded ones an error."""
    height = np.array([15.0, 30.0, 60.0])
    result = fit(Measurements(height=height, poisson=0.3, length=exact(height, 0.003)))
    assert result.identifiability is Identifiability.NO_SCATTER
    assert result.values["stiffness"] == pytest.approx(0.003)
    assert result.stderrs["stiffness"] is None
    assert result.intervals["stiffness"] == {0.6827: [], 0.95: []}
    assert "Give σ" in result.report()
    assert "±" not in result.report()
    assert "none: no value" not in result.report()
    rounded = fit(Measurements(height=height, poisson=0.3, length=exact(height, 0.003).round(1)))
    assert rounded.identifiability is Identifiability.IDENTIFIED


@pytest.mark.ci
def test_fewer_different_lines_than_parameters_are_remarked():
    m = Measurements(height=[25] * 3, poisson=0.3, length=15, length_sigma=0.5)
    result = fit(m, ("stiffness", "prestress"), intervals="profile")
    assert any("2 parameters are fitted, but only 1 of the data are different" in note for note in result.notes)
    told = result.verdicts["stiffness"].reason.split("; ")
    assert [unfolded(result.report()).count(f" {text[0].upper()}{text[1:]}. ") for text in told] == [1] * len(told)


@pytest.mark.ci
def test_scatter_beyond_sigma_is_remarked_and_measured():
    """χ² of p between 0.001 and 0.05 gets a note; without σ the report prints the scatter, and rises in its unit."""
    length = exact(np.array([15.0, 30.0, 60.0]), 0.003)
    data = {"height": [15, 30, 60], "poisson": 0.3, "length": length * [1.03, 0.99, 1.0]}
    loose = fit(Measurements(**data, length_sigma=0.02 * length))
    result = fit(Measurements(**data, length_sigma=0.02 * length * np.sqrt(loose.deviance / 8)))
    assert result.p_value == pytest.approx(np.exp(-4), rel=1e-3)  # χ² of 8 for two degrees of freedom
    assert any("2 times as large" in note for note in result.notes)
    free = fit(Measurements(**data))
    scatter = np.sqrt(((free.fitted - data["length"]) ** 2).sum() / 2)
    assert f"σ = {scatter:.3g} λc" in free.report()


def test_specimens_with_tied_roots_lie_on_one_side():
    """Each specimen has two roots of no residual: the value is the softer of each, and the report says whose k/K differ."""
    m = Measurements(height=[20, 25], poisson=0.3, length=[18.0, 23.0], length_sigma=0.2, specimen=("A", "B"))
    result = fit(m, [Parameter("stiffness", each="specimen")])
    for name in ("stiffness[A]", "stiffness[B]"):
        assert result.values[name] < 0.05
    assert "one for each specimen" in result.report(verbose=True)


def test_pieces_of_an_interval_have_exponents_of_their_own():
    assert interval(Interval(7.487e13, 1.09475e14, False, False), 2e10, 1e9) == "(0.75 to 1.09)e14"
    assert interval(Interval(1.92e10, 1.99e10, False, False), 1.95e10, 7e8) == "(1.920 to 1.990)e10"


def test_dictionary_is_json_and_complete():
    result = fit(study(np.array([15.0, 30.0, 60.0]), 0.003, 0.01))
    content = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert content["identifiability"] == "identified"
    assert content["values"]["stiffness"] == result.values["stiffness"]
    assert len(content["measurements"]["height"]) == len(content["residuals"]) == 3
    assert len(content["data_sha256"]) == 64
    assert content["intervals"]["stiffness"]["0.95"][0]["low"] < result.values["stiffness"]


def test_refused_requests():
    m = Measurements(height=[25.0], poisson=0.3, length=20, length_sigma=1)
    refused = {
        "stiffness is neither fitted nor held": {"free": ("poisson",)},
        "free = ": {"free": ()},
        "parameter 'k': one of stiffness": {"free": ("k",)},
        "stiffness is given 2 times": {"free": ("stiffness", "stiffness")},
        "needs measurements in SI": {"free": ("stiffness", "young")},
        "these measurements determine stiffness": {"free": ("areal_stiffness",)},
        "name no specimens": {"free": (Parameter("stiffness", each="specimen"),)},
        "model_factor: needs a prior": {"free": ("stiffness", "model_factor")},
        "nothing is fitted": {"free": (Parameter("stiffness", value=0.03),)},
        "range searched for poisson means ν": {"free": ("stiffness", Parameter("poisson", bounds=(0.1, 0.7)))},
        "loss = 'l1'": {"loss": "l1"},
        "method = 'newton'": {"method": "newton"},
        "sigma = 'none'": {"sigma": "none"},
        "cannot be taken from|no size of errors": {"sigma": "relative"},
    }
    for message, arguments in refused.items():
        with pytest.raises(ValueError, match=message):
            fit(m, **arguments)
    assert fit(m, free="stiffness").values == fit(m).values
    with pytest.raises(ValueError, match="must lie in 1e-30 to 1e3"):
        fit(m, bounds=(1e-300, 1e300))
    with pytest.raises(ValueError, match=r"bounds = \(1, 0.1\) of stiffness"):
        fit(m, bounds=(1.0, 0.1))
    with pytest.raises(ValueError, match="max_steps = 0"):
        fit(m, max_steps=0)
    with pytest.raises(ValueError, match=r"prior = \(3.3e\+09, 0.06\) of young: the deviation is 2e-11 of the mean"):
        Parameter("young", prior=(3.3e9, 0.06))


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.9555e10, 3.2e8, "(1.956 ± 0.032)e10"),
        (0.03, 0.0041, "0.0300 ± 0.0041"),
        (6.5e-5, 1.1e-6, "(6.50 ± 0.11)e-5"),
        (123.4, 15.0, "123 ± 15"),
        (0.03, None, "0.03"),
    ],
)
def test_value_with_error(value, error, text):
    assert value_with_error(value, error) == text


@pytest.mark.ci
def test_figure(tmp_path, worked):
    """Both panels have units, a legend, and show what is claimed; nothing warns on the way."""
    for name, measured in (("pmma_block", "measured ± σ"), ("paper_printed_value", "whole contacts")):
        best = "best fit" if name == "pmma_block" else "one that fits"
        result = worked(name)
        assert plot.fit(result).get_suptitle() == ""
        figure = plot.fit(result, caption=True)
        left, right, off = figure.axes
        assert not left.get_xlabel()  # that of the residuals below
        assert "stiffness" in right.get_xlabel()
        assert ("σ" if name == "pmma_block" else r"$\lambda_c$") in off.get_ylabel()  # a count has no σ
        assert off.get_xlabel() == "height, $H$ (mm)" or name != "pmma_block"
        title = figure.get_suptitle()
        assert (
            result.identifiability.value[1:] in title
            if name != "pmma_block"
            else title.startswith(
                "k/λc² = (1.96 ± 0.17)e10 Pa/m; (1.956 ± 0.032)e10 from the lengths only\nIdentified. From 6 "
            )
        )
        if name == "pmma_block":
            assert unfolded(title).endswith("E = 3 GPa, ν = 0.3, λc = 10 µm")
            box = unfolded(result.report().split("└")[0])
            assert unfolded(title).split("only Identified. ")[1].split(" E = ")[0] in box
        labels = {text.get_text() for text in left.get_legend().get_texts()}
        assert {best, "longer than possible", measured} <= labels
        assert any(label.startswith("95% band") for label in labels)
        figure.savefig(tmp_path / f"{name}.png")


@pytest.mark.ci
def test_a_rejected_fit_is_drawn_without_a_best_fit():
    m = Measurements(height=[25, 50, 75], poisson=0.3, length=[15, 15, 60], length_sigma=0.1, specimen=("A", "B", "A"))
    result = fit(m)
    figure = plot.fit(result, caption=True)
    texts = [text.get_text() for ax in figure.axes if ax.get_legend() for text in ax.get_legend().get_texts()]
    assert "best fit" not in texts
    assert "closest (rejected)" in texts
    assert {"A ± σ", "B ± σ"} <= set(texts)
    assert figure.get_suptitle().startswith("The model does not describe these data")
    no_legend_lies_on_data(figure)


def no_legend_lies_on_data(figure):
    """Each is above its panel, and clear of all others."""
    figure.draw_without_rendering()
    for ax in figure.axes:
        if ax.get_legend():
            legend = ax.get_legend().get_window_extent()
            assert legend.y0 >= ax.get_window_extent().y1
            assert legend.x1 < figure.bbox.width
            assert not any(legend.overlaps(other.get_tightbbox()) for other in figure.axes if other is not ax)


@pytest.mark.parametrize("count", [2, pytest.param(5, marks=pytest.mark.slow)])
def test_figure_has_the_profile_of_each_parameter(count):
    """Up to four, legibly; of more it says how to draw all."""
    heights, names = np.array([20.0, 50.0]), "VWXYZ"[:count]
    length = exact(heights, 0.002 * (1 + np.arange(count))[:, None]).ravel()
    specimen = [f"block {x}" for x in names for _ in heights]
    m = Measurements(np.tile(heights, count), 0.3, length + 0.1 * (-1) ** np.arange(2 * count), 0.1, specimen=specimen)
    figure = plot.fit(fit(m, [Parameter("stiffness", each="specimen")], intervals="profile"))
    _, *profiles, _ = figure.axes
    assert [ax.get_xlabel()[-9:] for ax in profiles] == [f"[block {x}]" for x in names[:4]]
    no_legend_lies_on_data(figure)
    assert min(ax.get_position().width * figure.get_size_inches()[0] for ax in figure.axes) > 2
    assert min(ax.get_position().height * figure.get_size_inches()[1] for ax in profiles) > 1
    said = profiles[0].get_legend().get_title().get_text().replace("\n", " ")
    assert said == ("4 of 5 parameters; all by sp.plot.fit_profiles(result)" if count > 4 else "")


def test_panels_take_the_place_of_an_axes():
    from matplotlib.figure import Figure

    result = fit(Measurements(height=[25, 50], poisson=0.3, length=[16, 40], length_sigma=0.5))
    outer = Figure(layout="constrained")
    first, second = outer.subplots(1, 2)
    assert plot.fit(result, ax=first) in outer.subfigs
    assert plot.fit_profiles(result, ax=second) in outer.subfigs
    assert len(outer.subfigs[0].axes) == 3
    with pytest.raises(ValueError, match="an Axes of a grid"):
        plot.fit(result, ax=Figure().add_axes((0, 0, 1, 1)))


@pytest.mark.ci
@pytest.mark.parametrize("name", ["height", "length", "young", "poisson", "correlation_length"])
def test_budget_is_what_fits_of_moved_inputs_give(name, worked):
    result = worked("pmma_block")
    m = result.measurements
    by = {"height": 1.01, "length": 1.01, "young": 1.05, "poisson": -0.02, "correlation_length": 0.5}[name]
    change = {name: m.poisson + by} if name == "poisson" else {name: getattr(m, name) * by}
    if name == "correlation_length":  # heights and lengths were measured in mm
        change |= {one: getattr(m, one) / by for one in ("height", "length", "length_sigma")}
    moved = fit(dataclasses.replace(m, **change)).values["areal_stiffness"] / result.values["areal_stiffness"]
    assert abs(np.log(moved)) > 0.02
    assert moves(result)[name]["areal_stiffness"] == pytest.approx(np.log(moved), rel=1e-3)
    by_word = {"height": "H larger by 1 %", "poisson": "ν smaller by 0.02", "correlation_length": "λc smaller by a factor 2"}
    (row,) = section(result.report(), f"  {by_word.get(name, name)}"[2:])[:1] if name in by_word else (f"{moved - 1:+.1%}",)
    assert f"{moved - 1:+.1%}".replace("%", "") in row


@pytest.mark.ci
def test_inputs_with_errors_of_their_own_are_not_taken_as_exact():
    m = read_measurements(PMMA)
    stated = dataclasses.replace(m, poisson_sigma=np.full(6, 0.02), young_sigma=0.05 * m.young)
    exact, known = fit(m, "areal_stiffness"), fit(stated, "areal_stiffness")
    assert moves(exact).keys() - moves(known).keys() == {"poisson", "young"}
    # the budget foretold what is in the standard error now
    of_both = [one for one in exact.changes if one.name in ("poisson", "young")]
    assert known.stderrs["areal_stiffness"] == pytest.approx(total(exact, "areal_stiffness", of_both), rel=0.05)


@pytest.mark.ci
def test_report_adds_what_usual_errors_of_the_inputs_do():
    result = fit(read_measurements(PMMA), "areal_stiffness")
    whole = total(result, "areal_stiffness", result.changes)
    assert whole > 4 * result.stderrs["areal_stiffness"]
    report = result.report()
    assert f"{value_with_error(result.values['areal_stiffness'], whole)} " in section(report, "k/λc² (Pa/m)")[0]
    rows = section(report, "What else would move it")
    whats = {"young": "E larger by 5 %", "height": "H larger by 1 %", "poisson": "ν smaller by 0.02"}
    shown = [next(row for row in rows if row.startswith(f"  {what} ")).split()[-2] for what in whats.values()]
    would = [np.exp(moves(result)[name]["areal_stiffness"]) for name in whats]
    assert [float(x) for x in shown] == pytest.approx([100 * (x - 1) for x in would], abs=0.06)
    assert result.stderrs_with_inputs == {"areal_stiffness": whole}
    assert result.to_dict()["stderr_with_inputs"] == {"areal_stiffness": whole}
    assert [one["name"] for one in result.to_dict()["changes"]] == [one.name for one in result.changes]


@pytest.mark.ci
def test_specimens_of_several_heights_have_curves_of_their_own():
    """Each through what the table says was fitted there; and no band where the model is rejected."""
    height, k = np.array([4.0, 6.0, 8.0, 10.0]), {"A": [2.6, 4.6, 6.8, 9.1], "B": [3.3, 5.6, 8.1, 10.9]}
    table = pd.concat(
        [pd.DataFrame({"specimen": name, "height_cm": height, "length_cm": lengths}) for name, lengths in k.items()]
    )
    table = table.assign(length_sigma_cm=0.2, poisson=0.35, correlation_length_um=500.0, young_GPa=3.2, young_sigma_GPa=0.16)
    result = fit(table.assign(correlation_length_sigma_um=100.0))
    assert result.identifiability is Identifiability.POOR_FIT
    ax = plot.fit_lengths(result)
    curves = [line for line in ax.lines if line.get_label() in ("A: closest (rejected)", "B: closest (rejected)")]
    fitted = result.to_dataframe()["length_fitted_cm"].to_numpy().reshape(2, 4)
    drawn = np.sort([np.interp(height, *curve.get_data()) for curve in curves], axis=0)
    np.testing.assert_allclose(drawn, np.sort(fitted, axis=0), rtol=1e-3)
    assert not any("band" in text.get_text() for text in ax.get_legend().get_texts())


def test_errors_of_specimens_in_the_report():
    """Inputs with an error are called by symbol and specimen, k/K says why it is two, lengths are in the table's unit."""
    table = pd.DataFrame({"specimen": ["A", "A", "B"], "height_cm": [2.4, 2.4, 6.0], "length_cm": [1.42, 1.38, 4.78]})
    table = table.assign(length_sigma_cm=0.1, poisson=0.37, correlation_length_um=10.0, young_GPa=3.3, young_sigma_GPa=0.2)
    result = fit(table)
    said = result.report(verbose=True)
    assert (
        "also fitted, within their errors, inputs separately for each specimen:\n    E (A): stated (3.30 ± 0.20)e9 Pa, fitted 3."
        in said
    )
    assert "correlations above 0.5:\n    C(k/λc², E (B)) = +0." in said
    assert "e-5, one for each specimen\n" in said
    assert "(k/K up to 1)" in said
    assert "H/cm  measured/cm" in said
    assert {"height_cm", "length_fitted_cm"} <= set(result.to_dataframe())
    ax = plot.fit_lengths(result)
    (curve,) = [line for line in ax.lines if line.get_label() == "best fit"]
    assert min(curve.get_xdata()) < 2.4 < 6 < max(curve.get_xdata())
    points = {drawn.get_label(): drawn[0] for drawn in ax.containers}
    assert len({points[f"{name} ± σ"].get_color() for name in "AB"}) == 2
    np.testing.assert_allclose(points["A ± σ"].get_xdata(), 2.4)  # repeats stay where they were measured
    # what is not said is named, with what it would add
    row = next(x for x in section(said, "What else") if "model factor of 1.1" in x)
    factor = fit(table, fixed={"model_factor": 1.1}).values["areal_stiffness"] / result.values["areal_stiffness"]
    assert row.rstrip(" │").endswith(f" {100 * (factor - 1):+.1f} %")
    assert factor < 0.9


def test_soft_lengths_rise_with_stiffness():
    """Below `RISING`, where the longest length is not looked for."""
    height, phi = np.array([1.01, 1.5, 3.0, 10.0, 100.0, 1e4]), np.array([-0.9, -0.4, 0.0, 0.3, 0.49, 0.9])
    b = np.geomspace(1e-6, RISING, 60)[:, None, None]
    for poisson in (-0.9, 0.3, 0.5):
        at = Inputs.of(height[:, None], b / (2 * (1 + poisson) * height[:, None]), poisson, phi)
        found = FirstFront().lengths(at.ravel()).reshape(at.poisson.shape)
        assert np.isfinite(found).sum() > 1000
        rounding = 1e-11 * np.where(np.isfinite(found[:-1]), found[:-1], 0)
        assert (found[1:] >= found[:-1] - rounding).all()


@pytest.mark.filterwarnings("ignore:every height is below 1 mm")
def test_counts_have_no_scale():
    """A count stays whole whatever λc, and H/λc may lie next to one."""
    height = np.array([1.0005, 30.0, 50.0, 70.0])
    count = np.maximum(np.ceil(exact(height, 0.005, 0.5)), 1)
    m = Measurements(
        height=height, poisson=0.5, length=count, length_sigma=1.0, kind=["whole"] * 4, correlation_length=1e-5, young=3e9
    )
    found = fit(m, "areal_stiffness")
    assert {one.name for one in of_inputs(found.changes)} == {"height", "young", "poisson", "correlation_length"}
    assert moves(found)["young"]["areal_stiffness"] == pytest.approx(np.log(1.05), rel=1e-4)
