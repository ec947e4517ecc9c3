"""Every test runs with JAX as strict as it goes, in float64 unless it asks for float32."""

import os

# two workers on two cores: a matrix library that starts threads of its own only gets in their way
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture
def float32():
    with jax.enable_x64(False):
        yield
