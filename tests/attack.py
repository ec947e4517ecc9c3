"""Attack the package: seeded campaigns aimed at the boundaries of what it takes, and a table of what they found.

Run: python tests/attack.py [factor on the number of attempts, 1 by default] [--write] [--only CAMPAIGN …]. With --write the table
goes to docs/tables/attack.md. `test_attack` runs a sample of each campaign. A campaign counts its attempts and describes what
fell: a number called ok that an independent route contradicts or that is no number, and any error but the promised one.
"""

import argparse
import json
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from click.testing import CliRunner

import slippulse_jax as sp
from slippulse_jax.base.status import NotConverged, Outcome
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.cli.main import slippulse
from slippulse_jax.exact.bulk import exact_fronts
from slippulse_jax.front.front import runaway_prestress
from slippulse_jax.inference.result.record import from_request, read_request
from slippulse_jax.inference.table.measurements import read_gauges
from slippulse_jax.lengths import arrests
from slippulse_jax.sweeps.store import StoreError

ROOT = Path(__file__).resolve().parent.parent
TABLES = sorted((ROOT / "fit_examples").glob("*/*.csv"))
STOPPED = Outcome.ARRESTED, Outcome.REBREAK


class Found(NamedTuple):
    """What a campaign found: attempts, those that ended in a promised refusal, and what fell, in words."""

    attempts: int
    refused: int
    fell: list[str]


def spread(rng: np.random.Generator, low: float, high: float, count: int) -> np.ndarray:
    """Numbers drawn evenly on a logarithmic scale."""
    return np.exp(rng.uniform(np.log(low), np.log(high), count))


def sliders(rng: np.random.Generator, count: int, tallest: float = 1e5) -> sp.Slider:
    """Sliders of the whole domain; one in four has a number at its end of it."""
    height, stiffness = spread(rng, 1.5, tallest, count), spread(rng, 1e-9, 10.0, count)
    poisson = rng.uniform(-0.95, 0.5, count)
    at = rng.integers(0, 16, count)
    height = np.where(at == 0, 1 + spread(rng, 1e-9, 0.1, count), height)
    stiffness = np.where(at == 1, spread(rng, 1e-12, 1e-9, count), np.where(at == 2, spread(rng, 10, 1e6, count), stiffness))
    poisson = np.where(at == 3, -1 + spread(rng, 1e-9, 0.05, count), poisson)
    return sp.Slider(height, stiffness, poisson)


def _lines(what: np.ndarray, *columns: np.ndarray) -> list[str]:
    """The lanes where `what` holds, in words."""
    return [", ".join(f"{x[i]:.17g}" for x in map(np.asarray, columns)) for i in np.nonzero(what)[0]]


# --- campaigns ------------------------------------------------------------------------------------------------------------


def lengths(rng: np.random.Generator, count: int) -> Found:
    """Recursion and closed form on the whole domain, with derivatives: no NaN called ok, the same count of contacts."""
    some = sliders(rng, count)
    ended, (exact, status) = arrests(some), exact_fronts(_rows(some, sp.Interface()))
    stopped = np.isin(ended.status, STOPPED)
    wrong = stopped & ~(np.isfinite(ended.length) & (ended.length > 0))
    # ℓ and ℓ* end between the same two contacts, and where contact 1 holds ℓ is 0; just on a contact rounding decides
    on_contact = np.abs(exact - np.round(exact)) < 1e-6 * np.maximum(exact, 1)
    crossed = (status == Outcome.ARRESTED) & (exact > 1)
    differ = (stopped != crossed) & ~on_contact
    apart = stopped & crossed & (np.ceil(exact) != ended.contacts_broken) & ~on_contact
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        slopes = sp.precursor_lengths(some, derivatives=1)
    lost = stopped & ~np.isfinite(np.stack(jax.tree.leaves(slopes.slider))).all(axis=0)
    fell = _lines(wrong | apart | differ | lost, some.height, some.stiffness, some.poisson, ended.length, exact)
    return Found(count, int((~stopped).sum()), fell)


def beside_run_away(rng: np.random.Generator, count: int) -> Found:
    """Prestress within 0.3 to 1e-7 of that of run-away, level, rising and falling thresholds: where both routes give a count."""
    some = sliders(rng, count, 3e3)
    with jax.enable_x64(True):
        at = np.asarray(runaway_prestress(lattice_modes(some)))
    prestress = np.clip(at + rng.choice([-1, 1], count) * spread(rng, 1e-7, 0.3, count), -0.99, 0.999)
    slope = np.where(rng.random(count) < 0.3, 0, rng.choice([-1, 1], count) * spread(rng, 1e-9, 1e-2, count))
    interface = sp.Interface(prestress, slope)
    ended, (exact, status) = arrests(some, interface, most=100_000), exact_fronts(_rows(some, interface))
    counted = np.isin(ended.status, STOPPED)
    with np.errstate(invalid="ignore"):  # two that never stop
        stops = counted & (status == Outcome.ARRESTED) & (np.abs(exact - ended.length) > 1)
    runs = counted & (status == Outcome.RUN_AWAY) | (ended.status == Outcome.RUN_AWAY) & (status == Outcome.ARRESTED)
    numbers = some.height, some.stiffness, some.poisson, prestress, slope, ended.length, exact
    return Found(count, int((~counted).sum()), _lines(stops | runs, *numbers))


def single_precision(rng: np.random.Generator, count: int) -> Found:
    """Lengths in single precision are within the promised 0.01 λc of those in double up to H/λc = 1000."""
    some = sp.Slider(spread(rng, 1.5, 1000, count), spread(rng, 1e-9, 1, count), rng.uniform(-0.9, 0.5, count))
    given = jax.tree.map(lambda x: np.asarray(x, np.float32), some)
    with jax.enable_x64(False):
        single = np.asarray(sp.precursor_length(given), np.float64)
    double = sp.precursor_lengths(jax.tree.map(lambda x: np.asarray(x, np.float64), given))
    jumps = (single == 0) != (double == 0)  # ℓ jumps from 0 to 1 where the domino starts
    fell = (np.abs(single - double) > 0.01) & ~(jumps & (np.maximum(single, double) < 1.001))
    return Found(count, int(jumps.sum()), _lines(fell, some.height, some.stiffness, some.poisson, single, double))


def blocks(rng: np.random.Generator, count: int) -> Found:
    """Blocks with any pusher: a length if and only if the event stopped, and then no contact at its threshold."""
    fell, refused = [], 0
    for _ in range(count):
        height, b = float(spread(rng, 2, 60, 1)[0]), float(spread(rng, 0.01, 100, 1)[0])
        poisson = float(rng.uniform(0, 0.45))
        at = float(rng.uniform(0.02, 0.98))
        push = [
            sp.Push(at), sp.Push(at, min(float(spread(rng, 1e-3, 1, 1)[0]), 1.99 * min(at, 1 - at))),
            sp.Push(at, min(0.2, 1.99 * min(at, 1 - at)), "force"), sp.Push(),
        ][rng.integers(4)]  # fmt: skip
        block = sp.Block(height, b / (2 * (1 + poisson) * height), poisson, push)
        with jax.enable_x64(True):
            found = sp.first_precursor(block, sites=256, event="full")
        status, length = Outcome(int(found.status)), float(found.length)
        stopped = status in STOPPED
        refused += not stopped
        if stopped != (np.isfinite(length) and length > 0) or (stopped and np.asarray(found.stress).max() >= 1):
            fell.append(f"{block}: {status.name}, {length}")
    return Found(count, refused, fell)


def damaged(rng: np.random.Generator, content: bytes) -> bytes:
    """A file with up to three places overwritten, cut off, cut out or inserted."""
    inserted = [
        b",",
        b"nan",
        b"-",
        b"1e999",
        b"\x00",
        b"\xff",
        b"\n",
        b'"',
        b";",
        b"9" * 400,
        b"\xe2\x88\x92",
        b"[",
        b"}",
        b"=",
    ]
    changed = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        at, kind = int(rng.integers(len(changed) + 1)), rng.integers(5)
        if kind == 0:
            changed[at : at + 1] = rng.bytes(1)
        elif kind == 1:
            del changed[at:]
        elif kind == 2:
            del changed[at : at + int(rng.integers(1, 30))]
        else:
            changed[at:at] = inserted[rng.integers(len(inserted))]
    return bytes(changed)


def _read(
    rng: np.random.Generator, count: int, originals: list[bytes], read: Callable[[Path], bool], begins: str = ""
) -> Found:
    """Damaged copies of files, which `read` takes and finds in order, or refuses by a `ValueError` of one line."""
    fell, refused = [], 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        for _ in range(count):
            content = damaged(rng, originals[rng.integers(len(originals))])
            path.write_bytes(content)
            try:
                if not read(path):
                    fell.append(f"read without a word: {content!r}")
            except ValueError as error:
                refused += 1
                text = str(error)
                if not text.startswith((str(path), *begins)) or "\n" in text or len(text) > 2100:
                    fell.append(f"message {text[:200]!r}")
            except Exception as error:  # noqa: BLE001 - what should not be
                fell.append(f"{type(error).__name__}: {error} of {content!r}"[:500])
    return Found(count, refused, fell)


def tables(rng: np.random.Generator, count: int) -> Found:
    """Damaged copies of the worked fits' tables: read in full, or a `ValueError` of one line that begins with the file."""

    def read(path: Path) -> bool:
        m = sp.read_measurements(path)
        return bool(np.isfinite(m.height).all() and (m.height > 1).all() and np.isfinite(m.length).all())

    return _read(rng, count, [path.read_bytes() for path in TABLES], read)


GAUGES = b"""# gauges along the interface
label,position_mm,slip_um,slip_sigma_um,stress_MPa,stress_sigma_MPa
A,5,1.5,0.1,,
A,12.5,0.8,0.1,0.31,0.02
B,5,1.25,0.1,,
"""


def gauges(rng: np.random.Generator, count: int) -> Found:
    """Damaged copies of a table of gauges: read in full, or a `ValueError` of one line that begins with the file."""

    def read(path: Path) -> bool:
        found = read_gauges(path, ["A", "B"])
        return bool(np.isfinite(found.position).all() and len(found.row) > 0)

    return _read(rng, count, [GAUGES], read)


REQUESTS = [
    b'# a request\nloss = "student"\nseed = 3\n\n[parameters.stiffness]\nbounds = [0.001, 0.5]\n\n[parameters.poisson]\nprior = [0.3, 0.02]\n',
    b'{"request": {"loss": "normal", "parameters": {"stiffness": {"each": "specimen"}, "prestress": {"prior": [0.0, 0.1]}}}}',
]


def requests(rng: np.random.Generator, count: int) -> Found:
    """Damaged copies of requests: understood, or a `ValueError` of one line that begins with the file or names what is wrong in the request."""
    return _read(
        rng, count, REQUESTS, lambda path: bool(from_request(read_request(path))), ("request", "parameter", "prior", "bounds")
    )


def stores(rng: np.random.Generator, count: int) -> Found:
    """Damaged copies of a store: resumed to the same bytes, or a `StoreError`; nothing read from it is another number."""
    fell, refused = [], 0
    given = {"height": np.linspace(10, 50, 12), "stiffness": np.geomspace(1e-3, 0.1, 10), "poisson": 0.3, "outputs": "length"}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        whole, copy = Path(folder) / "whole.zarr", Path(folder) / "copy.zarr"
        expected = sp.sweep(**given, store=whole, chunk=30).length.values
        files = sorted(path.relative_to(whole) for path in whole.rglob("*") if path.is_file())
        for _ in range(count):
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(whole, copy)
            path = copy / files[rng.integers(len(files))]
            content, kind = bytearray(path.read_bytes()), rng.integers(4)
            if kind == 0:
                content[rng.integers(len(content))] ^= 1 << rng.integers(8)
                path.write_bytes(content)
            elif kind == 1:
                path.write_bytes(content[: rng.integers(len(content))])
            elif kind == 2:
                path.write_bytes(rng.bytes(len(content)))
            else:
                path.unlink()
            try:
                with suppress(ValueError):  # Zarr's own, of a damaged chunk
                    read = sp.open_sweep(copy).length.values
                    if not (np.isnan(read) | (read == expected)).all():
                        fell.append(f"{path.name}: read another number")
                if not np.array_equal(sp.sweep(**given, store=copy, chunk=30).length.values, expected):
                    fell.append(f"{path.relative_to(copy)}: resumed to another number")
            except StoreError:
                refused += 1
            except Exception as error:  # noqa: BLE001 - what should not be
                fell.append(f"{path.relative_to(copy)}, damage {kind}: {type(error).__name__}: {error}"[:300])
    return Found(count, refused, fell)


WORDS = ("10", "0", "-1", "nan", "inf", "1e999", "", "x", "0.4", "2.5", "1:2:3", "1:2:3:log", "::", "[1]", "é", "9" * 60, "-")
SOUND = (
    "length --height 25 --stiffness 0.03 --poisson 0.3 --prestress 0.1 --threshold-slope 0.001 --json",
    "length --height 20 --stiffness 0.02 --poisson 0.3 --push-height 0.3",
    "sweep --height 10:50:3 --stiffness 1e-3:0.1:3:log --poisson 0.3 --prestress 0 --outputs length,status --chunk 4",
    f"fit {ROOT}/fit_examples/pmma_block/lengths.csv --sigma absolute --loss normal --seed 1",
)
"""Command lines that are in order."""


def command_lines(rng: np.random.Generator, count: int) -> Found:
    """Command lines with up to two words exchanged, left out or put in: a documented exit status, and never a traceback."""
    fell, refused, runner = [], 0, CliRunner()
    for _ in range(count):
        line = SOUND[rng.integers(len(SOUND))].split()
        for _ in range(rng.integers(0, 3)):
            at, word = int(rng.integers(1, len(line) + 1)), WORDS[rng.integers(len(WORDS))]
            line[at : at + int(rng.integers(0, 2))] = [word] * int(rng.random() < 0.8)
        done = runner.invoke(slippulse, line)
        refused += done.exit_code == 2
        broken = done.exception is not None and not isinstance(done.exception, SystemExit | NotConverged)
        if broken or done.exit_code not in (0, 1, 2, 3, 4):
            fell.append(f"{json.dumps(line)}: exit {done.exit_code}, {done.exception!r}"[:400])
    return Found(count, refused, fell)


CAMPAIGNS: dict[str, tuple[Callable[[np.random.Generator, int], Found], int]] = {
    "lengths": (lengths, 200_000),
    "beside run-away": (beside_run_away, 100_000),
    "single precision": (single_precision, 20_000),
    "blocks": (blocks, 300),
    "tables": (tables, 5000),
    "stores": (stores, 300),
    "command lines": (command_lines, 500),
    "gauges": (gauges, 5000),
    "requests": (requests, 5000),
}
"""Campaigns by name, and their usual number of attempts."""


def run(name: str, count: int, seed: int = 20) -> Found:
    """Run one campaign."""
    campaign, _ = CAMPAIGNS[name]
    return campaign(np.random.default_rng([seed, list(CAMPAIGNS).index(name)]), count)


def _rows(some: sp.Slider, interface: sp.Interface) -> np.ndarray:
    numbers = some.height, some.stiffness, some.poisson, interface.prestress, interface.threshold_slope
    return np.stack([np.broadcast_to(np.asarray(x, np.float64), some.shape) for x in numbers])


def rows(names: list[str], factor: float) -> Iterator[str]:
    """Lines of the table; what fell goes to the screen."""
    yield "| campaign | what must hold | attempts | refused, or without a length | fell |"
    yield "|---|---|---|---|---|"
    for name in names:
        campaign, usual = CAMPAIGNS[name]
        began = time.perf_counter()
        found = run(name, max(1, round(usual * factor)))
        print(
            f"{name}: {len(found.fell)} of {found.attempts} fell, {time.perf_counter() - began:.0f} s",
            *found.fell[:20],
            sep="\n  ",
        )
        yield f"| {name} | {campaign.__doc__} | {found.attempts} | {found.refused} | {len(found.fell)} |"


def main() -> None:
    """Run the campaigns, and print or write their table."""
    parser = argparse.ArgumentParser(description="Attack the package by seeded campaigns.")
    parser.add_argument("factor", nargs="?", type=float, default=1.0, help="on the number of attempts")
    parser.add_argument("--write", action="store_true", help="write docs/tables/attack.md")
    parser.add_argument("--only", nargs="+", choices=list(CAMPAIGNS), default=list(CAMPAIGNS), metavar="CAMPAIGN")
    asked = parser.parse_args()
    table = "\n".join(rows(asked.only, asked.factor)) + "\n"
    if asked.write:
        (ROOT / "docs" / "tables" / "attack.md").write_text(table, encoding="utf-8")
    print(table)


if __name__ == "__main__":
    main()
