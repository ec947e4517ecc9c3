"""Public functions, each with the largest relative error that single precision may have.

Run as a program it prints what a process computes that leaves JAX as it is.
"""

import json

import jax
import jax.numpy as jnp
import numpy as np

import slippulse_jax as sp
from slippulse_jax.blocks import event as blocks

SLIDER = sp.Slider(25.0, 0.03, 0.3)
BLOCK = sp.Block(40.0, 0.05, 0.3, sp.Push(0.4))
ROUNDED, SINGLE = 1e-6, 1e-3
"""Of numbers that are computed in double precision, and of those that are not."""


def low(height):
    """Blocks of which single precision made lengths of 1055 and 36, or none at all."""
    return sp.Block(800.0, 0.000703125, 0.37, sp.Push(height, 0.05))


def stress_in_the_block():
    found = sp.first_precursor(BLOCK)
    return sp.plot.block_stress(found, 20, colorbar=False).collections[0].get_array()


def of_fields():
    found = sp.first_precursor(BLOCK)
    return blocks.fields(found.body, found.load, found.pinning).vertical[:, -1]


def of_series():
    found = sp.series(BLOCK, events=6, sites=256)
    return jnp.concatenate([found.load, found.length, found.force_after])


CALLS = {
    "a low push": (lambda: sp.first_precursor(low(0.25)).length, ROUNDED),
    "its load": (lambda: sp.first_precursor(low(0.25)).load, ROUNDED),
    "a push at a third": (lambda: sp.first_precursor(low(0.35)).length, ROUNDED),
    "a tall block": (lambda: sp.precursor_length(low(0.35)), ROUNDED),
    "a tall block, all of it": (lambda: sp.precursor_length(low(0.35), event="full"), ROUNDED),
    "a front": (lambda: sp.precursor_length(BLOCK), ROUNDED),
    "an event": (lambda: sp.precursor_length(BLOCK, sp.Interface(0.1), event="full"), ROUNDED),
    "a smooth front": (lambda: sp.precursor_length(BLOCK, rule=sp.SmoothBreak(0.02)), ROUNDED),
    "stress": (lambda: sp.first_precursor(BLOCK).stress, ROUNDED),
    "derivatives": (lambda: jnp.stack(jax.tree.leaves(jax.grad(sp.precursor_length)(BLOCK))), 1e-4),  # of rounded numbers
    "forward derivative": (lambda: jax.jacfwd(lambda k: sp.precursor_length(sp.Block(40.0, k, 0.3)))(0.05), 1e-4),
    "fields": (of_fields, ROUNDED),
    "series of a block": (of_series, ROUNDED),
    "picture": (stress_in_the_block, 1e-5),
    "sweep": (
        lambda: (
            sp.sweep(
                height=40.0, stiffness=[0.05], poisson=0.3, push_height=0.4, outputs="block_precursor_length", progress=False
            ).block_precursor_length.values
        ),
        0,
    ),  # fmt: skip
    "slider": (lambda: sp.precursor_length(SLIDER), SINGLE),
    "slider, whole event": (lambda: sp.precursor_length(sp.Slider(50.0, 0.08, 0.3), event="full"), ROUNDED),
    "record": (lambda: sp.first_precursor(SLIDER).stress, SINGLE),
    "in bulk": (lambda: sp.precursor_lengths(SLIDER), 0),
    "exact": (lambda: sp.exact_length(SLIDER), SINGLE),
    "rupture": (lambda: sp.rupture(sp.chain(SLIDER, sites=80)).length, SINGLE),
    "series": (lambda: sp.series(sp.chain(SLIDER, sites=80), events=3).load, SINGLE),
    "sensitivity": (lambda: sp.sensitivity(SLIDER, sites=40).prestress, SINGLE),
}


def results():
    return {name: np.asarray(call(), np.float64).ravel().tolist() for name, (call, _) in CALLS.items()}


if __name__ == "__main__":
    print(json.dumps(results()))
