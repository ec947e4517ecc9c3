"""Onset of re-breaking at the edge, for λc → 0.

Derivation in ``docs/macroscopic.md``. Within a few 1/κ of the edge the slow mode is level, and the front stress obeys, with
y = κs and λ = (1 − β)/2,

    dT/dy = 1 − T (1 − λ − λ e^{−2y}),     T(0) = 1,

while contact 0, repinned, carries E = 2λ ∫_0^∞ T e^{−ξ} dξ once the front is far away. Neither ν nor a uniform prestress
enters.
"""

import functools
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

TERMS = 16
"""Terms of the series: each is at most λ/2n ≤ 1/4n of the one before, and the first one left out below 1e-20."""


def macroscopic_edge_stress(b: Any) -> Float[Array, "..."]:
    """Stress on contact 0 behind a front for λc → 0 at fixed b, in σ_s.

    Parameters
    ----------
    b : array_like
        Areal shear stiffness of the interface times H over the shear modulus; > 0.

    Notes
    -----
    The moments M_k = ∫ T e^{−ky} dy obey (k + 1 − λ) M_k = 1 + 1/k + λ M_{k+2}, so that

        E = 2λ M_1 = 2 Σ_n λ^{n+1} (2n + 2)/(2n + 1) / Π_{j≤n} (2j + 2 − λ),     λ = b/2(1 + b).
    """
    return _edge_stress(jnp.asarray(b, dtype=float))


def _edge_stress(b: Any) -> Any:
    share, total = b / (2 * (1 + b)), 0.0
    for n in range(TERMS - 1, -1, -1):  # by Horner's rule
        total = share / (2 * n + 2 - share) * ((2 * n + 2) / (2 * n + 1) + total)
    return 2 * total


@functools.cache
def rebreaking_b() -> float:
    """b* = 3.0872…, beyond which contact 0 breaks again before the front stops, for λc → 0.

    The root of `macroscopic_edge_stress` = 1. `slippulse_jax.rebreaking_onset` gives it for any H/λc.
    """
    low, high = 3.0, 3.2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if _edge_stress(middle) >= 1 else (middle, high)
    return high
