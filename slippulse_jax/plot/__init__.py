"""Pictures, with a unit on every axis; each is drawn on the Axes it is given as ``ax=``, and gives it back.

Without ``ax`` a figure of column width is made. Colours and type are those of `slippulse_jax.plot.style`.
"""

from slippulse_jax.plot import style as style
from slippulse_jax.plot.animation import animate as animate
from slippulse_jax.plot.events import friction_curve as friction_curve
from slippulse_jax.plot.events import space_time as space_time
from slippulse_jax.plot.explorer import explore as explore
from slippulse_jax.plot.maps import sweep as sweep
from slippulse_jax.plot.states import break_order as break_order
from slippulse_jax.plot.states import displacements as displacements
from slippulse_jax.plot.states import front_stress as front_stress
from slippulse_jax.plot.states import sensitivity as sensitivity
from slippulse_jax.plot.states import stress as stress
