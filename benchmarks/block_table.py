"""Compute the lengths of tall blocks that come with the package: relaxed, pushed above some heights.

Run: python -m benchmarks block_table (a minute)
"""

import io

import numpy as np

import slippulse_jax as sp
from slippulse_jax.events.resolution import many, tall_lengths
from slippulse_jax.files import write_atomically
from slippulse_jax.inference.block_lengths import TABLE, TALLEST
from slippulse_jax.inference.fronts import BLOCK_FROM, BLOCK_TO

POISSON, PUSHES = (0.2, 0.3, 0.4), (0.5, 0.25, 0.1)
SPACING = 0.2
"""In ln b."""


def main() -> None:
    """Write the table."""
    log_b = np.arange(np.log(BLOCK_FROM), np.log(BLOCK_TO), SPACING)
    poisson, push, at = np.meshgrid(POISSON, PUSHES, log_b, indexing="ij")
    stiffness, none = np.exp(at) / (2 * (1 + poisson) * TALLEST), np.zeros(at.size)
    block = many(np.full(at.size, TALLEST), stiffness.ravel(), poisson.ravel(), push.ravel())
    found, content = tall_lengths(block, sp.Interface(none, none), "full")[0].reshape(at.shape) / TALLEST, io.BytesIO()
    np.savez_compressed(content, poisson=POISSON, push=PUSHES, log_b=log_b, length=found)
    write_atomically(TABLE, content.getvalue())


if __name__ == "__main__":
    main()
