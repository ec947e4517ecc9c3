"""Every picture fits a journal's column and page: nothing is cut, small or without a name."""

import jax
import matplotlib as mpl
from chains import ended

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.text import Text

import slippulse_jax as sp
from slippulse_jax import plot
from slippulse_jax.events.rupture import nucleate, rupture

MM = 1 / 25.4
SLIDER = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)
BLOCK = sp.Block(100.0, 3e-3, 0.3, sp.Push(0.4, 0.3))
PANEL = {
    "schematic": lambda a, **o: [plot.schematic(body, **o) for body in (BLOCK, SLIDER)][-1 if o["ax"] is None else 0],
    "displacements": lambda a, **o: plot.displacements(a.rupture.after, before=a.rupture.before, sites=40, **o),
    "stress": lambda a, **o: plot.stress(a.rupture.after, chain=a.chain, before=a.rupture.before, sites=40, **o),
    "front_stress": lambda a, **o: plot.front_stress(a.front.front_stress[:40], length=float(a.front.length), **o),
    "break_order": lambda a, **o: plot.break_order(a.rupture, **o),
    "sensitivity": lambda a, **o: plot.sensitivity(a.sensitivity, **o),
    "friction_curve": lambda a, **o: plot.friction_curve(a.series, **o),
    "space_time": lambda a, **o: plot.space_time(a.series, **o),
    "precursors": lambda a, **o: plot.precursors(a.series, a.long, **o),
    "block_stress": lambda a, **o: plot.block_stress(a.event, **o),
    "sweep": lambda a, **o: plot.sweep(a.map, "nucleation_load", **o),
    "sweep, lines": lambda a, **o: plot.sweep(a.map.isel(stiffness=[0, 10, 20, 29]), "nucleation_load", **o),
    "recovered_profile": lambda a, **o: plot.recovered_profile(a.profile, **o),
    "resolution": lambda a, **o: plot.resolution(a.profile, **o),
    "design": lambda a, **o: plot.design(a.design, **o),
    "design_lengths": lambda a, **o: plot.design_lengths(a.design, **o),
    "fit_lengths": lambda a, **o: plot.fit_lengths(a.of("pmma_block"), **o),
    "fit_lengths, own_csv": lambda a, **o: plot.fit_lengths(a.of("own_csv"), **o),
    "length_versus_stiffness": lambda a, **o: plot.length_versus_stiffness(a.of("pmma_block"), **o),
    "residuals": lambda a, **o: plot.residuals(a.of("own_csv"), **o),
    "profile": lambda a, **o: plot.profile(a.each, a.each.names[0], **o),
    "confidence_region": lambda a, **o: plot.confidence_region(a.each, *a.each.names[:2], nodes=9, **o),
    "gauge_readings": lambda a, **o: plot.gauge_readings(a.gauges, "stress", **o),
    "observable": lambda a, **o: plot.observable(a.of("pmma_block"), "length", **o),
    "fit_sequence": lambda a, **o: plot.fit_sequence(a.of("sequence"), **o),
    "sequence_events": lambda a, **o: plot.sequence_events(a.of("sequence"), **o),
}
"""Functions that draw on one Axes, by name."""

PANELS = {
    **{f"fit, {name}": (lambda a, name=name, **o: plot.fit(a.of(name), **o))
       for name in ("pmma_block", "own_csv", "prestressed_slider", "counts_and_run_throughs", "shared_stiffness", "sequence")},
    "fit": lambda a, **o: plot.fit(a.each, **o),
    "fit, two roots": lambda a, **o: plot.fit(a.roots, **o),
    "fit, caption": lambda a, **o: plot.fit(a.of("own_csv"), caption=True, **o),
    "fit_profiles": lambda a, **o: plot.fit_profiles(a.each, **o),
    "corner": lambda a, **o: plot.corner(a.each, {"bootstrap": a.each.theta + np.zeros((2, 2)), "b": a.each.theta}, nodes=5, **o),
    "gauges": lambda a, **o: plot.gauges(a.gauges, **o),
    "design_figure": lambda a, **o: plot.design_figure(a.design, **o),
}  # fmt: skip
"""Functions that make a figure."""


class Made:
    """What is drawn, each computed when it is first asked for."""

    def __init__(self, of):
        self.of = of
        with jax.enable_x64(True):
            self.chain = sp.chain(SLIDER, sites=80)
            state, site = nucleate(self.chain)
            self.rupture = rupture(self.chain, state, trigger=site)
            self.front, self.sensitivity = sp.first_precursor(SLIDER), sp.sensitivity(SLIDER, sites=60)
            self.long = sp.chain(ended(sp.Slider(10.0, 0.03, 0.3), 40))
            self.series = sp.series(self.long, events=60, recorded_breaks=2000)
            self.event = sp.first_precursor(sp.Block(20.0, 0.02, 0.3, sp.Push(0.4)))
            every = {"outputs": ["length", "status", "nucleation_load"], "progress": False}
            swept = sp.sweep(height=np.linspace(5, 60, 30), stiffness=np.geomspace(1e-3, 0.3, 30), poisson=[0.3], **every)
            self.map = swept.isel(poisson=0)
            self.profile = sp.recover_profile(self.lengths([6.0, 12, 24, 40], 0.03), stiffness=0.03)
            self.roots = sp.fit(sp.Measurements(25.0, 0.3, 25.9, 0.1))
            self.design = sp.design(
                sp.Knowledge.from_measurements(self.roots.measurements), height=[5, 10, 25, 50, 75, 100, 200, 400], sigma=0.5
            )
            each = self.lengths([20.0, 40, 80, 20, 40, 80], np.repeat([0.012, 0.006], 3), specimen=[*"AAABBB"])
            self.each = sp.fit(each, [sp.Parameter("stiffness", each="specimen")])
            readings = {"row": [0, 0, 1, 1], "position": [2e-3, 8e-3, 5e-3, 2e-2], "stress": [5e5, 2e5, 6e5, 3e5]}
            table = {"height": [20.0, 40], "poisson": 0.3, "length": [12.6, 29.6], "length_sigma": 0.3, "label": ["A", "B"]}
            gauges = sp.Gauges(**{k: np.array(x) for k, x in readings.items()}, stress_sigma=2e5)
            measured = sp.Measurements(**table, correlation_length=1e-3, young=3e9, gauges=gauges)
            self.gauges = sp.fit(measured, ["stiffness", "strength"])

    @staticmethod
    def lengths(height, stiffness, **more):
        length = sp.exact_lengths(sp.Slider(np.array(height), stiffness, 0.3))
        return sp.Measurements(height, 0.3, length, 0.3, **more)


@pytest.fixture(scope="module")
def made(worked):
    return Made(worked)


def test_every_public_function_is_drawn_here():
    public = {name for name, value in vars(plot).items() if callable(value)}
    assert public - {"animate", "explore", "save"} == {name.partition(",")[0] for name in PANEL | PANELS}


@pytest.mark.ci
@pytest.mark.parametrize("width", [None, 85, 170])
@pytest.mark.parametrize("name", [*PANEL, *PANELS])
def test_a_picture_fits_its_width(name, width, made):
    if name in PANELS:
        figure = PANELS[name](made, width=width)
    elif width is None:
        figure = PANEL[name](made, ax=None).figure
    else:
        with plot.style.use(figure__figsize=(width * MM, plot.style.HEIGHT)):
            figure = PANEL[name](made, ax=plt.subplots()[1]).figure
    if width is not None:
        assert figure.get_figwidth() == pytest.approx(width * MM)
    nothing_is_cut(figure)
    every_curve_has_a_name(figure)
    plt.close("all")


def nothing_is_cut(figure):
    """All is inside the figure, of 6 points or more; no legend is on the data, and no two labels of an axis overlap."""
    figure.draw_without_rendering()
    for ax in filter(lambda ax: ax.get_visible(), figure.axes):
        assert all(edge >= -1 for edge in ax.get_tightbbox().p0)
        assert all(edge <= end + 1 for edge, end in zip(ax.get_tightbbox().p1, figure.bbox.p1, strict=True))
        if legend := ax.get_legend():
            box, frame = legend.get_window_extent(), ax.get_window_extent()
            assert box.y0 >= frame.y1 - 1 or box.x0 >= frame.x1 - 1
        for axis in (ax.xaxis, ax.yaxis):
            low, high = np.sort(axis.get_view_interval())
            ticks = [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high and tick.label1.get_text()]
            boxes = [label.get_window_extent() for label in ticks if label.get_visible()]
            assert not any(one.overlaps(other) for one, other in zip(boxes, boxes[1:], strict=False))
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip():
            assert text.get_fontsize() >= 6, text.get_text()
    for legend in figure.legends:
        assert figure.bbox.containsx(legend.get_window_extent().x0)


def every_curve_has_a_name(figure):
    """Each label is in a legend, once; and each colour of solid curves has a label of its own."""
    for ax in filter(lambda ax: ax.get_legend(), figure.axes):
        entries = [text.get_text().replace("\n", " ") for text in ax.get_legend().get_texts()]
        assert len({*entries}) == len(entries)
        assert {*ax.get_legend_handles_labels()[1]} <= {*entries}
        curves = [line for line in ax.lines if line.get_linestyle() == "-" and len({*line.get_xdata()}) > 2]
        colours = {to_hex(line.get_color()) for line in curves}
        names = {line.get_label() for line in curves if not line.get_label().startswith("_")}
        assert len(names) >= len(colours), (names, colours)


@pytest.mark.ci
def test_curves_that_differ_in_the_height_of_the_block_alone_are_named_by_specimen():
    """Both blocks are pushed at the same heights, which the legend names."""
    m = sp.Measurements([20.0, 20, 24, 24], 0.3, [8.0, 12, 8.5, 12.6], 2.0, push_height=[5.0, 8, 5, 8], specimen=[*"PPQQ"])
    ax = plot.length_versus_stiffness(sp.fit(m))
    curves = [line for line in ax.lines if line.get_linestyle() == "-" and len(line.get_xdata()) > 2]
    assert len({line.get_color() for line in curves}) == 4
    assert {line.get_label().rpartition(", ")[2] for line in curves} >= {"P", "Q"}
    assert len({line.get_label() for line in curves}) == 4
    plt.close("all")


def test_points_are_where_they_were_measured():
    """Several at one height are open, so that all can be seen."""
    m = sp.Measurements([20.0, 20.0, 40.0], 0.3, [12.4, 12.9, 29.6], 0.3, specimen=[*"ABA"])
    ax = plot.fit_lengths(sp.fit(m))
    found = {points.get_label(): points[0] for points in ax.containers}
    assert [points.get_xdata().tolist() for points in found.values()] == [[20.0, 40.0], [20.0]]
    assert {points.get_markerfacecolor() for points in found.values()} == {"none"}
    apart = plot.fit_lengths(sp.fit(sp.Measurements([20.0, 40.0], 0.3, [12.6, 29.6], 0.3)))
    assert apart.containers[0][0].get_markerfacecolor() != "none"
    plt.close("all")


def test_the_stiffness_axis_is_about_the_interval(worked):
    """From a decade and a half below to as much above, not over the whole range searched."""
    result = worked("pmma_block")
    low, high = plot.length_versus_stiffness(result).get_xlim()
    (interval,) = result.intervals["areal_stiffness"][0.95]
    np.testing.assert_allclose([interval.low / low, high / interval.high], 10**1.5, rtol=1e-6)
    plt.close("all")


def test_the_largest_drops_of_the_force_are_marked():
    catalogue = sp.series(sp.chain(ended(sp.Slider(10.0, 0.03, 0.3), 40)), events=60)
    drop = np.asarray(catalogue.force_before - catalogue.force_after)
    ax = plot.friction_curve(catalogue)
    marked = np.concatenate([line.get_xdata() for line in ax.lines if line.get_marker() == "."])
    np.testing.assert_allclose(np.sort(marked), np.asarray(catalogue.load)[drop >= 0.1 * np.nanmax(drop)])
    assert {line.get_label() for line in ax.lines} <= {"force", "edge", "renucleated", "interior", "spanning"}
    plt.close("all")


def test_a_width_and_axes_are_not_given_together(worked):
    ax = plt.subplots(1, 2)[1][0]
    with pytest.raises(ValueError, match="give one of them"):
        plot.fit(worked("pmma_block"), width=85, ax=ax)
    plt.close("all")
