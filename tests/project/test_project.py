"""Promises of the project as a whole: layers, README, examples, what importing does."""

import ast
import importlib.util
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import documented
import numpy as np
import pytest
from click.testing import CliRunner
from problems import PAPER

import slippulse_jax
import slippulse_jax as sp
from slippulse_jax.cli.fit import command as fit_command

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = Path(slippulse_jax.__file__).parent

# imports run from higher numbers to lower ones, or within a layer; equal numbers of different layers never meet
LAYERS = {
    "base": -2, "bulk": -1,
    "slider": 1, "rules": 1, "interface": 1, "block": 2, "experiments": 3,
    "bodies": 3,
    "front": 4, "exact": 5, "events": 5, "theory": 6, "blocks": 6,
    "lengths": 7, "precursor": 8,
    "inference": 9, "sweeps": 9,
    "plot": 10, "paper": 11,
    "cli": 12,
}  # fmt: skip
WAY_OF_A_FIT = {
    "choices": 0, "table": 1, "model": 2, "observables": 3, "parameters": 4, "search": 5, "result": 6,
    "fit": 7, "objective": 7, "knowledge": 7, "heterogeneous": 7, "mechanism": 8, "design": 8, "recover": 8,
}  # fmt: skip
"""The same of the rooms of `inference`."""


def imports(path):
    """Modules of the package that a file imports, anywhere in it, and the names that it imports from them."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    types_only = [one for one in tree.body if isinstance(one, ast.If) and "TYPE_CHECKING" in ast.unparse(one.test)]
    tree.body = [one for one in tree.body if one not in types_only]
    for node in ast.walk(tree):
        names = (
            [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
            if isinstance(node, ast.ImportFrom) and node.module
            else [a.name for a in node.names]
            if isinstance(node, ast.Import)
            else []
        )
        yield from (name for name in names if name.startswith("slippulse_jax."))


BODIES = "slider", "block", "chain"


@pytest.mark.parametrize(("room", "layers"), [("", LAYERS), ("inference.", WAY_OF_A_FIT)], ids=["package", "inference"])
def test_imports_run_downward(room, layers):
    seen, folder, inside = 0, PACKAGE / room.rstrip("."), f"slippulse_jax.{room}"
    for path in folder.rglob("*.py"):
        layer = path.relative_to(folder).parts[0].removesuffix(".py")
        if layer == "__init__":
            continue
        assert layer in layers, f"{layer} has no place in the layers: give it one"
        for name in imports(path):
            if not name.startswith(inside):
                continue
            other = name.removeprefix(inside).split(".")[0]
            if path.stem in BODIES and name.startswith(("slippulse_jax.events.first", "slippulse_jax.blocks.event")):
                continue  # a body's `contacts` calls up, into the room that computes them
            seen += 1
            assert other == layer or layers[other] < layers[layer], f"{path.name} imports {name}"
    assert seen > 20


@pytest.mark.parametrize(
    "room", ["blocks", "bodies", *(f"inference/{one}" for one in ("table", "model", "observables", "search", "result"))]
)
def test_modules_are_listed_in_the_order_in_which_they_build_on_each_other(room):
    """What the page of a room says: each module once, below all that it imports."""
    listed = re.findall(r"^ *`(\w+)` {3}", (PACKAGE / room / "__init__.py").read_text("utf-8"), flags=re.M)
    assert sorted(listed) == sorted(path.stem for path in (PACKAGE / room).glob("*.py") if path.stem != "__init__")
    inside = f"slippulse_jax.{room.replace('/', '.')}."
    for n, one in enumerate(listed):
        for name in imports(PACKAGE / room / f"{one}.py"):
            assert not name.startswith(inside) or name.removeprefix(inside).split(".")[0] in listed[:n], f"{one} imports {name}"


def test_docstrings_begin_with_twelve_words_at_most():
    """All but so many, which may only become fewer; the paper's claims state themselves."""
    long = []
    for path in (one for one in sorted(PACKAGE.rglob("*.py")) if one.parent.name != "paper"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module) and (text := ast.get_docstring(node)):
                long += [f"{path.name}: {line}" for line in text.splitlines()[:1] if len(line.split()) > 12]
    assert len(long) <= 6, "\n".join(long)


def test_matrices_are_eliminated_one_by_one():
    """jaxlib's elimination of a batch can wait for its own threads for ever: what uses it keeps `vmap` out, as these two do."""
    used = {
        path.stem for path in PACKAGE.rglob("*.py") if re.search(r"jnp\.linalg|jax\.scipy\.linalg", path.read_text("utf-8"))
    }
    assert used == {"guide", "distribution"}  # by sequential_vmap


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").glob("*.py")), ids=lambda path: path.stem)
def test_benchmarks_import_what_there_is(path):
    """Some import rivals that only the extra `bench` installs, so that the names are looked up instead."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("slippulse_jax"):
            for one in node.names:
                if not hasattr(importlib.import_module(node.module), one.name):
                    importlib.import_module(f"{node.module}.{one.name}")


@pytest.mark.ci
def test_importing_changes_nothing():
    """Importing the package starts no JAX and flips no flag; every public name is there."""
    code = (
        "import sys, slippulse_jax as sp\n"
        "assert 'jax' not in sys.modules\n"
        "import jax\n"
        "before = dict(jax.config.values)\n"
        "for name in sp.__all__: getattr(sp, name)\n"
        "assert before == dict(jax.config.values)\n"
        "assert set(sp.__all__) <= set(dir(sp))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr


def test_public_names_live_where_the_stub_says():
    """What type checkers read in ``__init__.pyi`` is what users get, about thirty names, and `dir` lists them."""
    for statement in ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8")).body:
        for name in statement.names if isinstance(statement, ast.ImportFrom) else []:
            assert name.asname == name.name, "a stub re-exports a name imported as itself"
            home = importlib.import_module(statement.module)
            assert getattr(slippulse_jax, name.name) is getattr(home, name.name)
    assert 30 <= len(slippulse_jax.__all__) <= 43
    assert dir(slippulse_jax) == sorted(slippulse_jax.__all__)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'precurser_length'"):
        slippulse_jax.precurser_length  # noqa: B018


@pytest.mark.ci
def test_readme_examples_run(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    scope = {}
    for _, block in documented.blocks(ROOT / "README.md", "python"):
        documented.run_python(block, "README.md", scope)
    assert scope["length"] == pytest.approx(PAPER.length, abs=1e-9)
    assert scope["slope"].stiffness > 0
    fitted = slippulse_jax.fit("fit_examples/pmma_block/lengths.csv")
    assert scope["f"].values(scope["theta"])["areal_stiffness"] == pytest.approx(fitted.values["areal_stiffness"], rel=1e-6)
    assert capsys.readouterr().out.startswith("25.78")


def test_readme_commands_are_the_ones_ci_runs():
    def command(number):
        return subprocess.run(
            [sys.executable, ".ci/readme_command.py", str(number)], capture_output=True, text=True, cwd=ROOT, check=True
        ).stdout  # fmt: skip

    assert "slippulse fit" in command(1)
    assert "pytest" in command(2)


def test_readme_table_is_read(tmp_path):
    """The table in README is one that the package takes, and the command beside it is one there is."""
    ((_, table),) = documented.blocks(ROOT / "README.md", "csv")
    (tmp_path / "my_lengths.csv").write_text(table, encoding="utf-8")
    assert slippulse_jax.read_measurements(tmp_path / "my_lengths.csv").length.shape == (2,)


def test_readme_links_lead_somewhere():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)]+)\)", text) if not link.startswith("http")]
    assert links
    for link in links:
        page, _, section = link.partition("#")
        assert (ROOT / page).exists(), link
        headings = re.findall(r"^#+ (.+)$", (ROOT / page).read_text(encoding="utf-8"), flags=re.M) if section else []
        assert not section or section in [heading.lower().replace(" ", "-") for heading in headings], link


EXAMPLES = sorted(path.parent.name for path in (ROOT / "fit_examples").glob("*/fit.py"))


QUICK = ("pmma_block", "pushed_block", "sequence", "threshold_profile")
"""One of a slider, of a block, of its sequence and of an interface that is not uniform; every night runs the others."""


@pytest.mark.ci
@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in EXAMPLES])
def test_fit_example_runs_and_recovers(name, tmp_path, monkeypatch):
    """What its README says to run: main() fits the data and checks what it recovers, and the command line takes them too."""
    shutil.copytree(ROOT / "fit_examples", tmp_path / "fit_examples", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(tmp_path / "fit_examples" / name)
    shutil.copy("lengths.csv", "my_lengths.csv")
    ((_, commands),) = documented.blocks("README.md", "sh")
    assert "python fit.py\n" in commands
    documented.run_shell(commands)


def test_there_are_examples():
    assert len(EXAMPLES) >= 8
    listed = (ROOT / "fit_examples" / "README.md").read_text(encoding="utf-8")
    assert all(f"({name}/README.md)" in listed for name in EXAMPLES)


def test_release_is_one_everywhere():
    """Version, change log and citation agree; the workflow tries the Python versions that the metadata name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text("utf-8")
    latest, date = re.search(r"^## (\S+) \((.*)\)$", (ROOT / "CHANGELOG.md").read_text("utf-8"), flags=re.M).groups()
    assert re.search(r"^version: (\S+)$", citation, flags=re.M)[1] == latest == project["version"]
    assert re.search(r'^date-released: "(.*)"$', citation, flags=re.M)[1] == date
    tried = re.search(r"python: \[(.*)\]", (ROOT / ".github/workflows/test.yml").read_text("utf-8"))[1]
    named = re.findall(r"Python :: (3\.\d+)", " ".join(project["classifiers"]))
    assert re.findall(r"3\.\d+", tried) == named
    assert project["requires-python"] == f">={named[0]}"


def test_every_folder_of_tests_has_its_night():
    jobs = re.findall(r"^ +tests: (.+)$", (ROOT / ".github/workflows/nightly.yml").read_text("utf-8"), flags=re.M)
    folders = {path.parent.relative_to(ROOT).as_posix() for path in (ROOT / "tests").rglob("test_*.py")}
    assert sorted(" ".join(jobs).split()) == sorted(folders)


def test_readme_quotes_the_report():
    """The text below the first command is how its output begins, up to …"""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    quoted = re.search(r"```text\n(.*?)```", text, flags=re.S)[1].splitlines()
    said = CliRunner().invoke(fit_command, [str(ROOT / "fit_examples/pmma_block/lengths.csv")]).stdout.splitlines()
    quoted = quoted[:-1] if quoted[-1].strip() == "…" else quoted
    assert len(quoted) > 5
    assert quoted == said[: len(quoted)]


def test_quantities_are_computed_where_the_table_says():
    """CONTRIBUTING's table: one row per quantity, modules that exist, and independent programs that exist."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.split("## Where each quantity is computed")[1].split("\n## ")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 15
    quantities = [row[0] for row in rows]
    assert len(set(quantities)) == len(quantities)
    for quantity, by, checked in rows:
        for name in re.findall(r"`([\w.]+)`", by):
            assert importlib.util.find_spec(f"slippulse_jax.{name}"), (quantity, name)
        for name in re.findall(r"`(\w+)\.?[\w.]*`", checked):
            assert [*(ROOT / "tests").rglob(f"{name}.py")] or name in ("DenseChain", "Chain"), (quantity, name)


PATHS = {  # a call, the function whose body holds the line, and the most frames of the package from the one to the other
    "precursor_length": (
        lambda: sp.precursor_length(sp.Slider(np.full(37, 25.0), 0.03, 0.3)),  # traced for no other test
        "end_of_front",
        7,
    ),
    "rupture": (lambda: sp.rupture(sp.chain(sp.Slider(25.0, 0.03, 0.3), sites=23)), "next_of", 10),
    "whole event": (lambda: sp.precursor_length(sp.Slider(21.0, 0.1, 0.3, length=87), event="full"), "next_of", 11),
    "block": (
        lambda: sp.precursor_length(sp.Block(24.0, 0.03, 0.3, sp.Push(0.25, 0.1), length=72, friction=0.29)),
        "next_of",
        11,
    ),
}


@pytest.mark.ci
@pytest.mark.parametrize(
    "name", ["precursor_length", "whole event", *(pytest.param(x, marks=pytest.mark.slow) for x in ("rupture", "block"))]
)
def test_a_newcomer_reaches_the_physics_in_few_frames(name):
    """From the public function to the line that computes ℓ, and to the line where a break hands its stress on."""
    call, target, most = PATHS[name]
    depths = []

    def watch(frame, event, _):
        if event == "call" and frame.f_code.co_name == target and frame.f_globals["__name__"].startswith("slippulse_jax"):
            above = 0
            while frame is not None:
                home = frame.f_globals.get("__name__", "")
                above += home.startswith("slippulse_jax") and frame.f_code.co_name[0] != "<"
                frame = frame.f_back
            depths.append(above)

    sys.setprofile(watch)
    try:
        call()
    finally:
        sys.setprofile(None)
    assert depths, "traced before: the test must be the first to ask for these shapes"
    assert max(depths) <= most


@pytest.mark.ci
@pytest.mark.parametrize("name", ["dask", "distributed"])
def test_what_tests_of_ci_are_skipped_without_is_there(name):
    assert importlib.util.find_spec(name) is not None, "install the extra ci"
