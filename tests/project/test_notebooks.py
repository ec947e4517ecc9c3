"""The notebooks ask one question each, read in 25 minutes, run, and are committed with what they print and draw."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))
QUICK = ("01_the_model_from_scratch.ipynb", "02_scanning.ipynb")
"""Those that CI runs; every night runs the others."""
WORDS = 5000
"""Words of text and code in all notebooks together: 25 minutes at 200 a minute."""

AS_NEW = "%reset -f\nimport jax, matplotlib\njax.config.update('jax_enable_x64', False)\nmatplotlib.rcdefaults()\n%reset -f"
"""A cell that undoes what notebooks set."""


def cells(name, kind=None):
    """Sources of a notebook's cells, of one kind or all."""
    notebook = json.loads((FOLDER / name).read_text(encoding="utf-8"))
    return ["".join(cell["source"]) for cell in notebook["cells"] if kind in (None, cell["cell_type"])]


def test_they_are_read_in_25_minutes():
    words = {name: sum(len(source.split()) for source in cells(name)) for name in NOTEBOOKS}
    assert 0 < sum(words.values()) <= WORDS, words


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_begins_with_a_question_and_ends_with_what_can_go_wrong(name):
    first, *_, last = cells(name)
    assert re.match(rf"# {int(name[:2])} · .+\?\n", first), "the title is the question"
    assert "After this notebook you can" in first
    assert re.search(r"It runs in \d+ s on one core\.", first)
    assert last.startswith("## What can go wrong\n")
    assert 2 <= len(re.findall(r"^- \*\*", last, flags=re.M)) <= 5


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_sentences_are_short(name):
    text = re.sub(r"\$\$.*?\$\$", ".", "\n\n".join(cells(name, "markdown")), flags=re.S)
    sentences = re.split(r"(?<=[.?!:])\s+|\n\n|\n- ", text)
    assert [sentence for sentence in sentences if len(sentence.split()) > 25] == []


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_needs_no_file_of_the_repository(name):
    """A user of the wheel has the package alone."""
    code = "\n".join(cells(name, "code"))
    assert "import slippulse_jax as sp" in code
    assert re.findall(r"fit_examples|\.csv|open\(|Path\(|\.\./", code) == []


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_other_notebooks_and_pages_that_it_names_exist(name):
    text = "\n".join(cells(name, "markdown"))
    linked = set(re.findall(r"\]\(([^)]+)\)", text))
    assert linked <= set(NOTEBOOKS)
    assert {page for page in re.findall(r"`(docs/[\w/]+\.md)`", text) if not (ROOT / page).exists()} == set()


@pytest.fixture(scope="module")
def client():
    """A client of one kernel for all notebooks: what one of them has imported and compiled the next need not."""
    import nbformat  # as long to import as the package with all it needs, and every worker reads this file
    from nbclient import NotebookClient

    client = NotebookClient(
        nbformat.v4.new_notebook(),
        timeout=300,
        kernel_name="python3",
        resources={"metadata": {"path": str(FOLDER)}},
    )
    with client.setup_kernel():
        yield client


@pytest.mark.ci
@pytest.mark.filterwarnings("default")  # of the notebook machinery, which is not ours
@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in NOTEBOOKS])
def test_notebook_runs_and_is_committed_with_its_output(name, client):
    import nbformat

    path = FOLDER / name
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code), "commit notebooks executed"
    assert not any(output.get("name") == "stderr" for cell in code for output in cell.outputs), "commit them without warnings"
    assert any("image/png" in output.get("data", {}) for cell in code for output in cell.outputs), "commit them with pictures"
    assert path.stat().st_size < 300_000
    notebook.cells.append(nbformat.v4.new_code_cell(AS_NEW))
    client.nb = notebook
    client.reset_execution_trackers()
    for number, cell in enumerate(notebook.cells):
        client.execute_cell(cell, number)


def test_there_are_notebooks():
    assert set(QUICK) <= set(NOTEBOOKS)
