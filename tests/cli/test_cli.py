"""The command line as a person or a script meets it: output, messages, exit status."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import click
import jax
import numpy as np
import pytest
from chains import ended

import slippulse_jax as sp
from slippulse_jax.base.files import plain
from slippulse_jax.base.status import Outcome
from slippulse_jax.blocks import size
from slippulse_jax.cli import main as cli
from slippulse_jax.exact import front as exact_front
from slippulse_jax.inference.table.columns import COLUMNS, OF_GAUGES

ROOT = Path(__file__).resolve().parents[2]
PMMA = "fit_examples/pmma_block/lengths.csv"
FIG2 = ["--height", "25", "--stiffness", "0.03", "--poisson", "0.3"]


def slippulse(*arguments, cwd=ROOT, env=None, **kwargs):
    return subprocess.run(
        [sys.executable, "-m", "slippulse_jax.cli.main", *arguments],
        capture_output=True, text=True, cwd=cwd, timeout=300, env=(env or os.environ) | {"PYTHONPATH": str(ROOT)}, **kwargs
    )  # fmt: skip


@pytest.fixture
def in_this_process(monkeypatch, capsys):
    """What `slippulse` does, without a process of its own."""

    def run(*arguments):
        monkeypatch.chdir(ROOT)
        monkeypatch.setattr(cli, "leave_when_interrupted", lambda: None)
        monkeypatch.setattr(sys, "argv", ["slippulse", *arguments])
        code = 0
        try:
            cli.main()
        except SystemExit as leaving:
            code = leaving.code
        printed = capsys.readouterr()
        return subprocess.CompletedProcess(arguments, code, printed.out, printed.err)

    return run


def test_help_and_version_do_not_import_jax():
    code = (
        "import sys; sys.argv = ['slippulse', '--help']\n"
        "from slippulse_jax.cli.main import main\n"
        "try:\n    main()\nexcept SystemExit as e:\n    assert e.code == 0\n"
        "assert 'jax' not in sys.modules and 'numpy' not in sys.modules and 'matplotlib' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "fit" in done.stdout
    assert "length" in done.stdout
    for command, option in (("length", "--help"), ("fit", "--help"), ("fit", "--columns")):
        loaded = code.replace("'--help'", f"'{command}', '{option}'").replace(" and 'numpy' not in sys.modules", "")
        done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, cwd=ROOT)
        assert done.returncode == 0, done.stderr
        assert ("--json" in done.stdout) == (option == "--help")
    for column in [*COLUMNS.values(), *OF_GAUGES.values()]:
        assert f"  {column.name(in_si=True)}  " in done.stdout


@pytest.mark.parametrize("name", [name for name in cli.COMMANDS if name not in ("claims", "figures")])
def test_help_lists_each_option_in_one_group(name):
    """The help of a command fits one screen of 60 lines, 100 characters wide."""
    root = click.Context(cli.slippulse, info_name="slippulse", terminal_width=100, **cli.slippulse.context_settings)
    command = cli.slippulse.get_command(root, name)
    context = click.Context(command, info_name=name, parent=root)
    shown = command.get_help(context).splitlines()
    assert len(shown) <= 60
    assert max(map(len, shown)) <= 100
    options = [max(one.opts, key=len) for one in command.get_params(context) if one.param_type_name == "option"]
    assert len(options) >= 14
    assert sorted(f"--{one}" for names in command.groups.values() for one in names.split()) == sorted(options)
    for title in command.groups:
        assert f"{title}:" in shown
    for option in options:
        assert sum(line.lstrip().removeprefix("-h, ").split(" ")[0] == option for line in shown if line[:2] == "  ") == 1, (
            option
        )


def test_length(in_this_process):
    done = in_this_process("length", *FIG2)
    assert (done.returncode, done.stderr) == (0, "")
    assert "ℓ   = 25.788815 λc" in done.stdout
    assert "Λ   = 26 λc" in done.stdout
    assert "arrested" in done.stdout


@pytest.mark.ci
def test_length_of_contacts_that_keep_a_share_of_their_strength(in_this_process):
    """Of a slider and of a block; the load at nucleation is that of contacts that keep nothing."""
    slider, kept = sp.Slider(25.0, 0.03, 0.3), sp.Interface(residual_strength=0.3)
    alone, content = (
        json.loads(in_this_process("length", "--json", *FIG2, *more).stdout) for more in ((), ("--residual-strength", "0.3"))
    )
    front = sp.first_precursor(slider, kept)
    assert (alone["residual_strength"], content["residual_strength"]) == (None, 0.3)
    assert content["length"] == pytest.approx(float(front.length), abs=1e-10)
    assert content["edge_stress"] == pytest.approx(float(front.stress[0]), abs=1e-10)
    assert content["load"] == pytest.approx(alone["load"], rel=1e-13)
    text = in_this_process("length", *FIG2, "--residual-strength", "0.3", "--push-height", "0.3").stdout
    with jax.enable_x64(True):
        of_block = sp.precursor_length(sp.Block(25.0, 0.03, 0.3, sp.Push(0.3)), kept)
    assert f"ℓ   = {float(of_block):.6g} λc" in text
    assert f"{float(sp.exact_length(slider, kept)):.6g} λc with the slider" in text
    assert "ν = 0.3, r = 0.3" in text


CACHES = ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA")
"""What says where a user's caches are, on one system or another."""


@pytest.fixture
def own_cache(tmp_path):
    """Environment of a user who has set nothing but a folder for caches, and that folder."""
    names = ("JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")
    return {k: v for k, v in os.environ.items() if k not in names} | dict.fromkeys(CACHES, str(tmp_path)), tmp_path


@pytest.mark.ci
def test_compiled_programs_are_kept_between_calls(own_cache):
    env, folder = own_cache
    first = slippulse("length", *FIG2, env=env)
    assert (first.returncode, first.stderr) == (0, "")
    programs = sorted(folder.rglob("*-cache"))
    assert programs
    old = programs[0].with_name("of_last_year-cache")
    old.touch()
    os.utime(old, (0, 0))
    again = slippulse("length", *FIG2, env=env | {"JAX_LOG_COMPILES": "1"})
    assert again.stdout == first.stdout
    assert "Persistent compilation cache hit" in again.stderr
    assert "compilation cache miss" not in again.stderr.lower()
    assert sorted(folder.rglob("*-cache")) == programs


@pytest.mark.ci
def test_an_unreadable_program_is_compiled_once_more(own_cache):
    """Whatever is wrong with it; the others stay."""
    code = """
import os, shutil, sys, warnings
from pathlib import Path
from slippulse_jax.cli import cache, main
cache.keep_compiled_programs()
warnings.showwarning = main._show
import jax
folder = Path(os.environ["JAX_COMPILATION_CACHE_DIR"])

def compiled():
    jax.clear_caches()
    jax.jit(lambda x: 2 * x)(1.0), jax.jit(lambda x: 3 * x)(1.0)  # two programs of one name

compiled()
whole = {path: path.read_bytes() for path in folder.glob("*-cache")}
path, content = next((path, content) for path, content in whole.items() if "lambda" in path.name)
assert sum("lambda" in path.name for path in whole) == 2
size = len(content)
for bad in [b"", b"0", content[:4], content[:100], content[: size // 2], content[:-1], b"garbage " * 100, None]:
    path.unlink()
    path.mkdir() if bad is None else path.write_bytes(bad)
    compiled()
    now = {path: path.read_bytes() for path in folder.glob("*-cache")}
    assert now == whole | {path: now[path]}, bad
    assert len(now[path]) > 0.9 * size, bad
    compiled()
    assert path.read_bytes() == now[path], bad
print("whole")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, env=own_cache[0])
    assert (done.stdout, done.stderr) == ("whole\n", "")


@pytest.mark.ci
def test_the_cache_can_be_switched_off_and_may_be_unwritable(own_cache):
    env, folder = own_cache
    assert slippulse("--no-cache", "length", *FIG2, env=env).returncode == 0
    assert slippulse("length", *FIG2, env=env | {"SLIPPULSE_CACHE": "off"}).returncode == 0
    assert list(folder.iterdir()) == []
    (folder / "a_file").touch()
    done = slippulse("length", *FIG2, env=env | dict.fromkeys(CACHES, str(folder / "a_file")))
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("block", [[], ["--push-height", "0.2"]], ids=["slider", "block"])
def test_length_of_contacts_that_differ(block, in_this_process):
    """What `sp.scattered` says, as numbers and as text."""
    body = ["length", "--height", "20", "--stiffness", "0.02", "--poisson", "0.3", *block]
    drawn = ["--threshold-scatter", "0.05", "--draws", "20", "--seed", "2"]
    found = json.loads(in_this_process(*body, *drawn, "--json").stdout)["scattered"]
    slider = sp.Slider(20.0, 0.02, 0.3)
    one = sp.Block(slider.height, slider.stiffness, slider.poisson, sp.Push(0.2)) if block else slider
    draws = sp.scattered(one, threshold_scatter=0.05, visible=2.0, draws=20, seed=2)
    assert found["length"] == pytest.approx(float(draws.length.mean()), rel=1e-6)
    assert found["low"] < found["median"] < found["high"]
    assert found["visible"] == 2
    text = in_this_process(*body, *drawn).stdout
    assert "thresholds that scatter by 5 %, 20 draws of seed 2; events visible from 2 λc on:" in text
    assert f"ℓ   = {found['length']:.5g} ± {found['spread']:.2g} λc, mean and spread" in text
    assert "give --threshold-scatter too" in in_this_process(*body, "--visible", "3").stderr
    assert "visible = 0: must be positive" in in_this_process(*body, *drawn, "--visible", "0").stderr


def test_length_in_si_as_json(in_this_process):
    done = in_this_process(
        "length", "--json", "--poisson", "0.3", "--height-mm", "75", "--correlation-length-um", "10", "--areal-stiffness", "2e10",
        "--young-gpa", "3",
    )  # fmt: skip
    content = json.loads(done.stdout)
    assert content["height"] == pytest.approx(7500)
    assert content["length_mm"] == pytest.approx(59.6129, abs=1e-4)
    assert content["status"] == "arrested"


def test_length_of_a_front_that_runs_through_is_null_not_a_number(in_this_process):
    done = in_this_process(
        "length", "--json", "--height", "50", "--stiffness", "0.03", "--poisson", "0.3", "--right", "free", "--sites", "100"
    )
    content = json.loads(done.stdout)
    assert content["length"] is None
    assert content["status"] == "ran_through"


@pytest.mark.ci
def test_length_of_a_block_that_ends_under_a_machine_that_gives_way(in_this_process):
    """The end is free by default, and need not lie at a whole contact."""
    si = ("--height-mm", "2.5", "--correlation-length-um", "100", "--areal-stiffness", "9e11", "--young-gpa", "3")
    done = in_this_process("length", "--json", "--poisson", "0.3", *si, "--block-length-mm", "10.05", "--machine", "2")
    content = json.loads(done.stdout)
    slider = sp.Slider(25.0, 0.03, 0.3)
    assert content["length"] == pytest.approx(float(sp.precursor_lengths(ended(slider, 100.5, machine=2.0))))
    assert content["length_mm"] == pytest.approx(content["length"] / 10)
    assert (content["right"], content["sites"], content["machine"]) == ("free", 100.5, 2)
    held = json.loads(in_this_process("length", "--json", *FIG2, "--machine", "2").stdout)
    assert held["length"] == pytest.approx(float(sp.precursor_lengths(ended(slider, machine=2.0))))
    assert held["length"] < content["length"]
    text = in_this_process("length", *FIG2, "--machine", "2").stdout
    assert "machine M/K = 2" in text
    assert "displacement of the machine at nucleation" in text


@pytest.mark.parametrize(
    ("status", "code"), [(Outcome.INVALID, 2), (Outcome.LIMIT, 3), (Outcome.NOT_CONVERGED, 3), (Outcome.LIFT_OFF, 0)]
)
@pytest.mark.parametrize("friction", [[], ["--friction", "0.3"]])
@pytest.mark.filterwarnings("ignore:Block:RuntimeWarning")
def test_a_block_without_a_length_says_why(status, code, friction, monkeypatch, in_this_process):
    """Whatever its outcome; only a block that lifts off is said to lift off."""
    monkeypatch.setattr(size, "resolved", lambda *_, **__: np.nan)
    monkeypatch.setattr(size, "_record", lambda *_: SimpleNamespace(status=status))
    monkeypatch.setattr(exact_front, "exact_length", lambda *_: np.nan)
    done = in_this_process("length", *FIG2, "--push-height", "0.3", *friction)
    assert done.returncode == code
    assert ("none: the block lifts off" in done.stdout) == (status is Outcome.LIFT_OFF)
    assert "nan" not in done.stdout
    assert status.message in done.stderr or code == 0


def test_numbers_that_are_not_finite_are_null():
    content = plain(
        {"a": [1, (float("nan"), np.float32("inf"))], "b": np.array([[1.5, -np.inf]]), "c": np.int64(3), "d": "inf"}
    )
    assert content == {"a": [1, [None, None]], "b": [[1.5, None]], "c": 3, "d": "inf"}


def test_what_is_not_found_is_one_line_and_exit_3(tmp_path, monkeypatch, in_this_process):
    """Of sliders so tall that a fit takes the closed form. It was never seen to happen, so it is made to."""
    tall = tmp_path / "tall.csv"
    tall.write_text("height,poisson,length,length_sigma\n1e5,0.3,7e4,700\n2e5,0.3,1.4e5,1400\n")

    def lost(lanes, **_):
        return np.full(lanes.shape[1], np.nan), np.full(lanes.shape[1], Outcome.NOT_CONVERGED)

    monkeypatch.setattr("slippulse_jax.inference.model.slider.exact_fronts", lost)
    done = in_this_process("fit", str(tall))
    assert done.returncode == 3
    *_, last = done.stderr.splitlines()
    assert last.startswith("Error: no exact length")
    assert last.endswith(Outcome.NOT_CONVERGED.message)


def test_a_search_that_does_not_converge_is_reported_with_exit_3(tmp_path, in_this_process):
    request = tmp_path / "one_step.toml"
    request.write_text("max_steps = 1\n")
    done = in_this_process("fit", PMMA, "--request", str(request))
    assert "The search did not converge" in done.stdout
    assert done.returncode == 3


def test_fit_reports_and_draws(tmp_path):
    figure = tmp_path / "fit.svg"
    done = slippulse("fit", PMMA, "--figure", str(figure))
    assert done.returncode == 0, done.stderr
    assert "│ Identified. From 6 lengths of lengths.csv, " in done.stdout
    assert "Pa/m" in done.stdout
    assert done.stderr.strip() == f"figure written to {figure}"
    assert figure.read_bytes().startswith(b"<?xml")
    assert [path.name for path in tmp_path.iterdir()] == ["fit.svg"], "no temporary file is left behind"


@pytest.mark.ci
def test_fit_as_json_keeps_stdout_clean(tmp_path, in_this_process):
    done = in_this_process("fit", PMMA, "--json", "--figure", str(tmp_path / "fit.png"))
    content = json.loads(done.stdout)
    assert content["identifiability"] == "identified"
    assert abs(content["values"]["areal_stiffness"] / 2e10 - 1) < 0.05


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["length", "--height", "0.5", "--stiffness", "0.03", "--poisson", "0.3"], "Slider.height = 0.5: must exceed 1"),
        (["length", "--height", "25", "--stiffness", "nan", "--poisson", "0.3"], "'--stiffness': 'nan' is not a number"),
        (["length", "--height", "25", "--poisson", "0.3"], "missing --stiffness"),
        (["length", "--height", "25", "--young-gpa", "3", "--poisson", "0.3"], "--young-gpa and --height belong to two forms"),
        (
            ["length", "--height-mm", "25", "--poisson", "0.3"],
            "missing --correlation-length-um, --areal-stiffness, --young-gpa",
        ),
        (["length", "--height", "1e170", "--stiffness", "0.03", "--poisson", "0.3"], "invalid: a value outside its domain"),
        (["length", *FIG2, "--right", "free"], "needs a length"),
        (["length", *FIG2, "--residual-strength", "1"], "Interface.residual_strength = 1: must lie in [0, 1)"),
        (["length", *FIG2, "--right", "open"], "'open' is not one of"),
        (["length", *FIG2, "--block-length-mm", "100"], "--block-length-mm belongs to the SI form of the slider"),
        (["length", *FIG2, "--block-length-mm", "100", "--sites", "9"], "--sites and --block-length-mm both say where"),
        (["length", *FIG2, "--machine", "-1"], "machine"),
        (["fit", PMMA, "--event", "slip"], "'slip' is not one of"),
        (["fit", PMMA, "--event", "crack"], "event = 'crack': friction is neither fitted nor held"),
        (["length", *FIG2, "--height", "tall"], "'--height': 'tall' is not a number"),
        (["fit", "none.csv"], "none.csv: No such file or directory"),
        (["fit", PMMA, "--figure", "fit.jpeg2000"], "must end in .png, .pdf, .svg"),
        (["fit", PMMA, "--figure", "no/such/folder/fit.png"], "there is no folder no/such/folder"),
        (["fit", PMMA, "--bounds", "2", "1"], "bounds = (2, 1) of stiffness: must be positive, finite and in increasing order"),
        (["fit"], "Missing argument 'LENGTHS.CSV'"),
        (["slide"], "No such command 'slide'"),
    ],
)
def test_bad_input_is_one_clear_line_and_exit_2(arguments, message, in_this_process):
    done = in_this_process(*arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert len([line for line in done.stderr.splitlines() if line.startswith("Error: ")]) == 1


def test_bad_table_names_file_line_and_column(tmp_path, in_this_process):
    path = tmp_path / "lengths.csv"
    path.write_text("height,poisson,length,length_sigma\n25,0.3,26,0.5\n25,0.3,x,0.5\n")
    done = in_this_process("fit", str(path))
    assert done.returncode == 2
    assert done.stderr == f"Error: {path}, line 3, column length: 'x' is not a number\n"


@pytest.mark.ci
def test_data_that_cannot_tell_is_an_answer_not_an_error(tmp_path, in_this_process):
    path = tmp_path / "lengths.csv"
    path.write_text("height,poisson,length,length_sigma\n25,0.3,40,0.5\n")
    done = in_this_process("fit", str(path))
    assert done.returncode == 0
    assert "│ Not identifiable: the length is at or above the attainable maximum. " in done.stdout


def test_interrupted():
    """Ctrl-C ends with 130 and no traceback."""
    code = (
        "import signal, sys; sys.argv = ['slippulse', 'fit', 'fit_examples/pmma_block/lengths.csv']\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # ignored where the tests run in the background
        "from slippulse_jax.cli.main import main\n"
        "print('ready', flush=True)\n"
        "main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env=os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "0"},  # which a killed process would leave half-written
    ) as process:  # fmt: skip
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.7)  # jax is being imported, or compiles
        process.send_signal(signal.SIGINT)
        err = process.stderr.read()
    assert process.returncode == 130
    assert err.strip().endswith("interrupted")
    assert "Traceback" not in err


@pytest.mark.ci
def test_reader_that_hangs_up_is_not_an_error_message():
    done = subprocess.run(
        f"{sys.executable} -m slippulse_jax.cli.main length --height 25 --stiffness 0.03 --poisson 0.3 | head -c 0",
        shell=True, capture_output=True, text=True, cwd=ROOT,
    )  # fmt: skip
    assert "Traceback" not in done.stderr


@pytest.mark.ci
@pytest.mark.parametrize("encoding", ["cp1252", pytest.param("latin-1", marks=pytest.mark.slow)])
def test_every_encoding_of_stdout(encoding):
    env = os.environ | {"PYTHONIOENCODING": encoding}
    for arguments in (["length", *FIG2], ["length", "--help"]):
        done = slippulse(*arguments, env=env, encoding=encoding)
        assert done.returncode == 0, done.stderr
        assert "UnicodeEncodeError" not in done.stderr
        assert done.stdout
    found = json.loads(slippulse("length", *FIG2, "--json", env=env, encoding=encoding).stdout)
    assert found == json.loads(slippulse("length", *FIG2, "--json").stdout)


@pytest.mark.ci
@pytest.mark.parametrize("closed", [1, 2])
def test_closed_streams(closed):
    code = f"import os, sys; os.close({closed}); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    done = subprocess.run(
        [sys.executable, "-c", code, "-m", "slippulse_jax.cli.main", "length", *FIG2], capture_output=True, text=True, cwd=ROOT
    )
    assert "Traceback" not in done.stderr
    assert done.returncode in (0, 1)


@pytest.mark.ci
def test_interrupted_while_it_starts():
    """Of the command that is installed, from its first import on."""
    slow = (
        "import builtins, signal, sys, time; from slippulse_jax.cli import run; real = builtins.__import__\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell's background ignores it
        "def late(*a, **k): print(1, flush=True); time.sleep(0.02); return real(*a, **k)\n"
    )
    started = subprocess.Popen(
        [sys.executable, "-c", slow + "sys.argv = ['slippulse', '--help']; builtins.__import__ = late; run()"],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert started.stdout.readline() == "1\n"
    started.send_signal(signal.SIGINT)
    _, said = started.communicate(timeout=60)
    assert started.returncode == 130
    assert "Traceback" not in said


@pytest.mark.ci
def test_a_long_cell_is_not_said_whole(tmp_path):
    (tmp_path / "long.csv").write_text("height,poisson,length,length_sigma\n25,0.3," + "x" * 100_000 + ",1\n")
    done = slippulse("fit", str(tmp_path / "long.csv"))
    assert done.returncode == 2
    assert "line 2, column length" in done.stderr
    assert len(done.stderr) < 3000


def test_atomic_writing_keeps_links_masks_and_names(tmp_path, monkeypatch):
    from slippulse_jax.base.files import write_atomically

    (tmp_path / "there").mkdir()
    (tmp_path / "link.png").symlink_to(tmp_path / "there" / "real.png")
    monkeypatch.setattr(os, "umask", lambda _: pytest.fail("the umask belongs to the whole process"))
    write_atomically(tmp_path / "link.png", b"drawn")
    assert (tmp_path / "link.png").is_symlink()
    assert (tmp_path / "there" / "real.png").read_bytes() == b"drawn"
    assert [p.name for p in (tmp_path / "there").iterdir()] == ["real.png"]
    plain = tmp_path / "made.png"
    plain.touch()
    assert (tmp_path / "there" / "real.png").stat().st_mode == plain.stat().st_mode
    with pytest.raises(FileNotFoundError) as error:
        write_atomically(tmp_path / "gone" / "a.png", b"")
    assert error.value.filename == str(tmp_path / "gone" / "a.png")


def test_full_disk_leaves_no_half_file(tmp_path, monkeypatch):
    from slippulse_jax.base.files import write_atomically

    path = tmp_path / "result.bin"
    write_atomically(path, b"old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, b"new and longer")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["result.bin"]
