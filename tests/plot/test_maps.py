"""Maps and lines of sweeps can be read at column width, whatever their values span."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import LogNorm

import slippulse_jax as sp
from slippulse_jax import plot
from slippulse_jax.plot import style

HEIGHT = np.geomspace(10, 1000, 40)
STIFFNESS = np.geomspace(1e-4, 0.1, 30)


def swept(length, height=HEIGHT, stiffness=STIFFNESS):
    """A made-up sweep of lengths over heights and stiffnesses."""
    values = length(height[:, None], stiffness).astype(float)
    coords = {"height": height, "stiffness": stiffness, "poisson": 0.3}
    return xr.Dataset({"length": (("height", "stiffness"), values)}, coords)


def drawn(found):
    ax = plot.sweep(found)
    ax.figure.draw_without_rendering()
    return ax


def labels(axis):
    low, high = np.sort(axis.get_view_interval())
    ticks = zip(axis.get_majorticklocs(), axis.get_ticklabels(), strict=True)
    return [text.get_text() for at, text in ticks if low <= at <= high and text.get_text()]


@pytest.mark.ci
@pytest.mark.parametrize(
    "length",
    [
        lambda height, stiffness: height * stiffness**0.2,
        lambda height, stiffness: np.where(height * stiffness < 3e-3, 0, height * stiffness**0.2),
        lambda height, stiffness: 500 + height + 0 * stiffness,
        lambda height, stiffness: height - 400 - 1000 * stiffness,
    ],
    ids=["decades", "with zeros", "no decades", "signs"],
)
def test_labels_of_contours_are_inside_and_apart(length):
    ax = drawn(swept(length))
    boxes = [text.get_window_extent() for text in ax.texts]
    frame = ax.get_window_extent()
    assert len(boxes) > 1
    for i, box in enumerate(boxes):
        assert frame.x0 <= box.x0 < box.x1 <= frame.x1
        assert frame.y0 <= box.y0 < box.y1 <= frame.y1
        assert not any(box.overlaps(other) for other in boxes[:i])


def test_an_axis_of_what_contacts_keep_is_labelled():
    """As an axis, as the value of a line, and as a number above."""
    found = swept(lambda height, stiffness: height * stiffness, HEIGHT[:4]).rename(height="residual_strength")
    found = found.assign_coords(residual_strength=[0, 0.1, 0.2, 0.3])
    assert drawn(found).get_legend().get_title().get_text().replace("\n", " ") == "residual strength, $r$"
    assert drawn(found.isel(stiffness=0)).get_xlabel() == "residual strength, $r$"
    assert drawn(found.isel(residual_strength=1)).get_title("left") == r"$\nu$ = 0.3, $r$ = 0.1"


@pytest.mark.ci
def test_colours_of_decades_are_logarithmic():
    """Zeros have the lowest colour; what is signed, or spans less, is linear."""
    decades = drawn(swept(lambda height, stiffness: np.where(height < 12, 0, height * stiffness**0.2)))
    norm = decades.collections[0].norm
    assert isinstance(norm, LogNorm)
    assert norm(0.0) == 0
    assert norm.vmin > 0
    for length in (lambda height, stiffness: 500 + height + stiffness, lambda height, stiffness: height - 400 + stiffness):
        assert not isinstance(drawn(swept(length)).collections[0].norm, LogNorm)


@pytest.mark.ci
@pytest.mark.parametrize("stiffness", [STIFFNESS, np.geomspace(0.002, 0.08, 30)], ids=["decades", "less than two"])
def test_axes_of_decades_have_two_labels_or_more(stiffness):
    line = swept(lambda height, stiffness: height * stiffness**0.2, stiffness=stiffness).isel(height=[7])
    assert len(labels(drawn(line).xaxis)) >= 2
    assert len(labels(drawn(swept(lambda height, stiffness: height * stiffness**0.2, stiffness=stiffness)).yaxis)) >= 2


@pytest.mark.ci
def test_lines_have_most_of_the_width():
    made = swept(lambda height, stiffness: height * stiffness**0.2, height=np.geomspace(10, 1000, 6))
    made["status"] = (made.length > 200).astype(int) * 2
    for found in (made, made.isel(height=[3])):
        ax = drawn(found)
        assert ax.get_window_extent().width > 0.55 * ax.figure.bbox.width
    assert [text.get_text() for text in drawn(made).get_legend().get_texts()][:3] == ["10", "25.1", "63.1"]


@pytest.mark.ci
def test_values_of_lines_are_told_apart():
    made = swept(lambda height, stiffness: height * stiffness, height=np.array([1000.0, 1001.0, 1002.0]))
    assert [text.get_text() for text in drawn(made).get_legend().get_texts()] == ["1000", "1001", "1002"]


@pytest.mark.ci
def test_a_map_on_a_panel_of_a_larger_figure():
    from matplotlib.figure import Figure

    outer = Figure(layout="constrained", figsize=(style.PAGE, 3))
    panel = outer.subfigures(1, 2)[0].subplots()
    plot.sweep(swept(lambda height, stiffness: height * stiffness**0.2), ax=panel)
    assert panel.texts


def test_a_store_opened_by_xarray_draws_the_length(tmp_path):
    """Which sorts the names of its outputs."""
    request = {"height": [10.0, 20.0, 30.0], "stiffness": [0.01], "poisson": 0.3, "outputs": ["b", "length"]}
    found = sp.sweep(**request, store=tmp_path / "s")
    opened = xr.open_zarr(tmp_path / "s")
    assert next(iter(opened.data_vars)) == "b"
    assert plot.sweep(opened).get_ylabel() == plot.sweep(found, "length").get_ylabel()
