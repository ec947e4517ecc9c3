"""Text of the user's is drawn as written, whatever it holds: names of specimens and precursors, of files, outputs and series."""

import dataclasses
import io
import warnings
from types import SimpleNamespace

import matplotlib as mpl

mpl.use("Agg")
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

import slippulse_jax as sp
from slippulse_jax.events.catalogue import Catalogue, EventClass
from slippulse_jax.plot.labels import as_written

NAMES = [
    r"$\alpha_{PMMA$", "$", "$$", r"\$", "a$b$c", "x_{", "^", "\\", "_x", "__", "_nolegend_", "two\nlines", "\t_", "bell\x07", "a\x00b",
    "\udcff", "東京", "שלום", "مرحبا", "\ufeffA", "\u202eabc", "\U0010ffff", "%#&~", "y" * 5000, "$" * 99, " ",
]  # fmt: skip


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def written(figure, form="png"):
    """Draw a figure, which fails where Matplotlib takes a text for something else."""
    content = io.BytesIO()
    figure.savefig(content, format=form, dpi=40)
    return content.getvalue()


@pytest.fixture(scope="module")
def legend():
    ax = Figure(figsize=(3, 1)).subplots()
    return ax, ax.plot([0, 1], [0, 1])[0]


@pytest.mark.parametrize("form", [pytest.param("png", marks=pytest.mark.ci), "svg", pytest.param("pdf", marks=pytest.mark.ci)])
def test_every_name_is_drawn_and_in_the_legend(form):
    ax = Figure(figsize=(3, 12)).subplots()
    for name in NAMES:
        ax.plot([0, 1], [0, 1], label=f"{as_written(name)}: $k/K$ = 3")
        ax.plot([0, 1], [0, 1], label=as_written(name))
    ax.set_title(as_written(" ".join(NAMES), 200))
    assert len(ax.legend(fontsize=3).get_texts()) == 2 * len(NAMES)
    drawn = written(ax.figure, form)
    if form == "svg":
        assert all(text in drawn.decode() for text in (r"$\alpha_{PMMA$", "bell\\x07", r"\udcff", r"\u6771\u4eac", "…"))


@pytest.mark.ci
@settings(max_examples=30, deadline=None)
@given(st.text(st.characters(), min_size=1, max_size=12))
def test_any_text_is_drawn(legend, text):
    ax, line = legend
    line.set_label(as_written(text) + " $k/K$")
    ax.legend()
    written(ax.figure)


def test_a_text_is_as_long_as_is_readable_and_keeps_its_end():
    long = "specimen " * 30 + "number 7"
    assert as_written("run 7, $H$") == r"run 7, \$H\$"
    assert len(as_written(long)) == 40
    assert as_written(long).startswith("specimen ")
    assert as_written(long).endswith("…ecimen number 7"[1:])


def test_a_font_that_has_the_sign_is_used():
    with sp.plot.style.use(font__family=["STIXGeneral", "DejaVu Sans"]):
        assert as_written("\u2a5f 7") == "\u2a5f 7"  # which only the first has
    assert as_written("\u2a5f 7") == r"\u2a5f 7"


def lengths(specimen, **columns):
    """Two lengths for each specimen, of k/K near 0.01."""
    height, more = np.tile([20.0, 40.0], len(specimen)), 1 + 0.01 * np.repeat(np.arange(len(specimen)), 2)
    return sp.Measurements(
        height,
        0.3,
        np.tile([12.6, 29.6], len(specimen)) * more,
        0.3,
        specimen=[name for name in specimen for _ in range(2)],
        **columns,
    )


@pytest.mark.ci
@pytest.mark.parametrize("names", [NAMES[:3], ["東\n_{$", "y" * 400, "\udcff"]])
def test_pictures_of_a_fit_of_specimens_of_any_name(names):
    """One stiffness for each, whose names are in titles, legends and below axes."""
    m = lengths(names, source="_$\udcff{.csv")
    result = sp.fit(m, [sp.Parameter("stiffness", each="specimen")], intervals="profile")
    figure = sp.plot.fit(result)
    written(figure)
    said = [text.get_text() for ax in figure.axes if ax.get_legend() for text in ax.get_legend().get_texts()]
    for name in names:
        assert f"{as_written(name)} ± σ" in said
        assert any(text.startswith(f"{as_written(name)}: ") for text in said)
    written(sp.plot.fit_profiles(result))
    theta = result.theta + 0.01 * np.random.default_rng(0).standard_normal((9, len(result.theta)))
    figure = sp.plot.corner(result, dict(zip(names, (theta, theta, theta), strict=True)), nodes=3)
    written(figure)
    assert {as_written(name) for name in names} <= {text.get_text() for text in figure.legends[0].get_texts()}


@pytest.mark.ci
@pytest.mark.parametrize("names", [NAMES[:8], NAMES[8:16]])
def test_pictures_of_a_fit_of_many_specimens(names):
    result = sp.fit(lengths(names), intervals="profile")
    for draw in (sp.plot.fit, sp.plot.fit_profiles):
        written(draw(result))
    for draw in (sp.plot.residuals, sp.plot.length_versus_stiffness):
        written(draw(result).figure)
    said = [text.get_text() for text in sp.plot.fit_lengths(result).get_legend().get_texts()]
    assert {f"{as_written(name)} ± σ" for name in names} <= {*said}


def test_gauges_of_precursors_of_any_name():
    row = np.arange(len(NAMES))
    m = sp.Measurements(
        10.0 + row, 0.3, 8.0, 0.5, correlation_length=1e-3, young=3e9, label=[*NAMES[1:], ""], source="_$\udcff{.csv",
        gauges=sp.Gauges(row=row, position=2e-3 + 0 * row, slip=3e-6 + 0 * row, slip_sigma=5e-7),
    )  # fmt: skip
    sigma = np.full(len(row), 5e-7)
    fitted = SimpleNamespace(
        measurements=m, fitted=m.length, further=[SimpleNamespace(observable="slip", sigma=sigma)], field=lambda *at: at[-1]
    )
    ax = sp.plot.gauge_readings(fitted, "slip", ax=Figure(figsize=(4, 12)).subplots())
    written(ax.figure)
    said = [text.get_text() for text in ax.get_legend().get_texts()]
    assert said[: len(NAMES) - 1] == [as_written(name) for name in NAMES[1:]]
    m = dataclasses.replace(m, label=())
    ax = sp.plot.gauge_readings(SimpleNamespace(**vars(fitted) | {"measurements": m}), "slip", ax=Figure().subplots())
    assert ax.lines[0].get_label() == as_written(m.place(0))
    written(ax.figure)


@pytest.mark.ci
@pytest.mark.parametrize("name", [NAMES[0], "_x{", "東\n\udcff$", "y" * 5000])
def test_maps_and_lines_of_outputs_of_any_name(name):
    """Names and units that a user gave to an output and to an axis of a sweep."""
    x = np.arange(1.0, 12.0)
    output = (("height", name), np.outer(x[:2], x), {"long_name": name, "units": name})
    lines = sp.plot.sweep(xr.Dataset({name + " of": output}, {"height": x[:2], name: x}))
    figure = Figure(figsize=(3, 2))
    bar = xr.Dataset({"ratio": (("height", name), np.outer(x, x), {"units": name})}, {"height": x, name: x})
    sp.plot.sweep(bar, ax=figure.subplots())
    written(figure)
    written(lines.figure)


def events(**columns):
    """A catalogue of these columns."""
    rows = len(columns["load"])
    known = {"kind": np.full(rows, EventClass.EDGE), "site": np.zeros(rows, int), "number": rows} | columns
    return Catalogue(**{name: np.asarray(known.get(name, np.zeros(rows))) for name in Catalogue._fields})


CREEP = events(
    load=[1, 2, 3, 4, 5], force_before=[4.0, 3, 5, 4, 6], extent=[5, 6, 7, 9, 20], site=[0, 5, 6, 7, 8],
    kind=[EventClass.EDGE, *[EventClass.RENUCLEATED] * 3, EventClass.SPANNING],
)  # fmt: skip


def bodies(**options):
    return sp.Block(10.0, 0.04, 0.3, sp.Push(0.25), length=20, **options)


@pytest.mark.parametrize(
    ("body", "interface", "name", "strength"),
    [
        (bodies(friction=0.3), None, r"that of friction, $F/\mu F_N$", 0.8),
        (bodies(friction=0.3), sp.Interface(0.2), r"that of friction, $F/\mu F_N$", 0.8),
        (bodies(friction=0.3, contact_law="multicontact"), None, r"that of friction, $F/\mu F_N$", 0.8),
        (bodies(friction=0.3, top="held"), None, r"at rest, $F/\mu F_{N,0}$", 0.8),
        (bodies(), None, "strength of all contacts", 0.8),
        (bodies(friction=0.0), None, "strength of all contacts", 0.8),
        (bodies(friction=0.3), sp.Profile([2.0]), "strength of all contacts", 1.6),
        (bodies(friction=0.3, top="held"), sp.Profile([1.0, 2.0]), "strength of all contacts", 1.56),
        (bodies(), sp.Interface(threshold_slope=0.1), "strength of all contacts", 1.56),
        (sp.chain(sp.Slider(5.0, 0.1, 0.3), sites=20), None, "strength of all contacts", 2.0),
        (sp.chain(sp.Slider(5.0, 0.1, 0.3), sites=20, contact=[0, *[1] * 19]), None, "strength of all contacts", 1.9),
    ],
)
def test_the_axis_of_the_force_says_over_what_it_is(body, interface, name, strength):
    ax = sp.plot.precursors(CREEP, body, interface=interface, ax=Figure().subplots())
    assert name in ax.get_xlabel()
    assert ("F_N" in ax.get_xlabel() or "F_{N" in ax.get_xlabel()) == ("friction" in name or "rest" in name)
    np.testing.assert_allclose(ax.lines[0].get_xdata() * strength, [4, 3, 5, 4, 6], rtol=1e-5)


def points(ax):
    """Extents drawn as points, full and open."""
    drawn = {"full": [], "none": []}
    for line in ax.lines:
        if line.get_marker() in ("o", "D"):
            drawn[line.get_fillstyle()] += (line.get_ydata() * 20).round().astype(int).tolist()
    return drawn["full"], drawn["none"]


def test_creep_has_no_points_and_what_begins_inside_is_open():
    body = bodies(friction=0.3)
    axes = Figure().subplots(1, 3)
    assert points(sp.plot.precursors(CREEP, body, ax=axes[0])) == ([5], [9, 20])
    assert points(sp.plot.precursors(CREEP, body, least_advance=-np.inf, ax=axes[1])) == ([5], [6, 7, 9, 20])
    assert points(sp.plot.precursors(CREEP, body, least_advance=100, ax=axes[2])) == ([], [20])
    for ax in axes:
        np.testing.assert_array_equal((ax.lines[0].get_ydata() * 20).round(), [5, 6, 7, 9, 20])
        assert ax.get_legend().get_title().get_text() == "open: does not begin at the edge"
    again = events(load=[1, 2], force_before=[1.0, 1.0], extent=[9, 4])  # inside what had slipped
    ax = sp.plot.precursors(again, body, ax=Figure().subplots())
    assert points(ax) == ([9], [])
    assert ax.get_legend().get_title().get_text() == ""


def test_series_of_several_bodies_in_one_picture():
    ax = Figure(figsize=(4, 8)).subplots()
    for name in NAMES:
        sp.plot.precursors(CREEP, bodies(friction=0.3), label=name, ax=ax)
    assert "F_N" in ax.get_xlabel()
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [as_written(name) for name in NAMES]
    written(ax.figure)
    sp.plot.precursors(CREEP, bodies(), label="μ = 0", ax=ax)
    assert "strength of all contacts" in ax.get_xlabel()
