"""Mutation testing: do the tests notice a changed operator, number or comparison where results are computed?

Mutants are made and run one by one by Cosmic Ray, in a copy of the tree: a seeded sample of each module against the tests named
for it here. What was done is kept in ``.pytest_cache/mutation``, so that a campaign that was stopped goes on.

Run::

    python tests/mutate.py                    # all modules
    python tests/mutate.py chain modes        # some
    python tests/mutate.py chain --again      # survivors only, after a change to the tests
    python tests/mutate.py --report --write   # none: write docs/tables/mutation.md of what was run, and leave its other rows
"""

import argparse
import ast
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

from cosmic_ray.commands import execute, init
from cosmic_ray.config import ConfigDict
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, WorkItem, WorkResult

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / ".pytest_cache" / "mutation"
TABLE = ROOT / "docs" / "tables" / "mutation.md"

MODULES = {
    "bodies/modes": "tests/front/test_front.py tests/front/test_ends.py tests/inference/test_fields.py tests/front/test_derivatives.py "
    "-k 'not semi-infinite-300 and not million and not hessian'",
    "front/front": "tests/front/test_front.py tests/front/test_interface.py tests/bulk/test_bulk.py "
    "-k '(not semi-infinite-300 and test_front) or profile_against or profile_that or soft_short or under_prestress or (test_interface and dense_chain) or sensitivity_takes or company or test_bulk'",
    "exact/crossing": "tests/exact/test_exact.py tests/exact/test_exact_lanes.py "
    "-k 'not sixty and not hessian and not resonan and not gradient and not modes and not exponents'",
    "exact/double_series": "tests/exact/test_exact.py tests/exact/test_exact_fields.py tests/exact/test_rebreaking.py "
    "-k 'not lanes and not every_mode and (not test_rebreaking or edge_stress_of_random)'",
    "bodies/chain": "tests/events/test_cascade.py tests/bodies/test_equilibrium.py "
    "-k 'inverse or dense_matrices or lattice_modes or floating or (refus and not differentiated) or interface or slopes or driver or by_default'",
    "bodies/equilibrium": "tests/bodies/test_equilibrium.py -k 'not continuum and not unrolled and not long_chain and not cut'",
    "events/rupture": "tests/events/test_cascade.py tests/front/test_surrogate.py "
    "-k '(test_cascade and not hundred_thousand and not devices and not size_of and not surrogate) or chain_approaches or same_smooth'",
    "inference/search/likelihood": "tests/inference/test_fit_parameters.py tests/inference/test_fit_ends.py "
    "-k 'gradient_is or of_a_count or counts_of or traced_density or least_density or parts_of or losses'",
}
"""Modules, and the tests that should see a change there, quick ones first."""

EQUIVALENT: dict[tuple[str, str], str] = {
    ("bodies/modes", 'MACHINE.check("machine", np.where(known >= np.inf, 1, known))'): "nothing exceeds inf",
    (
        "front/front",
        "return jnp.where(stopped, length, instead * (1 + jnp.where(jnp.isnan(length), 1, jnp.abs(length))))",
    ): "a factor on 0, inf or NaN",
    ("front/front", "reach = modes.weight + (modes.echo_factor(0 / one)[:, None] * modes.reflection).sum(0)"): "0/1 is 0",
    (
        "front/front",
        "stress = stress_ahead(front, echo)[ 1] + contact_at(modes, contacts, front.position)[1]",
    ): "of one element, JAX takes the last",
    (
        "front/front",
        "threshold, prestress = contact_at(modes, contacts, max(since * 1, 0))",
    ): "beyond its last site a profile stays as it is there",
    (
        "inference/search/likelihood",
        "slope = self(around.reshape(- 2, p), np.repeat(lane, around.shape[1]), 1).gradient",
    ): "NumPy takes any negative size for the one that is left",
    (
        "bodies/chain",
        "return (bonds + sites + end) / 2 - chain.stiffness * (chain.prestress * pinning).sum(where=chain.contact != 0)",
    ): "no contact has a negative stiffness",
    ("bodies/chain", "attached = self.contact != 0"): "no contact has a negative stiffness",
    (
        "bodies/chain",
        "floating = determinant(Springs(B + site.upper, K + site.layer, site.across)) == 0",
    ): "no stiffness is negative where it is asked",
    (
        "bodies/chain",
        "first = beside(Springs(*(x[ -1] for x in beyond)), chain.across[0], contact[0])",
    ): "K_T > 0 alone holds the first site",
    (
        "events/rupture",
        "per_load = jnp.where(chain.contact > -1, equilibrium(chain, State(state.pinning, state.load + 1)).stress - now, 0)",
    ): "a detached contact carries no stress at any load",
    ("events/rupture", "pulled = per_load != 0"): "no stress falls as the load rises, not even by rounding",
    (
        "events/rupture",
        "overloaded = ((now >= chain.threshold) & (chain.contact >= 0)).any()",
    ): "a detached contact carries no stress, and thresholds are positive",
    (
        "events/rupture",
        "overloaded = ((now >= chain.threshold) & (chain.contact > -1)).any()",
    ): "a detached contact carries no stress, and thresholds are positive",
    (
        "events/rupture",
        "slip = done.given.reshape(-1)[:n] * safe.stiffness / jnp.where(safe.contact != 0, safe.contact, jnp.inf)",
    ): "no contact has a negative stiffness",
    ("events/rupture", "t = stress + contact * arriving[ 2]"): "of two elements, JAX takes the last",
    (
        "exact/double_series",
        "z0, z1 = jnp.where(small, z, 1), jnp.where(small, 1, z)",
    ): "the sum of z0 is taken only where z is small",
    (
        "exact/crossing",
        "gone = ~checked & ((loss <= 0) & ~(bend < 0) | (s * found.system.rate[1] >= 60))",
    ): "at 60 already, e⁻⁶⁰ is left of what decays",
}
"""Mutants that change no result, as (module, mutated line), and why."""

REPLACED = (
    r"ReplaceBinaryOperator_(Add|Sub|Mul|Div|Pow)_(Add|Sub|Mul|Div)",
    r"ReplaceBinaryOperator_(BitOr_BitAnd|BitAnd_BitOr)",
    r"ReplaceComparisonOperator_(Eq|NotEq|Lt|LtE|Gt|GtE)_(Eq|NotEq|Lt|LtE|Gt|GtE)",
    r"ReplaceComparisonOperator_(Is_IsNot|IsNot_Is)",
    r"ReplaceUnaryOperator_(USub_UAdd|Delete_\w+)",
    r"AddNot|ReplaceTrueWithFalse|ReplaceFalseWithTrue|ReplaceAndWithOr|ReplaceOrWithAnd|NumberReplacer|ZeroIterationForLoop",
    r"ReplaceBreakWithContinue|ReplaceContinueWithBreak",
)
"""Changes that are made. Others, such as a shift for a sum, are errors of type that any test would notice."""


def spared(source: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Parts of a module that are not mutated: annotations, decorators and messages."""
    parts: list[ast.AST | None] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs, node.args.vararg, node.args.kwarg]
            parts += [node.returns, *node.decorator_list, *(one.annotation for one in arguments if one)]
        elif isinstance(node, ast.AnnAssign):
            parts.append(node.annotation)
        elif isinstance(node, ast.Raise):
            parts.append(node)
    parts += [one for one in ast.parse(source).body if isinstance(one, ast.Assign) and "|" in ast.unparse(one)]  # types
    return [((p.lineno, p.col_offset), (p.end_lineno, p.end_col_offset)) for p in parts if p]


def draw(items: Iterator[WorkItem], count: int, seed: int, module: str) -> list[WorkItem]:
    """A sample of the mutants of a module, in the order of its lines."""
    kept = spared((ROOT / "slippulse_jax" / f"{module}.py").read_text(encoding="utf-8"))

    def wanted(item: WorkItem) -> bool:
        (one,) = item.mutations
        name = one.operator_name.removeprefix("core/")
        inside = any(start <= one.start_pos and one.end_pos <= end for start, end in kept)
        return not inside and any(re.fullmatch(pattern, name) for pattern in REPLACED)

    def place(item: WorkItem) -> tuple:
        (one,) = item.mutations
        return one.start_pos, one.operator_name, one.occurrence

    found = sorted(filter(wanted, items), key=place)
    return sorted(random.Random(f"{seed} {module}").sample(found, min(count, len(found))), key=place)


def settings(module: str, timeout: float) -> ConfigDict:
    """What Cosmic Ray is told."""
    command = f"{sys.executable} -m pytest -q -x -n 0 -p no:cacheprovider --tb=line -m 'not slow' {MODULES[module]}"
    return ConfigDict({"test-command": command, "timeout": timeout, "distributor": {"name": "local"}})


def in_copy(module: str, session: WorkDB) -> None:
    """Run what is left of a session in a copy of the tree, whose files are mutated in place."""
    with tempfile.TemporaryDirectory() as copy:
        listed = subprocess.run(
            ["git", "ls-files", "-z", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, check=True
        )
        for name in filter(None, listed.stdout.decode().split("\0")):
            (target := Path(copy, name)).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
        os.environ.setdefault("SLIPPULSE_TEST_CACHE", str(ROOT / ".pytest_cache" / "compiled"))
        os.environ["PYTHONPATH"] = copy
        with chdir(copy):
            began = time.perf_counter()
            subprocess.run(shlex.split(settings(module, 0).test_command), check=True)  # nothing is mutated yet
            took = time.perf_counter() - began
            print(f"{module}: {session.num_work_items - session.num_results} mutants, {took:.0f} s each if they survive")
            execute(session, settings(module, 120 + 4 * took))


def changed(result: WorkResult, sign: str) -> str:
    """The line that a mutant changes, before ("-") or after ("+")."""
    return next(line[1:].strip() for line in result.diff.splitlines() if line.startswith(sign) and line[:3] != 3 * sign)


def campaign(module: str, count: int, seed: int, again: bool, report: bool) -> list[tuple[MutationSpec, WorkResult]]:
    """Make and run a sample of the mutants of one module, or go on with it."""
    KEPT.mkdir(parents=True, exist_ok=True)
    path = KEPT / f"{module.replace('/', '.')}-{seed}-{count}.sqlite"
    with use_db(path) as session:
        if not session.num_work_items:
            with chdir(ROOT):
                init([Path("slippulse_jax", f"{module}.py")], session, {})
            items = draw(iter(session.work_items), count, seed, module)
            session.clear()
            session.add_work_items(items)
        waiting = session.num_results < session.num_work_items
        if again and not report:
            kept = [
                (item, result)
                for item, result in session.completed_work_items
                if result.is_killed or (module, changed(result, "+")) in EQUIVALENT
            ]
            items = session.work_items
            session.clear()
            session.add_work_items(items)
            for item, result in kept:
                session.set_result(item.job_id, result)
            waiting = len(kept) < len(items)
        if waiting and not report:
            in_copy(module, session)
        done = [(item.mutations[0], result) for item, result in session.completed_work_items]
    return sorted(done, key=lambda one: one[0].start_pos)


def rows(module: str, done: list[tuple[MutationSpec, WorkResult]]) -> tuple[str, list[str]]:
    """A line of the table, and its survivors: line, original and mutant, and why if it is equivalent."""
    equivalent, survived = 0, []
    for one, result in done:
        if result.is_killed:
            continue
        why = EQUIVALENT.get((module, changed(result, "+")))
        equivalent += why is not None
        before, after = (changed(result, sign).replace("|", "\\|") for sign in "-+")
        survived.append(f"| {module} {one.start_pos[0]} | `{before}` | `{after}` | {why or 'not seen'} |")
    killed = len(done) - len(survived)
    score = killed / max(1, len(done) - equivalent)
    return (
        f"| {module} | {len(done)} | {killed} | {equivalent} | {len(survived) - equivalent} | {100 * score:.0f} % |",
        survived,
    )


def main() -> None:
    """Run campaigns, and print or write their table."""
    parser = argparse.ArgumentParser(description="Mutate modules and see whether their tests notice.")
    parser.add_argument("modules", nargs="*", help=", ".join(MODULES))
    parser.add_argument("--count", type=int, default=25, help="mutants per module")
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--again", action="store_true", help="run survivors again, except equivalent ones")
    parser.add_argument(
        "--report", action="store_true", help="run none, and report those that were run: a random part of the sample"
    )
    parser.add_argument("--write", action="store_true", help="write docs/tables/mutation.md")
    asked = parser.parse_args()
    chosen = [module for module in MODULES if not asked.modules or any(module.endswith(one) for one in asked.modules)]
    lines, survivors, before = [], [], TABLE.read_text(encoding="utf-8").splitlines()
    for module in MODULES:
        done = campaign(module, asked.count, asked.seed, asked.again, asked.report) if module in chosen else []
        if not done:  # the table goes on saying what it said
            lines += [row for row in before if row.startswith(f"| {module} |")]
            survivors += [row for row in before if re.match(rf"\| {module} \d+ \|", row)]
            continue
        line, survived = rows(module, done)
        lines.append(line)
        survivors += survived
        print(line, *survived, sep="\n", flush=True)
    head = "| module | mutants | killed | equivalent | not seen | score |", "|---|---|---|---|---|---|"
    listed = "", "| survivor | line | mutant | why |", "|---|---|---|---|"
    if asked.write:
        table = "\n".join([*head, *lines, *(listed if survivors else ()), *survivors]) + "\n"
        TABLE.write_text(table, encoding="utf-8")


if __name__ == "__main__":
    main()
