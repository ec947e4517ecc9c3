"""Analytical theory of the paper and this project, at four levels.

1. The lattice itself: `slippulse_jax.exact_length`.
2. The continuum, self-consistent in both layers: `length_continuum`.
3. The continuum with the upper layer frozen (Appendix): `length_frozen`, and `length`, Eq. (58), a fit of it.
4. The paper's Eq. (25): `length_eq25`.

`macroscopic_length` is the limit λc → 0 of the first two; `envelope_length` is a straight line. The differences between the
levels are physics, not errors. Of a block under two-dimensional elasticity there is `block_decay_length`.
"""

from slippulse_jax.exact.continuum import continuum_fields, continuum_stress, length_continuum
from slippulse_jax.theory.frozen import appendix, frozen_stress, length, length_eq25, length_frozen
from slippulse_jax.theory.limits import (
    block_decay_length,
    envelope_length,
    length_ceiling,
    macroscopic_correction,
    macroscopic_crack_length,
    macroscopic_edge_stress,
    macroscopic_length,
    rebreaking_b,
    runaway_prestress,
)

__all__ = [
    "appendix",
    "block_decay_length",
    "continuum_fields",
    "continuum_stress",
    "envelope_length",
    "frozen_stress",
    "length",
    "length_ceiling",
    "length_continuum",
    "length_eq25",
    "length_frozen",
    "macroscopic_correction",
    "macroscopic_crack_length",
    "macroscopic_edge_stress",
    "macroscopic_length",
    "rebreaking_b",
    "runaway_prestress",
]
