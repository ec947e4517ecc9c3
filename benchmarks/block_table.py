"""Compute the nodes of lengths of blocks that come with the package: relaxed blocks, for the usual heights of the push.

Nodes that the table has are left; the file is written anew every few minutes, and complete at any moment.
Run: python -m benchmarks block_table [--patches] (an hour of one core; pushes on patches of 0.1 H take as long again)
"""

import argparse
import io
import itertools

import numpy as np

from slippulse_jax.files import write_atomically
from slippulse_jax.inference.fronts import BLOCK_FROM, BLOCK_TO
from slippulse_jax.inference.interpolation import BLOCK_SPACING, TABLE, block_grid

POISSON = (0.3, 0.4, 0.2)
HEIGHTS = (0.25, 0.2, 0.3, 0.5, 0.45, 0.55, 0.4, 0.35, 0.1, 0.15, 0.05, 0.6, 0.75, 0.7, 0.8, 0.65, 0.85, 0.9)
AT_ONCE = 112


def wanted(patches: bool) -> np.ndarray:
    """Nodes, the most usual first, (n, 7)."""
    low, high = (round(np.log(b) / BLOCK_SPACING[1]) for b in (BLOCK_FROM, BLOCK_TO))
    width, kind, least = (1, 1, 0.1) if patches else (0, 0, 0.0)
    place = [
        (i, j, round(poisson / BLOCK_SPACING[2]), 0, round(height / BLOCK_SPACING[4]), width, kind)
        for height, poisson, i, j in itertools.product(HEIGHTS, POISSON, (0, 1), range(low - 1, high + 2))
        if least / 2 < height < 1 - least / 2
    ]
    return np.array(place)


def main() -> None:
    """Complete the table."""
    asked = argparse.ArgumentParser(description="Lengths of blocks that come with the package.")
    asked.add_argument("--patches", action="store_true")
    missing = [node for node in wanted(asked.parse_args().patches).tolist() if tuple(node) not in block_grid().known]
    for start in range(0, len(missing), AT_ONCE):
        nodes = np.array(missing[start : start + AT_ONCE])
        block_grid()(nodes * np.array(BLOCK_SPACING))
        known = block_grid().known
        node, content = np.array(sorted(known), dtype=np.int16), io.BytesIO()
        value = np.array([known[tuple(x)] for x in node.tolist()], dtype=np.float32)
        np.savez_compressed(content, node=node, value=value)
        write_atomically(TABLE, content.getvalue())
        print(f"{start + len(nodes)} of {len(missing)}", flush=True)


if __name__ == "__main__":
    main()
