"""The animation shows every break of the front, once, and stops where the front does."""

import matplotlib as mpl

mpl.use("Agg")
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import slippulse_jax as sp
from slippulse_jax.events.first import FirstPrecursor
from slippulse_jax.plot.labels import KEPT


@pytest.fixture(scope="module")
def front():
    return sp.first_precursor(sp.Slider(5.0, 0.2, 0.3))  # of few contacts: drawing takes longest


def test_gif_has_a_frame_for_every_break(front, tmp_path):
    path = tmp_path / "front.gif"
    movie = sp.plot.animate(front, path, fps=10, hold=1.0)
    with Image.open(path) as gif:
        durations = []
        for frame in range(gif.n_frames):
            gif.seek(frame)
            durations.append(gif.info["duration"])
    broken = int(front.contacts_broken)
    # frames that do not differ are one, shown for longer
    assert len(durations) == broken + 1
    assert sum(durations) == pytest.approx(1000 * ((broken + 1) / 10 + 1.0))
    assert path.stat().st_size < 1_000_000
    assert list(tmp_path.iterdir()) == [path]
    above, below = movie._fig.axes
    stress = below.lines[2].get_ydata()
    np.testing.assert_allclose(stress, front.stress[: len(stress)], atol=1e-12)
    assert f"contacts broken: {broken}, it stops" in below.texts[0].get_text()
    assert "u_s" in above.get_ylabel()


@pytest.mark.ci
@pytest.mark.parametrize("event", ["domino", pytest.param("full", marks=pytest.mark.slow)])
def test_what_contacts_keep_has_a_line(event):
    """At r θ, of a front on thresholds with a slope, and of a block whose thresholds follow the pressure."""
    with jax.enable_x64(True):
        if event == "domino":
            found = sp.first_precursor(sp.Slider(5.0, 0.2, 0.3), sp.Interface(0.0, 0.01, 0.4))
        else:
            found = sp.first_precursor(sp.Block(6.0, 0.1, 0.3, sp.Push(0.4), friction=0.3), sp.Interface(residual_strength=0.4))
        movie = sp.plot.animate(found)
        movie._func(int(found.breaks))
    below = movie._fig.axes[1]
    _, threshold, kept, stress, *_ = below.lines
    shown = len(stress.get_ydata())
    np.testing.assert_allclose(stress.get_ydata(), found.stress[:shown], atol=1e-12)
    np.testing.assert_allclose(kept.get_ydata(), 0.4 * threshold.get_ydata(), atol=1e-12)
    if event == "domino":
        np.testing.assert_allclose(threshold.get_ydata(), 1 + 0.01 * np.arange(shown), atol=1e-12)
    assert [text.get_text() for text in below.get_legend().get_texts()] == ["at nucleation", "threshold", KEPT]


@pytest.mark.slow
def test_html_and_notebooks(front, tmp_path):
    movie = sp.plot.animate(front, tmp_path / "front.html", sites=14, dark=True)
    page = (tmp_path / "front.html").read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>")
    assert page.count("data:image/png") >= int(front.contacts_broken) + 1
    assert "data:image/png" in movie._repr_html_()


def test_refusals(front, tmp_path):
    with pytest.raises(ValueError, match=r"front\.avi: an animation is written as \.gif"):
        sp.plot.animate(front, tmp_path / "front.avi")
    run_away = sp.first_precursor(sp.Slider(10.0, 0.03, 0.3), interface=sp.Interface(prestress=0.9), sites=4000)
    with pytest.raises(ValueError, match="did not stop"):
        sp.plot.animate(run_away)
    with pytest.raises(ValueError, match="fps = 0"):
        sp.plot.animate(front, fps=0)
    batch = FirstPrecursor(**{**vars(front), "contacts_broken": jnp.array([1, 2])})
    with pytest.raises(ValueError, match="not a batch"):
        sp.plot.animate(batch)
    if not mpl.animation.FFMpegWriter.isAvailable():
        with pytest.raises(RuntimeError, match="ffmpeg"):
            sp.plot.animate(front, tmp_path / "front.mp4")
    assert not list(tmp_path.iterdir())
