"""Published set-ups: what their records hold, and the blocks made of them."""

import contextlib
import io
import json
import re
from pathlib import Path

import documented
import jax
import numpy as np
import pytest
from click.testing import CliRunner

import slippulse_jax as sp
from slippulse_jax.cli.length import OF_EXPERIMENT
from slippulse_jax.cli.length import command as length_command
from slippulse_jax.experiments import ALL, NEEDED, oslo1d, tromborg2014
from slippulse_jax.inference.table.columns import COLUMNS

DOCS = Path(__file__).resolve().parents[2] / "docs"
REST = {"poisson": 1 / 3, "correlation_length": 2.5e-3, "areal_stiffness": 1.5e10, "push_width": 2.5e-3}
"""What the source of `tromborg2014` does not give."""
OPTIONS = ["--correlation-length-um", "2500", "--areal-stiffness", "1.5e10", "--push-width", str(1 / 30)]
"""The same as options, but for Poisson's ratio."""


def run(*options):
    return CliRunner().invoke(length_command, [*options])


def test_records_are_those_of_their_sources():
    """Typed again from the sources: Table S1, main.cpp, a caption."""
    table_s1 = {"height": 75e-3, "block_length": 140e-3, "block_width": 6e-3, "young": 3e9, "normal_load": 1920}
    table_s1 |= {"push_height": 5e-3, "machine_stiffness": 4e6, "friction": 0.4, "kinetic_friction": 0.17}
    program = {"block_length": 0.1, "cross_section": 1e-4, "young": 2.5e9, "normal_load": 400, "machine_stiffness": 8e5}
    program |= {"friction": 0.7, "kinetic_friction": 0.45}
    said = {"tromborg2014": table_s1, "oslo1d": program, "katano2014": {"normal_load": 400, "push_height": 0}}
    held = {one.name: {k: v for k, v in vars(one).items() if isinstance(v, float)} for one in ALL.values()}
    assert held == said
    assert all(getattr(sp.experiments, name) is one for name, one in ALL.items())


def test_names_are_those_of_columns():
    assert set(NEEDED) - set(COLUMNS) == {"areal_stiffness"}  # what a fit finds
    assert set(OF_EXPERIMENT) == set(NEEDED)
    assert {option for option, _ in OF_EXPERIMENT.values()} <= {one.name for one in length_command.params}


def test_a_block_is_the_record_and_what_it_lacks():
    block = tromborg2014.block(**REST)
    assert tromborg2014.lacks == tuple(name for name in NEEDED if name in REST)
    assert (block.sites, block.plane, block.push.control) == (56, "stress", "displacement")
    numbers = block.height, block.stiffness, block.push.height, block.push.width, block.friction, block.machine
    np.testing.assert_allclose(numbers, (30, 1.5e10 * 2.5e-3 / 3e9, 1 / 15, 1 / 30, 0.4, 4e6 / 6e-3 / 3e9), rtol=1e-12)
    bare = dict.fromkeys(("push_width", "block_length", "machine_stiffness", "friction"))
    other = oslo1d.block(**REST | bare, height=0.05, push_height=0.02, young=1e9, top="held")
    assert repr(other) == repr(sp.Block(20.0, 0.0375, 1 / 3, sp.Push(0.4), top="held"))


def test_derivatives_pass_through_a_record():
    slope = jax.grad(lambda stiffness: tromborg2014.block(**REST, machine_stiffness=stiffness).machine)(4e6)
    assert slope == pytest.approx(1 / (6e-3 * 3e9))


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("tromborg2014", {}, r"^tromborg2014 lacks poisson, correlation_length, areal_stiffness and push_width: give "
         r"block\(poisson=…, correlation_length=…, areal_stiffness=…, push_width=…\), in SI$"),
        ("tromborg2014", {k: v for k, v in REST.items() if k != "poisson"}, r"lacks poisson: give block\(poisson=…\)"),
        ("oslo1d", REST | {"height": 0.01, "push_height": 5e-3}, "^oslo1d lacks block_width: "),
        ("katano2014", REST, "lacks height, block_length, block_width, young, friction and machine_stiffness"),
        ("tromborg2014", REST | {"push_height": 0.0}, "push_height = 0: must be positive, in m"),
        ("tromborg2014", REST | {"block_width": 0.0}, "block_width = 0: the width of a block must be positive"),
        ("tromborg2014", REST | {"poisson": 0.6}, "poisson = 0.6"),
    ],
)  # fmt: skip
def test_missing_numbers_are_all_named(name, given, message):
    with pytest.raises(ValueError, match=message):
        ALL[name].block(**given)


def test_references_say_where_the_numbers_are():
    for name, one in ALL.items():
        text, bibtex = one.cite(), one.cite(bibtex=True)
        for part in (one.title, str(one.year), one.link, one.where):
            assert part in text
            assert f"{{{part}}}" in bibtex
        assert re.match(rf"@(article|misc)\{{{name},\n  author = ", bibtex)
        assert len(re.findall(r"^  \w+ = \{[^{}]+\},?$", bibtex, flags=re.M)) == bibtex.count("\n") - 1
    assert tromborg2014.cite().startswith("J. K. Trømborg, H. A. Sveinsson, J. Scheibert, K. Thøgersen, D. S. Amundsen and A. ")
    assert repr(ALL["katano2014"]) == "Experiment(name='katano2014', normal_load=400, push_height=0)"


def test_a_lattice_with_half_springs_on_its_diagonals_is_isotropic():
    """What the page says of Table S1: ν = 1/3 and k = 3BE/4, from the sum of k d² n n n n over the bonds of a cell."""
    tensor = np.zeros((2, 2, 2, 2))
    for k, bond in [(1, (1, 0)), (1, (0, 1)), (0.5, (1, 1)), (0.5, (1, -1))]:
        d = np.array(bond, dtype=float)
        tensor += k * np.einsum("i,j,k,l", d, d, d, d) / (d @ d)
    c11, c12, c66 = tensor[0, 0, 0, 0], tensor[0, 0, 1, 1], tensor[0, 1, 0, 1]
    assert c66 == pytest.approx((c11 - c12) / 2)
    assert c12 / c11 == pytest.approx(1 / 3)
    assert c11 - c12**2 / c11 == pytest.approx(4 / 3)  # BE over k


@pytest.mark.ci
def test_the_command_takes_the_same_block():
    done = run("--experiment", "tromborg2014", *OPTIONS, "--poisson", str(1 / 3), "--json")
    found = json.loads(done.stdout)
    block = tromborg2014.block(**REST)
    assert found["length"] == pytest.approx(float(sp.precursor_length(block)), rel=1e-9)
    assert found["length_mm"] == pytest.approx(2.5 * found["length"])
    assert (found["sites"], found["machine"]) == (56, pytest.approx(float(block.machine)))
    assert (found["experiment"], found["source"]) == ("tromborg2014", tromborg2014.cite())
    softer = run(
        "--experiment", "tromborg2014", *OPTIONS, "--poisson", str(1 / 3), "--machine", "0.1", "--young-gpa", "6"
    ).stdout
    assert "k/K = 0.00625, ν = 0.333333; 56 contacts long; machine M/K = 0.1; pushed over 0.0333333 H about" in softer
    assert "thresholds of μ = 0.4 times the pressure" in softer
    assert "numbers of tromborg2014: J. K. Trømborg" in softer


@pytest.mark.ci
def test_a_pushed_block_may_end_and_have_a_machine_without_an_experiment():
    si = (
        "--height-mm",
        "5",
        "--correlation-length-um",
        "200",
        "--areal-stiffness",
        "5e9",
        "--young-gpa",
        "3",
        "--poisson",
        "0.3",
    )
    done = run(*si, "--push-height", "0.5", "--block-length-mm", "4", "--machine", "2")
    assert "; 20 contacts long; machine M/K = 2; pushed above 0.5 H" in done.stdout
    assert "ℓ   = none: the front runs through the block" in done.stdout
    block = sp.Block(25.0, 5e9 * 2e-4 / 3e9, 0.3, sp.Push(0.5), length=20, machine=2.0)
    assert sp.precursor_length(block) == np.inf


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["tromborg1"], "'tromborg1' is not one of 'tromborg2014', 'oslo1d', 'katano2014'"),
        (["tromborg2014", *OPTIONS], "tromborg2014 lacks poisson (--poisson): give"),
        (["oslo1d"], "lacks height (--height-mm), block_width (--machine), poisson (--poisson), correlation_length (--corr"),
        (["katano2014"], "young (--young-gpa), poisson"),
        (["tromborg2014", *OPTIONS, "--poisson", "0.3", "--height", "9"], "--height-mm and --height belong to two forms"),
        (["tromborg2014", *OPTIONS, "--poisson", "0.3", "--right", "free"], "--sites and --right are a slider's"),
        (["tromborg2014", *OPTIONS, "--poisson", "0.6"], "poisson = 0.6"),
    ],
)
def test_the_command_says_which_option_is_missing(options, message):
    done = run("--experiment", *options)
    assert done.exit_code == 2
    assert message in done.stderr


def shown(page):
    """Outputs that a page shows, in their order."""
    return re.findall(r"^```text\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.M | re.S)


@pytest.mark.ci
@pytest.mark.parametrize("folder", ["model", "appendix"])
def test_the_page_prints_what_it_shows(folder):
    """In single precision, as a reader's process has it."""
    page, scope, printed = DOCS / folder / "experiments.md", {"__name__": "__main__"}, []
    with jax.enable_x64(False), jax.numpy_rank_promotion("allow"):
        for _, program in documented.blocks(page, "python"):
            with contextlib.redirect_stdout(io.StringIO()) as out:
                documented.run_python(program, page, scope)
            printed.append(out.getvalue())
    assert printed == shown(page)


def test_the_table_repeats_the_ranges_that_are_printed():
    ranges = re.findall(r"^  (first event at .*)$", shown(DOCS / "appendix/experiments.md")[0], flags=re.M)
    assert len(ranges) == 2
    table = (DOCS / "model/experiments.md").read_text(encoding="utf-8")
    assert all(f"| {one} |" in table for one in ranges)
