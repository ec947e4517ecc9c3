"""The notebooks run, and are committed with what they print and draw."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))
QUICK = ("01_the_model_from_scratch.ipynb", "02_scanning.ipynb")
"""Those that CI runs; every night runs the others."""

AS_NEW = "%reset -f\nimport jax, matplotlib\njax.config.update('jax_enable_x64', False)\nmatplotlib.rcdefaults()\n%reset -f"
"""A cell that undoes what notebooks set."""


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
