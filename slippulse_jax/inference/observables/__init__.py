"""Kinds of data, one file each: columns, readings, predictions and words.

In the order in which they build on each other:

`observable`        the protocol, and the density of a prediction
`lengths`           lengths, counts of contacts, and fronts that ran past a length
`nucleation`        displacement and force at nucleation
`gauges`            slip and stress along the interface after arrest
`sequence`          forces by place, largest forces, and first lengths, of the events of a block
"""

from slippulse_jax.inference.observables.gauges import Slip, Stress
from slippulse_jax.inference.observables.lengths import Count, Length, Limit
from slippulse_jax.inference.observables.nucleation import Displacement, Force
from slippulse_jax.inference.observables.observable import Observable as Observable
from slippulse_jax.inference.observables.sequence import Between, FirstLength, LargestForce, PlaceForce

EVERY = {
    one.name: one
    for one in (Length, Count, Limit, Displacement, Force, Slip, Stress, PlaceForce, FirstLength, LargestForce, Between)
}
"""Observables by name; those of rows first."""
