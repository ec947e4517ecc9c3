"""Every test runs with JAX as strict as it goes, in float64 unless it asks for float32."""

import os
import shutil
import tempfile

# two workers on two cores: a matrix library that starts threads of its own only gets in their way
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Compiling is most of what a run costs. What one worker, command line, example or notebook has compiled the others take from
# here. The size limit is never met: it is there because only with one does JAX lock the folder against half-written files.
OURS = "JAX_COMPILATION_CACHE_DIR" not in os.environ
if OURS:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="slippulse-tests-")
os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(10**10))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


def pytest_unconfigure(config):
    if OURS and not hasattr(config, "workerinput"):  # the process that made the folder, not one of its workers
        shutil.rmtree(os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)


@pytest.fixture(autouse=True, scope="module")
def forget_compiled_programs():
    """A file's programs are of no use to the next; kept, they come to gigabytes."""
    yield
    jax.clear_caches()


@pytest.fixture
def float32():
    with jax.enable_x64(False):
        yield
