"""Pictures of a fit say what was fitted, in the unit of the table, and by the name of the specimen."""

import dataclasses
import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from slippulse_jax import Measurements, Parameter, fit, plot, read_measurements
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
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
    figure = plot.fit(fit(specimens(), [EACH]), caption=True)
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
    drawn = result.intervals["stiffness"][0.95] + result.intervals_with_inputs["stiffness"][0.95]
    assert len(ax.patches) == 5 + len(drawn) == 9


def test_counts_are_bands_of_all_they_hold_and_limits_have_no_upper_end(worked):
    result = worked("counts_and_run_throughs")
    ax = plot.length_versus_stiffness(result)
    m = result.measurements
    bands = {(round(one.get_y(), 9), round(one.get_y() + one.get_height(), 9)) for one in ax.patches if one.get_width() == 1}
    shown = [0, 1, 3, 4]  # six of eight conditions; the last two are limits
    assert bands == {(round((m.length[i] - 1) / m.height[i], 9), round(m.length[i] / m.height[i], 9)) for i in shown}
    limits = [line.get_ydata()[0] for line in ax.lines if line.get_linestyle() == ":" and len({*line.get_ydata()}) == 1]
    np.testing.assert_allclose(limits, [30 / 44, 30 / 56])
    assert ax.get_legend().get_title().get_text() == "Bands: counted contacts\nDotted: at least this long\n6 of 8 conditions"
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
    every = [plot.residuals(fit(m)) for m in (exact, mixed, known)]
    per = [ax.get_ylabel().replace("residual ", "") for ax in every]
    assert per == [r"($\lambda_c$)", r"(σ, counts: $\lambda_c$)", "(σ)"]
    assert {ax.get_legend().get_title().get_text() for ax in every} == {"residual: fitted − measured"}


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
def test_no_equation_of_the_caption_is_broken(monkeypatch):
    result = fit(table("mm"), "areal_stiffness")
    for width in range(100, 141, 4):
        monkeypatch.setattr(plot.fits, "CAPTION", width)
        title = plot.fit(result, caption=True).get_suptitle()
        assert all(equation in title for equation in ("E = 3 GPa", "ν = 0.3", "λc = 10 µm"))


@pytest.mark.ci
def test_the_caption_says_what_was_fitted_beside():
    exact, known = (
        plot.fit(fit(specimens(**one), [EACH]), caption=True).get_suptitle() for one in ({}, {"poisson_sigma": 0.02})
    )
    assert "E = 3 GPa, ν = 0.3, λc = 1000 µm" in exact
    assert "ν = 0.3 ± 0.019 (fitted)" in known  # one for each specimen
    with_prior = fit(specimens(), ["stiffness", Parameter("young", prior=(3e9, 2e8))])
    assert with_prior.identifiability is Identifiability.POOR_FIT
    assert "E = 3.00 ± 0.20 GPa (stated), ν = 0.3" in plot.fit(with_prior, caption=True).get_suptitle()


@pytest.mark.ci
def test_an_input_with_a_prior_has_no_profile_beside_a_result():
    result = fit(specimens(), [EACH, Parameter("young", prior=(3e9, 2e8))])
    figure = plot.fit(result, caption=True)
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


# --- sequences of a block ----------------------------------------------------------------------------------------------

PLACES = [9.97, 10.79, 17.96, 27.01, 35.91, 45.11, 54.03, 62.99, 71.52, 80.23, 90.0]
FORCES = [160.3, 132.7, 143.2, 164.9, 181.2, 202.8, 173.8, 179.7, 178.1, 173.7, 172.7]
EVENTS = {"length_mm": [10.22, 47.63, 71.92, 76.87, 90.0], "force_N": [160.4, 201.8, 181.0, 176.7, 176.6]}
LABELS = "force over normal load, $F/F_N$", "extent over length, $x/L$"


def block(length, force, relative=0.005, **more):
    """Places reached of a block of 30 × 90 × 10 mm, with relative errors; the last spans it."""
    n = len(length)
    known = {"height_mm": 30, "block_length_mm": 90, "block_width_mm": 10, "correlation_length_um": 625, "poisson": 0.3}
    known |= {"young_GPa": 3, "push_height_mm": 4.5, "push_width_mm": 3, "normal_load_N": 1000}
    errors = {"force_sigma_N": 0.01 * np.array(force), "length_sigma_mm": [*relative * np.array(length)[:-1], np.nan]}
    spans = ["no"] * (n - 1) + ["yes"]
    return pd.DataFrame(known | {"length_mm": length, "force_N": force, "spans": spans} | errors | more, index=range(n))


@pytest.fixture(scope="module")
def places():
    return fit(block(PLACES, FORCES), free=["stiffness", "friction"])


@pytest.fixture(scope="module")
def numbered():
    """Two sequences, of which the loads differ."""
    length, force = EVENTS["length_mm"], np.array(EVENTS["force_N"])
    each = [
        block(length, load / 1000 * force, 0.03, event=range(1, 6), sequence=name, normal_load_N=load)
        for name, load in (("first", 1000), ("second_$", 2000))
    ]
    return fit(pd.concat(each, ignore_index=True), free=["stiffness", "friction"])


@pytest.fixture(scope="module")
def unloaded():
    """Whose normal load is not known."""
    return fit(block(PLACES, FORCES).drop(columns="normal_load_N"), free=["stiffness", "friction", "normal_load"])


@pytest.fixture(scope="module")
def far_off():
    result = fit(block(PLACES, FORCES), free="friction", fixed={"areal_stiffness": 1e9})
    assert result.identifiability is Identifiability.POOR_FIT
    return result


def drawn_as(ax, label):
    return next(line for line in ax.lines if line.get_label() == label)


@pytest.mark.ci
def test_a_sequence_is_drawn_as_it_was_measured_and_fitted(places):
    ax = plot.fit_sequence(places)
    assert (ax.get_xlabel(), ax.get_ylabel()) == LABELS
    points = {one.get_label(): one for one in ax.containers}
    plain, spanning = points["measured ± σ"], points["spanning ± σ"]
    np.testing.assert_allclose(plain[0].get_xdata(), np.array(FORCES[:-1]) / 1000)
    np.testing.assert_allclose(plain[0].get_ydata(), np.array(PLACES[:-1]) / 90)
    np.testing.assert_allclose([*spanning[0].get_xdata(), *spanning[0].get_ydata()], [FORCES[-1] / 1000, 1.0])
    across, along = (np.ptp(np.array(bars.get_segments()), axis=1) / 2 for bars in plain[2])
    np.testing.assert_allclose(across[:, 0], 0.01 * np.array(FORCES[:-1]) / 1000)
    np.testing.assert_allclose(along[:, 1], 0.005 * np.array(PLACES[:-1]) / 90)
    thin = np.concatenate([bars.get_segments() for one in ax.containers if one[0] is None for bars in one[2]])
    np.testing.assert_allclose(np.ptp(thin, axis=1)[:, 0] / 2, places.sigma / 1e5)  # N/m, of 1 kN on 10 mm
    ticks = drawn_as(ax, "fitted: mean of series")
    np.testing.assert_allclose(ticks.get_xdata(), places.fitted / 1e5)


@pytest.mark.ci
def test_the_staircase_is_the_series_at_the_best_fit(places):
    q = places.parameters
    data = places.problem.observed[0]
    ((found, *_),) = q.front.follow(data.inputs.at(places.theta[None]))
    line = drawn_as(plot.fit_sequence(places), "best fit")
    force, extent = line.get_data()
    at = np.array([0.05, 0.31, 0.55, 0.7, 0.99])
    first = np.argmax(extent[:, None] >= at, axis=0)
    np.testing.assert_allclose(force[first], places.values["friction"] * found.force_at(at, 0 * at)[0, 0], rtol=1e-12)
    assert (np.diff(extent) >= 0).all()
    assert extent[[0, -1]].tolist() == [0, 1]


@pytest.mark.ci
def test_the_band_of_a_sequence_is_that_of_series_the_data_allow(places):
    ax = plot.fit_sequence(places)
    (band,) = (one for one in ax.collections if one.get_label() == "95% band of series")
    corners = band.get_paths()[0].vertices
    force, extent = drawn_as(ax, "best fit").get_data()
    inside = []
    for at in np.linspace(0.02, 0.98, 49):
        ends = corners[np.abs(corners[:, 1] - at) < 0.003, 0]
        inside.append(ends.min() <= force[np.argmax(extent >= at)] <= ends.max())
    assert np.mean(inside) > 0.9
    at_start = corners[corners[:, 1] < 0.05, 0]
    (friction,) = places.intervals["friction"][0.95]  # to which the force of a series is proportional
    wide = (friction.high - friction.low) / places.values["friction"]
    assert wide < np.ptp(at_start) / at_start.mean() < 3 * wide


@pytest.mark.ci
def test_errors_that_do_not_fit_the_range_make_no_wider_band(unloaded, places):
    """μ and F_N are known only as a product, so that forces are known as well as with F_N."""
    widths = []
    for result, size in ((places, 1000), (unloaded, 1)):
        (band,) = (one for one in plot.fit_sequence(result).collections if one.get_label() == "95% band of series")
        corners = band.get_paths()[0].vertices
        widths.append(size * np.ptp(corners[np.abs(corners[:, 1] - 0.35) < 0.002, 0]))
    assert widths[1] < 2 * widths[0]


@pytest.mark.ci
def test_a_force_without_normal_load_has_the_unit_of_the_table(unloaded):
    figure = plot.fit(unloaded)
    ax = figure.axes[0]
    assert ax.get_xlabel() == "force, $F$ (N)"
    np.testing.assert_allclose(ax.containers[0][0].get_xdata(), FORCES[:-1])
    np.testing.assert_allclose(drawn_as(ax, "fitted: mean of series").get_xdata(), 0.01 * unloaded.fitted)
    assert [one.get_xlabel() for one in figure.axes[1:4]] == [
        "areal stiffness, $k/\\lambda_c^2$ ($10^{10}$ Pa/m)", r"friction coefficient, $\mu$", "normal load, $F_N$ ($10^{5}$ N/m)"
    ]  # fmt: skip


@pytest.mark.ci
def test_sequences_have_colours_and_share_residuals_of_first_lengths(numbered):
    figure = plot.fit(numbered)
    above, _, _, below = figure.axes
    assert texts(above)[:2] == ["first: best fit", r"second_\$: best fit"]
    lines = [drawn_as(above, label) for label in texts(above)[:2]]
    np.testing.assert_allclose(*(line.get_xdata() for line in lines), rtol=1e-9)  # over their loads both are alike
    colours = [line.get_color() for line in lines]
    assert [one[0].get_color() for one in above.containers if one[0]] == np.repeat(colours, 2).tolist()
    marks = [line for line in below.lines if line.get_linestyle() == "None"]
    np.testing.assert_allclose(np.concatenate([line.get_ydata() for line in marks[0:2] + marks[3:5]]), numbered.residuals)
    np.testing.assert_allclose(marks[0].get_xdata(), np.array(EVENTS["length_mm"][:-1]) / 90)
    (first,) = numbered.further
    np.testing.assert_allclose([marks[i].get_ydata()[0] for i in (2, 5)], first.residuals)
    assert texts(below) == ["± σ", "of the first length"]
    assert below.get_xlabel() == LABELS[1]


@pytest.mark.ci
def test_events_of_a_sequence_are_bars_over_what_breaks(numbered):
    q = numbered.parameters
    _, (found, *_) = q.front.follow(numbered.problem.observed[0].inputs.at(numbered.theta[None]))
    (bars,) = plot.sequence_events(numbered, "second_$").collections
    ends = np.array(bars.get_segments())
    n = int(np.isfinite(found.force[0]).sum())
    assert ends.shape == (n, 2, 2)
    begin, end, load = ends[:, 0, 0], ends[:, 1, 0], ends[:, 0, 1]
    contact = 1 / 128  # the most of a series
    assert (end - begin > 0.99 * contact).all()
    assert begin[0] == 0
    assert end[-1] == pytest.approx(1)
    # a front stops within the contact that is the last to break
    stopped = found.reached[0, : n - 1]
    over = np.maximum.accumulate(end)[:-1] - stopped
    assert over.min() > -1e-9
    assert over.max() < 1.01 * contact
    assert (np.diff(load) >= 0).all()
    np.testing.assert_allclose(bars.get_array(), numbered.values["friction"] * found.force[0, :n])
    assert plot.sequence_events(numbered).get_title("left") == "Events: best fit, first"
    with pytest.raises(ValueError, match="'third': one of 'first', 'second_"):
        plot.sequence_events(numbered, "third")


@pytest.mark.ci
def test_a_rejected_sequence_has_no_band(far_off):
    figure = plot.fit(far_off)
    assert texts(figure.axes[0])[0] == "closest (rejected)"
    assert not any("band" in text for text in texts(figure.axes[0]))
    assert figure.axes[1].get_xlabel() == r"friction coefficient, $\mu$"
    assert plot.sequence_events(far_off).get_title("left") == "Events: closest (rejected)"


@pytest.mark.ci
@pytest.mark.parametrize("draw", [plot.fit_lengths, plot.length_versus_stiffness])
def test_pictures_of_lengths_send_a_sequence_to_its_own(draw, places):
    with pytest.raises(ValueError, match=r"forces of a sequence, not lengths: use plot\.fit or plot\.fit_sequence"):
        draw(places)


@pytest.mark.parametrize("draw", [plot.fit_sequence, plot.sequence_events])
def test_pictures_of_sequences_send_lengths_to_their_own(draw):
    m = Measurements([20.0, 40.0], 0.3, lengths_of(np.array([20.0, 40.0]), 0.01), 0.3)
    with pytest.raises(ValueError, match=r"lengths, not forces of a sequence: use plot\.fit or plot\.fit_lengths"):
        draw(fit(m))


@pytest.mark.ci
@pytest.mark.parametrize("width", [None, 85, 170])
@pytest.mark.parametrize("name", ["places", "numbered", "unloaded", "far_off"])
def test_nothing_of_a_picture_of_a_sequence_is_cut_or_covered(name, width, request):
    """At the size of its own, and in columns and pages of journals, in mm."""
    result = request.getfixturevalue(name)
    figures = [plot.fit(result), plot.fit_profiles(result), plot.corner(result, nodes=5)] if width != 85 else []
    figures += (
        [draw(result).figure for draw in (plot.fit_sequence, plot.residuals, plot.sequence_events)] if width != 170 else []
    )
    for figure in figures:
        if width is not None:
            figure.set_size_inches(width / 25.4, figure.get_size_inches()[1])
        figure.draw_without_rendering()
        drawn, ends = figure.get_tightbbox().extents, [0, 0, *figure.get_size_inches()]
        assert (drawn[:2] >= -0.01).all(), drawn
        assert (drawn[2:] <= np.array(ends[2:]) + 0.01).all(), (drawn, ends)
        for ax in figure.axes:
            if legend := ax.get_legend():
                assert legend.get_window_extent().y0 >= ax.get_window_extent().y1 - 1
