"""Time of a fit by kind: the first in a process, compiling, and the next; writes docs/tables/fit_times.md.

``python -m benchmarks fit_times`` runs each kind in a process of its own, without a cache of compiled programs; beginnings of kinds
some of them, and writes nothing.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import slippulse_jax as sp
from benchmarks.timing import seconds

SMALLEST = "lengths"

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "tables" / "fit_times.md"

PMMA = ROOT / "fit_examples" / "pmma_block" / "lengths.csv"
MEASURED = ROOT / "fit_examples" / "own_csv" / "lengths.csv"
SHARED = ROOT / "fit_examples" / "shared_stiffness" / "lengths.csv"
PUSHED = ROOT / "fit_examples" / "pushed_block" / "lengths.csv"
PRESSED = ROOT / "fit_examples" / "pressed_block" / "lengths.csv"
SEQUENCE = ROOT / "fit_examples" / "sequence" / "lengths.csv"
BOTH = ["stiffness", "friction"]

KINDS = {
    "lengths of the slider": lambda: sp.fit(PMMA).report(),
    "measured lengths, with what they share": lambda: sp.fit(MEASURED).report(),
    "the same with 1000 bootstrap draws, no report": lambda: sp.fit(MEASURED).bootstrap(1000, kind="parametric"),
    "the same with a posterior by NUTS, no report": lambda: sp.fit(MEASURED).posterior(),
    'whole events, `event="full"`, $H/\\lambda_c$ ≤ 60': lambda: sp.fit(SHARED, event="full").report(),
    "a block pushed at six heights": lambda: sp.fit(PUSHED).report(),
    "six blocks with friction and an end": lambda: sp.fit(PRESSED).report(),
    "a sequence: stiffness and μ": lambda: sp.fit(SEQUENCE, free=BOTH).report(),
    "a sequence: stiffness, μ and normal load": lambda: sp.fit(SEQUENCE, free=[*BOTH, "normal_load"]).report(),
}


def measure(kind: str) -> list[float]:
    """Times of the first and the next fit of a kind in s, in a process of its own."""
    environment = {name: value for name, value in os.environ.items() if "CACHE" not in name and name != "SLIPPULSE_PROGRAMS"}
    command = [sys.executable, "-m", "benchmarks.fit_times", "--here", kind]
    said = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout
    return json.loads(said.splitlines()[-1])


def main(beginnings: list[str]) -> None:
    rows = ["| fit and report | first, s | again, s |", "|---|---|---|"]
    for kind in [one for one in KINDS if one.startswith(tuple(beginnings or [""]))]:
        first, again = measure(kind)
        rows.append(f"| {kind} | {first:.2g} | {again:.2g} |")
        print(rows[-1], flush=True)
    rows += ["", f"On {os.cpu_count()} cores; the first compiles its programs. `python -m benchmarks fit_times` measures them."]
    if not beginnings:
        PAGE.write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--here"]:
        print(json.dumps([seconds(KINDS[sys.argv[2]]) for _ in range(2)]))
    else:
        main(sys.argv[1:])
