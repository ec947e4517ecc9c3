"""Every test runs with JAX as strict as it goes, in float64 unless it asks for float32."""

import functools
import gc
import os
import resource
import signal
import sys
from pathlib import Path

# two workers on two cores: a matrix library that starts threads of its own only gets in their way
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Compiling is most of what a run costs. What one worker, command line, example or notebook has compiled the others read from
# here, and so does the next run. A size limit is given because only with one does JAX lock the folder against half-written files.
COMPILED = os.environ.get("SLIPPULSE_TEST_CACHE") or str(Path(__file__).resolve().parent.parent / ".pytest_cache" / "compiled")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", COMPILED)
os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(2 * 10**9))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")

import jax
import pytest

import slippulse_jax as sp
from slippulse_jax.bulk.compiler import knows

# Some of XLA's options reduce the time to compile to less than a third (the second, because both cores are busy already). An
# unknown one ends the process. Programs for many lanes are optimised as users' are, whatever is said here: they are few, and
# fits run them much. The rest may differ in the last digit. `XLA_FLAGS= pytest` compiles everything as users' programs are.
QUICK = {"xla_backend_optimization_level": 0, "xla_cpu_parallel_codegen_split_count": 1, "xla_cpu_use_fusion_emitters": "false"}
os.environ.setdefault("XLA_FLAGS", " ".join(f"--{name}={value}" for name, value in QUICK.items() if knows(name)))

if os.environ.get("SLIPPULSE_CHECK_SHAPES"):  # of every array that passes between functions
    import shapes

    shapes.install()

# tracing makes objects by the million, few of them in cycles: looking for these took a tenth of the time and more
gc.freeze()
gc.set_threshold(100_000, 20, 20)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

MOST_MEMORY = max(2.5e9, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 5)
"""Bytes that a worker may keep in compiled programs and the rest: to compile them again takes longest where there is room for all."""
MOST_MAPS = 32_000
"""Pieces of memory that it may have mapped, several for every program: Linux allows 65 530, and XLA ends the process at the next."""


def resident():
    """Memory of this process in bytes: now where Linux tells, at most elsewhere."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def mapped():
    """Pieces of memory that this process has mapped, where Linux tells."""
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return 0


@pytest.fixture(autouse=True)
def forget_programs_before_there_are_too_many():
    """One file alone may compile more than a process can hold."""
    yield
    if mapped() > MOST_MAPS:
        jax.clear_caches()


@pytest.fixture(autouse=True, scope="module")
def forget_compiled_programs():
    """Programs of one file may serve the next; kept without end, they come to gigabytes."""
    yield
    if resident() > MOST_MEMORY:
        jax.clear_caches()


@pytest.fixture(autouse=True)
def figures_are_closed():
    """Close what a test has drawn: pyplot keeps every figure, and warns of more than twenty."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture(autouse=True)
def compiler_flags_stay():
    """Processes that later tests start would inherit them, and compile other programs than this one."""
    before = os.environ.get("XLA_FLAGS")
    yield
    assert os.environ.get("XLA_FLAGS") == before


@pytest.fixture(scope="session")
def worked():
    """Fit of a bundled table as it comes, by the name of its folder: every worker fits each once."""
    folder = Path(__file__).resolve().parent.parent / "fit_examples"
    free = {"sequence": ("stiffness", "friction")}
    return functools.cache(lambda name: sp.fit(folder / name / "lengths.csv", free.get(name, "stiffness")))


@pytest.fixture
def float32():
    with jax.enable_x64(False):
        yield


@pytest.fixture
def full_disk():
    """No file may grow beyond a few bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def limit(size):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))

    yield limit
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, ignored)
