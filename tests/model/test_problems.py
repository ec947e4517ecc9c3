"""The table of named sliders against the independent programs, without the package; and the programs against each other."""

import ast
from pathlib import Path

import mpmath as mp
import numpy as np
import oracles
import problems
import pytest
from oracles import dense_chain
from oracles.lattice_mp import Chain

ARRESTED = {
    name: x
    for name, x in [
        *((name, x) for name, x in vars(problems).items() if isinstance(x, problems.Problem)),
        *((f"PRESTRESSED[{x.prestress}]", x) for x in problems.PRESTRESSED),
    ]
    if x.contacts > 0
}

NAMES = [
    name if name in ("PAPER", "NO_DOMINO", "REBREAK", "LONG") else pytest.param(name, marks=pytest.mark.ci) for name in ARRESTED
]


@pytest.fixture(autouse=True)
def sixty_digits():
    with mp.workdps(60):
        yield


@pytest.mark.parametrize("name", NAMES)
def test_lengths_and_load_in_sixty_digits(name):
    """Counted break by break; ℓ* from the series in between."""
    x = ARRESTED[name]
    chain, s0 = Chain(*x.slider), x.contacts
    series = chain.series(90 if x is problems.RESONANT else 44, x.prestress)
    if s0 < 1000:
        t = chain.recursion(s0 + 1, x.prestress)
        assert all(y >= 1 for y in t[1:s0])
        last = t[max(s0 - 5, 0) : s0 + 1]
    else:
        last = [series(s) for s in range(s0 - 5, s0 + 1)]
    assert last[-2] >= 1 > last[-1] or s0 == 1
    assert mp.almosteq(chain.load * (1 - mp.mpf(x.prestress)), x.load, 1e-11)
    if s0 == 1:
        assert (x.length, x.exact_length) == (0, 0)
        return
    degree = len(last) - 1
    weights = mp.lu_solve(mp.matrix([[mp.mpf(i - degree) ** j for j in range(degree + 1)] for i in range(degree + 1)]), last)
    end = mp.findroot(lambda y: sum(w * y**j for j, w in enumerate(weights)) - 1, (mp.mpf(-1), mp.mpf(0)), solver="illinois")
    assert mp.almosteq(s0 + end, x.length, 1e-12)
    found = mp.findroot(lambda s: series(s) - 1, (mp.mpf(s0) - 1, mp.mpf(s0)), solver="illinois")
    assert mp.almosteq(found, x.exact_length, 1e-12)


@pytest.mark.parametrize("name", [name for name, x in ARRESTED.items() if x.contacts < 110])
def test_count_and_status_by_dense_solves(name):
    x = ARRESTED[name]
    sites = x.contacts + 20
    count, excess, load, stress = dense_chain.front(*x.slider, np.ones(sites), np.full(sites, x.prestress), 0, sites)
    assert count == x.contacts
    assert abs(load - x.load) < 1e-9
    assert abs(dense_chain.crossing(excess) - x.length) < 1e-9
    assert x.status == ("NO_DOMINO" if count == 1 else "REBREAK" if stress[0] >= 1 else "ARRESTED")


def test_runaway():
    """G_00 is the response of a contact of an endless chain to its own pinning point: from the modes, and from a dense matrix."""
    x, sites = problems.RUNAWAY, 801
    assert mp.almosteq((1 + sum(Chain(*x.slider).w)) / 2, problems.RUNAWAY_PRESTRESS, 1e-14)
    force = np.zeros(2 * sites)
    force[sites + sites // 2] = x.stiffness
    G_00 = np.linalg.solve(dense_chain.chain_matrix(*x.slider, sites), force)[sites + sites // 2]
    assert abs((1 + G_00) / 2 - problems.RUNAWAY_PRESTRESS) < 1e-9
    t = Chain(*x.slider).recursion(400, x.prestress)
    assert all(y > 1 for y in t[1:])
    assert t[-2] > t[-1] > x.prestress / problems.RUNAWAY_PRESTRESS > 1, "it falls, but never below 2φ/(1 + G_00)"
    assert mp.almosteq(Chain(*x.slider).load * (1 - mp.mpf(x.prestress)), x.load, 1e-11)
    above = problems.STOPS_ABOVE
    assert above.prestress > (1 + sum(Chain(*above.slider).w)) / 2


def test_resonance():
    chain = Chain(*problems.RESONANT.slider)
    first, second = chain.roots()
    assert abs(second * chain.r[1] ** 2 / first - 1) < 1e-15


def test_paper_chain_with_an_end():
    """A free end lets TALL run through a hundred sites, and changes the count of PAPER."""
    assert dense_chain.first_precursor(*problems.TALL.slider, 100, "free")[0] == 100
    counts = [dense_chain.first_precursor(*problems.PAPER.slider, 100, right)[0] for right in ("free", "clamped")]
    assert counts == [28, 25]


def test_endless_end_is_what_a_wall_far_away_becomes():
    """Decimation, against adding one site after another to a wall until nothing changes."""
    for height, stiffness, poisson in [problems.PAPER.slider, (1.1, 1.0, 0.5), (100.0, 1e-3, 0.0)]:
        across = 1 / (2 * (1 + poisson) * height)
        bond = np.diag([height, 1.0])
        site = np.array([[across, -across], [-across, across + stiffness]])
        end, change = bond, 1.0
        while change > 1e-16:
            longer = bond - bond @ np.linalg.solve(bond + site + end, bond)
            end, change = longer, abs(longer - end).max() / height
        np.testing.assert_allclose(dense_chain.end_stiffness("semi-infinite", height, 1.0, across, stiffness), end, rtol=1e-10)


def test_programs_are_independent():
    """None imports the package, or JAX; each has its row in the table."""
    folder = Path(oracles.__file__).parent
    files = [
        path for path in folder.glob("*.py") if path.stem != "derivation"
    ]  # the paper's steps, in the package's own formulas
    programs = sorted(path.stem for path in files if path.stem != "__init__")
    for path in (*files, folder.parent / "problems.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {name.split(".")[0] for name in names} & {"slippulse_jax", "jax", "jaxlib"}, path.name
    assert [
        line.split()[0] for line in oracles.__doc__.splitlines() if line.split() and line.split()[0] in programs
    ] == programs
