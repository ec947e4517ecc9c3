"""The way of a table to the printed report: how often a reader of the program goes back to a file that was left.

The walk follows ``slippulse fit pmma_block/lengths.csv`` as it runs. Each public function at the top level of a module in
`slippulse_jax.inference`, whatever its room, is read once, where it is first called, together with the private ones below it. A
stay is a maximal run of such functions of one module, a return a stay in a module that was left before.
"""

import subprocess
import sys
from itertools import groupby
from pathlib import Path

import pytest

MOST = 6
"""Returns. There were 19 before the result was made in one piece, and 12 before columns were converted where they are described."""
ROOT = Path(__file__).resolve().parents[2]
WALK = """
import sys
from click.testing import CliRunner
from slippulse_jax.cli.fit import command
from slippulse_jax.inference import fit

calls, room = {}, "slippulse_jax.inference."

def follow(frame, event, _):
    module, code = frame.f_globals.get("__name__", ""), frame.f_code
    if event == "call" and module.startswith(room) and code.co_qualname.isidentifier() and not code.co_name.startswith("_"):
        calls.setdefault(code, module.removeprefix(room) + "." + code.co_name)

sys.setprofile(follow)
done = CliRunner().invoke(command, ["fit_examples/pmma_block/lengths.csv"])
sys.setprofile(None)
assert done.exit_code == 0 and "Identified" in done.stdout, done.output
print(*calls.values(), sep="\\n")
"""


@pytest.mark.ci
def test_few_files_are_opened_again_on_the_way_to_the_report():
    done = subprocess.run([sys.executable, "-c", WALK], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    read = done.stdout.split()
    assert read[0] == "table.measurements.read_measurements"
    told = "result.verdict.judge", "result.changes.find_changes", "result.changes.total", "result.report.report"
    assert {"fit.fit", "search.minima.search", *told} <= {*read}
    stays = [module for module, _ in groupby(name.rpartition(".")[0] for name in read)]
    assert len(stays) - len(set(stays)) <= MOST, " ".join(stays)
    # what was computed is printed without computing
    judged, found, total, _ = map(read.index, told)
    assert judged < found < total
