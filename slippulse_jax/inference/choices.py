"""Choices of a fit, which the command line reads without JAX."""

from typing import Literal

Loss = Literal["normal", "student"]
"""Loss function of a residual of r standard errors: r²/2, or that of the t distribution with 4 degrees of freedom.

Intervals (counts, fronts without arrest) keep their own likelihood under both.
"""

Sigma = Literal["absolute", "relative"]
"""Whether the stated σ are standard errors, or only their ratios are used."""

Method = Literal["lm", "lbfgs", "adam"]
"""Minimisation: Levenberg and Marquardt's, or optax's L-BFGS or Adam."""

IntervalsBy = Literal["auto", "profile", "calibrated"]
"""Intervals by rises of the deviance from χ², or from simulated measurements; `auto` chooses."""

MeasuredEvent = Literal["domino", "full", "crack", "sequence", "scattered"]
"""What was measured: the length of the first front, whose contacts heal; of the whole event, in which they may break again; of
the front of a crack, behind which they slide; the force at which the front of a block first reaches each place, up to sliding;
or, of contacts that differ, the length of the first event that would be noticed."""

Body = Literal["slider", "block"]
"""What carries the contacts: the paper's slider, or a block under two-dimensional elasticity that is pushed at a height."""

Template = Literal["slider", "block", "sequence"]
"""Tables to fill in: lengths on sliders or on blocks, or the events of a block up to sliding."""
