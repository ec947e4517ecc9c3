"""Compute the lengths of tall blocks that come with the package: relaxed, pushed above some heights.

Run: python -m benchmarks block_table (a minute)
"""

import io

import numpy as np

from slippulse_jax.files import write_atomically
from slippulse_jax.inference.block_lengths import TABLE, TALLEST, BlockLengths
from slippulse_jax.inference.fronts import BLOCK_FROM, BLOCK_TO
from slippulse_jax.inference.inputs import Inputs

POISSON, PUSHES = (0.2, 0.3, 0.4), (0.5, 0.25, 0.1)
SPACING = 0.2
"""In ln b."""


def main() -> None:
    """Write the table."""
    log_b = np.arange(np.log(BLOCK_FROM), np.log(BLOCK_TO), SPACING)
    poisson, push, at = np.meshgrid(POISSON, PUSHES, log_b, indexing="ij")
    inputs = Inputs.of(TALLEST, np.exp(at) / (2 * (1 + poisson) * TALLEST), poisson)
    pushed = inputs.given(log_push=np.log(push), log_push_width=np.full(push.shape, np.inf), push_force=np.zeros(push.shape))
    found, content = BlockLengths()(pushed.ravel())[0].reshape(push.shape) / TALLEST, io.BytesIO()
    np.savez_compressed(content, poisson=POISSON, push=PUSHES, log_b=log_b, length=found)
    write_atomically(TABLE, content.getvalue())


if __name__ == "__main__":
    main()
