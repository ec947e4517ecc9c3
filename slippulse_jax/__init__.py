"""Self-healing slip pulses at the onset of frictional sliding, as a differentiable JAX model.

The public names are imported when first used, so that ``slippulse --help`` answers without starting JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slippulse_jax import theory as theory
    from slippulse_jax.inference.fit import fit as fit
    from slippulse_jax.inference.measurements import MeasurementError as MeasurementError
    from slippulse_jax.inference.measurements import Measurements as Measurements
    from slippulse_jax.inference.measurements import read_measurements as read_measurements
    from slippulse_jax.inference.result import FitResult as FitResult
    from slippulse_jax.lattice.exact import exact_fields as exact_fields
    from slippulse_jax.lattice.exact import exact_front as exact_front
    from slippulse_jax.lattice.exact import exact_front_stress as exact_front_stress
    from slippulse_jax.lattice.exact import exact_length as exact_length
    from slippulse_jax.lattice.front import FrontStatus as FrontStatus
    from slippulse_jax.lattice.precursor import FirstPrecursor as FirstPrecursor
    from slippulse_jax.lattice.precursor import FrontNotArrested as FrontNotArrested
    from slippulse_jax.lattice.precursor import first_precursor as first_precursor
    from slippulse_jax.lattice.precursor import precursor_length as precursor_length
    from slippulse_jax.lattice.precursor import precursor_lengths as precursor_lengths
    from slippulse_jax.slider import Slider as Slider


_HOME = {
    "FirstPrecursor": "lattice.precursor",
    "FitResult": "inference.result",
    "FrontNotArrested": "lattice.precursor",
    "FrontStatus": "lattice.front",
    "MeasurementError": "inference.measurements",
    "Measurements": "inference.measurements",
    "Slider": "slider",
    "exact_fields": "lattice.exact",
    "exact_front": "lattice.exact",
    "exact_front_stress": "lattice.exact",
    "exact_length": "lattice.exact",
    "first_precursor": "lattice.precursor",
    "fit": "inference.fit",
    "precursor_length": "lattice.precursor",
    "precursor_lengths": "lattice.precursor",
    "read_measurements": "inference.measurements",
}

__all__ = [*_HOME, "theory", "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("slippulse_jax")
    if name == "theory":
        return import_module("slippulse_jax.theory")
    if name in _HOME:
        return getattr(import_module(f"slippulse_jax.{_HOME[name]}"), name)
    raise AttributeError(f"module 'slippulse_jax' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
