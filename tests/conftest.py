"""Every test runs with JAX as strict as it goes, in float64 unless it asks for float32."""

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture
def float32():
    with jax.enable_x64(False):
        yield
