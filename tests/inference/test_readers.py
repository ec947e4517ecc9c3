"""Files and arguments that would take memory or time without end: both grow as what is read, and stop at a stated size."""

import tracemalloc

import pytest
from click.testing import CliRunner

from slippulse_jax.base.files import read_whole
from slippulse_jax.cli import main as cli
from slippulse_jax.cli import sweep as sweep_command
from slippulse_jax.inference.result import record
from slippulse_jax.inference.table import measurements, tables
from slippulse_jax.inference.table.measurements import MeasurementError

MOST = 40
"""Bytes of memory per byte of a table or request, as docs/appendix/robustness.md says."""

SIZE = 40_000
HEADER = "height,poisson,length,length_sigma\n"


def filled(unit):
    return unit * (SIZE // len(unit))


TABLES = {
    "empty lines": filled("\n"),
    "empty lines after a header": HEADER + filled("\n"),
    "empty lines as of old": HEADER + filled("\r"),
    "comments": HEADER + filled("#\n"),
    "blank cells": HEADER + filled(",,,\n"),
    "one line of blank cells": filled(","),
    "one long cell": HEADER + filled("9"),
    "one cell of many lines": HEADER + '"' + filled("\n") + '"',
    "one quotation mark after another": HEADER + filled('"'),
    "other line ends": HEADER + filled("\u2028\x0b\x85"),
    "many columns": ",".join(f"c{i}" for i in range(SIZE // 7)),
    "many columns of one name": filled("a,"),
    "the shortest measurements": "height,poisson,length\n" + filled("9,0,1\n"),
    "with decimal commas": "height;poisson;length\n" + filled("9;0,1;1\n"),
    "one quantity in every case": ",".join(["height", *(f"{'Height'[: i % 6]}height{i}" for i in range(SIZE // 16))]),
}
GAUGES = {name: text.replace(HEADER, "label,position_mm,slip_um,slip_sigma_um\n") for name, text in TABLES.items()}
GAUGES |= {"readings": "label,position_mm,slip_um,slip_sigma_um\n" + filled("a,1,1,1\n")}
GAUGES |= {"readings of none": "label,position_mm,slip_um,slip_sigma_um\n" + filled("b,1,1,1\n")}
REQUESTS = {
    "empty lines": filled("\n"),
    "many keys": "".join(f"k{i}=1\n" for i in range(SIZE // 9)),
    "many tables": filled("[[a]]\n"),
    "nested tables": "a=" + filled("["),
    "a dotted key": "a" + filled(".a") + "=1",
    "a dotted header": "[a" + filled(".a") + "]",
    "a list": "a=[" + filled("0,") + "]",
    "many digits": "a=" + filled("9"),
    "JSON: many digits": '{"a":' + filled("9") + "}",
    "JSON: a list": '{"a":[' + filled("0,") + "0]}",
    "JSON: many objects": '{"a":[' + filled("{},") + "{}]}",
    "JSON: nested": filled('{"a":'),
}


def peak(read, path):
    """Most memory that is held while a file is read or refused, and the message."""
    tracemalloc.start()
    try:
        read(path)
        return tracemalloc.get_traced_memory()[1], None
    except ValueError as error:
        return tracemalloc.get_traced_memory()[1], str(error)
    finally:
        tracemalloc.stop()


@pytest.mark.ci
@pytest.mark.parametrize(
    ("read", "texts"),
    [
        (measurements.read_measurements, TABLES),
        (lambda path: measurements.read_gauges(path, ["a"]), GAUGES),
        (lambda path: record.from_request(record.read_request(path)), REQUESTS),
    ],
    ids=["measurements", "gauges", "requests"],
)
def test_memory_is_a_multiple_of_the_file(tmp_path, read, texts):
    path = tmp_path / "file"
    refused = 0
    for name, text in texts.items():
        path.write_text(text, encoding="utf-8", newline="")
        held, message = peak(read, path)
        assert held < MOST * path.stat().st_size, name
        if message is not None:
            refused += 1
            assert len(message) < 2100, name
            assert "\n" not in message, name
            assert message.startswith((str(path), "request")), message
    assert refused > len(texts) / 2


def test_empty_lines_are_not_kept(tmp_path):
    """A table whose lines are blank takes the memory of its text, not that of a list of lines."""
    path = tmp_path / "t.csv"
    path.write_text(HEADER + "\n" * SIZE + "9,0.3,8,1\n")
    assert peak(measurements.read_measurements, path)[0] < 5 * SIZE
    assert measurements.read_measurements(path).lines == (SIZE + 2,)


def test_files_beyond_a_stated_size_are_not_read(tmp_path, monkeypatch):
    """Nor is more of them held than that: a device without end is refused too."""
    path = tmp_path / "t.csv"
    path.write_bytes(b" " * (2**20 + 1))
    with pytest.raises(ValueError, match=r"t\.csv: larger than 1 MiB, the most that is read"):
        read_whole(path, 2**20)
    path.write_bytes(path.read_bytes()[:-1])
    assert len(read_whole(path, 2**20)) == 2**20
    monkeypatch.setattr(tables, "LARGEST", 2**20)
    monkeypatch.setattr(record, "LARGEST", 2**20)
    held, message = peak(measurements.read_measurements, "/dev/zero")
    assert message == "/dev/zero: larger than 1 MiB, the most that is read"
    assert held < 4 * 2**20
    with pytest.raises(MeasurementError, match="larger than 1 MiB"):
        measurements.read_gauges("/dev/zero", ["a"])
    with pytest.raises(ValueError, match="/dev/zero: larger than 1 MiB"):
        record.read_request("/dev/zero")


def test_long_ranges_are_refused_before_they_are_made():
    tracemalloc.start()
    done = CliRunner().invoke(
        sweep_command.command, ["--height", "1:2:1000000000000", "--stiffness", "0.03", "--poisson", "0.3"]
    )
    held = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (done.exit_code, done.stdout) == (2, "")
    assert "'1:2:1000000000000': more than 10000000 values" in done.stderr
    assert held < 1e8  # what importing takes


@pytest.mark.parametrize(
    "error", [MemoryError("Unable to allocate 745. GiB"), RuntimeError("RESOURCE_EXHAUSTED: Out of memory")]
)
def test_too_little_memory_is_one_line(error, monkeypatch, capsys):
    """Whether NumPy or XLA finds out."""

    def full(**_):
        raise error

    monkeypatch.setattr(cli.slippulse, "main", full)
    monkeypatch.setattr(cli, "leave_when_interrupted", lambda: None)
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert left.value.code == 1
    said = capsys.readouterr().err
    assert said == f"Error: not enough memory ({error}); a sweep with --store needs it for a few chunks only\n"
