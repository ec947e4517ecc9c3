"""What the figures show, from the numbers they are drawn from."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from slippulse_jax.cli.figures import command
from slippulse_jax.paper import figures


def test_fig2_is_the_papers(tmp_path):
    asked = [str(tmp_path), "--figure", "fig2", "--format", "png", "--format", "svg", "--json"]
    done = CliRunner().invoke(command, asked, catch_exceptions=False)
    files = [Path(name) for name in json.loads(done.output)["files"]]
    assert sorted(p.name for p in files) == ["fig2.png", "fig2.svg", "fig2_fields.csv", "fig2_stress.csv"]
    assert sorted(tmp_path.iterdir()) == sorted(files)  # no temporary file left
    assert files[-1].read_bytes()[:5] == b"<?xml"
    with open(tmp_path / "fig2_stress.csv") as file:
        front = [float(row["front"]) for row in csv.DictReader(file)]
    assert next(s for s, t in enumerate(front) if s and t < 1) == 26
    with open(tmp_path / "fig2_fields.csv") as file:
        edge = next(csv.DictReader(file))
    # the upper layer is held at its edge, the interfacial one almost doubles there (C2)
    np.testing.assert_allclose(float(edge["upper_s26"]), float(edge["upper_s0"]), rtol=1e-9)
    assert 1.7 < float(edge["layer_s26"]) / float(edge["layer_s0"]) < 2
    # the stress peaks at the tip and, behind it, grows with the distance (C3)
    stress = figures.fig2_fields()["stress_s26"]
    assert np.argmax(stress) == 26
    assert np.all(np.diff(stress[:26]) < 0)


@pytest.mark.slow
def test_fig3_numbers():
    table = figures.fig3a()
    here = np.isclose(table["stiffness"], 0.03) & np.isclose(table["height"], 25)
    assert table["contacts"][here] == 26
    assert table["free_L100"][here] == 28
    assert table["clamped_L100"][here] == 25
    again = np.isclose(table["stiffness"], 0.03) & table["breaks_again"]
    assert table["height"][again].min() == 53  # b = 4.1
    through = np.isclose(table["stiffness"], 0.03) & np.isclose(table["height"], 50)
    assert np.isnan(table["free_L100"][through]).all()


def test_unknown_names_are_refused(tmp_path):
    with pytest.raises(ValueError, match="'gif'"):
        figures.draw_figures(tmp_path, formats=("gif",))
    with pytest.raises(ValueError, match="'fig9'"):
        figures.draw_figures(tmp_path, names=("fig9",))
