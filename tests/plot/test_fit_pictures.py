"""Pictures of a fit say what was fitted, in the unit of the table, and by the name of the specimen."""

import dataclasses
import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from slippulse_jax import Measurements, Parameter, fit, plot, read_measurements
from slippulse_jax.inference.model.fronts import FirstFront
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.result.verdict import Identifiability

EXAMPLES = Path(__file__).resolve().parents[2] / "fit_examples"
HEIGHT_OF_P = (40.0, 60.0, 80.0, 100.0)
HEIGHTS = (2.5, 5.0, 7.5)


def lengths_of(height, stiffness):
    """ℓ* in λc of sliders whose fields broadcast."""
    inputs = Inputs.of(height, stiffness, 0.3)
    return FirstFront().lengths(inputs.ravel()).reshape(inputs.poisson.shape)


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def table(unit, *, height=HEIGHTS, correlation_length=1e-5, **columns):
    """Lengths over three heights in some unit."""
    size, height = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}[unit], np.array(height)
    length = lengths_of(height * size / correlation_length, 0.3 / (height[0] * size / correlation_length))
    length *= correlation_length / size
    made = {f"height_{unit}": height, f"length_{unit}": length, f"length_sigma_{unit}": 0.01 * length, "poisson": 0.3}
    return pd.DataFrame(made | {"correlation_length_m": correlation_length, "young_GPa": 3.0} | columns)


@pytest.mark.ci
@pytest.mark.parametrize(("unit", "correlation_length"), [("m", 1e-2), ("cm", 1e-4), ("mm", 1e-5), ("um", 1e-5)])
def test_every_length_is_in_the_unit_of_the_table(unit, correlation_length):
    heights = [2500.0, 5000.0, 7500.0] if unit == "um" else HEIGHTS
    made = table(unit, height=heights, correlation_length=correlation_length)
    left, right, below = plot.fit(fit(made, "areal_stiffness")).axes
    printed = {"um": "µm"}.get(unit, unit)
    assert texts(right)[:3] == [f"$H$ = {height:g} {printed}" for height in heights]
    assert below.get_xlabel() == f"height, $H$ ({printed})"
    assert left.get_ylabel() == f"precursor length, $\\ell$ ({printed})"
    (points,) = left.containers
    np.testing.assert_allclose(points[0].get_xdata(), heights)


@pytest.mark.ci
def test_lengths_without_a_unit_are_in_correlation_lengths():
    height = np.array([20.0, 40.0, 80.0])
    m = Measurements(height=height, poisson=0.3, length=lengths_of(height, 0.01), length_sigma=0.3)
    _, right, below = plot.fit(fit(m)).axes
    assert texts(right)[:3] == [rf"$H/\lambda_c$ = {h:g}" for h in height]
    assert below.get_xlabel() == r"height, $H/\lambda_c$"


@pytest.mark.ci
def test_a_block_that_a_front_may_run_through_has_a_picture():
    """At heights a little above those measured no length is the longest."""
    m = read_measurements(EXAMPLES / "pmma_block/lengths.csv")
    ax = plot.fit_lengths(fit(dataclasses.replace(m, block_length=np.full(len(m), 2e4))))
    assert max(m.length * m.unit[0]) < ax.get_ylim()[1] < 10 * max(m.length * m.unit[0])


def test_heights_of_the_push_are_in_the_unit_of_the_table():
    cm = io.StringIO("height_cm,push_height_cm,length_cm,length_sigma_cm,poisson,correlation_length_um,young_GPa\n"
                     "4,1.0,1.6,0.05,0.3,100,3\n4,1.5,1.9,0.05,0.3,100,3\n")  # fmt: skip
    _, right, below = plot.fit(fit(pd.read_csv(cm), "areal_stiffness")).axes
    assert texts(right)[:2] == ["$h$ = 1 cm", "$h$ = 1.5 cm"]
    assert below.get_xlabel() == "height of the push, $h$ (cm)"


def specimens(**columns):
    """Three specimens, of which the first is the stiffest."""
    height, each = np.array([20.0, 40.0, 80.0]), {"Z": 0.012, "Y": 0.009, "X": 0.006}
    tables = [{"specimen": name, "height_mm": height, "length_mm": lengths_of(height, k)} for name, k in each.items()]
    known = {"length_sigma_mm": 0.3, "poisson": 0.3, "correlation_length_mm": 1.0, "young_GPa": 3.0}
    return pd.concat(map(pd.DataFrame, tables), ignore_index=True).assign(**(known | columns))


EACH = Parameter("stiffness", each="specimen")


@pytest.mark.ci
def test_curve_and_points_of_a_specimen_share_name_and_colour():
    figure = plot.fit(fit(specimens(), [EACH]))
    left = figure.axes[0]
    assert [name for name in texts(left) if name[0] in "XYZ"] == [
        *(f"{name}: best fit" for name in "ZYX"), *(f"{name} ± σ" for name in "ZYX")
    ]  # fmt: skip
    lines = {line.get_label(): line for line in left.lines}
    for points in left.containers:
        assert points[0].get_color() == lines[points.get_label().replace(" ± σ", ": best fit")].get_color()
    title = figure.get_suptitle()
    assert [title.count(f"[{name}] = ") for name in "XYZ"] == [1, 1, 1]
    assert "…" not in title
    figure.draw_without_rendering()
    (text,) = [text for text in figure.texts if text.get_text() == title]
    assert text.get_window_extent().x1 <= figure.bbox.x1


@pytest.mark.ci
@pytest.mark.parametrize("count", [2, 5, 8])
def test_no_colour_stands_for_two_things(count):
    ax = plot.fit_lengths(fit(table("mm", height=np.linspace(2.5, 7.5, count), specimen=[f"block {i}" for i in range(count)])))
    curve = next(line for line in ax.lines if line.get_label() == "best fit")
    colours = [curve.get_color(), *(points[0].get_color() for points in ax.containers)]
    assert len({*colours}) == len(colours) == count + 1


@pytest.mark.ci
def test_a_profile_has_the_colour_of_its_specimen_and_is_dashed_for_its_own_lengths():
    height, poisson = np.repeat([[20.0, 60.0, 100.0]], 2, axis=0).ravel(), 0.3
    length = lengths_of(height, np.repeat([0.006, 0.2], 3))
    m = Measurements(height=height, poisson=poisson, length=length, length_sigma=0.3, specimen=[*"AAABBB"])
    result = fit(m, [EACH])
    assert result.verdicts["stiffness[B]"].identifiability is Identifiability.REBREAKS
    assert result.verdicts["stiffness[A]"].identifiability is Identifiability.IDENTIFIED
    first, second, *_ = plot.fit_profiles(result).axes
    lengths_of_each = {
        line.get_label()[0]: line.get_color() for line in plot.fit_lengths(result).lines if "best fit" in line.get_label()
    }
    for panel, name in ((first, "A"), (second, "B")):
        assert {line.get_color() for line in panel.lines if line.get_label() == "profile"} == {lengths_of_each[name]}
    assert "edge breaks again" not in texts(first)
    assert "edge breaks again" in texts(second)


@pytest.mark.ci
def test_one_curve_per_condition_and_the_label_says_what_differs(worked):
    result = worked("prestressed_slider")
    ax = plot.length_versus_stiffness(result)
    assert texts(ax)[:5] == [rf"$\varphi$ = {share:g}" for share in (0, 0.1, 0.2, 0.3, 0.4)]
    assert len(ax.patches) == 5 + len(result.intervals["stiffness"][0.95])


def test_counts_are_bands_of_all_they_hold_and_limits_have_no_upper_end(worked):
    result = worked("counts_and_run_throughs")
    ax = plot.length_versus_stiffness(result)
    m = result.measurements
    bands = {(round(one.get_y(), 9), round(one.get_y() + one.get_height(), 9)) for one in ax.patches if one.get_width() == 1}
    shown = [0, 1, 3, 4]  # six of eight conditions; the last two are limits
    assert bands == {(round((m.length[i] - 1) / m.height[i], 9), round(m.length[i] / m.height[i], 9)) for i in shown}
    limits = [line.get_ydata()[0] for line in ax.lines if line.get_linestyle() == ":" and len({*line.get_ydata()}) == 1]
    np.testing.assert_allclose(limits, [30 / 44, 30 / 56])
    assert ax.get_legend().get_title().get_text() == "Bands: counted contacts\nDotted: at least this long"
    marked = {
        line.get_marker(): len(line.get_xdata()) for line in plot.residuals(result).lines if len(line.get_xdata()) in (2, 6)
    }
    assert marked["^"] == 2


@pytest.mark.ci
def test_a_measured_band_is_inside_the_axes_although_no_stiffness_reaches_it():
    m = Measurements(height=[20.0, 40.0], poisson=0.3, length=[24.0, 46.0], length_sigma=0.5)
    top = plot.length_versus_stiffness(fit(m)).get_ylim()[1]
    assert top > 24.5 / 20


@pytest.mark.ci
def test_what_a_misfit_is_measured_in():
    """Counts have no σ; theirs is in contacts."""
    height = np.array([20.0, 30.0, 44.0])
    length = lengths_of(height, 0.01)
    exact = Measurements(height=height, poisson=0.3, length=np.ceil(length), length_sigma=0.0, kind=["whole"] * 3)
    mixed = Measurements(
        height=height,
        poisson=0.3,
        length=[*np.ceil(length[:2]), length[2]],
        length_sigma=[0, 0, 0.5],
        kind=["whole", "whole", "length"],
    )
    known = Measurements(height=height, poisson=0.3, length=length, length_sigma=0.5)
    labels = [plot.residuals(fit(m)).get_ylabel() for m in (exact, mixed, known)]
    per = [label.replace("(fitted − measured)/", "") for label in labels]
    assert per == [r"$\lambda_c$", r"σ (counts: $\lambda_c$)", "σ"]


def test_counts_of_several_specimens_are_named():
    height = np.array([20.0, 30.0, 44.0, 60.0])
    length = lengths_of(height, 0.01)
    m = Measurements(
        height, 0.3, [*np.ceil(length[:2]), *length[2:]], 0.5, kind=["whole"] * 2 + ["length"] * 2, specimen=[*"PPQQ"]
    )
    assert {"P, counted", "Q ± σ"} <= {*texts(plot.fit_lengths(fit(m)))}


@pytest.mark.ci
def test_each_curve_is_called_by_the_verdict_of_its_specimen():
    """The one length of Q has a second value, at which the edge breaks again."""
    height, specimen = [*HEIGHT_OF_P, 30.0], [*"PPPPQ"]
    m = Measurements(height, 0.3, [*lengths_of(np.array(HEIGHT_OF_P), 0.003), 30.0], 0.3, specimen=specimen)
    result = fit(m, [EACH], intervals="profile")
    assert result.verdicts["stiffness[Q]"].identifiability is Identifiability.SEVERAL_ROOTS
    assert {"P: best fit", "Q: one that fits"} <= {*texts(plot.fit_lengths(result))}


def test_the_profile_of_a_rejected_fit_has_no_levels():
    m = Measurements([20.0, 40.0, 80.0], 0.3, lengths_of(np.array([20.0, 40.0, 80.0]), [0.001, 0.005, 0.02]), 0.2)
    result = fit(m)
    assert result.identifiability is Identifiability.POOR_FIT
    ax = plot.profile(result, "stiffness")
    assert texts(ax) == ["profile (rejected)"]
    assert [text.get_text() for text in ax.texts] == []


@pytest.mark.ci
@pytest.mark.parametrize("name", ["counts_and_run_throughs", "own_csv", "prestressed_slider"])
def test_no_legend_reaches_beyond_the_figure(name, worked):
    figure = plot.fit(worked(name))
    figure.draw_without_rendering()
    legends = [ax.get_legend() for ax in figure.axes if ax.get_legend()]
    assert max(one.get_window_extent().x1 for one in legends) <= figure.bbox.x1


@pytest.mark.ci
def test_a_legend_of_many_inputs_stays_inside():
    """Heights and prestress differ, so that labels are long; with counts and limits the title has two lines."""
    height = np.array([20.0, 20.0, 35.0, 35.0, 50.0])
    m = Measurements(
        height, 0.3, 0.6 * height, 1.0, prestress=[0, 0.08, 0.15, -0.1, 0.05], kind=["length"] * 3 + ["whole", "at_least"]
    )
    figure = plot.fit(fit(m))
    figure.draw_without_rendering()
    legends = [ax.get_legend() for ax in figure.axes if ax.get_legend()]
    assert max(one.get_window_extent().x1 for one in legends) <= figure.bbox.x1
    widths = [ax.get_position().width for ax in figure.axes]
    assert max(widths) < 1.2 * min(widths)


@pytest.mark.ci
def test_panels_are_lettered_down_the_left_first():
    figure = plot.fit(fit(table("mm"), "areal_stiffness"))
    above, right, below = figure.axes
    assert [panel.texts[-1].get_text() for panel in (above, below, right)] == ["(a)", "(b)", "(c)"]


@pytest.mark.ci
def test_no_equation_of_the_title_is_broken(monkeypatch):
    result = fit(table("mm"), "areal_stiffness")
    for width in range(100, 141, 4):
        monkeypatch.setattr(plot.fits, "TITLE", width)
        title = plot.fit(result).get_suptitle()
        assert all(equation in title for equation in ("E = 3 GPa", "ν = 0.3", "λc = 10 µm"))


@pytest.mark.ci
def test_the_title_says_what_was_fitted_beside():
    exact, known = (plot.fit(fit(specimens(**one), [EACH])).get_suptitle() for one in ({}, {"poisson_sigma": 0.02}))
    assert "E = 3 GPa, ν = 0.3, λc = 1000 µm" in exact
    assert "ν = 0.3 ± 0.019 (fitted)" in known  # one for each specimen
    with_prior = fit(specimens(), ["stiffness", Parameter("young", prior=(3e9, 2e8))])
    assert with_prior.identifiability is Identifiability.POOR_FIT
    assert "E = 3.00 ± 0.20 GPa (stated), ν = 0.3" in plot.fit(with_prior).get_suptitle()


@pytest.mark.ci
def test_an_input_with_a_prior_has_no_profile_beside_a_result():
    result = fit(specimens(), [EACH, Parameter("young", prior=(3e9, 2e8))])
    figure = plot.fit(result)
    assert [ax.get_xlabel()[-3:] for ax in figure.axes[1:-1]] == ["[Z]", "[Y]", "[X]"]
    said = figure.axes[1].get_legend().get_title().get_text().replace("\n", " ")
    assert said == "3 of 4 parameters; all by sp.plot.fit_profiles(result)"
    assert "E = 3.00 ± 0.20 GPa (fitted)" in figure.get_suptitle()
    assert "Young" in "".join(ax.get_xlabel() for ax in plot.fit_profiles(result).axes)


def test_the_only_parameter_is_drawn_although_a_prior_holds_it():
    m = Measurements(height=[20.0, 40.0], poisson=0.3, length=lengths_of([20.0, 40.0], 0.01), length_sigma=8.0)
    assert len(plot.fit(fit(m, [Parameter("stiffness", prior=(0.01, 1e-4))])).axes) == 3


@pytest.mark.ci
def test_fitted_lengths_off_the_curve_are_marked():
    """Where each height has an error of its own."""
    made = specimens(height_sigma_mm=4.0)[:3]
    made["length_mm"] += [0.0, 6.0, 0.0]
    result = fit(made, "areal_stiffness")
    ax = plot.fit_lengths(result)
    (ticks,) = (line for line in ax.lines if line.get_label() == "fitted (own inputs)")
    (curve,) = (line for line in ax.lines if line.get_label() == "best fit")
    x, y = ticks.get_data()
    fitted = result.to_dataframe()["length_fitted_mm"].to_numpy()
    assert set(y) <= set(fitted)
    assert 40.0 in x
    assert np.abs(np.interp(x, *curve.get_data()) - y).min() > 0.01 * ax.get_ylim()[1]
    exact = plot.fit_lengths(fit(specimens()[:3], "areal_stiffness"))
    assert "fitted (own inputs)" not in texts(exact)


def test_a_corner_plot_has_points_of_bootstrap_and_posterior():
    result = fit(specimens(), [EACH], intervals="profile")
    theta = result.theta + 0.01 * np.random.default_rng(0).standard_normal((50, len(result.theta)))
    drawn = {"bootstrap": result.bootstrap(20), "posterior": theta}
    figure = plot.corner(result, drawn, nodes=5)
    panels = [ax for ax in figure.axes if any(line.get_label() in drawn for line in ax.lines)]
    assert panels
    for ax in panels:
        points = {line.get_label(): line for line in ax.lines if line.get_label() in drawn}
        assert {name: len(line.get_xdata()) for name, line in points.items()} == {"bootstrap": 20, "posterior": 50}
        assert points["bootstrap"].get_color() != points["posterior"].get_color()


@pytest.mark.ci
def test_a_narrow_region_is_drawn_in_one_piece():
    """Of two parameters that trade off, the regions are thin beside the range of either."""
    height = np.array([12.0, 24.0, 36.0, 48.0, 60.0, 72.0])
    length = [6.29, 13.80, 23.63, 34.18, 46.09, 57.70]
    known = {"poisson": 0.3, "correlation_length_um": 10.0, "young_GPa": 3.0, "length_sigma_mm": 0.3}
    result = fit(pd.DataFrame({"height_mm": height, "length_mm": length} | known), ["areal_stiffness", "prestress"])
    ax = plot.confidence_region(result, "areal_stiffness", "prestress")
    inner, outer = ax.collections[0].get_paths()
    assert len(inner.to_polygons()) == 1
    assert len(outer.to_polygons()) == 2  # around and inside
