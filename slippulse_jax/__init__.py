"""Self-healing slip pulses at the onset of frictional sliding, as a differentiable JAX model.

The public names are imported when first used, so that ``slippulse --help`` answers without starting JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slippulse_jax.slider import Slider as Slider

_HOME = {
    "Slider": "slider",
}

__all__ = [*_HOME, "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("slippulse_jax")
    if name in _HOME:
        return getattr(import_module(f"slippulse_jax.{_HOME[name]}"), name)
    raise AttributeError(f"module 'slippulse_jax' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
