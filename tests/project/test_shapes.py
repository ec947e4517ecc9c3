"""Every array that passes between functions of the package has the shape and dtype that its annotation promises."""

import subprocess
import sys
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
import shapes
from jaxtyping import Array, Float

pytestmark = pytest.mark.ci

ROOT = Path(__file__).resolve().parents[2]

PROGRAM = """
import sys
sys.path.insert(0, "tests")
import shapes
shapes.install()  # before anything of the package is imported
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
import numpy as np
import slippulse_jax as sp

slider = sp.Slider(25.0, 0.03, 0.3)
chain = sp.chain(slider, sites=20)
sp.precursor_length(slider)
jax.grad(sp.precursor_length)(slider)
sp.precursor_length(slider, interface=sp.Interface(0.1))
jax.grad(lambda phi: sp.precursor_length(slider, interface=sp.Profile(np.ones(30), phi)))(np.full(30, 0.1))
sp.first_precursor(slider)
sp.exact_length(slider)
sp.exact_lengths(sp.Slider([10.0, 25.0], 0.03, 0.3))
sp.series(chain, events=3)
sp.sensitivity(slider, sites=30)
print("all as promised")
"""


def test_public_functions_with_every_annotation_checked():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "all as promised\n", done.stderr[-3000:]


@jaxtyping.jaxtyped(typechecker=shapes.check)
def ahead(later: Float[np.ndarray, "n-1"], first: Float[np.ndarray, " n"] | None, scale: Float[Array, ""] | float = 1.0):
    """An axis computed from one that is bound later, a union, and a number."""
    return scale


@jaxtyping.jaxtyped(typechecker=shapes.check)
def doubled(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """It does not return what it says."""
    return np.append(x, x)


def test_the_checker_checks():
    assert ahead(np.ones(3), np.ones(4)) == 1.0
    for wrong in (
        (np.ones(4), np.ones(4)),
        (np.ones((3, 1)), np.ones(4)),
        (np.ones(3, int), np.ones(4)),
        (np.ones(3), np.ones(4), np.ones(2)),
    ):
        with pytest.raises(TypeError):
            ahead(*wrong)
    with pytest.raises(TypeError):
        doubled(np.ones(2))
