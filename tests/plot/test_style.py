"""The one look of all pictures: can every kind of sight tell its colours apart, on paper and on a dark page?"""

import itertools

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest

from slippulse_jax.plot import style

# Machado, Oliveira and Fernandes (2009), severity 1: what a dichromat sees, in linear RGB
SIGHT = {
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def linear(colour):
    """Linear RGB."""
    channel = np.asarray(mpl.colors.to_rgb(colour))
    return np.where(channel <= 0.04045, channel / 12.92, ((channel + 0.055) / 1.055) ** 2.4)


def contrast(one, other):
    """Contrast of two colours by WCAG 2, between 1 and 21."""
    low, high = sorted(linear(colour) @ (0.2126, 0.7152, 0.0722) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


def lab(colour, sight):
    """CIE L*a*b* (D65) of a colour as it is seen."""
    seen = np.clip(np.asarray(SIGHT[sight]) @ linear(colour), 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ seen
    f = np.cbrt(xyz / [0.9505, 1, 1.089])
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHT)
@pytest.mark.parametrize("palette", [style.LIGHT, style.DARK], ids=["light", "dark"])
def test_colours_are_told_apart(palette, sight):
    shown = [*palette.data[:4], palette.ink]
    for one, other in itertools.combinations(shown, 2):
        assert np.linalg.norm(lab(one, sight) - lab(other, sight)) > 16, (one, other)


def test_the_measure_of_colours_can_fail():
    # red and green of equal lightness, the classical trap
    assert np.linalg.norm(lab("#C00000", "deutan") - lab("#4A7000", "deutan")) < 16


@pytest.mark.parametrize("palette", [style.LIGHT, style.DARK], ids=["light", "dark"])
def test_lines_and_text_stand_out(palette):
    assert contrast("#000000", "#FFFFFF") == pytest.approx(21)
    for colour in palette.data[:3]:
        assert contrast(colour, palette.paper) > 3  # WCAG for graphics
    for colour in (palette.grey, palette.ink):
        assert contrast(colour, palette.paper) > 4.5  # WCAG for text


def test_colours_follow_what_they_are_drawn_on():
    figure, (light, dark, clear) = plt.subplots(1, 3)
    dark.set_facecolor("#101010")
    clear.set_facecolor("none")
    assert style.colours(light) is style.LIGHT
    assert style.colours(dark) is style.DARK
    assert style.colours(clear) is style.LIGHT
    figure.set_facecolor("black")
    assert style.colours(clear) is style.DARK
    plt.close(figure)


def test_settings_are_put_back():
    before = dict(mpl.rcParams)
    with style.use(dark=True, figure__figsize=(5, 2)):
        assert mpl.rcParams["figure.facecolor"] == style.DARK.paper
        assert tuple(mpl.rcParams["figure.figsize"]) == (5, 2)
    assert dict(mpl.rcParams) == before


def test_axes_are_made_where_none_are_given():
    ax = style.axes()
    assert ax.figure.get_figwidth() == style.COLUMN
    assert style.axes(ax) is ax
    plt.close(ax.figure)


@pytest.mark.parametrize(
    "settings",
    [style.settings(dark=True), "dark_background", style.settings(), "default"],
    ids=["dark", "mpl dark", "light", "mpl"],
)
def test_a_figure_made_under_any_settings_can_be_read(settings):
    from slippulse_jax import plot

    with plt.style.context(settings):
        ax = plot.front_stress(np.array([1.0, 1.1, 0.9]), length=1.5)
        saved = mpl.rcParams["savefig.facecolor"]
        around = ax.figure.get_facecolor() if saved == "auto" else saved
        words = [ax.xaxis.label, ax.yaxis.label, *ax.get_xticklabels(), *ax.get_legend().get_texts()]
        assert min(contrast(text.get_color(), paper) for text in words for paper in (around, ax.get_facecolor())) > 4.5
        assert min(contrast(line.get_color(), ax.get_facecolor()) for line in ax.lines) > 3
    plt.close(ax.figure)


def test_what_was_changed_of_the_look_holds():
    from slippulse_jax import plot

    with style.use(figure__figsize=(style.PAGE, 2)):
        ax = plot.front_stress(np.array([1.0, 1.1, 0.9]))
    assert tuple(ax.figure.get_size_inches()) == (style.PAGE, 2)
    plt.close(ax.figure)


def test_a_figure_made_by_a_drawing_function_has_the_look_throughout():
    from slippulse_jax import plot

    ax = plot.front_stress(np.array([1.0, 1.1, 0.9]), length=1.5)
    assert ax.get_legend().get_texts()[0].get_fontsize() == style.settings()["legend.fontsize"]
    assert ax.get_legend().get_texts()[0].get_fontsize() != mpl.rcParams["font.size"]
    plt.close(ax.figure)
