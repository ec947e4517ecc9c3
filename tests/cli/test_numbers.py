"""Numbers on the command line are written as in tables; a table may come from standard input."""

import importlib
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

import slippulse_jax as sp
from slippulse_jax.cli import fit, sweep
from slippulse_jax.cli.main import COMMANDS
from slippulse_jax.cli.shared import Values

ROOT = Path(__file__).resolve().parents[2]
BY_CALLBACK = {fit._pairs: "poisson={}", sweep._pair: "{}/4"}
"""Options whose text is read by a callback, and how a number stands in it."""


def options_of_numbers():
    for name in COMMANDS:
        command = importlib.import_module(f"slippulse_jax.cli.{name}").command
        for one in command.params:
            if (
                isinstance(one.type, click.types.FloatParamType | click.types.IntParamType | Values)
                or one.callback in BY_CALLBACK
            ):
                yield pytest.param(command, one, id=f"{name}{one.opts[-1]}")


def refusal(command, arguments):
    with pytest.raises(click.UsageError) as caught:
        command.make_context("slippulse", arguments)
    return caught.value.format_message()


@pytest.mark.parametrize(("command", "option"), [*options_of_numbers()])
def test_what_a_table_refuses_is_no_number_here(command, option):
    """`float` and `int` take underscores between digits, digits of all scripts, and nan."""
    form = BY_CALLBACK.get(option.callback, "{}")
    for text in ("2_5", "２５", "٢٥", "1_0e9", "nan", "2 5", "0x19", "2;5"):
        said = refusal(command, [option.opts[-1], *[form.format(text)] * option.nargs])
        assert option.opts[-1] in said
        assert text in said
        assert "not a number" in said or "NAME=NUMBER" in said or "index/number" in said
    if isinstance(option.type, Values):
        for text in ("1:2_0:3", "1:20:1_0", "1,2_0", "1:20:３", "1:20:3.5"):
            assert "is not a number, a list" in refusal(command, [option.opts[-1], text])


def test_there_are_many():
    assert len([*options_of_numbers()]) > 60


@pytest.mark.parametrize(
    ("text", "value"), [("25", 25.0), (" 25.", 25.0), ("-.5E+1", -5.0), ("inf", np.inf), ("1:3:3", [1, 2, 3]), ("1, 2", [1, 2])]
)
def test_what_a_table_takes_is_one(text, value):
    np.testing.assert_array_equal(Values().convert(text, None, None), value)


@pytest.mark.parametrize("height", ["2_5", ["2_5"], [20.0, "3_0"], "２５", ["٢٥"], b"25"])
def test_a_sweep_takes_numbers(height):
    with pytest.raises((TypeError, ValueError), match="height"):
        sp.sweep(height=height, stiffness=0.03, poisson=0.3)


@pytest.mark.parametrize("error", ["0_01", "０.1", "guess"])
def test_the_error_of_a_model_is_a_number_or_a_word(error):
    done = CliRunner().invoke(
        fit.command, ["--example", "sequence", "--free", "stiffness", "--free", "friction", "--model-error", error]
    )
    assert done.exit_code == 2
    assert f"model_error = '{error}'" in done.stderr


def test_a_table_from_standard_input():
    """The same report as of the file, but for its name; also after a mark of byte order, and for errors."""
    table = (ROOT / "fit_examples/pmma_block/lengths.csv").read_text(encoding="utf-8")
    of_file = CliRunner().invoke(fit.command, [str(ROOT / "fit_examples/pmma_block/lengths.csv"), "--json"])
    for text in (table, "\ufeff" + table):
        done = CliRunner().invoke(fit.command, ["-", "--json"], input=text.encode())
        assert done.exit_code == 0, done.output
        assert done.stdout.replace("standard input", "lengths.csv").count("lengths.csv") == of_file.stdout.count("lengths.csv")
    for text, said in (
        ("", "standard input"),
        (table.replace("75,", "x,"), "standard input, line"),
        ("\0", "standard input: holds NUL"),
    ):
        done = CliRunner().invoke(fit.command, ["-"], input=text.encode())
        assert done.exit_code == 2
        assert said in done.stderr
    for twice in (["-", "--gauges", "-"], ["-", "--request", "-"], ["x.csv", "--gauges", "-", "--request", "-"]):
        done = CliRunner().invoke(fit.command, twice, input=table.encode())
        assert done.exit_code == 2
        assert "- is standard input, which can be read once" in done.stderr
