"""Self-healing slip pulses at the onset of frictional sliding, as a differentiable JAX model.

The public names are imported when first used, so that ``slippulse --help`` answers without starting JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slippulse_jax import plot as plot
    from slippulse_jax import theory as theory
    from slippulse_jax.inference.bayes import Posterior as Posterior
    from slippulse_jax.inference.bootstrap import Bootstrap as Bootstrap
    from slippulse_jax.inference.design.design import Candidate as Candidate
    from slippulse_jax.inference.design.design import Design as Design
    from slippulse_jax.inference.design.design import design as design
    from slippulse_jax.inference.design.knowledge import Knowledge as Knowledge
    from slippulse_jax.inference.fit import fit as fit
    from slippulse_jax.inference.gauges import Gauges as Gauges
    from slippulse_jax.inference.measurements import MeasurementError as MeasurementError
    from slippulse_jax.inference.measurements import Measurements as Measurements
    from slippulse_jax.inference.parameters import Parameter as Parameter
    from slippulse_jax.inference.profile import Interval as Interval
    from slippulse_jax.inference.recover.recovery import Determination as Determination
    from slippulse_jax.inference.recover.recovery import RecoveredProfile as RecoveredProfile
    from slippulse_jax.inference.recover.recovery import recover_profile as recover_profile
    from slippulse_jax.inference.result import FitResult as FitResult
    from slippulse_jax.inference.table import read_measurements as read_measurements
    from slippulse_jax.inference.verdict import Identifiability as Identifiability
    from slippulse_jax.inference.verdict import Verdict as Verdict
    from slippulse_jax.interface import Interface as Interface
    from slippulse_jax.interface import Profile as Profile
    from slippulse_jax.lattice.ageing import Ageing as Ageing
    from slippulse_jax.lattice.catalogue import Catalogue as Catalogue
    from slippulse_jax.lattice.catalogue import EventClass as EventClass
    from slippulse_jax.lattice.catalogue import SeriesStatus as SeriesStatus
    from slippulse_jax.lattice.catalogue import write_series as write_series
    from slippulse_jax.lattice.chain import Chain as Chain
    from slippulse_jax.lattice.chain import State as State
    from slippulse_jax.lattice.chain import chain as chain
    from slippulse_jax.lattice.chain import relaxed as relaxed
    from slippulse_jax.lattice.distribution import ForceLaw as ForceLaw
    from slippulse_jax.lattice.distribution import ThresholdDistribution as ThresholdDistribution
    from slippulse_jax.lattice.distribution import force_law as force_law
    from slippulse_jax.lattice.equilibrium import Equilibrium as Equilibrium
    from slippulse_jax.lattice.equilibrium import EquilibriumStatus as EquilibriumStatus
    from slippulse_jax.lattice.equilibrium import equilibrium as equilibrium
    from slippulse_jax.lattice.exact import ExactFields as ExactFields
    from slippulse_jax.lattice.exact import ExactFront as ExactFront
    from slippulse_jax.lattice.exact import exact_fields as exact_fields
    from slippulse_jax.lattice.exact import exact_front as exact_front
    from slippulse_jax.lattice.exact import exact_front_stress as exact_front_stress
    from slippulse_jax.lattice.exact import exact_length as exact_length
    from slippulse_jax.lattice.exact_crossing import ExactStatus as ExactStatus
    from slippulse_jax.lattice.exact_lanes import ExactLengths as ExactLengths
    from slippulse_jax.lattice.exact_lanes import exact_lengths as exact_lengths
    from slippulse_jax.lattice.front import FrontStatus as FrontStatus
    from slippulse_jax.lattice.inertia import simulate_inertial as simulate_inertial
    from slippulse_jax.lattice.lengths import LengthGradient as LengthGradient
    from slippulse_jax.lattice.lengths import precursor_length_gradients as precursor_length_gradients
    from slippulse_jax.lattice.lengths import precursor_lengths as precursor_lengths
    from slippulse_jax.lattice.modes import Fields as Fields
    from slippulse_jax.lattice.motion import CrackLike as CrackLike
    from slippulse_jax.lattice.motion import Motion as Motion
    from slippulse_jax.lattice.motion import MotionStatus as MotionStatus
    from slippulse_jax.lattice.motion import SelfHealing as SelfHealing
    from slippulse_jax.lattice.precursor import FirstPrecursor as FirstPrecursor
    from slippulse_jax.lattice.precursor import FrontNotArrested as FrontNotArrested
    from slippulse_jax.lattice.precursor import first_precursor as first_precursor
    from slippulse_jax.lattice.precursor import precursor_length as precursor_length
    from slippulse_jax.lattice.rupture import Rupture as Rupture
    from slippulse_jax.lattice.rupture import RuptureStatus as RuptureStatus
    from slippulse_jax.lattice.rupture import nucleate as nucleate
    from slippulse_jax.lattice.rupture import rupture as rupture
    from slippulse_jax.lattice.sensitivity import Sensitivity as Sensitivity
    from slippulse_jax.lattice.sensitivity import sensitivity as sensitivity
    from slippulse_jax.lattice.series import Adiabatic as Adiabatic
    from slippulse_jax.lattice.series import Spring as Spring
    from slippulse_jax.lattice.series import Steps as Steps
    from slippulse_jax.lattice.series import series as series
    from slippulse_jax.rules import HardBreak as HardBreak
    from slippulse_jax.rules import SmoothBreak as SmoothBreak
    from slippulse_jax.slider import Slider as Slider
    from slippulse_jax.sweeps.run import open_sweep as open_sweep
    from slippulse_jax.sweeps.run import sweep as sweep
    from slippulse_jax.sweeps.store import StoreError as StoreError


_HOME = {
    "Adiabatic": "lattice.series",
    "Ageing": "lattice.ageing",
    "Bootstrap": "inference.bootstrap",
    "Candidate": "inference.design.design",
    "Catalogue": "lattice.catalogue",
    "Chain": "lattice.chain",
    "CrackLike": "lattice.motion",
    "Design": "inference.design.design",
    "Determination": "inference.recover.recovery",
    "Equilibrium": "lattice.equilibrium",
    "EquilibriumStatus": "lattice.equilibrium",
    "EventClass": "lattice.catalogue",
    "ExactFields": "lattice.exact",
    "ExactFront": "lattice.exact",
    "ExactLengths": "lattice.exact_lanes",
    "ExactStatus": "lattice.exact_crossing",
    "Fields": "lattice.modes",
    "FirstPrecursor": "lattice.precursor",
    "FitResult": "inference.result",
    "ForceLaw": "lattice.distribution",
    "FrontNotArrested": "lattice.precursor",
    "FrontStatus": "lattice.front",
    "Gauges": "inference.gauges",
    "HardBreak": "rules",
    "Identifiability": "inference.verdict",
    "Interface": "interface",
    "Interval": "inference.profile",
    "Knowledge": "inference.design.knowledge",
    "LengthGradient": "lattice.lengths",
    "MeasurementError": "inference.measurements",
    "Measurements": "inference.measurements",
    "Motion": "lattice.motion",
    "MotionStatus": "lattice.motion",
    "Parameter": "inference.parameters",
    "Posterior": "inference.bayes",
    "Profile": "interface",
    "RecoveredProfile": "inference.recover.recovery",
    "Rupture": "lattice.rupture",
    "RuptureStatus": "lattice.rupture",
    "SelfHealing": "lattice.motion",
    "Sensitivity": "lattice.sensitivity",
    "SeriesStatus": "lattice.catalogue",
    "Slider": "slider",
    "SmoothBreak": "rules",
    "Spring": "lattice.series",
    "State": "lattice.chain",
    "Steps": "lattice.series",
    "StoreError": "sweeps.store",
    "ThresholdDistribution": "lattice.distribution",
    "Verdict": "inference.verdict",
    "chain": "lattice.chain",
    "design": "inference.design.design",
    "equilibrium": "lattice.equilibrium",
    "exact_fields": "lattice.exact",
    "exact_front": "lattice.exact",
    "exact_front_stress": "lattice.exact",
    "exact_length": "lattice.exact",
    "exact_lengths": "lattice.exact_lanes",
    "first_precursor": "lattice.precursor",
    "fit": "inference.fit",
    "force_law": "lattice.distribution",
    "nucleate": "lattice.rupture",
    "open_sweep": "sweeps.run",
    "plot": "plot",
    "precursor_length": "lattice.precursor",
    "precursor_length_gradients": "lattice.lengths",
    "precursor_lengths": "lattice.lengths",
    "read_measurements": "inference.table",
    "recover_profile": "inference.recover.recovery",
    "relaxed": "lattice.chain",
    "rupture": "lattice.rupture",
    "sensitivity": "lattice.sensitivity",
    "series": "lattice.series",
    "simulate_inertial": "lattice.inertia",
    "sweep": "sweeps.run",
    "theory": "theory",
    "write_series": "lattice.catalogue",
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
