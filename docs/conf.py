"""Sphinx's configuration. Build with: python -m sphinx -W --keep-going docs docs/_build/html.

Nothing is executed: notebooks are shown with the outputs they were committed with. Pages that have another home (notebooks,
worked fits, the help of the command line) are written into folders that git ignores when the build starts.
"""

import re
import shutil
import sys
from importlib.metadata import version as version_of
from pathlib import Path

import click
from pygments.lexers.special import TextLexer

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT), str(HERE / "tools")]

project = "slippulse_jax"
author = "The slippulse_jax developers"
copyright = author  # noqa: A001
release = version = version_of("slippulse_jax")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml", "records"]
templates_path = []
exclude_patterns = ["journal", "tools", "_build", "tables", "pictures"]
html_math_renderer = "mathml"
nb_execution_mode = "off"
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["mystnb.unknown_mime_type"]

autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_param = False  # with it every "shape" of an argument is looked up as a name
default_role = "literal"

html_theme = "furo"
html_title = "slippulse_jax"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#005A8E", "color-brand-content": "#005A8E"},
    "dark_css_variables": {"color-brand-primary": "#8FB7EA", "color-brand-content": "#8FB7EA"},
}


def gather(app: object) -> None:
    """Notebooks, worked fits and the command line's help, from where they live."""
    for folder in ("notebooks", "fits"):
        shutil.rmtree(HERE / folder, ignore_errors=True)
        (HERE / folder).mkdir()
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text = path.read_text(encoding="utf-8")
        text = re.sub(r"`docs/([\w/]+)\.md`", r"[\1](../\1.md)", text)  # a page beside them here
        (HERE / "notebooks" / path.name).write_text(text, encoding="utf-8")
    for path in sorted((ROOT / "fit_examples").glob("*/README.md")):
        name = path.parent.name
        text = path.read_text(encoding="utf-8").rstrip()
        text = re.sub(r"\]\((\w+\.(?:csv|py))\)", r"]", text)
        program = (path.parent / "fit.py").read_text(encoding="utf-8").rstrip()
        (HERE / "fits" / f"{name}.md").write_text(
            f"{text}\n\n`fit_examples/{name}/fit.py`:\n\n```python\n{program}\n```\n", encoding="utf-8"
        )
    (HERE / "reference" / "commands.md").write_text(command_line(), encoding="utf-8")


def command_line() -> str:
    """The help of every command, as a page."""
    from slippulse_jax.cli.main import slippulse

    settings = {**slippulse.context_settings, "terminal_width": 84}  # of a block of code on a page
    root = click.Context(slippulse, info_name="slippulse", **settings)
    parts = [
        "# The command line\n",
        "Results go to stdout, progress and errors to stderr. Every command takes `--json`.\n",
        "| exit status | meaning |",
        "|---|---|",
        "| 0 | done |",
        "| 1 | failure |",
        "| 2 | wrong usage or input; one line names the file, line and column |",
        "| 3 | did not converge |",
        "| 4 | the sweep is incomplete |",
        "| 130 | interrupted |\n",
        "`slippulse` keeps compiled programs in the user's cache folder (`~/.cache/slippulse_jax` on Linux), so the next call",
        "starts at once. `slippulse --no-cache …` or `SLIPPULSE_CACHE=off` keeps none. `JAX_COMPILATION_CACHE_DIR` names",
        "another folder, for JAX's own cache only. In a notebook or a job, `SLIPPULSE_PROGRAMS=FOLDER` keeps the larger",
        "programs whole: the next process neither traces nor compiles them.\n",
        f"```text\n{slippulse.get_help(root)}\n```\n",
    ]
    for name in slippulse.list_commands(root):
        command = slippulse.get_command(root, name)
        context = click.Context(command, info_name=name, parent=root)
        parts.append(f"## {name}\n\n```text\n{command.get_help(context)}\n```\n")
    return "\n".join(parts)


COLON = "\ue000"


def hide_colons(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """A colon in the first line of a property is one of the sentence; napoleon would take what is before it for a type."""
    if what in ("property", "attribute"):
        lines[:1] = [line.replace(":", COLON) for line in lines[:1]]


def as_text(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Docstrings write |x| for an absolute value, which reStructuredText would take for a substitution."""
    lines[:] = [line.replace("|", "\\|").replace(COLON, ":") for line in lines]


def setup(app: object) -> None:
    """Called by Sphinx."""
    app.add_lexer("csv", TextLexer)  # pyright: ignore[reportAttributeAccessIssue]
    app.connect("autodoc-process-docstring", hide_colons, priority=100)  # pyright: ignore[reportAttributeAccessIssue]
    app.connect("autodoc-process-docstring", as_text)  # pyright: ignore[reportAttributeAccessIssue]
    app.connect("builder-inited", gather)  # pyright: ignore[reportAttributeAccessIssue]
