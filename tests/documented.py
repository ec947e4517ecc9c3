"""Run what documentation shows, block by block and in its order, as a reader would."""

import re
import runpy
import shlex
from pathlib import Path

from click.testing import CliRunner

BLOCK = re.compile(r"^```(python|sh|csv)\n(.*?)^```$", flags=re.M | re.S)


def blocks(page, *kinds):
    """(kind, text) of the fenced blocks of some kinds on a page."""
    return [(kind, text) for kind, text in BLOCK.findall(Path(page).read_text(encoding="utf-8")) if kind in kinds]


def run_python(text, page, scope):
    exec(compile(text, str(page), "exec"), scope)


def run_shell(text):
    """Commands of this package and programs of a folder, in the current folder; a mistake is an error here."""
    from slippulse_jax.cli.main import slippulse

    for line in text.replace("\\\n", " ").splitlines():
        program, *words = shlex.split(line, comments=True)
        if program == "slippulse":
            done = CliRunner().invoke(slippulse, words, catch_exceptions=False)
            assert done.exit_code == 0, f"{line}\n{done.output}"
        else:
            assert program == "python", line
            runpy.run_path(words[0])["main"](*words[1:])
