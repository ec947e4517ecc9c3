"""The page about Amontons' law: its numbers again, from finite elements that share no code with the package, and its program."""

import re
from pathlib import Path

import documented
import make_amontons as tool
import numpy as np
import pytest
from events.test_static_friction import dense

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "model" / "amontons.md"
TABLE = ROOT / "docs" / "tables" / "amontons.md"


def text():
    return " ".join(PAGE.read_text(encoding="utf-8").split())


def said(pattern):
    """Numbers in the groups of what the text says once."""
    (found,) = re.findall(pattern, text())
    return np.array(found if isinstance(found, tuple) else [found], float)


def listed(pattern):
    """Numbers of a list, such as "0.1, 0.2 and 0.3"."""
    (found,) = re.findall(pattern, text())
    return np.array(re.findall(r"[\d.]*\d", found), float)


def output():
    """Load, r and coefficient of each line that the page shows."""
    (block,) = re.findall(r"^```text\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.M | re.S)
    return block, np.array(re.findall(r"load ([\d.]+), r ([\d.]+): ([\d.]+)", block), float)


def table():
    """Values by (L/H, b)."""
    head, _, *rows = TABLE.read_text(encoding="utf-8").splitlines()
    stiffnesses = [float(b) for b in re.findall(r"= ([\d.]+)", head)]
    cells = [[float(x) for x in row.strip("| ").split(" | ")] for row in rows]
    return {(length, b): x for length, *values in cells for b, x in zip(stiffnesses, values, strict=True)}


@pytest.fixture
def independent(monkeypatch):
    """Largest force over that of friction; the event with it."""
    monkeypatch.syspath_prepend(ROOT / "fit_examples")

    def of(*case):
        forces, _ = dense(*case)
        return forces.max(), int(forces.argmax())

    return of


def test_table_and_program_are_those_of_the_text():
    assert sorted(table()) == [(length, b) for length in tool.LENGTHS for b in tool.STIFFNESSES]
    assert "{include} ../tables/amontons.md" in text()
    assert said(r"At \$H/\\lambda_c = (\d+)\$:") == [tool.FINE]
    assert said(r"\*μ = ([\d.]+), ν = ([\d.]+); \(b, c\) \$L = (\d)H\$; \(c\) \$b\$ = ([\d.]+)").tolist() == [
        tool.FRICTION, tool.POISSON, tool.LONG, tool.REFERENCE,
    ]  # fmt: skip
    ((_, program),) = documented.blocks(PAGE, "python")
    for part in (f"sp.Block({tool.DRAWN}.0, b", f"friction={tool.FRICTION}", f"{tool.REFERENCE} * load", "sp.Push(0.15, 0.1)"):
        assert part in program
    assert (tool.PUSH.height, tool.PUSH.width) == (0.15, 0.1)
    for words in ("1 to 4", r"\$b\$ = 0.1, 0.3, 1 and 3", r"at \$r\$ = 0, 0.2, 0.5, 0.7 and 0.9"):
        assert len(re.findall(words, text())) == 1, words
    assert min(table().values()) > 0.55, "the picture begins at 0.5"


@pytest.mark.ci
def test_output_of_the_page(capsys):
    ((_, program),) = documented.blocks(PAGE, "python")
    documented.run_python(program, PAGE, {"__name__": "__main__"})
    assert capsys.readouterr().out == output()[0]


@pytest.mark.ci
@pytest.mark.parametrize("row", range(5))
def test_output_of_the_page_by_finite_elements(row, independent):
    _, rows = output()
    assert len(rows) == 5
    load, kept, shown = rows[row]
    assert independent(tool.DRAWN, 3, tool.REFERENCE * load, kept)[0] == pytest.approx(shown, abs=1e-3)


CELLS = [(1, 0.1), (2, 1.0)]


@pytest.mark.parametrize(
    "cell",
    [pytest.param((x, b), marks=pytest.mark.ci if (x, b) in CELLS else pytest.mark.slow) for x, b in sorted(table())],
    ids=str,
)
def test_table_by_finite_elements(cell, independent):
    """From what stiffness on the first break is not at the largest force, too."""
    largest, event = independent(tool.FINE, *cell)
    assert largest == pytest.approx(table()[cell], abs=1e-3)
    begins = dict(zip(tool.LENGTHS, listed(r"From \$b\$ = (.*?) on"), strict=True))
    assert (event > 0) == (cell[1] > begins[cell[0]])


@pytest.mark.slow
def test_table_is_that_of_its_program():
    assert tool.table() == TABLE.read_text(encoding="utf-8")


@pytest.mark.slow
def test_numbers_of_the_text():
    found = listed(r"From \$b\$ = (.*?) on")
    assert found == pytest.approx([tool.creep_begins(tool.FINE, x) for x in tool.LENGTHS], abs=6e-3)
    level = tool.level()
    assert said(r"stays at ([\d.]+) to ([\d.]+), up to \$b\$ = 3") == pytest.approx([level.min(), level.max()], abs=5.1e-3)
    assert "obey it again, at 0.6 μ" in text()
    assert abs(level - 0.6).max() < 0.05
    fine = tool.coefficient
    higher, larger = ((fine(tool.DRAWN, x, 0.1), fine(tool.FINE, y, 0.2)) for x, y in ((4, 2), (3, 3)))
    shown = said(r"a block of \$L = (\d)H\$ and \$b\$ = ([\d.]+) is stronger \(([\d.]+) → ([\d.]+)\)")
    assert shown == pytest.approx((4, 0.1, *higher), abs=6e-4)
    assert said(r"one of \$(\d)H\$ is weaker \(([\d.]+) → ([\d.]+)\)") == pytest.approx((3, *larger), abs=6e-4)
    kept = [fine(tool.FINE, tool.LONG, 1.0, r) for r in tool.KEPT]
    assert listed(r"\(\$b\$ = 1: (.*?) at \$r\$") == pytest.approx(kept, abs=5.1e-3)
    assert fine(tool.DRAWN, tool.LONG, 0.1, 0.4) == pytest.approx(fine(tool.DRAWN, tool.LONG, 0.1), rel=1e-9)
    change = tool.changes(tool.DRAWN, tool.FINE)
    assert listed(r"falls by up to (.*?) at \$b\$") == pytest.approx(list(change.values()), abs=6e-4)
    for length, b in table():
        assert fine(tool.FINE, length, b) < fine(tool.DRAWN, length, b), "falls"


@pytest.mark.slow
def test_stiffnesses_that_follow_the_pressure():
    """At a tenth of the reference load; at it and beyond less than half as much."""
    (most,) = said(r"adds up to ([\d.]+) at low loads")
    low, high = (
        tool.coefficient(tool.COARSE, tool.LONG, b, law="multicontact") - tool.coefficient(tool.COARSE, tool.LONG, b)
        for b in (0.01, 0.3)
    )
    assert low == pytest.approx(most, abs=5e-3)
    assert abs(high) < most / 2
