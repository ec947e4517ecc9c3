"""Sliders move the model; tests/plot/test_browser.py moves them in a real browser."""

import re
import sys

import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.front.front import front_fields
from slippulse_jax.plot import explorer

MOVED = (
    ("height", 40.0), ("stiffness", 0.01), ("poisson", 0.2), ("prestress", 0.2), ("slope", 0.001), ("residual", 0.1)
)  # fmt: skip


@pytest.fixture(scope="module")
def widget():
    return sp.plot.explore()


def shown_length(text):
    return float(re.search(r"ℓ = ([\d.]+)", text)[1])


@pytest.mark.ci
def test_it_starts_at_the_papers_slider(widget):
    assert shown_length(widget.numbers.value) == pytest.approx(25.79, abs=0.005)
    assert bytes(widget.picture.value).startswith(b"\x89PNG")
    assert (widget.position.value, widget.position.max) == (26, 26)


@pytest.mark.ci
def test_everything_follows_without_compiling_again(widget):
    before, compiled = widget.picture.value, explorer.view._cache_size()
    for control, value in MOVED:
        getattr(widget, control).value = value
        assert widget.picture.value != before
        before = widget.picture.value
    expected = sp.precursor_length(sp.Slider(40.0, 0.01, 0.2), interface=sp.Interface(0.2, 0.001, 0.1))
    assert shown_length(widget.numbers.value) == pytest.approx(float(expected), abs=0.0051)
    assert widget.play.max == widget.position.max == int(np.ceil(expected))
    widget.position.value = 3
    assert widget.picture.value != before
    assert explorer.view._cache_size() == compiled


def test_stress_is_all_that_the_contacts_carry():
    seen = explorer.view(np.array([25.0, 0.03, 0.3, 0.3, 0.0, 0.0]), np.asarray(0))
    assert seen.fields.stress[0] == pytest.approx(1, abs=1e-12), "at its threshold, before anything has broken"
    assert seen.fields.stress[-1] == pytest.approx(0.3, abs=0.01), "far away its prestress alone"


def test_the_drawing_shows_length_front_and_slopes():
    """Of the paper's slider after ten breaks, and of a front that does not stop."""
    draw = explorer.Drawing(dark=False)
    theta = np.array([25.0, 0.03, 0.3, 0.0, 0.0, 0.0])
    first = draw(explorer.view(theta, np.asarray(10)), theta)
    assert first.startswith(b"\x89PNG")
    assert draw.arrest.get_xdata()[0] == pytest.approx(float(sp.precursor_length(sp.Slider(25.0, 0.03, 0.3))))
    assert {mark.get_xdata()[0] for mark in draw.marks} == {9.5}
    assert draw.words.get_text() == ""
    slopes = dict(zip(explorer.STEPS, (bar.get_width() for bar in draw.bars), strict=True))
    assert all(slopes.values()), "every parameter changes the length"
    assert np.isnan(draw.kept.get_ydata()).all()
    theta[5] = 0.4
    assert draw(explorer.view(theta, np.asarray(10)), theta) != first
    assert draw.arrest.get_xdata()[0] == pytest.approx(
        float(sp.precursor_length(sp.Slider(25.0, 0.03, 0.3), sp.Interface(residual_strength=0.4)))
    )
    np.testing.assert_array_equal(draw.kept.get_ydata(), 0.4)
    theta[3:6] = 0.7, 0, 0
    assert draw(explorer.view(theta, np.asarray(10)), theta) != first
    assert draw.words.get_text() == "the front does not stop"


@pytest.mark.ci
def test_slopes_are_those_of_the_length():
    theta = np.array([25.0, 0.03, 0.3, 0.1, 0.001, 0.2])
    seen = explorer.view(theta, np.asarray(-1))

    def length(x):
        return sp.precursor_length(sp.Slider(*x[:3]), interface=sp.Interface(*x[3:]))

    for i, step in enumerate((1e-4, 1e-7, 1e-6, 1e-6, 1e-8, 1e-6)):
        move = step * np.eye(6)[i]
        slope = (length(theta + move) - length(theta - move)) / (2 * step)
        np.testing.assert_allclose(seen.slopes[i], slope, rtol=1e-4)


@pytest.mark.ci
def test_the_edge_that_breaks_again_is_marked():
    """From the contact on whose break brings contact 0 back to its threshold."""
    seen = explorer.view(np.array([25.0, 0.1, 0.3, 0.0, 0.0, 0.0]), np.asarray(-1))
    front = sp.first_precursor(sp.Slider(25.0, 0.1, 0.3))
    assert 0 < seen.again < seen.front.contacts_broken
    at_edge = [front_fields(front.body, position=int(seen.again) - before, sites=40).stress[0] for before in (0, 1)]
    assert at_edge[0] >= 1 > at_edge[1]
    for theta in ([25.0, 0.03, 0.3, 0.0, 0.0, 0.0], [5.0, 1e-4, 0.3, 0.0, 0.0, 0.0]):
        assert explorer.view(np.array(theta), np.asarray(-1)).again == -1


@pytest.mark.ci
def test_a_front_that_never_stops_is_said_to(widget):
    widget.slope.value = widget.residual.value = 0.0
    widget.prestress.value = 0.7
    assert "does not stop" in widget.numbers.value
    assert bytes(widget.picture.value).startswith(b"\x89PNG")
    widget.prestress.value = 0.0


@pytest.mark.ci
def test_a_dark_page():
    assert bytes(sp.plot.explore(dark=True).picture.value).startswith(b"\x89PNG")


def test_without_ipywidgets_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(ImportError, match=r"slippulse_jax\[explore\]"):
        sp.plot.explore()
