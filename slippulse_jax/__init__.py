"""Self-healing slip pulses at the onset of frictional sliding, as a differentiable JAX model.

The public names are imported when first used, so that ``slippulse --help`` answers without starting JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slippulse_jax import plot as plot
    from slippulse_jax.lattice.cascade import nucleate as nucleate
    from slippulse_jax.lattice.cascade import rupture as rupture
    from slippulse_jax.lattice.chain import State as State
    from slippulse_jax.lattice.chain import chain as chain
    from slippulse_jax.lattice.chain import relaxed as relaxed
    from slippulse_jax.lattice.equilibrium import equilibrium as equilibrium
    from slippulse_jax.lattice.sensitivity import sensitivity as sensitivity
    from slippulse_jax.rules import HardBreak as HardBreak
    from slippulse_jax.rules import SmoothBreak as SmoothBreak
    from slippulse_jax.slider import Slider as Slider

_HOME = {
    "Slider": "slider",
    "State": "lattice.chain",
    "chain": "lattice.chain",
    "relaxed": "lattice.chain",
    "equilibrium": "lattice.equilibrium",
    "nucleate": "lattice.cascade",
    "rupture": "lattice.cascade",
    "sensitivity": "lattice.sensitivity",
    "HardBreak": "rules",
    "SmoothBreak": "rules",
    "plot": "plot",
}

__all__ = [*_HOME, "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("slippulse_jax")
    if name in _HOME:
        module = import_module(f"slippulse_jax.{_HOME[name]}")
        return module if name == _HOME[name] else getattr(module, name)
    raise AttributeError(f"module 'slippulse_jax' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
