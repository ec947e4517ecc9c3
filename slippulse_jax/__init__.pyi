"""Public names and their modules, as ``__init__.py`` reads them."""

from slippulse_jax import experiments as experiments
from slippulse_jax import plot as plot
from slippulse_jax import theory as theory
from slippulse_jax.block import Block as Block
from slippulse_jax.block import Push as Push
from slippulse_jax.bodies.chain import chain as chain
from slippulse_jax.bodies.equilibrium import equilibrium as equilibrium
from slippulse_jax.events.ageing import Ageing as Ageing
from slippulse_jax.events.inertia import simulate_inertial as simulate_inertial
from slippulse_jax.events.rupture import nucleate as nucleate
from slippulse_jax.events.rupture import rupture as rupture
from slippulse_jax.events.scattered import scattered as scattered
from slippulse_jax.events.series import Spring as Spring
from slippulse_jax.events.series import Steps as Steps
from slippulse_jax.events.series import series as series
from slippulse_jax.events.series import static_friction as static_friction
from slippulse_jax.exact.bulk import exact_lengths as exact_lengths
from slippulse_jax.exact.bulk import rebreaking_onset as rebreaking_onset
from slippulse_jax.exact.front import exact_front as exact_front
from slippulse_jax.exact.front import exact_length as exact_length
from slippulse_jax.front.sensitivity import sensitivity as sensitivity
from slippulse_jax.inference.design import design as design
from slippulse_jax.inference.fit import fit as fit
from slippulse_jax.inference.knowledge import Knowledge as Knowledge
from slippulse_jax.inference.mechanism import pulse_or_crack as pulse_or_crack
from slippulse_jax.inference.objective import objective as objective
from slippulse_jax.inference.parameters import Parameter as Parameter
from slippulse_jax.inference.recover import recover_profile as recover_profile
from slippulse_jax.inference.result.result import load_fit as load_fit
from slippulse_jax.inference.table.measurements import Gauges as Gauges
from slippulse_jax.inference.table.measurements import Measurements as Measurements
from slippulse_jax.inference.table.measurements import read_measurements as read_measurements
from slippulse_jax.interface import Interface as Interface
from slippulse_jax.interface import Profile as Profile
from slippulse_jax.lengths import precursor_lengths as precursor_lengths
from slippulse_jax.precursor import first_precursor as first_precursor
from slippulse_jax.precursor import precursor_length as precursor_length
from slippulse_jax.rules import CrackLike as CrackLike
from slippulse_jax.rules import SmoothBreak as SmoothBreak
from slippulse_jax.slider import Slider as Slider
from slippulse_jax.sweeps.run import open_sweep as open_sweep
from slippulse_jax.sweeps.run import sweep as sweep

__version__: str
