"""Files of figures as journals take them, whatever the settings: `plot.save`, which the commands and the paper's figures use."""

import importlib
import re
import zlib

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure

import slippulse_jax as sp
from slippulse_jax.base.files import FIGURE_FORMATS
from slippulse_jax.cli.fit import command as fit_command
from slippulse_jax.paper.figures import draw_figures

SETTINGS = [
    {},
    {"pdf.fonttype": 3, "svg.fonttype": "path", "ps.fonttype": 3},
    {"pdf.use14corefonts": True, "font.family": "sans-serif"},
    {"mathtext.fontset": "cm", "font.family": "serif", "savefig.format": "jpg", "savefig.bbox": "tight"},
    {"mathtext.fontset": "stix", "axes.formatter.use_mathtext": True, "pdf.compression": 0},
]


def fonts(path):
    """Types of the fonts in a PDF, also of those in compressed objects; `Type3` are pictures of letters."""
    content = path.read_bytes()
    assert content.startswith(b"%PDF")
    for stream in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", content, flags=re.S):
        try:
            content += zlib.decompress(stream)
        except zlib.error:
            continue
    return {name.decode() for name in re.findall(rb"/Subtype\s*/(Type3|CIDFontType2|TrueType|Type1)\b", content)}


def picture():
    """One of ours, and text with formulas beside it."""
    ax = sp.plot.schematic(sp.Slider(25.0, 0.03, 0.3))
    ax.set_xlabel(r"$\lambda_c \geq \sum_i \sqrt{\kappa_2^{-1}}$, µm")
    return ax


@pytest.mark.parametrize("settings", SETTINGS)
def test_no_pdf_has_letters_as_pictures(settings, tmp_path):
    """Made under any settings, or under the look and saved under others."""
    with mpl.rc_context(settings):
        sp.plot.save(picture(), tmp_path / "a.pdf")
        with sp.plot.style.use():
            drawn = picture()
        sp.plot.save(drawn.figure, str(tmp_path / "b.PDF"))
        sp.plot.save(drawn, tmp_path / "c.svg")
        assert mpl.rcParams["pdf.fonttype"] == settings.get("pdf.fonttype", mpl.rcParamsDefault["pdf.fonttype"])
    for name in ("a.pdf", "b.PDF"):
        assert fonts(tmp_path / name) == {"CIDFontType2"}
    assert "<text" in (tmp_path / "c.svg").read_text()


def test_the_look_of_fonts_can_be_found(tmp_path):
    """Matplotlib's default is what `fonts` looks for."""
    with mpl.rc_context({"pdf.fonttype": 3}):
        picture().figure.savefig(tmp_path / "a.pdf")
    assert "Type3" in fonts(tmp_path / "a.pdf")


def test_no_command_writes_letters_as_pictures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with mpl.rc_context({"pdf.fonttype": 3}):
        for arguments in (
            ["fit", "--example", "own_csv", "--figure", "fit.pdf", "--profiles", "profiles.pdf"],
            ["series", "--height", "25", "--stiffness", "0.03", "--poisson", "0.3", "--sites", "60", "--figure", "series.pdf"],
            [
                "sweep",
                "--height",
                "20:30:3",
                "--stiffness",
                "0.03",
                "--poisson",
                "0.3",
                "--figure",
                "sweep.pdf",
                "--out",
                "s.csv",
            ],
            ["figures", ".", "--format", "pdf"],
        ):
            command = importlib.import_module(f"slippulse_jax.cli.{arguments[0]}").command
            done = CliRunner().invoke(command, arguments[1:])
            assert done.exit_code == 0, (arguments, done.output)
    written = sorted(tmp_path.glob("*.pdf"))
    assert len(written) == 6
    for path in written:
        assert fonts(path) == {"CIDFontType2"}, path


@pytest.mark.parametrize("form", FIGURE_FORMATS)
def test_what_is_drawn_on_is_what_is_written(form, tmp_path):
    """A Figure, an Axes, an Axes of a part of a figure; dark where it is dark, the same file twice, and whole."""
    figure = Figure(facecolor="#101010")
    ax = figure.add_subfigure(figure.add_gridspec(1, 1)[0]).subplots()
    written = []
    for number, one in enumerate((figure, ax, ax.figure)):
        sp.plot.save(one, path := tmp_path / f"{number}.{form}", dpi=50)
        written.append(path.read_bytes())
    assert len({*written}) == 1
    if form == "png":
        seen = plt.imread(tmp_path / "0.png")
        np.testing.assert_allclose(seen[0, 0, :3], 16 / 255, atol=0.01)
        assert seen.shape[:2] == tuple((50 * figure.get_size_inches()[::-1]).astype(int))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(f"{number}.{form}" for number in range(3))


@pytest.mark.parametrize("name", ["a.jpg", "a.eps", "a.tiff", "a", "pdf", "a.pdf.gz"])
def test_another_format_says_what_to_do(name, tmp_path):
    with pytest.raises(ValueError, match=rf"{name}: must end in .png, .pdf or .svg; for another format call figure.savefig"):
        sp.plot.save(Figure(), tmp_path / name)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("thing", [None, "figure", plt, np.array([1.0])])
def test_only_a_figure_is_written(thing, tmp_path):
    with pytest.raises(TypeError, match="figure: give a Matplotlib Figure, or an Axes of one"):
        sp.plot.save(thing, tmp_path / "a.pdf")


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere.a\.png"):
        sp.plot.save(Figure(), tmp_path / "nowhere" / "a.png")


TWICE = [
    ["fit", "table.csv", "--figure", "x.pdf", "--profiles", "x.pdf"],
    ["fit", "table.csv", "--corner", "x.pdf", "--profiles", "./x.pdf"],
    ["fit", "table.csv", "--gauges", "g.csv", "--gauge-figure", "x.svg", "--figure", "sub/../x.svg"],
]


@pytest.mark.parametrize("arguments", TWICE)
def test_two_outputs_are_two_files(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    done = CliRunner().invoke(fit_command, arguments[1:])
    assert done.exit_code == 2
    assert re.search(r"x\.(pdf|svg): is the file of --[a-z-]+ too", done.stderr)
    assert not [*tmp_path.glob("x.*")]


def test_figures_of_the_paper_are_the_same_files_twice(tmp_path):
    for folder in ("a", "b"):
        draw_figures(tmp_path / folder, ["pdf"], ["fig2"])
    assert (tmp_path / "a" / "fig2.pdf").read_bytes() == (tmp_path / "b" / "fig2.pdf").read_bytes()
