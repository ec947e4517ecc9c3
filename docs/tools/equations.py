"""Index of the paper's equations, read from the code: the function and test of each.

The labels are in ``equations.csv``. A function, class or field computes what its docstring or comment names after the word
"label" or "labels", or what its `quantity` carries; a test checks what it names after that word, in its docstring or a comment.
"""

import ast
import csv
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import slippulse_jax

PACKAGE = Path(slippulse_jax.__file__).parent
TESTS = Path(__file__).resolve().parents[2] / "tests"

LABEL = r"(?:cra\d+[a-z]?\d?|discr\d)"
NAMED = re.compile(rf"\b[Ll]abels?\s+({LABEL}(?:(?:,\s+and|\s+and|,|–)\s*{LABEL})*)")
PARENTHESIS = re.compile(rf"\(({LABEL}(?:(?:, |–){LABEL})*)\)\s*(?:,.*|;.*)?$")


def equations() -> dict[str, dict[str, str]]:
    """Read the rows of equations.csv by label, in the order of the paper."""
    with open(Path(__file__).with_name("equations.csv"), newline="", encoding="utf-8") as file:
        return {row["label"]: row for row in csv.DictReader(file)}


ORDER = list(equations())


def expand(text: str) -> list[str]:
    """Expand a text like "cra26, cra28–cra33" to its labels, in the paper's order."""
    found: list[str] = []
    for part in re.split(r",\s*and\s+|\s+and\s+|,\s*", text):
        first, *rest = part.split("–")
        if not rest:
            found.append(first)
        else:
            found += [x for x in ORDER if ORDER.index(first) <= ORDER.index(x) <= ORDER.index(rest[0])]
    return found


def named(text: str) -> list[str]:
    """Find the labels that a text names after "label" or "labels"."""
    return [label for match in NAMED.finditer(text) for label in expand(match[1])]


def definitions(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Yield functions and classes with their qualified names, but not those inside functions."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield prefix + node.name, node
            if isinstance(node, ast.ClassDef):
                yield from definitions(node, f"{prefix}{node.name}.")


def in_code(path: Path) -> Iterator[tuple[str, str]]:
    """Yield (label, qualified name) of what a module computes."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    for name, node in definitions(ast.parse(text)):
        for label in named(ast.get_docstring(node) or ""):
            yield label, name
        for decorator in getattr(node, "decorator_list", []):
            if isinstance(decorator, ast.Call) and getattr(decorator.func, "id", "") == "quantity":
                yield from ((label, name) for label in re.findall(LABEL, ast.unparse(decorator)))
        if isinstance(node, ast.ClassDef):
            for field in node.body:
                if isinstance(field, ast.AnnAssign):
                    line = lines[field.lineno - 1]
                    comment = PARENTHESIS.search(line.partition("#")[2])
                    labels = expand(comment[1]) if comment else []
                    if "quantity_field(" in line:
                        labels += re.findall(LABEL, line)
                    yield from ((label, f"{name}.{ast.unparse(field.target)}") for label in labels)


def in_tests(path: Path) -> Iterator[tuple[str, str]]:
    """Yield (label, name) of what the tests of a module check."""
    text = path.read_text(encoding="utf-8")
    for name, node in definitions(ast.parse(text)):
        if name.startswith("test_"):
            segment = ast.get_source_segment(text, node) or ""
            yield from ((label, name) for label in named(segment))


def index() -> dict[str, tuple[list[str], list[str]]]:
    """Find where each label is computed and where a test checks it, as module.name and file::test."""
    computed, tested = defaultdict(list), defaultdict(list)
    sources = [(path, PACKAGE) for path in sorted(PACKAGE.rglob("*.py"))]
    # the steps between two results, which only the tests need
    sources.append((TESTS / "oracles" / "derivation.py", TESTS))
    for path, folder in sources:
        module = ".".join(path.relative_to(folder).with_suffix("").parts)
        if module.startswith("paper."):  # which measures what others compute
            continue
        for label, name in in_code(path):
            if f"{module}.{name}" not in computed[label]:
                computed[label].append(f"{module}.{name}")
    for path in sorted(TESTS.glob("*/test_*.py"), key=lambda path: path.name):
        for label, name in in_tests(path):
            if f"{path.name}::{name}" not in tested[label]:
                tested[label].append(f"{path.name}::{name}")
    unknown = (set(computed) | set(tested)) - set(ORDER)
    if unknown:
        raise ValueError(f"labels that are not in equations.csv: {sorted(unknown)}")
    return {label: (computed[label], tested[label]) for label in ORDER}


def missing() -> list[str]:
    """List the equations without a function or a test."""
    return [
        f"{label}: no {what} names it"
        for label, found in index().items()
        for what, places in zip(("function", "test"), found, strict=True)
        if not places
    ]


def page() -> str:
    """Write the page of the index, as Markdown."""
    rows, known = [], equations()
    for label, (computed, tested) in index().items():
        equation = known[label]
        functions = ", ".join(f"`{x}`" for x in computed)
        checks = "; ".join(x.replace(".py::test_", ": ").replace("test_", "", 1).replace("_", " ") for x in tested)
        rows.append(f"| {equation['number'] or '–'} | {label} | {equation['statement']} | {functions} | {checks} |")
    return "\n".join([HEADER, *rows, ""])


HEADER = """# Index of the paper's equations

Written by `docs/tools/generate_pages.py` from the code; a test fails where an equation has no function or no test. Labels are
those of the paper's LaTeX source. Numbers count the equations as typeset, the Appendix from 26 on; the two lattice equations
have no number, and a label only in a comment. Where the paper errs ([errata](../appendix/errata.md)), the function computes the
corrected form.

| number | label | what | computed by | checked by |
|---|---|---|---|---|"""
