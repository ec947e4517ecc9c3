"""Pictures, with a unit on every axis.

What fits on one Axes is drawn on the ``ax=`` it is given, which is returned; without ``ax`` a figure of column width is made.
Functions that need several panels return a figure. Colours and type are those of `slippulse_jax.plot.style`.
"""

from slippulse_jax.plot import style as style
from slippulse_jax.plot.animation import animate as animate
from slippulse_jax.plot.blocks import block_stress as block_stress
from slippulse_jax.plot.designs import design as design
from slippulse_jax.plot.designs import design_figure as design_figure
from slippulse_jax.plot.designs import design_lengths as design_lengths
from slippulse_jax.plot.events import break_order as break_order
from slippulse_jax.plot.events import displacements as displacements
from slippulse_jax.plot.events import friction_curve as friction_curve
from slippulse_jax.plot.events import front_stress as front_stress
from slippulse_jax.plot.events import precursors as precursors
from slippulse_jax.plot.events import sensitivity as sensitivity
from slippulse_jax.plot.events import space_time as space_time
from slippulse_jax.plot.events import stress as stress
from slippulse_jax.plot.explorer import explore as explore
from slippulse_jax.plot.fits import confidence_region as confidence_region
from slippulse_jax.plot.fits import corner as corner
from slippulse_jax.plot.fits import fit as fit
from slippulse_jax.plot.fits import fit_profiles as fit_profiles
from slippulse_jax.plot.fits import observable as observable
from slippulse_jax.plot.fits import profile as profile
from slippulse_jax.plot.fits import residuals as residuals
from slippulse_jax.plot.lengths import fit_lengths as fit_lengths
from slippulse_jax.plot.lengths import length_versus_stiffness as length_versus_stiffness
from slippulse_jax.plot.maps import sweep as sweep
from slippulse_jax.plot.profiles import recovered_profile as recovered_profile
from slippulse_jax.plot.profiles import resolution as resolution
from slippulse_jax.plot.readings import gauge_readings as gauge_readings
from slippulse_jax.plot.readings import gauges as gauges
from slippulse_jax.plot.schematic import schematic as schematic
from slippulse_jax.plot.sequences import fit_sequence as fit_sequence
from slippulse_jax.plot.sequences import sequence_events as sequence_events
from slippulse_jax.plot.style import save as save
