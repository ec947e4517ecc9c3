"""The block under two-dimensional elasticity as a strip that rests on its contacts."""

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike


def block_decay_length(b: ArrayLike, poisson: ArrayLike) -> Float[np.ndarray, "..."]:
    """Length over which an edge load decays along a block in plane stress, over H.

    It is 1/ζ, of the smallest root of b[4 − (1+ν)²ζ² − (3−ν)(1+ν) sin²ζ] = 4(1+ν)ζ(sin ζ cos ζ + ζ): the slowest mode of a
    strip without normal displacement at its lower edge, free at its upper one. At least 1/π.
    """
    b, poisson = np.broadcast_arrays(np.asarray(b, float), np.asarray(poisson, float))
    low, high = np.zeros(b.shape), np.full(b.shape, np.pi)
    for _ in range(60):
        zeta = (low + high) / 2
        held = 4 - (1 + poisson) ** 2 * zeta**2 - (3 - poisson) * (1 + poisson) * np.sin(zeta) ** 2
        above = b * held > 4 * (1 + poisson) * zeta * (np.sin(zeta) * np.cos(zeta) + zeta)
        low, high = np.where(above, zeta, low), np.where(above, high, zeta)
    return 1 / high
