"""What the paper, and this project, derive on paper: four levels of theory, each under its own name.

1. the lattice itself, `slippulse_jax.exact_length`; 2. `length_continuum`, the continuum self-consistent in both layers;
3. `length_frozen`, the continuum with the upper layer frozen (Appendix), and `length`, Eq. (58), a fit of it;
4. `length_eq25`, the paper's Eq. (25). `macroscopic_length` is the limit λc → 0 of the first two; `envelope_length` a line.
The gaps between the levels are physics, not error.
"""

from slippulse_jax.theory.continuum import continuum_fields, continuum_stress, length_continuum
from slippulse_jax.theory.frozen import appendix, frozen_stress, length, length_eq25, length_frozen, slow_decay_length
from slippulse_jax.theory.limits import (
    areal_stiffness_from_b,
    b_from_areal_stiffness,
    envelope_length,
    length_ceiling,
    macroscopic_correction,
    macroscopic_length,
    runaway_prestress,
)

__all__ = [
    "appendix",
    "areal_stiffness_from_b",
    "b_from_areal_stiffness",
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
    "macroscopic_length",
    "runaway_prestress",
    "slow_decay_length",
]
